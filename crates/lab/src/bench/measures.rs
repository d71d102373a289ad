//! How far an estimate is from the truth. Lights are known up to one common factor, K_S: fluxes and hemispheres are
//! compared after the estimate is scaled to the truth's.

use glam::Vec3;

use super::truth::{TrueLamp, Truth};
use rekindle_base::math::groups::linked_groups;
use rekindle_scene::hemisphere::{HemisphereGrid, find_lamps};
use rekindle_solution::SolutionLamp;

/// Blur, radians, with which hemispheres are compared: coarser than nodes, finer than lamps' distances.
const BLUR: f32 = 0.05;
/// Frequency of the grid on which they are compared: nodes are about a blur apart.
const COMPARED: u32 = 20;
/// Blurs beyond which a lamp adds nothing.
const BLURS: f32 = 5.0;
/// Discs as far apart as their radii together touch, but for rounding.
const TOUCHING: f32 = 1.001;
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
    /// Largest angle between a lamp and what was found of it, degrees. Lamps whose discs touch are one.
    pub direction_deg: Option<f64>,
    /// Largest relative error of a lamp's flux.
    pub flux: Option<f64>,
    /// Part of the flux found that is in lights that are no true lamp's.
    pub outside: Option<f64>,
    /// Part of the true flux that is in lamps of which nothing was found.
    pub missing: Option<f64>,
    /// Relative error of the blurred hemisphere; see [`hemisphere_error`].
    pub hemisphere: Option<f64>,
}

/// The truth, prepared for comparing many estimates with it.
pub struct Measures<'a> {
    truth: &'a Truth,
    /// Its lamps, those that touch as one.
    lamps: Vec<TrueLamp>,
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
            lamps: joined(&truth.lamps),
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
        let lamps = matched(&self.lamps, found);
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
            direction_deg: lamps.as_ref().map(|lamps| worst(&lamps.angles)),
            flux: lamps.as_ref().map(|lamps| worst(&lamps.fluxes)),
            outside: lamps.as_ref().map(|lamps| lamps.outside),
            missing: lamps.as_ref().map(|lamps| lamps.missing),
            hemisphere: hemisphere_error(&self.blurred, &blur(&self.compared, &sources)),
        }
    }
}

/// What of an estimate's lamps is which true lamp's.
#[derive(Debug)]
struct Matched {
    /// Angles between true lamps and what was found of them, degrees.
    angles: Vec<f64>,
    /// Relative errors of their fluxes, after those found are scaled to the true sum.
    fluxes: Vec<f64>,
    /// Part of the flux found that is no true lamp's.
    outside: f64,
    /// Part of the true flux of which nothing was found.
    missing: f64,
}

/// Compares lamps: `None` without any on either side. A lamp found is of the nearest true one: all that lie in its disc, or else the nearest to
/// it.
fn matched(truth: &[TrueLamp], found: &[FoundLamp]) -> Option<Matched> {
    let of: Vec<usize> = found
        .iter()
        .filter_map(|lamp| nearest(truth, lamp))
        .collect();
    let own = |k: usize| -> Option<FoundLamp> {
        let lamp = &truth[k];
        let own = found.iter().zip(&of).filter(|(_, of)| **of == k);
        let own: Vec<&FoundLamp> = own.map(|(found, _)| found).collect();
        let away = |found: &FoundLamp| angle(found.direction, lamp.direction);
        let radius = f64::from(lamp.angular_radius).to_degrees();
        let inside: Vec<&FoundLamp> = own.iter().copied().filter(|f| away(f) <= radius).collect();
        if inside.is_empty() {
            own.into_iter()
                .min_by(|a, b| away(a).total_cmp(&away(b)))
                .copied()
        } else {
            Some(together(
                inside.iter().map(|found| (found.direction, found.flux)),
            ))
        }
    };
    let pairs = (0..truth.len()).filter_map(|k| Some((&truth[k], own(k)?)));
    let pairs: Vec<(&TrueLamp, FoundLamp)> = pairs.collect();
    let total = |fluxes: &mut dyn Iterator<Item = Vec3>| fluxes.map(sum).sum::<f64>();
    let seen = total(&mut pairs.iter().map(|(lamp, _)| lamp.flux));
    let all = total(&mut truth.iter().map(|lamp| lamp.flux));
    let taken = total(&mut pairs.iter().map(|(_, found)| found.flux));
    let all_found = total(&mut found.iter().map(|lamp| lamp.flux));
    let scale = seen / taken.max(f64::MIN_POSITIVE);
    let error = |(lamp, found): &(&TrueLamp, FoundLamp)| {
        let flux = scale * sum(found.flux) / sum(lamp.flux) - 1.0;
        (angle(found.direction, lamp.direction), flux)
    };
    let (angles, fluxes) = pairs.iter().map(error).unzip();
    (!pairs.is_empty() && all_found > 0.0).then(|| Matched {
        angles,
        fluxes,
        outside: 1.0 - taken / all_found,
        missing: 1.0 - seen / all,
    })
}

