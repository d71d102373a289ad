//! Wavefront OBJ with its MTL file, for programs that read nothing newer.

use std::fmt::Write as _;
use std::io;
use std::path::Path;

use super::asset::Asset;
use rekindle_solution::write_obj;

/// Name of the material in the MTL file.
const MATERIAL: &str = "object";

/// Writes the mesh; it names the MTL file beside it.
pub fn write(path: &Path, asset: &Asset, mtl: &str) -> io::Result<()> {
    let head = format!("# written by rekindle\nmtllib {mtl}\nusemtl {MATERIAL}\n");
    write_obj(path, &head, &asset.mesh, &asset.uvs)
}

/// Files with the gloss of each texel.
#[derive(Clone, Copy, Debug)]
pub struct GlossFiles<'a> {
    /// √α, grey, linear.
    pub roughness: &'a str,
    /// Reflectance at normal incidence as a part of the strongest's, grey or RGB, linear.
    pub specular: &'a str,
}

/// The MTL file. `Pr` and `Pm` are the physically based extension; `Ks` and `Ns` say it to older programs.
pub fn material(asset: &Asset, base_colour: &str, gloss: Option<GlossFiles<'_>>) -> String {
    let material = &asset.strongest();
    let mut text =
        format!("# written by rekindle\nnewmtl {MATERIAL}\nKd 1 1 1\nmap_Kd {base_colour}\n");
    // Writing into a string can't fail.
    let _ = if material.model.is_some() {
        // Phong's exponent for slopes of variance σ²: 2/m² − 2 with m = √2 σ.
        let shininess = (1.0 / (material.sigma * material.sigma) - 2.0).clamp(1.0, 1000.0);
        writeln!(
            text,
            "Ks {f0} {f0} {f0}\nNs {shininess}\nPr {}\nPm 0\nNi {}\nillum 2",
            material.roughness(),
            material.refractive_index(),
            f0 = material.f0,
        )
    } else {
        writeln!(text, "Ks 0 0 0\nPr 1\nPm 0\nNi 1\nillum 1")
    };
    if let Some(GlossFiles {
        roughness,
        specular,
    }) = gloss
    {
        let _ = writeln!(text, "map_Pr {roughness}\nmap_Ks {specular}");
    }
    text
}
