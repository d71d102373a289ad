//! Recovering a camera's response from its brackets, after Debevec and Malik (1997).
//!
//! With g = ln of the response, code u of a file with exposure amount H says ln E = g(u) − ln H of the radiance E. A point
//! has one E in all exposures, which is eliminated by subtracting weighted means; g solves
//! `min Σ w (g(u) − ln H − ln E)² + λ Σ (h″)²` with g(u) = h(u) + (1 + a) s(u) + b ln u, where s is sRGB's curve.
//! Only h is held smooth, so that sRGB, any power of it, linear files and any gamma are found exactly. This also
//! settles what exposures that are a constant factor apart leave open: a ripple of that period in ln E (Grossberg and Nayar
//! 2003). Weights are those of the codes' noise; points that moved between exposures lose theirs.
//!
//! A curve takes the place of the one that files are taken as only where that explains the brackets worse; a curve for each
//! channel only where one for all does.

use super::response::{KNOTS, MIDDLE, Origin, Response, srgb_to_linear};
use faer::Mat;
use rekindle_base::math::sparse::LowerEntries;

/// Columns of the system: the knots of h, then a and b.
const COLUMNS: usize = KNOTS + 2;
/// Codes below are mostly noise and those above mostly clipped: they say nothing of the curve. In parts of full scale.
const LEAST: f64 = 16.0 / 255.0;
const MOST: f64 = 250.5 / 255.0;
/// Noise of a code, in codes of 8 bits: rounding and a little more. Only its relation to λ matters.
const CODE_NOISE: f64 = 0.6;
/// What h″ is expected to be, per code squared, and how many times that near full scale, where films have their shoulder.
const CURVATURE: f64 = 1e-4;
const SHOULDER: f64 = 3.0;
/// Fits, each with the weights that follow from the one before.
const ROUNDS: usize = 8;
/// Residuals beyond this many standard deviations lose weight (Cauchy).
const CAUCHY: f64 = 2.385;
/// A freer curve must explain the brackets this much better.
const BETTER: f64 = 1.1;
/// Fewer points tell nothing of a curve.
const ENOUGH: usize = 200;

/// One channel of a point of the picture in the exposures that show it.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    /// 0, 1 or 2.
    pub channel: usize,
    /// Code in [0, 1] and ln H of each exposure.
    pub values: Vec<(f64, f64)>,
}

impl Sample {
    /// The sample without exposures whose code says nothing; none if less than two are left.
    pub(super) fn new(channel: usize, mut values: Vec<(f64, f64)>) -> Option<Self> {
        values.retain(|(code, _)| (LEAST..=MOST).contains(code));
        let first = values.first()?.1;
        let differ = values.iter().any(|(_, amount)| *amount != first);
        differ.then_some(Self { channel, values })
    }
}

/// g at the knots; the first says nothing.
type LogCurve = Vec<f64>;

/// How samples are weighed.
#[derive(Clone, Debug)]
struct Noise {
    /// Inverse variance of ln E from a code near each knot.
    weights: Vec<f64>,
    /// Standard deviation of the residuals in units of that.
    scale: f64,
}

