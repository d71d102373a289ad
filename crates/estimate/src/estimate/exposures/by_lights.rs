//! Exposures that lights tell.
//!
//! A polished surface shows little that is the same in all views but the lights themselves, so that lights and exposures g have to be found
//! together. In turns they would not be: lights follow wrong exposures and stay there. So what lights can imitate of a view's brightness is
//! taken out of it first, as of any other unknown beside linear ones (Golub and Pereyra, "The differentiation of pseudo-inverses and
//! nonlinear least squares problems whose variables separate", 1973). With p what a fit shows of a view, A the lit cells' columns, both
//! with the points' diffuse colours eliminated, and residuals r, the step of ln g is the minimum of
//!
//! `|r − (I − A (AᵀWA)⁻¹ AᵀW) P ln g|²`
//!
//! under weights W, with one column of P a view.

use std::iter::zip;

use faer::linalg::solvers::Solve;
use faer::{Col, Mat, Side};
use rayon::prelude::*;

use super::super::below::AllAround;
use super::super::cells::Cell;
use super::super::design::Design;
use super::super::fast::Solver;
use super::super::observations::Point;
use super::super::state::{CLUSTERS, ROUGH, State};
use super::super::suspects::left;
use super::super::weights::transmitted_share;
use super::ENOUGH;
use rekindle_base::math::ranks::{SURE, signed_ranks};
use rekindle_base::math::{median, vector};
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// Turns of lights and exposures at each of some roughnesses, radians, and what the latter change by in one at most.
const TURNS: usize = 4;
const SIGMAS: [f32; 4] = [0.2, 0.13, 0.08, 0.05];
const MOST_AT_ONCE: f64 = 0.3;
/// How often rows are weighted anew where what lights leave is judged.
const REWEIGHTINGS: usize = 2;
/// By how much exposures and channels beside one another differ in photographs of one series, as a standard deviation of their logarithms.
const EXPOSURE: f64 = 0.5;
const BALANCE: f64 = 0.1;

/// Exposures that lights say.
pub struct ExposuresByLights {
    /// How much brighter each view is than most in each channel, RGB.
    pub gains: Vec<[f64; 3]>,
    /// Whether lights leave less of the views then than of these as they are, beyond chance: both have as many unknowns. Of a metal that says
    /// little, as all that it shows is light that follows any exposures.
    pub leave_less: bool,
}

/// How much brighter each view is than most of them in each channel, RGB, where lights explain them best; `None` where some views share
/// too little with others.
///
/// Which lobe the surface has shows only once views are evened: each is tried, at roughnesses from the widest on. A metal has no diffuse
/// part: all that it shows comes from somewhere all around, which says more of exposures than what differs between views does.
pub fn by_lights(solver: &Solver<'_>, models: &[SpecularModel]) -> Option<ExposuresByLights> {
    let colours = solver.coarse_colours();
    // Shadows would pass for dark views.
    let of_model = |&model: &SpecularModel| {
        if model == SpecularModel::Metal {
            let bare = colours.without_diffuse();
            let around = AllAround::of(solver);
            let whole = around.solver(solver);
            let everywhere = Design {
                diffuse_known: true,
                ..whole.roots_design(&bare, whole.near)
            };
            of_lobes(&everywhere, &whole.roots(), model, solver.seen.views.len())
        } else {
            let shadowed = solver.coarse_design(&colours);
            of_lobes(&shadowed, &solver.roots(), model, solver.seen.views.len())
        }
    };
    let found: Vec<UnderLobe> = models.par_iter().filter_map(of_model).collect();
    let best = found.into_iter().min_by(|a, b| a.left.total_cmp(&b.left))?;
    let UnderLobe { brdf, gains, .. } = best;
    let leave_less = brdf.model != SpecularModel::Metal && {
        let shadowed = solver.coarse_design(&colours);
        let as_they_are = vec![[1.0; 3]; gains.len()];
        let (before, after) = rayon::join(
            || fitted(&shadowed, &solver.roots(), brdf, &as_they_are),
            || fitted(&shadowed, &solver.roots(), brdf, &gains),
        );
        after.unexplained < before.unexplained && signed_ranks(&before.left, &after.left) > SURE
    };
    Some(ExposuresByLights { gains, leave_less })
}

/// What lights leave of the views.
struct Fitted {
    /// See [`State::unexplained`].
    unexplained: f64,
    /// See [`left`].
    left: Vec<f64>,
}

/// What a lobe's lights on some cells leave of the views, divided by their gains.
fn fitted(shadowed: &Design<'_>, cells: &[Cell], brdf: Brdf, gains: &[[f64; 3]]) -> Fitted {
    let evened = shadowed.observations.divided(gains);
    let design = Design {
        observations: &evened,
        ..shadowed.clone()
    };
    let mut state = State::new(design, cells.to_vec(), brdf);
    for _ in 0..REWEIGHTINGS {
        state.solve_lights(ROUGH);
        state.reweight();
    }
    state.solve_lights(ROUGH);
    Fitted {
        unexplained: state.unexplained(),
        left: left(&state),
    }
}

