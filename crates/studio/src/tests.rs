use rekindle_relight::luminance;
use std::fs;
use std::path::Path;

use glam::{Quat, Vec3};

use super::fixtures::solution;
use super::*;
use rekindle_relight::{self as relight, LampNodes, LightNode, Lighting, ProbeUnits};

fn document() -> Document {
    Document::new(solution(), Some("solution".into()))
}

/// Everything that shines, node by node.
fn shining(lighting: &Lighting) -> Vec<LightNode> {
    let lamps = lighting.lamps.iter().filter(|l| !l.muted);
    lamps
        .chain(lighting.environment_lamps())
        .flat_map(|l| l.nodes.iter().copied())
        .chain(lighting.remainder.iter().copied())
        .collect()
}

/// Fails unless two lightings cast the same light, in whatever order.
fn assert_same_light(a: &Lighting, b: &Lighting, what: &str) {
    let (a_nodes, b_nodes) = (shining(a), shining(b));
    assert_eq!(a_nodes.len(), b_nodes.len(), "{what}: number of nodes");
    let mut left = b_nodes;
    for node in &a_nodes {
        let difference = |other: &LightNode| {
            other.direction.distance(node.direction)
                + (other.flux() - node.flux()).length() / node.flux().length().max(1e-20)
        };
        let (at, least) = left
            .iter()
            .map(difference)
            .enumerate()
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap();
        assert!(least < 1e-4, "{what}: a node is off by {least}");
        left.swap_remove(at);
    }
    assert!((a.ambient - b.ambient).length() < 1e-6, "{what}: ambient");
}

/// A small probe with a sun in it.
fn write_probe(path: &Path) {
    let (width, height) = (32, 16);
    let pixels: Vec<[f32; 3]> = (0..width * height)
        .map(|i| {
            if i == 130 {
                [50.0, 40.0, 30.0]
            } else {
                [0.2, 0.3, 0.5]
            }
        })
        .collect();
    rekindle_solution::write_rgb(path, width, &pixels).unwrap();
}

/// The document's light must be what its edits make of the solution.
fn assert_edits_agree(document: &Document, folder: &Path, what: &str) {
    let edits = document.look().edits(document.base());
    let path = folder.join("edits.json");
    fs::write(&path, serde_json::to_string(&edits).unwrap()).unwrap();
    let edits = relight::load(&path).unwrap();
    let applied = relight::apply(&edits, &document.base().lighting).unwrap();
    assert_same_light(&document.light().lighting, &applied, what);
}

#[test]
fn an_untouched_look_is_the_light_of_the_capture() {
    let document = document();
    // Exactly: the reference renderer then shows the stored texture.
    assert_eq!(document.light().lighting, document.solution.lighting());
    assert!(document.look().edits(document.base()).is_empty());
    assert!(!document.is_modified());
}

