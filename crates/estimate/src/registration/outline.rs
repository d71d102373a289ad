//! Where a camera really is and looks: its photograph's outline against the mesh's.
//!
//! Coverage integrated along a line across the outline is the length of the line inside the object, so it says where the
//! outline is to a small part of a pixel, however pixels were filtered. What is found that way at many places of the mesh's
//! outline is explained by turning the camera in its place, and by an outline that is too wide or too narrow all round:
//! masks may be, and coarse meshes are. Where that leaves much, and moving the camera too brings the outlines together, it
//! stood elsewhere.

use faer::linalg::solvers::Solve;
use faer::{Col, Mat, Side};
use glam::{DMat3, DQuat, DVec2, DVec3};

use super::silhouettes::Silhouettes;
use rekindle_base::math::median;
use rekindle_capture::{Camera, Mesh};
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
/// Radians by which a camera is turned, and parts of its distance by which it is moved, to see what that does.
const NUDGE: f64 = 1e-6;
/// Rounds of reweighting; Tukey's limit in standard deviations.
const ROUNDS: usize = 8;
const LIMIT: f64 = 4.0;
/// Standard deviation over the median size, for normal errors.
const SPREAD: f64 = 1.4826;
/// Reaches that differ by no more than this factor are not told apart.
const ALIKE: f64 = 1.05;
/// Parts of the outline that are left out in turn to find a standard error.
const PARTS: usize = 16;

/// A camera stood elsewhere if the square of its shift over the standard error is at least this, and if the median place of the
/// outline then lies so many times as near. Of 259 cameras of captures as rendered, scanned and shot the six that were shifted by
/// 1.5 or 2 % of their distance have 4,900 and 1.9 times or more.
const LEAST_SIGNIFICANCE: f64 = 100.0;
const LEAST_NEARER: f64 = 1.5;
/// How often the outline of a moved camera is looked for anew, and the pixels below which that has come to rest.
const OUTLINES: usize = 4;
const AT_REST: f64 = 0.1;

/// Numbers of a motion: turns about the world's axes, and shifts along them in parts of the camera's distance.
const TURNS: usize = 3;
const MOTIONS: usize = 6;
/// The same with the widening of the outline.
const UNKNOWNS: usize = MOTIONS + 1;

/// A place of the mesh's outline.
struct Place {
    /// Where the line of sight leaves the surface, world.
    point: DVec3,
    /// Unit normal of the outline in the picture, away from the object.
    outward: DVec2,
}

/// A place whose outline was found in the photograph.
struct Row {
    /// Pixels, along the outline's normal, by which each unknown moves it.
    along: [f64; UNKNOWNS],
    /// The same of turns and shifts, as vectors in the picture.
    moves: [DVec2; MOTIONS],
    /// Pixels by which the photograph's outline lies outside.
    offset: f64,
    /// Which part of the outline.
    part: usize,
}

impl Row {
    fn left(&self, fit: &[f64; UNKNOWNS]) -> f64 {
        let explained = self.along.iter().zip(fit).map(|(a, f)| a * f);
        self.offset - explained.sum::<f64>()
    }
}

/// Which numbers are sought.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Freedom {
    Turn,
    TurnAndShift,
}

impl Freedom {
    /// The numbers' places among the unknowns.
    fn unknowns(self) -> &'static [usize] {
        match self {
            Self::Turn => &[0, 1, 2, 6],
            Self::TurnAndShift => &[0, 1, 2, 3, 4, 5, 6],
        }
    }
}

/// How a camera is moved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Rotation in the world, about the camera's place.
    pub rotation: DQuat,
    /// Shift of that place in the world, mesh units.
    pub shift: DVec3,
}

impl Motion {
    /// `camera` moved.
    pub fn applied(&self, camera: &Camera) -> Camera {
        let mut moved = camera.clone();
        moved.world_from_camera.matrix3 =
            DMat3::from_quat(self.rotation) * camera.world_from_camera.matrix3;
        moved.world_from_camera.translation += self.shift;
        moved
    }

    /// This one and then another.
    fn then(&self, next: &Self) -> Self {
        Self {
            rotation: (next.rotation * self.rotation).normalize(),
            shift: self.shift + next.shift,
        }
    }
}

/// How a camera has to be moved for the outlines to meet.
#[derive(Clone, Copy, Debug)]
pub struct Fit {
    /// That motion.
    pub motion: Motion,
    /// Root mean square of what it moves at the outline, pixels.
    pub moved: f64,
    /// Square of the turn in units of its standard error, over its three axes, and of the shift.
    pub significance: [f64; 2],
    /// Pixels by which the photograph's outline is wider all round.
    pub widened: f64,
    /// Root mean square distance of the outlines after it, pixels, without the places left out as outliers.
    pub left: f64,
    /// The median distance, of all places.
    typical: f64,
}

