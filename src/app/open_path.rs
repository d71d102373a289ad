//! Asks for a path where the system has no file dialog.

use std::path::{Path, PathBuf};

use eframe::egui::{self, Id, RichText};

use super::theme;
use crate::worker::Purpose;

/// The question while it is open.
pub struct OpenPath {
    purpose: Purpose,
    text: String,
    fresh: bool,
    /// Where relative paths begin.
    folder: PathBuf,
    home: Option<PathBuf>,
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
    /// Asks for a path. Relative ones begin in `folder`, or where the program was started.
    pub fn new(purpose: Purpose, folder: Option<PathBuf>) -> Self {
        let folder = folder.unwrap_or_default();
        Self {
            purpose,
            text: String::new(),
            fresh: true,
            folder: std::path::absolute(&folder)
                .or_else(|_| std::env::current_dir())
                .unwrap_or(folder),
            home: std::env::home_dir(),
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
                    Purpose::SaveCurves => ("Save the curves", "File to write, .csv or .svg"),
                    Purpose::LightProbe | Purpose::KnownLight => {
                        ("Open a light probe", "A lat-long .hdr or .exr")
                    }
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
                let path = resolved(&self.text, &self.folder, self.home.as_deref());
                let says = match &path {
                    Some(path) => format!("This is {}", path.display()),
                    None => format!("In {}", self.folder.display()),
                };
                let tip = "Relative paths begin in this folder; ~ is your home";
                let label = egui::Label::new(RichText::new(says).weak()).truncate();
                ui.add(label).on_hover_text(tip);
                ui.add_space(8.0);
                ui.horizontal(|ui| {
                    let open = ui
                        .add_enabled(path.is_some(), theme::main_button(ui, "Use this path"))
                        .on_hover_text("Go on with this path");
                    if let Some(path) = path.filter(|_| open.clicked() || entered) {
                        answer = Answer::Path(path);
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

/// The path that a text means: without the quotes of a shell, `~` being the home folder, relative ones in a folder. None where
/// there is no text.
fn resolved(text: &str, folder: &Path, home: Option<&Path>) -> Option<PathBuf> {
    let text = text.trim();
    let unquoted = |quote| text.strip_prefix(quote)?.strip_suffix(quote);
    let text = unquoted('"').or_else(|| unquoted('\'')).unwrap_or(text);
    if text.is_empty() {
        return None;
    }
    let path = Path::new(text);
    let at_home = home.and_then(|home| Some(home.join(path.strip_prefix("~").ok()?)));
    // Joining leaves absolute paths as they are.
    Some(at_home.unwrap_or_else(|| folder.join(path)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn typed_paths_begin_at_home_in_the_folder_or_at_the_root() {
        let (folder, home) = (Path::new("/captures"), Path::new("/home/ada"));
        for (text, path) in [
            (" duck ", "/captures/duck"),
            ("../solved/duck", "/captures/../solved/duck"),
            ("/tmp/duck", "/tmp/duck"),
            ("~", "/home/ada"),
            ("~/duck.rekindle", "/home/ada/duck.rekindle"),
            // Another's home is not known; such a name is a file's.
            ("~bob", "/captures/~bob"),
            ("'/tmp/two words'", "/tmp/two words"),
            ("\"~/duck\"", "/home/ada/duck"),
        ] {
            let found = resolved(text, folder, Some(home));
            assert_eq!(found, Some(PathBuf::from(path)), "{text}");
        }
        assert_eq!(resolved("  ", folder, Some(home)), None);
        let found = resolved("~/duck", folder, None);
        assert_eq!(found, Some(PathBuf::from("/captures/~/duck")));
    }
}
