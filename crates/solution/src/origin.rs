//! Would a solve give what is there already?

use std::hash::Hash;
use std::path::Path;

use siphasher::sip128::{Hasher128, SipHasher13};

use super::folder::read_manifest;
use super::format::VERSION;
use super::{LightProbe, Solution, SolveOptions};
use rekindle_capture::Capture;

/// A digest of what a solution is made of: the capture, the options, the light where it is given, the program. Hexadecimal.
pub fn origin(capture: &Capture, options: &SolveOptions, light: Option<&LightProbe>) -> String {
    let mut hasher = SipHasher13::new();
    capture.fingerprint().hash(&mut hasher);
    // Options are plain values, all of which this shows.
    format!("{options:?}").hash(&mut hasher);
    light.hash(&mut hasher);
    (VERSION, env!("CARGO_PKG_VERSION")).hash(&mut hasher);
    program().hash(&mut hasher);
    format!("{:032x}", hasher.finish128().as_u128())
}

/// Size and time of the running program: another build may find something else.
fn program() -> Option<(u64, std::time::SystemTime)> {
    let file = std::env::current_exe().and_then(std::fs::metadata).ok()?;
    Some((file.len(), file.modified().ok()?))
}

impl Solution {
    /// The solution in a folder, if there is one, it is whole, and `origin` says its [`origin`]: a look at every pixel, for
    /// which there must be a reason.
    pub fn load_of_origin(folder: &Path, origin: impl FnOnce() -> String) -> Option<Self> {
        let manifest = read_manifest(folder, &folder.join("solution.json")).ok()?;
        (manifest.origin == origin())
            .then(|| Self::load(folder).ok())
            .flatten()
    }
}
