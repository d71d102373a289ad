//! Distant environments: a lat-long picture, reduced to a bounded number of light nodes that hold all its flux, and the
//! picture itself for what mirrors it.

use std::collections::BinaryHeap;
use std::path::Path;
use std::sync::OnceLock;

use glam::{DVec3, Quat, Vec2, Vec3};

use super::lighting::{LampNodes, LightNode};
use super::lobes::{Lobe, Source, merge};
use super::patches::reach;
use super::sky::Sky;
use rayon::prelude::*;
use rekindle_capture::{CaptureError, read_probe, read_radiance};
use rekindle_scene::hemisphere::{
    HemisphereGrid, SkyPiece, direction_from_lat_long, lat_long_from_direction, lat_long_of,
};

/// Larger pictures are averaged down to this many columns first: finer than any lobe needs.
const MAX_COLUMNS: usize = 1024;
/// Patches whose visibility is judged as a whole.
pub(super) const PATCHES: usize = 96;
/// Nodes of each patch.
const NODES_PER_PATCH: usize = 16;
/// Rows of a picture of lamps.
const ROWS: u32 = 128;
/// What has so many times the mean radiance of all, and reaches no further than [`SUN_REACH`] radians, is a sun: its shadows have
/// edges, and half vectors drawn from a lobe would miss it or meet it.
const SUN_RADIANCE: f32 = 10.0;
const SUN_REACH: f32 = 0.12;
/// Suns with less than this part of the flux aren't told from the rest, nor more than so many.
const SUN_SHARE: f32 = 1e-3;
const MOST_SUNS: usize = 16;
/// Nodes of a sun at most.
const NODES_PER_SUN: usize = 64;

/// Light from all directions far away.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    /// What is small and bright in it, as lamps.
    pub suns: Vec<LampNodes>,
    /// All else in patches of neighbouring nodes, for irradiance.
    pub patches: Vec<LampNodes>,
    /// The same as lobes show it.
    pub sky: Sky,
}

impl Environment {
    /// Whether a lamp is no sun of light of which this is the mean radiance, all channels added: nothing of it has edges.
    pub(super) fn is_sky(lamp: &LampNodes, usual: f32) -> bool {
        let solid_angle: f32 = lamp.nodes.iter().map(|node| node.solid_angle).sum();
        let radiance = lamp.flux().element_sum() / solid_angle;
        radiance < SUN_RADIANCE * usual || reach(lamp) >= SUN_REACH
    }

    /// Distant lamps together.
    pub(super) fn of_lamps(lamps: &[&LampNodes]) -> Self {
        LatLong::of_lamps(lamps).reduced()
    }

    /// All its light as lamps: suns, then patches.
    pub fn lamps(&self) -> impl Iterator<Item = &LampNodes> {
        self.suns.iter().chain(&self.patches)
    }

    /// The same to be changed.
    pub fn lamps_mut(&mut self) -> impl Iterator<Item = &mut LampNodes> {
        self.suns.iter_mut().chain(&mut self.patches)
    }

    /// The same turned further, its radiance times `gain`.
    #[must_use]
    pub fn turned(&self, turn: Quat, gain: Vec3) -> Self {
        let node = |node: &LightNode| LightNode {
            direction: turn * node.direction,
            radiance: gain * node.radiance,
            ..*node
        };
        let lamp = |lamp: &LampNodes| LampNodes::new(lamp.nodes.iter().map(node).collect(), None);
        Self {
            suns: self.suns.iter().filter_map(lamp).collect(),
            patches: self.patches.iter().filter_map(lamp).collect(),
            sky: self.sky.turned(turn, gain),
        }
    }
}

/// A picture of the light from all directions.
#[derive(Clone, Debug)]
pub struct LatLong {
    width: usize,
    height: usize,
    /// Radiance row by row from the top.
    radiance: Vec<Vec3>,
    /// The environment that it is of, made once asked for.
    environment: OnceLock<Environment>,
}

/// A rectangle of pixels with its light.
#[derive(Clone, Debug)]
struct Region {
    rows: [usize; 2],
    columns: [usize; 2],
    /// Flux × squared extent: what is gained by a split.
    gain: f64,
}

