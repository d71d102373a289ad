//! The list of lamps and the settings of the selected one.

use eframe::egui::{
    self, Align, Align2, Button, CornerRadius, Layout, RichText, Sense, Stroke, vec2,
};
use glam::{Quat, Vec3};

use super::editing::{Editing, hue, undoable, with_lamp};
use super::whereabouts::Viewer;
use crate::app::theme;
use rekindle_relight::luminance;
use rekindle_scene::hemisphere::from_above_axes;
use rekindle_studio::{
    ANGULAR_RADIUS, Baseline, Colour, Document, KELVIN, Lamp, LampId, MAX_STOPS, Origin, black_body,
};

/// Why a light can't be reset.
pub(super) const NO_RESET: &str =
    "Only a light of the estimate that was changed has something to go back to.";
/// Intensities that the slider reaches; more can be typed.
const SLIDER_STOPS: f32 = 6.0;
/// Where a colour temperature begins: noon.
const NOON: f32 = 5600.0;

/// Width of the labels before settings, points.
pub(super) const LABELS: f32 = 72.0;

/// What a row asks for.
enum Wish {
    Mute(LampId),
    Solo(LampId),
    Rename(LampId, String),
    Duplicate(LampId),
    Delete(LampId),
    Reset(LampId),
}

/// The lamps of the look that is shown, those first that send the most light, or would if they were on.
pub(super) fn by_contribution(document: &Document) -> Vec<Lamp> {
    let base = document.base();
    let mut lamps = document.look().lamps.clone();
    let strength = |lamp: &Lamp| luminance(base.flux(lamp));
    lamps.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    lamps
}

/// Buttons for the list's lamps.
pub(super) fn buttons(ui: &mut egui::Ui, document: &mut Document, editing: &mut Editing) {
    ui.horizontal(|ui| {
        let tip = "Add a white disc of light from above the camera's side (A)";
        if ui.button("Add light").on_hover_text(tip).clicked() {
            add(document, editing);
        }
        let selected = editing.selected(document.look()).map(|l| l.id);
        for (name, tip) in [
            (
                "Duplicate",
                "Put a copy of the selected light beside it (Shift+D)",
            ),
            (
                "Delete",
                "Remove the selected light (Delete); undo brings it back",
            ),
        ] {
            let button = ui.add_enabled(selected.is_some(), Button::new(name));
            let clicked = button
                .on_hover_text(tip)
                .on_disabled_hover_text("Select a light first")
                .clicked();
            match (clicked, selected) {
                (true, Some(id)) if name == "Delete" => delete(document, editing, id),
                (true, Some(id)) => duplicate(document, editing, id),
                _ => {}
            }
        }
    });
}

/// Shows the list in the room that is left; it scrolls by itself.
pub(super) fn list(
    ui: &mut egui::Ui,
    document: &mut Document,
    editing: &mut Editing,
    viewer: &Viewer,
) {
    let mut wish = None;
    let lamps = by_contribution(document);
    let total = editing.total_light(document);
    let (look, base) = (document.look().clone(), document.base().clone());
    let scroll = egui::ScrollArea::vertical().id_salt("lamps");
    scroll.auto_shrink(false).show(ui, |ui| {
        // Room for the scroll bar.
        ui.set_max_width(ui.available_width() - 10.0);
        if lamps.is_empty() {
            ui.weak("No lights. Add one above.");
        }
        for lamp in &lamps {
            let dark = look.is_dark(lamp);
            let own = if dark {
                0.0
            } else {
                luminance(base.flux(lamp))
            };
            let row = Row {
                lamp,
                dark,
                solo: look.solo == Some(lamp.id),
                share: own / total.max(f32::MIN_POSITIVE),
                place: viewer.words(lamp.direction),
            };
            if let Some(asked) = row.show(ui, &base, editing) {
                wish = Some(asked);
            }
        }
    });
    match wish {
        Some(Wish::Mute(id)) => mute(document, id),
        Some(Wish::Solo(id)) => solo(document, id),
        Some(Wish::Rename(id, name)) => {
            document.edit("Rename light", |s, _| with_lamp(s, id, |l| l.name = name));
        }
        Some(Wish::Duplicate(id)) => duplicate(document, editing, id),
        Some(Wish::Delete(id)) => delete(document, editing, id),
        Some(Wish::Reset(id)) => reset(document, id),
        None => {}
    }
}

/// A row of the list.
struct Row<'a> {
    lamp: &'a Lamp,
    dark: bool,
    solo: bool,
    /// Part of all light that it sends.
    share: f32,
    /// Where it is, in words.
    place: String,
}

