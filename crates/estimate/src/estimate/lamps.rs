//! Lamps narrower than the lobe are given their plainest shape.
//!
//! Non-negative least squares puts the light of such a lamp on a few spikes, whose sum, centroid and second moments
//! are right and whose pattern is noise: the lobe blurs it beyond recognition. Shadows do show it. So the spikes of
//! each compact lamp are replaced by a uniform ellipse with the same flux, centroid and second moments.

use super::ellipse::Ellipse;
use rekindle_scene::hemisphere::{HemisphereGrid, Lamp, find_lamps, rest};

/// A lamp whose radius exceeds this many σ in the half vector keeps the shape that the rows gave it.
const WIDEST: f32 = 2.0;

/// More than this share of a lamp's flux is no speck of its own but other light.
const LARGEST_SPECK: f32 = 0.03;

/// Replaces the nodes of compact lamps by uniform ellipses; `sigma` is the lobe's width in radians.
pub fn fill_compact_lamps(
    grid: &HemisphereGrid,
    sigma: f32,
    radiance: &[[f32; 3]],
) -> Vec<[f32; 3]> {
    let mut filled = radiance.to_vec();
    let lamps = find_lamps(grid, radiance);
    let specks = specks(grid, sigma, radiance, &lamps);
    for (lamp, specks) in lamps.into_iter().zip(specks) {
        // The half vector turns by half the light's angle.
        if 0.5 * lamp.angular_radius >= WIDEST * sigma {
            continue;
        }
        let whole = Lamp::new(grid, radiance, [&lamp.nodes[..], &specks].concat());
        let whole = whole.filter(|w| w.mean_flux() < (1.0 + LARGEST_SPECK) * lamp.mean_flux());
        fill(grid, radiance, &whole.unwrap_or(lamp), &mut filled);
    }
    filled
}

/// Lit nodes of no lamp that the lobe can't tell from the nearest lamp, for each lamp: what non-negative least squares
/// puts there evens out the moments of the lamp's spikes.
fn specks(
    grid: &HemisphereGrid,
    sigma: f32,
    radiance: &[[f32; 3]],
    lamps: &[Lamp],
) -> Vec<Vec<u32>> {
    let mut specks = vec![Vec::new(); lamps.len()];
    for node in rest(grid, radiance, lamps).map_or(Vec::new(), |r| r.nodes) {
        let direction = grid.directions[node as usize];
        let nearest = (0..lamps.len())
            .map(|l| (lamps[l].direction.angle_between(direction), l))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        // One standard deviation of the lobe in the half vector is two in the light's direction.
        if let Some((_, lamp)) = nearest.filter(|(angle, _)| *angle < 2.0 * sigma) {
            specks[lamp].push(node);
        }
    }
    specks
}

fn fill(grid: &HemisphereGrid, radiance: &[[f32; 3]], lamp: &Lamp, filled: &mut [[f32; 3]]) {
    for &node in &lamp.nodes {
        filled[node as usize] = [0.0; 3];
    }
    Ellipse::of(grid, radiance, lamp).add_to(filled, grid);
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    #[test]
    fn a_speck_within_the_lobe_belongs_to_its_lamp_and_one_beyond_it_does_not() {
        let grid = HemisphereGrid::new(70, Vec3::Y, None, Vec3::ZERO);
        let centre = Vec3::new(0.3, 0.8, 0.4).normalize_or_zero();
        let side = centre.any_orthonormal_vector();
        let at = |degrees: f32| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            grid.nearest(cos * centre + sin * side)
                .expect("above the horizon")
        };
        let mut radiance = vec![[0.0; 3]; grid.directions.len()];
        for degrees in [-2.0, 0.0, 2.0] {
            radiance[at(degrees)] = [100.0; 3];
        }
        radiance[at(9.0)] = [0.5; 3];
        radiance[at(30.0)] = [0.4; 3];
        let filled = fill_compact_lamps(&grid, 0.1, &radiance);
        assert_eq!(filled[at(9.0)], [0.0; 3], "absorbed");
        assert_eq!(filled[at(30.0)], [0.4; 3], "left alone");
        let flux = find_lamps(&grid, &filled)[0].flux[0] / grid.solid_angle;
        assert!((flux - 300.5).abs() < 0.01, "flux {flux}");
    }

    #[test]
    fn spikes_become_a_disc_of_the_same_flux_direction_and_extent() {
        let grid = HemisphereGrid::new(70, Vec3::Y, None, Vec3::ZERO);
        let mut radiance = vec![[0.0; 3]; grid.directions.len()];
        let centre = Vec3::new(0.3, 0.8, 0.4).normalize_or_zero();
        let (x, y) = centre.any_orthonormal_pair();
        // Six spikes 2.1° from the centre: the second moments of a disc of 3°.
        for k in 0..6 {
            let a = k as f32 * std::f32::consts::TAU / 6.0;
            let d =
                (centre + 2.12_f32.to_radians() * (a.cos() * x + a.sin() * y)).normalize_or_zero();
            let node = grid.nearest(d).expect("above the horizon");
            radiance[node] = [100.0, 50.0, 25.0];
        }
        let before = find_lamps(&grid, &radiance);
        let filled = fill_compact_lamps(&grid, 0.075, &radiance);
        let after = find_lamps(&grid, &filled);
        assert_eq!((before.len(), after.len()), (1, 1));
        for c in 0..3 {
            assert!(
                (after[0].flux[c] / before[0].flux[c] - 1.0).abs() < 1e-4,
                "flux"
            );
        }
        assert!(after[0].direction.angle_between(before[0].direction) < 0.05_f32.to_radians());
        assert!((after[0].angular_radius / before[0].angular_radius - 1.0).abs() < 0.1);
        let lit: Vec<f32> = filled.iter().map(|l| l[0]).filter(|&l| l > 0.0).collect();
        assert!(lit.len() > 25, "{} nodes", lit.len());
    }
}
