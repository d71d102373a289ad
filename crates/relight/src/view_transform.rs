//! View transforms: how linear radiance becomes what a screen shows.
//!
//! A transform takes scene-linear RGB with Rec. 709 primaries, exposure applied (1 is diffuse white), and returns display values
//! in [0, 1], encoded for an sRGB screen. Each is the published formula with its constants:
//!
//! * sRGB: IEC 61966-2-1, cut at white;
//! * AgX: Troy Sobotka's, in the form that Blender 4 and Filament have it (inset in Rec. 2020, log2 from −12.47393 to
//!   4.026069), the sigmoid as Benjamin Wrensch's polynomial of sixth degree (mean squared error 3.7e-6);
//! * ACES: Stephen Hill's fit of RRT and ODT with its two matrices;
//! * Khronos PBR neutral: the specification of May 2024;
//! * false colour: luminance in stops on Anton Mikhailov's polynomial of the Turbo map, spread as in tev.
//!
//! The shaders have twins of these functions; what is here is the reference.

use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};

use rekindle_scene::hemisphere::srgb;

/// A way to show linear radiance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ViewTransform {
    /// As it is, cut at white.
    Srgb,
    /// AgX base look: highlights run out to white softly and keep their hue.
    #[default]
    Agx,
    /// The film-like curve of the Academy's reference transforms.
    Aces,
    /// True base colours with compressed highlights, as product viewers use it.
    PbrNeutral,
    /// Luminance as colour, ten stops from blue to red.
    FalseColour,
}

impl ViewTransform {
    /// All of them, in the order of menus.
    pub const ALL: [Self; 5] = [
        Self::Srgb,
        Self::Agx,
        Self::Aces,
        Self::PbrNeutral,
        Self::FalseColour,
    ];

    /// What people call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Srgb => "sRGB",
            Self::Agx => "AgX",
            Self::Aces => "ACES",
            Self::PbrNeutral => "Khronos neutral",
            Self::FalseColour => "False colour",
        }
    }

    /// Display values in [0, 1] of a linear colour. What is negative or not a number counts as black.
    pub fn apply(self, linear: Vec3) -> Vec3 {
        // `max` takes the other operand where one is not a number; infinity would become one in the matrices.
        let linear = linear.max(Vec3::ZERO).min(Vec3::splat(1e15));
        match self {
            Self::Srgb => encode(linear),
            Self::Agx => encode(agx(linear)),
            Self::Aces => encode(aces(linear)),
            Self::PbrNeutral => encode(pbr_neutral(linear)),
            Self::FalseColour => false_colour(linear),
        }
    }
}

/// The sRGB transfer function of each channel, cut to [0, 1].
fn encode(linear: Vec3) -> Vec3 {
    Vec3::from(linear.clamp(Vec3::ZERO, Vec3::ONE).to_array().map(srgb))
}

/// Linear Rec. 709 to linear Rec. 2020, by columns.
const REC2020_FROM_REC709: Mat3 = Mat3::from_cols(
    Vec3::new(0.6274, 0.0691, 0.0164),
    Vec3::new(0.3293, 0.9195, 0.0880),
    Vec3::new(0.0433, 0.0113, 0.8956),
);
/// And back.
const REC709_FROM_REC2020: Mat3 = Mat3::from_cols(
    Vec3::new(1.6605, -0.1246, -0.0182),
    Vec3::new(-0.5876, 1.1329, -0.1006),
    Vec3::new(-0.0728, -0.0083, 1.1187),
);
const AGX_INSET: Mat3 = Mat3::from_cols(
    Vec3::new(
        0.856_627_153_315_983,
        0.137_318_972_929_847,
        0.111_898_212_999_95,
    ),
    Vec3::new(
        0.095_121_240_538_158_8,
        0.761_241_990_602_591,
        0.076_799_418_603_190_3,
    ),
    Vec3::new(
        0.048_251_606_145_858_3,
        0.101_439_036_467_562,
        0.811_302_368_396_859,
    ),
);
const AGX_OUTSET: Mat3 = Mat3::from_cols(
    Vec3::new(
        1.127_100_581_814_436_8,
        -0.141_329_763_498_438_3,
        -0.141_329_763_498_438_26,
    ),
    Vec3::new(
        -0.110_606_643_096_603_23,
        1.157_823_702_216_272,
        -0.110_606_643_096_602_94,
    ),
    Vec3::new(
        -0.016_493_938_717_834_573,
        -0.016_493_938_717_834_257,
        1.251_936_406_595_040_5,
    ),
);
/// Ten stops below and six and a half above middle grey, 0.18, as exponents of two.
const AGX_STOPS: [f32; 2] = [-12.47393, 4.026_069];

