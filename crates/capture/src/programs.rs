//! Cameras and meshes as other programs write them: by files of COLMAP itself, and by the conventions of the others.

use super::manifest::Manifest;
use super::{Camera, CaptureError, gltf, mesh_file, read_cameras, transforms};
use glam::{DMat3, DQuat, DVec2, DVec3};
use rekindle_base::damage::{Random, damaged};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};

fn colmap(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/data/colmap")
        .join(name)
}

fn camera<'a>(cameras: &'a [(String, Camera)], image: &str) -> &'a Camera {
    let places = [image.to_owned(), format!("images/{image}")];
    let found = cameras.iter().find(|(name, _)| places.contains(name));
    &found.expect("the image's camera").1
}

/// Largest distance, in pixels, between where COLMAP and the cameras project points to.
fn disagreement(cameras: &[(String, Camera)]) -> f64 {
    let text = fs::read_to_string(colmap("projections.json")).expect("test data");
    let data: Value = serde_json::from_str(&text).expect("JSON");
    let list = data["projections"].as_array().expect("a list");
    assert_eq!(list.len(), 7 * 12);
    let vector = |value: &Value| -> Vec<f64> {
        let numbers = value.as_array().expect("numbers").iter();
        numbers.map(|v| v.as_f64().expect("a number")).collect()
    };
    let off = list.iter().map(|entry| {
        let (point, pixel) = (vector(&entry["point"]), vector(&entry["pixel"]));
        let camera = camera(cameras, entry["image"].as_str().expect("a name"));
        let found = camera.project(DVec3::from_slice(&point)).expect("in front");
        let expected = DVec2::from_slice(&pixel);
        let back = camera
            .project(camera.position() + 2.0 * camera.ray(expected))
            .expect("in front");
        (found - expected).length().max((back - expected).length())
    });
    off.fold(0.0, f64::max)
}

#[test]
fn cameras_project_as_colmap_does() {
    for kind in ["text", "binary"] {
        let cameras = read_cameras(&colmap(kind), DVec3::ZERO).expect("a model");
        assert_eq!(cameras.len(), 7);
        let off = disagreement(&cameras);
        assert!(off < 1e-6, "{kind}: {off} pixels");
        // What is written of them is read the same.
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("transforms.json");
        fs::write(&path, transforms(&cameras, DVec3::ZERO).to_string()).expect("written");
        let off = disagreement(&read_cameras(&path, DVec3::ZERO).expect("cameras"));
        assert!(off < 1e-6, "{kind}, written: {off} pixels");
    }
}

#[test]
fn text_models_of_careless_exporters_are_read() {
    let folder = tempfile::tempdir().expect("folder");
    let copy = |name: &str| fs::read_to_string(colmap("text").join(name)).expect("test data");
    fs::write(folder.path().join("cameras.txt"), copy("cameras.txt")).expect("written");
    let images = copy("images.txt");
    let is_image = |line: &&str| line.contains(".png");
    // Without the lines of points, with tabs and carriage returns, and without a last line end.
    let bare: Vec<&str> = images.lines().filter(is_image).collect();
    let tabs: Vec<String> = images.lines().map(|l| l.replacen(' ', "\t", 9)).collect();
    for text in [bare.join("\n"), tabs.join("\r\n"), bare.join("\n\n")] {
        fs::write(folder.path().join("images.txt"), text).expect("written");
        let cameras = read_cameras(folder.path(), DVec3::ZERO).expect("a model");
        assert_eq!(cameras.len(), 7);
        assert!(disagreement(&cameras) < 1e-6);
    }
}

#[test]
fn models_that_cannot_be_stated_are_refused_by_name() {
    let mut refused = 0;
    for folder in fs::read_dir(colmap("refused")).expect("test data") {
        let folder = folder.expect("entry").path();
        let name = folder
            .file_name()
            .expect("name")
            .to_string_lossy()
            .to_uppercase();
        let message = read_cameras(&folder, DVec3::ZERO)
            .expect_err("refused")
            .to_string();
        assert!(message.contains(&name), "{message}");
        assert!(message.contains("colmap image_undistorter"), "{message}");
        refused += 1;
    }
    assert_eq!(refused, 11);
}

