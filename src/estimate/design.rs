//! The linear system of eq. 7 over a set of cells, with every point's diffuse colour eliminated.
//!
//! A row of point p in view v reads `y = t_v D_p + Σ_c a_c L_c`, with `a_c = ω_c M (R/|p_c − x|)² lobe(n, l_c, v)` and
//! t_v the diffuse transmittance towards the viewer. For weights w, the best D_p given L is a weighted mean over the
//! point's rows; putting it back subtracts from each row t_v times that mean, of a and of y alike. What remains is
//! linear in L alone.

use std::sync::atomic::{AtomicBool, Ordering};

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, Mat, MatRef, Par};
use glam::Vec3;
use rayon::prelude::*;

use super::cells::CellGeometry;
use super::model::{Brdf, SpecularModel, ViewTerms};
use super::observations::{Observations, Point};

/// Points are always cut into this many runs, so that sums come out the same on any number of threads.
const RUNS: usize = 8;

/// Points that are multiplied into the Gram matrix together. Points are ordered by their normals, so that those of
/// one block see the same few cells, and only these columns are multiplied.
const BLOCK: usize = 48;

/// A matrix entry below this share of the block's largest is taken as zero.
const NEGLIGIBLE: f32 = 1e-5;

/// Points, cells and what light of each cell reaches each point.
#[derive(Clone, Debug)]
pub struct Design<'a> {
    /// Rows and points.
    pub observations: &'a Observations,
    /// The cells' directions, solid angles and spread.
    pub geometry: CellGeometry,
    /// Centre and radius of the hemisphere where it is finite.
    pub near: Option<(Vec3, f32)>,
    /// Share of each cell that each point sees, point by point; empty if all is taken as seen.
    pub visibility: Vec<f32>,
    /// Whether the rows' diffuse part has been subtracted already, so that nothing is left to eliminate.
    pub diffuse_known: bool,
    /// Once this is set, long sums end where they are, and what they give is of no use.
    pub stop: &'a AtomicBool,
}

/// Normal equations of the eliminated system, for the three channels.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    /// Symmetric matrix, cells × cells.
    pub gram: Mat<f64>,
    /// One right-hand side per channel.
    pub rhs: [Vec<f64>; 3],
}

impl NormalEquations {
    /// The equations of nothing.
    pub fn none() -> Self {
        Self {
            gram: Mat::new(),
            rhs: [Vec::new(), Vec::new(), Vec::new()],
        }
    }
}

/// Specular radiance of every row and its derivative by σ.
#[derive(Clone, Debug, Default)]
pub struct Prediction {
    /// Predicted specular radiance per row, RGB.
    pub value: Vec<[f32; 3]>,
    /// Its derivative by σ.
    pub by_sigma: Vec<[f32; 3]>,
}

/// Light reaching one point: directions to the cells, and how much of each arrives.
struct Arrival {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    gain: Vec<f32>,
}

