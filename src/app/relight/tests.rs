//! The page driven by the names that a screen reader reads, in a window without a screen.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use eframe::egui::{self, Modifiers, Pos2, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use glam::Vec3;

use crate::app::{App, Start};
use crate::worker::Source;
use rekindle_estimate::estimate::Diagnostics;
use rekindle_estimate::registration::Correction;
use rekindle_solution::Solution;
use rekindle_studio::fixtures::solution;
use rekindle_studio::{Document, LampId};

/// Longer than anything here takes on a slow machine.
const PATIENCE: Duration = Duration::from_mins(2);

type Window = Harness<'static, App>;

fn window(open: &Path) -> Window {
    let open = Some(Source::Path(open.to_owned()));
    let start = Start {
        open,
        recovery: None,
    };
    let mut window = Harness::builder()
        .with_size(vec2(1280.0, 900.0))
        .build_eframe(|cc| App::new(cc, start).expect("threads"));
    wait(&mut window, "the page", |w| {
        w.query_by_label("Lit hemisphere").is_some()
            && w.state()
                .relighting
                .as_ref()
                .is_some_and(|r| r.viewport.occluder().is_some() && r.viewport.seen().is_some())
    });
    window
}

fn wait(window: &mut Window, what: &str, there: impl Fn(&Window) -> bool) {
    let since = Instant::now();
    while !there(window) {
        assert!(since.elapsed() < PATIENCE, "no {what}");
        std::thread::sleep(Duration::from_millis(5));
        window.step();
    }
    window.run_steps(2);
}

fn wait_for(window: &mut Window, label: &str) {
    wait(window, label, |w| {
        w.query_all_by_label(label).next().is_some()
    });
}

fn document(window: &Window) -> &Document {
    window
        .state()
        .relighting
        .as_ref()
        .expect("a document")
        .document()
}

fn click(window: &mut Window, label: &str) {
    window.get_by_label(label).click();
    window.run_steps(3);
}

fn key(window: &mut Window, modifiers: Modifiers, key: egui::Key) {
    window.key_press_modifiers(modifiers, key);
    window.run_steps(3);
}

/// Sets a slider or a number.
fn set(window: &mut Window, label: &str, value: f64) {
    window
        .get_by_role_and_label(egui::Role::SpinButton, label)
        .set_value_accesskit(value);
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

/// Types a path where the system has no file dialog, which it must not have here.
fn give_path(window: &mut Window, path: &Path) {
    wait_for(window, "Use this path");
    window
        .get_by_label("Path")
        .type_text(&path.display().to_string());
    window.run_steps(2);
    click(window, "Use this path");
}

/// Exports the view, 64 × 48 pixels, and returns the file.
fn export(window: &mut Window, folder: &Path) -> Vec<u8> {
    key(window, Modifiers::COMMAND, egui::Key::E);
    wait_for(window, "Choose folder…");
    set(window, "Width", 64.0);
    set(window, "Height", 48.0);
    window.run_steps(2);
    click(window, "Choose folder…");
    give_path(window, folder);
    click(window, "Export");
    wait(window, "the export", |_| {
        std::fs::read_dir(folder).is_ok_and(|d| {
            d.flatten()
                .any(|e| e.path().extension().is_some_and(|x| x == "png"))
        })
    });
    let file = std::fs::read_dir(folder)
        .expect("a folder")
        .flatten()
        .map(|e| e.path())
        .find(|p| p.extension().is_some_and(|x| x == "png"));
    std::fs::read(file.expect("a picture")).expect("the picture")
}

fn saved_solution(folder: &Path) -> PathBuf {
    let place = folder.join("bumps");
    solution().save(&place).expect("saved");
    place
}

fn lamp(window: &Window, id: u32) -> rekindle_studio::Lamp {
    document(window)
        .look()
        .lamp(LampId(id))
        .expect("the lamp")
        .clone()
}

#[test]
fn a_lamp_is_muted_dragged_exported_and_comes_back_with_the_project() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    click(&mut window, "Mute Light 1");
    assert!(lamp(&window, 0).muted);
    key(&mut window, Modifiers::COMMAND, egui::Key::Z);
    assert!(!lamp(&window, 0).muted, "undone");
    assert!(!document(&window).is_modified());

    let before = lamp(&window, 0).direction;
    let mark = window
        .get_by_label("Light 1 on the hemisphere")
        .rect()
        .center();
    let disc = window.get_by_label("Lit hemisphere").rect();
    drag(
        &mut window,
        mark,
        disc.center() + vec2(-0.3, 0.2) * disc.width(),
    );
    let after = lamp(&window, 0).direction;
    assert!(after.angle_between(before) > 0.3, "it was moved");
    // −0.3 of the width is −0.6 of the radius, to the west and, downwards, 0.4 to the south.
    assert!(
        after.distance(Vec3::new(-0.6, 0.693, 0.4)) < 0.05,
        "{after}"
    );
    assert_eq!(document(&window).undo_label(), Some("Move Light 1"));

    // From another side, with more exposure: the project keeps the view too.
    let view = window.get_by_label("Viewport").rect();
    drag(
        &mut window,
        view.left_bottom() + vec2(20.0, -20.0),
        view.left_bottom() + vec2(140.0, -60.0),
    );
    key(&mut window, Modifiers::NONE, egui::Key::E);
    wait(&mut window, "rest", |w| {
        let relighting = w.state().relighting.as_ref().expect("a page");
        !relighting.viewport.is_moving()
    });
    let first = export(&mut window, &folder.path().join("first"));
    key(&mut window, Modifiers::COMMAND, egui::Key::S);
    give_path(&mut window, &folder.path().join("evening"));
    wait_for(&mut window, "Saved");
    assert!(!document(&window).is_modified());
    // One drag, one step.
    key(&mut window, Modifiers::COMMAND, egui::Key::Z);
    assert_eq!(
        lamp(&window, 0).direction,
        before,
        "history survives saving"
    );
    drop(window);

    let mut window = self::window(&folder.path().join("evening.rekindle"));
    assert_eq!(lamp(&window, 0).direction, after);
    let second = export(&mut window, &folder.path().join("second"));
    assert!(first == second, "the same pixels");
}

