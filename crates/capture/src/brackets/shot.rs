//! What a file's EXIF data say of how it was taken.

use exif::{Exif, In, Reader, Tag, Value};
use rekindle_base::files;
use std::io::{BufRead, BufReader, Seek};
use std::path::Path;

/// How much light an exposure let in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Exposure time in seconds.
    pub time: f64,
    /// Aperture number N, if known.
    pub f_number: Option<f64>,
    /// ISO sensitivity, if known.
    pub iso: Option<f64>,
}

impl Settings {
    /// Relative exposure H = t·(ISO/100)/N²; what isn't known counts as ISO 100 and N = 1.
    pub fn amount(&self) -> f64 {
        let stop = self.f_number.unwrap_or(1.0);
        self.time * self.iso.unwrap_or(100.0) / 100.0 / (stop * stop)
    }
}

/// What exposures state all or none, so that they are on one scale: its key in a manifest, its name, and whether it is
/// stated.
pub(super) type Optional = (&'static str, &'static str, fn(&Settings) -> bool);
pub(super) const OPTIONAL: [Optional; 2] = [
    ("f_number", "f-number", |s| s.f_number.is_some()),
    ("iso", "ISO sensitivity", |s| s.iso.is_some()),
];

/// One photograph as its EXIF data describe it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shot {
    /// How it was exposed, if that is stated.
    pub settings: Option<Settings>,
    /// Maker, model and serial number of the body, orientation and focal length: alike within a bracket.
    pub setup: Vec<String>,
    /// When it was taken, seconds since some day.
    pub taken: Option<f64>,
}

impl Shot {
    /// Reads what a file says; a file without EXIF data says nothing.
    pub fn read(path: &Path) -> Self {
        files::open(path).map_or_else(
            |_| Self::default(),
            |file| Self::parse(&mut BufReader::new(file)),
        )
    }

    /// What the bytes of an image file say.
    pub(crate) fn parse(file: &mut (impl BufRead + Seek)) -> Self {
        let mut reader = Reader::new();
        let read = reader.continue_on_error(true).read_from_container(file);
        let exif = read.or_else(|error| error.distill_partial_result(|_| {}));
        exif.map_or_else(|_| Self::default(), |exif| Self::of(&exif))
    }

    fn of(exif: &Exif) -> Self {
        let setup = [
            Tag::Make,
            Tag::Model,
            Tag::BodySerialNumber,
            Tag::Orientation,
            Tag::FocalLength,
        ];
        let field = |tag| exif.get_field(tag, In::PRIMARY);
        let text = |tag| field(tag).map_or_else(String::new, |f| f.display_value().to_string());
        Self {
            settings: settings(exif),
            setup: setup.into_iter().map(text).collect(),
            taken: taken(exif),
        }
    }
}

/// A positive, finite number of a field.
fn positive(exif: &Exif, tag: Tag) -> Option<f64> {
    number(exif, tag).filter(|&v| v > 0.0)
}

fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(v) => v.first()?.to_f64(),
        Value::SRational(v) => v.first()?.to_f64(),
        Value::Short(v) => f64::from(*v.first()?),
        Value::Long(v) => f64::from(*v.first()?),
        _ => return None,
    };
    value.is_finite().then_some(value)
}

fn settings(exif: &Exif) -> Option<Settings> {
    // APEX values state the time as −log₂ and the aperture as 2 log₂; 0/0 stands for unknown.
    let time = positive(exif, Tag::ExposureTime)
        .or_else(|| number(exif, Tag::ShutterSpeedValue).map(|tv| (-tv).exp2()))
        .filter(|&time| (1e-7..1e6).contains(&time))?;
    let f_number = positive(exif, Tag::FNumber)
        .or_else(|| number(exif, Tag::ApertureValue).map(|av| (0.5 * av).exp2()))
        .filter(|f| (1e-3..1e6).contains(f));
    // Sensitivities that 16 bits can't hold are stated as 65535, with the number elsewhere.
    let iso = positive(exif, Tag::PhotographicSensitivity)
        .filter(|&iso| iso < 65_535.0)
        .or_else(|| positive(exif, Tag::RecommendedExposureIndex))
        .or_else(|| positive(exif, Tag::StandardOutputSensitivity))
        .or_else(|| positive(exif, Tag::ISOSpeed));
    Some(Settings {
        time,
        f_number: f_number.filter(|n| (0.1..1e3).contains(n)),
        iso: iso.filter(|iso| (0.1..1e8).contains(iso)),
    })
}

/// Seconds of the time of day, with days long enough to be told apart.
fn taken(exif: &Exif) -> Option<f64> {
    let field = [Tag::DateTimeOriginal, Tag::DateTime]
        .into_iter()
        .find_map(|tag| exif.get_field(tag, In::PRIMARY))?;
    let Value::Ascii(lines) = &field.value else {
        return None;
    };
    let time = exif::DateTime::from_ascii(lines.first()?).ok()?;
    let months = f64::from(time.year) * 12.0 + f64::from(time.month);
    let days = months * 31.0 + f64::from(time.day);
    let minutes = (days * 24.0 + f64::from(time.hour)) * 60.0 + f64::from(time.minute);
    let fraction = match exif
        .get_field(Tag::SubSecTimeOriginal, In::PRIMARY)
        .map(|f| &f.value)
    {
        Some(Value::Ascii(lines)) => {
            let digits = lines.first().map_or(&[][..], Vec::as_slice);
            let text = String::from_utf8_lossy(digits);
            format!("0.{}", text.trim()).parse().unwrap_or(0.0)
        }
        _ => 0.0,
    };
    Some(minutes * 60.0 + f64::from(time.second) + fraction)
}
