//! Where light comes from by single highlights, before any lobe or light is known.
//!
//! A row that shows much more than its point does in other views is a highlight, or something is out of place: texture, a shadow's edge.
//! The light of a highlight stands about where the surface mirrors the camera there; what is out of place points anywhere. So places are
//! counted, in caps of the sphere. A place is a block of the surface in one view, and speaks for a cap once, however many of its rows
//! stand out. Its chance to do so by accident is that of as many rows of its class anywhere: of its view, and as grazing. A cap for which more
//! places speak than chance brings (Poisson, with Bonferroni's correction for all caps and thresholds that are looked at) has a light.
//!
//! It finds gloss on few parts of a surface: most points that mirror a light there contradict it, and a robust fit believes them.

use std::collections::BTreeMap;

use glam::Vec3;

use super::fast::Solver;
use super::near::{Near, mirrored};
use super::observations::{Observations, Point};
use rekindle_base::math::morton;
use rekindle_scene::hemisphere::HemisphereGrid;

/// Pixels looked at for points: few rows are highlights.
const POINTS: usize = 60_000;
/// Frequency of the grid whose nodes are the caps' centres, 3° apart, and the caps' radius, radians.
const FREQUENCY: u32 = 22;
const RADIUS: f32 = 0.07;
/// How much more than the middle of its point's a row has to show, as a part of that; each is tried.
const OUTSTANDING: [f32; TRIED] = [8.0, 4.0, 2.0, 1.0, 0.5];
const TRIED: usize = 5;
/// And how much to be called a highlight once it is known where they point.
const HIGHLIGHT: f32 = 1.0;
/// Part of that by which it may be off: its image detail.
const LEAST_SURE: f32 = 0.3;
/// A point's radiance is at least this part of the mean, so that what is nearly black does not stand out by noise.
const DARK: f32 = 0.1;
/// Rows at a smaller cosine between normal and view are not asked: they are out of place more often.
const LEAST_COS: f32 = 0.4;
/// Classes by that cosine in each view.
const CLASSES: usize = 4;
/// Blocks along the longest side of the surface.
const BLOCKS: f32 = 64.0;
/// The case that may be chance, as a part of all.
const RISK: f64 = 0.05;
/// Most directions, and the least angle between two, in radii.
const MOST: usize = 12;
const APART: f32 = 3.0;

/// A row that may be a highlight.
struct Ballot {
    /// The block and the view.
    place: (u32, usize),
    class: usize,
    /// The direction that it mirrors.
    towards: Vec3,
    /// See [`outstanding`].
    outstanding: f32,
}

/// What the rows of a place say in a cap: how often one of them would stand out by accident, and whether one does, by each of [`OUTSTANDING`].
#[derive(Clone, Copy, Default)]
struct Place {
    rates: [f64; TRIED],
    stands_out: [bool; TRIED],
}

/// A cap, with the logarithm of the chance of so many places that speak for it.
#[derive(Clone, Copy)]
struct Cap {
    node: usize,
    log_chance: f64,
}

/// Directions that light comes from, beyond chance, those of the brightest highlights first.
pub fn directions(solver: &Solver<'_>) -> Vec<Vec3> {
    let observations = solver.colours(POINTS).measured().to_gray();
    let grid = solver.grid.at_frequency(FREQUENCY);
    let ballots = ballots(&observations, &grid);
    let allowed = (RISK / (grid.directions.len() * OUTSTANDING.len()) as f64).ln();
    let mut directions: Vec<Vec3> = Vec::new();
    // What stands out most is nearest to where the light is mirrored.
    for caps in caps(&grid, &ballots) {
        for cap in caps.into_iter().take_while(|cap| cap.log_chance < allowed) {
            let direction = grid.directions[cap.node];
            let is_apart = |other: &Vec3| other.dot(direction) < (APART * RADIUS).cos();
            if directions.iter().all(is_apart) && directions.len() < MOST {
                directions.push(direction);
            }
        }
    }
    directions
}

/// Whether each point has a row that stands out and mirrors what is near some directions.
pub fn shown(observations: &Observations, near: &Near<'_>) -> Vec<bool> {
    let stands_out = outstanding(observations);
    let shows = |point: &Point| {
        let rows = &observations.rows[point.rows.clone()];
        let mut rows = rows.iter().zip(&stands_out[point.rows.clone()]);
        rows.any(|(row, &more)| {
            more > HIGHLIGHT && near.is_mirrored((point.position, point.normal), row, 1.0)
        })
    };
    observations.points.iter().map(shows).collect()
}

/// By how much each row shows more than the middle of its point's, as a part of that; 0 where image detail may be why.
fn outstanding(observations: &Observations) -> Vec<f32> {
    let mut all = Vec::with_capacity(observations.rows.len());
    for point in &observations.points {
        let rows = &observations.rows[point.rows.clone()];
        let asked = rows.iter().filter(|row| row.cos_view >= LEAST_COS);
        let mut values: Vec<f32> = asked.map(|row| row.radiance[0]).collect();
        values.sort_unstable_by(f32::total_cmp);
        // The lower one of two: the other is what may stand out.
        let middle = values.get(values.len().saturating_sub(1) / 2);
        all.extend(rows.iter().map(|row| {
            let more = row.radiance[0] - middle.unwrap_or(&row.radiance[0]);
            let is_sure = row.cos_view >= LEAST_COS && row.detail < LEAST_SURE * more;
            if is_sure {
                more / (middle.unwrap_or(&0.0).max(0.0) + DARK)
            } else {
                0.0
            }
        }));
    }
    all
}

