//! Panels of curves as SVG, all in one style.

use rekindle_base::staging::MAKER;
use std::io;
use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::prelude::*;

/// Of curves, in turn; told apart also by those who see fewer colours (Okabe and Ito 2008).
const COLOURS: [RGBColor; 5] = [
    RGBColor(0, 114, 178),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(0, 0, 0),
];
/// Height of the legend above all panels, and the room that a letter in it takes; pixels.
const LEGEND: u32 = 28;
const LETTER: i32 = 7;
/// Most marks on an axis of decades.
const MOST_DECADES: i32 = 6;

/// A picture in the making.
pub struct Panel {
    /// Above it.
    pub caption: String,
    /// To the right.
    pub x: Axis,
    /// Upward.
    pub y: Axis,
    /// In turn in the colours; those of all panels of a picture have the same names.
    pub curves: Vec<Curve>,
}

/// What is drawn along a side, with its name.
pub enum Axis {
    /// A logarithm from one whole power of ten to another.
    Decades(String),
    /// A logarithm with marks at these values, which ascend.
    Values(String, Vec<f64>),
    /// Places 0, 1, 2 …, each with a name.
    Places(String, Vec<String>),
    /// From minus to plus this, zero in the middle; what lies beyond is drawn at the edge.
    AroundZero(String, f64),
    /// From the least to the greatest value, with round numbers between.
    Linear(String),
}

/// Points joined by lines.
pub struct Curve {
    /// In the picture's legend; there is none without names.
    pub name: String,
    /// From left to right.
    pub points: Vec<Dot>,
}

/// A point of a curve.
#[derive(Clone, Copy)]
pub struct Dot {
    /// To the right.
    pub x: f64,
    /// Upward.
    pub y: f64,
    /// An upright bar through it, from the lower to the higher end.
    pub interval: Option<[f64; 2]>,
}

impl Dot {
    /// A point without a bar.
    pub fn new(x: f64, y: f64) -> Self {
        Self {
            x,
            y,
            interval: None,
        }
    }
}

/// Draws panels side by side, row by row, up to `columns` in a row; `size` is that of each in pixels.
pub fn draw(panels: &[Panel], columns: usize, size: [u32; 2]) -> io::Result<String> {
    let columns = columns.min(panels.len()).max(1);
    let rows = panels.len().div_ceil(columns);
    let legend = LEGEND * u32::from(!legend_of(panels).is_empty());
    let whole = (columns as u32 * size[0], rows as u32 * size[1] + legend);
    let mut svg = String::new();
    draw_all(&mut svg, panels, (rows, columns), whole)
        .map_err(|error| io::Error::other(error.to_string()))?;
    // Who made it, by which it may be replaced.
    Ok(svg.replacen('>', &format!("><desc>{MAKER}</desc>"), 1))
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), DrawingAreaErrorKind<io::Error>>;

fn draw_all(svg: &mut String, panels: &[Panel], split: (usize, usize), size: (u32, u32)) -> Drawn {
    let root = SVGBackend::with_string(svg, size).into_drawing_area();
    root.fill(&WHITE)?;
    let legend = legend_of(panels);
    let below = if legend.is_empty() {
        root.clone()
    } else {
        let (strip, below) = root.split_vertically(LEGEND);
        draw_legend(&strip, &legend)?;
        below
    };
    for (area, panel) in below.split_evenly(split).iter().zip(panels) {
        panel.draw(area)?;
    }
    root.present()
}

/// Names of the curves, the same in all panels; none where they have none.
fn legend_of(panels: &[Panel]) -> Vec<&str> {
    let curves = panels.first().map_or(&[][..], |panel| &panel.curves);
    let names = curves.iter().map(|curve| curve.name.as_str());
    names.filter(|name| !name.is_empty()).collect()
}