impl Row<'_> {
    fn show(&self, ui: &mut egui::Ui, base: &Baseline, editing: &mut Editing) -> Option<Wish> {
        let lamp = self.lamp;
        let mut wish = None;
        ui.horizontal(|ui| {
            swatch(ui, base, lamp, self.dark);
            let buttons = 62.0;
            let width = (ui.available_width() - buttons).max(40.0);
            if let Some((id, mut text)) = editing.renaming.take_if(|(id, _)| *id == lamp.id) {
                let field = egui::TextEdit::singleline(&mut text).desired_width(width - 16.0);
                let field = ui.add(field).accessible_name("Name of the light");
                field.request_focus();
                let enter = ui.input(|i| i.key_pressed(egui::Key::Enter));
                let escape = ui.input(|i| i.key_pressed(egui::Key::Escape));
                if enter || field.clicked_elsewhere() {
                    let name = text.trim();
                    if !name.is_empty() && name != lamp.name {
                        wish = Some(Wish::Rename(id, name.to_owned()));
                    }
                } else if !escape {
                    editing.renaming = Some((id, text));
                }
            } else if let Some(asked) = self.name_ui(ui, width, editing) {
                wish = Some(asked);
            }
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                ui.spacing_mut().item_spacing.x = 4.0;
                ui.spacing_mut().button_padding.x = 7.0;
                let tip = "Leave only this light and the ambient light on (S)";
                let name = format!("Solo {}", lamp.name);
                if toggle(ui, self.solo, "S", &name, tip) {
                    wish = Some(Wish::Solo(lamp.id));
                }
                let name = format!("Mute {}", lamp.name);
                if toggle(
                    ui,
                    lamp.muted,
                    "M",
                    &name,
                    "Switch this light off or on (M)",
                ) {
                    wish = Some(Wish::Mute(lamp.id));
                }
            });
        });
        wish
    }

    /// Name, place and share of all light, to be clicked.
    fn name_ui(&self, ui: &mut egui::Ui, width: f32, editing: &mut Editing) -> Option<Wish> {
        let lamp = self.lamp;
        let height = ui.spacing().interact_size.y;
        let (rect, response) = ui.allocate_exact_size(vec2(width, height), Sense::click());
        let selected = editing.is_selected(lamp.id);
        response.widget_info(|| {
            egui::WidgetInfo::selected(egui::Role::Button, true, selected, &lamp.name)
        });
        let share = format!("{:.0} %", 100.0 * self.share);
        let place = &self.place;
        let described = format!("{place}, {share} of the light");
        ui.ctx()
            .accesskit_node_builder(response.id, |node| node.set_description(described.clone()));
        self.paint(ui, rect, &response, selected, &share);
        if selected && editing.scroll_to.take_if(|id| *id == lamp.id).is_some() {
            response.scroll_to_me(None);
        }
        if response.hovered() {
            editing.hovered = Some(lamp.id);
        }
        if response.double_clicked() {
            editing.renaming = Some((lamp.id, lamp.name.clone()));
        } else if response.clicked() {
            editing.select(Some(lamp.id));
        }
        let mut wish = None;
        let tip = format!(
            "{}: {described}\nClick to select, double-click to rename, right-click for more",
            lamp.name
        );
        response.on_hover_text(tip).context_menu(|ui| {
            let chosen = |ui: &mut egui::Ui, name: &str| {
                let clicked = ui.button(name).clicked();
                if clicked {
                    ui.close();
                }
                clicked
            };
            if chosen(ui, "Rename") {
                editing.renaming = Some((lamp.id, lamp.name.clone()));
            }
            if chosen(ui, "Duplicate") {
                wish = Some(Wish::Duplicate(lamp.id));
            }
            if chosen(ui, "Reset") {
                wish = Some(Wish::Reset(lamp.id));
            }
            if chosen(ui, "Delete") {
                wish = Some(Wish::Delete(lamp.id));
            }
        });
        wish
    }

    fn paint(
        &self,
        ui: &egui::Ui,
        rect: egui::Rect,
        response: &egui::Response,
        selected: bool,
        share: &str,
    ) {
        const BAR: f32 = 2.0;
        let palette = theme::palette(ui);
        let visuals = ui.style().interact_selectable(response, selected);
        let painter = ui.painter_at(rect);
        if selected || response.hovered() || response.has_focus() {
            painter.rect_filled(rect, visuals.corner_radius, visuals.weak_bg_fill);
        }
        let text = if self.dark {
            palette.weak
        } else {
            visuals.text_color()
        };
        let small = egui::TextStyle::Small.resolve(ui.style());
        let right = rect.right_center() - vec2(6.0, 1.0);
        let share = if self.dark { "off" } else { share };
        let share = painter.text(right, Align2::RIGHT_CENTER, share, small, palette.weak);
        let left = rect.left_center() + vec2(6.0, -1.0);
        let end = share.left() - 6.0;
        let short = |text: &str, style: egui::TextStyle, from: f32| {
            let text = egui::WidgetText::from(text);
            let mode = Some(egui::TextWrapMode::Truncate);
            text.into_galley(ui, mode, (end - from).max(0.0), style)
        };
        let name = short(&self.lamp.name, egui::TextStyle::Button, left.x);
        let after = egui::pos2(left.x + name.size().x + 8.0, left.y);
        let up = |galley: &egui::Galley| vec2(0.0, -0.5 * galley.size().y);
        painter.galley(left + up(&name), name, text);
        if after.x < end {
            let place = short(&self.place, egui::TextStyle::Small, after.x);
            painter.galley(after + up(&place), place, palette.weak);
        }
        let foot = rect.left_bottom() - vec2(0.0, BAR);
        let part = vec2(rect.width() * self.share.clamp(0.0, 1.0), BAR);
        painter.rect_filled(egui::Rect::from_min_size(foot, part), 1.0, palette.accent);
    }
}

