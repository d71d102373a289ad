//! Which files are written, and the writing of them.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;
use serde_json::Value;
use thiserror::Error;

use super::asset::{Asset, Source};
use super::fidelity::{Fidelity, fidelity};
use super::gauge::Material;
use super::light_map::{MapLayout, Orientation, Part};
use super::notes::{notes, readme};
use super::{blender, glb, light_list, mitsuba, obj, textures, usd};
use crate::export::{self as pictures, ExportError, Renderer};
use crate::web::{self, Setup, WebError};
use rekindle_base::staging::{DestinationError, Staging, write_advice};
use rekindle_capture::transforms;
use rekindle_relight::Stop;
use rekindle_relight::ViewTransform;

/// Names of files that others refer to.
const OBJ: &str = "object.obj";
const MTL: &str = "object.mtl";
const COLOUR_PNG: &str = "base_color.png";
const COLOUR_EXR: &str = "base_color.exr";
const ROUGHNESS_PNG: &str = "roughness.png";
const SPECULAR_PNG: &str = "specular.png";
const GLOSS_EXR: &str = "gloss.exr";
const SPECULAR_COLOUR_EXR: &str = "specular_colour.exr";
const LIGHT: &str = "light.exr";
const REST: &str = "light_without_lamps.exr";
const README: &str = "README.txt";
/// Usual name of the web page.
pub const PAGE: &str = "object.html";

/// The widest map, and the narrowest.
const WIDTHS: std::ops::RangeInclusive<u32> = 16..=16384;

/// Something to be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Form {
    /// The light as lat-long map: EXR and Radiance HDR, and the lamps as JSON and CSV
    Light,
    /// The cameras as transforms.json
    Cameras,
    /// A script that rebuilds the scene in Blender
    Blender,
    /// A Mitsuba 3 scene
    Mitsuba,
    /// Binary glTF
    Gltf,
    /// USD as text
    Usd,
    /// Wavefront OBJ with MTL and texture
    Obj,
    /// Pictures from the cameras as EXR with layers and a light group for each lamp
    Layers,
    /// One web page in which the object is turned and relit, to be opened from the file
    Web,
}

impl Form {
    /// Those that are commonly wanted: all but pictures, which take their time, and the web page, which is no other program's.
    pub const USUAL: [Self; 7] = [
        Self::Light,
        Self::Cameras,
        Self::Blender,
        Self::Mitsuba,
        Self::Gltf,
        Self::Usd,
        Self::Obj,
    ];
}

/// What to write, and where.
#[derive(Clone, Debug)]
pub struct Job {
    /// Each once.
    pub forms: BTreeSet<Form>,
    /// How the light's map is drawn; programs with their own orientation get theirs.
    pub layout: MapLayout,
    /// A map for each lamp as well, and one of the rest.
    pub per_lamp: bool,
    /// A map with marked axes.
    pub calibration: bool,
    /// Name of the web page's file.
    pub page: String,
    /// Folder for the files; others in it stay.
    pub folder: PathBuf,
}

