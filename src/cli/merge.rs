//! `rekindle merge`: brackets of exposures to linear radiance.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::interrupt;
use super::progress::Progress;
use super::render::check_output;
use super::{OutputArgs, json_path, print_json, print_line};
use rekindle_base::staging::{Staging, cannot_write, check_added};
use rekindle_base::text::csv_cell;
use rekindle_capture::{Group, KNOTS, MergedPhoto, Origin, Photos, Response};
use rekindle_solution::{write_rgb, write_rgba};

/// Files that tell how the pictures were merged.
const REPORTS: [&str; 4] = [
    "response.json",
    "response.csv",
    "weights.csv",
    "frames.json",
];

/// Arguments of `rekindle merge`.
#[derive(clap::Args)]
pub(super) struct MergeArgs {
    /// Photographs, folders of them, or a capture whose transforms.json lists exposures
    #[arg(required = true)]
    photographs: Vec<PathBuf>,
    /// Folder for the merged pictures; others in it stay
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Table of exposures that replace those in EXIF data, lines of file,time[,f,iso] (default: exposures.csv in the folder of
    /// the photographs, if there is one)
    #[arg(long, value_name = "FILE")]
    exposures: Option<PathBuf>,
}

pub(super) fn run(args: &MergeArgs, output: OutputArgs) -> anyhow::Result<()> {
    let settled = check_output(&args.output)?;
    let mut progress = Progress::new(output);
    progress.warn_all(&settled);
    progress.stage("reading exposures", 0.0);
    let photos = Photos::find(&args.photographs, args.exposures.as_deref())?;
    check_inputs(args, &photos)?;
    interrupt::check()?;
    progress.stage("recovering the camera's response", 0.02);
    let response = photos.response()?;
    let staging = Staging::within(&args.output).map_err(cannot_write(&args.output))?;
    let mut views = Vec::with_capacity(photos.groups.len());
    for (i, group) in photos.groups.iter().enumerate() {
        interrupt::check()?;
        let part = 0.2 + 0.8 * i as f32 / photos.groups.len() as f32;
        progress.stage(&format!("merging {}", group.name), part);
        let merged = photos.merge(i, &response)?;
        for warning in &merged.warnings {
            progress.warn(warning);
        }
        write_picture(staging.path(), &group.name, &merged).map_err(cannot_write(&args.output))?;
        views.push(view(group, &merged));
    }
    interrupt::check()?;
    write_reports(staging.path(), &response, &views).map_err(cannot_write(&args.output))?;
    staging.add()?;
    progress.finish();
    if output.json {
        print_json(
            &json!({ "folder": json_path(&args.output), "response": response, "views": views }),
        );
    } else if !output.quiet {
        print_text(&args.output, &response, &views);
    }
    Ok(())
}

/// Fails where merged pictures or reports would be written over what is merged.
fn check_inputs(args: &MergeArgs, photos: &Photos) -> anyhow::Result<()> {
    let groups = &photos.groups;
    let photos = groups.iter().flat_map(|group| &group.photos);
    let mut inputs: Vec<PathBuf> = photos.map(|photo| photo.path.clone()).collect();
    inputs.extend(args.exposures.clone());
    let pictures = groups.iter().map(|group| format!("{}.exr", group.name));
    let names: Vec<String> = pictures.chain(REPORTS.map(str::to_owned)).collect();
    let names = names.iter().map(String::as_str);
    Ok(check_added(&args.output, names, &inputs)?)
}

fn write_picture(folder: &Path, name: &str, merged: &MergedPhoto) -> io::Result<()> {
    let path = folder.join(format!("{name}.exr"));
    match &merged.alpha {
        Some(alpha) => write_rgba(&path, merged.width, &merged.radiance, alpha),
        None => write_rgb(&path, merged.width, &merged.radiance),
    }
}

/// What became of a group.
fn view(group: &Group, merged: &MergedPhoto) -> Value {
    let files: Vec<Value> = group
        .photos
        .iter()
        .map(|photo| {
            let settings = photo.shot.settings;
            json!({
                "file": photo.path.file_name().map(|n| n.to_string_lossy()),
                "exposure_time": settings.map(|s| s.time),
                "f_number": settings.and_then(|s| s.f_number),
                "iso": settings.and_then(|s| s.iso),
            })
        })
        .collect();
    json!({
        "file_path": format!("{}.exr", group.name),
        "w": merged.width,
        "h": merged.height,
        "merged_from": files,
        "exposures": merged.uses,
        "saturated_pixels": merged.saturated,
        "warnings": merged.warnings,
    })
}

/// The response and the weights as JSON and CSV, and the frames for a manifest.
fn write_reports(folder: &Path, response: &Response, views: &[Value]) -> io::Result<()> {
    let report = json!({ "response": response, "views": views });
    let frames: Vec<Value> = views
        .iter()
        .map(|view| {
            json!({
                "file_path": view["file_path"],
                "w": view["w"],
                "h": view["h"],
                "merged_from": view["merged_from"],
            })
        })
        .collect();
    let fragment = json!({ "frames": frames });
    let texts = [
        serde_json::to_string_pretty(&report)?,
        response_csv(response),
        weights_csv(views),
        serde_json::to_string_pretty(&fragment)?,
    ];
    REPORTS
        .iter()
        .zip(texts)
        .try_for_each(|(name, text)| fs::write(folder.join(name), text))
}

fn response_csv(response: &Response) -> String {
    let mut text = "code,red,green,blue\n".to_owned();
    for k in 0..KNOTS {
        let [red, green, blue] = [0, 1, 2].map(|c| response.curves[c][k]);
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{k},{red},{green},{blue}");
    }
    text
}

fn weights_csv(views: &[Value]) -> String {
    let mut text = "picture,file,amount,weight,clipped,measured_factor\n".to_owned();
    let quoted = |value: &Value| csv_cell(value.as_str().unwrap_or_default());
    let number = |value: &Value| value.as_f64().map_or_else(String::new, |v| v.to_string());
    for view in views {
        for exposure in view["exposures"].as_array().into_iter().flatten() {
            let _ = writeln!(
                text,
                "{},{},{},{},{},{}",
                quoted(&view["file_path"]),
                quoted(&exposure["file"]),
                number(&exposure["amount"]),
                number(&exposure["weight"]),
                number(&exposure["clipped"]),
                number(&exposure["measured_factor"])
            );
        }
    }
    text
}

fn print_text(folder: &Path, response: &Response, views: &[Value]) {
    let origin = match response.origin {
        Origin::Srgb => "sRGB, which the brackets agree with",
        Origin::Linear => "linear, which the brackets agree with",
        Origin::Recovered => "recovered from the brackets",
        Origin::RecoveredPerChannel => "recovered from the brackets, a curve for each channel",
    };
    print_line(&format!("response  {origin}"));
    if let (Some(left), Some(before)) = (response.disagreement, response.disagreement_assumed) {
        print_line(&format!(
            "          exposures agree within {:.1} % ({:.1} % under the usual curve), at {} points",
            100.0 * left,
            100.0 * before,
            response.compared
        ));
    }
    for view in views {
        let weights: Vec<String> = view["exposures"]
            .as_array()
            .into_iter()
            .flatten()
            .map(|e| {
                let share = 100.0 * e["weight"].as_f64().unwrap_or(0.0);
                format!("{} {share:.0} %", e["file"].as_str().unwrap_or_default())
            })
            .collect();
        let name = view["file_path"].as_str().unwrap_or_default();
        let saturated = match view["saturated_pixels"].as_u64() {
            Some(count) if count > 0 => format!(", {count} pixels clipped in all"),
            _ => String::new(),
        };
        print_line(&format!("{name}  {}{saturated}", weights.join(", ")));
    }
    print_line(&format!(
        "{}: {} pictures, {}",
        folder.display(),
        views.len(),
        REPORTS.join(", ")
    ));
}
