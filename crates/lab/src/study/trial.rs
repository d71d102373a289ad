//! A capture made, solved and compared with its truth.

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use glam::DVec3;
use rayon::ThreadPool;
use rayon::prelude::*;
use serde_json::Value;

use super::child::{End, run};
use super::error::StudyError;
use super::outcome::{Cost, Found, Outcome, STAGES};
use crate::bench::{FoundLamp, Measures, Truth};
use crate::synth::{Recipe, SynthError, make};
use rekindle_base::math::median;
use rekindle_capture::{read_cameras, read_covered};
use rekindle_estimate::estimate::OFF_NORMALS;
use rekindle_solution::Solution;

/// The program's option for its number of threads.
pub(super) const THREADS: &str = "--threads";

/// Where and how cases are tried.
pub(super) struct Workshop<'a> {
    /// The program that solves.
    pub program: &'a Path,
    /// A folder for captures and solutions, which are removed one after the other.
    pub folder: &'a Path,
    /// How often each is solved; seconds and bytes are medians.
    pub rounds: u32,
    /// Whether it is told how long reading the photographs alone takes.
    pub with_floor: bool,
    /// Threads of each solve, unless it is told another number; all cores where nothing is said.
    pub threads: Option<u16>,
    /// Threads that make captures, which nobody times.
    pub makers: ThreadPool,
    /// Set once nothing more is wanted.
    pub stop: &'a AtomicBool,
}

impl Workshop<'_> {
    /// Makes the capture of a recipe, in a folder of this name, and solves it with each of some lists of options.
    pub(super) fn try_all(
        &self,
        name: &str,
        recipe: &Recipe,
        options: &[&[String]],
    ) -> Result<Vec<Outcome>, StudyError> {
        let own = self.folder.join(name);
        let capture = own.join("capture");
        let mut go_on = |_: &str, _: f32| {
            if self.stop.load(Ordering::Relaxed) {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        };
        let made = self.makers.install(|| make(recipe, &capture, &mut go_on));
        match made {
            Err(SynthError::Stopped) => return Err(StudyError::Stopped),
            other => other?,
        }
        let outcomes = options
            .iter()
            .map(|options| self.rounds(&capture, options))
            .collect();
        // What is left over goes with the folder that all are in.
        let _ = fs::remove_dir_all(&own);
        outcomes
    }

    /// Solves a capture as often as it is to be, and takes the medians of what it cost.
    fn rounds(&self, capture: &Path, options: &[String]) -> Result<Outcome, StudyError> {
        let mut costs = Vec::new();
        loop {
            let outcome = self.solve(capture, options)?;
            let Outcome::Solved(mut found) = outcome else {
                return Ok(outcome);
            };
            if self.with_floor {
                found.cost.floor = Some(floor(capture)?);
            }
            costs.push(found.cost.clone());
            if costs.len() == self.rounds as usize {
                found.cost = medians(&costs);
                return Ok(Outcome::Solved(found));
            }
        }
    }

    fn solve(&self, capture: &Path, options: &[String]) -> Result<Outcome, StudyError> {
        let solution = capture.with_file_name("solution");
        let own = capture.parent().unwrap_or(self.folder);
        let mut arguments: Vec<String> =
            ["solve", "--json", "--quiet", "--do-all", "unchanged", "-o"]
                .map(str::to_owned)
                .to_vec();
        arguments.push(solution.to_string_lossy().into_owned());
        arguments.push(capture.to_string_lossy().into_owned());
        arguments.extend_from_slice(options);
        if let Some(threads) = self.threads
            && !options.iter().any(|option| option == THREADS)
        {
            arguments.extend([THREADS.to_owned(), threads.to_string()]);
        }
        let end =
            run(self.program, &arguments, own, self.stop).map_err(|source| StudyError::Child {
                path: self.program.to_owned(),
                source,
            })?;
        let (status, stdout, stderr) = match end {
            End::Itself {
                status,
                stdout,
                stderr,
            } => (status, stdout, stderr),
            End::TooLong => return Ok(Outcome::Failed("It did not end.".to_owned())),
            End::Stopped => return Err(StudyError::Stopped),
        };
        if !status.success() {
            // Files are named as in the capture, wherever that was made.
            let folder = format!("{}/", capture.display());
            let said = stderr.trim().trim_start_matches("rekindle: ");
            let said = said.replace(&folder, "");
            return Ok(if status.code() == Some(2) {
                Outcome::Refused(said)
            } else {
                Outcome::Failed(format!("{status}: {said}"))
            });
        }
        let summary: Value = serde_json::from_str(&stdout).map_err(|error| StudyError::Child {
            path: own.join("stdout"),
            source: error.into(),
        })?;
        judge(capture, &solution, &summary)
    }
}

