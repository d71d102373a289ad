//! What the estimation looks at: surface points, each with its radiance in every view that sees it.
//!
//! The lights are sought in differences between views of one surface point, whose diffuse radiance is the same in
//! all of them (method notes, section 4). So only points that two views see clearly are taken. Points are spread
//! evenly over the pixels of all views, at pixel centres of one view and interpolated in the others.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DAffine3, DQuat, DVec2, Quat, Vec2, Vec3};
use rayon::prelude::*;

use super::turntable::Turning;
use super::weights::{DETAIL_SHARE, magnitude};
use rekindle_base::math::morton;
use rekindle_capture::{Mesh, Photograph, View};
use rekindle_scene::reflectance::{Brdf, Gloss};
use rekindle_scene::surface::{GlossParts, ViewSurface};

/// Rows at a smaller cosine between normal and view are not used: 1/cos θ_r magnifies there whatever is wrong in
/// the normals, and a pixel covers many of them.
pub const MIN_COS_ROW: f32 = 0.2;

/// What is not known of what the surface sends itself, as a part of it: reflectance, and what it sends on.
const MIRRORED_ERROR: f32 = 0.3;

/// Rows of a point up to which the number of points is what counts. Where many views see each point, fewer points say as much.
const ROWS_PER_POINT: usize = 8;

/// A surface and the photographs of it.
#[derive(Clone, Copy)]
pub struct Seen<'a> {
    /// The surface.
    pub mesh: &'a Mesh,
    /// Photographs and cameras.
    pub views: &'a [View],
    /// What each view sees of the surface, one per view.
    pub surfaces: &'a [ViewSurface],
    /// Pixels that points are spread over: those inside the outlines of the capture's own mesh, so that the same are looked at where another
    /// surface stands for it.
    pub pixels: usize,
    /// Which parts of the surface have another gloss than the rest, where that is known.
    pub parts: Option<&'a GlossParts>,
    /// What it mirrors of itself, where that is known.
    pub mirrored: Option<Mirrored<'a>>,
    /// How it stands to the light in each view, where that stands still with the camera.
    pub turning: Option<&'a Turning<'a>>,
}

/// What a surface mirrors of itself at a place, on a triangle with weights of the second and third corner, in a view, in the unit
/// direction to its camera; RGB in the capture's units, `None` where that can't be told. Places with other numbers may be looked at by
/// other rays.
pub type Mirrored<'a> = &'a (dyn Fn((u32, Vec2), (usize, Vec3), u32) -> Option<[f32; 3]> + Sync);

impl Seen<'_> {
    /// Glosses of the surface's parts.
    pub fn glosses(&self) -> Vec<Gloss> {
        self.parts
            .map_or_else(|| vec![Gloss::MAIN], |parts| parts.glosses.clone())
    }
}

/// Pixels inside the outlines of what views see of a surface.
pub fn pixels_inside(surfaces: &[ViewSurface]) -> usize {
    let inside = |surface: &ViewSurface| surface.interior.iter().filter(|&&inside| inside).count();
    surfaces.iter().map(inside).sum()
}

/// The widest lobe of some glosses, where `brdf` is the main one.
pub fn widest(brdf: &Brdf, glosses: &[Gloss]) -> Brdf {
    let shown = glosses.iter().filter(|gloss| gloss.strength > 0.0);
    let widest = shown.max_by(|a, b| a.roughness.total_cmp(&b.roughness));
    brdf.at(*widest.unwrap_or(&Gloss::MAIN))
}

/// The radiance of one surface point in one view.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The view.
    pub view: usize,
    /// Unit direction from the point to the camera, world space.
    pub to_camera: Vec3,
    /// Cosine between normal and `to_camera`.
    pub cos_view: f32,
    /// Measured radiance, RGB, in units of [`Observations::scale`], by the tint of its point's gloss: so one light is one to all parts.
    pub radiance: [f32; 3],
    /// Whether `radiance` is clipped: the least that it can be.
    pub is_bound: bool,
    /// How unsure the interpolated radiance is: the image's local deviation from a plane, same units.
    pub detail: f32,
    /// Irradiance of its point in this view, as a part of what is usual; 1 where it is the same in all views.
    pub irradiance: f32,
    /// The point as it is before this camera, where the light stands still with the camera.
    pub placed: Option<Placed>,
}

