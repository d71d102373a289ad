//! The object and its light as other programs get them: +Y up, lights and colours each on their own scale.

use std::f32::consts::PI;

use glam::{DMat3, DVec3, Quat, Vec2, Vec3};

use super::gauge::Material;
use crate::web::Setup;
use rekindle_capture::{Camera, Mesh};
use rekindle_relight::{LampNodes, LightNode, Lighting};
use rekindle_scene::reflectance::Gloss;
use rekindle_scene::surface::GlossTexture;
use rekindle_solution::Solution;

/// What fixes the scale that the photographs leave open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Anchor {
    /// Reflectance at normal incidence, more than 0 and less than 1.
    F0(f32),
    /// Diffuse albedo of the brightest parts, more than 0 and at most 1.
    WhiteAlbedo(f32),
}

/// What is to be exported.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The object.
    pub solution: &'a Solution,
    /// Its light, in the solution's world and K_S-scaled.
    pub lighting: &'a Lighting,
    /// Name of each of its lamps; without, they are numbered.
    pub names: &'a [String],
    /// Views to look from, with their names.
    pub cameras: &'a [(String, Camera)],
    /// Light setups of the web page, the captured light among them; without, it has that alone.
    pub setups: &'a [Setup],
    /// What fixes the scale.
    pub anchor: Anchor,
}

/// A part of the surface with a material of its own.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// How it differs from the main part.
    pub gloss: Gloss,
    /// The same in other programs' terms.
    pub material: Material,
    /// Share of the surface.
    pub share: f32,
}

/// The object and its light.
#[derive(Clone, Debug)]
pub struct Asset {
    /// The capture's name.
    pub name: String,
    /// The surface.
    pub mesh: Mesh,
    /// Texture coordinates of each triangle's corners, in [0, 1], v upwards.
    pub uvs: Vec<[Vec2; 3]>,
    /// Width of the texture in texels.
    pub texture_width: u32,
    /// Diffuse albedo of each texel, linear RGB, raised by [`Material::behind_surface`]. It may exceed 1.
    pub base_colour: Vec<[f32; 3]>,
    /// How the surface reflects, or its main part.
    pub material: Material,
    /// How other parts differ from that, texel by texel.
    pub gloss: Option<GlossTexture>,
    /// The parts whose gloss differs, the largest first; one where all is alike.
    pub parts: Vec<Part>,
    /// The light, without muted lamps: radiance is real, not K_S-scaled.
    pub lighting: Lighting,
    /// Name of every lamp.
    pub lamp_names: Vec<String>,
    /// Place of every lamp, counted from 1, among those of the source, muted ones too.
    pub lamp_numbers: Vec<usize>,
    /// Views to look from, with their names.
    pub cameras: Vec<(String, Camera)>,
    /// Radiance to be shown as white.
    pub white: f32,
    /// The turn from the solution's world into this one, whose up is +Y.
    pub turn: Quat,
    /// Place in the solution's world of what is this one's origin.
    pub origin: DVec3,
}

impl Asset {
    /// What other programs get of a source.
    pub fn new(source: &Source) -> Self {
        let Source {
            solution,
            lighting,
            cameras,
            anchor,
            ..
        } = *source;
        let turn = upright(lighting.up);
        let material = material(solution, anchor);
        let (lamp_numbers, lamps): (Vec<usize>, Vec<LampNodes>) = (1..)
            .zip(&lighting.lamps)
            .filter(|(_, lamp)| !lamp.muted)
            .map(|(number, lamp)| (number, turned_lamp(lamp, turn, &material)))
            .unzip();
        let name = |&number: &usize| {
            let given = source.names.get(number - 1);
            given.map_or_else(|| format!("Light {number}"), String::clone)
        };
        Self {
            name: solution.name.clone(),
            mesh: turned_mesh(&solution.mesh, turn),
            uvs: solution.stored_uvs(),
            texture_width: solution.atlas.width,
            base_colour: base_colour(solution, &material),
            material,
            parts: match &solution.gloss {
                Some(gloss) => (gloss.parts(&solution.mesh, &solution.atlas).into_iter())
                    .map(|(gloss, share)| Part {
                        gloss,
                        material: material.at(gloss),
                        share,
                    })
                    .collect(),
                None => vec![Part {
                    gloss: Gloss::MAIN,
                    material,
                    share: 1.0,
                }],
            },
            gloss: solution.gloss.clone(),
            lighting: Lighting {
                lamps,
                remainder: turned_nodes(&lighting.remainder, turn, &material),
                environment: (lighting.environment.as_ref())
                    .map(|e| e.turned(turn, Vec3::ONE / material.specular_scale)),
                ambient: lighting.ambient / material.specular_scale,
                centre: turn * lighting.centre,
                radius: lighting.radius,
                up: turn * lighting.up,
                specular_scale: Vec3::ONE,
            },
            lamp_names: lamp_numbers.iter().map(name).collect(),
            lamp_numbers,
            cameras: cameras
                .iter()
                .map(|(name, camera)| (name.clone(), turned_camera(camera, turn)))
                .collect(),
            white: solution.white(),
            turn,
            origin: solution.mesh.origin,
        }
    }

