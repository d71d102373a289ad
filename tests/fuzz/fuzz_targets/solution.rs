//! Solutions: the bytes in the place of the file that they are most like.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use rekindle_solution::Solution;
use rekindle_fuzz::{Folder, keep_seeds, solution};

/// Files by what they hold; pictures of colours and of confidence are read by different code.
const FILES: [(&[u8], &[&str]); 5] = [
    (b"\x76\x2f\x31\x01", &["albedo.exr", "confidence.exr"]),
    (b"ply", &["mesh.ply"]),
    (b"\"format\"", &["solution.json"]),
    (b"\"transform_matrix\"", &["cameras.json"]),
    (b"", &["nodes.json"]),
];

static FOLDER: LazyLock<Folder> = LazyLock::new(Folder::new);

fuzz_target!(
    init: {
        let folder = FOLDER.path().join("solution");
        solution().save(&folder).expect("saved");
        keep_seeds(&folder);
    },
    |bytes: &[u8]| {
        let holds = |part: &[u8]| part.is_empty() || bytes.windows(part.len()).any(|w| w == part);
        let (_, names) = FILES.iter().find(|(part, _)| holds(part)).expect("the last one fits");
        for name in *names {
            let name = format!("solution/{name}");
            let whole = std::fs::read(FOLDER.path().join(&name)).expect("read");
            FOLDER.write(&name, bytes);
            if let Ok(solution) = Solution::load(&FOLDER.path().join("solution")) {
                assert_eq!(solution.radiance.len(), solution.grid.directions.len());
                let _ = (solution.lighting(), solution.summary());
            }
            FOLDER.write(&name, &whole);
        }
    }
);