/// A camera turned every way, and where a point lies for it: x to the right, y down, z ahead.
struct Reference {
    camera_from_world: DMat3,
    centre: DVec3,
}

fn reference() -> Reference {
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 2.4, -0.4, 0.7);
    Reference {
        camera_from_world: DMat3::from_quat(turn),
        centre: DVec3::new(0.3, 2.1, 3.2),
    }
}

impl Reference {
    fn points(&self) -> [DVec3; 3] {
        let seen = [
            DVec3::new(0.0, 0.0, 4.0),
            DVec3::new(0.7, -0.4, 3.0),
            DVec3::new(-0.5, 0.9, 5.0),
        ];
        seen.map(|p| self.centre + self.camera_from_world.transpose() * p)
    }

    /// Normalised image coordinates, y downwards.
    fn see(&self, point: DVec3) -> DVec2 {
        let p = self.camera_from_world * (point - self.centre);
        DVec2::new(p.x, p.y) / p.z
    }
}

/// SfMData of one view, all numbers as texts, the lens as `lens` states it.
fn sfm_data(reference: &Reference, version: [&str; 3], lens: &Value) -> Value {
    let texts = |values: &[f64]| {
        values
            .iter()
            .map(|v| json!(v.to_string()))
            .collect::<Vec<_>>()
    };
    let mut intrinsic =
        json!({ "intrinsicId": "7", "width": "640", "height": "480", "type": "pinhole" });
    for (key, value) in lens.as_object().expect("an object") {
        intrinsic[key] = value.clone();
    }
    // Column by column.
    let rotation = reference.camera_from_world.to_cols_array();
    let transform =
        json!({ "rotation": texts(&rotation), "center": texts(&reference.centre.to_array()) });
    json!({
        "version": version,
        "views": [
            { "viewId": "1", "poseId": "1", "intrinsicId": "7", "path": "/elsewhere/photos/a.jpg", "width": "640", "height": "480" },
            { "viewId": "2", "poseId": "2", "intrinsicId": "7", "path": "/elsewhere/photos/lost.jpg" },
        ],
        "intrinsics": [intrinsic],
        "poses": [{ "poseId": "1", "pose": { "transform": transform, "locked": "0" } }],
    })
}

fn parse(name: &str, value: &Value) -> Result<Manifest, CaptureError> {
    let folder = PathBuf::from("folder");
    Manifest::parse(
        value.to_string().as_bytes(),
        folder.join(name),
        folder.clone(),
    )
}

#[test]
fn sfm_data_states_the_cameras_that_meshroom_means() {
    let reference = reference();
    let distorted = |u: DVec2| {
        let r2 = u.length_squared();
        u * (1.0 + r2 * (-0.1 + r2 * (0.02 + r2 * 0.003)))
    };
    let params = json!(["-0.1", "0.02", "0.003"]);
    // The same lens as three versions state it.
    let newest = json!({
        "focalLength": "30", "sensorWidth": "36", "sensorHeight": "24", "pixelRatio": "1.02",
        "principalPoint": ["3.5", "-2.25"], "distortionType": "radialk3", "distortionParams": params,
    });
    let middle = json!({
        "focalLength": 30, "sensorWidth": 36, "pixelRatio": 1.0 / 1.02, "type": "radial3",
        "principalPoint": [3.5, -2.25], "distortionParams": params,
    });
    let fx = 30.0 / 36.0 * 640.0;
    let oldest = json!({
        "pxFocalLength": fx.to_string(), "type": "radial3",
        "principalPoint": ["323.5", "237.75"], "distortionParams": params,
    });
    for (version, lens, ratio) in [
        (["1", "2", "11"], newest, 1.02),
        (["1", "2", "3"], middle, 1.02),
        (["1", "0", "0"], oldest, 1.0),
    ] {
        let value = sfm_data(&reference, version, &lens);
        let manifest = parse("cameras.sfm", &value).expect("SfMData");
        assert_eq!(
            manifest.frames.len(),
            1,
            "views without a pose are left out"
        );
        let frame = &manifest.frames[0];
        assert_eq!(frame.name, "images/a.jpg");
        let camera = frame.lens.camera((640, 480), frame.world_from_camera);
        for point in reference.points() {
            let u = distorted(reference.see(point));
            let expected = DVec2::new(u.x * fx + 323.5, u.y * fx * ratio + 237.75);
            let found = camera.project(point).expect("in front");
            assert!(
                (found - expected).length() < 1e-6,
                "{version:?}: {found} {expected}"
            );
        }
    }
}

