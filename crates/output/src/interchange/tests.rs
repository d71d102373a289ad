//! What would go wrong for a user: a mirrored or turned map, a lost lamp, a wrong scale, a file that names none.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DAffine3, DQuat, DVec2, DVec3, Mat4, Quat, Vec2, Vec3};

use super::*;
use rekindle_capture::{Camera, Distortion, read_cameras};
use rekindle_relight::{Edit, LampNodes, LatLong, LightNode, Lighting, apply};
use rekindle_scene::hemisphere::{Picture, direction_from_lat_long};
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};
use rekindle_scene::surface::GlossTexture;
use rekindle_solution::Solution;
use rekindle_studio::fixtures;

fn camera() -> Camera {
    let turn = DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(-0.3);
    Camera {
        width: 80,
        height: 60,
        focal: DVec2::new(90.0, 92.0),
        centre: DVec2::new(43.0, 28.5),
        distortion: Distortion::default(),
        world_from_camera: DAffine3::from_rotation_translation(turn, turn * (4.0 * DVec3::Z)),
    }
}

fn asset_of(solution: &Solution, lighting: &Lighting) -> Asset {
    Asset::new(&source(solution, lighting, &cameras()))
}

fn cameras() -> [(String, Camera); 1] {
    [("images/view_000.exr".to_owned(), camera())]
}

fn source<'a>(
    solution: &'a Solution,
    lighting: &'a Lighting,
    cameras: &'a [(String, Camera)],
) -> Source<'a> {
    Source {
        solution,
        lighting,
        names: &[],
        cameras,
        setups: &[],
        anchor: Anchor::F0(USUAL_F0),
    }
}

fn asset() -> Asset {
    let solution = fixtures::solution();
    asset_of(&solution, &solution.lighting())
}

fn layout(orientation: Orientation) -> MapLayout {
    MapLayout {
        width: 128,
        orientation,
        yaw_deg: 0.0,
    }
}

/// Σ radiance × solid angle over a lat-long picture.
fn flux(picture: &Picture) -> Vec3 {
    let edge = |row: u32| (std::f64::consts::PI * f64::from(row) / f64::from(picture.height)).cos();
    let mut sum = glam::DVec3::ZERO;
    for (i, &pixel) in picture.radiance.iter().enumerate() {
        let row = i as u32 / picture.width;
        let angle = (edge(row) - edge(row + 1)) * std::f64::consts::TAU / f64::from(picture.width);
        sum += Vec3::from(pixel).as_dvec3() * angle;
    }
    sum.as_vec3()
}

/// u of the brightest pixel.
fn brightest_u(picture: &Picture) -> f32 {
    let value = |i: usize| picture.radiance[i].iter().sum::<f32>();
    let at = (0..picture.radiance.len()).max_by(|&a, &b| value(a).total_cmp(&value(b)));
    (at.unwrap() as u32 % picture.width) as f32 / picture.width as f32
}

/// Distance on a circle of circumference 1.
fn apart(a: f32, b: f32) -> f32 {
    let d = (a - b).rem_euclid(1.0);
    d.min(1.0 - d)
}

#[test]
fn maps_are_turned_as_each_program_expects() {
    let solution = fixtures::solution();
    for (orientation, u_of_x, u_of_z) in [
        (Orientation::Blender, 0.5, 0.75),
        (Orientation::Three, 0.5, 0.75),
        (Orientation::Openexr, 0.25, 0.5),
        (Orientation::Usd, 0.25, 0.5),
        (Orientation::Mitsuba, 0.25, 0.5),
        (Orientation::Nvdiffrec, 0.75, 0.0),
    ] {
        for (direction, expected) in [(Vec3::X, u_of_x), (Vec3::Z, u_of_z)] {
            let mut lighting = solution.lighting();
            lighting.ambient = Vec3::ZERO;
            lighting.remainder.clear();
            lighting.lamps = vec![LampNodes::disc(direction, Vec3::ONE, 0.03, None)];
            let asset = asset_of(&solution, &lighting);
            let u = brightest_u(&layout(orientation).map(&asset, Part::Whole));
            assert!(
                apart(u, expected) < 0.02,
                "{orientation:?}, {direction}: u {u}"
            );
            let yawed = MapLayout {
                yaw_deg: 30.0,
                ..layout(orientation)
            };
            let u = brightest_u(&yawed.map(&asset, Part::Whole));
            let turned = expected + 30.0 / 360.0;
            assert!(apart(u, turned) < 0.02, "{orientation:?} by 30°: u {u}");
        }
    }
}

