//! From a capture to a solution: all rooms in their order.

use std::borrow::Cow;
use std::ops::ControlFlow;
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use super::mirrored::{diffuse_guess, without_mirrored};
use super::odd_views::{OddViews, without};
use super::turntable::{SelfLit, lightings};
use super::{
    Fit, HemispherePicture, KnownLight, LightProbe, Skipped, Solution, SolutionLamp, lighting,
    origin,
};
use rekindle_base::math::rounding::round_to_halves;
use rekindle_capture::{Camera, Capture, LightFrame, Mesh, View};
use rekindle_estimate::estimate::{
    Diagnostics, Estimate, EstimateInput, EstimateParams, GivenLight, Interim, Iteration, Observer,
    Stopped, bears_out, estimate, estimate_under, gains_by_lights, left_of_others,
    stands_with_camera, watched,
};
use rekindle_estimate::preflight::{Finding, misplacements, why_misplaced};
use rekindle_estimate::registration::{
    Correction, Registered, corrected, describe, evened, register, within_outlines,
};
use rekindle_relight::{
    Albedo, Ambient, DiffuseTexture, GlossMap, Interreflection, LightOfViews, Lighting, Scene,
    Shader, Surroundings, ViewFit, ViewLight, filled_albedo, light_texture, reconstruct, separate,
};
use rekindle_scene::hemisphere::{
    FromAbove, HemisphereGrid, InitialHemisphere, Lamp, PartialHemisphere, SpecularImage,
    find_lamps, rest,
};
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::shortcuts::{LeftOut, Shortcuts};
use rekindle_scene::surface::{
    Atlas, GlossTexture, MinimumTexture, Occluder, ViewSurface, minimum_texture, wanted_density,
};

/// Texels per pixel, along each side, where a view shows the surface largest.
const TEXELS_PER_PIXEL: f32 = 1.0;
/// Views that may miss a light that the initial hemisphere keeps (the n of 2.2).
const MISSING_VIEWS: usize = 2;
/// Views that are looked from at once, so that all threads are busy, …
const VIEWS_AT_ONCE: usize = 4;
/// … fewer where they have more pixels than this together, so that one may stop between them.
const PIXELS_AT_ONCE: usize = 3_000_000;
/// Side of a hemisphere's picture in pixels.
const PICTURE_SIDE: u32 = 256;

/// Parts of a solve, with the share of the whole that is done when each begins.
const SURFACE: (&str, f32) = ("finding what each view sees", 0.02);
const EXPOSURES: (&str, f32) = ("comparing exposures", 0.05);
const HEMISPHERES: (&str, f32) = ("collecting highlights on the hemisphere", 0.10);
const ESTIMATE: (&str, f32) = ("estimating roughness and lights", 0.15);
const TEXTURE: (&str, f32) = ("reconstructing the texture", 0.70);
const ALBEDO: (&str, f32) = ("separating texture and shading", 0.90);

/// Photographs of an object that turned come out at 35 to 58 dB where lights and albedo are right, and at 20 to 33 dB where they are not.
const ALIKE_DB: f32 = 34.0;

/// What is said where a capture turns out to be of an object that was turned.
const TURNS: &str = "The lights are taken to stand still with the camera, as on a turntable: that explains how the diffuse part \
    differs from view to view, and lights that stand still with the object do not. If it is not so, say that they do (--light-frame world).";

/// What a solve is asked to do.
#[derive(Clone, Copy, Debug)]
pub struct SolveOptions {
    /// Method and specular model.
    pub estimate: EstimateParams,
    /// Frequency of the geodesic hemisphere.
    pub frequency: u32,
    /// Distance of the lights in place of the one that the capture states.
    pub radius: Option<f32>,
    /// What the lights stand still with, in place of what the capture states.
    pub light_frame: Option<LightFrame>,
}

/// Passes an estimation's progress on as a part of the whole.
struct Part<'a> {
    observer: &'a mut dyn Observer,
}

