//! Solving under a light that is known: an independent renderer's pictures, with its own picture of the light.

use std::f32::consts::PI;
use std::path::{Path, PathBuf};

use rekindle_capture::Capture;
use rekindle_estimate::estimate::{EstimateParams, Unobserved};
use rekindle_solution::{LightProbe, Solution, SolveOptions, solve_under, write_rgb};

/// Roughness, strength and the turn between the renderer's convention for pictures of light and this one's.
const SIGMA: f32 = 0.085;
const STRENGTH: f32 = 0.35;
const TURN: f32 = 270.0;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/captures/spot_paper")
}

fn solved(light: &LightProbe) -> Solution {
    let capture = Capture::load(&folder()).expect("a capture");
    let options = SolveOptions {
        estimate: EstimateParams::default(),
        frequency: 40,
        radius: None,
        light_frame: None,
    };
    solve_under(&capture, &options, Some(light), 0.0, &mut Unobserved).expect("not stopped")
}

fn probe(turn: Option<f32>) -> LightProbe {
    let picture = folder().join("truth/environment.exr");
    LightProbe::load(&picture, turn.map(f32::to_radians)).expect("a probe")
}

#[test]
fn roughness_and_reflectance_are_absolute_and_highlights_tell_the_turn() {
    let found = solved(&probe(None));
    let known = found.known_light.as_ref().expect("a known light");
    assert!(!known.rotation_stated);
    let off = (known.rotation_deg - TURN).abs();
    assert!(off < 1.0, "turned by {}°", known.rotation_deg);
    let brdf = found.brdf.expect("a specular part");
    assert!((brdf.sigma / SIGMA - 1.0).abs() < 0.05, "σ {}", brdf.sigma);
    let reflectance = 8.0 * PI * SIGMA * SIGMA * STRENGTH;
    let ratio = found.known_reflectance().expect("gloss") / reflectance;
    assert!((ratio - 1.0).abs() < 0.08, "{ratio} times the reflectance");
    assert!(found.diagnostics.well_posed, "{:?}", found.diagnostics);
    // No light beside the given one is made up.
    assert_eq!(found.ambient, glam::Vec3::ZERO);

    // It comes back from its files, with the light's colour and strength.
    let place = tempfile::tempdir().expect("a folder");
    let path = place.path().join("solution");
    found.save(&path).expect("saved");
    let read = Solution::load(&path).expect("read");
    assert_eq!(read.known_light, found.known_light);
    let (was, is) = (found.lighting(), read.lighting());
    assert!(
        (is.specular_scale / was.specular_scale - 1.0)
            .abs()
            .max_element()
            < 1e-4
    );
}

#[test]
fn a_turn_that_is_stated_is_kept_and_a_wrong_one_explains_no_highlights() {
    let right = solved(&probe(Some(TURN)));
    let wrong = solved(&probe(Some(TURN - 180.0)));
    let known = right.known_light.as_ref().expect("a known light");
    assert!(known.rotation_stated && (known.rotation_deg - TURN).abs() < 1e-3);
    assert!(right.diagnostics.well_posed, "{:?}", right.diagnostics);
    assert!(!wrong.diagnostics.well_posed, "{:?}", wrong.diagnostics);
}

#[test]
fn what_is_no_probe_is_refused_with_its_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("probe.exr");
    let refused = |width: u32, pixels: &[[f32; 3]]| {
        write_rgb(&path, width, pixels).expect("written");
        LightProbe::load(&path, None)
            .expect_err("no probe")
            .to_string()
    };
    let mut broken = [[1.0; 3]; 32];
    broken[5][1] = f32::NAN;
    for (width, pixels, reason) in [
        (8, [[0.0; 3]; 32].as_slice(), "black everywhere"),
        (8, &broken, "1 of its pixels are not finite"),
        (16, &[[1.0; 3]; 32], "16×2 pixels"),
    ] {
        let said = refused(width, pixels);
        assert!(
            said.contains(reason) && said.contains("probe.exr"),
            "{said}"
        );
    }
    let eight_bits = folder.path().join("probe.png");
    image::RgbImage::from_pixel(8, 4, image::Rgb([200; 3]))
        .save(&eight_bits)
        .expect("written");
    let said = LightProbe::load(&eight_bits, None)
        .expect_err("no probe")
        .to_string();
    assert!(said.contains("end at white"), "{said}");
    std::fs::write(&path, "no picture").expect("written");
    assert!(LightProbe::load(&path, None).is_err());
}
