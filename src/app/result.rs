//! The result card: what a solve is worth and why. It stays beside the estimation and the relighting.

use eframe::egui::{self, Button, RichText, ScrollArea, vec2};

use super::capture_page::roughness_slider;
use super::commands::Action;
use super::theme::{self, Mark};
use super::{Request, Shared};
use rekindle_capture::LightFrame;
use rekindle_estimate::estimate::Method;
use rekindle_estimate::registration::{Correction, describe};
use rekindle_solution::{KnownLight, Solution};

/// Width of the card, points.
const WIDE: f32 = 300.0;
/// The picture of a view that comes out with this many dB is right for the eye: its bar is full.
const FULL_DB: f32 = 50.0;

/// Roughnesses that differ by less are one.
const LEAST_DIFFERENCE: f32 = 5e-3;

/// What a solve is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The data determine roughness and lights.
    Good,
    /// So they do, and there is something to know.
    Noted,
    /// Something contradicts the result.
    Doubtful,
    /// The light is what the shading tells: the object can be relit, less exactly than by its highlights.
    Approximate,
    /// No light was found: the object can't be relit.
    Failed,
}

impl Verdict {
    /// The verdict that a solution comes to.
    pub fn of(solution: &Solution) -> Self {
        match &solution.diagnostics {
            d if !d.specular_found => match &solution.known_light {
                // Of a matt surface under a given light nothing is open but how that is turned.
                Some(known) if known.rotation_stated => Self::Noted,
                Some(_) => Self::Doubtful,
                None if solution.lamps.is_empty() => Self::Failed,
                None => Self::Approximate,
            },
            d if !d.well_posed => Self::Doubtful,
            d if !d.warnings.is_empty() => Self::Noted,
            _ => Self::Good,
        }
    }

    /// Whether a user has to look at it before going on.
    pub fn asks_for_a_look(self) -> bool {
        matches!(self, Self::Doubtful | Self::Approximate | Self::Failed)
    }

    /// Its name, its mark and what it means, where the light was given or where it was sought.
    fn words(self, given: bool) -> (&'static str, Mark, &'static str) {
        let determined = if given {
            "The photographs determine the surface under the given light."
        } else {
            "The photographs determine roughness and lights."
        };
        match self {
            Self::Good => ("Good", Mark::Good, determined),
            Self::Noted => ("Good, with notes", Mark::Good, determined),
            Self::Doubtful if given => (
                "Doubtful",
                Mark::Warning,
                "Something contradicts the given light; see below what, and what to do.",
            ),
            Self::Doubtful => (
                "Doubtful",
                Mark::Warning,
                "Something contradicts roughness and lights; see below what, and what to do.",
            ),
            Self::Approximate => (
                "Approximate",
                Mark::Warning,
                "No highlights were found, so the light is what the shading tells. The object can be relit: sides and colours come \
                 out right, sharp shadows and the light's strength are a guess. For more, photograph something glossy with it, and \
                 have that in the mesh.",
            ),
            Self::Failed => (
                "Failed",
                Mark::Error,
                "Neither highlights nor shading tell of the light: the object has its colours as photographed, with their light in \
                 them. Photograph it in light from one side, or with something glossy that the mesh shows, too.",
            ),
        }
    }
}

/// The verdict on a solution by its name, its mark and what it means.
fn told(solution: &Solution) -> (&'static str, Mark, &'static str) {
    Verdict::of(solution).words(solution.known_light.is_some())
}

/// The button that opens the card, while it is closed.
pub(super) fn button(ui: &mut egui::Ui, solution: &Solution, shared: &mut Shared<'_>) {
    if shared.settings.result {
        return;
    }
    let (name, mark, meaning) = told(solution);
    let text = RichText::new(format!("Result: {name}")).color(mark.colour(ui));
    let tip = format!("{meaning} Shows the result card");
    if ui.button(text).on_hover_text(tip).clicked() {
        shared.settings.result = true;
    }
}

/// Shows the card at the right of a page, if it is open.
pub(super) fn panel(ui: &mut egui::Ui, solution: &Solution, shared: &mut Shared<'_>) {
    if !shared.settings.result {
        return;
    }
    egui::Panel::right("result")
        .frame(theme::side(ui))
        .resizable(false)
        .exact_size(WIDE)
        .show(ui, |ui| {
            head_ui(ui, solution, shared);
            ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                // Room for the scroll bar.
                ui.set_max_width(ui.available_width() - 10.0);
                doubts_ui(ui, solution);
                surface_ui(ui, solution);
                roughness_ui(ui, solution, shared);
                corrections_ui(ui, solution);
                views_ui(ui, solution, shared);
            });
        });
}

