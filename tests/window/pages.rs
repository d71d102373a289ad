//! The window, driven without a screen by the names that a screen reader reads.

use crate::driver::{
    ON_MESH, capture, click, click_at, coarse, drop_on, has, has_part, mark, misplace, placed,
    point_on_mesh, wait, wait_for, wait_for_iteration, wait_for_part, window,
};
use eframe::egui;
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use rekindle::worker::Source;
use rekindle_capture::Capture;

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
    wait_for(&mut window, "Lights");
    assert!(has_part(&window, "Light 1"), "a lamp was found");
    // Back to any iteration, and two beside each other.
    click(&mut window, "Estimation");
    click(&mut window, "Compare with");
    assert!(
        has_part(&window, "Compared Iteration 1,"),
        "the first beside the last"
    );
    // The curves name the stages, and a click on one goes to the iteration there.
    assert!(has_part(&window, "Splitting lit cells"));
    assert!(has(&window, "Roughness σ, rad") && has(&window, "Profile of σ, rad"));
    click_at(
        &mut window,
        "Curve of Residual, radiance",
        egui::vec2(0.2, 0.5),
    );
    assert!(has_part(&window, "Iteration 1,"), "the first is looked at");
    // The result stays on both pages, and goes to where photograph and rendering differ.
    click(&mut window, "Result: Good");
    assert!(has(&window, "None: all are taken as stated."));
    let view = window.get_by_label_contains("Difference at view 2, ");
    view.click();
    window.step();
    window.step();
    assert!(has(&window, "Lit hemisphere"), "on the page of relighting");
    let kind = window.get_by_label("Difference");
    let chosen = kind.accesskit_node().toggled();
    assert_eq!(chosen, Some(egui::accesskit::Toggled::True));
    click(&mut window, "Close the result");
    click(&mut window, "Estimation");
    // Again with other settings, without reading again, ended early.
    click(&mut window, "Estimate again");
    wait_for_iteration(&mut window, 1);
    click(&mut window, "Stop and keep best");
    wait_for(&mut window, "Lights");
    window.run_ok();
    window.check_accessibility();
}

#[test]
fn runs_are_kept_compared_saved_and_relit() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = window(Some(Source::Path(capture("spot_paper"))));
    wait_for(&mut window, "Findings");
    coarse(&mut window);
    for _ in 0..2 {
        window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Enter);
        window.step();
        wait_for(&mut window, "View 1 hemisphere");
        wait_for(&mut window, "Lit hemisphere");
    }
    click(&mut window, "Mute Light 1");
    click(&mut window, "Estimation");
    click(&mut window, "Run 2 of 2");
    assert!(has_part(&window, "Fast, lobe: Whichever fits"));
    click(&mut window, "Curves of Run 1");
    assert!(has(&window, "— Run 1"), "it is drawn over the other");
    window.check_accessibility();
    click(&mut window, "Run 1");
    assert!(has(&window, "Run 1 of 2"));
    window.key_press(egui::Key::Escape);
    window.run_steps(3);
    // Hemispheres of both, beside each other.
    click(&mut window, "Compare with");
    click(&mut window, "Compared run");
    let second = window.get_all_by_label("Run 2").last();
    second.expect("the choice").click();
    window.run_steps(3);
    assert!(has_part(&window, "Compared Run 2: Iteration 1,"));
    for (name, part) in [
        ("curves.csv", "run,iteration,elapsed_s,stage"),
        ("curves.svg", "Roughness σ, rad"),
    ] {
        click(&mut window, "Save curves…");
        wait_for(&mut window, "Use this path");
        let path = folder.path().join(name);
        let field = window.get_by_label("Path");
        field.type_text(&path.display().to_string());
        window.run_steps(2);
        click(&mut window, "Use this path");
        wait(&mut window, name, |_| path.exists());
        let text = std::fs::read_to_string(&path).expect("the curves");
        assert!(text.contains(part), "{text}");
        assert!(name != "curves.csv" || text.lines().any(|l| l.starts_with("2,")));
    }
    // Edits of the other run's light are not lost without a question.
    click(&mut window, "Relight");
    wait_for(&mut window, "Save the changes?");
    click(&mut window, "Don't save");
    wait_for(&mut window, "Lit hemisphere");
    window.run_steps(3);
    assert!(!has(&window, "Setup 1"), "as it was estimated");
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
    // What a fault is told with.
    click(&mut window, "Help");
    click(&mut window, "About rekindle");
    assert!(has(&window, env!("CARGO_PKG_VERSION")));
    assert!(has(&window, "Graphics adapter"));
    window.check_accessibility();
    click(&mut window, "Close");
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
        let stop = window.get_all_by_label("Stop").next();
        stop.expect("a button that stops").click();
        window.step();
        wait_for(&mut window, "Estimate again");
        assert!(!has(&window, "Lights"), "nothing is kept of {stage}");
    }
    // A key pressed by chance ends the estimation with what it has reached.
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Enter);
    window.step();
    wait_for_iteration(&mut window, 1);
    window.key_press(egui::Key::Escape);
    window.step();
    wait_for(&mut window, "Lights");
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Enter);
    window.step();
    wait_for_iteration(&mut window, 1);
    // Closing stops the threads and waits for them.
    drop(window);
}