/// The motion that brings the outline of `surface`, seen by `camera`, to that of `coverage`: a turn, unless the camera plainly
/// stood elsewhere. `None` where too little of the outline is in the picture or can be told from what lies beside it.
pub fn fit(
    camera: &Camera,
    surface: &ViewSurface,
    (mesh, occluder): (&Mesh, &Occluder),
    coverage: &[f32],
) -> Option<Fit> {
    let places = outline(camera, surface, occluder);
    let first = FIRST_REACH * f64::from(camera.width);
    let start = towards(camera, surface, coverage, 0.5 * first);
    let settled = |freedom, places: &[Place], start, reach| {
        settle(camera, places, coverage, (freedom, start, reach))
    };
    let turned = settled(Freedom::Turn, &places, start, first)?;
    let is_elsewhere = |fit: &Fit| {
        LEAST_NEARER * fit.typical < turned.typical && fit.significance[1] > LEAST_SIGNIFICANCE
    };
    let Some(mut found) =
        settled(Freedom::TurnAndShift, &places, start, first).filter(is_elsewhere)
    else {
        return Some(turned);
    };
    for _ in 1..OUTLINES {
        // From elsewhere the outline is another line of the surface.
        let moved = found.motion.applied(camera);
        let surface = ViewSurface::new(mesh, occluder, &moved);
        let places = outline(&moved, &surface, occluder);
        let reach = (LIMIT * found.left).max(LAST_REACH);
        let Some(next) = settled(Freedom::TurnAndShift, &places, found.motion, reach) else {
            break;
        };
        let is_at_rest = (next.moved - found.moved).abs() < AT_REST;
        found = next;
        if is_at_rest {
            break;
        }
    }
    Some(if is_elsewhere(&found) { found } else { turned })
}

/// The turn that brings the middle of what the mesh covers to that of what the object does, if they are more than `least` pixels apart.
fn towards(camera: &Camera, surface: &ViewSurface, coverage: &[f32], least: f64) -> Motion {
    let centres = Silhouettes::new(coverage, surface).map(|silhouettes| silhouettes.centres);
    let rotation = match centres {
        Some([Some(object), Some(mesh)]) if mesh.distance(object) > least => {
            DQuat::from_rotation_arc(camera.ray(object), camera.ray(mesh))
        }
        _ => DQuat::IDENTITY,
    };
    Motion {
        rotation,
        ..Motion::default()
    }
}

/// The motion from a start on that brings the outline to `places`, looked for within a reach that shrinks.
fn settle(
    camera: &Camera,
    places: &[Place],
    coverage: &[f32],
    (freedom, mut motion, mut reach): (Freedom, Motion, f64),
) -> Option<Fit> {
    let distance = distance(camera, places);
    loop {
        let rows = measure(&motion.applied(camera), places, coverage, reach);
        let (fit, weights) = solve(&rows, freedom)?;
        motion = motion.then(&motion_of(&fit, distance));
        // No less than the outlines lie apart: the places found within less would be the lucky ones.
        let least = (LIMIT * SPREAD * middle(&left(&rows, &fit))).max(LAST_REACH);
        if reach <= least * ALIKE {
            return Some(judge(&rows, &weights, (&fit, freedom), (motion, distance)));
        }
        reach = (0.5 * reach).max(least);
    }
}

/// How far the outline is from the camera, in the mean.
fn distance(camera: &Camera, places: &[Place]) -> f64 {
    let eye = camera.position();
    let sum: f64 = places.iter().map(|place| place.point.distance(eye)).sum();
    sum / places.len().max(1) as f64
}

fn motion_of(fit: &[f64; UNKNOWNS], distance: f64) -> Motion {
    let [x, y, z, sx, sy, sz, _] = *fit;
    Motion {
        rotation: DQuat::from_scaled_axis(DVec3::new(x, y, z)),
        shift: distance * DVec3::new(sx, sy, sz),
    }
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
    let to_camera = camera.world_from_camera.matrix3.transpose();
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
        let depth = f64::from(surface.depth[(y * width + x) as usize]);
        let mut distance = depth / -(to_camera * camera.ray(pixel)).z;
        let (mut inside, mut outside) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (inside + outside);
            let ray = camera.ray(pixel + middle * step).as_vec3();
            if let Some(hit) = occluder.hit(eye, ray) {
                inside = middle;
                distance = f64::from(hit.distance);
            } else {
                outside = middle;
            }
        }
        let ray = camera.ray(pixel + 0.5 * (inside + outside) * step);
        Some(Place {
            point: camera.position() + distance * ray,
            outward: slope.try_normalize()?,
        })
    };
    crossings.iter().step_by(every).filter_map(place).collect()
}

