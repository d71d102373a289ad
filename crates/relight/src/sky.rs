//! The soft light of an environment, as lobes and pictures show it: a picture of radiance at several blurs.
//!
//! A lobe is the mean over half vectors drawn from the facets' slopes, and each stands for a small part of them, so that it
//! sees the radiance blurred by as much (Křivánek and Colbert, "Real-time Shading with Filtered Importance Sampling", 2008).
//! Few are then enough, and no single node of light shows. What is small and bright, a sun, is kept out of it.

use std::f32::consts::PI;
use std::sync::Arc;

use glam::{Quat, Vec2, Vec3};
use rayon::prelude::*;

use rekindle_base::math::GOLDEN_ANGLE;
use rekindle_scene::hemisphere::{direction_from_lat_long, lat_long_from_direction};
use rekindle_scene::reflectance::Brdf;

/// Rows of the least blurred picture at most, and of the most blurred one.
const MOST_ROWS: usize = 256;
const LEAST_ROWS: usize = 4;
/// Standard deviation of a picture's blur along each axis, in parts of a row: what pixels and reading between them blur anyway.
const BLUR: f32 = 0.5;
/// Variance of the mean between two pixels about any place, in squares of their distance: a sixth.
const READING: f32 = 1.0 / 6.0;
/// Directions that a pixel's blur is the mean of.
const TAPS: usize = 24;
/// Half vectors of a lobe, and of how many pixels each has some of them.
const HALF_VECTORS: usize = 64;
pub(super) const FEW_CASES: usize = 4;

/// The picture at one blur: a lat-long one, twice as wide as high.
#[derive(Debug, PartialEq)]
pub struct SkyLevel {
    /// Rows; there are twice as many columns.
    pub rows: usize,
    /// Radiance row by row from the top, RGB.
    pub radiance: Vec<Vec3>,
}

impl SkyLevel {
    /// Of each pixel the radiance that `of` says there is in the mean about a direction.
    fn new(rows: usize, of: impl Fn(Vec3) -> Vec3 + Sync) -> Self {
        let pixel = |i: usize| {
            let place = Vec2::new((i % (2 * rows)) as f32, (i / (2 * rows)) as f32) + 0.5;
            of(direction_from_lat_long(
                place / Vec2::new((2 * rows) as f32, rows as f32),
            ))
        };
        Self {
            rows,
            radiance: (0..2 * rows * rows).into_par_iter().map(pixel).collect(),
        }
    }

    /// Standard deviation of its blur along each axis, radians.
    fn spread(&self) -> f32 {
        BLUR * PI / self.rows as f32
    }

    /// Radiance from a unit direction, between pixels.
    fn at(&self, direction: Vec3) -> Vec3 {
        self.at_place(lat_long_from_direction(direction))
    }

    /// The same by the place in the picture, 0 to 1.
    fn at_place(&self, uv: Vec2) -> Vec3 {
        let columns = 2 * self.rows;
        let x = uv.x * columns as f32 - 0.5;
        let y = (uv.y * self.rows as f32 - 0.5).clamp(0.0, (self.rows - 1) as f32);
        let (left, top) = (x.floor(), (y as usize).min(self.rows - 2));
        let left_column = (left as isize).rem_euclid(columns as isize) as usize;
        let across = [left_column, (left_column + 1) % columns];
        let row = |row: usize| {
            let [a, b] = across.map(|column| self.radiance[row * columns + column]);
            a.lerp(b, x - left)
        };
        row(top).lerp(row(top + 1), y - top as f32)
    }

