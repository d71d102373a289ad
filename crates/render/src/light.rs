//! The light taken apart: what can be baked for itself and added up with weights.
//!
//! Irradiance, visibility and interreflection are linear in the light. So every lamp, the remainder, the environment and the
//! ambient part are baked for unit flux in each channel, and gain, colour and mute are weights. What a part's nodes look like
//! apart from its flux is its shape: as long as that stays, nothing is baked again.

use glam::Vec3;

use rekindle_relight::lobes::Source;
use rekindle_relight::{Environment, LampNodes, LightNode, Lighting};

/// Which part of the light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PartKind {
    /// The lamp at this place in the list.
    Lamp(usize),
    /// Lit nodes of no lamp.
    Remainder,
    /// The distant environment.
    Environment,
    /// Light from everywhere alike.
    Ambient,
}

/// A part of the light.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub kind: PartKind,
    /// It alone, with unit flux (unit radiance for the ambient part) in each channel, never muted.
    pub shape: Lighting,
    /// Its flux; zero when muted.
    pub weight: Vec3,
}

/// Directions further apart than this are another shape, radians …
const SAME_DIRECTION: f32 = 1e-6;
/// … and so is a relative difference of radiance.
const SAME_RADIANCE: f32 = 1e-4;

/// Takes the light apart.
pub(super) fn split(lighting: &Lighting) -> Vec<Part> {
    let nothing = lighting.dark();
    let mut parts = Vec::with_capacity(lighting.lamps.len() + 3);
    for (i, lamp) in lighting.lamps.iter().enumerate() {
        let mut nodes = lamp.nodes.clone();
        let flux = normalise(&mut [&mut nodes]);
        if flux == Vec3::ZERO {
            continue;
        }
        parts.push(Part {
            kind: PartKind::Lamp(i),
            shape: Lighting {
                lamps: vec![LampNodes {
                    nodes,
                    muted: false,
                    ..*lamp
                }],
                ..nothing.clone()
            },
            weight: if lamp.muted { Vec3::ZERO } else { flux },
        });
    }
    let mut remainder = lighting.remainder.clone();
    let flux = normalise(&mut [&mut remainder]);
    if flux != Vec3::ZERO {
        parts.push(Part {
            kind: PartKind::Remainder,
            shape: Lighting {
                remainder,
                ..nothing.clone()
            },
            weight: flux,
        });
    }
    let mut environment = lighting.environment.clone();
    let lamps = environment.iter_mut().flat_map(Environment::lamps_mut);
    let mut lists: Vec<&mut Vec<LightNode>> = lamps.map(|lamp| &mut lamp.nodes).collect();
    let flux = normalise(&mut lists);
    if flux != Vec3::ZERO {
        parts.push(Part {
            kind: PartKind::Environment,
            shape: Lighting {
                environment,
                ..nothing.clone()
            },
            weight: flux,
        });
    }
    if lighting.ambient != Vec3::ZERO {
        parts.push(Part {
            kind: PartKind::Ambient,
            shape: Lighting {
                ambient: Vec3::ONE,
                ..nothing
            },
            weight: lighting.ambient,
        });
    }
    parts
}

/// Scales the nodes to unit flux in each channel and returns what the flux was. A channel without light takes the shape of
/// all channels together, so that colour is a weight whatever it was before. Dark nodes are dropped.
fn normalise(lists: &mut [&mut Vec<LightNode>]) -> Vec3 {
    for list in lists.iter_mut() {
        list.retain(|n| n.flux() != Vec3::ZERO);
    }
    let mut sum = glam::DVec3::ZERO;
    for node in lists.iter().flat_map(|list| list.iter()) {
        sum += node.flux().as_dvec3();
    }
    let flux = sum.as_vec3();
    let total = flux.element_sum();
    if total <= 0.0 || !total.is_finite() {
        return Vec3::ZERO;
    }
    for node in lists.iter_mut().flat_map(|list| list.iter_mut()) {
        let grey = node.radiance.element_sum() / total;
        node.radiance = Vec3::from([0, 1, 2].map(|c| {
            if flux[c] > 1e-6 * total {
                node.radiance[c] / flux[c]
            } else {
                grey
            }
        }));
    }
    flux
}

impl Part {
    /// Whether what is baked for `shape` serves this part.
    pub(super) fn has_shape(&self, shape: &Lighting) -> bool {
        let (a, b) = (&self.shape, shape);
        a.centre == b.centre
            && a.ambient == b.ambient
            && a.radius == b.radius
            && same_nodes(&a.remainder, &b.remainder)
            && same_lamps(&a.lamps, &b.lamps)
            && match (&a.environment, &b.environment) {
                (Some(a), Some(b)) => {
                    same_lamps(&a.suns, &b.suns) && same_lamps(&a.patches, &b.patches)
                }
                (a, b) => a.is_none() == b.is_none(),
            }
    }

