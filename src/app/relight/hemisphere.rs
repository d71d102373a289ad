//! The lit hemisphere seen from above, with the lamps as marks that can be dragged.

use std::sync::Arc;

use eframe::egui::{self, Color32, Pos2, Sense, Stroke, vec2};
use glam::{Quat, Vec3};

use super::compass;
use super::editing::{Editing, hue, move_to};
use crate::app::Shared;
use crate::app::disc::{self, Disc, DiscTexture};
use rekindle_relight::{LampNodes, LightNode, Lighting, luminance};
use rekindle_scene::hemisphere::{FromAbove, HemisphereGrid, Picture, from_above_axes};
use rekindle_studio::{Document, Lamp, LampId, Look};

/// Side of the square around a mark that takes the pointer, points.
const GRIP: f32 = 18.0;
/// Side of the picture in pixels.
const SIDE: u32 = 192;
/// Radius of the strongest light's mark in points, and of one without light.
const MARKS: [f32; 2] = [8.0, 3.5];

/// The picture of the light and what it was made of.
#[derive(Default)]
pub(super) struct LitDisc {
    from_above: Option<Arc<FromAbove>>,
    texture: DiscTexture,
    picture: Option<(u64, Arc<Picture>)>,
}

impl LitDisc {
    /// Gives it the way from nodes to pixels, which takes too long to find between two frames.
    pub(super) fn know(&mut self, from_above: Arc<FromAbove>) {
        self.from_above = Some(from_above);
    }

    /// The way from nodes to pixels.
    pub(super) fn from_above(grid: &HemisphereGrid) -> FromAbove {
        FromAbove::new(grid, SIDE)
    }

    /// Shows the disc as wide as `side`; the viewer is in the direction `towards` from the object.
    pub(super) fn show(
        &mut self,
        ui: &mut egui::Ui,
        side: f32,
        towards: Vec3,
        document: &mut Document,
        editing: &mut Editing,
        shared: &mut Shared<'_>,
    ) {
        let solution = Arc::clone(document.solution());
        let revision = document.revision();
        let old = self.picture.as_ref().is_none_or(|(of, _)| *of != revision);
        if let Some(from_above) = self.from_above.as_ref().filter(|_| old) {
            let mut nodes = on_grid(&solution.grid, &document.light().lighting);
            if let Some((probe, light)) = document.surroundings() {
                let captured = &document.base().lighting;
                for (node, direction) in nodes.iter_mut().zip(&solution.grid.directions) {
                    let all = Vec3::from(*node) + light.radiance(probe, captured, *direction);
                    *node = all.to_array();
                }
            }
            self.picture = Some((revision, Arc::new(from_above.picture(&nodes))));
        }
        let exposure = shared.settings.hemisphere;
        let texture = self
            .picture
            .as_ref()
            .map(|(_, picture)| self.texture.of(ui.ctx(), picture, exposure));
        let (response, disc) = ui
            .vertical_centered(|ui| {
                let name = "Lit hemisphere";
                let sense = Sense::CLICK | Sense::DRAG;
                disc::show(ui, texture, solution.grid.up, side, sense, name)
            })
            .inner;
        if response.clicked() {
            editing.select(None);
        }
        rubber_band(ui, &response, &disc, document.look(), editing);
        compass::wedge(ui, &disc, towards);
        let viewer = compass::told(towards, disc.up);
        ui.ctx()
            .accesskit_node_builder(response.id, |node| node.set_description(viewer.clone()));
        disc::direction_tip(response, &disc);
        let look = document.look().clone();
        for lamp in &look.lamps {
            mark(ui, document, editing, &disc, lamp, look.is_dark(lamp));
        }
    }
}

/// Selects the lamps that a rectangle, drawn from beside the marks, holds; with Ctrl or Shift they are added.
fn rubber_band(
    ui: &egui::Ui,
    response: &egui::Response,
    disc: &Disc,
    look: &Look,
    editing: &mut Editing,
) {
    let (origin, to, adds) = ui.input(|i| {
        let pointer = &i.pointer;
        let adds = i.modifiers.command || i.modifiers.shift;
        (pointer.press_origin(), pointer.interact_pos(), adds)
    });
    if response.drag_started() {
        editing.band = origin;
    }
    let (Some(from), Some(to)) = (editing.band, to) else {
        return;
    };
    let band = egui::Rect::from_two_pos(from, to);
    if response.dragged() {
        let line = Stroke::new(1.0, Color32::WHITE);
        let inside = egui::StrokeKind::Inside;
        ui.painter().rect_stroke(band, 0.0, line, inside);
    }
    if response.drag_stopped() {
        editing.band = None;
        let held = look.lamps.iter();
        let held = held.filter(|l| band.contains(place(disc, l.direction).0));
        let held: Vec<LampId> = held.map(|l| l.id).collect();
        let mut lamps = if adds {
            editing.selection(look)
        } else {
            Vec::new()
        };
        lamps.retain(|id| !held.contains(id));
        lamps.extend(held);
        editing.select_all(lamps);
    }
}

