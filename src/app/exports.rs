//! Exports in line: one is made, the others wait for it.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::Instant;

use eframe::egui::{self, RichText};

use super::relight::{Export, duration_in_words};
use super::{Request, theme};
use crate::worker::Command;

/// Width of the list, points.
const WIDE: f32 = 320.0;
/// Below this part of the whole the time left is a guess not worth showing.
const TELLING: f32 = 0.05;

/// Those that wait, and what the one that is made will write.
#[derive(Default)]
pub(super) struct Exports {
    waiting: VecDeque<(Command, Export)>,
    making: Vec<PathBuf>,
}

impl Exports {
    /// Puts an export at the end of the line.
    pub(super) fn add(&mut self, command: Command, export: Export) {
        self.waiting.push_back((command, export));
    }

    /// Takes the next one out of the line, to be made.
    pub(super) fn next(&mut self) -> Option<(Command, Export)> {
        let next = self.waiting.pop_front();
        self.making = match &next {
            Some((_, export)) => export.files.clone(),
            None => Vec::new(),
        };
        next
    }

    /// Takes one that waits out of the line.
    pub(super) fn remove(&mut self, index: usize) {
        self.waiting.remove(index);
    }

    /// Takes all that wait out of the line.
    pub(super) fn clear(&mut self) {
        self.waiting.clear();
    }

    /// Whether an export that is made or waits will write this file.
    pub(super) fn will_write(&self, file: &Path) -> bool {
        let waiting = self.waiting.iter().flat_map(|(_, export)| &export.files);
        self.making.iter().chain(waiting).any(|f| f == file)
    }

    /// How many wait.
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// The button that shows the line, while some wait. `pace` is the seconds that a million pixels take.
    pub(super) fn button(
        &self,
        ui: &mut egui::Ui,
        now: &Progress<'_>,
        pace: Option<f64>,
    ) -> Option<Request> {
        let count = self.waiting();
        if count == 0 {
            return None;
        }
        let tip = "Exports that wait for this one, with the time that each takes";
        let button = ui.button(format!("{count} waiting")).on_hover_text(tip);
        let mut request = None;
        egui::Popup::menu(&button)
            .close_behavior(egui::PopupCloseBehavior::CloseOnClickOutside)
            .show(|ui| {
                ui.set_width(WIDE);
                now.row_ui(ui);
                for (i, (_, export)) in self.waiting.iter().enumerate() {
                    if waiting_ui(ui, export, pace) {
                        request = Some(Request::RemoveExport(i));
                    }
                }
                ui.separator();
                let tip =
                    "Stop this one, which keeps its finished frames, and forget those that wait";
                if ui.button("Stop all").on_hover_text(tip).clicked() {
                    request = Some(Request::StopExports);
                }
            });
        request
    }
}

/// How far the export is that is being made.
pub(super) struct Progress<'a> {
    /// What it makes.
    pub(super) export: &'a Export,
    /// What of it is made now.
    pub(super) said: &'a str,
    /// Which part of it is done.
    pub(super) part: f32,
    /// Since when it has been made.
    pub(super) since: Instant,
}

impl Progress<'_> {
    /// How far it is as a bar, as narrow as the menu bar needs it.
    pub(super) fn bar_ui(&self, ui: &mut egui::Ui) {
        self.bar(ui, 110.0)
            .accessible_name("Progress of the export");
    }

    /// How far it is in words.
    pub(super) fn in_words(&self) -> String {
        format!("{}, {}", self.said, self.left())
    }

    /// Per cent, and the time left once that can be told.
    fn left(&self) -> String {
        let percent = (100.0 * self.part).floor();
        if self.part < TELLING {
            return format!("{percent} %");
        }
        let seconds = self.since.elapsed().as_secs_f64();
        let left = duration_in_words(seconds * f64::from((1.0 - self.part) / self.part));
        format!("{percent} %, about {left} left")
    }

    fn bar(&self, ui: &mut egui::Ui, width: f32) -> egui::Response {
        let bar = egui::ProgressBar::new(self.part)
            .desired_width(width)
            .desired_height(8.0)
            .fill(theme::palette(ui).accent);
        ui.add(bar)
    }

    fn row_ui(&self, ui: &mut egui::Ui) {
        name_ui(ui, self.export);
        let name = format!("Progress of {}", self.export.name);
        self.bar(ui, WIDE).accessible_name(name);
        ui.weak(self.left());
    }
}

/// An export that waits; whether it is to be taken out of the line.
fn waiting_ui(ui: &mut egui::Ui, export: &Export, pace: Option<f64>) -> bool {
    ui.separator();
    let right = egui::Layout::right_to_left(egui::Align::Center);
    let removed = ui.horizontal(|ui| {
        ui.with_layout(right, |ui| {
            let name = format!("Remove {}", export.name);
            let removed = theme::close_button(ui, &name, "Take this export out of the line");
            ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                name_ui(ui, export);
            });
            removed.clicked()
        })
    });
    let time = export.megapixels.zip(pace).map_or_else(
        || "waits".to_owned(),
        |(megapixels, pace)| {
            format!(
                "waits; takes about {}",
                duration_in_words(pace * megapixels)
            )
        },
    );
    ui.weak(time);
    removed.inner.inner
}

/// The name of an export, with its folder as a tip.
fn name_ui(ui: &mut egui::Ui, export: &Export) {
    let label = egui::Label::new(RichText::new(&export.name).strong()).truncate();
    let folder = export.folder.display();
    ui.add(label)
        .on_hover_text(format!("{}, into {folder}", export.name));
}
