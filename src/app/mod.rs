//! The window. It draws state and sends commands; all work is done by the [`Worker`]'s threads.
//!
//! The rooms of the window are its pages: `welcome`, `capture_page`, `estimation` and `relight`. What they share:
//! `theme` has the look, `commands` every command with its keys, `viewport` the picture of the object, `disc` the
//! hemisphere seen from above, `notices` the messages. A mesh that lies elsewhere is brought to its place on the capture's
//! page: `placing` offers it, and `points` are set where silhouettes alone don't tell.

mod about;
mod capture_page;
mod commands;
mod disc;
mod estimation;
mod exports;
mod exposures;
mod guide;
mod history;
mod known_light;
mod menus;
mod navigation;
mod notices;
mod open_path;
mod palette;
mod placing;
mod plots;
mod points;
mod projects;
mod relight;
mod result;
mod runs;
mod settings;
mod theme;
mod viewport;
mod welcome;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use eframe::egui;
use eframe::egui_wgpu::RenderState;

use crate::worker::{Command, Event, OpenedCapture, Purpose, Source, Worker};
use capture_page::CapturePage;
use commands::Action;
use estimation::Estimation;
use exports::Exports;
use navigation::Habit;
use notices::{Notices, Weight};
use open_path::OpenPath;
use palette::{Chosen, CommandPalette};
use projects::{Answer, Projects, Then};
use rekindle_estimate::align::{Alignment, MarkedPoint};
use rekindle_solution::Solution;
use rekindle_studio::{Document, Recoverable, state_folder};
use relight::{Export, Others, Problem, Relighting};
use result::Verdict;
use settings::Settings;

pub use theme::install as install_theme;

/// Why commands can't be given.
const NO_CAPTURE: &str = "No capture is open.";
const NO_LIGHT: &str = "There is no light yet; estimate it, or open a project or a solution.";
const NO_OBJECT: &str = "No object is shown on this page.";
const ON_RELIGHTING: &str = "It is a command of the relighting page.";

/// Where the settings are stored.
const SETTINGS: &str = "settings";

/// What fills the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Page {
    Welcome,
    Capture,
    Estimation,
    Relighting,
}

/// What the worker is doing.
#[derive(Clone, Debug)]
enum Doing {
    Opening(Source),
    Recovering(Arc<Recoverable>),
    /// Aligning the mesh, with the part that is done.
    Aligning(f32),
    Solving,
    Exporting {
        export: Export,
        /// What is made.
        said: String,
        /// Which part of it is done, and since when it has been done.
        part: f32,
        since: Instant,
    },
}

/// With what a window begins.
#[derive(Clone, Debug, Default)]
pub struct Start {
    /// What to open.
    pub open: Option<Source>,
    /// Where unsaved work is kept from crashes; nowhere if there is no such folder.
    pub recovery: Option<PathBuf>,
}

/// A command under way.
#[derive(Clone, Debug)]
struct Job {
    number: u64,
    doing: Doing,
}

/// What pages may use besides their own state.
struct Shared<'a> {
    worker: &'a mut Worker,
    settings: &'a mut Settings,
    /// Commands given on this page, to be carried out after it is drawn.
    actions: &'a mut Vec<Request>,
    /// The window's graphics card, if there is one.
    gpu: Option<&'a RenderState>,
    /// What is exported and what waits for it.
    exports: &'a Exports,
    /// Whether the worker has something to do.
    busy: bool,
    /// Which part of an alignment is done, while one is made.
    aligning: Option<f32>,
}

/// What a page asks for.
#[derive(Clone, Debug, PartialEq)]
enum Request {
    Action(Action),
    Open(Source),
    Habit(Habit),
    Recover(usize),
    Discard(usize),
    /// Export as the question about it says.
    Export(Others),
    /// Relight with the run that is looked at.
    RelightRun,
    /// Take an export that waits out of the line.
    RemoveExport(usize),
    /// Stop the export that is made, and take all that wait out of the line.
    StopExports,
    /// Show where a view's photograph and its rendering differ.
    ShowDifference(usize),
    /// Align the mesh, beginning with these points; without any from nothing.
    Align(Vec<MarkedPoint>),
}

/// What Help shows.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Help {
    Keys,
    About,
    Guide,
}

/// The window's state.
pub struct App {
    worker: Worker,
    gpu: Option<RenderState>,
    settings: Settings,
    notices: Notices,
    page: Page,
    welcome: Option<egui::TextureHandle>,
    job: Option<Job>,
    exports: Exports,
    capture: Option<CapturePage>,
    estimation: Option<Estimation>,
    relighting: Option<Relighting>,
    projects: Projects,
    /// What to do after the file for saving was chosen and written.
    save_then: Option<Then>,
    /// Unsaved changes were given up: the window may close.
    leaving: bool,
    /// What the window's title says.
    title: String,
    palette: Option<CommandPalette>,
    help: Option<Help>,
    open_path: Option<OpenPath>,
}

