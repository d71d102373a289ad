//! The renderer: keeps what doesn't change, redoes what does, refines what is still.

use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;
use half::f16;

use super::accumulate::AccumulatePass;
use super::baker::{Baked, Baker, Order};
use super::combine::{CombinePass, LayerTexture};
use super::display::{Display, DisplayPass};
use super::error::RenderError;
use super::frame::{COVERAGE, FIRST_SHADOW_MAP, Frame, GpuLobe, GpuShadowMap, LINEAR, STORED};
use super::gpu::Gpu;
use super::light::{self, Part, PartKind};
use super::light_picture::light_picture;
use super::lists::{self, Lists, Lit, Soft};
use super::pace::Pace;
use super::read_back::{LinearImage, ReadBack};
use super::request::{Background, FrameRequest, Mode};
use super::shade::{SHADOWS_SIZE, SceneBindings, ShadePass};
use super::shadow::{MAX_SHADOW_MAPS, ShadowPass, shadow_map};
use super::surface::{Surface, SurfaceBuffers, bits, surface_layout, to_half};
use super::targets::{Pictures, Targets, Which};
use super::visible::VisiblePass;
use rekindle_capture::Camera;
use rekindle_relight::{Lighting, Shader, ShadingPoint, Sky, SkyLevel};
use rekindle_scene::reflectance::SpecularModel;
use rekindle_scene::surface::GlossTexture;

/// Baked parts of the light that are kept although the lighting has them no more: for undo, and to compare looks.
const SPARE_LAYERS: usize = 16;

/// The brightest radiance of an environment's sky on the device: half floats have three digits from there down to a hundred
/// millionth of it.
const SKY_BRIGHTEST: f32 = 1e4;

/// Storage buffers that a shader reads.
const STORAGE_BUFFERS: u32 = 6;

/// A picture on the device.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'a> {
    /// The picture: display values, sRGB-encoded, opaque.
    pub view: &'a wgpu::TextureView,
    /// Another number means another texture: hand it to the window's toolkit again.
    pub texture_id: u64,
    /// Whether it will not get better.
    pub settled: bool,
}

/// What the baker was asked for.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Ordered {
    None,
    Drafts,
    All,
}

/// A part of the light that is baked.
struct Layer {
    id: u64,
    shape: Lighting,
    texture: LayerTexture,
    visibility: Vec<u8>,
    soft: Option<Soft>,
    /// Whether the exact one is still to come.
    draft: bool,
    /// Number of the lighting that used it last.
    used: u64,
}

/// A part of the light as it is now.
struct Current {
    part: Part,
    /// Names its shape.
    id: u64,
}

/// The light on the device.
struct Light {
    parts: Vec<Current>,
    /// Whether it is the captured lighting, so that the stored texture is its diffuse part.
    stored: bool,
    lists: Lists,
    /// Shadow maps of lamps that are not baked.
    maps: Vec<GpuShadowMap>,
    /// For each lamp of the lighting's list what the shader's shadow mode is told.
    shown_lamps: Vec<u32>,
    /// Irradiance by an ambient part that is not baked, in units of the surface.
    ambient: Vec3,
}

/// The pictures of an environment's sky on the device.
struct SkyTexture {
    /// What they were made of; without any a black one stands for them.
    levels: Option<Arc<Vec<SkyLevel>>>,
    /// Radiance of 1 on the device, in units of the pictures.
    unit: f32,
    view: wgpu::TextureView,
}

impl SkyTexture {
    fn new(gpu: &Gpu, sky: Option<&Sky>) -> Result<Self, RenderError> {
        let levels = sky.map(Sky::levels);
        let finest = levels.iter().flat_map(|levels| &levels[0].radiance);
        let brightest = finest.fold(0.0, |most: f32, r| most.max(r.max_element()));
        let unit = (brightest / SKY_BRIGHTEST).max(f32::MIN_POSITIVE);
        let halves: Vec<Vec<[u16; 4]>> = levels.map_or_else(
            || vec![vec![[0; 4]; 2]],
            |levels| {
                let of = |level: &SkyLevel| -> Vec<[f16; 4]> {
                    (level.radiance.iter())
                        .map(|&r| to_half(r / unit, 1.0))
                        .collect()
                };
                levels.iter().map(|level| bits(&of(level))).collect()
            },
        );
        let rows = levels.map_or(1, |levels| levels[0].rows as u32);
        let bytes: Vec<&[u8]> = halves.iter().map(|h| bytemuck::cast_slice(h)).collect();
        let texture = gpu.guarded("the environment", || {
            gpu.texture_of_levels("sky", [2 * rows, rows], LINEAR, &bytes)
        })?;
        Ok(Self {
            levels: levels.cloned(),
            unit,
            view: texture.create_view(&wgpu::TextureViewDescriptor::default()),
        })
    }