/// A square of the lamp's hue; an outline where the lamp is dark.
fn swatch(ui: &mut egui::Ui, base: &Baseline, lamp: &Lamp, dark: bool) {
    let (rect, _) = ui.allocate_exact_size(vec2(14.0, 14.0), Sense::hover());
    let hue = hue(base, lamp);
    let corner = CornerRadius::same(3);
    if dark {
        let inside = egui::StrokeKind::Inside;
        ui.painter()
            .rect_stroke(rect, corner, Stroke::new(2.0, hue), inside);
    } else {
        ui.painter().rect_filled(rect, corner, hue);
    }
    // White shows on a white panel, too.
    let line = Stroke::new(1.0, theme::palette(ui).line);
    let outside = egui::StrokeKind::Outside;
    ui.painter().rect_stroke(rect, corner, line, outside);
}

fn toggle(ui: &mut egui::Ui, on: bool, letter: &str, name: &str, tip: &str) -> bool {
    let letter = if on {
        RichText::new(letter).strong()
    } else {
        RichText::new(letter).weak()
    };
    let button = ui.add(Button::selectable(on, letter).frame_when_inactive(true));
    button.accessible_name(name).on_hover_text(tip).clicked()
}

/// Switches a lamp off or on.
pub(super) fn mute(document: &mut Document, id: LampId) {
    let muted = document.look().lamp(id).is_some_and(|l| l.muted);
    let label = if muted { "Unmute light" } else { "Mute light" };
    document.edit(label, |s, _| with_lamp(s, id, |l| l.muted = !muted));
}

/// Leaves only a lamp on, or ends that.
pub(super) fn solo(document: &mut Document, id: LampId) {
    let label = if document.look().solo == Some(id) {
        "End solo"
    } else {
        "Solo light"
    };
    document.edit(label, |s, _| s.look_mut().toggle_solo(id));
}

/// Adds a lamp and selects it.
pub(super) fn add(document: &mut Document, editing: &mut Editing) {
    let id = document.edit("Add light", |s, base| {
        let up = base.lighting.up;
        let [right, north] = from_above_axes(up);
        // Half way up in the south-east, beside those that were added there before.
        let turns = s.look().lamps.len() as f32;
        let side = Quat::from_axis_angle(up, 0.7 * turns) * (right - north);
        s.add_lamp(base, (side.normalize_or_zero() + up).normalize_or(up))
    });
    editing.select(Some(id));
}

/// Puts a copy of a lamp beside it, a little to the side, and selects it.
pub(super) fn duplicate(document: &mut Document, editing: &mut Editing, id: LampId) {
    let copy = document.edit("Duplicate light", |s, base| {
        let copy = s.duplicate_lamp(base, id)?;
        let turn = Quat::from_axis_angle(base.lighting.up, 0.2);
        with_lamp(s, copy, |l| {
            l.direction = (turn * l.direction).normalize_or(l.direction);
        });
        Some(copy)
    });
    editing.select(copy);
}

