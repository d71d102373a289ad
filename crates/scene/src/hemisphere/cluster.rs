//! Lamps: the lit nodes grouped into what a person would call one light.
//!
//! A solved hemisphere is spiky: a lamp of 3° radius comes out as several bright nodes with dark ones between them. So the
//! grouping looks at the radiance smoothed to [`SMOOTHING`]: every hill of it, down to where it runs into the next
//! (watershed), is one candidate; two hills are one lamp if the pass between them is at least [`PASS`] times as high as
//! the lower one. Two equal spikes become one lamp up to about 5° apart, and two lamps of 3° radius 10° apart stay two even
//! where one has a tenth of the other's flux. The foot of a hill below [`FOOT`] of its top belongs to no lamp, so that a
//! faint floor of light all over the hemisphere does not widen every lamp. Hills with less than [`SPECK`] of all flux, or
//! lower than [`SPECK`] of the highest, are specks: one within [`REACH`] of a lamp's edge joins the lamp; the others, like
//! the feet, are the rest (see [`rest`]).

use glam::Vec3;
use rayon::prelude::*;

use super::grid::HemisphereGrid;

/// Standard deviation, per axis, of the smoothing, in radians: 1.5°.
const SMOOTHING: f32 = 1.5 * std::f32::consts::PI / 180.0;
/// Height of the pass between two hills, relative to the lower, from which they are one lamp.
const PASS: f32 = 0.5;
/// Height relative to its top below which a hill ends.
const FOOT: f32 = 0.02;
/// Share of the whole flux, and of the highest hill's height, below which a hill is a speck.
const SPECK: f64 = 0.003;
/// How far beyond a lamp's angular radius a speck still joins it, in radians: 4°.
const REACH: f32 = 4.0 * std::f32::consts::PI / 180.0;

/// One light: a cluster of nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct Lamp {
    /// Its lit nodes, ascending.
    pub nodes: Vec<u32>,
    /// Flux-weighted centroid of the nodes' directions from the centre, unit.
    pub direction: Vec3,
    /// Σ L ω over the nodes, RGB, seen from the centre.
    pub flux: [f32; 3],
    /// √2 × the flux-weighted rms angle of the nodes from `direction`, in radians: the radius of a uniform disc.
    pub angular_radius: f32,
}

impl Lamp {
    /// The given nodes as one lamp, `None` if they emit nothing.
    pub fn new(grid: &HemisphereGrid, radiance: &[[f32; 3]], mut nodes: Vec<u32>) -> Option<Self> {
        nodes.sort_unstable();
        let mut flux = glam::DVec3::ZERO;
        let mut towards = glam::DVec3::ZERO;
        for &node in &nodes {
            flux += Vec3::from(radiance[node as usize]).as_dvec3();
            towards += weight(radiance[node as usize]) * grid.directions[node as usize].as_dvec3();
        }
        let direction = towards.try_normalize()?;
        let (mut squares, mut total) = (0.0, 0.0);
        for &node in &nodes {
            let w = weight(radiance[node as usize]);
            let angle = direction.angle_between(grid.directions[node as usize].as_dvec3());
            squares += w * angle * angle;
            total += w;
        }
        Some(Self {
            nodes,
            direction: direction.as_vec3().normalize_or_zero(),
            flux: (flux * f64::from(grid.solid_angle)).as_vec3().to_array(),
            angular_radius: (2.0 * squares / total).sqrt() as f32,
        })
    }

    /// Mean of the flux over the channels.
    pub fn mean_flux(&self) -> f32 {
        self.flux.iter().sum::<f32>() / 3.0
    }
}

/// What a node weighs in a cluster: the mean of its radiance over the channels.
fn weight(radiance: [f32; 3]) -> f64 {
    let mean = radiance.iter().map(|&c| f64::from(c)).sum::<f64>() / 3.0;
    if mean.is_finite() { mean.max(0.0) } else { 0.0 }
}

/// Radiance smoothed over the grid by repeated means with the neighbours, relative to the brightest node.
fn smoothed(grid: &HemisphereGrid, weights: &[f64]) -> Vec<f32> {
    let brightest = weights.iter().copied().fold(0.0, f64::max);
    let mut values: Vec<f32> = weights.iter().map(|w| (w / brightest) as f32).collect();
    // One mean over a node and its six neighbours at distance s spreads by the variance (6/7) s²/2 per axis.
    let step = 3.0 / 7.0 * grid.spacing() * grid.spacing();
    for _ in 0..(SMOOTHING * SMOOTHING / step).round() as usize {
        values = (0..values.len())
            .into_par_iter()
            .map(|node| {
                let around: f32 = grid.neighbours(node).map(|k| values[k]).sum();
                (values[node] + around) / 7.0
            })
            .collect();
    }
    values
}

/// Union-find over hills; each knows its top.
struct Hills {
    parent: Vec<u32>,
    top: Vec<f32>,
}

impl Hills {
    fn root(&mut self, mut hill: u32) -> u32 {
        while self.parent[hill as usize] != hill {
            let above = self.parent[self.parent[hill as usize] as usize];
            self.parent[hill as usize] = above;
            hill = above;
        }
        hill
    }
}

