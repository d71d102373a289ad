use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use exr::prelude::{ReadChannels as _, ReadLayers as _, read};
use glam::{DVec3, Vec3};

use super::*;
use rekindle_capture::Camera;
use rekindle_relight::ViewTransform;
use rekindle_relight::{self as relight, Lighting};
use rekindle_scene::surface::fixtures::camera;
use rekindle_solution::Solution;
use rekindle_studio::fixtures::solution;
use rekindle_studio::{Document, LampId};

fn view() -> Camera {
    camera(DVec3::new(1.0, 1.5, 3.5), DVec3::ZERO, 75, 70, 1.3)
}

fn job(folder: &Path, lighting: &Lighting) -> Job {
    Job {
        shots: vec![Shot {
            stem: "view".to_owned(),
            camera: view(),
            lighting: Arc::new(lighting.clone()),
        }],
        png: None,
        exr: false,
        layers: false,
        light_groups: false,
        animation: None,
        transform: ViewTransform::Agx,
        exposure: 2.0,
        background: None,
        edits: None,
        folder: folder.to_owned(),
    }
}

fn run(renderer: &Renderer, job: &Job) -> Result<usize, ExportError> {
    export(renderer, job, &|| false, &mut |_, _| {}).map(|files| files.len())
}

/// A channel of an EXR file.
fn channel(path: &Path, name: &str) -> Vec<f32> {
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .unwrap();
    let list = &image.layer_data.channel_data.list;
    let found = list.iter().find(|c| c.name.to_string() == name).unwrap();
    found.sample_data.values_as_f32().collect()
}

fn moved(solution: &Arc<Solution>) -> Document {
    let mut document = Document::new(Arc::clone(solution), None);
    document.edit("Move", |s, _| {
        let lamp = s.look_mut().lamp_mut(LampId(0)).unwrap();
        lamp.direction = Vec3::new(0.8, 0.6, 0.0);
        lamp.stops = 0.5;
    });
    document
}

#[test]
fn an_exr_holds_what_the_reference_renderer_gives_in_layers() {
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let lighting = moved(&solution).light().lighting;
    let folder = tempfile::tempdir().unwrap();
    let job = Job {
        exr: true,
        layers: true,
        ..job(folder.path(), &lighting)
    };
    assert_eq!(run(&renderer, &job).unwrap(), 1);
    let expected = renderer.light(&lighting).picture(&view());
    let file = folder.path().join("view.exr");
    assert_eq!(channel(&file, "A"), expected.coverage);
    for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
        let of = |pixels: &[[f32; 3]]| pixels.iter().map(|p| p[c]).collect::<Vec<f32>>();
        let (diffuse, specular) = (of(&expected.diffuse), of(&expected.specular));
        assert_eq!(channel(&file, &format!("diffuse.{name}")), diffuse);
        assert_eq!(channel(&file, &format!("specular.{name}")), specular);
        let sum: Vec<f32> = diffuse.iter().zip(&specular).map(|(d, s)| d + s).collect();
        assert_eq!(channel(&file, name), sum);
    }
    // In the middle: the sphere of radius 1 about the origin, seen from 3.94 away.
    let middle = 35 * 75 + 37;
    let depth = channel(&file, "Z")[middle];
    assert!((2.8..3.1).contains(&depth), "depth {depth}");
    let normal =
        Vec3::from(["X", "Y", "Z"].map(|a| channel(&file, &format!("normal.{a}"))[middle]));
    let towards = view().position().as_vec3().normalize_or_zero();
    assert!(normal.dot(towards) > 0.8, "normal {normal}");
    let albedo = channel(&file, "albedo.G")[middle];
    assert!((albedo - 0.015).abs() < 1e-4, "albedo {albedo}");
    assert_eq!(channel(&file, "Z")[0], 0.0);
}