#[test]
fn a_look_and_its_edits_are_the_same_light() {
    type Change = Box<dyn Fn(&mut State, &Baseline)>;
    let id = LampId;
    let set = |i: u32, change: fn(&mut Lamp)| -> Change {
        Box::new(move |state, _| change(state.look_mut().lamp_mut(id(i)).unwrap()))
    };
    let folder = tempfile::tempdir().unwrap();
    let probe = folder.path().join("probe.exr");
    write_probe(&probe);
    let probe_file = probe.clone();
    // Every change is tried alone, after the one before it, and all are tried together.
    let changes: Vec<(&str, Change)> = vec![
        ("mute", set(1, |l| l.muted = true)),
        ("stops", set(0, |l| l.stops = -1.5)),
        ("gain", set(2, |l| l.colour = Colour::Gain([2.0, 0.5, 0.0]))),
        ("kelvin", set(0, |l| l.colour = Colour::Kelvin(3200.0))),
        ("move", set(0, |l| l.direction = Vec3::new(0.6, 0.64, 0.48))),
        ("below", set(2, |l| l.direction = Vec3::new(0.0, -0.6, 0.8))),
        ("soften", set(1, |l| l.angular_radius = Some(0.3))),
        ("delete", Box::new(|s, _| s.look_mut().delete(LampId(2)))),
        (
            "add",
            Box::new(|s, b| {
                s.add_lamp(b, Vec3::new(1.0, 0.1, 0.0));
            }),
        ),
        (
            "duplicate",
            Box::new(|s, b| {
                s.duplicate_lamp(b, LampId(0));
            }),
        ),
        ("rest", Box::new(|s, _| s.look_mut().remainder = false)),
        ("ambient", Box::new(|s, _| s.look_mut().ambient = 0.25)),
        (
            "probe",
            Box::new(move |s, _| {
                s.look_mut().probe = Some(Probe {
                    units: ProbeUnits::Matched,
                    file: probe_file.clone(),
                    rotation: 1.0,
                    stops: -2.0,
                });
            }),
        ),
        (
            "solo",
            Box::new(|s, _| s.look_mut().toggle_solo(&[LampId(0)])),
        ),
        (
            "solo of a disc",
            Box::new(|s, b| {
                let id = s.add_lamp(b, Vec3::Z);
                s.look_mut().solo = vec![id];
            }),
        ),
        (
            "group",
            Box::new(|s, b| {
                let id = s.add_lamp(b, Vec3::NEG_X);
                let group = s.group_lamps(&[LampId(0), LampId(1), id]).unwrap();
                s.look_mut().group_mut(group).unwrap().stops = 1.25;
            }),
        ),
        (
            "muted group",
            Box::new(|s, _| {
                let group = s.group_lamps(&[LampId(1), LampId(2)]).unwrap();
                s.look_mut().group_mut(group).unwrap().muted = true;
            }),
        ),
        (
            "solo of several",
            Box::new(|s, b| {
                let id = s.add_lamp(b, Vec3::Z);
                s.look_mut().toggle_solo(&[id, LampId(0)]);
            }),
        ),
    ];
    let fresh = || {
        let mut document = document();
        document.know_probe(ProbeLight::load(&probe).unwrap());
        document
    };
    let mut together = fresh();
    for i in 0..changes.len() {
        let mut alone = fresh();
        alone.edit("change", |s, b| (changes[i].1)(s, b));
        assert!(alone.is_modified(), "{}", changes[i].0);
        assert_edits_agree(&alone, folder.path(), changes[i].0);
        if i > 0 && changes[i - 1].0 != "delete" {
            let mut two = fresh();
            two.edit("first", |s, b| (changes[i - 1].1)(s, b));
            two.edit("second", |s, b| (changes[i].1)(s, b));
            assert_edits_agree(&two, folder.path(), changes[i].0);
        }
        together.edit("change", |s, b| (changes[i].1)(s, b));
        assert_edits_agree(&together, folder.path(), changes[i].0);
    }
}

#[test]
fn lamps_of_a_group_are_set_together_and_shine_on_without_it() {
    let mut document = document();
    let flux = |document: &Document, lamp: usize| {
        let lamp = &document.light().lighting.lamps[lamp];
        if lamp.muted { Vec3::ZERO } else { lamp.flux() }
    };
    let before = [0, 1, 2].map(|lamp| flux(&document, lamp));
    let both = [LampId(0), LampId(2)];
    let group = document
        .edit("Group", |s, _| s.group_lamps(&both))
        .expect("a group");
    assert_eq!(document.look().members(group), both);
    assert_eq!([0, 1, 2].map(|lamp| flux(&document, lamp)), before);
    document.edit("Dim", |s, _| {
        s.look_mut().group_mut(group).unwrap().stops = -1.0;
        s.look_mut().lamp_mut(LampId(0)).unwrap().stops = 2.0;
    });
    let dimmed = [2.0 * before[0], before[1], 0.5 * before[2]];
    let near = |document: &Document, wanted: [Vec3; 3]| {
        (0..3).all(|i| (flux(document, i) - wanted[i]).length() < 1e-4 * before[i].length())
    };
    assert!(near(&document, dimmed));
    // One that goes to another group, and those that are left when a group ends, shine as before.
    document.edit("Group", |s, _| s.group_lamps(&[LampId(2), LampId(1)]));
    assert!(near(&document, dimmed));
    document.edit("Ungroup", |s, _| s.look_mut().ungroup(group));
    assert!(near(&document, dimmed));
    assert_eq!(document.look().groups.len(), 1);
    // The last lamp takes its group along.
    document.edit("Mute", |s, _| s.look_mut().groups[0].muted = true);
    assert!(near(&document, [dimmed[0], Vec3::ZERO, Vec3::ZERO]));
    document.edit("Delete", |s, _| s.look_mut().delete(LampId(1)));
    document.edit("Delete", |s, _| s.look_mut().delete(LampId(2)));
    assert!(document.look().groups.is_empty());
    for _ in 0..7 {
        document.undo();
    }
    assert!(!document.is_modified());
    // The captured light has no groups: the first one began a setup.
    assert_eq!(names(&document), ["Captured light"]);
}

