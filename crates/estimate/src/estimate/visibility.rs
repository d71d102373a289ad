//! Which cells a surface point sees past the rest of the object.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use glam::Vec3;
use rayon::prelude::*;

use super::cells::{Cell, Pyramid};
use super::design::Design;
use super::lobes::light_from;
use super::observations::{Placed, Point, Row};
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::shortcuts::Shortcut;
use rekindle_scene::surface::Occluder;

/// Part of a lobe's peak below which a light is not worth a shadow ray.
const NEGLIGIBLE: f32 = 3e-3;

/// Cells that are tested by one ray first.
struct Group {
    direction: Vec3,
    members: Vec<usize>,
    /// Groups whose centres are near this one's.
    around: Vec<usize>,
}

/// What share of each cell each point sees, or each row where the points are placed for every view.
#[derive(Clone, Debug, Default)]
pub struct SeenCells {
    /// The shares of all cells that there were, point by point; without any, everything is seen.
    shares: Arc<Vec<f32>>,
    /// How many cells there were.
    width: usize,
    /// Which of these the cells are.
    columns: Vec<u32>,
}

/// What a point sees of the cells.
#[derive(Clone, Copy, Debug)]
pub struct SeenFrom<'a> {
    shares: &'a [f32],
    columns: &'a [u32],
}

impl SeenCells {
    /// Shares of `width` cells, point by point.
    fn new(shares: Vec<f32>, width: usize) -> Self {
        Self {
            shares: Arc::new(shares),
            width,
            columns: (0..width as u32).collect(),
        }
    }

    /// What a point, or a row, sees; `None` where that is everything.
    pub(super) fn of(&self, point: usize) -> Option<SeenFrom<'_>> {
        let first = point * self.width;
        let shares = self.shares.get(first..first + self.width);
        let columns = &self.columns;
        shares
            .filter(|shares| !shares.is_empty())
            .map(|shares| SeenFrom { shares, columns })
    }

    /// The same of some of the points, or rows.
    pub(super) fn seen_from(&self, points: impl Iterator<Item = usize>) -> Self {
        let of = |point: usize| {
            self.shares
                .get(point * self.width..(point + 1) * self.width)
        };
        let shares: Vec<f32> = points.filter_map(of).flatten().copied().collect();
        Self {
            shares: Arc::new(shares),
            ..self.clone()
        }
    }

    /// The same of some of the cells.
    pub(super) fn restricted(&self, kept: &[usize]) -> Self {
        let columns = kept.iter().filter_map(|&cell| self.columns.get(cell));
        Self {
            shares: Arc::clone(&self.shares),
            width: self.width,
            columns: columns.copied().collect(),
        }
    }
}

impl<'a> SeenFrom<'a> {
    /// The share of each cell, in [0, 1].
    pub(super) fn shares(self) -> impl Iterator<Item = f32> + 'a {
        self.columns
            .iter()
            .map(move |&column| self.shares[column as usize])
    }
}

/// Share of each cell that each point of the design sees, 0 or 1; each row, where points are placed for every view.
///
/// Cells are tested in groups about as wide as a cell of the next coarser level: where a group and those around it
/// agree, its cells follow, and only at the edge of a shadow does each cell get its own ray. Where no row of a point
/// could show a group's highlight, no ray is sent and the group counts as seen.
pub fn cell_visibility(
    design: &Design<'_>,
    pyramid: &Pyramid,
    cells: &[Cell],
    brdf: &Brdf,
    occluder: &Occluder,
) -> SeenCells {
    let groups = group(pyramid, cells, &design.geometry.directions);
    let widest = design.observations.widest(brdf);
    let support = widest.half_angle_support(NEGLIGIBLE) + 0.5 * groups.reach;
    let n = cells.len();
    let lookouts = Lookout::all(design, occluder);
    let mut shares = vec![1.0_f32; lookouts.len() * n];
    shares
        .par_chunks_mut(n.max(1))
        .zip(&lookouts)
        .for_each(|(out, lookout)| {
            if design.stop.load(Ordering::Relaxed) {
                return;
            }
            let rays = if design.shortcuts.takes(Shortcut::ShadowRays) {
                lookout.look_by_groups(&groups, support, out)
            } else {
                lookout.look(0..n, out);
                n
            };
            let left_out = n.saturating_sub(rays);
            design.shortcuts.count(Shortcut::ShadowRays, n, left_out);
        });
    SeenCells::new(shares, n)
}

/// A surface point that looks for the cells.
struct Lookout<'a> {
    design: &'a Design<'a>,
    occluder: &'a Occluder,
    point: &'a Point,
    /// Its rows, or the one that it is placed for.
    rows: &'a [Row],
    placed: Option<Placed>,
}

impl<'a> Lookout<'a> {
    /// A lookout for each point, or for each row where points are placed for every view.
    fn all(design: &'a Design<'_>, occluder: &'a Occluder) -> Vec<Self> {
        let of = |point: &'a Point, rows: &'a [Row]| Self {
            design,
            occluder,
            point,
            rows,
            placed: rows[0].placed,
        };
        let observations = design.observations;
        let turns = observations.rows.iter().any(|row| row.placed.is_some());
        let points = observations.points.iter();
        let lookouts = points.flat_map(|point| {
            let rows = &observations.rows[point.rows.clone()];
            let size = if turns { 1 } else { rows.len().max(1) };
            rows.chunks(size).map(move |rows| of(point, rows))
        });
        lookouts.collect()
    }

