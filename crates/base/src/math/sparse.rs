//! Sparse symmetric positive definite systems, solved by Cholesky factorisation.

use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, SymbolicSparseColMat};
use faer::{Mat, Side};

/// One sparse row: (column, value).
pub type SparseRow = Vec<(usize, f64)>;

/// Lower half of a symmetric matrix; values at the same row and column add up.
#[derive(Clone, Debug, Default)]
pub struct LowerEntries {
    /// Row and value of each column's entries, rows ascending.
    columns: Vec<Vec<(usize, f64)>>,
}

impl LowerEntries {
    /// Adds a value at a row and a column; above the diagonal it is left out.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        if row < column {
            return;
        }
        if self.columns.len() <= column {
            self.columns.resize(column + 1, Vec::new());
        }
        let entries = &mut self.columns[column];
        match entries.binary_search_by_key(&row, |&(row, _)| row) {
            Ok(at) => entries[at].1 += value,
            Err(at) => entries.insert(at, (row, value)),
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

    /// The n × n matrix; `None` where an entry lies outside of it.
    fn matrix(&self, n: usize) -> Option<SparseColMat<usize, f64>> {
        let outside = |(row, column, _)| row >= n || column >= n;
        if self.iter().any(outside) {
            return None;
        }
        let ends = self.columns.iter().scan(0, |end, entries| {
            *end += entries.len();
            Some(*end)
        });
        let mut starts: Vec<usize> = std::iter::once(0).chain(ends).collect();
        starts.resize(n + 1, starts[starts.len() - 1]);
        let (rows, values) = self.columns.iter().flatten().copied().unzip();
        let pattern = SymbolicSparseColMat::new_checked(n, n, starts, None, rows);
        Some(SparseColMat::new(pattern, values))
    }

    /// The solution for each column of `rhs`; `None` where the matrix isn't positive definite.
    pub fn solve(&self, rhs: &Mat<f64>) -> Option<Mat<f64>> {
        let factor = self.matrix(rhs.nrows())?.sp_cholesky(Side::Lower).ok()?;
        let x = factor.solve(rhs);
        x.is_all_finite().then_some(x)
    }

    /// The same times a factor.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        for (_, value) in self.columns.iter_mut().flatten() {
            *value *= factor;
        }
        self
    }

    /// Adds another matrix.
    pub fn extend(&mut self, other: &Self) {
        for (row, column, value) in other.iter() {
            self.add(row, column, value);
        }
    }

    /// Row, column and value of every entry.
    pub fn iter(&self) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        let columns = self.columns.iter().enumerate();
        columns.flat_map(|(column, entries)| {
            entries
                .iter()
                .map(move |&(row, value)| (row, column, value))
        })
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
        let chain = chain.scaled(0.5);
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
