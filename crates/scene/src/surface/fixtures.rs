//! Shapes and cameras that the tests of several rooms share.

use glam::{DAffine3, DMat3, DVec2, DVec3, Vec2, Vec3};

use rekindle_capture::{Camera, Distortion, Mesh};

/// A closed sphere of radius 1 with bumps of the given height, exact normals left to the faces' mean.
pub fn bumpy_sphere(rings: u32, bumps: f32) -> Mesh {
    let columns = 2 * rings;
    let mut mesh = Mesh::default();
    for i in 0..=rings {
        for j in 0..=columns {
            let (u, v) = (j as f32 / columns as f32, i as f32 / rings as f32);
            let theta = v * std::f32::consts::PI;
            let phi = (j % columns) as f32 / columns as f32 * std::f32::consts::TAU;
            let direction = Vec3::new(
                theta.sin() * phi.sin(),
                theta.cos(),
                theta.sin() * phi.cos(),
            );
            let radius = 1.0 + bumps * theta.sin() * (5.0 * phi).sin() * (6.0 * theta).sin();
            mesh.positions.push(radius * direction);
            mesh.uvs.push(Vec2::new(u, 1.0 - v));
        }
    }
    for i in 0..rings {
        for j in 0..columns {
            let a = i * (columns + 1) + j;
            let b = a + columns + 1;
            if i > 0 {
                mesh.triangles.push([a, b, a + 1]);
            }
            if i + 1 < rings {
                mesh.triangles.push([a + 1, b, b + 1]);
            }
        }
    }
    mesh.normals = vec![Vec3::ZERO; mesh.positions.len()];
    for &[a, b, c] in &mesh.triangles {
        let corners = [a, b, c].map(|v| mesh.positions[v as usize]);
        let n = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        for v in [a, b, c] {
            mesh.normals[v as usize] += n;
        }
    }
    for i in 0..=rings {
        let (a, b) = (i * (columns + 1), i * (columns + 1) + columns);
        let sum = mesh.normals[a as usize] + mesh.normals[b as usize];
        mesh.normals[a as usize] = sum;
        mesh.normals[b as usize] = sum;
    }
    for n in &mut mesh.normals {
        *n = n.normalize_or_zero();
    }
    mesh
}

/// A pinhole at `position` looking at `target`, with a focal length of `focal` image widths.
pub fn camera(position: DVec3, target: DVec3, width: u32, height: u32, focal: f64) -> Camera {
    let backward = (position - target).normalize_or_zero();
    let right = DVec3::Y.cross(backward).normalize_or_zero();
    Camera {
        width,
        height,
        focal: DVec2::splat(focal * f64::from(width)),
        centre: DVec2::new(f64::from(width), f64::from(height)) * 0.5,
        distortion: Distortion::default(),
        world_from_camera: DAffine3::from_mat3_translation(
            DMat3::from_cols(right, backward.cross(right), backward),
            position,
        ),
    }
}
