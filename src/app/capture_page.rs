//! The page of a capture before it is solved: what is in it, what is wrong with it, and how to estimate.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::{
    self, Color32, ColorImage, CornerRadius, Grid, RichText, ScrollArea, Sense, Stroke, StrokeKind,
    TextureHandle, TextureOptions, vec2,
};

use super::commands::Action;
use super::estimation::sentence;
use super::known_light::KnownLightChoice;
use super::placing::{Outcome, Placing, State};
use super::points::ByPoints;
use super::projects::Then;
use super::settings::Estimation;
use super::theme::Mark;
use super::{Request, Shared, exposures, theme};
use crate::worker::{OpenedCapture, Source, Worker};
use rekindle_capture::{Capture, LightFrame};
use rekindle_estimate::align::{Alignment, MarkedPoint};
use rekindle_estimate::estimate::{Method, STATED_ROUGHNESS};
use rekindle_estimate::preflight::{Finding, Severity, Thumbnail, in_groups};
use rekindle_scene::reflectance::SpecularModel;
use rekindle_solution::{LightProbe, Solution};

/// The roughness that is suggested to a user who knows it: a varnish or a glaze.
const USUAL_ROUGHNESS: f32 = 0.3;

/// Narrowest thumbnail, points.
const THUMBNAIL: f32 = 210.0;

/// A capture as the page shows it.
pub struct CapturePage {
    placing: Placing,
    /// Photograph and outline of each view.
    textures: Vec<[TextureHandle; 2]>,
    /// A view shown large.
    large: Option<usize>,
    /// Points are being set.
    by_points: Option<ByPoints>,
    /// Where the light of the place is chosen.
    light: KnownLightChoice,
}

impl CapturePage {
    /// Shows a capture that was opened.
    pub fn new(ctx: &egui::Context, opened: OpenedCapture) -> Self {
        Self {
            textures: upload_all(ctx, &opened),
            placing: Placing::new(opened),
            large: None,
            by_points: None,
            light: KnownLightChoice::default(),
        }
    }

    /// What was opened, with the mesh where it lies now.
    pub fn opened(&self) -> &Arc<OpenedCapture> {
        &self.placing.now.opened
    }

    /// The capture.
    pub fn capture(&self) -> &Arc<Capture> {
        &self.opened().capture
    }

    /// Whether it is the built-in one.
    pub fn is_demo(&self) -> bool {
        self.opened().source == Source::Demo
    }

    /// Where it was read from, unless it is built in.
    pub fn path(&self) -> Option<PathBuf> {
        match &self.opened().source {
            Source::Demo => None,
            Source::Path(path) => Some(path.clone()),
        }
    }

    /// The picture of the light, where it is known.
    pub fn known_light(&self) -> Option<LightProbe> {
        let light = self.placing.now.light.as_ref();
        light.map(|light| light.probe().clone())
    }

    /// Reads the picture of the light.
    pub fn choose_light(&mut self, worker: &mut Worker, path: &Path) {
        self.light.read(worker, path);
    }

    /// Takes the picture of the light once it is read. Says what was wrong with it, once.
    pub fn take_light(&mut self, ctx: &egui::Context) -> Option<String> {
        self.light.take(ctx, &mut self.placing.now.light)
    }

    /// Takes the turn of the known light that a solve found.
    pub fn solved(&mut self, solution: &Solution) {
        if let (Some(light), Some(known)) = (&mut self.placing.now.light, &solution.known_light) {
            light.solved(known);
        }
    }

    /// Seconds that loading it took.
    pub fn load_s(&self) -> f64 {
        self.opened().load_s
    }

    /// Whether any camera sees the mesh, so that there is something to estimate.
    pub fn is_seen(&self) -> bool {
        self.opened().report.is_seen()
    }

