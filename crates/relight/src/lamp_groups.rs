//! Lamps and patches of light prepared for shading: their nodes, a few that stand for all of these, and those that rays are cast to.

use glam::{Mat2, Vec2, Vec3};

use super::lighting::{LampNodes, LightNode};
use super::patches;
use super::shading::{ShadingPoint, Visibility};

/// Lamps of at least this many nodes send scouts ahead …
const MANY_NODES: usize = 24;
/// … this many.
const SCOUTS: usize = 12;
/// Rays per patch of an environment, and of a wide lamp where it has a larger angular radius (radians) than this.
const SOFT_RAYS: usize = 4;
pub(super) const ONE_RAY: f32 = 0.12;

/// A small part of a lamp.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// Unit direction, or the node's position where it is near.
    pub(super) place: Vec3,
    pub(super) flux: Vec3,
}

/// A lamp prepared for shading.
#[derive(Clone, Debug)]
pub(super) struct Group {
    pub(super) nodes: Vec<Node>,
    /// A few nodes that shine as all of them do: as long as a lobe does not resolve them or, of a wide lamp's patch, for the lobe.
    pub(super) few: Vec<Node>,
    /// All light of a wide lamp's patch in one node, for irradiance.
    pub(super) middle: Option<[Node; 1]>,
    /// Squared distance from the centre, for near lamps.
    pub(super) near: Option<f32>,
    /// Unit direction or position of its middle.
    pub(super) axis: Vec3,
    /// Angular radius about the middle seen from the centre, radians.
    pub(super) reach: f32,
    /// How far below a point's horizon its middle is where all of it is: a sine.
    sine: f32,
    /// Nodes that tell whether the lamp is seen.
    pub(super) probes: Vec<usize>,
    /// Nodes spread over a lamp of many.
    pub(super) scouts: Vec<usize>,
    /// For every node of a lamp with scouts the three of them that are nearest.
    pub(super) among: Vec<[u8; 3]>,
    /// Σ flux × direction for each channel, of a distant lamp.
    pub(super) moment: [Vec3; 3],
    /// Visibility is a fraction that varies smoothly.
    pub(super) soft: bool,
    /// Lobes show it as part of the sky, not node by node.
    pub(super) in_sky: bool,
}

impl Group {
    pub(super) fn new(lamp: &LampNodes, centre: Vec3, role: Role, unresolved: f32) -> Option<Self> {
        let lit: Vec<_> = lamp
            .nodes
            .iter()
            .filter(|n| n.flux() != Vec3::ZERO)
            .collect();
        if lit.is_empty() || lamp.muted {
            return None;
        }
        let place = |direction: Vec3| lamp.radius.map_or(direction, |r| centre + r * direction);
        let nodes: Vec<Node> = lit
            .iter()
            .map(|n| Node {
                place: place(n.direction),
                flux: n.flux(),
            })
            .collect();
        let reach = patches::reach(lamp);
        let directions: Vec<Vec3> = lit.iter().map(|n| n.direction).collect();
        let soft = role != Role::Lamp;
        let probes = match role {
            Role::Patch if reach <= ONE_RAY => {
                innermost(&directions, lamp.direction).into_iter().collect()
            }
            Role::Patch => spread(nodes.len()),
            Role::Environment => {
                let count = SOFT_RAYS.min(nodes.len());
                (0..count).map(|i| i * nodes.len() / count).collect()
            }
            Role::Lamp => {
                let mut probes = extremal(&directions, lamp.direction);
                probes.sort_unstable();
                probes.dedup();
                probes
            }
        };
        let (scouts, among) = if soft || directions.len() < MANY_NODES {
            (Vec::new(), Vec::new())
        } else {
            scouts(&directions)
        };
        let mut moment = [Vec3::ZERO; 3];
        for n in &lit {
            for (channel, m) in moment.iter_mut().enumerate() {
                *m += n.direction * n.flux()[channel];
            }
        }
        let whole = |part: &LampNodes| Node {
            place: place(part.direction),
            flux: part.flux(),
        };
        let few = if role == Role::Patch {
            patches::cut(lamp, unresolved).iter().map(whole).collect()
        } else if nodes.len() < MANY_NODES {
            nodes.clone()
        } else {
            stand_ins(&lit, lamp.direction)
                .into_iter()
                .map(|(direction, flux)| Node {
                    place: place(direction),
                    flux,
                })
                .collect()
        };
        Some(Self {
            nodes,
            few,
            middle: (role == Role::Patch).then(|| [whole(lamp)]),
            near: lamp.radius.map(|r| r * r),
            axis: place(lamp.direction),
            reach,
            sine: sine(reach),
            probes,
            scouts,
            among,
            moment,
            soft,
            in_sky: role == Role::Environment,
        })
    }

