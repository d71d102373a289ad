//! The page of an estimation: it is watched while it converges, and looked back at afterwards.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use eframe::egui::{self, Button, ProgressBar, RichText, Sense, Slider};
use glam::Vec3;

use super::capture_page::estimation_ui;
use super::commands::Action;
use super::disc::{self, Disc, DiscTexture};
use super::plots::Curves;
use super::runs::{self, Run, State};
use super::settings::Estimation as Settings;
use super::viewport::{Object, Scene, Viewport};
use super::{Request, Shared, result, theme};
use crate::worker::{Latest, Progress, Purpose, Rendered, Step, Subject, Worker};
use rekindle_base::staging::write_advice;
use rekindle_capture::Capture;
use rekindle_estimate::estimate::Method;
use rekindle_relight::{LampNodes, LightNode, Lighting};
use rekindle_scene::hemisphere::{HemisphereGrid, Picture};
use rekindle_scene::reflectance::Brdf;
use rekindle_solution::Solution;
use rekindle_studio::write_whole;

/// Frequency of the patches into which the lighting is divided for a quick picture.
const PATCHES: u32 = 4;
/// Lit nodes from which on neighbours are joined for a quick picture …
const MANY: usize = 300;
/// … on a grid of this frequency.
const JOINED: u32 = 10;
/// Least width of the hemispheres, and of the object beside them, points.
const HEMISPHERES: f32 = 300.0;
const OBJECT: f32 = 410.0;
/// Widths from which the hemisphere's title has room beside its controls, short and in full, points.
const TITLES: [f32; 2] = [350.0, 450.0];
/// Width in which an iteration's name is read, points.
const NAMES: f32 = 250.0;
/// Below this part of the whole the time left is a guess not worth showing.
const TELLING: f32 = 0.08;
/// Runs that are kept.
const MOST_RUNS: usize = 8;

/// Which lighting is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Look {
    /// Whatever is newest.
    Newest,
    /// A view's partial hemisphere.
    Partial(usize),
    /// The initial hemisphere.
    Initial,
    /// An iteration, by index.
    Step(usize),
}

/// An iteration of a run, both by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Other {
    run: usize,
    step: usize,
}

/// A picture of an iteration's lighting, kept until another is wanted.
#[derive(Default)]
struct StepPicture {
    of: Option<(Other, Arc<Picture>)>,
    texture: DiscTexture,
}

/// What came of saving curves.
type Saved = Result<PathBuf, String>;

/// The estimations of a capture, the last of which may be running.
pub struct Estimation {
    capture: Arc<Capture>,
    /// At least one, once one was begun.
    runs: Vec<Run>,
    /// The run that is looked at, by index.
    at: usize,
    /// Runs that were begun.
    begun: usize,
    viewport: Viewport,
    look: Look,
    /// An iteration to compare with.
    other: Option<Other>,
    saved: Arc<Latest<Saved>>,
    main: StepPicture,
    beside: StepPicture,
    partials: Vec<DiscTexture>,
    initial: DiscTexture,
}

impl Estimation {
    /// A page for the estimations of a capture, none of which was begun.
    pub fn new(capture: Arc<Capture>) -> Self {
        let up = capture.light_hemisphere.up.as_vec3();
        let mut viewport = Viewport::new(Object::Capture(Arc::clone(&capture)), up, Some(&capture));
        viewport.set_white(white(&capture));
        Self {
            capture,
            runs: Vec::new(),
            at: 0,
            begun: 0,
            viewport,
            look: Look::Newest,
            other: None,
            saved: Arc::default(),
            main: StepPicture::default(),
            beside: StepPicture::default(),
            partials: Vec::new(),
            initial: DiscTexture::default(),
        }
    }

    /// Whether its estimations are of this capture.
    pub fn is_of(&self, capture: &Arc<Capture>) -> bool {
        Arc::ptr_eq(&self.capture, capture)
    }

    /// An estimation was just started as command `job`. The oldest run goes where there are too many.
    pub fn begin(&mut self, settings: Settings, job: u64) {
        self.begun += 1;
        self.runs.push(Run::new(self.begun, job, settings));
        if self.runs.len() > MOST_RUNS {
            self.runs.remove(0);
        }
        self.look_at(self.runs.len() - 1);
    }

