//! The welcome page: where to begin.

use eframe::egui::{self, Align2, Color32, CornerRadius, RichText, Stroke, StrokeKind, vec2};

use std::sync::Arc;

use super::commands::{Action, entry_of};
use super::{Request, Shared, Source, theme};
use rekindle_studio::Recoverable;

/// The demo, relit, before nothing.
const PICTURE: &[u8] = include_bytes!("../../assets/app/welcome.png");
/// Width of the column of buttons, points.
const COLUMN: f32 = 340.0;

/// The page's picture, ready to be shown.
pub(super) fn picture(ctx: &egui::Context) -> Option<egui::TextureHandle> {
    let picture = image::load_from_memory(PICTURE).ok()?.to_rgba8();
    let size = [picture.width() as usize, picture.height() as usize];
    let picture = egui::ColorImage::from_rgba_unmultiplied(size, &picture);
    Some(ctx.load_texture("welcome", picture, egui::TextureOptions::LINEAR))
}

/// Shows the page; `opening` is what is being opened.
pub(super) fn show(
    ui: &mut egui::Ui,
    shared: &mut Shared<'_>,
    shown: Option<&egui::TextureHandle>,
    opening: Option<&Source>,
    kept: &[Arc<Recoverable>],
) {
    let hovering = ui.input(|i| !i.raw.hovered_files.is_empty());
    egui::CentralPanel::default().show(ui, |ui| {
        let room = ui.available_rect_before_wrap();
        let wide = room.width() > 900.0;
        let column = if wide { COLUMN } else { room.width() - 96.0 };
        let picture = if wide {
            (room.width() - COLUMN - 160.0).min(640.0)
        } else {
            0.0
        };
        let left = room.center().x - 0.5 * (column + picture + if wide { 48.0 } else { 0.0 });
        let top = room.center().y - 250.0_f32.min(0.5 * room.height() - 16.0);
        let rect = egui::Rect::from_min_size(
            egui::pos2(left, top),
            vec2(column, room.bottom() - top - 16.0),
        );
        ui.scope_builder(egui::UiBuilder::new().max_rect(rect), |ui| {
            left_behind_ui(ui, shared, kept, opening.is_none());
            begin_ui(ui, shared, opening);
        });
        if let Some(shown) = shown.filter(|_| wide) {
            let size = shown.size_vec2();
            let rect = egui::Rect::from_center_size(
                egui::pos2(left + column + 48.0 + 0.5 * picture, room.center().y),
                size * (picture / size.x),
            );
            egui::Image::new(shown)
                .alt_text("The demo, relit")
                .paint_at(ui, rect);
        }
        if hovering {
            let rect = room.shrink(12.0);
            let accent = theme::palette(ui).accent;
            ui.painter().rect(
                rect,
                CornerRadius::same(10),
                Color32::from_black_alpha(150),
                Stroke::new(2.0, accent),
                StrokeKind::Inside,
            );
            ui.painter().text(
                rect.center(),
                Align2::CENTER_CENTER,
                "Drop it to open it",
                egui::FontId::proportional(24.0),
                Color32::WHITE,
            );
        }
    });
}

/// What a crash left behind.
fn left_behind_ui(
    ui: &mut egui::Ui,
    shared: &mut Shared<'_>,
    left: &[Arc<Recoverable>],
    enabled: bool,
) {
    for (i, work) in left.iter().enumerate().take(3) {
        theme::card(ui).show(ui, |ui| {
            ui.set_width(ui.available_width());
            let minutes = work
                .kept
                .elapsed()
                .map_or(0, |elapsed| elapsed.as_secs() / 60);
            let when = match minutes {
                0 => "just now".to_owned(),
                1..=90 => format!("{minutes} min ago"),
                _ => format!("{} h ago", minutes / 60),
            };
            ui.label(RichText::new("Unsaved work was left behind").strong());
            ui.weak(format!(
                "Kept {when}, before the program ended unexpectedly."
            ));
            ui.add_enabled_ui(enabled, |ui| {
                ui.horizontal(|ui| {
                    let recover = ui.add(theme::main_button(ui, "Recover"));
                    let tip = "Open it as it was kept";
                    if recover.on_hover_text(tip).clicked() {
                        shared.actions.push(Request::Recover(i));
                    }
                    let discard = ui.button("Discard");
                    if discard.on_hover_text("Remove it for good").clicked() {
                        shared.actions.push(Request::Discard(i));
                    }
                });
            });
        });
        ui.add_space(theme::GAP);
    }
}

fn begin_ui(ui: &mut egui::Ui, shared: &mut Shared<'_>, opening: Option<&Source>) {
    let palette = theme::palette(ui);
    ui.label(RichText::new("Rekindle").size(44.0).strong());
    ui.label(
        RichText::new("Relight an object from a few HDR photographs and its mesh.")
            .size(15.0)
            .color(palette.weak),
    );
    ui.add_space(24.0);
    ui.add_enabled_ui(opening.is_none(), |ui| {
        ui.spacing_mut().item_spacing.y = 10.0;
        let wide = vec2(ui.available_width(), 40.0);
        for (action, main) in [
            (Action::Demo, true),
            (Action::OpenFolder, false),
            (Action::OpenFile, false),
        ] {
            let Some(entry) = entry_of(action) else {
                continue;
            };
            let button = if main {
                theme::main_button(ui, entry.name)
            } else {
                egui::Button::new(entry.name)
            };
            let keys = entry.keys_text(ui.ctx());
            let tip = format!("{} ({})", entry.tip, keys.unwrap_or_default());
            if ui.add(button.min_size(wide)).on_hover_text(tip).clicked() {
                shared.actions.push(Request::Action(action));
            }
        }
    });
    ui.add_space(10.0);
    if opening.is_some() {
        ui.label(RichText::new("Reading photographs and mesh…").color(palette.accent));
    } else {
        ui.weak("Or drop a folder or a project on the window.");
        let needs = ui.link("What a capture needs");
        let tip = "How to shoot one: object, light, views, brackets, masks, mesh (Shift+F1)";
        if needs.on_hover_text(tip).clicked() {
            shared.actions.push(Request::Action(Action::Guide));
        }
    }
    ui.add_space(theme::GAP);
    recent_ui(ui, shared, opening.is_none());
}

fn recent_ui(ui: &mut egui::Ui, shared: &mut Shared<'_>, enabled: bool) {
    if shared.settings.recent.is_empty() {
        return;
    }
    theme::group(ui, "Recent");
    let mut forget = None;
    egui::ScrollArea::vertical().show(ui, |ui| {
        for (i, path) in shared.settings.recent.iter().enumerate() {
            let name = path.file_name().unwrap_or(path.as_os_str());
            let name = name.to_string_lossy().into_owned();
            let row = ui.add_enabled_ui(enabled, |ui| {
                ui.horizontal(|ui| {
                    let width = ui.available_width() - 32.0;
                    let text = egui::Button::new(&name)
                        .frame_when_inactive(false)
                        .truncate()
                        .min_size(vec2(width, 0.0));
                    let open = ui
                        .add_sized(vec2(width, 26.0), text)
                        .on_hover_text(path.display().to_string());
                    let forget = format!("Forget {name}");
                    let remove =
                        theme::close_button(ui, &forget, "Take off the list; the files stay");
                    (open.clicked(), remove.clicked())
                })
                .inner
            });
            if row.inner.0 {
                shared
                    .actions
                    .push(Request::Open(Source::Path(path.clone())));
            }
            if row.inner.1 {
                forget = Some(i);
            }
        }
    });
    if let Some(i) = forget {
        shared.settings.recent.remove(i);
    }
}
