//! What a lobe of specular reflection looks like.
//!
//! All models are the Torrance-Sparrow form `K_S F G / cos θ_r · L_i · D(α)` (eq. 3), with K_S = 1 absorbed into
//! the light and D(0) = F(normal incidence) = 1, so that lights mean the same in all:
//!
//! * [`SpecularModel::Paper`] (eq. 4): F and G constant, `D = exp(−α²/2σ²)`;
//! * [`SpecularModel::Beckmann`]: dielectric Fresnel factor, Smith's masking for Beckmann slopes and
//!   `D = exp(−tan²α/2σ²)/cos⁴α`, as of Walter et al., "Microfacet Models for Refraction through Rough Surfaces"
//!   (2007); a Beckmann slope width of √2 σ. The diffuse part loses what the surface reflects;
//! * [`SpecularModel::Ggx`]: the same with `D = (1 + tan²α/2σ²)⁻²/cos⁴α` and its own masking (ibid.): GGX, or
//!   Trowbridge-Reitz, of the width α = √2 σ, whose tails are long;
//! * [`SpecularModel::Metal`]: GGX with a constant Fresnel factor, as metals reflect much at all angles.
//!
//! α is the angle between the normal and the half vector, in radians. The cosine of the incident angle is inside
//! the lobe (it has cancelled), the light's solid angle is not.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use rekindle_base::math::exp::exp_negative;

/// Index of refraction taken for every dielectric. F(θ)/F(0) hardly depends on it between 1.4 and 1.6.
const REFRACTIVE_INDEX: f32 = 1.5;

/// Reflectance of metals at normal incidence, in the mean over channels: gold's is 0.5, iron's 0.55.
const USUAL_METAL: f32 = 0.5;

/// Below this cosine between normal and view the lobe's 1/cos θ_r is held constant: eq. 4 has a pole there.
pub const MIN_COS_VIEW: f32 = 1e-3;

/// Which form of eq. 3 a surface follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SpecularModel {
    /// Eq. 4: Fresnel and masking constant.
    Paper,
    /// Dielectric Fresnel factor, Beckmann's slopes and Smith masking.
    #[serde(alias = "microfacet")]
    Beckmann,
    /// Dielectric Fresnel factor, GGX's slopes and Smith masking.
    Ggx,
    /// A metal: GGX's slopes and masking, Fresnel factor constant.
    Metal,
}

/// A specular model with its roughness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brdf {
    /// The lobe's form.
    pub model: SpecularModel,
    /// Roughness σ: standard deviation of the facets' tilt, radians.
    pub sigma: f32,
    /// What it reflects specularly, as a multiple of what the object's main lobe does; 1 for that, and where a known light tells how
    /// much that reflects, as a multiple of what such surfaces usually do. Lobes have the peak 1 whatever it is, see
    /// [`Gloss::height`]; what they take from the diffuse part depends on it.
    pub strength: f32,
}

/// How the lobe of a part of the surface differs from the object's main one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gloss {
    /// Roughness as a multiple of the main one, positive.
    pub roughness: f32,
    /// Specularly reflected part of uniform light at normal incidence, as a multiple of the main lobe's; none where it is 0.
    pub strength: f32,
    /// Colour of what it reflects beside the main lobe, RGB of mean 1: a metal's beside a dielectric.
    #[serde(default = "Gloss::white", skip_serializing_if = "Gloss::is_white")]
    pub tint: [f32; 3],
}

impl Gloss {
    /// The main lobe's own.
    pub const MAIN: Self = Self {
        roughness: 1.0,
        strength: 1.0,
        tint: [1.0; 3],
    };

    /// A gloss without a colour of its own.
    pub const fn new(roughness: f32, strength: f32) -> Self {
        Self {
            roughness,
            strength,
            tint: [1.0; 3],
        }
    }

    /// The same lobe that reflects so much of each channel, as a multiple of what the main one does.
    #[must_use]
    pub fn reflecting(self, scale: Vec3) -> Self {
        if scale == Vec3::splat(scale.x) {
            return Self::new(self.roughness, scale.x);
        }
        let strength = scale.element_sum() / 3.0;
        Self {
            strength,
            tint: (scale / strength).to_array(),
            ..self
        }
    }

    /// The same where another one becomes the main one.
    #[must_use]
    pub fn beside(self, main: Self) -> Self {
        let colour = Vec3::from(self.tint) / Vec3::from(main.tint);
        let mean = colour.element_sum() / 3.0;
        Self {
            roughness: self.roughness / main.roughness,
            strength: self.strength / main.strength * mean,
            tint: (colour / mean).to_array(),
        }
    }

    /// The strength in each channel.
    pub fn scale(self) -> Vec3 {
        self.strength * Vec3::from(self.tint)
    }