    /// Whether it is of this sky, however turned and bright that is.
    fn is_of(&self, sky: Option<&Sky>) -> bool {
        match (&self.levels, sky) {
            (Some(levels), Some(sky)) => Arc::ptr_eq(levels, sky.levels()),
            (levels, sky) => levels.is_none() && sky.is_none(),
        }
    }
}

/// A surface on the device.
struct Loaded {
    surface: Arc<Surface>,
    buffers: SurfaceBuffers,
    irradiance: wgpu::TextureView,
    lighting: Lighting,
    light: Light,
    layers: Vec<Layer>,
    visibility: wgpu::TextureView,
    /// Shapes whose visibility the texture holds, by place.
    visible_ids: Vec<u64>,
    sky: SkyTexture,
    bindings: wgpu::BindGroup,
}

/// What a linear picture depends on.
#[derive(Clone, PartialEq)]
struct PictureKey {
    camera: CameraKey,
    mode: Mode,
    light: u64,
}

/// A camera to be compared.
#[derive(Clone, PartialEq)]
struct CameraKey {
    size: [u32; 2],
    focal: glam::DVec2,
    centre: glam::DVec2,
    distortion: rekindle_capture::Distortion,
    pose: glam::DAffine3,
}

impl CameraKey {
    fn new(camera: &Camera) -> Self {
        Self {
            size: [camera.width, camera.height],
            focal: camera.focal,
            centre: camera.centre,
            distortion: camera.distortion,
            pose: camera.world_from_camera,
        }
    }
}

/// Draws a surface under any light; see the module's head.
pub struct Renderer {
    gpu: Gpu,
    surface_layout: wgpu::BindGroupLayout,
    visible: VisiblePass,
    shade: ShadePass,
    shadow: ShadowPass,
    combine: CombinePass,
    accumulate: AccumulatePass,
    display: DisplayPass,
    baker: Baker,
    loaded: Option<Loaded>,
    pictures: Pictures,
    /// Counts changes of anything that the picture depends on besides the request.
    light_number: u64,
    next_id: u64,
    /// What the light's picture was last made for.
    light_picture: (u64, wgpu::TextureView),
    drawn: Option<PictureKey>,
    displayed: Option<Display>,
    /// Frames of the still picture so far.
    refined: u32,
    /// How much of the next frame is drawn at a time.
    pace: Pace,
    /// Parts that were ordered for the light as it is: none, drafts alone, or all.
    ordered: Ordered,
}