#[test]
fn the_calibration_map_marks_the_axes() {
    let picture = layout(Orientation::Blender).calibration();
    let at = |u: f32, v: f32| {
        let (x, y) = ((u * 128.0) as usize, (v * 64.0) as usize);
        picture.radiance[y * 128 + x]
    };
    let (red, blue, green) = (at(0.5, 0.5), at(0.75, 0.5), at(0.3, 0.0));
    assert!(red[0] > 5.0 * red[1], "{red:?}");
    assert!(blue[2] > 5.0 * blue[0], "{blue:?}");
    assert!(green[1] > 5.0 * green[0], "{green:?}");
}

#[test]
fn no_light_is_lost_on_the_way_into_a_map() {
    let solution = fixtures::solution();
    let original = solution.lighting();
    let edits = [
        Edit::Mute {
            near: original.lamps[1].direction,
        },
        Edit::Gain {
            near: original.lamps[2].direction,
            rgb: Vec3::new(2.0, 3.0, 4.0),
        },
        // Smaller than any texel.
        Edit::Add {
            direction: Vec3::new(0.0, -0.6, 0.8),
            flux: Vec3::new(5.0, 4.0, 3.0),
            angular_radius: 1e-4,
        },
    ];
    let lighting = apply(&edits, &original).unwrap();
    let asset = asset_of(&solution, &lighting);
    let stray: Vec3 = lighting.remainder.iter().map(LightNode::flux).sum();
    let lamps: Vec3 = lighting.lamps.iter().map(LampNodes::flux).sum();
    let everywhere = 4.0 * std::f32::consts::PI * lighting.ambient;
    let expected = (lamps + stray + everywhere) / asset.material.specular_scale;
    for width in [32, 128, 1024] {
        let layout = MapLayout {
            width,
            ..layout(Orientation::Usd)
        };
        let whole = flux(&layout.map(&asset, Part::Whole));
        assert!(
            (whole / expected - 1.0).abs().max_element() < 1e-3,
            "{whole}, not {expected}"
        );
        // The muted lamp is gone from the parts too.
        assert_eq!(asset.lighting.lamps.len(), 3);
        let parts: Vec3 = (0..3)
            .map(Part::Lamp)
            .chain([Part::Rest])
            .map(|part| flux(&layout.map(&asset, part)))
            .sum();
        assert!(
            (parts / expected - 1.0).abs().max_element() < 1e-3,
            "{parts}"
        );
    }
}

