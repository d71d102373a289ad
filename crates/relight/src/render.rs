//! The reference renderer: any camera, any lighting, on the CPU.
//!
//! A pixel is the mean over its area before a black background. The diffuse texture is read at every sub-sample; specular
//! radiance and irradiance vary slowly, so they are computed once for all sub-samples of a pixel that lie on one
//! smooth piece of surface, and for each quarter of the pixel where a shadow's edge passes.

use std::ops::{ControlFlow, Range};

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use smallvec::{SmallVec, smallvec};

use super::reflection::Surroundings;
use super::samples::{Sample, Samples, bands};
use super::shading::{Draw, Shade, Shader, ShadingPoint, Visibility, corners, is_coarse};
use super::triangle_shares::TriangleShares;
use rekindle_capture::{Camera, Mesh};
use rekindle_scene::reflectance::{Brdf, Gloss};
use rekindle_scene::surface::{Atlas, GlossTexture, Occluder};

/// Sub-samples along each side of a pixel.
const FACTOR: u32 = 4;
/// Pixels along each side of a tile, the unit of work.
pub(super) const TILE: usize = 32;
/// Neighbouring pixels whose seen part of a lamp differs by more have a shadow's edge between them.
const EDGE_SHARE: f32 = 0.02;
/// Normals of one smooth piece differ by at most this part of the roughness …
const PIECE_ROUGHNESS: f32 = 0.4;
/// … and at most this angle, radians.
const PIECE_ANGLE: f32 = 0.1;
/// Pixels along each side of the largest block that may be one smooth piece for a texture.
const BLOCK: usize = 4;

/// The object as the renderer needs it.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    /// The surface.
    pub mesh: &'a Mesh,
    /// The same mesh's.
    pub occluder: &'a Occluder,
    /// The surface's reflection, `None` without a specular part.
    pub brdf: Option<Brdf>,
    /// How the lobe differs from place to place; `None` where it doesn't.
    pub gloss: Option<GlossMap<'a>>,
    /// The surface as it lights itself, `None` to leave that out.
    pub surroundings: Option<&'a Surroundings<'a>>,
}

/// The gloss of a surface's places.
#[derive(Clone, Copy)]
pub struct GlossMap<'a> {
    /// Where each triangle lies in the texture.
    pub atlas: &'a Atlas,
    /// The gloss of every texel.
    pub texture: &'a GlossTexture,
}

impl Scene<'_> {
    /// The point of a triangle at the weights of its second and third corner, with its gloss.
    pub fn point(&self, triangle: u32, barycentric: Vec2) -> ShadingPoint {
        let point = ShadingPoint::on(self.mesh, triangle, barycentric);
        point.with_gloss(self.gloss_at(triangle, barycentric))
    }

    /// How the lobe differs from the main one at a point of a triangle.
    pub fn gloss_at(&self, triangle: u32, barycentric: Vec2) -> Gloss {
        self.gloss.map_or(Gloss::MAIN, |map| {
            map.texture.at(map.atlas, triangle, barycentric)
        })
    }

    /// Whether parts of the surface are metals, and not all of it.
    pub(super) fn has_metals_beside(&self) -> bool {
        let strongest = self.gloss.map_or(1.0, |map| map.texture.strongest());
        let strongest = Gloss::new(1.0, strongest);
        (self.brdf).is_some_and(|main| main.has_metal_beside(&main.at(strongest)))
    }

    /// Whether the surface is a metal at a texel.
    pub(super) fn is_metal(&self, texel: usize) -> bool {
        let gloss = self
            .gloss
            .map_or(Gloss::MAIN, |map| map.texture.texels()[texel]);
        self.is_metal_of(gloss)
    }

    /// Whether the surface is a metal where it has this gloss.
    fn is_metal_of(&self, gloss: Gloss) -> bool {
        self.brdf.is_some_and(|brdf| brdf.at(gloss).is_metal())
    }

    /// How much of the diffusely reflected light passes the surface where it has this gloss, towards a viewer at the cosine
    /// `cos`, as a ratio to normal exitance.
    pub fn diffuse_exit(&self, gloss: Gloss, cos: f32) -> f32 {
        self.brdf.map_or(1.0, |b| b.at(gloss).diffuse_exit(cos))
    }

    /// Roughness of the narrowest lobe, radians; infinite without any.
    fn narrowest(&self) -> f32 {
        let narrowest = self.gloss.map_or(1.0, |map| map.texture.narrowest());
        self.brdf.map_or(f32::INFINITY, |b| narrowest * b.sigma)
    }
}