    /// Takes the capture with its mesh in another place. Whether it was taken: silhouettes without points may find none better.
    pub fn aligned(
        &mut self,
        ctx: &egui::Context,
        opened: OpenedCapture,
        alignment: &Alignment,
    ) -> bool {
        let now = &self.placing.now;
        let overlap = [
            now.opened.report.mean_overlap(),
            opened.report.mean_overlap(),
        ];
        if self.by_points.is_none() && overlap[1] <= overlap[0] {
            return false;
        }
        let move_point = |point: &MarkedPoint| MarkedPoint {
            place: alignment.transform.apply(point.place),
            marks: point.marks.clone(),
        };
        let points = match &self.by_points {
            Some(by_points) => by_points.points(),
            None => &now.points,
        };
        let next = State {
            points: points.iter().map(move_point).collect(),
            moved: alignment.transform.matrix() * now.moved,
            opened: Arc::new(opened),
            outcome: Some(Outcome {
                overlap,
                ambiguous: alignment.ambiguous,
            }),
            light: now.light.clone(),
        };
        self.leave_points();
        self.placing.change(next);
        self.textures = upload_all(ctx, self.opened());
        true
    }

    /// Whether points are being set.
    pub fn by_points(&self) -> bool {
        self.by_points.is_some()
    }

    /// Lets points be set.
    pub fn set_points(&mut self) {
        if self.by_points.is_none() {
            let points = self.placing.now.points.clone();
            self.by_points = Some(ByPoints::new(self.capture(), points));
        }
    }

    /// Back to the capture; the points are kept.
    fn leave_points(&mut self) {
        if let Some(by_points) = self.by_points.take() {
            self.placing.now.points = by_points.points().to_vec();
        }
    }

    /// Carries out a command about the pictures on which points are set.
    pub fn act(&mut self, action: Action) {
        if let Some(by_points) = &mut self.by_points {
            by_points.act(action);
        }
    }

    /// Whether there is something to undo, or to do again.
    pub fn can(&self, action: Action) -> bool {
        match (action, &self.by_points) {
            (Action::Undo, Some(points)) => points.can_undo(),
            (Action::Undo, None) => self.placing.can_undo(),
            (Action::Redo, Some(points)) => points.can_redo(),
            (Action::Redo, None) => self.placing.can_redo(),
            _ => false,
        }
    }

    /// Undoes the last change of the points, of the mesh's place or of the known light; or does it again.
    pub fn undo(&mut self, ctx: &egui::Context, action: Action) {
        let before = Arc::clone(self.opened());
        match (action, &mut self.by_points) {
            (Action::Undo, Some(points)) => points.undo(),
            (_, Some(points)) => points.redo(),
            (Action::Undo, None) => self.placing.undo(),
            (_, None) => self.placing.redo(),
        }
        self.light.settle(self.placing.now.light.as_ref());
        if !Arc::ptr_eq(&before, self.opened()) {
            self.textures = upload_all(ctx, self.opened());
        }
    }

    /// Writes the mesh where it lies now.
    pub fn save_mesh(&mut self, worker: &mut Worker, path: PathBuf) {
        self.placing.save_mesh(worker, path);
    }

    /// Whether the mesh lies elsewhere than any file says.
    pub fn has_unsaved_place(&self) -> bool {
        self.placing.is_unsaved()
    }

    /// Writes the mesh's place into the capture, or, where it has no file for it, asks where to write the mesh; then something
    /// else is to be done.
    pub(super) fn save_place(&mut self, worker: &mut Worker, then: Then) {
        self.placing.save_place(worker, then);
    }

    /// What came of saving the mesh's place, once: the file and what to do then, or what went wrong.
    pub(super) fn take_saved(&mut self) -> Option<Result<(PathBuf, Option<Then>), String>> {
        self.placing.take_saved()
    }

