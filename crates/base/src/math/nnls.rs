//! Non-negative least squares from normal equations.

use std::sync::atomic::{AtomicBool, Ordering};

use faer::linalg::solvers::Solve;
use faer::{Col, Mat, MatRef, Side};

/// Limits of [`solve`].
#[derive(Clone, Copy, Debug)]
pub struct NnlsParams<'a> {
    /// Variables that may enter or leave before giving up.
    pub max_exchanges: usize,
    /// A gradient counts as negative below this fraction of the largest right-hand side.
    pub tolerance: f64,
    /// Once this is set, the solve ends where it is.
    pub stop: Option<&'a AtomicBool>,
}

impl NnlsParams<'_> {
    fn stopped(&self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    }
}

impl Default for NnlsParams<'_> {
    fn default() -> Self {
        Self {
            max_exchanges: 2000,
            tolerance: 1e-9,
            stop: None,
        }
    }
}

/// Minimises `½ xᵀ G x − bᵀ x` over `x ≥ 0`, G symmetric and positive semidefinite, n × n; b and x hold n values.
///
/// Lawson and Hanson's active-set method on normal equations (Bro and de Jong, "A Fast Non-negativity-constrained
/// Least Squares Algorithm", 1997). `x` holds a feasible starting point, from which the objective only falls, and
/// receives the solution. Its cost goes with the number of non-zeros, not with n.
pub fn solve(gram: MatRef<'_, f64>, rhs: &[f64], x: &mut [f64], params: &NnlsParams<'_>) {
    let n = rhs.len();
    assert_eq!(gram.nrows(), n, "one row of the Gram matrix per unknown");
    assert_eq!(x.len(), n, "one start value per unknown");
    let scale = rhs.iter().fold(0.0_f64, |m, b| m.max(b.abs()));
    if scale <= 0.0 {
        x.fill(0.0);
        return;
    }
    let threshold = params.tolerance * scale;
    let mut passive: Vec<usize> = (0..n).filter(|&i| x[i] > 0.0).collect();
    let mut left = params.max_exchanges;
    // A variable that leaves as soon as it enters was let in by rounding, not by descent.
    let mut rejected = vec![false; n];
    let mut target = solve_passive(gram, rhs, &passive);
    loop {
        descend(gram, rhs, x, &mut passive, target, &mut left, params);
        let gradient = gradient(gram, rhs, &passive, x);
        let mut entering: Vec<usize> = (0..n)
            .filter(|&i| x[i] <= 0.0 && !rejected[i] && gradient[i] < -threshold)
            .collect();
        if entering.is_empty() || left == 0 || params.stopped() {
            return;
        }
        entering.sort_by(|&a, &b| gradient[a].total_cmp(&gradient[b]));
        let steepest = gradient[entering[0]];
        entering.retain(|&i| gradient[i] < 0.1 * steepest);
        entering.truncate(1 + passive.len() / 2);
        left -= 1;
        target = enter(gram, rhs, &mut passive, entering, &mut rejected);
    }
}

/// Makes those of `entering` passive that come out positive; where none does, the steepest is rejected. Returns the solution of
/// the passive unknowns' equations.
fn enter(
    gram: MatRef<'_, f64>,
    rhs: &[f64],
    passive: &mut Vec<usize>,
    mut entering: Vec<usize>,
    rejected: &mut [bool],
) -> Vec<f64> {
    let before = passive.len();
    let steepest = entering[0];
    while !entering.is_empty() {
        passive.truncate(before);
        passive.extend(&entering);
        let solution = solve_passive(gram, rhs, passive);
        let positive: Vec<usize> = entering
            .iter()
            .zip(&solution[before..])
            .filter(|(_, v)| **v > 0.0)
            .map(|(&i, _)| i)
            .collect();
        if positive.len() == entering.len() {
            return solution;
        }
        // Alone, the steepest always comes out positive unless rounding is all there is to it.
        entering = if positive.is_empty() && entering.len() > 1 {
            vec![steepest]
        } else {
            positive
        };
    }
    passive.truncate(before);
    rejected[steepest] = true;
    solve_passive(gram, rhs, passive)
}

