//! What the program promises on the command line, checked on a capture with known truth.

use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::command::{rekindle, succeed};
use rekindle_capture::read_radiance;
use serde_json::{Value, json};

fn capture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/captures")
        .join(name)
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn vector(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|k| value[k].as_f64().unwrap())
}

fn angle_deg(a: [f64; 3], b: [f64; 3]) -> f64 {
    let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    (dot(a, b) / (dot(a, a) * dot(b, b)).sqrt())
        .clamp(-1.0, 1.0)
        .acos()
        .to_degrees()
}

/// Solves a capture, checks roughness and lamps against its truth, and returns the folder of the solution.
fn solve_and_check(name: &str, folder: &Path) -> PathBuf {
    solve_and_check_at(&capture(name), folder)
}

/// [`solve_and_check`] of a capture anywhere.
fn solve_and_check_at(source: &Path, folder: &Path) -> PathBuf {
    let name = source.display();
    let solution = folder.join("solution");
    succeed(&[
        "solve",
        source.to_str().unwrap(),
        "-o",
        solution.to_str().unwrap(),
        "--quiet",
    ]);
    let found = read_json(&solution.join("solution.json"));
    let truth = read_json(&source.join("truth/truth.json"));
    let material = &truth["material"];
    let sigma = material["sigma"]
        .as_f64()
        .unwrap_or_else(|| material["microfacet_alpha"].as_f64().unwrap() / 2.0_f64.sqrt());
    let error = found["sigma"].as_f64().unwrap() / sigma - 1.0;
    assert!(error.abs() < 0.01, "{name}: sigma is off by {error}");

    let lamps = truth["lights"].as_array().unwrap();
    let lights = found["lights"].as_array().unwrap();
    assert_eq!(lights.len(), lamps.len(), "{name}: number of lamps");
    let mut ratios = Vec::new();
    for lamp in lamps {
        let direction = vector(&lamp["direction"]);
        let nearest = lights
            .iter()
            .min_by(|a, b| {
                let to = |l: &Value| angle_deg(vector(&l["direction"]), direction);
                to(a).total_cmp(&to(b))
            })
            .unwrap();
        let off = angle_deg(vector(&nearest["direction"]), direction);
        assert!(off < 0.2, "{name}: a lamp is off by {off}°");
        let flux: f64 =
            vector(&lamp["radiance"]).iter().sum::<f64>() * lamp["solid_angle"].as_f64().unwrap();
        ratios.push(vector(&nearest["flux"]).iter().sum::<f64>() / flux);
    }
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    for ratio in ratios {
        let error = ratio / mean - 1.0;
        assert!(error.abs() < 0.015, "{name}: a flux is off by {error}");
    }
    solution
}

/// A copy of a `transforms.json` whose cameras are moved.
fn move_cameras(from: &Path, to: &Path, by: [f64; 3]) {
    let mut manifest = read_json(from);
    for frame in manifest["frames"].as_array_mut().unwrap() {
        for (row, by) in by.into_iter().enumerate() {
            let value = &mut frame["transform_matrix"][row][3];
            *value = json!(value.as_f64().unwrap() + by);
        }
    }
    std::fs::write(to, manifest.to_string()).unwrap();
}

/// A copy of an OBJ file whose vertices are moved.
fn move_mesh(from: &Path, to: &Path, by: [f64; 3]) {
    let mut moved = String::new();
    for line in std::fs::read_to_string(from).unwrap().lines() {
        match line.strip_prefix("v ") {
            Some(numbers) => {
                moved += "v";
                for (word, by) in numbers.split_whitespace().zip(by) {
                    let value: f64 = word.parse().unwrap();
                    let _ = write!(moved, " {:.9}", value + by);
                }
            }
            None => moved += line,
        }
        moved.push('\n');
    }
    std::fs::write(to, moved).unwrap();
}

