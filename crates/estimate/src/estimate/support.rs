//! Which of the lights found do the data ask for?
//!
//! A lamp lowers the residuals at all points that show its highlight. What imitates noise, or a few bad pixels, lowers them
//! at some points and raises them at nearly as many: the sum over points is then small against its own scatter. Noise takes
//! a little light from all over the hemisphere, and most from beside bright lamps, whose highlights are the noisiest; left in
//! place, it would be split into single nodes and named as lamps.

use std::collections::BTreeSet;

use super::state::{EXACT, Precision, State};
use rekindle_base::math::groups::linked_groups;

/// Lights of less than this share of the flux are dim.
const DIM: f32 = 0.01;
/// Brighter ones up to this share are looked at in the end: from behind, a little noise at grazing views asks for much light.
const BRIGHT: f32 = 0.2;

/// A light is a satellite of one that is this many times as bright, if it lies no further from it than this many σ. Cells
/// nearer to each other than the width, in σ, are one light here.
const MUCH_BRIGHTER: f32 = 10.0;
const SATELLITE_REACH: f32 = 4.0;
const SATELLITE_WIDTH: f32 = 0.7;

/// Sum over surface points of what a light takes off the squared residuals, in units of its scatter, below which it is
/// taken for noise. On captures with truth lights of noise come to 3 at most, lamps to 9 and more.
const LEAST_SUPPORT: f64 = 5.0;
/// The same for lights that are not dim: noise from behind comes to 1.4 at most, parts of lamps to 4.7 and more.
const LEAST_SUPPORT_OF_BRIGHT: f64 = 2.5;

/// What was dropped can come up again beside its place; this many times it is looked for.
const MOST_ROUNDS: usize = 3;

/// Drops the dim lights that the data do not ask for and solves for the others; whether there were any.
pub fn drop_unsupported(state: &mut State<'_>, precision: Precision) -> bool {
    let dropped = unsupported(state, &[(DIM, LEAST_SUPPORT)]);
    drop_cells(state, &dropped, precision)
}

/// [`drop_unsupported`] of a fit that is final but for these: also of lights that are not dim, with the dark cells a lobe's
/// width about them, where they would come up again.
pub fn drop_unsupported_in_the_end(state: &mut State<'_>) {
    let bounds = [(DIM, LEAST_SUPPORT), (BRIGHT, LEAST_SUPPORT_OF_BRIGHT)];
    for _ in 0..MOST_ROUNDS {
        let mut dropped = unsupported(state, &bounds);
        if dropped.is_empty() {
            return;
        }
        let reach = state.lobe_width();
        let lit: BTreeSet<usize> = state.lit().into_iter().collect();
        let dark = (0..state.cells.len()).filter(|k| !lit.contains(k));
        let around: Vec<usize> = dark
            .filter(|&k| is_near(state, &[k], &dropped, reach))
            .collect();
        dropped.extend(around);
        drop_cells(state, &dropped, EXACT);
    }
}

/// Cells of the lights of less than a share of the flux whose support is less than the bound of the first such share.
fn unsupported(state: &State<'_>, bounds: &[(f32, f64)]) -> Vec<usize> {
    let total = state.flux(&state.lit());
    let mut dropped = Vec::new();
    for patch in patches(state, state.brdf.sigma) {
        let share = state.flux(&patch) / total;
        let Some((_, least)) = bounds.iter().find(|(most, _)| share < *most) else {
            continue;
        };
        let own = contribution(state, &state.radiance, &darkened(&state.radiance, &patch));
        if support(state, &own, &state.residuals.values) < *least {
            dropped.extend(patch);
        }
    }
    dropped
}

/// Drops the satellites of bright lamps that these explain nearly as well in their place.
pub fn drop_satellites(state: &mut State<'_>) {
    for _ in 0..MOST_ROUNDS {
        let dropped = needless_satellites(state);
        if !drop_cells(state, &dropped, EXACT) {
            return;
        }
    }
}

