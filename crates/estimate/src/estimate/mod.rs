//! The inverse problem: roughness and lighting from differences between views.
//!
//! [`estimate`] runs one of the methods on a capture. All of them minimise over radiances L ≥ 0 on the nodes of a
//! geodesic hemisphere and the roughness σ of a specular lobe (eq. 17); they differ in how. Results are K_S-scaled:
//! K_S = 1, because it can't be told from the lights' strength.

mod alternating;
pub mod cells;
pub mod design;
mod diagnose;
mod ellipse;
mod exposures;
mod fast;
mod gloss;
mod gram;
mod lamps;
pub mod lobes;
mod merging;
pub mod misfit;
pub mod observations;
mod observer;
mod relief;
mod spread;
mod state;
mod strengths;
mod support;
mod suspects;
mod total_variation;
pub mod visibility;
mod weights;
pub mod workspace;

#[cfg(test)]
mod tests;

use std::sync::atomic::Ordering;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::registration;
use rekindle_capture::Capture;
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::shortcuts::{LeftOut, Shortcut, ShortcutSet, Shortcuts};
use rekindle_scene::surface::{GlossParts, Occluder, ViewSurface};

use alternating::{Order, Terms};
use cells::Pyramid;
use fast::{CoarseFit, Fit, Solver, Watch};
use observations::Seen;
pub use observer::{Interim, Iteration, Observer, Stopped, Unobserved};
pub use observer::{Watcher, watched};
use relief::Bench;
pub use relief::RefinedSurface;
use suspects::{SURE, Suspicion, left, signed_ranks};
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

/// What an estimation is asked to do.
#[derive(Clone, Copy, Debug, Default)]
pub struct EstimateParams {
    /// The method.
    pub method: Method,
    /// The specular model.
    pub specular: SpecularChoice,
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
    /// Nodes on which the lights are sought.
    pub grid: &'a HemisphereGrid,
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
    /// Radiance per node of the grid, RGB, in the capture's units; all zero without a specular part.
    pub radiance: Vec<[f32; 3]>,
    /// What it is worth.
    pub diagnostics: Diagnostics,
    /// Every iteration.
    pub convergence: Vec<Iteration>,
    /// Parts of the surface whose gloss differs from the main one, which `brdf` is; `None` where it has one for all.
    pub parts: Option<GlossParts>,
    /// Why this specular model, in a sentence.
    pub chosen_because: String,
    /// The surface that all this holds for, where it isn't the capture's mesh: that one is too coarse or noisy.
    pub refined: Option<RefinedSurface>,
    /// How much brighter each view was found to be than the common scale on which all this holds; empty where they agree.
    pub exposures: Vec<f64>,
    /// What it leaves of the differences between views beyond noise, as a part of them; see [`misfit`]. Nothing where there are no
    /// lights, or they are not of the default method.
    pub misfit: Option<f64>,
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
            radiance: vec![[0.0; 3]; grid.directions.len()],
            diagnostics: Diagnostics::default(),
            convergence: Vec::new(),
            parts: None,
            chosen_because: String::new(),
            refined: None,
            exposures: Vec::new(),
            misfit: None,
            left_out: Vec::new(),
        }
    }
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
        let mut result = run(input, params, &shortcuts, watcher, Start::default())?;
        result.left_out = shortcuts.counted();
        // What long sums give after a stop is of no use.
        if watcher.stop().load(Ordering::Relaxed) {
            return Err(Stopped);
        }
        Ok(result)
    })
}

/// Half the 95 % interval of σ in standard errors. Were the model exact and rows independent it would be 1.96; with
/// photographs' pixels, meshes and interpolation in between, 1.96 held the truth in half of 120 made captures. This, chosen on
/// 60, held it in 92.5, 97 and 98.5 % of 200 each with 0.3, 1 and 3 % of noise (`rekindle study --only coverage`).
const HALF_INTERVAL: f32 = 5.5;

/// A specular model that leaves so many times as much as another at the best of a few roughnesses is not improved. In 67
/// captures, rendered and made, the true model left less there every time; improving both turned that round once.
const CLEARLY_LESS: f64 = 1.25;

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

