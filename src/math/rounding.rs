//! Numbers without the digits that say nothing.

/// Bits of the mantissa that are dropped: 13 of 23 are kept.
const DROPPED: u32 = 10;

/// The nearest number of 14 significant bits, 6e-5 of it away at most.
///
/// The digits beyond are noise in anything measured, and most of the size of a file that is compressed without loss.
pub fn to_14_bits(value: f32) -> f32 {
    let half = 1 << (DROPPED - 1);
    let rounded = f32::from_bits(value.to_bits().saturating_add(half) & !((1 << DROPPED) - 1));
    if rounded.is_finite() { rounded } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_keeps_fourteen_bits_of_anything() {
        for value in [0.1_f32, -3.7, 1e-38, 6.5e4, f32::MAX, 1.0 / 3.0, -1e30] {
            let rounded = to_14_bits(value);
            assert!(
                (rounded / value - 1.0).abs() <= 6.2e-5,
                "{value}: {rounded}"
            );
            assert_eq!(to_14_bits(rounded), rounded, "{value} rounded twice");
        }
        assert_eq!(to_14_bits(0.0), 0.0);
        assert_eq!(to_14_bits(-0.0).to_bits(), (-0.0_f32).to_bits());
    }
}
