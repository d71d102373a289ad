//! What the estimate withstands: one thing at a time is made worse, from sound to hopeless.

use std::f32::consts::{FRAC_PI_2, TAU};

use glam::Vec3;

use super::case::{Case, Group};
use crate::synth::{Files, Lamps, Light, Material, Mistake, Normals, Object, Places, Recipe};
use rekindle_scene::hemisphere::HemisphereGrid;
use rekindle_scene::reflectance::SpecularModel;

/// Frequency of the grid among whose nodes lamps are placed: the default of `rekindle solve`.
const FREQUENCY: u32 = 70;
/// Where a lamp on a node is about: azimuth from the front and elevation, radians.
const ABOUT: [f32; 2] = [-0.5, 0.8];

/// Distance of near lights, mesh units.
const NEAR: f32 = 4.0;

/// The recipe from which all others depart by one thing.
pub(super) fn base(size: [u32; 2]) -> Recipe {
    let mut recipe = Recipe {
        truth_pictures: false,
        ..Recipe::default()
    };
    recipe.views.size = size;
    recipe.views.supersampling = 1;
    recipe
}

fn lamps(recipe: &mut Recipe, change: impl FnOnce(&mut Lamps)) {
    if let Light::Lamps(lamps) = &mut recipe.light {
        change(lamps);
    }
}

/// All groups of the section, with photographs of a size.
pub(super) fn groups(size: [u32; 2]) -> Vec<Group> {
    let base = base(size);
    [
        surface(&base),
        light(&base),
        photographs(&base),
        geometry(&base),
        mistakes(&base),
    ]
    .concat()
}

/// Each form of the lobe fitted by each other.
fn wrong_lobes(base: &Recipe) -> Group {
    let sigma = 0.1;
    let dielectric = |model| Material::dielectric(model, sigma, 1.5);
    let lobes = [
        ("paper", Material::paper(sigma, 0.4)),
        ("beckmann", dielectric(SpecularModel::Beckmann)),
        ("ggx", dielectric(SpecularModel::Ggx)),
        ("metal", Material::metal(sigma, 0.4)),
    ];
    let case = |(name, material): (&str, Material), fitted: &str| {
        let mut recipe = base.clone();
        recipe.material = material;
        Case {
            label: format!("{name} by {fitted}"),
            value: None,
            recipe,
            options: vec!["--specular".to_owned(), fitted.to_owned()],
        }
    };
    let pairs = (lobes.iter()).flat_map(|lobe| lobes.iter().map(move |fitted| (*lobe, fitted.0)));
    Group {
        name: "wrong_lobe",
        swept: "the surface's lobe by the one that is fitted",
        cases: pairs
            .filter(|(lobe, fitted)| lobe.0 != *fitted)
            .map(|(lobe, fitted)| case(lobe, fitted))
            .collect(),
    }
}

fn surface(base: &Recipe) -> Vec<Group> {
    let roughness = &[0.01, 0.02, 0.04, 0.075, 0.15, 0.25, 0.35, 0.5];
    let objects = [
        Object::Figurine,
        Object::Sphere,
        Object::Torus,
        Object::Bowl,
    ];
    vec![
        Group::sweep(
            "roughness",
            "σ, radians",
            base,
            roughness,
            |recipe, sigma| {
                recipe.material = Material::paper(sigma as f32, 0.4);
            },
        ),
        Group::sweep(
            "microfacet",
            "σ of Beckmann's lobe, radians",
            base,
            &[0.05, 0.1, 0.2, 0.35],
            |recipe, sigma| {
                recipe.material = Material::dielectric(SpecularModel::Beckmann, sigma as f32, 1.5);
            },
        ),
        Group::sweep(
            "ggx",
            "σ of GGX's lobe, radians",
            base,
            &[0.05, 0.1, 0.2],
            |recipe, sigma| {
                recipe.material = Material::dielectric(SpecularModel::Ggx, sigma as f32, 1.5);
            },
        ),
        Group::sweep(
            "metal",
            "σ of a metal's lobe, radians",
            base,
            &[0.05, 0.1, 0.2],
            |recipe, sigma| {
                recipe.material = Material::metal(sigma as f32, 0.4);
            },
        ),
        wrong_lobes(base),
        Group::sweep(
            "strength",
            "K_S",
            base,
            &[0.0, 0.004, 0.04, 0.4, 4.0],
            |recipe, strength| {
                recipe.material.strength = strength as f32;
            },
        ),
        Group::option(
            "stated_radius",
            "distance stated for distant lights, mesh units",
            base,
            &[5, 20, 100],
            "--radius",
        ),
        Group::sweep(
            "texture",
            "contrast of the texture",
            base,
            &[0.0, 0.5, 1.0],
            |recipe, contrast| {
                recipe.texture_contrast = contrast as f32;
            },
        ),
        Group::named(
            "object",
            "object",
            base,
            &objects.map(|o| (o.name(), o)),
            |recipe, object| {
                recipe.object = object;
            },
        ),
    ]
}

