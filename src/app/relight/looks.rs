//! The strip of setups: whole ways to light the object, to switch between. The first is the captured light, which stays as it
//! is.

use eframe::egui;
use glam::Vec3;

use super::editing::Editing;
use crate::app::theme;
use rekindle_studio::{Document, ReadySetup, State};

/// Shows the strip. `towards` is the direction from the object to the viewer.
pub(super) fn show(
    ui: &mut egui::Ui,
    document: &mut Document,
    editing: &mut Editing,
    towards: Vec3,
) {
    ui.horizontal(|ui| {
        theme::group(ui, "Setups");
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let active = document.state().active;
            ui.menu_button("Edit setup", |ui| menu(ui, document, editing, active))
                .response
                .on_hover_text("Duplicate, rename or delete");
            ui.menu_button("Add setup", |ui| add_menu(ui, document, towards))
                .response
                .on_hover_text("Begin with the captured light, or with a usual way to light");
        });
    });
    ui.horizontal_wrapped(|ui| {
        let names: Vec<String> = document
            .state()
            .looks
            .iter()
            .map(|l| l.name.clone())
            .collect();
        for (index, name) in names.iter().enumerate() {
            if let Some((at, mut text)) = editing.renaming_look.take_if(|(at, _)| *at == index) {
                let field = egui::TextEdit::singleline(&mut text).desired_width(140.0);
                let field = ui.add(field).accessible_name("Name of the setup");
                field.request_focus();
                let (enter, escape) = ui.input(|i| {
                    (
                        i.key_pressed(egui::Key::Enter),
                        i.key_pressed(egui::Key::Escape),
                    )
                });
                if enter || field.clicked_elsewhere() {
                    let new = text.trim().to_owned();
                    if !new.is_empty() {
                        document.edit("Rename setup", |s, _| {
                            if let Some(look) = s.looks.get_mut(at) {
                                look.name = new;
                            }
                        });
                    }
                } else if !escape {
                    editing.renaming_look = Some((at, text));
                }
                continue;
            }
            let captured = document.state().captured() == Some(index);
            let tip = if captured {
                "The light as it was captured. It stays so: the first change begins a setup of its own. C compares"
            } else {
                "Show this setup; L shows the next one, C the captured light, double-click renames"
            };
            let response = ui
                .selectable_label(index == document.state().active, name)
                .on_hover_text(tip);
            if response.double_clicked() && !captured {
                editing.renaming_look = Some((index, name.clone()));
            } else if response.clicked() {
                document.edit("Switch setup", |s, _| s.active = index);
            }
            response.context_menu(|ui| menu(ui, document, editing, index));
        }
    });
}

/// Setups to begin with: the captured light and usual ones, as seen from `towards`.
fn add_menu(ui: &mut egui::Ui, document: &mut Document, towards: Vec3) {
    let tip = "A setup that begins with the captured light";
    if ui
        .button("From the captured light")
        .on_hover_text(tip)
        .clicked()
    {
        document.edit("Add setup", State::add_look);
        ui.close();
    }
    ui.separator();
    for ready in ReadySetup::ALL {
        let (name, tip) = ready.words();
        let tip = format!("{tip}; from where you look now, as bright as the captured light");
        if ui.button(name).on_hover_text(tip).clicked() {
            document.edit("Add setup", |s, base| s.add_ready(base, ready, towards));
            ui.close();
        }
    }
}

fn menu(ui: &mut egui::Ui, document: &mut Document, editing: &mut Editing, index: usize) {
    let Some(look) = document.state().looks.get(index) else {
        return;
    };
    let (name, captured) = (look.name.clone(), look.captured);
    let tip = "A copy of this setup, to try something else";
    if ui.button("Duplicate setup").on_hover_text(tip).clicked() {
        document.edit("Duplicate setup", |s, _| s.duplicate_look(index));
        ui.close();
    }
    let kept = "The captured light stays as it is";
    let tip = "Give this setup another name";
    let rename = ui.add_enabled(!captured, egui::Button::new("Rename setup"));
    if rename
        .on_hover_text(tip)
        .on_disabled_hover_text(kept)
        .clicked()
    {
        editing.renaming_look = Some((index, name));
        ui.close();
    }
    let delete = ui.add_enabled(!captured, egui::Button::new("Delete setup"));
    let tip = "Remove this setup; undo brings it back";
    if delete
        .on_hover_text(tip)
        .on_disabled_hover_text(kept)
        .clicked()
    {
        document.edit("Delete setup", |s, _| s.delete_look(index));
        ui.close();
    }
}

/// Shows the look after the one that is shown.
pub(super) fn next(document: &mut Document) {
    document.edit("Switch setup", |s, _| {
        s.active = (s.active + 1) % s.looks.len().max(1);
    });
}

/// Whether there is a setup to compare the captured light with.
pub(super) fn is_comparable(document: &Document) -> bool {
    document.state().looks.len() > 1 && document.state().captured().is_some()
}

/// Shows the captured light in place of a setup, or the setup that was shown before.
pub(super) fn compare(document: &mut Document, editing: &mut Editing) {
    let state = document.state();
    let Some(captured) = state.captured() else {
        return;
    };
    if state.active != captured {
        editing.compared_look = Some(state.active);
        document.show(captured);
        return;
    }
    let there = |index: &usize| *index < state.looks.len() && *index != captured;
    let last = (0..state.looks.len()).rev().find(there);
    if let Some(other) = editing.compared_look.filter(there).or(last) {
        document.show(other);
    }
}
