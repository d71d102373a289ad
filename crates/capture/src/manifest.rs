//! Which files and cameras make up a capture: `transforms.json` in the nerfstudio / instant-ngp convention, or what other
//! programs write.
//!
//! Cameras are camera-to-world matrices with OpenGL axes. Where nerfstudio moved the scene into a frame of its own
//! it says so by `applied_transform` A and `applied_scale` s, `p = s·A·p_original`; both are undone here, so
//! that cameras are in the frame of the mesh, which nerfstudio does not touch. `light_hemisphere` is in the
//! mesh's frame from the start.
//!
//! `mesh_transform`, a similarity transform, brings the mesh of the file into that frame.
//!
//! Intrinsics may be shared or stand in a frame, which then wins. Models other than OPENCV's and what it contains are
//! refused: images are undistorted easily before.
//!
//! A COLMAP model, SfMData or a table of RealityCapture is read as the manifest that nerfstudio would write for it.

use super::LightFrame;
use super::brackets::Settings;
use super::camera::{Camera, Distortion};
use super::colmap;
use super::error::CaptureError;
use super::raw;
use super::{reality_capture, sfm_data};
use glam::{DAffine3, DMat3, DMat4, DVec2, DVec3};
use rekindle_base::files;
use serde_json::{Map, Value};
use std::path::{Path, PathBuf};

/// Names of manifests, in this order; Blender's NeRF add-ons write the second.
const MANIFESTS: [&str; 2] = ["transforms.json", "transforms_train.json"];

/// Largest image side accepted, in pixels.
const MAX_SIDE: f64 = 65_535.0;

/// File name endings tried when `file_path` has none, in this order: what was made for this, what a camera measured, and what it
/// made of that.
const EXTENSIONS: [&[&str]; 3] = [
    &["exr", "png", "hdr", "tif", "tiff"],
    &raw::ENDINGS,
    &["jpg", "jpeg"],
];

/// What a manifest says of the light hemisphere.
#[derive(Debug, Default)]
pub(super) struct StatedHemisphere {
    /// Unit vector, if stated.
    pub up: Option<DVec3>,
    /// Radius in mesh units, `None` for distant light.
    pub radius: Option<f64>,
    /// What the lights stand still with, where that is stated.
    pub frame: Option<LightFrame>,
}

/// Everything `transforms.json` says.
#[derive(Debug)]
pub(super) struct Manifest {
    /// The manifest file.
    pub path: PathBuf,
    /// The folder that paths are relative to.
    pub folder: PathBuf,
    /// At least one.
    pub frames: Vec<Frame>,
    /// The mesh file as named, if it is.
    pub mesh_path: Option<String>,
    /// What brings the mesh of the file into the cameras' frame, a similarity transform.
    pub mesh_transform: Option<DMat4>,
    /// Where the lights are.
    pub light_hemisphere: StatedHemisphere,
    /// `applied_transform` with `applied_scale`, where the manifest states them.
    pub applied: Option<DMat4>,
    /// Whether cameras are of the pixels as they are stored, whatever the images' orientation.
    pub as_stored: bool,
    /// Whether the program that found the cameras may have had more photographs than the capture.
    pub partial: bool,
    /// Frames of such photographs, once they are left out.
    pub left_out: Vec<Frame>,
}

/// One frame: its files and its camera, which lacks its size if only the image tells.
#[derive(Debug)]
pub(super) struct Frame {
    /// The field in the manifest, `frames[3]`.
    pub field: String,
    /// `file_path` as written.
    pub name: String,
    /// One image, or a bracket of exposures.
    pub exposures: Vec<Exposure>,
    /// Whether the manifest lists exposures, be it one.
    pub bracketed: bool,
    /// Mask file, black where the image is to be ignored.
    pub mask: Option<PathBuf>,
    /// Intrinsics.
    pub lens: Lens,
    /// Pose in the mesh's frame.
    pub world_from_camera: DAffine3,
    /// Pose as written, `applied_transform` not undone.
    pub stated_pose: DAffine3,
}

/// One file of a view.
#[derive(Debug)]
pub(super) struct Exposure {
    /// The field in the manifest that names it.
    pub field: String,
    /// The file.
    pub path: PathBuf,
    /// How it was exposed, as far as that is stated.
    pub settings: Option<Settings>,
}