/// Groups all nodes above zero of `height` into hills, flooding from the tops; returns the hill of each node
/// (`u32::MAX` for none) and the height of each hill's top.
fn watershed(grid: &HemisphereGrid, height: &[f32]) -> (Vec<u32>, Vec<f32>) {
    let mut order: Vec<u32> = (0..height.len() as u32)
        .filter(|&n| height[n as usize] > 0.0)
        .collect();
    order.sort_unstable_by(|&a, &b| {
        height[b as usize]
            .total_cmp(&height[a as usize])
            .then(a.cmp(&b))
    });
    let mut hill = vec![u32::MAX; height.len()];
    let mut hills = Hills {
        parent: Vec::new(),
        top: Vec::new(),
    };
    for node in order {
        let level = height[node as usize];
        // The hills that this node touches, the one it slopes up to most steeply first.
        let mut touched: Vec<(f32, u32)> = grid
            .neighbours(node as usize)
            .filter(|&k| hill[k] != u32::MAX)
            .map(|k| (height[k], hills.root(hill[k])))
            .collect();
        touched.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let Some(&(_, own)) = touched.first() else {
            hill[node as usize] = hills.top.len() as u32;
            hills.parent.push(hills.top.len() as u32);
            hills.top.push(level);
            continue;
        };
        hill[node as usize] = own;
        for &(_, other) in &touched[1..] {
            let (a, b) = (hills.root(own), hills.root(other));
            let (high, low) = if hills.top[a as usize] >= hills.top[b as usize] {
                (a, b)
            } else {
                (b, a)
            };
            if a != b && level >= PASS * hills.top[low as usize] {
                hills.parent[low as usize] = high;
            }
        }
    }
    for h in &mut hill {
        if *h != u32::MAX {
            *h = hills.root(*h);
        }
    }
    (hill, hills.top)
}

/// The lamps of a hemisphere with one radiance per node, brightest first by the mean of their flux over the channels.
pub fn find_lamps(grid: &HemisphereGrid, radiance: &[[f32; 3]]) -> Vec<Lamp> {
    assert_eq!(
        radiance.len(),
        grid.directions.len(),
        "one radiance per node"
    );
    let weights: Vec<f64> = radiance.iter().map(|&r| weight(r)).collect();
    let total: f64 = weights.iter().sum();
    if total <= 0.0 {
        return Vec::new();
    }
    let height = smoothed(grid, &weights);
    let (hill, tops) = watershed(grid, &height);
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); tops.len()];
    for (node, &h) in hill.iter().enumerate() {
        if h != u32::MAX && weights[node] > 0.0 && height[node] >= FOOT * tops[h as usize] {
            members[h as usize].push(node as u32);
        }
    }
    let highest = tops.iter().copied().fold(0.0, f32::max);
    let (mut lamps, mut specks) = (Vec::new(), Vec::new());
    for (nodes, top) in members.into_iter().zip(tops) {
        let share: f64 = nodes.iter().map(|&n| weights[n as usize]).sum::<f64>() / total;
        if let Some(lamp) = Lamp::new(grid, radiance, nodes) {
            if share >= SPECK && f64::from(top) >= SPECK * f64::from(highest) {
                lamps.push(lamp);
            } else {
                specks.push(lamp);
            }
        }
    }
    let mut joined: Vec<Vec<u32>> = vec![Vec::new(); lamps.len()];
    for speck in specks {
        let beyond =
            |lamp: &Lamp| lamp.direction.angle_between(speck.direction) - lamp.angular_radius;
        let nearest =
            (0..lamps.len()).min_by(|&a, &b| beyond(&lamps[a]).total_cmp(&beyond(&lamps[b])));
        if let Some(nearest) = nearest.filter(|&l| beyond(&lamps[l]) <= REACH) {
            joined[nearest].extend(speck.nodes);
        }
    }
    let mut lamps: Vec<Lamp> = lamps
        .into_iter()
        .zip(joined)
        .filter_map(|(lamp, more)| Lamp::new(grid, radiance, [lamp.nodes, more].concat()))
        .collect();
    lamps.sort_by(|a, b| {
        b.mean_flux()
            .total_cmp(&a.mean_flux())
            .then(a.nodes.cmp(&b.nodes))
    });
    lamps
}

