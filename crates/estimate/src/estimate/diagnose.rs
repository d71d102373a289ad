//! When the data can't say: no separation, no specular part, nothing that determines it.

use super::course::Grounds;
use super::fast::{CoarseFit, Fit};
use super::misfit::Misfit;
use super::observations::{Observations, Seen};
use super::relief::RefinedSurface;
use super::shading::Agreement;
use super::state::State;
use super::suspects::{Suspect, Suspicion, determines_roughness};
use super::weights::median;
use rekindle_capture::{Capture, View};
use rekindle_scene::reflectance::{Brdf, Gloss, SpecularModel};
use rekindle_scene::surface::GlossParts;

/// What parts of the surface differ in gloss, to follow the reason for a lobe.
pub fn parts(parts: &GlossParts, sigma: f32) -> String {
    let named = |(k, gloss): (usize, &Gloss)| {
        let share = 100.0 * parts.share(k);
        if gloss.strength > 0.0 {
            let (own, strength) = (sigma * gloss.roughness, gloss.strength);
            format!("σ {own:.4} and {strength:.2} times the strength on {share:.0} %")
        } else {
            format!("none on {share:.0} %")
        }
    };
    let named: Vec<String> = parts.glosses.iter().enumerate().map(named).collect();
    format!("; the gloss differs: {} of the surface", named.join(", "))
}

/// What is taken for granted where parts are metals beside the main lobe, or reflect in colours of their own; to follow the former.
pub fn metals(parts: &GlossParts, main: &Brdf) -> &'static str {
    let mut glosses = parts.glosses.iter();
    let is_metal = |gloss: &Gloss| main.has_metal_beside(&main.at(*gloss));
    if glosses.any(|gloss| is_metal(gloss) || !Gloss::is_white(&gloss.tint)) {
        "; what reflects least is taken for a dielectric, which has the colour of the light, and what reflects so much more for metal"
    } else {
        ""
    }
}

/// A specular model in words.
fn named(model: SpecularModel) -> &'static str {
    match model {
        SpecularModel::Paper => "constant Fresnel and masking",
        SpecularModel::Beckmann => "Beckmann's microfacets",
        SpecularModel::Ggx => "GGX",
        SpecularModel::Metal => "a metal",
    }
}

/// Why one lobe was chosen before another, by what each leaves.
pub fn chosen([(least, best), (more, other)]: [(f64, SpecularModel); 2]) -> String {
    format!(
        "{} leaves {:.0} % of the residual that {} leaves",
        named(best),
        100.0 * least / more.max(f64::MIN_POSITIVE),
        named(other)
    )
}

/// Why a metal was chosen, or not, though another lobe leaves less.
pub const MIRRORS_ALL: &str = "light from all around that a metal mirrors explains views left out better than diffuse colours do";
pub const HAS_DIFFUSE_PART: &str = "diffuse colours explain views left out better than light from all around that a metal would mirror";

/// Fewer surface points seen by two views than this are no basis for an estimate.
const FEWEST_POINTS: usize = 60;

/// Gain in the squared residual per lit cell, over the noise's, below which lights are fitted to noise.
const LEAST_SIGNIFICANCE: f64 = 8.0;

/// Share of the squared differences between views that lights must explain.
pub const LEAST_EXPLAINED: f64 = 0.15;

/// Relative standard error of σ past which it counts as undetermined.
const LARGEST_RELATIVE_ERROR: f32 = 0.3;

/// Part of the differences between views that a coarse fit leaves where the gloss may differ from place to place.
const MOST_UNEXPLAINED: f64 = 0.35;
/// And where the normals may be off, which is tried then: sound captures leave up to 0.14, scanned meshes 0.32 and more, those
/// decimated tenfold 0.6.
const MOST_OF_GOOD_NORMALS: f64 = 0.2;

/// Misfit past which a fit is doubted. Sound path-traced captures have none at all; normals off by 0.7° have 0.024, and σ is
/// then 2 % off.
const MOST_MISFIT: f64 = 0.02;
/// Correlation of neighbouring residuals, or misfit, from which what is wrong is looked for, which costs time: sound captures
/// without interreflection have up to 0.07, those with a cause to be named 0.14 and more.
const MIDDLING_CORRELATION: f64 = 0.1;

/// Part of the misfit that turned normals have to explain for them to be named as its cause.
const MOSTLY: f64 = 0.5;

/// A lobe whose σ is below this part of the turn from pixel to pixel is not resolved. Averaging over a pixel adds a twelfth of the turn's
/// square to σ²: so much here that σ comes out a tenth too large, which is 5 % of roughness.
const LEAST_RESOLVED: f32 = 0.69;
/// Pixels of a view whose turn is looked at, about.
const TURNS_PER_VIEW: usize = 20_000;

