//! What every room needs and no room owns: numerics without light or surfaces, files, text, memory, and results that appear whole or not at all.

pub mod damage;
pub mod files;
pub mod math;
pub mod memory;
pub mod staging;
pub mod text;
