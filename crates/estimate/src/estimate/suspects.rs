//! What, other than stated, would explain the photographs better?
//!
//! Where a fit leaves residuals that neighbouring points share, it is repeated on the coarsest cells with one assumption
//! changed: where the lights are, what the pictures' numbers mean. Each change is judged by whether it
//! wins in more parts of the surface than chance would have it: points are gathered in groups of like normals, and the groups'
//! differences are ranked (Wilcoxon, "Individual comparisons by ranking methods", 1945). So no single highlight decides.

use std::ops::{ControlFlow, Range, RangeInclusive};
use std::sync::atomic::Ordering;

use glam::Vec3;
use rayon::prelude::*;

use super::design::Design;
use super::fast::Solver;
use super::observations::{Observations, Point};
use super::observer::{Stopped, go_on};
use super::state::{ROUGH, State};
use super::weights::magnitude;
use rekindle_base::math::ranks::{SURE, signed_ranks};
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// An assumption that the photographs contradict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Suspect {
    /// The lights are distant, and not at the stated distance.
    Distant,
    /// The lights are at about this distance from the object's centre, mesh units.
    Near(f32),
    /// The pictures hold encoded values, as sRGB's, and not radiance.
    Encoded,
    /// The pictures hold values that were decoded twice.
    Decoded,
    /// A view does not fit the others; its index.
    View(usize),
    /// The surface has this lobe, and not the one asked for.
    Lobe(SpecularModel),
}

/// An assumption with the fit that changing it gives.
#[derive(Clone, Copy, Debug)]
pub struct Suspicion {
    /// What is wrong.
    pub suspect: Suspect,
    /// What the changed fit leaves, as a part of what the unchanged one does.
    pub leaves: f64,
    /// Its roughness over the unchanged one's.
    pub sigma_ratio: f32,
}

/// How much rougher and smoother a lobe is made to see whether its roughness is determined, and that of a changed fit …
const ROUGHER: f32 = 1.5;
/// … starting at this σ and within this range, radians.
const TYPICAL: f32 = 0.1;
const SIGMA_RANGE: RangeInclusive<f32> = 0.01..=0.5;
/// Rounds of improvement of a changed fit, …
const ROUNDS: usize = 4;
/// … which one that starts so much worse than it has to become is not worth.
const HOPELESS: f64 = 1.3;
/// Distances tried, as multiples of the one stated, and of half the object's diagonal where none is.
const STATED_RADII: [f32; 4] = [0.5, 0.8, 1.25, 2.0];
const RADII: [f32; 3] = [2.0, 5.0, 12.0];
/// With fewer views, none can be told to be the odd one.
const FEWEST_VIEWS: usize = 4;
/// Exponent of a display's curve.
const DISPLAY_GAMMA: f32 = 2.2;

/// A change of assumptions, with what it needs.
struct Change<'a> {
    suspect: Suspect,
    observations: &'a Observations,
    near: Option<(Vec3, f32)>,
    /// The lobes that may fit then; the first is tried at more roughnesses.
    models: &'a [SpecularModel],
}