/// Mean difference of two pictures as a part of the first's mean.
fn difference(a: &Path, b: &Path) -> f64 {
    let [a, b] = [a, b].map(|path| read_radiance(path).unwrap().2);
    let sum = |values: &mut dyn Iterator<Item = f32>| values.map(f64::from).sum::<f64>();
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    sum(&mut pairs.map(|(a, b)| (a - b).abs())) / sum(&mut a.iter().flatten().copied())
}

#[test]
fn surveyed_coordinates_lose_nothing() {
    let by = [431_000.0, -5_403_000.0, 260.0];
    let folder = tempfile::tempdir().unwrap();
    let (near, far) = (capture("spot_paper"), folder.path().join("far"));
    std::fs::create_dir_all(far.join("images")).unwrap();
    std::fs::create_dir_all(far.join("truth")).unwrap();
    for image in std::fs::read_dir(near.join("images")).unwrap() {
        let image = image.unwrap();
        std::fs::copy(image.path(), far.join("images").join(image.file_name())).unwrap();
    }
    std::fs::copy(near.join("truth/truth.json"), far.join("truth/truth.json")).unwrap();
    let [near_cameras, far_cameras] = [&near, &far].map(|capture| capture.join("transforms.json"));
    move_cameras(&near_cameras, &far_cameras, by);
    move_mesh(&near.join("mesh.obj"), &far.join("mesh.obj"), by);
    let solutions = [(&near, "a"), (&far, "b")]
        .map(|(source, name)| solve_and_check_at(source, &folder.path().join(name)));
    // The far solution is in the far world, and looks the same from there.
    let stored = read_json(&solutions[1].join("cameras.json"));
    let stated = read_json(&far_cameras);
    let place = |file: &Value| {
        file["frames"][0]["transform_matrix"][1][3]
            .as_f64()
            .unwrap()
    };
    assert!((place(&stored) - place(&stated)).abs() < 1e-6);
    let pictures =
        [(&solutions[0], near_cameras), (&solutions[1], far_cameras)].map(|(solution, cameras)| {
            let pictures = solution.with_extension("pictures");
            let paths = [solution, &cameras, &pictures].map(|path| path.to_str().unwrap());
            succeed(&[
                "render",
                paths[0],
                "--cameras",
                paths[1],
                "-o",
                paths[2],
                "--quiet",
            ]);
            pictures.join("view_000.exr")
        });
    let off = difference(&pictures[0], &pictures[1]);
    assert!(off < 1e-3, "the picture differs by {off} of its mean");
}

