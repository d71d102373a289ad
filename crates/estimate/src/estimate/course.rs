//! The course of the default method: which lobe, which parts of the surface, which surface; then lights and roughness, or why
//! there are none.

use super::SpecularChoice;
use super::below::{AllAround, is_lit_from_below};
use super::fast::{CoarseFit, Fit, Solver, Watch};
use super::gloss;
use super::held_out::{
    CHANCE, LeftAt, gain, leaves_less, predicts_better, roughly_left_out, shows_gloss, sparse,
};
use super::observations::Seen;
use super::observer::{Interim, Stopped, go_on};
use super::relief::{self, Bench, RefinedSurface, Relief};
use super::shading::{Agreement, LightByShading};
use super::state::State;
use super::suspects::{Suspicion, better_lobe, left};
use super::{
    broad_light, diagnose, exposures, has_metal, soft_gloss, sparse_gloss, strengths, under_shading,
};
use glam::Vec3;
use rekindle_base::math::ranks::{SURE, signed_ranks};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::shortcuts::Shortcut;
use rekindle_scene::surface::GlossParts;

/// A specular model that leaves so many times as much as another at the best of a few roughnesses is not improved. In 67
/// captures, rendered and made, the true model left less there every time; improving both turned that round once.
const CLEARLY_LESS: f64 = 1.25;

/// Step of the roughnesses that are compared where the views hardly tell them apart, and the range of these, radians.
const STEP: f32 = 1.25;
const SMOOTHEST: f32 = 0.02;
pub const ROUGHEST: f32 = 0.5;

/// Step of the factors by which broad light allows another roughness, and how many are tried on each side.
const FINE_STEP: f32 = 1.1;
const FINE_STEPS: i32 = 5;

/// What the course comes to.
pub enum Outcome {
    /// Roughness and lights.
    Found(Box<Ending>),
    /// There are none, for this reason, and what the shading says of light.
    Nothing(String, Option<Box<LightByShading>>),
    /// The views' exposures differ by these factors: everything is to be done again with them evened out.
    Exposures(Vec<f64>),
}

/// What was found.
pub struct Ending {
    /// Roughness and lights.
    pub fit: Fit,
    /// Why this lobe.
    pub because: String,
    /// The surface that it holds for, where that isn't the mesh.
    pub refined: Option<RefinedSurface>,
    /// What the photographs contradict.
    pub suspicion: Option<Suspicion>,
    /// The roughest σ that does as well, radians, where any smoother one does too.
    pub bound: Option<f32>,
    /// Factors of σ within which broad light allows others; 1 where it is not broad.
    pub allowed: [f32; 2],
    /// The nodes of the lights.
    pub grid: HemisphereGrid,
    /// Those of them that belong to broad light, ascending.
    pub broad_light: Vec<u32>,
    /// What says that there is gloss.
    pub grounds: Grounds,
    /// How far the shading has the same lights, where the fit leaves so much that this is asked.
    pub agreement: Option<Agreement>,
}

/// What says that there is gloss, and what lights there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grounds {
    /// The photographs.
    Views,
    /// Highlights on few parts of the surface; how strong lights are, the shading says. See [`sparse_gloss`].
    FewParts,
    /// Who stated its roughness: the lights are those that explain most at that.
    Stated,
    /// The same, under the light by shading. See [`under_shading`].
    StatedUnderShading,
    /// The photographs, and light by shading explains them nearly as well as lights of their own. See [`under_shading`].
    Shading,
    /// The photographs, but only under light that is broad. See [`soft_gloss`].
    BroadLight,
}

impl Ending {
    /// Whether there is light that is not near any of some directions.
    pub fn has_light_away_from(&self, solver: &Solver<'_>, directions: &[Vec3]) -> bool {
        let nodes = self.grid.directions.iter().zip(&self.fit.nodes);
        let mut lit = nodes.filter(|(_, radiance)| radiance.iter().any(|&v| v > 0.0));
        lit.any(|(&direction, _)| !solver.is_near(direction, directions))
    }
}

/// How a course is run.
#[derive(Clone, Copy)]
pub struct Rules {
    /// The specular model.
    pub choice: SpecularChoice,
    /// Whether exposures may still be evened out, and whether they have been before.
    pub exposures: Option<bool>,
}

/// The default method from the first look to the end. Where it finds no gloss, or what it finds is to be doubted and no cause has a name, gloss
/// that mirrors broad light only is looked for, beside diffuse colours, which no metal has: what explains views left out best is taken.
pub fn run(solver: &Solver<'_>, rules: Rules, watch: &mut Watch<'_>) -> Result<Outcome, Stopped> {
    let outcome = with_shading(solver, rules, watch)?;
    let is_metal = matches!(rules.choice, SpecularChoice::Model(SpecularModel::Metal));
    let is_known = solver.seen.turning.is_some() || solver.first.is_some();
    if is_metal || is_known || watch.observer.enough() {
        return Ok(outcome);
    }
    let under_broad = match &outcome {
        Outcome::Nothing(..) => soft_gloss::found(solver, rules.choice, watch)?,
        Outcome::Found(ending) if is_open(ending) => {
            soft_gloss::bettered(solver, ending, rules.choice, watch)?
        }
        _ => None,
    };
    Ok(match under_broad {
        Some(ending) => Outcome::Found(Box::new(ending)),
        None => outcome,
    })
}

