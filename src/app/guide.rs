//! How to shoot a capture: the guide of `docs/shooting.md`, with its drawings, in the window.

use eframe::egui::{self, Align2, Color32, Id, RichText, ScrollArea, Shape, Stroke, pos2, vec2};

use super::theme;

/// The guide's text.
const TEXT: &str = include_str!("../../docs/shooting.md");

/// The guide's drawings, by the names that the text calls them.
const DRAWINGS: [(&str, &str); 5] = [
    ("light", include_str!("../../docs/shooting/light.svg")),
    ("views", include_str!("../../docs/shooting/views.svg")),
    ("brackets", include_str!("../../docs/shooting/brackets.svg")),
    (
        "turntable",
        include_str!("../../docs/shooting/turntable.svg"),
    ),
    ("probe", include_str!("../../docs/shooting/probe.svg")),
];
/// The drawings' second colour, which stands for light.
const LIGHT: &str = "#d9822b";

/// Shows the guide; whether it is to be closed.
pub(super) fn show(ctx: &egui::Context) -> bool {
    let modal = egui::Modal::new(Id::unique("guide"))
        .frame(theme::dialog(ctx))
        .show(ctx, |ui| {
            ui.set_width(640.0_f32.min(ctx.content_rect().width() - 64.0));
            let height = ctx.content_rect().height() - 140.0;
            ScrollArea::vertical()
                .max_height(height)
                .auto_shrink(false)
                .show(ui, |ui| {
                    // Room for the scroll bar.
                    ui.set_max_width(ui.available_width() - 12.0);
                    for block in blocks(TEXT) {
                        block.show(ui);
                    }
                });
            ui.add_space(8.0);
            ui.button("Close").on_hover_text("Back to work").clicked()
        });
    modal.inner || modal.should_close()
}

/// A part of the text.
#[derive(Debug, PartialEq)]
enum Block<'t> {
    Title(&'t str),
    Heading(&'t str),
    Drawing(&'t str),
    Item(String),
    Paragraph(String),
}

/// The blocks of a text, as far as Markdown is used in the guide. Words in stars and backquotes lose these.
fn blocks(text: &str) -> Vec<Block<'_>> {
    let mut blocks: Vec<Block<'_>> = Vec::new();
    let mut goes_on = false;
    for line in text.lines() {
        let plain = || line.trim().replace(['*', '`'], "");
        let drawing = line
            .split_once("](shooting/")
            .and_then(|(_, rest)| rest.split_once('.'));
        let block = match line {
            "" => {
                goes_on = false;
                continue;
            }
            _ if line.starts_with("# ") => Block::Title(&line[2..]),
            _ if line.starts_with("## ") => Block::Heading(&line[3..]),
            _ if line.starts_with("![") => Block::Drawing(drawing.map_or("", |(name, _)| name)),
            _ if line.starts_with("- ") => Block::Item(plain()[2..].to_owned()),
            _ => match blocks.last_mut() {
                Some(Block::Item(before) | Block::Paragraph(before)) if goes_on => {
                    before.push(' ');
                    before.push_str(&plain());
                    continue;
                }
                _ => Block::Paragraph(plain()),
            },
        };
        goes_on = matches!(block, Block::Item(_) | Block::Paragraph(_));
        blocks.push(block);
    }
    blocks
}

impl Block<'_> {
    fn show(&self, ui: &mut egui::Ui) {
        match self {
            Self::Title(text) => {
                ui.heading(*text);
                ui.add_space(6.0);
            }
            Self::Heading(text) => {
                ui.add_space(theme::GAP);
                ui.label(RichText::new(*text).size(16.0).strong());
            }
            Self::Paragraph(text) => {
                ui.label(text);
            }
            Self::Item(text) => {
                ui.horizontal_top(|ui| {
                    ui.weak("•");
                    ui.add(egui::Label::new(text).wrap());
                });
            }
            Self::Drawing(name) => {
                let drawing = DRAWINGS.iter().find(|(known, _)| known == name);
                if let Some((_, svg)) = drawing {
                    draw(ui, svg);
                }
            }
        }
    }
}

/// An element of a drawing, with its attributes as they are written.
struct Element<'s> {
    name: &'s str,
    attributes: &'s str,
    content: &'s str,
}

impl<'s> Element<'s> {
    /// The elements of a drawing that are drawn, in their order.
    fn all(svg: &'s str) -> impl Iterator<Item = Self> {
        svg.split('<').filter_map(|piece| {
            let (tag, content) = piece.split_once('>')?;
            let (name, attributes) = tag.split_once(' ')?;
            (!name.starts_with('/')).then_some(Self {
                name,
                attributes,
                content,
            })
        })
    }

