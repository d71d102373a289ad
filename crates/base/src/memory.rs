//! How much memory the program may take: a share of what the machine has, what the process is allowed, or what was asked for.

use std::fs;
use std::sync::atomic::{AtomicU64, Ordering};

use sysinfo::{MemoryRefreshKind, RefreshKind, System};

/// Share of the machine's memory, or its container's, that the program takes at most unless another limit is asked for: the
/// rest is for the system and for what estimates leave out.
const SHARE: f64 = 0.75;
/// Address space that the program takes before it has read anything, and that of each thread, for which the allocator sets
/// aside 64 MiB. A solve of six views of 320×240 pixels on two threads took between 300 and 400 MiB in all.
const LEAST_SPACE: u64 = 256 << 20;
const THREAD_SPACE: u64 = 72 << 20;

/// What was asked for; zero for nothing.
static ASKED: AtomicU64 = AtomicU64::new(0);

/// Sets the most memory that the program may take, in bytes, in place of a share of the machine's.
pub fn set_limit(bytes: u64) {
    ASKED.store(bytes, Ordering::Relaxed);
}

/// The most memory in bytes that the program may take; `None` where the system doesn't say.
pub fn limit() -> Option<u64> {
    let asked = Some(ASKED.load(Ordering::Relaxed)).filter(|&bytes| bytes > 0);
    let own = asked.or_else(|| machine().map(|bytes| (SHARE * bytes as f64) as u64));
    let space = address_space().map(|bytes| bytes.saturating_sub(LEAST_SPACE));
    own.into_iter().chain(space).min()
}

/// Address space that the program needs to start at all with so many threads, and what it is allowed, if that is less.
pub fn missing_space(threads: usize) -> Option<[u64; 2]> {
    let needed = LEAST_SPACE + THREAD_SPACE * threads as u64;
    let allowed = address_space()?;
    (allowed < needed).then_some([needed, allowed])
}

/// Bytes in words for people, as `--memory` takes them.
pub fn in_words(bytes: u64) -> String {
    let mebibytes = bytes as f64 / f64::from(1 << 20);
    if mebibytes < 1024.0 {
        format!("{}M", mebibytes.ceil())
    } else {
        format!("{:.1}G", mebibytes / 1024.0)
    }
}

/// Bytes stated as a number and a unit: `900M`, `8G` or `8 GiB`, all in powers of 1024.
pub fn parse(text: &str) -> Result<u64, String> {
    let text = text.trim().to_ascii_uppercase();
    let unit = text.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
    let number = &text[..text.len() - unit.len()];
    let power = match unit.trim().trim_end_matches('B').trim_end_matches('I') {
        "" => 0,
        "K" => 1,
        "M" => 2,
        "G" => 3,
        "T" => 4,
        _ => return Err("write a number and K, M, G or T, as 8G".to_owned()),
    };
    let bytes = number.parse::<f64>().unwrap_or(0.0) * 1024_f64.powi(power);
    if bytes >= 1.0 && bytes < u64::MAX as f64 {
        Ok(bytes as u64)
    } else {
        Err("it must be a number greater than 0, with its unit, as 8G".to_owned())
    }
}

/// Memory of the machine, or of the container that the program runs in.
fn machine() -> Option<u64> {
    let kind = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
    let system = System::new_with_specifics(kind).ok()?;
    let container = system.cgroup_limits().map(|limits| limits.total_memory);
    let all = Some(system.total_memory()).into_iter().chain(container);
    all.filter(|&bytes| bytes > 0).min()
}

/// Address space that the process is allowed, where that is limited.
fn address_space() -> Option<u64> {
    #[cfg(unix)]
    let limit = rustix::process::getrlimit(rustix::process::Resource::As).current;
    #[cfg(not(unix))]
    let limit = None;
    limit
}

/// Starts counting [`peak`] anew from what is held now, where the system can: on Linux.
pub fn forget_peak() {
    // Without it the peak is that of the whole program so far, which is still an upper bound.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Bytes that the program has held at most; `None` where the system doesn't say.
pub fn peak() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(1024 * kib)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_are_read_as_they_are_written() {
        for (text, bytes) in [
            ("1", 1),
            ("900M", 900 << 20),
            ("1.5g", 3 << 29),
            ("8 GiB", 8 << 30),
            ("2TB", 2 << 40),
        ] {
            assert_eq!(parse(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "-1G", "8X", "0", "nan"] {
            assert!(parse(text).is_err(), "{text}");
        }
        assert_eq!(in_words(900 << 20), "900M");
        assert_eq!(in_words(8 << 30), "8.0G");
    }
}