#[test]
fn lamps_are_placed_and_asked_for_by_pointing() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    let view = window.get_by_label("Viewport").rect();
    // Right of the middle there is surface.
    let at = view.center() + vec2(0.04, 0.02) * view.width();
    click(&mut window, "Light 2");
    drag(&mut window, at - vec2(30.0, 0.0), at);
    assert_eq!(document(&window).undo_label(), Some("Place highlight"));
    let mirrored = {
        let relighting = window.state().relighting.as_ref().expect("a page");
        let (point, view) = relighting.viewport.surface_at(at).expect("surface");
        2.0 * point.normal.dot(view) * point.normal - view
    };
    assert!(lamp(&window, 1).direction.distance(mirrored) < 1e-3);
    // Its highlight is there now, so asking there gives this lamp.
    key(&mut window, Modifiers::NONE, egui::Key::Escape);
    window.hover_at(at - vec2(3.0, 0.0));
    window.run_steps(2);
    window.hover_at(at);
    window.run_steps(3);
    let asked = window
        .query_all_by_label_contains("Highlight of Light 2")
        .count();
    assert!(asked > 0, "the lamp is named");
    assert_eq!(
        window
            .state()
            .relighting
            .as_ref()
            .and_then(|r| r.editing.lit),
        Some(LampId(1)),
        "its marks light up"
    );
    // The other ways of placing, by their keys.
    click(&mut window, "Light 3");
    for (place, label) in [
        (egui::Key::B, "Place brightest shading"),
        (egui::Key::G, "Place rim light"),
    ] {
        key(&mut window, Modifiers::NONE, place);
        drag(&mut window, at - vec2(20.0, 0.0), at);
        assert_eq!(document(&window).undo_label(), Some(label));
    }
    let handle = window.get_by_label("Light 1 handle").rect().center();
    drag(&mut window, handle, handle + vec2(-60.0, 20.0));
    assert_eq!(document(&window).undo_label(), Some("Move Light 1"));
}

#[test]
fn every_setting_of_a_lamp_is_a_step() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    let start = document(&window).state().clone();
    click(&mut window, "Light 2");
    set(&mut window, "Intensity", 1.5);
    window.run_steps(3);
    assert_eq!(document(&window).undo_label(), Some("Intensity of Light 2"));
    assert_eq!(lamp(&window, 1).stops, 1.5);
    set(&mut window, "Softness", 12.0);
    window.run_steps(3);
    click(&mut window, "Temperature");
    set(&mut window, "Colour temperature", 3000.0);
    window.run_steps(3);
    click(&mut window, "Surroundings");
    set(&mut window, "Ambient", 0.5);
    window.run_steps(3);
    click(&mut window, "Solo Light 1");
    key(&mut window, Modifiers::SHIFT, egui::Key::D);
    assert_eq!(document(&window).look().lamps.len(), 4);
    key(&mut window, Modifiers::NONE, egui::Key::Delete);
    key(&mut window, Modifiers::NONE, egui::Key::A);
    assert_eq!(document(&window).look().lamps.len(), 4);
    click(&mut window, "Edit setup");
    click(&mut window, "Duplicate setup");
    assert_eq!(document(&window).state().active, 2);
    key(&mut window, Modifiers::NONE, egui::Key::L);
    assert_eq!(document(&window).state().active, 0);
    let mut steps = Vec::new();
    while let Some(label) = document(&window).undo_label().map(str::to_owned) {
        key(&mut window, Modifiers::COMMAND, egui::Key::Z);
        steps.push(label);
    }
    assert_eq!(steps.len(), 11, "each was one step: {steps:?}");
    assert!(document(&window).state() == &start);
    window.check_accessibility();
}

