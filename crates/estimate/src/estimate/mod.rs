//! The inverse problem: roughness and lighting from differences between views.
//!
//! [`estimate`] runs one of the methods on a capture. All of them minimise over radiances L ≥ 0 on the nodes of a
//! geodesic hemisphere and the roughness σ of a specular lobe (eq. 17); they differ in how. Results are K_S-scaled:
//! K_S = 1, because it can't be told from the lights' strength.

mod alternating;
mod below;
mod broad_light;
pub mod cells;
mod course;
pub mod design;
mod diagnose;
mod ellipse;
mod exposures;
mod fast;
mod gloss;
mod gram;
mod held_lights;
mod held_out;
mod highlights;
mod known_light;
mod lamps;
pub mod lobes;
mod merging;
pub mod misfit;
mod near;
mod neighbours;
pub mod observations;
mod observer;
mod relief;
mod shading;
mod soft_gloss;
mod sparse_gloss;
mod spread;
mod state;
mod strengths;
mod support;
mod suspects;
mod tints;
mod total_variation;
mod turntable;
mod under_shading;
pub mod visibility;
mod weights;
pub mod workspace;

#[cfg(test)]
mod tests;

use std::ops::RangeInclusive;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::registration;
use rekindle_base::math::ranks::{SURE, signed_ranks};
use rekindle_capture::{Capture, View};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::shortcuts::{LeftOut, ShortcutSet, Shortcuts};
use rekindle_scene::surface::{GlossParts, Occluder, ViewSurface};

use alternating::{Order, Terms};
use cells::Pyramid;
use course::{Ending, Grounds, Outcome, Rules};
pub use diagnose::OFF_NORMALS;
pub use exposures::ExposuresByLights;
use exposures::by_lights;
use fast::{Fit, Solver, Watch};
use held_out::relatively_left_out;
pub use known_light::{GivenLight, UnderGivenLight, estimate_under};
pub use observations::Mirrored;
use observations::Motion;
use observer::go_on;
pub use observer::{Interim, Iteration, Observer, Stopped, Unobserved};
pub use observer::{Watcher, watched};
pub use relief::RefinedSurface;
use suspects::Suspicion;
use turntable::Turning;
use workspace::Workspace;

/// How the minimum is sought.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Variable projection with the diffuse colours eliminated.
    #[default]
    Fast,
    /// The paper's alternating minimisation, lights first.
    Amuh,
    /// The paper's alternating minimisation, roughness first.
    Amhu,
    /// The paper's least squares (eq. 8), minimised as by AMUH: without M-estimator and without regularisation.
    Plain,
}

/// Which specular model to use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpecularChoice {
    /// This one.
    Model(SpecularModel),
    /// Whichever leaves less unexplained.
    #[default]
    Auto,
}

impl SpecularChoice {
    /// The models to compare: the one asked for, or those where none is.
    pub fn or<'a>(&'a self, models: &'a [SpecularModel]) -> &'a [SpecularModel] {
        match self {
            Self::Model(model) => std::slice::from_ref(model),
            Self::Auto => models,
        }
    }
}

/// Roughnesses that can be stated: a smoother surface is a mirror, whose highlights no picture resolves, and a rougher one has none.
pub const STATED_ROUGHNESS: RangeInclusive<f32> = 0.07..=0.9;

/// What an estimation is asked to do.
#[derive(Clone, Copy, Debug, Default)]
pub struct EstimateParams {
    /// The method.
    pub method: Method,
    /// The specular model.
    pub specular: SpecularChoice,
    /// σ of the lobe in radians, where it is stated; it is estimated otherwise.
    pub sigma: Option<f32>,
    /// Whether cameras and exposures are taken as the capture states them, even where they do not fit each other.
    pub as_stated: bool,
    /// Shortcuts that are not taken: what they leave out is done.
    pub avoided: ShortcutSet,
}

/// What an estimation works on.
#[derive(Clone, Copy)]
pub struct EstimateInput<'a> {
    /// Photographs, cameras and mesh.
    pub capture: &'a Capture,
    /// What each view sees, one per view.
    pub surfaces: &'a [ViewSurface],
    /// The object, for shadows.
    pub occluder: &'a Occluder,
    /// Nodes on which the lights are sought first, above the horizon.
    pub grid: &'a HemisphereGrid,
    /// What a first estimate has found of it.
    pub first: Option<First<'a>>,
}

