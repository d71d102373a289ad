//! `rekindle info SOLUTION`: what is in a solution.

use std::path::Path;

use super::{OutputArgs, print_json, print_line};
use crate::solution::Solution;

pub(super) fn run(path: &Path, output: OutputArgs) -> anyhow::Result<()> {
    let solution = Solution::load(path)?;
    if output.json {
        print_json(&solution.summary());
        return Ok(());
    }
    print_line(&format!(
        "solution of {}, method {}",
        solution.name,
        format!("{:?}", solution.method).to_lowercase()
    ));
    match (solution.brdf, solution.sigma_interval95) {
        (Some(brdf), Some([low, high])) => print_line(&format!(
            "roughness σ {:.5} (95 % between {low:.5} and {high:.5}), {:?} model: {}",
            brdf.sigma, brdf.model, solution.chosen_because
        )),
        (Some(brdf), None) => print_line(&format!(
            "roughness σ {:.5}, {:?} model: {}",
            brdf.sigma, brdf.model, solution.chosen_because
        )),
        (None, _) => print_line("no specular part was found: roughness and lights are unknown"),
    }
    print_line(&format!("{} lights", solution.lamps.len()));
    for lamp in &solution.lamps {
        let (d, f) = (lamp.direction, lamp.flux);
        print_line(&format!(
            "  {}: direction [{:.5}, {:.5}, {:.5}], flux [{:.4}, {:.4}, {:.4}], angular radius {:.2}°, {} nodes",
            lamp.name,
            d.x,
            d.y,
            d.z,
            f.x,
            f.y,
            f.z,
            lamp.angular_radius.to_degrees(),
            lamp.nodes.len()
        ));
    }
    let ambient = solution.ambient;
    print_line(&format!(
        "ambient radiance [{:.5}, {:.5}, {:.5}]",
        ambient.x, ambient.y, ambient.z
    ));
    print_line(&format!(
        "{} triangles, textures of {}×{} texels, {:.1} % of them seen",
        solution.mesh.triangles.len(),
        solution.atlas.width,
        solution.atlas.height,
        100.0 * solution.seen()
    ));
    let views: Vec<String> = solution
        .fit
        .psnr_db_per_view
        .iter()
        .map(|db| format!("{db:.1}"))
        .collect();
    print_line(&format!(
        "input views reproduced at {} dB",
        views.join(", ")
    ));
    for warning in &solution.diagnostics.warnings {
        print_line(&format!("warning: {warning}"));
    }
    Ok(())
}
