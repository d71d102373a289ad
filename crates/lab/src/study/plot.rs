//! Plots of a study: errors with their intervals, seconds and bytes against what was swept.

use std::io;

use super::outcome::{Found, Outcome, STAGES};
use super::{Section, Studied};
use crate::bench::{Axis, Curve, Dot, Panel, draw, mebibytes};

/// Width and height of a panel, and how many are in a row.
const SIZE: [u32; 2] = [400, 260];
const COLUMNS: usize = 3;
/// Limits of what is drawn of errors of σ, percent.
const LEAST_SIGMA: f64 = 0.5;
const MOST_SIGMA: f64 = 10.0;
/// Errors below this, percent or degrees, are drawn at it: a logarithm has no zero.
const FLOOR: f64 = 1e-3;

/// The plots of a section: file names, captions, pictures.
pub(super) fn plots(
    section: Section,
    studied: &[Studied],
) -> io::Result<Vec<(String, &'static str, String)>> {
    let plots: Vec<(&str, &str, Vec<Panel>)> = match section {
        Section::Stability => vec![
            (
                "sigma",
                "Error of σ in percent, with its 95 % interval",
                studied.iter().map(sigma).collect(),
            ),
            (
                "lamps",
                "Direction and flux of the worst lamp",
                studied.iter().map(lamps).collect(),
            ),
        ],
        Section::Scaling => {
            let numbers = || studied.iter().filter_map(|s| Some((s, values(s)?)));
            vec![
                (
                    "seconds",
                    "Seconds",
                    numbers().map(|(s, v)| seconds(s, v)).collect(),
                ),
                (
                    "memory",
                    "Most memory held, MiB",
                    numbers().map(|(s, v)| memory(s, v)).collect(),
                ),
            ]
        }
        Section::Coverage | Section::Skipping => Vec::new(),
    };
    plots
        .into_iter()
        .filter(|(_, _, panels)| !panels.is_empty())
        .map(|(name, caption, panels)| {
            let file = format!("{}_{name}.svg", section.name());
            Ok((file, caption, draw(&panels, COLUMNS, SIZE)?))
        })
        .collect()
}

/// Swept numbers of a group of more than one.
fn values(studied: &Studied) -> Option<Vec<f64>> {
    let values = studied.group.cases.iter().map(|case| case.value);
    let values = values.collect::<Option<Vec<f64>>>()?;
    (values.len() > 1).then_some(values)
}

/// Swept values side by side, those without a result in brackets.
fn places(studied: &Studied) -> Axis {
    let names = studied.group.cases.iter().zip(&studied.outcomes);
    let names = names.map(|(case, outcome)| match outcome {
        Outcome::Solved(_) => case.label.clone(),
        Outcome::Refused(_) | Outcome::Failed(_) => format!("({})", case.label),
    });
    Axis::Places(studied.group.swept.to_owned(), names.collect())
}

/// What was found, with its place.
fn found(studied: &Studied) -> impl Iterator<Item = (usize, &Found)> {
    let outcomes = studied.outcomes.iter().enumerate();
    outcomes.filter_map(|(place, outcome)| Some((place, outcome.found()?)))
}

fn sigma(studied: &Studied) -> Panel {
    let dots = found(studied).filter_map(|(place, found)| {
        Some(Dot {
            x: place as f64,
            y: 100.0 * found.errors.sigma?,
            interval: found.interval.map(|ends| ends.map(|end| 100.0 * end)),
        })
    });
    let points: Vec<Dot> = dots.collect();
    let most = points.iter().map(|p| p.y.abs()).fold(0.0, f64::max);
    Panel {
        caption: studied.group.name.replace('_', " "),
        x: places(studied),
        y: Axis::AroundZero(
            "σ, percent".to_owned(),
            (1.5 * most).clamp(LEAST_SIGMA, MOST_SIGMA),
        ),
        curves: vec![Curve {
            name: String::new(),
            points,
        }],
    }
}

fn lamps(studied: &Studied) -> Panel {
    let curve = |name: &str, error: &dyn Fn(&Found) -> Option<f64>| Curve {
        name: name.to_owned(),
        points: found(studied)
            .filter_map(|(place, found)| Some(Dot::new(place as f64, error(found)?.max(FLOOR))))
            .collect(),
    };
    Panel {
        caption: studied.group.name.replace('_', " "),
        x: places(studied),
        y: Axis::Decades(String::new()),
        curves: vec![
            curve("direction, degrees", &|f| f.errors.direction_deg),
            curve("flux, percent", &|f| f.errors.flux.map(|e| 100.0 * e)),
        ],
    }
}

fn seconds(studied: &Studied, values: Vec<f64>) -> Panel {
    let curve = |name: &str, seconds: &dyn Fn(&Found) -> Option<f64>| Curve {
        name: name.to_owned(),
        points: found(studied)
            .filter_map(|(place, found)| Some(Dot::new(values[place], seconds(found)?)))
            .collect(),
    };
    let stage = |name: &'static str| {
        let at = STAGES.iter().position(|stage| *stage == name);
        move |found: &Found| found.cost.stages[at?]
    };
    let curves = vec![
        curve("all", &|f| Some(f.cost.total)),
        curve("estimate", &stage("estimate")),
        curve("texture", &stage("texture")),
        curve("reading", &stage("load")),
        curve("least: read and add up", &|f| f.cost.floor),
    ];
    Panel {
        caption: format!("seconds against {}", studied.group.swept),
        x: Axis::Values(studied.group.swept.to_owned(), values),
        y: Axis::Decades("seconds".to_owned()),
        curves,
    }
}

fn memory(studied: &Studied, values: Vec<f64>) -> Panel {
    let points = found(studied).filter_map(|(place, found)| {
        Some(Dot::new(values[place], mebibytes(found.cost.peak_bytes)?))
    });
    let points = points.collect();
    Panel {
        caption: format!("memory against {}", studied.group.swept),
        x: Axis::Values(studied.group.swept.to_owned(), values),
        y: Axis::Decades("MiB".to_owned()),
        curves: vec![Curve {
            name: String::new(),
            points,
        }],
    }
}
