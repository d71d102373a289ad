//! Light that casts no highlight: a uniform ambient part that only the diffuse texture shows.
//!
//! Where a shadow falls, irradiance drops from E₁ to E₂ within a small distance and the albedo mostly does not:
//! D₁/(E₁ + a) = D₂/(E₂ + a), with a the ambient irradiance. Every such pair of places says
//! a = (D₂E₁ − D₁E₂)/(D₁ − D₂). The median over all pairs is not moved by the texture's own edges, which are as
//! often brighter on one side as on the other; the quartile says whether the pairs agree that there is any.

use glam::Vec3;
use rayon::prelude::*;

/// Edges to walk at most from the light into the shadow.
const STEPS: usize = 12;
/// Part of the irradiance that the shadowed end of a pair may have.
const SHADOWED: f32 = 0.15;
/// Part of the typical irradiance that the lit end must have.
const LIT: f32 = 0.25;
/// Pairs below which nothing is said.
const MIN_PAIRS: usize = 64;
/// Ambient irradiance below this part of the typical one is taken for error of what was subtracted before.
const SIGNIFICANT: f32 = 0.03;

/// Mean diffuse radiance and irradiance around each place of the mesh; `None` where no view saw it.
pub(super) struct Lit {
    pub radiance: Vec3,
    pub irradiance: Vec3,
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
            let shadowed = places[walk_into_shadow(places, around, p)?].as_ref()?;
            Some((lit, shadowed))
        })
        .collect();
    if pairs.len() < MIN_PAIRS {
        return Vec3::ZERO;
    }
    // Quotients with their weights: a pair says the more the larger the step of its radiance.
    let quantile = |part: f32, of: &(dyn Fn(Vec3) -> f32 + Sync)| {
        let mut said: Vec<f32> = pairs
            .par_iter()
            .filter_map(|(lit, shadowed)| {
                let (d1, d2) = (of(lit.radiance), of(shadowed.radiance));
                let (e1, e2) = (of(lit.irradiance), of(shadowed.irradiance));
                (d1 > d2).then(|| (d2 * e1 - d1 * e2) / (d1 - d2))
            })
            .collect();
        if said.len() < MIN_PAIRS {
            return 0.0;
        }
        let at = ((said.len() - 1) as f32 * part) as usize;
        *said.select_nth_unstable_by(at, f32::total_cmp).1
    };
    if quantile(0.25, &mean) <= 0.0 || quantile(0.5, &mean) < SIGNIFICANT * typical {
        return Vec3::ZERO;
    }
    Vec3::from([0, 1, 2].map(|channel| quantile(0.5, &|v: Vec3| v[channel]).max(0.0)))
}

fn mean(v: Vec3) -> f32 {
    v.element_sum() / 3.0
}

/// The first place in the shadow on the way from `start` down the steepest descent of irradiance.
fn walk_into_shadow<'a>(
    places: &[Option<Lit>],
    around: &(dyn Fn(usize) -> &'a [u32] + Sync),
    start: usize,
) -> Option<usize> {
    let irradiance = |p: usize| places[p].as_ref().map(|lit| mean(lit.irradiance));
    let first = irradiance(start)?;
    let mut here = start;
    for _ in 0..STEPS {
        let (darkest, least) = around(here)
            .iter()
            .filter_map(|&n| irradiance(n as usize).map(|e| (n as usize, e)))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        if least >= irradiance(here)? {
            return None;
        }
        if least <= SHADOWED * first {
            return Some(darkest);
        }
        here = darkest;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of places with checkered albedo, half of it in shadow with a soft edge, under this ambient irradiance.
    fn scene(ambient: Vec3) -> (Vec<Option<Lit>>, Vec<Vec<u32>>) {
        const SIDE: usize = 40;
        let mut places = Vec::new();
        let mut around = Vec::new();
        for y in 0..SIDE {
            for x in 0..SIDE {
                let albedo = if (x / 5 + y / 5) % 2 == 0 { 0.6 } else { 0.2 };
                let lit = ((x as f32 - 17.0) / 6.0).clamp(0.0, 1.0);
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
