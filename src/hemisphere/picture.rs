//! Pictures of the lighting: the hemisphere seen from straight above (as in the paper's figures 4 and 5), and lat-long
//! environment maps for other programs.

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};

use super::grid::HemisphereGrid;

/// Samples along each side of a pixel.
const SAMPLES: u32 = 4;

/// How radiances become grey levels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposure {
    /// In proportion, sRGB-encoded; this radiance becomes white.
    Linear {
        /// Radiance of white.
        white: f32,
    },
    /// By the logarithm of the brightest channel: the brightest pixel is white, and what is so many powers of ten darker
    /// is black. The hue is kept.
    Log {
        /// Powers of ten from black to white.
        decades: f32,
    },
}

/// An image of linear radiance, RGB, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// One radiance per pixel.
    pub radiance: Vec<[f32; 3]>,
}

impl Picture {
    /// The picture as 8-bit RGB.
    pub fn to_rgb8(&self, exposure: Exposure) -> Vec<[u8; 3]> {
        let brightest = self.radiance.iter().flatten().copied().fold(0.0, f32::max);
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        self.radiance
            .iter()
            .map(|&pixel| match exposure {
                Exposure::Linear { white } => {
                    pixel.map(|c| byte(srgb(if white > 0.0 { c / white } else { 0.0 })))
                }
                Exposure::Log { decades } => {
                    let top = pixel.into_iter().fold(0.0, f32::max);
                    if top <= 0.0 {
                        return [0; 3];
                    }
                    let level = 1.0 + (top / brightest).log10() / decades.max(1e-3);
                    pixel.map(|c| byte(level.max(0.0) * srgb(c / top)))
                }
            })
            .collect()
    }
}

/// The sRGB transfer function, of a linear value up to 1; 0 below 0.
pub fn srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear.max(0.0)
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

/// Unit directions to the right and to the top (north) of pictures from above: see [`FromAbove::new`].
pub fn from_above_axes(up: Vec3) -> [Vec3; 2] {
    let axis = if up.x.abs() > 0.9 { Vec3::Z } else { Vec3::X };
    let right = (axis - axis.dot(up) * up).normalize_or_zero();
    [right, up.cross(right)]
}

/// Pictures of a hemisphere seen from straight above: which nodes each pixel shows.
pub struct FromAbove {
    side: u32,
    /// Nodes of each pixel's samples; `None` outside the horizon.
    nodes: Vec<[Option<u32>; (SAMPLES * SAMPLES) as usize]>,
}

impl FromAbove {
    /// Pictures `side` pixels square, the horizon their inscribed circle (orthographic), black outside. With up = +Y, +X is
    /// on the right and −Z (north) at the top; with up = +Z, +X and +Y: right is the world's X axis laid into the
    /// horizon (or its Z axis where up is X), and the top is up × right.
    pub fn new(grid: &HemisphereGrid, side: u32) -> Self {
        let [right, north] = from_above_axes(grid.up);
        let fine = (side * SAMPLES) as f32;
        let nodes = (0..side * side)
            .into_par_iter()
            .map(|pixel| {
                std::array::from_fn(|sample| {
                    let sample = sample as u32;
                    let column = (pixel % side) * SAMPLES + sample % SAMPLES;
                    let row = (pixel / side) * SAMPLES + sample / SAMPLES;
                    let x = 2.0 * (column as f32 + 0.5) / fine - 1.0;
                    let y = 1.0 - 2.0 * (row as f32 + 0.5) / fine;
                    let squared = x * x + y * y;
                    let direction =
                        x * right + y * north + (1.0 - squared).max(0.0).sqrt() * grid.up;
                    let node = (squared <= 1.0).then(|| grid.nearest(direction))?;
                    node.map(|node| node as u32)
                })
            })
            .collect();
        Self { side, nodes }
    }

