//! What was measured: the photographs, their cameras and the mesh, read from a capture folder.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use rekindle_capture::Capture;
//!
//! let capture = Capture::load("capture".as_ref())?;
//! for view in &capture.views {
//!     println!("{}: {}×{}", view.name, view.camera.width, view.camera.height);
//! }
//! # Ok(())
//! # }
//! ```

mod brackets;
mod camera;
mod clipping;
mod colmap;
mod crop;
mod demo;
mod error;
mod fingerprint;
mod gltf;
mod isolated;
mod load;
mod manifest;
mod mesh;
mod mesh_file;
mod needs;
mod obj;
mod picture;
mod ply;
mod polygon;
#[cfg(test)]
mod programs;
mod raw;
mod reality_capture;
mod sfm_data;
#[cfg(test)]
mod tests;
mod write_cameras;

pub use brackets::{
    Brackets, ExposureUse, Group, KNOTS, MergedPhoto, Origin, Photo, Photos, Response, Settings,
    Shot,
};
pub use camera::{Camera, Distortion};
pub use crop::Crop;
pub use demo::{DEMO, demo_names, unpack_demo};
pub use error::CaptureError;
pub use load::{
    Covered, PixelCounts, input_files, read_cameras, read_covered, read_probe, read_radiance,
};
pub use mesh::{Mesh, SurfacePoint};
pub use mesh_file::origin_near;
pub use picture::exr_problem;
pub use write_cameras::{camera_matrix, transforms};

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use serde::{Deserialize, Serialize};

/// One photograph as linear radiance.
#[derive(Clone, Debug)]
pub struct Photograph {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Mean linear radiance over each pixel's area before a black background, RGB, row by row from the top:
    /// premultiplied by coverage. Finite everywhere: unusable pixels hold zero, but clipped ones the least that theirs can be.
    pub radiance: Vec<[f32; 3]>,
    /// Coverage of each pixel by the object in [0, 1], if the file or a mask states it.
    pub coverage: Option<Vec<f32>>,
    /// Whether each pixel is data: finite, not saturated, not masked out.
    pub usable: Vec<bool>,
    /// Whether each of the others is clipped, and its radiance the least that it can be; `None` where none is.
    pub clipped: Option<Vec<bool>>,
    /// Where it lies in the picture of its file, if it is only a part of that.
    pub crop: Option<Crop>,
}

impl Photograph {
    /// Whether a pixel is clipped: its radiance is the least that it can be.
    pub fn is_clipped(&self, pixel: usize) -> bool {
        self.clipped.as_ref().is_some_and(|clipped| clipped[pixel])
    }
}

/// One photograph with its camera.
#[derive(Clone, Debug)]
pub struct View {
    /// File path as the manifest has it.
    pub name: String,
    /// Where it was taken from; same size as the photograph, as if nothing more had been taken where that is cropped.
    pub camera: Camera,
    /// What was measured.
    pub photograph: Arc<Photograph>,
}

/// The hemisphere on which the lights are sought.
#[derive(Clone, Copy, Debug)]
pub struct LightHemisphere {
    /// Unit vector towards its pole.
    pub up: DVec3,
    /// Radius in mesh units about the object's centre, `None` for distant light.
    pub radius: Option<f64>,
    /// What the lights stand still with, where that is stated.
    pub frame: Option<LightFrame>,
}

/// What the lights stand still with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightFrame {
    /// The object: cameras go around it.
    #[default]
    World,
    /// The camera: the object turns before it, or the lights go with it. Directions and up are as at the first view.
    Camera,
}

impl LightFrame {
    /// Whether it is the object.
    pub fn is_world(&self) -> bool {
        *self == Self::World
    }
}

/// Everything measured of one object.
#[derive(Clone, Debug)]
pub struct Capture {
    /// The capture's name: its folder's.
    pub name: String,
    /// At least one view.
    pub views: Vec<View>,
    /// The surface, in the cameras' world frame.
    pub mesh: Mesh,
    /// Where lights are sought.
    pub light_hemisphere: LightHemisphere,
    /// Whether its photographs are single pictures of 8 bits, for each of which a camera may have chosen exposure and white balance.
    /// Raw files are none: they are linear, share a white balance, and say how they were exposed.
    pub is_developed: bool,
    /// How photographs of several exposures were merged, if there are any.
    pub brackets: Option<Brackets>,
    /// What a user should know of the input, in whole sentences.
    pub warnings: Vec<String>,
}

impl Capture {
    /// Where the light stands still with the camera, the rigid motion per view that brings the object, as it is before that camera, to
    /// where it is before the first: there the lights are the same for all. `None` where they stand still with the object, or there is a
    /// single view.
    pub fn motions(&self) -> Option<Vec<DAffine3>> {
        let turns = self.light_hemisphere.frame == Some(LightFrame::Camera);
        (turns && self.views.len() > 1).then(|| self.motions_of_camera())
    }

    /// The same, whatever the lights stand still with.
    pub fn motions_of_camera(&self) -> Vec<DAffine3> {
        let Some(first) = self.views.first() else {
            return Vec::new();
        };
        let first = first.camera.world_from_camera;
        let motion = |view: &View| first * view.camera.world_from_camera.inverse();
        self.views.iter().map(motion).collect()
    }
}