/// A first estimate of a surface that mirrors itself, to go on from.
#[derive(Clone, Copy)]
pub struct First<'a> {
    /// Its steps, and its lobe, whose form is kept.
    pub estimate: &'a Estimate,
    /// What the surface mirrors of itself in the light that was found, which was taken for direct light.
    pub mirrored: Mirrored<'a>,
}

/// What can be said of an estimate's worth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Diagnostics {
    /// Whether the data determine roughness and lighting.
    pub well_posed: bool,
    /// Whether there is a specular part at all.
    pub specular_found: bool,
    /// What a user should know, in whole sentences.
    pub warnings: Vec<String>,
}

/// Roughness and lighting.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The method that found it.
    pub method: Method,
    /// Specular model and roughness; `None` where no specular part was found.
    pub brdf: Option<Brdf>,
    /// 95 % interval of σ, radians.
    pub sigma_interval95: Option<[f32; 2]>,
    /// The nodes: those of the input, with those below the horizon where light comes from there.
    pub grid: HemisphereGrid,
    /// Radiance per node of the grid, RGB, in the capture's units; without a specular part what the
    /// shading says, or all zero.
    pub radiance: Vec<[f32; 3]>,
    /// The nodes that belong to the broad light that a metal mirrors beside its lights, ascending; none of any other surface.
    pub broad_light: Vec<u32>,
    /// What it is worth.
    pub diagnostics: Diagnostics,
    /// Every iteration.
    pub convergence: Vec<Iteration>,
    /// Parts of the surface whose gloss differs from the main one, which `brdf` is; `None` where it has one for all.
    pub parts: Option<GlossParts>,
    /// Irradiance of the diffuse layer by light from everywhere, RGB in the lights' units, where the light stands still with the camera.
    /// Elsewhere it is read off the textures.
    pub ambient_irradiance: Option<Vec3>,
    /// Why this specular model, in a sentence.
    pub chosen_because: String,
    /// The surface that all this holds for, where it isn't the capture's mesh: that one is too coarse or noisy.
    pub refined: Option<RefinedSurface>,
    /// How much brighter each view was found to be than the common scale on which all this holds; empty where they agree.
    pub exposures: Vec<f64>,
    /// What it leaves of the differences between views beyond noise, as a part of them; see [`misfit`]. Nothing where there are no
    /// lights, or they are not of the default method.
    pub misfit: Option<f64>,
    /// The view that contradicts the others, where one is suspected to.
    pub odd_view: Option<usize>,
    /// What was left out.
    pub left_out: Vec<LeftOut>,
}

impl Estimate {
    /// Nothing found.
    fn dark(method: Method, grid: &HemisphereGrid) -> Self {
        Self {
            method,
            brdf: None,
            sigma_interval95: None,
            grid: grid.clone(),
            radiance: vec![[0.0; 3]; grid.directions.len()],
            broad_light: Vec::new(),
            diagnostics: Diagnostics::default(),
            convergence: Vec::new(),
            parts: None,
            ambient_irradiance: None,
            chosen_because: String::new(),
            refined: None,
            exposures: Vec::new(),
            misfit: None,
            odd_view: None,
            left_out: Vec::new(),
        }
    }

    /// Whether the surface or a part of it is of metal.
    pub fn has_metal(&self) -> bool {
        (self.brdf.as_ref()).is_some_and(|main| has_metal(main, self.parts.as_ref()))
    }
}

/// Whether a surface with this main lobe, or a part of it, is of metal.
fn has_metal(main: &Brdf, parts: Option<&GlossParts>) -> bool {
    let mut glosses = parts.into_iter().flat_map(|parts| &parts.glosses);
    main.is_metal() || glosses.any(|gloss| main.at(*gloss).is_metal())
}

/// Estimates roughness and lighting of a capture.
///
/// A capture that can't tell them is no error: the result then has no specular part and its diagnostics say why.
pub fn estimate(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    observer: &mut dyn Observer,
) -> Result<Estimate, Stopped> {
    watched(observer, |watcher| {
        let shortcuts = Shortcuts::without(params.avoided);
        let mut result = match Reduced::of(input) {
            Some(reduced) => begin(&reduced.input(input), params, &shortcuts, watcher),
            None => begin(input, params, &shortcuts, watcher),
        }?;
        result.left_out = shortcuts.counted();
        // What long sums give after a stop is of no use.
        if watcher.stop().load(Ordering::Relaxed) {
            return Err(Stopped);
        }
        Ok(result)
    })
}

