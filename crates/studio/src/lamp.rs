//! A lamp as an artist sets it: named, with intensity in stops, a colour and a softness.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::group::GroupId;
use rekindle_relight::luminance;
use rekindle_relight::{LampNodes, Lighting};
use rekindle_solution::Solution;

/// Intensities stay within this many stops of the lamp's own.
pub const MAX_STOPS: f32 = 12.0;
/// Angular radii stay between these, radians: a fifth of a degree and what `edits.json` takes.
pub const ANGULAR_RADIUS: [f32; 2] = [0.2 * DEGREE, 90.0 * DEGREE];
/// Colour temperatures stay between these, kelvin: where the locus below holds.
pub const KELVIN: [f32; 2] = [1667.0, 25000.0];
const DEGREE: f32 = std::f32::consts::PI / 180.0;

/// Names a lamp for the life of a document, in all its looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct LampId(pub u32);

/// Where a lamp comes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// Lamp of this index of the estimate's lighting.
    Estimated(usize),
    /// A disc of light with this radiance × solid angle, RGB, before intensity and colour.
    Added([f32; 3]),
}

/// A lamp's colour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Colour {
    /// A factor of each channel; 1, 1, 1 is the lamp's own colour.
    Gain([f32; 3]),
    /// The colour of a black body at this temperature in kelvin, at the lamp's own luminance.
    Kelvin(f32),
}

/// A lamp of a look.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lamp {
    /// Names it.
    pub id: LampId,
    /// What people call it.
    pub name: String,
    /// Where it comes from.
    pub origin: Origin,
    /// Unit direction from the object's centre, in the world.
    #[serde(with = "super::vector")]
    pub direction: Vec3,
    /// Intensity in stops relative to its own.
    pub stops: f32,
    /// Its colour.
    pub colour: Colour,
    /// Angular radius in radians; `None` leaves the shape as it was estimated.
    pub angular_radius: Option<f32>,
    /// Whether it is switched off.
    pub muted: bool,
    /// The group of its look that it is in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<GroupId>,
}

/// A lamp of the estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseLamp {
    /// What the solution calls it.
    pub name: String,
    /// Unit direction from the object's centre.
    pub direction: Vec3,
    /// Radiance × solid angle, RGB.
    pub flux: Vec3,
    /// √2 × flux-weighted rms angle of its nodes, radians.
    pub angular_radius: f32,
}

/// The captured lighting: what looks start from and edits refer to.
#[derive(Clone, Debug)]
pub struct Baseline {
    /// As the solution has it.
    pub lighting: Lighting,
    /// One for each lamp of the lighting, in its order.
    pub lamps: Vec<BaseLamp>,
}

impl Baseline {
    /// The light that a solution found.
    pub fn new(solution: &Solution) -> Self {
        let lighting = solution.lighting();
        let lamps = lighting
            .lamps
            .iter()
            .enumerate()
            .map(|(i, lamp)| {
                // The lighting leaves out lamps without light, so names go by direction.
                let closeness =
                    |s: &rekindle_solution::SolutionLamp| s.direction.dot(lamp.direction);
                let known = solution
                    .lamps
                    .iter()
                    .max_by(|a, b| closeness(a).total_cmp(&closeness(b)));
                BaseLamp {
                    name: known.map_or_else(|| format!("Light {}", i + 1), |s| s.name.clone()),
                    direction: lamp.direction,
                    flux: lamp.flux(),
                    angular_radius: known.map_or(0.0, |s| s.angular_radius),
                }
            })
            .collect();
        Self { lighting, lamps }
    }

    /// A lamp's radiance × solid angle before intensity and colour, RGB.
    pub fn own_flux(&self, lamp: &Lamp) -> Vec3 {
        match lamp.origin {
            Origin::Estimated(index) => self.lamps.get(index).map_or(Vec3::ZERO, |l| l.flux),
            Origin::Added(flux) => Vec3::from(flux),
        }
    }

    /// A lamp's radiance × solid angle, RGB, were it not muted.
    pub fn flux(&self, lamp: &Lamp) -> Vec3 {
        self.own_flux(lamp) * self.gain(lamp)
    }

