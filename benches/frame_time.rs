//! Frame times of the renderer: `cargo bench --bench frame_time -- [SOLUTION] [WIDTHxHEIGHT]…`.
//!
//! Without a solution the built-in demo is solved first. For every size the object is orbited under one lit node and under
//! an environment, and a lamp is dragged; the times are those until the device is done, the median of many
//! frames. What light needs to be baked is not in them: it happens beside the frames.

#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a benchmark prints its figures"
)]

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow};
use glam::{DAffine3, DQuat, DVec3, Quat, Vec3};
use rekindle_capture::{Camera, Capture, read_cameras, unpack_demo};
use rekindle_estimate::estimate::{EstimateParams, Unobserved};
use rekindle_relight::ViewTransform;
use rekindle_relight::{LampNodes, LatLong, LightNode, Lighting};
use rekindle_render::{Background, FrameRequest, Gpu, Mode, Renderer, Surface};
use rekindle_solution::{Solution, SolveOptions, solve};

/// Frames of each measurement.
const FRAMES: usize = 15;

fn main() -> ExitCode {
    // `cargo bench` and `cargo test --benches` pass flags of their own.
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| !a.starts_with("--"))
        .collect();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("frame_time: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &[String]) -> anyhow::Result<()> {
    let size = |a: &String| {
        a.split_once('x')
            .and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]))
    };
    let mut sizes: Vec<[u32; 2]> = arguments.iter().filter_map(size).collect();
    if sizes.is_empty() {
        sizes = vec![[1280, 720]];
    }
    let folder = arguments.iter().find(|a| size(a).is_none());
    let demo = tempfile::tempdir()?;
    unpack_demo(demo.path())?;
    let (_, camera) =
        read_cameras(&demo.path().join("transforms.json"), DVec3::ZERO)?.swap_remove(0);
    let solution = if let Some(folder) = folder {
        Solution::load(Path::new(folder))?
    } else {
        let capture = Capture::load(demo.path())?;
        let options = SolveOptions {
            estimate: EstimateParams::default(),
            frequency: 70,
            radius: None,
            light_frame: None,
        };
        solve(&capture, &options, 0.0, &mut Unobserved)
            .map_err(|_| anyhow!("the solve was stopped"))?
    };
    let surface = Arc::new(Surface::new(Arc::new(solution)));
    let gpu = Gpu::headless()?;
    println!("adapter: {}", gpu.adapter_name());
    let mut renderer = Renderer::new(gpu)?;
    renderer.set_surface(Arc::clone(&surface))?;
    for [width, height] in sizes {
        let camera = sized(&camera, width, height);
        measure(&mut renderer, &surface, &camera).with_context(|| format!("{width}×{height}"))?;
    }
    Ok(())
}

/// The same view in another size.
fn sized(camera: &Camera, width: u32, height: u32) -> Camera {
    let factor = f64::from(height) / f64::from(camera.height);
    let shift = 0.5 * (f64::from(width) - f64::from(camera.width) * factor);
    Camera {
        width,
        height,
        focal: camera.focal * factor,
        centre: camera.centre * factor + DVec3::new(shift, 0.0, 0.0).truncate(),
        ..camera.clone()
    }
}

fn measure(renderer: &mut Renderer, surface: &Surface, camera: &Camera) -> anyhow::Result<()> {
    let original = surface.solution().lighting();
    let mut times = Vec::new();
    for (name, lighting) in [
        ("one lit node", one_node(&original)),
        ("an environment", sky(&original)),
    ] {
        renderer.set_lighting(&lighting)?;
        let request = request(camera.clone());
        let started = Instant::now();
        renderer.draw_settled(&request)?;
        renderer.gpu().wait()?;
        let settling = started.elapsed();
        let orbit = orbit(renderer, surface, camera, &lighting, false)?;
        let still = still(renderer, &request)?;
        println!(
            "{}×{} {name}: orbiting {} ms, a frame of the still picture {} ms; baked and settled after {:.1} s",
            camera.width,
            camera.height,
            milliseconds(orbit),
            milliseconds(still),
            settling.as_secs_f64()
        );
        times.push(orbit);
    }
    renderer.set_lighting(&original)?;
    renderer.draw_settled(&request(camera.clone()))?;
    let idle = orbit(renderer, surface, camera, &original, false)?;
    let dragged = orbit(renderer, surface, camera, &original, true)?;
    println!(
        "{}×{} as captured: orbiting {} ms, dragging a lamp {} ms, {:.0} frames per second",
        camera.width,
        camera.height,
        milliseconds(idle),
        milliseconds(dragged),
        1.0 / dragged.as_secs_f64()
    );
    println!(
        "{}×{}: environment ÷ one node {:.2} (at most 1.3 is wanted), dragging ÷ orbiting {:.2} (at most 2)",
        camera.width,
        camera.height,
        times[1].as_secs_f64() / times[0].as_secs_f64(),
        dragged.as_secs_f64() / idle.as_secs_f64()
    );
    Ok(())
}

