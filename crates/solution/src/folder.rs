//! A solution's folder: written whole or not at all, read with a check that its parts fit together, and never taken for more than it is.

use std::fs;
use std::io;
use std::path::Path;
use std::time::Instant;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::exr_file::{self, write_rgb};
use super::format::{
    FORMAT, Fit, Head, Hemisphere, Light, Listed, Manifest, Nodes, Texture, VERSION,
    VERSION_OF_ONE_GLOSS, VERSION_OF_WHITE_GLOSS,
};
use super::known_light::KnownLight;
use super::mesh_file::{self, write_obj};
use super::{Solution, SolutionError, SolutionLamp};
use rekindle_base::files;
use rekindle_base::staging::{DestinationError, Owned, Staging, cannot_write, check_owned};
use rekindle_capture::{Camera, Mesh, read_cameras, transforms};
use rekindle_estimate::estimate::Iteration;
use rekindle_scene::hemisphere::{HemisphereGrid, lat_long};
use rekindle_scene::reflectance::{Brdf, Gloss};
use rekindle_scene::surface::{Atlas, GlossTexture};

/// Rows of the lat-long picture: a node is some three pixels tall at frequency 70.
const LATLONG_ROWS: u32 = 512;
/// The file by which a solution is known.
pub(super) const MANIFEST: &str = "solution.json";
/// Folder of pictures of hemispheres in a solution.
pub(super) const HEMISPHERES: &str = "hemispheres";
/// Roughness σ of each texel, radians, and what it reflects as a multiple of the main lobe's; only where parts differ.
const ROUGHNESS: &str = "roughness.exr";
pub(super) const STRENGTH: &str = "specular_strength.exr";
/// First line of the mesh as OBJ.
const OBJ_HEAD: &str = "# written by rekindle; texture diffuse.exr\n";
/// Least roughness of a texel as a multiple of the main one's, and one over the largest: what files say beyond is a mistake.
const MIN_GLOSS_ROUGHNESS: f32 = 0.01;

impl Solution {
    /// What `solution.json` says.
    pub fn summary(&self) -> serde_json::Value {
        // By way of text, in which a float has no more digits than it needs.
        let text = serde_json::to_string(&self.manifest()).unwrap_or_default();
        serde_json::from_str(&text).unwrap_or_default()
    }

    /// Writes the solution; one that is there already is replaced once everything is written.
    /// Returns the seconds of all stages, writing and total included.
    pub fn save(&self, folder: &Path) -> Result<Vec<(String, f64)>, SolutionError> {
        let staging = Staging::beside(folder).map_err(cannot_write(folder))?;
        check_replaceable(folder)?;
        let timings = self
            .write_files(staging.path())
            .map_err(cannot_write(folder))?;
        staging.replace(check_replaceable)?;
        Ok(timings)
    }