/// A lobe wider than this, in radians, is no highlight: it spans most of the hemisphere.
const WIDEST_LOBE: f32 = 0.5;

/// Light that fills more than this solid angle, in steradians, is broad: a disc of 32° radius does.
const BROAD_LIGHT: f64 = 1.0;

/// Gain of the best of the roughnesses over the broadest below which none of them stands out.
const LEAST_SHARPNESS: f64 = 0.05;

/// What is said where no specular part is found.
pub const NO_SPECULAR: &str = "No specular part was found: no lights explain how the views differ. Either the object is purely diffuse, \
    or its highlights are smaller than a pixel or clipped, or the cameras are off by more than a highlight is wide. Everything is \
    taken as diffuse.";

/// What is said where a stated roughness is all that says that there is gloss.
const STATED: &str = "The photographs do not show that the surface is glossy: the lights are those that explain most at the \
    roughness that was stated. Some of them may not have been there.";
const STATED_UNDER_SHADING: &str = "That the surface is glossy was stated; under lights from anywhere the photographs do not show it. The \
    lighting was taken from the shading, as if the texture were even, and the gloss is as strong as the photographs allow under it, but not \
    below the 1 % that any glossy surface reflects. Lights may be wider than they were.";

/// What is said where the light is what the shading says, and the gloss bears that out.
const UNDER_SHADING: &str = "The gloss is faint and wide: lights that explain it alone make the texture less even, and the lighting that makes it \
    even explains the gloss nearly as well. So the lighting was taken from the shading. Lights may be wider than they were.";

/// What is said where the light is what the shading says.
pub const BY_SHADING: &str = "The lighting was taken from the shading alone, as if the texture were even: it is white on the \
    whole, and its strength is open. Lights may be wider and weaker or stronger than they were.";

/// What is said where highlights on few parts tell of lights, and the shading of how strong they are.
const STRENGTHS_BY_SHADING: &str = "Only few parts of the surface are glossy. They tell the roughness and where lights are that they mirror; how \
    strong lights are, and those that they don't mirror, were taken from the shading, as if the texture were even.";

/// What is said where the light is what the diffuse part says of an object that turns before it.
pub const BY_DIFFUSE: &str = "The lighting was taken from how the diffuse part changes as the object turns: it is white, and its strength is \
    open. Small lights may be wider than they were.";

/// What is said where gloss mirrors broad light only.
const UNDER_BROAD_LIGHT: &str = "The gloss shows no single lights but broad light, such as that of a window, a sky or a room: its lighting has \
    no detail sharp enough to tell its own blur from the surface's roughness. It was taken as smooth as the views that were left out say, and \
    the middle of the roughnesses that explain them as well. State the roughness if you know it, or add a lamp.";

/// What to doubt about what says that there is gloss.
pub fn grounds(grounds: Grounds) -> Option<&'static str> {
    match grounds {
        Grounds::Views => None,
        Grounds::FewParts => Some(STRENGTHS_BY_SHADING),
        Grounds::Stated => Some(STATED),
        Grounds::StatedUnderShading => Some(STATED_UNDER_SHADING),
        Grounds::Shading => Some(UNDER_SHADING),
        Grounds::BroadLight => Some(UNDER_BROAD_LIGHT),
    }
}

/// Why diffuse and specular parts can't be told apart in this capture, if they can't.
pub fn unseparable(capture: &Capture, observations: &Observations) -> Option<String> {
    let common = observations.points.len();
    if capture.views.len() == 1 {
        return Some(
            "There is a single view: nothing tells a highlight from the texture. The whole image is taken as \
             diffuse. Add views from other directions."
                .to_owned(),
        );
    }
    (common < FEWEST_POINTS).then(|| {
        format!(
            "Only {common} sampled surface points are seen clearly by two views or more: highlights can't be told \
             from the texture. Everything is taken as diffuse. Add views that overlap, or check that the mesh and \
             the cameras share one frame."
        )
    })
}

/// Whether a coarse fit explains so much of the differences between views, with so few lights, that no other look is needed.
pub fn explains_much(state: &State<'_>) -> bool {
    let rows = state.residuals.values.len() as f64;
    let lit = state.lit().len() as f64;
    let (dark, left) = (state.dark_objective(), state.objective());
    let explained = 1.0 - left / dark.max(f64::MIN_POSITIVE);
    let significance = (dark - left) / lit.max(1.0) / (left / rows).max(f64::MIN_POSITIVE);
    lit > 0.0 && explained >= LEAST_EXPLAINED && significance >= LEAST_SIGNIFICANCE
}

/// What is said of a metal.
pub const METAL: &str = "The surface reflects as a metal does. Its colour can't be told from that of the light, which is taken as white: \
    new light is coloured as the captured lighting is.";

