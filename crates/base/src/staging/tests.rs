use std::process::{Command, ExitStatus};

use super::*;
use exchange::in_two_steps;
use fault::KILL_AT;

/// Where a child process works.
const CHILD_FOLDER: &str = "REKINDLE_TEST_FOLDER";

#[expect(clippy::unnecessary_wraps, reason = "checks may fail")]
fn anything(_: &Path) -> Result<(), DestinationError> {
    Ok(())
}

fn names_in(folder: &Path) -> Vec<String> {
    let names = names(folder).unwrap();
    names
        .into_iter()
        .map(|n| n.into_string().unwrap())
        .collect()
}

/// A folder with a file that says what it is.
fn labelled(folder: &Path, label: &str) {
    fs::create_dir_all(folder).unwrap();
    fs::write(folder.join("label"), label).unwrap();
}

fn label(folder: &Path) -> String {
    fs::read_to_string(folder.join("label")).unwrap()
}

/// A staged folder with its label.
fn staged(target: &Path) -> Staging {
    let staging = Staging::beside(target).unwrap();
    labelled(staging.path(), "new");
    staging
}

/// Runs one of the tests below that are for child processes, which is killed at a point.
fn killed(test: &str, point: &str, folder: &Path) -> ExitStatus {
    Command::new(std::env::current_exe().unwrap())
        .args([&format!("staging::tests::{test}"), "--exact"])
        .args(["--ignored", "--nocapture", "--quiet"])
        .env(KILL_AT, point)
        .env(CHILD_FOLDER, folder)
        .output()
        .unwrap()
        .status
}

/// What a file says that this program wrote.
const OLD_FILE: &str = "old, of rekindle";

/// The folder of a child process; none where a person runs the tests that are ignored.
fn child_folder() -> Option<PathBuf> {
    std::env::var_os(CHILD_FOLDER).map(PathBuf::from)
}

#[test]
#[ignore = "run by other tests in a process of its own"]
fn child_replaces() {
    let Some(folder) = child_folder() else { return };
    let _ = staged(&folder.join("result")).replace(anything);
}

#[test]
#[ignore = "run by other tests in a process of its own"]
fn child_replaces_in_two_steps() {
    let Some(folder) = child_folder() else { return };
    let _ = staged(&folder.join("result")).replace_by(in_two_steps, anything);
}

#[test]
#[ignore = "run by other tests in a process of its own"]
fn child_adds() {
    let Some(folder) = child_folder() else { return };
    let staging = Staging::within(&folder.join("result")).unwrap();
    for name in ["one", "three", "two"] {
        fs::write(staging.path().join(name), "new").unwrap();
    }
    let _ = staging.add();
}

#[test]
fn an_abandoned_folder_leaves_nothing() {
    let parent = tempfile::tempdir().unwrap();
    let staging = Staging::beside(&parent.path().join("result")).unwrap();
    fs::write(staging.path().join("half"), "x").unwrap();
    drop(staging);
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
}

#[test]
fn folders_made_for_an_abandoned_one_vanish_too() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("one/two/result");
    drop(Staging::beside(&target).unwrap());
    assert!(!parent.path().join("one").exists());
    let staging = Staging::beside(&target).unwrap();
    staging.replace(anything).unwrap();
    assert!(target.exists());
}

#[test]
fn a_result_replaces_the_old_one_whole() {
    for exchange in [exchange::exchange as Exchange, in_two_steps] {
        let parent = tempfile::tempdir().unwrap();
        let target = parent.path().join("deep/result");
        for content in ["old", "new"] {
            let staging = Staging::beside(&target).unwrap();
            fs::write(staging.path().join(content), content).unwrap();
            staging.replace_by(exchange, anything).unwrap();
        }
        assert_eq!(names_in(&target), ["new"]);
        assert_eq!(names_in(target.parent().unwrap()), ["result"]);
    }
}

#[test]
fn what_may_not_be_replaced_stays() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("result");
    labelled(&target, "old");
    let refused = |path: &Path| Err(cannot_write(path)(io::ErrorKind::Other.into()));
    assert!(staged(&target).replace(refused).is_err());
    assert_eq!(label(&target), "old");
    assert_eq!(names_in(parent.path()), ["result"]);
}

#[test]
fn pictures_join_what_is_there() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("pictures");
    fs::create_dir(&target).unwrap();
    fs::write(target.join("other"), "x").unwrap();
    let staging = Staging::beside(&target).unwrap();
    fs::write(staging.path().join("one"), "1").unwrap();
    staging.add().unwrap();
    assert!(target.join("other").exists() && target.join("one").exists());
    assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1);
    let staging = Staging::within(&target).unwrap();
    fs::write(staging.path().join("two"), "2").unwrap();
    staging.add().unwrap();
    assert_eq!(fs::read_dir(&target).unwrap().count(), 3);
    drop(Staging::within(&parent.path().join("new/pictures")).unwrap());
    assert!(!parent.path().join("new").exists());
}

