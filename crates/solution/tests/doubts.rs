//! Captures with one thing wrong: every wrong result says so and names what is wrong, and right ones are not doubted.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use exr::prelude::{read_first_rgba_layer_from_file, write_rgba_file};
use glam::{DAffine3, DMat3, Vec3};
use rekindle_capture::{Capture, Photograph, read_radiance};
use rekindle_estimate::estimate::{EstimateParams, Unobserved};
use rekindle_scene::reflectance::Brdf;
use rekindle_solution::{Solution, SolveOptions, solve};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/captures")
        .join(name)
}

fn solved(capture: &Capture) -> Solution {
    let options = SolveOptions {
        estimate: EstimateParams::default(),
        frequency: 70,
        radius: None,
        light_frame: None,
    };
    solve(capture, &options, 0.0, &mut Unobserved).unwrap()
}

/// The solution of a capture after a change.
fn changed(name: &str, change: impl Fn(&mut Capture)) -> Solution {
    let mut capture = Capture::load(&folder(name)).unwrap();
    change(&mut capture);
    solved(&capture)
}

/// Fails unless a solution is doubted in words that hold all of some.
fn assert_doubted(solution: &Solution, what: &str, words: &[&str]) {
    let said = solution.diagnostics.warnings.join("\n");
    assert!(
        !solution.diagnostics.well_posed,
        "{what} is trusted: {said}"
    );
    for word in words {
        assert!(said.contains(word), "{what}: {said}");
    }
}

/// Every value of every photograph, which depends on itself alone.
fn change_pixels(capture: &mut Capture, value: impl Fn(f32) -> f32) {
    for view in &mut capture.views {
        let photograph = &view.photograph;
        let radiance = photograph.radiance.iter();
        view.photograph = Arc::new(Photograph {
            radiance: radiance.map(|pixel| pixel.map(&value)).collect(),
            coverage: photograph.coverage.clone(),
            usable: photograph.usable.clone(),
            clipped: photograph.clipped.clone(),
            ..**photograph
        });
    }
}

/// sRGB's encoding of a linear value.
fn encoded(v: f32) -> f32 {
    if v <= 0.003_130_8 {
        12.92 * v
    } else {
        1.055 * v.powf(1.0 / 2.4) - 0.055
    }
}

#[test]
fn sound_captures_are_not_doubted() {
    for name in ["spot_paper", "spot_plastic", "spot_near"] {
        let solution = changed(name, |_| ());
        let warnings = &solution.diagnostics.warnings;
        assert!(solution.diagnostics.well_posed, "{name}: {warnings:?}");
        assert!(warnings.is_empty(), "{name}: {warnings:?}");
        let misfit = solution.fit.misfit.unwrap();
        assert!(misfit < 0.02, "{name}: {misfit}");
    }
}

#[test]
fn a_wrong_distance_of_the_lights_is_named() {
    let near = |radius| move |capture: &mut Capture| capture.light_hemisphere.radius = Some(radius);
    let wrong = changed("spot_paper", near(5.0));
    assert_doubted(
        &wrong,
        "radius 5 of distant lights",
        &["Distant lights", "5"],
    );
    let wrong = changed("spot_plastic", near(20.0));
    assert_doubted(
        &wrong,
        "radius 20 of distant lights",
        &["Distant lights", "20"],
    );
    let wrong = changed("spot_near", |capture| {
        let radius = &mut capture.light_hemisphere.radius;
        *radius = radius.map(|radius| 1.2 * radius);
    });
    assert_doubted(
        &wrong,
        "a radius a fifth too large",
        &["Lights at a distance of about"],
    );
    let wrong = changed("spot_near", |capture| {
        capture.light_hemisphere.radius = None;
    });
    assert_doubted(&wrong, "near lights as distant", &["than distant ones"]);
}

#[test]
fn encoded_pictures_are_named() {
    for name in ["spot_paper", "spot_plastic"] {
        let wrong = changed(name, |capture| change_pixels(capture, encoded));
        assert_doubted(&wrong, name, &["not linear", "decoded as a display's"]);
        let [low, high] = wrong.sigma_interval95.unwrap();
        let right = changed(name, |_| ()).brdf.unwrap().sigma;
        // The interval reaches to where the decoded pictures have it.
        let reach = 0.08 * right;
        assert!(
            low - reach < right && right < high + reach,
            "{low} to {high}"
        );
    }
}

