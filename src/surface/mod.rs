//! Where it was measured: which point of the surface each pixel shows, and a texture for any mesh.

mod bvh;
mod visible;

pub use bvh::{Hit, Occluder};
pub use visible::{NO_TRIANGLE, ViewSurface};

#[cfg(test)]
pub(crate) mod fixtures;
