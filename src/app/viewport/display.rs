//! From linear radiance to colours on the screen, for pictures that the graphics card didn't draw.

use eframe::egui::{Color32, ColorImage};
use glam::Vec3;
use rayon::prelude::*;

use rekindle_capture::Photograph;
use rekindle_relight as relight;
use rekindle_relight::ViewTransform;

/// A picture of linear radiance.
#[derive(Clone, Debug)]
pub struct Linear {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// RGB premultiplied by coverage, row by row from the top.
    pub radiance: Vec<Vec3>,
    /// Part of each pixel that the object covers.
    pub coverage: Vec<f32>,
}

/// How linear radiance is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Display {
    /// Exposure in stops.
    pub exposure: f32,
    /// Radiance that is 1 at no stops.
    pub white: f32,
    /// From linear to the screen.
    pub transform: ViewTransform,
    /// Behind the object.
    pub background: Color32,
}

impl Linear {
    /// Of a picture of the reference renderer.
    pub fn of_picture(picture: &relight::Picture) -> Self {
        Self {
            width: picture.width as usize,
            height: picture.height as usize,
            radiance: picture
                .diffuse
                .iter()
                .zip(&picture.specular)
                .map(|(&d, &s)| Vec3::from(d) + Vec3::from(s))
                .collect(),
            coverage: picture.coverage.clone(),
        }
    }

    /// Of a photograph, made smaller by whole blocks of pixels. Without coverage the whole picture counts as covered.
    pub fn of_photograph(photograph: &Photograph, width: u32, height: u32) -> Self {
        let mean = |i: usize| {
            let (x, y) = (i as u32 % width, i as u32 / width);
            let (mut sum, mut covered, mut count) = (Vec3::ZERO, 0.0, 0.0);
            for row in block(y, height, photograph.height) {
                for column in block(x, width, photograph.width) {
                    let at = (row * photograph.width + column) as usize;
                    sum += Vec3::from(photograph.radiance[at]);
                    covered += photograph.coverage.as_ref().map_or(1.0, |c| c[at]);
                    count += 1.0;
                }
            }
            (sum / count, covered / count)
        };
        let pixels = (width * height) as usize;
        let (radiance, coverage) = (0..pixels).into_par_iter().map(mean).unzip();
        Self {
            width: width as usize,
            height: height as usize,
            radiance,
            coverage,
        }
    }

    /// The picture as it is shown.
    pub fn image(&self, display: &Display) -> ColorImage {
        let pixels = self
            .radiance
            .par_iter()
            .zip(&self.coverage)
            .map(|(&radiance, &coverage)| display.colour(radiance, coverage))
            .collect();
        ColorImage::new([self.width, self.height], pixels)
    }
}

/// The larger picture's rows, or columns, that one of the smaller shows.
fn block(at: u32, small: u32, large: u32) -> std::ops::Range<u32> {
    let edge = |at: u32| (u64::from(at) * u64::from(large) / u64::from(small)) as u32;
    let first = edge(at).min(large - 1);
    first..edge(at + 1).max(first + 1).min(large)
}

impl Display {
    /// Factor from radiance to what the view transform takes.
    pub fn gain(&self) -> f32 {
        self.exposure.exp2() / self.white.max(f32::MIN_POSITIVE)
    }

    fn colour(&self, radiance: Vec3, coverage: f32) -> Color32 {
        if coverage <= 0.0 {
            return self.background;
        }
        let shown = self.transform.apply(radiance * (self.gain() / coverage));
        mix(shown, self.background, coverage)
    }
}

/// Display values over a background.
pub fn mix(shown: Vec3, background: Color32, coverage: f32) -> Color32 {
    let [r, g, b, _] = background.to_array();
    let below = Vec3::new(r.into(), g.into(), b.into());
    let over = below.lerp(255.0 * shown, coverage.clamp(0.0, 1.0));
    let [r, g, b] = over.to_array().map(|v| v.round() as u8);
    Color32::from_rgb(r, g, b)
}