/// Where a picture's diffuse part comes from.
#[derive(Clone, Copy)]
pub enum Diffuse<'a> {
    /// There is none.
    Absent,
    /// The stored diffuse texture: the light is as it was.
    Stored(&'a Atlas, &'a [[f32; 3]]),
    /// Pseudo-albedo × irradiance (eq. 18).
    Relit(&'a Atlas, &'a [[f32; 3]]),
}

/// A rendered picture, row by row from the top; linear radiance, premultiplied by coverage.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Part of each pixel that the object covers.
    pub coverage: Vec<f32>,
    /// Diffuse part.
    pub diffuse: Vec<[f32; 3]>,
    /// Specular part.
    pub specular: Vec<[f32; 3]>,
}

/// Says, asked from any thread, whether to break off.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// A pixel's sub-samples on one smooth piece of surface.
#[derive(Clone, Copy)]
struct Piece {
    point: ShadingPoint,
    /// One of its samples.
    sample: Sample,
    /// One bit per sub-sample, in the order of the pixel's samples.
    members: u64,
}

/// Those of a pixel, the largest first: one but for the pixels at edges.
type Pieces = SmallVec<[Piece; 1]>;

/// A pixel before it is written.
#[derive(Clone, Copy, Default)]
struct Pixel {
    coverage: f32,
    diffuse: Vec3,
    specular: Vec3,
}

impl Pixel {
    /// A dark pixel in which some of so many sub-samples meet the object.
    fn covered_by(samples: usize, full: usize) -> Self {
        Self {
            coverage: samples as f32 * (1.0 / full as f32),
            ..Self::default()
        }
    }
}

/// Some rows of a picture, pixel by pixel from the left of the first row.
pub struct Band<'a> {
    /// Rows of the picture.
    pub rows: Range<usize>,
    /// What the pixels show of the surface.
    pub samples: &'a Samples,
    /// Part of each pixel that the object covers.
    pub coverage: Vec<f32>,
    /// Diffuse part, premultiplied by coverage.
    pub diffuse: Vec<[f32; 3]>,
    /// Specular part, premultiplied by coverage.
    pub specular: Vec<[f32; 3]>,
}

/// Renders a picture band by band from the top, so that no more than a band is ever held. Breaks off soon after `stop` says
/// so, and where `each` does.
pub fn render_bands(
    scene: &Scene,
    camera: &Camera,
    shader: &Shader,
    diffuse: Diffuse,
    stop: Stop,
    each: &mut dyn FnMut(&Band) -> ControlFlow<()>,
) -> ControlFlow<()> {
    for rows in bands(camera, FACTOR) {
        if stop() {
            return ControlFlow::Break(());
        }
        let samples = Samples::trace(
            scene.mesh,
            scene.occluder,
            camera,
            rows.clone(),
            FACTOR,
            &|_, _| true,
            stop,
        );
        if stop() {
            return ControlFlow::Break(());
        }
        let pixels = render_band(scene, camera, shader, diffuse, &samples, stop);
        if stop() {
            return ControlFlow::Break(());
        }
        each(&Band {
            rows,
            samples: &samples,
            coverage: pixels.iter().map(|p| p.coverage).collect(),
            diffuse: pixels.iter().map(|p| p.diffuse.to_array()).collect(),
            specular: pixels.iter().map(|p| p.specular.to_array()).collect(),
        })?;
    }
    ControlFlow::Continue(())
}

/// Renders a picture.
pub fn render(scene: &Scene, camera: &Camera, shader: &Shader, diffuse: Diffuse) -> Picture {
    let mut picture = Picture {
        width: camera.width,
        height: camera.height,
        coverage: Vec::new(),
        diffuse: Vec::new(),
        specular: Vec::new(),
    };
    let all = render_bands(scene, camera, shader, diffuse, &|| false, &mut |band| {
        picture.coverage.extend_from_slice(&band.coverage);
        picture.diffuse.extend_from_slice(&band.diffuse);
        picture.specular.extend_from_slice(&band.specular);
        ControlFlow::Continue(())
    });
    debug_assert!(all.is_continue(), "nothing stops it");
    picture
}

