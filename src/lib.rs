//! rekindle relights a captured object.

pub mod capture;
pub mod estimate;
pub mod hemisphere;
pub mod math;
pub mod preflight;
pub mod surface;
