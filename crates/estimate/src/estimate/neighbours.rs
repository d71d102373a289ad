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
/// Points inside a part that are few, as a share of those along its borders.
const FEW_INSIDE: f32 = 0.25;
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

impl<T> Lists<T> {
    /// Which points lie inside their parts, all neighbours being of the same: along borders it is not sure which one a point is of. All points
    /// of a part that has few inside do. `place` says which point an entry names.
    pub fn inside(&self, parts: &[usize], place: impl Fn(&T) -> u32) -> Vec<bool> {
        let is_of = |near: &T, part: usize| parts[place(near) as usize] == part;
        let is_inside = |i: usize| self[i].iter().all(|near| is_of(near, parts[i]));
        let mut inside: Vec<bool> = (0..parts.len()).map(is_inside).collect();
        let count = parts.iter().max().map_or(0, |most| most + 1);
        let mut points = vec![[0_usize; 2]; count];
        for (&part, &is_inside) in parts.iter().zip(&inside) {
            points[part][usize::from(is_inside)] += 1;
        }
        for (&part, is_inside) in parts.iter().zip(&mut inside) {
            let [border, within] = points[part];
            *is_inside |= (within as f32) < FEW_INSIDE * border as f32;
        }
        inside
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
