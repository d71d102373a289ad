//! The strip of looks: whole lighting set-ups to switch between.

use eframe::egui;

use super::editing::Editing;
use crate::app::theme;
use rekindle_studio::{Document, State};

/// Shows the strip.
pub(super) fn show(ui: &mut egui::Ui, document: &mut Document, editing: &mut Editing) {
    ui.horizontal(|ui| {
        theme::group(ui, "Looks");
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let active = document.state().active;
            ui.menu_button("Edit look", |ui| menu(ui, document, editing, active))
                .response
                .on_hover_text("New, duplicate, rename or delete");
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
                let field = ui.add(field).accessible_name("Name of the look");
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
                        document.edit("Rename look", |s, _| {
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
            let response = ui
                .selectable_label(index == document.state().active, name)
                .on_hover_text("Show this look; L shows the next one, double-click renames");
            if response.double_clicked() {
                editing.renaming_look = Some((index, name.clone()));
            } else if response.clicked() {
                document.edit("Switch look", |s, _| s.active = index);
            }
            response.context_menu(|ui| menu(ui, document, editing, index));
        }
    });
}

fn menu(ui: &mut egui::Ui, document: &mut Document, editing: &mut Editing, index: usize) {
    let name = document.state().looks.get(index).map(|l| l.name.clone());
    let tip = "A look with the captured lighting";
    if ui.button("New look").on_hover_text(tip).clicked() {
        document.edit("New look", State::add_look);
        ui.close();
    }
    let tip = "A copy of this look, to try something else";
    if ui.button("Duplicate look").on_hover_text(tip).clicked() {
        document.edit("Duplicate look", |s, _| s.duplicate_look(index));
        ui.close();
    }
    let tip = "Give this look another name";
    if ui.button("Rename look").on_hover_text(tip).clicked() {
        editing.renaming_look = name.map(|name| (index, name));
        ui.close();
    }
    let several = document.state().looks.len() > 1;
    let delete = ui.add_enabled(several, egui::Button::new("Delete look"));
    let tip = "Remove this look; undo brings it back. The last one stays";
    if delete
        .on_hover_text(tip)
        .on_disabled_hover_text(tip)
        .clicked()
    {
        document.edit("Delete look", |s, _| s.delete_look(index));
        ui.close();
    }
}

/// Shows the look after the one that is shown.
pub(super) fn next(document: &mut Document) {
    document.edit("Switch look", |s, _| {
        s.active = (s.active + 1) % s.looks.len().max(1);
    });
}
