//! What an EXR file holds beside the picture, so that it can be relit by adding layers.
//!
//! | channels | hold |
//! | --- | --- |
//! | `R G B A` | linear radiance, premultiplied by coverage |
//! | `diffuse`, `specular` | its two parts, premultiplied |
//! | `albedo`, `irradiance` | factors of the diffuse part; the albedo is premultiplied |
//! | `normal`, `position` | of the world, mean over the covered part; the normal is unit |
//! | `Z` | distance along the camera's axis in mesh units, 0 where there is nothing |
//! | `light_1` … `light_rest` | light groups: the picture by one lamp alone, and by all else |
//!
//! The light groups add up to the picture exactly, in whatever order they are added: each is a whole multiple of the last
//! binary digit of the sum.

use std::ops::ControlFlow;

use glam::Vec3;
use rayon::prelude::*;

use super::renderer::{LitScene, Renderer};
use rekindle_capture::Camera;
use rekindle_relight::{Band, Lighting, ShadingPoint, Stop};
use rekindle_solution::Solution;

/// Name of the group of all light that belongs to no lamp.
const REST: &str = "light_rest";

/// The picture alone.
const PICTURE: [&str; 4] = ["R", "G", "B", "A"];
/// Layers of colours and of vectors.
const COLOURS: [&str; 4] = ["diffuse", "specular", "albedo", "irradiance"];
const VECTORS: [&str; 2] = ["normal", "position"];

/// Which channels a file has.
pub(super) struct Layers<'a> {
    /// Whether there is more than the picture.
    all: bool,
    groups: Vec<Group<'a>>,
}

/// Light on its own.
struct Group<'a> {
    name: String,
    lit: LitScene<'a>,
}

/// The values of one channel.
type Plane = (String, Vec<f32>);

impl<'a> Layers<'a> {
    /// The picture, with all layers or without.
    pub(super) fn new(all: bool) -> Self {
        Self {
            all,
            groups: Vec::new(),
        }
    }

    /// Adds a group for each lamp of a lighting and one for the rest. Breaks off where `stop` says so.
    #[must_use]
    pub(super) fn with_groups(
        mut self,
        renderer: &'a Renderer<'a>,
        lighting: &Lighting,
        stop: Stop,
    ) -> Self {
        for (name, alone) in groups(lighting) {
            if stop() {
                break;
            }
            let lit = renderer.light(&alone);
            self.groups.push(Group { name, lit });
        }
        self
    }

    /// Names of the channels, in alphabetical order as files have them.
    pub(super) fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = PICTURE.iter().map(|&n| n.to_owned()).collect();
        let mut layer = |name: &str, channels: [&str; 3]| {
            names.extend(channels.iter().map(|c| format!("{name}.{c}")));
        };
        if self.all {
            for name in COLOURS {
                layer(name, ["R", "G", "B"]);
            }
            for name in VECTORS {
                layer(name, ["X", "Y", "Z"]);
            }
        }
        for group in &self.groups {
            layer(&group.name, ["R", "G", "B"]);
        }
        if self.all {
            names.push("Z".to_owned());
        }
        names.sort_unstable();
        names
    }

    /// The values of each channel, in the order of the names; `rgb` is the picture. `None` where `stop` has said so.
    pub(super) fn planes(
        &self,
        solution: &Solution,
        camera: &Camera,
        band: &Band,
        rgb: &[[f32; 3]],
        stop: Stop,
    ) -> Option<Vec<Vec<f32>>> {
        let mut planes: Vec<Plane> = vec![("A".to_owned(), band.coverage.clone())];
        add(&mut planes, "", ["R", "G", "B"], rgb);
        if self.all {
            layers(&mut planes, solution, camera, band);
        }
        if !self.groups.is_empty() {
            let parts = self
                .groups
                .iter()
                .map(|group| part(&group.lit, camera, band, stop))
                .collect::<Option<Vec<Part>>>()?;
            for (group, pixels) in self.groups.iter().zip(shared(band, rgb, &parts)) {
                let name = format!("{}.", group.name);
                add(&mut planes, &name, ["R", "G", "B"], &pixels);
            }
        }
        planes.sort_unstable_by(|a, b| a.0.cmp(&b.0));
        Some(planes.into_iter().map(|p| p.1).collect())
    }
}

