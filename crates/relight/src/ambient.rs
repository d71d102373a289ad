//! Light that casts no highlight: a uniform ambient part that only the diffuse texture shows.
//!
//! Where irradiance falls from E₁ to E₂ within a small distance, in a shadow or on a side that is turned away, the albedo mostly
//! does not: ρ₁ = D₁/(E₁ + a) and ρ₂ = D₂/(E₂ + a) are alike, with a the ambient irradiance. So a is where the contrasts
//! |ρ₁ − ρ₂|/(ρ₁ + ρ₂) of all such pairs of places have the least sum. The texture's own edges do not move it: they are as
//! often brighter on one side as on the other. Each dark place counts by its area, however many pairs it is the end of, so that
//! a mesh that is dense in its creases does not let these decide. There is ambient light only if it makes contrasts less beyond chance.

use glam::Vec3;
use rayon::prelude::*;
use rekindle_base::math::ranks::{SURE, weighted_signed_ranks};

/// Edges to walk at most from a place to a darker one.
const STEPS: usize = 12;
/// Part of the irradiance at which a walk is at its end, …
const SHADOWED: f32 = 0.15;
/// … and of which its end may have most: a pair of places that are lit alike says little.
const DARKER: f32 = 0.7;
/// Part of the typical irradiance that the lit end must have.
const LIT: f32 = 0.25;
/// Rings of neighbours around the dark end that are as dark: at the rim of a shadow, or in a crease, a pixel is off by more light
/// than an ambient part has.
const RIM: usize = 2;
/// Pairs below which nothing is said.
const MIN_PAIRS: usize = 64;
/// Ambient irradiance below this part of the typical one is taken for error of what was subtracted before.
const SIGNIFICANT: f32 = 0.03;
/// Ambient irradiances that are compared, as parts of the typical one: the least, the most and the step. The minimum is then
/// found to so many steps of a part of that.
const LEAST: f32 = 0.01;
const MOST: f32 = 10.0;
const STEP: f32 = 1.25;
const FINER: i32 = 8;

/// Mean diffuse radiance and irradiance around a place of the mesh, and the area that it stands for.
pub(super) struct Lit {
    pub radiance: Vec3,
    pub irradiance: Vec3,
    /// Of that what comes straight from lights, in the mean over channels.
    pub direct: f32,
    pub area: f32,
}

/// One channel of a place that is lit and of one nearby that is lit less.
struct Pair {
    radiance: [f32; 2],
    irradiance: [f32; 2],
    weight: f64,
}

impl Pair {
    /// Contrast of the albedos under an ambient irradiance, 0 to 1.
    fn contrast(&self, ambient: f32) -> f64 {
        let [bright, dark] = self.irradiance.map(|e| e + ambient);
        let (one, other) = (self.radiance[0] * dark, self.radiance[1] * bright);
        let sum = one + other;
        if sum > 0.0 {
            f64::from((one - other).abs() / sum)
        } else {
            0.0
        }
    }
}

/// The ambient irradiance, RGB. A place is `None` where no view saw it, `around` lists the neighbours of a place, `typical` is
/// the irradiance of a well-lit one.
pub(super) fn ambient_irradiance<'a>(
    places: &[Option<Lit>],
    around: &(dyn Fn(usize) -> &'a [u32] + Sync),
    typical: f32,
) -> Vec3 {
    let brightest = brightest_around(places, around);
    let walks: Vec<(usize, usize)> = (0..places.len())
        .into_par_iter()
        .filter(|&p| matches!(&places[p], Some(lit) if mean(lit.irradiance) >= LIT * typical))
        .filter_map(|p| Some((p, walk_down(places, &brightest, around, p)?)))
        .collect();
    if walks.len() < MIN_PAIRS {
        return Vec3::ZERO;
    }
    let mut ending = vec![0_u32; places.len()];
    for &(_, end) in &walks {
        ending[end] += 1;
    }
    let of = |channel: &(dyn Fn(Vec3) -> f32 + Sync)| -> Vec<Pair> {
        let pair = |&(start, end): &(usize, usize)| {
            let ends = [places[start].as_ref()?, places[end].as_ref()?];
            Some(Pair {
                radiance: ends.map(|lit| channel(lit.radiance).max(0.0)),
                irradiance: ends.map(|lit| channel(lit.irradiance)),
                weight: f64::from(ends[1].area) / f64::from(ending[end]),
            })
        };
        walks.par_iter().filter_map(pair).collect()
    };
    let gray = of(&mean);
    let found = least_contrast(&gray, typical);
    let contrasts = |ambient| -> Vec<f64> {
        let weighted = gray.iter().map(|p| p.weight * p.contrast(ambient));
        weighted.collect()
    };
    let weights: Vec<f64> = gray.iter().map(|p| p.weight).collect();
    let sure = || weighted_signed_ranks(&weights, &contrasts(0.0), &contrasts(found)) > SURE;
    if found < SIGNIFICANT * typical || !sure() {
        return Vec3::ZERO;
    }
    Vec3::from([0, 1, 2].map(|channel| least_contrast(&of(&|v: Vec3| v[channel]), typical)))
}

