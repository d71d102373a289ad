//! Do the photographs fit each other and the mesh? Cameras that look a little elsewhere than they are said to, and views
//! that were exposed differently, are found before anything is estimated from differences between views.

mod agreement;
mod mask;
mod outline;
mod silhouettes;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::sync::Arc;

use glam::{DQuat, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use agreement::{Agreement, Exposure};
pub use mask::within_outlines;
pub use silhouettes::Silhouettes;

use outline::{Fit, Motion};
use rekindle_capture::{Capture, Mesh, Photograph, View};
use rekindle_scene::surface::{Occluder, ViewSurface};

/// Points of the surface at which the views are compared.
const POINTS: usize = 5_000;

/// A camera is moved if that moves its outline by this many pixels at least, this many times as far as the outlines are
/// apart afterwards, and if the square of the turn over its standard error, or of the shift, is at least this.
const LEAST_MOVE: f64 = 0.02;
const LEAST_BETTER: f64 = 2.0;
const LEAST_SIGNIFICANCE: f64 = 100.0;
/// And if that is more than this part of what the outlines differ by all round: masks are rarely as wide on one side as on
/// the other.
const MOST_WIDENED: f64 = 0.5;

/// Moved cameras are kept unless the views then disagree more by this many standard errors.
const CLEARLY_WORSE: f64 = 3.0;

/// Views are taken to be exposed alike unless medians differ by this factor: what a varnish reflects at the rim, and what a
/// bowl sends to itself, makes for half of it.
const LEAST_RATIO: f64 = 1.025;

/// And unless, with the exposures evened out as other sides of the object say, the views disagree by this part at most.
const MOST_LEFT: f64 = 0.7;

/// Corrections of less than this, in percent, are not worth a word.
const LEAST_SAID: f64 = 0.5;

/// What has to be changed about a view for it to fit the others and the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correction {
    /// Turn of the camera in its place, about a world axis, degrees.
    pub turn_deg: [f64; 3],
    /// Shift of that place, mesh units, world.
    #[serde(default)]
    pub shift: [f64; 3],
    /// How much brighter the photograph is than the views' common scale.
    pub exposure: f64,
    /// And how much more so each of its channels, RGB.
    #[serde(default = "neutral")]
    pub balance: [f64; 3],
}

fn neutral() -> [f64; 3] {
    [1.0; 3]
}

impl Default for Correction {
    fn default() -> Self {
        Self {
            turn_deg: [0.0; 3],
            shift: [0.0; 3],
            exposure: 1.0,
            balance: neutral(),
        }
    }
}

impl Correction {
    /// Whether the camera is turned or shifted.
    pub fn moves(&self) -> bool {
        self.turn_deg != [0.0; 3] || self.shift != [0.0; 3]
    }

    /// Whether the photograph is scaled.
    pub fn scales(&self) -> bool {
        self.exposure != 1.0 || self.balance != neutral()
    }

    /// How much brighter the photograph is in each channel than it should be.
    pub fn gains(&self) -> [f64; 3] {
        self.balance.map(|balance| self.exposure * balance)
    }

    /// The same for the camera alone.
    #[must_use]
    pub fn of_camera(self) -> Self {
        Self {
            turn_deg: self.turn_deg,
            shift: self.shift,
            ..Self::default()
        }
    }

    /// The same where the photograph is so much too bright in each channel.
    #[must_use]
    pub fn with_gains(self, gains: [f64; 3]) -> Self {
        let exposure = (gains[0] * gains[1] * gains[2]).cbrt();
        Self {
            exposure,
            balance: gains.map(|gain| gain / exposure),
            ..self
        }
    }

    fn motion(&self) -> Motion {
        Motion {
            rotation: DQuat::from_scaled_axis(DVec3::from(self.turn_deg) * 1.0_f64.to_radians()),
            shift: DVec3::from(self.shift),
        }
    }

    /// What moves a camera so.
    fn moving(motion: &Motion) -> Self {
        let turn = motion.rotation.to_scaled_axis() * 1.0_f64.to_degrees();
        Self {
            turn_deg: turn.to_array(),
            shift: motion.shift.to_array(),
            ..Self::default()
        }
    }

    /// The view with the correction made.
    fn applied(&self, view: &View) -> View {
        let mut corrected = view.clone();
        if self.moves() {
            corrected.camera = self.motion().applied(&view.camera);
        }
        if self.scales() {
            let factors = self.gains().map(|gain| gain.recip() as f32);
            let Photograph {
                width,
                height,
                ref radiance,
                ref coverage,
                ref usable,
                ref clipped,
                crop,
            } = *view.photograph;
            let scaled = radiance
                .par_iter()
                .map(|p| std::array::from_fn(|c| p[c] * factors[c]));
            corrected.photograph = Arc::new(Photograph {
                width,
                height,
                radiance: scaled.collect(),
                coverage: coverage.clone(),
                usable: usable.clone(),
                clipped: clipped.clone(),
                crop,
            });
        }
        corrected
    }
}

/// The capture with the corrections made, one a view; itself where there are none.
pub fn corrected<'a>(capture: &'a Capture, corrections: &[Correction]) -> Cow<'a, Capture> {
    let fits = corrections.len() == capture.views.len();
    let none = corrections.iter().all(|c| *c == Correction::default());
    if !fits || none {
        return Cow::Borrowed(capture);
    }
    let views = capture.views.iter().zip(corrections);
    Cow::Owned(Capture {
        views: views.map(|(view, c)| c.applied(view)).collect(),
        ..capture.clone()
    })
}