    /// Shows the page.
    pub(super) fn show(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        if let Some(by_points) = &mut self.by_points {
            if by_points.show(ui, shared, &self.textures) {
                self.leave_points();
            }
            return;
        }
        egui::Panel::left("capture facts")
            .frame(theme::side(ui))
            .resizable(true)
            .default_size(theme::SIDE)
            .size_range(240.0..=420.0)
            .show(ui, |ui| {
                egui::Panel::bottom("estimate")
                    .frame(egui::Frame::new())
                    .show_separator_line(false)
                    .show(ui, |ui| {
                        ui.add_space(8.0);
                        self.start_ui(ui, shared);
                    });
                ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                    self.facts_ui(ui);
                    ui.add_space(theme::GAP);
                    if let Some(brackets) = &self.opened().capture.brackets {
                        exposures::show(ui, brackets);
                        ui.add_space(theme::GAP);
                    }
                    let now = &mut self.placing.now;
                    self.light
                        .show(ui, shared, &now.opened.capture, &mut now.light);
                    ui.add_space(theme::GAP);
                    theme::group(ui, "Estimation");
                    estimation_ui(ui, &mut shared.settings.estimation);
                });
            });
        let light = self.placing.now.light.as_ref();
        if self.light.has_changed(ui.ctx(), light) {
            let before = self.light.settle(light);
            self.placing.keep_light(before);
        }
        let frame = theme::side(ui);
        egui::CentralPanel::default().frame(frame).show(ui, |ui| {
            ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                if self.placing.show(ui, shared) {
                    self.set_points();
                }
                self.views_ui(ui, shared);
                ui.add_space(theme::GAP);
                self.findings_ui(ui);
            });
        });
    }

    fn start_ui(&self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        let hopeless = self
            .opened()
            .report
            .findings
            .iter()
            .any(|f| f.severity == Severity::Error);
        let button = theme::main_button(ui, "Estimate").min_size(vec2(0.0, 38.0));
        let tip = if hopeless {
            "There are errors: a solve makes little sense before they are put right (Ctrl+Enter)"
        } else {
            "Estimate roughness and lights (Ctrl+Enter)"
        };
        let start = ui.vertical_centered_justified(|ui| {
            ui.add_enabled(!shared.busy && self.is_seen(), button)
                .on_hover_text(tip)
                .on_disabled_hover_text("Something is running, or no camera sees the mesh yet")
        });
        if start.inner.clicked() {
            shared.actions.push(Request::Action(Action::Solve));
        }
    }

    fn facts_ui(&self, ui: &mut egui::Ui) {
        let report = &self.opened().report;
        ui.heading(&report.capture)
            .on_hover_text(format!("Read in {:.1} s", self.opened().load_s));
        ui.add_space(4.0);
        let [none, one, two, more] = report.seen_by.map(|share| 100.0 * share);
        let views = report.views.len();
        let first = &report.views[0];
        let radius = report
            .radius
            .map_or("distant".to_owned(), |r| format!("at distance {r}"));
        let turning = match report.light_frame {
            Some(LightFrame::Camera) => ", still with the camera",
            Some(LightFrame::World) | None => "",
        };
        let facts = [
            (
                "Views",
                format!("{views} of {}×{}", first.width, first.height),
            ),
            ("Triangles", grouped(report.mesh.triangles)),
            ("Lights", radius + turning),
            ("Seen by 3 or more", format!("{more:.1} %")),
            ("Seen by 2", format!("{two:.1} %")),
            ("Seen by 1", format!("{one:.1} %")),
            ("Not seen", format!("{none:.1} %")),
        ];
        Grid::new("facts").num_columns(2).show(ui, |ui| {
            for (name, value) in facts {
                ui.weak(name);
                ui.label(value);
                ui.end_row();
            }
        });
    }

    fn views_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        ui.horizontal(|ui| {
            theme::group(ui, "Photographs");
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                // The scroll bar lies there.
                ui.add_space(theme::GAP);
                ui.checkbox(&mut shared.settings.outline, "Outline of the mesh")
                    .on_hover_text("Lay the mesh's outline, as each camera sees it, over the photographs: it must fit");
                if self.large.is_some()
                    && ui
                        .button("All views")
                        .on_hover_text("Back to all photographs")
                        .clicked()
                {
                    self.large = None;
                }
            });
        });
        let outline = shared.settings.outline;
        if let Some(i) = self.large {
            let width = ui.available_width();
            if self.view_ui(ui, i, width, outline).clicked() {
                self.large = None;
            }
            return;
        }
        let gap = ui.spacing().item_spacing.x;
        let room = ui.available_width();
        let columns = (((room + gap) / (THUMBNAIL + gap)) as usize).clamp(1, 4);
        let width = (room - gap * (columns as f32 - 1.0)) / columns as f32 - 1.0;
        Grid::new("views")
            .num_columns(columns)
            .spacing([gap, gap])
            .show(ui, |ui| {
                for i in 0..self.textures.len() {
                    if self.view_ui(ui, i, width, outline).clicked() {
                        self.large = Some(i);
                    }
                    if (i + 1) % columns == 0 {
                        ui.end_row();
                    }
                }
            });
    }

    /// A photograph with its outline and name.
    fn view_ui(&self, ui: &mut egui::Ui, i: usize, width: f32, outline: bool) -> egui::Response {
        let [photograph, edge] = &self.textures[i];
        let size = photograph.size_vec2();
        let (rect, response) =
            ui.allocate_exact_size(vec2(width, width * size.y / size.x), Sense::click());
        let name = self.opened().report.views[i].name.clone();
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, CornerRadius::same(6), theme::STAGE);
        let all = egui::Rect::from_min_max(egui::pos2(0.0, 0.0), egui::pos2(1.0, 1.0));
        painter.image(photograph.id(), rect, all, Color32::WHITE);
        if outline {
            painter.image(edge.id(), rect, all, theme::palette(ui).accent);
        }
        let worst = self.worst(&name);
        let text = format!("{}  {name}", i + 1);
        painter.text(
            rect.left_bottom() + vec2(8.0, -6.0),
            egui::Align2::LEFT_BOTTOM,
            text,
            egui::TextStyle::Small.resolve(ui.style()),
            theme::ON_STAGE,
        );
        let stroke = match worst {
            Some(severity @ (Severity::Warning | Severity::Error)) => {
                Stroke::new(1.5, mark(severity).colour(ui))
            }
            _ if response.hovered() => Stroke::new(1.0, theme::palette(ui).accent),
            _ => Stroke::NONE,
        };
        painter.rect_stroke(rect, CornerRadius::same(6), stroke, StrokeKind::Inside);
        response.widget_info(|| {
            egui::WidgetInfo::labeled(egui::Role::Button, true, format!("View {name}"))
        });
        response.on_hover_text(self.view_tip(i))
    }

    fn view_tip(&self, i: usize) -> String {
        let view = &self.opened().report.views[i];
        let all = f64::from(view.width) * f64::from(view.height);
        let share = 100.0 * view.object_pixels as f64 / all;
        let mut lines = vec![
            view.name.clone(),
            format!(
                "{}×{} pixels, {share:.1} % of them show the object",
                view.width, view.height
            ),
        ];
        if let Some(iou) = view.silhouette_iou {
            lines.push(format!("Silhouettes overlap by {:.2} %", 100.0 * iou));
        }
        if let Some(exposure) = view.relative_exposure {
            lines.push(format!("Exposure against the other views {exposure:.3}"));
        }
        lines.push("Click to see it large".to_owned());
        lines.join("\n")
    }

    fn worst(&self, name: &str) -> Option<Severity> {
        let findings = self.opened().report.findings.iter();
        findings
            .filter(|f| f.subject == name)
            .map(|f| f.severity)
            .max()
    }

    fn findings_ui(&self, ui: &mut egui::Ui) {
        theme::group(ui, "Findings");
        for group in in_groups(&self.opened().report.findings) {
            findings_card(ui, group);
        }
    }
}