    fn write_files(&self, folder: &Path) -> io::Result<Vec<(String, f64)>> {
        let started = Instant::now();
        let uvs = self.stored_uvs();
        let width = self.atlas.width;
        let pictures = folder.join(HEMISPHERES);
        if !self.pictures.is_empty() {
            fs::create_dir(&pictures)?;
        }
        let jobs: Vec<Box<dyn Fn() -> io::Result<()> + Sync + Send + '_>> = vec![
            Box::new(|| write_rgb(&folder.join("diffuse.exr"), width, &self.diffuse)),
            Box::new(|| write_rgb(&folder.join("albedo.exr"), width, &self.albedo)),
            Box::new(|| {
                exr_file::write_gray(&folder.join("confidence.exr"), width, &self.confidence)
            }),
            Box::new(|| {
                let Some((gloss, brdf)) = self.gloss.as_ref().zip(self.brdf) else {
                    return Ok(());
                };
                let texels = gloss.texels().iter();
                let sigma: Vec<f32> = texels.clone().map(|g| brdf.at(*g).sigma).collect();
                exr_file::write_gray(&folder.join(ROUGHNESS), width, &sigma)?;
                let path = folder.join(STRENGTH);
                if gloss.is_coloured() {
                    let scales: Vec<_> = texels.map(|g| g.scale().to_array()).collect();
                    return write_rgb(&path, width, &scales);
                }
                let strength: Vec<f32> = texels.map(|g| g.strength).collect();
                exr_file::write_gray(&path, width, &strength)
            }),
            Box::new(|| write_obj(&folder.join("mesh.obj"), OBJ_HEAD, &self.mesh, &uvs)),
            Box::new(|| mesh_file::write_ply(&folder.join("mesh.ply"), &self.mesh, &uvs)),
            Box::new(|| {
                let picture = lat_long(&self.grid, &self.radiance, LATLONG_ROWS);
                write_rgb(
                    &folder.join("hemisphere.exr"),
                    picture.width,
                    &picture.radiance,
                )
            }),
            Box::new(|| {
                self.pictures.par_iter().try_for_each(|p| {
                    write_rgb(
                        &pictures.join(format!("{}.exr", p.name)),
                        p.picture.width,
                        &p.picture.radiance,
                    )
                })
            }),
            Box::new(|| write_json(&folder.join("nodes.json"), &self.nodes(), false)),
            Box::new(|| {
                if self.cameras.is_empty() {
                    return Ok(());
                }
                let cameras = transforms(&self.cameras, self.mesh.origin);
                write_json(&folder.join("cameras.json"), &cameras, true)
            }),
        ];
        jobs.into_par_iter().try_for_each(|job| job())?;
        let mut timings = self.timings.clone();
        timings.push(("save".to_owned(), started.elapsed().as_secs_f64()));
        let total = timings.iter().map(|(_, seconds)| seconds).sum();
        timings.push(("total".to_owned(), total));
        // Last, so that a folder with a solution.json has everything else too.
        let mut files = Owned::all_in(folder)?.listed();
        files.push(MANIFEST.to_owned());
        let manifest = Manifest {
            files,
            timings_s: to_map(&timings),
            ..self.manifest()
        };
        write_json(&folder.join(MANIFEST), &manifest, true)?;
        Ok(timings)
    }

    /// Texture coordinates as files have them, of each triangle's corners: in [0, 1], v upwards.
    pub fn stored_uvs(&self) -> Vec<[Vec2; 3]> {
        let size = Vec2::new(self.atlas.width as f32, self.atlas.height as f32);
        self.atlas
            .corner_uvs
            .iter()
            .map(|corners| {
                corners.map(|c| {
                    let uv = c / size;
                    Vec2::new(uv.x, 1.0 - uv.y)
                })
            })
            .collect()
    }

    fn nodes(&self) -> Nodes {
        Nodes {
            lit: self
                .radiance
                .iter()
                .enumerate()
                .filter(|(_, r)| **r != [0.0; 3])
                .map(|(i, r)| (i as u32, *r))
                .collect(),
            lights: self.lamps.iter().map(|l| l.nodes.clone()).collect(),
        }
    }

    fn manifest(&self) -> Manifest {
        // JSON has no word for infinity, which these reach where the data are absurd.
        let finite = |value: f64| {
            if value.is_finite() {
                value
            } else {
                f64::from(f32::MAX)
            }
        };
        let views = self.fit.psnr_db_per_view.iter();
        Manifest {
            format: FORMAT.to_owned(),
            version: match &self.gloss {
                Some(gloss) if gloss.is_coloured() => VERSION,
                Some(_) => VERSION_OF_WHITE_GLOSS,
                None => VERSION_OF_ONE_GLOSS,
            },
            files: Vec::new(),
            name: self.name.clone(),
            origin: self.origin.clone(),
            method: self.method,
            specular_model: self.brdf.map(|b| b.model),
            chosen_because: self.chosen_because.clone(),
            corrections: self.corrections.clone(),
            sigma: self.brdf.map(|b| b.sigma),
            sigma_interval95: self.sigma_interval95,
            known_light: self.known_light.clone(),
            gloss_parts: (self.gloss.as_ref())
                .map_or_else(Vec::new, |gloss| gloss.glosses().to_vec()),
            hemisphere: Hemisphere {
                frequency: self.grid.frequency,
                nodes: self.grid.directions.len(),
                active: self.radiance.iter().filter(|r| **r != [0.0; 3]).count(),
                up: self.grid.up.to_array(),
                radius: self.grid.radius,
                frame: self.light_frame,
                centre: world_centre(&self.mesh, self.grid.centre),
            },
            lights: self
                .lamps
                .iter()
                .enumerate()
                .map(|(id, lamp)| Light {
                    id,
                    name: lamp.name.clone(),
                    direction: lamp.direction.to_array(),
                    flux: lamp.flux.to_array(),
                    angular_radius_deg: lamp.angular_radius.to_degrees(),
                    nodes: lamp.nodes.len(),
                })
                .collect(),
            ambient: self.ambient.to_array(),
            diagnostics: self.diagnostics.clone(),
            fit: Fit {
                residual_rms: finite(self.fit.residual_rms),
                psnr_db_per_view: views.map(|&db| finite(db.into()) as f32).collect(),
                misfit: self.fit.misfit.map(finite),
            },
            skipped: self.skipped.clone(),
            timings_s: to_map(&self.timings),
            convergence: self
                .convergence
                .iter()
                .map(|iteration| Iteration {
                    objective: finite(iteration.objective),
                    residual_rms: finite(iteration.residual_rms.into()) as f32,
                    ..*iteration
                })
                .collect(),
            texture: Texture {
                width: self.atlas.width,
                height: self.atlas.height,
                own_uvs: self.atlas.own_uvs,
            },
        }
    }

    /// Reads a solution and checks that its parts fit together.
    pub fn load(folder: &Path) -> Result<Self, SolutionError> {
        let manifest_path = folder.join("solution.json");
        let manifest = read_manifest(folder, &manifest_path)?;
        let damaged = |file: &str, what: String| SolutionError::Damaged {
            path: folder.join(file),
            what,
        };
        let mut grid = check_manifest(&manifest).map_err(|what| damaged("solution.json", what))?;
        let (radiance, node_lists) = read_nodes(folder, &manifest)?;
        let (width, height) = (manifest.texture.width, manifest.texture.height);
        let rgb = |name: &str| {
            exr_file::read_rgb(&folder.join(name), width, height)
                .map_err(|what| damaged(name, what))
        };
        let ((diffuse, albedo), (confidence, mesh)) = rayon::join(
            || rayon::join(|| rgb("diffuse.exr"), || rgb("albedo.exr")),
            || {
                rayon::join(
                    || exr_file::read_gray(&folder.join("confidence.exr"), width, height),
                    || mesh_file::read_ply(&folder.join("mesh.ply")),
                )
            },
        );
        let mesh = mesh.map_err(|what| damaged("mesh.ply", what))?;
        let gloss = read_gloss(folder, &manifest).map_err(|(file, what)| damaged(file, what))?;
        let brdf = stored_lobe(&manifest);
        let origin = mesh.mesh.origin;
        grid.centre = (DVec3::from(manifest.hemisphere.centre) - origin).as_vec3();
        let cameras = read_stored_cameras(&folder.join("cameras.json"), origin);
        let size = Vec2::new(width as f32, height as f32);
        let corner_uvs = mesh
            .corner_uvs
            .iter()
            .map(|corners| corners.map(|uv| Vec2::new(uv.x, 1.0 - uv.y) * size))
            .collect();
        Ok(Self {
            name: manifest.name,
            origin: manifest.origin,
            method: manifest.method,
            brdf,
            known_light: manifest.known_light,
            light_frame: manifest.hemisphere.frame,
            chosen_because: manifest.chosen_because,
            corrections: manifest.corrections,
            sigma_interval95: manifest.sigma_interval95,
            grid,
            radiance,
            lamps: manifest
                .lights
                .into_iter()
                .zip(node_lists)
                .map(|(light, nodes)| SolutionLamp {
                    name: light.name,
                    direction: light.direction.into(),
                    flux: light.flux.into(),
                    angular_radius: light.angular_radius_deg.to_radians(),
                    nodes,
                })
                .collect(),
            ambient: manifest.ambient.into(),
            diagnostics: manifest.diagnostics,
            fit: manifest.fit,
            timings: manifest
                .timings_s
                .into_iter()
                .map(|(stage, seconds)| (stage, seconds.as_f64().unwrap_or(0.0)))
                .collect(),
            convergence: manifest.convergence,
            skipped: manifest.skipped,
            cameras: cameras.map_err(|what| damaged("cameras.json", what))?,
            mesh: Mesh {
                origin,
                positions: mesh.mesh.positions,
                normals: mesh.mesh.normals,
                uvs: Vec::new(),
                triangles: mesh.mesh.triangles,
            },
            atlas: Atlas::from_corners(width, height, corner_uvs, manifest.texture.own_uvs),
            diffuse: diffuse?,
            albedo: albedo?,
            gloss,
            confidence: confidence.map_err(|what| damaged("confidence.exr", what))?,
            pictures: Vec::new(),
        })
    }
}

