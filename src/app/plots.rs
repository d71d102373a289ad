//! The curves of an estimation: roughness, objective and residual against time, and the profile of σ.
//!
//! A curve is broken wherever the problem changes, because its values before and after can't be compared: at every stage, with
//! another lobe, and where the default method splits its cells. Bands with numbers say which stage it was.

use std::ops::RangeInclusive;
use std::sync::Arc;

use eframe::egui::{self, RichText};
use egui_plot::{
    AxisHints, GridMark, HoverPosition, Line, LineStyle, Plot, PlotPoint, PlotPoints, PlotUi,
    Points, Span, VLine,
};

use super::estimation::sentence;
use super::runs::Overlay;
use super::theme;
use crate::worker::{Step, Tried};
use rekindle_estimate::estimate::{Iteration, Method};
use rekindle_scene::reflectance::SpecularModel;

/// Room for the line above a plot, points.
const HEAD: f32 = 34.0;
/// How strong the colours of an earlier look's curves are, over those of the last one.
const EARLIER: f32 = 0.25;
/// Marks of an axis at most.
const MOST_MARKS: f64 = 5.0;

/// What is drawn of an estimation.
pub struct Curves<'a> {
    /// Its iterations.
    pub steps: &'a [Arc<Step>],
    /// The roughnesses that were tried.
    pub tried: &'a [Tried],
    /// Its method.
    pub method: Method,
    /// The iteration that is looked at, by index.
    pub shown: Option<usize>,
    /// The one that it is compared with.
    pub other: Option<usize>,
    /// 95 % interval of σ, once it is known.
    pub interval: Option<[f32; 2]>,
    /// Other runs, drawn over it.
    pub(super) overlays: Vec<Overlay<'a>>,
}

/// A curve: its name with the unit, what it says, and its value at an iteration.
pub(super) struct Kind {
    pub(super) name: &'static str,
    tip: &'static str,
    pub(super) value: fn(&Iteration) -> f64,
}

/// All curves against time.
pub(super) const KINDS: [Kind; 3] = [
    Kind {
        name: "Roughness σ, rad",
        tip: "Roughness of the lobe in radians; the band across is its 95 % interval",
        value: |i| f64::from(i.sigma),
    },
    Kind {
        name: "Residual, radiance",
        tip: "Root mean square of measured − predicted, weighted, in radiance units of the capture. It can be compared from stage \
              to stage, as the objective can't",
        value: |i| f64::from(i.residual_rms),
    },
    Kind {
        name: "Objective, log10",
        tip: "What is minimised, in squared radiance, as a power of ten. It begins anew at every break, with another problem: a \
              higher value there is no step back",
        value: |i| i.objective.max(f64::MIN_POSITIVE).log10(),
    },
];

/// A stage with the iterations in it.
struct Stage<'a> {
    name: &'a str,
    seconds: [f64; 2],
}

/// A stretch of iterations of one problem, by index.
pub(super) type Stretch = std::ops::Range<usize>;

