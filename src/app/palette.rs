//! The command palette and the key sheet.

use eframe::egui::{self, Align2, Id, Key, RichText, ScrollArea, vec2};

use super::commands::{Action, ENTRIES, Entry, Menu};
use super::theme;

/// The command palette while it is open.
#[derive(Default)]
pub struct CommandPalette {
    query: String,
    selected: usize,
    fresh: bool,
}

/// A command, and why it can't be given now, if it can't.
type Found = (&'static Entry, Option<&'static str>);

/// What came of a frame of the palette.
pub enum Chosen {
    /// It stays open.
    Nothing,
    /// It is to be closed.
    Closed,
    /// A command was chosen, and it is to be closed.
    Action(Action),
}

impl CommandPalette {
    /// An empty one.
    pub fn new() -> Self {
        Self {
            fresh: true,
            ..Self::default()
        }
    }

    /// Shows it; `obstacle` says why a command can't be given now. Those that can come first.
    pub fn show(
        &mut self,
        ctx: &egui::Context,
        obstacle: impl Fn(Action) -> Option<&'static str>,
    ) -> Chosen {
        let found = ENTRIES.iter().filter(|e| e.action != Action::Palette);
        let found = found.filter(|e| matches(e, &self.query));
        let mut found: Vec<Found> = found.map(|e| (e, obstacle(e.action))).collect();
        found.sort_by_key(|(_, why_not)| why_not.is_some());
        let moved = ctx.input_mut(|i| {
            i64::from(i.consume_key(egui::Modifiers::NONE, Key::ArrowDown))
                - i64::from(i.consume_key(egui::Modifiers::NONE, Key::ArrowUp))
        });
        let last = found.len().saturating_sub(1) as i64;
        self.selected = (self.selected as i64 + moved).clamp(0, last) as usize;
        let enter = ctx.input_mut(|i| i.consume_key(egui::Modifiers::NONE, Key::Enter));
        let selected = found.get(self.selected).filter(|_| enter);
        let mut chosen = selected.and_then(possible);
        let area = egui::Modal::default_area(Id::unique("palette"))
            .anchor(Align2::CENTER_TOP, vec2(0.0, 72.0));
        let modal = egui::Modal::new(Id::unique("palette"))
            .frame(theme::dialog(ctx).inner_margin(12))
            .area(area)
            .show(ctx, |ui| {
                ui.set_width(460.0);
                let field = egui::TextEdit::singleline(&mut self.query)
                    .hint_text("Find a command")
                    .desired_width(f32::INFINITY);
                let field = ui.add(field).accessible_name("Find a command");
                if self.fresh {
                    field.request_focus();
                    self.fresh = false;
                }
                if field.changed() {
                    self.selected = 0;
                }
                ui.add_space(4.0);
                ScrollArea::vertical().max_height(360.0).show(ui, |ui| {
                    for (i, one) in found.iter().enumerate() {
                        let row = row_ui(ui, one, i == self.selected);
                        if moved != 0 && i == self.selected {
                            row.scroll_to_me(None);
                        }
                        if row.clicked() {
                            chosen = possible(one);
                        }
                    }
                    if found.is_empty() {
                        ui.weak("No command has this in its name");
                    }
                });
            });
        match chosen {
            Some(action) => Chosen::Action(action),
            None if modal.should_close() => Chosen::Closed,
            None => Chosen::Nothing,
        }
    }
}

/// The command, if it can be given.
fn possible((entry, why_not): &Found) -> Option<Action> {
    why_not.is_none().then_some(entry.action)
}

/// A command's name and keys; where it can't be given, the reason in their place.
fn row_ui(ui: &mut egui::Ui, (entry, why_not): &Found, selected: bool) -> egui::Response {
    let keys = entry.keys_text(ui.ctx()).unwrap_or_default();
    let aside = why_not.map_or(keys, str::to_owned);
    let button = egui::Button::selectable(selected, entry.name)
        .shortcut_text(aside)
        .min_size(vec2(ui.available_width(), 0.0));
    ui.add_enabled(why_not.is_none(), button)
        .on_hover_text(entry.tip)
        .on_disabled_hover_text(entry.tip)
}

/// Whether every word of the query is in the command's name, menu or description.
fn matches(entry: &Entry, query: &str) -> bool {
    let text = format!("{} {} {}", entry.menu.name(), entry.name, entry.tip).to_lowercase();
    query
        .to_lowercase()
        .split_whitespace()
        .all(|word| text.contains(word))
}

/// Shows all keys and gestures; whether it is to be closed.
pub fn key_sheet(ctx: &egui::Context, gestures: &[(&str, &str)]) -> bool {
    let modal = egui::Modal::new(Id::unique("keys"))
        .frame(theme::dialog(ctx))
        .show(ctx, |ui| {
            ui.set_width(720.0_f32.min(ctx.content_rect().width() - 64.0));
            ui.heading("Keys and gestures");
            ui.add_space(8.0);
            let height = ctx.content_rect().height() - 160.0;
            ScrollArea::vertical().max_height(height).show(ui, |ui| {
                ui.columns(2, |columns| {
                    for (column, menus) in [
                        (0, [Menu::File, Menu::Edit, Menu::Estimate].as_slice()),
                        (1, [Menu::View, Menu::Help].as_slice()),
                    ] {
                        for &menu in menus {
                            menu_keys(&mut columns[column], menu);
                        }
                        if column == 0 {
                            gesture_keys(&mut columns[0], gestures);
                        }
                    }
                });
            });
            ui.add_space(8.0);
            ui.button("Close").on_hover_text("Back to work").clicked()
        });
    modal.inner || modal.should_close()
}

fn menu_keys(ui: &mut egui::Ui, menu: Menu) {
    theme::group(ui, menu.name());
    egui::Grid::new(("keys", menu.name()))
        .num_columns(2)
        .min_col_width(110.0)
        .show(ui, |ui| {
            for entry in ENTRIES.iter().filter(|e| e.menu == menu) {
                let Some(keys) = entry.keys_text(ui.ctx()) else {
                    continue;
                };
                match entry.action {
                    Action::Camera(0) => {
                        ui.label(RichText::new("1 … 9").monospace());
                        ui.label("Look through an input camera");
                        ui.end_row();
                        continue;
                    }
                    Action::Camera(_) => continue,
                    _ => {}
                }
                ui.label(RichText::new(keys).monospace());
                ui.label(entry.name);
                ui.end_row();
            }
        });
    ui.add_space(theme::GAP);
}

fn gesture_keys(ui: &mut egui::Ui, gestures: &[(&str, &str)]) {
    theme::group(ui, "Mouse in the viewport");
    egui::Grid::new("gestures")
        .num_columns(2)
        .min_col_width(110.0)
        .show(ui, |ui| {
            for (gesture, meaning) in gestures {
                ui.label(RichText::new(*gesture).monospace());
                ui.label(*meaning);
                ui.end_row();
            }
        });
}