#[test]
fn light_groups_add_up_to_the_picture_and_are_its_lamps() {
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let folder = tempfile::tempdir().unwrap();
    let mut document = moved(&solution);
    document.edit("Mute", |s, _| {
        s.look_mut().lamp_mut(LampId(1)).unwrap().muted = true;
    });
    for lighting in [renderer.original(), &document.light().lighting] {
        let job = Job {
            exr: true,
            layers: true,
            light_groups: true,
            ..job(folder.path(), lighting)
        };
        run(&renderer, &job).unwrap();
        let file = folder.path().join("view.exr");
        let lit = |i: usize| !lighting.lamps[i].muted;
        let lamps: Vec<usize> = (0..3).filter(|&i| lit(i)).collect();
        let mut names: Vec<String> = lamps.iter().map(|i| format!("light_{}", i + 1)).collect();
        names.push("light_rest".to_owned());
        for c in ["R", "G", "B"] {
            let groups = names.iter().map(|n| channel(&file, &format!("{n}.{c}")));
            let sum = groups.reduce(|a, b| a.iter().zip(b).map(|(a, b)| a + b).collect());
            assert_eq!(sum.unwrap(), channel(&file, c));
            // The factors of the diffuse part.
            let product: Vec<f32> = channel(&file, &format!("albedo.{c}"))
                .iter()
                .zip(channel(&file, &format!("irradiance.{c}")))
                .map(|(a, b)| a * b)
                .collect();
            for (found, diffuse) in product.iter().zip(channel(&file, &format!("diffuse.{c}"))) {
                assert!(
                    (found - diffuse).abs() <= 1e-5 * diffuse,
                    "{found}, {diffuse}"
                );
            }
        }
        // The middle of the picture lies where its channels say.
        let middle = 35 * 75 + 37;
        let at =
            Vec3::from(["X", "Y", "Z"].map(|a| channel(&file, &format!("position.{a}"))[middle]));
        let seen = view().project(at.as_dvec3()).unwrap();
        assert!(
            seen.distance(glam::DVec2::new(37.5, 35.5)) < 0.5,
            "seen at {seen}"
        );
        if lighting == renderer.original() {
            // The stored texture is shared out, which this solution's own irradiance does not quite give.
            continue;
        }
        // One lamp's group is the picture that it makes alone, up to the finer sampling of pixels in which another lamp's
        // shadow ends; no other lamp's is.
        let mut alone = lighting.clone();
        alone.lamps = vec![lighting.lamps[0].clone()];
        alone.remainder.clear();
        alone.ambient = Vec3::ZERO;
        let expected = renderer.light(&alone).picture(&view());
        let found = channel(&file, "light_1.G");
        let sum = |i: usize| expected.diffuse[i][1] + expected.specular[i][1];
        let total: f32 = (0..found.len()).map(sum).sum();
        let off: f32 = (0..found.len()).map(|i| (found[i] - sum(i)).abs()).sum();
        assert!(off < 0.05 * total, "{off} of {total}");
        let other = channel(&file, "light_3.G");
        let off: f32 = (0..other.len()).map(|i| (other[i] - sum(i)).abs()).sum();
        assert!(off > 0.5 * total, "{off} of {total}");
    }
}

#[test]
fn pngs_show_the_picture_through_the_view_transform() {
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let folder = tempfile::tempdir().unwrap();
    for (depth, unit, background) in [
        (Depth::Eight, 255.0, None),
        (Depth::Sixteen, 65535.0, Some([0.5, 0.25, 0.0])),
    ] {
        let job = Job {
            png: Some(depth),
            background,
            ..job(folder.path(), renderer.original())
        };
        run(&renderer, &job).unwrap();
        let read = image::open(folder.path().join("view.png")).unwrap();
        assert_eq!((read.width(), read.height()), (75, 70));
        assert_eq!(read.color().has_alpha(), background.is_none());
        let read = read.to_rgba32f();
        let picture = renderer.light(renderer.original()).picture(&view());
        for (i, pixel) in read.pixels().enumerate() {
            let alpha = picture.coverage[i];
            let sum = Vec3::from(picture.diffuse[i]) + Vec3::from(picture.specular[i]);
            let shown = ViewTransform::Agx.apply(2.0 * sum / alpha.max(1e-6));
            let expected = background.map_or(shown, |b| Vec3::from(b).lerp(shown, alpha));
            let found = Vec3::new(pixel[0], pixel[1], pixel[2]);
            let off = (found - expected).abs().max_element();
            assert!(off < 0.51 / unit, "pixel {i} is off by {off}");
            if background.is_none() {
                assert!((pixel[3] - alpha).abs() < 0.51 / unit);
            }
        }
    }
}

#[test]
fn pictures_do_not_depend_on_how_they_are_cut() {
    // Tall enough for two bands: the lower one alone, as a camera of its own, is the same.
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let tall = camera(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, 512, 576, 1.4);
    let whole = renderer.light(renderer.original()).picture(&tall);
    let mut low = tall.clone();
    low.centre.y -= 512.0;
    low.height = 64;
    let part = renderer.light(renderer.original()).picture(&low);
    let start = 512 * 512;
    assert_eq!(whole.coverage[start..], part.coverage);
    assert_eq!(whole.diffuse[start..], part.diffuse);
    assert_eq!(whole.specular[start..], part.specular);
}

