//! The lobes of many cells at once, as vector code: one row of the matrix of eq. 7.
//!
//! What a lobe is made of is computed as rarely as it changes: per cell and roughness (its blur), per cell and point
//! (direction, cosine and masking of the light), and for each row only what the half vector decides.

use glam::Vec3;

use super::cells::CellGeometry;
use super::visibility::SeenFrom;
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel, ViewTerms};

/// A lobe is taken as zero below this share of its peak.
const CUTOFF: f32 = 1e-7;
/// Cells that are looked at together: none of a run is computed where all are outside their lobes.
const RUN: usize = 16;

/// The lobes of a set of cells at one roughness, one value per cell in each vector.
///
/// A lobe is blurred by the extent of its cell, as its mean over the cell: the Gaussian of variance σ² becomes wider and,
/// as its integral stays, lower.
pub struct CellLobes<'a> {
    brdf: Brdf,
    gloss: Gloss,
    geometry: &'a CellGeometry,
    /// Centre and radius of a finite hemisphere.
    near: Option<(Vec3, f32)>,
    /// Roughness of the blurred lobe, radians.
    sigma: Vec<f32>,
    /// 1/σ² of the blurred lobe.
    inverse_variance: Vec<f32>,
    /// Height of the blurred lobe over the sharp one's, σ²/σ_blurred².
    height: Vec<f32>,
    /// Squared cosine between half vector and normal below which every lobe is taken as zero.
    least_cos_squared: f32,
}

/// Light of every cell at one surface point, one value per cell in each vector.
pub struct PointLobes {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// n·l.
    cos_light: Vec<f32>,
    /// ω M (R/|p − x|)² × height × masking towards the light; zero where the light is behind the surface.
    strength: Vec<f32>,
    /// ∂ ln(masking towards the light)/∂σ.
    log_masking_by_sigma: Vec<f32>,
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

impl<'a> CellLobes<'a> {
    /// Lobes of a part with this gloss, where `brdf` is the main one, on these cells, cut where they have fallen to nothing unless they are to be `whole`.
    pub fn new(
        brdf: &Brdf,
        gloss: Gloss,
        geometry: &'a CellGeometry,
        near: Option<(Vec3, f32)>,
        whole: bool,
    ) -> Self {
        let brdf = brdf.at(gloss);
        let variance = brdf.sigma * brdf.sigma;
        let padding = padded(geometry.spread.len()) - geometry.spread.len();
        let inverse_variance: Vec<f32> = geometry
            .spread
            .iter()
            .chain(std::iter::repeat_n(&0.0, padding))
            .map(|spread| 1.0 / (variance + spread))
            .collect();
        let sigma: Vec<f32> = inverse_variance.iter().map(|i| 1.0 / i.sqrt()).collect();
        let widest = Brdf {
            sigma: sigma.iter().fold(brdf.sigma, |m, &s| m.max(s)),
            ..brdf
        };
        let support = if whole {
            std::f32::consts::FRAC_PI_2
        } else {
            widest.half_angle_support(CUTOFF)
        };
        Self {
            brdf,
            gloss,
            geometry,
            near,
            least_cos_squared: support.min(std::f32::consts::FRAC_PI_2).cos().powi(2),
            sigma,
            height: inverse_variance.iter().map(|i| variance * i).collect(),
            inverse_variance,
        }
    }

    /// The sharp lobe.
    pub fn brdf(&self) -> Brdf {
        self.brdf
    }

    /// Room for the light at a point.
    pub fn point(&self) -> PointLobes {
        let mut directions = self.geometry.directions.clone();
        directions.resize(self.sigma.len(), Vec3::ZERO);
        let zeros = vec![0.0; directions.len()];
        PointLobes {
            x: directions.iter().map(|d| d.x).collect(),
            y: directions.iter().map(|d| d.y).collect(),
            z: directions.iter().map(|d| d.z).collect(),
            cos_light: zeros.clone(),
            strength: zeros.clone(),
            log_masking_by_sigma: zeros,
        }
    }

    /// Computes the light at `position` with the unit `normal`; `seen` holds the seen share of each cell, and everything is
    /// seen without it. `out` is of [`CellLobes::point`], used with these lobes alone.
    pub fn light(
        &self,
        position: Vec3,
        normal: Vec3,
        seen: Option<SeenFrom<'_>>,
        out: &mut PointLobes,
    ) {
        let peak = self.gloss.height();
        let solid_angles = &self.geometry.solid_angles;
        let strength = &mut out.strength[..solid_angles.len()];
        match seen {
            Some(seen) => {
                for ((s, w), m) in strength.iter_mut().zip(solid_angles).zip(seen.shares()) {
                    *s = peak * w * m;
                }
            }
            None => {
                for (s, w) in strength.iter_mut().zip(solid_angles) {
                    *s = peak * w;
                }
            }
        }
        if self.near.is_some() {
            let directions = self.geometry.directions.iter();
            for (c, (&direction, strength)) in directions.zip(strength).enumerate() {
                let (l, fall_off) = light_from(self.near, direction, position);
                (out.x[c], out.y[c], out.z[c]) = l.into();
                *strength *= fall_off;
            }
        }
        let arch = pulp::Arch::new();
        match self.brdf.model {
            SpecularModel::Paper => arch.dispatch(LightKernel::<PAPER> {
                lobes: self,
                normal,
                out,
            }),
            SpecularModel::Beckmann => arch.dispatch(LightKernel::<BECKMANN> {
                lobes: self,
                normal,
                out,
            }),
            SpecularModel::Ggx => arch.dispatch(LightKernel::<GGX> {
                lobes: self,
                normal,
                out,
            }),
            SpecularModel::Metal => arch.dispatch(LightKernel::<METAL> {
                lobes: self,
                normal,
                out,
            }),
        }
    }

