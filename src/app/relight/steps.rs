//! The history as a list: every step by its name, to go to any of them.

use eframe::egui::{self, RichText, ScrollArea, vec2};

use crate::app::theme;
use rekindle_studio::Document;

/// Size of the list, points.
const SIZE: egui::Vec2 = vec2(236.0, 300.0);

/// Shows the list over the viewport, which is at `within`. Whether it stays open.
pub(super) fn show(ctx: &egui::Context, within: egui::Rect, document: &mut Document) -> bool {
    let mut open = true;
    let style = ctx.global_style();
    egui::Window::new("History")
        .frame(egui::Frame::window(&style).inner_margin(12))
        .title_bar(false)
        .resizable(false)
        .constrain_to(within)
        .default_pos(within.right_top() + vec2(-SIZE.x - 48.0, 48.0))
        .show(ctx, |ui| {
            ui.set_width(SIZE.x);
            ui.horizontal(|ui| {
                ui.label(RichText::new("History").strong());
                ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                    let tip = "Hide the history (Ctrl+H)";
                    open = !theme::close_button(ui, "Close the history", tip).clicked();
                });
            });
            let height = SIZE.y.min(within.height() - 96.0);
            ScrollArea::vertical()
                .max_height(height)
                .auto_shrink([false, true])
                .show(ui, |ui| {
                    // Room for the scroll bar.
                    ui.set_max_width(ui.available_width() - 10.0);
                    if let Some(step) = list_ui(ui, document) {
                        document.go_to(step);
                    }
                });
        });
    open
}

/// The steps, the oldest first; returns the number of steps up to one that was clicked.
fn list_ui(ui: &mut egui::Ui, document: &Document) -> Option<usize> {
    let (done, undone) = document.history();
    let now = done.len();
    let begin = ["As it was opened"].into_iter();
    let steps = begin.chain(done).chain(undone).enumerate();
    let mut chosen = None;
    let id = ui.scope_id().with("shown step");
    let before = ui.data(|data| data.get_temp(id));
    ui.data_mut(|data| data.insert_temp(id, now));
    let scrolls = before != Some(now);
    for (step, label) in steps {
        let text = if step > now {
            RichText::new(label).weak()
        } else {
            RichText::new(label)
        };
        let width = ui.available_width();
        let button = egui::Button::selectable(step == now, text).truncate();
        let response = ui.add_sized([width, ui.spacing().interact_size.y], button);
        if step == now && scrolls {
            response.scroll_to_me(None);
        }
        let tip = match step {
            s if s == now => "This is what is shown",
            s if s > now => "Do everything up to here again",
            _ => "Undo everything after this",
        };
        if response.on_hover_text(tip).clicked() {
            chosen = Some(step);
        }
    }
    chosen
}
