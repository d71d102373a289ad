//! Where a camera really looks: its photograph's outline against the mesh's.
//!
//! Coverage integrated along a line across the outline is the length of the line inside the object, so it says where the
//! outline is to a small part of a pixel, however pixels were filtered. What is found that way at many places of the mesh's
//! outline is explained by turning the camera in its place, and by an outline that is too wide or too narrow all round:
//! masks may be, and coarse meshes are.

use glam::{DMat4, DQuat, DVec2, DVec3, DVec4};

use rekindle_capture::Camera;
use rekindle_scene::surface::{NO_TRIANGLE, Occluder, ViewSurface};

/// Most places of an outline that are looked at.
const PLACES: usize = 600;
/// Places without which nothing is said of a camera.
const ENOUGH: usize = 40;
/// Half lengths of the lines across the outline: the first as a part of the picture's width, the others in pixels.
const FIRST_REACH: f64 = 0.05;
const LAST_REACH: f64 = 3.0;
/// Steps along such a line, in pixels.
const STEP: f64 = 0.5;
/// Half side of the window whose pixels say which way the outline faces.
const WINDOW: i64 = 3;
/// Halvings between a pixel that shows the object and its neighbour that doesn't.
const HALVINGS: u32 = 9;
/// Radians by which a camera is turned to see what that does.
const TURN: f64 = 1e-6;
/// Rounds of reweighting; Tukey's limit in standard deviations.
const ROUNDS: usize = 8;
const LIMIT: f64 = 4.0;
/// Parts of the outline that are left out in turn to find a standard error.
const PARTS: usize = 16;

/// A place of the mesh's outline.
struct Place {
    /// Unit direction from the camera, world.
    direction: DVec3,
    /// Unit normal of the outline in the picture, away from the object.
    outward: DVec2,
}

/// A place whose outline was found in the photograph.
struct Row {
    /// Pixels, along the outline's normal, by which a turn about each axis of the world and a wider outline move it.
    turns: DVec4,
    /// The same of the first three, as a vector in the picture.
    moves: [DVec2; 3],
    /// Pixels by which the photograph's outline lies outside.
    offset: f64,
    /// Which part of the outline.
    part: usize,
}

/// How a camera has to be turned for the outlines to meet.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    /// Rotation in the world, about the camera's place.
    pub rotation: DQuat,
    /// Root mean square of what that moves at the outline, pixels.
    pub moved: f64,
    /// Square of the turn in units of its standard error, over its three axes.
    pub significance: f64,
    /// Pixels by which the photograph's outline is wider all round.
    pub widened: f64,
    /// Root mean square distance of the outlines after it, pixels, without the places left out as outliers.
    pub left: f64,
}

/// The turn that brings the outline of `surface`, seen by `camera`, to that of `coverage`. `None` where too little of the
/// outline is in the picture or can be told from what lies beside it.
pub fn turn(
    camera: &Camera,
    surface: &ViewSurface,
    occluder: &Occluder,
    coverage: &[f32],
) -> Option<Turn> {
    let places = outline(camera, surface, occluder);
    let mut rotation = DQuat::IDENTITY;
    let mut reach = FIRST_REACH * f64::from(camera.width);
    loop {
        let last = reach <= LAST_REACH;
        let rows = measure(&turned(camera, rotation), &places, coverage, reach);
        let (fit, weights) = solve(&rows)?;
        rotation = (DQuat::from_scaled_axis(fit.truncate()) * rotation).normalize();
        if last {
            return Some(judge(&rows, &weights, fit, rotation));
        }
        reach = (0.5 * reach).max(LAST_REACH);
    }
}

/// `camera` turned in its place.
pub fn turned(camera: &Camera, rotation: DQuat) -> Camera {
    let mut turned = camera.clone();
    turned.world_from_camera.matrix3 =
        glam::DMat3::from_quat(rotation) * camera.world_from_camera.matrix3;
    turned
}