impl Observer for Part<'_> {
    fn progress(&mut self, what: &str, fraction: f32) -> ControlFlow<()> {
        let whole = ESTIMATE.1 + fraction * (TEXTURE.1 - ESTIMATE.1);
        self.observer.progress(what, whole)
    }

    fn iteration(
        &mut self,
        iteration: &Iteration,
        hemisphere: &dyn Fn() -> Vec<[f32; 3]>,
    ) -> ControlFlow<()> {
        self.observer.iteration(iteration, hemisphere)
    }

    fn interim(&mut self, interim: Interim<'_>) {
        self.observer.interim(interim);
    }

    fn enough(&mut self) -> bool {
        self.observer.enough()
    }
}

/// Seconds of each stage.
struct Clock {
    since: Instant,
    stages: Vec<(String, f64)>,
}

impl Clock {
    fn lap(&mut self, stage: &str) {
        self.stages
            .push((stage.to_owned(), self.since.elapsed().as_secs_f64()));
        self.since = Instant::now();
    }
}

/// Solves a capture. `load_s` is how long it took to read, in seconds.
pub fn solve(
    stated: &Capture,
    options: &SolveOptions,
    load_s: f64,
    observer: &mut dyn Observer,
) -> Result<Solution, Stopped> {
    solve_under(stated, options, None, load_s, observer)
}

/// Solves a capture, under `light` where that is known: no light is estimated then, and reflectances are absolute.
pub fn solve_under(
    stated: &Capture,
    options: &SolveOptions,
    light: Option<&LightProbe>,
    load_s: f64,
    observer: &mut dyn Observer,
) -> Result<Solution, Stopped> {
    let mut clock = Clock {
        since: Instant::now(),
        stages: vec![("load".to_owned(), load_s)],
    };
    let mut measured = Measured::new(&stated.mesh, &stated.views, observer, SURFACE)?;
    let given = stated;
    let grid = hemisphere(given, options, light);
    let (framed, turns) = framed(given, options, light, (&measured, &grid), observer)?;
    let (stated, outlined) = within_outlines(&framed, &measured.surfaces);
    let stated = stated.as_ref();
    let (mut capture, mut corrections) = if options.estimate.as_stated {
        (Cow::Borrowed(stated), Vec::new())
    } else {
        measured.registered(stated, (&grid, &options.estimate), observer)?
    };
    let motions = capture.motions();
    let misplaced = measured.misplaced(&capture);
    clock.lap("surface");

    let (pictures, mut minimum) = hemispheres(&capture, &measured, &grid, observer)?;
    clock.lap("hemispheres");

    report(observer, ESTIMATE)?;
    let on = (&measured, &grid);
    let Found {
        estimate: mut found,
        known_light,
        odd,
    } = found(&capture, on, options, light, &misplaced, observer)?;
    capture = as_found(capture, odd.as_ref(), &found.exposures);
    corrections = with_exposures(corrections, &found.exposures);
    if let Some(refined) = &found.refined {
        capture.to_mut().mesh = refined.mesh.clone();
        measured = Measured::new(&capture.mesh, &capture.views, observer, TEXTURE)?;
        minimum = measured.minimum(&capture);
    }
    if light.is_none() && motions.is_none() {
        let input = measured.input(&capture, &grid);
        let on = (&measured, &minimum);
        let part = &mut Part { observer };
        found = without_mirrored(&input, on, &options.estimate, found, part)?;
    }
    let on = (capture.as_ref(), &grid, &minimum);
    let given_light = known_light.as_ref();
    let with = (&options.estimate, given_light);
    let (found, looks) = looks(&mut measured, on, with, found, &mut clock, observer)?;
    let Looks {
        lamps,
        mut texture,
        albedo,
        gloss,
        left_out,
    } = looks;
    let atlas = measured.atlas;

    let unlike = (motions.as_ref()).and_then(|_| unlike_photographs(&texture.fit));
    let misplaced = why_not_placed(&misplaced, odd.as_ref());
    let is_sound = misplaced.is_empty() && unlike.is_none();
    let mut skipped = skipped(&found, &corrections);
    skipped.left_out.extend(left_out);
    round_to_halves(&mut texture.confidence);
    let warnings = [
        given.warnings.clone(),
        outlined.into_iter().collect(),
        turns.into_iter().collect(),
        describe(&corrections),
        atlas.warnings.clone(),
        misplaced,
        odd.map(|odd| odd.warning).into_iter().collect(),
        unlike.into_iter().collect(),
    ];
    Ok(Solution {
        name: stated.name.clone(),
        origin: origin(given, options, light),
        method: found.method,
        brdf: found.brdf,
        chosen_because: found.chosen_because,
        corrections,
        sigma_interval95: found.sigma_interval95,
        known_light,
        light_frame: stated.light_hemisphere.frame.unwrap_or_default(),
        grid: found.grid,
        radiance: found.radiance,
        lamps,
        ambient: albedo.ambient,
        diagnostics: with_warnings(found.diagnostics, is_sound, &warnings),
        fit: Fit {
            misfit: found.misfit,
            ..summarise(&texture.fit)
        },
        skipped,
        timings: clock.stages,
        convergence: found.convergence,
        cameras: cameras(&capture.views),
        mesh: capture.mesh.clone(),
        atlas,
        diffuse: rounded(texture.radiance),
        albedo: rounded(albedo.albedo),
        confidence: texture.confidence,
        gloss,
        pictures,
    })
}

