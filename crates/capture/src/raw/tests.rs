//! Raw files with known content: levels, colours, clipping, places, and damage.

use std::fs;
use std::path::Path;

use image::DynamicImage;
use rekindle_base::damage::{Random, damaged};
use serde_json::json;

use super::dng::Dng;
use super::*;
use crate::{Capture, Photos, Settings};

/// A coloured surface without sharp edges.
fn scene(x: f64, y: f64) -> [f64; 3] {
    let wave = |phase: f64| 0.3 + 0.1 * (0.05 * x + 0.03 * y + phase).sin();
    [wave(0.0), 0.8 * wave(1.0), wave(2.0)]
}

fn develop_with(bytes: &[u8], white: Option<&WhiteBalance>) -> Result<Picture, CaptureError> {
    read(Path::new("a.dng"), bytes.to_vec(), true, white, &|_| Ok(()))
}

fn developed(bytes: &[u8]) -> Picture {
    develop_with(bytes, None).expect("a raw file")
}

/// The largest relative difference of a picture from a scene, but for clipped pixels.
fn difference(picture: &Picture, scene: impl Fn(f64, f64) -> [f64; 3]) -> f64 {
    let width = picture.width as usize;
    let pixels = picture.rgb.iter().zip(&picture.saturated).enumerate();
    let off = pixels
        .filter(|(_, (_, clipped))| !**clipped)
        .map(|(i, (pixel, _))| {
            let truth = scene((i % width) as f64, (i / width) as f64);
            let off = |c: usize| (f64::from(pixel[c]) / truth[c] - 1.0).abs();
            off(0).max(off(1)).max(off(2))
        });
    off.fold(0.0, f64::max)
}

#[test]
fn a_scene_comes_out_linear_and_in_its_colours() {
    let photograph = Dng::default();
    let picture = developed(&photograph.bytes(scene));
    assert_eq!((picture.width, picture.height), (40, 36), "the crop");
    assert!(!picture.saturated.contains(&true));
    let off = difference(&picture, scene);
    assert!(off < 0.02, "{off}");
    // Half the light is half of everything; each black level counts, or dark places would show a grid.
    for (time, tolerance) in [(0.5, 0.02), (0.03, 0.03)] {
        let photograph = Dng {
            time,
            ..Dng::default()
        };
        let picture = developed(&photograph.bytes(scene));
        let off = difference(&picture, |x, y| scene(x, y).map(|v| v * time));
        assert!(off < tolerance, "{off} at {time}");
    }
}

#[test]
fn grey_is_grey_to_the_last_digit_that_the_sensor_has() {
    let grey = |_: f64, _: f64| [0.2; 3];
    for pattern in [[0, 1, 1, 2], [2, 1, 1, 0], [1, 0, 2, 1], [1, 2, 0, 1]] {
        let photograph = Dng {
            pattern: pattern.to_vec(),
            ..Dng::default()
        };
        let off = difference(&developed(&photograph.bytes(grey)), grey);
        assert!(off < 1e-3, "{off} with {pattern:?}");
    }
}

#[test]
fn other_sensors_and_files_that_have_all_colours_come_out_alike() {
    let x_trans = [
        [1, 1, 0, 1, 1, 2],
        [1, 1, 2, 1, 1, 0],
        [2, 0, 1, 0, 2, 1],
        [1, 1, 2, 1, 1, 0],
        [1, 1, 0, 1, 1, 2],
        [0, 2, 1, 2, 0, 1],
    ];
    for (pattern, tolerance) in [(x_trans.as_flattened().to_vec(), 0.05), (Vec::new(), 1e-3)] {
        let photograph = Dng {
            pattern,
            ..Dng::default()
        };
        let picture = developed(&photograph.bytes(scene));
        let off = difference(&picture, scene);
        assert!(off < tolerance, "{off}");
        let bright = developed(&photograph.bytes(|_, _| [2.0; 3]));
        assert!(bright.saturated.iter().all(|&clipped| clipped));
        let off = |v: &f32| (v - 1.0).abs();
        assert!(bright.rgb.as_flattened().iter().all(|v| off(v) < 1e-3));
    }
}

