//! The picture of the object: where it is seen from, how it is shown, and what is under the pointer.

mod compare;
mod display;
mod histogram;

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Button, Color32, Pos2, Rect, RichText, Sense, TextureHandle, TextureOptions, vec2,
};
use glam::{DVec2, DVec3, Vec3};

use super::commands::Action;
use super::navigation::{Habit, Navigation};
use super::theme;
use crate::capture::{Camera, Capture, Mesh};
use crate::relight::{Lighting, ShadingPoint};
use crate::solution::Solution;
use crate::studio::{ViewTransform, luminance};
use crate::surface::Occluder;
use crate::worker::{Latest, Rendered, Shot, Subject, Worker};
use compare::{Compare, Kind};
use display::{Display, Linear};
use histogram::Histogram;

/// Longest side of a picture of the reference renderer, pixels.
const LONGEST: f32 = 400.0;
/// The same while the view moves.
const LONGEST_MOVING: f32 = 180.0;
/// Stops by which a key changes the exposure.
const STEP: f32 = 0.5;
/// Most stops.
const MOST_STOPS: f32 = 12.0;
/// Height of the bar below the picture, points.
const BAR: f32 = 40.0;

/// What the reference renderer was asked for.
const FREE: u64 = 0;
const AT_CAMERA: u64 = 1;

/// A view of the object.
pub struct Viewport {
    navigation: Navigation,
    capture: Option<Arc<Capture>>,
    cameras: Vec<(String, Camera)>,
    /// The input camera that is looked through.
    at: Option<usize>,
    /// Exposure in stops.
    exposure: f32,
    transform: ViewTransform,
    background: [u8; 3],
    /// Radiance that is white at no stops.
    white: f32,
    compare: Compare,
    /// Whether a comparison can be made: not while the estimation runs.
    comparable: bool,
    shots: u64,
    wanted: Option<Wanted>,
    shown: Option<Shown>,
    histogram: Option<Histogram>,
    show_histogram: bool,
    pointer: Option<Pos2>,
    pointed: Option<Pointed>,
    object: Object,
    occluder: Option<Occluder>,
    building: bool,
    built: Arc<Latest<Occluder>>,
    /// Camera and place of the picture that was drawn last.
    last: Option<(Camera, Rect)>,
}

/// Whose mesh is seen.
#[derive(Clone)]
pub enum Object {
    /// A capture's.
    Capture(Arc<Capture>),
    /// A solution's.
    Solution(Arc<Solution>),
}

impl Object {
    fn mesh(&self) -> &Mesh {
        match self {
            Self::Capture(capture) => &capture.mesh,
            Self::Solution(solution) => &solution.mesh,
        }
    }
}

/// A picture of the reference renderer.
struct Shown {
    linear: Linear,
    display: Display,
    texture: TextureHandle,
}

/// What the picture that was asked for last shows.
#[derive(Clone, PartialEq)]
struct Wanted {
    size: [u32; 2],
    position: DVec3,
    forward: DVec3,
    focal: DVec2,
    /// Changes with object and lighting.
    version: u64,
}

/// What is under the pointer.
#[derive(Clone, Copy, Debug)]
struct Pointed {
    pixel: [usize; 2],
    radiance: Vec3,
    other: Option<Vec3>,
}

/// What a viewport shows in this frame.
pub struct Scene<'a, F> {
    /// Who renders.
    pub worker: &'a mut Worker,
    /// Which mouse buttons move the view.
    pub habit: Habit,
    /// Whether the left button has nothing else to do than to move the view.
    pub free: bool,
    /// Changes with object and lighting.
    pub version: u64,
    /// Object and lighting; asked for only when a new picture is needed.
    pub subject: F,
}

impl Viewport {
    /// A view of an object, with the cameras of a capture.
    pub fn new(object: Object, up: Vec3, capture: Option<&Arc<Capture>>) -> Self {
        let views = capture.map_or(&[][..], |capture| &capture.views);
        let first = views.first().map(|v| &v.camera);
        Self {
            navigation: Navigation::new(object.mesh(), up.as_dvec3(), first),
            capture: capture.cloned(),
            cameras: views
                .iter()
                .map(|v| (v.name.clone(), v.camera.clone()))
                .collect(),
            at: None,
            exposure: 0.0,
            transform: ViewTransform::Srgb,
            background: [18; 3],
            white: 1.0,
            compare: Compare::default(),
            comparable: false,
            shots: 0,
            wanted: None,
            shown: None,
            histogram: None,
            show_histogram: false,
            pointer: None,
            pointed: None,
            object,
            occluder: None,
            building: false,
            built: Arc::default(),
            last: None,
        }
    }

