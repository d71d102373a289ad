//! Numerical building blocks that know nothing of light or surfaces.

pub mod centred;
pub mod exp;
pub mod groups;
pub mod morton;
pub mod nnls;
pub mod random;
pub mod ranks;
pub mod rounding;
pub mod sparse;
pub mod vector;

/// Turn between neighbours on a golden spiral, π (3 − √5) radians: points so turned never line up.
pub const GOLDEN_ANGLE: f32 = 2.399_963_2;

/// The middle value, or the mean of the two; `None` of nothing. Reorders its input.
pub fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    let (lower, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let below = lower.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Some(if even { 0.5 * (below + upper) } else { upper })
}
