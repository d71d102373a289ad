//! Lights wider than the lobe are given the evenest shape that explains the photographs as well.
//!
//! Non-negative least squares puts a wide light on spikes a lobe's width apart, which a person would take for so many
//! lamps. Where lit nodes lie in a group that is wider than what one lobe can hide, the light of the group is sought once
//! more on all cells in and between them, with a ridge: of all lights that leave nearly the same residuals, that of the
//! least Σ L² is the evenest. Lamps that really lie apart can't be filled up without leaving more, and stay as they are; what
//! two narrow lamps explain better than an even light are two lamps.

use std::collections::BTreeSet;

use glam::Vec3;

use super::cells::Cell;
use super::fast::Solver;
use super::observations::Observations;
use super::state::{EXACT, State};
use super::support::patches;
use rekindle_base::math::groups::linked_groups;
use rekindle_scene::hemisphere::{Lamp, find_lamps};

/// Patches of lit nodes that are no further apart than this many standard deviations of the lobe, seen as a light, may be
/// parts of one light …
const LINK: f32 = 1.75;
/// … if neither has more than this many times the flux of the other.
const ALIKE: f32 = 10.0;
/// A light with a radius below this many of them is not wide.
const WIDE: f32 = 0.75;
/// Its cells reach so many of them beyond the lit nodes.
const REACH: f32 = 1.0;
/// A light with less than this share of the flux is not worth it.
const LEAST_SHARE: f32 = 0.01;
/// The ridge, as a share of the Gram matrix's mean diagonal.
const RIDGE: f64 = 0.1;
/// The rows determine a light's second moments: where evening it out changes its radius by more than this part, it is no
/// even light. Of wide lights it changes by 1 to 5 %, of two lamps 10° apart by 6 to 16 %.
const SAME_RADIUS: f32 = 0.055;
/// Spikes lie about a width apart all over a wide light: at least so many of them in the square of a width.
const FILLED: f32 = 0.6;
/// Of the noise's variance, how much the squared residuals may rise for every unknown that the spikes had: by up to 90 where
/// lights are wide, by more than 160 where narrow lamps far apart are taken for a wide one.
const MOST_RISE: f64 = 120.0;
/// Cells of a narrow lamp in place of a wide light lie no further from its middle than this part of a width.
const NARROW: f32 = 0.35;
/// Rounds in which spikes are shared out between two lamps.
const PAIR_ROUNDS: usize = 10;

/// Evens out every wide light for which that explains the photographs as well.
pub fn even_out<'s>(
    solver: &'s Solver<'_>,
    mut state: State<'s>,
    observations: &'s Observations,
) -> State<'s> {
    let mut wide = BTreeSet::new();
    for group in wide_groups(&state) {
        if let Some((even, region)) = evened(solver, &state, observations, &group, &wide) {
            state = even;
            wide.extend(region);
        }
    }
    state
}

/// The fit with the wide lights among a group's evened out, and their cells; `None` where none is wide. `before` holds the
/// cells of wide lights that have been evened out already.
fn evened<'s>(
    solver: &'s Solver<'_>,
    state: &State<'s>,
    observations: &'s Observations,
    group: &BTreeSet<Cell>,
    before: &BTreeSet<Cell>,
) -> Option<(State<'s>, BTreeSet<Cell>)> {
    let mut region = around(solver, state, group)?;
    let solved = |replaced: &BTreeSet<Cell>, region: &BTreeSet<Cell>| {
        let even: BTreeSet<Cell> = region.union(before).copied().collect();
        let mut solved = instead(solver, state, observations, replaced, &even);
        solved.solve_lights_evenly(|c| even.contains(c), RIDGE, EXACT);
        solved
    };
    let mut even = solved(group, &region);
    let lights = find_lamps(solver.grid, &nodes(solver, &even, &region));
    let spikes = nodes(solver, state, group);
    let wide: Vec<&Lamp> = lights
        .iter()
        .filter(|light| is_wide(solver, state, light, &spikes))
        .collect();
    if wide.is_empty() {
        return None;
    }
    let mut replaced = group.clone();
    if wide.len() < lights.len() {
        let level = solver.pyramid.finest();
        let cell = |&node: &u32| solver.pyramid.parent(Cell { level, node });
        region = wide.iter().flat_map(|l| &l.nodes).map(cell).collect();
        replaced.retain(|&c| region.contains(&solver.pyramid.parent(c)));
        even = solved(&replaced, &region);
    }
    let variance = state.squares() / (3.0 * state.weights.len() as f64);
    let unknowns = state.restricted(|c| replaced.contains(c)).lit_unknowns();
    let most = MOST_RISE * variance * unknowns;
    if even.squares() - state.squares() > most {
        return None;
    }
    if wide.len() == 1 {
        let pair = pair(solver, state, &replaced)?;
        let mut narrow = instead(solver, state, observations, &replaced, &pair);
        narrow.solve_lights(EXACT);
        if narrow.squares() < even.squares() {
            return Some((narrow, BTreeSet::new()));
        }
    }
    Some((even, region))
}