    /// Number of input cameras.
    pub fn cameras(&self) -> usize {
        self.cameras.len()
    }

    /// Sets the radiance that is white at no stops.
    pub fn set_white(&mut self, white: f32) {
        self.white = white;
    }

    /// Allows the comparison with the photographs: the subject is a solution.
    pub fn allow_comparison(&mut self) {
        self.comparable = self.capture.is_some();
    }

    /// Carries out a command about the view.
    pub fn act(&mut self, action: Action) {
        match action {
            Action::Frame => {
                self.leave_camera();
                self.navigation.frame();
            }
            Action::ResetView => {
                self.leave_camera();
                self.navigation.reset();
            }
            Action::Camera(n) => self.go_to(usize::from(n)),
            Action::Brighter => self.exposure = (self.exposure + STEP).min(MOST_STOPS),
            Action::Darker => self.exposure = (self.exposure - STEP).max(-MOST_STOPS),
            Action::ResetExposure => self.exposure = 0.0,
            Action::Histogram => self.show_histogram = !self.show_histogram,
            _ => {}
        }
    }

    fn go_to(&mut self, camera: usize) {
        if let Some((_, there)) = self.cameras.get(camera) {
            self.navigation.jump_to(there);
            self.at = Some(camera);
            if self.comparable {
                self.compare.go_to(self.capture.as_ref(), self.at);
            }
        }
    }

    fn leave_camera(&mut self) {
        self.at = None;
        self.compare.go_to(None, None);
    }

    fn display(&self) -> Display {
        let [r, g, b] = self.background;
        Display {
            exposure: self.exposure,
            white: self.white,
            transform: self.transform,
            background: Color32::from_rgb(r, g, b),
        }
    }

    /// The camera for a picture of this size: an input camera where one is looked through.
    fn camera(&self, width: u32, height: u32) -> Camera {
        match self.at.and_then(|at| self.cameras.get(at)) {
            Some((_, camera)) => camera.resized(width, height),
            None => self.navigation.camera(width, height),
        }
    }

    /// Where in `rect` the picture lies: all of it, or as much as an input camera's shape fills.
    fn picture_rect(&self, rect: Rect) -> Rect {
        let Some((_, camera)) = self.at.and_then(|at| self.cameras.get(at)) else {
            return rect;
        };
        let shape = camera.width as f32 / camera.height as f32;
        let width = rect.width().min(rect.height() * shape);
        Rect::from_center_size(rect.center(), vec2(width, width / shape))
    }

    /// Origin and unit direction, in the world, of the camera's ray at a place on the window.
    pub fn ray_at(&self, place: Pos2) -> Option<(Vec3, Vec3)> {
        let (camera, rect) = self.last.as_ref()?;
        let size = DVec2::new(camera.width.into(), camera.height.into());
        let part = (place - rect.min) / rect.size();
        let pixel = DVec2::new(part.x.into(), part.y.into()) * size;
        Some((camera.position().as_vec3(), camera.ray(pixel).as_vec3()))
    }

    /// Where a point of the world is on the window; `None` behind the camera.
    pub fn place_of(&self, world: Vec3) -> Option<Pos2> {
        let (camera, rect) = self.last.as_ref()?;
        let pixel = camera.project(world.as_dvec3())?;
        let part = vec2(
            (pixel.x / f64::from(camera.width)) as f32,
            (pixel.y / f64::from(camera.height)) as f32,
        );
        Some(rect.min + part * rect.size())
    }

    /// The surface that is seen at a place on the window: the point, and the unit direction to the viewer.
    pub fn surface_at(&self, place: Pos2) -> Option<(ShadingPoint, Vec3)> {
        let (origin, direction) = self.ray_at(place)?;
        let hit = self.occluder.as_ref()?.hit(origin, direction)?;
        let point = ShadingPoint::on(self.object.mesh(), hit.triangle, hit.barycentric);
        Some((point, -direction))
    }