/// The folder of a solution that may be named by its `solution.json`.
pub fn solution_folder(path: &Path) -> &Path {
    let by_file = path.file_name().is_some_and(|name| name == "solution.json");
    match path.parent() {
        Some(folder) if by_file && path.is_file() => folder,
        _ => path,
    }
}

/// Fails if something that is no solution is in the way, or files that are no solution's, so that this is known before any
/// work is done. Returns what runs that were killed had left there and what became of it, in whole sentences.
pub fn check_destination(folder: &Path) -> Result<Vec<String>, SolutionError> {
    // Whether it can be written at all is best found out by trying.
    let staging = Staging::beside(folder).map_err(cannot_write(folder))?;
    check_replaceable(folder)?;
    Ok(staging.settled().to_vec())
}

/// Fails unless a folder is a solution with nothing else in it, empty or not there.
fn check_replaceable(folder: &Path) -> Result<(), DestinationError> {
    check_owned(folder, own_files(folder), "a solution")
}

/// The files of the solution in a folder, if there is one.
pub fn own_files(folder: &Path) -> Option<Owned> {
    let path = folder.join(MANIFEST);
    let text = path.is_file().then(|| fs::read(&path))?.ok()?;
    let listed: Listed = serde_json::from_slice(&text).ok()?;
    if listed.format != FORMAT {
        return None;
    }
    Some(if listed.files.is_empty() {
        unlisted_files(folder)
    } else {
        listed.files.into_iter().collect()
    })
}

