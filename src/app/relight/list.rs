//! The list of lamps and groups.

use eframe::egui::{
    self, Align, Align2, Button, CornerRadius, Layout, RichText, Sense, Stroke, vec2,
};

use super::editing::{Editing, Item, hue, with_lamp};
use super::lamps;
use super::whereabouts::Viewer;
use crate::app::theme;
use rekindle_relight::luminance;
use rekindle_studio::{Baseline, Document, Group, GroupId, Lamp, LampId, Look};

/// By how much the lamps of a group stand in, points.
const INDENT: f32 = 14.0;
/// Room of the buttons at the end of a row, points.
const BUTTONS: f32 = 62.0;

/// What a row asks for.
enum Wish {
    Mute(Item),
    Solo(Item),
    Rename(Item, String),
    Duplicate(LampId),
    Delete(Item),
    Reset(LampId),
    Fold(GroupId),
    Group,
    Ungroup(GroupId),
}

/// A line of the list.
pub(super) enum Line {
    /// A group with its lamps, which follow unless it is folded.
    Group(Group, Vec<LampId>),
    /// A lamp.
    Lamp(Lamp),
}

/// The lines of the look that is shown: those first that send the most light, or would if they were on, and after a group its
/// lamps.
pub(super) fn lines(document: &Document) -> Vec<Line> {
    let (base, look) = (document.base(), document.look());
    let strength = |lamp: &Lamp| luminance(base.flux(&look.as_lit(lamp)));
    let mut lamps: Vec<(f32, &Lamp)> = look.lamps.iter().map(|l| (strength(l), l)).collect();
    lamps.sort_by(|a, b| b.0.total_cmp(&a.0));
    let of = |group: Option<GroupId>| lamps.iter().filter(move |(_, l)| l.group == group);
    let alone = of(None).map(|(own, lamp)| (*own, vec![Line::Lamp((*lamp).clone())]));
    let groups = look.groups.iter().map(|group| {
        let members = of(Some(group.id));
        let ids = members.clone().map(|(_, l)| l.id).collect();
        let shown = members.clone().filter(|_| !group.folded);
        let mut lines = vec![Line::Group(group.clone(), ids)];
        lines.extend(shown.map(|(_, lamp)| Line::Lamp((*lamp).clone())));
        (members.map(|(own, _)| own).sum(), lines)
    });
    let mut units: Vec<(f32, Vec<Line>)> = alone.chain(groups).collect();
    units.sort_by(|a, b| b.0.total_cmp(&a.0));
    units.into_iter().flat_map(|(_, lines)| lines).collect()
}

/// The lamps that have a line, in the order of the list.
pub(super) fn order(lines: &[Line]) -> Vec<LampId> {
    let lamps = lines.iter().filter_map(|line| match line {
        Line::Lamp(lamp) => Some(lamp.id),
        Line::Group(..) => None,
    });
    lamps.collect()
}

/// Shows the list in the room that is left; it scrolls by itself.
pub(super) fn show(
    ui: &mut egui::Ui,
    document: &mut Document,
    editing: &mut Editing,
    viewer: &Viewer,
) {
    let mut wish = None;
    let lines = lines(document);
    let total = editing.total_light(document);
    let (look, base) = (document.look().clone(), document.base().clone());
    let list = List {
        look: &look,
        base: &base,
        order: order(&lines),
        total: total.max(f32::MIN_POSITIVE),
    };
    let scroll = egui::ScrollArea::vertical().id_salt("lamps");
    scroll.auto_shrink(false).show(ui, |ui| {
        // Room for the scroll bar.
        ui.set_max_width(ui.available_width() - 10.0);
        if lines.is_empty() {
            ui.weak("No lights. Add one above.");
        }
        for line in &lines {
            let row = list.row(line, viewer);
            if let Some(asked) = row.show(ui, &list, editing) {
                wish = Some(asked);
            }
        }
    });
    if let Some(wish) = wish {
        fulfil(wish, document, editing);
    }
}

