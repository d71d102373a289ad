//! A study as files: `accuracy.md`, and a CSV file and plots for each section.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

use super::outcome::{Found, Outcome, STAGES};
use super::plot;
use super::{Plan, SECTIONS, Section, Studied, Study};
use crate::bench::{cell, field, mebibytes, percent, with_unit};
use rekindle_base::math::median;

/// The report in words.
pub const ACCURACY: &str = "accuracy.md";

const INTRODUCTION: &str = "# How far the estimate can be trusted, and what it costs

Written by `rekindle study -o DIR`. The captures are those of `rekindle synth`, whose forward model is the program's own: a good
result here is necessary, not sufficient. `--only SECTION` renews one section and leaves the others as they are.
";

const STABILITY: &str = "One thing at a time is made worse. Unless it is swept: a figurine of 30,000 triangles with the paper's lobe of \
σ 0.075, three lamps of 3° radius and contrast 3, six views of SIZE over 150°, no noise. Errors are those of the worst lamp of \
which something was found; lamps whose discs touch are one, what was found in a disc is that lamp's, and \
fluxes are compared up to one factor. *Fine* is σ within 1 %, directions within 0.3°, fluxes within 3 %, less than 3 % of the \
flux in lights that are not there, and less than 3 % of the true flux in lamps of which nothing was found; *degrades* says what is beyond that, and whether the stated 95 % interval of σ still holds the \
truth; *doubted* means that the program itself says \
that the result is not to be trusted, *refused* that it gives none, and why. *Wrong and not said* is a \
result beyond what is fine that is neither doubted nor comes with the warning that the mesh's normals are off, unless only σ is wrong \
and its interval holds the truth. In the plots values without a result are in brackets.
";

const SCALING: &str = "What a solve costs, in seconds, by the program's own clock, with reading and writing. Unless it is swept: the capture of \
the section on stability, with photographs of 640×480. *Least* is reading and decoding the photographs and adding up their \
pixels; *× least* is the whole over that.
";

const SKIPPING: &str = "What a solve leaves out because the capture doesn't need it, done all the same: what that takes and what it changes. \
× is over the first row of the table, from the same run. σ is compared with that of the first row; its stated 95 % interval says \
by how much it may differ.
";

const COVERAGE: &str = "How often the stated 95 % interval of σ holds the truth, on captures of a torus that differ in roughness (0.1 to 0.25), lamps \
(1 to 3), texture, cameras and noise: four views of 160×120. Those that the program doubts count like the others.
";

impl Study {
    /// Writes all files into a folder that exists; returns their names. `earlier` is an earlier `accuracy.md`, of which
    /// the sections that were not studied are kept.
    pub fn write(&self, folder: &Path, earlier: &str) -> io::Result<Vec<String>> {
        let mut text = INTRODUCTION.to_owned();
        let mut files = Vec::new();
        for section in SECTIONS {
            let made = self.sections.iter().find(|(own, _)| *own == section);
            let Some((_, studied)) = made else {
                text.push_str(part_of(earlier, section).unwrap_or_default());
                continue;
            };
            add_head(&mut text, section, studied, &self.plan);
            for (file, caption, svg) in plot::plots(section, studied)? {
                let _ = write!(text, "\n![{caption}]({file})\n\n*{caption}.*\n");
                files.push((file, svg));
            }
            add_tables(&mut text, section, studied);
            let file = format!("{}.csv", section.name());
            let _ = write!(text, "\nAll numbers: [{file}]({file}).\n");
            files.push((file, csv(studied)));
        }
        files.push((ACCURACY.to_owned(), text));
        for (name, text) in &files {
            fs::write(folder.join(name), text)?;
        }
        Ok(files.into_iter().map(|(name, _)| name).collect())
    }
}

/// What a report says of a section, if anything: from its heading up to the next one's.
fn part_of(report: &str, section: Section) -> Option<&str> {
    let from = report.find(&format!("\n{}\n", heading(section)))?;
    let rest = &report[from + 1..];
    let to = rest.find("\n## ").map_or(report.len(), |to| from + 1 + to);
    Some(&report[from..to])
}

fn heading(section: Section) -> &'static str {
    match section {
        Section::Stability => "## Stability",
        Section::Scaling => "## Scaling",
        Section::Coverage => "## Coverage",
        Section::Skipping => "## Skipping",
    }
}