    /// The same blurred twice as much.
    fn blurred(&self) -> Self {
        let rows = self.rows / 2;
        // Variances add: that of reading this level, what is blurred here, and that of reading between the new pixels.
        let more = (0.75 * BLUR * BLUR - READING).sqrt() * PI / rows as f32;
        let taps: Vec<Vec2> = (0..TAPS)
            .map(|i| {
                let share = (i as f32 + 0.5) / TAPS as f32;
                let radius = more * (-2.0 * (1.0 - share).ln()).sqrt();
                radius * Vec2::from_angle(i as f32 * GOLDEN_ANGLE)
            })
            .collect();
        Self::new(rows, |direction| {
            let (tangent, bitangent) = direction.any_orthonormal_pair();
            let around = |tap: &Vec2| {
                let turned = direction + tangent * tap.x + bitangent * tap.y;
                self.at(turned.normalize_or(direction))
            };
            taps.iter().map(around).sum::<Vec3>() / TAPS as f32
        })
    }
}

/// The soft light of an environment.
#[derive(Clone, Debug)]
pub struct Sky {
    /// From the least to the most blurred; each twice as blurred as the one before, with half as many rows.
    levels: Arc<Vec<SkyLevel>>,
    turn: Quat,
    gain: Vec3,
}

impl PartialEq for Sky {
    fn eq(&self, other: &Self) -> bool {
        let same = Arc::ptr_eq(&self.levels, &other.levels) || self.levels == other.levels;
        self.turn == other.turn && self.gain == other.gain && same
    }
}

impl Sky {
    /// Rows of its least blurred picture where it is made of one with this many.
    pub(super) fn rows(of: usize) -> usize {
        of.next_power_of_two().clamp(LEAST_ROWS, MOST_ROWS)
    }

    /// A sky of which `of` says the radiance that a pixel of [`Self::rows`] shows in the mean, by its unit direction.
    pub(super) fn new(rows: usize, of: impl Fn(Vec3) -> Vec3 + Sync) -> Self {
        let mut levels = vec![SkyLevel::new(rows, of)];
        while let Some(last) = levels.last().filter(|last| last.rows > LEAST_ROWS) {
            levels.push(last.blurred());
        }
        Self {
            levels: Arc::new(levels),
            turn: Quat::IDENTITY,
            gain: Vec3::ONE,
        }
    }

    /// The same turned further and times `gain`.
    #[must_use]
    pub fn turned(&self, turn: Quat, gain: Vec3) -> Self {
        Self {
            levels: Arc::clone(&self.levels),
            turn: turn * self.turn,
            gain: gain * self.gain,
        }
    }

    /// The pictures before they are turned and multiplied, the least blurred first; each has half the rows of the one before.
    pub fn levels(&self) -> &Arc<Vec<SkyLevel>> {
        &self.levels
    }

    /// From the pictures' directions to the world's.
    pub fn turn(&self) -> Quat {
        self.turn
    }

    /// By what the pictures are multiplied, RGB.
    pub fn gain(&self) -> Vec3 {
        self.gain
    }

    /// Radiance about a unit direction, RGB, blurred to this standard deviation along each axis, radians.
    pub fn radiance(&self, direction: Vec3, spread: f32) -> Vec3 {
        let direction = self.turn.inverse() * direction;
        let finest = self.levels[0].spread();
        let level = (spread / finest).max(1.0).log2();
        let level = level.min((self.levels.len() - 1) as f32);
        let low = level as usize;
        let place = lat_long_from_direction(direction);
        let of = |k: usize| self.levels[k].at_place(place);
        let radiance = if low + 1 < self.levels.len() {
            of(low).lerp(of(low + 1), level - low as f32)
        } else {
            of(low)
        };
        self.gain * radiance
    }
}

/// Half vectors drawn from a lobe.
#[derive(Clone, Debug)]
pub(super) struct DrawnLobe {
    /// Of each how far along the surface it leans, and what part of all lies nearer to the normal.
    half_vectors: Vec<(Vec2, f32)>,
}

/// What a drawn half vector mirrors to the viewer.
pub(super) struct Mirrored {
    /// Towards the light, unit.
    pub light: Vec3,
    /// By what to weigh the radiance from there; the weights of all are to be divided by their `total`.
    pub weight: f32,
    /// Standard deviation of what it stands for along each axis, radians.
    pub spread: f32,
}

