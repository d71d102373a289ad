//! Do parts of the surface reflect in different colours?
//!
//! What a dielectric reflects has the colour of the light, what a metal reflects its own as well. Where one surface has both, the
//! parts that reflect least are taken for dielectrics, which tell the colour of the light, and stronger ones have the colour that
//! they reflect beside these. Lights that were found as if all parts reflected alike have the parts' colours where these alone mirror
//! them: so what each part shows of each light is looked at in gray, channel by channel. A colour counts where it explains views that had
//! no say in it better than one for both parts, beyond chance.

use glam::Vec3;

use super::fast::Solver;
use super::held_out::CHANCE;
use super::neighbours::Neighbours;
use super::observations::{Observations, Point};
use super::state::State;
use super::weights::eliminate_all;
use rekindle_base::math::ranks::placed_signed_ranks;
use rekindle_scene::reflectance::Gloss;
use rekindle_scene::surface::GlossParts;

/// Parts of the views that are left out in turn.
const FOLDS: usize = 3;
/// Steps in which strengths and a colour for all are fitted in turn.
const STEPS: usize = 20;
/// Most lights that are told apart; others belong to the nearest of them.
const LIGHTS: usize = 6;
/// The cosine between two of them, at most.
const APART: f32 = 0.94;
/// A point tells of the light that makes up this part of what it shows of all.
const MOSTLY: f64 = 0.8;

impl Solver<'_> {
    /// The solver's parts with the colours of what they reflect, if these differ under the lights of a state, and the gloss of the part
    /// that has the lights' colour, which is to be the main one.
    pub fn tinted_parts(&self, state: &State<'_>) -> Option<(GlossParts, Gloss)> {
        let parts = self.seen.parts?;
        let is_metal = !state.brdf.model.is_dielectric();
        let (glosses, white) = Shown::of(state).tinted(&parts.glosses, is_metal)?;
        Some((parts.with(glosses).beside(white), white))
    }
}

/// What rows measure and what each light shows in them, without their points' diffuse colours.
struct Shown<'a> {
    observations: &'a Observations,
    measured: Vec<[f32; 3]>,
    /// Of each light, gray.
    predicted: Vec<Vec<f32>>,
    /// None for bounds.
    weights: Vec<f32>,
    /// Which points lie inside their parts.
    inside: Vec<bool>,
}

/// How much more than predicted a part reflects of a light in each channel: the median of what its points say, as some points lie beyond
/// borders, where much more is reflected.
#[derive(Clone, Copy, Default)]
struct Told {
    scale: [f64; 3],
    /// Σ w p².
    weight: f64,
}

/// How much more than predicted each of two parts reflects of a light where both have one colour.
fn of_one_colour(parts: [Told; 2]) -> [[f64; 3]; 2] {
    let mut colour = [1.0; 3];
    let mut strength = [1.0; 2];
    let ratio = |above: f64, below: f64| (above / below.max(f64::MIN_POSITIVE)).max(0.0);
    for _ in 0..STEPS {
        strength = parts.map(|part| {
            let with = (0..3).map(|c| part.scale[c] * colour[c]).sum();
            ratio(with, colour.iter().map(|c| c * c).sum())
        });
        colour = [0, 1, 2].map(|c| {
            let weighted = || {
                parts
                    .iter()
                    .zip(strength)
                    .map(|(p, s)| (p, p.weight * s, s))
            };
            let with = weighted().map(|(part, weight, _)| weight * part.scale[c]);
            ratio(
                with.sum(),
                weighted().map(|(_, weight, s)| weight * s).sum(),
            )
        });
    }
    strength.map(|s| colour.map(|c| s * c))
}

/// Which of the brightest lights each cell of a state belongs to, and their number.
fn lights(state: &State<'_>) -> (Vec<usize>, usize) {
    let geometry = &state.design.geometry;
    let flux = |k: usize| geometry.solid_angles[k] * state.radiance[k].iter().sum::<f32>();
    let mut lit = state.lit();
    lit.sort_by(|&a, &b| flux(b).total_cmp(&flux(a)));
    let mut middles: Vec<Vec3> = Vec::with_capacity(LIGHTS);
    for direction in lit.iter().map(|&k| geometry.directions[k]) {
        let is_apart = middles.iter().all(|m| m.dot(direction) < APART);
        if is_apart && middles.len() < LIGHTS {
            middles.push(direction);
        }
    }
    let nearest = |direction: &Vec3| {
        let near = |&m: &usize| middles[m].dot(*direction);
        let places = 0..middles.len();
        places
            .max_by(|a, b| near(a).total_cmp(&near(b)))
            .unwrap_or(0)
    };
    let of_cells = geometry.directions.iter().map(nearest);
    (of_cells.collect(), middles.len())
}