fn head_ui(ui: &mut egui::Ui, solution: &Solution, shared: &mut Shared<'_>) {
    let (name, mark, meaning) = told(solution);
    ui.horizontal(|ui| {
        mark.show(ui);
        ui.label(RichText::new(name).strong().color(mark.colour(ui)));
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let tip = "Hide the card; a button in its place brings it back";
            if theme::close_button(ui, "Close the result", tip).clicked() {
                shared.settings.result = false;
            }
        });
    });
    ui.label(meaning);
    ui.add_space(theme::GAP * 0.5);
}

/// What a user should know, each with what to do.
fn doubts_ui(ui: &mut egui::Ui, solution: &Solution) {
    let diagnostics = &solution.diagnostics;
    // Corrections have a group of their own.
    let corrected = describe(&solution.corrections);
    let told = diagnostics.warnings.iter();
    let told: Vec<&String> = told.filter(|w| !corrected.contains(w)).collect();
    if told.is_empty() {
        return;
    }
    let mark = if Verdict::of(solution).asks_for_a_look() {
        Mark::Warning
    } else {
        Mark::Note
    };
    theme::group(ui, "What to know");
    for warning in told {
        let (what, remedy) = first_sentence(warning);
        theme::card(ui).inner_margin(8).show(ui, |ui| {
            ui.set_width(ui.available_width());
            ui.horizontal_top(|ui| {
                mark.show(ui);
                ui.vertical(|ui| {
                    ui.label(what);
                    if !remedy.is_empty() {
                        ui.weak(remedy);
                    }
                });
            });
        });
    }
    ui.add_space(theme::GAP * 0.5);
}

/// A text's first sentence, which says what is the matter, and the others, which say why and what to do.
fn first_sentence(text: &str) -> (&str, &str) {
    let begins = |rest: &str| rest.chars().next().is_some_and(char::is_uppercase);
    let end = text
        .match_indices(". ")
        .find(|(at, _)| begins(&text[at + 2..]));
    end.map_or((text, ""), |(at, _)| (&text[..=at], &text[at + 2..]))
}

/// Roughness with its interval, the lobe and the reason for it, and how much is left.
fn surface_ui(ui: &mut egui::Ui, solution: &Solution) {
    theme::group(ui, "Surface and lights");
    let mut rows = Vec::new();
    let mut tell = |name, value, tip| rows.push(Fact { name, value, tip });
    let tip = "How the surface reflects, and how rough it is: 0 is a mirror, 1 is matt";
    tell("Surface", solution.surface_in_words(), tip);
    if let Some(brdf) = solution.brdf {
        let tip = "How far the surface spreads a highlight, in radians; the smaller, the glossier";
        tell("σ", format!("{:.4} rad", brdf.sigma), tip);
        if let Some([low, high]) = solution.sigma_interval95 {
            let tip = "The photographs allow any σ in here: 19 times of 20 the true one is";
            let value = format!("{low:.4} to {high:.4} rad");
            tell("95 % interval", value, tip);
        }
        let tip = "The formula for the form of a highlight";
        tell("Lobe", brdf.model.name().to_owned(), tip);
        if !solution.chosen_because.is_empty() {
            let tip = "Why this formula and no other";
            tell("Chosen", solution.chosen_because.clone(), tip);
        }
    }
    if let Some(known) = &solution.known_light {
        tell(
            "Light",
            given(known),
            "The picture of the place's light, and how it was turned about the capture's up",
        );
        if let Some(f0) = solution.known_reflectance() {
            let value = format!("{:.1} % at normal incidence", 100.0 * f0);
            tell(
                "Reflects",
                value,
                "Part of the light that the gloss reflects of what falls on it head-on",
            );
        }
        if let Some(white) = solution.known_white() {
            let value = format!("{white:.2} where it is brightest, absolute");
            tell(
                "Albedo",
                value,
                "Part of the light that the colours throw back, 0 to 1",
            );
        }
    }
    let tip = if solution.known_light.is_some() {
        "How many lights the picture has; each can be moved, dimmed and coloured"
    } else {
        "How many lights were found; each can be moved, dimmed and coloured"
    };
    let mut lights = solution.lamps.len().to_string();
    if solution.light_frame == LightFrame::Camera {
        lights += ", still with the camera; here as they stood in the first view";
    }
    tell("Lights", lights, tip);
    if let Some(misfit) = solution.fit.misfit {
        let value = format!("{:.1} % beyond noise", 100.0 * misfit);
        let tip = "The part of the highlights that roughness and lights leave unexplained, apart from noise of the photographs";
        tell("Unexplained", value, tip);
    }
    facts(ui, rows);
}

