//! Results appear whole or not at all: files are written into a hidden working folder beside or in their destination, take
//! their place at the end, and are removed if anything goes wrong before. The working folder is locked; one whose lock is
//! free was left by a run that was killed, and is settled by the next (`leftovers`).

mod destination;
mod exchange;
mod fault;
mod leftovers;
mod owned;
mod provenance;
#[cfg(test)]
mod tests;

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

pub use destination::{
    DestinationError, cannot_write, check_added, check_holds_no_input, check_owned, write_advice,
};
pub use owned::Owned;
pub use provenance::MAKER;

use exchange::{Exchange, exchange, sync_all, sync_names};
use leftovers::{LOCK, MOVING, NEW, OLD, move_all, names, prefix_beside, prefix_within, settle};
use provenance::may_replace;

/// How many folders beside a destination are tried for what can't be put into it.
const MOST_BESIDE: usize = 10_000;
/// How many links are followed from a destination to what it is.
const MOST_LINKS: usize = 40;

/// Folders being written, so that an interrupted program can take them away.
static UNFINISHED: Mutex<Vec<Folders>> = Mutex::new(Vec::new());

fn unfinished() -> MutexGuard<'static, Vec<Folders>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes everything half-written, for a program that exits right after: writers still running fail from now on, and
/// nothing can be put into its place any more. A result that is just being put there is waited for.
pub fn abandon_unfinished() {
    let mut all = unfinished();
    for folders in all.drain(..) {
        // A writer may put one more file into the folder while it is being emptied.
        for _ in 0..20 {
            folders.remove();
            if !folders.path.exists() {
                break;
            }
        }
    }
    // Never unlocked: whoever would put a result into its place waits for the end of the program.
    std::mem::forget(all);
}

/// A working folder and those above it that were made for it, the innermost first.
#[derive(Clone, Debug)]
struct Folders {
    path: PathBuf,
    parents: Vec<PathBuf>,
}

impl Folders {
    /// Makes a working folder in `parent`, whose name begins with a prefix. Returns its lock too.
    fn make(parent: &Path, prefix: &OsStr) -> io::Result<(Self, File)> {
        if let Some(there) = parent.ancestors().find(|p| p.exists())
            && !there.is_dir()
        {
            let problem = format!("{} is not a folder", there.display());
            return Err(io::Error::new(io::ErrorKind::NotADirectory, problem));
        }
        let missing = parent.ancestors().take_while(|p| !p.exists());
        let mut folders = Self {
            path: PathBuf::new(),
            parents: missing.map(Path::to_owned).collect(),
        };
        let made = fs::create_dir_all(parent).and_then(|()| locked_folder(parent, prefix));
        let (path, lock) = made.inspect_err(|_| folders.remove_parents())?;
        folders.path = path;
        Ok((folders, lock))
    }

    /// Removes what is there, and the parents that are empty. What must not be lost is left to whoever comes next.
    fn remove(&self) {
        let kept = [OLD, MOVING].map(|name| self.path.join(name));
        if !kept.iter().any(|path| path.exists()) {
            let _ = fs::remove_dir_all(&self.path);
        }
        self.remove_parents();
    }

    fn remove_parents(&self) {
        for parent in &self.parents {
            let _ = fs::remove_dir(parent);
        }
    }
}

/// Makes and locks a working folder whose name is a prefix and the process's id, and a number where that is taken.
fn locked_folder(parent: &Path, prefix: &OsStr) -> io::Result<(PathBuf, File)> {
    let mut number = 0;
    loop {
        let mut name = prefix.to_owned();
        name.push(std::process::id().to_string());
        if number > 0 {
            name.push(format!("-{number}"));
        }
        number += 1;
        let path = parent.join(name);
        match fs::create_dir(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
            made => made?,
        }
        match lock(&path) {
            // Another run took it for left behind before it was locked.
            Err(error) if error.kind() == io::ErrorKind::NotFound && !path.exists() => {}
            Err(error) => {
                let _ = fs::remove_dir_all(&path);
                return Err(error);
            }
            Ok(lock) => return Ok((path, lock)),
        }
    }
}

fn lock(path: &Path) -> io::Result<File> {
    let lock = File::create(path.join(LOCK))?;
    // On a disk without locks, nothing can be locked to look whether it is left behind either.
    let _ = lock.lock();
    fs::create_dir(path.join(NEW))?;
    Ok(lock)
}

/// Where files really go: links are followed, also to what is not there yet.
fn real(target: &Path) -> io::Result<PathBuf> {
    let mut path = target.to_owned();
    for _ in 0..MOST_LINKS {
        if let Ok(there) = path.canonicalize() {
            return Ok(there);
        }
        let Ok(link) = fs::read_link(&path) else {
            return Ok(path);
        };
        path = path.parent().unwrap_or(Path::new("")).join(link);
    }
    Err(io::Error::other("its links lead to one another"))
}

/// A folder that becomes the result, or vanishes.
#[derive(Debug)]
pub struct Staging {
    folders: Folders,
    /// Held as long as the folder is written.
    _lock: File,
    new: PathBuf,
    target: PathBuf,
    /// Where the target is, links followed.
    real_target: PathBuf,
    settled: Vec<String>,
}

