//! Tables of exposures, and the merging of what they state.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use rekindle_capture::Photos;
use rekindle_fuzz::Folder;

static FOLDER: LazyLock<Folder> = LazyLock::new(|| {
    let folder = Folder::new();
    for name in ["a.png", "b.png", "c.png"] {
        folder.copy("capture/rgba8.png", &format!("photographs/{name}"));
    }
    folder
});

fuzz_target!(|bytes: &[u8]| {
    let table = FOLDER.write("exposures.csv", bytes);
    let photographs = FOLDER.path().join("photographs");
    let Ok(photos) = Photos::find(&[photographs], Some(&table)) else {
        return;
    };
    if let Ok(response) = photos.response() {
        for group in 0..photos.groups.len() {
            let _ = photos.merge(group, &response);
        }
    }
});