    fn text(&self, key: &str) -> Option<&'s str> {
        let (_, rest) = self.attributes.split_once(&format!("{key}=\""))?;
        rest.split_once('"').map(|(value, _)| value)
    }

    fn number(&self, key: &str) -> Option<f32> {
        self.text(key)?.parse().ok()
    }

    fn point(&self, x: &str, y: &str) -> Option<egui::Pos2> {
        Some(pos2(self.number(x)?, self.number(y)?))
    }

    /// The shape, its points placed by `at`; `None` where it is none.
    fn shape(&self, ui: &egui::Ui, at: &impl Fn(egui::Pos2) -> egui::Pos2) -> Option<Shape> {
        let ink = |key: &str| match self.text(key)? {
            "none" => None,
            LIGHT => Some(theme::palette(ui).accent),
            _ => Some(theme::palette(ui).weak),
        };
        let width = self.number("stroke-width").unwrap_or(1.0);
        let stroke = Stroke::new(width, ink("stroke").unwrap_or(Color32::TRANSPARENT));
        Some(match self.name {
            "line" => {
                let ends = [self.point("x1", "y1")?, self.point("x2", "y2")?];
                Shape::line_segment(ends.map(at), stroke)
            }
            "circle" => {
                let middle = at(self.point("cx", "cy")?);
                let fill = ink("fill").unwrap_or(Color32::TRANSPARENT);
                egui::epaint::CircleShape {
                    center: middle,
                    radius: self.number("r")?,
                    fill,
                    stroke,
                }
                .into()
            }
            "polyline" => {
                let place = |pair: &str| {
                    let (x, y) = pair.split_once(',')?;
                    Some(at(pos2(x.parse().ok()?, y.parse().ok()?)))
                };
                let points: Option<Vec<egui::Pos2>> =
                    self.text("points")?.split(' ').map(place).collect();
                Shape::line(points?, stroke)
            }
            "text" => {
                let font = egui::FontId::proportional(12.0);
                let colour = ink("fill").unwrap_or(Color32::TRANSPARENT);
                let place = at(self.point("x", "y")?);
                let text = self.content.to_owned();
                let galley = ui.painter().layout_no_wrap(text, font, colour);
                let rect = Align2::CENTER_BOTTOM.anchor_size(place, galley.size());
                Shape::galley(rect.min, galley, colour)
            }
            _ => return None,
        })
    }
}

/// Shows a drawing in the theme's colours, at its size.
fn draw(ui: &mut egui::Ui, svg: &str) {
    let mut elements = Element::all(svg).skip_while(|e| e.name != "svg");
    let Some(frame) = elements.next() else { return };
    let size = [frame.number("width"), frame.number("height")].map(|side| side.unwrap_or(0.0));
    let (rect, response) = ui.allocate_exact_size(vec2(size[0], size[1]), egui::Sense::hover());
    let at = |point: egui::Pos2| rect.min + point.to_vec2();
    for element in elements {
        if let Some(shape) = element.shape(ui, &at) {
            ui.painter().add(shape);
        }
    }
    let title = Element::title(svg);
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, title));
}

impl Element<'_> {
    /// What a drawing is called.
    fn title(svg: &str) -> &str {
        let named = svg
            .split_once("<title>")
            .and_then(|(_, rest)| rest.split_once('<'));
        named.map_or("", |(title, _)| title)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_drawing_of_the_guide_is_there_and_every_part_of_it_is_drawn() {
        let named = blocks(TEXT).into_iter().filter_map(|block| match block {
            Block::Drawing(name) => Some(name.to_owned()),
            _ => None,
        });
        let mut named: Vec<String> = named.collect();
        let mut known: Vec<&str> = DRAWINGS.iter().map(|(name, _)| *name).collect();
        named.sort();
        known.sort_unstable();
        assert_eq!(named, known);
        egui::__run_test_ui(|ui| {
            for (name, svg) in DRAWINGS {
                assert!(!Element::title(svg).is_empty(), "{name} has no title");
                for element in Element::all(svg) {
                    let drawn = element.shape(ui, &|point| point).is_some();
                    let frame = ["svg", "title", "?xml"].contains(&element.name);
                    assert!(
                        drawn || frame,
                        "{name}: {} {}",
                        element.name,
                        element.attributes
                    );
                }
            }
        });
    }

    #[test]
    fn lines_of_an_item_are_one_and_marks_of_emphasis_go() {
        let text = "# Title\n\nA *word*\nand more.\n\n## Next\n\n- One `a`\n  two\n- **Three**\n";
        let expected = [
            Block::Title("Title"),
            Block::Paragraph("A word and more.".to_owned()),
            Block::Heading("Next"),
            Block::Item("One a two".to_owned()),
            Block::Item("Three".to_owned()),
        ];
        assert_eq!(blocks(text), expected);
    }
}
