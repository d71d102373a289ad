//! How far can the estimate be trusted, and what does it cost?
//!
//! [`run`] makes captures with known truth, one thing worse or larger from one to the next, solves each by the program
//! itself in a process of its own, and compares what comes out with the truth by the measures of `bench`. [`Study::write`]
//! makes tables and plots of it. The captures are `synth`'s, whose forward model is the program's own: a good result is
//! necessary, not sufficient.

mod case;
mod child;
mod coverage;
mod error;
mod outcome;
mod plot;
mod report;
mod scaling;
mod skipping;
mod stability;
mod trial;

pub use error::StudyError;
pub use report::ACCURACY;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use rayon::ThreadPoolBuilder;

use crate::bench::Audience;
use case::Group;
use outcome::Outcome;
use trial::Workshop;

/// How often it is asked whether to break off.
const PERIOD: Duration = Duration::from_millis(10);

/// What is to be studied.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The program that solves.
    pub program: PathBuf,
    /// Sections, `stability`, or single groups of them, `stability/noise`; empty for everything.
    pub only: Vec<String>,
    /// Width and height of the photographs on which the stability is studied.
    pub size: [u32; 2],
    /// Captures for each noise level on which the coverage of intervals is counted.
    pub seeds: u32,
    /// How often solves are timed; the medians are stated.
    pub rounds: u32,
    /// Threads of solves that are timed; all cores where nothing is said.
    pub threads: Option<u16>,
    /// Megapixels of the largest photographs that are timed.
    pub most_megapixels: f64,
}

/// A part of the study.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Section {
    /// What the estimate withstands.
    Stability,
    /// What time and memory grow with.
    Scaling,
    /// How often the interval of σ holds the truth.
    Coverage,
    /// What leaving things out saves and changes.
    Skipping,
}

const SECTIONS: [Section; 4] = [
    Section::Stability,
    Section::Coverage,
    Section::Scaling,
    Section::Skipping,
];

impl Section {
    fn name(self) -> &'static str {
        match self {
            Self::Stability => "stability",
            Self::Scaling => "scaling",
            Self::Coverage => "coverage",
            Self::Skipping => "skipping",
        }
    }

    fn groups(self, plan: &Plan) -> Vec<Group> {
        match self {
            Self::Stability => stability::groups(plan.size),
            Self::Scaling => scaling::groups(plan.most_megapixels),
            Self::Coverage => coverage::groups(plan.seeds),
            Self::Skipping => skipping::groups(),
        }
    }

    /// Whether seconds are of interest, so that one solve has the machine for itself.
    fn is_timed(self) -> bool {
        matches!(self, Self::Scaling | Self::Skipping)
    }
}

/// A group and what came of each of its cases.
#[derive(Clone, Debug)]
struct Studied {
    group: Group,
    outcomes: Vec<Outcome>,
}

/// Everything that was found out.
#[derive(Clone, Debug)]
pub struct Study {
    plan: Plan,
    sections: Vec<(Section, Vec<Studied>)>,
}

/// Makes a study. Captures and solutions are made inside `folder` and removed again.
pub fn run(plan: &Plan, folder: &Path, audience: &mut dyn Audience) -> Result<Study, StudyError> {
    let wanted = wanted(plan)?;
    let mut all = Progress {
        audience,
        done: 0,
        all: wanted.iter().map(|(_, groups)| count(groups)).sum(),
    };
    let mut sections = Vec::new();
    for (section, groups) in wanted {
        let outcomes = study(plan, section, &groups, folder, &mut all)?;
        let studied = groups.into_iter().zip(outcomes);
        let studied = studied.map(|(group, outcomes)| Studied { group, outcomes });
        sections.push((section, studied.collect()));
    }
    Ok(Study {
        plan: plan.clone(),
        sections,
    })
}

fn count(groups: &[Group]) -> usize {
    groups.iter().map(|group| group.cases.len()).sum()
}

/// The sections with their groups, those that are asked for.
fn wanted(plan: &Plan) -> Result<Vec<(Section, Vec<Group>)>, StudyError> {
    let mut all = SECTIONS
        .map(|section| (section, section.groups(plan)))
        .to_vec();
    let names = |section: Section, group: &Group| {
        [
            section.name().to_owned(),
            format!("{}/{}", section.name(), group.name),
        ]
    };
    for name in &plan.only {
        let known = |(section, groups): &(Section, Vec<Group>)| {
            groups
                .iter()
                .any(|group| names(*section, group).contains(name))
        };
        if !all.iter().any(known) {
            return Err(StudyError::Unknown {
                name: name.clone(),
                known: list(&all),
            });
        }
    }
    if !plan.only.is_empty() {
        for (section, groups) in &mut all {
            groups.retain(|group| names(*section, group).iter().any(|n| plan.only.contains(n)));
        }
    }
    for (_, groups) in &mut all {
        groups.retain(|group| !group.cases.is_empty());
    }
    all.retain(|(_, groups)| !groups.is_empty());
    Ok(all)
}