/// Places of the mesh's outline, evenly along it.
fn outline(camera: &Camera, surface: &ViewSurface, occluder: &Occluder) -> Vec<Place> {
    let (width, height) = (i64::from(surface.width), i64::from(surface.height));
    let shown = |x: i64, y: i64| {
        let inside = (0..width).contains(&x) && (0..height).contains(&y);
        inside && surface.triangle[(y * width + x) as usize] != NO_TRIANGLE
    };
    let mut crossings = Vec::new();
    for y in WINDOW..height - WINDOW {
        for x in WINDOW..width - WINDOW {
            if !shown(x, y) {
                continue;
            }
            for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                if !shown(x + dx, y + dy) {
                    crossings.push(([x, y], [dx, dy]));
                }
            }
        }
    }
    let every = crossings.len().div_ceil(PLACES).max(1);
    let eye = camera.position().as_vec3();
    let place = |&([x, y], [dx, dy]): &([i64; 2], [i64; 2])| {
        let mut slope = DVec2::ZERO;
        for v in -WINDOW..=WINDOW {
            for u in -WINDOW..=WINDOW {
                if !shown(x + u, y + v) {
                    slope += DVec2::new(u as f64, v as f64);
                }
            }
        }
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let step = DVec2::new(dx as f64, dy as f64);
        let (mut inside, mut outside) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (inside + outside);
            let ray = camera.ray(pixel + middle * step).as_vec3();
            if occluder.hit(eye, ray).is_some() {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        Some(Place {
            direction: camera.ray(pixel + 0.5 * (inside + outside) * step),
            outward: slope.try_normalize()?,
        })
    };
    crossings.iter().step_by(every).filter_map(place).collect()
}

/// Finds the photograph's outline near each place as the turned camera sees it.
fn measure(camera: &Camera, places: &[Place], coverage: &[f32], reach: f64) -> Vec<Row> {
    let eye = camera.position();
    let centre = places
        .iter()
        .filter_map(|place| camera.project(eye + place.direction))
        .sum::<DVec2>()
        / places.len().max(1) as f64;
    places
        .iter()
        .filter_map(|place| {
            let at = camera.project(eye + place.direction)?;
            // What the first camera's picture calls outward; turns are small.
            let offset = offset(camera, coverage, at, place.outward, reach)?;
            let mut moves = [DVec2::ZERO; 3];
            for (axis, moved) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().zip(&mut moves) {
                let direction = place.direction - TURN * axis.cross(place.direction);
                *moved = (camera.project(eye + direction)? - at) / TURN;
            }
            let [x, y, z] = moves.map(|m| m.dot(place.outward));
            let angle = (at - centre).to_angle() / std::f64::consts::TAU + 0.5;
            Some(Row {
                turns: DVec4::new(x, y, z, 1.0),
                moves,
                offset,
                part: ((angle * PARTS as f64) as usize).min(PARTS - 1),
            })
        })
        .collect()
}

/// How far outside `at` the photograph's outline lies, along the unit vector `outward`; `None` unless the line from `reach`
/// inside to `reach` outside leaves the object just once.
fn offset(camera: &Camera, coverage: &[f32], at: DVec2, outward: DVec2, reach: f64) -> Option<f64> {
    let steps = (2.0 * reach / STEP).round() as i32;
    let mut sum = 0.0;
    let mut travelled = 0.0;
    let mut before: Option<f64> = None;
    for k in 0..=steps {
        let covered = bilinear(
            camera,
            coverage,
            at + (f64::from(k) * STEP - reach) * outward,
        )?;
        let ends = k == 0 || k == steps;
        if k == 0 && covered < 0.98 || k == steps && covered > 0.02 {
            return None;
        }
        sum += if ends { 0.5 * covered } else { covered };
        travelled += before.map_or(0.0, |b| (covered - b).abs());
        before = Some(covered);
    }
    (travelled < 1.1).then_some(sum * STEP - reach)
}

