//! Points at which tests end the program, as a kill would.

/// Names the point at which a test's child process ends.
#[cfg(test)]
pub(super) const KILL_AT: &str = "REKINDLE_TEST_KILL_AT";

/// Ends the program here if a test asks for it.
#[cfg(test)]
pub(super) fn point(name: &str) {
    if std::env::var(KILL_AT).is_ok_and(|at| at == name) {
        std::process::abort();
    }
}

/// Nothing outside of tests.
#[cfg(not(test))]
pub(super) fn point(_: &str) {}