/// The capture with lights that stand still with what the options or it itself say, or with what its diffuse part shows, which is then
/// told.
fn framed<'c>(
    capture: &'c Capture,
    options: &SolveOptions,
    light: Option<&LightProbe>,
    (measured, grid): (&Measured, &HemisphereGrid),
    observer: &mut dyn Observer,
) -> Result<(Cow<'c, Capture>, Option<String>), Stopped> {
    let mut framed = Cow::Borrowed(capture);
    let stated = capture.light_hemisphere.frame;
    if options.light_frame.is_some() && options.light_frame != stated {
        framed.to_mut().light_hemisphere.frame = options.light_frame;
    }
    let is_open = framed.light_hemisphere.frame.is_none() && light.is_none();
    if is_open && stands_with_camera(&measured.input(&framed, grid), observer)? {
        framed.to_mut().light_hemisphere.frame = Some(LightFrame::Camera);
        return Ok((framed, Some(TURNS.to_owned())));
    }
    Ok((framed, None))
}

/// What the surface looks like by itself, and the lamps without which it looks so.
struct Looks {
    lamps: Vec<SolutionLamp>,
    texture: DiffuseTexture,
    albedo: Albedo,
    gloss: Option<GlossTexture>,
    left_out: Vec<LeftOut>,
}

/// The textures under the light that was found, which is looked for once more where an object that turns lights itself.
fn looks(
    measured: &mut Measured,
    (capture, grid, minimum): (&Capture, &HemisphereGrid, &MinimumTexture),
    (params, known_light): (&EstimateParams, Option<&KnownLight>),
    mut found: Estimate,
    clock: &mut Clock,
    observer: &mut dyn Observer,
) -> Result<(Estimate, Looks), Stopped> {
    let mesh = &capture.mesh;
    let surfaces = std::mem::take(&mut measured.surfaces);
    let measured = &*measured;
    let shortcuts = Shortcuts::without(params.avoided);
    let sight = |surfaces| Sight {
        mesh,
        surfaces,
        measured,
        views: &capture.views,
        shortcuts: &shortcuts,
    };
    let motions = capture.motions();
    let gloss_of = |found: &Estimate| gloss(found, mesh, &measured.atlas, minimum);
    let first_gloss = motions.as_ref().and_then(|_| gloss_of(&found));
    let first_gloss = first_gloss.as_ref();
    let self_lit = match &motions {
        Some(motions) => SelfLit::new(
            sight(surfaces.clone()),
            first_gloss,
            &found,
            motions,
            observer,
        )?,
        None => None,
    };
    let mut sent = (self_lit.as_ref()).map_or_else(Vec::new, SelfLit::surroundings);
    if let Some(self_lit) = &self_lit
        && !self_lit.is_borne_out(sight(surfaces.clone()), first_gloss, &sent, observer)?
    {
        sent.clear();
    }
    if let Some(self_lit) = &self_lit
        && !sent.is_empty()
    {
        let input = EstimateInput {
            surfaces: &surfaces,
            ..measured.input(capture, grid)
        };
        let part = &mut Part { observer };
        found = self_lit.without_sent(&input, params, found, &sent, part)?;
    }
    clock.lap("estimate");

    let lamps = name_lamps(&found, known_light.is_some());
    let gloss = gloss_of(&found);
    let light = if let Some(motions) = &motions {
        Light::Turning(lightings(&found, motions), &sent)
    } else {
        let lobe = (found.brdf, known_light);
        let lit = lighting(&found.grid, &found.radiance, &lamps, Vec3::ZERO, lobe);
        Light::Still(lit, Ambient::beside(known_light.is_some()))
    };
    let lobe = (found.brdf, gloss.as_ref());
    let (texture, albedo) = textures(sight(surfaces), lobe, light, minimum, clock, observer)?;
    let looks = Looks {
        lamps,
        texture,
        albedo,
        gloss,
        left_out: shortcuts.counted(),
    };
    Ok((found, looks))
}

