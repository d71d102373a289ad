//! Wide lamps in patches.
//!
//! Of a lamp that fills a large part of the sky most points see some part, so that every node would have its ray almost
//! everywhere. Its shadows have no edges, though: it is taken for an environment of its own, patches of neighbouring nodes
//! of which a point sees a fraction that varies smoothly over the surface.

use std::borrow::Cow;

use super::lighting::{LampNodes, LightNode};

/// Lamps of a larger angular radius are wide, radians.
const WIDE: f32 = 0.15;

/// Largest angle between a lamp's direction and a node of it that shines, radians.
pub(super) fn reach(lamp: &LampNodes) -> f32 {
    lit(lamp)
        .map(|n| n.direction.angle_between(lamp.direction))
        .fold(0.0, f32::max)
}

fn lit(lamp: &LampNodes) -> impl Iterator<Item = &LightNode> {
    lamp.nodes.iter().filter(|n| n.flux() != glam::Vec3::ZERO)
}

/// The patches of a wide lamp, none with a larger [`reach`] than asked for; nothing where the lamp isn't wide.
pub(super) fn patches(lamp: &LampNodes, largest: f32) -> Vec<LampNodes> {
    if lamp.muted || reach(lamp) <= WIDE {
        return Vec::new();
    }
    cut(lamp, largest)
}

/// The parts of a lamp, none with a larger [`reach`] than asked for unless it is a single node.
pub(super) fn cut(lamp: &LampNodes, largest: f32) -> Vec<LampNodes> {
    let mut cut = Vec::new();
    let mut left: Vec<Cow<'_, LampNodes>> = vec![Cow::Borrowed(lamp)];
    while let Some(patch) = left.pop() {
        if patch.nodes.len() == 1 || reach(&patch) <= largest {
            cut.push(patch.into_owned());
        } else {
            left.extend(halves(&patch).into_iter().flatten().map(Cow::Owned));
        }
    }
    cut
}

/// A lamp's lit nodes on either side of the middle of its longer side.
fn halves(lamp: &LampNodes) -> [Option<LampNodes>; 2] {
    let mut nodes: Vec<LightNode> = lit(lamp).copied().collect();
    let (tangent, bitangent) = lamp.direction.any_orthonormal_pair();
    let extent = |axis: glam::Vec3| {
        let along = nodes.iter().map(|n| n.direction.dot(axis));
        let (low, high) = along.fold((f32::MAX, f32::MIN), |(l, h), x| (l.min(x), h.max(x)));
        high - low
    };
    // Of a few axes the one along which the nodes reach furthest.
    let axis = (0..4)
        .map(|k| {
            let (sin, cos) = (k as f32 * std::f32::consts::FRAC_PI_4).sin_cos();
            tangent * cos + bitangent * sin
        })
        .max_by(|&a, &b| extent(a).total_cmp(&extent(b)))
        .unwrap_or(tangent);
    nodes.sort_by(|a, b| a.direction.dot(axis).total_cmp(&b.direction.dot(axis)));
    let second = nodes.split_off(nodes.len() / 2);
    [nodes, second].map(|half| LampNodes::new(half, lamp.radius))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn a_wide_lamp_is_cut_into_small_patches_with_all_its_light_and_a_small_one_is_not() {
        let towards = Vec3::new(0.6, 0.48, 0.64);
        let flux = Vec3::new(3.0, 2.0, 1.0);
        let disc =
            |degrees: f32| LampNodes::disc_of(2000, towards, flux, f32::to_radians(degrees), None);
        assert!(patches(&disc(5.0), 0.12).is_empty());
        let wide = disc(25.0);
        let cut = patches(&wide, 0.12);
        // Discs of that reach would have a thirteenth of its area.
        assert!((13..80).contains(&cut.len()), "{} patches", cut.len());
        assert!(cut.iter().all(|p| reach(p) <= 0.12));
        let sum: Vec3 = cut.iter().map(LampNodes::flux).sum();
        assert!((sum - flux).length() < 1e-4, "{sum}");
        let nodes: usize = cut.iter().map(|p| p.nodes.len()).sum();
        assert_eq!(nodes, wide.nodes.len());
    }

    #[test]
    fn a_muted_lamp_has_none() {
        let mut lamp = LampNodes::disc(Vec3::Y, Vec3::ONE, 0.5, None);
        lamp.muted = true;
        assert!(patches(&lamp, 0.1).is_empty());
    }
}
