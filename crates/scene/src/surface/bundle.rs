//! Rays from one point, eight at a time, through the bounding volume hierarchy.
//!
//! Rays from a surface point to a lamp, or along a lobe, visit nearly the same boxes and triangles. So each has a lane of
//! vector code, and what is the same for all of them, as a corner's place seen from their origin, is computed once. A ray
//! alone costs what it would without lanes.

use glam::{Vec2, Vec3};
use obvhs::aabb::Aabb;
use obvhs::bvh2::node::Bvh2Node;

/// Rays that go together.
pub const LANES: usize = 8;

/// How far outside a triangle, in barycentric units, a ray still hits it: neighbours must not leave a crack.
const EDGE_TOLERANCE: f32 = 1e-6;
/// Least component of a direction whose inverse is taken, so that it stays finite.
const LEAST_COMPONENT: f32 = 1e-30;
/// No triangle.
const NONE: u32 = u32::MAX;

type Lanes = [f32; LANES];

/// One triangle as the traversal reads it: a corner and the two edges from it.
#[derive(Clone, Copy, Debug)]
pub struct Leaf {
    /// The first corner.
    pub corner: Vec3,
    /// From there to the second.
    pub edge1: Vec3,
    /// From there to the third.
    pub edge2: Vec3,
    /// Index of the triangle.
    pub triangle: u32,
}

/// A hierarchy to send rays through.
#[derive(Clone, Copy)]
pub struct Tree<'a> {
    /// Pairs of boxes, the root alone at the front.
    pub nodes: &'a [Bvh2Node],
    /// In the order of the hierarchy's leaves.
    pub leaves: &'a [Leaf],
    /// Levels.
    pub depth: usize,
}

/// Rays from one point and what they have met so far.
#[derive(Clone, Copy, Debug)]
pub struct Bundle {
    origin: Vec3,
    /// Sum of the directions.
    axis: Vec3,
    direction: [Lanes; 3],
    /// 1 / direction.
    inverse: [Lanes; 3],
    /// How far each ray goes; negative in lanes that have none, or none any more.
    reach: Lanes,
    /// What each ray has met.
    triangle: [u32; LANES],
    /// Where: weights of the triangle's second and third corner.
    barycentric: [Lanes; 2],
}

/// What a ray met.
#[derive(Clone, Copy, Debug)]
pub struct Met {
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of the triangle's second and third corner.
    pub barycentric: Vec2,
    /// Distance along the unit direction.
    pub distance: f32,
}

impl Bundle {
    /// Rays from `origin`, each with its unit direction and reach; those past [`LANES`] are left out.
    pub fn new(origin: Vec3, rays: impl IntoIterator<Item = (Vec3, f32)>) -> Self {
        let mut bundle = Self {
            origin,
            axis: Vec3::ZERO,
            direction: [[1.0; LANES]; 3],
            inverse: [[1.0; LANES]; 3],
            reach: [-1.0; LANES],
            triangle: [NONE; LANES],
            barycentric: [[0.0; LANES]; 2],
        };
        for (lane, (direction, reach)) in rays.into_iter().take(LANES).enumerate() {
            if !origin.is_finite() || !direction.is_finite() {
                continue;
            }
            bundle.axis += direction;
            bundle.reach[lane] = reach;
            for (k, d) in direction.to_array().into_iter().enumerate() {
                bundle.direction[k][lane] = d;
                bundle.inverse[k][lane] = 1.0 / d.abs().max(LEAST_COMPONENT).copysign(d);
            }
        }
        bundle
    }

    /// What the ray of a lane met.
    pub fn met(&self, lane: usize) -> Option<Met> {
        let [b1, b2] = &self.barycentric;
        (self.triangle[lane] != NONE).then(|| Met {
            triangle: self.triangle[lane],
            barycentric: Vec2::new(b1[lane], b2[lane]),
            distance: self.reach[lane],
        })
    }

    /// A bit for every lane whose ray met something.
    pub fn blocked(&self) -> u8 {
        (0..LANES).fold(0, |bits, lane| {
            bits | u8::from(self.triangle[lane] != NONE) << lane
        })
    }

    /// Lets each ray find the first triangle that it meets.
    pub fn find_nearest(&mut self, tree: Tree<'_>) {
        pulp::Arch::new().dispatch(Walk::<true> { rays: self, tree });
    }

    /// Lets each ray find out whether it meets any triangle; [`Bundle::met`] does not say where.
    pub fn find_any(&mut self, tree: Tree<'_>) {
        pulp::Arch::new().dispatch(Walk::<false> { rays: self, tree });
    }

