//! Where to begin from nothing: rotations spread evenly, each with the scale and the shift that bring points of the surface to
//! where the silhouettes are, ordered by how well they cover them.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;

use super::Similarity;
use super::silhouettes::bounds;
use rekindle_capture::{Camera, Mesh, View};

/// Rotations tried.
const ROTATIONS: u32 = 3000;
/// Points of the surface looked at.
const POINTS: usize = 1500;
/// Cells along a silhouette's longer side in which points are counted.
const CELLS: f64 = 22.0;
/// Rounds in which scale and shift are settled.
const ROUNDS: usize = 2;

/// A silhouette: where it is and what it covers.
struct Shape {
    camera: Camera,
    /// First corner of its cells, and pixels along each.
    low: DVec2,
    cell: f64,
    columns: usize,
    covered: Vec<bool>,
    /// Mean place and root mean square distance from it, pixels.
    centre: DVec2,
    extent: f64,
}

impl Shape {
    fn new(view: &View) -> Option<Self> {
        let [low, high] = bounds(view)?;
        let cell = ((high - low).max_element() / CELLS).max(1.0);
        // Room around it, so that what lies outside is counted.
        let low = low - 8.0 * cell;
        let size = ((high - low) / cell).ceil() + 8.0;
        let (columns, rows) = (size.x as usize, size.y as usize);
        let coverage = view.photograph.coverage.as_ref()?;
        let width = view.photograph.width as usize;
        let mut counts = vec![0_u32; columns * rows];
        let (mut sum, mut squares, mut count) = (DVec2::ZERO, 0.0, 0.0);
        for (i, _) in coverage.iter().enumerate().filter(|(_, c)| **c > 0.5) {
            let at = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let place = ((at - low) / cell).floor();
            counts[place.y as usize * columns + place.x as usize] += 1;
            sum += at;
            squares += at.length_squared();
            count += 1.0;
        }
        let centre = sum / count;
        Some(Self {
            camera: view.camera.clone(),
            low,
            cell,
            columns,
            covered: counts
                .iter()
                .map(|&n| f64::from(n) > 0.5 * cell * cell)
                .collect(),
            centre,
            extent: (squares / count - centre.length_squared()).max(1.0).sqrt(),
        })
    }

    /// Which cells points fall into, and how many fall beyond all.
    fn occupied(&self, points: &[DVec3], transform: &Similarity) -> (Vec<bool>, usize) {
        let mut occupied = vec![false; self.covered.len()];
        let mut beyond = 0;
        for &point in points {
            let pixel = self.camera.project(transform.apply(point));
            let place = pixel
                .map(|p| (p - self.low) / self.cell)
                .filter(|p| p.min_element() >= 0.0 && p.x < self.columns as f64);
            let index = place.map(|p| p.y as usize * self.columns + p.x as usize);
            match index.filter(|&i| i < occupied.len()) {
                Some(i) => occupied[i] = true,
                None => beyond += 1,
            }
        }
        (occupied, beyond)
    }
}

