//! Meshes moved out of their capture's frame come back.

use super::*;
use glam::{DQuat, DVec2, DVec3};
use rekindle_capture::Capture;
use rekindle_scene::surface::fixtures::bumpy_sphere;
use rekindle_scene::surface::{NO_TRIANGLE, Occluder, front_most};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

fn capture() -> Capture {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/captures/spot_paper");
    Capture::load(&folder).expect("test capture")
}

fn similarity(axis: DVec3, angle: f64, scale: f64, translation: DVec3) -> Similarity {
    Similarity {
        scale,
        rotation: DQuat::from_axis_angle(axis.normalize_or_zero(), angle),
        translation,
    }
}

/// Where the moved mesh of a capture comes to lie, without being stopped.
fn aligned(capture: &Capture, moved: &Mesh, start: Start<'_>) -> Alignment {
    align(&capture.views, moved, start, &mut |_| (), &|| false).expect("an alignment")
}

/// Largest distance of a vertex from where it belongs after a move and the alignment, in parts of the mesh's diagonal.
fn off(capture: &Capture, moved: &Mesh, alignment: &Alignment) -> f64 {
    let pairs = moved.positions.iter().zip(&capture.mesh.positions);
    let distance = pairs.map(|(from, to)| {
        alignment
            .transform
            .apply(from.as_dvec3())
            .distance(to.as_dvec3())
    });
    distance.fold(0.0, f64::max) / f64::from(capture.mesh.diagonal())
}

#[test]
fn a_mesh_that_is_a_little_off_comes_back() {
    let capture = capture();
    let wrong = similarity(
        DVec3::new(1.0, 2.0, -1.0),
        0.12,
        1.07,
        DVec3::new(0.08, -0.05, 0.06),
    );
    let moved = wrong.moved(&capture.mesh);
    let alignment = aligned(&capture, &moved, Start::Anywhere);
    let off = off(&capture, &moved, &alignment);
    assert!(off < 0.003, "{off}, overlap {:?}", alignment.mean_overlap());
    let overlap = alignment.mean_overlap();
    assert!(overlap > Some(0.97), "{overlap:?}");
}

#[test]
fn a_mesh_from_elsewhere_is_found_from_nothing() {
    let capture = capture();
    // Another axis up, in millimetres, far away.
    let wrong = similarity(
        DVec3::new(1.0, 0.3, 0.5),
        1.9,
        1000.0,
        DVec3::new(4e4, -900.0, 77.0),
    );
    let moved = wrong.moved(&capture.mesh);
    let alignment = aligned(&capture, &moved, Start::Anywhere);
    let off = off(&capture, &moved, &alignment);
    assert!(off < 0.003, "{off}, overlap {:?}", alignment.mean_overlap());
    assert!(!alignment.ambiguous);
}

#[test]
fn pairs_of_points_give_the_transform() {
    let wanted = similarity(
        DVec3::new(-1.0, 0.2, 0.6),
        2.8,
        0.03,
        DVec3::new(5.0, -2.0, 1.0),
    );
    let corners = [
        DVec3::X,
        DVec3::new(0.0, 2.0, 0.3),
        DVec3::new(-1.0, 0.5, 4.0),
    ];
    let pairs = corners.map(|p| [p, wanted.apply(p)]);
    let found = Similarity::from_pairs(&pairs).expect("a transform");
    for p in corners {
        assert!(found.apply(p).distance(wanted.apply(p)) < 1e-9);
    }
    assert!((found.scale / wanted.scale - 1.0).abs() < 1e-9);
    let on_a_line = [1.0, 2.0, 3.0].map(|k| [k * DVec3::X, k * DVec3::Y]);
    assert_eq!(Similarity::from_pairs(&on_a_line), Err(AlignError::Pairs));
    assert_eq!(Similarity::from_pairs(&pairs[..2]), Err(AlignError::Pairs));
}

#[test]
fn photographs_without_silhouettes_are_too_few() {
    let mut capture = capture();
    for view in &mut capture.views[1..] {
        Arc::make_mut(&mut view.photograph).coverage = None;
    }
    let found = align(
        &capture.views,
        &capture.mesh,
        Start::Anywhere,
        &mut |_| (),
        &|| false,
    );
    assert_eq!(found.err(), Some(AlignError::TooFewSilhouettes(1)));
}

