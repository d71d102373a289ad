//! The one place that prints: results to stdout, messages to stderr. A reader that went away or a full device never ends
//! the program: what it made is on the disk.

use std::io::{self, ErrorKind, Write as _};
use std::path::Path;

use serde_json::Value;

use rekindle_base::text::printable;

/// Prints a command's result as one JSON object.
pub(super) fn print_json(value: &Value) {
    let _ = writeln!(io::stdout(), "{value}");
}

/// Prints a line of a command's result.
pub(super) fn print_line(line: &str) {
    let _ = writeln!(io::stdout(), "{}", printable(line));
}

/// Prints a text that is all that a command makes. Only a reader that went away is no error.
pub(super) fn print_report(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    let printed = stdout
        .write_all(text.as_bytes())
        .and_then(|()| stdout.flush());
    match printed {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error),
        _ => Ok(()),
    }
}

/// Prints a message on stderr.
pub(super) fn print_message(line: &str) {
    let _ = writeln!(io::stderr(), "{}", printable(line));
}

/// A path in JSON, which knows only Unicode: what is none of it becomes the replacement character.
pub(super) fn json_path(path: &Path) -> Value {
    path.to_string_lossy().into()
}
