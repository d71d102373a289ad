//! Pictures of every state of the window, drawn without a screen:
//! `cargo test --release --test screenshots -- --ignored` writes screenshots/*.png.

mod driver;

use std::path::Path;

use driver::{Window, click, has, wait_for, wait_for_part};
use eframe::egui;
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable as _;
use rekindle::app::{App, Start};

/// A window drawn by whatever graphics adapter there is.
fn drawn(size: [f32; 2]) -> Window {
    Harness::builder()
        .with_size(egui::vec2(size[0], size[1]))
        .with_render_cursor(false)
        .wgpu()
        .build_eframe(|cc| App::new(cc, Start::default()).expect("threads"))
}

fn shoot(window: &mut Window, name: &str) {
    for _ in 0..3 {
        window.step();
    }
    let picture = window.render().expect("a picture");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("screenshots");
    let file = folder.join(format!("{name}.png"));
    picture.save(&file).expect("written");
}

/// Draws until the picture in the viewport stands still.
fn settle(window: &mut Window) {
    for _ in 0..400 {
        std::thread::sleep(std::time::Duration::from_millis(10));
        window.step();
    }
}

#[test]
#[ignore = "writes pictures"]
fn every_state() {
    let mut window = drawn([1280.0, 800.0]);
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
    shoot(&mut window, "estimating_partial");
    wait_for_part(&mut window, "Iteration 3,");
    click(&mut window, "Pause");
    settle(&mut window);
    shoot(&mut window, "estimating_first");
    click(&mut window, "Resume");
    wait_for_part(&mut window, "Iteration 14,");
    click(&mut window, "Pause");
    settle(&mut window);
    shoot(&mut window, "estimating_later");
    click(&mut window, "Resume");
    wait_for(&mut window, "Light 1");
    assert!(has(&window, "Viewport"));
    settle(&mut window);
    shoot(&mut window, "relit");
    window.key_press(egui::Key::Num3);
    window.step();
    click(&mut window, "Difference");
    settle(&mut window);
    shoot(&mut window, "difference");
    click(&mut window, "Wipe");
    settle(&mut window);
    shoot(&mut window, "wipe");
    click(&mut window, "Estimation");
    click(&mut window, "Compare with");
    settle(&mut window);
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
    let mut window = drawn([1024.0, 640.0]);
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::T);
    window.step();
    click(&mut window, "Try the demo");
    wait_for(&mut window, "Findings");
    shoot(&mut window, "light_preflight");
    driver::coarse(&mut window);
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Enter);
    window.step();
    wait_for_part(&mut window, "Iteration 6,");
    shoot(&mut window, "light_estimating");
    wait_for(&mut window, "Light 1");
    settle(&mut window);
    shoot(&mut window, "light_relit");
}
