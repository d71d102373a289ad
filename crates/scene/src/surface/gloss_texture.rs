//! The gloss of every texel.

use glam::Vec2;
use rayon::prelude::*;

use super::atlas::Atlas;
use super::parts::GlossParts;
use crate::reflectance::Gloss;
use glam::Vec3;
use rekindle_capture::Mesh;

/// How the lobe differs from the main one, texel by texel.
#[derive(Clone, Debug, PartialEq)]
pub struct GlossTexture {
    texels: Vec<Gloss>,
    /// Least and largest roughness of what reflects at all.
    roughness: [f32; 2],
}

impl GlossTexture {
    /// The glosses of all texels, row by row.
    pub fn new(texels: Vec<Gloss>) -> Self {
        let shown = texels.iter().filter(|gloss| gloss.strength > 0.0);
        let ends = shown.fold([f32::INFINITY, 0.0_f32], |[least, most], gloss| {
            [least.min(gloss.roughness), most.max(gloss.roughness)]
        });
        Self {
            roughness: if ends[0] <= ends[1] { ends } else { [1.0; 2] },
            texels,
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
        Self::new(texels)
    }

    /// The glosses of all texels, row by row.
    pub fn texels(&self) -> &[Gloss] {
        &self.texels
    }

    /// The least roughness of what reflects at all, as a multiple of the main one.
    pub fn narrowest(&self) -> f32 {
        self.roughness[0]
    }

    /// The largest roughness of what reflects at all, as a multiple of the main one.
    pub fn widest(&self) -> f32 {
        self.roughness[1]
    }

    /// The gloss at a point of a triangle, bilinear, roughness weighted by what each texel reflects.
    pub fn at(&self, atlas: &Atlas, triangle: u32, barycentric: Vec2) -> Gloss {
        let taps = atlas.taps(triangle, barycentric);
        Gloss::mean(taps.map(|(texel, weight)| (self.texels[texel], weight)))
    }
}