impl Row {
    /// What the viewer gets of the point's diffuse colour, which is that under usual irradiance.
    pub fn diffuse_share(&self, brdf: &Brdf) -> f32 {
        brdf.diffuse_exit(self.cos_view) * self.irradiance
    }
}

/// A surface point where the lights stand still.
#[derive(Clone, Copy, Debug)]
pub struct Placed {
    /// Position.
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit direction to the camera.
    pub to_camera: Vec3,
    /// What turns directions there to those of the surface.
    pub to_surface: Quat,
}

/// The rigid motion that brings a surface, as it is before a camera, to where the lights stand still.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    turn: Quat,
    shift: Vec3,
}

impl Motion {
    /// The same in single precision.
    pub fn new(motion: &DAffine3) -> Self {
        Self {
            turn: DQuat::from_mat3(&motion.matrix3).normalize().as_quat(),
            shift: motion.translation.as_vec3(),
        }
    }

    /// A point and the direction from it to the camera.
    pub fn place(&self, position: Vec3, normal: Vec3, to_camera: Vec3) -> Placed {
        Placed {
            position: self.turn * position + self.shift,
            normal: self.turn * normal,
            to_camera: self.turn * to_camera,
            to_surface: self.turn.conjugate(),
        }
    }
}

/// A surface point that at least two views see.
#[derive(Clone, Debug)]
pub struct Point {
    /// World position.
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// The triangle it lies on, and its weights of the second and third corner.
    pub on: (u32, Vec2),
    /// The view and the pixel in it, x and y, whose centre shows it.
    pub pixel: (usize, u32, u32),
    /// Its gloss's place in [`Observations::glosses`].
    pub gloss: usize,
    /// Its rows in [`Observations::rows`].
    pub rows: Range<usize>,
}

/// All points with their rows, points in the order of their normals.
#[derive(Clone, Debug)]
pub struct Observations {
    /// Glosses of the surface's parts; the main one where nothing else is known.
    pub glosses: Vec<Gloss>,
    /// Surface points.
    pub points: Vec<Point>,
    /// Rows, those of one point together.
    pub rows: Vec<Row>,
    /// Radiance that counts as 1: the mean over all rows and channels, in the capture's units.
    pub scale: f32,
    /// Whether the three channels are one and the same.
    pub gray: bool,
}

/// Which points [`Observations::gather`] looks for.
pub struct Sampling<'a> {
    /// Pixels looked at, about.
    pub candidates: usize,
    /// Most points kept, an even sample of those that qualify; see [`Candidate::among_first`].
    pub limit: usize,
    /// Whether a point with these rows is of use.
    pub keep: &'a (dyn Fn(Vec3, Vec3, &[Row]) -> bool + Sync),
    /// Radiance that counts as 1, if it has been chosen already.
    pub scale: Option<f32>,
    /// Once this is set, no more points are gathered.
    pub stop: &'a AtomicBool,
}

impl Observations {
    /// Gathers points from all views.
    pub fn gather(seen: &Seen<'_>, sampling: &Sampling<'_>) -> Self {
        let glosses = seen.glosses();
        Self::of(Candidate::all(seen, sampling), glosses, sampling.scale)
    }

    /// The rows of some points, which follow each other.
    pub fn rows_of(&self, points: &Range<usize>) -> Range<usize> {
        let of_points = &self.points[points.clone()];
        match (of_points.first(), of_points.last()) {
            (Some(first), Some(last)) => first.rows.start..last.rows.end,
            _ => 0..0,
        }
    }

    /// The widest of the lobes, where `brdf` is the main one.
    pub fn widest(&self, brdf: &Brdf) -> Brdf {
        widest(brdf, &self.glosses)
    }

