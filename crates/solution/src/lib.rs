//! What is saved of a solve: a folder that opens anywhere, complete without the capture.
//!
//! | file | holds |
//! | --- | --- |
//! | `solution.json` | everything in numbers: see `format` |
//! | `nodes.json` | radiance of every lit node, exact, and the lamps' nodes |
//! | `hemisphere.exr` | the lighting as a lat-long picture |
//! | `hemispheres/*.exr` | initial hemisphere and those of single views, seen from above |
//! | `cameras.json` | from where the photographs were taken, as a `transforms.json` without photographs |
//! | `mesh.ply`, `mesh.obj` | the surface with texture coordinates |
//! | `roughness.exr`, `specular_strength.exr` | where parts differ in gloss: σ in radians, and strength as a multiple of the main lobe's, RGB where parts reflect in different colours |
//! | `diffuse.exr`, `albedo.exr`, `confidence.exr` | textures: diffuse radiance, pseudo-albedo, how far each texel is known |
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use rekindle_capture::Capture;
//! use rekindle_estimate::estimate::{EstimateParams, Unobserved};
//! use rekindle_solution::{SolveOptions, solve};
//!
//! let capture = Capture::load("capture".as_ref())?;
//! let options = SolveOptions { estimate: EstimateParams::default(), frequency: 70, radius: None, light_frame: None };
//! let solution = solve(&capture, &options, 0.0, &mut Unobserved)?;
//! solution.save("solution".as_ref())?;
//! # Ok(())
//! # }
//! ```

mod diffuse_alone;
mod error;
mod exr_file;
mod folder;
mod format;
mod known_light;
mod lighting;
mod materials;
mod mesh_file;
mod mirrored;
mod odd_views;
mod origin;
mod placed;
mod solve;
mod turntable;

pub use diffuse_alone::diffuse_alone;
pub use error::SolutionError;
pub use exr_file::{write_rgb, write_rgba};
pub use folder::{check_destination, own_files, solution_folder};
pub use format::{Fit, Skipped};
pub use known_light::{KnownLight, LightProbe};
pub use lighting::lighting;
pub use materials::SurfacePart;
pub use mesh_file::{write_obj, write_plain_obj};
pub use origin::origin;
pub use placed::{manifest_of, write_mesh_transform, write_placed_mesh};
pub use solve::{SolveOptions, solve, solve_under};

use std::borrow::Cow;

use glam::Vec3;

use rekindle_capture::{Camera, LightFrame, Mesh};
use rekindle_estimate::estimate::{Diagnostics, Iteration, Method};
use rekindle_estimate::registration::Correction;
use rekindle_relight::{GlossMap, Lighting};
use rekindle_scene::hemisphere::{HemisphereGrid, Picture};
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::surface::{Atlas, GlossTexture};

/// A lamp that the estimate found.
#[derive(Clone, Debug, PartialEq)]
pub struct SolutionLamp {
    /// What people call it.
    pub name: String,
    /// Flux-weighted mean direction from the object's centre, unit.
    pub direction: Vec3,
    /// Radiance × solid angle, RGB.
    pub flux: Vec3,
    /// √2 × flux-weighted rms angle of its nodes, radians.
    pub angular_radius: f32,
    /// Nodes of the hemisphere.
    pub nodes: Vec<u32>,
}

/// A picture of a hemisphere seen from straight above.
#[derive(Clone, Debug)]
pub struct HemispherePicture {
    /// File name without extension.
    pub name: String,
    /// The picture.
    pub picture: Picture,
}