#[test]
fn groups_come_back_and_projects_without_them_stay_readable_by_older_programs() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = edited(folder.path());
    let path = folder.path().join("project.rekindle");
    let version = || {
        let file: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        file["version"].as_u64()
    };
    document.edit("Solo", |s, _| s.look_mut().toggle_solo(&[LampId(1)]));
    document.save(&path).unwrap();
    assert_eq!(version(), Some(1));
    let text = fs::read_to_string(&path).unwrap();
    assert!(
        text.contains("\"solo\": 1") && !text.contains("group"),
        "{text}"
    );
    document.edit("Group", |s, _| {
        let group = s.group_lamps(&[LampId(0), LampId(2)]).unwrap();
        let group = s.look_mut().group_mut(group).unwrap();
        (group.stops, group.folded) = (0.5, true);
        group.name = "Windows".to_owned();
        s.look_mut().toggle_solo(&[LampId(2), LampId(0)]);
    });
    document.save(&path).unwrap();
    assert_eq!(version(), Some(2));
    let (again, _) = Document::open(&path).unwrap();
    assert_eq!(again.state(), document.state());
    assert_eq!(again.light().lighting, document.light().lighting);
    // What names a group that isn't there is in none; two of one number are refused.
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replacen("\"group\": 0", "\"group\": 5", 1)).unwrap();
    let (again, _) = Document::open(&path).unwrap();
    let members = again.look().members(again.look().groups[0].id);
    assert_eq!(members.len(), 1);
    let mut file: serde_json::Value = serde_json::from_str(&text).unwrap();
    let active = file["active"].as_u64().unwrap() as usize;
    let groups = file["looks"][active]["groups"].as_array_mut().unwrap();
    groups.push(groups[0].clone());
    fs::write(&path, file.to_string()).unwrap();
    let message = Document::open(&path).err().unwrap().to_string();
    assert!(
        message.contains("\"Windows\" has the number of another"),
        "{message}"
    );
}

#[test]
fn any_step_of_the_history_can_be_gone_to() {
    let mut document = document();
    let mut states = vec![document.state().clone()];
    for (label, stops) in [("One", 1.0), ("Two", 2.0), ("Three", 3.0)] {
        document.edit(label, |s, _| s.look_mut().lamps[0].stops = stops);
        states.push(document.state().clone());
    }
    for at in [1, 3, 0, 2] {
        document.go_to(at);
        assert_eq!(document.state(), &states[at]);
        let (done, undone) = document.history();
        assert_eq!(done, ["One", "Two", "Three"][..at]);
        assert_eq!(undone, ["One", "Two", "Three"][at..]);
    }
    document.go_to(9);
    assert_eq!(document.state(), &states[3]);
}

#[test]
fn lamps_that_change_places_do_not_get_mixed_up() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = document();
    document.edit("rotate", |state, base| {
        for i in 0..3_usize {
            let lamp = state.look_mut().lamp_mut(LampId(i as u32)).unwrap();
            lamp.direction = base.lamps[(i + 1) % 3].direction;
            lamp.stops = i as f32;
        }
    });
    assert_edits_agree(&document, folder.path(), "three in a circle");
    document.edit("chase", |state, base| {
        let lamps = &mut state.look_mut().lamps;
        lamps[0].direction = base.lamps[1].direction;
        lamps[1].direction = base.lamps[2].direction;
        lamps[2].direction = Vec3::Y;
    });
    assert_edits_agree(&document, folder.path(), "one after the other");
}