/// What lights found in some views leave of the others, at each of many points and as a part of its radiance: where views are exposed
/// alike it is less.
pub fn left_of_others(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    observer: &mut dyn Observer,
) -> Result<Vec<f64>, Stopped> {
    with_reduced(input, params, observer, |solver, watch| {
        // Any lobe will do to see whether views agree on lights.
        let model = match params.specular {
            SpecularChoice::Model(model) => model,
            SpecularChoice::Auto => SpecularModel::Paper,
        };
        let fit = course::asked_for(solver, model, watch)?;
        Ok(relatively_left_out(solver, &fit.state))
    })
}

/// Whether lights found in views that are evened out predict others better, beyond chance, than lights found in them as they were: what a
/// polished surface mirrors differs from view to view as if these were exposed differently. Both as [`left_of_others`] has it.
pub fn bears_out(evened: &[f64], before: &[f64]) -> bool {
    signed_ranks(before, evened) > SURE
}

/// The views' exposures that fit lights best; `None` where some views share too little with others.
pub fn gains_by_lights(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    observer: &mut dyn Observer,
) -> Result<Option<ExposuresByLights>, Stopped> {
    with_reduced(input, params, observer, |solver, _| {
        // One without a diffuse part and one with it.
        let models = [SpecularModel::Metal, SpecularModel::Ggx];
        Ok(by_lights(solver, params.specular.or(&models)))
    })
}

/// Asks something of a solver of no more pixels than lights need, without anybody told of its steps.
fn with_reduced<R: Send>(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    observer: &mut dyn Observer,
    ask: impl FnOnce(&Solver<'_>, &mut Watch<'_>) -> Result<R, Stopped> + Send,
) -> Result<R, Stopped> {
    watched(observer, |watcher| {
        let stop = watcher.stop();
        let reduced = Reduced::of(input);
        let input = reduced.as_ref().map_or(*input, |r| r.input(input));
        let pyramid = Pyramid::new(input.grid, fast::COARSEST);
        let (shortcuts, workspace) = (Shortcuts::without(params.avoided), Workspace::new());
        let with = (&shortcuts, &workspace);
        let now = Instant::now();
        let solver = Solver::new(&input, params.sigma, &pyramid, with, None, now, stop);
        let mut watch = Watch {
            iterations: &mut Vec::new(),
            observer: &mut Unobserved,
        };
        let answer = ask(&solver, &mut watch)?;
        if stop.load(Ordering::Relaxed) {
            return Err(Stopped);
        }
        Ok(answer)
    })
}

/// Whether the diffuse part says that the light stands still with the camera, as on a turntable, where the capture doesn't say.
pub fn stands_with_camera(
    input: &EstimateInput<'_>,
    observer: &mut dyn Observer,
) -> Result<bool, Stopped> {
    let turned = input.capture.motions_of_camera();
    watched(observer, |watcher| {
        let stop = watcher.stop();
        let reduced = Reduced::of(input);
        let input = reduced.as_ref().map_or(*input, |r| r.input(input));
        let pyramid = Pyramid::new(input.grid, fast::COARSEST);
        let (shortcuts, workspace) = (Shortcuts::default(), Workspace::new());
        let turning = Turning {
            motions: turned.iter().map(Motion::new).collect(),
            irradiance: None,
            is_provisional: true,
        };
        let with = (&shortcuts, &workspace);
        let now = Instant::now();
        let solver = Solver::new(&input, None, &pyramid, with, Some(&turning), now, stop);
        let told = turntable::is_told(&solver);
        if stop.load(Ordering::Relaxed) {
            return Err(Stopped);
        }
        Ok(told)
    })
}

/// Pixels of the object in the largest of the views from which on these are looked at in fewer: lights of pictures with 0.1 to 12
/// megapixels come out the same, and what a mesh is off by is fewer pixels then.
const MOST_PIXELS: usize = 400_000;

/// A capture with fewer pixels than it was given with.
struct Reduced {
    capture: Capture,
    surfaces: Vec<ViewSurface>,
}

impl Reduced {
    /// Where the views of `input` have more pixels than lights need.
    fn of(input: &EstimateInput<'_>) -> Option<Self> {
        let object = |surface: &ViewSurface| surface.interior.iter().filter(|&&i| i).count();
        let largest = input.surfaces.iter().map(object).max().unwrap_or(0);
        let factor = (largest as f64 / MOST_PIXELS as f64).sqrt().ceil() as u32;
        if factor < 2 {
            return None;
        }
        let views = input.capture.views.iter();
        let views: Vec<View> = views.map(|view| view.in_blocks(factor)).collect();
        let see = |view: &View| ViewSurface::new(&input.capture.mesh, input.occluder, &view.camera);
        Some(Self {
            surfaces: views.par_iter().map(see).collect(),
            capture: Capture {
                views,
                ..input.capture.clone()
            },
        })
    }