/// Everything a solve found.
pub struct Solution {
    /// The capture's name.
    pub name: String,
    /// What it was made of, see [`origin()`]; empty in solutions that were written before this was kept.
    pub origin: String,
    /// The estimation method.
    pub method: Method,
    /// Specular model and roughness; `None` where no specular part was found.
    pub brdf: Option<Brdf>,
    /// Why this specular model, in words.
    pub chosen_because: String,
    /// What was corrected about each view; empty where all were taken as stated.
    pub corrections: Vec<Correction>,
    /// 95 % interval of σ, radians.
    pub sigma_interval95: Option<[f32; 2]>,
    /// The light's picture, where the light was given and not estimated.
    pub known_light: Option<KnownLight>,
    /// What the lights stand still with; with the camera, they are those before the first of `cameras`.
    pub light_frame: LightFrame,
    /// The nodes of light.
    pub grid: HemisphereGrid,
    /// Radiance of every node, RGB, `K_S`-scaled.
    pub radiance: Vec<[f32; 3]>,
    /// Brightest first.
    pub lamps: Vec<SolutionLamp>,
    /// Radiance from every direction alike, RGB, `K_S`-scaled.
    pub ambient: Vec3,
    /// What the data could say.
    pub diagnostics: Diagnostics,
    /// How well the input views are reproduced.
    pub fit: Fit,
    /// What was not done because the capture doesn't need it.
    pub skipped: Skipped,
    /// Seconds of each stage, in order.
    pub timings: Vec<(String, f64)>,
    /// The estimation's iterations.
    pub convergence: Vec<Iteration>,
    /// From where the photographs were taken, with their names; none in solutions that were written before these were kept.
    pub cameras: Vec<(String, Camera)>,
    /// The surface; its texture coordinates are the atlas's.
    pub mesh: Mesh,
    /// Where each triangle lies in the textures.
    pub atlas: Atlas,
    /// Diffuse radiance per texel under the captured lighting.
    pub diffuse: Vec<[f32; 3]>,
    /// Pseudo-albedo per texel.
    pub albedo: Vec<[f32; 3]>,
    /// How far each texel is known, 0 to 1.
    pub confidence: Vec<f32>,
    /// How the lobe of each texel differs from `brdf`; `None` where one is all.
    pub gloss: Option<GlossTexture>,
    /// Initial and partial hemispheres; written, not read back.
    pub pictures: Vec<HemispherePicture>,
}

impl Solution {
    /// The captured lighting, ready to be edited.
    pub fn lighting(&self) -> Lighting {
        lighting(
            &self.grid,
            &self.radiance,
            &self.lamps,
            self.ambient,
            (self.brdf, self.known_light.as_ref()),
        )
    }

    /// A lighting, which is stated as the object has it before the first camera, as it has it before another.
    pub fn lighting_before<'l>(
        &self,
        lighting: &'l Lighting,
        camera: &Camera,
    ) -> Cow<'l, Lighting> {
        match (self.light_frame, self.cameras.first()) {
            (LightFrame::Camera, Some((_, first))) => {
                let moved = camera.world_from_camera * first.world_from_camera.inverse();
                Cow::Owned(lighting.moved(&moved))
            }
            _ => Cow::Borrowed(lighting),
        }
    }

    /// How the lobe differs from place to place, where it does.
    pub fn gloss_map(&self) -> Option<GlossMap<'_>> {
        let atlas = &self.atlas;
        (self.gloss.as_ref()).map(|texture| GlossMap { atlas, texture })
    }

    /// Radiance to be shown as white: a little above the brightest diffuse parts under the captured lighting, so that all
    /// pictures of a solution have one exposure and highlights can be told from them. A metal, which has none, counts as if it sent
    /// what it reflects in all directions alike.
    pub fn white(&self) -> f32 {
        let diffuse = self.brightest(&self.diffuse);
        let metal = self.brdf.filter(|b| b.model == SpecularModel::Metal);
        let evenly = metal.map_or(0.0, |b| {
            // F₀ E/π of the light as it is, with E times K_S = F₀/(8πσ²) known.
            8.0 * b.sigma * b.sigma * self.lighting().flux().element_sum() / 3.0
        });
        (1.3 * diffuse.max(evenly)).max(f32::MIN_POSITIVE)
    }

    /// The value of a texture that 98 % of its known texels stay below in the mean over channels, 1 where nothing is known.
    pub fn brightest(&self, texture: &[[f32; 3]]) -> f32 {
        /// Texels that count as known.
        const KNOWN: f32 = 0.1;
        let mut means: Vec<f32> = texture
            .iter()
            .zip(&self.confidence)
            .filter(|(_, confidence)| **confidence > KNOWN)
            .map(|(texel, _)| texel.iter().sum::<f32>() / 3.0)
            .collect();
        if means.is_empty() {
            return 1.0;
        }
        let at = (means.len() - 1) * 98 / 100;
        *means.select_nth_unstable_by(at, f32::total_cmp).1
    }

    /// Part of the textures that views have seen.
    pub fn seen(&self) -> f32 {
        let seen = self.confidence.iter().filter(|c| **c > 0.0).count();
        let used = self
            .albedo
            .iter()
            .filter(|a| **a != [0.0; 3])
            .count()
            .max(seen);
        seen as f32 / used.max(1) as f32
    }
}

#[cfg(test)]
mod tests;
