//! Which parts of the surface are glossier than others?
//!
//! Under lights that one lobe for all has found, each point says how well lobes of other roughness and strength explain its
//! views. A few glosses are sought with which the points together are explained best; each point's part is then decided with
//! its neighbours, of like colour above all, so that places that no highlight reached have the gloss of their surroundings
//! (random walks from points that know to points that don't, after Grady, "Random Walks for Image Segmentation", 2006). A
//! further gloss counts where it explains views that had no say in it better, beyond chance.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::Vec3;
use rayon::prelude::*;

use super::cells::Cell;
use super::design::{Design, Prediction};
use super::fast::Solver;
use super::held_out::CHANCE;
use super::neighbours::{Bonds, Neighbours};
use super::observations::{Observations, Point, Row, Sampling, Seen};
use super::state::State;
use super::weights::{deviation, eliminate, log_diffuse, magnitude, median, shares};
use rekindle_base::math::ranks::{placed_signed_ranks, signed_ranks};
use rekindle_scene::reflectance::{Brdf, Gloss};
use rekindle_scene::surface::{GlossParts, PartPoint};

/// Pixels looked at for points.
const CANDIDATES: usize = 24_000;
/// Roughnesses that are compared, as multiples of the one for all.
const ROUGHNESSES: [f32; 11] = [
    0.315, 0.397, 0.5, 0.63, 0.794, 1.0, 1.26, 1.587, 2.0, 2.52, 3.175,
];
/// Error of a highlight as a part of it, by what is not known of lights and normals.
const HIGHLIGHT_ERROR: f32 = 0.1;
/// Points whose evidence is pooled for candidates of glosses.
const POOLED: usize = 24;
/// Bond from which on it is.
const ALIKE: f32 = 0.3;
/// Parts of the views that are left out in turn.
const FOLDS: usize = 3;
/// Most glosses.
const MOST: usize = 4;
/// Evidence that counts as certain, in units of what is typically left.
const CERTAIN: f64 = 9.0;
/// Strength of a full bond against certain evidence.
const BOND: f32 = 0.25;
/// Pull of the most frequent gloss on places that know nothing.
const PRIOR: f32 = 1e-4;
const SWEEPS: usize = 60;
/// Rounds of parts and glosses in turn.
const ROUNDS: usize = 4;
/// Newton steps of a height with which highlights come to be clipped or don't.
const HEIGHT_STEPS: usize = 8;
/// Gauss-Newton steps of the glosses.
const STEPS: usize = 8;
/// The part of what fewer unknowns leave that more may.
pub const WORTH: f64 = 0.9;
/// Standard deviations from which on a residual counts linearly.
const HUBER: f32 = 1.345;
/// Median of a chi-square of one degree of freedom.
const MEDIAN_SQUARE: f32 = 0.455;
/// Heights of candidates, in quarters of an octave; the least is none.
const LEAST_STEP: f64 = -20.0;
const MOST_STEP: f64 = 20.0;

/// A point's evidence: the squared error that is left is `all − 2 h with + h² of` at the height h of the lobe, for each of
/// [`ROUGHNESSES`], and what the height lacks of clipped highlights.
#[derive(Clone, Debug)]
struct Evidence {
    all: f64,
    with: [f64; ROUGHNESSES.len()],
    of: [f64; ROUGHNESSES.len()],
    bounds: Vec<Bound>,
}

/// A clipped highlight, which says how bright it is at least.
#[derive(Clone, Copy, Debug)]
struct Bound {
    /// How bright, without the diffuse colour.
    at_least: f64,
    /// What a lobe of each roughness shows.
    of: [f32; ROUGHNESSES.len()],
    weight: f64,
}

impl Bound {
    /// What a lobe lacks; zero or less where it shows as much.
    fn lacks(&self, k: usize, height: f64) -> f64 {
        self.at_least - height * f64::from(self.of[k])
    }
}

impl Evidence {
    fn left(&self, k: usize, height: f64) -> f64 {
        let lacking = self.bounds.iter().map(|bound| {
            let lacks = bound.lacks(k, height).max(0.0);
            bound.weight * lacks * lacks
        });
        self.all - 2.0 * height * self.with[k] + height * height * self.of[k] + lacking.sum::<f64>()
    }

    /// The height that leaves least.
    fn best_height(&self, k: usize) -> f64 {
        let mut height = 0.0;
        // Newton's method on a convex function of quadratic pieces.
        for _ in 0..=HEIGHT_STEPS {
            let (mut with, mut of) = (self.with[k], self.of[k]);
            for bound in self.bounds.iter().filter(|b| b.lacks(k, height) > 0.0) {
                let shown = f64::from(bound.of[k]);
                with += bound.weight * shown * bound.at_least;
                of += bound.weight * shown * shown;
            }
            let next = if of > 0.0 { (with / of).max(0.0) } else { 0.0 };
            if next == height || self.bounds.is_empty() {
                return next;
            }
            height = next;
        }
        height
    }