#[test]
fn clipped_highlights_are_white_and_no_brighter_than_the_truth() {
    let bright = |x: f64, y: f64| {
        let highlight = (-((x - 20.0).powi(2) + (y - 17.0).powi(2)) / 80.0).exp();
        scene(x, y).map(|v| 0.5 * v + 3.0 * highlight)
    };
    let picture = developed(&Dng::default().bytes(bright));
    let clipped = picture.saturated.iter().filter(|c| **c).count();
    let above = |level: f64| {
        let places = (0..36).flat_map(|y| (0..40).map(move |x| (f64::from(x), f64::from(y))));
        places.filter(|&(x, y)| bright(x, y)[1] > level).count()
    };
    assert!(clipped >= above(1.05) && clipped < above(0.4), "{clipped}");
    for (i, pixel) in picture.rgb.iter().enumerate() {
        let truth = bright((i % 40) as f64, (i / 40) as f64);
        for c in 0..3 {
            // Interpolation is off by that much on slopes as steep as these.
            let off = if picture.saturated[i] { 0.05 } else { 0.1 };
            let most = truth[c] * (1.0 + off);
            assert!(f64::from(pixel[c]) <= most, "{i}: {pixel:?} for {truth:?}");
        }
    }
    // In the middle all channels are clipped, red at half of green's light.
    let middle = picture.rgb[17 * 40 + 20];
    assert!(middle.iter().all(|v| (v - 1.0).abs() < 1e-3), "{middle:?}");
}

#[test]
fn a_hot_pixel_is_no_highlight() {
    let photograph = Dng::default();
    let mut bytes = photograph.bytes(|_, _| [0.02; 3]);
    let at = 8 + 2 * (20 * 56 + 30);
    bytes[at..at + 2].copy_from_slice(&15_000_u16.to_le_bytes());
    let picture = developed(&bytes);
    assert!(!picture.saturated.contains(&true));
    let off = difference(&picture, |_, _| [0.02; 3]);
    assert!(off < 0.02, "{off}");
}

#[test]
fn pictures_are_turned_as_the_file_says() {
    let upright = developed(&Dng::default().bytes(scene));
    let size = (upright.width, upright.height);
    let as_image = |picture: &Picture| {
        let numbers = picture.rgb.as_flattened().to_vec();
        let image = image::Rgb32FImage::from_raw(picture.width, picture.height, numbers);
        DynamicImage::ImageRgb32F(image.expect("an image"))
    };
    for code in 1..=8 {
        let photograph = Dng {
            orientation: code,
            ..Dng::default()
        };
        let bytes = photograph.bytes(scene);
        let mut expected = as_image(&upright);
        expected.apply_orientation(Orientation::from_exif(code as u8).expect("a code"));
        let turned = developed(&bytes);
        assert_eq!(as_image(&turned), expected, "orientation {code}");
        let found = read_size(Path::new("a.dng"), bytes.clone()).expect("a size");
        assert_eq!(found, (turned.width, turned.height));
        // Unless it should have the size that it has as it is stored.
        let stored = |found: (u32, u32)| {
            let other = || Fault::damaged("another size").of(Path::new("a.dng"));
            (found == size).then_some(()).ok_or_else(other)
        };
        let kept = read(Path::new("a.dng"), bytes, true, None, &stored).expect("as stored");
        assert_eq!((kept.width, kept.height), size);
    }
}

#[test]
fn views_of_one_camera_share_a_white_balance() {
    let folder = tempfile::tempdir().expect("a folder");
    // The camera took the same sensor's samples for another light: all that differs is what it says of grey.
    let bytes = Dng::default().bytes(scene);
    let place = bytes
        .windows(4)
        .rposition(|w| w == 625_000_u32.to_le_bytes());
    let mut other = bytes.clone();
    other[place.expect("blue's neutral")..][..4].copy_from_slice(&400_000_u32.to_le_bytes());
    let alone = developed(&other);
    assert!(difference(&alone, scene) > 0.2, "more blue");
    let path = folder.path().join("first.dng");
    fs::write(&path, &bytes).expect("written");
    let jpeg = Path::new("none.jpg");
    let white = white_balance([jpeg, &path].into_iter()).expect("a white balance");
    assert!((white.gains[2] - 1.6).abs() < 1e-4, "{white:?}");
    let shared = develop_with(&other, Some(&white)).expect("a raw file");
    assert!(difference(&shared, scene) < 0.02);
    let of_another = WhiteBalance {
        camera: "Other".to_owned(),
        ..white
    };
    let unshared = develop_with(&other, Some(&of_another)).expect("a raw file");
    assert_eq!(unshared.rgb, alone.rgb);
}

