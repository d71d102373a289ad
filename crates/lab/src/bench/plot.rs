//! Plots of error against elapsed time: one curve a method.

use std::io;

use super::chart::{self, Axis, Curve, Dot, Panel};
use super::measures::Errors;
use super::name;
use super::record::Run;

/// Width and height of a panel.
const SIZE: [u32; 2] = [480, 320];
/// Errors below this are drawn at it: a logarithm has no zero.
const FLOOR: f64 = 1e-5;

/// What a panel shows: its caption and the error.
type Shown = (&'static str, fn(&Errors) -> Option<f64>);

const SHOWN: [Shown; 4] = [
    ("roughness, relative error", |e| e.sigma.map(f64::abs)),
    ("direction of the worst lamp, degrees", |e| e.direction_deg),
    ("flux of the worst lamp, relative error", |e| e.flux),
    ("hemisphere, relative error", |e| e.hemisphere),
];

/// A picture of all `runs`, of one capture.
pub(super) fn plot(runs: &[&Run]) -> io::Result<String> {
    let panels = SHOWN.map(|(caption, error)| Panel {
        caption: caption.to_owned(),
        x: Axis::Decades("seconds".to_owned()),
        y: Axis::Decades(String::new()),
        curves: curves(runs, error),
    });
    chart::draw(&panels, 2, SIZE)
}

fn curves(runs: &[&Run], error: fn(&Errors) -> Option<f64>) -> Vec<Curve> {
    runs.iter()
        .map(|run| Curve {
            name: name(run.method).to_owned(),
            points: run
                .steps
                .iter()
                .filter_map(|step| {
                    let error = error(&step.errors).filter(|e| e.is_finite())?;
                    Some(Dot::new(step.iteration.elapsed_s, error.max(FLOOR)))
                })
                .collect(),
        })
        .collect()
}
