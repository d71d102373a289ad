//! Gloss that mirrors broad light only.
//!
//! A window, a sky or a room has no highlights that stand out: few lights, each as strong as the photographs allow, explain such a surface
//! worse than none, as each is fitted to what the surface and the cameras are off by. But broad light differs little from one direction to
//! the next. So light x ≥ 0 on cells all around is sought as the minimum of
//!
//! `Σ w (y − t D − A x)² + λ Σ (xᵢ − xⱼ)²`
//!
//! the diffuse colours D eliminated, where the roughness and λ are what explains views best that had no say. There is such gloss if it explains
//! them better than diffuse colours do, beyond chance. A view left out has an exposure of its own under either: those that views were evened
//! out by are what diffuse colours alone say.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use glam::Vec3;
use rayon::prelude::*;

use super::SpecularChoice;
use super::below::AllAround;
use super::broad_light::{FREQUENCY, smooth_nodes};
use super::cells::Cell;
use super::course::{Ending, Grounds};
use super::design::Design;
use super::fast::{Fit, Solver, Watch};
use super::held_lights::HeldLights;
use super::held_out::{CHANCE, common_noise, in_noise};
use super::misfit::Misfit;
use super::observations::{Observations, Point};
use super::observer::{Stopped, go_on};
use super::relief::Bench;
use super::state::{ROUGH, State};
use super::weights::{Residuals, dark_residuals};
use rekindle_base::math::median;
use rekindle_base::math::ranks::placed_signed_ranks;
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// Points that are looked at.
const POINTS: usize = 3000;
/// Roughnesses that are tried, radians.
const ROUGHNESSES: [f32; 7] = [0.03, 0.05, 0.08, 0.13, 0.2, 0.32, 0.5];
/// How much cells are held to their neighbours, as parts of the mean diagonal of the equations.
const SMOOTHNESS: [f64; 5] = [1e-3, 1e-2, 0.1, 1.0, 10.0];
/// Views are left out in so many turns at most, and where it is only asked how rough.
const MOST_TURNS: usize = 6;
const ROUGH_TURNS: usize = 3;
/// Frequency of the grid of the cells on which it is asked how rough: 1442 of them, 5° apart.
const FINE_FREQUENCY: u32 = 12;
/// Rounds in which weights and light take turns.
const ROUNDS: usize = 3;
/// A predicted radiance below this part of the mean says nothing of an exposure.
const DARK: f32 = 0.1;

/// Why the lobe is what it is.
const BECAUSE: &str = "under broad light it explains views left out best";
/// Without gloss, as much of its diffuse part leaves a surface towards all sides.
const MATTE: Brdf = Brdf::new(SpecularModel::Paper, 1.0);

/// What light and colours leave of views left out at a point: without gloss and with it.
#[derive(Clone, Copy, Debug)]
struct Left {
    pixel: (usize, u32, u32),
    place: Vec3,
    dark: f64,
    lit: f64,
}

/// A lobe and how smooth its light is, with what they leave at each point.
struct Tried {
    brdf: Brdf,
    smoothness: f64,
    left: Vec<Left>,
}

impl Tried {
    fn total(&self) -> f64 {
        self.left.iter().map(|at| at.lit).sum()
    }

    /// By how many standard deviations of chance diffuse colours alone leave more.
    fn gain(&self) -> f64 {
        let pairs = self.left.iter().map(|at| (at.place, at.dark, at.lit));
        placed_signed_ranks(&pairs.collect::<Vec<_>>())
    }

    /// By how many standard deviations of chance others leave more, at pixels that show both.
    fn gain_over(&self, others: &[Left]) -> f64 {
        let of_others: BTreeMap<_, f64> = others.iter().map(|at| (at.pixel, at.lit)).collect();
        let pair = |at: &Left| Some((at.place, *of_others.get(&at.pixel)?, at.lit));
        placed_signed_ranks(&self.left.iter().filter_map(pair).collect::<Vec<_>>())
    }
}

/// Gloss under broad light, where views left out show it beyond chance.
pub fn found(
    solver: &Solver<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    told(solver, choice, watch, |best| best.gain() > CHANCE)
}

/// The same on the surface of what has been found, where it explains views left out better than that does, beyond chance.
pub fn bettered(
    solver: &Solver<'_>,
    ending: &Ending,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    let refined = ending.refined.as_ref();
    let bench = refined.map(|on| (Bench::new(&on.mesh, solver.seen.views), on));
    let bench = bench.as_ref();
    let refined_solver = bench.map(|(bench, on)| bench.solver(solver, &on.mesh));
    let solver = refined_solver.as_ref().unwrap_or(solver);
    let soft = told(solver, choice, watch, |best| {
        best.gain() > CHANCE && best.gain_over(&left_by_lights(solver, &ending.fit)) > CHANCE
    })?;
    Ok(soft.map(|soft| Ending {
        refined: refined.cloned(),
        ..soft
    }))
}