#[test]
fn a_turntable_becomes_frames_and_an_animation() {
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let folder = tempfile::tempdir().unwrap();
    let lighting = Arc::new(renderer.original().clone());
    let shots = turntable(&view(), DVec3::ZERO, DVec3::Y, 4)
        .into_iter()
        .enumerate()
        .map(|(i, camera)| Shot {
            stem: format!("turn_{i:03}"),
            camera,
            lighting: Arc::clone(&lighting),
        })
        .collect();
    let job = Job {
        shots,
        png: Some(Depth::Eight),
        animation: Some(("turn".to_owned(), 12)),
        ..job(folder.path(), &lighting)
    };
    assert_eq!(run(&renderer, &job).unwrap(), 5);
    let file = std::io::BufReader::new(fs::File::open(folder.path().join("turn.apng")).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    assert_eq!(reader.info().animation_control().unwrap().num_frames, 4);
    let mut frames = Vec::new();
    for i in 0..4 {
        let mut buffer = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut buffer).unwrap();
        let alone = image::open(folder.path().join(format!("turn_{i:03}.png"))).unwrap();
        assert!(alone.into_bytes() == buffer, "frame {i} is its picture");
        frames.push(buffer);
    }
    assert!(frames[0] != frames[1] && frames[1] != frames[2]);
}

#[test]
fn a_lamp_goes_round_and_keeps_its_flux() {
    let solution = solution();
    let lighting = solution.lighting();
    let circle = lamp_circle(&lighting, 1, 8);
    assert_eq!(circle[0], lighting);
    let up = lighting.up;
    for (k, frame) in circle.iter().enumerate() {
        assert_eq!(frame.lamps[0], lighting.lamps[0]);
        let (lamp, before) = (&frame.lamps[1], &lighting.lamps[1]);
        assert!((lamp.direction.dot(up) - before.direction.dot(up)).abs() < 1e-4);
        let flat = |d: Vec3| d.reject_from(up);
        let angle = flat(lamp.direction).angle_between(flat(before.direction));
        let expected = (k as f32 / 8.0).min(1.0 - k as f32 / 8.0) * std::f32::consts::TAU;
        assert!((angle - expected).abs() < 1e-3);
    }
}

#[test]
fn a_resized_view_shows_the_same_in_height() {
    let small = view();
    let large = with_size(&small, 300, 140);
    for point in [DVec3::ZERO, DVec3::new(0.3, 0.7, -0.2)] {
        let (a, b) = (small.project(point).unwrap(), large.project(point).unwrap());
        assert!((2.0 * a.y - b.y).abs() < 1e-9);
        assert!((2.0 * (a.x - 37.5) - (b.x - 150.0)).abs() < 1e-9);
    }
}

#[test]
fn a_stopped_export_leaves_nothing() {
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("mine.txt"), "x").unwrap();
    for asked in [1, 3, 9] {
        let count = AtomicU32::new(0);
        let stop = || count.fetch_add(1, Ordering::Relaxed) >= asked;
        let job = Job {
            png: Some(Depth::Eight),
            exr: true,
            ..job(folder.path(), renderer.original())
        };
        let result = export(&renderer, &job, &stop, &mut |_, _| {});
        assert!(
            matches!(result, Err(ExportError::Stopped { kept: 0 })),
            "{result:?}"
        );
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}

#[test]
fn a_stopped_export_keeps_the_frames_that_are_finished() {
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let folder = tempfile::tempdir().unwrap();
    let mut job = Job {
        png: Some(Depth::Eight),
        animation: Some(("film".to_owned(), 24)),
        ..job(folder.path(), renderer.original())
    };
    let shot = job.shots[0].clone();
    job.shots = (0..3)
        .map(|k| Shot {
            stem: format!("film_{k}"),
            ..shot.clone()
        })
        .collect();
    // The third frame is never begun.
    let third = std::sync::atomic::AtomicBool::new(false);
    let stop = || third.load(Ordering::Relaxed);
    let result = export(&renderer, &job, &stop, &mut |_, what| {
        third.store(what == "film_2", Ordering::Relaxed);
    });
    assert!(
        matches!(result, Err(ExportError::Stopped { kept: 2 })),
        "{result:?}"
    );
    let mut names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    names.sort();
    assert_eq!(names, ["film_0.png", "film_1.png"]);
    assert!(image::open(folder.path().join("film_1.png")).is_ok());
}

