//! The picture of the object: where it is seen from, how it is shown, and what is under the pointer.

mod compare;
mod display;
mod gpu;
mod histogram;

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Button, Color32, Pos2, Rect, Sense, TextureHandle, TextureOptions, vec2,
};
use glam::{DVec2, DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::commands::Action;
use super::navigation::{Habit, Navigation, Place};
use super::theme;
use crate::worker::{Latest, Rendered, Shot, Subject, Worker};
use compare::{Compare, Kind};
use display::{Display, Linear};
use eframe::egui_wgpu::RenderState;
use gpu::GpuPicture;
use histogram::Histogram;
use rekindle_capture::{Camera, Capture, Mesh, View};
use rekindle_relight::{Lighting, ShadingPoint};
use rekindle_relight::{ViewTransform, luminance};
use rekindle_render::{Background, FrameRequest, Mode, RenderError};
use rekindle_scene::surface::Occluder;
use rekindle_solution::Solution;

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
/// Width from which that bar has room for everything in one row, without the graphics card's modes and with them, points.
const WIDE: f32 = 620.0;
const WIDE_GPU: f32 = 900.0;

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
    look: Look,
    gpu: Option<GpuPicture>,
    /// Why the graphics card doesn't draw, once it has failed, and whether that was told.
    failure: Option<(Failure, bool)>,
    /// Radiance that is white at no stops.
    white: f32,
    compare: Compare,
    photographs: Photographs,
    /// Whether the photographs are asked for.
    wishes_photographs: bool,
    shots: u64,
    wanted: Option<Wanted>,
    shown: Option<Shown>,
    histogram: Option<Histogram>,
    /// Number of the picture that the histogram is of, where the graphics card drew it.
    histogram_of: Option<u64>,
    pointer: Option<Pos2>,
    pointed: Option<Pointed>,
    object: Object,
    occluder: Option<Occluder>,
    building: bool,
    built: Arc<Latest<Occluder>>,
    /// Camera and place of the picture that was drawn last.
    last: Option<(Camera, Rect)>,
}

/// What is known of the photographs to compare with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Photographs {
    /// Nothing is compared, as while the estimation runs.
    Unused,
    /// They could be compared with, were they known.
    Missing,
    /// They can be compared with.
    Known,
}

/// Why the graphics card doesn't draw.
enum Failure {
    /// Its driver lacks what the live view needs.
    Unable,
    /// It began, and then failed.
    Drawing(RenderError),
}

/// How the object is shown.
#[derive(Clone, Copy, Debug)]
struct Look {
    /// Exposure in stops.
    exposure: f32,
    transform: ViewTransform,
    background: [u8; 3],
    /// Whether the lighting is behind the object, instead of the background's colour.
    lit_background: bool,
    mode: Mode,
    /// Whether the histogram is shown.
    histogram: bool,
}

/// What a project file says of the view.
#[derive(Serialize, Deserialize)]
struct Stored {
    place: Place,
    exposure: f32,
    transform: ViewTransform,
    background: [u8; 3],
    lit_background: bool,
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
    /// The window's graphics card, if there is one.
    pub gpu: Option<&'a RenderState>,
    /// Whether a lamp is being dragged: the picture may be coarse.
    pub dragging: bool,
    /// The lamp whose shadow is shown where shadows are, by its place in the lighting.
    pub shadowed: usize,
    /// Which mouse buttons move the view.
    pub habit: Habit,
    /// Whether the left button has nothing else to do than to move the view.
    pub free: bool,
    /// Changes with object and lighting.
    pub version: u64,
    /// Object and lighting; asked for only when a new picture is needed.
    pub subject: Option<F>,
}

impl Viewport {
    /// A view of an object, with the cameras of a capture, or, where that is not known, those that a solution kept.
    pub fn new(object: Object, up: Vec3, capture: Option<&Arc<Capture>>) -> Self {
        let cameras = match (capture, &object) {
            (None, Object::Solution(solution)) => solution.cameras.clone(),
            (Some(capture), _) | (None, Object::Capture(capture)) => cameras_of(capture),
        };
        let first = cameras.first().map(|(_, camera)| camera);
        Self {
            navigation: Navigation::new(object.mesh(), up.as_dvec3(), first),
            capture: capture.cloned(),
            cameras,
            at: None,
            look: Look {
                exposure: 0.0,
                transform: ViewTransform::Srgb,
                background: [18; 3],
                lit_background: false,
                mode: Mode::Beauty,
                histogram: false,
            },
            gpu: None,
            failure: None,
            white: 1.0,
            compare: Compare::default(),
            photographs: Photographs::Unused,
            wishes_photographs: false,
            shots: 0,
            wanted: None,
            shown: None,
            histogram: None,
            histogram_of: None,
            pointer: None,
            pointed: None,
            object,
            occluder: None,
            building: false,
            built: Arc::default(),
            last: None,
        }
    }

