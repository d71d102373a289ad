//! The graphics device against the reference renderer. A missing adapter is a failure: a software driver will do.

use std::sync::{Arc, OnceLock};

use glam::{DVec3, Quat, Vec3, Vec4};

use super::*;
use rekindle_capture::{Camera, Distortion, LightFrame, Mesh};
use rekindle_estimate::estimate::{Diagnostics, Method};
use rekindle_output::export;
use rekindle_relight::ViewTransform;
use rekindle_relight::{
    Interreflection, LatLong, Lighting, Scene, Shader, TriangleShares, texel_irradiance,
};
use rekindle_scene::hemisphere::{HemisphereGrid, srgb};
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};
use rekindle_scene::surface::fixtures::{bumpy_sphere, camera};
use rekindle_scene::surface::{Atlas, GlossTexture, Occluder};
use rekindle_solution::{Fit, Skipped, Solution, SolutionLamp};

const PAPER: Brdf = Brdf::new(SpecularModel::Paper, 0.12);
const GGX: Brdf = Brdf::new(SpecularModel::Ggx, 0.12);
const METAL: Brdf = Brdf::new(SpecularModel::Metal, 0.12);
const PLASTIC: Brdf = Brdf::new(SpecularModel::Beckmann, 0.12);

fn gpu() -> Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| Gpu::headless().expect("a graphics adapter; Mesa's software driver will do"))
        .clone()
}

/// Smooth colours that differ from place to place.
fn paint(position: Vec3) -> Vec3 {
    0.5 + 0.35
        * Vec3::new(
            (3.0 * position.x).sin(),
            (4.0 * position.y).cos(),
            (5.0 * position.z).sin(),
        )
}

/// A bumpy sphere with two lamps, as a solve would have left it.
fn solved(brdf: Option<Brdf>, radius: Option<f32>) -> Solution {
    let mesh = bumpy_sphere(28, 0.12);
    let grid = HemisphereGrid::new(16, Vec3::Y, radius, mesh.centre());
    let mut radiance = vec![[0.0; 3]; grid.directions.len()];
    let mut lamps = Vec::new();
    for (towards, colour) in [
        (Vec3::new(0.6, 0.7, 0.5), Vec3::new(9.0, 8.0, 6.0)),
        (Vec3::new(-0.7, 0.5, 0.6), Vec3::new(2.0, 3.0, 5.0)),
    ] {
        let direction = towards.normalize_or_zero();
        let nodes: Vec<u32> = (0..grid.directions.len() as u32)
            .filter(|&i| grid.directions[i as usize].dot(direction) > 0.09_f32.cos())
            .collect();
        for &i in &nodes {
            radiance[i as usize] = (colour / (nodes.len() as f32 * grid.solid_angle)).to_array();
        }
        lamps.push(SolutionLamp {
            name: String::new(),
            direction,
            flux: colour,
            angular_radius: 0.09,
            nodes,
        });
    }
    let atlas = Atlas::lattice(&mesh, &vec![40.0; mesh.triangles.len()]);
    let mut albedo = vec![[0.0; 3]; atlas.len()];
    // Metals reflect next to nothing diffusely.
    let diffuse = if brdf == Some(METAL) { 0.02 } else { 1.0 };
    for t in &atlas.texels {
        let position = mesh.point(t.triangle, t.barycentric).position;
        albedo[t.index as usize] = (diffuse * paint(position)).to_array();
    }
    let confidence: Vec<f32> = albedo.iter().map(|a| 0.2 + 0.8 * a[0]).collect();
    let mut solution = Solution {
        name: "test".to_owned(),
        method: Method::default(),
        brdf,
        chosen_because: String::new(),
        origin: String::new(),
        corrections: Vec::new(),
        sigma_interval95: None,
        known_light: None,
        light_frame: LightFrame::World,
        grid,
        radiance,
        lamps,
        ambient: Vec3::splat(0.2),
        diagnostics: Diagnostics::default(),
        fit: Fit::default(),
        skipped: Skipped::default(),
        timings: Vec::new(),
        convergence: Vec::new(),
        cameras: Vec::new(),
        confidence,
        diffuse: albedo.clone(),
        albedo,
        mesh,
        atlas,
        gloss: None,
        pictures: Vec::new(),
    };
    solution.diffuse = lit_texture(&solution);
    solution
}