/// Cells of two narrow lamps in the place of spikes: about the middles of those nearer to the one and to the other.
fn pair(solver: &Solver<'_>, state: &State<'_>, spikes: &BTreeSet<Cell>) -> Option<BTreeSet<Cell>> {
    let lit = state.lit();
    let spikes: Vec<(Vec3, f32)> = lit
        .into_iter()
        .filter(|&k| spikes.contains(&state.cells[k]))
        .map(|k| (state.design.geometry.directions[k], state.cell_flux(k)))
        .collect();
    let middle = |own: &dyn Fn(Vec3) -> bool| {
        let own = spikes.iter().filter(|spike| own(spike.0));
        own.map(|&(direction, flux)| flux * direction)
            .sum::<Vec3>()
            .normalize_or_zero()
    };
    let centre = middle(&|_| true);
    let away = |direction: Vec3| direction.distance_squared(centre);
    let (outermost, _) =
        (spikes.iter().copied()).max_by(|a, b| (a.1 * away(a.0)).total_cmp(&(b.1 * away(b.0))))?;
    let mut ends = [outermost, 2.0 * centre - outermost];
    for _ in 0..PAIR_ROUNDS {
        let [first, second] = ends;
        let nearer = |d: Vec3| d.distance_squared(first) < d.distance_squared(second);
        ends = [middle(&nearer), middle(&|d| !nearer(d))];
    }
    let (level, reach) = (solver.pyramid.finest(), NARROW * state.lobe_width());
    let cells = ends.map(|end| solver.pyramid.within(level, end, reach));
    Some(cells.into_iter().flatten().collect())
}

/// Whether a light of the evened fit is wider than a lobe, no wider than the spikes in its place, and full of these.
fn is_wide(solver: &Solver<'_>, state: &State<'_>, light: &Lamp, spikes: &[[f32; 3]]) -> bool {
    let own = light.nodes.iter().copied();
    let lit: Vec<u32> = own.filter(|&n| spikes[n as usize] != [0.0; 3]).collect();
    let apart = apart(solver, &lit, state.lobe_width());
    let spiky = Lamp::new(solver.grid, spikes, lit).map_or(0.0, |l| l.angular_radius);
    let widths = spiky / state.lobe_width();
    let change = (light.angular_radius - spiky).abs();
    widths > WIDE && change < SAME_RADIUS * spiky && apart as f32 > FILLED * widths * widths
}

/// How many of some nodes there are of which none is nearer to another than a distance, counted in their order.
fn apart(solver: &Solver<'_>, nodes: &[u32], distance: f32) -> usize {
    let mut taken: Vec<Vec3> = Vec::new();
    for &node in nodes {
        let direction = solver.grid.directions[node as usize];
        if taken
            .iter()
            .all(|t| t.distance_squared(direction) > distance * distance)
        {
            taken.push(direction);
        }
    }
    taken.len()
}

