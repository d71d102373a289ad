//! The question what other programs get of the object and its light.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use eframe::egui;

use super::exporting::{Answer, buttons, folder_ui};
use crate::app::theme;
use crate::setups;
use crate::worker::Command;
use rekindle_capture::Camera;
use rekindle_output::interchange::{
    Anchor, Form, Job, JobError, MapLayout, Orientation, PAGE, Source, USUAL_F0, export,
    reflectance, refractive_index,
};
use rekindle_output::web::Setup;
use rekindle_relight::Lighting;
use rekindle_solution::Solution;
use rekindle_studio::Document;

/// What can be chosen, with its name and what it is.
const FORMS: [(Form, &str, &str); 9] = [
    (
        Form::Blender,
        "Blender",
        "A script that rebuilds object, lights and cameras",
    ),
    (Form::Mitsuba, "Mitsuba 3", "A scene with the same material"),
    (Form::Gltf, "glTF", "One GLB file with the lights"),
    (Form::Usd, "USD", "Object, dome light and lights as text"),
    (Form::Obj, "OBJ", "Mesh, material and texture"),
    (
        Form::Light,
        "Light maps",
        "Lat-long EXR and HDR, and the lights as lists",
    ),
    (
        Form::Cameras,
        "Cameras",
        "transforms.json as nerfstudio reads it",
    ),
    (
        Form::Layers,
        "Layers",
        "EXR pictures from all cameras with a light group for each light; they take a while",
    ),
    (
        Form::Web,
        "Web page",
        "One file in which anyone with a browser turns the object and moves its lights, with all setups",
    ),
];

/// Layouts of light maps with the programs that have them.
const ORIENTATIONS: [(Orientation, &str); 3] = [
    (Orientation::Blender, "Blender, three.js"),
    (Orientation::Openexr, "OpenEXR, USD, Mitsuba"),
    (Orientation::Nvdiffrec, "nvdiffrec"),
];

/// The question while it is open.
pub(super) struct Programs {
    forms: BTreeSet<Form>,
    width: u32,
    orientation: Orientation,
    yaw_deg: f32,
    per_lamp: bool,
    calibration: bool,
    index: f32,
}

impl Default for Programs {
    fn default() -> Self {
        Self {
            forms: Form::USUAL.into_iter().collect(),
            width: 1024,
            orientation: Orientation::default(),
            yaw_deg: 0.0,
            per_lamp: false,
            calibration: false,
            index: refractive_index(USUAL_F0),
        }
    }
}

impl Programs {
    /// Asks for the web page alone.
    pub(super) fn choose_web_page(&mut self) {
        self.forms = BTreeSet::from([Form::Web]);
    }

    /// The question about an object that reflects this much at normal incidence, where that is known.
    pub(super) fn of(known_reflectance: Option<f32>) -> Self {
        let reflectance = known_reflectance.unwrap_or(USUAL_F0);
        Self {
            index: refractive_index(reflectance),
            ..Self::default()
        }
    }

    /// Shows the question; `cameras` is how many are known, `folder` where the files go.
    pub(super) fn show(
        &mut self,
        ctx: &egui::Context,
        cameras: usize,
        folder: Option<&Path>,
    ) -> Answer {
        let mut answer = Answer::Nothing;
        let modal = egui::Modal::new(egui::Id::unique("programs"))
            .frame(theme::dialog(ctx))
            .show(ctx, |ui| {
                ui.set_width(460.0);
                ui.heading("Export for other programs");
                ui.label("The object and the light of the setup that is shown; a web page has all setups.");
                ui.add_space(theme::GAP * 0.5);
                egui::Grid::new("programs settings")
                    .num_columns(2)
                    .spacing([16.0, 8.0])
                    .show(ui, |ui| {
                        self.forms_ui(ui, cameras);
                        self.maps_ui(ui);
                        self.scale_ui(ui);
                        if folder_ui(ui, folder) {
                            answer = Answer::ChooseFolder;
                        }
                    });
                ui.add_space(theme::GAP * 0.5);
                ui.weak(
                    "Highlights in glTF, USD and Blender's Principled have longer tails; README.txt in the folder says how near \
                     each comes.",
                );
                ui.add_space(theme::GAP * 0.5);
                let problem = match folder {
                    None => Some("Choose a folder first"),
                    Some(_) if self.forms.is_empty() => Some("Choose at least one program"),
                    Some(_) => None,
                };
                let given = buttons(ui, problem);
                if given != Answer::Nothing {
                    answer = given;
                }
            });
        if modal.should_close() && answer == Answer::Nothing {
            answer = Answer::Closed;
        }
        answer
    }