/// What more views than this have in common is told of one fewer; of the others, where the pointer rests.
const MOST_OF_A_GROUP: usize = 4;

/// What is found of one thing, or of each of several views.
fn findings_card(ui: &mut egui::Ui, group: &[Finding]) {
    let Finding {
        severity, advice, ..
    } = &group[0];
    let word = match severity {
        Severity::Ok => "Good",
        Severity::Note => "Note",
        Severity::Warning => "Warning",
        Severity::Error => "Error",
    };
    theme::card(ui).show(ui, |ui| {
        ui.set_width(ui.available_width());
        ui.horizontal_top(|ui| {
            mark(*severity).show(ui).on_hover_text(word);
            ui.vertical(|ui| {
                let shown = if group.len() > MOST_OF_A_GROUP {
                    MOST_OF_A_GROUP - 1
                } else {
                    group.len()
                };
                let (shown, others) = group.split_at(shown);
                for finding in shown {
                    ui.horizontal_wrapped(|ui| {
                        ui.label(RichText::new(subject(finding)).strong());
                        ui.label(&finding.message);
                    });
                }
                if !others.is_empty() {
                    let told = |of: &Finding| format!("{}  {}", of.subject, of.message);
                    let told: Vec<String> = others.iter().map(told).collect();
                    let label = ui.label(format!("The same in {} more views", others.len()));
                    label.on_hover_text(told.join("\n"));
                }
                if !advice.is_empty() {
                    ui.weak(advice);
                }
            });
        });
    });
}

