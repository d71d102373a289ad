//! Project files: what an artist made of a solution, as one JSON file.
//!
//! `NAME.rekindle` names the folder of its solution by a path relative to itself, and by the absolute one in case the file was
//! moved alone. A solve that was not saved yet is written beside it as `NAME.solution`; the two move together. Light probes
//! are named in the same way. The file appears whole or not at all, after the solution that it names.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use super::document::{Document, State};
use super::lamp::Baseline;
use super::look::ProbeLight;
use rekindle_base::files;
use rekindle_base::staging::write_advice;
use rekindle_solution::{Solution, SolutionError};

/// Extension of project files, without the dot.
pub const EXTENSION: &str = "rekindle";
const FORMAT: &str = "rekindle-project";
/// Newest version that is read: it knows groups, and a solo of several lamps.
const VERSION: u32 = 2;
/// What is written where nothing needs a newer one, so that older programs read it.
const OLDEST: u32 = 1;

/// Why a project can't be read or written.
#[derive(Debug, Error)]
pub enum ProjectError {
    /// A file can't be read.
    #[error("{path}: can't be read: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not JSON, or a field is missing or of the wrong type; the message has line and column.
    #[error("{path}: not a valid project: {source}; open its solution folder instead")]
    Json {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// Something else's JSON.
    #[error("{path}: not a rekindle project (its format is \"{found}\"); choose a .rekindle file")]
    Format {
        /// The file.
        path: PathBuf,
        /// What it says.
        found: String,
    },
    /// Written by a newer program.
    #[error(
        "{path}: written by a newer rekindle (version {found}, this one reads up to {VERSION}); update rekindle"
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// Contents that make no sense.
    #[error("{path}: {what}; open its solution folder instead")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// The solution that the project names is not there.
    #[error(
        "{path}: its solution is missing, neither {beside} nor {absolute} is there; put the solution folder back beside the project"
    )]
    SolutionMissing {
        /// The project file.
        path: PathBuf,
        /// Where it was looked for, relative to the project.
        beside: PathBuf,
        /// Where it was when the project was saved.
        absolute: PathBuf,
    },
    /// The solution can't be read or written.
    #[error(transparent)]
    Solution(#[from] SolutionError),
    /// Writing failed.
    #[error("{path}: can't be written: {source}; {}", write_advice(.source))]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// The fields by which a file of any version is known.
#[derive(Deserialize)]
struct Head {
    #[serde(default)]
    format: String,
    #[serde(default)]
    version: u32,
}

/// A place outside the project file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Reference {
    /// From the project file's folder, with `/` between the parts; absent where there is no such way.
    relative: Option<String>,
    absolute: PathBuf,
}

#[derive(Serialize, Deserialize)]
struct File {
    format: String,
    version: u32,
    solution: Reference,
    /// The capture, for its photographs; nothing needs it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    capture: Option<Reference>,
    /// Light probes that looks name by their absolute paths.
    #[serde(default)]
    probes: Vec<Reference>,
    #[serde(flatten)]
    state: State,
    #[serde(default)]
    view: Value,
    /// In a recovery file, the project file that it would have been saved to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    recovers: Option<PathBuf>,
}

impl Reference {
    fn new(folder: &Path, target: &Path) -> Self {
        let absolute = absolute(target);
        Self {
            relative: relative(&self::absolute(folder), &absolute),
            absolute,
        }
    }

    /// Where the target is now, seen from the project's folder.
    fn find(&self, folder: &Path) -> Option<PathBuf> {
        let beside = self.relative.as_ref().map(|r| folder.join(r));
        let places = beside.into_iter().chain([self.absolute.clone()]);
        places.into_iter().find(|p| p.exists())
    }
}

fn absolute(path: &Path) -> PathBuf {
    // Symbolic links resolved where the path exists, so that relative ways lead there.
    fs::canonicalize(path)
        .or_else(|_| std::path::absolute(path))
        .unwrap_or_else(|_| path.to_owned())
}

/// The way from a folder to a place, both absolute; `None` where they share nothing but the root, as what is that far away
/// won't be moved along, or where it isn't Unicode.
fn relative(folder: &Path, target: &Path) -> Option<String> {
    let (from, to): (Vec<_>, Vec<_>) =
        (folder.components().collect(), target.components().collect());
    let shared = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let names = from[..shared]
        .iter()
        .filter(|c| matches!(c, Component::Normal(_)));
    if names.count() == 0 {
        return None;
    }
    let up = from[shared..].iter().map(|_| Some(".."));
    let down = to[shared..].iter().map(|c| c.as_os_str().to_str());
    let parts: Vec<&str> = up.chain(down).collect::<Option<_>>()?;
    Some(parts.join("/"))
}