#[test]
fn colour_temperature_keeps_the_luminance() {
    let mut document = document();
    let flux = |d: &Document| d.base().flux(d.look().lamp(LampId(1)).unwrap());
    let before = flux(&document);
    document.edit("warm", |s, _| {
        s.look_mut().lamp_mut(LampId(1)).unwrap().colour = Colour::Kelvin(2700.0);
    });
    let after = flux(&document);
    assert!((luminance(after) / luminance(before) - 1.0).abs() < 1e-4);
    assert!(
        after.x > after.y && after.y > after.z,
        "2700 K is warm: {after}"
    );
    let wanted = Vec3::new(0.2, 0.9, 0.4);
    document.edit("green", |s, b| {
        let lamp = s.look_mut().lamp_mut(LampId(1)).unwrap();
        lamp.colour = b.gain_of_colour(lamp, wanted);
    });
    let after = flux(&document);
    assert!((luminance(after) / luminance(before) - 1.0).abs() < 1e-4);
    assert!((after / luminance(after) - wanted / luminance(wanted)).length() < 1e-4);
}

#[test]
fn everything_can_be_undone_and_a_drag_is_one_step() {
    let mut document = document();
    let mut states = vec![document.state().clone()];
    document.edit("Mute", |s, _| s.look_mut().lamps[0].muted = true);
    states.push(document.state().clone());
    document.begin("Move Light 2");
    for k in 1..20 {
        document.update(|s, _| {
            s.look_mut().lamps[1].direction = Quat::from_rotation_y(k as f32 * 0.05) * Vec3::X;
        });
    }
    document.commit();
    states.push(document.state().clone());
    document.edit("Add a look", State::add_look);
    states.push(document.state().clone());
    document.edit("Add a lamp", |s, b| {
        s.add_lamp(b, Vec3::Y);
    });
    states.push(document.state().clone());
    // What changes nothing is no step.
    document.edit("Nothing", |s, _| s.active = 2);
    assert_eq!(document.undo_label(), Some("Add a lamp"));
    for state in states.iter().rev().skip(1) {
        assert!(document.undo().is_some());
        assert_eq!(document.state(), state);
    }
    assert_eq!(document.undo(), None);
    assert!(!document.is_modified());
    for state in &states[1..] {
        assert!(document.redo().is_some());
        assert_eq!(document.state(), state);
    }
    assert_eq!(document.redo(), None);
    // A drag that is given up leaves nothing, a new edit forgets what was undone.
    document.begin("Move");
    document.update(|s, _| s.look_mut().lamps[0].direction = Vec3::Z);
    document.cancel();
    assert_eq!(document.state(), &states[4]);
    document.undo();
    document.edit("Rename", |s, _| s.look_mut().name = "Evening".to_owned());
    assert_eq!(document.redo_label(), None);
}

#[test]
fn looks_are_kept_apart() {
    let mut document = document();
    document.edit("Duplicate", |s, _| s.duplicate_look(0));
    document.edit("Mute", |s, _| s.look_mut().lamps[0].muted = true);
    assert_eq!(document.state().looks.len(), 2);
    assert!(!document.state().looks[0].lamps[0].muted);
    assert!(document.light().lighting.lamps[0].muted);
    document.edit("Switch", |s, _| s.active = 0);
    assert!(!document.light().lighting.lamps[0].muted);
    document.edit("Delete the captured light", |s, _| s.delete_look(0));
    assert_eq!(document.state().looks.len(), 2);
    document.edit("Delete", |s, _| s.delete_look(1));
    assert_eq!(
        (document.state().looks.len(), document.state().active),
        (1, 0)
    );
    document.edit("Add", State::add_look);
    assert_eq!(names(&document), ["Captured light", "Setup 1"]);
}

fn names(document: &Document) -> Vec<&str> {
    let looks = &document.state().looks;
    looks.iter().map(|l| l.name.as_str()).collect()
}

