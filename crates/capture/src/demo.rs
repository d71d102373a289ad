//! The built-in capture: Spot by Keenan Crane (CC0), rendered under known light.

use std::fs;
use std::io;
use std::path::Path;

/// What the built-in capture is called.
pub const DEMO: &str = "demo";

const FILES: [(&str, &[u8]); 8] = [
    (
        "transforms.json",
        include_bytes!("../../../assets/demo/transforms.json"),
    ),
    ("mesh.obj", include_bytes!("../../../assets/demo/mesh.obj")),
    (
        "images/view_000.exr",
        include_bytes!("../../../assets/demo/images/view_000.exr"),
    ),
    (
        "images/view_001.exr",
        include_bytes!("../../../assets/demo/images/view_001.exr"),
    ),
    (
        "images/view_002.exr",
        include_bytes!("../../../assets/demo/images/view_002.exr"),
    ),
    (
        "images/view_003.exr",
        include_bytes!("../../../assets/demo/images/view_003.exr"),
    ),
    (
        "images/view_004.exr",
        include_bytes!("../../../assets/demo/images/view_004.exr"),
    ),
    (
        "images/view_005.exr",
        include_bytes!("../../../assets/demo/images/view_005.exr"),
    ),
];

/// Names of the built-in capture's files.
pub fn demo_names() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|(name, _)| *name)
}

/// Writes the built-in capture's files into a folder, which is made.
pub fn unpack_demo(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder.join("images"))?;
    FILES
        .iter()
        .try_for_each(|(name, bytes)| fs::write(folder.join(name), bytes))
}
