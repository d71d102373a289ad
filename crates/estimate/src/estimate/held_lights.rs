//! Lights that have been found and are held, to see what else explains views under them.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use super::cells::Cell;
use super::fast::Solver;
use super::held_out::{Left, in_noise, left_under};
use super::observations::Observations;
use rekindle_scene::reflectance::Brdf;

/// Lights that have been found and are held.
pub struct HeldLights {
    /// What they are on.
    pub cells: Vec<Cell>,
    /// RGB, in units of the observations' scale.
    pub radiance: Vec<[f32; 3]>,
    /// The lobe that they are found with.
    pub brdf: Brdf,
}

impl HeldLights {
    /// Lights of a radiance per node, in the capture's units, on cells that are as coarse as a lobe allows.
    pub fn of(solver: &Solver<'_>, brdf: Brdf, nodes: &[[f32; 3]]) -> Self {
        Self::on_level(solver, brdf, nodes, Self::level(solver, brdf))
    }

    /// The same on coarser cells where they would be more than so many, as those of wide lights are.
    pub fn on_few(solver: &Solver<'_>, brdf: Brdf, nodes: &[[f32; 3]], most: usize) -> Self {
        let mut level = Self::level(solver, brdf);
        loop {
            let lights = Self::on_level(solver, brdf, nodes, level);
            if level == 0 || lights.cells.len() <= most {
                return lights;
            }
            level -= 1;
        }
    }

    /// The coarsest level whose cells a lobe does not tell from their middles.
    fn level(solver: &Solver<'_>, brdf: Brdf) -> u8 {
        let finest = solver.pyramid.finest();
        let fits = |level: &u8| solver.pyramid.spacing(*level) < brdf.sigma;
        (0..=finest).find(fits).unwrap_or(finest)
    }

    fn on_level(solver: &Solver<'_>, brdf: Brdf, nodes: &[[f32; 3]], level: u8) -> Self {
        let pyramid = solver.pyramid;
        let mut flux: BTreeMap<Cell, [f32; 3]> = BTreeMap::new();
        for (node, radiance) in nodes.iter().enumerate() {
            if radiance.iter().all(|&v| v <= 0.0) {
                continue;
            }
            let cell = pyramid.holding(node as u32, level);
            let sum = flux.entry(cell).or_default();
            for (sum, v) in sum.iter_mut().zip(radiance) {
                *sum += v * solver.grid.solid_angle / solver.coarse.scale;
            }
        }
        let cells: Vec<Cell> = flux.keys().copied().collect();
        let angles = pyramid.geometry(&cells).solid_angles;
        let radiance = flux
            .values()
            .zip(angles)
            .map(|(f, angle)| f.map(|f| f / angle));
        Self {
            radiance: radiance.collect(),
            cells,
            brdf,
        }
    }

    /// A radiance per node of a grid all around where lights of nodes, of the first of these, are as strong as their cells have it; in the
    /// capture's units.
    pub fn relit(
        solver: &Solver<'_>,
        nodes: &[[f32; 3]],
        (cells, radiance): (&[Cell], &[[f32; 3]]),
    ) -> Vec<[f32; 3]> {
        let mut relit = vec![[0.0; 3]; solver.grid.directions.len()];
        let Some(level) = cells.first().map(|cell| cell.level) else {
            return relit;
        };
        let angles = solver.pyramid.geometry(cells).solid_angles;
        let lit = |radiance: &[f32; 3]| radiance.iter().sum::<f32>();
        let of_cells: BTreeMap<Cell, usize> = cells.iter().copied().zip(0..).collect();
        let place = |node: usize| of_cells.get(&solver.pyramid.holding(node as u32, level));
        let mut before = vec![0.0_f32; cells.len()];
        for (node, radiance) in nodes.iter().enumerate() {
            if let Some(&k) = place(node) {
                before[k] += lit(radiance);
            }
        }
        for (node, own) in nodes.iter().enumerate() {
            if let Some(&k) = place(node).filter(|&&k| before[k] > 0.0) {
                let share = lit(own) / before[k] * angles[k] / solver.grid.solid_angle;
                relit[node] = radiance[k].map(|v| share * v * solver.coarse.scale);
            }
        }
        relit
    }

    /// Points at which they could show.
    pub fn points(&self, solver: &Solver<'_>, limit: usize) -> Observations {
        let mut around = self.cells.clone();
        while around.first().is_some_and(|cell| cell.level > 0) {
            for cell in &mut around {
                *cell = solver.pyramid.parent(*cell);
            }
        }
        around.sort_unstable();
        around.dedup();
        let directions = solver.pyramid.geometry(&around).directions;
        solver.points_showing(&directions, &self.brdf, limit)
    }

    /// What is left at each of some points in the views that are out, where noise is of that size, summed over turns in which others are.
    pub fn left_out(
        &self,
        solver: &Solver<'_>,
        points: &Observations,
        noise: f32,
        turns: impl IntoIterator<Item = impl Fn(usize) -> bool>,
    ) -> Vec<Left> {
        let design = solver.shadowed_design(points, &self.cells, &self.brdf);
        let units = in_noise(&design, noise);
        let lit = (self.brdf, &self.radiance[..]);
        let mut all = vec![Left::default(); points.points.len()];
        for is_out in turns {
            let left = left_under(&design, &self.cells, lit, &units, is_out);
            for (all, left) in all.iter_mut().zip(left) {
                *all += left;
            }
        }
        all
    }

    /// [`HeldLights::left_out`] of each view in turn; nothing of those that are left once the solver is stopped.
    pub fn left_out_in_turn(
        &self,
        solver: &Solver<'_>,
        points: &Observations,
        noise: f32,
    ) -> Vec<Left> {
        let views =
            (0..solver.seen.views.len()).take_while(|_| !solver.stop.load(Ordering::Relaxed));
        let turns = views.map(|view| move |other| other == view);
        self.left_out(solver, points, noise, turns)
    }
}
