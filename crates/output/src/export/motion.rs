//! Cameras and lights that move from frame to frame.

use std::f64::consts::TAU;

use glam::{DQuat, DVec2, DVec3, Quat};

use rekindle_capture::Camera;
use rekindle_relight::Lighting;

/// The same view with another size: the height shows what it showed, the width shows more or less.
pub fn with_size(camera: &Camera, width: u32, height: u32) -> Camera {
    let scale = f64::from(height) / f64::from(camera.height.max(1));
    let middle = DVec2::new(f64::from(camera.width), f64::from(camera.height)) * 0.5;
    let new_middle = DVec2::new(f64::from(width), f64::from(height)) * 0.5;
    Camera {
        width,
        height,
        focal: camera.focal * scale,
        centre: new_middle + (camera.centre - middle) * scale,
        ..camera.clone()
    }
}

/// Cameras on a full circle about the axis through `centre` along the unit vector `up`, the first at `camera`; the one after
/// the last would be the first again.
pub fn turntable(camera: &Camera, centre: DVec3, up: DVec3, frames: u32) -> Vec<Camera> {
    (0..frames)
        .map(|frame| {
            let turn = DQuat::from_axis_angle(up, TAU * f64::from(frame) / f64::from(frames));
            let mut turned = camera.clone();
            let pose = &mut turned.world_from_camera;
            pose.translation = centre + turn * (pose.translation - centre);
            pose.matrix3 = glam::DMat3::from_quat(turn) * pose.matrix3;
            turned
        })
        .collect()
}

/// Lightings in which one lamp goes once around the hemisphere's pole.
pub fn lamp_circle(lighting: &Lighting, lamp: usize, frames: u32) -> Vec<Lighting> {
    (0..frames)
        .map(|frame| {
            let angle = TAU * f64::from(frame) / f64::from(frames);
            let turn = Quat::from_axis_angle(lighting.up, angle as f32);
            let mut turned = lighting.clone();
            if let Some(lamp) = turned.lamps.get_mut(lamp).filter(|_| frame > 0) {
                let to = turn * lamp.direction;
                lamp.turn_towards(to.normalize_or(lamp.direction));
            }
            turned
        })
        .collect()
}
