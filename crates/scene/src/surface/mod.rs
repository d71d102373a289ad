//! Where it was measured: which point of the surface each pixel shows, and a texture for any mesh.

mod atlas;
mod bundle;
mod bvh;
mod charts;
mod fairing;
mod gloss_texture;
mod parts;
mod simplify;
mod texture;
mod visible;

pub use atlas::{Atlas, LARGEST_SIDE, Texel};
pub use bvh::{Hit, Occluder, WalkNode};
pub use fairing::{Fairing, Smoothing, area_vectors};
pub use gloss_texture::GlossTexture;
pub use parts::{GlossParts, PartPoint, likeness};
pub use simplify::simplified;
pub use texture::{
    FULL_COVERAGE, GRAZING, MinimumTexture, Observation, Reading, is_object, minimum_texture,
    wanted_density,
};
pub use visible::{Barycentrics, NO_TRIANGLE, ViewSurface, front_most};

pub mod fixtures;
