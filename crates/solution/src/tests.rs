//! What is written comes back, and what others wrote stays.

use std::fs;
use std::path::Path;

use glam::{DAffine3, DQuat, DVec2, DVec3, Vec2, Vec3};

use super::folder::{HEMISPHERES, MANIFEST, STRENGTH, read_json, write_json};
use super::*;
use rekindle_base::damage::{Random, damaged};
use rekindle_capture::Distortion;
use rekindle_scene::hemisphere::lat_long;
use rekindle_scene::reflectance::{Gloss, SpecularModel};
use rekindle_scene::shortcuts::LeftOut;

fn camera() -> Camera {
    Camera {
        width: 64,
        height: 48,
        focal: DVec2::new(70.1, 71.3),
        centre: DVec2::new(31.7, 24.9),
        distortion: Distortion {
            k: [0.1, -0.02, 0.003, 0.0],
            p: [1e-3, -2e-3],
            denominator: [0.04, 0.05, 0.06],
            fisheye: false,
        },
        world_from_camera: DAffine3::from_rotation_translation(
            DQuat::from_rotation_x(0.3),
            DVec3::new(1.0, 2.0, 3.0),
        ),
    }
}

pub(super) fn example() -> Solution {
    let grid = HemisphereGrid::new(4, Vec3::Y, Some(3.0), Vec3::new(0.1, 0.2, 0.3));
    let mut radiance = vec![[0.0; 3]; grid.directions.len()];
    radiance[5] = [0.1, 20.0, 1e-7];
    radiance[6] = [0.3, 2.0, 1.0];
    let mesh = Mesh {
        origin: glam::DVec3::ZERO,
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Z],
        normals: vec![Vec3::Y; 3],
        uvs: Vec::new(),
        triangles: vec![[0, 2, 1]],
    };
    let corners = [
        Vec2::new(0.5, 0.5),
        Vec2::new(3.5, 0.5),
        Vec2::new(0.5, 3.5),
    ];
    Solution {
        name: "example".to_owned(),
        method: Method::default(),
        brdf: Some(Brdf::new(SpecularModel::Beckmann, 0.075_123)),
        chosen_because: "it was asked for".to_owned(),
        origin: String::new(),
        corrections: Vec::new(),
        sigma_interval95: Some([0.07, 0.08]),
        known_light: None,
        light_frame: LightFrame::World,
        lamps: vec![SolutionLamp {
            name: "Light 1".to_owned(),
            direction: grid.directions[5],
            flux: Vec3::new(1.0, 2.0, 3.0),
            angular_radius: 0.05,
            nodes: vec![5],
        }],
        grid,
        radiance,
        ambient: Vec3::splat(0.01),
        diagnostics: Diagnostics::default(),
        fit: Fit::default(),
        skipped: Skipped {
            left_out: vec![LeftOut {
                what: "lobes".to_owned(),
                all: 5,
                left_out: 3,
            }],
            stages: vec!["refining".to_owned()],
        },
        timings: Vec::new(),
        convergence: Vec::new(),
        cameras: vec![("images/a.exr".to_owned(), camera())],
        mesh,
        atlas: Atlas::from_corners(4, 4, vec![corners], false),
        diffuse: (0..16).map(|i| [i as f32 * 0.1; 3]).collect(),
        albedo: (0..16).map(|i| [i as f32 * 0.2; 3]).collect(),
        confidence: (0..16).map(|i| i as f32 / 16.0).collect(),
        gloss: None,
        pictures: Vec::new(),
    }
}

