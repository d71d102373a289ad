//! Is there gloss at all? Lights found in some views have to explain others.
//!
//! Some lights always explain something: noise, texture that is out of place, views that differ in exposure. But they say
//! nothing of a view that had no say in them, while true ones show in it what the others don't: that is what they are for.

use std::collections::BTreeMap;
use std::ops::{AddAssign, Range};

use glam::Vec3;
use rayon::prelude::*;

use super::cells::Cell;
use super::design::Design;
use super::fast::Solver;
use super::observations::{Observations, Point, Row};
use super::state::{Precision, ROUGH, State};
use super::weights::{Residuals, dark_residuals, deviation, initial_weights, magnitude};
use rekindle_base::math::ranks::{SURE, placed_signed_ranks, signed_ranks, weighted_signed_ranks};
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// Views are left out in so many turns at most.
const MOST_TURNS: usize = 6;
/// And in so many where it need not be known as well.
const ROUGH_TURNS: usize = 3;
/// What chance exceeds in one case of twenty, in standard deviations.
pub const CHANCE: f64 = 1.645;
/// Points that are looked at: many, as most show no highlight.
const POINTS: usize = 8000;
/// Fewest of them that say roughly what lights there are.
const ENOUGH: usize = 2000;
/// Prices of light that are tried, in standard deviations of the residuals; see [`Precision::price`]. Without any, cells by the
/// hundred are lit by what the model leaves out, and drown the few lights that there are.
const PRICES: [f64; 4] = [16.0, 8.0, 4.0, 2.0];
/// Roughnesses that are tried, radians.
pub const ROUGHNESSES: [f32; 5] = [0.03, 0.05, 0.08, 0.13, 0.2];
/// A point's radiance below which what is left there is not compared with it but with this, as a part of the mean radiance.
const DARK: f32 = 0.1;
/// Standard deviations of noise by which explanations differ at a point that can tell between them.
const TELLING: f64 = 1.0;

/// What explanations leave at a point in the views that had no say, in some unit of each row, summed over its rows.
#[derive(Clone, Copy, Default)]
pub struct Left {
    /// By diffuse colours alone.
    pub dark: f64,
    /// With lights.
    pub lit: f64,
    /// What the lights change.
    pub shown: f64,
}

impl AddAssign for Left {
    fn add_assign(&mut self, other: Self) {
        self.dark += other.dark;
        self.lit += other.lit;
        self.shown += other.shown;
    }
}

/// What an explanation leaves at one of a surface's points.
#[derive(Clone, Copy, Debug)]
pub struct LeftAt {
    /// See [`Point::pixel`].
    pub pixel: (usize, u32, u32),
    /// See [`Point::position`].
    pub position: Vec3,
    /// How much.
    pub left: f64,
}

/// Whether what lights leave of views that had no say in them is less than what diffuse colours alone do, beyond chance.
pub fn shows_gloss(left: &[Left]) -> bool {
    let column = |of: fn(&Left) -> f64| -> Vec<f64> { left.iter().map(of).collect() };
    // At all points, as gloss that is everywhere shows on all sides.
    signed_ranks(&column(|l| l.dark), &column(|l| l.lit)) > SURE
}

/// Whether one explanation leaves less of such views than another by more than chance does in one case of twenty; each at the same
/// points.
pub fn predicts_better(own: &[Left], others: &[Left]) -> bool {
    let pairs = others.iter().zip(own);
    is_less(pairs.map(|(other, own)| (other.shown.max(own.shown), other.lit, own.lit))) > CHANCE
}

/// By how many standard deviations of chance lights leave less of such views than diffuse colours alone do, at the points that can tell.
pub fn gain(left: &[Left]) -> f64 {
    is_less(left.iter().map(|left| (left.shown, left.dark, left.lit)))
}

/// By how many standard deviations of chance the third of some values is less than the second, at points that can tell: where the
/// first, what explanations differ by, is more than noise.
fn is_less(values: impl Iterator<Item = (f64, f64, f64)>) -> f64 {
    let telling: Vec<_> = values.filter(|(shown, ..)| *shown > TELLING).collect();
    let column = |of: fn(&(f64, f64, f64)) -> f64| -> Vec<f64> { telling.iter().map(of).collect() };
    weighted_signed_ranks(&column(|v| v.0), &column(|v| v.1), &column(|v| v.2))
}

/// What the lobe of a state on its cells leaves at each of many points in views that had no say, in standard deviations of noise, at
/// the price of light that leaves least.
pub fn left_out(solver: &Solver<'_>, fit: &State<'_>) -> Vec<Left> {
    let turns = solver.seen.views.len().min(MOST_TURNS);
    let points = solver.colours(POINTS).to_gray();
    // What the object mirrors of itself is no light: it is where none comes past it.
    let design = solver.shadowed_design(&points, &fit.cells, &fit.brdf);
    let units = in_noise(&design, common_noise(&design));
    of_turns(&design, fit, &units, turns).1
}

