//! Do the views' exposures agree, as far as the light found explains their differences?
//!
//! A view that is brighter than it should be by the factor 1 + a has rows y (1 − a) = t D + s, where s is the specular part.
//! With the points' diffuse colours D eliminated that is linear in a, and so are small differences of exposure found by
//! one least-squares problem with one unknown a view, whose sum is zero.

use faer::linalg::solvers::Solve;
use faer::{Col, Mat, Side};
use rayon::prelude::*;

use std::ops::Range;

use super::below::AllAround;
use super::cells::Cell;
use super::design::Design;
use super::fast::Solver;
use super::observations::{Point, Row};
use super::state::{CLUSTERS, ROUGH, State};
use super::weights::transmitted_share;
use rekindle_base::math::{centred, median};
use rekindle_scene::reflectance::{Brdf, SpecularModel};

/// Only differences past this, or where there are any past the other, and past this many standard errors, are any.
const LEAST: f64 = 0.003;
const LEAST_KNOWN: f64 = 0.001;
const SURE: f64 = 5.0;
/// Points at which more than this share of a row is specular say little: coarse cells are not where the lamps are.
const MOST_SPECULAR: f32 = 0.1;
/// Turns of lights and exposures at each of some roughnesses, radians, and what the latter change by in one at most.
const TURNS: usize = 4;
const SIGMAS: [f32; 3] = [0.13, 0.08, 0.05];
const MOST_AT_ONCE: f64 = 0.3;
/// By how much exposures and channels beside one another differ in photographs of one series, as a standard deviation of their logarithms.
const EXPOSURE: f64 = 0.5;
const BALANCE: f64 = 0.1;
/// Every view has to have this many rows.
const ENOUGH: usize = 50;
/// Exposures must account for this part of what is left over: where the model of light is not the object's, they take up some
/// of that.
const LEAST_EXPLAINED: f64 = 0.5;

/// How much brighter each view is than the common scale, if any differs; `views` is how many there are. Where exposures are
/// `known` to differ, this is how much is left of that.
pub fn differing(state: &State<'_>, views: usize, known: bool) -> Option<Vec<f64>> {
    let observations = state.design.observations;
    let points = observations.points.iter();
    let diffuse: Vec<&Point> = points.filter(|point| is_diffuse(state, point)).collect();
    let (excess, errors, explained) = excess(state, views, &diffuse)?;
    let least = if known { LEAST_KNOWN } else { LEAST };
    let differs = |(a, e): (&f64, &f64)| a.abs() > least.max(SURE * e);
    let matters = known || explained > LEAST_EXPLAINED;
    let differ = matters && excess.iter().zip(&errors).any(differs);
    differ.then(|| excess.iter().map(|a| 1.0 + a).collect())
}

/// Factors found before, nothing where there were none, and after: both.
pub fn together(before: &[f64], mut factors: Vec<f64>) -> Vec<f64> {
    for (factor, before) in factors.iter_mut().zip(before) {
        *factor *= before;
    }
    factors
}

/// How much brighter each view is than most of them in each channel, RGB, and the lobe with which lights then explain them best; `None`
/// where some views share too little with others.
///
/// A polished surface shows little that is the same in all views but the lights themselves, and which lobe it has shows once views are
/// evened: both are sought together, each lobe at roughnesses from the widest on. A metal has no diffuse part: all that it shows comes from
/// somewhere all around, which says more of exposures than what differs between views does.
pub fn by_lights(solver: &Solver<'_>, models: &[SpecularModel]) -> Option<ByLights> {
    let colours = solver.coarse_colours();
    let bare = colours.without_diffuse();
    let around = AllAround::of(solver);
    let whole = around.solver(solver);
    let of_model = |&model: &SpecularModel| {
        // Shadows would pass for dark views.
        let (shadowed, cells) = if model == SpecularModel::Metal {
            let everywhere = whole.roots_design(&bare, whole.near);
            let design = Design {
                diffuse_known: true,
                ..everywhere
            };
            (design, whole.roots())
        } else {
            (solver.coarse_design(&colours), solver.roots())
        };
        let mut best: Option<ByLights> = None;
        let mut gains = vec![[1.0; 3]; solver.seen.views.len()];
        for sigma in SIGMAS {
            let brdf = Brdf::new(model, sigma);
            let left = taken_in_turns(&shadowed, &cells, brdf, &mut gains)?;
            if best.as_ref().is_none_or(|best| left < best.left) {
                let gains = gains.clone();
                best = Some(ByLights { gains, brdf, left });
            }
        }
        best
    };
    let found: Vec<ByLights> = models.par_iter().filter_map(of_model).collect();
    found.into_iter().min_by(|a, b| a.left.total_cmp(&b.left))
}

