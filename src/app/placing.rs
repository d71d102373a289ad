//! Where the mesh of a capture lies: offered to be aligned where it does not fit, then to be saved or undone. The history of the
//! capture's page is here, too.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::{self, RichText};
use glam::DMat4;

use super::commands::Action;
use super::history::History;
use super::known_light::GivenLight;
use super::points::progress_ui;
use super::projects::Then;
use super::theme::{self, Mark};
use super::{Request, Shared};
use crate::worker::{Latest, OpenedCapture, Purpose, Source, Worker};
use rekindle_estimate::align::MarkedPoint;
use rekindle_estimate::preflight::Report;
use rekindle_solution::{manifest_of, write_mesh_transform, write_placed_mesh};

/// Overlap below which an alignment is doubtful.
const DOUBTFUL: f64 = 0.9;

/// What an alignment brought.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outcome {
    /// Mean overlap of the silhouettes before and after, where photographs tell it.
    pub(super) overlap: [Option<f64>; 2],
    /// Whether another rotation fits as well.
    pub(super) ambiguous: bool,
}

/// A capture with its mesh in one place, and the light that is given with it.
#[derive(Clone)]
pub(super) struct State {
    pub(super) opened: Arc<OpenedCapture>,
    /// Points that were marked by then.
    pub(super) points: Vec<MarkedPoint>,
    /// From where the mesh lay when it was read.
    pub(super) moved: DMat4,
    pub(super) outcome: Option<Outcome>,
    /// The picture of the light, where it is known.
    pub(super) light: Option<GivenLight>,
}

/// What came of writing a file: the file, the place that the capture's file has now, and the one that this file holds.
type Saved = Result<(PathBuf, DMat4, DMat4), String>;

/// The place of the mesh now, those before and after, and the place that the capture's file has.
pub(super) struct Placing {
    pub(super) now: State,
    history: History<State>,
    written: DMat4,
    /// The place that the last file written holds.
    kept: DMat4,
    saving: bool,
    saved: Arc<Latest<Saved>>,
    /// What to do once the place is written.
    then: Option<Then>,
}

impl Placing {
    pub(super) fn new(opened: OpenedCapture) -> Self {
        Self {
            now: State {
                opened: Arc::new(opened),
                points: Vec::new(),
                moved: DMat4::IDENTITY,
                outcome: None,
                light: None,
            },
            history: History::new(),
            written: DMat4::IDENTITY,
            kept: DMat4::IDENTITY,
            saving: false,
            saved: Arc::default(),
            then: None,
        }
    }

    /// Takes another place of the mesh, which can be undone.
    pub(super) fn change(&mut self, next: State) {
        self.history.keep(std::mem::replace(&mut self.now, next));
    }

    /// Keeps the light before a change, which can be undone.
    pub(super) fn keep_light(&mut self, before: Option<GivenLight>) {
        self.history.keep(State {
            light: before,
            ..self.now.clone()
        });
    }

    pub(super) fn can_undo(&self) -> bool {
        self.history.can_undo()
    }

    pub(super) fn can_redo(&self) -> bool {
        self.history.can_redo()
    }

    pub(super) fn undo(&mut self) {
        self.history.undo(&mut self.now);
    }

    pub(super) fn redo(&mut self) {
        self.history.redo(&mut self.now);
    }

    /// The file of the capture into which the place can be written.
    fn manifest(&self) -> Option<PathBuf> {
        match &self.now.opened.source {
            Source::Demo => None,
            Source::Path(path) => manifest_of(path),
        }
    }

    /// Whether the mesh lies elsewhere than any file says.
    pub(super) fn is_unsaved(&self) -> bool {
        ![self.written, self.kept].contains(&self.now.moved)
    }

    /// Writes the place into the capture's file, or, where there is none, asks where to write the mesh; then something else is
    /// to be done.
    pub(super) fn save_place(&mut self, worker: &mut Worker, then: Then) {
        self.then = Some(then);
        match self.manifest() {
            Some(manifest) => self.save(worker, manifest),
            None => self.pick_mesh(worker),
        }
    }

    fn pick_mesh(&self, worker: &mut Worker) {
        let folder = match &self.now.opened.source {
            Source::Demo => None,
            Source::Path(path) => Some(path.as_path()),
        };
        worker.pick(Purpose::SaveMesh, folder);
    }

    /// Writes the place into the capture's file.
    fn save(&mut self, worker: &mut Worker, manifest: PathBuf) {
        self.saving = true;
        let (moved, saved) = (self.now.moved, Arc::clone(&self.saved));
        let mesh = &self.now.opened.capture.mesh;
        let further = mesh.world_transform(&(moved * self.written.inverse()));
        worker.aside("place", move || {
            let written = write_mesh_transform(&manifest, &further);
            saved.store(match written {
                Ok(()) => Ok((manifest, moved, moved)),
                Err(error) => Err(problem(&manifest, &error)),
            });
        });
    }

    /// Writes the mesh where it lies now.
    pub(super) fn save_mesh(&mut self, worker: &mut Worker, path: PathBuf) {
        self.saving = true;
        let (opened, saved) = (Arc::clone(&self.now.opened), Arc::clone(&self.saved));
        let (written, moved) = (self.written, self.now.moved);
        worker.aside("mesh", move || {
            saved.store(match write_placed_mesh(&path, &opened.capture.mesh) {
                // The capture's own file still has the old place.
                Ok(()) => Ok((path, written, moved)),
                Err(error) => Err(problem(&path, &error)),
            });
        });
    }