impl Renderer {
    /// Makes all pipelines. Takes a tenth of a second on a software driver.
    pub fn new(gpu: Gpu) -> Result<Self, RenderError> {
        let limits = gpu.device().limits();
        if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
            return Err(RenderError::Limit {
                what: "the renderer's shaders, in storage buffers,".to_owned(),
                needed: STORAGE_BUFFERS.into(),
                allowed: limits.max_storage_buffers_per_shader_stage.into(),
                advice: "install a Vulkan driver",
            });
        }
        let light_picture = gpu.guarded("the light", || light_texture(&gpu, [1, 1], &[[0; 4]]))?;
        let surface_layout = gpu.guarded("the surface", || surface_layout(&gpu))?;
        let visible = VisiblePass::new(&gpu, &surface_layout)?;
        Ok(Self {
            shade: ShadePass::new(&gpu, &visible.frame_layout, &surface_layout)?,
            shadow: ShadowPass::new(&gpu, &surface_layout)?,
            visible,
            surface_layout,
            combine: CombinePass::new(&gpu)?,
            accumulate: AccumulatePass::new(&gpu)?,
            display: DisplayPass::new(&gpu)?,
            baker: Baker::new()?,
            loaded: None,
            pictures: Pictures::default(),
            light_number: 0,
            next_id: 1,
            light_picture: (0, light_picture),
            drawn: None,
            displayed: None,
            refined: 0,
            pace: Pace::new(&gpu),
            ordered: Ordered::All,
            gpu,
        })
    }

    /// The device it draws with.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// What to call, from another thread, when something drawn before can be drawn better: a request to repaint.
    pub fn set_waker(&self, waker: impl Fn() + Send + 'static) {
        self.baker.set_waker(Box::new(waker));
    }

    /// Takes another surface, lit as it was captured.
    pub fn set_surface(&mut self, surface: Arc<Surface>) -> Result<(), RenderError> {
        self.gpu.check()?;
        let buffers = surface.upload(&self.gpu, &self.surface_layout)?;
        let size = [surface.light_atlas.width, surface.light_atlas.height];
        let (irradiance, visibility) = self.gpu.guarded("baked light", || {
            let attachment =
                wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
            let irradiance =
                self.gpu
                    .texture("irradiance", [size[0], size[1], 1], LINEAR, attachment, 1);
            (
                irradiance.create_view(&wgpu::TextureViewDescriptor::default()),
                visibility_texture(&self.gpu, [1, 1], &[vec![255; 4]]),
            )
        })?;
        let lighting = surface.original.clone();
        let light = Light {
            parts: Vec::new(),
            stored: true,
            lists: Lists::default(),
            maps: Vec::new(),
            shown_lamps: Vec::new(),
            ambient: Vec3::ZERO,
        };
        let sky = SkyTexture::new(&self.gpu, None)?;
        let bindings = bind(
            &self.gpu,
            &self.shade,
            &self.shadow,
            [&irradiance, &visibility, &sky.view],
            &buffers,
            &light,
        )?;
        self.loaded = Some(Loaded {
            surface,
            buffers,
            irradiance,
            lighting,
            light,
            layers: Vec::new(),
            visibility,
            visible_ids: Vec::new(),
            sky,
            bindings,
        });
        self.relight()
    }

    /// Takes another lighting. Gain, colour and mute of lamps cost nothing; what moved is lit coarsely by the next frame
    /// and baked beside it.
    pub fn set_lighting(&mut self, lighting: &Lighting) -> Result<(), RenderError> {
        let loaded = self.loaded.as_mut().ok_or(RenderError::NoSurface)?;
        if loaded.lighting == *lighting {
            return Ok(());
        }
        loaded.lighting = lighting.clone();
        self.relight()
    }

    /// Whether drawing again would show something else, even if nothing is asked for that wasn't before.
    pub fn needs_redraw(&self) -> bool {
        let Some(loaded) = &self.loaded else {
            return false;
        };
        self.baker.has_results()
            || self.drawn.is_none()
            || self.pictures.is_quick()
            || self.refined < loaded.light.lists.frames()
    }

    /// Whether the last picture is final: baked exactly and refined.
    pub fn is_settled(&self) -> bool {
        !self.needs_redraw()
            && self.loaded.as_ref().is_some_and(|l| {
                l.light
                    .parts
                    .iter()
                    .all(|p| l.layer(p.id).is_some_and(|layer| !layer.draft))
            })
    }

    /// Draws a picture, or makes the last one better if it is the same that is asked for.
    pub fn draw(&mut self, request: &FrameRequest) -> Result<Shown<'_>, RenderError> {
        self.gpu.check()?;
        let size = [request.camera.width.max(1), request.camera.height.max(1)];
        self.take_baked()?;
        self.order(if request.dragging {
            Ordered::Drafts
        } else {
            Ordered::All
        });
        if self.make_targets(Which::Whole, size)? {
            self.drawn = None;
        }
        self.update_light_picture(request.background)?;
        let key = PictureKey {
            camera: CameraKey::new(&request.camera),
            mode: request.mode,
            light: self.light_number,
        };
        let mut encoder = self
            .gpu
            .device()
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let moved = self.drawn.as_ref() != Some(&key);
        let changed = if moved {
            self.refined = 0;
            self.pace.restart();
            self.start(&mut encoder, request)?;
            self.drawn = Some(key);
            true
        } else if self.pictures.is_quick() {
            self.complete(&mut encoder, request)?
        } else {
            self.refine(&mut encoder, request)?
        };
        self.show(&mut encoder, request, changed)?;
        let commands = encoder.finish();
        if moved && request.quick {
            self.pace.submit_moving(&self.gpu, commands)?;
        } else {
            self.gpu.queue().submit([commands]);
        }
        if !moved {
            self.pace.time(&self.gpu);
        }
        let settled = self.is_settled();
        let targets = self.pictures.of(self.pictures.shown)?;
        Ok(Shown {
            view: &targets.shown_view,
            texture_id: targets.id,
            settled,
        })
    }

    /// Draws until the picture is final, baking included. For exports and tests; a window calls `draw` once a frame.
    pub fn draw_settled(&mut self, request: &FrameRequest) -> Result<Shown<'_>, RenderError> {
        let request = FrameRequest {
            dragging: false,
            quick: false,
            ..request.clone()
        };
        self.draw(&request)?;
        while !self.is_settled() {
            if !self.needs_redraw() {
                self.baker.wait();
            }
            self.draw(&request)?;
        }
        self.draw(&request)
    }

    /// Waits for the last picture and copies its linear values: radiance in the capture's units for the modes that show
    /// radiance, else what is shown.
    pub fn read_back(&self) -> Result<LinearImage, RenderError> {
        let (copy, unit) = self.start_read_back()?;
        copy.image(&self.gpu, unit)
    }

    /// Starts copying the last picture's linear values; a window must not wait for them.
    pub fn read_back_later(&self) -> Result<PendingImage, RenderError> {
        let (copy, unit) = self.start_read_back()?;
        Ok(PendingImage {
            gpu: self.gpu.clone(),
            copy,
            unit,
        })
    }

    /// Waits for the last picture and copies what is shown: RGBA, 8 bits, sRGB-encoded, row by row from the top.
    pub fn read_shown(&self) -> Result<Vec<u8>, RenderError> {
        let targets = self.pictures.of(self.pictures.shown)?;
        ReadBack::start(&self.gpu, &targets.shown, targets.size, 4)?.bytes(&self.gpu, 4)
    }

    fn start_read_back(&self) -> Result<(ReadBack, f32), RenderError> {
        let targets = self.pictures.of(self.pictures.shown)?;
        let loaded = self.loaded.as_ref().ok_or(RenderError::NoSurface)?;
        let texture = if self.is_refined() {
            &targets.mean
        } else {
            &targets.moving
        };
        let unit = match self.drawn.as_ref().map(|key| key.mode) {
            Some(mode) if mode.display_kind() == 0 => loaded.surface.unit,
            _ => 1.0,
        };
        Ok((ReadBack::start(&self.gpu, texture, targets.size, 8)?, unit))
    }

    /// Whether the still picture is complete, and shown instead of the moving one.
    fn is_refined(&self) -> bool {
        self.loaded
            .as_ref()
            .is_some_and(|l| self.refined >= l.light.lists.frames())
    }

    /// Brings the device up to date with the lighting.
    fn relight(&mut self) -> Result<(), RenderError> {
        let loaded = self.loaded.as_mut().ok_or(RenderError::NoSurface)?;
        self.light_number += 1;
        let parts = light::split(&loaded.lighting);
        let current: Vec<Current> = parts
            .into_iter()
            .map(|part| {
                let known = loaded
                    .layers
                    .iter()
                    .find(|l| part.has_shape(&l.shape))
                    .map(|l| l.id);
                let waiting = loaded
                    .light
                    .parts
                    .iter()
                    .find(|c| part.has_shape(&c.part.shape))
                    .map(|c| c.id);
                let id = known.or(waiting).unwrap_or_else(|| {
                    self.next_id += 1;
                    self.next_id
                });
                Current { part, id }
            })
            .collect();
        loaded.light.parts = current;
        loaded.forget(self.light_number);
        self.ordered = Ordered::None;
        self.refresh()
    }

    /// Rebuilds what depends on the light's parts and on which of them are baked.
    fn refresh(&mut self) -> Result<(), RenderError> {
        let loaded = self.loaded.as_mut().ok_or(RenderError::NoSurface)?;
        let gpu = &self.gpu;
        loaded.update_visibility(gpu)?;
        loaded.light = loaded.listed(gpu);
        let sky = loaded.lighting.environment.as_ref().map(|e| &e.sky);
        if !loaded.sky.is_of(sky) {
            loaded.sky = SkyTexture::new(gpu, sky)?;
        }
        loaded.bindings = bind(
            gpu,
            &self.shade,
            &self.shadow,
            [&loaded.irradiance, &loaded.visibility, &loaded.sky.view],
            &loaded.buffers,
            &loaded.light,
        )?;
        let mut encoder = gpu
            .device()
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for (i, map) in loaded.light.maps.iter().enumerate() {
            self.shadow.draw(gpu, &mut encoder, i, map, &loaded.buffers);
        }
        let unit = loaded.surface.unit;
        let layers: Vec<(&LayerTexture, Vec3)> = loaded
            .light
            .parts
            .iter()
            .filter(|current| lists::is_on(current.part.weight))
            .filter_map(|current| {
                Some((
                    &loaded.layer(current.id)?.texture,
                    current.part.weight / unit,
                ))
            })
            .collect();
        self.combine
            .draw(gpu, &mut encoder, &loaded.irradiance, &layers);
        gpu.queue().submit([encoder.finish()]);
        self.light_number += 1;
        Ok(())
    }

    /// Uploads what the baker has finished.
    fn take_baked(&mut self) -> Result<(), RenderError> {
        let results = self.baker.take();
        let Some(loaded) = self.loaded.as_mut() else {
            return Ok(());
        };
        let mut changed = false;
        for baked in results {
            let Some(current) = loaded.light.parts.iter().find(|c| c.id == baked.id) else {
                continue;
            };
            let atlas = &loaded.surface.light_atlas;
            // A result for the surface before this one has another size.
            let known = loaded
                .layer(baked.id)
                .is_some_and(|layer| baked.draft || !layer.draft);
            if baked.irradiance.len() != atlas.len() || known {
                continue;
            }
            let Baked {
                id,
                draft,
                irradiance,
                visibility,
                groups,
                soft,
            } = baked;
            let texture =
                self.combine
                    .upload(&self.gpu, [atlas.width, atlas.height], &bits(&irradiance))?;
            loaded.layers.retain(|layer| layer.id != id);
            loaded.layers.push(Layer {
                id,
                draft,
                shape: current.part.shape.clone(),
                texture,
                visibility,
                soft: (groups > 0).then_some(Soft { groups, seen: soft }),
                used: self.light_number,
            });
            changed = true;
        }
        if changed { self.refresh() } else { Ok(()) }
    }

    /// Asks the baker for all parts that are not baked; while a lamp is dragged, for drafts of what has drafts.
    fn order(&mut self, wanted: Ordered) {
        let Some(loaded) = &self.loaded else { return };
        if self.ordered >= wanted {
            return;
        }
        self.ordered = wanted;
        let draft = wanted == Ordered::Drafts;
        let orders: Vec<Order> = loaded
            .light
            .parts
            .iter()
            .map(|current| Order {
                id: current.id,
                shape: current.part.shape.clone(),
                lamp: matches!(current.part.kind, PartKind::Lamp(_)),
                draft,
            })
            .filter(|order| match loaded.layer(order.id) {
                None => !(draft && order.lamp),
                Some(layer) => layer.draft && !draft,
            })
            .collect();
        self.baker.request(&loaded.surface, orders);
    }

    /// Makes what a picture is drawn into, if it is of another size; whether it was.
    fn make_targets(&mut self, which: Which, size: [u32; 2]) -> Result<bool, RenderError> {
        let light = &self.light_picture.1;
        self.pictures.resize(which, size, |id| {
            Targets::new(
                &self.gpu,
                (id, size),
                &self.shade,
                &self.accumulate,
                &self.display,
                light,
            )
        })
    }

    /// Makes the picture of the light where it is the background.
    fn update_light_picture(&mut self, background: Background) -> Result<(), RenderError> {
        let Some(loaded) = &self.loaded else {
            return Ok(());
        };
        if background != Background::Light || self.light_picture.0 == self.light_number {
            return Ok(());
        }
        let (size, halves) = light_picture(&loaded.lighting, loaded.surface.unit);
        let view = self.gpu.guarded("the light", || {
            light_texture(&self.gpu, size, &bits(&halves))
        })?;
        for targets in self.pictures.all() {
            targets.show = [&targets.moving_view, &targets.mean_view]
                .map(|v| self.display.bind(&self.gpu, v, &view));
        }
        self.light_picture = (self.light_number, view);
        self.displayed = None;
        Ok(())
    }

    fn frame(
        &self,
        request: &FrameRequest,
        jitter: [f32; 2],
    ) -> Result<(Frame, &Loaded), RenderError> {
        let loaded = self.loaded.as_ref().ok_or(RenderError::NoSurface)?;
        let (surface, light) = (&loaded.surface, &loaded.light);
        let brdf = surface.solution.brdf;
        let mut frame = Frame {
            sigma: brdf.map_or(0.0, |b| b.sigma),
            model: SpecularModel::shader_number(brdf.map(|b| b.model)),
            tint: (brdf.map_or(Vec3::ONE, |b| b.tint(loaded.lighting.specular_scale))).to_array(),
            strength: brdf.map_or(1.0, |b| b.strength),
            mode: request.mode.number(),
            flags: if light.stored { STORED } else { 0 },
            row_words: light.lists.row_words,
            window_weight: light.lists.windows.len().max(1) as f32,
            ambient: light.ambient.to_array(),
            irradiance_scale: surface.albedo_unit,
            strongest: (surface.solution.gloss.as_ref()).map_or(1.0, GlossTexture::strongest),
            walk_nodes: loaded.buffers.walk_nodes,
            half_vector: MEAN_HALF_VECTOR,
            shown_lamp: match request.mode {
                Mode::Shadow(lamp) => light.shown_lamps.get(lamp).copied().unwrap_or(NOT_SHOWN),
                _ => NOT_SHOWN,
            },
            ..Frame::default()
        };
        for map in 0..light.maps.len() {
            frame.flags |= FIRST_SHADOW_MAP << map;
        }
        if let Some(environment) = &loaded.lighting.environment {
            frame.set_sky(&environment.sky, surface.unit / loaded.sky.unit);
        }
        frame.set_camera(&request.camera, surface.centre, surface.radius, jitter);
        Ok((frame, loaded))
    }

    /// Starts another picture: with a quick one, where that is wanted and the device needs it.
    fn start(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        request: &FrameRequest,
    ) -> Result<(), RenderError> {
        let coarse = self.pace.coarse();
        let camera = &request.camera;
        if !request.quick || coarse == 1 {
            self.pictures.shown = Which::Whole;
            let all = 0..camera.height.max(1);
            return self.draw_moving(encoder, request, Which::Whole, all);
        }
        let [width, height] = [camera.width, camera.height].map(|side| side.div_ceil(coarse));
        self.make_targets(Which::Quick, [width.max(1), height.max(1)])?;
        self.pictures.shown = Which::Quick;
        let quick = FrameRequest {
            camera: camera.resized(width, height),
            ..request.clone()
        };
        self.draw_moving(encoder, &quick, Which::Quick, 0..height.max(1))
    }

    /// Draws what the whole picture lacks where a quick one is shown, or as much of it as takes a moment; whether that completes it.
    fn complete(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        request: &FrameRequest,
    ) -> Result<bool, RenderError> {
        let height = request.camera.height.max(1);
        let rows = self.pace.next(height);
        let is_last = rows.end == height;
        self.draw_moving(encoder, request, Which::Whole, rows)?;
        if is_last {
            self.pictures.shown = Which::Whole;
        }
        Ok(is_last)
    }

    /// Draws rows of a picture as it is shown while things move.
    fn draw_moving(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        request: &FrameRequest,
        which: Which,
        rows: Range<u32>,
    ) -> Result<(), RenderError> {
        let (mut frame, loaded) = self.frame(request, [0.0; 2])?;
        let targets = self.pictures.of(which)?;
        let moving = &loaded.light.lists.moving;
        frame.always = [moving.range.start, moving.range.end];
        frame.first_word = moving.first_word;
        frame.flags |= COVERAGE;
        if rows.start == 0 {
            self.visible.cover(
                encoder,
                &loaded.buffers,
                &targets.coverage_samples,
                &targets.coverage,
            );
        }
        let pixels = &targets.shade_moving;
        self.draw_surface(encoder, &mut frame, loaded, targets, pixels, &rows);
        Ok(())
    }

    /// Finds what is visible and shades it.
    fn draw_surface(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        frame: &mut Frame,
        loaded: &Loaded,
        targets: &Targets,
        pixels: &wgpu::BindGroup,
        rows: &Range<u32>,
    ) {
        frame.rows = [rows.start, rows.end];
        self.visible.set_frame(&self.gpu, frame);
        self.visible.draw(
            encoder,
            &loaded.buffers,
            &targets.visible,
            &targets.depth,
            rows,
        );
        let groups = [
            &self.visible.frame_group,
            &loaded.buffers.group,
            &loaded.bindings,
            pixels,
        ];
        self.shade.run(encoder, groups, targets.size[0], rows);
    }

    /// Adds a frame, or as much of one as takes a moment, to the still picture if it isn't complete; whether that completes a frame.
    fn refine(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        request: &FrameRequest,
    ) -> Result<bool, RenderError> {
        if self.is_refined() {
            return Ok(false);
        }
        let height = request.camera.height.max(1);
        let rows = self.pace.next(height);
        let (mut frame, loaded) = self.frame(request, lists::jitter(self.refined))?;
        let targets = self.pictures.of(Which::Whole)?;
        let light = &loaded.light.lists;
        frame.always = [light.always.range.start, light.always.range.end];
        frame.half_vector = self.refined % lists::PLACES;
        frame.first_word = light.always.first_word;
        if !light.windows.is_empty() {
            let window = &light.windows[self.refined as usize % light.windows.len()];
            frame.window = [window.range.start, window.range.end];
            frame.first_word = window.first_word;
        }
        let pixels = &targets.shade_still;
        self.draw_surface(encoder, &mut frame, loaded, targets, pixels, &rows);
        let weight = 1.0 / light.frames() as f32;
        let first = self.refined == 0 && rows.start == 0;
        self.accumulate
            .draw(&self.gpu, encoder, targets, &rows, weight, first);
        let is_last = rows.end == height;
        self.refined += u32::from(is_last);
        Ok(is_last)
    }

    /// Writes the shown picture if it would be another one.
    fn show(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        request: &FrameRequest,
        changed: bool,
    ) -> Result<(), RenderError> {
        let refined = self.is_refined();
        let targets = self.pictures.of(self.pictures.shown)?;
        let [width, height] = targets.size;
        let camera = request.camera.resized(width, height);
        let axes = camera.world_from_camera.matrix3.transpose();
        let row = |axis: glam::DVec3| axis.as_vec3().extend(0.0).to_array();
        let (colour, light) = match request.background {
            Background::Colour(colour) => (colour, 0.0),
            Background::Light => ([0.0; 3], 1.0),
        };
        let display = Display {
            background: [colour[0], colour[1], colour[2], light],
            world_x: row(axes.x_axis),
            world_y: row(axes.y_axis),
            world_z: row(axes.z_axis),
            focal: camera.focal.as_vec2().to_array(),
            centre: camera.centre.as_vec2().to_array(),
            exposure: request.exposure_ev.exp2(),
            transform: request.transform as u32,
            kind: request.mode.display_kind(),
            pad: 0,
        };
        // Frames of an unfinished still picture aren't shown.
        let picture_changed = changed && (refined || self.refined == 0);
        if self.displayed == Some(display) && !picture_changed {
            return Ok(());
        }
        let picture = &targets.show[usize::from(refined)];
        self.display
            .draw(&self.gpu, encoder, &display, picture, &targets.shown_view);
        self.displayed = Some(display);
        Ok(())
    }
}

