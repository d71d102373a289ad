//! The light a picture is rendered under: lamps, an ambient part and an environment.
//!
//! All radiances are `K_S`-scaled (the specular lobe's strength is 1), RGB. A lamp is a list of nodes, each a small
//! piece of the sphere around the object's centre. Where a lamp has a finite radius R, its nodes are points on
//! the sphere of that radius: directions are taken from the surface point to the node and the solid angle
//! grows with (R/|p − x|)².

use std::f32::consts::TAU;

use glam::{DAffine3, DVec3, Quat, Vec3};
use serde::{Deserialize, Serialize};

use super::environment::Environment;
use rekindle_base::math::GOLDEN_ANGLE;

/// A small piece of a lamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightNode {
    /// Unit direction from the object's centre.
    pub direction: Vec3,
    /// Radiance, RGB.
    pub radiance: Vec3,
    /// Solid angle seen from the object's centre, sr.
    pub solid_angle: f32,
}

impl LightNode {
    /// Radiance × solid angle.
    pub fn flux(&self) -> Vec3 {
        self.radiance * self.solid_angle
    }
}

/// Nodes that act as one lamp.
#[derive(Clone, Debug, PartialEq)]
pub struct LampNodes {
    /// Flux-weighted mean direction from the object's centre, unit. Edits find the lamp by it.
    pub direction: Vec3,
    /// At least one.
    pub nodes: Vec<LightNode>,
    /// Distance of the nodes from the object's centre, `None` for distant light.
    pub radius: Option<f32>,
    /// A muted lamp stays where it is and can still be edited, but sends no light.
    pub muted: bool,
}

/// Everything that lights the object.
#[derive(Clone, Debug, PartialEq)]
pub struct Lighting {
    /// The lamps, each on its own.
    pub lamps: Vec<LampNodes>,
    /// Lit nodes that belong to no lamp: part of the estimate, not to be edited one by one.
    pub remainder: Vec<LightNode>,
    /// A distant environment.
    pub environment: Option<Environment>,
    /// Radiance that comes from every direction alike, RGB. It lights the diffuse part only.
    pub ambient: Vec3,
    /// The object's centre, from which directions are measured.
    pub centre: Vec3,
    /// Distance of the estimated lamps from the centre, `None` for distant light.
    pub radius: Option<f32>,
    /// The hemisphere's pole, unit: environments are turned about it.
    pub up: Vec3,
    /// How many times larger radiances here are than real ones, K_S of eq. 4, RGB; see
    /// [`usual_specular_scale`](rekindle_scene::reflectance::Brdf::usual_specular_scale). A metal's colour is in it.
    pub specular_scale: Vec3,
}

/// How bright a light probe's picture is taken to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ProbeUnits {
    /// As bright as the captured lighting in sum.
    #[default]
    Matched,
    /// As stored, in real units, as other programs and what is exported for them have it.
    Stored,
    /// As stored, in the lighting's own units, as a solution's `hemisphere.exr` has it.
    Solution,
}

impl Lighting {
    /// These lamps alone, about an object at the origin that stands on y.
    pub fn of(lamps: Vec<LampNodes>) -> Self {
        Self {
            lamps,
            remainder: Vec::new(),
            environment: None,
            ambient: Vec3::ZERO,
            centre: Vec3::ZERO,
            radius: None,
            up: Vec3::Y,
            specular_scale: Vec3::ONE,
        }
    }

    /// The same place without any light.
    #[must_use]
    pub fn dark(&self) -> Self {
        Self {
            lamps: Vec::new(),
            remainder: Vec::new(),
            environment: None,
            ambient: Vec3::ZERO,
            ..*self
        }
    }

    /// The same after a rigid motion of all that shines.
    #[must_use]
    pub fn moved(&self, motion: &DAffine3) -> Self {
        let turn = |direction: Vec3| {
            let turned = motion.transform_vector3(direction.as_dvec3());
            turned.normalize_or(DVec3::Y).as_vec3()
        };
        let node = |node: &LightNode| LightNode {
            direction: turn(node.direction),
            ..*node
        };
        let lamp = |lamp: &LampNodes| LampNodes {
            direction: turn(lamp.direction),
            nodes: lamp.nodes.iter().map(node).collect(),
            ..*lamp
        };
        Self {
            lamps: self.lamps.iter().map(lamp).collect(),
            remainder: self.remainder.iter().map(node).collect(),
            environment: (self.environment.as_ref())
                .map(|e| e.turned(Quat::from_mat3(&motion.matrix3.as_mat3()), Vec3::ONE)),
            centre: motion.transform_point3(self.centre.as_dvec3()).as_vec3(),
            up: turn(self.up),
            ..*self
        }
    }

    /// Radiance over all directions at the centre, RGB in the units of the lighting × steradians; muted lamps send none.
    pub fn flux(&self) -> Vec3 {
        let lamps = self.lamps.iter().chain(self.environment_lamps());
        let lamps: Vec3 = lamps.filter(|l| !l.muted).map(LampNodes::flux).sum();
        let strays: Vec3 = self.remainder.iter().map(LightNode::flux).sum();
        lamps + strays + self.ambient * (4.0 * std::f32::consts::PI)
    }

    /// All of the environment as lamps; see [`Environment::lamps`].
    pub fn environment_lamps(&self) -> impl Iterator<Item = &LampNodes> {
        self.environment.iter().flat_map(Environment::lamps)
    }