#[test]
fn the_first_edit_of_the_captured_light_begins_a_setup() {
    let mut document = document();
    document.begin("Move Light 1");
    for k in 1..4 {
        document.update(|s, _| {
            let lamp = s.look_mut().lamp_mut(LampId(0)).unwrap();
            lamp.direction = Quat::from_rotation_y(0.1 * k as f32) * Vec3::X;
        });
    }
    document.commit();
    assert_eq!(names(&document), ["Captured light", "Setup 1"]);
    let captured = &document.state().looks[0];
    assert_eq!(
        document.light_of(captured).lighting,
        document.solution.lighting()
    );
    assert_ne!(document.light().lighting, document.solution.lighting());
    // To and fro is no step, and what comes next goes into the same setup.
    document.show(0);
    assert_eq!(document.light().lighting, document.solution.lighting());
    document.show(1);
    assert_eq!(document.undo_label(), Some("Move Light 1"));
    document.edit("Mute", |s, _| s.look_mut().lamps[1].muted = true);
    assert_eq!(names(&document).len(), 2);
    document.show(0);
    document.edit("Dim", |s, _| s.look_mut().ambient = 0.5);
    assert_eq!(names(&document), ["Captured light", "Setup 1", "Setup 2"]);
    for _ in 0..3 {
        document.undo();
    }
    assert_eq!(names(&document), ["Captured light"]);
    assert!(!document.is_modified());
}

#[test]
fn projects_of_before_the_captured_light_was_kept_get_it_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = edited(folder.path());
    let path = folder.path().join("old.rekindle");
    document.save(&path).unwrap();
    let text = fs::read(&path).unwrap();
    let mut file: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let looks = file["looks"].as_array_mut().unwrap();
    looks.remove(0);
    for look in looks.iter_mut() {
        look.as_object_mut().unwrap().remove("captured");
    }
    file["active"] = 0.into();
    fs::write(&path, file.to_string()).unwrap();
    let (again, _) = Document::open(&path).unwrap();
    assert_eq!(again.light().lighting, document.light().lighting);
    assert_eq!(again.state().captured(), Some(0));
    let captured = &again.state().looks[0];
    assert_eq!(again.light_of(captured).lighting, again.solution.lighting());
}

/// A document of a saved solution with something of everything in it.
fn edited(folder: &Path) -> Document {
    let solution = solution();
    let place = folder.join("scans/bumps");
    solution.save(&place).unwrap();
    let probe = folder.join("scans/probe.exr");
    write_probe(&probe);
    let mut document = Document::new(solution, Some(place));
    document.know_probe(ProbeLight::load(&probe).unwrap());
    document.edit("Everything", |s, b| {
        s.look_mut().lamps[0].direction = Vec3::new(0.0, 0.6, 0.8);
        s.look_mut().lamps[1].colour = Colour::Kelvin(2700.0);
        s.add_lamp(b, Vec3::X);
        s.duplicate_look(0);
        s.look_mut().probe = Some(Probe {
            units: ProbeUnits::Matched,
            file: probe,
            rotation: 0.5,
            stops: 1.0,
        });
    });
    document.view = serde_json::json!({ "exposure": 1.5 });
    let capture = folder.join("scans/capture");
    fs::create_dir(&capture).unwrap();
    document.capture = Some(capture);
    document
}

#[test]
fn a_project_comes_back_as_it_was_and_can_be_moved() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = edited(folder.path());
    assert!(document.is_modified());
    let path = folder.path().join("scans/evening");
    document.save(&path).unwrap();
    assert!(!document.is_modified() && document.undo_label().is_some());
    let path = path.with_extension(EXTENSION);
    assert_eq!(document.project(), Some(path.as_path()));
    let (again, warnings) = Document::open(&path).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(again.light().lighting, document.light().lighting);
    assert_eq!(again.view, document.view);
    assert!(!again.is_modified());

    // With its surroundings, to another place.
    fs::rename(folder.path().join("scans"), folder.path().join("moved")).unwrap();
    let (moved, warnings) = Document::open(&folder.path().join("moved/evening.rekindle")).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(moved.light().lighting, document.light().lighting);
    let capture = moved.capture.expect("it was moved along");
    assert!(capture.is_dir() && capture.ends_with("capture"));

    // Without its probe it opens, and says so; without its solution it can't.
    fs::remove_file(folder.path().join("moved/probe.exr")).unwrap();
    let (_, warnings) = Document::open(&folder.path().join("moved/evening.rekindle")).unwrap();
    assert!(warnings[0].contains("probe.exr"), "{warnings:?}");
    fs::remove_dir_all(folder.path().join("moved/bumps")).unwrap();
    let error = Document::open(&folder.path().join("moved/evening.rekindle"))
        .err()
        .unwrap();
    assert!(
        matches!(error, ProjectError::SolutionMissing { .. }),
        "{error}"
    );
}

