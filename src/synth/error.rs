//! What can be wrong with a wish for a capture.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why a capture can't be made.
#[derive(Debug, Error)]
pub enum SynthError {
    /// The light probe can't be used; a whole sentence that names the file.
    #[error("{0}")]
    Probe(String),
    /// A lamp would stand in or at the object.
    #[error(
        "the lamps are {distance} from the object's centre, which would be inside it or at it; put them at {least:.2} or beyond"
    )]
    LampTooNear {
        /// As asked for, in mesh units.
        distance: f32,
        /// Least distance.
        least: f32,
    },
    /// The destination is something else's folder.
    #[error(
        "{path}: exists and is not a capture with known truth; choose another output folder or remove it"
    )]
    Occupied {
        /// The folder.
        path: PathBuf,
    },
    /// Writing failed.
    #[error(
        "{path}: can't be written: {source}; choose an output folder you may write to, on a disk with space left"
    )]
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
