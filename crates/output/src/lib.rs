//! What leaves the program: pictures and animations, and files for other programs.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use rekindle_output::export::Renderer;
//! use rekindle_solution::Solution;
//!
//! let solution = Solution::load("solution".as_ref())?;
//! let renderer = Renderer::new(&solution);
//! let lit = renderer.light(renderer.original());
//! let picture = lit.picture(&solution.cameras[0].1);
//! # let _ = picture;
//! # Ok(())
//! # }
//! ```

pub mod export;
pub mod interchange;
pub mod web;
