//! Lighting by pointing: where a lamp must be to do something at a point of the surface, and which lamp does it.
//!
//! With the unit normal N and the unit direction V to the viewer at the point x, light from the unit direction L
//!
//! * has its highlight at x where L mirrors V: L = 2 (N·V) N − V (the peak of eq. 3 is at half vector = normal);
//! * shades x brightest where L = N (Lambert, eq. 2);
//! * is a rim light where it comes from behind, along the camera's ray, and still grazes x.
//!
//! A distant lamp stands in that direction. One at the finite distance R from the object's centre c stands where the ray
//! from x along L meets the sphere of radius R about c; its direction is taken from c. Nothing confines lamps to the upper
//! hemisphere, where they were sought: light from below is allowed in edits and useful on a stage.

use glam::Vec3;

use rekindle_relight::{Lighting, Shader, ShadingPoint};
use rekindle_scene::reflectance::Brdf;
use rekindle_scene::surface::Occluder;

/// Elevation of a rim light above the tangent plane of the point it grazes: the sine of 12°.
const RIM_LIFT: f32 = 0.2079;

/// What a lamp is to do at the point that is pointed at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Its highlight is there.
    Highlight,
    /// It shades that point brightest.
    Brightest,
    /// It grazes the point from behind.
    Rim,
}

/// What a lamp adds to the specular radiance seen at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HighlightShare {
    /// Index of the lamp in the lighting.
    pub lamp: usize,
    /// Specular radiance towards the viewer, RGB.
    pub specular: Vec3,
    /// Part of the specular radiance of all lamps together, all channels added, in [0, 1].
    pub share: f32,
}

/// Unit direction, from the object's centre, of a lamp that does what is asked at a surface point seen from the unit
/// direction `view`. `centre` and `radius` are the lighting's. `None` where a near lamp's sphere is out of reach: the point
/// lies outside and looks away from it.
pub fn place(
    what: Place,
    position: Vec3,
    normal: Vec3,
    view: Vec3,
    centre: Vec3,
    radius: Option<f32>,
) -> Option<Vec3> {
    // Interpolated normals may look away from the viewer near a silhouette: there the surface is as if seen edge-on.
    let normal = facing(normal, view);
    let light = match what {
        Place::Highlight => 2.0 * normal.dot(view) * normal - view,
        Place::Brightest => normal,
        Place::Rim => rim(normal, view),
    };
    seen_from_centre(position, light.try_normalize()?, centre, radius)
}

/// The nearest normal to `normal` that does not look away from the viewer.
fn facing(normal: Vec3, view: Vec3) -> Vec3 {
    let away = normal.dot(view).min(0.0);
    (normal - away * view).normalize_or(view)
}

/// Light from as far behind as grazes the surface.
fn rim(normal: Vec3, view: Vec3) -> Vec3 {
    let behind = -view;
    if behind.dot(normal) >= RIM_LIFT {
        return behind;
    }
    // The part of −V in the tangent plane; where the surface faces the viewer, any way will do.
    let along = (behind - behind.dot(normal) * normal)
        .try_normalize()
        .unwrap_or_else(|| normal.any_orthonormal_vector());
    along * (1.0 - RIM_LIFT * RIM_LIFT).sqrt() + normal * RIM_LIFT
}

/// Direction from the centre of the place that lies along `light` from `position`.
fn seen_from_centre(
    position: Vec3,
    light: Vec3,
    centre: Vec3,
    radius: Option<f32>,
) -> Option<Vec3> {
    let Some(radius) = radius else {
        return Some(light);
    };
    let from = position - centre;
    let along = from.dot(light);
    let discriminant = along * along - from.length_squared() + radius * radius;
    if discriminant < 0.0 {
        return None;
    }
    let distance = discriminant.sqrt() - along;
    if distance <= 0.0 {
        return None;
    }
    (from + distance * light).try_normalize()
}