fn bilinear(camera: &Camera, values: &[f32], at: DVec2) -> Option<f64> {
    let corner = (at - 0.5).floor();
    let (x, y) = (corner.x, corner.y);
    let inside = x >= 0.0
        && y >= 0.0
        && x + 1.0 < f64::from(camera.width)
        && y + 1.0 < f64::from(camera.height);
    if !inside {
        return None;
    }
    let part = at - 0.5 - corner;
    let width = camera.width as usize;
    let first = y as usize * width + x as usize;
    let value = |i: usize| f64::from(values[i]);
    let top = value(first) * (1.0 - part.x) + value(first + 1) * part.x;
    let bottom = value(first + width) * (1.0 - part.x) + value(first + width + 1) * part.x;
    Some(top * (1.0 - part.y) + bottom * part.y)
}

/// Turn about the three axes and widening that explain the offsets best, with each row's weight.
fn solve(rows: &[Row]) -> Option<(DVec4, Vec<f64>)> {
    if rows.len() < ENOUGH {
        return None;
    }
    let mut weights = vec![1.0; rows.len()];
    let mut fit = least_squares(rows, &weights, None)?;
    for _ in 0..ROUNDS {
        let residuals: Vec<f64> = rows.iter().map(|r| r.offset - r.turns.dot(fit)).collect();
        let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
        let (_, &mut middle, _) = sizes.select_nth_unstable_by(rows.len() / 2, f64::total_cmp);
        let limit = LIMIT * (1.4826 * middle).max(1e-6);
        for (weight, residual) in weights.iter_mut().zip(&residuals) {
            *weight = (1.0 - (residual / limit).powi(2)).max(0.0).powi(2);
        }
        fit = least_squares(rows, &weights, None)?;
    }
    Some((fit, weights))
}

/// Weighted least squares without the rows of one part of the outline.
fn least_squares(rows: &[Row], weights: &[f64], without: Option<usize>) -> Option<DVec4> {
    let mut normal = DMat4::ZERO;
    let mut right = DVec4::ZERO;
    for (row, &weight) in rows.iter().zip(weights) {
        if Some(row.part) == without {
            continue;
        }
        let scaled = weight * row.turns;
        normal += DMat4::from_cols(
            scaled * row.turns.x,
            scaled * row.turns.y,
            scaled * row.turns.z,
            scaled * row.turns.w,
        );
        right += scaled * row.offset;
    }
    let fit = normal.inverse() * right;
    fit.is_finite().then_some(fit)
}

/// How much a turn does and how sure it is: the jackknife over parts of the outline.
fn judge(rows: &[Row], weights: &[f64], fit: DVec4, rotation: DQuat) -> Turn {
    let total = rotation.to_scaled_axis();
    let replicates: Vec<DVec3> = (0..PARTS)
        .filter_map(|part| Some(least_squares(rows, weights, Some(part))?.truncate()))
        .collect();
    let count = replicates.len() as f64;
    let mean = replicates.iter().sum::<DVec3>() / count;
    let mut covariance = glam::DMat3::ZERO;
    for replicate in &replicates {
        let off = *replicate - mean;
        covariance += glam::DMat3::from_cols(off * off.x, off * off.y, off * off.z);
    }
    covariance *= (count - 1.0) / count;
    let moved = |row: &Row| {
        let [x, y, z] = row.moves;
        (x * total.x + y * total.y + z * total.z).length_squared()
    };
    let mut squares = 0.0;
    let mut weight = 0.0;
    for (row, w) in rows.iter().zip(weights) {
        squares += w * (row.offset - row.turns.dot(fit)).powi(2);
        weight += w;
    }
    Turn {
        rotation,
        moved: (rows.iter().map(moved).sum::<f64>() / rows.len() as f64).sqrt(),
        significance: total.dot(covariance.inverse() * total),
        widened: fit.w,
        left: (squares / weight.max(1.0)).sqrt(),
    }
}