    /// The kind that leaves least.
    fn best_kind(&self) -> Kind {
        let kinds = (0..ROUGHNESSES.len()).map(|roughness| Kind {
            roughness,
            height: self.best_height(roughness),
        });
        kinds
            .min_by(|a, b| a.left(self).total_cmp(&b.left(self)))
            .unwrap_or(NO_GLOSS)
    }

    fn sum<'e>(evidence: impl Iterator<Item = &'e Self>) -> Self {
        evidence.fold(Self::none(), |mut all, one| {
            all.add(one);
            all
        })
    }

    fn add(&mut self, other: &Self) {
        self.all += other.all;
        for k in 0..ROUGHNESSES.len() {
            self.with[k] += other.with[k];
            self.of[k] += other.of[k];
        }
        self.bounds.extend_from_slice(&other.bounds);
    }

    fn none() -> Self {
        Self {
            all: 0.0,
            with: [0.0; ROUGHNESSES.len()],
            of: [0.0; ROUGHNESSES.len()],
            bounds: Vec::new(),
        }
    }
}

/// What points say of their gloss where some views have no say, and what these views say.
struct Fold {
    told: Vec<Evidence>,
    judging: Vec<Evidence>,
}

/// A gloss on the grid of [`ROUGHNESSES`].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Kind {
    roughness: usize,
    height: f64,
}

/// No specular part at all.
const NO_GLOSS: Kind = Kind {
    roughness: 5,
    height: 0.0,
};

/// None, and the lobe as it is.
const GLOSSY_OR_NOT: [Kind; 2] = [
    NO_GLOSS,
    Kind {
        height: 1.0,
        ..NO_GLOSS
    },
];

impl Kind {
    fn left(self, evidence: &Evidence) -> f64 {
        evidence.left(self.roughness, self.height)
    }

    /// The root of what it leaves: what nothing explains counts for no more than it is.
    fn error(self, evidence: &Evidence) -> f64 {
        self.left(evidence).max(0.0).sqrt()
    }

    fn gloss(self) -> Gloss {
        let roughness = ROUGHNESSES[self.roughness];
        Gloss::new(roughness, self.height as f32 * roughness * roughness)
    }
}

/// Points with their evidence, and who lies beside whom.
struct Board<'a> {
    observations: &'a Observations,
    evidence: Vec<Evidence>,
    /// Each view is left out in one of them.
    folds: Vec<Fold>,
    /// Logarithm of each point's diffuse radiance.
    colours: Vec<Vec3>,
    bonds: Bonds,
    /// Difference of colours that weakens bonds.
    contrast: f32,
    /// Squared error per degree of freedom that the best lobe of a point leaves, typically.
    unit: f64,
}

/// Lights seen from points of the surface, in gray.
struct Lit<'a> {
    design: Design<'a>,
    /// Radiance of each of the design's cells.
    radiance: Vec<[f32; 3]>,
    /// The main lobe.
    brdf: Brdf,
    /// One over each row's variance.
    weights: Vec<f32>,
}

impl Solver<'_> {
    /// The parts of the surface whose gloss differs under the lights of a state, if there are any, and the gloss of the part that
    /// is to be the main one, which the parts' are multiples of. A further gloss has to explain views that had no say in it better by more than
    /// some standard deviations of chance: the first of `beyond` that finds any. Where light is sought on few parts that show it, those that
    /// show none are told by nothing else.
    pub fn gloss_parts(
        &self,
        state: &State<'_>,
        beyond: impl IntoIterator<Item = f64>,
    ) -> Option<(GlossParts, Gloss)> {
        self.on_board(state, |board, lit| {
            let of_chance = |chance: f64| {
                let kinds = board.kinds_beyond(chance, self.stop);
                board.parted(lit, &kinds)
            };
            let found = beyond.into_iter().find_map(of_chance);
            let is_focused = self.near_to.is_some_and(|near| near.is_focused);
            match found {
                None if is_focused => board.parted(lit, &GLOSSY_OR_NOT),
                found => found,
            }
        })
    }

    /// The same in two glosses that explain the points best, whatever views that had no say say of them.
    pub fn two_glosses(&self, state: &State<'_>) -> Option<(GlossParts, Gloss)> {
        self.on_board(state, |board, lit| {
            let kinds = board.kinds(|fewer, _| fewer.len() < 2, self.stop);
            board.parted(lit, &kinds)
        })
    }

    /// The parts of the surface that show the lobe of a state under its lights, and those that show none, with the gloss of the former.
    pub fn glossy_parts(&self, state: &State<'_>) -> Option<(GlossParts, Gloss)> {
        self.on_board(state, |board, lit| board.parted(lit, &GLOSSY_OR_NOT))
    }

    /// Something done with what points say of their gloss under the lights of a state.
    fn on_board<R>(&self, state: &State<'_>, then: impl FnOnce(&Board<'_>, &Lit<'_>) -> R) -> R {
        let observations = Observations::gather(
            &Seen {
                parts: None,
                ..self.seen
            },
            &Sampling {
                candidates: CANDIDATES,
                limit: usize::MAX,
                keep: &|_, _, _| true,
                scale: Some(self.coarse.scale),
                stop: self.stop,
            },
        );
        let gray = observations.to_gray();
        let lit = state.lit();
        let cells: Vec<Cell> = lit.iter().map(|&k| state.cells[k]).collect();
        let model = state.brdf.model;
        let widest = Brdf::new(model, ROUGHNESSES[ROUGHNESSES.len() - 1] * state.brdf.sigma);
        let radiance = lit.iter().map(|&k| state.radiance[k]);
        let lit = Lit {
            design: self.shadowed_design(&gray, &cells, &widest),
            radiance: radiance.map(|l| [l.iter().sum::<f32>() / 3.0; 3]).collect(),
            brdf: state.brdf,
            weights: weights(&gray, state.residuals.noise),
        };
        let board = Board::new(&observations, &lit);
        then(&board, &lit)
    }

    /// The same solver where the surface has parts.
    pub fn parted<'b>(&'b self, parts: &'b GlossParts) -> Solver<'b> {
        Solver {
            seen: Seen {
                parts: Some(parts),
                ..self.seen
            },
            coarse: self.coarse.of_parts(parts),
            coarse_sees: self.coarse_sees.clone(),
            ..*self
        }
    }
}