impl Staging {
    /// An empty folder beside `target`, which it is to replace; missing parents are made.
    pub fn beside(target: &Path) -> io::Result<Self> {
        if target.file_name().is_none() {
            let problem = "the path does not end in a folder's name";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, problem));
        }
        Self::make(target, false)
    }

    /// An empty folder for files that are to be added to `target`: in it, or beside it where it does not exist yet.
    pub fn within(target: &Path) -> io::Result<Self> {
        Self::make(target, true)
    }

    fn make(target: &Path, inside: bool) -> io::Result<Self> {
        let mut all = unfinished();
        let real_target = real(target)?;
        let settled = settle(&real_target)?;
        if real_target.exists() && !real_target.is_dir() {
            let problem = "it is a file, not a folder";
            return Err(io::Error::new(io::ErrorKind::NotADirectory, problem));
        }
        let (folders, lock) = if inside && real_target.is_dir() {
            Folders::make(&real_target, &prefix_within())?
        } else {
            let name = real_target.file_name().unwrap_or_default();
            Folders::make(parent(&real_target), &prefix_beside(name))?
        };
        all.push(folders.clone());
        Ok(Self {
            new: folders.path.join(NEW),
            folders,
            _lock: lock,
            target: target.to_owned(),
            real_target,
            settled,
        })
    }

    /// The folder to write into.
    pub fn path(&self) -> &Path {
        &self.new
    }

    /// The folder that it becomes, as it was named.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// What runs that were killed had left there and what became of it, in whole sentences.
    pub fn settled(&self) -> &[String] {
        &self.settled
    }

    /// Puts the folder in the place of the target, which is removed if it exists and `check` allows it.
    pub fn replace(
        self,
        check: impl FnOnce(&Path) -> Result<(), DestinationError>,
    ) -> Result<(), DestinationError> {
        self.replace_by(exchange, check)
    }

    fn replace_by(
        self,
        exchange: Exchange,
        check: impl FnOnce(&Path) -> Result<(), DestinationError>,
    ) -> Result<(), DestinationError> {
        let failed = cannot_write(&self.target);
        sync_all(&self.new).map_err(&failed)?;
        let _uninterrupted = unfinished();
        if !self.real_target.exists() {
            return self.appear().map_err(&failed);
        }
        check(&self.target)?;
        let old = self.folders.path.join(OLD);
        exchange(&self.new, &self.real_target, &old).map_err(&failed)?;
        sync_names(parent(&self.real_target));
        // The new one is there: what is left of the old one is removed with the working folder, now or by the next run.
        let _ = fs::remove_dir_all(&old);
        Ok(())
    }

    /// Moves the folder's files into the target, which may hold others. What others wrote there is not replaced: where it is in
    /// the way, the files are put into a new folder beside the target, so that the work is not lost.
    pub fn add(self) -> Result<(), DestinationError> {
        let target = self.target.clone();
        let failed = cannot_write(&target);
        let mut others = Vec::new();
        for name in names(&self.new).map_err(&failed)? {
            let [there, new] = [&self.real_target, &self.new].map(|folder| folder.join(&name));
            if !there.is_dir() && !may_replace(&there, &new).map_err(&failed)? {
                others.push(name.into());
            }
        }
        if others.is_empty() {
            return self.add_all().map_err(failed);
        }
        Err(self.keep_beside(&others))
    }

    /// Moves the folder's files into the target in place of all that have their names, which someone has agreed to.
    pub fn add_all(self) -> io::Result<()> {
        sync_all(&self.new)?;
        let _uninterrupted = unfinished();
        if !self.real_target.exists() {
            return self.appear();
        }
        for name in names(&self.new)? {
            let there = self.real_target.join(&name);
            if there.is_dir() {
                let problem = format!("{} is a folder", there.display());
                return Err(io::Error::new(io::ErrorKind::IsADirectory, problem));
            }
        }
        let moving = self.folders.path.join(MOVING);
        File::create(&moving)?.sync_all()?;
        sync_names(&self.folders.path);
        move_all(&self.new, &self.real_target)?;
        sync_names(&self.real_target);
        fs::remove_file(moving)
    }

    /// Becomes a new folder beside the target, in whose way files of others are. Returns the error that says so.
    fn keep_beside(&self, others: &[PathBuf]) -> DestinationError {
        let beside = |number: usize| {
            let mut name = self.real_target.file_name().unwrap_or_default().to_owned();
            name.push(format!("-{number}"));
            parent(&self.real_target).join(name)
        };
        let kept = (2..MOST_BESIDE)
            .map(beside)
            .find(|path| fs::symlink_metadata(path).is_err());
        let kept = kept.unwrap_or_default();
        let _uninterrupted = unfinished();
        match sync_all(&self.new).and_then(|()| fs::rename(&self.new, &kept)) {
            Ok(()) => DestinationError::kept_beside(&self.target, others, kept),
            Err(source) => cannot_write(&kept)(source),
        }
    }

    /// Becomes the target, where nothing is.
    fn appear(&self) -> io::Result<()> {
        fs::rename(&self.new, &self.real_target)?;
        sync_names(parent(&self.real_target));
        Ok(())
    }
}

/// The folder that a path is in.
fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // Whoever ends the program finds the folder in the list or gone.
        let mut all = unfinished();
        self.folders.remove();
        all.retain(|folders| folders.path != self.folders.path);
    }
}
