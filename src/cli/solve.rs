//! `rekindle solve`: from a capture to a solution.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::bail;
use clap::ValueEnum;

use super::interrupt::{self, Interrupted};
use super::progress::Progress;
use super::{OutputArgs, print_json, print_line};
use rekindle_base::memory::peak;
use rekindle_base::staging::check_holds_no_input;
use rekindle_capture::{Capture, LightFrame, input_files};
use rekindle_estimate::estimate::{
    EstimateParams, Iteration, Method, Observer, STATED_ROUGHNESS, SpecularChoice,
};
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::shortcuts::Shortcut;
use rekindle_solution::{
    LightProbe, Solution, SolveOptions, check_destination, origin, solve_under,
};

/// Frequency of the hemisphere up to which all its nodes can be unknowns at once: 2000 of them.
const MOST_DENSE: u32 = 20;

/// Arguments of `rekindle solve`.
#[derive(clap::Args)]
pub(super) struct SolveArgs {
    /// Folder of the capture, or its transforms.json
    capture: PathBuf,
    /// Folder for the solution; one that is there already is replaced at the end, if nothing else is in its folder
    #[arg(short, long, value_name = "SOLUTION")]
    output: PathBuf,
    #[command(flatten)]
    options: EstimationArgs,
    #[command(flatten)]
    light: LightArgs,
}

/// The light of the place, where it is known.
#[derive(clap::Args)]
struct LightArgs {
    /// Lat-long picture of all the light of the place (EXR or Radiance HDR), in the photographs' units: no light is estimated, and
    /// roughness, gloss and albedo are absolute
    #[arg(long, value_name = "PROBE")]
    light: Option<PathBuf>,
    /// Turn of that picture about the capture's up, counter-clockwise seen from above (default: by the highlights)
    #[arg(long, value_name = "DEGREES", value_parser = degrees, requires = "light", allow_negative_numbers = true)]
    light_rotation: Option<f32>,
}

impl LightArgs {
    fn probe(&self) -> anyhow::Result<Option<LightProbe>> {
        let turn = self.light_rotation.map(f32::to_radians);
        let probe = self.light.as_ref().map(|path| LightProbe::load(path, turn));
        Ok(probe.transpose()?)
    }
}

fn degrees(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err("it must be a number of degrees".to_owned()),
    }
}

/// How the estimation is done.
#[derive(clap::Args)]
pub(super) struct EstimationArgs {
    /// How roughness and lights are estimated
    #[arg(long, value_enum, default_value_t = MethodArg::Fast)]
    method: MethodArg,
    /// Form of the specular lobe: the paper's, microfacets with Beckmann's or GGX's slopes, a metal's, or whichever fits
    #[arg(long, value_enum, default_value_t = SpecularArg::Auto)]
    specular: SpecularArg,
    /// Roughness of the surface as Blender and others call it, 0 to 1, where it is known (default: estimated)
    #[arg(long, value_parser = roughness, allow_negative_numbers = true)]
    roughness: Option<f32>,
    /// Parts into which each edge of the lights' icosahedron is divided
    #[arg(long, default_value_t = 70, value_parser = clap::value_parser!(u32).range(1..=200))]
    frequency: u32,
    /// Distance of the lights from the object's centre, in mesh units (default: what the capture states, or distant)
    #[arg(long, value_parser = positive, allow_negative_numbers = true)]
    radius: Option<f32>,
    /// What the lights stand still with (default: what the capture states, or else shows)
    #[arg(long, value_enum)]
    light_frame: Option<LightFrameArg>,
    /// Take cameras and exposures as stated, even where outlines and radiances do not fit
    #[arg(long)]
    as_stated: bool,
    /// Do everything, also what is skipped because it hardly changes the result
    #[arg(long, value_enum, value_name = "WHAT", value_delimiter = ',')]
    do_all: Vec<ShortcutArg>,
}

/// Work that is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ShortcutArg {
    /// Make every node of the hemisphere an unknown, not only those where light was found (frequency 20 at most)
    DarkCells,
    /// Solve for all cells at once, not only for those that are lit and those beside them
    FarCells,
    /// Evaluate lobes also where they have fallen to nothing
    Lobes,
    /// Look also at points that show no lamp's highlight
    UnlitPoints,
    /// Cast a ray for every cell and point
    ShadowRays,
    /// Try all roughnesses, for both specular models
    Roughnesses,
    /// Make the texture from all views, also where six others see a part of the surface better
    Views,
    /// Keep every pixel about the object, also where many large photographs show far more than lights need
    Pixels,
    /// Solve again what has not changed since the solution that is there was written
    Unchanged,
}

