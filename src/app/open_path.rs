//! Asks for a path where the system has no file dialog.

use std::path::PathBuf;

use eframe::egui::{self, Id};

use super::theme;
use crate::worker::Purpose;

/// The question while it is open.
pub struct OpenPath {
    purpose: Purpose,
    text: String,
    fresh: bool,
}

/// What came of a frame of the question.
pub enum Answer {
    /// It stays open.
    Nothing,
    /// It is to be closed.
    Closed,
    /// This path was given.
    Path(PathBuf),
}

impl OpenPath {
    /// Asks for a path to be opened.
    pub fn new(purpose: Purpose) -> Self {
        Self {
            purpose,
            text: String::new(),
            fresh: true,
        }
    }

    /// What the path is for.
    pub fn purpose(&self) -> Purpose {
        self.purpose
    }

    /// Shows the question.
    pub fn show(&mut self, ctx: &egui::Context) -> Answer {
        let mut answer = Answer::Nothing;
        let modal = egui::Modal::new(Id::unique("open path"))
            .frame(theme::dialog(ctx))
            .show(ctx, |ui| {
                ui.set_width(520.0);
                let (title, hint) = match self.purpose {
                    Purpose::OpenFolder => {
                        ("Open a capture", "Folder of a capture or of a solution")
                    }
                    Purpose::OpenFile => ("Open a project", "A project file or a transforms.json"),
                    Purpose::SaveProject => ("Save the project", "File to write"),
                    Purpose::ExportFolder => ("Export", "Folder to write to"),
                    Purpose::Photographs => (
                        "Locate the photographs",
                        "Folder of the capture, or its transforms.json",
                    ),
                    Purpose::SaveMesh => ("Save the mesh", "OBJ file to write"),
                    Purpose::LightProbe => ("Open a light probe", "A lat-long .hdr or .exr"),
                };
                ui.heading(title);
                ui.label(
                "This system has no file dialog. Type or paste the path, or drop it on the window.",
            );
                ui.add_space(8.0);
                let field = egui::TextEdit::singleline(&mut self.text)
                    .hint_text(hint)
                    .desired_width(f32::INFINITY);
                let field = ui.add(field).accessible_name("Path");
                if self.fresh {
                    field.request_focus();
                    self.fresh = false;
                }
                let entered = field.lost_focus() && ui.input(|i| i.key_pressed(egui::Key::Enter));
                ui.add_space(8.0);
                ui.horizontal(|ui| {
                    let given = !self.text.trim().is_empty();
                    let open = ui
                        .add_enabled(given, theme::main_button(ui, "Use this path"))
                        .on_hover_text("Go on with this path");
                    if open.clicked() || entered && given {
                        answer = Answer::Path(PathBuf::from(self.text.trim()));
                    }
                    if ui.button("Cancel").on_hover_text("Back to work").clicked() {
                        answer = Answer::Closed;
                    }
                });
            });
        if modal.should_close() && matches!(answer, Answer::Nothing) {
            answer = Answer::Closed;
        }
        answer
    }
}