#[test]
fn a_light_probe_replaces_the_light_and_can_be_turned() {
    let folder = tempfile::tempdir().expect("a folder");
    let probe = folder.path().join("studio.exr");
    let pixels: Vec<[f32; 3]> = (0..64 * 32)
        .map(|i| {
            if i % 64 < 8 {
                [30.0, 25.0, 20.0]
            } else {
                [0.5; 3]
            }
        })
        .collect();
    rekindle_solution::write_rgb(&probe, 64, &pixels).expect("written");
    let mut window = window(&saved_solution(folder.path()));
    click(&mut window, "Surroundings");
    click(&mut window, "Choose…");
    give_path(&mut window, &probe);
    wait_for(&mut window, "Remove");
    let look = document(&window).look().clone();
    assert!(look.lamps.iter().all(|l| l.muted) && !look.remainder);
    assert!(document(&window).light().lighting.environment.is_some());
    set(&mut window, "Turn of the light probe", 90.0);
    let turned = document(&window).look().probe.as_ref().map(|p| p.rotation);
    assert!((turned.unwrap_or_default() - 90_f32.to_radians()).abs() < 1e-5);
    key(&mut window, Modifiers::COMMAND, egui::Key::Z);
    key(&mut window, Modifiers::COMMAND, egui::Key::Z);
    assert!(document(&window).look().probe.is_none() && !document(&window).is_modified());
    // What is no picture is a message, and the light stays.
    std::fs::write(&probe, "no picture").expect("written");
    click(&mut window, "Choose…");
    give_path(&mut window, &probe);
    wait_for(&mut window, "The light probe can't be used");
    assert!(!document(&window).is_modified());
}

#[test]
fn an_export_is_stopped_and_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    key(&mut window, Modifiers::COMMAND, egui::Key::E);
    wait_for(&mut window, "Choose folder…");
    click(&mut window, "A turn around the object");
    click(&mut window, "Choose folder…");
    let target = folder.path().join("film");
    give_path(&mut window, &target);
    click(&mut window, "Export");
    wait(&mut window, "progress", |w| {
        w.query_all_by_label_contains("Exporting bumps Captured light_0")
            .next()
            .is_some()
    });
    click(&mut window, "Stop");
    wait_for(&mut window, "Export stopped");
    assert!(!target.exists(), "nothing is left");
}

#[test]
fn other_programs_get_the_light_of_the_setup_that_is_shown() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    click(&mut window, "Mute Light 2");
    key(
        &mut window,
        Modifiers::COMMAND | Modifiers::SHIFT,
        egui::Key::E,
    );
    wait_for(&mut window, "Export for other programs");
    click(&mut window, "Mitsuba 3");
    click(&mut window, "One for each light");
    click(&mut window, "Choose folder…");
    let target = folder.path().join("programs");
    give_path(&mut window, &target);
    click(&mut window, "Export");
    wait_for(&mut window, "Exported");
    let read = |name: &str| std::fs::read_to_string(target.join(name)).expect(name);
    let lamps = read("lights.csv");
    assert!(lamps.contains("Light 1") && lamps.contains("Light 3"));
    assert!(!lamps.contains("Light 2"), "it is muted: {lamps}");
    assert!(target.join("light_3.exr").exists() && !target.join("light_2.exr").exists());
    assert!(target.join("object.glb").exists() && !target.join("mitsuba.xml").exists());
    assert!(read("README.txt").contains("object.glb"));
}

#[test]
fn a_web_page_is_exported_with_all_setups() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    click(&mut window, "Mute Light 2");
    key(&mut window, Modifiers::COMMAND, egui::Key::P);
    window
        .get_by_label("Find a command")
        .type_text("export web");
    window.run_steps(2);
    key(&mut window, Modifiers::NONE, egui::Key::Enter);
    wait_for(&mut window, "Export for other programs");
    click(&mut window, "Choose folder…");
    let target = folder.path().join("page");
    give_path(&mut window, &target);
    click(&mut window, "Export");
    wait_for(&mut window, "Exported");
    let files: Vec<_> = std::fs::read_dir(&target).expect("a folder").collect();
    assert_eq!(files.len(), 1, "the page alone: {files:?}");
    let html = std::fs::read_to_string(target.join("object.html")).expect("a page");
    assert!(html.contains("\"Captured light\"") && html.contains("\"Setup 1\""));
    assert_eq!(
        html.matches("\"muted\":true").count(),
        1,
        "in the setup alone"
    );
}

