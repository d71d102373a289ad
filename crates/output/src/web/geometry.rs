//! The surface in few bytes: positions and normals in 16-bit numbers, once per vertex of the mesh; texture coordinates once per
//! corner that has others.
//!
//! Numbers that differ little from those before are written as differences, low bytes apart from high ones: then they pack well.

use std::collections::HashMap;

use glam::{Vec2, Vec3};
use serde_json::{Value, json};

use super::page::Page;
use rekindle_capture::Mesh;

/// Largest 16-bit number.
const FULL: f32 = 65535.0;

/// The surface, as the page unpacks it.
pub(super) struct Geometry {
    /// Corner of the box that holds all positions, relative to the centre.
    low: Vec3,
    /// Its sides.
    size: Vec3,
    /// Per vertex of the mesh: its place in the box, then its normal on the octahedron; five lists one after the other.
    vertices: [Vec<u16>; 5],
    /// Per corner: its vertex.
    corner_vertices: Vec<u32>,
    /// Per corner: u, and v downwards.
    corner_uvs: [Vec<u16>; 2],
    /// Three corners for each triangle.
    triangles: Vec<u32>,
}

impl Geometry {
    /// The surface with each triangle's texture coordinates (v downwards, in [0, 1]), positions relative to `centre`.
    pub(super) fn new(mesh: &Mesh, corner_uvs: &[[Vec2; 3]], centre: Vec3) -> Self {
        let (low, high) = mesh.bounds();
        let size = (high - low).max(Vec3::splat(f32::MIN_POSITIVE));
        let mut vertices: [Vec<u16>; 5] = Default::default();
        for (&position, &normal) in mesh.positions.iter().zip(&mesh.normals) {
            let place = (position - low) / size;
            let facing = octahedral(normal);
            let numbers = [place.x, place.y, place.z, facing.x, facing.y];
            for (list, number) in vertices.iter_mut().zip(numbers) {
                list.push(quantised(number));
            }
        }
        let mut geometry = Self {
            low: low - centre,
            size,
            vertices,
            corner_vertices: Vec::new(),
            corner_uvs: Default::default(),
            triangles: Vec::new(),
        };
        let mut known: HashMap<(u32, [u16; 2]), u32> = HashMap::new();
        for (triangle, uvs) in mesh.triangles.iter().zip(corner_uvs) {
            for (&vertex, uv) in triangle.iter().zip(uvs) {
                let uv = uv.to_array().map(quantised);
                let corner = *known.entry((vertex, uv)).or_insert_with(|| {
                    geometry.corner_vertices.push(vertex);
                    geometry.corner_uvs[0].push(uv[0]);
                    geometry.corner_uvs[1].push(uv[1]);
                    geometry.corner_vertices.len() as u32 - 1
                });
                geometry.triangles.push(corner);
            }
        }
        geometry
    }

    /// Puts the numbers into the page; what it has to know of them.
    pub(super) fn put(&self, page: &mut Page) -> Value {
        let wide = |list: &[u32]| differences(list.iter().copied(), 4);
        let narrow = |list: &[u16]| differences(list.iter().map(|&n| u32::from(n)), 2);
        page.pack(
            "vertices",
            &self.vertices.each_ref().map(|list| narrow(list)).concat(),
        );
        page.pack("corner-vertices", &wide(&self.corner_vertices));
        page.pack(
            "corner-uvs",
            &self.corner_uvs.each_ref().map(|list| narrow(list)).concat(),
        );
        page.pack("triangles", &wide(&self.triangles));
        json!({
            "low": self.low.to_array(),
            "size": self.size.to_array(),
            "vertices": self.vertices[0].len(),
            "corners": self.corner_vertices.len(),
            "triangles": self.triangles.len() / 3,
        })
    }
}

/// A number from 0 to 1 in 16 bits.
fn quantised(number: f32) -> u16 {
    (number.clamp(0.0, 1.0) * FULL).round() as u16
}

/// A direction on the unfolded octahedron, each coordinate from 0 to 1 (Cigolle et al. 2014).
fn octahedral(direction: Vec3) -> Vec2 {
    let sum = direction.abs().element_sum().max(f32::MIN_POSITIVE);
    let flat = Vec2::new(direction.x, direction.y) / sum;
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    let folded = if direction.z < 0.0 {
        Vec2::new(
            (1.0 - flat.y.abs()) * sign(flat.x),
            (1.0 - flat.x.abs()) * sign(flat.y),
        )
    } else {
        flat
    };
    folded * 0.5 + 0.5
}

/// Each number's difference from the one before it, small ones of either sign as small numbers (zigzag), in so many bytes:
/// first all low bytes, then the next.
fn differences(numbers: impl Iterator<Item = u32> + Clone, bytes: usize) -> Vec<u8> {
    let bits = 8 * bytes as u32;
    let mut before = 0_u32;
    let steps: Vec<u32> = numbers
        .map(|number| {
            let step = (number.wrapping_sub(before) << (32 - bits)) as i32 >> (32 - bits);
            before = number;
            (step << 1 ^ step >> 31) as u32
        })
        .collect();
    (0..bytes)
        .flat_map(|byte| steps.iter().map(move |step| (step >> (8 * byte)) as u8))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the page's script does, in its words.
    fn undone(bytes: &[u8], width: usize) -> Vec<u32> {
        let count = bytes.len() / width;
        let mask = if width == 4 {
            u32::MAX
        } else {
            (1 << (8 * width)) - 1
        };
        let mut before = 0_u32;
        (0..count)
            .map(|i| {
                let step: u32 = (0..width)
                    .map(|byte| u32::from(bytes[byte * count + i]) << (8 * byte))
                    .sum();
                let signed = (step >> 1) ^ (step & 1).wrapping_neg();
                before = before.wrapping_add(signed) & mask;
                before
            })
            .collect()
    }

    #[test]
    fn differences_lead_back_to_the_numbers() {
        for (numbers, width) in [
            (vec![0_u32, 65535, 3, 3, 40_000, 1], 2),
            (vec![7, 0, 4_000_000_000, 12, 2_147_483_648], 4),
        ] {
            let packed = differences(numbers.iter().copied(), width);
            assert_eq!(packed.len(), width * numbers.len());
            assert_eq!(undone(&packed, width), numbers);
        }
    }

    #[test]
    fn normals_survive_the_octahedron() {
        for direction in [
            Vec3::Y,
            Vec3::NEG_Z,
            Vec3::new(-0.6, 0.0, -0.8),
            Vec3::new(0.36, -0.48, 0.8),
            Vec3::new(-0.48, -0.6, -0.64),
        ] {
            let at = octahedral(direction).to_array().map(quantised);
            let at = Vec2::from(at.map(|n| f32::from(n) / FULL)) * 2.0 - 1.0;
            let z = 1.0 - at.x.abs() - at.y.abs();
            let fold = (-z).max(0.0);
            let back = Vec3::new(at.x - fold * at.x.signum(), at.y - fold * at.y.signum(), z);
            assert!(
                back.normalize_or_zero().distance(direction) < 1e-4,
                "{direction}: {back}"
            );
        }
    }
}
