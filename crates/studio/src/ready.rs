//! Ready-made setups: usual ways to light an object, as seen by whoever looks at it, as bright as the captured light.
//!
//! How bright a light makes what is seen of a sphere is, in the mean over the picture, its flux times the phase function of a
//! Lambertian sphere, `f(α) = 2 (sin α + (π − α) cos α) / 3π` with α the angle between light and viewer (Schönberg 1925). All
//! lights of a setup are scaled by one factor until they come to what the captured light comes to.

use std::f32::consts::{PI, TAU};

use glam::{Quat, Vec3};

use super::document::State;
use super::lamp::{Baseline, Colour, Lamp, LampId, Origin};
use super::look::Look;
use rekindle_relight::luminance;

/// A usual way to light an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadySetup {
    /// Key, fill and back light.
    ThreePoint,
    /// One large soft light from the side.
    SoftBox,
    /// Two lights from behind.
    Rim,
    /// A ring of lights around the viewer.
    Ring,
    /// Daylight through a window.
    Window,
    /// A low sun under a blue sky.
    GoldenHour,
}

/// A light of a setup.
struct Placed {
    name: &'static str,
    direction: Vec3,
    /// Angular radius, degrees.
    radius: f32,
    /// Flux relative to the setup's other lights.
    share: f32,
    /// Colour temperature; none is white.
    kelvin: Option<f32>,
}

/// Directions as the viewer has them.
struct Viewer {
    towards: Vec3,
    right: Vec3,
    front: Vec3,
    up: Vec3,
}

impl Viewer {
    /// A viewer in a unit direction from the object.
    fn new(towards: Vec3, up: Vec3) -> Self {
        let flat = towards.reject_from_normalized(up);
        let front = flat.normalize_or(up.any_orthonormal_vector());
        Self {
            towards,
            right: up.cross(front),
            front,
            up,
        }
    }

    /// The direction at degrees to the viewer's right, and above the horizon.
    fn at(&self, aside: f32, height: f32) -> Vec3 {
        let (aside, height) = (aside.to_radians(), height.to_radians());
        let flat = aside.cos() * self.front + aside.sin() * self.right;
        height.cos() * flat + height.sin() * self.up
    }

    /// The direction at degrees from the viewer's own, turned about it by an angle in radians.
    fn around(&self, degrees: f32, turn: f32) -> Vec3 {
        let tilted = Quat::from_axis_angle(self.right, degrees.to_radians()) * self.towards;
        Quat::from_axis_angle(self.towards, turn) * tilted
    }
}

impl ReadySetup {
    /// All of them, in the order of menus.
    pub const ALL: [Self; 6] = [
        Self::ThreePoint,
        Self::SoftBox,
        Self::Rim,
        Self::Ring,
        Self::Window,
        Self::GoldenHour,
    ];

    /// Its name and what it is.
    pub fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::ThreePoint => ("Three-point", "Key from the right, soft fill, back light"),
            Self::SoftBox => ("Soft box", "One large soft light from the right"),
            Self::Rim => ("Rim", "Two lights from behind, little from the front"),
            Self::Ring => ("Ring", "A ring of lights around the camera"),
            Self::Window => ("Window", "Daylight through a window on the left"),
            Self::GoldenHour => ("Golden hour", "A low warm sun under a blue sky"),
        }
    }

    /// What part of the captured light's brightness it has: dark setups are meant to be dark.
    fn level(self) -> f32 {
        match self {
            Self::Rim => 0.4,
            _ => 1.0,
        }
    }

    fn lights(self, viewer: &Viewer) -> Vec<Placed> {
        let white = |name, direction, radius, share| Placed {
            name,
            direction,
            radius,
            share,
            kelvin: None,
        };
        let warm = |placed: Placed, kelvin| Placed {
            kelvin: Some(kelvin),
            ..placed
        };
        match self {
            Self::ThreePoint => vec![
                white("Key", viewer.at(45.0, 40.0), 8.0, 1.0),
                white("Fill", viewer.at(-40.0, 15.0), 25.0, 0.3),
                white("Back", viewer.at(165.0, 45.0), 8.0, 0.8),
            ],
            Self::SoftBox => vec![
                white("Soft box", viewer.at(45.0, 35.0), 30.0, 1.0),
                white("Reflector", viewer.at(-60.0, 10.0), 40.0, 0.12),
            ],
            Self::Rim => vec![
                white("Rim right", viewer.at(140.0, 25.0), 6.0, 1.0),
                white("Rim left", viewer.at(-140.0, 25.0), 6.0, 1.0),
                white("Fill", viewer.at(0.0, 20.0), 50.0, 0.1),
            ],
            Self::Ring => {
                const LIGHTS: u8 = 8;
                let turn = |k: u8| TAU * f32::from(k) / f32::from(LIGHTS);
                let lights = (0..LIGHTS).map(|k| viewer.around(14.0, turn(k)));
                lights.map(|at| white("Ring", at, 4.0, 1.0)).collect()
            }
            Self::Window => {
                let panes = [45.0, 30.0, 15.0].into_iter();
                let panes = panes.flat_map(|height| [-87.0, -73.0].map(|aside| (aside, height)));
                let panes = panes.map(|(aside, height)| {
                    let pane = white("Pane", viewer.at(aside, height), 7.0, 1.0);
                    warm(pane, 6500.0)
                });
                let room = white("Room", viewer.at(90.0, 20.0), 60.0, 0.7);
                panes.chain([warm(room, 5000.0)]).collect()
            }
            Self::GoldenHour => vec![
                warm(white("Sun", viewer.at(-60.0, 8.0), 1.5, 1.0), 3000.0),
                warm(white("Sky", viewer.up, 70.0, 0.4), 10_000.0),
            ],
        }
    }

    /// The setup for a viewer in a unit direction from the object; its lamps are numbered from `first`.
    fn look(self, base: &Baseline, towards: Vec3, first: u32) -> Look {
        let viewer = Viewer::new(towards, base.lighting.up);
        let lights = self.lights(&viewer);
        let own = lights.iter().map(|l| l.share * seen(l.direction, towards));
        let captured = brightness(base, towards);
        // Nothing was found: as bright as a lamp that is added then.
        let wanted = if captured > 0.0 { captured } else { 1.0 };
        let scale = self.level() * wanted / own.sum::<f32>();
        let mut lamps: Vec<Lamp> = Vec::with_capacity(lights.len());
        for (light, number) in lights.into_iter().zip(first..) {
            let same = lamps.iter().filter(|l| l.name.starts_with(light.name));
            let name = match same.count() {
                0 => light.name.to_owned(),
                n => format!("{} {}", light.name, n + 1),
            };
            lamps.push(Lamp {
                id: LampId(number),
                name,
                origin: Origin::Added([light.share * scale; 3]),
                direction: light.direction.normalize_or(base.lighting.up),
                stops: 0.0,
                colour: light.kelvin.map_or(Colour::Gain([1.0; 3]), Colour::Kelvin),
                angular_radius: Some(light.radius.to_radians()),
                muted: false,
                group: None,
            });
        }
        Look {
            name: self.words().0.to_owned(),
            captured: false,
            lamps,
            groups: Vec::new(),
            solo: Vec::new(),
            remainder: false,
            ambient: 0.0,
            probe: None,
        }
    }
}

