//! The object's surface as a triangle mesh.

use glam::{DMat3, DMat4, DVec2, DVec3, Vec2, Vec3};
use rayon::prelude::*;

/// Triangles over shared vertices. Corners that differ in normal or texture coordinate are distinct vertices.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Where the positions' zero lies in the world: zero but for an object far from the world's own, as surveyed ones are,
    /// whose positions would lose digits.
    pub origin: DVec3,
    /// One position per vertex, from the origin.
    pub positions: Vec<Vec3>,
    /// One unit shading normal per vertex.
    pub normals: Vec<Vec3>,
    /// One texture coordinate per vertex (v upwards, as in OBJ), or empty if the mesh has none.
    pub uvs: Vec<Vec2>,
    /// Three vertex indices per triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// A point on the mesh.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// World position.
    pub position: Vec3,
    /// Unit shading normal: the vertex normals interpolated.
    pub normal: Vec3,
}

/// What becomes of normals where a surface is moved by an affine transform.
pub(super) fn normals_moved_by(transform: &DMat4) -> impl Fn(Vec3) -> Vec3 {
    let to_normal = DMat3::from_mat4(*transform).inverse().transpose();
    move |normal| {
        (to_normal * normal.as_dvec3())
            .normalize_or_zero()
            .as_vec3()
    }
}

impl Mesh {
    /// Smallest and largest coordinates over all vertices that triangles use.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.triangles.iter().flatten().fold(
            (Vec3::INFINITY, Vec3::NEG_INFINITY),
            |(lo, hi), &v| {
                let p = self.positions[v as usize];
                (lo.min(p), hi.max(p))
            },
        )
    }

    /// The object's centre: the centre of the bounding box, from which light directions are measured.
    pub fn centre(&self) -> Vec3 {
        let (lo, hi) = self.bounds();
        (lo + hi) * 0.5
    }

    /// Length of the bounding box's diagonal.
    pub fn diagonal(&self) -> f32 {
        let (lo, hi) = self.bounds();
        (hi - lo).length()
    }

    /// The three corner positions of a triangle.
    pub fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }

    /// Normal of a triangle's plane, unit or zero for a degenerate one.
    pub fn face_normal(&self, triangle: u32) -> Vec3 {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// A point on the mesh as the world has it.
    pub fn in_world(&self, point: Vec3) -> DVec3 {
        self.origin + point.as_dvec3()
    }

    /// A transform about the mesh's origin as one of the world.
    pub fn world_transform(&self, transform: &DMat4) -> DMat4 {
        let away = DMat4::from_translation(self.origin);
        let back = DMat4::from_translation(-self.origin);
        away * *transform * back
    }

    /// The mesh moved by an affine transform about its origin, which is not to mirror.
    #[must_use]
    pub fn transformed(&self, transform: &DMat4) -> Self {
        let turned = normals_moved_by(transform);
        Self {
            origin: self.origin,
            positions: (self.positions.iter())
                .map(|p| transform.transform_point3(p.as_dvec3()).as_vec3())
                .collect(),
            normals: self.normals.iter().map(|&n| turned(n)).collect(),
            uvs: self.uvs.clone(),
            triangles: self.triangles.clone(),
        }
    }

    /// For every vertex the number of its place, counted from 0: vertices at exactly one position have one place, whatever
    /// their normals and texture coordinates.
    pub fn places(&self) -> Vec<u32> {
        // Adding zero turns −0 into +0.
        let key = |v: u32| {
            (self.positions[v as usize] + Vec3::ZERO)
                .to_array()
                .map(f32::to_bits)
        };
        let mut order: Vec<u32> = (0..self.positions.len() as u32).collect();
        order.par_sort_unstable_by_key(|&v| (key(v), v));
        let mut places = vec![0; order.len()];
        for (place, same) in order.chunk_by(|&a, &b| key(a) == key(b)).enumerate() {
            for &v in same {
                places[v as usize] = place as u32;
            }
        }
        places
    }

    /// About `count` places spread evenly over the surface's area: triangles, and weights of the second and third corner.
    pub fn spread(&self, count: usize) -> Vec<(u32, Vec2)> {
        let area = |t: usize| {
            let [a, b, c] = self.corners(t as u32).map(Vec3::as_dvec3);
            (b - a).cross(c - a).length()
        };
        let areas: Vec<f64> = (0..self.triangles.len()).map(area).collect();
        let step = areas.iter().sum::<f64>() / count as f64;
        let mut places = Vec::with_capacity(count + 1);
        let mut owed = 0.5;
        for (triangle, area) in areas.iter().enumerate() {
            owed += area / step;
            while owed >= 1.0 {
                owed -= 1.0;
                // Roberts' R2 sequence, folded into the triangle.
                let k = places.len() as f64;
                let at = DVec2::new(
                    (0.5 + 0.754_877_666 * k).fract(),
                    (0.5 + 0.569_840_291 * k).fract(),
                );
                let folded = if at.x + at.y > 1.0 { 1.0 - at } else { at };
                places.push((triangle as u32, folded.as_vec2()));
            }
        }
        places
    }

    /// Position and shading normal at barycentric weights `(b1, b2)` of the second and third corner.
    pub fn point(&self, triangle: u32, barycentric: Vec2) -> SurfacePoint {
        let weights = [
            1.0 - barycentric.x - barycentric.y,
            barycentric.x,
            barycentric.y,
        ];
        let mut position = Vec3::ZERO;
        let mut normal = Vec3::ZERO;
        for (&v, w) in self.triangles[triangle as usize].iter().zip(weights) {
            position += w * self.positions[v as usize];
            normal += w * self.normals[v as usize];
        }
        SurfacePoint {
            position,
            normal: normal
                .try_normalize()
                .unwrap_or_else(|| self.face_normal(triangle)),
        }
    }
}