    /// The picture of these radiances, one per node of the grid.
    pub fn picture(&self, radiance: &[[f32; 3]]) -> Picture {
        let pixel = |nodes: &[Option<u32>]| {
            let lit = nodes.iter().flatten();
            let sum: Vec3 = lit.map(|&node| Vec3::from(radiance[node as usize])).sum();
            (sum / nodes.len() as f32).to_array()
        };
        Picture {
            width: self.side,
            height: self.side,
            radiance: self.nodes.par_iter().map(|nodes| pixel(nodes)).collect(),
        }
    }
}

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

/// The lighting as a lat-long map (see [`lat_long_from_direction`]) of `2 height × height` pixels.
///
/// Every node's light fills the directions to which it is the nearest, and each node's radiance is scaled so that it fills
/// them with exactly its flux L ω: Σ L dω over the pixels is Σ L ω over the nodes. Below the horizon it is black.
pub fn lat_long(grid: &HemisphereGrid, radiance: &[[f32; 3]], height: u32) -> Picture {
    assert_eq!(
        radiance.len(),
        grid.directions.len(),
        "one radiance per node"
    );
    let height = height.max(2);
    let width = 2 * height;
    let (columns, rows) = (width * SAMPLES, height * SAMPLES);
    let candidates = pixels_near_light(grid, radiance, [width, height]);
    // The nearest node of each of their samples.
    let owners: Vec<[Option<u32>; (SAMPLES * SAMPLES) as usize]> = candidates
        .par_iter()
        .map(|&pixel| {
            std::array::from_fn(|sample| {
                let sample = sample as u32;
                let column = (pixel % width) * SAMPLES + sample % SAMPLES;
                let row = (pixel / width) * SAMPLES + sample / SAMPLES;
                let at = Vec2::new(column as f32 + 0.5, row as f32 + 0.5);
                let uv = at / Vec2::new(columns as f32, rows as f32);
                let node = grid.nearest(direction_from_lat_long(uv))?;
                Some(node as u32)
            })
        })
        .collect();
    // Solid angle of a sample in each row, and of each node's samples.
    let edge = |row: u32| (std::f64::consts::PI * f64::from(row) / f64::from(rows)).cos();
    let row_angle: Vec<f64> = (0..rows)
        .map(|row| (edge(row) - edge(row + 1)) * std::f64::consts::TAU / f64::from(columns))
        .collect();
    let angle_of = |pixel: u32, sample: usize| {
        row_angle[((pixel / width) * SAMPLES) as usize + sample / SAMPLES as usize]
    };
    let mut filled = vec![0.0_f64; radiance.len()];
    for (&pixel, own) in candidates.iter().zip(&owners) {
        for (sample, node) in own.iter().enumerate() {
            if let Some(node) = node {
                filled[*node as usize] += angle_of(pixel, sample);
            }
        }
    }
    let solid_angle = f64::from(grid.solid_angle);
    let mut pixels = vec![[0.0_f32; 3]; width as usize * height as usize];
    for (&pixel, own) in candidates.iter().zip(&owners) {
        let mut flux = glam::DVec3::ZERO;
        let mut angle = 0.0;
        for (sample, node) in own.iter().enumerate() {
            angle += angle_of(pixel, sample);
            if let Some(node) = node {
                let share = angle_of(pixel, sample) * solid_angle / filled[*node as usize];
                flux += share * Vec3::from(radiance[*node as usize]).as_dvec3();
            }
        }
        pixels[pixel as usize] = (flux / angle).as_vec3().to_array();
    }
    // In a small map a node may fall between the samples: its flux goes to the pixel that holds it.
    for node in (0..radiance.len()).filter(|&n| filled[n] == 0.0 && radiance[n] != [0.0; 3]) {
        let uv = lat_long_from_direction(grid.directions[node]);
        let x = ((uv.x * width as f32) as u32).min(width - 1);
        let y = ((uv.y * height as f32) as u32).min(height - 1);
        let first = (y * SAMPLES) as usize;
        let angle: f64 = row_angle[first..first + SAMPLES as usize]
            .iter()
            .sum::<f64>()
            * f64::from(SAMPLES);
        let pixel = &mut pixels[(y * width + x) as usize];
        let added = Vec3::from(radiance[node]) * (solid_angle / angle) as f32;
        *pixel = (Vec3::from(*pixel) + added).to_array();
    }
    Picture {
        width,
        height,
        radiance: pixels,
    }
}

