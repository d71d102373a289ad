//! What runs that were killed left at a destination: found by the next run, finished, put back or removed.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::fault;

/// File that a run holds locked as long as it lives.
pub(super) const LOCK: &str = "lock";
/// Folder that is written into, and where the old one is after an exchange in one step.
pub(super) const NEW: &str = "new";
/// Where the old folder is during an exchange in two steps.
pub(super) const OLD: &str = "old";
/// File that says that everything in [`NEW`] is whole and is being moved into the destination.
pub(super) const MOVING: &str = "moving";
/// What ends the name of an old folder that earlier versions kept during their exchange.
const EARLIER_OLD: &str = "-old";

/// How the names of working folders inside a destination begin.
pub(super) fn prefix_within() -> OsString {
    ".unfinished-".into()
}

/// How the names of working folders beside a destination begin.
pub(super) fn prefix_beside(name: &OsStr) -> OsString {
    let mut prefix = OsString::from(".");
    prefix.push(name);
    prefix.push(".unfinished-");
    prefix
}

/// Finishes, puts back or removes what dead runs left at a destination. Returns what was done, in whole sentences.
pub(super) fn settle(target: &Path) -> io::Result<Vec<String>> {
    let mut places = Vec::new();
    if let (Some(parent), Some(name)) = (target.parent(), target.file_name()) {
        places.extend(working_folders(parent, &prefix_beside(name)));
    }
    places.extend(working_folders(target, &prefix_within()));
    let mut said = Vec::new();
    for place in places {
        if let Some(done) = settle_one(&place, target)? {
            said.push(format!("{}: {done}", target.display()));
        }
    }
    Ok(said)
}

/// The working folders in a folder, by name.
fn working_folders(folder: &Path, prefix: &OsStr) -> Vec<PathBuf> {
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> = entries
        .filter(|entry| is_working_name(&entry.file_name(), prefix))
        .map(|entry| entry.path())
        .filter(|path| fs::symlink_metadata(path).is_ok_and(|m| m.is_dir()))
        .collect();
    found.sort();
    found
}

/// Whether a name is the prefix and the number of a process, with another number or "-old" after it.
fn is_working_name(name: &OsStr, prefix: &OsStr) -> bool {
    let rest = name
        .as_encoded_bytes()
        .strip_prefix(prefix.as_encoded_bytes())
        .unwrap_or_default();
    let rest = rest.strip_suffix(EARLIER_OLD.as_bytes()).unwrap_or(rest);
    let mut numbers = rest.split(|&b| b == b'-');
    numbers.all(|n| !n.is_empty() && n.iter().all(u8::is_ascii_digit))
}

/// Settles one working folder, unless its run is alive.
fn settle_one(place: &Path, target: &Path) -> io::Result<Option<&'static str>> {
    let lock = match File::open(place.join(LOCK)) {
        Ok(lock) => lock,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return settle_unlocked(place, target);
        }
        // Another user's.
        Err(_) => return Ok(None),
    };
    if lock.try_lock().is_err() {
        return Ok(None);
    }
    let done = if place.join(MOVING).exists() {
        move_all(&place.join(NEW), target)?;
        "an interrupted run had added only some of its files; the others are added now"
    } else if !target.exists() && place.join(OLD).exists() {
        fs::rename(place.join(OLD), target)?;
        "an interrupted run had moved it away; it is put back"
    } else {
        "what an interrupted run had left unfinished is removed"
    };
    // What can't be removed is found again by the next run.
    Ok(fs::remove_dir_all(place).is_ok().then_some(done))
}

/// Settles what has no lock: just being made by a live run, or left by an earlier version of the program.
fn settle_unlocked(place: &Path, target: &Path) -> io::Result<Option<&'static str>> {
    if fs::remove_dir(place).is_ok() {
        return Ok(None);
    }
    let name = place.as_os_str().as_encoded_bytes();
    if !name.ends_with(EARLIER_OLD.as_bytes()) {
        let removed = fs::remove_dir_all(place).is_ok();
        return Ok(removed.then_some("what an interrupted run had left unfinished is removed"));
    }
    if target.exists() {
        return Ok(Some(
            "an interrupted run left what was there before in a hidden folder beside it whose name ends in -old; remove \
             that if you don't need it",
        ));
    }
    fs::rename(place, target)?;
    Ok(Some("an interrupted run had moved it away; it is put back"))
}

/// Moves all that is in a folder into another, where files of the same names are replaced.
pub(super) fn move_all(from: &Path, target: &Path) -> io::Result<()> {
    for name in names(from)? {
        fs::rename(from.join(&name), target.join(&name))?;
        fault::point("adding");
    }
    Ok(())
}

/// The names in a folder, sorted.
pub(super) fn names(folder: &Path) -> io::Result<Vec<OsString>> {
    let entries = fs::read_dir(folder)?;
    let mut names: Vec<OsString> = entries
        .map(|entry| entry.map(|e| e.file_name()))
        .collect::<io::Result<_>>()?;
    names.sort();
    Ok(names)
}