/// Calls `each` for every tile that `samples` cover, with the place of its first pixel in the band, its size and its pixels'
/// specular radiance, premultiplied by coverage; the results are in the tiles' order. `triangles` tells what these see of the
/// light.
pub(super) fn specular_tiles<T: Send>(
    scene: &Scene,
    camera: &Camera,
    shader: &Shader,
    triangles: &TriangleShares,
    samples: &Samples,
    each: impl Fn([usize; 2], [usize; 2], &[Vec3]) -> T + Sync,
) -> Vec<T> {
    let light = Light {
        shader,
        triangles: Some(triangles),
    };
    let each = |corner, size, pixels: Vec<Pixel>| {
        let specular: Vec<Vec3> = pixels.iter().map(|p| p.specular).collect();
        each(corner, size, &specular)
    };
    let diffuse = Diffuse::Absent;
    render_tiles(scene, camera, light, diffuse, samples, &|| false, each)
}

fn render_band(
    scene: &Scene,
    camera: &Camera,
    shader: &Shader,
    diffuse: Diffuse,
    samples: &Samples,
    stop: Stop,
) -> Vec<Pixel> {
    let light = Light {
        shader,
        triangles: None,
    };
    let each = |corner, size, pixels| (corner, size, pixels);
    let tiles: Vec<([usize; 2], [usize; 2], Vec<Pixel>)> =
        render_tiles(scene, camera, light, diffuse, samples, stop, each);
    let width = samples.width;
    let mut band = vec![Pixel::default(); width * samples.rows.len()];
    for ([x, y], [tile_width, _], pixels) in &tiles {
        for (row, line) in pixels.chunks(*tile_width).enumerate() {
            let start = (y + row) * width + x;
            band[start..start + tile_width].copy_from_slice(line);
        }
    }
    band
}

/// Light on the surface.
#[derive(Clone, Copy)]
struct Light<'a> {
    shader: &'a Shader<'a>,
    /// What triangles see of it, where that is known beforehand.
    triangles: Option<&'a TriangleShares>,
}

/// Renders the tiles of a band and calls `each` for every one, with the place of its first pixel in the band and its size.
fn render_tiles<T: Send>(
    scene: &Scene,
    camera: &Camera,
    light: Light,
    diffuse: Diffuse,
    samples: &Samples,
    stop: Stop,
    each: impl Fn([usize; 2], [usize; 2], Vec<Pixel>) -> T + Sync,
) -> Vec<T> {
    let (width, height) = (samples.width, samples.rows.len());
    let columns = width.div_ceil(TILE);
    (0..columns * height.div_ceil(TILE))
        .into_par_iter()
        .map(|tile| {
            let corner = [tile % columns * TILE, tile / columns * TILE];
            let size = [TILE.min(width - corner[0]), TILE.min(height - corner[1])];
            if stop() || light.shader.is_stopped() {
                return each(corner, size, vec![Pixel::default(); size[0] * size[1]]);
            }
            let tile = Tile {
                scene,
                shader: light.shader,
                triangles: light.triangles,
                samples,
                corner,
                size,
                eye: camera.position().as_vec3(),
                footprint: (1.0 / camera.focal.min_element()) as f32,
                relit: matches!(diffuse, Diffuse::Relit(..)),
            };
            each(corner, size, tile.render(diffuse))
        })
        .collect()
}

/// A rectangle of pixels.
struct Tile<'a> {
    scene: &'a Scene<'a>,
    shader: &'a Shader<'a>,
    /// What triangles see of the light, where that is known beforehand.
    triangles: Option<&'a TriangleShares>,
    samples: &'a Samples,
    corner: [usize; 2],
    size: [usize; 2],
    /// The camera's position.
    eye: Vec3,
    /// A pixel's size at unit distance.
    footprint: f32,
    /// Whether the irradiance is wanted, and so the visibility of lamps outside the lobe.
    relit: bool,
}