/// Removes a lamp.
pub(super) fn delete(document: &mut Document, editing: &mut Editing, id: LampId) {
    document.edit("Delete light", |s, _| s.look_mut().delete(id));
    editing.select(None);
}

/// Shows the settings of the selected lamp.
pub(super) fn settings(ui: &mut egui::Ui, document: &mut Document, editing: &Editing) {
    let base = document.base().clone();
    let Some(lamp) = editing.selected(document.look()).cloned() else {
        ui.weak("Select a light in the list, on the hemisphere or around the object.");
        return;
    };
    let id = lamp.id;
    fit_sliders(ui);
    egui::Grid::new("lamp settings")
        .num_columns(2)
        .min_col_width(LABELS)
        .spacing([12.0, 8.0])
        .show(ui, |ui| {
            ui.label("Intensity");
            let mut stops = lamp.stops;
            let slider = egui::Slider::new(&mut stops, -SLIDER_STOPS..=SLIDER_STOPS)
                .clamping(egui::SliderClamping::Edits)
                .fixed_decimals(2)
                .suffix(" stops");
            let response = ui
                .add(slider)
                .accessible_name("Intensity")
                .on_hover_text("One stop is twice or half the light; 0 is as estimated");
            undoable(
                document,
                &response,
                &format!("Intensity of {}", lamp.name),
                |s, _| {
                    with_lamp(s, id, |l| l.stops = stops.clamp(-MAX_STOPS, MAX_STOPS));
                },
            );
            ui.end_row();
            colour_ui(ui, document, &base, &lamp);
            softness_ui(ui, document, &base, &lamp);
            direction_ui(ui, document, &base, &lamp);
        });
    let button = ui.add_enabled(can_reset(document, editing), Button::new("Reset light"));
    let tip = "Undo everything done to this light except its name (Shift+R)";
    if button
        .on_hover_text(tip)
        .on_disabled_hover_text(NO_RESET)
        .clicked()
    {
        reset(document, id);
    }
}

/// A lamp as it was estimated, under its present name; none if it was added.
fn as_estimated(document: &Document, lamp: &Lamp) -> Option<Lamp> {
    let Origin::Estimated(index) = lamp.origin else {
        return None;
    };
    Some(Lamp {
        name: lamp.name.clone(),
        ..document.base().estimated(lamp.id, index)
    })
}

/// Whether the selected lamp is one of the estimate and was changed.
pub(super) fn can_reset(document: &Document, editing: &Editing) -> bool {
    let lamp = editing.selected(document.look());
    lamp.is_some_and(|lamp| as_estimated(document, lamp).is_some_and(|own| own != *lamp))
}

/// Puts a lamp back to how it was estimated.
pub(super) fn reset(document: &mut Document, id: LampId) {
    let lamp = document.look().lamp(id);
    let Some(own) = lamp.and_then(|lamp| as_estimated(document, lamp)) else {
        return;
    };
    let label = format!("Reset {}", own.name);
    document.edit(&label, |s, _| with_lamp(s, id, |l| *l = own));
}

fn colour_ui(ui: &mut egui::Ui, document: &mut Document, base: &Baseline, lamp: &Lamp) {
    let id = lamp.id;
    let label = format!("Colour of {}", lamp.name);
    ui.label("Colour");
    ui.horizontal(|ui| {
        let is_kelvin = matches!(lamp.colour, Colour::Kelvin(_));
        let rgb = ui
            .selectable_label(!is_kelvin, "RGB")
            .on_hover_text("Choose a colour; the light keeps its brightness");
        if rgb.clicked() && is_kelvin {
            document.edit(&label, |s, b| {
                with_lamp(s, id, |l| l.colour = b.gain_of_colour(l, b.flux(l)));
            });
        }
        let kelvin = ui
            .selectable_label(is_kelvin, "Temperature")
            .on_hover_text("The colour of a glowing body; the light keeps its brightness");
        if kelvin.clicked() && !is_kelvin {
            document.edit(&label, |s, _| {
                with_lamp(s, id, |l| l.colour = Colour::Kelvin(NOON));
            });
        }
    });
    ui.end_row();
    ui.label("");
    match lamp.colour {
        Colour::Gain(_) => {
            let flux = base.flux(lamp);
            let shown = flux / flux.max_element().max(f32::MIN_POSITIVE);
            let mut rgb = shown.to_array();
            let response = ui
                .color_edit_button_rgb(&mut rgb)
                .accessible_name("Colour")
                .on_hover_text("The hue of the light; the light keeps its brightness");
            let wanted = Vec3::from(rgb);
            // Black has no hue.
            if luminance(wanted) > 1e-4 {
                undoable(document, &response, &label, |s, b| {
                    with_lamp(s, id, |l| l.colour = b.gain_of_colour(l, wanted));
                });
            }
        }
        Colour::Kelvin(mut kelvin) => {
            let hue = super::editing::colour(black_body(kelvin) / black_body(kelvin).max_element());
            let slider = egui::Slider::new(&mut kelvin, KELVIN[0]..=12_000.0)
                .clamping(egui::SliderClamping::Edits)
                .logarithmic(true)
                .fixed_decimals(0)
                .suffix(" K");
            let response = ui
                .scope(|ui| {
                    ui.visuals_mut().selection.bg_fill = hue;
                    ui.add(slider)
                })
                .inner
                .accessible_name("Colour temperature")
                .on_hover_text("Candles 1900 K, bulbs 2700 K, noon 5600 K, blue sky 10,000 K");
            undoable(document, &response, &label, |s, _| {
                let kelvin = kelvin.clamp(KELVIN[0], KELVIN[1]);
                with_lamp(s, id, |l| l.colour = Colour::Kelvin(kelvin));
            });
        }
    }
    ui.end_row();
}

