//! Triangles on an object's surface: surface nets (Gibson 1998) on a grid, evened out, then divided until they are as many
//! as wanted. Every vertex lies on the surface and has its exact normal.

use std::collections::HashMap;

use fast_surface_nets::ndshape::RuntimeShape;
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use glam::DVec3;
use rayon::prelude::*;

use super::object::{Object, REACH};
use rekindle_capture::Mesh;

/// More triangles than this come from dividing fewer.
const MOST_FROM_GRID: u32 = 60_000;
/// Samples along each side of the grid by which the number of triangles is judged first.
const TRIAL_GRID: u32 = 32;
/// The coarsest grid that still shows what an object is.
const LEAST_GRID: u32 = 12;
/// Rounds of evening out.
const ROUNDS: usize = 4;

/// A mesh of an object with about `triangles` triangles.
pub(super) fn tessellate(object: Object, triangles: u32) -> Mesh {
    let mut divisions = 0;
    while triangles >> (2 * divisions) > MOST_FROM_GRID {
        divisions += 1;
    }
    let wanted = f64::from(triangles >> (2 * divisions)).max(1.0);
    // Their number grows with the square of the grid's.
    let mut grid = TRIAL_GRID;
    for _ in 0..3 {
        let found = net(object, grid).triangles.len().max(1) as f64;
        grid = ((f64::from(grid) * (wanted / found).sqrt()).round() as u32).max(LEAST_GRID);
    }
    let mut net = net(object, grid);
    for _ in 0..ROUNDS {
        net.even_out(object);
    }
    for _ in 0..divisions {
        net = net.divided();
    }
    net.finish(object)
}

/// Triangles over shared places.
struct Net {
    places: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// Surface nets on a grid of this many samples along each side.
fn net(object: Object, side: u32) -> Net {
    let spacing = 2.0 * REACH / f64::from(side - 1);
    let place = |[x, y, z]: [f64; 3]| DVec3::new(x, y, z) * spacing - DVec3::splat(REACH);
    let samples: Vec<f32> = (0..side.pow(3))
        .into_par_iter()
        .map(|i| {
            let at = [i % side, i / side % side, i / (side * side)].map(f64::from);
            object.distance(place(at)) as f32
        })
        .collect();
    let mut buffer = SurfaceNetsBuffer::default();
    let shape = RuntimeShape::<u32, 3>::new([side; 3]);
    surface_nets(&samples, &shape, [0; 3], [side - 1; 3], &mut buffer);
    let (indices, _) = buffer.indices.as_chunks::<3>();
    Net {
        places: buffer
            .positions
            .par_iter()
            .map(|p| object.onto_surface(place(p.map(f64::from))))
            .collect(),
        triangles: indices.to_vec(),
    }
}

impl Net {
    /// Moves every place to the mean of its neighbours and back onto the surface.
    fn even_out(&mut self, object: Object) {
        let mut sums = vec![(DVec3::ZERO, 0.0); self.places.len()];
        for &[a, b, c] in &self.triangles {
            for (here, there) in [(a, b), (b, c), (c, a)] {
                let (sum, count) = &mut sums[here as usize];
                *sum += self.places[there as usize];
                *count += 1.0;
            }
        }
        self.places
            .par_iter_mut()
            .zip(&sums)
            .for_each(|(p, (sum, count))| {
                if *count > 0.0 {
                    // The mean alone would slide over a narrow part to its other side.
                    *p = object.onto_surface(p.midpoint(*sum / *count));
                }
            });
    }

    /// Every triangle as four, new places in the middles of edges.
    fn divided(self) -> Self {
        let mut places = self.places;
        let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
        let mut triangles = Vec::with_capacity(4 * self.triangles.len());
        for [a, b, c] in self.triangles {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(from, to)| {
                *middles
                    .entry((from.min(to), from.max(to)))
                    .or_insert_with(|| {
                        places.push(places[from as usize].midpoint(places[to as usize]));
                        places.len() as u32 - 1
                    })
            });
            triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        Self { places, triangles }
    }

    /// The mesh, its triangles counter-clockwise seen from outside.
    fn finish(self, object: Object) -> Mesh {
        let places: Vec<DVec3> = self
            .places
            .into_par_iter()
            .map(|p| object.onto_surface(p))
            .collect();
        let normals: Vec<DVec3> = places.par_iter().map(|&p| object.normal(p)).collect();
        // All are wound alike; which way is decided by all together, as a single one may be folded.
        let outwards: f64 = self
            .triangles
            .iter()
            .map(|t| {
                let [p, q, r] = t.map(|v| places[v as usize]);
                (q - p).cross(r - p).dot(normals[t[0] as usize])
            })
            .sum();
        let wound = |[a, b, c]: [u32; 3]| if outwards < 0.0 { [a, c, b] } else { [a, b, c] };
        let triangles = self.triangles.into_iter().map(wound).collect();
        Mesh {
            origin: glam::DVec3::ZERO,
            positions: places.iter().map(|p| p.as_vec3()).collect(),
            normals: normals.iter().map(|n| n.as_vec3()).collect(),
            uvs: Vec::new(),
            triangles,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OBJECTS: [Object; 4] = [
        Object::Sphere,
        Object::Torus,
        Object::Bowl,
        Object::Figurine,
    ];

    #[test]
    fn there_are_as_many_triangles_as_asked_for() {
        for object in OBJECTS {
            for wanted in [2000, 30_000, 130_000] {
                let found = tessellate(object, wanted).triangles.len();
                let ratio = found as f64 / f64::from(wanted);
                assert!(
                    (ratio - 1.0).abs() < 0.15,
                    "{object:?}: {found} for {wanted}"
                );
            }
        }
    }

    #[test]
    fn every_mesh_is_closed_and_faces_outwards() {
        for object in OBJECTS {
            let mesh = tessellate(object, 20_000);
            let mut edges = HashMap::new();
            for &[a, b, c] in &mesh.triangles {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    *edges.entry((from.min(to), from.max(to))).or_insert(0) +=
                        if from < to { 1 } else { -1 };
                }
            }
            let open = edges.values().filter(|&&turns| turns != 0).count();
            assert_eq!(open, 0, "{object:?}: edges without a counterpart");
            let inwards = (0..mesh.triangles.len() as u32)
                .filter(|&t| {
                    let middle = mesh.corners(t).iter().sum::<glam::Vec3>() / 3.0;
                    let outside = middle + 0.02 * mesh.face_normal(t);
                    object.distance(outside.as_dvec3()) < 0.0
                })
                .count();
            // A hollow's edge may be nearer than that.
            assert!(
                inwards * 200 < mesh.triangles.len(),
                "{object:?}: {inwards}"
            );
        }
    }
}
