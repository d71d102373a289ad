//! The document that the desktop application edits, and the mathematics of looking at it. No window and no graphics
//! device in here.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use glam::Vec3;
//! use rekindle_solution::Solution;
//! use rekindle_studio::Document;
//!
//! let solution = Solution::load("solution".as_ref())?;
//! let mut document = Document::new(solution.into(), Some("solution".into()));
//! let lamp = document.edit("Add a lamp", |state, base| state.add_lamp(base, Vec3::Y));
//! document.undo();
//! # let _ = lamp;
//! # Ok(())
//! # }
//! ```

mod document;
mod group;
mod lamp;
mod look;
mod pointing;
mod project;
mod ready;
mod recovery;

pub mod fixtures;
#[cfg(test)]
mod tests;

pub use document::{Document, State};
pub use group::{Group, GroupId};
pub use lamp::{
    ANGULAR_RADIUS, BaseLamp, Baseline, Colour, KELVIN, Lamp, LampId, MAX_STOPS, Origin, black_body,
};
pub use look::{LitLook, Look, Probe, ProbeLight};
pub use pointing::{HighlightShare, Place, highlight_shares, place};
pub use project::{EXTENSION, ProjectError, Saved, Snapshot, write_whole};
pub use ready::ReadySetup;
pub use recovery::{Recoverable, Recovery, state_folder};

/// Vectors in files, as lists of three numbers.
mod vector {
    use glam::Vec3;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(super) fn serialize<S: Serializer>(
        vector: &Vec3,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        vector.to_array().serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec3, D::Error> {
        <[f32; 3]>::deserialize(deserializer).map(Vec3::from)
    }
}
