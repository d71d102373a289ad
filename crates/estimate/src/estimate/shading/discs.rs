//! Light by shading as discs.
//!
//! Cells all around tell where light comes from by their own width. A lamp or a sun is less than that, and its shadows and its terminator
//! say to a fraction of a degree where it stands. So the lights that cells show are taken as uniform discs, each of a flux, a direction and
//! a radius, and these numbers are fitted to what the cells were: that the albedos of neighbouring points differ least. Beside them there
//! is light from everywhere, and what the surface sends to itself: its own radiance is measured, so that only how much it counts is open.

use std::sync::atomic::Ordering;

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use glam::Vec3;
use rayon::prelude::*;

use super::region::{Receivers, Region};
use super::{DARK, contrasts, differences, every_second, mean, robust_weights};
use crate::estimate::ellipse::Ellipse;
use rekindle_base::math::ranks::signed_ranks;
use rekindle_scene::hemisphere::{HemisphereGrid, Lamp};

/// Numbers of a disc's shape: its direction's two, and its radius.
const OF_SHAPE: usize = 3;
/// Half the difference for derivatives by them, in widths of a node.
const DIFFERENCE: f32 = 0.25;
/// The longest step of one of them, radians.
const LONGEST: f64 = 0.05;
/// Cells are as wide as the light that they show, or wider: discs may have such parts of their radius.
const NARROWED: [f32; 2] = [1.0, 0.3];

/// Rounds, how often a step is tried shorter, and the change of what is left, over the pairs' number, that ends them.
const ROUNDS: usize = 30;
const TRIES: usize = 6;
const SETTLED: f64 = 2e-5;
/// Damping of the first step, as a part of the equations' diagonal, and the factor by which it changes.
const DAMPING: f64 = 1e-3;
const DAMPED: f64 = 8.0;
/// How much the mean irradiance is held, as a part of the mean diagonal.
const HELD: f64 = 10.0;

/// A uniform light of few numbers.
#[derive(Clone, Debug)]
pub struct Disc {
    /// Of unit flux.
    pub shape: Ellipse,
    /// Σ L ω.
    pub flux: f64,
    /// Which of the regions it is in.
    region: usize,
}

/// Discs, and other light.
#[derive(Clone, Debug)]
pub struct Discs {
    pub all: Vec<Disc>,
    /// How strong each part of what light there is beside them is. The mean irradiance by everything is 1.
    beside: Vec<f64>,
}

impl Discs {
    /// Those of some lamps.
    pub fn of(lamps: &[Lamp], grid: &HemisphereGrid, nodes: &[[f32; 3]]) -> Self {
        let disc = |lamp: &Lamp| Disc {
            shape: Ellipse::of(grid, nodes, lamp).with_flux(Vec3::ONE),
            flux: f64::from(lamp.mean_flux()),
            region: 0,
        };
        Self {
            all: lamps.iter().map(disc).collect(),
            beside: Vec::new(),
        }
    }

    /// The same, each in a region of its own that it may move in, and these.
    pub fn in_regions(mut self, on: &Receivers<'_>) -> (Self, Vec<Region>) {
        for (region, disc) in self.all.iter_mut().enumerate() {
            disc.region = region;
        }
        let regions = self.all.iter().map(|disc| Region::new(on, &disc.shape));
        let regions = regions.collect();
        (self, regions)
    }

    /// With radii that are so many times as long.
    fn scaled(&self, factor: f32, grid: &HemisphereGrid) -> Self {
        let mut scaled = self.clone();
        for disc in &mut scaled.all {
            disc.shape = disc.shape.scaled(factor, grid);
        }
        scaled
    }

    /// Without so many of the weakest.
    fn without_weakest(&self, count: usize) -> Self {
        let mut fewer = self.clone();
        fewer.all.sort_by(|a, b| b.flux.total_cmp(&a.flux));
        fewer.all.truncate(self.all.len() - count);
        fewer
    }

    fn times(mut self, factor: f64) -> Self {
        for disc in &mut self.all {
            disc.flux *= factor;
        }
        for strength in &mut self.beside {
            *strength *= factor;
        }
        self
    }
}

