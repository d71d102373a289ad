//! How far an estimate is from the truth. Lights are known up to one common factor, K_S: fluxes and hemispheres are
//! compared after the estimate is scaled to the truth's.

use std::collections::BTreeSet;

use glam::Vec3;

use super::truth::{TrueLamp, Truth};
use rekindle_scene::hemisphere::{HemisphereGrid, find_lamps};
use rekindle_solution::SolutionLamp;

/// Blur, radians, with which hemispheres are compared: coarser than nodes, finer than lamps' distances.
const BLUR: f32 = 0.05;
/// Frequency of the grid on which they are compared: nodes are about a blur apart.
const COMPARED: u32 = 20;
/// Blurs beyond which a lamp adds nothing.
const BLURS: f32 = 5.0;
/// Points that stand for a lamp's disc.
const DISC: usize = 64;

/// A lamp of an estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundLamp {
    /// Unit direction from the object's centre.
    pub direction: Vec3,
    /// Radiance × solid angle, RGB.
    pub flux: Vec3,
}

impl From<&SolutionLamp> for FoundLamp {
    fn from(lamp: &SolutionLamp) -> Self {
        Self {
            direction: lamp.direction,
            flux: lamp.flux,
        }
    }
}

/// Errors of an estimate; `None` where truth or estimate has nothing to compare.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// σ over the true σ, less 1.
    pub sigma: Option<f64>,
    /// Largest angle between a lamp and the nearest one found, degrees.
    pub direction_deg: Option<f64>,
    /// Largest relative error of a lamp's flux.
    pub flux: Option<f64>,
    /// Part of the flux found that is in lights that are no true lamp's.
    pub outside: Option<f64>,
    /// Relative error of the blurred hemisphere; see [`hemisphere_error`].
    pub hemisphere: Option<f64>,
}

/// The truth, prepared for comparing many estimates with it.
pub struct Measures<'a> {
    truth: &'a Truth,
    compared: HemisphereGrid,
    blurred: Vec<f64>,
}

impl<'a> Measures<'a> {
    /// Prepares a truth for estimates about this pole.
    pub fn new(truth: &'a Truth, up: Vec3) -> Self {
        let compared = HemisphereGrid::new(COMPARED, up, None, Vec3::ZERO);
        let sources: Vec<(Vec3, f64)> = truth.lamps.iter().flat_map(points).collect();
        let blurred = blur(&compared, &sources);
        Self {
            truth,
            compared,
            blurred,
        }
    }

    /// Errors of an estimate on the nodes of a grid, one radiance per node.
    pub fn of_nodes(&self, sigma: f32, grid: &HemisphereGrid, radiance: &[[f32; 3]]) -> Errors {
        let found: Vec<FoundLamp> = find_lamps(grid, radiance)
            .iter()
            .map(|lamp| FoundLamp {
                direction: lamp.direction,
                flux: lamp.flux.into(),
            })
            .collect();
        self.errors(Some(sigma), &found, grid, radiance)
    }

    /// Errors of an estimate whose lamps are known.
    pub fn errors(
        &self,
        sigma: Option<f32>,
        found: &[FoundLamp],
        grid: &HemisphereGrid,
        radiance: &[[f32; 3]],
    ) -> Errors {
        let lamps = lamp_errors(&self.truth.lamps, found);
        let worst = |values: &[f64]| values.iter().map(|v| v.abs()).fold(0.0, f64::max);
        let sources: Vec<(Vec3, f64)> = grid
            .directions
            .iter()
            .zip(radiance)
            .filter(|(_, radiance)| **radiance != [0.0; 3])
            .map(|(&direction, radiance)| (direction, radiance.iter().map(|&v| f64::from(v)).sum()))
            .collect();
        Errors {
            sigma: sigma
                .zip(self.truth.sigma)
                .map(|(found, truth)| f64::from(found) / f64::from(truth) - 1.0),
            direction_deg: lamps.as_ref().map(|(angles, _)| worst(angles)),
            flux: lamps.as_ref().map(|(_, fluxes)| worst(fluxes)),
            outside: outside(&self.truth.lamps, found),
            hemisphere: hemisphere_error(&self.blurred, &blur(&self.compared, &sources)),
        }
    }
}