/// The fit with another lobe than that of the first of some fits that explains the photographs better, beyond chance.
pub fn better_lobe(fits: &[State<'_>]) -> Option<Suspicion> {
    let (own, others) = fits.split_first()?;
    let (sigma, own) = (own.brdf.sigma, Trial::of(own));
    let other = |state: &State<'_>| (state.brdf.model, Trial::of(state));
    let tried = others.iter().map(other);
    let least = tried.min_by(|(_, a), (_, b)| a.total().total_cmp(&b.total()));
    let (model, trial) = least?;
    let is_better = trial.total() < own.total() && signed_ranks(&own.left, &trial.left) > SURE;
    is_better.then(|| Suspicion {
        suspect: Suspect::Lobe(model),
        leaves: trial.total() / own.total(),
        sigma_ratio: trial.sigma / sigma,
    })
}

/// A fit on the coarsest cells: what it leaves of the differences between views, one value a point, and its roughness.
struct Trial {
    left: Vec<f64>,
    sigma: f32,
}

impl Trial {
    fn of(state: &State<'_>) -> Self {
        Self {
            left: left(state),
            sigma: state.brdf.sigma,
        }
    }

    fn total(&self) -> f64 {
        self.left.iter().sum()
    }
}

/// What a fit leaves at each point, as a part of the differences between views and per degree of freedom, of which a lit cell
/// and a point's colour take one each.
pub fn left(state: &State<'_>) -> Vec<f64> {
    let observations = state.design.observations;
    let all = state.dark_residuals().absolute_sum();
    let rows = observations.rows.len() as f64;
    let taken = (observations.points.len() + state.lit().len()) as f64;
    let scale = rows / (rows - taken).max(1.0) / all.max(f64::MIN_POSITIVE);
    let residuals = &state.residuals.values;
    let of_point =
        |rows: Range<usize>| -> f64 { rows.map(|k| f64::from(magnitude(residuals[k]))).sum() };
    (observations.points.iter())
        .map(|point| scale * of_point(point.rows.clone()))
        .collect()
}

/// Whether a coarse fit's roughness stands out against a rougher and a smoother one: neither of them may do as well in so
/// many parts of the surface that chance could have decided.
pub fn determines_roughness(fit: &State<'_>) -> bool {
    let own = left(fit);
    let sigma = fit.brdf.sigma;
    [sigma / ROUGHER, sigma * ROUGHER]
        .into_par_iter()
        .map(|other| signed_ranks(&left(&fit.lit_at(other)), &own))
        .all(|z| z > SURE)
}

impl Solver<'_> {
    /// What the photographs contradict, if there is anything: something that is stated, or else a view.
    pub fn suspicion(&self, fit: &State<'_>) -> Result<Option<Suspicion>, Stopped> {
        match self.contradicted(fit, 1.0)? {
            Some(found) => Ok(Some(found)),
            None => self.odd_view(fit),
        }
    }

    /// What is stated of lights or numbers and the photographs contradict, looked for from a coarse fit of everything as stated, where
    /// what leaves more than a part `worth` of what that does is of no interest.
    pub fn contradicted(&self, fit: &State<'_>, worth: f64) -> Result<Option<Suspicion>, Stopped> {
        let colour = self.coarse_colours();
        let [decoded, encoded] = [DISPLAY_GAMMA, 1.0 / DISPLAY_GAMMA].map(|g| powered(&colour, g));
        // Which lobe fits depends on what the numbers mean and on where the lights are.
        let mut models = SpecularModel::ALL;
        models.sort_by_key(|&model| model != fit.brdf.model);
        let stated = self.stated(&models[..1]);
        let Some(own) = self.trial(&stated, fit.brdf.sigma, f64::INFINITY)? else {
            return Ok(None);
        };
        let mut best: Option<Suspicion> = None;
        let changes = self.changes(&models, [&decoded, &encoded]);
        let most = HOPELESS * worth * own.total();
        let trials = changes
            .par_iter()
            .map(|change| self.trial(change, fit.brdf.sigma, most));
        let trials: Result<Vec<Option<Trial>>, Stopped> = trials.collect();
        for (change, trial) in changes.iter().zip(trials?) {
            let Some(trial) = trial else { continue };
            let leaves = trial.total() / own.total();
            let less = leaves < best.map_or(1.0, |b| b.leaves);
            if less && signed_ranks(&own.left, &trial.left) > SURE {
                best = Some(Suspicion {
                    suspect: change.suspect,
                    leaves,
                    sigma_ratio: trial.sigma / own.sigma,
                });
            }
        }
        Ok(best)
    }

    /// Everything as stated.
    fn stated<'a>(&'a self, models: &'a [SpecularModel]) -> Change<'a> {
        Change {
            suspect: Suspect::Distant,
            observations: &self.coarse,
            near: self.near,
            models,
        }
    }

    /// The view without which the others are explained better than without any other, by more than chance.
    pub fn odd_view(&self, fit: &State<'_>) -> Result<Option<Suspicion>, Stopped> {
        let views = self.seen.views.len();
        if views < FEWEST_VIEWS {
            return Ok(None);
        }
        let sees = self.coarse_design(&self.coarse).seen;
        let without = |view: usize| {
            let (observations, rows) = self.coarse.without_views(|other| other == view);
            // All points see what they saw.
            let point = |of: &Point| {
                let row = rows[of.rows.start];
                self.coarse.points.partition_point(|p| p.rows.end <= row)
            };
            let design = Design {
                seen: sees.seen_from(observations.points.iter().map(point)),
                ..self.design(&observations, &self.roots())
            };
            let dark = State::new(design, self.roots(), fit.brdf);
            let mut state = dark.lit_at(fit.brdf.sigma);
            self.improve_quietly(&mut state, ROUNDS, ROUGH)?;
            Ok((self.left_in_rows(&state, &rows), state.brdf.sigma))
        };
        let without: Result<Vec<_>, Stopped> = (0..views).into_par_iter().map(without).collect();
        let without = without?;
        // What is left in the rows of third views is compared.
        let third = |one: usize, other: usize, left: &[f64]| -> Vec<f64> {
            let points = self.coarse.points.iter();
            let of_point = |rows: Range<usize>| -> f64 {
                rows.filter(|&k| ![one, other].contains(&self.coarse.rows[k].view))
                    .map(|k| left[k])
                    .sum()
            };
            points.map(|point| of_point(point.rows.clone())).collect()
        };
        let is_odd = |view: usize| {
            (0..views).filter(|&other| other != view).all(|other| {
                let own = third(view, other, &without[view].0);
                signed_ranks(&third(view, other, &without[other].0), &own) > SURE
            })
        };
        let Some(odd) = (0..views).find(|&view| is_odd(view)) else {
            return Ok(None);
        };
        let others = (0..views).filter(|&view| view != odd);
        let ratio = |view: usize| {
            let total = |of: usize| third(view, odd, &without[of].0).iter().sum::<f64>();
            total(odd) / total(view).max(f64::MIN_POSITIVE)
        };
        let leaves = others.map(ratio).sum::<f64>() / (views - 1) as f64;
        Ok(Some(Suspicion {
            suspect: Suspect::View(odd),
            leaves,
            sigma_ratio: without[odd].1 / fit.brdf.sigma,
        }))
    }

    /// What a fit to some of the coarse rows leaves in each, none where it has no row; `rows` are their places among all.
    fn left_in_rows(&self, state: &State<'_>, rows: &[usize]) -> Vec<f64> {
        let mut left = vec![0.0; self.coarse.rows.len()];
        for (&k, &residual) in rows.iter().zip(&state.residuals.values) {
            left[k] = f64::from(magnitude(residual));
        }
        left
    }

    /// All changes of what is stated; `powers` are the observations decoded and encoded.
    fn changes<'a>(
        &'a self,
        models: &'a [SpecularModel],
        powers: [&'a Observations; 2],
    ) -> Vec<Change<'a>> {
        let stated = |suspect| Change {
            suspect,
            ..self.stated(models)
        };
        let at = |centre, radius| Change {
            near: Some((centre, radius)),
            ..stated(Suspect::Near(radius))
        };
        let mut changes: Vec<Change<'_>> = if let Some((centre, radius)) = self.near {
            let distant = Change {
                near: None,
                ..stated(Suspect::Distant)
            };
            let others = STATED_RADII.map(|factor| at(centre, factor * radius));
            others.into_iter().chain([distant]).collect()
        } else {
            let reach = 0.5 * self.seen.mesh.diagonal();
            let others = RADII.map(|factor| at(self.grid.centre, factor * reach));
            others.into_iter().collect()
        };
        for (suspect, observations) in [Suspect::Encoded, Suspect::Decoded].into_iter().zip(powers)
        {
            changes.push(Change {
                observations,
                ..stated(suspect)
            });
        }
        changes
    }

    /// What a fit with a change leaves; nothing where it starts by leaving more than `most`.
    fn trial(&self, change: &Change<'_>, sigma: f32, most: f64) -> Result<Option<Trial>, Stopped> {
        let fitted = self.fitted(change, sigma, most)?;
        Ok(fitted.map(|state| Trial::of(&state)))
    }

    /// A fit with a change on the coarsest cells; nothing where it starts by leaving more than `most`.
    fn fitted<'s>(
        &'s self,
        change: &Change<'s>,
        sigma: f32,
        most: f64,
    ) -> Result<Option<State<'s>>, Stopped> {
        let design = if change.near == self.near {
            self.coarse_design(change.observations)
        } else {
            self.roots_design(change.observations, change.near)
        };
        let dark = State::new(design, self.roots(), Brdf::new(change.models[0], sigma));
        let start = downhill(&dark, sigma);
        let others = change.models[1..].par_iter().map(|&model| {
            let mut state = dark.clone();
            state.brdf.model = model;
            state.lit_at(start.brdf.sigma)
        });
        let mut states: Vec<State<'_>> = others.collect();
        states.push(start);
        if self.stop.load(Ordering::Relaxed) {
            go_on(ControlFlow::Break(()))?;
        }
        let states = states.into_iter();
        let best = states.min_by(|a, b| a.unexplained().total_cmp(&b.unexplained()));
        let Some(mut state) = best.filter(|state| left(state).iter().sum::<f64>() < most) else {
            return Ok(None);
        };
        self.improve_quietly(&mut state, ROUNDS, ROUGH)?;
        Ok(Some(state))
    }
}

