//! Captures as files: what other programs write, every bad input, and damaged bytes.

use super::manifest::Manifest;
use super::picture::Picture;
use super::{
    Camera, Capture, CaptureError, Distortion, LightFrame, mesh_file, obj, ply, polygon,
    read_cameras,
};
use glam::{DAffine3, DMat4, DVec2, DVec3, Vec3};
use rekindle_base::damage::{Random, damaged};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};

/// Size of the test images.
const SIZE: (u32, u32) = (8, 6);

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/data/capture")
        .join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    fs::read(data(name)).expect("test data")
}

fn decode(name: &str) -> Result<Picture, CaptureError> {
    Picture::decode(&data(name), &bytes(name), true, &|_| Ok(()))
}

/// A capture of the 2×2×2 box in a folder of its own.
struct Fixture {
    folder: tempfile::TempDir,
    manifest: Value,
}

impl Fixture {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        for name in ["box.obj", "rgba_half_zip.exr"] {
            fs::copy(data(name), folder.path().join(name)).expect("copy");
        }
        let manifest = json!({
            "camera_model": "PINHOLE", "w": SIZE.0, "h": SIZE.1,
            "fl_x": 8.0, "fl_y": 8.0, "cx": 4.0, "cy": 3.0,
            "mesh_path": "box.obj",
            "light_hemisphere": { "up": [0, 1, 0], "radius": null },
            "frames": [{ "file_path": "rgba_half_zip.exr", "transform_matrix": matrix(DVec3::new(0.0, 0.0, 5.0)) }],
        });
        Self { folder, manifest }
    }

    fn add(&self, name: &str) {
        fs::copy(data(name), self.folder.path().join(name)).expect("copy");
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.folder.path().join(name), content).expect("write");
    }

    fn load(&self) -> Result<Capture, CaptureError> {
        let text = serde_json::to_string_pretty(&self.manifest).expect("json");
        self.write("transforms.json", text);
        Capture::load(self.folder.path())
    }

    fn loaded(&self) -> Capture {
        self.load().expect("a good capture")
    }

    fn camera(&self) -> Camera {
        self.loaded().views[0].camera.clone()
    }

    /// The message of the error that loading gives.
    fn message(&self) -> String {
        self.load().expect_err("a bad capture").to_string()
    }
}

/// A camera-to-world matrix without rotation.
fn matrix(position: DVec3) -> Value {
    rows(DMat4::from_translation(position))
}

fn rows(m: DMat4) -> Value {
    json!(m.transpose().to_cols_array_2d())
}

fn assert_close(a: DVec3, b: DVec3, tolerance: f64) {
    assert!((a - b).length() <= tolerance, "{a} is not {b}");
}

/// What the test images show at a pixel: straight RGB and alpha, as in tests/data/capture/make.py.
fn pattern(x: u32, y: u32) -> ([f64; 3], f64) {
    let rgb = [f64::from(x + 1) / 16.0, f64::from(y + 1) / 16.0, 0.25];
    let alpha = match x {
        0..=5 => 1.0,
        6 => 0.5,
        _ => 0.0,
    };
    (rgb, alpha)
}

/// Checks a picture against the pattern; `premultiplied` as it should be, within a relative error.
fn assert_pattern(picture: &Picture, has_alpha: bool, premultiplied: bool, tolerance: f64) {
    assert_eq!((picture.width, picture.height), SIZE);
    assert_eq!(picture.alpha.is_some(), has_alpha);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let i = (y * SIZE.0 + x) as usize;
            let (rgb, alpha) = pattern(x, y);
            let factor = if premultiplied { alpha } else { 1.0 };
            for (c, value) in rgb.into_iter().enumerate() {
                let found = f64::from(picture.rgb[i][c]);
                let error = (found - value * factor).abs();
                assert!(
                    error <= tolerance,
                    "pixel {x} {y} channel {c}: {found}, not {}",
                    value * factor
                );
            }
            if let Some(found) = &picture.alpha {
                assert!(
                    (f64::from(found[i]) - alpha).abs() < 0.003,
                    "alpha at {x} {y}"
                );
            }
        }
    }
}

#[test]
fn images_of_other_programs_read_right() {
    // Name, alpha, premultiplied, tolerance by the precision of the format.
    for (name, alpha, premultiplied, tolerance) in [
        ("rgba_half_zip.exr", true, true, 5e-4),
        ("rgb_float_piz.exr", false, true, 1e-6),
        ("rgba_half_b44.exr", true, true, 0.1),
        ("rgba_half_dwaa.exr", true, true, 0.02),
        ("layers.exr", true, true, 1e-6),
        ("parts.exr", true, true, 1e-6),
        ("radiance.hdr", false, true, 5e-3),
        ("rgba8.png", true, true, 4e-3),
        ("rgba16.png", true, true, 2e-5),
        ("rgb16.tif", false, false, 2e-5),
        ("rgb32f.tif", false, false, 1e-6),
    ] {
        let picture = decode(name).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_pattern(&picture, alpha, premultiplied, tolerance);
        assert!(
            !picture.saturated.contains(&true),
            "{name} is nowhere clipped"
        );
    }
}

#[test]
fn data_window_is_placed_in_the_display_window() {
    let picture = decode("cropped.exr").expect("cropped");
    assert_eq!((picture.width, picture.height), SIZE);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let inside = (1..SIZE.1 - 1).contains(&y) && x < SIZE.0 - 1;
            let (rgb, alpha) = pattern(x, y);
            let expected = if inside { (rgb[0] * alpha) as f32 } else { 0.0 };
            assert_eq!(
                picture.rgb[(y * SIZE.0 + x) as usize][0],
                expected,
                "{x} {y}"
            );
        }
    }
}

/// Also where they overlap in part or not at all, to any side.
#[test]
fn a_moved_display_window_shows_what_lies_in_it() {
    let original = decode("rgba_half_zip.exr").expect("original");
    let name = b"displayWindow\0box2i\0";
    let (width, height) = (SIZE.0 as i32, SIZE.1 as i32);
    for (right, down) in [
        (1, 0),
        (-1, 2),
        (width, 0),
        (width + 3, -1),
        (-width, 0),
        (-width - 3, 0),
        (0, height + 1),
        (0, -height - 1),
    ] {
        let mut exr = bytes("rgba_half_zip.exr");
        let at = exr.windows(name.len()).position(|w| w == name);
        let corners = at.expect("attribute") + name.len() + 4;
        let window = [right, down, right + width - 1, down + height - 1];
        for (k, value) in window.into_iter().enumerate() {
            exr[corners + 4 * k..][..4].copy_from_slice(&value.to_le_bytes());
        }
        let picture = Picture::decode(Path::new("moved.exr"), &exr, true, &|_| Ok(()))
            .unwrap_or_else(|error| panic!("{right} {down}: {error}"));
        let alpha = picture.alpha.as_ref().expect("alpha");
        for (i, rgb) in picture.rgb.iter().enumerate() {
            let (x, y) = (i as i32 % width + right, i as i32 / width + down);
            let inside = (0..width).contains(&x) && (0..height).contains(&y);
            let from = (y * width + x) as usize;
            let there = original.alpha.as_ref().expect("alpha");
            let expected = if inside {
                (original.rgb[from], there[from])
            } else {
                ([0.0; 3], 0.0)
            };
            assert_eq!((*rgb, alpha[i]), expected, "moved by {right}, {down}: {i}");
        }
    }
}

#[test]
fn jpeg_is_decoded_and_its_clipped_half_marked() {
    let picture = decode("rgb8.jpg").expect("jpeg");
    for (i, rgb) in picture.rgb.iter().enumerate() {
        let upper = i < (SIZE.0 * SIZE.1 / 2) as usize;
        assert_eq!(picture.saturated[i], upper);
        // Code 128 is 0.2159 in linear light.
        let expected = if upper { 1.0 } else { 0.2159 };
        assert!((rgb[1] - expected).abs() < 0.02, "{rgb:?}");
    }
}

