//! Every page at the sizes that people have: nothing that can be pressed is cut off by the window or lies over something else.

use crate::driver::{Window, click, coarse, has, wait_for, window_of};
use eframe::egui;
use egui_kittest::kittest::{NodeT as _, Queryable as _};

/// Sizes in points: a small laptop, a common one, a large screen, and the same at twice the scale.
const SIZES: [[f32; 2]; 4] = [
    [1024.0, 640.0],
    [1280.0, 800.0],
    [2560.0, 1440.0],
    [1280.0, 720.0],
];

/// Points by which frames may lie over each other.
const TOUCH: f32 = 1.5;

/// Everything that can be pressed, with its name, but for marks of lights, which lie where the lights are, and what scrolls.
fn pressable(window: &Window) -> Vec<(String, egui::Rect)> {
    let roles = [
        egui::Role::Button,
        egui::Role::CheckBox,
        egui::Role::ComboBox,
        egui::Role::SpinButton,
        egui::Role::TextInput,
    ];
    let of = |role| window.query_all_by_role(role);
    let nodes = roles.into_iter().flat_map(of);
    let named = nodes.map(|node| {
        let name = node.accesskit_node().label().unwrap_or_default();
        (name, node.rect())
    });
    named
        .filter(|(name, _)| {
            let mark = name.ends_with(" handle") || name.ends_with(" on the hemisphere");
            let scrolls = name.starts_with("Difference at view") || name.starts_with("View ");
            !mark && !scrolls
        })
        .collect()
}

fn check(window: &Window, page: &str, [width, height]: [f32; 2]) {
    let whole = egui::Rect::from_min_size(egui::Pos2::ZERO, egui::vec2(width, height));
    let all = pressable(window);
    assert!(all.len() > 5, "{page}: {all:?}");
    for (i, (name, rect)) in all.iter().enumerate() {
        assert!(
            whole.expand(TOUCH).contains_rect(*rect),
            "{page} at {width}×{height}: {name} is cut: {rect}"
        );
        for (other, beside) in &all[i + 1..] {
            let shared = rect.intersect(*beside);
            let apart = shared.width() < TOUCH || shared.height() < TOUCH;
            assert!(
                apart || rect == beside,
                "{page} at {width}×{height}: {name} and {other} lie over each other: {rect}, {beside}"
            );
        }
    }
}

#[test]
fn nothing_is_cut_or_covered_at_any_size() {
    for size in SIZES {
        let mut window = window_of(size, None);
        window.step();
        check(&window, "Welcome", size);
        click(&mut window, "Try the demo");
        wait_for(&mut window, "Findings");
        window.run_steps(3);
        check(&window, "Capture", size);
        coarse(&mut window);
        let estimate = window.get_all_by_label("Estimate").last();
        estimate.expect("the button").click();
        wait_for(&mut window, "Lit hemisphere");
        wait_for(&mut window, "Close message Estimated");
        click(&mut window, "Close message Estimated");
        window.run_steps(3);
        check(&window, "Relighting", size);
        click(&mut window, "Light 1");
        window.run_steps(3);
        assert!(has(&window, "Reset light"));
        check(&window, "Relighting, a light selected", size);
        click(&mut window, "Result: Good");
        window.run_steps(3);
        check(&window, "Relighting with the result", size);
        window.key_press(egui::Key::Num1);
        window.run_steps(3);
        check(&window, "Relighting at a camera", size);
        click(&mut window, "Estimation");
        window.run_steps(3);
        check(&window, "Estimation with the result", size);
        click(&mut window, "Close the result");
        click(&mut window, "Compare with");
        window.run_steps(3);
        check(&window, "Estimation", size);
    }
}
