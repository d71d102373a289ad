//! Meshes moved out of their capture's frame come back.

use super::*;
use crate::capture::Capture;
use glam::{DQuat, DVec3};
use std::path::Path;
use std::sync::Arc;

fn capture() -> Capture {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures/spot_paper");
    Capture::load(&folder).expect("test capture")
}

fn similarity(axis: DVec3, angle: f64, scale: f64, translation: DVec3) -> Similarity {
    Similarity {
        scale,
        rotation: DQuat::from_axis_angle(axis.normalize_or_zero(), angle),
        translation,
    }
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

fn never(_: f32) -> ControlFlow<()> {
    ControlFlow::Continue(())
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
    let alignment = align(&capture.views, &moved, None, &mut never).expect("an alignment");
    let off = off(&capture, &moved, &alignment);
    assert!(off < 0.003, "{off}, overlap {}", alignment.mean_overlap());
    assert!(
        alignment.mean_overlap() > 0.97,
        "{}",
        alignment.mean_overlap()
    );
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
    let alignment = align(&capture.views, &moved, None, &mut never).expect("an alignment");
    let off = off(&capture, &moved, &alignment);
    assert!(off < 0.003, "{off}, overlap {}", alignment.mean_overlap());
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
    let found = align(&capture.views, &capture.mesh, None, &mut never);
    assert_eq!(found.err(), Some(AlignError::TooFewSilhouettes(1)));
}

#[test]
fn an_alignment_can_be_stopped() {
    let capture = capture();
    let stop = &mut |_: f32| ControlFlow::Break(());
    let found = align(&capture.views, &capture.mesh, None, stop);
    assert_eq!(found.err(), Some(AlignError::Stopped));
}