/// Albedo × irradiance under the solution's own light.
fn lit_texture(solution: &Solution) -> Vec<[f32; 3]> {
    let mesh = &solution.mesh;
    let occluder = Occluder::new(mesh);
    let shader = Shader::new(&occluder, solution.brdf, &solution.lighting());
    let scene = Scene {
        mesh,
        occluder: &occluder,
        brdf: solution.brdf,
        gloss: None,
        surroundings: None,
    };
    let triangles = TriangleShares::new(mesh, &solution.atlas, &shader);
    let mut irradiance = texel_irradiance(&scene, &solution.atlas, &shader, &triangles);
    if let Some(light) = Interreflection::new(mesh, &occluder, solution.brdf) {
        let relit = light.of_light(mesh, &shader, &solution.atlas, &solution.albedo);
        for t in &solution.atlas.texels {
            irradiance[t.index as usize] += relit.indirect.at(mesh, t.triangle, t.barycentric);
        }
    }
    let product = |(a, e): (&[f32; 3], &Vec3)| (Vec3::from(*a) * *e).to_array();
    solution
        .albedo
        .iter()
        .zip(&irradiance)
        .map(product)
        .collect()
}

fn view(side: u32) -> Camera {
    camera(DVec3::new(1.2, 1.0, 3.2), DVec3::ZERO, side, side, 1.1)
}

fn request(camera: Camera) -> FrameRequest {
    FrameRequest {
        camera,
        mode: Mode::Beauty,
        exposure_ev: 0.0,
        transform: ViewTransform::Srgb,
        background: Background::Colour([0.0; 3]),
        dragging: false,
        quick: false,
    }
}

fn renderer(solution: Solution) -> (Renderer, Arc<Surface>) {
    let surface = Arc::new(Surface::with_light_texels(Arc::new(solution), 120_000.0));
    let mut renderer = Renderer::new(gpu()).unwrap();
    renderer.set_surface(Arc::clone(&surface)).unwrap();
    (renderer, surface)
}

fn settled(renderer: &mut Renderer, request: &FrameRequest) -> LinearImage {
    renderer.draw_settled(request).unwrap();
    renderer.read_back().unwrap()
}

/// Diffuse and specular radiance and coverage by the reference renderer.
fn reference(solution: &Solution, lighting: &Lighting, camera: &Camera) -> [Vec<[f32; 4]>; 3] {
    let reference = export::Renderer::new(solution);
    let picture = reference.light(lighting).picture(camera);
    let with_alpha = |v: Vec3, i: usize| v.extend(picture.coverage[i]).to_array();
    let all = 0..picture.coverage.len();
    let part = |of: &dyn Fn(usize) -> Vec3| all.clone().map(|i| with_alpha(of(i), i)).collect();
    let (diffuse, specular) = (
        |i: usize| picture.diffuse[i].into(),
        |i: usize| picture.specular[i].into(),
    );
    [
        part(&|i| diffuse(i) + specular(i)),
        part(&diffuse),
        part(&specular),
    ]
}

/// The same of a finer picture, brought to the camera's size: what a surface mirrors of itself the reference traces for every
/// fourth pixel only.
fn fine_reference(solution: &Solution, lighting: &Lighting, camera: &Camera) -> [Vec<[f32; 4]>; 3] {
    const FINER: usize = 4;
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mean = |fine: &Vec<[f32; 4]>, pixel: usize| {
        let (x, y) = (pixel % width * FINER, pixel / width * FINER);
        let rows = (y..y + FINER).map(|y| y * width * FINER + x);
        let block = rows.flat_map(|first| &fine[first..first + FINER]);
        let sum: Vec4 = block.map(|&p| Vec4::from(p)).sum();
        (sum / (FINER * FINER) as f32).to_array()
    };
    let fine = reference(solution, lighting, &camera.supersampled(FINER as u32));
    fine.map(|part| (0..width * height).map(|i| mean(&part, i)).collect())
}