/// What a finding is about, in words; names of files stay as they are.
fn subject(finding: &Finding) -> String {
    if finding.kind.is_some() {
        finding.subject.clone()
    } else {
        sentence(&finding.subject)
    }
}

fn mark(severity: Severity) -> Mark {
    match severity {
        Severity::Ok => Mark::Good,
        Severity::Note => Mark::Note,
        Severity::Warning => Mark::Warning,
        Severity::Error => Mark::Error,
    }
}

/// What a method is called.
pub(super) fn method_name(method: Method) -> &'static str {
    match method {
        Method::Fast => "Fast",
        Method::Amuh => "AMUH (paper)",
        Method::Amhu => "AMHU (paper)",
        Method::Plain => "Least squares (paper)",
    }
}

/// What a choice of the lobe is called.
pub(super) fn specular_name(model: Option<SpecularModel>) -> &'static str {
    match model {
        None => "Whichever fits",
        Some(SpecularModel::Paper) => "Paper's (eq. 4)",
        Some(model) => model.name(),
    }
}

/// How to estimate.
pub(super) fn estimation_ui(ui: &mut egui::Ui, settings: &mut Estimation) {
    Grid::new("estimation").num_columns(2).show(ui, |ui| {
        let label = ui.label("Method");
        let name = method_name;
        egui::ComboBox::from_id_salt("method")
            .selected_text(name(settings.method))
            .show_ui(ui, |ui| {
                for (method, tip) in [
                    (Method::Fast, "Variable projection with the diffuse colours eliminated"),
                    (Method::Amuh, "The paper's alternation, lights first: slower and less exact, for comparison"),
                    (Method::Amhu, "The paper's alternation, roughness first: slower and less exact, for comparison"),
                    (Method::Plain, "The paper's least squares without regularisation: slower and least exact, for comparison"),
                ] {
                    ui.selectable_value(&mut settings.method, method, name(method)).on_hover_text(tip);
                }
            })
            .response
            .labelled_by(label.id)
            .on_hover_text("How roughness and lights are estimated");
        ui.end_row();
        let label = ui.label("Specular model");
        let name = specular_name;
        egui::ComboBox::from_id_salt("specular")
            .selected_text(name(settings.specular))
            .show_ui(ui, |ui| {
                for model in std::iter::once(None).chain(SpecularModel::ALL.map(Some)) {
                    ui.selectable_value(&mut settings.specular, model, name(model));
                }
            })
            .response
            .labelled_by(label.id)
            .on_hover_text("Form of the specular lobe: the paper's, Beckmann's or GGX's microfacets with Fresnel factor and masking, a metal's without Fresnel factor, or whichever leaves least unexplained");
        ui.end_row();
        let label = ui.label("Roughness");
        ui.add_enabled_ui(settings.method == Method::Fast, |ui| roughness_ui(ui, &mut settings.roughness, label.id));
        ui.end_row();
        let label = ui.label("Light resolution");
        ui.horizontal(|ui| {
            ui.add(egui::DragValue::new(&mut settings.frequency).range(8..=200))
                .labelled_by(label.id)
                .on_hover_text("Parts into which each edge of the lights' icosahedron is divided: the more, the finer the light");
            let directions = directions(settings.frequency);
            ui.weak(format!("{} directions", grouped(directions)));
        });
        ui.end_row();
        let label = ui.label("Lights");
        ui.horizontal(|ui| {
            let mut near = settings.radius.is_some();
            let text = if near { "Near lights, at a distance of" } else { "Near lights" };
            ui.checkbox(&mut near, text)
                .on_hover_text("Seek the lights at this distance from the object's centre, in mesh units, instead of where the capture says");
            if near != settings.radius.is_some() {
                settings.radius = near.then_some(3.0);
            }
            if let Some(radius) = &mut settings.radius {
                ui.add(egui::DragValue::new(radius).range(1e-3..=1e6).speed(0.02))
                    .labelled_by(label.id)
                    .on_hover_text("Distance from the object's centre, mesh units");
            }
        });
        ui.end_row();
        let label = ui.label("Lights still with");
        egui::ComboBox::from_id_salt("light_frame")
            .selected_text(frame_name(settings.light_frame))
            .show_ui(ui, |ui| {
                for frame in [None, Some(LightFrame::World), Some(LightFrame::Camera)] {
                    ui.selectable_value(&mut settings.light_frame, frame, frame_name(frame));
                }
            })
            .response
            .labelled_by(label.id)
            .on_hover_text("What the lights stood still with: the object, where the camera went around it, or the camera, where the object turned before it on a turntable");
        ui.end_row();
        ui.label("Views");
        ui.checkbox(&mut settings.as_stated, "Trust cameras and exposures").on_hover_text(
            "Take cameras and exposures as the capture states them. Otherwise cameras are turned until the outlines fit, \
             and exposures evened out, where either is clearly off",
        );
        ui.end_row();
    });
    if *settings == Estimation::default() {
        return;
    }
    let reset = ui.button("Reset settings");
    let tip = "Back to the settings that suit most captures";
    if reset.on_hover_text(tip).clicked() {
        *settings = Estimation::default();
    }
}

