//! Which of the lamps that spikes fall into are one?
//!
//! Non-negative least squares gives a lamp about as wide as the lobe as a ring of spikes, with gaps that a person would
//! take for the space between lamps. Only the data can tell: for lamps nearer to each other than the lobe's width two
//! lights are compared, the uniform ellipse that fits best, and one for each of them with its flux, centroid and second
//! moments. The one leaves more than the several where lamps do lie apart, all over the surface, and hardly more or less, or more here and
//! less there, where they are parts of one lamp.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::atomic::Ordering;

use faer::linalg::solvers::Solve;
use faer::{Col, Mat, Side};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::cells::Cell;
use super::design::Design;
use super::ellipse::{Ellipse, PARAMETERS};
use super::fast::Solver;
use super::observations::Observations;
use super::state::State;
use rekindle_base::math::groups::linked_groups;
use rekindle_base::math::ranks::{SURE, placed_signed_ranks};
use rekindle_scene::hemisphere::{HemisphereGrid, Lamp, find_lamps};

/// Parts of lamps with a larger radius, in widths of the lobe, show the lamp's own shape and not an ellipse.
const WIDEST: f32 = 2.0;
/// Over what the spikes leave, a round disc may leave so many times as much as several ellipses do, and a longish one less, as
/// two lamps look like a long one: of discs of 5 to 15° radius it was 0.2 to 5.5 times as much, of two narrow lamps 6 to 12°
/// apart 19 times and more, and down to 3.9 times among twelve. …
const MOST_RATIO: f64 = 7.0;
/// … And one may leave so many times the noise's variance more, for each ellipse less.
const MOST_NOISE: f64 = 20.0;

/// Room around an ellipse in which it may move and grow, in radii.
const REACH: f32 = 0.4;
/// Rounds in which it is fitted.
const ROUNDS: usize = 5;
/// A round that leaves more than this part of what was left before is the last.
const SETTLED: f64 = 0.98;
/// Differences for its derivatives, in widths of a node.
const DIFFERENCE: f32 = 0.25;

/// What lamps are judged by.
struct Judge<'a> {
    solver: &'a Solver<'a>,
    /// The final fit.
    state: &'a State<'a>,
    observations: &'a Observations,
    /// Its radiance on the nodes.
    nodes: &'a [[f32; 3]],
}

/// Radiances on the nodes with every lamp that spikes take apart as one uniform ellipse.
pub fn merge_lamps(
    solver: &Solver<'_>,
    state: &State<'_>,
    observations: &Observations,
) -> Vec<[f32; 3]> {
    let mut nodes = solver.pyramid.to_nodes(&state.cells, &state.radiance);
    let judge = Judge {
        solver,
        state,
        observations,
        nodes: &nodes,
    };
    let lamps = find_lamps(solver.grid, &nodes);
    let width = state.lobe_width();
    let gaps = Gaps::new(solver.grid, &lamps, width);
    let mut merged = Vec::new();
    for group in gaps.groups((0..lamps.len()).collect(), width) {
        judge.merge(&group, (&lamps, &gaps), &mut merged);
    }
    for &node in merged.iter().flat_map(|one| &one.lamp.nodes) {
        nodes[node as usize] = [0.0; 3];
    }
    for one in &merged {
        one.ellipse.add_to(&mut nodes, solver.grid);
    }
    nodes
}

/// A lamp that spikes had taken apart.
struct Merged {
    /// The spikes.
    lamp: Lamp,
    /// What is put in their place.
    ellipse: Ellipse,
}

/// Radiance of some nodes.
type Light = BTreeMap<u32, Vec3>;

fn light(nodes: impl IntoIterator<Item = (usize, [f32; 3])>) -> Light {
    let mut light = Light::new();
    for (node, radiance) in nodes {
        *light.entry(node as u32).or_default() += Vec3::from(radiance);
    }
    light
}

/// How far lamps lie apart: the distance of the nearest of their nodes, on the unit sphere.
struct Gaps {
    lamps: usize,
    /// Those of each lamp to all, lamp by lamp; infinite where no nodes come near each other.
    gaps: Vec<f32>,
}

