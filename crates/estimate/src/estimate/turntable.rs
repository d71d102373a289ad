//! Light that stands still with the camera, as where the object turns on a table.
//!
//! A point's diffuse radiance then differs from view to view as its irradiance E does: a row reads `y = t a E + S`, with the
//! transmittance t towards the viewer, the albedo a, which is unknown, and the specular radiance S. Where the ratios of E are
//! known, a is eliminated as everywhere, with t E in place of t, and all that seeks highlights stays what it is.
//!
//! E is sought first from the diffuse part alone: the light x ≥ 0 on broad cells all around for which
//! `Σ w (y − a E(x))²` is least over x and the albedos, by variable projection (Golub and Pereyra, "The differentiation of
//! pseudo-inverses and nonlinear least squares problems whose variables separate", 1973), from the x for which E is most nearly
//! along y, which is a convex problem. Lights that highlights then tell have sharper shadows: E is theirs next, each with a strength of
//! its own, beside light from everywhere. Both take turns.

use std::sync::atomic::{AtomicBool, Ordering};

use faer::Mat;
use glam::Vec3;
use rayon::prelude::*;

use super::Estimate;
use super::cells::{Cell, Pyramid};
use super::fast::Solver;
use super::lobes::light_from;
use super::observations::{Motion, Observations, Placed, Point, Row};
use super::shading::{MEAN_ALBEDO, brightest, lit_children, mean};
use super::weights::{magnitude, median};
use rekindle_base::math::nnls::{self, NnlsParams};
use rekindle_scene::hemisphere::{HemisphereGrid, find_lamps, rest};
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::surface::Occluder;

/// Points that tell the diffuse light, and frequency of the grid of its cells: 162 of them, 16° apart.
const POINTS: usize = 2500;
const FREQUENCY: u32 = 4;
/// How often cells that are not nearly dark are split.
const SPLITS: usize = 2;
/// More cells than this are fine enough.
const MOST_CELLS: usize = 500;
/// Part of the mean irradiance that the brightest cells give; the rest is taken for light from everywhere.
const MOST: f64 = 0.98;
/// How much cells are held to their neighbours, as a part of the mean diagonal of the equations.
const SMOOTHNESS: f64 = 1e-4;

/// Steps of variable projection, and the change of the light that ends them, relative.
const STEPS: usize = 20;
const SETTLED: f64 = 1e-3;
/// Residuals past so many standard deviations lose weight (Cauchy's function, whose efficiency then is 95 %).
const CAUCHY: f64 = 2.385;
/// Part of a point's radiance by which it is off at least.
const LEAST_ERROR: f64 = 0.003;
/// Part of the mean radiance that counts as nearly black.
const DARK: f64 = 0.05;
/// Irradiance is nowhere taken for less than this part of the usual one: what is dark has no say, but no infinite albedo.
const LEAST_IRRADIANCE: f32 = 1e-3;

/// How a surface stands to the light in each view.
pub struct Turning<'a> {
    /// One a view.
    pub motions: Vec<Motion>,
    /// Its irradiance, once something is known of it.
    pub irradiance: Option<Irradiance<'a>>,
    /// Whether that is only good enough to find lights by: where it is off, the surface seems to differ in gloss.
    pub is_provisional: bool,
}

/// Irradiance of a surface where the lights stand still.
#[derive(Clone)]
pub struct Irradiance<'a> {
    occluder: &'a Occluder,
    near: Option<(Vec3, f32)>,
    sources: Vec<Source>,
    /// Irradiance by light from everywhere, RGB.
    ambient: Vec3,
    /// The lobe, whose diffuse layer gets what it lets in.
    brdf: Option<Brdf>,
}

/// A direction that light comes from.
#[derive(Clone, Copy, Debug)]
struct Source {
    direction: Vec3,
    /// Radiance × solid angle, RGB.
    flux: Vec3,
}

