//! Every bad input ends in exit status 2 with one message that names what is wrong, and nothing is written.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;

use rekindle_capture::Capture;
use serde_json::{Value, json};

/// A capture that may be spoilt, in a folder of its own.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let bench = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures/spot_paper");
        fs::create_dir_all(bench.path("capture/images")).unwrap();
        let images = (0..6).map(|i| format!("images/view_{i:03}.exr"));
        for name in images.chain(["mesh.obj", "transforms.json"].map(str::to_owned)) {
            fs::copy(source.join(&name), bench.path("capture").join(&name)).unwrap();
        }
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(name), content).unwrap();
    }

    fn change_manifest(&self, change: impl Fn(&mut Value)) {
        let path = self.path("capture/transforms.json");
        let mut manifest: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        change(&mut manifest);
        fs::write(path, manifest.to_string()).unwrap();
    }

    fn change_mesh(&self, change: impl Fn(&str) -> String) {
        let path = self.path("capture/mesh.obj");
        let text = fs::read_to_string(&path).unwrap();
        fs::write(path, change(&text)).unwrap();
    }

    /// Replaces a picture by one of a single colour.
    fn fill_picture(&self, name: &str, value: f32) {
        exr::prelude::write_rgb_file(self.path(name), 320, 240, |_, _| (value, value, value))
            .unwrap();
    }

    /// A solution, quickly solved.
    fn solve(&self) {
        let run = self.run(&["solve", "capture", "-o", "solution", "--frequency", "20"]);
        assert!(run.status.success());
    }

    fn run(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_rekindle"))
            .args(arguments)
            .arg("--quiet")
            .current_dir(self.folder.path())
            .output()
            .unwrap()
    }

    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(self.folder.path()).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// Checks that a command is refused with one line that has all `parts`, and leaves no trace.
    fn refuses(&self, arguments: &[&str], parts: &[&str]) {
        let before = self.names();
        let run = self.run(arguments);
        check_refusal(&run, parts);
        assert_eq!(self.names(), before, "nothing may be written");
    }

    fn refuses_solve(&self, parts: &[&str]) {
        self.refuses(&["solve", "capture", "-o", "made/solution"], parts);
    }

    fn refuses_edits(&self, edits: &str, parts: &[&str]) {
        self.write("edits.json", edits);
        let cameras = "capture/transforms.json";
        let arguments = ["render", "solution", "--cameras", cameras, "-o", "pictures"];
        let arguments = [&arguments[..], &["--edits", "edits.json"]].concat();
        self.refuses(&arguments, parts);
    }
}

fn check_refusal(run: &Output, parts: &[&str]) {
    let message = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(2), "{message}");
    assert_eq!(message.trim().lines().count(), 1, "{message}");
    assert!(run.stdout.is_empty(), "stdout is for results");
    for part in parts {
        assert!(message.contains(part), "{message} lacks {part}");
    }
}

