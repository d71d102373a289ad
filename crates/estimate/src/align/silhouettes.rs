//! Least squares on blurred silhouettes.
//!
//! Around each photograph's silhouette a picture is cut out, blurred, and compared with the mesh's silhouette in it, blurred
//! alike: blur makes the difference change smoothly with the transform, and reach over gaps.

use std::collections::HashMap;

use glam::{DVec2, DVec3, Vec3};

use super::descent::Descent;
use super::sights::Sights;
use super::{Similarity, Stop};
use rekindle_capture::{Camera, Mesh, View};
use rekindle_scene::surface::{NO_TRIANGLE, Occluder, front_most};

/// Room around a silhouette, as a part of its longer side.
const ROOM: f64 = 0.4;
/// Samples along a pixel of the mesh's silhouette.
const SAMPLES: u32 = 2;
/// Radius of the blur, as a part of the cut-out's longer side, and how often it is done.
const BLUR: f64 = 0.03;
const BLURS: usize = 3;
/// Steps of least squares at each level.
const STEPS: usize = 10;
/// Weight of a mark's error, in pixels of the cut-out, beside differences of coverage: little where silhouettes tell anything,
/// but enough to hold what they leave open, such as the turn of a vase.
const HOLD: f32 = 0.3;

/// The silhouettes of photographs, ready to be compared with those of a mesh.
pub(super) struct Silhouettes<'a> {
    mesh: &'a Mesh,
    occluder: Occluder,
    /// One per view, none for those whose photograph has no silhouette.
    targets: Vec<Option<Target>>,
    /// The mesh's centre and radius.
    centre: DVec3,
    radius: f64,
    side: u32,
    /// Pixels of the cut-outs per radian, the mean over the views.
    pixels: f32,
}

/// A photograph's silhouette, cut out.
struct Target {
    /// Of the cut-out's pixels.
    camera: Camera,
    /// What the object covers of each pixel.
    coverage: Vec<f32>,
    /// The same, blurred.
    blurred: Vec<f32>,
}

/// Bounds of a silhouette in pixels, none where there is none: columns and rows of the first and the one after the last.
pub(super) fn bounds(view: &View) -> Option<[DVec2; 2]> {
    let coverage = view.photograph.coverage.as_ref()?;
    let width = view.photograph.width as usize;
    let mut bounds: Option<[DVec2; 2]> = None;
    for (i, _) in coverage.iter().enumerate().filter(|(_, c)| **c > 0.5) {
        let at = DVec2::new((i % width) as f64, (i / width) as f64);
        let [low, high] = bounds.unwrap_or([at, at + 1.0]);
        bounds = Some([low.min(at), high.max(at + 1.0)]);
    }
    bounds
}

impl Target {
    fn new(view: &View, side: u32) -> Option<Self> {
        let [low, high] = bounds(view)?;
        let room = ROOM * (high - low).max_element();
        let (low, size) = (low - room, high - low + 2.0 * room);
        let scale = f64::from(side) / size.max_element();
        let pixels = (size * scale).ceil().max(DVec2::splat(4.0));
        let camera = Camera {
            width: pixels.x as u32,
            height: pixels.y as u32,
            focal: view.camera.focal * scale,
            centre: (view.camera.centre - low) * scale,
            ..view.camera.clone()
        };
        let coverage = cut_out(view, low, scale, &camera);
        let blurred = blur(coverage.clone(), camera.width as usize, side);
        Some(Self {
            camera,
            coverage,
            blurred,
        })
    }
}

/// Mean coverage over each pixel of a cut-out that begins at `low` and has `scale` times as many pixels.
fn cut_out(view: &View, low: DVec2, scale: f64, camera: &Camera) -> Vec<f32> {
    const POINTS: u32 = 4;
    let photograph = &view.photograph;
    let at = |x: f64, y: f64| -> f32 {
        let inside = x >= 0.0
            && y >= 0.0
            && x < f64::from(photograph.width)
            && y < f64::from(photograph.height);
        let coverage = photograph.coverage.as_deref().filter(|_| inside);
        coverage.map_or(0.0, |c| {
            c[y as usize * photograph.width as usize + x as usize]
        })
    };
    let mut out = Vec::with_capacity((camera.width * camera.height) as usize);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let mut sum = 0.0;
            for k in 0..POINTS * POINTS {
                let part = |i: u32| (f64::from(i) + 0.5) / f64::from(POINTS);
                let place = DVec2::new(
                    f64::from(x) + part(k % POINTS),
                    f64::from(y) + part(k / POINTS),
                );
                let place = place / scale + low;
                sum += at(place.x, place.y);
            }
            out.push(sum / (POINTS * POINTS) as f32);
        }
    }
    out
}

/// Repeated means over squares, which are nearly Gaussian.
fn blur(mut values: Vec<f32>, width: usize, side: u32) -> Vec<f32> {
    let radius = (BLUR * f64::from(side)).round().max(1.0) as usize;
    let height = values.len() / width;
    for _ in 0..BLURS {
        for y in 0..height {
            running_mean(&mut values, y * width, 1, width, radius);
        }
        for x in 0..width {
            running_mean(&mut values, x, width, height, radius);
        }
    }
    values
}