/// The ambient irradiance under which the contrasts have the least weighted sum.
fn least_contrast(pairs: &[Pair], typical: f32) -> f32 {
    let sum = |ambient: f32| -> f64 {
        pairs
            .par_chunks(4096)
            .map(|some| {
                some.iter()
                    .map(|p| p.weight * p.contrast(ambient))
                    .sum::<f64>()
            })
            .collect::<Vec<_>>()
            .iter()
            .sum()
    };
    let least = |values: &mut dyn Iterator<Item = f32>| {
        let with_sums = values.map(|a| (a, sum(a)));
        let least = with_sums.min_by(|a, b| a.1.total_cmp(&b.1));
        least.map_or(0.0, |(a, _)| a)
    };
    let steps = ((MOST / LEAST).ln() / STEP.ln()) as i32;
    let coarse = (0..=steps).map(|k| LEAST * typical * STEP.powi(k));
    let found = least(&mut std::iter::once(0.0).chain(coarse));
    let finer = STEP.powf(1.0 / FINER as f32);
    least(&mut (-FINER..=FINER).map(|k| found * finer.powi(k)))
}

fn mean(v: Vec3) -> f32 {
    v.element_sum() / 3.0
}

/// The most irradiance within [`RIM`] rings of each place, mean over channels; `None` where no view saw the place.
fn brightest_around<'a>(
    places: &[Option<Lit>],
    around: &(dyn Fn(usize) -> &'a [u32] + Sync),
) -> Vec<Option<f32>> {
    let own = |place: &Option<Lit>| place.as_ref().map(|lit| mean(lit.irradiance));
    let mut brightest: Vec<Option<f32>> = places.iter().map(own).collect();
    for _ in 0..RIM {
        let widened = |p: usize| {
            let near = around(p).iter().filter_map(|&n| brightest[n as usize]);
            brightest[p].map(|own| near.fold(own, f32::max))
        };
        brightest = (0..places.len()).into_par_iter().map(widened).collect();
    }
    brightest
}

