//! Cameras in front of the object, and cameras that are not where they are said to be.

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};

use super::lamps::towards;
use super::recipe::Views;
use rekindle_base::math::random::Random;
use rekindle_capture::{Camera, Distortion, Mesh};

/// Distance from the object's centre, in radii of the object.
const DISTANCE: f64 = 4.0;
/// Part of the picture's shorter side that the object's bounding ball fills.
const FILLED: f64 = 0.94;
/// Elevations that input views take in turn, radians; several, so that highlights move both ways.
const ELEVATIONS: [f32; 3] = [0.15, 0.75, 0.45];
/// The one from which a turntable is looked at.
const TURNTABLE_ELEVATION: f32 = 0.45;
/// Every input view is off its place by up to this angle, radians.
const JITTER: f32 = 0.06;
/// Azimuth, as a part of the arc to either side, and elevation of the novel views.
const NOVEL: [[f32; 2]; 4] = [[-0.7, 0.35], [-0.2, 0.6], [0.3, 0.25], [0.8, 0.55]];

/// Looks at an object from a distance.
#[derive(Clone, Copy)]
pub(super) struct Stand {
    centre: DVec3,
    radius: f64,
    views: Views,
}

impl Stand {
    pub(super) fn new(mesh: &Mesh, views: Views) -> Self {
        let centre = mesh.centre();
        let radius = mesh
            .positions
            .iter()
            .map(|p| p.distance(centre))
            .fold(0.0, f32::max);
        Self {
            centre: centre.as_dvec3(),
            radius: radius.into(),
            views,
        }
    }

    /// Radius of the object about its centre.
    pub(super) fn object_radius(&self) -> f64 {
        self.radius
    }

    /// Pixels along a unit of length where the object is nearest.
    pub(super) fn largest_magnification(&self) -> f64 {
        self.focal() / ((DISTANCE - 1.0) * self.radius)
    }

    /// Focal length in pixels.
    fn focal(&self) -> f64 {
        let [width, height] = self.views.size.map(f64::from);
        // The ball's outline is seen at the angle asin(1/distance).
        0.5 * FILLED * width.min(height) * (DISTANCE * DISTANCE - 1.0).sqrt()
    }

    /// The cameras of the photographs.
    pub(super) fn input(&self, random: Random) -> Vec<Camera> {
        (0..self.views.count)
            .map(|i| {
                let jitter =
                    |k: u64| JITTER * (2.0 * random.uniform(2 * u64::from(i) + k) as f32 - 1.0);
                let along = (i as f32 + 0.5) / self.views.count as f32 - 0.5;
                let elevation = if self.views.turntable {
                    TURNTABLE_ELEVATION
                } else {
                    ELEVATIONS[i as usize % ELEVATIONS.len()] + jitter(1)
                };
                self.camera([self.views.arc * along + jitter(0), elevation])
            })
            .collect()
    }

    /// Cameras between those of the photographs.
    pub(super) fn novel(&self) -> Vec<Camera> {
        NOVEL
            .iter()
            .map(|&[part, elevation]| {
                let elevation = if self.views.turntable {
                    TURNTABLE_ELEVATION
                } else {
                    elevation
                };
                self.camera([0.5 * self.views.arc * part, elevation])
            })
            .collect()
    }

    fn camera(&self, place: [f32; 2]) -> Camera {
        let backward = towards(place).as_dvec3().normalize_or(DVec3::Z);
        let right = DVec3::Y.cross(backward).normalize_or(DVec3::X);
        let [width, height] = self.views.size;
        Camera {
            width,
            height,
            focal: DVec2::splat(self.focal()),
            centre: DVec2::new(width.into(), height.into()) * 0.5,
            distortion: Distortion::default(),
            world_from_camera: DAffine3::from_mat3_translation(
                DMat3::from_cols(right, backward.cross(right), backward),
                self.centre + backward * (DISTANCE * self.radius),
            ),
        }
    }
}

/// A camera turned in its place by `angle`, radians, about a random axis.
pub(super) fn misaligned(camera: &Camera, angle: f32, random: Random) -> Camera {
    let turn = DMat3::from_quat(DQuat::from_axis_angle(random.direction(0), angle.into()));
    let mut turned = camera.clone();
    turned.world_from_camera.matrix3 = turn * camera.world_from_camera.matrix3;
    turned
}
