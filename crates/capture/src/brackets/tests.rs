//! Brackets as files: exposures from every source, refusals, orientation, whole folders.

use super::*;
use crate::Capture;
use crate::picture::Picture;
use exif::experimental::Writer;
use exif::{Field, In, Rational, Tag, Value};
use serde_json::json;
use std::fs;
use std::io::Cursor;
use std::path::Path;

const SIZE: (u32, u32) = (48, 40);

/// Radiance of a pixel: from black to bright, without sharp edges.
fn radiance(x: u32, y: u32) -> f32 {
    0.003 * 2.0_f32.powf(9.0 * (x as f32 + 0.5) / SIZE.0 as f32) * (1.0 + 0.01 * y as f32)
}

fn pixels(code: &dyn Fn(f32) -> f32, amount: f32) -> image::RgbImage {
    image::RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        let value = (255.0 * code((radiance(x, y) * amount).min(1.0))).round() as u8;
        image::Rgb([value; 3])
    })
}

/// EXIF data as they stand in a file.
fn exif_data(settings: Option<Settings>, second: u32, orientation: u16) -> Vec<u8> {
    let rational = |v: f64| Value::Rational(vec![Rational::from(((v * 1e6) as u32, 1_000_000))]);
    let mut fields = vec![
        (Tag::Model, Value::Ascii(vec![b"Box".to_vec()])),
        (Tag::Orientation, Value::Short(vec![orientation])),
        (
            Tag::DateTimeOriginal,
            Value::Ascii(vec![format!("2026:03:01 12:00:{second:02}").into_bytes()]),
        ),
    ];
    if let Some(settings) = settings {
        fields.push((Tag::ExposureTime, rational(settings.time)));
        fields.extend(settings.f_number.map(|n| (Tag::FNumber, rational(n))));
        fields.extend(
            settings
                .iso
                .map(|iso| (Tag::PhotographicSensitivity, Value::Short(vec![iso as u16]))),
        );
    }
    let fields: Vec<Field> = fields
        .into_iter()
        .map(|(tag, value)| Field {
            tag,
            ifd_num: In::PRIMARY,
            value,
        })
        .collect();
    let mut writer = Writer::new();
    for field in &fields {
        writer.push_field(field);
    }
    let mut out = Cursor::new(Vec::new());
    writer.write(&mut out, true).expect("EXIF data");
    out.into_inner()
}

/// A JPEG file with EXIF data after its first marker.
fn jpeg(image: &image::RgbImage, exif: &[u8]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 100);
    image.write_with_encoder(encoder).expect("JPEG");
    let bytes = bytes.into_inner();
    let length = (exif.len() + 8) as u16;
    let segment = [&[0xff, 0xe1][..], &length.to_be_bytes(), b"Exif\0\0", exif].concat();
    [&bytes[..2], &segment, &bytes[2..]].concat()
}

fn settings(time: f64) -> Settings {
    Settings {
        time,
        f_number: Some(2.0),
        iso: Some(100.0),
    }
}

/// Exposure times of the brackets below: a stop apart, with N = 2.
const TIMES: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];

/// A folder with a bracket of JPEG files `DSC_0.JPG` … whose EXIF data state their exposure.
fn folder(code: &dyn Fn(f32) -> f32) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("folder");
    for (k, time) in TIMES.into_iter().enumerate() {
        let image = pixels(code, time as f32 / 4.0);
        let bytes = jpeg(&image, &exif_data(Some(settings(time)), k as u32, 1));
        fs::write(folder.path().join(format!("DSC_{k}.JPG")), bytes).expect("written");
    }
    folder
}

/// Makes a folder of a bracket a capture that leaves its exposures to other sources.
fn make_capture(folder: &Path) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/capture/box.obj");
    fs::copy(source, folder.join("box.obj")).expect("mesh");
    let exposures: Vec<_> = (0..TIMES.len())
        .map(|k| json!({ "file_path": format!("DSC_{k}.JPG") }))
        .collect();
    let pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]];
    let manifest = json!({
        "w": SIZE.0, "h": SIZE.1, "fl_x": 48.0, "light_hemisphere": { "up": [0, 1, 0] },
        "frames": [{ "transform_matrix": pose, "exposures": exposures }],
    });
    fs::write(folder.join("transforms.json"), manifest.to_string()).expect("manifest");
}