/// The gloss under broad light that explains views left out best, if that is to be taken.
fn told(
    solver: &Solver<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
    is_taken: impl FnOnce(&Tried) -> bool,
) -> Result<Option<Ending>, Stopped> {
    go_on(watch.observer.progress("looking for broad light", 0.5))?;
    let around = AllAround::on_cells_of(solver, FREQUENCY);
    let whole = around.solver(solver);
    let first = tried(&whole, choice, &SMOOTHNESS, MOST_TURNS);
    if solver.stop.load(Ordering::Relaxed) {
        return Err(Stopped);
    }
    let Some(best) = best(&first).filter(|best| is_taken(best)) else {
        return Ok(None);
    };
    // Cells that are wide beside a lobe prefer a wider one.
    go_on(watch.observer.progress("comparing roughnesses", 0.7))?;
    let around = AllAround::on_cells_of(solver, FINE_FREQUENCY);
    let whole = around.solver(solver);
    let tried = tried(&whole, choice, &[best.smoothness], ROUGH_TURNS);
    if solver.stop.load(Ordering::Relaxed) {
        return Err(Stopped);
    }
    let Some((best, roughest)) = middle(&tried) else {
        return Ok(None);
    };
    let cells = whole.pyramid.roots();
    let observations = whole.colours(POINTS);
    let design = whole.shadowed_design(&observations, &cells, &best.brdf);
    let mut state = State::new(design, cells.clone(), best.brdf);
    let joined = whole.pyramid.joined(&cells);
    light_in_rounds(&mut state, Some((&joined, best.smoothness)), |_| true);
    let nodes = smooth_nodes(&whole, &cells, &state.radiance);
    Ok(Some(Ending {
        fit: Fit {
            brdf: best.brdf,
            nodes,
            sigma_error: 0.0,
            noise_error: 0.0,
            misfit: Misfit::of(&state),
            parts: None,
        },
        because: BECAUSE.to_owned(),
        refined: None,
        suspicion: None,
        bound: Some(roughest),
        allowed: [1.0; 2],
        grid: whole.grid.clone(),
        grounds: Grounds::BroadLight,
        agreement: None,
    }))
}

/// What leaves least of views left out.
fn best(tried: &[Tried]) -> Option<&Tried> {
    tried.iter().min_by(|a, b| a.total().total_cmp(&b.total()))
}

/// The middle one of the lobes that explain views left out no worse than the best does, beyond chance, and the roughest σ of these, radians.
fn middle(tried: &[Tried]) -> Option<(&Tried, f32)> {
    let best = best(tried)?;
    let mut as_good: Vec<&Tried> = (tried.iter())
        .filter(|other| best.gain_over(&other.left) <= CHANCE)
        .collect();
    as_good.sort_by(|a, b| a.brdf.sigma.total_cmp(&b.brdf.sigma));
    let roughest = as_good.last()?.brdf.sigma;
    Some((as_good[(as_good.len() - 1) / 2], roughest))
}

/// What each lobe leaves with light on the coarsest cells, at each of some smoothnesses, where views are left out in so many turns.
fn tried(
    whole: &Solver<'_>,
    choice: SpecularChoice,
    smoothnesses: &[f64],
    turns: usize,
) -> Vec<Tried> {
    let gray = whole.colours(POINTS).to_gray();
    let cells = whole.pyramid.roots();
    let joined = whole.pyramid.joined(&cells);
    let widest = Brdf::new(SpecularModel::Ggx, ROUGHNESSES[ROUGHNESSES.len() - 1]);
    let design = whole.shadowed_design(&gray, &cells, &widest);
    let units = in_noise(&design, common_noise(&design));
    let sigmas = (whole.sigma).map_or_else(|| ROUGHNESSES.to_vec(), |stated| vec![stated]);
    let models = choice.or(&[SpecularModel::Ggx]);
    let lobe = |&model| {
        let at = move |&sigma: &f32| Brdf::new(model, sigma);
        sigmas.iter().map(at).collect::<Vec<_>>()
    };
    let lobes: Vec<Brdf> = models.iter().flat_map(lobe).collect();
    let held: Vec<Smoothness<'_>> = (smoothnesses.iter())
        .map(|&smoothness| Some((&joined[..], smoothness)))
        .collect();
    let views = (whole.seen.views.len(), turns);
    let of = |&brdf: &Brdf| {
        let left = left_out((&design, &units), (&cells, brdf), &held, views);
        let tried = smoothnesses.iter().zip(left);
        tried.map(move |(&smoothness, left)| Tried {
            brdf,
            smoothness,
            left,
        })
    };
    lobes.par_iter().flat_map_iter(of).collect()
}

