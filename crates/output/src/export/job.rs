//! A list of pictures to be made, and the making of them.

use std::io;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use serde_json::Value;
use thiserror::Error;

use super::exr_bands::{self, Sink};
use super::layers::Layers;
use super::png_file::{Animation, Depth, PngFile, Shown};
use super::renderer::{LitScene, Renderer};
use rekindle_base::staging::{DestinationError, Staging, write_advice};
use rekindle_capture::Camera;
use rekindle_relight::ViewTransform;
use rekindle_relight::{Band, Lighting, Stop};
use rekindle_solution::Solution;

/// Pictures are at most this many pixels wide and high.
pub const MAX_SIDE: u32 = 8192;
/// Animations, of which a whole frame is held, at most this many.
pub const MAX_ANIMATION_SIDE: u32 = 4096;

/// One picture.
#[derive(Clone, Debug)]
pub struct Shot {
    /// File name without extension.
    pub stem: String,
    /// Where it is taken from, and its size.
    pub camera: Camera,
    /// Its light.
    pub lighting: Arc<Lighting>,
}

/// What to write.
#[derive(Clone, Debug)]
pub struct Job {
    /// At least one. Those of one light should follow each other.
    pub shots: Vec<Shot>,
    /// Write PNG files of this depth.
    pub png: Option<Depth>,
    /// Write EXR files: linear radiance, premultiplied by alpha.
    pub exr: bool,
    /// Put layers beside the picture in EXR files: diffuse, specular, albedo, irradiance, normal, position and depth.
    pub layers: bool,
    /// Put a layer for each lamp, and one for all other light, into EXR files; they add up to the picture.
    pub light_groups: bool,
    /// Write all shots, which must be of one size, as an animated PNG of this name (without extension) and speed in frames
    /// per second.
    pub animation: Option<(String, u16)>,
    /// How PNG files show radiance.
    pub transform: ViewTransform,
    /// Factor of radiance before the view transform.
    pub exposure: f32,
    /// Display values behind the object in PNG files; `None` leaves them transparent.
    pub background: Option<[f32; 3]>,
    /// Write edits that give the same light on the command line as a JSON file of this name (without extension).
    pub edits: Option<(String, Vec<Value>)>,
    /// Folder for the files; others in it stay.
    pub folder: PathBuf,
}

/// Why pictures could not be made.
#[derive(Debug, Error)]
pub enum ExportError {
    /// It was asked for.
    #[error("the export was stopped; {kept} files of finished pictures were kept")]
    Stopped {
        /// How many files were complete by then, which were kept.
        kept: usize,
    },
    /// A size that can't be made.
    #[error("{width}×{height} pixels can't be exported; each side must be 1 to {limit}")]
    Size {
        /// Asked for.
        width: u32,
        /// Asked for.
        height: u32,
        /// The most.
        limit: u32,
    },
    /// Frames of an animation of different sizes.
    #[error(
        "the frames of an animation must all be of one size; export cameras of several sizes as single pictures"
    )]
    Sizes,
    /// Nothing to do.
    #[error("nothing to export; choose at least one file type and one camera")]
    Nothing,
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

impl Job {
    /// The same under names that are not `taken`: a number is added to all where one is.
    #[must_use]
    pub fn beside_others(self, taken: impl Fn(&Path) -> bool) -> Self {
        let is_free = |job: &Self| !job.files().any(|file| taken(&file));
        if is_free(&self) {
            return self;
        }
        let mut numbers = 2..;
        let free = numbers.find_map(|number| {
            let renamed = self.renamed(number);
            is_free(&renamed).then_some(renamed)
        });
        free.unwrap_or(self)
    }

    /// How many of its files have names that are `taken`.
    pub fn there_already(&self, taken: impl Fn(&Path) -> bool) -> usize {
        self.files().filter(|file| taken(file)).count()
    }

    /// Bytes that its files have at most, whatever the pictures show.
    pub fn most_bytes(&self) -> u64 {
        /// Bytes of a channel of an EXR file.
        const FLOAT: u64 = 4;
        /// Channels of the picture, of the layers beside it, and of a light group.
        const PICTURE: u64 = 4;
        const LAYERS: u64 = 19;
        const GROUP: u64 = 3;
        let shown = 3 + u64::from(self.background.is_none());
        let depth = |depth| match depth {
            Depth::Eight => 1,
            Depth::Sixteen => 2,
        };
        let of = |shot: &Shot| {
            let pixels = u64::from(shot.camera.width) * u64::from(shot.camera.height);
            let layers = if self.layers { LAYERS } else { 0 };
            // A group for each lamp, and one for all other light.
            let groups = if self.light_groups {
                GROUP * (shot.lighting.lamps.iter().filter(|l| !l.muted).count() as u64 + 1)
            } else {
                0
            };
            let exr = u64::from(self.exr) * FLOAT * (PICTURE + layers + groups);
            let png = self.png.map_or(0, depth) * shown;
            let film = u64::from(self.animation.is_some()) * shown;
            pixels * (exr + png + film)
        };
        self.shots.iter().map(of).sum()
    }

