//! How far the quotient of radiance and irradiance tells the albedo where little light arrives.
//!
//! In a shadow, light that the estimate doesn't have, what a pixel blurs and noise are divided by next to nothing. The albedo
//! may be taken from there or from the nearest place that is well lit. Which is better the surface itself says: places that are
//! lit as little differ by so much from the nearest well-lit one, of which well-lit places as far from each other differ by
//! their own. The rest is the quotient's error, and both are weighed by their squares. That error is what is usual, by medians: a
//! few places, as at a shadow's edge, say nothing of all others with as little light. Where it comes straight from lights and
//! where from the rest of the surface errors are told apart.

use glam::Vec3;

use super::ambient::Lit;
use super::fill::Places;

/// A place with at least this part of the typical irradiance is well lit.
const WELL_LIT: f32 = 0.5;
/// Of so many well-lit places one is what those around it are compared with; for larger distances of [`FURTHER`] times as many, and so
/// on as long as there are a few.
const APART: usize = 8;
const FURTHER: usize = 32;
const SOURCES: usize = 8;
/// Steps from place to place up to which the error is learned.
const NEAR: usize = 24;
/// Steps and irradiances are told apart by this factor, the least irradiance being this part of that of a well-lit place.
const FACTOR: f32 = 1.414;
/// Classes of steps.
const DISTANCES: usize = 24;
const LEAST: f32 = 1e-3;
/// An irradiance below this part of a well-lit place's is none.
const NOTHING: f32 = 1e-6;
/// Places below which a class of irradiances is joined with the next.
const MIN_PLACES: usize = 32;
/// Median of the square of a normal deviate.
const SQUARED_MEDIAN: f64 = 0.455;
/// Contrast of albedos that nobody sees.
const UNSEEN: f64 = 0.02;

/// Mean squares of contrasts between albedos.
pub(super) struct Trust {
    /// Steps of each place to the nearest well-lit one.
    steps: Vec<Option<usize>>,
    /// Irradiance of a well-lit place.
    well_lit: f32,
    /// What an albedo changes within so many steps, in the mean.
    by_steps: Vec<f64>,
    /// The quotient's error, by class of irradiance from the least: where that comes mostly from the rest of the surface, and
    /// where mostly from lights.
    by_irradiance: [Vec<f64>; 2],
}

/// Squared contrasts with the areas of their places.
#[derive(Clone, Default)]
struct Class {
    squares: Vec<(f64, f32)>,
}

impl Class {
    fn add(&mut self, square: f64, area: f32) {
        self.squares.push((square, area));
    }

    fn join(&mut self, other: Self) {
        self.squares.extend(other.squares);
    }

    fn mean(&self) -> f64 {
        let weighed = self.squares.iter().map(|(s, area)| s * f64::from(*area));
        weighed.sum::<f64>() / self.area().max(f64::MIN_POSITIVE)
    }

    /// The mean square of normal deviates with the same median.
    fn usual(&self) -> f64 {
        let mut squares = self.squares.clone();
        squares.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = 0.5 * self.area();
        let mut below = 0.0;
        let median = squares.iter().find(|(_, area)| {
            below += f64::from(*area);
            below >= half
        });
        median.map_or(0.0, |(square, _)| square / SQUARED_MEDIAN)
    }

    fn area(&self) -> f64 {
        self.squares.iter().map(|(_, area)| f64::from(*area)).sum()
    }
}

impl Trust {
    /// Learns from the places of a surface, of which each is `None` where no view saw it; `typical` is the irradiance of a well-lit
    /// one.
    pub(super) fn new(places: &Places, lit: &[Option<Lit>], typical: f32) -> Self {
        let well_lit = WELL_LIT * typical;
        let light = |p: usize| lit[p].as_ref().map(|l| mean(l.irradiance));
        let is_well_lit = |p: usize| light(p).is_some_and(|e| e >= well_lit);
        let sources: Vec<usize> = (0..lit.len()).filter(|&p| is_well_lit(p)).collect();
        let mut by_steps: Vec<Class> = vec![Class::default(); DISTANCES];
        let apart = std::iter::successors(Some(APART), |apart| Some(apart * FURTHER));
        for apart in apart.take_while(|apart| apart * SOURCES <= sources.len()) {
            let some = sources.iter().copied();
            let some = some.filter(|&p| scattered(p).is_multiple_of(apart));
            for (p, nearest) in nearest(places, some, is_well_lit).into_iter().enumerate() {
                let Some((source, steps)) = nearest.filter(|n| n.1 > 0) else {
                    continue;
                };
                if let (Some(one), Some(other)) = (&lit[p], &lit[source]) {
                    by_steps[distance(steps)].add(squared_contrast(one, other), one.area);
                }
            }
        }
        let usually = monotonic(&by_steps, Class::usual);
        let by_steps = monotonic(&by_steps, Class::mean);
        let nearest = nearest(places, sources.into_iter(), |_| true);
        let mut errors = [0, 1].map(|_| vec![Class::default(); class_of(1.0) + 1]);
        for (p, nearest) in nearest.iter().enumerate() {
            let Some((source, steps)) = nearest.filter(|n| (1..=NEAR).contains(&n.1)) else {
                continue;
            };
            if let (Some(one), Some(other)) = (&lit[p], &lit[source]) {
                let error =
                    squared_contrast(one, other) - SQUARED_MEDIAN * usually[distance(steps)];
                let light = mean(one.irradiance);
                let is_direct = usize::from(one.direct > 0.5 * light);
                errors[is_direct][class_of(light / well_lit)].add(error, one.area);
            }
        }
        let by_irradiance = errors.map(|mut classes| {
            // From the most light to the least errors grow.
            classes.reverse();
            let mut means = monotonic(&classes, Class::usual);
            means.reverse();
            means
        });
        Self {
            steps: (nearest.into_iter()).map(|n| n.map(|n| n.1)).collect(),
            well_lit,
            by_steps,
            by_irradiance,
        }
    }