    /// Whether the view is still on its way.
    #[cfg(test)]
    pub fn is_moving(&self) -> bool {
        self.navigation.is_moving()
    }

    /// Viewpoint and look, to be stored.
    pub fn state(&self) -> serde_json::Value {
        let stored = Stored {
            place: self.navigation.place(),
            exposure: self.look.exposure,
            transform: self.look.transform,
            background: self.look.background,
            lit_background: self.look.lit_background,
        };
        serde_json::to_value(stored).unwrap_or_default()
    }

    /// Goes to a stored viewpoint and look; what can't be read is left as it is.
    pub fn restore(&mut self, stored: &serde_json::Value) {
        if let Ok(stored) = Stored::deserialize(stored) {
            self.navigation.go_to(stored.place);
            self.look.exposure = stored.exposure.clamp(-MOST_STOPS, MOST_STOPS);
            self.look.transform = stored.transform;
            self.look.background = stored.background;
            self.look.lit_background = stored.lit_background;
        }
    }

    /// Number of input cameras.
    pub fn cameras(&self) -> usize {
        self.cameras.len()
    }

    /// Index of the input camera that is looked through.
    pub fn at(&self) -> Option<usize> {
        self.at
    }

    /// Names and input cameras.
    pub fn named_cameras(&self) -> &[(String, Camera)] {
        &self.cameras
    }

    /// Camera and place of the picture that was drawn last; a pixel of the camera is one of the screen.
    pub fn seen(&self) -> Option<&(Camera, Rect)> {
        self.last.as_ref()
    }

    /// What rays are cast at, once it is built.
    pub fn occluder(&self) -> Option<&Occluder> {
        self.occluder.as_ref()
    }

    /// View transform, factor of radiance before it, and display values of the background.
    pub fn shown_as(&self) -> (ViewTransform, f32, [f32; 3]) {
        let look = &self.look;
        let background = look.background.map(|v| f32::from(v) / 255.0);
        (
            look.transform,
            look.exposure.exp2() / self.white,
            background,
        )
    }

    /// The radiance that is white at no stops.
    pub fn white(&self) -> f32 {
        self.white
    }

    /// Sets the radiance that is white at no stops.
    pub fn set_white(&mut self, white: f32) {
        self.white = white;
    }

    /// What went wrong with the graphics card, once: a title and what it means.
    pub fn take_failure(&mut self) -> Option<(&'static str, String)> {
        let (failure, told) = self.failure.as_mut().filter(|(_, told)| !told)?;
        *told = true;
        Some(match failure {
            Failure::Unable => (
                "A slower preview is shown",
                "This graphics driver can't run the live view. A slower preview is shown; install a Vulkan driver for \
                 real-time relighting."
                    .to_owned(),
            ),
            Failure::Drawing(error) => (
                "Drawing failed on the graphics card",
                format!("{error}. A slower preview is shown meanwhile; all lights are kept."),
            ),
        })
    }

    /// Allows the comparison with the photographs: the subject is a solution.
    pub fn allow_comparison(&mut self) {
        self.photographs = match self.capture {
            Some(_) => Photographs::Known,
            None => Photographs::Missing,
        };
    }

    /// Takes photographs that were located.
    pub fn set_photographs(&mut self, capture: Arc<Capture>) {
        self.cameras = cameras_of(&capture);
        self.capture = Some(capture);
        self.allow_comparison();
        if self.at.is_some_and(|at| at >= self.cameras.len()) {
            self.at = None;
        }
        self.compare.go_to(None, None);
        self.compare.go_to(self.capture.as_ref(), self.at);
    }

    /// Whether photographs could be compared with, were they known.
    pub fn lacks_photographs(&self) -> bool {
        self.photographs == Photographs::Missing
    }

