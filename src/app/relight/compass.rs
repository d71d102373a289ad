//! Where the viewer is: a wedge on the hemisphere seen from above, and a compass over the picture of the object.

use eframe::egui::{self, Align2, Color32, FontId, Rect, Sense, Shape, Stroke, pos2, vec2};
use glam::Vec3;

use super::handles::Seen;
use super::lamp_settings::angles;
use crate::app::disc::Disc;
use crate::app::theme;
use rekindle_scene::hemisphere::from_above_axes;
use rekindle_studio::Document;

/// Half the wedge's angle, radians.
const HALF: f32 = 0.16;
/// Radius of the compass, and its distance from the edges of the picture, points.
const RADIUS: f32 = 26.0;
const APART: f32 = 16.0;
/// Below this part of a whole direction the viewer is straight above, and on no side.
const FLAT: f32 = 0.05;

/// A unit direction in words: "south-east, 32° up".
fn in_words(direction: Vec3, up: Vec3) -> String {
    const NAMES: [&str; 8] = [
        "north",
        "north-east",
        "east",
        "south-east",
        "south",
        "south-west",
        "west",
        "north-west",
    ];
    let [right, north] = from_above_axes(up);
    let (height, azimuth) = angles(direction, up, right, north);
    if direction.reject_from_normalized(up).length() < FLAT {
        return "straight above".to_owned();
    }
    let name = NAMES[(azimuth / 45.0).round() as usize % NAMES.len()];
    let side = if height < 0.0 { "below" } else { "up" };
    format!("{name}, {:.0}° {side}", height.abs())
}

/// What is said of where the viewer is, who is in a unit direction from the object.
pub(super) fn told(towards: Vec3, up: Vec3) -> String {
    format!("You look from the {}", in_words(towards, up))
}

/// Draws from which side the viewer looks, as a wedge on the disc.
pub(super) fn wedge(ui: &egui::Ui, disc: &Disc, towards: Vec3) {
    let [right, north] = from_above_axes(disc.up);
    let flat = vec2(towards.dot(right), -towards.dot(north));
    if flat.length() < FLAT {
        return;
    }
    let radius = 0.5 * disc.rect.width();
    let middle = flat.angle();
    let rim = (-4..=4).map(|k| {
        let angle = middle + HALF * k as f32 / 4.0;
        disc.rect.center() + radius * egui::Vec2::angled(angle)
    });
    let corners = std::iter::once(disc.rect.center()).chain(rim).collect();
    let fill = Color32::from_white_alpha(26);
    let line = Stroke::new(1.0, Color32::from_white_alpha(70));
    ui.painter().add(Shape::convex_polygon(corners, fill, line));
}

/// Draws the directions of the disc as the camera sees them, at the lower left of the picture.
pub(super) fn show(ui: &egui::Ui, seen: &Seen, document: &Document, towards: Vec3) {
    let lighting = &document.base().lighting;
    let centre = lighting.centre;
    let Some(origin) = seen.at(centre.as_dvec3()) else {
        return;
    };
    let [right, north] = from_above_axes(lighting.up);
    // Near the object's middle, where perspective bends little.
    let reach = 0.1 * document.solution().mesh.diagonal();
    let arm = |direction: Vec3| {
        let tip = seen.at((centre + reach * direction).as_dvec3())?;
        Some(tip - origin)
    };
    let middle = pos2(
        seen.rect.left() + APART + RADIUS,
        seen.rect.bottom() - APART - RADIUS,
    );
    let rect = Rect::from_center_size(middle, vec2(2.0 * RADIUS, 2.0 * RADIUS));
    let sides = [("N", north), ("E", right), ("S", -north), ("W", -right)];
    let arms: Vec<_> = sides
        .iter()
        .filter_map(|(name, direction)| Some((*name, arm(*direction)?)))
        .collect();
    let longest = arms.iter().map(|(_, arm)| arm.length());
    let scale = (RADIUS - 8.0) / longest.fold(1e-3, f32::max);
    let painter = ui.painter().with_clip_rect(seen.rect);
    painter.circle_filled(middle, RADIUS, Color32::from_black_alpha(110));
    for (name, arm) in arms {
        let tip = middle + scale * arm;
        let north = name == "N";
        let colour = if north {
            theme::palette(ui).accent
        } else {
            theme::ON_STAGE.gamma_multiply(0.6)
        };
        painter.line_segment([middle, tip], Stroke::new(1.0, colour));
        let font = FontId::proportional(10.0);
        painter.text(tip, Align2::CENTER_CENTER, name, font, colour);
    }
    let response = ui.interact(rect, ui.scope_id().with("compass"), Sense::hover());
    let told = told(towards, lighting.up);
    let name = format!("Compass: {}", told.to_lowercase());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, name.clone()));
    response.on_hover_text(format!("{told}. North is at the top of the hemisphere"));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_have_the_names_of_a_compass() {
        let [right, north] = from_above_axes(Vec3::Y);
        for (direction, words) in [
            (north, "north, 0° up"),
            (right, "east, 0° up"),
            (
                -north + right + Vec3::Y * 2.0_f32.sqrt(),
                "south-east, 45° up",
            ),
            (-right - 0.577 * Vec3::Y, "west, 30° below"),
            (Vec3::Y, "straight above"),
        ] {
            let direction = direction.normalize_or_zero();
            assert_eq!(in_words(direction, Vec3::Y), words);
        }
    }
}
