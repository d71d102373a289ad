//! Is this capture worth solving? Checks before anyone waits: whether images, cameras and mesh fit together, and what
//! the data can tell.
//!
//! [`Report::new`] measures; `findings` judges the numbers and says what to do. Nothing here changes the capture, and
//! no finding stops a solve.

mod findings;
mod mesh;
mod thumbnail;
mod view;

pub use mesh::MeshReport;
pub use thumbnail::{Thumbnail, outline};
pub use view::ViewReport;

use crate::registration::Agreement;
use rayon::prelude::*;
use rekindle_capture::{Capture, LightFrame, Mesh, PixelCounts, View};
use rekindle_scene::surface::{Occluder, ViewSurface};
use serde::Serialize;

/// Points of the surface at which views are compared.
const POINTS: usize = 20_000;

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// As it should be.
    Ok,
    /// Worth knowing.
    Note,
    /// The result will suffer.
    Warning,
    /// A solve makes no sense before this is put right.
    Error,
}

/// What several views may be found to have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The camera is inside the mesh.
    Inside,
    /// The camera sees nothing of the mesh.
    LooksAway,
    /// Mesh and alpha or mask overlap too little.
    Overlap,
    /// The view is brighter or darker than others.
    Exposure,
    /// Pixels are saturated.
    Saturated,
    /// Pixels are not finite.
    NonFinite,
    /// Pixels are negative.
    Negative,
    /// The back of triangles is seen.
    Backs,
    /// The object is cropped by the image's border.
    Cropped,
    /// The object fills little of the image.
    Small,
    /// The image has few pixels.
    Resolution,
}

/// One thing found out about a capture.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// How much it matters.
    pub severity: Severity,
    /// What it is of a view; none where it is about something else.
    pub kind: Option<Kind>,
    /// What it is about, such as a view's name or "mesh".
    pub subject: String,
    /// What was found.
    pub message: String,
    /// What to do about it; empty where nothing needs doing.
    pub advice: String,
}

/// Everything found out about a capture.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The capture's name.
    pub capture: String,
    /// Unit vector towards the pole of the light hemisphere.
    pub up: [f64; 3],
    /// Radius of the light hemisphere in mesh units, none for distant light.
    pub radius: Option<f64>,
    /// What the lights stand still with, none where that is not stated.
    pub light_frame: Option<LightFrame>,
    /// The mesh.
    pub mesh: MeshReport,
    /// One per view.
    pub views: Vec<ViewReport>,
    /// Share of the surface's area seen by no view, one, two, and three or more.
    pub seen_by: [f64; 4],
    /// Judgements, the worst first; those of one kind follow one another.
    pub findings: Vec<Finding>,
}

impl Report {
    /// Checks a capture; `pixels` are the bad pixels counted while loading it, one entry per view.
    pub fn new(capture: &Capture, pixels: &[PixelCounts]) -> Self {
        let occluder = Occluder::new(&capture.mesh);
        let surfaces: Vec<ViewSurface> = capture
            .views
            .iter()
            .map(|view| ViewSurface::new(&capture.mesh, &occluder, &view.camera))
            .collect();
        let agreement = Agreement::new(&capture.mesh, &capture.views, &surfaces, POINTS);
        let exposures = agreement.exposures();
        // Where the light turns, views differ by that.
        let is_still = capture.motions().is_none();
        let views = capture
            .views
            .par_iter()
            .zip(&surfaces)
            .enumerate()
            .map(|(i, (view, surface))| {
                let counts = pixels.get(i).copied().unwrap_or_default();
                let report = ViewReport::new(view, counts, surface, &capture.mesh, &occluder);
                ViewReport {
                    relative_exposure: exposures[i]
                        .filter(|_| is_still)
                        .map(|exposure| exposure.factor),
                    ..report
                }
            })
            .collect();
        let hemisphere = &capture.light_hemisphere;
        let mut report = Self {
            capture: capture.name.clone(),
            up: hemisphere.up.to_array(),
            radius: hemisphere.radius,
            light_frame: hemisphere.frame,
            mesh: MeshReport::new(&capture.mesh),
            views,
            seen_by: agreement.seen_by(),
            findings: Vec::new(),
        };
        report.findings = findings::judge(&report, &capture.warnings);
        report
    }

    /// Whether any camera sees the mesh.
    pub fn is_seen(&self) -> bool {
        is_seen(&self.views)
    }

    /// Whether the mesh seems to be in another frame than the cameras: one view that is off is that view's fault, all are the
    /// mesh's.
    pub fn is_misplaced(&self) -> bool {
        are_misplaced(&self.views)
    }

