//! What leaving things out saves, and what it changes: each shortcut avoided in turn, on one capture.

use super::case::{Case, Group};
use super::stability;
use crate::synth::{Material, Object, Recipe};
use rekindle_scene::reflectance::SpecularModel;
use rekindle_scene::shortcuts::Shortcut;

/// Width and height of the photographs.
const SIZE: [u32; 2] = [640, 480];
/// Frequency at which all nodes can be unknowns at once.
const DENSE: &str = "16";

/// A group for each capture; the first case of each takes all shortcuts.
pub(super) fn groups() -> Vec<Group> {
    let paper = stability::base(SIZE);
    let mut plastic = paper.clone();
    plastic.object = Object::Bowl;
    plastic.material = Material::dielectric(SpecularModel::Beckmann, 0.1, 1.5);
    plastic.interreflection = true;
    let mut small = paper.clone();
    small.views.size = [320, 240];
    let mut many = paper.clone();
    many.views.count = 24;
    many.sensor.noise = 0.01;
    let own = [Shortcut::DarkCells, Shortcut::Views];
    let others = |shortcut: &Shortcut| !own.contains(shortcut);
    let others: Vec<Shortcut> = Shortcut::ALL.into_iter().filter(others).collect();
    vec![
        group("figurine", &paper, &others, &[]),
        group("bowl", &plastic, &others, &[]),
        group(
            "few_nodes",
            &small,
            &[Shortcut::DarkCells],
            &["--frequency", DENSE],
        ),
        group("many_views", &many, &[Shortcut::Views], &[]),
    ]
}

/// All shortcuts taken, and each of some avoided; `options` are for all.
fn group(name: &'static str, recipe: &Recipe, avoided: &[Shortcut], options: &[&str]) -> Group {
    let case = |label: &str, more: &[&str]| Case {
        label: label.to_owned(),
        value: None,
        recipe: recipe.clone(),
        options: options.iter().chain(more).map(|&o| o.to_owned()).collect(),
    };
    let mut cases = vec![case("nothing", &[])];
    cases.extend(
        avoided
            .iter()
            .map(|s| case(s.name(), &["--do-all", s.name()])),
    );
    Group {
        name,
        swept: "done all the same",
        cases,
    }
}