/// Another roughness to estimate the lights for: where photographs leave it open, the user may know it.
fn roughness_ui(ui: &mut egui::Ui, solution: &Solution, shared: &mut Shared<'_>) {
    let Some(brdf) = solution.brdf.filter(|_| solution.method == Method::Fast) else {
        return;
    };
    let settings = &mut shared.settings.estimation;
    let found = brdf.roughness();
    let mut stated = settings.stated_roughness().unwrap_or(found);
    ui.horizontal(|ui| {
        let label = ui.weak("Roughness");
        if roughness_slider(ui, &mut stated)
            .labelled_by(label.id)
            .changed()
        {
            settings.roughness = Some(stated);
        }
    });
    let Some(stated) = settings.stated_roughness() else {
        ui.add_space(theme::GAP * 0.5);
        return;
    };
    let (estimate, open) = ui
        .horizontal(|ui| {
            let differs = (stated - found).abs() > LEAST_DIFFERENCE;
            let estimate = Button::new("Estimate with this");
            let estimate = ui
                .add_enabled(differs && !shared.busy, estimate)
                .on_hover_text("Seek the lights again for a surface as rough as this; this run is kept beside it")
                .on_disabled_hover_text("This run has this roughness");
            let open = ui
                .button("Leave it open")
                .on_hover_text("Have the roughness estimated the next time");
            (estimate.clicked(), open.clicked())
        })
        .inner;
    if open {
        shared.settings.estimation.roughness = None;
    }
    if estimate {
        shared.actions.push(Request::Action(Action::Solve));
    }
    ui.add_space(theme::GAP * 0.5);
}

/// A light that was given, in words.
fn given(known: &KnownLight) -> String {
    let (file, turn) = (&known.file, known.rotation_deg);
    let how = if known.rotation_stated {
        "as stated"
    } else {
        "by the highlights"
    };
    format!("Given by {file}, turned by {turn:.1}° {how}; not estimated")
}

/// A name with its value, and what it means.
struct Fact<'a> {
    name: &'a str,
    value: String,
    tip: &'static str,
}

/// Shows facts; long values are wrapped.
fn facts(ui: &mut egui::Ui, rows: Vec<Fact<'_>>) {
    const NAMES: f32 = 88.0;
    for Fact { name, value, tip } in rows {
        let row = ui.horizontal_top(|ui| {
            let left = egui::Layout::left_to_right(egui::Align::Min);
            ui.allocate_ui_with_layout(vec2(NAMES, 0.0), left, |ui| {
                ui.set_min_width(NAMES);
                ui.weak(name);
            });
            ui.vertical(|ui| ui.add(egui::Label::new(value).wrap()));
        });
        row.response.on_hover_text(tip);
    }
    ui.add_space(theme::GAP * 0.5);
}

fn corrections_ui(ui: &mut egui::Ui, solution: &Solution) {
    theme::group(ui, "Corrections to cameras and exposures");
    let numbered = solution.corrections.iter().enumerate();
    let rows: Vec<(String, String)> = numbered
        .filter_map(|(i, c)| Some((format!("View {}", i + 1), correction(c)?)))
        .collect();
    if rows.is_empty() {
        ui.label("None: all are taken as stated.");
        ui.add_space(theme::GAP * 0.5);
        return;
    }
    let tip = "What was put right before the estimate, because the photographs say so";
    let told = rows.iter().map(|(name, value)| Fact {
        name,
        value: value.clone(),
        tip,
    });
    facts(ui, told.collect());
}

/// What was corrected about a view, if anything was.
fn correction(correction: &Correction) -> Option<String> {
    /// Percent below which a change of exposure is not worth a word.
    const LEAST: f64 = 0.05;
    let mut parts = Vec::new();
    let length = |[x, y, z]: [f64; 3]| x.hypot(y).hypot(z);
    let (degrees, shift) = (length(correction.turn_deg), length(correction.shift));
    match (degrees > 0.0, shift > 0.0) {
        (true, false) => parts.push(format!("camera turned by {degrees:.2}°")),
        (false, true) => parts.push(format!("camera moved by {shift:.3}")),
        (true, true) => {
            parts.push(format!(
                "camera turned by {degrees:.2}°, moved by {shift:.3}"
            ));
        }
        (false, false) => {}
    }
    let percent = 100.0 * (correction.exposure - 1.0);
    if percent.abs() >= LEAST {
        let word = if percent > 0.0 { "brighter" } else { "darker" };
        parts.push(format!("{:.1} % {word} than most", percent.abs()));
    }
    let tint = correction.balance.iter().map(|b| (b - 1.0).abs());
    let tint = 100.0 * tint.fold(0.0, f64::max);
    if tint >= LEAST {
        parts.push(format!("white balance off by {tint:.1} %"));
    }
    (!parts.is_empty()).then(|| parts.join(", "))
}

