//! The window, driven without a screen by the names that a screen reader reads.

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

type Window = Harness<'static, App>;

fn window(open: Option<Source>) -> Window {
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

fn capture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/captures")
        .join(name)
}

/// Draws until `there` holds.
fn wait(window: &mut Window, what: &str, there: impl Fn(&Window) -> bool) {
    let since = Instant::now();
    while !there(window) {
        assert!(since.elapsed() < PATIENCE, "no {what}");
        std::thread::sleep(Duration::from_millis(5));
        window.step();
    }
}

fn wait_for(window: &mut Window, label: &str) {
    wait(window, label, |w| has(w, label));
}

fn wait_for_part(window: &mut Window, part: &str) {
    wait(window, part, |w| {
        w.query_all_by_label_contains(part).next().is_some()
    });
}

fn has(window: &Window, label: &str) -> bool {
    window.query_all_by_label(label).next().is_some()
}

fn has_part(window: &Window, part: &str) -> bool {
    window.query_all_by_label_contains(part).next().is_some()
}

fn click(window: &mut Window, label: &str) {
    window.get_by_label(label).click();
    window.step();
    window.step();
}

fn coarse(window: &mut Window) {
    window.get_by_label("Frequency").set_value_accesskit(24.0);
    window.step();
    window.step();
}

/// Drops a file or folder on the window.
fn drop_on(window: &mut Window, path: &Path) {
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
    wait_for_part(&mut window, "Iteration 2,");
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
    wait_for_part(&mut window, "Iteration 1,");
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
    wait_for_part(&mut window, "Iteration 1,");
    // Closing stops the threads and waits for them.
    drop(window);
}
