//! A Mitsuba 3 scene: the object, its material, the light as it is and a sensor for every camera.
//!
//! Mitsuba has the Beckmann and the GGX lobe itself, so nothing is fitted. The paper's model, with constant Fresnel factor and masking,
//! is a mixture by F₀ of a diffuse surface and a perfect mirror of that roughness; the microfacet model is Mitsuba's rough
//! plastic. That lets light through the surface twice, which a GGX surface here does once: on the way out.

use std::fmt::Write as _;

use glam::{DMat4, DVec3, Vec3};

use super::asset::{Asset, angular_radius};
use super::gauge::Material;
use rekindle_base::text::xml_attribute;
use rekindle_capture::Camera;
use rekindle_scene::reflectance::SpecularModel;

/// Files that the scene names.
pub struct Files<'a> {
    /// The mesh, OBJ.
    pub mesh: &'a str,
    /// Linear base colour, EXR.
    pub base_colour: &'a str,
    /// White where each part of another gloss is, all but the first; none where all is alike.
    pub masks: &'a [String],
    /// The light that is not of near lamps, lat-long in Mitsuba's orientation.
    pub light: &'a str,
}

/// The scene as XML. A path of one bounce shows what the paper's model is, further ones the surface's own reflections.
pub fn scene(asset: &Asset, files: &Files) -> String {
    let mut text = String::from("<scene version=\"3.0.0\">\n");
    let bounces = if asset
        .material
        .model
        .is_some_and(SpecularModel::is_dielectric)
    {
        8
    } else {
        2
    };
    let _ = write!(
        text,
        "    <default name=\"spp\" value=\"256\"/>\n\
         \x20   <integrator type=\"path\">\n\
         \x20       <integer name=\"max_depth\" value=\"{bounces}\"/>\n\
         \x20       <boolean name=\"hide_emitters\" value=\"true\"/>\n\
         \x20   </integrator>\n"
    );
    for (name, camera) in &asset.cameras {
        sensor(&mut text, name, camera);
    }
    let _ = write!(
        text,
        "    <shape type=\"obj\">\n        <string name=\"filename\" value=\"{}\"/>\n",
        xml_attribute(files.mesh)
    );
    // Mitsuba's rough plastic has one roughness: one surface for each part, blended by masks.
    for mask in files.masks.iter().rev() {
        let _ = writeln!(
            text,
            "        <bsdf type=\"blendbsdf\">{}",
            bitmap("weight", mask)
        );
    }
    for (k, part) in asset.parts.iter().enumerate() {
        material(&mut text, &part.material, files.base_colour);
        if k > 0 {
            text.push_str("        </bsdf>\n");
        }
    }
    text.push_str("    </shape>\n");
    let _ = write!(
        text,
        "    <emitter type=\"envmap\">\n        <string name=\"filename\" value=\"{}\"/>\n    </emitter>\n",
        xml_attribute(files.light)
    );
    near_lamps(&mut text, asset);
    text.push_str("</scene>\n");
    text
}

/// A linear texture.
fn bitmap(name: &str, file: &str) -> String {
    format!(
        "<texture type=\"bitmap\" name=\"{name}\"><string name=\"filename\" value=\"{}\"/><boolean name=\"raw\" value=\"true\"/></texture>",
        xml_attribute(file)
    )
}

