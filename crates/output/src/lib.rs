//! What leaves the program: pictures and animations, and files for other programs.

pub mod export;
pub mod interchange;
