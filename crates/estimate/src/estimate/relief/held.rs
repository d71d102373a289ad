//! The surface under lights that have been found on it.

use super::equations::LinearRows;
use super::{POINTS, POINTS_ON_TRIAL, Relief, is_out};
use crate::estimate::fast::{Fit, Solver, Watch};
use crate::estimate::held_lights::HeldLights;
use crate::estimate::held_out::{CHANCE, common_noise};
use crate::estimate::observations::Observations;
use crate::estimate::observer::{Stopped, go_on};
use rekindle_base::math::ranks::signed_ranks;

/// What is reported of it.
const WHAT: &str = "refining the surface under the lights";

/// Steps under lights that are held.
const ROUNDS: usize = 3;

/// How many times less rows count than if each were wrong by itself: what lights and lobe get wrong, they get wrong of many rows together.
const STIFFNESSES: [f64; 3] = [1.0, 10.0, 100.0];

impl Relief {
    /// Moves the heights under lights that have been found on the present surface, which `solver` is of. Where nothing has moved
    /// them before, views that had no say have to be explained better by that, beyond chance. Whether they were moved.
    pub fn bend(
        &mut self,
        solver: &Solver<'_>,
        fit: &Fit,
        watch: &mut Watch<'_>,
    ) -> Result<bool, Stopped> {
        let light = HeldLights::of(solver, fit.brdf, &fit.nodes);
        let start = self.heights.clone();
        let is_proven = start.iter().any(|&height| height != 0.0);
        let stiffness = if is_proven {
            Some(STIFFNESSES[0])
        } else {
            self.best_stiffness(solver, &light, watch)?
        };
        let Some(stiffness) = stiffness else {
            return Ok(false);
        };
        let points = light.points(solver, POINTS);
        for _ in 0..ROUNDS {
            go_on(watch.observer.progress(WHAT, 0.6))?;
            let step = self.bent(solver, &light, points.clone(), stiffness);
            if step.is_none() {
                self.heights = start;
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The stiffness with which a step from some of the views explains the others best, if that is better than none does, beyond
    /// chance. The heights stay as they are.
    fn best_stiffness(
        &mut self,
        solver: &Solver<'_>,
        light: &HeldLights,
        watch: &mut Watch<'_>,
    ) -> Result<Option<f64>, Stopped> {
        let judging = light.points(solver, POINTS_ON_TRIAL);
        let telling = light.points(solver, POINTS).without_views(is_out).0;
        let before = self.left_out(solver, light, &judging);
        let start = self.heights.clone();
        let mut best: Option<(f64, f64, Vec<f64>)> = None;
        for stiffness in STIFFNESSES {
            go_on(watch.observer.progress(WHAT, 0.6))?;
            if self
                .bent(solver, light, telling.clone(), stiffness)
                .is_some()
            {
                let left = self.left_out(solver, light, &judging);
                let total: f64 = left.iter().sum();
                if best.as_ref().is_none_or(|(least, ..)| total < *least) {
                    best = Some((total, stiffness, left));
                }
            }
            self.heights.clone_from(&start);
        }
        let best = best.filter(|(_, _, left)| signed_ranks(&before, left) > CHANCE);
        Ok(best.map(|(_, stiffness, _)| stiffness))
    }

    /// A Gauss-Newton step of the heights alone, from points of the surface that `solver` is of.
    fn bent(
        &mut self,
        solver: &Solver<'_>,
        light: &HeldLights,
        mut points: Observations,
        stiffness: f64,
    ) -> Option<()> {
        self.turn(&mut points);
        let design = solver.shadowed_design(&points, &light.cells, &light.brdf);
        let mut rows = LinearRows::new(&design, (&light.brdf, &light.radiance), Vec::new());
        for weight in &mut rows.weights {
            *weight /= stiffness;
        }
        self.moved(&points, &rows).map(|_| ())
    }

    /// What some points of the surface that `solver` is of leave, with the present normals, of the views that are out.
    fn left_out(&self, solver: &Solver<'_>, light: &HeldLights, points: &Observations) -> Vec<f64> {
        let noise = common_noise(&solver.design(points, &[]));
        let mut points = points.clone();
        self.turn(&mut points);
        let left = light.left_out(solver, &points, noise, [is_out]);
        left.iter().map(|left| left.lit).collect()
    }
}
