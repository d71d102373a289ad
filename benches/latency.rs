//! From an event to its picture, in the window: `cargo bench --bench latency -- [SOLUTION]`.
//!
//! The window is driven without a screen, drawn by whatever graphics adapter there is. Events come at their worst, while the
//! picture of the light before them is still refined, under few lights and under many. A time is from the event until the window's
//! picture that answers it has been drawn and read back. Without a solution the built-in demo is solved first.

#![allow(
    clippy::print_stdout,
    clippy::expect_used,
    reason = "a benchmark prints its figures, and ends where the window fails"
)]

#[path = "../tests/window/driver.rs"]
mod driver;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use eframe::egui::{Pos2, Vec2, vec2};
use egui_kittest::kittest::Queryable as _;
use rekindle::worker::Source;

use driver::{Window, click, drawn, finished, has, wait_for};

/// Size of the window, points.
const SIZE: [f32; 2] = [1440.0, 900.0];
/// Numbers of lights.
const LIGHTS: [usize; 2] = [3, 30];
/// Events of each kind.
const EVENTS: usize = 12;

fn main() {
    // `cargo bench` and `cargo test --benches` pass flags of their own.
    let folder = std::env::args().skip(1).find(|a| !a.starts_with("--"));
    let source = folder.map_or(Source::Demo, |folder| Source::Path(PathBuf::from(folder)));
    let mut window = drawn(SIZE, Some(source));
    wait_for_solution(&mut window);
    finished(&mut window);
    println!(
        "a picture of the window in which nothing changes: {}",
        told(&mut idle(&mut window))
    );
    let mut lights = (1..=LIGHTS[1])
        .take_while(|n| has(&window, &format!("Mute Light {n}")))
        .count();
    for wanted in LIGHTS {
        while lights < wanted {
            click(&mut window, "Add light");
            lights += 1;
        }
        finished(&mut window);
        for (name, times) in [
            ("turning the object", &mut orbit(&mut window)),
            ("dragging a light on the hemisphere", &mut drag(&mut window)),
            ("muting a light", &mut mute(&mut window)),
        ] {
            println!("{lights} lights, {name}: {}", told(times));
        }
    }
}

/// Estimates what was opened unless it is a solution.
fn wait_for_solution(window: &mut Window) {
    driver::wait(window, "capture or solution", |w| {
        has(w, "Findings") || has(w, "Lit hemisphere")
    });
    if has(window, "Findings") {
        window
            .get_all_by_label("Estimate")
            .last()
            .expect("the button")
            .click();
        wait_for(window, "Lit hemisphere");
    }
}

/// The time until the window has answered the events that were given, and its picture has been read back.
fn answered(window: &mut Window) -> Duration {
    let begun = Instant::now();
    window.step();
    window.render().expect("a picture");
    begun.elapsed()
}

fn idle(window: &mut Window) -> Vec<Duration> {
    (0..EVENTS).map(|_| answered(window)).collect()
}

/// Presses at a place and drags from there, in steps of `by`.
fn dragged(window: &mut Window, from: Pos2, by: Vec2) -> Vec<Duration> {
    window.hover_at(from);
    window.step();
    window.drag_at(from);
    window.step();
    let mut times = Vec::new();
    for k in 1..=EVENTS {
        window.hover_at(from + k as f32 * by);
        times.push(answered(window));
    }
    window.drop_at(from + EVENTS as f32 * by);
    window.step();
    times
}

fn orbit(window: &mut Window) -> Vec<Duration> {
    let middle = Pos2::new(0.4 * SIZE[0], 0.3 * SIZE[1]);
    dragged(window, middle, vec2(9.0, 2.0))
}

fn drag(window: &mut Window) -> Vec<Duration> {
    let mark = window.get_by_label("Light 1 on the hemisphere").rect();
    dragged(window, mark.center(), vec2(1.0, 3.0))
}

fn mute(window: &mut Window) -> Vec<Duration> {
    let toggle = |window: &mut Window| {
        window.get_by_label("Mute Light 1").click();
        answered(window)
    };
    (0..EVENTS).map(|_| toggle(window)).collect()
}

/// Times in words.
fn told(times: &mut [Duration]) -> String {
    times.sort();
    let ms = |time: Duration| time.as_secs_f64() * 1e3;
    format!(
        "{:.0} ms (median of {}; at most {:.0} ms)",
        ms(times[times.len() / 2]),
        times.len(),
        ms(times[times.len() - 1])
    )
}