#[test]
fn exr_without_rgb_names_its_channels() {
    for (name, channels) in [("luminance.exr", "it has Y"), ("depth.exr", "it has A, Z")] {
        let message = decode(name).expect_err("no RGB").to_string();
        assert!(
            message.contains(name) && message.contains(channels),
            "{message}"
        );
    }
}

#[test]
fn truncated_images_are_refused() {
    for name in [
        "rgba_half_zip.exr",
        "rgb_float_piz.exr",
        "parts.exr",
        "radiance.hdr",
        "rgba8.png",
        "rgba16.png",
        "rgb16.tif",
        "rgb32f.tif",
        "rgb8.jpg",
    ] {
        let bytes = bytes(name);
        for share in [0.0, 0.3, 0.6, 0.9] {
            let end = (bytes.len() as f64 * share) as usize;
            // TIFF files may keep their directory before the pixels and metadata behind them.
            let result = Picture::decode(&data(name), &bytes[..end], true, &|_| Ok(()));
            assert!(
                result.is_err(),
                "{name} cut to {end} of {} bytes",
                bytes.len()
            );
        }
    }
}

#[test]
fn enormous_headers_are_refused_without_allocating() {
    // An EXR header is a list of attributes; the display window's and data window's corner is overwritten.
    let mut exr = bytes("rgba_half_zip.exr");
    for name in [&b"dataWindow\0box2i\0"[..], &b"displayWindow\0box2i\0"[..]] {
        let at = exr
            .windows(name.len())
            .position(|w| w == name)
            .expect("attribute");
        let corner = at + name.len() + 4 + 8;
        exr[corner..corner + 8].copy_from_slice(&[0xff, 0xff, 0xff, 0x0f, 0xff, 0xff, 0xff, 0x0f]);
    }
    let message = Picture::decode(Path::new("huge.exr"), &exr, true, &|_| Ok(()))
        .expect_err("huge")
        .to_string();
    assert!(message.contains("huge.exr"), "{message}");
    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 900000 +X 900000\n";
    let message = Picture::decode(Path::new("huge.hdr"), hdr, true, &|_| Ok(()))
        .expect_err("huge")
        .to_string();
    assert!(message.contains("huge.hdr"), "{message}");
}

/// A header may announce only what the file's bytes can hold, however few pixels that are for a camera.
#[test]
fn small_files_cannot_announce_much() {
    let mut exr = bytes("rgba_half_zip.exr");
    let name = b"displayWindow\0box2i\0";
    let at = exr.windows(name.len()).position(|w| w == name);
    let corner = at.expect("attribute") + name.len() + 4 + 8;
    exr[corner..corner + 8].copy_from_slice(&[0x98, 0x3a, 0, 0, 0x98, 0x3a, 0, 0]);
    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 15000 +X 15000\n".to_vec();
    for (name, bytes) in [("a.exr", exr), ("a.hdr", hdr)] {
        let message = Picture::decode(Path::new(name), &bytes, true, &|_| Ok(()))
            .expect_err("refused")
            .to_string();
        assert!(message.contains(name), "{message}");
        assert!(message.contains("bytes can hold"), "{message}");
    }
    // Nothing but white, a bit a pixel, is the smallest that a large picture comes to.
    let mut white = Vec::new();
    let mut encoder = png::Encoder::new(&mut white, 6000, 4000);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::One);
    encoder.set_compression(png::Compression::High);
    encoder.set_filter(png::Filter::NoFilter);
    let mut writer = encoder.write_header().expect("header");
    writer
        .write_image_data(&vec![0xff; 6000 / 8 * 4000])
        .expect("pixels");
    writer.finish().expect("end");
    let picture = Picture::decode(Path::new("mask.png"), &white, true, &|_| Ok(()));
    assert_eq!(picture.expect("a mask").width, 6000);
}

#[test]
fn a_capture_has_what_its_files_say() {
    let capture = Fixture::new().loaded();
    assert!(capture.warnings.is_empty(), "{:?}", capture.warnings);
    assert_eq!(capture.mesh.triangles.len(), 12);
    assert_eq!(capture.light_hemisphere.up, DVec3::Y);
    assert_eq!(capture.light_hemisphere.frame, None);
    assert!(capture.motions().is_none());
    assert_eq!(capture.light_hemisphere.radius, None);
    let photograph = &capture.views[0].photograph;
    assert_eq!(photograph.coverage.as_ref().expect("alpha")[6], 0.5);
    assert_eq!(
        photograph.radiance[6],
        [0.5 * 7.0 / 16.0, 0.5 / 16.0, 0.125]
    );
    assert!(!photograph.usable.contains(&false));
}

#[test]
fn intrinsics_in_every_dialect_give_the_same_camera() {
    let reference = Fixture::new().camera();
    let angle = 2.0 * (0.5_f64).atan();
    let angle_y = 2.0 * (3.0_f64 / 8.0).atan();
    let strip = |fixture: &mut Fixture| {
        let map = fixture.manifest.as_object_mut().expect("object");
        for key in ["camera_model", "w", "h", "fl_x", "fl_y", "cx", "cy"] {
            map.remove(key);
        }
    };
    let variants: [(&str, Value, Value); 6] = [
        ("blender", json!({ "camera_angle_x": angle }), json!({})),
        (
            "blender per frame",
            json!({}),
            json!({ "camera_angle_x": angle }),
        ),
        (
            "both angles",
            json!({ "camera_angle_x": angle, "camera_angle_y": angle_y }),
            json!({}),
        ),
        (
            "frame wins",
            json!({ "fl_x": 99, "fl_y": 98, "cx": 1 }),
            json!({ "fl_x": 8, "fl_y": 8.0, "cx": 4.0, "w": 8.0 }),
        ),
        (
            "frame angle wins",
            json!({ "fl_x": 99 }),
            json!({ "camera_angle_x": angle }),
        ),
        (
            "simple",
            json!({ "camera_model": "SIMPLE_PINHOLE", "fl_x": 8 }),
            json!({}),
        ),
    ];
    for (name, top, frame) in variants {
        let mut fixture = Fixture::new();
        strip(&mut fixture);
        for (key, value) in top.as_object().expect("object") {
            fixture.manifest[key] = value.clone();
        }
        for (key, value) in frame.as_object().expect("object") {
            fixture.manifest["frames"][0][key] = value.clone();
        }
        let camera = fixture.camera();
        assert!(
            (camera.focal - reference.focal).length() < 1e-12,
            "{name}: {:?}",
            camera.focal
        );
        assert!(
            (camera.centre - reference.centre).length() < 1e-12,
            "{name}: {:?}",
            camera.centre
        );
        assert_eq!((camera.width, camera.height), SIZE, "{name}");
    }
}

