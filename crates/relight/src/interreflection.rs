//! Light that reaches a surface point by way of the surface itself.
//!
//! The irradiance of a point x by interreflection is E(x) = ∫ B(y) T(cos θ_x) T(cos θ_y) cos θ_x dω over the directions
//! in which another surface point y is seen, B being y's diffuse radiance towards normal incidence and T the diffuse
//! transmittance of [`Brdf`]. Under the captured lighting B is the diffuse texture itself. Under new light it is
//! pseudo-albedo × irradiance, with irradiance again direct plus interreflected: a radiosity problem (Goral et al.
//! 1984), solved by Jacobi iteration.
//!
//! Lights are only known times K_S (eq. 4), so E must be scaled by K_S too. The paper's model leaves K_S open and then
//! nothing can be said; in the microfacet models it follows from roughness and Fresnel factor, [`Brdf::specular_scale`].
//!
//! E varies slowly. It is gathered at points a hundredth of the object's size apart, each with a fixed set of rays,
//! and interpolated: over a lattice on every triangle, first, whose values weigh the gather points nearby by distance
//! and normal.

use std::f32::consts::{PI, TAU};

use glam::{IVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::reflection::Lobe;
use super::shading::{Shader, ShadingPoint, Visibility};
use rekindle_base::math::GOLDEN_ANGLE;
use rekindle_capture::Mesh;
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::surface::{Atlas, Occluder};

/// Distance of gather points as a part of the object's diagonal.
const SPACING: f32 = 1.0 / 90.0;
/// Lattice points at most: beyond, the spacing grows.
const MAX_PLACES: usize = 3_000_000;
/// Rays of each gather point.
const RAYS: usize = 96;
/// Those that are about as far from the normal.
const RING: usize = 24;
/// Rounds of interreflection of new light at most …
const MAX_BOUNCES: usize = 64;
/// … and the part of the brightest irradiance below which a further round is not worth its while.
const SETTLED: f32 = 1e-4;
/// No surface sends more than this part of what it receives: where a badly known albedo says so, it is held down.
const MAX_ALBEDO: f32 = 0.95;

/// How light passes from surface to surface: geometry and transmittances, whatever the light and the texture.
pub struct Interreflection {
    lattice: Lattice,
    clusters: Clusters,
    /// Rays of gather point `i` that met the surface: `hits[starts[i]..starts[i + 1]]`.
    starts: Vec<u32>,
    hits: Vec<Hit>,
    /// Per gather point, whether a ray of it or of those near it met the surface.
    sheltered: Vec<bool>,
    spacing: f32,
    pub(super) lobe: Lobe,
}

/// A ray that met the surface.
#[derive(Clone, Copy)]
struct Hit {
    triangle: u32,
    barycentric: Vec2,
    /// Irradiance, K_S-scaled, per unit of diffuse radiance.
    weight: f32,
}

/// Smooth irradiance everywhere on the surface.
pub struct Field<'a> {
    lattice: &'a Lattice,
    /// One per place of the lattice.
    pub(super) irradiance: Vec<Vec3>,
}

/// The surface under new light.
pub struct Relit<'a> {
    /// Irradiance by interreflection.
    pub indirect: Field<'a>,
    /// All irradiance that the albedo is multiplied by, direct light with the resolution of the gather points.
    pub total: Field<'a>,
}

impl Field<'_> {
    /// K_S-scaled irradiance, RGB, transmittance inside, at a point of the mesh.
    pub fn at(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> Vec3 {
        self.lattice
            .corners(mesh, triangle, barycentric)
            .into_iter()
            .map(|(place, share)| self.irradiance[place as usize] * share)
            .sum()
    }
}