/// For every true lamp the angle to the nearest one found, degrees, and the relative error of that one's flux after the
/// fluxes found are scaled to the true sum. `None` without lamps on either side.
pub fn lamp_errors(truth: &[TrueLamp], found: &[FoundLamp]) -> Option<(Vec<f64>, Vec<f64>)> {
    if truth.is_empty() || found.is_empty() {
        return None;
    }
    let nearest = nearest(truth, found).map(|i| &found[i]);
    let nearest: Vec<&FoundLamp> = nearest.collect();
    let total: f64 = truth.iter().map(|lamp| sum(lamp.flux)).sum();
    let total_found: f64 = nearest.iter().map(|lamp| sum(lamp.flux)).sum();
    let scale = total / total_found.max(f64::MIN_POSITIVE);
    Some(
        truth
            .iter()
            .zip(nearest)
            .map(|(lamp, found)| {
                let flux = scale * sum(found.flux) / sum(lamp.flux) - 1.0;
                (angle(found.direction, lamp.direction), flux)
            })
            .unzip(),
    )
}

/// For every true lamp the place of the nearest one found.
fn nearest(truth: &[TrueLamp], found: &[FoundLamp]) -> impl Iterator<Item = usize> {
    truth.iter().filter_map(|lamp| {
        let away = |i: &usize| angle(found[*i].direction, lamp.direction);
        (0..found.len()).min_by(|a, b| away(a).total_cmp(&away(b)))
    })
}

/// Part of the flux found that is in lights that are nearest to no true one.
fn outside(truth: &[TrueLamp], found: &[FoundLamp]) -> Option<f64> {
    let own: BTreeSet<usize> = nearest(truth, found).collect();
    let all: f64 = found.iter().map(|lamp| sum(lamp.flux)).sum();
    let inside: f64 = own.iter().map(|&i| sum(found[i].flux)).sum();
    (!own.is_empty() && all > 0.0).then(|| 1.0 - inside / all)
}

fn angle(a: Vec3, b: Vec3) -> f64 {
    a.as_dvec3().angle_between(b.as_dvec3()).to_degrees()
}

fn sum(flux: Vec3) -> f64 {
    flux.element_sum().into()
}

/// Points of a lamp's disc with their shares of its flux.
fn points(lamp: &TrueLamp) -> Vec<(Vec3, f64)> {
    let disc = rekindle_relight::LampNodes::disc_of(
        DISC,
        lamp.direction,
        lamp.flux,
        lamp.angular_radius,
        None,
    );
    disc.nodes
        .iter()
        .map(|node| (node.direction, f64::from(node.flux().element_sum())))
        .collect()
}

/// Light from given directions, blurred by a Gaussian, at every node of a grid.
fn blur(grid: &HemisphereGrid, sources: &[(Vec3, f64)]) -> Vec<f64> {
    let least = (BLURS * BLUR).cos();
    grid.directions
        .iter()
        .map(|direction| {
            sources
                .iter()
                .map(|(from, flux)| (direction.dot(*from), flux))
                .filter(|(cos, _)| *cos > least)
                .map(|(cos, flux)| flux * f64::from((cos - 1.0) / (BLUR * BLUR)).exp())
                .sum()
        })
        .collect()
}

