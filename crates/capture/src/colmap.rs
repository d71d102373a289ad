//! COLMAP models, text or binary, as the manifest that nerfstudio would write for them.
//!
//! COLMAP states world-to-camera rotations and translations with axes +X right, +Y down, looking along +Z; the mesh is in
//! the model's world frame.

use super::error::CaptureError;
use super::manifest::found;
use glam::{DMat3, DMat4, DQuat, DVec3};
use rekindle_base::files;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where a model may lie in a capture's folder.
const PLACES: [&str; 5] = ["", "sparse/0", "sparse", "colmap/sparse/0", "dense/sparse"];

/// Camera models by their number in binary files, with their parameters by nerfstudio's names. A focal length `f` is that of
/// both axes. Those without names are refused later by name.
const MODELS: [(&str, usize, &[&str]); 18] = [
    ("SIMPLE_PINHOLE", 3, &["f", "cx", "cy"]),
    ("PINHOLE", 4, &["fl_x", "fl_y", "cx", "cy"]),
    ("SIMPLE_RADIAL", 4, &["f", "cx", "cy", "k1"]),
    ("RADIAL", 5, &["f", "cx", "cy", "k1", "k2"]),
    (
        "OPENCV",
        8,
        &["fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"],
    ),
    (
        "OPENCV_FISHEYE",
        8,
        &["fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4"],
    ),
    (
        "FULL_OPENCV",
        12,
        &[
            "fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6",
        ],
    ),
    ("FOV", 5, &[]),
    ("SIMPLE_RADIAL_FISHEYE", 4, &[]),
    ("RADIAL_FISHEYE", 5, &[]),
    ("THIN_PRISM_FISHEYE", 12, &[]),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16, &[]),
    ("SIMPLE_DIVISION", 4, &[]),
    ("DIVISION", 5, &[]),
    ("SIMPLE_FISHEYE", 3, &[]),
    ("FISHEYE", 4, &[]),
    ("EUCM", 6, &[]),
    ("EQUIRECTANGULAR", 2, &[]),
];

/// The fields of a frame that a camera gives, by the camera's number.
type Cameras = BTreeMap<u64, Map<String, Value>>;

/// An image of a model.
struct Image {
    name: String,
    camera: u64,
    rotation: [f64; 4],
    translation: [f64; 3],
}

/// The model's file of images in a capture's folder, if there is a model.
pub(super) fn locate(folder: &Path) -> Option<PathBuf> {
    PLACES
        .iter()
        .flat_map(|place| ["images.bin", "images.txt"].map(|name| folder.join(place).join(name)))
        .find(|images| images.is_file() && images.with_file_name(cameras_of(images)).is_file())
}

fn is_binary(images: &Path) -> bool {
    images.extension().is_some_and(|ending| ending == "bin")
}

fn cameras_of(images: &Path) -> &'static str {
    if is_binary(images) {
        "cameras.bin"
    } else {
        "cameras.txt"
    }
}

/// The manifest for the model whose file of images is `images`, in the capture's `folder`.
pub(super) fn read(folder: &Path, images: &Path) -> Result<Value, CaptureError> {
    let cameras_path = images.with_file_name(cameras_of(images));
    let read = |path: &Path| {
        files::read(path).map_err(|source| CaptureError::Unreadable {
            path: path.to_owned(),
            source,
        })
    };
    let broken = |path: &Path, place: String| CaptureError::Field {
        path: path.to_owned(),
        field: place,
        problem: "is not as COLMAP writes it".to_owned(),
        advice: "export the model anew".to_owned(),
    };
    let (camera_bytes, image_bytes) = (read(&cameras_path)?, read(images)?);
    let cameras = if is_binary(images) {
        binary_cameras(&camera_bytes).ok_or("the file".to_owned())
    } else {
        text_cameras(&camera_bytes).map_err(|line| format!("line {line}"))
    };
    let cameras = cameras.map_err(|place| broken(&cameras_path, place))?;
    let found = if is_binary(images) {
        binary_images(&image_bytes).ok_or("the file".to_owned())
    } else {
        text_images(&image_bytes).map_err(|line| format!("line {line}"))
    };
    let mut found = found.map_err(|place| broken(images, place))?;
    found.sort_by(|a, b| a.name.cmp(&b.name));
    let mut frames = Vec::with_capacity(found.len());
    for image in found {
        let Some(camera) = cameras.get(&image.camera) else {
            return Err(CaptureError::Field {
                path: images.to_owned(),
                field: image.name,
                problem: format!(
                    "has camera {}, which {} lacks",
                    image.camera,
                    cameras_of(images)
                ),
                advice: "export the model anew".to_owned(),
            });
        };
        frames.push(frame(folder, &image, camera.clone()));
    }
    Ok(json!({ "frames": frames }))
}

fn frame(folder: &Path, image: &Image, mut fields: Map<String, Value>) -> Value {
    let name = ["images/", "input/", ""]
        .iter()
        .find_map(|place| found(folder, &format!("{place}{}", image.name)))
        .unwrap_or_else(|| format!("images/{}", image.name));
    let [w, x, y, z] = image.rotation;
    let camera_from_world = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let world_from_camera = camera_from_world.transpose();
    let position = -(world_from_camera * DVec3::from(image.translation));
    // To axes with +Y up, looking along −Z.
    let axes = world_from_camera * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let mut pose = DMat4::from_mat3(axes);
    pose.w_axis = position.extend(1.0);
    let rows = pose.transpose().to_cols_array_2d();
    fields.insert("file_path".to_owned(), json!(name));
    fields.insert("transform_matrix".to_owned(), json!(rows));
    Value::Object(fields)
}

