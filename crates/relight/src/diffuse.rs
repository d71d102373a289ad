//! The diffuse texture from all views, given the specular part.
//!
//! A pixel's diffuse radiance is what it measured minus its specular radiance, and is the mean over the pixel's area of
//! the texture times the transmittance towards the viewer. Written for all pixels of all views, d = F t with t the
//! texels and F the weights of box filter and bilinear look-up. It is solved by SIRT (simultaneous iterative
//! reconstruction: Gilbert 1972): t += Fᵀ W (d − F t), rows and columns normalised, starting from the weighted mean.
//! A few iterations sharpen the texture to what the pixels resolve; stopping there keeps noise down.
//!
//! Pixels weigh less the stronger the highlight that was subtracted, at grazing views and where they mix surfaces;
//! between iterations those that disagree with the other views (interreflection, bad geometry) lose their weight.

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;

use super::albedo::typical_irradiance;
use super::best_views::BestViews;
use super::footprints::{Canvas, Footprints, Pixel, Tap};
use super::irradiance::texel_irradiance;
use super::measure::psnr;
use super::reflection::Surroundings;
use super::render::{Scene, specular_tiles};
use super::samples::{Samples, bands};
use super::shading::Shader;
use super::triangle_shares::TriangleShares;
use rekindle_capture::{Mesh, View};
use rekindle_scene::hemisphere;
use rekindle_scene::shortcuts::{Shortcut, Shortcuts};
use rekindle_scene::surface::{Atlas, NO_TRIANGLE, Texel, ViewSurface};

/// Sub-samples of all views together: the more pixels, the fewer each has.
const MAX_SAMPLES: usize = 24 << 20;
/// Rounds of back-projection; five leave views within 0.1 dB of what three do.
const ITERATIONS: usize = 3;
/// Step of each: SIRT converges below 2.
const RELAXATION: f32 = 1.6;
/// Part of the specular radiance that is taken for its standard error.
const SPECULAR_ERROR: f32 = 0.02;
/// Standard error of a pixel as a part of the typical diffuse radiance.
const BASE_ERROR: f32 = 0.01;
/// Weight of pixels that mix several surfaces or the background.
const MIXED_WEIGHT: f32 = 0.05;
/// Residuals beyond this many standard deviations lose their weight (Tukey's biweight).
const OUTLIER: f32 = 6.0;
/// Where not all pixels serve the texture, every so-manieth one in each direction tells how well it fits.
const FIT_STRIDE: usize = 4;
/// Pixels that tell a median.
const ENOUGH_PIXELS: usize = 1 << 20;
/// A channel with less than this part of the strongest one's irradiance says nothing about the albedo.
const DIM_CHANNEL: f32 = 0.02;
/// Weight, in fully trusted pixels, at which a texel's confidence is one half.
const HALF_CONFIDENCE: f32 = 0.1;

/// A texture with what is known of each texel.
#[derive(Clone, Debug)]
pub struct DiffuseTexture {
    /// Diffuse radiance leaving the surface towards normal incidence, RGB; zero where nothing was seen.
    pub radiance: Vec<[f32; 3]>,
    /// How far each texel is known, from 0 (never seen) to 1.
    pub confidence: Vec<f32>,
    /// Per view, mean squared difference of the re-rendered view over pixels the object covers, and the same in dB
    /// against the view's brightest percent.
    pub fit: Vec<ViewFit>,
}

/// How well a view is reproduced.
#[derive(Clone, Copy, Debug)]
pub struct ViewFit {
    /// Sum over pixels and channels of squared differences of radiance.
    pub squared: f64,
    /// Number of channel values in the sum.
    pub count: usize,
    /// PSNR of sRGB-encoded values, white at the view's 99.5th percentile of mean RGB, dB.
    pub psnr_db: f32,
}

/// The light under which a view was taken.
pub struct ViewLight<'a> {
    /// The lighting.
    pub shader: Shader<'a>,
    /// What triangles see of it.
    pub seen: TriangleShares,
    /// The surface as it lights itself under this light, where that differs from view to view and is known.
    pub surroundings: Option<&'a Surroundings<'a>>,
}