#[test]
fn distortion_coefficients_are_found_in_every_dialect() {
    let with = |top: Value| {
        let mut fixture = Fixture::new();
        for (key, value) in top.as_object().expect("object") {
            fixture.manifest[key] = value.clone();
        }
        fixture.camera().distortion
    };
    let named = with(
        json!({ "camera_model": "OPENCV", "k1": 0.1, "k2": -0.02, "p1": 0.001, "p2": -0.002 }),
    );
    let expected = Distortion {
        k: [0.1, -0.02, 0.0, 0.0],
        p: [0.001, -0.002],
        ..Distortion::default()
    };
    assert_eq!(named, expected);
    let listed = with(
        json!({ "camera_model": "OPENCV", "distortion_params": [0.1, -0.02, 0, 0, 0.001, -0.002] }),
    );
    assert_eq!(listed, expected);
    let full = with(
        json!({ "camera_model": "FULL_OPENCV", "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4, "k5": 0.5, "k6": 0.6 }),
    );
    assert_eq!(
        (full.k, full.denominator),
        ([0.1, 0.2, 0.3, 0.0], [0.4, 0.5, 0.6])
    );
    assert!(with(json!({ "camera_model": "SIMPLE_RADIAL", "k1": 0.1 })).k[0] == 0.1);
}

#[test]
fn distortion_and_its_inverse_undo_each_other() {
    let mut random = Random(1);
    for _ in 0..200 {
        let mut coefficient = |size: f64| (random.unit() - 0.5) * size;
        let distortion = Distortion {
            k: [
                coefficient(0.3),
                coefficient(0.1),
                coefficient(0.02),
                coefficient(0.01),
            ],
            p: [coefficient(0.01), coefficient(0.01)],
            denominator: [coefficient(0.02), coefficient(0.01), coefficient(0.01)],
            fisheye: false,
        };
        let u = DVec2::new(coefficient(1.4), coefficient(1.4));
        assert!(
            (distortion.remove(distortion.apply(u)) - u).length() < 1e-9,
            "{distortion:?} at {u}"
        );
    }
}

#[test]
fn projection_and_rays_undo_each_other_through_a_lens() {
    let mut fixture = Fixture::new();
    fixture.manifest["camera_model"] = json!("OPENCV");
    fixture.manifest["k1"] = json!(-0.2);
    fixture.manifest["p1"] = json!(0.003);
    let camera = fixture.camera();
    for (x, y) in [(0.5, 0.5), (4.0, 3.0), (7.9, 5.5)] {
        let pixel = DVec2::new(x, y);
        let back = camera
            .project(camera.position() + 3.0 * camera.ray(pixel))
            .expect("in front");
        assert!(
            (back - pixel).length() < 1e-9,
            "{pixel} comes back as {back}"
        );
    }
}

#[test]
fn points_beyond_the_fold_of_a_distortion_are_not_seen() {
    let mut fixture = Fixture::new();
    fixture.manifest["k1"] = json!(-0.3);
    let camera = fixture.camera();
    // At r = 1.8 the polynomial has folded back to r = 0.05, the image's middle.
    let ray = DVec3::new(1.8, 0.0, -1.0);
    assert_eq!(camera.project(camera.position() + ray), None);
}

#[test]
fn applied_transform_is_undone() {
    // What ns-process-data writes: rows permuted, one negated.
    let applied = [
        [1.0, 0.0, 0.0, 0.3],
        [0.0, 0.0, 1.0, -0.2],
        [0.0, -1.0, 0.0, 0.1],
    ];
    let mut fixture = Fixture::new();
    let original = DMat4::from_rotation_y(0.1) * DMat4::from_translation(DVec3::new(0.0, 0.0, 5.0));
    let a = DMat4::from_cols_array_2d(&[
        [applied[0][0], applied[1][0], applied[2][0], 0.0],
        [applied[0][1], applied[1][1], applied[2][1], 0.0],
        [applied[0][2], applied[1][2], applied[2][2], 0.0],
        [applied[0][3], applied[1][3], applied[2][3], 1.0],
    ]);
    let mut moved = a * original;
    moved.w_axis = (moved.w_axis.truncate() * 0.5).extend(1.0);
    fixture.manifest["applied_transform"] = json!(applied);
    fixture.manifest["applied_scale"] = json!(0.5);
    fixture.manifest["frames"][0]["transform_matrix"] = rows(moved);
    let pose = fixture.camera().world_from_camera;
    let expected = DAffine3::from_mat4(original);
    assert_close(pose.translation, expected.translation, 1e-9);
    assert_close(pose.matrix3.x_axis, expected.matrix3.x_axis, 1e-9);
    assert_close(pose.matrix3.z_axis, expected.matrix3.z_axis, 1e-9);
}

#[test]
fn a_mesh_in_the_moved_frame_is_recognised() {
    let mut fixture = Fixture::new();
    fixture.manifest["applied_transform"] = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 400]]);
    let capture = fixture.loaded();
    assert_close(
        capture.views[0].camera.position(),
        DVec3::new(0.0, 0.0, 5.0),
        1e-12,
    );
    assert!(
        capture
            .warnings
            .iter()
            .any(|w| w.contains("applied_transform")),
        "{:?}",
        capture.warnings
    );
}

#[test]
fn a_uniform_scale_in_a_matrix_is_taken_out() {
    let mut fixture = Fixture::new();
    let scaled = DMat4::from_scale_rotation_translation(
        DVec3::splat(2.5),
        glam::DQuat::from_rotation_x(0.2),
        DVec3::new(0.0, -1.0, 5.0),
    );
    fixture.manifest["frames"][0]["transform_matrix"] = rows(scaled);
    let camera = fixture.camera();
    assert!((camera.forward().length() - 1.0).abs() < 1e-12);
    assert_close(camera.position(), DVec3::new(0.0, -1.0, 5.0), 1e-12);
}

#[test]
fn up_is_the_mean_of_the_cameras_and_said() {
    let mut fixture = Fixture::new();
    fixture
        .manifest
        .as_object_mut()
        .expect("object")
        .remove("light_hemisphere");
    let mut frames = Vec::new();
    for angle in [0.3, -0.3] {
        let pose =
            DMat4::from_rotation_x(angle) * DMat4::from_translation(DVec3::new(0.0, 0.0, 5.0));
        frames.push(json!({ "file_path": "rgba_half_zip.exr", "transform_matrix": rows(pose) }));
    }
    fixture.manifest["frames"] = json!(frames);
    let capture = fixture.loaded();
    assert_close(capture.light_hemisphere.up, DVec3::Y, 1e-12);
    assert!(
        capture
            .warnings
            .iter()
            .any(|w| w.contains("mean of the cameras' up")),
        "{:?}",
        capture.warnings
    );
}

#[test]
fn file_paths_without_ending_and_with_backslashes_are_found() {
    let mut fixture = Fixture::new();
    fs::create_dir(fixture.folder.path().join("train")).expect("folder");
    fixture.write("train/r_0.exr", bytes("rgba_half_zip.exr"));
    for name in [
        "./train/r_0",
        "train/r_0",
        "train\\r_0.exr",
        ".\\train\\r_0",
    ] {
        fixture.manifest["frames"][0]["file_path"] = json!(name);
        fixture.loaded();
    }
}

#[test]
fn black_in_a_mask_is_ignored() {
    let mut fixture = Fixture::new();
    let mask: Vec<u8> = (0..SIZE.0 * SIZE.1)
        .map(|i| if i % SIZE.0 < 3 { 0 } else { 255 })
        .collect();
    let path = fixture.folder.path().join("mask.png");
    image::save_buffer(path, &mask, SIZE.0, SIZE.1, image::ColorType::L8).expect("mask");
    fixture.add("rgb_float_piz.exr");
    fixture.manifest["frames"][0]["file_path"] = json!("rgb_float_piz.exr");
    fixture.manifest["frames"][0]["mask_path"] = json!("mask.png");
    let photograph = fixture.loaded().views.remove(0).photograph;
    for (i, &usable) in photograph.usable.iter().enumerate() {
        assert_eq!(usable, i as u32 % SIZE.0 >= 3);
        assert_eq!(
            photograph.coverage.as_ref().expect("mask")[i],
            f32::from(u8::from(usable))
        );
        assert!(usable || photograph.radiance[i] == [0.0; 3]);
    }
}

#[test]
fn clipped_pixels_keep_the_least_that_they_can_be() {
    let mut fixture = Fixture::new();
    let folder = fixture.folder.path().to_owned();
    let pixels = |shown: &dyn Fn(u32) -> u8| -> Vec<u8> {
        (0..3 * SIZE.0 * SIZE.1).map(|i| shown(i / 3)).collect()
    };
    // The first two pixels are clipped, the first of them outside the mask.
    let photograph = pixels(&|i| if i < 2 { 255 } else { 128 });
    let mask = pixels(&|i| if i == 0 { 0 } else { 255 });
    for (name, pixels) in [("photograph.png", photograph), ("mask.png", mask)] {
        let path = folder.join(name);
        image::save_buffer(path, &pixels, SIZE.0, SIZE.1, image::ColorType::Rgb8).expect("png");
    }
    fixture.manifest["frames"][0]["file_path"] = json!("photograph.png");
    fixture.manifest["frames"][0]["mask_path"] = json!("mask.png");
    let photograph = fixture.loaded().views.remove(0).photograph;
    let clipped: Vec<usize> = (0..photograph.usable.len())
        .filter(|&i| photograph.is_clipped(i))
        .collect();
    assert_eq!(clipped, [1]);
    assert!(!photograph.usable[1]);
    assert_eq!(photograph.radiance[1], [1.0; 3]);
    assert_eq!(photograph.radiance[0], [0.0; 3]);
}

