//! `truth.json` and `edit.json`: what an estimate should find.

use glam::Vec3;
use serde_json::{Value, json};

use super::environment::MAPPING;
use super::lamps::TrueLamp;
use super::recipe::{Files, Material, Mistake, Recipe};
use rekindle_scene::reflectance::SpecularModel;

/// All that is known of a made capture.
pub(super) fn describe(name: &str, recipe: &Recipe, lamps: &[TrueLamp], centre: Vec3) -> Value {
    let sensor = recipe.sensor;
    let errors = recipe.errors;
    json!({
        "name": name,
        "renderer": "rekindle synth: the program's own forward model, so a good result is necessary, not sufficient",
        "object": { "name": recipe.object.name(), "triangles": recipe.triangles },
        "material": material(&recipe.material),
        "texture": { "style": "patches", "contrast": recipe.texture_contrast },
        "lights": lamps.iter().map(|lamp| light(lamp, centre)).collect::<Vec<_>>(),
        "environment": { "file": "environment.exr", "mapping": MAPPING },
        "interreflections": recipe.interreflection,
        "shadows": true,
        "turntable": recipe.views.turntable.then_some("the light stands still with the camera; lights are as at the first view"),
        "noise": (sensor.noise > 0.0).then(|| json!({
            "deviation_at_mean": sensor.noise,
            "model": "var = deviation_at_mean^2 * I * mean I of the object, inputs only; truth images are clean",
        })),
        "outliers": sensor.outliers,
        "saturated_highlights": sensor.saturated,
        "gain_error": sensor.gain_error,
        "files": match sensor.files {
            Files::Exr => json!("exr"),
            Files::Exposures(stops) => json!({ "exposures_within_stops": stops }),
            Files::Brackets { count, stops } => {
                json!({ "brackets": count, "stops": stops, "response": format!("{:?}", sensor.response) })
            }
        },
        "geometry_errors": {
            "camera_rotation_deg": errors.rotation.to_degrees(),
            "vertex_noise": errors.vertex_noise,
            "triangles": errors.triangles,
            "normal_noise_deg": errors.normal_noise.to_degrees(),
        },
        "mistake": recipe.mistake.map(Mistake::name),
        "split": "diffuse + specular = noise-free image",
        "alpha": "object coverage of the pixel; RGB is the mean over the pixel with background 0 (premultiplied)",
        "moved": lamps.first().filter(|_| recipe.truth_pictures).map(edit),
        "seed": recipe.seed,
    })
}

fn material(material: &Material) -> Value {
    let mut value = json!({
        "sigma": material.sigma,
        "K_S": material.strength,
        "K_D": "albedo/pi, towards normal incidence",
    });
    let more = match material.model {
        SpecularModel::Paper => json!({
            "model": "paperts",
            "equation": "L_o = K_D int L_i cos_i dw + K_S/cos_r int L_i exp(-alpha^2/(2 sigma^2)) dw over cos_i>0, unshadowed",
        }),
        SpecularModel::Metal => json!({
            "model": "microfacet: GGX, Smith masking, constant Fresnel factor",
            "microfacet_alpha": material.sigma * std::f32::consts::SQRT_2,
        }),
        SpecularModel::Beckmann | SpecularModel::Ggx => json!({
            "model": format!("microfacet: {}, Smith masking, dielectric Fresnel factor of index 1.5", material.model.name()),
            "microfacet_alpha": material.sigma * std::f32::consts::SQRT_2,
            "int_ior": material.refractive_index,
        }),
    };
    if let (Value::Object(value), Value::Object(more)) = (&mut value, more) {
        value.extend(more);
    }
    value
}

fn light(lamp: &TrueLamp, centre: Vec3) -> Value {
    json!({
        "direction": lamp.direction.to_array(),
        "radiance": lamp.radiance.to_array(),
        "angular_radius_deg": lamp.angular_radius.to_degrees(),
        "solid_angle": lamp.solid_angle(),
        "normal_irradiance": lamp.normal_irradiance().to_array(),
        "position": lamp.distance.map(|d| (centre + lamp.direction * d).to_array()),
    })
}

/// How the first lamp moves.
pub(super) fn edit(lamp: &TrueLamp) -> Value {
    let to = lamp.moved().direction;
    json!({
        "light": 0,
        "from": lamp.direction.to_array(),
        "to": to.to_array(),
        "angle_deg": lamp.direction.angle_between(to).to_degrees(),
    })
}