    fn forms_ui(&mut self, ui: &mut egui::Ui, cameras: usize) {
        for (row, pair) in FORMS.chunks(2).enumerate() {
            ui.label(if row == 0 { "For" } else { "" });
            ui.columns(2, |columns| {
                for (ui, &(form, name, tip)) in columns.iter_mut().zip(pair) {
                    let possible = cameras > 0 || !matches!(form, Form::Cameras | Form::Layers);
                    let mut chosen = possible && self.forms.contains(&form);
                    let response = ui
                        .add_enabled(possible, egui::Checkbox::new(&mut chosen, name))
                        .on_hover_text(tip)
                        .on_disabled_hover_text("Open the capture for its cameras");
                    if response.changed() || !possible {
                        if chosen {
                            self.forms.insert(form);
                        } else {
                            self.forms.remove(&form);
                        }
                    }
                }
            });
            ui.end_row();
        }
    }

    fn maps_ui(&mut self, ui: &mut egui::Ui) {
        ui.label("Light maps");
        ui.horizontal(|ui| {
            egui::ComboBox::from_id_salt("width of light maps")
                .selected_text(format!("{} × {}", self.width, self.width / 2))
                .width(110.0)
                .show_ui(ui, |ui| {
                    for width in [512, 1024, 2048, 4096, 8192] {
                        let name = format!("{width} × {}", width / 2);
                        ui.selectable_value(&mut self.width, width, name);
                    }
                })
                .response
                .on_hover_text("Pixels of light maps");
            let shown = ORIENTATIONS.iter().find(|o| o.0 == self.orientation);
            egui::ComboBox::from_id_salt("layout of light maps")
                .selected_text(shown.map_or("", |o| o.1))
                .width(170.0)
                .show_ui(ui, |ui| {
                    for (orientation, name) in &ORIENTATIONS {
                        ui.selectable_value(&mut self.orientation, *orientation, *name);
                    }
                })
                .response
                .on_hover_text(
                    "Whose layout light.exr and light.hdr have; files of one program have its own",
                );
            ui.add(
                egui::DragValue::new(&mut self.yaw_deg)
                    .range(-180.0..=180.0)
                    .suffix("°"),
            )
            .accessible_name("Rotation")
            .on_hover_text("Rotation of light.exr and light.hdr to the right, degrees");
        });
        ui.end_row();
        ui.label("");
        ui.horizontal(|ui| {
            ui.checkbox(&mut self.per_lamp, "One for each light")
                .on_hover_text("A map for every light, and one of the rest");
            ui.checkbox(&mut self.calibration, "Marked axes")
                .on_hover_text(
                    "A map with red +X, green +Y and blue +Z, to see how a program turns it",
                );
        });
        ui.end_row();
    }

    fn scale_ui(&mut self, ui: &mut egui::Ui) {
        ui.label("Index of refraction");
        ui.add(
            egui::DragValue::new(&mut self.index)
                .range(1.05..=3.0)
                .speed(0.01)
                .max_decimals(3),
        )
        .accessible_name("Index of refraction")
        .on_hover_text(
            "Photographs leave the scale between light and colours open: the brighter the surface reflects, the weaker is the light. \
             Where the light was given, this follows from it",
        );
        ui.end_row();
    }

    /// The command that writes what was asked for into a folder; `cameras` are those of the capture.
    pub(super) fn command(
        &self,
        document: &Document,
        cameras: Vec<(String, Camera)>,
        folder: &Path,
    ) -> Command {
        let handed = Handed {
            solution: Arc::clone(document.solution()),
            lighting: document.light().lighting,
            names: setups::names(document.look()),
            setups: setups::of_document(document),
            cameras,
            anchor: Anchor::F0(reflectance(self.index)),
            job: Job {
                forms: self.forms.clone(),
                layout: MapLayout {
                    width: self.width,
                    orientation: self.orientation,
                    yaw_deg: self.yaw_deg,
                },
                per_lamp: self.per_lamp,
                calibration: self.calibration,
                page: PAGE.to_owned(),
                folder: folder.to_owned(),
            },
        };
        Command::Task {
            what: "Exporting".to_owned(),
            work: Box::new(move |tell, stop| {
                let source = Source {
                    solution: &handed.solution,
                    lighting: &handed.lighting,
                    names: &handed.names,
                    cameras: &handed.cameras,
                    setups: &handed.setups,
                    anchor: handed.anchor,
                };
                let mut progress = |what: &str, part: f32| {
                    let _ = tell(what, part);
                };
                match export(&source, &handed.job, stop, &mut progress) {
                    Ok(_) | Err(JobError::Stopped) => Ok(()),
                    Err(error) => Err(error.into()),
                }
            }),
        }
    }
}

/// What the worker needs, its own.
struct Handed {
    solution: Arc<Solution>,
    lighting: Lighting,
    names: Vec<String>,
    setups: Vec<Setup>,
    cameras: Vec<(String, Camera)>,
    anchor: Anchor,
    job: Job,
}