/// What may change of discs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Free {
    /// Everything.
    All,
    /// Fluxes, and other light.
    Flux,
}

/// What discs are fitted to.
#[derive(Clone, Copy)]
pub struct Fitting<'a> {
    pub on: Receivers<'a>,
    /// Diffuse radiance of each point, with a mean of 1.
    pub radiance: &'a [f64],
    /// Irradiance of each point by each part of what light there is beside discs.
    pub beside: &'a [Vec<f64>],
    /// Where discs may be.
    pub regions: &'a [Region],
}

/// Discs with the irradiance of each point by a unit flux of each, and by all.
#[derive(Clone)]
struct Lit {
    discs: Discs,
    by_disc: Vec<Vec<f64>>,
    all: Vec<f64>,
}

impl Fitting<'_> {
    /// Radiance of each node, RGB, by the discs that pairs tell, from some on; `None` where what cells say makes pairs that had no say differ
    /// less, by as much as `judged`. See [`Fitting::narrowed`], [`Fitting::better`] and [`Fitting::nodes`].
    pub fn by_discs(
        &self,
        start: Discs,
        (pairs, judged): (&[[usize; 2]], &[f64]),
        (by_channel, unit): (&[Vec<f64>; 3], f64),
    ) -> Option<Vec<[f32; 3]>> {
        if start.all.is_empty() {
            return None;
        }
        let (start, regions) = start.in_regions(&self.on);
        let about_cells = Fitting {
            regions: &regions,
            ..*self
        };
        let narrowed = about_cells.narrowed(&start, pairs)?;
        let (start, regions) = narrowed.in_regions(&self.on);
        let about_discs = Fitting {
            regions: &regions,
            ..*self
        };
        let discs = about_discs.better(&start, pairs, judged)?;
        Some(about_discs.nodes(&discs, by_channel, pairs, unit))
    }

    /// The discs that pairs tell, from some on that may be too wide.
    fn narrowed(&self, start: &Discs, pairs: &[[usize; 2]]) -> Option<Discs> {
        let starts = NARROWED.map(|factor| start.scaled(factor, self.on.grid));
        let fitted = starts.map(|start| self.fitted(&start, pairs, Free::All));
        let best = fitted.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        best.map(|(_, discs)| discs)
    }

    /// The discs that pairs tell, from some on, if they make those that had no say differ less than `judged`: there are fewer numbers than
    /// what that is of has. Those without which these differ no more are left out.
    fn better(&self, start: &Discs, pairs: &[[usize; 2]], judged: &[f64]) -> Option<Discs> {
        let (_, mut best) = self.fitted(start, pairs, Free::All);
        let by_all = self.judged(&best, pairs);
        if signed_ranks(judged, &by_all) <= 0.0 {
            return None;
        }
        let mut dropped = best.all.len() / 2;
        while dropped > 0 {
            let (_, fewer) = self.fitted(&best.without_weakest(dropped), pairs, Free::All);
            if signed_ranks(&self.judged(&fewer, pairs), &by_all) > 0.0 {
                dropped /= 2;
            } else {
                best = fewer;
                dropped = dropped.min(best.all.len() / 2);
            }
        }
        Some(best)
    }

    /// How far the albedos of pairs differ under what the others make of some discs.
    fn judged(&self, discs: &Discs, pairs: &[[usize; 2]]) -> Vec<f64> {
        let judged = [0, 1].map(|half| {
            let (_, discs) = self.fitted(discs, &every_second(pairs, half), Free::All);
            self.contrasts(&self.lit(discs), &every_second(pairs, 1 - half))
        });
        judged.concat()
    }

    /// Radiance of each node, RGB, of discs that are as bright in each channel as its radiance says, which has a mean of 1; in units of
    /// `unit`.
    fn nodes(
        &self,
        discs: &Discs,
        by_channel: &[Vec<f64>; 3],
        pairs: &[[usize; 2]],
        unit: f64,
    ) -> Vec<[f32; 3]> {
        let [red, green, blue] = by_channel.each_ref().map(|radiance| {
            let channel = Fitting { radiance, ..*self };
            channel.fitted(discs, pairs, Free::Flux).1.all
        });
        let mut nodes = vec![[0.0; 3]; self.on.grid.directions.len()];
        for ((red, green), blue) in red.iter().zip(green).zip(blue) {
            let flux = [red.flux, green.flux, blue.flux].map(|flux| (unit * flux) as f32);
            let disc = red.shape.with_flux(flux.into());
            disc.add_to(&mut nodes, self.on.grid);
        }
        nodes
    }

    /// The discs of least differences, from some on, and the mean of these.
    pub fn fitted(&self, start: &Discs, pairs: &[[usize; 2]], free: Free) -> (f64, Discs) {
        let mut now = self.lit(start.clone());
        let mut damping = DAMPING;
        for _ in 0..ROUNDS {
            let equations = Equations::new(self, &now, pairs, free);
            let next = (0..TRIES).find_map(|_| {
                let next = self.stepped(&now, &equations.step(damping)?, free);
                let left = equations.left_under(&self.contrasts(&next, pairs));
                if left < equations.left {
                    damping /= DAMPED;
                    return Some((equations.left - left, next));
                }
                damping *= DAMPED;
                None
            });
            let Some((gain, next)) = next else {
                break;
            };
            now = next;
            let is_stopped = self.on.solver.stop.load(Ordering::Relaxed);
            if gain < SETTLED * pairs.len() as f64 || is_stopped {
                break;
            }
        }
        (mean(&self.contrasts(&now, pairs)), now.discs)
    }

    /// How far the albedos of pairs differ.
    fn contrasts(&self, lit: &Lit, pairs: &[[usize; 2]]) -> Vec<f64> {
        contrasts(pairs, self.radiance, &lit.all)
    }

    /// The same discs as bright as makes the mean irradiance 1.
    fn lit(&self, discs: Discs) -> Lit {
        let by_disc = discs.all.par_iter();
        let by_disc = by_disc.map(|disc| self.irradiance(disc.region, &disc.shape));
        let by_disc = by_disc.collect();
        self.normalised(discs, by_disc)
    }

    fn normalised(&self, discs: Discs, by_disc: Vec<Vec<f64>>) -> Lit {
        let mut all = vec![0.0; self.radiance.len()];
        let flux = discs.all.iter().map(|disc| disc.flux);
        let by_discs = by_disc.iter().zip(flux);
        let beside = self.beside.iter().zip(discs.beside.iter().copied());
        for (by_unit, strength) in by_discs.chain(beside) {
            for (sum, by) in all.iter_mut().zip(by_unit) {
                *sum += strength * by;
            }
        }
        let factor = mean(&all).max(f64::MIN_POSITIVE).recip();
        for irradiance in &mut all {
            *irradiance *= factor;
        }
        Lit {
            discs: discs.times(factor),
            by_disc,
            all,
        }
    }

    /// Irradiance of each point by a disc of unit flux in a region.
    fn irradiance(&self, region: usize, shape: &Ellipse) -> Vec<f64> {
        let region = &self.regions[region];
        region.irradiance(&region.flux(shape, self.on.grid))
    }

    /// Its derivatives by the numbers of its shape.
    fn by_shape(&self, disc: &Disc) -> [Vec<f64>; OF_SHAPE] {
        let (grid, region) = (self.on.grid, &self.regions[disc.region]);
        let difference = DIFFERENCE * grid.spacing();
        [0, 1, 2].map(|number| {
            let [more, less] = [difference, -difference].map(|difference| {
                let mut by = [0.0; OF_SHAPE];
                by[number] = difference;
                region.flux(&self.changed(&disc.shape, by), grid)
            });
            let unit = f64::from(2.0 * difference).recip();
            let between = more.into_iter().zip(less);
            let slopes: Vec<f64> = between.map(|(m, l)| unit * (m - l)).collect();
            region.irradiance(&slopes)
        })
    }

    fn changed(&self, shape: &Ellipse, [x, y, radius]: [f32; OF_SHAPE]) -> Ellipse {
        shape.changed([x, y, radius, 0.0, radius], self.on.grid)
    }

    /// What a step of all numbers leads to.
    fn stepped(&self, from: &Lit, step: &[f64], free: Free) -> Lit {
        let mut discs = from.discs.clone();
        discs.beside.resize(self.beside.len(), 0.0);
        let fluxes = discs.all.iter_mut().map(|disc| &mut disc.flux);
        for (strength, step) in fluxes.chain(&mut discs.beside).zip(step) {
            *strength = (*strength + step).max(0.0);
        }
        if free == Free::Flux {
            return self.normalised(discs, from.by_disc.clone());
        }
        let of_shapes = step[discs.all.len() + discs.beside.len()..].chunks(OF_SHAPE);
        for (disc, step) in discs.all.iter_mut().zip(of_shapes) {
            let step = [0, 1, 2].map(|k| step[k].clamp(-LONGEST, LONGEST) as f32);
            disc.shape = self.changed(&disc.shape, step);
        }
        self.lit(discs)
    }
}

