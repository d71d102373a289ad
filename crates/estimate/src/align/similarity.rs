//! Similarity transforms: a scale, a rotation and a translation.

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};

use super::AlignError;
use rekindle_capture::{Camera, Mesh};

/// x ↦ s R x + t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// s, greater than zero.
    pub scale: f64,
    /// R.
    pub rotation: DQuat,
    /// t.
    pub translation: DVec3,
}

impl Similarity {
    /// Leaves everything where it is.
    pub const IDENTITY: Self = Self {
        scale: 1.0,
        rotation: DQuat::IDENTITY,
        translation: DVec3::ZERO,
    };

    /// The transform that brings the first of each pair nearest to the second, in the sense of least squares (Horn 1987).
    pub fn from_pairs(pairs: &[[DVec3; 2]]) -> Result<Self, AlignError> {
        let count = pairs.len() as f64;
        let mean = |k: usize| pairs.iter().map(|pair| pair[k]).sum::<DVec3>() / count;
        let means = [mean(0), mean(1)];
        let centred: Vec<[DVec3; 2]> = pairs
            .iter()
            .map(|pair| [pair[0] - means[0], pair[1] - means[1]])
            .collect();
        let size = |k: usize| {
            centred
                .iter()
                .map(|pair| pair[k].length_squared())
                .sum::<f64>()
        };
        let (from, to) = (size(0), size(1));
        let on_a_line = |k: usize| {
            let points: Vec<DVec3> = pairs.iter().map(|pair| pair[k]).collect();
            breadth(&points) < 1e-9
        };
        if pairs.len() < 3 || !from.is_normal() || !to.is_normal() || on_a_line(0) || on_a_line(1) {
            return Err(AlignError::Pairs);
        }
        let rotation = turn(&centred);
        let scale = (to / from).sqrt();
        Ok(Self {
            scale,
            rotation,
            translation: means[1] - scale * (rotation * means[0]),
        })
    }

    /// Where a point comes to lie.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.scale * (self.rotation * point) + self.translation
    }

    /// As a matrix.
    pub fn matrix(&self) -> DMat4 {
        let scale = DVec3::splat(self.scale);
        DMat4::from_scale_rotation_translation(scale, self.rotation, self.translation)
    }

    /// A mesh moved.
    pub fn moved(&self, mesh: &Mesh) -> Mesh {
        mesh.transformed(&self.matrix())
    }

    /// The camera that sees what lies where it was as `camera` sees it where it comes to lie.
    pub fn seen_from(&self, camera: &Camera) -> Camera {
        let back = self.rotation.inverse();
        let pose = camera.world_from_camera;
        Camera {
            world_from_camera: DAffine3 {
                matrix3: DMat3::from_quat(back) * pose.matrix3,
                translation: back * (pose.translation - self.translation) / self.scale,
            },
            ..camera.clone()
        }
    }

    /// This transform followed by a turn, a scaling and a shift about where `centre` comes to lie; the shift in parts of
    /// `radius`.
    pub(super) fn nudged(&self, step: &[f64; 7], centre: DVec3, radius: f64) -> Self {
        let turn = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
        let scale = step[6].exp();
        let middle = self.apply(centre);
        let shift = radius * DVec3::new(step[3], step[4], step[5]);
        Self {
            scale: scale * self.scale,
            rotation: (turn * self.rotation).normalize(),
            translation: middle + scale * (turn * (self.translation - middle)) + shift,
        }
    }
}

/// How far points are from being on one line: about twice the squared ratio of their second extent to the first, 0 where they
/// are on one line or in one place.
pub(super) fn breadth(points: &[DVec3]) -> f64 {
    let mean = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
    let mut spread = DMat3::ZERO;
    for point in points {
        let p = *point - mean;
        spread += DMat3::from_cols(p * p.x, p * p.y, p * p.z);
    }
    // The sum of the principal minors is that of the products of two eigenvalues.
    let trace = spread.col(0)[0] + spread.col(1)[1] + spread.col(2)[2];
    let square = spread * spread;
    let squares = square.col(0)[0] + square.col(1)[1] + square.col(2)[2];
    if trace > 0.0 {
        (trace * trace - squares) / (trace * trace)
    } else {
        0.0
    }
}

/// The rotation that turns the first of each pair to the second: the quaternion of the largest eigenvalue of Horn's matrix.
fn turn(centred: &[[DVec3; 2]]) -> DQuat {
    let mut m = [[0.0; 3]; 3];
    for [from, to] in centred {
        for i in 0..3 {
            for j in 0..3 {
                m[i][j] += from[i] * to[j];
            }
        }
    }
    let [xx, yy, zz] = [m[0][0], m[1][1], m[2][2]];
    let n = [
        [
            xx + yy + zz,
            m[1][2] - m[2][1],
            m[2][0] - m[0][2],
            m[0][1] - m[1][0],
        ],
        [
            m[1][2] - m[2][1],
            xx - yy - zz,
            m[0][1] + m[1][0],
            m[2][0] + m[0][2],
        ],
        [
            m[2][0] - m[0][2],
            m[0][1] + m[1][0],
            yy - xx - zz,
            m[1][2] + m[2][1],
        ],
        [
            m[0][1] - m[1][0],
            m[2][0] + m[0][2],
            m[1][2] + m[2][1],
            zz - xx - yy,
        ],
    ];
    let columns = n.map(glam::DVec4::from_array);
    let mut matrix = DMat4::from_cols(columns[0], columns[1], columns[2], columns[3]);
    // All eigenvalues positive, then squared until the largest is all there is.
    let bound: f64 = columns.iter().map(|c| c.length()).sum();
    matrix += DMat4::from_diagonal(glam::DVec4::splat(bound));
    for _ in 0..60 {
        matrix = matrix * matrix;
        let largest = matrix
            .to_cols_array()
            .into_iter()
            .fold(0.0, |a: f64, b| a.max(b.abs()));
        matrix *= 1.0 / largest;
    }
    let vectors = [matrix.x_axis, matrix.y_axis, matrix.z_axis, matrix.w_axis];
    let longest = vectors
        .into_iter()
        .max_by(|a, b| a.length().total_cmp(&b.length()));
    let v = longest.unwrap_or(glam::DVec4::X).normalize();
    DQuat::from_xyzw(v.y, v.z, v.w, v.x)
}