    /// Weighted mean of some: of the strengths in each channel, and of the roughnesses' logarithms weighted by strength too.
    pub fn mean(glosses: impl IntoIterator<Item = (Self, f32)>) -> Self {
        let (mut weights, mut strength, mut log_roughness) = (0.0, 0.0, 0.0);
        let mut scale = Vec3::ZERO;
        for (gloss, weight) in glosses {
            weights += weight;
            strength += weight * gloss.strength;
            scale += weight * gloss.scale();
            log_roughness += weight * gloss.strength * gloss.roughness.ln();
        }
        if weights <= 0.0 {
            return Self::MAIN;
        }
        if strength <= 0.0 {
            return Self::new(1.0, 0.0);
        }
        Self {
            roughness: (log_roughness / strength).exp(),
            strength: strength / weights,
            tint: (scale / strength).to_array(),
        }
    }

    /// How far two glosses are apart: by the logarithms of roughness, as far as both reflect, and by strength.
    pub fn difference(self, other: Self) -> f32 {
        let [least, most] = [
            self.strength.min(other.strength),
            self.strength.max(other.strength),
        ];
        if most <= 0.0 {
            return 0.0;
        }
        let alike = least / most;
        alike * (self.roughness / other.roughness).ln().abs() + (1.0 - alike)
    }

    /// Which of some it is or comes nearest to.
    pub fn nearest(self, others: &[Self]) -> usize {
        let apart = |k: usize| self.difference(others[k]);
        let nearest = (0..others.len()).min_by(|&a, &b| apart(a).total_cmp(&apart(b)));
        nearest.unwrap_or(0)
    }

    /// Peak of the lobe as a multiple of the main one's, the mean of the channels: a lobe of the same strength is lower the wider it is.
    #[inline(always)]
    pub fn height(self) -> f32 {
        self.strength / (self.roughness * self.roughness)
    }

    /// The same in each channel.
    #[inline(always)]
    pub fn peak(self) -> Vec3 {
        self.height() * Vec3::from(self.tint)
    }

    /// Whether a tint is none.
    pub fn is_white(tint: &[f32; 3]) -> bool {
        *tint == Self::white()
    }

    const fn white() -> [f32; 3] {
        [1.0; 3]
    }
}

/// A lobe's value and its derivative by σ.
#[derive(Clone, Copy, Debug, Default)]
pub struct LobeValue {
    /// Specular radiance per unit of radiance × solid angle.
    pub value: f32,
    /// ∂value/∂σ.
    pub by_sigma: f32,
}

/// What of a lobe depends on surface and view only, so that it is computed once per row.
#[derive(Clone, Copy, Debug)]
pub struct ViewTerms {
    normal: Vec3,
    view: Vec3,
    /// n·v.
    cos_normal: f32,
    cos_view: f32,
    /// See [`Brdf::rise`].
    rise: f32,
    /// Masking towards the viewer over cos θ_r.
    scale: f32,
    /// ∂ ln(scale)/∂σ.
    log_scale_by_sigma: f32,
}

impl Brdf {
    /// A main lobe.
    pub const fn new(model: SpecularModel, sigma: f32) -> Self {
        Self {
            model,
            sigma,
            strength: 1.0,
        }
    }

    /// The same lobe of a surface that reflects so much at normal incidence, F₀.
    #[must_use]
    pub fn with_reflectance(self, reflectance: f32) -> Self {
        Self {
            strength: reflectance / self.model.usual_reflectance(),
            ..self
        }
    }

    /// What other programs call roughness: the root of the slopes' width α = √2 σ, at most 1; 1 where nothing is reflected.
    pub fn roughness(&self) -> f32 {
        if self.strength > 0.0 {
            (std::f32::consts::SQRT_2 * self.sigma).min(1.0).sqrt()
        } else {
            1.0
        }
    }

    /// σ of a roughness as other programs call it, radians.
    pub fn sigma_of(roughness: f32) -> f32 {
        roughness * roughness * std::f32::consts::FRAC_1_SQRT_2
    }

