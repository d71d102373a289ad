//! The true light as a lat-long picture, in the mapping of the path-traced captures: row j and column i of H × W have
//! θ = π(j + ½)/H from +Y and φ = 2π(i + ½)/W, and show (sin θ sin φ, cos θ, −sin θ cos φ).

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::lamps::TrueLamp;
use super::scene::TrueLight;

/// Rows; there are twice as many columns.
const ROWS: usize = 512;
/// Samples along each side of a texel that a lamp's rim crosses.
const SAMPLES: usize = 8;
/// What `truth.json` says of the mapping.
pub(super) const MAPPING: &str = "lat-long, row j column i (centres at +0.5), H x W: theta = pi*(j+0.5)/H from +Y, \
     phi = 2*pi*(i+0.5)/W, direction towards the light = (sin(theta)*sin(phi), cos(theta), -sin(theta)*cos(phi)); \
     values are radiance, texel-averaged";

/// Width of the picture and its radiances, RGB, row by row from the top.
pub(super) fn picture(light: &TrueLight, scale: f32) -> (u32, Vec<[f32; 3]>) {
    let columns = 2 * ROWS;
    let mut radiance = vec![Vec3::ZERO; ROWS * columns];
    match light {
        TrueLight::Probe(probe) => {
            for (i, value) in radiance.iter_mut().enumerate() {
                let place = [(i % columns) as f32 + 0.5, (i / columns) as f32 + 0.5];
                *value = probe.radiance(direction(place)) * scale;
            }
        }
        TrueLight::Lamps(lamps) => {
            for lamp in lamps {
                add(lamp, &mut radiance);
            }
        }
    }
    (
        columns as u32,
        radiance.iter().map(Vec3::to_array).collect(),
    )
}

/// The direction of a place in columns and rows.
fn direction([column, row]: [f32; 2]) -> Vec3 {
    let (theta, phi) = (PI * row / ROWS as f32, PI * column / ROWS as f32);
    Vec3::new(
        theta.sin() * phi.sin(),
        theta.cos(),
        -theta.sin() * phi.cos(),
    )
}

/// Adds a lamp with exactly its flux.
fn add(lamp: &TrueLamp, radiance: &mut [Vec3]) {
    let columns = 2 * ROWS;
    let solid_angle = |row: usize| {
        let cos = |r: usize| (PI * r as f32 / ROWS as f32).cos();
        (cos(row) - cos(row + 1)) * TAU / columns as f32
    };
    let texel = PI / ROWS as f32;
    let near = (lamp.angular_radius + texel).min(PI).cos();
    let inside = lamp.angular_radius.cos();
    let (mut shares, mut covered) = (Vec::new(), 0.0);
    let (mut nearest, mut closeness) = (0, f32::NEG_INFINITY);
    for i in 0..radiance.len() {
        let (column, row) = (i % columns, i / columns);
        let cos = direction([column as f32 + 0.5, row as f32 + 0.5]).dot(lamp.direction);
        if cos > closeness {
            (nearest, closeness) = (i, cos);
        }
        if cos < near {
            continue;
        }
        let hits = (0..SAMPLES * SAMPLES)
            .filter(|k| {
                let part = |k: usize| (k as f32 + 0.5) / SAMPLES as f32;
                let place = [
                    column as f32 + part(k % SAMPLES),
                    row as f32 + part(k / SAMPLES),
                ];
                direction(place).dot(lamp.direction) > inside
            })
            .count();
        let share = hits as f32 / (SAMPLES * SAMPLES) as f32;
        covered += share * solid_angle(row);
        shares.push((i, share));
    }
    if covered == 0.0 {
        // Smaller than the samples' distance: all in one texel.
        shares = vec![(nearest, 1.0)];
        covered = solid_angle(nearest / columns);
    }
    let level = lamp.radiance * (lamp.solid_angle() / covered);
    for (i, share) in shares {
        radiance[i] += level * share;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_holds_every_lamps_flux_where_it_is() {
        for angular_radius in [1e-4, 0.05, 0.4] {
            let lamp = TrueLamp {
                direction: Vec3::new(0.48, 0.6, 0.64),
                radiance: Vec3::new(5.0, 3.0, 1.0),
                angular_radius,
                distance: None,
            };
            let (width, radiance) = picture(&TrueLight::Lamps(vec![lamp]), 1.0);
            let (mut flux, mut moment) = (Vec3::ZERO, Vec3::ZERO);
            for (i, value) in radiance.iter().enumerate() {
                let (column, row) = (i % width as usize, i / width as usize);
                let cos = |r: usize| (PI * r as f32 / ROWS as f32).cos();
                let part = Vec3::from(*value) * (cos(row) - cos(row + 1)) * TAU / width as f32;
                flux += part;
                moment += direction([column as f32 + 0.5, row as f32 + 0.5]) * part.x;
            }
            let expected = lamp.radiance * lamp.solid_angle();
            assert!(
                (flux - expected).length() < 1e-3 * expected.length(),
                "{flux} {expected}"
            );
            let off = moment.angle_between(lamp.direction).to_degrees();
            assert!(off < 0.3, "{off}° off");
        }
    }
}
