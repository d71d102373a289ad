//! What the estimation promises as a whole, on a capture with known truth and on made observations.

use std::array;
use std::f32::consts::PI;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::LazyLock;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use glam::{DVec3, Vec3};

use super::below::AllAround;
use super::cells::{Cell, Pyramid};
use super::course::{Ending, Grounds};
use super::design::Design;
use super::observations::{Observations, Point, Row};
use super::shading::{Agreement, LightByShading};
use super::state::{EXACT, State};
use super::visibility::SeenCells;
use super::weights::{initial_weights, residuals, robust_weights};
use super::*;
use rekindle_capture::read_radiance;
use rekindle_scene::hemisphere::{Lamp, find_lamps};
use rekindle_scene::reflectance::Gloss;

static NEVER: AtomicBool = AtomicBool::new(false);
static WORKSPACE: Workspace = Workspace::new();
static SHORTCUTS: LazyLock<Shortcuts> = LazyLock::new(Shortcuts::default);

/// Where the lamps of `spot_paper` are, from its truth.json; their green irradiances are 2.353 and 1.647.
const LAMPS: [Vec3; 2] = [
    Vec3::new(-0.619_74, 0.587_79, 0.520_03),
    Vec3::new(0.405_58, std::f32::consts::FRAC_1_SQRT_2, 0.579_23),
];

fn load() -> Capture {
    load_named("spot_paper")
}

fn load_named(name: &str) -> Capture {
    let captures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/captures");
    Capture::load(&captures.join(name)).unwrap()
}

fn run_on(
    capture: &Capture,
    method: Method,
    observer: &mut dyn Observer,
) -> Result<Estimate, Stopped> {
    let params = EstimateParams {
        method,
        ..EstimateParams::default()
    };
    with_input(capture, |input| estimate(input, &params, observer))
}