fn fulfil(wish: Wish, document: &mut Document, editing: &mut Editing) {
    match wish {
        Wish::Mute(Item::Lamp(id)) => lamps::mute(document, &[id]),
        Wish::Mute(Item::Group(id)) => lamps::mute_group(document, id),
        Wish::Solo(Item::Lamp(id)) => lamps::solo(document, &[id]),
        Wish::Solo(Item::Group(id)) => lamps::solo(document, &document.look().members(id)),
        Wish::Rename(Item::Lamp(id), name) => {
            document.edit("Rename light", |s, _| with_lamp(s, id, |l| l.name = name));
        }
        Wish::Rename(Item::Group(id), name) => document.edit("Rename group", |s, _| {
            if let Some(group) = s.look_mut().group_mut(id) {
                group.name = name;
            }
        }),
        Wish::Duplicate(id) => {
            let chosen = editing.with_selected(document.look(), id);
            lamps::duplicate(document, editing, &chosen);
        }
        Wish::Delete(item) => {
            let look = document.look();
            let chosen = match item {
                Item::Lamp(id) => editing.with_selected(look, id),
                Item::Group(id) => look.members(id),
            };
            lamps::delete(document, editing, &chosen);
        }
        Wish::Reset(id) => {
            let chosen = editing.with_selected(document.look(), id);
            lamps::reset(document, &chosen);
        }
        Wish::Fold(id) => lamps::fold(document, id),
        Wish::Group => lamps::group(document, editing),
        Wish::Ungroup(id) => lamps::ungroup(document, &[id]),
    }
}

/// What the rows of a list have in common.
struct List<'a> {
    look: &'a Look,
    base: &'a Baseline,
    /// Lamps in the order of the rows.
    order: Vec<LampId>,
    /// Luminance of all light.
    total: f32,
}

impl List<'_> {
    /// Part of all light that lamps send.
    fn share(&self, lamps: &[LampId]) -> f32 {
        let lamps = lamps.iter().filter_map(|id| self.look.lamp(*id));
        let shining = lamps.filter(|l| !self.look.is_dark(l));
        let flux = shining.map(|l| luminance(self.base.flux(&self.look.as_lit(l))));
        flux.sum::<f32>() / self.total
    }

    fn row<'a>(&self, line: &'a Line, viewer: &Viewer) -> Row<'a> {
        match line {
            Line::Lamp(lamp) => Row {
                item: Item::Lamp(lamp.id),
                name: &lamp.name,
                kind: Kind::Lamp(lamp),
                dark: self.look.is_dark(lamp),
                muted: lamp.muted,
                solo: self.look.solo.contains(&lamp.id),
                share: self.share(&[lamp.id]),
                place: viewer.words(lamp.direction),
            },
            Line::Group(group, lamps) => Row {
                item: Item::Group(group.id),
                name: &group.name,
                kind: Kind::Group(group),
                dark: self.share(lamps) == 0.0,
                muted: group.muted,
                solo: lamps::is_solo(self.look, lamps),
                share: self.share(lamps),
                place: match lamps.len() {
                    1 => "1 light".to_owned(),
                    several => format!("{several} lights"),
                },
            },
        }
    }
}

/// A row of the list.
struct Row<'a> {
    item: Item,
    name: &'a str,
    kind: Kind<'a>,
    dark: bool,
    muted: bool,
    solo: bool,
    /// Part of all light that it sends.
    share: f32,
    /// Where it is, in words; of a group, how much is in it.
    place: String,
}