    fn renamed(&self, number: u32) -> Self {
        let mut job = self.clone();
        let add = |name: &mut String| *name = format!("{name} {number}");
        job.shots.iter_mut().for_each(|shot| add(&mut shot.stem));
        job.animation.iter_mut().for_each(|(name, _)| add(name));
        job.edits.iter_mut().for_each(|(name, _)| add(name));
        job
    }

    /// The files that it writes.
    pub fn files(&self) -> impl Iterator<Item = PathBuf> {
        let pictures = self.shots.iter().flat_map(|shot| {
            let png = self.png.map(|_| format!("{}.png", shot.stem));
            let exr = self.exr.then(|| format!("{}.exr", shot.stem));
            png.into_iter().chain(exr)
        });
        let animation = self
            .animation
            .iter()
            .map(|(name, _)| format!("{name}.apng"));
        let edits = self.edits.iter().map(|(name, _)| format!("{name}.json"));
        let names = pictures.chain(animation).chain(edits);
        names.map(|name| self.folder.join(name))
    }

    fn check(&self) -> Result<(), ExportError> {
        if self.shots.is_empty() || !(self.exr || self.png.is_some() || self.animation.is_some()) {
            return Err(ExportError::Nothing);
        }
        let limit = if self.animation.is_some() {
            MAX_ANIMATION_SIDE
        } else {
            MAX_SIDE
        };
        let size = |shot: &Shot| (shot.camera.width, shot.camera.height);
        for (width, height) in self.shots.iter().map(size) {
            if !(1..=limit).contains(&width) || !(1..=limit).contains(&height) {
                return Err(ExportError::Size {
                    width,
                    height,
                    limit,
                });
            }
        }
        let first = self.shots.first().map(size);
        if self.animation.is_some() && self.shots.iter().any(|s| Some(size(s)) != first) {
            return Err(ExportError::Sizes);
        }
        Ok(())
    }
}

/// Makes all pictures of a job. `progress` hears which part of the whole is done, from 0 to 1, and what is being made;
/// `stop` is asked all the time, and pictures that are finished by then are kept. Returns the files.
pub fn export(
    renderer: &Renderer,
    job: &Job,
    stop: Stop,
    progress: &mut dyn FnMut(f32, &str),
) -> Result<Vec<PathBuf>, ExportError> {
    job.check()?;
    let failed = |source: io::Error| ExportError::Write {
        path: job.folder.clone(),
        source,
    };
    let staging = Staging::within(&job.folder).map_err(failed)?;
    let mut finished = Vec::new();
    match make(renderer, job, staging.path(), stop, progress, &mut finished) {
        Ok(files) => {
            staging.add()?;
            progress(1.0, "");
            Ok(files.iter().map(|name| job.folder.join(name)).collect())
        }
        Err(ExportError::Stopped { .. }) if !finished.is_empty() => {
            keep_only(staging.path(), &finished).map_err(failed)?;
            staging.add()?;
            Err(ExportError::Stopped {
                kept: finished.len(),
            })
        }
        Err(error) => Err(error),
    }
}

/// Removes all files of a folder but some.
fn keep_only(folder: &Path, names: &[String]) -> io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let is_kept = |name: &String| entry.file_name() == name.as_str();
        if !names.iter().any(is_kept) {
            std::fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Makes the pictures in `folder`. `finished` hears of each file that is whole.
fn make(
    renderer: &Renderer,
    job: &Job,
    folder: &Path,
    stop: Stop,
    progress: &mut dyn FnMut(f32, &str),
    finished: &mut Vec<String>,
) -> Result<Vec<String>, ExportError> {
    let failed = |source: io::Error| {
        if stop() {
            return ExportError::Stopped { kept: 0 };
        }
        ExportError::Write {
            path: job.folder.clone(),
            source,
        }
    };
    let display = |radiance: Vec3| job.transform.apply(radiance * job.exposure);
    let shown = Shown {
        display: &display,
        background: job.background.map(Vec3::from),
    };
    let mut writer = Writer {
        job,
        shown,
        folder,
        animation: None,
        files: Vec::new(),
    };
    let mut lit: Option<(&Lighting, LitScene, Layers)> = None;
    for (i, shot) in job.shots.iter().enumerate() {
        let done = |part: f32| (i as f32 + part) / job.shots.len() as f32;
        progress(done(0.0), &shot.stem);
        if stop() {
            return Err(ExportError::Stopped { kept: 0 });
        }
        let lighting = shot.lighting.as_ref();
        if lit.as_ref().is_none_or(|(before, ..)| *before != lighting) {
            let mut layers = Layers::new(job.layers);
            if job.exr && job.light_groups {
                layers = layers.with_groups(renderer, lighting, stop);
            }
            lit = Some((lighting, renderer.light(lighting), layers));
        }
        if let Some((_, lit, layers)) = &lit {
            let mut rows_done = |part: f32| progress(done(part), &shot.stem);
            writer
                .shoot(renderer.solution(), lit, layers, shot, stop, &mut rows_done)
                .map_err(failed)?;
            let film = job
                .animation
                .as_ref()
                .map(|(name, _)| format!("{name}.apng"));
            let whole = |name: &&String| Some(*name) != film.as_ref();
            *finished = writer.files.iter().filter(whole).cloned().collect();
        }
    }
    writer.edits().map_err(failed)?;
    let files = writer.finish().map_err(failed)?;
    if stop() {
        return Err(ExportError::Stopped { kept: 0 });
    }
    Ok(files)
}

/// Writes the files of a job into a folder.
struct Writer<'a> {
    job: &'a Job,
    shown: Shown<'a>,
    folder: &'a Path,
    animation: Option<Animation>,
    files: Vec<String>,
}

