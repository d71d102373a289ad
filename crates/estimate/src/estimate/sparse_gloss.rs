//! Gloss on so few parts of the surface that most points contradict it.
//!
//! A robust fit of lights believes most of the points that mirror one. Where gloss is on fewer parts than that, it finds nothing, and light is
//! what the shading says. But single highlights point at lights, beyond chance ([`highlights`]). Near these directions, and on points that
//! could show them, lights are sought that explain the points with a highlight; then each point says by its neighbours whether it has gloss
//! ([`Solver::strengths_by_highlights`]), and lobe, lights and parts are fitted as everywhere.
//!
//! What few parts say of lights is one-sided: where they happen to mirror none of a light, they say nothing of it. The shading does, of
//! all. So lights stand where the highlights say, are as strong as the shading says, and those that no highlight tells of are the shading's.

use std::collections::BTreeSet;

use glam::Vec3;

use super::SpecularChoice;
use super::below::AllAround;
use super::cells::Cell;
use super::course::{Ending, Grounds, choose_near};
use super::fast::{Fit, Solver, Watch};
use super::held_lights::HeldLights;
use super::held_out::{Left, common_noise, gain, shows_gloss};
use super::highlights;
use super::observer::{Stopped, go_on};
use super::shading::LightByShading;
use super::state::ROUGH;
use rekindle_base::math::ranks::SURE;
use rekindle_scene::hemisphere::{HemisphereGrid, Lamp, find_lamps};
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::surface::GlossParts;

/// Angle between what the shading and the highlights say of one light, beyond its radius, radians: the shading's cells are as wide.
const SAME_LIGHT: f32 = 0.28;

/// Points at which views are predicted.
const POINTS: usize = 8000;

