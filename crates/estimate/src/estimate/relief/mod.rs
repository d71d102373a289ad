//! The surface of a mesh that is coarser or noisier than its highlights allow, refined by them.
//!
//! Normals that are off by as much as the lobe is wide make highlights look like those of many lights in a narrow lobe.
//! The fair surface through the mesh ([`Fairing`]) is nearer to the object, but not near enough. So its places are moved
//! along its normals by heights d, which are estimated together with a few lamps and σ as the minimum of
//!
//! `Σ w (I − I_S(n(d), lamps, σ) − diffuse)²/s² + dᵀ P d`
//!
//! over the rows of all points that show a lamp, each point's diffuse colour eliminated as everywhere. s² is the mean
//! squared residual and P the precision of the fair surface, so both parts are in their own units
//! and nothing is tuned. A height moves the normals around it; what it does to places is left to the next round.
//!
//! Lamps are points here. Cells would do what normals are wanted to do: with many of them lit, any normals will do. And
//! they are looked for with a lobe that is too wide, which lights few cells. The final lights and σ are estimated from
//! the refined surface afresh.
//!
//! Under broad light, as in a room, few lamps are no explanation, and normals bent to serve as one are worse than the fair
//! ones. So the first rounds leave some views out, which the heights then have to explain better than the fair surface does;
//! where they do not, the fair surface it is.
//!
//! What lamps can't explain, lights found on cells of that surface often can. So once there are some, the heights move under these,
//! which are held: no light then does what normals should, nor normals what lights should ([`Relief::bend`]).

mod equations;
mod held;
mod lamps;
mod smoothing;

use std::ops::AddAssign;
use std::sync::OnceLock;

use faer::Col;
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::SpecularChoice;
use super::design::Design;
use super::fast::{Solver, Watch};
use super::held_out::{CHANCE, common_noise, in_noise, left_in};
use super::observations::{Observations, Point, Seen};
use super::observer::{Stopped, go_on};
use super::weights::median;
use rekindle_base::math::ranks::signed_ranks;
use rekindle_capture::{Mesh, View};
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::surface::{Fairing, Occluder, ViewSurface, area_vectors};

use equations::{Equations, LinearRows};
use lamps::{Lamps, WIDER, design, wide_lamps};
use smoothing::{pixels_per_triangle, smoothed};

/// What is reported of it.
const WHAT: &str = "refining the surface";

/// Rounds, and those in which σ stays as it is, so that the lamps find their places first.
const ROUNDS: usize = 8;
const ROUNDS_AT_FIRST_SIGMA: usize = 2;
/// Rounds from all views but some, which then have to be explained better; and the points at which they are looked at.
const ROUNDS_ON_TRIAL: usize = 4;
const POINTS_ON_TRIAL: usize = 4000;
/// One view in so many is left out then.
const TURNS: usize = 3;
/// A round that changes σ by less than this part of it is the last.
const SETTLED: f32 = 5e-3;

/// Pixels that a triangle must cover for the views to show more than it says: it is divided into sixteen.
const LEAST_PIXELS: f64 = 16.0;

/// Most points that take part.
const POINTS: usize = 24_000;
/// They are always cut into this many runs, so that sums come out the same on any number of threads.
const RUNS: usize = 4;

/// Pixels of a view at which the normals of two surfaces are compared, about.
const TILTS_PER_VIEW: usize = 20_000;

/// Angle by which normals and lamps are turned for their derivatives, radians.
const TURN: f32 = 1e-3;

/// A finer mesh in place of a coarse one.
#[derive(Clone, Debug)]
pub struct RefinedSurface {
    /// The surface, without texture coordinates.
    pub mesh: Mesh,
    /// Median angle by which normals were turned, radians.
    pub median_tilt: f32,
}

/// What a solver needs beside a mesh: what the views see of it, and what hides what.
pub struct Bench {
    occluder: Occluder,
    surfaces: Vec<ViewSurface>,
}

impl Bench {
    /// Looks at a mesh from all views.
    pub fn new(mesh: &Mesh, views: &[View]) -> Self {
        let occluder = Occluder::new(mesh);
        let surfaces = views
            .par_iter()
            .map(|v| ViewSurface::new(mesh, &occluder, &v.camera))
            .collect();
        Self { occluder, surfaces }
    }

    /// The solver of the same capture with `mesh` in place of its own.
    pub fn solver<'b>(&'b self, other: &'b Solver<'_>, mesh: &'b Mesh) -> Solver<'b> {
        let seen = Seen {
            mesh,
            surfaces: &self.surfaces,
            ..other.seen
        };
        Solver {
            coarse: Solver::coarse_observations(
                &seen,
                other.near_to,
                Some(other.coarse.scale),
                other.stop,
            ),
            coarse_sees: OnceLock::new(),
            seen,
            occluder: &self.occluder,
            ..*other
        }
    }
}