    /// The lobe of a part with another gloss, where this is the main one.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, gloss: Gloss) -> Self {
        Self {
            model: self.model,
            sigma: self.sigma * gloss.roughness,
            strength: self.strength * gloss.strength,
        }
    }

    /// Whether it is a metal's, which has no diffuse part to speak of: it reflects more than a dielectric can.
    pub fn is_metal(&self) -> bool {
        self.model == SpecularModel::Metal
            || self.model.is_dielectric() && self.strength > MOST_OF_DIELECTRIC
    }

    /// Whether a part's lobe is a metal's where this, the main one, is not.
    pub fn has_metal_beside(&self, part: &Self) -> bool {
        !self.is_metal() && part.is_metal()
    }

    /// The terms of a lobe seen from the unit direction `view` on a surface with the unit `normal`.
    pub fn view_terms(&self, normal: Vec3, view: Vec3) -> ViewTerms {
        let cos_normal = normal.dot(view);
        let cos_view = cos_normal.max(MIN_COS_VIEW);
        let masking = self.model.masking(cos_view, self.sigma);
        ViewTerms {
            normal,
            view,
            cos_normal,
            cos_view,
            rise: self.rise(),
            scale: masking.value / cos_view,
            log_scale_by_sigma: masking.by_sigma / masking.value,
        }
    }

    /// How much the Fresnel factor rises towards grazing angles, as a part of what a usual dielectric's does: whatever is reflected at
    /// normal incidence, all is at the last, so the factor, which is 1 there, rises by (1 − F₀)/F₀ of a metal beside dielectrics.
    #[inline(always)]
    pub fn rise(&self) -> f32 {
        if !self.model.is_dielectric() || !self.is_metal() {
            return 1.0;
        }
        let reflected = (self.strength * NORMAL_FRESNEL).min(1.0);
        (1.0 - reflected) / reflected * (NORMAL_FRESNEL / (1.0 - NORMAL_FRESNEL))
    }

    /// Fresnel factor at the cosine `cos` of incidence on facets, 1 at normal incidence.
    #[inline(always)]
    fn fresnel_factor(&self, cos: f32) -> f32 {
        risen(self.rise(), fresnel(cos) * INVERSE_NORMAL_FRESNEL)
    }

    /// The lobe for light from the unit direction `light`: zero where the light is behind the surface.
    #[inline(always)]
    pub fn lobe(&self, terms: &ViewTerms, light: Vec3) -> f32 {
        self.lobe_with_derivative(terms, light).value
    }

    /// The lobe and its derivative by σ.
    #[inline(always)]
    pub fn lobe_with_derivative(&self, terms: &ViewTerms, light: Vec3) -> LobeValue {
        let cos_light = terms.normal.dot(light);
        let facets = terms.facets(self.model, light, cos_light);
        let masking = self.model.masking(cos_light, self.sigma);
        let variance = self.sigma * self.sigma;
        let lit = if cos_light > 0.0 { terms.scale } else { 0.0 };
        let density = facets.density(self.model, 1.0 / variance);
        let value = lit * masking.value * density.value;
        let log_derivative = 2.0 * density.log_by_inverse_variance / self.sigma
            + masking.by_sigma / masking.value
            + terms.log_scale_by_sigma;
        LobeValue {
            value,
            by_sigma: value * log_derivative,
        }
    }

    /// How much of the light for the diffuse part passes the surface at the cosine `cos` of incidence, as a ratio to normal
    /// incidence: (1 − F(cos))/(1 − F(1)) for Beckmann, as in Mitsuba's rough plastic; else 1.
    #[inline(always)]
    pub fn diffuse_entry(&self, cos: f32) -> f32 {
        match self.model {
            SpecularModel::Paper | SpecularModel::Ggx | SpecularModel::Metal => 1.0,
            SpecularModel::Beckmann => smooth_transmittance(cos, self.strength),
        }
    }

    /// How much of the diffusely reflected light passes the surface towards a viewer at the cosine `cos`, as a ratio to
    /// normal exitance: 1 in the paper's model, (1 − F(cos))/(1 − F(1)) for Beckmann, as in Mitsuba's rough plastic, and
    /// (1 − E(cos))/(1 − E(1)) for GGX, E being what the lobe reflects, as in the Principled surface of Blender and others.
    #[inline(always)]
    pub fn diffuse_exit(&self, cos: f32) -> f32 {
        match self.model {
            SpecularModel::Paper | SpecularModel::Metal => 1.0,
            SpecularModel::Beckmann => smooth_transmittance(cos, self.strength),
            SpecularModel::Ggx => {
                let passed = |cos| 1.0 - self.strength.min(1.0) * ggx_reflectance(cos, self.sigma);
                passed(cos) / passed(1.0)
            }
        }
    }

    /// `K_S` of eq. 4, by which estimated lights are larger than real ones: F(normal incidence)/(8πσ²) in the microfacet
    /// models, whose lobes are normalised, a metal taken for a usual one; the paper's model leaves it open.
    pub fn specular_scale(&self) -> Option<f32> {
        match self.model {
            SpecularModel::Paper => None,
            SpecularModel::Beckmann | SpecularModel::Ggx | SpecularModel::Metal => {
                Some(self.usual_specular_scale())
            }
        }
    }

    /// What a surface that lights are known times this scale of, `K_S` of each channel, reflects at normal incidence over what this
    /// lobe does: a metal's colour, held to what no surface exceeds.
    pub fn tint(&self, specular_scale: Vec3) -> Vec3 {
        if self.model != SpecularModel::Metal {
            return Vec3::ONE;
        }
        let most = (self.strength * USUAL_METAL).max(f32::MIN_POSITIVE).recip();
        (specular_scale / self.usual_specular_scale()).clamp(Vec3::ZERO, Vec3::splat(most))
    }

    /// The same taken for any model: K_S of a surface that reflects as much at normal incidence as plastic and varnish do, 4 %,
    /// or as metals do, one half.
    pub fn usual_specular_scale(&self) -> f32 {
        self.strength * self.model.usual_reflectance()
            / (8.0 * std::f32::consts::PI * self.sigma * self.sigma)
    }

    /// Part of the light from a direction at the cosine `cos_light` that facets seen at the cosine `cos_between` (of
    /// l and h) pass on: F G₁ in absolute terms. Nothing where the paper's model leaves its scale open.
    pub fn facet_reflectance(&self, cos_light: f32, cos_between: f32) -> f32 {
        if cos_light <= 0.0 {
            return 0.0;
        }
        let fresnel_factor = match self.model {
            SpecularModel::Paper => return 0.0,
            SpecularModel::Beckmann | SpecularModel::Ggx => {
                self.fresnel_factor(cos_between) * NORMAL_FRESNEL
            }
            SpecularModel::Metal => USUAL_METAL,
        };
        let masking = self.model.masking(cos_light, self.sigma).value;
        (self.strength * fresnel_factor).min(1.0) * masking
    }

    /// tan α that a part `u` of the facets, by the area that they project, stay below.
    pub fn facet_slope(&self, u: f32) -> f32 {
        let slope_squared = match self.model {
            // tan²α is exponential with the mean 2σ².
            SpecularModel::Paper | SpecularModel::Beckmann => -(1.0 - u).ln(),
            SpecularModel::Ggx | SpecularModel::Metal => u / (1.0 - u),
        };
        self.sigma * (2.0 * slope_squared).sqrt()
    }

    /// What the lobe is of uniform light of radiance 1 as far as facets whose slopes [`Self::facet_slope`] draws mirror it to a
    /// viewer at the cosine `cos_view`, but for [`Self::drawn_reflectance`], of which it is multiplied by the mean weighted by
    /// (v·h)/(n·h).
    pub fn drawn_scale(&self, cos_view: f32) -> f32 {
        let masking_of_drawn = match self.model {
            SpecularModel::Paper => masking(cos_view.max(MIN_COS_VIEW), self.sigma).value,
            SpecularModel::Beckmann | SpecularModel::Ggx | SpecularModel::Metal => 1.0,
        };
        8.0 * std::f32::consts::PI * self.sigma * self.sigma / masking_of_drawn
    }

    /// F G₁ of a facet of the slope `tan` towards light at the cosine `cos_light`, with `cos_between` that of l and h, F being 1 at
    /// normal incidence; in the paper's model how much more such facets count than they are drawn.
    #[inline(always)]
    pub fn drawn_reflectance(&self, tan: f32, cos_light: f32, cos_between: f32) -> f32 {
        if cos_light <= 0.0 {
            return 0.0;
        }
        let masking = self.model.masking(cos_light, self.sigma).value;
        match self.model {
            SpecularModel::Paper => {
                let (squared, angle) = (tan * tan, tan.atan());
                let cos_squared = 1.0 / (1.0 + squared);
                let exponent = (squared - angle * angle) / (2.0 * self.sigma * self.sigma);
                exponent.exp() * cos_squared * cos_squared
            }
            SpecularModel::Metal => masking,
            SpecularModel::Beckmann | SpecularModel::Ggx => {
                self.fresnel_factor(cos_between) * masking
            }
        }
    }

    /// Solid angle of half vectors, sr, that one of so many stands for, of those of which a part `u` of all facets lies nearer to the
    /// normal; its slope is `tan`.
    #[inline(always)]
    pub fn drawn_solid_angle(&self, u: f32, tan: f32, count: usize) -> f32 {
        // 1/(count · p), p = D cos α/2πσ².
        let left = 1.0 - u;
        let density = match self.model {
            SpecularModel::Paper | SpecularModel::Beckmann => left,
            SpecularModel::Ggx | SpecularModel::Metal => left * left,
        };
        let cos_squared = 1.0 / (1.0 + tan * tan);
        let all = std::f32::consts::TAU * self.sigma * self.sigma;
        all * cos_squared * cos_squared.sqrt() / (density * count as f32)
    }

    /// Angle α beyond which D(α) is below `cutoff` of its peak, in radians.
    pub fn half_angle_support(&self, cutoff: f32) -> f32 {
        let reach = self.sigma * (-2.0 * cutoff.ln()).max(0.0).sqrt();
        match self.model {
            SpecularModel::Paper => reach.min(std::f32::consts::FRAC_PI_2),
            // exp(−t²/2σ²)/cos⁴ = exp(−t²/2σ² + 2 ln(1 + t²)): two steps of fixed-point iteration in t = tan α.
            SpecularModel::Beckmann => {
                let mut tan = reach;
                for _ in 0..4 {
                    let grown = 4.0 * self.sigma * self.sigma * (1.0 + tan * tan).ln();
                    tan = (reach * reach + grown).sqrt();
                }
                tan.atan()
            }
            // (1 + t²)/(1 + t²/2σ²) is the root of the share.
            SpecularModel::Ggx | SpecularModel::Metal => {
                let root = cutoff.max(0.0).sqrt();
                let fall = root / (2.0 * self.sigma * self.sigma) - 1.0;
                if fall > 0.0 {
                    ((1.0 - root).max(0.0) / fall).sqrt().atan()
                } else {
                    std::f32::consts::FRAC_PI_2
                }
            }
        }
    }
}

