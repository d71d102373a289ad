//! How everything looks: colours, sizes, spacing, in one place.
//!
//! Greys are neutral, so that they don't tint what is judged beside them. There is one accent, the amber of a lamp; red and
//! yellow are kept for errors and warnings.

use eframe::egui::{
    self, Color32, Context, CornerRadius, FontFamily, FontId, Margin, Stroke, TextStyle, Theme,
    Vec2, style,
};

/// Room between groups of widgets, points.
pub const GAP: f32 = 16.0;
/// Room inside panels, points.
pub const MARGIN: i8 = 12;
/// Height of the buttons that a page is about, points.
pub const TALL: f32 = 32.0;
/// Width of side panels, points.
pub const SIDE: f32 = 288.0;
/// Behind pictures, in both themes: a dark neutral grey.
pub const STAGE: Color32 = Color32::from_rgb(18, 18, 18);
/// On the stage.
pub const ON_STAGE: Color32 = Color32::from_rgb(214, 214, 214);

/// Colours that the two themes have in common by name.
#[derive(Clone, Copy, Debug)]
pub struct Palette {
    /// What is selected, running or to be pressed next.
    pub accent: Color32,
    /// Text on the accent.
    pub on_accent: Color32,
    /// Cards on panels.
    pub card: Color32,
    /// Thin lines.
    pub line: Color32,
    /// All well.
    pub good: Color32,
    /// Worth a thought.
    pub warning: Color32,
    /// Wrong.
    pub error: Color32,
    /// Colours of curves, the accent first.
    pub curves: [Color32; 3],
    /// Text of lesser weight.
    pub weak: Color32,
}

const DARK: Palette = Palette {
    accent: Color32::from_rgb(240, 168, 78),
    on_accent: Color32::from_rgb(28, 20, 8),
    card: Color32::from_rgb(38, 38, 38),
    line: Color32::from_rgb(56, 56, 56),
    good: Color32::from_rgb(122, 186, 122),
    warning: Color32::from_rgb(226, 196, 92),
    error: Color32::from_rgb(236, 112, 99),
    curves: [
        Color32::from_rgb(240, 168, 78),
        Color32::from_rgb(122, 176, 232),
        Color32::from_rgb(122, 186, 122),
    ],
    weak: Color32::from_rgb(148, 148, 148),
};

const LIGHT: Palette = Palette {
    accent: Color32::from_rgb(186, 104, 8),
    on_accent: Color32::from_rgb(255, 252, 246),
    card: Color32::from_rgb(255, 255, 255),
    line: Color32::from_rgb(212, 212, 212),
    good: Color32::from_rgb(42, 122, 52),
    warning: Color32::from_rgb(146, 106, 0),
    error: Color32::from_rgb(188, 42, 32),
    curves: [
        Color32::from_rgb(186, 104, 8),
        Color32::from_rgb(32, 98, 168),
        Color32::from_rgb(42, 122, 52),
    ],
    weak: Color32::from_rgb(98, 98, 98),
};

/// The colours of the theme that a window part has.
pub fn palette(ui: &egui::Ui) -> Palette {
    if ui.visuals().dark_mode { DARK } else { LIGHT }
}

/// Gives a context the look, in both themes.
pub fn install(ctx: &Context) {
    for (theme, palette) in [(Theme::Dark, DARK), (Theme::Light, LIGHT)] {
        ctx.style_mut_of(theme, |style| {
            sizes(style);
            colours(&mut style.visuals, theme == Theme::Dark, palette);
        });
    }
}

fn sizes(style: &mut egui::Style) {
    let proportional = |size| FontId::new(size, FontFamily::Proportional);
    style.text_styles = [
        (TextStyle::Small, proportional(11.5)),
        (TextStyle::Body, proportional(13.5)),
        (TextStyle::Button, proportional(13.5)),
        (TextStyle::Heading, proportional(19.0)),
        (
            TextStyle::Monospace,
            FontId::new(12.5, FontFamily::Monospace),
        ),
    ]
    .into();
    let spacing = &mut style.spacing;
    spacing.item_spacing = Vec2::new(8.0, 6.0);
    spacing.button_padding = Vec2::new(10.0, 4.0);
    spacing.interact_size = Vec2::new(40.0, 24.0);
    spacing.slider_width = 150.0;
    spacing.combo_width = 120.0;
    spacing.menu_width = 260.0;
    spacing.menu_margin = Margin::same(6);
    spacing.window_margin = Margin::same(16);
    spacing.tooltip_width = 320.0;
    style.interaction.tooltip_delay = 0.4;
    style.animation_time = 0.1;
}

