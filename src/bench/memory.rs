//! The most memory that the program has held, where the system tells: on Linux.

use std::fs;

/// Starts counting anew from what is held now.
pub(super) fn forget_peak() {
    // Without it the peak is that of the whole program so far, which is still an upper bound.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Bytes held at most since then; `None` where the system doesn't say.
pub(crate) fn peak() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(1024 * kib)
}