/// What of a lobe the half vector decides.
#[derive(Clone, Copy, Debug)]
pub struct Facets {
    /// α² in the paper's model, tan²α in the microfacet models.
    pub slope_squared: f32,
    /// Fresnel factor, 1 at normal incidence, over cos⁴α; 1 in the paper's model.
    pub factor: f32,
}

/// The density of the facets.
#[derive(Clone, Copy, Debug)]
pub struct Density {
    /// Its value.
    pub value: f32,
    /// −∂ ln(value)/∂ ln(1/σ²), which is slope²/2σ² for a Gaussian.
    pub log_by_inverse_variance: f32,
}

impl Facets {
    /// Factor × exp(−slope²/2σ²), or factor × (1 + slope²/2σ²)⁻² for GGX, given 1/σ².
    #[inline(always)]
    pub fn density(&self, model: SpecularModel, inverse_variance: f32) -> Density {
        let exponent = 0.5 * self.slope_squared * inverse_variance;
        match model {
            SpecularModel::Paper | SpecularModel::Beckmann => Density {
                value: self.factor * exp_negative(-exponent),
                log_by_inverse_variance: exponent,
            },
            SpecularModel::Ggx | SpecularModel::Metal => {
                let inverse = 1.0 / (1.0 + exponent);
                Density {
                    value: self.factor * inverse * inverse,
                    log_by_inverse_variance: 2.0 * exponent * inverse,
                }
            }
        }
    }
}

