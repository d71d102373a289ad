//! Light that is sought near some directions only.

use std::collections::BTreeSet;
use std::sync::OnceLock;

use glam::Vec3;

use super::cells::Cell;
use super::fast::Solver;
use super::observations::{Observations, Row, Sampling, Seen};
use rekindle_scene::hemisphere::HemisphereGrid;

/// Distance from directions that light is sought near, in spacings of the coarsest cells: with one, gloss on few parts of a path-traced
/// elephant was missed.
const DISTANCE: f32 = 2.0;
/// Distance from there at which rows still show such light, as a part of it: a lobe is as wide.
const REACH: f32 = 2.0;
/// Pixels looked at for points that could show it.
const CANDIDATES: usize = 48_000;

/// Where light is sought, if not everywhere.
#[derive(Clone, Copy)]
pub struct Near<'a> {
    /// Unit directions that it is near.
    pub directions: &'a [Vec3],
    /// Within this angle, radians.
    pub distance: f32,
    /// The nodes that it is sought on.
    pub grid: &'a HemisphereGrid,
    /// Whether it is sought on cells that are a level finer than the coarsest, and only at points that could show it.
    pub is_focused: bool,
}

impl Near<'_> {
    /// Whether a row of a point with a position and a normal mirrors what is so many times the distance from one of the directions.
    pub fn is_mirrored(&self, at: (Vec3, Vec3), row: &Row, times: f32) -> bool {
        let least = (times * self.distance).cos();
        let mirrored = mirrored(self.grid, at, row.to_camera);
        mirrored.is_some_and(|mirrored| self.directions.iter().any(|d| d.dot(mirrored) > least))
    }

    /// About `count` points that it is looked for at; `sampling` says what else is asked of them.
    pub fn points(&self, seen: &Seen<'_>, sampling: &Sampling<'_>) -> Observations {
        if !self.is_focused {
            return Observations::gather(seen, sampling);
        }
        let keep = |position: Vec3, normal: Vec3, rows: &[Row]| {
            let mut rows = rows.iter();
            rows.any(|row| self.is_mirrored((position, normal), row, REACH))
        };
        let focused = Sampling {
            candidates: CANDIDATES,
            keep: &keep,
            ..*sampling
        };
        Observations::gather(seen, &focused)
    }
}

/// The direction from the centre of a grid of what a surface with a normal at a place mirrors to a camera.
pub fn mirrored(
    grid: &HemisphereGrid,
    (position, normal): (Vec3, Vec3),
    to_camera: Vec3,
) -> Option<Vec3> {
    let along = 2.0 * normal.dot(to_camera) * normal - to_camera;
    grid.from_centre(position, along)
}

impl Solver<'_> {
    /// The same solver with light sought near some directions only.
    pub fn near_to<'b>(&'b self, directions: &'b [Vec3]) -> Solver<'b> {
        Solver {
            near_to: Some(self.about(directions, false)),
            coarse: self.coarse.clone(),
            coarse_sees: OnceLock::new(),
            ..*self
        }
    }

    /// The same on finer cells, and on points that could show light there: where few do, they are not outnumbered.
    pub fn focused_on<'b>(&'b self, directions: &'b [Vec3]) -> Solver<'b> {
        let near_to = Some(self.about(directions, true));
        let scale = Some(self.coarse.scale);
        Solver {
            near_to,
            coarse: Self::coarse_observations(&self.seen, near_to, scale, self.stop),
            coarse_sees: OnceLock::new(),
            ..*self
        }
    }

    fn about<'b>(&'b self, directions: &'b [Vec3], is_focused: bool) -> Near<'b> {
        Near {
            directions,
            grid: self.grid,
            distance: DISTANCE * self.pyramid.spacing(0),
            is_focused,
        }
    }

    /// The coarsest cells in which light is sought.
    pub fn roots(&self) -> Vec<Cell> {
        let Some(near) = self.near_to else {
            return self.pyramid.roots();
        };
        let level = u8::from(near.is_focused).min(self.pyramid.finest());
        let about = |&direction| self.pyramid.within(level, direction, near.distance);
        let cells: BTreeSet<Cell> = near.directions.iter().flat_map(about).collect();
        cells.into_iter().collect()
    }

    /// Whether a unit direction is so near one of others that light which is sought near these is sought there.
    pub fn is_near(&self, direction: Vec3, others: &[Vec3]) -> bool {
        let least = (DISTANCE * self.pyramid.spacing(0)).cos();
        others.iter().any(|other| other.dot(direction) >= least)
    }
}
