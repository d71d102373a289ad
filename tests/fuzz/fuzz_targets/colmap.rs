//! COLMAP's models: the bytes in the place of each file that is read, the other files being as COLMAP wrote them.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use rekindle_capture::read_cameras;
use rekindle_fuzz::Folder;

/// Each kind of model with its files.
const MODELS: [(&str, [&str; 2]); 2] = [
    ("text", ["cameras.txt", "images.txt"]),
    ("binary", ["cameras.bin", "images.bin"]),
];

static FOLDER: LazyLock<Folder> = LazyLock::new(|| {
    let folder = Folder::new();
    for (kind, files) in MODELS {
        for file in files {
            folder.copy(&format!("colmap/{kind}/{file}"), &format!("{kind}/{file}"));
        }
    }
    folder
});

fuzz_target!(|bytes: &[u8]| {
    for (kind, files) in MODELS {
        for file in files {
            let name = format!("{kind}/{file}");
            FOLDER.write(&name, bytes);
            let _ = read_cameras(&FOLDER.path().join(kind));
            FOLDER.copy(&format!("colmap/{name}"), &name);
        }
    }
});