impl ViewTerms {
    /// Cosine between normal and view, at least [`MIN_COS_VIEW`].
    #[inline(always)]
    pub fn cos_view(&self) -> f32 {
        self.cos_view
    }

    /// Masking towards the viewer over cos θ_r.
    #[inline(always)]
    pub fn scale(&self) -> f32 {
        self.scale
    }

    /// ∂ ln(scale)/∂σ.
    #[inline(always)]
    pub fn log_scale_by_sigma(&self) -> f32 {
        self.log_scale_by_sigma
    }

    /// n·(l + v) and |l + v|² for light from the unit direction `light`; `cos_light` is n·l.
    #[inline(always)]
    pub fn half(&self, light: Vec3, cos_light: f32) -> (f32, f32) {
        // |l + v|² = 2 + 2 l·v.
        let squared = (2.0 + 2.0 * light.dot(self.view)).max(1e-12);
        (cos_light + self.cos_normal, squared)
    }

    /// The facets that mirror light from the unit direction `light` to the viewer; `cos_light` is n·l.
    #[inline(always)]
    pub fn facets(&self, model: SpecularModel, light: Vec3, cos_light: f32) -> Facets {
        let (sum, squared) = self.half(light, cos_light);
        // n·h = n·(l + v)/|l + v|, l·h = |l + v|/2.
        let length = squared.sqrt();
        let cos_half = (sum / length).clamp(1e-3, 1.0);
        match model {
            SpecularModel::Paper => Facets {
                slope_squared: squared_arccos(cos_half),
                factor: 1.0,
            },
            SpecularModel::Beckmann | SpecularModel::Ggx | SpecularModel::Metal => {
                let inverse_cos_squared = 1.0 / (cos_half * cos_half);
                let fresnel = match model {
                    SpecularModel::Metal => 1.0,
                    _ => risen(self.rise, fresnel(0.5 * length) * INVERSE_NORMAL_FRESNEL),
                };
                Facets {
                    slope_squared: (1.0 - cos_half * cos_half) * inverse_cos_squared,
                    factor: fresnel * inverse_cos_squared * inverse_cos_squared,
                }
            }
        }
    }
}

impl SpecularModel {
    /// All of them, the simplest first.
    pub const ALL: [Self; 4] = [Self::Paper, Self::Beckmann, Self::Ggx, Self::Metal];

