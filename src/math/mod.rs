//! Numerical building blocks that know nothing of light or surfaces.

pub mod centred;
pub mod exp;
pub mod nnls;
pub mod random;
pub mod rounding;
pub mod sparse;
pub mod vector;

/// Turn between neighbours on a golden spiral, π (3 − √5) radians: points so turned never line up.
pub const GOLDEN_ANGLE: f32 = 2.399_963_2;