    /// Whether the photographs are to be located, once.
    pub fn take_wish(&mut self) -> bool {
        std::mem::take(&mut self.wishes_photographs)
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
            Action::Brighter => self.look.exposure = (self.look.exposure + STEP).min(MOST_STOPS),
            Action::Darker => self.look.exposure = (self.look.exposure - STEP).max(-MOST_STOPS),
            Action::ResetExposure => self.look.exposure = 0.0,
            Action::Histogram => self.look.histogram = !self.look.histogram,
            _ => {}
        }
    }

    fn go_to(&mut self, camera: usize) {
        if let Some((_, there)) = self.cameras.get(camera) {
            self.navigation.jump_to(there);
            self.at = Some(camera);
            if self.photographs == Photographs::Known {
                self.compare.go_to(self.capture.as_ref(), self.at);
            }
        }
    }

    /// Goes to an input camera and shows there where photograph and rendering differ, if the photographs are known.
    pub fn show_difference(&mut self, camera: usize) {
        self.go_to(camera);
        if self.photographs == Photographs::Known {
            self.compare.kind = Kind::Difference;
        }
    }

    fn leave_camera(&mut self) {
        self.at = None;
        self.compare.go_to(None, None);
    }

    fn display(&self) -> Display {
        let [r, g, b] = self.look.background;
        Display {
            exposure: self.look.exposure,
            white: self.white,
            transform: self.look.transform,
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
    pub fn show<F>(&mut self, ui: &mut egui::Ui, mut scene: Scene<'_, F>) -> egui::Response
    where
        F: FnOnce() -> Option<(Subject, Lighting)>,
    {
        let bar = egui::Frame::new()
            .fill(ui.visuals().panel_fill)
            .inner_margin(egui::Margin::symmetric(theme::MARGIN, 6));
        let needed = if self.gpu.is_some() { WIDE_GPU } else { WIDE };
        let narrow = ui.available_width() < needed;
        egui::Panel::bottom("view bar")
            .frame(bar)
            .exact_size(if narrow { 2.0 * BAR - 8.0 } else { BAR })
            .show(ui, |ui| self.bar_ui(ui, narrow));
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
        let scale = ui.pixels_per_point();
        let pixels = |side: f32| ((side * scale).round() as u32).max(1);
        let camera = self.camera(pixels(picture.width()), pixels(picture.height()));
        self.last = Some((camera, picture));
        self.pointer = response.hover_pos();
        if !self.paint_with_gpu(ui, &painter, picture, &mut scene) {
            if let Some(subject) = scene.subject.take() {
                self.ask(scene.worker, picture, moving, scene.version, subject);
            }
            self.paint(ui, &painter, picture);
        }
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
        self.kinds_ui(ui, rect);
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "Viewport"));
        response
    }

    /// Draws the object by the graphics card. Whether it did.
    fn paint_with_gpu<F>(
        &mut self,
        ui: &egui::Ui,
        painter: &egui::Painter,
        rect: Rect,
        scene: &mut Scene<'_, F>,
    ) -> bool
    where
        F: FnOnce() -> Option<(Subject, Lighting)>,
    {
        let Object::Solution(solution) = &self.object else {
            return false;
        };
        let Some(state) = scene.gpu.filter(|_| self.failure.is_none()) else {
            return false;
        };
        if self.compares() {
            return false;
        }
        let solution = Arc::clone(solution);
        match self.try_gpu(ui.ctx(), state, &solution, scene) {
            Ok(texture) => {
                if let Some(texture) = texture {
                    let all = Rect::from_min_max(Pos2::ZERO, egui::pos2(1.0, 1.0));
                    painter.image(texture, rect, all, Color32::WHITE);
                }
                true
            }
            Err(error) => {
                // What fails at once is the driver's limits, whose numbers tell a user nothing.
                let failure = match self.gpu.take() {
                    Some(_) => Failure::Drawing(error),
                    None => Failure::Unable,
                };
                self.failure = Some((failure, false));
                ui.ctx().request_repaint();
                false
            }
        }
    }

    fn try_gpu<F>(
        &mut self,
        ctx: &egui::Context,
        state: &RenderState,
        solution: &Arc<Solution>,
        scene: &mut Scene<'_, F>,
    ) -> Result<Option<egui::TextureId>, RenderError>
    where
        F: FnOnce() -> Option<(Subject, Lighting)>,
    {
        let Some((camera, _)) = &self.last else {
            return Ok(None);
        };
        let background = if self.look.lit_background {
            Background::Light
        } else {
            Background::Colour(self.look.background.map(|v| f32::from(v) / 255.0))
        };
        if self.gpu.is_none() {
            self.gpu = Some(GpuPicture::new(state, ctx)?);
        }
        let Some(gpu) = &mut self.gpu else {
            return Ok(None);
        };
        let request = FrameRequest {
            camera: camera.clone(),
            mode: match self.look.mode {
                Mode::Shadow(_) => Mode::Shadow(scene.shadowed),
                mode => mode,
            },
            exposure_ev: self.look.exposure,
            transform: self.look.transform,
            background,
            dragging: scene.dragging,
            quick: true,
        };
        if !gpu.prepare(scene.worker, solution)? {
            return Ok(None);
        }
        let subject = scene.subject.take();
        let texture = gpu.draw(ctx, &request, scene.version, || {
            let (_, lighting) = subject?()?;
            Some(lighting)
        })?;
        // Linear values are read back when someone looks at them.
        if (self.look.histogram || self.pointer.is_some())
            && gpu.is_settled()
            && let Some(linear) = gpu.linear(ctx)?
            && self.look.histogram
            && self.histogram_of != Some(linear.number)
        {
            self.histogram = Some(Histogram::new(&linear.picture));
            self.histogram_of = Some(linear.number);
        }
        Ok(texture)
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
        if self.compares() {
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

    /// Asks for what an input camera shows under the captured lighting.
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
                Subject::Solved(solution) => {
                    let lighting = solution.lighting();
                    solution.lighting_before(&lighting, &camera).into_owned()
                }
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
        if self.compares() {
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
            None => match &self.gpu {
                Some(gpu) => gpu.read(),
                None => self.shown.as_ref().map(|shown| &shown.linear),
            },
        };
        let Some(linear) = linear else { return };
        let x = ((part.x * linear.width as f32) as usize).min(linear.width - 1);
        let y = ((part.y * linear.height as f32) as usize).min(linear.height - 1);
        let at = y * linear.width + x;
        if linear.coverage[at] <= 0.0 {
            return;
        }
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
        if !self.look.histogram {
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
        if self.compares() {
            text = format!("{text}, {}", self.compare.kind.light());
            if let Some(psnr) = self.compare.psnr() {
                text = format!("{text}, {psnr:.2} dB");
            }
        }
        let drawn = ui.painter_at(rect).text(
            rect.left_top() + vec2(12.0, 10.0),
            Align2::LEFT_TOP,
            &text,
            egui::TextStyle::Body.resolve(ui.style()),
            theme::ON_STAGE,
        );
        let response = ui.interact(drawn, ui.scope_id().with("what is shown"), Sense::HOVER);
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Label, true, &text));
    }

    /// Whether a photograph and its rendering are shown instead of the object.
    pub fn compares(&self) -> bool {
        self.compare.kind != Kind::Object && self.compare.is_possible()
    }

    /// The bar below the picture, in two rows where it is narrow.
    fn bar_ui(&mut self, ui: &mut egui::Ui, narrow: bool) {
        let right = egui::Layout::right_to_left(egui::Align::Center);
        if narrow {
            ui.horizontal(|ui| {
                self.camera_ui(ui);
                self.mode_ui(ui);
                self.refining_ui(ui, "…");
                ui.with_layout(right, |ui| self.extras_ui(ui));
            });
            ui.horizontal(|ui| {
                ui.with_layout(right, |ui| self.exposure_ui(ui));
            });
            return;
        }
        ui.horizontal_centered(|ui| {
            self.camera_ui(ui);
            self.mode_ui(ui);
            self.refining_ui(ui, "Refining…");
            ui.with_layout(right, |ui| {
                self.extras_ui(ui);
                self.exposure_ui(ui);
            });
        });
    }

    /// Says, by a text that fits, that the picture is not final yet.
    fn refining_ui(&self, ui: &mut egui::Ui, text: &str) {
        // Beside a photograph the graphics card rests.
        if !self.compares() && self.gpu.as_ref().is_some_and(|gpu| !gpu.is_settled()) {
            ui.weak(text)
                .accessible_name("Refining…")
                .on_hover_text("Light is being baked, or the still picture made better");
        }
    }

    /// Chooses what of the object is shown.
    fn mode_ui(&mut self, ui: &mut egui::Ui) {
        if self.gpu.is_none() {
            return;
        }
        let name = |mode: Mode| match mode {
            Mode::Beauty => ("Beauty", "Diffuse and specular radiance"),
            Mode::Diffuse => ("Diffuse", "The diffuse part alone"),
            Mode::Specular => ("Specular", "The specular part alone"),
            Mode::Albedo => (
                "Pseudo-albedo",
                "Diffuse colour without the light, its brightest parts white",
            ),
            Mode::Irradiance => (
                "Irradiance",
                "The light that arrives, interreflection included",
            ),
            Mode::Normals => ("Normals", "Shading normals in the world, (n + 1)/2"),
            Mode::Shadow(_) => ("Shadow", "What the surface sees of the selected light"),
            Mode::Confidence => ("Confidence", "How far the texture is known"),
            Mode::Roughness => (
                "Roughness",
                "Roughness of the lobe as other programs have it, black for a mirror, white where nothing is reflected",
            ),
            Mode::Strength => (
                "Specular strength",
                "What the surface reflects specularly, white where it is most",
            ),
        };
        egui::ComboBox::from_id_salt("mode")
            .selected_text(name(self.look.mode).0)
            .width(112.0)
            .height(400.0)
            .show_ui(ui, |ui| {
                for mode in [
                    Mode::Beauty,
                    Mode::Diffuse,
                    Mode::Specular,
                    Mode::Albedo,
                    Mode::Irradiance,
                    Mode::Normals,
                    Mode::Shadow(0),
                    Mode::Confidence,
                    Mode::Roughness,
                    Mode::Strength,
                ] {
                    let (text, tip) = name(mode);
                    ui.selectable_value(&mut self.look.mode, mode, text)
                        .on_hover_text(tip);
                }
            })
            .response
            .on_hover_text("What of the object is shown")
            .accessible_name("Mode");
    }

    /// Chooses what is shown at an input camera, over the picture's head.
    fn kinds_ui(&mut self, ui: &mut egui::Ui, rect: Rect) {
        let missing = self.lacks_photographs() && self.at.is_some();
        if !self.compare.is_possible() && !missing {
            return;
        }
        let place = Rect::from_min_size(rect.left_top() + vec2(8.0, 34.0), vec2(420.0, 34.0));
        let builder = egui::UiBuilder::new().max_rect(place);
        ui.scope_builder(builder, |ui| {
            let frame = egui::Frame::new()
                .fill(ui.visuals().panel_fill.gamma_multiply(0.9))
                .corner_radius(6)
                .inner_margin(4);
            frame.show(ui, |ui| {
                ui.horizontal(|ui| {
                    ui.spacing_mut().item_spacing.x = 2.0;
                    if missing {
                        let locate = ui.button("Locate photographs…");
                        let tip = "Choose the capture's folder, to compare with its photographs";
                        self.wishes_photographs |= locate.on_hover_text(tip).clicked();
                        return;
                    }
                    for kind in Kind::ALL {
                        let (name, tip) = kind.words();
                        ui.selectable_value(&mut self.compare.kind, kind, name)
                            .on_hover_text(tip);
                    }
                });
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

    fn extras_ui(&mut self, ui: &mut egui::Ui) {
        ui.toggle_value(&mut self.look.histogram, "Histogram")
            .on_hover_text("How often each brightness occurs, by channel, in stops from white (I)");
        if self.gpu.is_some() {
            ui.toggle_value(&mut self.look.lit_background, "Show light")
                .on_hover_text("Show the lighting itself behind the object");
        }
    }

    fn exposure_ui(&mut self, ui: &mut egui::Ui) {
        let mut colour = self.look.background;
        let picker = ui.color_edit_button_srgb(&mut colour);
        picker
            .on_hover_text("What is behind the object")
            .accessible_name("Background colour");
        ui.label("Background");
        self.look.background = colour;
        egui::ComboBox::from_id_salt("view transform")
            .selected_text(self.look.transform.name())
            .width(110.0)
            .show_ui(ui, |ui| {
                for transform in ViewTransform::ALL {
                    ui.selectable_value(&mut self.look.transform, transform, transform.name());
                }
            })
            .response
            .on_hover_text("From linear radiance to the screen")
            .accessible_name("View transform");
        let reset = ui.add_enabled(self.look.exposure != 0.0, Button::new("Reset"));
        let tip = "Back to no stops (R)";
        if reset
            .on_hover_text(tip)
            .accessible_name("Reset exposure")
            .clicked()
        {
            self.look.exposure = 0.0;
        }
        ui.add(
            egui::DragValue::new(&mut self.look.exposure)
                .range(-MOST_STOPS..=MOST_STOPS)
                .speed(0.02)
                .fixed_decimals(1)
                .suffix(" stops"),
        )
        .on_hover_text("Exposure in stops (E, Shift+E)")
        .accessible_name("Exposure");
    }
}

/// Names and cameras of a capture's views.
fn cameras_of(capture: &Capture) -> Vec<(String, Camera)> {
    let named = |v: &View| (v.name.clone(), v.camera.clone());
    capture.views.iter().map(named).collect()
}
