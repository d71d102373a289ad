//! The threads behind the window, and the only file that has any: one loads, solves and runs other long tasks, one
//! renders pictures with the reference renderer.
//!
//! Commands and facts go through bounded queues. What grows while a solve runs goes through a [`Latest`] slot, where the
//! newest state replaces an unread older one, so that a window that is slow, or hidden, never piles up work.

use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use rekindle_capture::{Camera, Capture, DEMO, PixelCounts, unpack_demo};
use rekindle_estimate::align::{Alignment, MarkedPoint, Start, Stop, align};
use rekindle_estimate::estimate::{Interim, Iteration, Observer, Stopped};
use rekindle_estimate::preflight::{Report, Thumbnail};
use rekindle_relight::{
    self as relight, Diffuse, Interreflection, Lighting, Scene, Shader, Surroundings,
};
use rekindle_scene::hemisphere::{FromAbove, HemisphereGrid, Picture};
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::surface::{Atlas, Occluder};
use rekindle_solution::{LightProbe, Solution, SolveOptions, solution_folder, solve_under};
use rekindle_studio::{Document, EXTENSION, Recoverable};

/// Commands that may wait.
const COMMANDS: usize = 8;
/// Facts that may wait to be read.
const EVENTS: usize = 64;
/// Side of a hemisphere's picture in pixels.
const PICTURE_SIDE: u32 = 256;
/// How often a paused solve looks whether it is to stop.
const PAUSE: Duration = Duration::from_millis(20);
/// A file dialog that answers sooner than this was never shown.
const NO_DIALOG: Duration = Duration::from_millis(400);

/// Tells the window to draw again.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// What a long task reports to: what it does, which part of it is done, and whether to go on.
pub type Tell<'a> = &'a mut dyn FnMut(&str, f32) -> ControlFlow<()>;

/// A long task; see [`Command::Task`].
pub type Work = dyn FnOnce(Tell<'_>, relight::Stop<'_>) -> anyhow::Result<()> + Send;

/// What can be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// The built-in capture.
    Demo,
    /// A capture or a solution.
    Path(PathBuf),
}

/// Something to be done at length.
pub enum Command {
    /// Open a capture or a solution.
    Open(Source),
    /// Open what a crash left behind.
    Recover(Arc<Recoverable>),
    /// Bring the mesh of a capture to where its photographs show it.
    Align {
        /// The capture.
        opened: Arc<OpenedCapture>,
        /// Points of the mesh and where photographs show them, to begin with; none to begin from nothing.
        points: Vec<MarkedPoint>,
    },
    /// Solve a capture.
    Solve {
        /// What to solve.
        capture: Arc<Capture>,
        /// How.
        options: SolveOptions,
        /// The light, where it is known.
        light: Option<LightProbe>,
        /// Seconds that loading it took.
        load_s: f64,
    },
    /// Anything else.
    Task {
        /// What it does, as in "exporting the picture".
        what: String,
        /// The work. It is to return soon after a report is answered by `Break`, or the second function says to stop.
        work: Box<Work>,
    },
}

/// A capture that was opened.
pub struct OpenedCapture {
    /// Where it came from.
    pub source: Source,
    /// The capture.
    pub capture: Arc<Capture>,
    /// What is wrong with it.
    pub report: Report,
    /// A small picture of every view.
    pub thumbnails: Vec<Thumbnail>,
    /// Seconds that loading it took.
    pub load_s: f64,
}