impl PartialEq for Region {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Region {}
impl PartialOrd for Region {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Region {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.gain
            .total_cmp(&other.gain)
            .then_with(|| self.rows.cmp(&other.rows))
            .then_with(|| self.columns.cmp(&other.columns))
    }
}

impl LatLong {
    /// Reads an EXR or Radiance HDR picture. The error is a whole sentence that names the file.
    pub fn load(path: &Path) -> Result<Self, String> {
        let (width, height, rgb) = read_radiance(path).map_err(|e| e.to_string())?;
        let radiance: Vec<Vec3> = rgb.iter().map(|&p| Vec3::from(p).max(Vec3::ZERO)).collect();
        let picture = Self::new(width as usize, height as usize, &radiance);
        if picture.radiance.iter().any(|r| *r != Vec3::ZERO) {
            Ok(picture)
        } else {
            Err(format!(
                "{}: the environment is black everywhere; give a picture with light in it",
                path.display()
            ))
        }
    }

    /// Reads the light of a place, of which nothing may be missing: see [`read_probe`].
    pub fn load_probe(path: &Path) -> Result<Self, CaptureError> {
        let (width, height, rgb) = read_probe(path)?;
        let radiance: Vec<Vec3> = rgb.into_iter().map(Vec3::from).collect();
        Ok(Self::new(width as usize, height as usize, &radiance))
    }

    /// A picture of so many rows, twice as wide, of what `radiance` says of a unit direction.
    pub fn of(rows: usize, radiance: impl Fn(Vec3) -> Vec3) -> Self {
        let columns = 2 * rows;
        let place = |i: usize| Vec2::new((i % columns) as f32, (i / columns) as f32) + 0.5;
        let size = Vec2::new(columns as f32, rows as f32);
        let pixel = |i: usize| radiance(direction_from_lat_long(place(i) / size));
        let pixels: Vec<Vec3> = (0..columns * rows).map(pixel).collect();
        Self::new(columns, rows, &pixels)
    }

    /// The picture of some lamps, with all their flux.
    fn of_lamps(lamps: &[&LampNodes]) -> Self {
        let nodes = lamps.iter().flat_map(|lamp| &lamp.nodes);
        let piece = |n: &LightNode| SkyPiece::new(n.direction, n.radiance, n.solid_angle);
        let picture = lat_long_of(&nodes.map(piece).collect::<Vec<_>>(), ROWS);
        let radiance: Vec<Vec3> = picture.radiance.into_iter().map(Vec3::from).collect();
        Self::new(picture.width as usize, picture.height as usize, &radiance)
    }

    fn new(width: usize, height: usize, radiance: &[Vec3]) -> Self {
        let factor = width.div_ceil(MAX_COLUMNS).max(1);
        let (small_width, small_height) = (width.div_ceil(factor), height.div_ceil(factor));
        let mut small = Vec::with_capacity(small_width * small_height);
        for row in 0..small_height {
            for column in 0..small_width {
                let mut sum = DVec3::ZERO;
                let mut count = 0.0;
                for y in row * factor..((row + 1) * factor).min(height) {
                    for x in column * factor..((column + 1) * factor).min(width) {
                        sum += radiance[y * width + x].as_dvec3();
                        count += 1.0;
                    }
                }
                small.push((sum / count).as_vec3());
            }
        }
        Self {
            width: small_width,
            height: small_height,
            radiance: small,
            environment: OnceLock::new(),
        }
    }

    /// Radiance from a unit direction, RGB.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let uv = lat_long_from_direction(direction);
        let column = ((uv.x * self.width as f32) as usize).min(self.width - 1);
        let row = ((uv.y * self.height as f32) as usize).min(self.height - 1);
        self.radiance[row * self.width + column]
    }

    /// Solid angle of a pixel in a row, sr.
    fn solid_angle(&self, row: usize) -> f64 {
        let polar = |r: usize| (std::f64::consts::PI * r as f64 / self.height as f64).cos();
        (polar(row) - polar(row + 1)) * std::f64::consts::TAU / self.width as f64
    }

    fn direction(&self, row: usize, column: usize) -> Vec3 {
        direction_from_lat_long(Vec2::new(
            (column as f32 + 0.5) / self.width as f32,
            (row as f32 + 0.5) / self.height as f32,
        ))
    }

    /// Flux of a row's pixels in a range of columns, all channels added.
    fn row_flux(&self, row: usize, columns: [usize; 2]) -> f64 {
        let pixels = &self.radiance[row * self.width + columns[0]..row * self.width + columns[1]];
        pixels
            .iter()
            .map(|p| f64::from(p.element_sum()))
            .sum::<f64>()
            * self.solid_angle(row)
    }

