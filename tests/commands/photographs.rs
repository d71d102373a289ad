//! The commands that make captures of photographs: merging brackets and aligning the mesh.

use std::fs;
use std::path::{Path, PathBuf};

use crate::command::rekindle;
use glam::DVec3;
use rekindle_capture::{Capture, View};
use serde_json::{Value, json};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn json_of(arguments: &[&str]) -> Value {
    let run = rekindle(&[arguments, &["--json", "--quiet"]].concat());
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    serde_json::from_slice(&run.stdout).unwrap()
}

#[test]
fn brackets_are_merged_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let (capture, merged) = (folder.path().join("capture"), folder.path().join("merged"));
    json_of(&[
        "synth",
        "-o",
        text(&capture),
        "--object",
        "sphere",
        "--triangles",
        "2000",
        "--size",
        "96x72",
        "--views",
        "3",
        "--samples",
        "16",
        "--brackets",
        "5",
        "--bracket-stops",
        "1",
        "--response",
        "gamma",
        "--no-pictures",
    ]);
    // The photographs alone, without a manifest: named alike but for the exposure's number.
    let photographs = capture.join("images");
    let arguments = ["merge", text(&photographs), "-o", text(&merged)];
    let run = rekindle(&[&arguments[..], &["--quiet"]].concat());
    assert_eq!(run.status.code(), Some(2));
    let message = String::from_utf8_lossy(&run.stderr);
    assert!(message.contains("its exposure is not known"), "{message}");
    assert!(!merged.exists(), "nothing may be written");
    let table = "*_0.png,1\n*_1.png,2\n*_2.png,4\n*_3.png,8\n*_4.png,16\n";
    fs::write(photographs.join("exposures.csv"), table).unwrap();
    let found = json_of(&arguments);
    assert_eq!(found["response"]["origin"], "recovered");
    assert_eq!(found["views"].as_array().unwrap().len(), 3);
    for name in [
        "view_000.exr",
        "view_002.exr",
        "response.json",
        "weights.csv",
        "frames.json",
    ] {
        assert!(merged.join(name).is_file(), "{name}");
    }
    let curve = fs::read_to_string(merged.join("response.csv")).unwrap();
    assert_eq!(curve.lines().count(), 257);
    // A gamma of 1.8: codes twice as large stand for 3.48 times the exposure.
    let exposure = |code: usize| -> f64 {
        let line = curve.lines().nth(code + 1).unwrap();
        line.split(',').nth(2).unwrap().parse().unwrap()
    };
    let ratio = exposure(200) / exposure(100);
    assert!((ratio / 2.0_f64.powf(1.8) - 1.0).abs() < 0.02, "{ratio}");
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(left.len(), 2, "nothing is left behind");
}

/// A capture whose mesh lies elsewhere: with z upwards, a hundred times as large, far off.
fn misplaced(folder: &Path) -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures/spot_paper");
    let capture = folder.join("capture");
    fs::create_dir_all(capture.join("images")).unwrap();
    for i in 0..6 {
        let name = format!("images/view_{i:03}.exr");
        fs::copy(source.join(&name), capture.join(&name)).unwrap();
    }
    fs::copy(source.join("mesh.obj"), capture.join("mesh.obj")).unwrap();
    let manifest = fs::read(source.join("transforms.json")).unwrap();
    let mut manifest: Value = serde_json::from_slice(&manifest).unwrap();
    manifest["mesh_transform"] = json!([
        [100, 0, 0, 900],
        [0, 0, -100, 40],
        [0, 100, 0, 0],
        [0, 0, 0, 1]
    ]);
    fs::write(capture.join("transforms.json"), manifest.to_string()).unwrap();
    capture
}

/// Checks that the mesh of a capture lies where the photographs show it.
fn lies_well(capture: &Path) {
    let report = json_of(&["info", text(capture)]);
    for view in report["views"].as_array().unwrap() {
        let overlap = view["silhouette_iou"].as_f64().unwrap();
        assert!(overlap > 0.97, "{view}");
    }
}

#[test]
fn a_mesh_from_elsewhere_is_aligned() {
    let folder = tempfile::tempdir().unwrap();
    let capture = misplaced(folder.path());
    let run = rekindle(&["info", text(&capture)]);
    let message = String::from_utf8_lossy(&run.stderr);
    assert!(message.contains("rekindle align"), "{message}");
    let found = json_of(&["align", text(&capture)]);
    assert!(found["overlap"].as_f64().unwrap() > 0.97, "{found}");
    assert_eq!(found["ambiguous"], false);
    lies_well(&capture);
    assert_eq!(
        fs::read_dir(&capture).unwrap().count(),
        3,
        "nothing is left behind"
    );
}

#[test]
fn a_mesh_is_aligned_by_points_marked_in_photographs() {
    let folder = tempfile::tempdir().unwrap();
    let path = misplaced(folder.path());
    let (capture, _) = Capture::load_unplaced(&path).unwrap();
    // Vertices of the mesh, and where they belong: without the transform that was put on.
    let point = |(vertex, views): (usize, [usize; 2])| {
        let place = capture.mesh.positions[vertex].as_dvec3();
        let there = DVec3::new(
            (place.x - 900.0) / 100.0,
            place.z / 100.0,
            (40.0 - place.y) / 100.0,
        );
        let mark = |view: usize| {
            let View { name, camera, .. } = &capture.views[view];
            let pixel = camera.project(there).unwrap();
            (name.clone(), json!([pixel.x.round(), pixel.y.round()]))
        };
        let marks: serde_json::Map<String, Value> = views.into_iter().map(mark).collect();
        json!({ "mesh": [place.x, place.y, place.z], "marks": marks })
    };
    let points: Vec<Value> = [(100, [0, 1]), (1500, [2, 3]), (2500, [0, 5])]
        .into_iter()
        .map(point)
        .collect();
    let file = folder.path().join("points.json");
    fs::write(&file, json!(points).to_string()).unwrap();
    let found = json_of(&["align", text(&path), "--points", text(&file)]);
    assert!(found["overlap"].as_f64().unwrap() > 0.97, "{found}");
    lies_well(&path);
    // Two points leave the place open, and the file says which file.
    fs::write(&file, json!(points[..2]).to_string()).unwrap();
    let run = rekindle(&["align", text(&path), "--points", text(&file), "--quiet"]);
    assert_eq!(run.status.code(), Some(2));
    let message = String::from_utf8_lossy(&run.stderr);
    assert!(message.contains("points.json: only 2 points"), "{message}");
}