/// The files of a solution that was written before they were listed: all of a solution's names that are there.
fn unlisted_files(folder: &Path) -> Owned {
    let entries = fs::read_dir(folder.join(HEMISPHERES)).into_iter().flatten();
    let pictures = entries
        .flatten()
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| {
            let stem = name.strip_suffix(".exr").unwrap_or_default();
            let number = stem.strip_prefix("partial_").unwrap_or_default();
            let numbered = number.len() >= 3 && number.bytes().all(|b| b.is_ascii_digit());
            stem == "initial" || numbered
        })
        .map(|name| format!("{HEMISPHERES}/{name}"));
    let names = [
        MANIFEST,
        HEMISPHERES,
        "albedo.exr",
        "cameras.json",
        "confidence.exr",
        "diffuse.exr",
        "hemisphere.exr",
        "mesh.obj",
        "mesh.ply",
        "nodes.json",
    ];
    pictures.chain(names.map(str::to_owned)).collect()
}

fn to_map(timings: &[(String, f64)]) -> serde_json::Map<String, serde_json::Value> {
    timings
        .iter()
        .map(|(stage, seconds)| (stage.clone(), (*seconds).into()))
        .collect()
}

pub(super) fn write_json(
    path: &Path,
    value: &impl serde::Serialize,
    pretty: bool,
) -> io::Result<()> {
    let text = if pretty {
        serde_json::to_vec_pretty(value)
    } else {
        serde_json::to_vec(value)
    };
    fs::write(path, text.map_err(io::Error::other)?)
}

