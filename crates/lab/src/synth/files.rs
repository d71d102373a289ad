//! The files of a made capture: photographs, their parts, and the manifests that say from where they were taken.

use std::borrow::Cow;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use glam::Vec3;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::recipe::{Encode, Files, Mistake, Sensor};
use super::sensor::Exposed;
use rekindle_base::math::random::Random;
use rekindle_capture::{Camera, LightFrame, camera_matrix};
use rekindle_relight::Picture;
use rekindle_solution::write_rgba;

/// A folder with a `transforms.json` and pictures.
pub(super) struct Folder {
    path: PathBuf,
    /// How far below the capture's folder it is.
    depth: usize,
    light_distance: Option<f32>,
    light_frame: LightFrame,
}

/// How one view is stated: all of its frame but the camera.
pub(super) struct Frame(Value);

impl Folder {
    pub(super) fn new(
        path: &Path,
        depth: usize,
        light_distance: Option<f32>,
        light_frame: LightFrame,
    ) -> Self {
        Self {
            path: path.to_owned(),
            depth,
            light_distance,
            light_frame,
        }
    }

    /// Pictures without noise, with their manifest.
    pub(super) fn write_clean(&self, cameras: &[Camera], pictures: &[Picture]) -> io::Result<()> {
        fs::create_dir_all(self.path.join("images"))?;
        let frames = pictures.par_iter().enumerate().map(|(i, picture)| {
            let name = format!("images/view_{i:03}.exr");
            let (path, width) = (self.path.join(&name), picture.width);
            write_rgba(&path, width, &sum(picture), &picture.coverage)?;
            Ok(Frame(json!({ "file_path": name })))
        });
        let frames = frames.collect::<io::Result<Vec<Frame>>>()?;
        self.write_manifest(cameras, frames)
    }

    /// The diffuse and the specular part of pictures, and where they were really taken from.
    pub(super) fn write_split(&self, cameras: &[Camera], pictures: &[Picture]) -> io::Result<()> {
        for part in ["diffuse", "specular"] {
            fs::create_dir_all(self.path.join(part))?;
        }
        pictures
            .par_iter()
            .enumerate()
            .try_for_each(|(i, picture)| {
                for (part, values) in [
                    ("diffuse", &picture.diffuse),
                    ("specular", &picture.specular),
                ] {
                    let path = self.path.join(part).join(format!("view_{i:03}.exr"));
                    write_rgba(&path, picture.width, values, &picture.coverage)?;
                }
                Ok::<(), io::Error>(())
            })?;
        let frame = |i| Frame(json!({ "file_path": format!("diffuse/view_{i:03}.exr") }));
        self.write_manifest(cameras, (0..pictures.len()).map(frame).collect())
    }

    /// `transforms.json`, one frame a camera.
    pub(super) fn write_manifest(&self, cameras: &[Camera], frames: Vec<Frame>) -> io::Result<()> {
        let Some(first) = cameras.first() else {
            return Ok(());
        };
        let frames: Vec<Value> = cameras
            .iter()
            .zip(frames)
            .map(|(camera, Frame(mut frame))| {
                frame["transform_matrix"] = camera_matrix(camera);
                frame
            })
            .collect();
        let mut hemisphere = json!({ "up": [0, 1, 0], "radius": self.light_distance });
        if !self.light_frame.is_world() {
            hemisphere["frame"] = json!(self.light_frame);
        }
        let manifest = json!({
            "camera_model": "PINHOLE",
            "w": first.width,
            "h": first.height,
            "fl_x": first.focal.x,
            "fl_y": first.focal.y,
            "cx": first.centre.x,
            "cy": first.centre.y,
            "mesh_path": format!("{}mesh.obj", "../".repeat(self.depth)),
            "light_hemisphere": hemisphere,
            "frames": frames,
        });
        write_json(&self.path.join("transforms.json"), &manifest)
    }
}

/// What a sensor has read of pictures.
pub(super) struct Taken<'a> {
    pictures: &'a [Picture],
    /// RGB of every view, premultiplied by coverage.
    read: Vec<Vec<[f32; 3]>>,
    /// Whether files state no coverage.
    opaque: bool,
}

impl<'a> Taken<'a> {
    pub(super) fn new(exposed: &Exposed, pictures: &'a [Picture]) -> Self {
        let read = pictures.par_iter().enumerate();
        Self {
            pictures,
            read: read.map(|(i, picture)| exposed.read(i, picture)).collect(),
            opaque: false,
        }
    }

