//! Moving around the object: orbit, pan and zoom, damped, with the mouse habits of other programs.

use eframe::egui::{self, PointerButton, Vec2};
use glam::{DAffine3, DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use rekindle_capture::{Camera, Distortion, Mesh};

/// Time in which a movement has mostly come to rest, seconds.
const DAMPING_S: f64 = 0.07;
/// Part of a goal's size below which the view has arrived.
const ARRIVED: f64 = 1e-4;
/// Radians per point of dragging.
const TURN: f64 = 0.008;
/// Steepest view from above or below, radians from the horizon.
const STEEPEST: f64 = 1.54;
/// Field of view across the picture's shorter side, radians.
const FIELD: f64 = 0.6;

/// Whose mouse habits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Habit {
    /// Right button turns, middle pans, wheel zooms; the left button turns too where it has nothing else to do.
    #[default]
    Rekindle,
    /// Blender's: middle button, with Shift to pan, with Ctrl to zoom.
    Blender,
    /// Maya's: Alt with left, middle and right button.
    Maya,
}

impl Habit {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Rekindle, Self::Blender, Self::Maya];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rekindle => "Rekindle",
            Self::Blender => "Blender",
            Self::Maya => "Maya",
        }
    }

    /// Gestures and what they do, for the key sheet.
    pub fn gestures(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Rekindle => &[
                ("Drag, right drag", "Turn"),
                ("Middle drag, Shift+drag", "Pan"),
                ("Wheel, pinch", "Zoom"),
                ("Double click", "Turn about this point"),
            ],
            Self::Blender => &[
                ("Middle drag", "Turn"),
                ("Shift+middle drag", "Pan"),
                ("Ctrl+middle drag, wheel", "Zoom"),
                ("Double click", "Turn about this point"),
            ],
            Self::Maya => &[
                ("Alt+drag", "Turn"),
                ("Alt+middle drag", "Pan"),
                ("Alt+right drag, wheel", "Zoom"),
                ("Double click", "Turn about this point"),
            ],
        }
    }

    /// What a drag means; `free` where the left button has nothing else to do.
    fn movement(
        self,
        button: PointerButton,
        modifiers: egui::Modifiers,
        free: bool,
    ) -> Option<Movement> {
        use PointerButton::{Middle, Primary, Secondary};
        let egui::Modifiers {
            alt, shift, ctrl, ..
        } = modifiers;
        match self {
            Self::Rekindle => match button {
                Middle => Some(Movement::Pan),
                Primary if !free => None,
                Primary | Secondary if shift => Some(Movement::Pan),
                Primary | Secondary => Some(Movement::Turn),
                _ => None,
            },
            Self::Blender => match button {
                Middle if shift => Some(Movement::Pan),
                Middle if ctrl => Some(Movement::Zoom),
                Middle => Some(Movement::Turn),
                _ => None,
            },
            Self::Maya if !alt => None,
            Self::Maya => match button {
                Primary => Some(Movement::Turn),
                Middle => Some(Movement::Pan),
                Secondary => Some(Movement::Zoom),
                _ => None,
            },
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Movement {
    Turn,
    Pan,
    Zoom,
}

/// Where a view looks from: around a point, with the horizon level.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Place {
    target: [f64; 3],
    /// About the pole, radians.
    turn: f64,
    /// Above the horizon, radians.
    height: f64,
    distance: f64,
    /// Field of view across the picture's shorter side, radians.
    field: f64,
}

/// A viewpoint that moves towards its goal.
#[derive(Clone, Debug)]
pub struct Navigation {
    up: DVec3,
    centre: DVec3,
    /// Radius of a ball about the centre that holds the object.
    size: f64,
    first: Place,
    goal: Place,
    now: Place,
}

impl Navigation {
    /// A view of the whole object from the side of `from`, the first input camera.
    pub fn new(mesh: &Mesh, up: DVec3, from: Option<&Camera>) -> Self {
        let centre = mesh.centre().as_dvec3();
        let size = 0.5 * f64::from(mesh.diagonal()).max(1e-9);
        let place = Place {
            target: centre.to_array(),
            turn: 0.6,
            height: 0.35,
            distance: framing(size, FIELD),
            field: FIELD,
        };
        let mut navigation = Self {
            up,
            centre,
            size,
            first: place,
            goal: place,
            now: place,
        };
        if let Some(camera) = from {
            let seen = navigation.place_of(camera);
            navigation.first = Place {
                target: centre.to_array(),
                distance: framing(size, FIELD),
                field: FIELD,
                ..seen
            };
        }
        navigation.goal = navigation.first;
        navigation.now = navigation.first;
        navigation
    }

    /// Two directions that span the horizon.
    fn horizon(&self) -> (DVec3, DVec3) {
        let axis = if self.up.x.abs() > 0.9 {
            DVec3::Z
        } else {
            DVec3::X
        };
        let right = (axis - axis.dot(self.up) * self.up).normalize_or_zero();
        (right, right.cross(self.up))
    }

    /// The place that comes closest to a camera: all but its roll.
    fn place_of(&self, camera: &Camera) -> Place {
        let (position, forward) = (camera.position(), camera.forward());
        let depth = (self.centre - position).dot(forward).max(0.1 * self.size);
        let target = position + depth * forward;
        let (x, y) = self.horizon();
        let back = -forward;
        Place {
            target: target.to_array(),
            turn: back.dot(y).atan2(back.dot(x)),
            height: back.dot(self.up).clamp(-1.0, 1.0).asin(),
            distance: depth,
            field: 2.0 * (0.5 * f64::from(camera.height.min(camera.width)) / camera.focal.y).atan(),
        }
    }

    /// Goes to a camera's place at once.
    pub fn jump_to(&mut self, camera: &Camera) {
        self.goal = self.place_of(camera);
        self.now = self.goal;
    }

    /// Where the view goes.
    pub fn place(&self) -> Place {
        self.goal
    }

    /// Goes to a place at once, if it is one.
    pub fn go_to(&mut self, place: Place) {
        let Place {
            target: [x, y, z],
            turn,
            height,
            distance,
            field,
        } = place;
        let sound = [x, y, z, turn, height, distance, field]
            .iter()
            .all(|v| v.is_finite());
        if sound && distance > 0.0 && field > 0.0 && field < 3.0 {
            self.goal = place;
            self.now = place;
        }
    }

    /// Shows the whole object from the present side.
    pub fn frame(&mut self) {
        self.goal.target = self.centre.to_array();
        self.goal.field = FIELD;
        self.goal.distance = framing(self.size, FIELD);
    }

    /// Back to the first viewpoint.
    pub fn reset(&mut self) {
        self.goal = self.first;
    }

    /// The point that the view turns about.
    pub fn target(&self) -> DVec3 {
        self.now.target.into()
    }

    /// Turns about this point from now on.
    pub fn look_at(&mut self, point: DVec3) {
        self.goal.target = point.to_array();
    }

    /// Takes in the mouse over the viewport; `free` where the left button has nothing else to do. Whether the view moves.
    pub fn listen(
        &mut self,
        ui: &egui::Ui,
        response: &egui::Response,
        habit: Habit,
        free: bool,
    ) -> bool {
        let before = self.goal;
        let modifiers = ui.input(|i| i.modifiers);
        for button in [
            PointerButton::Primary,
            PointerButton::Secondary,
            PointerButton::Middle,
        ] {
            if !response.dragged_by(button) {
                continue;
            }
            let delta = response.drag_delta();
            match habit.movement(button, modifiers, free) {
                Some(Movement::Turn) => self.turn(delta),
                Some(Movement::Pan) => self.pan(delta, response.rect.height()),
                Some(Movement::Zoom) => self.zoom((0.01 * f64::from(delta.y - delta.x)).exp()),
                None => {}
            }
        }
        if response.hovered() {
            let (wheel, pinch) = ui.input(|i| (i.smooth_scroll_delta().y, i.zoom_delta()));
            if pinch != 1.0 {
                self.zoom(1.0 / f64::from(pinch));
            } else if wheel != 0.0 {
                self.zoom((-0.004 * f64::from(wheel)).exp());
            }
        }
        self.goal != before
    }

    fn turn(&mut self, delta: Vec2) {
        self.goal.turn -= TURN * f64::from(delta.x);
        self.goal.height =
            (self.goal.height + TURN * f64::from(delta.y)).clamp(-STEEPEST, STEEPEST);
    }

    fn pan(&mut self, delta: Vec2, height: f32) {
        let per_point =
            2.0 * self.goal.distance * (0.5 * self.goal.field).tan() / f64::from(height.max(1.0));
        let axes = self.axes(&self.goal);
        let moved =
            per_point * (-f64::from(delta.x) * axes.x_axis + f64::from(delta.y) * axes.y_axis);
        self.goal.target = (DVec3::from(self.goal.target) + moved).to_array();
    }

    fn zoom(&mut self, factor: f64) {
        let nearest = 0.02 * self.size;
        self.goal.distance = (self.goal.distance * factor).clamp(nearest, 100.0 * self.size);
    }

    /// Moves towards the goal; whether it is still on the way.
    pub fn step(&mut self, seconds: f32) -> bool {
        let part = 1.0 - (-f64::from(seconds) / DAMPING_S).exp();
        let (from, to) = (self.now, self.goal);
        let turn = angle_between(from.turn, to.turn);
        self.now = Place {
            target: DVec3::from(from.target)
                .lerp(to.target.into(), part)
                .to_array(),
            turn: from.turn + part * turn,
            height: from.height + part * (to.height - from.height),
            distance: from.distance * (to.distance / from.distance).powf(part),
            field: from.field + part * (to.field - from.field),
        };
        let left = DVec3::from(self.now.target).distance(to.target.into()) / self.size
            + angle_between(self.now.turn, to.turn).abs()
            + (self.now.height - to.height).abs()
            + (self.now.distance / to.distance).ln().abs()
            + (self.now.field - to.field).abs();
        if left < ARRIVED {
            self.now = to;
        }
        self.now != to
    }

    /// Whether the view is still on its way.
    pub fn is_moving(&self) -> bool {
        self.now != self.goal
    }

    /// Columns: right, up and back, in the world.
    fn axes(&self, place: &Place) -> DMat3 {
        let (x, y) = self.horizon();
        let (sin, cos) = place.turn.sin_cos();
        let outward = cos * x + sin * y;
        let (sin, cos) = place.height.sin_cos();
        let back = cos * outward + sin * self.up;
        let up = cos * self.up - sin * outward;
        DMat3::from_cols(up.cross(back), up, back)
    }

    /// The camera of this view for a picture of this size in pixels.
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        let axes = self.axes(&self.now);
        let focal = 0.5 * f64::from(height.min(width)) / (0.5 * self.now.field).tan();
        Camera {
            width,
            height,
            focal: DVec2::splat(focal),
            centre: 0.5 * DVec2::new(f64::from(width), f64::from(height)),
            distortion: Distortion::default(),
            world_from_camera: DAffine3::from_mat3_translation(
                axes,
                DVec3::from(self.now.target) + self.now.distance * axes.z_axis,
            ),
        }
    }
}