fn run(
    input: &EstimateInput<'_>,
    params: &EstimateParams,
    shortcuts: &Shortcuts,
    mut watcher: &Watcher<'_>,
    start: Start,
) -> Result<Estimate, Stopped> {
    let stop = watcher.stop();
    let observer: &mut dyn Observer = &mut watcher;
    let grid = input.grid;
    let pyramid = Pyramid::new(grid, fast::COARSEST);
    let seen = Seen {
        mesh: &input.capture.mesh,
        views: &input.capture.views,
        surfaces: input.surfaces,
        parts: None,
    };
    let workspace = Workspace::new();
    let solver = Solver {
        seen,
        occluder: input.occluder,
        grid,
        pyramid: &pyramid,
        near: grid.radius.map(|r| (grid.centre, r)),
        coarse: Solver::coarse_observations(&seen, None, stop),
        started: start.clock,
        shortcuts,
        workspace: &workspace,
        stop,
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
    let (coarse, because) = choose(&solver, params.specular, &SpecularModel::ALL, &mut watch)?;
    let patches = patches(&solver, &coarse, params.specular, &mut watch)?;
    let parted = patches.as_ref().map(|parts| solver.parted(parts));
    let on_patches = match &parted {
        Some(solver) => Some(choose(
            solver,
            params.specular,
            &SpecularModel::ALL,
            &mut watch,
        )?),
        None => None,
    };
    let (solver, coarse, because) = match (&parted, on_patches) {
        (Some(parted), Some((fit, because))) if explains_better(&fit, &coarse) => {
            (parted, fit, because)
        }
        _ => (&solver, coarse, because),
    };
    let refused = diagnose::no_specular(&coarse.state).or_else(|| diagnose::not_sharp(&coarse));
    if let Some(reason) = refused {
        result.diagnostics.warnings.push(reason);
        return Ok(result);
    }
    let views = input.capture.views.len();
    if !params.as_stated
        && start.rounds < MOST_ROUNDS
        && let Some(factors) = exposures::differing(&coarse.state, views, start.rounds > 0)
    {
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
        return run(&input, params, shortcuts, watcher, start);
    }
    let ending = end(solver, &coarse, because, params.specular, &mut watch)?;
    let ended = watch.observer.enough();
    result.chosen_because = ending.because;
    result.refined = ending.refined;
    accept(&mut result, solver, ending.fit, ending.suspicion.as_ref());
    if ended {
        let warnings = &mut result.diagnostics.warnings;
        warnings.push(diagnose::ENDED_EARLY.to_owned());
    }
    Ok(result)
}

/// What a coarse fit comes to.
struct Ending {
    fit: Fit,
    because: String,
    refined: Option<RefinedSurface>,
    suspicion: Option<Suspicion>,
}

/// Goes on from a coarse fit, chosen `because`, to the end, on a refined surface where the mesh is too coarse or noisy.
fn end(
    solver: &Solver<'_>,
    coarse: &CoarseFit<'_>,
    because: String,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Ending, Stopped> {
    let refined = if diagnose::doubts_normals(&coarse.state) {
        relief::refine(solver, coarse, choice, watch)?
    } else {
        None
    };
    let on_refined = match &refined {
        Some(surface) => fit_on(surface, solver, coarse, choice, watch)?,
        None => None,
    };
    let (fit, because, refined) = match on_refined {
        Some((fit, because)) => (fit, because, refined),
        None => (finish(solver, coarse, watch)?, because, None),
    };
    let suspicion = if !watch.observer.enough() && diagnose::is_middling(&fit.misfit) {
        solver.suspicion(&coarse.state)?
    } else {
        None
    };
    Ok(Ending {
        fit,
        because,
        refined,
        suspicion,
    })
}

/// Parts of the surface by the strength of their gloss, where one strength for all leaves so much that there may be some, and
/// many strengths clearly less.
fn patches(
    solver: &Solver<'_>,
    coarse: &CoarseFit<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<GlossParts>, Stopped> {
    if !diagnose::leaves_much(&coarse.state) || watch.observer.enough() {
        return Ok(None);
    }
    let Some(strengths) = solver.strengths(watch)? else {
        return Ok(None);
    };
    let parted = solver.parted(&strengths);
    let (fit, _) = choose(&parted, choice, &SpecularModel::ALL, watch)?;
    if !explains_better(&fit, coarse) {
        return Ok(None);
    }
    Ok(parted.gloss_parts(&fit.state).map(|(parts, _)| parts))
}

/// Whether one coarse fit leaves so much less than another that it is worth more unknowns.
fn explains_better(one: &CoarseFit<'_>, other: &CoarseFit<'_>) -> bool {
    one.unexplained < gloss::WORTH * other.unexplained
}

/// The fit on a refined surface, with the reason for its specular model; `None` unless it explains more than
/// `coarse`, the coarse fit on the solver's own surface, beyond chance.
fn fit_on(
    surface: &RefinedSurface,
    solver: &Solver<'_>,
    coarse: &CoarseFit<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<(Fit, String)>, Stopped> {
    let bench = Bench::new(&surface.mesh, solver.seen.views);
    let refined = bench.solver(solver, &surface.mesh);
    let (again, because) = choose(&refined, choice, &SpecularModel::ALL, watch)?;
    if signed_ranks(&left(&coarse.state), &left(&again.state)) <= SURE {
        return Ok(None);
    }
    Ok(Some((finish(&refined, &again, watch)?, because)))
}

/// Goes on from a coarse fit to the end.
fn finish(
    solver: &Solver<'_>,
    coarse: &CoarseFit<'_>,
    watch: &mut Watch<'_>,
) -> Result<Fit, Stopped> {
    let lobe = coarse.state.brdf.model;
    watch.observer.interim(Interim::Lobe(lobe));
    solver.fine_fit(&coarse.state, watch)
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

/// Takes over a fit if the data determine it.
fn accept(result: &mut Estimate, solver: &Solver<'_>, fit: Fit, suspicion: Option<&Suspicion>) {
    if let Some(reason) = diagnose::undetermined(&fit) {
        result.diagnostics.warnings.push(reason);
        return;
    }
    let sigma = fit.brdf.sigma;
    let half_width = HALF_INTERVAL * fit.sigma_error;
    let mut interval = [sigma - half_width, sigma + half_width];
    let by_noise = HALF_INTERVAL * fit.noise_error / sigma;
    let suspicion = suspicion.filter(|s| diagnose::is_worth_saying(s, &fit.misfit, by_noise));
    if let Some(suspicion) = suspicion {
        // Under the other assumption it would be another.
        let other = suspicion.sigma_ratio * sigma;
        interval = [interval[0].min(other), interval[1].max(other)];
    }
    let stated = solver.near.map(|(_, radius)| radius);
    // A cause that has a name is said in place of what it leaves.
    let misfit = match suspicion {
        Some(suspicion) => Some(diagnose::suspicion(suspicion, stated, solver.seen.views)),
        None => diagnose::misfit(&fit.misfit),
    };
    let doubts = [misfit, diagnose::unresolved(&solver.seen, &fit)];
    result.diagnostics.well_posed = doubts.iter().all(Option::is_none);
    let refined = result.refined.as_ref().map(diagnose::refined);
    let metal = (fit.brdf.model == SpecularModel::Metal).then(|| diagnose::METAL.to_owned());
    let warnings = refined.into_iter().chain(metal);
    let warnings = warnings.chain(doubts.into_iter().flatten());
    result.diagnostics.warnings.extend(warnings);
    result.misfit = Some(fit.misfit.share);
    result.diagnostics.specular_found = true;
    result.sigma_interval95 = Some(interval.map(|end| end.max(0.0)));
    result.brdf = Some(fit.brdf);
    result.radiance = fit.nodes;
    if let Some(parts) = &fit.parts {
        result.chosen_because += &diagnose::parts(parts, sigma);
    }
    result.parts = fit.parts;
}

/// The coarse fit of the model asked for, or of the one `among` others that leaves least, with the reason in words; the paper's
/// is always tried. Those that leave clearly more from the start are not improved.
fn choose<'s>(
    solver: &'s Solver<'_>,
    choice: SpecularChoice,
    among: &[SpecularModel],
    watch: &mut Watch<'_>,
) -> Result<(CoarseFit<'s>, String), Stopped> {
    if let SpecularChoice::Model(model) = choice {
        let mut fit = solver.compare_sigmas(model, None, watch)?;
        solver.improve_coarse(&mut fit, watch)?;
        return Ok((fit, "it was asked for".to_owned()));
    }
    let mut fits = vec![solver.compare_sigmas(SpecularModel::Paper, None, watch)?];
    if watch.observer.enough() {
        let because = "it was the only one tried before the end".to_owned();
        return Ok((fits.remove(0), because));
    }
    let near = Some(fits[0].state.brdf.sigma);
    for &model in among.iter().filter(|&&model| model != SpecularModel::Paper) {
        fits.push(solver.compare_sigmas(model, near, watch)?);
    }
    sort_by_rest(&mut fits);
    let most = CLEARLY_LESS * fits[0].unexplained;
    let worth = fits.partition_point(|fit| fit.unexplained <= most);
    let all = !solver.shortcuts.takes(Shortcut::Roughnesses);
    let improved = if all { fits.len() } else { worth };
    for fit in &mut fits[..improved] {
        solver.improve_coarse(fit, watch)?;
    }
    sort_by_rest(&mut fits[..improved]);
    let named = |fit: &CoarseFit<'_>| match fit.state.brdf.model {
        SpecularModel::Paper => "constant Fresnel and masking",
        SpecularModel::Beckmann => "Beckmann's microfacets",
        SpecularModel::Ggx => "GGX",
        SpecularModel::Metal => "a metal",
    };
    let because = format!(
        "{} leaves {:.0} % of the residual that {} leaves",
        named(&fits[0]),
        100.0 * fits[0].unexplained / fits[1].unexplained,
        named(&fits[1])
    );
    Ok((fits.swap_remove(0), because))
}

fn sort_by_rest(fits: &mut [CoarseFit<'_>]) {
    fits.sort_by(|a, b| a.unexplained.total_cmp(&b.unexplained));
}
