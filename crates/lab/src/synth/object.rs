//! Shapes given by a function that is negative inside and grows like a distance near the surface. All stand in the cube
//! of side 2.3 about the origin and face +Z, where the cameras are.

use glam::DVec3;

/// Half the side of the cube that holds every object.
pub(super) const REACH: f64 = 1.15;
/// Step of the central differences for a gradient: the finest relief is a hundred times longer.
const STEP: f64 = 1e-4;
/// Newton steps from a point near the surface onto it.
const NEWTON_STEPS: usize = 8;

/// A shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Object {
    /// A ball of radius 1.
    Sphere,
    /// A tilted ring: concave inside, casts shadows onto itself.
    Torus,
    /// A thick bowl that opens towards the cameras: much interreflection.
    Bowl,
    /// A figure with arms, ears, hollows and a fine relief.
    Figurine,
}

impl Object {
    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sphere => "sphere",
            Self::Torus => "torus",
            Self::Bowl => "bowl",
            Self::Figurine => "figurine",
        }
    }

    /// Negative inside, positive outside, about the distance near the surface.
    pub(super) fn distance(self, p: DVec3) -> f64 {
        match self {
            Self::Sphere => p.length() - 1.0,
            Self::Torus => {
                let axis = DVec3::new(0.0, 0.6, 0.8);
                let along = p.dot(axis);
                let across = (p - axis * along).length() - 0.7;
                across.hypot(along) - 0.3
            }
            Self::Bowl => {
                let opening = DVec3::new(0.0, 0.6, 0.8);
                let shell = (p.length() - 0.9).abs() - 0.08;
                -joined(-shell, 0.25 - p.dot(opening), 0.06)
            }
            Self::Figurine => figurine(p),
        }
    }

    /// Unit normal of the surface near a point of it, away from the inside.
    pub(super) fn normal(self, p: DVec3) -> DVec3 {
        self.gradient(p).normalize_or(DVec3::Y)
    }

    fn gradient(self, p: DVec3) -> DVec3 {
        let slope = |axis: DVec3| self.distance(p + STEP * axis) - self.distance(p - STEP * axis);
        DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z)) / (2.0 * STEP)
    }

    /// The point of the surface near a point.
    pub(super) fn onto_surface(self, mut p: DVec3) -> DVec3 {
        for _ in 0..NEWTON_STEPS {
            let gradient = self.gradient(p);
            let distance = self.distance(p);
            // Where two parts meet, the gradient may nearly vanish; a step must not leave the neighbourhood.
            p -= gradient * (distance / gradient.length_squared().max(0.1));
            if distance.abs() < 1e-9 {
                break;
            }
        }
        p
    }
}

/// The union of two shapes with a fillet of radius about `width` (Quilez's polynomial smooth minimum).
fn joined(a: f64, b: f64, width: f64) -> f64 {
    let overlap = (width - (a - b).abs()).max(0.0) / width;
    a.min(b) - 0.25 * width * overlap * overlap
}

fn ball(p: DVec3, centre: [f64; 3], radius: f64) -> f64 {
    (p - DVec3::from(centre)).length() - radius
}

fn capsule(p: DVec3, from: [f64; 3], to: [f64; 3], radius: f64) -> f64 {
    let (from, to) = (DVec3::from(from), DVec3::from(to));
    let axis = to - from;
    let along = ((p - from).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
    (p - from - axis * along).length() - radius
}

fn figurine(p: DVec3) -> f64 {
    // Left and right are alike.
    let p = DVec3::new(p.x.abs(), p.y, p.z);
    let body = ball(p, [0.0, -0.4, 0.0], 0.5);
    let head = ball(p, [0.0, 0.42, 0.05], 0.38);
    let mut shape = joined(body, head, 0.16);
    shape = joined(shape, ball(p, [0.3, 0.76, 0.0], 0.19), 0.05);
    let arm = capsule(p, [0.46, -0.12, 0.05], [0.62, -0.4, 0.42], 0.12);
    shape = joined(shape, arm, 0.06);
    let foot = capsule(p, [0.26, -0.85, 0.05], [0.3, -0.88, 0.4], 0.16);
    shape = joined(shape, foot, 0.08);
    // A hollow in the belly, and eyes.
    shape = -joined(-shape, ball(p, [0.0, -0.32, 0.58], 0.27), 0.05);
    shape = -joined(-shape, ball(p, [0.15, 0.5, 0.42], 0.09), 0.03);
    let relief = |x: f64| (36.0 * x).sin();
    shape + 0.003 * relief(p.x) * relief(p.y) * relief(p.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_put_onto_the_surface_of_every_object() {
        for object in [
            Object::Sphere,
            Object::Torus,
            Object::Bowl,
            Object::Figurine,
        ] {
            for k in 0..200 {
                let (sin, cos) = (f64::from(k) * 2.4).sin_cos();
                let height = f64::from(k) / 100.0 - 0.995;
                let across = (1.0 - height * height).sqrt();
                let from = DVec3::new(across * cos, height, across * sin);
                // Along the ray from outside to the first point near the surface.
                let Some(near) = (0..400)
                    .map(|i| from * (1.2 - 0.002 * f64::from(i)))
                    .find(|&p| object.distance(p).abs() < 0.01)
                else {
                    continue;
                };
                let p = object.onto_surface(near);
                assert!(object.distance(p).abs() < 1e-7, "{object:?} at {p}");
                assert!(p.distance(near) < 0.05, "{object:?} at {p}");
                let outside = p + 1e-3 * object.normal(p);
                assert!(object.distance(outside) > 0.0, "{object:?} at {p}");
            }
        }
    }
}