impl Tile<'_> {
    fn samples_of(&self, index: usize) -> &[Sample] {
        let (x, y) = (index % self.size[0], index / self.size[0]);
        self.samples
            .of((self.corner[1] + y) * self.samples.width + self.corner[0] + x)
    }

    fn view(&self, point: &ShadingPoint) -> Vec3 {
        (self.eye - point.position).normalize_or(point.normal)
    }

    fn render(&self, diffuse: Diffuse) -> Vec<Pixel> {
        let count = self.size[0] * self.size[1];
        if (0..count).all(|i| self.samples_of(i).is_empty()) {
            return vec![Pixel::default(); count];
        }
        let pieces: Vec<Pieces> = (0..count)
            .map(|i| self.pieces(self.samples_of(i)))
            .collect();
        let mains: Vec<Option<ShadingPoint>> = pieces
            .iter()
            .map(|p| p.first().map(|piece| piece.point))
            .collect();
        let distance = mains
            .iter()
            .flatten()
            .map(|p| p.position.distance(self.eye))
            .fold(f32::INFINITY, f32::min);
        let groups = self.shader.groups();
        let needed: Vec<bool> = mains
            .iter()
            .map(|main| main.as_ref().map(|p| (p, self.view(p))))
            .flat_map(|main| (0..groups).map(move |g| (main, g)))
            .map(|(main, g)| main.is_some_and(|(p, view)| self.is_lit(g, p, view)))
            .collect();
        let wanted = |index: usize, group: usize| needed[index * groups + group];
        let told = |index: usize, group: usize| self.told(pieces[index].first()?, group);
        let spacing = distance * self.footprint;
        let visibility = self
            .shader
            .visibility(&mains, self.size[0], spacing, &wanted, &told);
        let mirrored = self.mirrored(&pieces, &mains, spacing);
        let sky = self.sky_of_blocks(&pieces);
        (0..count)
            .map(|index| {
                let samples = self.samples_of(index);
                let Some(main) = &mains[index] else {
                    return Pixel::default();
                };
                let mut pixel = Pixel::covered_by(samples.len(), self.samples.full());
                let mut add = |mut shade: Shade, piece: &Piece| {
                    if let Some(&mirrored) = mirrored.get(index) {
                        shade.specular += self.reflected(piece, main, mirrored);
                    }
                    let is_main = std::ptr::eq(piece, &raw const pieces[index][0]);
                    let shared = sky.get(index).copied().flatten().filter(|_| is_main);
                    let own = || self.of_sky(piece, self.draw(piece, index));
                    shade.specular += shared.unwrap_or_else(own);
                    self.add(&mut pixel, samples, &shade, piece, diffuse);
                };
                let seen = &visibility[index * groups..(index + 1) * groups];
                let (first, others) = (&pieces[index][0], &pieces[index][1..]);
                let edges = self.shadow_edges(&mains, &visibility, index, &wanted);
                let is_cut = edges.contains(&true);
                if is_cut {
                    let alike = |g: usize| wanted(index, g) && !edges[g];
                    // A pixel of one sample has no quarters: what was cast for it holds.
                    let cast =
                        |g: usize| matches!(seen[g], Visibility::Part(_)) && samples.len() == 1;
                    let known = |g: usize| (alike(g) || cast(g)).then(|| seen[g].clone());
                    for quarter in self.quarters(first, samples) {
                        add(self.shade_with(&quarter.point, known), &quarter);
                    }
                } else {
                    add(self.shade(&first.point, seen), first);
                }
                // Smooth light is on other surfaces as on the pixel's main one, shadows are not.
                let known = |piece: &Piece, g: usize| {
                    let smooth = || {
                        let is_smooth = matches!(seen[g], Visibility::Fraction(_));
                        (is_smooth && !self.shader.is_sharp(g)).then(|| seen[g].clone())
                    };
                    self.told(piece, g).or_else(smooth)
                };
                for piece in others {
                    if is_cut {
                        for quarter in self.quarters(piece, samples) {
                            let known = |g| known(&quarter, g);
                            add(self.shade_with(&quarter.point, known), &quarter);
                        }
                    } else {
                        add(self.shade_with(&piece.point, |g| known(piece, g)), piece);
                    }
                }
                pixel
            })
            .collect()
    }

    /// For every pixel's main piece, the radiance of other parts of the surface that its lobe meets. Cast for
    /// every fourth pixel in each direction and interpolated where the surface between them is smooth, but in pictures of a metal at
    /// every pixel.
    fn mirrored(
        &self,
        pieces: &[Pieces],
        mains: &[Option<ShadingPoint>],
        spacing: f32,
    ) -> Vec<Vec3> {
        let Some(surroundings) = self.scene.surroundings else {
            return Vec::new();
        };
        let [width, height] = self.size;
        let cast = |index: usize| {
            let piece = pieces[index].first()?;
            let Sample {
                triangle,
                barycentric,
                ..
            } = piece.sample;
            let sheltered = surroundings.is_sheltered(self.scene.mesh, triangle, barycentric);
            Some(if sheltered {
                self.cast_mirrored(&piece.point, index)
            } else {
                Vec3::ZERO
            })
        };
        // Highlights in what a metal mirrors are narrow, and a picture would show that they were interpolated.
        let is_metal = |i: usize| {
            let main = mains[i].as_ref();
            main.is_some_and(|point| surroundings.is_metal(point.gloss))
        };
        let is_cast = |&i: &usize| {
            let all_cast = is_metal(i) && self.triangles.is_none();
            all_cast || is_coarse([i % width, i / width], [width, height])
        };
        let mut all = vec![Vec3::ZERO; mains.len()];
        for index in (0..mains.len()).filter(is_cast) {
            all[index] = cast(index).unwrap_or_default();
        }
        for index in (0..mains.len()).filter(|i| !is_cast(i)) {
            let mut corners = corners(
                mains,
                [width, height],
                [index % width, index / width],
                spacing,
                self.same_mirror_cos(),
            );
            corners.retain(|corner| is_metal(corner.0) == is_metal(index));
            let shares: f32 = corners.iter().map(|c| c.1).sum();
            all[index] = if corners.len() >= 3 && shares > 0.5 {
                let sum: Vec3 = corners
                    .iter()
                    .map(|&(corner, share)| all[corner] * share)
                    .sum();
                sum / shares
            } else {
                cast(index).unwrap_or_default()
            };
        }
        all
    }

    /// What a point mirrors of the surface, its rays turned by the number of a pixel.
    fn cast_mirrored(&self, point: &ShadingPoint, pixel: usize) -> Vec3 {
        self.scene.surroundings.map_or(Vec3::ZERO, |s| {
            s.mirrored(self.scene, self.shader, point, (self.view(point), pixel))
        })
    }

    /// Specular reflection of other parts of the surface by a piece, from what its pixel's main piece mirrors.
    fn reflected(&self, piece: &Piece, main: &ShadingPoint, mirrored: Vec3) -> Vec3 {
        let Some(surroundings) = self.scene.surroundings else {
            return Vec3::ZERO;
        };
        let thickness = self.footprint * main.position.distance(self.eye);
        let alike = piece.point.normal.dot(main.normal) > self.same_mirror_cos()
            && piece.point.position.distance(main.position) < 4.0 * thickness
            && surroundings.is_metal(piece.point.gloss) == surroundings.is_metal(main.gloss);
        let mirrored = if alike {
            mirrored
        } else {
            self.cast_mirrored(&piece.point, 0)
        };
        let cos_view = piece.point.normal.dot(self.view(&piece.point));
        mirrored * surroundings.reflectance(piece.point.gloss, cos_view)
    }

    /// What the main pieces of pixels mirror of an environment's sky, for a texture: blocks of them that are one smooth piece are looked at
    /// together. Nothing of those that are to be looked at one by one.
    fn sky_of_blocks(&self, pieces: &[Pieces]) -> Vec<Option<Vec3>> {
        if self.triangles.is_none() || !self.shader.shows_sky() {
            return Vec::new();
        }
        let mut shared = vec![None; pieces.len()];
        for y in (0..self.size[1]).step_by(BLOCK) {
            for x in (0..self.size[0]).step_by(BLOCK) {
                self.share_sky([x, y], BLOCK, pieces, &mut shared);
            }
        }
        shared
    }

    /// The same of one block, or of its quarters.
    fn share_sky(
        &self,
        [x, y]: [usize; 2],
        side: usize,
        pieces: &[Pieces],
        shared: &mut [Option<Vec3>],
    ) {
        let [width, height] = self.size;
        let rows = y..(y + side).min(height);
        let pixels = rows.flat_map(|row| (x..(x + side).min(width)).map(move |x| row * width + x));
        let block: SmallVec<[usize; BLOCK * BLOCK]> =
            pixels.filter(|&i| !pieces[i].is_empty()).collect();
        if block.len() < 2 {
            return;
        }
        if let Some(joined) = self.joined(&block, pieces, side) {
            // Four half vectors a pixel.
            let draw = if side == BLOCK {
                Draw::Whole
            } else {
                Draw::Few((y * width / side + x) / side)
            };
            let radiance = self.of_sky(&joined, draw);
            for i in block {
                shared[i] = Some(radiance);
            }
        } else if side > 2 {
            let half = side / 2;
            for [right, down] in [[0, 0], [half, 0], [0, half], [half, half]] {
                self.share_sky([x + right, y + down], half, pieces, shared);
            }
        }
    }

    /// The main pieces of a block's pixels as one, if they are smooth together and no metal.
    fn joined(&self, block: &[usize], pieces: &[Pieces], side: usize) -> Option<Piece> {
        let points = || block.iter().map(|&i| &pieces[i][0].point);
        let middle = &pieces[block[block.len() / 2]][0];
        let ShadingPoint {
            position,
            face_normal,
            gloss,
            ..
        } = middle.point;
        let normal: Vec3 = points().map(|point| point.normal).sum();
        let normal = normal.normalize_or(middle.point.normal);
        let thickness = side as f32 * self.footprint * position.distance(self.eye);
        let is_smooth = !self.scene.is_metal_of(gloss)
            && points().all(|point| {
                let height = (point.position - position).dot(face_normal).abs();
                point.normal.dot(normal) > self.piece_cos()
                    && height < thickness
                    && point.gloss == gloss
            });
        is_smooth.then_some(Piece {
            point: ShadingPoint {
                normal,
                ..middle.point
            },
            ..*middle
        })
    }

    /// What a piece mirrors of an environment's sky.
    fn of_sky(&self, piece: &Piece, draw: Draw) -> Vec3 {
        if !self.shader.shows_sky() {
            return Vec3::ZERO;
        }
        let Sample {
            triangle,
            barycentric,
            ..
        } = piece.sample;
        let is_sheltered = (self.scene.surroundings)
            .is_none_or(|s| s.is_sheltered(self.scene.mesh, triangle, barycentric));
        let view = self.view(&piece.point);
        self.shader
            .specular_of_sky(&piece.point, view, is_sheltered, draw)
    }

    /// How closely a pixel's piece is looked at. A texture is the mean of many pixels; of a metal all that they show is this.
    fn draw(&self, piece: &Piece, pixel: usize) -> Draw {
        if self.triangles.is_some() && !self.scene.is_metal_of(piece.point.gloss) {
            Draw::Few(pixel)
        } else {
            Draw::Whole
        }
    }

    /// Cosine of the largest angle between normals that mirror much the same: the mirrored direction turns by twice that
    /// angle, and the lobe is some 4σ wide.
    fn same_mirror_cos(&self) -> f32 {
        (2.0 * self.scene.narrowest()).min(0.3).cos()
    }

    /// Adds the sub-samples of one of a pixel's pieces.
    fn add(
        &self,
        pixel: &mut Pixel,
        samples: &[Sample],
        shade: &Shade,
        piece: &Piece,
        diffuse: Diffuse,
    ) {
        let share = 1.0 / self.samples.full() as f32;
        pixel.specular += shade.specular * (piece.members.count_ones() as f32 * share);
        let (atlas, texture, light, indirect) = match diffuse {
            Diffuse::Absent => return,
            Diffuse::Stored(atlas, texture) => (atlas, texture, Vec3::ONE, None),
            Diffuse::Relit(atlas, albedo) => {
                (atlas, albedo, shade.irradiance, self.scene.surroundings)
            }
        };
        let cos_view = piece.point.normal.dot(self.view(&piece.point));
        let through = self.scene.diffuse_exit(piece.point.gloss, cos_view);
        let mut sum = Vec3::ZERO;
        for (i, sample) in samples.iter().enumerate() {
            if piece.members >> i & 1 == 1 {
                let around = indirect.map_or(Vec3::ZERO, |indirect| {
                    indirect.irradiance(self.scene.mesh, sample.triangle, sample.barycentric)
                });
                sum +=
                    atlas.sample(texture, sample.triangle, sample.barycentric) * (light + around);
            }
        }
        pixel.diffuse += sum * (share * through);
    }

    fn point(&self, sample: &Sample) -> ShadingPoint {
        self.scene.point(sample.triangle, sample.barycentric)
    }

    /// Groups a pixel's samples into smooth pieces, the largest first.
    fn pieces(&self, samples: &[Sample]) -> Pieces {
        let [first, others @ ..] = samples else {
            return Pieces::new();
        };
        if others.is_empty() {
            return smallvec![Piece {
                point: self.point(first),
                sample: *first,
                members: 1,
            }];
        }
        if samples.iter().all(|s| s.triangle == first.triangle) {
            let sum: Vec2 = samples.iter().map(|s| s.barycentric).sum();
            let mean = Sample {
                barycentric: sum / samples.len() as f32,
                ..*first
            };
            let point = self.point(&mean);
            // One flat triangle may still be seen so nearly edge-on, or bend its normals so far, that it is no one
            // piece; then it falls through.
            let ends = [
                self.point(first).normal,
                self.point(&samples[samples.len() - 1]).normal,
            ];
            if ends.iter().all(|n| n.dot(point.normal) > self.piece_cos()) {
                return smallvec![Piece {
                    point,
                    sample: mean,
                    members: bits(samples.len()),
                }];
            }
        }
        let points: Vec<ShadingPoint> = samples.iter().map(|s| self.point(s)).collect();
        let mut left = bits(samples.len());
        let mut pieces = Pieces::new();
        let mut seed = samples.len() / 2;
        while left != 0 {
            if left >> seed & 1 == 0 {
                seed = left.trailing_zeros() as usize;
            }
            let centre = points[seed];
            let thickness = self.footprint * centre.position.distance(self.eye);
            let (mut members, mut normal) = (0_u64, Vec3::ZERO);
            for (i, p) in points
                .iter()
                .enumerate()
                .filter(|(i, _)| left >> i & 1 == 1)
            {
                let height = (p.position - centre.position).dot(centre.face_normal).abs();
                if i == seed
                    || (p.normal.dot(centre.normal) > self.piece_cos() && height < thickness)
                {
                    members |= 1 << i;
                    normal += p.normal;
                }
            }
            left &= !members;
            pieces.push(Piece {
                point: ShadingPoint {
                    normal: normal.normalize_or(centre.normal),
                    ..centre
                },
                sample: samples[seed],
                members,
            });
        }
        pieces.sort_by_key(|p| std::cmp::Reverse(p.members.count_ones()));
        pieces
    }

    /// Cosine of the largest angle between normals of one piece.
    fn piece_cos(&self) -> f32 {
        (PIECE_ROUGHNESS * self.scene.narrowest())
            .min(PIECE_ANGLE)
            .cos()
    }

    /// Cuts a pixel's piece into the quarters of the pixel.
    fn quarters(&self, piece: &Piece, samples: &[Sample]) -> SmallVec<[Piece; 4]> {
        let (factor, half) = (
            self.samples.factor as usize,
            (self.samples.factor / 2) as usize,
        );
        let mut cut = SmallVec::new();
        for quarter in 0..4 {
            let mut members = 0_u64;
            let mut sum = Vec3::ZERO;
            for (i, s) in samples.iter().enumerate() {
                let (column, row) = (usize::from(s.slot) % factor, usize::from(s.slot) / factor);
                let here = usize::from(row >= half) * 2 + usize::from(column >= half);
                if piece.members >> i & 1 == 1 && here == quarter {
                    members |= 1 << i;
                    sum += self.point(s).position;
                }
            }
            if members == 0 {
                continue;
            }
            let middle = sum / members.count_ones() as f32;
            let nearest = (0..samples.len())
                .filter(|i| members >> i & 1 == 1)
                .map(|i| (self.point(&samples[i]), samples[i]))
                .min_by(|(a, _), (b, _)| {
                    let d = |p: &ShadingPoint| p.position.distance_squared(middle);
                    d(a).total_cmp(&d(b))
                });
            cut.extend(nearest.map(|(point, sample)| Piece {
                point,
                sample,
                members,
            }));
        }
        cut
    }

    /// Whether the shadow of each group ends in this pixel or between it and a neighbour; none where triangles tell of the
    /// light, as for a texture, which is the mean of many pixels.
    fn shadow_edges(
        &self,
        mains: &[Option<ShadingPoint>],
        visibility: &[Visibility],
        index: usize,
        wanted: &dyn Fn(usize, usize) -> bool,
    ) -> SmallVec<[bool; 16]> {
        if self.triangles.is_some() {
            return SmallVec::new();
        }
        let groups = self.shader.groups();
        let (x, y) = (index % self.size[0], index / self.size[0]);
        let neighbours = [
            (x > 0).then(|| index - 1),
            (x + 1 < self.size[0]).then(|| index + 1),
            (y > 0).then(|| index - self.size[0]),
            (y + 1 < self.size[1]).then(|| index + self.size[0]),
        ];
        let has_edge = |g: usize| {
            if !self.shader.is_sharp(g) || !wanted(index, g) {
                return false;
            }
            let share = |i: usize| visibility[i * groups + g].share(self.shader.nodes(g));
            let here = share(index);
            neighbours.iter().flatten().any(|&n| {
                mains[n].is_some() && wanted(n, g) && (share(n) - here).abs() > EDGE_SHARE
            })
        };
        (0..groups).map(has_edge).collect()
    }

    /// What a piece's triangle tells of a group. Where the lobe shows how the group is spread, it matters which part of it is
    /// hidden.
    fn told(&self, piece: &Piece, group: usize) -> Option<Visibility> {
        let Sample {
            triangle,
            barycentric,
            ..
        } = piece.sample;
        let told = self.triangles?.told(triangle, barycentric, group)?;
        let is_enough = !matches!(told, Visibility::Fraction(_))
            || !self.shader.is_sharp(group)
            || !self
                .shader
                .is_resolved(group, &piece.point, self.view(&piece.point));
        is_enough.then_some(told)
    }

    /// Whether a group may add to what is seen of a point. Of a soft one, of which there are many and mostly in the lobe, it takes
    /// as long to tell as to add it up.
    fn is_lit(&self, group: usize, point: &ShadingPoint, view: Vec3) -> bool {
        let is_soft = self.triangles.is_some()
            && !self.shader.is_sharp(group)
            && !self.shader.is_in_sky(group);
        self.relit || is_soft || self.shader.is_in_lobe(group, point, view)
    }

    /// Shades a point whose visibilities are known.
    fn shade(&self, point: &ShadingPoint, visibility: &[Visibility]) -> Shade {
        if self.relit {
            return self.shader.shade(point, self.view(point), visibility);
        }
        Shade {
            specular: self.shader.specular(point, self.view(point), visibility),
            irradiance: Vec3::ZERO,
        }
    }

    /// Shades a point of which some groups' visibility is known; the others' is found out.
    fn shade_with(
        &self,
        point: &ShadingPoint,
        known: impl Fn(usize) -> Option<Visibility>,
    ) -> Shade {
        let view = self.view(point);
        let visibility: SmallVec<[Visibility; 4]> = (0..self.shader.groups())
            .map(|g| {
                if self.is_lit(g, point, view) {
                    known(g).unwrap_or_else(|| self.shader.cast(point, g))
                } else {
                    Visibility::Below
                }
            })
            .collect();
        self.shade(point, &visibility)
    }
}

