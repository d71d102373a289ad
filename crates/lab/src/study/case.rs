//! What a study is made of: captures to be made, how each is to be solved, and what is swept.

use crate::bench::number;
use crate::synth::Recipe;

/// A capture and how it is solved.
#[derive(Clone, Debug)]
pub(super) struct Case {
    /// The swept value in words.
    pub label: String,
    /// The swept value where it is a number.
    pub value: Option<f64>,
    /// The capture.
    pub recipe: Recipe,
    /// Further arguments of `rekindle solve`.
    pub options: Vec<String>,
}

/// Cases that differ in one thing.
#[derive(Clone, Debug)]
pub(super) struct Group {
    /// What it is called in files and on the command line.
    pub name: &'static str,
    /// What is swept, with its unit.
    pub swept: &'static str,
    /// In the order of the swept value.
    pub cases: Vec<Case>,
}

impl Group {
    /// A number is swept: `change` puts it into a copy of `base`.
    pub(super) fn sweep(
        name: &'static str,
        swept: &'static str,
        base: &Recipe,
        values: &[f64],
        change: impl Fn(&mut Recipe, f64),
    ) -> Self {
        let case = |&value: &f64| {
            let mut recipe = base.clone();
            change(&mut recipe, value);
            Case {
                label: number(value),
                value: Some(value),
                recipe,
                options: Vec::new(),
            }
        };
        Self {
            name,
            swept,
            cases: values.iter().map(case).collect(),
        }
    }

    /// Things with names are compared.
    pub(super) fn named<T: Copy>(
        name: &'static str,
        swept: &'static str,
        base: &Recipe,
        things: &[(&str, T)],
        change: impl Fn(&mut Recipe, T),
    ) -> Self {
        let case = |(label, thing): &(&str, T)| {
            let mut recipe = base.clone();
            change(&mut recipe, *thing);
            Case {
                label: (*label).to_owned(),
                value: None,
                recipe,
                options: Vec::new(),
            }
        };
        Self {
            name,
            swept,
            cases: things.iter().map(case).collect(),
        }
    }

    /// An option of `rekindle solve` is swept over a whole number.
    pub(super) fn option(
        name: &'static str,
        swept: &'static str,
        base: &Recipe,
        values: &[u32],
        option: &str,
    ) -> Self {
        let case = |&value: &u32| Case {
            label: value.to_string(),
            value: Some(f64::from(value)),
            recipe: base.clone(),
            options: vec![option.to_owned(), value.to_string()],
        };
        Self {
            name,
            swept,
            cases: values.iter().map(case).collect(),
        }
    }
}
