//! Where is gloss, before any light is known?
//!
//! Felt beside varnish: most points that a light should shine on show nothing, and one lobe for all then finds no light at
//! all. So, on the coarsest cells, each point has a strength of its own for the lobe, and lights and strengths take turns
//! (alternating least squares). A point's strength is what its neighbours of like colour say, not its own rows: none is
//! fitted to what it is judged by.

use glam::Vec3;
use rayon::prelude::*;

use super::cells::Cell;
use super::design::Design;
use super::fast::{Solver, Watch};
use super::gloss::WORTH;
use super::highlights;
use super::neighbours::Neighbours;
use super::observations::{Observations, Point};
use super::observer::{Stopped, go_on};
use super::state::{ROUGH, State};
use super::visibility::SeenCells;
use super::weights::{eliminate, log_diffuse};
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};
use rekindle_scene::surface::{GlossParts, PartPoint};

/// Points that have a strength: patches are told apart that are a few times as wide as the distance between them.
const POINTS: usize = 8000;
/// Roughnesses that are tried, radians. The first decides whether there is anything to be found.
pub const SIGMAS: [f32; 3] = [0.08, 0.13, 0.05];
/// A roughness that is tried where few points show gloss: lights are sought on finer cells there.
const NARROW: f32 = 0.03;
/// What is reported.
const WHAT: &str = "looking for patches of gloss";
/// Turns of strengths, after lights of one strength for all. One brings most of what there is to be had.
const TURNS: usize = 2;
/// Part of a point's strength that stays in a turn.
const KEPT: f64 = 0.5;
/// Strengths are steps of one over this, …
const STEPS: usize = 8;
/// … and at most so many.
const MOST_STEPS: usize = 16;
/// Part of the points that are stronger than 1, which only scales the lights.
const STRONGER: f64 = 0.2;
/// Rows that say that the strength is 1, as a part of the rows of a point.
const PRIOR: f64 = 0.05;

/// Strengths of points at one roughness, with the lights that go with them.
struct Strengths {
    brdf: Brdf,
    /// One per point.
    of_points: Vec<f64>,
    /// Radiance of each of the coarsest cells.
    radiance: Vec<[f32; 3]>,
    /// One per row.
    weights: Vec<f32>,
    /// See [`State::unexplained`].
    unexplained: f64,
}

/// What strengths are sought on.
struct Search<'a> {
    solver: &'a Solver<'a>,
    /// The coarsest cells, and what the points see of them.
    cells: Vec<Cell>,
    seen: SeenCells,
    colours: &'a Observations,
    gray: &'a Observations,
    neighbours: Neighbours,
}

impl Solver<'_> {
    /// The surface's parts by the strength of their gloss, whatever parts it has, if these explain the views clearly better than one for
    /// all.
    pub fn strengths(&self, watch: &mut Watch<'_>) -> Result<Option<GlossParts>, Stopped> {
        self.search(|search| {
            let mut best = Vec::new();
            for sigma in SIGMAS {
                go_on(watch.observer.progress(WHAT, 0.3))?;
                let plain = search.plain(Brdf::new(SpecularModel::Paper, sigma));
                let found = search.turned(&plain, 0.0);
                if best.is_empty() && found.unexplained > WORTH * plain.unexplained {
                    return Ok(None);
                }
                best.push(search.settled(found));
            }
            Ok(least(best).map(|found| search.parts(&found)))
        })
    }

    /// The same with the roughness that goes with them, radians, from lights that explain the points which show a highlight: the others may
    /// be most of those that mirror a light, and have no gloss.
    pub fn strengths_by_highlights(
        &self,
        watch: &mut Watch<'_>,
    ) -> Result<Option<(GlossParts, f32)>, Stopped> {
        let Some(near) = self.near_to else {
            return Ok(None);
        };
        self.search(|search| {
            let shown = highlights::shown(search.gray, &near);
            let glossy: Vec<f64> = shown.into_iter().map(|s| f64::from(u8::from(s))).collect();
            let mut tried = Vec::new();
            for sigma in SIGMAS.into_iter().chain([NARROW]) {
                go_on(watch.observer.progress(WHAT, 0.3))?;
                let brdf = Brdf::new(SpecularModel::Paper, sigma);
                let start = search.lit(brdf, glossy.clone(), search.dark());
                tried.push(search.settled(search.turned(&start, 0.0)));
            }
            let Some(best) = least(tried) else {
                return Ok(None);
            };
            let is_worth = best.unexplained < WORTH * search.plain(best.brdf).unexplained;
            Ok(is_worth.then(|| (search.parts(&best), best.brdf.sigma)))
        })
    }

    /// Something done with points whose strengths are sought.
    fn search<R>(&self, then: impl FnOnce(&Search<'_>) -> R) -> R {
        let colours = self.colours(POINTS).without_parts();
        let gray = colours.to_gray();
        then(&Search {
            solver: self,
            seen: self.roots_design(&gray, self.near).seen,
            cells: self.roots(),
            colours: &colours,
            gray: &gray,
            neighbours: Neighbours::of(&gray.points),
        })
    }
}

