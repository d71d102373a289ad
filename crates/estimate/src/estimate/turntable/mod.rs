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

mod diffuse;
mod discs;

use std::sync::atomic::Ordering;

use glam::Vec3;
use rayon::prelude::*;

use diffuse::{Shading, placed_rows};
use discs::Disc;

use super::Estimate;
use super::cells::Pyramid;
use super::fast::Solver;
use super::lobes::light_from;
use super::observations::{Motion, Observations, Placed, Point, Row};
use super::shading::{MEAN_ALBEDO, brightest, lit_children, mean};
use super::weights::{DETAIL_SHARE, magnitude, median};
use crate::registration::Agreement;
use rekindle_base::math::ranks::{SURE, signed_ranks};
use rekindle_scene::hemisphere::{HemisphereGrid, Lamp, find_lamps, rest};
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

/// Where light that stands still with the object leaves less of points' radiance than this, there is nothing to explain: gloss that
/// weakens the diffuse part towards the rim makes it look a little as if it were lit from the camera.
const CALM: f64 = 0.05;
/// What light that stands still with the camera may leave at most, as a part of that: it leaves 2 to 14 % on made turntables; 59 to 86 % where
/// exposures, highlights of a metal or a crude mesh make the views of a still object differ.
const WORTH: f64 = 1.0 / 3.0;

/// Lamps of a smaller angular radius, radians, are placed as discs, as long as there are not more.
const LARGE: f32 = 0.17;
const MOST_DISCS: usize = 8;
/// Standard deviation of the part of a light that a pixel in its penumbra sees, squared, over that part and the rest.
const PENUMBRA: f32 = 0.25;
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
    ground: Ground<'a>,
    lights: Vec<Light>,
    /// Standard deviation of what is known of it, as a part of it.
    error: f32,
    /// Irradiance by light from everywhere, RGB.
    ambient: Vec3,
}

/// A surface that light falls on.
#[derive(Clone, Copy)]
struct Ground<'a> {
    occluder: &'a Occluder,
    near: Option<(Vec3, f32)>,
    /// The lobe, whose diffuse layer gets what it lets in.
    brdf: Option<Brdf>,
}

/// Light from some directions.
#[derive(Clone, Debug)]
struct Light {
    sources: Vec<Source>,
    /// The first so many of them lie around the others: a place that sees all of them, or none, sees all others, or none. 0 where they
    /// lie anyhow.
    outline: usize,
}

/// A direction that light comes from.
#[derive(Clone, Copy, Debug)]
struct Source {
    direction: Vec3,
    /// Radiance × solid angle, RGB.
    flux: Vec3,
}

impl Ground<'_> {
    /// Calls `tell` with each of some sources, by what it goes with, that a placed point faces, what reaches the point of it where nothing
    /// is in the way, and whether something is. Rays start at `origin` on the surface.
    fn each_reaching<'s, T: Copy>(
        &self,
        (origin, placed): (Vec3, &Placed),
        sources: impl Iterator<Item = (T, &'s Source)>,
        mut tell: impl FnMut(T, Vec3, bool),
    ) {
        let facing = sources.filter_map(|(what, source)| {
            let (to, reaches) = self.reaching(placed, source)?;
            let far = distance(self.near, source.direction, placed.position);
            Some(((what, reaches), placed.to_surface * to, far))
        });
        self.occluder
            .each_occluded(origin, facing, |(what, reaches), is_blocked| {
                tell(what, reaches, is_blocked);
            });
    }

    /// The direction to a source that a placed point faces, and what reaches the point of it where nothing is in the way.
    fn reaching(&self, placed: &Placed, source: &Source) -> Option<(Vec3, Vec3)> {
        let (to, fall_off) = light_from(self.near, source.direction, placed.position);
        let cosine = placed.normal.dot(to);
        let entering = cosine * self.brdf.map_or(1.0, |brdf| brdf.diffuse_entry(cosine));
        (cosine > 0.0).then_some((to, source.flux * (fall_off * entering)))
    }

    /// What reaches a placed point of a light, and what would if nothing were in the way.
    fn of_light(&self, at: (Vec3, &Placed), light: &Light) -> [Vec3; 2] {
        let (outline, others) = light.sources.split_at(light.outline);
        let (mut seen, mut hidden) = (Vec3::ZERO, Vec3::ZERO);
        let mut look = |sources: &[Source]| {
            let sources = sources.iter().map(|source| ((), source));
            self.each_reaching(at, sources, |(), reaches, is_blocked| {
                *if is_blocked { &mut hidden } else { &mut seen } += reaches;
            });
            [seen, hidden]
        };
        let [seen, hidden] = look(outline);
        if (seen == Vec3::ZERO) == (hidden == Vec3::ZERO) {
            return look(others);
        }
        let facing = others
            .iter()
            .filter_map(|source| self.reaching(at.1, source));
        let inside: Vec3 = facing.map(|(_, reaches)| reaches).sum();
        if hidden == Vec3::ZERO {
            [seen + inside, hidden]
        } else {
            [seen, hidden + inside]
        }
    }
}

