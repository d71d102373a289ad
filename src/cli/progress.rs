//! Progress on stderr: a bar on a terminal, one plain line a stage elsewhere, nothing when quiet.

use std::io::IsTerminal as _;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use super::{OutputArgs, print_message};
use rekindle_base::text::printable;

/// Steps of the bar.
const STEPS: u64 = 1000;

/// Shows how far a command has come.
pub(super) struct Progress {
    bar: Option<ProgressBar>,
    quiet: bool,
    stage: String,
}

impl Progress {
    /// Progress for a command about to start.
    pub(super) fn new(output: OutputArgs) -> Self {
        let bar = (!output.quiet && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::new(STEPS);
            if let Ok(style) =
                ProgressStyle::with_template("{elapsed:>4} {bar:30} {percent:>3}%  {msg}")
            {
                bar.set_style(style);
            }
            bar.enable_steady_tick(Duration::from_millis(100));
            bar
        });
        Self {
            bar,
            quiet: output.quiet,
            stage: String::new(),
        }
    }

    /// What is being done, and which part of the whole is done.
    pub(super) fn stage(&mut self, what: &str, fraction: f32) {
        if let Some(bar) = &self.bar {
            bar.set_position((fraction.clamp(0.0, 1.0) * STEPS as f32) as u64);
            if self.stage != what {
                bar.set_message(printable(what).into_owned());
            }
        } else if !self.quiet && self.stage != what {
            print_message(what);
        }
        if self.stage != what {
            what.clone_into(&mut self.stage);
        }
    }

    /// Something the user should know.
    pub(super) fn warn(&self, warning: &str) {
        if self.quiet {
            return;
        }
        let line = format!("warning: {warning}");
        match &self.bar {
            Some(bar) => bar.suspend(|| print_message(&line)),
            None => print_message(&line),
        }
    }

    /// Several things the user should know.
    pub(super) fn warn_all(&self, warnings: &[String]) {
        for warning in warnings {
            self.warn(warning);
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
