//! Specular images, the partial hemisphere of each view and the initial hemisphere (2.2).
//!
//! What a photograph shows beyond the rendered diffuse texture is specular reflection, plus interreflection, plus noise.
//! Each pixel's remainder goes to the node nearest to where the mirror ray of the view about the shading normal meets the
//! hemisphere. A light stands still on the hemisphere from view to view; an interreflection moves: a node is kept where
//! enough views show something, at the least that any of them shows. The values are reflected radiance, still blurred
//! by the lobe and not yet divided by its integral: they say where light may be, and roughly how much.

use glam::{DAffine3, Vec3};
use rayon::prelude::*;

use super::grid::HemisphereGrid;
use crate::surface::{
    Atlas, Barycentrics, GRAZING, MinimumTexture, NO_TRIANGLE, ViewSurface, is_object,
};
use rekindle_capture::{Mesh, View};

/// Rounds in which a node without a value takes the mean of its neighbours': where the surface is strongly curved, mirror
/// rays of adjacent pixels lie several nodes apart, and what lies between them was seen too.
const CLOSING_ROUNDS: usize = 2;
/// Neighbours with a value that a node needs to be closed: more than half around it, so that the border does not grow.
const CLOSING_NEIGHBOURS: usize = 4;

/// Pixels of a view that are enough, some ten for each node of a hemisphere: of photographs of `n` times as many, every `n`-th is
/// looked at, …
const ENOUGH_PIXELS: usize = 1 << 18;
/// … from one row to the next shifted by this part of `n`, so that they are spread evenly.
const SHIFT: f32 = 0.618;

/// A photograph less the rendered diffuse texture.
#[derive(Clone, Debug)]
pub struct SpecularImage {
    /// Row by row from the top, without pixels that are not used: off the object, at a silhouette or a jump in depth, seen at a
    /// grazing angle, not data, or of unknown diffuse colour.
    pub pixels: Vec<SpecularPixel>,
}

/// A pixel of a specular image.
#[derive(Clone, Copy, Debug)]
pub struct SpecularPixel {
    /// What the photograph shows beyond the diffuse texture, RGB, at least zero.
    pub radiance: Vec3,
    /// Unit shading normal at the pixel's centre.
    pub normal: Vec3,
    /// Surface position there.
    pub position: Vec3,
}

/// What one view says of the light from each node.
#[derive(Clone, Debug)]
pub struct PartialHemisphere {
    /// Mean of the specular radiance that was sent to each node, RGB: the mean, because the greatest of several pixels grows
    /// with their noise. Zero where none was.
    pub radiance: Vec<[f32; 3]>,
    /// Whether each node has a value.
    pub has_value: Vec<bool>,
}

/// What the views agree on.
#[derive(Clone, Debug)]
pub struct InitialHemisphere {
    /// Least specular radiance among the views with a value, per channel, one per node; zero where too few have one.
    pub radiance: Vec<[f32; 3]>,
    /// Number of partial hemispheres that have a value, one per node.
    pub votes: Vec<u32>,
}

impl SpecularImage {
    /// The specular part of `view` over the diffuse `texture`.
    pub fn new(
        mesh: &Mesh,
        atlas: &Atlas,
        texture: &MinimumTexture,
        view: &View,
        surface: &ViewSurface,
    ) -> Self {
        let width = surface.width as usize;
        let camera = &view.camera;
        let eye = camera.position().as_vec3();
        let step = (surface.triangle.len() / ENOUGH_PIXELS).max(1);
        let shift = (SHIFT * step as f32) as usize;
        let of_row = |y: usize| {
            let row = y * width;
            let mut barycentrics = Barycentrics::new(mesh, camera);
            let looked_at = (row + y * shift % step..row + width).step_by(step);
            looked_at.filter_map(move |pixel| {
                let triangle = surface.triangle[pixel];
                let usable = triangle != NO_TRIANGLE
                    && surface.interior[pixel]
                    && is_object(&view.photograph, pixel);
                if !usable {
                    return None;
                }
                let x = (pixel - row) as u32;
                let barycentric = barycentrics.at(triangle, x, y as u32)?;
                let point = mesh.point(triangle, barycentric);
                let to_camera = (eye - point.position).normalize_or_zero();
                if point.normal.dot(to_camera) < GRAZING {
                    return None;
                }
                let diffuse = texture.at(atlas, triangle, barycentric)?;
                let measured = Vec3::from(view.photograph.radiance[pixel]);
                Some(SpecularPixel {
                    radiance: (measured - Vec3::from(diffuse)).max(Vec3::ZERO),
                    normal: point.normal,
                    position: point.position,
                })
            })
        };
        let rows = (0..surface.height as usize).into_par_iter();
        let pixels = rows.flat_map_iter(of_row);
        Self {
            pixels: pixels.collect(),
        }
    }