    /// Mean overlap of the silhouettes over the views that tell it, if any does.
    pub fn mean_overlap(&self) -> Option<f64> {
        mean_overlap(&self.views)
    }
}

fn is_seen(views: &[ViewReport]) -> bool {
    views.iter().any(|view| view.object_pixels > 0)
}

fn are_misplaced(views: &[ViewReport]) -> bool {
    let mut known = views.iter().filter_map(|view| view.silhouette_iou);
    let off = known.clone().count() > 1 && known.all(|iou| iou < findings::IOU_FAIR);
    off || !is_seen(views)
}

fn mean_overlap(views: &[ViewReport]) -> Option<f64> {
    let known: Vec<f64> = views.iter().filter_map(|v| v.silhouette_iou).collect();
    let sum: f64 = known.iter().sum();
    (!known.is_empty()).then(|| sum / known.len() as f64)
}

/// What is wrong with where cameras and mesh are: the findings from [`Severity::Warning`] on, the worst first, each with the view that it is
/// about, if it is about one. One surface a view.
pub fn misplacements(
    views: &[View],
    surfaces: &[ViewSurface],
    mesh: &Mesh,
    occluder: &Occluder,
) -> Vec<(Option<usize>, Finding)> {
    let reports: Vec<ViewReport> = (views.par_iter().zip(surfaces))
        .map(|(view, surface)| {
            ViewReport::new(view, PixelCounts::default(), surface, mesh, occluder)
        })
        .collect();
    let found = findings::judge_places(&reports).into_iter();
    let severe = found.filter(|finding| finding.severity >= Severity::Warning);
    let of = |finding: &Finding| views.iter().position(|view| view.name == finding.subject);
    severe.map(|finding| (of(&finding), finding)).collect()
}

/// Findings by what views have in common, in the same order: each is one, or one of each of several views.
pub fn in_groups(findings: &[Finding]) -> impl Iterator<Item = &[Finding]> {
    findings.chunk_by(|a, b| a.severity == b.severity && is_same_kind(a, b))
}

fn is_same_kind(a: &Finding, b: &Finding) -> bool {
    a.kind.is_some() && a.kind == b.kind
}

/// Why a solve's result is not to be trusted for some of [`misplacements`], in whole sentences: each kind once with the first view that
/// has it.
pub fn why_misplaced<'a>(found: impl IntoIterator<Item = &'a Finding>) -> Vec<String> {
    let mut kinds: Vec<(&Finding, usize)> = Vec::new();
    for finding in found {
        match kinds
            .iter_mut()
            .find(|(kind, _)| is_same_kind(kind, finding))
        {
            Some((_, times)) => *times += 1,
            None => kinds.push((finding, 1)),
        }
    }
    let sentences = kinds.into_iter();
    sentences
        .map(|(finding, times)| sentence(finding, times))
        .collect()
}

