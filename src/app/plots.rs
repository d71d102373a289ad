//! The curves of an estimation: objective, residual and σ against time, and the profile of σ.

use eframe::egui::{self, RichText};
use egui_plot::{HoverPosition, Line, LineStyle, Plot, PlotPoint, PlotPoints, Points, Span, VLine};

use super::theme;
use crate::worker::Tried;
use rekindle_estimate::estimate::Iteration;
use rekindle_scene::reflectance::SpecularModel;

/// What the plots mark.
#[derive(Clone, Copy, Default)]
pub struct Marks {
    /// The iteration that is looked at.
    pub shown: Option<Iteration>,
    /// The one that it is compared with.
    pub other: Option<Iteration>,
    /// 95 % interval of σ, once it is known.
    pub interval: Option<[f32; 2]>,
}

/// Shows the plots beside each other.
pub fn show(ui: &mut egui::Ui, iterations: &[Iteration], tried: &[Tried], marks: Marks) {
    let height = ui.available_height();
    ui.set_min_height(height);
    let plots = if ui.available_width() > 760.0 { 4 } else { 2 };
    ui.columns(plots, |columns| {
        let curve = |value: &dyn Fn(&Iteration) -> f64| -> Vec<[f64; 2]> {
            iterations
                .iter()
                .map(|i| [i.elapsed_s, value(i)])
                .filter(|p| p[1].is_finite())
                .collect()
        };
        let sigma = curve(&|i| f64::from(i.sigma));
        let objective = curve(&|i| i.objective.max(f64::MIN_POSITIVE).log10());
        let mut kinds = vec![
            (
                "Roughness σ",
                "Roughness of the lobe in radians; the band is its 95 % interval",
                sigma,
            ),
            (
                "Objective, log10",
                "What is minimised, as a power of ten; it starts anew where cells are split",
                objective,
            ),
        ];
        if plots == 4 {
            kinds.push((
                "Residual",
                "Root mean square of measured − predicted, weighted, in radiance units",
                curve(&|i| f64::from(i.residual_rms)),
            ));
        }
        for (k, (name, tip, points)) in kinds.into_iter().enumerate() {
            let interval = marks.interval.filter(|_| k == 0);
            time_plot(&mut columns[k], name, tip, &points, interval, marks, height);
        }
        if plots == 4 {
            profile_plot(&mut columns[3], tried, marks, height);
        }
    });
}

fn title(ui: &mut egui::Ui, name: &str, tip: &str) {
    ui.label(RichText::new(name).small().strong())
        .on_hover_text(tip);
}

fn base<'a>(name: &str, height: f32) -> Plot<'a> {
    Plot::new(("plot", name))
        .height(height.max(60.0))
        .allow_scroll(false)
        .allow_zoom(false)
        .allow_drag(false)
        .allow_boxed_zoom(false)
        .show_background(false)
        .y_axis_min_width(44.0)
        .set_margin_fraction(egui::vec2(0.03, 0.12))
}

fn time_plot(
    ui: &mut egui::Ui,
    name: &str,
    tip: &str,
    points: &[[f64; 2]],
    interval: Option<[f32; 2]>,
    marks: Marks,
    height: f32,
) {
    let palette = theme::palette(ui);
    title(ui, name, tip);
    let label = name.to_owned();
    base(name, height - 24.0)
        .x_axis_formatter(|mark, _| format!("{} s", mark.value))
        .label_formatter(move |position| {
            let at = place(position);
            Some(format!("{label} {:.4}\n{:.2} s", at.y, at.x))
        })
        .show(ui, |plot| {
            if let Some([low, high]) = interval {
                let band = Span::new("95 % interval", f64::from(low)..=f64::from(high))
                    .axis(egui_plot::Axis::Y)
                    .fill(palette.accent.gamma_multiply(0.18));
                plot.span(band);
            }
            plot.points(
                Points::new(name, PlotPoints::from(points.to_vec()))
                    .radius(1.8)
                    .color(palette.accent),
            );
            // Each stretch on its own: a joint of two steep ones would be drawn as a wedge.
            for pair in points.windows(2) {
                let stretch = Line::new(name, PlotPoints::from(pair.to_vec()));
                plot.line(stretch.color(palette.accent).width(1.5).allow_hover(false));
            }
            for (mark, colour) in [
                (marks.shown, palette.curves[1]),
                (marks.other, palette.curves[2]),
            ] {
                if let Some(mark) = mark {
                    plot.vline(
                        VLine::new("", mark.elapsed_s)
                            .color(colour)
                            .style(LineStyle::dashed_loose()),
                    );
                }
            }
        });
}

/// What each roughness leaves unexplained on the coarsest cells, as a part of the best one's.
fn profile_plot(ui: &mut egui::Ui, tried: &[Tried], marks: Marks, height: f32) {
    let palette = theme::palette(ui);
    title(
        ui,
        "Profile of σ",
        "What each roughness leaves unexplained, relative to the best, for both specular models; the line is σ, the band its 95 % interval",
    );
    let least = tried
        .iter()
        .map(|t| t.unexplained)
        .fold(f64::INFINITY, f64::min)
        .max(f64::MIN_POSITIVE);
    base("profile", height - 24.0)
        .x_axis_formatter(|mark, _| format!("{}", mark.value))
        .label_formatter(|position| {
            let at = place(position);
            Some(format!("σ {:.3}\n{:.2} × the least", at.x, at.y))
        })
        .include_y(1.0)
        .show(ui, |plot| {
            if let Some([low, high]) = marks.interval {
                let band = Span::new("95 % interval", f64::from(low)..=f64::from(high))
                    .fill(palette.accent.gamma_multiply(0.25));
                plot.span(band);
            }
            for (model, name, colour) in [
                (SpecularModel::Paper, "Paper's model", palette.curves[1]),
                (SpecularModel::Beckmann, "Beckmann", palette.curves[2]),
                (SpecularModel::Ggx, "GGX", palette.curves[0]),
                (
                    SpecularModel::Metal,
                    "Metal",
                    palette.curves[1].gamma_multiply(0.5),
                ),
            ] {
                let mut points: Vec<[f64; 2]> = tried
                    .iter()
                    .filter(|t| t.model == model && t.unexplained.is_finite())
                    .map(|t| [f64::from(t.sigma), t.unexplained / least])
                    .collect();
                points.sort_by(|a, b| a[0].total_cmp(&b[0]));
                plot.points(
                    Points::new(name, PlotPoints::from(points.clone()))
                        .radius(2.2)
                        .color(colour),
                );
                plot.line(Line::new(name, PlotPoints::from(points)).color(colour));
            }
            if let Some(shown) = marks.shown {
                plot.vline(VLine::new("σ", f64::from(shown.sigma)).color(palette.accent));
            }
        });
}

/// Where the pointer is, or the data point that it is near.
pub(super) fn place(position: &HoverPosition<'_>) -> PlotPoint {
    match position {
        HoverPosition::NearDataPoint { position, .. } | HoverPosition::Elsewhere { position } => {
            *position
        }
    }
}
