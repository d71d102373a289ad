//! The default method: variable projection over cells that are split where there is light.
//!
//! For a fixed σ the lights are a non-negative least-squares problem whose size is the number of lit cells, because
//! the diffuse colours are eliminated exactly and dark cells are left out. σ then is the minimum of
//! `f(σ) = min_{L ≥ 0} ‖W^½ P (A_σ L − I)‖²`: a few values of σ are compared on the coarsest cells, in gray and on
//! few points, and from the best one Gauss-Newton steps on f go on together with robust reweighting while lit cells
//! are split down to single nodes. Only surface points that could show one of the lit cells take part from then on.

use std::collections::BTreeSet;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use super::broad_light;
use super::cells::{Cell, Pyramid};
use super::design::Design;
use super::held_out::{
    CHANCE, Left, at_best_roughness, leaves_less, left_out, nearest_roughness, predicts_better,
    roughly_left_out, sparse,
};
use super::lamps::fill_compact_lamps;
use super::lobes::light_from;
use super::merging::merge_lamps;
use super::misfit::Misfit;
use super::near::Near;
use super::observations::{
    Candidate, Observations, Point, Row, Sampling, Seen, pixels_inside, widest,
};
use super::observer::{Interim, Iteration, Observer, Stopped, Unobserved, go_on};
use super::spread::even_out;
use super::state::{EXACT, Precision, ROUGH, SigmaStep, State};
use super::support::{drop_satellites, drop_unsupported, drop_unsupported_in_the_end};
use super::turntable::Turning;
use super::visibility::{SeenCells, cell_visibility};
use super::workspace::Workspace;
use super::{Estimate, EstimateInput};
use rekindle_base::math::ranks::SURE;
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};
use rekindle_scene::shortcuts::{Shortcut, Shortcuts};
use rekindle_scene::surface::{GlossParts, Occluder};

/// Roughnesses compared on the coarsest cells, radians.
pub const SIGMAS: [f32; 6] = [0.34, 0.21, 0.13, 0.08, 0.05, 0.03];

/// The roughnesses that fit two models differ by less than this factor.
const NEAR_RATIO: f32 = 2.0;

/// This many roughnesses in a row that leave so many times as much as the best so far end the comparison.
const CLEARLY_WORSE: f64 = 1.1;
const TIMES_WORSE: usize = 2;

/// So many of them are tried side by side.
const AT_ONCE: usize = 2;

/// How much shorter or longer than Gauss-Newton's a step of σ may be.
const MOST_SHORTENED: f64 = 0.5;
const MOST_LENGTHENED: f64 = 4.0;

/// A step of σ by less than this part of it is none.
const SETTLED: f64 = 3e-4;

/// Frequency of the coarsest grid.
pub const COARSEST: u32 = 11;

/// Points on the coarsest cells.
const COARSE_POINTS: usize = 1500;

/// Pixels looked at for points that could show a lit cell.
const FINE_CANDIDATES: usize = 24_000;

/// Most points that take part on cells between the coarsest and the finest, and on the finest.
pub const MIDDLE_POINTS: usize = 1800;
const FINE_POINTS: usize = 5000;

/// Cells past about this number stay coarse, the dimmest first.
const MOST_CELLS: usize = 700;

/// A cell with less than this share of the flux is not worth splitting.
const LEAST_SHARE: f32 = 2e-3;

/// A cell with less than this share of the flux is taken as dark.
const DARK_SHARE: f32 = 2e-4;

/// Rings of dark cells that are kept around lit ones while σ settles.
const MARGIN: usize = 2;

/// Rounds in which glosses and lights take turns.
const GLOSS_ROUNDS: usize = 3;
/// Parts that differ by less from those before, in the mean, are settled.
const SAME_GLOSS: f32 = 0.02;
/// Steps of σ and lights on cells that are split once to be compared.
const SPLIT_ROUNDS: usize = 4;

/// A lobe that reaches everything that any other does.
const WIDEST: Brdf = Brdf::new(SpecularModel::Ggx, 0.5);

/// A lobe below this share of its peak says nothing worth a row.
const LEAST_LOBE: f32 = 0.02;

/// What the fit of one specular model found.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Model and roughness.
    pub brdf: Brdf,
    /// Radiance per node of the finest grid, in the capture's units.
    pub nodes: Vec<[f32; 3]>,
    /// Standard error of σ, radians; infinite where the data do not determine it.
    pub sigma_error: f32,
    /// The same if residuals were noise, which neighbouring points don't share.
    pub noise_error: f32,
    /// What it leaves that is no noise.
    pub misfit: Misfit,
    /// Parts of the surface whose gloss differs, where there are any.
    pub parts: Option<GlossParts>,
}

