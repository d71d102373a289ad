//! `rekindle align`: where the mesh of a capture belongs.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use glam::{DMat4, DVec3};
use serde_json::{Value, json};

use super::interrupt::{self, Interrupted};
use super::progress::Progress;
use super::render::check_output;
use super::{OutputArgs, print_json, print_line};
use rekindle_base::files;
use rekindle_base::staging::{cannot_write, check_added};
use rekindle_capture::{Capture, input_files};
use rekindle_estimate::align::{AlignError, Alignment, Similarity, Start, align, read_points};
use rekindle_solution::{manifest_of, write_mesh_transform, write_placed_mesh};

/// Overlap below which the result is not to be trusted.
const DOUBTFUL: f64 = 0.9;

/// Arguments of `rekindle align`.
#[derive(clap::Args)]
pub(super) struct AlignArgs {
    /// Folder of a capture
    capture: PathBuf,
    /// Pairs of points to begin with, three lines or more of x,y,z,X,Y,Z: a point of the mesh and where it belongs
    #[arg(long, value_name = "FILE")]
    pairs: Option<PathBuf>,
    /// Points of the mesh and where photographs show them, to begin with
    ///
    /// A JSON list such as [{"mesh": [0.1, 0.2, 0.3], "marks": {"images/view_000.exr": [412.5, 300]}}, …]: coordinates of the
    /// mesh as the capture has it, names of photographs as the cameras' file has them, pixels from the upper left corner. Three
    /// points that are not on one line and four marks in two photographs are the least; each point marked in two photographs
    /// is better. Photographs without alpha or masks are aligned by these alone.
    #[arg(long, value_name = "FILE", conflicts_with = "pairs")]
    points: Option<PathBuf>,
    /// Begin with the mesh as it lies, whatever the overlap
    #[arg(long, conflicts_with_all = ["pairs", "points"])]
    from_here: bool,
    /// Write the mesh, moved, to this OBJ file in place of the transform into transforms.json
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Find the transform but write nothing
    #[arg(long, conflicts_with = "output")]
    dry_run: bool,
}

pub(super) fn run(args: &AlignArgs, output: OutputArgs) -> anyhow::Result<()> {
    let manifest = manifest_of(&args.capture);
    if manifest.is_none() && args.output.is_none() && !args.dry_run {
        bail!(
            "{}: there is no transforms.json to write the transform into; name a file for the moved mesh by -o",
            args.capture.display()
        );
    }
    let settled = check_written(args, manifest.as_deref())?;
    let mut progress = Progress::new(output);
    progress.warn_all(&settled);
    progress.stage("reading the capture", 0.0);
    let (capture, _) = Capture::load_unplaced(&args.capture)?;
    let points = match &args.points {
        Some(path) => read_points(path, &capture)?,
        None => Vec::new(),
    };
    let start = match &args.pairs {
        Some(path) => Start::At(
            Similarity::from_pairs(&read_pairs(path, capture.mesh.origin)?)
                .with_context(|| path.display().to_string())?,
        ),
        None if args.points.is_some() => Start::Marks(&points),
        None if args.from_here => Start::At(Similarity::IDENTITY),
        None => Start::Anywhere,
    };
    let found = align(
        &capture.views,
        &capture.mesh,
        start,
        &mut |part| progress.stage("aligning silhouettes", part),
        &interrupt::asked,
    );
    let alignment = match found {
        Err(AlignError::Stopped) => return Err(Interrupted.into()),
        Err(error @ AlignError::Marks(_)) => {
            let file = args.points.as_ref().unwrap_or(&args.capture);
            return Err(error).with_context(|| file.display().to_string());
        }
        other => other.with_context(|| args.capture.display().to_string())?,
    };
    interrupt::check()?;
    if let Some(overlap) = alignment.mean_overlap().filter(|o| *o < DOUBTFUL) {
        progress.warn(&format!(
            "silhouettes overlap by only {:.1} %: start it from points (--points or --pairs), and check masks and lenses",
            100.0 * overlap
        ));
    }
    if alignment.ambiguous {
        progress.warn(
            "another rotation fits as well: the object is symmetric in silhouette; check it against the photographs, or give points (--points or --pairs)",
        );
    }
    match (&args.output, manifest) {
        _ if args.dry_run => {}
        (Some(path), _) => {
            write_placed_mesh(path, &alignment.transform.moved(&capture.mesh))
                .map_err(cannot_write(path))?;
        }
        (None, Some(path)) => {
            write_mesh_transform(&path, &in_world(&capture, &alignment))
                .map_err(cannot_write(&path))?;
        }
        (None, None) => {}
    }
    progress.finish();
    report(&capture, &alignment, output);
    Ok(())
}

