//! Uniform elliptical lamps: the plainest light with given flux, centroid and second moments.

use glam::{DVec3, Mat2, Vec2, Vec3};

use rekindle_scene::hemisphere::{HemisphereGrid, Lamp};

/// Numbers that place and shape an ellipse.
pub const PARAMETERS: usize = 5;

/// A uniform ellipse on the hemisphere. Its edge is as soft as a node is wide.
#[derive(Clone, Copy, Debug)]
pub struct Ellipse {
    frame: Frame,
    /// Its centre in the frame, radians.
    centre: Vec2,
    /// Maps the unit disc to it: symmetric, the semi-axes in radians as eigenvalues.
    shape: Mat2,
    /// Σ L ω, RGB.
    flux: Vec3,
}

/// Tangent plane around a direction.
#[derive(Clone, Copy, Debug)]
struct Frame {
    pole: Vec3,
    x: Vec3,
    y: Vec3,
}

impl Frame {
    fn new(pole: Vec3) -> Self {
        let (x, y) = pole.any_orthonormal_pair();
        Self { pole, x, y }
    }

    /// Angles from the pole along the two axes, radians.
    fn project(&self, d: Vec3) -> Vec2 {
        let plane = Vec2::new(d.dot(self.x), d.dot(self.y));
        plane.normalize_or_zero() * plane.length().atan2(d.dot(self.pole))
    }

    /// The direction of such angles.
    fn direction(&self, angles: Vec2) -> Vec3 {
        let (sin, cos) = angles.length().sin_cos();
        let towards = angles.normalize_or_zero();
        cos * self.pole + sin * (towards.x * self.x + towards.y * self.y)
    }
}

/// A symmetric matrix's eigenvalues, the larger first, and the unit eigenvector of that.
fn eigen(matrix: Mat2) -> (f32, f32, Vec2) {
    let (xx, xy, yy) = (matrix.x_axis.x, matrix.x_axis.y, matrix.y_axis.y);
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    let root = half.hypot(xy);
    let axis = Vec2::from_angle(0.5 * xy.atan2(half));
    (mean + root, mean - root, axis)
}

/// The symmetric matrix with these eigenvalues, the first along a unit vector.
fn symmetric(first: f32, second: f32, axis: Vec2) -> Mat2 {
    let turned = Mat2::from_cols(axis, axis.perp());
    turned * Mat2::from_diagonal(Vec2::new(first, second)) * turned.transpose()
}

impl Ellipse {
    /// The ellipse with a lamp's flux, centroid and second moments, never smaller than a node.
    pub fn of(grid: &HemisphereGrid, radiance: &[[f32; 3]], lamp: &Lamp) -> Self {
        let frame = Frame::new(lamp.direction);
        let (mut moments, mut total) = (DVec3::ZERO, 0.0_f64);
        for &node in &lamp.nodes {
            let w = f64::from(radiance[node as usize].iter().sum::<f32>());
            let p = frame.project(grid.directions[node as usize]).as_dvec2();
            moments += w * DVec3::new(p.x * p.x, p.x * p.y, p.y * p.y);
            total += w;
        }
        let variance = (moments / total.max(f64::MIN_POSITIVE)).as_vec3();
        let columns = [[variance.x, variance.y], [variance.y, variance.z]];
        let (first, second, axis) = eigen(Mat2::from_cols_array_2d(&columns));
        // A uniform ellipse of semi-axis a has the variance a²/4 along it.
        let semi_axis = |variance: f32| 2.0 * variance.max(0.0).sqrt();
        Self {
            frame,
            centre: Vec2::ZERO,
            shape: symmetric(semi_axis(first), semi_axis(second), axis),
            flux: lamp.flux.into(),
        }
        .no_smaller_than(0.5 * grid.spacing())
    }

    fn no_smaller_than(self, least: f32) -> Self {
        let (first, second, axis) = eigen(self.shape);
        Self {
            shape: symmetric(first.max(least), second.max(least), axis),
            ..self
        }
    }

