//! What the surface sends to itself, live: interreflected irradiance at every vertex as a function of where light comes from.
//!
//! Interreflection is linear in the light and smooth in its direction. So light from directions all around is bounced by the
//! reference renderer's own radiosity, and what arrives at a vertex is projected on the nine spherical harmonics up to the second
//! order: E(x) = Σ_k T_k(x) L_k, with L_k the light's own coefficients (Sloan, Kautz and Snyder 2002). Near lamps count as distant
//! ones in the direction that they have from the object's centre; light from everywhere alike has a coefficient of its own.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use serde_json::{Value, json};

use super::page::Page;
use rekindle_base::math::GOLDEN_ANGLE;
use rekindle_relight::{Interreflection, LampNodes, LightNode, Lighting, Shader, Stop};
use rekindle_scene::surface::Occluder;
use rekindle_solution::Solution;

/// Directions that light is bounced from.
const DIRECTIONS: usize = 64;
/// Coefficients: nine harmonics, and light from everywhere.
const COEFFICIENTS: usize = 10;

/// T of every vertex.
pub(super) struct Transfer {
    /// Vertex by vertex.
    coefficients: Vec<[Vec3; COEFFICIENTS]>,
}

impl Transfer {
    /// Bounces the light. `None` where the model leaves open how strong interreflection is, or where it was stopped.
    pub(super) fn new(
        solution: &Solution,
        occluder: &Occluder,
        stop: Stop,
        progress: &mut dyn FnMut(f32),
    ) -> Option<Self> {
        let mesh = &solution.mesh;
        let around = Interreflection::new(mesh, occluder, solution.brdf)?;
        let dark = solution.lighting().dark();
        let corners = corner_of_each_vertex(&mesh.triangles, mesh.positions.len());
        let mut coefficients = vec![[Vec3::ZERO; COEFFICIENTS]; mesh.positions.len()];
        let mut add = |lighting: &Lighting, weights: &[f32; COEFFICIENTS]| {
            let shader = Shader::new(occluder, solution.brdf, lighting);
            let relit = around.of_light(mesh, &shader, &solution.atlas, &solution.albedo);
            for (own, corner) in coefficients.iter_mut().zip(&corners) {
                let Some((triangle, barycentric)) = *corner else {
                    continue;
                };
                let arrived = relit.indirect.at(mesh, triangle, barycentric);
                for (own, weight) in own.iter_mut().zip(weights) {
                    *own += arrived * *weight;
                }
            }
        };
        for i in 0..DIRECTIONS {
            if stop() {
                return None;
            }
            progress(i as f32 / DIRECTIONS as f32);
            let direction = spiral(i);
            let mut weights = [0.0; COEFFICIENTS];
            for (weight, y) in weights.iter_mut().zip(harmonics(direction)) {
                *weight = y * 4.0 * PI / DIRECTIONS as f32;
            }
            add(&unit_light(&dark, direction), &weights);
        }
        let everywhere = Lighting {
            ambient: Vec3::ONE,
            ..dark
        };
        let mut last = [0.0; COEFFICIENTS];
        last[COEFFICIENTS - 1] = 1.0;
        add(&everywhere, &last);
        Some(Self { coefficients })
    }

    /// Irradiance by way of the surface at a vertex, as the page's shader adds it up.
    #[cfg(test)]
    pub(super) fn irradiance(&self, vertex: usize, lighting: &Lighting) -> Vec3 {
        let mut sum = self.coefficients[vertex][COEFFICIENTS - 1] * lighting.ambient;
        for lamp in &lighting.lamps {
            for (t, y) in self.coefficients[vertex]
                .iter()
                .zip(harmonics(lamp.direction))
            {
                sum += *t * y * lamp.flux();
            }
        }
        sum
    }

    /// Puts T into the page in bytes; the largest value of each coefficient, which is the byte ±127.
    pub(super) fn put(&self, page: &mut Page) -> Value {
        let scales: [f32; COEFFICIENTS] = std::array::from_fn(|k| {
            let values = self
                .coefficients
                .iter()
                .map(|own| own[k].abs().max_element());
            values.fold(f32::MIN_POSITIVE, f32::max)
        });
        let byte = |value: f32, scale: f32| (value / scale * 127.0).round() as i8 as u8;
        // Coefficient by coefficient, as those of neighbours are alike.
        let bytes: Vec<u8> = (0..COEFFICIENTS)
            .flat_map(|k| (0..3).map(move |channel| (k, channel)))
            .flat_map(|(k, channel)| {
                (self.coefficients.iter()).map(move |own| byte(own[k][channel], scales[k]))
            })
            .collect();
        page.pack("transfer", &bytes);
        json!({ "scales": scales })
    }
}

/// A light of unit flux.
fn unit_light(dark: &Lighting, direction: Vec3) -> Lighting {
    let node = LightNode {
        direction,
        radiance: Vec3::ONE,
        solid_angle: 1.0,
    };
    Lighting {
        lamps: LampNodes::new(vec![node], None).into_iter().collect(),
        ..dark.clone()
    }
}

/// Directions spread evenly over the sphere.
fn spiral(i: usize) -> Vec3 {
    let height = 1.0 - 2.0 * (i as f32 + 0.5) / DIRECTIONS as f32;
    let across = (1.0 - height * height).max(0.0).sqrt();
    let (sin, cos) = (i as f32 * GOLDEN_ANGLE % TAU).sin_cos();
    Vec3::new(across * cos, height, across * sin)
}

/// Real spherical harmonics up to the second order, orthonormal; the page's script has the same.
fn harmonics(Vec3 { x, y, z }: Vec3) -> [f32; 9] {
    [
        0.282_094_8,
        0.488_602_5 * y,
        0.488_602_5 * z,
        0.488_602_5 * x,
        1.092_548_4 * x * y,
        1.092_548_4 * y * z,
        0.315_391_57 * (3.0 * z * z - 1.0),
        1.092_548_4 * x * z,
        0.546_274_2 * (x * x - y * y),
    ]
}

/// A triangle that each vertex belongs to, and where in it.
fn corner_of_each_vertex(triangles: &[[u32; 3]], vertices: usize) -> Vec<Option<(u32, Vec2)>> {
    let mut corners = vec![None; vertices];
    for (t, triangle) in triangles.iter().enumerate() {
        for (vertex, barycentric) in triangle.iter().zip([Vec2::ZERO, Vec2::X, Vec2::Y]) {
            corners[*vertex as usize] = Some((t as u32, barycentric));
        }
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_are_orthonormal_over_the_directions() {
        for a in 0..9 {
            for b in 0..9 {
                let sum: f32 = (0..DIRECTIONS)
                    .map(|i| harmonics(spiral(i))[a] * harmonics(spiral(i))[b])
                    .sum();
                let product = sum * 4.0 * PI / DIRECTIONS as f32;
                let expected = f32::from(u8::from(a == b));
                assert!((product - expected).abs() < 0.02, "{a}, {b}: {product}");
            }
        }
    }
}
