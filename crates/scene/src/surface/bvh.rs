//! Which part of the surface does a ray meet: ray casts against the mesh through a bounding volume hierarchy.
//!
//! Inside, the object is moved and scaled into a box of half diagonal 1 about the origin, so that every tolerance
//! is relative to the object's size whatever the mesh's unit is.

use glam::{Vec2, Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use rayon::prelude::*;
use std::time::Duration;

use super::bundle::{Bundle, LANES, Leaf, Tree};
use rekindle_capture::Mesh;

/// Growth of every triangle's box, as a fraction of the object's half diagonal: a flat box would be missed by rounding.
const BOX_MARGIN: f32 = 1e-6;
/// Distance by which a ray's origin is lifted off the surface, as a fraction of the object's half diagonal: some
/// hundred times the rounding error of a position, and far below a pixel's footprint.
const ORIGIN_LIFT: f32 = 2e-5;

/// Where a ray first meets the surface.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of the triangle's second and third corner.
    pub barycentric: Vec2,
    /// Distance along the unit direction, in mesh units.
    pub distance: f32,
}

/// A node of the hierarchy in the order in which a walk without a stack visits them: from one to the next where the ray
/// meets its box, past all nodes below it where not.
#[derive(Clone, Copy, Debug)]
pub struct WalkNode {
    /// Lowest corner of the box, mesh units.
    pub low: Vec3,
    /// Highest corner.
    pub high: Vec3,
    /// The node to go on with where the box is missed, or where this is a leaf.
    pub skip: u32,
    /// Triangles of a leaf, as a range of the walk's list of triangles; empty for others.
    pub first: u32,
    /// Their number.
    pub count: u32,
}

/// What a walk still has to do.
enum Step {
    /// Visit a node of the hierarchy.
    Visit(usize),
    /// Go on after a node of the walk: all that is below it has been visited.
    Close(usize),
}

/// The mesh prepared for ray casts.
pub struct Occluder {
    bvh: Bvh2,
    /// Levels of the hierarchy.
    depth: usize,
    /// In the order of the hierarchy's leaves.
    leaves: Vec<Leaf>,
    centre: Vec3,
    /// Mesh units per internal unit.
    scale: f32,
}

impl Occluder {
    /// Builds the hierarchy over all triangles of `mesh`.
    pub fn new(mesh: &Mesh) -> Self {
        let (low, high) = mesh.bounds();
        let centre = (low + high) * 0.5;
        let half = (high - low).length() * 0.5;
        let scale = if half.is_finite() && half > 0.0 {
            half
        } else {
            1.0
        };
        let inside = |p: Vec3| (p - centre) / scale;
        let boxes: Vec<Aabb> = (0..mesh.triangles.len())
            .into_par_iter()
            .map(|t| {
                let [a, b, c] = mesh.corners(t as u32).map(|p| Vec3A::from(inside(p)));
                Aabb {
                    min: a.min(b).min(c) - BOX_MARGIN,
                    max: a.max(b).max(c) + BOX_MARGIN,
                }
            })
            .collect();
        // A million triangles are built in under a second at this setting; small meshes get the better tree.
        let parameters = if boxes.len() > 400_000 {
            BvhBuildParams::fast_build()
        } else {
            BvhBuildParams::medium_build()
        };
        let bvh = build_bvh2(&boxes, parameters, &mut Duration::default());
        let depth = if bvh.nodes.is_empty() {
            0
        } else {
            bvh.depth(0)
        };
        let leaves = bvh
            .primitive_indices
            .iter()
            .map(|&triangle| {
                let [a, b, c] = mesh.corners(triangle).map(inside);
                Leaf {
                    corner: a,
                    edge1: b - a,
                    edge2: c - a,
                    triangle,
                }
            })
            .collect();
        Self {
            bvh,
            depth,
            leaves,
            centre,
            scale,
        }
    }

