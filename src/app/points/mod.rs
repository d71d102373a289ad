//! Aligning by points: points are set on the mesh and marked in photographs, until they place it.

mod list;
mod marks_ui;
mod mesh_view;
mod photo_view;

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Button, Color32, CornerRadius, ProgressBar, Rect, RichText, ScrollArea, Sense,
    Stroke, StrokeKind, TextureHandle, UiBuilder, vec2,
};

use super::commands::Action;
use super::estimation::sentence;
use super::theme::{self, Mark};
use super::{Request, Shared};
use list::Points;
use mesh_view::MeshView;
use photo_view::PhotoView;
use rekindle_capture::Capture;
use rekindle_estimate::align::{MarkedPoint, MarksError};

/// Height of the line over a picture and of the strip of photographs, points.
const HEAD: f32 = 32.0;
const STRIP: f32 = 84.0;
/// Part of the width that the mesh takes.
const MESH: f32 = 0.46;

/// What the pointer holds.
#[derive(Clone, Copy, Debug, Default)]
struct Grip {
    point: Option<usize>,
    moved: bool,
}

impl Grip {
    fn of(point: Option<usize>) -> Self {
        Self {
            point,
            moved: false,
        }
    }

    fn is_held(self) -> bool {
        self.point.is_some()
    }

    fn point(self) -> Option<usize> {
        self.point
    }

    /// Whether it moves for the first time.
    fn first(&mut self) -> bool {
        !std::mem::replace(&mut self.moved, true)
    }
}

/// The page while points are set.
pub(super) struct ByPoints {
    capture: Arc<Capture>,
    points: Points,
    mesh_view: MeshView,
    photo_view: PhotoView,
    /// A photograph was clicked with no point selected.
    lacking: bool,
}

impl ByPoints {
    pub(super) fn new(capture: &Arc<Capture>, points: Vec<MarkedPoint>) -> Self {
        Self {
            capture: Arc::clone(capture),
            points: Points::new(Arc::clone(capture), points),
            mesh_view: MeshView::new(capture),
            photo_view: PhotoView::new(capture),
            lacking: false,
        }
    }

    /// Points and marks so far.
    pub(super) fn points(&self) -> &[MarkedPoint] {
        self.points.all()
    }

    pub(super) fn can_undo(&self) -> bool {
        self.points.can_undo()
    }

    pub(super) fn can_redo(&self) -> bool {
        self.points.can_redo()
    }

    pub(super) fn undo(&mut self) {
        self.points.undo();
    }

    pub(super) fn redo(&mut self) {
        self.points.redo();
    }

    /// Carries out a command about the view of the mesh or about the photographs.
    pub(super) fn act(&mut self, action: Action) {
        match action {
            Action::Frame => self.mesh_view.navigation_mut().frame(),
            Action::ResetView => self.mesh_view.navigation_mut().reset(),
            Action::Camera(n) => self.photo_view.go_to(usize::from(n)),
            _ => {}
        }
    }

    fn remove_selected(&mut self) {
        if let Some(point) = self.points.selected() {
            self.points.remove(point);
        }
    }

    /// Shows the page. Whether it is to be left.
    pub(super) fn show(
        &mut self,
        ui: &mut egui::Ui,
        shared: &mut Shared<'_>,
        textures: &[[TextureHandle; 2]],
    ) -> bool {
        let typing = ui.ctx().text_edit_focused();
        if !typing && ui.input_mut(|i| i.consume_key(egui::Modifiers::NONE, egui::Key::Delete)) {
            self.remove_selected();
        }
        let mut leave = false;
        egui::Panel::left("points")
            .frame(theme::side(ui))
            .resizable(true)
            .default_size(theme::SIDE)
            .size_range(240.0..=420.0)
            .show(ui, |ui| {
                egui::Panel::bottom("align by points")
                    .frame(egui::Frame::new())
                    .show_separator_line(false)
                    .show(ui, |ui| leave = self.start_ui(ui, shared));
                ScrollArea::vertical()
                    .auto_shrink(false)
                    .show(ui, |ui| self.points_ui(ui));
            });
        egui::CentralPanel::default()
            .frame(theme::side(ui))
            .show(ui, |ui| self.pictures_ui(ui, shared, textures));
        leave
    }

    fn points_ui(&mut self, ui: &mut egui::Ui) {
        ui.heading("Align by points");
        ui.add_space(4.0);
        ui.weak(
            "Click a point on the mesh, then the same point in photographs, best in two. \
             Three points that are not on one line are enough.",
        );
        ui.add_space(theme::GAP);
        for point in 0..self.points.all().len() {
            if self.point_ui(ui, point) {
                self.points.remove(point);
                break;
            }
        }
    }

