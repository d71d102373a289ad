//! How often each brightness occurs, by channel.

use eframe::egui::{self, Align2, Color32, CornerRadius, FontId, Pos2, Rect, Stroke, vec2};

use super::display::{Display, Linear};
use super::theme;

/// Stops below white at the left end, and above white at the right end.
const BELOW: f32 = 10.0;
const ABOVE: f32 = 4.0;
const BINS: usize = 112;

/// Counts of pixels by stops, R, G and B.
pub struct Histogram {
    /// Values of the object's pixels by channel, sorted into bins of radiance: exponent of two and its parts.
    values: Vec<[f32; 3]>,
}

impl Histogram {
    /// Of the object's pixels in a picture.
    pub fn new(linear: &Linear) -> Self {
        let values = linear
            .radiance
            .iter()
            .zip(&linear.coverage)
            .filter(|(_, c)| **c > 0.5)
            .map(|(r, c)| (*r / *c).to_array())
            .collect();
        Self { values }
    }

    /// Part of the pixels in each bin by channel, and the part above white.
    fn bins(&self, gain: f32) -> ([[f32; BINS]; 3], [f32; 3]) {
        let mut bins = [[0.0; BINS]; 3];
        let mut above = [0.0; 3];
        let share = 1.0 / self.values.len().max(1) as f32;
        for value in &self.values {
            for c in 0..3 {
                let shown = value[c] * gain;
                if shown > 1.0 {
                    above[c] += share;
                }
                let at = (shown.max(1e-30).log2() + BELOW) / (BELOW + ABOVE) * BINS as f32;
                bins[c][(at.max(0.0) as usize).min(BINS - 1)] += share;
            }
        }
        (bins, above)
    }

    /// Draws it into the corner of `rect`.
    pub fn show(&self, ui: &egui::Ui, rect: Rect, display: &Display) {
        let size = vec2(260.0, 118.0);
        let frame = Rect::from_min_size(rect.right_top() + vec2(-size.x - 12.0, 12.0), size);
        let painter = ui.painter_at(rect);
        painter.rect_filled(frame, CornerRadius::same(6), Color32::from_black_alpha(190));
        let plot = Rect::from_min_max(frame.min + vec2(10.0, 8.0), frame.max - vec2(10.0, 34.0));
        let (bins, above) = self.bins(display.gain());
        // The ends hold all that lies beyond; they would flatten the rest.
        let highest = bins
            .iter()
            .flat_map(|b| &b[1..BINS - 1])
            .copied()
            .fold(1e-6, f32::max);
        let x_of = |stops: f32| plot.left() + (stops + BELOW) / (BELOW + ABOVE) * plot.width();
        let font = FontId::proportional(10.0);
        for stops in [-10, -8, -6, -4, -2, 0, 2, 4] {
            let x = x_of(stops as f32);
            let strong = if stops == 0 { 110 } else { 36 };
            painter.vline(
                x,
                plot.y_range(),
                Stroke::new(1.0, Color32::from_white_alpha(strong)),
            );
            painter.text(
                egui::pos2(x, plot.bottom() + 2.0),
                Align2::CENTER_TOP,
                format!("{stops:+}"),
                font.clone(),
                theme::ON_STAGE.gamma_multiply(0.7),
            );
        }
        let colours = [
            Color32::from_rgb(240, 96, 96),
            Color32::from_rgb(96, 214, 112),
            Color32::from_rgb(104, 148, 255),
        ];
        for (bins, colour) in bins.iter().zip(colours) {
            let line: Vec<Pos2> = bins
                .iter()
                .enumerate()
                .map(|(i, &part)| {
                    let x = plot.left() + (i as f32 + 0.5) / BINS as f32 * plot.width();
                    egui::pos2(x, plot.bottom() - (part / highest).min(1.0) * plot.height())
                })
                .collect();
            painter.line(line, Stroke::new(1.2, colour));
        }
        let [r, g, b] = above.map(|part| 100.0 * part);
        painter.text(
            frame.left_bottom() + vec2(10.0, -6.0),
            Align2::LEFT_BOTTOM,
            format!("stops from white; above it R {r:.1} %  G {g:.1} %  B {b:.1} %"),
            font,
            theme::ON_STAGE.gamma_multiply(0.7),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn a_value_falls_into_the_bin_of_its_stops() {
        let linear = Linear {
            width: 2,
            height: 1,
            radiance: vec![Vec3::new(0.25, 1.01, 2.0), Vec3::ZERO],
            coverage: vec![1.0, 0.0],
        };
        let (bins, above) = Histogram::new(&linear).bins(1.0);
        let bin = |stops: f32| ((stops + BELOW) / (BELOW + ABOVE) * BINS as f32) as usize;
        assert_eq!(bins[0][bin(-2.0)], 1.0, "a quarter is two stops down");
        assert_eq!(bins[1][bin(0.0)], 1.0);
        assert_eq!(bins[2][bin(1.0)], 1.0);
        assert_eq!(above, [0.0, 1.0, 1.0], "what is not the object is left out");
    }
}