    /// Writes strength × lobe of each cell towards the viewer of `terms` into `value`, and its derivative by σ into
    /// `by_sigma` if that is wanted. `light` is the light at the same point.
    pub fn row(
        &self,
        terms: &ViewTerms,
        light: &PointLobes,
        value: &mut [f32],
        by_sigma: Option<&mut [f32]>,
    ) {
        let arch = pulp::Arch::new();
        match self.brdf.model {
            SpecularModel::Paper => arch.dispatch(RowKernel::<PAPER> {
                lobes: self,
                terms,
                light,
                value,
                by_sigma,
            }),
            SpecularModel::Beckmann => arch.dispatch(RowKernel::<BECKMANN> {
                lobes: self,
                terms,
                light,
                value,
                by_sigma,
            }),
            SpecularModel::Ggx => arch.dispatch(RowKernel::<GGX> {
                lobes: self,
                terms,
                light,
                value,
                by_sigma,
            }),
            SpecularModel::Metal => arch.dispatch(RowKernel::<METAL> {
                lobes: self,
                terms,
                light,
                value,
                by_sigma,
            }),
        }
    }
}

/// The model is a constant of each kernel, so that its loops are free of branches and become vector code of the widest
/// kind that the processor has.
const PAPER: u8 = 0;
const BECKMANN: u8 = 1;
const GGX: u8 = 2;
const METAL: u8 = 3;

const fn model<const MODEL: u8>() -> SpecularModel {
    match MODEL {
        PAPER => SpecularModel::Paper,
        BECKMANN => SpecularModel::Beckmann,
        GGX => SpecularModel::Ggx,
        _ => SpecularModel::Metal,
    }
}

struct LightKernel<'a, const MODEL: u8> {
    lobes: &'a CellLobes<'a>,
    normal: Vec3,
    out: &'a mut PointLobes,
}

impl<const MODEL: u8> pulp::WithSimd for LightKernel<'_, MODEL> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let n = self.out.x.len();
        let (x, y, z) = (&self.out.x[..n], &self.out.y[..n], &self.out.z[..n]);
        let (sigma, height) = (&self.lobes.sigma[..n], &self.lobes.height[..n]);
        let cos_light = &mut self.out.cos_light[..n];
        let strength = &mut self.out.strength[..n];
        let log_masking_by_sigma = &mut self.out.log_masking_by_sigma[..n];
        for c in 0..n {
            let cos = self.normal.dot(Vec3::new(x[c], y[c], z[c]));
            let masking = const { model::<MODEL>() }.masking(cos, sigma[c]);
            cos_light[c] = cos;
            let lit = strength[c] * height[c] * masking.value;
            strength[c] = if cos > 0.0 { lit } else { 0.0 };
            log_masking_by_sigma[c] = masking.by_sigma / masking.value;
        }
    }
}

struct RowKernel<'a, const MODEL: u8> {
    lobes: &'a CellLobes<'a>,
    terms: &'a ViewTerms,
    light: &'a PointLobes,
    value: &'a mut [f32],
    by_sigma: Option<&'a mut [f32]>,
}

impl<const MODEL: u8> pulp::WithSimd for RowKernel<'_, MODEL> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let (whole, rest) = self.value.as_chunks_mut::<RUN>();
        let rest_at = whole.len() * RUN;
        let (mut derivatives, derivatives_rest) = match self.by_sigma {
            Some(by_sigma) => {
                let (whole, rest) = by_sigma.as_chunks_mut::<RUN>();
                (Some(whole), Some(rest))
            }
            None => (None, None),
        };
        let run = |first| Run::new(self.lobes, self.terms, self.light, first);
        for (k, value) in whole.iter_mut().enumerate() {
            let by_sigma = derivatives.as_deref_mut().map(|d| &mut d[k]);
            run(k * RUN).write::<MODEL>(value, by_sigma);
        }
        if !rest.is_empty() {
            let (mut value, mut by_sigma) = ([0.0; RUN], [0.0; RUN]);
            let wanted = derivatives_rest.is_some().then_some(&mut by_sigma);
            run(rest_at).write::<MODEL>(&mut value, wanted);
            rest.copy_from_slice(&value[..rest.len()]);
            if let Some(derivatives) = derivatives_rest {
                derivatives.copy_from_slice(&by_sigma[..derivatives.len()]);
            }
        }
    }
}