/// PSNR of sRGB-encoded values over the pixels that either covers, dB; white is the expected picture's brightest half
/// percent.
fn psnr(found: &LinearImage, expected: &[[f32; 4]]) -> f64 {
    let covered = |p: &[f32; 4]| p[3] > 0.0;
    let mut means: Vec<f32> = expected
        .iter()
        .filter(|p| covered(p))
        .map(|p| (p[0] + p[1] + p[2]) / 3.0)
        .collect();
    means.sort_by(f32::total_cmp);
    let white = means[means.len() * 995 / 1000];
    let (mut sum, mut count) = (0.0, 0);
    for (a, b) in found.pixels.iter().zip(expected) {
        if covered(a) || covered(b) {
            for channel in 0..3 {
                let encoded = |v: f32| srgb((v / white).clamp(0.0, 1.0));
                sum += f64::from(encoded(a[channel]) - encoded(b[channel])).powi(2);
                count += 1;
            }
        }
    }
    -10.0 * (sum / f64::from(count)).log10()
}

fn assert_close(found: &LinearImage, expected: &[[f32; 4]], at_least: f64, what: &str) {
    let db = psnr(found, expected);
    assert!(db >= at_least, "{what}: {db:.1} dB");
}

/// The solution's light with the first lamp elsewhere.
fn moved(lighting: &Lighting) -> Lighting {
    let mut moved = lighting.clone();
    moved.lamps[0].turn_towards(Vec3::new(0.1, 0.5, 0.85).normalize_or_zero());
    moved
}

/// Light from everywhere, or only from directions whose cosine to the viewer's side is at least so much, brighter above, with a bright
/// window before the object and a small sun.
fn sky(lighting: &Lighting, least: f32) -> Lighting {
    let window = Vec3::new(0.34, 0.28, 0.9).normalize_or_zero();
    let sun = Vec3::new(-0.5, 0.6, 0.6).normalize_or_zero();
    let radiance = |direction: Vec3| {
        let even = Vec3::new(0.6, 0.8, 1.0) * (1.2 + direction.y);
        if direction.dot(window) < least {
            Vec3::ZERO
        } else if direction.dot(sun) > 0.9986 {
            Vec3::splat(150.0)
        } else if direction.dot(window) > 0.95 {
            Vec3::new(9.0, 8.0, 7.0)
        } else {
            even
        }
    };
    Lighting {
        lamps: Vec::new(),
        remainder: Vec::new(),
        ambient: Vec3::ZERO,
        environment: LatLong::of(128, radiance).environment(Quat::from_rotation_y(0.2), Vec3::ONE),
        ..lighting.clone()
    }
}

#[test]
fn settled_pictures_are_the_reference_renderers() {
    for (brdf, radius) in [
        (Some(PAPER), None),
        (Some(PLASTIC), None),
        (Some(GGX), None),
        (Some(METAL), None),
        (Some(PAPER), Some(3.0)),
        (None, None),
    ] {
        let (mut renderer, surface) = renderer(solved(brdf, radius));
        let solution = surface.solution();
        let original = solution.lighting();
        let mut request = request(view(128));
        for (what, lighting) in [
            ("as captured", original.clone()),
            ("moved", moved(&original)),
        ] {
            let what = format!("{brdf:?}, radius {radius:?}, {what}");
            let [beauty, diffuse, specular] = fine_reference(solution, &lighting, &request.camera);
            renderer.set_lighting(&lighting).unwrap();
            for (mode, expected) in [
                (Mode::Beauty, beauty),
                (Mode::Diffuse, diffuse),
                (Mode::Specular, specular),
            ] {
                if mode == Mode::Specular && brdf.is_none() {
                    continue;
                }
                request.mode = mode;
                // What is mirrored shows most without the diffuse part; of a metal it is what lamps make of the surface, whose
                // shadows the reference knows at gather points and the device at texels.
                let at_least = match brdf {
                    Some(METAL) => 36.0,
                    Some(PLASTIC | GGX) if mode == Mode::Specular => 40.0,
                    _ => 45.0,
                };
                let picture = settled(&mut renderer, &request);
                assert_close(&picture, &expected, at_least, &format!("{what}, {mode:?}"));
            }
            request.mode = Mode::Beauty;
        }
    }
}