/// All sections with their groups, a line a section.
fn list(all: &[(Section, Vec<Group>)]) -> String {
    let line = |(section, groups): &(Section, Vec<Group>)| {
        let names: Vec<&str> = groups.iter().map(|group| group.name).collect();
        format!("  {}/ {}", section.name(), names.join(" "))
    };
    all.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// Tells how many cases are done.
struct Progress<'a> {
    audience: &'a mut dyn Audience,
    done: usize,
    all: usize,
}

impl Progress<'_> {
    fn done(&mut self, what: &str, cases: usize) {
        self.done += cases;
        let part = self.done as f32 / self.all.max(1) as f32;
        self.audience.stage(what, part);
    }
}

/// Cases of one capture: the places of each, group and case.
struct Work {
    cases: Vec<(usize, usize)>,
}

/// The cases of all groups, those of one capture together.
fn work(groups: &[Group]) -> Vec<Work> {
    let mut all: Vec<Work> = Vec::new();
    for (g, group) in groups.iter().enumerate() {
        for (c, case) in group.cases.iter().enumerate() {
            let same = |work: &&mut Work| {
                let (g, c) = work.cases[0];
                groups[g].cases[c].recipe == case.recipe
            };
            match all.iter_mut().find(same) {
                Some(work) => work.cases.push((g, c)),
                None => all.push(Work {
                    cases: vec![(g, c)],
                }),
            }
        }
    }
    all
}

/// Tries the cases of a section: for each group what came of each of its cases.
fn study(
    plan: &Plan,
    section: Section,
    groups: &[Group],
    folder: &Path,
    progress: &mut Progress<'_>,
) -> Result<Vec<Vec<Outcome>>, StudyError> {
    let stop = AtomicBool::new(false);
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let shop = Workshop {
        program: &plan.program,
        folder,
        rounds: if section.is_timed() { plan.rounds } else { 1 },
        with_floor: section.is_timed(),
        threads: if section.is_timed() {
            plan.threads
        } else {
            Some(1)
        },
        makers: ThreadPoolBuilder::new()
            .build()
            .expect("threads can be started"),
        stop: &stop,
    };
    let work = work(groups);
    let attempt = |index: usize| {
        let options: Vec<&[String]> = work[index]
            .cases
            .iter()
            .map(|&(g, c)| groups[g].cases[c].options.as_slice())
            .collect();
        let (g, c) = work[index].cases[0];
        let name = format!("{}_{index}", section.name());
        shop.try_all(&name, &groups[g].cases[c].recipe, &options)
    };
    let mut outcomes: Vec<Vec<Option<Outcome>>> =
        groups.iter().map(|g| vec![None; g.cases.len()]).collect();
    let jobs = if section.is_timed() { 1 } else { cores };
    let mut take = |some: Option<(usize, Vec<Outcome>)>| {
        if let Some((index, found)) = some {
            for (&(g, c), outcome) in work[index].cases.iter().zip(found) {
                outcomes[g][c] = Some(outcome);
            }
            let (g, c) = work[index].cases[0];
            let (group, label) = (groups[g].name, &groups[g].cases[c].label);
            let what = format!("{}: {group} {label}", section.name());
            progress.done(&what, work[index].cases.len());
        }
        progress.audience.stop()
    };
    in_parallel(jobs, work.len(), &stop, &attempt, &mut take)?;
    Ok(outcomes
        .into_iter()
        .map(|group| group.into_iter().flatten().collect())
        .collect())
}

/// Makes attempts 0 … `count`, several at a time. `take` is given what comes of each as it comes, and nothing now and then,
/// until it says that no more is wanted.
fn in_parallel<T: Send>(
    jobs: usize,
    count: usize,
    stop: &AtomicBool,
    attempt: &(dyn Fn(usize) -> Result<T, StudyError> + Sync),
    take: &mut dyn FnMut(Option<(usize, T)>) -> bool,
) -> Result<(), StudyError> {
    let next = AtomicUsize::new(0);
    thread::scope(|scope| {
        let (sender, receiver) = sync_channel(jobs);
        for _ in 0..jobs {
            let (sender, next) = (sender.clone(), &next);
            let worker = move || {
                while !stop.load(Ordering::Relaxed) {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= count || sender.send((index, attempt(index))).is_err() {
                        break;
                    }
                }
            };
            let name = "study".to_owned();
            let started = thread::Builder::new()
                .name(name)
                .spawn_scoped(scope, worker);
            started.expect("a thread can be started");
        }
        drop(sender);
        let mut failed = None;
        loop {
            let some = match receiver.recv_timeout(PERIOD) {
                Ok((index, Ok(outcome))) => Some((index, outcome)),
                Ok((_, Err(error))) => {
                    // What fails after that was only stopped.
                    failed = failed.or(Some(error));
                    None
                }
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => break,
            };
            if take(some) {
                failed = failed.or(Some(StudyError::Stopped));
            }
            stop.store(failed.is_some(), Ordering::Relaxed);
        }
        failed.map_or(Ok(()), Err)
    })
}