/// Each lamp that shines alone, and all other light.
fn groups(lighting: &Lighting) -> Vec<(String, Lighting)> {
    let rest = Lighting {
        lamps: Vec::new(),
        ..lighting.clone()
    };
    let alone = |i: usize| Lighting {
        lamps: vec![lighting.lamps[i].clone()],
        remainder: Vec::new(),
        environment: None,
        ambient: Vec3::ZERO,
        ..lighting.clone()
    };
    (0..lighting.lamps.len())
        .filter(|&i| !lighting.lamps[i].muted)
        .map(|i| (format!("light_{}", i + 1), alone(i)))
        .chain([(REST.to_owned(), rest)])
        .collect()
}

fn add(planes: &mut Vec<Plane>, layer: &str, channels: [&str; 3], pixels: &[[f32; 3]]) {
    for (c, channel) in channels.into_iter().enumerate() {
        let values = pixels.iter().map(|p| p[c]).collect();
        planes.push((format!("{layer}{channel}"), values));
    }
}

/// What the surface is like in a pixel.
struct Surface {
    albedo: [f32; 3],
    irradiance: [f32; 3],
    normal: [f32; 3],
    /// In the world.
    position: [f32; 3],
    depth: f32,
}

fn layers(planes: &mut Vec<Plane>, solution: &Solution, camera: &Camera, band: &Band) {
    let surface: Vec<Surface> = (0..band.coverage.len())
        .into_par_iter()
        .map(|i| surface(solution, camera, band, i))
        .collect();
    let of = |f: fn(&Surface) -> [f32; 3]| surface.iter().map(f).collect::<Vec<_>>();
    let colours: [&[[f32; 3]]; 4] = [
        &band.diffuse,
        &band.specular,
        &of(|s| s.albedo),
        &of(|s| s.irradiance),
    ];
    for (name, pixels) in COLOURS.iter().zip(colours) {
        add(planes, &format!("{name}."), ["R", "G", "B"], pixels);
    }
    let vectors = [of(|s| s.normal), of(|s| s.position)];
    for (name, pixels) in VECTORS.iter().zip(vectors) {
        add(planes, &format!("{name}."), ["X", "Y", "Z"], &pixels);
    }
    let depth = surface.iter().map(|s| s.depth).collect();
    planes.push(("Z".to_owned(), depth));
}

fn surface(solution: &Solution, camera: &Camera, band: &Band, pixel: usize) -> Surface {
    let samples = band.samples.of(pixel);
    let (mut albedo, mut normal, mut position) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    for s in samples {
        let point = ShadingPoint::on(&solution.mesh, s.triangle, s.barycentric);
        albedo += solution
            .atlas
            .sample(&solution.albedo, s.triangle, s.barycentric);
        normal += point.normal;
        position += point.position;
    }
    let count = samples.len().max(1) as f32;
    position /= count;
    albedo /= band.samples.full() as f32;
    let diffuse = Vec3::from(band.diffuse[pixel]);
    let dark = albedo.cmple(Vec3::ZERO);
    let depth = if samples.is_empty() {
        0.0
    } else {
        -camera.to_camera(position.as_dvec3()).z as f32
    };
    Surface {
        albedo: albedo.to_array(),
        irradiance: Vec3::select(dark, Vec3::ZERO, diffuse / albedo).to_array(),
        normal: normal.normalize_or_zero().to_array(),
        position: solution.mesh.in_world(position).as_vec3().to_array(),
        depth,
    }
}

