//! A Gram matrix that is summed up from blocks of rows.

use std::ops::Range;

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, MatMut, MatRef, Par};

use rekindle_base::math::vector;

/// A matrix entry below this share of the block's largest is taken as zero.
const NEGLIGIBLE: f32 = 1e-5;
/// So many columns between two that are not left out are not left out either: longer ranges cost less to move.
const BRIDGED: usize = 8;
/// Columns at the end that are never left out: what was measured.
const MEASURED: usize = 3;

/// Some of a block's columns, as ranges that ascend.
pub struct Columns {
    ranges: Vec<Range<usize>>,
    width: usize,
}

impl Columns {
    /// All of `width` columns.
    pub fn all(width: usize) -> Self {
        Self {
            ranges: std::iter::once(0..width).collect(),
            width,
        }
    }

    /// Those of a block of rows of `width` values that hold more than nothing, always with the last three.
    pub fn of(block: &[f32], width: usize) -> Self {
        let mut largest = vec![0.0_f32; width];
        for row in block.chunks_exact(width) {
            vector::keep_larger(&mut largest, row);
        }
        let cells = width - MEASURED;
        let threshold = NEGLIGIBLE * largest[..cells].iter().fold(0.0_f32, |m, &l| m.max(l));
        let mut ranges: Vec<Range<usize>> = Vec::new();
        for column in (0..width).filter(|&c| c >= cells || largest[c] > threshold) {
            match ranges.last_mut() {
                Some(last) if column <= last.end + BRIDGED => last.end = column + 1,
                _ => ranges.push(column..column + 1),
            }
        }
        Self { ranges, width }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.ranges.iter().map(Range::len).sum()
    }

    /// Appends the rows of a block with these columns only.
    pub fn pick(&self, block: &[f32], out: &mut Vec<f32>) {
        for row in block.chunks_exact(self.width) {
            for range in &self.ranges {
                out.extend_from_slice(&row[range.clone()]);
            }
        }
    }
}

/// The lower half of a symmetric matrix in the making.
pub struct Lower {
    /// Column by column, each from the diagonal down.
    values: Vec<f64>,
    n: usize,
    /// Room for a block's product.
    product: Vec<f32>,
}

impl Lower {
    /// How many values a matrix of n columns has.
    pub const fn size(n: usize) -> usize {
        n * (n + 1) / 2
    }

    /// A matrix of n columns, in memory for [`Lower::size`] values that holds zeros.
    pub const fn new(values: Vec<f64>, n: usize) -> Self {
        Self {
            values,
            n,
            product: Vec::new(),
        }
    }

    /// Its memory.
    pub fn into_values(self) -> Vec<f64> {
        self.values
    }

    /// A column from the diagonal down.
    pub fn column(&self, j: usize) -> &[f64] {
        &self.values[self.place(j)]
    }

    /// Where a column is: those before it have n, n − 1, … values.
    fn place(&self, j: usize) -> Range<usize> {
        let first = j * self.n - j * j.saturating_sub(1) / 2;
        first..first + self.n - j
    }

    /// Adds `blockᵀ block`; `block` holds rows of the values of `columns`. A block's products are summed in single precision,
    /// blocks in double.
    pub fn add_product(&mut self, block: &[f32], columns: &Columns) {
        let m = columns.count();
        // Row-major rows × m is column-major m × rows.
        let transposed = MatRef::from_column_major_slice(block, m, block.len() / m);
        self.product.resize(m * m, 0.0);
        matmul(
            MatMut::from_column_major_slice_mut(&mut self.product, m, m),
            BlockStructure::TriangularLower,
            Accum::Replace,
            transposed,
            BlockStructure::Rectangular,
            transposed.transpose(),
            BlockStructure::Rectangular,
            1.0_f32,
            Par::Seq,
        );
        let mut j = 0;
        for (k, range) in columns.ranges.iter().enumerate() {
            for column in range.clone() {
                let place = self.place(column);
                let sums = &mut self.values[place];
                let mut product = &self.product[j * m + j..(j + 1) * m];
                let below = std::iter::once(column..range.end);
                for rows in below.chain(columns.ranges[k + 1..].iter().cloned()) {
                    let (own, others) = product.split_at(rows.len());
                    vector::add(&mut sums[rows.start - column..], own);
                    product = others;
                }
                j += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_is_that_of_the_whole_block_but_for_what_is_negligible() {
        let (width, rows) = (40, 7);
        let lit = |c: usize| c < 3 || (17..20).contains(&c) || c >= width - MEASURED;
        let block: Vec<f32> = (0..rows * width)
            .map(|k| {
                let share = if lit(k % width) { 1.0 } else { 1e-7 };
                share * (1.0 + (k as f32 * 0.7).sin())
            })
            .collect();
        let columns = Columns::of(&block, width);
        assert_eq!(columns.ranges, [0..3, 17..20, 37..40]);
        let mut compact = Vec::new();
        columns.pick(&block, &mut compact);
        let mut gram = Lower::new(vec![0.0; Lower::size(width)], width);
        gram.add_product(&compact, &columns);
        for j in 0..width {
            for i in j..width {
                let exact: f64 = (0..rows)
                    .map(|r| f64::from(block[r * width + i]) * f64::from(block[r * width + j]))
                    .sum();
                let found = gram.column(j)[i - j];
                assert!((found - exact).abs() < 1e-5, "{i} {j}: {found} for {exact}");
            }
        }
    }
}