    /// The same after a rigid motion of the surface.
    #[must_use]
    pub fn moved(self, motion: &DAffine3) -> Self {
        let pixel = |pixel: SpecularPixel| SpecularPixel {
            normal: motion.transform_vector3(pixel.normal.as_dvec3()).as_vec3(),
            position: motion.transform_point3(pixel.position.as_dvec3()).as_vec3(),
            ..pixel
        };
        Self {
            pixels: self.pixels.into_par_iter().map(pixel).collect(),
        }
    }

    /// The specular radiance mapped to the hemisphere.
    pub fn partial_hemisphere(&self, grid: &HemisphereGrid, eye: Vec3) -> PartialHemisphere {
        let nodes: Vec<Option<u32>> = self
            .pixels
            .par_iter()
            .map(|pixel| {
                let (n, x) = (pixel.normal, pixel.position);
                let v = (eye - x).normalize_or_zero();
                let mirrored = 2.0 * n.dot(v) * n - v;
                grid.nearest_along(x, mirrored).map(|node| node as u32)
            })
            .collect();
        let mut sum = vec![Vec3::ZERO; grid.directions.len()];
        let mut count = vec![0_u32; grid.directions.len()];
        for (node, pixel) in nodes.iter().zip(&self.pixels) {
            if let Some(node) = *node {
                sum[node as usize] += pixel.radiance;
                count[node as usize] += 1;
            }
        }
        let mut values: Vec<Option<Vec3>> = sum
            .into_iter()
            .zip(count)
            .map(|(sum, count)| (count > 0).then(|| sum / count as f32))
            .collect();
        for _ in 0..CLOSING_ROUNDS {
            values = close(grid, &values);
        }
        PartialHemisphere {
            has_value: values.iter().map(Option::is_some).collect(),
            radiance: values
                .into_iter()
                .map(|v| v.unwrap_or(Vec3::ZERO).to_array())
                .collect(),
        }
    }
}

/// Gives nodes without a value the mean of their neighbours'.
fn close(grid: &HemisphereGrid, values: &[Option<Vec3>]) -> Vec<Option<Vec3>> {
    (0..values.len())
        .into_par_iter()
        .map(|node| {
            if values[node].is_some() {
                return values[node];
            }
            let known = || grid.neighbours(node).filter_map(|k| values[k]);
            let count = known().count();
            (count >= CLOSING_NEIGHBOURS).then(|| known().sum::<Vec3>() / count as f32)
        })
        .collect()
}

