//! What is photographed, as plain data and geometry: the surface with its atlas and ray caster, the hemisphere of lights, the reflectance models, and what may be left out of the work on them.
//!
//! ```no_run
//! use glam::Vec3;
//! use rekindle_scene::hemisphere::HemisphereGrid;
//!
//! let grid = HemisphereGrid::new(70, Vec3::Y, None, Vec3::ZERO);
//! let node = grid.nearest(Vec3::new(0.0, 0.6, 0.8));
//! assert!(node.is_some(), "above the horizon");
//! ```

pub mod hemisphere;
pub mod reflectance;
pub mod shortcuts;
pub mod surface;
