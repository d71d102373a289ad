//! The mesh alone, as a body of clay that can be turned and on which points are set.

use std::sync::Arc;

use eframe::egui::{
    self, Color32, ColorImage, CursorIcon, PointerButton, Pos2, Rect, Sense, TextureHandle,
    TextureOptions, vec2,
};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::Grip;
use super::list::Points;
use super::marks_ui;
use crate::app::navigation::{Habit, Navigation};
use crate::app::theme;
use crate::worker::{Latest, Worker};
use rekindle_capture::{Camera, Capture};
use rekindle_scene::hemisphere::srgb;
use rekindle_scene::surface::{Barycentrics, NO_TRIANGLE, Occluder, front_most};

/// Samples along a pixel of a picture that stands still.
const SAMPLES: u32 = 2;
/// A point is hidden by what is nearer by more than this part of the mesh's diagonal.
const HIDDEN: f32 = 0.01;
/// Light from the upper left before the mesh, in the camera's axes; from all around; reflected.
const KEY: Vec3 = Vec3::new(-0.42, 0.58, 0.7);
const AROUND: f32 = 0.05;
const REFLECTED: f32 = 0.38;

/// A view of the mesh.
pub(super) struct MeshView {
    capture: Arc<Capture>,
    navigation: Navigation,
    /// Which axis of the mesh points up, from 0.
    axis: usize,
    occluder: Arc<Latest<Arc<Occluder>>>,
    built: Option<Arc<Occluder>>,
    building: bool,
    /// What was asked for last, and whether it is still being drawn.
    wanted: Option<Camera>,
    drawing: bool,
    newest: Arc<Latest<Drawn>>,
    shown: Option<(Drawn, TextureHandle)>,
    grip: Grip,
}

/// A picture of the mesh.
struct Drawn {
    camera: Camera,
    image: ColorImage,
    /// Front-most triangle and depth at every pixel.
    triangles: Vec<u32>,
    depth: Vec<f32>,
}

impl MeshView {
    pub(super) fn new(capture: &Arc<Capture>) -> Self {
        let up = capture.light_hemisphere.up.abs();
        let axis = (0..3).fold(0, |best, k| if up[k] > up[best] { k } else { best });
        Self {
            navigation: Navigation::new(&capture.mesh, DVec3::AXES[axis], None),
            axis,
            capture: Arc::clone(capture),
            occluder: Arc::default(),
            built: None,
            building: false,
            wanted: None,
            drawing: false,
            newest: Arc::default(),
            shown: None,
            grip: Grip::default(),
        }
    }

    /// What rays are cast at, once it is built.
    pub(super) fn occluder(&self) -> Option<&Arc<Occluder>> {
        self.built.as_ref()
    }

