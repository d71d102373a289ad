//! How much a noisy mesh is to be smoothed: as much as the pictures say.

use rayon::prelude::*;

use super::{Bench, Relief};
use crate::estimate::fast::{Solver, Watch};
use crate::estimate::held_out::{CHANCE, LeftAt, at_best_roughness, leaves_less, roughly_left_out};
use crate::estimate::observations::Seen;
use crate::estimate::observer::{Stopped, go_on};
use rekindle_capture::Mesh;
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_scene::surface::{NO_TRIANGLE, Smoothing, ViewSurface, simplified};

/// Most triangles of a surface with places of its own to move.
const MOST_TRIANGLES: usize = 90_000;

/// How noisy surfaces are smoothed: how many times fewer triangles they get, and below which length, in their edges. What is
/// smoothed much needs few triangles.
const SMOOTHINGS: [(usize, f64); 8] = [
    (1, 0.4),
    (1, 0.7),
    (1, 1.0),
    (1, 1.5),
    (4, 1.0),
    (4, 1.5),
    (16, 1.0),
    (16, 2.0),
];
/// So many of them are tried side by side, which are of one mesh.
const AT_ONCE: usize = 2;

/// A surface that leaves so many times as much as a less smooth one is smoothed too much, as all smoother ones are.
const TOO_MUCH: f64 = 1.25;

/// A smoother surface may leave more than the best one by so many standard deviations of chance (the one-standard-error rule: Breiman et
/// al., "Classification and Regression Trees", 1984).
const AS_GOOD: f64 = 1.0;

/// A smoothed surface, and what a coarse fit to it leaves of views that had no say.
struct Smoothed {
    relief: Relief,
    left: Vec<LeftAt>,
}

impl Smoothed {
    fn of(
        solver: &Solver<'_>,
        brdf: Brdf,
        (mesh, spacing): (&Smoothing, f64),
        length: f64,
    ) -> Option<Self> {
        let fairing = mesh.at(length * spacing)?;
        let relief = Relief::new(fairing);
        let smooth = relief.mesh();
        let bench = Bench::new(&smooth, solver.seen.views);
        let again = bench.solver(solver, &smooth);
        let left = roughly_left_out(&again, &again.dark_roots(brdf));
        Some(Self { relief, left })
    }

    fn total(&self) -> f64 {
        self.left.iter().map(|at| at.left).sum()
    }
}

/// The surface through a mesh that is as fine as the pictures, smoothed as much as these say: the smoothest that leaves of views
/// that had no say no more than another one does, but for chance. What is smoothed much needs few triangles. Beside it whether it leaves
/// less than the mesh itself, beyond chance, with a lobe of `model`. `None` where even the least smooth ones leave more than the mesh,
/// beyond chance: what is smoothed away is no noise.
pub fn smoothed(
    solver: &Solver<'_>,
    model: SpecularModel,
    watch: &mut Watch<'_>,
) -> Result<Option<(Relief, bool)>, Stopped> {
    let pixels = |surface: &ViewSurface| {
        let object = surface.triangle.iter().filter(|&&t| t != NO_TRIANGLE);
        object.count()
    };
    let largest = solver.seen.surfaces.iter().map(pixels).max().unwrap_or(0);
    // What predicts views best on the mesh does so on other surfaces too, or nearly.
    let (sigma, unsmoothed) = at_best_roughness(solver, model);
    let brdf = Brdf::new(model, sigma);
    let mut tried: Vec<Smoothed> = Vec::new();
    let mut least = f64::INFINITY;
    let mut simpler: Option<(usize, Smoothing, f64)> = None;
    // Each simpler mesh is made of that before it.
    let mut last: Option<Mesh> = None;
    for (round, some) in SMOOTHINGS.chunks(AT_ONCE).enumerate() {
        go_on(watch.observer.progress("smoothing the surface", 0.3))?;
        let (coarser, _) = some[0];
        let known = simpler.take().filter(|(times, ..)| *times == coarser);
        let Some((_, mesh, spacing)) = known.or_else(|| {
            let triangles = largest.min(MOST_TRIANGLES) / coarser;
            let mesh = simplified(last.as_ref().unwrap_or(solver.seen.mesh), triangles);
            let level = Some((coarser, Smoothing::new(&mesh)?, spacing(&mesh)));
            last = Some(mesh);
            level
        }) else {
            continue;
        };
        let smooth =
            |&(_, length): &(usize, f64)| Smoothed::of(solver, brdf, (&mesh, spacing), length);
        let found: Vec<_> = some.par_iter().filter_map(smooth).collect();
        tried.extend(found);
        let is_worse = |smoothed: &Smoothed| leaves_less(&smoothed.left, &unsmoothed) > CHANCE;
        if round == 0 && !tried.is_empty() && tried.iter().all(is_worse) {
            return Ok(None);
        }
        simpler = Some((coarser, mesh, spacing));
        least = tried.iter().map(Smoothed::total).fold(least, f64::min);
        let is_last = |last: &Smoothed| last.total() > TOO_MUCH * least;
        if tried.last().is_some_and(is_last) {
            break;
        }
    }
    let Some(best) = tried.iter().position(|s| s.total() <= least) else {
        return Ok(None);
    };
    let left = &tried[best].left;
    let is_as_good = |s: &&Smoothed| leaves_less(&s.left, left) <= AS_GOOD;
    let smoother = tried[best + 1..].iter().take_while(is_as_good);
    let smoothest = best + smoother.count();
    let Smoothed { relief, left } = tried.swap_remove(smoothest);
    let is_better = leaves_less(&unsmoothed, &left) > CHANCE;
    Ok(Some((relief, is_better)))
}

/// Mean length of the edges of a mesh with one vertex a place.
fn spacing(mesh: &Mesh) -> f64 {
    let edges = mesh.triangles.iter().flat_map(|&[a, b, c]| {
        [(a, b), (b, c), (c, a)].map(|(p, q)| {
            let [p, q] = [p, q].map(|v| mesh.positions[v as usize]);
            f64::from(p.distance(q))
        })
    });
    edges.sum::<f64>() / (3 * mesh.triangles.len()).max(1) as f64
}

/// Pixels that a triangle covers in a view that shows it, in the mean.
pub fn pixels_per_triangle(seen: &Seen<'_>) -> f64 {
    let (mut pixels, mut shown) = (0_usize, 0_usize);
    for surface in seen.surfaces {
        let object = surface.triangle.iter().filter(|&&t| t != NO_TRIANGLE);
        let mut triangles: Vec<u32> = object.copied().collect();
        pixels += triangles.len();
        triangles.sort_unstable();
        triangles.dedup();
        shown += triangles.len();
    }
    pixels as f64 / shown.max(1) as f64
}