    /// The direction that the surface under the pointer mirrors to the viewer.
    pub fn mirrored(&self) -> Option<Vec3> {
        let (point, view) = self.surface_at(self.pointer?)?;
        let mirrored = 2.0 * point.normal.dot(view) * point.normal - view;
        mirrored.try_normalize()
    }

    /// Builds what rays are cast at, beside the window's thread.
    fn prepare(&mut self, worker: &mut Worker) {
        if let Some(occluder) = self.built.take() {
            self.occluder = Some(occluder);
        }
        if !self.building {
            self.building = true;
            let (object, built) = (self.object.clone(), Arc::clone(&self.built));
            worker.aside("occluder", move || {
                built.store(Occluder::new(object.mesh()));
            });
        }
    }

    /// Linear radiance at the pointer.
    fn pointed(&self) -> Option<String> {
        let pointed = self.pointed?;
        let Vec3 { x, y, z } = pointed.radiance;
        let stops = (luminance(pointed.radiance) / self.white).log2();
        let mut text = format!(
            "{}, {}   R {x:.4}  G {y:.4}  B {z:.4}   {stops:+.2} stops from white",
            pointed.pixel[0], pointed.pixel[1]
        );
        if let Some(other) = pointed.other {
            let Vec3 { x, y, z } = other;
            text = format!("{text}   render {x:.4} {y:.4} {z:.4}");
        }
        Some(text)
    }