/// What single highlights say, with lights as strong as the shading says; `None` where they say nothing.
pub fn found(
    solver: &Solver<'_>,
    light: &LightByShading,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Ending>, Stopped> {
    go_on(
        watch
            .observer
            .progress("looking for single highlights", 0.3),
    )?;
    let around = AllAround::of(solver);
    let whole = around.solver(solver);
    let directions = highlights::directions(&whole);
    if directions.is_empty() {
        return Ok(None);
    }
    let near = whole.focused_on(&directions);
    let Some((parts, sigma)) = glossy_parts(&near, watch)? else {
        return Ok(None);
    };
    let parted = near.parted(&parts);
    let (coarse, because) = choose_near(&parted, choice, Some(sigma), watch)?;
    if watch.observer.enough() || !shows_gloss(coarse.left_out(&parted)) {
        return Ok(None);
    }
    let fit = parted.fine_fit(&coarse.state, watch)?;
    let told = (fit.brdf, fit.parts.as_ref());
    let left = |(left, _): &Judged| left.iter().map(|left| left.lit).sum::<f64>();
    let best = judged(&whole, told, light, &fit.nodes)
        .into_iter()
        .min_by(|a, b| left(a).total_cmp(&left(b)));
    Ok(best
        .filter(|(left, _)| gain(left) > SURE)
        .map(|(_, nodes)| Ending {
            fit: Fit { nodes, ..fit },
            because,
            refined: None,
            suspicion: None,
            bound: None,
            allowed: [1.0; 2],
            grid: light.grid().clone(),
            broad_light: Vec::new(),
            grounds: Grounds::FewParts,
            agreement: None,
        }))
}

/// The parts of the surface that have gloss, by the points that show a highlight, and its σ, radians.
fn glossy_parts(
    near: &Solver<'_>,
    watch: &mut Watch<'_>,
) -> Result<Option<(GlossParts, f32)>, Stopped> {
    let Some((strengths, sigma)) = near.strengths_by_highlights(watch)? else {
        return Ok(None);
    };
    let parted = near.parted(&strengths);
    let mut state = parted.dark_roots(Brdf::new(SpecularModel::Paper, sigma));
    state.solve_lights(ROUGH);
    state.reweight();
    state.solve_lights(ROUGH);
    let parts = parted.glossy_parts(&state);
    Ok(parts.map(|(parts, main)| (parts, main.roughness * sigma)))
}

/// What is left at some points, and radiance per node of the lights that leave it.
type Judged = (Vec<Left>, Vec<[f32; 3]>);

/// Lights that may be by what highlights say of them (see [`lights`]), and what a lobe on some parts leaves under each of every view where
/// that has no say in diffuse colours, at points that could show any of them.
fn judged(
    whole: &Solver<'_>,
    (brdf, parts): (Brdf, Option<&GlossParts>),
    light: &LightByShading,
    by_highlights: &[[f32; 3]],
) -> Vec<Judged> {
    let parted = parts.map(|parts| whole.parted(parts));
    let solver = parted.as_ref().unwrap_or(whole);
    let tried = lights(whole.grid, by_highlights, light.nodes());
    let held = |nodes: &Vec<[f32; 3]>| HeldLights::of(solver, brdf, nodes);
    let held: Vec<HeldLights> = tried.iter().map(held).collect();
    let cells = held.iter().flat_map(|lights| lights.cells.iter().copied());
    let cells: BTreeSet<Cell> = cells.collect();
    let directions = whole.pyramid.geometry(&Vec::from_iter(cells)).directions;
    let points = solver.points_showing(&directions, &brdf, POINTS);
    let noise = common_noise(&solver.design(&points, &[]));
    let left = |lights: &HeldLights| lights.left_out_in_turn(solver, &points, noise);
    held.iter().map(left).zip(tried).collect()
}

/// Lights that may be, radiance per node: where the highlights say and as strong as the shading says; the shading's as they are; and these
/// gathered in points, as shading says little of how wide they are. All are up to one factor a channel, by which the shading's differ least
/// from what highlights say of them; none where the two have no light in common.
fn lights(
    grid: &HemisphereGrid,
    by_highlights: &[[f32; 3]],
    by_shading: &[[f32; 3]],
) -> Vec<Vec<[f32; 3]>> {
    let shaded = find_lamps(grid, by_shading);
    let shown = shown(grid, by_highlights, &shaded);
    let sum = |lamps: &Vec<Lamp>| lamps.iter().map(|lamp| Vec3::from(lamp.flux)).sum();
    let sums: Vec<Vec3> = shown.iter().map(sum).collect();
    let (mut products, mut squares) = (Vec3::ZERO, Vec3::ZERO);
    for (lamp, sum) in shaded.iter().zip(&sums) {
        if *sum != Vec3::ZERO {
            products += Vec3::from(lamp.flux) * *sum;
            squares += Vec3::from(lamp.flux).powf(2.0);
        }
    }
    if products.max_element() <= 0.0 {
        return Vec::new();
    }
    let factor = products / squares.max(Vec3::splat(f32::MIN_POSITIVE));
    let as_they_are: Vec<[f32; 3]> = (by_shading.iter())
        .map(|&radiance| (factor * Vec3::from(radiance)).to_array())
        .collect();
    let (mut placed, mut gathered) = (as_they_are.clone(), as_they_are.clone());
    for ((lamp, shown), sum) in shaded.iter().zip(&shown).zip(&sums) {
        let flux = factor * Vec3::from(lamp.flux);
        for &node in &lamp.nodes {
            gathered[node as usize] = [0.0; 3];
        }
        if let Some(node) = grid.nearest(lamp.direction) {
            gathered[node] = (flux / grid.solid_angle).to_array();
        }
        // Where normals are off, one light is shown as several.
        let [one] = &shown[..] else {
            continue;
        };
        for &node in &lamp.nodes {
            placed[node as usize] = [0.0; 3];
        }
        let strength = flux.element_sum() / sum.element_sum();
        for &node in &one.nodes {
            placed[node as usize] = by_highlights[node as usize].map(|v| strength * v);
        }
    }
    vec![placed, as_they_are, gathered]
}

/// The lights that highlights show of each that the shading tells of.
fn shown(grid: &HemisphereGrid, by_highlights: &[[f32; 3]], shaded: &[Lamp]) -> Vec<Vec<Lamp>> {
    let mut shown: Vec<Vec<Lamp>> = vec![Vec::new(); shaded.len()];
    for lamp in find_lamps(grid, by_highlights) {
        let apart = |of: usize| shaded[of].direction.angle_between(lamp.direction);
        let nearest = (0..shaded.len()).min_by(|&a, &b| apart(a).total_cmp(&apart(b)));
        let is_same = |&of: &usize| apart(of) < SAME_LIGHT + shaded[of].angular_radius;
        if let Some(of) = nearest.filter(is_same) {
            shown[of].push(lamp);
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> HemisphereGrid {
        HemisphereGrid::new(40, Vec3::Y, None, Vec3::ZERO)
    }

    /// Nodes of lights in directions, of these fluxes.
    fn lit(grid: &HemisphereGrid, lights: &[(Vec3, f32)]) -> Vec<[f32; 3]> {
        let mut nodes = vec![[0.0; 3]; grid.directions.len()];
        for &(direction, flux) in lights {
            let node = grid
                .nearest(direction.normalize_or_zero())
                .expect("above the horizon");
            nodes[node] = [flux / grid.solid_angle; 3];
        }
        nodes
    }

    #[test]
    fn lights_stand_where_highlights_say_and_are_as_strong_as_the_shading_says() {
        let grid = grid();
        let (one, other) = (Vec3::new(-0.6, 0.6, 0.5), Vec3::new(0.4, 0.7, 0.6));
        let beside = one + Vec3::new(0.05, 0.0, 0.0);
        let by_shading = lit(&grid, &[(one, 2.0), (other, 1.0)]);
        let tried = lights(&grid, &lit(&grid, &[(beside, 10.0)]), &by_shading);
        let has = |nodes: &[[f32; 3]], at: Vec3, flux: f32| {
            let expected = lit(&grid, &[(at, flux)]);
            let node = grid.nearest(at.normalize_or_zero()).unwrap_or(0);
            (nodes[node][1] / expected[node][1] - 1.0).abs() < 1e-4
        };
        let lit_nodes = |nodes: &[[f32; 3]]| nodes.iter().filter(|l| l[1] > 0.0).count();
        assert_eq!(tried.len(), 3);
        for (nodes, at) in tried.iter().zip([beside, one, one]) {
            assert!(has(nodes, at, 10.0));
            assert!(has(nodes, other, 5.0), "no highlight tells of it");
            assert_eq!(lit_nodes(nodes), 2);
        }
    }

    #[test]
    fn a_light_that_highlights_show_as_several_stands_where_the_shading_says() {
        let grid = grid();
        let at = Vec3::new(-0.6, 0.6, 0.5);
        let [left, right] = [-0.1, 0.1].map(|x| (at + Vec3::new(x, 0.0, 0.0), 5.0));
        let tried = lights(
            &grid,
            &lit(&grid, &[left, right]),
            &lit(&grid, &[(at, 2.0)]),
        );
        assert_eq!(tried[0], tried[1]);
        assert_eq!(find_lamps(&grid, &tried[0]).len(), 1);
    }

    #[test]
    fn without_a_light_in_common_nothing_is_taken() {
        let grid = grid();
        let by_shading = lit(&grid, &[(Vec3::new(-0.6, 0.6, 0.5), 2.0)]);
        let by_highlights = lit(&grid, &[(Vec3::new(0.6, 0.6, -0.5), 2.0)]);
        assert!(lights(&grid, &by_highlights, &by_shading).is_empty());
    }
}
