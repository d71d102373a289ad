//! Handles around the object: every lamp as a mark on a sphere, dragged in the viewport.

use eframe::egui::{self, Color32, Pos2, Rect, Sense, Stroke, Vec2, vec2};
use glam::{DVec2, DVec3, Vec3};

use super::editing::{Editing, hue, move_to};
use super::hemisphere::{MarkStyle, draw_mark, grab, mark_radius};
use rekindle_capture::Camera;
use rekindle_scene::hemisphere::from_above_axes;
use rekindle_studio::{Document, Lamp, LampId};

/// Radius of the handles' sphere in radii of the object.
const REACH: f64 = 1.3;

/// A camera and where its picture lies on the window.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    pub(super) camera: Camera,
    pub(super) rect: Rect,
}

/// A handle that is being dragged.
#[derive(Clone, Copy, Debug)]
struct Held {
    lamp: LampId,
    /// Whether it is on the far side of the sphere.
    behind: bool,
    /// Whether the pointer is off the sphere.
    outside: bool,
}

/// The handles.
#[derive(Default)]
pub(super) struct Handles {
    held: Option<Held>,
}

impl From<&(Camera, Rect)> for Seen {
    fn from((camera, rect): &(Camera, Rect)) -> Self {
        Self {
            camera: camera.clone(),
            rect: *rect,
        }
    }
}

impl Seen {
    /// Points of the window per pixel of the camera.
    fn scale(&self) -> Vec2 {
        self.rect.size() / vec2(self.camera.width as f32, self.camera.height as f32)
    }

    /// Where a world point is on the window.
    pub(super) fn at(&self, world: DVec3) -> Option<Pos2> {
        let pixel = self.camera.project(world)?;
        Some(self.rect.min + vec2(pixel.x as f32, pixel.y as f32) * self.scale())
    }

    /// Origin and unit direction of the ray through a place on the window.
    pub(super) fn ray(&self, at: Pos2) -> (DVec3, DVec3) {
        let offset = (at - self.rect.min) / self.scale();
        let pixel = DVec2::new(f64::from(offset.x), f64::from(offset.y));
        (self.camera.position(), self.camera.ray(pixel))
    }
}

/// The sphere that handles are on.
#[derive(Clone, Copy)]
struct Sphere {
    centre: DVec3,
    radius: f64,
}

impl Sphere {
    /// The place on the sphere at a ray, on the asked side; with it, whether the ray misses. Then it is the nearest place of
    /// the outline.
    fn at(&self, (origin, direction): (DVec3, DVec3), behind: bool) -> (DVec3, bool) {
        let to = self.centre - origin;
        let along = to.dot(direction);
        let offset = along * direction - to;
        let room = self.radius * self.radius - offset.length_squared();
        if room <= 0.0 {
            return (offset.normalize_or_zero(), true);
        }
        let half = if behind { room.sqrt() } else { -room.sqrt() };
        ((offset + half * direction).normalize_or_zero(), false)
    }

    /// Whether a place on the sphere is on the far side.
    fn is_behind(&self, eye: DVec3, direction: DVec3) -> bool {
        let place = self.centre + self.radius * direction;
        (place - eye).dot(direction) > 0.0
    }
}

/// The sphere about a document's object.
fn sphere_of(document: &Document) -> Sphere {
    let mesh = &document.solution().mesh;
    Sphere {
        centre: mesh.centre().as_dvec3(),
        radius: REACH * 0.5 * f64::from(mesh.diagonal()),
    }
}

/// Draws the hemisphere that the handles are on: the horizon, circles 30° and 60° above it and every 30° of the compass.
pub(super) fn dome(ui: &egui::Ui, seen: &Seen, document: &Document) {
    /// Points of a whole circle.
    const POINTS: i32 = 72;
    let sphere = sphere_of(document);
    let up = document.base().lighting.up;
    let [right, north] = from_above_axes(up);
    let direction = |azimuth: f32, height: f32| {
        let flat = azimuth.sin() * right + azimuth.cos() * north;
        (height.cos() * flat + height.sin() * up).as_dvec3()
    };
    let step = std::f32::consts::TAU / POINTS as f32;
    let painter = ui.painter().with_clip_rect(seen.rect);
    let eye = seen.camera.position();
    let arc = |points: Vec<DVec3>, strength: u8| {
        for pair in points.windows(2) {
            let ends = [0, 1].map(|i| seen.at(sphere.centre + sphere.radius * pair[i]));
            if let [Some(from), Some(to)] = ends {
                let behind = sphere.is_behind(eye, pair[0]);
                let alpha = if behind { strength / 3 } else { strength };
                let line = Stroke::new(1.0, Color32::from_white_alpha(alpha));
                painter.line_segment([from, to], line);
            }
        }
    };
    for (height, strength) in [(0.0_f32, 110), (30.0, 54), (60.0, 54)] {
        let height = height.to_radians();
        let circle = (0..=POINTS).map(|k| direction(k as f32 * step, height));
        arc(circle.collect(), strength);
    }
    for k in 0..12 {
        let azimuth = k as f32 * std::f32::consts::TAU / 12.0;
        let quarter = (0..=POINTS / 4).map(|k| direction(azimuth, k as f32 * step));
        arc(quarter.collect(), if k == 0 { 110 } else { 40 });
    }
}