    /// The points of candidates.
    pub fn of(mut candidates: Vec<Candidate>, glosses: Vec<Gloss>, scale: Option<f32>) -> Self {
        candidates.sort_by_key(|c| (morton_of_direction(c.normal), c.order));
        let mut all = Self {
            glosses,
            points: Vec::with_capacity(candidates.len()),
            rows: Vec::new(),
            scale: 1.0,
            gray: false,
        };
        let (mut sum, mut count) = (0.0_f64, 0);
        for candidate in &candidates {
            let first = all.rows.len();
            all.rows.extend(&candidate.rows);
            all.points.push(Point {
                position: candidate.position,
                normal: candidate.normal,
                on: candidate.on,
                pixel: (candidate.order.1, candidate.order.2, candidate.order.3),
                gloss: candidate.gloss,
                rows: first..all.rows.len(),
            });
            let measured = candidate.rows.iter().filter(|row| !row.is_bound);
            count += measured.clone().count();
            sum += measured
                .flat_map(|r| r.radiance)
                .map(f64::from)
                .sum::<f64>();
        }
        let mean = (sum / (3 * count).max(1) as f64) as f32;
        all.scale = scale.unwrap_or(if mean > 0.0 { mean } else { 1.0 });
        for row in &mut all.rows {
            row.radiance = row.radiance.map(|c| c / all.scale);
            row.detail /= all.scale;
        }
        all
    }

    /// The same without the rows of some views and the points that then have fewer than two, and the places that its rows have
    /// here.
    pub fn without_views(&self, is_out: impl Fn(usize) -> bool) -> (Self, Vec<usize>) {
        let mut without = self.emptied();
        let mut places = Vec::new();
        for point in &self.points {
            let mut kept: Vec<usize> = point.rows.clone().collect();
            kept.retain(|&k| !is_out(self.rows[k].view));
            if !are_enough(kept.iter().map(|&k| &self.rows[k])) {
                continue;
            }
            without.take(point, kept.iter().map(|&k| self.rows[k]));
            places.extend(kept);
        }
        (without, places)
    }

    /// The same with each view divided by how much too bright it is in each channel.
    #[must_use]
    pub fn divided(&self, gains: &[[f64; 3]]) -> Self {
        let mut divided = self.clone();
        for row in &mut divided.rows {
            let gain = gains[row.view].map(|gain| gain as f32);
            row.radiance = std::array::from_fn(|c| row.radiance[c] / gain[c]);
            row.detail /= gain.iter().sum::<f32>() / 3.0;
        }
        divided
    }

    /// The same without the rows that are bounds only.
    #[must_use]
    pub fn measured(&self) -> Self {
        let mut measured = self.emptied();
        for point in &self.points {
            let rows = self.rows[point.rows.clone()].iter().copied();
            measured.take(point, rows.filter(|row| !row.is_bound));
        }
        measured
    }

    /// The same where no point has a diffuse colour that it could show, as of a metal: there is nothing to eliminate.
    #[must_use]
    pub fn without_diffuse(&self) -> Self {
        let mut bare = self.clone();
        for row in &mut bare.rows {
            row.irradiance = 0.0;
        }
        bare
    }

    /// Every so many-th point, from that at `first` on.
    #[must_use]
    pub fn every(&self, step: usize, first: usize) -> Self {
        self.only(self.points.iter().skip(first).step_by(step))
    }

    /// The points of a kind.
    #[must_use]
    pub fn of_points(&self, is_kept: impl Fn(&Point) -> bool) -> Self {
        self.only(self.points.iter().filter(|point| is_kept(point)))
    }