/// A fact that the window must hear of.
pub enum Event {
    /// A capture was opened.
    Capture(Box<OpenedCapture>),
    /// The mesh of a capture was aligned.
    Aligned {
        /// The capture with the mesh in its new place.
        opened: Box<OpenedCapture>,
        /// How it came there.
        alignment: Alignment,
    },
    /// A solution was opened.
    Solution {
        /// Its folder.
        folder: PathBuf,
        /// The solution.
        solution: Arc<Solution>,
    },
    /// A project was opened.
    Project {
        /// Its file; none if it was recovered after a crash.
        path: Option<PathBuf>,
        /// The document.
        document: Box<Document>,
        /// What a user should know.
        warnings: Vec<String>,
    },
    /// A solve ended.
    Solved(Arc<Solution>),
    /// A task ended.
    Done {
        /// What it did.
        what: String,
    },
    /// The running command was stopped.
    Stopped,
    /// The running command failed.
    Failed {
        /// What was being done, as in "opening the capture".
        what: String,
        /// Why it failed and what to do.
        message: String,
    },
    /// A file dialog was answered.
    Picked {
        /// What the dialog was for.
        purpose: Purpose,
        /// What was chosen, `None` if nothing was.
        path: Option<PathBuf>,
    },
    /// There is no file dialog on this machine.
    NoDialog {
        /// What the dialog was for.
        purpose: Purpose,
        /// The folder that it would have begun in.
        start: Option<PathBuf>,
    },
}

/// What a file dialog is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Open the folder of a capture or of a solution.
    OpenFolder,
    /// Open a file: a project or a `transforms.json`.
    OpenFile,
    /// Save the project as.
    SaveProject,
    /// Choose a folder to export to.
    ExportFolder,
    /// Choose a light probe.
    LightProbe,
    /// Choose the picture of a capture's light.
    KnownLight,
    /// Choose the folder of a capture, for its photographs.
    Photographs,
    /// Save a mesh that was aligned as.
    SaveMesh,
    /// Save the curves of an estimation as.
    SaveCurves,
}

/// A try of a roughness on the coarsest cells.
#[derive(Clone, Copy, Debug)]
pub struct Tried {
    /// The specular model.
    pub model: SpecularModel,
    /// Roughness σ, radians.
    pub sigma: f32,
    /// What it leaves unexplained, in squares.
    pub unexplained: f64,
}

/// An iteration with its lighting.
pub struct Step {
    /// Its numbers.
    pub iteration: Iteration,
    /// The specular model.
    pub model: SpecularModel,
    /// What was being done.
    pub stage: String,
    /// Which part of the whole was done when this part of the stage began.
    pub fraction: f32,
    /// Lit nodes and their radiances, RGB.
    pub lit: Vec<(u32, [f32; 3])>,
}

/// The surface's atlas and a first diffuse texture.
pub struct FirstTexture {
    /// Where each triangle lies in the texture.
    pub atlas: Atlas,
    /// Diffuse radiance per texel, RGB.
    pub radiance: Vec<[f32; 3]>,
}

/// All that is known of a running command, most of it of a solve.
#[derive(Clone)]
pub struct Progress {
    /// Number of the command.
    pub job: u64,
    /// What is being done.
    pub stage: String,
    /// Which part of the whole is done.
    pub fraction: f32,
    /// When it began.
    pub started: Instant,
    /// Time during which it was paused.
    pub paused: Duration,
    /// The nodes, with those below the horizon.
    pub grid: Option<Arc<HemisphereGrid>>,
    /// Makes pictures of the nodes.
    pub from_above: Option<Arc<FromAbove>>,
    /// The first diffuse texture.
    pub texture: Option<Arc<FirstTexture>>,
    /// Partial hemispheres so far, one per view in order.
    pub partials: Vec<Arc<Picture>>,
    /// The initial hemisphere.
    pub initial: Option<Arc<Picture>>,
    /// Roughnesses tried.
    pub tried: Vec<Tried>,
    /// Iterations so far.
    pub steps: Vec<Arc<Step>>,
}

impl Step {
    /// Radiances of all `nodes` nodes, RGB.
    pub fn nodes(&self, nodes: usize) -> Vec<[f32; 3]> {
        let mut radiance = vec![[0.0; 3]; nodes];
        for &(node, value) in &self.lit {
            radiance[node as usize] = value;
        }
        radiance
    }
}

