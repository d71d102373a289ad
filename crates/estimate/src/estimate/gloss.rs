//! Which parts of the surface are glossier than others?
//!
//! Under lights that one lobe for all has found, each point says how well lobes of other roughness and strength explain its
//! views. A few glosses are sought with which the points together are explained best; each point's part is then decided with
//! its neighbours, of like colour above all, so that places that no highlight reached have the gloss of their surroundings
//! (random walks from points that know to points that don't, after Grady, "Random Walks for Image Segmentation", 2006). A
//! further gloss counts where points that had no say in it are explained better by it, beyond chance.

use glam::Vec3;
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::cells::Cell;
use super::design::{Design, Prediction};
use super::fast::Solver;
use super::observations::{Observations, Sampling, Seen};
use super::observer::Stopped;
use super::state::State;
use super::suspects::signed_ranks;
use super::weights::{deviation, eliminate, magnitude};
use rekindle_base::math::morton;
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
/// Points that a point is joined to.
const NEIGHBOURS: usize = 8;
/// Points whose evidence is pooled for candidates of glosses.
const POOLED: usize = 24;
/// Most glosses.
const MOST: usize = 4;

/// A point's evidence: the squared error that is left is `all − 2 h with + h² of` at the height h of the lobe, for each of
/// [`ROUGHNESSES`].
#[derive(Clone, Debug)]
struct Evidence {
    all: f64,
    with: [f64; ROUGHNESSES.len()],
    of: [f64; ROUGHNESSES.len()],
}

impl Evidence {
    fn left(&self, k: usize, height: f64) -> f64 {
        self.all - 2.0 * height * self.with[k] + height * height * self.of[k]
    }

    fn add(&mut self, other: &Self) {
        self.all += other.all;
        for k in 0..ROUGHNESSES.len() {
            self.with[k] += other.with[k];
            self.of[k] += other.of[k];
        }
    }

    fn none() -> Self {
        Self {
            all: 0.0,
            with: [0.0; ROUGHNESSES.len()],
            of: [0.0; ROUGHNESSES.len()],
        }
    }
}

/// A gloss on the grid of [`ROUGHNESSES`].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Kind {
    roughness: usize,
    height: f64,
}

impl Kind {
    fn left(self, evidence: &Evidence) -> f64 {
        evidence.left(self.roughness, self.height)
    }

    fn gloss(self) -> Gloss {
        let roughness = ROUGHNESSES[self.roughness];
        Gloss {
            roughness,
            strength: self.height as f32 * roughness * roughness,
        }
    }
}

/// Points with their evidence, and who lies beside whom.
struct Board<'a> {
    observations: &'a Observations,
    evidence: Vec<Evidence>,
    /// Logarithm of each point's diffuse radiance.
    colours: Vec<Vec3>,
    /// Each point's neighbours with the strength of their bond, from 0 to 1.
    bonds: Vec<Vec<(u32, f32)>>,
    contrast: f32,
    /// Squared error per degree of freedom that the best lobe of a point leaves, typically.
    unit: f64,
}

/// Evidence that counts as certain, in units of what is typically left.
const CERTAIN: f64 = 9.0;
/// Strength of a full bond against certain evidence.
const BOND: f32 = 0.25;
/// Pull of the most frequent gloss on places that know nothing.
const PRIOR: f32 = 1e-4;
const SWEEPS: usize = 60;
/// Rounds of parts and glosses in turn.
const ROUNDS: usize = 4;
/// Standard deviations of chance by which a further gloss has to win.
const SURE: f64 = 3.0;