/// A surface on its way.
pub struct Relief {
    fairing: Fairing,
    /// Unit normals of the fair surface, along which places move.
    along: Vec<DVec3>,
    /// How far, mesh units.
    heights: Vec<f64>,
}

/// A surface that explains the highlights better than the solver's; `None` where the mesh is neither coarse nor noisy or does not
/// determine a fair one. It is smoothed as far as a lobe of `model` says.
pub fn refine(
    solver: &Solver<'_>,
    model: SpecularModel,
    choice: SpecularChoice,
    watch: &mut Watch<'_>,
) -> Result<Option<Relief>, Stopped> {
    go_on(watch.observer.progress(WHAT, 0.3))?;
    let start = if pixels_per_triangle(&solver.seen) >= LEAST_PIXELS {
        Fairing::new(solver.seen.mesh).map(|fairing| (Relief::new(fairing), true))
    } else {
        smoothed(solver, model, watch)?
    };
    let Some((mut relief, is_fairer)) = start else {
        return Ok(None);
    };
    let smooth = relief.mesh();
    let bench = Bench::new(&smooth, solver.seen.views);
    let on_fair = bench.solver(solver, &smooth);
    let (lamps, sigma) = wide_lamps(&on_fair, choice, watch)?;
    let is_refined = relief.refine_with_lamps(&on_fair, lamps, sigma, watch)?;
    Ok((is_refined || is_fairer).then_some(relief))
}

/// One view in so many is left out on trial.
fn is_out(view: usize) -> bool {
    view.is_multiple_of(TURNS)
}

/// Median angle between the normals of two surfaces at the pixels that show both, radians.
pub fn median_tilt(before: &Seen<'_>, after: &Seen<'_>) -> f32 {
    let mut tilts = Vec::new();
    let surfaces = before.surfaces.iter().zip(after.surfaces);
    for (view, (one, other)) in before.views.iter().zip(surfaces) {
        // An odd step falls on all columns in turn.
        let step = one.interior.len().div_ceil(TILTS_PER_VIEW) | 1;
        for i in (0..one.interior.len()).step_by(step) {
            let (x, y) = (i as u32 % one.width, i as u32 / one.width);
            let normal = |surface: &ViewSurface, mesh| {
                let point = surface.point(mesh, &view.camera, x, y)?;
                surface.interior[i].then_some(point.normal)
            };
            if let (Some(a), Some(b)) = (normal(one, before.mesh), normal(other, after.mesh)) {
                tilts.push(a.angle_between(b));
            }
        }
    }
    median(&mut tilts)
}

/// The same points with every normal turned by `angle` towards the first or second tangent of its frame.
pub fn tilted(observations: &Observations, second: bool, angle: f32) -> Observations {
    let mut tilted = observations.clone();
    turn(&mut tilted, |point| {
        let (t1, t2) = point.normal.any_orthonormal_pair();
        let tangent = if second { t2 } else { t1 };
        (point.normal + angle * tangent).normalize_or_zero()
    });
    tilted
}

/// Gives every point another normal.
fn turn(observations: &mut Observations, normal: impl Fn(&Point) -> Vec3) {
    for point in &mut observations.points {
        point.normal = normal(point);
        for row in &mut observations.rows[point.rows.clone()] {
            row.cos_view = point.normal.dot(row.to_camera);
        }
    }
}

/// A unit normal with its derivatives by heights.
type Slopes = (DVec3, Vec<(usize, DVec3)>);

/// Values of numbered unknowns, ascending, those of the same one added up.
fn summed<T: Copy + AddAssign>(mut values: Vec<(usize, T)>) -> Vec<(usize, T)> {
    values.sort_by_key(|&(i, _)| i);
    values.dedup_by(|next, sum| {
        let is_same = next.0 == sum.0;
        if is_same {
            sum.1 += next.1;
        }
        is_same
    });
    values
}

impl Relief {
    fn new(fairing: Fairing) -> Self {
        let along = area_vectors(&fairing.positions, &fairing.triangles)
            .iter()
            .map(|n| n.normalize_or_zero())
            .collect();
        let heights = vec![0.0; fairing.positions.len()];
        Self {
            fairing,
            along,
            heights,
        }
    }

    fn positions(&self) -> Vec<DVec3> {
        let places = self.fairing.positions.iter().zip(&self.along);
        places
            .zip(&self.heights)
            .map(|((p, n), h)| *p + *h * *n)
            .collect()
    }

