//! What a sensor makes of radiance: gain errors, photon noise, outliers, clipping. All of it is decided per pixel from
//! the seed, so that nothing depends on the order of the work.

use super::recipe::Sensor;
use rekindle_base::math::random::Random;
use rekindle_relight::Picture;

/// Pixels whose specular part is more than this part of their radiance are a highlight's.
const HIGHLIGHT: f32 = 0.5;
/// Outliers are anything up to this percentile of the object's radiance.
const BRIGHT: f64 = 0.995;

/// A sensor set to the light that it finds.
pub(super) struct Exposed {
    sensor: Sensor,
    random: Random,
    /// Mean radiance of the object's pixels.
    mean: f32,
    /// Radiance that 99.5 % of the object's pixels stay below.
    bright: f32,
    /// Radiance at which the sensor is at full scale, infinite where nothing is clipped.
    pub full_scale: f32,
}

impl Exposed {
    /// Meters all photographs together.
    pub(super) fn new(sensor: Sensor, pictures: &[Picture], random: Random) -> Self {
        let (mut object, mut highlights) = (Vec::new(), Vec::new());
        for picture in pictures {
            for i in (0..picture.coverage.len()).filter(|&i| picture.coverage[i] == 1.0) {
                let pixel = radiance(picture, i);
                let mean = pixel.iter().sum::<f32>() / 3.0;
                object.push(mean);
                let specular = picture.specular[i].iter().sum::<f32>() / 3.0;
                if specular > HIGHLIGHT * mean {
                    highlights.push(pixel.iter().fold(0.0, |m: f32, &v| m.max(v)));
                }
            }
        }
        let sum: f64 = object.iter().map(|&v| f64::from(v)).sum();
        let clipped = f64::from(sensor.saturated);
        Self {
            sensor,
            random,
            mean: (sum / object.len().max(1) as f64) as f32,
            bright: quantile(&mut object, BRIGHT),
            full_scale: if clipped > 0.0 && !highlights.is_empty() {
                quantile(&mut highlights, 1.0 - clipped)
            } else {
                f32::INFINITY
            },
        }
    }

    /// What view number `view` reads, RGB, premultiplied by coverage. Values beyond [`Self::full_scale`] are clipped.
    pub(super) fn read(&self, view: usize, picture: &Picture) -> Vec<[f32; 3]> {
        let random = self.random.of(view as u64);
        let (noise, outliers, values) = (random.of(0), random.of(1), random.of(2));
        let gain = 1.0 + self.sensor.gain_error * random.normal(3) as f32;
        (0..picture.coverage.len())
            .map(|i| {
                let (index, coverage) = (i as u64, picture.coverage[i]);
                if coverage == 0.0 {
                    return [0.0; 3];
                }
                let stray = outliers.uniform(index) < f64::from(self.sensor.outliers);
                let clean = radiance(picture, i);
                let channel = |c: usize| {
                    let k = 3 * index + c as u64;
                    let value = if stray {
                        self.bright * coverage * values.uniform(k) as f32
                    } else {
                        gain * clean[c]
                    };
                    // The variance of photon noise grows with the radiance.
                    let deviation = self.sensor.noise * (value * self.mean).sqrt();
                    let read = value + deviation * noise.normal(k) as f32;
                    read.min(self.full_scale * coverage)
                };
                [0, 1, 2].map(channel)
            })
            .collect()
    }
}

/// Radiance of a pixel, RGB.
fn radiance(picture: &Picture, i: usize) -> [f32; 3] {
    [0, 1, 2].map(|c| picture.diffuse[i][c] + picture.specular[i][c])
}

/// The value that a part of all `values` stays below, 0 if there are none.
fn quantile(values: &mut [f32], part: f64) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let at = ((values.len() - 1) as f64 * part).round() as usize;
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::super::recipe::{Files, Recipe};
    use super::*;

    /// A picture of 20,000 pixels of diffuse radiance 1, a tenth of which have highlights of 1 to 10.
    fn picture() -> Picture {
        let count = 20_000;
        let highlight = |i: usize| {
            let shine = if i.is_multiple_of(10) {
                2.0 + 8.0 * i as f32 / count as f32
            } else {
                0.0
            };
            [shine; 3]
        };
        Picture {
            width: 200,
            height: 100,
            coverage: vec![1.0; count],
            diffuse: vec![[1.0; 3]; count],
            specular: (0..count).map(highlight).collect(),
        }
    }

    fn read(change: impl FnOnce(&mut Sensor)) -> (Vec<f32>, Exposed) {
        let mut sensor = Recipe::default().sensor;
        sensor.files = Files::Exr;
        change(&mut sensor);
        let pictures = [picture()];
        let exposed = Exposed::new(sensor, &pictures, Random::new(1, 1));
        let read = exposed.read(0, &pictures[0]);
        (read.into_iter().map(|p| p[0]).collect(), exposed)
    }

    #[test]
    fn noise_has_the_stated_deviation_at_the_mean_radiance() {
        let (values, exposed) = read(|sensor| sensor.noise = 0.05);
        let dull: Vec<f32> = (0..values.len())
            .filter(|i| !i.is_multiple_of(10))
            .map(|i| values[i] - 1.0)
            .collect();
        let squares: f32 = dull.iter().map(|d| d * d).sum();
        let deviation = (squares / dull.len() as f32).sqrt();
        // At radiance 1 it is smaller than at the mean by the root of their ratio.
        let expected = 0.05 * exposed.mean * (1.0 / exposed.mean).sqrt();
        assert!(
            (deviation / expected - 1.0).abs() < 0.03,
            "{deviation} {expected}"
        );
    }

    #[test]
    fn the_stated_part_of_the_highlights_is_clipped() {
        for part in [0.25, 1.0] {
            let (values, exposed) = read(|sensor| sensor.saturated = part);
            let clipped = values.iter().filter(|&&v| v >= exposed.full_scale).count();
            let expected = 2000.0 * part;
            assert!(
                (clipped as f32 - expected).abs() < 5.0,
                "{clipped} of {expected}"
            );
        }
        assert_eq!(read(|_| {}).1.full_scale, f32::INFINITY);
    }

    #[test]
    fn outliers_and_gains_are_as_many_and_as_large_as_stated() {
        let clean = read(|_| {}).0;
        let (values, _) = read(|sensor| sensor.outliers = 0.1);
        let changed = values.iter().zip(&clean).filter(|(a, b)| a != b).count();
        assert!((1850..2150).contains(&changed), "{changed}");
        let (values, _) = read(|sensor| sensor.gain_error = 0.1);
        let gain = values[1] / clean[1];
        assert!(gain != 1.0 && (gain - 1.0).abs() < 0.4);
        assert!(
            values
                .iter()
                .zip(&clean)
                .all(|(a, b)| (a / b / gain - 1.0).abs() < 1e-5)
        );
    }
}
