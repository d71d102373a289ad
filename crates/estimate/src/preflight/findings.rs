//! What the numbers of a report mean, and what to do about them.

use std::cmp::Reverse;

use super::{Finding, Kind, Report, Severity, ViewReport, are_misplaced, is_seen, mean_overlap};

/// Intersection over union below which silhouettes are worth a warning, and below which nothing fits.
pub(super) const IOU_FAIR: f64 = 0.95;
const IOU_HOPELESS: f64 = 0.5;

const ALIGN: &str =
    "The mesh may be in another frame than the cameras: rekindle align CAPTURE finds its place.";

/// Relative difference of exposure that is worth a warning.
const EXPOSURE: f64 = 0.1;

/// Collects findings.
#[derive(Default)]
struct Findings(Vec<Finding>);

impl Findings {
    fn add(&mut self, severity: Severity, subject: &str, message: impl Into<String>, advice: &str) {
        self.0.push(Finding {
            severity,
            kind: None,
            subject: subject.to_owned(),
            message: message.into(),
            advice: advice.to_owned(),
        });
    }

    /// Of a view, which others may have in common with it.
    fn of_view(
        &mut self,
        kind: Kind,
        (severity, view): (Severity, &ViewReport),
        message: impl Into<String>,
        advice: &str,
    ) {
        self.0.push(Finding {
            severity,
            kind: Some(kind),
            subject: view.name.clone(),
            message: message.into(),
            advice: advice.to_owned(),
        });
    }

    /// Those of one kind follow one another.
    fn worst_first(self) -> Vec<Finding> {
        let mut findings = self.0;
        findings.sort_by_key(|finding| (Reverse(finding.severity), finding.kind));
        findings
    }
}

/// Judges a report; `warnings` are what loading had to say. The worst come first.
pub(super) fn judge(report: &Report, warnings: &[String]) -> Vec<Finding> {
    let mut findings = Findings::default();
    for warning in warnings {
        findings.add(Severity::Note, "input", warning.as_str(), "");
    }
    sizes(report, &mut findings);
    places(&report.views, &mut findings);
    for view in &report.views {
        pixels(view, &mut findings);
    }
    exposures(report, &mut findings);
    coverage(report, &mut findings);
    mesh(report, &mut findings);
    findings.worst_first()
}

/// What is wrong with where cameras and mesh are, the worst first.
pub(super) fn judge_places(views: &[ViewReport]) -> Vec<Finding> {
    let mut findings = Findings::default();
    places(views, &mut findings);
    findings.worst_first()
}

