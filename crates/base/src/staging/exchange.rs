//! Puts one folder in the place of another: in one step where the system can, so that a kill finds one of them there.

use std::fs::{self, File};
use std::io;
use std::path::Path;

use super::fault;

/// How two folders change places: the new one, the one that is to be replaced, and where that may be kept meanwhile.
pub(super) type Exchange = fn(&Path, &Path, &Path) -> io::Result<()>;

/// Puts `new` in the place of `target`. What was there is then at `new` or at `old`.
pub(super) fn exchange(new: &Path, target: &Path, old: &Path) -> io::Result<()> {
    match in_one_step(new, target) {
        Err(error)
            if matches!(
                error.kind(),
                io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported
            ) =>
        {
            in_two_steps(new, target, old)
        }
        done => done,
    }
}

#[cfg(any(target_os = "linux", target_os = "macos"))]
fn in_one_step(new: &Path, target: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    renameat_with(CWD, new, CWD, target, RenameFlags::EXCHANGE)?;
    fault::point("exchanged");
    Ok(())
}

#[cfg(not(any(target_os = "linux", target_os = "macos")))]
fn in_one_step(_: &Path, _: &Path) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

/// As [`exchange`]; between the steps nothing is at `target`, and whoever comes next after a kill puts `old` back.
pub(super) fn in_two_steps(new: &Path, target: &Path, old: &Path) -> io::Result<()> {
    fs::rename(target, old)?;
    fault::point("between the steps");
    fs::rename(new, target).inspect_err(|_| {
        // Where even this fails, the old one stays aside, to be put back by whoever comes next.
        let _ = fs::rename(old, target);
    })
}

/// Waits until a folder and everything in it is on the disk.
pub(super) fn sync_all(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_all(&entry.path())?;
        } else {
            // Systems differ in whether a file must be open for writing to be synced.
            fs::OpenOptions::new()
                .read(true)
                .append(true)
                .open(entry.path())?
                .sync_all()?;
        }
    }
    sync_names(folder);
    Ok(())
}

/// Waits until the names in a folder are on the disk. Not every system can, and then nothing is lost that is there.
pub(super) fn sync_names(folder: &Path) {
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
}
