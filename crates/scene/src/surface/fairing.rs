//! A smooth surface through a coarse or noisy mesh.
//!
//! A mesh that was decimated has lost the normals between its vertices, and smooth ones computed from its faces are off
//! by degrees. Of all surfaces that it may stand for, the least bent is a far better guess. Every triangle is divided
//! into sixteen, and the places x of the fine vertices minimise
//!
//! `xᵀ K x − 2 xᵀ k = Σ_i |(Lx)_i|²/A_i + Σ_c (w/A_c) |B_c (x − x₀)|²`
//!
//! with x₀ the places in the flat triangles, L their cotangent Laplacian and A their areas. B_c is the mean over the
//! faces about a coarse vertex c, weighted by its hat function: a decimated mesh is close to the best fit by flat
//! triangles, whose difference from the surface vanishes in such means, while its vertices lie outside of bulges. The
//! energy at the minimum says how bent such surfaces are, and so with K how far the object's may be from it.

use std::collections::BTreeMap;

use faer::Mat;
use glam::{DVec3, Vec3};

use rekindle_base::math::sparse::{LowerEntries, Order, SparseRow};
use rekindle_capture::Mesh;

/// How often every triangle is divided into four.
const LEVELS: usize = 2;

/// The w above, per fine triangle. Normals of decimated meshes are best between 30 and 100.
const STIFFNESS: f64 = 50.0;

/// Cotangents beyond this are a sliver's.
const LARGEST_COTANGENT: f64 = 50.0;

/// Areas below this part of the mean are taken as that.
const LEAST_AREA: f64 = 1e-3;

/// A row with its weight.
type Weighted = (SparseRow, f64);

/// A fair surface, and how it may differ from the true one.
#[derive(Clone, Debug)]
pub struct Fairing {
    /// The fine mesh without texture coordinates.
    mesh: Mesh,
    /// Its triangles as triples of places.
    pub triangles: Vec<[usize; 3]>,
    /// Position of every place, mesh units.
    pub positions: Vec<DVec3>,
    /// Place of every vertex.
    place_of: Vec<u32>,
    /// Normals of the mesh that was given at the vertices, unit.
    given_normals: Vec<Vec3>,
    /// K over the energy per coarse vertex and axis.
    precision: LowerEntries,
}

impl Fairing {
    /// The fair surface of a mesh that is coarser than the surface; `None` where the mesh does not determine one.
    pub fn new(coarse: &Mesh) -> Option<Self> {
        let (mesh, hats) = divided(coarse);
        let flat = Flat::new(mesh);
        let mut hat_at = vec![SparseRow::new(); flat.places.len()];
        for (&place, hat) in flat.place_of.iter().zip(hats) {
            hat_at[place as usize] = hat;
        }
        let (bends, area) = flat.bends();
        let held = means(&hat_at, &area);
        let energy = energy(&bends, &held);
        let order = energy.order(flat.places.len())?;
        flat.faired(energy, (&bends, &held), &order)
    }

    /// Adds the precision P of the true surface's heights over the fair one, if surfaces are as bent as that, to
    /// `entries`, and −P `heights` to `gradient`; per squared mesh unit.
    pub fn add_prior(&self, heights: &[f64], entries: &mut LowerEntries, gradient: &mut [f64]) {
        entries.extend(&self.precision);
        for (row, column, value) in self.precision.iter() {
            gradient[row] -= value * heights[column];
            if row != column {
                gradient[column] -= value * heights[row];
            }
        }
    }

    /// The fine mesh with its places at `positions`, and normals to match.
    pub fn mesh_at(&self, positions: &[DVec3]) -> Mesh {
        let normals = area_vectors(positions, &self.triangles);
        let mut mesh = self.mesh.clone();
        for (vertex, &place) in self.place_of.iter().enumerate() {
            mesh.positions[vertex] = positions[place as usize].as_vec3();
            mesh.normals[vertex] = normals[place as usize]
                .try_normalize()
                .map_or(self.given_normals[vertex], glam::DVec3::as_vec3);
        }
        mesh
    }
}

