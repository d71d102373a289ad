//! `rekindle bench`: error against run time, and photographs predicted from others.

use std::io;
use std::path::{Path, PathBuf};

use super::interrupt::{self, Interrupted};
use super::progress::Progress;
use super::render::check_output;
use super::solve::MethodArg;
use super::{OutputArgs, json_path, print_json, print_line};
use rekindle_base::staging::{Staging, cannot_write};
use rekindle_estimate::estimate::EstimateParams;
use rekindle_lab::bench::{Audience, BenchError, Plan, leave_one_out, run as compare, table};
use rekindle_solution::SolveOptions;

/// Arguments of `rekindle bench`.
#[derive(clap::Args)]
pub(super) struct BenchArgs {
    /// Folders of captures with known truth, such as `rekindle synth` makes
    #[arg(required = true, value_name = "CAPTURE")]
    captures: Vec<PathBuf>,
    /// Folder for tables and plots
    #[arg(
        short,
        long,
        value_name = "DIR",
        required_unless_present = "leave_one_out"
    )]
    output: Option<PathBuf>,
    /// Predict each photograph from the others, of any capture: PSNR over all pixels and over the brightest tenth, beside the
    /// same with all taken as diffuse; prints a table
    #[arg(long, conflicts_with_all = ["output", "methods", "rounds"])]
    leave_one_out: bool,
    /// Methods to compare, separated by commas; ratios are to the first
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        default_value = "fast,amuh,amhu,plain"
    )]
    methods: Vec<MethodArg>,
    /// How often each is run, by turns; ratios are medians
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Parts into which each edge of the lights' icosahedron is divided
    #[arg(long, default_value_t = 70, value_parser = clap::value_parser!(u32).range(1..=200))]
    frequency: u32,
}

impl Audience for Progress {
    fn stage(&mut self, what: &str, fraction: f32) {
        Self::stage(self, what, fraction);
    }

    fn stop(&self) -> bool {
        interrupt::asked()
    }
}

pub(super) fn run(args: &BenchArgs, output: OutputArgs) -> anyhow::Result<()> {
    let Some(folder) = &args.output else {
        return predict(args, output);
    };
    let settled = check_output(folder)?;
    let mut methods: Vec<_> = Vec::new();
    for method in args.methods.iter().map(|method| method.method()) {
        if !methods.contains(&method) {
            methods.push(method);
        }
    }
    let plan = Plan {
        captures: args.captures.clone(),
        methods,
        rounds: args.rounds,
        frequency: args.frequency,
    };
    let mut progress = Progress::new(output);
    progress.warn_all(&settled);
    let report = match compare(&plan, &mut progress) {
        Err(BenchError::Stopped) => return Err(Interrupted.into()),
        other => other?,
    };
    interrupt::check()?;
    let staging = Staging::within(folder).map_err(cannot_write(folder))?;
    written(staging, folder, &progress, output, |folder| {
        report.write(folder)
    })
}

/// Each photograph from the others.
fn predict(args: &BenchArgs, output: OutputArgs) -> anyhow::Result<()> {
    let options = SolveOptions {
        estimate: EstimateParams::default(),
        frequency: args.frequency,
        radius: None,
        light_frame: None,
    };
    let mut progress = Progress::new(output);
    let predicted = match leave_one_out(&args.captures, &options, &mut progress) {
        Err(BenchError::Stopped) => return Err(Interrupted.into()),
        other => other?,
    };
    progress.finish();
    if output.json {
        print_json(&serde_json::json!({ "predicted": predicted }));
    } else {
        for line in table(&predicted).lines() {
            print_line(line);
        }
    }
    Ok(())
}

/// Adds the files that `write` makes in a folder, whose names it returns, to the folder asked for, and says so.
pub(super) fn written(
    staging: Staging,
    folder: &Path,
    progress: &Progress,
    output: OutputArgs,
    write: impl FnOnce(&Path) -> io::Result<Vec<String>>,
) -> anyhow::Result<()> {
    let files = write(staging.path()).map_err(cannot_write(folder))?;
    staging.add()?;
    progress.finish();
    if output.json {
        let files: Vec<_> = files
            .iter()
            .map(|file| json_path(&folder.join(file)))
            .collect();
        print_json(&serde_json::json!({ "files": files }));
    } else if !output.quiet {
        print_line(&format!("{}: {}", folder.display(), files.join(", ")));
    }
    Ok(())
}
