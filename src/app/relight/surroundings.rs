//! Light that no lamp makes: the ambient part, the estimate's stray light and a light probe.

use std::path::Path;
use std::sync::Arc;

use eframe::egui;

use super::editing::undoable;
use super::lamp_settings::{LABELS, fit_sliders};
use crate::app::Shared;
use crate::worker::{Latest, Purpose};
use rekindle_relight::ProbeUnits;
use rekindle_studio::{Document, Probe, ProbeLight};

/// A light probe being read.
#[derive(Default)]
pub(super) struct Probes {
    read: Arc<Latest<Result<Arc<ProbeLight>, String>>>,
    reading: bool,
}

impl Probes {
    /// Reads a picture beside the window's thread.
    pub(super) fn read(&mut self, worker: &mut crate::worker::Worker, path: &Path) {
        let (slot, path) = (Arc::clone(&self.read), path.to_owned());
        self.reading = true;
        worker.aside("probe", move || slot.store(ProbeLight::load(&path)));
    }

    /// Puts a picture that was read in the place of the light. Says what was wrong with it.
    pub(super) fn take(&mut self, document: &mut Document) -> Option<String> {
        let read = self.read.take()?;
        self.reading = false;
        match read {
            Ok(light) => {
                let file = light.file().to_owned();
                document.know_probe(light);
                document.edit("Load light probe", |s, _| {
                    let look = s.look_mut();
                    match &mut look.probe {
                        Some(probe) => probe.file = file,
                        None => look.replace_by_probe(file),
                    }
                });
                None
            }
            Err(problem) => Some(problem),
        }
    }
}

/// Shows the group.
pub(super) fn show(
    ui: &mut egui::Ui,
    document: &mut Document,
    probes: &Probes,
    shared: &mut Shared<'_>,
) {
    fit_sliders(ui);
    let (look, base) = (document.look().clone(), document.base().clone());
    egui::Grid::new("surroundings")
        .num_columns(2)
        .min_col_width(LABELS)
        .spacing([12.0, 8.0])
        .show(ui, |ui| {
            ui.label("Ambient");
            let has_ambient = base.lighting.ambient.max_element() > 0.0;
            let mut ambient = look.ambient;
            let slider = egui::Slider::new(&mut ambient, 0.0..=4.0)
                .fixed_decimals(2)
                .clamping(egui::SliderClamping::Edits);
            let tip = "Light from everywhere alike, as a part of what was estimated";
            let response = ui
                .add_enabled(has_ambient, slider)
                .accessible_name("Ambient")
                .on_hover_text(tip)
                .on_disabled_hover_text("The estimate has no ambient light");
            undoable(document, &response, "Ambient light", |s, _| {
                s.look_mut().ambient = ambient;
            });
            ui.end_row();
            if !base.lighting.remainder.is_empty() {
                ui.label("");
                let mut remainder = look.remainder;
                let response = ui.checkbox(&mut remainder, "Stray light").on_hover_text(
                    "Weak light of the estimate that belongs to none of them; a light probe replaces it",
                );
                undoable(document, &response, "Stray light", |s, _| {
                    s.look_mut().remainder = remainder;
                });
                ui.end_row();
            }
            ui.label("Light probe");
            probe_ui(ui, document, look.probe.as_ref(), probes, shared);
            ui.end_row();
            if let Some(probe) = &look.probe {
                probe_settings(ui, document, probe);
            }
        });
}

fn probe_ui(
    ui: &mut egui::Ui,
    document: &mut Document,
    probe: Option<&Probe>,
    probes: &Probes,
    shared: &mut Shared<'_>,
) {
    ui.horizontal(|ui| {
        if probes.reading {
            ui.spinner();
            ui.weak("Reading");
            return;
        }
        let tip = "Light the object by a lat-long picture, .hdr or .exr, in place of the lights";
        if ui.button("Choose…").on_hover_text(tip).clicked() {
            let start = probe.and_then(|p| p.file.parent());
            shared.worker.pick(Purpose::LightProbe, start);
        }
        if probe.is_some() {
            let tip = "Take the light probe away; the lights stay as they are";
            if ui.button("Remove").on_hover_text(tip).clicked() {
                document.edit("Remove the light probe", |s, _| s.look_mut().probe = None);
            }
        }
    });
}

fn probe_settings(ui: &mut egui::Ui, document: &mut Document, probe: &Probe) {
    ui.label("");
    let name = probe.file.file_name().unwrap_or(probe.file.as_os_str());
    ui.add(egui::Label::new(name.to_string_lossy()).truncate())
        .on_hover_text(probe.file.display().to_string());
    ui.end_row();
    ui.label("Turn");
    let mut degrees = probe.rotation.to_degrees();
    let slider = egui::Slider::new(&mut degrees, -180.0..=180.0)
        .clamping(egui::SliderClamping::Edits)
        .fixed_decimals(0)
        .suffix("°");
    let response = ui
        .add(slider)
        .accessible_name("Turn of the light probe")
        .on_hover_text("About the pole, counter-clockwise seen from above");
    undoable(document, &response, "Turn the light probe", |s, _| {
        if let Some(probe) = &mut s.look_mut().probe {
            probe.rotation = degrees.to_radians();
        }
    });
    ui.end_row();
    units_ui(ui, document, probe);
    ui.label("Brightness");
    let mut stops = probe.stops;
    let slider = egui::Slider::new(&mut stops, -8.0..=8.0)
        .clamping(egui::SliderClamping::Edits)
        .fixed_decimals(2)
        .suffix(" stops");
    let response = ui
        .add(slider)
        .accessible_name("Brightness of the light probe")
        .on_hover_text("One stop is twice or half the light");
    undoable(
        document,
        &response,
        "Brightness of the light probe",
        |s, _| {
            if let Some(probe) = &mut s.look_mut().probe {
                probe.stops = stops;
            }
        },
    );
    ui.end_row();
}

/// How bright the light probe is taken to be.
fn units_ui(ui: &mut egui::Ui, document: &mut Document, probe: &Probe) {
    let label = ui.label("Scale");
    let name = |units| match units {
        ProbeUnits::Matched => "Matched",
        ProbeUnits::Stored => "As stored",
        ProbeUnits::Solution => "Solution's",
    };
    let tip = |units| match units {
        ProbeUnits::Matched => "As bright as the captured lighting in sum",
        ProbeUnits::Stored => "In real units, as pictures exported for other programs",
        ProbeUnits::Solution => "In the solution's units, as its hemisphere.exr",
    };
    let mut units = probe.units;
    egui::ComboBox::from_id_salt("probe units")
        .selected_text(name(units))
        .show_ui(ui, |ui| {
            for choice in [
                ProbeUnits::Matched,
                ProbeUnits::Stored,
                ProbeUnits::Solution,
            ] {
                ui.selectable_value(&mut units, choice, name(choice))
                    .on_hover_text(tip(choice));
            }
        })
        .response
        .labelled_by(label.id)
        .on_hover_text("What the picture's numbers are taken for: matched to the captured lighting, or as they are stored");
    if units != probe.units {
        document.edit("Scale of the light probe", |s, _| {
            if let Some(probe) = &mut s.look_mut().probe {
                probe.units = units;
            }
        });
    }
    ui.end_row();
}