impl Handles {
    /// Shows the handles over the viewport. Returns whether one is held.
    pub(super) fn show(
        &mut self,
        ui: &egui::Ui,
        seen: &Seen,
        document: &mut Document,
        editing: &mut Editing,
    ) -> bool {
        let sphere = sphere_of(document);
        let look = document.look().clone();
        let mut held = None;
        for lamp in &look.lamps {
            held = held.or(self.handle(
                ui,
                seen,
                sphere,
                document,
                editing,
                lamp,
                look.is_dark(lamp),
            ));
        }
        self.held = held;
        held.is_some()
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "what a handle shows and what it may change"
    )]
    fn handle(
        &self,
        ui: &egui::Ui,
        seen: &Seen,
        sphere: Sphere,
        document: &mut Document,
        editing: &mut Editing,
        lamp: &Lamp,
        dark: bool,
    ) -> Option<Held> {
        let direction = lamp.direction.as_dvec3();
        let at = seen.at(sphere.centre + sphere.radius * direction)?;
        if !seen.rect.contains(at) && self.held.is_none_or(|h| h.lamp != lamp.id) {
            return None;
        }
        let behind = sphere.is_behind(seen.camera.position(), direction);
        let painter = ui.painter().with_clip_rect(seen.rect);
        let selected = editing.is_selected(lamp.id);
        let lit = editing.lit == Some(lamp.id);
        if (selected || lit)
            && let Some(centre) = seen.at(sphere.centre)
        {
            let faint = Color32::from_white_alpha(if behind { 24 } else { 60 });
            painter.line_segment([centre, at], Stroke::new(1.0, faint));
        }
        draw_mark(
            &painter,
            at,
            hue(document.base(), lamp),
            MarkStyle {
                radius: mark_radius(document, lamp),
                selected,
                lit,
                hollow: dark || behind,
                faint: dark,
            },
        );
        let rect = Rect::from_center_size(at, vec2(20.0, 20.0)).intersect(seen.rect);
        let id = ui.scope_id().with(("handle", lamp.id));
        let response = ui.interact(rect, id, Sense::CLICK | Sense::DRAG);
        let name = format!("{} handle", lamp.name);
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, name.clone()));
        grab(ui, &response, document, editing, lamp);
        let pointer = response
            .interact_pointer_pos()
            .filter(|_| response.dragged());
        let Some(pointer) = pointer else {
            let side = if behind { ", behind the object" } else { "" };
            response.on_hover_text(format!("{}{side}: drag to move", lamp.name));
            return None;
        };
        let mut held = self.held.filter(|h| h.lamp == lamp.id).unwrap_or(Held {
            lamp: lamp.id,
            behind,
            outside: false,
        });
        let (place, outside) = sphere.at(seen.ray(pointer), held.behind);
        if held.outside && !outside {
            // Once round the edge, to the other side.
            held.behind = !held.behind;
        }
        held.outside = outside;
        let (place, _) = if outside {
            (place, true)
        } else {
            sphere.at(seen.ray(pointer), held.behind)
        };
        let direction = place.as_vec3().normalize_or(Vec3::Y);
        move_to(document, editing, lamp, direction);
        Some(held)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_scene::surface::fixtures::camera;

    #[test]
    fn a_handle_follows_the_pointer_on_its_side() {
        let seen = Seen {
            camera: camera(DVec3::new(1.0, 2.0, 5.0), DVec3::ZERO, 200, 150, 1.2),
            rect: Rect::from_min_size(egui::pos2(30.0, 40.0), vec2(400.0, 300.0)),
        };
        let sphere = Sphere {
            centre: DVec3::ZERO,
            radius: 1.3,
        };
        for direction in [
            DVec3::new(0.1, 0.5, 0.8),
            DVec3::new(0.4, -0.2, -0.9),
            DVec3::new(-0.3, 0.2, 0.9),
        ] {
            let direction = direction.normalize_or_zero();
            let behind = sphere.is_behind(seen.camera.position(), direction);
            assert_eq!(behind, direction.z < 0.0);
            let at = seen.at(sphere.radius * direction).unwrap();
            let (back, outside) = sphere.at(seen.ray(at), behind);
            assert!(!outside && back.distance(direction) < 1e-5, "{back}");
        }
        let (edge, outside) = sphere.at(seen.ray(egui::pos2(40.0, 190.0)), false);
        assert!(outside && (edge.length() - 1.0).abs() < 1e-9);
    }
}
