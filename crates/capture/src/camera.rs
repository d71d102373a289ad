//! A camera with the distortion of the OPENCV or the OPENCV_FISHEYE model.
//!
//! Camera space has OpenGL axes: +X right, +Y up, looking along −Z. Pixel (0, 0) is the top-left pixel and
//! its centre lies at (0.5, 0.5). Distances are in the mesh's units.

use glam::{DAffine3, DMat2, DVec2, DVec3};

/// Radial and tangential lens distortion, applied to normalised image coordinates `(x, y) = (X/Z, Y/Z)`
/// with y downwards: the OPENCV model (k1, k2, p1, p2), extended by the radial k3 and k4; or, for a fisheye, the
/// OPENCV_FISHEYE model, whose radius is θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) at the angle θ from the axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// Radial coefficients of r², r⁴, r⁶ and r⁸.
    pub k: [f64; 4],
    /// Tangential coefficients.
    pub p: [f64; 2],
    /// Coefficients of r², r⁴ and r⁶ in the denominator of the radial factor (`FULL_OPENCV`'s k4, k5 and k6).
    pub denominator: [f64; 3],
    /// Whether the radius follows the angle in place of its tangent.
    pub fisheye: bool,
}

/// A camera: image size, intrinsics in pixels and pose.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal lengths in pixels, horizontal and vertical.
    pub focal: DVec2,
    /// Principal point in pixels.
    pub centre: DVec2,
    /// Lens distortion; all zero for a pinhole.
    pub distortion: Distortion,
    /// Camera-to-world transform: a rotation and the camera's position.
    pub world_from_camera: DAffine3,
}

impl Distortion {
    /// Whether there is none, so that straight lines stay straight.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Distorted coordinates of undistorted normalised coordinates.
    pub fn apply(&self, u: DVec2) -> DVec2 {
        if self.fisheye {
            let r = u.length();
            return if r < 1e-9 {
                u
            } else {
                u * (self.fisheye_radius(r.atan()) / r)
            };
        }
        self.apply_with_slopes(u).0
    }

    /// Whether the image still grows outwards at undistorted coordinates `u`. Beyond, a polynomial fitted to the image
    /// folds back and would put points far outside the field of view into the picture.
    fn grows_at(&self, u: DVec2) -> bool {
        if self.fisheye {
            return self.fisheye_slope(u.length().atan()) > 0.0;
        }
        let r2 = u.length_squared();
        let ([top, bottom], [top_slope, bottom_slope]) = self.radial(r2);
        // d(r·top/bottom)/dr times the squared denominator.
        bottom > 0.0 && top * bottom + 2.0 * r2 * (top_slope * bottom - top * bottom_slope) > 0.0
    }

    /// Numerator and denominator of what multiplies radii where the lens is no fisheye, at a squared radius, and their derivatives by that.
    #[inline]
    fn radial(&self, r2: f64) -> ([f64; 2], [f64; 2]) {
        let [k1, k2, k3, k4] = self.k;
        let [k5, k6, k7] = self.denominator;
        let top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
        let bottom = 1.0 + r2 * (k5 + r2 * (k6 + r2 * k7));
        let top_slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * 4.0 * k4));
        let bottom_slope = k5 + r2 * (2.0 * k6 + r2 * 3.0 * k7);
        ([top, bottom], [top_slope, bottom_slope])
    }

    /// Radius of a fisheye at an angle from the axis, and its derivative.
    fn fisheye_radius(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        let a2 = angle * angle;
        angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    }

    fn fisheye_slope(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        let a2 = angle * angle;
        1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)))
    }

    /// Undistorted coordinates of a fisheye's, by Newton's method on the angle. What lies behind the camera comes out just
    /// in front of it.
    fn remove_fisheye(&self, d: DVec2) -> DVec2 {
        const LARGEST: f64 = std::f64::consts::FRAC_PI_2 - 1e-6;
        let r = d.length();
        if r < 1e-9 {
            return d;
        }
        let mut angle = r.min(LARGEST);
        for _ in 0..20 {
            let slope = self.fisheye_slope(angle);
            if slope <= 1e-6 {
                break;
            }
            angle = (angle - (self.fisheye_radius(angle) - r) / slope).clamp(0.0, LARGEST);
        }
        d * (angle.tan() / r)
    }

    /// Undistorted coordinates of distorted ones, by Newton's method.
    pub fn remove(&self, d: DVec2) -> DVec2 {
        if self.is_none() {
            return d;
        }
        if self.fisheye {
            return self.remove_fisheye(d);
        }
        if self.p == [0.0; 2] {
            return d * self.radial_inverse(d.length_squared());
        }
        let mut u = d;
        for _ in 0..20 {
            let (at, slopes) = self.apply_with_slopes(u);
            let off = at - d;
            if off.length_squared() < 1e-24 || slopes.determinant().abs() < 1e-9 {
                break;
            }
            u -= slopes.inverse() * off;
        }
        u
    }

    /// By what distorted coordinates of a squared radius have to be scaled, for a lens without tangential coefficients, by Newton's method.
    fn radial_inverse(&self, d2: f64) -> f64 {
        let mut scale = 1.0;
        for _ in 0..20 {
            let r2 = scale * scale * d2;
            let ([top, bottom], [top_slope, bottom_slope]) = self.radial(r2);
            let off = scale * top - bottom;
            // The derivatives of both by the scale, of which either is a polynomial.
            let slope = top + 2.0 * r2 * top_slope - 2.0 * scale * d2 * bottom_slope;
            if off * off * d2 < 1e-24 || slope.abs() < 1e-9 {
                break;
            }
            scale -= off / slope;
        }
        scale
    }

    /// [`Distortion::apply`] where the lens is no fisheye, with the derivatives by both coordinates.
    #[inline]
    fn apply_with_slopes(&self, u: DVec2) -> (DVec2, DMat2) {
        let r2 = u.length_squared();
        let ([top, bottom], [top_slope, bottom_slope]) = self.radial(r2);
        let radial = top / bottom;
        let slope = 2.0 * (top_slope - radial * bottom_slope) / bottom;
        let [p1, p2] = self.p;
        let xy = 2.0 * u.x * u.y;
        let at = DVec2::new(
            u.x * radial + p1 * xy + p2 * (r2 + 2.0 * u.x * u.x),
            u.y * radial + p2 * xy + p1 * (r2 + 2.0 * u.y * u.y),
        );
        let across = u.x * u.y * slope + 2.0 * (p1 * u.x + p2 * u.y);
        let slopes = DMat2::from_cols(
            DVec2::new(
                radial + u.x * u.x * slope + 2.0 * p1 * u.y + 6.0 * p2 * u.x,
                across,
            ),
            DVec2::new(
                across,
                radial + u.y * u.y * slope + 2.0 * p2 * u.x + 6.0 * p1 * u.y,
            ),
        );
        (at, slopes)
    }
}

