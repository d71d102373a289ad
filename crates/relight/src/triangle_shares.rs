//! How much of each lamp a triangle's corners see.
//!
//! Most triangles of a fine mesh are far smaller than a penumbra. Their corners say how much of each lamp they see, and
//! their centroids where not all around them see the same; between them that is linear. Where the four disagree, and on
//! larger triangles at a shadow's edge, nothing is said: whoever asks casts rays there.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::shading::{Shader, ShadingPoint, Visibility};
use rekindle_capture::Mesh;
use rekindle_scene::surface::Atlas;

/// Triangles of at most this many texels need no look at their centroid.
const TINY_TRIANGLE: u32 = 1;
/// Triangles of at most this many texels have their visibility interpolated …
const SMALL_TRIANGLE: u32 = 40;
/// … where a lamp's seen part differs between their corners by no more than this part of the most that is seen: in
/// the dark, where an albedo is the quotient of two small numbers, as in the light …
const MAX_SPREAD: f32 = 0.4;
/// … and between their centroid and the corners' mean by no more than this part.
const MAX_BEND: f32 = 0.12;
/// Triangles of at most this many texels are taken as all lit or all dark where they are so at their corners, at those
/// of the triangles around, in the middles of their edges and in the centre.
const LARGE_TRIANGLE: u32 = 256;
/// Light without sharp shadows is taken as linear between the corners also where no edge is longer than this part of the mesh's size …
const FINE_EDGE: f32 = 0.01;
/// … and so is its irradiance, where the normals' cosine is above this: within 0.8 % of one light's.
const FLAT_COS: f32 = 0.97;

/// Seen part of a lamp at a triangle's corners, if it is linear between them.
pub(super) type Shares = Option<[f32; 3]>;

/// Number of texels that belong to each triangle.
pub(super) fn texels_of_triangles(mesh: &Mesh, atlas: &Atlas) -> Vec<u32> {
    let mut texels = vec![0_u32; mesh.triangles.len()];
    for texel in atlas.texels.iter().filter(|t| !t.gutter) {
        texels[texel.triangle as usize] += 1;
    }
    texels
}

/// For every triangle and each lamp what its corners see of it.
pub struct TriangleShares {
    /// Nothing for triangles that are too large to tell; of fine ones the lamps with sharp shadows alone, of others all, sharp
    /// ones first.
    triangles: Vec<Option<Vec<Shares>>>,
    /// Triangles over which all is linear but what sharp shadows hide.
    fine: Vec<bool>,
    /// Place of each lamp in a list.
    places: Vec<usize>,
    /// Lamps with sharp shadows, and all lamps.
    sharp: Vec<usize>,
    all: Vec<usize>,
    /// What is seen from the vertices.
    vertices: Vec<AtVertex>,
    /// The vertices of each triangle.
    corners: Vec<[u32; 3]>,
}

/// What a vertex sees of the light.
#[derive(Default)]
struct AtVertex {
    normal: Vec3,
    /// Seen part of each lamp, nothing of those below; empty where nobody asks.
    shares: Vec<Option<f32>>,
    /// Irradiance by all lamps without sharp shadows.
    soft: Vec3,
}

impl AtVertex {
    fn new(mesh: &Mesh, vertex: usize, shader: &Shader, soft: &[usize]) -> Self {
        let point = ShadingPoint::smooth(mesh.positions[vertex], mesh.normals[vertex]);
        let shares = shader.seen_shares(&point);
        let seen = |&g: &usize| Some((g, Visibility::Fraction(shares[g]?)));
        Self {
            normal: point.normal,
            soft: shader.irradiance_by(&point, soft.iter().filter_map(seen)),
            shares,
        }
    }
}