/// Sums of a Gauss-Newton step of one gloss: of the products of the two derivatives, by the logarithms of roughness and of
/// strength, with each other and with what is left.
#[derive(Clone, Copy, Default)]
struct Step {
    wider_wider: f64,
    wider_stronger: f64,
    stronger_stronger: f64,
    wider_left: f64,
    stronger_left: f64,
}

impl Step {
    fn add(&mut self, weight: f32, [left, wider, stronger]: [f32; 3]) {
        let [w, left, wider, stronger] = [weight, left, wider, stronger].map(f64::from);
        self.wider_wider += w * wider * wider;
        self.wider_stronger += w * wider * stronger;
        self.stronger_stronger += w * stronger * stronger;
        self.wider_left += w * wider * left;
        self.stronger_left += w * stronger * left;
    }

    /// The gloss after the step; the same where the rows say nothing of it.
    fn taken(self, gloss: Gloss) -> Gloss {
        let products = self.wider_wider * self.stronger_stronger;
        let determinant = products - self.wider_stronger * self.wider_stronger;
        if gloss.strength <= 0.0 || determinant <= 1e-9 * products {
            return gloss;
        }
        let by = |own: f64, own_left: f64, other_left: f64| {
            (own * own_left - self.wider_stronger * other_left) / determinant
        };
        let wider = by(self.stronger_stronger, self.wider_left, self.stronger_left);
        let stronger = by(self.wider_wider, self.stronger_left, self.wider_left);
        Gloss {
            roughness: (gloss.roughness * wider.clamp(-0.3, 0.3).exp() as f32).clamp(0.1, 10.0),
            strength: gloss.strength * stronger.clamp(-0.5, 0.5).exp() as f32,
            ..gloss
        }
    }
}

/// The kinds' glosses off the grid of [`ROUGHNESSES`], by robust Gauss-Newton steps over the points inside each one's part.
fn refined(lit: &Lit<'_>, parts: &[usize], inside: &[bool], kinds: &[Kind]) -> Vec<Gloss> {
    let mut own = lit.design.observations.clone();
    for (point, &part) in own.points.iter_mut().zip(parts) {
        point.gloss = part;
    }
    own.glosses = kinds.iter().map(|kind| kind.gloss()).collect();
    let mut robust = lit.measured_weights();
    for _ in 0..STEPS {
        let design = Design {
            observations: &own,
            ..lit.design.clone()
        };
        let Prediction { value, by_sigma } = design.predict(&lit.brdf, &lit.radiance);
        let mut steps = vec![Step::default(); kinds.len()];
        let of_use = own.points.iter().zip(inside);
        for (point, _) in of_use.filter(|(_, is_inside)| **is_inside) {
            let rows = point.rows.clone();
            // At a fixed strength a wider lobe is lower.
            let column = |k: usize| {
                let wider = lit.brdf.sigma * by_sigma[k][0] - 2.0 * value[k][0];
                [own.rows[k].radiance[0] - value[k][0], wider, value[k][0]]
            };
            let mut columns: Vec<[f32; 3]> = rows.clone().map(column).collect();
            let brdf = lit.brdf.at(own.glosses[point.gloss]);
            let own_rows = &own.rows[rows.clone()];
            eliminate(&brdf, own_rows, &robust[rows.clone()], &mut columns);
            for (k, column) in rows.zip(columns) {
                steps[point.gloss].add(robust[k], column);
                let is_met = own.rows[k].is_bound && column[0] <= 0.0;
                let deviations = lit.weights[k].sqrt() * column[0].abs();
                robust[k] = if is_met {
                    0.0
                } else {
                    lit.weights[k] * (HUBER / deviations.max(HUBER))
                };
            }
        }
        for (gloss, step) in own.glosses.iter_mut().zip(steps) {
            *gloss = step.taken(*gloss);
        }
    }
    own.glosses
}

