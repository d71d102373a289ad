//! Whether the shading bears out lights that highlights tell.
//!
//! Highlights and shading are two witnesses: a fit of the specular part eliminates the diffuse colours, and what makes these even has no
//! say in it. So lights are fitted to the shading alone, from what highlights say on. Those that were there hardly change.

use super::discs::{Discs, Fitting, Free};
use super::region::Receivers;
use super::{FREQUENCY, POINTS, Shading, diffuse, over_mean, pairs};
use crate::estimate::cells::Pyramid;
use crate::estimate::fast::Solver;
use crate::estimate::observations::Point;
use crate::estimate::weights::magnitude;
use rekindle_scene::hemisphere::{Lamp, find_lamps};

/// Lights with less than this part of the flux are not looked at.
const LEAST_SHARE: f32 = 0.01;

/// How far apart the two have a light at most where they agree, radians. Two directions of a hemisphere are so near to each other by chance
/// in one case of 740: 1 − cos.
const MOST_APART: f32 = 0.052;
/// And which part of the flux they have in other lights: a seventh of a stop. Of sixteen path-traced captures whose lights were right, ten
/// of them scans or JPEGs, it was up to 0.05.
const MOST_ELSEWHERE: f32 = 0.1;

/// What highlights and shading have differently.
#[derive(Clone, Copy, Debug)]
pub struct Agreement {
    /// The largest angle between the two directions of a light, radians.
    pub apart: f32,
    /// Part of the flux that is in other lights.
    pub elsewhere: f32,
}

impl Agreement {
    /// Of lights of so much radiance on the solver's nodes, at the points that have a diffuse part; `None` where there are none.
    pub fn of(
        solver: &Solver<'_>,
        nodes: &[[f32; 3]],
        has_diffuse_part: impl Fn(&Point) -> bool,
    ) -> Option<Self> {
        let observations = (solver.colours(POINTS).measured()).of_points(has_diffuse_part);
        let pairs = pairs(&observations.points);
        let grid = solver.grid.to_whole();
        let pyramid = Pyramid::new(&grid, FREQUENCY);
        let cells = pyramid.roots();
        let shading = Shading::new(solver, &observations, &pyramid, &cells, &pairs);
        let beside = shading.beside(solver, &observations.points, &pyramid.geometry(&cells));
        let mut lamps = find_lamps(solver.grid, nodes);
        let total: f32 = lamps.iter().map(Lamp::mean_flux).sum();
        lamps.retain(|lamp| lamp.mean_flux() >= LEAST_SHARE * total);
        let start = Discs::of(&lamps, solver.grid, nodes);
        if start.all.is_empty() {
            return None;
        }
        let on = Receivers {
            solver,
            grid: &grid,
            points: &observations.points,
        };
        let (start, regions) = start.in_regions(&on);
        let fitting = Fitting {
            on,
            radiance: &over_mean(&diffuse(&observations, magnitude)).1,
            beside: &beside,
            regions: &regions,
        };
        let (_, shaded) = fitting.fitted(&start, &pairs, Free::All);
        Some(Self::between(&start, &shaded))
    }

    fn between(shown: &Discs, shaded: &Discs) -> Self {
        let [of_shown, of_shaded] =
            [shown, shaded].map(|discs| discs.all.iter().map(|disc| disc.flux).sum::<f64>());
        let both = || shown.all.iter().zip(&shaded.all);
        let apart = both().map(|(a, b)| a.shape.middle().angle_between(b.shape.middle()));
        let elsewhere = both().map(|(a, b)| (a.flux / of_shown - b.flux / of_shaded).abs());
        Self {
            apart: apart.fold(0.0, f32::max),
            elsewhere: (0.5 * elsewhere.sum::<f64>()) as f32,
        }
    }

    /// Whether the two agree.
    pub fn is_close(&self) -> bool {
        self.apart < MOST_APART && self.elsewhere < MOST_ELSEWHERE
    }
}
