//! Runs the built program.

use std::process::{Command, Output};

/// What the program says to `arguments`, and its status.
pub fn rekindle(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rekindle"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

/// The same of arguments with which the program has to succeed.
pub fn succeed(arguments: &[&str]) -> Output {
    let run = rekindle(arguments);
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{said}");
    run
}