impl Solver<'_> {
    /// The parts of the surface whose gloss differs under the lights of a state, if there are any.
    pub fn gloss_parts(&self, state: &State<'_>) -> Result<Option<(GlossParts, Gloss)>, Stopped> {
        let t0 = std::time::Instant::now();
        let seen = Seen {
            parts: None,
            ..self.seen
        };
        let observations = Observations::gather(
            &seen,
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
        let radiance: Vec<[f32; 3]> = (lit.iter().map(|&k| state.radiance[k]))
            .map(|l| [l.iter().sum::<f32>() / 3.0; 3])
            .collect();
        let widest = ROUGHNESSES[ROUGHNESSES.len() - 1] * state.brdf.sigma;
        let widest = Brdf::new(state.brdf.model, widest);
        let design = self.shadowed_design(&gray, &cells, &widest);
        let board = Board::new(&observations, &design, state, &radiance);
        let kinds = board.kinds();
        if kinds.len() < 2 {
            return Ok(None);
        }
        let parts = board.walk(&kinds, |_| true);
        let glosses = refined(&gray, &parts, &kinds, &design, state, &radiance);
        eprintln!("glosses {glosses:?} {:?}", t0.elapsed());
        let points = (observations.points.iter().zip(&board.colours).zip(&parts))
            .map(|((point, &colour), &gloss)| PartPoint { position: point.position, colour, gloss });
        let mut counts = vec![0; glosses.len()];
        for &part in &parts { counts[part] += 1; }
        let main = (0..glosses.len()).filter(|&k| glosses[k].strength > 0.0).max_by_key(|&k| counts[k]).unwrap_or(0);
        let main = glosses[main];
        let glosses = glosses.into_iter().map(|gloss| Gloss { roughness: gloss.roughness / main.roughness, strength: gloss.strength / main.strength }).collect();
        Ok(Some((GlossParts::new(glosses, board.contrast, points.collect()), main)))
    }

    /// The same solver where the surface has parts.
    pub fn parted<'b>(&'b self, parts: &'b GlossParts) -> Solver<'b> {
        Solver {
            seen: Seen { parts: Some(parts), ..self.seen },
            coarse: self.coarse.clone(),
            ..*self
        }
    }
}

/// The kinds' glosses off the grid of [`ROUGHNESSES`], by Gauss-Newton steps over each one's points, as multiples of the state's
/// main lobe.
fn refined(gray: &Observations, parts: &[usize], kinds: &[Kind], design: &Design<'_>, state: &State<'_>, radiance: &[[f32; 3]]) -> Vec<Gloss> {
    const STEPS: usize = 8;
    let mut own = gray.clone();
    for (point, &part) in own.points.iter_mut().zip(parts) { point.gloss = part; }
    own.glosses = kinds.iter().map(|kind| kind.gloss()).collect();
    let sigma = f64::from(state.brdf.sigma);
    let first = weights(gray, state.residuals.noise);
    let mut huber = first.clone();
    for _ in 0..STEPS {
        let design = Design { observations: &own, ..design.clone() };
        let Prediction { value, by_sigma } = design.predict(&state.brdf, radiance);
        let mut sums = vec![[0.0_f64; 5]; kinds.len()];
        for point in &own.points {
            let gloss = own.glosses[point.gloss];
            let (rows, w) = (point.rows.clone(), &huber[point.rows.clone()].to_vec());
            let cosines = || rows.clone().map(|k| own.rows[k].cos_view);
            let brdf = state.brdf.at(gloss);
            let left = rows.clone().map(|k| own.rows[k].radiance[0] - value[k][0]);
            let wider = rows.clone().map(|k| (sigma as f32) * by_sigma[k][0] - 2.0 * value[k][0]);
            let mut columns: Vec<[f32; 3]> = left.zip(wider).zip(rows.clone()).map(|((l, b), k)| [l, b, value[k][0]]).collect();
            eliminate(&brdf, cosines(), w, &mut columns);
            let sum = &mut sums[point.gloss];
            for ((c, w), k) in columns.iter().zip(w).zip(rows.clone()) {
                let [r, b, v] = c.map(f64::from);
                let w = f64::from(*w);
                sum[0] += w * b * b; sum[1] += w * b * v; sum[2] += w * v * v; sum[3] += w * b * r; sum[4] += w * v * r;
                let t = (f64::from(first[k]).sqrt() * r).abs() / 1.345;
                huber[k] = first[k] * (if t > 1.0 { 1.0 / t } else { 1.0 }) as f32;
            }
        }
        for (gloss, [bb, bv, vv, br, vr]) in own.glosses.iter_mut().zip(sums) {
            let determinant = bb * vv - bv * bv;
            if gloss.strength <= 0.0 || determinant <= 1e-9 * bb * vv { continue; }
            let wider = ((vv * br - bv * vr) / determinant).clamp(-0.3, 0.3);
            let stronger = ((bb * vr - bv * br) / determinant).clamp(-0.5, 0.5);
            gloss.roughness = (gloss.roughness * wider.exp() as f32).clamp(0.1, 10.0);
            gloss.strength *= stronger.exp() as f32;
        }
    }
    own.glosses
}