impl Irradiance<'_> {
    /// What a point on the surface has in some rows, and takes out of their radiance what differs between the channels only.
    pub fn tell(&self, position: Vec3, normal: Vec3, rows: &mut [Row]) {
        let origin = self.occluder.offset_origin(position, normal);
        let of_rows: Vec<Vec3> = (rows.iter())
            .map(|row| {
                row.placed
                    .map_or(Vec3::ONE, |placed| self.at(origin, &placed))
            })
            .collect();
        let total: Vec3 = of_rows.iter().sum();
        let tint = 3.0 * total / total.element_sum().max(f32::MIN_POSITIVE);
        let albedo = albedo(rows, &of_rows);
        for (row, irradiance) in rows.iter_mut().zip(of_rows) {
            let gray = irradiance.element_sum() / 3.0;
            let coloured = albedo * (irradiance - tint * gray);
            row.radiance = (Vec3::from(row.radiance) - coloured).to_array();
            row.irradiance = gray.max(LEAST_IRRADIANCE);
        }
    }

    /// At a surface point as it lies before one camera, from which rays start at `origin` on the surface.
    fn at(&self, origin: Vec3, placed: &Placed) -> Vec3 {
        let lit = self.sources.iter().filter_map(|source| {
            let (to, fall_off) = light_from(self.near, source.direction, placed.position);
            let cosine = placed.normal.dot(to);
            let reaches = source.flux * (fall_off * entering(self.brdf, cosine));
            (cosine > 0.0).then_some((
                reaches,
                placed.to_surface * to,
                self.distance(source, placed),
            ))
        });
        let mut sum = self.ambient;
        self.occluder
            .each_occluded(origin, lit, |reaches, is_blocked| {
                if !is_blocked {
                    sum += reaches;
                }
            });
        sum
    }

    fn distance(&self, source: &Source, placed: &Placed) -> f32 {
        distance(self.near, source.direction, placed.position)
    }

    /// The same with a mean of 1 over some points.
    fn over_mean(mut self, observations: &Observations) -> Self {
        let gray = |(point, row): (&Point, &Row)| {
            let origin = self.occluder.offset_origin(point.position, point.normal);
            let at = row
                .placed
                .map_or(Vec3::ONE, |placed| self.at(origin, &placed));
            f64::from(at.element_sum()) / 3.0
        };
        let all: Vec<f64> = placed_rows(observations)
            .into_par_iter()
            .map(gray)
            .collect();
        let gain = (1.0 / mean(&all).max(f64::MIN_POSITIVE)) as f32;
        for source in &mut self.sources {
            source.flux *= gain;
        }
        self.ambient *= gain;
        self
    }
}

/// What a surface lets in of light at a cosine to its normal, that cosine inside.
fn entering(brdf: Option<Brdf>, cosine: f32) -> f32 {
    cosine * brdf.map_or(1.0, |brdf| brdf.diffuse_entry(cosine))
}

/// Albedo of a point under its rows' irradiance: in each channel the middle of what they say, by irradiance, so that highlights in
/// a few of them don't count.
fn albedo(rows: &[Row], irradiance: &[Vec3]) -> Vec3 {
    let channel = |c: usize| {
        let said = rows.iter().zip(irradiance).filter(|(_, e)| e[c] > 0.0);
        let mut said: Vec<(f32, f32)> = said
            .map(|(row, e)| (row.radiance[c] / e[c], e[c]))
            .collect();
        said.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = 0.5 * said.iter().map(|s| s.1).sum::<f32>();
        let mut below = 0.0;
        let middle = said.iter().find(|(_, weight)| {
            below += weight;
            below >= half
        });
        middle.map_or(0.0, |&(value, _)| value)
    };
    Vec3::from([0, 1, 2].map(channel))
}

/// Length of the way from a place to a light.
fn distance(near: Option<(Vec3, f32)>, direction: Vec3, position: Vec3) -> f32 {
    near.map_or(f32::INFINITY, |(centre, radius)| {
        (centre + radius * direction - position).length()
    })
}

/// Every row with its point.
fn placed_rows(observations: &Observations) -> Vec<(&Point, &Row)> {
    let points = observations.points.iter();
    let rows = points.flat_map(|point| {
        let rows = &observations.rows[point.rows.clone()];
        rows.iter().map(move |row| (point, row))
    });
    rows.collect()
}