/// Intrinsics as stated, before the image size is known.
#[derive(Clone, Debug)]
pub(super) struct Lens {
    /// Stated width and height in pixels.
    pub size: (Option<u32>, Option<u32>),
    focal: [Option<Focal>; 2],
    centre: [Option<f64>; 2],
    distortion: Distortion,
}

/// A focal length along one axis.
#[derive(Clone, Copy, Debug)]
enum Focal {
    Pixels(f64),
    /// Full angle of view in radians.
    Angle(f64),
}

impl Lens {
    /// The camera for an image of this size.
    pub(super) fn camera(&self, (width, height): (u32, u32), pose: DAffine3) -> Camera {
        let sides = [f64::from(width), f64::from(height)];
        let along = |axis: usize| {
            self.focal[axis].map(|focal| match focal {
                Focal::Pixels(pixels) => pixels,
                Focal::Angle(angle) => 0.5 * sides[axis] / (0.5 * angle).tan(),
            })
        };
        let focal_x = along(0).or_else(|| along(1)).unwrap_or(sides[0]);
        let focal_y = along(1).unwrap_or(focal_x);
        Camera {
            width,
            height,
            focal: DVec2::new(focal_x, focal_y),
            centre: DVec2::new(
                self.centre[0].unwrap_or(0.5 * sides[0]),
                self.centre[1].unwrap_or(0.5 * sides[1]),
            ),
            distortion: self.distortion,
            world_from_camera: pose,
        }
    }
}

/// A JSON object with its place in the manifest.
struct Fields<'a> {
    manifest: &'a Path,
    prefix: String,
    map: &'a Map<String, Value>,
}

impl<'a> Fields<'a> {
    fn of(manifest: &'a Path, prefix: &str, value: &'a Value) -> Result<Self, CaptureError> {
        let map = value.as_object().ok_or_else(|| CaptureError::Field {
            path: manifest.to_owned(),
            field: if prefix.is_empty() {
                "the file".to_owned()
            } else {
                prefix.to_owned()
            },
            problem: format!("is {}, not an object", kind(value)),
            advice: "see the nerfstudio data conventions".to_owned(),
        })?;
        Ok(Self {
            manifest,
            prefix: prefix.to_owned(),
            map,
        })
    }

    fn field(&self, key: &str) -> String {
        if self.prefix.is_empty() {
            key.to_owned()
        } else {
            format!("{}.{key}", self.prefix)
        }
    }

    fn error(&self, key: &str, problem: impl Into<String>, advice: &str) -> CaptureError {
        CaptureError::Field {
            path: self.manifest.to_owned(),
            field: self.field(key),
            problem: problem.into(),
            advice: advice.to_owned(),
        }
    }

