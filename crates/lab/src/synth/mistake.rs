//! One thing that is wrong with what a capture states, as it happens to people: the photographs' encoding, background or white
//! balance, one view's exposure, focus or camera, a mesh with holes, hot pixels.

use glam::{DMat3, DQuat, DVec3, Vec3};

use super::recipe::Mistake;
use rekindle_base::math::random::Random;
use rekindle_capture::{Camera, Mesh};
use rekindle_relight::{Picture, srgb};

/// The view that is unlike the others.
const ODD_VIEW: usize = 1;
/// How much it is brighter, and the factor of its channels where only the white balance is another.
const BRIGHTER: f32 = 4.0;
const WHITE_BALANCE: [f32; 3] = [1.05, 1.0, 0.95];
/// Angle by which its camera is stated to stand further round the object, radians.
const ORBIT: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// Part of its distance by which it is stated to stand nearer.
const NEARER: f64 = 0.02;
/// Half side of the square over which a view out of focus is even, in parts of its width.
const DEFOCUS: f64 = 0.01;
/// Radiance behind the object, in parts of its mean.
const BACKGROUND: f32 = 1.0;
/// Part of the triangles that are missing.
const MISSING: f64 = 0.2;
/// Hot pixels in each view, and how many times too bright they are.
const HOT: u64 = 20;
const HOTTER: f32 = 1000.0;

impl Mistake {
    /// What it is called in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Background => "no alpha, background as bright as the object",
            Self::Encoded => "sRGB-encoded EXR",
            Self::BrighterView => "one view ×4",
            Self::WhiteBalance => "white balance of one view 5 % off",
            Self::OrbitedCamera => "one camera 0.5° further round",
            Self::NearerCamera => "one camera 2 % of its distance nearer",
            Self::Defocused => "one view out of focus",
            Self::Holes => "a fifth of the triangles missing",
            Self::HotPixels => "20 pixels of each view ×1000",
        }
    }

    /// Puts it into photographs of `pictures`, premultiplied RGB.
    pub(super) fn spoil(
        self,
        photographs: &mut [Vec<[f32; 3]>],
        pictures: &[Picture],
        random: Random,
    ) {
        match self {
            Self::Background => {
                let behind = BACKGROUND * mean(photographs, pictures);
                for (photograph, picture) in photographs.iter_mut().zip(pictures) {
                    for (pixel, coverage) in photograph.iter_mut().zip(&picture.coverage) {
                        *pixel = pixel.map(|v| v + (1.0 - coverage) * behind);
                    }
                }
            }
            Self::Encoded => {
                let values = || photographs.iter().flatten().flatten();
                let brightest = values().fold(f32::MIN_POSITIVE, |m, &v| m.max(v));
                for pixel in photographs.iter_mut().flatten() {
                    let encoded = srgb(Vec3::from(*pixel).max(Vec3::ZERO) / brightest);
                    *pixel = encoded.to_array();
                }
            }
            Self::BrighterView => scale(photographs, [BRIGHTER; 3]),
            Self::WhiteBalance => scale(photographs, WHITE_BALANCE),
            Self::HotPixels => {
                for (view, (photograph, picture)) in
                    photographs.iter_mut().zip(pictures).enumerate()
                {
                    let whole = (0..photograph.len()).filter(|&i| picture.coverage[i] == 1.0);
                    let whole: Vec<usize> = whole.collect();
                    let random = random.of(view as u64);
                    for k in 0..HOT.min(whole.len() as u64) {
                        let at = (random.uniform(k) * whole.len() as f64) as usize;
                        let pixel = &mut photograph[whole[at.min(whole.len() - 1)]];
                        *pixel = pixel.map(|v| HOTTER * v);
                    }
                }
            }
            Self::Defocused => {
                let view = photographs.get_mut(ODD_VIEW).zip(pictures.get(ODD_VIEW));
                if let Some((photograph, picture)) = view {
                    *photograph = defocused(photograph, picture);
                }
            }
            Self::OrbitedCamera | Self::NearerCamera | Self::Holes => {}
        }
    }

    /// Whether the files state no coverage.
    pub(super) fn is_opaque(self) -> bool {
        self == Self::Background
    }

    /// Puts it into the stated cameras.
    pub(super) fn misplace(self, cameras: &mut [Camera], centre: DVec3) {
        let (turn, nearer) = match self {
            Self::OrbitedCamera => (DMat3::from_quat(DQuat::from_rotation_y(ORBIT)), 0.0),
            Self::NearerCamera => (DMat3::IDENTITY, NEARER),
            _ => return,
        };
        if let Some(camera) = cameras.get_mut(ODD_VIEW) {
            let pose = &mut camera.world_from_camera;
            pose.matrix3 = turn * pose.matrix3;
            pose.translation = centre + (1.0 - nearer) * (turn * (pose.translation - centre));
        }
    }

    /// Whether it spoils the stated mesh.
    pub(super) fn spoils_mesh(self) -> bool {
        self == Self::Holes
    }

    /// Puts it into the stated mesh.
    pub(super) fn tear(self, mesh: &mut Mesh, random: Random) {
        if self.spoils_mesh() {
            let mut number = 0;
            mesh.triangles.retain(|_| {
                number += 1;
                random.uniform(number) >= MISSING
            });
        }
    }
}

/// Mean radiance of the object's pixels.
fn mean(photographs: &[Vec<[f32; 3]>], pictures: &[Picture]) -> f32 {
    let (mut sum, mut covered) = (0.0, 0.0);
    for (photograph, picture) in photographs.iter().zip(pictures) {
        let values = photograph.iter().flatten();
        sum += values.map(|&v| f64::from(v)).sum::<f64>() / 3.0;
        let coverage = picture.coverage.iter();
        covered += coverage.map(|&v| f64::from(v)).sum::<f64>();
    }
    (sum / f64::max(covered, 1.0)) as f32
}

/// A photograph of which each pixel is the mean of a square of the object about it, premultiplied by what it covers as before.
fn defocused(photograph: &[[f32; 3]], picture: &Picture) -> Vec<[f32; 3]> {
    let (width, height) = (picture.width as usize, picture.height as usize);
    let reach = (DEFOCUS * f64::from(picture.width)).round().max(1.0) as usize;
    let around = |at: usize, size: usize| at.saturating_sub(reach)..(at + reach + 1).min(size);
    let pixel = |i: usize| {
        let (mut sum, mut covered) = (Vec3::ZERO, 0.0);
        for y in around(i / width, height) {
            for k in around(i % width, width).map(|x| y * width + x) {
                sum += Vec3::from(photograph[k]);
                covered += picture.coverage[k];
            }
        }
        (picture.coverage[i] * sum / covered.max(f32::MIN_POSITIVE)).to_array()
    };
    (0..photograph.len()).map(pixel).collect()
}

fn scale(photographs: &mut [Vec<[f32; 3]>], factors: [f32; 3]) {
    for pixel in photographs.get_mut(ODD_VIEW).into_iter().flatten() {
        for (value, factor) in pixel.iter_mut().zip(factors) {
            *value *= factor;
        }
    }
}