#[test]
fn a_lone_clipped_pixel_is_no_highlight_and_what_lies_beside_highlights_stays() {
    let mut fixture = Fixture::new();
    let at = |x: u32, y: u32| y * SIZE.0 + x;
    // Two clipped pixels one above the other, between bright ones; and one far from all, where it is dark.
    let highlight = [at(1, 1), at(1, 2)];
    let beside = [at(0, 1), at(2, 1), at(0, 2), at(2, 2)];
    let lone = at(SIZE.0 - 2, SIZE.1 - 2);
    let shown = |i: u32| match i {
        _ if highlight.contains(&i) || i == lone => 255,
        _ if beside.contains(&i) => 230,
        _ => 20,
    };
    let pixels: Vec<u8> = (0..3 * SIZE.0 * SIZE.1).map(|i| shown(i / 3)).collect();
    let path = fixture.folder.path().join("photograph.png");
    image::save_buffer(path, &pixels, SIZE.0, SIZE.1, image::ColorType::Rgb8).expect("png");
    fixture.manifest["frames"][0]["file_path"] = json!("photograph.png");
    let photograph = fixture.loaded().views.remove(0).photograph;
    for i in highlight {
        assert!(photograph.is_clipped(i as usize));
    }
    for i in beside {
        assert!(photograph.usable[i as usize], "{i} is beside a highlight");
    }
    let lone = lone as usize;
    assert!(!photograph.usable[lone] && !photograph.is_clipped(lone));
    assert_eq!(photograph.radiance[lone], [0.0; 3]);
}

/// Writes a float EXR whose pixel `i` is `pixel(i)`.
fn write_exr(path: &Path, pixel: impl Fn(usize) -> [f32; 4] + Sync) {
    exr::prelude::write_rgba_file(path, SIZE.0 as usize, SIZE.1 as usize, |x, y| {
        let [r, g, b, a] = pixel(y * SIZE.0 as usize + x);
        (r, g, b, a)
    })
    .expect("exr");
}

#[test]
fn bad_pixels_are_masked_clamped_and_counted() {
    let mut fixture = Fixture::new();
    fixture.manifest["frames"][0]["file_path"] = json!("bad.exr");
    write_exr(&fixture.folder.path().join("bad.exr"), |i| match i {
        3 => [f32::NAN, 1.0, 1.0, 1.0],
        4 => [1.0, f32::INFINITY, 1.0, 1.0],
        6 => [1.0, 1.0, f32::MAX, 1.0],
        5 => [-0.25, 0.5, 1.0, 1.0],
        _ => [1.0, 1.0, 1.0, 1.0],
    });
    let capture = fixture.loaded();
    let photograph = &capture.views[0].photograph;
    assert_eq!(photograph.usable.iter().filter(|&&u| !u).count(), 3);
    assert!([3, 4, 6].iter().all(|&i| !photograph.usable[i]));
    assert_eq!(photograph.radiance[3], [0.0; 3]);
    assert_eq!(photograph.radiance[5], [0.0, 0.5, 1.0]);
    let all = capture.warnings.join("\n");
    assert!(
        all.contains("Not finite and left out: 3 pixels in bad.exr"),
        "{all}"
    );
    assert!(
        all.contains("Negative and set to zero: 1 pixel in bad.exr"),
        "{all}"
    );
}

#[test]
fn a_single_8_bit_image_warns_of_clipping() {
    let mut fixture = Fixture::new();
    fixture.add("rgb8.jpg");
    fixture.manifest["frames"][0]["file_path"] = json!("rgb8.jpg");
    let capture = fixture.loaded();
    let all = capture.warnings.join("\n");
    assert!(
        all.contains("8-bit") && all.contains("24 pixels in rgb8.jpg"),
        "{all}"
    );
}

#[test]
fn brackets_merge_to_the_radiance_that_was_photographed() {
    let mut fixture = Fixture::new();
    let radiance = |i: usize| 0.002 * 1.2_f32.powi(i as i32);
    let mut exposures = Vec::new();
    for (k, time) in [1.0, 0.1, 0.01].into_iter().enumerate() {
        let name = format!("e{k}.png");
        let codes: Vec<u8> = (0..48)
            .flat_map(|i| {
                let v = (radiance(i) * time as f32).min(1.0);
                let code = if v <= 0.003_130_8 {
                    12.92 * v
                } else {
                    1.055 * v.powf(1.0 / 2.4) - 0.055
                };
                [(code * 255.0).round() as u8; 3]
            })
            .collect();
        let path = fixture.folder.path().join(&name);
        image::save_buffer(path, &codes, SIZE.0, SIZE.1, image::ColorType::Rgb8).expect("png");
        // The same exposure by time, by aperture and by sensitivity.
        exposures.push(match k {
            0 => json!({ "file_path": name, "exposure_time": time, "f_number": 1.0, "iso": 100 }),
            1 => json!({ "file_path": name, "exposure_time": 4.0 * time, "f_number": 2.0, "iso": 100 }),
            _ => json!({ "file_path": name, "exposure_time": time / 2.0, "f_number": 1.0, "iso": 200 }),
        });
    }
    fixture.manifest["frames"][0]
        .as_object_mut()
        .expect("frame")
        .remove("file_path");
    fixture.manifest["frames"][0]["exposures"] = json!(exposures);
    let capture = fixture.loaded();
    assert!(capture.warnings.is_empty(), "{:?}", capture.warnings);
    assert_eq!(capture.views[0].name, "e0.png");
    for (i, pixel) in capture.views[0].photograph.radiance.iter().enumerate() {
        let error = pixel[0] / radiance(i) - 1.0;
        // Quantisation: half a code of 255 on the sRGB curve, worst in the dark of the longest exposure.
        assert!(
            error.abs() < 0.08,
            "pixel {i}: {} for {}",
            pixel[0],
            radiance(i)
        );
    }
}

#[test]
fn meshes_of_other_programs_are_the_same_box() {
    for name in ["box.obj", "box_ascii.ply", "box_binary.ply"] {
        let (mesh, _) = mesh_file::read(&data(name), None).expect(name);
        assert_eq!(
            (mesh.positions.len(), mesh.triangles.len()),
            (8, 12),
            "{name}"
        );
        assert_eq!(mesh.bounds(), (-Vec3::ONE, Vec3::ONE), "{name}");
        for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
            // By symmetry the angle-weighted normal of a cube's corner is its diagonal.
            assert!(
                (p.normalize_or_zero() - *n).length() < 1e-5,
                "{name}: {n} at {p}"
            );
        }
    }
}

#[test]
fn a_scene_far_from_the_origin_keeps_its_digits() {
    let far = DVec3::new(1e6, -3e6, 2e5) + DVec3::new(0.1, 0.2, 0.3);
    let mut fixture = Fixture::new();
    let near = fixture.loaded();
    let text = fs::read_to_string(data("box.obj")).expect("a box");
    let moved: Vec<String> = text.lines().map(|line| moved_vertex(line, far)).collect();
    fixture.write("box.obj", moved.join("\n"));
    fixture.manifest["frames"][0]["transform_matrix"] = matrix(far + DVec3::new(0.0, 0.0, 5.0));
    let capture = fixture.loaded();
    let origin = capture.mesh.origin;
    assert!((origin - far).length() < 4.0, "{origin}");
    let shift = far - origin;
    for (p, q) in capture.mesh.positions.iter().zip(&near.mesh.positions) {
        let off = (p.as_dvec3() - shift - q.as_dvec3()).length();
        assert!(off < 1e-6, "{p} for {q}");
    }
    let camera = capture.views[0].camera.position() - shift;
    assert!((camera - near.views[0].camera.position()).length() < 1e-8);
    // The same change of the file by a transform of the mesh, about the world's own origin.
    fixture.write("box.obj", text);
    fixture.manifest["mesh_transform"] =
        json!(DMat4::from_translation(far).transpose().to_cols_array_2d());
    let by_transform = fixture.loaded();
    assert_eq!(by_transform.mesh.origin, origin);
    assert_eq!(by_transform.mesh.positions, capture.mesh.positions);
}

