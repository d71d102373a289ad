//! Results appear whole or not at all: files are written into a folder beside their destination, which is renamed into
//! place at the end and removed if anything goes wrong before.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

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

/// A folder being written and those above it that were made for it, the innermost first.
#[derive(Clone, Debug)]
struct Folders {
    path: PathBuf,
    parents: Vec<PathBuf>,
}

impl Folders {
    fn make(path: PathBuf, parent: &Path) -> io::Result<Self> {
        if let Some(there) = parent.ancestors().find(|p| p.exists())
            && !there.is_dir()
        {
            let problem = format!("{} is not a folder", there.display());
            return Err(io::Error::new(io::ErrorKind::NotADirectory, problem));
        }
        let missing = parent.ancestors().take_while(|p| !p.exists());
        let folders = Self {
            path,
            parents: missing.map(Path::to_owned).collect(),
        };
        let made = fs::create_dir_all(parent).and_then(|()| {
            if folders.path.exists() {
                // Left behind by a killed process that had the same id.
                fs::remove_dir_all(&folders.path)?;
            }
            fs::create_dir(&folders.path)
        });
        made.inspect_err(|_| folders.remove())?;
        Ok(folders)
    }

    /// Removes what is there: the folder, unless it was renamed into place, and the parents that are empty.
    fn remove(&self) {
        let _ = fs::remove_dir_all(&self.path);
        for parent in &self.parents {
            let _ = fs::remove_dir(parent);
        }
    }
}

/// A folder that becomes the result, or vanishes.
#[derive(Debug)]
pub struct Staging {
    folders: Folders,
    target: PathBuf,
}

impl Staging {
    /// An empty folder beside `target`; missing parents are made.
    pub fn beside(target: &Path) -> io::Result<Self> {
        let name = target
            .file_name()
            .ok_or_else(|| io::Error::other("the path does not end in a folder's name"))?
            .to_string_lossy()
            .into_owned();
        let parent = match target.parent() {
            Some(p) if !p.as_os_str().is_empty() => p,
            _ => Path::new("."),
        };
        let path = parent.join(format!(".{name}.unfinished-{}", std::process::id()));
        let mut all = unfinished();
        let folders = Folders::make(path, parent)?;
        all.push(folders.clone());
        Ok(Self {
            folders,
            target: target.to_owned(),
        })
    }

    /// An empty folder inside `target`, for files that are to be added to it; `target` and its missing parents are made.
    pub fn within(target: &Path) -> io::Result<Self> {
        let path = target.join(format!(".unfinished-{}", std::process::id()));
        let mut all = unfinished();
        let folders = Folders::make(path, target)?;
        all.push(folders.clone());
        Ok(Self {
            folders,
            target: target.to_owned(),
        })
    }

    /// The folder to write into.
    pub fn path(&self) -> &Path {
        &self.folders.path
    }

    /// The folder that it becomes.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Puts the folder in the place of the target, which is removed if it exists.
    pub fn replace(self) -> io::Result<()> {
        let _uninterrupted = unfinished();
        if !self.target.exists() {
            return fs::rename(self.path(), &self.target);
        }
        let mut old = self.path().to_owned().into_os_string();
        old.push("-old");
        let old = PathBuf::from(old);
        if old.exists() {
            fs::remove_dir_all(&old)?;
        }
        fs::rename(&self.target, &old)?;
        if let Err(error) = fs::rename(self.path(), &self.target) {
            fs::rename(&old, &self.target)?;
            return Err(error);
        }
        fs::remove_dir_all(&old)
    }

    /// Moves the folder's files into the target, which may hold others.
    pub fn add(self) -> io::Result<()> {
        let _uninterrupted = unfinished();
        if !self.target.exists() {
            return fs::rename(self.path(), &self.target);
        }
        let mut names: Vec<PathBuf> = fs::read_dir(self.path())?
            .map(|entry| entry.map(|e| PathBuf::from(e.file_name())))
            .collect::<io::Result<_>>()?;
        names.sort();
        for name in names {
            fs::rename(self.path().join(&name), self.target.join(&name))?;
        }
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        unfinished().retain(|folders| folders.path != self.folders.path);
        self.folders.remove();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_abandoned_folder_leaves_nothing() {
        let parent = tempfile::tempdir().unwrap();
        let staging = Staging::beside(&parent.path().join("result")).unwrap();
        fs::write(staging.path().join("half"), "x").unwrap();
        drop(staging);
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
    }

    #[test]
    fn folders_made_for_an_abandoned_one_vanish_too() {
        let parent = tempfile::tempdir().unwrap();
        let target = parent.path().join("one/two/result");
        drop(Staging::beside(&target).unwrap());
        assert!(!parent.path().join("one").exists());
        let staging = Staging::beside(&target).unwrap();
        staging.replace().unwrap();
        assert!(target.exists());
    }

    #[test]
    fn a_result_replaces_the_old_one_whole() {
        let parent = tempfile::tempdir().unwrap();
        let target = parent.path().join("deep/result");
        for content in ["old", "new"] {
            let staging = Staging::beside(&target).unwrap();
            fs::write(staging.path().join(content), content).unwrap();
            staging.replace().unwrap();
        }
        let names: Vec<_> = fs::read_dir(&target)
            .unwrap()
            .map(|e| e.unwrap().file_name())
            .collect();
        assert_eq!(names, ["new"]);
        assert_eq!(fs::read_dir(target.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn pictures_join_what_is_there() {
        let parent = tempfile::tempdir().unwrap();
        let target = parent.path().join("pictures");
        fs::create_dir(&target).unwrap();
        fs::write(target.join("other"), "x").unwrap();
        let staging = Staging::beside(&target).unwrap();
        fs::write(staging.path().join("one"), "1").unwrap();
        staging.add().unwrap();
        assert!(target.join("other").exists() && target.join("one").exists());
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1);
        let staging = Staging::within(&target).unwrap();
        fs::write(staging.path().join("two"), "2").unwrap();
        staging.add().unwrap();
        assert_eq!(fs::read_dir(&target).unwrap().count(), 3);
        drop(Staging::within(&parent.path().join("new/pictures")).unwrap());
        assert!(!parent.path().join("new").exists());
    }
}
