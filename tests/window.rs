//! The window, driven without a screen by the names that a screen reader reads.

mod driver;

use driver::{
    capture, click, coarse, drop_on, has, has_part, wait_for, wait_for_iteration, wait_for_part,
    window,
};
use eframe::egui;
use egui_kittest::kittest::Queryable as _;
use rekindle::worker::Source;

#[test]
fn the_demo_is_opened_estimated_paused_and_relit() {
    let mut window = window(None);
    window.step();
    assert!(has(&window, "Open capture…") && has(&window, "Open project…"));
    click(&mut window, "Try the demo");
    wait_for(&mut window, "Findings");
    assert!(has_part(&window, "View images/view_005.exr"), "six views");
    coarse(&mut window);
    window
        .get_all_by_label("Estimate")
        .last()
        .expect("the button")
        .click();
    window.step();
    wait_for(&mut window, "View 1 hemisphere");
    wait_for(&mut window, "Initial hemisphere");
    wait_for_iteration(&mut window, 2);
    click(&mut window, "Pause");
    wait_for_part(&mut window, "Paused while");
    click(&mut window, "Resume");
    wait_for(&mut window, "Viewport");
    wait_for(&mut window, "Lamps");
    assert!(has_part(&window, "Light 1"), "a lamp was found");
    // Back to any iteration, and two beside each other.
    click(&mut window, "Estimation");
    click(&mut window, "Compare with");
    assert!(
        has_part(&window, "Compared Iteration 1,"),
        "the first beside the last"
    );
    // Again with other settings, without reading again, ended early.
    click(&mut window, "Estimate again");
    wait_for_iteration(&mut window, 1);
    click(&mut window, "Stop and keep best");
    wait_for(&mut window, "Lamps");
    window.run_ok();
    window.check_accessibility();
}

#[test]
fn a_broken_capture_is_a_message_and_leaves_what_is_open() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("transforms.json"), "{ \"frames\": [").expect("written");
    let mut window = window(Some(Source::Path(capture("spot_paper"))));
    wait_for(&mut window, "Findings");
    drop_on(&mut window, folder.path());
    wait_for(&mut window, "Opening failed");
    assert!(has_part(&window, "transforms.json"), "it names the file");
    assert!(
        has(&window, "spot_paper") && has(&window, "Findings"),
        "still open"
    );
    click(&mut window, "Close message Opening failed");
    assert!(!has(&window, "Opening failed"));
    let missing = folder.path().join("nowhere");
    drop_on(&mut window, &missing);
    wait_for(&mut window, "Opening failed");
    assert!(has_part(&window, "nowhere") && has(&window, "spot_paper"));
}

#[test]
fn a_solve_is_stopped_in_every_stage_and_the_window_closed_in_one() {
    let mut window = window(Some(Source::Path(capture("spot_paper"))));
    wait_for(&mut window, "Findings");
    coarse(&mut window);
    for stage in [
        "Finding what each view sees",
        "Collecting highlights",
        "Comparing roughnesses",
        "Splitting lit cells",
        "Reconstructing the texture",
        "Separating texture and shading",
    ] {
        window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Enter);
        window.step();
        wait_for_part(&mut window, stage);
        window.key_press(egui::Key::Escape);
        window.step();
        wait_for(&mut window, "Estimate again");
        assert!(!has(&window, "Lamps"), "nothing is kept of {stage}");
    }
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Enter);
    window.step();
    wait_for_iteration(&mut window, 1);
    // Closing stops the threads and waits for them.
    drop(window);
}