impl Gaps {
    /// Those below `most` of some lamps.
    fn new(grid: &HemisphereGrid, lamps: &[Lamp], most: f32) -> Self {
        let direction = |&node: &u32| grid.directions[node as usize];
        let reach = |lamp: &Lamp| {
            let from_middle = lamp
                .nodes
                .iter()
                .map(|node| direction(node).distance(lamp.direction));
            from_middle.fold(0.0, f32::max)
        };
        let reaches: Vec<f32> = lamps.iter().map(reach).collect();
        let gap = |(i, j): (usize, usize)| {
            let (a, b) = (&lamps[i], &lamps[j]);
            let near = b.nodes.iter().map(direction);
            let near = near.filter(|d| d.distance(a.direction) < reaches[i] + most);
            let near: Vec<Vec3> = near.collect();
            let squared = a.nodes.iter().map(direction).flat_map(|d| {
                let to = move |e: &Vec3| d.distance_squared(*e);
                near.iter().map(to)
            });
            let gap = squared.fold(f32::INFINITY, f32::min).sqrt();
            if gap < most { gap } else { f32::INFINITY }
        };
        let pairs = (0..lamps.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
        let pairs: Vec<(usize, usize)> = pairs.collect();
        let found: Vec<f32> = pairs.par_iter().map(|&pair| gap(pair)).collect();
        let mut gaps = vec![f32::INFINITY; lamps.len() * lamps.len()];
        for (&(i, j), gap) in pairs.iter().zip(found) {
            gaps[i * lamps.len() + j] = gap;
            gaps[j * lamps.len() + i] = gap;
        }
        Self {
            lamps: lamps.len(),
            gaps,
        }
    }

    fn between(&self, i: usize, j: usize) -> f32 {
        self.gaps[i * self.lamps + j]
    }

    /// The groups that hang together by smaller gaps.
    fn groups(&self, lamps: Vec<usize>, gap: f32) -> Vec<Vec<usize>> {
        linked_groups(lamps, |&i, &j| self.between(i, j) < gap)
    }

    /// The largest of the gaps by which a group just hangs together: the longest edge of its minimum spanning tree, as Prim
    /// grows it.
    fn widest_link(&self, group: &[usize]) -> f32 {
        let mut left: Vec<(usize, f32)> = group.iter().map(|&i| (i, f32::INFINITY)).collect();
        let mut widest = 0.0_f32;
        let mut last = left.pop().map(|(i, _)| i);
        while let Some(i) = last {
            for (j, gap) in &mut left {
                *gap = gap.min(self.between(i, *j));
            }
            let nearest = (0..left.len()).min_by(|&a, &b| left[a].1.total_cmp(&left[b].1));
            let next = nearest.map(|k| left.swap_remove(k));
            widest = next.map_or(widest, |(_, gap)| widest.max(gap));
            last = next.map(|(i, _)| i);
        }
        widest
    }
}

impl Judge<'_> {
    fn is_stopped(&self) -> bool {
        self.solver.stop.load(Ordering::Relaxed)
    }

    /// Puts together what is one lamp: all of a group, or else of the parts that its widest gap divides it into.
    fn merge(&self, group: &[usize], all: (&[Lamp], &Gaps), merged: &mut Vec<Merged>) {
        if group.len() < 2 || self.is_stopped() {
            return;
        }
        let (lamps, gaps) = all;
        let of_group: Vec<Lamp> = group.iter().map(|&i| lamps[i].clone()).collect();
        if let Some(one) = self.as_one(&of_group) {
            merged.push(one);
            return;
        }
        for part in gaps.groups(group.to_vec(), gaps.widest_link(group)) {
            self.merge(&part, all, merged);
        }
    }

