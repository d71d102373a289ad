//! The unknown lights at a resolution that varies over the hemisphere.
//!
//! A cell is a set of neighbouring nodes of one radiance. The solve starts from large cells over the whole
//! hemisphere and splits only those that turn out to be lit, so that it never carries a column for the dark part.

use std::collections::BTreeMap;

use glam::Vec3;

use rekindle_scene::hemisphere::HemisphereGrid;

/// Grids of increasing frequency over one hemisphere; the last is the one whose nodes are the result.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<Level>,
}

#[derive(Clone, Debug)]
struct Level {
    grid: HemisphereGrid,
    /// Nodes of the next finer grid nearest to each node; empty at the finest level.
    children: Vec<Vec<u32>>,
    /// The nearest node of the next coarser grid for each node; empty at the coarsest level.
    parents: Vec<u32>,
}

/// A node of one level of a [`Pyramid`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Cell {
    /// Level in the pyramid, 0 the coarsest.
    pub level: u8,
    /// Node of that level's grid.
    pub node: u32,
}

/// What the rows need of a set of cells: one value per cell in each vector.
#[derive(Clone, Debug, Default)]
pub struct CellGeometry {
    /// Unit directions from the object's centre.
    pub directions: Vec<Vec3>,
    /// Solid angles in steradians.
    pub solid_angles: Vec<f32>,
    /// Variance that the cell's extent adds to σ², radians squared.
    pub spread: Vec<f32>,
}

impl Pyramid {
    /// Builds grids from about `coarsest` up to the frequency of `grid`, each about 2.2 times as fine.
    pub fn new(grid: &HemisphereGrid, coarsest: u32) -> Self {
        const STEP: f64 = 2.2;
        let ratio = f64::from(grid.frequency) / f64::from(coarsest.max(1));
        let steps = if ratio > 1.0 {
            (ratio.ln() / STEP.ln()).round().max(1.0) as i32
        } else {
            0
        };
        let mut grids: Vec<HemisphereGrid> = (1..=steps)
            .rev()
            .map(|k| {
                let f = f64::from(grid.frequency) / ratio.powf(f64::from(k) / f64::from(steps));
                grid.at_frequency(f.round() as u32)
            })
            .collect();
        grids.push(grid.clone());
        let mut levels: Vec<Level> = grids
            .into_iter()
            .map(|grid| Level {
                grid,
                children: Vec::new(),
                parents: Vec::new(),
            })
            .collect();
        for k in 1..levels.len() {
            let coarse = &levels[k - 1].grid;
            let fine = &levels[k].grid;
            // A fine node just below a coarse rim still belongs to the rim's nearest node.
            let parents: Vec<u32> = fine
                .directions
                .iter()
                .map(|&d| coarse.nearest(d).unwrap_or(0) as u32)
                .collect();
            let mut children = vec![Vec::new(); coarse.directions.len()];
            for (i, &parent) in parents.iter().enumerate() {
                children[parent as usize].push(i as u32);
            }
            levels[k - 1].children = children;
            levels[k].parents = parents;
        }
        Self { levels }
    }

    /// The coarser cell that a cell belongs to; a coarsest cell is its own.
    pub fn parent(&self, cell: Cell) -> Cell {
        if cell.level == 0 {
            return cell;
        }
        Cell {
            level: cell.level - 1,
            node: self.levels[cell.level as usize].parents[cell.node as usize],
        }
    }

    /// The cell of a level that a node of the finest one belongs to.
    pub fn holding(&self, node: u32, level: u8) -> Cell {
        let mut cell = Cell {
            level: self.finest(),
            node,
        };
        while cell.level > level {
            cell = self.parent(cell);
        }
        cell
    }

    /// Index of the finest level.
    pub fn finest(&self) -> u8 {
        (self.levels.len() - 1) as u8
    }

