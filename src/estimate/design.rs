//! The linear system of eq. 7 over a set of cells, with every point's diffuse colour eliminated.
//!
//! A row of point p in view v reads `y = t_v D_p + Σ_c a_c L_c`, with `a_c = ω_c M (R/|p_c − x|)² lobe(n, l_c, v)` and
//! t_v the diffuse transmittance towards the viewer. For weights w, the best D_p given L is a weighted mean over the
//! point's rows; putting it back subtracts from each row t_v times that mean, of a and of y alike. What remains is
//! linear in L alone.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, Mat, MatMut, MatRef, Par};
use glam::Vec3;
use rayon::prelude::*;

use super::cells::CellGeometry;
use super::lobes::{CellLobes, PointLobes};
use super::model::Brdf;
use super::observations::{Observations, Point};
use super::shortcuts::{Shortcut, Shortcuts};
use super::visibility::SeenCells;
use super::workspace::Workspace;
use crate::math::vector;

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
    /// Share of each cell that each point sees.
    pub seen: SeenCells,
    /// Whether the rows' diffuse part has been subtracted already, so that nothing is left to eliminate.
    pub diffuse_known: bool,
    /// What may be left out.
    pub shortcuts: &'a Shortcuts,
    /// Memory for the equations.
    pub workspace: &'a Workspace,
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
        let point = &self.observations.points[index];
        lobes.light(point.position, point.normal, self.seen.of(index), out);
    }

    fn lobes(&self, brdf: &Brdf) -> CellLobes<'_> {
        let whole = !self.shortcuts.takes(Shortcut::Lobes);
        CellLobes::new(brdf, &self.geometry, self.near, whole)
    }

    /// The eliminated normal equations for weights per row.
    pub fn normal_equations(&self, brdf: &Brdf, weights: &[f32]) -> NormalEquations {
        let n = self.cells();
        let lobes = self.lobes(brdf);
        let parts: Vec<Lower> = self
            .runs()
            .into_par_iter()
            .map(|(first, last)| self.run_equations(&lobes, weights, first, last))
            .collect();
        let columns: Vec<Vec<f64>> = (0..n)
            .into_par_iter()
            .map(|j| {
                let mut sums = vec![0.0; n + 3 - j];
                for part in &parts {
                    add(&mut sums, part.column(j));
                }
                sums
            })
            .collect();
        for part in parts {
            self.workspace.take_back(part.values);
        }
        let mut gram = Mat::<f64>::zeros(n, n);
        let mut rhs = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        for (j, sums) in columns.into_iter().enumerate() {
            let (products, measured) = sums.split_at(n - j);
            gram.col_as_slice_mut(j)[j..].copy_from_slice(products);
            for (rhs, &m) in rhs.iter_mut().zip(measured) {
                rhs[j] = m;
            }
        }
        for j in 0..n {
            for i in 0..j {
                gram[(i, j)] = gram[(j, i)];
            }
        }
        NormalEquations { gram, rhs }
    }

    /// Products of all columns, those of the cells and then the three of what was measured, over some points.
    fn run_equations(
        &self,
        lobes: &CellLobes<'_>,
        weights: &[f32],
        first: usize,
        last: usize,
    ) -> Lower {
        let width = self.cells() + 3;
        let mut gram = Lower {
            values: self.workspace.zeros(width * (width + 1) / 2),
            n: width,
            product: Vec::new(),
        };
        let mut light = lobes.point();
        let mut block: Vec<f32> = Vec::new();
        for start in (first..last).step_by(BLOCK) {
            if self.stop.load(Ordering::Relaxed) {
                break;
            }
            let points = start..(start + BLOCK).min(last);
            block.clear();
            for index in points.clone() {
                self.light(lobes, index, &mut light);
                self.fill_point(lobes, index, &light, &mut block);
            }
            let (columns, mut compact) = if self.shortcuts.takes(Shortcut::Lobes) {
                compress(&block, width)
            } else {
                ((0..width).collect(), block.clone())
            };
            let m = columns.len();
            let left_out = (width - m) * (block.len() / width);
            self.shortcuts.count(Shortcut::Lobes, block.len(), left_out);
            let mut rest = compact.as_mut_slice();
            for point in &self.observations.points[points] {
                let (rows, others) = rest.split_at_mut(point.rows.len() * m);
                self.eliminate(&lobes.brdf(), weights, point, rows);
                rest = others;
            }
            gram.add_product(&compact, &columns);
        }
        gram
    }

    /// Subtracts the weighted mean over a point's rows and scales each row by √w.
    fn eliminate(&self, brdf: &Brdf, weights: &[f32], point: &Point, block: &mut [f32]) {
        let rows = &self.observations.rows[point.rows.clone()];
        let w = &weights[point.rows.clone()];
        let n = block.len() / rows.len().max(1);
        let transmittance: Vec<f32> = rows
            .iter()
            .map(|r| brdf.diffuse_transmittance(r.cos_view))
            .collect();
        let total: f32 = w.iter().zip(&transmittance).map(|(w, t)| w * t * t).sum();
        if total <= 0.0 {
            block.fill(0.0);
            return;
        }
        let mut mean = vec![0.0_f32; n];
        if !self.diffuse_known {
            for ((row, w), t) in block.chunks_exact(n).zip(w).zip(&transmittance) {
                vector::add_scaled(&mut mean, w * t / total, row);
            }
        }
        for ((row, w), t) in block.chunks_exact_mut(n).zip(w).zip(&transmittance) {
            vector::combine(row, w.sqrt(), -t * w.sqrt(), &mean);
        }
    }

    /// The same points with some of the cells only.
    #[must_use]
    pub fn restricted(&self, kept: &[usize]) -> Self {
        let pick = |values: &[f32]| kept.iter().map(|&c| values[c]).collect();
        Self {
            geometry: CellGeometry {
                directions: kept.iter().map(|&c| self.geometry.directions[c]).collect(),
                solid_angles: pick(&self.geometry.solid_angles),
                spread: pick(&self.geometry.spread),
            },
            seen: self.seen.restricted(kept),
            ..self.clone()
        }
    }

    /// `aᵀ W z` for each cell's column a and each channel of `values`, one RGB value per row, from which the diffuse part
    /// has been eliminated: then it need not be from the columns.
    pub fn correlate(&self, brdf: &Brdf, weights: &[f32], values: &[[f32; 3]]) -> [Vec<f64>; 3] {
        let n = self.cells();
        let channels = if self.observations.gray { 1 } else { 3 };
        let lobes = self.lobes(brdf);
        let parts: Vec<[Vec<f64>; 3]> = self
            .runs()
            .into_par_iter()
            .map(|(first, last)| {
                let mut sums = [vec![0.0_f64; n], vec![0.0; n], vec![0.0; n]];
                let mut own = [vec![0.0_f32; n], vec![0.0; n], vec![0.0; n]];
                let mut light = lobes.point();
                let mut value = vec![0.0_f32; n];
                for start in (first..last).step_by(BLOCK) {
                    if self.stop.load(Ordering::Relaxed) {
                        break;
                    }
                    for index in start..(start + BLOCK).min(last) {
                        let point = &self.observations.points[index];
                        self.light(&lobes, index, &mut light);
                        for k in point.rows.clone() {
                            let to_camera = self.observations.rows[k].to_camera;
                            let terms = brdf.view_terms(point.normal, to_camera);
                            lobes.row(&terms, &light, &mut value, None);
                            for (sum, z) in own.iter_mut().zip(values[k]).take(channels) {
                                vector::add_scaled(sum, weights[k] * z, &value);
                            }
                        }
                    }
                    for (sum, own) in sums.iter_mut().zip(&mut own).take(channels) {
                        add(sum, own);
                        own.fill(0.0);
                    }
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
        if self.observations.gray {
            all = [all[0].clone(), all[0].clone(), all[0].clone()];
        }
        all
    }

    /// Appends one row of the matrix, and the three channels measured, per row of the point.
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
            block.extend(row.radiance);
        }
    }

    /// Specular radiance of every row under the cells' radiances, with its derivative by σ.
    pub fn predict(&self, brdf: &Brdf, radiance: &[[f32; 3]]) -> Prediction {
        let (value, by_sigma) = self.predicted(brdf, radiance, true);
        Prediction { value, by_sigma }
    }

    /// Specular radiance of every row under the cells' radiances.
    pub fn predict_values(&self, brdf: &Brdf, radiance: &[[f32; 3]]) -> Vec<[f32; 3]> {
        self.predicted(brdf, radiance, false).0
    }

    fn predicted(
        &self,
        brdf: &Brdf,
        radiance: &[[f32; 3]],
        derive: bool,
    ) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
        let lit: Vec<usize> = (0..self.cells())
            .filter(|&c| radiance[c].iter().any(|&v| v != 0.0))
            .collect();
        let design = self.restricted(&lit);
        let lobes = design.lobes(brdf);
        let channels = [0, 1, 2].map(|k| lit.iter().map(|&c| radiance[c][k]).collect::<Vec<f32>>());
        let gray = channels[0] == channels[1] && channels[0] == channels[2];
        let sum = |row: &[f32]| {
            if gray {
                [vector::dot(row, &channels[0]); 3]
            } else {
                channels.each_ref().map(|l| vector::dot(row, l))
            }
        };
        design
            .runs()
            .into_par_iter()
            .flat_map_iter(|(first, last)| {
                let mut rows = Vec::new();
                let mut light = lobes.point();
                let (mut value, mut by_sigma) = (vec![0.0; lit.len()], vec![0.0; lit.len()]);
                for index in first..last {
                    let point = &self.observations.points[index];
                    design.light(&lobes, index, &mut light);
                    for row in &self.observations.rows[point.rows.clone()] {
                        let terms = brdf.view_terms(point.normal, row.to_camera);
                        let derivative = derive.then_some(by_sigma.as_mut_slice());
                        lobes.row(&terms, &light, &mut value, derivative);
                        rows.push((sum(&value), sum(&by_sigma)));
                    }
                }
                rows
            })
            .unzip()
    }
}

