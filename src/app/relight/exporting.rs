//! The question what to export, and the progress of an export.

use std::path::Path;
use std::sync::Arc;

use eframe::egui;

use super::handles::Seen;
use crate::app::theme;
use crate::worker::Command;
use rekindle_capture::Camera;
use rekindle_output::export::{
    Depth, ExportError, Job, MAX_ANIMATION_SIDE, MAX_SIDE, Renderer, Shot, export, lamp_circle,
    turntable, with_size,
};
use rekindle_relight::ViewTransform;
use rekindle_solution::Solution;
use rekindle_studio::{Document, LampId};

/// From where pictures are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Subject {
    View,
    Cameras,
    Turntable,
    Lamp,
}

/// The question while it is open.
#[expect(
    clippy::struct_excessive_bools,
    reason = "one for each box that can be ticked"
)]
pub(super) struct Question {
    subject: Subject,
    size: [u32; 2],
    /// Cameras keep their own size.
    own_size: bool,
    png: bool,
    sixteen: bool,
    exr: bool,
    layers: bool,
    animation: bool,
    frames: u32,
    frames_per_second: u16,
    transparent: bool,
    edits: bool,
}

/// What the picture on the screen is like.
pub(super) struct Screen<'a> {
    /// The camera and its place on the window.
    pub(super) seen: &'a Seen,
    /// Names and cameras of the input views.
    pub(super) cameras: &'a [(String, Camera)],
    /// How radiance is shown.
    pub(super) transform: ViewTransform,
    /// Factor of radiance before the view transform.
    pub(super) exposure: f32,
    /// Display values of the background.
    pub(super) background: [f32; 3],
}

/// What came of a frame of the question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// It stays open.
    Nothing,
    /// It is to be closed.
    Closed,
    /// A folder is to be chosen.
    Export,
}

impl Default for Question {
    fn default() -> Self {
        Self {
            subject: Subject::View,
            size: [1920, 1080],
            own_size: true,
            png: true,
            sixteen: false,
            exr: false,
            layers: true,
            animation: true,
            frames: 48,
            frames_per_second: 24,
            transparent: false,
            edits: false,
        }
    }
}

impl Question {
    /// Shows the question. `lamp` is the name of the selected lamp.
    pub(super) fn show(
        &mut self,
        ctx: &egui::Context,
        cameras: usize,
        lamp: Option<&str>,
    ) -> Answer {
        let mut answer = Answer::Nothing;
        let modal = egui::Modal::new(egui::Id::unique("export"))
            .frame(theme::dialog(ctx))
            .show(ctx, |ui| {
                ui.set_width(460.0);
                ui.heading("Export");
                ui.label(
                    "Pictures by the reference renderer, in the light of the setup that is shown.",
                );
                ui.add_space(theme::GAP * 0.5);
                egui::Grid::new("export settings")
                    .num_columns(2)
                    .spacing([16.0, 8.0])
                    .show(ui, |ui| {
                        self.subject_ui(ui, cameras, lamp);
                        self.size_ui(ui);
                        self.files_ui(ui);
                    });
                ui.add_space(theme::GAP * 0.5);
                answer = buttons(ui, self.problem());
            });
        if modal.should_close() && answer == Answer::Nothing {
            answer = Answer::Closed;
        }
        answer
    }