/// Patches of three roughnesses and strengths over the surface, one of them of another colour.
fn patched(brdf: Brdf) -> Solution {
    let mut solution = solved(Some(brdf), None);
    let atlas = &solution.atlas;
    let coloured = Gloss::new(0.5, 6.5).reflecting(Vec3::new(9.5, 6.5, 3.5));
    let parts = [coloured, Gloss::new(1.0, 0.0), Gloss::new(1.5, 0.8)];
    let mut texels = vec![Gloss::MAIN; atlas.len()];
    for t in &atlas.texels {
        let height = solution.mesh.point(t.triangle, t.barycentric).position.y;
        texels[t.index as usize] = match height {
            h if h > 0.6 => parts[0],
            h if h > 0.2 => parts[1],
            _ => parts[2],
        };
    }
    solution.gloss = Some(GlossTexture::new(parts.to_vec(), texels));
    solution
}

#[test]
fn parts_of_other_gloss_are_the_reference_renderers() {
    for brdf in [PAPER, GGX, PLASTIC] {
        let solution = patched(brdf);
        let lighting = solution.lighting();
        let [beauty, _, specular] = reference(&solution, &lighting, &view(128));
        let uniform = solved(Some(brdf), None);
        let [_, _, of_one] = reference(&uniform, &lighting, &view(128));
        let (mut renderer, surface) = renderer(solution);
        let mut frame = request(view(128));
        assert_close(&settled(&mut renderer, &frame), &beauty, 40.0, "beauty");
        frame.mode = Mode::Specular;
        let found = settled(&mut renderer, &frame);
        assert_close(&found, &specular, 35.0, "specular");
        assert!(psnr(&found, &of_one) < 30.0, "as if one gloss were all");
        let solution = surface.solution();
        let gloss = |t, b| {
            solution
                .gloss_map()
                .unwrap()
                .texture
                .at(&solution.atlas, t, b)
        };
        let roughness = |t, b| {
            let gloss = gloss(t, b);
            let alpha = 2.0_f32.sqrt() * brdf.sigma * gloss.roughness;
            Vec3::splat(if gloss.strength > 0.0 {
                alpha.sqrt()
            } else {
                1.0
            })
        };
        let strength = |t, b| Vec3::splat(gloss(t, b).strength / 6.5);
        let cases: [(Mode, Value, f32); 2] = [
            (Mode::Roughness, &roughness, 0.02),
            (Mode::Strength, &strength, 0.02),
        ];
        for (mode, value, tolerance) in cases {
            frame.mode = mode;
            let picture = settled(&mut renderer, &frame);
            let expected = at_centres(&solution.mesh, &frame.camera, value);
            assert_shown(&picture, &expected, tolerance, mode);
        }
    }
}

#[test]
fn pictures_are_good_while_things_move() {
    for brdf in [PAPER, PLASTIC, GGX] {
        let (mut renderer, surface) = renderer(solved(Some(brdf), None));
        let original = surface.solution().lighting();
        let mut request = request(view(224));
        settled(&mut renderer, &request);
        request.camera.world_from_camera.translation.x += 0.01;
        renderer.draw(&request).unwrap();
        let [beauty, ..] = reference(surface.solution(), &original, &request.camera);
        assert_close(&renderer.read_back().unwrap(), &beauty, 35.0, "orbiting");
        let lighting = moved(&original);
        let [beauty, ..] = reference(surface.solution(), &lighting, &request.camera);
        request.dragging = true;
        renderer.set_lighting(&lighting).unwrap();
        renderer.draw(&request).unwrap();
        assert_close(&renderer.read_back().unwrap(), &beauty, 35.0, "dragging");
        assert!(!renderer.is_settled(), "a dragged lamp isn't baked");
    }
}