impl Curves<'_> {
    /// Shows the plots beside each other. Returns the iteration that was clicked, by index.
    pub fn show(&self, ui: &mut egui::Ui) -> Option<usize> {
        // All of the panel, which otherwise shrinks to what is in it.
        ui.set_min_height(ui.available_height());
        let stages = self.stages();
        let height = ui.available_height();
        let plots = match ui.available_width() {
            room if room > 1100.0 => 4,
            room if room > 760.0 => 3,
            _ => 2,
        };
        let mut clicked = None;
        ui.columns(plots, |columns| {
            for (column, kind) in columns.iter_mut().zip(&KINDS[..plots - 1]) {
                clicked = clicked.or(self.time_ui(column, kind, &stages, height));
            }
            self.profile_ui(&mut columns[plots - 1], height);
        });
        clicked
    }

    /// The stages in order, each from its first iteration to that of the next.
    fn stages(&self) -> Vec<Stage<'_>> {
        let mut stages: Vec<Stage<'_>> = Vec::new();
        for step in self.steps {
            let now = step.iteration.elapsed_s;
            if let Some(last) = stages.last_mut() {
                last.seconds[1] = now;
            }
            if stages.last().is_none_or(|last| last.name != step.stage) {
                stages.push(Stage {
                    name: &step.stage,
                    seconds: [now; 2],
                });
            }
        }
        stages
    }

    /// Which stage has which number, and what the dashed lines are.
    pub fn legend_ui(&self, ui: &mut egui::Ui) {
        let palette = theme::palette(ui);
        ui.horizontal_wrapped(|ui| {
            ui.spacing_mut().item_spacing.x = 14.0;
            for (i, stage) in self.stages().iter().enumerate() {
                let text = format!("{}  {}", i + 1, sentence(stage.name));
                ui.label(RichText::new(text).small());
            }
            for (mark, text, colour) in [
                (self.shown, "– – iteration shown", palette.curves[1]),
                (self.other, "– – compared with", palette.curves[2]),
            ] {
                if mark.is_some() {
                    ui.label(RichText::new(text).small().color(colour));
                }
            }
            for overlay in &self.overlays {
                let text = format!("— {}", overlay.run.name());
                ui.label(RichText::new(text).small().color(overlay.colour));
            }
        });
    }

    fn time_ui(
        &self,
        ui: &mut egui::Ui,
        kind: &Kind,
        stages: &[Stage<'_>],
        height: f32,
    ) -> Option<usize> {
        let palette = theme::palette(ui);
        head_ui(ui, kind.name, kind.tip, |_| {});
        let point = |i: usize| {
            let iteration = &self.steps[i].iteration;
            [iteration.elapsed_s, (kind.value)(iteration)]
        };
        let own = stretches(self.steps, self.method);
        let label = kind.name;
        let plot = base(kind.name, height - HEAD, " s").label_formatter(move |position| {
            let at = place(position);
            Some(format!("{label} {:.4}\n{:.2} s", at.y, at.x))
        });
        let shown = plot.show(ui, |plot| {
            for (i, stage) in stages.iter().enumerate() {
                let number = (i + 1).to_string();
                let band = Span::new(number, stage.seconds[0]..=stage.seconds[1]);
                // Without any fill the plot would choose one.
                let shade = if i % 2 == 1 { 0.14 } else { 0.02 };
                plot.span(
                    band.fill(palette.weak.gamma_multiply(shade))
                        .border_width(0.0),
                );
            }
            let sigma = self.interval.filter(|_| kind.name == KINDS[0].name);
            if let Some([low, high]) = sigma {
                let band = Span::new("95 % interval", f64::from(low)..=f64::from(high))
                    .axis(egui_plot::Axis::Y)
                    .fill(palette.accent.gamma_multiply(0.18));
                plot.span(band);
            }
            for Overlay { run, colour } in &self.overlays {
                let all = stretches(run.steps(), run.settings.method);
                stretches_ui(plot, kind, run.steps(), all, *colour);
            }
            stretches_ui(plot, kind, self.steps, own, palette.accent);
            for (mark, colour) in [
                (self.shown, palette.curves[1]),
                (self.other, palette.curves[2]),
            ] {
                if let Some(step) = mark.and_then(|k| self.steps.get(k)) {
                    let line = VLine::new("", step.iteration.elapsed_s).color(colour);
                    plot.vline(line.style(LineStyle::dashed_loose()));
                }
            }
            plot.pointer_coordinate()
        });
        let name = format!("Curve of {}", kind.name);
        let response = shown.response;
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, name.clone()));
        let seconds = shown.inner.filter(|_| response.clicked())?.x;
        let off = |i: &usize| (point(*i)[0] - seconds).abs();
        (0..self.steps.len()).min_by(|a, b| off(a).total_cmp(&off(b)))
    }

    /// What each roughness leaves unexplained on the coarsest cells, as a part of the best one's.
    fn profile_ui(&self, ui: &mut egui::Ui, height: f32) {
        let palette = theme::palette(ui);
        let tip = "What each roughness leaves unexplained on the coarsest cells, as a multiple of the least, for each form of the \
                   lobe; the line is σ, the band its 95 % interval. Fainter curves are of an earlier look: on another surface, or under \
                   light from elsewhere";
        let models = [
            (SpecularModel::Paper, palette.curves[1]),
            (SpecularModel::Beckmann, palette.curves[2]),
            (SpecularModel::Ggx, palette.curves[0]),
            (SpecularModel::Metal, palette.error),
        ];
        let of = |model: SpecularModel| self.tried.iter().filter(move |t| t.model == model);
        head_ui(ui, "Profile of σ, rad", tip, |ui| {
            let known = |model: SpecularModel| of(model).next().is_some();
            for (model, colour) in models.into_iter().filter(|(model, _)| known(*model)) {
                ui.label(RichText::new(model.name()).small().color(colour));
            }
        });
        if self.tried.is_empty() {
            if self.method != Method::Fast {
                ui.weak("This method has no profile: it compares no roughnesses before it begins.");
            }
            return;
        }
        let plot = base("profile", height - HEAD, "")
            .label_formatter(|position| {
                let at = place(position);
                Some(format!("σ {:.3} rad\n{:.2} × the least", at.x, at.y))
            })
            .include_y(1.0);
        let shown = plot.show(ui, |plot| {
            if let Some([low, high]) = self.interval {
                let band = Span::new("95 % interval", f64::from(low)..=f64::from(high))
                    .fill(palette.accent.gamma_multiply(0.25));
                plot.span(band);
            }
            let looks = looks(self.tried);
            for (k, look) in looks.iter().enumerate() {
                let strength = if k + 1 == looks.len() { 1.0 } else { EARLIER };
                for (model, colour) in models {
                    look_ui(plot, look, model, colour.gamma_multiply(strength));
                }
            }
            if let Some(step) = self.shown.and_then(|k| self.steps.get(k)) {
                let sigma = f64::from(step.iteration.sigma);
                plot.vline(VLine::new("σ", sigma).color(palette.accent));
            }
        });
        let name = "Curve of the profile of σ";
        let response = shown.response;
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, name));
    }
}

