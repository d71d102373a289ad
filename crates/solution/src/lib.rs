//! What is saved of a solve: a folder that opens anywhere, complete without the capture.
//!
//! | file | holds |
//! | --- | --- |
//! | `solution.json` | everything in numbers: see `format` |
//! | `nodes.json` | radiance of every lit node, exact, and the lamps' nodes |
//! | `hemisphere.exr` | the lighting as a lat-long picture |
//! | `hemispheres/*.exr` | initial hemisphere and those of single views, seen from above |
//! | `cameras.json` | from where the photographs were taken, as a `transforms.json` without photographs |
//! | `mesh.ply`, `mesh.obj` | the surface with texture coordinates |
//! | `roughness.exr`, `specular_strength.exr` | where parts differ in gloss: σ in radians, and strength as a multiple of the main lobe's, RGB where parts reflect in different colours |
//! | `diffuse.exr`, `albedo.exr`, `confidence.exr` | textures: diffuse radiance, pseudo-albedo, how far each texel is known |
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use rekindle_capture::Capture;
//! use rekindle_estimate::estimate::{EstimateParams, Unobserved};
//! use rekindle_solution::{SolveOptions, solve};
//!
//! let capture = Capture::load("capture".as_ref())?;
//! let options = SolveOptions { estimate: EstimateParams::default(), frequency: 70, radius: None, light_frame: None };
//! let solution = solve(&capture, &options, 0.0, &mut Unobserved)?;
//! solution.save("solution".as_ref())?;
//! # Ok(())
//! # }
//! ```

mod diffuse_alone;
mod error;
mod exr_file;
mod format;
mod known_light;
mod materials;
mod mesh_file;
mod mirrored;
mod origin;
mod placed;
mod solve;
mod turntable;

pub use diffuse_alone::diffuse_alone;
pub use error::SolutionError;
pub use exr_file::{write_rgb, write_rgba};
pub use format::{Fit, Skipped};
pub use known_light::{KnownLight, LightProbe};
pub use materials::SurfacePart;
pub use mesh_file::{write_obj, write_plain_obj};
pub use origin::origin;
pub use placed::{manifest_of, write_mesh_transform, write_placed_mesh};
pub use solve::{SolveOptions, solve, solve_under};

use std::borrow::Cow;
use std::fs;
use std::io;
use std::path::Path;
use std::time::Instant;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use format::{
    FORMAT, Head, Hemisphere, Light, Listed, Manifest, Nodes, Texture, VERSION,
    VERSION_OF_ONE_GLOSS, VERSION_OF_WHITE_GLOSS,
};
use rekindle_base::files;
use rekindle_base::staging::{DestinationError, Owned, Staging, cannot_write, check_owned};
use rekindle_capture::{Camera, LightFrame, Mesh, read_cameras, transforms};
use rekindle_estimate::estimate::{Diagnostics, Iteration, Method};
use rekindle_estimate::registration::Correction;
use rekindle_relight::{GlossMap, LampNodes, LightNode, Lighting};
use rekindle_scene::hemisphere::{HemisphereGrid, Picture, lat_long};
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};
use rekindle_scene::surface::{Atlas, GlossTexture};

/// Rows of the lat-long picture: a node is some three pixels tall at frequency 70.
const LATLONG_ROWS: u32 = 512;
/// The file by which a solution is known.
const MANIFEST: &str = "solution.json";
/// Folder of pictures of hemispheres in a solution.
const HEMISPHERES: &str = "hemispheres";
/// Roughness σ of each texel, radians, and what it reflects as a multiple of the main lobe's; only where parts differ.
const ROUGHNESS: &str = "roughness.exr";
const STRENGTH: &str = "specular_strength.exr";
/// First line of the mesh as OBJ.
const OBJ_HEAD: &str = "# written by rekindle; texture diffuse.exr\n";
/// Least roughness of a texel as a multiple of the main one's, and one over the largest: what files say beyond is a mistake.
const MIN_GLOSS_ROUGHNESS: f32 = 0.01;
/// Lit nodes outside all lamps that are kept apart.
const MAX_STRAYS: usize = 24;
/// Nodes outside all lamps that together have no more than this part of the flux, the weakest, are left dark: their
/// highlights are as much weaker than a lamp's, and each would cost what a lamp costs.
const NEGLIGIBLE_SHARE: f32 = 2e-3;