/// A slot whose newest content replaces what was not yet taken.
pub struct Latest<T> {
    slot: Mutex<Option<T>>,
    filled: Condvar,
}

impl<T> Default for Latest<T> {
    fn default() -> Self {
        Self {
            slot: Mutex::new(None),
            filled: Condvar::new(),
        }
    }
}

impl<T> Latest<T> {
    /// Puts something into the slot.
    pub fn store(&self, value: T) {
        *self.lock() = Some(value);
        self.filled.notify_one();
    }

    /// Takes what is in the slot.
    pub fn take(&self) -> Option<T> {
        self.lock().take()
    }

    fn wait(&self) -> T {
        let mut slot = self.lock();
        loop {
            if let Some(value) = slot.take() {
                return value;
            }
            slot = self
                .filled
                .wait(slot)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Option<T>> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What the window asks of one command.
#[derive(Default)]
struct Control {
    stop: AtomicBool,
    enough: AtomicBool,
    paused: AtomicBool,
    /// Set for good when the window closes, the same for all commands.
    closing: Arc<AtomicBool>,
}

/// A command on its way.
struct Job {
    number: u64,
    command: Command,
    control: Arc<Control>,
}

impl Control {
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.closing.load(Ordering::Relaxed)
    }

    /// Waits while paused; then whether to go on. Also says how long it waited.
    fn answer(&self) -> (ControlFlow<()>, Duration) {
        let since = Instant::now();
        let mut waited = Duration::ZERO;
        while self.paused.load(Ordering::Relaxed) && !self.stopped() {
            std::thread::sleep(PAUSE);
            waited = since.elapsed();
        }
        if self.stopped() {
            (ControlFlow::Break(()), waited)
        } else {
            (ControlFlow::Continue(()), waited)
        }
    }
}

/// What the reference renderer is to show.
#[derive(Clone)]
pub enum Subject {
    /// A solution.
    Solved(Arc<Solution>),
    /// An object whose solve is still running: first diffuse texture, specular part as estimated so far.
    Running {
        /// The capture.
        capture: Arc<Capture>,
        /// Its first texture.
        texture: Arc<FirstTexture>,
        /// Specular model and roughness so far.
        brdf: Brdf,
    },
}

/// A picture to be rendered.
#[derive(Clone)]
pub struct Shot {
    /// Comes back with the picture.
    pub id: u64,
    /// What to show.
    pub subject: Subject,
    /// From where.
    pub camera: Camera,
    /// Under which light.
    pub lighting: Lighting,
}

/// A picture that was rendered.
pub struct Rendered {
    /// The id of its [`Shot`].
    pub id: u64,
    /// The camera.
    pub camera: Camera,
    /// The picture.
    pub picture: relight::Picture,
}

enum Preview {
    Shot(Box<Shot>),
    Close,
}

/// The window's side of the threads. Dropping it stops and joins them.
pub struct Worker {
    commands: Option<SyncSender<Job>>,
    events: Option<Receiver<(u64, Event)>>,
    dialogs: SyncSender<(u64, Event)>,
    /// The newest command's.
    control: Arc<Control>,
    jobs: u64,
    progress: Arc<Latest<Arc<Progress>>>,
    shots: Arc<Latest<Preview>>,
    pictures: Arc<Latest<Rendered>>,
    wake: Wake,
    threads: Vec<JoinHandle<()>>,
}

impl Worker {
    /// Starts the threads. `wake` is called whenever there is something new.
    pub fn new(wake: Wake) -> std::io::Result<Self> {
        let (commands, waiting) = sync_channel(COMMANDS);
        let (facts, events) = sync_channel(EVENTS);
        let control = Arc::new(Control::default());
        let progress = Arc::new(Latest::default());
        let shots = Arc::new(Latest::default());
        let pictures = Arc::new(Latest::default());
        let bench = Bench {
            events: facts.clone(),
            progress: Arc::clone(&progress),
            wake: Arc::clone(&wake),
        };
        let working = Builder::new()
            .name("worker".to_owned())
            .spawn(move || bench.work(&waiting))?;
        let studio = Previews {
            shots: Arc::clone(&shots),
            closing: Arc::clone(&control.closing),
            pictures: Arc::clone(&pictures),
            wake: Arc::clone(&wake),
        };
        let rendering = Builder::new()
            .name("preview".to_owned())
            .spawn(move || studio.work())?;
        Ok(Self {
            commands: Some(commands),
            events: Some(events),
            dialogs: facts,
            control,
            jobs: 0,
            progress,
            shots,
            pictures,
            wake,
            threads: vec![working, rendering],
        })
    }

    /// Hands over a command and returns its number. It waits until the one before has ended; `None` if too many are waiting
    /// already. Stop, pause and finish are about the newest command.
    pub fn send(&mut self, command: Command) -> Option<u64> {
        let control = Arc::new(Control {
            closing: Arc::clone(&self.control.closing),
            ..Control::default()
        });
        let job = Job {
            number: self.jobs + 1,
            command,
            control: Arc::clone(&control),
        };
        self.commands.as_ref()?.try_send(job).ok()?;
        self.control = control;
        self.jobs += 1;
        Some(self.jobs)
    }

    /// The next fact, if there is one, with the number of the command that it is about, 0 for file dialogs.
    pub fn event(&self) -> Option<(u64, Event)> {
        self.events.as_ref()?.try_recv().ok()
    }

    /// The state of the running solve, if it has changed.
    pub fn progress(&self) -> Option<Arc<Progress>> {
        self.progress.take()
    }

    /// Stops the running command.
    pub fn stop(&self) {
        self.control.stop.store(true, Ordering::Relaxed);
    }

    /// Ends the running estimation with what it has reached.
    pub fn finish(&self) {
        self.control.enough.store(true, Ordering::Relaxed);
        self.control.paused.store(false, Ordering::Relaxed);
    }

    /// Pauses the running command or lets it go on.
    pub fn pause(&self, paused: bool) {
        self.control.paused.store(paused, Ordering::Relaxed);
    }

    /// Whether the running command is paused.
    pub fn is_paused(&self) -> bool {
        self.control.paused.load(Ordering::Relaxed)
    }

    /// Renders a picture with the reference renderer, in place of any that is still waiting.
    pub fn render(&self, shot: Shot) {
        self.shots.store(Preview::Shot(Box::new(shot)));
    }

    /// The picture rendered last, if it is new.
    pub fn rendered(&self) -> Option<Rendered> {
        self.pictures.take()
    }

    /// Does something short, such as writing a file, beside the running command. The window is woken when it ends.
    pub fn aside(&mut self, name: &str, work: impl FnOnce() + Send + 'static) {
        let wake = Arc::clone(&self.wake);
        self.threads.retain(|thread| !thread.is_finished());
        // Where no thread can be had, it is done at once, if need be at the window's cost.
        let work = Arc::new(Mutex::new(Some(work)));
        let shared = Arc::clone(&work);
        let thread = Builder::new().name(name.to_owned()).spawn(move || {
            run_once(&shared);
            wake();
        });
        match thread {
            Ok(thread) => self.threads.push(thread),
            Err(_) => run_once(&work),
        }
    }

    /// Shows the system's file dialog; the answer comes as an event.
    pub fn pick(&self, purpose: Purpose, start: Option<&Path>) {
        let (events, wake) = (self.dialogs.clone(), Arc::clone(&self.wake));
        let start = start.map(Path::to_owned);
        let none = Event::NoDialog {
            purpose,
            start: start.clone(),
        };
        let dialog = Builder::new().name("dialog".to_owned()).spawn(move || {
            let since = Instant::now();
            let path = ask(purpose, start.as_deref());
            let event = if path.is_none() && since.elapsed() < NO_DIALOG {
                Event::NoDialog { purpose, start }
            } else {
                Event::Picked { purpose, path }
            };
            if events.send((0, event)).is_ok() {
                wake();
            }
        });
        if dialog.is_err() && self.dialogs.try_send((0, none)).is_ok() {
            (self.wake)();
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.control.closing.store(true, Ordering::Relaxed);
        self.commands = None;
        // Without its receiver nothing waits for a place in the queue.
        self.events = None;
        self.shots.store(Preview::Close);
        for thread in self.threads.drain(..) {
            // A thread that panicked has nothing more to say.
            let _ = thread.join();
        }
    }
}

fn run_once(work: &Mutex<Option<impl FnOnce()>>) {
    let work = work.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(work) = work {
        work();
    }
}

/// The system's file dialog; returns when it is closed.
fn ask(purpose: Purpose, start: Option<&Path>) -> Option<PathBuf> {
    let mut dialog = rfd::FileDialog::new();
    if let Some(start) = start {
        dialog = dialog.set_directory(start);
    }
    match purpose {
        Purpose::OpenFolder => dialog
            .set_title("Open a capture or a solution")
            .pick_folder(),
        Purpose::OpenFile => dialog
            .set_title("Open a project")
            .add_filter("Projects and captures", &[EXTENSION, "json"])
            .pick_file(),
        Purpose::SaveProject => dialog
            .set_title("Save the project")
            .set_file_name(format!("project.{EXTENSION}"))
            .save_file(),
        Purpose::ExportFolder => dialog.set_title("Export to").pick_folder(),
        Purpose::Photographs => dialog
            .set_title("Locate the photographs' capture")
            .pick_folder(),
        Purpose::SaveMesh => dialog
            .set_title("Save the mesh")
            .set_file_name("mesh.obj")
            .save_file(),
        Purpose::SaveCurves => dialog
            .set_title("Save the curves")
            .add_filter("Numbers or a picture", &["csv", "svg"])
            .set_file_name("curves.csv")
            .save_file(),
        Purpose::LightProbe | Purpose::KnownLight => dialog
            .set_title("Open a light probe")
            .add_filter("Light probes", &["hdr", "exr"])
            .pick_file(),
    }
}

/// The worker's side.
struct Bench {
    events: SyncSender<(u64, Event)>,
    progress: Arc<Latest<Arc<Progress>>>,
    wake: Wake,
}

impl Bench {
    fn work(&self, jobs: &Receiver<Job>) {
        while let Ok(job) = jobs.recv() {
            if job.control.closing.load(Ordering::Relaxed) {
                return;
            }
            let what = match &job.command {
                Command::Open(_) => "Opening".to_owned(),
                Command::Recover(_) => "Recovering".to_owned(),
                Command::Align { .. } => "Aligning".to_owned(),
                Command::Solve { .. } => "Solving".to_owned(),
                Command::Task { what, .. } => what.clone(),
            };
            let (number, control) = (job.number, Arc::clone(&job.control));
            let result = catch_unwind(AssertUnwindSafe(|| self.run(job, &what)));
            let event = match result {
                _ if control.stopped() => Event::Stopped,
                Ok(Ok(event)) => event,
                Ok(Err(error)) => Event::Failed {
                    what,
                    message: message(&error),
                },
                Err(panic) => Event::Failed {
                    what,
                    message: format!(
                        "A mistake in rekindle: {}. Nothing that is open was changed; please report it.",
                        panic_text(panic.as_ref())
                    ),
                },
            };
            if self.events.send((number, event)).is_err() {
                return;
            }
            (self.wake)();
        }
    }

    fn run(&self, job: Job, what: &str) -> anyhow::Result<Event> {
        let mut shown = Shown::new(self, job.number, &job.control);
        match job.command {
            Command::Open(source) => open(source),
            Command::Recover(left) => {
                let (document, warnings) = left.open()?;
                Ok(Event::Project {
                    path: None,
                    document: Box::new(document),
                    warnings,
                })
            }
            Command::Align { opened, points } => {
                let tell = &mut |part| {
                    // Whoever stops it is asked besides.
                    let _ = shown.progress("aligning silhouettes", part);
                };
                realign(&opened, &points, tell, &|| job.control.stopped())
            }
            Command::Solve {
                capture,
                options,
                light,
                load_s,
            } => {
                if let Some(light) = &light {
                    light.check(&capture, &options)?;
                }
                let solved = solve_under(
                    &capture.reduced(),
                    &options,
                    light.as_ref(),
                    load_s,
                    &mut shown,
                );
                Ok(match solved {
                    Ok(solution) => Event::Solved(Arc::new(solution)),
                    Err(Stopped) => Event::Stopped,
                })
            }
            Command::Task { work, .. } => {
                let tell = &mut |stage: &str, fraction: f32| shown.progress(stage, fraction);
                work(tell, &|| job.control.stopped())?;
                Ok(Event::Done {
                    what: what.to_owned(),
                })
            }
        }
    }
}

fn open(source: Source) -> anyhow::Result<Event> {
    let started = Instant::now();
    let (capture, pixels) = match &source {
        Source::Demo => {
            let folder = tempfile::tempdir()?;
            unpack_demo(folder.path())?;
            let (mut capture, pixels) = Capture::load_counting(folder.path())?;
            DEMO.clone_into(&mut capture.name);
            (capture, pixels)
        }
        Source::Path(path) => {
            if path.extension().is_some_and(|e| e == EXTENSION) {
                let (document, warnings) = Document::open(path)?;
                return Ok(Event::Project {
                    path: Some(path.clone()),
                    document: Box::new(document),
                    warnings,
                });
            }
            let folder = solution_folder(path);
            if folder.join("solution.json").is_file() {
                return Ok(Event::Solution {
                    folder: folder.to_owned(),
                    solution: Arc::new(Solution::load(folder)?),
                });
            }
            // A mesh in another frame than the cameras can be aligned in the window.
            Capture::load_unplaced(path)?
        }
    };
    let load_s = started.elapsed().as_secs_f64();
    let opened = checked(source, capture, &pixels, load_s);
    Ok(Event::Capture(Box::new(opened)))
}

fn checked(source: Source, capture: Capture, pixels: &[PixelCounts], load_s: f64) -> OpenedCapture {
    let report = Report::new(&capture, pixels);
    let occluder = Occluder::new(&capture.mesh);
    let small = |view| Thumbnail::new(view, &capture.mesh, &occluder);
    let thumbnails = capture.views.iter().map(small).collect();
    OpenedCapture {
        source,
        capture: Arc::new(capture),
        report,
        thumbnails,
        load_s,
    }
}

fn realign(
    opened: &OpenedCapture,
    points: &[MarkedPoint],
    progress: &mut dyn FnMut(f32),
    stop: Stop<'_>,
) -> anyhow::Result<Event> {
    let capture = &opened.capture;
    let start = if points.is_empty() {
        Start::Anywhere
    } else {
        Start::Marks(points)
    };
    let alignment = align(&capture.views, &capture.mesh, start, progress, stop)?;
    let moved = Capture {
        mesh: alignment.transform.moved(&capture.mesh),
        ..Capture::clone(capture)
    };
    let pixels: Vec<PixelCounts> = opened.report.views.iter().map(|v| v.pixels).collect();
    let opened = checked(opened.source.clone(), moved, &pixels, opened.load_s);
    Ok(Event::Aligned {
        opened: Box::new(opened),
        alignment,
    })
}

/// What went wrong and why. Causes that a message has taken up are not repeated.
pub fn message(error: &anyhow::Error) -> String {
    let mut message = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if !message.contains(&cause) {
            let between = if message.is_empty() { "" } else { ": " };
            message = message + between + &cause;
        }
    }
    message.replace('\n', " ")
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("no message")
}

/// Shows a solve in the window and hears what the window asks of it.
struct Shown<'a> {
    bench: &'a Bench,
    control: &'a Control,
    progress: Progress,
    model: SpecularModel,
}

impl<'a> Shown<'a> {
    fn new(bench: &'a Bench, job: u64, control: &'a Control) -> Self {
        Self {
            bench,
            control,
            progress: Progress {
                job,
                stage: String::new(),
                fraction: 0.0,
                started: Instant::now(),
                paused: Duration::ZERO,
                grid: None,
                from_above: None,
                texture: None,
                partials: Vec::new(),
                initial: None,
                tried: Vec::new(),
                steps: Vec::new(),
            },
            model: SpecularModel::Paper,
        }
    }

