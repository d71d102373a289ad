use std::path::Path;

use super::*;
use rekindle_base::math::median;
use rekindle_base::math::random::Random;

/// A capture with known truth of the repository.
fn load(name: &str) -> Capture {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/captures");
    Capture::load(&folder.join(name)).expect("test capture")
}

fn registered(capture: &Capture) -> Vec<Correction> {
    let occluder = Occluder::new(&capture.mesh);
    let see = |view: &View| ViewSurface::new(&capture.mesh, &occluder, &view.camera);
    let surfaces: Vec<ViewSurface> = capture.views.iter().map(see).collect();
    register(&capture.mesh, &capture.views, &surfaces, &occluder).corrections
}

/// Turns each camera by `degrees` about an axis of its own.
fn misalign(capture: &Capture, degrees: f64) -> (Capture, Vec<Correction>) {
    let turns: Vec<Correction> = (0..capture.views.len())
        .map(|i| Correction {
            turn_deg: (degrees * Random::new(i as u64, 0).direction(0)).to_array(),
            ..Correction::default()
        })
        .collect();
    (corrected(capture, &turns).into_owned(), turns)
}

#[test]
fn cameras_that_look_elsewhere_are_turned_back() {
    let capture = load("spot_paper");
    for degrees in [0.1, 1.5, 5.0] {
        let (moved, turns) = misalign(&capture, degrees);
        for (found, turn) in registered(&moved).iter().zip(&turns) {
            let left = DVec3::from(found.turn_deg) + DVec3::from(turn.turn_deg);
            assert!(left.length() < 0.02, "{found:?} of {turn:?}");
            assert_eq!(found.exposure, 1.0);
        }
    }
}

#[test]
fn cameras_that_stood_elsewhere_are_moved_back() {
    let capture = load("spot_paper");
    let distance = |view: &View| {
        let centre = capture.mesh.centre().as_dvec3();
        view.camera.position().distance(centre)
    };
    let shifts = capture.views.iter().enumerate().map(|(i, view)| {
        let random = Random::new(i as u64, 1);
        // All but two stay.
        let by = [0.04, 0.1].get(i).map_or(0.0, |part| part * distance(view));
        Correction {
            turn_deg: (0.5 * random.direction(0)).to_array(),
            shift: (by * random.direction(1)).to_array(),
            ..Correction::default()
        }
    });
    let shifts: Vec<Correction> = shifts.collect();
    let moved = corrected(&capture, &shifts).into_owned();
    let found = registered(&moved);
    let back = corrected(&moved, &found);
    for (i, (view, stated)) in back.views.iter().zip(&capture.views).enumerate() {
        let (now, truth) = (&view.camera, &stated.camera);
        assert_eq!(found[i].shift != [0.0; 3], i < 2, "{:?}", found[i]);
        let vertices = capture.mesh.positions.iter().step_by(50);
        for vertex in vertices.map(|v| v.as_dvec3()) {
            let (Some(a), Some(b)) = (now.project(vertex), truth.project(vertex)) else {
                continue;
            };
            assert!(a.distance(b) < 0.5, "view {i}: {a} for {b}");
        }
    }
}

#[test]
fn exact_cameras_and_exposures_are_left_alone() {
    // The last has a mesh a tenth as fine as the object, whose outline is off by a good part of a pixel.
    for name in ["spot_paper", "spot_plastic", "spot_near", "spot_decimated"] {
        for found in registered(&load(name)) {
            assert_eq!(found, Correction::default(), "{name}");
        }
    }
}

#[test]
fn a_mask_wider_than_the_object_does_not_turn_cameras() {
    let mut capture = load("spot_paper");
    for view in &mut capture.views {
        let photograph = Arc::make_mut(&mut view.photograph);
        let (width, height) = (photograph.width as usize, photograph.height as usize);
        let coverage = photograph.coverage.take().expect("alpha");
        let wider = (0..coverage.len()).map(|i| {
            let (x, y) = (i % width, i / width);
            let rows = y.saturating_sub(2)..(y + 3).min(height);
            let around = rows.flat_map(|v| {
                (x.saturating_sub(2)..(x + 3).min(width)).map(move |u| v * width + u)
            });
            around.map(|k| coverage[k]).fold(0.0, f32::max)
        });
        photograph.coverage = Some(wider.collect());
    }
    for found in registered(&capture) {
        assert!(!found.moves(), "{found:?}");
    }
}

#[test]
fn views_of_other_exposures_are_evened_out() {
    let capture = load("spot_paper");
    let factors = [1.1, 0.95, 1.0, 1.04, 0.9, 1.02];
    let brighter = evened(&capture, &factors.map(|f: f64| f.recip())).into_owned();
    let most = median(&mut factors.map(f64::ln)).unwrap();
    for (found, factor) in registered(&brighter).iter().zip(factors) {
        let off = found.exposure.ln() - (factor.ln() - most);
        assert!(off.abs() < 0.003, "{found:?} for {factor}");
        assert!(!found.moves());
    }
}

#[test]
fn one_view_of_another_exposure_leaves_the_others_as_they_are() {
    let capture = load("spot_paper");
    let mut gains = [[1.0; 3]; 6];
    gains[2] = [4.0; 3];
    gains[4] = [1.05, 1.0, 0.95];
    let wrong: Vec<Correction> = gains
        .iter()
        .map(|gain| Correction {
            balance: gain.map(f64::recip),
            ..Correction::default()
        })
        .collect();
    let wrong = corrected(&capture, &wrong).into_owned();
    for (found, gain) in registered(&wrong).iter().zip(gains) {
        for (found, gain) in found.gains().iter().zip(gain) {
            let off = (found / gain).ln();
            assert!(off.abs() < 0.004, "{found} for {gain}");
        }
    }
}

#[test]
fn what_was_corrected_is_said() {
    let found = [
        Correction {
            turn_deg: [0.0, 0.3, 0.4],
            ..Correction::default()
        },
        Correction {
            shift: [0.0, 0.06, 0.08],
            exposure: 0.8,
            balance: [1.1, 1.0, 1.0],
            ..Correction::default()
        },
    ];
    let said = describe(&found).join(" ");
    assert!(
        said.contains("1 view")
            && said.contains("0.50°")
            && said.contains("the camera of 1 view was moved by up to 0.100")
            && said.contains("25.0 %")
            && said.contains("10.0 % in a channel"),
        "{said}"
    );
    assert!(describe(&[Correction::default()]).is_empty());
}
