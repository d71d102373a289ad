//! Repeatable random numbers that depend on a key and an index only, so that they can be asked for in any order and from
//! any thread.

use std::f64::consts::TAU;

use glam::DVec3;

/// Scrambles 64 bits: the finaliser of `SplitMix64` (Steele, Lea and Flood 2014).
pub fn scramble(z: u64) -> u64 {
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Increment of `SplitMix64`: 2⁶⁴ over the golden ratio.
pub const GOLDEN_STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// A family of random numbers.
#[derive(Clone, Copy, Debug)]
pub struct Random {
    key: u64,
}

impl Random {
    /// The numbers of a seed for one purpose; purposes of one seed have nothing in common.
    pub fn new(seed: u64, purpose: u64) -> Self {
        let key = scramble(seed.wrapping_add(GOLDEN_STEP));
        Self {
            key: scramble(key ^ purpose.wrapping_mul(GOLDEN_STEP)),
        }
    }

    /// The family's member number `index`, itself a family.
    #[must_use]
    pub fn of(self, index: u64) -> Self {
        Self::new(self.key, index)
    }

    /// Uniform in (0, 1).
    pub fn uniform(self, index: u64) -> f64 {
        let bits = scramble(self.key.wrapping_add(index.wrapping_mul(GOLDEN_STEP))) >> 11;
        (bits as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// Normal, of mean 0 and variance 1 (Box and Muller 1958).
    pub fn normal(self, index: u64) -> f64 {
        let (u, v) = (self.uniform(2 * index), self.uniform(2 * index + 1));
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    }

    /// A unit vector, all directions alike.
    pub fn direction(self, index: u64) -> DVec3 {
        let z = 2.0 * self.uniform(2 * index) - 1.0;
        let (sin, cos) = (TAU * self.uniform(2 * index + 1)).sin_cos();
        let across = (1.0 - z * z).max(0.0).sqrt();
        DVec3::new(across * cos, across * sin, z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_distributions() {
        let random = Random::new(3, 1);
        let count = 20_000;
        let mean = |f: &dyn Fn(u64) -> f64| (0..count).map(f).sum::<f64>() / count as f64;
        assert!((mean(&|i| random.uniform(i)) - 0.5).abs() < 0.01);
        assert!(mean(&|i| random.normal(i)).abs() < 0.03);
        assert!((mean(&|i| random.normal(i).powi(2)) - 1.0).abs() < 0.04);
        assert!(mean(&|i| random.direction(i).y).abs() < 0.02);
        assert!((mean(&|i| random.direction(i).y.powi(2)) - 1.0 / 3.0).abs() < 0.02);
    }

    #[test]
    fn purposes_of_a_seed_have_nothing_in_common() {
        let (a, b) = (Random::new(3, 1), Random::new(3, 2));
        let product: f64 = (0..10_000).map(|i| a.normal(i) * b.normal(i)).sum();
        assert!(product.abs() < 400.0, "{product}");
    }
}
