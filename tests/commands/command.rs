//! Runs the built program.

use std::process::{Command, Output};

/// What the program says to `arguments`, and its status.
pub fn rekindle(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rekindle"))
        .args(arguments)
        .output()
        .expect("the program starts")
}