#[test]
fn an_environment_is_the_reference_renderers() {
    let (mut renderer, surface) = renderer(solved(Some(PLASTIC), None));
    let lighting = sky(&surface.solution().lighting(), -1.0);
    let mut request = request(view(192));
    renderer.set_lighting(&lighting).unwrap();
    let parts = reference(surface.solution(), &lighting, &request.camera);
    let mut found = Vec::new();
    for (mode, expected) in [Mode::Beauty, Mode::Diffuse, Mode::Specular]
        .into_iter()
        .zip(&parts)
    {
        request.mode = mode;
        found.push(psnr(&settled(&mut renderer, &request), expected));
    }
    // Orbiting, a pixel has one sample, and silhouettes, where light from behind is brightest, show that: there is none.
    let before = sky(&surface.solution().lighting(), 0.2);
    let [beauty, ..] = reference(surface.solution(), &before, &request.camera);
    renderer.set_lighting(&before).unwrap();
    request.mode = Mode::Beauty;
    settled(&mut renderer, &request);
    request.camera.world_from_camera.translation.x += 1e-6;
    renderer.draw(&request).unwrap();
    found.push(psnr(&renderer.read_back().unwrap(), &beauty));
    let wanted = [40.0, 40.0, 35.0, 33.0];
    let good = found
        .iter()
        .zip(wanted)
        .all(|(found, wanted)| *found >= wanted);
    assert!(good, "beauty, diffuse, specular, orbiting: {found:.1?} dB");
}

#[test]
fn gain_colour_and_mute_bake_nothing_and_are_exact() {
    let (mut renderer, surface) = renderer(solved(Some(PAPER), None));
    let mut lighting = moved(&surface.solution().lighting());
    let request = request(view(96));
    renderer.set_lighting(&lighting).unwrap();
    let before = settled(&mut renderer, &request);
    lighting.lamps[1].muted = true;
    lighting.ambient = Vec3::ZERO;
    renderer.set_lighting(&lighting).unwrap();
    let alone = settled(&mut renderer, &request);
    lighting.lamps[1].muted = false;
    lighting.lamps[0].muted = true;
    lighting.ambient = Vec3::splat(0.2);
    renderer.set_lighting(&lighting).unwrap();
    let rest = settled(&mut renderer, &request);
    // Without waiting for the baker: everything there is to know is known.
    let gain = Vec3::new(2.0, 0.25, 0.0);
    lighting.lamps[0].muted = false;
    for node in &mut lighting.lamps[0].nodes {
        node.radiance *= gain;
    }
    renderer.set_lighting(&lighting).unwrap();
    renderer.draw(&request).unwrap();
    while renderer.needs_redraw() {
        renderer.draw(&request).unwrap();
    }
    assert!(renderer.is_settled(), "something was baked again");
    let gained = renderer.read_back().unwrap();
    for i in 0..before.pixels.len() {
        for c in 0..3 {
            let (all, one, others) = (before.pixels[i][c], alone.pixels[i][c], rest.pixels[i][c]);
            assert!(
                (one + others - all).abs() < 4e-3 * (all + 0.1),
                "pixel {i}: {one} + {others}, not {all}"
            );
            let (found, expected) = (gained.pixels[i][c], gain[c] * one + others);
            assert!(
                (found - expected).abs() < 4e-3 * (expected + 0.1),
                "pixel {i}: {found}, not {expected}"
            );
        }
    }
}

#[test]
fn a_settled_picture_does_not_depend_on_history() {
    let solution = solved(Some(PLASTIC), None);
    let original = solution.lighting();
    let (mut one, _) = renderer(solution);
    let (mut other, _) = renderer(solved(Some(PLASTIC), None));
    let mut request = request(view(96));
    let lighting = moved(&original);
    // Straight.
    one.set_lighting(&lighting).unwrap();
    let straight = settled(&mut one, &request);
    // By way of other cameras, lamps, a drag and a look.
    other.set_lighting(&sky(&original, -1.0)).unwrap();
    other.draw(&request).unwrap();
    request.dragging = true;
    let mut lamp = original.clone();
    for i in 0..5 {
        lamp.lamps[0].turn_towards(
            (Quat::from_rotation_y(0.1 * i as f32) * Vec3::new(0.5, 0.5, 0.5)).normalize_or_zero(),
        );
        other.set_lighting(&lamp).unwrap();
        request.camera.world_from_camera.translation.y += 0.02;
        other.draw(&request).unwrap();
    }
    request.camera = view(96);
    request.dragging = false;
    other.set_lighting(&original).unwrap();
    settled(&mut other, &request);
    other.set_lighting(&lighting).unwrap();
    let detour = settled(&mut other, &request);
    for (i, (a, b)) in straight.pixels.iter().zip(&detour.pixels).enumerate() {
        assert_eq!(a, b, "pixel {i}");
    }
}

