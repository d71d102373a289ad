//! A photograph, large, in which points are marked.

use std::sync::Arc;

use eframe::egui::{
    self, Color32, ColorImage, CursorIcon, PointerButton, Pos2, Rect, Sense, TextureHandle,
    TextureOptions, Vec2, vec2,
};
use glam::DVec2;

use super::Grip;
use super::list::Points;
use super::marks_ui;
use crate::app::theme;
use crate::worker::{Latest, Worker};
use rekindle_capture::{Camera, Capture};
use rekindle_estimate::align::Similarity;
use rekindle_estimate::preflight::outline;
use rekindle_scene::surface::Occluder;

/// Largest magnification.
const MOST: f32 = 16.0;

/// Pixels along the longer side of an outline.
const OUTLINE: u32 = 1000;

/// What an outline is of: a view and a version of the points.
type Of = (usize, u64);

/// A view of one photograph at a time.
pub(super) struct PhotoView {
    capture: Arc<Capture>,
    view: usize,
    zoom: f32,
    /// What is in the middle, in parts of the photograph.
    middle: Vec2,
    grip: Grip,
    wanted: Option<Of>,
    drawing: bool,
    newest: Arc<Latest<(Of, ColorImage)>>,
    /// The mesh's outline where the marks place it.
    shown: Option<(Of, TextureHandle)>,
}

impl PhotoView {
    pub(super) fn new(capture: &Arc<Capture>) -> Self {
        Self {
            capture: Arc::clone(capture),
            view: 0,
            zoom: 1.0,
            middle: vec2(0.5, 0.5),
            grip: Grip::default(),
            wanted: None,
            drawing: false,
            newest: Arc::default(),
            shown: None,
        }
    }

    pub(super) fn view(&self) -> usize {
        self.view
    }

    /// Shows another photograph.
    pub(super) fn go_to(&mut self, view: usize) {
        if view != self.view {
            self.view = view;
            self.zoom = 1.0;
            self.middle = vec2(0.5, 0.5);
        }
    }

