//! The textures that pictures are drawn into.

use super::accumulate::AccumulatePass;
use super::display::{DisplayPass, SHOWN};
use super::error::RenderError;
use super::frame::{DEPTH, LINEAR};
use super::gpu::Gpu;
use super::shade::ShadePass;
use super::visible::{COVERED, SAMPLES, VISIBLE};

/// Which of a renderer's pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Which {
    /// The one that was asked for.
    #[default]
    Whole,
    /// One of larger pixels, for as long as the whole one is not done.
    Quick,
}

/// The pictures of a renderer.
#[derive(Default)]
pub(super) struct Pictures {
    /// What each is drawn into, by [`Which`].
    targets: [Option<Targets>; 2],
    /// The one that is shown.
    pub shown: Which,
    /// How many have been made.
    made: u64,
}

impl Pictures {
    /// What one is drawn into.
    pub(super) fn of(&self, which: Which) -> Result<&Targets, RenderError> {
        let targets = self.targets[which as usize].as_ref();
        targets.ok_or(RenderError::NoSurface)
    }

    /// Whether the quick one is shown.
    pub(super) fn is_quick(&self) -> bool {
        self.shown == Which::Quick
    }

    /// All that there are.
    pub(super) fn all(&mut self) -> impl Iterator<Item = &mut Targets> {
        self.targets.iter_mut().flatten()
    }

    /// Has one of another size made, which gets a number; whether it was of another.
    pub(super) fn resize(
        &mut self,
        which: Which,
        size: [u32; 2],
        make: impl FnOnce(u64) -> Result<Targets, RenderError>,
    ) -> Result<bool, RenderError> {
        let targets = &mut self.targets[which as usize];
        if targets.as_ref().is_some_and(|t| t.size == size) {
            return Ok(false);
        }
        // The old ones go first: both may not fit.
        *targets = None;
        self.made += 1;
        *targets = Some(make(self.made)?);
        Ok(true)
    }
}

/// What a picture is drawn into.
pub(super) struct Targets {
    /// Another number means other textures.
    pub id: u64,
    pub size: [u32; 2],
    /// The triangle of each pixel.
    pub visible: wgpu::TextureView,
    pub depth: wgpu::TextureView,
    /// Four samples of a pixel's coverage, and their mean.
    pub coverage_samples: wgpu::TextureView,
    pub coverage: wgpu::TextureView,
    /// The picture while things move.
    pub moving: wgpu::Texture,
    pub moving_view: wgpu::TextureView,
    /// Binds all these to shade the moving picture, and one frame of a still one.
    pub shade_moving: wgpu::BindGroup,
    pub shade_still: wgpu::BindGroup,
    /// The mean of all of them.
    pub mean: wgpu::Texture,
    pub mean_view: wgpu::TextureView,
    /// What the window shows.
    pub shown: wgpu::Texture,
    pub shown_view: wgpu::TextureView,
    /// Binds a frame of a still picture to be accumulated.
    pub accumulate: wgpu::BindGroup,
    /// Binds the moving and the still picture to be shown.
    pub show: [wgpu::BindGroup; 2],
}

impl Targets {
    pub(super) fn new(
        gpu: &Gpu,
        (id, size): (u64, [u32; 2]),
        shade: &ShadePass,
        accumulate: &AccumulatePass,
        display: &DisplayPass,
        light: &wgpu::TextureView,
    ) -> Result<Self, RenderError> {
        gpu.check_texture("the picture", size, "make the window smaller")?;
        gpu.guarded("the picture", || {
            let attachment = wgpu::TextureUsages::RENDER_ATTACHMENT;
            let read = attachment | wgpu::TextureUsages::TEXTURE_BINDING;
            let copied = read | wgpu::TextureUsages::COPY_SRC;
            let shaded =
                wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::STORAGE_BINDING;
            let make = |label, format, usage, samples| {
                gpu.texture(label, [size[0], size[1], 1], format, usage, samples)
            };
            let view = |t: &wgpu::Texture| t.create_view(&wgpu::TextureViewDescriptor::default());
            let visible = view(&make("visible", VISIBLE, read, 1));
            let coverage = view(&make("coverage", COVERED, read, 1));
            let moving = make("moving", LINEAR, shaded | wgpu::TextureUsages::COPY_SRC, 1);
            let mean = make("still", LINEAR, copied, 1);
            let shown = make("shown", SHOWN, copied, 1);
            let still_frame = view(&make("still frame", LINEAR, shaded, 1));
            let (moving_view, mean_view) = (view(&moving), view(&mean));
            Self {
                id,
                size,
                depth: view(&make("depth", DEPTH, attachment, 1)),
                coverage_samples: view(&make("coverage samples", COVERED, attachment, SAMPLES)),
                shade_moving: shade.bind_pixels(gpu, &visible, &coverage, &moving_view),
                shade_still: shade.bind_pixels(gpu, &visible, &coverage, &still_frame),
                accumulate: accumulate.bind(gpu, &still_frame),
                show: [
                    display.bind(gpu, &moving_view, light),
                    display.bind(gpu, &mean_view, light),
                ],
                shown_view: view(&shown),
                visible,
                coverage,
                moving,
                moving_view,
                mean,
                mean_view,
                shown,
            }
        })
    }
}
