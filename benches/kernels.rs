//! What a solve spends its time in, piece by piece, on the built-in demo: `cargo bench --bench kernels -- [PART OF A NAME]…`.
//!
//! For each kernel the median time of a call and the quartiles are printed. No framework: those looked at change the
//! features of `clap`, so that the library would be built once more for them, or bring some twenty crates.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::hint::black_box;
use std::sync::LazyLock;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use glam::Vec3;
use rekindle_base::math::nnls::{self, NnlsParams};
use rekindle_base::math::random::Random;
use rekindle_capture::{Capture, View, unpack_demo};
use rekindle_estimate::estimate::cells::{Cell, Pyramid};
use rekindle_estimate::estimate::design::{Design, NormalEquations};
use rekindle_estimate::estimate::lobes::CellLobes;
use rekindle_estimate::estimate::observations::{Observations, Sampling, Seen, pixels_inside};
use rekindle_estimate::estimate::visibility::SeenCells;
use rekindle_estimate::estimate::workspace::Workspace;
use rekindle_relight::{LampNodes, Lighting, Scene, Shader, TriangleShares, texel_irradiance};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};
use rekindle_scene::shortcuts::Shortcuts;
use rekindle_scene::surface::{Atlas, Occluder, ViewSurface, minimum_texture, wanted_density};

/// Frequency of the hemisphere, and of its coarsest cells.
const FREQUENCIES: [u32; 2] = [70, 11];
/// Surface points with equations.
const POINTS: usize = 1500;
/// Rays that are cast together.
const RAYS: u64 = 4096;
/// Calls that are timed together take at least this long.
const BATCH: Duration = Duration::from_millis(5);
/// Batches of a kernel: so many at least, and at most unless that takes longer.
const FEWEST: usize = 5;
const MOST: usize = 100;
const ENOUGH: Duration = Duration::from_secs(2);

const BRDF: Brdf = Brdf::new(SpecularModel::Beckmann, 0.08);

static WORKSPACE: Workspace = Workspace::new();
static NEVER: AtomicBool = AtomicBool::new(false);
static SHORTCUTS: LazyLock<Shortcuts> = LazyLock::new(Shortcuts::default);
static DEMO: LazyLock<Demo> = LazyLock::new(Demo::new);
static OBSERVATIONS: LazyLock<Observations> = LazyLock::new(observations);
static CELLS: LazyLock<Vec<Cell>> = LazyLock::new(|| DEMO.pyramid.roots());

/// The demo, looked at.
struct Demo {
    capture: Capture,
    occluder: Occluder,
    surfaces: Vec<ViewSurface>,
    atlas: Atlas,
    pyramid: Pyramid,
}

impl Demo {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder can be made");
        unpack_demo(folder.path()).expect("the demo can be written");
        let capture = Capture::load(folder.path()).expect("the demo is sound");
        let occluder = Occluder::new(&capture.mesh);
        let see = |view: &View| ViewSurface::new(&capture.mesh, &occluder, &view.camera);
        let surfaces: Vec<ViewSurface> = capture.views.iter().map(see).collect();
        let density = wanted_density(&capture.mesh, &capture.views, &surfaces, 1.0);
        let grid = HemisphereGrid::new(
            FREQUENCIES[0],
            capture.light_hemisphere.up.as_vec3(),
            None,
            capture.mesh.centre(),
        );
        Self {
            atlas: Atlas::new(&capture.mesh, &density),
            pyramid: Pyramid::new(&grid, FREQUENCIES[1]),
            surfaces,
            occluder,
            capture,
        }
    }
}

/// Runs kernels whose names are asked for, and prints how long they take.
struct Bencher {
    /// Parts of names; empty for all.
    wanted: Vec<String>,
}

impl Bencher {
    /// Times a kernel: in batches that take long enough for the clock, until it is known or enough time has passed.
    fn time<T>(&self, name: &str, mut kernel: impl FnMut() -> T) {
        if !self.wanted.is_empty() && !self.wanted.iter().any(|part| name.contains(part)) {
            return;
        }
        let mut calls_of = |calls: u32| {
            let started = Instant::now();
            for _ in 0..calls {
                black_box(kernel());
            }
            started.elapsed()
        };
        let mut calls = 1;
        while calls_of(calls) < BATCH {
            calls *= 2;
        }
        let started = Instant::now();
        let mut seconds = Vec::new();
        while seconds.len() < FEWEST || (seconds.len() < MOST && started.elapsed() < ENOUGH) {
            seconds.push(calls_of(calls).as_secs_f64() / f64::from(calls));
        }
        seconds.sort_by(f64::total_cmp);
        let [low, middle, high] = [1, 2, 3].map(|k| seconds[k * seconds.len() / 4]);
        println!(
            "{name:<44} {}  ({} to {})",
            shown(middle),
            shown(low),
            shown(high)
        );
    }
}

fn shown(seconds: f64) -> String {
    if seconds < 1e-3 {
        format!("{:8.2} µs", 1e6 * seconds)
    } else {
        format!("{:8.2} ms", 1e3 * seconds)
    }
}

fn main() {
    // `cargo bench` passes flags of its own.
    let wanted = std::env::args().skip(1).filter(|a| !a.starts_with("--"));
    let bencher = Bencher {
        wanted: wanted.collect(),
    };
    lobes(&bencher);
    equations_of_cells(&bencher);
    rays(&bencher);
    textures(&bencher);
}

