//! The window: `rekindle`, `rekindle PATH` and `rekindle gui`.

use std::path::Path;

use anyhow::{anyhow, bail};

use super::{OutputArgs, demo, print_message, window_needs};
use crate::app;
use crate::worker::Source;

/// Commands that need no window.
const WITHOUT: &str = "rekindle solve, render, info and demo work without a window";

/// Opens the window, which a missing display or graphics adapter makes an error.
pub(super) fn run(path: Option<&Path>) -> anyhow::Result<()> {
    if !has_display() {
        bail!(
            "there is no display (neither WAYLAND_DISPLAY nor DISPLAY is set); set one, or use the command line: {WITHOUT}"
        );
    }
    let missing = window_needs::missing(has("WAYLAND_DISPLAY"));
    if !missing.is_empty() {
        bail!(
            "a window needs libraries that are not installed: {}; {}",
            missing.join(", "),
            remedy()
        );
    }
    let source = match path {
        Some(path) if !path.exists() => {
            bail!(
                "{}: there is no such file or folder; check the path",
                path.display()
            )
        }
        Some(path) => Some(Source::Path(path.to_owned())),
        None => None,
    };
    app::run(source).map_err(|error| {
        let why = error.to_string().replace('\n', " ");
        anyhow!("the window can't be opened: {why}; {}", remedy())
    })
}

/// What to do where there can't be a window.
fn remedy() -> String {
    let packages: Vec<&str> = window_needs::PACKAGES.lines().collect();
    format!(
        "install what it needs ({}), or use the command line: {WITHOUT}",
        packages.join("; ")
    )
}

/// Opens the window; without a path and where there can't be one, says so and runs the demo.
pub(super) fn run_or_demo(path: Option<&Path>, output: OutputArgs) -> anyhow::Result<()> {
    if path.is_none() && (output.json || output.quiet) {
        return demo::run(output);
    }
    match run(path) {
        Err(error) if path.is_none() => {
            print_message(&format!("rekindle: {error:#}. Running the demo."));
            demo::run(output)
        }
        result => result,
    }
}

/// Whether the environment names a display. Only Unix systems do.
fn has_display() -> bool {
    !cfg!(all(unix, not(target_os = "macos"))) || has("WAYLAND_DISPLAY") || has("DISPLAY")
}

/// Whether the environment says something of this name.
fn has(name: &str) -> bool {
    std::env::var_os(name).is_some_and(|value| !value.is_empty())
}
