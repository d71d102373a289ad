//! A photograph beside what the reference renderer makes of it: photo, render, a wipe between them, and the difference.

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Color32, ColorImage, CursorIcon, Id, Pos2, Rect, Sense, Stroke, TextureHandle,
    TextureOptions, vec2,
};
use glam::Vec3;
use rayon::prelude::*;

use super::display::{Display, Linear, mix};
use rekindle_capture::{Camera, Capture};
use rekindle_relight as relight;
use rekindle_relight::turbo;

/// Longest side of the compared pictures, pixels.
const LONGEST: u32 = 1200;
/// Pixels covered less than this are left out of the PSNR.
const COVERED: f32 = 0.999;
/// Difference, as a part of white, that gets the end of the colour map.
const FULL: f32 = 0.1;

/// What is shown at an input camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// The object under its present light.
    #[default]
    Object,
    /// The photograph.
    Photo,
    /// The rendering under the captured lighting.
    Render,
    /// The photograph on the left of a line, the rendering on its right.
    Wipe,
    /// How far they are apart.
    Difference,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Object,
        Self::Photo,
        Self::Render,
        Self::Wipe,
        Self::Difference,
    ];

    /// Which light it shows.
    pub fn light(self) -> &'static str {
        match self {
            Self::Object => "in the light of the setup",
            Self::Photo => "as photographed",
            Self::Render => "rendered in the captured light",
            Self::Wipe | Self::Difference => "photograph and rendering in the captured light",
        }
    }

    /// Its name and what it shows.
    pub fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Object => ("Object", "The object under its present light"),
            Self::Photo => ("Photo", "The photograph taken here"),
            Self::Render => (
                "Render",
                "What the reference renderer shows from here under the captured lighting",
            ),
            Self::Wipe => (
                "Wipe",
                "Photograph on the left, rendering on the right of a line that you drag",
            ),
            Self::Difference => (
                "Difference",
                "How far photograph and rendering are apart, in false colour",
            ),
        }
    }
}

/// The pictures of one input camera.
struct Pair {
    photo: Linear,
    render: Option<Linear>,
    /// Peak signal-to-noise ratio, dB.
    psnr: Option<f32>,
    shown: Option<Shown>,
}

struct Shown {
    display: Display,
    photo: TextureHandle,
    render: Option<TextureHandle>,
    difference: Option<TextureHandle>,
}

/// Comparison at the input camera that is looked through.
#[derive(Default)]
pub struct Compare {
    /// What is shown.
    pub kind: Kind,
    /// Where the wipe's line is, as a part of the picture's width.
    wipe: f32,
    camera: Option<usize>,
    pair: Option<Pair>,
}

impl Compare {
    /// Goes to another camera, or to none.
    pub fn go_to(&mut self, capture: Option<&Arc<Capture>>, camera: Option<usize>) {
        if self.camera == camera {
            return;
        }
        self.camera = camera;
        self.pair = None;
        if self.wipe == 0.0 {
            self.wipe = 0.5;
        }
        let view = capture.zip(camera).and_then(|(c, i)| c.views.get(i));
        self.pair = view.map(|view| {
            let [width, height] = size(&view.camera);
            Pair {
                photo: Linear::of_photograph(&view.photograph, width, height),
                render: None,
                psnr: None,
                shown: None,
            }
        });
    }

    /// Whether there is something to compare.
    pub fn is_possible(&self) -> bool {
        self.pair.is_some()
    }

    /// The camera for the rendering that is still missing.
    pub fn missing(&self, cameras: &[(String, Camera)]) -> Option<Camera> {
        let pair = self.pair.as_ref()?;
        if self.kind == Kind::Object || pair.render.is_some() {
            return None;
        }
        let (_, camera) = cameras.get(self.camera?)?;
        let [width, height] = size(camera);
        Some(camera.resized(width, height))
    }