    pub fn mesh(&self) -> Mesh {
        self.fairing.mesh_at(&self.positions())
    }

    /// Points that show a lamp, with the normals of the present surface; `solver` is of the fair one.
    fn points(&self, solver: &Solver<'_>, lamps: &Lamps) -> Observations {
        let mut points = solver.points_showing(&lamps.directions, &lamps.brdf, POINTS);
        self.turn(&mut points);
        points
    }

    /// Gives points of the fair surface the normals of the present one.
    fn turn(&self, observations: &mut Observations) {
        let mesh = self.mesh();
        turn(observations, |point| {
            mesh.point(point.on.0, point.on.1).normal
        });
    }

    /// Whether views that had no say in the heights are explained better by them, beyond chance, than by the fair surface at any of
    /// some roughnesses: with the lamps that were found, as bright on each surface as the other views say.
    fn predicts(&self, solver: &Solver<'_>, lamps: &Lamps, sigmas: &[f32]) -> bool {
        let fair = solver.points_showing(&lamps.directions, &lamps.brdf, POINTS_ON_TRIAL);
        let fair = fair.to_gray();
        let mut present = fair.clone();
        self.turn(&mut present);
        let [fair, present] = [&fair, &present].map(|points| design(solver, lamps, points));
        let around = lamps.around(solver);
        let noise = common_noise(&fair);
        let left = |on: &Design<'_>, sigma: f32| -> Vec<f64> {
            let brdf = Brdf {
                sigma,
                ..lamps.brdf
            };
            let left = left_in(on, &around, brdf, &in_noise(on, noise), &[0.0], is_out);
            left.iter().flatten().map(|left| left.lit).collect()
        };
        let refined = left(&present, lamps.brdf.sigma);
        let is_better = |&sigma: &f32| signed_ranks(&left(&fair, sigma), &refined) > CHANCE;
        sigmas.iter().all(is_better)
    }

    /// Moves the heights together with a few lamps, found on the fair surface, which `solver` is of and where a lobe of `sigma` fits best, as
    /// long as that explains views that had no say in it. Whether it does.
    fn refine_with_lamps(
        &mut self,
        solver: &Solver<'_>,
        mut lamps: Lamps,
        sigma: f32,
        watch: &mut Watch<'_>,
    ) -> Result<bool, Stopped> {
        if lamps.directions.is_empty() {
            return Ok(false);
        }
        // Of fewer views none can be spared.
        let on_trial = if solver.seen.views.len() < TURNS {
            0
        } else {
            ROUNDS_ON_TRIAL
        };
        for round in 0..ROUNDS {
            let done = 0.3 + 0.3 * round as f32 / ROUNDS as f32;
            go_on(watch.observer.progress(WHAT, done))?;
            let mut points = self.points(solver, &lamps);
            if round < on_trial {
                points = points.without_views(is_out).0;
            }
            let free_sigma = round >= ROUNDS_AT_FIRST_SIGMA;
            let before = lamps.brdf.sigma;
            let step = self.step(solver, &mut lamps, &points, free_sigma);
            if step.is_none() || watch.observer.enough() {
                break;
            }
            if round + 1 == on_trial {
                let sigmas = [sigma, WIDER * sigma, lamps.brdf.sigma];
                if !self.predicts(solver, &lamps, &sigmas) {
                    self.heights.fill(0.0);
                    return Ok(false);
                }
            }
            let is_settled = (lamps.brdf.sigma / before - 1.0).abs() < SETTLED;
            if free_sigma && round >= on_trial && is_settled {
                break;
            }
        }
        Ok(true)
    }

    /// A Gauss-Newton step of heights and lamps from points with the present surface's normals. `None` where there is none.
    fn step(
        &mut self,
        solver: &Solver<'_>,
        lamps: &mut Lamps,
        observations: &Observations,
        free_sigma: bool,
    ) -> Option<()> {
        let design = design(solver, lamps, observations);
        let mut by_lamps = lamps.derivatives(&design);
        if !free_sigma {
            by_lamps[0].fill([0.0; 3]);
        }
        let rows = LinearRows::new(&design, (&lamps.brdf, &lamps.flux), by_lamps);
        let step = self.moved(observations, &rows)?;
        lamps.take(&step);
        Some(())
    }

    /// Moves the heights by a Gauss-Newton step of them and of what may change beside them, whose step is returned.
    fn moved(&mut self, observations: &Observations, rows: &LinearRows) -> Option<Col<f64>> {
        let slopes = self.slopes();
        let points = &observations.points;
        let parts: Vec<Equations> = (0..RUNS)
            .into_par_iter()
            .map(|run| {
                let cut = |k: usize| points.len() * k / RUNS;
                let mut equations = Equations::new(self.heights.len(), rows.by_lamps.len());
                for point in &points[cut(run)..cut(run + 1)] {
                    let own = rows.point_equations(point, &mut equations);
                    equations.add(&own, &self.tilts(point, &slopes));
                }
                equations
            })
            .collect();
        let mut equations = Equations::new(self.heights.len(), rows.by_lamps.len());
        for part in &parts {
            equations.merge(part);
        }
        equations.hold(&self.fairing, &self.heights);
        let (step, others) = equations.solve()?;
        for (h, s) in self.heights.iter_mut().zip(step) {
            *h += s;
        }
        Some(others)
    }

    /// For each place its unit normal, and the derivative of that by every height that turns it.
    fn slopes(&self) -> Vec<Slopes> {
        let positions = self.positions();
        let triangles = &self.fairing.triangles;
        let mut turned: Vec<Vec<(usize, DVec3)>> = vec![Vec::new(); positions.len()];
        for t in triangles {
            for k in 0..3 {
                let [i, j, l] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
                // Of the area vector ½ (xᵢ × xⱼ + xⱼ × xₗ + xₗ × xᵢ).
                let slope = 0.5 * (positions[l] - positions[j]).cross(self.along[i]);
                for &place in t {
                    turned[place].push((i, slope));
                }
            }
        }
        let sums = area_vectors(&positions, triangles);
        let of_place = |(sum, slopes): (DVec3, Vec<(usize, DVec3)>)| {
            let normal = sum.normalize_or_zero();
            let unit = |d: DVec3| (d - normal * normal.dot(d)) / sum.length().max(1e-300);
            let slopes = summed(slopes).into_iter().map(|(i, d)| (i, unit(d)));
            (normal, slopes.collect())
        };
        sums.into_par_iter().zip(turned).map(of_place).collect()
    }

    /// Derivative of a point's normal, along the tangents of its frame, by every height that turns it.
    fn tilts(&self, point: &Point, slopes: &[Slopes]) -> Vec<(usize, DVec2)> {
        let (triangle, barycentric) = point.on;
        let weights = [
            1.0 - barycentric.x - barycentric.y,
            barycentric.x,
            barycentric.y,
        ];
        let corners = self.fairing.triangles[triangle as usize];
        let (t1, t2) = point.normal.any_orthonormal_pair();
        let (t1, t2) = (t1.as_dvec3(), t2.as_dvec3());
        let mut sum = DVec3::ZERO;
        let mut tilts = Vec::new();
        for (&place, weight) in corners.iter().zip(weights) {
            let (normal, slopes) = &slopes[place];
            sum += f64::from(weight) * *normal;
            for (i, slope) in slopes {
                let tilt = DVec2::new(t1.dot(*slope), t2.dot(*slope));
                tilts.push((*i, f64::from(weight) * tilt));
            }
        }
        let length = sum.length().max(1e-300);
        let tilts = summed(tilts).into_iter();
        tilts.map(|(i, t)| (i, t / length)).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use rekindle_scene::surface::fixtures::bumpy_sphere;

    #[test]
    fn tilts_by_heights_agree_with_finite_differences() {
        let mut relief = Relief::new(Fairing::new(&bumpy_sphere(8, 0.1)).unwrap());
        for (i, height) in relief.heights.iter_mut().enumerate() {
            *height = 0.01 * (i as f64).sin();
        }
        let on = (700, Vec2::new(0.2, 0.5));
        let normal = |relief: &Relief| relief.mesh().point(on.0, on.1).normal;
        let point = Point {
            position: Vec3::ZERO,
            normal: normal(&relief),
            on,
            pixel: (0, 0, 0),
            gloss: 0,
            rows: 0..0,
        };
        let (t1, t2) = point.normal.any_orthonormal_pair();
        let tilts = relief.tilts(&point, &relief.slopes());
        assert!(tilts.len() >= 10, "{} places turn the normal", tilts.len());
        let largest = tilts.iter().fold(0.0_f64, |m, t| m.max(t.1.length()));
        for (place, tilt) in tilts {
            let step = 1e-3;
            let at = |height: f64| {
                let mut moved = Relief {
                    fairing: relief.fairing.clone(),
                    along: relief.along.clone(),
                    heights: relief.heights.clone(),
                };
                moved.heights[place] += height;
                normal(&moved)
            };
            let turned = (at(step) - at(-step)) / (2.0 * step as f32);
            let difference = Vec2::new(t1.dot(turned), t2.dot(turned)).as_dvec2();
            assert!(
                (difference - tilt).length() < 5e-3 * largest,
                "{difference} against {tilt}, the largest is {largest}"
            );
        }
    }
}
