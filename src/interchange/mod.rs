//! The object and its light for other programs: what a solve found, in their conventions, files and units.
//!
//! An [`Asset`] is the solution as they see it: +Y up, light and colours each on a scale of their own ([`Material`]). Each
//! further file writes it in one form; [`export`] writes a folder of them.
//!
//! What no file can carry over: programs that know only GGX lobes show longer tails than the estimated lobe has; the paper's
//! model has no Fresnel factor and no masking; ambient light is reflected by glossy surfaces too.

mod asset;
mod blender;
mod gauge;
mod glb;
mod job;
mod light_list;
mod light_map;
mod mitsuba;
mod obj;
#[cfg(test)]
mod tests;
mod textures;
mod usd;

pub use asset::{Anchor, Asset};
pub use gauge::{Material, USUAL_F0, reflectance};
pub use job::{Form, Job, JobError, export};
pub use light_map::{MapLayout, Orientation, Part};