impl<'a> Shown<'a> {
    fn of(state: &'a State<'_>) -> Self {
        let observations = state.design.observations;
        let eliminated = |mut values: Vec<[f32; 3]>| {
            eliminate_all(observations, &state.brdf, &state.weights, &mut values);
            values
        };
        let rows = observations.rows.iter();
        let weights = (rows.clone().zip(&state.weights))
            .map(|(row, &weight)| if row.is_bound { 0.0 } else { weight });
        let (own, count) = lights(state);
        let by_light = |light: usize| -> Vec<f32> {
            let cells = state.radiance.iter().zip(&own);
            let gray = cells.map(|(radiance, &own)| {
                let is_of = if own == light { 1.0 } else { 0.0 };
                [is_of * radiance.iter().sum::<f32>() / 3.0; 3]
            });
            let shown = state
                .design
                .predict_values(&state.brdf, &gray.collect::<Vec<_>>());
            eliminated(shown)
                .into_iter()
                .map(|value| value[0])
                .collect()
        };
        let points = &observations.points;
        let parts: Vec<usize> = points.iter().map(|point| point.gloss).collect();
        Self {
            measured: eliminated(rows.map(|row| row.radiance).collect()),
            predicted: (0..count).map(by_light).collect(),
            weights: weights.collect(),
            inside: Neighbours::of(points).inside(&parts, |&near| near),
            observations,
        }
    }

    /// The points inside parts.
    fn points(&self) -> impl Iterator<Item = &Point> {
        let points = self.observations.points.iter().zip(&self.inside);
        points
            .filter(|(_, is_inside)| **is_inside)
            .map(|(point, _)| point)
    }

    /// What views that are told say of each part under each light.
    fn told(&self, is_told: impl Fn(usize) -> bool) -> Vec<Vec<Told>> {
        let Observations { glosses, rows, .. } = self.observations;
        let lights = self.predicted.len();
        // Of each part and light, ratios in each channel and weights of its points.
        let mut said = vec![vec![Vec::new(); lights]; glosses.len()];
        for point in self.points() {
            let told = || point.rows.clone().filter(|&k| is_told(rows[k].view));
            let weight = |k: usize| f64::from(self.weights[k]);
            let of = |predicted: &Vec<f32>| -> f64 {
                told()
                    .map(|k| weight(k) * f64::from(predicted[k]).powi(2))
                    .sum()
            };
            let shown: Vec<f64> = self.predicted.iter().map(of).collect();
            let most = MOSTLY * shown.iter().sum::<f64>();
            let mostly = shown.iter().position(|&own| own > most && own > 0.0);
            if let Some(light) = mostly {
                let ratio = |c: usize| {
                    let products = told().map(|k| {
                        let product = self.measured[k][c] * self.predicted[light][k];
                        weight(k) * f64::from(product)
                    });
                    products.sum::<f64>() / shown[light]
                };
                said[point.gloss][light].push(([0, 1, 2].map(ratio), shown[light]));
            }
        }
        let of_light = |said: Vec<([f64; 3], f64)>| {
            let channel = |c: usize| said.iter().map(move |(ratio, weight)| (ratio[c], *weight));
            Told {
                scale: [0, 1, 2].map(|c| weighted_median(channel(c).collect()).max(0.0)),
                weight: said.iter().map(|(_, weight)| weight).sum(),
            }
        };
        let of_part = |lights: Vec<_>| lights.into_iter().map(of_light).collect();
        said.into_iter().map(of_part).collect()
    }