impl ShortcutArg {
    /// The estimation's; none where what would be left out is the whole of it, or before it.
    fn shortcut(self) -> Option<Shortcut> {
        Some(match self {
            Self::DarkCells => Shortcut::DarkCells,
            Self::FarCells => Shortcut::FarCells,
            Self::Lobes => Shortcut::Lobes,
            Self::UnlitPoints => Shortcut::UnlitPoints,
            Self::ShadowRays => Shortcut::ShadowRays,
            Self::Roughnesses => Shortcut::Roughnesses,
            Self::Views => Shortcut::Views,
            Self::Pixels | Self::Unchanged => return None,
        })
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum LightFrameArg {
    /// The object: cameras went around it
    World,
    /// The camera: the object turned before it, as on a turntable
    Camera,
}

impl LightFrameArg {
    fn frame(self) -> LightFrame {
        match self {
            Self::World => LightFrame::World,
            Self::Camera => LightFrame::Camera,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum MethodArg {
    /// Variable projection with the diffuse colours eliminated
    Fast,
    /// The paper's alternation, lights first: for comparison, slower and less exact
    Amuh,
    /// The paper's alternation, roughness first: for comparison, slower and less exact
    Amhu,
    /// The paper's least squares without regularisation: for comparison, slower and least exact
    Plain,
}

impl MethodArg {
    /// The estimator's name for it.
    pub(super) fn method(self) -> Method {
        match self {
            Self::Fast => Method::Fast,
            Self::Amuh => Method::Amuh,
            Self::Amhu => Method::Amhu,
            Self::Plain => Method::Plain,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum SpecularArg {
    /// Fresnel factor and masking constant (eq. 4)
    Paper,
    /// Microfacets with Beckmann's slopes, dielectric Fresnel factor and masking
    #[value(alias = "microfacet")]
    Beckmann,
    /// The same with GGX's slopes, which fall off slowly, as the Principled surface of Blender and others
    Ggx,
    /// GGX's slopes with a constant Fresnel factor
    Metal,
    /// Whichever leaves least unexplained
    Auto,
}

impl Default for EstimationArgs {
    fn default() -> Self {
        Self {
            method: MethodArg::Fast,
            specular: SpecularArg::Auto,
            roughness: None,
            frequency: 70,
            radius: None,
            light_frame: None,
            as_stated: false,
            do_all: Vec::new(),
        }
    }
}

impl EstimationArgs {
    /// Refuses what would take all memory there is.
    fn check(&self) -> anyhow::Result<()> {
        if self.do_all.contains(&ShortcutArg::DarkCells) && self.frequency > MOST_DENSE {
            bail!(
                "--do-all dark-cells makes every node an unknown, which are too many at frequency {}; give --frequency \
                 {MOST_DENSE} or less",
                self.frequency
            );
        }
        if self.roughness.is_some() && !matches!(self.method, MethodArg::Fast) {
            bail!(
                "--roughness is for the default method: the reference methods estimate it. Leave one of both out"
            );
        }
        Ok(())
    }

    fn options(&self) -> SolveOptions {
        SolveOptions {
            estimate: EstimateParams {
                method: self.method.method(),
                specular: match self.specular {
                    SpecularArg::Paper => SpecularChoice::Model(SpecularModel::Paper),
                    SpecularArg::Beckmann => SpecularChoice::Model(SpecularModel::Beckmann),
                    SpecularArg::Ggx => SpecularChoice::Model(SpecularModel::Ggx),
                    SpecularArg::Metal => SpecularChoice::Model(SpecularModel::Metal),
                    SpecularArg::Auto => SpecularChoice::Auto,
                },
                sigma: self.roughness.map(Brdf::sigma_of),
                as_stated: self.as_stated,
                avoided: self
                    .do_all
                    .iter()
                    .filter_map(|shortcut| shortcut.shortcut())
                    .collect(),
            },
            frequency: self.frequency,
            radius: self.radius,
            light_frame: self.light_frame.map(LightFrameArg::frame),
        }
    }
}

fn roughness(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if STATED_ROUGHNESS.contains(&value) => Ok(value),
        _ => Err(format!(
            "it must be a number from {} to {}",
            STATED_ROUGHNESS.start(),
            STATED_ROUGHNESS.end()
        )),
    }
}

fn positive(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("it must be a number greater than 0".to_owned()),
    }
}

/// Shows a solve's progress and stops it after Ctrl-C.
struct Shown<'a>(&'a mut Progress);

impl Observer for Shown<'_> {
    fn progress(&mut self, what: &str, fraction: f32) -> ControlFlow<()> {
        self.0.stage(what, fraction);
        go_on()
    }

    fn iteration(&mut self, _: &Iteration, _: &dyn Fn() -> Vec<[f32; 3]>) -> ControlFlow<()> {
        go_on()
    }
}

fn go_on() -> ControlFlow<()> {
    if interrupt::asked() {
        ControlFlow::Break(())
    } else {
        ControlFlow::Continue(())
    }
}

pub(super) fn run(args: &SolveArgs, output: OutputArgs) -> anyhow::Result<()> {
    if args.output.exists() {
        check_holds_no_input(&args.output, &input_files(&args.capture)?)?;
    }
    let settled = check_destination(&args.output)?;
    args.options.check()?;
    if args.light.light.is_some() && !matches!(args.options.method, MethodArg::Fast) {
        bail!(
            "--light is for the default method: the reference methods estimate the light. Leave one of both out"
        );
    }
    let light = args.light.probe()?;
    let mut progress = Progress::new(output);
    progress.warn_all(&settled);
    progress.stage("reading the capture", 0.0);
    let started = Instant::now();
    let capture = if args.options.do_all.contains(&ShortcutArg::Pixels) {
        Capture::load_full(&args.capture)?
    } else {
        Capture::load(&args.capture)?
    };
    let load_s = started.elapsed().as_secs_f64();
    interrupt::check()?;
    if let Some(solution) = unchanged(args, &capture, light.as_ref()) {
        warn(&solution, &mut progress);
        progress.finish();
        report(args, output, &solution, solution.timings.clone(), true);
        return Ok(());
    }
    if let Some(light) = &light {
        light.check(&capture, &args.options.options())?;
    }
    let solution = solve_capture(
        &capture,
        load_s,
        &args.options,
        light.as_ref(),
        &mut progress,
    )?;
    progress.stage("writing the solution", 0.97);
    interrupt::check()?;
    let timings = solution.save(&args.output)?;
    progress.finish();
    report(args, output, &solution, timings, false);
    Ok(())
}

/// The solution that is there, if solving would give the same.
fn unchanged(args: &SolveArgs, capture: &Capture, light: Option<&LightProbe>) -> Option<Solution> {
    if args.options.do_all.contains(&ShortcutArg::Unchanged) {
        return None;
    }
    Solution::load_of_origin(&args.output, || {
        origin(capture, &args.options.options(), light)
    })
}

/// Says what was found and where it is; `timings` are the seconds of each stage, when it was found.
fn report(
    args: &SolveArgs,
    output: OutputArgs,
    solution: &Solution,
    timings: Vec<(String, f64)>,
    unchanged: bool,
) {
    let path = args.output.to_string_lossy().into_owned();
    if output.json {
        let mut summary = solution.summary();
        if let Some(object) = summary.as_object_mut() {
            let seconds: serde_json::Map<_, _> = timings
                .into_iter()
                .map(|(stage, s)| (stage, s.into()))
                .collect();
            object.insert("timings_s".to_owned(), seconds.into());
            object.insert("peak_bytes".to_owned(), peak().into());
            object.insert("solution".to_owned(), path.into());
            object.insert("unchanged".to_owned(), unchanged.into());
        }
        print_json(&summary);
    } else if !output.quiet {
        let found = describe(solution);
        let kept = if unchanged {
            "; nothing has changed since it was solved (--do-all unchanged solves it again)"
        } else {
            ""
        };
        print_line(&format!("{path}: {found}{kept}"));
    }
}

fn warn(solution: &Solution, progress: &mut Progress) {
    progress.warn_all(&solution.diagnostics.warnings);
}

/// Solves a capture, with progress and warnings.
pub(super) fn solve_capture(
    capture: &Capture,
    load_s: f64,
    options: &EstimationArgs,
    light: Option<&LightProbe>,
    progress: &mut Progress,
) -> anyhow::Result<Solution> {
    let options = options.options();
    let solution = solve_under(capture, &options, light, load_s, &mut Shown(progress))
        .map_err(Interrupted::from)?;
    warn(&solution, progress);
    Ok(solution)
}

/// What was found, in a line.
pub(super) fn describe(solution: &Solution) -> String {
    let lights = match (&solution.known_light, solution.lamps.len()) {
        (Some(known), _) => {
            let (file, turn) = (&known.file, known.rotation_deg);
            format!("the light given by {file}, turned by {turn:.1}°")
        }
        (None, 1) => "1 light".to_owned(),
        (None, count) => format!("{count} lights"),
    };
    match solution.brdf {
        Some(brdf) => {
            let surface = solution.surface_in_words();
            let reflects = solution.known_reflectance().map_or_else(String::new, |f0| {
                format!(", {:.1} % reflected at normal incidence", 100.0 * f0)
            });
            format!("{surface} (σ {:.4}){reflects}, {lights}", brdf.sigma)
        }
        None if solution.known_light.is_some() => {
            format!("no specular part was found; {lights}")
        }
        None if solution.lamps.is_empty() => {
            "no specular part was found; the solution holds the diffuse texture only".to_owned()
        }
        None => format!("no specular part was found; {lights} by the shading alone"),
    }
}