#[test]
fn sfm_data_that_is_not_enough_is_refused_by_name() {
    let pinhole =
        || json!({ "focalLength": "30", "principalPoint": ["0", "0"], "distortionType": "none" });
    let with = |change: &dyn Fn(&mut Value)| {
        let mut value = sfm_data(&reference(), ["1", "2", "11"], &pinhole());
        change(&mut value);
        parse("a.sfm", &value).expect_err("refused").to_string()
    };
    for (message, part) in [
        (with(&|v| v["poses"] = json!([])), "views have no pose"),
        (
            with(&|v| v["intrinsics"] = json!([])),
            "views[0] has no intrinsics",
        ),
        (
            with(&|v| v["intrinsics"][0]["distortionType"] = json!("3deanamorphic4")),
            "is 3deanamorphic4",
        ),
        (
            with(&|v| v["intrinsics"][0]["type"] = json!("equidistant")),
            "undistort the images",
        ),
        (
            with(&|v| v["intrinsics"][0]["focalLength"] = json!("x")),
            "intrinsics[0].focalLength is not a number",
        ),
        (
            with(&|v| v["poses"][0]["pose"]["transform"]["center"] = json!([1, 2])),
            "is not a list of 3 numbers",
        ),
    ] {
        assert!(message.contains(part), "{message} lacks {part}");
    }
}

#[test]
fn a_table_of_reality_capture_states_its_cameras() {
    let folder = tempfile::tempdir().expect("folder");
    image::RgbImage::new(60, 40)
        .save(folder.path().join("a b.png"))
        .expect("image");
    let table = "\u{feff}#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\r\n\
        a b.png,0.5,-2,1.5,30,60,10,28,0.01,-0.02,0.05,0,0,0,0.001,0\r\n";
    fs::write(folder.path().join("cameras.csv"), table).expect("written");
    let cameras = read_cameras(folder.path(), DVec3::ZERO).expect("a table");
    let camera = camera(&cameras, "a b.png");
    assert_eq!((camera.width, camera.height), (60, 40));
    // From straight down, up by the pitch, about the vertical by the heading, clockwise: 30° is to the right of north.
    let (heading, pitch) = (30_f64.to_radians(), 60_f64.to_radians());
    let forward = DVec3::new(
        pitch.sin() * heading.sin(),
        pitch.sin() * heading.cos(),
        -pitch.cos(),
    );
    let expected = DMat3::from_rotation_z(-heading)
        * DMat3::from_rotation_x(pitch)
        * DMat3::from_rotation_y(10_f64.to_radians());
    assert!((camera.forward() - expected * DVec3::NEG_Z).length() < 1e-9);
    let level = DMat3::from_rotation_z(-heading) * DMat3::from_rotation_x(pitch) * DVec3::NEG_Z;
    assert!((level - forward).length() < 1e-9, "{level} {forward}");
    let point = camera.position() + expected * DVec3::new(0.2, 0.1, -2.0);
    let (u, f) = (DVec2::new(0.1, -0.05), 28.0 * 60.0 / 36.0);
    let r2 = u.length_squared();
    let (x, y) = (u.x, u.y);
    let distorted = u * (1.0 + 0.05 * r2) + DVec2::new(0.002 * x * y, 0.001 * (r2 + 2.0 * y * y));
    let pixel = distorted * f + DVec2::new(30.0 + 0.6, 20.0 - 1.2);
    let found = camera.project(point).expect("in front");
    assert!((found - pixel).length() < 1e-9, "{found} {pixel}");
    let refuse = |table: &str| {
        fs::write(folder.path().join("cameras.csv"), table).expect("written");
        read_cameras(&folder.path().join("cameras.csv"), DVec3::ZERO)
            .expect_err("refused")
            .to_string()
    };
    assert!(refuse("name,x,y\n").contains("line 1 lacks some of the columns"));
    let bad = table.replace(",28,", ",wide,");
    assert!(
        refuse(&bad).contains("line 2 has 'wide' as f"),
        "{}",
        refuse(&bad)
    );
    assert!(refuse(&table.replace("a b", "c")).contains("no such image"));
}

