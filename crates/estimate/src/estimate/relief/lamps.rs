//! A few point lamps with the lobe that shows them, which are estimated together with the surface.

use faer::Col;
use glam::Vec3;

use super::TURN;
use crate::estimate::SpecularChoice;
use crate::estimate::cells::{Cell, CellGeometry};
use crate::estimate::course::{Compared, asked_for, compared};
use crate::estimate::design::Design;
use crate::estimate::fast::{CoarseFit, Solver, Watch};
use crate::estimate::held_out::{CHANCE, roughly_left_out};
use crate::estimate::observations::Observations;
use crate::estimate::observer::Stopped;
use crate::estimate::state::ROUGH;
use crate::estimate::visibility::{SeenCells, cell_visibility};
use rekindle_base::math::ranks::signed_ranks;
use rekindle_scene::hemisphere::{Lamp, find_lamps};
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// The lobe with which lamps are looked for over the one that fits best on unrefined normals.
pub const WIDER: f32 = 2.0;

/// Most lamps, and the least share of the flux of one.
const MOST_LAMPS: usize = 12;
const LEAST_SHARE: f32 = 0.03;

/// Longest step of σ and of a flux, relative, and of a lamp's direction, radians.
const LONGEST_SIGMA_STEP: f64 = 0.3;
const LONGEST_FLUX_STEP: f32 = 0.5;
const LONGEST_TURN: f32 = 0.05;

/// Unknowns of one lamp: two of its direction, three of its flux.
const PER_LAMP: usize = 5;

/// Directions of one lamp that its derivatives need.
const ASIDE: usize = 5;

/// Point lights with the lobe that shows them.
#[derive(Clone, Debug)]
pub struct Lamps {
    /// Unit directions from the object's centre.
    pub directions: Vec<Vec3>,
    /// Radiance × solid angle, RGB, in units of the observations' scale.
    pub flux: Vec<[f32; 3]>,
    /// The lobe.
    pub brdf: Brdf,
}

/// Lobes that are preferred: long tails explain normals that are off.
const SHORT_TAILED: [SpecularModel; 2] = [SpecularModel::Paper, SpecularModel::Beckmann];

/// The coarse fit that leaves least; one with a long tail has to predict views that had no say better than those without, beyond chance.
fn wide_fit<'s>(
    solver: &'s Solver<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<CoarseFit<'s>, Stopped> {
    if let SpecularChoice::Model(model) = choice {
        return asked_for(solver, model, watch);
    }
    let Compared { mut fits, improved } = compared(solver, None, watch)?;
    let is_short = |fit: &CoarseFit<'_>| SHORT_TAILED.contains(&fit.state.brdf.model);
    let at = fits.iter().position(is_short).unwrap_or(0);
    let mut short = fits.swap_remove(at);
    if at == 0 {
        return Ok(short);
    }
    let any = fits.swap_remove(0);
    if at >= improved {
        solver.improve_coarse(&mut short, watch)?;
    }
    let left = |fit: &CoarseFit<'_>| -> Vec<f64> {
        let left = roughly_left_out(solver, &fit.state);
        left.into_iter().map(|at| at.left).collect()
    };
    let is_better = signed_ranks(&left(&short), &left(&any)) > CHANCE;
    Ok(if is_better { any } else { short })
}

/// Lamps in a lobe that is too wide: few, and where the highlights are in the mean over the surface. Beside them the σ of the lobe
/// that fits best.
pub fn wide_lamps(
    solver: &Solver<'_>,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<(Lamps, f32), Stopped> {
    let coarse = wide_fit(solver, choice, watch)?.or_predicting(solver);
    let points = solver.middle_observations(&coarse.state);
    let mut state = solver.refine(&coarse.state, &points);
    state.brdf.sigma *= WIDER;
    state.solve_lights(ROUGH);
    let nodes = solver.pyramid.to_nodes(&state.cells, &state.radiance);
    let mut found = find_lamps(solver.grid, &nodes);
    let total: f32 = found.iter().map(Lamp::mean_flux).sum();
    found.retain(|l| l.mean_flux() > LEAST_SHARE * total);
    found.truncate(MOST_LAMPS);
    let lamps = Lamps {
        directions: found.iter().map(|l| l.direction).collect(),
        flux: found.iter().map(|l| l.flux).collect(),
        brdf: state.brdf,
    };
    Ok((lamps, coarse.state.brdf.sigma))
}

impl Lamps {
    fn geometry(&self) -> CellGeometry {
        CellGeometry {
            directions: self.directions.clone(),
            solid_angles: vec![1.0; self.directions.len()],
            spread: vec![0.0; self.directions.len()],
        }
    }

    /// The coarsest cells that they lie in.
    pub fn around(&self, solver: &Solver<'_>) -> Vec<Cell> {
        let directions = self.directions.iter();
        directions.map(|&d| solver.pyramid.root_at(d)).collect()
    }

