//! Sparse symmetric positive definite systems, solved by Cholesky factorisation.

use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};

/// One sparse row: (column, value).
pub type SparseRow = Vec<(usize, f64)>;

/// Lower half of a symmetric matrix; values at the same row and column add up.
#[derive(Clone, Debug, Default)]
pub struct LowerEntries(Vec<Triplet<usize, usize, f64>>);

impl LowerEntries {
    /// Adds a value at a row and a column; above the diagonal it is left out.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        if row >= column {
            self.0.push(Triplet::new(row, column, value));
        }
    }

    /// Adds `weight` times the square of a row.
    pub fn add_square(&mut self, row: &[(usize, f64)], weight: f64) {
        for &(i, a) in row {
            for &(j, b) in row {
                self.add(i, j, weight * a * b);
            }
        }
    }

    fn matrix(&self, n: usize) -> Option<SparseColMat<usize, f64>> {
        SparseColMat::try_new_from_triplets(n, n, &self.0).ok()
    }

    /// The solution for each column of `rhs`; `None` where the matrix isn't positive definite.
    pub fn solve(&self, rhs: &Mat<f64>) -> Option<Mat<f64>> {
        let factor = self.matrix(rhs.nrows())?.sp_cholesky(Side::Lower).ok()?;
        let x = factor.solve(rhs);
        x.is_all_finite().then_some(x)
    }

    /// The n × n matrix with one value per row and column; `None` where an entry lies outside of it.
    pub fn summed(&self, n: usize) -> Option<Self> {
        let matrix = self.matrix(n)?;
        let entries = matrix.triplet_iter();
        let owned = entries.map(|t| Triplet::new(t.row, t.col, *t.val));
        Some(Self(owned.collect()))
    }

    /// The same times a factor.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self(
            self.iter()
                .map(|(row, column, value)| Triplet::new(row, column, value * factor))
                .collect(),
        )
    }

    /// Adds another matrix.
    pub fn extend(&mut self, other: &Self) {
        self.0.extend_from_slice(&other.0);
    }

    /// Row, column and value of every entry.
    pub fn iter(&self) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        self.0.iter().map(|t| (t.row, t.col, t.val))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_solution_solves() {
        // A chain of springs with one end held: squares of differences, and of the first value.
        let n = 7;
        let mut chain = LowerEntries::default();
        chain.add_square(&[(0, 1.0)], 3.0);
        for i in 1..n {
            chain.add_square(&[(i - 1, -1.0), (i, 1.0)], 2.0);
        }
        let chain = chain.summed(n).unwrap().scaled(0.5);
        let rhs = Mat::from_fn(n, 1, |i, _| if i == n - 1 { 1.0 } else { 0.0 });
        let x = chain.solve(&rhs).unwrap();
        // A pull of 1 at the free end stretches the holding spring by 1/1.5 and each other by 1.
        for i in 0..n {
            assert!((x[(i, 0)] - (1.0 / 1.5 + i as f64)).abs() < 1e-12, "{i}");
        }
    }

    #[test]
    fn an_indefinite_matrix_has_no_solution() {
        let mut matrix = LowerEntries::default();
        matrix.add(0, 0, 1.0);
        matrix.add(1, 1, -1.0);
        assert!(matrix.solve(&Mat::zeros(2, 1)).is_none());
    }
}
