//! Lamps narrower than the lobe are given their plainest shape.
//!
//! Non-negative least squares puts the light of such a lamp on a few spikes, whose sum, centroid and second moments
//! are right and whose pattern is noise: the lobe blurs it beyond recognition. Shadows do show it. So the spikes of
//! each compact lamp are replaced by a uniform ellipse with the same flux, centroid and second moments.

use glam::{Vec2, Vec3};

use crate::hemisphere::{HemisphereGrid, Lamp, find_lamps, rest};

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
    let frame = Frame::new(lamp.direction);
    let ellipse = Ellipse::of(grid, radiance, lamp, &frame);
    let margin = 0.5 * grid.spacing();
    let reach = (ellipse.long + 2.0 * margin).min(1.5).cos();
    let cover: Vec<(usize, f32)> = (0..grid.directions.len())
        .filter(|&i| grid.directions[i].dot(lamp.direction) > reach)
        .map(|i| {
            (
                i,
                ellipse.coverage(frame.project(grid.directions[i]), margin),
            )
        })
        .filter(|(_, c)| *c > 0.0)
        .collect();
    let total: f32 = cover.iter().map(|(_, c)| c * grid.solid_angle).sum();
    if total <= 0.0 {
        return;
    }
    for &node in &lamp.nodes {
        filled[node as usize] = [0.0; 3];
    }
    for (node, c) in cover {
        for (value, flux) in filled[node].iter_mut().zip(lamp.flux) {
            *value += flux * c / total;
        }
    }
}

/// Tangent plane around a direction.
struct Frame {
    pole: Vec3,
    x: Vec3,
    y: Vec3,
}

impl Frame {
    fn new(pole: Vec3) -> Self {
        let (x, y) = pole.any_orthonormal_pair();
        Self { pole, x, y }
    }

    /// Angles from the pole along the two axes, radians.
    fn project(&self, d: Vec3) -> Vec2 {
        let plane = Vec2::new(d.dot(self.x), d.dot(self.y));
        plane.normalize_or_zero() * plane.length().atan2(d.dot(self.pole))
    }
}

/// A uniform ellipse about the pole of a [`Frame`]: semi-axes in radians and the unit direction of the long one.
struct Ellipse {
    long: f32,
    short: f32,
    axis: Vec2,
}

impl Ellipse {
    /// The ellipse with a lamp's second moments, never smaller than a node.
    fn of(grid: &HemisphereGrid, radiance: &[[f32; 3]], lamp: &Lamp, frame: &Frame) -> Self {
        let (mut xx, mut xy, mut yy, mut total) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        for &node in &lamp.nodes {
            let w = f64::from(radiance[node as usize].iter().sum::<f32>());
            let p = frame.project(grid.directions[node as usize]).as_dvec2();
            xx += w * p.x * p.x;
            xy += w * p.x * p.y;
            yy += w * p.y * p.y;
            total += w;
        }
        let total = total.max(f64::MIN_POSITIVE);
        let (xx, xy, yy) = (xx / total, xy / total, yy / total);
        let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let root = half.hypot(xy);
        let angle = 0.5 * xy.atan2(half) as f32;
        // A uniform ellipse of semi-axis a has the variance a²/4 along it.
        let semi_axis =
            |variance: f64| (2.0 * variance.max(0.0).sqrt() as f32).max(0.5 * grid.spacing());
        Self {
            long: semi_axis(mean + root),
            short: semi_axis(mean - root),
            axis: Vec2::from_angle(angle),
        }
    }

    /// Share of a node of half width `margin` at `p` that lies inside, nearly.
    fn coverage(&self, p: Vec2, margin: f32) -> f32 {
        let turned = Vec2::new(p.dot(self.axis), p.perp_dot(self.axis));
        let scaled = turned / Vec2::new(self.long, self.short);
        let distance = scaled.length();
        let inside = if distance < 1e-6 {
            self.short
        } else {
            turned.length() * (1.0 / distance - 1.0)
        };
        (0.5 * inside / margin + 0.5).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
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
