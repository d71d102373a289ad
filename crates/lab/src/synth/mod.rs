//! What would a capture with known truth look like? Makes captures to study the estimator with.
//!
//! [`make`] writes a folder like a photographed capture, with a folder `truth` beside the photographs that holds what an
//! estimate should find: `truth.json`, `environment.exr`, the photographs' diffuse and specular parts, and pictures from
//! new viewpoints and under new light. The pictures come from this program's own reference renderer, so the estimate's
//! model of light is exactly the truth's: a good result on them is necessary, and not sufficient.

mod cameras;
mod environment;
mod error;
mod files;
mod lamps;
mod mesh_errors;
mod mistake;
mod object;
mod recipe;
mod scene;
mod sensor;
mod tessellate;
#[cfg(test)]
mod tests;
mod texture;
mod truth;

pub use error::SynthError;
pub use object::Object;
pub use recipe::{
    Encode, Files, GeometryErrors, Lamps, Light, Material, Mistake, Normals, Places, Recipe,
    Sensor, Views,
};

use std::fs;
use std::io;
use std::ops::ControlFlow;
use std::path::Path;

use serde::{Deserialize, Serialize};

use cameras::{Stand, misaligned};
use files::{Folder, Taken, photographs};
use lamps::TrueLamp;
use mesh_errors::stated_mesh;
use rekindle_base::math::random::Random;
use rekindle_base::staging::{DestinationError, Owned, Staging, cannot_write, check_owned};
use rekindle_capture::{Camera, LightFrame};
use rekindle_relight::{Lighting, Picture};
use rekindle_solution::{write_plain_obj, write_rgb};
use scene::{TrueLight, TrueSurface};
use sensor::Exposed;

/// Input views from which pictures under new light are taken, at most.
const RELIT_VIEWS: usize = 3;
/// Near lamps are at least this many radii of the object away from its centre.
const NEAREST_LAMP: f32 = 1.3;

/// File that lists all files of a made capture.
const LIST: &str = "truth/files.json";
/// What the list's `format` says.
const LIST_FORMAT: &str = "rekindle-synth";

/// What a seed's numbers are for.
#[derive(Clone, Copy)]
enum Purpose {
    Texture,
    Lamps,
    Cameras,
    Rotations,
    Mesh,
    Sensor,
    Times,
    Mistake,
}

/// Hears what is done and which part of the whole is done, and may stop it.
pub type Progress<'a> = &'a mut dyn FnMut(&str, f32) -> ControlFlow<()>;

/// Makes a capture and writes it to a folder, which appears whole or not at all. One that was made there is replaced.
pub fn make(recipe: &Recipe, folder: &Path, progress: Progress) -> Result<(), SynthError> {
    let staging = Staging::beside(folder).map_err(cannot_write(folder))?;
    check_replaceable(folder)?;
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    Maker::new(recipe, progress)?.write(&name, staging.path(), folder)?;
    write_list(staging.path()).map_err(cannot_write(folder))?;
    Ok(staging.replace(check_replaceable)?)
}

/// Fails if something is in the way that was not made here, so that this is known before any work is done. Returns what
/// runs that were killed had left there and what became of it, in whole sentences.
pub fn check_destination(folder: &Path) -> Result<Vec<String>, SynthError> {
    let staging = Staging::beside(folder).map_err(cannot_write(folder))?;
    check_replaceable(folder)?;
    Ok(staging.settled().to_vec())
}

/// The list of all files of a made capture, itself included.
#[derive(Serialize, Deserialize)]
struct List {
    format: String,
    files: Vec<String>,
}

/// Writes the list of what is in a folder.
fn write_list(folder: &Path) -> io::Result<()> {
    let mut files = Owned::all_in(folder)?.listed();
    files.push(LIST.to_owned());
    let list = List {
        format: LIST_FORMAT.to_owned(),
        files,
    };
    fs::write(folder.join(LIST), serde_json::to_vec_pretty(&list)?)
}

/// Refuses to replace anything but an earlier made capture with nothing else in it.
fn check_replaceable(folder: &Path) -> Result<(), DestinationError> {
    let list = fs::read(folder.join(LIST)).ok();
    let list: Option<List> = list.and_then(|text| serde_json::from_slice(&text).ok());
    let owned = list
        .filter(|list| list.format == LIST_FORMAT)
        .map(|list| list.files.into_iter().collect());
    check_owned(
        folder,
        owned,
        "a capture that `rekindle synth` made (those have a list of their files, truth/files.json)",
    )
}

