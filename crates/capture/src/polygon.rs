//! Cutting polygons into triangles.

use earcut::Earcut;
use glam::{DVec2, DVec3};

/// Most corners of a convex polygon that becomes a fan. The long triangles of a larger one would all lie on each other's
/// bounds, and every ray at one of them would try them all: it is halved instead.
const MOST_FANNED: usize = 64;

/// Appends the triangles of a polygon to `out`, keeping its winding. `corners` are vertex indices, at
/// least three. Concave polygons, and large ones with corners in a line, are cut by ears in the plane of their mean normal
/// (Newell's).
pub(super) fn triangulate(corners: &[u32], positions: &[DVec3], out: &mut Vec<[u32; 3]>) {
    if let &[a, b, c] = corners {
        out.push([a, b, c]);
        return;
    }
    let points: Vec<DVec3> = corners.iter().map(|&v| positions[v as usize]).collect();
    let mut normal = DVec3::ZERO;
    for (i, p) in points.iter().enumerate() {
        normal += (*p - points[0]).cross(points[(i + 1) % points.len()] - points[0]);
    }
    let Some(normal) = normal.try_normalize() else {
        fan(corners, out);
        return;
    };
    let (x, y) = normal.any_orthonormal_pair();
    let flat: Vec<DVec2> = points
        .iter()
        .map(|p| DVec2::new((*p - points[0]).dot(x), (*p - points[0]).dot(y)))
        .collect();
    let orientation = normal.dot(x.cross(y)).signum();
    let turn = |i: usize, j: usize, k: usize| {
        orientation * (flat[j] - flat[i]).perp_dot(flat[k] - flat[i])
    };
    let count = corners.len();
    let turns = || (0..count).map(|i| turn(i, (i + 1) % count, (i + 2) % count));
    if count <= MOST_FANNED && turns().all(|turn| turn >= 0.0) {
        fan(corners, out);
        return;
    }
    if turns().all(|turn| turn > 0.0) && winds_once(&flat) {
        halve(corners, out);
        return;
    }
    let mut ears: Vec<u32> = Vec::with_capacity(3 * count);
    let plane = flat.iter().map(DVec2::to_array);
    Earcut::new().earcut(plane, &[], &mut ears);
    for ear in ears.chunks_exact(3) {
        let [a, b, c] = [ear[0], ear[1], ear[2]].map(|k| k as usize);
        let [b, c] = if turn(a, b, c) < 0.0 { [c, b] } else { [b, c] };
        out.push([corners[a], corners[b], corners[c]]);
    }
}

fn fan(corners: &[u32], out: &mut Vec<[u32; 3]>) {
    for pair in corners[1..].windows(2) {
        out.push([corners[0], pair[0], pair[1]]);
    }
}

/// Whether the polygon, all of whose turns go one way, goes around once and so crosses itself nowhere.
fn winds_once(flat: &[DVec2]) -> bool {
    let edges = || (0..flat.len()).map(|i| flat[(i + 1) % flat.len()] - flat[i]);
    let next = edges().cycle().skip(1);
    let turned: f64 = edges().zip(next).map(|(a, b)| a.angle_to(b)).sum();
    turned.abs() < 1.5 * std::f64::consts::TAU
}

/// The triangles between a convex chain of corners and the straight line between its ends: one to the corner in the
/// middle, and those of both halves.
fn halve(chain: &[u32], out: &mut Vec<[u32; 3]>) {
    if chain.len() < 3 {
        return;
    }
    let middle = chain.len() / 2;
    out.push([chain[0], chain[middle], chain[chain.len() - 1]]);
    halve(&chain[..=middle], out);
    halve(&chain[middle..], out);
}
