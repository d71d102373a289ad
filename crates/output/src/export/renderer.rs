//! A solution made ready for the reference renderer.

use std::ops::ControlFlow;

use rekindle_capture::Camera;
use rekindle_relight::{
    self as relight, Band, Diffuse, Interreflection, Lighting, Picture, Scene, Shader, Stop,
    Surroundings,
};
use rekindle_scene::surface::Occluder;
use rekindle_solution::Solution;

/// A solution with what rendering needs of its shape, whatever the light.
pub struct Renderer<'a> {
    solution: &'a Solution,
    occluder: Occluder,
    interreflection: Option<Interreflection>,
    original: Lighting,
}

/// A solution under one light.
pub struct LitScene<'a> {
    renderer: &'a Renderer<'a>,
    shader: Shader<'a>,
    surroundings: Option<Surroundings<'a>>,
    unchanged: bool,
}

impl<'a> Renderer<'a> {
    /// Prepares a solution: half a second or so.
    pub fn new(solution: &'a Solution) -> Self {
        let occluder = Occluder::new(&solution.mesh);
        let interreflection = Interreflection::new(&solution.mesh, &occluder, solution.brdf);
        Self {
            solution,
            occluder,
            interreflection,
            original: solution.lighting(),
        }
    }

    /// The solution.
    pub fn solution(&self) -> &'a Solution {
        self.solution
    }

    /// The captured lighting.
    pub fn original(&self) -> &Lighting {
        &self.original
    }

    /// Prepares a light. The captured lighting shows the stored diffuse texture, any other pseudo-albedo × irradiance.
    pub fn light(&'a self, lighting: &Lighting) -> LitScene<'a> {
        let solution = self.solution;
        let shader = Shader::new(&self.occluder, solution.brdf, lighting);
        let unchanged = *lighting == self.original;
        let (atlas, albedo) = (&solution.atlas, &solution.albedo);
        let texture = if unchanged { &solution.diffuse } else { albedo };
        let surroundings = self.interreflection.as_ref().map(|around| {
            let relit =
                (!unchanged).then(|| around.of_light(&solution.mesh, &shader, atlas, albedo));
            Surroundings::new(around, Some((atlas, texture)), relit)
        });
        LitScene {
            renderer: self,
            shader,
            surroundings,
            unchanged,
        }
    }
}

impl LitScene<'_> {
    fn scene(&self) -> Scene<'_> {
        let solution = self.renderer.solution;
        Scene {
            mesh: &solution.mesh,
            occluder: &self.renderer.occluder,
            brdf: solution.brdf,
            gloss: self.renderer.solution.gloss_map(),
            surroundings: self.surroundings.as_ref(),
        }
    }

    fn texture(&self) -> &[[f32; 3]] {
        if self.unchanged {
            &self.renderer.solution.diffuse
        } else {
            &self.renderer.solution.albedo
        }
    }

    fn diffuse(&self) -> Diffuse<'_> {
        let atlas = &self.renderer.solution.atlas;
        if self.unchanged {
            Diffuse::Stored(atlas, self.texture())
        } else {
            Diffuse::Relit(atlas, self.texture())
        }
    }

    /// Renders a picture.
    pub fn picture(&self, camera: &Camera) -> Picture {
        relight::render(&self.scene(), camera, &self.shader, self.diffuse())
    }

    /// Renders a picture band by band; see [`relight::render_bands`].
    pub fn bands(
        &self,
        camera: &Camera,
        stop: Stop,
        each: &mut dyn FnMut(&Band) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let (scene, diffuse) = (self.scene(), self.diffuse());
        relight::render_bands(&scene, camera, &self.shader, diffuse, stop, each)
    }
}