#[test]
fn a_folder_in_the_way_of_a_picture_leaves_all_as_it_was() {
    let parent = tempfile::tempdir().unwrap();
    fs::create_dir(parent.path().join("two")).unwrap();
    let staging = Staging::within(parent.path()).unwrap();
    for name in ["one", "two"] {
        fs::write(staging.path().join(name), "new").unwrap();
    }
    let error = staging.add().unwrap_err().to_string();
    assert!(error.contains("two is a folder"), "{error}");
    assert_eq!(names_in(parent.path()), ["two"]);
}

#[test]
fn a_kill_after_the_exchange_leaves_the_new_one() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("result");
    labelled(&target, "old");
    assert!(!killed("child_replaces", "exchanged", parent.path()).success());
    assert_eq!(label(&target), "new");
    let next = Staging::beside(&target).unwrap();
    assert!(
        next.settled()[0].contains("is removed"),
        "{:?}",
        next.settled()
    );
    drop(next);
    assert_eq!(names_in(parent.path()), ["result"]);
    assert!(Staging::beside(&target).unwrap().settled().is_empty());
}

#[test]
fn a_kill_between_the_steps_of_an_exchange_loses_nothing() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("result");
    labelled(&target, "old");
    let status = killed(
        "child_replaces_in_two_steps",
        "between the steps",
        parent.path(),
    );
    assert!(!status.success() && !target.exists());
    let next = Staging::beside(&target).unwrap();
    assert!(
        next.settled()[0].contains("put back"),
        "{:?}",
        next.settled()
    );
    assert_eq!(label(&target), "old");
    drop(next);
    assert_eq!(names_in(parent.path()), ["result"]);
}

#[test]
fn a_kill_while_adding_is_finished_by_the_next_run() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("result");
    fs::create_dir(&target).unwrap();
    for name in ["one", "other", "three", "two"] {
        fs::write(target.join(name), OLD_FILE).unwrap();
    }
    assert!(!killed("child_adds", "adding", parent.path()).success());
    let content = |name: &str| fs::read_to_string(target.join(name)).unwrap();
    assert_eq!(
        ["one", "three", "two"].map(content),
        ["new", OLD_FILE, OLD_FILE]
    );
    let next = Staging::within(&target).unwrap();
    assert!(
        next.settled()[0].contains("added now"),
        "{:?}",
        next.settled()
    );
    drop(next);
    let all = ["one", "other", "three", "two"];
    assert_eq!(names_in(&target), all);
    assert_eq!(all.map(content), ["new", OLD_FILE, "new", "new"]);
}

#[test]
fn what_a_live_run_writes_is_left_alone() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("result");
    let first = staged(&target);
    let second = Staging::beside(&target).unwrap();
    assert!(second.settled().is_empty());
    labelled(second.path(), "second");
    first.replace(anything).unwrap();
    assert_eq!(label(&target), "new");
    second.replace(anything).unwrap();
    assert_eq!(label(&target), "second");
    assert_eq!(names_in(parent.path()), ["result"]);
}

#[test]
fn what_earlier_versions_left_is_settled() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("result");
    let beside = |name: &str| parent.path().join(name);
    labelled(&beside(".result.unfinished-17"), "half");
    labelled(&beside(".result.unfinished-17-old"), "old");
    labelled(&beside(".result.unfinished-mine"), "mine");
    labelled(&beside(".other.unfinished-17"), "half");
    assert_eq!(Staging::beside(&target).unwrap().settled().len(), 2);
    assert_eq!(label(&target), "old");
    let left = [".other.unfinished-17", ".result.unfinished-mine", "result"];
    assert_eq!(names_in(parent.path()), left);
}

#[cfg(unix)]
#[test]
fn links_are_followed() {
    let parent = tempfile::tempdir().unwrap();
    let beside = |name: &str| parent.path().join(name);
    labelled(&beside("disk/result"), "old");
    std::os::unix::fs::symlink("disk/result", beside("link")).unwrap();
    std::os::unix::fs::symlink("disk/later", beside("dangling")).unwrap();
    for (link, there) in [("link", "disk/result"), ("dangling", "disk/later")] {
        staged(&beside(link)).replace(anything).unwrap();
        assert!(fs::symlink_metadata(beside(link)).unwrap().is_symlink());
        assert_eq!(label(&beside(there)), "new");
    }
    assert_eq!(names_in(&beside("disk")), ["later", "result"]);
    assert_eq!(names_in(parent.path()), ["dangling", "disk", "link"]);
}

#[test]
fn a_place_without_a_name_cannot_be_replaced_but_added_to() {
    let error = Staging::beside(Path::new("..")).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
    let parent = tempfile::tempdir().unwrap();
    fs::create_dir(parent.path().join("deep")).unwrap();
    let staging = Staging::within(&parent.path().join("deep/..")).unwrap();
    fs::write(staging.path().join("one"), "1").unwrap();
    staging.add().unwrap();
    assert_eq!(names_in(parent.path()), ["deep", "one"]);
}