/// Where a lamp's mark is. One below the horizon is on the rim, below which it stands.
fn place(disc: &Disc, direction: Vec3) -> (Pos2, bool) {
    if let Some(at) = disc.at(direction) {
        return (at, true);
    }
    let [right, north] = from_above_axes(disc.up);
    let flat = vec2(direction.dot(right), -direction.dot(north));
    let out = if flat.length() > 1e-6 {
        flat.normalized()
    } else {
        vec2(0.0, 1.0)
    };
    (disc.rect.center() + 0.5 * disc.rect.width() * out, false)
}

fn mark(
    ui: &egui::Ui,
    document: &mut Document,
    editing: &mut Editing,
    disc: &Disc,
    lamp: &Lamp,
    dark: bool,
) {
    let (at, above) = place(disc, lamp.direction);
    let rect = egui::Rect::from_center_size(at, egui::Vec2::splat(GRIP));
    let id = ui.scope_id().with(("mark", lamp.id));
    let response = ui.interact(rect, id, Sense::CLICK | Sense::DRAG);
    let name = format!("{} on the hemisphere", lamp.name);
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, name.clone()));
    grab(ui, &response, document, editing, lamp);
    if let Some(pointer) = response
        .interact_pointer_pos()
        .filter(|_| response.dragged())
    {
        move_to(document, editing, lamp, disc.direction(pointer));
    }
    let selected = editing.is_selected(lamp.id);
    let lit = editing.lit == Some(lamp.id);
    draw_mark(
        ui.painter(),
        at,
        hue(document.base(), lamp),
        MarkStyle {
            radius: mark_radius(document, lamp),
            selected,
            lit,
            hollow: dark || !above,
            faint: dark,
        },
    );
    let where_it_is = if above { "" } else { ", below the horizon" };
    response.on_hover_text(format!("{}{where_it_is}: drag to move", lamp.name));
}

/// Selects a lamp whose mark is pressed (with Ctrl or Shift beside those that are selected), lights up one that the pointer is at, and moves one that has the focus by the arrow
/// keys.
pub(super) fn grab(
    ui: &egui::Ui,
    response: &egui::Response,
    document: &mut Document,
    editing: &mut Editing,
    lamp: &Lamp,
) {
    /// Radians by which a key moves a lamp.
    const STEP: f32 = 0.035;
    if response.hovered() || response.dragged() || response.has_focus() {
        editing.hovered = Some(lamp.id);
    }
    if response.clicked() || response.drag_started() {
        let adds = ui.input(|i| i.modifiers.command || i.modifiers.shift);
        if response.clicked() && adds {
            editing.toggle(lamp.id);
        } else if response.clicked() || !editing.is_selected(lamp.id) {
            editing.select(Some(lamp.id));
        }
        response.request_focus();
    }
    if !response.has_focus() {
        return;
    }
    let filter = egui::EventFilter {
        horizontal_arrows: true,
        vertical_arrows: true,
        ..egui::EventFilter::default()
    };
    ui.memory_mut(|m| m.set_focus_lock_filter(response.id, filter));
    let [left, right, up, down] = ui.input(|i| {
        use egui::Key::{ArrowDown, ArrowLeft, ArrowRight, ArrowUp};
        [ArrowLeft, ArrowRight, ArrowUp, ArrowDown].map(|key| i.num_presses(key) as f32)
    });
    let (turn, rise) = (STEP * (left - right), STEP * (up - down));
    if turn != 0.0 || rise != 0.0 {
        let pole = document.base().lighting.up;
        let direction = nudged(lamp.direction, pole, turn, rise);
        move_to(document, editing, lamp, direction);
        document.commit();
    }
}

/// A direction turned about the pole and raised towards it, radians; never quite to the pole, where turning ends.
fn nudged(direction: Vec3, pole: Vec3, turn: f32, rise: f32) -> Vec3 {
    const NEAREST: f32 = 0.02;
    let direction = Quat::from_axis_angle(pole, turn) * direction;
    let Some(flat) = direction.reject_from_normalized(pole).try_normalize() else {
        return direction;
    };
    let height = direction.dot(pole).clamp(-1.0, 1.0).asin() + rise;
    let most = std::f32::consts::FRAC_PI_2 - NEAREST;
    let height = height.clamp(-most, most);
    (height.cos() * flat + height.sin() * pole).normalize_or(direction)
}

