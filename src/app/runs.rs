//! The runs of a page of estimation: every estimation of the capture since it was opened, to be looked at beside each other.

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use eframe::egui::{self, RichText};

use super::capture_page::{method_name, specular_name};
use super::settings::Estimation as Settings;
use super::theme;
use crate::worker::{Progress, Step};
use rekindle_lab::bench::{Axis, Curve, Dot, Panel, draw};
use rekindle_solution::Solution;

use super::plots::{KINDS, stretches};

/// Width of the list, points.
const WIDE: f32 = 420.0;
/// Size of a panel of saved curves, pixels.
const PANEL: [u32; 2] = [640, 360];

/// How far a run has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    Running,
    Stopping,
    Stopped,
    Done,
}

/// An estimation, running or ended.
pub(super) struct Run {
    /// The command's number.
    pub(super) job: u64,
    /// The run's own, from 1.
    pub(super) number: usize,
    /// How it estimates.
    pub(super) settings: Settings,
    pub(super) state: State,
    pub(super) progress: Option<Arc<Progress>>,
    pub(super) solution: Option<Arc<Solution>>,
    /// Time since the start without pauses.
    pub(super) elapsed: Duration,
    /// Whether its curves are drawn over those of the run that is looked at.
    pub(super) overlaid: bool,
}

impl Run {
    /// A run that was just started as command `job`.
    pub(super) fn new(number: usize, job: u64, settings: Settings) -> Self {
        Self {
            job,
            number,
            settings,
            state: State::Running,
            progress: None,
            solution: None,
            elapsed: Duration::ZERO,
            overlaid: false,
        }
    }

    pub(super) fn name(&self) -> String {
        format!("Run {}", self.number)
    }

    pub(super) fn steps(&self) -> &[Arc<Step>] {
        self.progress.as_ref().map_or(&[], |p| &p.steps)
    }

    /// Seconds that it took, without reading the capture; none before its end.
    pub(super) fn seconds(&self) -> Option<f64> {
        let timings = self.solution.as_ref()?.timings.iter();
        let own = timings.filter(|(stage, _)| stage != "load");
        Some(own.map(|(_, seconds)| seconds).sum())
    }

    /// How it was made and what came out.
    fn in_words(&self) -> String {
        let mut text = format!(
            "{}, lobe: {}",
            method_name(self.settings.method),
            specular_name(self.settings.specular)
        );
        // Writing into a string can't fail.
        let _ = write!(text, ", light resolution {}", self.settings.frequency);
        if let Some(roughness) = self.settings.stated_roughness() {
            let _ = write!(text, ", roughness {roughness:.2} as stated");
        }
        if self.settings.as_stated {
            text += ", cameras and exposures as stated";
        }
        let Some(solution) = &self.solution else {
            text += match self.state {
                State::Stopped => "; stopped",
                _ => "; under way",
            };
            return text;
        };
        let _ = write!(text, "; {:.1} s", self.seconds().unwrap_or_default());
        if let Some(brdf) = solution.brdf {
            let _ = write!(text, ", σ {:.4} rad", brdf.sigma);
        }
        let views = &solution.fit.psnr_db_per_view;
        if !views.is_empty() {
            let mean = views.iter().sum::<f32>() / views.len() as f32;
            let _ = write!(text, ", {mean:.1} dB");
        }
        text
    }
}

/// The button with the list of runs, where there are several; `at` is the one that is looked at. Whether another was chosen.
pub(super) fn button(ui: &mut egui::Ui, runs: &mut [Run], at: &mut usize) -> bool {
    let Some(shown) = runs.get(*at).filter(|_| runs.len() > 1) else {
        return false;
    };
    let text = format!("{} of {}", shown.name(), runs.len());
    let tip = "Every estimation of this capture: look at any, draw its curves over others, relight with it";
    let button = ui.button(text).on_hover_text(tip);
    let before = *at;
    egui::Popup::menu(&button)
        .close_behavior(egui::PopupCloseBehavior::CloseOnClickOutside)
        .show(|ui| {
            ui.set_width(WIDE);
            for (i, run) in runs.iter_mut().enumerate() {
                ui.horizontal(|ui| {
                    let name = RichText::new(run.name()).strong();
                    let look = ui.selectable_label(i == *at, name);
                    if look.on_hover_text("Look at this run").clicked() {
                        *at = i;
                    }
                    let name = format!("Curves of {}", run.name());
                    let tip = "Draw its curves over those of the run that is looked at";
                    ui.checkbox(&mut run.overlaid, "Curves")
                        .accessible_name(name)
                        .on_hover_text(tip);
                });
                ui.add(egui::Label::new(RichText::new(run.in_words()).weak()).wrap());
            }
        });
    before != *at
}

/// The curve of a run that is drawn over another's.
pub(super) struct Overlay<'a> {
    pub(super) run: &'a Run,
    pub(super) colour: egui::Color32,
}

/// The runs that are drawn over the one at `at`.
pub(super) fn overlays<'a>(ui: &egui::Ui, runs: &'a [Run], at: usize) -> Vec<Overlay<'a>> {
    let palette = theme::palette(ui);
    let colours = [
        palette.curves[1],
        palette.curves[2],
        palette.error,
        palette.warning,
    ];
    let others = runs.iter().enumerate();
    let others = others.filter(|(i, run)| *i != at && run.overlaid);
    let coloured = others.zip(colours.into_iter().cycle());
    coloured
        .map(|((_, run), colour)| Overlay { run, colour })
        .collect()
}

/// Every iteration of every run, as comma-separated values.
pub(super) fn csv(runs: &[Run]) -> String {
    let mut text =
        "run,iteration,elapsed_s,stage,lobe,sigma_rad,residual_rms,objective\n".to_owned();
    for run in runs {
        for step in run.steps() {
            let i = &step.iteration;
            // Writing into a string can't fail.
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{},{}",
                run.number,
                i.iteration,
                i.elapsed_s,
                step.stage,
                step.model.name(),
                i.sigma,
                i.residual_rms,
                i.objective
            );
        }
    }
    text
}

/// The curves of all runs as an SVG picture, one panel for each kind.
pub(super) fn svg(runs: &[Run]) -> std::io::Result<String> {
    let panels = KINDS.iter().map(|kind| {
        let curves = runs.iter().map(|run| {
            let mut points = Vec::new();
            for stretch in stretches(run.steps(), run.settings.method) {
                let iterations = run.steps()[stretch].iter().map(|step| &step.iteration);
                points.extend(iterations.map(|i| Dot::new(i.elapsed_s, (kind.value)(i))));
                points.push(Dot::new(f64::NAN, f64::NAN));
            }
            Curve {
                name: run.name(),
                points,
            }
        });
        Panel {
            caption: kind.name.to_owned(),
            x: Axis::Linear("seconds".to_owned()),
            y: Axis::Linear(String::new()),
            curves: curves.collect(),
        }
    });
    draw(&panels.collect::<Vec<_>>(), 1, PANEL)
}