#[test]
fn a_slow_device_answers_with_larger_pixels_and_ends_with_the_same_picture() {
    let (mut renderer, _) = renderer(solved(Some(PAPER), None));
    let whole = request(view(120));
    let expected = settled(&mut renderer, &whole);
    let quick = FrameRequest {
        quick: true,
        ..whole.clone()
    };
    let elsewhere = FrameRequest {
        camera: camera(DVec3::new(-1.2, 1.0, 3.2), DVec3::ZERO, 120, 120, 1.1),
        ..quick.clone()
    };
    let sides = |renderer: &mut Renderer, request: &FrameRequest| {
        let size = renderer.draw(request).unwrap().view.texture().size();
        [size.width, size.height]
    };
    let first = sides(&mut renderer, &elsewhere);
    if renderer.gpu().device().adapter_info().device_type == wgpu::DeviceType::Cpu {
        assert_eq!(first, [60, 60]);
    }
    renderer.draw(&quick).unwrap();
    assert!(renderer.needs_redraw() && !renderer.is_settled());
    while !renderer.is_settled() {
        assert!(renderer.needs_redraw());
        renderer.draw(&quick).unwrap();
    }
    assert_eq!(sides(&mut renderer, &quick), [120, 120]);
    assert!(renderer.read_back().unwrap().pixels == expected.pixels);
}

#[test]
fn nothing_is_drawn_while_nothing_changes() {
    let (mut renderer, _) = renderer(solved(Some(PAPER), None));
    let mut request = request(view(64));
    assert!(renderer.needs_redraw());
    let picture = settled(&mut renderer, &request);
    assert!(renderer.is_settled() && !renderer.needs_redraw());
    // Exposure and view transform are no reason to shade anything again.
    request.exposure_ev = 2.0;
    request.transform = ViewTransform::Agx;
    let shown = renderer.draw(&request).unwrap();
    assert!(shown.settled);
    assert_eq!(renderer.read_back().unwrap().pixels, picture.pixels);
    request.camera.world_from_camera.translation.x += 0.1;
    assert!(!renderer.draw(&request).unwrap().settled);
    assert!(renderer.needs_redraw());
}

/// Values of a mode at the pixels' centres by the mesh itself, where the pixel shows one smooth piece of it.
fn at_centres(
    mesh: &Mesh,
    camera: &Camera,
    value: &dyn Fn(u32, glam::Vec2) -> Vec3,
) -> Vec<Option<Vec3>> {
    let occluder = Occluder::new(mesh);
    let eye = camera.position().as_vec3();
    (0..camera.width * camera.height)
        .map(|i| {
            let at = |dx: f64, dy: f64| {
                let pixel = glam::DVec2::new(
                    f64::from(i % camera.width) + dx,
                    f64::from(i / camera.width) + dy,
                );
                occluder.hit(eye, camera.ray(pixel).as_vec3())
            };
            let corners = [at(0.0, 0.0)?, at(1.0, 0.0)?, at(0.0, 1.0)?, at(1.0, 1.0)?];
            let centre = at(0.5, 0.5)?;
            let smooth = corners
                .iter()
                .all(|c| (c.distance - centre.distance).abs() < 0.03);
            smooth.then(|| value(centre.triangle, centre.barycentric))
        })
        .collect()
}

/// A quantity at a point of a triangle.
type Value<'a> = &'a dyn Fn(u32, glam::Vec2) -> Vec3;

