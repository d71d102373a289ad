//! The graphics device: where it comes from, what it allows, and how its failures become values.

use std::sync::{Arc, Mutex, PoisonError};

use super::error::RenderError;

/// A graphics device with its limits. Clones share it.
#[derive(Clone)]
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    failure: Arc<Mutex<Option<RenderError>>>,
}

impl Gpu {
    /// Takes a device that a window made.
    ///
    /// From here on the device's errors and its loss are kept for [`Gpu::check`] instead of ending the program.
    pub fn new(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        let failure = Arc::new(Mutex::new(None));
        let keep = |failure: &Arc<Mutex<Option<RenderError>>>, error: RenderError| {
            let mut kept = failure.lock().unwrap_or_else(PoisonError::into_inner);
            // The first failure is the cause, those after it the consequences.
            kept.get_or_insert(error);
        };
        let uncaptured = Arc::clone(&failure);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            keep(&uncaptured, described("drawing", &error));
        }));
        let lost = Arc::clone(&failure);
        device.set_device_lost_callback(move |reason, message| {
            // A destroyed device takes what it is given without an error, and is lost like any other.
            let reason = if message.is_empty() {
                format!("{reason:?}").to_lowercase()
            } else {
                message
            };
            keep(&lost, RenderError::DeviceLost { reason });
        });
        Self {
            device,
            queue,
            failure,
        }
    }

    /// A device without a window: any adapter, software included, with the limits and features that a window's device has.
    pub fn headless() -> Result<Self, RenderError> {
        let none = |reason: String| RenderError::NoAdapter { reason };
        let instance =
            wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..wgpu::RequestAdapterOptions::default()
        }))
        .map_err(|e| none(e.to_string()))?;
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("rekindle"),
            ..wgpu::DeviceDescriptor::default()
        }))
        .map_err(|e| none(e.to_string()))?;
        Ok(Self::new(device, queue))
    }

    /// Name and kind of the adapter, as a person reads it.
    pub fn adapter_name(&self) -> String {
        let info = self.device.adapter_info();
        format!("{} ({:?}, {:?})", info.name, info.device_type, info.backend)
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// Its queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// The first failure since the device was taken, if there was one.
    pub fn check(&self) -> Result<(), RenderError> {
        let kept = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        kept.clone().map_or(Ok(()), Err)
    }

    /// Runs `make` and returns its result, or what the device had against it.
    pub(super) fn guarded<T>(
        &self,
        what: &str,
        make: impl FnOnce() -> T,
    ) -> Result<T, RenderError> {
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let made = make();
        let errors = [validation, internal, memory].map(|scope| pollster::block_on(scope.pop()));
        match errors.into_iter().flatten().next() {
            Some(error) => Err(described(what, &error)),
            None => Ok(made),
        }
    }

    /// Waits until the device has done everything it was given.
    pub fn wait(&self) -> Result<(), RenderError> {
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|e| RenderError::DeviceLost {
                reason: e.to_string(),
            })?;
        self.check()
    }

    /// Fails where a picture or texture of this size is more than the device allows.
    pub(super) fn check_texture(
        &self,
        what: &str,
        size: [u32; 2],
        advice: &'static str,
    ) -> Result<(), RenderError> {
        let allowed = self.device.limits().max_texture_dimension_2d;
        let needed = size[0].max(size[1]);
        if needed > allowed {
            return Err(RenderError::Limit {
                what: what.to_owned(),
                needed: needed.into(),
                allowed: allowed.into(),
                advice,
            });
        }
        Ok(())
    }

    /// A texture that shaders read.
    pub(super) fn texture(
        &self,
        label: &str,
        size: [u32; 3],
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
        samples: u32,
    ) -> wgpu::Texture {
        self.device.create_texture(&wgpu::TextureDescriptor {
            sample_count: samples,
            usage,
            ..plain(label, size, format)
        })
    }

    /// A texture to be read, of which each level has half the texels of the one before along each side: rows of bytes of each.
    pub(super) fn texture_of_levels(
        &self,
        label: &str,
        size: [u32; 2],
        format: wgpu::TextureFormat,
        levels: &[&[u8]],
    ) -> wgpu::Texture {
        let texture = self.device.create_texture(&wgpu::TextureDescriptor {
            mip_level_count: levels.len() as u32,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            ..plain(label, [size[0], size[1], 1], format)
        });
        for (level, bytes) in levels.iter().enumerate() {
            self.fill_level(
                &texture,
                [level as u32, 0],
                size.map(|side| side >> level),
                bytes,
            );
        }
        texture
    }

    /// Fills one layer of a texture of `size` texels with rows of `bytes`.
    pub(super) fn fill(&self, texture: &wgpu::Texture, layer: u32, size: [u32; 2], bytes: &[u8]) {
        self.fill_level(texture, [0, layer], size, bytes);
    }

    fn fill_level(
        &self,
        texture: &wgpu::Texture,
        [level, layer]: [u32; 2],
        size: [u32; 2],
        bytes: &[u8],
    ) {
        let row = bytes.len() as u32 / size[1].max(1);
        self.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture,
                mip_level: level,
                origin: wgpu::Origin3d {
                    x: 0,
                    y: 0,
                    z: layer,
                },
                aspect: wgpu::TextureAspect::All,
            },
            bytes,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(row),
                rows_per_image: Some(size[1]),
            },
            extent([size[0], size[1], 1]),
        );
    }

    /// A buffer that is written from here.
    pub(super) fn buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            // Copies need multiples of four, and an empty list still has to have room for one entry.
            size: size.next_multiple_of(16).max(96),
            usage: usage | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }
}

/// A flat texture of one level and one sample.
fn plain(label: &str, size: [u32; 3], format: wgpu::TextureFormat) -> wgpu::TextureDescriptor<'_> {
    wgpu::TextureDescriptor {
        label: Some(label),
        size: extent(size),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::empty(),
        view_formats: &[],
    }
}

/// Width, height and layers as the library wants them.
pub(super) fn extent([width, height, depth_or_array_layers]: [u32; 3]) -> wgpu::Extent3d {
    wgpu::Extent3d {
        width,
        height,
        depth_or_array_layers,
    }
}

fn described(what: &str, error: &wgpu::Error) -> RenderError {
    let what = what.to_owned();
    match error {
        wgpu::Error::OutOfMemory { .. } => RenderError::OutOfMemory { what },
        wgpu::Error::Validation { description, .. } | wgpu::Error::Internal { description, .. } => {
            RenderError::Refused {
                what,
                reason: description.clone(),
            }
        }
    }
}
