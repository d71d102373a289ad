//! From the demo to a saved project and back, driven without a screen.

use std::path::Path;

use crate::driver::{
    Window, capture, click, coarse, drop_on, has, has_part, wait_for, wait_for_part, window,
};
use eframe::egui::{self, Modifiers, Pos2, vec2};
use egui_kittest::kittest::Queryable as _;
use rekindle::worker::Source;
use rekindle_capture::unpack_demo;

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

#[test]
fn cameras_and_photographs_are_there_after_reopening() {
    let folder = tempfile::tempdir().expect("a folder");
    let photographs = capture("spot_paper");
    let mut window = window(Some(Source::Path(photographs.clone())));
    wait_for(&mut window, "Findings");
    coarse(&mut window);
    key(&mut window, Modifiers::COMMAND, egui::Key::Enter);
    wait_for(&mut window, "Lit hemisphere");
    key(&mut window, Modifiers::COMMAND, egui::Key::S);
    give_path(&mut window, &folder.path().join("evening"));
    wait_for(&mut window, "Saved");
    drop(window);

    // The project knows where its photographs are.
    let mut window = crate::driver::window(None);
    window.step();
    drop_on(&mut window, &folder.path().join("evening.rekindle"));
    wait_for(&mut window, "Lit hemisphere");
    key(&mut window, Modifiers::NONE, egui::Key::Num1);
    wait_for(&mut window, "Wipe");
    click(&mut window, "Wipe");
    wait_for_part(
        &mut window,
        "photograph and rendering in the captured light, ",
    );
    // What is shown is the captured light: nothing is placed there.
    click(&mut window, "Light 1");
    assert!(has(
        &window,
        "The captured light is shown; lights are placed in Object."
    ));
    assert!(!has(&window, "Light 1 handle"));
    click(&mut window, "Object");
    window.run_steps(2);
    assert!(has_part(&window, "Press on the object to place Light 1"));
    drop(window);

    // A solution alone has its cameras; the photographs are located.
    let mut window = crate::driver::window(None);
    window.step();
    drop_on(&mut window, &folder.path().join("evening.solution"));
    wait_for(&mut window, "Lit hemisphere");
    key(&mut window, Modifiers::NONE, egui::Key::Num2);
    window.run_steps(2);
    assert!(has(&window, "images/view_001.exr") && !has(&window, "Wipe"));
    click(&mut window, "Locate photographs…");
    let other = folder.path().join("demo");
    unpack_demo(&other).expect("written");
    give_path(&mut window, &other);
    wait_for(&mut window, "The photographs can't be used");
    click(&mut window, "Close message The photographs can't be used");
    click(&mut window, "Locate photographs…");
    give_path(&mut window, &photographs);
    wait_for(&mut window, "Difference");
    click(&mut window, "Difference");
    wait_for_part(&mut window, " dB");
}