    fn publish(&self) {
        self.bench.progress.store(Arc::new(self.progress.clone()));
        (self.bench.wake)();
    }

    fn go_on(&mut self) -> ControlFlow<()> {
        let (answer, waited) = self.control.answer();
        self.progress.paused += waited;
        answer
    }

    fn picture(&mut self, grid: &HemisphereGrid, radiance: &[[f32; 3]]) -> Arc<Picture> {
        if self.progress.grid.is_none() {
            // Later steps may have light below the horizon.
            self.progress.grid = Some(Arc::new(grid.to_whole()));
        }
        let from_above = self
            .progress
            .from_above
            .get_or_insert_with(|| Arc::new(FromAbove::new(grid, PICTURE_SIDE)));
        Arc::new(from_above.picture(radiance))
    }
}

impl Observer for Shown<'_> {
    fn progress(&mut self, what: &str, fraction: f32) -> ControlFlow<()> {
        if self.progress.stage != what || self.progress.fraction != fraction {
            what.clone_into(&mut self.progress.stage);
            self.progress.fraction = fraction;
            self.publish();
        }
        self.go_on()
    }

    fn iteration(
        &mut self,
        iteration: &Iteration,
        hemisphere: &dyn Fn() -> Vec<[f32; 3]>,
    ) -> ControlFlow<()> {
        let lit = hemisphere()
            .into_iter()
            .enumerate()
            .filter(|(_, radiance)| *radiance != [0.0; 3])
            .map(|(node, radiance)| (node as u32, radiance))
            .collect();
        self.progress.steps.push(Arc::new(Step {
            iteration: Iteration {
                // Of the whole solve, without the pauses.
                elapsed_s: self
                    .progress
                    .started
                    .elapsed()
                    .saturating_sub(self.progress.paused)
                    .as_secs_f64(),
                ..*iteration
            },
            model: self.model,
            stage: self.progress.stage.clone(),
            fraction: self.progress.fraction,
            lit,
        }));
        self.publish();
        self.go_on()
    }