/// The lit nodes that belong to none of `lamps`, as if they were one lamp: faint light all over, and specks. `None` if
/// there are none.
pub fn rest(grid: &HemisphereGrid, radiance: &[[f32; 3]], lamps: &[Lamp]) -> Option<Lamp> {
    let mut taken = vec![false; radiance.len()];
    for &node in lamps.iter().flat_map(|lamp| &lamp.nodes) {
        taken[node as usize] = true;
    }
    let nodes = (0..radiance.len() as u32)
        .filter(|&n| !taken[n as usize] && weight(radiance[n as usize]) > 0.0)
        .collect();
    Lamp::new(grid, radiance, nodes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> HemisphereGrid {
        HemisphereGrid::new(70, Vec3::Y, None, Vec3::ZERO)
    }

    /// Direction at an elevation and azimuth in degrees.
    fn towards(elevation: f32, azimuth: f32) -> Vec3 {
        let (e, a) = (elevation.to_radians(), azimuth.to_radians());
        Vec3::new(e.cos() * a.cos(), e.sin(), e.cos() * a.sin())
    }

    fn add_disc(
        grid: &HemisphereGrid,
        radiance: &mut [[f32; 3]],
        at: Vec3,
        radius_deg: f32,
        value: [f32; 3],
    ) {
        for (node, r) in radiance.iter_mut().enumerate() {
            if grid.directions[node].angle_between(at) <= radius_deg.to_radians() {
                *r = (Vec3::from(*r) + Vec3::from(value)).to_array();
            }
        }
    }

    #[test]
    fn lamps_ten_degrees_apart_are_two_whatever_their_strength() {
        let grid = grid();
        for (ratio, scale) in [(1.0, 1.0), (0.35, 1e-9), (0.1, 1e12)] {
            let mut radiance = vec![[0.0; 3]; grid.directions.len()];
            let (a, b) = (towards(50.0, 20.0), towards(60.0, 20.0));
            add_disc(&grid, &mut radiance, a, 3.0, [scale, scale, 0.5 * scale]);
            add_disc(&grid, &mut radiance, b, 3.0, [ratio * scale; 3]);
            let lamps = find_lamps(&grid, &radiance);
            assert_eq!(lamps.len(), 2, "ratio {ratio}");
            let disc = std::f32::consts::TAU * (1.0 - 3.0_f32.to_radians().cos());
            for (lamp, at, red) in [(&lamps[0], a, scale), (&lamps[1], b, ratio * scale)] {
                let (lamp, at) = if ratio == 1.0 && lamp.direction.angle_between(at) > 0.1 {
                    (if at == a { &lamps[1] } else { &lamps[0] }, at)
                } else {
                    (lamp, at)
                };
                let off = lamp.direction.angle_between(at).to_degrees();
                assert!(off < 0.2, "ratio {ratio}: {off}° off");
                let radius = lamp.angular_radius.to_degrees();
                assert!(
                    (radius - 3.0).abs() < 0.3,
                    "ratio {ratio}: radius {radius}°"
                );
                assert!(
                    (lamp.flux[0] / (red * disc) - 1.0).abs() < 0.15,
                    "flux {:?}",
                    lamp.flux
                );
            }
            assert!(rest(&grid, &radiance, &lamps).is_none());
        }
    }

    #[test]
    fn a_spiky_lamp_is_one() {
        let grid = grid();
        let at = towards(40.0, -70.0);
        for spikes in [2_usize, 3, 4, 6] {
            let mut radiance = vec![[0.0; 3]; grid.directions.len()];
            let side = at.any_orthonormal_vector();
            for k in 0..spikes {
                let turn = std::f32::consts::TAU * k as f32 / spikes as f32;
                let axis = glam::Quat::from_axis_angle(at, turn) * side;
                let spike = glam::Quat::from_axis_angle(axis, 2.1_f32.to_radians()) * at;
                let node = grid.nearest(spike).unwrap();
                radiance[node] = [1.0 + 0.5 * k as f32; 3];
            }
            let lamps = find_lamps(&grid, &radiance);
            assert_eq!(lamps.len(), 1, "{spikes} spikes");
            assert_eq!(lamps[0].nodes.len(), spikes);
        }
    }

    #[test]
    fn a_faint_floor_and_specks_do_not_move_or_widen_a_lamp() {
        let grid = grid();
        let at = towards(35.0, 100.0);
        let mut radiance: Vec<[f32; 3]> = (0..grid.directions.len())
            .map(|i| [1e-4 * (1.0 + (i % 7) as f32); 3])
            .collect();
        add_disc(&grid, &mut radiance, at, 3.0, [1.0; 3]);
        let far = grid.nearest(towards(70.0, -60.0)).unwrap();
        radiance[far] = [0.01; 3];
        let lamps = find_lamps(&grid, &radiance);
        assert_eq!(lamps.len(), 1);
        assert!(lamps[0].direction.angle_between(at).to_degrees() < 0.1);
        assert!((lamps[0].angular_radius.to_degrees() - 3.0).abs() < 0.3);
        let rest = rest(&grid, &radiance, &lamps).unwrap();
        assert!(rest.nodes.contains(&(far as u32)));
        let all: f64 =
            radiance.iter().map(|&r| weight(r)).sum::<f64>() * f64::from(grid.solid_angle);
        let parts = f64::from(lamps[0].mean_flux() + rest.mean_flux());
        assert!((parts / all - 1.0).abs() < 1e-5, "{parts} of {all}");
    }

    #[test]
    fn darkness_and_bad_numbers_have_no_lamps() {
        let grid = HemisphereGrid::new(8, Vec3::Z, None, Vec3::ZERO);
        assert!(find_lamps(&grid, &vec![[0.0; 3]; grid.directions.len()]).is_empty());
        assert!(find_lamps(&grid, &vec![[f32::NAN; 3]; grid.directions.len()]).is_empty());
    }
}