#[test]
fn normals_that_are_off_are_doubted() {
    let wrong = changed("spot_paper", |capture| {
        for (i, normal) in capture.mesh.normals.iter_mut().enumerate() {
            let wave = |k: f32| (k * i as f32).sin();
            let tilt = Vec3::new(wave(12.9), wave(78.2), wave(37.7));
            *normal = (*normal + 0.03 * tilt).normalize_or_zero();
        }
    });
    assert_doubted(&wrong, "normals off by degrees", &["Normals turned by"]);
}

/// A capture whose camera number `view` is carried about the object by an angle.
fn orbited(name: &str, view: usize, degrees: f64) -> Solution {
    changed(name, |capture| {
        let centre = capture.mesh.centre().as_dvec3();
        let turn = DAffine3::from_translation(centre)
            * DAffine3::from_rotation_y(degrees.to_radians())
            * DAffine3::from_translation(-centre);
        let camera = &mut capture.views[view].camera;
        camera.world_from_camera = turn * camera.world_from_camera;
    })
}

/// The solution's lamps are those of another within an angle, degrees.
fn assert_same_lamps(solution: &Solution, other: &Solution, degrees: f32) {
    assert_eq!(solution.lamps.len(), other.lamps.len());
    for lamp in &solution.lamps {
        let angle = |other: Vec3| lamp.direction.angle_between(other).to_degrees();
        let nearest = other.lamps.iter().map(|lamp| angle(lamp.direction));
        let nearest = nearest.fold(f32::INFINITY, f32::min);
        assert!(nearest < degrees, "a lamp is off by {nearest}°");
    }
}

#[test]
fn a_camera_that_stood_elsewhere_is_moved_back() {
    let mended = orbited("spot_near", 4, 1.0);
    assert!(
        mended.diagnostics.well_posed,
        "{:?}",
        mended.diagnostics.warnings
    );
    assert_same_lamps(&mended, &changed("spot_near", |_| ()), 0.1);
}

#[test]
fn a_camera_that_looks_away_is_left_out() {
    let away = changed("spot_paper", |capture| {
        let pose = &mut capture.views[0].camera.world_from_camera;
        pose.matrix3 = DMat3::from_rotation_y(std::f64::consts::PI) * pose.matrix3;
    });
    let said = away.diagnostics.warnings.join("\n");
    assert!(away.diagnostics.well_posed, "{said}");
    assert!(said.contains("view_000.exr does not fit"), "{said}");
    assert_same_lamps(&away, &changed("spot_paper", |_| ()), 0.3);
}

#[test]
fn a_view_that_contradicts_the_others_is_left_out() {
    // Out of focus: its highlights are wider and weaker than the others'.
    let blurred = changed("spot_near", |capture| {
        let photograph = &capture.views[4].photograph;
        let width = photograph.width as usize;
        let near = |i: usize| {
            let around = (0..15 * 15)
                .filter_map(|k| (i + (k / 15) * width + k % 15).checked_sub(7 * (width + 1)));
            let kept = around.filter(|&k| photograph.usable.get(k) == Some(&true));
            let (sum, count) = kept.fold((Vec3::ZERO, 0.0), |(sum, count), k| {
                (sum + Vec3::from(photograph.radiance[k]), count + 1.0)
            });
            (sum / f32::max(count, 1.0)).to_array()
        };
        capture.views[4].photograph = Arc::new(Photograph {
            radiance: (0..photograph.radiance.len()).map(near).collect(),
            coverage: photograph.coverage.clone(),
            usable: photograph.usable.clone(),
            clipped: photograph.clipped.clone(),
            ..**photograph
        });
    });
    let said = blurred.diagnostics.warnings.join("\n");
    assert!(
        said.contains("view_004.exr does not fit the others or the mesh and was left out"),
        "{said}"
    );
    assert!(blurred.diagnostics.well_posed, "{said}");
    assert_same_lamps(&blurred, &changed("spot_near", |_| ()), 0.3);
}