/// √(Σ (k b − a)² / Σ a²) of two blurred hemispheres a (the truth) and b, k scaling b to the sum of a. `None` where the
/// truth is dark; 1 where the estimate is.
pub fn hemisphere_error(truth: &[f64], found: &[f64]) -> Option<f64> {
    let squares: f64 = truth.iter().map(|a| a * a).sum();
    let sum: f64 = found.iter().sum();
    let scale = if sum > 0.0 {
        truth.iter().sum::<f64>() / sum
    } else {
        0.0
    };
    let apart: f64 = truth
        .iter()
        .zip(found)
        .map(|(a, b)| (scale * b - a).powi(2))
        .sum();
    (squares > 0.0).then(|| (apart / squares).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lamp(direction: Vec3, flux: f32) -> TrueLamp {
        TrueLamp {
            direction: direction.normalize_or_zero(),
            flux: Vec3::splat(flux),
            angular_radius: 0.02,
        }
    }

    #[test]
    fn fluxes_are_compared_up_to_one_factor() {
        let truth = [lamp(Vec3::X, 1.0), lamp(Vec3::Y, 3.0)];
        let found = [
            FoundLamp {
                direction: Vec3::new(0.01, 1.0, 0.0).normalize_or_zero(),
                flux: Vec3::splat(6.0),
            },
            FoundLamp {
                direction: Vec3::X,
                flux: Vec3::splat(2.0),
            },
            FoundLamp {
                direction: Vec3::Z,
                flux: Vec3::splat(9.0),
            },
        ];
        let (angles, fluxes) = lamp_errors(&truth, &found).expect("lamps on both sides");
        assert!(angles[0].abs() < 1e-4);
        assert!(
            (angles[1] - 0.01_f64.atan().to_degrees()).abs() < 1e-4,
            "{angles:?}"
        );
        assert!(fluxes.iter().all(|f| f.abs() < 1e-6), "{fluxes:?}");
        assert!(lamp_errors(&truth, &[]).is_none());
        // One lamp 10 % too strong: 1.1 + 3 shared out as 1 + 3.
        let stronger = [found[1], found[0]].map(|mut f| {
            if f.direction == Vec3::X {
                f.flux *= 1.1;
            }
            f
        });
        let (_, fluxes) = lamp_errors(&truth, &stronger).expect("lamps on both sides");
        assert!(
            (fluxes[0] - (1.1 * 4.0 / 4.1 - 1.0)).abs() < 1e-6,
            "{fluxes:?}"
        );
    }

    #[test]
    fn a_hemisphere_is_wrong_by_what_is_in_the_wrong_place() {
        assert_eq!(hemisphere_error(&[1.0, 2.0], &[10.0, 20.0]), Some(0.0));
        assert_eq!(hemisphere_error(&[3.0, 4.0], &[0.0, 0.0]), Some(1.0));
        assert_eq!(hemisphere_error(&[0.0, 0.0], &[1.0, 0.0]), None);
        let swapped = hemisphere_error(&[1.0, 0.0], &[0.0, 1.0]).expect("light");
        assert!((swapped - 2.0_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_lamp_a_little_off_is_a_little_wrong() {
        let truth = Truth {
            sigma: Some(0.1),
            lamps: vec![lamp(Vec3::new(0.3, 0.8, 0.2), 1.0)],
            novel: None,
            relit: Vec::new(),
        };
        let measures = Measures::new(&truth, Vec3::Y);
        let grid = HemisphereGrid::new(40, Vec3::Y, None, Vec3::ZERO);
        let at = |direction: Vec3| {
            let mut radiance = vec![[0.0; 3]; grid.directions.len()];
            radiance[grid.nearest(direction.normalize_or_zero()).expect("a node")] = [5.0; 3];
            measures.of_nodes(0.11, &grid, &radiance)
        };
        let (near, far) = (at(Vec3::new(0.3, 0.8, 0.2)), at(Vec3::new(0.5, 0.8, 0.2)));
        assert!((near.sigma.expect("σ") - 0.1).abs() < 1e-6);
        assert!(near.direction_deg.expect("a lamp") < 1.0 && near.flux.expect("a lamp") < 1e-6);
        assert!(near.hemisphere.expect("light") < 0.3, "{near:?}");
        assert!(far.hemisphere.expect("light") > 1.0, "{far:?}");
    }
}
