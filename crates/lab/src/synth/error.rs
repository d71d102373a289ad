//! What can be wrong with a wish for a capture.

use thiserror::Error;

use rekindle_base::staging::DestinationError;

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
    /// It can't be put where it is wanted.
    #[error(transparent)]
    Destination(#[from] DestinationError),
    /// Stopped by whoever asked for it.
    #[error("stopped")]
    Stopped,
}