/// Why nothing was written.
#[derive(Debug, Error)]
pub enum JobError {
    /// It was asked for.
    #[error("the export was stopped; nothing was written")]
    Stopped,
    /// A size that can't be made.
    #[error(
        "a light map of {width} columns can't be written; choose an even number from 16 to 16384"
    )]
    Width {
        /// Asked for.
        width: u32,
    },
    /// The web page can't be made.
    #[error(transparent)]
    Web(WebError),
    /// The pictures with layers can't be made.
    #[error(transparent)]
    Pictures(ExportError),
    /// Others' files are in the way.
    #[error(transparent)]
    Destination(#[from] DestinationError),
    /// Writing failed.
    #[error("{path}: can't be written: {source}; {}", write_advice(.source))]
    Write {
        /// The folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// What was written.
#[derive(Clone, Debug)]
pub struct Exported {
    /// Paths of the files.
    pub files: Vec<PathBuf>,
    /// What other programs show differently, in whole sentences.
    pub notes: Vec<String>,
    /// How near their materials come, where that can be told.
    pub fidelity: Option<Fidelity>,
}

/// Writes a job's files, all or none of them. `progress` hears what is being done and which part is done.
pub fn export(
    source: &Source,
    job: &Job,
    stop: Stop,
    progress: &mut dyn FnMut(&str, f32),
) -> Result<Exported, JobError> {
    let width = job.layout.width;
    if !WIDTHS.contains(&width) || !width.is_multiple_of(2) {
        return Err(JobError::Width { width });
    }
    let failed = |source| JobError::Write {
        path: job.folder.clone(),
        source,
    };
    let staging = Staging::within(&job.folder).map_err(failed)?;
    let asset = Asset::new(source);
    let mut names = Vec::new();
    let pictures = job.forms.contains(&Form::Layers) && !asset.cameras.is_empty();
    // Pictures take most of the time.
    let (written, compared) = if pictures { (0.1, 0.15) } else { (0.7, 1.0) };
    let files = files(&asset, job);
    for (i, file) in files.iter().enumerate() {
        progress(&file.name, written * i as f32 / files.len() as f32);
        if stop() {
            return Err(JobError::Stopped);
        }
        (file.write)(&staging.path().join(&file.name)).map_err(failed)?;
        names.push(file.name.clone());
    }
    if job.forms.contains(&Form::Web) {
        let mut part = |part: f32| progress(&job.page, written * part);
        let html = web_page(source, stop, &mut part)?;
        fs::write(staging.path().join(&job.page), html).map_err(failed)?;
        names.push(job.page.clone());
    }
    // A web page by itself needs no words for other programs.
    let is_page_alone = names == [job.page.as_str()];
    let (fidelity, notes) = if is_page_alone && !pictures {
        (None, Vec::new())
    } else {
        progress("comparison of materials", written);
        let fidelity = fidelity(&asset, stop);
        if pictures {
            let mut part =
                |part: f32, what: &str| progress(what, compared + (1.0 - compared) * part);
            names.extend(layered_pictures(source, staging.path(), stop, &mut part)?);
        }
        let notes = notes(&asset, fidelity);
        fs::write(staging.path().join(README), readme(&asset, &names, &notes)).map_err(failed)?;
        names.push(README.to_owned());
        (fidelity, notes)
    };
    if stop() {
        return Err(JobError::Stopped);
    }
    staging.add()?;
    Ok(Exported {
        files: names.iter().map(|name| job.folder.join(name)).collect(),
        notes,
        fidelity,
    })
}

/// The web page's text, with all setups; first it shows what the first camera does.
fn web_page(
    source: &Source,
    stop: Stop,
    progress: &mut dyn FnMut(f32),
) -> Result<String, JobError> {
    let captured = [Setup::captured(source.solution)];
    let setups: &[Setup] = if source.setups.is_empty() {
        &captured
    } else {
        source.setups
    };
    let towards = source.cameras.first().map(|(_, camera)| -camera.forward());
    web::page(source.solution, setups, towards, stop, progress).map_err(|error| match error {
        WebError::Stopped => JobError::Stopped,
        other => JobError::Web(other),
    })
}

/// Renders an EXR file with all layers for each camera. Returns their names.
fn layered_pictures(
    source: &Source,
    folder: &Path,
    stop: Stop,
    progress: &mut dyn FnMut(f32, &str),
) -> Result<Vec<String>, JobError> {
    let renderer = Renderer::new(source.solution);
    let lighting = Arc::new(source.lighting.clone());
    let shots = (1..).zip(source.cameras).map(|(number, (name, camera))| {
        let stem = Path::new(name).file_stem().unwrap_or_default();
        pictures::Shot {
            stem: format!("layers_{number:03}_{}", stem.to_string_lossy()),
            camera: camera.clone(),
            lighting: Arc::clone(&lighting),
        }
    });
    let job = pictures::Job {
        shots: shots.collect(),
        png: None,
        exr: true,
        layers: true,
        light_groups: true,
        animation: None,
        transform: ViewTransform::default(),
        exposure: 1.0,
        background: None,
        edits: None,
        folder: folder.to_owned(),
    };
    let files = pictures::export(&renderer, &job, stop, progress).map_err(|error| match error {
        ExportError::Stopped { .. } => JobError::Stopped,
        other => JobError::Pictures(other),
    })?;
    let names = files.iter().filter_map(|f| f.file_name());
    Ok(names.map(|n| n.to_string_lossy().into_owned()).collect())
}

type Write<'a> = Box<dyn Fn(&Path) -> io::Result<()> + 'a>;

/// A file to be written.
struct File<'a> {
    name: String,
    write: Write<'a>,
}

/// The files of a job, each once.
struct Files<'a> {
    asset: &'a Asset,
    layout: MapLayout,
    list: Vec<File<'a>>,
}

