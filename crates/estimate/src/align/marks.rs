//! A mesh placed by marks: points of it, and where photographs show them.
//!
//! A similarity transform has seven numbers and a mark tells two, so that three points and four marks would do; they must be in
//! two photographs, for one leaves the size open. All marks are fitted together, and any photograph may show any of the points.

use glam::{DVec2, DVec3};

use super::Similarity;
use super::descent::{Descent, cost};
use super::sights::Sights;
use super::similarity::breadth;
use rekindle_capture::View;

/// Points and marks at least.
const POINTS: usize = 3;
const MARKS: usize = 4;
/// Points less broad than this turn with the smallest error of a mark: their second extent is a thirtieth of the first.
const BREADTH: f64 = 2e-3;
/// Starts that are settled, and steps of least squares for each.
const STARTS: usize = 12;
const STEPS: usize = 40;
/// Marks are set as exactly as this part of a picture's longer side; whatever fits so well can't be told apart.
const EXACT: f64 = 0.004;
/// Marks off by more than this part are contradictions.
const OFF: f64 = 0.05;
/// Turned by more than this, radians, a place is another one.
const TURNED: f64 = 0.3;
/// Least part of the best told number's weight that the worst told one may have.
const TOLD: f64 = 1e-8;

/// Where a photograph shows a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// The view, by its number from 0.
    pub view: usize,
    /// Pixel coordinates in its photograph.
    pub pixel: DVec2,
}

/// A point of the mesh and where photographs show it.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkedPoint {
    /// Where it is on the mesh, as that lies.
    pub place: DVec3,
    /// At most one per view.
    pub marks: Vec<Mark>,
}

/// Why marks don't place a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MarksError {
    /// Fewer than three points have marks.
    #[error(
        "{} marked in photographs; mark three or more that are not on one line",
        points(*.0)
    )]
    TooFewPoints(usize),
    /// All marks are in one photograph.
    #[error(
        "all marks are in one photograph, which leaves the size open; mark points in a second one too"
    )]
    OnePhotograph,
    /// Too few marks for the numbers of a transform.
    #[error("three marks leave the place open; mark one of the points in another photograph too")]
    TooFewMarks,
    /// The points are on one line.
    #[error(
        "the marked points are on one line, about which the mesh may turn; mark one beside it too"
    )]
    OnALine,
    /// Whatever the place, some mark is far off or would be behind its camera.
    #[error(
        "the marks contradict each other, most of all those of point {point}; check that each shows that very point"
    )]
    Contradiction {
        /// The worst point, from 1.
        point: usize,
    },
    /// Several places fit.
    #[error(
        "the mesh fits to these marks in more than one place; mark another point, or one of them in another photograph"
    )]
    Ambiguous,
}

fn points(count: usize) -> String {
    match count {
        0 => "no point is".to_owned(),
        1 => "only one point is".to_owned(),
        n => format!("only {n} points are"),
    }
}

/// A mesh placed by marks.
#[derive(Clone, Debug)]
pub struct Placement {
    /// From where the mesh lies to where the marks say.
    pub transform: Similarity,
    /// By how many pixels each mark is missed, as the points have them.
    pub misses: Vec<Vec<f64>>,
}

impl Placement {
    /// The place that fits to all marks best.
    pub fn new(views: &[View], points: &[MarkedPoint]) -> Result<Self, MarksError> {
        check(points)?;
        let sights = Sights::new(views, points);
        let residuals = |transform: &Similarity| sights.residuals(transform).collect::<Vec<f32>>();
        let descent = descent(points);
        let mut settled: Vec<(f64, Similarity)> = sights
            .starts(STARTS)
            .into_iter()
            .map(|start| {
                let end = descent.settle(start, residuals);
                (cost(&residuals(&end)), end)
            })
            .collect();
        settled.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(&(_, transform)) = settled.first() else {
            return Err(MarksError::Ambiguous);
        };
        let best = Self::of(views, points, transform);
        let off = best.relative(views, points);
        let worst = (off.iter().enumerate()).max_by(|a, b| a.1.total_cmp(b.1));
        if let Some((point, _)) = worst.filter(|(_, off)| **off > OFF) {
            return Err(MarksError::Contradiction { point: point + 1 });
        }
        let limit = EXACT.max(2.0 * mean(&off));
        let as_good = settled[1..].iter().any(|(_, other)| {
            let elsewhere = other.rotation.angle_between(transform.rotation) > TURNED;
            elsewhere && mean(&Self::of(views, points, *other).relative(views, points)) < limit
        });
        if as_good || descent.condition(&transform, residuals) < TOLD {
            return Err(MarksError::Ambiguous);
        }
        Ok(best)
    }

    /// How a transform misses the marks; endlessly where a point would be behind a camera.
    fn of(views: &[View], points: &[MarkedPoint], transform: Similarity) -> Self {
        let miss = |point: &MarkedPoint, mark: &Mark| {
            let seen = views[mark.view]
                .camera
                .project(transform.apply(point.place));
            seen.map_or(f64::INFINITY, |pixel| pixel.distance(mark.pixel))
        };
        let of = |point: &MarkedPoint| point.marks.iter().map(|m| miss(point, m)).collect();
        Self {
            transform,
            misses: points.iter().map(of).collect(),
        }
    }

    /// The mean miss over all marks, pixels.
    pub fn mean_miss(&self) -> f64 {
        let all: Vec<f64> = self.misses.iter().flatten().copied().collect();
        mean(&all)
    }

    /// The largest miss of each point, in parts of the pictures' longer sides.
    fn relative(&self, views: &[View], points: &[MarkedPoint]) -> Vec<f64> {
        let of = |(point, misses): (&MarkedPoint, &Vec<f64>)| {
            let parts = point.marks.iter().zip(misses).map(|(mark, miss)| {
                let camera = &views[mark.view].camera;
                miss / f64::from(camera.width.max(camera.height))
            });
            parts.fold(0.0, f64::max)
        };
        points.iter().zip(&self.misses).map(of).collect()
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// What marks lack to determine a transform.
fn check(points: &[MarkedPoint]) -> Result<(), MarksError> {
    let marked: Vec<&MarkedPoint> = points.iter().filter(|p| !p.marks.is_empty()).collect();
    if marked.len() < POINTS {
        return Err(MarksError::TooFewPoints(marked.len()));
    }
    let places: Vec<DVec3> = marked.iter().map(|p| p.place).collect();
    if breadth(&places) < BREADTH {
        return Err(MarksError::OnALine);
    }
    let marks: Vec<&Mark> = marked.iter().flat_map(|p| &p.marks).collect();
    if marks.iter().all(|mark| mark.view == marks[0].view) {
        return Err(MarksError::OnePhotograph);
    }
    if marks.len() < MARKS {
        return Err(MarksError::TooFewMarks);
    }
    Ok(())
}

fn descent(points: &[MarkedPoint]) -> Descent<'static> {
    let marked = || {
        points
            .iter()
            .filter(|p| !p.marks.is_empty())
            .map(|p| p.place)
    };
    let centre = marked().sum::<DVec3>() / marked().count().max(1) as f64;
    let radius = marked().map(|place| place.distance(centre));
    Descent {
        centre,
        radius: radius.fold(0.0, f64::max),
        step: 1e-4,
        steps: STEPS,
        stop: &|| false,
    }
}