/// Radiance on the nodes by some of the cells.
fn nodes(solver: &Solver<'_>, state: &State<'_>, some: &BTreeSet<Cell>) -> Vec<[f32; 3]> {
    let all = state
        .cells
        .iter()
        .copied()
        .zip(state.radiance.iter().copied());
    let (cells, radiance): (Vec<_>, Vec<_>) = all.filter(|(c, _)| some.contains(c)).unzip();
    solver.pyramid.to_nodes(&cells, &radiance)
}

/// Cells in and around a group of lit ones; those of lights wider than a lobe need not be as small as nodes.
fn around(
    solver: &Solver<'_>,
    state: &State<'_>,
    group: &BTreeSet<Cell>,
) -> Option<BTreeSet<Cell>> {
    let level = solver.pyramid.finest().checked_sub(1)?;
    let reach = REACH * state.lobe_width();
    let cells: Vec<Cell> = group.iter().copied().collect();
    let directions = solver.pyramid.geometry(&cells).directions;
    let within = |&d: &Vec3| solver.pyramid.within(level, d, reach);
    Some(directions.iter().flat_map(within).collect())
}

/// A state to be solved with some cells in place of the `replaced` ones.
fn instead<'s>(
    solver: &'s Solver<'_>,
    state: &State<'s>,
    observations: &'s Observations,
    replaced: &BTreeSet<Cell>,
    cells: &BTreeSet<Cell>,
) -> State<'s> {
    let lit = state.lit().into_iter().map(|k| state.cells[k]);
    let kept = lit.filter(|c| !replaced.contains(c));
    let all: BTreeSet<Cell> = kept.chain(cells.iter().copied()).collect();
    let all: Vec<Cell> = all.into_iter().collect();
    let design = solver.shadowed_design(observations, &all, &state.brdf);
    let mut changed = State::new(design, all, state.brdf);
    changed.weights.clone_from(&state.weights);
    changed
}

/// Groups of lit cells that may be one light each, wider than what one lobe hides.
fn wide_groups(state: &State<'_>) -> Vec<BTreeSet<Cell>> {
    let width = state.lobe_width();
    let patches: Vec<Patch> = patches(state, width)
        .into_iter()
        .map(|cells| Patch::new(state, cells))
        .collect();
    let total: f32 = patches.iter().map(|p| p.flux).sum();
    let may_be_one = |a: &Patch, b: &Patch| a.may_belong_to(b, LINK * width, state);
    linked_groups(patches, may_be_one)
        .into_iter()
        .map(|parts| Patch::new(state, parts.into_iter().flat_map(|p| p.cells).collect()))
        .filter(|light| light.flux > LEAST_SHARE * total && light.radius(state) > WIDE * width)
        .map(|light| light.cells.iter().map(|&k| state.cells[k]).collect())
        .collect()
}

/// Some lit cells.
struct Patch {
    cells: Vec<usize>,
    /// Σ L ω over cells and channels.
    flux: f32,
}

impl Patch {
    fn new(state: &State<'_>, cells: Vec<usize>) -> Self {
        let flux = state.flux(&cells);
        Self { cells, flux }
    }

    /// Whether some cell is no further than `reach`, radians, from one of the other's.
    fn may_belong_to(&self, other: &Self, reach: f32, state: &State<'_>) -> bool {
        let directions = &state.design.geometry.directions;
        let near =
            |&a: &usize, &b: &usize| directions[a].distance_squared(directions[b]) < reach * reach;
        self.flux.max(other.flux) < ALIKE * self.flux.min(other.flux)
            && self
                .cells
                .iter()
                .any(|a| other.cells.iter().any(|b| near(a, b)))
    }

    /// Radius of the uniform disc with the same second moments, radians.
    fn radius(&self, state: &State<'_>) -> f32 {
        let directions = &state.design.geometry.directions;
        let towards: Vec3 = self
            .cells
            .iter()
            .map(|&k| state.cell_flux(k) * directions[k])
            .sum();
        let centre = towards.normalize_or_zero();
        let squares: f32 = self
            .cells
            .iter()
            .map(|&k| state.cell_flux(k) * directions[k].angle_between(centre).powi(2))
            .sum();
        (2.0 * squares / self.flux.max(f32::MIN_POSITIVE)).sqrt()
    }
}
