//! The laboratory: captures with known truth, and how far and how fast the estimate is on them.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use std::ops::ControlFlow;
//! use rekindle_lab::synth::{Mistake, Recipe, make};
//!
//! let recipe = Recipe { mistake: Some(Mistake::Encoded), ..Recipe::default() };
//! make(&recipe, "capture".as_ref(), &mut |_, _| ControlFlow::Continue(()))?;
//! # Ok(())
//! # }
//! ```

pub mod bench;
pub mod study;
pub mod synth;
