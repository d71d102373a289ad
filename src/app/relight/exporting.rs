//! The question what to export, and the progress of an export.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use eframe::egui;
use serde::{Deserialize, Serialize};

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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Subject {
    View,
    Cameras,
    Turntable,
    Lamp,
}

/// What is exported and how; remembered for the next time.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "one for each box that can be ticked"
)]
pub struct Question {
    /// Where the files go.
    pub folder: Option<PathBuf>,
    /// Seconds that a million pixels took the last time.
    pub seconds_per_megapixel: Option<f64>,
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
    /// The files' name, where it was typed.
    #[serde(skip)]
    name: Option<String>,
    /// Files that are there already, while it is asked what to do about them.
    #[serde(skip)]
    there_already: usize,
}

/// What the picture on the screen is like.
pub(super) struct Screen<'a> {
    /// The camera and its place on the window.
    pub(super) seen: &'a Seen,
    /// Names and cameras of the input views.
    pub(super) cameras: &'a [(String, Camera)],
    /// Index of the one that is looked through.
    pub(super) at: Option<usize>,
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
    ChooseFolder,
    /// The files are to be made.
    Export(Others),
}

/// What becomes of files that are there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::app) enum Others {
    /// It is asked, if there are any.
    Asked,
    /// They are replaced.
    Replaced,
    /// They stay, and new ones get a number.
    Kept,
}

impl Default for Question {
    fn default() -> Self {
        Self {
            folder: None,
            seconds_per_megapixel: None,
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
            name: None,
            there_already: 0,
        }
    }
}

impl Question {
    /// Shows the question; `job` is what it comes to in a folder, `lamp` the name of the selected lamp, and a file is `taken`
    /// that is there or will be.
    pub(super) fn show(
        &mut self,
        ctx: &egui::Context,
        cameras: usize,
        lamp: Option<&str>,
        automatic: &str,
        job: impl Fn(&Self, &Path) -> Option<Job>,
        taken: impl Fn(&Path) -> bool,
    ) -> Answer {
        let mut answer = Answer::Nothing;
        let modal = egui::Modal::new(egui::Id::unique("export"))
            .frame(theme::dialog(ctx))
            .show(ctx, |ui| {
                ui.set_width(460.0);
                ui.heading("Export pictures");
                ui.label(
                    "Pictures by the reference renderer, in the light of the setup that is shown.",
                );
                ui.add_space(theme::GAP * 0.5);
                let height = ui.ctx().content_rect().height() - 230.0;
                egui::ScrollArea::vertical()
                    .max_height(height)
                    .show(ui, |ui| {
                        egui::Grid::new("export settings")
                            .num_columns(2)
                            .spacing([16.0, 8.0])
                            .show(ui, |ui| {
                                self.subject_ui(ui, cameras, lamp);
                                self.size_ui(ui);
                                self.files_ui(ui);
                                self.name_ui(ui, automatic);
                                if folder_ui(ui, self.folder.as_deref()) {
                                    answer = Answer::ChooseFolder;
                                }
                            });
                    });
                ui.add_space(theme::GAP * 0.5);
                let folder = self.folder.clone().unwrap_or_default();
                if let Some(job) = job(self, &folder) {
                    ui.weak(self.cost(&job));
                }
                ui.add_space(theme::GAP * 0.5);
                let given = if self.there_already > 0 {
                    others_ui(ui, self.there_already)
                } else {
                    buttons(ui, self.problem())
                };
                if given != Answer::Nothing {
                    answer = given;
                }
            });
        if modal.should_close() && answer == Answer::Nothing {
            answer = Answer::Closed;
        }
        if answer != Answer::Nothing {
            self.there_already = 0;
        }
        if answer == Answer::Export(Others::Asked)
            && let Some(folder) = &self.folder
        {
            let there = job(self, folder).map_or(0, |job| job.there_already(taken));
            if there > 0 {
                self.there_already = there;
                answer = Answer::Nothing;
            }
        }
        answer
    }

    /// How many pictures there will be, how large, and how long it takes, as far as that is known.
    fn cost(&self, job: &Job) -> String {
        let count = match job.shots.len() {
            1 => "One picture".to_owned(),
            n => format!("{n} pictures"),
        };
        let bytes = size_in_words(job.most_bytes());
        let megapixels = megapixels(job);
        let time = self.seconds_per_megapixel.map_or_else(
            || "how long they take is known after the first export".to_owned(),
            |seconds| format!("about {}", duration_in_words(seconds * megapixels)),
        );
        format!("{count}, {megapixels:.1} megapixels, at most {bytes}; {time}")
    }

