//! Whether the system has what a window needs, found out before one is opened: the libraries are loaded at run time, and one
//! that is missing ends the program in the middle of it.

use std::process::Command;

/// Packages for the common distributions, a line each.
pub(super) const PACKAGES: &str = include_str!("../../assets/app/window_packages.txt");

/// Libraries of windows of X11.
const X11: [&str; 6] = [
    "libX11.so.6",
    "libX11-xcb.so.1",
    "libXcursor.so.1",
    "libXi.so.6",
    "libxkbcommon.so.0",
    "libxkbcommon-x11.so.0",
];
/// Libraries of windows of Wayland.
const WAYLAND: [&str; 2] = ["libwayland-client.so.0", "libxkbcommon.so.0"];
/// Of these, one will do.
const GRAPHICS: [&str; 2] = ["libvulkan.so.1", "libEGL.so.1"];

/// What is missing for a window, if anything is; nothing where the system does not tell which libraries it has.
pub(super) fn missing(wayland: bool) -> Vec<&'static str> {
    known_libraries().map_or_else(Vec::new, |known| missing_of(&known, wayland))
}

/// What is missing of the libraries that the loader's cache lists.
fn missing_of(known: &str, wayland: bool) -> Vec<&'static str> {
    let is_there = |library: &&str| {
        known
            .lines()
            .any(|line| line.trim_start().starts_with(*library))
    };
    let needed: &[&str] = if wayland { &WAYLAND } else { &X11 };
    let mut missing: Vec<&str> = needed.iter().copied().filter(|l| !is_there(l)).collect();
    if !GRAPHICS.iter().any(is_there) {
        missing.push(GRAPHICS[0]);
    }
    missing
}

/// The loader's cache, where there is one with more than nothing in it.
fn known_libraries() -> Option<String> {
    if !cfg!(target_os = "linux") || std::env::var_os("LD_LIBRARY_PATH").is_some() {
        return None;
    }
    let mut programs = ["ldconfig", "/sbin/ldconfig"].into_iter();
    let output = programs.find_map(|program| Command::new(program).arg("-p").output().ok())?;
    let known = String::from_utf8_lossy(&output.stdout).into_owned();
    known.contains("libc.so").then_some(known)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cache(libraries: &[&str]) -> String {
        let line = |library: &&str| format!("\t{library} (libc6,x86-64) => /lib/{library}\n");
        libraries.iter().map(line).collect()
    }

    #[test]
    fn what_a_window_lacks_is_named() {
        let all = cache(&[&X11[..], &WAYLAND, &GRAPHICS[..1]].concat());
        assert!(missing_of(&all, false).is_empty() && missing_of(&all, true).is_empty());
        let lacks = |line: &&str| !line.contains("xkbcommon-x11") && !line.contains("vulkan");
        let without: Vec<&str> = all.lines().filter(lacks).collect();
        let without = without.join("\n");
        assert_eq!(
            missing_of(&without, false),
            ["libxkbcommon-x11.so.0", "libvulkan.so.1"]
        );
        assert_eq!(missing_of(&without, true), ["libvulkan.so.1"]);
        let with_gl = without + "\n" + &cache(&["libEGL.so.1"]);
        assert!(missing_of(&with_gl, true).is_empty());
    }

    #[test]
    fn packages_are_named_for_every_distribution() {
        for name in ["Debian", "Fedora", "Arch", "openSUSE"] {
            assert!(
                PACKAGES.lines().any(|line| line.starts_with(name)),
                "{name}"
            );
        }
    }
}
