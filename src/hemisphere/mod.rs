//! The lighting: radiances on the nodes of a geodesic hemisphere.

mod grid;
mod partial;

pub use grid::HemisphereGrid;
pub use partial::{InitialHemisphere, PartialHemisphere, SpecularImage};
