//! The mesh that a capture states, where it isn't the photographed surface itself.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::object::Object;
use super::recipe::{GeometryErrors, Normals};
use super::tessellate::tessellate;
use rekindle_base::math::random::Random;
use rekindle_capture::Mesh;
use rekindle_scene::surface::area_vectors;

/// The stated mesh; `None` where it is the true one.
pub(super) fn stated_mesh(
    object: Object,
    truth: &Mesh,
    errors: &GeometryErrors,
    random: Random,
) -> Option<Mesh> {
    let sound = errors.vertex_noise == 0.0
        && errors.triangles.is_none()
        && errors.normals == Normals::Exact
        && errors.normal_noise == 0.0;
    if sound {
        return None;
    }
    let mut mesh = match errors.triangles {
        Some(triangles) => tessellate(object, triangles),
        None => truth.clone(),
    };
    let amplitude = errors.vertex_noise * truth.diagonal();
    let (places, tilts) = (random.of(0), random.of(1));
    for (i, (position, normal)) in mesh.positions.iter_mut().zip(&mesh.normals).enumerate() {
        *position += *normal * (amplitude * places.normal(i as u64) as f32);
    }
    if errors.normals == Normals::Faces {
        mesh.normals = face_normals(&mesh);
    }
    mesh.normals
        .par_iter_mut()
        .enumerate()
        .for_each(|(i, normal)| {
            let (tangent, bitangent) = normal.any_orthonormal_pair();
            let [x, y] =
                [0, 1].map(|k| errors.normal_noise * tilts.normal(2 * i as u64 + k) as f32);
            *normal = (*normal + tangent * x + bitangent * y).normalize_or(*normal);
        });
    Some(mesh)
}

/// Normals of the vertices from the triangles around them, by area.
fn face_normals(mesh: &Mesh) -> Vec<Vec3> {
    let positions: Vec<DVec3> = mesh.positions.iter().map(|p| p.as_dvec3()).collect();
    let triangles: Vec<[usize; 3]> = mesh
        .triangles
        .iter()
        .map(|t| t.map(|v| v as usize))
        .collect();
    area_vectors(&positions, &triangles)
        .iter()
        .zip(&mesh.normals)
        .map(|(sum, before)| sum.as_vec3().normalize_or(*before))
        .collect()
}
