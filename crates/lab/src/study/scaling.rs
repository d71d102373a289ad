//! What time and memory grow with.

use super::case::Group;
use super::stability;
use super::trial::THREADS;
use crate::synth::{Light, Places, Recipe};

/// Width and height of the photographs where they are not swept.
const SIZE: [u32; 2] = [640, 480];
/// The same where there are many views.
const SMALL: [u32; 2] = [320, 240];
/// Sizes of photographs, 0.1 to 12 megapixels.
const SIZES: [[u32; 2]; 5] = [
    [368, 276],
    [640, 480],
    [1152, 864],
    [2000, 1500],
    [4000, 3000],
];

/// All groups of the section; photographs have at most so many megapixels.
pub(super) fn groups(most_megapixels: f64) -> Vec<Group> {
    let base = stability::base(SIZE);
    let small = stability::base(SMALL);
    let sizes: Vec<[u32; 2]> = SIZES
        .into_iter()
        .filter(|size| megapixels(*size) <= most_megapixels)
        .collect();
    let pixels: Vec<f64> = sizes.iter().map(|size| megapixels(*size)).collect();
    let mut many = base.clone();
    many.views.count = 24;
    let wanted = [("24 views of 1024×768", [1024, 768])];
    let wanted: Vec<(&str, [u32; 2])> = wanted
        .into_iter()
        .filter(|(_, size)| megapixels(*size) <= most_megapixels)
        .collect();
    vec![
        Group::sweep(
            "pixels",
            "megapixels of each of six views",
            &base,
            &pixels,
            |recipe, value| {
                let size = sizes.iter().find(|size| megapixels(**size) == value);
                recipe.views.size = size.copied().unwrap_or(SIZE);
            },
        ),
        Group::named("many", "capture", &many, &wanted, |recipe, size| {
            recipe.views.size = size;
        }),
        Group::sweep(
            "views",
            "views of 320×240",
            &small,
            &[2.0, 4.0, 8.0, 16.0, 32.0, 64.0],
            |recipe, count| {
                recipe.views.count = count as u32;
            },
        ),
        Group::option(
            "frequency",
            "frequency of the hemisphere",
            &base,
            &[10, 20, 35, 70, 140],
            "--frequency",
        ),
        Group::sweep(
            "triangles",
            "triangles",
            &base,
            &[1e3, 1e4, 1e5, 1e6, 2e6],
            |recipe, count| {
                recipe.triangles = count as u32;
            },
        ),
        Group::sweep(
            "lamps",
            "lamps",
            &base,
            &[1.0, 2.0, 4.0, 8.0, 12.0],
            set_lamps,
        ),
        Group::option("threads", "threads", &base, &[1, 2], THREADS),
    ]
}

fn set_lamps(recipe: &mut Recipe, count: f64) {
    if let Light::Lamps(lamps) = &mut recipe.light {
        lamps.places = Places::Spread(count as u32);
    }
}

fn megapixels([width, height]: [u32; 2]) -> f64 {
    f64::from(width * height) / 1e6
}