/// What is said where the user wanted the result before it had settled.
pub const ENDED_EARLY: &str =
    "The estimation was ended before it had settled: roughness and lights are preliminary.";

/// What is said where smoother surfaces would do as well.
pub const OPEN: &str = "The lighting has no detail sharp enough to tell its own blur from the surface's roughness, as under a wide \
    window or sky: a smoother surface under wider lights explains the photographs as well. The middle of what they allow was taken. \
    State the roughness if you know it, or add a lamp.";

/// Whether a coarse fit's light is broad.
pub fn is_broad(coarse: &State<'_>) -> bool {
    coarse.light_extent() > BROAD_LIGHT
}

/// Whether a coarse fit leaves open how smooth the surface is: no roughness stands out, or its lights are so broad, or its lobe,
/// that a smoother surface does as well.
pub fn is_open(coarse: &CoarseFit<'_>) -> bool {
    let broad = coarse.state.brdf.sigma > WIDEST_LOBE;
    let open = || is_broad(&coarse.state) && !determines_roughness(&coarse.state);
    broad || coarse.sharpness < LEAST_SHARPNESS || open()
}

/// Whether a coarse fit leaves so much that the gloss may differ from place to place.
pub fn leaves_much(state: &State<'_>) -> bool {
    state.unexplained_share() > MOST_UNEXPLAINED
}

/// Whether a coarse fit leaves so much that light may come from where none is sought: before normals are blamed for it, or gloss.
pub fn may_lack_light(state: &State<'_>) -> bool {
    state.unexplained_share() > MOST_OF_GOOD_NORMALS
}

/// Whether a coarse fit leaves so much that the normals may be off, and more than noise does.
pub fn blames_normals(state: &State<'_>) -> bool {
    state.unexplained_share() > MOST_OF_GOOD_NORMALS && Misfit::of(state).tilt.explained > 0.0
}

/// With what begins what is said where the surface was refined.
pub const OFF_NORMALS: &str = "The mesh's normals are off by more than the highlights allow";

/// What is said where the surface was refined.
pub fn refined(surface: &RefinedSurface) -> String {
    format!(
        "{OFF_NORMALS}: it is too coarse, or noisy as scans are. A smooth surface \
         through it was refined by the highlights, which turned the normals by {:.1}° in the median; the solution holds this \
         surface. A mesh with the object's normals gives better results.",
        surface.median_tilt.to_degrees()
    )
}

/// Whether a fit leaves so much that is no noise that what is wrong should be looked for.
pub fn is_middling(misfit: &Misfit) -> bool {
    leaves_misfit(misfit) || misfit.correlation > MIDDLING_CORRELATION
}

/// Whether a suspicion changes what is said of a fit whose σ noise leaves unsure by a part `by_noise`. A view that holds most of a highlight
/// decides what the others are fitted to, so that they are fitted better without it whether it is right or not: that counts
/// only where something is left to be explained, or where σ changes by more than noise would change it.
pub fn is_worth_saying(suspicion: &Suspicion, misfit: &Misfit, by_noise: f32) -> bool {
    match suspicion.suspect {
        Suspect::View(_) => {
            misfit.share > MOST_MISFIT || (suspicion.sigma_ratio - 1.0).abs() > by_noise
        }
        _ => true,
    }
}

/// Whether a fit leaves more than noise unexplained.
pub fn leaves_misfit(misfit: &Misfit) -> bool {
    misfit.share > MOST_MISFIT
}

/// Whether it is to be doubted for that: what is left may come of much that changes no light, but where the shading has other lights, or
/// nobody has asked, it may come of these.
pub fn is_doubted(misfit: &Misfit, agreement: Option<Agreement>) -> bool {
    leaves_misfit(misfit) && !agreement.is_some_and(|agreement| agreement.is_close())
}

/// What to say of a fit that leaves more than noise unexplained.
pub fn misfit(misfit: &Misfit, agreement: Option<Agreement>) -> Option<String> {
    leaves_misfit(misfit).then(|| {
        let share = 100.0 * misfit.share;
        let tilt = &misfit.tilt;
        let cause = if tilt.explained > MOSTLY {
            ", so they are probably off. Use a mesh with the object's normals, or a smoother one."
        } else {
            "; the rest may be gloss that changes from place to place or is of another form, cameras that are off, or light that was \
             not the same in all views, as on an object that was turned."
        };
        let verdict = if is_doubted(misfit, agreement) {
            ", and are not to be trusted"
        } else {
            ""
        };
        let witness = agreement.map_or_else(String::new, of_shading);
        format!(
            "Roughness and lights leave {share:.0} % of the differences between views unexplained, beyond the noise{verdict}. \
             Normals turned by about {:.1}° would explain {:.0} % of that{cause}{witness}",
            tilt.angle.to_degrees(),
            100.0 * tilt.explained
        )
    })
}