#[test]
fn an_environment_is_exported_as_the_picture_that_it_is_of() {
    let solution = fixtures::solution();
    let sun = Vec3::new(0.48, 0.6, -0.64);
    let even = |d: Vec3| Vec3::new(0.7, 0.9, 1.1) * (1.5 + d.x + 0.4 * d.z);
    let radiance = |d: Vec3| even(d) + Vec3::splat(if d.dot(sun) > 0.998 { 80.0 } else { 0.0 });
    let picture = LatLong::of(128, radiance);
    let lighting = Lighting {
        environment: picture.environment(Quat::IDENTITY, Vec3::ONE),
        ..solution.lighting().dark()
    };
    let asset = asset_of(&solution, &lighting);
    // The scale is that of the material, the turn that from the solution's world to +Y up.
    let scale = asset.material.specular_scale;
    let map = layout(Orientation::Blender).map(&asset, Part::Rest);
    let total = flux(&map) * scale / picture.flux();
    assert!((total - 1.0).abs().max_element() < 2e-3, "{total}");
    for (i, &shown) in map.radiance.iter().enumerate() {
        let (column, row) = (i as u32 % map.width, i as u32 / map.width);
        let uv = Vec2::new(column as f32 + 0.5, row as f32 + 0.5)
            / Vec2::new(map.width as f32, map.height as f32);
        let direction = asset.turn.inverse() * direction_from_lat_long(uv);
        if direction.dot(sun) > 0.99 {
            continue;
        }
        let off = Vec3::from(shown) * scale / even(direction) - 1.0;
        assert!(off.abs().max_element() < 0.03, "{off} towards {direction}");
    }
}

#[test]
fn light_and_colour_change_scale_against_each_other() {
    let solution = fixtures::solution();
    let lighting = solution.lighting();
    for anchor in [Anchor::F0(0.04), Anchor::F0(0.02), Anchor::WhiteAlbedo(0.1)] {
        let asset = Asset::new(&Source {
            anchor,
            ..source(&solution, &lighting, &[])
        });
        let material = &asset.material;
        // Under the same lamp the diffuse radiance is the solution's: colour (1 − F₀)/π × light.
        let light = asset.lighting.lamps[0].flux().x / lighting.lamps[0].flux().x;
        let texel = solution.albedo.iter().position(|a| a[0] > 0.0).unwrap();
        let colour = asset.base_colour[texel][0] / solution.albedo[texel][0];
        let product = light * colour * (1.0 - material.f0) / std::f32::consts::PI;
        assert!((product - 1.0).abs() < 1e-4, "{anchor:?}: {product}");
        // And so is the peak of the lobe: D(0) F₀/4 × light.
        let peak = material.f0 / (4.0 * std::f32::consts::PI * material.alpha().powi(2));
        assert!(
            (light * peak - 1.0).abs() < 1e-4,
            "{anchor:?}: {}",
            light * peak
        );
    }
    let white = Asset::new(&Source {
        anchor: Anchor::WhiteAlbedo(0.1),
        ..source(&solution, &lighting, &[])
    });
    let brightest = solution.brightest(&white.base_colour) * (1.0 - white.material.f0);
    assert!((brightest - 0.1).abs() < 1e-3, "{brightest}");
}

#[test]
fn an_object_that_stands_along_z_is_turned_with_its_light_and_cameras() {
    let upright = fixtures::solution();
    let straight = asset();
    // The same world, laid down: +Y becomes +Z.
    let lay = Quat::from_rotation_arc(Vec3::Y, Vec3::Z);
    let mut laid = Arc::into_inner(fixtures::solution()).unwrap();
    for v in laid.mesh.positions.iter_mut().chain(&mut laid.mesh.normals) {
        *v = lay * *v;
    }
    let mut lighting = upright.lighting();
    lighting.up = Vec3::new(0.05, -0.03, 0.99).normalize_or_zero();
    let lamps = lighting.lamps.iter_mut();
    for lamp in lamps {
        lamp.direction = lay * lamp.direction;
        for node in &mut lamp.nodes {
            node.direction = lay * node.direction;
        }
    }
    let mut seen = camera();
    let lie = DAffine3::from_quat(lay.as_dquat());
    seen.world_from_camera = lie * seen.world_from_camera;
    let cameras = [("a".to_owned(), seen)];
    let turned = Asset::new(&source(&laid, &lighting, &cameras));
    for (a, b) in turned.mesh.positions.iter().zip(&straight.mesh.positions) {
        assert!(a.distance(*b) < 1e-5, "{a}, not {b}");
    }
    for (a, b) in turned.lighting.lamps.iter().zip(&straight.lighting.lamps) {
        assert!(a.direction.distance(b.direction) < 1e-5);
    }
    let point = DVec3::new(0.3, 0.6, -0.2);
    let (a, b) = (turned.cameras[0].1.project(point), camera().project(point));
    assert!(a.unwrap().distance(b.unwrap()) < 1e-4, "{a:?}, not {b:?}");
}