    fn tree(&self) -> Tree<'_> {
        Tree {
            nodes: &self.bvh.nodes,
            leaves: &self.leaves,
            depth: self.depth,
        }
    }

    /// Whether anything lies between `origin` and `max_distance` (mesh units, may be infinite) along the unit `direction`.
    pub fn occluded(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        let mut is_blocked = false;
        self.each_occluded(origin, [((), direction, max_distance)], |(), blocked| {
            is_blocked = blocked;
        });
        is_blocked
    }

    /// [`Occluder::occluded`] for many rays from one point, each with a name, its unit direction and its greatest distance.
    /// They go eight at a time: of those that go nearly the same way, eight cost little more than one.
    pub fn each_occluded<T: Copy>(
        &self,
        origin: Vec3,
        rays: impl IntoIterator<Item = (T, Vec3, f32)>,
        mut tell: impl FnMut(T, bool),
    ) {
        self.each_bundle(origin, rays, |bundle, names| {
            bundle.find_any(self.tree());
            let blocked = bundle.blocked();
            for (lane, &name) in names.iter().flatten().enumerate() {
                tell(name, blocked >> lane & 1 == 1);
            }
        });
    }

    /// Cuts rays into bundles, each with the names of its rays.
    #[inline]
    fn each_bundle<T: Copy>(
        &self,
        origin: Vec3,
        rays: impl IntoIterator<Item = (T, Vec3, f32)>,
        mut cast: impl FnMut(&mut Bundle, &[Option<T>; LANES]),
    ) {
        let from = (origin - self.centre) / self.scale;
        let mut rays = rays.into_iter().peekable();
        while rays.peek().is_some() {
            let mut names = [None; LANES];
            let some = names.iter_mut().zip(&mut rays);
            let mut bundle = Bundle::new(
                from,
                some.map(|(name, (own, direction, reach))| {
                    *name = Some(own);
                    (direction, reach / self.scale)
                }),
            );
            cast(&mut bundle, &names);
        }
    }

    /// The hierarchy for a walk without a stack, with its list of triangles.
    pub fn walk(&self) -> (Vec<WalkNode>, Vec<u32>) {
        let mut walk: Vec<WalkNode> = Vec::with_capacity(self.bvh.nodes.len());
        // The next step last.
        let mut steps = Vec::new();
        if !self.bvh.nodes.is_empty() {
            steps.push(Step::Visit(0));
        }
        while let Some(step) = steps.pop() {
            let visit = match step {
                Step::Close(at) => {
                    walk[at].skip = walk.len() as u32;
                    continue;
                }
                Step::Visit(visit) => &self.bvh.nodes[visit],
            };
            let outside = |p: Vec3A| Vec3::from(p) * self.scale + self.centre;
            let (at, first) = (walk.len(), visit.first_index);
            let leaf = visit.is_leaf();
            walk.push(WalkNode {
                low: outside(visit.aabb().min),
                high: outside(visit.aabb().max),
                skip: at as u32 + 1,
                first: if leaf { first } else { 0 },
                count: if leaf { visit.prim_count } else { 0 },
            });
            if !leaf {
                steps.push(Step::Close(at));
                steps.push(Step::Visit(first as usize + 1));
                steps.push(Step::Visit(first as usize));
            }
        }
        (walk, self.leaves.iter().map(|leaf| leaf.triangle).collect())
    }

    /// The first point of the surface, front or back, along the unit `direction`.
    pub fn hit(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let mut met = None;
        self.each_hit(origin, [((), direction)], |(), hit| met = hit);
        met
    }

    /// [`Occluder::hit`] for many rays from one point, each with a name and its unit direction, as for
    /// [`Occluder::each_occluded`].
    pub fn each_hit<T: Copy>(
        &self,
        origin: Vec3,
        rays: impl IntoIterator<Item = (T, Vec3)>,
        mut tell: impl FnMut(T, Option<Hit>),
    ) {
        let endless = rays.into_iter().map(|(name, d)| (name, d, f32::INFINITY));
        self.each_bundle(origin, endless, |bundle, names| {
            bundle.find_nearest(self.tree());
            for (lane, &name) in names.iter().flatten().enumerate() {
                let hit = bundle.met(lane).map(|met| Hit {
                    triangle: met.triangle,
                    barycentric: met.barycentric,
                    distance: met.distance * self.scale,
                });
                tell(name, hit);
            }
        });
    }

    /// `position` lifted off the surface along `normal` (unit, on the side the ray leaves to), far enough that a ray
    /// from there does not meet the triangle it starts on.
    pub fn offset_origin(&self, position: Vec3, normal: Vec3) -> Vec3 {
        position + normal * (ORIGIN_LIFT * self.scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::fixtures::bumpy_sphere;

    /// The nearest intersection by trying every triangle in double precision.
    fn brute_force(mesh: &Mesh, origin: Vec3, direction: Vec3) -> Option<(u32, f64)> {
        let (o, d) = (origin.as_dvec3(), direction.as_dvec3());
        (0..mesh.triangles.len() as u32)
            .filter_map(|t| {
                let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3() - o);
                let weights = [b.cross(c).dot(d), c.cross(a).dot(d), a.cross(b).dot(d)];
                let sum: f64 = weights.iter().sum();
                let inside = weights.iter().all(|w| w / sum >= 0.0);
                let distance = a.dot(b.cross(c)) / sum;
                (inside && distance > 0.0).then_some((t, distance))
            })
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    fn rays(count: usize) -> impl Iterator<Item = (Vec3, Vec3)> {
        (0..count).map(|i| {
            let k = i as f32;
            let origin = 3.0 * Vec3::new((k * 0.7).sin(), (k * 1.3).cos(), (k * 0.31).sin());
            let target = 0.9 * Vec3::new((k * 2.1).cos(), (k * 0.9).sin(), (k * 1.7).cos());
            (origin, (target - origin).normalize_or_zero())
        })
    }

    #[test]
    fn a_walk_visits_every_triangle_once_inside_its_box() {
        let mesh = bumpy_sphere(12, 0.2);
        let (nodes, list) = Occluder::new(&mesh).walk();
        let mut seen = vec![0; mesh.triangles.len()];
        for (at, node) in nodes.iter().enumerate() {
            assert!(node.skip as usize > at && node.skip as usize <= nodes.len());
            for &triangle in &list[node.first as usize..(node.first + node.count) as usize] {
                seen[triangle as usize] += 1;
                for corner in mesh.corners(triangle) {
                    let inside = corner.cmpge(node.low) & corner.cmple(node.high);
                    assert!(inside.all(), "{corner} outside its leaf's box");
                }
            }
            if node.count > 0 {
                assert_eq!(node.skip as usize, at + 1, "a leaf has nothing below it");
            }
        }
        assert!(seen.iter().all(|&count| count == 1));
        // A walk that misses every box ends at once.
        assert_eq!(nodes[0].skip as usize, nodes.len());
    }

    #[test]
    fn finds_the_nearest_triangle_at_any_scale_and_place() {
        for (scale, offset) in [
            (1.0, Vec3::ZERO),
            (1e-6, Vec3::ZERO),
            (1e5, Vec3::new(2e5, -1e5, 0.0)),
        ] {
            let mut mesh = bumpy_sphere(24, 0.2);
            for p in &mut mesh.positions {
                *p = *p * scale + offset;
            }
            let occluder = Occluder::new(&mesh);
            let mut hits = 0;
            for (origin, direction) in rays(2000) {
                let origin = origin * scale + offset;
                let expected = brute_force(&mesh, origin, direction);
                let found = occluder.hit(origin, direction);
                if let (Some((_, distance)), Some(hit)) = (expected, found) {
                    assert!(
                        (distance - f64::from(hit.distance)).abs()
                            < 1e-4 * distance + 1e-6 * f64::from(scale.max(offset.length())),
                        "{distance} against {}",
                        hit.distance
                    );
                    let there = mesh.point(hit.triangle, hit.barycentric).position;
                    let error = (origin + direction * hit.distance - there).length();
                    assert!(error < 1e-4 * scale.max(offset.length()), "off by {error}");
                    assert!(
                        occluder.occluded(origin, direction, f32::INFINITY),
                        "any hit"
                    );
                    assert!(
                        !occluder.occluded(origin, direction, hit.distance * 0.999),
                        "before it"
                    );
                    hits += 1;
                } else {
                    assert_eq!(
                        expected.is_some(),
                        found.is_some(),
                        "from {origin} along {direction}"
                    );
                }
            }
            assert!(hits > 1000, "{hits} of the rays meet the object");
        }
    }

    #[test]
    fn rays_together_meet_what_each_meets_alone() {
        let mesh = bumpy_sphere(24, 0.2);
        let occluder = Occluder::new(&mesh);
        let all: Vec<(Vec3, Vec3)> = rays(1600).collect();
        let (mut met, mut blocked) = (0, 0);
        for bundle in all.chunks(2 * LANES + 3) {
            let (origin, _) = bundle[0];
            let directions = || bundle.iter().map(|&(_, d)| d).enumerate();
            // Some end on the way to what they would meet.
            let reach = |i: usize| if i.is_multiple_of(2) { 2.5 } else { 9.0 };
            let mut hits = Vec::new();
            occluder.each_hit(origin, directions(), |i, hit| hits.push((i, hit)));
            let mut ends = Vec::new();
            let limited = directions().map(|(i, d)| (i, d, reach(i)));
            occluder.each_occluded(origin, limited, |i, is_blocked| ends.push((i, is_blocked)));
            assert_eq!((hits.len(), ends.len()), (bundle.len(), bundle.len()));
            for ((i, direction), (hit, end)) in directions().zip(hits.iter().zip(ends)) {
                let alone = occluder.hit(origin, direction);
                assert_eq!((hit.0, end.0), (i, i));
                assert_eq!(hit.1.map(|h| h.triangle), alone.map(|h| h.triangle));
                let is_blocked = alone.is_some_and(|h| h.distance < reach(i));
                assert_eq!(end.1, is_blocked, "ray {i} from {origin}");
                met += usize::from(hit.1.is_some());
                blocked += usize::from(is_blocked);
            }
        }
        assert!(
            met > 40 && blocked > 10 && blocked < met,
            "{met}, {blocked}"
        );
    }

    #[test]
    fn a_ray_that_leaves_the_surface_does_not_meet_where_it_starts() {
        let mesh = bumpy_sphere(64, 0.0);
        let occluder = Occluder::new(&mesh);
        for t in 0..mesh.triangles.len() as u32 {
            for barycentric in [Vec2::splat(0.33), Vec2::new(0.5, 0.5), Vec2::ZERO] {
                let point = mesh.point(t, barycentric);
                let normal = mesh.face_normal(t);
                let origin = occluder.offset_origin(point.position, normal);
                assert!(
                    !occluder.occluded(origin, normal, f32::INFINITY),
                    "triangle {t}"
                );
                assert!(
                    occluder.occluded(origin, -normal, f32::INFINITY),
                    "triangle {t}"
                );
            }
        }
    }

    #[test]
    fn empty_degenerate_and_repeated_triangles_do_no_harm() {
        let empty = Occluder::new(&Mesh::default());
        assert!(empty.hit(Vec3::ZERO, Vec3::Z).is_none());
        let mesh = Mesh {
            origin: glam::DVec3::ZERO,
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            normals: vec![Vec3::Z; 3],
            uvs: Vec::new(),
            triangles: [[0, 0, 0], [0, 1, 1], [0, 1, 2]].repeat(5000),
        };
        let occluder = Occluder::new(&mesh);
        let hit = occluder.hit(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z).unwrap();
        assert_eq!(hit.triangle, 2);
        assert!(occluder.hit(Vec3::splat(f32::NAN), Vec3::NEG_Z).is_none());
        let flat = Mesh {
            origin: glam::DVec3::ZERO,
            positions: vec![Vec3::ONE; 3],
            normals: vec![Vec3::Z; 3],
            uvs: Vec::new(),
            triangles: vec![[0, 1, 2]],
        };
        assert!(Occluder::new(&flat).hit(Vec3::ZERO, Vec3::Z).is_none());
    }
}