/// Whether what is found is to be doubted for a cause that has no name. What a metal mirrors has no diffuse colours beside it, and a gloss that
/// is stated needs no proof.
fn is_open(ending: &Ending) -> bool {
    let has_grounds = matches!(ending.grounds, Grounds::Views | Grounds::FewParts);
    let Fit { brdf, parts, .. } = &ending.fit;
    let is_doubted = diagnose::is_doubted(&ending.fit.misfit, ending.agreement);
    has_grounds && !has_metal(brdf, parts.as_ref()) && is_doubted && ending.suspicion.is_none()
}

/// What lights and shading say. Where no gloss shows under light from anywhere, or what is found is to be doubted and has
/// light from elsewhere, it is looked for under light from where the shading says: few lights can stand there for what is left out, so that
/// faint gloss, or on few parts, is more than these explain. What is found so has to be sound, and to make the albedo no less even than the
/// light by shading does. Where there is gloss only because its roughness was stated, its light is what the shading says, and so it is where
/// lights of their own explain views hardly better and the texture worse.
fn with_shading(
    solver: &Solver<'_>,
    rules: Rules,
    watch: &mut Watch<'_>,
) -> Result<Outcome, Stopped> {
    let outcome = sought(solver, rules, watch)?;
    let is_ended = watch.observer.enough() && matches!(outcome, Outcome::Found(_));
    if is_ended || !may_be_bettered(solver, &outcome) {
        return Ok(outcome);
    }
    go_on(watch.observer.progress("looking at the shading", 0.3))?;
    let Some(light) = LightByShading::of(solver).map(Box::new) else {
        return Ok(outcome);
    };
    let directions = light.directions();
    let is_elsewhere = match &outcome {
        Outcome::Found(ending) => ending.has_light_away_from(solver, &directions),
        _ => true,
    };
    if is_elsewhere
        && !watch.observer.enough()
        && let Some(bettered) = borne_out(solver, (&light, &directions), rules, watch)?
    {
        return Ok(bettered);
    }
    let reason = match outcome {
        Outcome::Nothing(reason, _) => reason,
        Outcome::Found(ending) if ending.grounds == Grounds::Stated => {
            let stated = under_shading::stated(solver, &light, rules.choice, watch)?;
            return Ok(Outcome::Found(stated.map_or(ending, Box::new)));
        }
        Outcome::Found(ending) if is_elsewhere => {
            let bettered = under_shading::bettered(solver, &ending, &light, rules.choice, watch)?;
            return Ok(Outcome::Found(bettered.map_or(ending, Box::new)));
        }
        _ => return Ok(outcome),
    };
    let by_highlights = sparse_gloss::found(solver, &light, rules.choice, watch)?;
    Ok(match by_highlights {
        Some(ending) => Outcome::Found(Box::new(ending)),
        None => Outcome::Nothing(reason, Some(light)),
    })
}

/// Whether light from where the shading says may do better. Other surfaces are tried under light from anywhere only; what a first estimate
/// has found is not looked for again, nor what a second one will better.
fn may_be_bettered(solver: &Solver<'_>, outcome: &Outcome) -> bool {
    let is_still = solver.seen.turning.is_none();
    is_still
        && match outcome {
            Outcome::Nothing(..) => true,
            Outcome::Found(ending) => {
                let is_only =
                    solver.first.is_none() && ending.fit.brdf.model != SpecularModel::Metal;
                let is_doubted =
                    is_only && diagnose::is_doubted(&ending.fit.misfit, ending.agreement);
                (ending.grounds == Grounds::Stated || is_doubted) && ending.refined.is_none()
            }
            Outcome::Exposures(_) => false,
        }
}

/// What is found near the light by shading, if it is sound and that bears it out; or that exposures differ.
pub fn borne_out(
    solver: &Solver<'_>,
    (light, directions): (&LightByShading, &[Vec3]),
    rules: Rules,
    watch: &mut Watch<'_>,
) -> Result<Option<Outcome>, Stopped> {
    let outcome = sought(&solver.near_to(directions), rules, watch)?;
    let is_sound = match &outcome {
        Outcome::Found(ending) => {
            !diagnose::is_doubted(&ending.fit.misfit, ending.agreement)
                && light.bears_out(solver, &ending.grid, &ending.fit.nodes)
        }
        Outcome::Nothing(..) => false,
        Outcome::Exposures(_) => true,
    };
    Ok(is_sound.then_some(outcome))
}

