//! What came of a comparison, as files: `iterations.csv`, `runs.csv`, `bench.md` and a plot for each capture.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

use super::record::Run;
use super::table::{cell, field, mebibytes, percent, with_unit};
use super::{name, plot};
use rekindle_base::math::median;
use rekindle_estimate::estimate::Method;

/// All runs of a comparison, capture by capture, in the order in which they were made.
#[derive(Clone, Debug)]
pub struct Report {
    /// At least one.
    pub runs: Vec<Run>,
}

impl Report {
    /// Writes all files into a folder that exists; returns their names.
    pub fn write(&self, folder: &Path) -> io::Result<Vec<String>> {
        let mut files = vec![
            ("iterations.csv".to_owned(), self.iterations_csv()),
            ("runs.csv".to_owned(), self.runs_csv()),
        ];
        let mut plots = Vec::new();
        for capture in self.captures() {
            let runs: Vec<&Run> = self.of(capture).filter(|run| run.round == 1).collect();
            let file = format!("{capture}.svg");
            files.push((file.clone(), plot::plot(&runs)?));
            plots.push((capture, file));
        }
        files.push(("bench.md".to_owned(), self.markdown(&plots)));
        for (name, text) in &files {
            fs::write(folder.join(name), text)?;
        }
        Ok(files.into_iter().map(|(name, _)| name).collect())
    }

    /// The captures' names, each once.
    fn captures(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for run in &self.runs {
            if !names.contains(&run.capture.as_str()) {
                names.push(&run.capture);
            }
        }
        names
    }

    fn of<'s>(&'s self, capture: &'s str) -> impl Iterator<Item = &'s Run> {
        self.runs.iter().filter(move |run| run.capture == capture)
    }

    /// The methods, each once.
    fn methods(&self) -> Vec<Method> {
        let mut methods: Vec<Method> = Vec::new();
        for run in &self.runs {
            if !methods.contains(&run.method) {
                methods.push(run.method);
            }
        }
        methods
    }

    /// Stages of a solve, in order.
    fn stages(&self) -> Vec<&str> {
        let first = self.runs.first().map(|run| &run.stages);
        first
            .into_iter()
            .flatten()
            .map(|(stage, _)| stage.as_str())
            .collect()
    }

    /// A row for every iteration of every run.
    pub fn iterations_csv(&self) -> String {
        let mut text = String::from(
            "capture,method,round,iteration,elapsed_s,objective,residual_rms,sigma,sigma_error_pct,\
             direction_error_deg,flux_error_pct,hemisphere_error_pct\n",
        );
        for run in &self.runs {
            for step in &run.steps {
                let (i, e) = (&step.iteration, &step.errors);
                // Writing into a string can't fail.
                let _ = writeln!(
                    text,
                    "{},{},{},{},{:.4},{:e},{:e},{},{},{},{},{}",
                    field(&run.capture),
                    name(run.method),
                    run.round,
                    i.iteration,
                    i.elapsed_s,
                    i.objective,
                    i.residual_rms,
                    i.sigma,
                    cell(percent(e.sigma), 4),
                    cell(e.direction_deg, 4),
                    cell(percent(e.flux), 4),
                    cell(percent(e.hemisphere), 4),
                );
            }
        }
        text
    }

    /// A row for every run.
    pub fn runs_csv(&self) -> String {
        let stages = self.stages();
        let mut text = String::from(
            "capture,method,round,sigma,lamps,sigma_error_pct,direction_error_deg,flux_error_pct,hemisphere_error_pct,\
             novel_psnr_db,alone_psnr_db,moved_psnr_db,solve_s,peak_mib",
        );
        for stage in &stages {
            let _ = write!(text, ",{stage}_s");
        }
        text.push('\n');
        for run in &self.runs {
            let (e, v) = (&run.errors, &run.views);
            let cells = [
                field(&run.capture),
                name(run.method).to_owned(),
                run.round.to_string(),
                cell(run.sigma, 6),
                run.lamps.to_string(),
                cell(percent(e.sigma), 4),
                cell(e.direction_deg, 4),
                cell(percent(e.flux), 4),
                cell(percent(e.hemisphere), 4),
                cell(v.novel_mean(), 3),
                cell(v.alone_mean(), 3),
                cell(v.moved_mean(), 3),
                cell(Some(run.seconds()), 4),
                cell(mebibytes(run.peak_bytes.map(|b| b as f64)), 1),
            ];
            let seconds = |stage: &&str| {
                let found = run.stages.iter().find(|(name, _)| name == stage);
                cell(found.map(|(_, s)| *s), 4)
            };
            let cells = cells.into_iter().chain(stages.iter().map(seconds));
            let _ = writeln!(text, "{}", cells.collect::<Vec<_>>().join(","));
        }
        text
    }