    fn look_at(&mut self, run: usize) {
        self.at = run;
        self.look = Look::Newest;
        self.other = None;
        self.partials.clear();
        (self.main, self.beside) = Default::default();
    }

    /// Takes news of a command.
    pub fn update(&mut self, progress: Arc<Progress>) {
        if let Some(run) = self.runs.iter_mut().find(|run| run.job == progress.job) {
            run.progress = Some(progress);
        }
    }

    /// The last run was asked to stop.
    pub fn stopping(&mut self) {
        if let Some(run) = self.runs.last_mut()
            && run.state == State::Running
        {
            run.state = State::Stopping;
        }
    }

    /// The last run was stopped, or failed.
    pub fn stopped(&mut self) {
        if let Some(run) = self.runs.last_mut() {
            run.state = State::Stopped;
        }
    }

    /// The last run ended.
    pub fn finish(&mut self, solution: Arc<Solution>) {
        if let Some(run) = self.runs.last_mut() {
            run.state = State::Done;
            run.solution = Some(solution);
        }
    }

    /// What the run that is looked at came to.
    pub fn solution(&self) -> Option<&Arc<Solution>> {
        self.run()?.solution.as_ref()
    }

    fn run(&self) -> Option<&Run> {
        self.runs.get(self.at)
    }

    fn state(&self) -> State {
        self.run().map_or(State::Stopped, |run| run.state)
    }

    fn progress(&self) -> Option<&Arc<Progress>> {
        self.run()?.progress.as_ref()
    }

    /// Saves the curves of all runs beside the window's thread; the file's extension says in which form.
    pub(super) fn save_curves(&self, worker: &mut Worker, path: PathBuf) {
        let extension = path.extension().map(std::ffi::OsStr::to_ascii_lowercase);
        let text = match extension.as_ref().and_then(|e| e.to_str()) {
            Some("csv") => Ok(runs::csv(&self.runs)),
            Some("svg") => runs::svg(&self.runs).map_err(|error| error.to_string()),
            _ => Err("its name must end in .csv or .svg".to_owned()),
        };
        let slot = Arc::clone(&self.saved);
        worker.aside("curves", move || {
            let written = text.and_then(|text| {
                let written = write_whole(&path, text.as_bytes());
                written
                    .map_err(|error| format!("can't be written: {error}; {}", write_advice(&error)))
            });
            slot.store(match written {
                Ok(()) => Ok(path),
                Err(problem) => Err(format!("{}: {problem}", path.display())),
            });
        });
    }

    /// What came of saving curves, once.
    pub(super) fn take_saved(&self) -> Option<Saved> {
        self.saved.take()
    }

    /// The view of the object.
    pub fn viewport(&self) -> &Viewport {
        &self.viewport
    }

    /// The view of the object.
    pub fn viewport_mut(&mut self) -> &mut Viewport {
        &mut self.viewport
    }

    /// Takes a picture of the reference renderer.
    pub fn rendered(&mut self, ctx: &egui::Context, rendered: &Rendered) {
        self.viewport.rendered(ctx, rendered);
    }

    fn steps(&self) -> &[Arc<Step>] {
        self.run().map_or(&[], Run::steps)
    }

    /// The iteration that is looked at, by index.
    fn shown(&self) -> Option<usize> {
        let last = self.steps().len().checked_sub(1)?;
        match self.look {
            Look::Newest => Some(last),
            Look::Step(k) => Some(k.min(last)),
            Look::Partial(_) | Look::Initial => None,
        }
    }