    /// Its place and normal where the lights stand still.
    fn place(&self) -> (Vec3, Vec3) {
        let placed = self.placed.map(|placed| (placed.position, placed.normal));
        placed.unwrap_or((self.point.position, self.point.normal))
    }

    /// Calls `tell` for each of some numbered directions, and whether the point sees that way.
    fn each(&self, directions: &[(usize, Vec3)], mut tell: impl FnMut(usize, bool)) {
        let Point {
            position, normal, ..
        } = *self.point;
        let origin = self.occluder.offset_origin(position, normal);
        let rays = directions.iter().map(|&(number, direction)| {
            let (l, distance) = self.ray(direction);
            (number, l, distance)
        });
        let tell = |number, is_blocked: bool| tell(number, !is_blocked);
        self.occluder.each_occluded(origin, rays, tell);
    }

    /// Direction and length of a ray towards a light, as the surface lies.
    fn ray(&self, direction: Vec3) -> (Vec3, f32) {
        let (position, _) = self.place();
        let (l, _) = light_from(self.design.near, direction, position);
        let distance = self.design.near.map_or(f32::INFINITY, |(centre, radius)| {
            (centre + radius * direction - position).length()
        });
        let l = self.placed.map_or(l, |placed| placed.to_surface * l);
        (l, distance)
    }

    /// Looks for every one of some cells.
    fn look(&self, cells: impl Iterator<Item = usize>, out: &mut [f32]) {
        let directions = &self.design.geometry.directions;
        let cells: Vec<(usize, Vec3)> = cells.map(|c| (c, directions[c])).collect();
        self.each(&cells, |cell, sees| out[cell] = f32::from(u8::from(sees)));
    }

    /// Looks for groups that could show within the angle `support` of a half vector, then for cells where groups disagree.
    /// Returns the number of rays.
    fn look_by_groups(&self, groups: &Groups, support: f32, out: &mut [f32]) -> usize {
        let least = support.min(std::f32::consts::PI).cos();
        let towards: Vec<(usize, Vec3)> = groups
            .list
            .iter()
            .enumerate()
            .map(|(k, group)| (k, group.direction))
            .filter(|&(_, direction)| self.could_show(direction, groups.reach, least))
            .collect();
        let mut rays = towards.len();
        let mut seen: Vec<Option<bool>> = vec![None; groups.list.len()];
        self.each(&towards, |k, sees| seen[k] = Some(sees));
        let mut open = Vec::new();
        for (group, own) in groups.list.iter().zip(&seen) {
            let Some(own) = *own else { continue };
            if group
                .around
                .iter()
                .all(|&o| seen[o].is_none_or(|s| s == own))
            {
                for &cell in &group.members {
                    out[cell] = f32::from(u8::from(own));
                }
            } else {
                open.extend(&group.members);
            }
        }
        rays += open.len();
        self.look(open.into_iter(), out);
        rays
    }

    /// Whether light from a direction, or up to `reach` from it, is not behind the surface and has a half vector whose
    /// cosine is more than `least` in some row.
    fn could_show(&self, direction: Vec3, reach: f32, least: f32) -> bool {
        let (position, normal) = self.place();
        let (l, _) = light_from(self.design.near, direction, position);
        let shows = |row: &Row| {
            let sum = l + row.placed.map_or(row.to_camera, |placed| placed.to_camera);
            sum.dot(normal) > least * sum.length()
        };
        normal.dot(l) > -reach && self.rows.iter().any(shows)
    }
}

struct Groups {
    list: Vec<Group>,
    /// Largest angle from a group's centre to one of its cells, radians.
    reach: f32,
}

/// Groups cells by their parent, which is found as the nearest centre among the coarser cells.
fn group(pyramid: &Pyramid, cells: &[Cell], directions: &[Vec3]) -> Groups {
    let mut members: BTreeMap<Cell, Vec<usize>> = BTreeMap::new();
    for (i, &cell) in cells.iter().enumerate() {
        members.entry(pyramid.parent(cell)).or_default().push(i);
    }
    let mut list: Vec<Group> = members
        .into_values()
        .map(|members| Group {
            direction: members
                .iter()
                .map(|&m| directions[m])
                .sum::<Vec3>()
                .normalize_or_zero(),
            members,
            around: Vec::new(),
        })
        .collect();
    let reach = list
        .iter()
        .flat_map(|g| {
            g.members
                .iter()
                .map(|&m| directions[m].angle_between(g.direction))
        })
        .fold(0.0_f32, f32::max);
    for i in 0..list.len() {
        let direction = list[i].direction;
        list[i].around = (0..list.len())
            .filter(|&j| j != i && list[j].direction.angle_between(direction) < 3.0 * reach)
            .collect();
    }
    Groups { list, reach }
}