    /// Takes the rendering.
    pub fn rendered(&mut self, picture: &relight::Picture) {
        if let Some(pair) = &mut self.pair {
            let render = Linear::of_picture(picture);
            if render.radiance.len() == pair.photo.radiance.len() {
                pair.psnr = Some(psnr(&pair.photo, &render));
                pair.render = Some(render);
                pair.shown = None;
            }
        }
    }

    /// PSNR of the rendering, sRGB-encoded, white at the photograph's 99.5th percentile, dB.
    pub fn psnr(&self) -> Option<f32> {
        self.pair.as_ref()?.psnr
    }

    /// The linear picture that is shown, for the probe: photograph or rendering.
    pub fn linear(&self) -> Option<&Linear> {
        let pair = self.pair.as_ref()?;
        match self.kind {
            Kind::Object => None,
            Kind::Photo => Some(&pair.photo),
            _ => pair.render.as_ref(),
        }
    }

    /// Photograph and rendering at a pixel.
    pub fn both(&self, x: usize, y: usize) -> Option<(Vec3, Option<Vec3>)> {
        let pair = self.pair.as_ref()?;
        let at = y * pair.photo.width + x;
        let photo = *pair.photo.radiance.get(at)?;
        let render = pair.render.as_ref().map(|r| r.radiance[at]);
        Some((photo, render))
    }

    /// Draws the comparison over `rect`.
    pub fn paint(&mut self, ui: &mut egui::Ui, rect: Rect, display: &Display) {
        let Some(pair) = &mut self.pair else { return };
        if pair.shown.as_ref().is_none_or(|s| s.display != *display) {
            pair.shown = Some(upload(ui.ctx(), pair, display));
        }
        let Some(shown) = &pair.shown else { return };
        let painter = ui.painter_at(rect);
        let all = Rect::from_min_max(Pos2::ZERO, egui::pos2(1.0, 1.0));
        let whole = |texture: &TextureHandle| {
            painter.image(texture.id(), rect, all, Color32::WHITE);
        };
        match (self.kind, &shown.render, &shown.difference) {
            (Kind::Object, ..) => {}
            (Kind::Photo, ..) => whole(&shown.photo),
            (Kind::Render, Some(render), _) => whole(render),
            (Kind::Difference, _, Some(difference)) => {
                whole(difference);
                legend(&painter, rect);
            }
            (Kind::Wipe, Some(render), _) => {
                whole(&shown.photo);
                let x = rect.left() + self.wipe * rect.width();
                let right = Rect::from_min_max(egui::pos2(x, rect.top()), rect.max);
                let part = Rect::from_min_max(egui::pos2(self.wipe, 0.0), egui::pos2(1.0, 1.0));
                painter.image(render.id(), right, part, Color32::WHITE);
                painter.vline(x, rect.y_range(), Stroke::new(1.5, Color32::WHITE));
                painter.circle(
                    egui::pos2(x, rect.center().y),
                    7.0,
                    Color32::WHITE,
                    Stroke::new(1.0, Color32::BLACK),
                );
                let grip = Rect::from_center_size(
                    egui::pos2(x, rect.center().y),
                    vec2(24.0, rect.height()),
                );
                let response = ui
                    .interact(grip, Id::unique("wipe"), Sense::DRAG)
                    .on_hover_cursor(CursorIcon::ResizeHorizontal);
                response.widget_info(|| {
                    egui::WidgetInfo::labeled(
                        egui::Role::Slider,
                        true,
                        "Wipe between photo and render",
                    )
                });
                if let Some(pointer) = response.interact_pointer_pos() {
                    self.wipe = ((pointer.x - rect.left()) / rect.width()).clamp(0.01, 0.99);
                }
            }
            _ => {
                whole(&shown.photo);
                painter.text(
                    rect.center_bottom() - vec2(0.0, 14.0),
                    Align2::CENTER_BOTTOM,
                    "Rendering…",
                    egui::TextStyle::Body.resolve(ui.style()),
                    Color32::WHITE,
                );
            }
        }
    }
}