fn srgb(v: f32) -> f32 {
    if v <= 0.003_130_8 {
        12.92 * v
    } else {
        1.055 * v.powf(1.0 / 2.4) - 0.055
    }
}

/// Root mean square relative error of a capture's radiance, apart from a common factor, where the longest exposure has
/// codes worth less than a twentieth each.
fn error(capture: &Capture) -> f32 {
    let found = &capture.views[0].photograph;
    let ratios: Vec<f32> = (0..SIZE.0 * SIZE.1)
        .filter(|&i| found.usable[i as usize])
        .map(|i| (i % SIZE.0, i / SIZE.0, found.radiance[i as usize][1]))
        .filter(|&(x, y, _)| radiance(x, y) > 0.02)
        .map(|(x, y, v)| v / radiance(x, y))
        .collect();
    let count = ratios.len() as f32;
    assert!(count > 1000.0, "{count}");
    let middle = ratios.iter().sum::<f32>() / count;
    let squares: f32 = ratios.iter().map(|r| (r / middle - 1.0).powi(2)).sum();
    (squares / count).sqrt()
}

#[test]
fn exposures_and_the_response_come_from_the_files() {
    let gamma = |v: f32| v.powf(1.0 / 1.6);
    let cases: [(&dyn Fn(f32) -> f32, Origin); 2] =
        [(&srgb, Origin::Srgb), (&gamma, Origin::Recovered)];
    for (code, origin) in cases {
        let folder = folder(code);
        make_capture(folder.path());
        let capture = Capture::load(folder.path()).expect("a capture");
        let brackets = capture.brackets.as_ref().expect("brackets");
        assert_eq!(brackets.response.origin, origin);
        let error = error(&capture);
        assert!(error < 0.01, "{origin:?}: {error}");
        let weights: f64 = brackets.views[0].iter().map(|u| u.weight).sum();
        assert!((weights - 1.0).abs() < 1e-9, "{weights}");
        assert!(brackets.views[0][0].clipped > brackets.views[0][4].clipped);
    }
}

#[test]
fn a_table_overrides_what_files_say() {
    let folder = folder(&srgb);
    make_capture(folder.path());
    let bytes = jpeg(&pixels(&srgb, 0.25), &exif_data(None, 2, 1));
    fs::write(folder.path().join("DSC_2.JPG"), bytes).expect("written");
    let message = Capture::load(folder.path())
        .expect_err("no exposure")
        .to_string();
    for part in [
        "frames[0].exposures[2].exposure_time is missing",
        "DSC_2.JPG",
        "exposures.csv",
    ] {
        assert!(message.contains(part), "{message}");
    }
    fs::write(
        folder.path().join(TABLE),
        "file,time,f,iso\nDSC_2.JPG,1,2,100\n",
    )
    .expect("table");
    let error = error(&Capture::load(folder.path()).expect("a capture"));
    assert!(error < 0.01, "{error}");
    fs::write(folder.path().join(TABLE), "DSC_2.JPG,1\n").expect("table");
    let message = Capture::load(folder.path())
        .expect_err("no f-number")
        .to_string();
    assert!(
        message.contains("f_number is missing") && message.contains("DSC_2.JPG"),
        "{message}"
    );
}

#[test]
fn exposures_that_pixels_contradict_are_named() {
    let folder = folder(&srgb);
    make_capture(folder.path());
    let message = |table: &str| {
        fs::write(folder.path().join(TABLE), table).expect("table");
        Capture::load(folder.path()).map(|c| c.warnings.join("\n"))
    };
    let same = "DSC_*.JPG,1,2,100\n";
    let refused = message(same).expect_err("identical").to_string();
    assert!(
        refused.contains("same exposure") && refused.contains("exposures.csv"),
        "{refused}"
    );
    let swapped = message("DSC_0.JPG,4,2,100\nDSC_4.JPG,0.25,2,100\n").expect_err("swapped");
    assert!(swapped.to_string().contains("but is brighter"), "{swapped}");
    let doubtful = message("DSC_4.JPG,5.6,2,100\n").expect("a doubt");
    assert!(
        doubtful.contains("DSC_4.JPG") && doubtful.contains("their pixels say"),
        "{doubtful}"
    );
}

