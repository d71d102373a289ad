//! The lighting: radiances on the nodes of a geodesic hemisphere.

mod grid;

pub use grid::HemisphereGrid;
