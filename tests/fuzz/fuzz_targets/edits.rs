//! Edits of light, applied to two lamps.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use rekindle_relight::{apply, load};
use rekindle_fuzz::{Folder, solution};

static FOLDER: LazyLock<Folder> = LazyLock::new(Folder::capture);

fuzz_target!(|bytes: &[u8]| {
    let path = FOLDER.write("edits.json", bytes);
    let lighting = solution().lighting();
    if let Ok(lighting) = load(&path).and_then(|edits| apply(&edits, &lighting)) {
        assert!(lighting.lamps.iter().all(|lamp| !lamp.flux().is_nan()));
    }
});