/// The response that fits the samples; `assumed` is what the files are taken as.
pub(super) fn recover(samples: &[Sample], assumed: Origin) -> Response {
    let mut response = Response::assumed(assumed);
    response.compared = samples.len();
    let all: Vec<&Sample> = samples.iter().collect();
    let known = log_curve(&response.curves[0]);
    if all.len() < ENOUGH {
        return response;
    }
    let Some((joint, noise)) = fit(&all, &known) else {
        return response;
    };
    let misfit = |curve: &LogCurve, of: &[&Sample]| cost(of, curve, &noise);
    let (before, after) = (misfit(&known, &all), misfit(&joint, &all));
    response.disagreement_assumed = Some(disagreement(&all, &known, &noise));
    response.disagreement = response.disagreement_assumed;
    if before <= BETTER * after {
        return response;
    }
    let channels: Vec<Vec<&Sample>> = (0..3)
        .map(|c| all.iter().copied().filter(|s| s.channel == c).collect())
        .collect();
    let own: Option<Vec<LogCurve>> = channels
        .iter()
        .map(|of| (of.len() >= ENOUGH).then(|| fit(of, &joint).map(|(curve, _)| curve))?)
        .collect();
    if let Some(own) = own {
        let separate: f64 = own.iter().zip(&channels).map(|(g, of)| misfit(g, of)).sum();
        if after > BETTER * separate {
            let squares = own.iter().zip(&channels).map(|(g, of)| {
                let rms = disagreement(of, g, &noise);
                rms * rms * of.len() as f64
            });
            response.disagreement = Some((squares.sum::<f64>() / all.len() as f64).sqrt());
            response.origin = Origin::RecoveredPerChannel;
            response.curves = [0, 1, 2].map(|c| linear_curve(&own[c]));
            return response;
        }
    }
    response.disagreement = Some(disagreement(&all, &joint, &noise));
    response.origin = Origin::Recovered;
    response.curves = [0, 1, 2].map(|_| linear_curve(&joint));
    response
}

/// ln of a curve, −∞ at code 0.
fn log_curve(curve: &[f32]) -> LogCurve {
    curve.iter().map(|&v| f64::from(v).ln()).collect()
}

/// The curve of its logarithm, made to rise where noise let it fall, with nothing at code 0.
fn linear_curve(log: &LogCurve) -> Vec<f32> {
    let mut rising = log[1..].to_vec();
    // From the middle outwards, so that neither end can lift or press down the whole.
    for k in MIDDLE..rising.len() {
        rising[k] = rising[k].max(rising[k - 1] + 1e-6);
    }
    for k in (0..MIDDLE - 1).rev() {
        rising[k] = rising[k].min(rising[k + 1] - 1e-6);
    }
    let rest = rising.iter().map(|g| g.exp() as f32);
    std::iter::once(0.0).chain(rest).collect()
}

/// The two knots around a code and the part of the second.
fn place(code: f64) -> (usize, f64) {
    let at = code * (KNOTS - 1) as f64;
    let knot = (at as usize).min(KNOTS - 2);
    (knot, at - knot as f64)
}

fn value(curve: &LogCurve, code: f64) -> f64 {
    let (knot, part) = place(code);
    (1.0 - part) * curve[knot] + part * curve[knot + 1]
}

impl Noise {
    /// The noise of codes under a curve without ripples: CODE_NOISE times its slope, and no less than a quarter of what
    /// sRGB would have.
    fn under(smooth: &LogCurve, shape: &LogCurve) -> Self {
        let slope = |curve: &LogCurve, k: usize| {
            let (low, high) = (k.max(2) - 1, (k + 1).clamp(3, KNOTS - 1));
            (curve[high] - curve[low]) / (high - low) as f64
        };
        let weight = |k: usize| {
            let deviation = CODE_NOISE * slope(smooth, k).max(0.25 * slope(shape, k));
            1.0 / (deviation * deviation)
        };
        Self {
            weights: (0..KNOTS).map(weight).collect(),
            scale: 1.0,
        }
    }

    fn weight(&self, code: f64) -> f64 {
        self.weights[place(code).0]
    }
}

/// Residuals of a sample under a curve, with their weights.
fn residuals(sample: &Sample, curve: &LogCurve, noise: &Noise) -> Vec<(f64, f64)> {
    let terms: Vec<(f64, f64)> = sample
        .values
        .iter()
        .map(|&(code, amount)| (value(curve, code) - amount, noise.weight(code)))
        .collect();
    let (sum, total) = terms
        .iter()
        .fold((0.0, 0.0), |(s, t), (v, w)| (s + w * v, t + w));
    let mean = sum / total;
    terms.iter().map(|&(v, w)| ((v - mean), w)).collect()
}