/// A triangle strip of two triangles in a node below another, and a mirrored copy without indices, as glTF with its buffer
/// in the file.
fn gltf_document() -> (Value, Vec<u8>) {
    let positions: [[f32; 3]; 4] = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [1.0, 1.0, 0.0],
    ];
    let uvs: [[u8; 4]; 4] = [
        [0, 0, 0, 0],
        [255, 0, 0, 0],
        [0, 255, 0, 0],
        [255, 255, 0, 0],
    ];
    let mut buffer: Vec<u8> = positions
        .as_flattened()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    buffer.extend(uvs.as_flattened());
    buffer.extend([0_u16, 1, 2, 3].iter().flat_map(|v| v.to_le_bytes()));
    let document = json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0, 2] }],
        "nodes": [
            { "translation": [0, 0, 1], "children": [1] },
            { "mesh": 0, "rotation": [0, 0, 0.5_f64.sqrt(), 0.5_f64.sqrt()], "scale": [2, 2, 2] },
            { "mesh": 1, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1] },
        ],
        "meshes": [
            { "primitives": [{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 2, "mode": 5 }] },
            { "primitives": [{ "attributes": { "POSITION": 3, "TEXCOORD_0": 1 } }, { "attributes": { "POSITION": 0 }, "mode": 0 }] },
        ],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3" },
            { "bufferView": 1, "componentType": 5121, "normalized": true, "count": 4, "type": "VEC2" },
            { "bufferView": 2, "componentType": 5123, "count": 4, "type": "SCALAR" },
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 16, "byteStride": 4 },
            { "buffer": 0, "byteOffset": 64, "byteLength": 8 },
        ],
        "buffers": [{ "byteLength": buffer.len() }],
    });
    (document, buffer)
}

fn glb((document, buffer): &(Value, Vec<u8>)) -> Vec<u8> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let word = |v: usize| (v as u32).to_le_bytes();
    let total = 12 + 8 + json.len() + 8 + buffer.len();
    [
        b"glTF".as_slice(),
        &word(2),
        &word(total),
        &word(json.len()),
        b"JSON",
        &json,
        &word(buffer.len()),
        b"BIN\0",
        buffer,
    ]
    .concat()
}

#[test]
fn gltf_scenes_become_one_mesh() {
    let source = gltf_document();
    let folder = tempfile::tempdir().expect("folder");
    fs::write(folder.path().join("a.glb"), glb(&source)).expect("written");
    let (mut document, buffer) = source.clone();
    document["buffers"][0]["uri"] = json!("the%20buffer.bin");
    fs::write(folder.path().join("b.gltf"), document.to_string()).expect("written");
    fs::write(folder.path().join("the buffer.bin"), buffer).expect("written");
    for name in ["a.glb", "b.gltf"] {
        let (mesh, _) = mesh_file::read(&folder.path().join(name), None).expect(name);
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (7, 3));
        // Turned by a quarter about z, doubled and lifted; all face +z.
        for triangle in 0..3 {
            assert!(
                mesh.face_normal(triangle).z > 0.999,
                "{name}: triangle {triangle}"
            );
        }
        let (low, high) = mesh.bounds();
        assert!(
            (low - glam::Vec3::new(-2.0, 0.0, 0.0)).length() < 1e-6,
            "{low}"
        );
        assert!(
            (high - glam::Vec3::new(5.0, 2.0, 1.0)).length() < 1e-6,
            "{high}"
        );
        // v runs upwards here.
        let corner = mesh
            .positions
            .iter()
            .position(|p| p.length() < 1.1 && p.z == 1.0);
        assert_eq!(
            mesh.uvs[corner.expect("the origin")],
            glam::Vec2::new(0.0, 1.0)
        );
    }
}

