//! A texture for any mesh: which texel belongs to which point of the surface.
//!
//! The mesh's own texture coordinates serve where they are a valid atlas. Otherwise the paper's lattice of points inside
//! every triangle (2.1) becomes a texture: with legs of n and m cells, the lattice point (i, j) lies at the barycentric
//! weights (i/n, j/m) and is the centre of a texel. Two such right triangles, one turned by half a turn, share a rectangle of
//! (n + ⌈n/m⌉ + 3) × (m + 2) texels, and the rectangles are packed into shelves, part by part of the surface and by height.
//! Beyond the long side lie gutter texels, so that a bilinear look-up anywhere in a triangle reads texels of that triangle
//! only. A triangle no larger than the texels wanted is a single one: a scan of millions of triangles needs no more.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::charts::from_own_uvs;
use rekindle_base::math::morton;
use rekindle_capture::Mesh;

/// The longest side of a texture. Every WebGPU device has textures of this size, and larger ones are not promised.
pub const LARGEST_SIDE: u32 = 8192;
/// The most texels that carry data: at 20 bytes for the list and 12 for each texture, more would take gigabytes.
const MOST_TEXELS: f64 = 32e6;
/// Texels of the parts of the surface that are packed one after the other: their sums while a texture is made fit a cache.
const PART: usize = 1 << 16;
/// Fractions of a texel below this are rounding: look-ups on a lattice's edge must not reach over it.
const SNAP: f32 = 1e-3;

/// One texel that carries data.
#[derive(Clone, Copy, Debug)]
pub struct Texel {
    /// Its place in the texture, y · width + x.
    pub index: u32,
    /// The triangle it belongs to.
    pub triangle: u32,
    /// Weights of the triangle's second and third corner; for a gutter texel those of the nearest point of the triangle.
    pub barycentric: Vec2,
    /// Whether its centre lies outside the triangle.
    pub gutter: bool,
}

/// A parametrisation of the surface by a texture.
#[derive(Clone, Debug)]
pub struct Atlas {
    /// Width in texels.
    pub width: u32,
    /// Height in texels.
    pub height: u32,
    /// The corners of each triangle in the texture, in texels: (0, 0) is the top-left corner of the texture, the first
    /// texel's centre lies at (0.5, 0.5).
    pub corner_uvs: Vec<[Vec2; 3]>,
    /// The texels that carry data, each once.
    pub texels: Vec<Texel>,
    /// Whether the mesh's own texture coordinates are used.
    pub own_uvs: bool,
    /// What a user should know, in whole sentences.
    pub warnings: Vec<String>,
    /// One per triangle where the lattice is used, else empty.
    pub(super) patches: Vec<Patch>,
}

/// Where a triangle's lattice lies: point (i, j) is the texel (x ± i, y ± j).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Patch {
    x: u32,
    y: u32,
    /// Turned by half a turn: the lattice runs to the left and up.
    turned: bool,
    cells: Cells,
}

/// The lattice's size and how it lies on the triangle.
#[derive(Clone, Copy, Debug, Default)]
struct Cells {
    /// Cells along the longer leg; none where one texel stands for the triangle.
    n: u32,
    /// Cells along the shorter leg; none where one texel stands for the triangle.
    m: u32,
    /// The corner at (0, 0), then the end of the longer leg, then the other.
    corners: [u8; 3],
}

impl Cells {
    /// Legs long enough for `density` texels per unit length; the triangle's longest side faces the lattice's origin.
    fn new(corners: [Vec3; 3], density: f32) -> Self {
        let side = |i: usize| corners[(i + 1) % 3].distance(corners[(i + 2) % 3]);
        let origin = (0..3).fold(0, |best, i| if side(i) > side(best) { i } else { best });
        if side(origin) * density <= 1.0 {
            return Self::default();
        }
        let (mut b, mut c) = ((origin + 1) % 3, (origin + 2) % 3);
        if corners[origin].distance(corners[b]) < corners[origin].distance(corners[c]) {
            std::mem::swap(&mut b, &mut c);
        }
        let cells = |leg: usize| {
            let wanted = corners[origin].distance(corners[leg]) * density;
            // Also where the wish is not a number.
            wanted.ceil().max(1.0).min((LARGEST_SIDE / 4) as f32) as u32
        };
        Self {
            n: cells(b),
            m: cells(c),
            corners: [origin as u8, b as u8, c as u8],
        }
    }

