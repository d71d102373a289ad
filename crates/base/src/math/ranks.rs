//! Comparing two explanations of the same data without a model of the noise.

use glam::Vec3;

/// Standard deviations of chance beyond which one explanation is better: one case in 740 is that by chance.
pub const SURE: f64 = 3.0;

/// Groups of values whose differences are ranked.
const GROUPS: usize = 32;

/// By how many standard deviations of chance the values of `second` are less than those of `first`: Wilcoxon's signed ranks
/// ("Individual comparisons by ranking methods", 1945) of the differences between groups of values that follow each other, so that no
/// single value decides. Both have the same length.
pub fn signed_ranks(first: &[f64], second: &[f64]) -> f64 {
    let size = first.len().div_ceil(GROUPS).max(1);
    let groups = first.chunks(size).zip(second.chunks(size));
    ranked(
        groups
            .map(|(a, b)| a.iter().sum::<f64>() - b.iter().sum::<f64>())
            .collect(),
    )
}

/// The same of values with weights of their own, not negative, of which each group has as much as another: where few values can
/// tell, they are not all in one group.
pub fn weighted_signed_ranks(weights: &[f64], first: &[f64], second: &[f64]) -> f64 {
    let total = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let mut differences = vec![0.0; GROUPS];
    let mut before = 0.0;
    for ((weight, a), b) in weights.iter().zip(first).zip(second) {
        let middle = (before + 0.5 * weight) / total;
        before += weight;
        differences[((middle * GROUPS as f64) as usize).min(GROUPS - 1)] += a - b;
    }
    ranked(differences)
}

/// The same of pairs of values at places, none negative: between parts of space that hold as much of both together each, so that where
/// there is more to tell there are more of them.
pub fn placed_signed_ranks(pairs: &[(Vec3, f64, f64)]) -> f64 {
    let mut differences = Vec::with_capacity(GROUPS);
    compare(&mut pairs.to_vec(), GROUPS, &mut differences);
    ranked(differences)
}

/// Cuts space in two where half of all values lies on each side, across the longest extent, until there are so many parts, and adds by how
/// much the first values are more than the second ones in each.
fn compare(pairs: &mut [(Vec3, f64, f64)], parts: usize, differences: &mut Vec<f64>) {
    if parts == 1 {
        differences.push(pairs.iter().map(|(_, a, b)| a - b).sum());
        return;
    }
    let low = pairs.iter().fold(Vec3::MAX, |m, p| m.min(p.0));
    let high = pairs.iter().fold(Vec3::MIN, |m, p| m.max(p.0));
    let axis = (high - low).max_position();
    pairs.sort_by(|a, b| a.0[axis].total_cmp(&b.0[axis]));
    let half = 0.5 * pairs.iter().map(|(_, a, b)| a + b).sum::<f64>();
    let mut before = 0.0;
    let cut = pairs.iter().position(|(_, a, b)| {
        before += a + b;
        before > half
    });
    let (one, other) = pairs.split_at_mut(cut.unwrap_or(pairs.len() / 2));
    compare(one, parts / 2, differences);
    compare(other, parts / 2, differences);
}

