//! The page on which the object is relit.

use std::sync::Arc;

use eframe::egui;

use super::viewport::{Object, Scene, Viewport};
use super::{Shared, theme};
use crate::capture::Capture;
use crate::studio::Document;
use crate::worker::{Rendered, Subject};

/// A document that is being edited.
pub struct Relighting {
    document: Document,
    viewport: Viewport,
}

impl Relighting {
    /// Shows a document; `capture` is what it was solved from, if that is open.
    pub fn new(document: Document, capture: Option<&Arc<Capture>>) -> Self {
        let solution = document.solution();
        let mut viewport = Viewport::new(
            Object::Solution(Arc::clone(solution)),
            solution.grid.up,
            capture,
        );
        viewport.allow_comparison();
        viewport.set_white(solution.white());
        Self { document, viewport }
    }

    /// The document.
    pub fn document(&self) -> &Document {
        &self.document
    }

    /// The document.
    pub fn document_mut(&mut self) -> &mut Document {
        &mut self.document
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
    pub fn rendered(&mut self, ctx: &egui::Context, rendered: &Rendered) {
        self.viewport.rendered(ctx, rendered);
    }

    /// Shows the page.
    pub(super) fn show(&mut self, ui: &mut egui::Ui, shared: &mut Shared<'_>) {
        egui::Panel::left("lamps")
            .frame(theme::side(ui))
            .resizable(true)
            .default_size(theme::SIDE)
            .size_range(220.0..=420.0)
            .show(ui, |ui| {
                theme::group(ui, "Lamps");
                for lamp in &self.document.look().lamps {
                    ui.label(&lamp.name);
                }
            });
        egui::CentralPanel::default()
            .frame(theme::stage())
            .show(ui, |ui| {
                let document = &self.document;
                let scene = Scene {
                    worker: shared.worker,
                    habit: shared.settings.habit,
                    free: true,
                    version: document.revision(),
                    gpu: shared.gpu,
                    dragging: document.is_dragging(),
                    shadowed: 0,
                    subject: Some(|| {
                        let subject = Subject::Solved(Arc::clone(document.solution()));
                        Some((subject, document.light().lighting))
                    }),
                };
                self.viewport.show(ui, scene);
            });
    }
}
