//! The picture in the window: the surface under any light, drawn by a graphics device. Plain data in, a texture out.
//!
//! ```no_run
//! # use std::sync::Arc;
//! # use rekindle_render::{Background, FrameRequest, Gpu, Mode, Renderer, Surface};
//! # fn show(solution: rekindle_solution::Solution, camera: rekindle_capture::Camera)
//! # -> Result<(), rekindle_render::RenderError> {
//! let gpu = Gpu::headless()?; // or Gpu::new(device, queue) with those of the window
//! let mut renderer = Renderer::new(gpu)?;
//! let surface = Arc::new(Surface::new(Arc::new(solution))); // takes a while: beside the window's thread
//! let mut lighting = surface.solution().lighting();
//! renderer.set_surface(surface)?;
//! lighting.lamps[0].muted = true;
//! renderer.set_lighting(&lighting)?; // whenever it changed; costs nothing if it didn't
//! let shown = renderer.draw(&FrameRequest {
//!     camera,
//!     mode: Mode::Beauty,
//!     exposure_ev: 0.0,
//!     transform: rekindle_relight::ViewTransform::Agx,
//!     background: Background::Colour([0.1; 3]),
//!     dragging: false,
//!     quick: true,
//! })?;
//! // shown.view is an Rgba8Unorm texture with sRGB-encoded values; register it again when shown.texture_id changes.
//! # let _ = shown.settled;
//! # Ok(())
//! # }
//! ```
//!
//! `draw` is called once per frame of the window. As long as [`Renderer::needs_redraw`] says so, the next `draw` makes the
//! picture better; then nothing need be drawn until something changes. [`Renderer::set_waker`] takes a function that asks
//! for a repaint when light has been baked. [`Renderer::read_back_later`] copies linear radiance for a pixel probe and a
//! histogram.
//!
//! How a frame comes about:
//!
//! * every part of the light (a lamp, the remainder, the environment, the ambient part) is baked once, for unit flux, by
//!   the reference renderer's own code on a background thread: irradiance with interreflection and, of lamps, visibility
//!   per texel, of other light visibility per vertex. `combine` adds the layers up with weights, so mute, gain and
//!   colour cost nothing;
//! * a part that isn't baked yet, such as a lamp that is dragged, is lit by its lobes and a shadow z-buffer (`shadow`);
//! * `visible` finds the triangle of every pixel and `shade` what it looks like: stored diffuse texture or pseudo-albedo ×
//!   irradiance (eq. 18), and the specular sum (eq. 7) over nodes merged into lobes (`lobes`). While things move a frame has
//!   few lobes, and only coverage has four samples a pixel;
//! * what the surface mirrors of itself and of an environment (`mirror.wgsl`, `sky.wgsl`) is traced with one ray a pixel and
//!   frame, or with four under an environment;
//! * where the device takes its time, something new is shown at once with larger pixels and then drawn whole in parts, between
//!   which the window hears its user (`pace`);
//! * a still picture is the mean of sixteen or more frames (`accumulate`), with the sub-pixel places of the reference
//!   renderer and all lobes. It depends on the request alone, not on what was drawn before;
//! * `display` applies exposure, view transform and background.
//!
//! The reference renderer (`relight::render`) has what is left out here: a visibility for each node of a lamp in its penumbra, and
//! for light of an environment that a metal shows by way of itself.

mod accumulate;
mod baker;
mod combine;
mod display;
mod error;
mod frame;
mod gpu;
mod light;
mod light_picture;
mod lists;
mod pace;
mod read_back;
mod renderer;
mod request;
mod shade;
mod shader;
mod shadow;
mod surface;
mod targets;
#[cfg(test)]
mod tests;
mod visible;

pub use error::RenderError;
pub use gpu::Gpu;
pub use read_back::LinearImage;
pub use renderer::{PendingImage, Renderer, Shown};
pub use request::{Background, FrameRequest, Mode};
pub use surface::Surface;
