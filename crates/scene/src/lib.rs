//! What is photographed, as plain data and geometry: the surface with its atlas and ray caster, the hemisphere of lights, the reflectance models, and what may be left out of the work on them.

pub mod hemisphere;
pub mod reflectance;
pub mod shortcuts;
pub mod surface;