    fn interim(&mut self, interim: Interim<'_>) {
        match interim {
            Interim::Texture { atlas, radiance } => {
                self.progress.texture = Some(Arc::new(FirstTexture {
                    atlas: atlas.clone(),
                    radiance: radiance.to_vec(),
                }));
            }
            Interim::Partial { grid, radiance, .. } => {
                let picture = self.picture(grid, radiance);
                self.progress.partials.push(picture);
            }
            Interim::Initial { grid, radiance } => {
                self.progress.initial = Some(self.picture(grid, radiance));
            }
            Interim::Lobe(model) => self.model = model,
            Interim::Tried {
                model,
                sigma,
                unexplained,
            } => self.progress.tried.push(Tried {
                model,
                sigma,
                unexplained,
            }),
        }
        self.publish();
    }

    fn enough(&mut self) -> bool {
        self.control.enough.load(Ordering::Relaxed)
    }
}

/// What the reference renderer needs of a subject beside the subject itself.
struct Prepared {
    occluder: Occluder,
    interreflection: Option<Interreflection>,
}

impl Subject {
    fn is_same_object(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Solved(a), Self::Solved(b)) => Arc::ptr_eq(a, b),
            (Self::Running { capture: a, .. }, Self::Running { capture: b, .. }) => {
                Arc::ptr_eq(a, b)
            }
            _ => false,
        }
    }

    fn prepare(&self) -> Prepared {
        match self {
            Self::Solved(solution) => {
                let occluder = Occluder::new(&solution.mesh);
                let interreflection =
                    Interreflection::new(&solution.mesh, &occluder, solution.brdf);
                Prepared {
                    occluder,
                    interreflection,
                }
            }
            Self::Running { capture, .. } => Prepared {
                occluder: Occluder::new(&capture.mesh),
                interreflection: None,
            },
        }
    }
}