/// Neither a place in the visibility texture nor a shadow map: seen by all.
const NOT_SHOWN: u32 = 256 + MAX_SHADOW_MAPS as u32;

/// Not one of a lobe's half vectors but the middle of all.
const MEAN_HALF_VECTOR: u32 = lists::PLACES;

/// A copy of a picture on its way from the device.
pub struct PendingImage {
    gpu: Gpu,
    copy: ReadBack,
    unit: f32,
}

impl PendingImage {
    /// Whether it has arrived.
    pub fn is_ready(&self) -> bool {
        self.copy.is_ready(&self.gpu)
    }

    /// The picture; waits if it hasn't arrived.
    pub fn finish(self) -> Result<LinearImage, RenderError> {
        self.copy.image(&self.gpu, self.unit)
    }
}

impl Loaded {
    fn layer(&self, id: u64) -> Option<&Layer> {
        self.layers.iter().find(|layer| layer.id == id)
    }

    /// Marks the layers in use and drops the oldest of the others.
    fn forget(&mut self, number: u64) {
        for layer in &mut self.layers {
            if self.light.parts.iter().any(|c| c.id == layer.id) {
                layer.used = number;
            }
        }
        let mut spare: Vec<u64> = self
            .layers
            .iter()
            .filter(|l| l.used != number)
            .map(|l| l.used)
            .collect();
        if spare.len() > SPARE_LAYERS {
            spare.sort_unstable_by(|a, b| b.cmp(a));
            let oldest = spare[SPARE_LAYERS - 1];
            self.layers.retain(|l| l.used >= oldest);
        }
    }

