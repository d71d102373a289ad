//! What is done with lamps, by buttons, menus and keys.

use eframe::egui::{self, Button};
use glam::Quat;

use super::editing::{Editing, with_lamp, with_lamps};
use rekindle_scene::hemisphere::from_above_axes;
use rekindle_studio::{Document, GroupId, Lamp, LampId, Look, Origin};

/// Why a light can't be reset.
pub(super) const NO_RESET: &str =
    "Only a light of the estimate that was changed has something to go back to.";

/// Buttons for the list's lamps.
pub(super) fn buttons(ui: &mut egui::Ui, document: &mut Document, editing: &mut Editing) {
    ui.horizontal(|ui| {
        let tip = "Add a white disc of light from above the camera's side (A)";
        if ui.button("Add light").on_hover_text(tip).clicked() {
            add(document, editing);
        }
        let selected = editing.selection(document.look());
        for (name, tip) in [
            (
                "Duplicate",
                "Put a copy of each selected light beside it (Shift+D)",
            ),
            (
                "Delete",
                "Remove the selected lights (Delete); undo brings them back",
            ),
        ] {
            let button = ui.add_enabled(!selected.is_empty(), Button::new(name));
            let clicked = button
                .on_hover_text(tip)
                .on_disabled_hover_text("Select a light first")
                .clicked();
            if clicked && name == "Delete" {
                delete(document, editing, &selected);
            } else if clicked {
                duplicate(document, editing, &selected);
            }
        }
    });
}

/// What a step that is done to lamps is called: "Mute light", "Mute 3 lights".
fn label(verb: &str, count: usize) -> String {
    match count {
        1 => format!("{verb} light"),
        several => format!("{verb} {several} lights"),
    }
}

/// Switches lamps off, or on if all of them are off.
pub(super) fn mute(document: &mut Document, lamps: &[LampId]) {
    let look = document.look();
    let muted = lamps
        .iter()
        .all(|id| look.lamp(*id).is_some_and(|l| l.muted));
    let verb = if muted { "Unmute" } else { "Mute" };
    document.edit(&label(verb, lamps.len()), |s, _| {
        with_lamps(s, lamps, |l| l.muted = !muted);
    });
}

/// Whether these lamps, and no others, are on by a solo.
pub(super) fn is_solo(look: &Look, lamps: &[LampId]) -> bool {
    !lamps.is_empty()
        && look.solo.len() == lamps.len()
        && lamps.iter().all(|id| look.solo.contains(id))
}

/// Leaves only these lamps on, or ends that.
pub(super) fn solo(document: &mut Document, lamps: &[LampId]) {
    let text = if is_solo(document.look(), lamps) {
        "End solo".to_owned()
    } else {
        label("Solo", lamps.len())
    };
    document.edit(&text, |s, _| s.look_mut().toggle_solo(lamps));
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

/// Puts a copy of each lamp beside it, a little to the side, and selects the copies.
pub(super) fn duplicate(document: &mut Document, editing: &mut Editing, lamps: &[LampId]) {
    let copies = document.edit(&label("Duplicate", lamps.len()), |s, base| {
        let turn = Quat::from_axis_angle(base.lighting.up, 0.2);
        let copies = lamps.iter().filter_map(|id| {
            let copy = s.duplicate_lamp(base, *id)?;
            with_lamp(s, copy, |l| {
                l.direction = (turn * l.direction).normalize_or(l.direction);
            });
            Some(copy)
        });
        copies.collect()
    });
    editing.select_all(copies);
}

/// Removes lamps.
pub(super) fn delete(document: &mut Document, editing: &mut Editing, lamps: &[LampId]) {
    document.edit(&label("Delete", lamps.len()), |s, _| {
        for id in lamps {
            s.look_mut().delete(*id);
        }
    });
    editing.select(None);
}

/// Makes a group of the selected lamps and selects it.
pub(super) fn group(document: &mut Document, editing: &mut Editing) {
    let lamps = editing.selection(document.look());
    let made = document.edit("Group lights", |s, _| s.group_lamps(&lamps));
    if let Some(id) = made {
        editing.select_group(document.look(), id);
    }
}

/// Ends groups; their lamps shine on as they do.
pub(super) fn ungroup(document: &mut Document, groups: &[GroupId]) {
    document.edit("Ungroup lights", |s, _| {
        for id in groups {
            s.look_mut().ungroup(*id);
        }
    });
}

/// Switches a group off or on.
pub(super) fn mute_group(document: &mut Document, id: GroupId) {
    let muted = document.look().group(id).is_some_and(|g| g.muted);
    let text = if muted { "Unmute group" } else { "Mute group" };
    document.edit(text, |s, _| {
        if let Some(group) = s.look_mut().group_mut(id) {
            group.muted = !muted;
        }
    });
}

/// Hides the lamps of a group from the list or shows them. It changes no light, so it is no step of the history.
pub(super) fn fold(document: &mut Document, id: GroupId) {
    document.commit();
    document.update(|s, _| {
        if let Some(group) = s.look_mut().group_mut(id) {
            group.folded = !group.folded;
        }
    });
}

/// A lamp as it was estimated, under its present name and in its group; none if it was added.
fn as_estimated(document: &Document, lamp: &Lamp) -> Option<Lamp> {
    let Origin::Estimated(index) = lamp.origin else {
        return None;
    };
    Some(Lamp {
        name: lamp.name.clone(),
        group: lamp.group,
        ..document.base().estimated(lamp.id, index)
    })
}

/// Those of these lamps that are of the estimate and were changed, as they were estimated.
fn changed(document: &Document, lamps: &[LampId]) -> Vec<Lamp> {
    let look = document.look();
    let lamps = lamps.iter().filter_map(|id| look.lamp(*id));
    let own = lamps.filter_map(|lamp| as_estimated(document, lamp).filter(|own| own != lamp));
    own.collect()
}

/// Whether a selected lamp is one of the estimate and was changed.
pub(super) fn can_reset(document: &Document, editing: &Editing) -> bool {
    !changed(document, &editing.selection(document.look())).is_empty()
}

/// Puts lamps back to how they were estimated.
pub(super) fn reset(document: &mut Document, lamps: &[LampId]) {
    let changed = changed(document, lamps);
    let text = match changed.as_slice() {
        [] => return,
        [one] => format!("Reset {}", one.name),
        several => label("Reset", several.len()),
    };
    document.edit(&text, |s, _| {
        for own in changed {
            with_lamp(s, own.id, |l| *l = own);
        }
    });
}
