//! The relightable object as one web page: no server, no network, opened from a file.
//!
//! The page holds the object with its textures, the captured light and other setups, and a renderer of its own for WebGL 2 in
//! which everything stays live: lights are dragged, dimmed, coloured and muted. Its parts:
//!
//! * `page/` is the page without data: HTML, style, the scripts, and the shaders, twins of those in `shaders/`;
//! * `geometry` is the surface in 16-bit numbers, `textures` are JPEG and PNG pictures;
//! * `light` is each lamp as few lobes, which is what the page's shaders add up;
//! * `transfer` is what the surface sends to itself, as a function of where light comes from.
//!
//! Radiance in the page is in units of the solution's white, positions are relative to the object's centre.

mod geometry;
mod light;
mod page;
#[cfg(test)]
mod tests;
mod textures;
mod transfer;

use std::io;

use glam::{DVec3, Vec3};
use serde_json::json;
use thiserror::Error;

use rekindle_relight::{Lighting, Stop};
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::surface::Occluder;
use rekindle_solution::Solution;

use geometry::Geometry;
use page::Page;
use transfer::Transfer;

/// The most triangles of a page: what a browser draws many times a second, and some 25 MB of file.
pub const MOST_TRIANGLES: usize = 1_000_000;

/// A light setup that the page can show.
#[derive(Clone, Debug)]
pub struct Setup {
    /// What people call it.
    pub name: String,
    /// Whether it is the captured light, under which the stored diffuse texture is shown.
    pub captured: bool,
    /// Its light, in the solution's world and K_S-scaled.
    pub lighting: Lighting,
    /// Name of each of its lamps; without, they are numbered.
    pub names: Vec<String>,
}

impl Setup {
    /// The light that a solution found.
    pub fn captured(solution: &Solution) -> Self {
        Self {
            name: "Captured light".to_owned(),
            captured: true,
            lighting: solution.lighting(),
            names: Vec::new(),
        }
    }
}

/// Why there is no page.
#[derive(Debug, Error)]
pub enum WebError {
    /// It was asked for.
    #[error("the export was stopped")]
    Stopped,
    /// The mesh has no triangles.
    #[error("the solution's mesh has no triangles; a web page needs a surface to show")]
    Empty,
    /// The mesh is too large for a browser.
    #[error(
        "the solution's mesh has {triangles} triangles, more than the {MOST_TRIANGLES} that a web page can show; decimate \
         the capture's mesh and solve it again"
    )]
    TooLarge {
        /// Of the mesh.
        triangles: usize,
    },
    /// A setup has too many lamps.
    #[error(
        "the setup \"{setup}\" has {lamps} lights, more than the {} that a web page can show; delete the weakest",
        light::MOST_LAMPS
    )]
    TooManyLamps {
        /// Its name.
        setup: String,
        /// How many.
        lamps: usize,
    },
    /// A picture can't be encoded.
    #[error("the textures can't be encoded: {0}")]
    Encoding(#[from] io::Error),
}

/// The whole page as HTML. `towards` is the direction from the object's centre to where it is first seen from; `progress` hears
/// which part is done.
pub fn page(
    solution: &Solution,
    setups: &[Setup],
    towards: Option<DVec3>,
    stop: Stop,
    progress: &mut dyn FnMut(f32),
) -> Result<String, WebError> {
    let mesh = &solution.mesh;
    match mesh.triangles.len() {
        0 => return Err(WebError::Empty),
        triangles if triangles > MOST_TRIANGLES => return Err(WebError::TooLarge { triangles }),
        _ => {}
    }
    for setup in setups {
        let lamps = setup.lighting.lamps.len();
        if lamps > light::MOST_LAMPS {
            let setup = setup.name.clone();
            return Err(WebError::TooManyLamps { setup, lamps });
        }
    }
    let occluder = Occluder::new(mesh);
    let mut transferred = |part: f32| progress(0.6 * part);
    let transfer = Transfer::new(solution, &occluder, stop, &mut transferred);
    if stop() {
        return Err(WebError::Stopped);
    }
    let textures = textures::Textures::new(solution)?;
    progress(0.8);
    if stop() {
        return Err(WebError::Stopped);
    }
    let white = solution.white();
    let lighting = solution.lighting();
    let centre = mesh.centre();
    let geometry = Geometry::new(mesh, &textures.corner_uvs, centre);
    let setups: Vec<_> = setups
        .iter()
        .map(|setup| light::setup(setup, solution, &occluder, white))
        .collect();
    let mut page = Page::default();
    let scene = json!({
        "name": solution.name,
        "origin": (mesh.origin + centre.as_dvec3()).to_array(),
        "radius": 0.5 * mesh.diagonal().max(f32::MIN_POSITIVE),
        "up": lighting.up.to_array(),
        "towards": towards.unwrap_or_else(|| lighting.up.as_dvec3() + DVec3::splat(0.3)).to_array(),
        "brdf": brdf(solution.brdf),
        "geometry": geometry.put(&mut page),
        "transfer": transfer.map(|transfer| transfer.put(&mut page)),
        "textures": textures.put(white, &mut page),
        "setups": setups,
    });
    progress(0.9);
    Ok(page.html(&solution.name, &scene))
}

/// The specular model by its number in the shaders, its roughness and its strength.
fn brdf(brdf: Option<Brdf>) -> serde_json::Value {
    json!({
        "model": SpecularModel::shader_number(brdf.map(|brdf| brdf.model)),
        "sigma": brdf.map_or(1.0, |brdf| brdf.sigma),
        "strength": brdf.map_or(1.0, |brdf| brdf.strength),
    })
}

/// A vector as a list of numbers.
fn list(v: Vec3) -> [f32; 3] {
    v.to_array()
}