fn add<T: Into<f64> + Copy>(sums: &mut [f64], part: &[T]) {
    for (s, &p) in sums.iter_mut().zip(part) {
        *s += p.into();
    }
}

/// The columns of a block of rows of `width` values that hold more than nothing, always with the last three, and the rows
/// with these columns only; all columns where that leaves out few.
fn compress(block: &[f32], width: usize) -> (Vec<usize>, Vec<f32>) {
    let mut largest = vec![0.0_f32; width];
    for row in block.chunks_exact(width) {
        vector::keep_larger(&mut largest, row);
    }
    let cells = width - 3;
    let threshold = NEGLIGIBLE * largest[..cells].iter().fold(0.0_f32, |m, &l| m.max(l));
    let columns: Vec<usize> = (0..width)
        .filter(|&c| c >= cells || largest[c] > threshold)
        .collect();
    if columns.len() as f32 > FEW_LEFT_OUT * width as f32 {
        return ((0..width).collect(), block.to_vec());
    }
    let mut compact = Vec::with_capacity(columns.len() * block.len() / width);
    for row in block.chunks_exact(width) {
        compact.extend(columns.iter().map(|&c| row[c]));
    }
    (columns, compact)
}

/// The lower half of a symmetric matrix in the making.
struct Lower {
    /// Column by column, each from the diagonal down.
    values: Vec<f64>,
    n: usize,
    /// Room for a block's product.
    product: Vec<f32>,
}

