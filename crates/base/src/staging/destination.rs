//! Whether a result may be put where it is wanted: nothing is lost by it, neither other people's files nor what is read.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::Owned;
use super::provenance::foreign;

/// Names of files in the way that a message tells, at most.
const TOLD: usize = 3;

/// Why a result can't be put where it is wanted.
#[derive(Debug, Error)]
pub enum DestinationError {
    /// The folder is something else's.
    #[error("{path}: exists and is not {expected}; choose another output folder or remove it")]
    Occupied {
        /// The folder.
        path: PathBuf,
        /// What would be replaced.
        expected: &'static str,
    },
    /// The folder holds files of others.
    #[error(
        "{path}: holds {found}, which this program did not write there and which would be lost; move that elsewhere or \
         choose another output folder"
    )]
    Others {
        /// The folder.
        path: PathBuf,
        /// What is in the way.
        found: String,
    },
    /// The same, known only when the work was done.
    #[error(
        "{path}: holds {found}, which this program did not write there and which would be lost; what was made is in {kept}"
    )]
    KeptBeside {
        /// The folder.
        path: PathBuf,
        /// What is in the way.
        found: String,
        /// Where the files are.
        kept: PathBuf,
    },
    /// A file that is read would be replaced.
    #[error(
        "{path}: {input} is read and would be lost by writing there; choose another output folder"
    )]
    Input {
        /// The destination.
        path: PathBuf,
        /// The file.
        input: PathBuf,
    },
    /// Writing failed.
    #[error("{path}: can't be written: {source}; {}", write_advice(.source))]
    Write {
        /// The folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl DestinationError {
    /// What was made is in `kept`, as files of others are in its way.
    pub(super) fn kept_beside(path: &Path, others: &[PathBuf], kept: PathBuf) -> Self {
        Self::KeptBeside {
            path: path.to_owned(),
            found: told(others),
            kept,
        }
    }
}

/// What becomes of a failure to write to a place.
pub fn cannot_write(path: &Path) -> impl Fn(io::Error) -> DestinationError {
    |source| DestinationError::Write {
        path: path.to_owned(),
        source,
    }
}

/// What to do where something can't be written.
pub fn write_advice(error: &io::Error) -> &'static str {
    use io::ErrorKind as Kind;
    match error.kind() {
        Kind::StorageFull | Kind::QuotaExceeded => {
            "free some space or choose an output folder on another disk"
        }
        Kind::FileTooLarge => {
            "choose an output folder on a disk with space for larger files, or raise the limit (ulimit -f)"
        }
        Kind::PermissionDenied => "choose an output folder you may write to",
        Kind::ReadOnlyFilesystem => "choose an output folder on a disk that is not read-only",
        Kind::NotADirectory | Kind::IsADirectory | Kind::AlreadyExists => {
            "choose another output folder"
        }
        Kind::NotFound => "check that the folder it is to be in is still there",
        Kind::InvalidFilename => "choose a shorter name",
        Kind::InvalidInput => "name the folder itself",
        Kind::CrossesDevices | Kind::ResourceBusy => "choose a folder inside it",
        _ => "choose an output folder you may write to, on a disk with space left",
    }
}

/// Fails if a folder that is to be replaced holds more than `owned`, the files that this program wrote there. `None` says
/// that it is not what is `expected`; then it must be empty.
pub fn check_owned(
    folder: &Path,
    owned: Option<Owned>,
    expected: &'static str,
) -> Result<(), DestinationError> {
    if !folder.exists() {
        return Ok(());
    }
    let known = owned.is_some();
    let others = owned
        .unwrap_or_default()
        .others_in(folder)
        .map_err(cannot_write(folder))?;
    if !known && !others.is_empty() {
        let path = folder.to_owned();
        return Err(DestinationError::Occupied { path, expected });
    }
    refuse_others(folder, &others)
}

/// Fails if there are files of others in a folder.
fn refuse_others(folder: &Path, others: &[PathBuf]) -> Result<(), DestinationError> {
    if others.is_empty() {
        return Ok(());
    }
    Err(DestinationError::Others {
        path: folder.to_owned(),
        found: told(others),
    })
}