impl<'a> ViewLight<'a> {
    /// Looks at a lighting from all triangles.
    pub fn new(mesh: &Mesh, atlas: &Atlas, shader: Shader<'a>) -> Self {
        Self {
            seen: TriangleShares::new(mesh, atlas, &shader),
            shader,
            surroundings: None,
        }
    }

    /// Irradiance of every texel.
    pub(super) fn irradiance(&self, scene: &Scene, atlas: &Atlas) -> Vec<Vec3> {
        let mut irradiance = texel_irradiance(scene, atlas, &self.shader, &self.seen);
        if let Some(surroundings) = self.surroundings {
            let added = |texel: &Texel| {
                surroundings.irradiance(scene.mesh, texel.triangle, texel.barycentric)
            };
            let added: Vec<Vec3> = atlas.texels.par_iter().map(added).collect();
            for (texel, added) in atlas.texels.iter().zip(added) {
                irradiance[texel.index as usize] += added;
            }
        }
        irradiance
    }
}

/// The light under which views were taken.
pub enum LightOfViews<'a> {
    /// The same for all: the texture is of diffuse radiance.
    Same(&'a ViewLight<'a>),
    /// Each has its own: the texture is of albedo.
    Each(&'a [ViewLight<'a>]),
}

impl<'a> LightOfViews<'a> {
    fn of(&self, view: usize) -> &'a ViewLight<'a> {
        match self {
            Self::Same(light) => light,
            Self::Each(lights) => &lights[view],
        }
    }

    fn is_stopped(&self) -> bool {
        match self {
            Self::Same(light) => light.shader.is_stopped(),
            Self::Each(lights) => lights.iter().any(|light| light.shader.is_stopped()),
        }
    }
}

/// Estimates the texture. `light` is that under which the views were taken, `surfaces` is what each view sees.
pub fn reconstruct(
    scene: &Scene,
    views: &[View],
    surfaces: Vec<ViewSurface>,
    atlas: &Atlas,
    light: &LightOfViews,
    shortcuts: &Shortcuts,
) -> DiffuseTexture {
    let factor = sampling_factor(&surfaces);
    let typical = typical_radiance(views);
    let best = match light {
        LightOfViews::Same(light) if shortcuts.takes(Shortcut::Views) => {
            BestViews::new(scene, views, &surfaces, atlas, &light.shader, typical)
        }
        // Where views were lit from elsewhere each shows what the others have in shadow.
        _ => None,
    };
    // Of what they see only the triangles are asked for any more, and these only where there are no finer samples.
    let triangles = |surface: ViewSurface| (factor == 1).then_some(surface.triangle);
    let triangles: Vec<Option<Vec<u32>>> = surfaces.into_iter().map(triangles).collect();
    let size = [atlas.width as usize, atlas.height as usize];
    let mut sums = Canvas::new(size);
    let trace = |(index, (view, triangles)): (usize, (&View, Option<Vec<u32>>))| {
        let tracer = Tracer::new(scene, atlas, light, index, (factor, typical));
        let serves = |triangle| best.as_ref().is_none_or(|b| b.serve(triangle, index));
        let footprints = tracer.trace(view, triangles.as_deref(), &serves);
        let left_out = footprints.left_out;
        shortcuts.count(
            Shortcut::Views,
            footprints.pixels.len() + left_out,
            left_out,
        );
        footprints
    };
    // Several views at once, so that all threads are busy at the end of each.
    let of_views = views.par_iter().zip(triangles).enumerate();
    let mut footprints: Vec<Footprints> = of_views.map(trace).collect();
    footprints.par_iter_mut().for_each(|f| *f = f.sorted(&sums));
    sums.gather(&footprints, None);
    let confidence = sums
        .texels()
        .map(|[.., weight]| weight / (weight + HALF_CONFIDENCE))
        .collect();
    let mut texture = sums.clone();
    let texels = texture.values_mut().par_iter_mut();
    texels.for_each(|[r, g, b, weight]| {
        let mean = |sum: f32| {
            if *weight > 0.0 {
                sum.max(0.0) / *weight
            } else {
                0.0
            }
        };
        (*r, *g, *b) = (mean(*r), mean(*g), mean(*b));
    });
    for iteration in 0..ITERATIONS {
        if light.is_stopped() {
            break;
        }
        if iteration == 1 {
            let of_views = footprints.par_iter_mut().zip(views);
            of_views.for_each(|(f, view)| {
                let residuals = f.residuals(&texture);
                f.distrust_outliers(view, &residuals, typical);
            });
        }
        sums.gather(&footprints, Some(&texture));
        let updates = sums.values().par_iter();
        let texels = texture.values_mut().par_iter_mut().zip(updates);
        texels
            .filter(|(_, update)| update[3] > 0.0)
            .for_each(|(value, update)| {
                let step = Vec4::from(*update) * (RELAXATION / update[3]);
                *value = (Vec4::from(*value) + step).max(Vec4::ZERO).into();
            });
    }
    let fit = footprints
        .par_iter()
        .zip(views)
        .map(|(f, view)| f.fit(view, &texture))
        .collect();
    DiffuseTexture {
        radiance: texture.texels().map(|[r, g, b, _]| [r, g, b]).collect(),
        confidence,
        fit,
    }
}

