//! Cutting polygons into triangles.

use glam::{DVec2, DVec3, Vec3};

/// Appends the triangles of a polygon to `out`, keeping its winding. `corners` are vertex indices, at
/// least three. Concave polygons are cut by ears in the plane of their mean normal (Newell's).
pub(super) fn triangulate(corners: &[u32], positions: &[Vec3], out: &mut Vec<[u32; 3]>) {
    if let &[a, b, c] = corners {
        out.push([a, b, c]);
        return;
    }
    let points: Vec<DVec3> = corners
        .iter()
        .map(|&v| positions[v as usize].as_dvec3())
        .collect();
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
        .map(|p| DVec2::new(p.dot(x), p.dot(y)))
        .collect();
    let orientation = normal.dot(x.cross(y)).signum();
    let turn = |i: usize, j: usize, k: usize| {
        orientation * (flat[j] - flat[i]).perp_dot(flat[k] - flat[i])
    };
    let count = corners.len();
    let convex = (0..count).all(|i| turn(i, (i + 1) % count, (i + 2) % count) >= 0.0);
    // Clipping ears takes quadratic time: beyond any modeller's polygon a fan has to do.
    if convex || count > 1000 {
        fan(corners, out);
        return;
    }
    let mut left: Vec<usize> = (0..count).collect();
    while left.len() > 3 {
        let n = left.len();
        let ear = (0..n).find(|&i| {
            let (a, b, c) = (left[(i + n - 1) % n], left[i], left[(i + 1) % n]);
            turn(a, b, c) > 0.0
                && left
                    .iter()
                    .filter(|&&p| p != a && p != b && p != c)
                    .all(|&p| turn(a, b, p) < 0.0 || turn(b, c, p) < 0.0 || turn(c, a, p) < 0.0)
        });
        // A polygon that crosses itself has no ear: cut anywhere.
        let i = ear.unwrap_or(0);
        out.push([left[(i + n - 1) % n], left[i], left[(i + 1) % n]].map(|k| corners[k]));
        left.remove(i);
    }
    out.push([corners[left[0]], corners[left[1]], corners[left[2]]]);
}

fn fan(corners: &[u32], out: &mut Vec<[u32; 3]>) {
    for pair in corners[1..].windows(2) {
        out.push([corners[0], pair[0], pair[1]]);
    }
}