    /// The same with some of its points alone.
    fn only<'p>(&self, points: impl Iterator<Item = &'p Point>) -> Self {
        let mut some = self.emptied();
        for point in points {
            some.take(point, self.rows[point.rows.clone()].iter().copied());
        }
        some
    }

    /// The same without points.
    fn emptied(&self) -> Self {
        Self {
            glosses: self.glosses.clone(),
            points: Vec::new(),
            rows: Vec::new(),
            ..*self
        }
    }

    /// Takes in a point of others with these rows.
    fn take(&mut self, point: &Point, rows: impl Iterator<Item = Row>) {
        let first = self.rows.len();
        self.rows.extend(rows);
        self.points.push(Point {
            rows: first..self.rows.len(),
            ..point.clone()
        });
    }

    /// The same on a surface whose parts differ in gloss.
    #[must_use]
    pub fn of_parts(&self, parts: &GlossParts) -> Self {
        let mut parted = self.clone();
        parted.glosses.clone_from(&parts.glosses);
        for (point, before) in parted.points.iter_mut().zip(&self.points) {
            point.gloss = parts.at(point.position);
            let tint = parts.glosses[point.gloss].tint;
            let change = Vec3::from(tint) / Vec3::from(self.glosses[before.gloss].tint);
            by_tint(&mut parted.rows[point.rows.clone()], change);
        }
        parted
    }

    /// The same on a surface of one gloss.
    #[must_use]
    pub fn without_parts(mut self) -> Self {
        for point in &mut self.points {
            let tint = Vec3::from(self.glosses[point.gloss].tint);
            by_tint(&mut self.rows[point.rows.clone()], tint.recip());
            point.gloss = 0;
        }
        self.glosses = vec![Gloss::MAIN];
        self
    }

    /// The same with each row's three channels replaced by their mean.
    #[must_use]
    pub fn to_gray(&self) -> Self {
        let mut gray = self.clone();
        for row in &mut gray.rows {
            row.radiance = [row.radiance.iter().sum::<f32>() / 3.0; 3];
        }
        gray.gray = true;
        gray
    }
}

/// Divides what rows measure by a tint.
fn by_tint(rows: &mut [Row], tint: Vec3) {
    if tint != Vec3::ONE {
        for row in rows {
            row.radiance = (Vec3::from(row.radiance) / tint).to_array();
        }
    }
}

/// Position on a space-filling curve over the octahedral map, so that near directions have near codes.
fn morton_of_direction(d: Vec3) -> u32 {
    let d = d / (d.x.abs() + d.y.abs() + d.z.abs()).max(1e-12);
    let fold = |a: f32, b: f32| (1.0 - b.abs()) * 1.0_f32.copysign(a);
    let (u, v) = if d.z >= 0.0 {
        (d.x, d.y)
    } else {
        (fold(d.x, d.y), fold(d.y, d.x))
    };
    let quantised = |t: f32| ((t * 0.5 + 0.5) * 255.0) as u32;
    morton::code([quantised(u), quantised(v)])
}

/// A surface point that may be taken.
#[derive(Clone)]
pub struct Candidate {
    /// Pseudo-random rank, unique enough to sample evenly.
    order: (u32, usize, u32, u32),
    position: Vec3,
    normal: Vec3,
    on: (u32, Vec2),
    gloss: usize,
    rows: Vec<Row>,
}

impl Candidate {
    /// Whether [`Sampling::keep`] would keep it.
    pub fn is_kept_by(&self, keep: impl Fn(Vec3, Vec3, &[Row]) -> bool) -> bool {
        keep(self.position, self.normal, &self.rows)
    }

    /// Says, asked of one candidate after the other, whether it is among the first `limit`, fewer where they have many rows.
    pub fn among_first(limit: usize) -> impl FnMut(&Self) -> bool {
        let most_rows = limit.saturating_mul(ROWS_PER_POINT);
        let (mut points, mut rows) = (0, 0);
        move |candidate| {
            points += 1;
            rows += candidate.rows.len();
            points <= limit && rows <= most_rows
        }
    }