    /// Moved by the first two of some steps along the axes of its frame and stretched by the others, radians.
    pub fn changed(&self, by: [f32; PARAMETERS], grid: &HemisphereGrid) -> Self {
        let [x, y, xx, xy, yy] = by;
        Self {
            centre: self.centre + Vec2::new(x, y),
            shape: self.shape + Mat2::from_cols_array_2d(&[[xx, xy], [xy, yy]]),
            ..*self
        }
        .no_smaller_than(0.5 * grid.spacing())
    }

    /// The shorter semi-axis as a part of the longer.
    pub fn roundness(&self) -> f32 {
        let (long, short, _) = eigen(self.shape);
        short / long
    }

    /// The direction of its middle.
    pub fn middle(&self) -> Vec3 {
        self.frame.direction(self.centre)
    }

    /// With semi-axes that are so many times as long.
    pub fn scaled(&self, factor: f32, grid: &HemisphereGrid) -> Self {
        Self {
            shape: factor * self.shape,
            ..*self
        }
        .no_smaller_than(0.5 * grid.spacing())
    }

    /// Of another flux.
    pub fn with_flux(&self, flux: Vec3) -> Self {
        Self { flux, ..*self }
    }

    /// As strong as some multiple of it in each channel.
    pub fn times(&self, factor: Vec3) -> Self {
        Self {
            flux: self.flux * factor,
            ..*self
        }
    }

    /// Nodes within `beyond`, radians, of it.
    pub fn reach(&self, grid: &HemisphereGrid, beyond: f32) -> impl Iterator<Item = usize> {
        let (pole, reach) = (self.frame.pole, self.cos_reach(beyond));
        (0..grid.directions.len()).filter(move |&i| grid.directions[i].dot(pole) > reach)
    }

    /// Cosine of the angle from its frame's pole within which all of it and what is within `beyond`, radians, of it lies.
    fn cos_reach(&self, beyond: f32) -> f32 {
        let (long, ..) = eigen(self.shape);
        (self.centre.length() + long + beyond).min(1.5).cos()
    }

    /// Its nodes and their radiance.
    pub fn nodes(&self, grid: &HemisphereGrid) -> Vec<(usize, [f32; 3])> {
        self.lit(grid, self.reach(grid, grid.spacing()))
    }

    /// All nodes of a grid, those first that are nearest to the direction from which its changes count.
    pub fn nearest_first(&self, grid: &HemisphereGrid) -> Vec<u32> {
        let towards = |node: &u32| grid.directions[*node as usize].dot(self.frame.pole);
        let mut nodes: Vec<u32> = (0..grid.directions.len() as u32).collect();
        nodes.sort_by(|a, b| towards(b).total_cmp(&towards(a)));
        nodes
    }

    /// The same nodes and radiance, of nodes in the order of [`Self::nearest_first`], so that not all are looked at.
    pub fn nodes_among(
        &self,
        grid: &HemisphereGrid,
        nearest_first: &[u32],
    ) -> Vec<(usize, [f32; 3])> {
        let (pole, reach) = (self.frame.pole, self.cos_reach(grid.spacing()));
        let nodes = nearest_first.iter().map(|&node| node as usize);
        let reached = nodes.take_while(|&node| grid.directions[node].dot(pole) > reach);
        self.lit(grid, reached)
    }

    /// Those of some nodes that it covers, and their radiance.
    fn lit(
        &self,
        grid: &HemisphereGrid,
        reached: impl Iterator<Item = usize>,
    ) -> Vec<(usize, [f32; 3])> {
        let margin = 0.5 * grid.spacing();
        let (long, short, axis) = eigen(self.shape);
        let coverage = |node: usize| {
            let p = self.frame.project(grid.directions[node]) - self.centre;
            let turned = Vec2::new(p.dot(axis), axis.perp_dot(p));
            coverage(turned, Vec2::new(long, short), margin)
        };
        let cover: Vec<(usize, f32)> = reached
            .map(|node| (node, coverage(node)))
            .filter(|(_, covered)| *covered > 0.0)
            .collect();
        let total: f32 = cover.iter().map(|(_, c)| c * grid.solid_angle).sum();
        let radiance = |covered: f32| (self.flux * (covered / total)).to_array();
        cover.into_iter().map(|(i, c)| (i, radiance(c))).collect()
    }