/// What is said of photographs of an object that turned, where its albedo under the lights doesn't give them back.
fn unlike_photographs(fit: &[ViewFit]) -> Option<String> {
    let mean = fit.iter().map(|view| view.psnr_db).sum::<f32>() / fit.len().max(1) as f32;
    (mean < ALIKE_DB).then(|| {
        format!(
            "Under the lights that were found the photographs come out at {mean:.0} dB only: how the shading changes as the object turns is \
             not explained, and the lights or the albedo are wrong in part. More or larger photographs help, and so does the same \
             exposure for all."
        )
    })
}

/// The diagnostics with what was said before them; a mesh has to lie where photographs show it, and these have to be given back.
fn with_warnings(found: Diagnostics, is_sound: bool, before: &[Vec<String>]) -> Diagnostics {
    Diagnostics {
        well_posed: found.well_posed && is_sound,
        warnings: [before.concat(), found.warnings].concat(),
        ..found
    }
}

/// Roughness and light.
struct Found {
    estimate: Estimate,
    known_light: Option<KnownLight>,
    /// The views that were left out for it.
    odd: Option<OddViews>,
}

/// Why what is found is not to be trusted for where views are, other than those left out.
fn why_not_placed(misplaced: &[(Option<usize>, Finding)], odd: Option<&OddViews>) -> Vec<String> {
    let is_left_out = |view: usize| odd.is_some_and(|odd| odd.views.contains(&view));
    let kept = misplaced
        .iter()
        .filter(|(view, _)| !view.is_some_and(is_left_out));
    why_misplaced(kept.map(|(_, finding)| finding))
}

/// Roughness and light; under `light` where that is known. Otherwise without views that don't lie where the mesh is or contradict the
/// others, where that explains no less.
fn found(
    capture: &Capture,
    (measured, grid): (&Measured, &HemisphereGrid),
    options: &SolveOptions,
    light: Option<&LightProbe>,
    misplaced: &[(Option<usize>, Finding)],
    observer: &mut dyn Observer,
) -> Result<Found, Stopped> {
    let input = measured.input(capture, grid);
    let (params, observer) = (&options.estimate, &mut Part { observer });
    let of_all = |estimate, known_light| Found {
        estimate,
        known_light,
        odd: None,
    };
    if let Some(probe) = light {
        let given = GivenLight {
            nodes: &|turn| probe.on_nodes(grid, turn),
            turn: probe.turn,
        };
        let under = estimate_under(&input, params, &given, observer)?;
        let brdf = under.estimate.brdf;
        let known = KnownLight::new(probe, under.turn, brdf, under.specular_scale);
        return Ok(of_all(under.estimate, Some(known)));
    }
    let all = estimate(&input, params, observer)?;
    if params.as_stated {
        return Ok(of_all(all, None));
    }
    let misplaced = misplaced.iter().filter_map(|(view, _)| *view);
    let mut odd: Vec<usize> = misplaced.chain(all.odd_view).collect();
    odd.sort_unstable();
    odd.dedup();
    Ok(match without(&input, params, (&all, odd), observer)? {
        Some((estimate, odd)) => Found {
            estimate,
            known_light: None,
            odd: Some(odd),
        },
        None => of_all(all, None),
    })
}

/// The gloss of every texel, where parts of the surface differ.
pub fn gloss(
    found: &Estimate,
    mesh: &Mesh,
    atlas: &Atlas,
    minimum: &MinimumTexture,
) -> Option<GlossTexture> {
    let parts = found.parts.as_ref()?;
    Some(GlossTexture::of_parts(
        parts,
        mesh,
        atlas,
        &minimum.radiance,
    ))
}