    /// How far the quotient counts, 0 to 1, beside what the surroundings say, where this irradiance (mean over channels) arrives
    /// about a place, this part of it straight from lights.
    pub(super) fn at(&self, irradiance: f32, direct: f32, place: usize) -> f32 {
        if irradiance >= self.well_lit {
            return 1.0;
        }
        if irradiance <= NOTHING * self.well_lit {
            return 0.0;
        }
        let Some(steps) = self.steps[place] else {
            return 1.0;
        };
        let changed = self.by_steps[distance(steps)].max(UNSEEN * UNSEEN);
        let class = class_of(irradiance / self.well_lit);
        let [around, straight] = [0, 1].map(|k| self.by_irradiance[k][class].max(0.0));
        // Between the middles of both halves.
        let part = f64::from((2.0 * direct - 0.5).clamp(0.0, 1.0));
        let error = around + part * (straight - around);
        (changed / (changed + error)) as f32
    }
}

/// A number as good as random for each place.
fn scattered(place: usize) -> usize {
    // Knuth's multiplicative hash; its high bits are mixed best.
    ((place as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as usize
}

fn mean(v: Vec3) -> f32 {
    v.element_sum() / 3.0
}

/// The number of the class of so many steps, at least one.
fn distance(steps: usize) -> usize {
    let above = (steps.max(1) as f32).ln() / FACTOR.ln();
    (above as usize).min(DISTANCES - 1)
}

/// The number of the class of irradiances, as parts of a well-lit place's, from the least.
fn class_of(part: f32) -> usize {
    let above = (part.clamp(LEAST, 1.0) / LEAST).ln() / FACTOR.ln();
    above as usize
}

/// The square of the contrast of the albedos of two places, 0 to 1, mean over channels.
fn squared_contrast(one: &Lit, other: &Lit) -> f64 {
    let [a, b] = [
        one.radiance.max(Vec3::ZERO) * other.irradiance,
        other.radiance.max(Vec3::ZERO) * one.irradiance,
    ];
    let sum = (a + b).max(Vec3::splat(f32::MIN_POSITIVE));
    let contrast = (a - b) / sum;
    f64::from(mean(contrast * contrast))
}

/// For every place that of the `sources` to which there are the fewest steps over places that `may_pass`, and of these one as near as
/// can be, with the steps.
fn nearest(
    places: &Places,
    sources: impl Iterator<Item = usize>,
    may_pass: impl Fn(usize) -> bool,
) -> Vec<Option<(usize, usize)>> {
    let mut nearest: Vec<Option<(usize, usize)>> = vec![None; places.count()];
    let mut ring: Vec<usize> = sources.collect();
    for &p in &ring {
        nearest[p] = Some((p, 0));
    }
    let apart = |p: usize, q: usize| places.position(p).distance_squared(places.position(q));
    let mut steps = 0;
    while !ring.is_empty() {
        steps += 1;
        let mut next = Vec::new();
        for &p in &ring {
            let Some((source, _)) = nearest[p] else {
                continue;
            };
            for &n in places.around(p) {
                let n = n as usize;
                match nearest[n] {
                    None if may_pass(n) => {
                        nearest[n] = Some((source, steps));
                        next.push(n);
                    }
                    Some((other, reached))
                        if reached == steps && apart(source, n) < apart(other, n) =>
                    {
                        nearest[n] = Some((source, steps));
                    }
                    _ => {}
                }
            }
        }
        ring = next;
    }
    nearest
}

/// What `value` says of classes, none less than those before (pool adjacent violators). Classes of few places are as those before
/// them.
fn monotonic(classes: &[Class], value: impl Fn(&Class) -> f64) -> Vec<f64> {
    let mut pools: Vec<(Class, f64, usize)> = Vec::new();
    for class in classes {
        pools.push((class.clone(), value(class), 1));
        while let [.., (before, least, _), (last, most, _)] = &pools[..]
            && (last.squares.len().min(before.squares.len()) < MIN_PLACES || most < least)
        {
            let Some((last, _, more)) = pools.pop() else {
                break;
            };
            if let Some((pool, of_pool, many)) = pools.last_mut() {
                pool.join(last);
                *of_pool = value(pool);
                *many += more;
            }
        }
    }
    let values = pools.iter().map(|&(_, value, many)| (value, many));
    values
        .flat_map(|(value, many)| std::iter::repeat_n(value, many))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_capture::Mesh;

    const SIDE: usize = 60;

    /// A sheet of patches of two albedos, lit less and less to one side, of which the darkest places show `error` besides.
    fn sheet(error: impl Fn(usize, f32) -> f32) -> (Places, Vec<Option<Lit>>) {
        let place = |i: usize| ((i % SIDE) as f32, (i / SIDE) as f32);
        let at = |x: usize, y: usize| (y * SIDE + x) as u32;
        let squares = (0..SIDE - 1).flat_map(|y| (0..SIDE - 1).map(move |x| (x, y)));
        let mesh = Mesh {
            positions: (0..SIDE * SIDE)
                .map(|i| Vec3::new(place(i).0, place(i).1, 0.0))
                .collect(),
            triangles: squares
                .flat_map(|(x, y)| {
                    [
                        [at(x, y), at(x + 1, y), at(x + 1, y + 1)],
                        [at(x, y), at(x + 1, y + 1), at(x, y + 1)],
                    ]
                })
                .collect(),
            ..Mesh::default()
        };
        let lit = |i: usize| {
            let (x, y) = place(i);
            let light = (1.0 - x / 50.0).max(0.01);
            let albedo = if ((y / 12.0) as usize).is_multiple_of(2) {
                0.5
            } else {
                0.3
            };
            Some(Lit {
                radiance: Vec3::splat((albedo * light + error(i, light)).max(0.0)),
                irradiance: Vec3::splat(light),
                direct: light,
                area: 1.0,
            })
        };
        (Places::new(&mesh), (0..SIDE * SIDE).map(lit).collect())
    }

    /// How far the quotients of a column of the sheet count, in the mean.
    fn trusted(error: impl Fn(usize, f32) -> f32, column: usize) -> f32 {
        let (places, lit) = sheet(error);
        let trust = Trust::new(&places, &lit, 1.0);
        let of = |y: usize| {
            let place = y * SIDE + column;
            trust.at(
                lit[place].as_ref().map_or(0.0, |l| l.irradiance.x),
                1.0,
                place,
            )
        };
        (0..SIDE).map(of).sum::<f32>() / SIDE as f32
    }

    /// Noise of any places, −1 to 1.
    fn noise(i: usize) -> f32 {
        2.0 * (i as f32 * 0.618_034).fract() - 1.0
    }

    #[test]
    fn exact_quotients_count_however_little_light_there_is() {
        for column in [10, 30, 45, 55] {
            let trusted = trusted(|_, _| 0.0, column);
            assert!(trusted > 0.9, "{trusted} in column {column}");
        }
    }

    #[test]
    fn light_that_the_estimate_lacks_counts_against_what_is_dark() {
        let lacking = |_, _| 0.02;
        assert!(trusted(lacking, 55) < 0.2, "{}", trusted(lacking, 55));
        assert!(trusted(lacking, 10) > 0.9, "{}", trusted(lacking, 10));
    }

    #[test]
    fn noise_counts_against_what_is_dark() {
        let noisy = |i, _| 0.01 * noise(i);
        assert!(trusted(noisy, 55) < 0.3, "{}", trusted(noisy, 55));
        assert!(trusted(noisy, 10) > 0.9, "{}", trusted(noisy, 10));
        assert!(trusted(noisy, 30) > 0.8, "{}", trusted(noisy, 30));
    }

    #[test]
    fn the_scale_of_light_changes_nothing() {
        let (places, lit) = sheet(|i, _| 0.01 * noise(i));
        let scaled = |l: &Option<Lit>| {
            let l = l.as_ref()?;
            Some(Lit {
                radiance: 1e-4 * l.radiance,
                irradiance: 1e-4 * l.irradiance,
                direct: 1e-4 * l.direct,
                area: l.area,
            })
        };
        let scaled: Vec<Option<Lit>> = lit.iter().map(scaled).collect();
        let one = Trust::new(&places, &lit, 1.0);
        let other = Trust::new(&places, &scaled, 1e-4);
        for (place, l) in lit.iter().enumerate() {
            let light = l.as_ref().map_or(0.0, |l| l.irradiance.x);
            let (a, b) = (
                one.at(light, 1.0, place),
                other.at(1e-4 * light, 1.0, place),
            );
            assert!((a - b).abs() < 1e-3, "{a} and {b} at {place}");
        }
    }

    #[test]
    fn nothing_to_compare_with_leaves_quotients_as_they_are() {
        let (places, lit) = sheet(|_, _| 0.0);
        let unseen: Vec<Option<Lit>> = lit.iter().map(|_| None).collect();
        let trust = Trust::new(&places, &unseen, 1.0);
        assert_eq!(trust.at(0.1, 1.0, 7), 1.0);
        assert_eq!(trust.at(0.0, 1.0, 7), 0.0);
    }
}
