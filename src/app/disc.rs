//! The hemisphere seen from straight above, as in the paper's figures 4 and 5: up is north, the horizon is the rim.

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Color32, ColorImage, FontId, Pos2, Rect, Sense, Stroke, TextureHandle,
    TextureOptions, vec2,
};
use glam::Vec3;

use super::settings::HemisphereExposure;
use super::theme;
use rekindle_scene::hemisphere::{Exposure, Picture, from_above_axes};

/// A picture of a hemisphere on the graphics card, made anew when picture or exposure change.
#[derive(Default)]
pub struct DiscTexture {
    shown: Option<(Arc<Picture>, HemisphereExposure, TextureHandle)>,
}

impl DiscTexture {
    /// The texture of a picture.
    pub fn of(
        &mut self,
        ctx: &egui::Context,
        picture: &Arc<Picture>,
        exposure: HemisphereExposure,
    ) -> egui::TextureId {
        if let Some((shown, how, texture)) = &self.shown
            && Arc::ptr_eq(shown, picture)
            && *how == exposure
        {
            return texture.id();
        }
        let image = image(picture, exposure);
        let texture = match self.shown.take() {
            Some((_, _, mut texture)) => {
                texture.set(image, TextureOptions::LINEAR);
                texture
            }
            None => ctx.load_texture("hemisphere", image, TextureOptions::LINEAR),
        };
        let id = texture.id();
        self.shown = Some((Arc::clone(picture), exposure, texture));
        id
    }
}

fn image(picture: &Picture, exposure: HemisphereExposure) -> ColorImage {
    let brightest = picture
        .radiance
        .iter()
        .flatten()
        .copied()
        .fold(0.0, f32::max);
    let exposure = if exposure.logarithmic {
        Exposure::Log {
            decades: exposure.decades,
        }
    } else {
        Exposure::Linear {
            white: brightest * 0.5_f32.powf(exposure.stops),
        }
    };
    let (width, height) = (picture.width as usize, picture.height as usize);
    let middle = 0.5 * (width as f32 - 1.0);
    let pixels = picture
        .to_rgb8(exposure)
        .into_iter()
        .enumerate()
        .map(|(i, [r, g, b])| {
            // The rim is softened over a pixel.
            let (x, y) = ((i % width) as f32 - middle, (i / width) as f32 - middle);
            let inside = (0.5 * width as f32 - x.hypot(y)).clamp(0.0, 1.0);
            Color32::from_rgb(r, g, b).gamma_multiply(inside)
        })
        .collect();
    ColorImage::new([width, height], pixels)
}

/// Where a disc lies on the window.
#[derive(Clone, Copy, Debug)]
pub struct Disc {
    /// The square around the horizon.
    pub rect: Rect,
    /// The pole, unit.
    pub up: Vec3,
}

impl Disc {
    /// Where a direction is shown; `None` below the horizon.
    pub fn at(&self, direction: Vec3) -> Option<Pos2> {
        let direction = direction.normalize_or_zero();
        if direction.dot(self.up) < 0.0 {
            return None;
        }
        let [right, north] = from_above_axes(self.up);
        let radius = 0.5 * self.rect.width();
        Some(self.rect.center() + radius * vec2(direction.dot(right), -direction.dot(north)))
    }

    /// The direction shown at a position; outside the rim, the nearest on the horizon.
    pub fn direction(&self, position: Pos2) -> Vec3 {
        let [right, north] = from_above_axes(self.up);
        let offset = (position - self.rect.center()) / (0.5 * self.rect.width()).max(1.0);
        let length = offset.length();
        let inside = if length > 1.0 {
            offset / length
        } else {
            offset
        };
        let height = (1.0 - inside.length_sq()).max(0.0).sqrt();
        (inside.x * right - inside.y * north + height * self.up).normalize_or(self.up)
    }
}

