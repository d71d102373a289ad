//! Marks as lines of sight: where from, in which direction, and which point of the mesh is to lie there.

use glam::{DMat3, DVec3};

use super::Similarity;
use super::marks::MarkedPoint;
use super::start::{nearest, spread};
use rekindle_capture::View;

/// Rotations tried.
const ROTATIONS: u32 = 2000;
/// Rotations nearer to each other than this lead to the same place, radians.
const APART: f64 = 0.5;

/// A line of sight to a point of the mesh.
struct Sight {
    /// The point, where the mesh lies.
    point: DVec3,
    origin: DVec3,
    /// Unit.
    direction: DVec3,
}

/// All lines of sight of some marks.
pub(super) struct Sights(Vec<Sight>);

impl Sights {
    pub(super) fn new(views: &[View], points: &[MarkedPoint]) -> Self {
        let of = |point: &MarkedPoint| {
            let place = point.place;
            let marks = point.marks.clone().into_iter();
            marks.map(move |mark| {
                let camera = &views[mark.view].camera;
                Sight {
                    point: place,
                    origin: camera.position(),
                    direction: camera.ray(mark.pixel),
                }
            })
        };
        Self(points.iter().flat_map(of).collect())
    }

    /// How far each direction to a moved point is from its line, radians in three components: they grow up to behind the
    /// camera, where a picture knows no place.
    pub(super) fn residuals(&self, transform: &Similarity) -> impl Iterator<Item = f32> {
        self.0.iter().flat_map(|sight| {
            let to = transform.apply(sight.point) - sight.origin;
            let off = to.normalize_or_zero() - sight.direction;
            off.as_vec3().to_array()
        })
    }

    /// Where to begin: of rotations spread evenly the best ones that are apart, each with the scale and the shift that bring
    /// the points nearest to their lines.
    pub(super) fn starts(&self, count: usize) -> Vec<Similarity> {
        let Some(lines) = Lines::new(&self.0) else {
            return Vec::new();
        };
        let mut found: Vec<(f64, Similarity)> = (0..ROTATIONS)
            .filter_map(|i| lines.place(spread(i, ROTATIONS)))
            .collect();
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut starts: Vec<Similarity> = Vec::new();
        for (_, start) in found {
            let far = |other: &Similarity| start.rotation.angle_between(other.rotation) > APART;
            if starts.len() < count && starts.iter().all(far) {
                starts.push(start);
            }
        }
        starts
    }
}

/// Sums over the lines that are the same for every rotation. With P = I − d dᵀ the squared distance of s R x + t from the
/// line through o along d is |P (s R x + t − o)|², so that s and t follow from linear equations.
struct Lines<'a> {
    sights: &'a [Sight],
    /// P of each line over its squared distance from where all of them meet.
    across: Vec<DMat3>,
    /// The inverse of Σ P, and Σ P o.
    inverse: DMat3,
    origins: DVec3,
}

impl<'a> Lines<'a> {
    /// None where all lines are parallel.
    fn new(sights: &'a [Sight]) -> Option<Self> {
        let lines: Vec<(DVec3, DVec3)> = sights.iter().map(|s| (s.origin, s.direction)).collect();
        let middle = nearest(&lines);
        let across: Vec<DMat3> = sights
            .iter()
            .map(|sight| {
                let d = sight.direction;
                let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
                across * (1.0 / sight.origin.distance_squared(middle).max(1e-30))
            })
            .collect();
        let mut sum = DMat3::ZERO;
        for p in &across {
            sum += *p;
        }
        let inverse = sum.inverse();
        let pairs = sights.iter().zip(&across);
        Some(Self {
            sights,
            origins: pairs.map(|(sight, p)| *p * sight.origin).sum(),
            inverse,
            across,
        })
        .filter(|lines| lines.inverse.is_finite())
    }

    /// The best scale and shift for a rotation, and by how much they lower the squared distances; none where the scale is not
    /// positive.
    fn place(&self, rotation: glam::DQuat) -> Option<(f64, Similarity)> {
        let (mut sum, mut towards, mut square) = (DVec3::ZERO, 0.0, 0.0);
        for (sight, p) in self.sights.iter().zip(&self.across) {
            let turned = rotation * sight.point;
            let across = *p * turned;
            sum += across;
            towards += across.dot(sight.origin);
            square += across.dot(turned);
        }
        let slope = towards - sum.dot(self.inverse * self.origins);
        let curvature = square - sum.dot(self.inverse * sum);
        let scale = slope / curvature;
        (scale.is_finite() && scale > 0.0).then(|| {
            let translation = self.inverse * (self.origins - scale * sum);
            let transform = Similarity {
                scale,
                rotation,
                translation,
            };
            (scale * slope, transform)
        })
    }
}