    /// The points of a sampling in random order, so that the first of them are an even sample too.
    pub fn all(seen: &Seen<'_>, sampling: &Sampling<'_>) -> Vec<Self> {
        // One candidate a square of `cell` pixels.
        let cell = (seen.pixels as f64 / sampling.candidates.max(1) as f64)
            .sqrt()
            .max(1.0);
        let mut found: Vec<Self> = (0..seen.views.len())
            .into_par_iter()
            .flat_map_iter(|view| {
                pixel_grid(&seen.surfaces[view], cell, view)
                    .map(move |(x, y, order)| (order, view, x, y))
            })
            .filter_map(|(order, view, x, y)| {
                if sampling.stop.load(Ordering::Relaxed) {
                    return None;
                }
                candidate(seen, view, [x, y], order)
            })
            .filter(|c| are_enough(&c.rows) && (sampling.keep)(c.position, c.normal, &c.rows))
            .collect();
        found.sort_unstable_by_key(|c| c.order);
        found.retain(Self::among_first(sampling.limit));
        if let Some(mirrored) = seen.mirrored {
            let stops = || sampling.stop.load(Ordering::Relaxed);
            let of_use = found.into_par_iter().filter_map(|mut candidate| {
                (stops() || candidate.take_out(mirrored)).then_some(candidate)
            });
            found = of_use.collect();
        }
        if let Some(parts) = seen.parts {
            for candidate in &mut found {
                let tint = parts.glosses[candidate.gloss].tint;
                by_tint(&mut candidate.rows, tint.into());
            }
        }
        if let Some(irradiance) = seen.turning.and_then(|turning| turning.irradiance.as_ref()) {
            let stops = || sampling.stop.load(Ordering::Relaxed);
            (found.par_iter_mut().filter(|_| !stops()))
                .for_each(|c| irradiance.tell(c.position, c.normal, &mut c.rows));
        }
        found
    }

    /// Leaves what comes straight from the lights and the diffuse body; whether that can be told.
    fn take_out(&mut self, mirrored: Mirrored<'_>) -> bool {
        for row in &mut self.rows {
            let Some(sent) = mirrored(self.on, (row.view, row.to_camera), self.order.0) else {
                return false;
            };
            let error = MIRRORED_ERROR * magnitude(sent);
            row.detail = row.detail.hypot(error / DETAIL_SHARE);
            for (all, sent) in row.radiance.iter_mut().zip(sent) {
                *all -= sent;
            }
        }
        true
    }
}

/// Whether rows of a point say what differs between views: at least two are measured.
fn are_enough<'r>(rows: impl IntoIterator<Item = &'r Row>) -> bool {
    rows.into_iter()
        .filter(|row| !row.is_bound)
        .nth(1)
        .is_some()
}

/// One pixel in each square of `cell` × `cell` pixels, jittered by a hash, with the hash as a random order.
fn pixel_grid(
    surface: &ViewSurface,
    cell: f64,
    view: usize,
) -> impl Iterator<Item = (u32, u32, u32)> {
    let across = (f64::from(surface.width) / cell).ceil() as u32;
    let down = (f64::from(surface.height) / cell).ceil() as u32;
    (0..down).flat_map(move |j| {
        (0..across).map(move |i| {
            let h = hash(i, j, view as u32);
            let within =
                |n: u32, bits: u32| ((f64::from(n) + f64::from(bits) / 65_536.0) * cell) as u32;
            (within(i, h & 0xffff), within(j, h >> 16), hash(h, i, j))
        })
    })
}

/// A well-mixed function of three integers (Jarzynski and Olano's pcg3d, first component).
fn hash(x: u32, y: u32, z: u32) -> u32 {
    let step = |v: u32| v.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    let (mut x, mut y, mut z) = (step(x), step(y), step(z));
    for _ in 0..2 {
        x = x.wrapping_add(y.wrapping_mul(z));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        x ^= x >> 16;
        y ^= y >> 16;
        z ^= z >> 16;
    }
    x
}

fn candidate(seen: &Seen<'_>, view: usize, [x, y]: [u32; 2], order: u32) -> Option<Candidate> {
    let surface = &seen.surfaces[view];
    if x >= surface.width || y >= surface.height {
        return None;
    }
    if !surface.interior[(y * surface.width + x) as usize] {
        return None;
    }
    let triangle = surface.triangle[(y * surface.width + x) as usize];
    let barycentric = surface.barycentric(seen.mesh, &seen.views[view].camera, x, y)?;
    let point = seen.mesh.point(triangle, barycentric);
    let rows: Vec<Row> = (0..seen.views.len())
        .filter_map(|v| row(seen, v, point.position, point.normal))
        .collect();
    (!rows.is_empty()).then_some(Candidate {
        order: (order, view, x, y),
        position: point.position,
        normal: point.normal,
        on: (triangle, barycentric),
        gloss: seen.parts.map_or(0, |parts| parts.at(point.position)),
        rows,
    })
}

