//! The linear system of eq. 7 over a set of cells, with every point's diffuse colour eliminated.
//!
//! A row of point p in view v reads `y = t_v D_p + Σ_c a_c L_c`, with `a_c = ω_c M (R/|p_c − x|)² lobe(n, l_c, v)` and
//! t_v the diffuse transmittance towards the viewer. For weights w, the best D_p given L is a weighted mean over the
//! point's rows; putting it back subtracts from each row t_v times that mean, of a and of y alike. What remains is
//! linear in L alone.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use faer::Mat;
use glam::Vec3;
use rayon::prelude::*;

use super::cells::CellGeometry;
use super::gram::{Columns, Lower};
use super::lobes::{CellLobes, PointLobes};
use super::observations::{Observations, Point};
use super::visibility::SeenCells;
use super::workspace::Workspace;
use rekindle_base::math::vector;
use rekindle_scene::reflectance::{Brdf, ViewTerms};
use rekindle_scene::shortcuts::{Shortcut, Shortcuts};

/// Points are always cut into this many runs, so that sums come out the same on any number of threads.
const RUNS: usize = 8;

/// Rows that are multiplied into the Gram matrix together, or those of one point where they are more. Points are ordered by
/// their normals, so that those of one block see the same few cells, and only these columns are multiplied.
const BLOCK: usize = 192;

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
    /// Whether the rows' diffuse part has been subtracted already, or there is none, so that nothing is left to eliminate.
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

    /// Calls `each` for every row of a point, with its number, what its view makes of a lobe, and the light of all cells there, for
    /// which `light` is the room.
    fn each_row(
        &self,
        lobes: &CellLobes<'_>,
        index: usize,
        light: &mut PointLobes,
        mut each: impl FnMut(usize, &ViewTerms, &PointLobes),
    ) {
        let point = &self.observations.points[index];
        for k in point.rows.clone() {
            let row = &self.observations.rows[k];
            let (normal, to_camera) = if let Some(placed) = row.placed {
                lobes.light(placed.position, placed.normal, self.seen.of(k), light);
                (placed.normal, placed.to_camera)
            } else {
                if k == point.rows.start {
                    lobes.light(point.position, point.normal, self.seen.of(index), light);
                }
                (point.normal, row.to_camera)
            };
            each(k, &lobes.brdf().view_terms(normal, to_camera), light);
        }
    }

    /// The lobes of each of the surface's parts.
    fn lobes(&self, brdf: &Brdf) -> Vec<CellLobes<'_>> {
        let whole = !self.shortcuts.takes(Shortcut::Lobes);
        let glosses = self.observations.glosses.iter();
        glosses
            .map(|&gloss| CellLobes::new(brdf, gloss, &self.geometry, self.near, whole))
            .collect()
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
                    vector::add(&mut sums, part.column(j));
                }
                sums
            })
            .collect();
        for part in parts {
            self.workspace.take_back(part.into_values());
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
        lobes: &[CellLobes<'_>],
        weights: &[f32],
        first: usize,
        last: usize,
    ) -> Lower {
        let width = self.cells() + 3;
        let mut gram = Lower::new(self.workspace.zeros(Lower::size(width)), width);
        let mut light = lobes[0].point();
        let (mut block, mut compact): (Vec<f32>, Vec<f32>) = (Vec::new(), Vec::new());
        for points in self.blocks(first, last) {
            if self.stop.load(Ordering::Relaxed) {
                break;
            }
            let rows = self.observations.rows_of(&points);
            block.resize(rows.len() * width, 0.0);
            let mut rest = block.as_mut_slice();
            for index in points.clone() {
                let lobes = &lobes[self.observations.points[index].gloss];
                let of_point = self.observations.points[index].rows.len() * width;
                let (own, others) = rest.split_at_mut(of_point);
                self.fill_point(lobes, index, &mut light, own);
                rest = others;
            }
            let columns = if self.shortcuts.takes(Shortcut::Lobes) {
                Columns::of(&block, width)
            } else {
                Columns::all(width)
            };
            let m = columns.count();
            let left_out = (width - m) * (block.len() / width);
            self.shortcuts.count(Shortcut::Lobes, block.len(), left_out);
            compact.clear();
            let mut rest = block.as_slice();
            for point in &self.observations.points[points] {
                let (own, others) = rest.split_at(point.rows.len() * width);
                let first = compact.len();
                columns.pick(own, &mut compact);
                let kept = self.eliminate(
                    &lobes[point.gloss].brdf(),
                    weights,
                    point,
                    &mut compact[first..],
                );
                compact.truncate(first + kept * m);
                rest = others;
            }
            gram.add_product(&compact, &columns);
        }
        gram
    }

    /// Cuts the points of a run into blocks.
    fn blocks(&self, first: usize, last: usize) -> Vec<Range<usize>> {
        let mut blocks = Vec::new();
        let mut start = first;
        for next in first + 1..=last {
            if next == last || self.observations.rows_of(&(start..next + 1)).len() > BLOCK {
                blocks.push(start..next);
                start = next;
            }
        }
        blocks
    }

    /// Scales each row of a point by √w and takes the diffuse colour out of them. Returns how many are left, the first ones.
    ///
    /// What the diffuse colour adds to them is along the vector √w t. A Householder reflection turns that onto the last row,
    /// which is left out; products of columns are the same as if it had been subtracted from each, of one row less.
    fn eliminate(&self, brdf: &Brdf, weights: &[f32], point: &Point, block: &mut [f32]) -> usize {
        let rows = &self.observations.rows[point.rows.clone()];
        let n = block.len() / rows.len().max(1);
        let scales: Vec<f32> = (weights[point.rows.clone()].iter())
            .map(|w| w.sqrt())
            .collect();
        if self.diffuse_known {
            for (row, scale) in block.chunks_exact_mut(n).zip(scales) {
                for value in row {
                    *value *= scale;
                }
            }
            return rows.len();
        }
        let mut reflector: Vec<f32> = (rows.iter().zip(&scales))
            .map(|(row, scale)| scale * row.diffuse_share(brdf))
            .collect();
        let length = reflector.iter().map(|a| a * a).sum::<f32>().sqrt();
        let Some(last) = reflector.last_mut().filter(|_| length > 0.0) else {
            return 0;
        };
        let half_square = length * (length + *last);
        *last += length;
        let mut along = vec![0.0_f32; n];
        for ((row, scale), v) in block.chunks_exact(n).zip(&scales).zip(&reflector) {
            vector::add_scaled(&mut along, v * scale / half_square, row);
        }
        let kept = rows.len() - 1;
        for ((row, scale), v) in block
            .chunks_exact_mut(n)
            .zip(scales)
            .zip(reflector)
            .take(kept)
        {
            vector::combine(row, scale, -v, &along);
        }
        kept
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
                let mut light = lobes[0].point();
                let mut value = vec![0.0_f32; n];
                for points in self.blocks(first, last) {
                    if self.stop.load(Ordering::Relaxed) {
                        break;
                    }
                    for index in points {
                        let lobes = &lobes[self.observations.points[index].gloss];
                        self.each_row(lobes, index, &mut light, |k, terms, light| {
                            lobes.row(terms, light, &mut value, None);
                            for (sum, z) in own.iter_mut().zip(values[k]).take(channels) {
                                vector::add_scaled(sum, weights[k] * z, &value);
                            }
                        });
                    }
                    for (sum, own) in sums.iter_mut().zip(&mut own).take(channels) {
                        vector::add(sum, own);
                        own.fill(0.0);
                    }
                }
                sums
            })
            .collect();
        let mut all = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        for part in &parts {
            for (sum, part) in all.iter_mut().zip(part) {
                vector::add(sum, part);
            }
        }
        if self.observations.gray {
            all = [all[0].clone(), all[0].clone(), all[0].clone()];
        }
        all
    }

    /// Writes one row of the matrix, and the three channels measured, per row of the point.
    fn fill_point(
        &self,
        lobes: &CellLobes<'_>,
        index: usize,
        light: &mut PointLobes,
        block: &mut [f32],
    ) {
        let mut rest = block.chunks_exact_mut(self.cells() + 3);
        self.each_row(lobes, index, light, |k, terms, light| {
            let Some(values) = rest.next() else { return };
            let (cells, measured) = values.split_at_mut(self.cells());
            lobes.row(terms, light, cells, None);
            measured.copy_from_slice(&self.observations.rows[k].radiance);
        });
    }

    /// What unit radiance of each cell shows in every row, row by row: the matrix of eq. 7.
    pub fn matrix(&self, brdf: &Brdf) -> Vec<f32> {
        let n = self.cells();
        if n == 0 {
            return Vec::new();
        }
        let lobes = self.lobes(brdf);
        let mut matrix = vec![0.0; self.observations.rows.len() * n];
        let mut rest = matrix.as_mut_slice();
        let blocks: Vec<_> = (self.blocks(0, self.observations.points.len()).into_iter())
            .map(|points| {
                let size = self.observations.rows_of(&points).len() * n;
                (points, rest.split_off_mut(..size).unwrap_or_default())
            })
            .collect();
        let room = || lobes[0].point();
        blocks
            .into_par_iter()
            .for_each_init(room, |light, (points, values)| {
                let mut rest = values.chunks_exact_mut(n);
                for index in points {
                    let lobes = &lobes[self.observations.points[index].gloss];
                    self.each_row(lobes, index, light, |_, terms, light| {
                        if let Some(row) = rest.next() {
                            lobes.row(terms, light, row, None);
                        }
                    });
                }
            });
        matrix
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
        let n = lit.len();
        let padded = n.next_multiple_of(vector::LANES);
        let channels = [0, 1, 2].map(|k| {
            let mut channel: Vec<f32> = lit.iter().map(|&c| radiance[c][k]).collect();
            channel.resize(padded, 0.0);
            channel
        });
        let gray = channels[0] == channels[1] && channels[0] == channels[2];
        let sum = |row: &[f32]| {
            if gray {
                [vector::dot(row, &channels[0]); 3]
            } else {
                channels.each_ref().map(|l| vector::dot(row, l))
            }
        };
        let rows = self.observations.rows.len();
        let mut values = vec![[0.0; 3]; rows];
        let mut derivatives = vec![[0.0; 3]; if derive { rows } else { 0 }];
        let (mut value_rest, mut rest) = (values.as_mut_slice(), derivatives.as_mut_slice());
        let blocks: Vec<_> = (self.blocks(0, self.observations.points.len()).into_iter())
            .map(|points| {
                let rows = self.observations.rows_of(&points).len();
                let values = value_rest.split_off_mut(..rows).unwrap_or_default();
                let derivatives = rest.split_off_mut(..rows).unwrap_or_default();
                (points, values, derivatives)
            })
            .collect();
        let room = || (lobes[0].point(), vec![0.0; padded], vec![0.0; padded]);
        blocks.into_par_iter().for_each_init(
            room,
            |(light, value, by_sigma), (points, values, derivatives)| {
                let mut k = 0;
                for index in points {
                    let lobes = &lobes[self.observations.points[index].gloss];
                    design.each_row(lobes, index, light, |_, terms, light| {
                        let derivative = derive.then_some(&mut by_sigma[..n]);
                        lobes.row(terms, light, &mut value[..n], derivative);
                        values[k] = sum(value);
                        if let Some(derivative) = derivatives.get_mut(k) {
                            *derivative = sum(by_sigma);
                        }
                        k += 1;
                    });
                }
            },
        );
        (values, derivatives)
    }
}