    fn input<'a>(&'a self, of: &EstimateInput<'a>) -> EstimateInput<'a> {
        EstimateInput {
            capture: &self.capture,
            surfaces: &self.surfaces,
            ..*of
        }
    }
}

/// Half the 95 % interval of σ in standard errors. Were the model exact and rows independent it would be 1.96; with
/// photographs' pixels, meshes and interpolation in between, 1.96 held the truth in half of 120 made captures. This, chosen on
/// 60, held it in 92.5, 97 and 98.5 % of 200 each with 0.3, 1 and 3 % of noise (`rekindle study --only coverage`).
const HALF_INTERVAL: f32 = 5.5;

/// Rounds in which the lights found and the views' exposures take turns.
const MOST_ROUNDS: usize = 3;

/// What a run goes on from.
struct Start {
    clock: Instant,
    convergence: Vec<Iteration>,
    /// What the views were divided by, after how many rounds.
    exposures: Vec<f64>,
    rounds: usize,
}

impl Default for Start {
    fn default() -> Self {
        Self {
            clock: Instant::now(),
            convergence: Vec::new(),
            exposures: Vec::new(),
            rounds: 0,
        }
    }
}

impl Start {
    /// Goes on from where a first estimate ended.
    fn after(first: First<'_>) -> Self {
        let convergence = first.estimate.convergence.clone();
        let elapsed = convergence.last().map_or(0.0, |last| last.elapsed_s);
        let now = Instant::now();
        let began = now.checked_sub(Duration::from_secs_f64(elapsed));
        Self {
            clock: began.unwrap_or(now),
            convergence,
            ..Self::default()
        }
    }
}

/// Runs a method from the beginning, or from where a first estimate ended.
fn begin(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    shortcuts: &Shortcuts,
    watcher: &Watcher<'_>,
) -> Result<Estimate, Stopped> {
    if let Some(motions) = input.capture.motions() {
        let motions = motions.iter().map(Motion::new).collect();
        on_turntable(input, params, shortcuts, watcher, motions)
    } else {
        let start = input.first.map_or_else(Start::default, Start::after);
        run(input, params, shortcuts, watcher, (start, None))
    }
}

/// Runs a method where the light stands still with the camera; see [`turntable`].
fn on_turntable<'o>(
    input: &EstimateInput<'o>,
    params: &EstimateParams,
    shortcuts: &Shortcuts,
    mut watcher: &Watcher<'_>,
    motions: Vec<Motion>,
) -> Result<Estimate, Stopped> {
    let pyramid = Pyramid::new(input.grid, fast::COARSEST);
    let workspace = Workspace::new();
    let (clock, stop) = (Instant::now(), watcher.stop());
    let with = (shortcuts, &workspace);
    let observer: &mut dyn Observer = &mut watcher;
    go_on(observer.progress("looking at the shading", 0.0))?;
    let mut turning = Turning {
        motions,
        irradiance: None,
        is_provisional: input.first.is_none(),
    };
    let told_by = |found: &Estimate, turning: &Turning<'o>| {
        let sigma = found.brdf.map(|brdf| brdf.sigma);
        let solver = Solver::new(input, sigma, &pyramid, with, Some(turning), clock, stop);
        turntable::from_lights(&solver, input.occluder, found)
    };
    let (mut start, by_diffuse) = if let Some(first) = input.first {
        turning.irradiance = told_by(first.estimate, &turning).map(|told| told.0);
        (Start::after(first), None)
    } else {
        let sigma = params.sigma;
        let solver = Solver::new(input, sigma, &pyramid, with, Some(&turning), clock, stop);
        let told = turntable::from_diffuse(&solver, input.occluder);
        turning.irradiance = Some(told.irradiance);
        let start = Start {
            clock,
            ..Start::default()
        };
        (start, Some((told.grid, told.nodes, told.ambient)))
    };
    loop {
        let mut found = run(input, params, shortcuts, watcher, (start, Some(&turning)))?;
        if found.brdf.is_none() {
            if let Some((grid, nodes, ambient)) = by_diffuse {
                let said = diagnose::BY_DIFFUSE.to_owned();
                found.diagnostics.warnings.push(said);
                (found.grid, found.radiance) = (grid, nodes);
                found.ambient_irradiance = Some(ambient);
            }
            return Ok(found);
        }
        let Some((irradiance, ambient)) = told_by(&found, &turning) else {
            return Ok(found);
        };
        if !turning.is_provisional {
            found.ambient_irradiance = Some(ambient);
            return Ok(found);
        }
        turning.irradiance = Some(irradiance);
        turning.is_provisional = false;
        start = Start {
            clock,
            convergence: found.convergence,
            ..Start::default()
        };
    }
}

