//! Lamps as discs of light, placed by the shadows and the shading that go over an object as it turns.
//!
//! Highlights tell where a lamp is to a small part of the lobe's width only where there are enough of them; the diffuse part of thousands of
//! points changes with every shift of a shadow. Each disc has a direction and a radius, which go by Gauss-Newton steps with the
//! strengths of all lights, the albedos eliminated.

use glam::Vec3;

use super::super::fast::Solver;
use super::super::observations::Observations;
use super::diffuse::Shading;
use super::{Light, Source};
use rekindle_base::math::GOLDEN_ANGLE;
use rekindle_scene::hemisphere::Lamp;
use rekindle_scene::reflectance::Brdf;

/// Sources of a disc, and how many of them lie around the others.
const SOURCES: usize = 16;
const OUTLINE: usize = 5;
/// Shifts by which derivatives are taken: of directions in radians, and of the radius' logarithm.
const TILT: f64 = 0.004;
const WIDER: f64 = 0.1;
/// Rounds, the largest tilt and change of the logarithm in one, and the tilt that ends them, radians.
const ROUNDS: usize = 5;
const MOST_TILT: f64 = 0.03;
const MOST_WIDER: f64 = 0.3;
const SETTLED: f64 = 2e-4;
/// Radii, radians.
const RADII: [f32; 2] = [0.002, 0.2];

/// A uniform disc of light.
#[derive(Clone, Copy, Debug)]
pub struct Disc {
    /// Unit direction of its centre.
    pub direction: Vec3,
    /// Angular radius, radians.
    pub radius: f32,
    /// Radiance × solid angle, RGB.
    pub flux: Vec3,
}

impl Disc {
    /// A lamp's.
    pub fn of(lamp: &Lamp) -> Self {
        Self {
            direction: lamp.direction,
            radius: lamp.angular_radius.clamp(RADII[0], RADII[1]),
            flux: lamp.flux.into(),
        }
    }

    /// As sources of equal flux, the outer ones first.
    pub fn light(&self) -> Light {
        let (across, along) = self.direction.any_orthonormal_pair();
        let source = |k: usize| {
            let (sin, cos) = (k as f32 * GOLDEN_ANGLE).sin_cos();
            let out = self.radius * ((k as f32 + 0.5) / SOURCES as f32).sqrt();
            Source {
                direction: (self.direction + out * (cos * across + sin * along))
                    .normalize_or(self.direction),
                flux: self.flux / SOURCES as f32,
            }
        };
        Light {
            sources: (0..SOURCES).rev().map(source).collect(),
            outline: OUTLINE,
        }
    }

    /// Tilted by angles to either side, and as many times as wide as the third's exponential.
    fn moved(&self, by: [f64; 3]) -> Self {
        let (across, along) = self.direction.any_orthonormal_pair();
        let [u, v, wider] = by.map(|shift| shift as f32);
        Self {
            direction: (self.direction + u * across + v * along).normalize_or(self.direction),
            radius: (self.radius * wider.exp()).clamp(RADII[0], RADII[1]),
            ..*self
        }
    }
}

/// The discs that leave least of the diffuse part, from these on, beside lights that stay as they are.
pub fn refined(
    (solver, brdf): (&Solver<'_>, Option<Brdf>),
    observations: &Observations,
    start: &[Disc],
    others: &[Light],
) -> Vec<Disc> {
    let mut discs = start.to_vec();
    let mut best: Option<(f64, f32, Vec<Disc>)> = None;
    for _ in 0..ROUNDS {
        let shifts = [
            [0.0; 3],
            [TILT, 0.0, 0.0],
            [0.0, TILT, 0.0],
            [0.0, 0.0, WIDER],
        ];
        let shifted = discs
            .iter()
            .flat_map(|disc| shifts.map(|by| disc.moved(by).light()));
        let lights: Vec<Light> = shifted.chain(others.iter().cloned()).collect();
        let all = Shading::of_lights((solver, brdf), observations, &lights);
        let own = discs.len();
        // The discs as they are, the others and light from everywhere.
        let unmoved = (0..own).map(|k| 4 * k).chain(4 * own..=lights.len());
        let unmoved: Vec<usize> = unmoved.collect();
        let here = all.only(&unmoved);
        let strengths = here.light(Some(vec![1.0; unmoved.len()]));
        let error = best
            .as_ref()
            .map_or_else(|| here.error(&strengths), |best| best.1);
        let cost = here.cost(&strengths, error);
        if best.as_ref().is_some_and(|(least, ..)| cost >= *least) {
            break;
        }
        best = Some((cost, error, discs.clone()));
        let mut x = vec![0.0; lights.len() + 1];
        for (&k, &strength) in unmoved.iter().zip(&strengths) {
            x[k] = strength;
        }
        let step = all.step(&x, |row| {
            let moves = (0..own).flat_map(|k| {
                let change = |j: usize, by: f64| x[4 * k] * (row[4 * k + j] - row[4 * k]) / by;
                [change(1, TILT), change(2, TILT), change(3, WIDER)]
            });
            moves.chain(unmoved.iter().map(|&k| row[k])).collect()
        });
        let mut furthest = 0.0_f64;
        for (disc, by) in discs.iter_mut().zip(step.as_chunks::<3>().0) {
            let [u, v] = [by[0], by[1]].map(|tilt| tilt.clamp(-MOST_TILT, MOST_TILT));
            furthest = furthest.max(u.hypot(v));
            *disc = disc.moved([u, v, by[2].clamp(-MOST_WIDER, MOST_WIDER)]);
        }
        if furthest < SETTLED {
            break;
        }
    }
    best.map_or(discs, |(.., discs)| discs)
}
