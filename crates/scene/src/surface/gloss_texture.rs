//! The gloss of every texel.

use glam::Vec2;
use rayon::prelude::*;

use super::atlas::Atlas;
use super::parts::GlossParts;
use crate::reflectance::Gloss;
use glam::Vec3;
use rekindle_capture::Mesh;

/// Triangles that are looked at for the parts' shares, about, and where in them: weights of the second and third corner.
const LOOKED_AT: usize = 100_000;
const WITHIN: [[f32; 2]; 4] = [[1.0 / 3.0; 2], [0.1, 0.1], [0.8, 0.1], [0.1, 0.8]];

/// How the lobe differs from the main one, texel by texel.
#[derive(Clone, Debug, PartialEq)]
pub struct GlossTexture {
    /// Those of the parts, at least one; texels between parts have others.
    parts: Vec<Gloss>,
    texels: Vec<Gloss>,
    /// Least and largest roughness of what reflects at all.
    roughness: [f32; 2],
    strongest: f32,
}

impl GlossTexture {
    /// The glosses of the parts, and those of all texels, row by row.
    pub fn new(parts: Vec<Gloss>, texels: Vec<Gloss>) -> Self {
        let shown = texels.iter().filter(|gloss| gloss.strength > 0.0);
        let ends = shown.fold([f32::INFINITY, 0.0_f32], |[least, most], gloss| {
            [least.min(gloss.roughness), most.max(gloss.roughness)]
        });
        Self {
            roughness: if ends[0] <= ends[1] { ends } else { [1.0; 2] },
            strongest: texels
                .iter()
                .map(|gloss| gloss.strength)
                .fold(0.0, f32::max),
            texels,
            parts,
        }
    }

    /// The glosses of a surface's parts; `colours` holds the diffuse radiance of each texel, where there is any.
    pub fn of_parts(parts: &GlossParts, mesh: &Mesh, atlas: &Atlas, colours: &[[f32; 3]]) -> Self {
        let glosses: Vec<Gloss> = atlas
            .texels
            .par_iter()
            .map(|texel| {
                let position = mesh.point(texel.triangle, texel.barycentric).position;
                let colour = Vec3::from(colours[texel.index as usize]);
                let colour = (colour.min_element() > 0.0).then(|| parts.colour(colour));
                parts.between(position, colour)
            })
            .collect();
        let mut texels = vec![Gloss::MAIN; atlas.len()];
        for (texel, gloss) in atlas.texels.iter().zip(glosses) {
            texels[texel.index as usize] = gloss;
        }
        Self::new(parts.glosses.clone(), texels)
    }

    /// The glosses of all texels, row by row.
    pub fn texels(&self) -> &[Gloss] {
        &self.texels
    }

    /// The parts' glosses, with the share of the surface's area that is nearest to each, the largest first.
    pub fn parts(&self, mesh: &Mesh, atlas: &Atlas) -> Vec<(Gloss, f32)> {
        let mut areas = vec![0.0_f64; self.parts.len()];
        let stride = mesh.triangles.len().div_ceil(LOOKED_AT).max(1);
        for triangle in (0..mesh.triangles.len()).step_by(stride) {
            let [a, b, c] = mesh.triangles[triangle].map(|v| mesh.positions[v as usize]);
            let area = f64::from((b - a).cross(c - a).length());
            for within in WITHIN {
                let gloss = self.at(atlas, triangle as u32, within.into());
                areas[gloss.nearest(&self.parts)] += area;
            }
        }
        let all = areas.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let mut parts: Vec<(Gloss, f32)> = (self.parts.iter().zip(areas))
            .map(|(&gloss, area)| (gloss, (area / all) as f32))
            .collect();
        parts.sort_by(|a, b| b.1.total_cmp(&a.1));
        parts
    }

    /// The parts' glosses.
    pub fn glosses(&self) -> &[Gloss] {
        &self.parts
    }

    /// Whether parts reflect in different colours.
    pub fn is_coloured(&self) -> bool {
        !self.parts.iter().all(|gloss| Gloss::is_white(&gloss.tint))
    }

    /// The least roughness of what reflects at all, as a multiple of the main one.
    pub fn narrowest(&self) -> f32 {
        self.roughness[0]
    }

    /// The largest roughness of what reflects at all, as a multiple of the main one.
    pub fn widest(&self) -> f32 {
        self.roughness[1]
    }

    /// The largest strength, as a multiple of the main lobe's.
    pub fn strongest(&self) -> f32 {
        self.strongest
    }

    /// The gloss at a point of a triangle, bilinear, roughness weighted by what each texel reflects.
    pub fn at(&self, atlas: &Atlas, triangle: u32, barycentric: Vec2) -> Gloss {
        let taps = atlas.taps(triangle, barycentric);
        Gloss::mean(taps.map(|(texel, weight)| (self.texels[texel], weight)))
    }
}