    /// One point of the list; whether it is to be removed.
    fn point_ui(&mut self, ui: &mut egui::Ui, point: usize) -> bool {
        let selected = self.points.selected() == Some(point);
        let place = self.points.all()[point].place;
        let name = format!("Point {}", point + 1);
        let mut remove = false;
        ui.horizontal(|ui| {
            let row = Button::selectable(selected, &name).min_size(vec2(72.0, 0.0));
            let row = ui.add(row).on_hover_text(format!(
                "At {:.6}, {:.6}, {:.6} on the mesh; marks go to the selected point",
                place.x, place.y, place.z
            ));
            let told = format!("{name} at {} {} {}", place.x, place.y, place.z);
            row.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, told.clone()));
            if row.clicked() {
                self.points.select(point);
            }
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                let name = format!("Remove point {}", point + 1);
                remove = theme::close_button(ui, &name, "Remove the point and its marks (Delete)")
                    .clicked();
                let wrapped = egui::Layout::left_to_right(egui::Align::Center).with_main_wrap(true);
                ui.with_layout(wrapped, |ui| self.marks_of(ui, point));
            });
        });
        remove
    }

    /// The photographs in which a point is marked, to go there.
    fn marks_of(&mut self, ui: &mut egui::Ui, point: usize) {
        ui.spacing_mut().item_spacing.x = 4.0;
        let views: Vec<usize> = self.points.all()[point]
            .marks
            .iter()
            .map(|m| m.view)
            .collect();
        if views.is_empty() {
            ui.weak("not marked yet");
        } else {
            ui.weak("in");
        }
        for view in views {
            let miss = self.points.miss(point, view);
            let off = miss.map_or(String::new(), |miss| {
                format!("\nThe placed mesh misses the mark by {miss:.1} pixels")
            });
            let chip = Button::new(RichText::new((view + 1).to_string()).small())
                .min_size(vec2(22.0, 20.0))
                .selected(view == self.photo_view.view());
            let name = &self.capture.views[view].name;
            let chip = ui.add(chip).on_hover_text(format!(
                "Marked in {name}; right click removes the mark{off}"
            ));
            let told = format!("Mark of point {} in photograph {}", point + 1, view + 1);
            chip.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, told.clone()));
            if chip.clicked() {
                self.points.select(point);
                self.photo_view.go_to(view);
            }
            if chip.secondary_clicked() {
                self.points.remove_mark(point, view);
            }
        }
    }

    /// What is missing or how well the marks fit, and the buttons. Whether the page is to be left.
    fn start_ui(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) -> bool {
        let (mark, text) = self.told();
        theme::card(ui).show(ui, |ui| {
            ui.set_width(ui.available_width());
            ui.horizontal_top(|ui| {
                mark.show(ui);
                ui.vertical(|ui| ui.label(text));
            });
        });
        ui.add_space(8.0);
        if let Some(part) = shared.aligning {
            progress_ui(ui, shared, part);
            return false;
        }
        let ready = self.points.placement().is_ok() && !shared.busy;
        let align = theme::main_button(ui, "Align the mesh").min_size(vec2(0.0, 38.0));
        let align = ui.vertical_centered_justified(|ui| {
            ui.add_enabled(ready, align)
                .on_hover_text(
                    "Place the mesh by the points, then fit it to the photographs' silhouettes",
                )
                .on_disabled_hover_text("Set and mark points first, as said above")
        });
        if align.inner.clicked() {
            let points = self.points.all().to_vec();
            shared.actions.push(Request::Align(points));
        }
        let back = ui.vertical_centered_justified(|ui| {
            ui.button("Back to the capture")
                .on_hover_text("The points are kept as long as the capture is open")
        });
        back.inner.clicked()
    }

    fn told(&self) -> (Mark, String) {
        if self.lacking && self.points.selected().is_none() {
            let text = "Select a point, or set one on the mesh, before marking it.";
            return (Mark::Note, text.to_owned());
        }
        match self.points.placement() {
            Ok(placement) => {
                let miss = placement.mean_miss();
                let text = format!("The marks fit within {miss:.1} pixels on average.");
                (Mark::Good, text)
            }
            Err(error @ (MarksError::Contradiction { .. } | MarksError::Ambiguous)) => {
                (Mark::Warning, sentence(&error.to_string()) + ".")
            }
            Err(error) => (Mark::Note, sentence(&error.to_string()) + "."),
        }
    }

    /// Mesh and photograph beside each other, the other photographs below.
    fn pictures_ui(
        &mut self,
        ui: &mut egui::Ui,
        shared: &mut Shared<'_>,
        textures: &[[TextureHandle; 2]],
    ) {
        let room = ui.available_rect_before_wrap();
        let gap = ui.spacing().item_spacing.x;
        let (left, right) = room.split_left_right_at_fraction(MESH);
        let (left, right) = (left.with_max_x(left.max.x - gap), right);
        let habit = shared.settings.habit;
        let turn = habit.gestures()[0].0.to_lowercase();
        let hint = format!("click: point   {turn}: turn   wheel: zoom");
        head_ui(ui, left, "Mesh", &hint, |ui| {
            let up = ui.small_button(format!("Up: {}", self.mesh_view.up()));
            let tip = "Let another axis of the mesh point up, as for one that lies on its side";
            if up.on_hover_text(tip).clicked() {
                self.mesh_view.turn_up();
            }
        });
        let mesh = left.with_min_y(left.min.y + HEAD);
        self.mesh_view
            .show(ui, mesh, shared.worker, habit, &mut self.points);
        let view = self.photo_view.view();
        let title = format!("Photograph {}", view + 1);
        let hint = "click: mark   drag: move   wheel: zoom";
        head_ui(ui, right, &title, hint, |_| {});
        let photo = right
            .with_min_y(right.min.y + HEAD)
            .with_max_y(right.max.y - STRIP - gap);
        let Some([texture, _]) = textures.get(view) else {
            return;
        };
        let occluder = self.mesh_view.occluder();
        self.photo_view
            .draw_outline(ui.ctx(), shared.worker, occluder, &self.points);
        let lacking = self.photo_view.show(ui, photo, texture, &mut self.points);
        self.lacking = lacking || self.lacking && self.points.selected().is_none();
        let strip = right.with_min_y(right.max.y - STRIP);
        ui.scope_builder(UiBuilder::new().max_rect(strip), |ui| {
            ScrollArea::horizontal()
                .auto_shrink(false)
                .show(ui, |ui| self.strip_ui(ui, textures));
        });
    }

    fn strip_ui(&mut self, ui: &mut egui::Ui, textures: &[[TextureHandle; 2]]) {
        // All of them side by side, where they are not too many.
        let gap = ui.spacing().item_spacing.x;
        let each = ui.available_width() / textures.len().max(1) as f32 - gap;
        ui.horizontal(|ui| {
            for (view, [texture, _]) in textures.iter().enumerate() {
                let size = texture.size_vec2();
                let height = (each * size.y / size.x).clamp(0.6 * STRIP, STRIP - 12.0);
                let size = vec2(height * size.x / size.y, height);
                if self.small_ui(ui, view, texture, size).clicked() {
                    self.photo_view.go_to(view);
                }
            }
        });
    }

    /// A small photograph with its number and that of its marks.
    fn small_ui(
        &self,
        ui: &mut egui::Ui,
        view: usize,
        texture: &TextureHandle,
        size: egui::Vec2,
    ) -> egui::Response {
        let (rect, response) = ui.allocate_exact_size(size, Sense::click());
        let painter = ui.painter_at(rect);
        painter.rect_filled(rect, CornerRadius::same(6), theme::STAGE);
        painter.image(texture.id(), rect, marks_ui::WHOLE, Color32::WHITE);
        let marked = self
            .points
            .all()
            .iter()
            .filter(|p| p.marks.iter().any(|m| m.view == view));
        let marks = marked.count();
        let font = egui::TextStyle::Small.resolve(ui.style());
        let number = (view + 1).to_string();
        let corner = rect.left_bottom() + vec2(7.0, -5.0);
        painter.text(
            corner,
            Align2::LEFT_BOTTOM,
            number,
            font.clone(),
            theme::ON_STAGE,
        );
        let palette = theme::palette(ui);
        if marks > 0 {
            let middle = rect.right_top() + vec2(-12.0, 12.0);
            painter.circle_filled(middle, 7.5, palette.accent);
            let colour = palette.on_accent;
            painter.text(
                middle,
                Align2::CENTER_CENTER,
                marks.to_string(),
                font,
                colour,
            );
        }
        let here = view == self.photo_view.view();
        let stroke = match (here, response.hovered()) {
            (true, _) => Stroke::new(2.0, palette.accent),
            (_, true) => Stroke::new(1.0, palette.accent),
            _ => Stroke::NONE,
        };
        painter.rect_stroke(rect, CornerRadius::same(6), stroke, StrokeKind::Inside);
        let name = format!("Show photograph {}", view + 1);
        response.widget_info(|| {
            egui::WidgetInfo::selected(egui::Role::Button, true, here, name.clone())
        });
        let plural = if marks == 1 { "" } else { "s" };
        let name = &self.capture.views[view].name;
        response.on_hover_text(format!("{name}: {marks} mark{plural}"))
    }
}

