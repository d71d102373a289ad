//! Cameras as a `transforms.json` in the nerfstudio convention, which `rekindle render --cameras` reads too.

use glam::DVec3;
use serde_json::{Map, Value, json};

use super::Camera;

/// A frame for each camera, with its name as `file_path` and all intrinsics, in the world in which theirs has its origin at
/// `origin`.
pub fn transforms(cameras: &[(String, Camera)], origin: DVec3) -> Value {
    let frames: Vec<Value> = cameras
        .iter()
        .map(|(name, camera)| frame(name, &camera.clone().seen_about(-origin)))
        .collect();
    json!({ "frames": frames })
}

fn frame(name: &str, camera: &Camera) -> Value {
    let distortion = &camera.distortion;
    let mut frame = Map::new();
    let mut put = |key: &str, value: Value| frame.insert(key.to_owned(), value);
    put("file_path", json!(name));
    put("w", json!(camera.width));
    put("h", json!(camera.height));
    put("fl_x", json!(camera.focal.x));
    put("fl_y", json!(camera.focal.y));
    put("cx", json!(camera.centre.x));
    put("cy", json!(camera.centre.y));
    let [k1, k2, k3, k4] = distortion.k;
    let [p1, p2] = distortion.p;
    let [k5, k6, k7] = distortion.denominator;
    let rational = distortion.denominator != [0.0; 3];
    let model = match (distortion.is_none(), rational) {
        _ if distortion.fisheye => "OPENCV_FISHEYE",
        (true, _) => "PINHOLE",
        (false, false) => "OPENCV",
        (false, true) => "FULL_OPENCV",
    };
    put("camera_model", json!(model));
    let named = if rational {
        // FULL_OPENCV counts the denominator's coefficients k4 to k6.
        vec![
            ("k1", k1),
            ("k2", k2),
            ("p1", p1),
            ("p2", p2),
            ("k3", k3),
            ("k4", k5),
            ("k5", k6),
            ("k6", k7),
        ]
    } else {
        vec![
            ("k1", k1),
            ("k2", k2),
            ("p1", p1),
            ("p2", p2),
            ("k3", k3),
            ("k4", k4),
        ]
    };
    for (key, value) in named.into_iter().filter(|(_, v)| *v != 0.0) {
        put(key, json!(value));
    }
    put("transform_matrix", camera_matrix(camera));
    Value::Object(frame)
}

/// Camera-to-world matrix, row by row.
pub fn camera_matrix(camera: &Camera) -> Value {
    let pose = camera.world_from_camera;
    let mut rows: Vec<[f64; 4]> = (0..3)
        .map(|i| {
            let row = pose.matrix3.row(i);
            [row.x, row.y, row.z, pose.translation[i]]
        })
        .collect();
    rows.push([0.0, 0.0, 0.0, 1.0]);
    json!(rows)
}
