//! Numerical building blocks that know nothing of light or surfaces.

pub mod exp;
pub mod nnls;