/// A number of cells that is whole runs.
fn padded(cells: usize) -> usize {
    cells.next_multiple_of(RUN)
}

/// The run of cells of some vector that begins at `first`.
#[inline(always)]
fn run(of: &[f32], first: usize) -> &[f32; RUN] {
    of[first..]
        .first_chunk()
        .expect("vectors are padded to whole runs")
}

/// A run of neighbouring cells in a row: arrays of known length, for which compilers write vector code.
struct Run<'a> {
    lobes: &'a CellLobes<'a>,
    terms: &'a ViewTerms,
    first: usize,
    light: &'a PointLobes,
    x: &'a [f32; RUN],
    y: &'a [f32; RUN],
    z: &'a [f32; RUN],
    cos_light: &'a [f32; RUN],
    strength: &'a [f32; RUN],
    inverse_variance: &'a [f32; RUN],
}

impl<'a> Run<'a> {
    #[inline(always)]
    fn new(
        lobes: &'a CellLobes<'_>,
        terms: &'a ViewTerms,
        light: &'a PointLobes,
        first: usize,
    ) -> Self {
        Self {
            lobes,
            terms,
            first,
            light,
            x: run(&light.x, first),
            y: run(&light.y, first),
            z: run(&light.z, first),
            cos_light: run(&light.cos_light, first),
            strength: run(&light.strength, first),
            inverse_variance: run(&lobes.inverse_variance, first),
        }
    }

    #[inline(always)]
    fn direction(&self, c: usize) -> Vec3 {
        Vec3::new(self.x[c], self.y[c], self.z[c])
    }

    /// Whether the half vector of any of the cells is near enough to the normal.
    #[inline(always)]
    fn is_in_lobe(&self) -> bool {
        let least = self.lobes.least_cos_squared;
        let mut inside = [0_u32; RUN];
        for (c, inside) in inside.iter_mut().enumerate() {
            let (sum, squared) = self.terms.half(self.direction(c), self.cos_light[c]);
            let near = sum * sum >= least * squared;
            *inside = u32::from(near) & u32::from(self.cos_light[c] > 0.0);
        }
        inside.iter().fold(0, |any, i| any | i) != 0
    }

    /// Writes the values and, if they are wanted, their derivatives by σ.
    #[inline(always)]
    fn write<const MODEL: u8>(&self, value: &mut [f32; RUN], by_sigma: Option<&mut [f32; RUN]>) {
        let is_in_lobe = self.is_in_lobe();
        match by_sigma {
            None if is_in_lobe => *value = self.values::<MODEL>(),
            Some(by_sigma) if is_in_lobe => {
                (*value, *by_sigma) = self.derivatives::<MODEL>();
            }
            by_sigma => {
                *value = [0.0; RUN];
                if let Some(by_sigma) = by_sigma {
                    *by_sigma = [0.0; RUN];
                }
            }
        }
    }

    #[inline(always)]
    fn values<const MODEL: u8>(&self) -> [f32; RUN] {
        let model = const { model::<MODEL>() };
        let mut value = [0.0; RUN];
        for (c, value) in value.iter_mut().enumerate() {
            let facets = self
                .terms
                .facets(model, self.direction(c), self.cos_light[c]);
            let density = facets.density(model, self.inverse_variance[c]);
            *value = self.strength[c] * self.terms.scale() * density.value;
        }
        value
    }

    /// The values with their derivatives by σ.
    #[inline(always)]
    fn derivatives<const MODEL: u8>(&self) -> ([f32; RUN], [f32; RUN]) {
        let model = const { model::<MODEL>() };
        let log_masking_by_sigma = run(&self.light.log_masking_by_sigma, self.first);
        let height = run(&self.lobes.height, self.first);
        let sigma = self.lobes.brdf.sigma;
        // By the main σ, of which this one is a multiple.
        let by_main = self.lobes.gloss.roughness;
        let (mut value, mut by_sigma) = ([0.0; RUN], [0.0; RUN]);
        for c in 0..RUN {
            let facets = self
                .terms
                .facets(model, self.direction(c), self.cos_light[c]);
            let inverse = self.inverse_variance[c];
            let density = facets.density(model, inverse);
            value[c] = self.strength[c] * self.terms.scale() * density.value;
            // d ln(1/σ_blurred²)/dσ = −2σ/σ_blurred²; dσ_blurred/dσ = σ/σ_blurred = √height; d ln(height)/dσ = 2 (1 − height)/σ.
            let log_derivative = 2.0 * sigma * inverse * density.log_by_inverse_variance
                + height[c].sqrt() * log_masking_by_sigma[c]
                + self.terms.log_scale_by_sigma()
                + 2.0 / sigma * (1.0 - height[c]);
            by_sigma[c] = value[c] * log_derivative * by_main;
        }
        (value, by_sigma)
    }
}