#[test]
fn bad_gltf_files_are_refused_by_place() {
    let with = |change: &dyn Fn(&mut Value)| {
        let mut source = gltf_document();
        change(&mut source.0);
        gltf::parse(Path::new("a.glb"), &glb(&source))
            .expect_err("refused")
            .to_string()
    };
    for (message, part) in [
        (
            with(&|d| d["extensionsRequired"] = json!(["KHR_draco_mesh_compression"])),
            "compressed (Draco)",
        ),
        (
            with(&|d| d["bufferViews"][0]["extensions"] = json!({ "EXT_meshopt_compression": {} })),
            "compressed (meshopt)",
        ),
        (
            with(&|d| d["accessors"][0]["count"] = json!(4_000_000_000_u64)),
            "meshes[0].primitives[0]: accessor 0 reaches beyond",
        ),
        (
            with(&|d| d["accessors"][2]["count"] = json!(5)),
            "accessor 2 reaches beyond",
        ),
        (
            with(&|d| d["accessors"][0]["count"] = json!(3)),
            "an index is out of range",
        ),
        (
            with(&|d| d["nodes"][1]["children"] = json!([0])),
            "nodes[0]: it has two parents",
        ),
        (
            with(&|d| d["nodes"][0]["children"] = json!([9])),
            "nodes[9]: there is no such node",
        ),
        (
            with(&|d| d["accessors"][0]["sparse"] = json!({})),
            "is sparse",
        ),
        (
            with(&|d| d["scenes"][0]["nodes"] = json!([])),
            "no triangles",
        ),
        (
            with(&|d| d["buffers"][0]["uri"] = json!("nowhere.bin")),
            "buffers[0]: nowhere.bin can't be read",
        ),
        // What is no file may never end.
        (
            with(&|d| d["buffers"][0]["uri"] = json!("/dev/null")),
            "buffers[0]: /dev/null is not in the folder of the mesh",
        ),
    ] {
        assert!(message.contains(part), "{message} lacks {part}");
    }
}

#[test]
fn damaged_files_of_other_programs_never_panic() {
    let mut random = Random(21);
    let source = gltf_document();
    let whole = glb(&source);
    let text = source.0.to_string();
    for i in 0..3000 {
        let bytes = if i % 2 == 0 {
            damaged(&whole, &mut random)
        } else {
            // Damage to the JSON alone leaves a file that is read to its end.
            let json = String::from_utf8_lossy(&damaged(text.as_bytes(), &mut random)).into_owned();
            match serde_json::from_str(&json) {
                Ok(value) => glb(&(value, source.1.clone())),
                Err(_) => json.into_bytes(),
            }
        };
        let path = Path::new("a.glb");
        if let Ok((mesh, _)) =
            gltf::parse(path, &bytes).and_then(|raw| mesh_file::finish(path, raw))
        {
            let in_range = |&v: &u32| (v as usize) < mesh.positions.len();
            assert!(mesh.triangles.iter().flatten().all(in_range));
        }
    }
    let lens = json!({ "focalLength": "30", "principalPoint": ["0", "0"], "distortionType": "brown", "distortionParams": ["0.1"] });
    let sfm = sfm_data(&reference(), ["1", "2", "11"], &lens).to_string();
    let folder = tempfile::tempdir().expect("folder");
    image::RgbImage::new(4, 4)
        .save(folder.path().join("a.png"))
        .expect("image");
    let table = b"#name,x,y,alt,heading,pitch,roll,f,px\na.png,0,0,1,10,20,30,35,0\n";
    for _ in 0..1500 {
        let bytes = damaged(sfm.as_bytes(), &mut random);
        let _ = Manifest::parse(&bytes, PathBuf::from("a.sfm"), PathBuf::new());
        let bytes = damaged(table, &mut random);
        let _ = Manifest::parse(
            &bytes,
            folder.path().join("a.csv"),
            folder.path().to_owned(),
        );
    }
    for name in [
        "text/images.txt",
        "text/cameras.txt",
        "binary/images.bin",
        "binary/cameras.bin",
    ] {
        let (kind, file) = name.split_once('/').expect("a folder");
        let target = folder.path().join(kind);
        fs::create_dir_all(&target).expect("folder");
        for entry in fs::read_dir(colmap(kind)).expect("test data") {
            let entry = entry.expect("entry");
            fs::copy(entry.path(), target.join(entry.file_name())).expect("copy");
        }
        let original = fs::read(colmap(name)).expect("test data");
        for _ in 0..300 {
            fs::write(target.join(file), damaged(&original, &mut random)).expect("written");
            let _ = read_cameras(&target, DVec3::ZERO);
        }
    }
}