impl Fit {
    /// Whether the surface is of metal at a place.
    pub fn is_metal_at(&self, place: Vec3) -> bool {
        let parts = self.parts.as_ref();
        let gloss = parts.map_or(Gloss::MAIN, |parts| parts.glosses[parts.at(place)]);
        self.brdf.at(gloss).is_metal()
    }
}

/// The best fit on the coarsest cells.
pub struct CoarseFit<'a> {
    /// The fit.
    pub state: State<'a>,
    /// The least [`State::unexplained`] on the way to it, positive.
    pub unexplained: f64,
    /// How much of what the broadest lobe leaves unexplained the best one explains, in [0, 1].
    pub sharpness: f64,
    /// See [`CoarseFit::left_out`].
    left: OnceLock<Vec<Left>>,
}

impl<'a> CoarseFit<'a> {
    /// The same, or lights at a roughness that predicts views better. Where normals are off, a narrow lobe under many lights explains what they
    /// do to single points, and predicts nothing.
    #[must_use]
    pub fn or_predicting(self, solver: &'a Solver<'_>) -> Self {
        let Some(sigma) = self.outdone(solver) else {
            return self;
        };
        let (_, state) = sparse(solver, Brdf::new(self.state.brdf.model, sigma));
        Self {
            unexplained: state.unexplained().max(f64::MIN_POSITIVE),
            state,
            left: OnceLock::new(),
            ..self
        }
    }

    /// The roughness that predicts views best, if it does so better than the fit's own, beyond chance.
    pub fn outdone(&self, solver: &Solver<'_>) -> Option<f32> {
        if solver.sigma.is_some() {
            return None;
        }
        let Brdf { model, sigma, .. } = self.state.brdf;
        let (other, best) = at_best_roughness(solver, model);
        let is_other = nearest_roughness(sigma) != other;
        let own = || roughly_left_out(solver, &self.state);
        (is_other && leaves_less(&own(), &best) > CHANCE).then_some(other)
    }

    /// What it leaves of views that had no say, looked at once; with its own solver. See [`left_out`].
    pub fn left_out(&self, solver: &Solver<'_>) -> &[Left] {
        self.left.get_or_init(|| left_out(solver, &self.state))
    }
}

/// All that a fit works on.
pub struct Solver<'a> {
    /// Mesh, photographs and cameras.
    pub seen: Seen<'a>,
    /// The object, for shadows.
    pub occluder: &'a Occluder,
    /// Nodes of the result, the finest of the pyramid.
    pub grid: &'a HemisphereGrid,
    /// The cells.
    pub pyramid: &'a Pyramid,
    /// Centre and radius of a finite hemisphere.
    pub near: Option<(Vec3, f32)>,
    /// Points spread over everything seen, in gray.
    pub coarse: Observations,
    /// What these see of the coarsest cells, once that has been asked.
    pub coarse_sees: OnceLock<SeenCells>,
    /// The clock that iterations are timed by.
    pub started: Instant,
    /// What may be left out.
    pub shortcuts: &'a Shortcuts,
    /// Memory for its equations.
    pub workspace: &'a Workspace,
    /// σ where it is stated, radians.
    pub sigma: Option<f32>,
    /// Whether the lobe is one that was asked for, and not what explains most.
    pub is_lobe_asked_for: bool,
    /// What a first estimate has found.
    pub first: Option<&'a Estimate>,
    /// Where light is sought, if not everywhere.
    pub near_to: Option<Near<'a>>,
    /// Set once the observer wants no more.
    pub stop: &'a AtomicBool,
}

/// The step of σ, corrected by how the slope changed since the step before.
///
/// A Gauss-Newton step takes the dark cells as dark for good. Where cells go dark or light up as σ moves, f is flatter
/// than that, and the secant through the last two slopes says by how much.
fn lengthened(before: Option<(f64, SigmaStep)>, sigma: f64, step: &SigmaStep) -> f64 {
    let Some((last_sigma, last)) = before else {
        return step.step;
    };
    let secant = step.slope * (sigma - last_sigma) / (last.slope - step.slope);
    let ratio = secant / step.step;
    if ratio.is_finite() {
        step.step * ratio.clamp(MOST_SHORTENED, MOST_LENGTHENED)
    } else {
        step.step
    }
}

