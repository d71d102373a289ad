//! How a camera turns linear light into the codes of its files: the response curve.
//!
//! A curve gives the relative exposure, radiance × amount, that each code stands for. It is known up to a factor, which
//! is chosen so that the middle code is what it is in sRGB, in every channel.

use serde::Serialize;

/// Number of codes at which a curve is stated; finer codes lie between two of them.
pub const KNOTS: usize = 256;
/// Distance of two knots in 16-bit codes.
const STEP: u16 = 257;
/// Knot at which all curves meet.
pub(super) const MIDDLE: usize = 128;

/// Where a response comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// sRGB, which 8-bit files are taken as and the brackets agree with.
    Srgb,
    /// Linear, which 16-bit files are taken as and the brackets agree with.
    Linear,
    /// Recovered from the brackets, one curve for all channels.
    Recovered,
    /// Recovered from the brackets, a curve for each channel.
    RecoveredPerChannel,
}

/// The response of a camera.
#[derive(Clone, Debug, Serialize)]
pub struct Response {
    /// Where it comes from.
    pub origin: Origin,
    /// What the files are taken to have if nothing tells otherwise.
    pub assumed: Origin,
    /// Relative exposure of the codes 0, 1/255 … 1 in each channel; never falling, code 0 is none.
    pub curves: [Vec<f32>; 3],
    /// Root mean square disagreement of the exposures of one point under this response, as a part of its radiance; none
    /// if nothing was compared.
    pub disagreement: Option<f64>,
    /// The same under the response that the files are taken as.
    pub disagreement_assumed: Option<f64>,
    /// Number of points and channels that were compared.
    pub compared: usize,
}

impl Response {
    /// The response that files are taken as.
    pub(super) fn assumed(origin: Origin) -> Self {
        let curve = usual(origin);
        Self {
            origin,
            assumed: origin,
            curves: [curve.clone(), curve.clone(), curve],
            disagreement: None,
            disagreement_assumed: None,
            compared: 0,
        }
    }

    /// Whether it is what the files are taken as anyway.
    pub fn is_assumed(&self) -> bool {
        matches!(self.origin, Origin::Srgb | Origin::Linear)
    }

    /// The curve that the files are taken to have if nothing tells otherwise.
    pub fn usual(&self) -> Vec<f32> {
        usual(self.assumed)
    }

    /// The 16-bit code of a relative exposure, none from full scale on.
    pub(super) fn code(&self, channel: usize, exposure: f32) -> Option<u16> {
        let curve = &self.curves[channel];
        let above = curve.partition_point(|&e| e <= exposure);
        if above == 0 || above == KNOTS {
            return (above == 0).then_some(0);
        }
        let (low, high) = (curve[above - 1], curve[above]);
        let part = (exposure - low) / (high - low);
        Some(((above - 1) as f32 * f32::from(STEP) + part * f32::from(STEP)) as u16)
    }

    /// Relative exposure of a 16-bit code; 8-bit codes are multiples of 257.
    pub fn exposure(&self, channel: usize, code: u16) -> f32 {
        let curve = &self.curves[channel];
        let (knot, rest) = (usize::from(code / STEP), code % STEP);
        if rest == 0 {
            return curve[knot];
        }
        let part = f32::from(rest) / f32::from(STEP);
        curve[knot] + part * (curve[knot + 1] - curve[knot])
    }

    /// How much the exposure grows by 1/255 of full scale at a code.
    pub fn slope(&self, channel: usize, code: u16) -> f32 {
        let curve = &self.curves[channel];
        let knot = usize::from(code / STEP);
        let (low, high) = (knot.saturating_sub(1), (knot + 1).min(KNOTS - 1));
        (curve[high] - curve[low]) / (high - low) as f32
    }
}

/// The curve of an assumption.
fn usual(origin: Origin) -> Vec<f32> {
    let codes = (0..KNOTS).map(|k| k as f32 / (KNOTS - 1) as f32);
    match origin {
        Origin::Linear => codes.collect(),
        _ => codes.map(srgb_to_linear).collect(),
    }
}

/// The sRGB decoding curve on [0, 1] (IEC 61966-2-1).
pub(crate) fn srgb_to_linear(code: f32) -> f32 {
    if code <= 0.040_45 {
        code / 12.92
    } else {
        ((code + 0.055) / 1.055).powf(2.4)
    }
}
