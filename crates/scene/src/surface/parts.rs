//! Parts of the surface whose gloss differs: points that say of which kind it is around them.

use rstar::RTree;
use rstar::primitives::GeomWithData;

use crate::reflectance::{Gloss, MOST_OF_DIELECTRIC};
use glam::Vec3;

/// Points that have a say in what lies between them.
const VOTERS: usize = 8;

/// A point of the surface with the gloss of its part.
#[derive(Clone, Copy, Debug)]
pub struct PartPoint {
    /// World position.
    pub position: Vec3,
    /// Logarithm of its diffuse radiance, RGB.
    pub colour: Vec3,
    /// Its gloss's place among all.
    pub gloss: usize,
}

/// Parts of a surface, each with one of a few glosses.
#[derive(Clone, Debug)]
pub struct GlossParts {
    /// The glosses, the main one first.
    pub glosses: Vec<Gloss>,
    /// Difference of colours that tells parts apart, in natural logarithms.
    contrast: f32,
    /// Radiance whose logarithm is 0.
    scale: f32,
    points: RTree<GeomWithData<[f32; 3], PartPoint>>,
}

impl GlossParts {
    /// Parts by their points, whose colours, logarithms of radiances in units of `scale`, tell them apart where they differ by
    /// `contrast`.
    pub fn new(glosses: Vec<Gloss>, contrast: f32, scale: f32, points: Vec<PartPoint>) -> Self {
        let placed = points.into_iter();
        let placed = placed.map(|point| GeomWithData::new(point.position.to_array(), point));
        Self {
            glosses,
            contrast,
            scale,
            points: RTree::bulk_load(placed.collect()),
        }
    }

    /// The gloss that reflects least, of a surface that others reflect so much more of than a dielectric beside another can that they are
    /// metals.
    pub fn beside_metals(&self) -> Option<Gloss> {
        let reflecting = self.glosses.iter().filter(|gloss| gloss.strength > 0.0);
        let weakest = reflecting
            .clone()
            .min_by(|a, b| a.strength.total_cmp(&b.strength))?;
        let strongest = reflecting.map(|gloss| gloss.strength).fold(0.0, f32::max);
        (strongest > MOST_OF_DIELECTRIC * weakest.strength).then_some(*weakest)
    }

    /// The same parts where another gloss is the main one.
    #[must_use]
    pub fn beside(&self, main: Gloss) -> Self {
        let glosses = self.glosses.iter().map(|gloss| gloss.beside(main));
        self.with(glosses.collect())
    }

    /// The same parts with other glosses.
    #[must_use]
    pub fn with(&self, glosses: Vec<Gloss>) -> Self {
        Self {
            glosses,
            ..self.clone()
        }
    }

    /// Part of the points that have one of the glosses.
    pub fn share(&self, gloss: usize) -> f32 {
        let own = self.points.iter().filter(|p| p.data.gloss == gloss).count();
        own as f32 / self.points.size().max(1) as f32
    }

    /// How far the gloss of the points is from that of other parts in the mean; see [`Gloss::difference`].
    pub fn difference(&self, other: &Self) -> f32 {
        let apart = |point: &PartPoint| {
            let theirs = other.glosses[other.at(point.position)];
            f64::from(self.glosses[point.gloss].difference(theirs))
        };
        let sum: f64 = self.points.iter().map(|point| apart(&point.data)).sum();
        (sum / self.points.size().max(1) as f64) as f32
    }

    /// Which gloss the surface has at a place: that of the nearest point.
    pub fn at(&self, position: Vec3) -> usize {
        let nearest = self.points.nearest_neighbor(position.to_array());
        nearest.map_or(0, |point| point.data.gloss)
    }

    /// The gloss at a place of this colour (logarithms of RGB, where they are known), between those of the points around it.
    pub fn between(&self, position: Vec3, colour: Option<Vec3>) -> Gloss {
        let mut votes: Vec<(f32, usize)> = Vec::with_capacity(VOTERS);
        let around = self
            .points
            .nearest_neighbor_iter_with_distance_2(position.to_array());
        let mut reach = 0.0_f32;
        for (point, squared) in around.take(VOTERS) {
            reach = reach.max(squared);
            let alike = colour.map_or(1.0, |colour| self.likeness(colour, point.data.colour));
            votes.push((
                alike / (squared + 0.02 * reach).max(1e-30),
                point.data.gloss,
            ));
        }
        let glosses = votes.into_iter();
        Gloss::mean(glosses.map(|(weight, gloss)| (self.glosses[gloss], weight)))
    }

    /// How alike two colours are, from 0 to 1.
    pub fn likeness(&self, one: Vec3, other: Vec3) -> f32 {
        likeness(self.contrast, one, other)
    }

    /// A diffuse radiance, positive and in the capture's units, as the points' colours are.
    pub fn colour(&self, radiance: Vec3) -> Vec3 {
        let scaled = radiance / self.scale;
        Vec3::new(scaled.x.ln(), scaled.y.ln(), scaled.z.ln())
    }
}

/// How alike two colours are, from 0 to 1, where differences by `contrast` tell them apart.
pub fn likeness(contrast: f32, one: Vec3, other: Vec3) -> f32 {
    let apart = one.distance_squared(other) / (contrast * contrast);
    (-0.5 * apart).exp().max(1e-4)
}