/// Standard deviation of the residuals in units of the codes' noise, by their median.
fn spread(samples: &[&Sample], curve: &LogCurve, noise: &Noise) -> f64 {
    let mut all: Vec<f64> = samples
        .iter()
        .flat_map(|sample| residuals(sample, curve, noise))
        .map(|(r, w)| r.abs() * w.sqrt())
        .collect();
    let middle = all.len() / 2;
    let median = *all.select_nth_unstable_by(middle, f64::total_cmp).1;
    // 1.48 makes it that of a normal distribution. Rounding alone leaves less than one, but neighbouring points alike.
    (1.4826 * median).max(1.0)
}

/// Sum of Cauchy's function of the residuals.
fn cost(samples: &[&Sample], curve: &LogCurve, noise: &Noise) -> f64 {
    let each = samples.iter().flat_map(|s| residuals(s, curve, noise));
    let function = |t: f64| (t / CAUCHY).powi(2).ln_1p();
    each.map(|(r, w)| function(r * w.sqrt() / noise.scale))
        .sum()
}

/// Root mean square residual of ln E with Cauchy's weights.
fn disagreement(samples: &[&Sample], curve: &LogCurve, noise: &Noise) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for (r, w) in samples.iter().flat_map(|s| residuals(s, curve, noise)) {
        let robust = w * cauchy(r * w.sqrt() / noise.scale);
        sum += robust * r * r;
        total += robust;
    }
    (sum / total).sqrt()
}

/// Weight of a residual of t standard deviations.
fn cauchy(t: f64) -> f64 {
    1.0 / (1.0 + (t / CAUCHY).powi(2))
}

/// The curve that fits samples best, beginning with `start`, and the noise of what it leaves.
fn fit(samples: &[&Sample], start: &LogCurve) -> Option<(LogCurve, Noise)> {
    let shape: LogCurve = (0..KNOTS)
        .map(|k| f64::from(srgb_to_linear(k.max(1) as f32 / (KNOTS - 1) as f32)).ln())
        .collect();
    let logs: LogCurve = (0..KNOTS)
        .map(|k| (k.max(1) as f64 / (KNOTS - 1) as f64).ln())
        .collect();
    let mut curve = start.clone();
    let mut noise = Noise::under(&shape, &shape);
    noise.scale = spread(samples, &curve, &noise);
    for _ in 0..ROUNDS {
        let x = System::new(samples, &curve, &noise, [&shape, &logs]).solve()?;
        let (a, b) = (x[(KNOTS, 0)], x[(KNOTS + 1, 0)]);
        let plain = |k: usize| (1.0 + a) * shape[k] + b * logs[k];
        let middle = x[(MIDDLE, 0)] + plain(MIDDLE);
        curve = (0..KNOTS)
            .map(|k| x[(k, 0)] + plain(k) - middle + shape[MIDDLE])
            .collect();
        noise = Noise::under(&(0..KNOTS).map(plain).collect(), &shape);
        noise.scale = spread(samples, &curve, &noise);
    }
    Some((curve, noise))
}

/// The normal equations of a fit.
struct System {
    matrix: Vec<f64>,
    rhs: Vec<f64>,
}

