//! `rekindle render`: pictures of a solution from given cameras, under edited light.

use std::io;
use std::path::{Path, PathBuf};

use anyhow::bail;
use glam::{DVec3, Vec3};

use super::interrupt;
use super::progress::Progress;
use super::{OutputArgs, json_path, print_json, print_line};
use rekindle_base::staging::{Staging, cannot_write, check_added};
use rekindle_capture::{Camera, input_files, read_cameras};
use rekindle_output::export::{self, Depth, PngFile, Shown};
use rekindle_relight::{self as relight, Edit, Picture};
use rekindle_solution::{Solution, own_files, solution_folder, write_rgb, write_rgba};

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
    check_apart(&args.output, &args.solution)?;
    let settled = check_output(&args.output)?;
    let mut progress = Progress::new(output);
    progress.warn_all(&settled);
    progress.stage("reading the solution", 0.0);
    let solution = Solution::load(solution_folder(&args.solution))?;
    let shots = shots(&args.cameras, solution.mesh.origin)?;
    check_inputs(args, &shots)?;
    let edits = match &args.edits {
        Some(path) => relight::load(path)?,
        None => Vec::new(),
    };
    let renderer = Renderer::new(&solution);
    let staging = Staging::within(&args.output).map_err(cannot_write(&args.output))?;
    let files = renderer.shoot(&shots, &edits, args.layers, &staging, &mut progress)?;
    staging.add()?;
    progress.finish();
    if output.json {
        let pictures: Vec<_> = files
            .iter()
            .map(|f| json_path(&args.output.join(f)))
            .collect();
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

/// Fails where no files can be added, so that this is known before any work is done. Returns what runs that were killed had
/// left there and what became of it, in whole sentences.
pub(super) fn check_output(folder: &Path) -> anyhow::Result<Vec<String>> {
    if folder.exists() && !folder.is_dir() {
        bail!("{}: is not a folder; choose another", folder.display());
    }
    let staging = Staging::within(folder).map_err(cannot_write(folder))?;
    Ok(staging.settled().to_vec())
}

/// Fails where the output folder is the solution's own.
pub(super) fn check_apart(output: &Path, solution: &Path) -> anyhow::Result<()> {
    let real = |path: &Path| path.canonicalize().ok();
    if real(output).is_some() && real(output) == real(solution_folder(solution)) {
        bail!(
            "{}: is the solution itself, whose files would be mixed with others; choose another output folder",
            output.display()
        );
    }
    Ok(())
}

/// Fails where pictures would be written over photographs or files of the solution.
fn check_inputs(args: &RenderArgs, shots: &[Shot]) -> anyhow::Result<()> {
    let solution = solution_folder(&args.solution);
    let own = own_files(solution).unwrap_or_default();
    let mut inputs = input_files(&args.cameras)?;
    inputs.extend(own.listed().iter().map(|name| solution.join(name)));
    let endings = [".exr", ".png", ".diffuse.exr", ".specular.exr"];
    let endings = &endings[..if args.layers { 4 } else { 2 }];
    let names: Vec<String> = shots
        .iter()
        .flat_map(|shot| endings.iter().map(|end| format!("{}{end}", shot.stem)))
        .collect();
    let names = names.iter().map(String::as_str);
    Ok(check_added(&args.output, names, &inputs)?)
}

/// One shot per frame of a cameras file, named by the stem of its file path, of what lies about `origin`.
pub(super) fn shots(cameras: &Path, origin: DVec3) -> anyhow::Result<Vec<Shot>> {
    let mut shots: Vec<Shot> = Vec::new();
    for (name, camera) in read_cameras(cameras, origin)? {
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
    renderer: export::Renderer<'a>,
    /// Radiance that becomes white in tone-mapped pictures.
    white: f32,
}

impl<'a> Renderer<'a> {
    pub(super) fn new(solution: &'a Solution) -> Self {
        Self {
            renderer: export::Renderer::new(solution),
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
        let lighting = relight::apply(edits, self.renderer.original())?;
        let photographer = export::Photographer::new(&self.renderer, &lighting);
        let mut files = Vec::new();
        for (i, shot) in shots.iter().enumerate() {
            interrupt::check()?;
            progress.stage(
                &format!("rendering {}", shot.stem),
                i as f32 / shots.len() as f32,
            );
            let picture = photographer.picture(&shot.camera);
            self.write(&picture, &shot.stem, layers, staging.path(), &mut files)
                .map_err(cannot_write(staging.target()))?;
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
        let display = |radiance: Vec3| tone_mapped(radiance / self.white);
        let shown = Shown {
            display: &display,
            background: None,
        };
        let size = [width, picture.height];
        let mut png = PngFile::create(&add(".png"), size, Depth::Eight, shown)?;
        png.rows(&sum, &picture.coverage, &interrupt::asked)?;
        png.finish()?;
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

/// Display values, encoded for an sRGB screen, of radiance of which 1 is white.
fn tone_mapped(radiance: Vec3) -> Vec3 {
    /// Above this part of white, values are compressed instead of cut.
    const SHOULDER: f32 = 0.75;
    let tone = |v: f32| {
        if v <= SHOULDER {
            v.max(0.0)
        } else {
            1.0 - (1.0 - SHOULDER) * (-(v - SHOULDER) / (1.0 - SHOULDER)).exp()
        }
    };
    relight::srgb(Vec3::from(radiance.to_array().map(tone)))
}
