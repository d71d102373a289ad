//! What an export can't carry over, in words for the one who opens it.

use std::fmt::Write as _;

use glam::{DVec3, Quat};

use super::asset::Asset;
use super::fidelity::Fidelity;
use super::job::PAGE;
use rekindle_scene::reflectance::SpecularModel;

/// Whole sentences about what other programs show differently.
pub fn notes(asset: &Asset, fidelity: Option<Fidelity>) -> Vec<String> {
    let material = &asset.material;
    let mut notes = Vec::new();
    if material.model.is_some() {
        notes.push(format!(
            "The photographs leave the scale between light and colours open; it is fixed by a reflectance of {:.3} at normal \
             incidence (index of refraction {:.3}).",
            material.f0,
            material.refractive_index()
        ));
    } else {
        notes.push(
            "No specular part was found: the object is purely diffuse, and the light is what its shading tells."
                .to_owned(),
        );
    }
    if let Some(Fidelity {
        beckmann_db,
        ggx_db,
    }) = fidelity
    {
        let own = match material.model {
            Some(SpecularModel::Ggx | SpecularModel::Metal) => "whose lobe it is",
            _ => "whose highlights have longer tails",
        };
        notes.push(format!(
            "By the material alone, programs with a Beckmann lobe (Mitsuba, Blender's Glossy BSDF) come to {beckmann_db:.1} dB \
             of rekindle's picture, those with GGX (glTF, USD, Blender's Principled BSDF), {own}, \
             to {ggx_db:.1} dB, in the worst view."
        ));
    }
    if material.model == Some(SpecularModel::Metal) {
        notes.push(
            "The surface reflects as a metal does, whose colour can't be told from the light's. These files hold a dielectric of \
             the same roughness under light of that colour; for a metal, whiten the light and set the material to metallic."
                .to_owned(),
        );
    }
    if material.f0 >= 0.9 {
        notes.push(
            "With so high a --white-albedo the surface would have to be a mirror; the colours come out darker.".to_owned(),
        );
    }
    let (part, largest) = asset.too_bright();
    if part > 0.0 {
        notes.push(format!(
            "{:.1} % of the texture would have to reflect more light than arrives, up to {largest:.2} times, and is cut at 1; \
             --f0 {:.3} or less leaves all of it below.",
            100.0 * part,
            material.f0 / largest
        ));
    }
    if material.model.is_some_and(|model| !model.is_dielectric()) {
        notes.push(
            "The colours hold what the surface sends to itself: render without light bounces (the scripts do), or creases come \
             out too bright."
                .to_owned(),
        );
    }
    if asset.lighting.ambient.max_element() > 0.0 {
        notes.push(
            "Ambient light reaches everything alike here; other programs shadow it and let the surface reflect it.".to_owned(),
        );
    }
    if asset.lighting.radius.is_some() {
        notes.push(
            "The lamps are near: they become lamps at their places. Light maps show them as seen from the object's centre."
                .to_owned(),
        );
    }
    if asset.turn != Quat::IDENTITY {
        notes.push(
            "The object is turned, so that +Y is up, with its lamps and cameras; pictures with layers keep the capture's world."
                .to_owned(),
        );
    }
    if asset.origin != DVec3::ZERO {
        let o = asset.origin;
        notes.push(format!(
            "The object lies far from the origin of the capture's world, which other programs' single precision would blur; \
             it is moved near it, with its lamps and cameras, by [{}, {}, {}].",
            -o.x, -o.y, -o.z
        ));
    }
    let distorted = |(_, camera): &(_, rekindle_capture::Camera)| !camera.distortion.is_none();
    if asset.cameras.iter().any(distorted) {
        notes.push(
            "Only cameras.json has the lenses' distortion; other files have cameras without it."
                .to_owned(),
        );
    }
    notes
}

/// What lies in the folder and how to open it.
pub fn readme(asset: &Asset, files: &[String], notes: &[String]) -> String {
    let mut text = format!("{}, exported by rekindle\n\n", asset.name);
    if files.iter().any(|f| f.starts_with("layers_")) {
        text.push_str(
            "layers_*.exr       pictures with layers; the light_ layers add up to the picture\n",
        );
    }
    for (name, what) in [
        (
            "blender_scene.py",
            "open in Blender's Scripting workspace and run: object, lamps, cameras",
        ),
        ("mitsuba.xml", "mitsuba mitsuba.xml: object, light, cameras"),
        (
            "object.glb",
            "glTF, lamps included; lights are in units of the colours (in Blender: Lighting Mode \"Unitless\")",
        ),
        (
            "object.usda",
            "USD: object, dome light, cameras; the lamps are there, hidden",
        ),
        (
            "object.obj",
            "Wavefront OBJ with object.mtl and base_color.png",
        ),
        (
            PAGE,
            "web page: open it in a browser, turn the object, move its lights",
        ),
        ("light.exr", "the light, lat-long, linear 32-bit float"),
        ("light.hdr", "the same as Radiance HDR"),
        ("lights.json", "the lamps as a list"),
        ("lights.csv", "the lamps as a table"),
        ("cameras.json", "the cameras, in the nerfstudio convention"),
        (
            "calibration.exr",
            "a light map with marked axes: red +X, green +Y, blue +Z",
        ),
    ] {
        if files.iter().any(|f| f == name) {
            // Writing into a string can't fail.
            let _ = writeln!(text, "{name:18} {what}");
        }
    }
    text.push_str("\nThe world is right-handed with +Y up.\n");
    for note in notes {
        let _ = writeln!(text, "{note}");
    }
    text
}
