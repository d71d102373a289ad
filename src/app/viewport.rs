//! The picture of the object: where it is seen from, how bright it is shown, and the picture itself.

use eframe::egui::{
    self, Color32, ColorImage, Pos2, Rect, Sense, TextureHandle, TextureOptions, vec2,
};
use glam::{DVec2, DVec3, Vec3};

use super::commands::Action;
use super::navigation::{Habit, Navigation};
use super::theme;
use crate::capture::{Camera, Mesh, View};
use crate::hemisphere::srgb;
use crate::relight::Lighting;
use crate::worker::{Rendered, Shot, Subject, Worker};

/// Longest side of a picture of the reference renderer, pixels.
const LONGEST: f32 = 400.0;
/// The same while the view moves.
const LONGEST_MOVING: f32 = 180.0;
/// Stops by which a key changes the exposure.
const STEP: f32 = 0.5;

/// A view of the object.
pub struct Viewport {
    navigation: Navigation,
    cameras: Vec<(String, Camera)>,
    /// The input camera that is looked through.
    at: Option<usize>,
    /// Exposure in stops.
    pub exposure: f32,
    /// Radiance that is white at no stops.
    white: f32,
    shots: u64,
    wanted: Option<Wanted>,
    shown: Option<(Rendered, f32, TextureHandle)>,
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

impl Viewport {
    /// A view of a mesh, with the cameras of the input views.
    pub fn new(mesh: &Mesh, up: Vec3, views: &[View]) -> Self {
        Self {
            navigation: Navigation::new(mesh, up.as_dvec3(), views.first().map(|v| &v.camera)),
            cameras: views
                .iter()
                .map(|v| (v.name.clone(), v.camera.clone()))
                .collect(),
            at: None,
            exposure: 0.0,
            white: 1.0,
            shots: 0,
            wanted: None,
            shown: None,
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

    /// Carries out a command about the view.
    pub fn act(&mut self, action: Action) {
        match action {
            Action::Frame => {
                self.at = None;
                self.navigation.frame();
            }
            Action::ResetView => {
                self.at = None;
                self.navigation.reset();
            }
            Action::Camera(n) => {
                if let Some((_, camera)) = self.cameras.get(usize::from(n)) {
                    self.navigation.jump_to(camera);
                    self.at = Some(usize::from(n));
                }
            }
            Action::Brighter => self.exposure += STEP,
            Action::Darker => self.exposure -= STEP,
            Action::ResetExposure => self.exposure = 0.0,
            _ => {}
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

    /// Shows the object. `subject` is asked for only when a new picture is needed; `version` changes with it.
    pub fn show(
        &mut self,
        ui: &mut egui::Ui,
        worker: &Worker,
        habit: Habit,
        version: u64,
        subject: impl FnOnce() -> Option<(Subject, Lighting)>,
    ) -> egui::Response {
        let rect = ui.available_rect_before_wrap();
        let response = ui.allocate_rect(rect, Sense::CLICK | Sense::DRAG);
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 0.0, theme::STAGE);
        if self.navigation.listen(ui, &response, habit, true) {
            self.at = None;
        }
        let seconds = ui.input(|i| i.stable_dt).min(0.1);
        let moving = self.navigation.is_moving();
        if moving && self.navigation.step(seconds) {
            ui.ctx().request_repaint();
        }
        let picture = self.picture_rect(rect);
        self.ask(worker, picture, moving, version, subject);
        self.paint(ui, &painter, picture);
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
        let Some((subject, lighting)) = subject() else {
            return;
        };
        self.shots += 1;
        worker.render(Shot {
            id: self.shots,
            subject,
            camera,
            lighting,
        });
        self.wanted = Some(wanted);
    }

    /// Takes a picture of the reference renderer.
    pub fn rendered(&mut self, ctx: &egui::Context, rendered: Rendered) {
        let texture = ctx.load_texture("viewport", self.image(&rendered), TextureOptions::LINEAR);
        self.shown = Some((rendered, self.exposure, texture));
    }

    fn image(&self, rendered: &Rendered) -> ColorImage {
        let picture = &rendered.picture;
        let gain = self.exposure.exp2() / self.white;
        let pixels = picture
            .diffuse
            .iter()
            .zip(&picture.specular)
            .map(|(&d, &s)| {
                let [r, g, b] = (gain * (Vec3::from(d) + Vec3::from(s)))
                    .to_array()
                    .map(|v| (255.0 * srgb(v.clamp(0.0, 1.0))).round() as u8);
                Color32::from_rgb(r, g, b)
            })
            .zip(&picture.coverage)
            .map(|(colour, &coverage)| {
                // Over the stage's grey.
                let rest = (1.0 - coverage) * f32::from(theme::STAGE.r());
                let over = |c: u8| (f32::from(c) + rest).min(255.0) as u8;
                Color32::from_rgb(over(colour.r()), over(colour.g()), over(colour.b()))
            })
            .collect();
        ColorImage::new([picture.width as usize, picture.height as usize], pixels)
    }

    fn paint(&mut self, ui: &egui::Ui, painter: &egui::Painter, rect: Rect) {
        let exposure = self.exposure;
        if let Some((rendered, shown, _)) = &self.shown
            && *shown != exposure
        {
            let image = self.image(rendered);
            if let Some((_, shown, texture)) = &mut self.shown {
                texture.set(image, TextureOptions::LINEAR);
                *shown = exposure;
            }
        }
        match &self.shown {
            Some((_, _, texture)) => {
                let all = Rect::from_min_max(Pos2::ZERO, egui::pos2(1.0, 1.0));
                painter.image(texture.id(), rect, all, Color32::WHITE);
            }
            None => {
                painter.text(
                    rect.center(),
                    egui::Align2::CENTER_CENTER,
                    "The object appears here",
                    egui::TextStyle::Body.resolve(ui.style()),
                    theme::ON_STAGE.gamma_multiply(0.5),
                );
            }
        }
    }
}
