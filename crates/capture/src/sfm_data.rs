//! AliceVision's and Meshroom's SfMData (`cameras.sfm`, `sfm.json`), as the manifest that nerfstudio would write for it.
//!
//! All numbers may be texts. A pose is the camera's centre and the rotation from world to camera, its nine numbers column by
//! column, with axes +X right, +Y down, looking along +Z. A file's version decides how a lens is stated.

use super::error::CaptureError;
use super::manifest::found;
use glam::{DMat3, DMat4, DVec3};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Names that Meshroom's nodes give their files, the best first.
const NAMES: [&str; 4] = ["cameras.sfm", "sfm.sfm", "sfmData.sfm", "sfm.json"];

/// SfMData in a folder, if there is any.
pub(super) fn locate(folder: &Path) -> Option<PathBuf> {
    let named = NAMES.iter().map(|name| folder.join(name));
    named.into_iter().find(|path| path.is_file()).or_else(|| {
        let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
            .ok()?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| path.extension().is_some_and(|e| e == "sfm"))
            .collect();
        files.sort();
        files.into_iter().next()
    })
}

/// Whether a JSON file is SfMData.
pub(super) fn is_sfm_data(value: &Value) -> bool {
    value.get("views").is_some_and(Value::is_array) && value.get("frames").is_none()
}

/// The manifest for SfMData read from `path`.
pub(super) fn convert(path: &Path, value: &Value) -> Result<Value, CaptureError> {
    let file = File { path, value };
    let version = file.version();
    let mut lenses = BTreeMap::new();
    for (field, entry) in file.entries("intrinsics") {
        let id = text(entry, "intrinsicId").ok_or_else(|| file.missing(&field, "intrinsicId"))?;
        lenses.insert(id, file.lens(&field, entry, version)?);
    }
    let mut poses = BTreeMap::new();
    for (field, entry) in file.entries("poses") {
        let id = text(entry, "poseId").ok_or_else(|| file.missing(&field, "poseId"))?;
        poses.insert(id, file.pose(&field, entry)?);
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut frames = Vec::new();
    for (field, view) in file.entries("views") {
        let stated = text(view, "path").ok_or_else(|| file.missing(&field, "path"))?;
        let pose = text(view, "poseId").or_else(|| text(view, "viewId"));
        // Views without a pose were not reconstructed.
        let Some(pose) = pose.and_then(|id| poses.get(&id)) else {
            continue;
        };
        let lens = text(view, "intrinsicId").and_then(|id| lenses.get(&id));
        let Some(lens) = lens else {
            let advice = "export the cameras anew, with intrinsics";
            return Err(file.error(&field, "has no intrinsics in the file".to_owned(), advice));
        };
        let mut frame = lens.clone();
        frame.insert("file_path".to_owned(), json!(image(folder, &stated)));
        frame.insert("transform_matrix".to_owned(), pose.clone());
        frames.push(Value::Object(frame));
    }
    if frames.is_empty() {
        let advice =
            "export the result of StructureFromMotion or ConvertSfMFormat with views and poses";
        return Err(file.error("views", "have no pose, none of them".to_owned(), advice));
    }
    frames.sort_by(|a, b| a["file_path"].as_str().cmp(&b["file_path"].as_str()));
    Ok(json!({ "frames": frames }))
}

/// Where an image is: as stated, or by its name in the capture's folder or its `images`. Paths are those of the machine
/// that ran Meshroom.
fn image(folder: &Path, stated: &str) -> String {
    let name = stated.rsplit(['/', '\\']).next().unwrap_or(stated);
    let places = [stated.to_owned(), name.to_owned(), format!("images/{name}")];
    let here = places.iter().find_map(|place| found(folder, place));
    here.unwrap_or_else(|| places[2].clone())
}

/// A text or number.
fn text(value: &Value, key: &str) -> Option<String> {
    match value.get(key)? {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    }
}

fn as_number(value: &Value) -> Option<f64> {
    let number = match value {
        Value::String(text) => text.trim().parse().ok()?,
        other => other.as_f64()?,
    };
    f64::is_finite(number).then_some(number)
}

struct File<'a> {
    path: &'a Path,
    value: &'a Value,
}

impl<'a> File<'a> {
    fn error(&self, field: &str, problem: String, advice: &str) -> CaptureError {
        CaptureError::Field {
            path: self.path.to_owned(),
            field: field.to_owned(),
            problem,
            advice: advice.to_owned(),
        }
    }

    fn missing(&self, field: &str, key: &str) -> CaptureError {
        let field = format!("{field}.{key}");
        self.error(&field, "is missing".to_owned(), "export the cameras anew")
    }

    /// The entries of a list with their places.
    fn entries(&self, key: &'static str) -> impl Iterator<Item = (String, &'a Value)> {
        let list = self.value.get(key).and_then(Value::as_array);
        let entries = list.map_or(&[][..], Vec::as_slice).iter().enumerate();
        entries.map(move |(i, value)| (format!("{key}[{i}]"), value))
    }

    fn version(&self) -> [u32; 3] {
        let list = self.value.get("version").and_then(Value::as_array);
        let number = |i: usize| list.and_then(|list| as_number(list.get(i)?)).unwrap_or(1.0) as u32;
        [0, 1, 2].map(number)
    }