    /// Fills the visibility texture with the lamps' seen parts, if they are others than before.
    fn update_visibility(&mut self, gpu: &Gpu) -> Result<(), RenderError> {
        let parts: Vec<Part> = self.light.parts.iter().map(|c| c.part.clone()).collect();
        let mut ids = Vec::new();
        for (current, place) in self.light.parts.iter().zip(lists::places(&parts)) {
            if place.is_some() {
                ids.push(if self.layer(current.id).is_some() {
                    current.id
                } else {
                    0
                });
            }
        }
        if ids == self.visible_ids || ids.is_empty() {
            return Ok(());
        }
        let atlas = &self.surface.light_atlas;
        let layers: Vec<Vec<u8>> = ids
            .chunks(4)
            .map(|four| {
                let mut bytes = vec![255; 4 * atlas.len()];
                for (channel, id) in four.iter().enumerate() {
                    if let Some(layer) = self.layer(*id) {
                        for (texel, &seen) in bytes.chunks_exact_mut(4).zip(&layer.visibility) {
                            texel[channel] = seen;
                        }
                    }
                }
                bytes
            })
            .collect();
        self.visibility = gpu.guarded("the lamps' visibility", || {
            visibility_texture(gpu, [atlas.width, atlas.height], &layers)
        })?;
        self.visible_ids = ids;
        Ok(())
    }