    fn region(&self, rows: [usize; 2], columns: [usize; 2]) -> Region {
        let flux: f64 = (rows[0]..rows[1]).map(|r| self.row_flux(r, columns)).sum();
        let (tall, wide) = self.extent(rows, columns);
        Region {
            rows,
            columns,
            gain: if rows[1] - rows[0] == 1 && columns[1] - columns[0] == 1 {
                0.0
            } else {
                flux * (tall * tall + wide * wide)
            },
        }
    }

    /// Angular height and width of a region, radians.
    fn extent(&self, rows: [usize; 2], columns: [usize; 2]) -> (f64, f64) {
        let pi = std::f64::consts::PI;
        let middle = pi * (rows[0] + rows[1]) as f64 / (2 * self.height) as f64;
        (
            pi * (rows[1] - rows[0]) as f64 / self.height as f64,
            2.0 * pi * (columns[1] - columns[0]) as f64 / self.width as f64 * middle.sin(),
        )
    }

    /// Splits a region across its longer side where half its flux lies on either side.
    fn split(&self, region: &Region) -> [Region; 2] {
        let (tall, wide) = self.extent(region.rows, region.columns);
        let across_rows = region.columns[1] - region.columns[0] == 1
            || (tall >= wide && region.rows[1] - region.rows[0] > 1);
        let fluxes: Vec<f64> = if across_rows {
            (region.rows[0]..region.rows[1])
                .map(|r| self.row_flux(r, region.columns))
                .collect()
        } else {
            (region.columns[0]..region.columns[1])
                .map(|c| {
                    (region.rows[0]..region.rows[1])
                        .map(|r| self.row_flux(r, [c, c + 1]))
                        .sum()
                })
                .collect()
        };
        let half = 0.5 * fluxes.iter().sum::<f64>();
        let mut sum = 0.0;
        let before = fluxes
            .iter()
            .take_while(|&&f| {
                sum += f;
                sum < half
            })
            .count();
        let at = before.clamp(1, fluxes.len() - 1);
        if across_rows {
            let cut = region.rows[0] + at;
            [
                self.region([region.rows[0], cut], region.columns),
                self.region([cut, region.rows[1]], region.columns),
            ]
        } else {
            let cut = region.columns[0] + at;
            [
                self.region(region.rows, [region.columns[0], cut]),
                self.region(region.rows, [cut, region.columns[1]]),
            ]
        }
    }

    /// Splits where it gains most until there are `count` regions.
    fn cut(&self, root: Region, count: usize) -> Vec<Region> {
        let mut heap = BinaryHeap::from([root]);
        while heap.len() < count {
            match heap.pop() {
                Some(region) if region.gain > 0.0 => heap.extend(self.split(&region)),
                Some(region) => {
                    heap.push(region);
                    break;
                }
                None => break,
            }
        }
        heap.into_sorted_vec()
    }

    fn node(&self, region: &Region) -> Option<LightNode> {
        let (mut flux, mut moment, mut solid_angle) = (DVec3::ZERO, DVec3::ZERO, 0.0);
        for row in region.rows[0]..region.rows[1] {
            let pixel_solid_angle = self.solid_angle(row);
            for column in region.columns[0]..region.columns[1] {
                let pixel = self.radiance[row * self.width + column].as_dvec3() * pixel_solid_angle;
                flux += pixel;
                moment += self.direction(row, column).as_dvec3() * pixel.element_sum();
                solid_angle += pixel_solid_angle;
            }
        }
        let direction = moment.as_vec3().try_normalize()?;
        Some(LightNode {
            direction,
            radiance: (flux / solid_angle).as_vec3(),
            solid_angle: solid_angle as f32,
        })
    }

    /// Its columns and rows.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Radiance of each of its pixels, row by row from the top.
    pub fn pixels(&self) -> &[Vec3] {
        &self.radiance
    }

    /// Part of its flux that comes from directions whose cosine to `up` is below zero once it is turned, all channels together.
    pub fn share_below(&self, turn: Quat, up: Vec3) -> f32 {
        let (mut below, mut all) = (0.0, 0.0);
        for row in 0..self.height {
            let angle = self.solid_angle(row);
            for column in 0..self.width {
                let pixel = self.radiance[row * self.width + column];
                let flux = angle * f64::from(pixel.element_sum());
                all += flux;
                if (turn * self.direction(row, column)).dot(up) < 0.0 {
                    below += flux;
                }
            }
        }
        (below / all.max(f64::MIN_POSITIVE)) as f32
    }

