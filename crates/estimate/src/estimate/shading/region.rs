//! Which light from a part of the hemisphere reaches points: looked at once, so that what moves there costs no ray.

use std::sync::atomic::Ordering;

use rayon::prelude::*;

use crate::estimate::ellipse::Ellipse;
use crate::estimate::fast::Solver;
use crate::estimate::lobes::light_from;
use crate::estimate::observations::Point;
use rekindle_scene::hemisphere::HemisphereGrid;

/// How far around a disc it is known what of it reaches each point, radians: it moves within.
const MARGIN: f32 = 0.1;
/// Nodes of a region at most: each stands for those around it.
const MOST_NODES: usize = 600;
/// Points that are looked at together.
const POINTS_AT_ONCE: usize = 256;

/// Where irradiance is looked at.
#[derive(Clone, Copy)]
pub struct Receivers<'a> {
    pub solver: &'a Solver<'a>,
    /// Nodes all around.
    pub grid: &'a HemisphereGrid,
    pub points: &'a [Point],
}

/// A part of the hemisphere, and what of its light reaches points.
pub struct Region {
    /// The node of it that stands for each of the grid's.
    places: Vec<Option<u32>>,
    /// All nodes of the grid, see [`Ellipse::nearest_first`].
    nearest_first: Vec<u32>,
    /// Irradiance of each point by a unit flux of each node: blocks of points, in these the nodes one after the other.
    blocks: Vec<Vec<f32>>,
    /// The numbers of both.
    points: usize,
    nodes: usize,
}

impl Region {
    /// About a disc.
    pub fn new(on: &Receivers<'_>, shape: &Ellipse) -> Self {
        let Receivers {
            solver,
            grid,
            points,
        } = *on;
        let reached: Vec<usize> = shape.reach(grid, MARGIN).collect();
        let thinned = reached
            .iter()
            .step_by(reached.len().div_ceil(MOST_NODES).max(1));
        let nodes: Vec<usize> = thinned.copied().collect();
        let place = |&node: &usize| {
            let apart =
                |k: usize| grid.directions[node].distance_squared(grid.directions[nodes[k]]);
            (0..nodes.len()).min_by(|&a, &b| apart(a).total_cmp(&apart(b)))
        };
        let mut places = vec![None; grid.directions.len()];
        for (node, place) in reached
            .iter()
            .zip(reached.par_iter().map(place).collect::<Vec<_>>())
        {
            places[*node] = place.map(|place| place as u32);
        }
        let block = |points: &[Point]| {
            let mut lit = vec![0.0; nodes.len() * points.len()];
            for (p, point) in points.iter().enumerate() {
                if solver.stop.load(Ordering::Relaxed) {
                    break;
                }
                let origin = solver.occluder.offset_origin(point.position, point.normal);
                let rays = nodes.iter().enumerate().filter_map(|(place, &node)| {
                    let direction = grid.directions[node];
                    let (to, falloff) = light_from(solver.near, direction, point.position);
                    let cosine = point.normal.dot(to);
                    (cosine > 0.0).then_some(((place, falloff * cosine), to, f32::INFINITY))
                });
                let occluder = solver.occluder;
                occluder.each_occluded(origin, rays, |(place, value), is_hidden| {
                    if !is_hidden {
                        lit[place * points.len() + p] = value;
                    }
                });
            }
            lit
        };
        Self {
            places,
            nearest_first: shape.nearest_first(grid),
            blocks: points.par_chunks(POINTS_AT_ONCE).map(block).collect(),
            points: points.len(),
            nodes: nodes.len(),
        }
    }

    /// Flux of each of its nodes by a disc, the one that it is about or a changed one; what of that lies outside is dark.
    pub fn flux(&self, shape: &Ellipse, grid: &HemisphereGrid) -> Vec<f64> {
        let mut flux = vec![0.0; self.nodes];
        for (node, radiance) in shape.nodes_among(grid, &self.nearest_first) {
            if let Some(place) = self.places[node] {
                flux[place as usize] += f64::from(radiance[0] * grid.solid_angle);
            }
        }
        flux
    }

    /// Irradiance of each point by so much flux of each node, or less than none.
    pub fn irradiance(&self, flux: &[f64]) -> Vec<f64> {
        let changed = flux.iter().enumerate().filter(|(_, flux)| **flux != 0.0);
        let changed: Vec<(usize, f64)> = changed.map(|(place, &flux)| (place, flux)).collect();
        let mut irradiance = vec![0.0; self.points];
        let blocks = irradiance.par_chunks_mut(POINTS_AT_ONCE);
        blocks.zip(&self.blocks).for_each(|(sums, block)| {
            for &(place, flux) in &changed {
                let by_node = &block[place * sums.len()..][..sums.len()];
                for (sum, &by) in sums.iter_mut().zip(by_node) {
                    *sum += flux * f64::from(by);
                }
            }
        });
        irradiance
    }
}
