//! Which cells a surface point sees past the rest of the object.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use glam::Vec3;
use rayon::prelude::*;

use super::cells::{Cell, Pyramid};
use super::design::Design;
use super::lobes::light_from;
use super::model::Brdf;
use super::shortcuts::Shortcut;
use crate::surface::Occluder;

/// Part of a lobe's peak below which a light is not worth a shadow ray.
const NEGLIGIBLE: f32 = 3e-3;

/// Cells that are tested by one ray first.
struct Group {
    direction: Vec3,
    members: Vec<usize>,
    /// Groups whose centres are near this one's.
    around: Vec<usize>,
}

/// Share of each cell that each point of the design sees, 0 or 1, point by point.
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
) -> Vec<f32> {
    let groups = group(pyramid, cells, &design.geometry.directions);
    let widest = groups.reach;
    let support = brdf.half_angle_support(NEGLIGIBLE) + 0.5 * widest;
    let n = cells.len();
    let mut visibility = vec![1.0_f32; design.observations.points.len() * n];
    visibility
        .par_chunks_mut(n.max(1))
        .enumerate()
        .for_each(|(index, out)| {
            if design.stop.load(Ordering::Relaxed) {
                return;
            }
            let point = &design.observations.points[index];
            let rows = &design.observations.rows[point.rows.clone()];
            let origin = occluder.offset_origin(point.position, point.normal);
            let sees = |direction: Vec3| {
                let (l, _) = light_from(design.near, direction, point.position);
                let distance = design.near.map_or(f32::INFINITY, |(c, r)| {
                    (c + r * direction - origin).length()
                });
                !occluder.occluded(origin, l, distance)
            };
            let matters = |direction: Vec3| {
                let (l, _) = light_from(design.near, direction, point.position);
                point.normal.dot(l) > -widest
                    && rows.iter().any(|r| {
                        (l + r.to_camera)
                            .normalize_or_zero()
                            .dot(point.normal)
                            .clamp(-1.0, 1.0)
                            .acos()
                            < support
                    })
            };
            if !design.shortcuts.takes(Shortcut::ShadowRays) {
                for (out, &direction) in out.iter_mut().zip(&design.geometry.directions) {
                    *out = f32::from(u8::from(sees(direction)));
                }
                design.shortcuts.count(Shortcut::ShadowRays, n, 0);
                return;
            }
            let seen: Vec<Option<bool>> = groups
                .list
                .iter()
                .map(|g| matters(g.direction).then(|| sees(g.direction)))
                .collect();
            let mut rays = seen.iter().flatten().count();
            for (g, own) in groups.list.iter().zip(&seen) {
                let Some(own) = *own else { continue };
                let agreed = g.around.iter().all(|&o| seen[o].is_none_or(|s| s == own));
                if !agreed {
                    rays += g.members.len();
                }
                for &c in &g.members {
                    let s = if agreed {
                        own
                    } else {
                        sees(design.geometry.directions[c])
                    };
                    out[c] = f32::from(u8::from(s));
                }
            }
            let left_out = n.saturating_sub(rays);
            design.shortcuts.count(Shortcut::ShadowRays, n, left_out);
        });
    visibility
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
