//! The photographs of a solution that was opened without its capture: read anew, if they are those that it was estimated from.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::worker::message;
use rekindle_capture::Capture;
use rekindle_estimate::registration::corrected;
use rekindle_solution::Solution;

/// Where the photographs are and the capture with them, or what is wrong.
pub(super) type Read = Result<(PathBuf, Arc<Capture>), String>;

/// Reads the capture that a solution was estimated from, with its corrections.
pub(super) fn read(path: &Path, solution: &Solution) -> Result<Arc<Capture>, String> {
    let read = Capture::load_unplaced(path).map_err(|error| message(&error.into()));
    let (capture, _) = read?;
    if let Some(difference) = difference(&capture, solution) {
        let path = path.display();
        return Err(format!(
            "{path}: these are not the photographs of {}: {difference}; choose its capture's folder",
            solution.name
        ));
    }
    Ok(with_corrections(&Arc::new(capture), solution))
}

/// A capture with the corrections that a solution found.
pub(super) fn with_corrections(capture: &Arc<Capture>, solution: &Solution) -> Arc<Capture> {
    match corrected(capture, &solution.corrections) {
        Cow::Borrowed(_) => Arc::clone(capture),
        Cow::Owned(registered) => Arc::new(registered),
    }
}

/// In what a capture differs from the one of a solution, if it does.
fn difference(capture: &Capture, solution: &Solution) -> Option<String> {
    let (here, there) = (capture.views.len(), solution.cameras.len());
    if here != there {
        return Some(format!("there are {here} views in place of {there}"));
    }
    let mut views = capture.views.iter().zip(&solution.cameras);
    views.find_map(|(view, (name, camera))| {
        let size = |c: &rekindle_capture::Camera| (c.width, c.height);
        let same = view.name == *name && size(&view.camera) == size(camera);
        (!same).then(|| format!("{} is not {name}", view.name))
    })
}