/// Roughnesses that were compared with each other: where one is tried again, another look begins, of a problem that is not to be compared.
fn looks(tried: &[Tried]) -> Vec<&[Tried]> {
    let mut looks = Vec::new();
    let mut first = 0;
    for (i, one) in tried.iter().enumerate() {
        let is_again = |t: &Tried| t.model == one.model && t.sigma == one.sigma;
        if tried[first..i].iter().any(is_again) {
            looks.push(&tried[first..i]);
            first = i;
        }
    }
    looks.push(&tried[first..]);
    looks
}

/// Draws what the roughnesses of a look leave with one form of the lobe.
fn look_ui(plot: &mut PlotUi<'_>, look: &[Tried], model: SpecularModel, colour: egui::Color32) {
    let least = look.iter().map(|t| t.unexplained);
    let least = least.fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE);
    let known = look
        .iter()
        .filter(|t| t.model == model && t.unexplained.is_finite());
    let mut points: Vec<[f64; 2]> = known
        .map(|t| [f64::from(t.sigma), t.unexplained / least])
        .collect();
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    plot.points(
        Points::new(model.name(), PlotPoints::from(points.clone()))
            .radius(2.2)
            .color(colour),
    );
    plot.line(Line::new(model.name(), PlotPoints::from(points)).color(colour));
}

/// Iterations of one problem each.
pub(super) fn stretches(steps: &[Arc<Step>], method: Method) -> Vec<Stretch> {
    let mut stretches: Vec<Stretch> = Vec::new();
    for (i, step) in steps.iter().enumerate() {
        let goes_on = i.checked_sub(1).is_some_and(|before| {
            let before = &steps[before];
            let split = method == Method::Fast && before.fraction != step.fraction;
            before.stage == step.stage && before.model == step.model && !split
        });
        match stretches.last_mut() {
            Some(last) if goes_on => last.end = i + 1,
            _ => stretches.push(i..i + 1),
        }
    }
    stretches
}

/// Draws the curve of a run, broken between its stretches.
fn stretches_ui(
    plot: &mut PlotUi<'_>,
    kind: &Kind,
    steps: &[Arc<Step>],
    stretches: Vec<Stretch>,
    colour: egui::Color32,
) {
    for stretch in stretches {
        let iterations = steps[stretch].iter().map(|step| &step.iteration);
        let points = iterations.map(|i| [i.elapsed_s, (kind.value)(i)]);
        let points: Vec<[f64; 2]> = points.filter(|p| p[1].is_finite()).collect();
        plot.points(
            Points::new(kind.name, PlotPoints::from(points.clone()))
                .radius(1.8)
                .color(colour),
        );
        // Each part on its own: a joint of two steep ones would be drawn as a wedge.
        for pair in points.windows(2) {
            let part = Line::new(kind.name, PlotPoints::from(pair.to_vec()));
            plot.line(part.color(colour).width(1.5).allow_hover(false));
        }
    }
}

/// The line above a plot: its name, and what else there is.
fn head_ui(ui: &mut egui::Ui, name: &str, tip: &str, more: impl FnOnce(&mut egui::Ui)) {
    ui.horizontal(|ui| {
        ui.label(RichText::new(name).small().strong())
            .on_hover_text(tip);
        more(ui);
    });
}