pub(super) fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, SolutionError> {
    let text = files::read(path).map_err(|source| SolutionError::Read {
        path: path.to_owned(),
        source,
    })?;
    serde_json::from_slice(&text).map_err(|source| SolutionError::Json {
        path: path.to_owned(),
        source,
    })
}

pub(super) fn read_manifest(folder: &Path, path: &Path) -> Result<Manifest, SolutionError> {
    if !path.is_file() {
        return Err(SolutionError::Missing {
            path: folder.to_owned(),
        });
    }
    let head: Head = read_json(path)?;
    if head.format != FORMAT {
        return Err(SolutionError::Format {
            path: path.to_owned(),
            found: head.format,
        });
    }
    if head.version > VERSION {
        return Err(SolutionError::Newer {
            path: path.to_owned(),
            found: head.version,
            supported: VERSION,
        });
    }
    read_json(path)
}

/// The hemisphere's centre as the world has it, without digits that single precision did not have.
fn world_centre(mesh: &Mesh, centre: Vec3) -> [f64; 3] {
    let shortest = |v: f32| v.to_string().parse().unwrap_or_else(|_| f64::from(v));
    if mesh.origin == DVec3::ZERO {
        centre.to_array().map(shortest)
    } else {
        mesh.in_world(centre).to_array()
    }
}

/// The cameras of a solution; the error says what is wrong with the file.
fn read_stored_cameras(path: &Path, origin: DVec3) -> Result<Vec<(String, Camera)>, String> {
    if path.is_file() {
        read_cameras(path, origin).map_err(|e| e.to_string())
    } else {
        Ok(Vec::new())
    }
}

/// Radiance of every node, and the lamps' nodes.
#[expect(
    clippy::type_complexity,
    reason = "two lists that are taken apart at once"
)]
fn read_nodes(
    folder: &Path,
    manifest: &Manifest,
) -> Result<(Vec<[f32; 3]>, Vec<Vec<u32>>), SolutionError> {
    let path = folder.join("nodes.json");
    let nodes: Nodes = read_json(&path)?;
    let count = manifest.hemisphere.nodes;
    let in_range = |&i: &u32| (i as usize) < count;
    let sound = nodes
        .lit
        .iter()
        .all(|(i, r)| in_range(i) && r.iter().all(|v| v.is_finite() && *v >= 0.0))
        && nodes.lights.iter().flatten().all(in_range)
        && nodes.lights.len() == manifest.lights.len();
    if !sound {
        return Err(SolutionError::Damaged {
            path,
            what: "its nodes do not fit solution.json, or have a radiance that is negative or not finite".to_owned(),
        });
    }
    let mut radiance = vec![[0.0; 3]; count];
    for (i, r) in nodes.lit {
        radiance[i as usize] = r;
    }
    Ok((radiance, nodes.lights))
}