/// What a capture's diffuse part tells.
pub struct ByDiffuse<'o> {
    /// The irradiance.
    pub irradiance: Irradiance<'o>,
    /// Nodes all around …
    pub grid: HemisphereGrid,
    /// … and the radiance of each, RGB, in the capture's units, under which the albedo is one half in the mean.
    pub nodes: Vec<[f32; 3]>,
    /// Irradiance by light from everywhere in the same units, RGB; only where there is no other light.
    pub ambient: Vec3,
}

/// The light that a capture's diffuse part tells.
pub fn from_diffuse<'o>(solver: &Solver<'_>, occluder: &'o Occluder) -> ByDiffuse<'o> {
    let grid = solver.grid.to_whole();
    let pyramid = Pyramid::new(&grid, FREQUENCY);
    let observations = solver.colours(POINTS).to_gray();
    let mut cells = pyramid.roots();
    let mut shading = Shading::of_cells(solver, &observations, &pyramid, &cells);
    let mut x = shading.light(None);
    for _ in 0..SPLITS {
        let finer = lit_children(&pyramid, &cells, &x);
        if finer.len() > MOST_CELLS || solver.stop.load(Ordering::Relaxed) {
            break;
        }
        shading = Shading::of_cells(solver, &observations, &pyramid, &finer);
        cells = finer;
        x = shading.light(None);
    }
    let bright = brightest(&x, &shading.mean, MOST);
    let geometry = pyramid.geometry(&cells);
    let sources = (0..cells.len()).filter(|&k| bright[k]).map(|k| Source {
        direction: geometry.directions[k],
        flux: Vec3::splat(x[k] as f32 * geometry.solid_angles[k]),
    });
    let dim: f64 = (0..cells.len())
        .filter(|&k| !bright[k])
        .map(|k| x[k] * shading.mean[k])
        .sum();
    let irradiance = Irradiance {
        occluder,
        near: solver.near,
        sources: sources.collect(),
        ambient: Vec3::splat(dim as f32),
        brdf: None,
    };
    // The strength is open: the albedo is taken to be one half in the mean.
    let unit = f64::from(solver.coarse.scale) * shading.usual / MEAN_ALBEDO;
    let radiance: Vec<[f32; 3]> = x.iter().map(|&v| [(unit * v) as f32; 3]).collect();
    let is_dark = x.iter().all(|&v| v == 0.0);
    ByDiffuse {
        irradiance,
        nodes: pyramid.to_nodes(&cells, &radiance),
        grid,
        ambient: Vec3::splat(if is_dark { unit as f32 } else { 0.0 }),
    }
}

/// The irradiance by lights that highlights tell, radiance per node of a grid, each as strong as the diffuse part says, with light
/// from everywhere; and the latter's irradiance where the former are as strong in the mean as the nodes say. `None` without lights.
pub fn from_lights<'o>(
    solver: &Solver<'_>,
    occluder: &'o Occluder,
    found: &Estimate,
) -> Option<(Irradiance<'o>, Vec3)> {
    let (grid, nodes) = (&found.grid, &found.radiance);
    let lamps = find_lamps(grid, nodes);
    let strays = rest(grid, nodes, &lamps);
    let members = lamps.iter().chain(&strays).map(|lamp| &lamp.nodes);
    let lights: Vec<Vec<Source>> = members.map(|own| merged(grid, nodes, own)).collect();
    if lights.is_empty() {
        return None;
    }
    let observations = solver.colours(POINTS).to_gray();
    let shading = Shading::of_lights((solver, found.brdf), &observations, &lights);
    let as_told = vec![1.0; lights.len()];
    let x = shading.light(Some([as_told, vec![0.0]].concat()));
    let (ambient, gains) = x.split_last()?;
    let told: f64 = gains
        .iter()
        .zip(&shading.mean)
        .map(|(x, mean)| x * mean)
        .sum();
    let by_nodes: f64 = shading.mean[..gains.len()].iter().sum();
    let sources = lights.iter().zip(gains).flat_map(|(light, &gain)| {
        light.iter().map(move |source| Source {
            flux: source.flux * gain as f32,
            ..*source
        })
    });
    let irradiance = Irradiance {
        occluder,
        near: solver.near,
        sources: sources.collect(),
        ambient: Vec3::splat(*ambient as f32),
        brdf: found.brdf,
    };
    let scale = by_nodes / told.max(f64::MIN_POSITIVE);
    let beside = Vec3::splat((ambient * scale) as f32);
    Some((irradiance.over_mean(&observations), beside))
}