#[test]
fn the_captured_light_stays_and_is_compared_with_by_one_key() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    assert!(window.query_by_label("Setup 1").is_none());
    click(&mut window, "Light 2");
    set(&mut window, "Intensity", 1.5);
    // The first change began a setup; the captured light is as it was.
    assert!(window.query_by_label("Setup 1").is_some());
    let captured = document(&window).state().looks[0].clone();
    assert_eq!(
        document(&window).light_of(&captured).lighting,
        solution().lighting()
    );
    let shown = |w: &Window| document(w).look().name.clone();
    assert_eq!(shown(&window), "Setup 1");
    key(&mut window, Modifiers::NONE, egui::Key::C);
    assert_eq!(shown(&window), "Captured light");
    key(&mut window, Modifiers::NONE, egui::Key::C);
    assert_eq!(shown(&window), "Setup 1");
    assert_eq!(document(&window).undo_label(), Some("Intensity of Light 2"));
    // One light goes back, the others stay as they are.
    click(&mut window, "Mute Light 1");
    click(&mut window, "Reset light");
    assert_eq!(document(&window).undo_label(), Some("Reset Light 2"));
    assert_eq!(lamp(&window, 1), captured.lamps[1]);
    assert!(lamp(&window, 0).muted);
    // All of it can be undone.
    for _ in 0..3 {
        key(&mut window, Modifiers::COMMAND, egui::Key::Z);
    }
    assert!(window.query_by_label("Setup 1").is_none());
    assert!(!document(&window).is_modified());
}

#[test]
fn ready_made_setups_are_applied_by_one_click() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    for (name, lights) in [
        ("Three-point", 3),
        ("Soft box", 2),
        ("Rim", 3),
        ("Ring", 8),
        ("Window", 7),
        ("Golden hour", 2),
    ] {
        click(&mut window, "Add setup");
        click(&mut window, name);
        let look = document(&window).look();
        assert_eq!((look.name.as_str(), look.lamps.len()), (name, lights));
        assert_eq!(document(&window).undo_label(), Some("Add setup"));
    }
    assert_eq!(document(&window).state().looks.len(), 7);
}

fn has_part(window: &Window, part: &str) -> bool {
    window.query_all_by_label_contains(part).next().is_some()
}

#[test]
fn the_result_card_says_what_a_solve_is_worth_and_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let good = saved_solution(folder.path());
    let mut solution = Solution::load(&good).expect("a solution");
    solution.diagnostics = Diagnostics {
        well_posed: false,
        specular_found: true,
        warnings: vec!["The view 2 contradicts the others. Check its camera.".to_owned()],
    };
    solution.sigma_interval95 = Some([0.08, 0.13]);
    solution.fit.psnr_db_per_view = vec![41.23, 22.5];
    let turned = Correction {
        turn_deg: [0.0, 0.25, 0.0],
        ..Correction::default()
    };
    solution.corrections = vec![Correction::default(), turned];
    let doubtful = folder.path().join("doubtful");
    solution.save(&doubtful).expect("saved");

    // A doubt opens the card; it stays until it is closed, and comes back by its button.
    let mut window = window(&doubtful);
    for part in [
        "The view 2 contradicts the others.",
        "Check its camera.",
        "0.0800 to 0.1300 rad",
        "it was made so",
        "camera turned by 0.25°",
        "Difference at view 1, 41.2 dB",
        "Difference at view 2, 22.5 dB",
    ] {
        assert!(has_part(&window, part), "{part}");
    }
    window.check_accessibility();
    click(&mut window, "Close the result");
    assert!(!has_part(&window, "Check its camera."));
    click(&mut window, "Result: Doubtful");
    assert!(has_part(&window, "Check its camera."));
    drop(window);

    // Lit by its shading it can be relit: approximate, with what to do for more.
    solution.diagnostics.specular_found = false;
    solution.brdf = None;
    let matte = folder.path().join("matte");
    solution.save(&matte).expect("saved");
    let window = self::window(&matte);
    assert!(has_part(&window, "Approximate") && !has_part(&window, "Failed"));
    assert!(has_part(&window, "the light is what the shading tells"));
    assert!(has_part(&window, "photograph something glossy with it"));
    assert!(has_part(&window, "Light 1 on the hemisphere"));
    drop(window);

    // Without light it failed, and says so.
    solution.lamps.clear();
    solution.radiance.fill([0.0; 3]);
    let failed = folder.path().join("failed");
    solution.save(&failed).expect("saved");
    let window = self::window(&failed);
    assert!(has_part(
        &window,
        "Neither highlights nor shading tell of the light"
    ));
    assert!(has_part(&window, "Failed"));
}