impl Design<'_> {
    fn cells(&self) -> usize {
        self.geometry.directions.len()
    }

    /// First and last point of each run.
    fn runs(&self) -> Vec<(usize, usize)> {
        let points = self.observations.points.len();
        let size = points.div_ceil(RUNS).max(1);
        (0..points)
            .step_by(size)
            .map(|first| (first, (first + size).min(points)))
            .collect()
    }

    fn arrival(&self, index: usize, point: &Point, out: &mut Arrival) {
        let n = self.cells();
        let visibility = self.visibility.get(index * n..(index + 1) * n);
        for c in 0..n {
            let (direction, fall_off) =
                light_from(self.near, self.geometry.directions[c], point.position);
            let seen = visibility.map_or(1.0, |v| v[c]);
            (out.x[c], out.y[c], out.z[c]) = direction.into();
            out.gain[c] = if point.normal.dot(direction) > 0.0 {
                self.geometry.solid_angles[c] * fall_off * seen
            } else {
                0.0
            };
        }
    }

    /// The eliminated normal equations for weights per row.
    pub fn normal_equations(&self, brdf: &Brdf, weights: &[f32]) -> NormalEquations {
        let n = self.cells();
        let parts: Vec<(Mat<f64>, [Vec<f64>; 3])> = self
            .runs()
            .into_par_iter()
            .map(|(first, last)| self.run_equations(brdf, weights, first, last))
            .collect();
        let mut gram = Mat::<f64>::zeros(n, n);
        let mut rhs = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        for (g, r) in &parts {
            for j in 0..n {
                for i in j..n {
                    gram[(i, j)] += g[(i, j)];
                }
            }
            add(&mut rhs, r);
        }
        for j in 0..n {
            for i in 0..j {
                gram[(i, j)] = gram[(j, i)];
            }
        }
        NormalEquations { gram, rhs }
    }

    fn run_equations(
        &self,
        brdf: &Brdf,
        weights: &[f32],
        first: usize,
        last: usize,
    ) -> (Mat<f64>, [Vec<f64>; 3]) {
        let n = self.cells();
        let mut gram = Mat::<f64>::zeros(n, n);
        let mut rhs = [vec![0.0_f64; n], vec![0.0; n], vec![0.0; n]];
        let mut arrival = Arrival::new(n);
        let mut block: Vec<f32> = Vec::new();
        for start in (first..last).step_by(BLOCK) {
            if self.stop.load(Ordering::Relaxed) {
                break;
            }
            block.clear();
            for index in start..(start + BLOCK).min(last) {
                let point = &self.observations.points[index];
                self.arrival(index, point, &mut arrival);
                self.fill_point(brdf, point, &arrival, &mut block);
            }
            let (columns, mut compact) = compress(&block, n);
            let m = columns.len();
            let mut sums = [vec![0.0; m], vec![0.0; m], vec![0.0; m]];
            let mut from = 0;
            for index in start..(start + BLOCK).min(last) {
                let point = &self.observations.points[index];
                let part = &mut compact[from * m..(from + point.rows.len()) * m];
                from += point.rows.len();
                let measured = self.observations.radiance(point);
                self.eliminate(brdf, weights, point, &measured, part, &mut sums);
            }
            accumulate(&mut gram, &compact, &columns);
            for (all, own) in rhs.iter_mut().zip(&sums) {
                for (&c, v) in columns.iter().zip(own) {
                    all[c] += v;
                }
            }
        }
        (gram, rhs)
    }

    /// Subtracts the weighted mean over a point's rows, scales each row by √w and adds its product with `values`
    /// to the right-hand sides.
    fn eliminate(
        &self,
        brdf: &Brdf,
        weights: &[f32],
        point: &Point,
        values: &[[f32; 3]],
        block: &mut [f32],
        rhs: &mut [Vec<f64>; 3],
    ) {
        let n = rhs[0].len();
        let rows = &self.observations.rows[point.rows.clone()];
        let transmittance: Vec<f32> = rows
            .iter()
            .map(|r| brdf.diffuse_transmittance(r.cos_view))
            .collect();
        let w = &weights[point.rows.clone()];
        let total: f32 = w.iter().zip(&transmittance).map(|(w, t)| w * t * t).sum();
        if total <= 0.0 {
            block.fill(0.0);
            return;
        }
        let mut mean = vec![0.0_f32; n];
        let mut mean_radiance = Vec3::ZERO;
        let averaged = if self.diffuse_known { 0 } else { rows.len() };
        for k in 0..averaged {
            let share = w[k] * transmittance[k] / total;
            for (m, a) in mean.iter_mut().zip(&block[k * n..(k + 1) * n]) {
                *m += share * a;
            }
            mean_radiance += share * Vec3::from(values[k]);
        }
        for k in 0..rows.len() {
            let (root, t) = (w[k].sqrt(), transmittance[k]);
            let y = (root * (Vec3::from(values[k]) - t * mean_radiance)).to_array();
            let row = &mut block[k * n..(k + 1) * n];
            for (a, m) in row.iter_mut().zip(&mean) {
                *a = root * (*a - t * m);
            }
            for (sum, y) in rhs.iter_mut().zip(y) {
                for (s, a) in sum.iter_mut().zip(row.iter()) {
                    *s += f64::from(a * y);
                }
            }
        }
    }

    /// The same points with some of the cells only.
    pub fn restricted(&self, kept: &[usize]) -> Self {
        let n = self.cells();
        let pick = |values: &[f32]| kept.iter().map(|&c| values[c]).collect();
        Self {
            geometry: CellGeometry {
                directions: kept.iter().map(|&c| self.geometry.directions[c]).collect(),
                solid_angles: pick(&self.geometry.solid_angles),
                spread: pick(&self.geometry.spread),
            },
            visibility: self
                .visibility
                .chunks(n.max(1))
                .flat_map(|v| kept.iter().map(|&c| v[c]))
                .collect(),
            ..self.clone()
        }
    }

    /// `aᵀ W z` for each cell's eliminated column a and each channel of `values`, one RGB value per row.
    pub fn correlate(&self, brdf: &Brdf, weights: &[f32], values: &[[f32; 3]]) -> [Vec<f64>; 3] {
        let n = self.cells();
        let parts: Vec<[Vec<f64>; 3]> = self
            .runs()
            .into_par_iter()
            .map(|(first, last)| {
                let mut sums = [vec![0.0_f64; n], vec![0.0; n], vec![0.0; n]];
                let mut arrival = Arrival::new(n);
                let mut block = Vec::new();
                for index in first..last {
                    if self.stop.load(Ordering::Relaxed) {
                        break;
                    }
                    let point = &self.observations.points[index];
                    self.arrival(index, point, &mut arrival);
                    self.fill_point(brdf, point, &arrival, &mut block);
                    self.eliminate(
                        brdf,
                        weights,
                        point,
                        &values[point.rows.clone()],
                        &mut block,
                        &mut sums,
                    );
                    block.clear();
                }
                sums
            })
            .collect();
        let mut all = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        for part in &parts {
            add(&mut all, part);
        }
        all
    }

    /// Appends one row of the matrix per row of the point.
    fn fill_point(&self, brdf: &Brdf, point: &Point, arrival: &Arrival, block: &mut Vec<f32>) {
        let n = self.cells();
        for row in &self.observations.rows[point.rows.clone()] {
            let from = block.len();
            block.resize(from + n, 0.0);
            let terms = brdf.view_terms(point.normal, row.to_camera);
            fill_row(
                brdf,
                &terms,
                arrival,
                &self.geometry.spread,
                &mut block[from..],
                None,
            );
        }
    }

    /// Specular radiance of every row under the cells' radiances, with its derivative by σ.
    pub fn predict(&self, brdf: &Brdf, radiance: &[[f32; 3]]) -> Prediction {
        let lit: Vec<usize> = (0..self.cells())
            .filter(|&c| radiance[c].iter().any(|&v| v != 0.0))
            .collect();
        let design = self.restricted(&lit);
        let channels = [0, 1, 2].map(|k| lit.iter().map(|&c| radiance[c][k]).collect::<Vec<f32>>());
        let parts: Vec<Prediction> = design
            .runs()
            .into_par_iter()
            .map(|(first, last)| {
                let mut part = Prediction::default();
                let mut arrival = Arrival::new(lit.len());
                let (mut value, mut by_sigma) = (vec![0.0; lit.len()], vec![0.0; lit.len()]);
                for index in first..last {
                    let point = &self.observations.points[index];
                    design.arrival(index, point, &mut arrival);
                    for row in &self.observations.rows[point.rows.clone()] {
                        let terms = brdf.view_terms(point.normal, row.to_camera);
                        let spread = &design.geometry.spread;
                        fill_row(
                            brdf,
                            &terms,
                            &arrival,
                            spread,
                            &mut value,
                            Some(&mut by_sigma),
                        );
                        part.value.push(channels.each_ref().map(|l| dot(&value, l)));
                        part.by_sigma
                            .push(channels.each_ref().map(|l| dot(&by_sigma, l)));
                    }
                }
                part
            })
            .collect();
        let mut all = Prediction::default();
        for part in parts {
            all.value.extend(part.value);
            all.by_sigma.extend(part.by_sigma);
        }
        all
    }
}