/// Nodes as a few sources: those within about a degree and a half of a bright one are one with it.
fn merged(grid: &HemisphereGrid, nodes: &[[f32; 3]], own: &[u32]) -> Vec<Source> {
    let least = (1.5 * grid.spacing()).cos();
    let flux = |node: u32| Vec3::from(nodes[node as usize]) * grid.solid_angle;
    let mut left = own.to_vec();
    left.sort_by(|&a, &b| flux(b).element_sum().total_cmp(&flux(a).element_sum()));
    let mut sources = Vec::new();
    while let Some(&first) = left.first() {
        let centre = grid.directions[first as usize];
        let is_near = |&node: &u32| grid.directions[node as usize].dot(centre) >= least;
        let (near, far): (Vec<u32>, Vec<u32>) = left.into_iter().partition(is_near);
        let weighted = |&node: &u32| grid.directions[node as usize] * flux(node).element_sum();
        sources.push(Source {
            direction: near.iter().map(weighted).sum::<Vec3>().normalize_or(centre),
            flux: near.iter().map(|&node| flux(node)).sum(),
        });
        left = far;
    }
    sources
}

/// Irradiance of each row by each of some lights, and what was measured.
struct Shading<'a> {
    stop: &'a AtomicBool,
    observations: &'a Observations,
    /// Row by row, that by unit strength of each light.
    by_light: Vec<Vec<f64>>,
    /// Mean over the rows of that by each light.
    mean: Vec<f64>,
    /// Lights that lie beside each other.
    joined: Vec<[usize; 2]>,
    /// Mean radiance of all rows.
    usual: f64,
}

impl<'a> Shading<'a> {
    fn new(
        stop: &'a AtomicBool,
        observations: &'a Observations,
        lights: usize,
        joined: Vec<[usize; 2]>,
        row: impl Fn(&Point, &Placed) -> Vec<f64> + Sync,
    ) -> Self {
        let of_row = |(point, own): (&Point, &Row)| match own.placed {
            Some(placed) if !stop.load(Ordering::Relaxed) => row(point, &placed),
            _ => vec![0.0; lights],
        };
        let by_light: Vec<Vec<f64>> = placed_rows(observations)
            .into_par_iter()
            .map(of_row)
            .collect();
        let radiance = observations
            .rows
            .iter()
            .map(|row| f64::from(magnitude(row.radiance)));
        Self {
            stop,
            observations,
            mean: (0..lights)
                .map(|k| mean(&by_light.iter().map(|row| row[k]).collect::<Vec<_>>()))
                .collect(),
            by_light,
            joined,
            usual: mean(&radiance.collect::<Vec<_>>()),
        }
    }

    /// Cells of a pyramid, by unit radiance.
    fn of_cells(
        solver: &'a Solver<'_>,
        observations: &'a Observations,
        pyramid: &Pyramid,
        cells: &[Cell],
    ) -> Self {
        let geometry = pyramid.geometry(cells);
        let sources: Vec<Source> = (geometry.directions.iter().zip(&geometry.solid_angles))
            .map(|(&direction, &solid_angle)| Source {
                direction,
                flux: Vec3::splat(solid_angle),
            })
            .collect();
        Self::new(
            solver.stop,
            observations,
            cells.len(),
            pyramid.joined(cells),
            |point, placed| {
                let mut row = vec![0.0; cells.len()];
                each_reaching(
                    (solver, None),
                    point,
                    placed,
                    sources.iter().enumerate(),
                    |k, flux| row[k] += flux,
                );
                row
            },
        )
    }