    fn number(&self, field: &str, value: &Value, key: &str) -> Result<Option<f64>, CaptureError> {
        value.get(key).map_or(Ok(None), |found| {
            as_number(found).map(Some).ok_or_else(|| {
                let field = format!("{field}.{key}");
                self.error(
                    &field,
                    "is not a number".to_owned(),
                    "export the cameras anew",
                )
            })
        })
    }

    /// Numbers of a list of N.
    fn numbers<const N: usize>(
        &self,
        field: &str,
        value: &Value,
        key: &str,
    ) -> Result<[f64; N], CaptureError> {
        let list = value.get(key).and_then(Value::as_array);
        let numbers: Option<Vec<f64>> = list.and_then(|list| list.iter().map(as_number).collect());
        numbers
            .and_then(|n| <[f64; N]>::try_from(n).ok())
            .ok_or_else(|| {
                let problem = format!("is not a list of {N} numbers");
                self.error(
                    &format!("{field}.{key}"),
                    problem,
                    "export the cameras anew",
                )
            })
    }

    /// Camera-to-world matrix with axes +Y up, looking along −Z.
    fn pose(&self, field: &str, entry: &Value) -> Result<Value, CaptureError> {
        let field = format!("{field}.pose.transform");
        let transform = entry.pointer("/pose/transform").unwrap_or(&Value::Null);
        let camera_from_world =
            DMat3::from_cols_array(&self.numbers(&field, transform, "rotation")?);
        let centre: [f64; 3] = self.numbers(&field, transform, "center")?;
        let axes =
            camera_from_world.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let mut pose = DMat4::from_mat3(axes);
        pose.w_axis = DVec3::from(centre).extend(1.0);
        Ok(json!(pose.transpose().to_cols_array_2d()))
    }

    /// The fields of frames with a lens.
    fn lens(
        &self,
        field: &str,
        entry: &Value,
        version: [u32; 3],
    ) -> Result<Map<String, Value>, CaptureError> {
        let need = |key: &str| {
            let number = self.number(field, entry, key)?;
            number.ok_or_else(|| self.missing(field, key))
        };
        let (width, height) = (need("width")?, need("height")?);
        let [fx, fy] = if version >= [1, 2, 2] {
            let sensor = self.number(field, entry, "sensorWidth")?.unwrap_or(36.0);
            let ratio = self.number(field, entry, "pixelRatio")?.unwrap_or(1.0);
            let fx = need("focalLength")? / sensor * width;
            // Before 1.2.5 the pixels' ratio was that of the focal lengths.
            [
                fx,
                if version >= [1, 2, 5] {
                    fx * ratio
                } else {
                    fx / ratio
                },
            ]
        } else if version >= [1, 2, 0] && entry.get("pxFocalLength").is_some_and(Value::is_array) {
            self.numbers(field, entry, "pxFocalLength")?
        } else {
            [need("pxFocalLength")?; 2]
        };
        let [cx, cy]: [f64; 2] = self.numbers(field, entry, "principalPoint")?;
        let centre = if version >= [1, 2, 1] {
            [cx + 0.5 * width, cy + 0.5 * height]
        } else {
            [cx, cy]
        };
        let mut fields = Map::new();
        for (key, value) in [
            ("w", width),
            ("h", height),
            ("fl_x", fx),
            ("fl_y", fy),
            ("cx", centre[0]),
            ("cy", centre[1]),
        ] {
            fields.insert(key.to_owned(), json!(value));
        }
        self.distortion(field, entry, version, &mut fields)?;
        Ok(fields)
    }

    fn distortion(
        &self,
        field: &str,
        entry: &Value,
        version: [u32; 3],
        fields: &mut Map<String, Value>,
    ) -> Result<(), CaptureError> {
        let kind = text(entry, "type").unwrap_or_else(|| "pinhole".to_owned());
        // The type told of the distortion before 1.2.8.
        let stated = text(entry, "distortionType").filter(|_| version >= [1, 2, 8]);
        let distortion = stated.clone().unwrap_or_else(|| kind.clone());
        let names: &[&str] = match distortion.as_str() {
            "none" | "pinhole" | "" => &[],
            "radialk1" | "radial1" => &["k1"],
            "radialk3" | "radial3" => &["k1", "k2", "k3"],
            "brown" => &["k1", "k2", "k3", "p1", "p2"],
            "fisheye4" => &["k1", "k2", "k3", "k4"],
            _ => return Err(self.refused(field, &distortion)),
        };
        if stated.is_some() && kind != "pinhole" {
            return Err(self.refused(field, &kind));
        }
        if distortion == "fisheye4" {
            fields.insert("camera_model".to_owned(), json!("OPENCV_FISHEYE"));
        }
        let list = entry.get("distortionParams").and_then(Value::as_array);
        for (i, name) in names.iter().enumerate() {
            let value = list
                .and_then(|list| list.get(i))
                .map_or(Some(0.0), as_number);
            let place = format!("{field}.distortionParams[{i}]");
            let value = value.ok_or_else(|| {
                self.error(
                    &place,
                    "is not a number".to_owned(),
                    "export the cameras anew",
                )
            })?;
            fields.insert((*name).to_owned(), json!(value));
        }
        Ok(())
    }

    fn refused(&self, field: &str, what: &str) -> CaptureError {
        self.error(
            &format!("{field}.type"),
            format!("is {what}, which is not among pinhole, radial, brown and fisheye4"),
            "undistort the images (Meshroom: ExportImages or PrepareDenseScene, aliceVision_prepareDenseScene) and export their cameras",
        )
    }
}
