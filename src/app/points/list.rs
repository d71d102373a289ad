//! Points and marks while they are set: which is selected, what fits, what can be undone.

use std::sync::Arc;

use glam::{DVec2, DVec3};

use super::super::history::History;
use rekindle_capture::Capture;
use rekindle_estimate::align::{Mark, MarkedPoint, MarksError, Placement};

/// Points with the one that is selected.
#[derive(Clone, Debug, Default, PartialEq)]
struct State {
    points: Vec<MarkedPoint>,
    selected: Option<usize>,
}

/// Points of a capture's mesh and where its photographs show them.
pub(super) struct Points {
    capture: Arc<Capture>,
    now: State,
    history: History<State>,
    /// Where they place the mesh.
    placement: Result<Placement, MarksError>,
    /// Changes with the placement.
    version: u64,
}

impl Points {
    pub(super) fn new(capture: Arc<Capture>, points: Vec<MarkedPoint>) -> Self {
        let placement = Placement::new(&capture.views, &points);
        Self {
            capture,
            now: State {
                points,
                selected: None,
            },
            history: History::new(),
            placement,
            version: 0,
        }
    }

    pub(super) fn all(&self) -> &[MarkedPoint] {
        &self.now.points
    }

    pub(super) fn selected(&self) -> Option<usize> {
        self.now.selected
    }

    pub(super) fn placement(&self) -> &Result<Placement, MarksError> {
        &self.placement
    }

    pub(super) fn version(&self) -> u64 {
        self.version
    }

    /// Where a point is marked in a view.
    pub(super) fn mark(&self, point: usize, view: usize) -> Option<DVec2> {
        let marks = &self.now.points.get(point)?.marks;
        let mark = marks.iter().find(|mark| mark.view == view)?;
        Some(mark.pixel)
    }

    /// How far the placement is from a mark, pixels.
    pub(super) fn miss(&self, point: usize, view: usize) -> Option<f64> {
        let marks = &self.now.points.get(point)?.marks;
        let k = marks.iter().position(|mark| mark.view == view)?;
        let placement = self.placement.as_ref().ok()?;
        placement.misses.get(point)?.get(k).copied()
    }

    pub(super) fn select(&mut self, point: usize) {
        self.now.selected = Some(point);
    }

    /// What follows can be undone in one step.
    pub(super) fn begin(&mut self) {
        self.history.keep(self.now.clone());
    }

    /// Adds a point of the mesh and selects it.
    pub(super) fn add(&mut self, place: DVec3) {
        self.begin();
        self.now.points.push(MarkedPoint {
            place,
            marks: Vec::new(),
        });
        self.now.selected = Some(self.now.points.len() - 1);
        self.changed();
    }

    /// Moves a point on the mesh, as a part of what was begun.
    pub(super) fn move_point(&mut self, point: usize, place: DVec3) {
        if let Some(point) = self.now.points.get_mut(point) {
            point.place = place;
            self.changed();
        }
    }

    /// Marks a point in a view, or moves its mark, as a part of what was begun.
    pub(super) fn set_mark(&mut self, point: usize, view: usize, pixel: DVec2) {
        if let Some(point) = self.now.points.get_mut(point) {
            point.marks.retain(|mark| mark.view != view);
            point.marks.push(Mark { view, pixel });
            point.marks.sort_by_key(|mark| mark.view);
            self.changed();
        }
    }

    pub(super) fn remove_mark(&mut self, point: usize, view: usize) {
        if self.mark(point, view).is_some() {
            self.begin();
            let marks = &mut self.now.points[point].marks;
            marks.retain(|mark| mark.view != view);
            self.changed();
        }
    }

    pub(super) fn remove(&mut self, point: usize) {
        if point < self.now.points.len() {
            self.begin();
            self.now.points.remove(point);
            self.now.selected = match self.now.selected {
                Some(selected) if selected == point => None,
                Some(selected) if selected > point => Some(selected - 1),
                other => other,
            };
            self.changed();
        }
    }

    pub(super) fn can_undo(&self) -> bool {
        self.history.can_undo()
    }

    pub(super) fn can_redo(&self) -> bool {
        self.history.can_redo()
    }

    pub(super) fn undo(&mut self) {
        if self.history.undo(&mut self.now) {
            self.changed();
        }
    }

    pub(super) fn redo(&mut self) {
        if self.history.redo(&mut self.now) {
            self.changed();
        }
    }

    fn changed(&mut self) {
        self.placement = Placement::new(&self.capture.views, &self.now.points);
        self.version += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn points() -> Points {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures/spot_paper");
        let capture = Capture::load(&folder).expect("test capture");
        Points::new(Arc::new(capture), Vec::new())
    }

    #[test]
    fn every_change_is_undone_and_done_again() {
        let mut points = points();
        points.add(DVec3::X);
        points.begin();
        points.set_mark(0, 1, DVec2::new(10.0, 20.0));
        points.set_mark(0, 1, DVec2::new(11.0, 21.0));
        points.add(DVec3::Y);
        points.remove(0);
        assert_eq!(points.all().len(), 1);
        assert_eq!(points.selected(), Some(0), "the second is the first now");
        points.undo();
        assert_eq!(points.mark(0, 1), Some(DVec2::new(11.0, 21.0)));
        points.undo();
        points.undo();
        assert_eq!(points.mark(0, 1), None, "a drag is one step");
        points.undo();
        assert!(points.all().is_empty() && !points.can_undo());
        while points.can_redo() {
            points.redo();
        }
        assert_eq!(points.all()[0].place, DVec3::Y);
        points.remove_mark(0, 3);
        assert!(!points.can_redo() && points.all().len() == 1);
    }
}