/// A recipe on its way to a capture.
struct Maker<'a> {
    recipe: &'a Recipe,
    surface: TrueSurface,
    light: TrueLight,
    stand: Stand,
    cameras: Vec<Camera>,
    progress: Counted<'a>,
}

/// Progress by the number of pictures.
struct Counted<'a> {
    progress: Progress<'a>,
    done: usize,
    all: usize,
}

impl Counted<'_> {
    fn picture(&mut self, what: &str) -> Result<(), SynthError> {
        let part = 0.05 + 0.95 * self.done as f32 / self.all.max(1) as f32;
        self.done += 1;
        match (self.progress)(what, part) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(SynthError::Stopped),
        }
    }
}

fn random(recipe: &Recipe, purpose: Purpose) -> Random {
    Random::new(recipe.seed, purpose as u64)
}

impl<'a> Maker<'a> {
    fn new(recipe: &'a Recipe, progress: Progress<'a>) -> Result<Self, SynthError> {
        if progress("shaping the object", 0.0).is_break() {
            return Err(SynthError::Stopped);
        }
        let mesh = TrueSurface::mesh_of(recipe);
        let stand = Stand::new(&mesh, recipe.views);
        let light =
            TrueLight::new(recipe, random(recipe, Purpose::Lamps)).map_err(SynthError::Probe)?;
        let least = NEAREST_LAMP * stand.object_radius() as f32;
        if let Some(distance) = light.lamps().first().and_then(|lamp| lamp.distance)
            && distance < least
        {
            return Err(SynthError::LampTooNear { distance, least });
        }
        let magnification = stand.largest_magnification();
        let texture = random(recipe, Purpose::Texture);
        let surface = TrueSurface::new(recipe, mesh, magnification, texture);
        let cameras = stand.input(random(recipe, Purpose::Cameras));
        let lamps = light.lamps().len();
        let relit = if lamps > 0 { lamps + 1 } else { 0 };
        let more = stand.novel().len() + relit * RELIT_VIEWS.min(cameras.len());
        let all = cameras.len() + if recipe.truth_pictures { more } else { 0 };
        Ok(Self {
            recipe,
            surface,
            light,
            stand,
            cameras,
            progress: Counted {
                progress,
                done: 0,
                all,
            },
        })
    }

    /// Writes everything to `into`; messages name `folder`.
    fn write(mut self, name: &str, into: &Path, folder: &Path) -> Result<(), SynthError> {
        let lighting = match &self.light {
            TrueLight::Lamps(lamps) => self.surface.lamps(lamps),
            TrueLight::Probe(probe) => self.surface.probe(probe, self.recipe.views.scale),
        };
        let pictures = self.take("photographing", &lighting, &self.cameras.clone())?;
        self.write_input(name, into, &pictures)
            .map_err(cannot_write(folder))?;
        drop(pictures);
        if self.recipe.truth_pictures {
            self.write_pictures(&lighting, &into.join("truth"), folder)?;
        }
        Ok(())
    }

    /// Writes the pictures from elsewhere and under new light.
    fn write_pictures(
        &mut self,
        lighting: &Lighting,
        truth: &Path,
        folder: &Path,
    ) -> Result<(), SynthError> {
        let set = |to: Folder, cameras: &[Camera], pictures: &[Picture]| {
            to.write_clean(cameras, pictures)
                .map_err(cannot_write(folder))
        };
        let novel = self.stand.novel();
        let seen = self.take("taking novel views", lighting, &novel)?;
        set(self.folder(&truth.join("novel"), 2), &novel, &seen)?;
        let relit = self.relit_cameras();
        for (light, lamps) in self.new_lights() {
            let lighting = self.surface.lamps(&lamps);
            let seen = self.take("relighting", &lighting, &relit)?;
            let path = truth.join("relit").join(light);
            set(self.folder(&path, 3), &relit, &seen)?;
        }
        if let Some(lamp) = self.light.lamps().first() {
            let path = truth.join("relit/moved/edit.json");
            files::write_json(&path, &truth::edit(lamp)).map_err(cannot_write(folder))?;
        }
        Ok(())
    }

