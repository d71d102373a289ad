//! RealityCapture's table of cameras.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use rekindle_capture::Capture;
use rekindle_fuzz::Folder;

static FOLDER: LazyLock<Folder> = LazyLock::new(Folder::capture);

fuzz_target!(|bytes: &[u8]| {
    FOLDER.write("cameras.csv", bytes);
    let _ = Capture::load(FOLDER.path());
});