    /// The material of a texel.
    pub fn material_at(&self, texel: usize) -> Material {
        match &self.gloss {
            Some(gloss) => self.material.at(gloss.texels()[texel]),
            None => self.material,
        }
    }

    /// Whether parts reflect in different colours.
    pub fn is_coloured(&self) -> bool {
        self.gloss.as_ref().is_some_and(GlossTexture::is_coloured)
    }

    /// Which of [`Asset::parts`] each texel is of, or nearest to.
    pub fn nearest_parts(&self) -> Vec<usize> {
        let Some(gloss) = &self.gloss else {
            return vec![0; self.base_colour.len()];
        };
        let parts: Vec<Gloss> = self.parts.iter().map(|part| part.gloss).collect();
        let texels = gloss.texels().iter();
        texels.map(|own| own.nearest(&parts)).collect()
    }

    /// The material of the part that reflects most at normal incidence.
    pub fn strongest(&self) -> Material {
        let parts = self.parts.iter().map(|part| part.material);
        parts
            .max_by(|a, b| a.f0.total_cmp(&b.f0))
            .unwrap_or(self.material)
    }

    /// Part of the texels with a colour above 1, which no surface has, and the largest value.
    pub fn too_bright(&self) -> (f32, f32) {
        let used = self.base_colour.iter().filter(|c| **c != [0.0; 3]);
        let (mut above, mut count, mut largest) = (0_usize, 0_usize, 0.0_f32);
        for colour in used {
            let value = colour.iter().copied().fold(0.0, f32::max);
            count += 1;
            above += usize::from(value > 1.0);
            largest = largest.max(value);
        }
        (above as f32 / count.max(1) as f32, largest)
    }
}

/// The diffuse albedo behind a surface of this material.
fn base_colour(solution: &Solution, material: &Material) -> Vec<[f32; 3]> {
    let texels = solution.albedo.iter().enumerate();
    let raised = texels.map(|(k, albedo)| {
        let own = match &solution.gloss {
            Some(gloss) => material.at(gloss.texels()[k]),
            None => *material,
        };
        let factor = PI * material.specular_scale * own.behind_surface();
        albedo.map(|v| v * factor)
    });
    raised.collect()
}

fn material(solution: &Solution, anchor: Anchor) -> Material {
    let f0 = match (anchor, solution.brdf) {
        (Anchor::F0(f0), _) => f0,
        (Anchor::WhiteAlbedo(albedo), Some(brdf)) => {
            // π K_S A = albedo of the brightest texels, and K_S = F₀/(8πσ²).
            let specular_scale = albedo / (PI * solution.brightest(&solution.albedo));
            (8.0 * PI * brdf.sigma * brdf.sigma * specular_scale).clamp(1e-6, 0.9)
        }
        (Anchor::WhiteAlbedo(_), None) => 0.0,
    };
    Material::new(solution.brdf, f0)
}

/// The turn by right angles that takes the axis nearest to `up` to +Y: an object that stands upright in its own world does so
/// in programs whose up is +Y, and one in a world with +Y up stays as it is.
fn upright(up: Vec3) -> Quat {
    let size = up.abs();
    let axis = if size.y >= size.x.max(size.z) {
        Vec3::Y * up.y.signum()
    } else if size.z >= size.x {
        Vec3::Z * up.z.signum()
    } else {
        Vec3::X * up.x.signum()
    };
    Quat::from_rotation_arc(axis, Vec3::Y)
}

fn turned_mesh(mesh: &Mesh, turn: Quat) -> Mesh {
    Mesh {
        origin: DVec3::ZERO,
        positions: mesh.positions.iter().map(|&p| turn * p).collect(),
        normals: mesh.normals.iter().map(|&n| turn * n).collect(),
        ..mesh.clone()
    }
}

fn turned_nodes(nodes: &[LightNode], turn: Quat, material: &Material) -> Vec<LightNode> {
    let turned = nodes.iter().map(|node| LightNode {
        direction: turn * node.direction,
        radiance: node.radiance / material.specular_scale,
        solid_angle: node.solid_angle,
    });
    turned.collect()
}

fn turned_lamp(lamp: &LampNodes, turn: Quat, material: &Material) -> LampNodes {
    LampNodes {
        direction: turn * lamp.direction,
        nodes: turned_nodes(&lamp.nodes, turn, material),
        ..lamp.clone()
    }
}

fn turned_camera(camera: &Camera, turn: Quat) -> Camera {
    let turn = DMat3::from_quat(turn.as_dquat());
    let mut camera = camera.clone();
    let pose = &mut camera.world_from_camera;
    pose.matrix3 = turn * pose.matrix3;
    pose.translation = turn * pose.translation;
    camera
}

/// Half the angle under which a lamp shines, radians: √2 × the flux-weighted rms angle of its nodes from its direction, which
/// for a uniform disc is its radius.
pub(super) fn angular_radius(lamp: &LampNodes) -> f32 {
    let (mut squares, mut weights) = (0.0_f64, 0.0_f64);
    for node in &lamp.nodes {
        let weight = f64::from(node.flux().element_sum());
        squares += weight * f64::from(node.direction.angle_between(lamp.direction)).powi(2);
        weights += weight;
    }
    (2.0 * squares / weights.max(f64::MIN_POSITIVE)).sqrt() as f32
}
