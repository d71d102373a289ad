//! Light that casts no highlight: a uniform ambient part that only the diffuse texture shows.
//!
//! Where irradiance falls from E₁ to E₂ within a small distance, in a shadow or on a side that is turned away, the albedo mostly
//! does not: ρ₁ = D₁/(E₁ + a) and ρ₂ = D₂/(E₂ + a) are alike, with a the ambient irradiance. So a is where the contrasts
//! |ρ₁ − ρ₂|/(ρ₁ + ρ₂) of all such pairs of places have the least sum. The texture's own edges do not move it: they are as
//! often brighter on one side as on the other. There is ambient light only if it makes contrasts less beyond chance.

use glam::Vec3;
use rayon::prelude::*;
use rekindle_base::math::ranks::{SURE, signed_ranks};

/// Edges to walk at most from a place to a darker one.
const STEPS: usize = 12;
/// Part of the irradiance at which a walk is at its end, …
const SHADOWED: f32 = 0.15;
/// … and of which its end may have most: a pair of places that are lit alike says little.
const DARKER: f32 = 0.7;
/// Part of the typical irradiance that the lit end must have.
const LIT: f32 = 0.25;
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

/// Mean diffuse radiance and irradiance around each place of the mesh; `None` where no view saw it.
pub(super) struct Lit {
    pub radiance: Vec3,
    pub irradiance: Vec3,
}

/// One channel of a place that is lit and of one nearby that is lit less.
struct Pair {
    radiance: [f32; 2],
    irradiance: [f32; 2],
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

/// The ambient irradiance, RGB. `around` lists the neighbours of a place, `typical` is the irradiance of a well-lit one.
pub(super) fn ambient_irradiance<'a>(
    places: &[Option<Lit>],
    around: &(dyn Fn(usize) -> &'a [u32] + Sync),
    typical: f32,
) -> Vec3 {
    let pairs: Vec<(&Lit, &Lit)> = (0..places.len())
        .into_par_iter()
        .filter_map(|p| {
            let lit = places[p].as_ref()?;
            if mean(lit.irradiance) < LIT * typical {
                return None;
            }
            let darker = places[walk_down(places, around, p)?].as_ref()?;
            Some((lit, darker))
        })
        .collect();
    if pairs.len() < MIN_PAIRS {
        return Vec3::ZERO;
    }
    let of = |channel: &(dyn Fn(Vec3) -> f32 + Sync)| -> Vec<Pair> {
        let pair = |&(lit, darker): &(&Lit, &Lit)| Pair {
            radiance: [lit, darker].map(|place| channel(place.radiance).max(0.0)),
            irradiance: [lit, darker].map(|place| channel(place.irradiance)),
        };
        pairs.par_iter().map(pair).collect()
    };
    let gray = of(&mean);
    let found = least_contrast(&gray, typical);
    let contrasts = |ambient| -> Vec<f64> { gray.iter().map(|p| p.contrast(ambient)).collect() };
    if found < SIGNIFICANT * typical || signed_ranks(&contrasts(0.0), &contrasts(found)) <= SURE {
        return Vec3::ZERO;
    }
    Vec3::from([0, 1, 2].map(|channel| least_contrast(&of(&|v: Vec3| v[channel]), typical)))
}

/// The ambient irradiance under which the contrasts have the least sum.
fn least_contrast(pairs: &[Pair], typical: f32) -> f32 {
    let sum = |ambient: f32| -> f64 {
        pairs
            .par_chunks(4096)
            .map(|some| some.iter().map(|p| p.contrast(ambient)).sum::<f64>())
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

/// The last place on the way from `start` down the steepest descent of irradiance, if it is clearly darker.
fn walk_down<'a>(
    places: &[Option<Lit>],
    around: &(dyn Fn(usize) -> &'a [u32] + Sync),
    start: usize,
) -> Option<usize> {
    let irradiance = |p: usize| places[p].as_ref().map(|lit| mean(lit.irradiance));
    let first = irradiance(start)?;
    let (mut here, mut least) = (start, first);
    for _ in 0..STEPS {
        let next = around(here)
            .iter()
            .filter_map(|&n| irradiance(n as usize).map(|e| (n as usize, e)))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        match next {
            Some((darkest, e)) if e < least => (here, least) = (darkest, e),
            _ => break,
        }
        if least <= SHADOWED * first {
            break;
        }
    }
    (least <= DARKER * first).then_some(here)
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
                let albedo = if (x / 5 + y / 5) % 2 == 0 { 0.6 } else { 0.2 };
                let lit = ((x as f32 - 17.0) / 6.0).clamp(darkest, 1.0);
                let irradiance = Vec3::new(3.0, 2.0, 1.0) * lit;
                places.push(Some(Lit {
                    radiance: albedo * (irradiance + ambient),
                    irradiance,
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
                })
            })
            .collect();
        let one = ambient_irradiance(&places, &|p| around[p].as_slice(), 2.0);
        let other = ambient_irradiance(&scaled, &|p| around[p].as_slice(), 2e-4);
        assert!((other * 1e4 - one).length() < 1e-4, "{one} and {other}");
    }
}
