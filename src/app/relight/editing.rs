//! What is selected, and how widgets become steps that can be undone.

use eframe::egui::{self, Color32};
use glam::Vec3;

use rekindle_relight::luminance;
use rekindle_scene::hemisphere::srgb;
use rekindle_studio::{Baseline, Document, Lamp, LampId, Look, Place, State};

/// What the parts of the page share besides the document.
#[derive(Default)]
pub(super) struct Editing {
    /// The selected lamp.
    selected: Option<LampId>,
    /// The lamp that the pointer is at, anywhere: its marks light up.
    pub(super) hovered: Option<LampId>,
    /// The same, of the frame before: marks are drawn before all of them have been asked.
    pub(super) lit: Option<LampId>,
    /// A lamp whose name is being typed, with the text.
    pub(super) renaming: Option<(LampId, String)>,
    /// A look whose name is being typed, with the text.
    pub(super) renaming_look: Option<(usize, String)>,
    /// The lamp that the list is to scroll to.
    pub(super) scroll_to: Option<LampId>,
    /// Whether the pinned settings are those of the surroundings, not of the selected lamp.
    pub(super) surroundings: bool,
    /// Luminance of all light of the look, with the revision of the document that it is of.
    total: Option<(u64, f32)>,
    /// The look that was shown before the captured light, to compare with.
    pub(super) compared_look: Option<usize>,
    /// What pressing on the object does with the selected lamp.
    pub(super) place: Placing,
}

/// What pressing on the object does with the selected lamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Placing(pub(super) Place);

impl Default for Placing {
    fn default() -> Self {
        Self(Place::Highlight)
    }
}

impl Editing {
    /// The selected lamp, if the look has it.
    pub(super) fn selected<'a>(&self, look: &'a Look) -> Option<&'a Lamp> {
        self.selected.and_then(|id| look.lamp(id))
    }

    /// Selects a lamp, or none.
    pub(super) fn select(&mut self, id: Option<LampId>) {
        self.selected = id;
        self.scroll_to = id;
        if id.is_some() {
            self.surroundings = false;
        }
    }

    /// Luminance of all light of the look that is shown.
    pub(super) fn total_light(&mut self, document: &Document) -> f32 {
        let revision = document.revision();
        match self.total {
            Some((of, total)) if of == revision => total,
            _ => {
                let total = luminance(document.light().lighting.flux());
                self.total = Some((revision, total));
                total
            }
        }
    }

    /// Whether a lamp is the selected one.
    pub(super) fn is_selected(&self, id: LampId) -> bool {
        self.selected == Some(id)
    }

    /// Begins a frame.
    pub(super) fn begin_frame(&mut self) {
        self.lit = self.hovered.take();
    }
}

/// Makes what a widget did part of a step, which [`settle`] ends.
pub(super) fn undoable(
    document: &mut Document,
    response: &egui::Response,
    label: &str,
    change: impl FnOnce(&mut State, &Baseline),
) {
    if response.changed() {
        document.begin(label);
        document.update(change);
    }
}

/// Ends a step when mouse and keyboard have let go of it: a drag is one step, so is what is typed into a field, and so is
/// what is tried in a colour's popup.
pub(super) fn settle(ctx: &egui::Context, document: &mut Document) {
    let held = ctx.input(|i| i.pointer.any_down()) || ctx.text_edit_focused();
    if document.is_dragging() && !held && !egui::Popup::is_any_open(ctx) {
        document.commit();
    }
}

/// Changes a lamp of the look that is shown, if it is there.
pub(super) fn with_lamp(state: &mut State, id: LampId, change: impl FnOnce(&mut Lamp)) {
    if let Some(lamp) = state.look_mut().lamp_mut(id) {
        change(lamp);
    }
}

/// The hue of a lamp's light, as bright as the screen shows it.
pub(super) fn hue(base: &Baseline, lamp: &Lamp) -> Color32 {
    let flux = base.flux(lamp);
    colour(flux / flux.max_element().max(f32::MIN_POSITIVE))
}

/// A linear colour up to 1 as the screen shows it.
pub(super) fn colour(linear: Vec3) -> Color32 {
    let [r, g, b] = linear
        .to_array()
        .map(|v| (255.0 * srgb(v.clamp(0.0, 1.0))).round() as u8);
    Color32::from_rgb(r, g, b)
}