/// A mesh that is as fine as the surface but noisy, to be smoothed more or less.
pub struct Smoothing {
    flat: Flat,
    bends: Vec<Weighted>,
    /// What bends add to K.
    bent: LowerEntries,
    /// Area of each place.
    area: Vec<f64>,
    order: Order,
}

impl Smoothing {
    /// Prepares a mesh; `None` where it has no surface.
    pub fn new(noisy: &Mesh) -> Option<Self> {
        let flat = Flat::new(Mesh {
            uvs: Vec::new(),
            ..noisy.clone()
        });
        let (bends, area) = flat.bends();
        let bent = energy(&bends, &[]);
        // Each place is held beside its own bend, so by an entry that is there.
        let order = bent.order(flat.places.len())?;
        Some(Self {
            flat,
            bends,
            bent,
            area,
            order,
        })
    }

    /// The fair surface: B is one place, and its weight A/ℓ⁴, so that what is clearly shorter than 2πℓ is smoothed away; `length` is that
    /// ℓ, mesh units. Where the surface is bent more than it is at most places even so, as at creases, bending counts less: as under a
    /// Cauchy distribution of curvatures. `None` where the mesh does not determine one.
    pub fn at(&self, length: f64) -> Option<Fairing> {
        let held = self.held(length);
        let even = self.evenly(&held)?;
        let creased = creased(self.bends.clone(), &even);
        let energy = energy(&creased, &held);
        self.flat.faired(energy, (&creased, &held), &self.order)
    }

    fn held(&self, length: f64) -> Vec<Weighted> {
        let held = self.area.iter().enumerate();
        held.map(|(place, area)| (vec![(place, 1.0)], area / length.powi(4)))
            .collect()
    }

    /// Places where bending counts the same everywhere.
    fn evenly(&self, held: &[Weighted]) -> Option<Vec<DVec3>> {
        let mut energy = self.bent.clone();
        for (row, weight) in held {
            energy.add_square(row, *weight);
        }
        self.flat.least_bent(&energy, held, &self.order)
    }
}

/// The K of weighted rows.
fn energy(bends: &[Weighted], held: &[Weighted]) -> LowerEntries {
    let mut energy = LowerEntries::default();
    for (row, weight) in bends.iter().chain(held) {
        energy.add_square(row, *weight);
    }
    energy
}

/// A mesh whose vertices at one place are one.
struct Flat {
    mesh: Mesh,
    triangles: Vec<[usize; 3]>,
    places: Vec<DVec3>,
    place_of: Vec<u32>,
}

impl Flat {
    fn new(mesh: Mesh) -> Self {
        let place_of = mesh.places();
        let count = place_of.iter().max().map_or(0, |m| *m as usize + 1);
        let mut places = vec![DVec3::ZERO; count];
        for (&place, position) in place_of.iter().zip(&mesh.positions) {
            places[place as usize] = position.as_dvec3();
        }
        let triangles = mesh.triangles.iter();
        Self {
            triangles: triangles
                .map(|t| t.map(|v| place_of[v as usize] as usize))
                .collect(),
            mesh,
            places,
            place_of,
        }
    }

    /// The rows L with the weights 1/A, and the areas A.
    fn bends(&self) -> (Vec<Weighted>, Vec<f64>) {
        let (laplacian, area) = laplacian(&self.places, &self.triangles);
        let rows = laplacian.into_iter().zip(&area);
        (rows.map(|(row, a)| (row, 1.0 / a)).collect(), area)
    }

