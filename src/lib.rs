//! rekindle relights a captured object.

pub mod align;
pub mod app;
pub mod bench;
pub mod capture;
pub mod cli;
#[cfg(test)]
mod damage;
pub mod estimate;
pub mod export;
pub mod files;
pub mod hemisphere;
pub mod interchange;
pub mod math;
pub mod memory;
pub mod preflight;
pub mod registration;
pub mod relight;
pub mod render;
pub mod solution;
pub mod studio;
pub mod study;
pub mod surface;
pub mod synth;
pub mod text;
pub mod worker;
