//! The picture as the graphics card draws it, and what is read back of it.

use std::sync::Arc;

use eframe::egui::{self, TextureId};
use eframe::egui_wgpu::RenderState;
use eframe::wgpu;
use glam::Vec3;

use super::display::Linear;
use crate::worker::{Latest, Worker};
use rekindle_relight::Lighting;
use rekindle_render::{FrameRequest, Gpu, PendingImage, RenderError, Renderer, Surface};
use rekindle_solution::Solution;

/// A solution on the graphics card.
pub struct GpuPicture {
    state: RenderState,
    renderer: Renderer,
    texture: Option<(u64, TextureId)>,
    /// Whether a surface is being made ready.
    preparing: bool,
    ready: Arc<Latest<Arc<Surface>>>,
    loaded: bool,
    /// Version of the lighting that is set.
    lit: Option<u64>,
    settled: bool,
    pending: Option<PendingImage>,
    linear: Option<Read>,
    reads: u64,
}

/// Linear values read back from the graphics card.
pub struct Read {
    /// Another number means another picture.
    pub number: u64,
    /// The values.
    pub picture: Linear,
}

impl GpuPicture {
    /// Takes the window's device. `ctx` is asked to repaint when light has been baked.
    pub fn new(state: &RenderState, ctx: &egui::Context) -> Result<Self, RenderError> {
        let renderer = Renderer::new(Gpu::new(state.device.clone(), state.queue.clone()))?;
        let ctx = ctx.clone();
        renderer.set_waker(move || ctx.request_repaint());
        Ok(Self {
            state: state.clone(),
            renderer,
            texture: None,
            preparing: false,
            ready: Arc::default(),
            loaded: false,
            lit: None,
            settled: false,
            pending: None,
            linear: None,
            reads: 0,
        })
    }

    /// Makes a solution ready beside the window's thread. Whether there is something to draw.
    pub fn prepare(
        &mut self,
        worker: &mut Worker,
        solution: &Arc<Solution>,
    ) -> Result<bool, RenderError> {
        if !self.preparing {
            self.preparing = true;
            let (solution, ready) = (Arc::clone(solution), Arc::clone(&self.ready));
            worker.aside("surface", move || {
                ready.store(Arc::new(Surface::new(solution)));
            });
        }
        if let Some(surface) = self.ready.take() {
            self.renderer.set_surface(surface)?;
            self.loaded = true;
        }
        Ok(self.loaded)
    }

    /// Draws a picture under the lighting of a version; returns it as a texture of the window.
    pub fn draw(
        &mut self,
        ctx: &egui::Context,
        request: &FrameRequest,
        version: u64,
        lighting: impl FnOnce() -> Option<Lighting>,
    ) -> Result<Option<TextureId>, RenderError> {
        if self.lit != Some(version) {
            let Some(lighting) = lighting() else {
                return Ok(None);
            };
            self.renderer.set_lighting(&lighting)?;
            self.lit = Some(version);
        }
        let shown = self.renderer.draw(request)?;
        let (view, number, settled) = (shown.view.clone(), shown.texture_id, shown.settled);
        let id = self.register(&view, number);
        if self.renderer.needs_redraw() {
            ctx.request_repaint();
        }
        self.settled = settled;
        if !settled {
            self.linear = None;
            self.pending = None;
        }
        Ok(Some(id))
    }

    /// Hands the picture's texture to the window's renderer, once for each texture.
    fn register(&mut self, view: &wgpu::TextureView, number: u64) -> TextureId {
        let mut egui = self.state.renderer.write();
        let filter = wgpu::FilterMode::Linear;
        let device = &self.state.device;
        if let Some((known, id)) = &mut self.texture {
            if *known != number {
                egui.update_egui_texture_from_wgpu_texture(device, view, filter, *id);
                *known = number;
            }
            return *id;
        }
        let id = egui.register_native_texture(device, view, filter);
        self.texture = Some((number, id));
        id
    }

    /// Whether the picture will not get better.
    pub fn is_settled(&self) -> bool {
        self.settled
    }

    /// Linear values of the settled picture, a few frames after they are first asked for.
    pub fn linear(&mut self, ctx: &egui::Context) -> Result<Option<&Read>, RenderError> {
        if self.linear.is_none() {
            match self.pending.take() {
                None => self.pending = Some(self.renderer.read_back_later()?),
                Some(pending) if pending.is_ready() => {
                    let image = pending.finish()?;
                    self.reads += 1;
                    let pixels = image.pixels.iter();
                    self.linear = Some(Read {
                        number: self.reads,
                        picture: Linear {
                            width: image.width as usize,
                            height: image.height as usize,
                            radiance: pixels
                                .clone()
                                .map(|p| Vec3::new(p[0], p[1], p[2]))
                                .collect(),
                            coverage: pixels.map(|p| p[3]).collect(),
                        },
                    });
                }
                Some(pending) => self.pending = Some(pending),
            }
            if self.linear.is_none() {
                ctx.request_repaint();
            }
        }
        Ok(self.linear.as_ref())
    }

    /// Linear values that were read back last, if the picture still shows them.
    pub fn read(&self) -> Option<&Linear> {
        self.linear.as_ref().map(|read| &read.picture)
    }
}

impl Drop for GpuPicture {
    fn drop(&mut self) {
        if let Some((_, id)) = self.texture {
            self.state.renderer.write().free_texture(&id);
        }
    }
}