    /// Shows the page.
    pub(super) fn show(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        let paused = shared.worker.is_paused();
        let runs = self.runs.iter_mut();
        for run in runs.filter(|run| run.state == State::Running && !paused) {
            if let Some(progress) = &run.progress {
                run.elapsed = progress.started.elapsed().saturating_sub(progress.paused);
            }
            // The clock goes on between the news.
            ui.ctx().request_repaint_after(Duration::from_millis(500));
        }
        egui::Panel::top("estimation progress")
            .frame(theme::side(ui))
            .show(ui, |ui| self.progress_ui(ui, shared));
        if let Some(solution) = self.solution().cloned() {
            result::panel(ui, &solution, shared);
        }
        let tall = (ui.available_height() * 0.3).clamp(130.0, 240.0);
        egui::Panel::bottom("estimation plots")
            .frame(theme::side(ui))
            .resizable(true)
            .default_size(tall)
            .size_range(110.0..=420.0)
            .show(ui, |ui| self.plots_ui(ui, shared));
        let wide = (ui.available_width() * 0.5).max(380.0);
        egui::Panel::left("estimation hemispheres")
            .frame(theme::side(ui))
            .resizable(true)
            .default_size(wide)
            // A width from a larger window must leave room for the object.
            .size_range(HEMISPHERES..=(ui.available_width() - OBJECT).max(HEMISPHERES))
            .show(ui, |ui| self.hemispheres_ui(ui, shared));
        egui::CentralPanel::default()
            .frame(theme::stage())
            .show(ui, |ui| self.object_ui(ui, shared));
    }

