//! Lat-long maps of the lighting, for other programs.
//!
//! A map shows pieces of the sky, each a small part of the sphere that shines uniformly. A sample of the map belongs to the
//! piece nearest to it, and a piece's radiance is scaled so that its samples hold exactly its flux L ω: the sum of
//! radiance × solid angle over all pixels is that of the pieces, whatever the map's size.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::grid::HemisphereGrid;
use super::picture::Picture;

/// Samples along each side of a pixel.
const SAMPLES: usize = 4;
/// A piece reaches this many radii of the cap of its solid angle: as far as the corners of a hexagon of that area, and some.
const REACH: f32 = 1.2;

/// Where a lat-long map shows a direction: u from 0 at the left to 1 at the right, v from 0 at the top to 1 at the bottom.
///
/// u = 1/2 + atan2(z, x) / 2π, v = acos(y) / π: the top row is +Y, the middle of the image +X, three quarters to the right
/// +Z, and the world is seen from inside, not mirrored. It is what Blender's Environment Texture shows in the direction
/// in which it places the object when a +Y-up OBJ or glTF is imported with the default axes, (x, y, z) to (x, −z, y): there
/// u = 1/2 − atan2(y, x) / 2π with z up.
pub fn lat_long_from_direction(direction: Vec3) -> Vec2 {
    let d = direction.normalize_or_zero();
    Vec2::new(0.5 + d.z.atan2(d.x) / TAU, d.y.clamp(-1.0, 1.0).acos() / PI)
}

/// The unit direction that a lat-long map shows at `uv`: the inverse of [`lat_long_from_direction`].
pub fn direction_from_lat_long(uv: Vec2) -> Vec3 {
    let (turn, fall) = ((uv.x - 0.5) * TAU, uv.y * PI);
    Vec3::new(fall.sin() * turn.cos(), fall.cos(), fall.sin() * turn.sin())
}

/// A small part of the sphere that shines uniformly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkyPiece {
    /// Its middle, unit.
    pub direction: Vec3,
    /// Radiance, RGB.
    pub radiance: Vec3,
    /// Solid angle, sr.
    pub solid_angle: f32,
    /// Angle from its middle beyond which it shows nothing, radians. Within, it ends half way to its neighbours.
    pub reach: f32,
}

impl SkyPiece {
    /// A piece as round as a cell of the hemisphere.
    pub fn new(direction: Vec3, radiance: Vec3, solid_angle: f32) -> Self {
        // The cap of solid angle ω = 2π (1 − cos r).
        let cap = (1.0 - (solid_angle / TAU).min(2.0)).acos();
        Self {
            direction,
            radiance,
            solid_angle,
            reach: REACH * cap,
        }
    }
}

/// The lighting on the nodes of a hemisphere as a lat-long map of `2 height × height` pixels; `radiance` is RGB, one per node.
pub fn lat_long(grid: &HemisphereGrid, radiance: &[[f32; 3]], height: u32) -> Picture {
    assert_eq!(
        radiance.len(),
        grid.directions.len(),
        "one radiance per node"
    );
    let lit = grid.directions.iter().zip(radiance);
    let pieces: Vec<SkyPiece> = lit
        .filter(|(_, r)| **r != [0.0; 3])
        .map(|(&direction, &r)| SkyPiece::new(direction, r.into(), grid.solid_angle))
        .collect();
    lat_long_of(&pieces, height)
}

/// Pieces of the sky as a lat-long map (see [`lat_long_from_direction`]) of `2 height × height` pixels, black where none is.
pub fn lat_long_of(pieces: &[SkyPiece], height: u32) -> Picture {
    let size = Size::new(height);
    let mut near = vec![Vec::new(); size.height];
    for (i, piece) in pieces.iter().enumerate() {
        for row in size.rows_near(piece) {
            near[row].push(i as u32);
        }
    }
    let rows: Vec<Vec<Share>> = near
        .par_iter()
        .enumerate()
        .map(|(row, near)| size.shares(row, pieces, near))
        .collect();
    // Solid angle of each piece's samples, by the rows in their order.
    let mut filled = vec![0.0_f64; pieces.len()];
    for share in rows.iter().flatten() {
        filled[share.piece as usize] += share.solid_angle;
    }
    let mut flux: Vec<DVec3> = Vec::new();
    let mut radiance = Vec::with_capacity(size.width * size.height);
    for (row, shares) in rows.iter().enumerate() {
        flux.clear();
        flux.resize(size.width, DVec3::ZERO);
        for share in shares {
            let piece = &pieces[share.piece as usize];
            let part = share.solid_angle / filled[share.piece as usize];
            flux[share.column as usize] +=
                piece.radiance.as_dvec3() * (f64::from(piece.solid_angle) * part);
        }
        let angle = size.pixel_angle(row);
        radiance.extend(flux.iter().map(|&f| (f / angle).as_vec3().to_array()));
    }
    // In a small map a piece may fall between the samples: its flux goes to the pixel that holds it.
    for (piece, _) in pieces.iter().zip(&filled).filter(|(_, f)| **f == 0.0) {
        let uv = lat_long_from_direction(piece.direction);
        let column = ((uv.x * size.width as f32) as usize).min(size.width - 1);
        let row = ((uv.y * size.height as f32) as usize).min(size.height - 1);
        let share = f64::from(piece.solid_angle) / size.pixel_angle(row);
        let pixel = &mut radiance[row * size.width + column];
        *pixel = (Vec3::from(*pixel) + piece.radiance * share as f32).to_array();
    }
    Picture {
        width: size.width as u32,
        height: size.height as u32,
        radiance,
    }
}

