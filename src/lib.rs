//! rekindle relights a captured object: the window and the commands. What they call is in the library crates under `crates/`.

pub mod app;
pub mod cli;
mod setups;
pub mod worker;