    /// The light as the shader wants it.
    fn listed(&mut self, gpu: &Gpu) -> Light {
        let surface = Arc::clone(&self.surface);
        let solution = &surface.solution;
        let current = std::mem::take(&mut self.light.parts);
        let parts: Vec<Part> = current.iter().map(|c| c.part.clone()).collect();
        let places = lists::places(&parts);
        let mut shown_lamps = vec![NOT_SHOWN; self.lighting.lamps.len()];
        let mut maps = Vec::new();
        let mut ambient = Vec3::ZERO;
        let mut lit = Vec::new();
        for (i, part) in parts.iter().enumerate() {
            let layer = self.layer(current[i].id);
            let mut map = None;
            if let (None, PartKind::Lamp(_), [lamp]) =
                (layer, part.kind, part.shape.lamps.as_slice())
                && maps.len() < MAX_SHADOW_MAPS
            {
                map = shadow_map(lamp, surface.radius).map(|new| {
                    maps.push(new);
                    maps.len() - 1
                });
            }
            if let (None, PartKind::Ambient) = (layer, part.kind) {
                ambient =
                    self.ambient_irradiance(&part.shape) * part.weight / surface.irradiance_unit();
            }
            if let PartKind::Lamp(index) = part.kind {
                shown_lamps[index] = match (layer, places[i], map) {
                    (Some(_), Some(place), _) => place as u32,
                    (None, _, Some(map)) => 256 + map as u32,
                    _ => NOT_SHOWN,
                };
            }
            if lists::is_on(part.weight) {
                lit.push(Lit {
                    part,
                    baked: layer.is_some(),
                    place: places[i],
                    shadow_map: map,
                    soft: layer.and_then(|l| l.soft.as_ref()),
                });
            }
        }
        let limit = gpu.device().limits().max_storage_buffer_binding_size;
        let narrowest = solution.gloss.as_ref().map_or(1.0, GlossTexture::narrowest);
        let sigma = solution.brdf.map(|b| narrowest * b.sigma);
        let lists = Lists::new(&lit, sigma, surface.unit, &surface.openness, limit);
        Light {
            stored: self.lighting == surface.original,
            parts: current,
            lists,
            maps,
            shown_lamps,
            ambient,
        }
    }