#[test]
fn a_solution_comes_back_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution");
    let saved = example();
    saved.save(&path).unwrap();
    // Saving again replaces it.
    saved.save(&path).unwrap();
    let read = Solution::load(&path).unwrap();
    assert_eq!(read.radiance, saved.radiance);
    assert_eq!(read.brdf, saved.brdf);
    assert_eq!(read.diffuse, saved.diffuse);
    assert_eq!(read.albedo, saved.albedo);
    assert_eq!(read.confidence, saved.confidence);
    assert_eq!(read.mesh.positions, saved.mesh.positions);
    assert_eq!(read.lighting(), saved.lighting());
    let (name, seen) = &read.cameras[0];
    assert_eq!(name, "images/a.exr");
    assert_eq!(seen.distortion, camera().distortion);
    let point = DVec3::new(0.9, 1.7, 0.4);
    let (now, then) = (seen.project(point), camera().project(point));
    assert!(now.unwrap().distance(then.unwrap()) < 1e-9, "{now:?}");
    for (a, b) in read.atlas.corner_uvs[0]
        .iter()
        .zip(&saved.atlas.corner_uvs[0])
    {
        assert!(a.distance(*b) < 1e-5, "{a} was {b}");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn light_that_stands_still_with_the_camera_comes_back_and_goes_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution");
    let mut saved = example();
    saved.light_frame = LightFrame::Camera;
    saved.save(&path).unwrap();
    let read = Solution::load(&path).unwrap();
    assert_eq!(read.light_frame, LightFrame::Camera);
    // The first camera sees the light as it is stated; one that went around the object by a quarter has taken it along.
    let mut camera = read.cameras[0].1.clone();
    let lighting = read.lighting();
    let lamp = |camera: &Camera| read.lighting_before(&lighting, camera).lamps[0].direction;
    let before = lighting.lamps[0].direction;
    assert!(lamp(&camera).distance(before) < 1e-5);
    let quarter = DAffine3::from_axis_angle(DVec3::Y, std::f64::consts::FRAC_PI_2);
    camera.world_from_camera = quarter * camera.world_from_camera;
    let taken_along = quarter.transform_vector3(before.as_dvec3()).as_vec3();
    assert!(lamp(&camera).distance(taken_along) < 1e-5);
    // Light that stands still with the object stays.
    assert!(example().lighting_before(&lighting, &camera).as_ref() == &lighting);
}

#[test]
fn light_below_the_horizon_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution");
    let mut saved = example();
    saved.grid = saved.grid.to_whole();
    let lowest = saved.grid.directions.len() - 1;
    assert!(saved.grid.directions[lowest].y < 0.0);
    saved.radiance.resize(lowest + 1, [0.0; 3]);
    saved.radiance[lowest] = [1.0, 2.0, 3.0];
    saved.save(&path).unwrap();
    let read = Solution::load(&path).unwrap();
    assert!(read.grid.whole);
    assert_eq!(read.radiance, saved.radiance);
    assert_eq!(read.lighting(), saved.lighting());
}

#[test]
fn unreadable_solutions_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution");
    let message = |path: &Path| Solution::load(path).err().unwrap().to_string();
    assert!(message(&path).contains("no solution here"));
    example().save(&path).unwrap();
    let manifest = path.join("solution.json");
    let text = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, text.replace("\"version\": 1", "\"version\": 9")).unwrap();
    assert!(message(&path).contains("newer"));
    fs::write(&manifest, &text).unwrap();
    fs::remove_file(path.join("albedo.exr")).unwrap();
    assert!(message(&path).contains("albedo.exr"));
}

#[test]
fn damaged_solutions_are_refused_or_read() {
    let mut random = Random(11);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution");
    example().save(&path).unwrap();
    let files = [
        ("solution.json", 400),
        ("nodes.json", 300),
        ("mesh.ply", 300),
        ("albedo.exr", 150),
        ("confidence.exr", 150),
    ];
    for (name, rounds) in files {
        let file = path.join(name);
        let whole = fs::read(&file).unwrap();
        for _ in 0..rounds {
            fs::write(&file, damaged(&whole, &mut random)).unwrap();
            match Solution::load(&path) {
                Ok(solution) => {
                    assert_eq!(solution.radiance.len(), solution.grid.directions.len());
                    let count = solution.atlas.len();
                    let textures = [solution.diffuse.len(), solution.confidence.len()];
                    assert_eq!(textures, [count; 2], "one value per texel");
                    let _ = (solution.lighting(), solution.summary());
                }
                Err(error) => assert!(error.to_string().contains("solution"), "{error}"),
            }
        }
        fs::write(&file, whole).unwrap();
    }
    assert!(Solution::load(&path).is_ok());
}

#[test]
fn a_solution_of_absurd_data_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution");
    let mut solution = example();
    solution.fit.residual_rms = f64::INFINITY;
    solution.fit.psnr_db_per_view = vec![f32::NAN, 40.0];
    solution.save(&path).unwrap();
    let read = Solution::load(&path).unwrap();
    assert_eq!(read.fit.psnr_db_per_view[1], 40.0);
}