/// Cells of the satellites that the data do not ask for, looked at in turn, the dimmest first.
fn needless_satellites(state: &State<'_>) -> Vec<usize> {
    let width = SATELLITE_WIDTH * state.brdf.sigma;
    let reach = SATELLITE_REACH * state.brdf.sigma;
    let mut lamps: Vec<(f32, Vec<usize>)> = patches(state, width)
        .into_iter()
        .map(|cells| (state.flux(&cells), cells))
        .collect();
    lamps.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut dropped = Vec::new();
    let mut radiance = state.radiance.clone();
    let mut residuals = state.residuals.values.clone();
    for (k, (flux, lamp)) in lamps.iter().enumerate() {
        let mut brighter = lamps[k..].iter().filter(|b| b.0 > MUCH_BRIGHTER * flux);
        if !brighter.any(|b| is_near(state, lamp, &b.1, reach)) {
            continue;
        }
        let without = state.refit(&darkened(&radiance, lamp), EXACT);
        let own = contribution(state, &radiance, &without);
        if support(state, &own, &residuals) < LEAST_SUPPORT {
            dropped.extend(lamp);
            radiance = without;
            for (residual, own) in residuals.iter_mut().flatten().zip(own.iter().flatten()) {
                *residual += own;
            }
        }
    }
    dropped
}

/// Solves without some of the cells; whether there are any.
fn drop_cells(state: &mut State<'_>, dropped: &[usize], precision: Precision) -> bool {
    if dropped.is_empty() {
        return false;
    }
    let dropped: BTreeSet<usize> = dropped.iter().copied().collect();
    let kept: Vec<usize> = (0..state.cells.len())
        .filter(|k| !dropped.contains(k))
        .collect();
    *state = state.with_cells(&kept);
    state.solve_lit(precision);
    true
}

/// Radiances with some of the cells dark.
fn darkened(radiance: &[[f32; 3]], cells: &[usize]) -> Vec<[f32; 3]> {
    let mut darkened = radiance.to_vec();
    for &k in cells {
        darkened[k] = [0.0; 3];
    }
    darkened
}

/// Whether some cell lies nearer than `reach`, radians, to one of others.
fn is_near(state: &State<'_>, one: &[usize], other: &[usize], reach: f32) -> bool {
    let directions = &state.design.geometry.directions;
    let mut pairs = one.iter().flat_map(|&a| other.iter().map(move |&b| (a, b)));
    pairs.any(|(a, b)| directions[a].distance_squared(directions[b]) < reach * reach)
}

/// Lit cells, those together that lie beside each other or nearer to each other than `width`, radians: within a lobe's
/// width their lobes can hardly be told apart.
pub fn patches(state: &State<'_>, width: f32) -> Vec<Vec<usize>> {
    let directions = &state.design.geometry.directions;
    let together = |i: usize, j: usize| {
        state.is_beside(i, j) || directions[i].distance_squared(directions[j]) < width * width
    };
    linked_groups(state.lit(), |&i, &j| together(i, j))
}

/// What some lights show at the rows that others do not, each point's best diffuse colour taken out.
fn contribution(state: &State<'_>, lights: &[[f32; 3]], others: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let change: Vec<[f32; 3]> = lights
        .iter()
        .zip(others)
        .map(|(l, o)| std::array::from_fn(|c| l[c] - o[c]))
        .collect();
    let mut own = state.design.predict_values(&state.brdf, &change);
    state.eliminate(&mut own);
    own
}

/// Sum over points of the fall of the weighted squared residuals by what a light shows, as a multiple of the root of the sum
/// of its squares.
fn support(state: &State<'_>, own: &[[f32; 3]], residuals: &[[f32; 3]]) -> f64 {
    let (mut sum, mut squares) = (0.0_f64, 0.0_f64);
    for point in &state.design.observations.points {
        let mut fall = 0.0_f64;
        for k in point.rows.clone() {
            for (s, r) in own[k].iter().zip(residuals[k]) {
                fall += f64::from(state.weights[k] * s * (s + 2.0 * r));
            }
        }
        sum += fall;
        squares += fall * fall;
    }
    sum / squares.sqrt().max(f64::MIN_POSITIVE)
}