/// Moves to the minimum over the passive variables, dropping those that reach zero on the way; many at once where that lowers
/// the objective, else one by one. `target` is the solution of their equations.
fn descend(
    gram: MatRef<'_, f64>,
    rhs: &[f64],
    x: &mut [f64],
    passive: &mut Vec<usize>,
    mut target: Vec<f64>,
    left: &mut usize,
    params: &NnlsParams<'_>,
) {
    loop {
        let leaves_bounds = target.iter().any(|&t| t <= 0.0);
        if leaves_bounds && leap(gram, rhs, x, passive, &target) {
            return;
        }
        let step = passive
            .iter()
            .zip(&target)
            .filter(|(_, t)| **t <= 0.0)
            .map(|(&i, &t)| x[i] / (x[i] - t).max(f64::MIN_POSITIVE))
            .fold(1.0_f64, f64::min);
        for (&i, &t) in passive.iter().zip(&target) {
            x[i] += step * (t - x[i]);
        }
        if step >= 1.0 {
            return;
        }
        let largest = passive.iter().fold(0.0_f64, |m, &i| m.max(x[i]));
        let before = passive.len();
        passive.retain(|&i| x[i] > 1e-14 * largest);
        if passive.len() == before || *left == 0 || params.stopped() {
            return;
        }
        *left -= 1;
        let kept: std::collections::BTreeSet<usize> = passive.iter().copied().collect();
        for (i, v) in x.iter_mut().enumerate() {
            if !kept.contains(&i) {
                *v = 0.0;
            }
        }
        target = solve_passive(gram, rhs, passive);
    }
}

/// Drops all passive variables whose `target` is not positive, and again until none is left, as block principal pivoting does
/// (Portugal, Júdice and Vicente 1994), and moves there if the objective is lower; else nothing changes and it is false.
fn leap(
    gram: MatRef<'_, f64>,
    rhs: &[f64],
    x: &mut [f64],
    passive: &mut Vec<usize>,
    target: &[f64],
) -> bool {
    let mut kept = passive.clone();
    let mut values = target.to_vec();
    while values.iter().any(|&v| v <= 0.0) {
        let mut positive = values.iter().map(|&v| v > 0.0);
        kept.retain(|_| positive.next() == Some(true));
        values = solve_passive(gram, rhs, &kept);
    }
    // At a minimum over some variables xᵀGx is bᵀx.
    let there = -0.5
        * kept
            .iter()
            .zip(&values)
            .map(|(&i, v)| rhs[i] * v)
            .sum::<f64>();
    let is_lower = there < objective(gram, rhs, passive, x);
    if !is_lower {
        return false;
    }
    for &i in passive.iter() {
        x[i] = 0.0;
    }
    for (&i, v) in kept.iter().zip(values) {
        x[i] = v;
    }
    *passive = kept;
    true
}

/// `½ xᵀ G x − bᵀ x` where x vanishes outside `passive`.
fn objective(gram: MatRef<'_, f64>, rhs: &[f64], passive: &[usize], x: &[f64]) -> f64 {
    passive
        .iter()
        .map(|&i| {
            let column = gram.col(i);
            let product: f64 = passive.iter().map(|&j| column[j] * x[j]).sum();
            x[i] * (0.5 * product - rhs[i])
        })
        .sum()
}

/// `G x − b` where x vanishes outside `passive`.
fn gradient(gram: MatRef<'_, f64>, rhs: &[f64], passive: &[usize], x: &[f64]) -> Vec<f64> {
    let mut gradient: Vec<f64> = rhs.iter().map(|b| -b).collect();
    for &j in passive {
        for (g, a) in gradient.iter_mut().zip(gram.col(j).iter()) {
            *g += a * x[j];
        }
    }
    gradient
}