/// The light that views were taken under.
enum Light<'a> {
    /// The same for all.
    Still(Lighting, Ambient),
    /// One for each, with the surface as it lights itself, where that is known.
    Turning(Vec<Lighting>, &'a [Surroundings<'a>]),
}

/// What textures are made of.
pub struct Sight<'a> {
    /// The surface.
    pub mesh: &'a Mesh,
    /// What was measured of it.
    pub measured: &'a Measured,
    /// The photographs.
    pub views: &'a [View],
    /// What each view sees.
    pub surfaces: Vec<ViewSurface>,
    /// What may be left out.
    pub shortcuts: &'a Shortcuts,
}

/// The diffuse texture and the pseudo-albedo of what the views see, under the light that was found.
fn textures(
    sight: Sight<'_>,
    (brdf, gloss): (Option<Brdf>, Option<&GlossTexture>),
    light: Light<'_>,
    minimum: &MinimumTexture,
    clock: &mut Clock,
    observer: &mut dyn Observer,
) -> Result<(DiffuseTexture, Albedo), Stopped> {
    let Sight {
        mesh,
        measured: Measured {
            occluder, atlas, ..
        },
        views,
        surfaces,
        shortcuts,
    } = sight;
    watched(observer, |watcher| {
        let stop = watcher.stop();
        let mut observer = watcher;
        report(&mut observer, TEXTURE)?;
        // What is sent there differs from view to view where the light does.
        let interreflection = match &light {
            Light::Still(..) => Interreflection::new(mesh, occluder, brdf),
            Light::Turning(..) => None,
        };
        // What a dielectric mirrors of itself is small: the first guess at its texture will do. A metal's is its highlights.
        let guess = diffuse_guess(brdf, gloss, &minimum.radiance);
        let guess = guess.as_deref().map(|guess| (atlas, guess));
        let surroundings =
            (interreflection.as_ref()).map(|around| Surroundings::new(around, guess, None));
        let scene = Scene {
            mesh,
            occluder,
            brdf,
            gloss: gloss.map(|texture| GlossMap { atlas, texture }),
            surroundings: surroundings.as_ref(),
        };
        let of = |brdf, lighting: &Lighting| {
            let shader = Shader::new(occluder, brdf, lighting).stopped_by(stop);
            ViewLight::new(mesh, atlas, shader)
        };
        let from = |light: LightOfViews<'_>, surfaces| {
            reconstruct(&scene, views, surfaces, atlas, &light, shortcuts)
        };
        let (texture, albedo) = match light {
            Light::Still(lighting, ambient) => {
                let own = of(brdf, &lighting);
                let mut texture = if brdf.is_some() {
                    from(LightOfViews::Same(&own), surfaces)
                } else {
                    // Without gloss no light is to be taken out.
                    from(LightOfViews::Same(&of(None, &lighting.dark())), surfaces)
                };
                clock.lap("texture");
                report(&mut observer, ALBEDO)?;
                let albedo = separate(&scene, atlas, &own.shader, &own.seen, &mut texture, ambient);
                (texture, albedo)
            }
            Light::Turning(lightings, sent) => {
                let own = lightings
                    .iter()
                    .enumerate()
                    .map(|(view, lighting)| ViewLight {
                        surroundings: sent.get(view),
                        ..of(brdf, lighting)
                    });
                let own: Vec<ViewLight<'_>> = own.collect();
                let mut texture = from(LightOfViews::Each(&own), surfaces);
                clock.lap("texture");
                report(&mut observer, ALBEDO)?;
                let albedo = filled_albedo(&scene, atlas, &texture);
                light_texture(&scene, atlas, &own[0], &albedo, &mut texture);
                let ambient = lightings[0].ambient;
                (texture, Albedo { albedo, ambient })
            }
        };
        clock.lap("albedo");
        // What long loops give after a stop is of no use.
        report(&mut observer, ALBEDO)?;
        Ok((texture, albedo))
    })
}

/// From where the photographs were taken, with their names.
fn cameras(views: &[View]) -> Vec<(String, Camera)> {
    let camera = |view: &View| (view.name.clone(), view.whole_camera());
    views.iter().map(camera).collect()
}

fn rounded(mut pixels: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
    round_to_halves(pixels.as_flattened_mut());
    pixels
}

