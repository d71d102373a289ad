//! Normal equations whose unknowns are known only up to what all of them have in common.

use faer::linalg::solvers::Llt;
use faer::{Mat, Side};

/// Factor of equations `gram` that, in place of what adding one number to all unknowns does, say that their sum is zero;
/// `None` where they leave more than that open.
pub fn factor(gram: &Mat<f64>) -> Option<Llt<f64>> {
    let n = gram.nrows();
    let mean = (0..n).map(|v| gram[(v, v)]).sum::<f64>() / n.max(1) as f64;
    let held = Mat::from_fn(n, n, |i, j| gram[(i, j)] + mean);
    held.llt(Side::Lower).ok()
}