/// The pixels of a lat-long map of `[width, height]` that may show a lit node, ascending.
fn pixels_near_light(
    grid: &HemisphereGrid,
    radiance: &[[f32; 3]],
    [width, height]: [u32; 2],
) -> Vec<u32> {
    let pixel = PI / height as f32;
    // Further from a node than the spacing another one is nearer; below the horizon nothing is.
    let reach = 1.5 * grid.spacing() + pixel;
    let mut near = vec![false; width as usize * height as usize];
    for (direction, _) in grid
        .directions
        .iter()
        .zip(radiance)
        .filter(|(_, r)| **r != [0.0; 3])
    {
        let uv = lat_long_from_direction(*direction);
        let fall = uv.y * PI;
        let row = |angle: f32| ((angle / pixel) as u32).min(height - 1);
        // What is within reach of the node covers at most this turn about the poles.
        let widest = reach.sin() / fall.sin().max(1e-6);
        let turn = if fall - reach <= 0.0 || fall + reach >= PI || widest >= 1.0 {
            PI
        } else {
            widest.asin() + pixel
        };
        let (first, count) = (
            ((uv.x - turn / TAU) * width as f32).floor() as i64,
            ((turn / PI) * width as f32).ceil() as i64 + 1,
        );
        for y in row((fall - reach).max(0.0))..=row(fall + reach) {
            for x in first..first + count.min(i64::from(width)) {
                let x = x.rem_euclid(i64::from(width)) as usize;
                near[y as usize * width as usize + x] = true;
            }
        }
    }
    (0..width * height).filter(|&i| near[i as usize]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

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
    fn from_above_north_is_at_the_top() {
        let grid = HemisphereGrid::new(40, Vec3::Y, None, Vec3::ZERO);
        let brightest_at = |direction: Vec3| {
            let mut radiance = vec![[0.0; 3]; grid.directions.len()];
            radiance[grid.nearest(direction.normalize_or_zero()).unwrap()] = [1.0; 3];
            let picture = FromAbove::new(&grid, 101).picture(&radiance);
            let pixel = (0..101 * 101)
                .max_by(|&a, &b| picture.radiance[a][0].total_cmp(&picture.radiance[b][0]))
                .unwrap();
            (pixel % 101, pixel / 101)
        };
        let (x, y) = brightest_at(Vec3::Y);
        assert!(
            x.abs_diff(50) <= 2 && y.abs_diff(50) <= 2,
            "zenith at {x}, {y}"
        );
        let (x, y) = brightest_at(Vec3::new(1.0, 1.0, 0.0));
        assert!(x > 80 && y.abs_diff(50) <= 2, "+X at {x}, {y}");
        let (x, y) = brightest_at(Vec3::new(0.0, 1.0, -1.0));
        assert!(x.abs_diff(50) <= 2 && y < 20, "−Z at {x}, {y}");
    }

    #[test]
    fn exposures_map_the_brightest_to_white() {
        let picture = Picture {
            width: 3,
            height: 1,
            radiance: vec![[100.0; 3], [1.0; 3], [0.0; 3]],
        };
        assert_eq!(
            picture.to_rgb8(Exposure::Log { decades: 8.0 }),
            [[255; 3], [191; 3], [0; 3]]
        );
        assert_eq!(
            picture.to_rgb8(Exposure::Linear { white: 1.0 }),
            [[255; 3], [255; 3], [0; 3]]
        );
    }
}