    /// Radiance of every node of a grid under it, RGB, turned by `turn`. All flux from where there are nodes goes to the nearest.
    pub fn on_nodes(&self, grid: &HemisphereGrid, turn: Quat) -> Vec<[f32; 3]> {
        // Pixels larger than half the distance of nodes are cut.
        let pixel = std::f32::consts::PI / self.height as f32;
        let cuts = (2.0 * pixel / grid.spacing()).ceil().max(1.0) as usize;
        let (rows, columns) = (self.height * cuts, self.width * cuts);
        let angle = |row: usize| {
            let polar = |r: usize| (std::f64::consts::PI * r as f64 / rows as f64).cos();
            (polar(row) - polar(row + 1)) * std::f64::consts::TAU / columns as f64
        };
        let of_row = |row: usize| -> Vec<Option<u32>> {
            let nearest = |column: usize| {
                let at = Vec2::new(
                    (column as f32 + 0.5) / columns as f32,
                    (row as f32 + 0.5) / rows as f32,
                );
                let node = grid.nearest(turn * direction_from_lat_long(at))?;
                Some(node as u32)
            };
            (0..columns).map(nearest).collect()
        };
        let nearest: Vec<Vec<Option<u32>>> = (0..rows).into_par_iter().map(of_row).collect();
        let mut flux = vec![DVec3::ZERO; grid.directions.len()];
        for (row, nearest) in nearest.iter().enumerate() {
            let angle = angle(row);
            for (column, node) in nearest.iter().enumerate() {
                let pixel = self.radiance[row / cuts * self.width + column / cuts];
                if let Some(node) = node {
                    flux[*node as usize] += angle * pixel.as_dvec3();
                }
            }
        }
        let unit = 1.0 / f64::from(grid.solid_angle);
        flux.into_iter()
            .map(|f| (unit * f).as_vec3().to_array())
            .collect()
    }

    /// Radiance over all directions, RGB × steradians.
    pub fn flux(&self) -> Vec3 {
        let rows = self.radiance.chunks(self.width).enumerate();
        let of_row = |(row, pixels): (usize, &[Vec3])| {
            pixels.iter().map(|p| p.as_dvec3()).sum::<DVec3>() * self.solid_angle(row)
        };
        rows.map(of_row).sum::<DVec3>().as_vec3()
    }

    /// The environment that it is of, turned by `turn`, its radiance times `gain`; none where that is dark.
    pub fn environment(&self, turn: Quat, gain: Vec3) -> Option<Environment> {
        if gain == Vec3::ZERO {
            return None;
        }
        let as_it_is = self.environment.get_or_init(|| self.reduced());
        Some(as_it_is.turned(turn, gain))
    }

    fn reduced(&self) -> Environment {
        let mut soft = Self {
            radiance: self.radiance.clone(),
            environment: OnceLock::new(),
            ..*self
        };
        let suns: Vec<LampNodes> = (self.bright_spots().iter())
            .filter_map(|spot| {
                let sun = self.sun(spot)?;
                for &pixel in spot {
                    soft.radiance[pixel] = Vec3::ZERO;
                }
                Some(sun)
            })
            .collect();
        let patch = |region| {
            let nodes = soft.cut(region, NODES_PER_PATCH);
            LampNodes::new(nodes.iter().filter_map(|n| soft.node(n)).collect(), None)
        };
        let whole = soft.region([0, self.height], [0, self.width]);
        Environment {
            suns,
            patches: (soft.cut(whole, PATCHES).into_iter())
                .filter_map(patch)
                .collect(),
            sky: soft.sky(),
        }
    }

    /// Pixels beside each other that are far brighter than the mean: the spots of the most flux first, of those with enough.
    fn bright_spots(&self) -> Vec<Vec<usize>> {
        let total = self.flux().element_sum();
        let bright = SUN_RADIANCE * total / (4.0 * std::f32::consts::PI);
        let mut is_left: Vec<bool> = (self.radiance.iter())
            .map(|radiance| radiance.element_sum() > bright)
            .collect();
        let mut spots: Vec<(f64, Vec<usize>)> = Vec::new();
        for first in 0..is_left.len() {
            if !std::mem::take(&mut is_left[first]) {
                continue;
            }
            let mut spot = vec![first];
            let mut seen = 0;
            while let Some(&pixel) = spot.get(seen) {
                seen += 1;
                for near in self.around(pixel) {
                    if std::mem::take(&mut is_left[near]) {
                        spot.push(near);
                    }
                }
            }
            let flux = spot.iter().map(|&pixel| {
                let [row, column] = [pixel / self.width, pixel % self.width];
                self.row_flux(row, [column, column + 1])
            });
            spots.push((flux.sum(), spot));
        }
        spots.retain(|(flux, _)| *flux >= f64::from(SUN_SHARE * total));
        spots.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
        spots.truncate(MOST_SUNS);
        spots.into_iter().map(|(_, spot)| spot).collect()
    }