#[test]
fn lists_name_every_lamp() {
    let asset = asset();
    let csv = light_list::csv(&asset);
    assert_eq!(csv.lines().count(), 4);
    let second: Vec<f32> = csv
        .lines()
        .nth(2)
        .and_then(|line| line.strip_prefix("\"Light 2\","))
        .unwrap()
        .split(',')
        .map(|v| v.parse().unwrap())
        .collect();
    let lamp = &asset.lighting.lamps[1];
    assert!(Vec3::from_slice(&second).distance(lamp.direction) < 1e-5);
    let flux = lamp.flux();
    // Tilted nodes light a facing surface by no more than their cosine less.
    assert!(
        (Vec3::from_slice(&second[3..]) / flux - 1.0)
            .abs()
            .max_element()
            < 0.01
    );
    let json = light_list::json(&asset);
    assert_eq!(json["lights"].as_array().unwrap().len(), 3);
}

#[test]
fn cameras_come_back_from_their_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.json");
    let cameras = [("a/b.exr".to_owned(), camera())];
    let text = rekindle_capture::transforms(&cameras, DVec3::ZERO).to_string();
    fs::write(&path, text).unwrap();
    let read = read_cameras(&path, DVec3::ZERO).unwrap();
    assert_eq!(read[0].0, "a/b.exr");
    let point = DVec3::new(0.2, -0.4, 0.1);
    let (a, b) = (
        read[0].1.project(point).unwrap(),
        camera().project(point).unwrap(),
    );
    assert!(a.distance(b) < 1e-9);
}

#[test]
fn a_glb_reads_back_as_the_object_in_its_light() {
    let asset = asset();
    let png = textures::base_colour_png(&asset).unwrap();
    let bytes = glb::glb(&asset, &png, &[]);
    let file = gltf::Gltf::from_slice(&bytes).unwrap();
    let blob = file.blob.clone().unwrap();
    let primitive = file.meshes().next().unwrap().primitives().next().unwrap();
    let reader = primitive.reader(|_| Some(blob.as_slice()));
    let positions: Vec<Vec3> = reader.read_positions().unwrap().map(Vec3::from).collect();
    let uvs: Vec<[f32; 2]> = reader.read_tex_coords(0).unwrap().into_f32().collect();
    let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
    assert_eq!(indices.len(), 3 * asset.mesh.triangles.len());
    // In the middle of a triangle, the picture has the colour of the texture.
    let picture = image::load_from_memory(&png).unwrap().to_rgb8();
    for triangle in [0, asset.mesh.triangles.len() / 2] {
        let corners: Vec<usize> = (0..3).map(|k| indices[3 * triangle + k] as usize).collect();
        for (k, &corner) in corners.iter().enumerate() {
            let own = asset.mesh.positions[asset.mesh.triangles[triangle][k] as usize];
            assert_eq!(positions[corner], own);
        }
        let middle = |axis: usize| corners.iter().map(|&c| uvs[c][axis]).sum::<f32>() / 3.0;
        let x = (middle(0) * picture.width() as f32) as u32;
        let y = (middle(1) * picture.height() as f32) as u32;
        let shown = picture.get_pixel(x, y).0;
        let texel = asset.base_colour[(y * asset.texture_width + x) as usize];
        assert_ne!(texel, [0.0; 3], "outside the charts");
        for (s, t) in shown.iter().zip(texel) {
            let decoded = rekindle_scene::hemisphere::srgb(t) * 255.0;
            assert!(
                (f32::from(*s) - decoded).abs() < 1.0,
                "{shown:?}, {texel:?}"
            );
        }
    }
    let material = primitive.material();
    let pbr = material.pbr_metallic_roughness();
    assert_eq!(pbr.metallic_factor(), 0.0);
    assert!((pbr.roughness_factor().powi(2) / asset.material.alpha() - 1.0).abs() < 1e-5);
    let index = material.ior().unwrap();
    assert!((reflectance(index) / asset.material.f0 - 1.0).abs() < 1e-4);
    let lights: Vec<_> = file.lights().unwrap().collect();
    assert_eq!(lights.len(), 3);
    let placed = file
        .nodes()
        .filter_map(|n| n.light().map(|l| (n.transform(), l)));
    for ((transform, light), lamp) in placed.zip(&asset.lighting.lamps) {
        let shines = Mat4::from_cols_array_2d(&transform.matrix()).transform_vector3(-Vec3::Z);
        assert!(
            shines.distance(-lamp.direction) < 1e-5,
            "shines along {shines}"
        );
        let energy = Vec3::from(light.color()) * light.intensity();
        assert!(
            (energy / lamp.flux() - 1.0).abs().max_element() < 0.01,
            "{energy}"
        );
    }
    let seen = file.cameras().next().unwrap();
    let gltf::camera::Projection::Perspective(lens) = seen.projection() else {
        panic!("not a perspective camera");
    };
    assert!((lens.yfov() - 2.0 * (30.0_f32 / 92.0).atan()).abs() < 1e-5);
}