    /// Factor of each channel by which intensity and colour change a lamp.
    pub fn gain(&self, lamp: &Lamp) -> Vec3 {
        let tint = match lamp.colour {
            Colour::Gain(gain) => Vec3::from(gain),
            Colour::Kelvin(kelvin) => {
                let own = self.own_flux(lamp);
                let wanted = black_body(kelvin) * luminance(own);
                let ratio = |c: usize| {
                    if own[c] > 0.0 {
                        wanted[c] / own[c]
                    } else {
                        0.0
                    }
                };
                Vec3::new(ratio(0), ratio(1), ratio(2))
            }
        };
        tint * lamp.stops.exp2()
    }

    /// A lamp's angular radius, radians.
    pub fn angular_radius(&self, lamp: &Lamp) -> f32 {
        let own = match lamp.origin {
            Origin::Estimated(index) => self.lamps.get(index).map_or(0.0, |l| l.angular_radius),
            Origin::Added(_) => 0.0,
        };
        lamp.angular_radius
            .unwrap_or(own)
            .clamp(ANGULAR_RADIUS[0], ANGULAR_RADIUS[1])
    }

    /// Direction of a lamp before it was moved; `None` if it was added.
    pub fn own_direction(&self, lamp: &Lamp) -> Option<Vec3> {
        match lamp.origin {
            Origin::Estimated(index) => self.lamps.get(index).map(|l| l.direction),
            Origin::Added(_) => None,
        }
    }

    /// A lamp as the renderers take it.
    pub fn nodes(&self, lamp: &Lamp, muted: bool) -> LampNodes {
        let gain = self.gain(lamp);
        let estimated = match (lamp.origin, lamp.angular_radius) {
            (Origin::Estimated(index), None) => self.lighting.lamps.get(index),
            _ => None,
        };
        let Some(estimated) = estimated else {
            return LampNodes {
                muted,
                ..LampNodes::disc(
                    lamp.direction,
                    self.flux(lamp),
                    self.angular_radius(lamp),
                    self.lighting.radius,
                )
            };
        };
        let mut nodes = estimated.clone();
        if gain != Vec3::ONE {
            for node in &mut nodes.nodes {
                node.radiance *= gain;
            }
        }
        if lamp.direction != nodes.direction {
            nodes.turn_towards(lamp.direction);
        }
        nodes.muted = muted;
        nodes
    }

    /// The lamp of an index as it was estimated.
    pub fn estimated(&self, id: LampId, index: usize) -> Lamp {
        let base = &self.lamps[index];
        Lamp {
            id,
            name: base.name.clone(),
            origin: Origin::Estimated(index),
            direction: base.direction,
            stops: 0.0,
            colour: Colour::Gain([1.0; 3]),
            angular_radius: None,
            muted: false,
            group: None,
        }
    }

    /// A new lamp: a white disc of 5° radius, as bright as the brightest of the estimate.
    pub fn added(&self, id: LampId, name: String, direction: Vec3) -> Lamp {
        let strongest = self.lamps.iter().map(|l| luminance(l.flux));
        // Without any lamp the light of the ambient part, as if it came from one direction.
        let ambient = luminance(self.lighting.ambient) * std::f32::consts::PI;
        let flux = strongest.fold(ambient, f32::max);
        Lamp {
            id,
            name,
            origin: Origin::Added([if flux > 0.0 { flux } else { 1.0 }; 3]),
            direction: direction.normalize_or(self.lighting.up),
            stops: 0.0,
            colour: Colour::Gain([1.0; 3]),
            angular_radius: Some(5.0 * DEGREE),
            muted: false,
            group: None,
        }
    }

    /// A copy of a lamp as a lamp of its own. One with an estimated shape becomes a disc of the same extent.
    pub fn duplicate(&self, lamp: &Lamp, id: LampId, name: String) -> Lamp {
        Lamp {
            id,
            name,
            origin: Origin::Added(self.own_flux(lamp).to_array()),
            angular_radius: Some(self.angular_radius(lamp)),
            ..lamp.clone()
        }
    }

    /// The factors that give a lamp the hue of a linear colour and leave its luminance as it is.
    pub fn gain_of_colour(&self, lamp: &Lamp, wanted: Vec3) -> Colour {
        let own = self.own_flux(lamp);
        let scale = luminance(own) / luminance(wanted).max(f32::MIN_POSITIVE);
        let ratio = |c: usize| {
            if own[c] > 0.0 {
                (wanted[c] * scale / own[c]).clamp(0.0, 1e6)
            } else {
                0.0
            }
        };
        Colour::Gain([ratio(0), ratio(1), ratio(2)])
    }
}