impl Interreflection {
    /// Casts the rays. `None` where the model leaves open how strong interreflection is.
    pub fn new(mesh: &Mesh, occluder: &Occluder, brdf: Option<Brdf>) -> Option<Self> {
        let brdf = brdf?;
        let scale = brdf.specular_scale()?;
        let mut spacing = SPACING * mesh.diagonal();
        let mut lattice = Lattice::new(mesh, spacing);
        while lattice.places > MAX_PLACES.max(mesh.positions.len()) {
            spacing *= 1.5;
            lattice = Lattice::new(mesh, spacing);
        }
        let places = lattice.points(mesh);
        let clusters = Clusters::new(&places, spacing);
        let order = ring_order();
        let rays: Vec<Vec<Hit>> = clusters
            .gather
            .par_iter()
            .enumerate()
            .map(|(i, point)| cast(mesh, occluder, brdf, scale, point, i, &order))
            .collect();
        let mut starts = vec![0];
        let mut hits = Vec::with_capacity(rays.iter().map(Vec::len).sum());
        for mut row in rays {
            hits.append(&mut row);
            starts.push(hits.len() as u32);
        }
        let meets = |i: u32| starts[i as usize] < starts[i as usize + 1];
        let sheltered = (0..clusters.gather.len())
            .map(|i| clusters.near(i as u32).iter().any(|&n| meets(n)))
            .collect();
        Some(Self {
            lattice,
            clusters,
            starts,
            hits,
            sheltered,
            spacing,
            lobe: Lobe::new(brdf),
        })
    }