    fn is_single(self) -> bool {
        self.m == 0
    }

    /// Last column with a texel in row `j` (0 ≤ j ≤ m): the cells of the row before reach as far as the triangle does there.
    fn reach(self, j: u32) -> u32 {
        if self.is_single() {
            return 0;
        }
        (self.n * (self.m + 1 - j.max(1))).div_ceil(self.m)
    }

    /// Last column inside the triangle in row `j`.
    fn inside(self, j: u32) -> u32 {
        if self.is_single() {
            return 0;
        }
        self.n * (self.m - j) / self.m
    }

    /// Size of the rectangle that two such triangles share.
    fn rectangle(self) -> (u32, u32) {
        if self.is_single() {
            return (2, 1);
        }
        (self.n + self.n.div_ceil(self.m) + 3, self.m + 2)
    }

    /// Weights of the triangle's second and third corner at a lattice point, moved to the long side if beyond.
    fn barycentric(self, i: u32, j: u32) -> Vec2 {
        if self.is_single() {
            return Vec2::splat(1.0 / 3.0);
        }
        let (mut a, mut b) = (i as f32 / self.n as f32, j as f32 / self.m as f32);
        let beyond = (a + b - 1.0).max(0.0) * 0.5;
        a = (a - beyond).clamp(0.0, 1.0);
        b = (b - beyond).clamp(0.0, 1.0 - a);
        let mut weights = [0.0; 3];
        weights[self.corners[0] as usize] = 1.0 - a - b;
        weights[self.corners[1] as usize] = a;
        weights[self.corners[2] as usize] = b;
        Vec2::new(weights[1], weights[2])
    }
}

impl Patch {
    fn texel(self, i: u32, j: u32) -> (u32, u32) {
        if self.turned {
            (self.x - i, self.y - j)
        } else {
            (self.x + i, self.y + j)
        }
    }

    fn corner_uvs(self) -> [Vec2; 3] {
        let mut uvs = [Vec2::ZERO; 3];
        if self.cells.is_single() {
            return [Vec2::new(self.x as f32 + 0.5, self.y as f32 + 0.5); 3];
        }
        let ends = [(0, 0), (self.cells.n, 0), (0, self.cells.m)];
        for (corner, (i, j)) in self.cells.corners.into_iter().zip(ends) {
            let (x, y) = self.texel(i, j);
            uvs[corner as usize] = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        }
        uvs
    }

    fn texels(self, triangle: u32, width: u32) -> impl Iterator<Item = Texel> {
        (0..=self.cells.m).flat_map(move |j| {
            (0..=self.cells.reach(j)).map(move |i| {
                let (x, y) = self.texel(i, j);
                Texel {
                    index: y * width + x,
                    triangle,
                    barycentric: self.cells.barycentric(i, j),
                    gutter: i > self.cells.inside(j),
                }
            })
        })
    }
}

/// The order in which triangles get their places: part by part of the surface, so that what lies together there lies together
/// in the texture, and by size within a part, as neighbours in a row should be of one height. Every other part ascends, and
/// heights never jump. `along` holds all triangles along a curve that fills space.
fn packing_order(cells: &[Cells], along: &[u32]) -> Vec<u32> {
    let mut before = 0;
    let part: Vec<usize> = along
        .iter()
        .map(|&t| {
            let (w, h) = cells[t as usize].rectangle();
            before += (w * h / 2).max(1) as usize;
            before / PART
        })
        .collect();
    let mut order: Vec<(usize, i64, u32)> = (along.iter().zip(part))
        .map(|(&t, part)| {
            let Cells { m, n, .. } = cells[t as usize];
            let size = i64::from(m) << 32 | i64::from(n);
            (part, if part % 2 == 0 { -size } else { size }, t)
        })
        .collect();
    order.par_sort_unstable();
    order.into_iter().map(|(_, _, t)| t).collect()
}

