//! The page on which the object is relit.
//!
//! The document is changed by [`looks`], [`lamps`] (shown by [`list`] and [`lamp_settings`]), [`surroundings`] and
//! [`hemisphere`] on the left, and over the viewport by [`handles`] and [`pointing`]. They share what is selected
//! ([`editing`]), and every change goes through the document's history, which [`steps`] shows. [`compass`] says where the
//! viewer is. [`exporting`] writes pictures, [`programs`] the object and its light for other programs.

mod compass;
mod editing;
mod exporting;
mod handles;
mod hemisphere;
mod lamp_settings;
mod lamps;
mod list;
mod looks;
mod photographs;
mod pointing;
mod programs;
mod steps;
mod surroundings;
#[cfg(test)]
mod tests;
mod whereabouts;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use eframe::egui;
use glam::Vec3;

use super::commands::Action;
use super::exports::Exports;
use super::viewport::{Object, Scene, Viewport};
use super::{Request, Shared, result, theme};
use crate::worker::{Command, Latest, Purpose, Rendered, Subject, Worker};
use editing::Editing;
use exporting::{Answer, Screen};
pub(super) use exporting::{Others, Question, duration_in_words};
use handles::{Handles, Seen};
use hemisphere::LitDisc;
use pointing::Pointing;
use programs::Programs;
use rekindle_capture::{Camera, Capture};
use rekindle_output::export::Job;
use rekindle_scene::hemisphere::FromAbove;
use rekindle_studio::{Document, Group, GroupId, Place};
use surroundings::Probes;
use whereabouts::Viewer;

/// Height of the settings that never move, points.
const PINNED: f32 = 222.0;
/// Least height of the list of lights with what is above it, points.
const LEAST_LIST: f32 = 150.0;
/// Least side of the hemisphere, points; its most, as a part of the window's height.
const LEAST_DISC: f32 = 90.0;
const MOST_DISC: f32 = 0.3;

/// A question about exports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    Pictures,
    Programs,
}

/// What is wrong with a file that was chosen on the page.
pub(super) enum Problem {
    /// A light probe.
    Probe(String),
    /// Photographs.
    Photographs(String),
}

/// An export under way.
#[derive(Clone, Debug)]
pub(super) struct Export {
    /// What it is called in the line.
    pub(super) name: String,
    /// Where to.
    pub(super) folder: PathBuf,
    /// The pictures that it will write.
    pub(super) files: Vec<PathBuf>,
    /// Millions of pixels that it makes; none where it is of other things, too.
    pub(super) megapixels: Option<f64>,
    /// Files that are there if it is stopped.
    pub(super) kept: Arc<AtomicUsize>,
}

/// A document that is being edited.
pub struct Relighting {
    document: Document,
    viewport: Viewport,
    editing: Editing,
    disc: LitDisc,
    handles: Handles,
    pointing: Pointing,
    probes: Probes,
    /// Pixels of the disc, once they are found.
    from_above: Arc<Latest<FromAbove>>,
    /// The capture's photographs, once they are read.
    photographs: Arc<Latest<photographs::Read>>,
    prepared: bool,
    /// The question that is open.
    question: Option<Asked>,
    /// The question that was answered last, while a folder is chosen and the files are made.
    answered: Asked,
    programs: Programs,
    /// Whether the list of steps is shown.
    history: bool,
}

impl Relighting {
    /// Shows a document; `capture` is what it was solved from, if that is open.
    pub fn new(document: Document, capture: Option<&Arc<Capture>>) -> Self {
        let solution = document.solution();
        let registered = capture.map(|capture| photographs::with_corrections(capture, solution));
        let mut viewport = Viewport::new(
            Object::Solution(Arc::clone(solution)),
            solution.grid.up,
            registered.as_ref(),
        );
        viewport.allow_comparison();
        viewport.set_white(solution.white());
        viewport.restore(&document.view);
        let programs = Programs::of(solution.known_reflectance());
        Self {
            document,
            viewport,
            editing: Editing::default(),
            disc: LitDisc::default(),
            handles: Handles::default(),
            pointing: Pointing::default(),
            probes: Probes::default(),
            from_above: Arc::default(),
            photographs: Arc::default(),
            prepared: false,
            question: None,
            answered: Asked::Pictures,
            programs,
            history: false,
        }
    }

