//! Plots of error against elapsed time, as SVG: one curve a method.

use std::io;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::measures::Errors;
use super::name;
use super::record::Run;

/// Width and height of a plot.
const SIZE: (u32, u32) = (960, 640);
/// Errors below this are drawn at it: a logarithm has no zero.
const FLOOR: f64 = 1e-5;
/// Of the methods, in turn; told apart also by those who see fewer colours (Okabe and Ito 2008).
const COLOURS: [RGBColor; 4] = [
    RGBColor(0, 114, 178),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
];

/// What a panel shows: its caption and the error.
type Panel = (&'static str, fn(&Errors) -> Option<f64>);

const PANELS: [Panel; 4] = [
    ("roughness, relative error", |e| e.sigma.map(f64::abs)),
    ("direction of the worst lamp, degrees", |e| e.direction_deg),
    ("flux of the worst lamp, relative error", |e| e.flux),
    ("hemisphere, relative error", |e| e.hemisphere),
];

/// One method's points: seconds and error.
struct Curve {
    name: &'static str,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
}

/// A picture of all `runs`, of one capture.
pub(super) fn plot(runs: &[&Run]) -> io::Result<String> {
    let mut svg = String::new();
    draw(&mut svg, runs).map_err(|error| io::Error::other(error.to_string()))?;
    Ok(svg)
}

type Drawn = Result<(), DrawingAreaErrorKind<io::Error>>;

fn draw(svg: &mut String, runs: &[&Run]) -> Drawn {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, panel) in root.split_evenly((2, 2)).iter().zip(PANELS) {
        draw_panel(area, panel.0, &curves(runs, panel.1))?;
    }
    root.present()
}

fn curves(runs: &[&Run], error: fn(&Errors) -> Option<f64>) -> Vec<Curve> {
    runs.iter()
        .enumerate()
        .map(|(i, run)| Curve {
            name: name(run.method),
            colour: COLOURS[i % COLOURS.len()],
            points: run
                .steps
                .iter()
                .filter_map(|step| {
                    let error = error(&step.errors).filter(|e| e.is_finite())?;
                    Some((step.iteration.elapsed_s, error.max(FLOOR)))
                })
                .collect(),
        })
        .collect()
}

fn draw_panel(area: &DrawingArea<SVGBackend<'_>, Shift>, caption: &str, curves: &[Curve]) -> Drawn {
    let points = || curves.iter().flat_map(|curve| &curve.points);
    // Whole powers of ten, so that the labels are such.
    let decades = |of: fn(&(f64, f64)) -> f64| {
        let lowest = points().map(of).fold(f64::INFINITY, f64::min);
        let highest = points().map(of).fold(lowest, f64::max);
        let lowest = if lowest > 0.0 && lowest.is_finite() {
            lowest
        } else {
            0.1
        };
        let from = lowest.log10().floor() as i32;
        let to = highest.max(lowest).log10().ceil() as i32;
        10.0_f64.powi(from)..10.0_f64.powi(to.max(from + 1))
    };
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 16))
        .margin(8)
        .x_label_area_size(34)
        .y_label_area_size(58)
        .build_cartesian_2d(decades(|p| p.0).log_scale(), decades(|p| p.1).log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .x_desc("seconds")
        .x_labels(6)
        .x_label_formatter(&|v| format!("{v}"))
        .y_labels(6)
        .y_label_formatter(&|v| format!("{v:.0e}"))
        .draw()?;
    for curve in curves {
        let style = curve.colour.stroke_width(2);
        chart
            .draw_series(LineSeries::new(curve.points.iter().copied(), style))?
            .label(curve.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .draw()
}