#[test]
fn parts_of_metal_keep_their_colour_in_other_programs() {
    let mut solution = Arc::into_inner(fixtures::solution()).unwrap();
    solution.brdf = Some(Brdf::new(SpecularModel::Ggx, 0.1));
    let metal = Gloss::new(0.5, 10.0).reflecting(Vec3::new(15.0, 10.0, 5.0));
    let mut texels = vec![Gloss::MAIN; solution.atlas.len()];
    texels[..solution.atlas.len() / 2].fill(metal);
    solution.gloss = Some(GlossTexture::new(vec![Gloss::MAIN, metal], texels));
    let (lighting, cameras) = (solution.lighting(), cameras());
    let asset = asset_of(&solution, &lighting);
    let (first, last) = (
        asset.material_at(0),
        asset.material_at(solution.atlas.len() - 1),
    );
    assert!((first.f0 * first.colour - Vec3::new(0.6, 0.4, 0.2)).length() < 1e-5);
    assert_eq!((last.f0, last.colour), (USUAL_F0, Vec3::ONE));
    // Of plastic 0.04 of 0.6, and all channels of it.
    let picture = |bytes: io::Result<Vec<u8>>| image::load_from_memory(&bytes.unwrap()).unwrap();
    let ends = |picture: &image::DynamicImage| {
        let rgb = picture.to_rgb8();
        let last = rgb.get_pixel(rgb.width() - 1, rgb.height() - 1).0;
        (rgb.get_pixel(0, 0).0, last)
    };
    let specular = picture(textures::specular_png(&asset));
    assert_eq!(ends(&specular), ([255, 170, 85], [17; 3]));
    let colour = picture(textures::specular_colour_png(&asset));
    assert_eq!(ends(&colour), ([255, 213, 156], [255; 3]));
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let forms = [Form::Gltf, Form::Blender, Form::Mitsuba, Form::Usd];
    let source = source(&solution, &lighting, &cameras);
    export(&source, &job(&out, forms), &|| false, &mut |_, _| ()).unwrap();
    let text = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    let file = gltf::Gltf::open(out.join("object.glb")).unwrap();
    let specular = file.materials().next().unwrap().specular().unwrap();
    assert_eq!(
        specular.specular_color_texture().unwrap().texture().index(),
        2
    );
    assert_eq!(file.images().count(), 3);
    let scene: serde_json::Value = serde_json::from_str(&text("scene.json")).unwrap();
    let named = scene["material"]["gloss"]["colour"].as_str().unwrap();
    assert!(out.join(named).is_file());
    let red = text("mitsuba.xml").matches("specular_reflectance").count();
    assert_eq!(red, 1, "only the metal has a colour");
}