/// By how many standard deviations of chance some differences are positive.
fn ranked(mut differences: Vec<f64>) -> f64 {
    differences.retain(|d| *d != 0.0);
    differences.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let n = differences.len() as f64;
    let signed: f64 = (differences.iter().enumerate())
        .map(|(rank, d)| (rank + 1) as f64 * d.signum())
        .sum();
    // The variance of the sum of n signed ranks is n (n + 1) (2n + 1) / 6.
    signed / (n * (n + 1.0) * (2.0 * n + 1.0) / 6.0).max(1.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_less_everywhere_is_sure_and_what_is_less_by_chance_is_not() {
        let first: Vec<f64> = (0..640).map(|i| 1.0 + (f64::from(i) * 0.7).sin()).collect();
        let less: Vec<f64> = first.iter().map(|v| 0.9 * v).collect();
        assert!(signed_ranks(&first, &less) > 4.0);
        assert!(signed_ranks(&less, &first) < -4.0);
        let mixed: Vec<f64> = (first.iter().enumerate())
            .map(|(i, v)| v * if i / 20 % 2 == 0 { 0.9 } else { 1.1 })
            .collect();
        assert!(signed_ranks(&first, &mixed).abs() < 1.5);
        // All the gain in one place.
        let mut single = first.clone();
        single[5] = -1e6;
        assert!(signed_ranks(&first, &single) < 2.0);
        assert_eq!(signed_ranks(&first, &first), 0.0);
    }

    #[test]
    fn pairs_that_vary_from_place_to_place_are_compared_where_they_are() {
        let at = |i: usize| {
            let turn = i as f32 * 2.4;
            Vec3::new(turn.cos(), turn.sin(), (i as f32 * 0.37).sin())
        };
        let noise = |i: usize| (i as f64 * 12.9898).sin();
        // What both leave varies much more than by what they differ.
        let both = |i: usize, part: f64| {
            let field = 10.0 + 8.0 * f64::from(at(i).x) + 2.0 * noise(i);
            (at(i), field, part * field + 0.2 * noise(i + 7000))
        };
        let of = |part: f64| -> Vec<_> { (0..900).map(|i| both(i, part)).collect() };
        assert!(placed_signed_ranks(&of(0.95)) > 4.0);
        assert!(placed_signed_ranks(&of(1.05)) < -4.0);
        assert!(placed_signed_ranks(&of(1.0)).abs() < 2.0);
        assert_eq!(placed_signed_ranks(&[]), 0.0);
    }

    #[test]
    fn a_difference_in_one_corner_where_most_is_left_is_seen() {
        let at = |i: usize| {
            let turn = i as f32 * 2.4;
            Vec3::new(turn.cos(), turn.sin(), (i as f32 * 0.37).sin())
        };
        let noise = |i: usize| 1.0 + 0.9 * (i as f64 * 12.9898).sin();
        let shines = |p: Vec3| p.x > 0.8 && p.z > 0.0;
        let of = |other: usize, [first, second]: [f64; 2]| -> Vec<(Vec3, f64, f64)> {
            let value = |i, left| noise(i) * if shines(at(i)) { left } else { 1.0 };
            let pair = |i| {
                let there = if shines(at(i)) { second } else { 1.0 };
                (at(i), value(i, first), noise(i + other) * there)
            };
            (0..1500).map(pair).collect()
        };
        assert!(placed_signed_ranks(&of(5000, [30.0, 15.0])) > SURE);
        assert!(placed_signed_ranks(&of(5000, [15.0, 30.0])) < -SURE);
        // Chance is not taken for more in whichever comes first.
        let sum: f64 = (1..40)
            .map(|k| placed_signed_ranks(&of(5000 * k, [30.0, 30.0])))
            .sum();
        assert!((sum / 39.0).abs() < 0.5, "{sum}");
    }

    #[test]
    fn few_values_that_can_tell_are_heard_among_many_that_cannot() {
        let noise = |i: usize| (i as f64 * 12.9898).sin();
        let tells = |i: usize| (300..360).contains(&i);
        let weights: Vec<f64> = (0..640)
            .map(|i| if tells(i) { 1.0 } else { 1e-3 })
            .collect();
        let first: Vec<f64> = (0..640).map(|i| 5.0 + noise(i)).collect();
        let second: Vec<f64> = (0..640)
            .map(|i| 5.0 - if tells(i) { 1.5 } else { 0.0 } + noise(i + 7000))
            .collect();
        assert!(signed_ranks(&first, &second) < SURE);
        assert!(weighted_signed_ranks(&weights, &first, &second) > 4.0);
        assert!(weighted_signed_ranks(&weights, &second, &first) < -4.0);
        assert_eq!(weighted_signed_ranks(&weights, &first, &first), 0.0);
        assert_eq!(weighted_signed_ranks(&[], &[], &[]), 0.0);
    }
}
