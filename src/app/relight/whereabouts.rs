//! Where a light is, in words, for whoever looks at the object.

use glam::Vec3;

/// Degrees above the horizon from which a light has no side any more …
const ABOVE: f32 = 75.0;
/// … from which it is high …
const HIGH: f32 = 55.0;
/// … and below which it is low.
const LOW: f32 = 25.0;

/// Directions as the viewer has them.
pub(super) struct Viewer {
    right: Vec3,
    front: Vec3,
    up: Vec3,
}

impl Viewer {
    /// A viewer in a unit direction from the object.
    pub(super) fn new(towards: Vec3, up: Vec3) -> Self {
        let flat = towards.reject_from_normalized(up);
        let front = flat.normalize_or(up.any_orthonormal_vector());
        Self {
            right: up.cross(front),
            front,
            up,
        }
    }

    /// A unit direction in words: "left, low".
    pub(super) fn words(&self, direction: Vec3) -> String {
        let height = direction.dot(self.up).clamp(-1.0, 1.0).asin().to_degrees();
        if height > ABOVE {
            return "above".to_owned();
        }
        let aside = direction
            .dot(self.right)
            .atan2(direction.dot(self.front))
            .to_degrees();
        let side = if aside > 0.0 { "right" } else { "left" };
        let side = match aside.abs() {
            a if a < 22.5 => "front".to_owned(),
            a if a < 67.5 => format!("front {side}"),
            a if a < 112.5 => side.to_owned(),
            a if a < 157.5 => format!("back {side}"),
            _ => "back".to_owned(),
        };
        match height {
            h if h < 0.0 => format!("{side}, below"),
            h if h < LOW => format!("{side}, low"),
            h if h > HIGH => format!("{side}, high"),
            _ => side,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_named_as_the_viewer_sees_them() {
        let viewer = Viewer::new(Vec3::new(0.0, 0.6, 0.8), Vec3::Y);
        for (direction, words) in [
            (Vec3::new(0.0, 0.6, 0.8), "front"),
            (Vec3::new(-1.0, 0.2, 0.0), "left, low"),
            (Vec3::new(1.0, 1.0, 1.4), "front right"),
            (Vec3::new(0.8, 2.0, -0.9), "back right, high"),
            (Vec3::new(0.0, -0.1, -1.0), "back, below"),
            (Vec3::new(0.1, 1.0, 0.1), "above"),
        ] {
            let told = viewer.words(direction.normalize_or_zero());
            assert_eq!(told, words, "{direction}");
        }
        // From the other side left is right.
        let other = Viewer::new(Vec3::NEG_Z, Vec3::Y);
        assert_eq!(other.words(Vec3::NEG_X), "right, low");
    }
}