/// Something done with what an estimate is made of.
fn with_input<R>(capture: &Capture, then: impl FnOnce(&EstimateInput<'_>) -> R) -> R {
    let occluder = Occluder::new(&capture.mesh);
    let surfaces: Vec<ViewSurface> = capture
        .views
        .iter()
        .map(|v| ViewSurface::new(&capture.mesh, &occluder, &v.camera))
        .collect();
    let grid = HemisphereGrid::new(
        40,
        capture.light_hemisphere.up.as_vec3(),
        None,
        capture.mesh.centre(),
    );
    then(&EstimateInput {
        capture,
        surfaces: &surfaces,
        occluder: &occluder,
        grid: &grid,
        first: None,
    })
}

/// Something done with the solver of a capture.
fn with_solver<R>(capture: &Capture, then: impl FnOnce(&Solver<'_>) -> R) -> R {
    with_input(capture, |input| {
        let pyramid = Pyramid::new(input.grid, fast::COARSEST);
        let with = (&*SHORTCUTS, &WORKSPACE);
        let now = Instant::now();
        then(&Solver::new(input, None, &pyramid, with, None, now, &NEVER))
    })
}

fn fast(capture: &Capture) -> Estimate {
    run_on(capture, Method::Fast, &mut Unobserved).unwrap()
}

/// Whether there is no light, and everything was left to the diffuse part for a reason that contains `words`.
fn is_dark(found: &Estimate, words: &str) {
    assert!(found.radiance.iter().flatten().all(|&v| v == 0.0), "light");
    is_diffuse_only(found, words);
}

/// Whether everything was left to the diffuse part, and the reason given contains `words`.
fn is_diffuse_only(found: &Estimate, words: &str) {
    let d = &found.diagnostics;
    assert!(
        found.brdf.is_none() && !d.well_posed && !d.specular_found,
        "{d:?}"
    );
    assert!(d.warnings.iter().any(|w| w.contains(words)), "{d:?}");
}

/// The diffuse part of each view of `spot_paper`, which is what its renderer says.
fn true_diffuse(capture: &Capture) -> Vec<Vec<[f32; 3]>> {
    let folder =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/captures/spot_paper/truth/diffuse");
    let picture =
        |i: usize| read_radiance(&folder.join(format!("view_{i:03}.exr"))).map(|(_, _, r)| r);
    let views = 0..capture.views.len();
    views.map(|i| picture(i).unwrap()).collect()
}

#[test]
fn a_single_view_is_left_diffuse() {
    let mut capture = load();
    capture.views.truncate(1);
    is_dark(&fast(&capture), "single view");
}

#[test]
fn views_without_a_common_surface_are_left_diffuse() {
    let mut capture = load();
    capture.views.truncate(2);
    let occluder = Occluder::new(&capture.mesh);
    let middle = capture.mesh.centre().x;
    for (view, side) in capture.views.iter_mut().zip([-1.0, 1.0]) {
        let surface = ViewSurface::new(&capture.mesh, &occluder, &view.camera);
        for y in 0..surface.height {
            for x in 0..surface.width {
                let point = surface.point(&capture.mesh, &view.camera, x, y);
                let usable = point.is_some_and(|p| side * (p.position.x - middle) > 0.0);
                Arc::make_mut(&mut view.photograph).usable[(y * surface.width + x) as usize] &=
                    usable;
            }
        }
    }
    is_dark(&fast(&capture), "seen clearly by two views");
}

#[test]
fn a_purely_diffuse_object_is_left_diffuse_and_lit_by_its_shading() {
    let mut capture = load();
    for (picture, view) in true_diffuse(&capture).into_iter().zip(&mut capture.views) {
        Arc::make_mut(&mut view.photograph).radiance = picture;
    }
    let reference = run_on(&capture, Method::Amuh, &mut Unobserved).unwrap();
    is_dark(&reference, "No specular part");
    let found = fast(&capture);
    is_diffuse_only(&found, "No specular part");
    is_diffuse_only(&found, "from the shading alone");
    // Irradiance over the directions of normals, found and true.
    let normals = HemisphereGrid::new(8, Vec3::Y, None, Vec3::ZERO).to_whole();
    let lit = |normal: &Vec3, lights: &mut dyn Iterator<Item = (Vec3, f32)>| -> f64 {
        lights
            .map(|(to, flux)| f64::from(flux * normal.dot(to).max(0.0)))
            .sum()
    };
    let nodes = || found.grid.directions.iter().copied().zip(&found.radiance);
    let lamps = LAMPS.into_iter().zip([2.353, 1.647]);
    let irradiance: Vec<[f64; 2]> = (normals.directions.iter())
        .map(|n| {
            [
                lit(n, &mut nodes().map(|(to, l)| (to, l[1]))),
                lit(n, &mut lamps.clone()),
            ]
        })
        .collect();
    let correlation = correlation(&irradiance);
    assert!(correlation > 0.95, "{correlation}");
}

/// Of pairs of values.
fn correlation(pairs: &[[f64; 2]]) -> f64 {
    let mean = [0, 1].map(|k| pairs.iter().map(|p| p[k]).sum::<f64>() / pairs.len() as f64);
    let product = |a: usize, b: usize| -> f64 {
        pairs
            .iter()
            .map(|p| (p[a] - mean[a]) * (p[b] - mean[b]))
            .sum()
    };
    product(0, 1) / (product(0, 0) * product(1, 1)).sqrt()
}

/// The object of `spot_paper` in an even colour, with a gloss, under light from everywhere, radiance by direction, and a little noise.
fn under_sky(brdf: &Brdf, sky: impl Fn(Vec3) -> f32) -> Capture {
    let mut capture = load();
    let occluder = Occluder::new(&capture.mesh);
    let grid = HemisphereGrid::new(12, Vec3::Y, None, Vec3::ZERO);
    let both = grid.directions.iter().flat_map(|&l| [l, -l]);
    let lights: Vec<(Vec3, f32)> = both.map(|l| (l, grid.solid_angle * sky(l))).collect();
    for view in &mut capture.views {
        let surface = ViewSurface::new(&capture.mesh, &occluder, &view.camera);
        let eye = view.camera.position().as_vec3();
        let width = surface.width;
        let shaded = |pixel: usize| {
            let (x, y) = (pixel as u32 % width, pixel as u32 / width);
            let Some(p) = surface.point(&capture.mesh, &view.camera, x, y) else {
                return [0.0; 3];
            };
            let terms = brdf.view_terms(p.normal, (eye - p.position).normalize_or_zero());
            let lobes = lights.iter().map(|&(l, flux)| flux * brdf.lobe(&terms, l));
            let diffuse = 0.4 * brdf.diffuse_exit(terms.cos_view());
            let noise = 1.0 + 0.005 * Random(pixel as u64 * 0x9e37_79b9_7f4a_7c15).normal();
            [noise * (diffuse + lobes.sum::<f32>()); 3]
        };
        let radiance = (0..surface.interior.len()).map(shaded).collect();
        Arc::make_mut(&mut view.photograph).radiance = radiance;
    }
    capture
}

#[test]
fn uniform_light_on_a_glossy_object_gives_a_bound_of_the_roughness() {
    let brdf = Brdf::new(SpecularModel::Beckmann, 0.2);
    let capture = under_sky(&brdf, |_| 0.3);
    let found = fast(&capture);
    let warnings = found.diagnostics.warnings.join("\n");
    assert!(
        !found.diagnostics.well_posed && warnings.contains("no detail"),
        "{warnings}"
    );
    let [low, high] = found.sigma_interval95.unwrap();
    assert!(low == 0.0 && brdf.sigma < high, "{low} to {high}");
    assert!(found.brdf.unwrap().sigma < high);
}

/// A capture with its views exposed by these factors.
fn exposed(mut capture: Capture, exposures: &[f32]) -> Capture {
    for (view, exposure) in capture.views.iter_mut().zip(exposures) {
        let radiance = &mut Arc::make_mut(&mut view.photograph).radiance;
        for value in radiance.as_flattened_mut() {
            *value *= exposure;
        }
    }
    capture
}

/// What soft gloss is found on a capture whose views are exposed by these factors.
fn soft_gloss_of(capture: Capture, exposures: &[f32]) -> Option<Ending> {
    with_solver(&exposed(capture, exposures), |solver| {
        let mut watch = Watch {
            iterations: &mut Vec::new(),
            observer: &mut Unobserved,
        };
        soft_gloss::found(solver, SpecularChoice::Auto, &mut watch).unwrap()
    })
}

#[test]
fn gloss_that_mirrors_a_window_is_found_with_the_window() {
    let window = Vec3::new(0.8, 0.5, 0.3).normalize_or_zero();
    let brdf = Brdf::new(SpecularModel::Ggx, 0.08);
    let sky = |l: Vec3| 0.1 + 2.0 * l.dot(window).max(0.0).powi(8);
    let found = soft_gloss_of(under_sky(&brdf, sky), &[]).expect("gloss");
    let nodes = found.grid.directions.iter().zip(&found.fit.nodes);
    let away = |cos: f32, less: bool| -> f32 {
        let there = nodes.clone().filter(|(l, _)| (l.dot(window) < cos) == less);
        let (count, sum) = there.fold((0.0, 0.0), |(n, sum), (_, l)| (n + 1.0, sum + l[1]));
        sum / count
    };
    // There is 16 times as much within 20° of it as where it isn't, and how strong that is depends on the roughness.
    let ratio = away(0.94, false) / away(0.5, true);
    assert!((ratio / 16.0).ln().abs() < 0.4, "{ratio}");
    assert_eq!(found.fit.brdf.sigma, brdf.sigma);
    let roughest = found.bound.expect("broad light leaves roughness open");
    assert!(brdf.sigma < 1.01 * roughest, "{roughest}");
}

#[test]
fn a_matte_object_has_no_soft_gloss_however_it_is_exposed() {
    assert!(soft_gloss_of(matte(), &[]).is_none());
    assert!(soft_gloss_of(matte(), &[1.0, 1.2, 0.9, 1.05, 0.85, 1.1]).is_none());
}

#[test]
fn lights_that_explain_highlights_are_not_given_up_for_broad_light() {
    with_solver(&load(), |solver| {
        let ending = found_by_course(solver);
        assert!(bettered_by_sky(solver, &ending).is_none());
        // What is not where any light is does worse.
        let wrong = lit_from_elsewhere(ending);
        assert!(bettered_by_sky(solver, &wrong).is_some());
    });
}

/// What the default method finds.
fn found_by_course(solver: &Solver<'_>) -> Ending {
    let mut watch = Watch {
        iterations: &mut Vec::new(),
        observer: &mut Unobserved,
    };
    let rules = Rules {
        choice: SpecularChoice::Auto,
        exposures: None,
    };
    match course::run(solver, rules, &mut watch).unwrap() {
        Outcome::Found(ending) => *ending,
        _ => panic!("lights are found"),
    }
}

fn bettered_by_sky(solver: &Solver<'_>, ending: &Ending) -> Option<Ending> {
    let mut watch = Watch {
        iterations: &mut Vec::new(),
        observer: &mut Unobserved,
    };
    soft_gloss::bettered(solver, ending, SpecularChoice::Auto, &mut watch).unwrap()
}

/// The same with as many lights, none of them where one is.
fn lit_from_elsewhere(ending: Ending) -> Ending {
    let mut nodes = ending.fit.nodes;
    nodes.reverse();
    Ending {
        fit: Fit {
            nodes,
            ..ending.fit
        },
        ..ending
    }
}

#[test]
fn light_by_shading_takes_the_place_of_lights_that_explain_gloss_no_better_and_make_the_texture_less_even()
 {
    with_solver(&load(), |solver| {
        let ending = found_by_course(solver);
        let light = LightByShading::of(solver).expect("two lamps shade");
        let choice = SpecularChoice::Auto;
        let bettered = |ending: &Ending| {
            let mut watch = Watch {
                iterations: &mut Vec::new(),
                observer: &mut Unobserved,
            };
            under_shading::bettered(solver, ending, &light, choice, &mut watch).unwrap()
        };
        assert!(bettered(&ending).is_none());
        let wrong = lit_from_elsewhere(ending);
        let right = bettered(&wrong).expect("the shading's");
        assert_eq!(right.grounds, Grounds::Shading);
        is_a_multiple(&right.fit.nodes, light.nodes());
        // No interval where the roughness is taken from one of two explanations without what the other has.
        let [low, high] = interval(&right.fit, right.allowed, None);
        let own = wrong.fit.brdf.sigma;
        assert!(low <= own && own <= high, "{low} to {high} for {own}");
    });
}

#[test]
fn a_sun_that_was_found_gets_the_sky_beside_it() {
    let (sun, blue) = (Vec3::new(-0.5, 0.7, 0.5), Vec3::new(0.8, 0.5, 0.3));
    let [sun, blue] = [sun, blue].map(Vec3::normalize_or_zero);
    let brdf = Brdf::new(SpecularModel::Ggx, 0.08);
    let shines = |l: Vec3| l.dot(sun) > 8.0_f32.to_radians().cos();
    let of_sky = |l: Vec3| 0.1 + 2.0 * l.dot(blue).max(0.0).powi(8);
    let sky = |l: Vec3| if shines(l) { 30.0 } else { of_sky(l) };
    with_solver(&under_sky(&brdf, sky), |solver| {
        let ending = found_by_course(solver);
        let only_sun = solver
            .grid
            .directions
            .iter()
            .map(|&l| if shines(l) { [9.0; 3] } else { [0.0; 3] });
        let found = Ending {
            fit: Fit {
                brdf: Brdf {
                    sigma: 1.3 * brdf.sigma,
                    ..brdf
                },
                nodes: only_sun.collect(),
                ..ending.fit
            },
            refined: None,
            ..ending
        };
        let bettered = bettered_by_sky(solver, &found).expect("a sky");
        assert_eq!(bettered.grounds, found.grounds);
        let sigma = bettered.fit.brdf.sigma;
        assert!((sigma / brdf.sigma).ln().abs() < 0.2, "{sigma}");
        let nodes = bettered.grid.directions.iter().zip(&bettered.fit.nodes);
        let mean = |is_there: &dyn Fn(Vec3) -> bool| -> f32 {
            let there = nodes.clone().filter(|(l, _)| is_there(**l));
            let (count, sum) = there.fold((0.0, 0.0), |(n, sum), (_, l)| (n + 1.0, sum + l[1]));
            sum / count
        };
        let by_sun = mean(&shines) / mean(&|l| l.dot(blue) > 0.94);
        assert!((by_sun / 17.0).ln().abs() < 0.4, "{by_sun}");
        let sky_alone = bettered.broad_light.len();
        assert!(
            sky_alone > bettered.grid.directions.len() / 2,
            "{sky_alone}"
        );
    });
}

#[test]
fn a_mesh_coarser_than_the_highlights_is_refined() {
    let capture = load_named("spot_decimated");
    let found = fast(&capture);
    let surface = found.refined.as_ref().expect("the mesh is too coarse");
    assert!(found.diagnostics.well_posed, "{:?}", found.diagnostics);
    assert_eq!(
        surface.mesh.triangles.len(),
        16 * capture.mesh.triangles.len()
    );
    let tilt = surface.median_tilt.to_degrees();
    assert!((1.0..6.0).contains(&tilt), "{tilt}°");
    // From the truth.json of spot_paper.
    let sigma = found.brdf.unwrap().sigma;
    assert!((sigma / 0.085 - 1.0).abs() < 0.05, "{sigma}");
    lamps_of_spot_paper_are_found(&found);
}

/// The capture with a mesh as a scanner has it: places off by a part of its size along the normals, and the normals of these.
fn scanned(mut capture: Capture, part: f32) -> Capture {
    let mesh = &mut capture.mesh;
    let noise = part * mesh.diagonal();
    let place_of = mesh.places();
    for (v, place) in place_of.iter().enumerate() {
        let normal = Random(u64::from(*place).wrapping_mul(0x9e37_79b9_7f4a_7c15)).normal();
        let along = mesh.normals[v];
        mesh.positions[v] += noise * normal * along;
    }
    let mut normals = vec![Vec3::ZERO; mesh.positions.len()];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        for v in t {
            normals[place_of[*v as usize] as usize] += (b - a).cross(c - a);
        }
    }
    for (normal, &place) in mesh.normals.iter_mut().zip(&place_of) {
        *normal = normals[place as usize].normalize_or_zero();
    }
    capture
}

/// Median angle between the normals of two meshes of the same vertices, degrees.
fn median_off(one: &Capture, other: &Capture) -> f32 {
    let pairs = one.mesh.normals.iter().zip(&other.mesh.normals);
    let mut off: Vec<f32> = pairs
        .map(|(a, b)| a.angle_between(*b).to_degrees())
        .collect();
    off.sort_by(f32::total_cmp);
    off[off.len() / 2]
}

#[test]
fn a_mesh_with_a_scanners_noise_is_smoothed_and_refined() {
    let capture = scanned(load(), 5e-4);
    let off = median_off(&capture, &load());
    assert!(off > 2.0, "{off}°");
    let found = fast(&capture);
    assert!(found.refined.is_some(), "{:?}", found.diagnostics);
    // From the truth.json of spot_paper.
    let sigma = found.brdf.unwrap().sigma;
    assert!((sigma / 0.085 - 1.0).abs() < 0.05, "{sigma}");
    lamps_of_spot_paper_are_found(&found);
}

/// Whether both lamps of `spot_paper` (from its truth.json) are found within 1°, and hardly any other light.
fn lamps_of_spot_paper_are_found(found: &Estimate) {
    lamps_of_spot_paper_are_within(found, 1.0);
}

/// The same within some degrees.
fn lamps_of_spot_paper_are_within(found: &Estimate, most: f32) {
    let lamps = find_lamps(&found.grid, &found.radiance);
    assert!(lamps.len() >= 2, "{:?}", found.diagnostics);
    for truth in LAMPS {
        let off = lamps[..2]
            .iter()
            .map(|lamp| lamp.direction.angle_between(truth).to_degrees())
            .fold(f32::INFINITY, f32::min);
        assert!(off < most, "{off}° off");
    }
    let all: f32 = lamps.iter().map(Lamp::mean_flux).sum();
    let strays: f32 = lamps[2..].iter().map(Lamp::mean_flux).sum();
    assert!(strays < 0.03 * all, "{strays} of {all}");
}

/// `spot_paper` without gloss.
fn matte() -> Capture {
    let mut matte = load();
    for (view, picture) in matte.views.iter_mut().zip(true_diffuse(&load())) {
        Arc::make_mut(&mut view.photograph).radiance = picture;
    }
    matte
}

/// Whether a place of [`half_dull`] has no gloss.
fn is_dull(p: Vec3) -> bool {
    (3.0 * p).floor().element_sum() as i32 % 2 == 0
}

/// `spot_paper` with gloss on half of its surface, and where highlights are, or would be if it weren't dull.
fn half_dull() -> (Capture, Vec<Vec3>) {
    dull_where(is_dull, 1.0)
}

/// Whether a place of [`mostly_dull`] has no gloss.
fn is_mostly_dull(p: Vec3) -> bool {
    (5.0 * p).floor().element_sum() as i32 % 3 != 0
}

/// `spot_paper` with four times the gloss on a third of its surface, and where highlights are, or would be.
fn mostly_dull() -> (Capture, Vec<Vec3>) {
    dull_where(is_mostly_dull, 4.0)
}

/// `spot_paper` without gloss at some places and so many times as much elsewhere, and where highlights are, or would be if none were dull.
fn dull_where(is_dull: fn(Vec3) -> bool, times: f32) -> (Capture, Vec<Vec3>) {
    glossy_by(|p| Vec3::splat(if is_dull(p) { 0.0 } else { times }))
}

/// `spot_paper` with so many times as much gloss at each place, in each channel, and where highlights are, or would be.
fn glossy_by(times: impl Fn(Vec3) -> Vec3) -> (Capture, Vec<Vec3>) {
    let mut capture = load();
    let occluder = Occluder::new(&capture.mesh);
    let mut places = Vec::new();
    for (picture, view) in true_diffuse(&capture).into_iter().zip(&mut capture.views) {
        let surface = ViewSurface::new(&capture.mesh, &occluder, &view.camera);
        let pixels = Arc::make_mut(&mut view.photograph).radiance.iter_mut();
        for (i, (pixel, diffuse)) in pixels.zip(picture).enumerate() {
            let (x, y) = (i as u32 % surface.width, i as u32 / surface.width);
            if let Some(point) = surface.point(&capture.mesh, &view.camera, x, y) {
                if pixel[1] > 1.2 * diffuse[1] {
                    places.push(point.position);
                }
                let gloss = times(point.position);
                *pixel = array::from_fn(|c| diffuse[c] + gloss[c] * (pixel[c] - diffuse[c]));
            }
        }
    }
    assert!(places.len() > 5000, "{}", places.len());
    (capture, places)
}

/// Whether the parts that were found have no gloss where `is_dull` says so, at nearly all of some places.
fn parts_are(found: &Estimate, is_dull: fn(Vec3) -> bool, places: &[Vec3]) {
    let parts = found.parts.as_ref().expect("some of the surface is dull");
    let is_right = |&&p: &&Vec3| is_dull(p) == (parts.glosses[parts.at(p)].strength == 0.0);
    let right = places.iter().filter(is_right).count();
    assert!(
        right as f32 > 0.9 * places.len() as f32,
        "{right} of {}",
        places.len()
    );
}

/// Whether they are those of [`half_dull`].
fn parts_are_half_dull(found: &Estimate, places: &[Vec3]) {
    parts_are(found, is_dull, places);
}

#[test]
fn lights_are_found_where_half_the_surface_has_no_gloss() {
    let (capture, places) = half_dull();
    let found = fast(&capture);
    lamps_of_spot_paper_are_found(&found);
    // From the truth.json of spot_paper.
    let sigma = found.brdf.unwrap().sigma;
    assert!((sigma / 0.085 - 1.0).abs() < 0.05, "{sigma}");
    parts_are_half_dull(&found, &places);
}

#[test]
fn parts_that_reflect_in_a_colour_do_not_colour_the_lights() {
    let metal = Vec3::new(12.0, 8.0, 4.0);
    let (capture, places) = glossy_by(|p| if is_dull(p) { Vec3::ONE } else { metal });
    let [plain, found] = [&load(), &capture].map(fast);
    lamps_of_spot_paper_are_within(&found, 1.0);
    let parts = found
        .parts
        .as_ref()
        .expect("half of the surface is a metal");
    let is_metal = |p: &Vec3| parts.glosses[parts.at(*p)].strength > 4.0;
    let right = places
        .iter()
        .filter(|p| is_metal(p) != is_dull(**p))
        .count();
    assert!(
        right as f32 > 0.9 * places.len() as f32,
        "{right} of {}",
        places.len()
    );
    let strongest = parts
        .glosses
        .iter()
        .max_by(|a, b| a.strength.total_cmp(&b.strength));
    let scale = strongest.unwrap().scale();
    assert!((scale / metal - 1.0).abs().max_element() < 0.1, "{scale}");
    let colour = |found: &Estimate| -> Vec3 {
        let sum: Vec3 = found.radiance.iter().map(|&l| Vec3::from(l)).sum();
        sum / sum.element_sum()
    };
    let off = colour(&found) / colour(&plain) - 1.0;
    assert!(off.abs().max_element() < 0.03, "{off}");
}

#[test]
fn gloss_on_half_of_a_surface_is_found_by_highlights_that_are_clipped() {
    let (capture, places) = half_dull();
    let found = fast(&clipped(capture, 0.005));
    lamps_of_spot_paper_are_within(&found, 2.0);
    parts_are_half_dull(&found, &places);
}

#[test]
fn a_scan_of_a_surface_half_of_which_has_no_gloss_is_refined() {
    let (capture, places) = half_dull();
    let found = fast(&scanned(capture, 5e-4));
    assert!(found.refined.is_some(), "{:?}", found.diagnostics);
    lamps_of_spot_paper_are_within(&found, 2.0);
    parts_are_half_dull(&found, &places);
}

#[test]
fn lights_that_the_shading_contradicts_are_told() {
    with_solver(&matte(), |solver| {
        let by_shading = LightByShading::of(solver).expect("two lamps shade");
        let bears_out =
            |lamps: &[(Vec3, f32)]| by_shading.bears_out(solver, solver.grid, &lit(solver, lamps));
        let [one, other] = [(LAMPS[0], FLUXES[0]), (LAMPS[1], FLUXES[1])];
        assert!(bears_out(&[one, other]), "the lamps as they are");
        let brighter = [one, other].map(|(direction, flux)| (direction, 5.0 * flux));
        assert!(bears_out(&brighter), "their strength is open");
        assert!(!bears_out(&[one]), "one of them alone");
        let turn = glam::Quat::from_rotation_y(0.5);
        let turned = [one, other].map(|(direction, flux)| (turn * direction, flux));
        assert!(!bears_out(&turned), "lamps that are elsewhere");
    });
}

/// Nodes of lamps in directions, of these fluxes.
fn lit(solver: &Solver<'_>, lamps: &[(Vec3, f32)]) -> Vec<[f32; 3]> {
    let mut nodes = vec![[0.0; 3]; solver.grid.directions.len()];
    for &(direction, flux) in lamps {
        nodes[solver.grid.nearest(direction).unwrap()] = [flux; 3];
    }
    nodes
}

// From the truth.json of spot_paper.
const FLUXES: [f32; 2] = [2.353, 1.647];

#[test]
fn shading_tells_lamps_to_half_a_degree() {
    with_solver(&matte(), |solver| {
        let by_shading = LightByShading::of(solver).expect("two lamps shade");
        let lamps = find_lamps(by_shading.grid(), by_shading.nodes());
        assert_eq!(lamps.len(), 2);
        for (lamp, truth) in lamps.iter().zip(LAMPS) {
            let off = lamp.direction.angle_between(truth).to_degrees();
            assert!(off < 0.5, "{off}° off");
            let radius = lamp.angular_radius.to_degrees();
            assert!(radius < 6.0, "a cell is 16° wide, and this {radius}°");
        }
        let ratio = lamps[0].mean_flux() / lamps[1].mean_flux();
        let truth = FLUXES[0] / FLUXES[1];
        assert!((ratio / truth - 1.0).abs() < 0.05, "{ratio} for {truth}");
    });
}

#[test]
fn shading_agrees_with_the_lamps_that_were_there_and_with_no_others() {
    with_solver(&load(), |solver| {
        let agreement = |lamps: &[(Vec3, f32)]| {
            Agreement::of(solver, &lit(solver, lamps), |_| true).expect("there are lamps")
        };
        let there = [(LAMPS[0], FLUXES[0]), (LAMPS[1], FLUXES[1])];
        let close = agreement(&there);
        assert!(close.is_close(), "{close:?}");
        // Nobody knows how bright they were, and shading doesn't say.
        let brighter = there.map(|(direction, flux)| (direction, 5.0 * flux));
        assert!(agreement(&brighter).is_close());
        let false_light = (Vec3::new(0.1, 0.5, 0.86).normalize_or_zero(), 0.8);
        let far = agreement(&[there[0], there[1], false_light]);
        assert!(!far.is_close(), "{far:?}");
        let [one, other] = there;
        let far = agreement(&[(one.0, other.1), (other.0, one.1)]);
        assert!(!far.is_close(), "{far:?}");
        let turn = glam::Quat::from_rotation_y(0.15);
        let far = agreement(&there.map(|(direction, flux)| (turn * direction, flux)));
        assert!(!far.is_close(), "{far:?}");
    });
}

#[test]
fn parts_of_metal_are_not_asked_whether_shading_agrees() {
    // They show what lies on the other side.
    let mut capture = load();
    let occluder = Occluder::new(&capture.mesh);
    for view in &mut capture.views {
        let surface = ViewSurface::new(&capture.mesh, &occluder, &view.camera);
        let pixels = Arc::make_mut(&mut view.photograph).radiance.iter_mut();
        for (i, pixel) in pixels.enumerate() {
            let (x, y) = (i as u32 % surface.width, i as u32 / surface.width);
            let point = surface.point(&capture.mesh, &view.camera, x, y);
            if let Some(point) = point.filter(|point| is_dull(point.position)) {
                *pixel = [0.2 + point.normal.dot(-LAMPS[0]).max(0.0); 3];
            }
        }
    }
    with_solver(&capture, |solver| {
        let there = lit(solver, &[(LAMPS[0], FLUXES[0]), (LAMPS[1], FLUXES[1])]);
        let of_all = Agreement::of(solver, &there, |_| true).expect("there are lamps");
        assert!(!of_all.is_close(), "{of_all:?}");
        let is_painted = |point: &Point| !is_dull(point.position);
        let of_paint = Agreement::of(solver, &there, is_painted).expect("there are lamps");
        assert!(of_paint.is_close(), "{of_paint:?}");
    });
}

#[test]
fn highlights_on_few_parts_point_at_a_lamp_and_a_matte_surface_has_none() {
    let (capture, _) = mostly_dull();
    with_solver(&capture, |solver| {
        let found = highlights::directions(solver);
        assert!(!found.is_empty());
        for direction in &found {
            let off = LAMPS.map(|truth| direction.angle_between(truth).to_degrees());
            assert!(off[0].min(off[1]) < 10.0, "{off:?}: {found:?}");
        }
    });
    with_solver(&matte(), |solver| {
        assert_eq!(highlights::directions(solver), []);
    });
}

#[test]
fn gloss_on_few_parts_of_a_surface_is_found_by_its_highlights() {
    let (capture, places) = mostly_dull();
    let found = fast(&capture);
    let sigma = found.brdf.expect("gloss").sigma;
    // From the truth.json of spot_paper.
    assert!((sigma / 0.085 - 1.0).abs() < 0.1, "{sigma}");
    lamps_of_spot_paper_are_within(&found, 3.0);
    parts_are(&found, is_mostly_dull, &places);
    let said = found.diagnostics.warnings.iter();
    let by_shading = said.filter(|said| said.contains("taken from the shading"));
    assert_eq!(by_shading.count(), 1, "{:?}", found.diagnostics);
    assert!(!found.diagnostics.well_posed);
}

#[test]
fn a_stated_roughness_that_photographs_do_not_show_lights_no_lamps() {
    let params = EstimateParams {
        sigma: Some(0.05),
        ..EstimateParams::default()
    };
    let of = |params: &EstimateParams| {
        with_input(&matte(), |input| estimate(input, params, &mut Unobserved)).unwrap()
    };
    let (open, stated) = (of(&EstimateParams::default()), of(&params));
    assert_eq!(stated.brdf.map(|brdf| brdf.sigma), Some(0.05));
    is_a_multiple(&stated.radiance, &open.radiance);
    let said = stated.diagnostics.warnings.join("\n");
    assert!(said.contains("taken from the shading"), "{said}");
    assert!(!stated.diagnostics.well_posed);
}

/// Fails unless radiances are others times a factor above 0.
fn is_a_multiple(own: &[[f32; 3]], others: &[[f32; 3]]) {
    let sum =
        |nodes: &[[f32; 3]]| -> f64 { nodes.as_flattened().iter().map(|&v| f64::from(v)).sum() };
    let factor = sum(own) / sum(others);
    assert!(factor > 0.0, "{factor}");
    for (&own, &other) in own.as_flattened().iter().zip(others.as_flattened()) {
        let (own, other) = (f64::from(own), factor * f64::from(other));
        assert!((own - other).abs() <= 1e-4 * own, "{own} for {other}");
    }
}

#[test]
fn a_stated_gloss_is_as_strong_as_views_allow_under_the_light_by_shading() {
    let of_capture = |capture: &Capture| {
        with_solver(capture, |solver| {
            let stated = Solver {
                sigma: Some(0.085),
                coarse: solver.coarse.clone(),
                coarse_sees: solver.coarse_sees.clone(),
                ..*solver
            };
            let light = LightByShading::of(&stated).expect("two lamps shade");
            let mut watch = Watch {
                iterations: &mut Vec::new(),
                observer: &mut Unobserved,
            };
            let choice = SpecularChoice::Model(SpecularModel::Paper);
            let found = under_shading::stated(&stated, &light, choice, &mut watch).unwrap();
            found.map(|ending| (ending, light.nodes().to_vec()))
        })
    };
    // The roughness of spot_paper's truth.json.
    let (glossy, by_shading) = of_capture(&load()).expect("a lobe");
    assert_eq!(glossy.fit.brdf.sigma, 0.085);
    assert_eq!(glossy.grounds, Grounds::StatedUnderShading);
    is_a_multiple(&glossy.fit.nodes, &by_shading);
    let reflectance = |ending: &Ending, by_shading: &[[f32; 3]]| {
        let green = |nodes: &[[f32; 3]]| nodes.iter().map(|l| l[1]).sum::<f32>();
        8.0 * PI * 0.085 * 0.085 * green(&ending.fit.nodes) / green(by_shading)
    };
    let (matt, by_shading_of_matt) = of_capture(&matte()).expect("a lobe");
    let least = reflectance(&matt, &by_shading_of_matt);
    assert!((least - 0.01).abs() < 1e-4, "{least}");
    assert!(reflectance(&glossy, &by_shading) > 3.0 * least);
}

#[test]
fn light_is_sought_near_where_it_is_known_to_come_from_and_nowhere_else() {
    let (capture, _) = half_dull();
    with_solver(&capture, |solver| {
        let near = solver.near_to(&LAMPS);
        assert!(near.roots().len() * 10 < solver.roots().len());
        let mut watch = Watch {
            iterations: &mut Vec::new(),
            observer: &mut Unobserved,
        };
        let parts = near.strengths(&mut watch).unwrap().expect("gloss on half");
        let parted = near.parted(&parts);
        let mut fit = parted
            .compare_sigmas(SpecularModel::Paper, None, &mut watch)
            .unwrap();
        parted.improve_coarse(&mut fit, &mut watch).unwrap();
        let directions = &fit.state.design.geometry.directions;
        let lit = fit.state.lit();
        let flux = |k: usize| fit.state.radiance[k][1];
        let all: f32 = lit.iter().map(|&k| flux(k)).sum();
        for truth in LAMPS {
            let at = |k: &&usize| directions[**k].angle_between(truth) < 0.15;
            let share = lit.iter().filter(at).map(|&k| flux(k)).sum::<f32>() / all;
            assert!(share > 0.3, "{share}");
        }
        for &k in &lit {
            let off = LAMPS.map(|truth| directions[k].angle_between(truth));
            assert!(off[0].min(off[1]) < 0.25, "{off:?}");
        }
    });
}

#[test]
fn what_is_found_near_light_by_shading_is_taken_only_if_it_is_sound() {
    let (capture, _) = half_dull();
    with_solver(&capture, |solver| {
        let rules = Rules {
            choice: SpecularChoice::Auto,
            exposures: None,
        };
        let light = LightByShading::of(solver).expect("two lamps shade");
        let sought_near = |directions: &[Vec3]| {
            let mut watch = Watch {
                iterations: &mut Vec::new(),
                observer: &mut Unobserved,
            };
            course::borne_out(solver, (&light, directions), rules, &mut watch).unwrap()
        };
        let Some(Outcome::Found(ending)) = sought_near(&light.directions()) else {
            panic!("the lamps are where they shade");
        };
        assert!(!ending.has_light_away_from(solver, &LAMPS));
        assert!(ending.has_light_away_from(solver, &LAMPS[..1]));
        let turn = glam::Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
        let elsewhere = LAMPS.map(|lamp| turn * lamp);
        assert!(
            sought_near(&elsewhere).is_none(),
            "lamps where there are none"
        );
    });
}

#[test]
fn exposures_of_a_matte_object_are_told_too() {
    let factors = [1.5, 0.8, 1.0, 0.6, 1.3, 0.9];
    with_solver(&exposed(matte(), &factors), |solver| {
        let models = [SpecularModel::Metal, SpecularModel::Ggx];
        let gains = by_lights(solver, &models)
            .expect("views share the surface")
            .gains;
        for (gain, factor) in gains.iter().zip(factors) {
            for channel in 0..3 {
                let off = gain[channel] / gains[0][channel] * f64::from(factors[0] / factor) - 1.0;
                assert!(off.abs() < 0.04, "{off} of {factor}");
            }
        }
    });
}

#[test]
fn no_cells_show_nothing() {
    with_solver(&load(), |solver| {
        let dark = solver.dark_roots(Brdf::new(SpecularModel::Ggx, 0.1));
        assert!(dark.design.restricted(&[]).matrix(&dark.brdf).is_empty());
    });
}

#[test]
fn light_from_below_the_horizon_is_found_and_not_sought_without_need() {
    let mut capture = load();
    let usual = fast(&capture);
    assert!(!usual.grid.whole, "all lamps are above the horizon");
    // One lamp is 40° below this horizon, the other 19° above it.
    capture.light_hemisphere.up = DVec3::new(1.0, 0.0, -0.15);
    let found = fast(&capture);
    assert!(
        found.grid.whole && found.diagnostics.well_posed,
        "{:?}",
        found.diagnostics
    );
    lamps_of_spot_paper_are_found(&found);
    let ratio = found.brdf.unwrap().sigma / usual.brdf.unwrap().sigma;
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
}

#[test]
fn a_sound_mesh_is_kept() {
    assert!(fast(&load()).refined.is_none());
}

#[test]
fn the_scale_of_the_images_only_scales_the_lights() {
    let capture = load();
    let reference = fast(&capture);
    let brightest = reference
        .radiance
        .iter()
        .flatten()
        .fold(0.0_f32, |m, &v| m.max(v));
    // Powers of two near 1e-4 and 1e4, so that rounding is the same.
    for factor in [2.0_f32.powi(-13), 2.0_f32.powi(13)] {
        let mut scaled = capture.clone();
        for value in scaled.views.iter_mut().flat_map(|v| {
            Arc::make_mut(&mut v.photograph)
                .radiance
                .iter_mut()
                .flatten()
        }) {
            *value *= factor;
        }
        let found = fast(&scaled);
        let (a, b) = (found.brdf.unwrap(), reference.brdf.unwrap());
        assert_eq!(a.model, b.model);
        assert!(
            (a.sigma / b.sigma - 1.0).abs() < 1e-4,
            "{} {}",
            a.sigma,
            b.sigma
        );
        for (x, y) in found
            .radiance
            .iter()
            .flatten()
            .zip(reference.radiance.iter().flatten())
        {
            assert!(
                (x / factor - y).abs() < 1e-3 * brightest,
                "{x} at {factor}, {y} at 1"
            );
        }
    }
}

/// The capture with what is brighter than all but a part of the views' pixels clipped.
fn clipped(mut capture: Capture, part: f64) -> Capture {
    for view in &mut capture.views {
        let photograph = Arc::make_mut(&mut view.photograph);
        let brightness = |pixel: &[f32; 3]| pixel.iter().copied().fold(0.0, f32::max);
        let mut levels: Vec<f32> = photograph.radiance.iter().map(brightness).collect();
        levels.retain(|&level| level > 0.0);
        levels.sort_by(f32::total_cmp);
        let full = levels[((levels.len() - 1) as f64 * (1.0 - part)) as usize];
        let is_full: Vec<bool> = (photograph.radiance.iter())
            .map(|pixel| brightness(pixel) >= full)
            .collect();
        for (i, pixel) in photograph.radiance.iter_mut().enumerate() {
            *pixel = pixel.map(|value| value.min(full));
            photograph.usable[i] &= !is_full[i];
        }
        photograph.clipped = Some(is_full);
    }
    capture
}

#[test]
fn what_is_clipped_is_no_less_bright_for_that() {
    let fluxes = |capture: &Capture| {
        let found = fast(capture);
        let lamps = find_lamps(&found.grid, &found.radiance);
        LAMPS.map(|direction| {
            let near = lamps.iter().filter(|l| l.direction.dot(direction) > 0.99);
            near.map(|l| l.flux[1]).sum::<f32>()
        })
    };
    let whole = fluxes(&load());
    let lost = fluxes(&clipped(load(), 0.12));
    for (lost, whole) in lost.into_iter().zip(whole) {
        assert!((lost / whole - 1.0).abs() < 0.01, "{lost} of {whole}");
    }
}

#[test]
fn a_bound_has_a_say_only_where_it_is_not_met() {
    let mut observations = bare_observations(1, &mut Random(1));
    observations.rows[2].is_bound = true;
    observations.rows[2].radiance = [0.5; 3];
    let grid = HemisphereGrid::new(4, Vec3::Z, None, Vec3::ZERO);
    let design = bare_design(&observations, &Pyramid::new(&grid, 4), &[]);
    let brdf = Brdf::new(SpecularModel::Paper, 0.1);
    let weights = initial_weights(&design);
    assert_eq!(weights[2], 0.0, "nothing contradicts it yet");
    let under = |specular: f32| {
        let mut value = vec![[0.0; 3]; observations.rows.len()];
        value[2] = [specular; 3];
        let left = residuals(&design, &brdf, &weights, &value);
        (left.values[2], robust_weights(&design, &left)[2])
    };
    let (left, weight) = under(0.2);
    assert!(left.iter().all(|&v| (v - 0.3).abs() < 1e-6) && weight > 0.0);
    assert_eq!(under(0.8), ([0.0; 3], 0.0));
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let capture = load();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| fast(&capture))
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(one.brdf, three.brdf);
    assert_eq!(one.sigma_interval95, three.sigma_interval95);
    assert_eq!(one.radiance, three.radiance);
}