/// How far an alignment is, and a button to stop it.
pub(super) fn progress_ui(ui: &mut egui::Ui, shared: &mut Shared<'_>, part: f32) {
    ui.horizontal(|ui| {
        let stop = vec2(64.0, theme::TALL);
        let width = ui.available_width() - stop.x - ui.spacing().item_spacing.x;
        let bar = ProgressBar::new(part)
            .desired_width(width)
            .desired_height(theme::TALL)
            .text(format!("Aligning, {:.0} %", 100.0 * part));
        ui.add(bar);
        let stop = ui.add_sized(stop, Button::new("Stop"));
        if stop.on_hover_text("Leave the mesh where it is").clicked() {
            shared.actions.push(Request::Action(Action::Stop));
        }
    });
}

/// The line over a picture: what it shows, what the mouse does there, and what more there is.
fn head_ui(
    ui: &mut egui::Ui,
    room: Rect,
    title: &str,
    hint: &str,
    more: impl FnOnce(&mut egui::Ui),
) {
    let line = room.with_max_y(room.min.y + HEAD - 6.0);
    ui.scope_builder(UiBuilder::new().max_rect(line), |ui| {
        ui.horizontal_centered(|ui| {
            theme::group(ui, title);
            more(ui);
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                ui.add(egui::Label::new(RichText::new(hint).small().weak()).truncate());
            });
        });
    });
}