/// Compares a solution with the truth; `summary` is what the program said of it.
fn judge(capture: &Path, solution: &Path, summary: &Value) -> Result<Outcome, StudyError> {
    let solution = Solution::load(solution)?;
    let warnings = &solution.diagnostics.warnings;
    let blames_mesh = warnings.iter().any(|said| said.starts_with(OFF_NORMALS));
    let last = warnings.last().cloned();
    let last = last.unwrap_or_else(|| "It gives no reason.".to_owned());
    let Some(brdf) = solution.brdf else {
        return Ok(Outcome::Refused(last));
    };
    let truth = Truth::load(capture)?;
    let measures = Measures::new(&truth, solution.grid.up);
    let lamps: Vec<FoundLamp> = solution.lamps.iter().map(Into::into).collect();
    let errors = measures.errors(Some(brdf.sigma), &lamps, &solution.grid, &solution.radiance);
    let relative = |sigma: f32| truth.sigma.map(|t| f64::from(sigma) / f64::from(t) - 1.0);
    let interval = solution
        .sigma_interval95
        .and_then(|[low, high]| Some([relative(low)?, relative(high)?]));
    let fits = &solution.fit.psnr_db_per_view;
    let fit_db = fits.iter().copied().map(f64::from).sum::<f64>() / fits.len().max(1) as f64;
    Ok(Outcome::Solved(Box::new(Found {
        sigma: brdf.sigma.into(),
        interval,
        errors,
        lamps: [lamps.len(), truth.lamps.len()],
        fit_db,
        doubt: (!solution.diagnostics.well_posed).then_some(last),
        blames_mesh,
        cost: cost(summary),
    })))
}

fn cost(summary: &Value) -> Cost {
    let seconds = |stage: &str| summary["timings_s"][stage].as_f64();
    Cost {
        stages: STAGES.iter().map(|stage| seconds(stage)).collect(),
        total: seconds("total").unwrap_or(f64::NAN),
        peak_bytes: summary["peak_bytes"].as_f64(),
        floor: None,
    }
}

fn medians(costs: &[Cost]) -> Cost {
    let of = |value: &dyn Fn(&Cost) -> Option<f64>| {
        median(&mut costs.iter().filter_map(value).collect::<Vec<f64>>())
    };
    Cost {
        stages: (0..STAGES.len())
            .map(|k| of(&|cost| cost.stages[k]))
            .collect(),
        total: of(&|cost| Some(cost.total)).unwrap_or(f64::NAN),
        peak_bytes: of(&|cost| cost.peak_bytes),
        floor: of(&|cost| cost.floor),
    }
}

/// Seconds that reading and decoding all photographs and adding up their pixels takes: no solve can be faster.
fn floor(capture: &Path) -> Result<f64, StudyError> {
    let cameras = read_cameras(&capture.join("transforms.json"), DVec3::ZERO)?;
    let paths: Vec<PathBuf> = cameras.iter().map(|(name, _)| capture.join(name)).collect();
    let started = Instant::now();
    let sums = paths
        .par_iter()
        .map(|path| {
            let picture = read_covered(path)?;
            Ok(picture
                .radiance
                .iter()
                .flatten()
                .map(|&v| f64::from(v))
                .sum())
        })
        .collect::<Result<Vec<f64>, StudyError>>()?;
    // The sums are asked for, so that they are made.
    std::hint::black_box(sums);
    Ok(started.elapsed().as_secs_f64())
}