    /// The pixels that touch one.
    fn around(&self, pixel: usize) -> impl Iterator<Item = usize> + use<> {
        let (width, height) = (self.width, self.height);
        let [row, column] = [pixel / width, pixel % width];
        let rows = row.saturating_sub(1)..(row + 2).min(height);
        rows.flat_map(move |row| {
            let columns = [column + width - 1, column, column + 1];
            columns.map(|column| row * width + column % width)
        })
    }

    /// A lamp of these pixels, unless they reach too far.
    fn sun(&self, pixels: &[usize]) -> Option<LampNodes> {
        let source = |&pixel: &usize| {
            let [row, column] = [pixel / self.width, pixel % self.width];
            Source {
                direction: self.direction(row, column),
                flux: self.radiance[pixel] * self.solid_angle(row) as f32,
                group: 0,
            }
        };
        let angles = pixels.iter().map(|p| self.solid_angle(p / self.width));
        let all: f64 = angles.sum();
        let merged = merge(pixels.iter().map(source).collect(), 0.0, NODES_PER_SUN);
        let solid_angle = all as f32 / merged.len() as f32;
        let node = |lobe: &Lobe| LightNode {
            direction: lobe.direction,
            radiance: lobe.flux / solid_angle,
            solid_angle,
        };
        let sun = LampNodes::new(merged.iter().map(node).collect(), None)?;
        (reach(&sun) < SUN_REACH).then_some(sun)
    }