fn material(text: &mut String, material: &Material, base_colour: &str) {
    let texture = |name: &str| bitmap(name, base_colour);
    let distribution = match material.model {
        Some(SpecularModel::Ggx | SpecularModel::Metal) => "ggx",
        _ => "beckmann",
    };
    let lobe = format!(
        "<string name=\"distribution\" value=\"{distribution}\"/><float name=\"alpha\" value=\"{}\"/>",
        material.alpha()
    );
    let colour = if material.colour == Vec3::ONE {
        String::new()
    } else {
        let Vec3 { x, y, z } = material.colour;
        format!("<rgb name=\"specular_reflectance\" value=\"{x} {y} {z}\"/>")
    };
    let _ = match material.model {
        None => writeln!(
            text,
            "        <bsdf type=\"diffuse\">{}</bsdf>",
            texture("reflectance")
        ),
        Some(SpecularModel::Paper | SpecularModel::Metal) => write!(
            text,
            "        <bsdf type=\"blendbsdf\">\n            <float name=\"weight\" value=\"{}\"/>\n\
             \x20           <bsdf type=\"diffuse\">{}</bsdf>\n\
             \x20           <bsdf type=\"roughconductor\"><string name=\"material\" value=\"none\"/>{lobe}</bsdf>\n\
             \x20       </bsdf>\n",
            material.f0,
            texture("reflectance")
        ),
        Some(SpecularModel::Beckmann | SpecularModel::Ggx) => writeln!(
            text,
            "        <bsdf type=\"roughplastic\"><float name=\"int_ior\" value=\"{}\"/><float name=\"ext_ior\" value=\"1\"/>{lobe}{colour}{}</bsdf>",
            material.refractive_index(),
            texture("diffuse_reflectance")
        ),
    };
}

/// By how much the base colour is to be multiplied for a program whose rough plastic lets light through the surface twice
/// and normalises by the part of uniform light that passes.
pub fn diffuse_factor(material: &Material) -> f32 {
    match material.model {
        // Ours is 1 for normal incidence and exitance, and the base colour is raised for one passage.
        Some(SpecularModel::Beckmann) => {
            (1.0 - material.mean_reflectance()) * material.behind_surface()
        }
        _ => 1.0,
    }
}

fn sensor(text: &mut String, name: &str, camera: &Camera) {
    // Mitsuba's camera looks along +Z with +X to the left.
    let pose =
        DMat4::from(camera.world_from_camera) * DMat4::from_scale(DVec3::new(-1.0, 1.0, -1.0));
    let rows: Vec<String> = (0..4)
        .flat_map(|r| pose.row(r).to_array())
        .map(|v| v.to_string())
        .collect();
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let fov = (2.0 * (0.5 * width / camera.focal.x).atan()).to_degrees();
    let _ = write!(
        text,
        "    <sensor type=\"perspective\" id=\"{}\">\n\
         \x20       <string name=\"fov_axis\" value=\"x\"/><float name=\"fov\" value=\"{fov}\"/>\n\
         \x20       <float name=\"principal_point_offset_x\" value=\"{}\"/><float name=\"principal_point_offset_y\" value=\"{}\"/>\n\
         \x20       <transform name=\"to_world\"><matrix value=\"{}\"/></transform>\n\
         \x20       <sampler type=\"multijitter\"><integer name=\"sample_count\" value=\"$spp\"/></sampler>\n\
         \x20       <film type=\"hdrfilm\"><integer name=\"width\" value=\"{}\"/><integer name=\"height\" value=\"{}\"/>\
         <string name=\"pixel_format\" value=\"rgba\"/><rfilter type=\"box\"/></film>\n\
         \x20   </sensor>\n",
        xml_attribute(&name.replace('.', "_")),
        0.5 - camera.centre.x / width,
        0.5 - camera.centre.y / height,
        rows.join(" "),
        camera.width,
        camera.height
    );
}

/// Lamps at a finite distance as spheres of even radiance.
fn near_lamps(text: &mut String, asset: &Asset) {
    for lamp in &asset.lighting.lamps {
        let Some(distance) = lamp.radius else {
            continue;
        };
        let sine = angular_radius(lamp).sin().max(1e-4);
        // Seen from the centre a sphere has the solid angle π sin² of its half angle, for the cosine of what it lights.
        let radiance: Vec3 = lamp.flux() / (std::f32::consts::PI * sine * sine);
        let at = asset.lighting.centre + distance * lamp.direction;
        let _ = write!(
            text,
            "    <shape type=\"sphere\">\n\
             \x20       <point name=\"center\" x=\"{}\" y=\"{}\" z=\"{}\"/><float name=\"radius\" value=\"{}\"/>\n\
             \x20       <emitter type=\"area\"><rgb name=\"radiance\" value=\"{} {} {}\"/></emitter>\n\
             \x20   </shape>\n",
            at.x,
            at.y,
            at.z,
            distance * sine,
            radiance.x,
            radiance.y,
            radiance.z
        );
    }
}
