//! How points and marks look, on the mesh and on photographs.

use eframe::egui::{
    self, Align2, Color32, CornerRadius, FontId, Painter, Pos2, Rect, Stroke, vec2,
};

use crate::app::theme;

/// A texture, all of it.
pub(super) const WHOLE: Rect = Rect {
    min: Pos2::ZERO,
    max: Pos2::new(1.0, 1.0),
};

/// How near the pointer takes hold of a mark, points.
const REACH: f32 = 10.0;
/// Radius of a mark, points.
const RADIUS: f32 = 5.5;

/// The mark nearest to a place, within reach; each with whether it is hidden.
pub(super) fn nearest(places: &[(Option<Pos2>, bool)], at: Pos2) -> Option<usize> {
    let visible = places.iter().enumerate().filter(|(_, (_, hidden))| !hidden);
    let distances = visible.filter_map(|(i, (place, _))| Some((i, (*place)?.distance(at))));
    distances
        .filter(|(_, distance)| *distance <= REACH)
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(i, _)| i)
}

/// Draws a mark with its number: a ring with the very place in it.
pub(super) fn paint(
    ui: &egui::Ui,
    painter: &Painter,
    at: Option<Pos2>,
    number: usize,
    selected: bool,
    hidden: bool,
    hovered: bool,
) {
    let Some(at) = at else { return };
    let strength = if hidden { 0.35 } else { 1.0 };
    let colour = if selected {
        theme::palette(ui).accent
    } else {
        theme::ON_STAGE
    };
    let colour = colour.gamma_multiply(strength);
    let radius = if selected || hovered {
        RADIUS + 1.5
    } else {
        RADIUS
    };
    let dark = Color32::from_black_alpha(if hidden { 60 } else { 170 });
    painter.circle_stroke(at, radius, Stroke::new(4.0, dark));
    painter.circle_stroke(at, radius, Stroke::new(1.8, colour));
    painter.circle_filled(at, 2.4, dark);
    painter.circle_filled(at, 1.4, colour);
    let text = (number + 1).to_string();
    let font = FontId::proportional(12.0);
    let galley = painter.layout_no_wrap(text, font, Color32::PLACEHOLDER);
    let pill = Align2::LEFT_BOTTOM
        .anchor_size(at + vec2(radius + 1.0, -radius + 3.0), galley.size())
        .expand2(vec2(4.0, 0.0))
        .translate(vec2(4.0, 0.0));
    painter.rect_filled(pill, CornerRadius::same(6), dark);
    painter.galley(pill.min + vec2(4.0, 0.0), galley, colour);
}

/// Draws where a point is to be expected that is not marked here.
pub(super) fn paint_expected(painter: &Painter, at: Pos2, selected: Option<Color32>) {
    let colour = selected.unwrap_or(theme::ON_STAGE).gamma_multiply(0.7);
    let arm = |from: f32, to: f32, turn: f32| {
        let direction = egui::Vec2::angled(turn);
        let ends = [at + from * direction, at + to * direction];
        painter.line_segment(ends, Stroke::new(3.0, Color32::from_black_alpha(120)));
        painter.line_segment(ends, Stroke::new(1.2, colour));
    };
    for k in 0..4 {
        arm(2.5, 7.0, std::f32::consts::FRAC_PI_2 * k as f32);
    }
}