    /// What came of saving, once: the file and what to do then, or what went wrong.
    pub(super) fn take_saved(&mut self) -> Option<Result<(PathBuf, Option<Then>), String>> {
        let saved = self.saved.take()?;
        self.saving = false;
        let then = self.then.take();
        Some(saved.map(|(path, written, kept)| {
            (self.written, self.kept) = (written, kept);
            (path, then)
        }))
    }

    /// Shows the card, if there is something to say. Whether points are to be set.
    pub(super) fn show(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) -> bool {
        let report = &self.now.opened.report;
        if shared.aligning.is_none() && self.now.outcome.is_none() && !report.is_misplaced() {
            return false;
        }
        let (mark, title, text) = match self.now.outcome {
            Some(outcome) => outcome.told(),
            None => misplaced(report),
        };
        let mut by_points = false;
        theme::card(ui).show(ui, |ui| {
            ui.set_width(ui.available_width());
            ui.horizontal_top(|ui| {
                mark.show(ui);
                ui.vertical(|ui| {
                    ui.label(RichText::new(title).strong());
                    ui.label(text);
                    ui.add_space(6.0);
                    match shared.aligning {
                        Some(part) => progress_ui(ui, shared, part),
                        None => by_points = self.buttons_ui(ui, shared),
                    }
                });
            });
        });
        ui.add_space(theme::GAP);
        by_points
    }

    /// What can be done about it. Whether points are to be set.
    fn buttons_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) -> bool {
        let mut by_points = false;
        ui.horizontal_wrapped(|ui| {
            if self.now.outcome.is_some() {
                self.save_ui(ui, shared);
                let undo = egui::Button::new("Undo").min_size(egui::vec2(0.0, theme::TALL));
                let undo = ui.add_enabled(!shared.busy, undo);
                if undo
                    .on_hover_text(
                        "Undo the last change, of the mesh's place or of the light (Ctrl+Z)",
                    )
                    .clicked()
                {
                    shared.actions.push(Request::Action(Action::Undo));
                }
            } else {
                let align = theme::main_button(ui, "Align");
                let align = ui.add_enabled(!shared.busy, align).on_hover_text(
                    "Find the mesh's place, size and turn by the photographs' silhouettes",
                );
                if align.clicked() {
                    shared.actions.push(Request::Action(Action::Align));
                }
            }
            let points = ui.add_enabled(
                !shared.busy,
                egui::Button::new("Align by points…").min_size(egui::vec2(0.0, theme::TALL)),
            );
            by_points = points
                .on_hover_text("Set points on the mesh and mark them in photographs, to begin with")
                .clicked();
        });
        by_points
    }

    fn save_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        let unsaved = self.written != self.now.moved && !self.saving;
        if let Some(manifest) = self.manifest() {
            let name = if unsaved || self.saving {
                "Save in the capture"
            } else {
                "Saved in the capture"
            };
            let save = ui
                .add_enabled(unsaved, theme::main_button(ui, name))
                .on_hover_text(format!(
                    "Write the mesh's place as mesh_transform into {}; the mesh's file stays as it is",
                    manifest.display()
                ));
            if save.clicked() {
                self.then = None;
                self.save(shared.worker, manifest);
            }
        }
        let save = egui::Button::new("Save the mesh as…").min_size(egui::vec2(0.0, theme::TALL));
        let save = ui
            .add_enabled(!self.saving, save)
            .on_hover_text("Write the mesh where it lies now as an OBJ file");
        if save.clicked() {
            self.then = None;
            self.pick_mesh(shared.worker);
        }
    }
}

impl Outcome {
    fn told(self) -> (Mark, &'static str, String) {
        let overlap = match self.overlap {
            [Some(before), Some(after)] => format!(
                "Silhouettes overlap by {:.1} %, before by {:.1} %.",
                100.0 * after,
                100.0 * before
            ),
            _ => "The mesh lies where the points say; no photograph has alpha or a mask to check it by."
                .to_owned(),
        };
        if self.overlap[1].is_some_and(|after| after < DOUBTFUL) {
            let text = overlap + " That is little: align by points, and check masks and lenses.";
            (Mark::Warning, "Aligned, but doubtful", text)
        } else if self.ambiguous {
            let text = overlap
                + " Another rotation fits as well, the object being symmetric in silhouette: \
                   compare it with the photographs, or align by points.";
            (Mark::Warning, "Aligned, but not for certain", text)
        } else {
            (Mark::Good, "Aligned", overlap)
        }
    }
}

fn misplaced(report: &Report) -> (Mark, &'static str, String) {
    let text = match report.mean_overlap() {
        None => "No camera sees it, and no photograph has alpha or a mask: align it by points."
            .to_owned(),
        Some(_) if !report.is_seen() => {
            "No camera sees it: it may be in another frame than the cameras.".to_owned()
        }
        Some(overlap) => format!(
            "Silhouettes overlap by only {:.1} % on average: it may be in another frame than the cameras.",
            100.0 * overlap
        ),
    };
    (
        Mark::Warning,
        "The mesh is not where the photographs show it",
        text,
    )
}

fn problem(path: &Path, error: &std::io::Error) -> String {
    format!(
        "{}: can't be written: {error}; save the mesh in another place",
        path.display()
    )
}