impl App {
    /// A window on its welcome page, or opening something.
    pub fn new(cc: &eframe::CreationContext<'_>, start: Start) -> std::io::Result<Self> {
        let settings: Settings = cc
            .storage
            .and_then(|storage| eframe::get_value(storage, SETTINGS))
            .unwrap_or_default();
        let ctx = cc.egui_ctx.clone();
        theme::install(&ctx);
        ctx.set_theme(settings.theme);
        // The command table has these keys.
        ctx.options_mut(|options| options.zoom_with_keyboard = false);
        let worker = Worker::new(Arc::new(move || ctx.request_repaint()))?;
        let mut app = Self {
            worker,
            gpu: cc.wgpu_render_state.clone(),
            settings,
            notices: Notices::default(),
            page: Page::Welcome,
            welcome: welcome::picture(&cc.egui_ctx),
            job: None,
            exports: Exports::default(),
            capture: None,
            estimation: None,
            relighting: None,
            projects: Projects::new(start.recovery),
            save_then: None,
            leaving: false,
            title: String::new(),
            palette: None,
            help: None,
            open_path: None,
        };
        if let Some(source) = start.open {
            app.open(source);
        }
        Ok(app)
    }

    fn is_solving(&self) -> bool {
        let doing = self.job.as_ref().map(|job| &job.doing);
        matches!(doing, Some(Doing::Solving))
    }

    fn is_exporting(&self) -> bool {
        let doing = self.job.as_ref().map(|job| &job.doing);
        matches!(doing, Some(Doing::Exporting { .. }))
    }

    /// Whether the mesh was put elsewhere and its place not saved.
    fn has_unsaved_place(&self) -> bool {
        self.capture
            .as_ref()
            .is_some_and(CapturePage::has_unsaved_place)
    }

    /// Whether there is work that would be lost.
    fn has_unsaved_work(&self) -> bool {
        self.has_unsaved_place() || self.has_unsaved_document()
    }

    fn has_unsaved_document(&self) -> bool {
        let Some(document) = self.relighting.as_ref().map(Relighting::document) else {
            return false;
        };
        // The demo is quickly estimated again: only what was done to it counts.
        let demo = self.capture.as_ref().is_some_and(CapturePage::is_demo);
        document.is_modified() && (!demo || document.undo_label().is_some())
    }

    fn has_edits(&self) -> bool {
        let document = self.relighting.as_ref().map(Relighting::document);
        document.is_some_and(|d| d.is_modified() && d.undo_label().is_some())
    }

    fn ask_to_open(&mut self, source: Source) {
        if let Some(job) = &self.job {
            let text = match job.doing {
                Doing::Solving => "Stop the estimation first, or wait for its end.",
                Doing::Aligning(_) => "Stop the alignment first, or wait for its end.",
                Doing::Exporting { .. } => "Stop the export first, or wait for its end.",
                _ => "Something else is being opened; wait for its end.",
            };
            self.notices.add(Weight::Note, "One thing at a time", text);
        } else if self.has_unsaved_work() {
            self.projects.ask(Then::Open(source));
        } else {
            self.open(source);
        }
    }

    fn open(&mut self, source: Source) {
        let doing = Doing::Opening(source.clone());
        self.start(Command::Open(source), doing);
    }

    fn start(&mut self, command: Command, doing: Doing) -> bool {
        let number = self.worker.send(command);
        self.job = number.map(|number| Job { number, doing });
        number.is_some()
    }

    fn solve(&mut self) {
        let Some(page) = self.capture.as_ref().filter(|_| self.job.is_none()) else {
            return;
        };
        let (capture, load_s) = (Arc::clone(page.capture()), page.load_s());
        let command = Command::Solve {
            capture: Arc::clone(&capture),
            options: self.settings.estimation.options(),
            light: page.known_light(),
            load_s,
        };
        if self.start(command, Doing::Solving) {
            let number = self.job.as_ref().map_or(0, |job| job.number);
            let known = self.estimation.take();
            let known = known.filter(|estimation| estimation.is_of(&capture));
            let mut estimation = known.unwrap_or_else(|| Estimation::new(capture));
            estimation.begin(self.settings.estimation, number);
            self.estimation = Some(estimation);
            self.page = Page::Estimation;
        }
    }

    fn align(&mut self, points: Vec<MarkedPoint>) {
        if let Some(page) = self.capture.as_ref().filter(|_| self.job.is_none()) {
            let opened = Arc::clone(page.opened());
            self.start(Command::Align { opened, points }, Doing::Aligning(0.0));
            self.page = Page::Capture;
        }
    }

    fn aligned(&mut self, ctx: &egui::Context, opened: OpenedCapture, alignment: &Alignment) {
        self.notices.clear_errors();
        let Some(page) = &mut self.capture else {
            return;
        };
        let overlap = opened.report.mean_overlap();
        let overlap = overlap.map_or(String::new(), |o| {
            format!("Silhouettes overlap by {:.1} %.", 100.0 * o)
        });
        if page.aligned(ctx, opened, alignment) {
            self.notices.add(Weight::Done, "Mesh aligned", overlap);
        } else {
            let title = "The mesh stays where it is";
            self.notices
                .add(Weight::Note, title, "No place was found that fits better.");
        }
    }