/// Samples of one pixel that belong to one piece.
struct Share {
    column: u32,
    piece: u32,
    /// Solid angle of the samples, sr.
    solid_angle: f64,
}

/// A map's size with the directions of its samples.
struct Size {
    width: usize,
    height: usize,
    /// Cosine and sine of the turn of each column of samples.
    turns: Vec<[f32; 2]>,
}

impl Size {
    fn new(height: u32) -> Self {
        let height = height.max(2) as usize;
        let columns = 2 * height * SAMPLES;
        let turn = |c: usize| ((c as f32 + 0.5) / columns as f32 - 0.5) * TAU;
        Self {
            width: 2 * height,
            height,
            turns: (0..columns)
                .map(|c| [turn(c).cos(), turn(c).sin()])
                .collect(),
        }
    }

    /// Solid angle of a row of samples between these edges, counted in rows of samples, sr.
    fn band_angle(&self, edges: [usize; 2]) -> f64 {
        let rows = (self.height * SAMPLES) as f64;
        let [top, bottom] = edges.map(|e| (std::f64::consts::PI * e as f64 / rows).cos());
        (top - bottom) * std::f64::consts::TAU
    }

    fn pixel_angle(&self, row: usize) -> f64 {
        self.band_angle([row * SAMPLES, (row + 1) * SAMPLES]) / self.width as f64
    }

    /// Rows of pixels that a piece may reach.
    fn rows_near(&self, piece: &SkyPiece) -> std::ops::RangeInclusive<usize> {
        let fall = piece.direction.y.clamp(-1.0, 1.0).acos();
        let row = |angle: f32| ((angle / PI * self.height as f32) as usize).min(self.height - 1);
        row((fall - piece.reach).max(0.0))..=row(fall + piece.reach)
    }

    /// Columns of samples that a piece may reach at the angle `fall` from the top: the first, and how many.
    fn columns_near(&self, piece: &SkyPiece, fall: f32) -> (usize, usize) {
        let columns = self.turns.len();
        // At the same height two directions apart by the turn t are apart by the angle a of
        // cos a = cos f₁ cos f₂ + sin f₁ sin f₂ cos t.
        let sines = (1.0 - piece.direction.y * piece.direction.y)
            .max(0.0)
            .sqrt()
            * fall.sin();
        let cos_turn =
            (piece.reach.min(PI).cos() - piece.direction.y * fall.cos()) / sines.max(1e-9);
        if cos_turn <= -1.0 || piece.reach >= FRAC_PI_2 {
            return (0, columns);
        }
        let turn = cos_turn.min(1.0).acos();
        let middle = lat_long_from_direction(piece.direction).x * columns as f32;
        let half = turn / TAU * columns as f32 + 1.0;
        let first = (middle - half).floor() as i64;
        let count = ((2.0 * half) as usize + 2).min(columns);
        (first.rem_euclid(columns as i64) as usize, count)
    }

    /// What the pieces `near` a row of pixels have of its samples.
    fn shares(&self, row: usize, pieces: &[SkyPiece], near: &[u32]) -> Vec<Share> {
        if near.is_empty() {
            return Vec::new();
        }
        let columns = self.turns.len();
        let mut owned: Vec<(u32, u32, f64)> = Vec::new();
        let mut nearest: Vec<(f32, u32)> = Vec::new();
        for line in row * SAMPLES..(row + 1) * SAMPLES {
            let fall = (line as f32 + 0.5) / (self.height * SAMPLES) as f32 * PI;
            nearest.clear();
            nearest.resize(columns, (f32::NEG_INFINITY, u32::MAX));
            for &index in near {
                let piece = &pieces[index as usize];
                let (least, d) = (piece.reach.min(PI).cos(), piece.direction);
                let (first, count) = self.columns_near(piece, fall);
                for step in 0..count {
                    let column = (first + step) % columns;
                    let [cos, sin] = self.turns[column];
                    let closeness = d.y * fall.cos() + fall.sin() * (d.x * cos + d.z * sin);
                    if closeness >= least && closeness > nearest[column].0 {
                        nearest[column] = (closeness, index);
                    }
                }
            }
            let angle = self.band_angle([line, line + 1]) / columns as f64;
            for (column, &(_, index)) in nearest.iter().enumerate() {
                if index != u32::MAX {
                    owned.push(((column / SAMPLES) as u32, index, angle));
                }
            }
        }
        owned.sort_by_key(|&(column, piece, _)| (column, piece));
        let mut shares: Vec<Share> = Vec::new();
        for (column, piece, solid_angle) in owned {
            match shares.last_mut() {
                Some(last) if (last.column, last.piece) == (column, piece) => {
                    last.solid_angle += solid_angle;
                }
                _ => shares.push(Share {
                    column,
                    piece,
                    solid_angle,
                }),
            }
        }
        shares
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flux(picture: &Picture) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for (i, &pixel) in picture.radiance.iter().enumerate() {
            let row = f64::from(i as u32 / picture.width);
            let edge = |r: f64| (std::f64::consts::PI * r / f64::from(picture.height)).cos();
            let angle =
                (edge(row) - edge(row + 1.0)) * std::f64::consts::TAU / f64::from(picture.width);
            sum += angle * Vec3::from(pixel).as_dvec3();
        }
        sum
    }