/// Median time of a frame while the camera goes round, or a lamp before a camera that stands still.
fn orbit(
    renderer: &mut Renderer,
    surface: &Surface,
    camera: &Camera,
    lighting: &Lighting,
    drag: bool,
) -> anyhow::Result<Duration> {
    let mut lighting = lighting.clone();
    let mut request = request(camera.clone());
    request.dragging = drag;
    let centre = surface.solution().mesh.centre().as_dvec3();
    let mut times = Vec::new();
    for frame in 0..=FRAMES {
        if drag && let Some(lamp) = lighting.lamps.first_mut() {
            let to = Quat::from_axis_angle(surface.solution().grid.up, 0.02) * lamp.direction;
            lamp.turn_towards(to);
        } else {
            let turn = DQuat::from_rotation_y(0.02);
            let about = DAffine3::from_translation(centre)
                * DAffine3::from_quat(turn)
                * DAffine3::from_translation(-centre);
            request.camera.world_from_camera = about * request.camera.world_from_camera;
        }
        let started = Instant::now();
        renderer.set_lighting(&lighting)?;
        renderer.draw(&request)?;
        renderer.gpu().wait()?;
        // The first has shaders to compile.
        if frame > 0 {
            times.push(started.elapsed());
        }
    }
    Ok(median(times))
}

/// Median time of the frames that refine a still picture.
fn still(renderer: &mut Renderer, request: &FrameRequest) -> anyhow::Result<Duration> {
    renderer.draw(request)?;
    renderer.gpu().wait()?;
    let mut times = Vec::new();
    for _ in 0..FRAMES {
        let started = Instant::now();
        renderer.draw(request)?;
        renderer.gpu().wait()?;
        times.push(started.elapsed());
    }
    Ok(median(times))
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times[times.len() / 2]
}

fn milliseconds(time: Duration) -> String {
    format!("{:.1}", time.as_secs_f64() * 1e3)
}

fn request(camera: Camera) -> FrameRequest {
    FrameRequest {
        camera,
        mode: Mode::Beauty,
        exposure_ev: 0.0,
        transform: ViewTransform::Agx,
        background: Background::Colour([0.1; 3]),
        dragging: false,
        quick: false,
    }
}

fn no_light(original: &Lighting) -> Lighting {
    Lighting {
        lamps: Vec::new(),
        remainder: Vec::new(),
        environment: None,
        ambient: Vec3::ZERO,
        ..original.clone()
    }
}

fn one_node(original: &Lighting) -> Lighting {
    let node = LightNode {
        direction: original.up,
        radiance: Vec3::ONE,
        solid_angle: 0.01,
    };
    Lighting {
        lamps: LampNodes::new(vec![node], None).into_iter().collect(),
        ..no_light(original)
    }
}

/// A sky, as a light probe comes.
fn sky(original: &Lighting) -> Lighting {
    let radiance = |direction: Vec3| {
        Vec3::new(0.6, 0.8, 1.0) * (1.2 + (3.0 * direction.x).sin() * (5.0 * direction.z).cos())
    };
    Lighting {
        environment: LatLong::of(256, radiance).environment(Quat::IDENTITY, Vec3::ONE),
        ..no_light(original)
    }
}
