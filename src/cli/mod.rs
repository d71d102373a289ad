//! The command line: one file per command. Results go to stdout, progress and warnings to stderr, and every error is
//! printed here, once.

mod align;
mod bench;
mod demo;
mod export;
mod gui;
mod info;
mod info_solution;
mod interrupt;
mod manual;
mod merge;
mod print;
mod progress;
mod render;
mod solve;
mod study;
mod synth;
mod window_needs;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context as _, bail};
use clap::{Args, Parser, Subcommand};
use interrupt::{INTERRUPTED, Interrupted};
use print::{json_path, print_json, print_line, print_message, print_report};

use crate::worker::message;
use rekindle_base::memory;

/// Exit status for bad input and usage, as clap's own.
const BAD_INPUT: u8 = 2;

/// Relights a captured object: recovers texture, roughness and lighting from a few HDR photographs.
///
/// Without a command, the window opens. Where there is no display, or with --quiet or --json, the built-in demo is
/// solved and relit in ./rekindle-demo instead.
#[derive(Parser)]
#[command(name = "rekindle", version, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// Folder of a capture or of a solution, or a project, to open in the window
    path: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

/// What all commands have in common.
#[derive(Args, Clone, Copy, Debug)]
#[command(next_help_heading = "General options")]
struct OutputArgs {
    /// No progress and no warnings
    #[arg(long, global = true)]
    quiet: bool,
    /// Print one JSON object on stdout at the end
    #[arg(long, global = true)]
    json: bool,
    /// Number of threads (default: one per core)
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Most memory that captures may take, such as 8G (default: three quarters of the machine's)
    #[arg(long, global = true, value_name = "BYTES", value_parser = memory::parse)]
    memory: Option<u64>,
}

#[derive(Subcommand)]
enum Command {
    /// Open the window
    Gui {
        /// Folder of a capture or of a solution, or a project
        path: Option<PathBuf>,
    },
    /// Solve the built-in capture and relight it in ./rekindle-demo
    Demo,
    /// Recover texture, roughness and lighting of a capture
    Solve(solve::SolveArgs),
    /// Render a solution from other viewpoints and under other light
    Render(render::RenderArgs),
    /// Write a solution's object and light for other programs
    ///
    /// Without --for: light maps and lists, cameras, scenes for Blender and Mitsuba, glTF, USD and OBJ.
    Export(export::ExportArgs),
    /// Bring the mesh of a capture into the cameras' frame, by the silhouettes of its photographs
    ///
    /// The images must have alpha or masks, or points be marked in them (--points). The transform is written into
    /// transforms.json as mesh_transform.
    Align(align::AlignArgs),
    /// Merge brackets of exposures to linear EXR files, all on one scale
    ///
    /// Photographs that belong together are found by their EXIF data: taken one after the other with the same camera, each
    /// with another exposure; or else by names that differ only after the last `_` or `-`. The camera's response is recovered
    /// from all of them.
    Merge(merge::MergeArgs),
    /// Make a capture with known truth, to study the estimation with
    ///
    /// The folder is like a photographed capture, with the truth beside it: what `rekindle bench` compares with. The
    /// photographs come from this program's own reference renderer, so that the estimation's model of light is exactly
    /// the truth's. A good result on such a capture is necessary, not sufficient.
    Synth(synth::SynthArgs),
    /// Compare methods on captures with known truth: error against run time
    ///
    /// With --leave-one-out captures of real objects will do, of which nothing but the photographs is known.
    Bench(bench::BenchArgs),
    /// Study how far the estimate can be trusted and what it costs, on captures made for it
    ///
    /// Makes captures one thing worse or larger from one to the next, solves each by the default method in a process of its own,
    /// and writes tables and plots of the errors, seconds and bytes. The whole takes more than an hour.
    Study(study::StudyArgs),
    /// Say what is in a capture or a solution, and what is wrong with it
    Info {
        /// Folder of a capture or of a solution
        path: PathBuf,
    },
    /// Print a shell's script that completes commands and options
    ///
    /// For instance: rekindle completions bash > ~/.local/share/bash-completion/completions/rekindle
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Print the manual page of a command, for man
    ///
    /// For instance: rekindle manual solve | man -l -
    Manual {
        /// The command (default: the program itself)
        command: Option<String>,
    },
}

/// Runs the command given by the program's arguments.
pub fn run() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version come this way too and are no errors.
            let status = if error.use_stderr() { BAD_INPUT } else { 0 };
            let _ = error.print();
            return ExitCode::from(status);
        }
    };
    match execute(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        // What was being written is taken away then, so that other errors may come of it.
        Err(error) if error.is::<Interrupted>() || interrupt::asked() => {
            ExitCode::from(INTERRUPTED)
        }
        Err(error) => {
            print_message(&format!("rekindle: {}", message(&error)));
            ExitCode::from(BAD_INPUT)
        }
    }
}

fn execute(cli: &Cli) -> anyhow::Result<()> {
    check_space(cli.output.threads)?;
    interrupt::listen()?;
    interrupt::outlive_file_limit()?;
    start_threads(cli.output.threads)?;
    if let Some(bytes) = cli.output.memory {
        memory::set_limit(bytes);
    }
    match &cli.command {
        None => gui::run_or_demo(cli.path.as_deref(), cli.output),
        Some(Command::Gui { path }) => gui::run(path.as_deref()),
        Some(Command::Demo) => demo::run(cli.output),
        Some(Command::Solve(args)) => solve::run(args, cli.output),
        Some(Command::Render(args)) => render::run(args, cli.output),
        Some(Command::Export(args)) => export::run(args, cli.output),
        Some(Command::Align(args)) => align::run(args, cli.output),
        Some(Command::Merge(args)) => merge::run(args, cli.output),
        Some(Command::Synth(args)) => synth::run(args, cli.output),
        Some(Command::Bench(args)) => bench::run(args, cli.output),
        Some(Command::Study(args)) => study::run(args, cli.output),
        Some(Command::Info { path }) => {
            let folder = rekindle_solution::solution_folder(path);
            if folder.join("solution.json").is_file() {
                info_solution::run(folder, cli.output)
            } else {
                info::run(path, cli.output.json)
            }
        }
        Some(Command::Completions { shell }) => manual::completions(*shell),
        Some(Command::Manual { command }) => manual::page(command.as_deref()),
    }
}

/// Refuses to start where memory would run out before anything is read: the allocator ends a program without a word.
fn check_space(threads: Option<u16>) -> anyhow::Result<()> {
    let all = || std::thread::available_parallelism().map_or(1, usize::from);
    if let Some([needed, allowed]) = memory::missing_space(threads.map_or_else(all, usize::from)) {
        bail!(
            "{} of address space are needed to start, and the process is allowed {}; raise the limit (ulimit -v) or use fewer threads (--threads 1)",
            memory::in_words(needed),
            memory::in_words(allowed)
        );
    }
    Ok(())
}

/// Starts the threads that share the work, one per core unless stated.
fn start_threads(threads: Option<u16>) -> anyhow::Result<()> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.map_or(0, usize::from))
        .build_global()
        .context("can't start the threads; use fewer (--threads 1), or raise the limits of memory and processes (ulimit)")
}