    /// Why there is nothing to export.
    fn problem(&self) -> Option<&'static str> {
        let animated = self.is_moving() && self.animation;
        if self.folder.is_none() {
            Some("Choose a folder first")
        } else if !(self.png || self.exr || animated) {
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

    fn name_ui(&mut self, ui: &mut egui::Ui, automatic: &str) {
        let label = ui.label("Name");
        let mut text = self.name.clone().unwrap_or_else(|| automatic.to_owned());
        let field = egui::TextEdit::singleline(&mut text).desired_width(300.0);
        let field = ui.add(field).labelled_by(label.id);
        let tip = "Of the files; frames and cameras get numbers. By itself it is that of project, setup and view";
        if field.on_hover_text(tip).changed() {
            self.name = Some(text).filter(|text| !text.trim().is_empty());
        }
        ui.end_row();
    }

    /// The name of the files where none was typed: project, setup and view.
    pub(super) fn automatic_name(&self, document: &Document, at: Option<usize>) -> String {
        let name = format!("{} {}", document.name(), document.look().name);
        let at = at.filter(|_| self.subject == Subject::View);
        let name = at.map_or(name.clone(), |at| format!("{name} camera {}", at + 1));
        file_name(&name)
    }

    /// The name of the files.
    pub(super) fn file_name(&self, document: &Document, at: Option<usize>) -> String {
        match &self.name {
            Some(name) => file_name(name),
            None => self.automatic_name(document, at),
        }
    }

    /// Forgets a name that was typed, when another document is open.
    pub(in crate::app) fn forget_name(&mut self) {
        self.name = None;
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
        let name = self.file_name(document, screen.at);
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
            .map(|(stem, camera)| Shot {
                lighting: match document.solution().lighting_before(&lighting, &camera) {
                    Cow::Borrowed(_) => Arc::clone(&lighting),
                    Cow::Owned(before) => Arc::new(before),
                },
                stem,
                camera,
            })
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
    }
}

/// The folder that files go to; whether another is to be chosen.
pub(super) fn folder_ui(ui: &mut egui::Ui, folder: Option<&Path>) -> bool {
    ui.label("Folder");
    let chosen = ui.horizontal(|ui| {
        let choose = ui.button("Choose folder…");
        let shown = folder.map(|f| f.display().to_string());
        let shown = shown.unwrap_or_else(|| "None is chosen".to_owned());
        let label = ui.add(egui::Label::new(egui::RichText::new(&shown).weak()).truncate());
        label.on_hover_text(shown);
        choose.on_hover_text("Choose where the files go").clicked()
    });
    ui.end_row();
    chosen.inner
}

/// What to do about files that are there already.
fn others_ui(ui: &mut egui::Ui, count: usize) -> Answer {
    let mut answer = Answer::Nothing;
    ui.label(match count {
        1 => "A file of this name is in the folder already, or will be.".to_owned(),
        n => format!("{n} files of these names are in the folder already, or will be."),
    });
    ui.horizontal(|ui| {
        for (name, tip, others) in [
            (
                "Keep both",
                "The new files get a number",
                Some(Others::Kept),
            ),
            (
                "Replace",
                "The new files take their places; only files that this program wrote are replaced",
                Some(Others::Replaced),
            ),
            ("Cancel", "Back to work", None),
        ] {
            if ui.button(name).on_hover_text(tip).clicked() {
                answer = others.map_or(Answer::Closed, Answer::Export);
            }
        }
    });
    answer
}

/// Millions of pixels of a job.
pub(super) fn megapixels(job: &Job) -> f64 {
    let pixels = |shot: &Shot| f64::from(shot.camera.width) * f64::from(shot.camera.height);
    job.shots.iter().map(pixels).sum::<f64>() / 1e6
}

fn size_in_words(bytes: u64) -> String {
    let megabytes = bytes as f64 / 1e6;
    if megabytes < 1000.0 {
        format!("{:.0} MB", megabytes.ceil())
    } else {
        format!("{:.1} GB", megabytes / 1e3)
    }
}

/// A time as people say it.
pub(in crate::app) fn duration_in_words(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{:.0} s", s.ceil()),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// The buttons of a question about exports; `problem` says why there is nothing to export.
pub(super) fn buttons(ui: &mut egui::Ui, problem: Option<&str>) -> Answer {
    let mut answer = Answer::Nothing;
    ui.horizontal(|ui| {
        let button = ui.add_enabled(problem.is_none(), theme::main_button(ui, "Export"));
        if button
            .on_hover_text("Make the files; it goes on beside other work and can be stopped. While others are made it waits in line")
            .on_disabled_hover_text(problem.unwrap_or_default())
            .clicked()
        {
            answer = Answer::Export(Others::Asked);
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

/// The command that makes the pictures of a job. `kept` hears how many files are there if it is stopped.
pub(super) fn command(solution: &Arc<Solution>, job: Job, kept: Arc<AtomicUsize>) -> Command {
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
                Ok(_) => Ok(()),
                Err(ExportError::Stopped { kept: files }) => {
                    kept.store(files, Ordering::Relaxed);
                    Ok(())
                }
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