impl Lower {
    /// Where a column is: those before it have n, n − 1, … values.
    fn place(&self, j: usize) -> Range<usize> {
        let first = j * self.n - j * j.saturating_sub(1) / 2;
        first..first + self.n - j
    }

    fn column(&self, j: usize) -> &[f64] {
        &self.values[self.place(j)]
    }

    /// Adds `blockᵀ block`; `block` holds rows of the values of `columns`, which ascend. A block's products are summed in
    /// single precision, blocks in double.
    fn add_product(&mut self, block: &[f32], columns: &[usize]) {
        let (m, n) = (columns.len(), self.n);
        // Row-major rows × m is column-major m × rows.
        let transposed = MatRef::from_column_major_slice(block, m, block.len() / m);
        self.product.resize(m * m, 0.0);
        matmul(
            MatMut::from_column_major_slice_mut(&mut self.product, m, m),
            BlockStructure::TriangularLower,
            Accum::Replace,
            transposed,
            BlockStructure::Rectangular,
            transposed.transpose(),
            BlockStructure::Rectangular,
            1.0_f32,
            Par::Seq,
        );
        for (j, &column) in columns.iter().enumerate() {
            let place = self.place(column);
            let sums = &mut self.values[place];
            let product = &self.product[j * m..(j + 1) * m];
            if m == n {
                add(sums, &product[j..]);
            } else {
                for (&i, &p) in columns[j..].iter().zip(&product[j..]) {
                    sums[i - column] += f64::from(p);
                }
            }
        }
    }
}