/// What the shading says of the lights.
fn of_shading(agreement: Agreement) -> String {
    let verdict = if agreement.is_close() {
        "bears the lights out"
    } else {
        "contradicts the lights"
    };
    format!(
        " The shading, which had no say in it, {verdict}: it has them up to {:.1}° away, and {:.0} % of their flux in others.",
        agreement.apart.to_degrees(),
        100.0 * agreement.elsewhere
    )
}

/// What to doubt where a changed assumption explains the photographs, which are `views`, better; `stated` is the distance of
/// the lights that was stated.
pub fn suspicion(suspicion: &Suspicion, stated: Option<f32>, views: &[View]) -> String {
    let (explanation, remedy) = match suspicion.suspect {
        Suspect::Distant => (
            format!(
                "Distant lights explain the photographs better than lights at the stated distance of {}",
                stated.unwrap_or(0.0)
            ),
            "Leave the lights' radius out, or correct it.".to_owned(),
        ),
        Suspect::Near(radius) => (
            match stated {
                Some(stated) => format!(
                    "Lights at a distance of about {radius:.3} explain the photographs better than at the stated {stated}"
                ),
                None => format!(
                    "Lights at a distance of about {radius:.3} explain the photographs better than distant ones"
                ),
            },
            "Measure the lights' distance from the object's centre and state it as the radius.".to_owned(),
        ),
        Suspect::Encoded => (
            "The pictures' values are probably not linear: decoded as a display's, they are explained better".to_owned(),
            "Save the pictures with linear values, without a curve or view transform.".to_owned(),
        ),
        Suspect::Decoded => (
            "The pictures' values are probably not linear: it is as if a display's curve had been taken off twice".to_owned(),
            "Save the pictures with linear values.".to_owned(),
        ),
        Suspect::Lobe(model) => (
            format!(
                "Another lobe than the one asked for explains the photographs better: {}",
                named(model)
            ),
            "Ask for that one, or leave the choice to the program.".to_owned(),
        ),
        Suspect::View(odd) => (
            format!(
                "The view {} contradicts the others, which are explained better without it",
                views.get(odd).map_or("", |view| view.name.as_str())
            ),
            "Check its camera, its focus, and whether the light was the same; or leave it out.".to_owned(),
        ),
    };
    // What the other views leave is told apart by ranks; its sum says little.
    let by = match suspicion.suspect {
        Suspect::View(_) => String::new(),
        _ => format!(
            " (a first look leaves {:.0} % of what it leaves otherwise)",
            100.0 * suspicion.leaves
        ),
    };
    format!("{explanation}{by}. Roughness and lights are not to be trusted. {remedy}")
}

/// What to doubt about a lobe that is narrower than the normals that one pixel shows: pixels average the highlight away, and
/// no one shows how bright or how wide it is.
pub fn unresolved(seen: &Seen<'_>, fit: &Fit) -> Option<String> {
    let turn = turn_per_pixel(seen);
    (fit.brdf.sigma < LEAST_RESOLVED * turn).then(|| {
        format!(
            "The highlights are narrower than the pictures resolve: from one pixel to the next the surface turns by {:.1}°, and \
             the lobe's roughness comes out as {:.1}°. Roughness and lights are not to be trusted. Use larger pictures, or \
             come closer.",
            turn.to_degrees(),
            fit.brdf.sigma.to_degrees()
        )
    })
}

/// Median angle between the normals of neighbouring pixels inside the object, radians.
fn turn_per_pixel(seen: &Seen<'_>) -> f32 {
    let mut turns = Vec::new();
    for (view, surface) in seen.views.iter().zip(seen.surfaces) {
        // An odd step falls on all columns in turn.
        let step = surface.interior.len().div_ceil(TURNS_PER_VIEW) | 1;
        for i in (0..surface.interior.len().saturating_sub(1)).step_by(step) {
            let (x, y) = (i as u32 % surface.width, i as u32 / surface.width);
            if x + 1 == surface.width || !surface.interior[i] || !surface.interior[i + 1] {
                continue;
            }
            let normal = |x| Some(surface.point(seen.mesh, &view.camera, x, y)?.normal);
            if let (Some(here), Some(next)) = (normal(x), normal(x + 1)) {
                turns.push(here.angle_between(next));
            }
        }
    }
    median(&mut turns)
}

/// Whether a fit leaves σ open.
pub fn is_undetermined(fit: &Fit) -> bool {
    let relative = fit.sigma_error / fit.brdf.sigma;
    !relative.is_finite() || relative > LARGEST_RELATIVE_ERROR
}
