//! The lamps as lists: JSON for programs, CSV for tables.

use std::fmt::Write as _;

use glam::Vec3;
use serde_json::{Value, json};

use super::asset::{Asset, angular_radius};
use rekindle_base::text::csv_cell;
use rekindle_relight::{LampNodes, LightNode};

/// A lamp in the few numbers that other programs' lamps have.
#[derive(Clone, Debug, PartialEq)]
pub struct ListedLamp {
    /// What people call it.
    pub name: String,
    /// Unit direction from the object's centre to the lamp.
    pub direction: Vec3,
    /// Radiance × solid angle, RGB: the irradiance of a surface at the centre that faces the lamp.
    pub irradiance: Vec3,
    /// Half the angle under which it shines, radians.
    pub angular_radius: f32,
    /// Its place, for a near lamp.
    pub position: Option<Vec3>,
    /// How far from the object's centre that is.
    pub distance: Option<f32>,
}

/// The lamps, in their order.
pub fn listed(asset: &Asset) -> Vec<ListedLamp> {
    let lamps = asset.lighting.lamps.iter().zip(&asset.lamp_names);
    lamps
        .map(|(lamp, name)| ListedLamp {
            name: name.clone(),
            direction: lamp.direction,
            irradiance: facing_irradiance(lamp),
            angular_radius: angular_radius(lamp),
            position: lamp
                .radius
                .map(|r| asset.lighting.centre + r * lamp.direction),
            distance: lamp.radius,
        })
        .collect()
}

/// Σ L ω cos θ over the nodes, θ from the lamp's direction.
fn facing_irradiance(lamp: &LampNodes) -> Vec3 {
    let of = |n: &LightNode| n.flux() * n.direction.dot(lamp.direction).max(0.0);
    lamp.nodes.iter().map(of).sum()
}

impl ListedLamp {
    /// Its irradiance as a colour whose largest channel is 1, and the factor.
    pub fn colour_and_strength(&self) -> ([f32; 3], f32) {
        let strength = self.irradiance.max_element().max(f32::MIN_POSITIVE);
        ((self.irradiance / strength).to_array(), strength)
    }
}

/// The list with what it means.
pub fn json(asset: &Asset) -> Value {
    let lamps: Vec<Value> = listed(asset)
        .into_iter()
        .map(|lamp| {
            json!({
                "name": lamp.name,
                "direction": lamp.direction.to_array(),
                "irradiance": lamp.irradiance.to_array(),
                "angular_radius_deg": lamp.angular_radius.to_degrees(),
                "position": lamp.position.map(|p| p.to_array()),
            })
        })
        .collect();
    json!({
        "format": "rekindle-lights",
        "version": 1,
        "units": "direction: unit, from the object's centre to the lamp, +Y up; irradiance: of a surface at the centre that faces the lamp",
        "centre": asset.lighting.centre.to_array(),
        "radius": asset.lighting.radius,
        "lights": lamps,
        "ambient_radiance": asset.lighting.ambient.to_array(),
        "k_s_scaled_by": asset.material.specular_scale,
    })
}

/// The list as a table with a line of names.
pub fn csv(asset: &Asset) -> String {
    let mut text = String::from(
        "name,direction_x,direction_y,direction_z,irradiance_r,irradiance_g,irradiance_b,angular_radius_deg\n",
    );
    for lamp in listed(asset) {
        let (d, e) = (lamp.direction, lamp.irradiance);
        // Writing into a string can't fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{}",
            csv_cell(&lamp.name),
            d.x,
            d.y,
            d.z,
            e.x,
            e.y,
            e.z,
            lamp.angular_radius.to_degrees()
        );
    }
    text
}