/// A line of an OBJ file, moved where it is a vertex.
fn moved_vertex(line: &str, by: DVec3) -> String {
    let Some(numbers) = line.strip_prefix("v ") else {
        return line.to_owned();
    };
    let numbers = numbers.split_whitespace().zip(by.to_array());
    let moved = numbers.map(|(word, by)| word.parse::<f64>().expect("a number") + by);
    moved.fold("v".to_owned(), |line, v| format!("{line} {v}"))
}

fn parse_obj(text: &str) -> Result<super::Mesh, CaptureError> {
    let path = Path::new("mesh.obj");
    mesh_file::finish(path, obj::parse(path, text.as_bytes())?).map(|(mesh, _)| mesh)
}

#[test]
fn obj_dialects_are_understood() {
    let square =
        "v 0 0 0\nv 1 0 0 0.5 0.5 0.5\r\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1\nvn 0 0 2\nvn 0 0 0\n";
    for (faces, triangles, vertices) in [
        ("f 1 2 3 4", 2, 4),
        ("f -4 -3 -2 -1", 2, 4),
        ("f 1//1 2//1 3//1 4//1", 2, 4),
        (
            "g a\nf 1/1 2/2 3/1\no b\nusemtl m\ns off\nf 1/2 3/1 4/1 # comment",
            2,
            5,
        ),
        ("f 1 2 \\\n 3 4\nl 1 2\np 1", 2, 4),
        ("f 1//2 2//2 3//1", 1, 3),
    ] {
        let mesh = parse_obj(&format!("{square}{faces}\n")).expect(faces);
        assert_eq!(
            (mesh.triangles.len(), mesh.positions.len()),
            (triangles, vertices),
            "{faces}"
        );
        assert!(
            mesh.normals.iter().all(|n| (*n - Vec3::Z).length() < 1e-6),
            "{faces}"
        );
    }
    let before = format!("f 1 2 3\n{square}");
    assert_eq!(parse_obj(&before).expect("faces first").triangles.len(), 1);
}

#[test]
fn obj_names_and_comments_may_hold_anything() {
    let mut text =
        b"# exported from C:\\models\\\nmtllib Vase gr\xfcn.mtl\no \xe9\nusemtl\ng\n".to_vec();
    text.extend(b"v 0 0 0 1\nv 1 0 0 1 0.5 0 1 # seven\nv 0 1 0#\n\tf 1 2 3\n");
    let raw = obj::parse(Path::new("mesh.obj"), &text).expect("mesh");
    assert_eq!((raw.positions.len(), raw.triangles.len()), (3, 1));
}

#[test]
fn obj_corners_without_all_indices_get_nothing_from_others() {
    // Of two triangles one has texture coordinates and normals, which point the other way than its face.
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 0 0\nv 6 0 0\nv 5 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0.6 0 0.8\n\
         f 1/1/1 2/2/1 3/3/1\nf 4 5 6\n";
    let path = Path::new("mesh.obj");
    let raw = obj::parse(path, text.as_bytes()).expect("mesh");
    for (position, (normal, uv)) in raw.positions.iter().zip(raw.normals.iter().zip(&raw.uvs)) {
        let first = position.x < 2.0;
        let stated = Vec3::new(0.6, 0.0, 0.8);
        assert_eq!(*normal, if first { stated } else { Vec3::ZERO });
        assert_eq!(uv.is_nan(), !first);
    }
    // The entry that stands for a missing index can't be named.
    let message = obj::parse(path, text.replace("f 4 5 6", "f 4/4 5 6").as_bytes())
        .expect_err("out of range")
        .to_string();
    let part = "line 12: texture coordinate index 4 is out of range: the file has 3";
    assert!(message.contains(part), "{message}");
}

#[test]
fn broken_obj_lines_are_named() {
    for (text, part) in [
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n",
            "line 4: vertex index 4 is out of range",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n",
            "line 4: vertex index 0 is out of range",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/0\n",
            "line 5: texture coordinate index 0 is out of range",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1 2 3//-2\n",
            "line 5: normal index -2 is out of range",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/-1 2/-1 3/-1\nvt 0 0\n",
            "line 4: texture coordinate index -1 is out of range",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9223372036854775807\n",
            "line 4: '-9223372036854775807' is not an index",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3/1/1/1\n",
            "line 4: '3/1/1/1' is not a corner",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 \\\n2 \\\n3\nf 1 2 x\n",
            "line 7: 'x' is not an index",
        ),
        (
            "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n",
            "line 2: the vertex is NaN",
        ),
        ("v 0 0 0\nv 1 0\n", "line 2: numbers are missing"),
        ("v 0 0 0\nv 1 0 x\n", "line 2: 'x' is not a number"),
        ("v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3: a face with 2 corners"),
        ("v 0 0 0\n", "1 vertices but no faces"),
        ("", "the mesh is empty"),
        ("v 0 0 0\nv 0 0 0\nv 1 0 0\nf 1 2 3\n", "zero area"),
    ] {
        let message = parse_obj(text).expect_err(part).to_string();
        assert!(
            message.contains(part) && message.contains("mesh.obj"),
            "{message} lacks {part}"
        );
    }
}

#[test]
fn concave_polygons_are_cut_inside() {
    // An arrow head whose fan from the first corner would leave the polygon.
    let points = [[0.0, 0.0], [2.0, -1.0], [0.5, 0.0], [2.0, 1.0]]
        .map(|[x, y]: [f64; 2]| DVec3::new(x, y, 0.0));
    for shift in 0..4 {
        let corners: Vec<u32> = (0..4).map(|i| (i + shift) % 4).collect();
        let mut triangles = Vec::new();
        polygon::triangulate(&corners, &points, &mut triangles);
        let area: f64 = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| points[v as usize]);
                let twice = (b - a).cross(c - a).z;
                assert!(twice > 0.0, "a triangle is turned over");
                0.5 * twice
            })
            .sum();
        assert!((area - 0.5).abs() < 1e-6, "the area is {area}");
    }
}

#[test]
fn large_concave_polygons_are_cut_inside() {
    // A gear whose fan from any corner would leave it.
    let points = ring(3000, |i| if i / 10 % 2 == 0 { 1.0 } else { 0.6 });
    let area: f64 = areas(&points, &cut(&points)).iter().sum();
    let expected = area_of(&points);
    assert!((area - expected).abs() < 1e-4, "{area} for {expected}");
}

#[test]
fn large_convex_polygons_are_halved() {
    // The bounds of a fan's triangles would all hold its first corner; those of halves get smaller by and by.
    let count = 3000;
    let points = ring(count, |_| 1.0);
    let triangles = cut(&points);
    assert_eq!(triangles.len(), count as usize - 2);
    let area: f64 = areas(&points, &triangles).iter().sum();
    let expected = area_of(&points);
    assert!((area - expected).abs() < 1e-9, "{area} for {expected}");
    let at_one_corner = |corner: u32| triangles.iter().filter(|t| t.contains(&corner)).count();
    assert!((0..count).all(|corner| at_one_corner(corner) < 32));
}

/// A closed line around the origin of `count` corners, at `radius` of each.
fn ring(count: u32, radius: impl Fn(u32) -> f64) -> Vec<DVec3> {
    let at = |i: u32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(count)).sin_cos();
        radius(i) * DVec3::new(cos, sin, 0.0)
    };
    (0..count).map(at).collect()
}

fn twice_the_area(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    (b - a).cross(c - a).z
}