    /// Shows the object and the bar below it.
    pub fn show<F>(&mut self, ui: &mut egui::Ui, scene: Scene<'_, F>) -> egui::Response
    where
        F: FnOnce() -> Option<(Subject, Lighting)>,
    {
        let bar = egui::Frame::new()
            .fill(ui.visuals().panel_fill)
            .inner_margin(egui::Margin::symmetric(theme::MARGIN, 6));
        egui::Panel::bottom("view bar")
            .frame(bar)
            .exact_size(BAR)
            .show(ui, |ui| self.bar_ui(ui));
        self.prepare(scene.worker);
        let rect = ui.available_rect_before_wrap();
        let response = ui.allocate_rect(rect, Sense::CLICK | Sense::DRAG);
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 0.0, self.display().background);
        if self
            .navigation
            .listen(ui, &response, scene.habit, scene.free)
        {
            self.leave_camera();
        }
        let seconds = ui.input(|i| i.stable_dt).min(0.1);
        let moving = self.navigation.is_moving();
        if moving && self.navigation.step(seconds) {
            ui.ctx().request_repaint();
        }
        let picture = self.picture_rect(rect);
        self.ask(scene.worker, picture, moving, scene.version, scene.subject);
        self.paint(ui, &painter, picture);
        let scale = ui.pixels_per_point();
        let pixels = |side: f32| ((side * scale).round() as u32).max(1);
        let camera = self.camera(pixels(picture.width()), pixels(picture.height()));
        self.last = Some((camera, picture));
        self.pointer = response.hover_pos();
        self.point(&response, picture);
        if response.double_clicked()
            && let Some(pointer) = response.interact_pointer_pos()
            && let Some((point, _)) = self.surface_at(pointer)
        {
            self.leave_camera();
            self.navigation.look_at(point.position.as_dvec3());
            ui.ctx().request_repaint();
        }
        if moving && let Some(at) = self.place_of(self.navigation.target().as_vec3()) {
            // What the view turns about.
            let faint = theme::ON_STAGE.gamma_multiply(0.5);
            painter.circle_stroke(at, 4.0, egui::Stroke::new(1.0, faint));
        }
        self.histogram_ui(ui, rect);
        self.corner_ui(ui, rect);
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "Viewport"));
        response
    }

    /// Asks for a new picture if the last one asked for shows something else.
    fn ask(
        &mut self,
        worker: &Worker,
        rect: Rect,
        moving: bool,
        version: u64,
        subject: impl FnOnce() -> Option<(Subject, Lighting)>,
    ) {
        if self.compare.kind != Kind::Object && self.compare.is_possible() {
            self.ask_for_comparison(worker, subject);
            return;
        }
        let longest = if moving { LONGEST_MOVING } else { LONGEST };
        let scale = (longest / rect.width().max(rect.height()).max(1.0)).min(1.0);
        let size = [rect.width(), rect.height()].map(|side| (side * scale).round().max(8.0) as u32);
        let camera = self.camera(size[0], size[1]);
        let wanted = Wanted {
            size,
            position: camera.position(),
            forward: camera.forward(),
            focal: camera.focal,
            version,
        };
        if self.wanted.as_ref() == Some(&wanted) {
            return;
        }
        if let Some((subject, lighting)) = subject() {
            self.render(worker, FREE, subject, camera, lighting);
            self.wanted = Some(wanted);
        }
    }

    /// Asks for what an input camera shows under the light of the capture.
    fn ask_for_comparison(
        &mut self,
        worker: &Worker,
        subject: impl FnOnce() -> Option<(Subject, Lighting)>,
    ) {
        let Some(camera) = self.compare.missing(&self.cameras) else {
            return;
        };
        let wanted = Wanted {
            size: [camera.width, camera.height],
            position: camera.position(),
            forward: camera.forward(),
            focal: camera.focal,
            version: u64::MAX,
        };
        if self.wanted.as_ref() == Some(&wanted) {
            return;
        }
        if let Some((subject @ Subject::Solved(_), _)) = subject() {
            let lighting = match &subject {
                Subject::Solved(solution) => solution.lighting(),
                Subject::Running { .. } => return,
            };
            self.render(worker, AT_CAMERA, subject, camera, lighting);
            self.wanted = Some(wanted);
        }
    }

    fn render(
        &mut self,
        worker: &Worker,
        kind: u64,
        subject: Subject,
        camera: Camera,
        lighting: Lighting,
    ) {
        self.shots += 1;
        worker.render(Shot {
            id: 2 * self.shots + kind,
            subject,
            camera,
            lighting,
        });
    }

    /// Takes a picture of the reference renderer.
    pub fn rendered(&mut self, ctx: &egui::Context, rendered: &Rendered) {
        if rendered.id % 2 == AT_CAMERA {
            self.compare.rendered(&rendered.picture);
            return;
        }
        let linear = Linear::of_picture(&rendered.picture);
        let display = self.display();
        let texture = ctx.load_texture("viewport", linear.image(&display), TextureOptions::LINEAR);
        self.histogram = Some(Histogram::new(&linear));
        self.shown = Some(Shown {
            linear,
            display,
            texture,
        });
    }

    fn paint(&mut self, ui: &mut egui::Ui, painter: &egui::Painter, rect: Rect) {
        let display = self.display();
        if self.compare.kind != Kind::Object && self.compare.is_possible() {
            self.compare.paint(ui, rect, &display);
            return;
        }
        if let Some(shown) = &mut self.shown
            && shown.display != display
        {
            let image = shown.linear.image(&display);
            shown.texture.set(image, TextureOptions::LINEAR);
            shown.display = display;
        }
        match &self.shown {
            Some(shown) => {
                let all = Rect::from_min_max(Pos2::ZERO, egui::pos2(1.0, 1.0));
                painter.image(shown.texture.id(), rect, all, Color32::WHITE);
            }
            None => {
                painter.text(
                    rect.center(),
                    Align2::CENTER_CENTER,
                    "The object appears here",
                    egui::TextStyle::Body.resolve(ui.style()),
                    theme::ON_STAGE.gamma_multiply(0.5),
                );
            }
        }
    }

    /// Reads what is under the pointer.
    fn point(&mut self, response: &egui::Response, rect: Rect) {
        self.pointed = None;
        let Some(pointer) = response.hover_pos().filter(|p| rect.contains(*p)) else {
            return;
        };
        let part = (pointer - rect.min) / rect.size();
        let comparing = self.compare.kind != Kind::Object;
        let linear = match self.compare.linear() {
            Some(linear) => Some(linear),
            None => self.shown.as_ref().map(|shown| &shown.linear),
        };
        let Some(linear) = linear else { return };
        let x = ((part.x * linear.width as f32) as usize).min(linear.width - 1);
        let y = ((part.y * linear.height as f32) as usize).min(linear.height - 1);
        let at = y * linear.width + x;
        self.pointed = Some(Pointed {
            pixel: [x, y],
            radiance: linear.radiance[at],
            other: None,
        });
        if comparing && let Some((photo, render)) = self.compare.both(x, y) {
            self.pointed = Some(Pointed {
                pixel: [x, y],
                radiance: photo,
                other: render,
            });
        }
    }

    fn histogram_ui(&self, ui: &egui::Ui, rect: Rect) {
        if !self.show_histogram {
            return;
        }
        let of_comparison = self.compare.linear().map(Histogram::new);
        if let Some(histogram) = of_comparison.as_ref().or(self.histogram.as_ref()) {
            histogram.show(ui, rect, &self.display());
        }
    }

    /// The camera's name over the picture's corner, and what is under the pointer.
    fn corner_ui(&self, ui: &egui::Ui, rect: Rect) {
        if let Some(pointed) = self.pointed() {
            let place = rect.left_bottom() + vec2(12.0, -10.0);
            let font = egui::FontId::monospace(11.5);
            let painter = ui.painter_at(rect);
            let text = painter.layout_no_wrap(pointed, font, theme::ON_STAGE);
            let place = Align2::LEFT_BOTTOM.anchor_size(place, text.size()).min;
            let behind = Rect::from_min_size(place, text.size()).expand(4.0);
            painter.rect_filled(behind, 4.0, Color32::from_black_alpha(150));
            painter.galley(place, text, theme::ON_STAGE);
        }
        let Some((name, _)) = self.at.and_then(|at| self.cameras.get(at)) else {
            return;
        };
        let mut text = name.clone();
        if self.compare.kind != Kind::Object
            && let Some(psnr) = self.compare.psnr()
        {
            text = format!("{text}   {psnr:.2} dB");
        }
        ui.painter_at(rect).text(
            rect.left_top() + vec2(12.0, 10.0),
            Align2::LEFT_TOP,
            text,
            egui::TextStyle::Body.resolve(ui.style()),
            theme::ON_STAGE,
        );
    }

    /// The bar below the picture.
    fn bar_ui(&mut self, ui: &mut egui::Ui) {
        ui.horizontal_centered(|ui| {
            self.camera_ui(ui);
            if self.compare.is_possible() {
                for kind in Kind::ALL {
                    let (name, tip) = kind.words();
                    ui.selectable_value(&mut self.compare.kind, kind, name)
                        .on_hover_text(tip);
                }
            }
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                self.exposure_ui(ui);
            });
        });
    }

    fn camera_ui(&mut self, ui: &mut egui::Ui) {
        if self.cameras.is_empty() {
            return;
        }
        let shown = self
            .at
            .map_or("Free view".to_owned(), |at| format!("Camera {}", at + 1));
        let mut go = None;
        egui::ComboBox::from_id_salt("camera")
            .selected_text(shown)
            .width(96.0)
            .show_ui(ui, |ui| {
                for (i, (name, _)) in self.cameras.iter().enumerate() {
                    let text = format!("Camera {}", i + 1);
                    let label = ui.selectable_label(self.at == Some(i), text);
                    if label.on_hover_text(name).clicked() {
                        go = Some(i);
                    }
                }
            })
            .response
            .on_hover_text("Look from where a photograph was taken (1 … 9)")
            .accessible_name("Camera");
        if let Some(go) = go {
            self.go_to(go);
        }
    }

    fn exposure_ui(&mut self, ui: &mut egui::Ui) {
        ui.toggle_value(&mut self.show_histogram, "Histogram")
            .on_hover_text("How often each brightness occurs, by channel, in stops from white (H)");
        let mut colour = self.background;
        let picker = ui.color_edit_button_srgb(&mut colour);
        picker
            .on_hover_text("Background colour")
            .accessible_name("Background colour");
        self.background = colour;
        egui::ComboBox::from_id_salt("view transform")
            .selected_text(self.transform.name())
            .width(110.0)
            .show_ui(ui, |ui| {
                for transform in ViewTransform::ALL {
                    ui.selectable_value(&mut self.transform, transform, transform.name());
                }
            })
            .response
            .on_hover_text("From linear radiance to the screen")
            .accessible_name("View transform");
        let reset = Button::new(RichText::new("0").monospace()).small();
        let reset = ui.add_enabled(self.exposure != 0.0, reset);
        let tip = "Back to no stops (R)";
        if reset
            .on_hover_text(tip)
            .accessible_name("Reset exposure")
            .clicked()
        {
            self.exposure = 0.0;
        }
        ui.add(
            egui::DragValue::new(&mut self.exposure)
                .range(-MOST_STOPS..=MOST_STOPS)
                .speed(0.02)
                .fixed_decimals(1)
                .suffix(" stops"),
        )
        .on_hover_text("Exposure in stops (E, Shift+E)")
        .accessible_name("Exposure");
    }
}