#[test]
fn white_balance_that_is_not_stated_is_that_of_daylight() {
    let mut bytes = Dng::default().bytes(scene);
    let tag = bytes.windows(4).rposition(|w| w == [0x28, 0xc6, 5, 0]);
    bytes[tag.expect("the neutral")] = 0x29;
    assert!(difference(&developed(&bytes), scene) < 0.02);
}

/// A capture of the test box whose views are raw files of these exposures, by several files to a view or one.
fn capture(times: &[f64], bracketed: bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/capture");
    fs::copy(data.join("box.obj"), folder.path().join("box.obj")).expect("a mesh");
    for (k, &time) in times.iter().enumerate() {
        let photograph = Dng {
            time,
            second: k as u32,
            ..Dng::default()
        };
        let name = format!("DSC_{k}.DNG");
        fs::write(folder.path().join(name), photograph.bytes(scene)).expect("written");
    }
    let pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]];
    // Cameras that were found from JPEG files.
    let file = |k: usize| json!({ "file_path": format!("DSC_{k}.jpg"), "transform_matrix": pose });
    let files: Vec<_> = (0..times.len()).map(file).collect();
    let frames = if bracketed {
        json!([{ "transform_matrix": pose, "exposures": files }])
    } else {
        json!(files)
    };
    let manifest = json!({
        "w": 40, "h": 36, "fl_x": 40.0, "light_hemisphere": { "up": [0, 1, 0] }, "frames": frames,
    });
    fs::write(folder.path().join("transforms.json"), manifest.to_string()).expect("a manifest");
    folder
}

#[test]
fn views_are_on_one_scale_by_their_exposures() {
    let folder = capture(&[1.0, 0.25], false);
    let capture = Capture::load(folder.path()).expect("a capture");
    assert!(!capture.is_developed);
    assert!(capture.warnings.is_empty(), "{:?}", capture.warnings);
    let [bright, dark] = [0, 1].map(|k| &capture.views[k].photograph.radiance);
    for (a, b) in bright.iter().flatten().zip(dark.iter().flatten()) {
        assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");
    }
    // t · (ISO/100) / N² is 1/16.
    let expected = 16.0 * scene(20.0, 18.0)[1];
    let found = f64::from(bright[18 * 40 + 20][1]);
    assert!((found / expected - 1.0).abs() < 0.02, "{found} {expected}");
}

#[test]
fn brackets_of_raw_files_are_linear() {
    let folder = capture(&[0.25, 1.0, 4.0], true);
    let capture = Capture::load(folder.path()).expect("a capture");
    let brackets = capture.brackets.expect("brackets");
    assert!(brackets.response.is_assumed(), "{:?}", brackets.response);
    assert_eq!(brackets.response.assumed, crate::Origin::Linear);
    let factors: Vec<f64> = (brackets.views[0].iter())
        .filter_map(|exposure| exposure.measured_factor)
        .collect();
    assert!(
        !factors.is_empty() && factors.iter().all(|f| (f - 1.0).abs() < 0.02),
        "{factors:?}"
    );
    let photograph = &capture.views[0].photograph;
    assert!(photograph.usable.iter().all(|&usable| usable));
}

#[test]
fn raw_files_of_a_folder_are_grouped_without_the_pictures_beside_them() {
    let folder = capture(&[0.25, 1.0, 4.0], true);
    fs::remove_file(folder.path().join("transforms.json")).expect("removed");
    for k in 0..3 {
        fs::write(folder.path().join(format!("DSC_{k}.JPG")), b"no picture").expect("written");
    }
    let photos = Photos::find(&[folder.path().to_owned()], None).expect("photographs");
    assert_eq!(photos.groups.len(), 1);
    let times: Vec<Option<Settings>> = (photos.groups[0].photos.iter())
        .map(|photo| photo.shot.settings)
        .collect();
    let settings = |time: f64| {
        Some(Settings {
            time,
            f_number: Some(4.0),
            iso: Some(100.0),
        })
    };
    assert_eq!(times, [settings(0.25), settings(1.0), settings(4.0)]);
    let response = photos.response().expect("a response");
    let merged = photos.merge(0, &response).expect("merged");
    assert_eq!((merged.width, merged.height, merged.saturated), (40, 36, 0));
}