/// One value a row, and what each row shows of its point's diffuse colour beside it.
struct Column {
    values: Vec<f32>,
    transmittance: Vec<f32>,
}

impl Column {
    /// Gray values beside a lobe.
    fn new(rows: &[Row], brdf: &Brdf, values: &[[f32; 3]]) -> Self {
        Self {
            values: values.iter().map(|value| value[0]).collect(),
            transmittance: rows.par_iter().map(|row| row.diffuse_share(brdf)).collect(),
        }
    }

    /// The values of a point's rows without the diffuse colour that some weights say.
    fn eliminated(&self, own: Range<usize>, weights: &[f32]) -> Vec<f32> {
        let shares = shares(&self.transmittance[own.clone()], weights);
        let values = &self.values[own];
        let mean: f32 = (shares.iter().zip(values))
            .map(|((into, _), v)| into * v)
            .sum();
        (shares.iter().zip(values))
            .map(|((_, t), v)| v - t * mean)
            .collect()
    }
}

impl Lit<'_> {
    /// The rows' weights; none of bounds, which say nothing as long as nothing contradicts them.
    fn measured_weights(&self) -> Vec<f32> {
        let rows = self.design.observations.rows.iter().zip(&self.weights);
        rows.map(|(row, &weight)| if row.is_bound { 0.0 } else { weight })
            .collect()
    }

    /// What is measured, and what lobes of [`ROUGHNESSES`] show.
    fn columns(&self) -> (Column, [Column; ROUGHNESSES.len()]) {
        let rows = &self.design.observations.rows;
        let measured: Vec<[f32; 3]> = rows.iter().map(|row| row.radiance).collect();
        let shown = ROUGHNESSES.map(|roughness| {
            let brdf = Brdf::new(self.brdf.model, roughness * self.brdf.sigma);
            let shown = self.design.predict_values(&brdf, &self.radiance);
            Column::new(rows, &brdf, &shown)
        });
        (Column::new(rows, &self.brdf, &measured), shown)
    }

    /// What the views of a point that are told say of its gloss, and what the others do, its diffuse colour being what the former say.
    fn evidence(
        &self,
        point: &Point,
        (measured, shown): &(Column, [Column; ROUGHNESSES.len()]),
        is_told: impl Fn(usize) -> bool,
    ) -> [Evidence; 2] {
        let own = point.rows.clone();
        let rows = &self.design.observations.rows[own.clone()];
        let weights = &self.weights[own.clone()];
        let telling: Vec<f32> = (rows.iter().zip(weights))
            .map(|(row, &weight)| {
                if is_told(row.view) && !row.is_bound {
                    weight
                } else {
                    0.0
                }
            })
            .collect();
        let mut evidence = [Evidence::none(), Evidence::none()];
        if telling.iter().all(|&weight| weight == 0.0) {
            return evidence;
        }
        let measured = measured.eliminated(own.clone(), &telling);
        let shown = shown
            .each_ref()
            .map(|shown| shown.eliminated(own.clone(), &telling));
        for (i, (row, &weight)) in rows.iter().zip(weights).enumerate() {
            let of = &mut evidence[usize::from(!is_told(row.view))];
            let (weight, value) = (f64::from(weight), f64::from(measured[i]));
            if row.is_bound {
                of.bounds.push(Bound {
                    at_least: value,
                    of: shown.each_ref().map(|shown| shown[i]),
                    weight,
                });
                continue;
            }
            of.all += weight * value * value;
            for (at, shown) in shown.iter().enumerate() {
                let shown = f64::from(shown[i]);
                of.with[at] += weight * shown * value;
                of.of[at] += weight * shown * shown;
            }
        }
        evidence
    }
}

impl<'a> Board<'a> {
    fn new(observations: &'a Observations, lit: &Lit<'_>) -> Self {
        let rows = &lit.design.observations.rows;
        let views = rows.iter().map(|row| row.view + 1).max().unwrap_or(0);
        let turns = views.min(FOLDS);
        let columns = lit.columns();
        let fold = |turn: usize| -> Fold {
            let points = observations.points.par_iter();
            let is_told = |view: usize| view % turns != turn;
            let of_point = |point| lit.evidence(point, &columns, is_told).into();
            let (told, judging) = points.map(of_point).unzip();
            Fold { told, judging }
        };
        // In a turn that leaves none out, all are told.
        let Fold { told: evidence, .. } = fold(turns);
        let folds = (0..turns).map(fold).collect();
        let shown = lit.design.predict_values(&lit.brdf, &lit.radiance);
        let colours = log_diffuse(observations, &lit.brdf, &lit.measured_weights(), &shown);
        let (bonds, contrast) = Neighbours::of(&observations.points).bonds(&colours);
        let left = |(point, evidence): (&Point, &Evidence)| {
            let left = evidence.best_kind().left(evidence);
            (left / (point.rows.len() - 1).max(1) as f64) as f32
        };
        let mut left: Vec<f32> = observations
            .points
            .iter()
            .zip(&evidence)
            .map(left)
            .collect();
        Self {
            observations,
            evidence,
            folds,
            colours,
            bonds,
            contrast,
            unit: f64::from(median(&mut left) / MEDIAN_SQUARE).max(f64::MIN_POSITIVE),
        }
    }