/// Sub-samples along a pixel's side that keep all views within memory.
fn sampling_factor(surfaces: &[ViewSurface]) -> u32 {
    let shown = |surface: &ViewSurface| {
        let triangles = surface.triangle.par_iter();
        triangles.filter(|&&t| t != NO_TRIANGLE).count()
    };
    let pixels: usize = surfaces.iter().map(shown).sum();
    (1..=2)
        .rev()
        .find(|f| pixels * (f * f) as usize <= MAX_SAMPLES)
        .unwrap_or(1)
}

/// Median over all views, of large ones over some of the pixels, of the positive mean-RGB radiances.
fn typical_radiance(views: &[View]) -> f32 {
    let pixels: usize = views.iter().map(|v| v.photograph.usable.len()).sum();
    // Odd, so that it does not fall on the same columns in every row.
    let step = pixels.div_ceil(ENOUGH_PIXELS) | 1;
    let mut values: Vec<f32> = views
        .iter()
        .flat_map(|v| v.photograph.radiance.iter().zip(&v.photograph.usable))
        .step_by(step)
        .filter(|(_, usable)| **usable)
        .map(|(p, _)| p.iter().sum::<f32>() / 3.0)
        .filter(|&m| m > 0.0)
        .collect();
    if values.is_empty() {
        return 1.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// What footprints are traced with.
struct Tracer<'a> {
    scene: Scene<'a>,
    atlas: &'a Atlas,
    shader: &'a Shader<'a>,
    /// What triangles see of the light.
    seen: &'a TriangleShares,
    /// Sub-samples along each side of a pixel.
    factor: u32,
    /// A typical diffuse radiance.
    typical: f32,
    /// Irradiance of each texel and a usual one, where the texture is of albedo.
    irradiance: Option<(Vec<[f32; 3]>, f32)>,
}

impl<'a> Tracer<'a> {
    /// For one of the views.
    fn new(
        scene: &'a Scene<'a>,
        atlas: &'a Atlas,
        light: &LightOfViews<'a>,
        view: usize,
        (factor, typical): (u32, f32),
    ) -> Self {
        let own = light.of(view);
        let irradiance = match light {
            LightOfViews::Same(_) => None,
            LightOfViews::Each(_) => {
                let of_texels = own.irradiance(scene, atlas);
                let usual = typical_irradiance(atlas, &of_texels);
                Some((of_texels.iter().map(Vec3::to_array).collect(), usual))
            }
        };
        Self {
            scene: Scene {
                surroundings: own.surroundings.or(scene.surroundings),
                ..*scene
            },
            atlas,
            shader: &own.shader,
            seen: &own.seen,
            factor,
            typical,
            irradiance,
        }
    }

    /// Irradiance at a place of the surface and how much it tells of the albedo; nothing where the texture is of radiance.
    fn irradiance_at(&self, triangle: u32, barycentric: Vec2) -> (Option<Vec3>, f32) {
        let Some((of_texels, usual)) = &self.irradiance else {
            return (None, 1.0);
        };
        let irradiance = self.atlas.sample(of_texels, triangle, barycentric);
        let part = irradiance.element_sum() / 3.0 / usual;
        // What hardly arrives can't be divided by.
        let least = (DIM_CHANNEL * irradiance.max_element()).max(DIM_CHANNEL * DIM_CHANNEL * usual);
        (
            Some(irradiance.max(Vec3::splat(least))),
            (part * part).min(1.0),
        )
    }

    /// The pixels of a view; `triangles` are the front-most at their centres, where they are known, and `serves` says whether
    /// the texture of a triangle is made from this view.
    fn trace(
        &self,
        view: &View,
        triangles: Option<&[u32]>,
        serves: &(dyn Fn(u32) -> bool + Sync),
    ) -> Footprints {
        let (scene, atlas, factor) = (&self.scene, self.atlas, self.factor);
        let (camera, photograph) = (&view.camera, &view.photograph);
        let size = [atlas.width as usize, atlas.height as usize];
        let eye = camera.position().as_vec3();
        let mut all = Footprints::with_room(0);
        for rows in bands(camera, factor) {
            let wanted = |at: [usize; 2], triangle: u32| tells_fit(at) || serves(triangle);
            let (mesh, occluder) = (scene.mesh, scene.occluder);
            let samples = match triangles {
                Some(triangles) => {
                    let width = camera.width as usize;
                    let triangles = &triangles[rows.start * width..rows.end * width];
                    Samples::of_view(mesh, camera, triangles, rows, &wanted)
                }
                None => Samples::trace(mesh, occluder, camera, rows, factor, &wanted, &|| false),
            };
            all.left_out += samples.left_out;
            let first = samples.rows.start * samples.width;
            let tile = |[left, top]: [usize; 2], [width, height]: [usize; 2], specular: &[Vec3]| {
                let places = (0..width * height).map(|i| (left + i % width, top + i / width));
                let places = places.map(|(x, y)| y * samples.width + x);
                let mut part =
                    Footprints::with_room(places.clone().map(|i| samples.of(i).len()).sum());
                for (index, &specular) in places.zip(specular) {
                    let pixel = first + index;
                    let covered = samples.of(index);
                    if covered.is_empty() || !photograph.usable[pixel] {
                        continue;
                    }
                    let middle = &covered[covered.len() / 2];
                    let point = scene.mesh.point(middle.triangle, middle.barycentric);
                    let cos_view = point.normal.dot((eye - point.position).normalize_or_zero());
                    let gloss = scene.gloss_at(middle.triangle, middle.barycentric);
                    let through = scene.diffuse_exit(gloss, cos_view);
                    let whole = covered.len() == samples.full()
                        && photograph
                            .coverage
                            .as_ref()
                            .is_none_or(|c| c[pixel] > 0.999);
                    let trust = if whole { 1.0 } else { MIXED_WEIGHT };
                    let certainty = if serves(middle.triangle) {
                        certainty(specular, self.typical)
                    } else {
                        0.0
                    };
                    let taps = covered.iter().map(|s| {
                        let [a, b, c] = atlas.corner_uvs[s.triangle as usize];
                        let (u, v) = (s.barycentric.x, s.barycentric.y);
                        Tap::new(a * (1.0 - u - v) + b * u + c * v, size)
                    });
                    let (irradiance, told) =
                        self.irradiance_at(middle.triangle, middle.barycentric);
                    let diffuse = Vec3::from(photograph.radiance[pixel]) - specular;
                    let pixel = Pixel {
                        index: pixel,
                        scale: through / samples.full() as f32,
                        target: diffuse / irradiance.unwrap_or(Vec3::ONE),
                        irradiance,
                        weight: trust * cos_view.clamp(0.02, 1.0) * certainty * told,
                    };
                    part.push(&pixel, taps);
                }
                part
            };
            all.append(specular_tiles(
                scene,
                camera,
                self.shader,
                self.seen,
                &samples,
                tile,
            ));
        }
        all
    }
}

impl Footprints {
    /// Takes weight from pixels whose residual is far outside the common run.
    fn distrust_outliers(&mut self, view: &View, residuals: &[Vec3], typical: f32) {
        let residuals: Vec<Vec3> = (residuals.par_iter().enumerate())
            .map(|(i, residual)| residual * self.irradiance(i))
            .collect();
        let diffuse: Vec<Vec3> = (self.target.par_iter().enumerate())
            .map(|(i, target)| target * self.irradiance(i))
            .collect();
        let mut sizes: Vec<f32> = residuals
            .iter()
            .zip(&self.weight)
            .filter(|(_, w)| **w > 0.1)
            .map(|(r, _)| r.abs().max_element())
            .collect();
        if sizes.len() < 16 {
            return;
        }
        let middle = sizes.len() / 2;
        let spread = 1.4826 * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1;
        let Self { pixels, weight, .. } = self;
        weight
            .par_iter_mut()
            .zip(residuals)
            .zip(pixels.par_iter().zip(diffuse))
            .for_each(|((weight, residual), (&pixel, diffuse))| {
                let measured = Vec3::from(view.photograph.radiance[pixel as usize]);
                let specular = SPECULAR_ERROR * (measured - diffuse).max_element();
                let scale = OUTLIER * (spread.max(BASE_ERROR * typical) + specular);
                let part = 1.0 - (residual.abs().max_element() / scale).powi(2);
                // Never to nothing: a point that one view alone saw keeps what it has.
                *weight *= part.max(0.0).powi(2).max(1e-3);
            });
    }

    fn fit(&self, view: &View, texture: &Canvas) -> ViewFit {
        let coverage = view.photograph.coverage.as_deref();
        let width = view.camera.width as usize;
        let counts = |pixel: usize| self.left_out == 0 || tells_fit([pixel % width, pixel / width]);
        let inside: Vec<usize> = (0..self.pixels.len())
            .filter(|&i| coverage.is_none_or(|c| c[self.pixels[i] as usize] > 0.999))
            .filter(|&i| counts(self.pixels[i] as usize))
            .collect();
        let measured: Vec<Vec3> = inside
            .par_iter()
            .map(|&i| Vec3::from(view.photograph.radiance[self.pixels[i] as usize]))
            .collect();
        // What is measured less the target is the specular part.
        let rendered: Vec<Vec3> = inside
            .par_iter()
            .zip(&measured)
            .map(|(&i, measured)| measured - self.residual(i, texture) * self.irradiance(i))
            .collect();
        let differences = rendered.iter().zip(&measured).map(|(r, m)| *r - *m);
        ViewFit {
            squared: differences.map(|d| f64::from(d.length_squared())).sum(),
            count: 3 * inside.len(),
            psnr_db: psnr(&measured, &rendered),
        }
    }
}

/// Weight of a pixel from which a highlight was subtracted.
pub(super) fn certainty(specular: Vec3, typical: f32) -> f32 {
    let error = (BASE_ERROR * typical).hypot(SPECULAR_ERROR * specular.max_element());
    (BASE_ERROR * typical / error).powi(2)
}

/// Whether the pixel in this column and row is looked at for the fit alone where it does not serve the texture.
fn tells_fit([x, y]: [usize; 2]) -> bool {
    x.is_multiple_of(FIT_STRIDE) && y.is_multiple_of(FIT_STRIDE)
}

/// sRGB encoding of linear values, clamped to [0, 1].
pub fn srgb(linear: Vec3) -> Vec3 {
    Vec3::from(
        linear
            .clamp(Vec3::ZERO, Vec3::ONE)
            .to_array()
            .map(hemisphere::srgb),
    )
}