/// Exposures that lights say under a lobe.
struct UnderLobe {
    brdf: Brdf,
    /// How much brighter each view is than most in each channel, RGB.
    gains: Vec<[f64; 3]>,
    /// What lights leave then.
    left: f64,
}

/// Those of a model's roughness that leaves least.
fn of_lobes(
    shadowed: &Design<'_>,
    cells: &[Cell],
    model: SpecularModel,
    views: usize,
) -> Option<UnderLobe> {
    let mut best: Option<UnderLobe> = None;
    let mut gains = vec![[1.0; 3]; views];
    for sigma in SIGMAS {
        let brdf = Brdf::new(model, sigma);
        let left = taken_in_turns(shadowed, cells, brdf, &mut gains)?;
        if best.as_ref().is_none_or(|best| left < best.left) {
            let gains = gains.clone();
            best = Some(UnderLobe { brdf, gains, left });
        }
    }
    best
}

/// Lets lights and the views' gains take turns under a lobe; what they leave then.
fn taken_in_turns(
    shadowed: &Design<'_>,
    cells: &[Cell],
    brdf: Brdf,
    gains: &mut [[f64; 3]],
) -> Option<f64> {
    let mut left = f64::INFINITY;
    let mut radiance = vec![[0.0; 3]; cells.len()];
    for turn in 0..TURNS {
        let evened = shadowed.observations.divided(gains);
        let design = Design {
            observations: &evened,
            ..shadowed.clone()
        };
        let mut state = State::new(design, cells.to_vec(), brdf);
        if turn > 0 {
            state.light_by(&radiance);
            state.reweight();
        }
        state.solve_lights(ROUGH);
        left = state.unexplained();
        let excess = excess_beside_lights(&state, gains)?;
        for (gain, excess) in gains.iter_mut().zip(excess) {
            for (gain, excess) in gain.iter_mut().zip(excess) {
                *gain *= excess.clamp(-MOST_AT_ONCE, MOST_AT_ONCE).exp();
            }
        }
        relate_to_most(gains)?;
        radiance = state.radiance;
    }
    Some(left)
}

/// Takes the scale of each channel to be that of most views, which lights follow.
fn relate_to_most(gains: &mut [[f64; 3]]) -> Option<()> {
    for channel in 0..3 {
        let mut all: Vec<f64> = gains.iter().map(|gain| gain[channel]).collect();
        let most = median(&mut all)?;
        for gain in &mut *gains {
            gain[channel] /= most;
        }
    }
    Some(())
}

/// By how much, as logarithms, each view is still brighter in each channel, RGB, than the others and `gains` say, where lights follow it.
/// What no light tells is held by what cameras do, see [`EXPOSURE`] and [`BALANCE`].
fn excess_beside_lights(state: &State<'_>, gains: &[[f64; 3]]) -> Option<Vec<[f64; 3]>> {
    let views = gains.len();
    let mut counts = vec![0; views];
    for row in &state.design.observations.rows {
        counts[row.view] += 1;
    }
    if counts.iter().any(|&count| count < ENOUGH) {
        return None;
    }
    let clusters = Sums::of_clusters(state, views);
    // Unknowns are channel by channel, each view by view.
    let (of_exposure, of_balance) = (EXPOSURE.powi(-2), BALANCE.powi(-2));
    let mut gram = Mat::<f64>::zeros(3 * views, 3 * views);
    let mut right = vec![0.0; 3 * views];
    for channel in 0..3 {
        let (own, pull, dispersion) = told(state, &clusters, channel);
        for i in 0..views {
            let at = channel * views + i;
            right[at] += pull[i] / dispersion;
            for j in 0..views {
                gram[(at, channel * views + j)] += own[(i, j)] / dispersion;
            }
            // (1/3 Σ ln g)² of a view's three gains is held to 0, and each ln g less that mean.
            for other in 0..3 {
                let same = if other == channel { 1.0 } else { 0.0 };
                let held = of_exposure / 9.0 + of_balance * (same - 1.0 / 3.0);
                gram[(at, other * views + i)] += held;
                right[at] -= held * gains[i][other].ln();
            }
        }
    }
    let factor = gram.llt(Side::Lower).ok()?;
    let solution = factor.solve(&Col::from_fn(3 * views, |i| right[i]));
    let of_view = |i: usize| [0, 1, 2].map(|c| solution[c * views + i]);
    Some((0..views).map(of_view).collect())
}