/// Solution of the equations of the passive unknowns, in their order.
fn solve_passive(gram: MatRef<'_, f64>, rhs: &[f64], passive: &[usize]) -> Vec<f64> {
    let m = passive.len();
    if m == 0 {
        return Vec::new();
    }
    let b = Col::from_fn(m, |i| rhs[passive[i]]);
    let mean_diagonal = passive.iter().map(|&i| gram[(i, i)]).sum::<f64>() / m as f64;
    // Rounding can make a nearly singular block indefinite: a growing ridge mends that.
    let mut ridge = 0.0;
    for _ in 0..8 {
        let mut block = Mat::<f64>::zeros(m, m);
        for j in 0..m {
            let column = gram.col(passive[j]);
            for (value, &i) in block.col_as_slice_mut(j)[j..].iter_mut().zip(&passive[j..]) {
                *value = column[i];
            }
            block[(j, j)] += ridge;
        }
        if let Ok(factor) = block.llt(Side::Lower) {
            let solution = factor.solve(&b);
            return (0..m).map(|k| solution[k]).collect();
        }
        ridge = if ridge == 0.0 {
            1e-12 * mean_diagonal
        } else {
            ridge * 10.0
        };
    }
    vec![0.0; m]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reproducible sequence in [−1, 1].
    fn noise(i: usize) -> f64 {
        ((i as f64 * 12.9898).sin() * 43_758.545).fract() * 2.0 - 1.0
    }

    #[test]
    fn satisfies_the_optimality_conditions() {
        for size in [1, 7, 40] {
            let rows = 3 * size;
            let a = Mat::from_fn(rows, size, |i, j| noise(i * size + j));
            let y = Col::from_fn(rows, |i| noise(7919 + i));
            let gram = a.transpose() * &a;
            let b = a.transpose() * &y;
            let rhs: Vec<f64> = (0..size).map(|i| b[i]).collect();
            let mut x = vec![0.0; size];
            solve(gram.as_ref(), &rhs, &mut x, &NnlsParams::default());
            for i in 0..size {
                let g = (0..size).map(|j| gram[(i, j)] * x[j]).sum::<f64>() - rhs[i];
                assert!(x[i] >= 0.0, "x[{i}] = {}", x[i]);
                assert!(g > -1e-8, "gradient {g} at {i}");
                assert!((x[i] * g).abs() < 1e-8, "complementarity at {i}");
            }
        }
    }

    #[test]
    fn recovers_a_sparse_solution_of_an_ill_conditioned_blur() {
        let n = 60;
        let a = Mat::from_fn(200, n, |i, j| {
            let d = (i as f64 / 200.0 - j as f64 / n as f64) * 8.0;
            (-d * d).exp()
        });
        let truth: Vec<f64> = (0..n)
            .map(|j| match j {
                10 => 3.0,
                30 => 1.0,
                _ => 0.0,
            })
            .collect();
        let t = Col::from_fn(n, |j| truth[j]);
        let gram = a.transpose() * &a;
        let b = a.transpose() * &(&a * &t);
        let rhs: Vec<f64> = (0..n).map(|i| b[i]).collect();
        let mut x = vec![0.0; n];
        solve(gram.as_ref(), &rhs, &mut x, &NnlsParams::default());
        let near = |c: usize| x[c - 2..=c + 2].iter().sum::<f64>();
        assert!((near(10) - 3.0).abs() < 1e-3, "first spike {}", near(10));
        assert!((near(30) - 1.0).abs() < 1e-3, "second spike {}", near(30));
    }

    #[test]
    fn no_signal_gives_zero() {
        let gram = Mat::<f64>::identity(3, 3);
        let mut x = vec![1.0; 3];
        solve(gram.as_ref(), &[0.0; 3], &mut x, &NnlsParams::default());
        assert_eq!(x, [0.0; 3]);
    }
}
