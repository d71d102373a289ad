//! What this program is, and on what it draws.

use eframe::egui::{self, Id};
use eframe::egui_wgpu::RenderState;
use eframe::wgpu;

use super::theme;

/// Width of the names of facts, points.
const NAMES: f32 = 120.0;

/// Shows version and graphics adapter; whether it is to be closed.
pub(super) fn show(ctx: &egui::Context, gpu: Option<&RenderState>) -> bool {
    let facts = facts(gpu.map(|gpu| gpu.adapter.get_info()));
    let modal = egui::Modal::new(Id::unique("about"))
        .frame(theme::dialog(ctx))
        .show(ctx, |ui| {
            ui.set_width(460.0);
            ui.heading("About rekindle");
            ui.label("Relights a captured object: from photographs with known cameras and a mesh.");
            ui.add_space(theme::GAP * 0.5);
            egui::Grid::new("about")
                .num_columns(2)
                .min_col_width(NAMES)
                .spacing([12.0, 6.0])
                .show(ui, |ui| {
                    for (name, value) in &facts {
                        ui.weak(*name);
                        ui.add(egui::Label::new(value).wrap());
                        ui.end_row();
                    }
                });
            ui.add_space(theme::GAP);
            ui.horizontal(|ui| {
                let tip = "Copy version and adapter, to be told with a fault";
                if ui.button("Copy").on_hover_text(tip).clicked() {
                    let lines = facts
                        .iter()
                        .map(|(name, value)| format!("{name}: {value}\n"));
                    ui.ctx().copy_text(lines.collect());
                }
                ui.button("Close").on_hover_text("Back to work").clicked()
            })
            .inner
        });
    modal.inner || modal.should_close()
}

/// Names with values.
fn facts(adapter: Option<wgpu::AdapterInfo>) -> Vec<(&'static str, String)> {
    let mut facts = vec![
        ("Version", env!("CARGO_PKG_VERSION").to_owned()),
        ("Licence", env!("CARGO_PKG_LICENSE").to_owned()),
    ];
    let Some(adapter) = adapter else {
        let none = "None: the object is shown by the reference renderer, which takes longer";
        facts.push(("Graphics adapter", none.to_owned()));
        return facts;
    };
    let kind = match adapter.device_type {
        wgpu::DeviceType::DiscreteGpu => "a card of its own",
        wgpu::DeviceType::IntegratedGpu => "built into the processor",
        wgpu::DeviceType::VirtualGpu => "a virtual one",
        wgpu::DeviceType::Cpu => "none: the processor does its work, which takes longer",
        wgpu::DeviceType::Other => "unknown",
    };
    let driver = format!("{} {}", adapter.driver, adapter.driver_info);
    facts.extend([
        ("Graphics adapter", adapter.name),
        ("Kind of adapter", kind.to_owned()),
        ("Driver", driver.trim().to_owned()),
        ("Interface", adapter.backend.to_string()),
    ]);
    facts
}
