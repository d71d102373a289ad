//! Pixels far brighter than all about them: hot pixels of sensors, fireflies of path tracers.
//!
//! No lens and no surface shows such a pixel: an image of a point covers several, and a highlight is wider still. A few of
//! them would outweigh all that a picture says.

/// How many times as bright as each of its neighbours a pixel has to be.
const TIMES: f32 = 10.0;

/// The indices of such pixels among those of which something is `known`, of a picture `width` pixels wide; none is darker than the mean.
pub(super) fn isolated_pixels(rgb: &[[f32; 3]], known: &[bool], width: usize) -> Vec<usize> {
    let brightness = |i: usize| rgb[i].iter().fold(0.0_f32, |m, &v| m.max(v));
    let data = || (0..rgb.len()).filter(|&i| known[i] && brightness(i) > 0.0);
    let (sum, count) = data().fold((0.0_f64, 0_usize), |(sum, count), i| {
        (sum + f64::from(brightness(i)), count + 1)
    });
    let mean = (sum / count.max(1) as f64) as f32;
    let is_isolated = |i: usize| {
        let own = brightness(i);
        own > mean
            && neighbours(i, width, rgb.len() / width)
                .filter(|&k| known[k])
                .all(|k| own > TIMES * brightness(k))
    };
    data().filter(|&i| is_isolated(i)).collect()
}

/// The up to eight pixels about one.
fn neighbours(i: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (i % width, i / width);
    let rows = y.saturating_sub(1)..(y + 2).min(height);
    rows.flat_map(move |row| {
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        columns.map(move |column| row * width + column)
    })
    .filter(move |&k| k != i)
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 40;

    /// A lit surface with a highlight of the width σ, in pixels.
    fn picture(sigma: f32) -> Vec<[f32; 3]> {
        let at = |i: usize| {
            let (x, y) = ((i % WIDTH) as f32 - 20.0, (i / WIDTH) as f32 - 15.0);
            [0.1 + 50.0 * (-(x * x + y * y) / (2.0 * sigma * sigma)).exp(); 3]
        };
        (0..WIDTH * 30).map(at).collect()
    }

    #[test]
    fn single_bright_pixels_are_found_also_at_the_rim() {
        let mut rgb = picture(3.0);
        let places = [0, WIDTH - 1, 7 * WIDTH + 3, 29 * WIDTH + 11];
        for i in places {
            rgb[i] = [500.0, 0.1, 0.1];
        }
        let mut usable = vec![true; rgb.len()];
        assert_eq!(isolated_pixels(&rgb, &usable, WIDTH), places);
        usable[0] = false;
        assert_eq!(isolated_pixels(&rgb, &usable, WIDTH), places[1..]);
    }

    #[test]
    fn the_smallest_highlight_that_pixels_resolve_is_none() {
        for sigma in [0.7, 1.0, 3.0] {
            let rgb = picture(sigma);
            let usable = vec![true; rgb.len()];
            assert!(isolated_pixels(&rgb, &usable, WIDTH).is_empty(), "{sigma}");
        }
    }

    #[test]
    fn noise_in_the_dark_is_none() {
        let mut rgb = picture(3.0);
        for i in (200..400).step_by(7) {
            rgb[i - 1..=i + 1].fill([0.0; 3]);
            rgb[i] = [0.01; 3];
        }
        let usable = vec![true; rgb.len()];
        assert!(isolated_pixels(&rgb, &usable, WIDTH).is_empty());
    }
}