impl Lamp {
    /// Holds every number within its bounds; `None` where one isn't finite or the direction is none.
    pub fn checked(mut self) -> Option<Self> {
        let direction = self.direction.try_normalize()?;
        // Directions that are unit already stay as they are, bit for bit.
        if (self.direction.length_squared() - 1.0).abs() > 1e-6 {
            self.direction = direction;
        }
        let sound = |values: &[f32]| values.iter().all(|v| v.is_finite() && *v >= 0.0);
        let colour_is_sound = match &self.colour {
            Colour::Gain(gain) => sound(gain),
            Colour::Kelvin(kelvin) => sound(&[*kelvin]),
        };
        let origin_is_sound = match &self.origin {
            Origin::Estimated(_) => true,
            Origin::Added(flux) => sound(flux),
        };
        if let Colour::Kelvin(kelvin) = &mut self.colour {
            *kelvin = kelvin.clamp(KELVIN[0], KELVIN[1]);
        }
        let radius_is_sound = self.angular_radius.is_none_or(|r| r.is_finite() && r > 0.0);
        if let Some(radius) = &mut self.angular_radius {
            *radius = radius.clamp(ANGULAR_RADIUS[0], ANGULAR_RADIUS[1]);
        }
        let all = colour_is_sound && origin_is_sound && radius_is_sound && self.stops.is_finite();
        self.stops = self.stops.clamp(-MAX_STOPS, MAX_STOPS);
        all.then_some(self)
    }
}

/// Linear Rec. 709 colour of a black body, of luminance 1; channels outside the gamut are zero. White (1, 1, 1) is D65,
/// so some 6500 K. The locus is the cubic approximation by Kim, Hong and Shin (US patent 7024034, 2006), good from 1667 K
/// to 25,000 K; temperatures are held within.
pub fn black_body(kelvin: f32) -> Vec3 {
    let t = kelvin.clamp(KELVIN[0], KELVIN[1]);
    let u = 1e3 / t;
    let x = if t <= 4000.0 {
        ((-0.266_123_9 * u - 0.234_358_9) * u + 0.877_695_6) * u + 0.179_910
    } else {
        ((-3.025_846_9 * u + 2.107_037_9) * u + 0.222_634_7) * u + 0.240_390
    };
    let y = if t <= 2222.0 {
        ((-1.106_381_4 * x - 1.348_110_2) * x + 2.185_558_32) * x - 0.202_196_83
    } else if t <= 4000.0 {
        ((-0.954_947_6 * x - 1.374_185_93) * x + 2.091_370_15) * x - 0.167_488_67
    } else {
        ((3.081_758 * x - 5.873_386_7) * x + 3.751_129_97) * x - 0.370_014_83
    };
    // XYZ at Y = 1 to linear Rec. 709.
    let xyz = Vec3::new(x / y, 1.0, (1.0 - x - y) / y);
    let rgb = Vec3::new(
        xyz.dot(Vec3::new(3.240_625, -1.537_208, -0.498_629)),
        xyz.dot(Vec3::new(-0.968_931, 1.875_756, 0.041_518)),
        xyz.dot(Vec3::new(0.055_710, -0.204_021, 1.056_996)),
    )
    .max(Vec3::ZERO);
    rgb / luminance(rgb)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_bodies_have_their_colours() {
        // Planck's chromaticities (CIE 015): 2856 K is illuminant A at (0.4476, 0.4074); 6504 K is near D65.
        let near_white = black_body(6504.0);
        assert!(
            (near_white - Vec3::ONE).abs().max_element() < 0.08,
            "{near_white}"
        );
        let a = black_body(2856.0);
        // Illuminant A through the same primaries: X = 1.0987, Z = 0.3559 at Y = 1.
        let expected = Vec3::new(
            3.240_625 * 1.0987 - 1.537_208 - 0.498_629 * 0.3559,
            -0.968_931 * 1.0987 + 1.875_756 + 0.041_518 * 0.3559,
            0.055_710 * 1.0987 - 0.204_021 + 1.056_996 * 0.3559,
        );
        assert!(
            (a - expected).abs().max_element() < 0.01,
            "{a}, expected {expected}"
        );
        let mut last = f32::INFINITY;
        for kelvin in (1700..25_000).step_by(100) {
            let rgb = black_body(kelvin as f32);
            assert!((luminance(rgb) - 1.0).abs() < 1e-4);
            assert!(rgb.x / rgb.y < last + 1e-3, "redder at {kelvin} K");
            last = rgb.x / rgb.y;
        }
    }
}