    /// Takes in what the worker has to say.
    fn listen(&mut self, ctx: &egui::Context) {
        if let Some(progress) = self.worker.progress() {
            let job = self.job.as_mut().filter(|job| job.number == progress.job);
            match (job.map(|job| &mut job.doing), &mut self.estimation) {
                (Some(Doing::Aligning(part)), _) => *part = progress.fraction,
                (Some(Doing::Exporting { said, part, .. }), _) => {
                    *said = format!("Exporting {}", progress.stage);
                    *part = progress.fraction;
                }
                (_, Some(estimation)) => estimation.update(progress),
                _ => {}
            }
        }
        while let Some((number, event)) = self.worker.event() {
            let ours = self.job.as_ref().is_some_and(|job| job.number == number);
            let doing: Option<Doing> = if ours {
                self.job.take().map(|job| job.doing)
            } else {
                None
            };
            self.hear(ctx, event, doing.as_ref());
            self.export_next();
        }
        let rendered = self.worker.rendered();
        if let Some(rendered) = rendered {
            match self.page {
                Page::Estimation => {
                    if let Some(estimation) = &mut self.estimation {
                        estimation.rendered(ctx, &rendered);
                    }
                }
                _ => {
                    if let Some(relighting) = &mut self.relighting {
                        relighting.rendered(ctx, &rendered);
                    }
                }
            }
        }
    }

    fn hear(&mut self, ctx: &egui::Context, event: Event, doing: Option<&Doing>) {
        match event {
            Event::Capture(opened) => self.show_capture(ctx, *opened),
            Event::Solution { folder, solution } => {
                self.settings.remember(&folder);
                self.capture = None;
                self.estimation = None;
                self.notices.clear_errors();
                self.show_document(Document::new(solution, Some(folder)));
            }
            Event::Project {
                path,
                document,
                warnings,
            } => {
                self.notices.clear_errors();
                if let Some(path) = path {
                    self.settings.remember(&path);
                }
                self.capture = None;
                self.estimation = None;
                for warning in warnings {
                    self.notices
                        .add(Weight::Note, "About this project", warning);
                }
                if let Some(Doing::Recovering(left)) = doing {
                    self.projects.recovered(&mut self.worker, &document, left);
                }
                self.show_document(*document);
            }
            Event::Solved(solution) => {
                self.notices.clear_errors();
                if let Some(estimation) = &mut self.estimation {
                    estimation.finish(Arc::clone(&solution));
                }
                if let Some(page) = &mut self.capture {
                    page.solved(&solution);
                }
                self.say_what_was_found(&solution);
                self.show_estimated(solution);
            }
            Event::Done { what } => match doing {
                Some(Doing::Exporting { export, since, .. }) => self.exported(export, *since),
                _ => self.notices.add(Weight::Done, what, ""),
            },
            Event::Stopped => {
                if matches!(doing, Some(Doing::Aligning(_))) {
                    let text = "The mesh is where it was.";
                    self.notices.add(Weight::Note, "Alignment stopped", text);
                }
                if let Some(Doing::Exporting { export, .. }) = doing {
                    self.export_stopped(export);
                }
                if let Some(estimation) = &mut self.estimation
                    && matches!(doing, Some(Doing::Solving))
                {
                    estimation.stopped();
                    self.notices.add(
                        Weight::Note,
                        "Stopped",
                        "Start again at any time; the capture is still open.",
                    );
                }
            }
            Event::Failed { what, message } => {
                if let Some(estimation) = &mut self.estimation
                    && matches!(doing, Some(Doing::Solving))
                {
                    estimation.stopped();
                }
                let title = format!("{what} failed");
                self.notices.add(Weight::Error, title, message);
            }
            Event::Aligned { opened, alignment } => self.aligned(ctx, *opened, &alignment),
            Event::Picked { purpose, path } => {
                if let Some(path) = path {
                    self.picked(purpose, path);
                }
            }
            Event::NoDialog { purpose, start } => {
                self.open_path = Some(OpenPath::new(purpose, start));
            }
        }
    }

    /// A path was chosen in a file dialog, or typed where there is none.
    fn picked(&mut self, purpose: Purpose, path: PathBuf) {
        match purpose {
            Purpose::OpenFolder | Purpose::OpenFile => self.ask_to_open(Source::Path(path)),
            Purpose::SaveProject => {
                let then = self.save_then.take();
                self.save_to(&path, then);
            }
            Purpose::SaveCurves => {
                if let Some(estimation) = &self.estimation {
                    estimation.save_curves(&mut self.worker, path);
                }
            }
            Purpose::ExportFolder => self.settings.export.folder = Some(path),
            Purpose::Photographs => {
                if let Some(relighting) = &mut self.relighting {
                    relighting.locate_photographs(&mut self.worker, &path);
                }
            }
            Purpose::SaveMesh => {
                if let Some(page) = &mut self.capture {
                    page.save_mesh(&mut self.worker, path);
                }
            }
            Purpose::KnownLight => {
                if let Some(page) = &mut self.capture {
                    page.choose_light(&mut self.worker, &path);
                }
            }
            Purpose::LightProbe => {
                if let Some(relighting) = &mut self.relighting {
                    relighting.choose_probe(&mut self.worker, &path);
                }
            }
        }
    }

    fn save_place(&mut self, then: Then) {
        if let Some(page) = &mut self.capture {
            page.save_place(&mut self.worker, then);
        }
    }

    fn export(&mut self, others: Others) {
        let relighting = self.relighting.as_ref();
        let asked = relighting.and_then(|r| r.export(&self.settings.export, others, &self.exports));
        if let Some((command, export)) = asked {
            self.exports.add(command, export);
            self.export_next();
        }
    }

    /// Begins with the next export of the line, once nothing else is done.
    fn export_next(&mut self) {
        if self.job.is_some() {
            return;
        }
        if let Some((command, export)) = self.exports.next() {
            let doing = Doing::Exporting {
                export,
                said: "Exporting".to_owned(),
                part: 0.0,
                since: Instant::now(),
            };
            self.start(command, doing);
        }
    }

