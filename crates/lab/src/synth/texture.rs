//! A solid texture: the albedo of every point in space.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use rekindle_base::math::random::Random;
use rekindle_capture::Mesh;
use rekindle_scene::surface::Atlas;

/// Albedo of a surface without contrast.
const BASE: Vec3 = Vec3::new(0.45, 0.4, 0.36);
/// The part of the base by which it changes at full contrast.
const SWING: f32 = 0.92;
/// Patches along a unit of length, and those of the finer pattern on them.
const PATCHES: f32 = 3.0;
const DETAIL: f32 = 14.0;

/// The albedo of an object.
#[derive(Clone, Copy)]
pub(super) struct Texture {
    contrast: f32,
    random: Random,
}

impl Texture {
    pub(super) fn new(contrast: f32, random: Random) -> Self {
        Self { contrast, random }
    }

    /// Albedo, RGB in (0, 1).
    pub(super) fn albedo(&self, p: Vec3) -> Vec3 {
        let patches = self.noise(p * PATCHES, 0);
        // Edges between patches, not a gradient.
        let edge = (8.0 * (patches - 0.5)).tanh();
        let hue = Vec3::new(
            self.noise(p * PATCHES, 1),
            self.noise(p * PATCHES, 2),
            self.noise(p * PATCHES, 3),
        ) - 0.5;
        let detail = self.noise(p * DETAIL, 4) - 0.5;
        let pattern = (Vec3::splat(0.6 * edge + 0.6 * detail) + hue).clamp(-Vec3::ONE, Vec3::ONE);
        BASE * (1.0 + self.contrast * SWING * pattern)
    }

    /// The albedo of every texel.
    pub(super) fn bake(&self, mesh: &Mesh, atlas: &Atlas) -> Vec<[f32; 3]> {
        let values: Vec<[f32; 3]> = atlas
            .texels
            .par_iter()
            .map(|texel| {
                let point = mesh.point(texel.triangle, texel.barycentric);
                self.albedo(point.position).to_array()
            })
            .collect();
        let mut baked = vec![[0.0; 3]; atlas.len()];
        for (texel, value) in atlas.texels.iter().zip(values) {
            baked[texel.index as usize] = value;
        }
        atlas.extend(&mut baked);
        baked
    }

    /// Value noise: smooth between random values in [0, 1] at the lattice's points.
    fn noise(&self, p: Vec3, channel: u64) -> f32 {
        let (cell, random) = (p.floor().as_ivec3(), self.random.of(channel));
        let at = p - p.floor();
        let smooth = at * at * (3.0 - 2.0 * at);
        let mut sum = 0.0;
        for corner in 0..8 {
            let bits = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let weights = Vec3::select(bits.cmpeq(IVec3::ONE), smooth, 1.0 - smooth);
            sum += weights.element_product() * random.uniform(key(cell + bits)) as f32;
        }
        sum
    }
}

/// A number for a lattice point, another for every one within a million of the origin.
fn key(cell: IVec3) -> u64 {
    cell.to_array()
        .into_iter()
        .fold(0, |key, c| key << 21 | (i64::from(c) + (1 << 20)) as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Smallest and largest mean albedo on a walk through space.
    fn range(contrast: f32) -> [f32; 2] {
        let texture = Texture::new(contrast, Random::new(1, 2));
        (0..4000).fold([f32::INFINITY, 0.0], |[low, high], i| {
            let t = i as f32;
            let p = Vec3::new((0.1 * t).sin(), (0.037 * t).cos(), (0.0071 * t).sin());
            let albedo = texture.albedo(p);
            assert!(albedo.min_element() > 0.0 && albedo.max_element() < 1.0);
            let mean = albedo.element_sum() / 3.0;
            [low.min(mean), high.max(mean)]
        })
    }

    #[test]
    fn contrast_goes_from_none_to_nearly_all() {
        let [low, high] = range(0.0);
        assert_eq!(low, high);
        for contrast in [0.3, 0.6, 1.0] {
            let [low, high] = range(contrast);
            let expected = (1.0 + SWING * contrast) / (1.0 - SWING * contrast);
            let part = high / low / expected;
            assert!(
                (0.8..1.001).contains(&part),
                "{contrast}: {part} of {expected}"
            );
        }
    }
}
