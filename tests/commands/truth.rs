//! What `rekindle synth` and `rekindle bench` promise on the command line.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use crate::command::{rekindle, succeed};
use rekindle_capture::Capture;
use rekindle_estimate::estimate::{EstimateParams, Unobserved};
use rekindle_lab::synth::{Lamps, Light, Material, Object, Places, Recipe, make};
use rekindle_scene::shortcuts::Shortcut;
use rekindle_solution::{Solution, SolutionLamp, SolveOptions, solve};

/// Fails unless the program refuses with status 2 and one line, which is returned.
fn refused(arguments: &[&str]) -> String {
    let run = rekindle(arguments);
    let message = String::from_utf8_lossy(&run.stderr).into_owned();
    assert_eq!(run.status.code(), Some(2), "{message}");
    message
}

fn capture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures/spot_paper")
}

fn lines(path: &Path) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| line.split(',').map(str::to_owned).collect();
    text.lines().map(row).collect()
}

#[test]
fn a_bench_has_a_row_for_every_iteration_and_the_errors_of_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let (source, into) = (capture(), folder.path().join("bench"));
    succeed(&[
        "bench",
        source.to_str().unwrap(),
        "-o",
        into.to_str().unwrap(),
        "--methods",
        "fast",
        "--rounds",
        "2",
        "--frequency",
        "30",
        "--quiet",
    ]);
    let runs = lines(&into.join("runs.csv"));
    let iterations = lines(&into.join("iterations.csv"));
    assert_eq!(runs.len(), 3, "a head and two rounds");
    let column = |name: &str| runs[0].iter().position(|n| n == name).unwrap();
    let value = |name: &str| runs[1][column(name)].parse::<f64>().unwrap();
    assert!(value("sigma_error_pct").abs() < 1.0);
    assert!(value("direction_error_deg") < 0.3);
    assert!(value("flux_error_pct") < 3.0);
    assert!(value("novel_psnr_db") > 40.0 && value("alone_psnr_db") > 35.0);
    assert!(value("solve_s") > 0.0);
    let first: Vec<_> = iterations[1..].iter().filter(|row| row[2] == "1").collect();
    for (i, row) in first.iter().enumerate() {
        assert_eq!(row[3], (i + 1).to_string(), "iterations are counted");
        assert_eq!(row.len(), iterations[0].len());
    }
    let elapsed: Vec<f64> = first.iter().map(|row| row[4].parse().unwrap()).collect();
    assert!(elapsed.len() > 3 && elapsed.is_sorted(), "{elapsed:?}");
    let text = std::fs::read_to_string(into.join("bench.md")).unwrap();
    assert!(text.contains("spot_paper.svg"), "{text}");
    let plot = std::fs::read_to_string(into.join("spot_paper.svg")).unwrap();
    assert!(plot.contains("<svg") && plot.contains("fast"));
}

#[test]
fn a_capture_without_truth_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let (source, into) = (capture(), folder.path().join("bench"));
    let without = source.with_file_name("spot_decimated");
    let message = refused(&[
        "bench",
        source.to_str().unwrap(),
        without.to_str().unwrap(),
        "-o",
        into.to_str().unwrap(),
        "--quiet",
    ]);
    assert!(
        message.contains("spot_decimated") && message.contains("truth.json"),
        "{message}"
    );
    assert_eq!(message.trim().lines().count(), 1, "{message}");
    assert!(!into.exists(), "nothing may be written");
}

#[test]
fn wishes_that_contradict_each_other_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let into = folder.path().join("made");
    let into = into.to_str().unwrap();
    for (arguments, named) in [
        (&["--ior", "1.4"][..], "--ior"),
        (&["--model", "microfacet", "--ks", "1"][..], "--ks"),
        (&["--interreflection"][..], "--interreflection"),
        (&["--size", "640"][..], "640x480"),
        (&["--lamp", "10,95"][..], "elevation"),
        (&["--samples", "20"][..], "144"),
        (&["--lamps", "13"][..], "12"),
    ] {
        let message = refused(&[&["synth", "-o", into], arguments].concat());
        assert!(message.contains(named), "{message}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let help = rekindle(&["synth", "--help"]);
    let help = String::from_utf8_lossy(&help.stdout).into_owned();
    assert!(help.contains("necessary, not sufficient"), "{help}");
}

#[test]
fn a_made_capture_is_solved_and_benched_as_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let made = succeed(&[
        "synth",
        "-o",
        &path("made"),
        "--object",
        "sphere",
        "--triangles",
        "4000",
        "--size",
        "96x72",
        "--samples",
        "16",
        "--lamp",
        "-30,50",
        "--lamp",
        "40,35",
        "--noise",
        "1",
        "--quiet",
        "--json",
    ]);
    assert!(String::from_utf8_lossy(&made.stdout).contains("\"views\":6"));
    // Two captures of one name are told apart.
    succeed(&[
        "bench",
        &path("made"),
        &path("made"),
        "-o",
        &path("bench"),
        "--methods",
        "fast",
        "--frequency",
        "20",
    ]);
    let runs = lines(&folder.path().join("bench/runs.csv"));
    let names: Vec<&str> = runs.iter().map(|row| row[0].as_str()).collect();
    assert_eq!(names, ["capture", "made", "made-2"]);
    for name in ["made", "made-2"] {
        let plot = folder.path().join(format!("bench/{name}.svg"));
        assert!(plot.is_file(), "{}", plot.display());
    }
}