/// A watched solve: every step is counted, timed and reported.
pub struct Watch<'w> {
    /// Iterations so far.
    pub iterations: &'w mut Vec<Iteration>,
    /// Who is told.
    pub observer: &'w mut dyn Observer,
}

/// Points spread over everything seen that could show the light that is sought, about `count`; `scale` is the radiance that counts as 1, if
/// it has been chosen already.
fn spread_points(
    seen: &Seen<'_>,
    near_to: Option<Near<'_>>,
    count: usize,
    scale: Option<f32>,
    stop: &AtomicBool,
) -> Observations {
    let sampling = Sampling {
        candidates: count,
        limit: count,
        keep: &|_, _, _| true,
        scale,
        stop,
    };
    near_to.map_or_else(
        || Observations::gather(seen, &sampling),
        |near| near.points(seen, &sampling),
    )
}

impl<'a> Solver<'a> {
    /// A solver of an input whose surface has one gloss, with σ where it is stated.
    pub fn new(
        input: &EstimateInput<'a>,
        sigma: Option<f32>,
        pyramid: &'a Pyramid,
        (shortcuts, workspace): (&'a Shortcuts, &'a Workspace),
        turning: Option<&'a Turning<'a>>,
        started: Instant,
        stop: &'a AtomicBool,
    ) -> Self {
        let seen = Seen {
            mesh: &input.capture.mesh,
            views: &input.capture.views,
            surfaces: input.surfaces,
            pixels: pixels_inside(input.surfaces),
            parts: None,
            mirrored: input.first.map(|first| first.mirrored),
            turning,
        };
        Self {
            seen,
            occluder: input.occluder,
            grid: input.grid,
            pyramid,
            near: input.grid.radius.map(|r| (input.grid.centre, r)),
            coarse: Self::coarse_observations(&seen, None, None, stop),
            coarse_sees: OnceLock::new(),
            started,
            shortcuts,
            workspace,
            sigma,
            is_lobe_asked_for: false,
            first: input.first.map(|first| first.estimate),
            near_to: None,
            stop,
        }
    }
}

/// A state at whose σ the lights are, and the last step of σ, which has not been taken.
struct Settled<'s> {
    state: State<'s>,
    step: SigmaStep,
}