#[derive(Clone, Copy)]
enum Kind<'a> {
    Lamp(&'a Lamp),
    Group(&'a Group),
}

impl Row<'_> {
    fn show(&self, ui: &mut egui::Ui, list: &List<'_>, editing: &mut Editing) -> Option<Wish> {
        let mut wish = None;
        ui.horizontal(|ui| {
            match self.kind {
                Kind::Lamp(lamp) => {
                    if lamp.group.is_some() {
                        ui.add_space(INDENT);
                    }
                    swatch(ui, list.base, lamp, self.dark);
                }
                Kind::Group(group) => {
                    if fold_button(ui, group) {
                        wish = Some(Wish::Fold(group.id));
                    }
                }
            }
            let width = (ui.available_width() - BUTTONS).max(40.0);
            let own = editing.renaming.take_if(|(item, _)| *item == self.item);
            let asked = match own {
                Some((_, text)) => self.rename_ui(ui, width, text, editing),
                None => self.name_ui(ui, width, list, editing),
            };
            let pressed = self.buttons_ui(ui);
            wish = wish.take().or(asked).or(pressed);
        });
        wish
    }

    /// A field for another name.
    fn rename_ui(
        &self,
        ui: &mut egui::Ui,
        width: f32,
        mut text: String,
        editing: &mut Editing,
    ) -> Option<Wish> {
        let field = egui::TextEdit::singleline(&mut text).desired_width(width - 16.0);
        let what = match self.item {
            Item::Lamp(_) => "Name of the light",
            Item::Group(_) => "Name of the group",
        };
        let field = ui.add(field).accessible_name(what);
        field.request_focus();
        let enter = ui.input(|i| i.key_pressed(egui::Key::Enter));
        let escape = ui.input(|i| i.key_pressed(egui::Key::Escape));
        if enter || field.clicked_elsewhere() {
            let name = text.trim();
            let other = !name.is_empty() && name != self.name;
            return other.then(|| Wish::Rename(self.item, name.to_owned()));
        }
        if !escape {
            editing.renaming = Some((self.item, text));
        }
        None
    }

    fn buttons_ui(&self, ui: &mut egui::Ui) -> Option<Wish> {
        let (of_solo, of_mute) = match self.item {
            Item::Lamp(_) => (
                "Leave only this light and the ambient light on (S)",
                "Switch this light off or on (M)",
            ),
            Item::Group(_) => (
                "Leave only this group's lights and the ambient light on",
                "Switch this group off or on",
            ),
        };
        let right = Layout::right_to_left(Align::Center);
        let pressed = ui.with_layout(right, |ui| {
            ui.spacing_mut().item_spacing.x = 4.0;
            ui.spacing_mut().button_padding.x = 7.0;
            let name = format!("Solo {}", self.name);
            let solo = toggle(ui, self.solo, "S", &name, of_solo);
            let name = format!("Mute {}", self.name);
            let mute = toggle(ui, self.muted, "M", &name, of_mute);
            (solo, mute)
        });
        match pressed.inner {
            (true, _) => Some(Wish::Solo(self.item)),
            (_, true) => Some(Wish::Mute(self.item)),
            _ => None,
        }
    }

    /// Name, place and share of all light, to be clicked.
    fn name_ui(
        &self,
        ui: &mut egui::Ui,
        width: f32,
        list: &List<'_>,
        editing: &mut Editing,
    ) -> Option<Wish> {
        let height = ui.spacing().interact_size.y;
        let (rect, response) = ui.allocate_exact_size(vec2(width, height), Sense::click());
        let selected = match self.item {
            Item::Lamp(id) => editing.is_selected(id),
            Item::Group(id) => editing.group(list.look).is_some_and(|g| g.id == id),
        };
        response.widget_info(|| {
            egui::WidgetInfo::selected(egui::Role::Button, true, selected, self.name)
        });
        let share = format!("{:.0} %", 100.0 * self.share);
        let described = format!("{}, {share} of the light", self.place);
        ui.ctx()
            .accesskit_node_builder(response.id, |node| node.set_description(described.clone()));
        self.paint(ui, rect, &response, selected, &share);
        if let Item::Lamp(id) = self.item {
            if selected && editing.scroll_to.take_if(|to| *to == id).is_some() {
                response.scroll_to_me(None);
            }
            if response.hovered() {
                editing.hovered = Some(id);
            }
        }
        if response.double_clicked() {
            editing.renaming = Some((self.item, self.name.to_owned()));
        } else if response.clicked() {
            match self.item {
                Item::Lamp(id) => editing.press(id, ui.input(|i| i.modifiers), &list.order),
                Item::Group(id) => editing.select_group(list.look, id),
            }
        }
        let hint = match self.item {
            Item::Lamp(_) => {
                "Click to select, with Ctrl or Shift several; double-click to rename, right-click for more"
            }
            Item::Group(_) => {
                "Click to set its lights together, double-click to rename, right-click for more"
            }
        };
        let tip = format!("{}: {described}\n{hint}", self.name);
        let mut wish = None;
        response
            .on_hover_text(tip)
            .context_menu(|ui| wish = self.menu_ui(ui, list, editing));
        wish
    }

    fn menu_ui(&self, ui: &mut egui::Ui, list: &List<'_>, editing: &mut Editing) -> Option<Wish> {
        let mut wish = None;
        let chosen = |ui: &mut egui::Ui, name: &str| {
            let clicked = ui.button(name).clicked();
            if clicked {
                ui.close();
            }
            clicked
        };
        if chosen(ui, "Rename") {
            editing.renaming = Some((self.item, self.name.to_owned()));
        }
        match self.item {
            Item::Lamp(id) => {
                if chosen(ui, "Duplicate") {
                    wish = Some(Wish::Duplicate(id));
                }
                if chosen(ui, "Reset") {
                    wish = Some(Wish::Reset(id));
                }
                let several = editing.is_selected(id) && editing.selection(list.look).len() > 1;
                if several && chosen(ui, "Group") {
                    wish = Some(Wish::Group);
                }
                if chosen(ui, "Delete") {
                    wish = Some(Wish::Delete(self.item));
                }
            }
            Item::Group(id) => {
                if chosen(ui, "Ungroup") {
                    wish = Some(Wish::Ungroup(id));
                }
                if chosen(ui, "Delete with its lights") {
                    wish = Some(Wish::Delete(self.item));
                }
            }
        }
        wish
    }

    fn paint(
        &self,
        ui: &egui::Ui,
        rect: egui::Rect,
        response: &egui::Response,
        selected: bool,
        share: &str,
    ) {
        const BAR: f32 = 2.0;
        let palette = theme::palette(ui);
        let visuals = ui.style().interact_selectable(response, selected);
        let painter = ui.painter_at(rect);
        if selected || response.hovered() || response.has_focus() {
            painter.rect_filled(rect, visuals.corner_radius, visuals.weak_bg_fill);
        }
        let text = if self.dark {
            palette.weak
        } else {
            visuals.text_color()
        };
        let small = egui::TextStyle::Small.resolve(ui.style());
        let right = rect.right_center() - vec2(6.0, 1.0);
        let share = if self.dark { "off" } else { share };
        let share = painter.text(right, Align2::RIGHT_CENTER, share, small, palette.weak);
        let left = rect.left_center() + vec2(6.0, -1.0);
        let end = share.left() - 6.0;
        let short = |text: &str, style: egui::TextStyle, from: f32| {
            let text = egui::WidgetText::from(text);
            let mode = Some(egui::TextWrapMode::Truncate);
            text.into_galley(ui, mode, (end - from).max(0.0), style)
        };
        let name = short(self.name, egui::TextStyle::Button, left.x);
        let after = egui::pos2(left.x + name.size().x + 8.0, left.y);
        let up = |galley: &egui::Galley| vec2(0.0, -0.5 * galley.size().y);
        painter.galley(left + up(&name), name, text);
        if after.x < end {
            let place = short(&self.place, egui::TextStyle::Small, after.x);
            painter.galley(after + up(&place), place, palette.weak);
        }
        let foot = rect.left_bottom() - vec2(0.0, BAR);
        let part = vec2(rect.width() * self.share.clamp(0.0, 1.0), BAR);
        painter.rect_filled(egui::Rect::from_min_size(foot, part), 1.0, palette.accent);
    }
}