    #[test]
    fn a_lat_long_map_holds_the_flux_whatever_its_size_and_up() {
        for up in [Vec3::Y, Vec3::Z, Vec3::new(1.0, -0.5, 0.2)] {
            let grid = HemisphereGrid::new(30, up, None, Vec3::ZERO);
            let radiance: Vec<[f32; 3]> = (0..grid.directions.len())
                .map(|i| {
                    if i % 13 == 0 {
                        [i as f32, 1.0, 1000.0 - (i % 1000) as f32]
                    } else {
                        [0.0; 3]
                    }
                })
                .collect();
            let expected = f64::from(grid.solid_angle)
                * radiance
                    .iter()
                    .map(|&r| Vec3::from(r).as_dvec3())
                    .sum::<DVec3>();
            for height in [4, 16, 64, 256] {
                let error = flux(&lat_long(&grid, &radiance, height)) / expected - 1.0;
                assert!(
                    error.abs().max_element() < 1e-4,
                    "up {up}, height {height}: {error}"
                );
            }
        }
    }

    #[test]
    fn lat_long_directions_are_blenders() {
        for (direction, u, v) in [
            (Vec3::X, 0.5, 0.5),
            (Vec3::Z, 0.75, 0.5),
            (Vec3::NEG_Z, 0.25, 0.5),
        ] {
            let uv = lat_long_from_direction(direction);
            assert!(uv.distance(Vec2::new(u, v)) < 1e-6, "{direction} at {uv}");
        }
        assert!(lat_long_from_direction(Vec3::Y).y.abs() < 1e-6);
        for uv in [
            Vec2::new(0.1, 0.2),
            Vec2::new(0.6, 0.9),
            Vec2::new(0.99, 0.5),
        ] {
            assert!(lat_long_from_direction(direction_from_lat_long(uv)).distance(uv) < 1e-6);
        }
        // A lamp shows where its direction maps to.
        let grid = HemisphereGrid::new(40, Vec3::Y, None, Vec3::ZERO);
        let at = Vec3::new(0.3, 0.5, -0.6).normalize_or_zero();
        let mut radiance = vec![[0.0; 3]; grid.directions.len()];
        radiance[grid.nearest(at).unwrap()] = [1.0; 3];
        let picture = lat_long(&grid, &radiance, 128);
        let brightest = (0..picture.radiance.len())
            .max_by(|&a, &b| picture.radiance[a][0].total_cmp(&picture.radiance[b][0]))
            .unwrap();
        let centre = Vec2::new(
            (brightest % 256) as f32 + 0.5,
            (brightest / 256) as f32 + 0.5,
        );
        let shown = direction_from_lat_long(centre / Vec2::new(256.0, 128.0));
        assert!(
            shown.angle_between(at).to_degrees() < 3.0,
            "shown at {shown}"
        );
    }

    #[test]
    fn a_lamp_smaller_than_a_pixel_keeps_its_flux_and_place() {
        let direction = Vec3::new(-0.2, 0.4, 0.7).normalize_or_zero();
        let piece = SkyPiece::new(direction, Vec3::new(1e6, 2e6, 3e6), 1e-6);
        for height in [16, 128, 500] {
            let picture = lat_long_of(&[piece], height);
            let error = flux(&picture) / DVec3::new(1.0, 2.0, 3.0) - 1.0;
            assert!(error.abs().max_element() < 1e-5, "height {height}: {error}");
            let uv = lat_long_from_direction(direction);
            let (x, y) = (uv.x * picture.width as f32, uv.y * height as f32);
            let pixel = y as usize * picture.width as usize + x as usize;
            assert!(picture.radiance[pixel][0] > 0.0, "not at its place");
        }
    }

    #[test]
    fn light_from_everywhere_fills_the_map_evenly() {
        let grid = HemisphereGrid::new(20, Vec3::Y, None, Vec3::ZERO);
        let above = grid.directions.iter().copied();
        // The rim is in both halves.
        let below = grid.directions.iter().filter(|d| d.y > 1e-4).map(|d| -*d);
        let pieces: Vec<SkyPiece> = above
            .chain(below)
            .map(|d| SkyPiece::new(d, Vec3::ONE, grid.solid_angle))
            .collect();
        let picture = lat_long_of(&pieces, 64);
        // The cells' areas differ by a third.
        for pixel in &picture.radiance {
            assert!((0.7..1.6).contains(&pixel[0]), "{pixel:?}");
        }
    }
}