    /// One ellipse, if it explains the photographs about as well as one for each of some parts.
    fn as_one(&self, parts: &[Lamp]) -> Option<Merged> {
        let grid = self.solver.grid;
        let nodes = parts.iter().flat_map(|lamp| lamp.nodes.iter().copied());
        let lamp = Lamp::new(grid, self.nodes, nodes.collect())?;
        if lamp.angular_radius > WIDEST * self.state.lobe_width() {
            return None;
        }
        let start = Ellipse::of(grid, self.nodes, &lamp);
        let spike = |&node: &u32| (node as usize, self.nodes[node as usize]);
        let spikes = light(lamp.nodes.iter().map(spike));
        let of_part = |part| Ellipse::of(grid, self.nodes, part).nodes(grid);
        let several = light(parts.iter().flat_map(of_part));
        let around = start
            .reach(grid, REACH * lamp.angular_radius)
            .map(|n| n as u32);
        let all = spikes.keys().chain(several.keys()).copied().chain(around);
        let place = Place::new(self, all.collect(), &spikes);
        let present = self.state.squares();
        let variance = present / (3.0 * self.state.weights.len() as f64);
        let noise = MOST_NOISE * variance * (parts.len() - 1) as f64;
        let several = place.with(&several);
        let (ellipse, one) = place.fit(start);
        let by_several = (several.left - present).max(0.0);
        let is_as_good =
            one.left - present < MOST_RATIO * f64::from(ellipse.roundness()) * by_several + noise;
        let is_one = is_as_good || place.is_by_chance(&one, &several);
        is_one.then(|| Merged {
            lamp,
            ellipse: ellipse.times(one.factor.as_vec3()),
        })
    }
}

/// The part of the hemisphere in which other light is put in the place of spikes.
struct Place<'a> {
    judge: &'a Judge<'a>,
    cells: Vec<Cell>,
    design: Design<'a>,
    /// The residuals without the spikes.
    residuals: Vec<DVec3>,
    /// Their weighted squares.
    squares: DVec3,
}

/// A light in the place of spikes, as strong as fits best.
struct Shown {
    /// What it shows at the rows, at its own strength.
    values: Vec<DVec3>,
    /// The weighted squares of that.
    own: DVec3,
    /// Its best strength.
    factor: DVec3,
    /// Weighted squares of the residuals that it leaves.
    left: f64,
}

/// The strength, per channel, at which a light leaves least whose values hold `along` of the residuals and `own` of themselves: none in a
/// channel that it would have to darken.
fn strength(along: DVec3, own: DVec3) -> DVec3 {
    (along / own).max(DVec3::ZERO)
}

impl<'a> Place<'a> {
    fn new(judge: &'a Judge<'a>, nodes: BTreeSet<u32>, spikes: &Light) -> Self {
        let level = judge.solver.pyramid.finest();
        let cells: Vec<Cell> = nodes.into_iter().map(|node| Cell { level, node }).collect();
        let brdf = &judge.state.brdf;
        let design = judge
            .solver
            .shadowed_design(judge.observations, &cells, brdf);
        let mut place = Self {
            judge,
            cells,
            design,
            residuals: Vec::new(),
            squares: DVec3::ZERO,
        };
        let present = judge.state.residuals.values.iter();
        place.residuals = present
            .zip(place.shown(spikes))
            .map(|(&residual, spikes)| Vec3::from(residual).as_dvec3() + spikes)
            .collect();
        place.squares = place.dot(&place.residuals, &place.residuals);
        place
    }

    /// What a light shows at the rows; nothing after a stop.
    fn shown(&self, light: &Light) -> Vec<DVec3> {
        let state = self.judge.state;
        if self.judge.is_stopped() {
            return vec![DVec3::ZERO; state.weights.len()];
        }
        let of = |cell: &Cell| light.get(&cell.node).map_or([0.0; 3], Vec3::to_array);
        let radiance: Vec<[f32; 3]> = self.cells.iter().map(of).collect();
        let mut values = self.design.predict_values(&state.brdf, &radiance);
        state.eliminate(&mut values);
        values
            .into_iter()
            .map(|v| Vec3::from(v).as_dvec3())
            .collect()
    }

    /// Σ w a b over the rows, per channel.
    fn dot(&self, a: &[DVec3], b: &[DVec3]) -> DVec3 {
        let weights = &self.judge.state.weights;
        let rows = a.iter().zip(b).zip(weights);
        rows.map(|((&a, &b), &w)| f64::from(w) * a * b).sum()
    }

