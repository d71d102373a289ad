//! Drives the window without a screen by the names that a screen reader reads.

#![allow(dead_code, reason = "each file of tests uses its part of the driver")]

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui;
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable as _;
use rekindle::app::{App, Start};
use rekindle::worker::Source;

/// Longer than anything here takes on a slow machine.
const PATIENCE: Duration = Duration::from_mins(4);

/// The window under test.
pub type Window = Harness<'static, App>;

pub fn window(open: Option<Source>) -> Window {
    Harness::builder()
        .with_size(egui::vec2(1280.0, 800.0))
        .build_eframe(|cc| {
            let start = Start {
                open,
                recovery: None,
            };
            App::new(cc, start).expect("threads")
        })
}

pub fn capture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/captures")
        .join(name)
}

/// Draws until `there` holds.
pub fn wait(window: &mut Window, what: &str, there: impl Fn(&Window) -> bool) {
    let since = Instant::now();
    while !there(window) {
        assert!(since.elapsed() < PATIENCE, "no {what}");
        std::thread::sleep(Duration::from_millis(5));
        window.step();
    }
}

pub fn wait_for(window: &mut Window, label: &str) {
    wait(window, label, |w| has(w, label));
}

pub fn wait_for_part(window: &mut Window, part: &str) {
    wait(window, part, |w| {
        w.query_all_by_label_contains(part).next().is_some()
    });
}

pub fn has(window: &Window, label: &str) -> bool {
    window.query_all_by_label(label).next().is_some()
}

pub fn has_part(window: &Window, part: &str) -> bool {
    window.query_all_by_label_contains(part).next().is_some()
}

pub fn click(window: &mut Window, label: &str) {
    window.get_by_label(label).click();
    window.step();
    window.step();
}

pub fn coarse(window: &mut Window) {
    window.get_by_label("Frequency").set_value_accesskit(24.0);
    window.step();
    window.step();
}

/// Drops a file or folder on the window.
pub fn drop_on(window: &mut Window, path: &Path) {
    struct Dropped(PathBuf);
    impl fmt::Debug for Dropped {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "{}", self.0.display())
        }
    }
    impl egui::DroppedFile for Dropped {
        fn path(&self) -> &Path {
            &self.0
        }
        fn bytes(&self) -> Result<Vec<u8>, String> {
            std::fs::read(&self.0).map_err(|error| error.to_string())
        }
    }
    window
        .input_mut()
        .dropped_files
        .push(Arc::new(Dropped(path.to_owned())));
    window.step();
}
