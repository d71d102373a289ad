//! What is known of a capture: its folder `truth`.

use std::fs;
use std::path::{Path, PathBuf};

use glam::Vec3;
use serde::Deserialize;

use super::error::BenchError;
use rekindle_base::files;
use rekindle_relight::Edit;

/// What an estimate should find.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Roughness σ, radians, if it is known.
    pub sigma: Option<f32>,
    /// The lamps; none under a light probe.
    pub lamps: Vec<TrueLamp>,
    /// `transforms.json` of views from elsewhere, if there are any.
    pub novel: Option<PathBuf>,
    /// Views under new light.
    pub relit: Vec<RelitCase>,
}

/// A lamp as it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueLamp {
    /// Unit direction from the object's centre.
    pub direction: Vec3,
    /// Radiance × solid angle, RGB; not times K_S.
    pub flux: Vec3,
    /// Angular radius, radians.
    pub angular_radius: f32,
}

/// Views under new light.
#[derive(Clone, Debug)]
pub struct RelitCase {
    /// The folder's name.
    pub name: String,
    /// Its `transforms.json`.
    pub cameras: PathBuf,
    /// How the light comes about from that of the capture.
    pub edits: Vec<Edit>,
}

#[derive(Deserialize)]
struct TruthFile {
    #[serde(default)]
    material: Option<MaterialFile>,
    #[serde(default)]
    lights: Option<Vec<LightFile>>,
}

#[derive(Deserialize)]
struct MaterialFile {
    sigma: Option<f32>,
    microfacet_alpha: Option<f32>,
    /// Of GGX, of each of the surface's parts.
    ggx_alpha: Option<Vec<f32>>,
}

#[derive(Deserialize)]
struct LightFile {
    direction: [f32; 3],
    radiance: [f32; 3],
    solid_angle: f32,
    #[serde(default)]
    angular_radius_deg: f32,
}

#[derive(Deserialize)]
struct EditFile {
    from: [f32; 3],
    to: [f32; 3],
}

impl Truth {
    /// Reads the truth of a capture, given by its folder or its `transforms.json`.
    pub fn load(capture: &Path) -> Result<Self, BenchError> {
        let folder = if capture.is_file() {
            capture.parent().unwrap_or(Path::new("."))
        } else {
            capture
        };
        let truth = folder.join("truth");
        let path = truth.join("truth.json");
        if !path.is_file() {
            return Err(BenchError::NoTruth {
                path: capture.to_owned(),
            });
        }
        let file: TruthFile = read(&path)?;
        let lamps = file
            .lights
            .unwrap_or_default()
            .iter()
            .map(|light| {
                Ok(TrueLamp {
                    direction: unit(light.direction, &path)?,
                    flux: Vec3::from(light.radiance) * light.solid_angle,
                    angular_radius: light.angular_radius_deg.to_radians(),
                })
            })
            .collect::<Result<Vec<TrueLamp>, BenchError>>()?;
        let relit = relit_cases(&truth.join("relit"), &lamps)?;
        // The slopes' width is √2 σ. Where it differs from part to part, there is no one σ.
        let sigma = file.material.and_then(|material| {
            let parts = material.ggx_alpha.unwrap_or_default();
            let common = parts
                .first()
                .filter(|first| parts.iter().all(|p| p == *first));
            let alpha = material.microfacet_alpha.or(common.copied());
            let of_alpha = |alpha: f32| alpha / std::f32::consts::SQRT_2;
            material.sigma.or(alpha.map(of_alpha))
        });
        Ok(Self {
            sigma: sigma.filter(|&sigma| sigma > 0.0),
            lamps,
            novel: Some(truth.join("novel/transforms.json")).filter(|path| path.is_file()),
            relit,
        })
    }
}

fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, BenchError> {
    let problem = |what: String| BenchError::Truth {
        path: path.to_owned(),
        what,
    };
    let text = files::read(path).map_err(|error| problem(format!("can't be read: {error}")))?;
    serde_json::from_slice(&text).map_err(|error| problem(format!("isn't as expected: {error}")))
}

fn unit(direction: [f32; 3], path: &Path) -> Result<Vec3, BenchError> {
    let direction = Vec3::from(direction);
    direction.try_normalize().ok_or_else(|| BenchError::Truth {
        path: path.to_owned(),
        what: format!("{direction} is no direction"),
    })
}

/// The folders `light_K` (only lamp K) and `moved` (as its `edit.json` says), by name.
fn relit_cases(folder: &Path, lamps: &[TrueLamp]) -> Result<Vec<RelitCase>, BenchError> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .map(|entries| {
            let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
            names.collect()
        })
        .unwrap_or_default();
    names.sort();
    let mut cases = Vec::new();
    for name in names {
        let cameras = folder.join(&name).join("transforms.json");
        if !cameras.is_file() {
            continue;
        }
        let number = name.strip_prefix("light_").map(str::parse::<usize>);
        let edits = if let Some(Ok(number)) = number {
            let lamp = lamps.get(number).ok_or_else(|| BenchError::Truth {
                path: folder.join(&name),
                what: format!("truth.json has {} lamps only", lamps.len()),
            })?;
            let near = lamp.direction;
            vec![Edit::Solo { near }, Edit::Ambient { gain: 0.0 }]
        } else {
            let path = folder.join(&name).join("edit.json");
            let edit: EditFile = read(&path)?;
            vec![Edit::Move {
                near: unit(edit.from, &path)?,
                to: unit(edit.to, &path)?,
            }]
        };
        cases.push(RelitCase {
            name,
            cameras,
            edits,
        });
    }
    Ok(cases)
}
