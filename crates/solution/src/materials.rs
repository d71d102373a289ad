//! The surface in words: its lobe, and the parts whose gloss differs.

use std::fmt::Write as _;

use super::Solution;
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};

/// Shares below this are not worth a word.
const LEAST_SHARE: f32 = 0.005;

/// A part of the surface with a gloss of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePart {
    /// Its lobe; the strength is 0 where nothing is reflected.
    pub brdf: Brdf,
    /// See [`Gloss::tint`].
    pub tint: [f32; 3],
    /// Share of the surface, 0 to 1.
    pub share: f32,
}

impl SurfacePart {
    /// See [`Brdf::roughness`].
    pub fn roughness(&self) -> f32 {
        self.brdf.roughness()
    }

    /// Whether it reflects at all.
    pub fn is_glossy(&self) -> bool {
        self.brdf.strength > 0.0
    }
}

impl Solution {
    /// The parts of the surface, the largest first: one where all is alike, none without a specular part.
    pub fn parts(&self) -> Vec<SurfacePart> {
        let Some(main) = self.brdf else {
            return Vec::new();
        };
        let whole = || vec![(Gloss::MAIN, 1.0)];
        let parts =
            (self.gloss.as_ref()).map_or_else(whole, |gloss| gloss.parts(&self.mesh, &self.atlas));
        let parts = parts.into_iter();
        parts
            .map(|(gloss, share)| SurfacePart {
                brdf: main.at(gloss),
                tint: gloss.tint,
                share,
            })
            .collect()
    }

    /// The surface in words, such as "GGX, roughness 0.30 ± 0.01 on 62 % of the surface, 0.45 on 30 %, no gloss on 8 %";
    /// roughness is that of other programs.
    pub fn surface_in_words(&self) -> String {
        let Some(main) = self.brdf else {
            return "purely diffuse".to_owned();
        };
        let model = match main.model {
            SpecularModel::Paper => "the paper's lobe",
            SpecularModel::Beckmann => "Beckmann",
            SpecularModel::Ggx => "GGX",
            SpecularModel::Metal => "metal (GGX)",
        };
        let parts = self.parts();
        let told = parts.iter().filter(|part| part.share >= LEAST_SHARE);
        let several = told.clone().count() > 1;
        let mut texts: Vec<String> = told.map(|part| self.part_in_words(part, several)).collect();
        if let Some(first) = texts.first_mut().filter(|_| several) {
            first.push_str(" of the surface");
        }
        format!("{model}, {}", texts.join(", "))
    }

    fn part_in_words(&self, part: &SurfacePart, several: bool) -> String {
        let share = 100.0 * part.share;
        if !part.is_glossy() {
            return format!("no gloss on {share:.0} %");
        }
        let roughness = part.roughness();
        let is_main = Some(part.brdf) == self.brdf;
        let is_metal = self
            .brdf
            .is_some_and(|main| main.has_metal_beside(&part.brdf));
        let metal = if is_metal { "metal of " } else { "" };
        // Writing into a string can't fail.
        let mut text = format!("{metal}roughness {roughness:.2}");
        if is_main && let Some([low, high]) = self.sigma_interval95 {
            // √σ moves by half of what σ does, in parts of it.
            let error = 0.25 * roughness * (high - low) / part.brdf.sigma;
            let _ = write!(text, " ± {}", two_digits(error));
        }
        if !is_main {
            let strength = part.brdf.strength / self.brdf.map_or(1.0, |main| main.strength);
            let _ = write!(text, " at {strength:.2} times the strength");
        }
        if !Gloss::is_white(&part.tint) {
            let [r, g, b] = part.tint;
            let _ = write!(text, " and tint {r:.2} {g:.2} {b:.2}");
        }
        if several {
            let _ = write!(text, " on {share:.0} %");
        }
        text
    }
}

/// A small error with no more digits than it is worth.
fn two_digits(error: f32) -> String {
    if error >= 0.005 {
        format!("{error:.2}")
    } else {
        format!("{:.4}", error.max(1e-4))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::example;
    use super::*;
    use glam::{Vec2, Vec3};
    use rekindle_scene::surface::{Atlas, GlossTexture};

    #[test]
    fn parts_are_told_with_their_shares() {
        let mut solution = example();
        solution.brdf = Some(Brdf::new(SpecularModel::Ggx, 0.0636));
        solution.sigma_interval95 = Some([0.0594, 0.0678]);
        assert_eq!(solution.surface_in_words(), "GGX, roughness 0.30 ± 0.01");

        // Ten triangles of one size, each with a texel of its own.
        let count = 10;
        solution.mesh.triangles = vec![[0, 2, 1]; count];
        let at = |k: usize| [Vec2::new(k as f32 + 0.5, 0.5); 3];
        solution.atlas = Atlas::from_corners(count as u32, 1, (0..count).map(at).collect(), false);
        let mut texels = vec![Gloss::MAIN; count];
        let matt = Gloss {
            strength: 0.0,
            ..Gloss::MAIN
        };
        let dull = Gloss::new(2.25, 0.5);
        texels[0] = matt;
        texels[1..3].fill(dull);
        // What lies between two parts makes no part.
        texels[3] = Gloss::new(2.0, 0.6);
        solution.gloss = Some(GlossTexture::new(vec![Gloss::MAIN, dull, matt], texels));
        assert_eq!(
            solution.surface_in_words(),
            "GGX, roughness 0.30 ± 0.01 on 60 % of the surface, roughness 0.45 at 0.50 times the strength on 30 %, no gloss on \
             10 %"
        );
        // What reflects so much more than plastic is a metal, of its own colour.
        let metal = Gloss::new(0.25, 9.0).reflecting(Vec3::new(13.5, 9.0, 4.5));
        let mut texels = vec![Gloss::MAIN; count];
        texels[..6].fill(metal);
        solution.gloss = Some(GlossTexture::new(vec![Gloss::MAIN, metal], texels));
        assert_eq!(
            solution.surface_in_words(),
            "GGX, metal of roughness 0.15 at 9.00 times the strength and tint 1.50 1.00 0.50 on 60 % of the surface, roughness \
             0.30 ± 0.01 on 40 %"
        );
    }

    #[test]
    fn without_a_specular_part_there_are_no_parts() {
        let mut solution = example();
        solution.brdf = None;
        assert!(solution.parts().is_empty());
        assert_eq!(solution.surface_in_words(), "purely diffuse");
    }
}