/// Replaces `count` values from `start`, `stride` apart, by the means over `radius` to either side; beyond the ends is zero.
fn running_mean(values: &mut [f32], start: usize, stride: usize, count: usize, radius: usize) {
    let line: Vec<f32> = (0..count).map(|i| values[start + i * stride]).collect();
    let span = (2 * radius + 1) as f32;
    let mut sum: f32 = line.iter().take(radius + 1).sum();
    for i in 0..count {
        values[start + i * stride] = sum / span;
        sum += line.get(i + radius + 1).copied().unwrap_or(0.0);
        sum -= if i >= radius { line[i - radius] } else { 0.0 };
    }
}

impl<'a> Silhouettes<'a> {
    /// Silhouettes cut out with `side` pixels along their longer side.
    pub(super) fn new(views: &[View], mesh: &'a Mesh, side: u32) -> Self {
        let targets: Vec<_> = views.iter().map(|view| Target::new(view, side)).collect();
        let focal = targets.iter().flatten().map(|t| t.camera.focal.x as f32);
        let known = focal.clone().count().max(1) as f32;
        Self {
            mesh,
            occluder: Occluder::new(mesh),
            pixels: focal.sum::<f32>() / known,
            targets,
            centre: mesh.centre().as_dvec3(),
            radius: 0.5 * f64::from(mesh.diagonal()),
            side,
        }
    }

    /// What a mesh that was moved covers of each pixel of a cut-out.
    fn covered(&self, target: &Target, transform: &Similarity) -> Vec<f32> {
        let camera = transform.seen_from(&target.camera);
        let fine = camera.supersampled(SAMPLES);
        let (triangles, _) = front_most(self.mesh, &self.occluder, &fine);
        let (width, samples) = (camera.width as usize, SAMPLES as usize);
        let mut out = vec![0.0; target.coverage.len()];
        for (i, _) in triangles
            .iter()
            .enumerate()
            .filter(|(_, t)| **t != NO_TRIANGLE)
        {
            let (x, y) = (i % (width * samples), i / (width * samples));
            out[y / samples * width + x / samples] += 1.0 / (SAMPLES * SAMPLES) as f32;
        }
        out
    }

    /// Intersection over union of each view's silhouettes.
    pub(super) fn overlap(&self, transform: &Similarity) -> Vec<Option<f64>> {
        let of = |target: &Target| {
            let mesh = self.covered(target, transform);
            let pairs = || mesh.iter().zip(&target.coverage);
            let both: f32 = pairs().map(|(a, b)| a.min(*b)).sum();
            let either: f32 = pairs().map(|(a, b)| a.max(*b)).sum();
            f64::from(both / either.max(f32::MIN_POSITIVE))
        };
        self.targets
            .iter()
            .map(|target| target.as_ref().map(of))
            .collect()
    }

    /// Differences of all views' blurred silhouettes.
    fn residuals(&self, transform: &Similarity) -> Vec<f32> {
        let mut out = Vec::new();
        for target in self.targets.iter().flatten() {
            let mesh = self.covered(target, transform);
            let blurred = blur(mesh, target.camera.width as usize, self.side);
            out.extend(blurred.iter().zip(&target.blurred).map(|(a, b)| a - b));
        }
        out
    }

    /// The transform from `start` on that makes the differences least, held by marks where there are any.
    pub(super) fn settle(
        &self,
        start: Similarity,
        hold: Option<&Sights>,
        stop: Stop<'_>,
    ) -> Similarity {
        let descent = Descent {
            centre: self.centre,
            radius: self.radius,
            // About a pixel on the silhouette.
            step: 1.0 / f64::from(self.side),
            steps: STEPS,
            stop,
        };
        descent.settle(start, |transform| {
            let mut residuals = self.residuals(transform);
            if let Some(sights) = hold {
                residuals.extend(sights.residuals(transform).map(|r| HOLD * self.pixels * r));
            }
            residuals
        })
    }
}

/// A mesh with one vertex for each of so many cells along its longest side: coarse, and as large as before.
pub(super) fn thinned(mesh: &Mesh, cells: f32) -> Mesh {
    let (low, high) = mesh.bounds();
    let size = (high - low).max_element().max(f32::MIN_POSITIVE) / cells;
    let mut numbers: HashMap<[i32; 3], u32> = HashMap::new();
    let mut positions: Vec<Vec3> = Vec::new();
    let place: Vec<u32> = mesh
        .positions
        .iter()
        .map(|&p| {
            let cell = ((p - low) / size).floor().as_ivec3().to_array();
            *numbers.entry(cell).or_insert_with(|| {
                positions.push(p);
                positions.len() as u32 - 1
            })
        })
        .collect();
    let mut triangles: Vec<[u32; 3]> = mesh
        .triangles
        .iter()
        .map(|t| t.map(|v| place[v as usize]))
        .filter(|[a, b, c]| a != b && b != c && a != c)
        .collect();
    triangles.sort_unstable();
    triangles.dedup();
    Mesh {
        origin: mesh.origin,
        normals: vec![Vec3::Y; positions.len()],
        positions,
        uvs: Vec::new(),
        triangles,
    }
}
