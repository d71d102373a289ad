//! The light of the place, where it is known: what a solve is given, and what a solution says of it.

use std::f32::consts::PI;
use std::hash::{Hash, Hasher};
use std::path::Path;
use std::sync::Arc;

use glam::{Quat, Vec2, Vec3};
use serde::{Deserialize, Serialize};

use super::{Solution, SolutionError, SolveOptions};
use rekindle_capture::{Capture, CaptureError, LightFrame};
use rekindle_relight::LatLong;
use rekindle_scene::hemisphere::{HemisphereGrid, Picture, lat_long_from_direction};
use rekindle_scene::reflectance::Brdf;

/// Part of the light below the horizon from which on it is taken in.
const LEAST_BELOW: f32 = 1e-3;

/// A picture of all the light that shone on the object, and how it is turned.
///
/// The picture is a lat-long map as [`lat_long_from_direction`] says, its top
/// towards the capture's up, and its radiance in the photographs' units.
#[derive(Clone, Debug)]
pub struct LightProbe {
    file: String,
    picture: Arc<LatLong>,
    /// Turn about the capture's up, radians, counter-clockwise seen from above; sought where it is not stated.
    pub turn: Option<f32>,
}

impl LightProbe {
    /// Refuses captures whose lights stand still with the camera: the picture is of a place around the object.
    pub fn check(&self, capture: &Capture, options: &SolveOptions) -> Result<(), SolutionError> {
        let stated = capture.light_hemisphere.frame;
        match options.light_frame.or(stated) {
            None | Some(LightFrame::World) => Ok(()),
            Some(LightFrame::Camera) => Err(SolutionError::LightTurns {
                capture: capture.name.clone(),
            }),
        }
    }

    /// Reads a picture; `turn` is in radians.
    pub fn load(path: &Path, turn: Option<f32>) -> Result<Self, CaptureError> {
        let name = path.file_name().unwrap_or(path.as_os_str());
        Ok(Self {
            file: name.to_string_lossy().into_owned(),
            picture: Arc::new(LatLong::load_probe(path)?),
            turn,
        })
    }

    /// The name of its file.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// The picture: linear radiance, row by row from the top, at most as fine as any lobe needs.
    pub fn picture(&self) -> Picture {
        let (width, height) = self.picture.size();
        Picture {
            width: width as u32,
            height: height as u32,
            radiance: self.picture.pixels().iter().map(Vec3::to_array).collect(),
        }
    }

    /// Where the unturned picture has a direction of a world with this `up`, as parts of its width and height from its top left
    /// corner.
    pub fn place_of(up: Vec3, direction: Vec3) -> Vec2 {
        lat_long_from_direction(Self::world_from_picture(up, 0.0).inverse() * direction)
    }

    /// The rotation from the picture's directions to the world's when it is turned about `up` by an angle, radians.
    fn world_from_picture(up: Vec3, turn: f32) -> Quat {
        Quat::from_axis_angle(up, turn) * Quat::from_rotation_arc(Vec3::Y, up)
    }

    /// The nodes of a grid, or with those below the horizon where light comes from there.
    pub(super) fn grid(&self, above: HemisphereGrid) -> HemisphereGrid {
        let upright = Self::world_from_picture(above.up, 0.0);
        if self.picture.share_below(upright, above.up) > LEAST_BELOW {
            above.to_whole()
        } else {
            above
        }
    }

    /// Radiance of each node of a grid, RGB, when it is turned by an angle, radians.
    pub(super) fn on_nodes(&self, grid: &HemisphereGrid, turn: f32) -> Vec<[f32; 3]> {
        let turn = Self::world_from_picture(grid.up, turn);
        self.picture.on_nodes(grid, turn)
    }
}

impl Hash for LightProbe {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.file.hash(state);
        self.turn.map(f32::to_bits).hash(state);
        for pixel in self.picture.pixels() {
            pixel.to_array().map(f32::to_bits).hash(state);
        }
    }
}

/// What a solution says of the light that it was given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KnownLight {
    /// Name of the picture's file.
    pub file: String,
    /// Turn about the hemisphere's pole, degrees, counter-clockwise seen from the pole.
    pub rotation_deg: f32,
    /// Whether the turn was stated; it was sought otherwise.
    pub rotation_stated: bool,
    /// Reflectance at normal incidence of each channel, F₀; 0 where no specular part was found.
    pub specular_reflectance: [f32; 3],
    /// What pseudo-albedo is to be multiplied by for the diffuse albedo, the base colour of other programs, 0 to 1.
    pub albedo_scale: f32,
}

impl KnownLight {
    /// Under a probe turned by `turn`, radians, for a lobe and its `K_S`.
    pub(super) fn new(probe: &LightProbe, turn: f32, brdf: Option<Brdf>, scale: [f32; 3]) -> Self {
        let unit = brdf.map_or(0.0, |brdf| 8.0 * PI * brdf.sigma * brdf.sigma);
        let reflectance = scale.map(|k| unit * k);
        Self {
            file: probe.file.clone(),
            rotation_deg: turn.to_degrees().rem_euclid(360.0),
            rotation_stated: probe.turn.is_some(),
            specular_reflectance: reflectance,
            albedo_scale: PI * mean(scale) / (1.0 - mean(reflectance)).max(0.1),
        }
    }

    /// The reflectance at normal incidence in the mean over channels.
    pub fn reflectance(&self) -> f32 {
        mean(self.specular_reflectance)
    }

    /// Colour of what is reflected specularly, 1 in the mean.
    pub(super) fn tint(&self) -> Option<Vec3> {
        let mean = self.reflectance();
        (mean > 0.0).then(|| Vec3::from(self.specular_reflectance) / mean)
    }

    /// Why it can't be one that was written, if so.
    pub(super) fn fault(&self) -> Option<&'static str> {
        let is_sound = |v: f32| v.is_finite() && v >= 0.0;
        let values = self.specular_reflectance.into_iter();
        if !values.chain([self.albedo_scale]).all(is_sound) || !self.rotation_deg.is_finite() {
            return Some("known_light has a number that is negative or not finite");
        }
        None
    }
}

fn mean(of_channels: [f32; 3]) -> f32 {
    of_channels.iter().sum::<f32>() / 3.0
}

impl Solution {
    /// Reflectance at normal incidence where the light was given: it follows from it then.
    pub fn known_reflectance(&self) -> Option<f32> {
        let known = self.known_light.as_ref()?;
        self.brdf.map(|_| known.reflectance())
    }

    /// Diffuse albedo of the brightest parts, 0 to 1, where the light was given.
    pub fn known_white(&self) -> Option<f32> {
        let known = self.known_light.as_ref()?;
        Some(known.albedo_scale * self.brightest(&self.albedo))
    }
}