#[test]
fn a_folder_has_all_files_that_its_files_name() {
    let folder = tempfile::tempdir().unwrap();
    let (solution, cameras) = (fixtures::solution(), cameras());
    let lighting = solution.lighting();
    let source = source(&solution, &lighting, &cameras);
    for form in Form::USUAL.into_iter().chain([Form::Layers]) {
        let path = folder.path().join(format!("{form:?}"));
        let job = job(&path, [form]);
        let exported = export(&source, &job, &|| false, &mut |_, _| ()).unwrap();
        let written = exported.files;
        assert_eq!(written.len(), fs::read_dir(&path).unwrap().count());
        assert!(written.iter().all(|p| p.is_file()), "{written:?}");
        let names: Vec<String> = written
            .iter()
            .map(|p| p.file_name().unwrap().to_string_lossy().into_owned())
            .collect();
        for text in written.iter().filter(|p| {
            let kind = p.extension().unwrap().to_string_lossy();
            ["xml", "usda", "obj", "mtl"].contains(&&*kind) || p.ends_with("scene.json")
        }) {
            let text = fs::read_to_string(text).unwrap();
            let words = text.split(|c: char| c.is_whitespace() || "\"@".contains(c));
            for word in words.filter(|w| {
                [".exr", ".png", ".obj", ".mtl"]
                    .iter()
                    .any(|e| w.ends_with(e))
            }) {
                // The cameras' names are those of photographs.
                let photograph = word.contains('/');
                assert!(
                    photograph || names.iter().any(|n| n == word),
                    "{form:?}: {word}"
                );
            }
        }
    }
}

fn job(path: &Path, forms: impl IntoIterator<Item = Form>) -> Job {
    Job {
        forms: forms.into_iter().collect::<BTreeSet<_>>(),
        layout: layout(Orientation::Blender),
        per_lamp: true,
        calibration: true,
        page: PAGE.to_owned(),
        folder: path.to_owned(),
    }
}

#[test]
fn a_stopped_export_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new");
    let asked = AtomicBool::new(false);
    let stop = || asked.load(Ordering::Relaxed);
    let mut after_three = |_: &str, part: f32| {
        if part > 0.1 {
            asked.store(true, Ordering::Relaxed);
        }
    };
    let (solution, cameras) = (fixtures::solution(), cameras());
    let lighting = solution.lighting();
    let source = source(&solution, &lighting, &cameras);
    let result = export(&source, &job(&path, Form::USUAL), &stop, &mut after_three);
    assert!(matches!(result, Err(JobError::Stopped)));
    assert!(!path.exists());
    let odd = Job {
        layout: MapLayout {
            width: 77,
            ..layout(Orientation::Blender)
        },
        ..job(&path, Form::USUAL)
    };
    let refused = export(&source, &odd, &|| false, &mut |_, _| ());
    assert!(refused.unwrap_err().to_string().contains("77 columns"));
}

#[test]
fn materials_come_as_near_as_their_lobes() {
    let solution = fixtures::solution();
    let (lighting, cameras) = (solution.lighting(), cameras());
    let mut asset = Asset::new(&source(&solution, &lighting, &cameras));
    // Other programs let the surface mirror it, which on so dark a one is more than it lights.
    asset.lighting.ambient = Vec3::ZERO;
    let near = fidelity::fidelity(&asset, &|| false).unwrap();
    // The lobe is the same there; its tails are not.
    assert!(near.beckmann_db > near.ggx_db + 3.0, "{near:?}");
    assert!(near.ggx_db > 20.0, "{near:?}");
    assert!(fidelity::fidelity(&asset, &|| true).is_none());
}
