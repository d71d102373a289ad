//! What lobes with smooth light, alone or beside lights that were found, leave of views that had no say in it.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use rayon::prelude::*;

use super::super::cells::Cell;
use super::super::design::Design;
use super::super::fast::Solver;
use super::super::held_lights::HeldLights;
use super::super::held_out::{LeftAt, common_noise, in_noise};
use super::super::observations::{Observations, Point};
use super::super::observer::Stopped;
use super::super::state::{ROUGH, State};
use super::super::weights::{Residuals, dark_residuals};
use rekindle_base::math::median;
use rekindle_base::math::ranks::placed_signed_ranks;
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::surface::GlossParts;

/// Points that are looked at.
pub const POINTS: usize = 3000;
/// Rounds in which weights and light take turns.
const ROUNDS: usize = 3;
/// A predicted radiance below this part of the mean says nothing of an exposure.
const DARK: f32 = 0.1;

/// Without gloss, as much of its diffuse part leaves a surface towards all sides.
const MATTE: Brdf = Brdf::new(SpecularModel::Paper, 1.0);

pub fn total(left: &[LeftAt]) -> f64 {
    left.iter().map(|at| at.left).sum()
}

/// A lobe and how smooth its light is, with what they leave of views left out.
pub struct Tried {
    pub brdf: Brdf,
    pub smoothness: f64,
    pub left: Vec<LeftAt>,
    /// What diffuse colours alone leave at the same points.
    dark: Arc<[f64]>,
}

impl Tried {
    /// By how many standard deviations of chance diffuse colours alone leave more.
    pub fn gain(&self) -> f64 {
        let both = self.left.iter().zip(&self.dark[..]);
        let pairs = both.map(|(at, &dark)| (at.position, dark, at.left));
        placed_signed_ranks(&pairs.collect::<Vec<_>>())
    }
}

/// Cells that are held to each other, and how much; see [`State::solve_lights_smoothly`].
pub type Smoothness<'j> = Option<(&'j [[usize; 2]], f64)>;

/// Gray points and the cells on which lobes compete: those of lights that were found, if there are any, and after them the coarsest ones all
/// around, of which neighbours are joined.
pub struct Board<'s> {
    pub whole: &'s Solver<'s>,
    gray: Observations,
    pub cells: Vec<Cell>,
    pub joined: Vec<[usize; 2]>,
    /// So many cells are those of lights.
    pub lights: usize,
    /// Standard deviations of the rows.
    units: Vec<f32>,
}

/// Turns in each of which some of the views have no say.
#[derive(Clone, Copy)]
pub struct Turns<'w> {
    pub views: usize,
    pub count: usize,
    /// The weight of each row in each turn, where that is known.
    pub weights: Option<&'w [Vec<f32>]>,
}

impl Turns<'_> {
    /// So many at most of all views.
    pub fn of(solver: &Solver<'_>, most: usize) -> Self {
        let views = solver.seen.views.len();
        Self {
            views,
            count: views.min(most),
            weights: None,
        }
    }

    /// Whether a view has no say in one of them.
    fn is_out(self, turn: usize, view: usize) -> bool {
        view % self.count == turn
    }
}

impl<'s> Board<'s> {
    pub fn of(whole: &'s Solver<'s>) -> Self {
        let gray = whole.colours(POINTS).to_gray();
        let cells = whole.pyramid.roots();
        let design = whole.design(&gray, &cells);
        let units = in_noise(&design, common_noise(&design));
        Self {
            whole,
            joined: whole.pyramid.joined(&cells),
            cells,
            lights: 0,
            gray,
            units,
        }
    }

    /// The same points with a solver's own cells.
    pub fn on<'o>(self, whole: &'o Solver<'o>) -> Board<'o> {
        let cells = whole.pyramid.roots();
        Board {
            whole,
            joined: whole.pyramid.joined(&cells),
            cells,
            lights: 0,
            gray: self.gray,
            units: self.units,
        }
    }

    /// The same with the cells of lights as well, on a surface of parts with glosses of their own where there are such.
    pub fn beside(&self, lights: &HeldLights, parts: Option<&GlossParts>) -> Self {
        let count = lights.cells.len();
        let parted = parts.map(|parts| self.gray.of_parts(parts));
        let joined = self.joined.iter();
        Self {
            whole: self.whole,
            gray: parted.unwrap_or_else(|| self.gray.clone()),
            cells: [&lights.cells[..], &self.cells].concat(),
            joined: joined.map(|[i, j]| [count + i, count + j]).collect(),
            lights: count,
            units: self.units.clone(),
        }
    }

    pub fn go_on(&self) -> Result<(), Stopped> {
        if self.whole.stop.load(Ordering::Relaxed) {
            Err(Stopped)
        } else {
            Ok(())
        }
    }