fn light(base: &Recipe) -> Vec<Group> {
    let mut pair = base.clone();
    lamps(&mut pair, |lamps| lamps.places = Places::Spread(2));
    let mut row = base.clone();
    lamps(&mut row, |lamps| {
        lamps.angular_radius = 0.5_f32.to_radians();
        lamps.contrast = 1.5;
    });
    let mut one = base.clone();
    lamps(&mut one, |lamps| {
        lamps.angular_radius = 0.1_f32.to_radians();
    });
    let [node, between] = on_and_between_nodes();
    let elsewhere = [1.0, 0.7];
    let places = [
        ("on a node", node),
        ("between nodes", between),
        ("at the rim", [-0.7, 0.01]),
        ("behind", [2.6, 0.4]),
    ];
    vec![
        Group::sweep(
            "lamps",
            "lamps",
            base,
            &[1.0, 3.0, 6.0, 12.0],
            |recipe, count| {
                lamps(recipe, |lamps| lamps.places = Places::Spread(count as u32));
            },
        ),
        Group::sweep(
            "extent",
            "angular radius of two lamps, degrees",
            &pair,
            &[0.05, 0.5, 3.0, 5.0, 8.0, 10.0, 15.0, 30.0],
            |recipe, degrees| {
                lamps(recipe, |lamps| {
                    lamps.angular_radius = degrees.to_radians() as f32;
                });
            },
        ),
        Group::sweep(
            "separation",
            "angle between two lamps, degrees",
            &row,
            &[2.0, 4.0, 6.0, 8.0, 10.0],
            |recipe, degrees| {
                lamps(recipe, |lamps| {
                    lamps.places = Places::Row(2, degrees.to_radians() as f32);
                });
            },
        ),
        Group::named(
            "place",
            "place of the first of two lamps",
            &one,
            &places,
            |recipe, place| {
                lamps(recipe, |lamps| {
                    lamps.places = Places::At(vec![place, elsewhere]);
                });
            },
        ),
        Group::sweep(
            "contrast",
            "strongest over weakest of three lamps",
            base,
            &[3.0, 10.0, 100.0, 1000.0, 10_000.0],
            |recipe, contrast| {
                lamps(recipe, |lamps| lamps.contrast = contrast as f32);
            },
        ),
        Group::sweep(
            "distance",
            "distance of the lamps, radii of the object",
            base,
            &[2.0, 4.0, 10.0],
            |recipe, distance| {
                lamps(recipe, |lamps| lamps.distance = Some(distance as f32));
            },
        ),
    ]
}

fn photographs(base: &Recipe) -> Vec<Group> {
    let clipped = &[0.0, 10.0, 50.0, 100.0];
    let mut brackets = base.clone();
    brackets.sensor.files = Files::Brackets { count: 4, stops: 2 };
    vec![
        Group::sweep(
            "views",
            "views",
            base,
            &[1.0, 2.0, 3.0, 6.0, 12.0, 24.0, 64.0],
            |recipe, count| {
                recipe.views.count = count as u32;
            },
        ),
        Group::sweep(
            "arc",
            "azimuths that six views are spread over, degrees",
            base,
            &[5.0, 20.0, 60.0, 150.0, 300.0],
            |recipe, degrees| {
                recipe.views.arc = degrees.to_radians() as f32;
            },
        ),
        Group::sweep(
            "turntable",
            "views of an object that turns all around",
            base,
            &[6.0, 8.0, 12.0, 24.0],
            |recipe, count| {
                recipe.views.count = count as u32;
                recipe.views.turntable = true;
                recipe.views.arc = TAU * (1.0 - 1.0 / count as f32);
            },
        ),
        Group::sweep(
            "scale",
            "factor of all radiances",
            base,
            &[1e-6, 1.0, 1e6],
            |recipe, factor| {
                recipe.views.scale = factor as f32;
            },
        ),
        Group::sweep(
            "noise",
            "noise, percent of the mean",
            base,
            &[0.0, 0.3, 1.0, 3.0, 10.0],
            |recipe, percent| {
                recipe.sensor.noise = percent as f32 / 100.0;
            },
        ),
        Group::sweep(
            "saturation",
            "clipped pixels of the highlights, percent",
            base,
            clipped,
            |recipe, percent| {
                recipe.sensor.saturated = percent as f32 / 100.0;
            },
        ),
        Group::sweep(
            "brackets",
            "the same in brackets of four",
            &brackets,
            clipped,
            |recipe, percent| {
                recipe.sensor.saturated = percent as f32 / 100.0;
            },
        ),
        Group::sweep(
            "outliers",
            "pixels of something else, percent",
            base,
            &[0.0, 1.0, 5.0, 20.0],
            |recipe, percent| {
                recipe.sensor.outliers = percent as f32 / 100.0;
            },
        ),
        Group::sweep(
            "exposure",
            "unstated differences of exposure, percent",
            base,
            &[0.0, 1.0, 5.0],
            |recipe, percent| {
                recipe.sensor.gain_error = percent as f32 / 100.0;
            },
        ),
    ]
}