/// What all stages need of a mesh.
pub struct Measured {
    /// The mesh, for shadows.
    pub occluder: Occluder,
    surfaces: Vec<ViewSurface>,
    /// Where each triangle lies in textures.
    pub atlas: Atlas,
}

impl Measured {
    /// Looks at a mesh from all views; progress is reported as of `stage`.
    fn new(
        mesh: &Mesh,
        views: &[View],
        observer: &mut dyn Observer,
        stage: (&str, f32),
    ) -> Result<Self, Stopped> {
        report(observer, stage)?;
        let occluder = Occluder::new(mesh);
        let surfaces = see(mesh, views, &occluder, observer, stage)?;
        let density = wanted_density(mesh, views, &surfaces, TEXELS_PER_PIXEL);
        let atlas = Atlas::new(mesh, &density);
        Ok(Self {
            occluder,
            surfaces,
            atlas,
        })
    }

    /// What is seen of a capture, whose lights are sought on these nodes.
    fn input<'a>(&'a self, capture: &'a Capture, grid: &'a HemisphereGrid) -> EstimateInput<'a> {
        EstimateInput {
            capture,
            surfaces: &self.surfaces,
            occluder: &self.occluder,
            grid,
            first: None,
        }
    }

    /// What is wrong with where cameras and mesh are.
    fn misplaced(&self, capture: &Capture) -> Vec<(Option<usize>, Finding)> {
        let Capture { views, mesh, .. } = capture;
        misplacements(views, &self.surfaces, mesh, &self.occluder)
    }

    /// The least that the views of a capture show of each texel.
    fn minimum(&self, capture: &Capture) -> MinimumTexture {
        minimum_texture(&capture.mesh, &self.atlas, &capture.views, &self.surfaces)
    }

    /// The capture with what does not fit the mesh and the other views corrected, and the corrections; none where all fits.
    fn registered<'c>(
        &mut self,
        stated: &'c Capture,
        (grid, params): (&HemisphereGrid, &EstimateParams),
        observer: &mut dyn Observer,
    ) -> Result<(Cow<'c, Capture>, Vec<Correction>), Stopped> {
        let Registered {
            mut corrections,
            are_even,
        } = register(&stated.mesh, &stated.views, &self.surfaces, &self.occluder);
        let mut capture = corrected(stated, &corrections);
        if corrections.iter().any(Correction::moves) {
            self.surfaces = see(
                &stated.mesh,
                &capture.views,
                &self.occluder,
                observer,
                SURFACE,
            )?;
        }
        if capture.motions().is_some() && corrections.iter().any(Correction::scales) {
            // What differs between views is the light on them.
            corrections = corrections.iter().map(|c| c.of_camera()).collect();
            capture = corrected(stated, &corrections);
        } else if !are_even && (stated.is_developed || corrections.iter().any(Correction::scales)) {
            report(observer, EXPOSURES)?;
            corrections = self.borne_out(stated, corrections, (grid, params), observer)?;
            capture = corrected(stated, &corrections);
        }
        if corrections.iter().all(|c| *c == Correction::default()) {
            corrections.clear();
        }
        Ok((capture, corrections))
    }

    /// Corrections of cameras, with those of exposures that lights bear out: as the views' medians have them, or as the lights themselves do.
    /// The latter count where lights leave less of all views, or else where they predict views left out better: of broad light a view left
    /// out shows what no other has seen, and medians take that for its exposure.
    fn borne_out(
        &self,
        stated: &Capture,
        evened: Vec<Correction>,
        (grid, params): (&HemisphereGrid, &EstimateParams),
        observer: &mut dyn Observer,
    ) -> Result<Vec<Correction>, Stopped> {
        let of_cameras: Vec<Correction> = evened.iter().map(|c| c.of_camera()).collect();
        let left = |corrections: &[Correction], observer: &mut dyn Observer| {
            let capture = corrected(stated, corrections);
            left_of_others(&self.input(&capture, grid), params, observer)
        };
        let mut best = (left(&of_cameras, observer)?, of_cameras);
        if evened.iter().any(Correction::scales) {
            let evened = (left(&evened, observer)?, evened);
            if bears_out(&evened.0, &best.0) {
                best = evened;
            }
        }
        if !stated.is_developed {
            return Ok(best.1);
        }
        let capture = corrected(stated, &best.1);
        let input = self.input(&capture, grid);
        if let Some(told) = gains_by_lights(&input, params, observer)? {
            let own = best.1.iter().zip(&told.gains).map(|(correction, gains)| {
                let before = correction.gains();
                correction.with_gains([0, 1, 2].map(|c| before[c] * gains[c]))
            });
            let own: Vec<Correction> = own.collect();
            if told.leave_less || bears_out(&left(&own, observer)?, &best.0) {
                best.1 = own;
            }
        }
        Ok(best.1)
    }
}

