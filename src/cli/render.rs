//! `rekindle render`: pictures of a solution from given cameras, under edited light.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use glam::Vec3;

use super::interrupt;
use super::progress::Progress;
use super::{OutputArgs, print_json, print_line};
use crate::capture::{Camera, read_cameras};
use crate::relight::{self, Diffuse, Edit, Interreflection, Picture, Scene, Shader, Surroundings};
use crate::solution::{Solution, Staging, solution_folder, write_rgb, write_rgba};
use crate::surface::Occluder;

/// Arguments of `rekindle render`.
#[derive(clap::Args)]
pub(super) struct RenderArgs {
    /// Folder of a solution
    solution: PathBuf,
    /// File with the cameras, like a capture's transforms.json; one picture per frame
    #[arg(long, value_name = "FILE")]
    cameras: PathBuf,
    /// Folder for the pictures
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// File with edits of the lighting
    #[arg(long, value_name = "FILE")]
    edits: Option<PathBuf>,
    /// Write the diffuse and the specular part as well
    #[arg(long)]
    layers: bool,
}

/// A picture to be made.
pub(super) struct Shot {
    /// File name without extension.
    pub(super) stem: String,
    /// Where it is taken from.
    pub(super) camera: Camera,
}

pub(super) fn run(args: &RenderArgs, output: OutputArgs) -> anyhow::Result<()> {
    check_output(&args.output)?;
    let mut progress = Progress::new(output);
    progress.stage("reading the solution", 0.0);
    let solution = Solution::load(solution_folder(&args.solution))?;
    let shots = shots(&args.cameras)?;
    let edits = match &args.edits {
        Some(path) => relight::load(path)?,
        None => Vec::new(),
    };
    let renderer = Renderer::new(&solution);
    let staging = Staging::beside(&args.output).with_context(|| cannot_write(&args.output))?;
    let files = renderer.shoot(&shots, &edits, args.layers, &staging, &mut progress)?;
    staging.add().with_context(|| cannot_write(&args.output))?;
    progress.finish();
    if output.json {
        let pictures: Vec<_> = files.iter().map(|f| args.output.join(f)).collect();
        print_json(&serde_json::json!({ "pictures": pictures }));
    } else if !output.quiet {
        let plural = if shots.len() == 1 { "" } else { "s" };
        print_line(&format!(
            "{}: {} view{plural}, EXR and PNG",
            args.output.display(),
            shots.len()
        ));
    }
    Ok(())
}

/// Fails where no pictures can be written, so that this is known before any work is done.
fn check_output(folder: &Path) -> anyhow::Result<()> {
    if folder.exists() && !folder.is_dir() {
        bail!("{}: is not a folder; choose another", folder.display());
    }
    let staging = Staging::beside(folder).with_context(|| cannot_write(folder))?;
    drop(staging);
    Ok(())
}

/// What to say where pictures can't be written.
pub(super) fn cannot_write(folder: &Path) -> String {
    format!(
        "{}: can't be written; choose an output folder you may write to, on a disk with space left",
        folder.display()
    )
}

/// One shot per frame of a cameras file, named by the stem of its file path.
pub(super) fn shots(cameras: &Path) -> anyhow::Result<Vec<Shot>> {
    let mut shots: Vec<Shot> = Vec::new();
    for (name, camera) in read_cameras(cameras)? {
        let Some(stem) = Path::new(&name).file_stem() else {
            bail!(
                "{}: file_path \"{name}\" has no file name to call the picture by; give it one",
                cameras.display()
            );
        };
        let stem = stem.to_string_lossy().into_owned();
        if shots.iter().any(|s| s.stem == stem) {
            bail!(
                "{}: two frames would both be written to {stem}.exr; give their file_path different names",
                cameras.display()
            );
        }
        shots.push(Shot { stem, camera });
    }
    Ok(shots)
}

/// A solution ready to be rendered.
pub(super) struct Renderer<'a> {
    solution: &'a Solution,
    occluder: Occluder,
    interreflection: Option<Interreflection>,
    /// Radiance that becomes white in tone-mapped pictures.
    white: f32,
}

impl<'a> Renderer<'a> {
    pub(super) fn new(solution: &'a Solution) -> Self {
        let occluder = Occluder::new(&solution.mesh);
        let interreflection = Interreflection::new(&solution.mesh, &occluder, solution.brdf);
        Self {
            solution,
            occluder,
            interreflection,
            white: solution.white(),
        }
    }