#[test]
fn a_folder_of_something_else_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("thesis.tex"), "x").unwrap();
    let error = example().save(folder.path()).unwrap_err().to_string();
    assert!(error.contains("not a solution"), "{error}");
    // Nor with a solution.json of something else.
    fs::write(folder.path().join(MANIFEST), "{\"format\": \"chemistry\"}").unwrap();
    let error = example().save(folder.path()).unwrap_err().to_string();
    assert!(error.contains("not a solution"), "{error}");
    assert!(folder.path().join("thesis.tex").exists());
}

fn pictured() -> Solution {
    let picture = |name: &str| HemispherePicture {
        name: name.to_owned(),
        picture: lat_long(&example().grid, &example().radiance, 4),
    };
    Solution {
        pictures: vec![picture("initial"), picture("partial_000")],
        ..example()
    }
}

#[test]
fn parts_of_other_gloss_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution");
    let mut solution = example();
    let white = |k: usize| Gloss::new(0.5 + k as f32 / 7.0, [1.0, 0.0, 1.25][k % 3]);
    let metal = |k: usize| match k % 3 {
        2 => white(k).reflecting(Vec3::new(14.0, 9.0, 4.0)),
        _ => white(k),
    };
    let all: [(&dyn Fn(usize) -> Gloss, u32); 2] = [(&white, 2), (&metal, 3)];
    for (gloss, version) in all {
        let texels = (0..solution.atlas.len()).map(gloss).collect();
        let parts = (0..3).map(gloss).collect();
        solution.gloss = Some(GlossTexture::new(parts, texels));
        solution.save(&path).unwrap();
        let text = fs::read_to_string(path.join(MANIFEST)).unwrap();
        assert!(text.contains(&format!("\"version\": {version},")), "{text}");
        let found = Solution::load(&path).unwrap().gloss.unwrap();
        assert_eq!(found.is_coloured(), version == 3);
        for (k, found) in found.texels().iter().enumerate() {
            assert!((found.roughness / gloss(k).roughness - 1.0).abs() < 1e-5);
            if Gloss::is_white(&gloss(k).tint) {
                assert_eq!((found.strength, found.tint), (gloss(k).strength, [1.0; 3]));
            }
            let off = found.scale() - gloss(k).scale();
            assert!(off.abs().max_element() < 1e-5, "{off}");
        }
    }
    fs::remove_file(path.join(STRENGTH)).unwrap();
    let error = Solution::load(&path).err().unwrap().to_string();
    assert!(error.contains(STRENGTH), "{error}");
    // With one gloss for all, older programs can read it.
    let one = folder.path().join("one");
    example().save(&one).unwrap();
    let text = fs::read_to_string(one.join(MANIFEST)).unwrap();
    assert!(text.contains("\"version\": 1,"), "{text}");
}

#[test]
fn what_a_solution_did_not_write_is_never_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution");
    pictured().save(&path).unwrap();
    example().save(&path).unwrap();
    assert!(!path.join(HEMISPHERES).exists(), "all of the old one goes");
    pictured().save(&path).unwrap();
    for (name, is_folder) in [
        ("notes.txt", false),
        ("paintings", true),
        ("hemispheres/partial_000.png", false),
        ("hemispheres/mine", true),
    ] {
        let other = path.join(name);
        if is_folder {
            fs::create_dir(&other).unwrap();
        } else {
            fs::write(&other, "x").unwrap();
        }
        let error = check_destination(&path).unwrap_err().to_string();
        assert!(error.contains(name), "{error} does not name {name}");
        assert!(example().save(&path).is_err());
        assert!(other.exists() && Solution::load(&path).is_ok());
        if is_folder {
            fs::remove_dir(&other).unwrap();
        } else {
            fs::remove_file(&other).unwrap();
        }
    }
    assert!(check_destination(&path).unwrap().is_empty());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn files_are_known_of_solutions_that_do_not_list_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution");
    pictured().save(&path).unwrap();
    let manifest = path.join(MANIFEST);
    let mut value: serde_json::Value = read_json(&manifest).unwrap();
    let listed = value.as_object_mut().unwrap().remove("files").unwrap();
    assert_eq!(listed.as_array().unwrap().len(), 11);
    write_json(&manifest, &value, true).unwrap();
    fs::write(path.join("notes.txt"), "x").unwrap();
    let error = check_destination(&path).unwrap_err().to_string();
    assert!(error.contains(": holds notes.txt, which"), "{error}");
    fs::remove_file(path.join("notes.txt")).unwrap();
    pictured().save(&path).unwrap();
}