#[test]
fn each_photograph_is_predicted_from_the_others_better_by_lights_than_without() {
    let folder = tempfile::tempdir().unwrap();
    small_capture(folder.path(), 5);
    let path = folder.path().to_str().unwrap();
    let run = succeed(&["bench", "--leave-one-out", path, "--quiet", "--json"]);
    let said: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    let views = said["predicted"].as_array().unwrap();
    assert_eq!(views.len(), 5, "{said}");
    for view in views {
        let highlights = |of: &str| view[of]["highlights"].as_f64().unwrap();
        let all = |of: &str| view[of]["all"].as_f64().unwrap();
        assert!(all("predicted") > 35.0, "{view}");
        assert!(all("predicted") > all("diffuse"), "{view}");
        assert!(
            highlights("predicted") > highlights("diffuse") + 6.0,
            "{view}"
        );
    }
    let message = refused(&["bench", "--leave-one-out", path, "-o", path]);
    assert!(message.contains("--output"), "{message}");
}

#[test]
fn a_study_judges_every_case_and_leaves_nothing_but_its_report() {
    let folder = tempfile::tempdir().unwrap();
    let into = folder.path().join("report");
    let study = |only: &str| {
        let into = into.to_str().unwrap();
        ["study", "-o", into, "--only", only, "--quiet"].map(str::to_owned)
    };
    let mut arguments = study("coverage/noise_1,coverage/noise_3").to_vec();
    arguments.extend(["--seeds", "1"].map(str::to_owned));
    let run = rekindle(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let rows = lines(&into.join("coverage.csv"));
    let column = |name: &str| rows[0].iter().position(|n| n == name).unwrap();
    assert_eq!(rows.len(), 1 + 2, "a row for each noise level");
    for row in &rows[1..] {
        assert!(["fine", "degrades"].contains(&row[column("verdict")].as_str()));
        let error: f64 = row[column("sigma_error_pct")].parse().unwrap();
        assert!(error.abs() < 10.0, "{row:?}");
        let seconds = ["total_s", "estimate_s"].map(|s| row[column(s)].parse::<f64>().unwrap());
        assert!(seconds[0] > seconds[1], "a stage takes less than all");
    }
    let text = std::fs::read_to_string(into.join("accuracy.md")).unwrap();
    assert!(text.contains("## Coverage") && !text.contains("## Stability"));
    assert!(!into.join("captures").exists());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);

    let unknown = study("stability/charm");
    let message = refused(&unknown.each_ref().map(String::as_str));
    assert!(
        message.contains("stability/charm") && message.contains("noise"),
        "{message}"
    );
}

/// A sphere under two lamps, as small as it can be.
fn small_capture(folder: &Path, views: u32) -> Capture {
    let mut recipe = Recipe {
        object: Object::Sphere,
        triangles: 2000,
        material: Material::paper(0.12, 0.4),
        truth_pictures: false,
        ..Recipe::default()
    };
    if let Light::Lamps(lamps) = &mut recipe.light {
        lamps.places = Places::Spread(2);
        lamps.contrast = 1.5;
    }
    recipe.views.count = views;
    recipe.views.size = [96, 72];
    recipe.views.supersampling = 1;
    make(&recipe, folder, &mut |_, _| ControlFlow::Continue(())).unwrap();
    Capture::load(folder).unwrap()
}

/// The lamps that are found of two which lie, or are as wide, as `change` says.
fn lamps_of_two(folder: &Path, change: impl FnOnce(&mut Lamps)) -> Vec<SolutionLamp> {
    let mut recipe = Recipe {
        truth_pictures: false,
        ..Recipe::default()
    };
    if let Light::Lamps(lamps) = &mut recipe.light {
        lamps.places = Places::Spread(2);
        change(lamps);
    }
    recipe.views.size = [640, 480];
    recipe.views.supersampling = 1;
    make(&recipe, folder, &mut |_, _| ControlFlow::Continue(())).unwrap();
    let capture = Capture::load(folder).unwrap();
    let options = SolveOptions {
        estimate: EstimateParams::default(),
        frequency: 70,
        radius: None,
        light_frame: None,
    };
    let solution = solve(&capture, &options, 0.0, &mut Unobserved).unwrap();
    solution.lamps
}

#[test]
fn a_lamp_as_wide_as_the_lobe_is_one_and_two_narrow_ones_as_far_apart_are_two() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let wide = lamps_of_two(&path("wide"), |lamps| {
        lamps.angular_radius = 8_f32.to_radians();
    });
    assert_eq!(wide.len(), 2, "{wide:?}");
    for lamp in &wide {
        let radius = lamp.angular_radius.to_degrees();
        assert!((radius - 8.0).abs() < 0.5, "{radius}°");
    }
    let narrow = lamps_of_two(&path("narrow"), |lamps| {
        lamps.angular_radius = 0.5_f32.to_radians();
        lamps.places = Places::Row(2, 8_f32.to_radians());
    });
    assert_eq!(narrow.len(), 2, "{narrow:?}");
    let apart = narrow[0].direction.angle_between(narrow[1].direction);
    assert!((apart.to_degrees() - 8.0).abs() < 0.5, "{apart}");
}

