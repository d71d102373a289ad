//! `solution.json` and `nodes.json`: what is written, field by field, and what is checked when they are read.

use serde::{Deserialize, Serialize};

use super::KnownLight;
use rekindle_capture::LightFrame;
use rekindle_estimate::estimate::{Diagnostics, Iteration, Method};
use rekindle_estimate::registration::Correction;
use rekindle_scene::reflectance::{Gloss, SpecularModel};
use rekindle_scene::shortcuts::LeftOut;

/// What `format` says.
pub(super) const FORMAT: &str = "rekindle-solution";
/// The newest version that can be read, written where parts of the surface reflect in different colours, …
pub(super) const VERSION: u32 = 3;
/// … where they differ in gloss, and where they don't: older programs read these too.
pub(super) const VERSION_OF_WHITE_GLOSS: u32 = 2;
pub(super) const VERSION_OF_ONE_GLOSS: u32 = 1;

/// Read before everything else, so that a newer file is recognised whatever else it holds.
#[derive(Deserialize)]
pub(super) struct Head {
    pub(super) format: String,
    pub(super) version: u32,
}

/// Read where a solution is to be replaced, of any version.
#[derive(Deserialize)]
pub(super) struct Listed {
    #[serde(default)]
    pub(super) format: String,
    #[serde(default)]
    pub(super) files: Vec<String>,
}

#[derive(Serialize, Deserialize)]
pub(super) struct Manifest {
    pub(super) format: String,
    pub(super) version: u32,
    /// All files of the solution, by their paths in its folder; nothing in solutions that were written before they were
    /// listed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) files: Vec<String>,
    pub(super) name: String,
    /// Nothing in solutions that were written before it was kept.
    #[serde(default)]
    pub(super) origin: String,
    pub(super) method: Method,
    pub(super) specular_model: Option<SpecularModel>,
    pub(super) chosen_because: String,
    /// What was corrected about each view; nothing where all were taken as stated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) corrections: Vec<Correction>,
    pub(super) sigma: Option<f32>,
    pub(super) sigma_interval95: Option<[f32; 2]>,
    /// Where the light was given and not estimated; not in solutions that were written before it could be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) known_light: Option<KnownLight>,
    /// The glosses of the parts, where they differ; there are textures then.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) gloss_parts: Vec<Gloss>,
    pub(super) hemisphere: Hemisphere,
    pub(super) lights: Vec<Light>,
    /// Radiance from every direction alike, RGB, K_S-scaled.
    pub(super) ambient: [f32; 3],
    pub(super) diagnostics: Diagnostics,
    pub(super) fit: Fit,
    /// Nothing in solutions that were written before it was counted.
    #[serde(default, skip_serializing_if = "Skipped::is_empty")]
    pub(super) skipped: Skipped,
    pub(super) timings_s: serde_json::Map<String, serde_json::Value>,
    pub(super) convergence: Vec<Iteration>,
    pub(super) texture: Texture,
}

#[derive(Serialize, Deserialize)]
pub(super) struct Hemisphere {
    pub(super) frequency: u32,
    pub(super) nodes: usize,
    pub(super) active: usize,
    pub(super) up: [f32; 3],
    pub(super) radius: Option<f32>,
    /// Directions are as at the first camera where the lights stand still with the camera.
    #[serde(default, skip_serializing_if = "LightFrame::is_world")]
    pub(super) frame: LightFrame,
    /// In the world.
    pub(super) centre: [f64; 3],
}

#[derive(Serialize, Deserialize)]
pub(super) struct Light {
    pub(super) id: usize,
    pub(super) name: String,
    pub(super) direction: [f32; 3],
    pub(super) flux: [f32; 3],
    pub(super) angular_radius_deg: f32,
    pub(super) nodes: usize,
}

/// How well the solution reproduces the input views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Root mean square of measured − rendered over all pixels inside the object, in radiance.
    pub residual_rms: f64,
    /// PSNR of each view, sRGB-encoded, white at its 99.5th percentile, in dB.
    pub psnr_db_per_view: Vec<f32>,
    /// What lights and roughness leave of the differences between views beyond noise, as a part of them; see
    /// [`rekindle_estimate::estimate::misfit`]. None where there are no lights, or they are not of the default method.
    #[serde(default)]
    pub misfit: Option<f64>,
}

/// What a solve did not do because the capture doesn't need it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Skipped {
    /// Parts of the estimation, each with how much of it was left out; `rekindle solve --do-all` does them.
    pub left_out: Vec<LeftOut>,
    /// Stages that were not needed, each with the reason.
    pub stages: Vec<String>,
}

impl Skipped {
    fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

#[derive(Serialize, Deserialize)]
pub(super) struct Texture {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) own_uvs: bool,
}

/// The lit nodes and which lamp each belongs to.
#[derive(Serialize, Deserialize)]
pub(super) struct Nodes {
    /// Index and radiance, RGB, by rising index.
    pub(super) lit: Vec<(u32, [f32; 3])>,
    /// Node indices of each light, in the lights' order.
    pub(super) lights: Vec<Vec<u32>>,
}
