//! The bar at the top: menus, the pages, and what is running.

use std::time::Duration;

use eframe::egui::{self, Button, RichText};

use super::commands::{Action, ENTRIES, Menu};
use super::exports::Progress;
use super::navigation::Habit;
use super::{App, Doing, Page, Request, Source, theme};

/// Shows the bar; returns what was asked for.
pub(super) fn show(ui: &mut egui::Ui, app: &App) -> Vec<Request> {
    let mut requests = Vec::new();
    egui::Panel::top("menus").show(ui, |ui| {
        egui::MenuBar::new().ui(ui, |ui| {
            for menu in Menu::ALL {
                menu_ui(ui, app, menu, &mut requests);
            }
            ui.add_space(theme::GAP);
            pages_ui(ui, app, &mut requests);
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                running_ui(ui, app, &mut requests);
            });
        });
    });
    requests
}

fn menu_ui(ui: &mut egui::Ui, app: &App, menu: Menu, requests: &mut Vec<Request>) {
    ui.menu_button(menu.name(), |ui| {
        for entry in ENTRIES.iter().filter(|e| e.menu == menu) {
            // Nine cameras would fill the menu: those that there are.
            if matches!(entry.action, Action::Camera(_)) && !app.enabled(entry.action) {
                continue;
            }
            if entry.begins_group {
                ui.separator();
            }
            let mut button = Button::new(entry.name);
            if let Some(keys) = entry.keys_text(ui.ctx()) {
                button = button.shortcut_text(keys);
            }
            let obstacle = app.obstacle(entry.action);
            let why_not = obstacle.unwrap_or_default();
            let response = ui
                .add_enabled(obstacle.is_none(), button)
                .on_hover_text(entry.tip)
                .on_disabled_hover_text(format!("{}. {why_not}", entry.tip));
            if response.clicked() {
                requests.push(Request::Action(entry.action));
                ui.close();
            }
            if entry.action == Action::OpenFile {
                recent_ui(ui, app, requests);
            }
        }
        if menu == Menu::View {
            ui.separator();
            habits_ui(ui, app, requests);
        }
    });
}

fn recent_ui(ui: &mut egui::Ui, app: &App, requests: &mut Vec<Request>) {
    let recent = &app.settings.recent;
    ui.add_enabled_ui(!recent.is_empty() && app.job.is_none(), |ui| {
        ui.menu_button("Open recent", |ui| {
            for path in recent {
                let text = path.display().to_string();
                if ui.button(&text).on_hover_text("Open again").clicked() {
                    requests.push(Request::Open(Source::Path(path.clone())));
                    ui.close();
                }
            }
        });
    });
}

/// Whose mouse habits the viewport has.
fn habits_ui(ui: &mut egui::Ui, app: &App, requests: &mut Vec<Request>) {
    ui.menu_button("Mouse habits", |ui| {
        for habit in Habit::ALL {
            let gestures: Vec<String> = habit
                .gestures()
                .iter()
                .map(|(gesture, meaning)| format!("{gesture}: {meaning}"))
                .collect();
            let response = ui
                .radio(app.settings.habit == habit, habit.name())
                .on_hover_text(gestures.join("\n"));
            if response.clicked() {
                requests.push(Request::Habit(habit));
                ui.close();
            }
        }
    });
}

/// The pages that there are, as tabs.
fn pages_ui(ui: &mut egui::Ui, app: &App, requests: &mut Vec<Request>) {
    for (page, name, action, tip) in [
        (
            Page::Capture,
            "Capture",
            Action::ShowCapture,
            "Photographs, mesh and what is wrong with them (F1)",
        ),
        (
            Page::Estimation,
            "Estimation",
            Action::ShowEstimation,
            "Hemispheres, curves and every iteration (F2)",
        ),
        (
            Page::Relighting,
            "Relighting",
            Action::ShowRelighting,
            "The object and its lights (F3)",
        ),
    ] {
        let here = app.page == page;
        let button = Button::selectable(here, name);
        let response = ui
            .add_enabled(app.enabled(action), button)
            .on_hover_text(tip)
            .on_disabled_hover_text(tip);
        if response.clicked() && !here {
            requests.push(Request::Action(action));
        }
    }
}

/// What the worker does, at the right end.
fn running_ui(ui: &mut egui::Ui, app: &App, requests: &mut Vec<Request>) {
    let Some(job) = &app.job else { return };
    let text = match &job.doing {
        Doing::Opening(Source::Demo) => "Opening the demo".to_owned(),
        Doing::Opening(Source::Path(path)) => {
            let name = path.file_name().unwrap_or(path.as_os_str());
            format!("Opening {}", name.to_string_lossy())
        }
        Doing::Recovering(_) => "Recovering".to_owned(),
        Doing::Aligning(part) => format!("Aligning, {:.0} %", 100.0 * part),
        Doing::Solving if app.worker.is_paused() => "Paused".to_owned(),
        Doing::Solving => "Estimating".to_owned(),
        Doing::Exporting {
            export,
            said,
            part,
            since,
        } => {
            let progress = Progress {
                export,
                said,
                part: *part,
                since: *since,
            };
            exporting_ui(ui, app, &progress, requests);
            return;
        }
    };
    // These pages have a button of their own.
    let own = match app.page {
        Page::Estimation => true,
        Page::Capture => matches!(job.doing, Doing::Aligning(_)),
        _ => false,
    };
    if !own {
        let stop = ui.button("Stop").on_hover_text("Stop what is running");
        if stop.clicked() {
            requests.push(Request::Action(Action::Stop));
        }
    }
    ui.label(RichText::new(text).color(theme::palette(ui).accent));
}

/// How far an export is, and what waits for it.
fn exporting_ui(
    ui: &mut egui::Ui,
    app: &App,
    progress: &Progress<'_>,
    requests: &mut Vec<Request>,
) {
    // The time goes on between the news.
    ui.ctx().request_repaint_after(Duration::from_millis(500));
    let tip = if app.exports.waiting() == 0 {
        "Stop the export; finished frames are kept"
    } else {
        "Stop this export, which keeps its finished frames, and go on with the next"
    };
    if ui.button("Stop").on_hover_text(tip).clicked() {
        requests.push(Request::Action(Action::Stop));
    }
    let pace = app.settings.export.seconds_per_megapixel;
    requests.extend(app.exports.button(ui, progress, pace));
    progress.bar_ui(ui);
    let text = RichText::new(progress.in_words()).color(theme::palette(ui).accent);
    ui.add(egui::Label::new(text).truncate());
}