fn observations() -> Observations {
    let seen = Seen {
        mesh: &DEMO.capture.mesh,
        views: &DEMO.capture.views,
        surfaces: &DEMO.surfaces,
        pixels: pixels_inside(&DEMO.surfaces),
        parts: None,
        mirrored: None,
        turning: None,
    };
    let sampling = Sampling {
        candidates: POINTS,
        limit: POINTS,
        keep: &|_, _, _| true,
        scale: None,
        stop: &NEVER,
    };
    Observations::gather(&seen, &sampling)
}

fn equations() -> NormalEquations {
    let design = Design {
        observations: &OBSERVATIONS,
        geometry: DEMO.pyramid.geometry(&CELLS),
        near: None,
        seen: SeenCells::default(),
        diffuse_known: false,
        shortcuts: &SHORTCUTS,
        workspace: &WORKSPACE,
        stop: &NEVER,
    };
    design.normal_equations(&BRDF, &vec![1.0; OBSERVATIONS.rows.len()])
}

/// One row of the matrix: all coarsest cells at a point, in a view.
fn lobes(bencher: &Bencher) {
    let geometry = DEMO.pyramid.geometry(&CELLS);
    let lobes = CellLobes::new(&BRDF, Gloss::MAIN, &geometry, None, false);
    let point = &OBSERVATIONS.points[0];
    let to_camera = OBSERVATIONS.rows[point.rows.start].to_camera;
    let terms = BRDF.view_terms(point.normal, to_camera);
    let mut light = lobes.point();
    let (mut value, mut by_sigma) = (vec![0.0; CELLS.len()], vec![0.0; CELLS.len()]);
    bencher.time("light of the coarsest cells at a point", || {
        lobes.light(black_box(point.position), point.normal, None, &mut light);
    });
    bencher.time("row of lobes", || {
        lobes.row(&terms, black_box(&light), &mut value, None);
    });
    bencher.time("row of lobes with derivatives", || {
        lobes.row(&terms, black_box(&light), &mut value, Some(&mut by_sigma));
    });
}

/// From photographs to the radiance of the coarsest cells.
fn equations_of_cells(bencher: &Bencher) {
    bencher.time("points with their rows", observations);
    bencher.time("normal equations", equations);
    let mut equations = equations();
    for i in 0..CELLS.len() {
        // Cells that no row sees stay dark.
        equations.gram[(i, i)] += 1e-6;
    }
    bencher.time("non-negative least squares", || {
        let mut x = vec![0.0; CELLS.len()];
        let params = NnlsParams::default();
        nnls::solve(equations.gram.as_ref(), &equations.rhs[0], &mut x, &params);
        x
    });
}

/// Rays from the surface in all directions, and those of a view.
fn rays(bencher: &Bencher) {
    let (mesh, occluder) = (&DEMO.capture.mesh, &DEMO.occluder);
    let random = Random::new(1, 0);
    let ray = |i: u64| {
        let triangle = i * 7919 % mesh.triangles.len() as u64;
        let direction = random.direction(i).as_vec3();
        let corner = mesh.corners(triangle as u32)[0];
        (occluder.offset_origin(corner, direction), direction)
    };
    let rays: Vec<(Vec3, Vec3)> = (0..RAYS).map(ray).collect();
    bencher.time("what 4096 rays meet", || {
        let meets = |(from, to): &&(Vec3, Vec3)| occluder.hit(*from, *to).is_some();
        rays.iter().filter(meets).count()
    });
    bencher.time("whether 4096 rays are blocked", || {
        let blocked = |(from, to): &&(Vec3, Vec3)| occluder.occluded(*from, *to, f32::INFINITY);
        rays.iter().filter(blocked).count()
    });
    bencher.time("whether 512 times 8 rays of a lamp are blocked", || {
        let towards = |to: Vec3, i: u8| {
            let aside = 0.05 * f32::from(i).sin();
            (to + Vec3::splat(aside)).normalize_or_zero()
        };
        let blocked = |(from, to): &(Vec3, Vec3)| {
            let rays = (0..8).map(|i| ((), towards(*to, i), f32::INFINITY));
            let mut count = 0;
            occluder.each_occluded(*from, rays, |(), blocked| count += u32::from(blocked));
            count
        };
        rays.iter().step_by(8).map(blocked).sum::<u32>()
    });
    let camera = &DEMO.capture.views[0].camera;
    bencher.time("what a view sees", || {
        ViewSurface::new(mesh, occluder, camera)
    });
}

/// What is made of all texels.
fn textures(bencher: &Bencher) {
    let capture = &DEMO.capture;
    bencher.time("least of all views for each texel", || {
        minimum_texture(&capture.mesh, &DEMO.atlas, &capture.views, &DEMO.surfaces)
    });
    let direction = Vec3::new(0.3, 0.8, 0.5).normalize_or(Vec3::Y);
    let lighting = Lighting {
        lamps: vec![LampNodes::disc_of(64, direction, Vec3::ONE, 0.05, None)],
        remainder: Vec::new(),
        environment: None,
        ambient: Vec3::ZERO,
        centre: capture.mesh.centre(),
        radius: None,
        up: Vec3::Y,
        specular_scale: Vec3::ONE,
    };
    let shader = Shader::new(&DEMO.occluder, Some(BRDF), &lighting);
    let scene = Scene {
        mesh: &capture.mesh,
        occluder: &DEMO.occluder,
        brdf: Some(BRDF),
        gloss: None,
        surroundings: None,
    };
    bencher.time("irradiance of all texels under a lamp", || {
        let triangles = TriangleShares::new(&capture.mesh, &DEMO.atlas, &shader);
        texel_irradiance(&scene, &DEMO.atlas, &shader, &triangles)
    });
}