/// A line above all panels, so that it covers no curve.
fn draw_legend(strip: &Area<'_>, names: &[&str]) -> Drawn {
    let middle = LEGEND as i32 / 2 + 2;
    let mut x = 16;
    for (name, colour) in names.iter().zip(COLOURS.into_iter().cycle()) {
        let line = [(x, middle), (x + 18, middle)];
        strip.draw(&PathElement::new(line, colour.stroke_width(2)))?;
        strip.draw(&Text::new(
            (*name).to_owned(),
            (x + 24, middle - 7),
            ("sans-serif", 13),
        ))?;
        x += 48 + LETTER * name.chars().count() as i32;
    }
    Ok(())
}

impl Panel {
    fn draw(&self, area: &Area<'_>) -> Drawn {
        let points = || self.curves.iter().flat_map(|curve| &curve.points);
        let x = self.x.ruler(points().map(|p| p.x));
        let y = self.y.ruler(points().map(|p| p.y));
        let mut chart = ChartBuilder::on(area)
            .caption(&self.caption, ("sans-serif", 16))
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(58)
            .build_cartesian_2d(x.clone(), y.clone())?;
        chart
            .configure_mesh()
            .x_desc(self.x.name())
            .x_label_formatter(&|v| x.label(*v))
            .y_desc(self.y.name())
            .y_label_formatter(&|v| y.label(*v))
            .draw()?;
        for (curve, colour) in self.curves.iter().zip(COLOURS.into_iter().cycle()) {
            let style = colour.stroke_width(2);
            // What is not a number breaks the curve.
            let gap = |p: &Dot| !(p.x.is_finite() && p.y.is_finite());
            for stretch in curve.points.split(gap) {
                let line = stretch.iter().map(|p| (p.x, p.y));
                chart.draw_series(LineSeries::new(line, style).point_size(2))?;
            }
            let bars = curve.points.iter().filter_map(|p| {
                let [low, high] = p.interval?;
                let ends = [low, high].map(|end| (p.x, end));
                Some(PathElement::new(ends, colour.mix(0.5).stroke_width(5)))
            });
            chart.draw_series(bars)?;
        }
        Ok(())
    }
}

/// An axis for given values: what is drawn where.
#[derive(Clone)]
struct Ruler {
    logarithmic: bool,
    /// Ends, after the logarithm if there is one.
    ends: Range<f64>,
    /// Places, after the logarithm if there is one, and what is written there.
    marks: Vec<(f64, String)>,
}

impl Ranged for Ruler {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    /// What lies beyond the ends is drawn at them.
    fn map(&self, value: &f64, (first, last): (i32, i32)) -> i32 {
        let place = self.place(*value).clamp(self.ends.start, self.ends.end);
        let part = (place - self.ends.start) / (self.ends.end - self.ends.start);
        first + (part * f64::from(last - first)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.marks.iter().map(|(at, _)| self.value(*at)).collect()
    }

    fn range(&self) -> Range<f64> {
        self.value(self.ends.start)..self.value(self.ends.end)
    }
}

impl Ruler {
    fn place(&self, value: f64) -> f64 {
        if self.logarithmic {
            value.max(f64::MIN_POSITIVE).log10()
        } else {
            value
        }
    }

    fn value(&self, place: f64) -> f64 {
        if self.logarithmic {
            10.0_f64.powf(place)
        } else {
            place
        }
    }

    /// What is written at a marked value.
    fn label(&self, value: f64) -> String {
        let place = self.place(value);
        let mark = self.marks.iter().find(|(at, _)| (at - place).abs() < 1e-9);
        mark.map_or_else(String::new, |(_, label)| label.clone())
    }
}

impl Axis {
    fn name(&self) -> &str {
        match self {
            Self::Decades(name)
            | Self::Values(name, _)
            | Self::Places(name, _)
            | Self::AroundZero(name, _)
            | Self::Linear(name) => name,
        }
    }