    /// Irradiance by an ambient part, anywhere.
    fn ambient_irradiance(&self, shape: &Lighting) -> Vec3 {
        let shader = Shader::new(&self.surface.occluder, self.surface.solution.brdf, shape);
        let anywhere = ShadingPoint::smooth(self.surface.centre, Vec3::Y);
        shader.irradiance(&anywhere, &[])
    }
}

/// Copies the light to the device and binds everything that the surface's shader reads.
fn bind(
    gpu: &Gpu,
    shade: &ShadePass,
    shadow: &ShadowPass,
    [irradiance, visibility, sky]: [&wgpu::TextureView; 3],
    surface: &SurfaceBuffers,
    light: &Light,
) -> Result<wgpu::BindGroup, RenderError> {
    gpu.guarded("the light", || {
        let filled = |label: &str, bytes: &[u8], usage| {
            let buffer = gpu.buffer(label, bytes.len() as u64, usage);
            if !bytes.is_empty() {
                gpu.queue().write_buffer(&buffer, 0, bytes);
            }
            buffer
        };
        let storage = wgpu::BufferUsages::STORAGE;
        // An empty list still has room for one lobe, which no range names.
        let mut lobes = light.lists.lobes.clone();
        lobes.push(GpuLobe::default());
        let lobes = filled("lobes", bytemuck::cast_slice(&lobes), storage);
        let soft = filled(
            "visibility of vertices",
            bytemuck::cast_slice(&light.lists.rows),
            storage,
        );
        let shadows = gpu.buffer("shadow maps", SHADOWS_SIZE, wgpu::BufferUsages::UNIFORM);
        if !light.maps.is_empty() {
            gpu.queue()
                .write_buffer(&shadows, 0, bytemuck::cast_slice(&light.maps));
        }
        shade.bind(
            gpu,
            &SceneBindings {
                surface,
                irradiance,
                visibility,
                shadow_maps: &shadow.maps,
                lobes: &lobes,
                soft: &soft,
                shadows: &shadows,
                sky,
            },
        )
    })
}

/// Four lamps' visibilities to a layer.
fn visibility_texture(gpu: &Gpu, size: [u32; 2], layers: &[Vec<u8>]) -> wgpu::TextureView {
    let texture = gpu.texture(
        "visibility",
        [size[0], size[1], layers.len() as u32],
        wgpu::TextureFormat::Rgba8Unorm,
        wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        1,
    );
    for (layer, bytes) in layers.iter().enumerate() {
        gpu.fill(&texture, layer as u32, size, bytes);
    }
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..wgpu::TextureViewDescriptor::default()
    })
}

/// The light as a picture.
fn light_texture(gpu: &Gpu, size: [u32; 2], bits: &[[u16; 4]]) -> wgpu::TextureView {
    let texture = gpu.texture(
        "light",
        [size[0], size[1], 1],
        LINEAR,
        wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        1,
    );
    gpu.fill(&texture, 0, size, bytemuck::cast_slice(bits));
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}