    /// The least bent surface that is held where it is by some weighted means of places; `energy` is its K.
    fn faired(
        &self,
        energy: LowerEntries,
        (bends, held): (&[Weighted], &[Weighted]),
        order: &Order,
    ) -> Option<Fairing> {
        let positions = self.least_bent(&energy, held, order)?;
        let off = positions.iter().zip(&self.places);
        let off: Vec<DVec3> = off.map(|(x, f)| *x - *f).collect();
        let bent = bends
            .iter()
            .map(|(row, w)| w * applied(row, &positions).length_squared());
        let moved = held
            .iter()
            .map(|(row, w)| w * applied(row, &off).length_squared());
        let variance = bent.chain(moved).sum::<f64>() / (3 * held.len()) as f64;
        Some(Fairing {
            precision: energy.scaled(1.0 / variance.max(f64::MIN_POSITIVE)),
            given_normals: self.mesh.normals.clone(),
            mesh: self.mesh.clone(),
            triangles: self.triangles.clone(),
            positions,
            place_of: self.place_of.clone(),
        })
    }

    /// The places of that surface.
    fn least_bent(
        &self,
        energy: &LowerEntries,
        held: &[Weighted],
        order: &Order,
    ) -> Option<Vec<DVec3>> {
        let count = self.places.len();
        let mut pull = vec![DVec3::ZERO; count];
        for (row, weight) in held {
            let mean = applied(row, &self.places);
            for &(place, share) in row {
                pull[place] += *weight * share * mean;
            }
        }
        let x = energy.solve_in(order, &Mat::from_fn(count, 3, |i, k| pull[i][k]))?;
        let places = (0..count).map(|i| DVec3::new(x[(i, 0)], x[(i, 1)], x[(i, 2)]));
        Some(places.collect())
    }
}

/// The rows L with less weight where the surface of these places is bent more than it is at most of them.
fn creased(mut bends: Vec<Weighted>, places: &[DVec3]) -> Vec<Weighted> {
    let curvature = |(row, weight): &Weighted| weight * applied(row, places).length();
    let curvatures: Vec<f64> = bends.iter().map(curvature).collect();
    let mut sorted = curvatures.clone();
    let at = sorted.len() / 2;
    if at >= sorted.len() {
        return bends;
    }
    let median = sorted
        .select_nth_unstable_by(at, f64::total_cmp)
        .1
        .max(f64::MIN_POSITIVE);
    for ((_, weight), curvature) in bends.iter_mut().zip(curvatures) {
        *weight /= 1.0 + (curvature / median).powi(2);
    }
    bends
}

/// A row's product with positions.
fn applied(row: &[(usize, f64)], positions: &[DVec3]) -> DVec3 {
    row.iter().map(|&(i, w)| w * positions[i]).sum()
}

/// Every triangle divided into 4^[`LEVELS`], with each vertex's hat functions of the coarse mesh's places.
fn divided(coarse: &Mesh) -> (Mesh, Vec<SparseRow>) {
    let places = coarse.places();
    let mut hats: Vec<SparseRow> = places.iter().map(|&p| vec![(p as usize, 1.0)]).collect();
    let mut mesh = Mesh {
        uvs: Vec::new(),
        ..coarse.clone()
    };
    for _ in 0..LEVELS {
        divide(&mut mesh, &mut hats);
    }
    for normal in &mut mesh.normals {
        *normal = normal.try_normalize().unwrap_or(Vec3::Y);
    }
    (mesh, hats)
}

/// Divides every triangle into four.
fn divide(mesh: &mut Mesh, hats: &mut Vec<SparseRow>) {
    let mut middles: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for [a, b, c] in std::mem::take(&mut mesh.triangles) {
        let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
            *middles.entry((p.min(q), p.max(q))).or_insert_with(|| {
                let (p, q) = (p as usize, q as usize);
                let middle = mesh.positions.len() as u32;
                mesh.positions
                    .push((mesh.positions[p] + mesh.positions[q]) * 0.5);
                mesh.normals.push((mesh.normals[p] + mesh.normals[q]) * 0.5);
                let mut hat: BTreeMap<usize, f64> = BTreeMap::new();
                for &(place, weight) in hats[p].iter().chain(&hats[q]) {
                    *hat.entry(place).or_default() += 0.5 * weight;
                }
                hats.push(hat.into_iter().collect());
                middle
            })
        });
        mesh.triangles
            .extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
}

