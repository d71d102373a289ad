//! Meshes in PLY files.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use rekindle_fuzz::{Folder, read_mesh};

static FOLDER: LazyLock<Folder> = LazyLock::new(Folder::capture);

fuzz_target!(|bytes: &[u8]| read_mesh(&FOLDER, "mesh.ply", bytes));