/// The last place on the way from `start` down the steepest descent of the irradiance around, if it is clearly darker. Where all
/// around is lit alike, the place's own irradiance says which way is down.
fn walk_down<'a>(
    places: &[Option<Lit>],
    brightest: &[Option<f32>],
    around: &(dyn Fn(usize) -> &'a [u32] + Sync),
    start: usize,
) -> Option<usize> {
    let height = |p: usize| Some((brightest[p]?, mean(places[p].as_ref()?.irradiance)));
    let below = |a: &(f32, f32), b: &(f32, f32)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1));
    let mut least = height(start)?;
    let (mut here, first) = (start, least.1);
    for _ in 0..STEPS {
        let next = around(here)
            .iter()
            .filter_map(|&n| Some((n as usize, height(n as usize)?)))
            .min_by(|a, b| below(&a.1, &b.1));
        match next {
            Some((darkest, e)) if below(&e, &least).is_lt() => (here, least) = (darkest, e),
            _ => break,
        }
        if least.0 <= SHADOWED * first {
            break;
        }
    }
    (least.0 <= DARKER * first).then_some(here)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of places with checkered albedo, half of it in shadow with a soft edge, under this ambient irradiance.
    fn scene(ambient: Vec3) -> (Vec<Option<Lit>>, Vec<Vec<u32>>) {
        turned(ambient, 0.0)
    }

    /// The same where irradiance falls no further than to a part of the brightest.
    fn turned(ambient: Vec3, darkest: f32) -> (Vec<Option<Lit>>, Vec<Vec<u32>>) {
        const SIDE: usize = 40;
        let mut places = Vec::new();
        let mut around = Vec::new();
        for y in 0..SIDE {
            for x in 0..SIDE {
                // Oblique checks, so that a walk across the shadow's edge crosses one of theirs only now and then.
                let check = (x + 2 * y) / 20 + (2 * x + SIDE - y) / 20;
                let albedo = if check.is_multiple_of(2) { 0.6 } else { 0.2 };
                let lit = ((x as f32 - 17.0) / 6.0).clamp(darkest, 1.0);
                let irradiance = Vec3::new(3.0, 2.0, 1.0) * lit;
                places.push(Some(Lit {
                    radiance: albedo * (irradiance + ambient),
                    irradiance,
                    direct: mean(irradiance),
                    area: 1.0,
                }));
                let mut near = Vec::new();
                for (dx, dy) in [(0, 1), (1, 0), (2, 1), (1, 2)] {
                    let (nx, ny) = (x + dx, y + dy);
                    if (1..=SIDE).contains(&nx) && (1..=SIDE).contains(&ny) {
                        near.push(((ny - 1) * SIDE + nx - 1) as u32);
                    }
                }
                around.push(near);
            }
        }
        (places, around)
    }

    #[test]
    fn ambient_light_is_read_off_the_shadows() {
        let ambient = Vec3::new(0.2, 0.3, 0.1);
        let (places, around) = scene(ambient);
        let found = ambient_irradiance(&places, &|p| around[p].as_slice(), 2.0);
        assert!((found - ambient).abs().max_element() < 0.02, "{found}");
    }

    #[test]
    fn ambient_light_is_read_off_sides_that_are_turned_away() {
        let ambient = Vec3::new(0.2, 0.3, 0.1);
        let (places, around) = turned(ambient, 0.5);
        let found = ambient_irradiance(&places, &|p| around[p].as_slice(), 2.0);
        assert!((found - ambient).abs().max_element() < 0.02, "{found}");
    }

    #[test]
    fn dark_lines_that_pixels_blur_are_no_ambient_light() {
        // Lines one place wide, as creases are: hardly any light arrives in them, but a pixel there shows what is beside them.
        let (mut places, around) = scene(Vec3::ZERO);
        for (i, lit) in places.iter_mut().flatten().enumerate() {
            if i % 40 > 20 && i % 40 % 6 == 0 {
                lit.irradiance *= 0.02;
                lit.radiance *= 0.5;
            }
        }
        let found = ambient_irradiance(&places, &|p| around[p].as_slice(), 2.0);
        assert_eq!(found, Vec3::ZERO);
    }

    #[test]
    fn where_the_mesh_is_dense_counts_by_its_area() {
        // Half of the object is in places of a thousandth of the area, and there the shadows are not black.
        let (mut places, around) = scene(Vec3::ZERO);
        let (blurred, _) = scene(Vec3::splat(0.5));
        for (i, (lit, blurred)) in places.iter_mut().zip(blurred).enumerate() {
            if i / 40 > 16 {
                let blurred = blurred.map(|b| Lit { area: 1e-3, ..b });
                *lit = blurred;
            }
        }
        let found = ambient_irradiance(&places, &|p| around[p].as_slice(), 2.0);
        assert_eq!(found, Vec3::ZERO);
    }

    #[test]
    fn black_shadows_have_no_ambient_light() {
        let (places, around) = scene(Vec3::ZERO);
        let found = ambient_irradiance(&places, &|p| around[p].as_slice(), 2.0);
        assert_eq!(found, Vec3::ZERO);
    }

    #[test]
    fn ambient_light_scales_with_the_pictures() {
        let (places, around) = scene(Vec3::splat(0.2));
        let scaled: Vec<Option<Lit>> = places
            .iter()
            .flatten()
            .map(|lit| {
                Some(Lit {
                    radiance: lit.radiance * 1e-4,
                    irradiance: lit.irradiance * 1e-4,
                    direct: lit.direct * 1e-4,
                    area: lit.area,
                })
            })
            .collect();
        let one = ambient_irradiance(&places, &|p| around[p].as_slice(), 2.0);
        let other = ambient_irradiance(&scaled, &|p| around[p].as_slice(), 2e-4);
        assert!((other * 1e4 - one).length() < 1e-4, "{one} and {other}");
    }
}