    /// What it shows as a sky.
    fn sky(&self) -> Sky {
        let rows = Sky::rows(self.height);
        // Of a pixel of the sky those pixels of the picture that lie in it, at least the nearest.
        let around = |middle: f32, size: usize, parts: usize| {
            let half = 0.5 / parts as f32;
            let first = ((middle - half) * size as f32).round().max(0.0) as usize;
            let end = ((middle + half) * size as f32).round() as usize;
            let nearest = ((middle * size as f32) as usize).min(size - 1);
            if first < end.min(size) {
                first..end.min(size)
            } else {
                nearest..nearest + 1
            }
        };
        Sky::new(rows, |direction| {
            let uv = lat_long_from_direction(direction);
            let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
            for row in around(uv.y, self.height, rows) {
                let weight = self.solid_angle(row);
                for column in around(uv.x, self.width, 2 * rows) {
                    sum += weight * self.radiance[row * self.width + column].as_dvec3();
                    weights += weight;
                }
            }
            (sum / weights).as_vec3()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(f: impl Fn(Vec3) -> Vec3) -> LatLong {
        LatLong::of(64, f)
    }

    #[test]
    fn patches_hold_all_flux_on_the_whole_sphere() {
        let uniform = picture(|_| Vec3::new(1.0, 2.0, 3.0));
        let environment = uniform
            .environment(Quat::IDENTITY, Vec3::splat(0.5))
            .unwrap();
        assert!(environment.suns.is_empty());
        let patches = &environment.patches;
        let flux: Vec3 = patches.iter().map(LampNodes::flux).sum();
        let sphere = 4.0 * std::f32::consts::PI;
        let expected = Vec3::new(0.5, 1.0, 1.5) * sphere;
        assert!(
            (flux - expected).length() < 1e-3 * expected.length(),
            "{flux}"
        );
        let nodes: usize = patches.iter().map(|p| p.nodes.len()).sum();
        assert!(nodes <= PATCHES * NODES_PER_PATCH, "{nodes} nodes");
        // Uniform light has no preferred direction.
        let moment: Vec3 = patches
            .iter()
            .flat_map(|p| &p.nodes)
            .map(|n| n.direction * n.flux().x)
            .sum();
        assert!(moment.length() < 0.02 * flux.x, "{moment}");
    }

    #[test]
    fn lamps_together_are_an_environment_of_as_much_light_in_the_same_place() {
        let (radius, flux) = (1.4_f32, Vec3::new(3.0, 2.0, 1.0));
        let lamp = LampNodes::disc_of(9000, Vec3::Y, flux, radius, None);
        // Another one over its rim.
        let inner = LampNodes::disc_of(300, Vec3::X, 0.02 * flux, 0.3, None);
        let environment = Environment::of_lamps(&[&lamp, &inner]);
        let found: Vec3 = environment.lamps().map(LampNodes::flux).sum();
        let both = 1.02 * flux;
        assert!((found - both).length() < 1e-3 * both.length(), "{found}");
        let towards = |lamp: &LampNodes| -> Vec3 {
            let moments = lamp.nodes.iter().map(|n| n.direction * n.flux().x);
            moments.sum()
        };
        let moment: Vec3 = environment.patches.iter().map(towards).sum();
        let lost = moment.distance(towards(&lamp) + towards(&inner));
        assert!(lost < 0.01 * flux.x, "{lost}");
        let even = flux.x / (std::f32::consts::TAU * (1.0 - radius.cos()));
        let shown = |polar: f32| {
            let direction = Vec3::new(-polar.sin(), polar.cos(), 0.0);
            environment.sky.radiance(direction, 0.02).x / even
        };
        for polar in [0.0, 0.4, 0.8, 1.2] {
            assert!((shown(polar) - 1.0).abs() < 0.05, "{}", shown(polar));
        }
        assert!(shown(1.6) < 0.01 && shown(3.0) == 0.0);
    }

    #[test]
    fn nodes_hold_the_flux_of_pixels_of_any_size_where_the_turn_puts_it() {
        let sun = Vec3::new(0.6, 0.64, 0.48);
        let sky = picture(|d| Vec3::splat(if d.dot(sun) > 0.99 { 50.0 } else { 1.0 }));
        let turn = Quat::from_rotation_y(0.7);
        for frequency in [8, 40] {
            let above = HemisphereGrid::new(frequency, Vec3::Y, None, Vec3::ZERO);
            let grid = above.to_whole();
            let nodes = sky.on_nodes(&grid, turn);
            let flux: Vec3 = nodes.iter().map(|&r| Vec3::from(r)).sum::<Vec3>() * grid.solid_angle;
            assert!(
                (flux / sky.flux() - 1.0).abs().max_element() < 1e-4,
                "{flux}"
            );
            let brightest = (0..nodes.len()).max_by(|&a, &b| nodes[a][0].total_cmp(&nodes[b][0]));
            let shown = grid.directions[brightest.unwrap()];
            let off = shown.angle_between(turn * sun);
            assert!(off < 0.15 + grid.spacing(), "off by {off}");
            // What has no node near it is left out.
            let half: f32 = sky.on_nodes(&above, turn).iter().map(|r| r[0]).sum();
            let share = half * above.solid_angle / flux.x;
            let below = sky.share_below(turn, Vec3::Y);
            assert!(
                (share - (1.0 - below)).abs() < 0.1,
                "{share} above, {below} below"
            );
        }
    }

    #[test]
    fn a_small_sun_stays_small_and_turns_with_the_picture() {
        let sun = Vec3::new(0.6, 0.64, 0.48);
        let sky = picture(|d| Vec3::splat(if d.dot(sun) > 0.995 { 1000.0 } else { 1.0 }));
        let turn = Quat::from_rotation_y(1.0);
        let environment = sky.environment(turn, Vec3::ONE).unwrap();
        let bright = |lamp: &LampNodes| lamp.flux().x;
        let by_flux = |a: &&LampNodes, b: &&LampNodes| bright(a).total_cmp(&bright(b));
        let brightest = environment.suns.iter().max_by(by_flux).unwrap();
        assert!(brightest.direction.angle_between(turn * sun) < 0.1);
        // What lobes show as the sky is without it, and with all else.
        let behind = environment.sky.radiance(turn * sun, 0.0);
        assert!(behind.x < 1.0, "{behind}");
        let elsewhere = environment.sky.radiance(turn * -sun, 0.3);
        assert!((elsewhere - 1.0).abs().max_element() < 1e-3, "{elsewhere}");
        let flux: Vec3 = environment.lamps().map(LampNodes::flux).sum();
        assert!((flux / sky.flux() - 1.0).abs().max_element() < 1e-4);
        assert_eq!(sky.radiance(sun), Vec3::splat(1000.0));
        assert_eq!(sky.radiance(-sun), Vec3::ONE);
    }
}
