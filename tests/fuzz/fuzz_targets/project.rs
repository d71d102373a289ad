//! Project files of the window.

#![no_main]

use std::sync::{Arc, LazyLock};

use libfuzzer_sys::fuzz_target;
use rekindle_studio::Document;
use rekindle_fuzz::{Folder, keep_seeds, solution};

static FOLDER: LazyLock<Folder> = LazyLock::new(Folder::new);

fuzz_target!(
    init: {
        let folder = FOLDER.path().join("solution");
        solution().save(&folder).expect("saved");
        let mut document = Document::new(Arc::new(solution()), Some(folder));
        document.save(&FOLDER.path().join("seeds/project.rekindle")).expect("saved");
        keep_seeds(&FOLDER.path().join("seeds"));
    },
    |bytes: &[u8]| {
        let path = FOLDER.write("a.rekindle", bytes);
        if let Ok((document, _)) = Document::open(&path) {
            let lamps = document.light().lighting.lamps;
            assert!(lamps.iter().all(|lamp| !lamp.flux().is_nan()));
        }
    }
);