#[test]
fn a_mesh_that_lies_elsewhere_is_aligned_by_points_undone_and_saved() {
    let folder = tempfile::tempdir().expect("a folder");
    let other = capture("spot_paper");
    misplace(folder.path());
    let (capture, _) = Capture::load_unplaced(folder.path()).expect("a capture");
    let mut window = window(Some(Source::Path(folder.path().to_owned())));
    wait_for(&mut window, "The mesh is not where the photographs show it");
    assert!(has(&window, "No camera sees the mesh."));
    // From nothing, stopped before its end.
    click(&mut window, "Align");
    wait_for_part(&mut window, "Aligning, ");
    window.key_press(egui::Key::Escape);
    window.step();
    wait_for(&mut window, "Alignment stopped");
    click(&mut window, "Align by points…");
    wait_for_part(&mut window, "No point is marked");
    wait_for(&mut window, "Picture of the mesh");
    for (point, [x, y]) in ON_MESH.into_iter().enumerate() {
        click_at(&mut window, "Picture of the mesh", egui::vec2(x, y));
        let place = point_on_mesh(&window, point + 1);
        for view in [0, 1 + point] {
            mark(&mut window, &capture, view, place);
        }
    }
    wait_for_part(&mut window, "The marks fit within 0.");
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Z);
    wait(&mut window, "undone mark", |w| {
        !has(w, "Mark of point 3 in photograph 4")
    });
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Y);
    wait_for(&mut window, "Mark of point 3 in photograph 4");
    wait_for_part(&mut window, "The marks fit within 0.");
    window.run_ok();
    window.check_accessibility();
    click(&mut window, "Align the mesh");
    wait_for(&mut window, "Aligned");
    assert!(has_part(&window, "Silhouettes overlap by 9"));
    assert!(has(&window, "Findings"), "back on the capture's page");
    // Undone, done again, saved where it was done.
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Z);
    wait_for(&mut window, "No camera sees the mesh.");
    window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Y);
    wait_for(&mut window, "Aligned");
    // Something else is not opened before the place is dealt with.
    drop_on(&mut window, &other);
    wait_for(&mut window, "Save the changes?");
    assert!(has_part(&window, "The mesh's place has changes"));
    click(&mut window, "Cancel");
    wait(&mut window, "end of the question", |w| {
        !has(w, "Save the changes?")
    });
    assert!(has(&window, "Save in the capture") && !has(&window, "spot_paper"));
    drop_on(&mut window, &other);
    wait_for(&mut window, "Save the changes?");
    click(&mut window, "Save");
    wait_for(&mut window, "Saved");
    wait_for(&mut window, "spot_paper");
    drop(window);
    let aligned = Capture::load(folder.path()).expect("seen now");
    let moved = aligned.mesh.positions.iter().zip(&capture.mesh.positions);
    let off = moved.map(|(now, before)| {
        let right = placed(before.to_array().map(f64::from));
        now.as_dvec3().distance(right)
    });
    let off = off.fold(0.0, f64::max);
    assert!(off < 0.004 * f64::from(aligned.mesh.diagonal()), "{off}");
}