/// A lamp that the estimate found.
#[derive(Clone, Debug, PartialEq)]
pub struct SolutionLamp {
    /// What people call it.
    pub name: String,
    /// Flux-weighted mean direction from the object's centre, unit.
    pub direction: Vec3,
    /// Radiance × solid angle, RGB.
    pub flux: Vec3,
    /// √2 × flux-weighted rms angle of its nodes, radians.
    pub angular_radius: f32,
    /// Nodes of the hemisphere.
    pub nodes: Vec<u32>,
}

/// A picture of a hemisphere seen from straight above.
#[derive(Clone, Debug)]
pub struct HemispherePicture {
    /// File name without extension.
    pub name: String,
    /// The picture.
    pub picture: Picture,
}

/// Everything a solve found.
pub struct Solution {
    /// The capture's name.
    pub name: String,
    /// What it was made of, see [`origin()`]; empty in solutions that were written before this was kept.
    pub origin: String,
    /// The estimation method.
    pub method: Method,
    /// Specular model and roughness; `None` where no specular part was found.
    pub brdf: Option<Brdf>,
    /// Why this specular model, in words.
    pub chosen_because: String,
    /// What was corrected about each view; empty where all were taken as stated.
    pub corrections: Vec<Correction>,
    /// 95 % interval of σ, radians.
    pub sigma_interval95: Option<[f32; 2]>,
    /// The light's picture, where the light was given and not estimated.
    pub known_light: Option<KnownLight>,
    /// What the lights stand still with; with the camera, they are those before the first of `cameras`.
    pub light_frame: LightFrame,
    /// The nodes of light.
    pub grid: HemisphereGrid,
    /// Radiance of every node, RGB, `K_S`-scaled.
    pub radiance: Vec<[f32; 3]>,
    /// Brightest first.
    pub lamps: Vec<SolutionLamp>,
    /// Radiance from every direction alike, RGB, `K_S`-scaled.
    pub ambient: Vec3,
    /// What the data could say.
    pub diagnostics: Diagnostics,
    /// How well the input views are reproduced.
    pub fit: Fit,
    /// What was not done because the capture doesn't need it.
    pub skipped: Skipped,
    /// Seconds of each stage, in order.
    pub timings: Vec<(String, f64)>,
    /// The estimation's iterations.
    pub convergence: Vec<Iteration>,
    /// From where the photographs were taken, with their names; none in solutions that were written before these were kept.
    pub cameras: Vec<(String, Camera)>,
    /// The surface; its texture coordinates are the atlas's.
    pub mesh: Mesh,
    /// Where each triangle lies in the textures.
    pub atlas: Atlas,
    /// Diffuse radiance per texel under the captured lighting.
    pub diffuse: Vec<[f32; 3]>,
    /// Pseudo-albedo per texel.
    pub albedo: Vec<[f32; 3]>,
    /// How far each texel is known, 0 to 1.
    pub confidence: Vec<f32>,
    /// How the lobe of each texel differs from `brdf`; `None` where one is all.
    pub gloss: Option<GlossTexture>,
    /// Initial and partial hemispheres; written, not read back.
    pub pictures: Vec<HemispherePicture>,
}

impl Solution {
    /// The captured lighting, ready to be edited.
    pub fn lighting(&self) -> Lighting {
        lighting(
            &self.grid,
            &self.radiance,
            &self.lamps,
            self.ambient,
            (self.brdf, self.known_light.as_ref()),
        )
    }