#[test]
fn many_lights_are_listed_by_what_they_contribute() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    let row = |w: &Window, name: &str| w.get_by_label(name).rect();
    let described = |w: &Window, name: &str| {
        let node = w.get_by_label(name);
        node.accesskit_node().description().expect("a description")
    };
    assert!(row(&window, "Light 1").top() < row(&window, "Light 2").top());
    click(&mut window, "Light 2");
    let intensity = |w: &Window| {
        w.get_by_role_and_label(egui::Role::SpinButton, "Intensity")
            .rect()
    };
    let pinned = intensity(&window);
    set(&mut window, "Intensity", 4.0);
    assert!(row(&window, "Light 2").top() < row(&window, "Light 1").top());
    let share = described(&window, "Light 2");
    assert!(
        share.contains("left") && share.contains("% of the light"),
        "{share}"
    );
    // From where it is looked at is told, on the disc and over the object.
    let disc = window.get_by_label("Lit hemisphere");
    let viewer = disc.accesskit_node().description().expect("a description");
    assert!(viewer.starts_with("You look from the "), "{viewer}");
    assert!(has_part(
        &window,
        &format!("Compass: {}", viewer.to_lowercase())
    ));
    // The list scrolls by itself; the settings stay where they are.
    for _ in 0..20 {
        key(&mut window, Modifiers::NONE, egui::Key::A);
    }
    assert!(row(&window, "Light 23").bottom() < pinned.top());
    window.hover_at(row(&window, "Light 23").center());
    window.event(egui::Event::MouseWheel {
        unit: egui::MouseWheelUnit::Point,
        delta: vec2(0.0, -2000.0),
        phase: egui::TouchPhase::Move,
        source: egui::MouseWheelSource::Wheel,
        modifiers: Modifiers::NONE,
    });
    window.run_steps(20);
    assert!(row(&window, "Light 3").bottom() < pinned.top());
    click(&mut window, "Light 3");
    assert_eq!(intensity(&window), pinned);
    // Marks are as large as their lights are strong.
    let relighting = window.state().relighting.as_ref().expect("a page");
    let radius = |id: u32| super::hemisphere::mark_radius(&relighting.document, &lamp(&window, id));
    assert!(radius(1) > 1.5 * radius(2));
    window.check_accessibility();
}

#[test]
fn the_palette_says_why_a_command_cannot_be_given() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    key(&mut window, Modifiers::COMMAND, egui::Key::P);
    window
        .get_by_label("Find a command")
        .type_text("solo light");
    window.run_steps(2);
    let row = window.get_by_label_contains("Solo light");
    assert!(row.accesskit_node().is_disabled());
    assert!(has_part(&window, "Select a light first."));
    // Enter does nothing with it.
    key(&mut window, Modifiers::NONE, egui::Key::Enter);
    assert!(has_part(&window, "Select a light first."));
    key(&mut window, Modifiers::NONE, egui::Key::Escape);
    click(&mut window, "Light 2");
    key(&mut window, Modifiers::COMMAND, egui::Key::P);
    window
        .get_by_label("Find a command")
        .type_text("solo light");
    window.run_steps(2);
    key(&mut window, Modifiers::NONE, egui::Key::Enter);
    assert_eq!(document(&window).look().solo, [LampId(1)]);
}

/// Names of the files in a folder, in order.
fn files(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder").flatten();
    let mut names: Vec<String> = entries
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

#[test]
fn exports_are_named_asked_about_and_remembered() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    let target = folder.path().join("pictures");
    export(&mut window, &target);
    wait_for(&mut window, "Exported");
    // The name says whose picture it is and in which light.
    assert_eq!(files(&target), ["bumps Captured light.png"]);
    window.get_by_label("Open folder").click();
    let opens = |command: &egui::OutputCommand| match command {
        egui::OutputCommand::OpenUrl(url) => url.url.ends_with("/pictures"),
        _ => false,
    };
    let opened = (0..4).any(|_| {
        window.step();
        window.output().platform_output.commands.iter().any(opens)
    });
    assert!(opened, "the folder is shown");

    // Folder and size are as they were; how long it takes is known now; what is there is asked about.
    key(&mut window, Modifiers::COMMAND, egui::Key::E);
    wait(&mut window, "the cost", |w| {
        has_part(w, "One picture, 0.0 megapixels, at most 1 MB; about ")
    });
    click(&mut window, "Export");
    wait_for(
        &mut window,
        "A file of this name is in the folder already, or will be.",
    );
    click(&mut window, "Keep both");
    wait(&mut window, "a second file", |_| files(&target).len() == 2);
    wait(&mut window, "its end", |w| w.state().job.is_none());
    let before = std::fs::metadata(target.join("bumps Captured light.png")).expect("there");
    key(&mut window, Modifiers::COMMAND, egui::Key::E);
    window.run_steps(3);
    click(&mut window, "Export");
    click(&mut window, "Replace");
    wait(&mut window, "its end", |w| w.state().job.is_none());
    assert_eq!(files(&target).len(), 2);
    let after = std::fs::metadata(target.join("bumps Captured light.png")).expect("there");
    assert!(after.modified().expect("a time") > before.modified().expect("a time"));

    // Another setup has another name, and one that is typed is taken.
    click(&mut window, "Mute Light 1");
    key(&mut window, Modifiers::COMMAND, egui::Key::E);
    window.run_steps(3);
    let name = window.get_by_role_and_label(egui::Role::TextInput, "Name");
    assert_eq!(name.value().as_deref(), Some("bumps Setup 1"));
    name.focus();
    window.run_steps(2);
    key(&mut window, Modifiers::COMMAND, egui::Key::A);
    let name = window.get_by_role_and_label(egui::Role::TextInput, "Name");
    name.type_text("evening/2");
    window.run_steps(3);
    click(&mut window, "Export");
    wait(&mut window, "its end", |w| w.state().job.is_none());
    assert!(
        files(&target).contains(&"evening_2.png".to_owned()),
        "{:?}",
        files(&target)
    );
}