/// The same under light from wherever the solver seeks it.
fn sought(solver: &Solver<'_>, rules: Rules, watch: &mut Watch<'_>) -> Result<Outcome, Stopped> {
    // What a first estimate has told of the parts, a second one starts from.
    if let Some(parts) = solver.first.and_then(|first| first.parts.as_ref()) {
        let parted = solver.parted(parts);
        return with_coarse_fit(&parted, rules.choice, watch, |solver, start, watch| {
            on_mesh(solver, start, None, rules.choice, watch)
        });
    }
    with_coarse_fit(solver, rules.choice, watch, |solver, start, watch| {
        let shown = is_glossy(solver, &start.coarse);
        let views = solver.seen.views.len();
        if shown
            && let Some(known) = rules.exposures
            && let Some(factors) = exposures::differing(&start.coarse.state, views, known)
        {
            return Ok(Outcome::Exposures(factors));
        }
        // Normals that are off look like patches of gloss, and gloss in patches not like normals that are off: these don't predict.
        let mut known = None;
        if may_be_refined(solver, shown, &start.coarse)? {
            let on = (&start.coarse, &mut known);
            if let Some(ending) = on_refined(solver, on, rules.choice, watch)? {
                return Ok(Outcome::Found(Box::new(ending)));
            }
        }
        with_parts(
            solver,
            (start, known),
            rules.choice,
            watch,
            |solver, start, guess, watch| on_mesh(solver, start, guess, rules.choice, watch),
        )
    })
}

/// Whether another surface may be tried: where there is no gloss on the mesh, or what is left may be normals that are off.
fn may_be_refined(
    solver: &Solver<'_>,
    shown: bool,
    coarse: &CoarseFit<'_>,
) -> Result<bool, Stopped> {
    // Before light is sought near where the shading says, other surfaces have been tried under light from anywhere.
    let is_open =
        solver.seen.turning.is_none() && solver.first.is_none() && solver.near_to.is_none();
    Ok(is_open && (!shown || blames_normals(solver, coarse)?))
}

/// Whether normals may be off by what a coarse fit leaves, and not by what coarse cells do: a narrow lobe shows more of the lights than these
/// hold, so they are split once. Or by a lobe that is narrower than what predicts views, and so has lights for what they do.
fn blames_normals(solver: &Solver<'_>, coarse: &CoarseFit<'_>) -> Result<bool, Stopped> {
    let is_narrower =
        |sigma: Option<f32>| sigma.is_some_and(|sigma| sigma > coarse.state.brdf.sigma);
    Ok(diagnose::blames_normals(&coarse.state)
        && (on_split(solver, &coarse.state, diagnose::blames_normals)?
            || is_narrower(coarse.outdone(solver))))
}

/// Whether gloss may differ from place to place by what a coarse fit leaves, and not by what coarse cells do.
fn leaves_much(solver: &Solver<'_>, coarse: &State<'_>) -> Result<bool, Stopped> {
    Ok(diagnose::leaves_much(coarse) && on_split(solver, coarse, diagnose::leaves_much)?)
}

/// Something asked of a coarse fit's lights where they are split once.
fn on_split(
    solver: &Solver<'_>,
    coarse: &State<'_>,
    is_so: fn(&State<'_>) -> bool,
) -> Result<bool, Stopped> {
    let observations = solver.middle_observations(coarse).to_gray();
    let split = solver.lit_on_split(solver.refine(coarse, &observations))?;
    Ok(is_so(&split))
}

/// The end on the mesh as it is, or on one that its parts show how to refine, or those that may be.
fn on_mesh(
    solver: &Solver<'_>,
    Start { coarse, because }: Start<'_>,
    guess: Option<&GlossParts>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Outcome, Stopped> {
    let shown = is_glossy(solver, &coarse);
    let ending = match guess {
        // Without parts that has been tried before.
        None if solver.seen.parts.is_some() && may_be_refined(solver, shown, &coarse)? => {
            on_refined(solver, (&coarse, &mut None), choice, watch)?
        }
        Some(guess) if may_be_refined(solver, shown, &coarse)? => {
            on_guess(solver, guess, choice, watch)?
        }
        _ => None,
    };
    if let Some(ending) = ending {
        return Ok(Outcome::Found(Box::new(ending)));
    }
    // Who states a roughness says that there is gloss.
    let is_stated = solver.sigma.is_some() && !coarse.state.lit().is_empty();
    if !shown && !is_stated {
        return Ok(Outcome::Nothing(diagnose::NO_SPECULAR.to_owned(), None));
    }
    let ending = end(solver, &coarse, because, (choice, Causes::All), watch)?;
    Ok(Outcome::Found(Box::new(Ending {
        grounds: if shown {
            Grounds::Views
        } else {
            Grounds::Stated
        },
        ..ending
    })))
}

/// Whether a coarse fit's lobe is more than an accident. One that leaves open how smooth the surface is, though nobody has stated
/// it, has to predict views.
fn is_glossy(solver: &Solver<'_>, coarse: &CoarseFit<'_>) -> bool {
    let is_clear = diagnose::explains_much(&coarse.state);
    let is_settled = || {
        if solver.sigma.is_some() {
            gain(coarse.left_out(solver)) > SURE
        } else {
            !diagnose::is_open(coarse)
        }
    };
    (is_clear && is_settled()) || shows_gloss(coarse.left_out(solver))
}

/// A coarse fit to go on from.
struct Start<'s> {
    coarse: CoarseFit<'s>,
    /// Why it has its lobe.
    because: String,
}

/// Goes on from the best coarse fit, with light from below the horizon if that explains clearly more.
fn with_coarse_fit<R>(
    solver: &Solver<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
    then: impl FnOnce(&Solver<'_>, Start<'_>, &mut Watch<'_>) -> Result<R, Stopped>,
) -> Result<R, Stopped> {
    let (coarse, because) = choose(solver, choice, watch)?;
    if !solver.grid.whole && diagnose::may_lack_light(&coarse.state) && !watch.observer.enough() {
        let around = AllAround::of(solver);
        let whole = around.solver(solver);
        // The lobe is chosen anew only if it is worth it.
        if let Some(everywhere) = around_explaining_more(&whole, &coarse, watch)?
            && is_lit_from_below((&whole, &everywhere), (solver, &coarse))
        {
            let (coarse, because) = choose(&whole, choice, watch)?;
            return then(&whole, Start { coarse, because }, watch);
        }
    }
    then(solver, Start { coarse, because }, watch)
}

/// The coarse fit with light from everywhere, `whole`, of the model of one with light from above, if it may explain more: where more cells
/// explain no more with the same lobe they don't with another.
fn around_explaining_more<'s>(
    whole: &'s Solver<'_>,
    coarse: &CoarseFit<'_>,
    watch: &mut Watch<'_>,
) -> Result<Option<CoarseFit<'s>>, Stopped> {
    let Brdf { model, sigma, .. } = coarse.state.brdf;
    let same = whole.dark_roots(coarse.state.brdf).lit_at(sigma);
    if same.unexplained() >= coarse.unexplained {
        return Ok(None);
    }
    let mut everywhere = whole.compare_sigmas(model, Some(sigma), watch)?;
    whole.improve_coarse(&mut everywhere, watch)?;
    Ok(Some(everywhere))
}