impl<'a> Board<'a> {
    fn new(
        observations: &'a Observations,
        design: &Design<'_>,
        state: &State<'_>,
        radiance: &[[f32; 3]],
    ) -> Self {
        let weights = weights(design.observations, state.residuals.noise);
        let rows = &design.observations.rows;
        let cosines = |k: usize| rows[k].cos_view;
        let eliminated = |mut values: Vec<[f32; 3]>, brdf: &Brdf| {
            for point in &observations.points {
                let own = point.rows.clone();
                let cosines = own.clone().map(cosines);
                eliminate(brdf, cosines, &weights[own.clone()], &mut values[own]);
            }
            values
        };
        let measured = eliminated(rows.iter().map(|r| r.radiance).collect(), &state.brdf);
        let mut evidence = vec![Evidence::none(); observations.points.len()];
        for (point, evidence) in observations.points.iter().zip(&mut evidence) {
            for k in point.rows.clone() {
                evidence.all += f64::from(weights[k] * measured[k][0] * measured[k][0]);
            }
        }
        let mut colours = Vec::new();
        for (k, roughness) in ROUGHNESSES.into_iter().enumerate() {
            let brdf = Brdf::new(state.brdf.model, roughness * state.brdf.sigma);
            let shown = design.predict_values(&brdf, radiance);
            if roughness == 1.0 {
                colours = log_colours(observations, &weights, &shown, &brdf);
            }
            let shown = eliminated(shown, &brdf);
            for (point, evidence) in observations.points.iter().zip(&mut evidence) {
                for row in point.rows.clone() {
                    let (w, a) = (f64::from(weights[row]), f64::from(shown[row][0]));
                    evidence.with[k] += w * a * f64::from(measured[row][0]);
                    evidence.of[k] += w * a * a;
                }
            }
        }
        let (bonds, contrast) = bonds(observations, &colours);
        let mut least: Vec<f64> = (observations.points.iter().zip(&evidence))
            .filter(|(_, e)| e.all > 0.0)
            .map(|(point, e)| {
                let left = (0..ROUGHNESSES.len()).map(|k| e.left(k, best_height(e, k)));
                left.fold(e.all, f64::min) / (point.rows.len() - 1).max(1) as f64
            })
            .collect();
        least.sort_by(f64::total_cmp);
        // The median of a chi-square of one degree of freedom is 0.455.
        let unit = least.get(least.len() / 2).map_or(1.0, |m| m / 0.455);
        Self {
            observations,
            evidence,
            colours,
            bonds,
            contrast,
            unit: unit.max(f64::MIN_POSITIVE),
        }
    }

    /// The glosses that explain the points, the most frequent first.
    fn kinds(&self) -> Vec<Kind> {
        let pooled = self.pooled();
        let mut kinds = vec![best_kind(&sum(pooled.iter()))];
        let mut parts = vec![0; self.evidence.len()];
        let mut candidates: Vec<Kind> = pooled.iter().map(best_kind).collect();
        candidates.push(Kind { roughness: 5, height: 0.0 });
        candidates = quantised(candidates);
        while kinds.len() < MOST {
            let gain = |candidate: &Kind| -> f64 {
                pooled.iter().map(|e| {
                    let now = kinds.iter().map(|k| k.left(e)).fold(f64::INFINITY, f64::min);
                    (now - candidate.left(e)).clamp(0.0, CERTAIN * self.unit * POOLED as f64)
                }).sum()
            };
            let gains: Vec<f64> = candidates.par_iter().map(gain).collect();
            let Some(best) = (0..gains.len()).max_by(|&a, &b| gains[a].total_cmp(&gains[b])) else { break };
            let mut more = kinds.clone();
            more.push(candidates[best]);
            eprintln!("candidate {:?} of {} gain {}", candidates[best], candidates.len(), gains[best]);
            for _ in 0..ROUNDS {
                let own = self.walk(&more, |_| true);
                for (k, kind) in more.iter_mut().enumerate() {
                    let of = sum(self.evidence.iter().zip(&own).filter(|(_, part)| **part == k).map(|(e, _)| e));
                    *kind = best_kind(&of);
                }
            }
            let z = self.test(&kinds, &more);
            let left = |kinds: &[Kind], parts: &[usize]| -> f64 { self.evidence.iter().zip(parts).map(|(e, &p)| kinds[p].left(e).min(100.0*self.unit)).sum() };
            let own = self.walk(&more, |_| true);
            let mut counts = vec![0; more.len()]; for &p in &own { counts[p] += 1; }
            eprintln!("more {more:?} counts {counts:?} z {z:.1} left {} -> {}", left(&kinds, &parts), left(&more, &own));
            if z < SURE {
                break;
            }
            kinds = more;
            parts = own;
        }
        kinds
    }