/// Nearly all pixels have the value at their centre.
fn assert_shown(picture: &LinearImage, expected: &[Option<Vec3>], tolerance: f32, mode: Mode) {
    let pairs = picture.pixels.iter().zip(expected);
    let errors: Vec<f32> = pairs
        .filter_map(|(found, e)| {
            let found = Vec3::new(found[0], found[1], found[2]);
            Some((found - (*e)?).abs().max_element())
        })
        .collect();
    assert!(errors.len() > 2000, "{} pixels to compare", errors.len());
    let bad = errors.iter().filter(|e| **e > tolerance).count();
    // A shadow's edge may pass through a pixel, and the mean over it isn't its centre's value.
    assert!(
        bad * 20 < errors.len(),
        "{mode:?}: {bad} of {} pixels are off",
        errors.len()
    );
}

#[test]
fn every_mode_shows_what_it_says() {
    let (mut renderer, surface) = renderer(solved(Some(PLASTIC), None));
    let solution = surface.solution();
    let mesh = &solution.mesh;
    let lighting = moved(&solution.lighting());
    renderer.set_lighting(&lighting).unwrap();
    let mut request = request(view(96));
    let occluder = Occluder::new(mesh);
    let reference = Shader::new(&occluder, solution.brdf, &lighting);
    let albedo_white = solution.brightest(&solution.albedo);
    let seen = |triangle, barycentric| {
        let point = rekindle_relight::ShadingPoint::on(mesh, triangle, barycentric);
        Vec3::splat(reference.seen_share(&point, 0).unwrap_or(0.0))
    };
    let normal = |t, b| mesh.point(t, b).normal * 0.5 + 0.5;
    let albedo = |t, b| solution.atlas.sample(&solution.albedo, t, b) / albedo_white;
    let confidence = |t, b| {
        let texels: Vec<[f32; 3]> = solution.confidence.iter().map(|c| [*c; 3]).collect();
        solution.atlas.sample(&texels, t, b)
    };
    let cases: [(Mode, Value, f32); 4] = [
        (Mode::Normals, &normal, 0.01),
        (Mode::Albedo, &albedo, 0.02),
        (Mode::Shadow(0), &seen, 0.05),
        (Mode::Confidence, &confidence, 0.02),
    ];
    for (mode, value, tolerance) in cases {
        request.mode = mode;
        let picture = settled(&mut renderer, &request);
        let expected = at_centres(mesh, &request.camera, value);
        assert_shown(&picture, &expected, tolerance, mode);
    }
    // Irradiance is what turns the albedo into the diffuse part, but for the transmittance towards the viewer.
    request.mode = Mode::Irradiance;
    let irradiance = settled(&mut renderer, &request);
    request.mode = Mode::Albedo;
    let albedo = settled(&mut renderer, &request);
    request.mode = Mode::Diffuse;
    let diffuse = settled(&mut renderer, &request);
    let bright = surface.white();
    for i in (0..diffuse.pixels.len()).filter(|&i| diffuse.pixels[i][3] == 1.0) {
        let product = irradiance.pixels[i][1] * albedo.pixels[i][1];
        let found = diffuse.pixels[i][1];
        assert!(
            found <= 1.01 * product + 0.01 * bright,
            "pixel {i}: {found} of {product}"
        );
    }
}

