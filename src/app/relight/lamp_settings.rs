//! The settings of what is selected: one light, several, or a group.

use eframe::egui::{self, Button};
use glam::Vec3;

use super::editing::{Editing, move_to, undoable, with_lamps};
use super::lamps::{self, NO_RESET};
use rekindle_relight::luminance;
use rekindle_scene::hemisphere::from_above_axes;
use rekindle_studio::{
    ANGULAR_RADIUS, Baseline, Colour, Document, Group, KELVIN, Lamp, LampId, MAX_STOPS, black_body,
};

/// Intensities that the slider reaches; more can be typed.
const SLIDER_STOPS: f32 = 6.0;
/// Where a colour temperature begins: noon.
const NOON: f32 = 5600.0;

/// Width of the labels before settings, points.
pub(super) const LABELS: f32 = 72.0;

/// What settings are of.
struct Chosen {
    /// What steps call it.
    name: String,
    /// The lamp whose values are shown.
    lamp: Lamp,
    /// The lamps that are changed.
    lamps: Vec<LampId>,
    /// The group whose intensity is changed in place of the lamps'.
    group: Option<Group>,
}

impl Chosen {
    fn new(document: &Document, editing: &Editing) -> Option<Self> {
        let look = document.look();
        Some(Self {
            name: editing.called(look)?,
            lamp: editing.selected(look)?.clone(),
            lamps: editing.selection(look),
            group: editing.group(look).cloned(),
        })
    }
}

/// Shows the settings of the selected lamps.
pub(super) fn show(ui: &mut egui::Ui, document: &mut Document, editing: &mut Editing) {
    let base = document.base().clone();
    let Some(chosen) = Chosen::new(document, editing) else {
        ui.weak("Select a light in the list, on the hemisphere or around the object.");
        return;
    };
    fit_sliders(ui);
    egui::Grid::new("lamp settings")
        .num_columns(2)
        .min_col_width(LABELS)
        .spacing([12.0, 8.0])
        .show(ui, |ui| {
            intensity_ui(ui, document, &chosen);
            colour_ui(ui, document, &base, &chosen);
            softness_ui(ui, document, &base, &chosen);
            direction_ui(ui, document, &base, editing, &chosen);
        });
    ui.horizontal(|ui| buttons(ui, document, editing, &chosen));
}

fn buttons(ui: &mut egui::Ui, document: &mut Document, editing: &mut Editing, chosen: &Chosen) {
    let several = chosen.lamps.len() > 1;
    let name = if several {
        "Reset lights"
    } else {
        "Reset light"
    };
    let button = ui.add_enabled(lamps::can_reset(document, editing), Button::new(name));
    let tip = "Undo everything done to what is selected except its name (Shift+R)";
    if button
        .on_hover_text(tip)
        .on_disabled_hover_text(NO_RESET)
        .clicked()
    {
        lamps::reset(document, &chosen.lamps);
    }
    if let Some(group) = &chosen.group {
        let tip = "End the group; its lights shine on as they do (Ctrl+Shift+G)";
        if ui.button("Ungroup").on_hover_text(tip).clicked() {
            lamps::ungroup(document, &[group.id]);
        }
    } else if several {
        let tip = "Set the selected lights together from now on: one name, intensity, mute and solo (Ctrl+G)";
        if ui.button("Group").on_hover_text(tip).clicked() {
            lamps::group(document, editing);
        }
    }
}

fn intensity_ui(ui: &mut egui::Ui, document: &mut Document, chosen: &Chosen) {
    ui.label("Intensity");
    let own = chosen.group.as_ref().map_or(chosen.lamp.stops, |g| g.stops);
    let mut stops = own;
    let slider = egui::Slider::new(&mut stops, -SLIDER_STOPS..=SLIDER_STOPS)
        .clamping(egui::SliderClamping::Edits)
        .fixed_decimals(2)
        .suffix(" stops");
    let tip = match (&chosen.group, chosen.lamps.len()) {
        (Some(_), _) => "Of the whole group, beside that of each light; one stop is twice or half",
        (None, 1) => "One stop is twice or half the light; 0 is as estimated",
        _ => "The other selected lights change by as many stops",
    };
    let slider = ui.add(slider).accessible_name("Intensity");
    let label = format!("Intensity of {}", chosen.name);
    let group = chosen.group.as_ref().map(|g| g.id);
    undoable(document, &slider.on_hover_text(tip), &label, |s, _| {
        if let Some(group) = group.and_then(|id| s.look_mut().group_mut(id)) {
            group.stops = stops.clamp(-MAX_STOPS, MAX_STOPS);
            return;
        }
        with_lamps(s, &chosen.lamps, |l| {
            let wanted = if l.id == chosen.lamp.id {
                stops
            } else {
                l.stops + stops - own
            };
            l.stops = wanted.clamp(-MAX_STOPS, MAX_STOPS);
        });
    });
    ui.end_row();
}

fn colour_ui(ui: &mut egui::Ui, document: &mut Document, base: &Baseline, chosen: &Chosen) {
    let (lamp, all) = (&chosen.lamp, &chosen.lamps);
    let label = format!("Colour of {}", chosen.name);
    ui.label("Colour");
    ui.horizontal(|ui| {
        let is_kelvin = matches!(lamp.colour, Colour::Kelvin(_));
        let rgb = ui
            .selectable_label(!is_kelvin, "RGB")
            .on_hover_text("Choose a colour; the light keeps its brightness");
        if rgb.clicked() && is_kelvin {
            document.edit(&label, |s, b| {
                with_lamps(s, all, |l| l.colour = b.gain_of_colour(l, b.flux(l)));
            });
        }
        let kelvin = ui
            .selectable_label(is_kelvin, "Temperature")
            .on_hover_text("The colour of a glowing body; the light keeps its brightness");
        if kelvin.clicked() && !is_kelvin {
            document.edit(&label, |s, _| {
                with_lamps(s, all, |l| l.colour = Colour::Kelvin(NOON));
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
                    with_lamps(s, all, |l| l.colour = b.gain_of_colour(l, wanted));
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
                with_lamps(s, all, |l| l.colour = Colour::Kelvin(kelvin));
            });
        }
    }
    ui.end_row();
}

fn softness_ui(ui: &mut egui::Ui, document: &mut Document, base: &Baseline, chosen: &Chosen) {
    ui.label("Softness");
    let mut degrees = base.angular_radius(&chosen.lamp).to_degrees();
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
        &format!("Softness of {}", chosen.name),
        |s, _| {
            with_lamps(s, &chosen.lamps, |l| {
                l.angular_radius = Some(degrees.to_radians());
            });
        },
    );
    ui.end_row();
}

fn direction_ui(
    ui: &mut egui::Ui,
    document: &mut Document,
    base: &Baseline,
    editing: &Editing,
    chosen: &Chosen,
) {
    let lamp = &chosen.lamp;
    let up = base.lighting.up;
    let [right, north] = from_above_axes(up);
    let (mut height, mut azimuth) = angles(lamp.direction, up, right, north);
    ui.label("Direction");
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
        if a.changed() || b.changed() {
            move_to(document, editing, lamp, direction);
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
