//! Marked points from a file: a list such as
//! `[{"mesh": [0.1, 0.2, 0.3], "marks": {"images/view_000.exr": [412.5, 300]}}]`.

use std::io;
use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};
use serde_json::Value;

use super::marks::{Mark, MarkedPoint};
use rekindle_base::files;
use rekindle_capture::{Capture, View};

/// Why a file of points can't be used.
#[derive(Debug, thiserror::Error)]
pub enum PointsError {
    /// The operating system could not read it.
    #[error("{path}: cannot be read: {source}; check that it is a file and may be read")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// It is not JSON.
    #[error(
        "{path}: line {line}, column {column}: broken JSON: {problem}; correct it or write it anew"
    )]
    BrokenJson {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What the parser expected.
        problem: String,
    },
    /// A field makes no sense.
    #[error("{path}: {field} {problem}; {advice}")]
    Field {
        /// The file.
        path: PathBuf,
        /// The field, as `[2].marks`.
        field: String,
        /// What is wrong with it.
        problem: String,
        /// What to do.
        advice: String,
    },
}

/// Reads marked points of a capture's mesh; photographs go by the names of its views.
pub fn read_points(path: &Path, capture: &Capture) -> Result<Vec<MarkedPoint>, PointsError> {
    let text = files::read(path).map_err(|source| PointsError::Unreadable {
        path: path.to_owned(),
        source,
    })?;
    let reader = Reader {
        path,
        views: &capture.views,
        origin: capture.mesh.origin,
    };
    reader.parse(&text)
}

struct Reader<'a> {
    path: &'a Path,
    views: &'a [View],
    /// Of the mesh.
    origin: DVec3,
}

impl Reader<'_> {
    fn parse(&self, text: &[u8]) -> Result<Vec<MarkedPoint>, PointsError> {
        let value: Value = serde_json::from_slice(text).map_err(|error| {
            let problem = error.to_string();
            let end = problem.rfind(" at line").unwrap_or(problem.len());
            PointsError::BrokenJson {
                path: self.path.to_owned(),
                line: error.line(),
                column: error.column(),
                problem: problem[..end].to_owned(),
            }
        })?;
        let Some(points) = value.as_array() else {
            let advice = "write [{\"mesh\": [x, y, z], \"marks\": {\"PHOTOGRAPH\": [x, y]}}, …]";
            return Err(self.error("the file", "is not a list of points", advice));
        };
        let numbered = points.iter().enumerate();
        numbered.map(|(i, point)| self.point(i, point)).collect()
    }

    fn point(&self, i: usize, value: &Value) -> Result<MarkedPoint, PointsError> {
        let field = format!("[{i}].mesh");
        let [x, y, z] = self.numbers(&field, value.get("mesh"), "[x, y, z] of the mesh")?;
        let field = format!("[{i}].marks");
        let Some(marks) = value.get("marks").and_then(Value::as_object) else {
            let advice =
                "write {\"PHOTOGRAPH\": [x, y]}, with pixel coordinates from the upper left corner";
            return Err(self.error(
                &field,
                "is missing or no list of marks by photograph",
                advice,
            ));
        };
        let mark = |(name, pixel): (&String, &Value)| {
            let field = format!("{field}.{name}");
            let [x, y] = self.numbers(&field, Some(pixel), "[x, y] in pixels")?;
            let pixel = DVec2::new(x, y);
            let view = self.view(&field, name)?;
            let camera = &self.views[view].camera;
            let size = DVec2::new(camera.width.into(), camera.height.into());
            if pixel.cmplt(DVec2::ZERO).any() || pixel.cmpgt(size).any() {
                let problem = format!(
                    "is outside the photograph, which has {}×{} pixels",
                    camera.width, camera.height
                );
                let advice = "write pixel coordinates from its upper left corner";
                return Err(self.error(&field, &problem, advice));
            }
            Ok(Mark { view, pixel })
        };
        Ok(MarkedPoint {
            place: DVec3::new(x, y, z) - self.origin,
            marks: marks.iter().map(mark).collect::<Result<_, _>>()?,
        })
    }

    fn view(&self, field: &str, name: &str) -> Result<usize, PointsError> {
        let found = self.views.iter().position(|view| view.name == name);
        found.ok_or_else(|| {
            let names: Vec<&str> = self.views.iter().take(3).map(|v| v.name.as_str()).collect();
            let more = if self.views.len() > 3 { " …" } else { "" };
            let advice = format!("name one of {}{more}", names.join(", "));
            self.error(field, "is no photograph of the capture", &advice)
        })
    }

    fn numbers<const N: usize>(
        &self,
        field: &str,
        value: Option<&Value>,
        wanted: &str,
    ) -> Result<[f64; N], PointsError> {
        let numbers: Option<Vec<f64>> = value
            .and_then(Value::as_array)
            .and_then(|list| list.iter().map(Value::as_f64).collect());
        numbers
            .and_then(|numbers| <[f64; N]>::try_from(numbers).ok())
            .filter(|numbers| numbers.iter().all(|v| v.is_finite()))
            .ok_or_else(|| {
                let problem = format!("is missing or not {N} numbers");
                self.error(field, &problem, &format!("write {wanted}"))
            })
    }

    fn error(&self, field: &str, problem: &str, advice: &str) -> PointsError {
        PointsError::Field {
            path: self.path.to_owned(),
            field: field.to_owned(),
            problem: problem.to_owned(),
            advice: advice.to_owned(),
        }
    }
}