/// Radius of a lamp's mark: its area grows with the lamp's flux, up to that of the look's strongest.
pub(super) fn mark_radius(document: &Document, lamp: &Lamp) -> f32 {
    let (base, look) = (document.base(), document.look());
    let strength = |lamp: &Lamp| luminance(base.flux(&look.as_lit(lamp)));
    let most = look.lamps.iter().map(strength);
    let part = strength(lamp) / most.fold(f32::MIN_POSITIVE, f32::max);
    MARKS[1] + (MARKS[0] - MARKS[1]) * part.clamp(0.0, 1.0).sqrt()
}

/// How a lamp's mark is drawn.
#[expect(clippy::struct_excessive_bools, reason = "each stands alone")]
#[derive(Clone, Copy)]
pub(super) struct MarkStyle {
    /// In points.
    pub(super) radius: f32,
    pub(super) selected: bool,
    pub(super) lit: bool,
    /// An outline only: the lamp is dark, or not where the mark is.
    pub(super) hollow: bool,
    pub(super) faint: bool,
}

/// Draws a lamp's mark: a disc of its hue in a dark ring, which light and white backgrounds both leave visible.
pub(super) fn draw_mark(painter: &egui::Painter, at: Pos2, hue: Color32, style: MarkStyle) {
    let larger = if style.lit || style.selected {
        1.5
    } else {
        0.0
    };
    let radius = style.radius + larger;
    let strength = if style.faint { 0.55 } else { 1.0 };
    painter.circle_stroke(
        at,
        radius + 1.0,
        Stroke::new(2.5, Color32::from_black_alpha(170)),
    );
    if style.hollow {
        painter.circle_stroke(at, radius, Stroke::new(2.0, hue.gamma_multiply(strength)));
    } else {
        painter.circle_filled(at, radius, hue.gamma_multiply(strength));
    }
    if style.selected || style.lit {
        let width = if style.selected { 1.8 } else { 1.0 };
        painter.circle_stroke(at, radius + 3.0, Stroke::new(width, Color32::WHITE));
    }
}

/// The radiance of lamps and stray light on the nodes of the estimate. Light below the horizon is not on it.
fn on_grid(grid: &HemisphereGrid, lighting: &Lighting) -> Vec<[f32; 3]> {
    let mut radiance = vec![Vec3::ZERO; grid.directions.len()];
    let mut put = |node: &LightNode| {
        if let Some(nearest) = grid.nearest(node.direction) {
            radiance[nearest] += node.flux() / grid.solid_angle;
        }
    };
    let lamps: Vec<&LampNodes> = lighting.lamps.iter().filter(|l| !l.muted).collect();
    lamps.iter().flat_map(|l| &l.nodes).for_each(&mut put);
    lighting.remainder.iter().for_each(&mut put);
    radiance.into_iter().map(|r| r.to_array()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_studio::fixtures::solution;

    #[test]
    fn the_disc_shows_all_light_above_the_horizon() {
        let solution = solution();
        let mut lighting = solution.lighting();
        let total = |l: &Lighting| {
            let nodes = on_grid(&solution.grid, l).into_iter().map(Vec3::from);
            nodes.sum::<Vec3>() * solution.grid.solid_angle
        };
        let flux: Vec3 = lighting.lamps.iter().map(LampNodes::flux).sum();
        let stray: Vec3 = lighting.remainder.iter().map(LightNode::flux).sum();
        assert!((total(&lighting) - flux - stray).length() < 1e-3 * flux.length());
        lighting.lamps[0].muted = true;
        let without = total(&lighting);
        lighting.lamps[1].turn_towards(Vec3::NEG_Y);
        assert!(total(&lighting).length() < without.length());
    }

    #[test]
    fn keys_move_a_lamp_round_and_up() {
        let direction = Vec3::new(0.6, 0.64, 0.48);
        let there = nudged(direction, Vec3::Y, 0.1, 0.0);
        assert!((there.y - direction.y).abs() < 1e-6);
        assert!((there.angle_between(direction) - 0.1 * 0.768_37).abs() < 1e-3);
        let up = nudged(direction, Vec3::Y, 0.0, 0.1);
        assert!((up.y.asin() - direction.y.asin() - 0.1).abs() < 1e-4);
        let top = nudged(direction, Vec3::Y, 0.0, 9.0);
        assert!(top.y > 0.999 && top.y < 1.0);
    }

    #[test]
    fn a_lamp_below_the_horizon_has_its_mark_on_the_rim() {
        let disc = Disc {
            rect: egui::Rect::from_min_size(Pos2::ZERO, vec2(200.0, 200.0)),
            up: Vec3::Y,
        };
        let (at, above) = place(&disc, Vec3::new(0.6, -0.8, 0.0));
        assert!(!above && at.distance(egui::pos2(200.0, 100.0)) < 1e-3);
        let (at, _) = place(&disc, Vec3::NEG_Y);
        assert!((at.distance(disc.rect.center()) - 100.0).abs() < 1e-3);
    }
}
