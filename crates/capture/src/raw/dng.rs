//! Small DNG files for tests: a sensor that sees a known scene, uncompressed.

use glam::{DMat3, DVec3};

/// Linear sRGB from CIE XYZ with the white D65.
const SRGB_FROM_XYZ: DMat3 = DMat3::from_cols(
    DVec3::new(3.240_454_2, -0.969_266_0, 0.055_643_4),
    DVec3::new(-1.537_138_5, 1.876_010_8, -0.204_025_9),
    DVec3::new(-0.498_531_4, 0.041_556_0, 1.057_225_2),
);

/// A camera and a photograph of it.
#[derive(Clone)]
pub(crate) struct Dng {
    /// Width and height of the sensor.
    pub size: [u32; 2],
    /// Top, left, bottom and right of what sees light.
    pub active: [u32; 4],
    /// First column and row of the picture in there, and its size.
    pub crop: [u32; 4],
    /// Black level at even and odd columns of even rows, and of odd rows, from the active area's corner; or of three channels.
    pub black: [u16; 4],
    /// White level.
    pub white: u16,
    /// Colours of a square of samples from the active area's corner; none where each pixel has all three.
    pub pattern: Vec<u8>,
    /// What a grey thing gives, in parts of green.
    pub neutral: [f64; 3],
    /// EXIF orientation.
    pub orientation: u16,
    /// Seconds of exposure, which alone change what the sensor gets.
    pub time: f64,
    /// Second at which it was taken.
    pub second: u32,
}

/// A camera's RGB from linear sRGB, with its rows adding up to 1.
fn balanced_from_srgb() -> DMat3 {
    // Each channel sees some of what the others do.
    DMat3::from_cols(
        DVec3::new(0.7, 0.2, 0.05),
        DVec3::new(0.25, 0.65, 0.25),
        DVec3::new(0.05, 0.15, 0.7),
    )
}

impl Default for Dng {
    fn default() -> Self {
        Self {
            size: [56, 46],
            active: [3, 5, 43, 53],
            crop: [4, 2, 40, 36],
            black: [510, 512, 514, 520],
            white: 15_000,
            pattern: vec![0, 1, 1, 2],
            neutral: [0.5, 1.0, 0.625],
            orientation: 1,
            time: 1.0,
            second: 0,
        }
    }
}

impl Dng {
    /// The file, where `scene` is linear sRGB at columns and rows of the picture: green's white level is 1.
    pub(crate) fn bytes(&self, scene: impl Fn(f64, f64) -> [f64; 3]) -> Vec<u8> {
        let (width, height) = (self.size[0], self.size[1]);
        let [top, left, bottom, right] = self.active;
        let neutral = DVec3::from(self.neutral);
        let mut samples = Vec::new();
        for (row, column) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let inside = (top..bottom).contains(&row) && (left..right).contains(&column);
            let x = f64::from(column) - f64::from(left + self.crop[0]);
            let y = f64::from(row) - f64::from(top + self.crop[1]);
            let camera = balanced_from_srgb() * DVec3::from(scene(x, y)) * neutral * self.time;
            // Ahead of the active area the patterns go on.
            let place = |side: u32| {
                let [row, column] = [row + side - top % side, column + side - left % side];
                (row % side * side + column % side) as usize
            };
            let side = self.pattern.len().isqrt() as u32;
            let channels = if side == 0 {
                0..3
            } else {
                let colour = usize::from(self.pattern[place(side)]);
                colour..colour + 1
            };
            for channel in channels {
                let light = if inside { camera[channel] } else { 0.0 };
                let black = f64::from(self.black[if side == 0 { channel } else { place(2) }]);
                let sample = black + light * (f64::from(self.white) - black);
                let sample = sample.round().clamp(0.0, f64::from(self.white)) as u16;
                samples.extend(sample.to_le_bytes());
            }
        }
        self.file(&samples)
    }

    /// The file with these bytes as samples.
    fn file(&self, samples: &[u8]) -> Vec<u8> {
        let side = self.pattern.len().isqrt() as u16;
        let is_linear = side == 0;
        let channels = if is_linear { 3 } else { 1 };
        let blacks = if is_linear { 1 } else { 2 };
        let camera_from_xyz =
            DMat3::from_diagonal(self.neutral.into()) * balanced_from_srgb() * SRGB_FROM_XYZ;
        let matrix: Vec<f64> = camera_from_xyz.transpose().to_cols_array().into();
        let [top, left, bottom, right] = self.active;
        let [x, y, width, height] = self.crop;
        let date = format!("2026:03:01 12:00:{:02}\0", self.second);
        let exif = vec![
            entry(33_434, &Value::Ratios(&[self.time])),
            entry(33_437, &Value::Ratios(&[4.0])),
            entry(34_855, &Value::Shorts(&[100])),
            entry(36_867, &Value::Text(date.as_bytes())),
        ];
        let exif_at = 8 + samples.len() as u32;
        let exif = directory(exif, exif_at);
        let root_at = exif_at + exif.len() as u32;
        let root = vec![
            entry(254, &Value::Longs(&[0])),
            entry(256, &Value::Longs(&[self.size[0]])),
            entry(257, &Value::Longs(&[self.size[1]])),
            entry(258, &Value::Shorts(&[16].repeat(channels))),
            entry(259, &Value::Shorts(&[1])),
            entry(
                262,
                &Value::Shorts(&[if is_linear { 34_892 } else { 32_803 }]),
            ),
            entry(271, &Value::Text(b"Test\0")),
            entry(272, &Value::Text(b"Box\0")),
            entry(273, &Value::Longs(&[8])),
            entry(274, &Value::Shorts(&[self.orientation])),
            entry(277, &Value::Shorts(&[channels as u16])),
            entry(278, &Value::Longs(&[self.size[1]])),
            entry(279, &Value::Longs(&[samples.len() as u32])),
            entry(33_421, &Value::Shorts(&[side, side])),
            entry(33_422, &Value::Bytes(&self.pattern)),
            entry(34_665, &Value::Longs(&[exif_at])),
            entry(50_706, &Value::Bytes(&[1, 4, 0, 0])),
            entry(50_713, &Value::Shorts(&[blacks, blacks])),
            entry(
                50_714,
                &Value::Shorts(&self.black[..self.black.len() - channels / 3]),
            ),
            entry(
                50_717,
                &Value::Longs(&[u32::from(self.white)].repeat(channels)),
            ),
            entry(50_719, &Value::Longs(&[x, y])),
            entry(50_720, &Value::Longs(&[width, height])),
            entry(50_721, &Value::SignedRatios(&matrix)),
            entry(50_728, &Value::Ratios(&self.neutral)),
            entry(50_778, &Value::Shorts(&[21])),
            entry(50_829, &Value::Longs(&[top, left, bottom, right])),
        ];
        let header = [b"II*\0".as_slice(), &root_at.to_le_bytes()].concat();
        [&header, samples, &exif, &directory(root, root_at)].concat()
    }
}

