//! What can keep methods from being compared.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use rekindle_base::staging::write_advice;
use rekindle_capture::CaptureError;
use rekindle_relight::EditError;

/// Why a comparison can't be made.
#[derive(Debug, Error)]
pub enum BenchError {
    /// The capture has no truth beside it.
    #[error(
        "{path}: no truth to compare with (there is no truth/truth.json); give captures with known truth, such as \
         `rekindle synth` makes"
    )]
    NoTruth {
        /// The capture.
        path: PathBuf,
    },
    /// The truth can't be understood.
    #[error("{path}: {what}; make the capture anew")]
    Truth {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// The capture has no other view to predict one from.
    #[error(
        "{path}: it has one view, which no other can predict; give captures of two views or more"
    )]
    OneView {
        /// The capture.
        path: PathBuf,
    },
    /// The capture, a camera or a true picture can't be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A light can't be made of what was found.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// Writing failed.
    #[error("{path}: can't be written: {source}; {}", write_advice(.source))]
    Write {
        /// The folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Stopped by whoever asked for it.
    #[error("stopped")]
    Stopped,
}