fn sentence(finding: &Finding, times: usize) -> String {
    let others = match times {
        1 => String::new(),
        2 => " The same in another view.".to_owned(),
        _ => format!(" The same in {} other views.", times - 1),
    };
    let Finding {
        subject,
        message,
        advice,
        ..
    } = finding;
    format!("{subject}: {message}{others} The result is not to be trusted. {advice}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::sync::Arc;

    /// A capture with known truth of the repository.
    fn capture() -> (Capture, Vec<PixelCounts>) {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/captures/spot_paper");
        Capture::load_counting(&folder).expect("test capture")
    }

    fn finding<'a>(report: &'a Report, part: &str) -> Option<&'a Finding> {
        report
            .findings
            .iter()
            .find(|finding| finding.message.contains(part))
    }

    #[test]
    fn a_good_capture_has_nothing_to_warn_of() {
        let (capture, pixels) = capture();
        let report = Report::new(&capture, &pixels);
        let worst = report.findings.iter().map(|f| f.severity).max();
        assert!(worst < Some(Severity::Warning), "{:#?}", report.findings);
        for view in &report.views {
            assert!(view.silhouette_iou.expect("alpha") > 0.97, "{view:?}");
            assert!(
                (view.relative_exposure.expect("shared points") - 1.0).abs() < 0.05,
                "{view:?}"
            );
            assert!(!view.inside);
        }
        assert!((report.seen_by.iter().sum::<f64>() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_view_of_another_exposure_is_found() {
        let (mut capture, pixels) = capture();
        for pixel in &mut Arc::make_mut(&mut capture.views[2].photograph).radiance {
            *pixel = pixel.map(|v| 1.5 * v);
        }
        let report = Report::new(&capture, &pixels);
        let found = report.views[2].relative_exposure.expect("shared points");
        assert!((found - 1.5).abs() < 0.1, "{found}");
        let finding = finding(&report, "brighter").expect("a finding");
        assert_eq!(
            (finding.severity, finding.subject.as_str()),
            (Severity::Warning, report.views[2].name.as_str())
        );
    }

    #[test]
    fn cameras_that_do_not_fit_are_found() {
        let (mut capture, pixels) = capture();
        let centre = capture.mesh.centre().as_dvec3();
        // One camera in the object, one looking away, one turned a little.
        capture.views[0].camera.world_from_camera.translation = centre;
        let pose = &mut capture.views[1].camera.world_from_camera;
        pose.matrix3 *= glam::DMat3::from_rotation_y(std::f64::consts::PI);
        let pose = &mut capture.views[2].camera.world_from_camera;
        pose.matrix3 *= glam::DMat3::from_rotation_y(0.05);
        let report = Report::new(&capture, &pixels);
        let subject = |part: &str| finding(&report, part).map(|f| (f.severity, f.subject.clone()));
        let name = |i: usize| capture.views[i].name.clone();
        assert_eq!(subject("inside the mesh"), Some((Severity::Error, name(0))));
        assert_eq!(
            subject("sees nothing of the mesh"),
            Some((Severity::Error, name(1)))
        );
        let shifted = report
            .findings
            .iter()
            .find(|f| f.subject == name(2) && f.message.contains("overlap"));
        assert!(
            shifted.is_some_and(|f| f.severity >= Severity::Warning),
            "{:#?}",
            report.findings
        );
    }

    #[test]
    fn a_mesh_in_another_frame_is_one_finding() {
        let (mut capture, pixels) = capture();
        assert!(!Report::new(&capture, &pixels).is_misplaced());
        for p in &mut capture.mesh.positions {
            *p += glam::Vec3::new(0.4, 0.0, 0.0);
        }
        let shifted = Report::new(&capture, &pixels);
        assert!(shifted.is_misplaced() && shifted.is_seen());
        assert!(shifted.mean_overlap() < Some(0.9));
        for p in &mut capture.mesh.positions {
            *p += glam::Vec3::new(0.0, 1e4, 0.0);
        }
        let far = Report::new(&capture, &pixels);
        assert!(far.is_misplaced() && !far.is_seen());
        let errors = far
            .findings
            .iter()
            .filter(|f| f.severity == Severity::Error);
        assert_eq!(errors.count(), 1, "{:#?}", far.findings);
        assert!(finding(&far, "No camera sees the mesh").is_some());
        assert!(finding(&far, "alpha or a mask").is_none());
    }

    #[test]
    fn what_views_have_in_common_is_one_group() {
        let (mut capture, pixels) = capture();
        for view in [0, 3] {
            let pose = &mut capture.views[view].camera.world_from_camera;
            pose.matrix3 *= glam::DMat3::from_rotation_y(std::f64::consts::PI);
        }
        let report = Report::new(&capture, &pixels);
        let away = in_groups(&report.findings).find(|group| group[0].kind == Some(Kind::LooksAway));
        let subjects = away.map(|group| group.iter().map(|f| f.subject.clone()).collect());
        let views = [0, 3].map(|i| capture.views[i].name.clone()).to_vec();
        assert_eq!(subjects, Some(views), "{:#?}", report.findings);
        let all: usize = in_groups(&report.findings).map(<[Finding]>::len).sum();
        assert_eq!(all, report.findings.len());
    }

    #[test]
    fn scale_does_not_matter() {
        let (capture, pixels) = capture();
        let mut dim = capture.clone();
        for pixel in dim
            .views
            .iter_mut()
            .flat_map(|view| &mut Arc::make_mut(&mut view.photograph).radiance)
        {
            *pixel = pixel.map(|v| v * 2.0_f32.powi(-13));
        }
        let (bright, dim) = (Report::new(&capture, &pixels), Report::new(&dim, &pixels));
        for (a, b) in bright.views.iter().zip(&dim.views) {
            let of = |view: &ViewReport| view.relative_exposure.expect("shared points");
            assert!((of(a) - of(b)).abs() < 1e-12, "{} and {}", of(a), of(b));
        }
    }

    #[test]
    fn one_view_is_said_to_be_too_few() {
        let (mut capture, pixels) = capture();
        capture.views.truncate(1);
        let report = Report::new(&capture, &pixels);
        assert!(finding(&report, "one view").is_some_and(|f| f.severity == Severity::Warning));
        assert_eq!(report.views[0].relative_exposure, None);
    }
}
