//! The linear system of eq. 7 over a set of cells, with every point's diffuse colour eliminated.
//!
//! A row of point p in view v reads `y = t_v D_p + Σ_c a_c L_c`, with `a_c = ω_c M (R/|p_c − x|)² lobe(n, l_c, v)` and
//! t_v the diffuse transmittance towards the viewer. For weights w, the best D_p given L is a weighted mean over the
//! point's rows; putting it back subtracts from each row t_v times that mean, of a and of y alike. What remains is
//! linear in L alone.

use std::sync::atomic::{AtomicBool, Ordering};

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, Mat, MatMut, MatRef, Par};
use glam::Vec3;
use rayon::prelude::*;

use super::cells::CellGeometry;
use super::lobes::{CellLobes, PointLobes};
use super::model::Brdf;
use super::observations::{Observations, Point};

/// Points are always cut into this many runs, so that sums come out the same on any number of threads.
const RUNS: usize = 8;

/// Points that are multiplied into the Gram matrix together. Points are ordered by their normals, so that those of
/// one block see the same few cells, and only these columns are multiplied.
const BLOCK: usize = 48;

/// A matrix entry below this share of the block's largest is taken as zero.
const NEGLIGIBLE: f32 = 1e-5;
/// Past this part of all columns, multiplying them all costs less than picking.
const FEW_LEFT_OUT: f32 = 0.85;

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

    /// Computes the light of all cells at a point.
    fn light(&self, lobes: &CellLobes<'_>, index: usize, out: &mut PointLobes) {
        let n = self.cells();
        let point = &self.observations.points[index];
        let visibility = self.visibility.get(index * n..(index + 1) * n);
        lobes.light(point.position, point.normal, visibility, out);
    }

    fn lobes(&self, brdf: &Brdf) -> CellLobes<'_> {
        CellLobes::new(brdf, &self.geometry, self.near)
    }

    /// The eliminated normal equations for weights per row.
    pub fn normal_equations(&self, brdf: &Brdf, weights: &[f32]) -> NormalEquations {
        let n = self.cells();
        let lobes = self.lobes(brdf);
        let parts: Vec<(Lower, [Vec<f64>; 3])> = self
            .runs()
            .into_par_iter()
            .map(|(first, last)| self.run_equations(&lobes, weights, first, last))
            .collect();
        let mut gram = Mat::<f64>::zeros(n, n);
        let mut rhs = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        for j in 0..n {
            let column = &mut gram.col_as_slice_mut(j)[j..];
            for (part, _) in &parts {
                add(column, &part.column(j)[j..]);
            }
        }
        for (_, part) in &parts {
            for (sum, part) in rhs.iter_mut().zip(part) {
                add(sum, part);
            }
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
        lobes: &CellLobes<'_>,
        weights: &[f32],
        first: usize,
        last: usize,
    ) -> (Lower, [Vec<f64>; 3]) {
        let n = self.cells();
        let mut gram = Lower::new(n);
        let mut rhs = [vec![0.0_f64; n], vec![0.0; n], vec![0.0; n]];
        let mut light = lobes.point();
        let mut block: Vec<f32> = Vec::new();
        for start in (first..last).step_by(BLOCK) {
            if self.stop.load(Ordering::Relaxed) {
                break;
            }
            block.clear();
            for index in start..(start + BLOCK).min(last) {
                self.light(lobes, index, &mut light);
                self.fill_point(lobes, index, &light, &mut block);
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
                self.eliminate(&lobes.brdf(), weights, point, &measured, part, &mut sums);
            }
            gram.add_product(&compact, &columns);
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
        let lobes = self.lobes(brdf);
        let parts: Vec<[Vec<f64>; 3]> = self
            .runs()
            .into_par_iter()
            .map(|(first, last)| {
                let mut sums = [vec![0.0_f64; n], vec![0.0; n], vec![0.0; n]];
                let mut light = lobes.point();
                let mut block = Vec::new();
                for index in first..last {
                    if self.stop.load(Ordering::Relaxed) {
                        break;
                    }
                    let point = &self.observations.points[index];
                    self.light(&lobes, index, &mut light);
                    self.fill_point(&lobes, index, &light, &mut block);
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
            for (sum, part) in all.iter_mut().zip(part) {
                add(sum, part);
            }
        }
        all
    }

    /// Appends one row of the matrix per row of the point.
    fn fill_point(
        &self,
        lobes: &CellLobes<'_>,
        index: usize,
        light: &PointLobes,
        block: &mut Vec<f32>,
    ) {
        let n = self.cells();
        let point = &self.observations.points[index];
        for row in &self.observations.rows[point.rows.clone()] {
            let from = block.len();
            block.resize(from + n, 0.0);
            let terms = lobes.brdf().view_terms(point.normal, row.to_camera);
            lobes.row(&terms, light, &mut block[from..], None);
        }
    }

    /// Specular radiance of every row under the cells' radiances, with its derivative by σ.
    pub fn predict(&self, brdf: &Brdf, radiance: &[[f32; 3]]) -> Prediction {
        let lit: Vec<usize> = (0..self.cells())
            .filter(|&c| radiance[c].iter().any(|&v| v != 0.0))
            .collect();
        let design = self.restricted(&lit);
        let lobes = design.lobes(brdf);
        let channels = [0, 1, 2].map(|k| lit.iter().map(|&c| radiance[c][k]).collect::<Vec<f32>>());
        let parts: Vec<Prediction> = design
            .runs()
            .into_par_iter()
            .map(|(first, last)| {
                let mut part = Prediction::default();
                let mut light = lobes.point();
                let (mut value, mut by_sigma) = (vec![0.0; lit.len()], vec![0.0; lit.len()]);
                for index in first..last {
                    let point = &self.observations.points[index];
                    design.light(&lobes, index, &mut light);
                    for row in &self.observations.rows[point.rows.clone()] {
                        let terms = brdf.view_terms(point.normal, row.to_camera);
                        lobes.row(&terms, &light, &mut value, Some(&mut by_sigma));
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

fn add(sums: &mut [f64], part: &[f64]) {
    for (s, p) in sums.iter_mut().zip(part) {
        *s += p;
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The columns of a block of rows of `n` values that hold more than nothing, and the rows with these columns only; all
/// columns where that leaves out few.
fn compress(block: &[f32], n: usize) -> (Vec<usize>, Vec<f32>) {
    let mut largest = vec![0.0_f32; n];
    for row in block.chunks_exact(n.max(1)) {
        for (l, &a) in largest.iter_mut().zip(row) {
            *l = if a > *l { a } else { *l };
        }
    }
    let threshold = NEGLIGIBLE * largest.iter().fold(0.0_f32, |m, &l| m.max(l));
    let columns: Vec<usize> = (0..n).filter(|&c| largest[c] > threshold).collect();
    if columns.len() as f32 > FEW_LEFT_OUT * n as f32 {
        return ((0..n).collect(), block.to_vec());
    }
    let mut compact = Vec::with_capacity(columns.len() * block.len() / n.max(1));
    for row in block.chunks_exact(n.max(1)) {
        compact.extend(columns.iter().map(|&c| row[c]));
    }
    (columns, compact)
}

/// The lower half of a symmetric matrix in the making.
struct Lower {
    /// Column by column, n × n; the upper half is not used.
    values: Vec<f64>,
    n: usize,
    /// Room for a block's product.
    product: Vec<f64>,
}

impl Lower {
    fn new(n: usize) -> Self {
        Self {
            values: vec![0.0; n * n],
            n,
            product: Vec::new(),
        }
    }

    fn column(&self, j: usize) -> &[f64] {
        &self.values[j * self.n..(j + 1) * self.n]
    }

    /// Adds `blockᵀ block`; `block` holds rows of the values of `columns`, which ascend.
    fn add_product(&mut self, block: &[f32], columns: &[usize]) {
        let (m, n) = (columns.len(), self.n);
        if m == 0 {
            return;
        }
        let rows = block.len() / m;
        let block: Vec<f64> = block.iter().map(|&a| f64::from(a)).collect();
        if m == n {
            let sum = MatMut::from_column_major_slice_mut(&mut self.values, n, n);
            add_gram(sum, &block, rows, Accum::Add);
            return;
        }
        self.product.resize(m * m, 0.0);
        let product = MatMut::from_column_major_slice_mut(&mut self.product, m, m);
        add_gram(product, &block, rows, Accum::Replace);
        for (j, &column) in columns.iter().enumerate() {
            let sum = &mut self.values[column * n..(column + 1) * n];
            let product = &self.product[j * m..(j + 1) * m];
            for (&i, p) in columns[j..].iter().zip(&product[j..]) {
                sum[i] += p;
            }
        }
    }
}

/// The lower half of `blockᵀ block`, added to `sum` or in its place; `block` holds `rows` rows.
fn add_gram(sum: MatMut<'_, f64>, block: &[f64], rows: usize, accum: Accum) {
    // Row-major rows × n is column-major n × rows.
    let transposed = MatRef::from_column_major_slice(block, block.len() / rows, rows);
    matmul(
        sum,
        BlockStructure::TriangularLower,
        accum,
        transposed,
        BlockStructure::Rectangular,
        transposed.transpose(),
        BlockStructure::Rectangular,
        1.0_f64,
        Par::Seq,
    );
}