#[test]
fn an_alignment_can_be_stopped() {
    let capture = capture();
    // At the beginning, and after some of the work.
    for after in [0, 30] {
        let asked = AtomicU32::new(0);
        let stop = || asked.fetch_add(1, Ordering::Relaxed) >= after;
        let found = align(
            &capture.views,
            &capture.mesh,
            Start::Anywhere,
            &mut |_| (),
            &stop,
        );
        assert_eq!(found.err(), Some(AlignError::Stopped));
        let asked = asked.load(Ordering::Relaxed);
        assert!(asked < after + 20, "it went on for {asked} questions");
    }
}

/// Marks of points spread over a mesh that lies elsewhere, each in the views with these numbers, off by up to `error` pixels.
fn marks(
    capture: &Capture,
    wrong: &Similarity,
    views: &[&[usize]],
    error: f64,
) -> Vec<MarkedPoint> {
    let mut random = rekindle_base::damage::Random(7);
    let places = capture.mesh.spread(views.len());
    let point = |((triangle, at), views): ((u32, glam::Vec2), &&[usize])| {
        let there = capture.mesh.point(triangle, at).position.as_dvec3();
        let marks = views.iter().map(|&view| {
            let seen = capture.views[view].camera.project(there).expect("in front");
            let off = DVec2::new(random.unit() - 0.5, random.unit() - 0.5);
            Mark {
                view,
                pixel: seen + 2.0 * error * off,
            }
        });
        MarkedPoint {
            place: wrong.apply(there),
            marks: marks.collect(),
        }
    };
    places.into_iter().zip(views).map(point).collect()
}

/// Another axis up, in millimetres, far away.
fn elsewhere() -> Similarity {
    similarity(
        DVec3::new(1.0, 0.3, 0.5),
        1.9,
        1000.0,
        DVec3::new(4e4, -900.0, 77.0),
    )
}

#[test]
fn exact_marks_give_the_transform() {
    let capture = capture();
    let wrong = elsewhere();
    for views in [
        &[&[0, 1][..], &[1, 2], &[0, 4]][..],
        &[&[0, 3], &[1], &[2], &[4, 5], &[]],
        &[&[0], &[0], &[0, 5], &[0], &[5]],
    ] {
        let points = marks(&capture, &wrong, views, 0.0);
        let found = Placement::new(&capture.views, &points).expect("a place");
        for &p in &capture.mesh.positions {
            let back = found.transform.apply(wrong.apply(p.as_dvec3()));
            let off = back.distance(p.as_dvec3()) / f64::from(capture.mesh.diagonal());
            assert!(off < 1e-3, "{off} with {views:?}");
        }
        assert!(found.mean_miss() < 0.05, "{}", found.mean_miss());
    }
}

#[test]
fn marks_set_by_hand_are_refined_by_silhouettes() {
    let capture = capture();
    let wrong = elsewhere();
    let moved = wrong.moved(&capture.mesh);
    let points = marks(&capture, &wrong, &[&[0, 1], &[1, 2], &[0, 4], &[3]], 3.0);
    let placed = Placement::new(&capture.views, &points).expect("a place");
    assert!(placed.mean_miss() < 4.0, "{}", placed.mean_miss());
    let alignment = aligned(&capture, &moved, Start::Marks(&points));
    let off = off(&capture, &moved, &alignment);
    assert!(off < 0.004, "{off}, overlap {:?}", alignment.mean_overlap());
}

#[test]
fn marks_hold_the_turn_that_silhouettes_leave_open() {
    let mut capture = capture();
    // An egg in place of the object: its turn about its axis shows in no silhouette.
    let (centre, size) = (capture.mesh.centre(), 0.3 * capture.mesh.diagonal());
    let mut egg = bumpy_sphere(24, 0.0);
    for p in &mut egg.positions {
        *p = centre + size * *p * glam::Vec3::new(0.7, 1.0, 0.7);
    }
    let occluder = Occluder::new(&egg);
    for view in &mut capture.views {
        let (triangles, _) = front_most(&egg, &occluder, &view.camera);
        let covered = triangles
            .iter()
            .map(|&t| f32::from(u8::from(t != NO_TRIANGLE)));
        Arc::make_mut(&mut view.photograph).coverage = Some(covered.collect());
    }
    capture.mesh = egg;
    let wrong = elsewhere();
    let moved = wrong.moved(&capture.mesh);
    let points = marks(&capture, &wrong, &[&[0, 1], &[1, 2], &[0, 4], &[3, 5]], 1.0);
    let alignment = aligned(&capture, &moved, Start::Marks(&points));
    let off = off(&capture, &moved, &alignment);
    assert!(off < 0.01, "{off}, overlap {:?}", alignment.mean_overlap());
}

