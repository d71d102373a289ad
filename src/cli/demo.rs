//! `rekindle` without a command: solves the built-in capture and relights it.

use std::fs;
use std::path::Path;
use std::time::Instant;

use glam::Vec3;

use super::progress::Progress;
use super::render::{Renderer, Shot};
use super::solve::{EstimationArgs, describe, solve_capture};
use super::{OutputArgs, print_json, print_line};
use rekindle_base::staging::{DestinationError, Owned, Staging, cannot_write, check_owned};
use rekindle_capture::{Camera, Capture, DEMO, demo_names, unpack_demo};
use rekindle_relight::Edit;
use rekindle_solution::{Solution, SolutionError, own_files};

/// Where the demo is written, in the current folder.
const FOLDER: &str = "rekindle-demo";

/// Folders in it.
const CAPTURE: &str = "capture";
const SOLUTION: &str = "solution";
const PICTURES: &str = "pictures";
/// Name of the picture under the captured lighting, without extension.
const ORIGINAL: &str = "original";
/// Name of the picture with a lamp moved.
const MOVED: &str = "light_1_moved";

/// How far the moved lamp is turned about the hemisphere's pole, radians.
const MOVE: f32 = 1.2;

pub(super) fn run(output: OutputArgs) -> anyhow::Result<()> {
    let folder = Path::new(FOLDER);
    let staging = Staging::beside(folder).map_err(cannot_write(folder))?;
    check_replaceable(folder)?;
    let mut progress = Progress::new(output);
    progress.warn_all(staging.settled());
    let capture_folder = staging.path().join(CAPTURE);
    unpack_demo(&capture_folder).map_err(cannot_write(folder))?;
    let started = Instant::now();
    let mut capture = Capture::load(&capture_folder)?;
    DEMO.clone_into(&mut capture.name);
    let load_s = started.elapsed().as_secs_f64();
    let solution = solve_capture(
        &capture,
        load_s,
        &EstimationArgs::default(),
        None,
        &mut progress,
    )?;
    let saved = solution.save(&staging.path().join(SOLUTION));
    saved.map_err(|error| match error {
        SolutionError::Destination(DestinationError::Write { source, .. }) => {
            cannot_write(folder)(source).into()
        }
        other => other,
    })?;
    let pictures = take_pictures(&solution, &capture.views[0].camera, &staging, &mut progress)?;
    staging.replace(check_replaceable)?;
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

/// Name of the picture of a lamp alone.
fn alone(number: usize) -> String {
    format!("light_{number}_alone")
}

/// Refuses to replace anything but an earlier demo with nothing else in it.
fn check_replaceable(folder: &Path) -> Result<(), DestinationError> {
    check_owned(folder, demo_files(folder), "an earlier demo")
}

/// The files of an earlier demo in a folder, if there is one.
fn demo_files(folder: &Path) -> Option<Owned> {
    let solution = own_files(&folder.join(SOLUTION))?.listed();
    let solution = solution.iter().map(|name| format!("{SOLUTION}/{name}"));
    let capture = demo_names().map(|name| format!("{CAPTURE}/{name}"));
    // As many lamps as there are files are enough to know all pictures by name.
    let lamps = fs::read_dir(folder.join(PICTURES)).map_or(0, Iterator::count);
    let stems = (1..=lamps).map(alone);
    let stems = stems.chain([ORIGINAL, MOVED].map(str::to_owned));
    let pictures =
        stems.flat_map(|stem| ["exr", "png"].map(|end| format!("{PICTURES}/{stem}.{end}")));
    Some(solution.chain(capture).chain(pictures).collect())
}

/// Renders the demo's pictures; returns file and description of each.
fn take_pictures(
    solution: &Solution,
    camera: &Camera,
    staging: &Staging,
    progress: &mut Progress,
) -> anyhow::Result<Vec<(String, String)>> {
    let mut wishes = vec![(
        ORIGINAL.to_owned(),
        "the captured lighting".to_owned(),
        Vec::new(),
    )];
    for (i, lamp) in solution.lamps.iter().enumerate() {
        wishes.push((
            alone(i + 1),
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
            MOVED.to_owned(),
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
    fs::create_dir(staging.path().join(PICTURES)).map_err(cannot_write(staging.target()))?;
    let renderer = Renderer::new(solution);
    let mut made = Vec::new();
    for (stem, what, edits) in wishes {
        let shot = Shot {
            stem: format!("{PICTURES}/{stem}"),
            camera: camera.clone(),
        };
        renderer.shoot(&[shot], &edits, false, staging, progress)?;
        made.push((format!("{PICTURES}/{stem}.png"), what));
    }
    Ok(made)
}