/// The gloss of every texel, where parts of the surface differ; or the file that is damaged, and what is wrong with it.
fn read_gloss(
    folder: &Path,
    manifest: &Manifest,
) -> std::result::Result<Option<GlossTexture>, (&'static str, String)> {
    let Some(sigma) = manifest.sigma.filter(|_| !manifest.gloss_parts.is_empty()) else {
        return Ok(None);
    };
    let (width, height) = (manifest.texture.width, manifest.texture.height);
    let gray = |name: &'static str| {
        let read = exr_file::read_gray(&folder.join(name), width, height);
        read.map_err(|what| (name, what))
    };
    let parts = manifest.gloss_parts.iter();
    let is_coloured = parts.clone().any(|part| !Gloss::is_white(&part.tint));
    let scales = if is_coloured {
        let read = exr_file::read_rgb(&folder.join(STRENGTH), width, height);
        read.map_err(|what| (STRENGTH, what))?
    } else {
        gray(STRENGTH)?.into_iter().map(|s| [s; 3]).collect()
    };
    let gloss = |(roughness, scale): (f32, Vec3)| {
        let least = MIN_GLOSS_ROUGHNESS;
        let roughness = roughness.clamp(least, least.recip());
        Gloss::new(roughness, 0.0).reflecting(scale.max(Vec3::ZERO))
    };
    let parts = parts.map(|part| gloss((part.roughness, part.scale())));
    let texels = (gray(ROUGHNESS)?.into_iter().zip(scales))
        .map(|(own, scale)| gloss((own / sigma, scale.into())));
    Ok(Some(GlossTexture::new(parts.collect(), texels.collect())))
}

/// The main lobe: of the strength that was found where the light was given.
fn stored_lobe(manifest: &Manifest) -> Option<Brdf> {
    let (model, sigma) = manifest.specular_model.zip(manifest.sigma)?;
    let lobe = Brdf::new(model, sigma);
    Some(match &manifest.known_light {
        Some(known) => lobe.with_reflectance(known.reflectance()),
        None => lobe,
    })
}

/// The hemisphere that the manifest describes, if everything in it makes sense.
fn check_manifest(manifest: &Manifest) -> Result<HemisphereGrid, String> {
    let hemisphere = &manifest.hemisphere;
    if !(1..=200).contains(&hemisphere.frequency) {
        return Err(format!(
            "the hemisphere's frequency is {}",
            hemisphere.frequency
        ));
    }
    if (Vec3::from(hemisphere.up).length() - 1.0).abs() > 1e-3 {
        return Err("the hemisphere's up is no unit vector".to_owned());
    }
    if hemisphere
        .radius
        .is_some_and(|r| !(r > 0.0 && r.is_finite()))
    {
        return Err("the hemisphere's radius is not positive".to_owned());
    }
    if !DVec3::from(hemisphere.centre).as_vec3().is_finite() {
        return Err("the hemisphere's centre is not finite".to_owned());
    }
    let lamps = &manifest.lights;
    let numbers = lamps.iter().flat_map(|l| l.direction.iter().chain(&l.flux));
    if numbers.copied().any(|v| !v.is_finite()) {
        return Err("a light's direction or flux is not finite".to_owned());
    }
    if manifest.sigma.is_some_and(|s| !(s > 1e-4 && s < 2.0)) {
        return Err("sigma is out of range".to_owned());
    }
    if let Some(fault) = manifest.known_light.as_ref().and_then(KnownLight::fault) {
        return Err(fault.to_owned());
    }
    if manifest.sigma.is_some() != manifest.specular_model.is_some() {
        return Err("sigma and specular_model do not fit together".to_owned());
    }
    if manifest
        .ambient
        .iter()
        .any(|a| !(a.is_finite() && *a >= 0.0))
    {
        return Err("the ambient part is negative".to_owned());
    }
    let grid = HemisphereGrid::new(
        hemisphere.frequency,
        hemisphere.up.into(),
        hemisphere.radius,
        Vec3::ZERO,
    );
    let above = grid.directions.len();
    if hemisphere.nodes == above {
        return Ok(grid);
    }
    // Light comes from below the horizon as well.
    let whole = grid.to_whole();
    if hemisphere.nodes == whole.directions.len() {
        return Ok(whole);
    }
    Err(format!(
        "{} nodes are stated where the frequency gives {above}, or {} with those below the horizon",
        hemisphere.nodes,
        whole.directions.len()
    ))
}