    /// Lights of some sources each, as strong as these are, and light from everywhere of irradiance 1.
    fn of_lights(
        (solver, brdf): (&'a Solver<'_>, Option<Brdf>),
        observations: &'a Observations,
        lights: &[Vec<Source>],
    ) -> Self {
        let sources = lights.iter().enumerate();
        let sources: Vec<(usize, &Source)> = sources
            .flat_map(|(k, own)| own.iter().map(move |s| (k, s)))
            .collect();
        Self::new(
            solver.stop,
            observations,
            lights.len() + 1,
            Vec::new(),
            |point, placed| {
                let mut row = vec![0.0; lights.len() + 1];
                each_reaching(
                    (solver, brdf),
                    point,
                    placed,
                    sources.iter().copied(),
                    |k, flux| row[k] += flux,
                );
                row[lights.len()] = 1.0;
                row
            },
        )
    }

    /// Irradiance of each row.
    fn lit(&self, x: &[f64]) -> Vec<f64> {
        let sum = |row: &Vec<f64>| row.iter().zip(x).map(|(f, v)| f * v).sum();
        self.by_light.par_iter().map(sum).collect()
    }

    /// The lights' strengths under which the mean irradiance is 1.
    fn normalised(&self, mut x: Vec<f64>) -> Vec<f64> {
        let mean: f64 = x.iter().zip(&self.mean).map(|(x, mean)| x * mean).sum();
        if mean > 0.0 {
            for v in &mut x {
                *v /= mean;
            }
        }
        x
    }

    /// The strengths that leave least, of mean irradiance 1; sought from some, or from those under which the irradiance of points is
    /// most nearly along their radiance.
    fn light(&self, start: Option<Vec<f64>>) -> Vec<f64> {
        let measured: Vec<f64> = (self.observations.rows.iter())
            .map(|row| f64::from(magnitude(row.radiance)))
            .collect();
        let mut robust = vec![1.0; measured.len()];
        let mut x = self.normalised(match start {
            Some(start) => start,
            None => self.solved(&measured, &robust, &measured, vec![0.0; self.mean.len()]),
        });
        for _ in 0..STEPS {
            let lit = self.lit(&x);
            robust = self.robust(&measured, &robust, &lit);
            let next = self.solved(&measured, &robust, &lit, x.clone());
            let next = self.normalised(next);
            let change: f64 = next
                .iter()
                .zip(&x)
                .zip(&self.mean)
                .map(|((a, b), m)| (a - b).abs() * m)
                .sum();
            x = next;
            if change < SETTLED || self.stop.load(Ordering::Relaxed) {
                break;
            }
        }
        x
    }

    /// Weight of each row: a point's rows as parts of its radiance, the outliers among them less.
    fn robust(&self, measured: &[f64], before: &[f64], lit: &[f64]) -> Vec<f64> {
        let mut left = vec![0.0; measured.len()];
        for point in &self.observations.points {
            let own = point.rows.clone();
            let albedo = along(
                &measured[own.clone()],
                &lit[own.clone()],
                &before[own.clone()],
            );
            let size = self.size(&measured[own.clone()]);
            for k in own {
                left[k] = (measured[k] - albedo * lit[k]) / size;
            }
        }
        let mut sizes: Vec<f32> = left.iter().map(|v| v.abs() as f32).collect();
        let deviation = (1.4826 * f64::from(median(&mut sizes))).max(LEAST_ERROR);
        (left.iter())
            .map(|v| 1.0 / (1.0 + (v / (CAUCHY * deviation)).powi(2)))
            .collect()
    }

    /// Radiance of a point that others are compared with.
    fn size(&self, measured: &[f64]) -> f64 {
        let square = measured.iter().map(|v| v * v).sum::<f64>() / measured.len().max(1) as f64;
        square.sqrt() + DARK * self.usual
    }