/// Linear display colour.
fn agx(linear: Vec3) -> Vec3 {
    let inset = (AGX_INSET * (REC2020_FROM_REC709 * linear)).max(Vec3::splat(1e-10));
    let stops = Vec3::from(inset.to_array().map(f32::log2));
    let x = ((stops - AGX_STOPS[0]) / (AGX_STOPS[1] - AGX_STOPS[0])).clamp(Vec3::ZERO, Vec3::ONE);
    let x2 = x * x;
    let x4 = x2 * x2;
    let curve =
        15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x
            - 0.00232;
    let display = (AGX_OUTSET * curve).max(Vec3::ZERO);
    REC709_FROM_REC2020 * Vec3::from(display.to_array().map(|v| v.powf(2.2)))
}

const ACES_INPUT: Mat3 = Mat3::from_cols(
    Vec3::new(0.59719, 0.07600, 0.02840),
    Vec3::new(0.35458, 0.90834, 0.13383),
    Vec3::new(0.04823, 0.01566, 0.83777),
);
const ACES_OUTPUT: Mat3 = Mat3::from_cols(
    Vec3::new(1.60475, -0.10208, -0.00327),
    Vec3::new(-0.53108, 1.10813, -0.07276),
    Vec3::new(-0.07367, -0.00605, 1.07602),
);

/// Linear display colour.
fn aces(linear: Vec3) -> Vec3 {
    let v = ACES_INPUT * linear;
    let above = v * (v + 0.024_578_6) - 0.000_090_537;
    let below = v * (0.983_729 * v + 0.432_951_0) + 0.238_081;
    ACES_OUTPUT * (above / below)
}

/// Linear display colour.
fn pbr_neutral(linear: Vec3) -> Vec3 {
    const START: f32 = 0.8 - 0.04;
    const DESATURATION: f32 = 0.15;
    let least = linear.min_element();
    let offset = if least < 0.08 {
        least - 6.25 * least * least
    } else {
        0.04
    };
    let colour = linear - offset;
    let peak = colour.max_element();
    if peak < START {
        return colour;
    }
    let room = 1.0 - START;
    let new_peak = 1.0 - room * room / (peak + room - START);
    let colour = colour * (new_peak / peak);
    let grey = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    colour.lerp(Vec3::splat(new_peak), grey)
}