/// What one channel tells of the views' brightness once lights have followed it: the normal equations, and by how much what points of like
/// normals say is spread beyond what these count for.
fn told(state: &State<'_>, clusters: &[Sums], channel: usize) -> (Mat<f64>, Vec<f64>, f64) {
    let views = clusters.first().map_or(0, |sums| sums.pull[channel].len());
    let sum = |of: &dyn Fn(&Sums) -> f64| clusters.iter().map(of).sum::<f64>();
    let lit = state.lit();
    let shared = Mat::from_fn(lit.len(), views, |k, v| {
        sum(&|sums| f64::from(sums.shared[channel][v][k]))
    });
    let imitation = state.imitation(channel, &lit, &shared);
    let imitated = shared.transpose() * &imitation;
    let gram = Mat::from_fn(views, views, |i, j| {
        sum(&|sums| sums.gram[channel][(i, j)]) - imitated[(i, j)]
    });
    let (mut pull, mut spread) = (vec![0.0; views], 0.0);
    for sums in clusters {
        for (v, pull) in pull.iter_mut().enumerate() {
            let lights = zip(&sums.lights[channel], imitation.col(v).iter());
            let by_lights: f64 = lights.map(|(&a, x)| f64::from(a) * x).sum();
            let own = sums.pull[channel][v] - by_lights;
            *pull += own;
            spread += own * own;
        }
    }
    let counted: f64 = (0..views).map(|i| gram[(i, i)]).sum();
    (gram, pull, (spread / counted).max(f64::MIN_POSITIVE))
}

/// Weighted products over the rows of some points, in each channel; lit cells are numbered as [`State::lit`] has them.
struct Sums {
    /// Of what is shown of each view with that of each other, diffuse colours eliminated.
    gram: [Mat<f64>; 3],
    /// Of what is shown of each view with the residuals.
    pull: [Vec<f64>; 3],
    /// Of what is shown of each view with each lit cell's column.
    shared: [Vec<Vec<f32>>; 3],
    /// Of the residuals with each lit cell's column.
    lights: [Vec<f32>; 3],
}

impl Sums {
    /// Those of runs of points of like normals.
    fn of_clusters(state: &State<'_>, views: usize) -> Vec<Self> {
        let lit = state.lit();
        let design = state.design.restricted(&lit);
        let matrix = design.matrix(&state.brdf);
        let points = &design.observations.points;
        let runs = points.par_chunks(points.len().div_ceil(CLUSTERS).max(1));
        let of_run = |run: &[Point]| {
            let mut sums = Self::zeros(views, lit.len());
            for point in run {
                let own = point.rows.start * lit.len()..point.rows.end * lit.len();
                sums.add(state, point, &matrix[own]);
            }
            sums
        };
        runs.map(of_run).collect()
    }

    fn zeros(views: usize, lit: usize) -> Self {
        Self {
            gram: [(); 3].map(|()| Mat::zeros(views, views)),
            pull: [(); 3].map(|()| vec![0.0; views]),
            shared: [(); 3].map(|()| vec![vec![0.0; lit]; views]),
            lights: [(); 3].map(|()| vec![0.0; lit]),
        }
    }

    /// Adds the rows of a point, of whose lit cells `matrix` has the columns, row by row.
    fn add(&mut self, state: &State<'_>, point: &Point, matrix: &[f32]) {
        let observations = state.design.observations;
        let rows = &observations.rows[point.rows.clone()];
        let weights = &state.weights[point.rows.clone()];
        let left = &state.residuals.values[point.rows.clone()];
        let brdf = state.brdf.at(observations.glosses[point.gloss]);
        // Eliminated values are z − t Σ s z, and with weights that is symmetrical.
        let share = transmitted_share(&brdf, rows, weights);
        let lit = matrix.len() / rows.len().max(1);
        let of_row = |i: usize| &matrix[i * lit..(i + 1) * lit];
        let mut mean = vec![0.0; lit];
        for (i, (into, _)) in share.iter().enumerate() {
            vector::add_scaled(&mut mean, *into, of_row(i));
        }
        let shown = |i: usize, c: usize| rows[i].radiance[c] - left[i][c];
        let mut column = vec![0.0; lit];
        for (i, row) in rows.iter().enumerate() {
            column.copy_from_slice(of_row(i));
            vector::add_scaled(&mut column, -share[i].1, &mean);
            for (c, &residual) in left[i].iter().enumerate() {
                let own = weights[i] * shown(i, c);
                self.pull[c][row.view] += f64::from(own * residual);
                vector::add_scaled(&mut self.shared[c][row.view], own, &column);
                vector::add_scaled(&mut self.lights[c], weights[i] * residual, &column);
                for (j, other) in rows.iter().enumerate() {
                    let kept = if i == j { 1.0 } else { 0.0 };
                    let product = own * shown(j, c) * (kept - share[j].0 * share[i].1);
                    self.gram[c][(row.view, other.view)] += f64::from(product);
                }
            }
        }
    }
}
