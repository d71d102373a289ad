//! Where it was measured: which point of the surface each pixel shows, and a texture for any mesh.

mod bvh;
mod visible;

pub use bvh::{Hit, Occluder};
pub use visible::{NO_TRIANGLE, ViewSurface, barycentric_at, front_most};

#[cfg(test)]
pub(crate) mod fixtures;
