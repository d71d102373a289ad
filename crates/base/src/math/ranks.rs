//! Comparing two explanations of the same data without a model of the noise.

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