    fn progress_ui(&self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        let palette = theme::palette(ui);
        ui.horizontal(|ui| {
            let (stage, fraction) = self
                .progress()
                .map_or(("starting", 0.0), |p| (p.stage.as_str(), p.fraction));
            let paused = shared.worker.is_paused();
            let (text, fraction) = match self.state() {
                State::Running if paused => (format!("Paused while {stage}"), fraction),
                State::Running => (sentence(stage), fraction),
                State::Stopping => ("Stopping".to_owned(), fraction),
                State::Stopped => ("Stopped".to_owned(), fraction),
                State::Done => ("Done".to_owned(), 1.0),
            };
            let buttons = 480.0;
            ui.vertical(|ui| {
                ui.set_width((ui.available_width() - buttons).max(160.0));
                ui.horizontal(|ui| {
                    ui.label(RichText::new(text).strong());
                    ui.weak(self.time(fraction));
                });
                let fill = if self.state() == State::Stopped {
                    palette.weak
                } else {
                    palette.accent
                };
                let bar = ProgressBar::new(fraction)
                    .desired_height(6.0)
                    .fill(fill)
                    .desired_width(ui.available_width());
                ui.add(bar).accessible_name("Progress");
            });
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                self.buttons_ui(ui, shared, paused);
            });
        });
    }

    fn buttons_ui(&self, ui: &mut egui::Ui, shared: &mut Shared<'_>, paused: bool) {
        if matches!(self.state(), State::Running | State::Stopping) {
            ui.add_enabled_ui(self.state() == State::Running, |ui| {
                let stop = ui.button("Stop");
                if stop.on_hover_text("Stop and keep nothing").clicked() {
                    give(shared, Action::Stop);
                }
                let keep = ui.button("Stop and keep best");
                let tip =
                    "End the estimation with what it has reached and relight with that (Ctrl+. or Esc)";
                if keep.on_hover_text(tip).clicked() {
                    give(shared, Action::KeepBest);
                }
                let pause = ui.button(if paused { "Resume" } else { "Pause" });
                if pause.on_hover_text("Pause, or go on (Space)").clicked() {
                    give(shared, Action::Pause);
                }
            });
            return;
        }
        if self.state() == State::Done {
            let relight = ui.add(theme::main_button(ui, "Relight"));
            let tip = "To the object and its lights, as this run found them (F3)";
            if relight.on_hover_text(tip).clicked() {
                shared.actions.push(Request::RelightRun);
            }
        }
        let again = ui.add_enabled(!shared.busy, Button::new("Estimate again"));
        let tip = "Estimate again with these settings; photographs and mesh are not read again (Ctrl+Enter)";
        if again.on_hover_text(tip).clicked() {
            give(shared, Action::Solve);
        }
        ui.menu_button("Settings", |ui| {
            estimation_ui(ui, &mut shared.settings.estimation);
        })
        .response
        .on_hover_text("How to estimate the next time");
        if let Some(solution) = self.solution() {
            result::button(ui, solution, shared);
        }
    }

    /// Elapsed time, and what is left if it can be told.
    fn time(&self, fraction: f32) -> String {
        let (Some(run), Some(progress)) = (self.run(), self.progress()) else {
            return String::new();
        };
        if run.state == State::Done {
            let seconds = run.seconds().unwrap_or_default();
            return format!("{seconds:.1} s, {} iterations", progress.steps.len());
        }
        if run.state == State::Stopped {
            return format!("after {} iterations", progress.steps.len());
        }
        let elapsed = run.elapsed.as_secs_f32();
        if fraction < TELLING {
            return format!("{elapsed:.0} s");
        }
        let left = elapsed * (1.0 - fraction) / fraction;
        format!("{elapsed:.0} s, about {:.0} s left", left.ceil())
    }

    fn plots_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        let curves = ui.horizontal(|ui| {
            let mut at = self.at;
            if runs::button(ui, &mut self.runs, &mut at) {
                self.look_at(at);
            }
            let any = self.runs.iter().any(|run| !run.steps().is_empty());
            let save = ui.add_enabled(any, Button::new("Save curves…"));
            let tip = "Write the curves of all runs: numbers as .csv, a picture as .svg";
            if save.on_hover_text(tip).clicked() {
                let start = shared
                    .settings
                    .recent
                    .first()
                    .and_then(|path| path.parent());
                shared.worker.pick(Purpose::SaveCurves, start);
            }
            let curves = self.curves(ui);
            curves.legend_ui(ui);
            curves
        });
        if let Some(clicked) = curves.inner.show(ui) {
            self.look = Look::Step(clicked);
        }
    }

    /// The curves of the run that is looked at, under those of others.
    fn curves(&self, ui: &egui::Ui) -> Curves<'_> {
        let other = self.other.filter(|other| other.run == self.at);
        Curves {
            steps: self.steps(),
            tried: self.progress().map_or(&[][..], |p| &p.tried),
            method: self
                .run()
                .map_or_else(Method::default, |run| run.settings.method),
            shown: self.shown(),
            other: other.map(|other| other.step),
            interval: self.solution().and_then(|s| s.sigma_interval95),
            overlays: runs::overlays(ui, &self.runs, self.at),
        }
    }

    fn hemispheres_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        let exposure = &mut shared.settings.hemisphere;
        ui.horizontal(|ui| {
            let title = match ui.available_width() {
                room if room > TITLES[1] => "Hemisphere, seen from above",
                room if room > TITLES[0] => "Hemisphere",
                _ => "",
            };
            theme::group(ui, title).on_hover_text("Seen from above; the rim is the horizon");
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                disc::exposure_ui(ui, exposure);
            });
        });
        let exposure = *exposure;
        let strip = 92.0;
        let controls = 84.0;
        let room = ui.available_size();
        let discs = if self.other.is_some() { 2.0 } else { 1.0 };
        let side = ((room.x - 8.0 * (discs - 1.0)) / discs)
            .min(room.y - strip - controls)
            .max(80.0);
        // Names are wider than small discs.
        let cell = side.max(NAMES.min(room.x / discs - 8.0));
        let size = egui::vec2(cell, side);
        let column = egui::Layout::top_down(egui::Align::Center);
        ui.horizontal_top(|ui| {
            ui.add_space((0.5 * (room.x - discs * cell - 8.0 * (discs - 1.0))).max(0.0));
            ui.allocate_ui_with_layout(size, column, |ui| {
                let name = self.main_name();
                let texture = self.main_texture(ui.ctx(), exposure);
                let (response, disc) =
                    disc::show(ui, texture, self.up(), side, Sense::hover(), &name);
                if self.look == Look::Newest {
                    self.lamps_ui(ui, &disc);
                }
                disc::mirror_mark(ui, &disc, self.viewport.mirrored());
                disc::direction_tip(response, &disc);
                caption(ui, cell, name);
            });
            if let Some(other) = self.other {
                ui.allocate_ui_with_layout(size, column, |ui| {
                    let run = &self.runs[other.run];
                    let mut name = step_name(run, other.step);
                    if other.run != self.at {
                        name = format!("{}: {name}", run.name());
                    }
                    let texture = step_texture(
                        &mut self.beside,
                        run.progress.as_deref(),
                        other,
                        ui.ctx(),
                        exposure,
                    );
                    disc::show(
                        ui,
                        texture,
                        self.up(),
                        side,
                        Sense::hover(),
                        &format!("Compared {name}"),
                    );
                    caption(ui, cell, name);
                });
            }
        });
        self.scrub_ui(ui);
        self.strip_ui(ui, exposure, strip);
    }

    /// Rings around the lamps that were found.
    fn lamps_ui(&self, ui: &egui::Ui, disc: &Disc) {
        let palette = theme::palette(ui);
        let Some(solution) = self.solution() else {
            return;
        };
        for lamp in &solution.lamps {
            let Some(at) = disc.at(lamp.direction) else {
                continue;
            };
            let radius = 0.5 * disc.rect.width() * lamp.angular_radius.sin() + 7.0;
            let stroke = egui::Stroke::new(1.5, palette.accent);
            ui.painter().circle_stroke(at, radius, stroke);
            ui.painter().text(
                at + egui::vec2(radius + 4.0, 0.0),
                egui::Align2::LEFT_CENTER,
                &lamp.name,
                egui::TextStyle::Small.resolve(ui.style()),
                palette.accent,
            );
        }
    }

    fn up(&self) -> Vec3 {
        self.capture.light_hemisphere.up.as_vec3()
    }

    fn main_name(&self) -> String {
        let progress = self.progress();
        match self.look {
            Look::Partial(i) => format!("Partial hemisphere of view {}", i + 1),
            Look::Initial => "Initial hemisphere".to_owned(),
            Look::Newest | Look::Step(_) => match (self.shown(), progress) {
                (Some(k), _) => self.run().map_or_else(String::new, |run| step_name(run, k)),
                (None, Some(p)) if p.initial.is_some() => "Initial hemisphere".to_owned(),
                (None, Some(p)) if !p.partials.is_empty() => {
                    format!("Partial hemisphere of view {}", p.partials.len())
                }
                _ => "No highlights yet".to_owned(),
            },
        }
    }

    fn main_texture(
        &mut self,
        ctx: &egui::Context,
        exposure: super::settings::HemisphereExposure,
    ) -> Option<egui::TextureId> {
        let progress = self.progress().cloned()?;
        let run = self.at;
        let partial = |this: &mut Self, i: usize| {
            let picture = progress.partials.get(i)?;
            if this.partials.len() <= i {
                this.partials.resize_with(i + 1, DiscTexture::default);
            }
            Some(this.partials[i].of(ctx, picture, exposure))
        };
        match (self.look, self.shown()) {
            (Look::Partial(i), _) => partial(self, i),
            (Look::Initial, _) => {
                let picture = progress.initial.as_ref()?;
                Some(self.initial.of(ctx, picture, exposure))
            }
            (_, Some(step)) => {
                let shown = Other { run, step };
                step_texture(&mut self.main, Some(&progress), shown, ctx, exposure)
            }
            (_, None) => match &progress.initial {
                Some(picture) => Some(self.initial.of(ctx, picture, exposure)),
                None => partial(self, progress.partials.len().checked_sub(1)?),
            },
        }
    }

    /// Chooses the iteration to look at and the one to compare it with.
    fn scrub_ui(&mut self, ui: &mut egui::Ui) {
        let last = self.steps().len().saturating_sub(1);
        ui.add_enabled_ui(last > 0, |ui| {
            ui.spacing_mut().slider_width = (ui.available_width() - 240.0).max(80.0);
            ui.horizontal(|ui| {
                let label = ui.label("Iteration");
                let mut k = self.shown().unwrap_or(last) + 1;
                let slider = ui
                    .add(Slider::new(&mut k, 1..=last + 1))
                    .labelled_by(label.id)
                    .on_hover_text("Look at any iteration");
                if slider.changed() {
                    self.look = Look::Step(k - 1);
                }
                let newest = ui.selectable_label(self.look == Look::Newest, "Newest");
                if newest.on_hover_text("Follow the estimation").clicked() {
                    self.look = Look::Newest;
                }
            });
            ui.horizontal(|ui| {
                let mut compare = self.other.is_some();
                ui.checkbox(&mut compare, "Compare with")
                    .on_hover_text("Show another iteration beside it");
                if compare != self.other.is_some() {
                    let first = Other {
                        run: self.at,
                        step: 0,
                    };
                    self.other = compare.then_some(first);
                }
                if let Some(other) = &mut self.other {
                    other_ui(ui, &self.runs, other);
                }
            });
        });
    }

    /// Partial hemispheres and the initial one, small.
    fn strip_ui(
        &mut self,
        ui: &mut egui::Ui,
        exposure: super::settings::HemisphereExposure,
        height: f32,
    ) {
        let Some(progress) = self.progress().cloned() else {
            return;
        };
        let side = height - 26.0;
        egui::ScrollArea::horizontal().show(ui, |ui| {
            ui.horizontal(|ui| {
                for (i, picture) in progress.partials.iter().enumerate() {
                    if self.partials.len() <= i {
                        self.partials.push(DiscTexture::default());
                    }
                    let texture = self.partials[i].of(ui.ctx(), picture, exposure);
                    let look = Look::Partial(i);
                    self.small_ui(ui, texture, side, look, &format!("View {}", i + 1));
                }
                if let Some(picture) = &progress.initial {
                    let texture = self.initial.of(ui.ctx(), picture, exposure);
                    self.small_ui(ui, texture, side, Look::Initial, "Initial");
                }
            });
        });
    }

    fn small_ui(
        &mut self,
        ui: &mut egui::Ui,
        texture: egui::TextureId,
        side: f32,
        look: Look,
        name: &str,
    ) {
        ui.vertical(|ui| {
            ui.spacing_mut().item_spacing.y = 2.0;
            let label = format!("{name} hemisphere");
            let (response, disc) = disc::show(ui, Some(texture), self.up(), side, Sense::click(), &label);
            let chosen = self.look == look;
            if chosen || response.hovered() {
                let accent = theme::palette(ui).accent;
                let stroke = egui::Stroke::new(if chosen { 2.0 } else { 1.0 }, accent);
                ui.painter()
                    .circle_stroke(disc.rect.center(), 0.5 * disc.rect.width(), stroke);
            }
            let tip = "What this view says of the lighting: where its mirror rays meet the hemisphere. Click to see it large";
            if response.on_hover_text(tip).clicked() {
                self.look = if chosen { Look::Newest } else { look };
            }
            ui.label(RichText::new(name).small());
        });
    }

    /// The object under the lighting that is looked at.
    fn object_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        let progress = self.progress().cloned();
        let shown = self.shown();
        // Another for every iteration of every run.
        let version = ((self.at as u64) << 32) + shown.map_or(0, |k| k as u64 + 1);
        let capture = &self.capture;
        let subject = || {
            let progress = progress?;
            let texture = Arc::clone(progress.texture.as_ref()?);
            let step = progress.steps.get(shown?)?;
            let lighting = quick_lighting(progress.grid.as_ref()?, step);
            let subject = Subject::Running {
                capture: Arc::clone(capture),
                texture,
                brdf: Brdf::new(step.model, step.iteration.sigma),
            };
            Some((subject, lighting))
        };
        let scene = Scene {
            worker: shared.worker,
            habit: shared.settings.habit,
            free: true,
            version,
            gpu: None,
            dragging: false,
            shadowed: 0,
            subject: Some(subject),
        };
        self.viewport.show(ui, scene);
    }
}