/// Normal equations of one step of all numbers: the fluxes, other light, and the shapes one after the other.
struct Equations {
    gram: Mat<f64>,
    right: Vec<f64>,
    /// Differences that are usual, and what is left of all.
    usual: f64,
    left: f64,
}

impl Equations {
    fn new(fitting: &Fitting<'_>, lit: &Lit, pairs: &[[usize; 2]], free: Free) -> Self {
        let mut columns = lit.by_disc.clone();
        columns.extend_from_slice(fitting.beside);
        if free == Free::All {
            let by_shape = lit.discs.all.par_iter().flat_map_iter(|disc| {
                let by_shape = fitting.by_shape(disc).into_iter();
                by_shape.map(|slopes| {
                    let slopes = slopes.iter();
                    slopes.map(|slope| disc.flux * slope).collect()
                })
            });
            columns.par_extend(by_shape);
        }
        let differences = differences(pairs, fitting.radiance, &lit.all);
        let (usual, weights) = robust_weights(&differences);
        let rows = slopes(&columns, pairs, &lit.all, &weights);
        let right = Mat::from_fn(pairs.len(), 1, |row, _| weights[row] * differences[row]);
        let (mut gram, right) = (rows.transpose() * &rows, rows.transpose() * right);
        let n = columns.len();
        let held = HELD * (0..n).map(|k| gram[(k, k)]).sum::<f64>() / n as f64;
        // Only ratios count: the mean irradiance is held.
        let means: Vec<f64> = columns.iter().map(|column| mean(column)).collect();
        for i in 0..n {
            for j in 0..n {
                gram[(i, j)] += held * means[i] * means[j];
            }
        }
        let mut equations = Self {
            gram,
            right: (0..n).map(|k| right[(k, 0)]).collect(),
            usual,
            left: 0.0,
        };
        equations.left = equations.left_under(&differences);
        equations
    }