impl System {
    /// Rows of all samples, weighted by the noise of their codes and by how well `curve` fits them.
    fn new(
        samples: &[&Sample],
        curve: &LogCurve,
        noise: &Noise,
        [shape, logs]: [&LogCurve; 2],
    ) -> Self {
        let mut system = Self {
            matrix: vec![0.0; COLUMNS * COLUMNS],
            rhs: vec![0.0; COLUMNS],
        };
        for sample in samples {
            let residuals = residuals(sample, curve, noise);
            let mut mean: Vec<(usize, f64)> = Vec::with_capacity(4 * residuals.len());
            let (mut mean_rhs, mut total) = (0.0, 0.0);
            for (&(code, amount), (r, w)) in sample.values.iter().zip(residuals) {
                let weight = w * cauchy(r * w.sqrt() / noise.scale) / (noise.scale * noise.scale);
                let (knot, part) = place(code);
                let row = [
                    (knot, 1.0 - part),
                    (knot + 1, part),
                    (KNOTS, value(shape, code)),
                    (KNOTS + 1, value(logs, code)),
                ];
                let rhs = amount - value(shape, code);
                system.add(&row, rhs, weight);
                mean.extend(row.map(|(column, v)| (column, weight * v)));
                mean_rhs += weight * rhs;
                total += weight;
            }
            // The point's own radiance, eliminated.
            system.add(&mean, mean_rhs, -1.0 / total);
        }
        system.add_prior();
        system
    }

    fn add(&mut self, row: &[(usize, f64)], rhs: f64, weight: f64) {
        for &(i, a) in row {
            self.rhs[i] += weight * a * rhs;
            for &(j, b) in row {
                self.matrix[i * COLUMNS + j] += weight * a * b;
            }
        }
    }

    /// Smoothness of h, and a value for what is free.
    fn add_prior(&mut self) {
        for k in 1..KNOTS - 1 {
            let near = (k as f64 / KNOTS as f64).powi(8);
            let bend = CURVATURE * (1.0 + (SHOULDER - 1.0) * near);
            let stiffness = 1.0 / (bend * bend);
            self.add(&[(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)], 0.0, stiffness);
        }
        self.add(&[(MIDDLE, 1.0)], 0.0, 1.0);
        self.add(&[(0, -1.0), (KNOTS - 1, 1.0)], 0.0, 1.0);
        self.add(&[(KNOTS, 1.0)], 0.0, 1.0);
        self.add(&[(KNOTS + 1, 1.0)], 0.0, 1.0);
    }