impl DrawnLobe {
    /// All of a lobe.
    pub(super) fn new(main: Brdf) -> Self {
        Self::drawn(main, HALF_VECTORS, 0.5)
    }

    /// Few of a lobe, in each case others: they share all of the lobe among them.
    pub(super) fn few(main: Brdf) -> [Self; FEW_CASES] {
        let place = |case: usize| (case as f32 + 0.5) / FEW_CASES as f32;
        std::array::from_fn(|case| Self::drawn(main, HALF_VECTORS / FEW_CASES, place(case)))
    }

    /// So many, each at this place in its share of all.
    fn drawn(main: Brdf, count: usize, place: f32) -> Self {
        let half_vectors = (0..count).map(|i| {
            let below = (i as f32 + place) / count as f32;
            let lean = main.facet_slope(below) * Vec2::from_angle(i as f32 * GOLDEN_ANGLE);
            (lean, below)
        });
        Self {
            half_vectors: half_vectors.collect(),
        }
    }

    /// Calls `add` for every direction that a half vector of the lobe `brdf`, so many times as wide as the main one, mirrors to the
    /// view, all of them turned about the normal by an angle. The sum of weight × radiance is the lobe under it.
    pub(super) fn each(
        &self,
        (brdf, wider): (Brdf, f32),
        angle: f32,
        normal: Vec3,
        view: Vec3,
        mut add: impl FnMut(Mirrored),
    ) {
        let frame = super::reflection::facing_frame(normal, view);
        let turn = wider * Vec2::from_angle(angle);
        let lean = |lean: Vec2| frame * turn.rotate(lean).extend(1.0).normalize_or(Vec3::Z);
        let weights = self.half_vectors.iter().map(|&(along, _)| {
            let half = lean(along);
            half.dot(view).max(0.0) / half.dot(normal)
        });
        let total: f32 = weights.sum();
        if total <= 0.0 {
            return;
        }
        let scale = brdf.drawn_scale(normal.dot(view)) / total;
        for &(along, below) in &self.half_vectors {
            let half = lean(along);
            let (tan, cos_between) = (wider * along.length(), half.dot(view));
            if cos_between <= 0.0 {
                continue;
            }
            let light = half * (2.0 * cos_between) - view;
            let passes = brdf.drawn_reflectance(tan, normal.dot(light), cos_between);
            // Mirroring widens a solid angle by 4 v·h; of a disc a quarter of the squared radius is the variance.
            let count = self.half_vectors.len();
            let solid_angle = 4.0 * cos_between * brdf.drawn_solid_angle(below, tan, count);
            add(Mirrored {
                light,
                weight: scale * passes * cos_between / half.dot(normal),
                spread: 0.5 * (solid_angle / PI).sqrt(),
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::TAU;

    use super::*;
    use crate::shading::Draw;
    use crate::{LampNodes, LatLong, LightNode, Lighting, Shader, ShadingPoint};
    use rekindle_capture::Mesh;
    use rekindle_scene::reflectance::{Gloss, SpecularModel};
    use rekindle_scene::surface::Occluder;

    /// A sky whose radiance `of` a direction is given, without a sun.
    fn sky(of: impl Fn(Vec3) -> Vec3) -> Sky {
        let environment = LatLong::of(128, of).environment(Quat::IDENTITY, Vec3::ONE);
        environment.expect("it shines").sky
    }

    /// ∫ radiance × lobe over all directions, by a sum over a fine grid.
    fn integrated(brdf: Brdf, view: Vec3, radiance: impl Fn(Vec3) -> f32) -> f32 {
        const STEPS: usize = 900;
        let terms = brdf.view_terms(Vec3::Z, view);
        let mut sum = 0.0;
        for i in 0..STEPS {
            let height = (i as f32 + 0.5) / STEPS as f32;
            let across = (1.0 - height * height).sqrt();
            for j in 0..STEPS {
                let (sin, cos) = (TAU * (j as f32 + 0.5) / STEPS as f32).sin_cos();
                let light = Vec3::new(across * cos, across * sin, height);
                sum += f64::from(brdf.lobe(&terms, light) * radiance(light));
            }
        }
        (sum * f64::from(TAU) / (STEPS * STEPS) as f64) as f32
    }

    /// What a lobe about +Z shows of a sky.
    fn mirrored(brdf: Brdf, view: Vec3, sky: &Sky) -> f32 {
        let mut sum = 0.0;
        DrawnLobe::new(brdf).each((brdf, 1.0), 0.0, Vec3::Z, view, |m| {
            sum += m.weight * sky.radiance(m.light, m.spread).x;
        });
        sum
    }

    fn tilted(cos: f32) -> Vec3 {
        Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos)
    }

    #[test]
    fn a_lobe_shows_an_even_sky_as_its_integral_says() {
        let even = sky(|_| Vec3::ONE);
        for model in SpecularModel::ALL {
            for sigma in [0.03, 0.1, 0.25] {
                let brdf = Brdf::new(model, sigma);
                for cos in [1.0, 0.7, 0.4] {
                    let found = mirrored(brdf, tilted(cos), &even);
                    let expected = integrated(brdf, tilted(cos), |_| 1.0);
                    // Masking in the lobe's formula is a fit, right to 2 or 3 %.
                    assert!(
                        (found / expected - 1.0).abs() < 0.035,
                        "{model:?}, σ {sigma}, cos {cos}: {found} for {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_lobe_shows_the_edges_of_a_sky_without_steps() {
        // Bright above a slanted edge, which the lobe passes over as the view sinks.
        let bright = |d: Vec3| if d.x + 0.3 * d.y < -0.5 { 3.0 } else { 0.2 };
        let even = sky(|_| Vec3::ONE);
        let sky = sky(|d| Vec3::splat(bright(d)));
        for model in [SpecularModel::Beckmann, SpecularModel::Ggx] {
            let brdf = Brdf::new(model, 0.06);
            let whole = |cos: f32| integrated(brdf, tilted(cos), |_| 1.0);
            let shown = |cos: f32| mirrored(brdf, tilted(cos), &even);
            for cos in [0.95, 0.9, 0.85, 0.8, 0.7, 0.5, 0.3] {
                let found = mirrored(brdf, tilted(cos), &sky) / shown(cos);
                let expected = integrated(brdf, tilted(cos), bright) / whole(cos);
                assert!(
                    (found - expected).abs() < 0.1,
                    "{model:?}, cos {cos}: {found} for {expected}, of 3"
                );
            }
        }
    }

    #[test]
    fn few_half_vectors_of_many_pixels_show_what_all_do() {
        let window = Vec3::new(-0.6, 0.2, 0.7).normalize_or_zero();
        let radiance = |d: Vec3| 0.2 + 3.0 * d.dot(window).max(0.0).powi(20);
        let sky = sky(|d| Vec3::splat(radiance(d)));
        for sigma in [0.08, 0.25] {
            let brdf = Brdf::new(SpecularModel::Ggx, sigma);
            let few = DrawnLobe::few(brdf);
            for cos in [0.95, 0.7, 0.4] {
                let shown = |pixel: usize| {
                    let (mut sum, angle) = (0.0, pixel as f32 * GOLDEN_ANGLE);
                    few[pixel % FEW_CASES].each((brdf, 1.0), angle, Vec3::Z, tilted(cos), |m| {
                        sum += m.weight * sky.radiance(m.light, m.spread).x;
                    });
                    sum
                };
                let mean = (0..64).map(shown).sum::<f32>() / 64.0;
                let expected = integrated(brdf, tilted(cos), radiance);
                let part = mean / expected;
                assert!((part - 1.0).abs() < 0.035, "σ {sigma}, cos {cos}: {part}");
                let off = (0..64).map(|pixel| (shown(pixel) / mean - 1.0).powi(2));
                let noise = (off.sum::<f32>() / 64.0).sqrt();
                assert!(noise < 0.2, "σ {sigma}, cos {cos}: {noise}");
            }
        }
    }

    #[test]
    fn blurring_keeps_the_light_and_spreads_it_as_far_as_it_says() {
        let towards = Vec3::new(0.3, 0.9, 0.2).normalize_or_zero();
        let sky = sky(|d| Vec3::splat(if d.dot(towards) > 0.97 { 5.0 } else { 1.0 }));
        let sums = sky.levels().iter().map(|level| {
            let rows = level.rows;
            let mut sum = 0.0;
            for (i, radiance) in level.radiance.iter().enumerate() {
                let polar = |row: usize| (PI * row as f32 / rows as f32).cos();
                let row = i / (2 * rows);
                sum += radiance.x * (polar(row) - polar(row + 1)) * TAU / (2 * rows) as f32;
            }
            sum
        });
        let sums: Vec<f32> = sums.collect();
        for sum in &sums {
            assert!((sum / sums[0] - 1.0).abs() < 0.02, "{sums:?}");
        }
        // At the rim of the bright disc, in the mean, half of it is seen, however blurred.
        let across = towards.any_orthonormal_vector();
        let at = |angle: f32, spread| {
            let d = Quat::from_axis_angle(across, angle) * towards;
            sky.radiance(d, spread).x
        };
        let rim = 0.97_f32.acos();
        assert!((at(rim, 0.03) - 3.0).abs() < 0.4, "{}", at(rim, 0.03));
        let slope = (at(rim - 0.05, 0.05) - at(rim + 0.05, 0.05)) / 4.0;
        // One standard deviation to either side of an edge hold 68 % of it.
        assert!((slope - 0.68).abs() < 0.08, "{slope}");
    }

    #[test]
    fn the_surface_hides_the_sky_where_it_is_sheltered() {
        // A floor, and a roof over all of it but what is far away.
        let plate = |height: f32, size: f32| {
            let corner = |x: f32, z: f32| Vec3::new(size * x, height, size * z);
            [
                corner(-1.0, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ]
        };
        let mesh = Mesh {
            positions: [plate(0.0, 1.0), plate(0.2, 50.0)].concat(),
            normals: [[Vec3::Y; 4], [Vec3::NEG_Y; 4]].concat(),
            triangles: vec![[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]],
            ..Mesh::default()
        };
        let occluder = Occluder::new(&mesh);
        let environment = LatLong::of(32, |_| Vec3::ONE).environment(Quat::IDENTITY, Vec3::ONE);
        let lighting = Lighting {
            environment,
            ..Lighting::of(Vec::new())
        };
        let brdf = Brdf::new(SpecularModel::Ggx, 0.05);
        let shader = Shader::new(&occluder, Some(brdf), &lighting);
        let point = ShadingPoint::smooth(Vec3::ZERO, Vec3::Y);
        let view = Vec3::new(0.1, 0.1, 0.0).normalize_or_zero();
        let open = shader.specular_of_sky(&point, view, false, Draw::Whole);
        let sheltered = shader.specular_of_sky(&point, view, true, Draw::Whole);
        assert!(open.min_element() > 0.0, "{open}");
        assert!(
            sheltered.max_element() < 0.01 * open.x,
            "{sheltered}, not 0 of {open}"
        );
        // What reflects nothing shows none, and half as strong a lobe half of it.
        let matt = Gloss {
            strength: 0.0,
            ..Gloss::MAIN
        };
        let half = Gloss {
            strength: 0.5,
            ..Gloss::MAIN
        };
        let none = shader.specular_of_sky(&point.with_gloss(matt), view, false, Draw::Whole);
        assert_eq!(none, Vec3::ZERO);
        let weak = shader.specular_of_sky(&point.with_gloss(half), view, false, Draw::Whole);
        assert!((weak / open - 0.5).abs().max_element() < 1e-3, "{weak}");
    }

    #[test]
    fn many_wide_lamps_together_shine_as_their_nodes_do() {
        // A floor, half of it beside a high wall.
        let corner = |x: f32, y: f32, z: f32| Vec3::new(4.0 * x, 4.0 * y, 4.0 * z);
        let floor = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let wall = [(0.0, -1.0), (0.0, 1.0), (1.0, 1.0), (1.0, -1.0)];
        let mesh = Mesh {
            positions: [
                floor.map(|(x, z)| corner(x, 0.0, z)),
                wall.map(|(y, z)| corner(0.1, y, z)),
            ]
            .concat(),
            normals: [[Vec3::Y; 4], [Vec3::NEG_X; 4]].concat(),
            triangles: vec![[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]],
            ..Mesh::default()
        };
        let occluder = Occluder::new(&mesh);
        let wide = (0..12).map(|i| {
            let turn = i as f32 * 2.4;
            let height = 0.1 + 0.8 * i as f32 / 12.0;
            let across = (1.0 - height * height).sqrt();
            let towards = Vec3::new(across * turn.cos(), height, across * turn.sin());
            let flux = Vec3::new(1.0 + turn.sin(), 1.0, 1.0 + turn.cos());
            LampNodes::disc_of(900, towards, flux, 0.3 + 0.02 * i as f32, None)
        });
        let sun = LampNodes::disc_of(40, Vec3::new(-0.6, 0.8, 0.0), Vec3::ONE, 0.03, None);
        let lamps: Vec<LampNodes> = wide.chain([sun]).collect();
        for sigma in [0.06, 0.15] {
            let brdf = Brdf::new(SpecularModel::Ggx, sigma);
            let shader = Shader::new(&occluder, Some(brdf), &Lighting::of(lamps.clone()));
            assert!(shader.shows_sky());
            for place in [Vec3::new(-3.0, 0.0, 0.0), Vec3::new(-0.5, 0.0, 0.5)] {
                let point = ShadingPoint::smooth(place, Vec3::Y);
                let seen: Vec<_> = (0..shader.groups())
                    .map(|group| shader.cast(&point, group))
                    .collect();
                let origin = occluder.offset_origin(place, Vec3::Y);
                let is_seen =
                    |node: &&LightNode| !occluder.occluded(origin, node.direction, f32::INFINITY);
                for view in [Vec3::new(-0.5, 1.0, 0.2), Vec3::new(0.1, 1.0, 0.0)] {
                    let view = view.normalize_or_zero();
                    let terms = brdf.view_terms(Vec3::Y, view);
                    let nodes = || lamps.iter().flat_map(|lamp| &lamp.nodes);
                    let lobe = |n: &LightNode| n.flux() * brdf.lobe(&terms, n.direction);
                    let lit = |n: &LightNode| {
                        let cos = n.direction.y.max(0.0);
                        n.flux() * cos * brdf.diffuse_entry(cos)
                    };
                    let sky = shader.specular_of_sky(&point, view, true, Draw::Whole);
                    let shade = shader.shade(&point, view, &seen);
                    let specular: Vec3 = nodes().filter(is_seen).map(lobe).sum();
                    let open: Vec3 = nodes().map(lobe).sum();
                    let off = shade.specular + sky - specular;
                    assert!(
                        off.length() < 0.08 * open.length(),
                        "σ {sigma}, {place}, {view}: off by {off} of {specular}"
                    );
                    let irradiance: Vec3 = nodes().filter(is_seen).map(lit).sum();
                    let off = shade.irradiance - irradiance;
                    assert!(
                        off.length() < 0.04 * irradiance.length(),
                        "σ {sigma}, {place}: off by {off} of {irradiance}"
                    );
                }
            }
        }
    }
}