    /// One step: the strengths that leave least where the albedos are those under the irradiance `lit`, and changes of it along
    /// itself are eliminated.
    fn solved(&self, measured: &[f64], robust: &[f64], lit: &[f64], mut x: Vec<f64>) -> Vec<f64> {
        let n = self.mean.len();
        let starts_along = x.iter().all(|&v| v == 0.0);
        let mut rows = Mat::<f64>::zeros(measured.len(), n);
        let mut right = Mat::<f64>::zeros(measured.len(), 1);
        for point in &self.observations.points {
            let own = point.rows.clone();
            let (weights, lit) = (&robust[own.clone()], &lit[own.clone()]);
            // Along what was measured, only the directions of the two are compared.
            let (albedo, size) = if starts_along {
                (1.0, 1.0)
            } else {
                let measured = &measured[own.clone()];
                (along(measured, lit, weights), self.size(measured))
            };
            let by_light = &self.by_light[own.clone()];
            let squares: f64 = lit.iter().zip(weights).map(|(e, w)| w * e * e).sum();
            if squares <= 0.0 {
                continue;
            }
            for k in 0..n {
                let inner: f64 = (by_light.iter().zip(lit).zip(weights))
                    .map(|((row, e), w)| w * e * row[k])
                    .sum();
                let part = inner / squares;
                for (i, row) in own.clone().enumerate() {
                    let scale = albedo * weights[i].sqrt() / size;
                    rows[(row, k)] = scale * (by_light[i][k] - part * lit[i]);
                }
            }
            if !starts_along {
                for (i, row) in own.enumerate() {
                    right[(row, 0)] = (measured[row] - albedo * lit[i]) * weights[i].sqrt() / size;
                }
            }
        }
        let mut gram = rows.transpose() * &rows;
        let falls = rows.transpose() * &right;
        let diagonal = (0..n).map(|k| gram[(k, k)]).sum::<f64>() / n as f64;
        for &[i, j] in &self.joined {
            let weight = SMOOTHNESS * diagonal;
            gram[(i, i)] += weight;
            gram[(j, j)] += weight;
            gram[(i, j)] -= weight;
            gram[(j, i)] -= weight;
        }
        // Only ratios count: the mean irradiance is held.
        let held = diagonal * n as f64
            / self
                .mean
                .iter()
                .map(|m| m * m)
                .sum::<f64>()
                .max(f64::MIN_POSITIVE);
        for i in 0..n {
            gram[(i, i)] += 1e-9 * diagonal;
            for j in 0..n {
                gram[(i, j)] += held * self.mean[i] * self.mean[j];
            }
        }
        let right: Vec<f64> = (0..n)
            .map(|k| falls[(k, 0)] + held * self.mean[k])
            .collect();
        let params = NnlsParams {
            stop: Some(self.stop),
            ..NnlsParams::default()
        };
        nnls::solve(gram.as_ref(), &right, &mut x, &params);
        x
    }
}

/// Calls `tell` with what reaches a placed point of each of some numbered sources, gray, that it sees.
fn each_reaching<'s>(
    (solver, brdf): (&Solver<'_>, Option<Brdf>),
    point: &Point,
    placed: &Placed,
    sources: impl Iterator<Item = (usize, &'s Source)>,
    mut tell: impl FnMut(usize, f64),
) {
    let origin = solver.occluder.offset_origin(point.position, point.normal);
    let facing = sources.filter_map(|(k, source)| {
        let (to, fall_off) = light_from(solver.near, source.direction, placed.position);
        let cosine = placed.normal.dot(to);
        let reaches = source.flux.element_sum() / 3.0 * fall_off * entering(brdf, cosine);
        let far = distance(solver.near, source.direction, placed.position);
        (cosine > 0.0).then_some(((k, f64::from(reaches)), placed.to_surface * to, far))
    });
    solver
        .occluder
        .each_occluded(origin, facing, |(k, reaches), is_blocked| {
            if !is_blocked {
                tell(k, reaches);
            }
        });
}

/// The best multiple of `of` for `values`, by weight.
fn along(values: &[f64], of: &[f64], weights: &[f64]) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for ((v, e), w) in values.iter().zip(of).zip(weights) {
        product += w * v * e;
        square += w * e * e;
    }
    product / square.max(f64::MIN_POSITIVE)
}
