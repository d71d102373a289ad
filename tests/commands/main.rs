//! The program's commands, as users and other programs run them.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod bad_input;
mod command;
mod dialects;
mod manual;
mod photographs;
mod program;
mod truth;