fn add(sums: &mut [Vec<f64>; 3], part: &[Vec<f64>; 3]) {
    for (sum, part) in sums.iter_mut().zip(part) {
        for (s, p) in sum.iter_mut().zip(part) {
            *s += p;
        }
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Arrival {
    fn new(n: usize) -> Self {
        Self {
            x: vec![0.0; n],
            y: vec![0.0; n],
            z: vec![0.0; n],
            gain: vec![0.0; n],
        }
    }

    #[inline(always)]
    fn slices(&self, n: usize) -> (&[f32], &[f32], &[f32], &[f32]) {
        (&self.x[..n], &self.y[..n], &self.z[..n], &self.gain[..n])
    }
}

/// Unit direction from `position` towards a light in the direction `direction` from the hemisphere's centre, and
/// its fall-off (R/|p − x|)²; `near` holds centre and radius of a finite hemisphere.
#[inline(always)]
pub fn light_from(near: Option<(Vec3, f32)>, direction: Vec3, position: Vec3) -> (Vec3, f32) {
    match near {
        None => (direction, 1.0),
        Some((centre, radius)) => {
            let to_light = centre + radius * direction - position;
            let squared = to_light.length_squared().max(1e-12 * radius * radius);
            (to_light / squared.sqrt(), radius * radius / squared)
        }
    }
}

/// A lobe blurred by the extent of a cell, as its mean over the cell: the Gaussian of variance σ² becomes wider and, as
/// its integral stays, lower.
#[derive(Clone, Copy)]
struct Blurred {
    brdf: Brdf,
    /// Its height over the sharp lobe's, σ²/σ_blurred².
    height: f32,
    /// dσ_blurred/dσ.
    by_sigma: f32,
}

impl Blurred {
    #[inline(always)]
    fn new(brdf: &Brdf, spread: f32) -> Self {
        let variance = brdf.sigma * brdf.sigma;
        let inverse = 1.0 / (variance + spread);
        let ratio = (variance * inverse).sqrt();
        Self {
            brdf: Brdf {
                sigma: brdf.sigma / ratio,
                ..*brdf
            },
            height: variance * inverse,
            by_sigma: ratio,
        }
    }
}

/// One row of the matrix: gain × lobe for each cell, and its derivative by σ if wanted.
struct RowKernel<'a, const MICROFACET: bool> {
    sigma: f32,
    terms: &'a ViewTerms,
    arrival: &'a Arrival,
    spread: &'a [f32],
    value: &'a mut [f32],
    by_sigma: Option<&'a mut [f32]>,
}

impl<const MICROFACET: bool> pulp::WithSimd for RowKernel<'_, MICROFACET> {
    type Output = ();

    /// The model is a constant, so that the loops are free of branches and become vector code of the widest kind
    /// that the processor has.
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let model = if MICROFACET {
            SpecularModel::Microfacet
        } else {
            SpecularModel::Paper
        };
        let brdf = Brdf {
            model,
            sigma: self.sigma,
        };
        let n = self.value.len();
        let (x, y, z, gain) = self.arrival.slices(n);
        let spread = &self.spread[..n];
        if let Some(by_sigma) = self.by_sigma {
            let by_sigma = &mut by_sigma[..n];
            for c in 0..n {
                let blurred = Blurred::new(&brdf, spread[c]);
                let lobe = blurred
                    .brdf
                    .lobe_with_derivative(self.terms, Vec3::new(x[c], y[c], z[c]));
                let gain = gain[c] * blurred.height;
                self.value[c] = gain * lobe.value;
                // The height's own derivative is 2/σ · height · (1 − height).
                by_sigma[c] = gain
                    * (blurred.by_sigma * lobe.by_sigma
                        + 2.0 / self.sigma * (1.0 - blurred.height) * lobe.value);
            }
        } else {
            for c in 0..n {
                let blurred = Blurred::new(&brdf, spread[c]);
                let lobe = blurred.brdf.lobe(self.terms, Vec3::new(x[c], y[c], z[c]));
                self.value[c] = gain[c] * blurred.height * lobe;
            }
        }
    }
}