    fn get(&self, key: &str) -> Option<&'a Value> {
        self.map.get(key).filter(|value| !value.is_null())
    }

    fn number(&self, key: &str) -> Result<Option<f64>, CaptureError> {
        self.get(key)
            .map(|value| {
                value.as_f64().filter(|n| n.is_finite()).ok_or_else(|| {
                    self.error(key, format!("is {}", kind(value)), "write a number there")
                })
            })
            .transpose()
    }

    fn positive(&self, key: &str) -> Result<Option<f64>, CaptureError> {
        let number = self.number(key)?;
        match number {
            Some(n) if n <= 0.0 => {
                Err(self.error(key, format!("is {n}"), "it must be greater than zero"))
            }
            _ => Ok(number),
        }
    }

    fn side(&self, key: &str) -> Result<Option<u32>, CaptureError> {
        self.positive(key)?
            .map(|n| {
                if n.fract() == 0.0 && n <= MAX_SIDE {
                    Ok(n as u32)
                } else {
                    Err(self.error(key, format!("is {n}"), "write the number of pixels"))
                }
            })
            .transpose()
    }

    fn text(&self, key: &str) -> Result<Option<&'a str>, CaptureError> {
        self.get(key)
            .map(|value| {
                value.as_str().filter(|s| !s.is_empty()).ok_or_else(|| {
                    self.error(key, format!("is {}", kind(value)), "write a text there")
                })
            })
            .transpose()
    }

    fn list(&self, key: &str) -> Result<Option<&'a Vec<Value>>, CaptureError> {
        self.get(key)
            .map(|value| {
                value.as_array().ok_or_else(|| {
                    self.error(key, format!("is {}", kind(value)), "write a list there")
                })
            })
            .transpose()
    }

    fn numbers(&self, key: &str) -> Result<Option<Vec<f64>>, CaptureError> {
        self.list(key)?
            .map(|list| {
                list.iter()
                    .map(|value| value.as_f64().filter(|n| n.is_finite()))
                    .collect::<Option<Vec<_>>>()
                    .ok_or_else(|| {
                        self.error(
                            key,
                            "holds something other than finite numbers",
                            "write numbers only",
                        )
                    })
            })
            .transpose()
    }

    /// A matrix of 3 or 4 rows with 4 columns each; the fourth row is 0 0 0 1 if absent.
    fn matrix(&self, key: &str) -> Result<Option<DMat4>, CaptureError> {
        const ADVICE: &str = "write 4 rows of 4 finite numbers, camera to world";
        let Some(rows) = self.list(key)? else {
            return Ok(None);
        };
        if !(3..=4).contains(&rows.len()) {
            return Err(self.error(key, format!("has {} rows", rows.len()), ADVICE));
        }
        let mut matrix = DMat4::IDENTITY;
        for (i, row) in rows.iter().enumerate() {
            let row = row.as_array().filter(|row| row.len() == 4).ok_or_else(|| {
                self.error(
                    key,
                    format!("row {} does not have 4 numbers", i + 1),
                    ADVICE,
                )
            })?;
            for (j, value) in row.iter().enumerate() {
                // `null` stands where the file had NaN or Infinity, which JSON does not know.
                matrix.col_mut(j)[i] =
                    value.as_f64().filter(|n| n.is_finite()).ok_or_else(|| {
                        let what = if value.is_null() {
                            "NaN or not finite".to_owned()
                        } else {
                            kind(value)
                        };
                        let place = format!("is {what} in row {}, column {}", i + 1, j + 1);
                        self.error(key, place, ADVICE)
                    })?;
            }
        }
        Ok(Some(matrix))
    }
}

/// What a JSON value is, for messages.
fn kind(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(b) => format!("{b}"),
        Value::Number(n) => format!("the number {n}"),
        Value::String(s) if s.is_empty() => "empty".to_owned(),
        Value::String(s) => format!("the text \"{}\"", s.chars().take(40).collect::<String>()),
        Value::Array(_) => "a list".to_owned(),
        Value::Object(_) => "an object".to_owned(),
    }
}