    /// Cells of a level within an angle of a direction, radians.
    pub fn within(
        &self,
        level: u8,
        direction: Vec3,
        angle: f32,
    ) -> impl Iterator<Item = Cell> + '_ {
        let least = angle.cos();
        let directions = &self.levels[level as usize].grid.directions;
        (0..directions.len() as u32)
            .filter(move |&node| directions[node as usize].dot(direction) > least)
            .map(move |node| Cell { level, node })
    }

    /// All cells of the coarsest level.
    pub fn roots(&self) -> Vec<Cell> {
        (0..self.levels[0].grid.directions.len() as u32)
            .map(|node| Cell { level: 0, node })
            .collect()
    }

    /// The cell of the coarsest level whose centre is nearest to a direction; the first if that is below the rim.
    pub fn root_at(&self, direction: Vec3) -> Cell {
        Cell {
            level: 0,
            node: self.levels[0].grid.nearest(direction).unwrap_or(0) as u32,
        }
    }

    /// Mean angle between neighbouring nodes of a level, radians.
    pub fn spacing(&self, level: u8) -> f32 {
        self.levels[level as usize].grid.spacing()
    }

    /// Cells of the same level around a cell.
    pub fn neighbours(&self, cell: Cell) -> impl Iterator<Item = Cell> + '_ {
        self.levels[cell.level as usize]
            .grid
            .neighbours(cell.node as usize)
            .map(move |node| Cell {
                level: cell.level,
                node: node as u32,
            })
    }

    /// The places among some cells of those that lie beside each other on one level, the earlier of each pair first.
    pub fn joined(&self, cells: &[Cell]) -> Vec<[usize; 2]> {
        let places: BTreeMap<Cell, usize> = cells.iter().copied().zip(0..).collect();
        let joined = places.iter().flat_map(|(&cell, &i)| {
            let others = self.neighbours(cell);
            let others = others.filter_map(|other| places.get(&other).copied());
            others.filter(move |&j| i < j).map(move |j| [i, j])
        });
        joined.collect()
    }

    /// Cells of the next finer level that make up a cell; none for the finest.
    pub fn children(&self, cell: Cell) -> impl Iterator<Item = Cell> + '_ {
        self.levels[cell.level as usize]
            .children
            .get(cell.node as usize)
            .into_iter()
            .flatten()
            .map(move |&node| Cell {
                level: cell.level + 1,
                node,
            })
    }

    /// Directions, solid angles and spread of a set of cells.
    pub fn geometry(&self, cells: &[Cell]) -> CellGeometry {
        let level = |c: &Cell| &self.levels[c.level as usize].grid;
        CellGeometry {
            directions: cells
                .iter()
                .map(|c| level(c).directions[c.node as usize])
                .collect(),
            solid_angles: cells.iter().map(|c| level(c).solid_angle).collect(),
            // A disc of solid angle Ω = πr² has a variance of r²/4 along each axis; the half vector turns by half
            // the light's angle. A node of the finest grid is a point, as in eq. 7.
            spread: cells
                .iter()
                .map(|c| {
                    if c.level == self.finest() {
                        0.0
                    } else {
                        level(c).solid_angle / (16.0 * std::f32::consts::PI)
                    }
                })
                .collect(),
        }
    }

    /// Radiances on the finest grid: each cell's flux is spread evenly over the nodes it consists of.
    pub fn to_nodes(&self, cells: &[Cell], radiance: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let finest = &self.levels[self.finest() as usize].grid;
        let mut nodes = vec![[0.0_f32; 3]; finest.directions.len()];
        for (&cell, value) in cells.iter().zip(radiance) {
            if value.iter().all(|&v| v <= 0.0) {
                continue;
            }
            let members = self.descendants(cell);
            let solid_angle = self.levels[cell.level as usize].grid.solid_angle;
            let share = solid_angle / (members.len() as f32 * finest.solid_angle);
            for node in members {
                for (sum, v) in nodes[node as usize].iter_mut().zip(value) {
                    *sum += v * share;
                }
            }
        }
        nodes
    }

    /// The finest nodes of a cell. A cell that no finer node is nearest to (at the rim) gives its nearest one.
    fn descendants(&self, cell: Cell) -> Vec<u32> {
        let mut members = vec![cell];
        while members.first().is_some_and(|m| m.level < self.finest()) {
            let next: Vec<Cell> = members.iter().flat_map(|&m| self.children(m)).collect();
            if next.is_empty() {
                let direction =
                    self.levels[cell.level as usize].grid.directions[cell.node as usize];
                let finest = &self.levels[self.finest() as usize].grid;
                return finest
                    .nearest(direction)
                    .map(|n| n as u32)
                    .into_iter()
                    .collect();
            }
            members = next;
        }
        members.into_iter().map(|m| m.node).collect()
    }
}
