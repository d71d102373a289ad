//! Clipped highlights in floating-point pictures, which don't say where they clip.
//!
//! A highlight that was clipped before it became a floating-point number is a plateau: many pixels of exactly the
//! largest value, beside few of nearly that value, on the slope that leads up to it. The top of a highlight that is all
//! there is as many pixels, but of different values.

use std::array;

/// Fewer pixels of one value are no plateau.
const LEAST_PIXELS: usize = 16;
/// Values from this part of the largest on are nearly that.
const NEARLY: f32 = 0.9;
/// A plateau has more than this many pixels for each that is nearly as bright. At the top of a smooth highlight stored
/// in the eight bits of Radiance files it is 0.04.
const LEAST_RATIO: f32 = 0.25;
/// A plateau has a slope around it, with more than this many pixels for each of its own: a face that is lit evenly has
/// none.
const LEAST_SLOPE: f32 = 0.02;
/// What covers more than this part of everything that isn't black is no highlight.
const LARGEST_PART: f32 = 0.2;

/// Marks the pixels of which a channel is clipped.
pub(super) fn mark_clipped(rgb: &[[f32; 3]], clipped: &mut [bool]) {
    let largest = rgb.iter().fold([0.0_f32; 3], |largest, pixel| {
        array::from_fn(|c| match pixel[c] {
            v if v.is_finite() => largest[c].max(v),
            _ => largest[c],
        })
    });
    let top = rgb.iter().fold([0_usize; 3], |top, pixel| {
        array::from_fn(|c| top[c] + usize::from(pixel[c] == largest[c]))
    });
    for c in 0..3 {
        let values = || rgb.iter().map(|pixel| pixel[c]);
        if largest[c] > 0.0 && top[c] >= LEAST_PIXELS && is_plateau(values, largest[c], top[c]) {
            for (mark, v) in clipped.iter_mut().zip(values()) {
                *mark |= v == largest[c];
            }
        }
    }
}

/// Whether the `top` pixels of the `largest` of a channel's values are a plateau on a slope.
fn is_plateau<V: Iterator<Item = f32>>(values: impl Fn() -> V, largest: f32, top: usize) -> bool {
    let nearly = values()
        .filter(|&v| v >= NEARLY * largest && v < largest)
        .count() as f32;
    let lit = values().filter(|&v| v > 0.0).count() as f32;
    let top = top as f32;
    top > LEAST_RATIO * nearly && nearly > LEAST_SLOPE * top && top < LARGEST_PART * lit
}

#[cfg(test)]
mod tests {
    use half::f16;

    use super::*;

    const SIDE: usize = 100;

    /// Pixels of `value(x, y)` in all channels.
    fn picture(value: impl Fn(f32, f32) -> f32) -> Vec<[f32; 3]> {
        let at = |i: usize| value((i % SIDE) as f32, (i / SIDE) as f32);
        (0..SIDE * SIDE).map(|i| [at(i); 3]).collect()
    }

    /// A highlight `width` pixels wide on a textured surface.
    fn highlight(width: f32) -> impl Fn(f32, f32) -> f32 {
        move |x, y| {
            let (dx, dy) = ((x - 50.0) / width, (y - 47.0) / width);
            0.3 + 0.1 * (0.7 * x).sin() * (0.3 * y).cos() + 2.0 * (-0.5 * (dx * dx + dy * dy)).exp()
        }
    }

    fn count(rgb: &[[f32; 3]]) -> usize {
        let mut clipped = vec![false; rgb.len()];
        mark_clipped(rgb, &mut clipped);
        clipped.iter().filter(|&&c| c).count()
    }

    #[test]
    fn the_plateau_of_a_clipped_highlight_is_found() {
        for (width, level) in [(12.0, 1.5), (12.0, 0.6), (6.0, 1.0)] {
            let full = highlight(width);
            let expected = picture(&full).iter().filter(|p| p[0] >= level).count();
            let clipped = picture(|x, y| full(x, y).min(level));
            assert_eq!(count(&clipped), expected, "{width} pixels wide, at {level}");
        }
        let red: Vec<[f32; 3]> = picture(highlight(12.0))
            .iter()
            .map(|p| [p[0].min(1.0), p[1], p[2]])
            .collect();
        assert!(count(&red) > 100, "one channel alone");
    }

    #[test]
    fn what_is_not_clipped_is_left() {
        let half = |v: f32| f16::from_f32(v).to_f32();
        for width in [3.0, 12.0, 40.0] {
            let full = highlight(width);
            assert_eq!(count(&picture(|x, y| half(full(x, y)))), 0, "{width} wide");
        }
        assert_eq!(count(&picture(|_, _| 0.7)), 0, "one value everywhere");
        assert_eq!(count(&picture(|_, _| 0.0)), 0, "black");
        let face = |x: f32, y: f32| {
            let inside = (20.0..60.0).contains(&x) && (30.0..60.0).contains(&y);
            if inside { 0.8 } else { 0.2 }
        };
        assert_eq!(count(&picture(face)), 0, "a face that is lit evenly");
    }
}
