//! What every pass of a frame knows: the mirrors of `frame.wgsl` and of the structures in `shade.wgsl`.

use bytemuck::{Pod, Zeroable};
use glam::{Mat3, Mat4, Vec3};

use rekindle_capture::Camera;
use rekindle_relight::Sky;

/// Colour that passes hand on: linear radiance, premultiplied by coverage.
pub(super) const LINEAR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Depth of the picture and of shadow maps.
pub(super) const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Mirror of `Frame` in `frame.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Default, Pod, Zeroable)]
pub(super) struct Frame {
    pub camera_x: [f32; 4],
    pub camera_y: [f32; 4],
    pub camera_z: [f32; 4],
    pub focal: [f32; 2],
    pub centre: [f32; 2],
    pub radial: [f32; 4],
    pub denominator: [f32; 4],
    pub tangential: [f32; 2],
    pub distorted: u32,
    pub near: f32,
    pub size: [f32; 2],
    pub sigma: f32,
    pub model: u32,
    pub mode: u32,
    pub flags: u32,
    pub always: [u32; 2],
    pub window: [u32; 2],
    pub window_weight: f32,
    pub first_word: u32,
    pub row_words: u32,
    pub shown_lamp: u32,
    pub walk_nodes: u32,
    pub half_vector: u32,
    pub ambient: [f32; 3],
    pub irradiance_scale: f32,
    pub rows: [u32; 2],
    pub radius: f32,
    pub strongest: f32,
    pub tint: [f32; 3],
    pub strength: f32,
    pub sky_x: [f32; 4],
    pub sky_y: [f32; 4],
    pub sky_z: [f32; 4],
    pub sky_levels: u32,
    pub unused: [u32; 3],
}

/// The diffuse part is the stored texture.
pub(super) const STORED: u32 = 1;
/// Pixels are covered in part, as the coverage texture says.
pub(super) const COVERAGE: u32 = 2;
/// First of the flags that say which shadow maps are in use.
pub(super) const FIRST_SHADOW_MAP: u32 = 16;

/// Mirror of `Lobe` in `shade.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Default, Pod, Zeroable)]
pub(super) struct GpuLobe {
    pub place: [f32; 3],
    pub spread: f32,
    pub flux: [f32; 3],
    pub bits: u32,
}

/// Mirror of `ShadowMap` in `shade.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Default, Pod, Zeroable)]
pub(super) struct GpuShadowMap {
    pub clip_from_world: [[f32; 4]; 4],
    pub place: [f32; 3],
    pub softness: f32,
    pub near_plane: f32,
    pub far_plane: f32,
    pub half_tangent: f32,
    pub texel: f32,
}

impl GpuShadowMap {
    pub(super) fn set_matrix(&mut self, matrix: Mat4) {
        self.clip_from_world = matrix.to_cols_array_2d();
    }
}

impl Frame {
    /// The sky of an environment, in units of radiance `unit`.
    pub(super) fn set_sky(&mut self, sky: &Sky, unit: f32) {
        let turn = Mat3::from_quat(sky.turn().inverse()).transpose();
        let gain = sky.gain() / unit;
        self.sky_x = turn.x_axis.extend(gain.x).to_array();
        self.sky_y = turn.y_axis.extend(gain.y).to_array();
        self.sky_z = turn.z_axis.extend(gain.z).to_array();
        self.sky_levels = sky.levels().len() as u32;
    }

    /// A camera, its picture moved by `jitter` pixels, before an object of `radius` about `centre`.
    pub(super) fn set_camera(
        &mut self,
        camera: &Camera,
        centre: Vec3,
        radius: f32,
        jitter: [f32; 2],
    ) {
        let eye = (camera.position() - centre.as_dvec3()).as_vec3();
        let axes = camera.world_from_camera.matrix3;
        let row = |axis: glam::DVec3, w: f32| axis.as_vec3().extend(w).to_array();
        self.camera_x = row(axes.x_axis, eye.x);
        self.camera_y = row(axes.y_axis, eye.y);
        self.camera_z = row(axes.z_axis, eye.z);
        let size = [f64::from(camera.width), f64::from(camera.height)];
        let ndc_focal = |f: f64, size: f64| (2.0 * f / size) as f32;
        let ndc_centre =
            |c: f64, jitter: f32, size: f64| (2.0 * (c - f64::from(jitter)) / size - 1.0) as f32;
        self.focal = [
            ndc_focal(camera.focal.x, size[0]),
            ndc_focal(camera.focal.y, size[1]),
        ];
        self.centre = [
            ndc_centre(camera.centre.x, jitter[0], size[0]),
            ndc_centre(camera.centre.y, jitter[1], size[1]),
        ];
        let d = &camera.distortion;
        self.distorted = if d.fisheye {
            2
        } else {
            u32::from(!d.is_none())
        };
        self.radial = d.k.map(|k| k as f32);
        self.tangential = d.p.map(|p| p as f32);
        let [a, b, c] = d.denominator.map(|k| k as f32);
        self.denominator = [a, b, c, 0.0];
        // As far as the object allows, so that nothing of it is cut off.
        self.near = (eye.length() - 1.01 * radius).max(1e-3 * radius);
        self.size = size.map(|s| s as f32);
        self.radius = radius;
    }
}