    /// Unit direction from a surface point to a place of this group, fall-off and distance.
    #[inline]
    pub(super) fn towards(&self, place: Vec3, from: Vec3) -> (Vec3, f32, f32) {
        match self.near {
            None => (place, 1.0, f32::INFINITY),
            Some(squared_radius) => {
                let offset = place - from;
                // A node inside the object would blow up: nothing comes nearer than a tenth of the radius.
                let squared = offset.length_squared().max(0.01 * squared_radius);
                let distance = squared.sqrt();
                (offset / distance, squared_radius / squared, distance)
            }
        }
    }

    /// Unit direction to a node and its distance, unless it is behind the surface.
    pub(super) fn ray_to(&self, node: usize, point: &ShadingPoint) -> Option<(Vec3, f32)> {
        let (l, _, distance) = self.towards(self.nodes[node].place, point.position);
        let in_front = l.dot(point.normal) > 0.0 && l.dot(point.face_normal) > 0.0;
        in_front.then_some((l, distance))
    }

    /// Largest angle between the axis and a node, seen from a surface point; radians.
    #[inline]
    pub(super) fn reach_from(&self, falloff: f32) -> f32 {
        // Seen from nearer, a lamp is larger by the root of its fall-off; a tenth more as the nodes' own
        // distances differ.
        if self.near.is_some() {
            self.reach * falloff.sqrt() * 1.1
        } else {
            self.reach
        }
    }

    /// The nodes to add up at a point: a few for all where these are seen alike and, but for patches, above the horizon,
    /// unless the distances between them matter.
    pub(super) fn standing_for(
        &self,
        point: &ShadingPoint,
        seen: &Visibility,
        resolved: bool,
    ) -> &[Node] {
        if self.middle.is_some() {
            return &self.few;
        }
        let is_cut = || self.horizon(point) != Horizon::Above;
        if resolved || matches!(seen, Visibility::Part(_)) || !self.soft && is_cut() {
            &self.nodes
        } else {
            &self.few
        }
    }

    pub(super) fn horizon(&self, point: &ShadingPoint) -> Horizon {
        let (axis, falloff, _) = self.towards(self.axis, point.position);
        let height = axis.dot(point.normal).min(axis.dot(point.face_normal));
        let reach = match self.near {
            None => self.sine,
            Some(_) => sine(self.reach_from(falloff)),
        };
        if height > reach {
            Horizon::Above
        } else if height < -reach {
            Horizon::Below
        } else {
            Horizon::Across
        }
    }
}

/// What a group of nodes is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// A lamp, whose shadows have edges.
    Lamp,
    /// A patch of an environment, of which a point sees a fraction that varies smoothly.
    Environment,
    /// A patch of a wide lamp, the same, and one of so many beside each other that one ray does for a small one, and one direction
    /// for its irradiance.
    Patch,
}

/// Where a lamp is as seen from a point.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Horizon {
    Above,
    Across,
    Below,
}

/// The sine of an angular radius, 1 where that is more than a right angle.
fn sine(reach: f32) -> f32 {
    reach.min(std::f32::consts::FRAC_PI_2).sin()
}

/// The nodes furthest out in four directions around the axis, and the innermost.
fn extremal(directions: &[Vec3], axis: Vec3) -> Vec<usize> {
    let (tangent, bitangent) = axis.any_orthonormal_pair();
    let furthest = |score: &dyn Fn(Vec3) -> f32| {
        (0..directions.len()).max_by(|&a, &b| score(directions[a]).total_cmp(&score(directions[b])))
    };
    let mut probes: Vec<usize> = (0..4)
        .filter_map(|k| {
            let (sin, cos) = (k as f32 * std::f32::consts::FRAC_PI_2).sin_cos();
            furthest(&|d| d.dot(tangent * cos + bitangent * sin))
        })
        .collect();
    probes.extend(innermost(directions, axis));
    probes
}

