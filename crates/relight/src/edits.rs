//! Edits of the lighting: `edits.json`, parsed, checked and applied in order.
//!
//! A lamp is named by a direction: `near` picks the lamp whose direction is closest. A muted lamp can still be
//! picked. `solo` mutes every other lamp and takes away what else casts light, except the ambient part, which
//! has a gain of its own.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{Quat, Vec3};
use serde::Deserialize;
use serde_json::Value;
use thiserror::Error;

use super::environment::LatLong;
use super::lighting::{LampNodes, Lighting, ProbeUnits};
use rekindle_base::files;

/// The operations there are, as the messages list them.
const OPERATIONS: &str = "mute, solo, gain, move, add, delete, environment, ambient, remainder";

/// One edit of the lighting.
#[derive(Clone, Debug)]
pub enum Edit {
    /// Switches a lamp off.
    Mute {
        /// Picks the lamp.
        near: Vec3,
    },
    /// Leaves only this lamp and the ambient part on.
    Solo {
        /// Picks the lamp.
        near: Vec3,
    },
    /// Multiplies a lamp's radiance.
    Gain {
        /// Picks the lamp.
        near: Vec3,
        /// Factor of each channel.
        rgb: Vec3,
    },
    /// Turns a lamp rigidly about the object's centre.
    Move {
        /// Picks the lamp.
        near: Vec3,
        /// Its new direction, unit.
        to: Vec3,
    },
    /// Adds a disc of light.
    Add {
        /// Unit direction from the object's centre.
        direction: Vec3,
        /// Radiance × solid angle, RGB.
        flux: Vec3,
        /// Angular radius in radians.
        angular_radius: f32,
    },
    /// Removes a lamp.
    Delete {
        /// Picks the lamp.
        near: Vec3,
    },
    /// Replaces the environment.
    Environment {
        /// The picture.
        picture: Arc<LatLong>,
        /// Turn about the hemisphere's pole, radians, counter-clockwise seen from the pole.
        rotation: f32,
        /// How bright it is taken to be.
        units: ProbeUnits,
        /// Factor of its radiance.
        gain: f32,
    },
    /// Multiplies the ambient part.
    Ambient {
        /// The factor.
        gain: f32,
    },
    /// Multiplies estimated light that belongs to no lamp.
    Remainder {
        /// The factor.
        gain: f32,
    },
}