/// Goes on from a coarse fit, on a surface that has parts by their strength of gloss if these explain clearly more; where one gloss for all
/// shows nothing, if they may. Parts that nothing proves on this surface are told as a guess. Patches that are known are not looked for.
fn with_parts<R>(
    solver: &Solver<'_>,
    (start, known): (Start<'_>, Option<Patches>),
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
    then: impl FnOnce(&Solver<'_>, Start<'_>, Option<&GlossParts>, &mut Watch<'_>) -> Result<R, Stopped>,
) -> Result<R, Stopped> {
    let shown = is_glossy(solver, &start.coarse);
    let patches = match known {
        Some(patches) => patches,
        None => patches(solver, &start.coarse, watch)?,
    };
    let parts = match patches {
        Patches::Likely(parts) => parts,
        Patches::Guess(parts) if !shown => return then(solver, start, Some(&parts), watch),
        _ => return then(solver, start, None, watch),
    };
    let parted = solver.parted(&parts);
    let (mut coarse, because) = choose(&parted, choice, watch)?;
    if !shown {
        coarse = coarse.or_predicting(&parted);
    }
    // Lights that only parts make room for explain much by accident.
    let is_better = explains_better(&coarse, &start.coarse)
        && predicts_better(coarse.left_out(&parted), start.coarse.left_out(solver))
        && (shown || shows_gloss(coarse.left_out(&parted)));
    if is_better {
        then(&parted, Start { coarse, because }, None, watch)
    } else {
        then(solver, start, (!shown).then_some(&parts), watch)
    }
}

/// The end on a refined surface, if views left out are explained better there than on the solver's own, whose fit is `coarse`, beyond
/// chance. Patches of the latter become known where they are looked for.
fn on_refined(
    solver: &Solver<'_>,
    (coarse, known): (&CoarseFit<'_>, &mut Option<Patches>),
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    let Some(mut relief) = relief::refine(solver, coarse.state.brdf.model, choice, watch)? else {
        return Ok(None);
    };
    let mesh = relief.mesh();
    let bench = Bench::new(&mesh, solver.seen.views);
    let refined = bench.solver(solver, &mesh);
    let before = roughly_left_out(solver, &coarse.state);
    let on_mesh = solver;
    with_coarse_fit(&refined, choice, watch, |solver, start, watch| {
        let start = Start {
            coarse: start.coarse.or_predicting(solver),
            ..start
        };
        let after = roughly_left_out(solver, &start.coarse.state);
        let z = leaves_less(&before, &after);
        let [left_before, left_after] =
            [&before, &after].map(|left| left.iter().map(|at| at.left).sum::<f64>());
        if left_after >= left_before || z <= CHANCE {
            return Ok(None);
        }
        // Turned normals can stand for much else that is wrong: what has a name, and leaves less, goes before them.
        let worth = left_after / left_before;
        let named = on_mesh.contradicted(&coarse.state, worth)?;
        if named.is_some_and(|named| named.leaves <= worth) {
            return Ok(None);
        }
        // Where little is left there is little that parts could leave less of.
        if leaves_much(solver, &start.coarse.state)? {
            let patches = known.insert(patches(on_mesh, coarse, watch)?);
            if outdone_by_parts((on_mesh, patches), &after, choice, watch)? {
                return Ok(None);
            }
        }
        on_glossy(solver, start, (&mut relief, &on_mesh.seen), choice, watch)
    })
}

/// Whether patches of the solver's own surface leave less of views left out than another surface, on which `after` is left, beyond chance:
/// turned normals can stand for gloss that differs from place to place.
fn outdone_by_parts(
    (solver, patches): (&Solver<'_>, &Patches),
    after: &[LeftAt],
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<bool, Stopped> {
    let Patches::Likely(parts) = patches else {
        return Ok(false);
    };
    let parted = solver.parted(parts);
    let (fit, _) = choose(&parted, choice, watch)?;
    let by_parts = roughly_left_out(&parted, &fit.state);
    let [left_after, left_by_parts] =
        [after, &by_parts].map(|left| left.iter().map(|at| at.left).sum::<f64>());
    Ok(left_by_parts < left_after && leaves_less(after, &by_parts) > CHANCE)
}

/// The end on a surface that is refined with parts that may be, if gloss then shows on it whatever these are.
fn on_guess(
    solver: &Solver<'_>,
    guess: &GlossParts,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    let parted = solver.parted(guess);
    let Some(mut relief) = relief::refine(&parted, SpecularModel::Paper, choice, watch)? else {
        return Ok(None);
    };
    let mesh = relief.mesh();
    let bench = Bench::new(&mesh, solver.seen.views);
    let refined = bench.solver(solver, &mesh);
    let original = &solver.seen;
    with_coarse_fit(&refined, choice, watch, |solver, start, watch| {
        on_glossy(solver, start, (&mut relief, original), choice, watch)
    })
}

/// The end on a surface that stands for that of `original`, if gloss shows on it or on parts of it. See [`on_relief`].
fn on_glossy(
    solver: &Solver<'_>,
    start: Start<'_>,
    (relief, original): (&mut Relief, &Seen<'_>),
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    with_parts(
        solver,
        (start, None),
        choice,
        watch,
        |solver, start, _, watch| {
            if !is_glossy(solver, &start.coarse) {
                return Ok(None);
            }
            on_relief(solver, start, (relief, original), choice, watch).map(Some)
        },
    )
}

/// The end on a surface that stands for that of `original`: `relief`, which the solver is of, moved under the lights found on it if that
/// leaves less.
fn on_relief(
    solver: &Solver<'_>,
    start: Start<'_>,
    (relief, original): (&mut Relief, &Seen<'_>),
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Ending, Stopped> {
    let on = |solver: &Solver<'_>, ending: Ending| Ending {
        refined: Some(RefinedSurface {
            mesh: solver.seen.mesh.clone(),
            median_tilt: relief::median_tilt(original, &solver.seen),
        }),
        ..ending
    };
    let Start { coarse, because } = start;
    let with = (choice, Causes::Views);
    let fit = finish(solver, &coarse.state, watch)?;
    let parted = fit.parts.as_ref().map(|parts| solver.parted(parts));
    let glossy = parted.as_ref().unwrap_or(solver);
    if !watch.observer.enough() && relief.bend(glossy, &fit, watch)? {
        let mesh = relief.mesh();
        let bench = Bench::new(&mesh, solver.seen.views);
        let bent = bench.solver(solver, &mesh);
        let near = Some(coarse.state.brdf.sigma);
        let (again, because) = choose_near(&bent, choice, near, watch)?;
        if again.unexplained < coarse.unexplained {
            let ending = end(&bent, &again, because, with, watch)?;
            return Ok(on(&bent, ending));
        }
    }
    let ending = end(solver, &coarse, because, with, watch)?;
    Ok(on(solver, ending))
}

/// What a misfit may come of that has a name.
#[derive(Clone, Copy)]
enum Causes {
    /// What is stated of lights and numbers, or a view.
    All,
    /// A view: what is stated has been looked at before.
    Views,
}

/// Goes on from a coarse fit, chosen `because`, to the end: with the middle of the roughnesses that the views allow where these
/// tell no more.
fn end(
    solver: &Solver<'_>,
    coarse: &CoarseFit<'_>,
    because: String,
    (choice, causes): (SpecularChoice, Causes),
    watch: &mut Watch<'_>,
) -> Result<Ending, Stopped> {
    let (mut bound, mut because) = (None, because);
    let (fit, suspicion) = if solver.sigma.is_none() && diagnose::is_open(coarse) {
        let (middle, roughest) = open_roughness(&coarse.state);
        bound = Some(roughest);
        let bounded = Solver {
            sigma: Some(middle),
            coarse: solver.coarse.clone(),
            coarse_sees: solver.coarse_sees.clone(),
            ..*solver
        };
        let model = coarse.state.brdf.model;
        let start = bounded.compare_sigmas(model, None, watch)?;
        (finish(&bounded, &start.state, watch)?, None)
    } else {
        let resolved = resolved(solver, &coarse.state, choice, watch)?;
        let start = match &resolved {
            Some((state, why)) => {
                because.clone_from(why);
                state
            }
            None => &coarse.state,
        };
        let fit = finish(solver, start, watch)?;
        let (fit, because_of_misfit) = match &resolved {
            None => explaining_all(solver, fit, &coarse.state, choice, watch)?,
            Some(_) => (fit, None),
        };
        because = because_of_misfit.unwrap_or(because);
        // What a metal mirrors of itself is a cause that a second estimate takes away.
        let is_known = fit.brdf.model == SpecularModel::Metal && solver.first.is_none();
        let is_still = solver.seen.turning.is_none();
        let is_middling = is_still && !is_known && diagnose::is_middling(&fit.misfit);
        let is_looked_for = is_middling && !watch.observer.enough();
        let suspicion = match (contradicted_lobe(solver, start, watch)?, causes) {
            (Some(lobe), _) => Some(lobe),
            _ if !is_looked_for => None,
            (None, Causes::All) => solver.suspicion(&coarse.state)?,
            (None, Causes::Views) => solver.odd_view(&coarse.state)?,
        };
        (fit, suspicion)
    };
    // A metal has no diffuse part, and what turns before its light another one in each view.
    let is_asked = diagnose::leaves_misfit(&fit.misfit)
        && fit.brdf.model != SpecularModel::Metal
        && solver.seen.turning.is_none();
    let agreement = if is_asked && !watch.observer.enough() {
        go_on(watch.observer.progress("comparing with the shading", 0.9))?;
        Agreement::of(solver, &fit.nodes, |point| !fit.is_metal_at(point.position))
    } else {
        None
    };
    let is_told = solver.sigma.is_none() && bound.is_none();
    let allowed = if is_told && diagnose::is_broad(&coarse.state) {
        allowed_factors(&coarse.state)
    } else {
        [1.0; 2]
    };
    Ok(Ending {
        fit,
        because,
        refined: None,
        suspicion,
        bound,
        allowed,
        grid: solver.grid.clone(),
        broad_light: Vec::new(),
        grounds: Grounds::Views,
        agreement,
    })
}

/// By how much smoother and rougher a coarse fit's lobe may be without leaving more than it does beyond chance: broad light makes good on
/// coarse cells for what a lobe lacks, which a curvature about the best one doesn't show.
fn allowed_factors(coarse: &State<'_>) -> [f32; 2] {
    let own = left(coarse);
    let leaves_more = |factor: f32| {
        let other = coarse.lit_at(factor * coarse.brdf.sigma);
        signed_ranks(&left(&other), &own) > SURE
    };
    [FINE_STEP.recip(), FINE_STEP].map(|step| {
        let factors = (1..=FINE_STEPS).map(|k| step.powi(k));
        let beyond = factors.take_while(|&factor| !leaves_more(factor));
        // The next one is not allowed, but what lies between may be.
        beyond.last().unwrap_or(1.0) * step
    })
}

/// The roughness in the middle of those that explain as much as a coarse fit's, and the roughest of them. They weigh as much as
/// chance lets them explain what they do: by exp(−z²/2) where they leave more by z standard deviations of it.
fn open_roughness(coarse: &State<'_>) -> (f32, f32) {
    let own = left(coarse);
    let steps = (ROUGHEST / SMOOTHEST).ln() / STEP.ln();
    let sigmas = (0..=steps as i32).map(|k| SMOOTHEST * STEP.powi(k));
    let tried: Vec<(f32, f64)> = sigmas
        .map(|sigma| (sigma, signed_ranks(&left(&coarse.lit_at(sigma)), &own)))
        .collect();
    let (mut sum, mut total) = (0.0, 0.0);
    for &(sigma, z) in &tried {
        let weight = (-0.5 * z.max(0.0).powi(2)).exp();
        sum += weight * f64::from(sigma.ln());
        total += weight;
    }
    let roughest = tried
        .iter()
        .rfind(|(_, z)| *z <= SURE)
        .map(|&(sigma, _)| sigma);
    let own = coarse.brdf.sigma;
    let middle = if total > 0.0 {
        (sum / total).exp() as f32
    } else {
        own
    };
    (middle, roughest.unwrap_or(own).max(middle))
}

/// Parts of the surface by their gloss.
enum Patches {
    /// There are none.
    None,
    /// They explain views that had no say better, under the lights that they were told by: to be compared with one gloss under its own.
    Likely(GlossParts),
    /// They explain more, but views that had no say not beyond chance: something to refine the surface with, and not to be believed.
    Guess(GlossParts),
}

/// Parts of the surface by the strength of their gloss, where one strength for all leaves so much that there may be some, and
/// many strengths clearly less.
fn patches(
    solver: &Solver<'_>,
    coarse: &CoarseFit<'_>,
    watch: &mut Watch<'_>,
) -> Result<Patches, Stopped> {
    let is_provisional = solver.is_provisional();
    if is_provisional || watch.observer.enough() || !leaves_much(solver, &coarse.state)? {
        return Ok(Patches::None);
    }
    let Some(strengths) = solver.strengths(watch)? else {
        return Ok(Patches::None);
    };
    let parted = solver.parted(&strengths);
    let model = coarse.state.brdf.model;
    let lights = strengths::SIGMAS.map(|sigma| sparse(&parted, Brdf::new(model, sigma)));
    let Some((_, lights)) = lights.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) else {
        return Ok(Patches::None);
    };
    // Two glosses tell the lights better than strengths do, and these the glosses.
    let Some((two, main)) = parted.two_glosses(&lights) else {
        return Ok(Patches::None);
    };
    let parted = solver.parted(&two);
    let (_, lights) = sparse(
        &parted,
        Brdf::new(model, main.roughness * lights.brdf.sigma),
    );
    Ok(match parted.gloss_parts(&lights, [SURE, CHANCE]) {
        Some((parts, _)) => Patches::Likely(parts),
        None => Patches::Guess(two),
    })
}

/// Whether one coarse fit leaves so much less than another that it is worth more unknowns.
pub fn explains_better(one: &CoarseFit<'_>, other: &CoarseFit<'_>) -> bool {
    one.unexplained < gloss::WORTH * other.unexplained
}

/// Roughness and lights on single nodes, from a coarse fit.
fn finish(solver: &Solver<'_>, coarse: &State<'_>, watch: &mut Watch<'_>) -> Result<Fit, Stopped> {
    watch.observer.interim(Interim::Lobe(coarse.brdf.model));
    solver.fine_fit(coarse, watch)
}

/// A coarse fit's lights with the lobe that leaves least where they are split once, and why it is that one. Coarse cells don't
/// tell lobes apart that are narrower than themselves: nothing is looked at where this one isn't, or was asked for.
fn resolved<'s>(
    solver: &'s Solver<'_>,
    coarse: &State<'s>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<(State<'s>, String)>, Stopped> {
    let is_narrow = coarse.lobe_width() < solver.pyramid.spacing(0);
    if !is_narrow || choice != SpecularChoice::Auto || watch.observer.enough() {
        return Ok(None);
    }
    let (state, Chosen { because, .. }) = chosen_on_split(solver, coarse, watch)?;
    Ok(Some((state, because)))
}

/// The fit, or that of the lobe that leaves least where a coarse fit's lights are split once, with the reason in words, if the fit is doubted
/// and that one is not: coarse cells take a lobe's tail for what they blur. Where views left out say that there is no diffuse part, a metal's
/// fit is taken though it is doubted as well.
fn explaining_all(
    solver: &Solver<'_>,
    fit: Fit,
    coarse: &State<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<(Fit, Option<String>), Stopped> {
    let is_known = solver.first.is_some() || solver.seen.turning.is_some();
    let is_free =
        choice == SpecularChoice::Auto && !is_known && fit.brdf.model != SpecularModel::Metal;
    if !is_free || !diagnose::leaves_misfit(&fit.misfit) || watch.observer.enough() {
        return Ok((fit, None));
    }
    let (start, chosen) = chosen_on_split(solver, coarse, watch)?;
    if start.brdf.model == fit.brdf.model {
        return Ok((fit, None));
    }
    let other = finish(solver, &start, watch)?;
    let is_metal = other.brdf.model == SpecularModel::Metal && chosen.is_told;
    Ok(if diagnose::leaves_misfit(&other.misfit) && !is_metal {
        (fit, None)
    } else {
        (other, Some(chosen.because))
    })
}

/// A coarse fit's lights with the lobe that leaves least where they are split once, and why it is that one.
fn chosen_on_split<'s>(
    solver: &'s Solver<'_>,
    coarse: &State<'s>,
    watch: &mut Watch<'_>,
) -> Result<(State<'s>, Chosen), Stopped> {
    let (brdf, chosen) = on_split_with_all(solver, coarse, watch, |states, watch| {
        let mut tried: Vec<(f64, &State<'_>)> =
            states.iter().map(|s| (s.unexplained(), s)).collect();
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        let chosen = chosen(solver, &tried, watch)?;
        Ok((tried[chosen.index].1.brdf, chosen))
    })?;
    let mut state = coarse.clone();
    state.brdf = brdf;
    Ok((state, chosen))
}

/// The lobe that explains more than the one asked for, if there is one.
fn contradicted_lobe(
    solver: &Solver<'_>,
    coarse: &State<'_>,
    watch: &mut Watch<'_>,
) -> Result<Option<Suspicion>, Stopped> {
    if !solver.is_lobe_asked_for || watch.observer.enough() {
        return Ok(None);
    }
    on_split_with_all(solver, coarse, watch, |states, _| Ok(better_lobe(states)))
}

/// Something asked of a coarse fit's lights where they are split once, with all lobes, its own first.
fn on_split_with_all<R>(
    solver: &Solver<'_>,
    coarse: &State<'_>,
    watch: &mut Watch<'_>,
    then: impl FnOnce(&[State<'_>], &mut Watch<'_>) -> Result<R, Stopped>,
) -> Result<R, Stopped> {
    let observations = solver.middle_observations(coarse).to_gray();
    let split = solver.refine(coarse, &observations);
    let mut models = SpecularModel::ALL;
    models.sort_by_key(|&model| model != coarse.brdf.model);
    let mut states = Vec::new();
    for model in models {
        go_on(watch.observer.progress("comparing lobes", 0.3))?;
        let mut state = split.clone();
        state.brdf.model = model;
        states.push(solver.lit_on_split(state)?);
    }
    then(&states, watch)
}

/// The coarse fit of the model asked for, or of the one that leaves least, with the reason in words.
fn choose<'s>(
    solver: &'s Solver<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<(CoarseFit<'s>, String), Stopped> {
    choose_near(solver, choice, None, watch)
}

/// The same of roughnesses about one, where there is such.
pub fn choose_near<'s>(
    solver: &'s Solver<'_>,
    choice: SpecularChoice,
    near: Option<f32>,
    watch: &mut Watch<'_>,
) -> Result<(CoarseFit<'s>, String), Stopped> {
    if let SpecularChoice::Model(model) = choice {
        return Ok((
            asked_for(solver, model, watch)?,
            "it was asked for".to_owned(),
        ));
    }
    let Compared { mut fits, .. } = compared(solver, near, watch)?;
    if fits.len() < 2 {
        let because = "it was the only one tried before the end".to_owned();
        return Ok((fits.swap_remove(0), because));
    }
    let tried: Vec<_> = fits
        .iter()
        .map(|fit| (fit.unexplained, &fit.state))
        .collect();
    let Chosen { index, because, .. } = chosen(solver, &tried, watch)?;
    Ok((fits.swap_remove(index), because))
}

/// Which lobe is chosen.
struct Chosen {
    index: usize,
    /// Why, in words.
    because: String,
    /// Whether views left out say so, and not only what is left.
    is_told: bool,
}

/// Which lobe is chosen, of states with what they leave, the least first: the first, unless a metal is among those that leave about as much
/// and there is a diffuse part, or none.
fn chosen(
    solver: &Solver<'_>,
    tried: &[(f64, &State<'_>)],
    watch: &mut Watch<'_>,
) -> Result<Chosen, Stopped> {
    let most = CLEARLY_LESS * tried[0].0;
    let close = tried.partition_point(|(left, _)| *left <= most);
    let close: Vec<&State<'_>> = tried[..close].iter().map(|(_, state)| *state).collect();
    let told = by_diffuse_part(solver, &close, watch)?;
    let is_told = told.is_some();
    let other = told.filter(|told| told.index != 0);
    Ok(other.unwrap_or_else(|| Chosen {
        index: 0,
        because: diagnose::chosen([0, 1].map(|k| (tried[k].0, tried[k].1.brdf.model))),
        is_told,
    }))
}

/// Of a metal and others that leave about as much the one that views left out bear out by whether there is a diffuse part, if they do one.
/// In a room next to nothing else tells them apart.
fn by_diffuse_part(
    solver: &Solver<'_>,
    tried: &[&State<'_>],
    watch: &mut Watch<'_>,
) -> Result<Option<Chosen>, Stopped> {
    let is_metal = |state: &&State<'_>| state.brdf.model == SpecularModel::Metal;
    let metal = tried.iter().position(is_metal);
    let other = tried.iter().position(|state| !is_metal(state));
    let (Some(metal), Some(other)) = (metal, other) else {
        return Ok(None);
    };
    // Metals have dielectrics beside them, with diffuse parts.
    let is_mixed = (solver.seen.parts).is_some_and(|parts| parts.beside_metals().is_some());
    if is_mixed || solver.seen.turning.is_some() || watch.observer.enough() {
        return Ok(None);
    }
    go_on(watch.observer.progress("looking for a diffuse part", 0.15))?;
    let deviations = broad_light::against_colours(solver, tried[metal], |_| true)?;
    let (index, because) = if deviations > SURE {
        (metal, diagnose::MIRRORS_ALL)
    } else {
        (other, diagnose::HAS_DIFFUSE_PART)
    };
    Ok((deviations.abs() > SURE).then(|| Chosen {
        index,
        because: because.to_owned(),
        is_told: true,
    }))
}

/// The coarse fit of a model.
pub fn asked_for<'s>(
    solver: &'s Solver<'_>,
    model: SpecularModel,
    watch: &mut Watch<'_>,
) -> Result<CoarseFit<'s>, Stopped> {
    let first = solver.first.and_then(|first| first.brdf);
    let near = first.map(|brdf| brdf.sigma);
    let mut fit = solver.compare_sigmas(model, near, watch)?;
    solver.improve_coarse(&mut fit, watch)?;
    Ok(fit)
}

/// Coarse fits of all models, those that leave less first.
pub struct Compared<'s> {
    /// The fits; the paper's alone where there was no time for others.
    pub fits: Vec<CoarseFit<'s>>,
    /// So many of them were improved: those that leave clearly more from the start are not.
    pub improved: usize,
}

/// Compares all models, at roughnesses about one where there is such.
pub fn compared<'s>(
    solver: &'s Solver<'_>,
    near: Option<f32>,
    watch: &mut Watch<'_>,
) -> Result<Compared<'s>, Stopped> {
    let mut fits = vec![solver.compare_sigmas(SpecularModel::Paper, near, watch)?];
    if watch.observer.enough() {
        return Ok(Compared { fits, improved: 0 });
    }
    let near = Some(fits[0].state.brdf.sigma);
    for model in SpecularModel::ALL {
        if model != SpecularModel::Paper {
            fits.push(solver.compare_sigmas(model, near, watch)?);
        }
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
    Ok(Compared { fits, improved })
}

fn sort_by_rest(fits: &mut [CoarseFit<'_>]) {
    fits.sort_by(|a, b| a.unexplained.total_cmp(&b.unexplained));
}
