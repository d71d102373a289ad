//! Do parts of the surface reflect in different colours?
//!
//! What a dielectric reflects has the colour of the light, what a metal reflects its own as well. Where one surface has both, the
//! parts that reflect least are taken for dielectrics, which tell the colour of the light, and stronger ones have the colour that
//! they reflect beside these. It counts where it explains views that had no say in it better than one colour for both, beyond chance.

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

/// What rows measure and what the lights show in them, without their points' diffuse colours.
struct Shown<'a> {
    observations: &'a Observations,
    measured: Vec<[f32; 3]>,
    predicted: Vec<[f32; 3]>,
    /// None for bounds.
    weights: Vec<f32>,
    /// Which points lie inside their parts.
    inside: Vec<bool>,
}

/// How much more than predicted a part reflects in each channel: the median of what its points say, as some points lie beyond
/// borders, where much more is reflected.
#[derive(Clone, Copy, Default)]
struct Told {
    scale: [f64; 3],
    /// Σ w p².
    weight: [f64; 3],
}

/// How much more than predicted each of two parts reflects where both have one colour.
fn of_one_colour(parts: [Told; 2]) -> [[f64; 3]; 2] {
    let mut colour = [1.0; 3];
    let mut strength = [1.0; 2];
    let ratio = |above: f64, below: f64| (above / below.max(f64::MIN_POSITIVE)).max(0.0);
    for _ in 0..STEPS {
        strength = parts.map(|part| {
            let weighted = |c: usize| part.weight[c] * colour[c];
            let with = (0..3).map(|c| weighted(c) * part.scale[c]).sum();
            ratio(with, (0..3).map(|c| weighted(c) * colour[c]).sum())
        });
        colour = [0, 1, 2].map(|c| {
            let weighted = || {
                parts
                    .iter()
                    .zip(strength)
                    .map(|(p, s)| (p, p.weight[c] * s, s))
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

impl<'a> Shown<'a> {
    fn of(state: &'a State<'_>) -> Self {
        let observations = state.design.observations;
        let rows = 0..observations.rows.len();
        let mut predicted: Vec<[f32; 3]> = rows.map(|k| state.specular(k)).collect();
        eliminate_all(observations, &state.brdf, &state.weights, &mut predicted);
        let left = state.residuals.values.iter().zip(&predicted);
        let measured = left.map(|(&left, &shown)| (Vec3::from(left) + Vec3::from(shown)).into());
        let weights = (observations.rows.iter().zip(&state.weights))
            .map(|(row, &weight)| if row.is_bound { 0.0 } else { weight });
        let points = &observations.points;
        let parts: Vec<usize> = points.iter().map(|point| point.gloss).collect();
        Self {
            inside: Neighbours::of(points).inside(&parts),
            measured: measured.collect(),
            weights: weights.collect(),
            predicted,
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

    /// What views that are told say of each part.
    fn told(&self, is_told: impl Fn(usize) -> bool) -> Vec<Told> {
        let Observations { glosses, rows, .. } = self.observations;
        // Of each part and channel, ratios and weights of its points.
        let mut said = vec![[const { Vec::new() }; 3]; glosses.len()];
        for point in self.points() {
            for (c, said) in said[point.gloss].iter_mut().enumerate() {
                let (mut with, mut of) = (0.0, 0.0);
                for k in point.rows.clone().filter(|&k| is_told(rows[k].view)) {
                    let [w, p, m] =
                        [self.weights[k], self.predicted[k][c], self.measured[k][c]].map(f64::from);
                    with += w * m * p;
                    of += w * p * p;
                }
                if of > 0.0 {
                    said.push((with / of, of));
                }
            }
        }
        let of_part = |mut part: [Vec<(f64, f64)>; 3]| Told {
            weight: [0, 1, 2].map(|c| part[c].iter().map(|(_, weight)| weight).sum()),
            scale: [0, 1, 2].map(|c| weighted_median(&mut part[c]).max(0.0)),
        };
        said.into_iter().map(of_part).collect()
    }

    /// The roots of what the points of two parts leave in some views where so much more than predicted is reflected.
    fn errors(
        &self,
        pair: [usize; 2],
        scales: [[f64; 3]; 2],
        is_judging: impl Fn(usize) -> bool,
    ) -> Vec<(Vec3, f64)> {
        let rows = &self.observations.rows;
        let of_pair = self.points().filter_map(|point| {
            let part = pair.iter().position(|&gloss| gloss == point.gloss)?;
            let judging = point.rows.clone().filter(|&k| is_judging(rows[k].view));
            let left = judging.map(|k| {
                let left = (0..3).map(|c| {
                    let shown = scales[part][c] * f64::from(self.predicted[k][c]);
                    (f64::from(self.measured[k][c]) - shown).powi(2)
                });
                f64::from(self.weights[k]) * left.sum::<f64>()
            });
            Some((point.position, left.sum::<f64>().sqrt()))
        });
        of_pair.collect()
    }

    /// How much more clearly than by chance a colour for each of two parts explains views that had no say in it better than one for both.
    fn differ(&self, pair: [usize; 2]) -> f64 {
        let views = self.observations.rows.iter().map(|row| row.view + 1).max();
        let turns = views.unwrap_or(0).min(FOLDS);
        let mut pairs = Vec::new();
        for turn in 0..turns {
            let is_judging = |view: usize| view % turns == turn;
            let told = self.told(|view| !is_judging(view));
            let own = pair.map(|part| told[part]);
            let one = self.errors(pair, of_one_colour(own), is_judging);
            let each = self.errors(pair, own.map(|part| part.scale), is_judging);
            let both = one.into_iter().zip(each);
            pairs.extend(both.map(|((at, one), (_, each))| (at, one, each)));
        }
        placed_signed_ranks(&pairs)
    }

    /// The glosses with the colours of what stronger parts reflect beside the weakest that one differs from, and that.
    fn tinted(&self, glosses: &[Gloss], is_metal: bool) -> Option<(Vec<Gloss>, Gloss)> {
        let told = self.told(|_| true);
        let mut order: Vec<usize> = (0..glosses.len())
            .filter(|&k| glosses[k].strength > 0.0)
            .collect();
        order.sort_by(|&a, &b| glosses[a].strength.total_cmp(&glosses[b].strength));
        for (at, &white) in order.iter().enumerate() {
            let differing = order[at + 1..].iter().copied();
            let differing: Vec<usize> = differing
                .filter(|&part| self.differ([white, part]) > CHANCE)
                .collect();
            if differing.is_empty() {
                continue;
            }
            let reference = Vec3::from(told[white].scale.map(|s| s as f32));
            let mut tinted = glosses.to_vec();
            for part in differing {
                let beside = Vec3::from(told[part].scale.map(|s| s as f32)) / reference;
                // No metal reflects less of any channel than a dielectric does.
                let least = if is_metal {
                    Vec3::ZERO
                } else {
                    glosses[white].scale()
                };
                let scale = (glosses[part].scale() * beside).max(least);
                tinted[part] = glosses[part].reflecting(scale);
            }
            return Some((tinted, glosses[white]));
        }
        None
    }
}

/// The value that half of the weight lies below.
fn weighted_median(values: &mut [(f64, f64)]) -> f64 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut before = 0.0;
    let middle = values.iter().find(|(_, weight)| {
        before += weight;
        before >= half
    });
    middle.map_or(0.0, |(value, _)| *value)
}