/// Says stop some time after the first call, and counts the calls that come nevertheless.
struct StopsAfter {
    since: Option<Instant>,
    patience: Duration,
    stopped: bool,
    ignored: usize,
}

impl StopsAfter {
    fn answer(&mut self) -> ControlFlow<()> {
        self.ignored += usize::from(self.stopped);
        let since = *self.since.get_or_insert_with(Instant::now);
        self.stopped = since.elapsed() >= self.patience;
        if self.stopped {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
}

impl Observer for StopsAfter {
    fn progress(&mut self, _: &str, _: f32) -> ControlFlow<()> {
        self.answer()
    }

    fn iteration(&mut self, _: &Iteration, _: &dyn Fn() -> Vec<[f32; 3]>) -> ControlFlow<()> {
        self.answer()
    }
}

#[test]
fn a_stop_at_any_moment_is_heard_once() {
    let capture = load();
    for method in [Method::Fast, Method::Amuh, Method::Amhu] {
        for milliseconds in [0, 1, 7, 23, 60, 140, 310] {
            let mut observer = StopsAfter {
                since: None,
                patience: Duration::from_millis(milliseconds),
                stopped: false,
                ignored: 0,
            };
            let result = run_on(&capture, method, &mut observer);
            assert_eq!(
                observer.stopped,
                result.is_err(),
                "{method:?} {milliseconds}"
            );
            assert_eq!(observer.ignored, 0, "{method:?} {milliseconds}");
        }
    }
}

/// A reproducible sequence of numbers.
pub struct Random(pub u64);

impl Random {
    /// Uniform in (0, 1).
    fn uniform(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 40) as f32 + 0.5) / 16_777_216.0
    }