/// The strengths that leave least.
fn least(tried: Vec<Strengths>) -> Option<Strengths> {
    let tried = tried.into_iter();
    tried.min_by(|a, b| a.unexplained.total_cmp(&b.unexplained))
}

impl Search<'_> {
    /// One strength for all.
    fn plain(&self, brdf: Brdf) -> Strengths {
        let strengths = vec![1.0; self.gray.points.len()];
        self.lit(brdf, strengths, self.dark())
    }

    /// No lights.
    fn dark(&self) -> Vec<[f32; 3]> {
        vec![[0.0; 3]; self.cells.len()]
    }

    /// Strengths after the turns that follow the first.
    fn settled(&self, mut found: Strengths) -> Strengths {
        for _ in 1..TURNS {
            found = self.turned(&found, KEPT);
        }
        found
    }

    /// Lights of these strengths, sought from those at hand.
    fn lit(&self, brdf: Brdf, strengths: Vec<f64>, start: Vec<[f32; 3]>) -> Strengths {
        let points = self.points(&strengths);
        let design = self.design(&points);
        let mut state = State::new(design, self.cells.clone(), brdf);
        state.radiance = start;
        state.solve_lights(ROUGH);
        state.reweight();
        state.solve_lights(ROUGH);
        Strengths {
            brdf,
            unexplained: state.unexplained(),
            radiance: state.radiance,
            weights: state.weights,
            of_points: strengths,
        }
    }

    /// The points, whatever their gloss, under the cells that they see.
    fn design<'d>(&'d self, points: &'d Observations) -> Design<'d> {
        Design {
            seen: self.seen.clone(),
            ..self.solver.design(points, &self.cells)
        }
    }

    /// The points with the gloss of their strengths.
    fn points(&self, strengths: &[f64]) -> Observations {
        let mut points = self.gray.clone();
        points.glosses = (0..=MOST_STEPS).map(gloss).collect();
        for (point, strength) in points.points.iter_mut().zip(strengths) {
            point.gloss = step(*strength);
        }
        points
    }

    /// The strengths that some lights say, of which a part `kept` stays as it is, and the lights of these.
    fn turned(&self, before: &Strengths, kept: f64) -> Strengths {
        let around = self.around(before).into_iter().zip(&before.of_points);
        let strengths: Vec<f64> = around
            .map(|(said, before)| kept * before + (1.0 - kept) * said)
            .collect();
        let unit = upper(&strengths);
        let mut start = before.radiance.clone();
        for value in start.as_flattened_mut() {
            *value *= unit as f32;
        }
        let strengths = strengths.into_iter().map(|s| s / unit).collect();
        self.lit(before.brdf, strengths, start)
    }

    /// The strength that the neighbours of each point say.
    fn around(&self, before: &Strengths) -> Vec<f64> {
        let shown = self.shown(before);
        let own = self.said(before, &shown);
        let (bonds, _) = self.neighbours.bonds(&self.diffuse(before, shown));
        let typical = own.iter().map(|(_, of)| of).sum::<f64>() / own.len().max(1) as f64;
        let around = |i: usize| {
            let (mut with, mut of) = (PRIOR * typical, PRIOR * typical);
            for &(near, bond) in &bonds[i] {
                let further = &bonds[near as usize];
                for &(k, next) in std::iter::once(&(near, 1.0)).chain(further) {
                    if k as usize != i {
                        let weight = f64::from(bond * next);
                        with += weight * own[k as usize].0;
                        of += weight * own[k as usize].1;
                    }
                }
            }
            (with / of.max(f64::MIN_POSITIVE)).max(0.0)
        };
        (0..own.len()).into_par_iter().map(around).collect()
    }

    /// Specular radiance of every row where all points have the strength 1.
    fn shown(&self, of: &Strengths) -> Vec<[f32; 3]> {
        let design = self.design(self.gray);
        design.predict_values(&of.brdf, &of.radiance)
    }

    /// Of each point's rows the product of what they show with what they should show at the strength 1, and the square of
    /// that, its diffuse colour taken out of both: their quotient is its strength.
    fn said(&self, before: &Strengths, shown: &[[f32; 3]]) -> Vec<(f64, f64)> {
        let rows = &self.gray.rows;
        let of = |point: &Point| {
            let own = point.rows.clone();
            let weights = &before.weights[own.clone()];
            let mut shown = shown[own.clone()].to_vec();
            let mut measured: Vec<_> = rows[own.clone()].iter().map(|r| r.radiance).collect();
            for values in [&mut shown, &mut measured] {
                eliminate(&before.brdf, &rows[own.clone()], weights, values);
            }
            let product = |a: &[[f32; 3]], b: &[[f32; 3]]| -> f64 {
                let terms = weights.iter().zip(a).zip(b);
                terms.map(|((w, a), b)| f64::from(w * a[0] * b[0])).sum()
            };
            (product(&shown, &measured), product(&shown, &shown))
        };
        self.gray.points.iter().map(of).collect()
    }

    /// Logarithm of each point's diffuse radiance, where `shown` is its specular radiance at the strength 1.
    fn diffuse(&self, of: &Strengths, mut shown: Vec<[f32; 3]>) -> Vec<Vec3> {
        for (point, &strength) in self.gray.points.iter().zip(&of.of_points) {
            for value in shown[point.rows.clone()].as_flattened_mut() {
                *value *= strength as f32;
            }
        }
        log_diffuse(self.colours, &of.brdf, &of.weights, &shown)
    }

    /// The surface with these strengths.
    fn parts(&self, found: &Strengths) -> GlossParts {
        let diffuse = self.diffuse(found, self.shown(found));
        let (_, contrast) = self.neighbours.bonds(&diffuse);
        let points = self.points(&found.of_points);
        let placed = points.points.iter().zip(diffuse);
        let placed = placed.map(|(point, colour)| PartPoint {
            position: point.position,
            colour,
            gloss: point.gloss,
        });
        GlossParts::new(points.glosses, contrast, points.scale, placed.collect())
    }
}

/// The step nearest to a strength.
fn step(strength: f64) -> usize {
    ((strength * STEPS as f64).round() as usize).min(MOST_STEPS)
}

/// The gloss of a step.
fn gloss(step: usize) -> Gloss {
    Gloss::new(1.0, step as f32 / STEPS as f32)
}

/// The strength that is to be called 1.
fn upper(strengths: &[f64]) -> f64 {
    let mut sorted = strengths.to_vec();
    let at = ((1.0 - STRONGER) * sorted.len() as f64) as usize;
    if at >= sorted.len() {
        return 1.0;
    }
    let (_, upper, _) = sorted.select_nth_unstable_by(at, f64::total_cmp);
    upper.max(1e-6)
}