/// A plot that stays as it is; `unit` follows the numbers below it.
fn base<'a>(name: &str, height: f32, unit: &'static str) -> Plot<'a> {
    /// Room between marks below which their labels go, points.
    const LABELS: RangeInclusive<f32> = 12.0..=14.0;
    let below = AxisHints::new_x()
        .formatter(move |mark, _| format!("{}{unit}", tidy(mark)))
        .label_spacing(LABELS);
    let aside = AxisHints::new_y()
        .formatter(|mark, _| tidy(mark))
        .label_spacing(LABELS)
        .min_thickness(44.0);
    Plot::new(("plot", name))
        .height(height.max(60.0))
        .allow_scroll(false)
        .allow_zoom(false)
        .allow_drag(false)
        .allow_boxed_zoom(false)
        .show_background(false)
        .grid_color(egui::Color32::from_gray(128).gamma_multiply(0.25))
        .custom_x_axes(vec![below])
        .custom_y_axes(vec![aside])
        .x_grid_spacer(|input| marks(input.bounds))
        .y_grid_spacer(|input| marks(input.bounds))
        .set_margin_fraction(egui::vec2(0.03, 0.12))
}

/// Marks at round numbers, a few of them however long the axis is.
fn marks((low, high): (f64, f64)) -> Vec<GridMark> {
    let least = (high - low) / MOST_MARKS;
    if !(least.is_normal() && least > 0.0) {
        return Vec::new();
    }
    let power = 10_f64.powf(least.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    let step = step.into_iter().find(|s| *s >= least).unwrap_or(least);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    let mark = |k: i64| GridMark {
        value: k as f64 * step,
        step_size: step,
    };
    (first..=last).map(mark).collect()
}

/// A mark's number with the digits that its axis needs.
fn tidy(mark: GridMark) -> String {
    let digits = (-(mark.step_size * 1.001).log10().floor()).clamp(0.0, 9.0);
    format!("{:.*}", digits as usize, mark.value)
}

/// Where the pointer is, or the data point that it is near.
pub(super) fn place(position: &HoverPosition<'_>) -> PlotPoint {
    match position {
        HoverPosition::NearDataPoint { position, .. } | HoverPosition::Elsewhere { position } => {
            *position
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(stage: &str, fraction: f32, elapsed_s: f64) -> Arc<Step> {
        Arc::new(Step {
            iteration: Iteration {
                iteration: 1,
                elapsed_s,
                objective: 1.0,
                sigma: 0.1,
                residual_rms: 0.1,
            },
            model: SpecularModel::Ggx,
            stage: stage.to_owned(),
            fraction,
            lit: Vec::new(),
        })
    }

    fn curves(steps: &[Arc<Step>], method: Method) -> Curves<'_> {
        Curves {
            steps,
            tried: &[],
            method,
            shown: None,
            other: None,
            interval: None,
            overlays: Vec::new(),
        }
    }

    #[test]
    fn curves_are_broken_where_the_problem_changes() {
        let steps = [
            step("comparing", 0.1, 1.0),
            step("comparing", 0.1, 2.0),
            step("splitting", 0.3, 3.0),
            step("splitting", 0.5, 4.0),
            step("splitting", 0.5, 5.0),
        ];
        let fast = curves(&steps, Method::Fast);
        assert_eq!(stretches(&steps, Method::Fast), [0..2, 2..3, 3..5]);
        // The paper's methods have one problem from begin to end, and tell how far they are at every step.
        assert_eq!(stretches(&steps, Method::Amuh), [0..2, 2..5]);
        let stages = fast.stages();
        let stages = stages.iter().map(|s| (s.name, s.seconds));
        let expected = [("comparing", [1.0, 3.0]), ("splitting", [3.0, 5.0])];
        assert_eq!(stages.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn roughnesses_of_two_looks_are_two_curves() {
        let tried = |model, sigma| Tried {
            model,
            sigma,
            unexplained: 1.0,
        };
        let (paper, ggx) = (SpecularModel::Paper, SpecularModel::Ggx);
        let first = [tried(paper, 0.1), tried(paper, 0.2), tried(ggx, 0.1)];
        assert_eq!(
            looks(&first).len(),
            1,
            "another form of the lobe is no other look"
        );
        let both = [&first[..], &first[..2]].concat();
        let lengths: Vec<usize> = looks(&both).iter().map(|look| look.len()).collect();
        assert_eq!(lengths, [3, 2]);
    }

    #[test]
    fn axes_have_a_few_tidy_numbers_however_long_they_are() {
        for (low, high, texts) in [
            (0.0, 1.1, vec!["0.0", "0.5", "1.0"]),
            (0.05, 0.35, vec!["0.1", "0.2", "0.3"]),
            (0.0, 12.0, vec!["0", "5", "10"]),
            (-1.0, 95.0, vec!["0", "20", "40", "60", "80"]),
            (
                0.070,
                0.0721,
                vec!["0.0700", "0.0705", "0.0710", "0.0715", "0.0720"],
            ),
        ] {
            let told: Vec<String> = marks((low, high)).into_iter().map(tidy).collect();
            assert_eq!(told, texts);
        }
    }
}
