//! A mesh with no more triangles than pictures can tell apart.
//!
//! A scan has a hundred triangles where a picture has one pixel, each of them turned by the scanner's noise. What is finer
//! than the triangles that are left is smoothed away before (Taubin, "A signal processing approach to fair surface design",
//! 1995, which does not shrink the surface), or it would come back as noise of theirs; then edges are collapsed by the least
//! quadric error (Garland and Heckbert 1997, as `meshopt` does it).

use glam::DVec3;
use meshopt::{SimplifyOptions, VertexDataAdapter};

use super::fairing::area_vectors;
use rekindle_capture::Mesh;

/// Taubin's factors of a step towards the neighbours' mean and of the one back.
const FORWARD: f64 = 0.5;
const BACKWARD: f64 = -0.53;
/// Pairs of steps per triangle that becomes part of a coarser one.
const STEPS: f64 = 2.0;
/// And most of them.
const MOST_STEPS: f64 = 100.0;

/// About `count` triangles in place of more, without texture coordinates, each place one vertex; the same surface where it has
/// no more.
pub fn simplified(mesh: &Mesh, count: usize) -> Mesh {
    let (mut positions, mut triangles) = welded(mesh);
    if triangles.len() > count {
        let ratio = triangles.len() as f64 / count.max(1) as f64;
        let steps = (STEPS * ratio).min(MOST_STEPS) as usize;
        smooth(&mut positions, &triangles, steps);
        triangles = collapsed(&positions, &triangles, count);
    }
    compacted(mesh, &positions, &triangles)
}

/// Position of every place, and triangles of places without those that have two corners at one.
fn welded(mesh: &Mesh) -> (Vec<DVec3>, Vec<[usize; 3]>) {
    let place_of = mesh.places();
    let count = place_of.iter().max().map_or(0, |m| *m as usize + 1);
    let mut positions = vec![DVec3::ZERO; count];
    for (&place, position) in place_of.iter().zip(&mesh.positions) {
        positions[place as usize] = position.as_dvec3();
    }
    let places = |t: &[u32; 3]| t.map(|v| place_of[v as usize] as usize);
    let is_one = |t: &[usize; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
    let triangles = mesh.triangles.iter().map(places).filter(is_one).collect();
    (positions, triangles)
}

/// Pairs of Taubin's steps.
fn smooth(positions: &mut [DVec3], triangles: &[[usize; 3]], pairs: usize) {
    let mut sums = vec![(DVec3::ZERO, 0.0); positions.len()];
    for step in 0..2 * pairs {
        sums.fill((DVec3::ZERO, 0.0));
        for &[a, b, c] in triangles {
            for (i, j, l) in [(a, b, c), (b, c, a), (c, a, b)] {
                sums[i].0 += positions[j] + positions[l];
                sums[i].1 += 2.0;
            }
        }
        let factor = if step % 2 == 0 { FORWARD } else { BACKWARD };
        for (position, (sum, count)) in positions.iter_mut().zip(&sums) {
            if *count > 0.0 {
                *position += factor * (*sum / *count - *position);
            }
        }
    }
}

/// The triangles that are left once edges are collapsed.
fn collapsed(positions: &[DVec3], triangles: &[[usize; 3]], count: usize) -> Vec<[usize; 3]> {
    let vertices: Vec<[f32; 3]> = positions.iter().map(|p| p.as_vec3().to_array()).collect();
    let indices: Vec<u32> = triangles.as_flattened().iter().map(|&i| i as u32).collect();
    let bytes = bytemuck::cast_slice(&vertices);
    let Ok(adapter) = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0) else {
        return triangles.to_vec();
    };
    let options = SimplifyOptions::None;
    let left = meshopt::simplify(&indices, &adapter, 3 * count, 1.0, options, None);
    let left = left.chunks_exact(3);
    left.map(|t| [t[0] as usize, t[1] as usize, t[2] as usize])
        .collect()
}

/// A mesh of the places that triangles use, with normals to match.
fn compacted(of: &Mesh, positions: &[DVec3], triangles: &[[usize; 3]]) -> Mesh {
    let normals = area_vectors(positions, triangles);
    let mut vertex = vec![u32::MAX; positions.len()];
    let mut mesh = Mesh {
        origin: of.origin,
        ..Mesh::default()
    };
    for t in triangles {
        let corners = t.map(|place| {
            if vertex[place] == u32::MAX {
                vertex[place] = mesh.positions.len() as u32;
                mesh.positions.push(positions[place].as_vec3());
                let normal = normals[place].try_normalize().unwrap_or(DVec3::Y);
                mesh.normals.push(normal.as_vec3());
            }
            vertex[place]
        });
        mesh.triangles.push(corners);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::surface::fixtures::bumpy_sphere;

    #[test]
    fn a_noisy_scan_comes_out_smaller_and_with_better_normals() {
        let truth = |p: Vec3| p.normalize_or_zero();
        let mut scan = bumpy_sphere(120, 0.0);
        let noise = |i: usize| 2e-3 * ((i * i) as f32).sin();
        let place_of = scan.places();
        for (position, &place) in scan.positions.iter_mut().zip(&place_of) {
            *position *= 1.0 + noise(place as usize);
        }
        let raw = simplified(&scan, usize::MAX);
        let simple = simplified(&scan, 6_000);
        assert!(
            simple.triangles.len() <= 6_000,
            "{}",
            simple.triangles.len()
        );
        assert!(simple.triangles.len() > 5_000, "{}", simple.triangles.len());
        let error = |mesh: &Mesh| {
            let mut errors: Vec<f32> = (mesh.positions.iter().zip(&mesh.normals))
                .map(|(p, n)| n.angle_between(truth(*p)).to_degrees())
                .collect();
            errors.sort_by(f32::total_cmp);
            errors[errors.len() / 2]
        };
        let (before, after) = (error(&raw), error(&simple));
        assert!(after < 0.5 * before, "{before}° before, {after}° after");
        let away = |p: &Vec3| (p.length() - 1.0).abs();
        let furthest = simple.positions.iter().map(away).fold(0.0, f32::max);
        assert!(furthest < 4e-3, "a vertex lies {furthest} off the sphere");
    }

    #[test]
    fn a_mesh_with_few_triangles_stays_as_it_is() {
        let mesh = bumpy_sphere(10, 0.1);
        let same = simplified(&mesh, mesh.triangles.len());
        assert_eq!(same.triangles.len(), mesh.triangles.len());
        assert_eq!(same.bounds(), mesh.bounds());
    }
}