    /// Of mean 0 and variance 1.
    fn normal(&mut self) -> f32 {
        (-2.0 * self.uniform().ln()).sqrt() * (2.0 * PI * self.uniform()).cos()
    }

    /// Within `spread` radians of the pole, about.
    fn direction(&mut self, spread: f32) -> Vec3 {
        let (x, y) = (spread * self.normal(), spread * self.normal());
        Vec3::new(x, y, 1.0).normalize_or_zero()
    }
}

/// Points of a bumpy plane under six cameras; black so far.
pub fn bare_observations(points: usize, random: &mut Random) -> Observations {
    let cameras: Vec<Vec3> = (0..6)
        .map(|k| {
            let a = k as f32 * PI / 3.0;
            Vec3::new(0.5 * a.cos(), 0.5 * a.sin(), 0.8).normalize_or_zero()
        })
        .collect();
    let mut all = Observations {
        glosses: vec![Gloss::MAIN],
        points: Vec::new(),
        rows: Vec::new(),
        scale: 1.0,
        gray: false,
    };
    for _ in 0..points {
        let normal = random.direction(0.25);
        let first = all.rows.len();
        all.rows
            .extend(cameras.iter().enumerate().map(|(view, &to_camera)| Row {
                is_bound: false,
                view,
                to_camera,
                cos_view: normal.dot(to_camera),
                radiance: [0.0; 3],
                detail: 0.0,
                irradiance: 1.0,
                placed: None,
            }));
        all.points.push(Point {
            position: Vec3::ZERO,
            normal,
            on: (0, glam::Vec2::ZERO),
            pixel: (0, 0, 0),
            gloss: 0,
            rows: first..all.rows.len(),
        });
    }
    all
}

