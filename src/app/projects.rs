//! Projects: saving, the question about unsaved changes, and what a crash leaves behind.
//!
//! Whatever is unsaved is kept in a recovery folder a few seconds after it changed. Files are written beside the window's
//! thread and beside a running solve.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use eframe::egui::{self, Id};

use super::theme;
use crate::worker::{Latest, Source, Worker, message};
use rekindle_studio::{Document, Recoverable, Recovery, Saved, Snapshot};

/// Seconds after a change until it is kept.
const KEPT_AFTER_S: f64 = 5.0;

/// What is to be done once unsaved changes are dealt with.
#[derive(Clone, Debug, PartialEq)]
pub enum Then {
    /// Close the window.
    Quit,
    /// Open something else.
    Open(Source),
    /// Estimate again.
    Solve,
    /// Relight with another run.
    RelightRun,
}

/// What the user said to the question about unsaved changes.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// Save, then go on.
    Save(Then),
    /// Go on without saving.
    Discard(Then),
    /// Stay.
    Cancel,
}

/// What came of writing a file.
type Outcome = Result<Saved, String>;

/// Saving and recovery of the open document.
pub struct Projects {
    /// Where recovery folders are; none in tests that want none.
    base: Option<PathBuf>,
    recovery: Option<Arc<Mutex<Recovery>>>,
    left_behind: Vec<Arc<Recoverable>>,
    saving: bool,
    saved: Arc<Latest<Outcome>>,
    /// Revision of the document that is kept, and since when a newer one waits.
    kept: u64,
    waiting: Option<f64>,
    failed: Arc<Latest<String>>,
    question: Option<Then>,
    /// What to do once the file is written.
    then: Option<Then>,
}

impl Projects {
    /// Looks for what was left behind in `base`.
    pub fn new(base: Option<PathBuf>) -> Self {
        let left_behind = base.as_deref().map(Recovery::left_behind).map(|left| {
            let left = left.into_iter();
            left.map(Arc::new).collect()
        });
        Self {
            base,
            recovery: None,
            left_behind: left_behind.unwrap_or_default(),
            saving: false,
            saved: Arc::default(),
            kept: 0,
            waiting: None,
            failed: Arc::default(),
            question: None,
            then: None,
        }
    }

    /// Work that a crash left behind, the newest first.
    pub fn left_behind(&self) -> &[Arc<Recoverable>] {
        &self.left_behind
    }

    /// What was left behind is open now: it is kept anew under this window's name, then removed.
    pub fn recovered(&mut self, worker: &mut Worker, document: &Document, left: &Arc<Recoverable>) {
        self.left_behind.retain(|other| !Arc::ptr_eq(other, left));
        self.keep_now(worker, document.snapshot(), Some(Arc::clone(left)));
        self.kept = document.revision();
    }

    /// Gives up what was left behind.
    pub fn discard(&mut self, index: usize) {
        if let Some(left) = Arc::into_inner(self.left_behind.remove(index)) {
            left.discard();
        }
    }

    /// Another document is open now.
    pub fn reset(&mut self) {
        self.kept = u64::MAX;
        self.waiting = None;
    }

    /// Whether a file is being written.
    pub fn is_saving(&self) -> bool {
        self.saving
    }

    /// Writes the document.
    pub fn save(
        &mut self,
        worker: &mut Worker,
        document: &Document,
        path: &Path,
        then: Option<Then>,
    ) {
        self.saving = true;
        self.then = then;
        let (snapshot, slot) = (document.snapshot(), Arc::clone(&self.saved));
        let path = path.to_owned();
        worker.aside("save", move || {
            let saved = snapshot.save(&path);
            slot.store(saved.map_err(|error| message(&error.into())));
        });
    }

    /// What came of writing, once it ended, and what is to be done next if it went well.
    pub fn outcome(&mut self) -> Option<(Outcome, Option<Then>)> {
        let outcome = self.saved.take()?;
        self.saving = false;
        let then = self.then.take();
        if outcome.is_ok() {
            self.forget();
        }
        Some((outcome, then))
    }

