//! Lamps with known truth. They are uniform discs of light where they stand, not nodes of any grid.

use std::f32::consts::{PI, TAU};

use glam::{Quat, Vec3};

use super::recipe::{Lamps, Places};
use rekindle_base::math::random::Random;
use rekindle_relight::LampNodes;

/// Irradiance at normal incidence of all lamps together: a white surface then has a radiance of about 1.
const IRRADIANCE: f32 = 4.0;
/// Where lamps are spread: azimuths to either side of the front, and elevations; radians.
const SIDEWAYS: f32 = 1.2;
const ELEVATIONS: [f32; 2] = [0.45, 1.2];
/// The middle of a row.
const ROW: [f32; 2] = [-0.5, 0.8];
/// Lamps are off these places by up to this angle, radians, so that none is on a node.
const JITTER: f32 = 0.04;
/// Nodes of a lamp: as many as bring them as near to each other as a lobe is wide, at least as many as make a smooth
/// penumbra, and no more than can be added up.
const NODES: [usize; 2] = [128, 16_384];
/// How far the moved lamp goes, radians.
const MOVE: f32 = 40.0 * PI / 180.0;

/// A lamp as it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrueLamp {
    /// Unit direction from the object's centre.
    pub direction: Vec3,
    /// Radiance, RGB.
    pub radiance: Vec3,
    /// Angular radius seen from the centre, radians.
    pub angular_radius: f32,
    /// Distance from the centre, `None` for a distant lamp.
    pub distance: Option<f32>,
}

impl TrueLamp {
    /// Solid angle seen from the centre, sr.
    pub(super) fn solid_angle(&self) -> f32 {
        // 2π (1 − cos r), which small angles would lose to rounding.
        2.0 * TAU * (0.5 * self.angular_radius).sin().powi(2)
    }

    /// Irradiance at the centre of a surface that faces it, RGB.
    pub(super) fn normal_irradiance(&self) -> Vec3 {
        self.radiance * (PI * self.angular_radius.sin().powi(2))
    }

    /// The lamp as nodes for a lobe of roughness σ, its radiance times `strength`.
    pub(super) fn nodes(&self, sigma: f32, strength: f32) -> LampNodes {
        let area = PI * (self.angular_radius / sigma).powi(2);
        let count = (area.ceil() as usize).clamp(NODES[0], NODES[1]);
        let flux = self.radiance * (strength * self.solid_angle());
        LampNodes::disc_of(
            count,
            self.direction,
            flux,
            self.angular_radius,
            self.distance,
        )
    }

    /// The lamp turned sideways to the other half, as far up as it was or lower.
    #[must_use]
    pub(super) fn moved(&self) -> Self {
        let across = Vec3::Y.cross(self.direction).normalize_or(Vec3::X);
        let side = if across.x * self.direction.x > 0.0 {
            -across
        } else {
            across
        };
        Self {
            direction: (self.direction * MOVE.cos() + side * MOVE.sin()).normalize_or(Vec3::Y),
            ..*self
        }
    }
}

/// The lamps of a recipe, the strongest first.
pub(super) fn place(lamps: &Lamps, scale: f32, random: Random) -> Vec<TrueLamp> {
    let directions = directions(&lamps.places, random);
    let last = directions.len().saturating_sub(1).max(1) as f32;
    let strengths: Vec<f32> = (0..directions.len())
        .map(|i| lamps.contrast.powf(-(i as f32) / last))
        .collect();
    let total: f32 = strengths.iter().sum();
    let facing = PI * lamps.angular_radius.sin().powi(2);
    directions
        .into_iter()
        .zip(&strengths)
        .enumerate()
        .map(|(i, (direction, strength))| TrueLamp {
            direction,
            radiance: colour(i, lamps.tint) * (scale * IRRADIANCE * strength / total / facing),
            angular_radius: lamps.angular_radius,
            distance: lamps.distance,
        })
        .collect()
}