    /// A lighting, which is stated as the object has it before the first camera, as it has it before another.
    pub fn lighting_before<'l>(
        &self,
        lighting: &'l Lighting,
        camera: &Camera,
    ) -> Cow<'l, Lighting> {
        match (self.light_frame, self.cameras.first()) {
            (LightFrame::Camera, Some((_, first))) => {
                let moved = camera.world_from_camera * first.world_from_camera.inverse();
                Cow::Owned(lighting.moved(&moved))
            }
            _ => Cow::Borrowed(lighting),
        }
    }

    /// How the lobe differs from place to place, where it does.
    pub fn gloss_map(&self) -> Option<GlossMap<'_>> {
        let atlas = &self.atlas;
        (self.gloss.as_ref()).map(|texture| GlossMap { atlas, texture })
    }

    /// What `solution.json` says.
    pub fn summary(&self) -> serde_json::Value {
        // By way of text, in which a float has no more digits than it needs.
        let text = serde_json::to_string(&self.manifest()).unwrap_or_default();
        serde_json::from_str(&text).unwrap_or_default()
    }

    /// Radiance to be shown as white: a little above the brightest diffuse parts under the captured lighting, so that all
    /// pictures of a solution have one exposure and highlights can be told from them. A metal, which has none, counts as if it sent
    /// what it reflects in all directions alike.
    pub fn white(&self) -> f32 {
        let diffuse = self.brightest(&self.diffuse);
        let metal = self.brdf.filter(|b| b.model == SpecularModel::Metal);
        let evenly = metal.map_or(0.0, |b| {
            // F₀ E/π of the light as it is, with E times K_S = F₀/(8πσ²) known.
            8.0 * b.sigma * b.sigma * self.lighting().flux().element_sum() / 3.0
        });
        (1.3 * diffuse.max(evenly)).max(f32::MIN_POSITIVE)
    }

    /// The value of a texture that 98 % of its known texels stay below in the mean over channels, 1 where nothing is known.
    pub fn brightest(&self, texture: &[[f32; 3]]) -> f32 {
        /// Texels that count as known.
        const KNOWN: f32 = 0.1;
        let mut means: Vec<f32> = texture
            .iter()
            .zip(&self.confidence)
            .filter(|(_, confidence)| **confidence > KNOWN)
            .map(|(texel, _)| texel.iter().sum::<f32>() / 3.0)
            .collect();
        if means.is_empty() {
            return 1.0;
        }
        let at = (means.len() - 1) * 98 / 100;
        *means.select_nth_unstable_by(at, f32::total_cmp).1
    }

    /// Part of the textures that views have seen.
    pub fn seen(&self) -> f32 {
        let seen = self.confidence.iter().filter(|c| **c > 0.0).count();
        let used = self
            .albedo
            .iter()
            .filter(|a| **a != [0.0; 3])
            .count()
            .max(seen);
        seen as f32 / used.max(1) as f32
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

/// The lighting of an estimate. A compact lamp shines as a uniform disc with its direction, flux and extent: single nodes of
/// a solved lamp are spiky, and a shadow's soft edge would show each of them. Wider lamps keep their nodes. Lit nodes that
/// no lamp claims are the remainder.
pub fn lighting(
    grid: &HemisphereGrid,
    radiance: &[[f32; 3]],
    lamps: &[SolutionLamp],
    ambient: Vec3,
    (brdf, known): (Option<Brdf>, Option<&KnownLight>),
) -> Lighting {
    let node = |i: u32| LightNode {
        direction: grid.directions[i as usize],
        radiance: radiance[i as usize].into(),
        solid_angle: grid.solid_angle,
    };
    let mut claimed = vec![false; radiance.len()];
    for &i in lamps.iter().flat_map(|l| &l.nodes) {
        claimed[i as usize] = true;
    }
    let lamps: Vec<LampNodes> = lamps
        .iter()
        .filter_map(|lamp| {
            LampNodes::new(lamp.nodes.iter().map(|&i| node(i)).collect(), grid.radius)
        })
        .collect();
    let strays = (0..radiance.len() as u32)
        .filter(|&i| !claimed[i as usize] && radiance[i as usize] != [0.0; 3])
        .map(node)
        .collect();
    let flux: Vec3 = lamps.iter().map(LampNodes::flux).sum();
    let total = flux.element_sum();
    // Of a metal and its light only the product is seen: where the light isn't known it is taken as white, so that new light is
    // coloured.
    let tint = match (brdf, known) {
        (Some(brdf), Some(known)) if brdf.model == SpecularModel::Metal => known.tint(),
        (Some(brdf), None) if brdf.model == SpecularModel::Metal && total > 0.0 => {
            Some(3.0 * flux / total)
        }
        _ => None,
    };
    let tint = tint.unwrap_or(Vec3::ONE);
    Lighting {
        lamps,
        remainder: strongest(strays, NEGLIGIBLE_SHARE * total),
        environment: None,
        ambient,
        centre: grid.centre,
        radius: grid.radius,
        up: grid.up,
        specular_scale: tint * brdf.map_or(1.0, |brdf| brdf.usual_specular_scale()),
    }
}

/// At most [`MAX_STRAYS`] nodes, the strongest; each takes the light of the weaker ones it is nearest to. The weakest are
/// left out, up to the flux `negligible` of all of them.
fn strongest(mut strays: Vec<LightNode>, mut negligible: f32) -> Vec<LightNode> {
    let strength = |n: &LightNode| n.flux().element_sum();
    strays.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    while let Some(weakest) = strays.last().map(strength)
        && weakest <= negligible
    {
        negligible -= weakest;
        strays.pop();
    }
    let weaker = strays.split_off(strays.len().min(MAX_STRAYS));
    for node in weaker {
        let closeness = |n: &LightNode| n.direction.dot(node.direction);
        let nearest = strays
            .iter_mut()
            .max_by(|a, b| closeness(a).total_cmp(&closeness(b)));
        if let Some(nearest) = nearest {
            nearest.radiance += node.radiance;
        }
    }
    strays
}

fn to_map(timings: &[(String, f64)]) -> serde_json::Map<String, serde_json::Value> {
    timings
        .iter()
        .map(|(stage, seconds)| (stage.clone(), (*seconds).into()))
        .collect()
}

fn write_json(path: &Path, value: &impl serde::Serialize, pretty: bool) -> io::Result<()> {
    let text = if pretty {
        serde_json::to_vec_pretty(value)
    } else {
        serde_json::to_vec(value)
    };
    fs::write(path, text.map_err(io::Error::other)?)
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, SolutionError> {
    let text = files::read(path).map_err(|source| SolutionError::Read {
        path: path.to_owned(),
        source,
    })?;
    serde_json::from_slice(&text).map_err(|source| SolutionError::Json {
        path: path.to_owned(),
        source,
    })
}

fn read_manifest(folder: &Path, path: &Path) -> Result<Manifest, SolutionError> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, DQuat, DVec2, DVec3};
    use rekindle_base::damage::{Random, damaged};
    use rekindle_capture::Distortion;
    use rekindle_scene::reflectance::SpecularModel;
    use rekindle_scene::shortcuts::LeftOut;

    fn camera() -> Camera {
        Camera {
            width: 64,
            height: 48,
            focal: DVec2::new(70.1, 71.3),
            centre: DVec2::new(31.7, 24.9),
            distortion: Distortion {
                k: [0.1, -0.02, 0.003, 0.0],
                p: [1e-3, -2e-3],
                denominator: [0.04, 0.05, 0.06],
                fisheye: false,
            },
            world_from_camera: DAffine3::from_rotation_translation(
                DQuat::from_rotation_x(0.3),
                DVec3::new(1.0, 2.0, 3.0),
            ),
        }
    }

    pub(super) fn example() -> Solution {
        let grid = HemisphereGrid::new(4, Vec3::Y, Some(3.0), Vec3::new(0.1, 0.2, 0.3));
        let mut radiance = vec![[0.0; 3]; grid.directions.len()];
        radiance[5] = [0.1, 20.0, 1e-7];
        radiance[6] = [0.3, 2.0, 1.0];
        let mesh = Mesh {
            origin: glam::DVec3::ZERO,
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Z],
            normals: vec![Vec3::Y; 3],
            uvs: Vec::new(),
            triangles: vec![[0, 2, 1]],
        };
        let corners = [
            Vec2::new(0.5, 0.5),
            Vec2::new(3.5, 0.5),
            Vec2::new(0.5, 3.5),
        ];
        Solution {
            name: "example".to_owned(),
            method: Method::default(),
            brdf: Some(Brdf::new(SpecularModel::Beckmann, 0.075_123)),
            chosen_because: "it was asked for".to_owned(),
            origin: String::new(),
            corrections: Vec::new(),
            sigma_interval95: Some([0.07, 0.08]),
            known_light: None,
            light_frame: LightFrame::World,
            lamps: vec![SolutionLamp {
                name: "Light 1".to_owned(),
                direction: grid.directions[5],
                flux: Vec3::new(1.0, 2.0, 3.0),
                angular_radius: 0.05,
                nodes: vec![5],
            }],
            grid,
            radiance,
            ambient: Vec3::splat(0.01),
            diagnostics: Diagnostics::default(),
            fit: Fit::default(),
            skipped: Skipped {
                left_out: vec![LeftOut {
                    what: "lobes".to_owned(),
                    all: 5,
                    left_out: 3,
                }],
                stages: vec!["refining".to_owned()],
            },
            timings: Vec::new(),
            convergence: Vec::new(),
            cameras: vec![("images/a.exr".to_owned(), camera())],
            mesh,
            atlas: Atlas::from_corners(4, 4, vec![corners], false),
            diffuse: (0..16).map(|i| [i as f32 * 0.1; 3]).collect(),
            albedo: (0..16).map(|i| [i as f32 * 0.2; 3]).collect(),
            confidence: (0..16).map(|i| i as f32 / 16.0).collect(),
            gloss: None,
            pictures: Vec::new(),
        }
    }

    #[test]
    fn a_solution_comes_back_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solution");
        let saved = example();
        saved.save(&path).unwrap();
        // Saving again replaces it.
        saved.save(&path).unwrap();
        let read = Solution::load(&path).unwrap();
        assert_eq!(read.radiance, saved.radiance);
        assert_eq!(read.brdf, saved.brdf);
        assert_eq!(read.diffuse, saved.diffuse);
        assert_eq!(read.albedo, saved.albedo);
        assert_eq!(read.confidence, saved.confidence);
        assert_eq!(read.mesh.positions, saved.mesh.positions);
        assert_eq!(read.lighting(), saved.lighting());
        let (name, seen) = &read.cameras[0];
        assert_eq!(name, "images/a.exr");
        assert_eq!(seen.distortion, camera().distortion);
        let point = DVec3::new(0.9, 1.7, 0.4);
        let (now, then) = (seen.project(point), camera().project(point));
        assert!(now.unwrap().distance(then.unwrap()) < 1e-9, "{now:?}");
        for (a, b) in read.atlas.corner_uvs[0]
            .iter()
            .zip(&saved.atlas.corner_uvs[0])
        {
            assert!(a.distance(*b) < 1e-5, "{a} was {b}");
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn light_that_stands_still_with_the_camera_comes_back_and_goes_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solution");
        let mut saved = example();
        saved.light_frame = LightFrame::Camera;
        saved.save(&path).unwrap();
        let read = Solution::load(&path).unwrap();
        assert_eq!(read.light_frame, LightFrame::Camera);
        // The first camera sees the light as it is stated; one that went around the object by a quarter has taken it along.
        let mut camera = read.cameras[0].1.clone();
        let lighting = read.lighting();
        let lamp = |camera: &Camera| read.lighting_before(&lighting, camera).lamps[0].direction;
        let before = lighting.lamps[0].direction;
        assert!(lamp(&camera).distance(before) < 1e-5);
        let quarter = DAffine3::from_axis_angle(DVec3::Y, std::f64::consts::FRAC_PI_2);
        camera.world_from_camera = quarter * camera.world_from_camera;
        let taken_along = quarter.transform_vector3(before.as_dvec3()).as_vec3();
        assert!(lamp(&camera).distance(taken_along) < 1e-5);
        // Light that stands still with the object stays.
        assert!(example().lighting_before(&lighting, &camera).as_ref() == &lighting);
    }

    #[test]
    fn light_below_the_horizon_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solution");
        let mut saved = example();
        saved.grid = saved.grid.to_whole();
        let lowest = saved.grid.directions.len() - 1;
        assert!(saved.grid.directions[lowest].y < 0.0);
        saved.radiance.resize(lowest + 1, [0.0; 3]);
        saved.radiance[lowest] = [1.0, 2.0, 3.0];
        saved.save(&path).unwrap();
        let read = Solution::load(&path).unwrap();
        assert!(read.grid.whole);
        assert_eq!(read.radiance, saved.radiance);
        assert_eq!(read.lighting(), saved.lighting());
    }

    #[test]
    fn unreadable_solutions_say_why() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solution");
        let message = |path: &Path| Solution::load(path).err().unwrap().to_string();
        assert!(message(&path).contains("no solution here"));
        example().save(&path).unwrap();
        let manifest = path.join("solution.json");
        let text = fs::read_to_string(&manifest).unwrap();
        fs::write(&manifest, text.replace("\"version\": 1", "\"version\": 9")).unwrap();
        assert!(message(&path).contains("newer"));
        fs::write(&manifest, &text).unwrap();
        fs::remove_file(path.join("albedo.exr")).unwrap();
        assert!(message(&path).contains("albedo.exr"));
    }

    #[test]
    fn damaged_solutions_are_refused_or_read() {
        let mut random = Random(11);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solution");
        example().save(&path).unwrap();
        let files = [
            ("solution.json", 400),
            ("nodes.json", 300),
            ("mesh.ply", 300),
            ("albedo.exr", 150),
            ("confidence.exr", 150),
        ];
        for (name, rounds) in files {
            let file = path.join(name);
            let whole = fs::read(&file).unwrap();
            for _ in 0..rounds {
                fs::write(&file, damaged(&whole, &mut random)).unwrap();
                match Solution::load(&path) {
                    Ok(solution) => {
                        assert_eq!(solution.radiance.len(), solution.grid.directions.len());
                        let count = solution.atlas.len();
                        let textures = [solution.diffuse.len(), solution.confidence.len()];
                        assert_eq!(textures, [count; 2], "one value per texel");
                        let _ = (solution.lighting(), solution.summary());
                    }
                    Err(error) => assert!(error.to_string().contains("solution"), "{error}"),
                }
            }
            fs::write(&file, whole).unwrap();
        }
        assert!(Solution::load(&path).is_ok());
    }

    #[test]
    fn a_solution_of_absurd_data_can_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solution");
        let mut solution = example();
        solution.fit.residual_rms = f64::INFINITY;
        solution.fit.psnr_db_per_view = vec![f32::NAN, 40.0];
        solution.save(&path).unwrap();
        let read = Solution::load(&path).unwrap();
        assert_eq!(read.fit.psnr_db_per_view[1], 40.0);
    }

    #[test]
    fn a_folder_of_something_else_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("thesis.tex"), "x").unwrap();
        let error = example().save(folder.path()).unwrap_err().to_string();
        assert!(error.contains("not a solution"), "{error}");
        // Nor with a solution.json of something else.
        fs::write(folder.path().join(MANIFEST), "{\"format\": \"chemistry\"}").unwrap();
        let error = example().save(folder.path()).unwrap_err().to_string();
        assert!(error.contains("not a solution"), "{error}");
        assert!(folder.path().join("thesis.tex").exists());
    }

    fn pictured() -> Solution {
        let picture = |name: &str| HemispherePicture {
            name: name.to_owned(),
            picture: lat_long(&example().grid, &example().radiance, 4),
        };
        Solution {
            pictures: vec![picture("initial"), picture("partial_000")],
            ..example()
        }
    }

    #[test]
    fn parts_of_other_gloss_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solution");
        let mut solution = example();
        let white = |k: usize| Gloss::new(0.5 + k as f32 / 7.0, [1.0, 0.0, 1.25][k % 3]);
        let metal = |k: usize| match k % 3 {
            2 => white(k).reflecting(Vec3::new(14.0, 9.0, 4.0)),
            _ => white(k),
        };
        let all: [(&dyn Fn(usize) -> Gloss, u32); 2] = [(&white, 2), (&metal, 3)];
        for (gloss, version) in all {
            let texels = (0..solution.atlas.len()).map(gloss).collect();
            let parts = (0..3).map(gloss).collect();
            solution.gloss = Some(GlossTexture::new(parts, texels));
            solution.save(&path).unwrap();
            let text = fs::read_to_string(path.join(MANIFEST)).unwrap();
            assert!(text.contains(&format!("\"version\": {version},")), "{text}");
            let found = Solution::load(&path).unwrap().gloss.unwrap();
            assert_eq!(found.is_coloured(), version == 3);
            for (k, found) in found.texels().iter().enumerate() {
                assert!((found.roughness / gloss(k).roughness - 1.0).abs() < 1e-5);
                if Gloss::is_white(&gloss(k).tint) {
                    assert_eq!((found.strength, found.tint), (gloss(k).strength, [1.0; 3]));
                }
                let off = found.scale() - gloss(k).scale();
                assert!(off.abs().max_element() < 1e-5, "{off}");
            }
        }
        fs::remove_file(path.join(STRENGTH)).unwrap();
        let error = Solution::load(&path).err().unwrap().to_string();
        assert!(error.contains(STRENGTH), "{error}");
        // With one gloss for all, older programs can read it.
        let one = folder.path().join("one");
        example().save(&one).unwrap();
        let text = fs::read_to_string(one.join(MANIFEST)).unwrap();
        assert!(text.contains("\"version\": 1,"), "{text}");
    }

    #[test]
    fn what_a_solution_did_not_write_is_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solution");
        pictured().save(&path).unwrap();
        example().save(&path).unwrap();
        assert!(!path.join(HEMISPHERES).exists(), "all of the old one goes");
        pictured().save(&path).unwrap();
        for (name, is_folder) in [
            ("notes.txt", false),
            ("paintings", true),
            ("hemispheres/partial_000.png", false),
            ("hemispheres/mine", true),
        ] {
            let other = path.join(name);
            if is_folder {
                fs::create_dir(&other).unwrap();
            } else {
                fs::write(&other, "x").unwrap();
            }
            let error = check_destination(&path).unwrap_err().to_string();
            assert!(error.contains(name), "{error} does not name {name}");
            assert!(example().save(&path).is_err());
            assert!(other.exists() && Solution::load(&path).is_ok());
            if is_folder {
                fs::remove_dir(&other).unwrap();
            } else {
                fs::remove_file(&other).unwrap();
            }
        }
        assert!(check_destination(&path).unwrap().is_empty());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn files_are_known_of_solutions_that_do_not_list_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("solution");
        pictured().save(&path).unwrap();
        let manifest = path.join(MANIFEST);
        let mut value: serde_json::Value = read_json(&manifest).unwrap();
        let listed = value.as_object_mut().unwrap().remove("files").unwrap();
        assert_eq!(listed.as_array().unwrap().len(), 11);
        write_json(&manifest, &value, true).unwrap();
        fs::write(path.join("notes.txt"), "x").unwrap();
        let error = check_destination(&path).unwrap_err().to_string();
        assert!(error.contains(": holds notes.txt, which"), "{error}");
        fs::remove_file(path.join("notes.txt")).unwrap();
        pictured().save(&path).unwrap();
    }
}