    /// The number by which shaders know the model of a surface, or that it has none.
    pub fn shader_number(model: Option<Self>) -> u32 {
        match model {
            Some(Self::Paper) => 0,
            Some(Self::Beckmann) => 1,
            Some(Self::Ggx) => 2,
            Some(Self::Metal) => 3,
            None => 4,
        }
    }

    /// Its name in the field.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "Gaussian",
            Self::Beckmann => "Beckmann",
            Self::Ggx => "GGX",
            Self::Metal => "Metal",
        }
    }

    /// What such surfaces usually reflect at normal incidence, F₀.
    fn usual_reflectance(self) -> f32 {
        match self {
            Self::Metal => USUAL_METAL,
            _ => NORMAL_FRESNEL,
        }
    }

    /// Whether it is a dielectric's: says how much is reflected in absolute terms, and what passes the surface.
    pub fn is_dielectric(self) -> bool {
        matches!(self, Self::Beckmann | Self::Ggx)
    }

    /// Masking towards a direction at the cosine `cos`, with its derivative by σ.
    #[inline(always)]
    pub fn masking(self, cos: f32, sigma: f32) -> LobeValue {
        match self {
            Self::Paper => LobeValue {
                value: 1.0,
                by_sigma: 0.0,
            },
            Self::Beckmann => masking(cos.max(1e-4), sigma),
            Self::Ggx | Self::Metal => ggx_masking(cos.max(1e-4), sigma),
        }
    }
}

const NORMAL_FRESNEL: f32 = {
    let r = (REFRACTIVE_INDEX - 1.0) / (REFRACTIVE_INDEX + 1.0);
    r * r
};
/// How many times as much as a usual dielectric one reflects at most, or any beside another: F₀ lies between that of ice, 0.02, and that
/// of glass of an index of 1.8, 0.08; no metal has less than 0.4.
pub const MOST_OF_DIELECTRIC: f32 = 4.0;
const INVERSE_NORMAL_FRESNEL: f32 = 1.0 / NORMAL_FRESNEL;

/// A dielectric's Fresnel factor, 1 at normal incidence, of a surface where it rises by this part as much; see [`Brdf::rise`].
#[inline(always)]
fn risen(rise: f32, factor: f32) -> f32 {
    factor * rise + (1.0 - rise)
}

/// Unpolarised Fresnel reflectance of a dielectric at the cosine `c` of incidence.
#[inline(always)]
fn fresnel(c: f32) -> f32 {
    // Walter et al. (2007), eq. 22.
    let g = (REFRACTIVE_INDEX * REFRACTIVE_INDEX - 1.0 + c * c).sqrt();
    // (g − c)/(g + c) without a division: g² − c² = η² − 1.
    let a = (g - c) * (g - c) * (1.0 / (REFRACTIVE_INDEX * REFRACTIVE_INDEX - 1.0));
    let b = (c * (g + c) - 1.0) / (c * (g - c) + 1.0);
    0.5 * a * a * (1.0 + b * b)
}

/// What passes a smooth surface at the cosine `cos`, as a ratio to normal incidence; one that reflects `strength` times what a
/// dielectric does, at most once.
#[inline(always)]
fn smooth_transmittance(cos: f32, strength: f32) -> f32 {
    let strength = strength.min(1.0);
    (1.0 - strength * fresnel(cos.clamp(1e-3, 1.0))) / (1.0 - strength * NORMAL_FRESNEL)
}

/// Part of uniform light that a GGX lobe sends towards a viewer at the cosine `cos`: the Fresnel reflectance at a steeper
/// angle. Fitted to the integral (sampled by visible normals, separable masking) for widths √2 σ from 0.02 to 0.7 and cosines
/// from 0.1 on: what passes is right to 0.7 % from cosines of 0.3 on and to 2.5 % below.
#[inline]
fn ggx_reflectance(cos: f32, sigma: f32) -> f32 {
    let (cos, alpha) = (cos.clamp(1e-3, 1.0), std::f32::consts::SQRT_2 * sigma);
    let (tilt, squared) = (1.0 - cos, alpha * alpha);
    let steeper = (cos * cos + 1.0738 * alpha.powf(1.4252) * tilt.powf(0.8577)).min(1.0);
    let lost = 1.0 + squared * (1.3559 - 2.7057 * tilt.powf(2.5463));
    (fresnel(steeper.sqrt()) / lost.max(0.2)).min(0.99)
}