    /// Why there is nothing to export.
    fn problem(&self) -> Option<&'static str> {
        let animated = self.is_moving() && self.animation;
        if !(self.png || self.exr || animated) {
            Some("Choose at least one kind of file")
        } else if animated && self.size.iter().any(|side| *side > MAX_ANIMATION_SIDE) {
            Some("Animations are at most 4096 × 4096")
        } else {
            None
        }
    }

    fn is_moving(&self) -> bool {
        matches!(self.subject, Subject::Turntable | Subject::Lamp)
    }

    fn subject_ui(&mut self, ui: &mut egui::Ui, cameras: usize, lamp: Option<&str>) {
        let choices = [
            (Subject::View, "This view".to_owned(), true, ""),
            (
                Subject::Cameras,
                match cameras {
                    0 => "All input cameras".to_owned(),
                    n => format!("All {n} input cameras"),
                },
                cameras > 0,
                "Open the capture for its cameras",
            ),
            (
                Subject::Turntable,
                "A turn around the object".to_owned(),
                true,
                "",
            ),
            (
                Subject::Lamp,
                lamp.map_or_else(
                    || "The selected light circling the object".to_owned(),
                    |name| format!("{name} circling the object"),
                ),
                lamp.is_some(),
                "Select a light first",
            ),
        ];
        for (i, (subject, name, possible, why_not)) in choices.into_iter().enumerate() {
            if !possible && self.subject == subject {
                self.subject = Subject::View;
            }
            ui.label(if i == 0 { "What" } else { "" });
            let button = egui::RadioButton::new(self.subject == subject, name);
            let response = ui.add_enabled(possible, button);
            if response.on_disabled_hover_text(why_not).clicked() {
                self.subject = subject;
            }
            ui.end_row();
        }
        if self.is_moving() {
            ui.label("Frames");
            ui.horizontal(|ui| {
                ui.add(egui::DragValue::new(&mut self.frames).range(2..=1000))
                    .accessible_name("Frames")
                    .on_hover_text("Pictures in a full turn");
                ui.label("at");
                ui.add(
                    egui::DragValue::new(&mut self.frames_per_second)
                        .range(1..=60)
                        .suffix(" per second"),
                )
                .accessible_name("Frames per second")
                .on_hover_text("How fast the animation plays");
            });
            ui.end_row();
        }
    }

    fn size_ui(&mut self, ui: &mut egui::Ui) {
        ui.label("Size");
        ui.horizontal(|ui| {
            if self.subject == Subject::Cameras {
                ui.checkbox(&mut self.own_size, "As photographed")
                    .on_hover_text("Every camera keeps the size of its photograph");
            }
            ui.add_enabled_ui(self.subject != Subject::Cameras || !self.own_size, |ui| {
                for (side, name) in [(0, "Width"), (1, "Height")] {
                    if side == 1 {
                        ui.label("×");
                    }
                    ui.add(egui::DragValue::new(&mut self.size[side]).range(1..=MAX_SIDE))
                        .accessible_name(name)
                        .on_hover_text("Pixels, up to 8192; each is the mean of sixteen samples");
                }
                ui.menu_button("Presets", |ui| {
                    for (name, size) in [
                        ("1280 × 720", [1280, 720]),
                        ("1920 × 1080", [1920, 1080]),
                        ("3840 × 2160", [3840, 2160]),
                        ("2048 × 2048", [2048, 2048]),
                        ("8192 × 8192", [8192, 8192]),
                    ] {
                        if ui.button(name).clicked() {
                            self.size = size;
                            ui.close();
                        }
                    }
                })
                .response
                .on_hover_text("Usual sizes");
            });
        });
        ui.end_row();
    }

    fn files_ui(&mut self, ui: &mut egui::Ui) {
        ui.label("Files");
        ui.horizontal(|ui| {
            ui.checkbox(&mut self.png, "PNG")
                .on_hover_text("As shown: exposure and view transform of the viewport");
            ui.add_enabled_ui(self.png, |ui| {
                ui.selectable_value(&mut self.sixteen, false, "8 bit");
                ui.selectable_value(&mut self.sixteen, true, "16 bit");
            });
        });
        ui.end_row();
        ui.label("");
        ui.horizontal(|ui| {
            ui.checkbox(&mut self.exr, "EXR")
                .on_hover_text("Linear radiance, 32-bit float, premultiplied alpha");
            ui.add_enabled(self.exr, egui::Checkbox::new(&mut self.layers, "Layers"))
                .on_hover_text("Diffuse, specular, albedo, irradiance, normal, position, depth and the light of each light beside the picture");
        });
        ui.end_row();
        if self.is_moving() {
            ui.label("");
            ui.checkbox(&mut self.animation, "Animated PNG")
                .on_hover_text("One file that browsers play");
            ui.end_row();
        }
        ui.label("");
        ui.checkbox(&mut self.edits, "Light edits (edits.json)")
            .on_hover_text("A JSON file with which rekindle render --edits gives this light");
        ui.end_row();
        ui.label("Background");
        let shown = self.png || self.is_moving() && self.animation;
        let transparent = egui::Checkbox::new(&mut self.transparent, "Transparent");
        ui.add_enabled(shown, transparent)
            .on_hover_text("Without it, PNG files have the background of the viewport");
        ui.end_row();
    }

    /// What is to be made, in a folder.
    pub(super) fn job(
        &self,
        document: &Document,
        lamp: Option<LampId>,
        screen: &Screen<'_>,
        folder: &Path,
    ) -> Job {
        let light = document.light();
        let lighting = Arc::new(light.lighting);
        let name = file_name(&document.name());
        let [width, height] = self.size;
        let view = with_size(&screen.seen.camera, width, height);
        let shot = |stem: String, camera: Camera| Shot {
            stem,
            camera,
            lighting: Arc::clone(&lighting),
        };
        let stem = |frame: usize| format!("{name}_{frame:04}");
        let shots = match self.subject {
            Subject::View => vec![shot(name.clone(), view)],
            Subject::Cameras => camera_shots(screen.cameras, |camera| {
                if self.own_size {
                    camera.clone()
                } else {
                    with_size(camera, width, height)
                }
            })
            .map(|(stem, camera)| shot(stem, camera))
            .collect(),
            Subject::Turntable => {
                let solution = document.solution();
                let (centre, up) = (solution.mesh.centre(), solution.grid.up);
                let turn = turntable(&view, centre.as_dvec3(), up.as_dvec3(), self.frames);
                let frames = turn.into_iter().enumerate();
                frames.map(|(i, camera)| shot(stem(i), camera)).collect()
            }
            Subject::Lamp => {
                let index = light.lamps.iter().position(|id| Some(*id) == lamp);
                let circle = lamp_circle(&lighting, index.unwrap_or(usize::MAX), self.frames);
                let frames = circle.into_iter().enumerate();
                frames
                    .map(|(i, lighting)| Shot {
                        stem: stem(i),
                        camera: view.clone(),
                        lighting: Arc::new(lighting),
                    })
                    .collect()
            }
        };
        let moving = self.is_moving();
        Job {
            shots,
            png: self.png.then_some(if self.sixteen {
                Depth::Sixteen
            } else {
                Depth::Eight
            }),
            exr: self.exr,
            layers: self.layers,
            light_groups: self.layers,
            edits: self.edits.then(|| {
                let edits = document.look().edits(document.base());
                (format!("{name}_edits"), edits)
            }),
            animation: (moving && self.animation).then_some((name, self.frames_per_second)),
            transform: screen.transform,
            exposure: screen.exposure,
            background: (!self.transparent).then_some(screen.background),
            folder: folder.to_owned(),
        }
        .beside_others()
    }
}

