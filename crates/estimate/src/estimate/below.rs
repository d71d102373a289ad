//! Does light come from below the horizon?
//!
//! The paper seeks light on a hemisphere. In a room or out of doors a tenth to a third of it comes from below: what floor and
//! ground throw back. Without it the gloss that faces down is laid to light above, in a lobe that is too wide. So cells
//! below the horizon are taken in where they explain clearly more. That alone would mislead: more cells explain normals and
//! cameras that are off as well. But then they don't predict views that had no say in them better.

use std::sync::OnceLock;

use super::cells::Pyramid;
use super::course::explains_better;
use super::fast::{COARSEST, CoarseFit, Solver};
use super::held_out::predicts_better;
use rekindle_scene::hemisphere::HemisphereGrid;

/// Directions all around in which light is sought.
pub struct AllAround {
    grid: HemisphereGrid,
    pyramid: Pyramid,
}

impl AllAround {
    /// The nodes of a solver with those below the horizon.
    pub fn of(solver: &Solver<'_>) -> Self {
        Self::on_cells_of(solver, COARSEST)
    }

    /// The same, where the grid of the coarsest cells has that frequency.
    pub fn on_cells_of(solver: &Solver<'_>, frequency: u32) -> Self {
        let grid = solver.grid.to_whole();
        Self {
            pyramid: Pyramid::new(&grid, frequency),
            grid,
        }
    }

    /// The same solver with light from everywhere.
    pub fn solver<'b>(&'b self, other: &'b Solver<'_>) -> Solver<'b> {
        Solver {
            grid: &self.grid,
            pyramid: &self.pyramid,
            coarse: other.coarse.clone(),
            coarse_sees: OnceLock::new(),
            ..*other
        }
    }
}

/// Whether a coarse fit with light from everywhere is to be preferred to one with light from above, each with its solver.
pub fn is_lit_from_below(
    everywhere: (&Solver<'_>, &CoarseFit<'_>),
    above: (&Solver<'_>, &CoarseFit<'_>),
) -> bool {
    explains_better(everywhere.1, above.1)
        && predicts_better(
            everywhere.1.left_out(everywhere.0),
            above.1.left_out(above.0),
        )
}