/// How well each photograph is reproduced; a click shows where it isn't.
fn views_ui(ui: &mut egui::Ui, solution: &Solution, shared: &mut Shared<'_>) {
    let views = &solution.fit.psnr_db_per_view;
    if views.is_empty() {
        return;
    }
    theme::group(ui, "Photographs reproduced")
        .on_hover_text("Peak signal-to-noise ratio of the rendering against the photograph: 30 dB show differences when looked for, 40 dB hardly any");
    for (i, &db) in views.iter().enumerate() {
        if view_ui(ui, i, db).clicked() {
            shared.actions.push(Request::ShowDifference(i));
        }
    }
}

fn view_ui(ui: &mut egui::Ui, i: usize, db: f32) -> egui::Response {
    let size = vec2(ui.available_width(), 22.0);
    let (rect, response) = ui.allocate_exact_size(size, egui::Sense::click());
    let palette = theme::palette(ui);
    let hovered = response.hovered() || response.has_focus();
    let colour = if hovered {
        palette.accent
    } else {
        palette.weak
    };
    let painter = ui.painter_at(rect);
    let font = egui::TextStyle::Body.resolve(ui.style());
    let text = ui.visuals().text_color();
    let left = rect.left_center();
    let view = format!("View {}", i + 1);
    painter.text(left, egui::Align2::LEFT_CENTER, view, font.clone(), text);
    let value = format!("{db:.1} dB");
    let right = rect.right_center();
    painter.text(right, egui::Align2::RIGHT_CENTER, value, font, text);
    let bar = egui::Rect::from_min_max(
        rect.left_center() + vec2(64.0, -3.0),
        rect.right_center() + vec2(-64.0, 3.0),
    );
    painter.rect_filled(bar, 3.0, palette.line);
    let mut full = bar;
    full.set_width(bar.width() * (db / FULL_DB).clamp(0.0, 1.0));
    painter.rect_filled(full, 3.0, colour);
    let name = format!("Difference at view {}, {db:.1} dB", i + 1);
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, name.clone()));
    response.on_hover_text("Show where photograph and rendering differ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_estimate::estimate::Diagnostics;
    use rekindle_studio::fixtures::solution;
    use std::sync::Arc;

    #[test]
    fn verdicts_follow_from_what_the_data_say() {
        let mut found = Arc::into_inner(solution()).expect("a solution of its own");
        found.diagnostics = Diagnostics {
            well_posed: true,
            specular_found: true,
            warnings: Vec::new(),
        };
        assert_eq!(Verdict::of(&found), Verdict::Good);
        let metal = "The surface is a metal's.".to_owned();
        found.diagnostics.warnings.push(metal);
        assert_eq!(Verdict::of(&found), Verdict::Noted);
        found.diagnostics.well_posed = false;
        assert_eq!(Verdict::of(&found), Verdict::Doubtful);
        // Without highlights it can be relit as long as the shading told of light.
        found.diagnostics.specular_found = false;
        assert_eq!(Verdict::of(&found), Verdict::Approximate);
        found.lamps.clear();
        assert_eq!(Verdict::of(&found), Verdict::Failed);
        // Under a given light a matt surface leaves nothing open, unless its turn was to be sought by highlights.
        let mut known = KnownLight {
            file: "probe.exr".to_owned(),
            rotation_deg: 90.0,
            rotation_stated: true,
            specular_reflectance: [0.0; 3],
            albedo_scale: 3.0,
        };
        found.known_light = Some(known.clone());
        assert_eq!(Verdict::of(&found), Verdict::Noted);
        known.rotation_stated = false;
        found.known_light = Some(known);
        assert_eq!(Verdict::of(&found), Verdict::Doubtful);
    }

    #[test]
    fn a_warning_is_told_from_its_remedy() {
        let text = "Normals are off by 1.5° or more. Use a smoother mesh. It helps.";
        let told = (
            "Normals are off by 1.5° or more.",
            "Use a smoother mesh. It helps.",
        );
        assert_eq!(first_sentence(text), told);
        assert_eq!(first_sentence("All is well."), ("All is well.", ""));
    }

    #[test]
    fn corrections_are_told_in_words() {
        assert_eq!(correction(&Correction::default()), None);
        let both = Correction {
            turn_deg: [0.0, 0.3, 0.4],
            exposure: 0.92,
            ..Correction::default()
        };
        let text = correction(&both).expect("two corrections");
        assert_eq!(text, "camera turned by 0.50°, 8.0 % darker than most");
        let moved = Correction {
            shift: [0.0, 0.0, 0.25],
            ..both
        };
        let text = correction(&moved).expect("three corrections");
        assert_eq!(
            text,
            "camera turned by 0.50°, moved by 0.250, 8.0 % darker than most"
        );
    }
}