/// Their design on some cells, without shadows.
pub fn bare_design<'a>(
    observations: &'a Observations,
    pyramid: &Pyramid,
    cells: &[Cell],
) -> Design<'a> {
    Design {
        observations,
        geometry: pyramid.geometry(cells),
        near: None,
        seen: SeenCells::default(),
        diffuse_known: false,
        shortcuts: &SHORTCUTS,
        workspace: &WORKSPACE,
        stop: &NEVER,
    }
}

/// A grid with its cells near the pole, and the radiance of two lamps on them.
fn two_lamps(frequency: u32) -> (Pyramid, Vec<Cell>, Vec<[f32; 3]>) {
    let grid = HemisphereGrid::new(frequency, Vec3::Z, None, Vec3::ZERO);
    let pyramid = Pyramid::new(&grid, frequency);
    let cells: Vec<Cell> = pyramid
        .roots()
        .into_iter()
        .filter(|c| grid.directions[c.node as usize].z > 0.75)
        .collect();
    let lamps = [
        (Vec3::new(0.3, 0.1, 0.9), [60.0, 50.0, 40.0]),
        (Vec3::new(-0.3, -0.2, 0.9), [20.0, 25.0, 30.0]),
    ];
    let radiance = cells
        .iter()
        .map(|c| {
            let d = grid.directions[c.node as usize];
            let near = |lamp: &&(Vec3, [f32; 3])| d.angle_between(lamp.0) < 0.07;
            lamps.iter().find(near).map_or([0.0; 3], |lamp| lamp.1)
        })
        .collect();
    (pyramid, cells, radiance)
}