fn colours(visuals: &mut egui::Visuals, dark: bool, palette: Palette) {
    let grey = |dark_level: u8, light_level: u8| {
        Color32::from_gray(if dark { dark_level } else { light_level })
    };
    visuals.panel_fill = grey(28, 244);
    visuals.window_fill = grey(34, 250);
    visuals.window_stroke = Stroke::new(1.0, palette.line);
    visuals.extreme_bg_color = grey(18, 255);
    visuals.faint_bg_color = grey(33, 238);
    visuals.weak_text_color = Some(palette.weak);
    visuals.warn_fg_color = palette.warning;
    visuals.error_fg_color = palette.error;
    visuals.hyperlink_color = palette.accent;
    visuals.slider_trailing_fill = true;
    visuals.handle_shape = style::HandleShape::Circle;
    visuals.selection = style::Selection {
        bg_fill: if dark {
            Color32::from_rgb(122, 82, 32)
        } else {
            Color32::from_rgb(250, 214, 160)
        },
        stroke: Stroke::new(1.0, grey(250, 20)),
    };
    let widgets = &mut visuals.widgets;
    widgets.noninteractive.bg_stroke = Stroke::new(1.0, palette.line);
    widgets.noninteractive.fg_stroke = Stroke::new(1.0, grey(206, 48));
    widgets.inactive.weak_bg_fill = grey(48, 228);
    widgets.inactive.bg_fill = grey(60, 216);
    widgets.inactive.fg_stroke = Stroke::new(1.0, grey(222, 36));
    widgets.hovered.weak_bg_fill = grey(60, 218);
    widgets.hovered.bg_fill = grey(72, 206);
    widgets.hovered.bg_stroke = Stroke::new(1.0, palette.accent.gamma_multiply(0.7));
    widgets.active.weak_bg_fill = grey(40, 206);
    widgets.active.bg_stroke = Stroke::new(1.0, palette.accent);
    for widget in [
        &mut widgets.noninteractive,
        &mut widgets.inactive,
        &mut widgets.hovered,
        &mut widgets.active,
        &mut widgets.open,
    ] {
        widget.corner_radius = CornerRadius::same(5);
        widget.expansion = 0.0;
    }
}

/// The button that a page is about.
pub fn main_button<'a>(ui: &egui::Ui, text: &'a str) -> egui::Button<'a> {
    let palette = palette(ui);
    egui::Button::new(egui::RichText::new(text).color(palette.on_accent).strong())
        .fill(palette.accent)
        .min_size(Vec2::new(0.0, TALL))
}

/// A card on a panel.
pub fn card(ui: &egui::Ui) -> egui::Frame {
    let palette = palette(ui);
    egui::Frame::new()
        .fill(palette.card)
        .stroke(Stroke::new(1.0, palette.line))
        .corner_radius(CornerRadius::same(8))
        .inner_margin(Margin::same(MARGIN))
}

/// The frame of dialogs.
pub fn dialog(ctx: &Context) -> egui::Frame {
    egui::Frame::popup(&ctx.global_style()).inner_margin(Margin::same(20))
}

/// The frame of side panels.
pub fn side(ui: &egui::Ui) -> egui::Frame {
    egui::Frame::new()
        .fill(ui.visuals().panel_fill)
        .inner_margin(Margin::same(MARGIN))
}

/// The frame behind pictures.
pub fn stage() -> egui::Frame {
    egui::Frame::new().fill(STAGE)
}

/// The marks of messages and findings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// All well.
    Good,
    /// To know.
    Note,
    /// Worth a thought.
    Warning,
    /// Wrong.
    Error,
}

impl Mark {
    /// Its colour.
    pub fn colour(self, ui: &egui::Ui) -> Color32 {
        let palette = palette(ui);
        match self {
            Self::Good => palette.good,
            Self::Note => palette.curves[1],
            Self::Warning => palette.warning,
            Self::Error => palette.error,
        }
    }

    /// Draws it: a disc with a tick, an i, an exclamation mark or a cross, whatever the fonts hold.
    pub fn show(self, ui: &mut egui::Ui) -> egui::Response {
        let (rect, response) = ui.allocate_exact_size(Vec2::splat(18.0), egui::Sense::hover());
        let painter = ui.painter_at(rect);
        let middle = rect.center();
        let colour = self.colour(ui);
        painter.circle_filled(middle, 8.0, colour.gamma_multiply(0.22));
        let stroke = Stroke::new(1.8, colour);
        let line = |a: [f32; 2], b: [f32; 2]| {
            painter.line_segment([middle + Vec2::from(a), middle + Vec2::from(b)], stroke);
        };
        match self {
            Self::Good => {
                line([-3.6, 0.2], [-1.0, 3.0]);
                line([-1.0, 3.0], [3.8, -3.0]);
            }
            Self::Note => {
                painter.circle_filled(middle - Vec2::new(0.0, 3.6), 1.2, colour);
                line([0.0, -0.8], [0.0, 4.0]);
            }
            Self::Warning => {
                line([0.0, -4.2], [0.0, 1.0]);
                painter.circle_filled(middle + Vec2::new(0.0, 3.8), 1.2, colour);
            }
            Self::Error => {
                line([-3.0, -3.0], [3.0, 3.0]);
                line([-3.0, 3.0], [3.0, -3.0]);
            }
        }
        response
    }
}

/// A small button with a cross, called `name`.
pub fn close_button(ui: &mut egui::Ui, name: &str, tip: &str) -> egui::Response {
    let (rect, response) = ui.allocate_exact_size(Vec2::splat(20.0), egui::Sense::click());
    let visuals = ui.style().interact(&response);
    if response.hovered() || response.has_focus() {
        ui.painter()
            .rect_filled(rect, CornerRadius::same(4), visuals.weak_bg_fill);
    }
    let stroke = Stroke::new(1.4, visuals.fg_stroke.color);
    let inner = rect.shrink(6.0);
    ui.painter()
        .line_segment([inner.left_top(), inner.right_bottom()], stroke);
    ui.painter()
        .line_segment([inner.right_top(), inner.left_bottom()], stroke);
    let label = name.to_owned();
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, label.clone()));
    response.on_hover_text(tip)
}

/// A heading over a group of widgets.
pub fn group(ui: &mut egui::Ui, text: &str) -> egui::Response {
    ui.label(
        egui::RichText::new(text)
            .strong()
            .color(ui.visuals().widgets.inactive.fg_stroke.color),
    )
}
