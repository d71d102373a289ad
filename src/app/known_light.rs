//! The light of the place, where its picture is known: chosen and turned on the page of a capture, before it is estimated.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui::{
    self, ColorImage, Rect, RichText, Sense, Stroke, TextureHandle, TextureOptions,
    TextureWrapMode, pos2, vec2,
};
use glam::Vec2;

use super::Shared;
use crate::worker::{Latest, Purpose, Worker};
use rekindle_capture::Capture;
use rekindle_scene::hemisphere::{Exposure, Picture};
use rekindle_solution::{KnownLight, LightProbe};

/// Part of the picture's pixels that is shown darker than white.
const SHOWN: f32 = 0.95;

/// A picture of the light, and how it is turned.
#[derive(Clone)]
pub(super) struct GivenLight {
    path: PathBuf,
    probe: LightProbe,
    texture: TextureHandle,
    /// The turn that was stated or found last, degrees from 0 to 360.
    degrees: f32,
    /// Whether the highlights told that turn.
    found: bool,
}

impl PartialEq for GivenLight {
    fn eq(&self, other: &Self) -> bool {
        self.path == other.path
            && self.texture == other.texture
            && self.probe.turn == other.probe.turn
    }
}

/// A picture that was read, and as it is shown.
type Read = Result<(PathBuf, LightProbe, ColorImage), String>;

/// Where the light is chosen.
#[derive(Default)]
pub(super) struct KnownLightChoice {
    read: Arc<Latest<Read>>,
    reading: bool,
    /// The light before what is done to it now.
    settled: Option<GivenLight>,
}

impl KnownLightChoice {
    /// Reads a picture beside the window's thread.
    pub(super) fn read(&mut self, worker: &mut Worker, path: &Path) {
        let (slot, path) = (Arc::clone(&self.read), path.to_owned());
        self.reading = true;
        worker.aside("known light", move || {
            let read = LightProbe::load(&path, None).map(|probe| {
                let shown = shown(&probe.picture());
                (path, probe, shown)
            });
            slot.store(read.map_err(|e| e.to_string()));
        });
    }

    /// Takes a picture that was read; a turn that was stated stays. Says what was wrong with it, once.
    pub(super) fn take(
        &mut self,
        ctx: &egui::Context,
        now: &mut Option<GivenLight>,
    ) -> Option<String> {
        let read = self.read.take()?;
        self.reading = false;
        let (path, mut probe, image) = match read {
            Ok(read) => read,
            Err(problem) => return Some(problem),
        };
        probe.turn = now.as_ref().and_then(|light| light.probe.turn);
        let options = TextureOptions {
            wrap_mode: TextureWrapMode::Repeat,
            ..TextureOptions::LINEAR
        };
        *now = Some(GivenLight {
            path,
            degrees: probe.turn.map_or(0.0, f32::to_degrees),
            probe,
            texture: ctx.load_texture("known light", image, options),
            found: false,
        });
        None
    }

    /// Whether a change of the light has just ended: a drag is one change.
    pub(super) fn has_changed(&self, ctx: &egui::Context, now: Option<&GivenLight>) -> bool {
        let is_held = ctx.input(|i| i.pointer.any_down()) || ctx.text_edit_focused();
        !is_held && now != self.settled.as_ref()
    }

    /// Takes the light as it is now for settled, and gives what was before.
    pub(super) fn settle(&mut self, now: Option<&GivenLight>) -> Option<GivenLight> {
        std::mem::replace(&mut self.settled, now.cloned())
    }

    /// Shows the choice.
    pub(super) fn show(
        &self,
        ui: &mut egui::Ui,
        shared: &mut Shared<'_>,
        capture: &Capture,
        now: &mut Option<GivenLight>,
    ) {
        if self.reading {
            ui.horizontal(|ui| {
                ui.strong("Light");
                ui.spinner();
                ui.label("Reading the picture");
            });
            return;
        }
        // In one line: the panel of a small window is full.
        ui.horizontal_wrapped(|ui| {
            ui.strong("Light");
            let estimate = ui
                .radio(now.is_none(), "Estimate it")
                .on_hover_text("Find the lights by the highlights in the photographs");
            let choose = ui.radio(now.is_some(), "Known light…").on_hover_text(
                "Choose a lat-long picture (EXR or Radiance HDR) of all the light of the place, in the photographs' units: no \
                 light is estimated then, and roughness, gloss and albedo are absolute (Ctrl+L, or drop the picture here)",
            );
            if estimate.clicked() {
                *now = None;
            }
            if choose.clicked() {
                let start = now.as_ref().and_then(|light| light.path.parent());
                shared.worker.pick(Purpose::KnownLight, start);
            }
        });
        if let Some(light) = now {
            light.show(ui, capture);
        }
    }
}

impl GivenLight {
    /// What a solve is given.
    pub(super) fn probe(&self) -> &LightProbe {
        &self.probe
    }

