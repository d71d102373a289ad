//! Drives the window without a screen by the names that a screen reader reads.

#![allow(dead_code, reason = "each file of tests uses its part of the driver")]

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui;
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use glam::DVec3;
use rekindle::app::{App, Start};
use rekindle::worker::Source;
use rekindle_capture::{Capture, View, unpack_demo};

/// Longer than anything here takes on a slow machine.
const PATIENCE: Duration = Duration::from_mins(4);

/// A picture that has not changed for so long stands still.
const STILL: Duration = Duration::from_millis(1500);

/// Where on the picture of the mesh points are set, in parts of it.
pub const ON_MESH: [[f32; 2]; 3] = [[0.5, 0.5], [0.35, 0.52], [0.62, 0.42]];

/// The window under test.
pub type Window = Harness<'static, App>;

pub fn window(open: Option<Source>) -> Window {
    window_of([1280.0, 800.0], open)
}

/// A window of a size in points.
pub fn window_of(size: [f32; 2], open: Option<Source>) -> Window {
    Harness::builder()
        .with_size(egui::vec2(size[0], size[1]))
        .build_eframe(|cc| {
            let start = Start {
                open,
                recovery: None,
            };
            App::new(cc, start).expect("threads")
        })
}

/// A window drawn by whatever graphics adapter there is; without one the test fails.
pub fn drawn(size: [f32; 2], open: Option<Source>) -> Window {
    Harness::builder()
        .with_size(egui::vec2(size[0], size[1]))
        .with_render_cursor(false)
        .wgpu()
        .build_eframe(|cc| {
            let start = Start {
                open,
                recovery: None,
            };
            App::new(cc, start).expect("threads")
        })
}

/// The window's picture once it stands still: nothing is baked or refined any more.
pub fn finished(window: &mut Window) -> image::RgbaImage {
    for _ in 0..3 {
        window.step();
    }
    wait(window, "final picture", |w| !has(w, "Refining…"));
    still(window)
}

/// The window's picture once it stands still, baked or not: what is dragged is not.
pub fn still(window: &mut Window) -> image::RgbaImage {
    let begun = Instant::now();
    let mut since = Instant::now();
    let mut before = window.render().expect("a picture");
    while since.elapsed() < STILL {
        assert!(begun.elapsed() < PATIENCE, "the picture never stands still");
        std::thread::sleep(Duration::from_millis(20));
        window.step();
        let now = window.render().expect("a picture");
        if now != before {
            before = now;
            since = Instant::now();
        }
    }
    before
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

/// Waits until an iteration at least this far is shown.
pub fn wait_for_iteration(window: &mut Window, at_least: u32) {
    wait(window, "iteration", |w| shows_iteration(w, at_least));
}

/// Whether an iteration at least this far is shown.
pub fn shows_iteration(window: &Window, at_least: u32) -> bool {
    let shown = window.query_all_by_label_contains("Iteration ");
    let number = |node: egui_kittest::Node<'_>| {
        let label = node.accesskit_node().label()?;
        let (number, _) = label.strip_prefix("Iteration ")?.split_once(',')?;
        number.parse::<u32>().ok()
    };
    shown.filter_map(number).any(|n| n >= at_least)
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
    window
        .get_by_role_and_label(egui::Role::SpinButton, "Light resolution")
        .set_value_accesskit(24.0);
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

/// Writes the demo's capture into a folder, with its mesh elsewhere: turned, a hundred times as large, far off.
pub fn misplace(folder: &Path) {
    unpack_demo(folder).expect("written");
    let path = folder.join("transforms.json");
    let manifest = std::fs::read(&path).expect("a manifest");
    let mut manifest: serde_json::Value = serde_json::from_slice(&manifest).expect("JSON");
    manifest["mesh_transform"] = serde_json::json!([
        [0, 0, 100, 900],
        [0, 100, 0, 40],
        [-100, 0, 0, 0],
        [0, 0, 0, 1]
    ]);
    std::fs::write(path, manifest.to_string()).expect("written");
}

/// Where [`misplace`] puts a point of the mesh, undone.
pub fn placed([x, y, z]: [f64; 3]) -> DVec3 {
    DVec3::new(-z / 100.0, (y - 40.0) / 100.0, (x - 900.0) / 100.0)
}

/// Clicks at a part of what has this name.
pub fn click_at(window: &mut Window, label: &str, part: egui::Vec2) {
    let rect = window.get_by_label(label).rect();
    let at = rect.min + part * rect.size();
    window.hover_at(at);
    window.step();
    window.drag_at(at);
    window.step();
    window.drop_at(at);
    window.step();
    window.step();
}

/// Where a point that was set on the mesh is, as its row says.
pub fn point_on_mesh(window: &Window, point: usize) -> [f64; 3] {
    let part = format!("Point {point} at ");
    let row = window.get_by_label_contains(&part);
    let label = row.accesskit_node().label().expect("a name");
    let numbers = label[part.len()..]
        .split(' ')
        .map(|v| v.parse().expect("a number"));
    numbers.collect::<Vec<f64>>().try_into().expect("three")
}

/// Marks the selected point, which is at `place` on a mesh that [`misplace`] put elsewhere, where photograph `view` shows it.
pub fn mark(window: &mut Window, capture: &Capture, view: usize, place: [f64; 3]) {
    click(window, &format!("Show photograph {}", view + 1));
    let View { name, camera, .. } = &capture.views[view];
    let pixel = camera.project(placed(place)).expect("in front");
    let part = egui::vec2(
        (pixel.x / f64::from(camera.width)) as f32,
        (pixel.y / f64::from(camera.height)) as f32,
    );
    click_at(window, &format!("Photograph {name}"), part);
}
