//! What is left after a crash: every running window keeps its unsaved work in a folder of its own, with a lock on it. A folder
//! whose lock is free was left by a window that is no more.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use super::document::Document;
use super::project::{EXTENSION, ProjectError, Snapshot};
use rekindle_solution::Solution;

/// File that a running window holds locked.
const LOCK: &str = "lock";

/// Where recovery folders are: `rekindle/recovery` in the user's folder for state (`XDG_STATE_HOME`), or for data where the
/// system has none for state. `None` where there is no home.
pub fn state_folder() -> Option<PathBuf> {
    let folders = directories::ProjectDirs::from("", "", "rekindle")?;
    let state = folders.state_dir().unwrap_or(folders.data_local_dir());
    Some(state.join("recovery"))
}

/// A running window's own recovery folder.
pub struct Recovery {
    folder: PathBuf,
    /// Held as long as the window runs.
    _lock: File,
    /// The solution that is written in the folder already.
    solution: Option<Arc<Solution>>,
}

/// Work that a crash left behind.
#[derive(Debug)]
pub struct Recoverable {
    folder: PathBuf,
    /// Held while it is decided on, so that no other window offers it too.
    _lock: File,
    /// When it was last kept.
    pub kept: SystemTime,
}

impl Recovery {
    /// A new folder in `base`.
    pub fn begin(base: &Path) -> io::Result<Self> {
        fs::create_dir_all(base)?;
        let folder = tempfile::Builder::new()
            .prefix("window-")
            .tempdir_in(base)?
            .keep();
        let lock = File::create(folder.join(LOCK))?;
        lock.lock()?;
        Ok(Self {
            folder,
            _lock: lock,
            solution: None,
        })
    }

    fn file(&self) -> PathBuf {
        self.folder.join("project").with_extension(EXTENSION)
    }

    /// Keeps the work as it is. The first time with a solution that is nowhere else takes a second or so.
    pub fn keep(&mut self, snapshot: &Snapshot) -> Result<(), ProjectError> {
        let solution = snapshot.solution();
        let written = self
            .solution
            .as_ref()
            .is_some_and(|s| Arc::ptr_eq(s, solution));
        snapshot.save_for_recovery(&self.file(), written)?;
        if snapshot.has_unsaved_solution() {
            self.solution = Some(Arc::clone(solution));
        }
        Ok(())
    }

    /// Forgets the work: it is saved, or was given up.
    pub fn clear(&mut self) {
        // What can't be removed is offered at the next start: nothing is lost.
        let _ = fs::remove_file(self.file());
        let _ = fs::remove_dir_all(self.file().with_extension("solution"));
        self.solution = None;
    }

    /// What windows that are no more have left in `base`, the newest first. Empty folders of theirs are removed.
    pub fn left_behind(base: &Path) -> Vec<Recoverable> {
        let entries = fs::read_dir(base).into_iter().flatten().flatten();
        let mut found: Vec<Recoverable> =
            entries.filter_map(|e| Recoverable::at(e.path())).collect();
        found.sort_by(|a, b| b.kept.cmp(&a.kept).then_with(|| a.folder.cmp(&b.folder)));
        found
    }
}

impl Drop for Recovery {
    fn drop(&mut self) {
        // Dropped in order, the window has asked what to do with unsaved work. A crash doesn't come by here.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

impl Recoverable {
    fn at(folder: PathBuf) -> Option<Self> {
        let lock = File::open(folder.join(LOCK)).ok()?;
        lock.try_lock().ok()?;
        let file = folder.join("project").with_extension(EXTENSION);
        let Ok(kept) = fs::metadata(&file).and_then(|m| m.modified()) else {
            // Nothing unsaved was left. What can't be removed does no harm.
            let _ = fs::remove_dir_all(&folder);
            return None;
        };
        Some(Self {
            folder,
            _lock: lock,
            kept,
        })
    }

    fn file(&self) -> PathBuf {
        self.folder.join("project").with_extension(EXTENSION)
    }

    /// Opens it; it counts as modified. The second value is as for [`Document::open`].
    pub fn open(&self) -> Result<(Document, Vec<String>), ProjectError> {
        Document::recover(&self.file())
    }

    /// Removes it for good.
    pub fn discard(self) {
        // What can't be removed is offered again: nothing is lost.
        let _ = fs::remove_dir_all(&self.folder);
    }
}