/// The triangles that a polygon is cut into.
fn cut(points: &[DVec3]) -> Vec<[u32; 3]> {
    let corners: Vec<u32> = (0..points.len() as u32).collect();
    let mut triangles = Vec::new();
    polygon::triangulate(&corners, points, &mut triangles);
    triangles
}

/// Areas of triangles in the plane, none of which may be turned over.
fn areas(points: &[DVec3], triangles: &[[u32; 3]]) -> Vec<f64> {
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| points[v as usize]);
        let twice = twice_the_area(a, b, c);
        assert!(twice >= 0.0, "a triangle is turned over");
        0.5 * twice
    };
    triangles.iter().map(area).collect()
}

fn area_of(points: &[DVec3]) -> f64 {
    let next = |i: usize| points[(i + 1) % points.len()];
    let pieces = points.iter().enumerate();
    pieces
        .map(|(i, &p)| 0.5 * twice_the_area(DVec3::ZERO, p, next(i)))
        .sum()
}

#[test]
fn repeated_triangles_are_left_out() {
    let mut text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 1 0\nf 3 2 1\n".to_owned();
    text.push_str(&"f 1 2 3\nf 2 3 1\nf 1 2 4\n".repeat(10));
    let path = Path::new("mesh.obj");
    let raw = obj::parse(path, text.as_bytes()).expect("obj");
    let (mesh, warnings) = mesh_file::finish(path, raw).expect("mesh");
    // The two sides of the sheet stay.
    assert_eq!(mesh.triangles.len(), 2);
    assert!(
        warnings
            .iter()
            .any(|w| w.contains("29 triangles that repeat others")),
        "{warnings:?}"
    );
}

#[test]
fn ply_quads_big_endian_and_corner_texture_coordinates() {
    let header = "ply\nformat ascii 1.0\ncomment x\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
         property uchar red\nelement face 2\nproperty list uchar uint vertex_index\nproperty list uchar float texcoord\n\
         property int flags\nelement edge 1\nproperty int vertex1\nend_header\n";
    let text = format!(
        "{header}0 0 0 1\n1 0 0 2\n1 1 0 3\n0 1 0 4\n3 0 1 2 6 0 0 1 0 1 1 7\n3 0 2 3 6 0.5 0 1 1 0 1 7\n0\n"
    );
    let path = Path::new("mesh.ply");
    let (mesh, _) =
        mesh_file::finish(path, ply::parse(path, text.as_bytes()).expect("ply")).expect("mesh");
    assert_eq!(
        (mesh.triangles.len(), mesh.positions.len(), mesh.uvs.len()),
        (2, 5, 5)
    );
    let mut big = b"ply\nformat binary_big_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        property float nx\nproperty float ny\nproperty float nz\nproperty float s\nproperty float t\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        .to_vec();
    for [x, y] in [[0.0_f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
        for value in [x, y, 0.0, 0.0, 0.0, 3.0, x, y] {
            big.extend(value.to_be_bytes());
        }
    }
    big.push(4);
    for index in 0..4_i32 {
        big.extend(index.to_be_bytes());
    }
    let (mesh, warnings) =
        mesh_file::finish(path, ply::parse(path, &big).expect("ply")).expect("mesh");
    assert_eq!(
        (mesh.triangles.len(), mesh.positions.len(), mesh.uvs.len()),
        (2, 4, 4)
    );
    assert_eq!((mesh.normals[0], mesh.uvs[2]), (Vec3::Z, glam::Vec2::ONE));
    assert!(warnings.is_empty(), "{warnings:?}");
}

#[test]
fn broken_ply_entries_are_named() {
    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
         element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    let path = Path::new("mesh.ply");
    for (text, part) in [
        (
            "not a ply".to_owned(),
            "header: the file does not start with 'ply'",
        ),
        (
            format!("{header}0 0 0\n1 0 0\n0 1 0\n").replace("face 1", "face 99999999999"),
            "element face: 99999999999 entries are announced",
        ),
        (
            format!("{header}0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n"),
            "vertex 2: the position is NaN",
        ),
        (
            format!("{header}0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n"),
            "face 0: a vertex index is out of range",
        ),
        (
            format!("{header}0 0 0\n1 0 0\n0 1 0\n3 0 1 -2\n"),
            "face 0: a vertex index is out of range",
        ),
        (
            format!("{header}0 0 0\n1 0 0\n0 1 0\n3 0 1"),
            "face 0: the file ends too early",
        ),
        (
            format!("{header}0 0 0\n1 0 0\n0 1 0\n2 0 1"),
            "face 0: it has 2 corners",
        ),
    ] {
        let message = ply::parse(path, text.as_bytes())
            .expect_err(part)
            .to_string();
        assert!(
            message.contains(part) && message.contains("mesh.ply"),
            "{message} lacks {part}"
        );
    }
}

#[test]
fn meshes_the_wrong_way_round_are_turned() {
    let raw = || obj::parse(Path::new("box.obj"), &bytes("box.obj")).expect("box");
    // Faces swapped, normals negated, normals removed, one side open.
    for case in 0..16 {
        let (swap, negate, bare, open) = (case & 1 > 0, case & 2 > 0, case & 4 > 0, case & 8 > 0);
        // An open surface without normals has no outside.
        if open && (bare || negate) {
            continue;
        }
        let mut raw = raw();
        if swap {
            raw.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        }
        for normal in &mut raw.normals {
            *normal *= if bare {
                0.0
            } else if negate {
                -1.0
            } else {
                1.0
            };
        }
        if open {
            raw.triangles.truncate(10);
        }
        let (mesh, warnings) = mesh_file::finish(Path::new("box.obj"), raw).expect("mesh");
        for t in 0..mesh.triangles.len() as u32 {
            assert!(
                mesh.face_normal(t).dot(mesh.corners(t)[0]) > 0.0,
                "case {case}"
            );
        }
        assert!(
            mesh.normals
                .iter()
                .zip(&mesh.positions)
                .all(|(n, p)| n.dot(*p) > 0.0),
            "case {case}"
        );
        assert_eq!(
            warnings.is_empty(),
            !(swap || negate || bare),
            "case {case}: {warnings:?}"
        );
    }
}

#[test]
fn the_only_mesh_of_the_folder_is_found() {
    let mut fixture = Fixture::new();
    fixture
        .manifest
        .as_object_mut()
        .expect("object")
        .remove("mesh_path");
    // A point cloud is no mesh.
    fixture.write(
        "sparse_pc.ply",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
    );
    assert_eq!(fixture.loaded().mesh.triangles.len(), 12);
    fixture.add("box_ascii.ply");
    let message = fixture.message();
    assert!(
        message.contains("box.obj, box_ascii.ply") && message.contains("mesh_path"),
        "{message}"
    );
}

#[test]
fn cameras_read_without_images() {
    let fixture = Fixture::new();
    fixture.load().expect("good");
    fs::remove_file(fixture.folder.path().join("rgba_half_zip.exr")).expect("remove");
    let cameras = read_cameras(fixture.folder.path(), DVec3::ZERO).expect("cameras");
    assert_eq!(cameras[0].0, "rgba_half_zip.exr");
    assert_eq!((cameras[0].1.width, cameras[0].1.height), SIZE);
}

#[test]
fn missing_folders_and_manifests_are_named() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let message = |path: &Path| Capture::load(path).expect_err("bad").to_string();
    assert!(message(&folder.path().join("nowhere")).contains("nowhere: no such file or folder"));
    assert!(message(folder.path()).contains("no transforms.json"));
    assert!(message(folder.path()).contains("COLMAP"));
}

