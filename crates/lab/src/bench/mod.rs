//! How near do methods come to the truth, and how fast?
//!
//! [`run`] solves captures with known truth by several methods, in turn, and [`Report`] writes what came of it: a row for
//! every iteration, a row for every solve, tables and plots. The measures are those of `evaluate.py`, which comes with the
//! path-traced captures. Nothing but this room reads `truth/`.
//! [`leave_one_out`] needs none: it predicts each photograph from the others.

mod chart;
mod error;
mod leave_one_out;
mod measures;
mod plot;
mod record;
mod report;
mod table;
mod truth;
mod views;

pub(crate) use chart::number;
pub use chart::{Axis, Curve, Dot, Panel, draw};
pub use error::BenchError;
pub use leave_one_out::{Predicted, PredictionError, leave_one_out, table};
pub use measures::{Errors, FoundLamp, Measures, hemisphere_error};
pub use record::{Run, Step};
pub use report::Report;
pub(crate) use table::{cell, field, mebibytes, percent, with_unit};
pub use truth::{RelitCase, TrueLamp, Truth};
pub use views::ViewErrors;

use std::path::PathBuf;

use rekindle_capture::Capture;
use rekindle_estimate::estimate::{EstimateParams, Method};
use rekindle_solution::SolveOptions;

/// What is to be compared.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Folders of captures with known truth.
    pub captures: Vec<PathBuf>,
    /// At least one; ratios are to the first.
    pub methods: Vec<Method>,
    /// How often each is run; the methods take turns.
    pub rounds: u32,
    /// Frequency of the geodesic hemisphere.
    pub frequency: u32,
}

/// Asks and tells whoever wants a comparison.
pub trait Audience: Send {
    /// Which capture and method is worked on, and which part of the whole is done.
    fn stage(&mut self, what: &str, fraction: f32);
    /// Whether to break off.
    fn stop(&self) -> bool;
}

/// Runs a comparison.
pub fn run(plan: &Plan, audience: &mut dyn Audience) -> Result<Report, BenchError> {
    // A capture that can't be judged is found before anything is solved.
    let truths = plan
        .captures
        .iter()
        .map(|folder| Truth::load(folder))
        .collect::<Result<Vec<Truth>, BenchError>>()?;
    let all = plan.captures.len() * plan.methods.len() * plan.rounds as usize;
    let mut runs: Vec<Run> = Vec::with_capacity(all);
    let mut names: Vec<String> = Vec::new();
    for (folder, truth) in plan.captures.iter().zip(&truths) {
        let mut own: Option<String> = None;
        for round in 1..=plan.rounds {
            for &method in &plan.methods {
                let (mut capture, load_s) = load(folder)?;
                let own = own.get_or_insert_with(|| unlike(&capture.name, &names));
                capture.name.clone_from(own);
                let what = format!("{own}: {}", name(method));
                audience.stage(&what, runs.len() as f32 / all as f32);
                let options = SolveOptions {
                    estimate: EstimateParams {
                        method,
                        ..EstimateParams::default()
                    },
                    frequency: plan.frequency,
                    radius: None,
                    light_frame: None,
                };
                let run = record::record((capture, load_s), truth, &options, round, audience)?;
                runs.push(run);
            }
        }
        names.extend(own);
    }
    Ok(Report { runs })
}

/// The name, with a number if another capture has it already.
fn unlike(name: &str, taken: &[String]) -> String {
    let numbered = (2..).map(|k| format!("{name}-{k}"));
    std::iter::once(name.to_owned())
        .chain(numbered)
        .find(|candidate| !taken.contains(candidate))
        .unwrap_or_default()
}

/// What a method is called in files.
pub(crate) fn name(method: Method) -> &'static str {
    match method {
        Method::Fast => "fast",
        Method::Amuh => "amuh",
        Method::Amhu => "amhu",
        Method::Plain => "plain",
    }
}

/// A capture and how many seconds it took to read.
fn load(folder: &std::path::Path) -> Result<(Capture, f64), BenchError> {
    rekindle_base::memory::forget_peak();
    let started = std::time::Instant::now();
    let capture = Capture::load(folder)?;
    Ok((capture, started.elapsed().as_secs_f64()))
}