enum Value<'a> {
    Bytes(&'a [u8]),
    Text(&'a [u8]),
    Shorts(&'a [u16]),
    Longs(&'a [u32]),
    Ratios(&'a [f64]),
    SignedRatios(&'a [f64]),
}

/// An entry of a directory: tag, type, number of values and their bytes.
fn entry(tag: u16, value: &Value) -> (u16, u16, u32, Vec<u8>) {
    const UNIT: f64 = 1e6;
    let ratio = |v: &f64| {
        let top = ((v * UNIT).round() as i32).to_le_bytes();
        [top, (UNIT as i32).to_le_bytes()].concat()
    };
    let (kind, count, bytes): (u16, usize, Vec<u8>) = match value {
        Value::Bytes(all) => (1, all.len(), all.to_vec()),
        Value::Text(all) => (2, all.len(), all.to_vec()),
        Value::Shorts(all) => (
            3,
            all.len(),
            all.iter().flat_map(|v| v.to_le_bytes()).collect(),
        ),
        Value::Longs(all) => (
            4,
            all.len(),
            all.iter().flat_map(|v| v.to_le_bytes()).collect(),
        ),
        Value::Ratios(all) => (5, all.len(), all.iter().flat_map(ratio).collect()),
        Value::SignedRatios(all) => (10, all.len(), all.iter().flat_map(ratio).collect()),
    };
    (tag, kind, count as u32, bytes)
}

/// The bytes of a directory that stands at `at`, and of its longer values behind it.
fn directory(entries: Vec<(u16, u16, u32, Vec<u8>)>, at: u32) -> Vec<u8> {
    let mut fixed = (entries.len() as u16).to_le_bytes().to_vec();
    let mut longer = Vec::new();
    let behind = at + 2 + 12 * entries.len() as u32 + 4;
    for (tag, kind, count, mut bytes) in entries {
        fixed.extend(tag.to_le_bytes());
        fixed.extend(kind.to_le_bytes());
        fixed.extend(count.to_le_bytes());
        if bytes.len() > 4 {
            fixed.extend((behind + longer.len() as u32).to_le_bytes());
            longer.append(&mut bytes);
        } else {
            bytes.resize(4, 0);
            fixed.append(&mut bytes);
        }
    }
    [fixed, vec![0; 4], longer].concat()
}
