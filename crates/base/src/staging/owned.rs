//! Which files of a folder this program wrote: those it may replace.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Files that this program wrote, by their paths in a folder.
#[derive(Clone, Debug, Default)]
pub struct Owned(BTreeSet<PathBuf>);

impl<P: Into<PathBuf>> FromIterator<P> for Owned {
    fn from_iter<I: IntoIterator<Item = P>>(paths: I) -> Self {
        Self(paths.into_iter().map(Into::into).collect())
    }
}

impl Owned {
    /// All files in a folder that was just written.
    pub fn all_in(folder: &Path) -> io::Result<Self> {
        let mut files = Self::default();
        files.collect(folder, Path::new(""))?;
        Ok(files)
    }

    fn collect(&mut self, folder: &Path, below: &Path) -> io::Result<()> {
        for entry in fs::read_dir(folder.join(below))? {
            let entry = entry?;
            let path = below.join(entry.file_name());
            if entry.file_type()?.is_dir() {
                self.collect(folder, &path)?;
            } else {
                self.0.insert(path);
            }
        }
        Ok(())
    }

    /// The paths as a file lists them, with slashes.
    pub fn listed(&self) -> Vec<String> {
        let listed = |path: &PathBuf| {
            let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
            parts.join("/")
        };
        self.0.iter().map(listed).collect()
    }

    /// What else there is in a folder, sorted: files, and folders that hold none of these files.
    pub fn others_in(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        let mut others = Vec::new();
        self.collect_others(folder, Path::new(""), &mut others)?;
        others.sort();
        Ok(others)
    }

    fn collect_others(
        &self,
        folder: &Path,
        below: &Path,
        others: &mut Vec<PathBuf>,
    ) -> io::Result<()> {
        for entry in fs::read_dir(folder.join(below))? {
            let entry = entry?;
            let (path, kind) = (below.join(entry.file_name()), entry.file_type()?);
            if kind.is_dir() && self.0.iter().any(|own| own.starts_with(&path)) {
                self.collect_others(folder, &path, others)?;
            } else if !(kind.is_file() && self.0.contains(&path)) {
                others.push(path);
            }
        }
        Ok(())
    }
}