fn fill_row(
    brdf: &Brdf,
    terms: &ViewTerms,
    arrival: &Arrival,
    spread: &[f32],
    value: &mut [f32],
    by_sigma: Option<&mut [f32]>,
) {
    let sigma = brdf.sigma;
    let arch = pulp::Arch::new();
    match brdf.model {
        SpecularModel::Paper => arch.dispatch(RowKernel::<false> {
            sigma,
            terms,
            arrival,
            spread,
            value,
            by_sigma,
        }),
        SpecularModel::Microfacet => arch.dispatch(RowKernel::<true> {
            sigma,
            terms,
            arrival,
            spread,
            value,
            by_sigma,
        }),
    }
}

/// The columns of a block of rows of `n` values that hold more than nothing, and the rows with these columns only.
fn compress(block: &[f32], n: usize) -> (Vec<usize>, Vec<f32>) {
    let mut largest = vec![0.0_f32; n];
    for row in block.chunks_exact(n.max(1)) {
        for (l, a) in largest.iter_mut().zip(row) {
            *l = l.max(*a);
        }
    }
    let threshold = NEGLIGIBLE * largest.iter().fold(0.0_f32, |m, &l| m.max(l));
    let columns: Vec<usize> = (0..n).filter(|&c| largest[c] > threshold).collect();
    let mut compact = Vec::with_capacity(columns.len() * block.len() / n.max(1));
    for row in block.chunks_exact(n.max(1)) {
        compact.extend(columns.iter().map(|&c| row[c]));
    }
    (columns, compact)
}

/// Adds `blockᵀ block` to the lower half of `gram`; `block` holds rows of the values of `columns`, which ascend.
fn accumulate(gram: &mut Mat<f64>, block: &[f32], columns: &[usize]) {
    let n = columns.len();
    if n == 0 {
        return;
    }
    let rows = block.len() / n;
    let block: Vec<f64> = block.iter().map(|&a| f64::from(a)).collect();
    // Row-major rows × n is column-major n × rows.
    let transposed = MatRef::from_column_major_slice(&block, n, rows);
    let mut product = Mat::<f64>::zeros(n, n);
    matmul(
        product.as_mut(),
        BlockStructure::TriangularLower,
        Accum::Replace,
        transposed,
        BlockStructure::Rectangular,
        transposed.transpose(),
        BlockStructure::Rectangular,
        1.0_f64,
        Par::Seq,
    );
    for j in 0..n {
        for i in j..n {
            gram[(columns[i], columns[j])] += product[(i, j)];
        }
    }
}