    /// Takes the turn that a solve found, to begin with where it is turned by hand.
    pub(super) fn solved(&mut self, known: &KnownLight) {
        if self.probe.turn.is_none() && self.probe.file() == known.file {
            self.degrees = known.rotation_deg;
            self.found = true;
        }
    }

    fn turn_to(&mut self, degrees: f32) {
        self.degrees = degrees;
        self.probe.turn = Some(degrees.to_radians());
    }

    fn show(&mut self, ui: &mut egui::Ui, capture: &Capture) {
        ui.add_space(4.0);
        self.picture_ui(ui, capture);
        ui.add(egui::Label::new(RichText::new(self.probe.file()).strong()).truncate())
            .on_hover_text(self.path.display().to_string());
        ui.horizontal_wrapped(|ui| {
            ui.label("Turn");
            let stated = self.probe.turn.is_some();
            let sought = ui.radio(!stated, "By the highlights").on_hover_text(
                "Turn the picture about the capture's up to where it explains the highlights best",
            );
            let by_hand = ui
                .radio(stated, "By hand")
                .on_hover_text("State how the picture is turned about the capture's up");
            if sought.clicked() {
                self.probe.turn = None;
            }
            if by_hand.clicked() {
                self.turn_to(self.degrees);
            }
        });
        if self.probe.turn.is_some() {
            let mut degrees = self.degrees;
            let slider = egui::Slider::new(&mut degrees, 0.0..=360.0)
                .clamping(egui::SliderClamping::Edits)
                .fixed_decimals(1)
                .suffix("°");
            let turned = ui
                .add(slider)
                .accessible_name("Turn of the known light")
                .on_hover_text("About the capture's up, counter-clockwise seen from above");
            if turned.changed() {
                self.turn_to(degrees);
            }
        } else if self.found {
            ui.weak(format!("The highlights told {:.1}°.", self.degrees));
        }
        ui.weak("No light is estimated. Roughness, gloss and albedo come in absolute units.");
    }

    /// The picture as the object sees it, with the cameras; dragged sideways it is turned.
    fn picture_ui(&mut self, ui: &mut egui::Ui, capture: &Capture) {
        let size = vec2(ui.available_width(), 0.5 * ui.available_width());
        let (rect, response) = ui.allocate_exact_size(size, Sense::drag());
        let response = response.on_hover_cursor(egui::CursorIcon::ResizeHorizontal);
        let across = response.drag_delta().x;
        if across != 0.0 {
            let degrees = self.degrees - 360.0 * across / rect.width();
            self.turn_to(degrees.rem_euclid(360.0));
        }
        // A picture that is turned counter-clockwise goes to the left.
        let left = self.degrees / 360.0;
        let uv = Rect::from_min_max(pos2(left, 0.0), pos2(left + 1.0, 1.0));
        let painter = ui.painter_at(rect);
        painter.image(self.texture.id(), rect, uv, egui::Color32::WHITE);
        let (light, dark) = (egui::Color32::WHITE, egui::Color32::BLACK);
        for place in cameras(capture) {
            let at = rect.min + vec2(place.x * rect.width(), place.y * rect.height());
            painter.circle(at, 4.0, dark, Stroke::new(1.5, light));
        }
        let name = "The known light around the object";
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, name));
        response.on_hover_text(
            "The light around the object, its top above. Circles are where cameras stand. Drag it sideways to turn it by hand",
        );
    }
}

/// Where cameras stand in the unturned picture, as parts of its width and height from its top left corner.
fn cameras(capture: &Capture) -> impl Iterator<Item = Vec2> {
    let (centre, up) = (capture.mesh.centre(), capture.light_hemisphere.up.as_vec3());
    let towards = move |view: &rekindle_capture::View| {
        (view.camera.position().as_vec3() - centre).normalize_or_zero()
    };
    let views = capture.views.iter();
    views.map(move |view| LightProbe::place_of(up, towards(view)))
}

/// A picture of light as the window shows it: all but its brightest parts by their shades.
fn shown(picture: &Picture) -> ColorImage {
    let mut levels: Vec<f32> = picture
        .radiance
        .iter()
        .map(|pixel| pixel.iter().copied().fold(0.0, f32::max))
        .collect();
    let bright = (SHOWN * (levels.len() - 1) as f32) as usize;
    levels.sort_by(f32::total_cmp);
    // Where most of it is black, by its brightest.
    let white = [levels[bright], levels[levels.len() - 1]];
    let white = white.into_iter().find(|&w| w > 0.0).unwrap_or(1.0);
    let pixels = picture.to_rgb8(Exposure::Linear { white });
    let pixels = pixels.into_iter().flatten().collect::<Vec<u8>>();
    ColorImage::from_rgb([picture.width as usize, picture.height as usize], &pixels)
}