    /// The parts of some kinds, where there are several, and the gloss of the main one.
    fn parted(&self, lit: &Lit<'_>, kinds: &[Kind]) -> Option<(GlossParts, Gloss)> {
        if kinds.len() < 2 {
            return None;
        }
        let parts = self.walk(kinds, &self.evidence);
        let inside = self.bonds.inside(&parts, |&(near, _)| near);
        let glosses = refined(lit, &parts, &inside, kinds);
        // The one that explains most.
        let explained = |k: usize| -> f64 {
            let own = self.evidence.iter().zip(&parts);
            let own = own.filter(|(_, part)| **part == k);
            own.map(|(e, _)| NO_GLOSS.left(e) - kinds[k].left(e)).sum()
        };
        let main = (0..glosses.len())
            .filter(|&k| glosses[k].strength > 0.0)
            .max_by(|&a, &b| explained(a).total_cmp(&explained(b)))?;
        let main = glosses[main];
        let points = self
            .observations
            .points
            .iter()
            .zip(&self.colours)
            .zip(&parts);
        let points = points.map(|((point, &colour), &gloss)| PartPoint {
            position: point.position,
            colour,
            gloss,
        });
        let glosses = glosses.into_iter().map(|gloss| gloss.beside(main));
        let scale = self.observations.scale;
        let parts = GlossParts::new(glosses.collect(), self.contrast, scale, points.collect());
        Some((parts, main))
    }

    /// The glosses that explain the points, the one for all first: more as long as these are `better`.
    fn kinds(
        &self,
        mut better: impl FnMut(&[Kind], &[Kind]) -> bool,
        stop: &AtomicBool,
    ) -> Vec<Kind> {
        let pooled = self.pooled(&self.evidence);
        let all: Vec<usize> = (0..self.evidence.len()).collect();
        let mut kinds = vec![self.kind_of(&all)];
        let candidates = pooled.iter().map(Evidence::best_kind);
        let candidates = quantised(candidates.chain([NO_GLOSS]));
        // What the points around each say where some views are left out, and what these say of it.
        let folds = self.folds.iter();
        let votes = folds.flat_map(|fold| self.pooled(&fold.told).into_iter().zip(&fold.judging));
        let votes: Vec<(Evidence, &Evidence)> = votes.collect();
        while kinds.len() < MOST && !stop.load(Ordering::Relaxed) {
            let before = votes.iter().map(|(vote, judging)| {
                let best = preferred(&kinds, vote);
                (best.left(vote), best.error(judging))
            });
            let before: Vec<(f64, f64)> = before.collect();
            // How much less a candidate leaves where the points around are for it.
            let gain = |candidate: &Kind| -> f64 {
                (votes.iter().zip(&before))
                    .filter(|((vote, _), (left, _))| candidate.left(vote) < *left)
                    .map(|((_, judging), (_, error))| error - candidate.error(judging))
                    .sum()
            };
            let gains: Vec<f64> = candidates.par_iter().map(gain).collect();
            let best = (0..gains.len()).max_by(|&a, &b| gains[a].total_cmp(&gains[b]));
            let Some(best) = best else { break };
            let mut more = kinds.clone();
            more.push(candidates[best]);
            for _ in 0..ROUNDS {
                let before = more.clone();
                let parts = self.walk(&more, &self.evidence);
                for (k, kind) in more.iter_mut().enumerate() {
                    let own: Vec<usize> = (0..parts.len()).filter(|&i| parts[i] == k).collect();
                    *kind = self.kind_of(&own);
                }
                if more == before {
                    break;
                }
            }
            if !better(&kinds, &more) {
                break;
            }
            kinds = more;
        }
        kinds
    }

    fn place(&self, point: usize) -> Vec3 {
        self.observations.points[point].position
    }

    /// The kind that leaves least of some points; none where the one that some views say does not explain the others better, beyond
    /// chance.
    fn kind_of(&self, points: &[usize]) -> Kind {
        let best =
            |evidence: &[Evidence]| Evidence::sum(points.iter().map(|&i| &evidence[i])).best_kind();
        let mut pairs: Vec<(Vec3, f64, f64)> =
            points.iter().map(|&i| (self.place(i), 0.0, 0.0)).collect();
        for fold in &self.folds {
            let told = best(&fold.told);
            for (&i, (_, without, with)) in points.iter().zip(&mut pairs) {
                *without += NO_GLOSS.error(&fold.judging[i]);
                *with += told.error(&fold.judging[i]);
            }
        }
        if placed_signed_ranks(&pairs) > CHANCE {
            best(&self.evidence)
        } else {
            NO_GLOSS
        }
    }

