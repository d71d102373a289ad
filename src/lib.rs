//! rekindle relights a captured object.

pub mod capture;
pub mod hemisphere;
pub mod surface;