/// Size of the compared pictures of a camera.
fn size(camera: &Camera) -> [u32; 2] {
    let longest = camera.width.max(camera.height);
    let scale = f64::from(LONGEST.min(longest)) / f64::from(longest);
    [camera.width, camera.height].map(|side| ((f64::from(side) * scale).round() as u32).max(1))
}

fn upload(ctx: &egui::Context, pair: &Pair, display: &Display) -> Shown {
    let load =
        |name: &str, image: ColorImage| ctx.load_texture(name, image, TextureOptions::LINEAR);
    let render = pair.render.as_ref();
    Shown {
        display: *display,
        photo: load("photo", pair.photo.image(display)),
        render: render.map(|render| load("render", render.image(display))),
        difference: render
            .map(|render| load("difference", difference(&pair.photo, render, display))),
    }
}

/// The greatest difference of the channels, as a part of [`FULL`] of white, on the Turbo map.
fn difference(photo: &Linear, render: &Linear, display: &Display) -> ColorImage {
    let pixels = photo
        .radiance
        .par_iter()
        .zip(&render.radiance)
        .zip(photo.coverage.par_iter().zip(&render.coverage))
        .map(|((&a, &b), (&covered, &seen))| {
            let apart = (a - b).abs().max_element() * display.gain();
            mix(
                turbo(apart / FULL),
                display.background,
                covered.max(seen).min(1.0),
            )
        })
        .collect();
    ColorImage::new([photo.width, photo.height], pixels)
}

/// What the colours of the difference mean.
fn legend(painter: &egui::Painter, rect: Rect) {
    const STEPS: usize = 32;
    let bar = Rect::from_min_size(rect.right_bottom() + vec2(-194.0, -34.0), vec2(180.0, 8.0));
    for i in 0..STEPS {
        let t = (i as f32 + 0.5) / STEPS as f32;
        let step = Rect::from_min_max(
            egui::pos2(
                bar.left() + bar.width() * i as f32 / STEPS as f32,
                bar.top(),
            ),
            egui::pos2(
                bar.left() + bar.width() * (i + 1) as f32 / STEPS as f32,
                bar.bottom(),
            ),
        );
        painter.rect_filled(step, 0.0, mix(turbo(t), Color32::BLACK, 1.0));
    }
    let font = egui::FontId::proportional(11.0);
    let full = format!("{:.0} % of white", 100.0 * FULL);
    for (at, align, text) in [
        (bar.left_bottom(), Align2::LEFT_TOP, "0"),
        (bar.right_bottom(), Align2::RIGHT_TOP, full.as_str()),
    ] {
        painter.text(
            at + vec2(0.0, 3.0),
            align,
            text,
            font.clone(),
            Color32::WHITE,
        );
    }
}

/// PSNR inside the object, white as in the photograph, dB.
fn psnr(photo: &Linear, render: &Linear) -> f32 {
    let inside = |i: &usize| photo.coverage[*i] > COVERED && render.coverage[*i] > COVERED;
    let pixels = |picture: &Linear| -> Vec<Vec3> {
        let all = (0..photo.radiance.len()).filter(inside);
        all.map(|i| picture.radiance[i]).collect()
    };
    relight::psnr(&pixels(photo), &pixels(render))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: f32) -> Linear {
        Linear {
            width: 40,
            height: 30,
            radiance: vec![Vec3::splat(value); 1200],
            coverage: vec![1.0; 1200],
        }
    }

    #[test]
    fn equal_pictures_differ_nowhere() {
        let display = Display {
            exposure: 0.0,
            white: 1.0,
            transform: rekindle_relight::ViewTransform::Srgb,
            background: Color32::BLACK,
        };
        let same = difference(&picture(0.3), &picture(0.3), &display);
        let none = mix(turbo(0.0), Color32::BLACK, 1.0);
        assert!(same.pixels.iter().all(|&p| p == none));
        let far = difference(&picture(0.3), &picture(0.9), &display);
        let most = mix(turbo(1.0), Color32::BLACK, 1.0);
        assert!(far.pixels.iter().all(|&p| p == most));
    }
}
