//! `rekindle info CAPTURE`: what is in a capture and what is wrong with it.

use super::print_report;
use anyhow::Context as _;
use rekindle_base::text::printable;
use rekindle_capture::{Capture, LightFrame};
use rekindle_estimate::preflight::{Finding, MeshReport, Report, Severity, ViewReport, in_groups};
use std::fmt::Write as _;
use std::path::Path;

/// Checks the capture at `path` and prints the report on stdout, as text or as one JSON object.
pub fn run(path: &Path, json: bool) -> anyhow::Result<()> {
    let (capture, pixels) = Capture::load_counting(path)?;
    let report = Report::new(&capture, &pixels);
    let text = if json {
        serde_json::to_string(&report)? + "\n"
    } else {
        printable(&text(&report)).into_owned()
    };
    print_report(&text).context("the report can't be printed")
}

/// The report as aligned lines.
fn text(report: &Report) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(out, "capture   {}", report.capture);
    let [x, y, z] = report.up;
    let radius = report
        .radius
        .map_or("distant".to_owned(), |radius| format!("radius {radius}"));
    let turning = match report.light_frame {
        None => "",
        Some(LightFrame::World) => ", still with the object",
        Some(LightFrame::Camera) => ", still with the camera (turntable)",
    };
    let _ = writeln!(
        out,
        "lights    {radius}, up [{x:.4}, {y:.4}, {z:.4}]{turning}"
    );
    out.push_str(&mesh_text(&report.mesh));
    let [none, one, two, more] = report.seen_by.map(|share| 100.0 * share);
    let _ = writeln!(
        out,
        "surface   seen by no view {none:.1} %, one {one:.1} %, two {two:.1} %, three or more {more:.1} %"
    );
    let _ = writeln!(out, "\n{}", views_text(&report.views));
    out.push_str(&findings_text(&report.findings));
    out
}

fn mesh_text(mesh: &MeshReport) -> String {
    let uvs = if mesh.has_uvs { "with" } else { "without" };
    format!(
        "mesh      {} triangles, {} positions, {uvs} texture coordinates, diagonal {}\n",
        mesh.triangles, mesh.positions, mesh.diagonal
    )
}

/// A table with one line per view.
fn views_text(views: &[ViewReport]) -> String {
    const HEAD: [&str; 8] = [
        "view",
        "pixels",
        "object",
        "overlap",
        "exposure",
        "saturated",
        "not finite",
        "negative",
    ];
    let optional = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
    let mut rows = vec![HEAD.map(str::to_owned)];
    for view in views {
        let all = f64::from(view.width) * f64::from(view.height);
        rows.push([
            view.name.clone(),
            format!("{}×{}", view.width, view.height),
            format!("{:.1} %", 100.0 * view.object_pixels as f64 / all),
            optional(
                view.silhouette_iou
                    .map(|iou| format!("{:.2} %", 100.0 * iou)),
            ),
            optional(view.relative_exposure.map(|ratio| format!("{ratio:.3}"))),
            view.pixels.saturated.to_string(),
            view.pixels.non_finite.to_string(),
            view.pixels.negative.to_string(),
        ]);
    }
    let width = |column: usize| {
        rows.iter()
            .map(|row| row[column].chars().count())
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..HEAD.len()).map(width).collect();
    let mut out = String::new();
    for row in &rows {
        let mut line = format!("{:<1$}", row[0], widths[0]);
        for (cell, width) in row.iter().zip(&widths).skip(1) {
            let _ = write!(line, "  {cell:>width$}");
        }
        let _ = writeln!(out, "{}", line.trim_end());
    }
    out
}

/// One finding a line; the advice for those of one kind indented below.
fn findings_text(findings: &[Finding]) -> String {
    let subject = findings
        .iter()
        .map(|finding| finding.subject.chars().count())
        .max()
        .unwrap_or(0);
    let mut out = String::new();
    for group in in_groups(findings) {
        let severity = match group[0].severity {
            Severity::Ok => "ok",
            Severity::Note => "note",
            Severity::Warning => "warning",
            Severity::Error => "error",
        };
        for finding in group {
            let _ = writeln!(
                out,
                "{severity:<7}  {:<subject$}  {}",
                finding.subject, finding.message
            );
        }
        if !group[0].advice.is_empty() {
            let _ = writeln!(out, "{:1$}{2}", "", subject + 11, group[0].advice);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_names_every_view_and_finding() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/captures/spot_near");
        let (capture, pixels) = Capture::load_counting(&folder).expect("test capture");
        let report = Report::new(&capture, &pixels);
        let text = text(&report);
        assert!(
            text.contains("radius 3") && text.contains("23424 triangles"),
            "{text}"
        );
        for view in &report.views {
            assert!(
                text.contains(&format!("\n{}  320×240", view.name)),
                "{text}"
            );
        }
        for finding in &report.findings {
            assert!(
                text.contains(&finding.message) && text.contains(&finding.advice),
                "{text}"
            );
        }
    }
}