/// The fixture's view, turned, as a COLMAP model in `sparse/0`: the capture that it should give.
fn colmap_fixture(binary: bool) -> (Fixture, Camera) {
    let mut fixture = Fixture::new();
    let pose = DMat4::from_rotation_y(0.2) * DMat4::from_translation(DVec3::new(0.1, 0.2, 5.0));
    fixture.manifest["frames"][0]["transform_matrix"] = rows(pose);
    for (key, value) in [("k1", 0.1), ("k2", -0.02), ("p1", 0.001), ("p2", 0.002)] {
        fixture.manifest[key] = json!(value);
    }
    fixture.manifest["camera_model"] = json!("OPENCV");
    let expected = fixture.camera();
    fs::remove_file(fixture.folder.path().join("transforms.json")).expect("remove");
    let flipped = pose * DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0));
    let inverse = flipped.inverse();
    let q = glam::DQuat::from_mat4(&inverse);
    let t = inverse.w_axis;
    fs::create_dir_all(fixture.folder.path().join("sparse/0")).expect("folder");
    fs::create_dir(fixture.folder.path().join("images")).expect("folder");
    fixture.write("images/a b.exr", bytes("rgba_half_zip.exr"));
    let lens = [8.0_f64, 8.0, 4.0, 3.0, 0.1, -0.02, 0.001, 0.002];
    if !binary {
        let lens = lens.map(|v| v.to_string()).join(" ");
        fixture.write(
            "sparse/0/cameras.txt",
            format!("# cameras\n7 OPENCV 8 6 {lens}\n"),
        );
        let image = format!("{} {} {} {} {} {} {}", q.w, q.x, q.y, q.z, t.x, t.y, t.z);
        fixture.write(
            "sparse/0/images.txt",
            format!("# images\n3 {image} 7 a b.exr\n\n"),
        );
        return (fixture, expected);
    }
    let mut cameras = 1_u64.to_le_bytes().to_vec();
    cameras.extend([7_u32, 4].iter().flat_map(|v| v.to_le_bytes()));
    cameras.extend([8_u64, 6].iter().flat_map(|v| v.to_le_bytes()));
    cameras.extend(lens.iter().flat_map(|v| v.to_le_bytes()));
    fixture.write("sparse/0/cameras.bin", cameras);
    let mut images = 1_u64.to_le_bytes().to_vec();
    images.extend(3_u32.to_le_bytes());
    let pose = [q.w, q.x, q.y, q.z, t.x, t.y, t.z];
    images.extend(pose.iter().flat_map(|v| v.to_le_bytes()));
    images.extend(7_u32.to_le_bytes());
    images.extend(b"a b.exr\0");
    images.extend(2_u64.to_le_bytes());
    images.extend([1; 48]);
    fixture.write("sparse/0/images.bin", images);
    (fixture, expected)
}

#[test]
fn colmap_models_are_captures() {
    for binary in [false, true] {
        let (fixture, expected) = colmap_fixture(binary);
        let capture = Capture::load(fixture.folder.path()).expect("a capture");
        let camera = &capture.views[0].camera;
        assert_eq!(capture.views[0].name, "images/a b.exr");
        assert_eq!(camera.distortion, expected.distortion);
        assert_eq!(
            (camera.focal, camera.centre),
            (expected.focal, expected.centre)
        );
        assert_close(camera.position(), expected.position(), 1e-9);
        assert_close(camera.up(), expected.up(), 1e-9);
        assert_close(camera.forward(), expected.forward(), 1e-9);
    }
}

#[test]
fn a_model_may_be_of_more_photographs_than_the_capture() {
    let (fixture, expected) = colmap_fixture(false);
    let model = "sparse/0/images.txt";
    let whole = fs::read_to_string(fixture.folder.path().join(model)).expect("model");
    // The model is of JPEG files; a third one, upside down, was not taken as HDR.
    let jpeg = whole.replace(".exr", ".jpg");
    let more = "4 0 0 0 1 0 0 5 7 b.jpg\n\n5 0 1 0 0 0 0 5 7 c.jpg\n\n";
    fixture.write("images/c.exr", bytes("rgba_half_zip.exr"));
    fixture.write(model, jpeg.clone() + more);
    let (capture, _) = Capture::load_unplaced(fixture.folder.path()).expect("a capture");
    let names: Vec<&str> = capture.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["images/a b.exr", "images/c.exr"]);
    assert_close(
        capture.views[0].camera.position(),
        expected.position(),
        1e-9,
    );
    let note = &capture.warnings[0];
    assert!(note.contains("1 of the 3 photographs"), "{note}");
    assert!(note.contains("images.txt"), "{note}");
    let ups: [DVec3; 2] = [0, 1].map(|i| capture.views[i].camera.up());
    let left_out = DVec3::new(0.0, 1.0, 0.0);
    let mean = (ups[0] + ups[1] + left_out).normalize_or_zero();
    assert_close(capture.light_hemisphere.up, mean, 1e-9);
    // All cameras are there to render from, and where no photograph is here the first is missed.
    assert_eq!(
        read_cameras(fixture.folder.path(), DVec3::ZERO)
            .expect("cameras")
            .len(),
        3
    );
    fixture.write(model, more);
    fs::remove_file(fixture.folder.path().join("images/c.exr")).expect("removed");
    let message = Capture::load(fixture.folder.path()).expect_err("none");
    assert!(
        message.to_string().contains("b.jpg: no such image"),
        "{message}"
    );
}

#[test]
fn damaged_colmap_models_never_panic() {
    let mut random = Random(9);
    for (binary, names) in [
        (false, ["sparse/0/cameras.txt", "sparse/0/images.txt"]),
        (true, ["sparse/0/cameras.bin", "sparse/0/images.bin"]),
    ] {
        let (fixture, _) = colmap_fixture(binary);
        for name in names {
            let whole = fs::read(fixture.folder.path().join(name)).expect("model");
            for _ in 0..200 {
                fixture.write(name, damaged(&whole, &mut random));
                let _ = Capture::load(fixture.folder.path());
            }
            fixture.write(name, whole);
        }
    }
}

#[test]
fn broken_json_is_located() {
    let fixture = Fixture::new();
    for (text, place) in [
        ("", "line 1, column 0"),
        ("{\n  \"frames\": [}\n", "line 2, column 14"),
        ("{\"frames\": [1, 2", "line 1, column 16"),
    ] {
        fixture.write("transforms.json", text);
        let message = Capture::load(fixture.folder.path())
            .expect_err("broken")
            .to_string();
        assert!(
            message.contains("transforms.json") && message.contains(place),
            "{message} lacks {place}"
        );
    }
}

#[test]
fn nan_in_a_matrix_is_found_in_json_that_python_wrote() {
    let fixture = Fixture::new();
    let text = fixture.manifest.to_string().replacen("5.0", "NaN", 1);
    fixture.write("transforms.json", text);
    let message = Capture::load(fixture.folder.path())
        .expect_err("NaN")
        .to_string();
    let place = "frames[0].transform_matrix is NaN or not finite in row 3, column 4";
    assert!(message.contains(place), "{message}");
}

#[test]
fn every_bad_field_has_its_message() {
    type Change = fn(&mut Value);
    let cases: [(Change, &str); 17] = [
        (|m| m["frames"] = json!([]), "frames is missing or empty"),
        (|m| m["frames"] = json!(7), "frames is the number 7"),
        (
            |m| m["frames"] = json!([1]),
            "frames[0] is the number 1, not an object",
        ),
        (|m| *m = json!([]), "is a list, not an object"),
        (
            |m| m["frames"][0]["transform_matrix"] = json!(null),
            "frames[0].transform_matrix is missing",
        ),
        (
            |m| m["frames"][0]["transform_matrix"] = json!([[1, 0], [0, 1]]),
            "has 2 rows",
        ),
        (
            |m| m["frames"][0]["transform_matrix"][1] = json!([0, 0, 0, 0]),
            "is singular",
        ),
        (
            |m| m["frames"][0]["transform_matrix"][1][1] = json!("x"),
            "is the text \"x\" in row 2, column 2",
        ),
        (
            |m| m["frames"][0]["transform_matrix"][1][1] = json!(-1),
            "mirrors",
        ),
        (
            |m| m["frames"][0]["transform_matrix"][1][1] = json!(1.5),
            "is not a rotation",
        ),
        (
            |m| m["frames"][0]["transform_matrix"][3] = json!([0, 0, 1, 0]),
            "row 0 0 0 1",
        ),
        (
            |m| m["frames"][0]["file_path"] = json!(null),
            "frames[0].file_path is missing",
        ),
        (
            |m| m["camera_model"] = json!("THIN_PRISM_FISHEYE"),
            "undistort",
        ),
        (|m| m["fl_x"] = json!(-3), "fl_x is -3"),
        (|m| m["w"] = json!(1e9), "w is 1000000000"),
        (
            |m| m["light_hemisphere"]["up"] = json!([0, 0, 0]),
            "light_hemisphere.up is not a direction",
        ),
        (
            |m| m["light_hemisphere"]["frame"] = json!("turntable"),
            "light_hemisphere.frame is \"turntable\"; write \"world\"",
        ),
    ];
    for (change, part) in cases {
        let mut fixture = Fixture::new();
        change(&mut fixture.manifest);
        let message = fixture.message();
        assert!(
            message.contains(part) && message.contains("transforms.json"),
            "{message} lacks {part}"
        );
    }
    let mut fixture = Fixture::new();
    for key in ["fl_x", "fl_y"] {
        fixture
            .manifest
            .as_object_mut()
            .expect("object")
            .remove(key);
    }
    assert!(
        fixture
            .message()
            .contains("fl_x is missing, and so is camera_angle_x")
    );
}