    /// Interreflected irradiance where the surface's diffuse radiance towards normal incidence is `radiance(triangle,
    /// barycentric)`.
    pub fn of_radiance(
        &self,
        mesh: &Mesh,
        radiance: &(dyn Fn(u32, Vec2) -> Vec3 + Sync),
    ) -> Field<'_> {
        let gathered: Vec<Vec3> = (0..self.clusters.gather.len())
            .into_par_iter()
            .map(|i| {
                self.hits_of(i)
                    .iter()
                    .map(|h| radiance(h.triangle, h.barycentric) * h.weight)
                    .sum()
            })
            .collect();
        self.spread(&self.lattice.points(mesh), &gathered)
    }

    /// Irradiance under the light of `shader`, on a surface with this pseudo-albedo.
    pub fn of_light(
        &self,
        mesh: &Mesh,
        shader: &Shader,
        atlas: &Atlas,
        albedo: &[[f32; 3]],
    ) -> Relit<'_> {
        let direct = self.direct(shader);
        let passed = self.passed(mesh, atlas, albedo);
        let indirect = bounce(&direct, &self.rows(&passed));
        let total: Vec<Vec3> = direct.iter().zip(&indirect).map(|(&d, &i)| d + i).collect();
        self.relit(mesh, &indirect, &total)
    }

    /// Irradiance under the light of `shader` where the surface's diffuse radiance is known as so many times its direct irradiance: what
    /// it sends itself is in that factor, so the light bounces no more than once.
    pub fn of_pictured(
        &self,
        mesh: &Mesh,
        shader: &Shader,
        atlas: &Atlas,
        factor: &[[f32; 3]],
    ) -> Relit<'_> {
        let direct = self.direct(shader);
        let passed = self.passed(mesh, atlas, factor);
        let gather = |row: &&[(u32, Vec3)]| {
            let sent = row
                .iter()
                .map(|&(from, share)| share * direct[from as usize]);
            sent.sum()
        };
        let indirect: Vec<Vec3> = self.rows(&passed).par_iter().map(gather).collect();
        self.relit(mesh, &indirect, &direct)
    }

    /// Irradiance at the gather points as fields.
    fn relit(&self, mesh: &Mesh, indirect: &[Vec3], total: &[Vec3]) -> Relit<'_> {
        let places = self.lattice.points(mesh);
        Relit {
            indirect: self.spread(&places, indirect),
            total: self.spread(&places, total),
        }
    }

    /// Direct irradiance of the gather points.
    fn direct(&self, shader: &Shader) -> Vec<Vec3> {
        let at = |point: &ShadingPoint| {
            let groups = 0..shader.groups();
            let seen: Vec<Visibility> = groups.map(|g| shader.cast(point, g)).collect();
            shader.irradiance(point, &seen)
        };
        self.clusters.gather.par_iter().map(at).collect()
    }

    /// What each hit passes on of the irradiance at its own gather point.
    fn passed(&self, mesh: &Mesh, atlas: &Atlas, albedo: &[[f32; 3]]) -> Vec<(u32, Vec3)> {
        let pass = |hit: &Hit| {
            let gather = self.gather_point(mesh, hit.triangle, hit.barycentric);
            let albedo = atlas.sample(albedo, hit.triangle, hit.barycentric);
            (gather as u32, albedo * hit.weight)
        };
        self.hits.par_iter().map(pass).collect()
    }

    /// Values of the hits, those of each gather point together.
    fn rows<'v, T>(&self, of_hits: &'v [T]) -> Vec<&'v [T]> {
        let row = |ends: &[u32]| &of_hits[ends[0] as usize..ends[1] as usize];
        self.starts.windows(2).map(row).collect()
    }

    /// Whether any surface can be seen from near a point of the mesh.
    pub(super) fn is_sheltered(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> bool {
        self.sheltered[self.gather_point(mesh, triangle, barycentric)]
    }

    /// Part of the light from everywhere, by its irradiance, that reaches a point of the mesh past the rest of the surface.
    pub(super) fn openness(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> f32 {
        let gather = self.gather_point(mesh, triangle, barycentric);
        1.0 - self.hits_of(gather).len() as f32 / RAYS as f32
    }

    /// Points at which light is gathered.
    pub(super) fn gather_points(&self) -> &[ShadingPoint] {
        &self.clusters.gather
    }

    /// That of these which stands for a point of the mesh.
    pub(super) fn gather_point(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> usize {
        let place = self.lattice.nearest(mesh, triangle, barycentric);
        self.clusters.own[place as usize] as usize
    }

    fn hits_of(&self, gather: usize) -> &[Hit] {
        &self.hits[self.starts[gather] as usize..self.starts[gather + 1] as usize]
    }

    /// Interpolates values of the gather points at the lattice's places.
    fn spread(&self, places: &[ShadingPoint], values: &[Vec3]) -> Field<'_> {
        let irradiance = places
            .par_iter()
            .zip(&self.clusters.own)
            .map(|(place, &own)| {
                let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
                for &i in self.clusters.near(own) {
                    let point = &self.clusters.gather[i as usize];
                    let away = point.position.distance_squared(place.position)
                        / (2.0 * self.spacing).powi(2);
                    let facing = point.normal.dot(place.normal).max(0.0);
                    let weight = (1.0 - away).max(0.0).powi(2) * facing.powi(4);
                    sum += values[i as usize] * weight;
                    weights += weight;
                }
                if weights > 1e-6 {
                    sum / weights
                } else {
                    values[own as usize]
                }
            })
            .collect();
        Field {
            lattice: &self.lattice,
            irradiance,
        }
    }
}

/// Solves indirect = rows × (direct + indirect) by Jacobi iteration; a row lists the points that light comes from with
/// the part of their irradiance that arrives.
fn bounce(direct: &[Vec3], rows: &[&[(u32, Vec3)]]) -> Vec<Vec3> {
    let gains: Vec<f32> = rows
        .iter()
        .map(|row| {
            let sum: Vec3 = row.iter().map(|&(_, share)| share).sum();
            (MAX_ALBEDO / sum.max_element().max(MAX_ALBEDO)).min(1.0)
        })
        .collect();
    let brightest = direct.iter().fold(0.0_f32, |m, d| m.max(d.max_element()));
    let mut indirect = vec![Vec3::ZERO; direct.len()];
    for _ in 0..MAX_BOUNCES {
        let next: Vec<Vec3> = rows
            .par_iter()
            .zip(&gains)
            .map(|(row, &gain)| {
                let sum: Vec3 = row
                    .iter()
                    .map(|&(from, share)| share * (direct[from as usize] + indirect[from as usize]))
                    .sum();
                sum * gain
            })
            .collect();
        let change = next
            .iter()
            .zip(&indirect)
            .fold(0.0_f32, |m, (a, b)| m.max((*a - *b).abs().max_element()));
        indirect = next;
        if change <= SETTLED * brightest {
            break;
        }
    }
    indirect
}

/// Cosine at which light leaves a point of the surface against the unit direction of the ray that met it. `None` on the
/// inside of an open surface, which sends nothing.
pub(super) fn exit_cosine(
    mesh: &Mesh,
    triangle: u32,
    barycentric: Vec2,
    direction: Vec3,
) -> Option<f32> {
    let cos = -mesh.point(triangle, barycentric).normal.dot(direction);
    (cos > 0.0 && mesh.face_normal(triangle).dot(direction) < 0.0).then_some(cos)
}

/// Casts the rays of one gather point, distributed by the cosine (Malley's method) along a golden spiral.
fn cast(
    mesh: &Mesh,
    occluder: &Occluder,
    brdf: Brdf,
    scale: f32,
    point: &ShadingPoint,
    index: usize,
    order: &[usize; RAYS],
) -> Vec<Hit> {
    let origin = occluder.offset_origin(point.position, point.face_normal);
    let (tangent, bitangent) = point.normal.any_orthonormal_pair();
    // Every gather point turns the spiral, so that its gaps do not show as a pattern.
    let turn = (index as f32 * 0.618_034).fract() * TAU;
    let height_of = |ray: usize| (1.0 - (ray as f32 + 0.5) / RAYS as f32).sqrt();
    let direction = |ray: usize| {
        let height = height_of(ray);
        let radius = (1.0 - height * height).sqrt();
        let (sin, cos) = (turn + ray as f32 * GOLDEN_ANGLE).sin_cos();
        radius * (cos * tangent + sin * bitangent) + height * point.normal
    };
    let rays = order
        .iter()
        .map(|&ray| (ray, direction(ray)))
        .filter(|(_, direction)| direction.dot(point.face_normal) > 0.0)
        .map(|(ray, direction)| ((ray, direction), direction));
    let mut met = Vec::new();
    occluder.each_hit(origin, rays, |(ray, direction), hit| {
        let Some(hit) = hit else { return };
        let cos = exit_cosine(mesh, hit.triangle, hit.barycentric, direction);
        met.extend(cos.map(|cos_there| Hit {
            triangle: hit.triangle,
            barycentric: hit.barycentric,
            weight: scale * PI / RAYS as f32
                * brdf.diffuse_entry(height_of(ray))
                * brdf.diffuse_exit(cos_there),
        }));
    });
    met
}

/// The rays of a gather point in an order in which neighbours go nearly the same way: ring by ring, around.
fn ring_order() -> [usize; RAYS] {
    let mut order: [usize; RAYS] = std::array::from_fn(|ray| ray);
    for ring in order.chunks_mut(RING) {
        let angle = |ray: usize| (ray as f32 * GOLDEN_ANGLE).rem_euclid(TAU);
        ring.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)));
    }
    order
}

