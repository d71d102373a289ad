//! Is there gloss at all? Lights found in some views have to explain others.
//!
//! Some lights always explain something: noise, texture that is out of place, views that differ in exposure. But they say
//! nothing of a view that had no say in them, while true ones show in it what the others don't: that is what they are for.

use std::ops::Range;

use rayon::prelude::*;

use super::fast::{CoarseFit, Solver};
use super::observations::Observations;
use super::state::{ROUGH, State};
use super::weights::{deviation, magnitude};
use rekindle_base::math::ranks::{SURE, signed_ranks};

/// Views are left out in so many turns at most.
const MOST_TURNS: usize = 6;
/// What chance does in one case of twenty, in standard deviations.
const CHANCE: f64 = 2.0;
/// Points that are looked at: many, as most show no highlight.
const POINTS: usize = 4000;

/// Whether the lobe of a coarse fit predicts views that had no say in the lights better than diffuse colours alone do, beyond
/// chance.
pub fn shows_gloss(solver: &Solver<'_>, fit: &CoarseFit<'_>) -> bool {
    let [dark, lit] = left_out(solver, fit);
    signed_ranks(&dark, &lit) > SURE
}

/// Whether one coarse fit, with its solver, predicts such views worse than another by more than two standard deviations of chance.
pub fn predicts_worse(
    (solver, fit): (&Solver<'_>, &CoarseFit<'_>),
    other: (&Solver<'_>, &CoarseFit<'_>),
) -> bool {
    let [[_, lit], [_, by_other]] = [(solver, fit), other].map(|(s, f)| left_out(s, f));
    signed_ranks(&lit, &by_other) > CHANCE
}

/// What is left at each of many points in views that had no say, in standard deviations of noise: by diffuse colours alone, and
/// with lights.
fn left_out(solver: &Solver<'_>, fit: &CoarseFit<'_>) -> [Vec<f64>; 2] {
    let turns = solver.seen.views.len().min(MOST_TURNS);
    let points = solver.colours(POINTS).to_gray();
    let of_turns: Vec<Vec<[f64; 2]>> = (0..turns)
        .into_par_iter()
        .map(|turn| left_in(solver, &points, &fit.state, |view| view % turns == turn))
        .collect();
    [0, 1].map(|which| {
        let points = 0..points.points.len();
        let of = |i: usize| of_turns.iter().map(|left| left[i][which]).sum();
        points.map(of).collect()
    })
}

/// What is left at each point in the views that `is_out` leaves out, in standard deviations of noise: by diffuse colours alone,
/// and with the lights of the other views.
fn left_in(
    solver: &Solver<'_>,
    all: &Observations,
    fit: &State<'_>,
    is_out: impl Fn(usize) -> bool,
) -> Vec<[f64; 2]> {
    let (others, _) = all.without_views(&is_out);
    let on = |observations| {
        State::new(
            solver.design(observations, &fit.cells),
            fit.cells.clone(),
            fit.brdf,
        )
    };
    let mut fitted = on(&others);
    fitted.solve_lights(ROUGH);
    fitted.reweight();
    fitted.solve_lights(ROUGH);
    let judged = fitted.judged_on(solver.design(all, &fit.cells), |k| {
        !is_out(all.rows[k].view)
    });
    let noise = fitted.residuals.noise.max(f32::MIN_POSITIVE);
    let dark = judged.dark_residuals();
    let of_point = |rows: Range<usize>| {
        let (out, kept): (Vec<usize>, Vec<usize>) = rows.partition(|&k| is_out(all.rows[k].view));
        if kept.is_empty() {
            // Nothing says what its diffuse colour is.
            return [0.0; 2];
        }
        [&dark, &judged.residuals].map(|residuals| {
            let whitened = |&k: &usize| {
                let noise = deviation(noise, all.rows[k].detail);
                f64::from(magnitude(residuals.values[k]) / noise)
            };
            out.iter().map(whitened).sum()
        })
    };
    let points = all.points.iter();
    points.map(|point| of_point(point.rows.clone())).collect()
}