#[test]
fn recovers_the_papers_surface_and_renders_edits() {
    let folder = tempfile::tempdir().unwrap();
    let solution = solve_and_check("spot_paper", folder.path());
    // A solution opens elsewhere, without the capture.
    let moved = folder.path().join("elsewhere");
    std::fs::rename(&solution, &moved).unwrap();
    let cameras = capture("spot_paper").join("truth/novel/transforms.json");
    let edits = folder.path().join("edits.json");
    std::fs::write(&edits, r#"[{"mute": {"near": [0, 1, 0]}}]"#).unwrap();
    let pictures = folder.path().join("pictures");
    succeed(&[
        "render",
        moved.to_str().unwrap(),
        "--cameras",
        cameras.to_str().unwrap(),
        "--edits",
        edits.to_str().unwrap(),
        "-o",
        pictures.to_str().unwrap(),
        "--layers",
        "--quiet",
    ]);
    for ending in ["exr", "png", "diffuse.exr", "specular.exr"] {
        let path = pictures.join(format!("view_000.{ending}"));
        assert!(path.exists(), "{} is missing", path.display());
    }

    std::fs::write(&edits, r#"[{"dim": {}}]"#).unwrap();
    let refused = folder.path().join("refused");
    let run = rekindle(&[
        "render",
        moved.to_str().unwrap(),
        "--cameras",
        cameras.to_str().unwrap(),
        "--edits",
        edits.to_str().unwrap(),
        "-o",
        refused.to_str().unwrap(),
    ]);
    let message = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(2), "{message}");
    for known in ["mute", "solo", "gain", "move", "add", "delete"] {
        assert!(message.contains(known), "{message} does not name {known}");
    }
    assert!(!refused.exists(), "nothing may be written");
}

#[test]
fn recovers_a_plastic_with_interreflections_and_noise() {
    let folder = tempfile::tempdir().unwrap();
    let solution = solve_and_check("spot_plastic", folder.path());
    let found = read_json(&solution.join("solution.json"));
    assert!(
        found["specular_model"] == "beckmann",
        "the solution states the model that the data chose"
    );
}

/// A Beckmann lobe on such a surface takes its tails for lights.
#[test]
fn recovers_a_ggx_surface_without_false_lights() {
    let folder = tempfile::tempdir().unwrap();
    let (source, solution) = (capture("spot_ggx"), folder.path().join("solution"));
    let [from, into] = [&source, &solution].map(|path| path.to_str().unwrap());
    succeed(&["solve", from, "-o", into, "--quiet"]);
    let found = read_json(&solution.join("solution.json"));
    let truth = read_json(&source.join("truth/truth.json"));
    assert_eq!(found["specular_model"], "ggx");
    let flux = |light: &Value| vector(&light["flux"]).iter().sum::<f64>();
    let lights = found["lights"].as_array().unwrap();
    let all: f64 = lights.iter().map(flux).sum();
    let near = |lamp: &Value| -> f64 {
        let direction = vector(&lamp["direction"]);
        let near = |light: &&Value| angle_deg(vector(&light["direction"]), direction) < 0.5;
        lights.iter().filter(near).map(flux).sum()
    };
    let lamps = truth["lights"].as_array().unwrap();
    let true_flux = lamps.iter().map(near).sum::<f64>();
    assert!(true_flux > 0.97 * all, "{true_flux} of {all} in the lamps");
}

#[test]
fn recovers_lamps_at_finite_distance() {
    let folder = tempfile::tempdir().unwrap();
    solve_and_check("spot_near", folder.path());
}

/// Everything in a solution's folder but how long things took.
fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = std::fs::read_dir(folder).unwrap();
    let files = entries.map(|entry| entry.unwrap().path());
    let mut contents: Vec<_> = files
        .filter(|path| path.is_file() && !path.ends_with("solution.json"))
        .map(|path| {
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            (name, std::fs::read(&path).unwrap())
        })
        .collect();
    contents.sort();
    contents
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let folder = tempfile::tempdir().unwrap();
    let source = capture("spot_plastic");
    let solve = |threads: &str| {
        let solution = folder.path().join(threads);
        let run = rekindle(&[
            "solve",
            source.to_str().unwrap(),
            "-o",
            solution.to_str().unwrap(),
            "--frequency",
            "20",
            "--threads",
            threads,
        ]);
        assert!(run.status.success());
        let found = read_json(&solution.join("solution.json"));
        let numbers = ["sigma", "sigma_interval95", "lights", "ambient", "fit"];
        (numbers.map(|key| found[key].clone()), contents(&solution))
    };
    let (numbers, files) = solve("1");
    let (numbers_of_three, files_of_three) = solve("3");
    assert_eq!(numbers, numbers_of_three);
    for ((name, one), (_, three)) in files.iter().zip(&files_of_three) {
        assert!(one == three, "{name} differs");
    }
    assert!(files.len() >= 7, "the textures, the mesh and the light");
}

