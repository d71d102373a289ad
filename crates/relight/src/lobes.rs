//! Nodes of light merged into lobes.
//!
//! A lobe of specular reflection can't tell nodes from one another that are much closer together than it is wide. Such nodes
//! become one lobe with their mean direction, their flux and their angular variance, by which the shader widens it: then
//! mean and variance of the sum are right, and what is left is of fourth order in (angle between nodes ÷ width of the
//! lobe).

use std::collections::BinaryHeap;

use glam::Vec3;

/// A node of light to be merged.
#[derive(Clone, Copy, Debug)]
pub struct Source {
    /// Unit direction from the centre.
    pub direction: Vec3,
    /// Radiance × solid angle.
    pub flux: Vec3,
    /// What it shares its visibility with.
    pub group: u32,
}

/// Several nodes as one.
#[derive(Clone, Debug, PartialEq)]
pub struct Lobe {
    /// Unit direction from the centre.
    pub direction: Vec3,
    /// Radiance × solid angle.
    pub flux: Vec3,
    /// Variance of the nodes' directions per axis, radians².
    pub spread: f32,
    /// Groups of the nodes with their parts of the flux.
    pub groups: Vec<(u32, f32)>,
}

/// Some nodes that may be split again.
struct Cluster {
    nodes: Vec<Source>,
    /// Mean direction, not normalised.
    mean: Vec3,
    spread: f32,
    strength: f32,
    /// Number in the order of creation: makes the order of equals definite.
    number: usize,
}

impl Cluster {
    fn new(nodes: Vec<Source>, number: usize) -> Self {
        let weight = |n: &Source| n.flux.element_sum();
        let strength: f32 = nodes.iter().map(weight).sum();
        let sum: Vec3 = nodes.iter().map(|n| n.direction * weight(n)).sum();
        let mean = sum / strength.max(f32::MIN_POSITIVE);
        let variance: f32 = nodes
            .iter()
            .map(|n| n.direction.distance_squared(mean) * weight(n))
            .sum();
        Self {
            mean,
            spread: 0.5 * variance / strength.max(f32::MIN_POSITIVE),
            strength,
            nodes,
            number,
        }
    }

    /// How much there is to gain by a split.
    fn gain(&self) -> f32 {
        if self.nodes.len() > 1 {
            self.strength * self.spread
        } else {
            0.0
        }
    }

    /// Halves at the mean across the axis along which the directions vary most.
    fn split(self, number: usize) -> [Self; 2] {
        let mut variance = Vec3::ZERO;
        for n in &self.nodes {
            let offset = n.direction - self.mean;
            variance += offset * offset * n.flux.element_sum();
        }
        let axis = variance.max_position();
        let (mut low, mut high): (Vec<Source>, Vec<Source>) = self
            .nodes
            .iter()
            .partition(|n| n.direction[axis] < self.mean[axis]);
        if low.is_empty() || high.is_empty() {
            // All at one place: any halves will do.
            let mut all = self.nodes;
            high = all.split_off(all.len() / 2);
            low = all;
        }
        [Self::new(low, number), Self::new(high, number + 1)]
    }

    fn lobe(&self) -> Lobe {
        let mut groups: Vec<(u32, f32)> = Vec::new();
        for node in &self.nodes {
            let share = node.flux.element_sum() / self.strength.max(f32::MIN_POSITIVE);
            match groups.binary_search_by_key(&node.group, |g| g.0) {
                Ok(at) => groups[at].1 += share,
                Err(at) => groups.insert(at, (node.group, share)),
            }
        }
        Lobe {
            direction: self
                .mean
                .normalize_or(self.nodes.first().map_or(Vec3::Y, |n| n.direction)),
            flux: self.nodes.iter().map(|n| n.flux).sum(),
            spread: self.spread,
            groups,
        }
    }
}

impl PartialEq for Cluster {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Cluster {}
impl PartialOrd for Cluster {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Cluster {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.gain()
            .total_cmp(&other.gain())
            .then(other.number.cmp(&self.number))
    }
}

/// Merges nodes into lobes: as few as have no more than the variance `spread`, and no more than `most`.
pub fn merge(nodes: Vec<Source>, spread: f32, most: usize) -> Vec<Lobe> {
    let nodes: Vec<Source> = nodes
        .into_iter()
        .filter(|n| n.flux.element_sum() > 0.0)
        .collect();
    if nodes.is_empty() || most == 0 {
        return Vec::new();
    }
    let mut open = BinaryHeap::from([Cluster::new(nodes, 0)]);
    let mut done: Vec<Cluster> = Vec::new();
    let mut number = 1;
    while let Some(cluster) = open.pop() {
        let full = done.len() + open.len() + 1 >= most;
        if full || cluster.nodes.len() == 1 || cluster.spread <= spread {
            done.push(cluster);
        } else {
            open.extend(cluster.split(number));
            number += 2;
        }
    }
    done.sort_by_key(|c| c.number);
    done.iter().map(Cluster::lobe).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cap(count: usize) -> Vec<Source> {
        (0..count)
            .map(|i| {
                let height = 1.0 - (i as f32 + 0.5) / count as f32;
                let across = (1.0 - height * height).sqrt();
                let (sin, cos) = (i as f32 * rekindle_base::math::GOLDEN_ANGLE).sin_cos();
                Source {
                    direction: Vec3::new(across * cos, height, across * sin),
                    flux: Vec3::new(1.0, 2.0, 0.5) / count as f32,
                    group: (i % 7) as u32,
                }
            })
            .collect()
    }

    #[test]
    fn merging_keeps_the_flux_and_obeys_both_bounds() {
        for (spread, most) in [(1e-3, usize::MAX), (1e-2, 40), (0.0, 16), (10.0, 100)] {
            let lobes = merge(cap(3000), spread, most);
            let flux: Vec3 = lobes.iter().map(|l| l.flux).sum();
            assert!((flux - Vec3::new(1.0, 2.0, 0.5)).length() < 1e-4, "{flux}");
            assert!(lobes.len() <= most);
            if lobes.len() < most {
                assert!(
                    lobes.iter().all(|l| l.spread <= spread),
                    "lobes wider than asked for"
                );
            }
            for lobe in &lobes {
                let shares: f32 = lobe.groups.iter().map(|g| g.1).sum();
                assert!((shares - 1.0).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn a_single_node_is_a_lobe_without_spread() {
        let one = cap(1);
        let lobes = merge(one.clone(), 0.1, 8);
        assert_eq!(lobes.len(), 1);
        assert_eq!(lobes[0].spread, 0.0);
        assert!(lobes[0].direction.distance(one[0].direction) < 1e-6);
        assert!(merge(Vec::new(), 0.1, 8).is_empty());
    }

    #[test]
    fn nodes_at_one_place_are_merged_even_when_none_may_be() {
        let same = vec![cap(1)[0]; 5];
        let lobes = merge(same, 0.0, 8);
        assert_eq!(lobes.len(), 1);
    }
}
