//! Gloss that mirrors broad light, alone or beside lights.
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
//!
//! Where lights are found that are to be doubted, smooth light alone competes with them, and so does smooth light beside them, with columns of
//! their own that nothing holds: a sun has a sky, and a lamp a room.

mod board;

use super::SpecularChoice;
use super::below::AllAround;
use super::broad_light::{FREQUENCY, add, smooth_nodes};
use super::course::{Ending, Grounds};
use super::fast::{Fit, Solver, Watch};
use super::gloss::WORTH;
use super::held_lights::HeldLights;
use super::held_out::{CHANCE, ROUGHNESSES, leaves_less};
use super::misfit::Misfit;
use super::observer::{Stopped, go_on};
use super::relief::Bench;
use super::state::State;
use board::{Board, POINTS, Tried, Turns, light_in_rounds, total};
use rekindle_scene::hemisphere::{find_lamps, rest};
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// How much cells are held to their neighbours, as parts of the mean diagonal of the equations.
const SMOOTHNESS: [f64; 5] = [1e-3, 1e-2, 0.1, 1.0, 10.0];
/// Roughnesses that are tried beyond those of lights, radians.
const ROUGHER: [f32; 2] = [0.32, 0.5];
/// The same beside lights, as parts of what they were found with: what the sky shows widened their lobe.
const NARROWER: [f32; 4] = [1.0, 0.84, 0.71, 0.5];
/// Cells of lights that smooth light is beside, at most.
const MOST_CELLS: usize = 300;
/// Views are left out in so many turns at most, and where it is only asked how rough.
const MOST_TURNS: usize = 6;
const ROUGH_TURNS: usize = 3;
/// Frequency of the grid of the cells on which it is asked how rough: 1442 of them, 5° apart.
const FINE_FREQUENCY: u32 = 12;

/// Why the lobe is what it is.
const BECAUSE: &str = "under broad light it explains views left out best";

/// Gloss under broad light, where views left out show it beyond chance.
pub fn found(
    solver: &Solver<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    go_on(watch.observer.progress("looking for broad light", 0.5))?;
    let around = AllAround::on_cells_of(solver, FREQUENCY);
    let whole = around.solver(solver);
    let board = Board::of(&whole);
    let alone = alone(&board, choice)?;
    match alone.filter(|alone| alone.gain() > CHANCE) {
        Some(alone) => under(solver, board, &alone, choice, watch),
        None => Ok(None),
    }
}

/// The same on the surface of what has been found, alone or beside its lights, where it explains views left out better than these do, beyond
/// chance.
pub fn bettered(
    solver: &Solver<'_>,
    ending: &Ending,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    go_on(watch.observer.progress("looking for broad light", 0.5))?;
    let refined = ending.refined.as_ref();
    let bench = refined.map(|on| (Bench::new(&on.mesh, solver.seen.views), on));
    let bench = bench.as_ref();
    let refined_solver = bench.map(|(bench, on)| bench.solver(solver, &on.mesh));
    let solver = refined_solver.as_ref().unwrap_or(solver);
    let around = AllAround::on_cells_of(solver, FREQUENCY);
    let whole = around.solver(solver);
    let board = Board::of(&whole);
    let Fit {
        brdf, parts, nodes, ..
    } = &ending.fit;
    let lights = HeldLights::on_few(&whole, *brdf, nodes, MOST_CELLS);
    let with_lights = board.beside(&lights, parts.as_ref());
    let turns = Turns::of(&whole, MOST_TURNS);
    let by_lights = with_lights.left_by_lights(*brdf, turns);
    let is_better = |tried: &Tried| leaves_less(&by_lights, &tried.left) > CHANCE;
    // Many more unknowns have to be worth it.
    let is_worth = |tried: &Tried| total(&tried.left) < WORTH * total(&by_lights);
    let beside = best(with_lights.tried(&narrower(solver, *brdf), &SMOOTHNESS, turns))
        .filter(|tried| is_better(tried) && is_worth(tried));
    let alone = alone(&board, choice)?.filter(|tried| tried.gain() > CHANCE && is_better(tried));
    let soft = match (alone, beside) {
        (Some(alone), Some(beside)) if leaves_less(&beside.left, &alone.left) <= CHANCE => {
            Some(beside_lights(&with_lights, &beside, ending))
        }
        (Some(alone), _) => under(solver, board, &alone, choice, watch)?,
        (None, Some(beside)) => Some(beside_lights(&with_lights, &beside, ending)),
        (None, None) => None,
    };
    Ok(soft.map(|soft| Ending {
        refined: refined.cloned(),
        ..soft
    }))
}

/// The best of all lobes under smooth light alone.
fn alone(board: &Board<'_>, choice: SpecularChoice) -> Result<Option<Tried>, Stopped> {
    let turns = Turns::of(board.whole, MOST_TURNS);
    let tried = board.tried(&lobes(board.whole, choice), &SMOOTHNESS, turns);
    board.go_on()?;
    Ok(best(tried))
}