    /// Whether more kinds explain views that had no say in the parts better, by more than `chance`, by what each leaves there: what is
    /// wrong with a highlight in one view, such as a shadow's edge or what the surface mirrors of itself, is no gloss, and others don't
    /// show it. The views are compared in turn, and, where few places show a highlight, parts of space that hold as much of what is left.
    fn is_better(&self, chance: f64, fewer: &[f64], more: &[f64]) -> bool {
        // Twice the negative logarithm of a Cauchy likelihood: a part that is told wrongly is off by a thousand deviations where its
        // highlight would be, and must not outweigh all others.
        let unlikely = |errors: &[f64]| -> f64 {
            let squares = errors.iter().map(|error| error * error / self.unit);
            squares.map(f64::ln_1p).sum()
        };
        if unlikely(more) >= unlikely(fewer) {
            return false;
        }
        let points = (0..self.evidence.len()).map(|i| self.place(i)).cycle();
        let pairs = points.zip(fewer).zip(more);
        let pairs: Vec<_> = pairs
            .map(|((at, fewer), more)| (at, *fewer, *more))
            .collect();
        signed_ranks(fewer, more).max(placed_signed_ranks(&pairs)) > chance
    }

    /// What kinds leave of views that had no say in the parts, fold by fold and point by point.
    fn errors(&self, kinds: &[Kind]) -> Vec<f64> {
        let of_fold = |fold: &Fold| -> Vec<f64> {
            let parts = self.walk(kinds, &fold.told).into_iter();
            let errors = parts.zip(&fold.judging);
            errors
                .map(|(part, judging)| kinds[part].error(judging))
                .collect()
        };
        self.folds.par_iter().flat_map(of_fold).collect()
    }

    /// The kinds of which each further one is better beyond `chance`; see [`Board::is_better`].
    fn kinds_beyond(&self, chance: f64, stop: &AtomicBool) -> Vec<Kind> {
        let mut known: Option<Vec<f64>> = None;
        let is_better = |fewer: &[Kind], more: &[Kind]| {
            let left = known.take().unwrap_or_else(|| self.errors(fewer));
            let left_by_more = self.errors(more);
            let is_better = self.is_better(chance, &left, &left_by_more);
            known = Some(left_by_more);
            is_better
        };
        self.kinds(is_better, stop)
    }

    /// Some evidence of each point with that of the points around it, of like colour.
    fn pooled(&self, evidence: &[Evidence]) -> Vec<Evidence> {
        let pooled = |i: usize| {
            let mut all = evidence[i].clone();
            let mut taken = BTreeSet::from([i as u32]);
            for &(near, bond) in &self.bonds[i] {
                let further = self.bonds[near as usize].iter();
                for &(k, next) in std::iter::once(&(near, 1.0)).chain(further) {
                    if bond * next > ALIKE && taken.len() < POOLED && taken.insert(k) {
                        all.add(&evidence[k as usize]);
                    }
                }
            }
            all
        };
        (0..evidence.len()).into_par_iter().map(pooled).collect()
    }

    /// The part of each point by what all say, of at most [`MOST`] kinds.
    fn walk(&self, kinds: &[Kind], evidence: &[Evidence]) -> Vec<usize> {
        let n = kinds.len();
        if n == 1 {
            return vec![0; self.evidence.len()];
        }
        let told = evidence.iter().map(|own| self.verdict(kinds, own));
        let told: Vec<(usize, f32)> = told.collect();
        let mut share = [0.0_f32; MOST];
        for &(kind, certain) in &told {
            share[kind] += certain;
        }
        let total = share.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        let share = share.map(|share| share / total);
        // A point is likely what it says itself and, so much, what its neighbours are.
        let of_point = |i: usize| {
            let (kind, certain) = told[i];
            let mut own = share.map(|share| PRIOR * share);
            own[kind] += certain;
            let bonds: f32 = self.bonds[i].iter().map(|(_, bond)| bond).sum();
            let weight = certain + PRIOR + BOND * bonds;
            (own.map(|own| own / weight), BOND / weight)
        };
        let of_points: Vec<([f32; MOST], f32)> = (0..told.len()).map(of_point).collect();
        let mut likely = vec![share; told.len()];
        let mut asked = |i: usize| {
            let mut around = [0.0; MOST];
            for &(near, bond) in &self.bonds[i] {
                for (around, other) in around.iter_mut().zip(likely[near as usize]) {
                    *around += bond * other;
                }
            }
            let (own, part) = &of_points[i];
            likely[i] = std::array::from_fn(|k| own[k] + part * around[k]);
        };
        for sweep in 0..SWEEPS {
            // Forth and back, so that what is known travels far either way.
            if sweep % 2 == 0 {
                (0..told.len()).for_each(&mut asked);
            } else {
                (0..told.len()).rev().for_each(&mut asked);
            }
        }
        let most_likely =
            |p: &[f32; MOST]| (0..n).max_by(|&a, &b| p[a].total_cmp(&p[b])).unwrap_or(0);
        likely.iter().map(most_likely).collect()
    }

