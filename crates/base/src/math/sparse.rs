//! Sparse symmetric positive definite systems, solved by Cholesky factorisation.

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
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

/// In which order a matrix is factorised best: found once for all that have entries at the same places.
#[derive(Clone, Debug)]
pub struct Order {
    places: SymbolicSparseColMat<usize>,
    factors: SymbolicLlt<usize>,
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

    /// The order for an n × n matrix with entries at these places; `None` where one lies outside of it.
    pub fn order(&self, n: usize) -> Option<Order> {
        let (places, _) = self.matrix(n)?.into_parts();
        let factors = SymbolicLlt::try_new(places.as_ref(), Side::Lower).ok()?;
        Some(Order { places, factors })
    }

    /// [`LowerEntries::solve`] in an order that is known; one for entries at other places is of no use.
    pub fn solve_in(&self, order: &Order, rhs: &Mat<f64>) -> Option<Mat<f64>> {
        let matrix = self.matrix(rhs.nrows())?;
        let (own, known) = (matrix.symbolic(), order.places.as_ref());
        if own.col_ptr() != known.col_ptr() || own.row_idx() != known.row_idx() {
            return self.solve(rhs);
        }
        let factors = order.factors.clone();
        let factor = Llt::try_new_with_symbolic(factors, matrix.as_ref(), Side::Lower).ok()?;
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
        if self.columns.len() < other.columns.len() {
            self.columns.resize(other.columns.len(), Vec::new());
        }
        let columns = self.columns.iter_mut().zip(&other.columns);
        for (own, others) in columns.filter(|(_, others)| !others.is_empty()) {
            *own = merged(own, others);
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

/// Entries of one column or the other, rows ascending, those of one row added up.
fn merged(one: &[(usize, f64)], other: &[(usize, f64)]) -> Vec<(usize, f64)> {
    let mut all = Vec::with_capacity(one.len() + other.len());
    let (mut one, mut other) = (one.iter().peekable(), other.iter().peekable());
    while let (Some(&&(row, value)), Some(&&(next, further))) = (one.peek(), other.peek()) {
        let mut sum = 0.0;
        if row <= next {
            sum += value;
            one.next();
        }
        if next <= row {
            sum += further;
            other.next();
        }
        all.push((row.min(next), sum));
    }
    all.extend(one.chain(other));
    all
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
        let order = chain.clone().scaled(3.0).order(n).unwrap();
        assert_eq!(chain.solve_in(&order, &rhs).unwrap(), x);
        let mut longer = chain.clone();
        longer.add(n - 1, 0, 0.0);
        let other = longer.solve_in(&order, &rhs).unwrap();
        assert!((other - &x).norm_max() < 1e-12, "an order for other places");
        // A pull of 1 at the free end stretches the holding spring by 1/1.5 and each other by 1.
        for i in 0..n {
            assert!((x[(i, 0)] - (1.0 / 1.5 + i as f64)).abs() < 1e-12, "{i}");
        }
    }

    #[test]
    fn a_sum_of_matrices_has_the_entries_of_both() {
        let mut one = LowerEntries::default();
        let mut other = LowerEntries::default();
        for (row, column, value) in [(0, 0, 1.0), (3, 1, 2.0), (1, 1, 5.0)] {
            one.add(row, column, value);
        }
        for (row, column, value) in [(3, 1, 0.5), (2, 1, 4.0), (6, 5, 7.0)] {
            other.add(row, column, value);
        }
        one.extend(&other);
        let all: Vec<_> = one.iter().collect();
        let expected = [
            (0, 0, 1.0),
            (1, 1, 5.0),
            (2, 1, 4.0),
            (3, 1, 2.5),
            (6, 5, 7.0),
        ];
        assert_eq!(all, expected);
    }

    #[test]
    fn an_indefinite_matrix_has_no_solution() {
        let mut matrix = LowerEntries::default();
        matrix.add(0, 0, 1.0);
        matrix.add(1, 1, -1.0);
        assert!(matrix.solve(&Mat::zeros(2, 1)).is_none());
    }
}