/// What the lights that were found leave, each of them as strong as the views that have a say have it.
fn left_by_lights(solver: &Solver<'_>, fit: &Fit) -> Vec<Left> {
    let around = AllAround::of(solver);
    let whole = around.solver(solver);
    let parted = fit.parts.as_ref().map(|parts| whole.parted(parts));
    let whole = parted.as_ref().unwrap_or(&whole);
    let mut nodes = fit.nodes.clone();
    nodes.resize(whole.grid.directions.len(), [0.0; 3]);
    let HeldLights { cells, brdf, .. } = HeldLights::of(whole, fit.brdf, &nodes);
    let gray = whole.colours(POINTS).to_gray();
    let design = whole.shadowed_design(&gray, &cells, &brdf);
    let units = in_noise(&design, common_noise(&design));
    let views = (whole.seen.views.len(), MOST_TURNS);
    let left = left_out((&design, &units), (&cells, brdf), &[None], views);
    left.into_iter().flatten().collect()
}

/// Cells that are held to each other, and how much; see [`State::solve_lights_smoothly`].
type Smoothness<'j> = Option<(&'j [[usize; 2]], f64)>;

/// What a lobe on some cells leaves, held together in several ways, summed over turns in each of which some of the views have no say.
fn left_out(
    (design, units): (&Design<'_>, &[f32]),
    (cells, brdf): (&[Cell], Brdf),
    held: &[Smoothness<'_>],
    (views, most_turns): (usize, usize),
) -> Vec<Vec<Left>> {
    let Observations { points, rows, .. } = design.observations;
    let turns = views.min(most_turns);
    let of_turn = |turn: usize| -> Vec<Vec<(f64, f64)>> {
        let is_out = |view: usize| view % turns == turn;
        let tells = |k: usize| !is_out(rows[k].view);
        let mut state = State::new(design.clone(), cells.to_vec(), brdf);
        light_in_rounds(&mut state, held[held.len() / 2], tells);
        state.reweight();
        state.silence(tells);
        let mut judged = State::new(design.clone(), cells.to_vec(), brdf);
        judged.silence(tells);
        let out: Vec<usize> = (0..views).filter(|&view| is_out(view)).collect();
        let colours = dark_residuals(design, &MATTE, &judged.weights);
        let dark = left_by(design, &colours, units, &out);
        let of = |&held: &Smoothness<'_>| {
            light(&mut state, held);
            judged.light_as(&state);
            let lit = left_by(design, &judged.residuals, units, &out);
            dark.iter().copied().zip(lit).collect()
        };
        held.iter().map(of).collect()
    };
    let of_turns: Vec<_> = (0..turns).into_par_iter().map(of_turn).collect();
    let of_held = |h: usize| -> Vec<Left> {
        let at = |(i, point): (usize, &Point)| {
            let sum =
                |of: fn(&(f64, f64)) -> f64| of_turns.iter().map(|turn| of(&turn[h][i])).sum();
            Left {
                pixel: point.pixel,
                place: point.position,
                dark: sum(|left| left.0),
                lit: sum(|left| left.1),
            }
        };
        points.iter().enumerate().map(at).collect()
    };
    (0..held.len()).map(of_held).collect()
}

/// Lets light and weights take turns, where only some rows tell.
fn light_in_rounds(state: &mut State<'_>, held: Smoothness<'_>, tells: impl Fn(usize) -> bool) {
    for round in 0..ROUNDS {
        if round > 0 {
            state.reweight();
        }
        state.silence(&tells);
        light(state, held);
    }
}

fn light(state: &mut State<'_>, held: Smoothness<'_>) {
    match held {
        Some((joined, smoothness)) => state.solve_lights_smoothly(joined, smoothness, ROUGH),
        None => state.solve_lights(ROUGH),
    }
}

/// What residuals of gray rows leave at each point in the views that are `out`, each of which has the exposure that leaves least there.
fn left_by(design: &Design<'_>, residuals: &Residuals, units: &[f32], out: &[usize]) -> Vec<f64> {
    let Observations { points, rows, .. } = design.observations;
    let is_told = |point: &Point| {
        let mut own = point.rows.clone();
        own.any(|k| !out.contains(&rows[k].view) && !rows[k].is_bound)
    };
    let told: Vec<bool> = points.iter().map(is_told).collect();
    let mut left = vec![0.0; points.len()];
    for view in out {
        let row_in = |point: &Point| point.rows.clone().find(|&k| rows[k].view == *view);
        let seen: Vec<(usize, usize)> = (points.iter().enumerate())
            .filter(|&(i, _)| told[i])
            .filter_map(|(i, point)| Some((i, row_in(point)?)))
            .collect();
        let measured = |k: usize| rows[k].radiance[0];
        let predicted = |k: usize| measured(k) - residuals.values[k][0];
        let tells = |k: usize| !rows[k].is_bound && predicted(k) > DARK;
        let ratio = |k: usize| f64::from(measured(k) / predicted(k));
        let told = seen.iter().filter(|(_, k)| tells(*k));
        let mut ratios: Vec<f64> = told.map(|(_, k)| ratio(*k)).collect();
        let exposure = median(&mut ratios).unwrap_or(1.0) as f32;
        for (i, k) in seen {
            let lacking = measured(k) - exposure * predicted(k);
            let lacking = if rows[k].is_bound {
                lacking.max(0.0)
            } else {
                lacking.abs()
            };
            left[i] += f64::from(lacking / units[k]);
        }
    }
    left
}