#[test]
fn a_stated_roughness_is_taken_and_nonsense_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let solution = folder.path().join("solution");
    let solution = solution.to_str().unwrap();
    let source = capture("spot_uniform");
    let source = source.to_str().unwrap();
    let solve = |more: &[&str]| rekindle(&[&["solve", source, "-o", solution][..], more].concat());
    for (more, said) in [
        (&["--roughness", "2"][..], "0.07 to 0.9"),
        (&["--roughness", "rough"], "0.07 to 0.9"),
        (
            &["--roughness", "0.3", "--method", "amuh"],
            "reference methods",
        ),
    ] {
        let run = solve(more);
        assert_eq!(run.status.code(), Some(2), "{more:?}");
        let message = String::from_utf8_lossy(&run.stderr);
        assert!(message.contains(said), "{message}");
    }
    assert!(
        solve(&["--frequency", "20", "--roughness", "0.5"])
            .status
            .success()
    );
    let found = read_json(&Path::new(solution).join("solution.json"));
    // α is the square of the roughness, and √2 σ.
    let sigma = found["sigma"].as_f64().unwrap();
    assert!((sigma - 0.25 / 2.0_f64.sqrt()).abs() < 1e-5, "{sigma}");
    assert!(found["sigma_interval95"].is_null(), "nothing was estimated");
}

#[test]
fn a_given_light_is_taken_as_it_is_turned_and_nonsense_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let solution = folder.path().join("solution");
    let solution = solution.to_str().unwrap();
    let source = capture("spot_paper");
    let light = source.join("truth/environment.exr");
    let photograph = source.join("images/view_000.exr");
    let [source, light, photograph] = [&source, &light, &photograph].map(|p| p.to_str().unwrap());
    let solve = |more: &[&str]| rekindle(&[&["solve", source, "-o", solution][..], more].concat());
    for (more, said) in [
        (&["--light-rotation", "90"][..], "--light <PROBE>"),
        (
            &["--light", light, "--light-rotation", "east"],
            "number of degrees",
        ),
        (
            &["--light", light, "--method", "amuh"],
            "reference methods estimate the light",
        ),
        (
            &["--light", light, "--light-frame", "camera"],
            "lights stand still with the camera",
        ),
        (&["--light", photograph], "twice as wide as high"),
        (&["--light", "no/such/probe.exr"], "no/such/probe.exr"),
    ] {
        let run = solve(more);
        assert_eq!(run.status.code(), Some(2), "{more:?}");
        let message = String::from_utf8_lossy(&run.stderr);
        assert!(message.contains(said), "{message}");
        assert!(!Path::new(solution).exists(), "nothing is written");
    }
    let given = ["--frequency", "20", "--light", light, "--light-rotation"];
    assert!(solve(&[&given[..], &["-90"]].concat()).status.success());
    let found = read_json(&Path::new(solution).join("solution.json"));
    assert_eq!(found["known_light"]["rotation_deg"], 270.0);
    assert_eq!(found["known_light"]["rotation_stated"], true);
    // No light beside the given one is made up.
    assert_eq!(vector(&found["ambient"]), [0.0; 3]);
}

#[test]
fn a_missing_capture_is_one_message_and_status_2() {
    let folder = tempfile::tempdir().unwrap();
    let solution = folder.path().join("solution");
    let run = rekindle(&[
        "solve",
        "no/such/folder",
        "-o",
        solution.to_str().unwrap(),
        "--quiet",
    ]);
    assert_eq!(run.status.code(), Some(2));
    let message = String::from_utf8_lossy(&run.stderr);
    assert!(message.contains("no/such/folder"), "{message}");
    assert_eq!(message.trim().lines().count(), 1, "{message}");
    assert!(!solution.exists(), "nothing may be written");
}