impl TriangleShares {
    /// Looks from the corners of all triangles, and from their centroids where these do not agree.
    pub fn new(mesh: &Mesh, atlas: &Atlas, shader: &Shader) -> Self {
        let texels = texels_of_triangles(mesh, atlas);
        let tells = |t: usize| texels[t] <= LARGE_TRIANGLE;
        let longest = FINE_EDGE * mesh.diagonal();
        let is_fine = |t: usize| {
            texels[t] <= SMALL_TRIANGLE || {
                let [a, b, c] = mesh.corners(t as u32);
                a.distance(b).max(b.distance(c)).max(c.distance(a)) <= longest
            }
        };
        let fine: Vec<bool> = (0..mesh.triangles.len()).map(is_fine).collect();
        let mut needed = vec![false; mesh.positions.len()];
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            for &v in triangle {
                needed[v as usize] |= tells(t) || fine[t];
            }
        }
        let (sharp, soft): (Vec<usize>, Vec<usize>) =
            (0..shader.groups()).partition(|&g| shader.is_sharp(g));
        let vertices: Vec<AtVertex> = (0..mesh.positions.len())
            .into_par_iter()
            .map(|v| {
                if needed[v] {
                    AtVertex::new(mesh, v, shader, &soft)
                } else {
                    AtVertex::default()
                }
            })
            .collect();
        let listed = [&sharp[..], &soft].concat();
        let asked = if fine.iter().all(|&fine| fine) {
            &sharp
        } else {
            &listed
        };
        let plain = plain_surroundings(mesh, &vertices, asked);
        let looks = Looks {
            mesh,
            shader,
            vertices: &vertices,
        };
        let triangles = (0..mesh.triangles.len())
            .into_par_iter()
            .map(|t| {
                if !tells(t) {
                    return None;
                }
                let own = if fine[t] { &sharp } else { asked };
                let shares = own.iter().enumerate().map(|(place, &g)| {
                    let same = mesh.triangles[t].map(|v| plain[v as usize * asked.len() + place]);
                    looks.shares(t, g, texels[t], agreed(same))
                });
                Some(shares.collect())
            })
            .collect();
        let mut places = vec![0; shader.groups()];
        for (place, &group) in listed.iter().enumerate() {
            places[group] = place;
        }
        Self {
            triangles,
            fine,
            places,
            sharp,
            all: (0..shader.groups()).collect(),
            vertices,
            corners: mesh.triangles.clone(),
        }
    }

    /// What a triangle's corners see of a lamp, where it tells.
    pub(super) fn of(&self, triangle: u32, group: usize) -> Shares {
        let place = self.places[group];
        if self.fine[triangle as usize] && place >= self.sharp.len() {
            let seen = |v: u32| self.vertices[v as usize].shares[group];
            return Some(linear_alone(self.corners[triangle as usize].map(seen)));
        }
        self.triangles[triangle as usize].as_deref()?[place]
    }

    /// What a point of a triangle sees of a lamp, where its triangle tells.
    pub(super) fn told(
        &self,
        triangle: u32,
        barycentric: Vec2,
        group: usize,
    ) -> Option<Visibility> {
        let shares = self.of(triangle, group)?;
        Some(match between(shares, barycentric) {
            0.0 => Visibility::Hidden,
            1.0 => Visibility::Whole,
            share => Visibility::Fraction(share),
        })
    }

    /// Irradiance at a point of a triangle by lamps that need no look at it, and those that are left: all but the ones with
    /// sharp shadows are told by its corners where it is fine and hardly bent.
    pub(super) fn beforehand(&self, triangle: u32, barycentric: Vec2) -> (Vec3, &[usize]) {
        let corners = self.corners[triangle as usize].map(|v| &self.vertices[v as usize]);
        let [a, b, c] = corners.map(|at| at.normal);
        let is_flat = a.dot(b).min(b.dot(c)).min(c.dot(a)) >= FLAT_COS;
        if !is_flat || !self.fine[triangle as usize] {
            return (Vec3::ZERO, &self.all);
        }
        let [a, b, c] = corners.map(|at| at.soft);
        let soft = a + barycentric.x * (b - a) + barycentric.y * (c - a);
        (soft.max(Vec3::ZERO), &self.sharp)
    }
}

/// What triangles are looked at with.
struct Looks<'a> {
    mesh: &'a Mesh,
    shader: &'a Shader<'a>,
    vertices: &'a [AtVertex],
}