/// Solves made observations with noise of a known size; σ and its standard error.
fn fit_with_noise(seed: u64, sigma: f32, noise: f32) -> (f32, f32) {
    let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let (pyramid, cells, lamps) = two_lamps(20);
    let mut observations = bare_observations(250, &mut random);
    let brdf = Brdf::new(SpecularModel::Paper, sigma);
    let specular = bare_design(&observations, &pyramid, &cells)
        .predict(&brdf, &lamps)
        .value;
    let Observations { points, rows, .. } = &mut observations;
    for point in points.iter() {
        let diffuse = [0; 3].map(|_| 0.2 + random.uniform());
        for k in point.rows.clone() {
            for c in 0..3 {
                rows[k].radiance[c] = diffuse[c] + specular[k][c] + noise * random.normal();
            }
        }
    }
    let start = Brdf {
        sigma: 1.15 * sigma,
        ..brdf
    };
    let observations = observations.to_gray();
    let mut state = State::new(bare_design(&observations, &pyramid, &cells), cells, start);
    state.solve_lights(EXACT);
    for _ in 0..8 {
        state.reweight();
        state.solve_lights(EXACT);
        state.brdf.sigma += state.sigma_step().step as f32;
    }
    state.solve_lights(EXACT);
    let step = state.sigma_step();
    let error = state.settle_sigma(&step, EXACT);
    (state.brdf.sigma, error as f32)
}