fn geometry(base: &Recipe) -> Vec<Group> {
    let mut faces = base.clone();
    faces.errors.normals = Normals::Faces;
    vec![
        Group::sweep(
            "cameras",
            "turn of the cameras, degrees",
            base,
            &[0.0, 0.05, 0.2, 1.0, 2.0],
            |recipe, degrees| {
                recipe.errors.rotation = degrees.to_radians() as f32;
            },
        ),
        Group::sweep(
            "vertices",
            "noise of the vertices, percent of the diagonal",
            base,
            &[0.0, 0.02, 0.05, 0.1],
            |recipe, percent| {
                recipe.errors.vertex_noise = percent as f32 / 100.0;
            },
        ),
        Group::sweep(
            "rough_normals",
            "the same, normals from the triangles",
            &faces,
            &[0.0, 0.02, 0.05],
            |recipe, percent| {
                recipe.errors.vertex_noise = percent as f32 / 100.0;
            },
        ),
        Group::sweep(
            "normals",
            "noise of the normals, degrees",
            base,
            &[0.0, 0.3, 1.0, 4.0],
            |recipe, degrees| {
                recipe.errors.normal_noise = degrees.to_radians() as f32;
            },
        ),
        Group::sweep(
            "decimation",
            "triangles of the stated mesh",
            base,
            &[1000.0, 3000.0, 10_000.0, 30_000.0],
            |recipe, count| {
                recipe.errors.triangles = Some(count as u32);
            },
        ),
        Group::sweep(
            "face_normals",
            "the same, normals from the triangles",
            &faces,
            &[3000.0, 10_000.0, 30_000.0],
            |recipe, count| {
                recipe.errors.triangles = Some(count as u32);
            },
        ),
    ]
}

/// What people get wrong and nothing in the capture states.
fn mistakes(base: &Recipe) -> Vec<Group> {
    let mut near = base.clone();
    lamps(&mut near, |lamps| lamps.distance = Some(NEAR));
    let mut even = base.clone();
    lamps(&mut even, |lamps| {
        lamps.places = Places::At(vec![[0.0, FRAC_PI_2]]);
        lamps.contrast = 1.0;
    });
    let stated = |factor: f64| factor * f64::from(NEAR);
    let mut distances = Group::sweep(
        "near_radius",
        "distance stated for near lights, times the true one",
        &near,
        &[0.8, 1.2, 2.0],
        |_, _| {},
    );
    for case in &mut distances.cases {
        let factor = case.value.unwrap_or(1.0);
        case.options = vec!["--radius".to_owned(), stated(factor).to_string()];
    }
    vec![
        Group::named(
            "mistakes",
            "what is wrong",
            base,
            &Mistake::ALL.map(|mistake| (mistake.name(), mistake)),
            |recipe, mistake| recipe.mistake = Some(mistake),
        ),
        distances,
        Group::sweep(
            "even_light",
            "angular radius of one light about the zenith, degrees",
            &even,
            &[45.0, 90.0],
            |recipe, degrees| {
                lamps(recipe, |lamps| {
                    lamps.angular_radius = degrees.to_radians() as f32;
                });
            },
        ),
    ]
}

/// A direction exactly on a node of the default grid, and the middle between that node and one beside it.
fn on_and_between_nodes() -> [[f32; 2]; 2] {
    let grid = HemisphereGrid::new(FREQUENCY, Vec3::Y, None, Vec3::ZERO);
    let (sin, cos) = ABOUT[0].sin_cos();
    let about = Vec3::new(ABOUT[1].cos() * sin, ABOUT[1].sin(), ABOUT[1].cos() * cos);
    let node = grid.nearest(about).unwrap_or(0);
    let beside = grid.neighbours(node).next().unwrap_or(node);
    let at = grid.directions[node];
    [at, (at + grid.directions[beside]).normalize_or(at)].map(azimuth_and_elevation)
}

fn azimuth_and_elevation(direction: Vec3) -> [f32; 2] {
    let elevation = FRAC_PI_2 - direction.angle_between(Vec3::Y);
    [direction.x.atan2(direction.z), elevation]
}
