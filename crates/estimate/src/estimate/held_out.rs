//! Is there gloss at all? Lights found in some views have to explain others.
//!
//! Some lights always explain something: noise, texture that is out of place, views that differ in exposure. But they say
//! nothing of a view that had no say in them, while true ones show in it what the others don't: that is what they are for.

use std::ops::Range;

use rayon::prelude::*;

use super::cells::Cell;
use super::design::Design;
use super::fast::{CoarseFit, Solver};
use super::observations::Observations;
use super::state::{ROUGH, State};
use super::weights::{deviation, magnitude};
use rekindle_base::math::ranks::{SURE, signed_ranks};
use rekindle_scene::reflectance::Brdf;

/// Views are left out in so many turns at most.
const MOST_TURNS: usize = 6;
/// What chance exceeds in one case of twenty, in standard deviations.
pub const CHANCE: f64 = 1.645;
/// Points that are looked at: many, as most show no highlight.
const POINTS: usize = 4000;

/// Whether the lobe of a coarse fit predicts views that had no say in the lights better than diffuse colours alone do, beyond
/// chance.
pub fn shows_gloss(solver: &Solver<'_>, fit: &CoarseFit<'_>) -> bool {
    let [dark, lit] = left_out(solver, &fit.state);
    signed_ranks(&dark, &lit) > SURE
}

/// Whether the lobe of one state on its cells, with its solver, predicts such views better than another's by more than
/// chance does in one case of twenty.
pub fn predicts_better(
    (solver, fit): (&Solver<'_>, &State<'_>),
    other: (&Solver<'_>, &State<'_>),
) -> bool {
    let [[_, lit], [_, by_other]] = [(solver, fit), other].map(|(s, f)| left_out(s, f));
    signed_ranks(&by_other, &lit) > CHANCE
}

/// What is left at each of many points in views that had no say, in standard deviations of noise: by diffuse colours alone, and
/// with lights.
fn left_out(solver: &Solver<'_>, fit: &State<'_>) -> [Vec<f64>; 2] {
    let turns = solver.seen.views.len().min(MOST_TURNS);
    let points = solver.colours(POINTS).to_gray();
    let of_turns: Vec<Vec<[f64; 2]>> = (0..turns)
        .into_par_iter()
        .map(|turn| {
            let is_out = |view| view % turns == turn;
            let (others, _) = points.without_views(is_out);
            let designs = [&others, &points].map(|points| solver.design(points, &fit.cells));
            left_in(designs, &fit.cells, fit.brdf, is_out)
        })
        .collect();
    [0, 1].map(|which| {
        let points = 0..points.points.len();
        let of = |i: usize| of_turns.iter().map(|left| left[i][which]).sum();
        points.map(of).collect()
    })
}

/// What is left at each point in the views that `is_out` leaves out, in standard deviations of noise: by diffuse colours alone,
/// and with the lights that the other views say on some cells. The designs are of the rows of the others and of all.
pub fn left_in(
    [others, all]: [Design<'_>; 2],
    cells: &[Cell],
    brdf: Brdf,
    is_out: impl Fn(usize) -> bool,
) -> Vec<[f64; 2]> {
    let mut fitted = State::new(others, cells.to_vec(), brdf);
    fitted.solve_lights(ROUGH);
    fitted.reweight();
    fitted.solve_lights(ROUGH);
    let Observations { points, rows, .. } = all.observations;
    let judged = fitted.judged_on(all, |k| !is_out(rows[k].view));
    // What all explanations have in common: their own noise would favour those that explain little.
    let noise = fitted.dark_residuals().noise.max(f32::MIN_POSITIVE);
    let dark = judged.dark_residuals();
    let of_point = |own: Range<usize>| {
        let (out, kept): (Vec<usize>, Vec<usize>) = own.partition(|&k| is_out(rows[k].view));
        if kept.is_empty() {
            // Nothing says what its diffuse colour is.
            return [0.0; 2];
        }
        [&dark, &judged.residuals].map(|residuals| {
            let whitened = |&k: &usize| {
                let noise = deviation(noise, rows[k].detail);
                f64::from(magnitude(residuals.values[k]) / noise)
            };
            out.iter().map(whitened).sum()
        })
    };
    let own = points.iter().map(|point| point.rows.clone());
    own.map(of_point).collect()
}