#[test]
fn the_shader_shows_colours_as_the_reference_transforms_do() {
    let (mut renderer, surface) = renderer(solved(Some(PAPER), None));
    let mut request = request(view(64));
    let linear = settled(&mut renderer, &request);
    for transform in ViewTransform::ALL {
        for exposure_ev in [-2.0, 0.0, 3.0] {
            request.transform = transform;
            request.exposure_ev = exposure_ev;
            renderer.draw(&request).unwrap();
            let shown = renderer.read_shown().unwrap();
            for (i, pixel) in linear
                .pixels
                .iter()
                .enumerate()
                .filter(|(_, p)| p[3] == 1.0)
            {
                let radiance = Vec3::new(pixel[0], pixel[1], pixel[2])
                    * (exposure_ev.exp2() / surface.white());
                let expected = transform.apply(radiance) * 255.0;
                let found = Vec3::new(
                    shown[4 * i].into(),
                    shown[4 * i + 1].into(),
                    shown[4 * i + 2].into(),
                );
                let error = (found - expected).abs().max_element();
                assert!(
                    error < 1.5,
                    "{transform:?} at {exposure_ev} stops: {found}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn the_background_is_a_colour_or_the_light() {
    let (mut renderer, surface) = renderer(solved(Some(PAPER), None));
    let lighting = surface.solution().lighting();
    let lamp = lighting.lamps[0].direction.as_dvec3();
    // From beyond the object, so that the lamp stands behind it to the left.
    let eye = -4.0 * lamp + 2.0 * DVec3::Y.cross(lamp).normalize_or_zero();
    let mut request = request(camera(eye, DVec3::ZERO, 96, 96, 0.8));
    request.background = Background::Colour([0.2, 0.4, 0.6]);
    renderer.draw_settled(&request).unwrap();
    assert_eq!(renderer.read_shown().unwrap()[..3], [51, 102, 153]);
    request.background = Background::Light;
    renderer.draw(&request).unwrap();
    let shown = renderer.read_shown().unwrap();
    let place = request.camera.project(eye + lamp).unwrap();
    let at = |x: usize, y: usize| shown[4 * (y * 96 + x)];
    assert_eq!(at(place.x as usize, place.y as usize), 255, "the lamp");
    assert!(at(2, 2) < 128, "the dark beside it: {}", at(2, 2));
}

#[test]
fn a_camera_with_distortion_sees_what_the_reference_sees() {
    let (mut renderer, surface) = renderer(solved(Some(PAPER), None));
    let mut request = request(view(128));
    request.camera.distortion = Distortion {
        k: [-0.25, 0.08, 0.0, 0.0],
        p: [0.004, -0.003],
        ..Distortion::default()
    };
    request.camera.centre += glam::DVec2::new(5.0, -3.0);
    let [beauty, ..] = reference(
        surface.solution(),
        &surface.solution().lighting(),
        &request.camera,
    );
    assert_close(
        &settled(&mut renderer, &request),
        &beauty,
        40.0,
        "distorted",
    );
}

#[test]
fn radiance_scales_with_the_capture() {
    let scaled = |factor: f32| {
        let mut solution = solved(Some(PLASTIC), None);
        for value in solution
            .diffuse
            .iter_mut()
            .chain(&mut solution.radiance)
            .flatten()
        {
            *value *= factor;
        }
        solution.ambient *= factor;
        for lamp in &mut solution.lamps {
            lamp.flux *= factor;
        }
        let (mut renderer, surface) = renderer(solution);
        renderer
            .set_lighting(&moved(&surface.solution().lighting()))
            .unwrap();
        settled(&mut renderer, &request(view(64)))
    };
    let one = scaled(1.0);
    for factor in [1e-4, 1e4] {
        for (a, b) in one.pixels.iter().zip(&scaled(factor).pixels) {
            for c in 0..3 {
                let (a, b) = (a[c], b[c] / factor);
                assert!(
                    (a - b).abs() <= 4e-3 * a.max(0.01),
                    "{b}, not {a}, at {factor}"
                );
            }
        }
    }
}

#[test]
fn failures_are_values() {
    let own = Gpu::headless().unwrap();
    let mut renderer = Renderer::new(own.clone()).unwrap();
    let mut request = request(view(32));
    assert!(matches!(
        renderer.draw(&request),
        Err(RenderError::NoSurface)
    ));
    let lighting = solved(None, None).lighting();
    assert!(matches!(
        renderer.set_lighting(&lighting),
        Err(RenderError::NoSurface)
    ));
    let surface = Arc::new(Surface::with_light_texels(
        Arc::new(solved(Some(PAPER), None)),
        1e4,
    ));
    renderer.set_surface(surface).unwrap();
    request.camera.width = 1 << 20;
    let error = renderer.draw(&request).err().unwrap();
    assert!(matches!(error, RenderError::Limit { .. }), "{error}");
    // It goes on with a picture that fits.
    request.camera.width = 32;
    renderer.draw(&request).unwrap();
    own.device().destroy();
    let error = renderer.gpu().wait().err().unwrap();
    assert!(matches!(error, RenderError::DeviceLost { .. }), "{error}");
    request.camera.world_from_camera.translation.x += 0.1;
    let error = renderer.draw(&request).err().unwrap();
    assert!(matches!(error, RenderError::DeviceLost { .. }), "{error}");
}
