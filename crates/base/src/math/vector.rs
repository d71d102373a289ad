//! Sums over rows of numbers, as vector code of the widest kind that the processor has.

/// Partial sums side by side: so many that additions don't wait for each other. Products of vectors of a multiple of this
/// length take no longer than they have to.
pub const LANES: usize = 32;

/// `Σ aᵢ bᵢ`, summed in an order that depends on the length alone.
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    pulp::Arch::new().dispatch(Dot { a, b })
}

struct Dot<'a> {
    a: &'a [f32],
    b: &'a [f32],
}

impl pulp::NullaryFnOnce for Dot<'_> {
    type Output = f32;

    #[inline(always)]
    fn call(self) -> f32 {
        let n = self.a.len().min(self.b.len());
        let (a, a_rest) = self.a[..n].as_chunks::<LANES>();
        let (b, b_rest) = self.b[..n].as_chunks::<LANES>();
        let mut sums = [0.0_f32; LANES];
        for (a, b) in a.iter().zip(b) {
            for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
                *sum += a * b;
            }
        }
        let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
        let sums: [f32; 16] = std::array::from_fn(|k| sums[k] + sums[k + 16]);
        let sums: [f32; 8] = std::array::from_fn(|k| sums[k] + sums[k + 8]);
        let sums: [f32; 4] = std::array::from_fn(|k| sums[k] + sums[k + 4]);
        (sums[0] + sums[2]) + (sums[1] + sums[3]) + rest
    }
}

/// `sums += factor × values`.
pub fn add_scaled(sums: &mut [f32], factor: f32, values: &[f32]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += factor * value;
            }
        },
    );
}

/// `sums += values`, in double precision.
pub fn add<T: Into<f64> + Copy>(sums: &mut [f64], values: &[T]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for (sum, &value) in sums.iter_mut().zip(values) {
                *sum += value.into();
            }
        },
    );
}

/// `values = own × values + other × others`.
pub fn combine(values: &mut [f32], own: f32, other: f32, others: &[f32]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for (value, o) in values.iter_mut().zip(others) {
                *value = own * *value + other * o;
            }
        },
    );
}

/// Each of `largest` becomes the larger of itself and its counterpart.
pub fn keep_larger(largest: &mut [f32], values: &[f32]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for (l, &v) in largest.iter_mut().zip(values) {
                *l = if v > *l { v } else { *l };
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dot_product_of_any_length_is_that_of_exact_sums() {
        for n in [0, 1, 31, 32, 33, 100] {
            let a: Vec<f32> = (0..n).map(|i| (i as f32 * 0.37).sin()).collect();
            let b: Vec<f32> = (0..n).map(|i| (i as f32 * 0.11).cos()).collect();
            let exact: f64 = a
                .iter()
                .zip(&b)
                .map(|(&a, &b)| f64::from(a) * f64::from(b))
                .sum();
            assert!((f64::from(dot(&a, &b)) - exact).abs() < 1e-5, "{n}");
        }
    }
}
