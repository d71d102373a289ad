//! Bringing the mesh into the cameras' frame: the similarity transform under which it fits to the photographs' silhouettes.
//!
//! Started from what is stated, from points and where photographs show them (`marks`), or from nothing: then many rotations
//! are tried on points of the surface (`start`). The best are settled by least squares on blurred silhouettes, from coarse to
//! fine (`silhouettes`). The photographs must say what the object covers, by alpha or by masks; only marks do without.

mod descent;
mod marks;
mod points_file;
mod sights;
mod silhouettes;
mod similarity;
mod start;
#[cfg(test)]
mod tests;

pub use marks::{Mark, MarkedPoint, MarksError, Placement};
pub use points_file::{PointsError, read_points};
pub use similarity::Similarity;

use rayon::prelude::*;

use rekindle_capture::{Mesh, View};
use sights::Sights;
use silhouettes::Silhouettes;

/// Starts that are settled at the coarsest level, those of them that go on, and pixels along a silhouette's longer side at each.
const LEVELS: [(usize, u32); 3] = [(16, 40), (4, 80), (1, 180)];
/// Cells along the mesh's longest side, of which each keeps one vertex at the coarse levels.
const CELLS: f32 = 96.0;
/// Start fits better than this are near enough to begin with.
const NEAR: f64 = 0.6;
/// Two fits whose overlap differs by less can't be told apart by silhouettes, if they are turned by more than the angle.
const ALIKE: f64 = 0.005;
const TURNED: f64 = 0.3;

/// Why a mesh can't be aligned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AlignError {
    /// Too few pictures tell what the object covers.
    #[error(
        "only {0} of the photographs tell what the object covers; give at least two of them alpha or a mask_path, or align by points"
    )]
    TooFewSilhouettes(usize),
    /// The pairs of points don't determine a transform.
    #[error("the pairs don't determine a transform; give three or more that are not on one line")]
    Pairs,
    /// The marks don't determine a transform.
    #[error(transparent)]
    Marks(#[from] MarksError),
    /// The observer asked to stop.
    #[error("stopped")]
    Stopped,
}

/// Says whether to stop; asked often, and by several threads.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Where an alignment begins.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// From nothing, unless the mesh lies near enough already.
    Anywhere,
    /// From a transform.
    At(Similarity),
    /// From where marks place the mesh. They also hold what silhouettes leave open.
    Marks(&'a [MarkedPoint]),
}

/// Where the mesh belongs.
#[derive(Clone, Debug)]
pub struct Alignment {
    /// From the mesh's file to the cameras' frame.
    pub transform: Similarity,
    /// Intersection over union of the silhouettes, one per view, none for those without one.
    pub overlap: Vec<Option<f64>>,
    /// Whether another rotation fits as well, so that silhouettes alone don't tell.
    pub ambiguous: bool,
}

impl Alignment {
    /// Mean overlap over the views that have one, if any has.
    pub fn mean_overlap(&self) -> Option<f64> {
        let any = self.overlap.iter().any(Option::is_some);
        any.then(|| mean(&self.overlap))
    }
}

fn mean(overlap: &[Option<f64>]) -> f64 {
    let known: Vec<f64> = overlap.iter().copied().flatten().collect();
    known.iter().sum::<f64>() / known.len().max(1) as f64
}

/// Finds the transform of `mesh` for `views`. `progress` is told the part that is done. Without silhouettes the mesh lies where
/// marks place it.
pub fn align(
    views: &[View],
    mesh: &Mesh,
    start: Start<'_>,
    progress: &mut dyn FnMut(f32),
    stop: Stop<'_>,
) -> Result<Alignment, AlignError> {
    let (placed, hold) = match start {
        Start::Anywhere => (None, None),
        Start::At(transform) => (Some(transform), None),
        Start::Marks(points) => {
            let placement = Placement::new(views, points)?;
            (Some(placement.transform), Some(Sights::new(views, points)))
        }
    };
    let known = views
        .iter()
        .filter(|v| v.photograph.coverage.is_some())
        .count();
    if known < 2 {
        let by_marks = placed.filter(|_| hold.is_some());
        return by_marks
            .map(|transform| Alignment {
                transform,
                overlap: vec![None; views.len()],
                ambiguous: false,
            })
            .ok_or(AlignError::TooFewSilhouettes(known));
    }
    let mut go_on = |part| {
        progress(part);
        if stop() {
            Err(AlignError::Stopped)
        } else {
            Ok(())
        }
    };
    go_on(0.0)?;
    let coarse = silhouettes::thinned(mesh, CELLS);
    let stated = placed.unwrap_or(Similarity::IDENTITY);
    let levels = LEVELS.map(|(_, side)| side);
    let first = Silhouettes::new(views, &coarse, levels[0]);
    let mut found = vec![stated];
    if placed.is_none() && mean(&first.overlap(&stated)) < NEAR {
        found = start::rotations(views, mesh);
        go_on(0.2)?;
    }
    for (level, (count, side)) in LEVELS.into_iter().enumerate() {
        let last = level + 1 == LEVELS.len();
        let silhouettes = Silhouettes::new(views, if last { mesh } else { &coarse }, side);
        let mut settled: Vec<(f64, Similarity)> = Vec::new();
        let candidates: Vec<Similarity> = found.iter().copied().take(count).collect();
        // A few at a time, so that one may stop between them.
        for some in candidates.chunks(4) {
            go_on(
                0.2 + 0.25 * level as f32 + 0.25 * settled.len() as f32 / candidates.len() as f32,
            )?;
            let fits: Vec<(f64, Similarity)> = some
                .par_iter()
                .map(|&start| {
                    let end = silhouettes.settle(start, hold.as_ref(), stop);
                    (mean(&silhouettes.overlap(&end)), end)
                })
                .collect();
            settled.extend(fits);
        }
        settled.sort_by(|a, b| b.0.total_cmp(&a.0));
        if last {
            go_on(1.0)?;
            let (_, transform) = settled[0];
            return Ok(Alignment {
                transform,
                overlap: silhouettes.overlap(&transform),
                ambiguous: is_ambiguous(&found, &first),
            });
        }
        found = settled.into_iter().map(|(_, fit)| fit).collect();
    }
    Err(AlignError::Stopped)
}

/// Whether a fit that is turned against the best one overlaps as well.
fn is_ambiguous(found: &[Similarity], coarse: &Silhouettes<'_>) -> bool {
    let Some((best, others)) = found.split_first() else {
        return false;
    };
    let overlap = mean(&coarse.overlap(best));
    others.iter().any(|other| {
        other.rotation.angle_between(best.rotation) > TURNED
            && mean(&coarse.overlap(other)) > overlap - ALIKE
    })
}
