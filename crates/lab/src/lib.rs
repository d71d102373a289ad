//! The laboratory: captures with known truth, and how far and how fast the estimate is on them.

pub mod bench;
pub mod study;
pub mod synth;
