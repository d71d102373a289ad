//! What the targets share: a folder with the file that is fuzzed, and a limit on memory.

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::{env, fs, process};

use glam::{DAffine3, DVec2, DVec3, Vec2, Vec3};
use rekindle_capture::{Camera, Capture, Distortion, LightFrame, Mesh};
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_estimate::estimate::{Diagnostics, Method};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_solution::{Fit, Skipped, Solution, SolutionLamp};
use rekindle_scene::surface::Atlas;

/// Memory that no file of a few kilobytes may make a reader ask for, in bytes: what a picture takes that is nothing but white.
const LIMIT: usize = 4 << 30;

/// The system's allocator, which ends the process when more than the limit is asked for: libFuzzer sees only what is
/// touched, and the address sanitizer, which would see it, makes everything slow.
struct Limited;

static ALLOCATED: AtomicUsize = AtomicUsize::new(0);

#[global_allocator]
static ALLOCATOR: Limited = Limited;

impl Limited {
    fn add(size: usize) {
        if ALLOCATED.fetch_add(size, Ordering::Relaxed) + size > LIMIT {
            ALLOCATED.store(0, Ordering::Relaxed);
            eprintln!("{size} bytes more are asked for, which makes more than {LIMIT}");
            process::abort();
        }
    }
}

// SAFETY: everything is passed on to the system's allocator.
unsafe impl GlobalAlloc for Limited {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Self::add(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        Self::add(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        ALLOCATED.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// A folder in the temporary one, of this process.
pub struct Folder(PathBuf);

impl Folder {
    /// A new folder.
    pub fn new() -> Self {
        let path = env::temp_dir().join(format!("rekindle-fuzz-{}", process::id()));
        fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    /// A capture of one small picture of a box.
    pub fn capture() -> Self {
        let folder = Self::new();
        folder.copy("capture/rgba_half_zip.exr", "a.exr");
        folder.copy("capture/rgba8.png", "a.png");
        folder.copy("capture/rgba8.png", "b.png");
        folder.copy("capture/box.obj", "box.obj");
        folder
    }

    /// Puts a file of `tests/data` here.
    pub fn copy(&self, data: &str, name: &str) {
        let from = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../data")
            .join(data);
        self.write(name, &fs::read(from).expect("test data"));
    }

    /// Writes a file, and says where.
    pub fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.join(name);
        let parent = path.parent().expect("a folder");
        fs::create_dir_all(parent).expect("a folder");
        fs::write(&path, bytes).expect("written");
        path
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Default for Folder {
    fn default() -> Self {
        Self::new()
    }
}

/// Reads a capture whose mesh is a file of these bytes.
pub fn read_mesh(folder: &Folder, name: &str, bytes: &[u8]) {
    let manifest = format!(
        r#"{{"fl_x": 8, "mesh_path": "{name}", "frames": [{{"file_path": "a.exr",
            "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]]}}]}}"#
    );
    folder.write("transforms.json", manifest.as_bytes());
    folder.write(name, bytes);
    if let Ok(capture) = Capture::load_unplaced(folder.path()) {
        let mesh = &capture.mesh;
        let count = mesh.positions.len();
        assert!(
            mesh.triangles
                .iter()
                .flatten()
                .all(|&v| (v as usize) < count)
        );
        assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-3));
    }
}

/// A solution of one triangle and two lamps.
pub fn solution() -> Solution {
    let grid = HemisphereGrid::new(4, Vec3::Y, Some(3.0), Vec3::ZERO);
    let mut radiance = vec![[0.0; 3]; grid.directions.len()];
    let lamps = [5, 20].map(|node| {
        radiance[node] = [1.0, 2.0, 3.0];
        SolutionLamp {
            name: format!("Light {node}"),
            direction: grid.directions[node],
            flux: Vec3::new(1.0, 2.0, 3.0),
            angular_radius: 0.05,
            nodes: vec![node as u32],
        }
    });
    let camera = Camera {
        width: 64,
        height: 48,
        focal: DVec2::splat(70.0),
        centre: DVec2::new(32.0, 24.0),
        distortion: Distortion::default(),
        world_from_camera: DAffine3::from_translation(DVec3::Z),
    };
    let corners = [[0.5, 0.5], [3.5, 0.5], [0.5, 3.5]].map(Vec2::from);
    Solution {
        name: "seed".to_owned(),
        method: Method::default(),
        brdf: Some(Brdf::new(SpecularModel::Beckmann, 0.1)),
        chosen_because: String::new(),
        corrections: Vec::new(),
        sigma_interval95: Some([0.09, 0.11]),
        known_light: None,
        light_frame: LightFrame::World,
        grid,
        radiance,
        lamps: lamps.into(),
        ambient: Vec3::splat(0.01),
        diagnostics: Diagnostics::default(),
        fit: Fit::default(),
        skipped: Skipped::default(),
        timings: Vec::new(),
        convergence: Vec::new(),
        cameras: vec![("a.exr".to_owned(), camera)],
        mesh: Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Z],
            normals: vec![Vec3::Y; 3],
            uvs: Vec::new(),
            triangles: vec![[0, 2, 1]],
        },
        atlas: Atlas::from_corners(4, 4, vec![corners], false),
        diffuse: vec![[0.1; 3]; 16],
        albedo: vec![[0.2; 3]; 16],
        confidence: vec![1.0; 16],
        gloss: None,
        pictures: Vec::new(),
    }
}

/// Puts the files of a folder among the seeds.
pub fn keep_seeds(folder: &Path) {
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus/made");
    fs::create_dir_all(&seeds).expect("a folder");
    for entry in fs::read_dir(folder).expect("a folder").flatten() {
        if entry.path().is_file() {
            fs::copy(entry.path(), seeds.join(entry.file_name())).expect("copied");
        }
    }
}