#[test]
fn a_stopped_export_keeps_the_frames_that_were_finished() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    key(&mut window, Modifiers::COMMAND, egui::Key::E);
    wait_for(&mut window, "Choose folder…");
    click(&mut window, "A turn around the object");
    set(&mut window, "Width", 200.0);
    set(&mut window, "Height", 150.0);
    set(&mut window, "Frames", 900.0);
    click(&mut window, "Choose folder…");
    let target = folder.path().join("film");
    give_path(&mut window, &target);
    assert!(has_part(&window, "900 pictures, 27.0 megapixels"));
    click(&mut window, "Export");
    wait(&mut window, "a second frame", |w| {
        has_part(w, "Exporting bumps Captured light_0002")
    });
    assert!(has_part(&window, "Progress of the export"));
    click(&mut window, "Stop");
    wait_for(&mut window, "Export stopped");
    let kept = files(&target);
    assert!(
        kept.len() >= 2
            && kept
                .iter()
                .all(|f| Path::new(f).extension().is_some_and(|x| x == "png")),
        "{kept:?}"
    );
    let said = format!("Files of finished pictures that were kept: {}.", kept.len());
    assert!(has_part(&window, &said));
}

/// Clicks with keys held.
fn click_with(window: &mut Window, modifiers: Modifiers, label: &str) {
    window.get_by_label(label).click_modifiers(modifiers);
    window.run_steps(3);
}

fn muted(window: &Window) -> Vec<bool> {
    let look = document(window).look();
    look.lamps.iter().map(|l| look.is_dark(l)).collect()
}

#[test]
fn several_lights_are_selected_and_changed_together() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    let start = document(&window).state().clone();
    // With Ctrl one after the other, with Shift all between.
    click(&mut window, "Light 1");
    click_with(&mut window, Modifiers::COMMAND, "Light 3");
    key(&mut window, Modifiers::NONE, egui::Key::M);
    assert_eq!(muted(&window), [true, false, true]);
    assert_eq!(document(&window).undo_label(), Some("Mute 2 lights"));
    key(&mut window, Modifiers::NONE, egui::Key::M);
    assert_eq!(muted(&window), [false; 3]);
    click(&mut window, "Light 1");
    click_with(&mut window, Modifiers::SHIFT, "Light 3");
    set(&mut window, "Intensity", 1.5);
    let stops = |w: &Window| [0, 1, 2].map(|id| lamp(w, id).stops);
    assert_eq!(stops(&window), [1.5; 3]);
    assert_eq!(
        document(&window).undo_label(),
        Some("Intensity of 3 lights")
    );
    click_with(&mut window, Modifiers::COMMAND, "Light 1");
    set(&mut window, "Intensity", 0.5);
    assert_eq!(stops(&window), [1.5, 0.5, 0.5]);
    // Those that differ keep their differences.
    key(&mut window, Modifiers::COMMAND, egui::Key::A);
    set(&mut window, "Intensity", 2.0);
    let [first, second, third] = stops(&window);
    assert!(
        second == third && (first - second).abs() == 1.0,
        "{first} {second} {third}"
    );
    click(&mut window, "Temperature");
    set(&mut window, "Colour temperature", 3000.0);
    let warm = rekindle_studio::Colour::Kelvin(3000.0);
    assert!([0, 1, 2].iter().all(|id| lamp(&window, *id).colour == warm));

    // One mark is dragged: all turn with it, rigidly.
    let before = [0, 1, 2].map(|id| lamp(&window, id).direction);
    let mark = window.get_by_label("Light 1 on the hemisphere").rect();
    let disc = window.get_by_label("Lit hemisphere").rect();
    drag(
        &mut window,
        mark.center(),
        disc.center() + vec2(0.1, -0.1) * disc.width(),
    );
    let after = [0, 1, 2].map(|id| lamp(&window, id).direction);
    assert_eq!(document(&window).undo_label(), Some("Move 3 lights"));
    for (a, b) in [(0, 1), (1, 2), (0, 2)] {
        assert!(before[a].angle_between(after[a]) > 0.05, "moved");
        let apart = before[a].angle_between(before[b]) - after[a].angle_between(after[b]);
        assert!(
            apart.abs() < 1e-3,
            "they stay as far from each other: {apart}"
        );
    }
    // To the left of what is marked, by a rectangle: only the light there.
    key(&mut window, Modifiers::NONE, egui::Key::Escape);
    let mark = window.get_by_label("Light 2 on the hemisphere").rect();
    drag(
        &mut window,
        mark.center() - vec2(16.0, 16.0),
        mark.center() + vec2(14.0, 14.0),
    );
    key(&mut window, Modifiers::NONE, egui::Key::Delete);
    let left = document(&window).look().lamps.iter().map(|l| l.id.0);
    assert_eq!(left.collect::<Vec<_>>(), [0, 2]);
    key(&mut window, Modifiers::NONE, egui::Key::N);
    key(&mut window, Modifiers::SHIFT, egui::Key::N);
    key(&mut window, Modifiers::SHIFT, egui::Key::D);
    assert_eq!(document(&window).look().lamps.len(), 4);
    key(&mut window, Modifiers::NONE, egui::Key::S);
    assert_eq!(document(&window).look().solo.len(), 2);
    assert_eq!(document(&window).undo_label(), Some("Solo 2 lights"));
    window.check_accessibility();
    while document(&window).undo_label().is_some() {
        key(&mut window, Modifiers::COMMAND, egui::Key::Z);
    }
    assert!(document(&window).state() == &start);
}