#[test]
fn manifests() {
    let bench = Bench::new();
    bench.refuses(&["solve", "no/such", "-o", "out"], &["no/such: no such"]);
    bench.write("capture/transforms.json", "{\n  \"frames\": [}\n");
    bench.refuses_solve(&["transforms.json: line 2, column 14"]);

    let bench = Bench::new();
    bench.change_manifest(|m| {
        m["frames"][2]
            .as_object_mut()
            .unwrap()
            .remove("transform_matrix");
    });
    bench.refuses_solve(&["transforms.json: frames[2].transform_matrix is missing"]);
    bench.change_manifest(|m| {
        m["frames"][2]["transform_matrix"] =
            json!([[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    });
    bench.refuses_solve(&["frames[2].transform_matrix is singular"]);
    let path = bench.path("capture/transforms.json");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replacen("[1,0,0,0]", "[NaN,0,0,0]", 1)).unwrap();
    bench.refuses_solve(&["frames[2].transform_matrix is NaN or not finite in row 1, column 1"]);
}

#[test]
fn images() {
    const PICTURE: &str = "capture/images/view_003.exr";
    let bench = Bench::new();
    let whole = fs::read(bench.path(PICTURE)).unwrap();
    fs::remove_file(bench.path(PICTURE)).unwrap();
    bench.refuses_solve(&["view_003.exr: no such image", "frames[3].file_path"]);
    bench.write(PICTURE, &whole[..whole.len() / 2]);
    bench.refuses_solve(&["view_003.exr: the image cannot be decoded"]);
    bench.fill_picture(PICTURE, 0.0);
    bench.refuses_solve(&["view_003.exr", "black"]);
    bench.fill_picture(PICTURE, f32::NAN);
    bench.refuses_solve(&["view_003.exr", "not finite"]);
    let gray = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/capture/luminance.exr");
    fs::copy(gray, bench.path(PICTURE)).unwrap();
    bench.refuses_solve(&["view_003.exr", "no R, G and B"]);
    bench.write(PICTURE, &whole);
    bench.change_manifest(|m| m["w"] = json!(321));
    bench.refuses_solve(&["is 320×240 pixels", "transforms.json says 321×240"]);
}

#[test]
fn points_to_align_by() {
    let bench = Bench::new();
    let refuses = |text: &str, parts: &[&str]| {
        bench.write("points.json", text);
        let arguments = ["align", "capture", "--points", "points.json"];
        bench.refuses(&arguments, parts);
    };
    refuses("[{]", &["points.json: line 1, column 3: broken JSON"]);
    refuses("{}", &["points.json: the file is not a list of points"]);
    refuses(
        r#"[{"mesh": [0, 1]}]"#,
        &["points.json: [0].mesh is missing or not 3 numbers"],
    );
    refuses(
        r#"[{"mesh": [0, 1, 2], "marks": [3, 4]}]"#,
        &["[0].marks is missing or no list of marks"],
    );
    refuses(
        r#"[{"mesh": [0, 1, 2], "marks": {"front.exr": [3, 4]}}]"#,
        &[
            "[0].marks.front.exr is no photograph",
            "images/view_000.exr",
        ],
    );
    refuses(
        r#"[{"mesh": [0, 1, 2], "marks": {"images/view_001.exr": [3, 4000]}}]"#,
        &["[0].marks.images/view_001.exr is outside the photograph"],
    );
    refuses("[]", &["points.json: no point is marked"]);
    let arguments = ["align", "capture", "--points", "nowhere.json"];
    bench.refuses(&arguments, &["nowhere.json: cannot be read"]);
}

#[test]
fn meshes() {
    let bench = Bench::new();
    let path = bench.path("capture/mesh.obj");
    let whole = fs::read_to_string(&path).unwrap();
    fs::remove_file(&path).unwrap();
    bench.refuses_solve(&["mesh.obj: no such mesh", "mesh_path"]);
    bench.write("capture/mesh.obj", "");
    bench.refuses_solve(&["mesh.obj: the mesh is empty"]);
    fs::write(&path, &whole).unwrap();
    bench.change_mesh(|text| text.to_owned() + "f 1 2 99999\n");
    let last = format!("line {}", whole.lines().count() + 1);
    bench.refuses_solve(&["mesh.obj", &last, "index 99999 is out of range"]);
    fs::write(&path, &whole).unwrap();
    bench.change_mesh(|text| text.replacen("\nv ", "\nv nan ", 1));
    bench.refuses_solve(&["mesh.obj: line 3: the vertex is NaN"]);
    fs::write(&path, &whole).unwrap();
    // Each vertex far to the side.
    bench.change_mesh(|text| text.replace("\nv ", "\nv 1e4 "));
    bench.refuses_solve(&["mesh.obj: no camera sees the mesh"]);
}

#[test]
fn solutions_and_edits() {
    let bench = Bench::new();
    bench.solve();
    bench.refuses_edits(
        r#"[{"mute": {"near": [0, 1, 0]}}, {"blur": {}}]"#,
        &["edits.json: edit 1", "\"blur\"", "mute, solo, gain, move"],
    );
    bench.refuses_edits("[{\"mute\"\n: }]", &["edits.json", "line 2 column 3"]);
    bench.refuses_edits(r#"[{"mute": {"far": [0, 1, 0]}}]"#, &["`far`", "`near`"]);
    bench.refuses_edits(
        r#"[{"environment": {"file": "no.hdr"}}]"#,
        &["edits.json: edit 0", "no.hdr: no such image"],
    );
    let cameras = "capture/transforms.json";
    let render = |solution| ["render", solution, "--cameras", cameras, "-o", "pictures"];
    bench.refuses(&render("capture"), &["capture: no solution here"]);
    let missing = [
        "render",
        "solution",
        "--cameras",
        "no.json",
        "-o",
        "pictures",
    ];
    bench.refuses(&missing, &["no.json: no such file"]);

    let path = bench.path("solution/solution.json");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("\"version\": 1", "\"version\": 9")).unwrap();
    bench.refuses(&render("solution"), &["newer rekindle (version 9"]);
    fs::write(&path, &text[..text.len() / 2]).unwrap();
    bench.refuses(
        &render("solution"),
        &["solution.json: not a valid solution"],
    );
    bench.refuses(
        &["info", "solution"],
        &["solution.json: not a valid solution"],
    );
}

#[test]
fn destinations() {
    let bench = Bench::new();
    bench.solve();
    bench.write("thesis.tex", "x");
    let solve = |output| ["solve", "capture", "-o", output];
    bench.refuses(&solve("thesis.tex"), &["thesis.tex: can't be written"]);
    bench.refuses(&solve("thesis.tex/a/b"), &["thesis.tex is not a folder"]);
    bench.refuses(
        &solve("capture"),
        &["capture: capture/transforms.json is read and would be lost"],
    );
    let cameras = "capture/transforms.json";
    let render = |output| ["render", "solution", "--cameras", cameras, "-o", output];
    bench.refuses(&render("thesis.tex"), &["thesis.tex: is not a folder"]);
    bench.refuses(&render("thesis.tex/a"), &["thesis.tex/a: can't be written"]);
}

#[test]
fn what_others_put_there_is_never_lost() {
    let bench = Bench::new();
    bench.solve();
    let again = ["--frequency", "20", "--do-all", "unchanged"];
    let solve = |output| [&["solve", "capture", "-o", output], &again[..]].concat();
    fs::create_dir(bench.path("solution/paintings")).unwrap();
    bench.write("solution/notes.txt", "x");
    let told = ["solution: holds notes.txt, paintings, which"];
    bench.refuses(&solve("solution"), &told);
    assert!(bench.path("solution/notes.txt").exists());
    assert!(bench.path("solution/paintings").exists());
    fs::create_dir(bench.path("chemistry")).unwrap();
    bench.write("chemistry/solution.json", "{\"acid\": 1}");
    let foreign = ["chemistry: exists and is not a solution"];
    bench.refuses(&solve("chemistry"), &foreign);
    // A truth from elsewhere does not make a capture one of ours.
    fs::create_dir(bench.path("capture/truth")).unwrap();
    bench.write("capture/truth/truth.json", "{}");
    let synth = ["synth", "-o", "capture", "--views", "2", "--size", "32x24"];
    bench.refuses(&synth, &["capture: exists and is not a capture that"]);
    assert!(bench.path("capture/images/view_005.exr").exists());
}

#[test]
fn pictures_of_others_are_never_replaced() {
    let bench = Bench::new();
    bench.solve();
    let render = [
        "render",
        "solution",
        "--cameras",
        "capture/transforms.json",
        "-o",
        "made",
    ];
    let export = ["export", "solution", "-o", "made"];
    // Of some files it is known before the work that others wrote them, of some only after it.
    for (arguments, file, is_early) in [
        (&render[..], "view_003.png", true),
        (&export[..], "object.glb", false),
        (&export[..], "light.hdr", false),
        (&export[..], "lights.csv", false),
    ] {
        fs::create_dir_all(bench.path("made")).unwrap();
        let path = bench.path("made").join(file);
        fs::write(&path, "painted for a week").unwrap();
        let parts = [file, "did not write"];
        if is_early {
            bench.refuses(arguments, &parts);
        } else {
            check_refusal(
                &bench.run(arguments),
                &[&parts[..], &["what was made is in", "made-2"]].concat(),
            );
            assert!(bench.path("made-2").join(file).is_file());
            fs::remove_dir_all(bench.path("made-2")).unwrap();
        }
        assert_eq!(fs::read_to_string(path).unwrap(), "painted for a week");
        assert_eq!(fs::read_dir(bench.path("made")).unwrap().count(), 1);
        fs::remove_dir_all(bench.path("made")).unwrap();
    }
    // What the program wrote there, it writes anew.
    for arguments in [&render[..], &export, &render, &export] {
        let run = bench.run(arguments);
        assert!(
            run.status.success(),
            "{}",
            String::from_utf8_lossy(&run.stderr)
        );
    }
}

#[test]
fn what_is_read_is_never_lost() {
    let bench = Bench::new();
    bench.solve();
    let solve = |output| ["solve", "capture", "-o", output];
    let manifest = ["transforms.json is read and would be lost"];
    bench.refuses(&solve("solution/../capture"), &manifest);
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("capture", bench.path("link")).unwrap();
        bench.refuses(&solve("link"), &manifest);
        bench.refuses(&["solve", "link", "-o", "capture"], &manifest);
    }
    let inner = bench.path("solution/capture");
    fs::rename(bench.path("capture"), &inner).unwrap();
    bench.refuses(&["solve", "solution/capture", "-o", "solution"], &manifest);
    fs::rename(&inner, bench.path("capture")).unwrap();

    let cameras = "capture/transforms.json";
    let render = |output| ["render", "solution", "--cameras", cameras, "-o", output];
    let photograph = ["capture/images/view_000.exr is read and would be lost"];
    bench.refuses(&render("capture/images"), &photograph);
    bench.refuses(&render("solution"), &["solution: is the solution itself"]);
    bench.refuses(&["export", "solution", "-o", "solution"], &["solution: is"]);
    let align = ["align", "capture", "-o", "capture/mesh.obj", "--from-here"];
    bench.refuses(&align, &["capture/mesh.obj is read and would be lost"]);
    bench.change_manifest(|m| m["mesh_path"] = json!("../solution/mesh.obj"));
    let mesh = ["solution/mesh.obj is read and would be lost"];
    bench.refuses(&solve("solution"), &mesh);
    assert!(bench.run(&["info", "solution"]).status.success());
}

#[test]
fn a_web_page_is_one_file() {
    let bench = Bench::new();
    bench.solve();
    let all_in_one = ["export", "solution", "-o", "page.html"];
    bench.refuses(
        &all_in_one,
        &["page.html: only a web page is a single file"],
    );
    let page = [
        "export",
        "solution",
        "--for",
        "web",
        "-o",
        "pages/page.html",
    ];
    assert!(bench.run(&page).status.success());
    assert_eq!(
        fs::read_dir(bench.path("pages")).unwrap().count(),
        1,
        "the page alone"
    );
}

#[test]
fn what_a_killed_run_left_is_mentioned_once() {
    let bench = Bench::new();
    bench.solve();
    let before = bench.names();
    let solve = |more: &[&str]| {
        let run = Command::new(env!("CARGO_BIN_EXE_rekindle"))
            .args(["solve", "capture", "-o", "solution", "--frequency", "20"])
            .args(more)
            .current_dir(bench.folder.path())
            .output()
            .unwrap();
        assert!(run.status.success());
        let printed = String::from_utf8(run.stdout).unwrap();
        assert!(!printed.contains("interrupted"), "{printed}");
        let said = String::from_utf8(run.stderr).unwrap();
        said.matches("interrupted").count()
    };
    for (more, expected) in [(&[][..], 1), (&["--json"], 1), (&["--quiet"], 0)] {
        fs::create_dir(bench.path(".solution.unfinished-17")).unwrap();
        bench.write(".solution.unfinished-17/half", "x");
        assert_eq!(solve(more), expected);
        assert_eq!(bench.names(), before);
        assert_eq!(solve(more), 0);
    }
    fs::rename(
        bench.path("solution"),
        bench.path(".solution.unfinished-17-old"),
    )
    .unwrap();
    assert_eq!(solve(&[]), 1, "put back");
    assert_eq!(bench.names(), before);
}

/// Makes a pipe that nobody writes into.
#[cfg(unix)]
fn make_pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// What only looks like a file is refused, not waited for.
#[cfg(unix)]
#[test]
fn pipes_and_folders() {
    const PICTURE: &str = "capture/images/view_003.exr";
    let bench = Bench::new();
    bench.solve();
    fs::remove_file(bench.path(PICTURE)).unwrap();
    make_pipe(&bench.path(PICTURE));
    bench.refuses_solve(&["view_003.exr: cannot be read: it is a device, a pipe"]);
    fs::remove_file(bench.path(PICTURE)).unwrap();
    fs::create_dir(bench.path(PICTURE)).unwrap();
    bench.refuses_solve(&["view_003.exr: cannot be read: it is a folder"]);
    let cameras = "capture/transforms.json";
    let render = ["render", "solution", "--cameras", cameras, "-o", "pictures"];
    make_pipe(&bench.path("edits.json"));
    let edited = [&render[..], &["--edits", "edits.json"]].concat();
    bench.refuses(&edited, &["edits.json", "a pipe"]);
    for name in ["mesh.ply", "diffuse.exr"] {
        let path = bench.path("solution").join(name);
        assert!(path.exists(), "a solution has {name}");
        let whole = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        make_pipe(&path);
        bench.refuses(&render, &[name, "a pipe"]);
        fs::remove_file(&path).unwrap();
        fs::write(&path, whole).unwrap();
    }
}

#[test]
fn files_outside_the_folder_of_a_mesh() {
    let bench = Bench::new();
    bench.write("secret.bin", [0; 36]);
    bench.change_manifest(|m| m["mesh_path"] = json!("mesh.gltf"));
    let outside = bench.path("secret.bin");
    for uri in [
        "../secret.bin",
        "a/../../secret.bin",
        outside.to_str().unwrap(),
    ] {
        let document = json!({
            "asset": { "version": "2.0" },
            "buffers": [{ "uri": uri, "byteLength": 36 }],
        });
        bench.write("capture/mesh.gltf", document.to_string());
        bench.refuses_solve(&["mesh.gltf", "is not in the folder of the mesh"]);
    }
}

#[test]
fn a_mesh_in_other_units() {
    let bench = Bench::new();
    bench.change_mesh(|text| {
        let lines = text.lines().map(|line| match line.strip_prefix("v ") {
            Some(numbers) => {
                let scaled = numbers.split_whitespace().map(|number| {
                    let value: f64 = number.parse().unwrap();
                    (1e-6 * value).to_string()
                });
                format!("v {}\n", scaled.collect::<Vec<_>>().join(" "))
            }
            None => format!("{line}\n"),
        });
        lines.collect()
    });
    bench.refuses_solve(&["mesh.obj: no camera sees the mesh", "units"]);
}

#[test]
fn names_that_are_empty() {
    let bench = Bench::new();
    bench.change_manifest(|m| m["mesh_path"] = json!(""));
    bench.refuses_solve(&["mesh_path is empty"]);
}

#[test]
fn messages_hold_no_control_characters() {
    let bench = Bench::new();
    bench.change_manifest(|m| m["mesh_path"] = json!("\u{1b}[2Jmesh.obj"));
    bench.refuses_solve(&["\\u{1b}[2Jmesh.obj: no such mesh"]);
}

#[test]
fn more_memory_than_may_be_taken() {
    let bench = Bench::new();
    let solve = ["solve", "capture", "-o", "made/solution", "--memory"];
    let limited = |limit| [&solve[..], &[limit]].concat();
    bench.refuses(
        &limited("4M"),
        &["transforms.json", "6 views", "4M may be taken", "--memory"],
    );
    bench.refuses(&["info", "capture", "--memory", "4M"], &["4M may be taken"]);
    let run = bench.run(&["info", "capture", "--memory", "1G"]);
    assert!(run.status.success());
}

/// Frames that name the same file share its pixels.
#[test]
fn a_file_is_read_once() {
    let bench = Bench::new();
    bench.change_manifest(|m| {
        let name = m["frames"][1]["file_path"].clone();
        m["frames"][4]["file_path"] = name;
    });
    let capture = Capture::load(&bench.path("capture")).unwrap();
    let photograph = |i: usize| &capture.views[i].photograph;
    assert_eq!(capture.views.len(), 6);
    assert!(Arc::ptr_eq(photograph(1), photograph(4)));
    assert!(!Arc::ptr_eq(photograph(1), photograph(2)));
}

/// Too little address space is a message before anything is read.
#[cfg(target_os = "linux")]
#[test]
fn too_little_address_space() {
    let bench = Bench::new();
    for mebibytes in [200, 300] {
        let run = Command::new("sh")
            .arg("-c")
            .arg(format!("ulimit -v {}; exec \"$@\"", 1024 * mebibytes))
            .arg("sh")
            .arg(env!("CARGO_BIN_EXE_rekindle"))
            .args(["solve", "capture", "-o", "made", "--threads", "2"])
            .current_dir(bench.folder.path())
            .output()
            .unwrap();
        check_refusal(&run, &["address space", "ulimit -v"]);
    }
}

/// A limit on the size of files fails like a full disk: in the middle of writing, whether or not its signal is caught by
/// whoever starts the program.
#[cfg(unix)]
#[test]
fn a_full_disk() {
    fail_to_write("trap '' XFSZ; ulimit -f 100; exec \"$@\"");
    fail_to_write("ulimit -f 100; exec \"$@\"");
}

#[cfg(unix)]
fn fail_to_write(script: &str) {
    let bench = Bench::new();
    bench.solve();
    let before = bench.names();
    let limited = |arguments: &[&str]| {
        Command::new("sh")
            .args(["-c", script, "sh"])
            .arg(env!("CARGO_BIN_EXE_rekindle"))
            .args(arguments)
            .arg("--quiet")
            .current_dir(bench.folder.path())
            .output()
            .unwrap()
    };
    let run = limited(&["solve", "capture", "-o", "made/new", "--frequency", "20"]);
    check_refusal(&run, &["made/new: can't be written", "space"]);
    let cameras = "capture/transforms.json";
    let run = limited(&["render", "solution", "--cameras", cameras, "-o", "made"]);
    check_refusal(&run, &["made: can't be written", "space"]);
    // An earlier solution stays as it was.
    let again = ["--frequency", "20", "--do-all", "unchanged"];
    let run = limited(&[&["solve", "capture", "-o", "solution"], &again[..]].concat());
    check_refusal(&run, &["solution: can't be written", "space"]);
    assert_eq!(bench.names(), before, "nothing may be left");
    assert!(bench.run(&["info", "solution"]).status.success());
}