/// A row for every case.
fn csv(studied: &[Studied]) -> String {
    let mut text = String::from(
        "group,value,verdict,wrong_and_not_said,words,sigma,sigma_error_pct,interval_low_pct,interval_high_pct,direction_error_deg,\
         flux_error_pct,flux_outside_pct,flux_missing_pct,hemisphere_error_pct,lamps_found,lamps,fit_db,total_s,floor_s,peak_mib",
    );
    for stage in STAGES {
        let _ = write!(text, ",{stage}_s");
    }
    text.push('\n');
    for group in studied {
        for (case, outcome) in group.group.cases.iter().zip(&group.outcomes) {
            let verdict = outcome.verdict();
            let _ = writeln!(
                text,
                "{},{},{},{},{},{}",
                group.group.name,
                field(&case.label),
                verdict.word(),
                u8::from(outcome.is_silently_wrong()),
                field(verdict.words()),
                numbers(outcome.found())
            );
        }
    }
    text
}

/// The numbers of a row of the CSV file.
fn numbers(found: Option<&Found>) -> String {
    let of =
        |value: &dyn Fn(&Found) -> Option<f64>, decimals| cell(found.and_then(value), decimals);
    let end = |k: usize| move |f: &Found| Some(100.0 * f.interval?[k]);
    let mut cells = vec![
        of(&|f| Some(f.sigma), 6),
        of(&|f| percent(f.errors.sigma), 4),
        of(&end(0), 4),
        of(&end(1), 4),
        of(&|f| f.errors.direction_deg, 4),
        of(&|f| percent(f.errors.flux), 4),
        of(&|f| percent(f.errors.outside), 4),
        of(&|f| percent(f.errors.missing), 4),
        of(&|f| percent(f.errors.hemisphere), 4),
        of(&|f| Some(f.lamps[0] as f64), 0),
        of(&|f| Some(f.lamps[1] as f64), 0),
        of(&|f| Some(f.fit_db), 2),
        of(&|f| Some(f.cost.total), 4),
        of(&|f| f.cost.floor, 4),
        of(&|f| mebibytes(f.cost.peak_bytes), 1),
    ];
    cells.extend((0..STAGES.len()).map(|k| of(&|f| f.cost.stages[k], 4)));
    cells.join(",")
}

fn add_head(text: &mut String, section: Section, studied: &[Studied], plan: &Plan) {
    let [width, height] = plan.size;
    let words = match section {
        Section::Stability => STABILITY.replace("SIZE", &format!("{width}×{height}")),
        Section::Scaling => SCALING.to_owned(),
        Section::Coverage => COVERAGE.to_owned(),
        Section::Skipping => SKIPPING.to_owned(),
    };
    let _ = write!(text, "\n{}\n\n{words}", heading(section));
    if section.is_timed() {
        let threads = plan
            .threads
            .map_or("a thread per core".to_owned(), |n| format!("{n} threads"));
        let _ = writeln!(text, "\nSolves have {threads} of {}.", processor());
    }
    if section == Section::Stability {
        let outcomes = || studied.iter().flat_map(|s| &s.outcomes);
        let counts = ["fine", "degrades", "doubted", "refused", "failed"].map(|word| {
            let count = outcomes().filter(|o| o.verdict().word() == word).count();
            format!("{count} {word}")
        });
        let _ = writeln!(
            text,
            "\nOf {} cases: {}. Wrong and not said: {}.",
            outcomes().count(),
            counts.join(", "),
            outcomes().filter(|o| o.is_silently_wrong()).count()
        );
    }
}

/// The processor's name where the system tells it.
fn processor() -> String {
    let named = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    });
    named.unwrap_or_else(|| "this machine".to_owned())
}

fn add_tables(text: &mut String, section: Section, studied: &[Studied]) {
    match section {
        Section::Coverage => {
            text.push_str(
                "\n| noise, percent | captures | with a result | interval holds σ | of those with a result | doubted | error of σ, \
                 median | half the interval, median |\n| --- | --- | --- | --- | --- | --- | --- | --- |\n",
            );
            for group in studied {
                add_coverage(text, group);
            }
        }
        Section::Stability => {
            for group in studied {
                let head = "σ | 95 % interval | direction | flux | hemisphere | lamps | verdict | wrong and not said";
                add_group(text, group, head, stability_row);
            }
        }
        Section::Scaling => {
            let head = format!("all | {} | least | × least | memory", STAGES.join(" | "));
            for group in studied {
                add_group(text, group, &head, scaling_row);
            }
        }
        Section::Skipping => {
            for group in studied {
                let head = "all | estimate | × all | × estimate | σ | half its interval | σ less the first | fit | memory";
                add_group(text, group, head, skipping_row);
            }
        }
    }
}