/// What the lobe of a state on its cells leaves at each point of a design, summed over turns in each of which some of the views have no
/// say, at the price of light that leaves least, which is told.
fn of_turns(design: &Design<'_>, fit: &State<'_>, units: &[f32], turns: usize) -> (f64, Vec<Left>) {
    let of_turns: Vec<Vec<Vec<Left>>> = (0..turns)
        .into_par_iter()
        .map(|turn| {
            let is_out = |view| view % turns == turn;
            left_in(design, &fit.cells, fit.brdf, units, &PRICES, is_out)
        })
        .collect();
    let of_price = |price: usize| -> Vec<Left> {
        let sum = |i: usize| {
            of_turns.iter().fold(Left::default(), |mut sum, turn| {
                sum += turn[price][i];
                sum
            })
        };
        (0..design.observations.points.len()).map(sum).collect()
    };
    let of_prices = (0..PRICES.len()).map(|price| (PRICES[price], of_price(price)));
    let best = of_prices.min_by(|(_, a), (_, b)| total(a).total_cmp(&total(b)));
    best.unwrap_or_default()
}

/// What lights leave at all points.
fn total(left: &[Left]) -> f64 {
    left.iter().map(|left| left.lit).sum()
}

/// The lights of a lobe on the coarsest cells at the price at which others that views say explain those that had no say best, and what they
/// leave of these, in standard deviations of noise: fewer than explain all views best, of which some hundreds only stand for what the
/// lobe leaves out.
pub fn sparse<'s>(solver: &'s Solver<'_>, brdf: Brdf) -> (f64, State<'s>) {
    let mut state = solver.dark_roots(brdf);
    let units = in_noise(&state.design, common_noise(&state.design));
    let turns = solver.seen.views.len().min(MOST_TURNS);
    let (price, left) = of_turns(&state.design, &state, &units, turns);
    state.solve_lights(ROUGH);
    state.reweight();
    let deviation = f64::from(state.rms());
    state.solve_lights(Precision {
        price: price * deviation,
        ..ROUGH
    });
    (total(&left), state)
}

/// What is left at each point of a design in the views that `is_out` leaves out, with the lights that the other views say on some
/// cells, for each of some prices of light; in `units`, one a row.
pub fn left_in(
    design: &Design<'_>,
    cells: &[Cell],
    brdf: Brdf,
    units: &[f32],
    prices: &[f64],
    is_out: impl Fn(usize) -> bool,
) -> Vec<Vec<Left>> {
    let rows = &design.observations.rows;
    let tells = |k: usize| !is_out(rows[k].view);
    let mut fitted = State::new(design.clone(), cells.to_vec(), brdf);
    fitted.silence(tells);
    fitted.light_by(&lights_of_some(design, cells, brdf, &is_out));
    // At a price there is less light than those have found without any.
    fitted.keep_to_lit();
    fitted.reweight();
    fitted.silence(tells);
    let deviation = f64::from(fitted.rms());
    let mut judged = State::new(design.clone(), cells.to_vec(), brdf);
    judged.silence(tells);
    let dark = judged.dark_residuals();
    let of_price = |price: &f64| {
        fitted.solve_candidates(Precision {
            price: price * deviation,
            ..ROUGH
        });
        judged.light_as(&fitted);
        left_by(&judged, &dark, units, &is_out)
    };
    prices.iter().map(of_price).collect()
}

/// The lights that the views that are not out say at every so many-th point: enough to see which rows are odd.
fn lights_of_some(
    design: &Design<'_>,
    cells: &[Cell],
    brdf: Brdf,
    is_out: impl Fn(usize) -> bool,
) -> Vec<[f32; 3]> {
    let all = design.observations;
    let step = (all.points.len() / ENOUGH).max(1);
    let observations = all.every(step, 0);
    let points = (0..all.points.len()).step_by(step);
    let seen = if all.rows.iter().any(|row| row.placed.is_some()) {
        let rows = points.flat_map(|point| all.points[point].rows.clone());
        design.seen.seen_from(rows)
    } else {
        design.seen.seen_from(points)
    };
    let design = Design {
        observations: &observations,
        seen,
        ..design.clone()
    };
    let mut some = State::new(design, cells.to_vec(), brdf);
    some.silence(|k| !is_out(observations.rows[k].view));
    some.solve_lights(ROUGH);
    some.radiance
}

/// What is left at each point of a design in the views that `is_out` leaves out, under lights that are held: the others say nothing
/// but the points' diffuse colours.
pub fn left_under(
    design: &Design<'_>,
    cells: &[Cell],
    (brdf, radiance): (Brdf, &[[f32; 3]]),
    units: &[f32],
    is_out: impl Fn(usize) -> bool,
) -> Vec<Left> {
    let mut judged = State::new(design.clone(), cells.to_vec(), brdf);
    judged.silence(|k| !is_out(design.observations.rows[k].view));
    judged.light_by(radiance);
    left_by(&judged, &judged.dark_residuals(), units, is_out)
}

/// The one of [`ROUGHNESSES`] that a roughness is next to.
pub fn nearest_roughness(sigma: f32) -> f32 {
    let away = |of: &f32| (sigma / of).ln().abs();
    let nearest = ROUGHNESSES
        .into_iter()
        .min_by(|a, b| away(a).total_cmp(&away(b)));
    nearest.unwrap_or(sigma)
}