#[test]
fn without_silhouettes_marks_alone_place_the_mesh() {
    let mut capture = capture();
    for view in &mut capture.views {
        Arc::make_mut(&mut view.photograph).coverage = None;
    }
    let wrong = elsewhere();
    let moved = wrong.moved(&capture.mesh);
    let points = marks(&capture, &wrong, &[&[0, 1], &[1, 2], &[0, 4]], 0.0);
    let alignment = aligned(&capture, &moved, Start::Marks(&points));
    assert!(off(&capture, &moved, &alignment) < 1e-3);
    assert!(alignment.overlap.iter().all(Option::is_none));
}

#[test]
fn marks_that_leave_the_place_open_are_refused() {
    let capture = capture();
    let wrong = elsewhere();
    let refused = |points: &[MarkedPoint]| Placement::new(&capture.views, points).err();
    let of = |views: &[&[usize]]| marks(&capture, &wrong, views, 0.0);
    assert_eq!(refused(&[]), Some(MarksError::TooFewPoints(0)));
    let two = of(&[&[0, 1], &[2, 3], &[]]);
    assert_eq!(refused(&two), Some(MarksError::TooFewPoints(2)));
    let one_photograph = of(&[&[2], &[2], &[2], &[2]]);
    assert_eq!(refused(&one_photograph), Some(MarksError::OnePhotograph));
    let few = of(&[&[0], &[1], &[2]]);
    assert_eq!(refused(&few), Some(MarksError::TooFewMarks));
    let mut on_a_line = of(&[&[0, 1], &[1, 2], &[0, 4]]);
    for (k, point) in on_a_line.iter_mut().enumerate() {
        point.place = wrong.apply(k as f64 * DVec3::new(0.1, 0.2, 0.3));
    }
    assert_eq!(refused(&on_a_line), Some(MarksError::OnALine));
}

#[test]
fn marks_that_contradict_each_other_are_refused() {
    let capture = capture();
    let wrong = elsewhere();
    let refused = |points: &[MarkedPoint]| Placement::new(&capture.views, points).err();
    // One of many in the wrong place.
    let mut off = marks(
        &capture,
        &wrong,
        &[&[0, 1, 2], &[1, 2, 3], &[0, 4, 5], &[0, 3, 5]],
        0.0,
    );
    off[1].marks[0].pixel += DVec2::new(90.0, -60.0);
    assert_eq!(refused(&off), Some(MarksError::Contradiction { point: 2 }));
    // Cameras turned round: what they see is behind them.
    let mut turned = capture.clone();
    for view in &mut turned.views {
        let pose = &mut view.camera.world_from_camera;
        pose.matrix3 *= glam::DMat3::from_rotation_y(std::f64::consts::PI);
    }
    let points = marks(&capture, &wrong, &[&[0, 1], &[1, 2], &[0, 4]], 0.0);
    let found = Placement::new(&turned.views, &points).err();
    assert!(
        matches!(
            found,
            Some(MarksError::Contradiction { .. } | MarksError::Ambiguous)
        ),
        "{found:?}"
    );
}

#[test]
fn damaged_points_are_read_or_refused() {
    let capture = capture();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points.json");
    let name = &capture.views[2].name;
    let point = format!(r#"{{"mesh": [0.1, -0.2, 3e-1], "marks": {{"{name}": [41.5, 30]}}}}"#);
    let whole = format!("[{point}, {point}]").into_bytes();
    std::fs::write(&path, &whole).unwrap();
    let read = read_points(&path, &capture).expect("points");
    assert_eq!(read.len(), 2);
    assert_eq!(read[0].place, DVec3::new(0.1, -0.2, 0.3));
    let mark = Mark {
        view: 2,
        pixel: DVec2::new(41.5, 30.0),
    };
    assert_eq!(read[1].marks, [mark]);
    let mut random = rekindle_base::damage::Random(3);
    for _ in 0..500 {
        std::fs::write(&path, rekindle_base::damage::damaged(&whole, &mut random)).unwrap();
        match read_points(&path, &capture) {
            Ok(points) => {
                let _ = Placement::new(&capture.views, &points);
            }
            Err(error) => assert!(error.to_string().contains("points.json"), "{error}"),
        }
    }
}