/// Smith's masking G₁ for Beckmann slopes of width √2 σ at the cosine `c`, in the rational approximation of
/// Walter et al. (2007), with its derivative by σ.
#[inline(always)]
fn masking(c: f32, sigma: f32) -> LobeValue {
    let tangent = ((1.0 - c * c).max(0.0)).sqrt() / c;
    let a = 1.0 / (std::f32::consts::SQRT_2 * sigma * tangent).max(1e-6);
    let (top, bottom) = (a * (3.535 + 2.181 * a), 1.0 + a * (2.276 + 2.577 * a));
    let value = top / bottom;
    let by_a = ((3.535 + 4.362 * a) * bottom - top * (2.276 + 5.154 * a)) / (bottom * bottom);
    // da/dσ = −a/σ. Past a = 1.6 nothing is masked.
    if a < 1.6 {
        LobeValue {
            value,
            by_sigma: -by_a * a / sigma,
        }
    } else {
        LobeValue {
            value: 1.0,
            by_sigma: 0.0,
        }
    }
}

/// Smith's masking G₁ for GGX slopes of width √2 σ at the cosine `c` (Walter et al. 2007, eq. 34), with its derivative by σ.
#[inline(always)]
fn ggx_masking(c: f32, sigma: f32) -> LobeValue {
    let spread = 2.0 * sigma * sigma * (1.0 - c * c).max(0.0) / (c * c);
    let root = (1.0 + spread).sqrt();
    let value = 2.0 / (1.0 + root);
    // d root/dσ = spread/(σ root).
    LobeValue {
        value,
        by_sigma: -0.5 * value * value * spread / (sigma * root),
    }
}

