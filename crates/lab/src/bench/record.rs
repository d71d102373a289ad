//! A solve with every iteration compared with the truth.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use super::Audience;
use super::error::BenchError;
use super::measures::{Errors, FoundLamp, Measures};
use super::truth::Truth;
use super::views::{self, ViewErrors};
use rekindle_base::memory;
use rekindle_capture::Capture;
use rekindle_estimate::estimate::{Interim, Iteration, Method, Observer};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_solution::{Skipped, SolveOptions, solve};

/// An iteration and its errors.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// What the estimation said; its `elapsed_s` counts from the start of the whole solve, reading included and the time
    /// spent on watching it not.
    pub iteration: Iteration,
    /// How far it was from the truth.
    pub errors: Errors,
}

/// A solve.
#[derive(Clone, Debug)]
pub struct Run {
    /// The capture's name.
    pub capture: String,
    /// The method.
    pub method: Method,
    /// Counts from 1.
    pub round: u32,
    /// Every iteration.
    pub steps: Vec<Step>,
    /// Roughness found, radians.
    pub sigma: Option<f32>,
    /// Lamps found.
    pub lamps: usize,
    /// Errors of what was found in the end.
    pub errors: Errors,
    /// Errors of its pictures.
    pub views: ViewErrors,
    /// Seconds of each stage, in order; the time spent on watching is taken out.
    pub stages: Vec<(String, f64)>,
    /// What was not done because the capture doesn't need it.
    pub skipped: Skipped,
    /// Bytes held at most, where the system tells.
    pub peak_bytes: Option<u64>,
}

impl Run {
    /// Seconds from the start of reading to the end of the solve.
    pub fn seconds(&self) -> f64 {
        self.stages.iter().map(|(_, seconds)| seconds).sum()
    }
}

/// An iteration as it comes.
struct Heard {
    iteration: Iteration,
    radiance: Vec<[f32; 3]>,
}

/// Keeps all that an estimation says.
struct Recorder<'a> {
    audience: &'a mut dyn Audience,
    started: Instant,
    load_s: f64,
    /// Time spent in here.
    watching: Duration,
    grid: Option<HemisphereGrid>,
    heard: Vec<Heard>,
}

impl Observer for Recorder<'_> {
    fn progress(&mut self, _: &str, _: f32) -> ControlFlow<()> {
        if self.audience.stop() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }

    fn iteration(
        &mut self,
        iteration: &Iteration,
        hemisphere: &dyn Fn() -> Vec<[f32; 3]>,
    ) -> ControlFlow<()> {
        let since = Instant::now();
        let elapsed = since
            .duration_since(self.started)
            .saturating_sub(self.watching);
        self.heard.push(Heard {
            iteration: Iteration {
                elapsed_s: self.load_s + elapsed.as_secs_f64(),
                ..*iteration
            },
            radiance: hemisphere(),
        });
        self.watching += since.elapsed();
        ControlFlow::Continue(())
    }

    fn interim(&mut self, interim: Interim<'_>) {
        if let Interim::Initial { grid, .. } = interim {
            self.grid = Some(grid.clone());
        }
    }
}

/// Solves a capture that took `load_s` seconds to read and compares it with its truth.
pub(super) fn record(
    (capture, load_s): (Capture, f64),
    truth: &Truth,
    options: &SolveOptions,
    round: u32,
    audience: &mut dyn Audience,
) -> Result<Run, BenchError> {
    let mut recorder = Recorder {
        audience,
        started: Instant::now(),
        load_s,
        watching: Duration::ZERO,
        grid: None,
        heard: Vec::new(),
    };
    let solution =
        solve(&capture, options, load_s, &mut recorder).map_err(|_| BenchError::Stopped)?;
    let peak_bytes = memory::peak();
    let Recorder {
        watching,
        grid,
        heard,
        audience,
        ..
    } = recorder;
    let measures = Measures::new(truth, solution.grid.up);
    let grid = grid.as_ref().unwrap_or(&solution.grid);
    let steps = heard
        .iter()
        .map(|heard| Step {
            iteration: heard.iteration,
            errors: measures.of_nodes(heard.iteration.sigma, grid, &heard.radiance),
        })
        .collect();
    let found: Vec<FoundLamp> = solution.lamps.iter().map(Into::into).collect();
    let sigma = solution.brdf.map(|brdf| brdf.sigma);
    let mut stages = solution.timings.clone();
    // Iterations are heard during the estimation.
    if let Some((_, seconds)) = stages.iter_mut().find(|(stage, _)| stage == "estimate") {
        *seconds = (*seconds - watching.as_secs_f64()).max(0.0);
    }
    Ok(Run {
        capture: capture.name,
        method: options.estimate.method,
        round,
        steps,
        sigma,
        lamps: found.len(),
        errors: measures.errors(sigma, &found, &solution.grid, &solution.radiance),
        views: views::compare(&solution, truth, audience)?,
        stages,
        skipped: solution.skipped,
        peak_bytes,
    })
}