impl State {
    /// Adds a ready-made setup for a viewer in a unit direction from the object, and shows it.
    pub fn add_ready(&mut self, base: &Baseline, ready: ReadySetup, towards: Vec3) {
        let look = ready.look(base, towards, self.next_lamp);
        self.next_lamp = self.next_lamp.saturating_add(look.lamps.len() as u32);
        self.push_look(look);
    }
}

/// How bright a light of flux 1 makes what is seen of a sphere, in the mean.
fn seen(light: Vec3, viewer: Vec3) -> f32 {
    let angle = light.angle_between(viewer);
    2.0 / (3.0 * PI) * (angle.sin() + (PI - angle) * angle.cos())
}

/// How bright the captured light makes what is seen of a sphere, in the mean.
fn brightness(base: &Baseline, towards: Vec3) -> f32 {
    let lighting = &base.lighting;
    let lamps = base.lamps.iter().map(|l| (l.direction, l.flux));
    let stray = lighting.remainder.iter().map(|n| (n.direction, n.flux()));
    let lit = lamps.chain(stray);
    let lit: f32 = lit
        .map(|(direction, flux)| luminance(flux) * seen(direction, towards))
        .sum();
    lit + PI * luminance(lighting.ambient)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::solution;

    /// The mean irradiance of what is seen of a sphere, by adding it up.
    fn measured(lights: &[(Vec3, f32)], viewer: Vec3) -> f32 {
        const COUNT: u32 = 20_000;
        let golden = PI * (3.0 - 5.0_f32.sqrt());
        let (mut sum, mut weights) = (0.0, 0.0);
        for i in 0..COUNT {
            let z = 1.0 - (2 * i + 1) as f32 / COUNT as f32;
            let (sin, cos) = (golden * i as f32).sin_cos();
            let normal = Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
            let weight = normal.dot(viewer).max(0.0);
            let light = lights.iter().map(|(l, f)| f * normal.dot(*l).max(0.0));
            sum += weight * light.sum::<f32>();
            weights += weight;
        }
        sum / weights
    }

    #[test]
    fn ready_setups_are_as_bright_as_the_captured_light() {
        let base = Baseline::new(&solution());
        for towards in [Vec3::Z, Vec3::new(0.6, 0.64, 0.48), Vec3::Y] {
            let captured = base.lamps.iter().map(|l| (l.direction, luminance(l.flux)));
            let stray = base.lighting.remainder.iter();
            let stray = stray.map(|n| (n.direction, luminance(n.flux())));
            let captured: Vec<_> = captured.chain(stray).collect();
            let captured = measured(&captured, towards) + PI * luminance(base.lighting.ambient);
            for ready in ReadySetup::ALL {
                let look = ready.look(&base, towards, 7);
                let lights = look.lamps.iter();
                let lights = lights.map(|l| (l.direction, luminance(base.flux(l))));
                let bright = measured(&lights.collect::<Vec<_>>(), towards);
                let off = bright / (ready.level() * captured);
                assert!((off - 1.0).abs() < 0.01, "{ready:?} at {towards}: {off}");
            }
        }
    }

    #[test]
    fn a_ready_setup_stands_beside_the_others_with_names_of_its_own() {
        let base = Baseline::new(&solution());
        let mut state = State::new(&base);
        state.add_ready(&base, ReadySetup::Window, Vec3::Z);
        state.add_ready(&base, ReadySetup::Window, Vec3::Z);
        let names: Vec<&str> = state.looks.iter().map(|l| l.name.as_str()).collect();
        assert_eq!(names, ["Captured light", "Window", "Window 2"]);
        assert_eq!(state.active, 2);
        let lamps: Vec<&str> = state.look().lamps.iter().map(|l| l.name.as_str()).collect();
        assert_eq!(lamps[..3], ["Pane", "Pane 2", "Pane 3"]);
        let mut ids: Vec<LampId> = state.look().lamps.iter().map(|l| l.id).collect();
        ids.dedup();
        assert_eq!(ids.len(), 7);
        // The window is on the viewer's left.
        assert!(state.look().lamps[0].direction.x < -0.5);
        assert!(state.checked(&base).is_ok());
    }
}
