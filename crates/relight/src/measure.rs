//! How near one picture comes to another.

use glam::Vec3;
use rayon::prelude::*;

use super::diffuse::srgb;

/// Part of the pixels that white lets be brighter.
const ABOVE_WHITE: f32 = 0.005;
/// Pixels that are added up by one thread.
const RUN: usize = 4096;

/// PSNR of sRGB-encoded radiances of the same pixels, dB; white is the reference's own, [`white`]. At most 120 dB; 0 where there are no pixels.
pub fn psnr(reference: &[Vec3], found: &[Vec3]) -> f32 {
    psnr_below(white(reference), reference, found)
}

/// [`psnr`] with another white than the reference's own: for a part of a picture.
pub fn psnr_below(white: f32, reference: &[Vec3], found: &[Vec3]) -> f32 {
    assert_eq!(reference.len(), found.len(), "the same pixels");
    if reference.is_empty() {
        return 0.0;
    }
    let white = white.max(f32::MIN_POSITIVE);
    let square = |(&a, &b)| f64::from((srgb(b / white) - srgb(a / white)).length_squared());
    // The order of a sum is that of its runs, whatever the number of threads.
    let runs: Vec<f64> = reference
        .par_chunks(RUN)
        .zip(found.par_chunks(RUN))
        .map(|(reference, found)| reference.iter().zip(found).map(square).sum())
        .collect();
    let squares: f64 = runs.iter().sum();
    let mean = squares / (3 * reference.len()) as f64;
    (-10.0 * mean.max(1e-12).log10()) as f32
}

/// A picture's 99.5th percentile of mean RGB, between pixels by linear interpolation.
pub fn white(reference: &[Vec3]) -> f32 {
    brighter_than(1.0 - ABOVE_WHITE, reference)
}

/// What this part of the pixels lies below in mean RGB, between pixels by linear interpolation; 0 where there are no pixels.
pub fn brighter_than(part: f32, reference: &[Vec3]) -> f32 {
    let mut means: Vec<f32> = reference.iter().map(|r| r.element_sum() / 3.0).collect();
    let Some(last) = means.len().checked_sub(1) else {
        return 0.0;
    };
    let place = last as f32 * part;
    let (_, &mut low, above) = means.select_nth_unstable_by(place as usize, f32::total_cmp);
    let next = above.iter().copied().fold(f32::INFINITY, f32::min);
    if next.is_finite() {
        low + place.fract() * (next - low)
    } else {
        low
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn psnr_is_that_of_the_encoded_difference_whatever_the_scale() {
        // Linear 1 is encoded as 1, linear 0.5 as 0.7354: apart by 0.2646, which is 11.55 dB.
        for scale in [1e-4, 1.0, 1e4] {
            let found = psnr(
                &[Vec3::splat(scale); 1200],
                &[Vec3::splat(0.5 * scale); 1200],
            );
            assert!((found - 11.55).abs() < 0.01, "{found} dB at scale {scale}");
        }
        assert!(psnr(&[Vec3::ONE; 5], &[Vec3::ONE; 5]) > 100.0);
    }

    #[test]
    fn white_lies_between_pixels() {
        // Of 0 … 100 the place is 99.5: half way from 99 to 100.
        let ramp: Vec<Vec3> = (0..=100).map(|i| Vec3::splat(i as f32)).collect();
        assert!((white(&ramp) - 99.5).abs() < 1e-3, "{}", white(&ramp));
    }
}