/// Fails where the result can't be written or would replace a file that is read, so that this is known before any work is
/// done. Returns what runs that were killed had left there and what became of it, in whole sentences.
fn check_written(args: &AlignArgs, manifest: Option<&Path>) -> anyhow::Result<Vec<String>> {
    let Some(file) = args.output.as_deref().or(manifest) else {
        return Ok(Vec::new());
    };
    if args.dry_run {
        return Ok(Vec::new());
    }
    let (Some(folder), Some(name)) = (file.parent(), file.file_name()) else {
        bail!("{}: is not a file's name; name a file", file.display());
    };
    if args.output.is_some() {
        let mut inputs = input_files(&args.capture)?;
        inputs.extend(args.pairs.iter().chain(&args.points).cloned());
        let name = name.to_string_lossy();
        check_added(folder, [name.as_ref()], &inputs)?;
    }
    check_output(if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    })
}

/// The transform as the world has it.
fn in_world(capture: &Capture, alignment: &Alignment) -> DMat4 {
    let matrix = alignment.transform.matrix();
    capture.mesh.world_transform(&matrix)
}

/// Lines of six numbers, as points about `origin`.
fn read_pairs(path: &Path, origin: DVec3) -> anyhow::Result<Vec<[DVec3; 2]>> {
    let text = files::read_text(path)
        .with_context(|| format!("{}: can't be read; check that it is a file", path.display()))?;
    let mut pairs = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let numbers: Option<Vec<f64>> = line
            .split([',', ';', ' ', '\t'])
            .filter(|word| !word.is_empty())
            .map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()))
            .collect();
        match numbers.as_deref() {
            Some(&[x, y, z, u, v, w]) => {
                pairs.push([DVec3::new(x, y, z), DVec3::new(u, v, w)].map(|point| point - origin));
            }
            _ => bail!(
                "{}: line {} is not six numbers; write x,y,z of the mesh and X,Y,Z where it belongs",
                path.display(),
                i + 1
            ),
        }
    }
    Ok(pairs)
}

fn report(capture: &Capture, alignment: &Alignment, output: OutputArgs) {
    let transform = alignment.transform;
    if output.json {
        let views: Vec<Value> = capture
            .views
            .iter()
            .zip(&alignment.overlap)
            .map(|(view, overlap)| json!({ "name": view.name, "overlap": overlap }))
            .collect();
        print_json(&json!({
            "mesh_transform": in_world(capture, alignment).transpose().to_cols_array_2d(),
            "scale": transform.scale,
            "overlap": alignment.mean_overlap(),
            "ambiguous": alignment.ambiguous,
            "views": views,
        }));
    } else if !output.quiet {
        for (view, overlap) in capture.views.iter().zip(&alignment.overlap) {
            let text = overlap.map_or("-".to_owned(), |o| format!("{:.2} %", 100.0 * o));
            print_line(&format!("{}  overlap {text}", view.name));
        }
        let (axis, angle) = transform.rotation.to_axis_angle();
        let t = in_world(capture, alignment).w_axis;
        print_line(&format!(
            "scale {:.6}, turned by {:.3}° about [{:.4}, {:.4}, {:.4}], shifted by [{:.6}, {:.6}, {:.6}]",
            transform.scale,
            angle.to_degrees(),
            axis.x,
            axis.y,
            axis.z,
            t.x,
            t.y,
            t.z
        ));
    }
}