fn places(views: &[ViewReport], findings: &mut Findings) {
    let seen = is_seen(views);
    if !seen {
        let message = "No camera sees the mesh.";
        findings.add(Severity::Error, "mesh", message, ALIGN);
    }
    for view in views {
        place(view, seen, findings);
    }
    silhouettes(views, findings);
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn sizes(report: &Report, findings: &mut Findings) {
    let first = &report.views[0];
    let different = report
        .views
        .iter()
        .any(|v| (v.width, v.height) != (first.width, first.height));
    if different {
        findings.add(
            Severity::Note,
            "images",
            "Images are of different sizes.",
            "",
        );
    }
    for view in report.views.iter().filter(|v| v.width.min(v.height) < 100) {
        let message = format!("The image is only {}×{} pixels.", view.width, view.height);
        findings.of_view(
            Kind::Resolution,
            (Severity::Note, view),
            message,
            "Use the full resolution if there is more.",
        );
    }
}

/// Where the camera is and what it sees of the mesh; `seen` by any other camera.
fn place(view: &ViewReport, seen: bool, findings: &mut Findings) {
    const MATRIX: &str =
        "Check transform_matrix: camera to world, OpenGL axes, in the mesh's frame and units.";
    if view.inside {
        let message = "The camera is inside the mesh.";
        findings.of_view(Kind::Inside, (Severity::Error, view), message, MATRIX);
        return;
    }
    if view.object_pixels == 0 {
        if seen {
            let message = "The camera looks away: it sees nothing of the mesh.";
            findings.of_view(Kind::LooksAway, (Severity::Error, view), message, MATRIX);
        }
        return;
    }
    let share = view.object_pixels as f64 / (f64::from(view.width) * f64::from(view.height));
    if share < 0.02 {
        let message = format!("The object fills only {} of the image.", percent(share));
        findings.of_view(
            Kind::Small,
            (Severity::Note, view),
            message,
            "Move closer: highlights need pixels.",
        );
    }
    if view.border_share > 0.02 {
        let message = format!(
            "The object is cropped: it covers {} of the image's border.",
            percent(view.border_share)
        );
        findings.of_view(Kind::Cropped, (Severity::Note, view), message, "");
    }
    if view.back_share > 0.01 {
        let message = format!(
            "{} of the object's pixels show the back of triangles.",
            percent(view.back_share)
        );
        let advice =
            "Close the mesh's holes, or recalculate its normals so that all faces point outwards.";
        findings.of_view(Kind::Backs, (Severity::Warning, view), message, advice);
    }
}

fn pixels(view: &ViewReport, findings: &mut Findings) {
    let all = f64::from(view.width) * f64::from(view.height);
    let counts = view.pixels;
    if view.saturated_share > 0.002 {
        let message = format!(
            "{} of the object's pixels are saturated.",
            percent(view.saturated_share)
        );
        findings.of_view(
            Kind::Saturated,
            (Severity::Warning, view),
            message,
            "Add shorter exposures: highlights carry the lighting.",
        );
    }
    for (kind, count, what, advice) in [
        (
            Kind::NonFinite,
            counts.non_finite,
            "not finite",
            "Find out which program wrote them and export anew.",
        ),
        (
            Kind::Negative,
            counts.negative,
            "negative",
            "Check the black level that was subtracted, or a sharpening filter.",
        ),
    ] {
        let share = count as f64 / all;
        if share > 0.01 {
            let message = format!("{} of the pixels are {what}.", percent(share));
            findings.of_view(kind, (Severity::Warning, view), message, advice);
        }
    }
}

fn silhouettes(views: &[ViewReport], findings: &mut Findings) {
    const ADVICE: &str =
        "Check this view's matrix and intrinsics, the mesh's frame, and the mask or alpha.";
    let known: Vec<(&ViewReport, f64)> = views
        .iter()
        .filter(|view| view.object_pixels > 0 && !view.inside)
        .filter_map(|view| Some((view, view.silhouette_iou?)))
        .collect();
    let advice = if are_misplaced(views) { ALIGN } else { ADVICE };
    for &(view, iou) in known.iter().filter(|(_, iou)| *iou < IOU_FAIR) {
        let severity = if iou < IOU_HOPELESS {
            Severity::Error
        } else {
            Severity::Warning
        };
        let [x, y] = view.silhouette_shift.unwrap_or_default();
        let message = format!(
            "Mesh and alpha overlap by only {} (intersection over union); the picture lies {x:+.1}, {y:+.1} pixels (right, \
             down) from the mesh.",
            percent(iou)
        );
        findings.of_view(Kind::Overlap, (severity, view), message, advice);
    }
    let least = known
        .iter()
        .map(|(_, iou)| *iou)
        .fold(f64::INFINITY, f64::min);
    if mean_overlap(views).is_none() {
        let message = "No image has alpha or a mask: what the object covers is taken from the mesh, and the two cannot be compared.";
        findings.add(
            Severity::Note,
            "silhouettes",
            message,
            "Add mask_path if the result looks misplaced.",
        );
    } else if !known.is_empty() && least >= IOU_FAIR {
        let message = format!(
            "Mesh and alpha agree: the least overlap in a view is {}.",
            percent(least)
        );
        findings.add(Severity::Ok, "silhouettes", message, "");
    }
}

fn exposures(report: &Report, findings: &mut Findings) {
    let known: Vec<(&ViewReport, f64)> = report
        .views
        .iter()
        .filter_map(|view| Some((view, view.relative_exposure?)))
        .collect();
    let odd = |ratio: f64| (ratio - 1.0).abs() > EXPOSURE;
    for &(view, ratio) in known.iter().filter(|(_, ratio)| odd(*ratio)) {
        let (times, word) = if ratio > 1.0 {
            (ratio, "brighter")
        } else {
            (1.0 / ratio, "darker")
        };
        let message = format!(
            "The view is {times:.2} times {word} than the others at the same points of the surface."
        );
        let advice = "Differences are evened out, unless exposures are trusted. Better is one exposure and white balance for all views: \
             fixed by hand in the camera, or by exposures[].";
        findings.of_view(Kind::Exposure, (Severity::Warning, view), message, advice);
    }
    if !known.is_empty() && !known.iter().any(|(_, ratio)| odd(*ratio)) {
        let off = known
            .iter()
            .map(|(_, ratio)| (ratio - 1.0).abs())
            .fold(0.0, f64::max);
        let message = format!("All views have the same exposure, within {}.", percent(off));
        findings.add(Severity::Ok, "exposure", message, "");
    }
}

/// How many views see each point.
fn coverage(report: &Report, findings: &mut Findings) {
    let [none, one, two, more] = report.seen_by;
    if report.views.len() == 1 {
        let message = "There is one view only: texture and highlights cannot be told apart.";
        findings.add(
            Severity::Warning,
            "views",
            message,
            "Take at least three, from directions 20° to 60° apart.",
        );
        return;
    }
    let several = two + more;
    if several < 0.02 {
        let message = "Views have nothing of the surface in common: texture and highlights cannot be told apart.";
        findings.add(
            Severity::Warning,
            "views",
            message,
            "Take views that overlap, 20° to 60° apart.",
        );
    } else if several < 0.4 {
        let message = format!(
            "Only {} of the surface is seen by two views or more.",
            percent(several)
        );
        findings.add(
            Severity::Warning,
            "views",
            message,
            "Add views between the existing ones.",
        );
    } else {
        let message = format!(
            "{} of the surface is seen by two views or more.",
            percent(several)
        );
        findings.add(Severity::Ok, "views", message, "");
    }
    if none > 0.02 {
        let message = format!(
            "{} of the surface is seen by no view and will be filled in.",
            percent(none)
        );
        findings.add(
            Severity::Note,
            "views",
            message,
            "Add views of these sides if renderings show them.",
        );
    }
    if one > 0.3 {
        let message = format!(
            "{} of the surface is seen by one view only: highlights may stay in its texture.",
            percent(one)
        );
        findings.add(
            Severity::Note,
            "views",
            message,
            "Add views between the existing ones.",
        );
    }
}

fn mesh(report: &Report, findings: &mut Findings) {
    let mesh = &report.mesh;
    let edges = mesh.triangles as f64 * 1.5;
    let mut clean = true;
    let mut add = |severity, message: String, advice: &str| {
        clean = false;
        findings.add(severity, "mesh", message, advice);
    };
    if mesh.flipped_edges > 0 {
        let message = format!(
            "{} edges join triangles wound against each other.",
            mesh.flipped_edges
        );
        let many = mesh.flipped_edges as f64 > 0.001 * edges;
        let severity = if many {
            Severity::Warning
        } else {
            Severity::Note
        };
        add(
            severity,
            message,
            "Recalculate the normals outside (Blender: Mesh > Normals > Recalculate Outside).",
        );
    }
    if mesh.normals_against_faces > 0.005 {
        let message = format!(
            "On {} of the surface a vertex normal points to the back of its triangle.",
            percent(mesh.normals_against_faces)
        );
        add(
            Severity::Warning,
            message,
            "Recalculate its normals; where it has none of its own, its faces fold there or face both ways.",
        );
    }
    if mesh.non_manifold_edges > 0 {
        let message = format!(
            "{} edges have three triangles or more.",
            mesh.non_manifold_edges
        );
        add(
            Severity::Note,
            message,
            "Clean up inner and double faces if the shading looks wrong there.",
        );
    }
    if mesh.duplicate_triangles > 0 {
        let message = format!("{} triangles occur twice.", mesh.duplicate_triangles);
        add(Severity::Note, message, "Merge doubles.");
    }
    if mesh.boundary_edges > 0 {
        let message = format!(
            "The surface is open: {} edges have one triangle only.",
            mesh.boundary_edges
        );
        add(
            Severity::Note,
            message,
            "Holes that lights shine through cast no shadow; close them if you can.",
        );
    }
    if mesh.pieces > 1 {
        let message = format!("The mesh has {} separate pieces.", mesh.pieces);
        add(
            Severity::Note,
            message,
            "Remove floating bits that a scan left.",
        );
    }
    if clean {
        findings.add(
            Severity::Ok,
            "mesh",
            "A closed, consistently wound surface of one piece.",
            "",
        );
    }
}