    /// By how many standard deviations of chance more kinds explain points better that had no say in their part.
    fn test(&self, fewer: &[Kind], more: &[Kind]) -> f64 {
        let is_told = |i: usize| morton::code([i as u32]).count_ones() % 2 == 0;
        let of = |kinds: &[Kind]| -> Vec<f64> {
            let parts = self.walk(kinds, is_told);
            let points = (0..self.evidence.len()).filter(|&i| !is_told(i));
            points.map(|i| kinds[parts[i]].left(&self.evidence[i]).min(100.0 * self.unit)).collect()
        };
        signed_ranks(&of(fewer), &of(more))
    }

    /// Each point's evidence with that of the points around it, of like colour.
    fn pooled(&self) -> Vec<Evidence> {
        (0..self.evidence.len()).into_par_iter().map(|i| {
            let mut all = self.evidence[i].clone();
            let mut taken = std::collections::BTreeSet::from([i as u32]);
            for &(j, bond) in &self.bonds[i] {
                for &(k, next) in std::iter::once(&(j, 1.0)).chain(&self.bonds[j as usize]) {
                    if bond * next > 0.3 && taken.len() < POOLED && taken.insert(k) {
                        all.add(&self.evidence[k as usize]);
                    }
                }
            }
            all
        }).collect()
    }

    /// The part of each point; only those that `are_told` have their own evidence.
    fn walk(&self, kinds: &[Kind], are_told: impl Fn(usize) -> bool) -> Vec<usize> {
        let n = kinds.len();
        if n == 1 { return vec![0; self.evidence.len()]; }
        let mut told: Vec<(usize, f32)> = Vec::with_capacity(self.evidence.len());
        let mut share = vec![0.0_f32; n];
        for (i, e) in self.evidence.iter().enumerate() {
            let mut left: Vec<(f64, usize)> = kinds.iter().enumerate().map(|(k, kind)| (kind.left(e), k)).collect();
            left.sort_by(|a, b| a.0.total_cmp(&b.0));
            let certain = (((left[1].0 - left[0].0) / self.unit).min(CERTAIN) / CERTAIN) as f32;
            let certain = if are_told(i) { certain } else { 0.0 };
            share[left[0].1] += certain;
            told.push((left[0].1, certain));
        }
        let total: f32 = share.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        let share: Vec<f32> = share.iter().map(|s| s / total).collect();
        let mut likely: Vec<f32> = share.iter().copied().cycle().take(n * told.len()).collect();
        let mut own = vec![0.0_f32; n];
        for sweep in 0..SWEEPS {
            for step in 0..told.len() {
                let i = if sweep % 2 == 0 { step } else { told.len() - 1 - step };
                let (kind, certain) = told[i];
                let mut weight = certain + PRIOR;
                for (own, share) in own.iter_mut().zip(&share) { *own = PRIOR * share; }
                own[kind] += certain;
                for &(j, bond) in &self.bonds[i] {
                    let bond = BOND * bond;
                    weight += bond;
                    for (own, other) in own.iter_mut().zip(&likely[j as usize * n..]) { *own += bond * other; }
                }
                for (p, own) in likely[i * n..(i + 1) * n].iter_mut().zip(&own) { *p = own / weight; }
            }
        }
        likely.chunks_exact(n).map(|p| (0..n).max_by(|&a, &b| p[a].total_cmp(&p[b])).unwrap_or(0)).collect()
    }
}

fn sum<'e>(evidence: impl Iterator<Item = &'e Evidence>) -> Evidence {
    let mut all = Evidence::none();
    for e in evidence { all.add(e); }
    all
}