fn give(shared: &mut Shared<'_>, action: Action) {
    shared.actions.push(Request::Action(action));
}

/// A disc's name in the middle below it.
fn caption(ui: &mut egui::Ui, side: f32, name: String) {
    let size = egui::vec2(side, 16.0);
    ui.add_sized(
        size,
        egui::Label::new(RichText::new(name).small()).truncate(),
    );
}

fn step_name(run: &Run, step: usize) -> String {
    run.steps().get(step).map_or_else(String::new, |step| {
        format!(
            "Iteration {}, σ {:.4}, {} lit nodes",
            step.iteration.iteration,
            step.iteration.sigma,
            step.lit.len()
        )
    })
}

/// Chooses the iteration, of any run, to compare with.
fn other_ui(ui: &mut egui::Ui, runs: &[Run], other: &mut Other) {
    if runs.len() > 1 {
        let name = runs[other.run].name();
        let chosen = egui::ComboBox::from_id_salt("compared run")
            .width(70.0)
            .selected_text(name)
            .show_ui(ui, |ui| {
                for (i, run) in runs.iter().enumerate() {
                    ui.selectable_value(&mut other.run, i, run.name());
                }
            });
        let chosen = chosen.response.accessible_name("Compared run");
        chosen.on_hover_text("The run to compare with");
        ui.spacing_mut().slider_width = (ui.spacing().slider_width - 90.0).max(60.0);
    }
    let last = runs[other.run].steps().len().saturating_sub(1);
    let mut k = other.step.min(last) + 1;
    ui.add(Slider::new(&mut k, 1..=last + 1))
        .on_hover_text("The iteration to compare with")
        .accessible_name("Compared iteration");
    other.step = k - 1;
}