impl Manifest {
    /// Reads the manifest of a capture, given its folder or the file itself.
    pub(super) fn read(path: &Path) -> Result<Self, CaptureError> {
        if path.is_dir() && !MANIFESTS.iter().any(|name| path.join(name).is_file()) {
            if let Some(images) = colmap::locate(path) {
                let value = colmap::read(path, &images)?;
                let mut manifest = Self::from_value(&value, images, path.to_owned())?;
                manifest.as_stored = true;
                manifest.partial = true;
                return Ok(manifest);
            }
            let other = sfm_data::locate(path).or_else(|| reality_capture::locate(path));
            if let Some(other) = other {
                return Self::read(&other);
            }
        }
        let file = locate(path)?;
        let bytes = files::read(&file).map_err(|source| CaptureError::Unreadable {
            path: file.clone(),
            source,
        })?;
        let folder = match file.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
            _ => PathBuf::from("."),
        };
        Self::parse(&bytes, file, folder)
    }

    /// Parses the text of the manifest `path`, of any program, whose files lie in `folder`.
    pub(super) fn parse(
        bytes: &[u8],
        path: PathBuf,
        folder: PathBuf,
    ) -> Result<Self, CaptureError> {
        if path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("csv"))
        {
            let value = reality_capture::convert(&path, bytes)?;
            return Self::from_value(&value, path, folder);
        }
        let mut value = parse_json(bytes, &path)?;
        let partial = sfm_data::is_sfm_data(&value);
        if partial {
            value = sfm_data::convert(&path, &value)?;
        }
        let manifest = Self::from_value(&value, path, folder)?;
        Ok(Self {
            partial,
            ..manifest
        })
    }

    /// Takes what a manifest states.
    fn from_value(value: &Value, path: PathBuf, folder: PathBuf) -> Result<Self, CaptureError> {
        let top = Fields::of(&path, "", value)?;
        let applied = applied_transform(&top)?;
        let undo = applied.map(|m| m.inverse());
        let list = top.list("frames")?.filter(|list| !list.is_empty());
        let list = list.ok_or_else(|| {
            top.error(
                "frames",
                "is missing or empty",
                "list at least one image with its matrix",
            )
        })?;
        let frames = list
            .iter()
            .enumerate()
            .map(|(i, value)| {
                let fields = Fields::of(&path, &format!("frames[{i}]"), value)?;
                read_frame(&fields, &top, &folder, undo)
            })
            .collect::<Result<Vec<_>, _>>()?;
        let light_hemisphere = light_hemisphere(&top)?;
        let mesh_path = top.text("mesh_path")?.map(str::to_owned);
        let mesh_transform = mesh_transform(&top)?;
        Ok(Self {
            path,
            folder,
            frames,
            mesh_path,
            mesh_transform,
            light_hemisphere,
            applied,
            as_stored: false,
            partial: false,
            left_out: Vec::new(),
        })
    }

    /// Leaves out the photographs that the capture doesn't have, where there may be such, unless it has none. Cameras are
    /// found from many photographs, but few are taken as HDR. Returns what a user should know.
    pub(super) fn leave_out_missing(&mut self) -> Option<String> {
        let here = |frame: &Frame| frame.exposures.iter().all(|e| e.path.is_file());
        if !self.partial || !self.frames.iter().any(here) {
            return None;
        }
        let all = self.frames.len();
        (self.frames, self.left_out) = std::mem::take(&mut self.frames).into_iter().partition(here);
        (!self.left_out.is_empty()).then(|| {
            format!(
                "{} of the {all} photographs that {} lists are not here and are left out.",
                self.left_out.len(),
                self.path.display()
            )
        })
    }
}

/// The manifest file of a capture.
fn locate(path: &Path) -> Result<PathBuf, CaptureError> {
    if !path.exists() {
        return Err(CaptureError::NoSuchFolder {
            path: path.to_owned(),
        });
    }
    if path.is_file() {
        return Ok(path.to_owned());
    }
    let manifests = MANIFESTS.iter().map(|name| path.join(name));
    if let Some(file) = manifests.into_iter().find(|file| file.is_file()) {
        return Ok(file);
    }
    let advice = "it needs the nerfstudio file that lists images and cameras, a COLMAP model, Meshroom's cameras.sfm, or \
        RealityCapture's table of cameras";
    Err(CaptureError::NoManifest {
        path: path.to_owned(),
        advice: advice.to_owned(),
    })
}

/// Parses JSON, forgiving Python's NaN and Infinity, which become null.
fn parse_json(bytes: &[u8], path: &Path) -> Result<Value, CaptureError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let strict = match serde_json::from_slice(bytes) {
        Ok(value) => return Ok(value),
        Err(error) => error,
    };
    let forgiven = std::str::from_utf8(bytes)
        .ok()
        .map(without_non_finite)
        .and_then(|text| serde_json::from_str(&text).ok());
    forgiven.ok_or_else(|| {
        let text = strict.to_string();
        let problem = text.split(" at line ").next().unwrap_or(&text).to_owned();
        CaptureError::BrokenJson {
            path: path.to_owned(),
            line: strict.line(),
            column: strict.column(),
            problem,
        }
    })
}

/// The text with the bare words NaN, Infinity and -Infinity outside strings replaced by null.
fn without_non_finite(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut in_string, mut escaped) = (false, false);
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        if !in_string {
            let word = ["NaN", "-NaN", "-Infinity", "Infinity"]
                .into_iter()
                .find(|word| rest.starts_with(word));
            if let Some(word) = word {
                out.push_str("null");
                rest = &rest[word.len()..];
                continue;
            }
        }
        in_string ^= c == '"' && !escaped;
        escaped = in_string && c == '\\' && !escaped;
        out.push(c);
        rest = &rest[c.len_utf8()..];
    }
    out
}