    /// What each of some lobes leaves at each of some smoothnesses.
    pub fn tried(&self, lobes: &[Brdf], smoothnesses: &[f64], turns: Turns<'_>) -> Vec<Tried> {
        let widest = lobes.iter().map(|brdf| brdf.sigma).fold(0.0, f32::max);
        let asked = self.asked(Brdf::new(SpecularModel::Ggx, widest));
        let held: Vec<Smoothness<'_>> = (smoothnesses.iter())
            .map(|&smoothness| Some((&self.joined[..], smoothness)))
            .collect();
        let of = |&brdf: &Brdf| {
            let (dark, left) = self.left_out(&asked.with(brdf), &held, turns);
            let tried = smoothnesses.iter().zip(left);
            tried.map(move |(&smoothness, left)| Tried {
                brdf,
                smoothness,
                left,
                dark: Arc::clone(&dark),
            })
        };
        lobes.par_iter().flat_map_iter(of).collect()
    }

    /// What the lights alone leave, each of them as strong as the views that have a say have it.
    pub fn left_by_lights(&self, brdf: Brdf, turns: Turns<'_>) -> Vec<LeftAt> {
        let asked = self.asked_on(&self.cells[..self.lights], brdf);
        let (_, left) = self.left_out(&asked, &[None], turns);
        left.into_iter().flatten().collect()
    }

    fn asked(&self, brdf: Brdf) -> Asked<'_> {
        self.asked_on(&self.cells, brdf)
    }

    fn asked_on<'d>(&'d self, cells: &'d [Cell], brdf: Brdf) -> Asked<'d> {
        Asked {
            design: (self.whole).shadowed_design(&self.gray, cells, &brdf),
            cells,
            brdf,
        }
    }

    /// The weight that each row has in each turn by what a lobe leaves.
    pub fn weights(&self, tried: &Tried, turns: Turns<'_>) -> Vec<Vec<f32>> {
        let asked = self.asked(tried.brdf);
        let held = Some((&self.joined[..], tried.smoothness));
        let of_turn = |turn| asked.weighted(held, (turns, turn)).weights;
        (0..turns.count).into_par_iter().map(of_turn).collect()
    }

    /// What diffuse colours alone leave at each point, and what a lobe does where cells are held to each other in some ways, summed over all
    /// turns.
    fn left_out(
        &self,
        asked: &Asked<'_>,
        held: &[Smoothness<'_>],
        turns: Turns<'_>,
    ) -> (Arc<[f64]>, Vec<Vec<LeftAt>>) {
        let Observations { points, .. } = &self.gray;
        let of_turn = |turn| asked.left_in(held, (turns, turn), &self.units);
        let of_turns: Vec<_> = (0..turns.count).into_par_iter().map(of_turn).collect();
        let sum = |of: usize, i: usize| of_turns.iter().map(|turn| turn[of][i]).sum::<f64>();
        let dark = (0..points.len()).map(|i| sum(0, i)).collect();
        let of_held = |h: usize| {
            let at = |(i, point): (usize, &Point)| LeftAt {
                pixel: point.pixel,
                position: point.position,
                left: sum(h + 1, i),
            };
            points.iter().enumerate().map(at).collect()
        };
        (dark, (0..held.len()).map(of_held).collect())
    }
}

/// A lobe with light on some cells, of which it is asked what it leaves.
struct Asked<'d> {
    design: Design<'d>,
    cells: &'d [Cell],
    brdf: Brdf,
}

impl<'d> Asked<'d> {
    /// The same with a lobe that is no wider.
    fn with(&self, brdf: Brdf) -> Self {
        Self {
            design: self.design.clone(),
            brdf,
            ..*self
        }
    }

    fn dark(&self) -> State<'d> {
        State::new(self.design.clone(), self.cells.to_vec(), self.brdf)
    }

    /// Light by the views that have a say in a turn after some rounds, with the weights that are right for it.
    fn weighted(&self, held: Smoothness<'_>, (turns, turn): (Turns<'_>, usize)) -> State<'d> {
        let rows = &self.design.observations.rows;
        let tells = |k: usize| !turns.is_out(turn, rows[k].view);
        let mut state = self.dark();
        if let Some(weights) = turns.weights {
            state.weights.clone_from(&weights[turn]);
        } else {
            light_in_rounds(&mut state, held, tells);
            state.reweight();
        }
        state.silence(tells);
        state
    }

    /// What is left at each point in the views that have no say in a turn, by diffuse colours alone and where cells are held in each way.
    fn left_in(
        &self,
        held: &[Smoothness<'_>],
        (turns, turn): (Turns<'_>, usize),
        units: &[f32],
    ) -> Vec<Vec<f64>> {
        let rows = &self.design.observations.rows;
        let mut state = self.weighted(held[held.len() / 2], (turns, turn));
        let mut judged = self.dark();
        judged.silence(|k| !turns.is_out(turn, rows[k].view));
        let is_out = |view: &usize| turns.is_out(turn, *view);
        let out: Vec<usize> = (0..turns.views).filter(is_out).collect();
        let dark = dark_residuals(&self.design, &MATTE, &judged.weights);
        let mut left = vec![left_by(&self.design, &dark, units, &out)];
        for &held in held {
            light(&mut state, held);
            judged.light_as(&state);
            left.push(left_by(&self.design, &judged.residuals, units, &out));
        }
        left
    }
}

/// Lets light and weights take turns, where only some rows tell.
pub fn light_in_rounds(state: &mut State<'_>, held: Smoothness<'_>, tells: impl Fn(usize) -> bool) {
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