#[test]
fn lights_are_grouped_set_together_and_come_back_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    let brightness = |w: &Window, lamp: usize| {
        rekindle_relight::luminance(document(w).light().lighting.lamps[lamp].flux())
    };
    let before = [0, 1, 2].map(|lamp| brightness(&window, lamp));
    click(&mut window, "Light 1");
    click_with(&mut window, Modifiers::COMMAND, "Light 2");
    key(&mut window, Modifiers::COMMAND, egui::Key::G);
    assert_eq!(document(&window).undo_label(), Some("Group lights"));
    let row = window.get_by_label("Group 1");
    let described = row.accesskit_node().description().expect("a description");
    assert!(described.contains("2 lights"), "{described}");
    // The group is selected: its intensity is its own, beside that of its lights.
    set(&mut window, "Intensity", -1.0);
    assert_eq!(document(&window).undo_label(), Some("Intensity of Group 1"));
    assert_eq!(lamp(&window, 0).stops, 0.0);
    for (lamp, part) in [(0, 0.5), (1, 0.5), (2, 1.0)] {
        let now = brightness(&window, lamp);
        assert!((now / before[lamp] - part).abs() < 1e-4, "{lamp}: {now}");
    }
    // Folded, its lights have no rows.
    click(&mut window, "Fold Group 1");
    assert!(window.query_by_label("Light 1").is_none());
    assert!(window.query_by_label("Light 3").is_some());
    click(&mut window, "Mute Group 1");
    assert_eq!(muted(&window), [true, true, false]);
    click(&mut window, "Mute Group 1");
    click(&mut window, "Solo Group 1");
    assert_eq!(muted(&window), [false, false, true]);
    click(&mut window, "Solo Group 1");
    assert_eq!(muted(&window), [false; 3]);
    // Its name is typed where it stands.
    window.get_by_label("Group 1").click_secondary();
    window.run_steps(3);
    click(&mut window, "Rename");
    key(&mut window, Modifiers::COMMAND, egui::Key::A);
    window
        .get_by_label("Name of the group")
        .type_text("Windows");
    window.run_steps(2);
    key(&mut window, Modifiers::NONE, egui::Key::Enter);
    assert_eq!(document(&window).look().groups[0].name, "Windows");
    window.check_accessibility();
    key(&mut window, Modifiers::COMMAND, egui::Key::S);
    give_path(&mut window, &folder.path().join("evening"));
    wait_for(&mut window, "Saved");
    drop(window);

    let mut window = self::window(&folder.path().join("evening.rekindle"));
    assert!(window.query_by_label("Unfold Windows").is_some());
    assert!((brightness(&window, 0) / before[0] - 0.5).abs() < 1e-4);
    click(&mut window, "Unfold Windows");
    click(&mut window, "Windows");
    key(
        &mut window,
        Modifiers::COMMAND | Modifiers::SHIFT,
        egui::Key::G,
    );
    assert!(document(&window).look().groups.is_empty());
    assert!((brightness(&window, 0) / before[0] - 0.5).abs() < 1e-4);
    assert_eq!(lamp(&window, 0).stops, -1.0, "the light stays");
    key(&mut window, Modifiers::COMMAND, egui::Key::Z);
    click(&mut window, "Windows");
    key(&mut window, Modifiers::NONE, egui::Key::Delete);
    assert_eq!(document(&window).look().lamps.len(), 1);
    assert!(document(&window).look().groups.is_empty());
}