/// A table of a group, a row a case; `row` is given what came of a case and of the first one.
fn add_group(
    text: &mut String,
    studied: &Studied,
    head: &str,
    row: fn(&Outcome, &Outcome) -> Vec<String>,
) {
    let group = &studied.group;
    let columns = 1 + head.split(" | ").count();
    let _ = writeln!(
        text,
        "\n### {}\n\n| {} | {head} |\n|{}",
        group.name.replace('_', " "),
        group.swept,
        " --- |".repeat(columns)
    );
    for (case, outcome) in group.cases.iter().zip(&studied.outcomes) {
        let _ = writeln!(
            text,
            "| {} | {} |",
            case.label,
            row(outcome, &studied.outcomes[0]).join(" | ")
        );
    }
}

fn stability_row(outcome: &Outcome, _: &Outcome) -> Vec<String> {
    let found = outcome.found();
    let of = |value: &dyn Fn(&Found) -> Option<f64>, decimals, unit| {
        with_unit(cell(found.and_then(value), decimals), unit)
    };
    let interval = found.and_then(|f| f.interval).map(|ends| {
        let [low, high] = ends.map(|end| 100.0 * end);
        format!("{low:+.2} to {high:+.2} %")
    });
    let lamps = found.map(|f| format!("{} of {}", f.lamps[0], f.lamps[1]));
    let verdict = outcome.verdict();
    let words = match first_sentence(verdict.words()) {
        "" => verdict.word().to_owned(),
        words => format!("{}: {words}", verdict.word()),
    };
    let unsaid = if outcome.is_silently_wrong() {
        "yes"
    } else {
        ""
    };
    vec![
        of(&|f| percent(f.errors.sigma), 2, " %"),
        with_unit(interval.unwrap_or_default(), ""),
        of(&|f| f.errors.direction_deg, 2, "°"),
        of(&|f| percent(f.errors.flux), 2, " %"),
        of(&|f| percent(f.errors.hemisphere), 1, " %"),
        with_unit(lamps.unwrap_or_default(), ""),
        words.replace('|', "\\|"),
        unsaid.to_owned(),
    ]
}

fn scaling_row(outcome: &Outcome, _: &Outcome) -> Vec<String> {
    let found = outcome.found();
    let of = |value: &dyn Fn(&Found) -> Option<f64>, decimals, unit| {
        with_unit(cell(found.and_then(value), decimals), unit)
    };
    let mut cells = vec![of(&|f| Some(f.cost.total), 2, "")];
    cells.extend((0..STAGES.len()).map(|k| of(&|f| f.cost.stages[k], 2, "")));
    cells.push(of(&|f| f.cost.floor, 3, ""));
    cells.push(of(&|f| Some(f.cost.total / f.cost.floor?), 1, ""));
    cells.push(of(&|f| mebibytes(f.cost.peak_bytes), 0, " MiB"));
    cells
}

fn skipping_row(outcome: &Outcome, first: &Outcome) -> Vec<String> {
    let (found, first) = (outcome.found(), first.found());
    let estimate = |f: &Found| {
        let at = STAGES.iter().position(|stage| *stage == "estimate")?;
        f.cost.stages[at]
    };
    let of = |value: &dyn Fn(&Found) -> Option<f64>, decimals, unit| {
        with_unit(cell(found.and_then(value), decimals), unit)
    };
    vec![
        of(&|f| Some(f.cost.total), 2, ""),
        of(&estimate, 2, ""),
        of(&|f| Some(f.cost.total / first?.cost.total), 2, ""),
        of(&|f| Some(estimate(f)? / estimate(first?)?), 2, ""),
        of(&|f| Some(f.sigma), 5, ""),
        of(&|f| Some(50.0 * (f.interval?[1] - f.interval?[0])), 3, " %"),
        of(&|f| Some(100.0 * (f.sigma / first?.sigma - 1.0)), 4, " %"),
        of(&|f| Some(f.fit_db), 1, " dB"),
        of(&|f| mebibytes(f.cost.peak_bytes), 0, " MiB"),
    ]
}