impl Looks<'_> {
    fn at_corners(&self, triangle: usize, group: usize) -> [Option<f32>; 3] {
        self.mesh.triangles[triangle].map(|v| self.vertices[v as usize].shares[group])
    }

    /// What a triangle of so many texels sees of a lamp; `agreed` is what all about its corners see of it, if that is the same.
    fn shares(&self, triangle: usize, group: usize, texels: u32, agreed: Option<f32>) -> Shares {
        if texels <= TINY_TRIANGLE {
            return Some(linear_alone(self.at_corners(triangle, group)));
        }
        let seen = |at: Vec2| {
            let point = ShadingPoint::on(self.mesh, triangle as u32, at);
            self.shader.seen_share(&point, group)
        };
        let centroid = Vec2::splat(1.0 / 3.0);
        if texels <= SMALL_TRIANGLE {
            return match agreed {
                Some(share) => Some([share; 3]),
                None => linear(self.at_corners(triangle, group), seen(centroid)),
            };
        }
        let inside = [centroid, Vec2::X * 0.5, Vec2::Y * 0.5, Vec2::splat(0.5)];
        agreed
            .filter(|_| inside.iter().all(|&at| seen(at) == agreed))
            .map(|share| [share; 3])
    }
}

/// Whether all or nothing is seen of a lamp.
fn is_plain(share: &f32) -> bool {
    *share == 0.0 || *share == 1.0
}

/// What all three say.
fn agreed([a, b, c]: [Option<f32>; 3]) -> Option<f32> {
    a.filter(|_| a == b && a == c)
}

/// For every vertex and each of some lamps: 0 or 1 where it and all vertices around it see none or all of the lamp.
fn plain_surroundings(mesh: &Mesh, vertices: &[AtVertex], groups: &[usize]) -> Vec<Option<f32>> {
    let share = |v: usize, place: usize| -> Option<f32> {
        *vertices[v].shares.get(groups[place]).unwrap_or(&None)
    };
    let count = groups.len();
    let mut plain: Vec<Option<f32>> = (0..mesh.positions.len() * count)
        .map(|i| share(i / count, i % count).filter(is_plain))
        .collect();
    for triangle in &mesh.triangles {
        for place in 0..count {
            let [a, b, c] = triangle.map(|v| share(v as usize, place));
            if a != b || b != c {
                for &v in triangle {
                    plain[v as usize * count + place] = None;
                }
            }
        }
    }
    plain
}

/// The corners' shares if they are linear over the triangle. A corner that the lamp is below takes what the centroid
/// sees: light is grazing there and hardly counts.
fn linear(corners: [Option<f32>; 3], centre: Option<f32>) -> Shares {
    let Some(at_centre) = centre else {
        let dark = corners.iter().all(|c| c.is_none_or(|share| share == 0.0));
        return dark.then_some([0.0; 3]);
    };
    let corners = corners.map(|c| c.unwrap_or(at_centre));
    let highest = corners.into_iter().fold(at_centre, f32::max);
    let lowest = corners.into_iter().fold(at_centre, f32::min);
    let mean = corners.iter().sum::<f32>() / 3.0;
    (highest - lowest <= MAX_SPREAD * highest && (mean - at_centre).abs() <= MAX_BEND * highest)
        .then_some(corners)
}

/// The corners' shares of a triangle that is no larger than a texel: nothing finer shows.
fn linear_alone(corners: [Option<f32>; 3]) -> [f32; 3] {
    let known = || corners.into_iter().flatten();
    let mean = known().sum::<f32>() / known().count().max(1) as f32;
    corners.map(|c| c.unwrap_or(mean))
}

/// A share at barycentric weights, given those at the corners.
pub(super) fn between([a, b, c]: [f32; 3], at: Vec2) -> f32 {
    (a + at.x * (b - a) + at.y * (c - a)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shadows_edge_is_not_taken_for_a_ramp() {
        let whole = Some(1.0);
        assert_eq!(linear([whole; 3], whole), Some([1.0; 3]));
        assert_eq!(
            linear([whole, whole, Some(0.0)], Some(0.66)),
            None,
            "a sharp edge"
        );
        assert_eq!(
            linear([whole; 3], Some(0.0)),
            None,
            "a thin shadow across the middle"
        );
        assert_eq!(
            linear([Some(0.5), Some(0.6), Some(0.7)], Some(0.6)),
            Some([0.5, 0.6, 0.7])
        );
        assert_eq!(linear([None; 3], None), Some([0.0; 3]), "the lamp is below");
        assert_eq!(linear([None, whole, whole], whole), Some([1.0; 3]));
    }
}