#[test]
fn an_export_beside_others_replaces_none() {
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let folder = tempfile::tempdir().unwrap();
    let wanted = Job {
        png: Some(Depth::Eight),
        ..job(folder.path(), renderer.original())
    };
    let name = format!("{}.png", wanted.shots[0].stem);
    assert_eq!(wanted.there_already(Path::exists), 0);
    for count in 1..=3 {
        run(&renderer, &wanted.clone().beside_others(Path::exists)).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), count);
    }
    assert!(folder.path().join(name).exists());
    // What another export will write is taken, too.
    let second = wanted.clone().beside_others(Path::exists);
    let third = wanted
        .clone()
        .beside_others(|file| file.exists() || second.files().any(|f| f == file));
    assert_ne!(second.shots[0].stem, third.shots[0].stem);
    assert_eq!(wanted.there_already(Path::exists), 1);
}

#[test]
fn files_are_no_larger_than_was_said() {
    /// Room for what stands in front of the pixels, bytes.
    const HEADERS: u64 = 16_000;
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let one = job(Path::new(""), renderer.original());
    for wanted in [
        Job {
            png: Some(Depth::Sixteen),
            ..one.clone()
        },
        Job {
            exr: true,
            ..one.clone()
        },
        Job {
            exr: true,
            layers: true,
            light_groups: true,
            ..one
        },
    ] {
        let folder = tempfile::tempdir().unwrap();
        let wanted = Job {
            folder: folder.path().to_owned(),
            ..wanted
        };
        run(&renderer, &wanted).unwrap();
        let files = fs::read_dir(folder.path()).unwrap();
        let bytes: u64 = files.map(|f| f.unwrap().metadata().unwrap().len()).sum();
        let most = wanted.most_bytes();
        assert!(bytes <= most + HEADERS, "{bytes} of {most}");
        // And it says something: a picture of noise would come near it.
        assert!(10 * bytes > most, "{bytes} of {most}");
    }
}

#[test]
fn impossible_exports_say_why() {
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let folder = tempfile::tempdir().unwrap();
    let good = Job {
        exr: true,
        ..job(folder.path(), renderer.original())
    };
    let message = |job: Job| run(&renderer, &job).unwrap_err().to_string();
    assert!(
        message(Job {
            exr: false,
            ..good.clone()
        })
        .contains("file type")
    );
    let mut large = good.clone();
    large.shots[0].camera.width = 9000;
    assert!(message(large).contains("9000×70"));
    let mut uneven = good.clone();
    uneven.animation = Some(("a".to_owned(), 10));
    uneven.shots.push(uneven.shots[0].clone());
    uneven.shots[1].camera = with_size(&view(), 64, 64);
    assert!(message(uneven).contains("one size"));
    fs::write(folder.path().join("file"), "x").unwrap();
    let nowhere = Job {
        folder: folder.path().join("file/inside"),
        ..good
    };
    assert!(message(nowhere).contains("inside"));
}

#[test]
fn a_look_and_its_edits_give_the_same_picture() {
    let solution = solution();
    let renderer = Renderer::new(&solution);
    let mut document = moved(&solution);
    document.edit("More", |s, b| {
        s.look_mut().lamps[1].angular_radius = Some(0.2);
        s.look_mut().lamps[2].muted = true;
        s.add_lamp(b, Vec3::new(-0.6, 0.0, 0.8));
        s.look_mut().ambient = 0.5;
    });
    let folder = tempfile::tempdir().unwrap();
    let lighting = document.light().lighting;
    let job = Job {
        png: Some(Depth::Eight),
        edits: Some(("edits".to_owned(), document.look().edits(document.base()))),
        ..job(folder.path(), &lighting)
    };
    assert_eq!(run(&renderer, &job).unwrap(), 2);
    let path = folder.path().join("edits.json");
    let edited = relight::apply(&relight::load(&path).unwrap(), renderer.original()).unwrap();
    let a = renderer.light(&edited).picture(&view());
    let b = renderer.light(&lighting).picture(&view());
    let brightest = b
        .diffuse
        .iter()
        .chain(&b.specular)
        .flatten()
        .copied()
        .fold(0.0, f32::max);
    let (a, b) = (
        a.diffuse.iter().chain(&a.specular),
        b.diffuse.iter().chain(&b.specular),
    );
    // Shadow rays may pass an edge on the other side where directions differ in their last bit.
    let differing = a
        .zip(b)
        .filter(|(a, b)| Vec3::from(**a).distance(Vec3::from(**b)) > 1e-3 * brightest)
        .count();
    assert!(differing < 20, "{differing} pixels differ");
}
