//! What can keep a study from being made.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use crate::bench::BenchError;
use crate::synth::SynthError;
use rekindle_capture::CaptureError;
use rekindle_solution::SolutionError;

/// Why a study can't be made.
#[derive(Debug, Error)]
pub enum StudyError {
    /// A section or group that there is none of.
    #[error(
        "there is no section or group {name} in the study; these are its sections and groups:\n{known}"
    )]
    Unknown {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// A capture can't be made.
    #[error(transparent)]
    Synth(#[from] SynthError),
    /// A capture can't be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A solution can't be read.
    #[error(transparent)]
    Solution(#[from] SolutionError),
    /// A solution can't be compared with the truth.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The program can't be started, or what it says not be read.
    #[error(
        "{path}: {source}; look for a program that can be started there, and for space on the disk"
    )]
    Child {
        /// The program or one of its files.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Stopped by whoever asked for it.
    #[error("stopped")]
    Stopped,
}