#[test]
fn the_interval_of_sigma_covers_the_truth_as_often_as_it_says() {
    let sigma = 0.09;
    let fits: Vec<(f32, f32)> = (1..=60)
        .map(|seed| fit_with_noise(seed, sigma, 0.02))
        .collect();
    let covered = fits
        .iter()
        .filter(|(s, e)| (s - sigma).abs() < 1.96 * e)
        .count();
    let mean = fits.iter().map(|f| f.0).sum::<f32>() / 60.0;
    // Of 60 intervals that cover with 95 %, fewer than 51 do so once in a thousand times.
    assert!(covered >= 51, "{covered} of 60, mean {mean}");
    // And an interval that says nothing would cover always.
    assert!(fits.iter().all(|(s, e)| *e < 0.1 * s), "too wide");
}

#[test]
fn rows_derivatives_by_sigma_agree_with_finite_differences() {
    let mut random = Random(5);
    let observations = bare_observations(40, &mut random);
    let grid = HemisphereGrid::new(24, Vec3::Z, None, Vec3::ZERO);
    let pyramid = Pyramid::new(&grid, 11);
    // Coarse cells, whose extent blurs the lobe.
    let cells = pyramid.roots();
    let design = bare_design(&observations, &pyramid, &cells);
    let radiance = vec![[1.0; 3]; cells.len()];
    for model in SpecularModel::ALL {
        let at = |sigma: f32| design.predict(&Brdf::new(model, sigma), &radiance);
        let (low, mid, high) = (at(0.118), at(0.12), at(0.122));
        for k in 0..observations.rows.len() {
            let difference = (high.value[k][0] - low.value[k][0]) / 0.004;
            let analytic = mid.by_sigma[k][0];
            assert!(
                (difference - analytic).abs() < 5e-3 * (1.0 + analytic.abs()),
                "{model:?}: {analytic} against {difference}"
            );
        }
    }
}

