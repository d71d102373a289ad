//! New light on the object: lighting and its edits, shading, the textures that relighting needs, and the reference
//! renderer.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use rekindle_relight::{Lighting, apply, load};
//! # fn lighting() -> Lighting { unimplemented!() }
//!
//! let edits = load("edits.json".as_ref())?;
//! let lighting = apply(&edits, &lighting())?;
//! println!("{} lamps", lighting.lamps.len());
//! # Ok(())
//! # }
//! ```

mod albedo;
mod ambient;
mod best_views;
mod diffuse;
mod edits;
mod environment;
mod fill;
mod footprints;
mod interreflection;
mod irradiance;
mod lamp_groups;
mod lighting;
pub mod lobes;
mod measure;
mod patches;
mod reflection;
mod render;
mod samples;
mod shading;
mod sky;
mod triangle_shares;
mod trust;
mod view_transform;

pub use albedo::{Albedo, Ambient, filled_albedo, light_texture, separate};
pub use diffuse::{DiffuseTexture, LightOfViews, ViewFit, ViewLight, reconstruct, srgb};
pub use edits::{Edit, EditError, apply, load};
pub use environment::{Environment, LatLong};
pub use interreflection::{Field, Interreflection, Relit};
pub use irradiance::texel_irradiance;
pub use lighting::{LampNodes, LightNode, Lighting, ProbeUnits};
pub use measure::{brighter_than, psnr, psnr_below, white};
pub use reflection::Surroundings;
pub use render::{Band, Diffuse, GlossMap, Picture, Scene, Stop, render, render_bands};
pub use samples::{Sample, Samples};
pub use shading::{Shade, Shader, ShadingPoint, Visibility, ambient_gain};
pub use sky::{Sky, SkyLevel};
pub use triangle_shares::TriangleShares;
pub use view_transform::{ViewTransform, luminance, turbo};
