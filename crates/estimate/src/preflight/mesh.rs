//! Whether the mesh is a proper surface: its edges, pieces, duplicates and normals.
//!
//! Vertices at exactly the same position count as one, so that texture seams are no edges.

use rayon::prelude::*;
use rekindle_capture::Mesh;
use serde::Serialize;

/// What the mesh is like.
#[derive(Clone, Debug, Default, Serialize)]
pub struct MeshReport {
    /// Number of triangles.
    pub triangles: usize,
    /// Number of distinct vertex positions that triangles use.
    pub positions: usize,
    /// Length of the bounding box's diagonal, in mesh units.
    pub diagonal: f32,
    /// Whether the mesh has texture coordinates.
    pub has_uvs: bool,
    /// Connected pieces.
    pub pieces: usize,
    /// Edges with one triangle.
    pub boundary_edges: usize,
    /// Edges with three or more triangles.
    pub non_manifold_edges: usize,
    /// Edges whose two triangles are wound against each other.
    pub flipped_edges: usize,
    /// Triangles with the same three corners as an earlier one.
    pub duplicate_triangles: usize,
    /// Share of the area on which a vertex normal points to the back of its triangle.
    pub normals_against_faces: f64,
}

impl MeshReport {
    /// Examines a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        let (places, count) = weld(mesh);
        let triangles: Vec<[u32; 3]> = mesh
            .triangles
            .iter()
            .map(|t| t.map(|v| places[v as usize]))
            .collect();
        let mut report = Self {
            triangles: triangles.len(),
            positions: count,
            diagonal: mesh.diagonal(),
            has_uvs: !mesh.uvs.is_empty(),
            pieces: pieces(&triangles, count),
            duplicate_triangles: duplicates(&triangles),
            normals_against_faces: normals_against_faces(mesh),
            ..Self::default()
        };
        report.count_edges(&triangles);
        report
    }

    fn count_edges(&mut self, triangles: &[[u32; 3]]) {
        // Each edge by its lower and higher corner, and whether the triangle runs from low to high.
        let mut edges: Vec<(u32, u32, bool)> = triangles
            .par_iter()
            .flat_map_iter(|&[a, b, c]| {
                [(a, b), (b, c), (c, a)]
                    .into_iter()
                    .filter(|(i, j)| i != j)
                    .map(|(i, j)| (i.min(j), i.max(j), i < j))
            })
            .collect();
        edges.par_sort_unstable();
        for edge in edges.chunk_by(|e, f| (e.0, e.1) == (f.0, f.1)) {
            match edge {
                [_] => self.boundary_edges += 1,
                [first, second] => self.flipped_edges += usize::from(first.2 == second.2),
                _ => self.non_manifold_edges += 1,
            }
        }
    }
}

/// A number for every vertex, the same for vertices at the same position, and how many are used.
fn weld(mesh: &Mesh) -> (Vec<u32>, usize) {
    let mut used: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    used.par_sort_unstable();
    used.dedup();
    // Adding zero turns −0 into +0.
    let key = |v: u32| {
        let p = mesh.positions[v as usize] + glam::Vec3::ZERO;
        p.to_array().map(f32::to_bits)
    };
    used.par_sort_unstable_by_key(|&v| (key(v), v));
    let mut places = vec![0; mesh.positions.len()];
    let mut count = 0;
    for same in used.chunk_by(|&a, &b| key(a) == key(b)) {
        for &v in same {
            places[v as usize] = count;
        }
        count += 1;
    }
    (places, count as usize)
}

/// Number of connected pieces among `count` vertices, by union and find.
fn pieces(triangles: &[[u32; 3]], count: usize) -> usize {
    let mut parent: Vec<u32> = (0..count as u32).collect();
    let mut left = count;
    for &[a, b, c] in triangles {
        for (i, j) in [(a, b), (b, c)] {
            let (i, j) = (root(&mut parent, i), root(&mut parent, j));
            if i != j {
                parent[i.max(j) as usize] = i.min(j);
                left -= 1;
            }
        }
    }
    left
}

fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}

fn duplicates(triangles: &[[u32; 3]]) -> usize {
    let mut sorted: Vec<[u32; 3]> = triangles
        .par_iter()
        .map(|t| {
            let mut t = *t;
            t.sort_unstable();
            t
        })
        .collect();
    sorted.par_sort_unstable();
    sorted.windows(2).filter(|pair| pair[0] == pair[1]).count()
}

fn normals_against_faces(mesh: &Mesh) -> f64 {
    let (mut against, mut all) = (0.0, 0.0);
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
        let face = (b - a).cross(c - a);
        let area = face.length();
        let back = triangle
            .iter()
            .any(|&v| mesh.normals[v as usize].as_dvec3().dot(face) < 0.0);
        all += area;
        against += if back { area } else { 0.0 };
    }
    if all > 0.0 { against / all } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_scene::surface::fixtures::bumpy_sphere;

    /// A closed sphere whose poles are exactly one point each.
    fn sphere() -> Mesh {
        let mut mesh = bumpy_sphere(20, 0.0);
        for p in mesh.positions.iter_mut().filter(|p| p.y.abs() > 0.9999) {
            *p = glam::Vec3::new(0.0, p.y.signum(), 0.0);
        }
        mesh
    }

    #[test]
    fn a_closed_sphere_is_proper() {
        let mesh = sphere();
        let report = MeshReport::new(&mesh);
        assert_eq!(report.pieces, 1);
        let wrong = [
            report.boundary_edges,
            report.non_manifold_edges,
            report.flipped_edges,
            report.duplicate_triangles,
        ];
        assert_eq!(wrong, [0; 4]);
        // Euler's formula for a sphere: V − E + F = 2 with E = 3F/2.
        assert_eq!(
            report.positions + report.triangles - report.triangles * 3 / 2,
            2
        );
    }

    #[test]
    fn each_defect_is_counted() {
        let mesh = sphere();
        let mut torn = mesh.clone();
        torn.triangles.remove(300);
        assert_eq!(MeshReport::new(&torn).boundary_edges, 3);
        let mut flipped = mesh.clone();
        flipped.triangles[300].swap(0, 1);
        let report = MeshReport::new(&flipped);
        assert_eq!((report.flipped_edges, report.boundary_edges), (3, 0));
        assert!(report.normals_against_faces > 0.0);
        let mut doubled = mesh.clone();
        doubled.triangles.push(doubled.triangles[300]);
        let report = MeshReport::new(&doubled);
        assert_eq!(
            (report.duplicate_triangles, report.non_manifold_edges),
            (1, 3)
        );
        let mut pair = mesh;
        let count = pair.positions.len() as u32;
        for i in 0..count as usize {
            pair.positions.push(pair.positions[i] + 5.0);
            pair.normals.push(pair.normals[i]);
        }
        let far: Vec<_> = pair
            .triangles
            .iter()
            .map(|t| t.map(|v| v + count))
            .collect();
        pair.triangles.extend(far);
        assert_eq!(MeshReport::new(&pair).pieces, 2);
    }
}
