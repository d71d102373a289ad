//! `rekindle export`: a solution's object and light for other programs.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::bail;

use super::interrupt::{self, Interrupted};
use super::progress::Progress;
use super::render::{check_apart, check_output};
use super::{OutputArgs, json_path, print_json, print_line};
use crate::setups;
use rekindle_capture::read_cameras;
use rekindle_output::interchange::{
    Anchor, Form, Job, JobError, MapLayout, Orientation, PAGE, Source, USUAL_F0, export,
    reflectance,
};
use rekindle_output::web::Setup;
use rekindle_relight::{self as relight, Lighting};
use rekindle_solution::{Solution, solution_folder};
use rekindle_studio::{Document, EXTENSION};

/// Arguments of `rekindle export`.
#[derive(clap::Args)]
pub(super) struct ExportArgs {
    /// Folder of a solution, or a project, whose shown setup is exported
    solution: PathBuf,
    /// Folder for the files; for the web page alone also the name of its file, as object.html
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Only what these programs and forms need (default: all but layers and the web page)
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
    /// Index of refraction of the surface (default: what a known light tells, else 1.5)
    #[arg(long, value_name = "N")]
    ior: Option<f32>,
    /// Reflectance at normal incidence of the surface (default: what a known light tells, else 0.04)
    #[arg(long, value_name = "F0")]
    f0: Option<f32>,
    /// Diffuse albedo of the object's brightest parts, instead
    #[arg(long, value_name = "ALBEDO")]
    white_albedo: Option<f32>,
}

impl GaugeArgs {
    /// The anchor; `known` is the reflectance at normal incidence where a known light tells it.
    fn anchor(&self, known: Option<f32>) -> anyhow::Result<Anchor> {
        Ok(match (self.ior, self.f0, self.white_albedo) {
            (Some(index), ..) if index > 1.0 && index <= 10.0 => Anchor::F0(reflectance(index)),
            (Some(_), ..) => bail!("--ior must be more than 1 and at most 10, as 1.5 for plastic"),
            (_, Some(f0), _) if f0 > 0.0 && f0 <= 0.9 => Anchor::F0(f0),
            (_, Some(_), _) => {
                bail!("--f0 must be more than 0 and at most 0.9, as 0.04 for plastic")
            }
            (.., Some(albedo)) if albedo > 0.0 && albedo <= 1.0 => Anchor::WhiteAlbedo(albedo),
            (.., Some(_)) => bail!("--white-albedo must be more than 0 and at most 1"),
            _ => Anchor::F0(known.unwrap_or(USUAL_F0)),
        })
    }
}

/// What is exported: a solution, and what an artist made of its light.
struct Opened {
    solution: Arc<Solution>,
    lighting: Lighting,
    /// Names of its lamps; without, they are numbered.
    names: Vec<String>,
    setups: Vec<Setup>,
    /// What the reader has to say, in whole sentences.
    warnings: Vec<String>,
}

impl Opened {
    fn new(path: &Path) -> anyhow::Result<Self> {
        if path.extension().is_some_and(|e| e == EXTENSION) {
            let (document, warnings) = Document::open(path)?;
            return Ok(Self {
                solution: Arc::clone(document.solution()),
                lighting: document.light().lighting,
                names: setups::names(document.look()),
                setups: setups::of_document(&document),
                warnings,
            });
        }
        let solution = Solution::load(solution_folder(path))?;
        Ok(Self {
            lighting: solution.lighting(),
            names: Vec::new(),
            setups: vec![Setup::captured(&solution)],
            solution: Arc::new(solution),
            warnings: Vec::new(),
        })
    }

    /// Edits the light; the web page has it as a setup of its own.
    fn edit(&mut self, path: &Path) -> anyhow::Result<()> {
        self.lighting = relight::apply(&relight::load(path)?, &self.lighting)?;
        self.names.clear();
        let stem = path.file_stem().unwrap_or_default();
        self.setups.push(Setup {
            name: stem.to_string_lossy().into_owned(),
            captured: false,
            lighting: self.lighting.clone(),
            names: Vec::new(),
        });
        Ok(())
    }
}

/// Folder of the files, and the web page's name in it.
fn destination(args: &ExportArgs) -> anyhow::Result<(PathBuf, String)> {
    let output = &args.output;
    let (true, Some(name)) = (
        output
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("html")),
        output.file_name(),
    ) else {
        return Ok((output.clone(), PAGE.to_owned()));
    };
    if args.forms != [Form::Web] || args.per_lamp || args.calibration {
        bail!(
            "{}: only a web page is a single file; name a folder, or export by --for web alone",
            output.display()
        );
    }
    let folder = output.parent().filter(|p| !p.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    Ok((folder.to_owned(), name.to_string_lossy().into_owned()))
}

pub(super) fn run(args: &ExportArgs, output: OutputArgs) -> anyhow::Result<()> {
    let (folder, page) = destination(args)?;
    check_apart(&folder, &args.solution)?;
    let settled = check_output(&folder)?;
    let mut progress = Progress::new(output);
    progress.warn_all(&settled);
    progress.stage("reading the solution", 0.0);
    let mut opened = Opened::new(&args.solution)?;
    progress.warn_all(&opened.warnings);
    let anchor = args.gauge.anchor(opened.solution.known_reflectance())?;
    let cameras = match &args.cameras {
        Some(path) => read_cameras(path, opened.solution.mesh.origin)?,
        None => opened.solution.cameras.clone(),
    };
    if let Some(path) = &args.edits {
        opened.edit(path)?;
    }
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
        page,
        folder,
    };
    let source = Source {
        solution: &opened.solution,
        lighting: &opened.lighting,
        names: &opened.names,
        cameras: &cameras,
        setups: &opened.setups,
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
        print_line(&match exported.files.as_slice() {
            [page] => page.display().to_string(),
            files => format!("{}: {} files", args.output.display(), files.len()),
        });
        exported.notes.iter().for_each(|note| print_line(note));
    }
    Ok(())
}
