//! `rekindle align`: where the mesh of a capture belongs.

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use glam::DVec3;
use serde_json::{Value, json};

use super::interrupt::{self, Interrupted};
use super::progress::Progress;
use super::{OutputArgs, print_json, print_line};
use crate::align::{AlignError, Alignment, Similarity, align};
use crate::capture::Capture;
use crate::solution::{Staging, write_plain_obj};

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
    /// Begin with the mesh as it lies, whatever the overlap
    #[arg(long, conflicts_with = "pairs")]
    from_here: bool,
    /// Write the mesh, moved, to this OBJ file in place of the transform into transforms.json
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Find the transform but write nothing
    #[arg(long, conflicts_with = "output")]
    dry_run: bool,
}

pub(super) fn run(args: &AlignArgs, output: OutputArgs) -> anyhow::Result<()> {
    let manifest = manifest(&args.capture);
    if manifest.is_none() && args.output.is_none() && !args.dry_run {
        bail!(
            "{}: there is no transforms.json to write the transform into; name a file for the moved mesh by -o",
            args.capture.display()
        );
    }
    let mut progress = Progress::new(output);
    progress.stage("reading the capture", 0.0);
    let capture = Capture::load_unplaced(&args.capture)?;
    let start = match &args.pairs {
        Some(path) => Some(
            Similarity::from_pairs(&read_pairs(path)?)
                .with_context(|| path.display().to_string())?,
        ),
        None => args.from_here.then_some(Similarity::IDENTITY),
    };
    let found = align(&capture.views, &capture.mesh, start, &mut |part| {
        progress.stage("aligning silhouettes", part);
        if interrupt::asked() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    let alignment = match found {
        Err(AlignError::Stopped) => return Err(Interrupted.into()),
        other => other.with_context(|| args.capture.display().to_string())?,
    };
    interrupt::check()?;
    if alignment.mean_overlap() < DOUBTFUL {
        progress.warn(&format!(
            "silhouettes overlap by only {:.1} %: start it from three pairs of points (--pairs), and check masks and lenses",
            100.0 * alignment.mean_overlap()
        ));
    }
    if alignment.ambiguous {
        progress.warn(
            "another rotation fits as well: the object is symmetric in silhouette; check it against the photographs, or give pairs of points (--pairs)",
        );
    }
    match (&args.output, manifest) {
        _ if args.dry_run => {}
        (Some(path), _) => write_mesh(path, &capture, &alignment)?,
        (None, Some(path)) => write_transform(&path, &alignment)?,
        (None, None) => {}
    }
    progress.finish();
    report(&capture, &alignment, output);
    Ok(())
}

/// The capture's own manifest, into which the transform can be written.
fn manifest(capture: &Path) -> Option<PathBuf> {
    let named = ["transforms.json", "transforms_train.json"].map(|name| capture.join(name));
    let own = capture
        .extension()
        .is_some_and(|e| e == "json")
        .then(|| capture.to_owned());
    own.into_iter().chain(named).find(|path| path.is_file())
}

/// Lines of six numbers.
fn read_pairs(path: &Path) -> anyhow::Result<Vec<[DVec3; 2]>> {
    let text = fs::read_to_string(path)
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
            Some(&[x, y, z, u, v, w]) => pairs.push([DVec3::new(x, y, z), DVec3::new(u, v, w)]),
            _ => bail!(
                "{}: line {} is not six numbers; write x,y,z of the mesh and X,Y,Z where it belongs",
                path.display(),
                i + 1
            ),
        }
    }
    Ok(pairs)
}

/// Writes the transform, after the one that is stated already, into a manifest; the file appears whole or not at all.
fn write_transform(path: &Path, alignment: &Alignment) -> anyhow::Result<()> {
    let problem = || format!("{}: can't be written; choose -o FILE", path.display());
    let bytes = fs::read(path).with_context(problem)?;
    let mut manifest: Value = serde_json::from_slice(&bytes).with_context(problem)?;
    let before = manifest.get("mesh_transform").and_then(matrix);
    let matrix = alignment.transform.matrix() * before.unwrap_or(glam::DMat4::IDENTITY);
    manifest["mesh_transform"] = json!(matrix.transpose().to_cols_array_2d());
    let text = serde_json::to_vec_pretty(&manifest).with_context(problem)?;
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let staging = Staging::within(folder).with_context(problem)?;
    let name = path.file_name().unwrap_or_default();
    fs::write(staging.path().join(name), text).with_context(problem)?;
    staging.add().with_context(problem)
}

/// A matrix as rows.
fn matrix(value: &Value) -> Option<glam::DMat4> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).ok()?;
    let mut matrix = glam::DMat4::IDENTITY;
    for (i, row) in rows.iter().enumerate().take(4) {
        for (j, &v) in row.iter().enumerate().take(4) {
            matrix.col_mut(j)[i] = v;
        }
    }
    Some(matrix)
}

fn write_mesh(path: &Path, capture: &Capture, alignment: &Alignment) -> anyhow::Result<()> {
    let problem = || format!("{}: can't be written; choose another file", path.display());
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let Some(name) = path.file_name() else {
        bail!(
            "{}: is not a file's name; choose one that ends in .obj",
            path.display()
        );
    };
    let staging = Staging::within(folder).with_context(problem)?;
    let moved = alignment.transform.moved(&capture.mesh);
    write_plain_obj(&staging.path().join(name), &moved).with_context(problem)?;
    staging.add().with_context(problem)
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
            "mesh_transform": transform.matrix().transpose().to_cols_array_2d(),
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
        let t = transform.translation;
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