    fn exported(&mut self, export: &Export, since: Instant) {
        if let Some(megapixels) = export.megapixels.filter(|m| *m > 0.0) {
            let seconds = since.elapsed().as_secs_f64();
            self.settings.export.seconds_per_megapixel = Some(seconds / megapixels);
        }
        self.notices
            .add_folder(Weight::Done, "Exported", "", &export.folder);
    }

    fn export_stopped(&mut self, export: &Export) {
        let title = "Export stopped";
        match export.kept.load(Ordering::Relaxed) {
            0 => {
                let text = "No picture was finished; nothing was written.";
                self.notices.add(Weight::Note, title, text);
            }
            kept => {
                let text = format!("Files of finished pictures that were kept: {kept}.");
                self.notices
                    .add_folder(Weight::Note, title, text, &export.folder);
            }
        }
    }

    fn show_capture(&mut self, ctx: &egui::Context, opened: OpenedCapture) {
        self.notices.clear_errors();
        if let Source::Path(path) = &opened.source {
            self.settings.remember(path);
        }
        self.capture = Some(CapturePage::new(ctx, opened));
        self.estimation = None;
        self.relighting = None;
        self.page = Page::Capture;
    }

    fn say_what_was_found(&mut self, solution: &Solution) {
        let lights = match (&solution.known_light, solution.lamps.len()) {
            (Some(known), _) => format!("The light is that of {}.", known.file),
            (None, 0) => "No lights were found.".to_owned(),
            (None, 1) => "One light was found.".to_owned(),
            (None, n) => format!("{n} lights were found."),
        };
        let (weight, title, more) = match Verdict::of(solution) {
            Verdict::Good | Verdict::Noted => (Weight::Done, "Estimated", ""),
            Verdict::Doubtful => (
                Weight::Note,
                "Estimated, with doubts",
                " The result card says what to do.",
            ),
            Verdict::Approximate => (
                Weight::Note,
                "Estimated from the shading",
                " The result card says what that means.",
            ),
            Verdict::Failed => (
                Weight::Note,
                "No lighting could be recovered",
                " The result card says why and what to do.",
            ),
        };
        let text = format!("{lights} Surface: {}.{more}", solution.surface_in_words());
        self.notices.add(weight, title, text);
    }

    /// Shows at an input camera where photograph and rendering differ.
    fn show_difference(&mut self, view: usize) {
        if let Some(relighting) = &mut self.relighting {
            relighting.viewport_mut().show_difference(view);
            self.page = Page::Relighting;
        }
    }

    /// Shows what an estimation of the open capture came to, as it was estimated.
    fn show_estimated(&mut self, solution: Arc<Solution>) {
        let mut document = Document::new(solution, None);
        document.capture = self.capture.as_ref().and_then(CapturePage::path);
        self.show_document(document);
    }

    /// Goes to the object as the run found it that is looked at; asks before edits are lost.
    fn relight_run(&mut self, asks: bool) {
        let run = self.estimation.as_ref().and_then(Estimation::solution);
        let Some(run) = run.map(Arc::clone) else {
            return;
        };
        let shown = self.relighting.as_ref().map(Relighting::document);
        if shown.is_some_and(|shown| Arc::ptr_eq(shown.solution(), &run)) {
            self.page = Page::Relighting;
        } else if asks && self.has_edits() {
            self.projects.ask(Then::RelightRun);
        } else {
            self.show_estimated(run);
        }
    }

    fn show_document(&mut self, document: Document) {
        self.projects.reset();
        self.settings.export.forget_name();
        if Verdict::of(document.solution()).asks_for_a_look() {
            self.settings.result = true;
        }
        let capture = self.capture.as_ref().map(|page| Arc::clone(page.capture()));
        self.relighting = Some(Relighting::new(document, capture.as_ref()));
        self.page = Page::Relighting;
    }

    /// Whether a command can be given now.
    fn enabled(&self, action: Action) -> bool {
        self.obstacle(action).is_none()
    }

