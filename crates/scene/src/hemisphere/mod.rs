//! The lighting: radiances on the nodes of a geodesic hemisphere.

mod cluster;
mod grid;
mod lat_long;
mod partial;
mod picture;

pub use cluster::{Lamp, find_lamps, rest};
pub use grid::HemisphereGrid;
pub use lat_long::{
    SkyPiece, direction_from_lat_long, lat_long, lat_long_from_direction, lat_long_of,
};
pub use partial::{InitialHemisphere, PartialHemisphere, SpecularImage, SpecularPixel};
pub use picture::{Exposure, FromAbove, Picture, from_above_axes, srgb};