    /// Whether any of the rays enters a box.
    #[inline(always)]
    fn enters(&self, bounds: &Aabb) -> bool {
        let low = Vec3::from(bounds.min) - self.origin;
        let high = Vec3::from(bounds.max) - self.origin;
        let [x, y, z] = &self.inverse;
        let mut inside = [0_u32; LANES];
        for i in 0..LANES {
            let (x0, x1) = (low.x * x[i], high.x * x[i]);
            let (y0, y1) = (low.y * y[i], high.y * y[i]);
            let (z0, z1) = (low.z * z[i], high.z * z[i]);
            let near = larger(
                larger(smaller(x0, x1), smaller(y0, y1)),
                larger(smaller(z0, z1), 0.0),
            );
            let far = smaller(
                smaller(larger(x0, x1), larger(y0, y1)),
                smaller(larger(z0, z1), self.reach[i]),
            );
            inside[i] = u32::from(near <= far);
        }
        inside.iter().fold(0, |any, i| any | i) != 0
    }

    /// Lets the rays meet a triangle's front or back (Möller and Trumbore 1997), of two at one distance the lower index, so
    /// that the tree's shape does not show. Where any will do, a ray that has met one ends.
    #[expect(
        clippy::needless_bitwise_bool,
        reason = "a branch would end the vector code"
    )]
    #[inline(always)]
    fn meet<const NEAREST: bool>(&mut self, leaf: &Leaf) {
        let from_corner = self.origin - leaf.corner;
        // The products of direction, edges and corner, turned round so that what all rays share comes first.
        let normal = leaf.edge2.cross(leaf.edge1);
        let across = leaf.edge2.cross(from_corner);
        let along = from_corner.cross(leaf.edge1);
        let height = leaf.edge2.dot(along);
        let [x, y, z] = &self.direction;
        // Whole arrays are replaced, not some of their lanes: those would be read before they are written.
        let mut reach = self.reach;
        let mut triangle = self.triangle;
        let [mut first, mut second] = self.barycentric;
        for i in 0..LANES {
            let dot = |v: Vec3| v.x * x[i] + v.y * y[i] + v.z * z[i];
            let inverse = 1.0 / dot(normal);
            let (b1, b2) = (dot(across) * inverse, dot(along) * inverse);
            let t = height * inverse;
            // Not so also where a weight is NaN: a sliver seen edge-on.
            let inside = (b1 >= -EDGE_TOLERANCE)
                & (b2 >= -EDGE_TOLERANCE)
                & (b1 + b2 <= 1.0 + EDGE_TOLERANCE);
            let nearer = (t < self.reach[i])
                | (NEAREST & (t == self.reach[i]) & (leaf.triangle < self.triangle[i]));
            let met = inside & nearer & (t > 0.0) & (t <= f32::MAX);
            let reached = if NEAREST { t } else { -1.0 };
            reach[i] = if met { reached } else { self.reach[i] };
            // With bits: a choice between two places in memory would be made by gathering from them.
            let chosen = u32::from(met).wrapping_neg();
            triangle[i] = (leaf.triangle & chosen) | (self.triangle[i] & !chosen);
            if NEAREST {
                first[i] = if met { b1 } else { self.barycentric[0][i] };
                second[i] = if met { b2 } else { self.barycentric[1][i] };
            }
        }
        self.reach = reach;
        self.triangle = triangle;
        if NEAREST {
            self.barycentric = [first, second];
        }
    }

    /// Whether no ray goes on.
    #[inline(always)]
    fn is_done(&self) -> bool {
        self.reach
            .iter()
            .fold(0, |any, &reach| any | u32::from(reach >= 0.0))
            == 0
    }
}

/// The lesser of two numbers, as one instruction; what it gives for NaN does not matter here.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The way of a bundle through a tree, compiled for the widest vectors that the processor has.
struct Walk<'a, const NEAREST: bool> {
    rays: &'a mut Bundle,
    tree: Tree<'a>,
}

impl<const NEAREST: bool> pulp::NullaryFnOnce for Walk<'_, NEAREST> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Tree {
            nodes,
            leaves,
            depth,
        } = self.tree;
        let rays = self.rays;
        let Some(mut node) = nodes.first().filter(|root| rays.enters(&root.aabb)) else {
            return;
        };
        let mut left: Vec<u32> = Vec::with_capacity(depth);
        loop {
            let first = node.first_index as usize;
            if node.is_leaf() {
                for leaf in &leaves[first..first + node.prim_count as usize] {
                    rays.meet::<NEAREST>(leaf);
                }
                if !NEAREST && rays.is_done() {
                    return;
                }
            } else {
                let [one, other] = [&nodes[first], &nodes[first + 1]];
                let enters = [rays.enters(&one.aabb), rays.enters(&other.aabb)];
                if enters == [true, true] {
                    // The nearer one first.
                    let middles = [one, other].map(|n| n.aabb.min + n.aabb.max);
                    let swap = (middles[1] - middles[0]).dot(rays.axis.into()) < 0.0;
                    left.push(node.first_index + u32::from(!swap));
                    node = if swap { other } else { one };
                    continue;
                }
                if enters != [false, false] {
                    node = if enters[0] { one } else { other };
                    continue;
                }
            }
            match left.pop() {
                Some(next) => node = &nodes[next as usize],
                None => return,
            }
        }
    }
}
