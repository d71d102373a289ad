//! Total variation of radiances over the edges of the hemisphere's grid (eq. 14–17).

use std::collections::BTreeMap;

use faer::Mat;

use super::cells::{Cell, Pyramid};

/// Radiance difference, in units of the observations' scale, below which |x| is rounded to a parabola.
const ROUNDING: f64 = 1e-2;

/// Σ over edges of √(d² + ε²), d the difference of the two ends; nodes that are no unknowns are dark.
pub struct TotalVariation {
    /// Index of one end, and of the other unless that is dark.
    edges: Vec<(usize, Option<usize>)>,
}

impl TotalVariation {
    /// Over all edges that touch one of the cells.
    pub fn new(pyramid: &Pyramid, cells: &[Cell]) -> Self {
        let index: BTreeMap<Cell, usize> = cells.iter().enumerate().map(|(i, &c)| (c, i)).collect();
        let mut edges = Vec::new();
        for (i, &cell) in cells.iter().enumerate() {
            for neighbour in pyramid.neighbours(cell) {
                let other = index.get(&neighbour).copied();
                if other.is_none_or(|o| o > i) {
                    edges.push((i, other));
                }
            }
        }
        Self { edges }
    }

    /// The sum itself, for one channel.
    pub fn value(&self, x: &[f64]) -> f64 {
        self.edges.iter().map(|&edge| rounded(x, edge)).sum()
    }

    /// Adds `factor` × D to a matrix, D such that D x is the gradient at x: lagged diffusivity, by which the term
    /// becomes ½ xᵀ D x (Vogel and Oman, "Iterative methods for total variation denoising", 1996).
    pub fn add_diffusion(&self, x: &[f64], factor: f64, matrix: &mut Mat<f64>) {
        for &(i, other) in &self.edges {
            let weight = factor / rounded(x, (i, other));
            matrix[(i, i)] += weight;
            if let Some(o) = other {
                matrix[(o, o)] += weight;
                matrix[(i, o)] -= weight;
                matrix[(o, i)] -= weight;
            }
        }
    }
}

/// √(d² + ε²) of an edge.
fn rounded(x: &[f64], (i, other): (usize, Option<usize>)) -> f64 {
    (x[i] - other.map_or(0.0, |o| x[o])).hypot(ROUNDING)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_diffusion_gives_the_gradient() {
        let tv = TotalVariation {
            edges: vec![(0, Some(1)), (1, Some(2)), (0, Some(2)), (2, None)],
        };
        let x = [0.5, 0.512, 0.1];
        let mut diffusion = Mat::<f64>::zeros(3, 3);
        tv.add_diffusion(&x, 1.0, &mut diffusion);
        for i in 0..3 {
            let gradient: f64 = (0..3).map(|j| diffusion[(i, j)] * x[j]).sum();
            let at = |step: f64| {
                let mut moved = x;
                moved[i] += step;
                tv.value(&moved)
            };
            let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!(
                (gradient - difference).abs() < 1e-6,
                "{gradient} {difference}"
            );
        }
    }
}