/// Exposures that lights say.
pub struct ByLights {
    /// How much brighter each view is than most in each channel, RGB.
    pub gains: Vec<[f64; 3]>,
    /// The lobe that leaves least then.
    pub brdf: Brdf,
    /// What it leaves.
    left: f64,
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

/// Whether little of any of a point's rows is specular.
fn is_diffuse(state: &State<'_>, point: &Point) -> bool {
    point.rows.clone().all(|k| {
        let specular: f32 = state.specular(k).iter().sum();
        let all: f32 = state.design.observations.rows[k].radiance.iter().sum();
        specular <= MOST_SPECULAR * all
    })
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

/// By how much, as logarithms, each view is still brighter in each channel, RGB, than the others and `gains` say, where lights follow it:
/// what they and the diffuse colours can imitate of a view's brightness is taken out of it first (variable projection, as of σ in
/// [`State::sigma_step`]). What no light tells is held by what cameras do, see [`EXPOSURE`] and [`BALANCE`].
fn excess_beside_lights(state: &State<'_>, gains: &[[f64; 3]]) -> Option<Vec<[f64; 3]>> {
    let views = gains.len();
    let rows = &state.design.observations.rows;
    let residuals = &state.residuals.values;
    let mut counts = vec![0; views];
    for row in rows {
        counts[row.view] += 1;
    }
    if counts.iter().any(|&count| count < ENOUGH) {
        return None;
    }
    let own = |view: usize| {
        let shown = rows.iter().zip(residuals).map(|(row, left)| {
            let kept = if row.view == view { 1.0 } else { 0.0 };
            std::array::from_fn(|c| kept * (row.radiance[c] - left[c]))
        });
        state.unexplained_part(shown.collect())
    };
    let columns: Vec<Vec<[f32; 3]>> = (0..views).into_par_iter().map(own).collect();
    // Unknowns are channel by channel, each view by view.
    let (of_exposure, of_balance) = (EXPOSURE.powi(-2), BALANCE.powi(-2));
    let mut gram = Mat::<f64>::zeros(3 * views, 3 * views);
    let mut right = vec![0.0; 3 * views];
    for channel in 0..3 {
        let (own, pull, dispersion) = told(state, &columns, channel);
        for i in 0..views {
            let at = channel * views + i;
            right[at] += pull[i] / dispersion;
            for j in 0..views {
                gram[(at, channel * views + j)] += own[(i, j)] / dispersion;
            }
            // (1/3 Σ g)² of a view's three logarithms is held to 0, and each less that mean.
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
    Some(
        (0..views)
            .map(|i| [0, 1, 2].map(|c| solution[c * views + i]))
            .collect(),
    )
}

/// What one channel's rows tell of the views' brightness, of which `columns` are what nothing else can imitate: the normal equations,
/// and by how much what points of like normals say is spread beyond what these count for.
fn told(state: &State<'_>, columns: &[Vec<[f32; 3]>], channel: usize) -> (Mat<f64>, Vec<f64>, f64) {
    let views = columns.len();
    let product = |rows: Range<usize>, one: &[[f32; 3]], other: &[[f32; 3]]| -> f64 {
        let both = one[rows.clone()].iter().zip(&other[rows.clone()]);
        (both.zip(&state.weights[rows]))
            .map(|((a, b), w)| f64::from(w * a[channel] * b[channel]))
            .sum()
    };
    let all = 0..state.weights.len();
    let gram = Mat::from_fn(views, views, |i, j| {
        product(all.clone(), &columns[i], &columns[j])
    });
    let (mut pull, mut spread) = (vec![0.0; views], 0.0);
    let points = &state.design.observations.points;
    for cluster in points.chunks(points.len().div_ceil(CLUSTERS).max(1)) {
        let rows = cluster[0].rows.start..cluster[cluster.len() - 1].rows.end;
        for (pull, column) in pull.iter_mut().zip(columns) {
            let own = product(rows.clone(), column, &state.residuals.values);
            *pull += own;
            spread += own * own;
        }
    }
    let counted: f64 = (0..views).map(|i| gram[(i, i)]).sum();
    (gram, pull, (spread / counted).max(f64::MIN_POSITIVE))
}

/// The excess a of each view, as some points say, its standard error, with one group a point, and the part of the
/// weighted squared residuals that goes away with it.
fn excess(state: &State<'_>, views: usize, points: &[&Point]) -> Option<(Vec<f64>, Vec<f64>, f64)> {
    let inner = |point: &Point, column: &[[f32; 3]], values: &dyn Fn(usize) -> [f32; 3]| {
        inner(state, point, column, values)
    };
    let mut counts = vec![0; views];
    let mut gram = Mat::<f64>::zeros(views, views);
    let mut right = vec![0.0; views];
    let mut squares = 0.0;
    for point in points {
        let columns = columns(state, point);
        let all = &state.residuals.values[point.rows.clone()];
        squares += inner(point, all, &|k| state.residuals.values[k]);
        for (j, (view, column)) in columns.iter().enumerate() {
            counts[*view] += 1;
            right[*view] += inner(point, column, &|k| state.residuals.values[k]);
            for (other, second) in &columns[..=j] {
                let product = inner(point, column, &|k| second[k - point.rows.start]);
                gram[(*view, *other)] += product;
                if view != other {
                    gram[(*other, *view)] += product;
                }
            }
        }
    }
    if counts.iter().any(|&count| count < ENOUGH) {
        return None;
    }
    let factor = centred::factor(&gram)?;
    let solution = factor.solve(&Col::from_fn(views, |v| right[v]));
    let mut spread = Mat::<f64>::zeros(views, views);
    for point in points {
        let columns = columns(state, point);
        let left = |k: usize| {
            let mut left = state.residuals.values[k];
            for (view, column) in &columns {
                for (l, c) in left.iter_mut().zip(column[k - point.rows.start]) {
                    *l -= solution[*view] as f32 * c;
                }
            }
            left
        };
        let pulls: Vec<(usize, f64)> = columns
            .iter()
            .map(|(view, column)| (*view, inner(point, column, &left)))
            .collect();
        for &(i, a) in &pulls {
            for &(j, b) in &pulls {
                spread[(i, j)] += a * b;
            }
        }
    }
    let half = factor.solve(&spread);
    let covariance = factor.solve(&half.transpose().to_owned());
    let errors = (0..views).map(|v| covariance[(v, v)].max(0.0).sqrt());
    let mut excess: Vec<f64> = solution.iter().copied().collect();
    let fall: f64 = excess.iter().zip(&right).map(|(a, b)| a * b).sum();
    // The scale is that of most views, which none can move far by itself.
    let common = median(&mut excess.clone()).unwrap_or(0.0);
    for excess in &mut excess {
        *excess -= common;
    }
    Some((
        excess,
        errors.collect(),
        fall / squares.max(f64::MIN_POSITIVE),
    ))
}

/// What an excess of each view that sees a point adds to its rows, the diffuse colour eliminated.
fn columns(state: &State<'_>, point: &Point) -> Vec<(usize, Vec<[f32; 3]>)> {
    let rows: &[Row] = &state.design.observations.rows[point.rows.clone()];
    let weights = &state.weights[point.rows.clone()];
    let brdf = state
        .brdf
        .at(state.design.observations.glosses[point.gloss]);
    let share = transmitted_share(&brdf, rows, weights);
    (0..rows.len())
        .map(|own| {
            let column = (0..rows.len()).map(|k| {
                let kept = if k == own { 1.0 } else { 0.0 };
                let factor = kept - share[own].0 * share[k].1;
                rows[own].radiance.map(|v| factor * v)
            });
            (rows[own].view, column.collect())
        })
        .collect()
}

/// Weighted product of a column and values of a point's rows.
fn inner(
    state: &State<'_>,
    point: &Point,
    column: &[[f32; 3]],
    values: &dyn Fn(usize) -> [f32; 3],
) -> f64 {
    point
        .rows
        .clone()
        .zip(column)
        .map(|(k, c)| {
            let values = values(k);
            let product: f32 = c.iter().zip(values).map(|(c, v)| c * v).sum();
            f64::from(state.weights[k] * product)
        })
        .sum()
}