    /// Why a command can't be given now, if it can't.
    fn obstacle(&self, action: Action) -> Option<&'static str> {
        match action {
            Action::OpenFolder | Action::OpenFile | Action::Demo => self.running(),
            Action::Solve | Action::Align | Action::AlignByPoints => self.obstacle_of_work(action),
            Action::KnownLight => unless(self.capture.is_some(), NO_CAPTURE).or(self.running()),
            Action::Save | Action::SaveAs => unless(self.relighting.is_some(), NO_LIGHT).or(
                unless(!self.projects.is_saving(), "The project is being saved."),
            ),
            Action::Undo | Action::Redo => self.obstacle_of_history(action),
            Action::Pause | Action::KeepBest => {
                unless(self.is_solving(), "No estimation is running.")
            }
            Action::Stop => unless(self.job.is_some(), "Nothing is running."),
            Action::ShowCapture => unless(self.capture.is_some(), NO_CAPTURE),
            Action::ShowEstimation => unless(
                self.estimation.is_some(),
                "Nothing has been estimated since the program was started.",
            ),
            Action::ShowRelighting => unless(self.relighting.is_some(), NO_LIGHT),
            Action::Camera(n) => {
                let on_page = self.points_page().map(|page| page.capture().views.len());
                let cameras = on_page.or_else(|| self.viewport().map(viewport::Viewport::cameras));
                let there = cameras.is_some_and(|cameras| usize::from(n) < cameras);
                unless(there, "There is no such camera here.")
            }
            Action::Frame | Action::ResetView => {
                let shown = self.viewport().is_some() || self.points_page().is_some();
                unless(shown, NO_OBJECT)
            }
            Action::Brighter | Action::Darker | Action::Histogram | Action::ResetExposure => {
                unless(self.viewport().is_some(), NO_OBJECT)
            }
            Action::Dome => unless(self.document().is_some(), ON_RELIGHTING),
            Action::LocatePhotographs => unless(
                self.relighting
                    .as_ref()
                    .is_some_and(Relighting::lacks_photographs),
                "No photographs are missing.",
            ),
            Action::Export | Action::ExportObject | Action::ExportWeb => {
                let waits = self.is_exporting();
                let busy = || self.running().filter(|_| !waits);
                unless(self.document().is_some(), ON_RELIGHTING).or_else(busy)
            }
            Action::AddLamp
            | Action::DuplicateLamp
            | Action::DeleteLamp
            | Action::MuteLamp
            | Action::SoloLamp
            | Action::PlaceHighlight
            | Action::PlaceBrightest
            | Action::PlaceRim
            | Action::NextLamp
            | Action::AlsoNextLamp
            | Action::SelectAllLamps
            | Action::GroupLamps
            | Action::UngroupLamps
            | Action::ResetLamp
            | Action::NextLook
            | Action::History
            | Action::CompareCaptured => {
                let relighting = self.relighting.as_ref();
                let here = relighting.filter(|_| self.page == Page::Relighting);
                here.map_or(Some(ON_RELIGHTING), |r| r.obstacle(action))
            }
            _ => None,
        }
    }

    /// What stands in the way of what needs the worker, while that works.
    fn running(&self) -> Option<&'static str> {
        unless(
            self.job.is_none(),
            "Something is running; stop it, or wait for its end.",
        )
    }

    fn obstacle_of_work(&self, action: Action) -> Option<&'static str> {
        let Some(page) = &self.capture else {
            return Some(NO_CAPTURE);
        };
        let seen = action != Action::Solve || page.is_seen();
        self.running()
            .or(unless(seen, "No camera sees the mesh; align it first."))
    }

    fn obstacle_of_history(&self, action: Action) -> Option<&'static str> {
        let possible = match (action, self.page) {
            (_, Page::Capture) => self.free_capture().is_some_and(|page| page.can(action)),
            (Action::Undo, _) => self.document().is_some_and(|d| d.undo_label().is_some()),
            _ => self.document().is_some_and(|d| d.redo_label().is_some()),
        };
        let nothing = if action == Action::Undo {
            "There is nothing to undo."
        } else {
            "There is nothing to do again."
        };
        unless(possible, nothing)
    }

    /// The capture's page, while nothing is done at length.
    fn free_capture(&self) -> Option<&CapturePage> {
        self.capture.as_ref().filter(|_| self.job.is_none())
    }

    /// The capture's page, while points are set on it.
    fn points_page(&self) -> Option<&CapturePage> {
        let page = self.capture.as_ref();
        page.filter(|page| self.page == Page::Capture && page.by_points())
    }

    /// The document, on the page where it is edited.
    fn document(&self) -> Option<&Document> {
        let relighting = self.relighting.as_ref();
        relighting
            .filter(|_| self.page == Page::Relighting)
            .map(Relighting::document)
    }

    fn viewport(&self) -> Option<&viewport::Viewport> {
        match self.page {
            Page::Estimation => self.estimation.as_ref().map(Estimation::viewport),
            Page::Relighting => self.relighting.as_ref().map(Relighting::viewport),
            _ => None,
        }
    }

    fn viewport_mut(&mut self) -> Option<&mut viewport::Viewport> {
        match self.page {
            Page::Estimation => self.estimation.as_mut().map(Estimation::viewport_mut),
            Page::Relighting => self.relighting.as_mut().map(Relighting::viewport_mut),
            _ => None,
        }
    }

    fn act(&mut self, ctx: &egui::Context, action: Action) {
        if !self.enabled(action) {
            return;
        }
        match action {
            Action::OpenFolder => self.pick(Purpose::OpenFolder),
            Action::OpenFile => self.pick(Purpose::OpenFile),
            Action::Demo => self.ask_to_open(Source::Demo),
            Action::Save => self.save(None),
            Action::SaveAs => self.pick(Purpose::SaveProject),
            Action::LocatePhotographs => self.pick(Purpose::Photographs),
            Action::Undo | Action::Redo => self.undo(ctx, action),
            Action::Welcome => self.page = Page::Welcome,
            Action::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            Action::Align => self.align(Vec::new()),
            Action::AlignByPoints => {
                if let Some(page) = &mut self.capture {
                    page.set_points();
                    self.page = Page::Capture;
                }
            }
            Action::KnownLight => {
                self.pick(Purpose::KnownLight);
                self.page = Page::Capture;
            }
            Action::Solve if self.has_edits() => self.projects.ask(Then::Solve),
            Action::Solve => self.solve(),
            Action::Pause => self.worker.pause(!self.worker.is_paused()),
            Action::Stop => {
                self.worker.stop();
                if let Some(estimation) = &mut self.estimation {
                    estimation.stopping();
                }
            }
            Action::KeepBest => self.worker.finish(),
            Action::ShowCapture => self.page = Page::Capture,
            Action::ShowEstimation => self.page = Page::Estimation,
            Action::ShowRelighting => self.page = Page::Relighting,
            Action::ToggleTheme => {
                self.settings.theme = if ctx.theme() == egui::Theme::Dark {
                    egui::ThemePreference::Light
                } else {
                    egui::ThemePreference::Dark
                };
                ctx.set_theme(self.settings.theme);
            }
            Action::ZoomIn => ctx.set_zoom_factor((ctx.zoom_factor() + 0.1).min(3.0)),
            Action::ZoomOut => ctx.set_zoom_factor((ctx.zoom_factor() - 0.1).max(0.5)),
            Action::ZoomReset => ctx.set_zoom_factor(1.0),
            Action::FullScreen => {
                let full = ctx.input(|i| i.viewport().fullscreen.unwrap_or(false));
                ctx.send_viewport_cmd(egui::ViewportCommand::Fullscreen(!full));
            }
            Action::Export
            | Action::ExportObject
            | Action::ExportWeb
            | Action::AddLamp
            | Action::DuplicateLamp
            | Action::DeleteLamp
            | Action::MuteLamp
            | Action::SoloLamp
            | Action::PlaceHighlight
            | Action::PlaceBrightest
            | Action::PlaceRim
            | Action::NextLamp
            | Action::AlsoNextLamp
            | Action::SelectAllLamps
            | Action::GroupLamps
            | Action::UngroupLamps
            | Action::ResetLamp
            | Action::NextLook
            | Action::History
            | Action::CompareCaptured => {
                if let Some(relighting) = &mut self.relighting {
                    relighting.act(action);
                }
            }
            Action::Palette => self.palette = Some(CommandPalette::new()),
            Action::Guide => self.toggle_help(Help::Guide),
            Action::Keys => self.toggle_help(Help::Keys),
            Action::About => self.help = Some(Help::About),
            Action::Dome => self.settings.dome = !self.settings.dome,
            Action::Frame
            | Action::ResetView
            | Action::Camera(_)
            | Action::Brighter
            | Action::Darker
            | Action::Histogram
            | Action::ResetExposure => {
                if let Some(viewport) = self.viewport_mut() {
                    viewport.act(action);
                } else if let Some(page) = &mut self.capture {
                    page.act(action);
                }
            }
        }
        ctx.request_repaint();
    }

    fn toggle_help(&mut self, help: Help) {
        self.help = (self.help != Some(help)).then_some(help);
    }

    fn undo(&mut self, ctx: &egui::Context, action: Action) {
        if self.page == Page::Capture {
            if let Some(page) = &mut self.capture {
                page.undo(ctx, action);
            }
            return;
        }
        let Some(relighting) = &mut self.relighting else {
            return;
        };
        let document = relighting.document_mut();
        let (word, label) = if action == Action::Undo {
            ("Undone", document.undo())
        } else {
            ("Redone", document.redo())
        };
        if let Some(label) = label {
            let mut letters = label.chars();
            let first = letters.next().map(char::to_lowercase);
            let label: String = first.into_iter().flatten().chain(letters).collect();
            self.notices
                .add(Weight::Note, format!("{word}: {label}"), "");
        }
    }

    /// Saves the project, after asking where if it has no file yet; then does `then`.
    fn save(&mut self, then: Option<Then>) {
        let document = self.relighting.as_ref().map(Relighting::document);
        let path = document.and_then(|d| d.project().map(Path::to_owned));
        if let Some(path) = path {
            self.save_to(&path, then);
        } else {
            self.save_then = then;
            self.pick(Purpose::SaveProject);
        }
    }

    fn save_to(&mut self, path: &Path, then: Option<Then>) {
        if let Some(relighting) = &mut self.relighting {
            relighting.note_view();
            let document = relighting.document();
            self.projects.save(&mut self.worker, document, path, then);
        }
    }

    /// Says in the window's title what is open and what it does.
    fn set_title(&mut self, ctx: &egui::Context) {
        let document = self.relighting.as_ref().map(Relighting::document);
        let name = match (self.page, document, &self.capture) {
            (Page::Relighting, Some(document), _) => {
                let mark = if document.is_modified() { "*" } else { "" };
                format!("{}{mark}, relighting – ", document.name())
            }
            (Page::Estimation, _, Some(page)) => {
                format!("{}, estimation – ", page.capture().name)
            }
            (Page::Capture, _, Some(page)) => format!("{} – ", page.capture().name),
            _ => String::new(),
        };
        let title = name + "Rekindle";
        if title != self.title {
            ctx.send_viewport_cmd(egui::ViewportCommand::Title(title.clone()));
            self.title = title;
        }
    }

    /// Takes in what came of saving; keeps what is unsaved.
    fn look_after(&mut self, ctx: &egui::Context) {
        if let Some((outcome, then)) = self.projects.outcome() {
            match (outcome, &mut self.relighting) {
                (Ok(saved), Some(relighting)) => {
                    relighting.document_mut().saved(saved);
                    if let Some(path) = relighting.document().project() {
                        self.settings.remember(path);
                        let text = path.display().to_string();
                        self.notices.add(Weight::Done, "Saved", text);
                    }
                    if let Some(then) = then {
                        self.go_on(ctx, then);
                    }
                }
                (Ok(_), None) => {}
                (Err(text), _) => self.notices.add(Weight::Error, "Saving failed", text),
            }
        }
        match self.estimation.as_ref().and_then(Estimation::take_saved) {
            Some(Ok(path)) => {
                let text = path.display().to_string();
                self.notices.add(Weight::Done, "Saved", text);
            }
            Some(Err(text)) => self.notices.add(Weight::Error, "Saving failed", text),
            None => {}
        }
        match self.capture.as_mut().and_then(CapturePage::take_saved) {
            Some(Ok((path, then))) => {
                let text = path.display().to_string();
                self.notices.add(Weight::Done, "Saved", text);
                match then {
                    Some(then) if self.has_unsaved_document() => self.projects.ask(then),
                    Some(then) => self.go_on(ctx, then),
                    None => {}
                }
            }
            Some(Err(text)) => self.notices.add(Weight::Error, "Saving failed", text),
            None => {}
        }
        let page = self.capture.as_mut();
        if let Some(problem) = page.and_then(|page| page.take_light(ctx)) {
            let title = "The light's picture can't be used";
            self.notices.add(Weight::Error, title, problem);
        }
        if let Some(relighting) = &mut self.relighting {
            relighting.note_view();
            let document = relighting.document();
            if let Some(text) = self.projects.keep(ctx, &mut self.worker, document) {
                self.notices
                    .add(Weight::Error, "Unsaved work can't be kept", text);
            }
        }
        let failure = self
            .relighting
            .as_mut()
            .and_then(|relighting| relighting.viewport_mut().take_failure());
        if let Some((title, text)) = failure {
            self.notices.add(Weight::Error, title, text);
        }
        if ctx.input(|i| i.viewport().close_requested()) && !self.leaving && self.has_unsaved_work()
        {
            ctx.send_viewport_cmd(egui::ViewportCommand::CancelClose);
            self.projects.ask(Then::Quit);
        }
    }

    fn go_on(&mut self, ctx: &egui::Context, then: Then) {
        match then {
            Then::Quit => {
                self.leaving = true;
                self.projects.forget();
                ctx.send_viewport_cmd(egui::ViewportCommand::Close);
            }
            Then::Open(source) => self.open(source),
            Then::Solve => self.solve(),
            Then::RelightRun => self.relight_run(false),
        }
    }

    fn recover(&mut self, index: usize) {
        if self.job.is_none()
            && let Some(left) = self.projects.left_behind().get(index).cloned()
        {
            let doing = Doing::Recovering(Arc::clone(&left));
            self.start(Command::Recover(left), doing);
        }
    }

    fn pick(&mut self, purpose: Purpose) {
        let start = self.settings.recent.first().and_then(|path| path.parent());
        self.worker.pick(purpose, start);
    }

    /// Commands given by keys.
    fn read_keys(&mut self, ctx: &egui::Context) {
        if self.palette.is_some() || self.open_path.is_some() {
            return;
        }
        let typing = ctx.text_edit_focused();
        let any_popup = egui::Popup::is_any_open(ctx);
        let is_reading = matches!(self.help, Some(Help::Keys | Help::Guide));
        let also = [
            (egui::Key::K, Action::Palette),
            (egui::Key::Y, Action::Redo),
        ];
        let mut actions = Vec::new();
        ctx.input_mut(|input| {
            for (key, action) in also {
                if input.consume_key(egui::Modifiers::COMMAND, key) {
                    actions.push(action);
                }
            }
            for (keys, action) in commands::by_keys() {
                let plain = !keys.modifiers.command && !is_function_key(keys.logical_key);
                // Without a modifier a key may be meant for a text field, or close a menu.
                if plain && (typing || any_popup || is_reading) && action != Action::Keys {
                    continue;
                }
                // Ctrl+A is a key of text fields.
                if (plain || keys.logical_key == egui::Key::A) && typing {
                    continue;
                }
                if self.enabled(action) && input.consume_shortcut(&keys) {
                    // A key pressed by chance must not throw an estimation away.
                    let keeps = action == Action::Stop && self.is_solving();
                    actions.push(if keeps { Action::KeepBest } else { action });
                }
            }
        });
        for action in actions {
            self.act(ctx, action);
        }
    }

    /// Folders and files dropped on the window: a picture on the page of a capture is its light.
    fn read_drops(&mut self, ctx: &egui::Context) {
        let dropped = ctx.input(|i| {
            let file = i.raw.dropped_files.first();
            file.map(|file| file.path().to_owned())
        });
        let Some(path) = dropped else { return };
        let extension = path.extension().map(std::ffi::OsStr::to_ascii_lowercase);
        let is_picture = extension.is_some_and(|e| e == "exr" || e == "hdr");
        match &mut self.capture {
            Some(page) if is_picture && self.page == Page::Capture => {
                page.choose_light(&mut self.worker, &path);
            }
            _ => self.ask_to_open(Source::Path(path)),
        }
    }

    fn show_page(&mut self, ui: &mut egui::Ui) -> Vec<Request> {
        let mut actions = Vec::new();
        let mut shared = Shared {
            worker: &mut self.worker,
            settings: &mut self.settings,
            actions: &mut actions,
            gpu: self.gpu.as_ref(),
            exports: &self.exports,
            busy: self.job.is_some(),
            aligning: self.job.as_ref().and_then(|job| match job.doing {
                Doing::Aligning(part) => Some(part),
                _ => None,
            }),
        };
        match self.page {
            Page::Capture => {
                if let Some(page) = &mut self.capture {
                    page.show(ui, &mut shared);
                }
            }
            Page::Estimation => {
                if let Some(estimation) = &mut self.estimation {
                    estimation.show(ui, &mut shared);
                }
            }
            Page::Relighting => {
                if let Some(relighting) = &mut self.relighting {
                    let problem = relighting.show(ui, &mut shared);
                    match problem {
                        Some(Problem::Probe(text)) => {
                            let title = "The light probe can't be used";
                            self.notices.add(Weight::Error, title, text);
                        }
                        Some(Problem::Photographs(text)) => {
                            let title = "The photographs can't be used";
                            self.notices.add(Weight::Error, title, text);
                        }
                        None => {}
                    }
                }
            }
            Page::Welcome => {
                let opening = self.job.as_ref().and_then(|job| match &job.doing {
                    Doing::Opening(source) => Some(source),
                    _ => None,
                });
                let left = self.projects.left_behind();
                welcome::show(ui, &mut shared, self.welcome.as_ref(), opening, left);
            }
        }
        actions
    }

    fn show_dialogs(&mut self, ctx: &egui::Context) {
        if let Some(mut palette) = self.palette.take() {
            match palette.show(ctx, |action| self.obstacle(action)) {
                Chosen::Nothing => self.palette = Some(palette),
                Chosen::Closed => {}
                Chosen::Action(action) => self.act(ctx, action),
            }
        }
        let is_read = match self.help {
            None => false,
            Some(Help::Keys) => palette::key_sheet(ctx, self.settings.habit.gestures()),
            Some(Help::About) => about::show(ctx, self.gpu.as_ref()),
            Some(Help::Guide) => guide::show(ctx),
        };
        if is_read {
            self.help = None;
        }
        if let Some(mut open_path) = self.open_path.take() {
            match open_path.show(ctx) {
                open_path::Answer::Nothing => self.open_path = Some(open_path),
                open_path::Answer::Closed => {}
                open_path::Answer::Path(path) => self.picked(open_path.purpose(), path),
            }
        }
        let name = match &self.relighting {
            Some(relighting) if self.has_unsaved_document() => relighting.document().name(),
            _ => "The mesh's place".to_owned(),
        };
        match self.projects.show(ctx, &name) {
            Some(Answer::Save(then)) if self.has_unsaved_place() => self.save_place(then),
            Some(Answer::Save(then)) => self.save(Some(then)),
            Some(Answer::Discard(then)) => self.go_on(ctx, then),
            Some(Answer::Cancel) | None => {}
        }
        self.notices.show(ctx);
    }
}

