//! What is selected, and how widgets become steps that can be undone.

use eframe::egui::{self, Color32};
use glam::{Quat, Vec3};

use super::list;
use rekindle_relight::luminance;
use rekindle_scene::hemisphere::srgb;
use rekindle_studio::{Baseline, Document, Group, GroupId, Lamp, LampId, Look, Place, State};

/// What has a line in the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Item {
    Lamp(LampId),
    Group(GroupId),
}

/// What the parts of the page share besides the document.
#[derive(Default)]
pub(super) struct Editing {
    /// The selected lamps, the one whose settings are shown at the end.
    selection: Vec<LampId>,
    /// The lamp that a selection with Shift reaches from.
    anchor: Option<LampId>,
    /// The group whose lamps are selected, if they were selected by it.
    group: Option<GroupId>,
    /// The lamp that the pointer is at, anywhere: its marks light up.
    pub(super) hovered: Option<LampId>,
    /// The same, of the frame before: marks are drawn before all of them have been asked.
    pub(super) lit: Option<LampId>,
    /// What has its name typed, with the text.
    pub(super) renaming: Option<(Item, String)>,
    /// A look whose name is being typed, with the text.
    pub(super) renaming_look: Option<(usize, String)>,
    /// Where a rectangle on the hemisphere began, while it is drawn.
    pub(super) band: Option<egui::Pos2>,
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
    /// The selected lamp, of several the one whose settings are shown, if the look has it.
    pub(super) fn selected<'a>(&self, look: &'a Look) -> Option<&'a Lamp> {
        self.selection.iter().rev().find_map(|id| look.lamp(*id))
    }

    /// All selected lamps that the look has.
    pub(super) fn selection(&self, look: &Look) -> Vec<LampId> {
        let all = self.selection.iter().copied();
        all.filter(|id| look.lamp(*id).is_some()).collect()
    }

    /// The selected group, if the look has it.
    pub(super) fn group<'a>(&self, look: &'a Look) -> Option<&'a Group> {
        self.group.and_then(|id| look.group(id))
    }

    /// What steps call the selection; none if nothing is selected.
    pub(super) fn called(&self, look: &Look) -> Option<String> {
        if let Some(group) = self.group(look) {
            return Some(group.name.clone());
        }
        match self.selection(look).len() {
            0 => None,
            1 => self.selected(look).map(|lamp| lamp.name.clone()),
            several => Some(format!("{several} lights")),
        }
    }

    /// Selects a lamp, or none.
    pub(super) fn select(&mut self, id: Option<LampId>) {
        self.select_all(id.into_iter().collect());
    }

    /// Selects lamps, the last of which has its settings shown.
    pub(super) fn select_all(&mut self, lamps: Vec<LampId>) {
        self.group = None;
        self.selection = lamps;
        self.anchor = self.selection.last().copied();
        self.scroll_to = self.anchor;
        if self.anchor.is_some() {
            self.surroundings = false;
        }
    }

    /// Selects the lamps of a group.
    pub(super) fn select_group(&mut self, look: &Look, id: GroupId) {
        self.select_all(look.members(id));
        self.group = Some(id);
        self.scroll_to = None;
    }

    /// Adds a lamp to the selection, or takes it out.
    pub(super) fn toggle(&mut self, id: LampId) {
        let mut lamps = std::mem::take(&mut self.selection);
        if lamps.contains(&id) {
            lamps.retain(|other| *other != id);
        } else {
            lamps.push(id);
        }
        self.select_all(lamps);
    }

    /// A lamp of the list was clicked: with Ctrl it is added or taken out, with Shift all from the last one on are selected.
    pub(super) fn press(&mut self, id: LampId, modifiers: egui::Modifiers, order: &[LampId]) {
        let at = |lamp: LampId| order.iter().position(|other| *other == lamp);
        let from = self.anchor.and_then(at);
        match (from, at(id)) {
            (Some(from), Some(to)) if modifiers.shift => {
                let anchor = self.anchor;
                let mut lamps = order[from.min(to)..=from.max(to)].to_vec();
                if from > to {
                    lamps.reverse();
                }
                self.select_all(lamps);
                self.anchor = anchor;
            }
            _ if modifiers.command => self.toggle(id),
            _ => self.select(Some(id)),
        }
    }

    /// Selects the lamp below the selected one in the list, or the first; it is added to the selection if asked for.
    pub(super) fn select_next(&mut self, document: &Document, also: bool) {
        let order = list::order(&list::lines(document));
        let selected = self.selected(document.look()).map(|l| l.id);
        let at = order.iter().position(|id| Some(*id) == selected);
        let next = order.get(at.map_or(0, |at| at + 1)).or(order.first());
        let mut lamps = if also {
            self.selection(document.look())
        } else {
            Vec::new()
        };
        lamps.retain(|id| Some(id) != next);
        lamps.extend(next);
        self.select_all(lamps);
    }

    /// The lamps that something is done to with one: all selected ones, if it is among them.
    pub(super) fn with_selected(&self, look: &Look, id: LampId) -> Vec<LampId> {
        if self.is_selected(id) {
            self.selection(look)
        } else {
            vec![id]
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

    /// Whether a lamp is selected.
    pub(super) fn is_selected(&self, id: LampId) -> bool {
        self.selection.contains(&id)
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

/// Changes lamps of the look that is shown.
pub(super) fn with_lamps(state: &mut State, lamps: &[LampId], change: impl Fn(&mut Lamp)) {
    for id in lamps {
        with_lamp(state, *id, &change);
    }
}

/// Moves a lamp within a drag. If it is selected, all selected ones turn with it, as if they were fixed to each other.
pub(super) fn move_to(document: &mut Document, editing: &Editing, lamp: &Lamp, direction: Vec3) {
    let lamps = editing.with_selected(document.look(), lamp.id);
    let label = match lamps.len() {
        1 => format!("Move {}", lamp.name),
        several => format!("Move {several} lights"),
    };
    document.begin(&label);
    let Some(before) = document.before_drag().map(State::look) else {
        return;
    };
    let at = |id: LampId| before.lamp(id).map(|l| l.direction);
    let from = at(lamp.id).unwrap_or(lamp.direction);
    // From where the drag began: there and back again is no change.
    let turn = Quat::from_rotation_arc(from, direction);
    let turned = |id: LampId| Some((id, (turn * at(id)?).normalize_or(direction)));
    let others = lamps.into_iter().filter(|id| *id != lamp.id);
    let moved: Vec<_> = others.filter_map(turned).collect();
    document.update(|s, _| {
        with_lamp(s, lamp.id, |l| l.direction = direction);
        for (id, direction) in moved {
            with_lamp(s, id, |l| l.direction = direction);
        }
    });
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