    /// The document.
    pub fn document(&self) -> &Document {
        &self.document
    }

    /// The document.
    pub fn document_mut(&mut self) -> &mut Document {
        &mut self.document
    }

    /// Puts the view into the document, to be saved with it.
    pub fn note_view(&mut self) {
        self.document.view = self.viewport.state();
    }

    /// The view of the object.
    pub fn viewport(&self) -> &Viewport {
        &self.viewport
    }

    /// The view of the object.
    pub fn viewport_mut(&mut self) -> &mut Viewport {
        &mut self.viewport
    }

    /// Whether the photographs are not known.
    pub(super) fn lacks_photographs(&self) -> bool {
        self.viewport.lacks_photographs()
    }

    /// Reads photographs beside the window's thread, to compare with.
    pub(super) fn locate_photographs(&mut self, worker: &mut Worker, path: &Path) {
        let (slot, path) = (Arc::clone(&self.photographs), path.to_owned());
        let solution = Arc::clone(self.document.solution());
        worker.aside("photographs", move || {
            slot.store(photographs::read(&path, &solution).map(|capture| (path, capture)));
        });
    }

    /// Takes photographs that were read. Says what is wrong with them.
    fn take_photographs(&mut self) -> Option<String> {
        match self.photographs.take()? {
            Ok((path, capture)) => {
                self.document.capture = Some(path);
                self.viewport.set_photographs(capture);
                None
            }
            Err(problem) => Some(problem),
        }
    }

    /// Takes a picture of the reference renderer.
    pub fn rendered(&mut self, ctx: &egui::Context, rendered: &Rendered) {
        self.viewport.rendered(ctx, rendered);
    }