#[test]
fn the_interval_holds_what_one_camera_does() {
    let solution = orbited("spot_paper", 1, 0.5);
    let truth = std::fs::read(folder("spot_paper").join("truth/truth.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_slice(&truth).unwrap();
    let sigma = truth["material"]["sigma"].as_f64().unwrap() as f32;
    let [low, high] = solution.sigma_interval95.unwrap();
    assert!((low..high).contains(&sigma), "{low} {high}");
}

#[test]
fn one_view_of_another_exposure_or_balance_changes_nothing() {
    let usual = changed("spot_paper", |_| ());
    for gain in [[4.0, 4.0, 4.0], [1.05, 1.0, 0.95]] {
        let evened = changed("spot_paper", |capture| {
            let photograph = &capture.views[3].photograph;
            let brighter = |p: &[f32; 3]| std::array::from_fn(|c| p[c] * gain[c]);
            capture.views[3].photograph = Arc::new(Photograph {
                radiance: photograph.radiance.iter().map(brighter).collect(),
                coverage: photograph.coverage.clone(),
                usable: photograph.usable.clone(),
                clipped: photograph.clipped.clone(),
                ..**photograph
            });
        });
        assert_eq!(evened.lamps.len(), usual.lamps.len(), "{gain:?}");
        for (one, other) in evened.lamps.iter().zip(&usual.lamps) {
            let change = one.flux.element_sum() / other.flux.element_sum() - 1.0;
            assert!(change.abs() < 0.01, "{gain:?}: a flux changes by {change}");
        }
    }
}

#[test]
fn a_lit_background_without_alpha_stays_out_of_the_texture() {
    let usual = changed("spot_paper", |_| ());
    let lit = changed("spot_paper", |capture| {
        for view in &mut capture.views {
            let photograph = &view.photograph;
            let coverage = photograph.coverage.as_ref().unwrap();
            let over = |(p, cover): (&[f32; 3], &f32)| p.map(|v| v + 10.0 * (1.0 - cover));
            view.photograph = Arc::new(Photograph {
                radiance: photograph.radiance.iter().zip(coverage).map(over).collect(),
                coverage: None,
                usable: photograph.usable.clone(),
                clipped: photograph.clipped.clone(),
                ..**photograph
            });
        }
    });
    assert!(lit.diagnostics.well_posed);
    let said = lit.diagnostics.warnings.join(" ");
    assert!(said.contains("background is not black"), "{said}");
    let mean = |solution: &Solution| {
        let fits = &solution.fit.psnr_db_per_view;
        fits.iter().sum::<f32>() / fits.len() as f32
    };
    let loss = mean(&usual) - mean(&lit);
    assert!(loss < 1.0, "views are reproduced worse by {loss} dB");
    let texels = usual.diffuse.iter().flatten();
    let brightest = texels.fold(0.0_f32, |m, &v| m.max(v));
    let texels = lit.diffuse.iter().flatten();
    let brightest_lit = texels.fold(0.0_f32, |m, &v| m.max(v));
    assert!(
        brightest_lit < 1.5 * brightest,
        "{brightest_lit} for {brightest}"
    );
}

#[test]
fn a_mesh_with_holes_is_doubted() {
    let wrong = changed("spot_paper", |capture| {
        let mut triangles = capture.mesh.triangles.clone();
        let mut index = 0_usize;
        triangles.retain(|_| {
            index += 1;
            // A fifth of them, here and there.
            (index * 7919) % 1000 >= 200
        });
        capture.mesh.triangles = triangles;
    });
    assert_doubted(
        &wrong,
        "a fifth of the triangles missing",
        &["back of triangles", "holes"],
    );
}

#[test]
fn light_without_detail_gives_no_more_than_a_bound_of_the_roughness() {
    let solution = changed("spot_uniform", |_| ());
    assert_doubted(&solution, "an even sky", &["no detail"]);
    let [low, high] = solution.sigma_interval95.unwrap();
    assert!(low == 0.0 && solution.brdf.unwrap().sigma < high, "{high}");
}

#[test]
fn hot_pixels_are_left_out_and_change_nothing() {
    let copy = tempfile::tempdir().unwrap();
    let source = folder("spot_paper");
    let name = |view: usize| format!("images/view_{view:03}.exr");
    std::fs::create_dir(copy.path().join("images")).unwrap();
    for file in ["mesh.obj", "transforms.json"] {
        std::fs::copy(source.join(file), copy.path().join(file)).unwrap();
    }
    for view in 0..6 {
        let image = read_first_rgba_layer_from_file(
            source.join(name(view)),
            |size, _| vec![vec![[0.0_f32; 4]; size.width()]; size.height()],
            |pixels, at, (r, g, b, a): (f32, f32, f32, f32)| {
                pixels[at.y()][at.x()] = [r, g, b, a];
            },
        )
        .unwrap();
        let mut pixels = image.layer_data.channel_data.pixels;
        // Here and there on the object, at least two apart.
        let mut hot = 0;
        for y in (20..220).step_by(9) {
            let x = 110 + (y * 37 + view * 11) % 100;
            if pixels[y][x][3] == 1.0 {
                pixels[y][x] = pixels[y][x].map(|v| 1000.0 * v);
                pixels[y][x][3] = 1.0;
                hot += 1;
            }
        }
        assert!(hot > 5, "too few hot pixels: {hot}");
        let at = |x: usize, y: usize| pixels[y][x].into();
        let size = (pixels[0].len(), pixels.len());
        write_rgba_file(copy.path().join(name(view)), size.0, size.1, |x, y| {
            let pixel: (f32, f32, f32, f32) = at(x, y);
            pixel
        })
        .unwrap();
    }
    let solution = solved(&Capture::load(copy.path()).unwrap());
    let warnings = solution.diagnostics.warnings.join("\n");
    assert!(solution.diagnostics.well_posed, "{warnings}");
    assert!(warnings.contains("hot pixels"), "{warnings}");
    let usual = changed("spot_paper", |_| ());
    let sigma = |solution: &Solution| solution.brdf.unwrap().sigma;
    let change = sigma(&solution) / sigma(&usual) - 1.0;
    assert!(change.abs() < 2e-3, "σ changes by {change}");
    for (one, other) in solution.lamps.iter().zip(&usual.lamps) {
        let off = one.direction.angle_between(other.direction).to_degrees();
        assert!(off < 0.05, "a light moves by {off}°");
    }
}

fn with_roughness(capture: &Capture, roughness: f32) -> Solution {
    let options = SolveOptions {
        estimate: EstimateParams {
            sigma: Some(Brdf::sigma_of(roughness)),
            ..EstimateParams::default()
        },
        frequency: 40,
        radius: None,
        light_frame: None,
    };
    solve(capture, &options, 0.0, &mut Unobserved).unwrap()
}

#[test]
fn a_roughness_that_is_stated_a_little_wrong_is_taken_and_has_lights() {
    let capture = Capture::load(&folder("spot_paper")).unwrap();
    let solution = with_roughness(&capture, 0.36);
    let said = &solution.diagnostics.warnings;
    assert!(solution.diagnostics.specular_found, "{said:?}");
    assert_eq!(solution.brdf.unwrap().sigma, Brdf::sigma_of(0.36));
    // spot_paper has two.
    assert_eq!(solution.lamps.len(), 2);
}

#[test]
fn a_roughness_that_is_stated_of_a_matt_surface_is_taken_and_doubted() {
    let mut capture = Capture::load(&folder("spot_paper")).unwrap();
    for (i, view) in capture.views.iter_mut().enumerate() {
        let file = folder("spot_paper").join(format!("truth/diffuse/view_{i:03}.exr"));
        let photograph = &view.photograph;
        view.photograph = Arc::new(Photograph {
            radiance: read_radiance(&file).unwrap().2,
            coverage: photograph.coverage.clone(),
            usable: photograph.usable.clone(),
            clipped: photograph.clipped.clone(),
            ..**photograph
        });
    }
    let solution = with_roughness(&capture, 0.3);
    assert_doubted(
        &solution,
        "gloss of a matt surface",
        &["do not show", "stated"],
    );
    assert!(solution.diagnostics.specular_found && !solution.lamps.is_empty());
}