    /// The kind that some evidence is for, and how certain that is, from 0 to 1.
    fn verdict(&self, kinds: &[Kind], evidence: &Evidence) -> (usize, f32) {
        let (mut best, mut least, mut second) = (0, f64::INFINITY, f64::INFINITY);
        for (k, kind) in kinds.iter().enumerate() {
            let left = kind.left(evidence);
            if left < least {
                (best, second, least) = (k, least, left);
            } else {
                second = second.min(left);
            }
        }
        let apart = (second - least) / (CERTAIN * self.unit);
        (best, apart.min(1.0) as f32)
    }
}

/// The one of some kinds that leaves least.
fn preferred(kinds: &[Kind], evidence: &Evidence) -> Kind {
    let less = |a: &&Kind, b: &&Kind| a.left(evidence).total_cmp(&b.left(evidence));
    kinds.iter().min_by(less).copied().unwrap_or(NO_GLOSS)
}

/// Some kinds with heights of four values to an octave, each once.
fn quantised(kinds: impl Iterator<Item = Kind>) -> Vec<Kind> {
    let steps = kinds.map(|kind| {
        let step = (4.0 * kind.height.max(f64::MIN_POSITIVE).log2()).round();
        (kind.roughness, step.clamp(LEAST_STEP, MOST_STEP) as i32)
    });
    let distinct: BTreeSet<(usize, i32)> = steps.collect();
    let kind = |(roughness, step): (usize, i32)| Kind {
        roughness,
        height: if f64::from(step) > LEAST_STEP {
            (f64::from(step) / 4.0).exp2()
        } else {
            0.0
        },
    };
    distinct.into_iter().map(kind).collect()
}

