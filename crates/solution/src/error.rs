//! What can be wrong with a solution.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use rekindle_base::staging::DestinationError;

/// Why a solution can't be read or written.
#[derive(Debug, Error)]
pub enum SolutionError {
    /// No solution there.
    #[error(
        "{path}: no solution here (there is no solution.json); give the folder that `rekindle solve -o` wrote"
    )]
    Missing {
        /// The folder.
        path: PathBuf,
    },
    /// A file can't be read.
    #[error("{path}: can't be read: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not JSON, or a field is missing or of the wrong type; the message has line and column.
    #[error("{path}: not a valid solution: {source}; solve the capture again")]
    Json {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// Something else's JSON.
    #[error(
        "{path}: the format is \"{found}\", expected \"rekindle-solution\"; give a folder that `rekindle solve -o` wrote"
    )]
    Format {
        /// The file.
        path: PathBuf,
        /// What it says.
        found: String,
    },
    /// Written by a newer program.
    #[error(
        "{path}: written by a newer rekindle (version {found}, this one reads up to {supported}); update rekindle or solve the capture again"
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
        /// Ours.
        supported: u32,
    },
    /// Contents that don't fit together.
    #[error("{path}: {what}; the solution is damaged, solve the capture again")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// A light is given for a capture whose light turns before the object.
    #[error(
        "{capture}: a given light is that of a place around the object, but this capture's lights stand still with the camera, as on a \
         turntable; leave the given light out, or say that they stand still with the object (light frame \"world\")"
    )]
    LightTurns {
        /// The capture's name.
        capture: String,
    },
    /// It can't be put where it is wanted.
    #[error(transparent)]
    Destination(#[from] DestinationError),
}