#[test]
fn a_known_light_is_chosen_turned_and_said_in_the_result() {
    let capture = capture("spot_paper");
    let mut window = window(Some(Source::Path(capture.clone())));
    wait_for(&mut window, "Findings");
    coarse(&mut window);
    let choose = |window: &mut crate::driver::Window, path: &std::path::Path| {
        click(window, "Known light…");
        wait_for(window, "Use this path");
        let path = path.display().to_string();
        window.get_by_label("Path").type_text(&path);
        window.run_steps(2);
        click(window, "Use this path");
    };
    // What is no light probe is a message, and the light is still to be estimated.
    choose(&mut window, &capture.join("images/view_000.exr"));
    wait_for(&mut window, "The light's picture can't be used");
    assert!(!has(&window, "By hand"));
    choose(&mut window, &capture.join("truth/environment.exr"));
    wait_for(&mut window, "environment.exr");
    click(&mut window, "By hand");
    let turn = window.get_by_role_and_label(egui::Role::Slider, "Turn of the known light");
    turn.set_value_accesskit(270.0);
    window.run_steps(2);
    // Each choice is a step that can be undone.
    let turned = |window: &crate::driver::Window| {
        let turn = window.query_by_role_and_label(egui::Role::Slider, "Turn of the known light");
        turn.and_then(|turn| turn.accesskit_node().numeric_value())
    };
    let mut seen = vec![turned(&window)];
    for _ in 0..3 {
        window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Z);
        window.run_steps(2);
        seen.push(turned(&window));
    }
    assert!(!has(&window, "environment.exr"), "the picture is undone");
    assert_ne!(seen[0], seen[1], "the turn is undone");
    assert!(seen[1].is_some() && seen[2].is_none(), "{seen:?}");
    for _ in 0..3 {
        window.key_press_modifiers(egui::Modifiers::COMMAND, egui::Key::Y);
        window.run_steps(2);
    }
    assert_eq!(turned(&window), seen[0]);
    let buttons = window.get_all_by_label("Estimate");
    buttons.last().expect("the button").click();
    window.step();
    wait_for_part(&mut window, "Close message Estimated");
    // The card is open where there are doubts.
    if has_part(&window, "Result: ") {
        window.get_by_label_contains("Result: ").click();
        window.run_steps(2);
    }
    assert!(has_part(
        &window,
        "Given by environment.exr, turned by 270.0° as stated"
    ));
    // Back to an estimate.
    click(&mut window, "Capture");
    click(&mut window, "Estimate it");
    assert!(!has(&window, "environment.exr"));
}

#[test]
fn the_guide_is_opened_from_the_welcome_page_and_closed() {
    let mut window = window(None);
    window.step();
    click(&mut window, "What a capture needs");
    assert!(has(&window, "How to shoot a capture") && has(&window, "The turntable"));
    assert!(has(&window, "Where cameras stand"), "a drawing");
    // It takes a few frames to find its place.
    window.run_steps(12);
    click(&mut window, "Close");
    window.run_steps(2);
    assert!(!has(&window, "The turntable"));
}

#[test]
fn a_roughness_is_stated_beside_the_result_and_left_open_again() {
    let capture = capture("spot_paper");
    let mut window = window(Some(Source::Path(capture)));
    wait_for(&mut window, "Findings");
    coarse(&mut window);
    let buttons = window.get_all_by_label("Estimate");
    buttons.last().expect("the button").click();
    window.step();
    wait_for_part(&mut window, "Result: ");
    window.get_by_label_contains("Result: ").click();
    window.run_steps(2);
    assert!(!has(&window, "Estimate with this"), "nothing is stated yet");
    let slider = |window: &crate::driver::Window| {
        let slider = window.get_by_role_and_label(egui::Role::Slider, "Roughness");
        slider.accesskit_node().numeric_value()
    };
    let found = slider(&window);
    let roughness = window.get_by_role_and_label(egui::Role::Slider, "Roughness");
    roughness.set_value_accesskit(0.42);
    window.run_steps(2);
    click(&mut window, "Estimate with this");
    wait_for_part(&mut window, "roughness 0.42");
    click(&mut window, "Estimation");
    assert!(has(&window, "Run 2 of 2"), "the first run is kept");
    assert!(
        !has_part(&window, "± "),
        "a stated roughness has no interval"
    );
    // Below the fold, as this run has more to be told.
    window.get_by_label("Leave it open").click_accesskit();
    window.run_steps(2);
    assert!(!has(&window, "Estimate with this"));
    assert!(
        slider(&window) > found,
        "the slider shows what this run has"
    );
}