#[test]
fn small_differences_of_exposure_are_found_with_the_lights() {
    let capture = load();
    let factors = [1.008, 0.994, 1.0, 1.01, 0.99, 0.998];
    let darker = factors.map(|f: f64| f.recip());
    let found = fast(&registration::evened(&capture, &darker));
    let mean = factors.iter().sum::<f64>() / factors.len() as f64;
    assert_eq!(found.exposures.len(), factors.len(), "none found");
    for (exposure, factor) in found.exposures.iter().zip(factors) {
        assert!(
            (exposure / (factor / mean) - 1.0).abs() < 0.002,
            "{exposure} for {factor}"
        );
    }
    assert!(fast(&capture).exposures.is_empty());
}

#[test]
fn noise_is_not_taken_for_lamps() {
    let clean = load();
    for seed in 1..=3 {
        let mut capture = clean.clone();
        for (i, view) in capture.views.iter_mut().enumerate() {
            let radiance = &mut Arc::make_mut(&mut view.photograph).radiance;
            for (k, pixel) in radiance.iter_mut().enumerate() {
                let place = (seed * 10 + i) * 1_000_000 + k;
                let mut random = Random(place as u64 * 0x9e37_79b9_7f4a_7c15);
                *pixel = pixel.map(|v| v * (1.0 + 0.03 * random.normal()));
            }
        }
        let found = fast(&capture);
        let up = capture.light_hemisphere.up.as_vec3();
        let grid = HemisphereGrid::new(40, up, None, capture.mesh.centre());
        let lamps = find_lamps(&grid, &found.radiance);
        assert_eq!(lamps.len(), 2, "{lamps:?}");
    }
}

/// A solver's cells all around, as [`broad_light`] has them.
fn with_cells_around<R>(then: impl FnOnce(&Solver<'_>, &[Cell]) -> R) -> R {
    with_solver(&load(), |solver| {
        let around = AllAround::on_cells_of(solver, broad_light::FREQUENCY);
        let whole = around.solver(solver);
        then(&whole, &whole.pyramid.roots())
    })
}

#[test]
fn what_a_metal_mirrors_beside_its_lights_is_light_and_what_paint_shows_is_not() {
    with_cells_around(|solver, cells| {
        let brdf = Brdf::new(SpecularModel::Metal, 0.08);
        let mut observations = solver.colours(1500);
        let dark = vec![[0.0; 3]; solver.grid.directions.len()];
        let find = |observations: &Observations| {
            broad_light::mirrored_in(solver, observations, cells, (brdf, &dark))
        };
        let against_colours = |observations: &Observations| {
            broad_light::against_colours_in(solver, observations, cells, (brdf, &dark))
        };
        // A room: brighter and bluer towards +X, warm below.
        let directions = solver.pyramid.geometry(cells).directions;
        let of_room = |d: &Vec3| [0.5 - 0.3 * d.y, 0.5 + 0.2 * d.x, 0.5 + 0.4 * d.x];
        let room: Vec<[f32; 3]> = directions.iter().map(of_room).collect();
        let shown =
            (solver.shadowed_design(&observations, cells, &brdf)).predict_values(&brdf, &room);
        for (row, shown) in observations.rows.iter_mut().zip(shown) {
            row.radiance = shown;
        }
        let found = find(&observations).expect("it mirrors the room");
        let mut errors: Vec<f32> = (found.iter().zip(&room))
            .map(|(f, r)| Vec3::from(*f).distance(Vec3::from(*r)) / Vec3::from(*r).length())
            .collect();
        errors.sort_by(f32::total_cmp);
        let median = errors[errors.len() / 2];
        assert!(median < 0.1, "off by {median}");
        assert!(against_colours(&observations) > SURE);
        let metal = observations.clone();
        // The same object painted, under light from above.
        for point in &observations.points {
            let lit = 0.2 + point.normal.y.max(0.0);
            let colour = [
                0.3,
                0.2,
                0.5 + 0.4 * (9.0 * point.position.x).sin().signum(),
            ];
            for row in &mut observations.rows[point.rows.clone()] {
                row.radiance = colour.map(|c| c * lit);
            }
        }
        assert!(find(&observations).is_none(), "paint is no light");
        assert!(against_colours(&observations) < -SURE);
        // One side of metal, the other painted, each asked by itself.
        let middle = solver.seen.mesh.centre().x;
        let is_metal = |point: &Point| point.position.x > middle;
        let mut mixed = observations.clone();
        for point in metal.points.iter().filter(|point| is_metal(point)) {
            let own = point.rows.clone();
            mixed.rows[own.clone()].copy_from_slice(&metal.rows[own]);
        }
        assert!(against_colours(&mixed.of_points(is_metal)) > SURE);
        assert!(against_colours(&mixed.of_points(|point| !is_metal(point))) < -SURE);
        // And in white all over.
        for point in &observations.points {
            for row in &mut observations.rows[point.rows.clone()] {
                row.radiance = [0.2 + point.normal.y.max(0.0); 3];
            }
        }
        assert!(against_colours(&observations) < -SURE);
    });
}