    /// Renders all shots into the folder of a staging. Returns the files' names.
    pub(super) fn shoot(
        &self,
        shots: &[Shot],
        edits: &[Edit],
        layers: bool,
        staging: &Staging,
        progress: &mut Progress,
    ) -> anyhow::Result<Vec<String>> {
        let solution = self.solution;
        let original = solution.lighting();
        let lighting = relight::apply(edits, &original)?;
        let shader = Shader::new(&self.occluder, solution.brdf, &lighting);
        let unchanged = lighting == original;
        let (atlas, texture) = if unchanged {
            (&solution.atlas, &solution.diffuse)
        } else {
            (&solution.atlas, &solution.albedo)
        };
        let relit = self
            .interreflection
            .as_ref()
            .filter(|_| !unchanged)
            .map(|i| i.of_light(&solution.mesh, &shader, atlas, texture));
        let scene = Scene {
            mesh: &solution.mesh,
            occluder: &self.occluder,
            brdf: solution.brdf,
            surroundings: self
                .interreflection
                .as_ref()
                .map(|interreflection| Surroundings {
                    interreflection,
                    atlas,
                    texture,
                    relit: relit.as_ref(),
                }),
        };
        let diffuse = if unchanged {
            Diffuse::Stored(atlas, texture)
        } else {
            Diffuse::Relit(atlas, texture)
        };
        let mut files = Vec::new();
        for (i, shot) in shots.iter().enumerate() {
            interrupt::check()?;
            progress.stage(
                &format!("rendering {}", shot.stem),
                i as f32 / shots.len() as f32,
            );
            let picture = relight::render(&scene, &shot.camera, &shader, diffuse);
            self.write(&picture, &shot.stem, layers, staging.path(), &mut files)
                .with_context(|| cannot_write(staging.target()))?;
        }
        Ok(files)
    }

    fn write(
        &self,
        picture: &Picture,
        stem: &str,
        layers: bool,
        folder: &Path,
        files: &mut Vec<String>,
    ) -> io::Result<()> {
        let width = picture.width;
        let mut add = |suffix: &str| {
            let name = format!("{stem}{suffix}");
            let path = folder.join(&name);
            files.push(name);
            path
        };
        let sum: Vec<[f32; 3]> = picture
            .diffuse
            .iter()
            .zip(&picture.specular)
            .map(|(&d, &s)| (Vec3::from(d) + Vec3::from(s)).to_array())
            .collect();
        write_rgba(&add(".exr"), width, &sum, &picture.coverage)?;
        write_png(&add(".png"), width, &sum, &picture.coverage, self.white)?;
        if layers {
            write_rgba(
                &add(".diffuse.exr"),
                width,
                &picture.diffuse,
                &picture.coverage,
            )?;
            write_rgb(&add(".specular.exr"), width, &picture.specular)?;
        }
        Ok(())
    }
}

/// Writes a tone-mapped picture: sRGB, 8 bits, straight alpha.
fn write_png(
    path: &Path,
    width: u32,
    rgb: &[[f32; 3]],
    coverage: &[f32],
    white: f32,
) -> io::Result<()> {
    /// Above this part of white, values are compressed instead of cut.
    const SHOULDER: f32 = 0.75;
    let tone = |v: f32| {
        if v <= SHOULDER {
            v.max(0.0)
        } else {
            1.0 - (1.0 - SHOULDER) * (-(v - SHOULDER) / (1.0 - SHOULDER)).exp()
        }
    };
    let mut bytes = Vec::with_capacity(4 * rgb.len());
    for (&pixel, &alpha) in rgb.iter().zip(coverage) {
        let straight = Vec3::from(pixel) / (alpha.max(1e-6) * white);
        let encoded = relight::srgb(Vec3::new(
            tone(straight.x),
            tone(straight.y),
            tone(straight.z),
        ));
        bytes.extend(encoded.to_array().map(|v| (v * 255.0 + 0.5) as u8));
        bytes.push((alpha * 255.0 + 0.5) as u8);
    }
    let height = rgb.len() as u32 / width.max(1);
    let mut encoded = Vec::new();
    image::write_buffer_with_format(
        &mut io::Cursor::new(&mut encoded),
        &bytes,
        width,
        height,
        image::ColorType::Rgba8,
        image::ImageFormat::Png,
    )
    .map_err(io::Error::other)?;
    fs::write(path, encoded)
}