/// A square of the lamp's hue; an outline where the lamp is dark.
fn swatch(ui: &mut egui::Ui, base: &Baseline, lamp: &Lamp, dark: bool) {
    let (rect, _) = ui.allocate_exact_size(vec2(14.0, 14.0), Sense::hover());
    let hue = hue(base, lamp);
    let corner = CornerRadius::same(3);
    if dark {
        let inside = egui::StrokeKind::Inside;
        ui.painter()
            .rect_stroke(rect, corner, Stroke::new(2.0, hue), inside);
    } else {
        ui.painter().rect_filled(rect, corner, hue);
    }
    // White shows on a white panel, too.
    let line = Stroke::new(1.0, theme::palette(ui).line);
    let outside = egui::StrokeKind::Outside;
    ui.painter().rect_stroke(rect, corner, line, outside);
}

/// The triangle that folds a group; whether it was pressed.
fn fold_button(ui: &mut egui::Ui, group: &Group) -> bool {
    let (verb, tip) = if group.folded {
        ("Unfold", "Show its lights in the list")
    } else {
        ("Fold", "Hide its lights from the list")
    };
    let (rect, response) = ui.allocate_exact_size(vec2(14.0, 14.0), Sense::click());
    let openness = if group.folded { 0.0 } else { 1.0 };
    egui::collapsing_header::paint_default_icon(
        ui,
        openness,
        &response.clone().with_new_rect(rect),
    );
    let name = format!("{verb} {}", group.name);
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, &name));
    response.on_hover_text(tip).clicked()
}

fn toggle(ui: &mut egui::Ui, on: bool, letter: &str, name: &str, tip: &str) -> bool {
    let letter = if on {
        RichText::new(letter).strong()
    } else {
        RichText::new(letter).weak()
    };
    let button = ui.add(Button::selectable(on, letter).frame_when_inactive(true));
    button.accessible_name(name).on_hover_text(tip).clicked()
}