#[test]
fn another_size_is_refused_before_the_samples_are_decoded() {
    let folder = capture(&[1.0], false);
    let path = folder.path().join("DSC_0.DNG");
    let mut bytes = fs::read(&path).expect("the file");
    // The size is in the header, and the file has no samples now.
    bytes.splice(8..8 + 2 * 56 * 46, []);
    let at = 8_u32.to_le_bytes();
    bytes[4..8].copy_from_slice(&at);
    fs::write(&path, bytes).expect("written");
    let message = Capture::load(folder.path()).expect_err("no samples");
    assert!(message.to_string().contains("DSC_0.DNG"), "{message}");

    let folder = capture(&[1.0], false);
    let manifest = folder.path().join("transforms.json");
    let text = fs::read_to_string(&manifest).expect("the manifest");
    fs::write(&manifest, text.replace("\"w\":40", "\"w\":41")).expect("written");
    let message = Capture::load(folder.path())
        .expect_err("another size")
        .to_string();
    assert!(
        message.contains("40×36") && message.contains("41×36"),
        "{message}"
    );
}

#[test]
fn what_is_no_raw_file_says_so() {
    let jpeg = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/capture/rgb8.jpg");
    let jpeg = fs::read(jpeg).expect("test data");
    for bytes in [b"".as_slice(), b"II*\0", b"none at all", &jpeg] {
        let message = develop_with(bytes, None)
            .expect_err("no raw file")
            .to_string();
        assert!(
            message.starts_with("a.dng: the image cannot be decoded: "),
            "{message}"
        );
        assert!(!message.contains('\n'), "{message}");
    }
}

#[test]
fn cut_files_are_refused() {
    let bytes = Dng::default().bytes(scene);
    for share in [0.1, 0.5, 0.9, 0.99] {
        let end = (bytes.len() as f64 * share) as usize;
        let message = develop_with(&bytes[..end], None)
            .expect_err("cut")
            .to_string();
        assert!(!message.contains("Custom"), "{end} bytes: {message}");
    }
}

#[test]
fn damaged_files_never_panic() {
    let original = Dng::default().bytes(scene);
    let root = original.len() - 600;
    let mut random = Random(11);
    let mut read_well = 0;
    for round in 0..400 {
        // Damage to samples tells little: mostly the directories are damaged.
        let from = if round % 4 == 0 { 0 } else { root };
        let bytes = [&original[..from], &damaged(&original[from..], &mut random)].concat();
        if let Ok(picture) = develop_with(&bytes, None) {
            let pixels = picture.width as usize * picture.height as usize;
            assert_eq!([picture.rgb.len(), picture.saturated.len()], [pixels; 2]);
            read_well += 1;
        }
        let _ = read_size(Path::new("a.dng"), bytes.clone());
        let _ = metadata(Path::new("a.dng"), bytes);
    }
    assert!(read_well > 40, "{read_well}");
}

#[test]
fn directories_without_end_and_entries_without_measure_are_refused() {
    let path = Path::new("a.dng");
    let good = Dng::default().bytes(scene);
    assert!(directory::check(path, &good).is_ok());
    let root = u32::from_le_bytes(*good[4..].first_chunk().expect("a header")) as usize;
    let count = usize::from(good[root]);
    let refused = |at: usize, number: u32, part: &str| {
        let mut bytes = good.clone();
        bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
        let message = develop_with(&bytes, None).expect_err("refused").to_string();
        assert!(message.contains(part), "{message}");
    };
    refused(
        root + 2 + 12 * count,
        root as u32,
        "its directories have no end",
    );
    let entry = |tag: u16| {
        let entries = (0..count).map(|i| root + 2 + 12 * i);
        let mut of_tag = entries.filter(|&at| good[at..at + 2] == tag.to_le_bytes());
        of_tag.next().expect("the entry")
    };
    refused(entry(50_721) + 4, 1 << 30, "longer than the file");
    refused(entry(256) + 8, 20_000_000, "header announces 20000000×46");
    refused(entry(257) + 8, 2_000_000, "more than its");
}