#[test]
fn every_bad_file_has_its_message() {
    type Change = fn(&mut Fixture);
    let cases: [(Change, &[&str]); 13] = [
        (
            |f| f.manifest["frames"][0]["file_path"] = json!("no.exr"),
            &["no.exr: no such image", "frames[0].file_path"],
        ),
        (
            |f| f.write("rgba_half_zip.exr", &bytes("rgba_half_zip.exr")[..300]),
            &["rgba_half_zip.exr", "cannot be decoded"],
        ),
        (
            |f| f.write("rgba_half_zip.exr", "hello"),
            &["rgba_half_zip.exr", "format is not known"],
        ),
        (
            |f| f.write("rgba_half_zip.exr", bytes("luminance.exr")),
            &["no R, G and B", "it has Y"],
        ),
        (
            |f| f.manifest["w"] = json!(9),
            &["is 8×6 pixels", "transforms.json says 9×6"],
        ),
        (
            |f| write_exr(&f.folder.path().join("rgba_half_zip.exr"), |_| [0.0; 4]),
            &["rgba_half_zip.exr", "black"],
        ),
        (
            |f| {
                write_exr(&f.folder.path().join("rgba_half_zip.exr"), |_| {
                    [f32::NAN; 4]
                });
            },
            &["rgba_half_zip.exr", "not finite"],
        ),
        (
            |f| f.manifest["mesh_path"] = json!("no.obj"),
            &["no.obj: no such mesh", "mesh_path"],
        ),
        (
            |f| f.manifest["mesh_path"] = json!("rgba_half_zip.exr"),
            &["not a mesh format", "OBJ, PLY, GLB or glTF"],
        ),
        (|f| f.write("box.obj", ""), &["box.obj", "empty"]),
        (
            |f| f.write("box.obj", "v 0 0 0\nf 1 2 3\n"),
            &["box.obj", "line 2", "out of range"],
        ),
        (
            |f| f.manifest["frames"][0]["transform_matrix"] = matrix(DVec3::new(0.0, 0.0, -5.0)),
            &["box.obj", "no camera sees"],
        ),
        (
            |f| f.manifest["frames"][0]["mask_path"] = json!("mask.png"),
            &["mask.png: no such image", "mask_path"],
        ),
    ];
    for (change, parts) in cases {
        let mut fixture = Fixture::new();
        change(&mut fixture);
        let message = fixture.message();
        for part in parts {
            assert!(message.contains(part), "{message} lacks {part}");
        }
    }
}

#[test]
fn exposures_on_different_scales_are_refused() {
    let mut fixture = Fixture::new();
    let second = fixture.manifest["frames"][0].clone();
    fixture.manifest["frames"]
        .as_array_mut()
        .expect("frames")
        .push(second);
    fixture.manifest["frames"][0]["exposures"] =
        json!([{ "file_path": "rgba_half_zip.exr", "exposure_time": 0.5 }]);
    assert!(fixture.message().contains("frames[1].exposures is missing"));
    fixture.manifest["frames"][1]["exposures"] =
        json!([{ "file_path": "rgba_half_zip.exr", "exposure_time": 0.5, "f_number": 8 }]);
    assert!(
        fixture
            .message()
            .contains("frames[0].exposures[0].f_number is missing")
    );
    fixture.manifest["frames"][1]["exposures"] = json!([{ "file_path": "rgba_half_zip.exr" }]);
    assert!(
        fixture
            .message()
            .contains("frames[1].exposures[0].exposure_time is missing")
    );
}

#[test]
fn damaged_files_never_panic() {
    let mut random = Random(7);
    for name in [
        "rgba_half_zip.exr",
        "rgb_float_piz.exr",
        "rgba_half_b44.exr",
        "rgba_half_dwaa.exr",
        "layers.exr",
        "parts.exr",
        "cropped.exr",
    ] {
        let original = bytes(name);
        for _ in 0..150 {
            let _ = Picture::decode(
                Path::new(name),
                &damaged(&original, &mut random),
                true,
                &|_| Ok(()),
            );
        }
    }
    for name in [
        "radiance.hdr",
        "rgba8.png",
        "rgba16.png",
        "rgb16.tif",
        "rgb32f.tif",
        "rgb8.jpg",
    ] {
        let original = bytes(name);
        for _ in 0..150 {
            let _ = Picture::decode(
                Path::new(name),
                &damaged(&original, &mut random),
                true,
                &|_| Ok(()),
            );
        }
    }
    for name in ["box.obj", "box_ascii.ply", "box_binary.ply"] {
        let (original, path) = (bytes(name), Path::new(name));
        for _ in 0..1500 {
            let bytes = damaged(&original, &mut random);
            let raw = if name.ends_with("obj") {
                obj::parse(path, &bytes)
            } else {
                ply::parse(path, &bytes)
            };
            if let Ok((mesh, _)) = raw.and_then(|raw| mesh_file::finish(path, raw)) {
                assert!(
                    mesh.triangles
                        .iter()
                        .flatten()
                        .all(|&v| (v as usize) < mesh.positions.len())
                );
                assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-3));
            }
        }
    }
}

#[test]
fn damaged_manifests_never_panic() {
    let mut random = Random(8);
    let fixture = Fixture::new();
    let original = fixture.manifest.to_string();
    for i in 0..400 {
        let bytes = damaged(original.as_bytes(), &mut random);
        let folder = fixture.folder.path().to_owned();
        let _ = Manifest::parse(&bytes, folder.join("transforms.json"), folder.clone());
        if i % 8 == 0 {
            fixture.write("transforms.json", &bytes);
            let _ = Capture::load(&folder);
        }
    }
}

#[test]
fn light_that_stands_still_with_the_camera_comes_with_the_motions_to_the_first_view() {
    let mut fixture = Fixture::new();
    fixture.manifest["light_hemisphere"]["frame"] = json!("camera");
    let mut capture = fixture.loaded();
    assert_eq!(capture.light_hemisphere.frame, Some(LightFrame::Camera));
    assert!(
        capture.motions().is_none(),
        "a single view has light of its own"
    );
    let mut second = capture.views[0].clone();
    let around = DAffine3::from_axis_angle(DVec3::new(0.2, 1.0, 0.0).normalize_or_zero(), 0.8);
    second.camera.world_from_camera = around * second.camera.world_from_camera;
    capture.views.push(second);
    let motions = capture.motions().unwrap();
    for (motion, view) in motions.iter().zip(&capture.views) {
        // What a camera sees in its own coordinates is where the first camera would see the same.
        let point = DVec3::new(0.3, -0.2, 0.1);
        let seen = view
            .camera
            .world_from_camera
            .inverse()
            .transform_point3(point);
        let by_first = capture.views[0]
            .camera
            .world_from_camera
            .transform_point3(seen);
        assert_close(motion.transform_point3(point), by_first, 1e-9);
    }
}