    /// Shows the photograph in `room` and sets marks in it. Whether a mark was wanted where no point is selected.
    pub(super) fn show(
        &mut self,
        ui: &mut egui::Ui,
        room: Rect,
        texture: &TextureHandle,
        points: &mut Points,
    ) -> bool {
        let picture = self.picture(room, texture.size_vec2());
        let response = ui
            .allocate_rect(picture.intersect(room), Sense::CLICK | Sense::DRAG)
            .on_hover_cursor(CursorIcon::Crosshair);
        let painter = ui.painter_at(room);
        painter.rect_filled(room, 0.0, theme::STAGE);
        painter.image(texture.id(), picture, marks_ui::WHOLE, Color32::WHITE);
        if let Some(((view, version), edge)) = &self.shown
            && points.placement().is_ok()
            && *view == self.view
        {
            // An outline of what the marks were before is faint until the new one is there.
            let strength = if *version == points.version() {
                0.9
            } else {
                0.4
            };
            let colour = theme::palette(ui).accent.gamma_multiply(strength);
            painter.image(edge.id(), picture, marks_ui::WHOLE, colour);
        }
        let lacking = self.set_marks(&response, picture, points);
        self.move_about(ui, &response, room, picture);
        self.paint_marks(ui, &painter, picture, points, response.hover_pos());
        let name = &self.capture.views[self.view].name;
        let name = format!("Photograph {name}");
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, name.clone()));
        lacking
    }

    /// Where the whole photograph would be: fitted into the room, then magnified.
    fn picture(&mut self, room: Rect, size: Vec2) -> Rect {
        let fit = (room.width() / size.x).min(room.height() / size.y);
        let size = size * fit * self.zoom;
        // What is beyond its edges is not moved into the room while there is photograph to fill it.
        for k in 0..2 {
            let half = (0.5 * room.size()[k] / size[k]).min(0.5);
            self.middle[k] = self.middle[k].clamp(half, 1.0 - half);
        }
        Rect::from_min_size(room.center() - self.middle * size, size)
    }

    fn camera(&self) -> &Camera {
        &self.capture.views[self.view].camera
    }

    fn size(&self) -> DVec2 {
        DVec2::new(self.camera().width.into(), self.camera().height.into())
    }

    fn pixel_at(&self, picture: Rect, at: Pos2) -> DVec2 {
        let part = ((at - picture.min) / picture.size()).clamp(Vec2::ZERO, Vec2::splat(1.0));
        DVec2::new(part.x.into(), part.y.into()) * self.size()
    }

    fn place_of(&self, picture: Rect, pixel: DVec2) -> Pos2 {
        let part = (pixel / self.size()).as_vec2();
        picture.min + vec2(part.x, part.y) * picture.size()
    }

    fn places(&self, picture: Rect, points: &Points) -> Vec<(Option<Pos2>, bool)> {
        let of = |i| {
            let pixel = points.mark(i, self.view)?;
            Some(self.place_of(picture, pixel))
        };
        (0..points.all().len()).map(|i| (of(i), false)).collect()
    }

    /// Clicks mark the selected point or select another, drags move marks.
    fn set_marks(&mut self, response: &egui::Response, picture: Rect, points: &mut Points) -> bool {
        let places = self.places(picture, points);
        if response.drag_started_by(PointerButton::Primary) {
            let pressed = response.ctx.input(|i| i.pointer.press_origin());
            self.grip = Grip::of(pressed.and_then(|at| marks_ui::nearest(&places, at)));
        }
        let mut lacking = false;
        if response.clicked()
            && let Some(at) = response.interact_pointer_pos()
        {
            match (marks_ui::nearest(&places, at), points.selected()) {
                (Some(point), _) => points.select(point),
                (None, Some(point)) => {
                    points.begin();
                    points.set_mark(point, self.view, self.pixel_at(picture, at));
                }
                (None, None) => lacking = true,
            }
        }
        let moved = response.dragged_by(PointerButton::Primary);
        if let Some(point) = self.grip.point()
            && let Some(at) = response.interact_pointer_pos().filter(|_| moved)
        {
            if self.grip.first() {
                points.begin();
                points.select(point);
            }
            points.set_mark(point, self.view, self.pixel_at(picture, at));
        }
        lacking
    }

    /// The wheel magnifies about the pointer, drags move the photograph.
    fn move_about(&mut self, ui: &egui::Ui, response: &egui::Response, room: Rect, picture: Rect) {
        if response.dragged() && !self.grip.is_held() {
            self.middle -= response.drag_delta() / picture.size();
        }
        if response.drag_stopped() {
            self.grip = Grip::default();
        }
        let Some(pointer) = response.hover_pos() else {
            return;
        };
        let (wheel, pinch) = ui.input(|i| (i.smooth_scroll_delta().y, i.zoom_delta()));
        let factor = if pinch == 1.0 {
            (0.004 * wheel).exp()
        } else {
            pinch
        };
        let zoom = (self.zoom * factor).clamp(1.0, MOST);
        if zoom != self.zoom {
            // What is under the pointer stays there.
            let part = (pointer - picture.min) / picture.size();
            let size = picture.size() * (zoom / self.zoom);
            self.middle = part - (pointer - room.center()) / size;
            self.zoom = zoom;
            ui.ctx().request_repaint();
        }
    }

    fn paint_marks(
        &self,
        ui: &egui::Ui,
        painter: &egui::Painter,
        picture: Rect,
        points: &Points,
        pointer: Option<Pos2>,
    ) {
        let places = self.places(picture, points);
        let accent = theme::palette(ui).accent;
        if let Ok(placement) = points.placement() {
            for (i, point) in points.all().iter().enumerate() {
                let expected = self
                    .camera()
                    .project(placement.transform.apply(point.place));
                if let (None, Some(pixel)) = (places[i].0, expected) {
                    let selected = (points.selected() == Some(i)).then_some(accent);
                    let at = self.place_of(picture, pixel);
                    marks_ui::paint_expected(painter, at, selected);
                }
            }
        }
        let hovered = pointer.and_then(|at| marks_ui::nearest(&places, at));
        for (i, &(at, _)) in places.iter().enumerate() {
            let selected = points.selected() == Some(i);
            marks_ui::paint(ui, painter, at, i, selected, false, hovered == Some(i));
        }
    }

    /// Draws the outline of the mesh where the marks place it, beside the window's thread.
    pub(super) fn draw_outline(
        &mut self,
        ctx: &egui::Context,
        worker: &mut Worker,
        occluder: Option<&Arc<Occluder>>,
        points: &Points,
    ) {
        if let Some((of, image)) = self.newest.take() {
            self.drawing = false;
            let texture = ctx.load_texture("outline by marks", image, TextureOptions::LINEAR);
            self.shown = Some((of, texture));
        }
        let of = (self.view, points.version());
        let (Ok(placement), Some(occluder)) = (points.placement(), occluder) else {
            return;
        };
        if self.drawing || self.wanted == Some(of) {
            return;
        }
        (self.wanted, self.drawing) = (Some(of), true);
        let (capture, newest) = (Arc::clone(&self.capture), Arc::clone(&self.newest));
        let (occluder, transform) = (Arc::clone(occluder), placement.transform);
        let Camera { width, height, .. } = *self.camera();
        let scale = f64::from(OUTLINE) / f64::from(width.max(height));
        let side = |side: u32| ((f64::from(side) * scale).round() as u32).max(1);
        let camera = self.camera().resized(side(width), side(height));
        worker.aside("outline", move || {
            let image = draw(&capture, &occluder, &transform, &camera);
            newest.store((of, image));
        });
    }
}

/// The outline of a mesh that was moved, white on nothing.
fn draw(
    capture: &Capture,
    occluder: &Occluder,
    transform: &Similarity,
    camera: &Camera,
) -> ColorImage {
    let edges = outline(&capture.mesh, occluder, &transform.seen_from(camera));
    let colour = |edge| {
        if edge {
            Color32::WHITE
        } else {
            Color32::TRANSPARENT
        }
    };
    let size = [camera.width as usize, camera.height as usize];
    ColorImage::new(size, edges.into_iter().map(colour).collect())
}