    fn ruler(&self, drawn: impl Iterator<Item = f64>) -> Ruler {
        match self {
            Self::Decades(_) => decades(drawn),
            Self::Linear(_) => linear(drawn),
            Self::Values(_, values) => {
                let marks: Vec<(f64, String)> =
                    values.iter().map(|v| (v.log10(), number(*v))).collect();
                let first = marks.first().map_or(0.0, |(at, _)| *at);
                let last = marks.last().map_or(1.0, |(at, _)| *at);
                let margin = (0.05 * (last - first)).max(0.05);
                Ruler {
                    logarithmic: true,
                    ends: first - margin..last + margin,
                    marks,
                }
            }
            Self::Places(_, names) => Ruler {
                logarithmic: false,
                ends: -0.5..names.len() as f64 - 0.5,
                marks: (0..names.len())
                    .map(|i| (i as f64, names[i].clone()))
                    .collect(),
            },
            Self::AroundZero(_, limit) => Ruler {
                logarithmic: false,
                ends: -limit..*limit,
                marks: [-1.0, -0.5, 0.0, 0.5, 1.0]
                    .map(|part| (part * limit, number(part * limit)))
                    .to_vec(),
            },
        }
    }
}

/// Whole powers of ten around the values.
fn decades(values: impl Iterator<Item = f64>) -> Ruler {
    let values: Vec<f64> = values.filter(|v| *v > 0.0 && v.is_finite()).collect();
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = values.iter().copied().fold(0.0, f64::max);
    let (from, to) = if values.is_empty() {
        (-1, 0)
    } else {
        (least.log10().floor() as i32, most.log10().ceil() as i32)
    };
    let to = to.max(from + 1);
    let step = (to - from).div_euclid(MOST_DECADES) + 1;
    let marks = (from..=to).step_by(step as usize);
    Ruler {
        logarithmic: true,
        ends: f64::from(from)..f64::from(to),
        marks: marks
            .map(|k| (f64::from(k), number(10.0_f64.powi(k))))
            .collect(),
    }
}

/// Round numbers around the values.
fn linear(values: impl Iterator<Item = f64>) -> Ruler {
    /// Marks at most.
    const MOST: f64 = 6.0;
    let values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (least, most) = if values.is_empty() {
        (0.0, 1.0)
    } else {
        // Without any extent it is drawn in the middle.
        let margin = (0.04 * (most - least)).max(1e-6 * most.abs()).max(1e-12);
        (least - margin, most + margin)
    };
    let rough = (most - least) / MOST;
    let power = 10.0_f64.powf(rough.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    let step = steps.into_iter().find(|s| *s >= rough).unwrap_or(rough);
    let marks = (least / step).ceil() as i64..=(most / step).floor() as i64;
    let digits = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    Ruler {
        logarithmic: false,
        ends: least..most,
        marks: marks
            .map(|k| k as f64 * step)
            .map(|value| (value, format!("{value:.digits$}")))
            .collect(),
    }
}

/// A number in few characters.
pub(crate) fn number(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) {
        format!("{value:.0e}")
    } else {
        // Three digits are enough for a mark; zeros behind them go.
        let rounded = format!("{value:.3}");
        let short = rounded.trim_end_matches('0').trim_end_matches('.');
        short.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decades_hold_all_values_between_whole_powers() {
        let ruler = decades([0.03, 0.0, 7.0].into_iter());
        assert_eq!(ruler.ends, -2.0..1.0);
        assert_eq!(ruler.label(1.0), "1");
        assert_eq!(ruler.map(&1.0, (0, 300)), 200);
        assert_eq!(ruler.map(&0.0, (0, 300)), 0, "zero is drawn at the edge");
        let long = decades([1e-9, 1e9].into_iter());
        assert!(long.marks.len() <= 7, "{}", long.marks.len());
    }

    #[test]
    fn linear_axes_have_round_numbers() {
        let ruler = linear([0.071, f64::NAN, 0.0745].into_iter());
        let marks: Vec<&str> = ruler
            .marks
            .iter()
            .map(|(_, label)| label.as_str())
            .collect();
        assert_eq!(marks, ["0.071", "0.072", "0.073", "0.074"]);
        assert!(ruler.ends.start < 0.071 && ruler.ends.end > 0.0745);
        let one = linear([5.0].into_iter());
        assert_eq!(one.map(&5.0, (0, 100)), 50);
    }

    #[test]
    fn numbers_are_short() {
        let words = [0.0, 0.075, -2.5, 24.0, 1e6, 1e-6].map(number);
        assert_eq!(words, ["0", "0.075", "-2.5", "24", "1e6", "1e-6"]);
    }
}