impl InitialHemisphere {
    /// Nodes for which all but `missing` of the partial hemispheres have a value keep the least of these values (2.2).
    /// `missing` is 0, or more where some lights do not reach every view.
    pub fn new(partials: &[PartialHemisphere], missing: usize) -> Self {
        let nodes = partials.first().map_or(0, |p| p.radiance.len());
        let needed = partials.len().saturating_sub(missing).max(1);
        let (radiance, votes) = (0..nodes)
            .into_par_iter()
            .map(|node| {
                let with_value = || partials.iter().filter(|p| p.has_value[node]);
                let votes = with_value().count();
                let least = if votes >= needed {
                    with_value().fold(Vec3::INFINITY, |least, p| {
                        least.min(p.radiance[node].into())
                    })
                } else {
                    Vec3::ZERO
                };
                (least.to_array(), votes as u32)
            })
            .unzip();
        Self { radiance, votes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::fixtures::{bumpy_sphere, camera};
    use crate::surface::{Occluder, minimum_texture, wanted_density};
    use glam::DVec3;
    use rekindle_capture::Photograph;
    use std::sync::Arc;

    /// A smooth albedo lit from one direction, plus a narrow highlight where the mirror ray meets the light.
    fn radiance(position: Vec3, normal: Vec3, eye: Vec3, light: Vec3) -> (Vec3, Vec3) {
        let albedo = Vec3::new(0.6, 0.5, 0.4) + 0.2 * (3.0 * position).map(f32::sin);
        let v = (eye - position).normalize_or_zero();
        let mirrored = 2.0 * normal.dot(v) * normal - v;
        let highlight = 5.0 * (-(mirrored.angle_between(light) / 0.1).powi(2)).exp();
        (
            albedo * (0.2 + normal.dot(light).max(0.0)),
            Vec3::splat(highlight),
        )
    }

    #[test]
    fn the_split_finds_diffuse_colours_and_the_light() {
        let mut mesh = bumpy_sphere(60, 0.05);
        mesh.uvs.clear();
        let occluder = Occluder::new(&mesh);
        let light = Vec3::new(0.3, 0.8, 0.5).normalize_or_zero();
        let mut views = Vec::new();
        let mut surfaces = Vec::new();
        for k in 0..6 {
            let turn = f64::from(k) * std::f64::consts::TAU / 6.0;
            let position = DVec3::new(4.0 * turn.sin(), 2.0, 4.0 * turn.cos());
            let camera = camera(position, DVec3::ZERO, 200, 200, 1.6);
            let surface = ViewSurface::new(&mesh, &occluder, &camera);
            let seen: Vec<Option<[f32; 3]>> = (0..200 * 200)
                .map(|p| {
                    let point = surface.point(&mesh, &camera, p % 200, p / 200)?;
                    let (d, s) = radiance(point.position, point.normal, position.as_vec3(), light);
                    Some((d + s).to_array())
                })
                .collect();
            views.push(View {
                name: format!("view {k}"),
                camera,
                photograph: Arc::new(Photograph {
                    width: 200,
                    height: 200,
                    radiance: seen.iter().map(|p| p.unwrap_or([0.0; 3])).collect(),
                    coverage: Some(
                        seen.iter()
                            .map(|p| f32::from(u8::from(p.is_some())))
                            .collect(),
                    ),
                    usable: vec![true; 200 * 200],
                    clipped: None,
                    crop: None,
                }),
            });
            surfaces.push(surface);
        }
        let density = wanted_density(&mesh, &views, &surfaces, 1.5);
        let atlas = Atlas::new(&mesh, &density);
        let texture = minimum_texture(&mesh, &atlas, &views, &surfaces);
        let (mut within, mut seen_often) = (0, 0);
        for texel in atlas.texels.iter().filter(|t| !t.gutter) {
            let index = texel.index as usize;
            if texture.confidence[index] > 1.5 {
                let point = mesh.point(texel.triangle, texel.barycentric);
                let (d, _) = radiance(point.position, point.normal, Vec3::ZERO, light);
                let error = (Vec3::from(texture.radiance[index]) - d).length() / d.length();
                seen_often += 1;
                within += usize::from(error < 0.03);
            }
        }
        assert!(seen_often > 10_000, "{seen_often} texels");
        assert!(within * 100 > seen_often * 97, "{within} of {seen_often}");

        let grid = HemisphereGrid::new(30, Vec3::Y, None, Vec3::ZERO);
        let partials: Vec<PartialHemisphere> = views
            .iter()
            .zip(&surfaces)
            .map(|(view, surface)| {
                SpecularImage::new(&mesh, &atlas, &texture, view, surface)
                    .partial_hemisphere(&grid, view.camera.position().as_vec3())
            })
            .collect();
        let initial = InitialHemisphere::new(&partials, 2);
        let brightest = (0..initial.radiance.len())
            .max_by(|&a, &b| initial.radiance[a][0].total_cmp(&initial.radiance[b][0]))
            .unwrap();
        let off = grid.directions[brightest].angle_between(light).to_degrees();
        assert!(off < 6.0, "brightest node {off}° from the light");
        assert!(
            initial.radiance[brightest][0] > 1.0,
            "{:?}",
            initial.radiance[brightest]
        );
    }

    #[test]
    fn the_vote_keeps_what_enough_views_agree_on() {
        let partial = |values: [Option<f32>; 3]| PartialHemisphere {
            radiance: values.map(|v| [v.unwrap_or(0.0); 3]).to_vec(),
            has_value: values.map(|v| v.is_some()).to_vec(),
        };
        let partials = [
            partial([Some(3.0), Some(5.0), None]),
            partial([Some(2.0), None, None]),
            partial([Some(4.0), Some(6.0), Some(9.0)]),
        ];
        let all = InitialHemisphere::new(&partials, 0);
        assert_eq!(all.votes, [3, 2, 1]);
        assert_eq!(all.radiance, [[2.0; 3], [0.0; 3], [0.0; 3]]);
        let but_one = InitialHemisphere::new(&partials, 1);
        assert_eq!(but_one.radiance, [[2.0; 3], [5.0; 3], [0.0; 3]]);
        assert!(InitialHemisphere::new(&[], 2).radiance.is_empty());
    }
}