/// The capture with each view divided by how much too bright it is.
pub fn evened<'a>(capture: &'a Capture, exposures: &[f64]) -> Cow<'a, Capture> {
    let of = |&exposure: &f64| Correction {
        exposure,
        ..Correction::default()
    };
    corrected(capture, &exposures.iter().map(of).collect::<Vec<_>>())
}

/// What views differ in from the mesh and each other.
pub struct Registered {
    /// What has to be corrected, one a view.
    pub corrections: Vec<Correction>,
    /// Whether they seem to be exposed alike.
    pub are_even: bool,
}

/// Finds what has to be corrected; `surfaces` are what the stated cameras see. Exposures that differ may as well be what a glossy surface
/// mirrors: lights have to bear them out, and may tell them where the views' medians don't.
pub fn register(
    mesh: &Mesh,
    views: &[View],
    surfaces: &[ViewSurface],
    occluder: &Occluder,
) -> Registered {
    let before = Agreement::new(mesh, views, surfaces, POINTS);
    let mut corrections = vec![Correction::default(); views.len()];
    let mut agreement = &before;
    let after = moved(mesh, views, surfaces, occluder, &before);
    if let Some((moved, after)) = &after {
        corrections.clone_from(moved);
        agreement = after;
    }
    let differ = |gain: &f64| gain.ln().abs() > LEAST_RATIO.ln();
    let gains = agreement.gains();
    let gains = gains.filter(|gains| gains.as_flattened().iter().any(differ));
    let are_even = gains.is_none();
    let hold_elsewhere =
        || agreement.disagreement_evened_by_others() < MOST_LEFT * agreement.disagreement();
    if let Some(gains) = gains.filter(|_| hold_elsewhere()) {
        for (correction, gains) in corrections.iter_mut().zip(gains) {
            *correction = correction.with_gains(gains);
        }
    }
    Registered {
        corrections,
        are_even,
    }
}

/// Motions of the cameras, with how the views agree after them; `None` if all stay where they are.
fn moved(
    mesh: &Mesh,
    views: &[View],
    surfaces: &[ViewSurface],
    occluder: &Occluder,
    before: &Agreement,
) -> Option<(Vec<Correction>, Agreement)> {
    let is_needed = |fit: &Fit| {
        let unsure = (LEAST_BETTER * fit.left).max(MOST_WIDENED * fit.widened.abs());
        let significance = fit.significance.into_iter().fold(0.0, f64::max);
        fit.moved > LEAST_MOVE.max(unsure) && significance > LEAST_SIGNIFICANCE
    };
    let corrections: Vec<Correction> = views
        .par_iter()
        .zip(surfaces)
        .map(|(view, surface)| {
            let coverage = view.photograph.coverage.as_ref()?;
            let fit = outline::fit(&view.camera, surface, (mesh, occluder), coverage)?;
            is_needed(&fit).then(|| Correction::moving(&fit.motion))
        })
        .map(Option::unwrap_or_default)
        .collect();
    if !corrections.iter().any(Correction::moves) {
        return None;
    }
    let pairs = views.iter().zip(&corrections);
    let moved: Vec<View> = pairs.map(|(view, c)| c.applied(view)).collect();
    let see = |view: &View| ViewSurface::new(mesh, occluder, &view.camera);
    let seen: Vec<ViewSurface> = moved.iter().map(see).collect();
    let after = Agreement::new(mesh, &moved, &seen, POINTS);
    let (gain, error) = after.gain_over(before);
    (gain > -CLEARLY_WORSE * error).then_some((corrections, after))
}

/// What a user should know of corrections that were made, in whole sentences.
pub fn describe(corrections: &[Correction]) -> Vec<String> {
    let mut sentences = Vec::new();
    let turns = corrections.iter().map(|c| DVec3::from(c.turn_deg).length());
    let turned = turns.clone().filter(|&t| t > 0.0).count();
    if turned > 0 {
        sentences.push(format!(
            "Outlines did not fit the mesh: the cameras of {turned} view{} were turned by up to {:.2}°. Check the cameras, \
             or take them as stated (--as-stated).",
            if turned == 1 { "" } else { "s" },
            turns.fold(0.0, f64::max)
        ));
    }
    let shifts = corrections.iter().map(|c| DVec3::from(c.shift).length());
    let shifted = shifts.clone().filter(|&shift| shift > 0.0).count();
    if shifted > 0 {
        sentences.push(format!(
            "Outlines fit the mesh only from elsewhere: the camera{} of {shifted} view{} moved by up to {:.3} of the mesh's \
             units. Check the cameras, or take them as stated (--as-stated).",
            if shifted == 1 { "" } else { "s" },
            if shifted == 1 { " was" } else { "s were" },
            shifts.fold(0.0, f64::max)
        ));
    }
    let percent = |ratio: f64| (ratio.ln().abs().exp() - 1.0) * 100.0;
    let largest = |ratios: &mut dyn Iterator<Item = f64>| ratios.map(percent).fold(0.0, f64::max);
    let off = largest(&mut corrections.iter().map(|c| c.exposure));
    if off > LEAST_SAID {
        sentences.push(format!(
            "Views are exposed differently, by up to {off:.1} % from what most of them are, which was evened out. Check the \
             exposures, or take them as stated (--as-stated)."
        ));
    }
    let off = largest(&mut corrections.iter().flat_map(|c| c.balance));
    if off > LEAST_SAID {
        sentences.push(format!(
            "Views differ in white balance, by up to {off:.1} % in a channel from what most of them have, which was evened \
             out. Use one white balance for all, or take them as stated (--as-stated)."
        ));
    }
    sentences
}