    /// The axis of the mesh that points up.
    pub(super) fn up(&self) -> &'static str {
        ["X", "Y", "Z"][self.axis]
    }

    /// Lets the next axis point up: a mesh from elsewhere may lie on its side.
    pub(super) fn turn_up(&mut self) {
        self.axis = (self.axis + 1) % 3;
        self.navigation = Navigation::new(&self.capture.mesh, DVec3::AXES[self.axis], None);
    }

    pub(super) fn navigation_mut(&mut self) -> &mut Navigation {
        &mut self.navigation
    }

    /// Shows the mesh in `rect` and sets points on it.
    pub(super) fn show(
        &mut self,
        ui: &mut egui::Ui,
        rect: Rect,
        worker: &mut Worker,
        habit: Habit,
        points: &mut Points,
    ) {
        let response = ui
            .allocate_rect(rect, Sense::CLICK | Sense::DRAG)
            .on_hover_cursor(CursorIcon::Crosshair);
        self.prepare(ui.ctx(), worker);
        self.take_hold(&response, rect, points);
        let held = self.grip.is_held();
        self.navigation.listen(ui, &response, habit, !held);
        let seconds = ui.input(|i| i.stable_dt).min(0.1);
        if self.navigation.is_moving() && self.navigation.step(seconds) {
            ui.ctx().request_repaint();
        }
        self.draw(worker, rect, ui.pixels_per_point());
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, 0.0, theme::STAGE);
        let name = if let Some((_, texture)) = &self.shown {
            painter.image(texture.id(), rect, marks_ui::WHOLE, Color32::WHITE);
            "Picture of the mesh"
        } else {
            "The mesh is being drawn"
        };
        self.set_points(&response, rect, points);
        let places = self.places(rect, points);
        let hovered = response
            .hover_pos()
            .and_then(|p| marks_ui::nearest(&places, p));
        for (i, &(at, hidden)) in places.iter().enumerate() {
            let selected = points.selected() == Some(i);
            marks_ui::paint(ui, &painter, at, i, selected, hidden, hovered == Some(i));
        }
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, name));
    }

    /// A drag that begins at a point moves it, any other the view.
    fn take_hold(&mut self, response: &egui::Response, rect: Rect, points: &Points) {
        if response.drag_started_by(PointerButton::Primary) {
            let pressed = response.ctx.input(|i| i.pointer.press_origin());
            let places = self.places(rect, points);
            self.grip = Grip::of(pressed.and_then(|at| marks_ui::nearest(&places, at)));
        }
    }

    /// Clicks set points and select them, drags move them.
    fn set_points(&mut self, response: &egui::Response, rect: Rect, points: &mut Points) {
        if response.clicked()
            && let Some(at) = response.interact_pointer_pos()
        {
            match marks_ui::nearest(&self.places(rect, points), at) {
                Some(point) => points.select(point),
                None => {
                    if let Some(place) = self.place_at(rect, at) {
                        points.add(place);
                    }
                }
            }
        }
        let moved = response.dragged_by(PointerButton::Primary);
        if let Some(point) = self.grip.point()
            && let Some(at) = response.interact_pointer_pos().filter(|_| moved)
            && let Some(place) = self.place_at(rect, at)
        {
            if self.grip.first() {
                points.begin();
                points.select(point);
            }
            points.move_point(point, place);
        }
        if response.drag_stopped() {
            self.grip = Grip::default();
        }
    }

    /// The point of the mesh at a place on the window.
    fn place_at(&self, rect: Rect, at: Pos2) -> Option<DVec3> {
        let (drawn, _) = self.shown.as_ref()?;
        let camera = &drawn.camera;
        let part = (at - rect.min) / rect.size();
        let x = (part.x * camera.width as f32) as u32;
        let y = (part.y * camera.height as f32) as u32;
        if x >= camera.width || y >= camera.height {
            return None;
        }
        let triangle = drawn.triangles[(y * camera.width + x) as usize];
        let mesh = &self.capture.mesh;
        if triangle == NO_TRIANGLE {
            return None;
        }
        let weights = Barycentrics::new(mesh, camera).at(triangle, x, y)?;
        Some(mesh.point(triangle, weights).position.as_dvec3())
    }

    /// Where the points are on the window, and whether the mesh hides them.
    fn places(&self, rect: Rect, points: &Points) -> Vec<(Option<Pos2>, bool)> {
        let Some((drawn, _)) = &self.shown else {
            return vec![(None, false); points.all().len()];
        };
        let camera = &drawn.camera;
        let size = DVec2::new(camera.width.into(), camera.height.into());
        let near = HIDDEN * self.capture.mesh.diagonal();
        let of = |place: DVec3| {
            let pixel = camera.project(place)?;
            let inside = pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(size).all();
            let index = pixel.y as usize * camera.width as usize + pixel.x as usize;
            let depth = -camera.to_camera(place).z as f32;
            let part = (pixel / size).as_vec2();
            let at = rect.min + vec2(part.x, part.y) * rect.size();
            inside.then(|| (Some(at), depth > drawn.depth[index] + near))
        };
        let all = points.all().iter();
        all.map(|p| of(p.place).unwrap_or((None, false))).collect()
    }

    /// Builds what rays are cast at, and takes in the picture that was drawn.
    fn prepare(&mut self, ctx: &egui::Context, worker: &mut Worker) {
        if !self.building {
            self.building = true;
            let (capture, built) = (Arc::clone(&self.capture), Arc::clone(&self.occluder));
            worker.aside("occluder", move || {
                built.store(Arc::new(Occluder::new(&capture.mesh)));
            });
        }
        if let Some(occluder) = self.occluder.take() {
            self.built = Some(occluder);
        }
        if let Some(mut drawn) = self.newest.take() {
            self.drawing = false;
            let image = std::mem::take(&mut drawn.image);
            let texture = ctx.load_texture("mesh", image, TextureOptions::LINEAR);
            self.shown = Some((drawn, texture));
        }
    }

    /// Asks for a picture of what is seen now, one at a time: coarse while the view moves, fine once it stands still.
    fn draw(&mut self, worker: &mut Worker, rect: Rect, scale: f32) {
        let samples = if self.navigation.is_moving() {
            1
        } else {
            SAMPLES
        };
        let pixels = |side: f32| ((side * scale).round() as u32).max(8) * samples;
        let camera = self
            .navigation
            .camera(pixels(rect.width()), pixels(rect.height()));
        let same = |other: &Camera| {
            other.width == camera.width
                && other.height == camera.height
                && other.focal == camera.focal
                && other.world_from_camera == camera.world_from_camera
        };
        let Some(occluder) = self.built.clone().filter(|_| !self.drawing) else {
            return;
        };
        if self.wanted.as_ref().is_some_and(same) {
            return;
        }
        self.wanted = Some(camera.clone());
        self.drawing = true;
        let (capture, newest) = (Arc::clone(&self.capture), Arc::clone(&self.newest));
        worker.aside("mesh", move || {
            newest.store(draw(&capture, &occluder, camera, samples));
        });
    }
}

/// The mesh in clay.
fn draw(capture: &Capture, occluder: &Occluder, camera: Camera, samples: u32) -> Drawn {
    let mesh = &capture.mesh;
    let (triangles, depth) = front_most(mesh, occluder, &camera);
    let axes = camera.world_from_camera.matrix3.as_mat3();
    let eye = camera.position().as_vec3();
    let brightness = |x: u32, y: u32| -> Option<f32> {
        let triangle = triangles[(y * camera.width + x) as usize];
        if triangle == NO_TRIANGLE {
            return None;
        }
        let weights = Barycentrics::new(mesh, &camera).at(triangle, x, y)?;
        let point = mesh.point(triangle, weights);
        let normal = point.normal;
        let outward = normal * normal.dot(eye - point.position).signum();
        let key = (axes.transpose() * outward).dot(KEY.normalize_or_zero());
        let wrapped = (0.5 + 0.5 * key).max(0.0);
        Some(AROUND + REFLECTED * wrapped * wrapped)
    };
    let (width, height) = (camera.width / samples, camera.height / samples);
    let pixel = |i: usize| {
        let (x, y) = (i as u32 % width, i as u32 / width);
        let mut sum = 0.0;
        for k in 0..samples * samples {
            let level = brightness(x * samples + k % samples, y * samples + k / samples);
            sum += level.map_or(f32::from(theme::STAGE.r()) / 255.0, srgb);
        }
        Color32::from_gray((255.0 * sum / (samples * samples) as f32).round() as u8)
    };
    let pixels = (0..(width * height) as usize).into_par_iter().map(pixel);
    Drawn {
        image: ColorImage::new([width as usize, height as usize], pixels.collect()),
        camera,
        triangles,
        depth,
    }
}
