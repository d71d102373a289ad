//! Solves in a process of their own: with its own memory to be measured, and whatever happens to it.

use std::fs::{self, File};
use std::io;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// How often it is asked whether it has ended.
const PERIOD: Duration = Duration::from_millis(5);
/// A solve that takes longer has no end.
const ENDLESS: Duration = Duration::from_mins(15);

/// How a process ended.
pub(super) enum End {
    /// By itself, with what it wrote to stdout and stderr.
    Itself {
        status: ExitStatus,
        stdout: String,
        stderr: String,
    },
    /// It was ended, because it took too long.
    TooLong,
    /// It was ended, as was asked for.
    Stopped,
}

/// Runs a program to its end. What it writes goes through files in `folder`, which take any amount.
pub(super) fn run(
    program: &Path,
    arguments: &[String],
    folder: &Path,
    stop: &AtomicBool,
) -> io::Result<End> {
    let (out, err) = (folder.join("stdout"), folder.join("stderr"));
    let mut child = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(File::create(&out)?)
        .stderr(File::create(&err)?)
        .spawn()?;
    let started = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            let text = |path| fs::read(path).map(|b| String::from_utf8_lossy(&b).into_owned());
            return Ok(End::Itself {
                status,
                stdout: text(out)?,
                stderr: text(err)?,
            });
        }
        if stop.load(Ordering::Relaxed) {
            end(&mut child)?;
            return Ok(End::Stopped);
        }
        if started.elapsed() > ENDLESS {
            end(&mut child)?;
            return Ok(End::TooLong);
        }
        sleep(PERIOD);
    }
}

fn end(child: &mut Child) -> io::Result<()> {
    child.kill()?;
    child.wait().map(drop)
}
