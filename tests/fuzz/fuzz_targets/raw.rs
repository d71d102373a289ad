//! Raw files of cameras, and the exposures that they state.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use rekindle_capture::{Photos, read_covered};
use rekindle_fuzz::Folder;

static FOLDER: LazyLock<Folder> = LazyLock::new(Folder::new);

fuzz_target!(|bytes: &[u8]| {
    let path = FOLDER.write("picture.dng", bytes);
    if let Ok(picture) = read_covered(&path) {
        let pixels = picture.width as usize * picture.height as usize;
        assert_eq!(picture.radiance.len(), pixels);
    }
    let _ = Photos::find(&[path], None);
});