impl Irradiance<'_> {
    /// What a point on the surface has in some rows, and how unsure that makes them; takes out of their radiance what differs between
    /// the channels only.
    pub fn tell(&self, position: Vec3, normal: Vec3, rows: &mut [Row]) {
        let origin = self.ground.occluder.offset_origin(position, normal);
        let told: Vec<(Vec3, Vec3)> = (rows.iter())
            .map(|row| {
                row.placed
                    .map_or((Vec3::ONE, Vec3::ZERO), |placed| self.at(origin, &placed))
            })
            .collect();
        let of_rows: Vec<Vec3> = told.iter().map(|told| told.0).collect();
        let total: Vec3 = of_rows.iter().sum();
        let tint = 3.0 * total / total.element_sum().max(f32::MIN_POSITIVE);
        let albedo = albedo(rows, &of_rows);
        for (row, (irradiance, error)) in rows.iter_mut().zip(told) {
            let gray = irradiance.element_sum() / 3.0;
            let coloured = albedo * (irradiance - tint * gray);
            row.radiance = (Vec3::from(row.radiance) - coloured).to_array();
            row.irradiance = gray.max(LEAST_IRRADIANCE);
            row.detail = row
                .detail
                .hypot(magnitude((albedo * error).to_array()) / DETAIL_SHARE);
        }
    }

    /// At a surface point as it lies before one camera, from which rays start at `origin` on the surface, and its standard deviation.
    fn at(&self, origin: Vec3, placed: &Placed) -> (Vec3, Vec3) {
        let (mut sum, mut squares) = (self.ambient, Vec3::ZERO);
        for light in &self.lights {
            let [seen, hidden] = self.ground.of_light((origin, placed), light);
            sum += seen;
            // A pixel in a penumbra may lie anywhere in it.
            squares += PENUMBRA * seen * hidden;
        }
        squares += (self.error * sum).powf(2.0);
        (sum, squares.powf(0.5))
    }

    /// The same with a mean of 1 over some points.
    fn over_mean(mut self, observations: &Observations) -> Self {
        let gray = |(point, row): (&Point, &Row)| {
            let occluder = self.ground.occluder;
            let origin = occluder.offset_origin(point.position, point.normal);
            let at = row
                .placed
                .map_or(Vec3::ONE, |placed| self.at(origin, &placed).0);
            f64::from(at.element_sum()) / 3.0
        };
        let all: Vec<f64> = placed_rows(observations)
            .into_par_iter()
            .map(gray)
            .collect();
        let gain = (1.0 / mean(&all).max(f64::MIN_POSITIVE)) as f32;
        for light in &mut self.lights {
            *light = light.times(gain);
        }
        self.ambient *= gain;
        self
    }
}

impl Light {
    /// From anywhere.
    fn of(sources: Vec<Source>) -> Self {
        Self {
            sources,
            outline: 0,
        }
    }

