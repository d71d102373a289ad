//! A capture as other programs would write it is solved as well as the original: through a distorting lens, in 16-bit PNG
//! files with straight alpha, with a mesh in binary PLY, in a scene that nerfstudio moved and scaled.

use std::fs;
use std::path::Path;
use std::process::Command;

use glam::{DMat4, DVec2, DVec3};
use image::{ImageBuffer, Rgba};
use rekindle_capture::{Camera, Capture, Distortion, Mesh, View};
use serde_json::{Value, json};

const LENS: Distortion = Distortion {
    k: [0.15, -0.2, 0.0, 0.0],
    p: [0.002, -0.003],
    denominator: [0.0; 3],
    fisheye: false,
};

/// The view through another lens: premultiplied RGB and alpha, row by row.
fn through(lens: &Camera, view: &View) -> Vec<[f32; 4]> {
    let photograph = &view.photograph;
    let (width, height) = (photograph.width as usize, photograph.height as usize);
    let coverage = photograph.coverage.as_ref().unwrap();
    let value = |at: DVec2| {
        let corner = (at - 0.5).clamp(
            DVec2::ZERO,
            DVec2::new(width as f64 - 1.001, height as f64 - 1.001),
        );
        let (x, y) = (corner.x as usize, corner.y as usize);
        let (fx, fy) = (corner.x.fract() as f32, corner.y.fract() as f32);
        let mut sum = [0.0; 4];
        for (dx, dy, weight) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            let i = (y + dy) * width + x + dx;
            let [r, g, b] = photograph.radiance[i];
            for (sum, v) in sum.iter_mut().zip([r, g, b, coverage[i]]) {
                *sum += weight * v;
            }
        }
        sum
    };
    (0..width * height)
        .map(|i| {
            let pixel = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let point = lens.position() + lens.ray(pixel);
            value(view.camera.project(point).unwrap())
        })
        .collect()
}

/// Writes a 16-bit PNG file in which `full` is full scale.
fn write_png(path: &Path, width: u32, pixels: &[[f32; 4]], full: f32) {
    let codes = pixels.iter().flat_map(|&[r, g, b, a]| {
        let straight = [r, g, b].map(|v| v / (a.max(1e-6) * full));
        [straight[0], straight[1], straight[2], a].map(|v| (v * 65_535.0).round() as u16)
    });
    let height = pixels.len() as u32 / width;
    let picture = ImageBuffer::<Rgba<u16>, _>::from_raw(width, height, codes.collect::<Vec<_>>());
    picture.unwrap().save(path).unwrap();
}

fn write_ply(path: &Path, mesh: &Mesh) {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\nelement face {}\n\
         property list uchar int vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for (position, normal) in mesh.positions.iter().zip(&mesh.normals) {
        for value in position.to_array().into_iter().chain(normal.to_array()) {
            bytes.extend(value.to_le_bytes());
        }
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
    }
    fs::write(path, bytes).unwrap();
}

/// The manifest for a scene moved by `applied` and scaled by `scale`.
fn manifest(source: &Path, applied: DMat4, scale: f64) -> Value {
    let text = fs::read(source.join("transforms.json")).unwrap();
    let mut manifest: Value = serde_json::from_slice(&text).unwrap();
    let rows = |m: DMat4| json!(m.transpose().to_cols_array_2d());
    let angle = 2.0 * (160.0 / manifest["fl_x"].as_f64().unwrap()).atan();
    let fields = manifest.as_object_mut().unwrap();
    for key in ["w", "h", "fl_x", "fl_y", "cx", "cy"] {
        fields.remove(key);
    }
    for (i, frame) in manifest["frames"]
        .as_array_mut()
        .unwrap()
        .iter_mut()
        .enumerate()
    {
        let stated = &frame["transform_matrix"];
        let entry = |row: usize, column: usize| stated[row][column].as_f64().unwrap();
        let pose = DMat4::from_cols_array(&std::array::from_fn(|k| entry(k % 4, k / 4)));
        let mut moved = applied * pose;
        moved.w_axis = (moved.w_axis.truncate() * scale).extend(1.0);
        frame["transform_matrix"] = rows(moved);
        frame["file_path"] = json!(format!("./images/{i}"));
        frame["camera_angle_x"] = json!(angle);
    }
    manifest["camera_model"] = json!("OPENCV");
    for (key, value) in [
        ("k1", LENS.k[0]),
        ("k2", LENS.k[1]),
        ("p1", LENS.p[0]),
        ("p2", LENS.p[1]),
    ] {
        manifest[key] = json!(value);
    }
    manifest["mesh_path"] = json!("mesh.ply");
    manifest["applied_transform"] = rows(applied);
    manifest["applied_scale"] = json!(scale);
    manifest
}

#[test]
fn a_capture_as_other_programs_write_it_is_solved_as_well() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures/spot_paper");
    let capture = Capture::load(&source).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("capture");
    fs::create_dir_all(target.join("images")).unwrap();
    let radiances = capture
        .views
        .iter()
        .flat_map(|view| &view.photograph.radiance);
    let full = 1.1 * radiances.flatten().fold(0.0_f32, |a, &b| a.max(b));
    for (i, view) in capture.views.iter().enumerate() {
        let lens = Camera {
            distortion: LENS,
            ..view.camera.clone()
        };
        let name = format!("images/{i}.png");
        write_png(&target.join(name), lens.width, &through(&lens, view), full);
    }
    write_ply(&target.join("mesh.ply"), &capture.mesh);
    let turn = DMat4::from_axis_angle(DVec3::new(0.36, 0.48, 0.8), 2.0);
    let applied = DMat4::from_translation(DVec3::new(0.3, -0.2, 0.1)) * turn;
    let text = manifest(&source, applied, 0.25).to_string();
    fs::write(target.join("transforms.json"), text).unwrap();

    let run = Command::new(env!("CARGO_BIN_EXE_rekindle"))
        .args(["solve", "capture", "-o", "solution", "--json", "--quiet"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let found: Value = serde_json::from_slice(&run.stdout).unwrap();
    let truth = fs::read(source.join("truth/truth.json")).unwrap();
    let truth: Value = serde_json::from_slice(&truth).unwrap();
    let sigma = truth["material"]["sigma"].as_f64().unwrap();
    let error = found["sigma"].as_f64().unwrap() / sigma - 1.0;
    assert!(error.abs() < 0.01, "sigma is off by {error}");
    let vector = |value: &Value| DVec3::from_array([0, 1, 2].map(|k| value[k].as_f64().unwrap()));
    let lights = found["lights"].as_array().unwrap();
    for lamp in truth["lights"].as_array().unwrap() {
        let direction = vector(&lamp["direction"]);
        let angles = lights
            .iter()
            .map(|l| vector(&l["direction"]).angle_between(direction));
        let off = angles.fold(f64::INFINITY, f64::min).to_degrees();
        assert!(off < 0.2, "a lamp is off by {off}°");
    }
}