/// The place of the true lamp whose disc, or else whose centre, is nearest to one found.
fn nearest(truth: &[TrueLamp], found: &FoundLamp) -> Option<usize> {
    let away = |k: &usize| {
        let off = angle(found.direction, truth[*k].direction);
        let radius = f64::from(truth[*k].angular_radius).to_degrees();
        ((off - radius).max(0.0), off)
    };
    (0..truth.len()).min_by(|a, b| {
        let ((beyond, off), (other_beyond, other_off)) = (away(a), away(b));
        beyond
            .total_cmp(&other_beyond)
            .then(off.total_cmp(&other_off))
    })
}

/// Lights as one: where their flux is, and how much.
fn together(lights: impl Iterator<Item = (Vec3, Vec3)>) -> FoundLamp {
    let (mut about, mut flux) = (Vec3::ZERO, Vec3::ZERO);
    for (direction, own) in lights {
        about += own.element_sum() * direction;
        flux += own;
    }
    FoundLamp {
        direction: about.normalize_or_zero(),
        flux,
    }
}

/// The same lamps, those whose discs touch as one: nothing tells where one ends and the other begins.
fn joined(lamps: &[TrueLamp]) -> Vec<TrueLamp> {
    let touch = |one: &TrueLamp, other: &TrueLamp| {
        let reach = one.angular_radius + other.angular_radius;
        one.direction.angle_between(other.direction) <= TOUCHING * reach
    };
    let one = |group: Vec<TrueLamp>| {
        let FoundLamp { direction, flux } = together(group.iter().map(|l| (l.direction, l.flux)));
        let reach = |lamp: &TrueLamp| direction.angle_between(lamp.direction) + lamp.angular_radius;
        let angular_radius = group.iter().map(reach).fold(0.0, f32::max);
        match group[..] {
            [alone] => alone,
            _ => TrueLamp {
                direction,
                flux,
                angular_radius,
            },
        }
    };
    let groups = linked_groups(lamps.to_vec(), touch);
    groups.into_iter().map(one).collect()
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
        let lamps = matched(&truth, &found).expect("lamps on both sides");
        assert!(lamps.angles[0].abs() < 1e-4);
        assert!(
            (lamps.angles[1] - 0.01_f64.atan().to_degrees()).abs() < 1e-4,
            "{lamps:?}"
        );
        assert!(lamps.fluxes.iter().all(|f| f.abs() < 1e-6), "{lamps:?}");
        assert!((lamps.outside - 9.0 / 17.0).abs() < 1e-6 && lamps.missing == 0.0);
        assert!(matched(&truth, &[]).is_none());
        // One lamp 10 % too strong: 1.1 + 3 shared out as 1 + 3.
        let stronger = [found[1], found[0]].map(|mut f| {
            if f.direction == Vec3::X {
                f.flux *= 1.1;
            }
            f
        });
        let fluxes = matched(&truth, &stronger)
            .expect("lamps on both sides")
            .fluxes;
        assert!(
            (fluxes[0] - (1.1 * 4.0 / 4.1 - 1.0)).abs() < 1e-6,
            "{fluxes:?}"
        );
    }

    #[test]
    fn a_lamp_of_which_nothing_was_found_is_missing_and_not_elsewhere() {
        let truth = [lamp(Vec3::X, 99.0), lamp(Vec3::Y, 1.0)];
        let found = [FoundLamp {
            direction: Vec3::X,
            flux: Vec3::splat(2.0),
        }];
        let lamps = matched(&truth, &found).expect("lamps on both sides");
        let counts = (lamps.angles.len(), lamps.fluxes.len(), lamps.outside);
        assert_eq!(counts, (1, 1, 0.0));
        assert!(lamps.angles[0] < 1e-4 && lamps.fluxes[0].abs() < 1e-6);
        assert!((lamps.missing - 0.01).abs() < 1e-6);
    }

    #[test]
    fn pieces_of_a_wide_lamp_are_that_lamp() {
        let wide = TrueLamp {
            angular_radius: 0.5,
            ..lamp(Vec3::X, 4.0)
        };
        let piece = |y: f32, flux: f32| FoundLamp {
            direction: Vec3::new(1.0, y, 0.0).normalize_or_zero(),
            flux: Vec3::splat(flux),
        };
        let of = |found: &[FoundLamp]| matched(&[wide], found).expect("lamps on both sides");
        let both = of(&[piece(0.3, 1.0), piece(-0.3, 1.0)]);
        assert!(
            both.angles[0] < 1e-3 && both.outside == 0.0,
            "{:?}",
            both.angles
        );
        let astray = of(&[piece(0.3, 1.0), piece(-0.3, 1.0), piece(2.0, 1.0)]);
        assert!((astray.outside - 1.0 / 3.0).abs() < 1e-6);
    }

    #[test]
    fn lamps_that_touch_are_one() {
        let at = |degrees: f32| {
            lamp(
                Vec3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), 0.0),
                1.0,
            )
        };
        let of = |apart: f32| {
            let mut lamps = [at(0.0), at(apart), at(90.0)];
            for lamp in &mut lamps {
                lamp.angular_radius = 3.0_f32.to_radians();
            }
            joined(&lamps)
        };
        assert_eq!((of(6.0).len(), of(7.0).len()), (2, 3));
        let one = of(6.0)
            .into_iter()
            .find(|lamp| lamp.flux.x == 2.0)
            .expect("one of both");
        assert!((angle(one.direction, at(3.0).direction)) < 1e-3);
        assert!((one.angular_radius.to_degrees() - 6.0).abs() < 1e-3);
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