/// The transform from the mesh's frame to that of the stated matrices.
fn applied_transform(top: &Fields) -> Result<Option<DMat4>, CaptureError> {
    const KEY: &str = "applied_transform";
    let matrix = top.matrix(KEY)?;
    let scale = top.positive("applied_scale")?;
    if matrix.is_none() && scale.is_none() {
        return Ok(None);
    }
    let matrix = matrix.unwrap_or(DMat4::IDENTITY);
    let matrix = DMat4::from_scale(DVec3::splat(scale.unwrap_or(1.0))) * matrix;
    rigid(matrix).map_err(|problem| {
        top.error(
            KEY,
            problem,
            "write the 3×4 matrix that moved the scene, or remove it",
        )
    })?;
    Ok(Some(matrix))
}

/// `mesh_transform`: from the mesh's file to the cameras' frame.
fn mesh_transform(top: &Fields) -> Result<Option<DMat4>, CaptureError> {
    const KEY: &str = "mesh_transform";
    let matrix = top.matrix(KEY)?;
    if let Some(matrix) = matrix {
        let advice =
            "write the matrix of a similarity transform, as rekindle align does, or remove it";
        rigid(matrix).map_err(|problem| top.error(KEY, problem, advice))?;
    }
    Ok(matrix)
}

/// `light_hemisphere`: unit up, radius and what the lights stand still with.
fn light_hemisphere(top: &Fields) -> Result<StatedHemisphere, CaptureError> {
    const KEY: &str = "light_hemisphere";
    let Some(value) = top.get(KEY) else {
        return Ok(StatedHemisphere::default());
    };
    let fields = Fields::of(top.manifest, KEY, value)?;
    let up = fields
        .numbers("up")?
        .map(|up| {
            <[f64; 3]>::try_from(up)
                .ok()
                .and_then(|up| DVec3::from_array(up).try_normalize())
                .ok_or_else(|| {
                    fields.error("up", "is not a direction", "write [x, y, z], not all zero")
                })
        })
        .transpose()?;
    let frame = match fields.text("frame")? {
        None => None,
        Some("world") => Some(LightFrame::World),
        Some("camera") => Some(LightFrame::Camera),
        Some(other) => {
            let problem = format!("is \"{other}\"");
            let advice = "write \"world\" where the lights stand still with the object, \"camera\" where they do with the camera, \
                          as on a turntable";
            return Err(fields.error("frame", problem, advice));
        }
    };
    Ok(StatedHemisphere {
        up,
        radius: fields.positive("radius")?,
        frame,
    })
}

fn read_frame(
    frame: &Fields,
    top: &Fields,
    folder: &Path,
    undo: Option<DMat4>,
) -> Result<Frame, CaptureError> {
    const KEY: &str = "transform_matrix";
    const ADVICE: &str = "write the camera-to-world matrix of this image";
    let stated = frame
        .matrix(KEY)?
        .ok_or_else(|| frame.error(KEY, "is missing", ADVICE))?;
    let bad = |problem| frame.error(KEY, problem, ADVICE);
    let stated_pose = rigid(stated).map_err(bad)?;
    let world_from_camera = match undo {
        Some(undo) => rigid(undo * stated).map_err(bad)?,
        None => stated_pose,
    };
    let exposures = read_exposures(frame, folder)?;
    let name = match frame.text("file_path")? {
        Some(name) => name.to_owned(),
        None => bracket_name(frame)?,
    };
    let mask = frame.text("mask_path")?.map(|name| resolve(folder, name));
    Ok(Frame {
        field: frame.prefix.clone(),
        name,
        bracketed: frame
            .list("exposures")?
            .is_some_and(|list| !list.is_empty()),
        exposures,
        mask,
        lens: read_lens(frame, top)?,
        world_from_camera,
        stated_pose,
    })
}

/// The name of a bracketed view: its first file's.
fn bracket_name(frame: &Fields) -> Result<String, CaptureError> {
    let first = frame.list("exposures")?.and_then(|list| list.first());
    let name = first
        .and_then(|value| value.get("file_path"))
        .and_then(Value::as_str);
    Ok(name.unwrap_or(&frame.prefix).to_owned())
}

