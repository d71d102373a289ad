//! Pictures of the lighting: the hemisphere seen from straight above, as in the paper's figures 4 and 5.

use glam::Vec3;
use rayon::prelude::*;

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

#[cfg(test)]
mod tests {
    use super::*;

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
