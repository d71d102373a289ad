//! How much of a still picture is refined at a time, so that a window hears its user in between on any device.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use super::gpu::Gpu;

/// Longer, and the next part is smaller.
const LONG: Duration = Duration::from_millis(50);
/// Shorter, and the next part is larger.
const SHORT: Duration = Duration::from_millis(25);
/// Parts of a frame at most: the window is painted for each, which takes its time too.
const MOST_BANDS: u32 = 8;

/// Divides frames into bands of rows that take the device a moment each.
pub(super) struct Pace {
    /// Bands of a frame, a power of two.
    bands: Arc<AtomicU32>,
    /// First row that the frame lacks.
    row: u32,
}

impl Pace {
    pub(super) fn new() -> Self {
        Self {
            bands: Arc::new(AtomicU32::new(1)),
            row: 0,
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_of_any_number_cover_each_row_once() {
        for bands in [1, 2, 4, 8] {
            for height in [1, 5, 8, 715] {
                let mut pace = Pace::new();
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
