//! Messages: errors stay until closed, the rest goes by itself.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use eframe::egui::{self, Align2, Id, Order, RichText, Stroke, vec2};

use super::theme::{self, Mark};

/// How long a message that is no error is shown, seconds.
const SHOWN_S: f64 = 6.0;
/// Messages shown at a time; older ones give way.
const MOST: usize = 4;

/// How much a message matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weight {
    /// Something went well.
    Done,
    /// Something to know.
    Note,
    /// Something failed.
    Error,
}

struct Notice {
    number: u64,
    weight: Weight,
    title: String,
    text: String,
    /// A folder that it is about.
    folder: Option<PathBuf>,
    /// When it goes, in the window's seconds.
    until: Option<f64>,
}

/// The messages on the window.
#[derive(Default)]
pub struct Notices {
    notices: Vec<Notice>,
    count: u64,
}

impl Notices {
    /// Adds a message. An error stays until it is closed; one like it is replaced.
    pub fn add(&mut self, weight: Weight, title: impl Into<String>, text: impl Into<String>) {
        self.push(weight, title.into(), text.into(), None);
    }

    /// Adds a message about a folder, which it names and offers to open.
    pub fn add_folder(
        &mut self,
        weight: Weight,
        title: impl Into<String>,
        text: impl Into<String>,
        folder: &Path,
    ) {
        self.push(weight, title.into(), text.into(), Some(folder.to_owned()));
    }

    fn push(&mut self, weight: Weight, title: String, text: String, folder: Option<PathBuf>) {
        self.notices
            .retain(|n| n.title != title || n.weight != weight);
        self.count += 1;
        self.notices.push(Notice {
            number: self.count,
            weight,
            title,
            text,
            folder,
            until: None,
        });
        let surplus = self.notices.len().saturating_sub(MOST);
        self.notices.drain(..surplus);
    }

    /// Closes the errors, as when what they were about worked the next time.
    pub fn clear_errors(&mut self) {
        self.notices.retain(|n| n.weight != Weight::Error);
    }

    /// Shows the messages over the window's lower right corner.
    pub fn show(&mut self, ctx: &egui::Context) {
        let now = ctx.input(|i| i.time);
        let mut closed = None;
        let mut below = 36.0;
        for notice in self.notices.iter_mut().rev() {
            if notice.weight != Weight::Error {
                let until = *notice.until.get_or_insert(now + SHOWN_S);
                if now >= until {
                    closed = Some(notice.number);
                    continue;
                }
                ctx.request_repaint_after_secs((until - now) as f32);
            }
            let area = egui::Area::new(Id::unique(("notice", notice.number)))
                .order(Order::Foreground)
                .anchor(Align2::RIGHT_BOTTOM, vec2(-16.0, -below))
                .show(ctx, |ui| notice_ui(ui, notice));
            if area.inner {
                closed = Some(notice.number);
            }
            below += area.response.rect.height() + 8.0;
        }
        if let Some(number) = closed {
            self.notices.retain(|n| n.number != number);
            ctx.request_repaint();
        }
    }
}

/// One message; whether it is to be closed.
fn notice_ui(ui: &mut egui::Ui, notice: &Notice) -> bool {
    let mark = match notice.weight {
        Weight::Done => Mark::Good,
        Weight::Note => Mark::Note,
        Weight::Error => Mark::Error,
    };
    let colour = mark.colour(ui);
    let frame = theme::card(ui)
        .fill(ui.visuals().window_fill)
        .stroke(Stroke::new(1.0, colour))
        .shadow(ui.visuals().popup_shadow);
    let mut close = false;
    frame.show(ui, |ui| {
        ui.set_max_width(460.0);
        ui.horizontal_top(|ui| {
            mark.show(ui);
            ui.vertical(|ui| {
                ui.set_max_width(380.0);
                ui.label(RichText::new(&notice.title).strong());
                if !notice.text.is_empty() {
                    ui.label(&notice.text);
                }
                if let Some(folder) = &notice.folder {
                    ui.label(folder.display().to_string());
                    let open = ui.button("Open folder");
                    if open
                        .on_hover_text("Show it in the system's file manager")
                        .clicked()
                    {
                        let url = url_of(folder);
                        ui.ctx().open_url(egui::OpenUrl::new_tab(url));
                    }
                }
            });
            let name = format!("Close message {}", notice.title);
            close = theme::close_button(ui, &name, "Close this message").clicked();
        });
    });
    close
}

/// A folder as file managers and browsers are told of it.
fn url_of(folder: &Path) -> String {
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let path = absolute.to_string_lossy().replace('\\', "/");
    let mut url = "file://".to_owned();
    if !path.starts_with('/') {
        url.push('/');
    }
    for byte in path.bytes() {
        if byte.is_ascii_alphanumeric() || b"/:-_.~".contains(&byte) {
            url.push(char::from(byte));
        } else {
            // Writing into a string can't fail.
            let _ = write!(url, "%{byte:02X}");
        }
    }
    url
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_become_addresses() {
        let url = url_of(Path::new("/work/a picture/50 % größer"));
        assert_eq!(url, "file:///work/a%20picture/50%20%25%20gr%C3%B6%C3%9Fer");
    }
}
