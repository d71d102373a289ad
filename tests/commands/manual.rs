//! Manual pages and completions know every command and option that help knows.

use crate::command::{rekindle, succeed};

fn printed(arguments: &[&str]) -> String {
    String::from_utf8(succeed(arguments).stdout).unwrap()
}

/// The program's commands, as its help lists them.
fn commands() -> Vec<String> {
    let help = printed(&["-h"]);
    let listed = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| !line.is_empty())
        .map(|line| line.split_whitespace().next().unwrap().to_owned());
    listed.collect()
}

/// The options of a command, as its help lists them: `--output`.
fn options(command: &str) -> Vec<String> {
    let help = printed(&[command, "-h"]);
    let words = help
        .split_whitespace()
        .map(|word| word.trim_end_matches(','));
    let mut options: Vec<String> = words
        .filter(|word| {
            word.strip_prefix("--").is_some_and(|rest| {
                rest.len() > 1 && rest.bytes().all(|c| c == b'-' || c.is_ascii_lowercase())
            })
        })
        .map(str::to_owned)
        .collect();
    options.sort();
    options.dedup();
    options
}

#[test]
fn every_command_has_a_manual_page_with_all_its_options() {
    let commands = commands();
    assert!(commands.contains(&"solve".to_owned()), "{commands:?}");
    for command in commands {
        let page = printed(&["manual", &command]);
        assert!(
            page.contains(&format!(".TH rekindle-{command} 1")),
            "{command}"
        );
        // It takes no options.
        if command == "help" {
            continue;
        }
        for option in options(&command) {
            let escaped = option.replace('-', "\\-");
            assert!(page.contains(&escaped), "{command} {option}");
        }
    }
    assert!(printed(&["manual"]).contains(".TH rekindle 1"));
}

#[test]
fn shells_complete_all_commands() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = printed(&["completions", shell]);
        for command in commands() {
            assert!(script.contains(&command), "{shell} {command}");
        }
        assert!(script.contains("light-rotation"), "{shell}");
    }
}

#[test]
fn a_page_of_no_command_is_refused_with_all_that_there_are() {
    let run = rekindle(&["manual", "slove"]);
    let said = String::from_utf8(run.stderr).unwrap();
    assert_eq!(run.status.code(), Some(2), "{said}");
    assert!(
        said.contains("slove: ") && said.contains("solve, render"),
        "{said}"
    );
}