/// Distance from which a ball of radius `size` fits into the field of view with some room.
fn framing(size: f64, field: f64) -> f64 {
    1.02 * size / (0.5 * field).sin()
}

/// The shorter way from one angle to another.
fn angle_between(from: f64, to: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    let difference = (to - from).rem_euclid(turn);
    if difference > 0.5 * turn {
        difference - turn
    } else {
        difference
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use rekindle_scene::surface::fixtures::bumpy_sphere;

    fn ball() -> Mesh {
        let mut mesh = bumpy_sphere(12, 0.1);
        for p in &mut mesh.positions {
            *p = 0.5 * *p + Vec3::new(0.3, 0.2, -0.1);
        }
        mesh
    }

    #[test]
    fn framing_shows_the_whole_object_from_every_side() {
        let mesh = ball();
        for up in [DVec3::Y, DVec3::Z, DVec3::new(0.6, 0.8, 0.0)] {
            let mut navigation = Navigation::new(&mesh, up, None);
            for turn in 0..12 {
                navigation.goal.turn = f64::from(turn);
                navigation.goal.distance = 100.0;
                navigation.frame();
                while navigation.step(0.02) {}
                let camera = navigation.camera(300, 200);
                for &p in &mesh.positions {
                    let at = camera.project(p.as_dvec3()).expect("before the camera");
                    assert!(
                        at.cmpge(DVec2::ZERO).all() && at.cmple(DVec2::new(300.0, 200.0)).all(),
                        "{p} at {at}"
                    );
                }
                // The pole points upwards in the picture.
                let middle = camera.project(mesh.centre().as_dvec3()).expect("seen");
                let above = camera
                    .project(mesh.centre().as_dvec3() + 0.1 * up)
                    .expect("seen");
                assert!(above.y < middle.y, "{above} over {middle}");
            }
        }
    }

    #[test]
    fn jumping_to_a_camera_shows_what_it_shows() {
        let mesh = ball();
        let mut navigation = Navigation::new(&mesh, DVec3::Y, None);
        navigation.goal.turn = 2.0;
        navigation.goal.height = -0.4;
        while navigation.step(0.02) {}
        let camera = navigation.camera(320, 240);
        let mut other = Navigation::new(&mesh, DVec3::Y, None);
        other.jump_to(&camera);
        let again = other.camera(320, 240);
        for &p in &mesh.positions {
            let (a, b) = (camera.project(p.as_dvec3()), again.project(p.as_dvec3()));
            let apart = (a.expect("seen") - b.expect("seen")).length();
            assert!(apart < 1e-6, "{apart} pixels");
        }
    }

    #[test]
    fn a_view_comes_to_rest() {
        let mut navigation = Navigation::new(&ball(), DVec3::Y, None);
        navigation.turn(Vec2::new(40.0, 10.0));
        let mut frames = 0;
        while navigation.step(1.0 / 60.0) {
            frames += 1;
            assert!(frames < 100, "still moving after {frames} frames");
        }
        assert!(!navigation.is_moving());
    }
}
