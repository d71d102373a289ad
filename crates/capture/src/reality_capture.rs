//! RealityCapture's and RealityScan's table of cameras ("Internal/External camera parameters", CSV), as the manifest that
//! nerfstudio would write for it.
//!
//! Positions are x, y, alt with z up; the camera-to-world rotation with axes +Y up, looking along −Z is
//! Rz(−heading) Rx(pitch) Ry(roll), in degrees. The focal length is that of 36 mm film, and lengths are in units of the image's
//! longer side, whose size only the image tells.

use super::error::CaptureError;
use super::picture;
use glam::{DMat3, DMat4, DVec3};
use rekindle_base::files;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// Columns that a table must have.
const NEEDED: [&str; 8] = ["name", "x", "y", "alt", "heading", "pitch", "roll", "f"];
/// Columns of distortion with nerfstudio's names.
const LENS: [(&str, &str); 6] = [
    ("k1", "k1"),
    ("k2", "k2"),
    ("k3", "k3"),
    ("k4", "k4"),
    ("t1", "p1"),
    ("t2", "p2"),
];

/// A table of cameras in a folder, if there is one.
pub(super) fn locate(folder: &Path) -> Option<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            path.extension()
                .is_some_and(|e| e.eq_ignore_ascii_case("csv"))
        })
        .filter(|path| files::read(path).is_ok_and(|bytes| columns(&bytes).is_some()))
        .collect();
    files.sort();
    files.into_iter().next()
}

/// The names of the columns if the file is a table of cameras.
fn columns(bytes: &[u8]) -> Option<Vec<String>> {
    let line = bytes.split(|&b| b == b'\n').next()?;
    let text = String::from_utf8_lossy(line);
    let text = text
        .trim()
        .trim_start_matches('\u{feff}')
        .trim_start_matches('#');
    let names: Vec<String> = text.split(',').map(|n| n.trim().to_lowercase()).collect();
    NEEDED
        .iter()
        .all(|need| names.iter().any(|n| n == need))
        .then_some(names)
}

/// The manifest for the table read from `path`, whose images lie in its folder or in `images`.
pub(super) fn convert(path: &Path, bytes: &[u8]) -> Result<Value, CaptureError> {
    let error = |field: String, problem: String| CaptureError::Field {
        path: path.to_owned(),
        field,
        problem,
        advice: "export the cameras anew, with name, x, y, alt, heading, pitch, roll and f"
            .to_owned(),
    };
    let names = columns(bytes).ok_or_else(|| {
        let problem = format!("lacks some of the columns {}", NEEDED.join(", "));
        error("line 1".to_owned(), problem)
    })?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let text = String::from_utf8_lossy(bytes);
    let mut frames = Vec::new();
    for (i, line) in text.lines().enumerate().skip(1) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let row = Row {
            names: &names,
            cells: line.split(',').map(str::trim).collect(),
        };
        let place = format!("line {}", i + 1);
        let frame = frame(folder, &row, &place, &error)?;
        frames.push(frame);
    }
    Ok(json!({ "frames": frames }))
}

struct Row<'a> {
    names: &'a [String],
    cells: Vec<&'a str>,
}

impl Row<'_> {
    fn cell(&self, name: &str) -> Option<&str> {
        let at = self.names.iter().position(|n| n == name)?;
        self.cells.get(at).copied().filter(|cell| !cell.is_empty())
    }

    fn number(&self, name: &str) -> Result<f64, String> {
        let cell = self.cell(name).ok_or_else(|| format!("has no {name}"))?;
        let number = cell.parse().ok().filter(|v: &f64| v.is_finite());
        number.ok_or_else(|| format!("has '{cell}' as {name}, which is not a number"))
    }

    fn or_zero(&self, name: &str) -> Result<f64, String> {
        if self.cell(name).is_none() {
            Ok(0.0)
        } else {
            self.number(name)
        }
    }
}

fn frame(
    folder: &Path,
    row: &Row<'_>,
    place: &str,
    error: &dyn Fn(String, String) -> CaptureError,
) -> Result<Value, CaptureError> {
    let bad = |problem: String| error(place.to_owned(), problem);
    let name = row
        .cell("name")
        .ok_or_else(|| bad("has no name".to_owned()))?;
    let name = name.trim_matches('"');
    let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
    let places = [name.to_owned(), file.to_owned(), format!("images/{file}")];
    let found = places
        .iter()
        .find(|p| folder.join(p).is_file())
        .unwrap_or(&places[2]);
    let (width, height) = picture::read_size(&folder.join(found), place)?;
    let (w, h) = (f64::from(width), f64::from(height));
    let longer = w.max(h);
    let number = |name: &str| row.number(name).map_err(bad);
    let optional = |name: &str| row.or_zero(name).map_err(bad);
    let focal = number("f")? * longer / 36.0;
    let rotation = DMat3::from_rotation_z(-number("heading")?.to_radians())
        * DMat3::from_rotation_x(number("pitch")?.to_radians())
        * DMat3::from_rotation_y(number("roll")?.to_radians());
    let mut pose = DMat4::from_mat3(rotation);
    pose.w_axis = DVec3::new(number("x")?, number("y")?, number("alt")?).extend(1.0);
    let mut fields = Map::new();
    for (key, value) in [
        ("fl_x", focal),
        ("fl_y", focal),
        ("cx", optional("px")? * longer + 0.5 * w),
        ("cy", optional("py")? * longer + 0.5 * h),
    ] {
        fields.insert(key.to_owned(), json!(value));
    }
    for (column, key) in LENS {
        fields.insert(key.to_owned(), json!(optional(column)?));
    }
    fields.insert("w".to_owned(), json!(width));
    fields.insert("h".to_owned(), json!(height));
    fields.insert("file_path".to_owned(), json!(found));
    let rows = pose.transpose().to_cols_array_2d();
    fields.insert("transform_matrix".to_owned(), json!(rows));
    Ok(Value::Object(fields))
}