    fn solve(&self) -> Option<Mat<f64>> {
        let mut entries = LowerEntries::default();
        for row in 0..COLUMNS {
            for column in 0..=row {
                let value = self.matrix[row * COLUMNS + column];
                if value != 0.0 {
                    entries.add(row, column, value);
                }
            }
        }
        let rhs = Mat::from_fn(COLUMNS, 1, |i, _| self.rhs[i]);
        entries.solve(&rhs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_base::math::random::Random;

    /// Points photographed with exposures a factor `step` apart by a camera that encodes by `encode`, with noise in codes.
    fn brackets(
        encode: &dyn Fn(usize, f64) -> f64,
        step: f64,
        exposures: i32,
        noise: f64,
    ) -> Vec<Sample> {
        let random = Random::new(3, 5);
        let mut samples = Vec::new();
        for i in 0..3000_u64 {
            let radiance = (random.of(1).uniform(i) * 12.0 - 10.0).exp2();
            for channel in 0..3 {
                let values = (0..exposures)
                    .map(|k| {
                        let amount = step.powi(k);
                        let index = (i * 3 + channel as u64) * 16 + k as u64;
                        let code = 255.0 * encode(channel, radiance * amount)
                            + noise * random.of(2).normal(index);
                        (code.round().clamp(0.0, 255.0) / 255.0, amount.ln())
                    })
                    .collect();
                samples.extend(Sample::new(channel, values));
            }
        }
        samples
    }

    fn srgb(v: f64) -> f64 {
        if v <= 0.003_130_8 {
            12.92 * v
        } else {
            1.055 * v.powf(1.0 / 2.4) - 0.055
        }
    }

    /// Largest relative error of a curve's exposures up to code 245, apart from a common factor, where one code more is
    /// less than 6 % more radiance.
    fn worst(response: &Response, channel: usize, encode: &dyn Fn(f64) -> f64) -> f64 {
        let decode = |k: usize| {
            // By bisection.
            let (mut low, mut high) = (0.0, 16.0);
            for _ in 0..80 {
                let middle = 0.5 * (low + high);
                if encode(middle) < k as f64 / 255.0 {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            low
        };
        let ratio = |k: usize| f64::from(response.curves[channel][k]) / decode(k);
        let middle = ratio(MIDDLE);
        let usable = (1..=245).filter(|&k| decode(k + 1) < 1.06 * decode(k));
        let errors = usable.map(|k| (ratio(k) / middle - 1.0).abs());
        errors.fold(0.0, f64::max)
    }

    fn film(v: f64) -> f64 {
        // A toe and a shoulder on a gamma.
        let x = v.powf(0.55);
        1.25 * x / (0.25 + x) * (x / (x + 0.02)).powf(0.7) / (1.0 + 0.25 * x).powf(0.3)
    }

    #[test]
    fn files_that_are_srgb_stay_srgb() {
        for noise in [0.0, 1.5] {
            for step in [2.0, 4.0] {
                let samples = brackets(&|_, v| srgb(v.min(1.0)), step, 4, noise);
                let response = recover(&samples, Origin::Srgb);
                assert_eq!(
                    response.origin,
                    Origin::Srgb,
                    "{noise} {step} {:?}",
                    response.disagreement
                );
            }
        }
    }

    /// A name, how codes follow from exposures, and steps between exposures.
    type Case<'a> = (&'a str, &'a dyn Fn(f64) -> f64, &'a [f64]);

    #[test]
    fn gammas_films_and_linear_files_are_recovered() {
        let gamma = |v: f64| v.min(1.0).powf(1.0 / 1.8);
        let linear = |v: f64| v.min(1.0);
        let film_like = |v: f64| film(v).min(1.0);
        // Exposures four times apart leave a curve's shape open over so many codes that a film's isn't found.
        let cases: [Case<'_>; 3] = [
            ("gamma", &gamma, &[2.0, 4.0]),
            ("linear", &linear, &[2.0, 4.0]),
            ("film", &film_like, &[2.0]),
        ];
        for (name, encode, steps) in cases {
            for (&step, noise) in steps.iter().flat_map(|step| [(step, 0.0), (step, 1.0)]) {
                let samples = brackets(&|_, v| encode(v), step, 4, noise);
                let response = recover(&samples, Origin::Srgb);
                assert_eq!(response.origin, Origin::Recovered, "{name}");
                let error = worst(&response, 1, encode);
                assert!(
                    error < 0.02,
                    "{name}, steps of {step}, noise {noise}: {error}"
                );
            }
        }
    }

    #[test]
    fn channels_of_their_own_curves_are_told_apart() {
        let encode = |channel: usize, v: f64| v.min(1.0).powf(1.0 / [1.7, 2.2, 2.7][channel]);
        let response = recover(&brackets(&encode, 2.0, 4, 0.5), Origin::Srgb);
        assert_eq!(response.origin, Origin::RecoveredPerChannel);
        for channel in 0..3 {
            let error = worst(&response, channel, &|v| encode(channel, v));
            assert!(error < 0.02, "channel {channel}: {error}");
        }
    }

    #[test]
    fn points_that_moved_do_not_matter() {
        let gamma = |v: f64| v.min(1.0).powf(1.0 / 1.8);
        let mut samples = brackets(&|_, v| gamma(v), 2.0, 4, 0.5);
        for sample in samples.iter_mut().step_by(12) {
            sample.values[0].0 = 0.5 * (sample.values[0].0 + 0.5);
        }
        let response = recover(&samples, Origin::Srgb);
        let error = worst(&response, 0, &gamma);
        assert!(error < 0.02, "{error}");
    }

    #[test]
    fn few_points_leave_the_curve_alone() {
        let mut samples = brackets(&|_, v| v.min(1.0), 2.0, 4, 0.0);
        samples.truncate(ENOUGH - 1);
        assert_eq!(recover(&samples, Origin::Srgb).origin, Origin::Srgb);
    }
}