/// Why not, unless something holds.
fn unless(holds: bool, why_not: &'static str) -> Option<&'static str> {
    (!holds).then_some(why_not)
}

fn is_function_key(key: egui::Key) -> bool {
    use egui::Key;
    matches!(
        key,
        Key::F1 | Key::F2 | Key::F3 | Key::F4 | Key::F5 | Key::F11 | Key::F12
    )
}

impl eframe::App for App {
    fn logic(&mut self, ctx: &egui::Context, _: &mut eframe::Frame) {
        self.listen(ctx);
    }

    fn ui(&mut self, ui: &mut egui::Ui, _: &mut eframe::Frame) {
        let ctx = ui.ctx().clone();
        self.look_after(&ctx);
        self.read_keys(&ctx);
        self.read_drops(&ctx);
        let mut given = menus::show(ui, self);
        given.extend(self.show_page(ui));
        for request in given {
            match request {
                Request::Action(action) => self.act(&ctx, action),
                Request::Open(source) => self.ask_to_open(source),
                Request::Recover(index) => self.recover(index),
                Request::Discard(index) => self.projects.discard(index),
                Request::Habit(habit) => self.settings.habit = habit,
                Request::Export(others) => self.export(others),
                Request::RelightRun => self.relight_run(true),
                Request::RemoveExport(index) => self.exports.remove(index),
                Request::StopExports => {
                    self.exports.clear();
                    self.worker.stop();
                }
                Request::ShowDifference(view) => self.show_difference(view),
                Request::Align(points) => self.align(points),
            }
        }
        self.show_dialogs(&ctx);
        self.set_title(&ctx);
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        eframe::set_value(storage, SETTINGS, &self.settings);
    }

    fn clear_color(&self, visuals: &egui::Visuals) -> [f32; 4] {
        visuals.panel_fill.to_normalized_gamma_f32()
    }
}

/// What task bars and title bars show: the picture that the desktop entry names as well.
fn icon() -> egui::IconData {
    let picture = include_bytes!("../../assets/package/rekindle.png");
    eframe::icon_data::from_png_bytes(picture).unwrap_or_default()
}

/// Opens the window and returns when it is closed.
pub fn run(open: Option<Source>) -> eframe::Result {
    let viewport = egui::ViewportBuilder::default()
        .with_title("Rekindle")
        .with_app_id("rekindle")
        .with_icon(icon())
        .with_inner_size([1280.0, 820.0])
        .with_min_inner_size([960.0, 600.0])
        .with_drag_and_drop(true);
    let options = eframe::NativeOptions {
        viewport,
        ..eframe::NativeOptions::default()
    };
    let start = Start {
        open,
        recovery: state_folder(),
    };
    eframe::run_native(
        "rekindle",
        options,
        Box::new(|cc| Ok(Box::new(App::new(cc, start)?))),
    )
}
