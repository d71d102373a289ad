//! How much is drawn at a time, so that a window hears its user in between on any device.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use super::error::RenderError;
use super::gpu::Gpu;

/// Longer, and the next part is smaller.
const LONG: Duration = Duration::from_millis(50);
/// Shorter, and the next part is larger.
const SHORT: Duration = Duration::from_millis(25);
/// Parts of a frame at most: the window is painted for each, which takes its time too.
const MOST_BANDS: u32 = 8;

/// Sides of a quick picture's pixels at most, in pixels of the whole one: larger ones don't show what is moved.
const COARSEST: u32 = 6;
/// The same before anything has been timed, on a processor.
const COARSE: u32 = 2;

/// Divides frames into bands of rows that take the device a moment each, and says how large a quick picture's pixels have to be.
pub(super) struct Pace {
    /// Bands of a frame, a power of two.
    bands: Arc<AtomicU32>,
    /// First row that the frame lacks.
    row: u32,
    /// Side of a quick picture's pixels, in pixels of the whole one.
    coarse: Arc<AtomicU32>,
    /// Whether a processor draws.
    is_processor: bool,
}

impl Pace {
    pub(super) fn new(gpu: &Gpu) -> Self {
        let is_processor = gpu.device().adapter_info().device_type == wgpu::DeviceType::Cpu;
        let coarse = if is_processor { COARSE } else { 1 };
        Self {
            bands: Arc::new(AtomicU32::new(1)),
            row: 0,
            coarse: Arc::new(AtomicU32::new(coarse)),
            is_processor,
        }
    }

    /// Side of the pixels of a quick picture, in pixels of the whole one.
    pub(super) fn coarse(&self) -> u32 {
        self.coarse.load(Ordering::Relaxed)
    }

    /// Submits a picture that is drawn while things move, and learns how large the next one's pixels have to be.
    pub(super) fn submit_moving(
        &self,
        gpu: &Gpu,
        commands: wgpu::CommandBuffer,
    ) -> Result<(), RenderError> {
        if self.is_processor {
            // It does nothing else meanwhile, and so tells how long the picture alone took.
            gpu.wait()?;
        }
        let (coarse, started) = (Arc::clone(&self.coarse), Instant::now());
        gpu.queue().submit([commands]);
        gpu.queue().on_submitted_work_done(move || {
            let now = coarse.load(Ordering::Relaxed);
            coarse.store(next_coarse(now, started.elapsed()), Ordering::Relaxed);
        });
        if self.is_processor {
            gpu.wait()?;
        }
        Ok(())
    }

    /// Starts a frame from its top.
    pub(super) fn restart(&mut self) {
        self.row = 0;
    }

    /// The rows that are next, of a frame of this height; ends with the height where they complete it.
    pub(super) fn next(&mut self, height: u32) -> Range<u32> {
        let first = self.row;
        let rows = height.div_ceil(self.bands.load(Ordering::Relaxed));
        let end = (first + rows).min(height);
        self.row = end % height;
        first..end
    }

    /// Learns from how long what was just submitted takes.
    pub(super) fn time(&self, gpu: &Gpu) {
        let (bands, started) = (Arc::clone(&self.bands), Instant::now());
        gpu.queue().on_submitted_work_done(move || {
            let now = bands.load(Ordering::Relaxed);
            let elapsed = started.elapsed();
            if elapsed > LONG {
                bands.store((2 * now).min(MOST_BANDS), Ordering::Relaxed);
            } else if elapsed < SHORT {
                bands.store((now / 2).max(1), Ordering::Relaxed);
            }
        });
    }
}

/// How large pixels have to be where those of side `now` took so long.
fn next_coarse(now: u32, elapsed: Duration) -> u32 {
    if elapsed > LONG {
        return (now + 1).min(COARSEST);
    }
    let finer = now.saturating_sub(1).max(1);
    let expected = elapsed * now.pow(2) / finer.pow(2);
    if expected < (SHORT + LONG) / 2 {
        finer
    } else {
        now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_become_as_large_as_a_device_needs_and_no_larger() {
        for of_whole in [5, 30, 90, 400, 900, 5000] {
            let took = |coarse: u32| Duration::from_millis(of_whole) / coarse.pow(2);
            let mut coarse = COARSE;
            for _ in 0..10 {
                coarse = next_coarse(coarse, took(coarse));
            }
            assert_eq!(next_coarse(coarse, took(coarse)), coarse, "it settles");
            assert!(
                took(coarse) <= LONG || coarse == COARSEST,
                "{of_whole} ms: {coarse}"
            );
            assert!(
                coarse == 1 || took(coarse - 1) > SHORT,
                "{of_whole} ms: {coarse}"
            );
        }
    }

    #[test]
    fn bands_of_any_number_cover_each_row_once() {
        for bands in [1, 2, 4, 8] {
            for height in [1, 5, 8, 715] {
                let mut pace = Pace {
                    bands: Arc::default(),
                    row: 0,
                    coarse: Arc::default(),
                    is_processor: false,
                };
                for frame in 0..3 {
                    let mut end = 0;
                    while end < height {
                        // The number may change within a frame.
                        let changed = if frame == 1 && end > 0 { 4 } else { bands };
                        pace.bands.store(changed, Ordering::Relaxed);
                        let rows = pace.next(height);
                        assert_eq!(rows.start, end);
                        assert!(rows.end > rows.start);
                        end = rows.end;
                    }
                    assert_eq!(end, height);
                }
            }
        }
    }
}
