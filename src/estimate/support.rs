//! Which of the lights found do the data ask for?
//!
//! A lamp lowers the residuals at all points that show its highlight. What imitates noise, or a few bad pixels, lowers them
//! at some points and raises them at nearly as many: the sum over points is then small against its own scatter. Noise takes
//! a little light from all over the hemisphere; left in place, it would be split into single nodes and named as lamps.

use super::state::{Precision, State};

/// Lights of less than this share of the flux are looked at; brighter ones explain too much to be noise.
const MOST_SHARE: f32 = 0.01;

/// Sum over surface points of what a light takes off the squared residuals, in units of its scatter, below which it is
/// taken for noise. Lights of noise come to 3 at most on captures with truth, lamps to 6 and more.
const LEAST_SUPPORT: f64 = 5.0;

/// Drops the lights that the data do not ask for and solves for the others; whether there were any.
pub fn drop_unsupported(state: &mut State<'_>, precision: Precision) -> bool {
    let flux = |cells: &[usize]| cells.iter().map(|&k| state.flux(k)).sum::<f32>();
    let total = flux(&state.lit());
    let mut dropped = vec![false; state.cells.len()];
    for patch in patches(state, state.brdf.sigma) {
        if flux(&patch) < MOST_SHARE * total && support(state, &patch) < LEAST_SUPPORT {
            for k in patch {
                dropped[k] = true;
            }
        }
    }
    if !dropped.contains(&true) {
        return false;
    }
    let kept: Vec<usize> = (0..dropped.len()).filter(|&k| !dropped[k]).collect();
    *state = state.with_cells(&kept);
    state.solve_lit(precision);
    true
}

/// Lit cells, those together that lie beside each other or nearer to each other than `width`, radians: within a lobe's
/// width their lobes can hardly be told apart.
pub fn patches(state: &State<'_>, width: f32) -> Vec<Vec<usize>> {
    let directions = &state.design.geometry.directions;
    let together = |i: usize, j: usize| {
        state.is_beside(i, j) || directions[i].distance_squared(directions[j]) < width * width
    };
    let mut left = state.lit();
    let mut patches = Vec::new();
    while let Some(first) = left.pop() {
        let mut patch = vec![first];
        let mut next = 0;
        while let Some(&cell) = patch.get(next) {
            next += 1;
            let (near, far): (Vec<_>, Vec<_>) = left.iter().partition(|&&k| together(k, cell));
            patch.extend(near);
            left = far;
        }
        patches.push(patch);
    }
    patches
}

/// Sum over points of the fall of the weighted squared residuals by some of the cells, as a multiple of the root of the sum
/// of its squares.
fn support(state: &State<'_>, cells: &[usize]) -> f64 {
    let mut alone = vec![[0.0; 3]; state.cells.len()];
    for &k in cells {
        alone[k] = state.radiance[k];
    }
    let mut own = state.design.predict_values(&state.brdf, &alone);
    state.eliminate(&mut own);
    let (mut sum, mut squares) = (0.0_f64, 0.0_f64);
    for point in &state.design.observations.points {
        let mut fall = 0.0_f64;
        for k in point.rows.clone() {
            for (s, r) in own[k].iter().zip(state.residuals.values[k]) {
                fall += f64::from(state.weights[k] * s * (s + 2.0 * r));
            }
        }
        sum += fall;
        squares += fall * fall;
    }
    sum / squares.sqrt().max(f64::MIN_POSITIVE)
}
