//! The light of the place, where its picture is known: chosen on the page of a capture, before it is estimated.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::{self, DragValue, RichText};

use super::{Shared, theme};
use crate::worker::{Latest, Purpose, Worker};
use rekindle_solution::LightProbe;

/// What is chosen of the light: its picture, if there is one.
#[derive(Default)]
pub struct KnownLightChoice {
    chosen: Option<Chosen>,
    read: Arc<Latest<Result<Chosen, String>>>,
    reading: bool,
}

/// A picture of the light.
#[derive(Clone)]
struct Chosen {
    path: PathBuf,
    probe: LightProbe,
    /// The rotation that was stated last, degrees.
    degrees: f32,
}

impl KnownLightChoice {
    /// Reads a picture beside the window's thread; a rotation that was stated stays.
    pub fn read(&mut self, worker: &mut Worker, path: &Path) {
        let (slot, path) = (Arc::clone(&self.read), path.to_owned());
        let before = self.chosen.as_ref();
        let turn = before.and_then(|chosen| chosen.probe.turn);
        let degrees = before.map_or(0.0, |chosen| chosen.degrees);
        self.reading = true;
        worker.aside("known light", move || {
            let read = LightProbe::load(&path, turn).map(|probe| Chosen {
                path,
                probe,
                degrees,
            });
            slot.store(read.map_err(|e| e.to_string()));
        });
    }

    /// Takes a picture that was read. Says what was wrong with it, once.
    pub fn take(&mut self) -> Option<String> {
        let read = self.read.take()?;
        self.reading = false;
        match read {
            Ok(chosen) => {
                self.chosen = Some(chosen);
                None
            }
            Err(problem) => Some(problem),
        }
    }

    /// The picture of the light, if it is known.
    pub fn probe(&self) -> Option<LightProbe> {
        self.chosen.as_ref().map(|chosen| chosen.probe.clone())
    }

    /// Shows the choice.
    pub(super) fn show(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        theme::group(ui, "Light");
        ui.horizontal_wrapped(|ui| {
            if self.reading {
                ui.spinner();
                ui.label("Reading the picture");
                return;
            }
            let mut known = self.chosen.is_some();
            let estimate = ui.radio_value(&mut known, false, "Estimate it");
            if estimate
                .on_hover_text("Find the lights by the highlights in the photographs")
                .changed()
            {
                self.chosen = None;
            }
            let choose = ui.radio(known, "Known light…").on_hover_text(
                "A lat-long picture (EXR or Radiance HDR) of all the light of the place, in the photographs' units: no light \
                 is estimated then, and roughness, gloss and albedo are absolute",
            );
            if choose.clicked() {
                let start = self.chosen.as_ref().and_then(|chosen| chosen.path.parent());
                shared.worker.pick(Purpose::KnownLight, start);
            }
        });
        if let Some(chosen) = &mut self.chosen {
            chosen.show(ui);
        }
    }
}

impl Chosen {
    fn show(&mut self, ui: &mut egui::Ui) {
        ui.add(egui::Label::new(RichText::new(self.probe.file()).strong()).truncate())
            .on_hover_text(self.path.display().to_string());
        ui.horizontal(|ui| {
            let mut stated = self.probe.turn.is_some();
            ui.checkbox(&mut stated, "Rotation").on_hover_text(
                "State how the picture is turned about the capture's up, counter-clockwise seen from above. Otherwise the \
                 highlights tell",
            );
            if stated {
                ui.add(
                    DragValue::new(&mut self.degrees)
                        .range(-360.0..=360.0)
                        .speed(0.5)
                        .suffix("°"),
                )
                .on_hover_text("Degrees, counter-clockwise seen from above")
                .accessible_name("Rotation of the known light");
            } else {
                ui.weak("by the highlights");
            }
            self.probe.turn = stated.then(|| self.degrees.to_radians());
        });
        ui.weak("No light is estimated. Roughness, gloss and albedo come in absolute units.");
    }
}
