//! What can be wrong with a capture: every message names the file, the field or line, what is wrong with it
//! and what to do.

use std::io;
use std::path::PathBuf;

/// Why a capture could not be read.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The path given does not exist.
    #[error("{path}: no such file or folder; give the folder of a capture or its transforms.json")]
    NoSuchFolder {
        /// The path as it was given.
        path: PathBuf,
    },
    /// The folder holds no manifest.
    #[error("{path}: no transforms.json in this folder; {advice}")]
    NoManifest {
        /// The folder.
        path: PathBuf,
        /// What to do, which depends on what lies there instead.
        advice: String,
    },
    /// The operating system could not read a file.
    #[error("{path}: cannot be read: {source}; check that it is a file and may be read")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// The manifest is not JSON.
    #[error(
        "{path}: line {line}, column {column}: broken JSON: {problem}; correct it or write it anew"
    )]
    BrokenJson {
        /// The manifest.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What the parser expected.
        problem: String,
    },
    /// A field of the manifest is missing or makes no sense.
    #[error("{path}: {field} {problem}; {advice}")]
    Field {
        /// The manifest.
        path: PathBuf,
        /// The field, as `frames[3].transform_matrix`.
        field: String,
        /// What is wrong with it.
        problem: String,
        /// What to do.
        advice: String,
    },
    /// An image or mask that the manifest names does not exist.
    #[error("{path}: no such image ({field} names it); put it there or correct the name")]
    ImageMissing {
        /// The file.
        path: PathBuf,
        /// The field of the manifest that names it.
        field: String,
    },
    /// An image is truncated, damaged or of an unknown format.
    #[error("{path}: the image cannot be decoded: {problem}; {advice}")]
    ImageBroken {
        /// The file.
        path: PathBuf,
        /// What the decoder says.
        problem: String,
        /// What to do.
        advice: String,
    },
    /// A picture is no light probe.
    #[error("{path}: the picture is no light probe: {problem}; {advice}")]
    NoProbe {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// What to do.
        advice: String,
    },
    /// An image has another size than stated.
    #[error(
        "{path}: the image is {}×{} pixels, but {stated_by} says {}×{}; correct the numbers there or use the image they belong to",
        found.0, found.1, stated.0, stated.1
    )]
    ImageSize {
        /// The file.
        path: PathBuf,
        /// Width and height found.
        found: (u32, u32),
        /// Width and height expected.
        stated: (u32, u32),
        /// Where the expectation comes from.
        stated_by: String,
    },
    /// A header announces an image too large to be one.
    #[error(
        "{path}: the header announces {width}×{height} pixels, more than {limit} million; the file is damaged, or scale it down"
    )]
    ImageTooLarge {
        /// The file.
        path: PathBuf,
        /// Width in the header.
        width: u64,
        /// Height in the header.
        height: u64,
        /// Largest number of pixels accepted, in millions.
        limit: u64,
    },
    /// An EXR file without red, green and blue.
    #[error(
        "{path}: the EXR file has no R, G and B channels (it has {channels}); save it as RGB or RGBA"
    )]
    ImageChannels {
        /// The file.
        path: PathBuf,
        /// The channels there are.
        channels: String,
    },
    /// No pixel of an image can be used.
    #[error("{path}: {problem}; {advice}")]
    ImageUseless {
        /// The file.
        path: PathBuf,
        /// Why.
        problem: String,
        /// What to do.
        advice: String,
    },
    /// The exposure of a file of a bracket contradicts its pixels.
    #[error("{path}: {problem}; {advice}")]
    Exposure {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What to do.
        advice: String,
    },
    /// There is no mesh.
    #[error("{path}: {problem}; {advice}")]
    MeshMissing {
        /// The file, or the folder where it was looked for.
        path: PathBuf,
        /// What is missing.
        problem: String,
        /// What to do.
        advice: String,
    },
    /// A mesh file that makes no sense at one place.
    #[error("{path}: {place}: {problem}; export the mesh anew")]
    MeshBroken {
        /// The file.
        path: PathBuf,
        /// The line or element.
        place: String,
        /// What is wrong there.
        problem: String,
    },
    /// A mesh without triangles.
    #[error("{path}: the mesh is empty: {problem}; export the surface as triangles")]
    MeshEmpty {
        /// The file.
        path: PathBuf,
        /// What was found instead.
        problem: String,
    },
    /// The photographs would take more memory than the program may.
    #[error(
        "{path}: its {views} views of {megapixels:.1} megapixels together would take about {needed} of memory, and {limit} may be taken; scale the photographs down, leave views out, or allow more with --memory"
    )]
    Memory {
        /// The manifest.
        path: PathBuf,
        /// Number of views.
        views: usize,
        /// Their pixels together, in millions.
        megapixels: f64,
        /// What would be taken.
        needed: String,
        /// What may be taken.
        limit: String,
    },
    /// No camera sees the mesh.
    #[error(
        "{path}: no camera sees the mesh: it lies outside all images or is smaller than a pixel there; check that cameras and mesh are in the same coordinate frame and units, and that the matrices are camera-to-world with OpenGL axes; rekindle align finds the mesh's place if the images have alpha or masks"
    )]
    MeshUnseen {
        /// The mesh file.
        path: PathBuf,
    },
}