/// The fields that a camera gives to its frames.
fn camera(model: &str, size: [u64; 2], values: &[f64]) -> Option<Map<String, Value>> {
    let mut fields = Map::new();
    fields.insert("camera_model".to_owned(), json!(model));
    fields.insert("w".to_owned(), json!(size[0]));
    fields.insert("h".to_owned(), json!(size[1]));
    let known = MODELS.iter().find(|(name, ..)| *name == model);
    let names = known.map_or(&[][..], |(.., names)| *names);
    if values.len() < names.len() {
        return None;
    }
    for (name, value) in names.iter().zip(values) {
        let axes: &[&str] = if *name == "f" {
            &["fl_x", "fl_y"]
        } else {
            &[name]
        };
        for axis in axes {
            fields.insert((*axis).to_owned(), json!(value));
        }
    }
    Some(fields)
}

/// The lines of a text file that are no comments, with their numbers.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, String)> {
    let lines = bytes.split(|&b| b == b'\n').enumerate();
    lines
        .map(|(i, line)| (i + 1, String::from_utf8_lossy(line).trim().to_owned()))
        .filter(|(_, line)| !line.starts_with('#'))
}

/// The cameras, or the number of the first bad line.
fn text_cameras(bytes: &[u8]) -> Result<Cameras, usize> {
    let parse = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [id, model, width, height, values @ ..] = words.as_slice() else {
            return None;
        };
        let values: Option<Vec<f64>> = values.iter().map(|word| word.parse().ok()).collect();
        let size = [width.parse().ok()?, height.parse().ok()?];
        Some((id.parse().ok()?, camera(model, size, &values?)?))
    };
    lines(bytes)
        .filter(|(_, line)| !line.is_empty())
        .map(|(number, line)| parse(&line).ok_or(number))
        .collect()
}

/// The images, or the number of the first bad line. The line of points that follows each image may be missing.
fn text_images(bytes: &[u8]) -> Result<Vec<Image>, usize> {
    let mut images = Vec::new();
    let mut after_image = false;
    for (number, line) in lines(bytes) {
        let points = line.is_empty() || after_image && is_points(&line);
        after_image = !points;
        if !points {
            images.push(text_image(&line).ok_or(number)?);
        }
    }
    Ok(images)
}

/// An image's own line. Its name, which comes last, may hold spaces.
fn text_image(line: &str) -> Option<Image> {
    let mut rest = line;
    let mut word = || {
        let (word, after) = rest.split_once(char::is_whitespace)?;
        rest = after.trim_start();
        Some(word)
    };
    let _id: u64 = word()?.parse().ok()?;
    let mut number = || word()?.parse::<f64>().ok();
    let rotation = [number()?, number()?, number()?, number()?];
    let translation = [number()?, number()?, number()?];
    let camera = word()?.parse().ok()?;
    (!rest.is_empty()).then(|| Image {
        camera,
        name: rest.to_owned(),
        rotation,
        translation,
    })
}

/// Whether a line lists points: places in the image and numbers of points, and no name.
fn is_points(line: &str) -> bool {
    let words = line.split_whitespace();
    words.clone().count().is_multiple_of(3) && words.into_iter().all(|w| w.parse::<f64>().is_ok())
}

/// Reads little-endian values one after the other.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*head)
    }

    fn u32(&mut self) -> Option<u32> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.bytes().map(u64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.bytes()?);
        }
        Some(values)
    }
}

fn binary_cameras(bytes: &[u8]) -> Option<Cameras> {
    let mut reader = Reader(bytes);
    let mut cameras = Cameras::new();
    for _ in 0..reader.u64()? {
        let (id, model) = (reader.u32()?, reader.u32()?);
        let size = [reader.u64()?, reader.u64()?];
        let (name, count, _) = MODELS.get(model as usize)?;
        let mut values = Vec::with_capacity(*count);
        for _ in 0..*count {
            values.push(f64::from_le_bytes(reader.bytes()?));
        }
        cameras.insert(id.into(), camera(name, size, &values)?);
    }
    Some(cameras)
}

fn binary_images(bytes: &[u8]) -> Option<Vec<Image>> {
    let mut reader = Reader(bytes);
    let mut images = Vec::new();
    for _ in 0..reader.u64()? {
        let _id = reader.u32()?;
        let (rotation, translation) = (reader.f64s()?, reader.f64s()?);
        let camera = reader.u32()?.into();
        let end = reader.0.iter().position(|&b| b == 0)?;
        let name = String::from_utf8_lossy(&reader.0[..end]).into_owned();
        // Each point has a place in the image and a number.
        let mut rest = Reader(&reader.0[end + 1..]);
        let points = usize::try_from(rest.u64()?).ok()?.checked_mul(24)?;
        reader = Reader(rest.0.get(points..)?);
        images.push(Image {
            name,
            camera,
            rotation,
            translation,
        });
    }
    Some(images)
}