/// `acos(c)²` for `c` in [0, 1], by `(1 − c)·P(c)²` with the polynomial of Abramowitz and Stegun, 4.4.46: exact
/// where it vanishes, error below 1e-7 elsewhere.
#[inline(always)]
fn squared_arccos(c: f32) -> f32 {
    let p = -0.001_262_491_1_f32;
    let p = p * c + 0.006_670_09;
    let p = p * c - 0.017_088_126;
    let p = p * c + 0.030_891_88;
    let p = p * c - 0.050_174_303;
    let p = p * c + 0.088_978_99;
    let p = p * c - 0.214_598_8;
    let p = p * c + std::f32::consts::FRAC_PI_2;
    (1.0 - c) * p * p
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A few configurations with light, view and normal well above the horizon.
    fn configurations() -> impl Iterator<Item = (Vec3, Vec3, Vec3)> {
        (0..60).map(|i| {
            let t = i as f32;
            let direction = |a: f32, tilt: f32| {
                Vec3::new(a.cos() * tilt.sin(), a.sin() * tilt.sin(), tilt.cos())
            };
            (
                direction(t * 0.7, 0.1),
                direction(t * 1.3, 0.2 + 0.9 * (t * 0.37).sin().abs()),
                direction(t * 1.3 + 3.0, 0.25 + 0.9 * (t * 0.41).sin().abs()),
            )
        })
    }

    #[test]
    fn derivative_by_sigma_agrees_with_finite_differences() {
        for model in SpecularModel::ALL {
            for (n, v, l) in configurations() {
                let at = |sigma: f32| {
                    let brdf = Brdf::new(model, sigma);
                    brdf.lobe_with_derivative(&brdf.view_terms(n, v), l)
                };
                let step = 2e-3;
                let (low, mid, high) = (at(0.2 - step), at(0.2), at(0.2 + step));
                let difference = (high.value - low.value) / (2.0 * step);
                assert!(
                    (difference - mid.by_sigma).abs() < 2e-3 * (1.0 + mid.by_sigma.abs()),
                    "{model:?}: analytic {} against {difference}",
                    mid.by_sigma
                );
            }
        }
    }

    #[test]
    fn what_reflects_more_reflects_no_more_than_all_at_grazing_angles() {
        // Of plastic 24 times as much as at normal incidence, of gold hardly more, of what reflects all the same.
        for (strength, most) in [(1.0, 25.0), (10.0, 2.5), (25.0, 1.0), (40.0, 1.0)] {
            let gloss = Gloss::new(1.0, strength);
            let brdf = Brdf::new(SpecularModel::Ggx, 0.1).at(gloss);
            let factor = brdf.fresnel_factor(1e-4);
            assert!((factor / most - 1.0).abs() < 0.01, "{strength}: {factor}");
            assert!((brdf.fresnel_factor(1.0) - 1.0).abs() < 1e-4);
        }
    }

    #[test]
    fn a_gloss_beside_another_is_what_it_reflects_more() {
        let metal = Gloss::new(0.5, 8.0).reflecting(Vec3::new(12.0, 8.0, 4.0));
        assert_eq!((metal.strength, metal.tint), (8.0, [1.5, 1.0, 0.5]));
        let main = Gloss::new(2.0, 4.0).reflecting(Vec3::new(2.0, 4.0, 6.0));
        let beside = metal.beside(main);
        assert_eq!(beside.roughness, 0.25);
        let off = beside.scale() - Vec3::new(6.0, 2.0, 4.0 / 6.0);
        assert!(off.abs().max_element() < 1e-5, "{off}");
        assert_eq!(metal.beside(metal), Gloss::MAIN);
        // Half of a texel that reflects nothing leaves the colour and takes half of the strength.
        let mixed = Gloss::mean([(metal, 0.5), (Gloss::new(1.0, 0.0), 0.5)]);
        assert_eq!(mixed.tint, metal.tint);
        assert_eq!((mixed.strength, mixed.roughness), (4.0, 0.5));
    }

    #[test]
    fn paper_lobe_is_equation_4() {
        for (n, v, l) in configurations() {
            let sigma = 0.15_f32;
            let brdf = Brdf::new(SpecularModel::Paper, sigma);
            let (n, v, l) = (n.as_dvec3(), v.as_dvec3(), l.as_dvec3());
            let alpha = n.dot((l + v).normalize_or_zero()).clamp(-1.0, 1.0).acos();
            let expected = (-alpha * alpha / (2.0 * f64::from(sigma).powi(2))).exp() / n.dot(v);
            let got = brdf.lobe(&brdf.view_terms(n.as_vec3(), v.as_vec3()), l.as_vec3());
            assert!(
                (f64::from(got) - expected).abs() < 2e-5 * (1.0 + expected),
                "{got} against {expected}"
            );
        }
    }

    #[test]
    fn microfacet_lobes_are_reciprocal_and_one_at_the_peak() {
        for model in [SpecularModel::Beckmann, SpecularModel::Ggx] {
            let brdf = Brdf::new(model, 0.1);
            let peak = brdf.lobe(&brdf.view_terms(Vec3::Z, Vec3::Z), Vec3::Z);
            assert!((peak - 1.0).abs() < 1e-5, "{model:?}: peak {peak}");
            for (n, v, l) in configurations() {
                // f(l, v)·cos θ_i is the lobe, so lobe/cos θ_i must not change when l and v change places.
                let forward = brdf.lobe(&brdf.view_terms(n, v), l) / n.dot(l);
                let backward = brdf.lobe(&brdf.view_terms(n, l), v) / n.dot(v);
                assert!(
                    (forward - backward).abs() < 1e-4 * (1e-3 + forward),
                    "{model:?}: {forward} against {backward}"
                );
            }
        }
    }

    /// The lobe under uniform light, in absolute terms, by summing over the hemisphere.
    fn reflected(brdf: Brdf, cos: f32) -> f32 {
        const STEPS: usize = 600;
        let view = Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
        let terms = brdf.view_terms(Vec3::Z, view);
        let mut sum = 0.0;
        for i in 0..STEPS {
            let height = (i as f32 + 0.5) / STEPS as f32;
            let radius = (1.0 - height * height).sqrt();
            for j in 0..STEPS {
                let (y, x) = (std::f32::consts::TAU * j as f32 / STEPS as f32).sin_cos();
                let light = Vec3::new(radius * x, radius * y, height);
                sum += f64::from(brdf.lobe(&terms, light));
            }
        }
        let solid_angle = std::f64::consts::TAU / (STEPS * STEPS) as f64;
        (sum * solid_angle) as f32 * brdf.specular_scale().expect("it has a scale")
    }

    #[test]
    fn the_diffuse_part_loses_what_a_ggx_lobe_reflects() {
        for sigma in [0.06, 0.12, 0.3] {
            let brdf = Brdf::new(SpecularModel::Ggx, sigma);
            let normal = 1.0 - reflected(brdf, 1.0);
            for (cos, most) in [(0.8, 0.005), (0.5, 0.005), (0.3, 0.007), (0.15, 0.025)] {
                let expected = (1.0 - reflected(brdf, cos)) / normal;
                let found = brdf.diffuse_exit(cos);
                assert!(
                    (found / expected - 1.0).abs() < most,
                    "σ {sigma}, cos {cos}: {found} for {expected}"
                );
            }
        }
    }

    #[test]
    fn light_from_behind_contributes_nothing() {
        for model in SpecularModel::ALL {
            let brdf = Brdf::new(model, 0.4);
            let terms = brdf.view_terms(Vec3::Z, Vec3::new(0.8, 0.0, 0.6));
            assert_eq!(
                brdf.lobe(&terms, Vec3::new(-0.8, 0.0, -0.01)),
                0.0,
                "{model:?}"
            );
        }
    }

    #[test]
    fn support_bounds_the_lobe() {
        for model in SpecularModel::ALL {
            let brdf = Brdf::new(model, 0.1);
            let reach = brdf.half_angle_support(1e-3);
            let terms = brdf.view_terms(Vec3::Z, Vec3::Z);
            let peak = brdf.lobe(&terms, Vec3::Z);
            let beyond = Vec3::new((2.0 * reach + 0.02).sin(), 0.0, (2.0 * reach + 0.02).cos());
            assert!(brdf.lobe(&terms, beyond) < 1.1e-3 * peak, "{model:?}");
        }
    }
}
