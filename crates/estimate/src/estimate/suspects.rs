//! What, other than stated, would explain the photographs better?
//!
//! Where a fit leaves residuals that neighbouring points share, it is repeated on the coarsest cells with one assumption
//! changed: where the lights are, what the pictures' numbers mean. Each change is judged by whether it
//! wins in more parts of the surface than chance would have it: points are gathered in groups of like normals, and the groups'
//! differences are ranked (Wilcoxon, "Individual comparisons by ranking methods", 1945). So no single highlight decides. What wins has to
//! win on cells that are split once, too: a change that makes highlights wider is better on coarse cells only.

use std::ops::{ControlFlow, Range, RangeInclusive};
use std::sync::OnceLock;
use std::sync::atomic::Ordering;

use glam::Vec3;
use rayon::prelude::*;

use super::design::Design;
use super::fast::{MIDDLE_POINTS, Solver};
use super::gloss;
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

impl Suspicion {
    /// The view that is suspected, if it is one.
    pub fn view(&self) -> Option<usize> {
        match self.suspect {
            Suspect::View(view) => Some(view),
            _ => None,
        }
    }
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
/// Exponents of a display's curve, by which encoded values are decoded, and decoded ones encoded.
const POWERS: [f32; 2] = [2.2, 1.0 / 2.2];

/// A change of assumptions, with what it needs.
struct Change<'a> {
    suspect: Suspect,
    /// The observations with their numbers raised to this power.
    power: f32,
    observations: &'a Observations,
    near: Option<(Vec3, f32)>,
    /// The lobes that may fit then; the first is tried at more roughnesses.
    models: &'a [SpecularModel],
}

impl Change<'_> {
    /// What a fit with it leaves of the differences between views as they are stated. See [`left`].
    fn left(&self, state: &State<'_>) -> Vec<f64> {
        if self.power == 1.0 {
            left(state)
        } else {
            left_before(state, self.power)
        }
    }
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

    /// A fit with a change.
    fn with(change: &Change<'_>, state: &State<'_>) -> Self {
        Self {
            left: change.left(state),
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
    left_as(state, |_, residual| magnitude(residual))
}

/// The same of a fit in gray to numbers that were raised to a `power`, in what they were before: two powers are compared by the same numbers.
fn left_before(state: &State<'_>, power: f32) -> Vec<f64> {
    let rows = &state.design.observations.rows;
    let before = |value: f32| value.max(0.0).powf(power.recip());
    left_as(state, |k, [residual, ..]| {
        let [measured, ..] = rows[k].radiance;
        (before(measured) - before(measured - residual)).abs()
    })
}

/// The same where the residual of each row has a size.
fn left_as(state: &State<'_>, size: impl Fn(usize, [f32; 3]) -> f32) -> Vec<f64> {
    let observations = state.design.observations;
    let size_of = |residuals: &[[f32; 3]], k: usize| f64::from(size(k, residuals[k]));
    let rows = observations.rows.len();
    let dark = state.dark_residuals().values;
    let all: f64 = (0..rows).map(|k| size_of(&dark, k)).sum();
    let rows = rows as f64;
    let taken = (observations.points.len() + state.lit().len()) as f64;
    let scale = rows / (rows - taken).max(1.0) / all.max(f64::MIN_POSITIVE);
    let residuals = &state.residuals.values;
    let of_point = |rows: Range<usize>| -> f64 { rows.map(|k| size_of(residuals, k)).sum() };
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
        let [decoded, encoded] = POWERS.map(|power| powered(&colour, power));
        // Which lobe fits depends on what the numbers mean and on where the lights are.
        let mut models = SpecularModel::ALL;
        models.sort_by_key(|&model| model != fit.brdf.model);
        let stated = self.stated(&models[..1]);
        let Some(as_stated) = self.fitted(&stated, fit.brdf.sigma, f64::INFINITY)? else {
            return Ok(None);
        };
        let own = Trial::with(&stated, &as_stated);
        let mut better: Vec<(Suspicion, &Change<'_>, State<'_>)> = Vec::new();
        let changes = self.changes(&models, [&decoded, &encoded]);
        let most = HOPELESS * worth * own.total();
        let fits = changes
            .par_iter()
            .map(|change| self.fitted(change, fit.brdf.sigma, most));
        let fits: Result<Vec<Option<State<'_>>>, Stopped> = fits.collect();
        for (change, state) in changes.iter().zip(fits?) {
            let Some(state) = state else { continue };
            let trial = Trial::with(change, &state);
            let leaves = trial.total() / own.total();
            // A little less is what many a wrong assumption leaves of a misfit that has another cause.
            if leaves < gloss::WORTH && signed_ranks(&own.left, &trial.left) > SURE {
                let found = Suspicion {
                    suspect: change.suspect,
                    leaves,
                    sigma_ratio: trial.sigma / own.sigma,
                };
                better.push((found, change, state));
            }
        }
        better.sort_by(|(a, ..), (b, ..)| a.leaves.total_cmp(&b.leaves));
        for (found, change, changed) in better {
            if self.is_better_on_split((&stated, &as_stated), (change, &changed))? {
                return Ok(Some(found));
            }
        }
        Ok(None)
    }

    /// Whether the second of two fits leaves less than the first on cells that are split once, beyond chance, at points that could show the
    /// lights of either.
    fn is_better_on_split(
        &self,
        first: (&Change<'_>, &State<'_>),
        second: (&Change<'_>, &State<'_>),
    ) -> Result<bool, Stopped> {
        let lit = [first.1, second.1].into_iter().flat_map(|state| {
            let directions = &state.design.geometry.directions;
            state.lit().into_iter().map(|k| directions[k])
        });
        let widest = f32::max(first.1.brdf.sigma, second.1.brdf.sigma);
        let widest = Brdf::new(first.1.brdf.model, widest);
        let lit: Vec<Vec3> = lit.collect();
        let points = self.points_showing(&lit, &widest, MIDDLE_POINTS);
        let left = |(change, state): (&Change<'_>, &State<'_>)| {
            let changed = Solver {
                near: change.near,
                coarse: self.coarse.clone(),
                coarse_sees: OnceLock::new(),
                ..*self
            };
            let points = powered(&points, change.power);
            let split = changed.lit_on_split(changed.refine(state, &points))?;
            Ok(change.left(&split))
        };
        let (first, second) = (left(first)?, left(second)?);
        Ok(signed_ranks(&first, &second) > SURE)
    }

    /// Everything as stated.
    fn stated<'a>(&'a self, models: &'a [SpecularModel]) -> Change<'a> {
        Change {
            suspect: Suspect::Distant,
            power: 1.0,
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
        let suspects = [Suspect::Encoded, Suspect::Decoded].into_iter();
        for ((suspect, power), observations) in suspects.zip(POWERS).zip(powers) {
            changes.push(Change {
                power,
                observations,
                ..stated(suspect)
            });
        }
        changes
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
        let is_hopeful = |state: &State<'_>| change.left(state).iter().sum::<f64>() < most;
        let Some(mut state) = best.filter(is_hopeful) else {
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