/// How many of some views are looked from at once.
fn at_once(views: &[View]) -> usize {
    let pixels = views.iter().map(|view| view.photograph.usable.len()).max();
    (PIXELS_AT_ONCE / pixels.unwrap_or(0).max(1)).clamp(1, VIEWS_AT_ONCE)
}

/// What all views see of a mesh.
fn see(
    mesh: &Mesh,
    views: &[View],
    occluder: &Occluder,
    observer: &mut dyn Observer,
    stage: (&str, f32),
) -> Result<Vec<ViewSurface>, Stopped> {
    let mut surfaces = Vec::with_capacity(views.len());
    for some in views.chunks(at_once(views)) {
        report(observer, stage)?;
        let seen = some
            .par_iter()
            .map(|view| ViewSurface::new(mesh, occluder, &view.camera));
        surfaces.par_extend(seen);
    }
    report(observer, stage)?;
    Ok(surfaces)
}

/// The capture with exposures evened out as was found, without what odd views show beside others.
fn as_found<'c>(
    capture: Cow<'c, Capture>,
    odd: Option<&OddViews>,
    exposures: &[f64],
) -> Cow<'c, Capture> {
    let shown = odd.map_or(capture, |odd| Cow::Owned(odd.capture.clone()));
    if exposures.is_empty() {
        return shown;
    }
    Cow::Owned(evened(&shown, exposures).into_owned())
}

/// Corrections, if there were any, with what else was found of the views' exposures.
fn with_exposures(mut corrections: Vec<Correction>, exposures: &[f64]) -> Vec<Correction> {
    if exposures.is_empty() {
        return corrections;
    }
    corrections.resize(exposures.len(), Correction::default());
    for (correction, factor) in corrections.iter_mut().zip(exposures) {
        correction.exposure *= factor;
    }
    corrections
}

/// Says that textures are made.
pub fn report_texture(observer: &mut dyn Observer) -> Result<(), Stopped> {
    report(observer, TEXTURE)
}

fn report(observer: &mut dyn Observer, (what, fraction): (&str, f32)) -> Result<(), Stopped> {
    match observer.progress(what, fraction) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Stopped),
    }
}

/// The nodes on which lights are sought, or known.
fn hemisphere(
    capture: &Capture,
    options: &SolveOptions,
    light: Option<&LightProbe>,
) -> HemisphereGrid {
    let stated = capture.light_hemisphere.radius.map(|r| r as f32);
    let above = HemisphereGrid::new(
        options.frequency,
        capture.light_hemisphere.up.as_vec3(),
        options.radius.or(stated),
        capture.mesh.centre(),
    );
    match light {
        Some(probe) => probe.grid(above),
        None => above,
    }
}

