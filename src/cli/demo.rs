//! `rekindle` without a command: solves the built-in capture and relights it.

use std::fs;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context as _, bail};
use glam::Vec3;

use super::progress::Progress;
use super::render::{Renderer, Shot, cannot_write};
use super::solve::{EstimationArgs, describe, solve_capture};
use super::{OutputArgs, print_json, print_line};
use crate::capture::{Camera, Capture, DEMO, unpack_demo};
use crate::relight::Edit;
use crate::solution::{Solution, SolutionError, Staging};

/// Where the demo is written, in the current folder.
const FOLDER: &str = "rekindle-demo";

/// How far the moved lamp is turned about the hemisphere's pole, radians.
const MOVE: f32 = 1.2;

pub(super) fn run(output: OutputArgs) -> anyhow::Result<()> {
    let folder = Path::new(FOLDER);
    if folder.exists() && !folder.join("solution/solution.json").is_file() {
        bail!(
            "{FOLDER}: exists and is not an earlier demo; remove it or run this in another folder"
        );
    }
    let mut progress = Progress::new(output);
    let staging = Staging::beside(folder).with_context(|| cannot_write(folder))?;
    let capture_folder = staging.path().join("capture");
    unpack_demo(&capture_folder).with_context(|| cannot_write(folder))?;
    let started = Instant::now();
    let mut capture = Capture::load(&capture_folder)?;
    DEMO.clone_into(&mut capture.name);
    let load_s = started.elapsed().as_secs_f64();
    let solution = solve_capture(&capture, load_s, &EstimationArgs::default(), &mut progress)?;
    let saved = solution.save(&staging.path().join("solution"));
    saved.map_err(|error| match error {
        SolutionError::Write { source, .. } => SolutionError::Write {
            path: folder.to_owned(),
            source,
        },
        other => other,
    })?;
    let pictures = take_pictures(&solution, &capture.views[0].camera, &staging, &mut progress)?;
    staging.replace().with_context(|| cannot_write(folder))?;
    progress.finish();
    if output.json {
        let paths: Vec<_> = pictures.iter().map(|(file, _)| folder.join(file)).collect();
        print_json(&serde_json::json!({
            "solution": folder.join("solution"),
            "pictures": paths,
        }));
    } else if !output.quiet {
        print_line(&format!(
            "Solved {FOLDER}/capture into {FOLDER}/solution: {}",
            describe(&solution)
        ));
        for (file, what) in &pictures {
            print_line(&format!("{FOLDER}/{file}  {what}"));
        }
        print_line(&format!(
            "Your own: rekindle solve CAPTURE -o SOLUTION; other light: rekindle render {FOLDER}/solution \
             --cameras {FOLDER}/capture/transforms.json --edits EDITS -o DIR"
        ));
    }
    Ok(())
}

/// Renders the demo's pictures; returns file and description of each.
fn take_pictures(
    solution: &Solution,
    camera: &Camera,
    staging: &Staging,
    progress: &mut Progress,
) -> anyhow::Result<Vec<(String, String)>> {
    let mut wishes = vec![(
        "original".to_owned(),
        "the light of the capture".to_owned(),
        Vec::new(),
    )];
    for (i, lamp) in solution.lamps.iter().enumerate() {
        wishes.push((
            format!("light_{}_alone", i + 1),
            format!("{} alone", lamp.name),
            vec![
                Edit::Solo {
                    near: lamp.direction,
                },
                Edit::Ambient { gain: 0.0 },
            ],
        ));
    }
    if let Some(lamp) = solution.lamps.first() {
        let up = solution.grid.up;
        let turned = glam::Quat::from_axis_angle(up, MOVE) * lamp.direction;
        wishes.push((
            "light_1_moved".to_owned(),
            format!(
                "{} moved by {:.0}° about the pole",
                lamp.name,
                MOVE.to_degrees()
            ),
            vec![Edit::Move {
                near: lamp.direction,
                to: turned.try_normalize().unwrap_or(Vec3::Y),
            }],
        ));
    }
    fs::create_dir(staging.path().join("pictures"))
        .with_context(|| cannot_write(staging.target()))?;
    let renderer = Renderer::new(solution);
    let mut made = Vec::new();
    for (stem, what, edits) in wishes {
        let shot = Shot {
            stem: format!("pictures/{stem}"),
            camera: camera.clone(),
        };
        renderer.shoot(&[shot], &edits, false, staging, progress)?;
        made.push((format!("pictures/{stem}.png"), what));
    }
    Ok(made)
}
