//! The lighting: radiances on the nodes of a geodesic hemisphere.

mod cluster;
mod grid;
mod partial;
mod picture;

pub use cluster::{Lamp, find_lamps, rest};
pub use grid::HemisphereGrid;
pub use partial::{InitialHemisphere, PartialHemisphere, SpecularImage};
pub use picture::{
    Exposure, FromAbove, Picture, direction_from_lat_long, from_above_axes, lat_long,
    lat_long_from_direction, srgb,
};