    /// Its nodes with their true flux. Groups are numbered as `relight::Shader` numbers those of the shape.
    pub(super) fn sources(&self) -> Vec<Source> {
        let lists = self
            .shape
            .lamps
            .iter()
            .chain(self.shape.environment_lamps())
            .map(|lamp| lamp.nodes.as_slice());
        let strays = self.shape.remainder.iter().map(std::slice::from_ref);
        lists
            .chain(strays)
            .filter(|nodes| !nodes.is_empty())
            .enumerate()
            .flat_map(|(group, nodes)| {
                nodes.iter().map(move |n| Source {
                    direction: n.direction,
                    flux: n.flux() * self.weight,
                    group: group as u32,
                })
            })
            .collect()
    }

    /// Those of its nodes that lobes show one by one, and those that they show as the sky.
    pub(super) fn sources_by_lobes(&self) -> (Vec<Source>, Vec<Source>) {
        let environment = self.shape.environment.as_ref();
        let mirrored = environment.map_or(usize::MAX, |environment| environment.suns.len());
        (self.sources().into_iter()).partition(|source| (source.group as usize) < mirrored)
    }

    /// Distance of its nodes from the centre, `None` for distant light.
    pub(super) fn radius(&self) -> Option<f32> {
        match self.kind {
            PartKind::Lamp(_) => self.shape.lamps.first().and_then(|lamp| lamp.radius),
            PartKind::Remainder => self.shape.radius,
            PartKind::Environment | PartKind::Ambient => None,
        }
    }
}

fn same_lamps(a: &[LampNodes], b: &[LampNodes]) -> bool {
    a.len() == b.len()
        && a.iter()
            .zip(b)
            .all(|(a, b)| a.radius == b.radius && same_nodes(&a.nodes, &b.nodes))
}

fn same_nodes(a: &[LightNode], b: &[LightNode]) -> bool {
    a.len() == b.len()
        && a.iter().zip(b).all(|(a, b)| {
            let (fa, fb) = (a.flux(), b.flux());
            a.direction.distance_squared(b.direction) <= SAME_DIRECTION * SAME_DIRECTION
                && (fa - fb).abs().max_element()
                    <= SAME_RADIANCE * fa.max_element().max(fb.max_element())
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lighting() -> Lighting {
        Lighting {
            lamps: vec![
                LampNodes::disc(Vec3::Y, Vec3::new(3.0, 2.0, 1.0), 0.05, None),
                LampNodes::disc(Vec3::X, Vec3::new(0.0, 1.0, 1.0), 0.05, None),
            ],
            remainder: Vec::new(),
            environment: None,
            ambient: Vec3::splat(0.1),
            centre: Vec3::ZERO,
            radius: None,
            up: Vec3::Y,
            specular_scale: Vec3::ONE,
        }
    }

    #[test]
    fn gain_colour_and_mute_keep_the_shape() {
        let before = split(&lighting());
        let mut edited = lighting();
        for node in &mut edited.lamps[0].nodes {
            node.radiance *= Vec3::new(0.5, 7.0, 0.0);
        }
        edited.lamps[1].muted = true;
        edited.ambient *= 3.0;
        let after = split(&edited);
        assert_eq!(before.len(), after.len());
        for (a, b) in before.iter().zip(&after) {
            assert!(a.has_shape(&b.shape), "{:?}", a.kind);
        }
        assert!((after[0].weight - Vec3::new(1.5, 14.0, 0.0)).length() < 1e-4);
        assert_eq!(after[1].weight, Vec3::ZERO);
    }

    #[test]
    fn a_move_is_another_shape_of_that_lamp_alone() {
        let before = split(&lighting());
        let mut edited = lighting();
        edited.lamps[0].turn_towards(Vec3::new(0.01, 1.0, 0.0).normalize_or_zero());
        let after = split(&edited);
        assert!(!before[0].has_shape(&after[0].shape));
        assert!(before[1].has_shape(&after[1].shape));
    }

    #[test]
    fn a_part_has_the_flux_it_had() {
        for part in split(&lighting()) {
            let flux: Vec3 = part.sources().iter().map(|s| s.flux).sum();
            let expected = match part.kind {
                PartKind::Lamp(i) => lighting().lamps[i].flux(),
                _ => Vec3::ZERO,
            };
            assert!((flux - expected).length() < 1e-4, "{flux}, not {expected}");
        }
    }
}