/// The means B over coarse vertices' faces with their weights w/A.
fn means(hat_at: &[SparseRow], area: &[f64]) -> Vec<Weighted> {
    let mut by_coarse: BTreeMap<usize, SparseRow> = BTreeMap::new();
    for (place, hat) in hat_at.iter().enumerate() {
        for &(coarse, weight) in hat {
            let row = by_coarse.entry(coarse).or_default();
            row.push((place, weight * area[place]));
        }
    }
    by_coarse
        .into_values()
        .map(|mut row| {
            let total: f64 = row.iter().map(|r| r.1).sum();
            for r in &mut row {
                r.1 /= total;
            }
            (row, STIFFNESS * f64::from(1 << (2 * LEVELS)) / total)
        })
        .collect()
}

/// The cotangent Laplacian, and the area of each place: a third of its triangles'.
fn laplacian(positions: &[DVec3], triangles: &[[usize; 3]]) -> (Vec<SparseRow>, Vec<f64>) {
    let mut weights: Vec<BTreeMap<usize, f64>> = vec![BTreeMap::new(); positions.len()];
    let mut area = vec![0.0; positions.len()];
    for t in triangles {
        for k in 0..3 {
            let [a, b, c] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
            let (u, v) = (positions[b] - positions[a], positions[c] - positions[a]);
            let twice = u.cross(v).length();
            let cotangent = u.dot(v) / twice.max(f64::MIN_POSITIVE);
            let weight = 0.5 * cotangent.clamp(-LARGEST_COTANGENT, LARGEST_COTANGENT);
            for (i, j) in [(b, c), (c, b)] {
                *weights[i].entry(j).or_default() -= weight;
                *weights[i].entry(i).or_default() += weight;
            }
            area[a] += twice / 6.0;
        }
    }
    let least = LEAST_AREA * area.iter().sum::<f64>() / area.len().max(1) as f64;
    for a in &mut area {
        *a = a.max(least);
    }
    let rows = weights
        .into_iter()
        .map(|w| w.into_iter().collect())
        .collect();
    (rows, area)
}