/// A document at one moment, to be written by another thread.
#[derive(Clone)]
pub struct Snapshot {
    state: Arc<State>,
    solution: Arc<Solution>,
    source: Option<PathBuf>,
    project: Option<PathBuf>,
    capture: Option<PathBuf>,
    view: Value,
}

/// What was written, for [`Document::saved`].
#[derive(Clone, Debug)]
pub struct Saved {
    state: Arc<State>,
    project: PathBuf,
    source: PathBuf,
}

impl Snapshot {
    pub(super) fn solution(&self) -> &Arc<Solution> {
        &self.solution
    }

    /// Whether the solution has yet to be written, which takes a second or so.
    pub fn has_unsaved_solution(&self) -> bool {
        self.source.is_none()
    }

    /// Writes the project file and, where it has no place yet, its solution.
    pub fn save(&self, path: &Path) -> Result<Saved, ProjectError> {
        let path = with_extension(path);
        let source = self.save_solution(&path)?;
        self.write(&path, &source, None)?;
        Ok(Saved {
            state: Arc::clone(&self.state),
            project: path,
            source,
        })
    }

    /// Makes sure that the solution is in a folder. Returns the folder.
    fn save_solution(&self, path: &Path) -> Result<PathBuf, ProjectError> {
        let beside = path.with_extension("solution");
        // A solution that stands beside another project belongs to that; this one gets its own.
        let other = self.project.as_deref().filter(|p| *p != path);
        let belongs = other.map(|p| p.with_extension("solution"));
        let own = self
            .source
            .as_ref()
            .filter(|s| belongs.as_ref() != Some(*s));
        if let Some(source) = own.filter(|s| s.is_dir()) {
            return Ok(source.clone());
        }
        self.solution.save(&beside)?;
        Ok(beside)
    }

    /// Writes the project into a recovery file. The solution is written beside it unless it is in a folder already.
    pub(super) fn save_for_recovery(
        &self,
        path: &Path,
        solution_written: bool,
    ) -> Result<(), ProjectError> {
        let beside = path.with_extension("solution");
        if self.source.is_none() && !solution_written {
            self.solution.save(&beside)?;
        }
        let source = self.source.clone().unwrap_or(beside);
        self.write(path, &source, self.project.clone())
    }

    fn write(
        &self,
        path: &Path,
        source: &Path,
        recovers: Option<PathBuf>,
    ) -> Result<(), ProjectError> {
        let folder = parent(path);
        let mut state = State::clone(&self.state);
        let mut probes = Vec::new();
        for probe in state.looks.iter_mut().filter_map(|l| l.probe.as_mut()) {
            probe.file = absolute(&probe.file);
            let reference = Reference::new(folder, &probe.file);
            if !probes.contains(&reference) {
                probes.push(reference);
            }
        }
        let file = File {
            format: FORMAT.to_owned(),
            version: if needs_groups(&state) {
                VERSION
            } else {
                OLDEST
            },
            solution: Reference::new(folder, source),
            capture: (self.capture.as_deref()).map(|capture| Reference::new(folder, capture)),
            probes,
            state,
            view: self.view.clone(),
            recovers,
        };
        let failed = |source: io::Error| ProjectError::Write {
            path: path.to_owned(),
            source,
        };
        let text = serde_json::to_vec_pretty(&file).map_err(|e| failed(io::Error::other(e)))?;
        write_whole(path, &text).map_err(failed)
    }
}

/// Whether a program that knows no groups would show another light.
fn needs_groups(state: &State) -> bool {
    let mut looks = state.looks.iter();
    looks.any(|look| !look.groups.is_empty() || look.solo.len() > 1)
}

/// Writes a single file that its user chose whole: aside, then renamed over what was there. A link is followed, folders that lack
/// are made.
pub fn write_whole(path: &Path, contents: &[u8]) -> io::Result<()> {
    let real = path.canonicalize();
    let path = real.as_deref().unwrap_or(path);
    let folder = parent(path);
    fs::create_dir_all(folder)?;
    let mut aside = tempfile::Builder::new()
        .prefix(".unfinished-")
        .tempfile_in(folder)?;
    aside.write_all(contents)?;
    aside.as_file().sync_all()?;
    aside.persist(path)?;
    Ok(())
}

fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// The path of a project file: a name without the extension gets it.
fn with_extension(path: &Path) -> PathBuf {
    if path.extension().is_some_and(|e| e == EXTENSION) {
        return path.to_owned();
    }
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(EXTENSION);
    PathBuf::from(name)
}

impl Document {
    /// The document as it is now, cheap to take.
    pub fn snapshot(&self) -> Snapshot {
        Snapshot {
            state: Arc::clone(self.state()),
            solution: Arc::clone(&self.solution),
            source: self.source.clone(),
            project: self.project.clone(),
            capture: self.capture.clone(),
            view: self.view.clone(),
        }
    }

    /// Notes that a snapshot was saved. What was edited since stays modified; the history stays.
    pub fn saved(&mut self, saved: Saved) {
        self.project = Some(saved.project);
        self.source = Some(saved.source);
        self.note_saved(saved.state);
    }

    /// Saves at once; for programs without another thread.
    pub fn save(&mut self, path: &Path) -> Result<(), ProjectError> {
        let saved = self.snapshot().save(path)?;
        self.saved(saved);
        Ok(())
    }

    /// Opens a project with its solution and light probes. The second value says in whole sentences what is missing but
    /// not needed: probes.
    pub fn open(path: &Path) -> Result<(Self, Vec<String>), ProjectError> {
        let (file, document, warnings) = read(path)?;
        let mut document = document.restored(file.state, true);
        document.project = Some(path.to_owned());
        document.view = file.view;
        Ok((document, warnings))
    }

    /// Opens what a crashed program left. It counts as modified, and what it left unsaved is to be saved anew.
    pub(super) fn recover(path: &Path) -> Result<(Self, Vec<String>), ProjectError> {
        let (file, document, warnings) = read(path)?;
        let mut document = document.restored(file.state, false);
        document.project = file.recovers;
        document.view = file.view;
        if document.source.as_deref() == Some(&absolute(&path.with_extension("solution"))) {
            document.source = None;
        }
        Ok((document, warnings))
    }
}

/// A project file with its solution and probes; the document's state is still the solution's.
fn read(path: &Path) -> Result<(File, Document, Vec<String>), ProjectError> {
    let mut file = parse(path)?;
    let folder = parent(path);
    let missing = || ProjectError::SolutionMissing {
        path: path.to_owned(),
        beside: folder.join(file.solution.relative.as_deref().unwrap_or_default()),
        absolute: file.solution.absolute.clone(),
    };
    let source = file.solution.find(folder).ok_or_else(missing)?;
    let solution = Arc::new(Solution::load(&source)?);
    let base = Baseline::new(&solution);
    file.state = file
        .state
        .checked(&base)
        .map_err(|what| ProjectError::Damaged {
            path: path.to_owned(),
            what,
        })?;
    let mut document = Document::new(solution, Some(absolute(&source)));
    document.capture = file.capture.as_ref().and_then(|c| c.find(folder));
    let mut warnings = Vec::new();
    for reference in &file.probes {
        let Some(found) = reference.find(folder) else {
            warnings.push(format!(
                "{}: the light probe is missing, setups that use it are darker; put it back or choose another",
                reference.absolute.display()
            ));
            continue;
        };
        let named = file.state.looks.iter_mut().filter_map(|l| l.probe.as_mut());
        for probe in named.filter(|p| p.file == reference.absolute) {
            probe.file.clone_from(&found);
        }
        match ProbeLight::load(&found) {
            Ok(light) => document.know_probe(light),
            Err(problem) => warnings.push(problem),
        }
    }
    Ok((file, document, warnings))
}

fn parse(path: &Path) -> Result<File, ProjectError> {
    let text = files::read(path).map_err(|source| ProjectError::Read {
        path: path.to_owned(),
        source,
    })?;
    let json = |source| ProjectError::Json {
        path: path.to_owned(),
        source,
    };
    let head: Head = serde_json::from_slice(&text).map_err(json)?;
    if head.format != FORMAT {
        return Err(ProjectError::Format {
            path: path.to_owned(),
            found: head.format,
        });
    }
    if head.version > VERSION {
        return Err(ProjectError::Newer {
            path: path.to_owned(),
            found: head.version,
        });
    }
    serde_json::from_slice(&text).map_err(json)
}
