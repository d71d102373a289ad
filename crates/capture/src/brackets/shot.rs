//! What a file's EXIF data say of how it was taken.

use crate::raw;
use exif::{Exif, In, Reader, Tag, Value};
use rawler::decoders::RawMetadata;
use rawler::formats::tiff::{Rational, SRational};
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
        // Many makers keep EXIF data where only a decoder of their own files finds them.
        let metadata = || raw::metadata(path, files::read(path).ok()?);
        if raw::is_raw(path)
            && let Some(metadata) = metadata()
        {
            return Self::of_raw(&metadata);
        }
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

    /// What the metadata of a raw file say.
    fn of_raw(metadata: &RawMetadata) -> Self {
        let exif = &metadata.exif;
        let stated = Stated {
            time: above_zero(ratio(exif.exposure_time.as_ref())),
            time_value: signed_ratio(exif.shutter_speed_value.as_ref()),
            f_number: above_zero(ratio(exif.fnumber.as_ref())),
            aperture_value: ratio(exif.aperture_value.as_ref()),
            sensitivities: [
                exif.iso_speed_ratings.map(f64::from),
                exif.recommended_exposure_index.map(f64::from),
                None,
                exif.iso_speed.map(f64::from),
            ]
            .map(above_zero),
        };
        let date = exif
            .date_time_original
            .as_ref()
            .or(exif.modify_date.as_ref());
        let fraction = exif.sub_sec_time_original.as_deref().unwrap_or_default();
        Self {
            settings: stated.settings(),
            setup: vec![
                metadata.make.clone(),
                metadata.model.clone(),
                exif.serial_number.clone().unwrap_or_default(),
                format!("{:?}", exif.orientation),
                format!("{:?}", ratio(exif.focal_length.as_ref())),
            ],
            taken: date.and_then(|date| seconds(date.as_bytes(), fraction)),
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
    let sensitivities = [
        Tag::PhotographicSensitivity,
        Tag::RecommendedExposureIndex,
        Tag::StandardOutputSensitivity,
        Tag::ISOSpeed,
    ];
    let stated = Stated {
        time: positive(exif, Tag::ExposureTime),
        time_value: number(exif, Tag::ShutterSpeedValue),
        f_number: positive(exif, Tag::FNumber),
        aperture_value: number(exif, Tag::ApertureValue),
        sensitivities: sensitivities.map(|tag| positive(exif, tag)),
    };
    stated.settings()
}

/// What EXIF data state of an exposure, in all the ways that they can.
struct Stated {
    /// Seconds.
    time: Option<f64>,
    /// The same as an APEX value, −log₂.
    time_value: Option<f64>,
    /// Aperture number.
    f_number: Option<f64>,
    /// The same as an APEX value, 2 log₂.
    aperture_value: Option<f64>,
    /// ISO sensitivities, the one that is meant first.
    sensitivities: [Option<f64>; 4],
}

impl Stated {
    fn settings(self) -> Option<Settings> {
        // 0/0 stands for unknown.
        let time = (self.time)
            .or_else(|| self.time_value.map(|tv| (-tv).exp2()))
            .filter(|&time| (1e-7..1e6).contains(&time))?;
        let f_number = (self.f_number)
            .or_else(|| self.aperture_value.map(|av| (0.5 * av).exp2()))
            .filter(|f| (1e-3..1e6).contains(f));
        // Sensitivities that 16 bits can't hold are stated as 65535, with the number elsewhere.
        let [first, others @ ..] = self.sensitivities;
        let iso = first.filter(|&iso| iso < 65_535.0);
        let iso = others.into_iter().fold(iso, Option::or);
        Some(Settings {
            time,
            f_number: f_number.filter(|n| (0.1..1e3).contains(n)),
            iso: iso.filter(|iso| (0.1..1e8).contains(iso)),
        })
    }
}

/// A positive, finite number.
fn above_zero(value: Option<f64>) -> Option<f64> {
    value.filter(|v| v.is_finite() && *v > 0.0)
}

fn ratio(value: Option<&Rational>) -> Option<f64> {
    let value = value.map(|v| f64::from(v.n) / f64::from(v.d));
    value.filter(|v| v.is_finite())
}

fn signed_ratio(value: Option<&SRational>) -> Option<f64> {
    let value = value.map(|v| f64::from(v.n) / f64::from(v.d));
    value.filter(|v| v.is_finite())
}

fn taken(exif: &Exif) -> Option<f64> {
    let lines = |tag: Tag| match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Ascii(lines) => lines.first(),
        _ => None,
    };
    let date = lines(Tag::DateTimeOriginal).or_else(|| lines(Tag::DateTime))?;
    let digits = lines(Tag::SubSecTimeOriginal).map_or(&[][..], Vec::as_slice);
    seconds(date, &String::from_utf8_lossy(digits))
}

/// Seconds of a date as EXIF data write it, with the digits of its fraction, and with days long enough to be told apart.
fn seconds(date: &[u8], fraction: &str) -> Option<f64> {
    let time = exif::DateTime::from_ascii(date).ok()?;
    let months = f64::from(time.year) * 12.0 + f64::from(time.month);
    let days = months * 31.0 + f64::from(time.day);
    let minutes = (days * 24.0 + f64::from(time.hour)) * 60.0 + f64::from(time.minute);
    let fraction = format!("0.{}", fraction.trim()).parse().unwrap_or(0.0);
    Some(minutes * 60.0 + f64::from(time.second) + fraction)
}