/// All triangles along a curve that fills space.
fn along_space_curve(mesh: &Mesh) -> Vec<u32> {
    let (least, most) = mesh.bounds();
    let size = (most - least).max_element().max(f32::MIN_POSITIVE);
    let mut order: Vec<(u32, u32)> = (0..mesh.triangles.len() as u32)
        .into_par_iter()
        .map(|t| {
            let middle = mesh.corners(t).iter().sum::<Vec3>() / 3.0;
            let place = (middle - least) / size * 1023.0;
            (morton::code(place.as_uvec3().to_array()), t)
        })
        .collect();
    order.par_sort_unstable();
    order.into_iter().map(|(_, t)| t).collect()
}

/// The lattices of all triangles packed into one texture in some order: its size and the patches, `None` if it does not fit.
fn pack(cells: &[Cells], order: &[u32]) -> Option<(u32, u32, Vec<Patch>)> {
    let pair_size = |pair: &[u32]| {
        pair.iter()
            .map(|&t| cells[t as usize].rectangle())
            .fold((0, 0), |(w, h), (a, b)| (w.max(a), h.max(b)))
    };
    let (mut area, mut widest) = (0_u64, 1);
    for pair in order.chunks(2) {
        let (w, h) = pair_size(pair);
        area += u64::from(w) * u64::from(h);
        widest = widest.max(w);
    }
    let width = ((area as f64 * 1.01).sqrt().ceil() as u32).max(widest);
    if width > LARGEST_SIDE {
        return None;
    }
    let mut patches = vec![Patch::default(); cells.len()];
    let (mut x, mut y, mut shelf) = (0, 0, 0);
    for pair in order.chunks(2) {
        let (w, h) = pair_size(pair);
        if x + w > width {
            (x, y, shelf) = (0, y + shelf, 0);
        }
        shelf = shelf.max(h);
        for (k, &t) in pair.iter().enumerate() {
            let turned = k == 1;
            patches[t as usize] = Patch {
                x: if turned { x + w - 1 } else { x },
                y: if turned { y + h - 1 } else { y },
                turned,
                cells: cells[t as usize],
            };
        }
        x += w;
    }
    let height = (y + shelf).max(1);
    (height <= LARGEST_SIDE).then_some((width, height, patches))
}

impl Atlas {
    /// A texture for `mesh` with `density[t]` texels per mesh unit on triangle `t`: by the mesh's own texture coordinates
    /// where they are in [0, 1], free of overlap and fine enough, else by the lattice.
    pub fn new(mesh: &Mesh, density: &[f32]) -> Self {
        from_own_uvs(mesh, density).unwrap_or_else(|| Self::lattice(mesh, density))
    }

    /// A texture by the lattice inside every triangle.
    pub fn lattice(mesh: &Mesh, density: &[f32]) -> Self {
        assert_eq!(
            density.len(),
            mesh.triangles.len(),
            "one density per triangle"
        );
        let mut warnings = Vec::new();
        let mut factor = 1.0_f32;
        let along = along_space_curve(mesh);
        let (width, height, patches) = loop {
            let cells: Vec<Cells> = (0..mesh.triangles.len())
                .into_par_iter()
                .map(|t| Cells::new(mesh.corners(t as u32), density[t] * factor))
                .collect();
            let total: f64 = cells
                .iter()
                .map(|c| {
                    let (w, h) = c.rectangle();
                    0.5 * f64::from(w) * f64::from(h)
                })
                .sum();
            let smallest = cells.iter().all(|c| c.is_single());
            if let Some(packed) = pack(&cells, &packing_order(&cells, &along))
                && (total <= MOST_TEXELS || smallest)
            {
                break packed;
            }
            if smallest {
                // Past sixty million triangles not even one texel for each fits: one stands for them all.
                warnings.push(format!(
                    "the mesh has {} triangles, too many for a texture: the object gets a single colour; decimate it",
                    mesh.triangles.len()
                ));
                return Self::single_colour(mesh, warnings);
            }
            factor *= (MOST_TEXELS / total).sqrt().clamp(0.05, 0.9) as f32;
        };
        if factor < 1.0 {
            warnings.push(format!(
                "the texture has {:.0} % of the density that the images ask for along each side: more would not fit \
                 {LARGEST_SIDE} × {LARGEST_SIDE} texels",
                100.0 * factor
            ));
        }
        let texels = patches
            .par_iter()
            .enumerate()
            .flat_map_iter(|(t, patch)| patch.texels(t as u32, width))
            .collect();
        Self {
            width,
            height,
            corner_uvs: patches.par_iter().map(|p| p.corner_uvs()).collect(),
            texels,
            own_uvs: false,
            warnings,
            patches,
        }
    }

