//! `rekindle info SOLUTION`: what is in a solution.

use std::fmt::Write as _;
use std::path::Path;

use super::{OutputArgs, print_json, print_line};
use rekindle_solution::Solution;

pub(super) fn run(path: &Path, output: OutputArgs) -> anyhow::Result<()> {
    let solution = Solution::load(path)?;
    if output.json {
        print_json(&solution.summary());
    } else {
        print_line(text(&solution).trim_end());
    }
    Ok(())
}

/// What the solution holds, as aligned lines.
fn text(solution: &Solution) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let mut line = |label: &str, text: String| {
        let _ = writeln!(out, "{label:<10}{text}");
    };
    let method = format!("{:?}", solution.method).to_lowercase();
    line("solution", format!("{}, method {method}", solution.name));
    if let Some(brdf) = solution.brdf {
        let interval = solution
            .sigma_interval95
            .map(|[low, high]| format!(", 95 % between {low:.5} and {high:.5}"))
            .unwrap_or_default();
        line("roughness", format!("σ {:.5}{interval}", brdf.sigma));
        line("surface", solution.surface_in_words());
        let model = format!("{:?}", brdf.model).to_lowercase();
        line("specular", format!("{model}: {}", solution.chosen_because));
    } else {
        let lights = if solution.lamps.is_empty() {
            "unknown"
        } else {
            "what the shading tells"
        };
        line(
            "roughness",
            format!("unknown, as no specular part was found; lights are {lights}"),
        );
    }
    for lamp in &solution.lamps {
        let (d, f) = (lamp.direction, lamp.flux);
        let radius = lamp.angular_radius.to_degrees();
        line(
            "light",
            format!(
                "{}: direction [{:.5}, {:.5}, {:.5}], flux [{:.4}, {:.4}, {:.4}], angular radius {radius:.2}°, {} nodes",
                lamp.name,
                d.x,
                d.y,
                d.z,
                f.x,
                f.y,
                f.z,
                lamp.nodes.len()
            ),
        );
    }
    let a = solution.ambient;
    line("ambient", format!("[{:.5}, {:.5}, {:.5}]", a.x, a.y, a.z));
    line(
        "mesh",
        format!("{} triangles", solution.mesh.triangles.len()),
    );
    let (atlas, seen) = (&solution.atlas, 100.0 * solution.seen());
    let size = format!("{}×{} texels", atlas.width, atlas.height);
    line(
        "textures",
        format!("{size}, {seen:.1} % of the surface seen"),
    );
    let views = solution.fit.psnr_db_per_view.iter();
    let views: Vec<String> = views.map(|db| format!("{db:.1}")).collect();
    line("views", format!("reproduced at {} dB", views.join(", ")));
    for warning in &solution.diagnostics.warnings {
        line("warning", warning.clone());
    }
    out
}