#[test]
fn a_new_solve_is_saved_beside_its_project() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = Document::new(solution(), None);
    assert!(document.is_modified(), "a solve is worth saving");
    document.save(&folder.path().join("one.rekindle")).unwrap();
    assert!(folder.path().join("one.solution/solution.json").is_file());
    // A copy elsewhere has a solution of its own.
    document.save(&folder.path().join("two.rekindle")).unwrap();
    fs::remove_dir_all(folder.path().join("one.solution")).unwrap();
    assert!(Document::open(&folder.path().join("two.rekindle")).is_ok());
    let names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    assert_eq!(names.len(), 3, "nothing else is left: {names:?}");
}

#[test]
fn bad_projects_are_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = edited(folder.path());
    let path = folder.path().join("project.rekindle");
    document.save(&path).unwrap();
    let text = fs::read_to_string(&path).unwrap();
    for (from, to, part) in [
        ("rekindle-project", "something-else", "something-else"),
        ("\"version\": 1", "\"version\": 3", "newer"),
        ("\"active\": 1", "\"active\": 7", "setup"),
        (
            "\"estimated\": 2",
            "\"estimated\": 9",
            "none of the solution's",
        ),
        ("\"looks\"", "\"locks\"", "looks"),
        ("{", "[", "not a valid project"),
    ] {
        assert!(text.contains(from), "the file has {from}");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let message = Document::open(&path).err().unwrap().to_string();
        assert!(message.contains(part), "\"{message}\" lacks \"{part}\"");
        assert!(message.contains("project.rekindle"), "{message}");
    }
    let mut random = rekindle_base::damage::Random(5);
    for _ in 0..300 {
        fs::write(
            &path,
            rekindle_base::damage::damaged(text.as_bytes(), &mut random),
        )
        .unwrap();
        if let Ok((document, _)) = Document::open(&path) {
            let light = document.light().lighting;
            assert!(light.lamps.iter().all(|l| !LampNodes::flux(l).is_nan()));
        }
    }
}

#[test]
fn a_crash_leaves_work_that_can_be_recovered() {
    let base = tempfile::tempdir().unwrap();
    let mut document = Document::new(solution(), None);
    document.edit("Mute", |s, _| s.look_mut().lamps[1].muted = true);
    let mut recovery = Recovery::begin(base.path()).unwrap();
    recovery.keep(&document.snapshot()).unwrap();
    document.edit("Dim", |s, _| s.look_mut().lamps[0].stops = -1.0);
    recovery.keep(&document.snapshot()).unwrap();
    // A window that runs is not offered.
    assert!(Recovery::left_behind(base.path()).is_empty());
    let folder = fs::read_dir(base.path())
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    // A crash: the lock goes, the folder stays.
    let crashed = base.path().join("window-crashed");
    copy(&folder, &crashed);
    drop(recovery);
    assert!(!folder.exists(), "an orderly end leaves nothing");
    let left = Recovery::left_behind(base.path());
    assert_eq!(left.len(), 1);
    assert!(
        Recovery::left_behind(base.path()).is_empty(),
        "offered once"
    );
    let (recovered, _) = left[0].open().unwrap();
    assert_eq!(recovered.light().lighting, document.light().lighting);
    assert!(recovered.is_modified() && recovered.project().is_none());
    left.into_iter().for_each(Recoverable::discard);
    assert!(!crashed.exists());
    // The recovered document carries its solution along.
    let mut recovered = recovered;
    recovered.save(&base.path().join("again.rekindle")).unwrap();
    assert!(Document::open(&base.path().join("again.rekindle")).is_ok());
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}