/// A choice of what the lights stand still with.
fn frame_name(frame: Option<LightFrame>) -> &'static str {
    frame.map_or("As the capture shows", still_with)
}

fn still_with(frame: LightFrame) -> &'static str {
    match frame {
        LightFrame::World => "The object",
        LightFrame::Camera => "The camera (turntable)",
    }
}

/// Whether the roughness is known, and which it is.
fn roughness_ui(ui: &mut egui::Ui, roughness: &mut Option<f32>, label: egui::Id) {
    ui.horizontal(|ui| {
        let mut known = roughness.is_some();
        ui.checkbox(&mut known, "Known")
            .on_hover_text(
                "State the roughness in place of having it estimated: under a wide window or an overcast sky the photographs leave it \
                 open, and the lights follow from it",
            )
            .on_disabled_hover_text("This method estimates the roughness");
        if known != roughness.is_some() {
            *roughness = known.then_some(USUAL_ROUGHNESS);
        }
        if let Some(roughness) = roughness {
            roughness_slider(ui, roughness).labelled_by(label);
        }
    });
}

/// A slider of the roughnesses that may be stated.
pub(super) fn roughness_slider(ui: &mut egui::Ui, roughness: &mut f32) -> egui::Response {
    // Shown as it is, and changed by the user alone.
    let slider = egui::Slider::new(roughness, STATED_ROUGHNESS)
        .custom_formatter(|value, _| format!("{value:.2}"))
        .clamping(egui::SliderClamping::Edits);
    ui.add(slider)
        .on_hover_text("Roughness as Blender has it: 0 is a mirror, 1 is matt")
}

/// Nodes of a hemisphere of this frequency: an icosahedron's upper half, its equator shared.
fn directions(frequency: u32) -> usize {
    let f = frequency as usize;
    5 * f * f + 2 * f + 1
}

fn upload_all(ctx: &egui::Context, opened: &OpenedCapture) -> Vec<[TextureHandle; 2]> {
    let numbered = opened.thumbnails.iter().enumerate();
    numbered.map(|(i, small)| upload(ctx, i, small)).collect()
}

fn upload(ctx: &egui::Context, i: usize, thumbnail: &Thumbnail) -> [TextureHandle; 2] {
    let size = [thumbnail.width as usize, thumbnail.height as usize];
    let photograph = ColorImage::new(
        size,
        thumbnail
            .photograph
            .iter()
            .map(|&[r, g, b]| Color32::from_rgb(r, g, b))
            .collect(),
    );
    let outline = ColorImage::new(
        size,
        thumbnail
            .outline
            .iter()
            .map(|&edge| {
                if edge {
                    Color32::WHITE
                } else {
                    Color32::TRANSPARENT
                }
            })
            .collect(),
    );
    [
        ctx.load_texture(format!("view {i}"), photograph, TextureOptions::LINEAR),
        ctx.load_texture(format!("outline {i}"), outline, TextureOptions::LINEAR),
    ]
}

/// A number with its thousands apart.
pub(super) fn grouped(number: usize) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use rekindle_scene::hemisphere::HemisphereGrid;

    #[test]
    fn the_light_resolution_is_told_in_directions() {
        for frequency in [8, 9, 24, 70] {
            let grid = HemisphereGrid::new(frequency, Vec3::Y, None, Vec3::ZERO);
            assert_eq!(directions(frequency), grid.directions.len());
        }
        assert_eq!(grouped(directions(70)), "24,641");
    }
}