/// The first of some names.
fn told(names: &[PathBuf]) -> String {
    let shown: Vec<String> = names
        .iter()
        .take(TOLD)
        .map(|name| name.display().to_string())
        .collect();
    match names.len().saturating_sub(TOLD) {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// Fails if one of the files that are read lies in a folder that is to be replaced, whatever the paths look like.
pub fn check_holds_no_input(folder: &Path, inputs: &[PathBuf]) -> Result<(), DestinationError> {
    let Ok(real) = folder.canonicalize() else {
        return Ok(());
    };
    refuse_input(folder, inputs, |input| input.starts_with(&real))
}

/// Fails if what is to be written into a folder by these names would replace one of the files that are read, or what others
/// wrote, as far as that can be said before it is made.
pub fn check_added<'a>(
    folder: &Path,
    names: impl IntoIterator<Item = &'a str> + Clone,
    inputs: &[PathBuf],
) -> Result<(), DestinationError> {
    refuse_inputs_named(folder, names.clone(), inputs)?;
    let others = foreign(folder, names).map_err(cannot_write(folder))?;
    refuse_others(folder, &others)
}

/// Fails if one of the files that are read is among those that are to be written into a folder by these names.
fn refuse_inputs_named<'a>(
    folder: &Path,
    names: impl IntoIterator<Item = &'a str>,
    inputs: &[PathBuf],
) -> Result<(), DestinationError> {
    let there: Vec<PathBuf> = names
        .into_iter()
        .filter_map(|name| folder.join(name).canonicalize().ok())
        .collect();
    refuse_input(folder, inputs, |input| there.iter().any(|p| p == input))
}

fn refuse_input(
    folder: &Path,
    inputs: &[PathBuf],
    is_hit: impl Fn(&Path) -> bool,
) -> Result<(), DestinationError> {
    let hit = |input: &&PathBuf| input.canonicalize().is_ok_and(|real| is_hit(&real));
    match inputs.iter().find(hit) {
        Some(input) => Err(DestinationError::Input {
            path: folder.to_owned(),
            input: input.clone(),
        }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn advice_fits_the_cause() {
        use io::ErrorKind as Kind;
        let said = |kind: Kind| cannot_write(Path::new("out"))(kind.into()).to_string();
        for kind in [
            Kind::PermissionDenied,
            Kind::ReadOnlyFilesystem,
            Kind::NotADirectory,
            Kind::InvalidInput,
            Kind::NotFound,
        ] {
            assert!(!said(kind).contains("space"), "{}", said(kind));
        }
        for kind in [Kind::StorageFull, Kind::FileTooLarge] {
            assert!(said(kind).contains("space"), "{}", said(kind));
        }
        assert!(said(Kind::InvalidInput).ends_with("name the folder itself"));
    }

    #[test]
    fn what_is_read_is_known_by_any_path() {
        let folder = tempfile::tempdir().unwrap();
        let pictures = folder.path().join("pictures");
        fs::create_dir(&pictures).unwrap();
        let table = pictures.join("weights.csv");
        fs::write(&table, "x").unwrap();
        let inputs = [folder.path().join("pictures/../pictures/weights.csv")];
        let written = |name: &'static str| check_added(&pictures, [name], &inputs);
        assert!(written("weights.csv").is_err());
        assert!(written("frames.json").is_ok());
        for (replaced, allowed) in [("pictures", false), (".", false), ("elsewhere", true)] {
            let held = check_holds_no_input(&folder.path().join(replaced), &inputs);
            assert_eq!(held.is_ok(), allowed, "{replaced}");
        }
    }

    #[test]
    fn long_lists_of_what_is_in_the_way_are_cut() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a", "b", "c", "d", "e", "own"] {
            fs::write(folder.path().join(name), "x").unwrap();
        }
        let owned = Some(["own", "gone"].into_iter().collect());
        let error = check_owned(folder.path(), owned, "a solution").unwrap_err();
        assert!(
            error
                .to_string()
                .contains("holds a, b, c and 2 more, which"),
            "{error}"
        );
    }
}