fn directions(places: &Places, random: Random) -> Vec<Vec3> {
    let jitter =
        |i: u32, k: u64| JITTER * (2.0 * random.uniform(2 * u64::from(i) + k) as f32 - 1.0);
    match places {
        Places::At(places) => places.iter().map(|&place| towards(place)).collect(),
        Places::Spread(count) => (0..*count)
            .map(|i| {
                // Two irrational steps fill the rectangle evenly, however many there are (Roberts's R2 sequence).
                let part = |step: f32, from: f32| (from + i as f32 * step).fract();
                let azimuth = SIDEWAYS * (2.0 * part(0.754_877_7, 0.2) - 1.0);
                let elevation =
                    ELEVATIONS[0] + (ELEVATIONS[1] - ELEVATIONS[0]) * part(0.569_840_3, 0.5);
                towards([azimuth + jitter(i, 0), elevation + jitter(i, 1)])
            })
            .collect(),
        Places::Row(count, apart) => {
            let middle = towards([ROW[0] + jitter(0, 0), ROW[1] + jitter(0, 1)]);
            let axis = Vec3::X.cross(middle).normalize_or(Vec3::Y);
            (0..*count)
                .map(|i| {
                    let turn = apart * (i as f32 - 0.5 * (*count as f32 - 1.0));
                    (Quat::from_axis_angle(axis, turn) * middle).normalize_or(middle)
                })
                .collect()
        }
    }
}

/// Unit direction of an azimuth from +Z towards +X and an elevation, radians.
pub(super) fn towards([azimuth, elevation]: [f32; 2]) -> Vec3 {
    let ((sin, cos), (up, along)) = (azimuth.sin_cos(), elevation.sin_cos());
    Vec3::new(along * sin, up, along * cos)
}

/// A lamp's colour, of mean 1: neighbours in the list differ most.
fn colour(index: usize, tint: f32) -> Vec3 {
    let hue = TAU * (index as f32 * 0.381_966).fract();
    let wave = |shift: f32| 1.0 + tint * (hue - shift * TAU / 3.0).cos();
    Vec3::new(wave(0.0), wave(1.0), wave(2.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lamps(places: Places) -> Lamps {
        Lamps {
            places,
            angular_radius: 0.05,
            contrast: 100.0,
            tint: 0.5,
            distance: None,
        }
    }

    #[test]
    fn a_row_of_lamps_is_as_far_apart_as_stated() {
        let apart = 2.0_f32.to_radians();
        let row = place(&lamps(Places::Row(4, apart)), 1.0, Random::new(1, 1));
        for pair in row.windows(2) {
            let found = pair[0].direction.angle_between(pair[1].direction);
            assert!((found - apart).abs() < 1e-3, "{found}");
        }
    }

    #[test]
    fn contrast_tint_and_sum_are_as_stated() {
        let all = place(&lamps(Places::Spread(12)), 3.0, Random::new(1, 1));
        let mean = |lamp: &TrueLamp| lamp.normal_irradiance().element_sum() / 3.0;
        assert!((mean(&all[0]) / mean(&all[11]) - 100.0).abs() < 0.1);
        let total: f32 = all.iter().map(mean).sum();
        assert!((total - 12.0).abs() < 0.01, "{total}");
        let first = all[0].radiance / (all[0].radiance.element_sum() / 3.0);
        assert!(
            (first - Vec3::new(1.5, 0.75, 0.75)).length() < 1e-3,
            "{first}"
        );
        for (i, a) in all.iter().enumerate() {
            for b in &all[..i] {
                let apart = a.direction.angle_between(b.direction).to_degrees();
                assert!(apart > 8.0, "{apart}°");
            }
        }
    }

    #[test]
    fn a_lamps_nodes_hold_its_flux_however_small_or_large_it_is() {
        for angular_radius in [0.001, 0.05, 0.5] {
            let lamp = TrueLamp {
                direction: Vec3::new(0.0, 0.6, 0.8),
                radiance: Vec3::splat(7.0),
                angular_radius,
                distance: None,
            };
            let flux = lamp.nodes(0.05, 2.0).flux().x;
            let expected = 14.0 * TAU * (1.0 - f64::from(angular_radius).cos()) as f32;
            assert!((flux / expected - 1.0).abs() < 2e-2, "{flux} {expected}");
            let moved = lamp.moved().direction.angle_between(lamp.direction);
            assert!((moved - MOVE).abs() < 1e-4 && lamp.moved().direction.y > 0.0);
        }
    }
}
