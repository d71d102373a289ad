//! The page on which the object is relit.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eframe::egui;

use super::viewport::Viewport;
use super::{Shared, theme};
use crate::capture::Capture;
use crate::solution::Solution;
use crate::worker::{Purpose, Rendered, Subject};

/// A solution that is being relit.
pub struct Relighting {
    solution: Arc<Solution>,
    viewport: Viewport,
    /// Changes with the lighting.
    version: u64,
}

impl Relighting {
    /// Shows a solution; `capture` is what it was solved from, if that is open, `folder` where it is stored.
    pub fn new(
        solution: Arc<Solution>,
        capture: Option<Arc<Capture>>,
        _folder: Option<&Path>,
    ) -> Self {
        let views = capture.as_ref().map_or(&[][..], |capture| &capture.views);
        let mut viewport = Viewport::new(&solution.mesh, solution.grid.up, views);
        viewport.set_white(solution.white());
        Self {
            solution,
            viewport,
            version: 0,
        }
    }

    /// The view of the object.
    pub fn viewport(&self) -> &Viewport {
        &self.viewport
    }

    /// The view of the object.
    pub fn viewport_mut(&mut self) -> &mut Viewport {
        &mut self.viewport
    }

    /// Takes a picture of the reference renderer.
    pub fn rendered(&mut self, ctx: &egui::Context, rendered: Rendered) {
        self.viewport.rendered(ctx, rendered);
    }

    /// A path was chosen in a file dialog.
    pub fn picked(&mut self, _purpose: Purpose, _path: PathBuf) {}

    /// Shows the page.
    pub(super) fn show(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        egui::Panel::left("lamps")
            .frame(theme::side(ui))
            .resizable(true)
            .default_size(theme::SIDE)
            .size_range(220.0..=420.0)
            .show(ui, |ui| {
                theme::group(ui, "Lamps");
                for lamp in &self.solution.lamps {
                    ui.label(&lamp.name);
                }
            });
        egui::CentralPanel::default()
            .frame(theme::stage())
            .show(ui, |ui| {
                let solution = &self.solution;
                let habit = shared.settings.habit;
                self.viewport
                    .show(ui, shared.worker, habit, self.version, || {
                        let lighting = solution.lighting();
                        Some((Subject::Solved(Arc::clone(solution)), lighting))
                    });
            });
    }
}