fn lobes(solver: &Solver<'_>, choice: SpecularChoice) -> Vec<Brdf> {
    let roughnesses = || ROUGHNESSES.into_iter().chain(ROUGHER).collect();
    let sigmas: Vec<f32> = solver.sigma.map_or_else(roughnesses, |stated| vec![stated]);
    let models = choice.or(&[SpecularModel::Ggx]);
    let lobe = |&model| sigmas.iter().map(move |&sigma| Brdf::new(model, sigma));
    models.iter().flat_map(lobe).collect()
}

fn narrower(solver: &Solver<'_>, brdf: Brdf) -> Vec<Brdf> {
    let factors = if solver.sigma.is_some() {
        &NARROWER[..1]
    } else {
        &NARROWER
    };
    let lobe = |factor: &f32| Brdf {
        sigma: factor * brdf.sigma,
        ..brdf
    };
    factors.iter().map(lobe).collect()
}

/// The end under smooth light alone.
fn under(
    solver: &Solver<'_>,
    board: Board<'_>,
    best: &Tried,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    // Cells that are wide beside a lobe prefer a wider one.
    go_on(watch.observer.progress("comparing roughnesses", 0.7))?;
    let turns = Turns::of(solver, ROUGH_TURNS);
    let weights = board.weights(best, turns);
    let around = AllAround::on_cells_of(solver, FINE_FREQUENCY);
    let whole = around.solver(solver);
    let board = board.on(&whole);
    let turns = Turns {
        weights: Some(&weights),
        ..turns
    };
    let tried = board.tried(&lobes(solver, choice), &[best.smoothness], turns);
    board.go_on()?;
    let Some((best, roughest)) = middle(&tried) else {
        return Ok(None);
    };
    let observations = whole.colours(POINTS);
    let design = whole.shadowed_design(&observations, &board.cells, &best.brdf);
    let mut state = State::new(design, board.cells.clone(), best.brdf);
    light_in_rounds(&mut state, Some((&board.joined, best.smoothness)), |_| true);
    let nodes = smooth_nodes(&whole, &board.cells, &state.radiance);
    let lamps = find_lamps(whole.grid, &nodes);
    let rest = rest(whole.grid, &nodes, &lamps);
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
        broad_light: rest.map(|rest| rest.nodes).unwrap_or_default(),
        grounds: Grounds::BroadLight,
        agreement: None,
    }))
}

/// The end under smooth light beside the lights that were found, each of them as strong as it is then.
fn beside_lights(board: &Board<'_>, best: &Tried, ending: &Ending) -> Ending {
    let Fit { parts, nodes, .. } = &ending.fit;
    let parted = parts.as_ref().map(|parts| board.whole.parted(parts));
    let whole = parted.as_ref().unwrap_or(board.whole);
    let observations = whole.colours(POINTS);
    let design = whole.shadowed_design(&observations, &board.cells, &best.brdf);
    let mut state = State::new(design, board.cells.clone(), best.brdf);
    light_in_rounds(&mut state, Some((&board.joined, best.smoothness)), |_| true);
    let [lights, around] = [0..board.lights, board.lights..board.cells.len()];
    let on = |own: std::ops::Range<usize>| (&board.cells[own.clone()], &state.radiance[own]);
    let mut nodes = HeldLights::relit(whole, nodes, on(lights));
    let broad_light = add(whole, &mut nodes, on(around));
    Ending {
        fit: Fit {
            brdf: best.brdf,
            nodes,
            misfit: Misfit::of(&state),
            parts: parts.clone(),
            ..ending.fit
        },
        because: ending.because.clone(),
        refined: None,
        suspicion: None,
        grid: whole.grid.clone(),
        broad_light,
        agreement: None,
        ..*ending
    }
}

/// What leaves least of views left out.
fn best(tried: Vec<Tried>) -> Option<Tried> {
    (tried.into_iter()).min_by(|a, b| total(&a.left).total_cmp(&total(&b.left)))
}

/// The middle one of the lobes that explain views left out no worse than the best does, beyond chance, and the roughest σ of these, radians.
fn middle(tried: &[Tried]) -> Option<(&Tried, f32)> {
    let best = (tried.iter()).min_by(|a, b| total(&a.left).total_cmp(&total(&b.left)))?;
    let mut as_good: Vec<&Tried> = (tried.iter())
        .filter(|other| leaves_less(&other.left, &best.left) <= CHANCE)
        .collect();
    as_good.sort_by(|a, b| a.brdf.sigma.total_cmp(&b.brdf.sigma));
    let roughest = as_good.last()?.brdf.sigma;
    Some((as_good[(as_good.len() - 1) / 2], roughest))
}
