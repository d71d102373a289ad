//! A branch-free exponential that compilers turn into vector code.

use std::f32::consts::{LN_2, LOG2_E};

/// `exp(x)` for `x ≤ 0` with a relative error below 2e-7·(2 + |x|), mostly the rounding of `x` itself; 0 below
/// about −87.
///
/// Splits `x·log₂e` into an integer, written into the exponent bits, and a fraction in [−½, ½], for which a
/// polynomial of degree 6 stands.
#[inline(always)]
pub fn exp_negative(x: f32) -> f32 {
    // Adding 1.5·2²³ rounds to the nearest integer and leaves it in the low mantissa bits.
    const ROUND: f32 = 12_582_912.0;
    let t = (x * LOG2_E).max(-126.0);
    let shifted = t + ROUND;
    let f = t - (shifted - ROUND);
    let p = 1.540_353_e-4_f32;
    let p = p * f + 1.333_355_8e-3;
    let p = p * f + 9.618_129e-3;
    let p = p * f + 5.550_410_9e-2;
    let p = p * f + 2.402_265_1e-1;
    let p = p * f + LN_2;
    let p = p * f + 1.0;
    let scale = f32::from_bits(shifted.to_bits().wrapping_add(127) << 23);
    if t <= -126.0 { 0.0 } else { p * scale }
}

#[cfg(test)]
mod tests {
    use super::exp_negative;

    #[test]
    fn agrees_with_the_standard_library() {
        for i in 0..200_000 {
            let x = -(i as f32) * 4.3e-4;
            let (fast, exact) = (exp_negative(x), f64::from(x).exp());
            assert!(
                (f64::from(fast) / exact - 1.0).abs() < 2e-7 * (2.0 + f64::from(x.abs())),
                "exp({x}) = {fast}, exactly {exact}"
            );
        }
        assert_eq!(exp_negative(-1000.0), 0.0, "underflow must be clean");
        assert_eq!(exp_negative(0.0), 1.0, "exp(0) must be exact");
    }
}