/// Places on the surface: the mesh's vertices, and where triangles are large a triangular lattice inside each.
struct Lattice {
    /// Parts that each triangle's edges are cut into.
    cuts: Vec<u16>,
    /// First place of each cut triangle.
    first: Vec<u32>,
    /// Number of places.
    places: usize,
}

impl Lattice {
    fn new(mesh: &Mesh, spacing: f32) -> Self {
        let mut places = mesh.positions.len();
        let (mut cuts, mut first) = (Vec::new(), Vec::new());
        for t in 0..mesh.triangles.len() as u32 {
            let [a, b, c] = mesh.corners(t);
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            let cut = (longest / spacing).ceil().clamp(1.0, 256.0) as usize;
            cuts.push(cut as u16);
            first.push(places as u32);
            if cut > 1 {
                places = places.saturating_add((cut + 1) * (cut + 2) / 2);
            }
        }
        Self {
            cuts,
            first,
            places,
        }
    }

    /// Number of the place at column `i` and row `j` of a triangle's lattice.
    fn place(&self, mesh: &Mesh, triangle: u32, i: usize, j: usize) -> u32 {
        let cut = usize::from(self.cuts[triangle as usize]);
        if cut == 1 {
            return mesh.triangles[triangle as usize][i + 2 * j];
        }
        // Rows have cut + 1, cut, … places.
        let before = j * (cut + 1) - j * j.saturating_sub(1) / 2;
        self.first[triangle as usize] + (before + i) as u32
    }