    /// The atlas of a stored mesh, for look-ups only: without its list of texels.
    pub fn from_corners(
        width: u32,
        height: u32,
        corner_uvs: Vec<[Vec2; 3]>,
        own_uvs: bool,
    ) -> Self {
        Self {
            width: width.max(1),
            height: height.max(1),
            corner_uvs,
            texels: Vec::new(),
            own_uvs,
            warnings: Vec::new(),
            patches: Vec::new(),
        }
    }

    fn single_colour(mesh: &Mesh, warnings: Vec<String>) -> Self {
        Self {
            width: 1,
            height: 1,
            corner_uvs: vec![[Vec2::splat(0.5); 3]; mesh.triangles.len()],
            texels: vec![Texel {
                index: 0,
                triangle: 0,
                barycentric: Vec2::splat(1.0 / 3.0),
                gutter: false,
            }],
            own_uvs: false,
            warnings,
            patches: Vec::new(),
        }
    }

    /// Number of texels, data or not: the length of every texture of this atlas.
    pub fn len(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Whether the texture is empty: never.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The texture's bilinear value at a point of a triangle, given by the weights of its second and third corner.
    #[inline]
    pub fn sample(&self, texture: &[[f32; 3]], triangle: u32, barycentric: Vec2) -> Vec3 {
        self.taps(triangle, barycentric)
            .into_iter()
            .map(|(texel, weight)| weight * Vec3::from(texture[texel]))
            .sum()
    }

    /// The four texels of a bilinear look-up and their weights, which sum to 1.
    #[inline]
    pub fn taps(&self, triangle: u32, barycentric: Vec2) -> [(usize, f32); 4] {
        let [a, b, c] = self.corner_uvs[triangle as usize];
        let at = a + (b - a) * barycentric.x + (c - a) * barycentric.y - 0.5;
        let (x, right) = Self::cell(at.x, self.width);
        let (y, below) = Self::cell(at.y, self.height);
        let width = self.width as usize;
        let first = y * width + x;
        // A share of zero must not name a texel over the edge.
        let to_right = usize::from(right > 0.0);
        let down = if below > 0.0 { width } else { 0 };
        [
            (first, (1.0 - right) * (1.0 - below)),
            (first + to_right, right * (1.0 - below)),
            (first + down, (1.0 - right) * below),
            (first + down + to_right, right * below),
        ]
    }

    /// The texel before a coordinate and the share of the one after it.
    #[inline]
    fn cell(coordinate: f32, size: u32) -> (usize, f32) {
        let bounded = coordinate.clamp(0.0, (size - 1) as f32);
        let first = (bounded + SNAP).floor();
        let share = bounded - first;
        (first as usize, if share < SNAP { 0.0 } else { share })
    }

    /// Continues a texture linearly into the lattice's gutters, so that a function that is linear on a triangle is
    /// reproduced up to its long side; values stay at or above zero. Gutters of the mesh's own charts keep their values.
    pub fn extend(&self, texture: &mut [[f32; 3]]) {
        assert_eq!(texture.len(), self.len(), "one value per texel");
        let width = self.width as usize;
        for patch in &self.patches {
            let at = |i: u32, j: u32| {
                let (x, y) = patch.texel(i, j);
                y as usize * width + x as usize
            };
            for j in 1..=patch.cells.m {
                let last = patch.cells.inside(j);
                let here = Vec3::from(texture[at(last, j)]);
                let before = Vec3::from(texture[at(last, j - 1)]);
                for i in last + 1..=patch.cells.reach(j) {
                    let beside = Vec3::from(texture[at(i, j - 1)]);
                    texture[at(i, j)] = (here + beside - before).max(Vec3::ZERO).to_array();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::fixtures::bumpy_sphere;

    /// Points of a triangle: corners, edges, and inside.
    fn points(count: u32) -> impl Iterator<Item = Vec2> {
        (0..count).map(move |k| {
            let a = k as f32 * 0.618_034 % 1.0;
            let b = (k as f32 * 0.324_72 + 0.1) % 1.0;
            match k % 5 {
                0 => Vec2::new(a, 0.0),
                1 => Vec2::new(0.0, a),
                2 => Vec2::new(a, 1.0 - a),
                3 if k < 20 => [Vec2::ZERO, Vec2::X, Vec2::Y][k as usize % 3],
                _ if a + b > 1.0 => Vec2::new(1.0 - a, 1.0 - b),
                _ => Vec2::new(a, b),
            }
        })
    }

    /// A sphere without texture coordinates, with slivers and triangles of many sizes, and densities that differ.
    fn uneven() -> (Mesh, Vec<f32>) {
        let mut mesh = bumpy_sphere(20, 0.2);
        mesh.uvs.clear();
        let density = (0..mesh.triangles.len())
            .map(|t| 1.0 + (t % 97) as f32 * 2.0)
            .collect();
        (mesh, density)
    }

    #[test]
    fn a_look_up_reads_texels_of_its_own_triangle_only() {
        let (mesh, density) = uneven();
        let atlas = Atlas::new(&mesh, &density);
        assert!(!atlas.own_uvs);
        let mut owner = vec![u32::MAX; atlas.len()];
        for texel in &atlas.texels {
            assert_eq!(
                owner[texel.index as usize],
                u32::MAX,
                "texel {} has two owners",
                texel.index
            );
            owner[texel.index as usize] = texel.triangle;
        }
        for t in 0..mesh.triangles.len() as u32 {
            for barycentric in points(60) {
                let mut sum = 0.0;
                for (texel, weight) in atlas.taps(t, barycentric) {
                    assert_eq!(owner[texel], t, "triangle {t} at {barycentric}");
                    sum += weight;
                }
                assert!((sum - 1.0).abs() < 1e-5, "weights sum to {sum}");
            }
        }
    }

    /// A linear function of position, positive on the sphere.
    fn linear(position: Vec3) -> Vec3 {
        Vec3::new(
            3.0 + position.x,
            5.0 + position.y - 2.0 * position.z,
            4.0 + position.element_sum(),
        )
    }

    fn largest_error(mesh: &Mesh, atlas: &Atlas) -> f32 {
        let mut texture = vec![[f32::NAN; 3]; atlas.len()];
        for texel in &atlas.texels {
            let position = mesh.point(texel.triangle, texel.barycentric).position;
            texture[texel.index as usize] = linear(position).to_array();
        }
        atlas.extend(&mut texture);
        let mut worst = 0.0_f32;
        let single = |t: u32| {
            let patch = atlas.patches.get(t as usize);
            patch.is_some_and(|patch| patch.cells.is_single())
        };
        for t in (0..mesh.triangles.len() as u32).filter(|&t| !single(t)) {
            for barycentric in points(40) {
                let expected = linear(mesh.point(t, barycentric).position);
                let error = (atlas.sample(&texture, t, barycentric) - expected)
                    .abs()
                    .max_element();
                // NaN, from a texel without data, must not hide.
                worst = if error >= worst || error.is_nan() {
                    error
                } else {
                    worst
                };
            }
        }
        worst
    }

    #[test]
    fn the_lattice_reproduces_linear_functions() {
        let (mesh, density) = uneven();
        let error = largest_error(&mesh, &Atlas::new(&mesh, &density));
        assert!(error < 1e-4, "off by {error}");
    }

    #[test]
    fn valid_texture_coordinates_are_used_and_hold_linear_functions() {
        let mut mesh = bumpy_sphere(40, 0.0);
        for uv in &mut mesh.uvs {
            *uv = 0.05 + 0.9 * *uv;
        }
        let atlas = Atlas::new(&mesh, &vec![60.0; mesh.triangles.len()]);
        assert!(atlas.own_uvs);
        let error = largest_error(&mesh, &atlas);
        // Beyond the seam the texture stands still for up to a texel's length.
        assert!(error < 0.05, "off by {error}");
    }

    #[test]
    fn bad_texture_coordinates_are_not_used() {
        let good = bumpy_sphere(40, 0.0);
        let density = vec![60.0; good.triangles.len()];
        for name in ["outside", "folded", "one point", "a line", "not a number"] {
            let mut mesh = good.clone();
            for uv in &mut mesh.uvs {
                *uv = match name {
                    "outside" => *uv * 1.2,
                    "folded" => Vec2::new((uv.x - 0.5).abs(), uv.y),
                    "one point" => Vec2::splat(0.5),
                    "a line" => Vec2::new(uv.x, 0.5),
                    _ => Vec2::NAN,
                };
            }
            assert!(!Atlas::new(&mesh, &density).own_uvs, "{name}");
        }
    }

    #[test]
    fn density_follows_the_wish() {
        let (mesh, _) = uneven();
        for wanted in [5.0, 50.0, 400.0] {
            let atlas = Atlas::lattice(&mesh, &vec![wanted; mesh.triangles.len()]);
            for t in 0..mesh.triangles.len() {
                let space = mesh.corners(t as u32);
                let uv = atlas.corner_uvs[t];
                if atlas.patches[t].cells.is_single() {
                    let longest = (0..3).map(|i| space[i].distance(space[(i + 1) % 3]));
                    assert!(longest.fold(0.0, f32::max) * wanted <= 1.0, "triangle {t}");
                    continue;
                }
                for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                    let texels = uv[i].distance(uv[j]);
                    let length = space[i].distance(space[j]);
                    assert!(
                        texels >= 0.7 * wanted * length,
                        "triangle {t}: {texels} for {length}"
                    );
                    assert!(
                        texels <= 1.5 * wanted * length + 3.0,
                        "triangle {t}: {texels} for {length}"
                    );
                }
            }
        }
    }

    #[test]
    fn triangles_smaller_than_texels_take_one_each() {
        let mesh = bumpy_sphere(100, 0.1);
        let count = mesh.triangles.len();
        let atlas = Atlas::lattice(&mesh, &vec![5.0; count]);
        assert_eq!(atlas.texels.len(), count);
        assert!(atlas.len() < count * 11 / 10, "{} texels", atlas.len());
        let texture: Vec<[f32; 3]> = (0..atlas.len()).map(|i| [i as f32; 3]).collect();
        for texel in &atlas.texels {
            let value = atlas.sample(&texture, texel.triangle, Vec2::new(0.9, 0.05));
            assert_eq!(value.x, texel.index as f32);
        }
    }

    #[test]
    fn one_triangle_and_very_many_texels_fit() {
        let one = Mesh {
            origin: glam::DVec3::ZERO,
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            normals: vec![Vec3::Z; 3],
            uvs: Vec::new(),
            triangles: vec![[0, 1, 2]],
        };
        for density in [0.0, 1.0, 700.0, 1e9, f32::NAN, f32::INFINITY] {
            let atlas = Atlas::new(&one, &[density]);
            assert!(
                atlas.width <= LARGEST_SIDE && atlas.height <= LARGEST_SIDE,
                "{density}"
            );
            assert!(largest_error(&one, &atlas) < 1e-3, "{density}");
        }
        let mesh = bumpy_sphere(40, 0.1);
        let atlas = Atlas::lattice(&mesh, &vec![5000.0; mesh.triangles.len()]);
        assert!(
            atlas.texels.len() < 40_000_000,
            "{} texels",
            atlas.texels.len()
        );
        assert_eq!(atlas.warnings.len(), 1);
        assert!(Atlas::new(&Mesh::default(), &[]).texels.is_empty());
    }
}