fn add_coverage(text: &mut String, studied: &Studied) {
    let found: Vec<&Found> = studied.outcomes.iter().filter_map(Outcome::found).collect();
    let holds = found.iter().filter(|f| f.covers()).count();
    let doubted = found.iter().filter(|f| f.doubt.is_some()).count();
    let errors = found.iter().filter_map(|f| Some(f.errors.sigma?.abs()));
    let widths = found.iter().filter_map(|f| {
        let [low, high] = f.interval?;
        Some(0.5 * (high - low))
    });
    let _ = writeln!(
        text,
        "| {} | {} | {} | {holds} | {} | {doubted} | {} | {} |",
        studied.group.name.trim_start_matches("noise_"),
        studied.outcomes.len(),
        found.len(),
        with_unit(
            cell(
                (!found.is_empty()).then(|| 100.0 * holds as f64 / found.len() as f64),
                1
            ),
            " %"
        ),
        with_unit(
            cell(percent(median(&mut errors.collect::<Vec<_>>())), 3),
            " %"
        ),
        with_unit(
            cell(percent(median(&mut widths.collect::<Vec<_>>())), 3),
            " %"
        ),
    );
}

/// The first sentence of a text in one line.
fn first_sentence(text: &str) -> &str {
    let line = text.lines().next().unwrap_or_default();
    line.split_once(". ").map_or(line, |(first, _)| first)
}

#[cfg(test)]
mod tests {
    use super::super::outcome::Cost;
    use super::super::{scaling, stability};
    use super::*;
    use crate::bench::Errors;

    /// A result as of a case number: the larger, the worse.
    fn outcome(case: usize) -> Outcome {
        if case == 3 {
            return Outcome::Refused("Too | bad. Go home.".to_owned());
        }
        let error = 0.002 * case as f64;
        Outcome::Solved(Box::new(Found {
            sigma: 0.1 * (1.0 + error),
            interval: Some([-0.001, 0.001 + error]),
            errors: Errors {
                sigma: Some(error),
                direction_deg: Some(if case == 2 { 1.0 } else { error }),
                flux: Some(error),
                outside: Some(error),
                missing: Some(0.0),
                hemisphere: Some(error),
            },
            lamps: [1, 1],
            fit_db: 40.0,
            doubt: None,
            blames_mesh: false,
            cost: Cost {
                stages: vec![Some(1.0); STAGES.len()],
                total: 8.0,
                peak_bytes: Some(3e8),
                floor: Some(0.5),
            },
        }))
    }

    fn studied(groups: Vec<super::super::Group>) -> Vec<Studied> {
        let outcomes = |group: &super::super::Group| (0..group.cases.len()).map(outcome).collect();
        groups
            .into_iter()
            .map(|group| Studied {
                outcomes: outcomes(&group),
                group,
            })
            .collect()
    }

    fn study(section: Section, groups: Vec<super::super::Group>) -> Study {
        let plan = Plan {
            program: "rekindle".into(),
            only: Vec::new(),
            size: [320, 240],
            seeds: 1,
            rounds: 1,
            threads: None,
            most_megapixels: 1.0,
        };
        Study {
            plan,
            sections: vec![(section, studied(groups))],
        }
    }

    #[test]
    fn a_section_is_renewed_and_the_others_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let write = |study: &Study, earlier: &str| {
            study.write(folder.path(), earlier).unwrap();
            fs::read_to_string(folder.path().join(ACCURACY)).unwrap()
        };
        let stability = study(Section::Stability, stability::groups([320, 240]));
        let scaling = study(Section::Scaling, scaling::groups(1.0));
        let first = write(&stability, "");
        let both = write(&scaling, &first);
        assert!(both.starts_with(&first), "what was studied earlier is kept");
        assert_eq!(write(&stability, &both), both, "sections keep their order");
        assert_eq!(write(&scaling, &both), both);

        assert!(
            both.contains("refused: Too \\| bad |"),
            "one sentence, escaped"
        );
        let lines: Vec<&str> = both.lines().collect();
        let cells = |line: &str| line.replace("\\|", "").matches('|').count();
        for table in lines.chunk_by(|a, b| a.starts_with('|') && b.starts_with('|')) {
            let of_head = cells(table[0]);
            assert!(table.iter().all(|row| cells(row) == of_head), "{table:?}");
        }
        assert!(both.contains("| degrades: directions | yes |"));
        for link in both.split("](").skip(1) {
            let file = link.split(')').next().unwrap();
            assert!(folder.path().join(file).is_file(), "{file}");
        }
        let csv = fs::read_to_string(folder.path().join("stability.csv")).unwrap();
        let cases: usize = stability.sections[0]
            .1
            .iter()
            .map(|s| s.outcomes.len())
            .sum();
        assert_eq!(csv.lines().count(), 1 + cases);
        assert!(csv.contains("refused,0,Too | bad. Go home.,,,"), "{csv}");
        let tables = both.lines().filter(|line| line.starts_with("| "));
        assert!(tables.count() > cases);
    }
}
