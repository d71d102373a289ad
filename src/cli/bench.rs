//! `rekindle bench`: error against run time.

use std::io;
use std::path::{Path, PathBuf};

use super::interrupt::{self, Interrupted};
use super::progress::Progress;
use super::render::check_output;
use super::solve::MethodArg;
use super::{OutputArgs, json_path, print_json, print_line};
use rekindle_base::staging::{Staging, cannot_write};
use rekindle_lab::bench::{Audience, BenchError, Plan, run as compare};

/// Arguments of `rekindle bench`.
#[derive(clap::Args)]
pub(super) struct BenchArgs {
    /// Folders of captures with known truth, such as `rekindle synth` makes
    #[arg(required = true, value_name = "CAPTURE")]
    captures: Vec<PathBuf>,
    /// Folder for tables and plots
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
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
    let settled = check_output(&args.output)?;
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
    let staging = Staging::within(&args.output).map_err(cannot_write(&args.output))?;
    written(staging, &args.output, &progress, output, |folder| {
        report.write(folder)
    })
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