/// One over each row's variance: noise, image detail and what is not known of highlights, which are what a row has above the
/// darkest of its point under equal irradiance.
fn weights(observations: &Observations, noise: f32) -> Vec<f32> {
    let mut weights = vec![0.0; observations.rows.len()];
    for point in &observations.points {
        let rows = &observations.rows[point.rows.clone()];
        let brightness = rows.iter().map(|row| magnitude(row.radiance));
        let albedos = brightness
            .clone()
            .zip(rows)
            .map(|(bright, row)| bright / row.irradiance);
        let least = albedos.fold(f32::INFINITY, f32::min);
        let weights = weights[point.rows.clone()].iter_mut();
        for ((weight, row), bright) in weights.zip(rows).zip(brightness) {
            let error = HIGHLIGHT_ERROR * (bright - least * row.irradiance);
            let deviation = deviation(noise.max(1e-7), row.detail).hypot(error);
            *weight = deviation.powi(-2);
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use rekindle_base::math::ranks::SURE;

    /// Points along a side of the surface, and rows of each.
    const SIDE: usize = 60;
    const ROWS: usize = 6;

    /// Noise from -1 to 1, the same for the same number.
    fn noise(seed: usize) -> f64 {
        let hash = (seed as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let hash = (hash ^ (hash >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let high = f64::from((hash >> 32) as u32) / f64::from(u32::MAX);
        high.mul_add(2.0, -1.0)
    }

    /// What a lobe of height 1 shows in a row: few rows show a highlight, and a wider lobe shows some of it in others.
    fn shown(row: usize, roughness: usize) -> f64 {
        let away = 8.0 * noise(7 * row + 1).abs();
        let width = f64::from(ROUGHNESSES[roughness]);
        (-0.5 * (away / width).powi(2)).exp()
    }

    /// A plane of points whose left half has one height of the lobe and whose right half another, with noise.
    fn observations() -> Observations {
        let at = |i: usize| Vec3::new((i % SIDE) as f32, (i / SIDE) as f32, 0.0);
        let point = |i: usize| Point {
            position: at(i),
            normal: Vec3::Z,
            on: (0, Vec2::ZERO),
            pixel: (0, i as u32, 0),
            gloss: 0,
            rows: ROWS * i..ROWS * (i + 1),
        };
        Observations {
            glosses: vec![Gloss::MAIN],
            points: (0..SIDE * SIDE).map(point).collect(),
            rows: Vec::new(),
            scale: 1.0,
            gray: true,
        }
    }

    fn is_left(i: usize) -> bool {
        i % SIDE < SIDE / 2
    }

    fn board(observations: &Observations, [left, right]: [f64; 2], deviation: f64) -> Board<'_> {
        let evidence = |i: usize, is_told: &dyn Fn(usize) -> bool| -> [Evidence; 2] {
            let mut evidence = [Evidence::none(), Evidence::none()];
            for k in 0..ROWS {
                let row = ROWS * i + k;
                let height = if is_left(i) { left } else { right };
                let measured = height * shown(row, 5) + deviation * 1.7 * noise(row + 999_983);
                let of = &mut evidence[usize::from(!is_told(k))];
                of.all += measured * measured;
                for roughness in 0..ROUGHNESSES.len() {
                    let own = shown(row, roughness);
                    of.with[roughness] += own * measured;
                    of.of[roughness] += own * own;
                }
            }
            evidence
        };
        let all = 0..observations.points.len();
        let fold = |turn: usize| {
            let of = |i| evidence(i, &|k| k % FOLDS != turn).into();
            let (told, judging) = all.clone().map(of).unzip();
            Fold { told, judging }
        };
        let colours = vec![Vec3::ZERO; all.len()];
        let (bonds, _) = Neighbours::of(&observations.points).bonds(&colours);
        Board {
            observations,
            evidence: all
                .clone()
                .map(|i| evidence(i, &|_| true)[0].clone())
                .collect(),
            folds: (0..FOLDS).map(fold).collect(),
            colours,
            bonds,
            contrast: 1.0,
            unit: deviation * deviation,
        }
    }

    fn kinds(board: &Board<'_>) -> Vec<Kind> {
        board.kinds_beyond(3.0, &AtomicBool::new(false))
    }

    #[test]
    fn a_height_reaches_what_is_clipped_and_no_further() {
        let mut evidence = Evidence::none();
        (evidence.all, evidence.with[5], evidence.of[5]) = (4.0, 2.0, 1.0);
        let bound = |at_least| Bound {
            at_least,
            of: [1.0; ROUGHNESSES.len()],
            weight: 1.0,
        };
        // What is shown is 2; a highlight that is 1.5 at least changes nothing, one that is 3 lies half-way.
        evidence.bounds = vec![bound(1.5)];
        assert_eq!(evidence.best_height(5), 2.0);
        assert_eq!(evidence.left(5, 2.0), 0.0);
        evidence.bounds.push(bound(3.0));
        assert_eq!(evidence.best_height(5), 2.5);
        assert_eq!(evidence.left(5, 2.5), 0.5);
        assert_eq!(NO_GLOSS.left(&evidence), 4.0 + 1.5 * 1.5 + 9.0);
    }

    #[test]
    fn gloss_on_one_half_is_found_however_little_noise_there_is() {
        let observations = observations();
        for deviation in [0.1, 1e-4] {
            let board = board(&observations, [0.0, 1.0], deviation);
            let found = kinds(&board);
            let mut heights: Vec<f64> = found.iter().map(|kind| kind.height).collect();
            heights.sort_by(f64::total_cmp);
            assert_eq!(heights.len(), 2, "{found:?}");
            assert_eq!(heights[0], 0.0, "{found:?}");
            assert!((heights[1] - 1.0).abs() < 0.05, "{found:?}");
            let parts = board.walk(&found, &board.evidence);
            let is_right = |&i: &usize| is_left(i) == (found[parts[i]].height == 0.0);
            let right = (0..parts.len()).filter(is_right).count();
            assert!(right as f64 > 0.97 * parts.len() as f64, "{right}");
        }
    }

    #[test]
    fn two_glosses_are_told_apart_where_noise_is_most_of_what_is_left_and_one_is_not_made_two() {
        let observations = observations();
        let two = board(&observations, [1.0, 0.5], 0.4);
        let left = |kinds: &[Kind]| -> f64 {
            let parts = two.walk(kinds, &two.evidence);
            let left = parts.iter().zip(&two.evidence);
            left.map(|(&part, evidence)| kinds[part].left(evidence))
                .sum()
        };
        let found = kinds(&two);
        assert_eq!(found.len(), 2, "{found:?}");
        let one = [Evidence::sum(two.evidence.iter()).best_kind()];
        assert!(left(&found) > 0.9 * left(&one), "too easy");
        let one = kinds(&board(&observations, [0.8, 0.8], 0.4));
        assert_eq!(one.len(), 1, "{one:?}");
        let none = kinds(&board(&observations, [0.0, 0.0], 0.4));
        assert_eq!(none.len(), 1, "{none:?}");
    }

    #[test]
    fn a_part_that_is_told_wrongly_does_not_outweigh_all_others() {
        let observations = observations();
        let board = board(&observations, [0.0, 1.0], 1.0);
        let all = FOLDS * observations.points.len();
        // A row of points in one fold, off by a thousand deviations.
        let is_told_wrongly = |k: usize| k / SIDE == 8;
        let fewer: Vec<f64> = (0..all).map(|k| 6.0 + noise(k)).collect();
        let better = |k: usize| {
            if is_told_wrongly(k) {
                1000.0
            } else {
                2.0 + noise(k)
            }
        };
        let worse = |k: usize| {
            if is_told_wrongly(k) {
                0.0
            } else {
                7.0 + noise(k)
            }
        };
        assert!(board.is_better(SURE, &fewer, &(0..all).map(better).collect::<Vec<_>>()));
        assert!(!board.is_better(SURE, &fewer, &(0..all).map(worse).collect::<Vec<_>>()));
    }
}