/// Pictures of the initial hemisphere and of each view's partial one (2.2).
fn hemispheres(
    capture: &Capture,
    measured: &Measured,
    grid: &HemisphereGrid,
    observer: &mut dyn Observer,
) -> Result<(Vec<HemispherePicture>, MinimumTexture), Stopped> {
    let Measured {
        surfaces, atlas, ..
    } = measured;
    report(observer, HEMISPHERES)?;
    let minimum = measured.minimum(capture);
    observer.interim(Interim::Texture {
        atlas,
        radiance: &minimum.radiance,
    });
    let motions = capture.motions();
    let mut partials: Vec<PartialHemisphere> = Vec::with_capacity(surfaces.len());
    let at_once = at_once(&capture.views);
    let some = capture.views.chunks(at_once).zip(surfaces.chunks(at_once));
    for (views, surfaces) in some {
        report(observer, HEMISPHERES)?;
        let first = partials.len();
        let partial = |(index, (view, surface)): (usize, (&View, &ViewSurface))| {
            let specular = SpecularImage::new(&capture.mesh, atlas, &minimum, view, surface);
            let eye = view.camera.position();
            match &motions {
                Some(motions) => {
                    let motion = &motions[first + index];
                    let eye = motion.transform_point3(eye).as_vec3();
                    specular.moved(motion).partial_hemisphere(grid, eye)
                }
                None => specular.partial_hemisphere(grid, eye.as_vec3()),
            }
        };
        partials.par_extend(views.par_iter().zip(surfaces).enumerate().map(partial));
        for (index, partial) in partials.iter().enumerate().skip(first) {
            observer.interim(Interim::Partial {
                view: index,
                grid,
                radiance: &partial.radiance,
            });
        }
    }
    let missing = MISSING_VIEWS.min(partials.len().saturating_sub(2));
    let initial = InitialHemisphere::new(&partials, missing);
    observer.interim(Interim::Initial {
        grid,
        radiance: &initial.radiance,
    });
    let from_above = FromAbove::new(grid, PICTURE_SIDE);
    let picture = |name: String, radiance: &[[f32; 3]]| {
        let mut picture = from_above.picture(radiance);
        picture.radiance = rounded(picture.radiance);
        HemispherePicture { name, picture }
    };
    let mut pictures = vec![picture("initial".to_owned(), &initial.radiance)];
    for (i, partial) in partials.iter().enumerate() {
        pictures.push(picture(format!("partial_{i:03}"), &partial.radiance));
    }
    Ok((pictures, minimum))
}

/// The lamps with their names. Of a known light nothing is noise: what belongs to no lamp is one of its own.
pub fn name_lamps(found: &Estimate, is_known: bool) -> Vec<SolutionLamp> {
    let named = |name: String, lamp: Lamp| SolutionLamp {
        name,
        direction: lamp.direction,
        flux: lamp.flux.into(),
        angular_radius: lamp.angular_radius,
        nodes: lamp.nodes,
    };
    let mut others = found.radiance.clone();
    for &node in &found.broad_light {
        others[node as usize] = [0.0; 3];
    }
    let mut lamps = find_lamps(&found.grid, &others);
    if is_known {
        lamps.extend(rest(&found.grid, &found.radiance, &lamps));
        lamps.sort_by(|a, b| b.mean_flux().total_cmp(&a.mean_flux()));
    }
    let broad = Lamp::new(&found.grid, &found.radiance, found.broad_light.clone());
    let lamps = lamps.into_iter().enumerate();
    let mut all: Vec<SolutionLamp> = lamps
        .map(|(i, lamp)| named(format!("Light {}", i + 1), lamp))
        .collect();
    all.extend(broad.map(|broad| named("Broad light".to_owned(), broad)));
    all
}

/// What was not done, stages with the reason.
fn skipped(found: &Estimate, corrections: &[Correction]) -> Skipped {
    let brdf = found.brdf;
    let stages = [
        (
            corrections.iter().any(Correction::moves),
            "looking again with cameras turned or moved: outlines fit, or are taken as stated",
        ),
        (
            corrections.iter().any(Correction::scales),
            "solving again with exposures evened out: the views agree, or are taken as stated",
        ),
        (
            brdf.is_none() || found.refined.is_some(),
            "refining the surface: as it is, it explains the highlights",
        ),
        (
            brdf.is_some(),
            "lights and roughness: no specular part was found",
        ),
        (
            brdf.is_none_or(|brdf| brdf.specular_scale().is_some()),
            "interreflection: the specular model leaves its strength open",
        ),
    ];
    let not_run = stages.into_iter().filter(|(run, _)| !run);
    Skipped {
        left_out: found.left_out.clone(),
        stages: not_run.map(|(_, why)| why.to_owned()).collect(),
    }
}

fn summarise(views: &[ViewFit]) -> Fit {
    let squared: f64 = views.iter().map(|v| v.squared).sum();
    let count: usize = views.iter().map(|v| v.count).sum();
    Fit {
        residual_rms: (squared / count.max(1) as f64).sqrt(),
        psnr_db_per_view: views.iter().map(|v| v.psnr_db).collect(),
        misfit: None,
    }
}