impl<'a> Files<'a> {
    fn add(&mut self, name: &str, write: impl Fn(&Path) -> io::Result<()> + 'a) {
        if self.list.iter().all(|f| f.name != name) {
            self.list.push(File {
                name: name.to_owned(),
                write: Box::new(write),
            });
        }
    }

    fn text(&mut self, name: &str, text: impl Fn() -> String + 'a) {
        self.add(name, move |path| fs::write(path, text()));
    }

    fn json(&mut self, name: &str, value: impl Fn() -> Value + 'a) {
        self.add(name, move |path| {
            fs::write(path, serde_json::to_vec_pretty(&value())?)
        });
    }

    fn map(&mut self, name: &str, layout: MapLayout, part: Part) {
        let asset = self.asset;
        self.add(name, move |path| {
            textures::write_exr(path, &layout.map(asset, part))
        });
    }

    fn base_colour(&mut self, name: &str, factor: fn(&Material) -> f32) {
        let asset = self.asset;
        self.add(name, move |path| {
            textures::write_base_colour(path, asset, factor)
        });
    }

    fn png(&mut self, name: &str, bytes: impl Fn(&Asset) -> io::Result<Vec<u8>> + 'a) {
        let asset = self.asset;
        self.add(name, move |path| fs::write(path, bytes(asset)?));
    }

