//! Pictures read back from the device: for the pixel probe, the histogram and tests.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

use half::f16;

use super::error::RenderError;
use super::gpu::{Gpu, extent};

/// A picture of linear radiance, row by row from the top.
#[derive(Clone, Debug)]
pub struct LinearImage {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// RGB premultiplied by coverage, and coverage. Radiance is in the capture's units.
    pub pixels: Vec<[f32; 4]>,
}

const WAITING: u8 = 0;
const READY: u8 = 1;
const FAILED: u8 = 2;

/// How long another thread may take to say that a copy has arrived.
const GRACE: Duration = Duration::from_secs(5);

/// A copy on its way.
pub(super) struct ReadBack {
    buffer: wgpu::Buffer,
    size: [u32; 2],
    row_bytes: u32,
    state: Arc<AtomicU8>,
}

impl ReadBack {
    /// Starts copying a texture with `texel_bytes` per texel.
    pub(super) fn start(
        gpu: &Gpu,
        texture: &wgpu::Texture,
        size: [u32; 2],
        texel_bytes: u32,
    ) -> Result<Self, RenderError> {
        let row_bytes =
            (size[0] * texel_bytes).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let bytes = u64::from(row_bytes) * u64::from(size[1]);
        let buffer = gpu.guarded("reading the picture back", || {
            let device = gpu.device();
            let buffer = device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("read back"),
                size: bytes,
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            let mut encoder =
                device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.copy_texture_to_buffer(
                texture.as_image_copy(),
                wgpu::TexelCopyBufferInfo {
                    buffer: &buffer,
                    layout: wgpu::TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(row_bytes),
                        rows_per_image: Some(size[1]),
                    },
                },
                extent([size[0], size[1], 1]),
            );
            gpu.queue().submit([encoder.finish()]);
            buffer
        })?;
        let state = Arc::new(AtomicU8::new(WAITING));
        let theirs = Arc::clone(&state);
        buffer
            .slice(..)
            .map_async(wgpu::MapMode::Read, move |result| {
                theirs.store(
                    if result.is_ok() { READY } else { FAILED },
                    Ordering::Release,
                );
            });
        Ok(Self {
            buffer,
            size,
            row_bytes,
            state,
        })
    }

    /// Whether the copy has arrived or failed.
    pub(super) fn is_ready(&self, gpu: &Gpu) -> bool {
        // Maps the buffers that are done; an error shows when the data are asked for.
        let _ = gpu.device().poll(wgpu::PollType::Poll);
        self.state.load(Ordering::Acquire) != WAITING
    }

    /// Waits until the copy has arrived or failed. Another thread that polls the device may have taken this copy's answer and
    /// be about to give it, though the device is done.
    fn settled(&self, gpu: &Gpu) -> Result<u8, RenderError> {
        let deadline = Instant::now() + GRACE;
        loop {
            gpu.wait()?;
            let state = self.state.load(Ordering::Acquire);
            if state != WAITING || Instant::now() > deadline {
                return Ok(state);
            }
            std::thread::yield_now();
        }
    }

    /// Waits for the copy and returns its rows without padding.
    pub(super) fn bytes(self, gpu: &Gpu, texel_bytes: u32) -> Result<Vec<u8>, RenderError> {
        let state = self.settled(gpu)?;
        let refused = |reason: String| RenderError::Refused {
            what: "reading the picture back".to_owned(),
            reason,
        };
        if state != READY {
            return Err(refused("the buffer can't be mapped".to_owned()));
        }
        let view = self
            .buffer
            .slice(..)
            .get_mapped_range()
            .map_err(|e| refused(e.to_string()))?;
        let bytes: &[u8] = &view;
        let used = (self.size[0] * texel_bytes) as usize;
        Ok(bytes
            .chunks(self.row_bytes as usize)
            .flat_map(|row| row[..used].iter().copied())
            .collect())
    }

    /// Waits for the copy of a picture of half floats; RGB is multiplied by `unit`.
    pub(super) fn image(self, gpu: &Gpu, unit: f32) -> Result<LinearImage, RenderError> {
        let [width, height] = self.size;
        let bytes = self.bytes(gpu, 8)?;
        let pixels = bytes
            .chunks_exact(8)
            .map(|b| {
                let value = |i: usize| f16::from_le_bytes([b[2 * i], b[2 * i + 1]]).to_f32();
                [value(0) * unit, value(1) * unit, value(2) * unit, value(3)]
            })
            .collect();
        Ok(LinearImage {
            width,
            height,
            pixels,
        })
    }
}
