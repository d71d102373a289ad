//! Large matrices that are used again.
//!
//! Memory that is given back to the system and asked for anew costs more than many of the sums that it is for: every page is
//! a fault, and other threads are interrupted for it.

use std::sync::{Mutex, PoisonError};

/// Memory of matrices that are not needed at present.
#[derive(Debug, Default)]
pub struct Workspace {
    spare: Mutex<Vec<Vec<f64>>>,
}

impl Workspace {
    /// Without any memory yet.
    pub const fn new() -> Self {
        Self {
            spare: Mutex::new(Vec::new()),
        }
    }

    /// So many zeros.
    pub(super) fn zeros(&self, count: usize) -> Vec<f64> {
        let spare = self.with(Vec::pop);
        let mut values = spare.unwrap_or_default();
        values.clear();
        values.resize(count, 0.0);
        values
    }

    /// Takes back what [`Workspace::zeros`] gave.
    pub(super) fn take_back(&self, values: Vec<f64>) {
        self.with(|spare| spare.push(values));
    }

    fn with<T>(&self, use_spare: impl FnOnce(&mut Vec<Vec<f64>>) -> T) -> T {
        use_spare(&mut self.spare.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