    /// Puts a mistake into all of it.
    pub(super) fn spoil(&mut self, mistake: Mistake, random: Random) {
        mistake.spoil(&mut self.read, self.pictures, random);
        self.opaque = mistake.is_opaque();
    }
}

/// Writes photographs as files of a sensor that is full at a radiance.
pub(super) fn photographs(
    folder: &Folder,
    sensor: Sensor,
    taken: &Taken,
    full_scale: f32,
    times: Random,
) -> io::Result<Vec<Frame>> {
    fs::create_dir_all(folder.path.join("images"))?;
    let Taken { pictures, read, .. } = taken;
    // The shortest of a bracket's exposures has the brightest pixel at full scale, or the sensor's.
    let brightest = read
        .iter()
        .flatten()
        .flatten()
        .fold(0.0_f32, |m, &v| m.max(v));
    let full_scale = f64::from(full_scale.min(brightest).max(f32::MIN_POSITIVE));
    (0..pictures.len())
        .into_par_iter()
        .map(|i| {
            let (mut picture, read) = (Cow::Borrowed(&pictures[i]), &read[i]);
            if taken.opaque {
                picture.to_mut().coverage.fill(1.0);
            }
            match sensor.files {
                Files::Exr => exposure(folder, i, &picture, read, None),
                Files::Exposures(stops) => {
                    let time = (f64::from(stops) * (times.uniform(i as u64) - 0.5)).exp2();
                    exposure(folder, i, &picture, read, Some(time))
                }
                Files::Brackets { count, stops } => {
                    let times = (0..count).map(|k| f64::from(k * stops).exp2() / full_scale);
                    bracket(folder, i, &picture, read, times, sensor.response)
                }
            }
        })
        .collect()
}

/// One EXR file, in units of its exposure time where that is stated.
fn exposure(
    folder: &Folder,
    view: usize,
    picture: &Picture,
    read: &[[f32; 3]],
    time: Option<f64>,
) -> io::Result<Frame> {
    let name = format!("images/view_{view:03}.exr");
    let factor = time.unwrap_or(1.0) as f32;
    let values: Vec<[f32; 3]> = read.iter().map(|p| p.map(|v| v * factor)).collect();
    write_rgba(
        &folder.path.join(&name),
        picture.width,
        &values,
        &picture.coverage,
    )?;
    Ok(Frame(match time {
        None => json!({ "file_path": name }),
        Some(time) => {
            json!({ "exposures": [{ "file_path": name, "exposure_time": time }] })
        }
    }))
}

/// 8-bit PNG files of exposure times, which grow.
fn bracket(
    folder: &Folder,
    view: usize,
    picture: &Picture,
    read: &[[f32; 3]],
    times: impl Iterator<Item = f64>,
    response: Encode,
) -> io::Result<Frame> {
    let exposures = times.enumerate().map(|(k, time)| {
        let name = format!("images/view_{view:03}_{k}.png");
        let mut bytes = Vec::with_capacity(4 * read.len());
        for (pixel, coverage) in read.iter().zip(&picture.coverage) {
            // Alpha is straight in PNG files.
            let straight = Vec3::from(*pixel) * (time as f32) / coverage.max(f32::MIN_POSITIVE);
            let code = |v: f32| (255.0 * v).round() as u8;
            bytes.extend(straight.to_array().map(|v| code(response.code(v))));
            bytes.push(code(*coverage));
        }
        let path = folder.path.join(&name);
        let (width, height) = (picture.width, picture.height);
        image::save_buffer(path, &bytes, width, height, image::ColorType::Rgba8)
            .map_err(io::Error::other)?;
        Ok(json!({ "file_path": name, "exposure_time": time }))
    });
    let exposures = exposures.collect::<io::Result<Vec<Value>>>()?;
    Ok(Frame(json!({ "exposures": exposures })))
}

/// Radiance of every pixel.
fn sum(picture: &Picture) -> Vec<[f32; 3]> {
    let parts = picture.diffuse.iter().zip(&picture.specular);
    parts
        .map(|(&d, &s)| (Vec3::from(d) + Vec3::from(s)).to_array())
        .collect()
}

pub(super) fn write_json(path: &Path, value: &Value) -> io::Result<()> {
    fs::write(path, serde_json::to_vec_pretty(value)?)
}
