//! Does the 95 % interval of σ hold the truth in 95 % of captures that differ in everything?

use super::case::Group;
use super::stability;
use crate::synth::{Light, Material, Object, Places, Recipe};
use rekindle_base::math::random::Random;

/// Noise levels, percent of the object's mean radiance.
const NOISE: [f64; 3] = [0.3, 1.0, 3.0];
/// Small photographs of a large highlight: many captures in little time.
const SIZE: [u32; 2] = [160, 120];
/// Views and triangles of each.
const VIEWS: u32 = 4;
const TRIANGLES: u32 = 6000;
/// The roughnesses, radians: from the first up to as many times it as the second.
const SIGMA: [f64; 2] = [0.1, 2.5];
/// At most this many lamps.
const MOST_LAMPS: u64 = 3;

/// A group of so many captures for each noise level; seeds decide roughness, lamps, texture, cameras and noise.
pub(super) fn groups(seeds: u32) -> Vec<Group> {
    let numbers: Vec<f64> = (1..=seeds).map(f64::from).collect();
    NOISE
        .into_iter()
        .zip(["noise_0.3", "noise_1", "noise_3"])
        .map(|(percent, name)| {
            let mut base = stability::base(SIZE);
            base.object = Object::Torus;
            base.triangles = TRIANGLES;
            base.views.count = VIEWS;
            base.sensor.noise = percent as f32 / 100.0;
            Group::sweep(name, "seed", &base, &numbers, vary)
        })
        .collect()
}

fn vary(recipe: &mut Recipe, seed: f64) {
    recipe.seed = seed as u64;
    // Apart from what the recipe's own seed decides.
    let random = Random::new(recipe.seed, u64::MAX);
    let sigma = SIGMA[0] * SIGMA[1].powf(random.uniform(0));
    recipe.material = Material::paper(sigma as f32, 0.4);
    if let Light::Lamps(lamps) = &mut recipe.light {
        lamps.places = Places::Spread(1 + (recipe.seed % MOST_LAMPS) as u32);
    }
}