/// A few of so many nodes in a row, each in the middle of a part of it.
fn spread(nodes: usize) -> Vec<usize> {
    let count = SOFT_RAYS.min(nodes);
    let middle = |i: usize| (2 * i + 1) * nodes / (2 * count);
    (0..count).map(middle).collect()
}

/// The node nearest to the axis.
fn innermost(directions: &[Vec3], axis: Vec3) -> Option<usize> {
    let towards = |k: usize| directions[k].dot(axis);
    (0..directions.len()).max_by(|&a, &b| towards(a).total_cmp(&towards(b)))
}

/// Nodes spread as far apart as they can be, the next always furthest from those before, and for every node the three
/// nearest of them.
fn scouts(directions: &[Vec3]) -> (Vec<usize>, Vec<[u8; 3]>) {
    let mut scouts = vec![0];
    let mut distance: Vec<f32> = directions
        .iter()
        .map(|d| d.distance_squared(directions[0]))
        .collect();
    while scouts.len() < SCOUTS {
        let furthest = (0..distance.len())
            .max_by(|&a, &b| distance[a].total_cmp(&distance[b]))
            .unwrap_or(0);
        scouts.push(furthest);
        for (d, direction) in distance.iter_mut().zip(directions) {
            *d = d.min(direction.distance_squared(directions[furthest]));
        }
    }
    let among = directions
        .iter()
        .map(|direction| {
            let mut order: Vec<u8> = (0..SCOUTS as u8).collect();
            let away = |s: u8| directions[scouts[usize::from(s)]].distance_squared(*direction);
            order.sort_by(|&a, &b| away(a).total_cmp(&away(b)));
            [order[0], order[1], order[2]]
        })
        .collect();
    (scouts, among)
}

/// Seven directions with their fluxes that have the nodes' flux, mean, covariance and, as a uniform ellipse of that
/// covariance has them, the moments up to the fifth (Abramowitz and Stegun, 25.4.61).
fn stand_ins(nodes: &[&LightNode], axis: Vec3) -> Vec<(Vec3, Vec3)> {
    let (mut total, mut weights) = (Vec3::ZERO, 0.0);
    let (tangent, bitangent) = axis.any_orthonormal_pair();
    let (mut mean, mut square) = (Vec2::ZERO, Mat2::ZERO);
    for node in nodes {
        let weight = node.flux().element_sum();
        let at = Vec2::new(node.direction.dot(tangent), node.direction.dot(bitangent));
        total += node.flux();
        weights += weight;
        mean += weight * at;
        square += Mat2::from_cols(at * at.x, at * at.y) * weight;
    }
    let weights = weights.max(f32::MIN_POSITIVE);
    mean /= weights;
    let square = square * (1.0 / weights);
    let (xx, xy, yy) = (
        square.x_axis.x - mean.x * mean.x,
        square.x_axis.y - mean.x * mean.y,
        square.y_axis.y - mean.y * mean.y,
    );
    // Any root of the covariance will do: Cholesky's.
    let across = xx.max(0.0).sqrt();
    let skew = if across > 0.0 { xy / across } else { 0.0 };
    let along = (yy - skew * skew).max(0.0).sqrt();
    let direction = |at: Vec2| {
        let at = mean + at;
        let height = (1.0 - at.length_squared()).max(0.0).sqrt();
        (tangent * at.x + bitangent * at.y + axis * height).normalize_or(axis)
    };
    // A uniform disc's standard deviation is half its radius.
    let ring = 2.0 * (2.0_f32 / 3.0).sqrt();
    std::iter::once((direction(Vec2::ZERO), total * 0.25))
        .chain((0..6).map(|k| {
            let (sin, cos) = (k as f32 * std::f32::consts::FRAC_PI_3).sin_cos();
            let at = ring * Vec2::new(across * cos, skew * cos + along * sin);
            (direction(at), total * 0.125)
        }))
        .collect()
}