/// The texture of an iteration's lighting.
fn step_texture(
    kept: &mut StepPicture,
    progress: Option<&Progress>,
    shown: Other,
    ctx: &egui::Context,
    exposure: super::settings::HemisphereExposure,
) -> Option<egui::TextureId> {
    let progress = progress?;
    let step = progress.steps.get(shown.step)?;
    let (grid, from_above) = (progress.grid.as_ref()?, progress.from_above.as_ref()?);
    let picture = match &kept.of {
        Some((of, picture)) if *of == shown => Arc::clone(picture),
        _ => {
            let radiance = step.nodes(grid.directions.len());
            let picture = Arc::new(from_above.picture(&radiance));
            kept.of = Some((shown, Arc::clone(&picture)));
            picture
        }
    };
    Some(kept.texture.of(ctx, &picture, exposure))
}

/// An iteration's lighting for a quick picture: neighbours joined where there are many, in patches that cast one shadow.
fn quick_lighting(grid: &HemisphereGrid, step: &Step) -> Lighting {
    let mut nodes: Vec<LightNode> = step
        .lit
        .iter()
        .map(|&(node, radiance)| LightNode {
            direction: grid.directions[node as usize],
            radiance: radiance.into(),
            solid_angle: grid.solid_angle,
        })
        .collect();
    if nodes.len() > MANY {
        let coarse = grid.at_frequency(JOINED);
        let mut flux = vec![Vec3::ZERO; coarse.directions.len()];
        for node in &nodes {
            if let Some(k) = coarse.nearest(node.direction) {
                flux[k] += node.flux();
            }
        }
        nodes = flux
            .into_iter()
            .zip(&coarse.directions)
            .filter(|(flux, _)| *flux != Vec3::ZERO)
            .map(|(flux, &direction)| LightNode {
                direction,
                radiance: flux / coarse.solid_angle,
                solid_angle: coarse.solid_angle,
            })
            .collect();
    }
    let patches = grid.at_frequency(PATCHES);
    let mut members: Vec<Vec<LightNode>> = vec![Vec::new(); patches.directions.len()];
    for node in nodes {
        if let Some(k) = patches.nearest(node.direction) {
            members[k].push(node);
        }
    }
    let lamps = members.into_iter();
    let lamps = lamps.filter_map(|nodes| LampNodes::new(nodes, grid.radius));
    Lighting {
        centre: grid.centre,
        radius: grid.radius,
        up: grid.up,
        ..Lighting::of(lamps.collect())
    }
}

/// Radiance shown as white before there is a texture: what few of the photographs' pixels exceed.
fn white(capture: &Capture) -> f32 {
    let mut levels: Vec<f32> = capture
        .views
        .iter()
        .flat_map(|v| &v.photograph.radiance)
        .map(|p| p.iter().sum::<f32>() / 3.0)
        .filter(|&v| v > 0.0)
        .collect();
    if levels.is_empty() {
        return 1.0;
    }
    let at = (levels.len() - 1) * 97 / 100;
    let bright = *levels.select_nth_unstable_by(at, f32::total_cmp).1;
    (1.3 * bright).max(f32::MIN_POSITIVE)
}

/// A stage's name as a sentence begins.
pub(super) fn sentence(stage: &str) -> String {
    let mut letters = stage.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}
