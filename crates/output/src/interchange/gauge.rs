//! What other programs' materials and lights are worth in this one's units.
//!
//! A solve knows only products of light and reflectance: its lights are K_S times the real ones, its pseudo-albedo is
//! K_D / K_S. Other programs ask for each alone. The gauge is fixed by the reflectance at normal incidence F₀: with
//! I_s = K_S L exp(−α²/2σ²)/cos θ_r (eq. 4) equated to D F₀ G L/(4 cos θ_r) and D(0) = 1/(π m²), the Beckmann slope width
//! m = √2 σ gives K_S = F₀/(4π m²).
//!
//! Programs that have no Beckmann lobe get GGX of the same width, α = m: its peak is as bright with the same F₀. Its tails
//! are longer. A wider lobe that comes nearer to D in the mean square (α ≈ 1.6 σ) makes the tails brighter yet, and pictures
//! come out further apart: with Blender's Principled BSDF 32.1 dB against 33.6 dB on the first view of the demo.

use std::f32::consts::{PI, SQRT_2};

use glam::Vec3;
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};

/// Reflectance of plastic, varnish and skin at normal incidence: an index of refraction of 1.5.
pub const USUAL_F0: f32 = 0.04;

/// No dielectric reflects more at normal incidence.
const LARGEST_F0: f32 = 0.9;

/// Reflection of the surface in the terms of other programs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Which form of eq. 3 the surface follows, `None` where it reflects diffusely only.
    pub model: Option<SpecularModel>,
    /// Roughness σ of the lobe, radians; 0 without one.
    pub sigma: f32,
    /// Reflectance at normal incidence, that of the channel of which most is reflected; 0 without a lobe.
    pub f0: f32,
    /// Part of it that each channel has, the largest being 1.
    pub colour: Vec3,
    /// K_S of eq. 4: real light is the solution's divided by it.
    pub specular_scale: f32,
}

impl Material {
    /// The material of a lobe with the reflectance `f0` at normal incidence, between 0 and 1.
    pub fn new(brdf: Option<Brdf>, f0: f32) -> Self {
        let Some(Brdf { model, sigma, .. }) = brdf else {
            return Self {
                model: None,
                sigma: 0.0,
                f0: 0.0,
                colour: Vec3::ONE,
                specular_scale: 1.0,
            };
        };
        Self {
            model: Some(model),
            sigma,
            f0,
            colour: Vec3::ONE,
            specular_scale: f0 / (8.0 * PI * sigma * sigma),
        }
    }

    /// The material of a part of another gloss, where this is the main one.
    #[must_use]
    pub fn at(&self, gloss: Gloss) -> Self {
        if gloss.strength <= 0.0 {
            return Self {
                model: None,
                f0: 0.0,
                colour: Vec3::ONE,
                specular_scale: 0.0,
                ..*self
            };
        }
        let reflected = (self.f0 * gloss.scale()).min(Vec3::splat(LARGEST_F0));
        let f0 = reflected.max_element();
        Self {
            sigma: self.sigma * gloss.roughness,
            f0,
            colour: if Gloss::is_white(&gloss.tint) {
                Vec3::ONE
            } else {
                reflected / f0.max(f32::MIN_POSITIVE)
            },
            specular_scale: self.specular_scale * gloss.height(),
            ..*self
        }
    }

    /// Slope width m of the Beckmann lobe and α of the GGX lobe.
    pub fn alpha(&self) -> f32 {
        if self.model.is_some() {
            (SQRT_2 * self.sigma).min(1.0)
        } else {
            1.0
        }
    }

    /// What programs call roughness: √α.
    pub fn roughness(&self) -> f32 {
        self.alpha().sqrt()
    }

    /// Index of refraction with which a dielectric reflects F₀.
    pub fn refractive_index(&self) -> f32 {
        refractive_index(self.f0)
    }

    /// By how much a diffuse albedo is to be raised where a program lets only 1 − F₀ of the light through to it.
    pub fn behind_surface(&self) -> f32 {
        1.0 / (1.0 - self.f0)
    }

    /// The part of uniform light that a smooth surface of this index of refraction reflects.
    pub fn mean_reflectance(&self) -> f32 {
        /// Midpoint rule in cos²θ.
        const STEPS: usize = 256;
        let index = self.refractive_index();
        let sum: f32 = (0..STEPS)
            .map(|i| fresnel(((i as f32 + 0.5) / STEPS as f32).sqrt(), index))
            .sum();
        sum / STEPS as f32
    }
}

/// Index of refraction with which a dielectric reflects `f0` at normal incidence.
pub fn refractive_index(f0: f32) -> f32 {
    let root = f0.clamp(0.0, 0.99).sqrt();
    (1.0 + root) / (1.0 - root)
}

/// Reflectance at normal incidence of a dielectric with this index of refraction.
pub fn reflectance(index: f32) -> f32 {
    ((index - 1.0) / (index + 1.0)).powi(2)
}

/// Unpolarised Fresnel reflectance of a dielectric of any index above 1 at the cosine `c` of incidence.
pub fn fresnel(c: f32, index: f32) -> f32 {
    let g = (index * index - 1.0 + c * c).sqrt();
    let a = (g - c) / (g + c);
    let b = (c * (g + c) - 1.0) / (c * (g - c) + 1.0);
    0.5 * a * a * (1.0 + b * b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn material(sigma: f32) -> Material {
        let model = SpecularModel::Paper;
        Material::new(Some(Brdf::new(model, sigma)), USUAL_F0)
    }

    #[test]
    fn the_peak_of_the_lobe_is_that_of_eq_4() {
        for sigma in [0.03, 0.075, 0.2] {
            let m = material(sigma);
            // D(0) F₀/4 = K_S for Beckmann and for GGX.
            let peak = m.f0 / (4.0 * PI * m.alpha().powi(2));
            assert!((peak / m.specular_scale - 1.0).abs() < 1e-5, "σ {sigma}");
        }
    }

    #[test]
    fn the_gauge_of_the_microfacet_model_is_the_estimates_own() {
        let model = SpecularModel::Beckmann;
        let brdf = Brdf::new(model, 0.1);
        let own = brdf.specular_scale().unwrap();
        let m = Material::new(Some(brdf), USUAL_F0);
        assert!((m.specular_scale / own - 1.0).abs() < 1e-5);
    }

    #[test]
    fn index_and_reflectance_are_inverse() {
        assert!((reflectance(1.5) - 0.04).abs() < 1e-6);
        for index in [1.3, 1.5, 2.4] {
            assert!((refractive_index(reflectance(index)) - index).abs() < 1e-5);
            assert!((fresnel(1.0, index) - reflectance(index)).abs() < 1e-6);
            assert!((fresnel(1e-4, index) - 1.0).abs() < 1e-2);
        }
        // Known for an index of 1.5: 9.2 % of uniform light.
        assert!((material(0.1).mean_reflectance() - 0.0918).abs() < 1e-3);
    }
}
