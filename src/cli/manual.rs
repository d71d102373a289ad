//! Completions and manual pages, made of the definition of the command line.

use anyhow::{Context as _, anyhow};
use clap::CommandFactory as _;
use clap_complete::Shell;
use clap_mangen::Man;

use super::{Cli, print_report};

/// Prints the script that completes commands and options in `shell`.
pub(super) fn completions(shell: Shell) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "rekindle", &mut script);
    print(script)
}

/// Prints the manual page of a command, or that of the program.
pub(super) fn page(command: Option<&str>) -> anyhow::Result<()> {
    let mut definition = Cli::command();
    definition.build();
    let shown = match command {
        None => definition,
        Some(name) => command_named(&definition, name)?,
    };
    let mut page = Vec::new();
    Man::new(shown)
        .source(concat!("rekindle ", env!("CARGO_PKG_VERSION")))
        .manual("Rekindle")
        .render(&mut page)
        .context("can't make the manual page")?;
    print(page)
}

/// The command of this name, or an error that lists all.
fn command_named(program: &clap::Command, name: &str) -> anyhow::Result<clap::Command> {
    program.find_subcommand(name).cloned().ok_or_else(|| {
        let names: Vec<&str> = program
            .get_subcommands()
            .map(clap::Command::get_name)
            .collect();
        anyhow!(
            "{name}: there is no such command; it is one of {}",
            names.join(", ")
        )
    })
}

/// Prints a text that clap made.
fn print(text: Vec<u8>) -> anyhow::Result<()> {
    let text = String::from_utf8(text).context("can't print what is no text")?;
    print_report(&text).context("can't print; stdout is a full device or closed")
}
