//! rekindle relights a captured object.

pub mod capture;