fn softness_ui(ui: &mut egui::Ui, document: &mut Document, base: &Baseline, lamp: &Lamp) {
    let id = lamp.id;
    ui.label("Softness");
    let mut degrees = base.angular_radius(lamp).to_degrees();
    let range = ANGULAR_RADIUS[0].to_degrees()..=ANGULAR_RADIUS[1].to_degrees();
    let slider = egui::Slider::new(&mut degrees, range)
        .clamping(egui::SliderClamping::Edits)
        .logarithmic(true)
        .fixed_decimals(1)
        .suffix("°");
    let response = ui.add(slider).accessible_name("Softness").on_hover_text(
        "Angular radius: a larger light has softer shadows and wider highlights, as bright",
    );
    undoable(
        document,
        &response,
        &format!("Softness of {}", lamp.name),
        |s, _| {
            with_lamp(s, id, |l| l.angular_radius = Some(degrees.to_radians()));
        },
    );
    ui.end_row();
}

fn direction_ui(ui: &mut egui::Ui, document: &mut Document, base: &Baseline, lamp: &Lamp) {
    let id = lamp.id;
    let up = base.lighting.up;
    let [right, north] = from_above_axes(up);
    let (mut height, mut azimuth) = angles(lamp.direction, up, right, north);
    ui.label("Direction");
    let label = format!("Direction of {}", lamp.name);
    ui.horizontal(|ui| {
        let height_field = egui::DragValue::new(&mut height)
            .range(-90.0..=90.0)
            .speed(0.5)
            .fixed_decimals(1)
            .suffix("° up");
        let a = ui
            .add(height_field)
            .accessible_name("Height above the horizon")
            .on_hover_text("Degrees above the horizon; below it where negative");
        let azimuth_field = egui::DragValue::new(&mut azimuth)
            .speed(0.5)
            .fixed_decimals(1)
            .suffix("°");
        let b = ui
            .add(azimuth_field)
            .accessible_name("Azimuth")
            .on_hover_text("Degrees clockwise from north, seen from above");
        let (height, azimuth) = (height.to_radians(), azimuth.to_radians());
        let flat = azimuth.sin() * right + azimuth.cos() * north;
        let direction = (height.cos() * flat + height.sin() * up).normalize_or(up);
        for response in [a, b] {
            undoable(document, &response, &label, |s, _| {
                with_lamp(s, id, |l| l.direction = direction);
            });
        }
    });
    ui.end_row();
}

/// Gives sliders what labels and values leave of a panel's width.
pub(super) fn fit_sliders(ui: &mut egui::Ui) {
    /// Room of the value beside a slider, with the gaps about it.
    const VALUE: f32 = 104.0;
    ui.spacing_mut().slider_width = (ui.available_width() - LABELS - VALUE).max(40.0);
}

/// Height above the horizon and azimuth clockwise from north, degrees.
pub(super) fn angles(direction: Vec3, up: Vec3, right: Vec3, north: Vec3) -> (f32, f32) {
    let height = direction.dot(up).clamp(-1.0, 1.0).asin().to_degrees();
    let azimuth = direction.dot(right).atan2(direction.dot(north));
    (height, azimuth.to_degrees().rem_euclid(360.0))
}