/// What can be wrong with edits.
#[derive(Debug, Error)]
pub enum EditError {
    /// The file can't be read.
    #[error("{path}: can't read the edits: {source}")]
    Read {
        /// The edits file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not JSON. The message has line and column.
    #[error("{path}: not valid JSON: {source}")]
    Json {
        /// The edits file.
        path: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// JSON of another shape.
    #[error(
        "{path}: expected a list of edits, each an object with one operation, like [{{\"mute\": {{\"near\": [0, 1, 0]}}}}]; {what}"
    )]
    Shape {
        /// The edits file.
        path: PathBuf,
        /// What was found.
        what: String,
    },
    /// An operation there isn't.
    #[error("{path}: edit {index}: unknown operation \"{name}\"; the operations are {OPERATIONS}")]
    UnknownOperation {
        /// The edits file.
        path: PathBuf,
        /// Place in the list, from 0.
        index: usize,
        /// What it was called.
        name: String,
    },
    /// A field is missing or has a value that can't be used.
    #[error("{path}: edit {index} (\"{operation}\"): {what}")]
    Field {
        /// The edits file.
        path: PathBuf,
        /// Place in the list, from 0.
        index: usize,
        /// The operation.
        operation: String,
        /// What is wrong, and what to do.
        what: String,
    },
    /// A lamp is asked for and there is none.
    #[error(
        "edit {index}: there is no lamp left to choose from; add one first or leave this edit out"
    )]
    NoLamp {
        /// Place in the list, from 0.
        index: usize,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NearFields {
    near: [f32; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GainFields {
    near: [f32; 3],
    rgb: [f32; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MoveFields {
    near: [f32; 3],
    to: [f32; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AddFields {
    direction: [f32; 3],
    flux: [f32; 3],
    angular_radius_deg: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EnvironmentFields {
    file: PathBuf,
    #[serde(default)]
    rotation_deg: f32,
    #[serde(default)]
    units: ProbeUnits,
    #[serde(default = "one")]
    gain: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GainOnlyFields {
    gain: f32,
}

fn one() -> f32 {
    1.0
}

/// Reads an edits file and the environment pictures it names, relative to its folder.
pub fn load(path: &Path) -> Result<Vec<Edit>, EditError> {
    let text = files::read_text(path).map_err(|source| EditError::Read {
        path: path.to_owned(),
        source,
    })?;
    let value: Value = serde_json::from_str(&text).map_err(|source| EditError::Json {
        path: path.to_owned(),
        source,
    })?;
    let shape = |what: String| EditError::Shape {
        path: path.to_owned(),
        what,
    };
    let Value::Array(list) = value else {
        return Err(shape("the file holds something else".to_owned()));
    };
    let mut edits = Vec::with_capacity(list.len());
    for (index, entry) in list.into_iter().enumerate() {
        let Value::Object(object) = entry else {
            return Err(shape(format!("edit {index} is no object")));
        };
        let count = object.len();
        let (1, Some((name, fields))) = (count, object.into_iter().next()) else {
            return Err(shape(format!("edit {index} has {count} operations")));
        };
        let edit =
            parse(&name, fields, path.parent().unwrap_or(Path::new("."))).map_err(|problem| {
                match problem {
                    Problem::UnknownOperation => EditError::UnknownOperation {
                        path: path.to_owned(),
                        index,
                        name,
                    },
                    Problem::Field(what) => EditError::Field {
                        path: path.to_owned(),
                        index,
                        operation: name,
                        what,
                    },
                }
            })?;
        edits.push(edit);
    }
    Ok(edits)
}

/// What is wrong with one edit, before its place in the file is known.
enum Problem {
    UnknownOperation,
    Field(String),
}

impl From<serde_json::Error> for Problem {
    fn from(error: serde_json::Error) -> Self {
        Self::Field(error.to_string())
    }
}

fn parse(name: &str, fields: Value, folder: &Path) -> Result<Edit, Problem> {
    use serde_json::from_value;
    Ok(match name {
        "mute" => Edit::Mute {
            near: unit("near", from_value::<NearFields>(fields)?.near)?,
        },
        "solo" => Edit::Solo {
            near: unit("near", from_value::<NearFields>(fields)?.near)?,
        },
        "delete" => Edit::Delete {
            near: unit("near", from_value::<NearFields>(fields)?.near)?,
        },
        "gain" => {
            let f: GainFields = from_value(fields)?;
            Edit::Gain {
                near: unit("near", f.near)?,
                rgb: not_negative("rgb", f.rgb)?,
            }
        }
        "move" => {
            let f: MoveFields = from_value(fields)?;
            Edit::Move {
                near: unit("near", f.near)?,
                to: unit("to", f.to)?,
            }
        }
        "add" => {
            let f: AddFields = from_value(fields)?;
            if !(f.angular_radius_deg > 0.0 && f.angular_radius_deg <= 90.0) {
                return Err(Problem::Field(
                    "\"angular_radius_deg\" must be greater than 0 and at most 90".to_owned(),
                ));
            }
            Edit::Add {
                direction: unit("direction", f.direction)?,
                flux: not_negative("flux", f.flux)?,
                angular_radius: f.angular_radius_deg.to_radians(),
            }
        }
        "environment" => {
            let f: EnvironmentFields = from_value(fields)?;
            if !f.rotation_deg.is_finite() {
                return Err(Problem::Field(
                    "\"rotation_deg\" must be a finite number".to_owned(),
                ));
            }
            let picture = LatLong::load(&folder.join(&f.file)).map_err(Problem::Field)?;
            Edit::Environment {
                picture: Arc::new(picture),
                rotation: f.rotation_deg.to_radians(),
                units: f.units,
                gain: not_negative("gain", [f.gain; 3])?.x,
            }
        }
        "ambient" => Edit::Ambient {
            gain: not_negative("gain", [from_value::<GainOnlyFields>(fields)?.gain; 3])?.x,
        },
        "remainder" => Edit::Remainder {
            gain: not_negative("gain", [from_value::<GainOnlyFields>(fields)?.gain; 3])?.x,
        },
        _ => return Err(Problem::UnknownOperation),
    })
}

/// A direction of any length.
fn unit(field: &str, value: [f32; 3]) -> Result<Vec3, Problem> {
    Vec3::from(value).try_normalize().ok_or_else(|| {
        Problem::Field(format!(
            "\"{field}\" must be a direction, but [{}, {}, {}] points nowhere",
            value[0], value[1], value[2]
        ))
    })
}

fn not_negative(field: &str, value: [f32; 3]) -> Result<Vec3, Problem> {
    let vector = Vec3::from(value);
    if vector.is_finite() && vector.cmpge(Vec3::ZERO).all() {
        Ok(vector)
    } else {
        Err(Problem::Field(format!(
            "\"{field}\" must be finite and not negative"
        )))
    }
}

/// The lighting after all edits, in order.
pub fn apply(edits: &[Edit], lighting: &Lighting) -> Result<Lighting, EditError> {
    let mut edited = lighting.clone();
    for (index, edit) in edits.iter().enumerate() {
        let pick = |edited: &Lighting, near: Vec3| {
            edited.nearest_lamp(near).ok_or(EditError::NoLamp { index })
        };
        match edit {
            Edit::Mute { near } => {
                let lamp = pick(&edited, *near)?;
                edited.lamps[lamp].muted = true;
            }
            Edit::Solo { near } => {
                let chosen = pick(&edited, *near)?;
                for (i, lamp) in edited.lamps.iter_mut().enumerate() {
                    lamp.muted = i != chosen;
                }
                edited.remainder.clear();
                edited.environment = None;
            }
            Edit::Gain { near, rgb } => {
                let lamp = pick(&edited, *near)?;
                for node in &mut edited.lamps[lamp].nodes {
                    node.radiance *= *rgb;
                }
            }
            Edit::Move { near, to } => {
                let lamp = pick(&edited, *near)?;
                edited.lamps[lamp].turn_towards(*to);
            }
            Edit::Add {
                direction,
                flux,
                angular_radius,
            } => edited.lamps.push(LampNodes::disc(
                *direction,
                *flux,
                *angular_radius,
                lighting.radius,
            )),
            Edit::Delete { near } => {
                let lamp = pick(&edited, *near)?;
                edited.lamps.remove(lamp);
            }
            Edit::Environment {
                picture,
                rotation,
                units,
                gain,
            } => {
                let turn = Quat::from_axis_angle(lighting.up, *rotation);
                let bright = lighting.probe_gain(*units, picture.flux());
                edited.environment = picture.environment(turn, bright * *gain);
            }
            Edit::Ambient { gain } => edited.ambient *= *gain,
            Edit::Remainder { gain } if *gain == 0.0 => edited.remainder.clear(),
            Edit::Remainder { gain } => {
                for node in &mut edited.remainder {
                    node.radiance *= *gain;
                }
            }
        }
    }
    Ok(edited)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::LightNode;
    use rekindle_base::damage::{Random, damaged};

    fn two_lamps() -> Lighting {
        Lighting {
            lamps: vec![
                LampNodes::disc(Vec3::Y, Vec3::new(3.0, 3.0, 3.0), 0.05, None),
                LampNodes::disc(Vec3::X, Vec3::new(1.0, 1.0, 1.0), 0.05, None),
            ],
            remainder: vec![LightNode {
                direction: Vec3::Z,
                radiance: Vec3::ONE,
                solid_angle: 0.01,
            }],
            environment: None,
            ambient: Vec3::splat(0.1),
            centre: Vec3::ZERO,
            radius: None,
            up: Vec3::Y,
            specular_scale: Vec3::splat(0.2),
        }
    }

    fn load_text(text: &str) -> Result<Vec<Edit>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("edits.json");
        fs::write(&path, text).unwrap();
        load(&path).map_err(|e| e.to_string())
    }

    fn applied(text: &str) -> Lighting {
        apply(&load_text(text).unwrap(), &two_lamps()).unwrap()
    }

    #[test]
    fn damaged_edits_are_refused_or_keep_the_light_sane() {
        let mut random = Random(12);
        let text = br#"[{"mute": {"near": [0, 1, 0]}}, {"gain": {"near": [1, 0, 0], "rgb": [2, 0.5, 1e1]}},
            {"move": {"near": [1, 0, 0], "to": [0, 0, 1]}}, {"ambient": {"gain": 0.5}},
            {"add": {"direction": [0, 1, 0], "flux": [1, 1, 1], "angular_radius_deg": 3}}]"#;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("edits.json");
        for _ in 0..2000 {
            fs::write(&path, damaged(text, &mut random)).unwrap();
            let Ok(lighting) = load(&path).map(|edits| apply(&edits, &two_lamps())) else {
                continue;
            };
            for lamp in lighting.iter().flat_map(|l| &l.lamps) {
                assert!(!lamp.flux().is_nan() && lamp.flux().min_element() >= 0.0);
            }
        }
    }

    #[test]
    fn every_operation_does_what_it_says() {
        let muted = applied(r#"[{"mute": {"near": [1, 0, 0]}}]"#);
        assert_eq!(muted.lamps[1].flux(), Vec3::ZERO);
        assert!(muted.lamps[0].flux().x > 2.9);

        let solo = applied(r#"[{"solo": {"near": [1, 0, 0]}}]"#);
        assert_eq!(solo.lamps[0].flux(), Vec3::ZERO);
        assert_eq!(
            solo.ambient,
            Vec3::splat(0.1),
            "solo keeps the ambient part"
        );

        let gained = applied(r#"[{"gain": {"near": [1, 0, 0], "rgb": [2, 0, 1]}}]"#);
        assert!((gained.lamps[1].flux() - Vec3::new(2.0, 0.0, 1.0)).length() < 1e-5);

        let moved = applied(r#"[{"move": {"near": [0, 1, 0], "to": [0, 0, 1]}}]"#);
        assert_eq!(moved.lamps[0].direction, Vec3::Z);

        let added = applied(
            r#"[{"add": {"direction": [0, 0, 1], "flux": [1, 2, 3], "angular_radius_deg": 3}}]"#,
        );
        assert!((added.lamps[2].flux() - Vec3::new(1.0, 2.0, 3.0)).length() < 1e-5);

        let deleted = applied(r#"[{"delete": {"near": [0, 1, 0]}}]"#);
        assert_eq!(deleted.lamps.len(), 1);
        assert_eq!(deleted.lamps[0].direction, Vec3::X);

        let dimmed = applied(r#"[{"ambient": {"gain": 0.5}}]"#);
        assert_eq!(dimmed.ambient, Vec3::splat(0.05));

        let half = applied(r#"[{"remainder": {"gain": 0.5}}]"#);
        assert_eq!(half.remainder[0].radiance, Vec3::splat(0.5));
        assert!(
            applied(r#"[{"remainder": {"gain": 0}}]"#)
                .remainder
                .is_empty()
        );
    }

    #[test]
    fn edits_apply_in_order() {
        let lighting = applied(
            r#"[{"move": {"near": [3, 0, 0], "to": [0, 0, 0.5]}}, {"mute": {"near": [0, 0, 1]}}]"#,
        );
        assert_eq!(lighting.lamps[1].flux(), Vec3::ZERO);
        assert!(lighting.lamps[0].flux().x > 0.0);
    }

    #[test]
    fn a_probe_is_as_bright_as_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        // 16 by 8 pixels of radiance 2, 1 and 1/2, with a common exponent.
        let mut picture = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n".to_vec();
        picture.extend([128, 64, 32, 130].repeat(16 * 8));
        fs::write(folder.path().join("probe.hdr"), picture).unwrap();
        let lighting = two_lamps();
        let sphere = 4.0 * std::f32::consts::PI;
        let stored = Vec3::new(2.0, 1.0, 0.5) * sphere;
        // The lamps' 12, the stray node's and the ambient light's.
        let captured = 12.0 + 0.03 + 0.3 * sphere;
        for (units, expected) in [
            ("", stored * (captured / (3.5 * sphere))),
            (
                r#", "units": "matched""#,
                stored * (captured / (3.5 * sphere)),
            ),
            (r#", "units": "stored""#, stored * 0.2),
            (r#", "units": "solution", "gain": 2"#, stored * 2.0),
        ] {
            let path = folder.path().join("edits.json");
            let text = format!(r#"[{{"environment": {{"file": "probe.hdr"{units}}}}}]"#);
            fs::write(&path, text).unwrap();
            let edited = apply(&load(&path).unwrap(), &lighting).unwrap();
            let found: Vec3 = edited.environment_lamps().map(LampNodes::flux).sum();
            let off = (found - expected).length() / expected.length();
            assert!(off < 5e-3, "{units}: {found}, not {expected}");
        }
    }

    #[test]
    fn bad_edits_are_named() {
        for (text, parts) in [
            ("[{\"mute\": ]", &["line 1", "column"][..]),
            ("{}", &["list of edits"]),
            (
                r#"[{"mute": {"near": [0,1,0]}}, {"dim": {}}]"#,
                &["edit 1", "\"dim\"", "solo", "ambient"],
            ),
            (r#"[{"mute": {}}]"#, &["edit 0", "near"]),
            (
                r#"[{"mute": {"near": [0, 0, 0]}}]"#,
                &["\"near\"", "direction"],
            ),
            (
                r#"[{"gain": {"near": [0, 1, 0], "rgb": [1, -1, 1]}}]"#,
                &["rgb", "not negative"],
            ),
            (
                r#"[{"mute": {"nearest": [0, 1, 0]}}]"#,
                &["nearest", "near"],
            ),
            (r#"[{"environment": {"file": "none.hdr"}}]"#, &["none.hdr"]),
        ] {
            let message = load_text(text).unwrap_err();
            for part in parts {
                assert!(message.contains(part), "\"{message}\" lacks \"{part}\"");
            }
        }
        let nothing = Lighting {
            lamps: Vec::new(),
            ..two_lamps()
        };
        let edits = load_text(r#"[{"mute": {"near": [0, 1, 0]}}]"#).unwrap();
        assert!(
            apply(&edits, &nothing)
                .unwrap_err()
                .to_string()
                .contains("no lamp")
        );
    }
}