/// The lowest `count` bits set.
fn bits(count: usize) -> u64 {
    if count >= 64 {
        u64::MAX
    } else {
        (1 << count) - 1
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Quat};

    use super::*;
    use crate::{LatLong, Lighting};
    use rekindle_scene::reflectance::SpecularModel;
    use rekindle_scene::surface::fixtures::{bumpy_sphere, camera};

    #[test]
    fn a_texture_is_told_of_a_sky_what_a_picture_shows() {
        const SIDE: u32 = 128;
        let mesh = bumpy_sphere(60, 0.05);
        let occluder = Occluder::new(&mesh);
        let window = Vec3::new(0.5, 0.4, 0.7).normalize_or_zero();
        let of_sky = |d: Vec3| Vec3::splat(0.2 + 2.0 * d.dot(window).max(0.0).powi(20));
        let lighting = Lighting {
            environment: LatLong::of(128, of_sky).environment(Quat::IDENTITY, Vec3::ONE),
            ..Lighting::of(Vec::new())
        };
        let brdf = Some(Brdf::new(SpecularModel::Ggx, 0.1));
        let shader = Shader::new(&occluder, brdf, &lighting);
        let atlas = Atlas::lattice(&mesh, &vec![4.0; mesh.triangles.len()]);
        let seen = TriangleShares::new(&mesh, &atlas, &shader);
        let scene = Scene {
            mesh: &mesh,
            occluder: &occluder,
            brdf,
            gloss: None,
            surroundings: None,
        };
        let camera = camera(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, SIDE, SIDE, 200.0);
        let picture = render(&scene, &camera, &shader, Diffuse::Absent);
        let rows = 0..SIDE as usize;
        let samples = Samples::trace(&mesh, &occluder, &camera, rows, 1, &|_, _| true, &|| false);
        // Of what eight times eight pixels show, where all see the object.
        let mut squares = [0.0_f32; 2];
        let mut pixel_by_pixel = true;
        let tile =
            |corner: [usize; 2], size: [usize; 2], pixels: &[Vec3]| (corner, size, pixels.to_vec());
        for ([x, y], [width, height], pixels) in
            specular_tiles(&scene, &camera, &shader, &seen, &samples, tile)
        {
            let shown = |i: usize| (y + i / width) * SIDE as usize + x + i % width;
            pixel_by_pixel &= pixels
                .windows(2)
                .all(|two| two[0] != two[1] || two[0] == Vec3::ZERO);
            for block in 0..(width / 8) * (height / 8) {
                let first = block / (width / 8) * 8 * width + block % (width / 8) * 8;
                let block = (0..64).map(|k| first + k / 8 * width + k % 8);
                if block.clone().any(|i| picture.coverage[shown(i)] < 1.0) {
                    continue;
                }
                let told: f32 = block.clone().map(|i| pixels[i].x).sum();
                let expected: f32 = block.map(|i| picture.specular[shown(i)][0]).sum();
                squares[0] += (told - expected).powi(2);
                squares[1] += expected.powi(2);
            }
        }
        assert!(!pixel_by_pixel, "no block is looked at together");
        let off = (squares[0] / squares[1]).sqrt();
        assert!(off < 0.03, "off by {off}");
    }
}