/// Solves a capture with some shortcuts not taken.
fn solve_without(avoided: &[Shortcut], capture: &Capture) -> Solution {
    let options = SolveOptions {
        estimate: EstimateParams {
            avoided: avoided.iter().copied().collect(),
            ..EstimateParams::default()
        },
        frequency: 14,
        radius: None,
        light_frame: None,
    };
    solve(capture, &options, 0.0, &mut Unobserved).unwrap()
}

/// How much a shortcut left out, and of how much.
fn counted(solution: &Solution, shortcut: Shortcut) -> (u64, u64) {
    let mut counts = solution.skipped.left_out.iter();
    let count = counts.find(|count| count.what == shortcut.name()).unwrap();
    (count.left_out, count.all)
}

#[test]
fn a_texture_from_the_best_views_is_as_good_as_one_from_all() {
    let folder = tempfile::tempdir().unwrap();
    let capture = small_capture(&folder.path().join("capture"), 16);
    let usual = solve_without(&[], &capture);
    let whole = solve_without(&[Shortcut::Views], &capture);
    let (left_out, all) = counted(&usual, Shortcut::Views);
    assert!(left_out * 10 > all, "{left_out} of {all}");
    assert_eq!(counted(&whole, Shortcut::Views).0, 0);
    let mean = |solution: &Solution| {
        let fits = &solution.fit.psnr_db_per_view;
        fits.iter().sum::<f32>() / fits.len() as f32
    };
    let loss = mean(&whole) - mean(&usual);
    assert!(loss < 0.5, "views are reproduced worse by {loss} dB");
    // The texture itself, where it is known.
    let (mut change, mut sum) = (0.0_f64, 0.0_f64);
    for texel in &whole.atlas.texels {
        let t = texel.index as usize;
        if whole.confidence[t] > 0.9 && usual.confidence[t] > 0.9 {
            change += f64::from(whole.diffuse[t][1] - usual.diffuse[t][1]).powi(2);
            sum += f64::from(whole.diffuse[t][1]).powi(2);
        }
    }
    let change = (change / sum).sqrt();
    assert!(change < 0.01, "the texture changes by {change}");
}

#[test]
fn what_is_left_out_changes_nothing_to_speak_of() {
    let folder = tempfile::tempdir().unwrap();
    let capture = small_capture(&folder.path().join("capture"), 4);
    let without = |avoided: &[Shortcut]| solve_without(avoided, &capture);
    let angle = |one: &SolutionLamp, other: &SolutionLamp| {
        let (one, other) = (one.direction.as_dvec3(), other.direction.as_dvec3());
        one.angle_between(other)
    };
    let usual = without(&[]);
    // Views are left out of textures, and where there are many.
    let (dark, others) = Shortcut::ALL.split_first().unwrap();
    let (views, others) = others.split_last().unwrap();
    assert_eq!(*views, Shortcut::Views);
    for &shortcut in others.iter().chain([dark]) {
        let (left_out, all) = counted(&usual, shortcut);
        assert!(0 < left_out && left_out < all, "{shortcut:?}: {left_out}");
    }
    for avoided in [&[*dark][..], others] {
        let whole = without(avoided);
        for &shortcut in avoided {
            assert_eq!(counted(&whole, shortcut).0, 0, "{shortcut:?}");
        }
        let sigma = |solution: &Solution| solution.brdf.unwrap().sigma;
        let change = sigma(&whole) / sigma(&usual) - 1.0;
        assert!(change.abs() < 2e-4, "{avoided:?}: σ changes by {change}");
        // Both lamps; what may be found of dim light beside them is not looked at.
        let pairs: Vec<_> = usual.lamps[..2]
            .iter()
            .map(|lamp| {
                let away = |other: &&SolutionLamp| angle(lamp, other);
                let nearest = whole.lamps.iter();
                let nearest = nearest.min_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
                (lamp, nearest)
            })
            .collect();
        for (lamp, nearest) in &pairs {
            let off = angle(lamp, nearest).to_degrees();
            assert!(off < 0.05, "{avoided:?}: a lamp is off by {off}°");
        }
        let ratio = |(lamp, nearest): &(&SolutionLamp, &SolutionLamp)| {
            nearest.flux.element_sum() / lamp.flux.element_sum()
        };
        let change = ratio(&pairs[0]) / ratio(&pairs[1]) - 1.0;
        assert!(change.abs() < 5e-3, "{avoided:?}: fluxes by {change}");
    }
}

#[test]
fn an_unbounded_solve_is_refused() {
    let source = capture();
    let solve = ["solve", source.to_str().unwrap(), "-o", "out"];
    let message = refused(&[&solve[..], &["--do-all", "dark-cells"]].concat());
    assert!(message.contains("--frequency 20"), "{message}");
}
