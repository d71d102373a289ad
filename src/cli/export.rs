//! `rekindle export`: a solution's object and light for other programs.

use std::path::PathBuf;

use anyhow::bail;

use super::interrupt::{self, Interrupted};
use super::progress::Progress;
use super::render::{check_apart, check_output};
use super::{OutputArgs, json_path, print_json, print_line};
use rekindle_capture::read_cameras;
use rekindle_output::interchange::{
    Anchor, Form, Job, JobError, MapLayout, Orientation, Source, USUAL_F0, export, reflectance,
};
use rekindle_relight as relight;
use rekindle_solution::{Solution, solution_folder};

/// Arguments of `rekindle export`.
#[derive(clap::Args)]
pub(super) struct ExportArgs {
    /// Folder of a solution
    solution: PathBuf,
    /// Folder for the files
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Only what these programs and forms need (default: all but layers)
    #[arg(long = "for", value_name = "FORM", value_delimiter = ',')]
    forms: Vec<Form>,
    /// File with edits of the lighting
    #[arg(long, value_name = "FILE")]
    edits: Option<PathBuf>,
    /// File with cameras, like a capture's transforms.json (default: those of the capture)
    #[arg(long, value_name = "FILE")]
    cameras: Option<PathBuf>,
    /// Columns of the light maps; rows are half as many
    #[arg(long, value_name = "PIXELS", default_value_t = 1024)]
    size: u32,
    /// Layout of light.exr and light.hdr; files of one program have its own
    #[arg(long, value_enum, default_value_t)]
    orientation: Orientation,
    /// Rotation of light.exr and light.hdr to the right, degrees
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    yaw: f32,
    /// A light map for each lamp, and one of the rest
    #[arg(long)]
    per_lamp: bool,
    /// A light map with marked axes: red +X, green +Y, blue +Z
    #[arg(long)]
    calibration: bool,
    #[command(flatten)]
    gauge: GaugeArgs,
}

/// What fixes the scale that the photographs leave open.
#[derive(clap::Args)]
#[group(multiple = false)]
struct GaugeArgs {
    /// Index of refraction of the surface (default: 1.5)
    #[arg(long, value_name = "N")]
    ior: Option<f32>,
    /// Reflectance at normal incidence of the surface (default: 0.04)
    #[arg(long, value_name = "F0")]
    f0: Option<f32>,
    /// Diffuse albedo of the object's brightest parts, instead
    #[arg(long, value_name = "ALBEDO")]
    white_albedo: Option<f32>,
}

impl GaugeArgs {
    fn anchor(&self) -> anyhow::Result<Anchor> {
        Ok(match (self.ior, self.f0, self.white_albedo) {
            (Some(index), ..) if index > 1.0 && index <= 10.0 => Anchor::F0(reflectance(index)),
            (Some(_), ..) => bail!("--ior must be more than 1 and at most 10, as 1.5 for plastic"),
            (_, Some(f0), _) if f0 > 0.0 && f0 <= 0.9 => Anchor::F0(f0),
            (_, Some(_), _) => {
                bail!("--f0 must be more than 0 and at most 0.9, as 0.04 for plastic")
            }
            (.., Some(albedo)) if albedo > 0.0 && albedo <= 1.0 => Anchor::WhiteAlbedo(albedo),
            (.., Some(_)) => bail!("--white-albedo must be more than 0 and at most 1"),
            _ => Anchor::F0(USUAL_F0),
        })
    }
}

pub(super) fn run(args: &ExportArgs, output: OutputArgs) -> anyhow::Result<()> {
    let anchor = args.gauge.anchor()?;
    check_apart(&args.output, &args.solution)?;
    let settled = check_output(&args.output)?;
    let mut progress = Progress::new(output);
    progress.warn_all(&settled);
    progress.stage("reading the solution", 0.0);
    let solution = Solution::load(solution_folder(&args.solution))?;
    let edits = match &args.edits {
        Some(path) => relight::load(path)?,
        None => Vec::new(),
    };
    let cameras = match &args.cameras {
        Some(path) => read_cameras(path, solution.mesh.origin)?,
        None => solution.cameras.clone(),
    };
    let lighting = relight::apply(&edits, &solution.lighting())?;
    interrupt::check()?;
    let wants_cameras = |form: &Form| matches!(form, Form::Cameras | Form::Layers);
    if cameras.is_empty() && args.forms.iter().any(wants_cameras) {
        bail!(
            "{}: the solution has no cameras; name a file with them by --cameras, or solve the capture again",
            args.solution.display()
        );
    }
    let forms: &[Form] = if args.forms.is_empty() {
        &Form::USUAL
    } else {
        &args.forms
    };
    let job = Job {
        forms: forms.iter().copied().collect(),
        layout: MapLayout {
            width: args.size,
            orientation: args.orientation,
            yaw_deg: args.yaw,
        },
        per_lamp: args.per_lamp,
        calibration: args.calibration,
        folder: args.output.clone(),
    };
    let source = Source {
        solution: &solution,
        lighting: &lighting,
        names: &[],
        cameras: &cameras,
        anchor,
    };
    let mut report = |what: &str, part: f32| progress.stage(&format!("writing {what}"), part);
    let exported = export(&source, &job, &interrupt::asked, &mut report).map_err(|e| match e {
        JobError::Stopped => anyhow::Error::from(Interrupted),
        other => other.into(),
    })?;
    progress.finish();
    if output.json {
        let files: Vec<_> = exported.files.iter().map(|file| json_path(file)).collect();
        print_json(&serde_json::json!({
            "files": files,
            "notes": exported.notes,
            "beckmann_db": exported.fidelity.map(|f| f.beckmann_db),
            "ggx_db": exported.fidelity.map(|f| f.ggx_db),
        }));
    } else if !output.quiet {
        let count = exported.files.len();
        print_line(&format!("{}: {count} files", args.output.display()));
        exported.notes.iter().for_each(|note| print_line(note));
    }
    Ok(())
}