/// Sum of the area vectors of the triangles about each place; it points along the normal.
pub fn area_vectors(positions: &[DVec3], triangles: &[[usize; 3]]) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|i| positions[i]);
        let face = 0.5 * (b - a).cross(c - a);
        for &i in t {
            sums[i] += face;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::fixtures::bumpy_sphere;

    /// Median angle in degrees between a mesh's normals in the middle of its triangles and those of the surface that
    /// `normal` gives at a position.
    fn median_error(mesh: &Mesh, normal: impl Fn(Vec3) -> Vec3) -> f32 {
        let mut errors: Vec<f32> = (0..mesh.triangles.len() as u32)
            .map(|t| {
                let point = mesh.point(t, glam::Vec2::splat(1.0 / 3.0));
                point.normal.angle_between(normal(point.position))
            })
            .collect();
        errors.sort_by(f32::total_cmp);
        errors[errors.len() / 2].to_degrees()
    }

    /// Vertices of another mesh of the same surface are where its normals are looked up.
    fn nearest_normal(fine: &Mesh) -> impl Fn(Vec3) -> Vec3 + '_ {
        |position| {
            let nearest = (0..fine.positions.len()).min_by(|&a, &b| {
                let away = |v: usize| fine.positions[v].distance_squared(position);
                away(a).total_cmp(&away(b))
            });
            fine.normals[nearest.unwrap_or(0)]
        }
    }

    #[test]
    fn a_coarse_mesh_gets_normals_nearer_to_the_surface() {
        let coarse = bumpy_sphere(16, 0.1);
        let truth = bumpy_sphere(160, 0.1);
        let fairing = Fairing::new(&coarse).unwrap();
        let fair = fairing.mesh_at(&fairing.positions);
        assert_eq!(fair.triangles.len(), 16 * coarse.triangles.len());
        let before = median_error(&coarse, nearest_normal(&truth));
        let after = median_error(&fair, nearest_normal(&truth));
        assert!(after < 0.6 * before, "{before}° before, {after}° after");
    }

    /// Two slopes that meet at right angles along the line x = 0, of triangles with legs of 1 and noise of 0.1 along the vertical.
    fn noisy_ridge() -> Mesh {
        const HALF: i32 = 24;
        let mut mesh = Mesh::default();
        for i in -HALF..=HALF {
            for j in -HALF..=HALF {
                let noise = (f64::from(i) * 12.9898 + f64::from(j) * 78.233).sin() * 43758.5453;
                let height = 0.1 * (2.0 * (noise - noise.floor()) - 1.0) - f64::from(i.abs());
                mesh.positions
                    .push(DVec3::new(f64::from(i), f64::from(j), height).as_vec3());
            }
        }
        let side = 2 * HALF as u32 + 1;
        for i in 0..side - 1 {
            for j in 0..side - 1 {
                let [a, b] = [i * side + j, (i + 1) * side + j];
                mesh.triangles.extend([[a, b, a + 1], [a + 1, b, b + 1]]);
            }
        }
        mesh.normals = vec![Vec3::Z; mesh.positions.len()];
        mesh
    }

    /// Median angle in degrees between the normals of faces so far from the ridge and those of the slopes.
    fn off_ridge(
        (places, place_of): (&[DVec3], &[u32]),
        mesh: &Mesh,
        distance: std::ops::Range<f64>,
    ) -> f64 {
        let mut errors: Vec<f64> = Vec::new();
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|v| places[place_of[v as usize] as usize]);
            let middle = (a + b + c) / 3.0;
            // The rim is free.
            if distance.contains(&middle.x.abs()) && middle.y.abs() < 20.0 {
                let slope = DVec3::new(middle.x.signum(), 0.0, 1.0);
                errors.push((b - a).cross(c - a).angle_between(slope).to_degrees());
            }
        }
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    }

    #[test]
    fn smoothing_takes_noise_away_and_leaves_a_crease() {
        let mesh = noisy_ridge();
        let smoothing = Smoothing::new(&mesh).unwrap();
        let smooth = smoothing.at(1.5).unwrap();
        let even = smoothing.evenly(&smoothing.held(1.5)).unwrap();
        let Flat {
            places: noisy,
            place_of,
            ..
        } = smoothing.flat;
        let [before, after] =
            [&noisy, &smooth.positions].map(|at| off_ridge((at, &place_of), &mesh, 6.0..18.0));
        assert!(after < 0.4 * before, "{before}° before, {after}° after");
        let [even, creased] =
            [&even, &smooth.positions].map(|at| off_ridge((at, &place_of), &mesh, 0.0..2.0));
        assert!(
            creased < 0.6 * even,
            "{even}° evenly, {creased}° with a crease"
        );
    }

    #[test]
    fn the_fair_surface_is_the_minimum() {
        let coarse = bumpy_sphere(8, 0.1);
        let fairing = Fairing::new(&coarse).unwrap();
        let n = fairing.positions.len();
        // At heights of zero nothing pulls; anywhere else the prior pulls back.
        let (mut entries, mut gradient) = (LowerEntries::default(), vec![0.0; n]);
        let heights: Vec<f64> = (0..n).map(|i| (i as f64).sin()).collect();
        fairing.add_prior(&heights, &mut entries, &mut gradient);
        let back = entries
            .solve(&Mat::from_fn(n, 1, |i, _| gradient[i]))
            .unwrap();
        for (i, h) in heights.iter().enumerate() {
            assert!((back[(i, 0)] + h).abs() < 1e-5, "{} for {h}", back[(i, 0)]);
        }
    }
}
