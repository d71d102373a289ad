//! Pictures of every state of the window, drawn without a screen:
//! `cargo test --release --test screenshots -- --ignored` writes screenshots/*.png.

#[path = "window/driver.rs"]
mod driver;

use std::ops::ControlFlow;
use std::path::Path;

use driver::{
    Window, click, drawn, finished, has, shows_iteration, still, wait_for, wait_for_iteration,
};
use eframe::egui;
use egui_kittest::kittest::Queryable as _;
use rekindle::worker::Source;
use rekindle_capture::Capture;
use rekindle_lab::synth::{Encode, Files, Recipe, make};

/// Writes the window's picture once it is final.
fn shoot(window: &mut Window, name: &str) {
    let picture = finished(window);
    write(&picture, name);
}

/// Writes the window's picture at once.
fn snap(window: &mut Window, name: &str) {
    window.step();
    let picture = window.render().expect("a picture");
    write(&picture, name);
}

fn write(picture: &image::RgbaImage, name: &str) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("screenshots");
    let file = folder.join(format!("{name}.png"));
    picture.save(&file).expect("written");
}

#[test]
#[ignore = "writes pictures"]
fn every_state() {
    let mut window = drawn([1280.0, 800.0], None);
    shoot(&mut window, "welcome");
    click(&mut window, "Try the demo");
    wait_for(&mut window, "Findings");
    shoot(&mut window, "preflight");
    window
        .get_all_by_label("Estimate")
        .last()
        .expect("the button")
        .click();
    wait_for(&mut window, "View 4 hemisphere");
    snap(&mut window, "estimating_partial");
    wait_for_iteration(&mut window, 3);
    click(&mut window, "Pause");
    shoot(&mut window, "estimating_first");
    // From pause to pause: a fast machine would be done before the next look.
    while !shows_iteration(&window, 12) {
        click(&mut window, "Resume");
        click(&mut window, "Pause");
    }
    shoot(&mut window, "estimating_later");
    click(&mut window, "Resume");
    wait_for(&mut window, "Light 1");
    assert!(has(&window, "Viewport"));
    wait_for(&mut window, "Close message Estimated");
    click(&mut window, "Close message Estimated");
    shoot(&mut window, "relit");
    // The first lamp's highlight, put elsewhere.
    window.key_press(egui::Key::N);
    window.step();
    let middle = window.get_by_label("Viewport").rect().center();
    window.drag_at(middle);
    window.step();
    for part in [0.3, 0.6, 1.0] {
        window.hover_at(middle + part * egui::vec2(-90.0, 10.0));
        window.step();
    }
    let dragged = still(&mut window);
    write(&dragged, "lamp_dragged");
    window.drop_at(middle + egui::vec2(-90.0, 10.0));
    window.step();
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::E);
    window.step();
    shoot(&mut window, "export");
    window.key_press(egui::Key::Escape);
    window.step();
    let shifted = egui::Modifiers::COMMAND | egui::Modifiers::SHIFT;
    window.key_press_modifiers(shifted, egui::Key::E);
    window.step();
    shoot(&mut window, "export_programs");
    window.key_press(egui::Key::Escape);
    window.step();
    window.key_press(egui::Key::Num3);
    window.step();
    click(&mut window, "Difference");
    shoot(&mut window, "difference");
    click(&mut window, "Wipe");
    shoot(&mut window, "wipe");
    click(&mut window, "Estimation");
    click(&mut window, "Compare with");
    shoot(&mut window, "researcher");
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::P);
    shoot(&mut window, "palette");
    window.key_press(egui::Key::Escape);
    window.step();
    window.key_press(egui::Key::Questionmark);
    shoot(&mut window, "keys");
}

#[test]
#[ignore = "writes pictures"]
fn small_and_light() {
    let mut window = drawn([1024.0, 640.0], None);
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::T);
    window.step();
    click(&mut window, "Try the demo");
    wait_for(&mut window, "Findings");
    shoot(&mut window, "light_preflight");
    driver::coarse(&mut window);
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Enter);
    window.step();
    wait_for_iteration(&mut window, 6);
    snap(&mut window, "light_estimating");
    wait_for(&mut window, "Light 1");
    shoot(&mut window, "light_relit");
}