/// The side of the thread that renders shots.
struct Previews {
    shots: Arc<Latest<Preview>>,
    closing: Arc<AtomicBool>,
    pictures: Arc<Latest<Rendered>>,
    wake: Wake,
}

impl Previews {
    /// Renders shots, always the newest, until told to close.
    fn work(&self) {
        let mut last: Option<(Subject, Prepared)> = None;
        while let Preview::Shot(shot) = self.shots.wait() {
            let prepared = match last.take() {
                Some((subject, prepared)) if subject.is_same_object(&shot.subject) => prepared,
                _ => shot.subject.prepare(),
            };
            let picture = catch_unwind(AssertUnwindSafe(|| {
                take_picture(&shot, &prepared, &self.closing)
            }));
            if let Ok(picture) = picture {
                self.pictures.store(Rendered {
                    id: shot.id,
                    camera: shot.camera,
                    picture,
                });
                (self.wake)();
            }
            last = Some((shot.subject, prepared));
        }
    }
}

fn take_picture(shot: &Shot, prepared: &Prepared, closing: &AtomicBool) -> relight::Picture {
    match &shot.subject {
        Subject::Solved(solution) => take_solved(shot, solution, prepared, closing),
        Subject::Running {
            capture,
            texture,
            brdf,
        } => {
            let shader =
                Shader::new(&prepared.occluder, Some(*brdf), &shot.lighting).stopped_by(closing);
            let scene = Scene {
                mesh: &capture.mesh,
                occluder: &prepared.occluder,
                brdf: Some(*brdf),
                gloss: None,
                surroundings: None,
            };
            let diffuse = Diffuse::Stored(&texture.atlas, &texture.radiance);
            relight::render(&scene, &shot.camera, &shader, diffuse)
        }
    }
}

/// A solution as `rekindle render` shows it.
fn take_solved(
    shot: &Shot,
    solution: &Solution,
    prepared: &Prepared,
    closing: &AtomicBool,
) -> relight::Picture {
    let shader = Shader::new(&prepared.occluder, solution.brdf, &shot.lighting).stopped_by(closing);
    let unchanged = shot.lighting == solution.lighting();
    let atlas = &solution.atlas;
    let (texture, diffuse) = if unchanged {
        let texture = &solution.diffuse;
        (texture, Diffuse::Stored(atlas, texture))
    } else {
        let texture = &solution.albedo;
        (texture, Diffuse::Relit(atlas, texture))
    };
    let interreflection = prepared.interreflection.as_ref();
    let relit = interreflection
        .filter(|_| !unchanged)
        .map(|i| i.of_light(&solution.mesh, &shader, atlas, texture));
    let surroundings =
        interreflection.map(|around| Surroundings::new(around, Some((atlas, texture)), relit));
    let scene = Scene {
        mesh: &solution.mesh,
        occluder: &prepared.occluder,
        brdf: solution.brdf,
        gloss: solution.gloss_map(),
        surroundings: surroundings.as_ref(),
    };
    relight::render(&scene, &shot.camera, &shader, diffuse)
}