/// Luminance of linear Rec. 709.
pub fn luminance(linear: Vec3) -> f32 {
    linear.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Encoded colour: log2(Y + 1/32)/10 + 1/2 on the Turbo map. Blue is black, green is Y = 1, red five stops above.
fn false_colour(linear: Vec3) -> Vec3 {
    turbo((luminance(linear) + 1.0 / 32.0).log2() / 10.0 + 0.5)
}

/// The Turbo colour map at `t`, held to [0, 1]: encoded RGB.
pub fn turbo(t: f32) -> Vec3 {
    const TERMS: [Vec3; 6] = [
        Vec3::new(0.135_721_38, 0.091_402_61, 0.106_673_30),
        Vec3::new(4.615_392_60, 2.194_188_39, 12.641_946_08),
        Vec3::new(-42.660_322_58, 4.842_966_58, -60.582_048_36),
        Vec3::new(132.131_082_34, -14.185_033_33, 110.362_767_71),
        Vec3::new(-152.942_393_96, 4.277_298_57, -89.903_109_12),
        Vec3::new(59.286_379_43, 2.829_566_04, 27.348_249_73),
    ];
    let t = t.clamp(0.0, 1.0);
    let sum = TERMS
        .iter()
        .rev()
        .fold(Vec3::ZERO, |sum, term| sum * t + *term);
    sum.clamp(Vec3::ZERO, Vec3::ONE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(transform: ViewTransform, value: f32) -> f32 {
        let shown = transform.apply(Vec3::splat(value));
        assert!(
            (shown.max_element() - shown.min_element()) < 2e-3,
            "{transform:?} tints grey {value}: {shown}"
        );
        shown.y
    }

    /// Inverse of the sRGB transfer function.
    fn decode(v: f32) -> f32 {
        if v <= 0.04045 {
            v / 12.92
        } else {
            ((v + 0.055) / 1.055).powf(2.4)
        }
    }

    #[test]
    fn srgb_has_the_standards_values() {
        // Half of the encoded range is 21.404 % of white; half of white is 73.536 % of the range.
        assert!((grey(ViewTransform::Srgb, 0.214_041) - 0.5).abs() < 1e-5);
        assert!((grey(ViewTransform::Srgb, 0.5) - 0.735_357).abs() < 1e-5);
        assert!(grey(ViewTransform::Srgb, 7.0) > 0.9999);
    }

    #[test]
    fn agx_has_its_pivot_and_its_ends() {
        // Sobotka's curve passes middle grey at half of the display's range, encoded with the power 2.2.
        let middle = decode(grey(ViewTransform::Agx, 0.18)).powf(1.0 / 2.2);
        assert!((middle - 0.5).abs() < 0.005, "middle grey at {middle}");
        assert!(grey(ViewTransform::Agx, 0.18 / 2048.0) < 0.01);
        assert!(grey(ViewTransform::Agx, 0.18 * 128.0) > 0.99);
        // A colour at the edge of the gamut loses its saturation as it brightens.
        let bright = ViewTransform::Agx.apply(Vec3::new(16.0, 0.0, 0.0));
        assert!(bright.y > 0.25 && bright.x > 0.9, "{bright}");
    }

    #[test]
    fn aces_is_hills_fit() {
        // The rows of both matrices add up to one, so grey passes through the curve alone; by hand for 0.18:
        // (0.18 · 0.2045786 − 0.000090537)/(0.18 · (0.17707122 + 0.432951) + 0.238081) = 0.0367336/0.3478850.
        let shown = decode(grey(ViewTransform::Aces, 0.18));
        assert!((shown - 0.036_733_6 / 0.347_885).abs() < 2e-5, "{shown}");
        assert!(grey(ViewTransform::Aces, 1e6) > 0.9999);
    }

    #[test]
    fn pbr_neutral_keeps_base_colours() {
        // The specification: below 0.8 a base colour comes back less the 0.04 that a dielectric reflects.
        for colour in [Vec3::new(0.5, 0.3, 0.1), Vec3::new(0.79, 0.4, 0.09)] {
            let shown = ViewTransform::PbrNeutral.apply(colour);
            let linear = Vec3::from(shown.to_array().map(decode));
            assert!((linear - (colour - 0.04)).abs().max_element() < 1e-5);
        }
        // Continuous where compression starts, and never over white.
        let (below, above) = (0.799_99, 0.800_01);
        let step = grey(ViewTransform::PbrNeutral, above) - grey(ViewTransform::PbrNeutral, below);
        assert!((0.0..1e-4).contains(&step));
        assert!(grey(ViewTransform::PbrNeutral, 1e5) > 0.999);
    }

    #[test]
    fn false_colour_counts_stops() {
        // Dark blue, green and dark red: Mikhailov's table has (0.64, 0.99, 0.23) in the middle and (0.48, 0.02, 0.01) at the
        // end. The polynomial is within a tenth of it.
        let near = |t: f32, table: Vec3| (turbo(t) - table).abs().max_element() < 0.1;
        assert!(near(0.5, Vec3::new(0.64, 0.99, 0.23)));
        assert!(near(1.0, Vec3::new(0.48, 0.02, 0.01)));
        let shown = ViewTransform::FalseColour.apply(Vec3::splat(1.0 - 1.0 / 32.0));
        assert!((shown - turbo(0.5)).length() < 1e-5);
        let stop_up = ViewTransform::FalseColour.apply(Vec3::splat(2.0 - 1.0 / 32.0));
        assert!((stop_up - turbo(0.6)).length() < 1e-5);
    }

    #[test]
    fn every_transform_rises_and_survives_anything() {
        for transform in ViewTransform::ALL {
            if transform != ViewTransform::FalseColour {
                let mut last = -1.0;
                for i in 0..200 {
                    let shown = grey(transform, 1e-4 * 1.08_f32.powi(i));
                    assert!(shown >= last - 1e-6, "{transform:?} falls at step {i}");
                    last = shown;
                }
            }
            for strange in [
                f32::NAN,
                f32::INFINITY,
                f32::NEG_INFINITY,
                -3.0,
                f32::MAX,
                1e-45,
            ] {
                for colour in [Vec3::splat(strange), Vec3::new(strange, 0.2, 0.0)] {
                    let shown = transform.apply(colour);
                    let range = shown.cmpge(Vec3::ZERO) & shown.cmple(Vec3::ONE);
                    assert!(range.all(), "{transform:?} of {colour}: {shown}");
                }
            }
        }
    }
}