/// Shows a disc as wide as `side`; nothing of the picture where there is none yet.
pub fn show(
    ui: &mut egui::Ui,
    texture: Option<egui::TextureId>,
    up: Vec3,
    side: f32,
    sense: Sense,
    name: &str,
) -> (egui::Response, Disc) {
    let (rect, response) = ui.allocate_exact_size(vec2(side, side), sense);
    let painter = ui.painter_at(rect.expand(1.0));
    let rim = rect.shrink(1.0);
    painter.circle_filled(rect.center(), 0.5 * rim.width(), Color32::BLACK);
    if let Some(texture) = texture {
        let all = Rect::from_min_max(Pos2::ZERO, egui::pos2(1.0, 1.0));
        painter.image(texture, rim, all, Color32::WHITE);
    }
    let faint = Color32::from_white_alpha(46);
    // Heights of 30° and 60°, and the pole.
    for height in [30.0_f32, 60.0] {
        let radius = 0.5 * rim.width() * height.to_radians().cos();
        painter.circle_stroke(
            rect.center(),
            radius,
            Stroke::new(0.5, Color32::from_white_alpha(24)),
        );
    }
    painter.circle_stroke(rect.center(), 0.5 * rim.width(), Stroke::new(1.0, faint));
    let tick = 3.0;
    for offset in [vec2(tick, 0.0), vec2(0.0, tick)] {
        let ends = [rect.center() - offset, rect.center() + offset];
        painter.line_segment(ends, Stroke::new(1.0, faint));
    }
    if side > 150.0 {
        painter.text(
            rim.center_top() + vec2(0.0, 6.0),
            Align2::CENTER_TOP,
            "N",
            FontId::proportional(11.0),
            theme::ON_STAGE.gamma_multiply(0.7),
        );
    }
    let label = name.to_owned();
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, label.clone()));
    (response, Disc { rect: rim, up })
}

/// Marks the direction that the surface under the pointer mirrors.
pub fn mirror_mark(ui: &egui::Ui, disc: &Disc, mirrored: Option<Vec3>) {
    let Some(at) = mirrored.and_then(|direction| disc.at(direction)) else {
        return;
    };
    let accent = theme::palette(ui).accent;
    let painter = ui.painter();
    painter.circle_stroke(at, 5.0, Stroke::new(3.0, Color32::from_black_alpha(160)));
    painter.circle_stroke(at, 5.0, Stroke::new(1.5, accent));
    for offset in [vec2(9.0, 0.0), vec2(0.0, 9.0)] {
        for side in [-1.0, 1.0] {
            let ends = [at + side * 0.5 * offset, at + side * offset];
            painter.line_segment(ends, Stroke::new(1.5, accent));
        }
    }
}

/// Says which direction the pointer is at.
pub fn direction_tip(response: egui::Response, disc: &Disc) {
    let Some(pointer) = response.hover_pos() else {
        return;
    };
    let direction = disc.direction(pointer);
    let [right, north] = from_above_axes(disc.up);
    let height = direction.dot(disc.up).clamp(-1.0, 1.0).asin().to_degrees();
    let east = direction.dot(right).atan2(direction.dot(north));
    let azimuth = east.to_degrees().rem_euclid(360.0);
    response.on_hover_text_at_pointer(format!(
        "{height:.1}° above the horizon, {azimuth:.1}° clockwise from north"
    ));
}

/// Controls of the exposure.
pub fn exposure_ui(ui: &mut egui::Ui, exposure: &mut HemisphereExposure) {
    ui.horizontal(|ui| {
        ui.selectable_value(&mut exposure.logarithmic, true, "Log")
            .on_hover_text("Brightness by the logarithm: faint lights show beside strong ones");
        ui.selectable_value(&mut exposure.logarithmic, false, "Linear")
            .on_hover_text("Brightness in proportion, sRGB-encoded");
        if exposure.logarithmic {
            ui.add(
                egui::DragValue::new(&mut exposure.decades)
                    .range(0.5..=8.0)
                    .speed(0.02)
                    .prefix("Range: ")
                    .suffix(" decades"),
            )
            .on_hover_text("Powers of ten from black to white")
            .accessible_name("Decades");
        } else {
            ui.add(
                egui::DragValue::new(&mut exposure.stops)
                    .range(-4.0..=16.0)
                    .speed(0.05)
                    .suffix(" stops"),
            )
            .on_hover_text("Stops above the exposure at which the brightest light is white")
            .accessible_name("Stops of the hemisphere");
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_direction_comes_back_from_its_place_on_the_disc() {
        for up in [Vec3::Y, Vec3::Z, Vec3::new(0.6, 0.0, 0.8)] {
            let disc = Disc {
                rect: Rect::from_min_size(egui::pos2(40.0, 20.0), vec2(300.0, 300.0)),
                up,
            };
            for other in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::new(-0.5, 0.3, 0.7)] {
                let direction = (other + 1.2 * up).normalize_or_zero();
                let at = disc.at(direction).expect("above the horizon");
                let back = disc.direction(at);
                assert!(
                    back.distance(direction) < 1e-4,
                    "{direction} came back as {back}"
                );
            }
            assert!(disc.at(-up).is_none());
            let outside = disc.direction(egui::pos2(2000.0, 170.0));
            assert!(outside.dot(up).abs() < 1e-6, "{outside} is on the horizon");
        }
    }
}
