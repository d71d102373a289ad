//! Pictures as photographs of a capture were taken, where the light may stand still with the camera.

use super::{LitScene, Renderer};
use rekindle_capture::{Camera, LightFrame};
use rekindle_relight::{Lighting, Picture};

/// A solution under one light, to be photographed from several places.
pub struct Photographer<'a> {
    renderer: &'a Renderer<'a>,
    lighting: &'a Lighting,
    /// The scene that all cameras see, where the light stands still with the object.
    still: Option<LitScene<'a>>,
}

impl<'a> Photographer<'a> {
    /// Prepares a light, as it stands to the object before the solution's first camera.
    pub fn new(renderer: &'a Renderer<'a>, lighting: &'a Lighting) -> Self {
        let still = match renderer.solution().light_frame {
            LightFrame::World => Some(renderer.light(lighting)),
            LightFrame::Camera => None,
        };
        Self {
            renderer,
            lighting,
            still,
        }
    }

    /// Renders what a camera sees, under the light as it stands to the object before it.
    pub fn picture(&self, camera: &Camera) -> Picture {
        if let Some(still) = &self.still {
            return still.picture(camera);
        }
        let solution = self.renderer.solution();
        let lighting = solution.lighting_before(self.lighting, camera);
        self.renderer.light(&lighting).picture(camera)
    }
}