    /// So many times as strong.
    fn times(&self, gain: f32) -> Self {
        let source = |source: &Source| Source {
            flux: source.flux * gain,
            ..*source
        };
        Self {
            sources: self.sources.iter().map(source).collect(),
            ..*self
        }
    }
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

/// Whether light that stands still with the camera explains the diffuse part of points that had no say better than light that stands
/// still with the object, beyond chance and by far.
pub fn is_told(solver: &Solver<'_>) -> bool {
    let observations = solver.colours(POINTS).measured().to_gray();
    let halves = [0, 1].map(|first| observations.every(2, first));
    let grid = solver.grid.to_whole();
    let pyramid = Pyramid::new(&grid, FREQUENCY);
    let cells = pyramid.roots();
    // Light from everywhere is the same in all views, which may be exposed differently, as the other half of the points says.
    let even = |half: &Observations, others: &Observations| {
        let evened = half.divided(&gains(others, solver.seen.views.len()));
        Shading::of_lights((solver, None), &evened, &[]).left_of_points(&[1.0])
    };
    let still = [even(&halves[0], &halves[1]), even(&halves[1], &halves[0])].concat();
    if middle(&still) < CALM {
        return false;
    }
    let shadings =
        (halves.each_ref()).map(|half| Shading::of_cells(solver, half, &pyramid, &cells));
    let turning = [&shadings[1], &shadings[0]].map(|others| others.light(None));
    let turning: Vec<f64> = (shadings.iter().zip(&turning))
        .flat_map(|(shading, x)| shading.left_of_points(x))
        .collect();
    middle(&turning) < WORTH * middle(&still) && signed_ranks(&still, &turning) > SURE
}

/// How much brighter each view is than the others; none is where they share too little.
fn gains(observations: &Observations, views: usize) -> Vec<[f64; 3]> {
    let shown = |point: &Point| -> Vec<(usize, [f64; 3])> {
        let rows = &observations.rows[point.rows.clone()];
        rows.iter()
            .map(|row| (row.view, row.radiance.map(f64::from)))
            .collect()
    };
    let points = observations.points.iter().map(shown).collect();
    let gains = Agreement::of(views, points).gains();
    gains.unwrap_or_else(|| vec![[1.0; 3]; views])
}

fn middle(values: &[f64]) -> f64 {
    let mut values: Vec<f32> = values.iter().map(|&v| v as f32).collect();
    f64::from(median(&mut values))
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
    let observations = solver.colours(POINTS).measured().to_gray();
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
    let lights = (0..cells.len()).filter(|&k| bright[k]).map(|k| {
        Light::of(vec![Source {
            direction: geometry.directions[k],
            flux: Vec3::splat(x[k] as f32 * geometry.solid_angles[k]),
        }])
    });
    let dim: f64 = (0..cells.len())
        .filter(|&k| !bright[k])
        .map(|k| x[k] * shading.mean[k])
        .sum();
    let irradiance = Irradiance {
        ground: Ground {
            occluder,
            near: solver.near,
            brdf: None,
        },
        lights: lights.collect(),
        error: shading.error(&x),
        ambient: Vec3::splat(dim as f32),
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
    let observations = solver.colours(POINTS).measured().to_gray();
    let (small, large): (Vec<&Lamp>, Vec<&Lamp>) = (lamps.iter().chain(&strays))
        .partition(|lamp| lamp.angular_radius < LARGE && lamps.len() <= MOST_DISCS);
    let mut lights: Vec<Light> = (large.iter())
        .map(|lamp| Light::of(merged(grid, nodes, &lamp.nodes)))
        .collect();
    let discs: Vec<Disc> = small.iter().map(|lamp| Disc::of(lamp)).collect();
    let discs = discs::refined((solver, found.brdf), &observations, &discs, &lights);
    lights.extend(discs.iter().map(Disc::light));
    if lights.is_empty() {
        return None;
    }
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
    let error = shading.error(&x);
    let lights = lights.iter().zip(gains);
    let irradiance = Irradiance {
        ground: Ground {
            occluder,
            near: solver.near,
            brdf: found.brdf,
        },
        lights: lights.map(|(l, &gain)| l.times(gain as f32)).collect(),
        error,
        ambient: Vec3::splat(*ambient as f32),
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