    /// What differences leave.
    fn left_under(&self, differences: &[f64]) -> f64 {
        let of = |d: &f64| (1.0 + (d / self.usual).powi(2)).ln();
        differences.iter().map(of).sum()
    }

    /// The damped step.
    fn step(&self, damping: f64) -> Option<Vec<f64>> {
        let mut gram = self.gram.clone();
        let n = self.right.len();
        for k in 0..n {
            gram[(k, k)] = (1.0 + damping) * gram[(k, k)].max(f64::MIN_POSITIVE);
        }
        let right = Mat::from_fn(n, 1, |k, _| self.right[k]);
        let step = gram.llt(Side::Lower).ok()?.solve(&right);
        let step: Vec<f64> = (0..n).map(|k| step[(k, 0)]).collect();
        step.iter().all(|v| v.is_finite()).then_some(step)
    }
}

/// Weighted derivatives of the differences of pairs' albedos by numbers of which these are the points' irradiances.
fn slopes(columns: &[Vec<f64>], pairs: &[[usize; 2]], lit: &[f64], weights: &[f64]) -> Mat<f64> {
    let unit: Vec<f64> = lit.iter().map(|lit| (lit + DARK).recip()).collect();
    Mat::from_fn(pairs.len(), columns.len(), |row, k| {
        let slope = |p: usize| columns[k][p] * unit[p];
        let [p, q] = pairs[row];
        weights[row] * (slope(p) - slope(q))
    })
}