    /// By what to multiply a picture of the light, of this flux over all directions, for this lighting.
    pub fn probe_gain(&self, units: ProbeUnits, flux: Vec3) -> Vec3 {
        let lit = (self.specular_scale * flux).element_sum();
        match units {
            ProbeUnits::Matched if lit > 0.0 => {
                self.specular_scale * (self.flux().element_sum() / lit)
            }
            ProbeUnits::Matched | ProbeUnits::Solution => Vec3::ONE,
            ProbeUnits::Stored => self.specular_scale,
        }
    }
}

impl LampNodes {
    /// A lamp of these nodes; `None` if they hold no light, which has no direction.
    pub fn new(nodes: Vec<LightNode>, radius: Option<f32>) -> Option<Self> {
        let direction = nodes
            .iter()
            .map(|n| n.direction * n.flux().element_sum())
            .sum::<Vec3>()
            .try_normalize()?;
        Some(Self {
            direction,
            nodes,
            radius,
            muted: false,
        })
    }

    /// A uniform disc of light.
    pub fn disc(direction: Vec3, flux: Vec3, angular_radius: f32, radius: Option<f32>) -> Self {
        /// Nodes in a disc: a lobe sees it as smooth, and its penumbra has as many steps.
        const NODES: usize = 64;
        Self::disc_of(NODES, direction, flux, angular_radius, radius)
    }

    /// A uniform disc of light as this many nodes, at least one.
    pub fn disc_of(
        count: usize,
        direction: Vec3,
        flux: Vec3,
        angular_radius: f32,
        radius: Option<f32>,
    ) -> Self {
        let count = count.max(1);
        // Equal areas along a golden spiral.
        let (tangent, bitangent) = direction.any_orthonormal_pair();
        let depth = 1.0 - angular_radius.min(std::f32::consts::PI).cos();
        let solid_angle = (TAU * depth).max(1e-9) / count as f32;
        let nodes = (0..count)
            .map(|i| {
                let height = 1.0 - depth * (i as f32 + 0.5) / count as f32;
                let across = (1.0 - height * height).max(0.0).sqrt();
                let (sin, cos) = (i as f32 * GOLDEN_ANGLE).sin_cos();
                LightNode {
                    direction: (direction * height + across * (tangent * cos + bitangent * sin))
                        .normalize_or(direction),
                    radiance: flux / (count as f32 * solid_angle),
                    solid_angle,
                }
            })
            .collect();
        Self {
            direction,
            nodes,
            radius,
            muted: false,
        }
    }

    /// Σ radiance × solid angle, RGB; zero when muted.
    pub fn flux(&self) -> Vec3 {
        if self.muted {
            return Vec3::ZERO;
        }
        let mut sum = glam::DVec3::ZERO;
        for node in &self.nodes {
            sum += node.flux().as_dvec3();
        }
        sum.as_vec3()
    }

    /// Turns the lamp rigidly by the smallest rotation that takes its direction to `to` (unit).
    pub fn turn_towards(&mut self, to: Vec3) {
        let rotation = Quat::from_rotation_arc(self.direction, to);
        for node in &mut self.nodes {
            node.direction = (rotation * node.direction).normalize_or(to);
        }
        self.direction = to;
    }
}

impl Lighting {
    /// Index of the lamp whose direction is closest to `direction`, `None` if there are no lamps.
    pub fn nearest_lamp(&self, direction: Vec3) -> Option<usize> {
        let closeness = |lamp: &LampNodes| lamp.direction.dot(direction);
        (0..self.lamps.len())
            .max_by(|&a, &b| closeness(&self.lamps[a]).total_cmp(&closeness(&self.lamps[b])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_has_its_flux_and_its_direction() {
        let direction = Vec3::new(0.6, 0.48, 0.64);
        let flux = Vec3::new(2.0, 1.0, 0.5);
        let lamp = LampNodes::disc(direction, flux, 3.0_f32.to_radians(), None);
        assert!((lamp.flux() - flux).length() < 1e-5, "{}", lamp.flux());
        let again = LampNodes::new(lamp.nodes.clone(), None).unwrap();
        assert!(
            again.direction.angle_between(direction) < 0.05_f32.to_radians(),
            "mean direction {}",
            again.direction
        );
        let mean_square = lamp
            .nodes
            .iter()
            .map(|n| n.direction.angle_between(direction).powi(2))
            .sum::<f32>()
            / lamp.nodes.len() as f32;
        // √2 × the rms angle of a uniform disc is its radius.
        let extent = (2.0 * mean_square).sqrt().to_degrees();
        assert!((extent - 3.0).abs() < 0.02, "extent {extent}°");
    }

    #[test]
    fn a_lamps_flux_and_shape_survive_a_move() {
        let from = Vec3::new(0.0, 0.8, 0.6);
        for to in [Vec3::new(0.6, 0.8, 0.0), Vec3::new(0.0, -0.8, -0.6)] {
            let mut lamp = LampNodes::disc(from, Vec3::new(3.0, 2.0, 1.0), 0.1, Some(3.0));
            let before = lamp.clone();
            lamp.turn_towards(to);
            assert!((lamp.flux() - before.flux()).length() < 1e-5);
            for (a, b) in lamp.nodes.iter().zip(&before.nodes) {
                let (now, then) = (a.direction.dot(to), b.direction.dot(from));
                assert!((now - then).abs() < 1e-5, "{now} was {then}");
            }
        }
    }
}