/// Starts, the most promising first.
pub(super) fn rotations(views: &[View], mesh: &Mesh) -> Vec<Similarity> {
    let shapes: Vec<Shape> = views.iter().filter_map(Shape::new).collect();
    let rays: Vec<(DVec3, DVec3)> = shapes
        .iter()
        .map(|s| (s.camera.position(), s.camera.ray(s.centre)))
        .collect();
    let middle = nearest(&rays);
    let points: Vec<DVec3> = mesh
        .spread(POINTS)
        .into_iter()
        .map(|(triangle, at)| mesh.point(triangle, at).position.as_dvec3())
        .collect();
    let centre = mesh.centre().as_dvec3();
    let mut found: Vec<(f64, Similarity)> = (0..ROTATIONS)
        .into_par_iter()
        .map(|i| {
            let mut transform = Similarity {
                scale: 1.0,
                rotation: spread(i, ROTATIONS),
                translation: DVec3::ZERO,
            };
            transform.translation = middle - transform.apply(centre);
            transform.scale = first_scale(&shapes, &points, centre, middle, &transform);
            transform.translation = middle - transform.scale * (transform.rotation * centre);
            for _ in 0..ROUNDS {
                adjust(&shapes, &points, middle, &mut transform);
            }
            (score(&shapes, &points, &transform), transform)
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(_, transform)| transform).collect()
}

/// The point nearest to lines, each given by a point and a unit direction.
pub(super) fn nearest(lines: &[(DVec3, DVec3)]) -> DVec3 {
    let (mut matrix, mut rhs) = (DMat3::ZERO, DVec3::ZERO);
    for &(origin, d) in lines {
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        matrix += across;
        rhs += across * origin;
    }
    // Parallel lines have no such point: then at the cameras' mean distance of nothing known, in front of the first.
    if matrix.determinant().abs() < 1e-9 {
        return lines
            .first()
            .map_or(DVec3::ZERO, |(origin, d)| *origin + *d);
    }
    matrix.inverse() * rhs
}

/// One of `count` rotations spread evenly: the super-Fibonacci spiral of Alexa (2022).
pub(super) fn spread(i: u32, count: u32) -> DQuat {
    const PSI: f64 = 1.533_751_168_755_204_3;
    let s = f64::from(i) + 0.5;
    let t = s / f64::from(count);
    let d = TAU * s;
    let (r, big) = (t.sqrt(), (1.0 - t).sqrt());
    let (alpha, beta) = (d / std::f64::consts::SQRT_2, d / PSI);
    DQuat::from_xyzw(
        r * alpha.sin(),
        r * alpha.cos(),
        big * beta.sin(),
        big * beta.cos(),
    )
    .normalize()
}

/// The scale at which points are spread as wide as the silhouettes, in the middle of the views.
fn first_scale(
    shapes: &[Shape],
    points: &[DVec3],
    centre: DVec3,
    middle: DVec3,
    transform: &Similarity,
) -> f64 {
    let mut scales: Vec<f64> = shapes
        .iter()
        .map(|shape| {
            let camera = &shape.camera;
            let depth = (middle - camera.position()).dot(camera.forward()).max(1e-9);
            let right = camera.world_from_camera.matrix3.x_axis;
            let up = camera.up();
            let squares = points.iter().map(|&p| {
                let p = transform.rotation * (p - centre);
                p.dot(right).powi(2) + p.dot(up).powi(2)
            });
            let wide = (squares.sum::<f64>() / points.len() as f64).sqrt();
            shape.extent * depth / (camera.focal.y * wide.max(1e-30))
        })
        .collect();
    let half = scales.len() / 2;
    *scales.select_nth_unstable_by(half, f64::total_cmp).1
}

/// Brings area and centre of what the points cover nearer to those of the silhouettes.
fn adjust(shapes: &[Shape], points: &[DVec3], middle: DVec3, transform: &mut Similarity) {
    let (mut matrix, mut rhs) = (DMat3::ZERO, DVec3::ZERO);
    let (mut area, mut wanted) = (0.0, 0.0);
    for shape in shapes {
        let (occupied, beyond) = shape.occupied(points, transform);
        let centre = |cells: &[bool]| {
            let inside = cells.iter().enumerate().filter(|(_, c)| **c);
            let sum: DVec2 = inside
                .clone()
                .map(|(i, _)| DVec2::new((i % shape.columns) as f64, (i / shape.columns) as f64))
                .sum();
            let count = inside.count() as f64;
            (sum / count.max(1.0), count)
        };
        let ((at, count), (to, of)) = (centre(&occupied), centre(&shape.covered));
        area += count + beyond as f64;
        wanted += of;
        if count == 0.0 {
            continue;
        }
        let camera = &shape.camera;
        let depth = (middle - camera.position()).dot(camera.forward()).max(1e-9);
        let pixels = (to - at) * shape.cell;
        let move_by = camera.world_from_camera.matrix3.x_axis * (pixels.x * depth / camera.focal.x)
            - camera.up() * (pixels.y * depth / camera.focal.y);
        let d = camera.forward();
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        matrix += across;
        rhs += across * move_by;
    }
    if matrix.determinant().abs() > 1e-9 {
        transform.translation += matrix.inverse() * rhs;
    }
    if area > 0.0 {
        let by = (wanted / area).sqrt().clamp(0.5, 2.0);
        transform.scale *= by;
        transform.translation = middle + by * (transform.translation - middle);
    }
}

/// Mean intersection over union of the cells.
fn score(shapes: &[Shape], points: &[DVec3], transform: &Similarity) -> f64 {
    let each = shapes.iter().map(|shape| {
        let (occupied, beyond) = shape.occupied(points, transform);
        let pairs = || occupied.iter().zip(&shape.covered);
        let both = pairs().filter(|(a, b)| **a && **b).count();
        let either = pairs().filter(|(a, b)| **a || **b).count() + beyond;
        both as f64 / either.max(1) as f64
    });
    each.sum::<f64>() / shapes.len().max(1) as f64
}