/// Finds the photograph's outline near each place as the moved camera sees it.
fn measure(camera: &Camera, places: &[Place], coverage: &[f32], reach: f64) -> Vec<Row> {
    let eye = camera.position();
    let distance = distance(camera, places);
    let centre = places
        .iter()
        .filter_map(|place| camera.project(place.point))
        .sum::<DVec2>()
        / places.len().max(1) as f64;
    places
        .iter()
        .filter_map(|place| {
            let at = camera.project(place.point)?;
            // What the first camera's picture calls outward; turns are small.
            let offset = offset(camera, coverage, at, place.outward, reach)?;
            let mut moves = [DVec2::ZERO; MOTIONS];
            for (k, moved) in moves.iter_mut().enumerate() {
                let axis = DVec3::AXES[k % TURNS];
                let by = if k < TURNS {
                    axis.cross(place.point - eye)
                } else {
                    distance * axis
                };
                *moved = (camera.project(place.point - NUDGE * by)? - at) / NUDGE;
            }
            let angle = (at - centre).to_angle() / std::f64::consts::TAU + 0.5;
            Some(Row {
                along: std::array::from_fn(|k| moves.get(k).map_or(1.0, |m| m.dot(place.outward))),
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

/// The unknowns that explain the offsets best, those not sought 0, with each row's weight.
fn solve(rows: &[Row], freedom: Freedom) -> Option<([f64; UNKNOWNS], Vec<f64>)> {
    if rows.len() < ENOUGH {
        return None;
    }
    let mut weights = vec![1.0; rows.len()];
    let mut fit = least_squares(rows, &weights, freedom, None)?;
    for _ in 0..ROUNDS {
        let residuals = left(rows, &fit);
        let limit = LIMIT * (SPREAD * middle(&residuals)).max(1e-6);
        for (weight, residual) in weights.iter_mut().zip(&residuals) {
            *weight = (1.0 - (residual / limit).powi(2)).max(0.0).powi(2);
        }
        fit = least_squares(rows, &weights, freedom, None)?;
    }
    Some((fit, weights))
}

/// What some unknowns leave of the rows' offsets.
fn left(rows: &[Row], fit: &[f64; UNKNOWNS]) -> Vec<f64> {
    rows.iter().map(|row| row.left(fit)).collect()
}

/// The median size.
fn middle(residuals: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    median(&mut sizes).unwrap_or(0.0)
}

/// Weighted least squares without the rows of one part of the outline.
fn least_squares(
    rows: &[Row],
    weights: &[f64],
    freedom: Freedom,
    without: Option<usize>,
) -> Option<[f64; UNKNOWNS]> {
    let sought = freedom.unknowns();
    let mut normal = Mat::<f64>::zeros(sought.len(), sought.len());
    let mut right = Col::<f64>::zeros(sought.len());
    for (row, &weight) in rows.iter().zip(weights) {
        if Some(row.part) == without {
            continue;
        }
        for (i, &a) in sought.iter().enumerate() {
            right[i] += weight * row.along[a] * row.offset;
            for (j, &b) in sought.iter().enumerate() {
                normal[(i, j)] += weight * row.along[a] * row.along[b];
            }
        }
    }
    let solution = normal.llt(Side::Lower).ok()?.solve(right);
    let mut fit = [0.0; UNKNOWNS];
    for (i, &a) in sought.iter().enumerate() {
        fit[a] = solution[i];
    }
    fit.iter().all(|value| value.is_finite()).then_some(fit)
}

/// How much a motion does and how sure it is: the jackknife over parts of the outline.
fn judge(
    rows: &[Row],
    weights: &[f64],
    (fit, freedom): (&[f64; UNKNOWNS], Freedom),
    (motion, distance): (Motion, f64),
) -> Fit {
    let (turn, shift) = (motion.rotation.to_scaled_axis(), motion.shift / distance);
    let replicates: Vec<[f64; UNKNOWNS]> = (0..PARTS)
        .filter_map(|part| least_squares(rows, weights, freedom, Some(part)))
        .collect();
    let moved = |row: &Row| {
        let total = turn.to_array().into_iter().chain(shift.to_array());
        let sum: DVec2 = row.moves.iter().zip(total).map(|(&m, by)| m * by).sum();
        sum.length_squared()
    };
    let residuals = left(rows, fit);
    let weighted = residuals.iter().zip(weights).map(|(r, w)| w * r * r);
    let shifted = match freedom {
        Freedom::Turn => 0.0,
        Freedom::TurnAndShift => significance(shift, &replicates, TURNS),
    };
    Fit {
        motion,
        moved: (rows.iter().map(moved).sum::<f64>() / rows.len() as f64).sqrt(),
        significance: [significance(turn, &replicates, 0), shifted],
        widened: fit[MOTIONS],
        left: (weighted.sum::<f64>() / weights.iter().sum::<f64>().max(1.0)).sqrt(),
        typical: middle(&residuals),
    }
}

/// The square of three numbers in units of their standard error, which their replicates, from unknown `first` on, tell.
fn significance(total: DVec3, replicates: &[[f64; UNKNOWNS]], first: usize) -> f64 {
    let count = replicates.len() as f64;
    let own = |fit: &[f64; UNKNOWNS]| DVec3::from_slice(&fit[first..]);
    let mean = replicates.iter().map(own).sum::<DVec3>() / count;
    let mut covariance = DMat3::ZERO;
    for off in replicates.iter().map(|fit| own(fit) - mean) {
        covariance += DMat3::from_cols(off * off.x, off * off.y, off * off.z);
    }
    covariance *= (count - 1.0) / count;
    total.dot(covariance.inverse() * total)
}