    /// Nothing is unsaved any more.
    pub fn forget(&mut self) {
        if let Some(recovery) = &self.recovery {
            lock(recovery).clear();
        }
    }

    /// Keeps unsaved changes a while after they were made. Says what failed.
    pub fn keep(
        &mut self,
        ctx: &egui::Context,
        worker: &mut Worker,
        document: &Document,
    ) -> Option<String> {
        if document.is_modified() && document.revision() != self.kept && !document.is_dragging() {
            let now = ctx.input(|i| i.time);
            let since = *self.waiting.get_or_insert(now);
            if now - since >= KEPT_AFTER_S {
                self.waiting = None;
                self.kept = document.revision();
                self.keep_now(worker, document.snapshot(), None);
            } else {
                ctx.request_repaint_after_secs((KEPT_AFTER_S - (now - since)) as f32 + 0.05);
            }
        }
        self.failed.take()
    }

    /// Keeps a snapshot; `before` is removed once it is.
    fn keep_now(
        &mut self,
        worker: &mut Worker,
        snapshot: Snapshot,
        before: Option<Arc<Recoverable>>,
    ) {
        let Some(base) = &self.base else { return };
        if self.recovery.is_none() {
            match Recovery::begin(base) {
                Ok(recovery) => self.recovery = Some(Arc::new(Mutex::new(recovery))),
                Err(error) => {
                    let base = base.display();
                    self.failed.store(format!(
                        "{base}: can't be written: {error}. Unsaved work is not safe from a crash; save often."
                    ));
                    // Said once.
                    self.base = None;
                    return;
                }
            }
        }
        if let Some(recovery) = &self.recovery {
            let (recovery, failed) = (Arc::clone(recovery), Arc::clone(&self.failed));
            worker.aside("keep", move || match lock(&recovery).keep(&snapshot) {
                Ok(()) => before
                    .and_then(Arc::into_inner)
                    .map_or((), Recoverable::discard),
                Err(error) => failed.store(message(&error.into())),
            });
        }
    }

    /// Asks what to do with unsaved changes before `then`.
    pub fn ask(&mut self, then: Then) {
        self.question = Some(then);
    }

    /// Shows the question, if there is one.
    pub fn show(&mut self, ctx: &egui::Context, name: &str) -> Option<Answer> {
        let then = self.question.clone()?;
        let mut answer = None;
        let modal = egui::Modal::new(Id::unique("unsaved"))
            .frame(theme::dialog(ctx))
            .show(ctx, |ui| {
                ui.set_width(420.0);
                ui.heading("Save the changes?");
                ui.add_space(4.0);
                ui.label(match then {
                Then::Quit => {
                    format!("{name} has changes that are not saved. Without saving they are lost.")
                }
                Then::Open(_) => format!(
                    "{name} has changes that are not saved. Opening something else loses them."
                ),
                Then::Solve => format!(
                    "{name} has changes that are not saved. A new estimate replaces its lights."
                ),
                Then::RelightRun => format!(
                    "{name} has changes that are not saved. The lights of another run replace them."
                ),
            });
                ui.add_space(theme::GAP);
                ui.horizontal(|ui| {
                    let save = ui.add(theme::main_button(ui, "Save"));
                    if save.on_hover_text("Save, then go on").clicked() {
                        answer = Some(Answer::Save(then.clone()));
                    }
                    let discard = ui.button("Don't save");
                    if discard
                        .on_hover_text("Go on; the changes are lost")
                        .clicked()
                    {
                        answer = Some(Answer::Discard(then.clone()));
                    }
                    if ui.button("Cancel").on_hover_text("Back to work").clicked() {
                        answer = Some(Answer::Cancel);
                    }
                });
            });
        if modal.should_close() && answer.is_none() {
            answer = Some(Answer::Cancel);
        }
        if answer.is_some() {
            self.question = None;
        }
        answer
    }
}

fn lock(recovery: &Mutex<Recovery>) -> std::sync::MutexGuard<'_, Recovery> {
    recovery.lock().unwrap_or_else(PoisonError::into_inner)
}