    /// A light in the place of the spikes.
    fn with(&self, light: &Light) -> Shown {
        let values = self.shown(light);
        let own = self
            .dot(&values, &values)
            .max(DVec3::splat(f64::MIN_POSITIVE));
        let along = self.dot(&values, &self.residuals);
        let factor = strength(along, own);
        let left = self.squares - factor * (2.0 * along - factor * own);
        Shown {
            values,
            own,
            factor,
            left: left.element_sum(),
        }
    }

    /// Whether chance may decide that one light leaves more than another: where normals are off, as on scans, several lights explain some
    /// of them better than one does, but not all over the surface.
    fn is_by_chance(&self, one: &Shown, other: &Shown) -> bool {
        let left = |shown: &Shown, rows: Range<usize>| -> f64 {
            let of_row = |k: usize| {
                let residual = self.residuals[k] - shown.factor * shown.values[k];
                f64::from(self.judge.state.weights[k]) * residual.length_squared()
            };
            rows.map(of_row).sum()
        };
        let points = self.judge.observations.points.iter();
        let pairs = points.map(|point| {
            let [one, other] = [one, other].map(|shown| left(shown, point.rows.clone()));
            (point.position, one, other)
        });
        placed_signed_ranks(&pairs.collect::<Vec<_>>()) <= SURE
    }

    /// The ellipse that leaves least, and what it shows, sought from one that leaves little by Gauss-Newton steps on place and
    /// shape, the strength eliminated.
    fn fit(&self, start: Ellipse) -> (Ellipse, Shown) {
        let grid = self.judge.solver.grid;
        let (mut ellipse, mut shown) = (start, self.with(&light(start.nodes(grid))));
        for _ in 0..ROUNDS {
            let Some(step) = self.step(&ellipse, &shown) else {
                break;
            };
            let mut tried = [1.0, 0.4].into_iter().map(|part| {
                let next = ellipse.changed(step.map(|s| part * s), grid);
                (next, self.with(&light(next.nodes(grid))))
            });
            let Some(better) = tried.find(|(_, then)| then.left < shown.left) else {
                break;
            };
            let settled = better.1.left > SETTLED * shown.left;
            (ellipse, shown) = better;
            if settled {
                break;
            }
        }
        (ellipse, shown)
    }

    /// A Gauss-Newton step of an ellipse.
    fn step(&self, ellipse: &Ellipse, shown: &Shown) -> Option<[f32; PARAMETERS]> {
        let grid = self.judge.solver.grid;
        let delta = DIFFERENCE * grid.spacing();
        let columns: Vec<Vec<DVec3>> = (0..PARAMETERS)
            .map(|k| {
                let mut by = [0.0; PARAMETERS];
                by[k] = delta;
                let changed = self.shown(&light(ellipse.changed(by, grid).nodes(grid)));
                let scale = shown.factor / f64::from(delta);
                let pairs = changed.into_iter().zip(&shown.values);
                let mut column: Vec<DVec3> = pairs.map(|(a, b)| scale * (a - *b)).collect();
                let along = self.dot(&column, &shown.values) / shown.own;
                for (value, shown) in column.iter_mut().zip(&shown.values) {
                    *value -= along * *shown;
                }
                column
            })
            .collect();
        let left: Vec<DVec3> = (self.residuals.iter().zip(&shown.values))
            .map(|(residual, shown_there)| *residual - shown.factor * *shown_there)
            .collect();
        let gram = Mat::from_fn(PARAMETERS, PARAMETERS, |i, j| {
            self.dot(&columns[i], &columns[j]).element_sum()
        });
        let right = Col::from_fn(PARAMETERS, |i| self.dot(&columns[i], &left).element_sum());
        let step = gram.llt(Side::Lower).ok()?.solve(&right);
        Some(std::array::from_fn(|k| step[k] as f32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_light_is_negative_in_a_channel() {
        // What is left of the blue would best be explained by darkness: as a negative radiance a solution could not be read again.
        let strength = strength(DVec3::new(6.0, 2.0, -0.1), DVec3::new(2.0, 2.0, 2.0));
        assert_eq!(strength, DVec3::new(3.0, 1.0, 0.0));
    }
}
