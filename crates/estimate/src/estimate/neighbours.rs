//! Which points of the surface lie beside which, and how alike they are.

use std::ops::Index;

use glam::Vec3;
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::observations::Point;
use super::weights::median;
use rekindle_scene::surface::likeness;

/// Points that a point is joined to.
const NEIGHBOURS: usize = 8;
/// Difference of neighbours' logarithms of radiance that says nothing.
const LEAST_CONTRAST: f32 = 0.02;

/// A list of each point, those of one after those of the other.
#[derive(Clone, Debug)]
pub struct Lists<T> {
    /// Where each point's begins, and at last their number.
    starts: Vec<usize>,
    all: Vec<T>,
}

/// The nearest points of each that face the same side.
pub type Neighbours = Lists<u32>;

/// The same with the strength of the bond to each, from 0 to 1.
pub type Bonds = Lists<(u32, f32)>;

impl<T> Lists<T> {
    /// The number of points.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Each point's list.
    pub fn iter(&self) -> impl Iterator<Item = &[T]> {
        (0..self.len()).map(|i| &self[i])
    }
}

impl<T> Index<usize> for Lists<T> {
    type Output = [T];

    fn index(&self, point: usize) -> &[T] {
        &self.all[self.starts[point]..self.starts[point + 1]]
    }
}

impl Neighbours {
    /// Of some points.
    pub fn of(points: &[Point]) -> Self {
        let placed = points.iter().enumerate();
        let placed = placed.map(|(i, p)| GeomWithData::new(p.position.to_array(), i as u32));
        let tree: RTree<GeomWithData<[f32; 3], u32>> = RTree::bulk_load(placed.collect());
        let beside = |(i, point): (usize, &Point)| -> Vec<u32> {
            tree.nearest_neighbor_iter(point.position.to_array())
                .map(|near| near.data)
                .filter(|&j| j as usize != i && points[j as usize].normal.dot(point.normal) > 0.0)
                .take(NEIGHBOURS)
                .collect()
        };
        let lists: Vec<Vec<u32>> = points.par_iter().enumerate().map(beside).collect();
        let ends = lists.iter().scan(0, |end, list| {
            *end += list.len();
            Some(*end)
        });
        Self {
            starts: std::iter::once(0).chain(ends).collect(),
            all: lists.concat(),
        }
    }

    /// Bonds that the points' colours, logarithms of their radiances, weaken, and the contrast that does.
    pub fn bonds(&self, colours: &[Vec3]) -> (Bonds, f32) {
        let pairs = || {
            let of_point = |i: usize| self[i].iter().map(move |&j| (i, j));
            (0..self.len()).flat_map(of_point)
        };
        let mut steps: Vec<f32> = pairs()
            .map(|(i, j)| colours[i].distance(colours[j as usize]))
            .collect();
        let contrast = 2.0 * median(&mut steps).max(LEAST_CONTRAST);
        let bond = |(i, j): (usize, u32)| (j, likeness(contrast, colours[i], colours[j as usize]));
        let bonds = Lists {
            starts: self.starts.clone(),
            all: pairs().map(bond).collect(),
        };
        (bonds, contrast)
    }
}
