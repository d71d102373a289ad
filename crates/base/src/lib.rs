//! What every room needs and no room owns: numerics without light or surfaces, files, text, memory, and results that appear whole or not at all.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use rekindle_base::staging::Staging;
//!
//! let staging = Staging::within("pictures".as_ref())?;
//! std::fs::write(staging.path().join("notes.txt"), "written by rekindle")?;
//! staging.add()?; // all of its files, or none; nobody else's is replaced
//! # Ok(())
//! # }
//! ```

pub mod damage;
pub mod files;
pub mod math;
pub mod memory;
pub mod staging;
pub mod text;