#[test]
fn the_history_lists_every_step_and_goes_to_any() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    key(&mut window, Modifiers::COMMAND, egui::Key::H);
    assert!(window.query_by_label("As it was opened").is_some());
    click(&mut window, "Mute Light 1");
    click(&mut window, "Light 2");
    set(&mut window, "Intensity", 1.5);
    set(&mut window, "Softness", 12.0);
    let soft = document(&window).state().clone();
    // Back to the first step, from there to the last, and to the beginning.
    click(&mut window, "Mute light");
    assert!(lamp(&window, 0).muted);
    assert_eq!(lamp(&window, 1).stops, 0.0);
    assert_eq!(document(&window).redo_label(), Some("Intensity of Light 2"));
    click(&mut window, "Softness of Light 2");
    assert!(document(&window).state() == &soft);
    click(&mut window, "As it was opened");
    assert!(!document(&window).is_modified());
    // Another change takes the place of what was undone.
    click(&mut window, "Mute Light 3");
    assert!(window.query_by_label("Softness of Light 2").is_none());
    window.check_accessibility();
    click(&mut window, "Close the history");
    assert!(window.query_by_label("As it was opened").is_none());
}

#[test]
fn typed_paths_may_be_relative_to_the_folder_that_is_shown() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    key(&mut window, Modifiers::COMMAND, egui::Key::S);
    wait_for(&mut window, "Use this path");
    let shown = format!("In {}", folder.path().display());
    assert!(window.query_by_label(&shown).is_some());
    window.get_by_label("Path").type_text("light/evening");
    window.run_steps(2);
    let place = folder.path().join("light/evening");
    let says = format!("This is {}", place.display());
    assert!(window.query_by_label(&says).is_some());
    click(&mut window, "Use this path");
    wait_for(&mut window, "Saved");
    assert!(place.with_extension("rekindle").is_file());
}

/// Asks for a turn of `frames` pictures into a folder that was chosen before.
fn export_turn(window: &mut Window, frames: f64, name: &str) {
    key(window, Modifiers::COMMAND, egui::Key::E);
    wait_for(window, "Choose folder…");
    set(window, "Frames", frames);
    let field = window.get_by_role_and_label(egui::Role::TextInput, "Name");
    field.focus();
    window.run_steps(2);
    key(window, Modifiers::COMMAND, egui::Key::A);
    let field = window.get_by_role_and_label(egui::Role::TextInput, "Name");
    field.type_text(name);
    window.run_steps(2);
    click(window, "Export");
}

#[test]
fn exports_wait_in_line_and_a_stop_goes_on_with_the_next() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(&saved_solution(folder.path()));
    key(&mut window, Modifiers::COMMAND, egui::Key::E);
    wait_for(&mut window, "Choose folder…");
    click(&mut window, "A turn around the object");
    set(&mut window, "Width", 120.0);
    set(&mut window, "Height", 90.0);
    click(&mut window, "Animated PNG");
    click(&mut window, "Choose folder…");
    let target = folder.path().join("films");
    give_path(&mut window, &target);
    click(&mut window, "Cancel");
    export_turn(&mut window, 1000.0, "long");
    wait(&mut window, "a second frame", |w| {
        has_part(w, "Exporting long_0002")
    });
    export_turn(&mut window, 2.0, "short");
    export_turn(&mut window, 1000.0, "never");
    // The same name again would replace what is yet to be made: that is asked.
    export_turn(&mut window, 2.0, "short");
    wait(&mut window, "the question", |w| has_part(w, "or will be."));
    click(&mut window, "Keep both");
    click(&mut window, "3 waiting");
    assert!(window.query_by_label("Progress of long").is_some());
    click(&mut window, "Remove never");
    window.check_accessibility();
    window
        .get_all_by_label("Stop")
        .next()
        .expect("the button")
        .click();
    wait(&mut window, "the end of all", |w| w.state().job.is_none());
    let made = files(&target);
    let of = |name: &str| made.iter().filter(|f| f.starts_with(name)).count();
    assert!(
        (2..1000).contains(&of("long_")),
        "finished frames are kept: {made:?}"
    );
    assert_eq!((of("short_"), of("never_")), (4, 0), "{made:?}");

    // All at once.
    export_turn(&mut window, 1000.0, "a");
    export_turn(&mut window, 1000.0, "b");
    click(&mut window, "1 waiting");
    click(&mut window, "Stop all");
    wait(&mut window, "the end of all", |w| w.state().job.is_none());
    assert!(!files(&target).iter().any(|f| f.starts_with("b_")));
}