/// The files of a frame, with their relative exposures if it is bracketed.
fn read_exposures(frame: &Fields, folder: &Path) -> Result<Vec<Exposure>, CaptureError> {
    let Some(list) = frame.list("exposures")?.filter(|list| !list.is_empty()) else {
        let name = frame.text("file_path")?.ok_or_else(|| {
            frame.error("file_path", "is missing", "name the image of this frame")
        })?;
        return Ok(vec![Exposure {
            field: frame.field("file_path"),
            path: resolve(folder, name),
            settings: None,
        }]);
    };
    list.iter()
        .enumerate()
        .map(|(i, value)| {
            let prefix = frame.field(&format!("exposures[{i}]"));
            let fields = Fields::of(frame.manifest, &prefix, value)?;
            let name = fields.text("file_path")?.ok_or_else(|| {
                fields.error("file_path", "is missing", "name the image of this exposure")
            })?;
            let (f_number, iso) = (fields.positive("f_number")?, fields.positive("iso")?);
            let time = fields.positive("exposure_time")?;
            Ok(Exposure {
                field: fields.field("file_path"),
                path: resolve(folder, name),
                settings: time.map(|time| Settings {
                    time,
                    f_number,
                    iso,
                }),
            })
        })
        .collect()
}

/// The file a path names: as written, with slashes turned round, with an ending added, or with another ending: cameras are
/// often found from JPEG files of what was taken as HDR too.
fn resolve(folder: &Path, name: &str) -> PathBuf {
    let plain = folder.join(name.strip_prefix("./").unwrap_or(name));
    if plain.is_file() {
        return plain;
    }
    let turned = folder.join(name.replace('\\', "/"));
    if turned.is_file() {
        return turned;
    }
    // Cameras write their endings in capitals.
    let as_written = |e: &&str| [(*e).to_owned(), e.to_uppercase()];
    let endings = || EXTENSIONS.iter().copied().flatten().flat_map(as_written);
    let added = endings().map(|ending| {
        let mut with_ending = turned.clone().into_os_string();
        with_ending.push(".");
        with_ending.push(ending);
        PathBuf::from(with_ending)
    });
    let own = turned.extension().unwrap_or_default();
    let known = endings().any(|ending| own.eq_ignore_ascii_case(ending));
    let replaced = endings().filter(|_| known);
    let replaced = replaced.map(|ending| turned.with_extension(ending));
    added
        .chain(replaced)
        .find(|candidate| candidate.is_file())
        .unwrap_or(plain)
}

/// The path of the file that a path names, if it is there, as the capture's folder has it.
pub(super) fn found(folder: &Path, name: &str) -> Option<String> {
    let path = resolve(folder, name);
    let below = path.strip_prefix(folder).unwrap_or(&path);
    path.is_file().then(|| below.to_string_lossy().into_owned())
}

fn read_lens(frame: &Fields, top: &Fields) -> Result<Lens, CaptureError> {
    let model = match frame.text("camera_model")? {
        Some(model) => Some(model),
        None => top.text("camera_model")?,
    };
    check_model(model.unwrap_or("OPENCV"), top)?;
    let either = |key: &str| -> Result<Option<f64>, CaptureError> {
        Ok(frame.number(key)?.or(top.number(key)?))
    };
    let side = |key: &str| -> Result<Option<u32>, CaptureError> {
        Ok(frame.side(key)?.or(top.side(key)?))
    };
    let focal = |pixels: &str, angle: &str| -> Result<Option<Focal>, CaptureError> {
        Ok(read_focal(frame, pixels, angle)?.or(read_focal(top, pixels, angle)?))
    };
    let lens = Lens {
        size: (side("w")?, side("h")?),
        focal: [
            focal("fl_x", "camera_angle_x")?,
            focal("fl_y", "camera_angle_y")?,
        ],
        centre: [either("cx")?, either("cy")?],
        distortion: read_distortion(frame, top, model)?,
    };
    if lens.focal.iter().all(Option::is_none) {
        return Err(frame.error(
            "fl_x",
            "is missing, and so is camera_angle_x",
            "state the focal length in pixels, for all frames or for this one",
        ));
    }
    Ok(lens)
}

fn is_fisheye(model: Option<&str>) -> bool {
    model.is_some_and(|model| model.eq_ignore_ascii_case("OPENCV_FISHEYE"))
}

