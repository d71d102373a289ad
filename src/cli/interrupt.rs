//! Ctrl-C: the running command is asked to stop, and is stopped if it does not answer.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::Duration;

use anyhow::Context as _;

use rekindle_base::staging::abandon_unfinished;
use rekindle_estimate::estimate::Stopped;

/// Exit status after Ctrl-C.
pub(super) const INTERRUPTED: u8 = 130;
/// How long a command has to stop by itself, which together with its end stays within a tenth of a second.
const GRACE: Duration = Duration::from_millis(30);

static ASKED: AtomicBool = AtomicBool::new(false);

/// Listens for Ctrl-C from now on.
pub(super) fn listen() -> anyhow::Result<()> {
    ctrlc::set_handler(|| {
        ASKED.store(true, Ordering::SeqCst);
        sleep(GRACE);
        abandon_unfinished();
        std::process::exit(INTERRUPTED.into());
    })
    .context("can't listen for Ctrl-C")
}

/// Makes writing beyond the limit on the size of files fail like a full disk, where it would end the program.
pub(super) fn outlive_file_limit() -> anyhow::Result<()> {
    #[cfg(unix)]
    {
        let reached = std::sync::Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(signal_hook::consts::SIGXFSZ, reached)
            .context("can't listen for the limit on the size of files")?;
    }
    Ok(())
}

/// Whether the command is to stop.
pub(super) fn asked() -> bool {
    ASKED.load(Ordering::SeqCst)
}

/// Fails with [`Interrupted`] if the command is to stop.
pub(super) fn check() -> Result<(), Interrupted> {
    if asked() { Err(Interrupted) } else { Ok(()) }
}

/// The command was stopped by Ctrl-C.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("interrupted")]
pub(super) struct Interrupted;

impl From<Stopped> for Interrupted {
    fn from(_: Stopped) -> Self {
        Self
    }
}
