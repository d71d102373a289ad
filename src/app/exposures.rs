//! What became of a capture's brackets: the camera's response, and which exposure tells of which radiance.

use eframe::egui::{self, Color32, RichText};
use egui_plot::{HoverPosition, Line, LineStyle, Plot, PlotPoints};

use super::plots::place;
use super::theme;
use rekindle_capture::{Brackets, KNOTS, Origin};

/// Height of a plot, points.
const HEIGHT: f32 = 104.0;
/// Stops below full scale that the response is shown for.
const STOPS: f64 = 11.0;
/// Points of a curve of weights.
const POINTS: usize = 160;

/// Shows the brackets of a capture.
pub(super) fn show(ui: &mut egui::Ui, brackets: &Brackets) {
    theme::group(ui, "Exposures");
    let response = &brackets.response;
    let (what, tip) = match response.origin {
        Origin::Srgb => (
            "Response: sRGB",
            "The exposures agree with sRGB's curve, which 8-bit files are taken to have",
        ),
        Origin::Linear => (
            "Response: linear",
            "The exposures agree that the files are linear, as raw and 16-bit files are taken to be",
        ),
        Origin::Recovered => (
            "Response: recovered",
            "The exposures contradict the curve that such files are taken to have (dashed); this one explains them",
        ),
        Origin::RecoveredPerChannel => (
            "Response: recovered for each channel",
            "The exposures contradict the curve that such files are taken to have (dashed), and each channel has its own",
        ),
    };
    title(ui, what, tip);
    response_plot(ui, brackets);
    if let Some(left) = response.disagreement {
        ui.weak(format!("Exposures agree within {:.1} %", 100.0 * left))
            .on_hover_text(match response.disagreement_assumed {
                Some(before) if !response.is_assumed() => format!(
                    "Root mean square difference of the radiance that exposures of one point measure; under the usual curve it is {:.1} %",
                    100.0 * before
                ),
                _ => "Root mean square difference of the radiance that exposures of one point measure".to_owned(),
            });
    }
    ui.add_space(6.0);
    title(
        ui,
        "Weight of each exposure",
        "Which exposure a pixel's radiance comes from: its share of the weights, which are the inverse variances, from the darkest pixels to the brightest",
    );
    weights_plot(ui, brackets);
}

fn title(ui: &mut egui::Ui, text: &str, tip: &str) {
    ui.label(RichText::new(text).small().strong())
        .on_hover_text(tip);
}

fn base<'a>(name: &str) -> Plot<'a> {
    Plot::new(name)
        .height(HEIGHT)
        .allow_scroll(false)
        .allow_zoom(false)
        .allow_drag(false)
        .allow_boxed_zoom(false)
        .show_background(false)
        .y_axis_min_width(28.0)
}

/// Stops below full scale against the code.
fn response_plot(ui: &mut egui::Ui, brackets: &Brackets) {
    let palette = theme::palette(ui);
    let response = &brackets.response;
    let points = |exposure: &dyn Fn(usize) -> f32| -> Vec<[f64; 2]> {
        let full = f64::from(exposure(KNOTS - 1));
        (1..KNOTS)
            .map(|k| [k as f64, (f64::from(exposure(k)) / full).log2()])
            .filter(|[_, stops]| *stops >= -STOPS)
            .collect()
    };
    let colours: &[(usize, &str, Color32)] = if response.origin == Origin::RecoveredPerChannel {
        &[
            (0, "Red", Color32::from_rgb(222, 92, 82)),
            (1, "Green", Color32::from_rgb(104, 176, 104)),
            (2, "Blue", Color32::from_rgb(98, 146, 226)),
        ]
    } else {
        &[(1, "Response", palette.accent)]
    };
    base("response")
        .include_x(0.0)
        .include_x(255.0)
        .include_y(-STOPS)
        .include_y(0.0)
        .label_formatter(|position| {
            let at = place(position);
            Some(format!(
                "Code {:.0}\n{:.2} stops below full scale",
                at.x, -at.y
            ))
        })
        .show(ui, |plot| {
            if !response.is_assumed() {
                let usual = response.usual();
                let line = Line::new("Usual", PlotPoints::from(points(&|k| usual[k])));
                plot.line(
                    line.color(palette.weak)
                        .width(1.0)
                        .style(LineStyle::dashed_dense()),
                );
            }
            for &(channel, name, colour) in colours {
                let curve = points(&|k| response.curves[channel][k]);
                plot.line(
                    Line::new(name, PlotPoints::from(curve))
                        .color(colour)
                        .width(1.8),
                );
            }
        });
}

/// The share of each exposure of the first view against the radiance, in stops below the brightest that it holds.
fn weights_plot(ui: &mut egui::Ui, brackets: &Brackets) {
    let palette = theme::palette(ui);
    let Some(view) = brackets.views.iter().find(|view| !view.is_empty()) else {
        return;
    };
    let shortest = view.last().map_or(1.0, |exposure| exposure.amount);
    let longest = view.first().map_or(1.0, |exposure| exposure.amount);
    let depth = (longest / shortest).log2() + 6.0;
    let brightest = brackets.full_scale() / shortest;
    let shares: Vec<(f64, Vec<f64>)> = (0..POINTS)
        .map(|i| {
            let stops = -depth * (1.0 - (i as f64 + 0.5) / POINTS as f64);
            (stops, brackets.shares(view, brightest * stops.exp2()))
        })
        .collect();
    base("weights")
        .include_y(0.0)
        .include_y(1.0)
        .label_formatter(|position| {
            let at = place(position);
            let name = match position {
                HoverPosition::NearDataPoint { plot_name, .. } => format!("{plot_name}\n"),
                HoverPosition::Elsewhere { .. } => String::new(),
            };
            Some(format!(
                "{name}{:.0} % at {:.1} stops below the brightest",
                100.0 * at.y,
                -at.x
            ))
        })
        .show(ui, |plot| {
            for (k, exposure) in view.iter().enumerate() {
                let part = k as f32 / (view.len().max(2) - 1) as f32;
                let colour = mixed(palette.curves[1], palette.accent, part);
                let points: Vec<[f64; 2]> = shares.iter().map(|(at, all)| [*at, all[k]]).collect();
                let line = Line::new(exposure.file.clone(), PlotPoints::from(points));
                plot.line(line.color(colour).width(1.6).fill(0.0).fill_alpha(0.14));
            }
        });
    for (k, exposure) in view.iter().enumerate() {
        let part = k as f32 / (view.len().max(2) - 1) as f32;
        let colour = mixed(palette.curves[1], palette.accent, part);
        ui.horizontal(|ui| {
            let (rect, _) = ui.allocate_exact_size(egui::vec2(10.0, 10.0), egui::Sense::hover());
            ui.painter().rect_filled(rect, 3.0, colour);
            ui.label(RichText::new(&exposure.file).small());
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                ui.weak(RichText::new(format!("{:.0} %", 100.0 * exposure.weight)).small());
            });
        })
        .response
        .on_hover_text(format!(
            "Relative exposure {:.4}: {:.0} % of the first view's weights, {:.1} % of its pixels clipped",
            exposure.amount,
            100.0 * exposure.weight,
            100.0 * exposure.clipped
        ));
    }
}

/// A colour between two.
fn mixed(a: Color32, b: Color32, part: f32) -> Color32 {
    let channel =
        |a: u8, b: u8| (f32::from(a) + part * (f32::from(b) - f32::from(a))).round() as u8;
    Color32::from_rgb(
        channel(a.r(), b.r()),
        channel(a.g(), b.g()),
        channel(a.b(), b.b()),
    )
}