impl Writer<'_> {
    fn file(&mut self, name: String) -> PathBuf {
        let path = self.folder.join(&name);
        self.files.push(name);
        path
    }

    fn shoot(
        &mut self,
        solution: &Solution,
        lit: &LitScene,
        layers: &Layers,
        shot: &Shot,
        stop: Stop,
        progress: &mut dyn FnMut(f32),
    ) -> io::Result<()> {
        let camera = &shot.camera;
        let size = [camera.width, camera.height];
        let mut png = match self.job.png {
            Some(depth) => {
                let path = self.file(format!("{}.png", shot.stem));
                Some(PngFile::create(&path, size, depth, self.shown)?)
            }
            None => None,
        };
        let mut frame = self.job.animation.is_some().then(Vec::new);
        let shown = self.shown;
        let mut render = |mut exr: Option<&mut Sink>| {
            let mut problem = None;
            let all = lit.bands(camera, stop, &mut |band| {
                let rgb = sum(band);
                let mut write = || -> io::Result<()> {
                    if let Some(png) = &mut png {
                        png.rows(&rgb, &band.coverage, stop)?;
                    }
                    if let Some(frame) = &mut frame {
                        frame.extend(shown.encode(&rgb, &band.coverage, Depth::Eight));
                    }
                    if let Some(exr) = &mut exr {
                        let planes = layers.planes(solution, camera, band, &rgb, stop);
                        exr(&planes.ok_or_else(|| io::Error::other("stopped"))?)?;
                    }
                    Ok(())
                };
                match write() {
                    Ok(()) => {
                        progress(band.rows.end as f32 / camera.height as f32);
                        ControlFlow::Continue(())
                    }
                    Err(error) => {
                        problem = Some(error);
                        ControlFlow::Break(())
                    }
                }
            });
            match (problem, all) {
                (Some(error), _) => Err(error),
                (None, ControlFlow::Break(())) => Err(io::Error::other("stopped")),
                (None, ControlFlow::Continue(())) => Ok(()),
            }
        };
        if self.job.exr {
            let name = format!("{}.exr", shot.stem);
            let path = self.folder.join(&name);
            let channels = layers.names();
            exr_bands::write(&path, size, &channels, stop, |sink| render(Some(sink)))?;
            self.files.push(name);
        } else {
            render(None)?;
        }
        if let Some(png) = png {
            png.finish()?;
        }
        if let Some(frame) = frame {
            self.add_frame(size, &frame)?;
        }
        Ok(())
    }

    fn add_frame(&mut self, size: [u32; 2], frame: &[u8]) -> io::Result<()> {
        let Some((name, speed)) = &self.job.animation else {
            return Ok(());
        };
        let mut animation = if let Some(animation) = self.animation.take() {
            animation
        } else {
            let frames = self.job.shots.len() as u32;
            let path = self.folder.join(format!("{name}.apng"));
            self.files.push(format!("{name}.apng"));
            Animation::create(&path, size, frames, *speed, &self.shown)?
        };
        animation.frame(frame)?;
        self.animation = Some(animation);
        Ok(())
    }

    fn edits(&mut self) -> io::Result<()> {
        let Some((name, edits)) = &self.job.edits else {
            return Ok(());
        };
        let path = self.file(format!("{name}.json"));
        std::fs::write(path, serde_json::to_vec_pretty(edits)?)
    }

    fn finish(self) -> io::Result<Vec<String>> {
        if let Some(animation) = self.animation {
            animation.finish()?;
        }
        Ok(self.files)
    }
}

/// Diffuse and specular part together.
fn sum(band: &Band) -> Vec<[f32; 3]> {
    band.diffuse
        .iter()
        .zip(&band.specular)
        .map(|(&d, &s)| (Vec3::from(d) + Vec3::from(s)).to_array())
        .collect()
}
