//! Pictures and animations written to files, all of them made by the reference renderer.
//!
//! A picture is rendered, encoded and written in bands of rows, so that memory stays bounded at any size. Files appear
//! together when all of them are complete; a job that fails or is stopped leaves nothing.

mod exr_bands;
mod job;
mod layers;
mod motion;
mod photographer;
mod png_file;
mod renderer;
#[cfg(test)]
mod tests;

pub use job::{ExportError, Job, MAX_ANIMATION_SIDE, MAX_SIDE, Shot, export};
pub use motion::{lamp_circle, turntable, with_size};
pub use photographer::Photographer;
pub use png_file::{Depth, PngFile, Shown};
pub use renderer::{LitScene, Renderer};