    /// Why a command about lamps and looks can't be given, if it can't.
    pub(super) fn obstacle(&self, action: Action) -> Option<&'static str> {
        let (possible, why_not) = match action {
            Action::AddLamp
            | Action::NextLamp
            | Action::AlsoNextLamp
            | Action::NextLook
            | Action::History => return None,
            Action::CompareCaptured => (
                looks::is_comparable(&self.document),
                "There is only the captured light so far.",
            ),
            Action::ResetLamp => (
                lamps::can_reset(&self.document, &self.editing),
                lamps::NO_RESET,
            ),
            Action::SelectAllLamps => (
                !self.document.look().lamps.is_empty(),
                "This setup has no lights.",
            ),
            Action::GroupLamps => (
                self.editing.selection(self.document.look()).len() > 1,
                "Select two lights or more first: with Ctrl, Shift or a rectangle on the hemisphere.",
            ),
            Action::UngroupLamps => (
                self.selected_groups().next().is_some(),
                "No selected light is in a group.",
            ),
            _ => (
                self.editing.selected(self.document.look()).is_some(),
                "Select a light first.",
            ),
        };
        (!possible).then_some(why_not)
    }

    /// Carries out a command about lamps and looks.
    pub(super) fn act(&mut self, action: Action) {
        let selected = self.editing.selection(self.document.look());
        let groups: Vec<GroupId> = self.selected_groups().collect();
        let (document, editing) = (&mut self.document, &mut self.editing);
        match action {
            Action::AddLamp => lamps::add(document, editing),
            Action::NextLamp => editing.select_next(document, false),
            Action::AlsoNextLamp => editing.select_next(document, true),
            Action::SelectAllLamps => editing.select_all(list::order(&list::lines(document))),
            Action::GroupLamps => lamps::group(document, editing),
            Action::UngroupLamps => lamps::ungroup(document, &groups),
            Action::NextLook => looks::next(document),
            Action::History => self.history = !self.history,
            Action::CompareCaptured => looks::compare(document, editing),
            Action::ResetLamp => lamps::reset(document, &selected),
            Action::Export => self.question = Some(Asked::Pictures),
            Action::ExportObject => self.question = Some(Asked::Programs),
            Action::ExportWeb => {
                self.programs.choose_web_page();
                self.question = Some(Asked::Programs);
            }
            Action::MuteLamp => lamps::mute(document, &selected),
            Action::SoloLamp => lamps::solo(document, &selected),
            Action::DuplicateLamp => lamps::duplicate(document, editing, &selected),
            Action::DeleteLamp => lamps::delete(document, editing, &selected),
            Action::PlaceHighlight => editing.place.0 = Place::Highlight,
            Action::PlaceBrightest => editing.place.0 = Place::Brightest,
            Action::PlaceRim => editing.place.0 = Place::Rim,
            _ => {}
        }
    }

    /// The groups that selected lamps are in.
    fn selected_groups(&self) -> impl Iterator<Item = GroupId> {
        let look = self.document.look();
        let selected = self.editing.selection(look);
        let of = |group: &Group| {
            look.members(group.id)
                .iter()
                .any(|id| selected.contains(id))
        };
        let groups = look.groups.iter().filter(|group| of(group));
        let groups: Vec<GroupId> = groups.map(|group| group.id).collect();
        groups.into_iter()
    }

    /// A light probe was chosen.
    pub(super) fn choose_probe(&mut self, worker: &mut Worker, path: &Path) {
        self.probes.read(worker, path);
    }

    /// The pictures that a question comes to, in a folder.
    fn pictures(&self, question: &Question, folder: &Path) -> Option<Job> {
        let seen = Seen::from(self.viewport.seen()?);
        let (transform, exposure, background) = self.viewport.shown_as();
        let screen = Screen {
            seen: &seen,
            cameras: self.viewport.named_cameras(),
            at: self.viewport.at(),
            transform,
            exposure,
            background,
        };
        let lamp = self.editing.selected(self.document.look()).map(|l| l.id);
        Some(question.job(&self.document, lamp, &screen, folder))
    }

    /// The command that exports as was asked, and what is to be known of it.
    pub(super) fn export(
        &self,
        question: &Question,
        others: Others,
        exports: &Exports,
    ) -> Option<(Command, Export)> {
        let folder = question.folder.clone()?;
        let mut export = Export {
            name: "Files for other programs".to_owned(),
            folder,
            files: Vec::new(),
            megapixels: None,
            kept: Arc::default(),
        };
        if self.answered == Asked::Programs {
            let cameras = self.cameras().to_vec();
            let command = self
                .programs
                .command(&self.document, cameras, &export.folder);
            return Some((command, export));
        }
        let mut job = self.pictures(question, &export.folder)?;
        if others == Others::Kept {
            job = job.beside_others(|file| is_taken(file, exports));
        }
        export.name = question.file_name(&self.document, self.viewport.at());
        export.files = job.files().collect();
        export.megapixels = Some(exporting::megapixels(&job));
        let kept = Arc::clone(&export.kept);
        Some((
            exporting::command(self.document.solution(), job, kept),
            export,
        ))
    }

    /// Names and cameras of the input views: the solution's own, or those of the open capture.
    fn cameras(&self) -> &[(String, Camera)] {
        let own = &self.document.solution().cameras;
        if own.is_empty() {
            self.viewport.named_cameras()
        } else {
            own
        }
    }

    /// Finds beside the window's thread what takes too long between two frames.
    fn prepare(&mut self, worker: &mut Worker) {
        if let Some(from_above) = self.from_above.take() {
            self.disc.know(Arc::new(from_above));
        }
        if !self.prepared {
            self.prepared = true;
            let known = self.document.capture.clone();
            if let Some(path) = known.filter(|_| self.viewport.lacks_photographs()) {
                self.locate_photographs(worker, &path);
            }
            let solution = Arc::clone(self.document.solution());
            let slot = Arc::clone(&self.from_above);
            worker.aside("disc", move || {
                slot.store(LitDisc::from_above(&solution.grid));
            });
        }
    }

    /// Shows the page. Returns what is wrong, if something is.
    pub(super) fn show(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) -> Option<Problem> {
        self.prepare(shared.worker);
        let problem = self.probes.take(&mut self.document).map(Problem::Probe);
        let problem = problem.or(self.take_photographs().map(Problem::Photographs));
        self.editing.begin_frame();
        egui::Panel::left("lamps")
            .frame(theme::side(ui))
            .resizable(true)
            .default_size(theme::SIDE)
            .size_range(260.0..=420.0)
            .show(ui, |ui| self.side_ui(ui, shared));
        result::panel(ui, self.document.solution(), shared);
        egui::CentralPanel::default()
            .frame(theme::stage())
            .show(ui, |ui| {
                let stage = ui.max_rect();
                self.stage_ui(ui, shared);
                self.history = self.history && steps::show(ui.ctx(), stage, &mut self.document);
            });
        self.question_ui(ui.ctx(), shared);
        let typing = ui.ctx().text_edit_focused();
        if !typing && self.question.is_none() && ui.input(|i| i.key_pressed(egui::Key::Escape)) {
            if self.document.is_dragging() {
                self.document.cancel();
            } else {
                self.editing.select(None);
            }
        }
        editing::settle(ui.ctx(), &mut self.document);
        problem
    }

    /// The direction from the object to where it is seen from.
    fn towards_viewer(&self) -> Vec3 {
        let lighting = &self.document.base().lighting;
        let eye = self.viewport.seen().map(|(camera, _)| camera.position());
        let offset = eye.map_or(Vec3::ZERO, |eye| eye.as_vec3() - lighting.centre);
        offset.normalize_or(lighting.up)
    }

    /// Setups, hemisphere and lights; below, in a place that never moves, what belongs to the selected light.
    fn side_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        egui::Panel::bottom("pinned settings")
            .frame(egui::Frame::new())
            .exact_size(PINNED)
            .show(ui, |ui| self.pinned_ui(ui, shared));
        let towards = self.towards_viewer();
        let viewer = Viewer::new(towards, self.document.base().lighting.up);
        let (document, editing) = (&mut self.document, &mut self.editing);
        looks::show(ui, document, editing, towards);
        ui.add_space(theme::GAP * 0.5);
        // In a low window the list needs the room.
        let room = ui.available_height() - LEAST_LIST;
        let side = room.clamp(LEAST_DISC, MOST_DISC * ui.ctx().content_rect().height());
        let side = side.min(ui.available_width());
        self.disc.show(ui, side, towards, document, editing, shared);
        ui.add_space(theme::GAP * 0.5);
        theme::group(ui, "Lights");
        lamps::buttons(ui, document, editing);
        list::show(ui, document, editing, &viewer);
    }

    /// Settings of the selected light, or of the surroundings.
    fn pinned_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        let (document, editing) = (&mut self.document, &mut self.editing);
        ui.add_space(6.0);
        ui.horizontal(|ui| {
            let name = editing.called(document.look());
            let name = name.as_deref().unwrap_or("Selected light");
            let name = egui::RichText::new(name).strong();
            let own = egui::Button::selectable(!editing.surroundings, name).truncate();
            let own = ui.add(own).accessible_name("Settings of the light");
            if own
                .on_hover_text("Settings of the selected light")
                .clicked()
            {
                editing.surroundings = false;
            }
            let around = ui.selectable_label(editing.surroundings, "Surroundings");
            let tip = "Ambient light, stray light and a light probe";
            if around.on_hover_text(tip).clicked() {
                editing.surroundings = true;
            }
        });
        ui.add_space(4.0);
        if editing.surroundings {
            surroundings::show(ui, document, &self.probes, shared);
        } else {
            lamp_settings::show(ui, document, editing);
        }
    }

    fn stage_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        let bar = egui::Frame::new()
            .fill(ui.visuals().panel_fill)
            .inner_margin(egui::Margin::symmetric(theme::MARGIN, 6));
        egui::Panel::top("pointing")
            .frame(bar)
            .exact_size(36.0)
            .show(ui, |ui| {
                ui.horizontal_centered(|ui| {
                    ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                        result::button(ui, self.document.solution(), shared);
                        ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                            if self.viewport.compares() {
                                ui.weak(
                                    "The captured light is shown; lights are placed in Object.",
                                );
                            } else {
                                pointing::bar(ui, &self.document, &mut self.editing);
                            }
                        });
                    });
                });
            });
        let document = &self.document;
        let look = document.look();
        let selected = self.editing.selected(look).map(|l| l.id);
        let shadowed = look.lamps.iter().position(|l| Some(l.id) == selected);
        let scene = Scene {
            worker: &mut *shared.worker,
            habit: shared.settings.habit,
            free: !self.pointing.is_placing(),
            version: document.revision(),
            gpu: shared.gpu,
            dragging: document.is_dragging(),
            shadowed: shadowed.unwrap_or(0),
            subject: Some(|| {
                let subject = Subject::Solved(Arc::clone(document.solution()));
                Some((subject, document.light().lighting))
            }),
        };
        let response = self.viewport.show(ui, scene);
        let Some(seen) = self.viewport.seen().map(Seen::from) else {
            return;
        };
        if self.viewport.take_wish() {
            shared
                .actions
                .push(Request::Action(Action::LocatePhotographs));
        }
        // Beside a photograph no light is placed: what is shown is the captured one.
        if self.viewport.compares() {
            return;
        }
        let towards = self.towards_viewer();
        compass::show(ui, &seen, &self.document, towards);
        if shared.settings.dome {
            handles::dome(ui, &seen, &self.document);
        }
        let (document, editing) = (&mut self.document, &mut self.editing);
        let held = self.handles.show(ui, &seen, document, editing);
        self.pointing
            .show(ui, &response, &self.viewport, document, editing, held);
    }

    fn question_ui(&mut self, ctx: &egui::Context, shared: &mut Shared<'_>) {
        let answer = match self.question {
            None => return,
            Some(Asked::Pictures) => self.pictures_ui(ctx, shared),
            Some(Asked::Programs) => {
                let cameras = self.cameras().len();
                let folder = shared.settings.export.folder.as_deref();
                self.programs.show(ctx, cameras, folder)
            }
        };
        match answer {
            Answer::Nothing => {}
            Answer::Closed => self.question = None,
            Answer::ChooseFolder => {
                let known = shared.settings.export.folder.as_deref();
                let start = known.or_else(|| self.document.project().and_then(Path::parent));
                shared.worker.pick(Purpose::ExportFolder, start);
            }
            Answer::Export(others) => {
                self.answered = self.question.take().unwrap_or(Asked::Pictures);
                shared.actions.push(Request::Export(others));
            }
        }
    }

    /// The question about pictures.
    fn pictures_ui(&mut self, ctx: &egui::Context, shared: &mut Shared<'_>) -> Answer {
        let question = &mut shared.settings.export;
        let lamp = self.editing.selected(self.document.look());
        let lamp = lamp.map(|l| l.name.clone());
        let cameras = self.viewport.cameras();
        let automatic = question.automatic_name(&self.document, self.viewport.at());
        let job = |question: &Question, folder: &Path| self.pictures(question, folder);
        let exports = shared.exports;
        let taken = |file: &Path| is_taken(file, exports);
        question.show(ctx, cameras, lamp.as_deref(), &automatic, job, taken)
    }
}

/// Whether a file is there, or will be once all exports are made.
fn is_taken(file: &Path, exports: &Exports) -> bool {
    file.exists() || exports.will_write(file)
}
