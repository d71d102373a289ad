//! What the Blender script reads: the whole scene as one JSON file.
//!
//! The script is the same for every export. Near lamps become point lights with a radius, distant ones suns.

use glam::DVec3;
use serde_json::{Value, json};

use super::asset::Asset;
use super::light_list;
use rekindle_capture::transforms;
use rekindle_scene::reflectance::SpecularModel;

/// The script, to be run in Blender or with its `bpy` package.
pub const SCRIPT: &str = include_str!("../../../../assets/blender_scene.py");

/// Files that the scene names.
pub struct Files<'a> {
    /// The mesh, OBJ.
    pub mesh: &'a str,
    /// Linear base colour, EXR.
    pub base_colour: &'a str,
    /// Roughness in red and specular level in green, linear EXR, where parts differ.
    pub gloss: Option<&'a str>,
    /// What is reflected of each channel beside that of which most is, linear EXR, where parts differ in that.
    pub specular_colour: Option<&'a str>,
    /// The whole light, lat-long in Blender's orientation.
    pub light: &'a str,
    /// The same without lamps.
    pub rest: &'a str,
}

/// The scene.
pub fn scene(asset: &Asset, files: &Files) -> Value {
    let material = &asset.material;
    let lamps: Vec<Value> = light_list::listed(asset)
        .into_iter()
        .map(|lamp| {
            let (colour, strength) = lamp.colour_and_strength();
            json!({
                "name": lamp.name,
                "direction": lamp.direction.to_array(),
                "position": lamp.position.map(|p| p.to_array()),
                "distance": lamp.distance,
                "colour": colour,
                "irradiance": strength,
                "angular_radius_deg": lamp.angular_radius.to_degrees(),
            })
        })
        .collect();
    json!({
        "format": "rekindle-scene",
        "version": 1,
        "name": asset.name,
        "mesh": files.mesh,
        "base_colour": files.base_colour,
        "light": files.light,
        "light_without_lamps": files.rest,
        "material": {
            "specular": material.model,
            "sigma": material.sigma,
            "f0": material.f0,
            "roughness": material.roughness(),
            "ior": material.refractive_index(),
            "gloss": files.gloss.map(|file| {
                let strongest = asset.strongest();
                json!({
                    "file": file,
                    "colour": files.specular_colour,
                    "f0": strongest.f0,
                    "ior": strongest.refractive_index(),
                })
            }),
        },
        "interreflections": material.model.is_some_and(SpecularModel::is_dielectric),
        "lamps": lamps,
        "cameras": transforms(&asset.cameras, DVec3::ZERO)["frames"],
        "white": asset.white,
    })
}