    /// Roughness and specular level as pictures, where parts differ.
    fn gloss_pngs(&mut self) -> Option<obj::GlossFiles<'static>> {
        self.asset.gloss.as_ref()?;
        self.png(ROUGHNESS_PNG, textures::roughness_png);
        self.png(SPECULAR_PNG, textures::specular_png);
        Some(obj::GlossFiles {
            roughness: ROUGHNESS_PNG,
            specular: SPECULAR_PNG,
        })
    }

    fn mesh(&mut self) {
        let asset = self.asset;
        self.add(OBJ, move |path| obj::write(path, asset, MTL));
        let gloss = self.gloss_pngs();
        self.text(MTL, move || obj::material(asset, COLOUR_PNG, gloss));
        self.png(COLOUR_PNG, textures::base_colour_png);
    }

    fn light(&mut self) {
        let (asset, layout) = (self.asset, self.layout);
        self.map(LIGHT, layout, Part::Whole);
        self.add("light.hdr", move |path| {
            textures::write_hdr(path, &layout.map(asset, Part::Whole))
        });
        self.json("lights.json", move || light_list::json(asset));
        self.text("lights.csv", move || light_list::csv(asset));
    }

    fn lamps(&mut self) {
        for (index, number) in self.asset.lamp_numbers.iter().enumerate() {
            let name = format!("light_{number}.exr");
            self.map(&name, self.layout, Part::Lamp(index));
        }
        self.map("light_rest.exr", self.layout, Part::Rest);
    }

    fn blender(&mut self) {
        let asset = self.asset;
        self.mesh();
        self.base_colour(COLOUR_EXR, |_| 1.0);
        let gloss = asset.gloss.as_ref().map(|_| GLOSS_EXR);
        if let Some(name) = gloss {
            self.add(name, move |path| textures::write_gloss(path, asset));
        }
        let colour = asset.is_coloured().then_some(SPECULAR_COLOUR_EXR);
        if let Some(name) = colour {
            self.add(name, move |path| {
                textures::write_specular_colour(path, asset)
            });
        }
        let own = self.layout.oriented(Orientation::Blender);
        let light = self.own_light(own, "light_blender.exr");
        self.map(REST, own, Part::Rest);
        self.json("scene.json", move || {
            let files = blender::Files {
                mesh: OBJ,
                base_colour: COLOUR_EXR,
                gloss,
                specular_colour: colour,
                light,
                rest: REST,
            };
            blender::scene(asset, &files)
        });
        self.text("blender_scene.py", || blender::SCRIPT.to_owned());
    }

    fn mitsuba(&mut self) {
        let asset = self.asset;
        self.mesh();
        let base_colour = if mitsuba::diffuse_factor(&asset.material) == 1.0 {
            COLOUR_EXR
        } else {
            "diffuse_mitsuba.exr"
        };
        self.base_colour(base_colour, mitsuba::diffuse_factor);
        let masks: Vec<String> = (1..asset.parts.len())
            .map(|part| format!("part_{}.png", part + 1))
            .collect();
        for (part, name) in (1..).zip(&masks) {
            self.png(name, move |asset| textures::mask_png(asset, part));
        }
        let own = self.layout.oriented(Orientation::Mitsuba);
        let light = self.distant_light(own, "light_mitsuba.exr");
        self.text("mitsuba.xml", move || {
            let files = mitsuba::Files {
                mesh: OBJ,
                base_colour,
                masks: &masks,
                light,
            };
            mitsuba::scene(asset, &files)
        });
    }

    fn usd(&mut self) {
        let asset = self.asset;
        self.png(COLOUR_PNG, textures::base_colour_png);
        let gloss = self.gloss_pngs();
        let own = self.layout.oriented(Orientation::Usd);
        let light = self.distant_light(own, "light_usd.exr");
        self.text("object.usda", move || {
            let files = usd::Files {
                base_colour: COLOUR_PNG,
                gloss,
                light,
            };
            usd::stage(asset, &files)
        });
    }

    /// The whole light in a program's own orientation: the common map where that is the same, else one of this name.
    fn own_light(&mut self, own: MapLayout, name: &'static str) -> &'static str {
        let name = if own == self.layout { LIGHT } else { name };
        self.map(name, own, Part::Whole);
        name
    }

    /// The same without near lamps, which are lamps in that program's scene.
    fn distant_light(&mut self, own: MapLayout, name: &'static str) -> &'static str {
        if self.asset.lighting.radius.is_none() {
            return self.own_light(own, name);
        }
        self.map(name, own, Part::Rest);
        name
    }
}

fn files<'a>(asset: &'a Asset, job: &Job) -> Vec<File<'a>> {
    let mut files = Files {
        asset,
        layout: job.layout,
        list: Vec::new(),
    };
    for form in &job.forms {
        match form {
            Form::Light => files.light(),
            // A file without frames is none that programs read.
            Form::Cameras if asset.cameras.is_empty() => {}
            Form::Cameras => files.json("cameras.json", || transforms(&asset.cameras, DVec3::ZERO)),
            Form::Blender => files.blender(),
            Form::Mitsuba => files.mitsuba(),
            Form::Gltf => files.add("object.glb", |path| {
                let mut gloss = Vec::new();
                if asset.gloss.is_some() {
                    gloss.push(textures::gltf_gloss_png(asset)?);
                }
                if asset.is_coloured() {
                    gloss.push(textures::specular_colour_png(asset)?);
                }
                let colours = textures::base_colour_png(asset)?;
                fs::write(path, glb::glb(asset, &colours, &gloss))
            }),
            Form::Usd => files.usd(),
            Form::Obj => files.mesh(),
            Form::Layers | Form::Web => {}
        }
    }
    if job.per_lamp {
        files.lamps();
    }
    if job.calibration {
        let layout = job.layout;
        files.add("calibration.exr", move |path| {
            textures::write_exr(path, &layout.calibration())
        });
    }
    files.list
}