/// Runs the program, presses Ctrl-C once it says `moment`, and returns its exit status.
#[cfg(unix)]
fn interrupt_at(moment: &str, arguments: &[&str]) -> Option<i32> {
    let mut program = Command::new(env!("CARGO_BIN_EXE_rekindle"))
        .args(arguments)
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let said = BufReader::new(program.stderr.take().unwrap());
    let mut lines = said.lines().map_while(Result::ok);
    assert!(lines.any(|line| line.starts_with(moment)), "no {moment}");
    let pressed = Command::new("kill")
        .args(["-INT", &program.id().to_string()])
        .status();
    assert!(pressed.unwrap().success(), "the program has ended before");
    // Its output must be read to the end, or it would wait.
    lines.for_each(drop);
    program.wait().unwrap().code()
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_nothing_at_any_moment() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let source = capture("spot_paper");
    let source = source.to_str().unwrap();
    let nothing_new = |moment: &str, expected: &[&str]| {
        let mut found: Vec<String> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        found.sort();
        assert_eq!(found, expected, "after Ctrl-C while {moment}");
    };
    for moment in [
        "reading the capture",
        "finding what each view sees",
        "collecting highlights",
        "estimating roughness",
        "reconstructing the texture",
        "separating texture and shading",
        "writing the solution",
    ] {
        let arguments = ["solve", source, "-o", &path("deep/solution")];
        let arguments = [&arguments[..], &["--frequency", "20"]].concat();
        assert_eq!(interrupt_at(moment, &arguments), Some(130), "{moment}");
        nothing_new(moment, &[]);
    }
    let solution = path("solution");
    let run = rekindle(&["solve", source, "-o", &solution, "--frequency", "20"]);
    assert!(run.status.success());
    let cameras = format!("{source}/truth/novel/transforms.json");
    for moment in ["reading the solution", "rendering view_000"] {
        let pictures = path("pictures");
        let arguments = ["render", &solution, "--cameras", &cameras, "-o", &pictures];
        assert_eq!(interrupt_at(moment, &arguments), Some(130), "{moment}");
        nothing_new(moment, &["solution"]);
    }
    // An earlier solution survives the interrupted writing of its successor.
    let again = ["--frequency", "20", "--do-all", "unchanged"];
    let arguments = [&["solve", source, "-o", &solution], &again[..]].concat();
    let status = interrupt_at("writing the solution", &arguments);
    assert_eq!(status, Some(130));
    nothing_new("writing the solution anew", &["solution"]);
    assert!(rekindle(&["info", &solution]).status.success());
}