/// What a lobe of a model leaves in views that had no say, at the one of a few roughnesses with which others explain these best, or the
/// one that is stated.
pub fn at_best_roughness(solver: &Solver<'_>, model: SpecularModel) -> (f32, Vec<LeftAt>) {
    let of = |&sigma: &f32| {
        let fit = solver.dark_roots(Brdf::new(model, sigma));
        (sigma, roughly_left_out(solver, &fit))
    };
    let sigmas = solver
        .sigma
        .map_or_else(|| ROUGHNESSES.to_vec(), |stated| vec![stated]);
    let tried: Vec<(f32, Vec<LeftAt>)> = sigmas.par_iter().map(of).collect();
    let total = |left: &[LeftAt]| left.iter().map(|at| at.left).sum::<f64>();
    let best = tried
        .into_iter()
        .min_by(|(_, a), (_, b)| total(a).total_cmp(&total(b)));
    best.unwrap_or((ROUGHNESSES[0], Vec::new()))
}

/// What the lobe of a coarse fit leaves in views that had no say at each of its points: as a part of what diffuse colours alone leave at
/// all of them.
pub fn roughly_left_out(solver: &Solver<'_>, fit: &State<'_>) -> Vec<LeftAt> {
    let design = solver.coarse_design(&solver.coarse);
    let units = in_noise(&design, common_noise(&design));
    let (_, left) = of_turns(&design, fit, &units, ROUGH_TURNS);
    let dark = left.iter().map(|left| left.dark).sum::<f64>();
    let at = |(point, left): (&Point, Left)| LeftAt {
        pixel: point.pixel,
        position: point.position,
        left: left.lit / dark.max(f64::MIN_POSITIVE),
    };
    solver.coarse.points.iter().zip(left).map(at).collect()
}

/// By how many standard deviations of chance the second of two surfaces leaves less than the first, at pixels that show both.
pub fn leaves_less(first: &[LeftAt], second: &[LeftAt]) -> f64 {
    let of_second: BTreeMap<_, f64> = second.iter().map(|at| (at.pixel, at.left)).collect();
    let both = first.iter().filter_map(|at| {
        let second = of_second.get(&at.pixel)?;
        Some((at.position, at.left, *second))
    });
    placed_signed_ranks(&both.collect::<Vec<_>>())
}

/// What the lobe of a coarse fit leaves in such views as parts of the mean radiance of each of its points: so it means the same where
/// photographs differ by factors.
pub fn relatively_left_out(solver: &Solver<'_>, fit: &State<'_>) -> Vec<f64> {
    let design = solver.coarse_design(&solver.coarse);
    let (_, left) = of_turns(&design, fit, &in_radiance(&design), ROUGH_TURNS);
    left.iter().map(|left| left.lit).collect()
}

/// Noise of the rows of a design without lights and gloss, which all explanations have in common: their own would favour those that
/// explain little.
pub fn common_noise(design: &Design<'_>) -> f32 {
    let matte = Brdf::new(SpecularModel::Paper, 1.0);
    let dark = dark_residuals(design, &matte, &initial_weights(design));
    dark.noise.max(f32::MIN_POSITIVE)
}

/// Standard deviations of the rows of a design, with noise of that size.
pub fn in_noise(design: &Design<'_>, noise: f32) -> Vec<f32> {
    let rows = design.observations.rows.iter();
    rows.map(|row| deviation(noise, row.detail)).collect()
}

/// Mean radiance of the point that each row of a design is of.
fn in_radiance(design: &Design<'_>) -> Vec<f32> {
    let Observations { points, rows, .. } = design.observations;
    let mean = |own: &[Row]| {
        let sum: f32 = own.iter().map(|row| magnitude(row.radiance)).sum();
        (sum / own.len() as f32).max(DARK)
    };
    let of_points = points.iter().map(|point| &rows[point.rows.clone()]);
    of_points
        .flat_map(|own| std::iter::repeat_n(mean(own), own.len()))
        .collect()
}

/// What lights that others have said leave at each point in the views that `is_out` says.
fn left_by(
    judged: &State<'_>,
    dark: &Residuals,
    units: &[f32],
    is_out: impl Fn(usize) -> bool,
) -> Vec<Left> {
    let Observations { points, rows, .. } = judged.design.observations;
    let of_point = |own: Range<usize>| {
        let (out, kept): (Vec<usize>, Vec<usize>) = own.partition(|&k| is_out(rows[k].view));
        let mut left = Left::default();
        if kept.iter().all(|&k| rows[k].is_bound) {
            // Nothing says what its diffuse colour is.
            return left;
        }
        for k in out {
            let in_units = |value| f64::from(magnitude(value) / units[k]);
            let (by_dark, by_lit) = (dark.values[k], judged.residuals.values[k]);
            left.dark += in_units(by_dark);
            left.lit += in_units(by_lit);
            left.shown += in_units(std::array::from_fn(|c| by_dark[c] - by_lit[c]));
        }
        left
    };
    let own = points.iter().map(|point| point.rows.clone());
    own.map(of_point).collect()
}