fn best_height(e: &Evidence, k: usize) -> f64 {
    if e.of[k] > 0.0 { (e.with[k] / e.of[k]).max(0.0) } else { 0.0 }
}

fn best_kind(e: &Evidence) -> Kind {
    let kinds = (0..ROUGHNESSES.len()).map(|k| Kind { roughness: k, height: best_height(e, k) });
    kinds.min_by(|a, b| a.left(e).total_cmp(&b.left(e))).unwrap_or(Kind { roughness: 5, height: 1.0 })
}

/// Some kinds with heights of a few values, each once.
fn quantised(kinds: Vec<Kind>) -> Vec<Kind> {
    let mut found: Vec<Kind> = kinds.into_iter().map(|kind| Kind {
        height: if kind.height > 0.03 { (4.0 * kind.height.log2()).round().clamp(-20.0, 20.0) } else { -1e3 }, ..kind }).collect();
    found.sort_by(|a, b| (a.roughness, a.height).partial_cmp(&(b.roughness, b.height)).unwrap_or(std::cmp::Ordering::Equal));
    found.dedup();
    for kind in &mut found { kind.height = if kind.height > -999.0 { (kind.height / 4.0).exp2() } else { 0.0 }; }
    found
}

/// One over each row's variance: noise, image detail and what is not known of highlights, which are what a row has above the
/// darkest of its point.
fn weights(observations: &Observations, noise: f32) -> Vec<f32> {
    let mut weights = vec![0.0; observations.rows.len()];
    for point in &observations.points {
        let rows = &observations.rows[point.rows.clone()];
        let least = rows.iter().map(|r| magnitude(r.radiance)).fold(f32::INFINITY, f32::min);
        for (weight, row) in weights[point.rows.clone()].iter_mut().zip(rows) {
            let error = HIGHLIGHT_ERROR * (magnitude(row.radiance) - least);
            *weight = deviation(noise.max(1e-7), row.detail).hypot(error).powi(-2);
        }
    }
    weights
}

/// Logarithm of each point's diffuse radiance where `shown` is what is specular.
fn log_colours(observations: &Observations, weights: &[f32], shown: &[[f32; 3]], brdf: &Brdf) -> Vec<Vec3> {
    observations.points.iter().map(|point| {
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for k in point.rows.clone() {
            let row = &observations.rows[k];
            let through = brdf.diffuse_exit(row.cos_view);
            sum += weights[k] * through * (Vec3::from(row.radiance) - Vec3::from(shown[k]));
            total += weights[k] * through * through;
        }
        let colour = (sum / total.max(f32::MIN_POSITIVE)).max(Vec3::splat(1e-4));
        Vec3::new(colour.x.ln(), colour.y.ln(), colour.z.ln())
    }).collect()
}

/// Who lies beside each point, with bonds that colours weaken, and the contrast that does.
fn bonds(observations: &Observations, colours: &[Vec3]) -> (Vec<Vec<(u32, f32)>>, f32) {
    let placed = observations.points.iter().enumerate();
    let placed = placed.map(|(i, p)| GeomWithData::new(p.position.to_array(), i as u32));
    let tree: RTree<GeomWithData<[f32; 3], u32>> = RTree::bulk_load(placed.collect());
    let beside: Vec<Vec<u32>> = observations.points.par_iter().enumerate().map(|(i, point)| {
        tree.nearest_neighbor_iter(point.position.to_array())
            .map(|p| p.data)
            .filter(|&j| j != i as u32 && observations.points[j as usize].normal.dot(point.normal) > 0.0)
            .take(NEIGHBOURS).collect()
    }).collect();
    let mut steps: Vec<f32> = beside.iter().enumerate().flat_map(|(i, beside)| {
        beside.iter().map(move |&j| colours[i].distance(colours[j as usize]))
    }).collect();
    steps.sort_by(f32::total_cmp);
    let contrast = 2.0 * steps.get(steps.len() / 2).copied().unwrap_or(0.0).max(0.02);
    let bonds = beside.into_iter().enumerate().map(|(i, beside)| {
        beside.into_iter().map(|j| (j, rekindle_scene::surface::likeness(contrast, colours[i], colours[j as usize]))).collect()
    }).collect();
    (bonds, contrast)
}