/// Ended from outside at any moment, the program says so by its status and leaves nothing.
#[cfg(unix)]
#[test]
fn terminated_renders_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let source = capture("spot_paper");
    let source = source.to_str().unwrap();
    let solution = path("solution");
    let run = rekindle(&["solve", source, "-o", &solution, "--frequency", "20"]);
    assert!(run.status.success());
    let cameras = format!("{source}/truth/novel/transforms.json");
    let pictures = path("pictures");
    let mut ended_early = 0;
    for moment in 0..30 {
        let mut program = Command::new(env!("CARGO_BIN_EXE_rekindle"))
            .args(["render", &solution, "--cameras", &cameras, "-o", &pictures])
            .arg("--layers")
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(program.stderr.take().unwrap()).lines();
        let mut lines = lines.map_while(Result::ok);
        lines.next();
        std::thread::sleep(std::time::Duration::from_millis(7 * moment));
        let id = program.id().to_string();
        let _ = Command::new("kill").args(["-TERM", &id]).status();
        let said: Vec<String> = lines.collect();
        let status = program.wait().unwrap().code();
        if status == Some(0) {
            std::fs::remove_dir_all(&pictures).unwrap();
        } else {
            ended_early += 1;
            assert_eq!(status, Some(130), "{said:?}");
            // The signal may have come when all pictures were in their place.
            if let Ok(made) = std::fs::read_dir(&pictures) {
                let made: Vec<_> = made.map(|entry| entry.unwrap().file_name()).collect();
                assert_eq!(made.len() % 4, 0, "some of the pictures only: {made:?}");
                std::fs::remove_dir_all(&pictures).unwrap();
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
    assert!(ended_early > 0, "no render was ended");
}

/// A reader that goes away and a device that is full cost the messages, not the result.
#[cfg(target_os = "linux")]
#[test]
fn results_do_not_depend_on_who_listens() {
    let folder = tempfile::tempdir().unwrap();
    let source = capture("spot_paper");
    for (name, redirection) in [
        ("nobody", "2>&1 | true"),
        ("full", "2>/dev/full"),
        ("full_json", "--json >/dev/full 2>&1"),
    ] {
        let solution = folder.path().join(name);
        let script = format!("\"$0\" solve \"$1\" -o \"$2\" --frequency 20 {redirection}");
        let run = Command::new("sh")
            .args(["-c", &script, env!("CARGO_BIN_EXE_rekindle")])
            .args([&source, &solution])
            .status()
            .unwrap();
        assert!(run.success(), "{name}: {run}");
        let written = solution.join("solution.json");
        assert!(written.is_file(), "{name}: the solution was lost");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn paths_may_hold_any_bytes() {
    use std::os::unix::ffi::OsStrExt as _;
    let folder = tempfile::tempdir().unwrap();
    let odd = |name: &[u8]| folder.path().join(std::ffi::OsStr::from_bytes(name));
    let source = capture("spot_paper");
    let program = |name: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rekindle"));
        command.args([name, "--json", "--quiet"]);
        command
    };
    let solution = odd(b"solution\xff");
    let solve = program("solve")
        .args(["--frequency", "20"])
        .arg(&source)
        .arg("-o")
        .arg(&solution)
        .output();
    assert_eq!(solve.unwrap().status.code(), Some(0));
    let render = program("render")
        .arg(&solution)
        .arg("--cameras")
        .arg(source.join("transforms.json"))
        .arg("-o")
        .arg(odd(b"pictures\xfe"))
        .output()
        .unwrap();
    assert_eq!(render.status.code(), Some(0));
    let printed: Value = serde_json::from_slice(&render.stdout).unwrap();
    assert_eq!(printed["pictures"].as_array().unwrap().len(), 12);
    let export = program("export")
        .args(["--for", "light", "--size", "64"])
        .arg(&solution)
        .arg("-o")
        .arg(odd(b"files\xfd"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&export.stderr);
    assert_eq!(export.status.code(), Some(0), "{said}");
}

#[test]
fn what_has_not_changed_is_not_solved_again() {
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("capture");
    std::fs::create_dir_all(own.join("images")).unwrap();
    for part in ["", "images"] {
        for (file, bytes) in contents(&capture("spot_paper").join(part)) {
            std::fs::write(own.join(part).join(file), bytes).unwrap();
        }
    }
    let solution = folder.path().join("solution");
    let is_kept = |more: &[&str]| {
        let paths = [own.to_str().unwrap(), "-o", solution.to_str().unwrap()];
        let run = rekindle(&[&["solve", "--json", "--frequency", "30"], &paths[..], more].concat());
        let message = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "{message}");
        let summary: Value = serde_json::from_slice(&run.stdout).unwrap();
        assert!(summary["sigma"].as_f64().unwrap() > 0.0);
        summary["unchanged"].as_bool().unwrap()
    };
    assert!(!is_kept(&[]), "there is none yet");
    let written = || {
        let manifest = std::fs::metadata(solution.join("solution.json")).unwrap();
        manifest.modified().unwrap()
    };
    let first = written();
    assert!(is_kept(&[]));
    assert_eq!(written(), first, "nothing is written");

    assert!(!is_kept(&["--do-all", "unchanged"]), "asked for");
    assert!(!is_kept(&["--specular", "paper"]), "other options");
    assert!(!is_kept(&[]), "the options before");

    let damaged = solution.join("diffuse.exr");
    let bytes = std::fs::read(&damaged).unwrap();
    std::fs::write(&damaged, &bytes[..bytes.len() / 2]).unwrap();
    assert!(!is_kept(&[]), "a damaged solution is no solution");

    let manifest = own.join("transforms.json");
    let mut cameras = read_json(&manifest);
    let height = &mut cameras["frames"][0]["transform_matrix"][1][3];
    *height = (height.as_f64().unwrap() + 1e-5).into();
    std::fs::write(&manifest, cameras.to_string()).unwrap();
    assert!(!is_kept(&[]), "a camera was moved");
}
