//! The object and its light for other programs: what a solve found, in their conventions, files and units.
//!
//! An [`Asset`] is the solution as they see it: +Y up, light and colours each on a scale of their own ([`Material`]). Each
//! further file writes it in one form; [`export`] writes a folder of them, says what none of them can carry over, and how
//! near they come.

mod asset;
mod blender;
mod fidelity;
mod gauge;
mod glb;
mod job;
mod light_list;
mod light_map;
mod mitsuba;
mod notes;
mod obj;
#[cfg(test)]
mod tests;
mod textures;
mod usd;

pub use asset::{Anchor, Asset, Source};
pub use fidelity::Fidelity;
pub use gauge::{Material, USUAL_F0, reflectance, refractive_index};
pub use job::{Exported, Form, Job, JobError, PAGE, export};
pub use light_map::{MapLayout, Orientation, Part};