#[test]
fn pictures_are_turned_as_their_orientation_says() {
    let folder = tempfile::tempdir().expect("folder");
    let image = pixels(&srgb, 0.1);
    let upright = folder.path().join("turned.jpg");
    // 6: the picture is to be turned clockwise by a quarter.
    fs::write(
        &upright,
        jpeg(&image::imageops::rotate270(&image), &exif_data(None, 0, 6)),
    )
    .expect("written");
    let read = |size: Option<(u32, u32)>| {
        Picture::read(&upright, "file", true, None, &move |found| {
            if size.is_none_or(|size| size == found) {
                return Ok(());
            }
            Err(CaptureError::ImageSize {
                path: "x".into(),
                found,
                stated: size.unwrap_or_default(),
                stated_by: "a test".to_owned(),
            })
        })
    };
    let picture = read(None).expect("a picture");
    assert_eq!((picture.width, picture.height), SIZE);
    let corner = picture.codes.expect("codes").at(0)[0] / 257;
    assert!(
        corner.abs_diff(image.get_pixel(0, 0).0[0].into()) <= 2,
        "{corner}"
    );
    let stored = read(Some((SIZE.1, SIZE.0))).expect("as stored");
    assert_eq!(
        (stored.width, stored.height),
        (SIZE.1, SIZE.0),
        "what the manifest states wins"
    );
    assert!(read(Some((7, 7))).is_err());
}

#[test]
fn a_folder_of_brackets_groups_itself() {
    let folder = tempfile::tempdir().expect("folder");
    for i in 0..10 {
        let time = TIMES[i % 5];
        let bytes = jpeg(
            &pixels(&srgb, time as f32 / 4.0),
            &exif_data(Some(settings(time)), i as u32, 1),
        );
        fs::write(
            folder.path().join(format!("IMG_{:04}.JPG", 9998 + i)),
            bytes,
        )
        .expect("written");
    }
    let photos = Photos::find(&[folder.path().to_owned()], None).expect("photographs");
    let counts: Vec<usize> = photos.groups.iter().map(|g| g.photos.len()).collect();
    assert_eq!(counts, [5, 5]);
    let response = photos.response().expect("a response");
    let merged = photos.merge(1, &response).expect("a picture");
    assert_eq!(merged.uses.len(), 5);
    let at = (20 * SIZE.0 + 30) as usize;
    let off = merged.radiance[at][1] / radiance(30, 20) - 1.0;
    assert!(off.abs() < 0.02, "{off}");
}

#[test]
fn photographs_that_are_no_brackets_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let find = || {
        Photos::find(&[folder.path().to_owned()], None)
            .expect_err("refused")
            .to_string()
    };
    assert!(find().contains("no photographs in this folder"));
    for i in 0..3 {
        let bytes = jpeg(&pixels(&srgb, 0.1), &exif_data(Some(settings(1.0)), i, 1));
        fs::write(folder.path().join(format!("a_{i}.jpg")), bytes).expect("written");
    }
    assert!(
        find().contains("all 3 photographs state the same exposure"),
        "{}",
        find()
    );
    let bytes = jpeg(&pixels(&srgb, 0.1), &exif_data(None, 9, 1));
    fs::write(folder.path().join("b.jpg"), bytes).expect("written");
    assert!(
        find().contains("b.jpg: its exposure is not known"),
        "{}",
        find()
    );
}

#[test]
fn damaged_tables_and_exif_data_never_panic() {
    use rekindle_base::damage::{Random, damaged};
    let mut random = Random(12);
    let table = b"file,time,f,iso\n\"a,b.jpg\",1/60,8,200\n*_2.png;0.5\n".as_slice();
    let file = jpeg(&pixels(&srgb, 0.1), &exif_data(Some(settings(0.5)), 3, 6));
    let data = exif_data(Some(settings(0.5)), 3, 6);
    for _ in 0..3000 {
        if let Ok(table) = Table::parse(Path::new("t.csv"), &damaged(table, &mut random)) {
            let _ = table.settings(Path::new("a_2.png"));
        }
        let _ = Shot::parse(&mut Cursor::new(damaged(&file[..600], &mut random)));
        let _ = Shot::parse(&mut Cursor::new(damaged(&data, &mut random)));
    }
}