fn row(seen: &Seen<'_>, view: usize, position: Vec3, normal: Vec3) -> Option<Row> {
    let camera = &seen.views[view].camera;
    let to_camera = (camera.position() - position.as_dvec3())
        .normalize_or_zero()
        .as_vec3();
    let cos_view = normal.dot(to_camera);
    if cos_view < MIN_COS_ROW {
        return None;
    }
    let pixel = seen.surfaces[view].sees(position)?;
    let photograph = &seen.views[view].photograph;
    let (radiance, detail, is_bound) = interpolate(photograph, &seen.surfaces[view], pixel)?;
    Some(Row {
        view,
        to_camera,
        cos_view,
        radiance,
        is_bound,
        detail,
        irradiance: 1.0,
        placed: seen
            .turning
            .map(|turning| turning.motions[view].place(position, normal, to_camera)),
    })
}

/// Catmull-Rom interpolation of a photograph at a pixel coordinate, with the deviation of the 4 × 4 pixels from
/// their best plane, and whether one of the nearest four is clipped: then the least of these is what there is at least. `None` where
/// one of them is no data or not inside the object, or where clipped ones would only correct what nearer ones say.
fn interpolate(
    photograph: &Photograph,
    surface: &ViewSurface,
    pixel: DVec2,
) -> Option<([f32; 3], f32, bool)> {
    let at = pixel - 0.5;
    let corner = at.floor();
    let (x0, y0) = (corner.x as i64 - 1, corner.y as i64 - 1);
    let (width, height) = (i64::from(photograph.width), i64::from(photograph.height));
    if x0 < 0 || y0 < 0 || x0 + 4 > width || y0 + 4 > height {
        return None;
    }
    let weights = |t: f32| {
        [
            ((2.0 - t) * t - 1.0) * t * 0.5,
            ((3.0 * t - 5.0) * t * t + 2.0) * 0.5,
            ((4.0 - 3.0 * t) * t + 1.0) * t * 0.5,
            (t - 1.0) * t * t * 0.5,
        ]
    };
    let fraction = (at - corner).as_vec2();
    let (wx, wy) = (weights(fraction.x), weights(fraction.y));
    let mut value = Vec3::ZERO;
    let mut samples = [Vec3::ZERO; 16];
    let (mut is_bound, mut at_least, mut any_clipped) = (false, Vec3::INFINITY, false);
    for j in 0..4 {
        for i in 0..4 {
            let index = ((y0 + j) * width + x0 + i) as usize;
            let is_clipped = photograph.is_clipped(index);
            if !surface.interior[index] || !(photograph.usable[index] || is_clipped) {
                return None;
            }
            let sample = Vec3::from(photograph.radiance[index]);
            any_clipped |= is_clipped;
            if (1..3).contains(&i) && (1..3).contains(&j) {
                is_bound |= is_clipped;
                at_least = at_least.min(sample);
            }
            samples[(4 * j + i) as usize] = sample;
            value += wx[i as usize] * wy[j as usize] * sample;
        }
    }
    if any_clipped && !is_bound {
        return None;
    }
    let value = if is_bound {
        at_least
    } else {
        value.max(Vec3::ZERO)
    };
    Some((value.into(), plane_deviation(&samples), is_bound))
}

/// Root mean square deviation of 4 × 4 samples from their least-squares plane, over the three channels.
fn plane_deviation(samples: &[Vec3; 16]) -> f32 {
    let position = |k: usize| ((k % 4) as f32 - 1.5, (k / 4) as f32 - 1.5);
    let mut mean = Vec3::ZERO;
    let (mut slope_x, mut slope_y) = (Vec3::ZERO, Vec3::ZERO);
    for (k, &s) in samples.iter().enumerate() {
        let (x, y) = position(k);
        mean += s / 16.0;
        // Σ x² over the 16 samples is 20.
        slope_x += s * (x / 20.0);
        slope_y += s * (y / 20.0);
    }
    let sum: f32 = samples
        .iter()
        .enumerate()
        .map(|(k, &s)| {
            let (x, y) = position(k);
            (s - mean - slope_x * x - slope_y * y).length_squared()
        })
        .sum();
    (sum / 48.0).sqrt()
}