/// The fit of a dark state at the roughness from which all steps leave more, starting at `sigma` or at a usual one: what is wrong
/// may have led the former far from the truth.
fn downhill<'s>(dark: &State<'s>, sigma: f32) -> State<'s> {
    let of = |sigma: f32| {
        let state = dark.lit_at(sigma);
        (state.unexplained(), state)
    };
    let (own, typical) = rayon::join(|| of(sigma), || of(TYPICAL));
    let mut best = if own.0 < typical.0 { own } else { typical };
    let sigma = best.1.brdf.sigma;
    let (rougher, smoother) = rayon::join(|| of(sigma * ROUGHER), || of(sigma / ROUGHER));
    let (mut next, factor) = if rougher.0 < smoother.0 {
        (rougher, ROUGHER)
    } else {
        (smoother, ROUGHER.recip())
    };
    while next.0 < best.0 {
        best = next;
        let sigma = best.1.brdf.sigma * factor;
        if !SIGMA_RANGE.contains(&sigma) {
            break;
        }
        next = of(sigma);
    }
    best.1
}

/// Every channel of every row raised to a power, with its detail to match, in gray.
fn powered(colour: &Observations, exponent: f32) -> Observations {
    let mut powered = colour.clone();
    for row in &mut powered.rows {
        let slope = exponent * magnitude(row.radiance).max(1e-6).powf(exponent - 1.0);
        row.detail *= slope;
        row.radiance = row.radiance.map(|v| v.max(0.0).powf(exponent));
    }
    powered.to_gray()
}