/// What each lamp of a lighting adds to the specular radiance at a point seen from the unit direction `view`, shadows
/// included; the strongest first. Lamps that add nothing are left out.
pub fn highlight_shares(
    occluder: &Occluder,
    brdf: Option<Brdf>,
    lighting: &Lighting,
    point: &ShadingPoint,
    view: Vec3,
) -> Vec<HighlightShare> {
    let mut shares = Vec::new();
    for (index, lamp) in lighting.lamps.iter().enumerate() {
        let alone = Lighting {
            lamps: vec![lamp.clone()],
            ..lighting.dark()
        };
        let shader = Shader::new(occluder, brdf, &alone);
        if !(0..shader.groups()).any(|g| shader.is_in_lobe(g, point, view)) {
            continue;
        }
        let seen: Vec<_> = (0..shader.groups())
            .map(|g| shader.cast(point, g))
            .collect();
        let specular = shader.shade(point, view, &seen).specular;
        if specular.max_element() > 0.0 {
            shares.push(HighlightShare {
                lamp: index,
                specular,
                share: specular.element_sum(),
            });
        }
    }
    let total: f32 = shares.iter().map(|s| s.share).sum();
    for share in &mut shares {
        share.share /= total.max(f32::MIN_POSITIVE);
    }
    shares.sort_by(|a, b| b.share.total_cmp(&a.share));
    shares
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::sphere;
    use rekindle_relight::LampNodes;
    use rekindle_scene::reflectance::SpecularModel;

    /// Direction from a point to where a lamp stands.
    fn towards(direction: Vec3, position: Vec3, radius: Option<f32>) -> Vec3 {
        radius.map_or(direction, |r| {
            (r * direction - position).normalize_or_zero()
        })
    }

    #[test]
    fn the_highlight_comes_to_the_point() {
        // The lobe of a small lamp placed so must peak there: no other point of the sphere around it is brighter.
        let brdf = Brdf::new(SpecularModel::Paper, 0.1);
        let eye = Vec3::new(0.5, 1.0, 6.0);
        for radius in [None, Some(3.0)] {
            for normal in [
                Vec3::new(0.0, 0.6, 0.8),
                Vec3::new(-0.48, 0.64, 0.6),
                Vec3::new(0.8, -0.36, 0.48),
            ] {
                let view = (eye - normal).normalize_or_zero();
                let direction =
                    place(Place::Highlight, normal, normal, view, Vec3::ZERO, radius).unwrap();
                let value = |n: Vec3| {
                    let v = (eye - n).normalize_or_zero();
                    let terms = brdf.view_terms(n, v);
                    // cos θ_r taken off again: at equal distance from the mirror direction it is what is left of eq. 4.
                    brdf.lobe(&terms, towards(direction, n, radius)) * terms.cos_view()
                };
                let here = value(normal);
                assert!((here - 1.0).abs() < 1e-4, "{here} of the peak");
                let (a, b) = normal.any_orthonormal_pair();
                for step in [a, -a, b, -b] {
                    assert!(value((normal + 0.1 * step).normalize_or_zero()) < 0.9 * here);
                }
            }
        }
    }

    #[test]
    fn brightest_shading_and_rim_are_as_they_are_called() {
        let (normal, view) = (Vec3::new(0.0, 0.6, 0.8), Vec3::Z);
        for radius in [None, Some(2.5)] {
            let direction =
                place(Place::Brightest, normal, normal, view, Vec3::ZERO, radius).unwrap();
            let l = towards(direction, normal, radius);
            assert!(l.dot(normal) > 0.999_99);
            let direction = place(Place::Rim, normal, normal, view, Vec3::ZERO, radius).unwrap();
            let l = towards(direction, normal, radius);
            assert!(l.dot(view) < 0.0, "a rim light comes from behind");
            let grazing = l.dot(normal).asin().to_degrees();
            assert!((grazing - 12.0).abs() < 0.1, "{grazing}° above the surface");
        }
        // At the silhouette it is straight behind.
        let edge = Vec3::new(1.0, 0.0, -0.3).normalize_or_zero();
        let rim = place(Place::Rim, edge, edge, view, Vec3::ZERO, None).unwrap();
        assert!(rim.is_finite() && rim.dot(view) < -0.9);
        // Facing the viewer there is no way more behind than others, but there is one.
        let rim = place(Place::Rim, view, view, view, Vec3::ZERO, None).unwrap();
        assert!((rim.length() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_highlight_is_asked_for_its_lamp() {
        let (mesh, occluder) = sphere();
        let brdf = Some(Brdf::new(SpecularModel::Beckmann, 0.08));
        let eye = Vec3::new(0.0, 0.0, 8.0);
        let normals = [
            Vec3::new(0.5, 0.3, 0.812_404),
            Vec3::new(-0.5, 0.3, 0.812_404),
        ];
        let lamps = normals.map(|n| {
            let direction = place(
                Place::Highlight,
                n,
                n,
                (eye - n).normalize_or_zero(),
                Vec3::ZERO,
                None,
            )
            .unwrap();
            LampNodes::disc(direction, Vec3::ONE, 0.03, None)
        });
        let mut lighting = Lighting {
            ambient: Vec3::splat(0.2),
            ..Lighting::of(lamps.to_vec())
        };
        let ask = |lighting: &Lighting, n: Vec3| {
            let hit = occluder.hit(eye, (n - eye).normalize_or_zero()).unwrap();
            let point = ShadingPoint::on(&mesh, hit.triangle, hit.barycentric);
            let view = (eye - point.position).normalize_or_zero();
            highlight_shares(&occluder, brdf, lighting, &point, view)
        };
        for (i, normal) in normals.into_iter().enumerate() {
            let shares = ask(&lighting, normal);
            assert_eq!(shares[0].lamp, i);
            assert!(shares[0].share > 0.95, "{shares:?}");
        }
        assert!(ask(&lighting, Vec3::new(0.0, -0.6, 0.8)).is_empty());
        lighting.lamps[0].muted = true;
        assert!(ask(&lighting, normals[0]).iter().all(|s| s.lamp != 0));
    }
}