impl Solver<'_> {
    /// See [`Turning::is_provisional`].
    pub fn is_provisional(&self) -> bool {
        self.seen
            .turning
            .is_some_and(|turning| turning.is_provisional)
    }

    /// Points for the coarsest cells; `scale` is the radiance that counts as 1, if it has been chosen already.
    pub fn coarse_observations(
        seen: &Seen<'_>,
        near_to: Option<Near<'_>>,
        scale: Option<f32>,
        stop: &AtomicBool,
    ) -> Observations {
        spread_points(seen, near_to, COARSE_POINTS, scale, stop).to_gray()
    }

    /// [`Solver::coarse`] in colour.
    pub fn coarse_colours(&self) -> Observations {
        self.colours(COARSE_POINTS)
    }

    /// About `count` points spread over everything seen, in colour.
    pub fn colours(&self, count: usize) -> Observations {
        let scale = Some(self.coarse.scale);
        spread_points(&self.seen, self.near_to, count, scale, self.stop)
    }

    /// The best of [`SIGMAS`] on the coarsest cells. Where another model's roughness is known, only those near it are looked
    /// at, and the first.
    pub fn compare_sigmas(
        &self,
        model: SpecularModel,
        near: Option<f32>,
        watch: &mut Watch<'_>,
    ) -> Result<CoarseFit<'_>, Stopped> {
        let dark = self.dark_roots(Brdf::new(model, SIGMAS[0]));
        watch.observer.interim(Interim::Lobe(model));
        let is_near = |sigma: f32| {
            let ratio = near.map_or(1.0, |n| sigma / n);
            (1.0 / NEAR_RATIO..NEAR_RATIO).contains(&ratio)
        };
        let thrifty = self.shortcuts.takes(Shortcut::Roughnesses);
        let worth = (SIGMAS.into_iter().enumerate())
            .filter(|&(k, sigma)| !thrifty || k == 0 || is_near(sigma))
            .map(|(_, sigma)| sigma);
        let sigmas: Vec<f32> = self
            .sigma
            .map_or_else(|| worth.collect(), |sigma| vec![sigma]);
        let mut best: Option<(f64, State<'_>)> = None;
        let mut broadest = None;
        let mut worse = 0;
        let mut tried = 0;
        for some in sigmas.chunks(AT_ONCE) {
            let done = 0.3 * tried as f32 / sigmas.len() as f32;
            go_on(watch.observer.progress("comparing roughnesses", done))?;
            tried += some.len();
            let states: Vec<State<'_>> = some.par_iter().map(|&sigma| dark.lit_at(sigma)).collect();
            for state in states {
                let cost = state.unexplained();
                watch.observer.interim(Interim::Tried {
                    model,
                    sigma: state.brdf.sigma,
                    unexplained: cost,
                });
                broadest.get_or_insert(cost);
                match &best {
                    Some((least, _)) if cost >= *least => {
                        worse += usize::from(cost > CLEARLY_WORSE * least);
                    }
                    _ => {
                        best = Some((cost, state));
                        worse = 0;
                    }
                }
            }
            if thrifty && worse >= TIMES_WORSE {
                break;
            }
        }
        let left_out = SIGMAS.len().saturating_sub(tried);
        self.shortcuts
            .count(Shortcut::Roughnesses, SIGMAS.len(), left_out);
        let (cost, state) = best.unwrap_or((f64::INFINITY, dark));
        let sharpness = 1.0 - cost / broadest.unwrap_or(cost).max(f64::MIN_POSITIVE);
        Ok(CoarseFit {
            state,
            unexplained: cost.max(f64::MIN_POSITIVE),
            sharpness,
            left: OnceLock::new(),
        })
    }

    /// The coarsest cells, unlit.
    pub fn dark_roots(&self, brdf: Brdf) -> State<'_> {
        let design = self.coarse_design(&self.coarse);
        State::new(design, self.roots(), brdf)
    }

    /// Improves a coarse fit by a few steps. These may leave more unexplained than was before them, which does not count against
    /// its model.
    pub fn improve_coarse(
        &self,
        fit: &mut CoarseFit<'_>,
        watch: &mut Watch<'_>,
    ) -> Result<(), Stopped> {
        watch.observer.interim(Interim::Lobe(fit.state.brdf.model));
        self.improve(&mut fit.state, 4, ROUGH, watch)?;
        fit.left.take();
        let unexplained = fit.state.unexplained().max(f64::MIN_POSITIVE);
        fit.unexplained = fit.unexplained.min(unexplained);
        Ok(())
    }

    /// Goes on from a coarse fit to single nodes.
    pub fn fine_fit(&self, coarse: &State<'_>, watch: &mut Watch<'_>) -> Result<Fit, Stopped> {
        let mut points = self.points_of_cells(coarse, FINE_POINTS);
        let scale = Some(self.coarse.scale);
        let glosses = self.seen.glosses();
        let all = Observations::of(points.clone(), glosses.clone(), scale);
        points.retain(Candidate::among_first(MIDDLE_POINTS));
        let some = Observations::of(points, glosses, scale);
        let some_gray = some.to_gray();
        let finest = self.pyramid.finest();
        let mut state = coarse.clone();
        for level in 1..=finest {
            let done = f32::from(level - 1) / f32::from(finest);
            go_on(
                watch
                    .observer
                    .progress("splitting lit cells", 0.3 + 0.5 * done),
            )?;
            let last = level == finest;
            state = self.refine(&state, if last { &some } else { &some_gray });
            let (rounds, precision) = if last { (10, EXACT) } else { (4, ROUGH) };
            state.solve_lights(precision);
            if last {
                if self.shortcuts.takes(Shortcut::DarkCells) {
                    state = self.narrow(&state);
                }
                let (all, unknown) = (self.grid.directions.len(), state.cells.len());
                self.shortcuts
                    .count(Shortcut::DarkCells, all, all.saturating_sub(unknown));
            }
            let settled = self.improve(&mut state, rounds, precision, watch)?;
            drop_unsupported(&mut state, precision);
            if watch.observer.enough() {
                let error = settled.map_or(f64::INFINITY, |step| step.error);
                let nodes = self.pyramid.to_nodes(&state.cells, &state.radiance);
                return Ok(self.fit(&state, nodes, error, 1.0));
            }
        }
        go_on(watch.observer.progress("settling the roughness", 0.8))?;
        let settled = self.settled_on(&state, &all, watch)?;
        let are_known = self.first.is_some_and(|first| first.parts.is_some());
        let rounds = if are_known { 1 } else { GLOSS_ROUNDS };
        self.with_parts(settled, rounds, watch)
    }

    /// The fit of a settled state, after `rounds` in which the surface's parts and the lights take turns where some parts are
    /// glossier than others.
    fn with_parts(
        &self,
        settled: Settled<'_>,
        rounds: usize,
        watch: &mut Watch<'_>,
    ) -> Result<Fit, Stopped> {
        // What a surface mirrors of itself makes parts look glossier, not fewer of them; and what is stated holds for all of it.
        let is_even = self.first.is_some_and(|first| first.parts.is_none());
        let is_stated = self.sigma.is_some();
        let found = if rounds > 0 && !is_even && !is_stated && !self.is_provisional() {
            self.gloss_parts(&settled.state, [SURE])
        } else {
            None
        };
        let are_same = |parts: &GlossParts| {
            let before = self.seen.parts;
            before.is_some_and(|before| parts.difference(before) < SAME_GLOSS)
        };
        let Some((parts, main)) = found.filter(|(parts, _)| !are_same(parts)) else {
            return self.with_metals(settled, watch);
        };
        let state = &settled.state;
        let parted = self.parted(&parts);
        let with_main = state.with_main(main);
        // That there are parts at all has to be shown once.
        let is_new = self.seen.parts.is_none();
        if is_new
            && !predicts_better(
                &left_out(&parted, &parted.dark_roots(with_main.brdf)),
                &left_out(self, &self.dark_roots(state.brdf)),
            )
        {
            return self.finish(settled, watch);
        }
        let observations = state.design.observations.of_parts(&parts);
        let settled = parted.settled_on(&with_main, &observations, watch)?;
        parted.with_parts(settled, rounds - 1, watch)
    }

    /// The same where the parts are known. Where some reflect as metals do beside others the latter are dielectrics, if these lobes leave less;
    /// where the lobe is a metal's, which leaves a diffuse part no room, if they have one.
    fn with_metals(&self, settled: Settled<'_>, watch: &mut Watch<'_>) -> Result<Fit, Stopped> {
        let state = &settled.state;
        let dielectric = self.seen.parts.and_then(GlossParts::beside_metals);
        let is_free = !self.is_lobe_asked_for || state.brdf.model == SpecularModel::Ggx;
        let Some((parts, main)) = self.seen.parts.zip(dielectric).filter(|_| is_free) else {
            return self.with_tints(settled, watch);
        };
        let is_metal = state.brdf.model == SpecularModel::Metal;
        let is_weak = |point: &Point| parts.glosses[point.gloss].strength <= main.strength;
        if is_metal && broad_light::against_colours(self, state, is_weak)? > -SURE {
            return self.with_tints(settled, watch);
        }
        let parts = parts.beside(main);
        let beside = self.parted(&parts);
        let observations = state.design.observations.of_parts(&parts);
        let mut with_main = state.with_main(main);
        with_main.brdf.model = SpecularModel::Ggx;
        let mixed = beside.settled_on(&with_main, &observations, watch)?;
        let left = |state: &State<'_>| state.residuals.absolute_sum();
        if is_metal || left(&mixed.state) < left(state) {
            beside.with_tints(mixed, watch)
        } else {
            self.with_tints(settled, watch)
        }
    }

    /// The same after the lights are told in the colours that the parts reflect in, where these differ.
    fn with_tints(&self, settled: Settled<'_>, watch: &mut Watch<'_>) -> Result<Fit, Stopped> {
        let state = &settled.state;
        let Some((parts, main)) = self.tinted_parts(state) else {
            return self.finish(settled, watch);
        };
        let tinted = self.parted(&parts);
        let observations = state.design.observations.of_parts(&parts);
        let settled = tinted.settled_on(&state.with_main(main), &observations, watch)?;
        tinted.finish(settled, watch)
    }

    /// The lights of a state settled on other points.
    fn settled_on<'s>(
        &'s self,
        state: &State<'_>,
        observations: &'s Observations,
        watch: &mut Watch<'_>,
    ) -> Result<Settled<'s>, Stopped> {
        let mut state = self.on_points(state, observations);
        let step = self.settle(&mut state, watch)?;
        Ok(Settled { state, step })
    }

    /// Lights and roughness on single nodes and all points, and the last step of σ.
    fn settle(&self, state: &mut State<'_>, watch: &mut Watch<'_>) -> Result<SigmaStep, Stopped> {
        let step = self.improve(state, 4, EXACT, watch)?;
        Ok(match step {
            Some(step) if !drop_unsupported(state, EXACT) => step,
            Some(_) => state.sigma_step(),
            None => {
                state.solve_lights(EXACT);
                state.sigma_step()
            }
        })
    }

    /// The fit of a settled state, whose lights are made as even and as few as the rows allow.
    fn finish(&self, settled: Settled<'_>, watch: &mut Watch<'_>) -> Result<Fit, Stopped> {
        let Settled { mut state, step } = settled;
        let observations = state.design.observations;
        let widened = step.clustered_error / step.error;
        let by_noise = match self.sigma {
            Some(_) => 0.0,
            None => state.settle_sigma(&step, EXACT),
        };
        drop_satellites(&mut state);
        drop_unsupported_in_the_end(&mut state);
        let state = even_out(self, state, observations);
        self.report(&state, watch)?;
        let nodes = merge_lamps(self, &state, observations);
        Ok(self.fit(&state, nodes, by_noise, widened.max(1.0)))
    }

    /// What a state on single nodes, or on cells where it was ended early, has found, with its radiance on the nodes.
    fn fit(&self, state: &State<'_>, mut nodes: Vec<[f32; 3]>, by_noise: f64, widened: f64) -> Fit {
        let scale = self.coarse.scale;
        for value in nodes.iter_mut().flatten() {
            *value *= scale;
        }
        Fit {
            brdf: state.brdf,
            nodes: fill_compact_lamps(self.grid, state.brdf.sigma, &nodes),
            sigma_error: (widened * by_noise) as f32,
            noise_error: by_noise as f32,
            misfit: Misfit::of(state),
            parts: self.seen.parts.cloned(),
        }
    }

    /// Reweighting, lights and a step of σ in turn, until σ stands still. Returns the step at which it did, which has
    /// not been taken: the lights are those of the present σ. After `rounds` without standing still there is none, and lights and
    /// residuals are those of the σ before.
    fn improve(
        &self,
        state: &mut State<'_>,
        rounds: usize,
        precision: Precision,
        watch: &mut Watch<'_>,
    ) -> Result<Option<SigmaStep>, Stopped> {
        let mut before: Option<(f64, SigmaStep)> = None;
        for round in 0..rounds {
            state.reweight();
            state.solve_lit(precision);
            // Where σ still moves far, new cells light up; on single nodes it does not, and looking for them costs more.
            if precision.looks_around {
                state.light_missed(precision);
            }
            let mut step = self.sigma_step(state);
            self.report(state, watch)?;
            let sigma = f64::from(state.brdf.sigma);
            let limit = 0.3 * sigma;
            let mut change = lengthened(before, sigma, &step).clamp(-limit, limit);
            if watch.observer.enough() {
                return Ok(Some(step));
            }
            let is_small = |change: f64| round > 0 && change.abs() < SETTLED * sigma;
            if (is_small(change) || round + 1 == rounds) && state.light_missed(precision) {
                step = self.sigma_step(state);
                change = step.step.clamp(-limit, limit);
            }
            if is_small(change) {
                return Ok(Some(step));
            }
            // While the weights still settle, slopes of two rounds belong to two objectives.
            before = (round > 0).then_some((sigma, step));
            state.brdf.sigma = (sigma + change).clamp(0.003, 1.0) as f32;
        }
        Ok(None)
    }

    /// The step of σ, which stays as it is where it is stated.
    fn sigma_step(&self, state: &State<'_>) -> SigmaStep {
        let mut step = state.sigma_step();
        if self.sigma.is_some() {
            step.step = 0.0;
        }
        step
    }

    /// [`Solver::improve`] without anybody told.
    pub fn improve_quietly(
        &self,
        state: &mut State<'_>,
        rounds: usize,
        precision: Precision,
    ) -> Result<(), Stopped> {
        let mut watch = Watch {
            iterations: &mut Vec::new(),
            observer: &mut Unobserved,
        };
        self.improve(state, rounds, precision, &mut watch)
            .map(|_| ())
    }

    /// A state on cells that are split once with their lights, improved by a few steps.
    pub fn lit_on_split<'s>(&self, mut split: State<'s>) -> Result<State<'s>, Stopped> {
        split.solve_lights(ROUGH);
        self.improve_quietly(&mut split, SPLIT_ROUNDS, ROUGH)?;
        Ok(split)
    }

    /// A design without shadows.
    pub fn design<'s>(&'s self, observations: &'s Observations, cells: &[Cell]) -> Design<'s> {
        Design {
            observations,
            geometry: self.pyramid.geometry(cells),
            near: self.near,
            seen: SeenCells::default(),
            diffuse_known: false,
            shortcuts: self.shortcuts,
            workspace: self.workspace,
            stop: self.stop,
        }
    }

    /// Points for cells between the coarsest and the finest.
    pub fn middle_observations(&self, coarse: &State<'_>) -> Observations {
        let points = self.points_of_cells(coarse, MIDDLE_POINTS);
        Observations::of(points, self.seen.glosses(), Some(self.coarse.scale))
    }

    /// Points at which one of the lit cells, or one beside them, could show.
    fn points_of_cells(&self, coarse: &State<'_>, limit: usize) -> Vec<Candidate> {
        let (split, kept) = self.worth_splitting(coarse);
        let cells: Vec<Cell> = split.into_iter().chain(kept).collect();
        let directions = self.pyramid.geometry(&cells).directions;
        self.candidates_showing(&directions, &coarse.brdf, limit)
    }

    /// At most `limit` points at which light from one of the directions, or from a coarsest cell around it, could
    /// show.
    pub fn points_showing(&self, directions: &[Vec3], brdf: &Brdf, limit: usize) -> Observations {
        let points = self.candidates_showing(directions, brdf, limit);
        Observations::of(points, self.seen.glosses(), Some(self.coarse.scale))
    }

    fn candidates_showing(&self, directions: &[Vec3], brdf: &Brdf, limit: usize) -> Vec<Candidate> {
        let widest = widest(brdf, &self.seen.glosses());
        let reach = widest.half_angle_support(LEAST_LOBE) + 0.25 * self.pyramid.spacing(0);
        let least = reach.min(std::f32::consts::FRAC_PI_2).cos();
        let shows = |position: Vec3, normal: Vec3, rows: &[Row]| {
            directions.iter().any(|&d| {
                rows.iter().any(|row| {
                    let (position, normal, to_camera) =
                        row.placed.map_or((position, normal, row.to_camera), |p| {
                            (p.position, p.normal, p.to_camera)
                        });
                    let (l, _) = light_from(self.near, d, position);
                    (l + to_camera).normalize_or_zero().dot(normal) > least
                })
            })
        };
        let thrifty = self.shortcuts.takes(Shortcut::UnlitPoints);
        let keep = |position: Vec3, normal: Vec3, rows: &[Row]| {
            let kept = !thrifty || shows(position, normal, rows);
            self.shortcuts
                .count(Shortcut::UnlitPoints, 1, usize::from(!kept));
            kept
        };
        let sampling = Sampling {
            candidates: FINE_CANDIDATES,
            limit: if thrifty { limit } else { usize::MAX },
            keep: &keep,
            scale: Some(self.coarse.scale),
            stop: self.stop,
        };
        let mut points = Candidate::all(&self.seen, &sampling);
        if !thrifty {
            // As many of those that matter, with the others that lie between them.
            let mut is_among_first = Candidate::among_first(limit);
            let mut enough = false;
            points.retain(|point| {
                enough |= point.is_kept_by(shows) && !is_among_first(point);
                !enough
            });
        }
        points
    }

    /// Lit cells and those beside them, to be split; and lit cells that are too dim to be.
    fn worth_splitting(&self, state: &State<'_>) -> (BTreeSet<Cell>, BTreeSet<Cell>) {
        if !self.shortcuts.takes(Shortcut::DarkCells) {
            return (state.cells.iter().copied().collect(), BTreeSet::new());
        }
        let mut lit: Vec<(f32, Cell)> = state
            .cells
            .iter()
            .zip(&state.radiance)
            .zip(&state.design.geometry.solid_angles)
            .map(|((&cell, l), w)| (w * l.iter().sum::<f32>(), cell))
            .filter(|(flux, _)| *flux > 0.0)
            .collect();
        lit.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let total: f32 = lit.iter().map(|(flux, _)| flux).sum();
        lit.retain(|(flux, _)| *flux > DARK_SHARE * total);
        let present: BTreeSet<Cell> = state.cells.iter().copied().collect();
        let (mut split, mut kept) = (BTreeSet::new(), BTreeSet::new());
        let mut count = 0;
        for (flux, cell) in lit {
            if count >= MOST_CELLS || flux < LEAST_SHARE * total {
                kept.insert(cell);
                continue;
            }
            let beside = self
                .pyramid
                .neighbours(cell)
                .filter(|n| present.contains(n));
            for c in std::iter::once(cell).chain(beside) {
                if split.insert(c) {
                    count += self.pyramid.children(c).count();
                }
            }
        }
        let kept = kept.difference(&split).copied().collect();
        (split, kept)
    }

    /// The same lights and σ on other points.
    fn on_points<'s>(&'s self, state: &State<'_>, observations: &'s Observations) -> State<'s> {
        state.on(self.shadowed_design(observations, &state.cells, &state.brdf))
    }

    /// A design that knows which points each cell reaches.
    pub fn shadowed_design<'s>(
        &'s self,
        observations: &'s Observations,
        cells: &[Cell],
        brdf: &Brdf,
    ) -> Design<'s> {
        let mut design = self.design(observations, cells);
        design.seen = cell_visibility(&design, self.pyramid, cells, brdf, self.occluder);
        design
    }

    /// A design of the coarsest cells that knows which of them the coarse points see, whatever the lobe. `observations` are these points,
    /// whatever they show.
    pub fn coarse_design<'s>(&'s self, observations: &'s Observations) -> Design<'s> {
        let sees = || self.roots_design(observations, self.near).seen;
        Design {
            seen: self.coarse_sees.get_or_init(sees).clone(),
            ..self.design(observations, &self.roots())
        }
    }

    /// A design of the coarsest cells that knows which of them its points see, whatever the lobe; of lights that are `near` or distant.
    pub fn roots_design<'s>(
        &'s self,
        observations: &'s Observations,
        near: Option<(Vec3, f32)>,
    ) -> Design<'s> {
        let roots = self.roots();
        let mut design = Design {
            near,
            ..self.design(observations, &roots)
        };
        design.seen = cell_visibility(&design, self.pyramid, &roots, &WIDEST, self.occluder);
        design
    }

    /// Splits lit cells and those beside them, drops dark ones and looks for shadows.
    pub fn refine<'s>(&'s self, state: &State<'_>, observations: &'s Observations) -> State<'s> {
        let (split, kept) = self.worth_splitting(state);
        let mut cells: Vec<Cell> = kept.into_iter().collect();
        for &cell in &split {
            let before = cells.len();
            cells.extend(self.pyramid.children(cell));
            if cells.len() == before {
                cells.push(cell);
            }
        }
        cells.sort_unstable();
        let design = self.shadowed_design(observations, &cells, &state.brdf);
        State::new(design, cells, state.brdf)
    }

    /// Drops the cells that are more than [`MARGIN`] steps from a lit one.
    fn narrow<'s>(&self, state: &State<'s>) -> State<'s> {
        let mut near: BTreeSet<Cell> = state
            .cells
            .iter()
            .zip(&state.radiance)
            .filter(|(_, l)| l.iter().any(|&v| v > 0.0))
            .map(|(&cell, _)| cell)
            .collect();
        for _ in 0..MARGIN {
            let beside: Vec<Cell> = near
                .iter()
                .flat_map(|&c| self.pyramid.neighbours(c))
                .collect();
            near.extend(beside);
        }
        state.restricted(|cell| near.contains(cell))
    }

    /// Counts a state as an iteration and shows it to the observer.
    pub fn report(&self, state: &State<'_>, watch: &mut Watch<'_>) -> Result<(), Stopped> {
        let scale = self.coarse.scale;
        let iteration = Iteration {
            iteration: watch.iterations.len() as u32 + 1,
            elapsed_s: self.started.elapsed().as_secs_f64(),
            objective: state.objective() * f64::from(scale).powi(2),
            sigma: state.brdf.sigma,
            residual_rms: state.rms() * scale,
        };
        watch.iterations.push(iteration);
        go_on(
            watch
                .observer
                .iteration(&iteration, &|| self.nodes(&state.cells, &state.radiance)),
        )
    }

    /// Radiance of each node, RGB, in the capture's units, by that of cells in units of the observations' scale.
    pub fn nodes(&self, cells: &[Cell], radiance: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let mut nodes = self.pyramid.to_nodes(cells, radiance);
        for value in nodes.iter_mut().flatten() {
            *value *= self.coarse.scale;
        }
        nodes
    }
}