/// Pages at the sizes that people have, to be looked at: `target/layouts/*.png`.
#[test]
#[ignore = "writes pictures"]
fn every_page_at_every_size() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/layouts");
    std::fs::create_dir_all(&folder).expect("a folder");
    for [width, height, scale] in [
        [1024.0, 640.0, 1.0],
        [1280.0, 800.0, 1.0],
        [2560.0, 1440.0, 1.0],
        [1280.0, 720.0, 2.0],
    ] {
        let mut window = drawn([scale * width, scale * height], None);
        window.set_pixels_per_point(scale);
        let page = |window: &mut Window, name: &str| {
            window.run_steps(4);
            let picture = window.render().expect("a picture");
            let file = format!("{width}x{height}@{scale}_{name}.png");
            picture.save(folder.join(file)).expect("written");
        };
        page(&mut window, "welcome");
        click(&mut window, "Try the demo");
        wait_for(&mut window, "Findings");
        page(&mut window, "capture");
        driver::coarse(&mut window);
        window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Enter);
        window.step();
        wait_for(&mut window, "Close message Estimated");
        click(&mut window, "Close message Estimated");
        click(&mut window, "Light 1");
        click(&mut window, "Result: Good");
        page(&mut window, "relighting");
        window
            .get_by_label_contains("Difference at view 2, ")
            .click();
        window.step();
        page(&mut window, "difference");
        window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::E);
        page(&mut window, "export");
        window.key_press(egui::Key::Escape);
        window.step();
        click(&mut window, "Estimation");
        page(&mut window, "estimation_result");
        click(&mut window, "Close the result");
        click(&mut window, "Compare with");
        page(&mut window, "estimation");
    }
}

/// A known light as it is chosen and turned, and what came of it: `target/layouts/*.png`.
#[test]
#[ignore = "writes pictures"]
fn a_known_light() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/layouts");
    std::fs::create_dir_all(&folder).expect("a folder");
    let capture = driver::capture("spot_paper");
    for [width, height] in [[1024.0, 640.0], [1280.0, 800.0]] {
        let mut window = drawn([width, height], Some(Source::Path(capture.clone())));
        let page = |window: &mut Window, name: &str| {
            let file = format!("{width}x{height}@1_known_light_{name}.png");
            finished(window).save(folder.join(file)).expect("written");
        };
        wait_for(&mut window, "Findings");
        driver::drop_on(&mut window, &capture.join("truth/environment.exr"));
        wait_for(&mut window, "environment.exr");
        page(&mut window, "chosen");
        window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Enter);
        window.step();
        wait_for(&mut window, "Close message Estimated");
        click(&mut window, "Close message Estimated");
        click(&mut window, "Result: Good");
        page(&mut window, "result");
        click(&mut window, "Capture");
        click(&mut window, "By hand");
        page(&mut window, "turned");
        window.key_press_modifiers(egui::Modifiers::SHIFT, egui::Key::F1);
        page(&mut window, "guide");
    }
}

#[test]
#[ignore = "writes pictures"]
fn a_mesh_that_lies_elsewhere() {
    let folder = tempfile::tempdir().expect("folder");
    driver::misplace(folder.path());
    let (capture, _) = Capture::load_unplaced(folder.path()).expect("a capture");
    let mut window = drawn(
        [1280.0, 800.0],
        Some(Source::Path(folder.path().to_owned())),
    );
    wait_for(&mut window, "Align by points…");
    click(&mut window, "Align by points…");
    wait_for(&mut window, "Picture of the mesh");
    for (point, [x, y]) in driver::ON_MESH.into_iter().enumerate() {
        driver::click_at(&mut window, "Picture of the mesh", egui::vec2(x, y));
        let place = driver::point_on_mesh(&window, point + 1);
        for view in [0, 1 + point].into_iter().rev().take(1 + point) {
            driver::mark(&mut window, &capture, view, place);
        }
    }
    shoot(&mut window, "align_points");
}

#[test]
#[ignore = "writes pictures"]
fn brackets_of_a_camera_with_a_response_of_its_own() {
    let folder = tempfile::tempdir().expect("folder");
    let capture = folder.path().join("figurine");
    let mut recipe = Recipe::default();
    recipe.views.size = [480, 360];
    recipe.views.supersampling = 1;
    recipe.sensor.files = Files::Brackets { count: 5, stops: 1 };
    recipe.sensor.response = Encode::Film;
    recipe.truth_pictures = false;
    make(&recipe, &capture, &mut |_, _| ControlFlow::Continue(())).expect("a capture");
    let mut window = drawn([1280.0, 800.0], Some(Source::Path(capture)));
    wait_for(&mut window, "Findings");
    shoot(&mut window, "brackets");
}