/// Refuses camera models that can't be stated here.
fn check_model(model: &str, top: &Fields) -> Result<(), CaptureError> {
    const KNOWN: [&str; 8] = [
        "SIMPLE_PINHOLE",
        "PINHOLE",
        "PERSPECTIVE",
        "SIMPLE_RADIAL",
        "RADIAL",
        "OPENCV",
        "OPENCV_FISHEYE",
        "FULL_OPENCV",
    ];
    if KNOWN.contains(&model.to_uppercase().as_str()) {
        return Ok(());
    }
    Err(top.error(
        "camera_model",
        format!("is {model}, which is not among {}", KNOWN.join(", ")),
        "undistort the images (colmap image_undistorter --image_path images --input_path sparse/0 --output_path undistorted) and use the PINHOLE cameras that this writes",
    ))
}

fn read_focal(fields: &Fields, pixels: &str, angle: &str) -> Result<Option<Focal>, CaptureError> {
    if let Some(pixels) = fields.positive(pixels)? {
        return Ok(Some(Focal::Pixels(pixels)));
    }
    let Some(radians) = fields.positive(angle)? else {
        return Ok(None);
    };
    if radians >= std::f64::consts::PI {
        return Err(fields.error(
            angle,
            format!("is {radians}"),
            "write the full angle of view in radians, less than π",
        ));
    }
    Ok(Some(Focal::Angle(radians)))
}

/// Distortion coefficients by name or as nerfstudio's list `[k1, k2, k3, k4, p1, p2]`.
fn read_distortion(
    frame: &Fields,
    top: &Fields,
    model: Option<&str>,
) -> Result<Distortion, CaptureError> {
    let list = match frame.numbers("distortion_params")? {
        Some(list) => list,
        None => top.numbers("distortion_params")?.unwrap_or_default(),
    };
    let named = |key: &str, place: usize| -> Result<f64, CaptureError> {
        let named = frame.number(key)?.or(top.number(key)?);
        Ok(named.or(list.get(place).copied()).unwrap_or(0.0))
    };
    let (k1, k2) = (named("k1", 0)?, named("k2", 1)?);
    let (k3, k4) = (named("k3", 2)?, named("k4", 3)?);
    let p = [named("p1", 4)?, named("p2", 5)?];
    if is_fisheye(model) {
        return Ok(Distortion {
            k: [k1, k2, k3, k4],
            fisheye: true,
            ..Distortion::default()
        });
    }
    // In FULL_OPENCV k4, k5 and k6 are the coefficients of a denominator.
    if model.is_some_and(|model| model.eq_ignore_ascii_case("FULL_OPENCV")) {
        return Ok(Distortion {
            k: [k1, k2, k3, 0.0],
            p,
            denominator: [k4, named("k5", usize::MAX)?, named("k6", usize::MAX)?],
            fisheye: false,
        });
    }
    Ok(Distortion {
        k: [k1, k2, k3, k4],
        p,
        denominator: [0.0; 3],
        fisheye: false,
    })
}

/// The rotation and position in a matrix that may carry a uniform scale, or what is wrong with it.
fn rigid(matrix: DMat4) -> Result<DAffine3, String> {
    let row = matrix.row(3);
    let last_row_error = row.truncate().abs().max_element() + (row.w - 1.0).abs();
    if last_row_error > 1e-4 {
        return Err("does not end with the row 0 0 0 1".to_owned());
    }
    let linear = DMat3::from_mat4(matrix);
    let size = linear.x_axis.length() * linear.y_axis.length() * linear.z_axis.length();
    let det = linear.determinant();
    if !size.is_normal() || det.abs() < 1e-6 * size {
        return Err("is singular".to_owned());
    }
    if det < 0.0 {
        return Err("mirrors (its determinant is negative)".to_owned());
    }
    let scale = det.cbrt();
    let mut rotation = linear * (1.0 / scale);
    // Polar decomposition by Newton's method: the rotation nearest to what was written.
    for _ in 0..12 {
        rotation = (rotation + rotation.inverse().transpose()) * 0.5;
    }
    let distance = (0..3)
        .map(|i| (linear.col(i) / scale - rotation.col(i)).length())
        .fold(0.0, f64::max);
    if distance.is_nan() || distance > 0.02 {
        return Err("is not a rotation with a uniform scale".to_owned());
    }
    Ok(DAffine3 {
        matrix3: rotation,
        translation: matrix.w_axis.truncate(),
    })
}