impl Camera {
    /// The camera's position in the world.
    pub fn position(&self) -> DVec3 {
        self.world_from_camera.translation
    }

    /// The camera's up vector in the world, unit.
    pub fn up(&self) -> DVec3 {
        self.world_from_camera.transform_vector3(DVec3::Y)
    }

    /// The same camera in a world whose origin lies at `origin` of this one.
    #[must_use]
    pub fn seen_about(mut self, origin: DVec3) -> Self {
        self.world_from_camera.translation -= origin;
        self
    }

    /// Unit direction the camera looks along, in the world.
    pub fn forward(&self) -> DVec3 {
        self.world_from_camera.transform_vector3(DVec3::NEG_Z)
    }

    /// The same camera with `factor` times as many pixels along each side.
    #[must_use]
    pub fn supersampled(&self, factor: u32) -> Self {
        let f = f64::from(factor);
        Self {
            width: self.width * factor,
            height: self.height * factor,
            focal: self.focal * f,
            centre: self.centre * f,
            ..self.clone()
        }
    }

    /// The same field of view on a picture of another size. The pixels' aspect ratio follows the size.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let factor = DVec2::new(
            f64::from(width) / f64::from(self.width),
            f64::from(height) / f64::from(self.height),
        );
        Self {
            width,
            height,
            focal: self.focal * factor,
            centre: self.centre * factor,
            ..self.clone()
        }
    }

    /// World point in camera space.
    pub fn to_camera(&self, world: DVec3) -> DVec3 {
        self.world_from_camera.matrix3.transpose() * (world - self.position())
    }

    /// Pixel coordinates of a world point, `None` where it lies behind the camera or so far outside the field of
    /// view that the distortion model no longer applies.
    pub fn project(&self, world: DVec3) -> Option<DVec2> {
        self.project_from_camera(self.to_camera(world))
    }

    /// [`Camera::project`] of a point in camera space.
    pub fn project_from_camera(&self, c: DVec3) -> Option<DVec2> {
        let depth = -c.z;
        if depth <= 1e-12 {
            return None;
        }
        let u = DVec2::new(c.x / depth, -c.y / depth);
        if self.distortion.is_none() {
            return Some(u * self.focal + self.centre);
        }
        let grows = self.distortion.grows_at(u);
        grows.then(|| self.distortion.apply(u) * self.focal + self.centre)
    }

    /// Unit direction, in the world, of the ray from the camera's position through a pixel coordinate.
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        let u = self.distortion.remove((pixel - self.centre) / self.focal);
        self.world_from_camera
            .transform_vector3(DVec3::new(u.x, -u.y, -1.0))
            .normalize_or_zero()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_of_a_lens_agree_with_finite_differences() {
        let lens = Distortion {
            k: [-0.3, 0.12, 0.02, -0.01],
            p: [0.004, -0.003],
            denominator: [0.02, -0.01, 0.005],
            fisheye: false,
        };
        for u in [DVec2::ZERO, DVec2::new(0.5, -0.3), DVec2::new(-0.2, 0.7)] {
            let (at, slopes) = lens.apply_with_slopes(u);
            assert_eq!(at, lens.apply(u));
            for (axis, slope) in [(DVec2::X, slopes.x_axis), (DVec2::Y, slopes.y_axis)] {
                let step = 1e-5 * axis;
                let difference = (lens.apply(u + step) - lens.apply(u - step)) / 2e-5;
                assert!(
                    (difference - slope).length() < 1e-9,
                    "{difference} for {slope}"
                );
            }
        }
    }

    #[test]
    fn removing_a_distortion_undoes_applying_it() {
        for p in [[0.0, 0.0], [0.004, -0.003]] {
            for denominator in [[0.0; 3], [0.02, -0.01, 0.005]] {
                let lens = Distortion {
                    k: [-0.3, 0.12, 0.02, -0.01],
                    p,
                    denominator,
                    fisheye: false,
                };
                for u in [DVec2::ZERO, DVec2::new(0.5, -0.3), DVec2::new(-0.2, 0.7)] {
                    let back = lens.remove(lens.apply(u));
                    assert!((back - u).length() < 1e-11, "{back} for {u} of {lens:?}");
                }
            }
        }
    }
}