    /// The roots of what the points of two parts leave in some views where so much more than predicted is reflected of each light.
    fn errors(
        &self,
        pair: [usize; 2],
        scales: &[[[f64; 3]; 2]],
        is_judging: impl Fn(usize) -> bool,
    ) -> Vec<(Vec3, f64)> {
        let rows = &self.observations.rows;
        let of_pair = self.points().filter_map(|point| {
            let part = pair.iter().position(|&gloss| gloss == point.gloss)?;
            let judging = point.rows.clone().filter(|&k| is_judging(rows[k].view));
            let left = judging.map(|k| {
                let lights = || scales.iter().zip(&self.predicted);
                let left = (0..3).map(|c| {
                    let shown = lights().map(|(scale, p)| scale[part][c] * f64::from(p[k]));
                    (f64::from(self.measured[k][c]) - shown.sum::<f64>()).powi(2)
                });
                f64::from(self.weights[k]) * left.sum::<f64>()
            });
            Some((point.position, left.sum::<f64>().sqrt()))
        });
        of_pair.collect()
    }

    /// What views say of each part under each light where some are left out in turn.
    fn folds(&self) -> Vec<Vec<Vec<Told>>> {
        let views = self.observations.rows.iter().map(|row| row.view + 1).max();
        let turns = views.unwrap_or(0).min(FOLDS);
        let without = |turn: usize| self.told(|view| view % turns != turn);
        (0..turns).map(without).collect()
    }

    /// How much more clearly than by chance a colour for each of two parts explains views that had no say in it better than one for both.
    fn differ(&self, pair: [usize; 2], folds: &[Vec<Vec<Told>>]) -> f64 {
        let mut pairs = Vec::new();
        for (turn, told) in folds.iter().enumerate() {
            let is_judging = |view: usize| view % folds.len() == turn;
            let lights = 0..self.predicted.len();
            let own = lights.map(|light| pair.map(|part| told[part][light]));
            let own: Vec<[Told; 2]> = own.collect();
            let one: Vec<_> = own.iter().map(|&parts| of_one_colour(parts)).collect();
            let each: Vec<_> = own.iter().map(|parts| parts.map(|p| p.scale)).collect();
            let one = self.errors(pair, &one, is_judging);
            let each = self.errors(pair, &each, is_judging);
            let both = one.into_iter().zip(each);
            pairs.extend(both.map(|((at, one), (_, each))| (at, one, each)));
        }
        placed_signed_ranks(&pairs)
    }

    /// The glosses with the colours of what stronger parts reflect beside the weakest that one differs from, and that.
    fn tinted(&self, glosses: &[Gloss], is_metal: bool) -> Option<(Vec<Gloss>, Gloss)> {
        let told = self.told(|_| true);
        let folds = self.folds();
        let mut order: Vec<usize> = (0..glosses.len())
            .filter(|&k| glosses[k].strength > 0.0)
            .collect();
        order.sort_by(|&a, &b| glosses[a].strength.total_cmp(&glosses[b].strength));
        for (at, &white) in order.iter().enumerate() {
            let differing = order[at + 1..].iter().copied();
            let differing: Vec<usize> = differing
                .filter(|&part| self.differ([white, part], &folds) > CHANCE)
                .collect();
            if differing.is_empty() {
                continue;
            }
            let mut tinted = glosses.to_vec();
            for part in differing {
                // No metal reflects less of any channel than a dielectric does.
                let least = if is_metal {
                    Vec3::ZERO
                } else {
                    glosses[white].scale()
                };
                let scale = glosses[part].scale() * beside(&told[part], &told[white]);
                tinted[part] = glosses[part].reflecting(scale.max(least));
            }
            return Some((tinted, glosses[white]));
        }
        None
    }
}

/// What a part reflects of each channel over what another one does, the geometric mean over lights that both mirror.
fn beside(part: &[Told], white: &[Told]) -> Vec3 {
    let (mut sum, mut weights) = ([0.0; 3], 0.0);
    for (part, white) in part.iter().zip(white) {
        let seen = part
            .scale
            .iter()
            .chain(&white.scale)
            .all(|&scale| scale > 0.0);
        if seen {
            // One over the variance of the ratio's logarithm.
            let weight = (part.weight.recip() + white.weight.recip()).recip();
            weights += weight;
            for (c, sum) in sum.iter_mut().enumerate() {
                *sum += weight * (part.scale[c] / white.scale[c]).ln();
            }
        }
    }
    if weights <= 0.0 {
        return Vec3::ONE;
    }
    Vec3::from(sum.map(|sum| (sum / weights).exp() as f32))
}

/// The value that half of the weight lies below.
fn weighted_median(mut values: Vec<(f64, f64)>) -> f64 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut before = 0.0;
    let middle = values.iter().find(|(_, weight)| {
        before += weight;
        before >= half
    });
    middle.map_or(0.0, |(value, _)| *value)
}