/// Diffuse and specular radiance by one group.
struct Part {
    diffuse: Vec<[f32; 3]>,
    specular: Vec<[f32; 3]>,
}

/// The same rows under other light; `None` where `stop` has said so.
fn part(lit: &LitScene, camera: &Camera, band: &Band, stop: Stop) -> Option<Part> {
    let mut rows = camera.clone();
    rows.height = band.rows.len() as u32;
    rows.centre.y -= band.rows.start as f64;
    let mut part = Part {
        diffuse: Vec::new(),
        specular: Vec::new(),
    };
    let all = lit.bands(&rows, stop, &mut |band| {
        part.diffuse.extend_from_slice(&band.diffuse);
        part.specular.extend_from_slice(&band.specular);
        ControlFlow::Continue(())
    });
    all.is_continue().then_some(part)
}

/// The picture divided among the groups: its diffuse and its specular part each in proportion to theirs.
fn shared(band: &Band, rgb: &[[f32; 3]], parts: &[Part]) -> Vec<Vec<[f32; 3]>> {
    let mut groups = vec![vec![[0.0; 3]; rgb.len()]; parts.len()];
    let mut shares = vec![0.0; parts.len()];
    for (pixel, total) in rgb.iter().enumerate() {
        for channel in 0..3 {
            shares.fill(0.0);
            proportions(&mut shares, band.diffuse[pixel][channel], &|g: usize| {
                parts[g].diffuse[pixel][channel]
            });
            proportions(&mut shares, band.specular[pixel][channel], &|g: usize| {
                parts[g].specular[pixel][channel]
            });
            let split = split(total[channel], &shares);
            for (group, value) in groups.iter_mut().zip(split) {
                group[pixel][channel] = value;
            }
        }
    }
    groups
}

/// Adds `total` to the shares in proportion to `of`; where all of these are dark, to the last.
fn proportions(shares: &mut [f64], total: f32, of: &dyn Fn(usize) -> f32) {
    let sum: f64 = (0..shares.len()).map(|g| f64::from(of(g))).sum();
    let last = shares.len() - 1;
    if sum > 0.0 {
        for (group, share) in shares.iter_mut().enumerate() {
            *share += f64::from(total) * f64::from(of(group)) / sum;
        }
    } else {
        shares[last] += f64::from(total);
    }
}

/// Numbers near the shares whose sum is `total` exactly, in any order of adding.
fn split(total: f32, shares: &[f64]) -> Vec<f32> {
    // Value of the last binary digit of the total: whole multiples of it up to the total are all exact.
    let exponent = ((total.to_bits() >> 23) & 0xff).max(1) as i32;
    let digit = f64::from(exponent - 150).exp2();
    let mut counts: Vec<f64> = shares
        .iter()
        .map(|s| (s / digit).round().max(0.0))
        .collect();
    let missing = f64::from(total) / digit - counts.iter().sum::<f64>();
    let largest = (0..counts.len()).max_by(|&a, &b| counts[a].total_cmp(&counts[b]));
    if let Some(largest) = largest {
        counts[largest] += missing;
    }
    counts.iter().map(|c| (c * digit) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_exactly_in_any_order() {
        for total in [0.1_f32, 1.0, 3.3e-5, 12345.678, 1e-41, 0.0] {
            for i in 0..200 {
                let part = |k: i32| f64::from(total) * (0.5 + 0.5 * f64::from(i * k).sin()) / 3.0;
                let shares = [part(3), part(5), part(7), 0.1 * f64::from(total)];
                let parts = split(total, &shares);
                let forwards: f32 = parts.iter().fold(0.0, |sum, p| sum + p);
                let backwards: f32 = parts.iter().rev().fold(0.0, |sum, p| sum + p);
                assert_eq!([forwards, backwards], [total; 2], "{parts:?}");
                assert!(parts.iter().all(|p| *p >= 0.0), "{parts:?}");
            }
        }
    }
}