    /// Tables of errors, stages and ratios, with the plots.
    fn markdown(&self, plots: &[(&str, String)]) -> String {
        let mut text = String::from(
            "# Error against run time\n\nErrors are those of the worst lamp; fluxes and hemispheres are compared up to one \
             factor. PSNR in dB, means over the views. Solve is reading and solving without writing.\n\n",
        );
        self.add_errors(&mut text);
        text.push_str("\n## Seconds of each stage\n\n");
        self.add_stages(&mut text);
        self.add_skipped(&mut text);
        self.add_ratios(&mut text);
        for (capture, file) in plots {
            let _ = write!(text, "\n![Error against seconds, {capture}](<{file}>)\n");
        }
        text
    }

    fn add_errors(&self, text: &mut String) {
        text.push_str(
            "| capture | method | σ | direction | flux | hemisphere | novel | alone | moved | solve | peak |\n\
             | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
        );
        for run in self.runs.iter().filter(|run| run.round == 1) {
            let (e, v) = (&run.errors, &run.views);
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {:.2} s | {} |",
                run.capture,
                name(run.method),
                with_unit(cell(percent(e.sigma), 2), " %"),
                with_unit(cell(e.direction_deg, 2), "°"),
                with_unit(cell(percent(e.flux), 2), " %"),
                with_unit(cell(percent(e.hemisphere), 1), " %"),
                with_unit(cell(v.novel_mean(), 1), ""),
                with_unit(cell(v.alone_mean(), 1), ""),
                with_unit(cell(v.moved_mean(), 1), ""),
                run.seconds(),
                with_unit(cell(mebibytes(run.peak_bytes.map(|b| b as f64)), 0), " MiB"),
            );
        }
    }

    fn add_stages(&self, text: &mut String) {
        let stages = self.stages();
        let _ = writeln!(text, "| capture | method | {} |", stages.join(" | "));
        let _ = writeln!(text, "| --- | --- |{}", " --- |".repeat(stages.len()));
        for run in self.runs.iter().filter(|run| run.round == 1) {
            let seconds: Vec<String> = run.stages.iter().map(|(_, s)| format!("{s:.2}")).collect();
            let _ = writeln!(
                text,
                "| {} | {} | {} |",
                run.capture,
                name(run.method),
                seconds.join(" | ")
            );
        }
    }

    /// What was left out, as parts of all there was.
    fn add_skipped(&self, text: &mut String) {
        text.push_str("\n## Left out as the capture doesn't need it\n\n");
        let mut names: Vec<&str> = Vec::new();
        for count in self.runs.iter().flat_map(|run| &run.skipped.left_out) {
            if !names.contains(&count.what.as_str()) {
                names.push(&count.what);
            }
        }
        let _ = writeln!(text, "| capture | method | {} |", names.join(" | "));
        let _ = writeln!(text, "| --- | --- |{}", " --- |".repeat(names.len()));
        for run in self.runs.iter().filter(|run| run.round == 1) {
            let parts = names.iter().map(|name| {
                let count = run.skipped.left_out.iter().find(|c| c.what == *name);
                let part = count.map(|c| 100.0 * c.left_out as f64 / c.all.max(1) as f64);
                with_unit(cell(part, 1), " %")
            });
            let _ = writeln!(
                text,
                "| {} | {} | {} |",
                run.capture,
                name(run.method),
                parts.collect::<Vec<_>>().join(" | ")
            );
        }
    }

    /// Every method over the first, of the same round: medians over the rounds.
    fn add_ratios(&self, text: &mut String) {
        let methods = self.methods();
        let Some((first, others)) = methods
            .split_first()
            .filter(|(_, others)| !others.is_empty())
        else {
            return;
        };
        let first = name(*first);
        let _ = writeln!(
            text,
            "\n## Ratios to {first}, both from one run\n\n\
             | capture | method | solve | σ error | direction error | flux error | hemisphere error |\n\
             | --- | --- | --- | --- | --- | --- | --- |"
        );
        for capture in self.captures() {
            for &other in others {
                let ratios: Vec<String> = RATIOS
                    .iter()
                    .map(|value| cell(self.ratio(capture, methods[0], other, *value), 2))
                    .collect();
                let _ = writeln!(
                    text,
                    "| {capture} | {} | {} |",
                    name(other),
                    ratios.join(" | ")
                );
            }
        }
    }

    /// Median over the rounds of one method's value over another's.
    pub fn ratio(
        &self,
        capture: &str,
        under: Method,
        over: Method,
        value: fn(&Run) -> Option<f64>,
    ) -> Option<f64> {
        let of = |method: Method, round: u32| {
            let run = self
                .of(capture)
                .find(|run| run.method == method && run.round == round)?;
            value(run)
        };
        let rounds = self.of(capture).map(|run| run.round).max().unwrap_or(0);
        let ratios = (1..=rounds)
            .filter_map(|round| Some(of(over, round)? / of(under, round)?))
            .filter(|ratio| ratio.is_finite());
        median(&mut ratios.collect::<Vec<_>>())
    }
}

/// What methods are compared by.
const RATIOS: [fn(&Run) -> Option<f64>; 5] = [
    |run| Some(run.seconds()),
    |run| run.errors.sigma.map(f64::abs),
    |run| run.errors.direction_deg,
    |run| run.errors.flux,
    |run| run.errors.hemisphere,
];
