//! From the demo to a saved project and back, driven without a screen.

use std::path::Path;

use crate::driver::{Window, click, coarse, drop_on, has, has_part, wait_for, window};
use eframe::egui::{self, Modifiers, Pos2, vec2};
use egui_kittest::kittest::Queryable as _;

fn key(window: &mut Window, modifiers: Modifiers, key: egui::Key) {
    window.key_press_modifiers(modifiers, key);
    window.run_steps(3);
}

/// Drags from a place to another by way of those between.
fn drag(window: &mut Window, from: Pos2, to: Pos2) {
    window.hover_at(from);
    window.step();
    window.drag_at(from);
    window.step();
    for k in 1..=8 {
        window.hover_at(from + (to - from) * (k as f32 / 8.0));
        window.step();
    }
    window.drop_at(to);
    window.run_steps(3);
}

/// Answers a question for a path; without a desktop there is no file dialog.
fn give_path(window: &mut Window, path: &Path) {
    wait_for(window, "Use this path");
    let field = window.get_by_label("Path");
    field.type_text(&path.display().to_string());
    window.run_steps(2);
    click(window, "Use this path");
}

/// Exports the view, 96 × 64 pixels. Returns the PNG file.
fn export(window: &mut Window, folder: &Path) -> Vec<u8> {
    key(window, Modifiers::COMMAND, egui::Key::E);
    wait_for(window, "Choose folder…");
    for (side, pixels) in [("Width", 96.0), ("Height", 64.0)] {
        let field = window.get_by_role_and_label(egui::Role::SpinButton, side);
        field.set_value_accesskit(pixels);
        window.run_steps(2);
    }
    click(window, "Choose folder…");
    give_path(window, folder);
    click(window, "Export");
    wait_for(window, "Exported");
    let pictures: Vec<_> = std::fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    assert_eq!(pictures.len(), 1, "{pictures:?}");
    std::fs::read(&pictures[0]).expect("the picture")
}

#[test]
fn the_demo_is_relit_exported_saved_and_comes_back_with_the_same_pixels() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(None);
    window.step();
    click(&mut window, "Try the demo");
    wait_for(&mut window, "Findings");
    coarse(&mut window);
    let estimate = window.get_all_by_label("Estimate").last();
    estimate.expect("the button").click();
    wait_for(&mut window, "Lit hemisphere");
    window.run_steps(3);

    click(&mut window, "Mute Light 1");
    key(&mut window, Modifiers::COMMAND, egui::Key::Z);
    assert!(has_part(&window, "Undone: mute light"));
    let mark = window.get_by_label("Light 1 on the hemisphere").rect();
    let disc = window.get_by_label("Lit hemisphere").rect();
    drag(
        &mut window,
        mark.center(),
        disc.center() + 0.3 * vec2(disc.width(), -disc.height()),
    );
    let moved = window.get_by_label("Light 1 on the hemisphere").rect();
    assert!(
        moved.center().distance(mark.center()) > 20.0,
        "it was moved"
    );
    let first = export(&mut window, &folder.path().join("first"));

    key(&mut window, Modifiers::COMMAND, egui::Key::S);
    give_path(&mut window, &folder.path().join("evening"));
    wait_for(&mut window, "Saved");
    // The solve is saved beside the project.
    assert!(folder.path().join("evening.solution").is_dir());
    drop(window);

    let mut window = crate::driver::window(None);
    window.step();
    drop_on(&mut window, &folder.path().join("evening.rekindle"));
    wait_for(&mut window, "Lit hemisphere");
    window.run_steps(3);
    let again = window.get_by_label("Light 1 on the hemisphere").rect();
    assert!(again.center().distance(moved.center()) < 1.0, "still there");
    assert!(!has(&window, "Save the changes?"));
    let second = export(&mut window, &folder.path().join("second"));
    assert!(first == second, "the same pixels");
}