/// The buttons of a question about exports; `problem` says why there is nothing to export.
pub(super) fn buttons(ui: &mut egui::Ui, problem: Option<&str>) -> Answer {
    let mut answer = Answer::Nothing;
    ui.horizontal(|ui| {
        let button = theme::main_button(ui, "Choose folder…");
        let button = ui.add_enabled(problem.is_none(), button);
        let tip = "Choose where the files go, then export; files that are there already stay, new ones get a number";
        if button
            .on_hover_text(tip)
            .on_disabled_hover_text(problem.unwrap_or_default())
            .clicked()
        {
            answer = Answer::Export;
        }
        if ui.button("Cancel").on_hover_text("Back to work").clicked() {
            answer = Answer::Closed;
        }
        if let Some(problem) = problem {
            ui.weak(problem);
        }
    });
    answer
}

/// The cameras of input views with file names that differ.
fn camera_shots(
    cameras: &[(String, Camera)],
    size: impl Fn(&Camera) -> Camera,
) -> impl Iterator<Item = (String, Camera)> {
    cameras.iter().enumerate().map(move |(i, (name, camera))| {
        let stem = Path::new(name).file_stem().unwrap_or_default();
        let stem = format!("{}_{:03}", file_name(&stem.to_string_lossy()), i + 1);
        (stem, size(camera))
    })
}

/// A name that any file system takes.
fn file_name(name: &str) -> String {
    let safe: String = name
        .chars()
        .map(|c| {
            if c.is_alphanumeric() || "-_. ".contains(c) {
                c
            } else {
                '_'
            }
        })
        .collect();
    let safe = safe.trim_matches([' ', '.']);
    if safe.is_empty() {
        "picture".to_owned()
    } else {
        safe.to_owned()
    }
}

/// The command that makes the pictures of a job.
pub(super) fn command(solution: &Arc<Solution>, job: Job) -> Command {
    let solution = Arc::clone(solution);
    Command::Task {
        what: "Exporting".to_owned(),
        work: Box::new(move |tell, stop| {
            let _ = tell("preparing", 0.0);
            let renderer = Renderer::new(&solution);
            let done = export(&renderer, &job, stop, &mut |part, what| {
                let _ = tell(what, part);
            });
            match done {
                Ok(_) | Err(ExportError::Stopped { .. }) => Ok(()),
                Err(error) => Err(error.into()),
            }
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_names_of_files() {
        for (name, file) in [
            ("Spot: evening/2", "Spot_ evening_2"),
            ("..", "picture"),
            ("Ölbild 3.1", "Ölbild 3.1"),
        ] {
            assert_eq!(file_name(name), file);
        }
    }
}