/// The rows that are asked.
fn ballots(observations: &Observations, grid: &HemisphereGrid) -> Vec<Ballot> {
    let positions = observations.points.iter().map(|point| point.position);
    let low = positions.clone().fold(Vec3::MAX, Vec3::min);
    let high = positions.fold(Vec3::MIN, Vec3::max);
    let size = ((high - low).max_element() / BLOCKS).max(f32::MIN_POSITIVE);
    let stands_out = outstanding(observations);
    let of_point = |point: &Point| {
        let [x, y, z] = ((point.position - low) / size).to_array().map(|v| v as u32);
        let block = morton::code([x, y, z]);
        let rows = point.rows.clone();
        let asked = rows.filter(|&k| observations.rows[k].cos_view >= LEAST_COS);
        let ballot = |k: usize| {
            let row = &observations.rows[k];
            let of_view = (row.cos_view * CLASSES as f32) as usize;
            Some(Ballot {
                place: (block, row.view),
                class: row.view * CLASSES + of_view.min(CLASSES - 1),
                towards: mirrored(grid, (point.position, point.normal), row.to_camera)?,
                outstanding: stands_out[k],
            })
        };
        asked.filter_map(ballot).collect::<Vec<_>>()
    };
    observations.points.iter().flat_map(of_point).collect()
}

/// The caps about all nodes of a grid by rows that stand out by each of [`OUTSTANDING`], those that are least by chance first.
fn caps(grid: &HemisphereGrid, ballots: &[Ballot]) -> [Vec<Cap>; TRIED] {
    let stands_out = |ballot: &Ballot| OUTSTANDING.map(|least| ballot.outstanding > least);
    let mut classes: BTreeMap<usize, ([f64; TRIED], f64)> = BTreeMap::new();
    for ballot in ballots {
        let (standing, all) = classes.entry(ballot.class).or_default();
        for (standing, stands_out) in standing.iter_mut().zip(stands_out(ballot)) {
            *standing += f64::from(u8::from(stands_out));
        }
        *all += 1.0;
    }
    let mut caps = vec![BTreeMap::<_, Place>::new(); grid.directions.len()];
    for ballot in ballots {
        let (standing, all) = classes[&ballot.class];
        let rates = standing.map(|standing| -(-standing / all).ln_1p());
        let stands_out = stands_out(ballot);
        for node in within(grid, ballot.towards) {
            let place = caps[node].entry(ballot.place).or_default();
            for k in 0..TRIED {
                place.rates[k] += rates[k];
                place.stands_out[k] |= stands_out[k];
            }
        }
    }
    std::array::from_fn(|k| {
        let cap = |(node, places): (usize, &BTreeMap<_, Place>)| {
            let chance = |place: &Place| -(-place.rates[k]).exp_m1();
            let expected: f64 = places.values().map(chance).sum();
            let count = places.values().filter(|place| place.stands_out[k]).count();
            Cap {
                node,
                log_chance: log_tail(count as f64, expected),
            }
        };
        let mut caps: Vec<Cap> = caps.iter().enumerate().map(cap).collect();
        caps.sort_by(|a, b| a.log_chance.total_cmp(&b.log_chance));
        caps
    })
}

/// Nodes within [`RADIUS`] of a direction; none below the horizon of a hemisphere.
fn within(grid: &HemisphereGrid, direction: Vec3) -> Vec<usize> {
    let least = RADIUS.cos();
    let mut nodes: Vec<usize> = grid.nearest(direction).into_iter().collect();
    let mut next = 0;
    while next < nodes.len() {
        for beside in grid.neighbours(nodes[next]) {
            if grid.directions[beside].dot(direction) > least && !nodes.contains(&beside) {
                nodes.push(beside);
            }
        }
        next += 1;
    }
    nodes
}

/// Logarithm of the chance that `count` or more things happen where so many are expected (Poisson), by Chernoff's bound.
fn log_tail(count: f64, expected: f64) -> f64 {
    if count <= expected {
        return 0.0;
    }
    count - expected - count * (count / expected.max(f64::MIN_POSITIVE)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_is_expected_is_less_likely_and_no_more_says_nothing() {
        assert_eq!(log_tail(2.0, 3.0), 0.0);
        assert_eq!(log_tail(0.0, 0.0), 0.0);
        // P(X ≥ 10) where 1 is expected is 1.1e-7; the bound is above it.
        let bound = log_tail(10.0, 1.0).exp();
        assert!((1.1e-7..1e-5).contains(&bound), "{bound}");
    }

    #[test]
    fn a_cap_has_the_nodes_that_are_near_its_centre() {
        let grid = HemisphereGrid::new(FREQUENCY, Vec3::Y, None, Vec3::ZERO);
        let direction = Vec3::new(0.3, 0.7, -0.2).normalize_or_zero();
        let mut found = within(&grid, direction);
        found.sort_unstable();
        let near = |&node: &usize| grid.directions[node].angle_between(direction) < RADIUS;
        let all: Vec<usize> = (0..grid.directions.len()).filter(near).collect();
        assert!(all.len() >= 5 && found == all, "{found:?} {all:?}");
    }
}
