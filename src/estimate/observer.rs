//! How a running solve is watched and stopped.

use std::ops::ControlFlow;

use serde::{Deserialize, Serialize};

/// A solve was stopped by its observer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopped;

/// One step of the minimisation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Iteration {
    /// Counts from 1.
    pub iteration: u32,
    /// Seconds since the estimation began.
    pub elapsed_s: f64,
    /// The method's objective, in squared radiance units of the capture.
    pub objective: f64,
    /// Roughness σ in radians.
    pub sigma: f32,
    /// Weighted root mean square of measured − predicted, in the capture's radiance units.
    pub residual_rms: f32,
}

/// Watches a solve. Every call may stop it by `ControlFlow::Break`; calls come at least every 100 ms.
pub trait Observer {
    /// `fraction` of the estimation is done, in [0, 1]; `what` says in a few words what it is doing.
    fn progress(&mut self, what: &str, fraction: f32) -> ControlFlow<()>;

    /// An iteration ended. `hemisphere` computes the current radiances, RGB per node, if they are wanted.
    fn iteration(
        &mut self,
        iteration: &Iteration,
        hemisphere: &dyn Fn() -> Vec<[f32; 3]>,
    ) -> ControlFlow<()>;
}

/// An observer that lets the solve run and keeps nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl Observer for Unobserved {
    fn progress(&mut self, _: &str, _: f32) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn iteration(&mut self, _: &Iteration, _: &dyn Fn() -> Vec<[f32; 3]>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

/// `?`-friendly form of an observer's answer.
pub(crate) fn go_on(answer: ControlFlow<()>) -> Result<(), Stopped> {
    match answer {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Stopped),
    }
}
