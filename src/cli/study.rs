//! `rekindle study`: how far the estimate can be trusted, and what it costs.

use std::fs;
use std::path::PathBuf;

use anyhow::Context as _;

use super::OutputArgs;
use super::bench::written;
use super::interrupt::{self, Interrupted};
use super::progress::Progress;
use super::render::check_output;
use super::synth::Size;
use rekindle_base::staging::{Staging, cannot_write};
use rekindle_lab::study::{ACCURACY, Plan, StudyError, run as study};

/// Arguments of `rekindle study`.
#[derive(clap::Args)]
pub(super) struct StudyArgs {
    /// Folder for tables and plots; of an earlier study there, sections that are not asked for are kept
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Sections (stability, coverage, scaling, skipping) or single groups of them (stability/noise) in place of all
    #[arg(long, value_name = "SECTION[/GROUP]", value_delimiter = ',')]
    only: Vec<String>,
    /// Width and height of the photographs on which the stability is studied
    #[arg(long, value_name = "WxH", default_value = "320x240")]
    size: Size,
    /// Captures for each noise level on which it is counted how often intervals hold the truth
    #[arg(long, value_name = "COUNT", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    seeds: u32,
    /// How often what is timed is run; medians are stated
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Leave out larger photographs where times are measured, megapixels
    #[arg(long, value_name = "MEGAPIXELS", default_value_t = 12.0)]
    most_pixels: f64,
}

pub(super) fn run(args: &StudyArgs, output: OutputArgs) -> anyhow::Result<()> {
    let settled = check_output(&args.output)?;
    let plan = Plan {
        program: std::env::current_exe().context("the program can't find itself")?,
        only: args.only.clone(),
        size: args.size.pixels(),
        seeds: args.seeds,
        rounds: args.rounds,
        threads: output.threads,
        most_megapixels: args.most_pixels,
    };
    let mut progress = Progress::new(output);
    progress.warn_all(&settled);
    // Captures are made where the result is to be, where there is room, and go with it if the study is interrupted.
    let staging = Staging::within(&args.output).map_err(cannot_write(&args.output))?;
    let made = study(&plan, &staging.path().join("captures"), &mut progress);
    let made = match made {
        Err(StudyError::Stopped) => return Err(Interrupted.into()),
        other => other?,
    };
    interrupt::check()?;
    let earlier = fs::read_to_string(args.output.join(ACCURACY)).unwrap_or_default();
    written(staging, &args.output, &progress, output, |folder| {
        // What is left of the captures is no result.
        let _ = fs::remove_dir_all(folder.join("captures"));
        made.write(folder, &earlier)
    })
}