    /// The three places around a point with their weights.
    fn corners(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> [(u32, f32); 3] {
        let cut = usize::from(self.cuts[triangle as usize]);
        let x = barycentric.x.clamp(0.0, 1.0);
        let y = barycentric.y.clamp(0.0, 1.0 - x);
        let (x, y) = (x * cut as f32, y * cut as f32);
        let j = (y as usize).min(cut - 1);
        let i = (x as usize).min(cut - 1 - j);
        let (u, v) = (
            (x - i as f32).clamp(0.0, 1.0),
            (y - j as f32).clamp(0.0, 1.0),
        );
        let at = |i: usize, j: usize| self.place(mesh, triangle, i, j);
        if u + v <= 1.0 || i + j + 2 > cut {
            let sum = (u + v).max(1.0);
            let (u, v) = (u / sum, v / sum);
            [
                (at(i, j), 1.0 - u - v),
                (at(i + 1, j), u),
                (at(i, j + 1), v),
            ]
        } else {
            [
                (at(i + 1, j + 1), u + v - 1.0),
                (at(i, j + 1), 1.0 - u),
                (at(i + 1, j), 1.0 - v),
            ]
        }
    }

    fn nearest(&self, mesh: &Mesh, triangle: u32, barycentric: Vec2) -> u32 {
        let [a, b, c] = self.corners(mesh, triangle, barycentric);
        let larger = |a: (u32, f32), b: (u32, f32)| if b.1 > a.1 { b } else { a };
        larger(larger(a, b), c).0
    }

    /// The surface points of all places.
    fn points(&self, mesh: &Mesh) -> Vec<ShadingPoint> {
        let mut points: Vec<ShadingPoint> = mesh
            .positions
            .iter()
            .zip(&mesh.normals)
            .map(|(&position, &normal)| ShadingPoint::smooth(position, normal))
            .collect();
        let inside: Vec<Vec<ShadingPoint>> = (0..mesh.triangles.len() as u32)
            .into_par_iter()
            .filter(|&t| self.cuts[t as usize] > 1)
            .map(|t| {
                let cut = usize::from(self.cuts[t as usize]);
                (0..=cut)
                    .flat_map(|j| (0..=cut - j).map(move |i| Vec2::new(i as f32, j as f32)))
                    .map(|at| ShadingPoint::on(mesh, t, at / cut as f32))
                    .collect()
            })
            .collect();
        points.extend(inside.into_iter().flatten());
        points
    }
}

/// Places of the lattice grouped by cell and by the way they face.
struct Clusters {
    /// One point of each group, where light is gathered.
    gather: Vec<ShadingPoint>,
    /// Group of each place.
    own: Vec<u32>,
    /// Groups of the cells around group `i`, itself included: `near[near_starts[i]..near_starts[i + 1]]`.
    near_starts: Vec<u32>,
    near: Vec<u32>,
}

impl Clusters {
    fn new(places: &[ShadingPoint], spacing: f32) -> Self {
        type Key = ([i32; 3], u8);
        let key = |p: &ShadingPoint| -> Key {
            let cell = (p.position / spacing).floor().as_ivec3();
            (cell.to_array(), facing(p.normal))
        };
        let mut order: Vec<(Key, u32)> = places
            .par_iter()
            .enumerate()
            .map(|(i, p)| (key(p), i as u32))
            .collect();
        order.par_sort_unstable();
        let groups: Vec<&[(Key, u32)]> = order.chunk_by(|a, b| a.0 == b.0).collect();
        let gather: Vec<ShadingPoint> = groups.par_iter().map(|g| middle(places, g)).collect();
        let mut own = vec![0; places.len()];
        for (i, group) in groups.iter().enumerate() {
            for &(_, place) in *group {
                own[place as usize] = i as u32;
            }
        }
        let near: Vec<Vec<u32>> = groups
            .par_iter()
            .map(|group| {
                let centre = IVec3::from(group[0].0.0);
                let mut near = Vec::new();
                for offset in (-1..=1).flat_map(|x| (-1..=1).map(move |y| (x, y))) {
                    // Cells that differ in z alone stand side by side.
                    let cell = |z: i32| [centre.x + offset.0, centre.y + offset.1, centre.z + z];
                    let from = groups.partition_point(|g| g[0].0 < (cell(-1), 0));
                    let upto = groups.partition_point(|g| g[0].0 <= (cell(1), u8::MAX));
                    near.extend((from..upto).map(|i| i as u32));
                }
                near
            })
            .collect();
        let mut near_starts = vec![0];
        for list in &near {
            near_starts.push(near_starts[near_starts.len() - 1] + list.len() as u32);
        }
        Self {
            gather,
            own,
            near_starts,
            near: near.concat(),
        }
    }
}

impl Clusters {
    fn near(&self, group: u32) -> &[u32] {
        let i = group as usize;
        &self.near[self.near_starts[i] as usize..self.near_starts[i + 1] as usize]
    }
}

/// Which of six directions a normal is nearest to.
fn facing(normal: Vec3) -> u8 {
    let axis = normal.abs().max_position() as u8;
    2 * axis + u8::from(normal[usize::from(axis)] < 0.0)
}

/// Of a group's places the one nearest to their mean.
fn middle<K>(places: &[ShadingPoint], group: &[(K, u32)]) -> ShadingPoint {
    let sum: Vec3 = group.iter().map(|g| places[g.1 as usize].position).sum();
    let mean = sum / group.len() as f32;
    let distance = |g: &(K, u32)| places[g.1 as usize].position.distance_squared(mean);
    let nearest = group
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .unwrap_or(&group[0]);
    places[nearest.1 as usize]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_scene::reflectance::SpecularModel;
    use rekindle_scene::surface::fixtures::bumpy_sphere;

    const PLASTIC: Brdf = Brdf::new(SpecularModel::Beckmann, 0.1);

    /// The unit sphere seen from inside: every point sees the whole sphere.
    fn cavity() -> Mesh {
        let mut mesh = bumpy_sphere(48, 0.0);
        for triangle in &mut mesh.triangles {
            triangle.swap(1, 2);
        }
        for normal in &mut mesh.normals {
            *normal = -*normal;
        }
        mesh
    }

    /// In a sphere cos θ is the same at both ends of every chord: scale · 2π ∫ T(c)² c dc of unit radiance.
    fn irradiance_in_cavity() -> f32 {
        let steps = 20_000;
        let integral: f32 = (0..steps)
            .map(|i| {
                let c = (i as f32 + 0.5) / steps as f32;
                PLASTIC.diffuse_exit(c).powi(2) * c / steps as f32
            })
            .sum();
        PLASTIC.specular_scale().unwrap() * TAU * integral
    }

    #[test]
    fn a_glowing_cavity_lights_itself_as_the_integral_says() {
        let mesh = cavity();
        let occluder = Occluder::new(&mesh);
        let light = Interreflection::new(&mesh, &occluder, Some(PLASTIC)).unwrap();
        let field = light.of_radiance(&mesh, &|_, _| Vec3::new(1.0, 0.5, 0.0));
        let expected = irradiance_in_cavity();
        for triangle in (0..mesh.triangles.len() as u32).step_by(97) {
            let found = field.at(&mesh, triangle, Vec2::new(0.2, 0.3));
            assert!(
                (found.x / expected - 1.0).abs() < 0.02 && (found.y / expected - 0.5).abs() < 0.01,
                "{found} at triangle {triangle}, expected {expected}"
            );
            assert_eq!(found.z, 0.0);
        }
    }

    #[test]
    fn bounces_add_up_to_the_geometric_series() {
        // Two points that each get half of what the other has, and one that sees nothing.
        let half = Vec3::splat(0.5);
        let rows: [&[(u32, Vec3)]; 3] = [&[(1, half)], &[(0, half)], &[]];
        let found = bounce(&[Vec3::ONE, Vec3::ZERO, Vec3::ONE], &rows);
        // i₀ = (i₁)/2, i₁ = (1 + i₀)/2.
        let expected = [1.0 / 3.0, 2.0 / 3.0, 0.0];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found.x - expected).abs() < 1e-3, "{found}, not {expected}");
        }
    }

    #[test]
    fn impossible_albedos_do_not_run_away() {
        let rows: [&[(u32, Vec3)]; 2] = [&[(1, Vec3::splat(7.0))], &[(0, Vec3::splat(3.0))]];
        let found = bounce(&[Vec3::ONE, Vec3::ONE], &rows);
        assert!(
            found.iter().all(|f| f.x.is_finite() && f.x < 25.0),
            "{found:?}"
        );
    }

    #[test]
    fn a_sphere_does_not_light_itself() {
        let mesh = bumpy_sphere(24, 0.0);
        let occluder = Occluder::new(&mesh);
        let light = Interreflection::new(&mesh, &occluder, Some(PLASTIC)).unwrap();
        let field = light.of_radiance(&mesh, &|_, _| Vec3::ONE);
        let inside = Vec2::splat(0.3);
        for triangle in 0..mesh.triangles.len() as u32 {
            assert_eq!(field.at(&mesh, triangle, inside), Vec3::ZERO);
            assert!(!light.is_sheltered(&mesh, triangle, inside));
        }
    }

    #[test]
    fn the_papers_model_leaves_interreflection_open() {
        let mesh = cavity();
        let brdf = Brdf {
            model: SpecularModel::Paper,
            ..PLASTIC
        };
        let occluder = Occluder::new(&mesh);
        assert!(Interreflection::new(&mesh, &occluder, Some(brdf)).is_none());
        assert!(Interreflection::new(&mesh, &occluder, None).is_none());
    }

    #[test]
    fn a_lattice_reproduces_what_is_linear() {
        let mesh = bumpy_sphere(6, 0.0);
        let lattice = Lattice::new(&mesh, 0.11);
        let places = lattice.points(&mesh);
        assert_eq!(places.len(), lattice.places);
        for triangle in 0..mesh.triangles.len() as u32 {
            for i in 0..=9 {
                for j in 0..=9 - i {
                    let at = Vec2::new(i as f32, j as f32) / 9.0;
                    let sum: Vec3 = lattice
                        .corners(&mesh, triangle, at)
                        .into_iter()
                        .map(|(place, share)| {
                            assert!((-1e-5..=1.0 + 1e-5).contains(&share));
                            places[place as usize].position * share
                        })
                        .sum();
                    let expected = mesh.point(triangle, at).position;
                    assert!(sum.distance(expected) < 1e-5, "{sum}, not {expected}");
                }
            }
        }
    }
}