    /// Derivatives of every row's specular radiance: by σ, then lamp by lamp by the direction along two tangents and by
    /// the three channels' flux.
    pub fn derivatives(&self, design: &Design<'_>) -> Vec<Vec<[f32; 3]>> {
        // Each lamp where it is, and turned either way along each tangent.
        let of_lamps = (0..self.directions.len()).flat_map(|lamp| [lamp; ASIDE]);
        let mut beside = design.restricted(&of_lamps.collect::<Vec<_>>());
        let turned = self.directions.iter().flat_map(|&lamp| {
            let (t1, t2) = lamp.any_orthonormal_pair();
            let turns = [Vec3::ZERO, TURN * t1, -TURN * t1, TURN * t2, -TURN * t2];
            turns.map(|turn| (lamp + turn).normalize_or_zero())
        });
        beside.geometry.directions = turned.collect();
        let shown = beside.matrix(&self.brdf);
        let rows = || shown.chunks_exact(ASIDE * self.directions.len());
        let mut columns = vec![design.predict(&self.brdf, &self.flux).by_sigma];
        for (lamp, flux) in self.flux.iter().enumerate() {
            let first = ASIDE * lamp;
            for at in [first + 1, first + 3] {
                let slope = |row: &[f32]| (row[at] - row[at + 1]) / (2.0 * TURN);
                columns.push(rows().map(|row| flux.map(|f| f * slope(row))).collect());
            }
            for channel in 0..3 {
                let by_flux = |row: &[f32]| {
                    let mut own = [0.0; 3];
                    own[channel] = row[first];
                    own
                };
                columns.push(rows().map(by_flux).collect());
            }
        }
        columns
    }

    /// Takes a step of the unknowns in the order of [`Lamps::derivatives`], no part of it too long.
    pub fn take(&mut self, step: &Col<f64>) {
        let sigma = f64::from(self.brdf.sigma);
        let limit = LONGEST_SIGMA_STEP * sigma;
        self.brdf.sigma = (sigma + step[0].clamp(-limit, limit)) as f32;
        for lamp in 0..self.directions.len() {
            let at = |k: usize| step[1 + PER_LAMP * lamp + k] as f32;
            let (t1, t2) = self.directions[lamp].any_orthonormal_pair();
            let turn = (at(0) * t1 + at(1) * t2).clamp_length_max(LONGEST_TURN);
            self.directions[lamp] = (self.directions[lamp] + turn).normalize_or_zero();
            for (channel, flux) in self.flux[lamp].iter_mut().enumerate() {
                let limit = LONGEST_FLUX_STEP * *flux;
                *flux += at(2 + channel).clamp(-limit, limit);
            }
        }
    }
}

/// Rows under the lamps, with their shadows.
pub fn design<'o>(
    solver: &Solver<'o>,
    lamps: &Lamps,
    observations: &'o Observations,
) -> Design<'o> {
    let mut design = Design {
        observations,
        geometry: lamps.geometry(),
        near: solver.near,
        seen: SeenCells::default(),
        diffuse_known: false,
        shortcuts: solver.shortcuts,
        workspace: solver.workspace,
        stop: solver.stop,
    };
    let around = lamps.around(solver);
    design.seen = cell_visibility(
        &design,
        solver.pyramid,
        &around,
        &lamps.brdf,
        solver.occluder,
    );
    design
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::cells::Pyramid;
    use crate::estimate::tests::{Random, bare_design, bare_observations};
    use rekindle_scene::hemisphere::HemisphereGrid;

    #[test]
    fn derivatives_agree_with_steps_of_the_unknowns() {
        let observations = bare_observations(60, &mut Random(7));
        let grid = HemisphereGrid::new(24, Vec3::Z, None, Vec3::ZERO);
        let pyramid = Pyramid::new(&grid, 11);
        let lamps = Lamps {
            directions: [Vec3::new(0.3, 0.1, 0.9), Vec3::new(-0.3, -0.2, 0.9)]
                .map(Vec3::normalize_or_zero)
                .to_vec(),
            flux: vec![[6.0, 5.0, 4.0], [2.0, 2.5, 3.0]],
            brdf: Brdf::new(SpecularModel::Beckmann, 0.15),
        };
        let design = |lamps: &Lamps| Design {
            geometry: lamps.geometry(),
            ..bare_design(&observations, &pyramid, &[])
        };
        let unknowns = 1 + PER_LAMP * lamps.directions.len();
        let columns = lamps.derivatives(&design(&lamps));
        assert_eq!(columns.len(), unknowns);
        for (unknown, column) in columns.iter().enumerate() {
            let shown = |step: f64| {
                let mut stepped = lamps.clone();
                stepped.take(&Col::from_fn(unknowns, |k| {
                    if k == unknown { step } else { 0.0 }
                }));
                design(&stepped).predict_values(&stepped.brdf, &stepped.flux)
            };
            let (more, less) = (shown(2e-3), shown(-2e-3));
            let largest = column
                .as_flattened()
                .iter()
                .fold(0.0_f32, |m, v| m.max(v.abs()));
            assert!(largest > 0.01, "{unknown} changes nothing");
            let values = column.iter().zip(more.iter().zip(&less));
            for (own, (more, less)) in values {
                for c in 0..3 {
                    let difference = (more[c] - less[c]) / 4e-3;
                    let off = (own[c] - difference).abs();
                    assert!(
                        off < 1e-2 * largest,
                        "{unknown}: {} for {difference}",
                        own[c]
                    );
                }
            }
        }
    }
}