    /// Adds its light to radiances on the nodes.
    pub fn add_to(&self, nodes: &mut [[f32; 3]], grid: &HemisphereGrid) {
        for (node, radiance) in self.nodes(grid) {
            for (value, own) in nodes[node].iter_mut().zip(radiance) {
                *value += own;
            }
        }
    }
}

/// Share of a node of half width `margin` at `p` that lies within an ellipse's semi-axes along x and y, nearly.
fn coverage(p: Vec2, semi_axes: Vec2, margin: f32) -> f32 {
    let distance = (p / semi_axes).length();
    let inside = if distance < 1e-6 {
        semi_axes.y
    } else {
        p.length() * (1.0 / distance - 1.0)
    };
    (0.5 * inside / margin + 0.5).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ellipse_has_the_moments_of_what_it_was_made_from_and_follows_its_changes() {
        let grid = HemisphereGrid::new(70, Vec3::Y, None, Vec3::ZERO);
        let pole = Vec3::new(0.3, 0.8, 0.4).normalize_or_zero();
        let (x, y) = pole.any_orthonormal_pair();
        // Four spikes: semi-axes of 6° and 4°, turned by 30°.
        let (sin, cos) = 30_f32.to_radians().sin_cos();
        let axes = [cos * x + sin * y, cos * y - sin * x];
        let mut radiance = vec![[0.0; 3]; grid.directions.len()];
        for (axis, angle) in [(axes[0], 6_f32), (axes[1], 4.0)] {
            let away = (0.5_f32.sqrt() * angle.to_radians()).tan() * axis;
            for spike in [pole + away, pole - away] {
                let node = grid.nearest(spike.normalize_or_zero());
                radiance[node.expect("above the horizon")] = [3.0, 2.0, 1.0];
            }
        }
        let lit = (0..radiance.len() as u32).filter(|&n| radiance[n as usize] != [0.0; 3]);
        let lamp = Lamp::new(&grid, &radiance, lit.collect()).expect("lit");
        let ellipse = Ellipse::of(&grid, &radiance, &lamp);
        let (long, short, _) = eigen(ellipse.shape);
        // Spikes lie on nodes 0.9° apart.
        assert!(
            (long.to_degrees() - 6.0).abs() < 0.5,
            "{}",
            long.to_degrees()
        );
        assert!(
            (short.to_degrees() - 4.0).abs() < 0.5,
            "{}",
            short.to_degrees()
        );
        let lamp_of = |ellipse: &Ellipse| {
            let mut nodes = vec![[0.0; 3]; grid.directions.len()];
            let lit = ellipse.nodes(&grid);
            for &(node, value) in &lit {
                nodes[node] = value;
            }
            let lit = lit.iter().map(|&(node, _)| node as u32);
            Lamp::new(&grid, &nodes, lit.collect()).expect("lit")
        };
        let filled = lamp_of(&ellipse);
        assert!(filled.direction.angle_between(lamp.direction) < 0.001);
        assert!((filled.angular_radius / lamp.angular_radius - 1.0).abs() < 0.03);
        assert!((filled.mean_flux() / lamp.mean_flux() - 1.0).abs() < 1e-4);
        let moved = ellipse.changed([0.02, -0.01, 0.0, 0.0, 0.0], &grid);
        let by = lamp_of(&moved).direction.angle_between(filled.direction);
        assert!((by - 0.02_f32.hypot(0.01)).abs() < 0.002, "{by}");
        let wider = lamp_of(&ellipse.changed([0.0, 0.0, 0.03, 0.0, 0.03], &grid));
        assert!(wider.angular_radius > filled.angular_radius + 0.025);
        let none = lamp_of(&ellipse.changed([0.0, 0.0, -1.0, 0.0, -1.0], &grid));
        assert!(none.angular_radius < grid.spacing() && none.mean_flux() > 0.0);
    }
}
