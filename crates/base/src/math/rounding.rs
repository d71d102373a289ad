//! Numbers without the digits that say nothing.

use half::f16;
use rayon::prelude::*;

/// Largest magnitude of numbers that are rounded to half floats, and the least that the largest of them must have: below
/// it, many would be subnormal.
const HALVES: [f32; 2] = [0.01, 6e4];
/// Bits of a mantissa that go beyond a half float's.
const BEYOND: u32 = 13;

/// Rounds numbers to 11 significant bits, 4.9e-4 of each at most: the rest is noise in anything measured, and most of the
/// size of a file that is compressed without loss. Where half floats have the range for all of them, they are such
/// afterwards.
pub fn round_to_halves(values: &mut [f32]) {
    let largest = values.par_iter().map(|v| v.abs()).reduce(|| 0.0, f32::max);
    let fit = (HALVES[0]..=HALVES[1]).contains(&largest);
    values.par_iter_mut().for_each(|value| {
        *value = if fit {
            f16::from_f32(*value).to_f32()
        } else {
            to_11_bits(*value)
        };
    });
}

fn to_11_bits(value: f32) -> f32 {
    let half_step = 1 << (BEYOND - 1);
    let bits = value.to_bits().saturating_add(half_step) & !((1 << BEYOND) - 1);
    let rounded = f32::from_bits(bits);
    if rounded.is_finite() { rounded } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_keeps_eleven_bits_at_any_scale() {
        let numbers = [0.1_f32, -3.7, 2.5e-3, 0.0, 1.0 / 3.0, -0.9];
        for scale in [1e-30, 1e-4, 1.0, 1e4, 1e30] {
            let exact = numbers.map(|n| n * scale);
            let mut rounded = exact;
            round_to_halves(&mut rounded);
            for (r, e) in rounded.iter().zip(exact) {
                assert!((r - e).abs() <= 4.9e-4 * e.abs(), "{e} became {r}");
            }
            let once = rounded;
            round_to_halves(&mut rounded);
            assert_eq!(rounded, once, "rounded twice, at scale {scale}");
        }
        let mut extreme = [f32::MAX, 1e-38];
        round_to_halves(&mut extreme);
        assert!(extreme[0].is_finite());
    }

    #[test]
    fn common_radiances_become_half_floats() {
        let mut values: Vec<f32> = (0..1000).map(|i| i as f32 * 0.013).collect();
        round_to_halves(&mut values);
        assert!(values.iter().all(|&v| f16::from_f32(v).to_f32() == v));
    }
}