fn run(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    shortcuts: &Shortcuts,
    mut watcher: &Watcher<'_>,
    (start, turning): (Start, Option<&Turning<'_>>),
) -> Result<Estimate, Stopped> {
    let stop = watcher.stop();
    let observer: &mut dyn Observer = &mut watcher;
    let grid = input.grid;
    let pyramid = Pyramid::new(grid, fast::COARSEST);
    let workspace = Workspace::new();
    let solver = Solver {
        is_lobe_asked_for: params.specular != SpecularChoice::Auto,
        ..Solver::new(
            input,
            params.sigma,
            &pyramid,
            (shortcuts, &workspace),
            turning,
            start.clock,
            stop,
        )
    };
    let mut result = Estimate {
        convergence: start.convergence,
        exposures: start.exposures.clone(),
        ..Estimate::dark(params.method, grid)
    };
    if let Some(reason) = diagnose::unseparable(input.capture, &solver.coarse) {
        result.diagnostics.warnings.push(reason);
        return Ok(result);
    }
    let way = match params.method {
        Method::Fast => None,
        Method::Amuh => Some((Order::LightsFirst, Terms::Robust)),
        Method::Amhu => Some((Order::LobeFirst, Terms::Robust)),
        Method::Plain => Some((Order::LightsFirst, Terms::Squares)),
    };
    if let Some(way) = way {
        alternate(&mut result, &solver, grid, way, params.specular, observer)?;
        return Ok(result);
    }
    let mut watch = Watch {
        iterations: &mut result.convergence,
        observer,
    };
    // Where the light turns, what differs between views is that as well.
    let evens = !params.as_stated
        && start.rounds < MOST_ROUNDS
        && input.first.is_none()
        && turning.is_none();
    let lobe = input.first.and_then(|first| first.estimate.brdf);
    let rules = Rules {
        choice: lobe.map_or(params.specular, |lobe| SpecularChoice::Model(lobe.model)),
        exposures: evens.then_some(start.rounds > 0),
    };
    match course::run(&solver, rules, &mut watch)? {
        Outcome::Nothing(reason, by_shading) => {
            result.diagnostics.warnings.push(reason);
            if let Some(light) = by_shading {
                let said = diagnose::BY_SHADING.to_owned();
                result.diagnostics.warnings.push(said);
                (result.grid, result.radiance) = (light.grid().clone(), light.nodes().to_vec());
            }
        }
        Outcome::Found(ending) => {
            let ended = watch.observer.enough();
            let brdf = ending.fit.brdf;
            accept(&mut result, &solver, *ending);
            if let Some(first) = input.first {
                (result.chosen_because).clone_from(&first.estimate.chosen_because);
                if brdf.model == SpecularModel::Metal && turning.is_none() && !ended {
                    go_on(observer.progress("looking for broad light", 0.95))?;
                    if let Some(found) = broad_light::beside(&solver, brdf, &result.radiance)? {
                        result.grid = found.grid;
                        result.radiance = found.nodes;
                        result.broad_light = found.own;
                    }
                }
            }
            if ended {
                let warnings = &mut result.diagnostics.warnings;
                warnings.push(diagnose::ENDED_EARLY.to_owned());
            }
        }
        Outcome::Exposures(factors) => {
            let evened = registration::evened(input.capture, &factors);
            let start = Start {
                clock: solver.started,
                convergence: result.convergence,
                exposures: exposures::together(&result.exposures, factors),
                rounds: start.rounds + 1,
            };
            let input = EstimateInput {
                capture: &evened,
                ..*input
            };
            return run(&input, params, shortcuts, watcher, (start, turning));
        }
    }
    Ok(result)
}

/// Runs one of the paper's reference methods; the paper's lobe is theirs unless another is asked for.
fn alternate(
    result: &mut Estimate,
    solver: &Solver<'_>,
    grid: &HemisphereGrid,
    way: (Order, Terms),
    choice: SpecularChoice,
    observer: &mut dyn Observer,
) -> Result<(), Stopped> {
    let (model, because) = match choice {
        SpecularChoice::Model(model) => (model, "it was asked for"),
        SpecularChoice::Auto => (SpecularModel::Paper, "it is the one of the paper's method"),
    };
    let mut watch = Watch {
        iterations: &mut result.convergence,
        observer,
    };
    watch.observer.interim(Interim::Lobe(model));
    let Some(solution) = alternating::solve(solver, grid, way, model, &mut watch)? else {
        result
            .diagnostics
            .warnings
            .push(diagnose::NO_SPECULAR.to_owned());
        return Ok(());
    };
    because.clone_into(&mut result.chosen_because);
    result.diagnostics.well_posed = true;
    result.diagnostics.specular_found = true;
    result.brdf = Some(solution.brdf);
    result.radiance = solution.nodes;
    Ok(())
}

/// Takes over what was found, with what is to be said of it.
fn accept(result: &mut Estimate, solver: &Solver<'_>, ending: Ending) {
    let Ending {
        fit,
        because,
        refined,
        suspicion,
        bound,
        allowed,
        grid,
        broad_light,
        grounds,
        agreement,
    } = ending;
    let sigma = fit.brdf.sigma;
    let by_noise = HALF_INTERVAL * fit.noise_error / sigma;
    let suspicion = suspicion
        .as_ref()
        .filter(|s| diagnose::is_worth_saying(s, &fit.misfit, by_noise));
    result.odd_view = suspicion.and_then(Suspicion::view);
    // No curvature, no end.
    let undetermined = diagnose::is_undetermined(&fit).then_some(course::ROUGHEST.max(sigma));
    let bound = bound.or(undetermined);
    result.chosen_because = because;
    result.refined = refined;
    result.sigma_interval95 = match (solver.sigma, bound) {
        (Some(_), _) => None,
        (None, Some(roughest)) => Some([0.0, roughest]),
        (None, None) => Some(interval(&fit, allowed, suspicion)),
    };
    let open = bound
        .filter(|_| grounds != Grounds::BroadLight)
        .map(|_| diagnose::OPEN.to_owned());
    let unconfirmed = diagnose::grounds(grounds).map(str::to_owned);
    let stated = solver.near.map(|(_, radius)| radius);
    // A cause that has a name is said in place of what it leaves.
    let suspected = suspicion.map(|s| diagnose::suspicion(s, stated, solver.seen.views));
    let misfit = match &suspected {
        Some(_) => None,
        None => diagnose::misfit(&fit.misfit, agreement),
    };
    let (doubted, noted) = if diagnose::is_doubted(&fit.misfit, agreement) {
        (misfit, None)
    } else {
        (None, misfit)
    };
    let unresolved = diagnose::unresolved(&solver.seen, &fit);
    let doubts = [unconfirmed, open, suspected, doubted, unresolved];
    result.diagnostics.well_posed = doubts.iter().all(Option::is_none);
    let refined = result.refined.as_ref().map(diagnose::refined);
    let metal = (fit.brdf.model == SpecularModel::Metal).then(|| diagnose::METAL.to_owned());
    let warnings = refined.into_iter().chain(metal).chain(noted);
    let warnings = warnings.chain(doubts.into_iter().flatten());
    result.diagnostics.warnings.extend(warnings);
    result.misfit = Some(fit.misfit.share);
    result.diagnostics.specular_found = true;
    result.brdf = Some(fit.brdf);
    if let Some(parts) = &fit.parts {
        result.chosen_because += &diagnose::parts(parts, sigma);
        result.chosen_because += diagnose::metals(parts, &fit.brdf);
    }
    result.broad_light = broad_light;
    result.grid = grid;
    result.radiance = fit.nodes;
    result.parts = fit.parts;
}

/// The 95 % interval of σ, of which some factors are as good as none.
fn interval(fit: &Fit, allowed: [f32; 2], suspicion: Option<&Suspicion>) -> [f32; 2] {
    let sigma = fit.brdf.sigma;
    let half_width = HALF_INTERVAL * fit.sigma_error;
    let mut interval = [
        (sigma - half_width).min(allowed[0] * sigma),
        (sigma + half_width).max(allowed[1] * sigma),
    ];
    if let Some(suspicion) = suspicion {
        // Under the other assumption it would be another.
        let other = suspicion.sigma_ratio * sigma;
        interval = [interval[0].min(other), interval[1].max(other)];
    }
    interval.map(|end| end.max(0.0))
}
