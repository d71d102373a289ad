//! From photographs to light and roughness: whether the capture fits together, where mesh and cameras belong, and the estimate itself.

pub mod align;
pub mod estimate;
pub mod preflight;
pub mod registration;
