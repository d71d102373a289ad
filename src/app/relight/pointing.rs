//! Lighting by pointing at the object: press to place a lamp, hover to ask which lamp makes a highlight.

use super::editing::{Editing, with_lamp};
use crate::app::viewport::Viewport;
use eframe::egui::{self, Pos2};
use rekindle_relight::luminance;
use rekindle_studio::{Document, LampId, Place, highlight_shares, place};

/// A highlight is one from this part of the radiance that is shown as white.
const VISIBLE: f32 = 0.04;

/// What the pointer does over the object.
#[derive(Default)]
pub(super) struct Pointing {
    /// The press that is under way began on the object, with a lamp selected.
    placing: bool,
    /// What was asked last: where, of which light, and the answer.
    asked: Option<(Pos2, u64, Option<Answer>)>,
}

/// Whose highlight is at the pointer.
#[derive(Clone, Debug)]
struct Answer {
    lamp: LampId,
    share: f32,
}

impl Pointing {
    /// Whether the left button belongs to the lamp and not to the view.
    pub(super) fn is_placing(&self) -> bool {
        self.placing
    }

    /// Looks at the pointer over the viewport, whose response is given. `over` says that a handle has the pointer.
    pub(super) fn show(
        &mut self,
        ui: &egui::Ui,
        response: &egui::Response,
        viewport: &Viewport,
        document: &mut Document,
        editing: &mut Editing,
        over: bool,
    ) {
        let (pressed, down, released) = ui.input(|i| {
            let pointer = &i.pointer;
            (
                pointer.primary_pressed(),
                pointer.primary_down(),
                pointer.primary_released(),
            )
        });
        // Where the button is let go counts too: on a slow machine the last move comes with it.
        if !down && !released {
            self.placing = false;
        }
        let Some(pointer) = ui
            .input(|i| i.pointer.interact_pos())
            .filter(|p| response.rect.contains(*p))
        else {
            return;
        };
        let let_go = released && response.contains_pointer();
        let held = (response.is_pointer_button_down_on() || let_go) && !over;
        let selected = editing.selected(document.look()).map(|l| l.id);
        if pressed && held && selected.is_some() && ui.input(|i| i.modifiers.is_none()) {
            self.placing = viewport.surface_at(pointer).is_some();
        }
        if self.placing && held {
            if let Some(id) = selected {
                put(document, editing.place.0, id, viewport, pointer);
            }
        } else if response.hovered() && !over && !down {
            self.ask(response, viewport, document, editing, pointer);
        }
    }

    /// Says whose highlight is at the pointer, and selects that lamp on a click.
    fn ask(
        &mut self,
        response: &egui::Response,
        viewport: &Viewport,
        document: &Document,
        editing: &mut Editing,
        at: Pos2,
    ) {
        let revision = document.revision();
        let known = self.asked.as_ref();
        if known.is_none_or(|(place, of, _)| *place != at || *of != revision) {
            let answer = answer(document, viewport, at);
            self.asked = Some((at, revision, answer));
        }
        let Some((_, _, Some(answer))) = &self.asked else {
            return;
        };
        let Some(lamp) = document.look().lamp(answer.lamp) else {
            return;
        };
        editing.hovered = Some(answer.lamp);
        let share = if answer.share > 0.97 {
            String::new()
        } else {
            format!(" makes {:.0} % of it", 100.0 * answer.share)
        };
        // With a lamp selected a click places that one.
        let free = editing.selected(document.look()).is_none();
        let hint = if free { "\nClick to select it" } else { "" };
        egui::Popup::from_response(response)
            .kind(egui::PopupKind::Tooltip)
            .at_pointer()
            .gap(14.0)
            .show(|ui| ui.label(format!("Highlight of {}{share}{hint}", lamp.name)));
        if free && response.clicked() {
            editing.select(Some(answer.lamp));
        }
    }
}

/// Puts a lamp where it does what is asked at the pointer.
fn put(document: &mut Document, what: Place, id: LampId, viewport: &Viewport, at: Pos2) {
    let Some((point, view)) = viewport.surface_at(at) else {
        return;
    };
    let (centre, radius) = {
        let lighting = &document.base().lighting;
        (lighting.centre, lighting.radius)
    };
    let found = place(what, point.position, point.normal, view, centre, radius);
    if let Some(direction) = found {
        let label = match what {
            Place::Highlight => "Place highlight",
            Place::Brightest => "Place brightest shading",
            Place::Rim => "Place rim light",
        };
        document.begin(label);
        document.update(|s, _| with_lamp(s, id, |l| l.direction = direction));
    }
}

/// Whose highlight is at a place on the window.
fn answer(document: &Document, viewport: &Viewport, at: Pos2) -> Option<Answer> {
    let (point, view) = viewport.surface_at(at)?;
    let solution = document.solution();
    let lit = document.light();
    let occluder = viewport.occluder()?;
    let shares = highlight_shares(occluder, solution.brdf, &lit.lighting, &point, view);
    let first = shares.first()?;
    (luminance(first.specular) > VISIBLE * viewport.white()).then(|| Answer {
        lamp: lit.lamps[first.lamp],
        share: first.share,
    })
}

/// Width from which the bar has room for a sentence beside its buttons, points.
const WIDE: f32 = 640.0;

/// Buttons for what pressing on the object does, over the foot of the viewport.
pub(super) fn bar(ui: &mut egui::Ui, document: &Document, editing: &mut Editing) {
    let Some(lamp) = editing.selected(document.look()) else {
        let text = "Hover a highlight to see which light makes it. Select a light to place it by pressing on the object.";
        let weak = egui::RichText::new(text).weak();
        ui.add(egui::Label::new(weak).truncate());
        return;
    };
    // A long name must leave room for the buttons.
    let wide = ui.available_width() >= WIDE;
    let most = if wide { 24 } else { 7 };
    let mut name: String = lamp.name.chars().take(most).collect();
    if name.len() < lamp.name.len() {
        name.push('…');
    }
    let sentence = format!("Press on the object to place {name}");
    let text = if wide { &sentence } else { &name };
    ui.label(text).on_hover_text(&sentence);
    for (what, name, tip) in [
        (
            Place::Highlight,
            "Highlight",
            "Its highlight goes where you press (H)",
        ),
        (
            Place::Brightest,
            "Brightest shading",
            "It faces the surface where you press (B)",
        ),
        (
            Place::Rim,
            "Rim",
            "It comes from behind and grazes where you press (G)",
        ),
    ] {
        let chosen = editing.place.0 == what;
        if ui
            .selectable_label(chosen, name)
            .on_hover_text(tip)
            .clicked()
        {
            editing.place.0 = what;
        }
    }
    if ui
        .button("Done")
        .on_hover_text("Select no light (Escape)")
        .clicked()
    {
        editing.select(None);
    }
}