    fn take(
        &mut self,
        what: &str,
        lighting: &Lighting,
        cameras: &[Camera],
    ) -> Result<Vec<Picture>, SynthError> {
        let progress = &mut self.progress;
        let Some(first) = self.cameras.first().filter(|_| self.recipe.views.turntable) else {
            return self
                .surface
                .photographs(lighting, cameras, &mut |_| progress.picture(what));
        };
        let before_first = first.world_from_camera.inverse();
        let mut taken = Vec::with_capacity(cameras.len());
        for camera in cameras {
            let moved = lighting.moved(&(camera.world_from_camera * before_first));
            let camera = std::slice::from_ref(camera);
            let mut each = |_| progress.picture(what);
            taken.extend(self.surface.photographs(&moved, camera, &mut each)?);
        }
        Ok(taken)
    }

    /// A folder of pictures some folders below the capture's.
    fn folder(&self, path: &Path, depth: usize) -> Folder {
        let frame = if self.recipe.views.turntable {
            LightFrame::Camera
        } else {
            LightFrame::World
        };
        Folder::new(path, depth, self.light_distance(), frame)
    }

    /// The capture itself, and what of the truth belongs to its views.
    fn write_input(&self, name: &str, into: &Path, pictures: &[Picture]) -> io::Result<()> {
        let recipe = self.recipe;
        let mesh_random = random(recipe, Purpose::Mesh);
        let true_mesh = &self.surface.mesh;
        let mut stated = stated_mesh(recipe.object, true_mesh, &recipe.errors, mesh_random);
        let mistakes = random(recipe, Purpose::Mistake);
        if let Some(mistake) = recipe.mistake.filter(|mistake| mistake.spoils_mesh()) {
            mistake.tear(stated.get_or_insert_with(|| true_mesh.clone()), mistakes);
        }
        write_plain_obj(&into.join("mesh.obj"), stated.as_ref().unwrap_or(true_mesh))?;
        let exposed = Exposed::new(recipe.sensor, pictures, random(recipe, Purpose::Sensor));
        let rotations = random(recipe, Purpose::Rotations);
        let mut turned: Vec<Camera> = self
            .cameras
            .iter()
            .enumerate()
            .map(|(i, camera)| misaligned(camera, recipe.errors.rotation, rotations.of(i as u64)))
            .collect();
        if let Some(mistake) = recipe.mistake {
            mistake.misplace(&mut turned, true_mesh.centre().as_dvec3());
        }
        let times = random(recipe, Purpose::Times);
        let folder = self.folder(into, 0);
        let mut taken = Taken::new(&exposed, pictures);
        if let Some(mistake) = recipe.mistake {
            taken.spoil(mistake, mistakes);
        }
        let frames = photographs(&folder, recipe.sensor, &taken, exposed.full_scale, times)?;
        folder.write_manifest(&turned, frames)?;

        let truth = into.join("truth");
        fs::create_dir_all(&truth)?;
        if stated.is_some() {
            write_plain_obj(&truth.join("mesh.obj"), true_mesh)?;
        }
        self.folder(&truth, 1)
            .write_split(&self.cameras, pictures)?;
        let (width, environment) = environment::picture(&self.light, recipe.views.scale);
        write_rgb(&truth.join("environment.exr"), width, &environment)?;
        let centre = true_mesh.centre();
        let described = truth::describe(name, recipe, self.light.lamps(), centre);
        files::write_json(&truth.join("truth.json"), &described)
    }

    fn light_distance(&self) -> Option<f32> {
        self.light.lamps().first().and_then(|lamp| lamp.distance)
    }

    /// Views for pictures under new light: spread over the input views.
    fn relit_cameras(&self) -> Vec<Camera> {
        let count = RELIT_VIEWS.min(self.cameras.len());
        (0..count)
            .map(|k| self.cameras[k * self.cameras.len() / count].clone())
            .collect()
    }

    /// Every lamp alone, and all with the first one moved, by the names of their folders.
    fn new_lights(&self) -> Vec<(String, Vec<TrueLamp>)> {
        let lamps = self.light.lamps();
        let mut lights: Vec<(String, Vec<TrueLamp>)> = lamps
            .iter()
            .enumerate()
            .map(|(i, lamp)| (format!("light_{i}"), vec![*lamp]))
            .collect();
        if let Some((first, others)) = lamps.split_first() {
            let moved = std::iter::once(first.moved()).chain(others.iter().copied());
            lights.push(("moved".to_owned(), moved.collect()));
        }
        lights
    }
}
