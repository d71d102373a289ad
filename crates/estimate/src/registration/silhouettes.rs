//! What an object and its mesh cover of a picture.

use glam::DVec2;

use rekindle_scene::surface::{NO_TRIANGLE, ViewSurface};

/// The object's silhouette and the mesh's.
pub struct Silhouettes {
    /// Pixels of both over those of either.
    pub overlap: f64,
    /// Centres of mass in pixels, of the object's and of the mesh's; none of an empty one.
    pub centres: [Option<DVec2>; 2],
}

impl Silhouettes {
    /// Of a photograph's coverage and what its camera sees of the mesh; none if both are empty.
    pub fn new(coverage: &[f32], surface: &ViewSurface) -> Option<Self> {
        let (mut both, mut either) = (0_usize, 0_usize);
        let mut sums = [DVec2::ZERO; 2];
        let mut counts = [0_usize; 2];
        let width = surface.width as usize;
        for (i, (&cover, &triangle)) in coverage.iter().zip(&surface.triangle).enumerate() {
            let shown = [cover > 0.5, triangle != NO_TRIANGLE];
            both += usize::from(shown[0] && shown[1]);
            either += usize::from(shown[0] || shown[1]);
            for k in 0..2 {
                if shown[k] {
                    sums[k] += DVec2::new((i % width) as f64, (i / width) as f64) + 0.5;
                    counts[k] += 1;
                }
            }
        }
        let centre = |k: usize| (counts[k] > 0).then(|| sums[k] / counts[k] as f64);
        (either > 0).then(|| Self {
            overlap: both as f64 / either as f64,
            centres: [centre(0), centre(1)],
        })
    }

    /// How far the object's lies from the mesh's, in pixels; zero where one is empty.
    pub fn shift(&self) -> DVec2 {
        match self.centres {
            [Some(object), Some(mesh)] => object - mesh,
            _ => DVec2::ZERO,
        }
    }
}
