//! What each pixel of a view shows: the front-most triangle at its centre and its depth.
//!
//! The triangles are rasterised in homogeneous coordinates (Olano and Greer 1997): with d the ray through a pixel
//! centre, scaled to unit depth, and c₀ c₁ c₂ the corners in camera space, the edge functions eᵢ = (cⱼ × cₖ) · d are
//! linear in the pixel's coordinates, the barycentric weights are eᵢ / Σ e and the depth det[c₀ c₁ c₂] / Σ e. Nothing is
//! divided by a corner's depth, so triangles that reach behind the camera need no clipping, and two triangles that share
//! an edge compute the same numbers for it and leave no crack. Where the lens distorts, the same is computed at where a
//! pinhole would see what the pixels show; each pixel casts a ray where that can't be said of all the mesh.

use glam::{DAffine3, DMat3, DVec2, DVec3, Vec2, Vec3, Vec4};
use rayon::prelude::*;

use super::bvh::Occluder;
use rekindle_capture::{Camera, Mesh, SurfacePoint};

/// Marks a pixel that shows no triangle.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// Rows that one task rasterises.
const BAND_ROWS: u32 = 32;
/// Triangles that one task prepares.
const BATCH: usize = 1 << 13;
/// Depths below this fraction of the object's size do not exist: the surface would touch the lens.
const NEAR: f64 = 1e-6;
/// Planes that neighbours are compared by and kept for the next: more triangles than meet around a pixel.
const PLANES_KEPT: usize = 64;

/// The surface as one view sees it, row by row from the top.
#[derive(Clone, Debug)]
pub struct ViewSurface {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Front-most triangle at each pixel's centre, from whichever side, or [`NO_TRIANGLE`].
    pub triangle: Vec<u32>,
    /// Its distance along the camera's axis (−z in camera space), in mesh units; +∞ where there is none.
    pub depth: Vec<f32>,
    /// Whether the 3×3 pixels about it show one piece of surface: no silhouette, no jump in depth.
    pub interior: Vec<bool>,
    /// Whether the pixel and those right of it, below it and across show one piece of surface, so that what lies between
    /// their centres is shown too.
    whole: Vec<bool>,
    projection: Projection,
}

/// A triangle ready to be rasterised: the edge functions' coefficients and the bounding box of its pixels.
struct Setup {
    triangle: u32,
    /// Edge function i is `edges[i] · (x, y, 1)` in pixel coordinates, all signs such that inside is positive.
    edges: [DVec3; 3],
    /// |det[c₀ c₁ c₂]|.
    volume: f64,
    columns: (u32, u32),
    rows: (u32, u32),
}

/// Rays of unit depth for pixel coordinates, in camera space, for a pinhole.
fn unit_depth_ray(camera: &Camera, pixel: DVec2) -> DVec3 {
    let u = camera
        .distortion
        .remove((pixel - camera.centre) / camera.focal);
    DVec3::new(u.x, -u.y, -1.0)
}

/// Centre of a pixel in pixel coordinates.
fn pixel_centre(x: u32, y: u32) -> DVec2 {
    DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)
}

/// First and one past the last pixel whose centres lie between two coordinates, within an image of `size` pixels.
fn centres_between(low: f64, high: f64, size: u32) -> (u32, u32) {
    let first = (low - 0.5).ceil().clamp(0.0, f64::from(size)) as u32;
    let last = ((high - 0.5).floor() + 1.0).clamp(0.0, f64::from(size)) as u32;
    (first, last)
}

impl Setup {
    fn new(triangle: u32, corners: [DVec3; 3], camera: &Camera, near: f64) -> Option<Self> {
        let [a, b, c] = corners;
        if corners.iter().all(|p| -p.z <= near) {
            return None;
        }
        let (columns, rows) = if corners.iter().all(|p| -p.z > near) {
            let (low, high) = extent(corners, camera);
            (
                centres_between(low.x, high.x, camera.width),
                centres_between(low.y, high.y, camera.height),
            )
        } else {
            ((0, camera.width), (0, camera.height))
        };
        if columns.0 >= columns.1 || rows.0 >= rows.1 {
            return None;
        }
        let normals = [b.cross(c), c.cross(a), a.cross(b)];
        let volume = a.dot(normals[0]);
        if volume == 0.0 || !volume.is_finite() {
            return None;
        }
        // e = n · d with d = ((x − cx)/fx, −(y − cy)/fy, −1).
        let edges = normals.map(|n| {
            let n = n * volume.signum();
            let along_x = n.x / camera.focal.x;
            let along_y = -n.y / camera.focal.y;
            DVec3::new(
                along_x,
                along_y,
                -n.z - along_x * camera.centre.x - along_y * camera.centre.y,
            )
        });
        Some(Self {
            triangle,
            edges,
            volume: volume.abs(),
            columns,
            rows,
        })
    }

    /// Draws the part of the triangle that falls into rows `first_row..` of a band; `bent` is where a pinhole would see what the
    /// pixels show, if they show something else.
    fn draw(
        &self,
        width: usize,
        first_row: u32,
        near: f64,
        bent: Option<&Bent>,
        triangle: &mut [u32],
        depth: &mut [f32],
    ) {
        let band_rows = (triangle.len() / width) as u32;
        let rows = self.rows.0.max(first_row)..self.rows.1.min(first_row + band_rows);
        for y in rows {
            let start = (y - first_row) as usize * width;
            let row = DVec3::new(0.5, f64::from(y) + 0.5, 1.0);
            let [e0, e1, e2] = self.edges.map(|e| e.dot(row));
            for x in self.columns.0..self.columns.1 {
                let [w0, w1, w2] = if let Some(bent) = bent {
                    let place = bent.at(x, y).extend(1.0);
                    self.edges.map(|e| e.dot(place))
                } else {
                    let step = f64::from(x);
                    [
                        e0 + step * self.edges[0].x,
                        e1 + step * self.edges[1].x,
                        e2 + step * self.edges[2].x,
                    ]
                };
                if w0 < 0.0 || w1 < 0.0 || w2 < 0.0 {
                    continue;
                }
                let z = self.volume / (w0 + w1 + w2);
                if !(z > near && z.is_finite()) {
                    continue;
                }
                let pixel = start + x as usize;
                let z = z as f32;
                // Of two at one depth the lower index wins, whatever the order of drawing.
                if z < depth[pixel] || (z == depth[pixel] && self.triangle < triangle[pixel]) {
                    depth[pixel] = z;
                    triangle[pixel] = self.triangle;
                }
            }
        }
    }
}

/// The least and the largest pixel coordinates at which a triangle before the camera may be seen.
fn extent(corners: [DVec3; 3], camera: &Camera) -> (DVec2, DVec2) {
    let around = |points: &[DVec2]| {
        let low = points.iter().copied().fold(DVec2::INFINITY, DVec2::min);
        let high = points.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        (low, high)
    };
    if camera.distortion.is_none() {
        return around(
            &corners.map(|p| DVec2::new(p.x, -p.y) / -p.z * camera.focal + camera.centre),
        );
    }
    let [a, b, c] = corners;
    let seen = [a, b, c, 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)]
        .map(|p| camera.project_from_camera(p).unwrap_or(camera.centre));
    // Edges are bent, most in their middle, so that they reach no further beyond what is seen of it than it is off the chord.
    let bow = |from: usize, to: usize, middle: usize| {
        let chord = seen[to] - seen[from];
        let off = chord.perp_dot(seen[middle] - seen[from]).abs();
        off / chord.length().max(1e-9)
    };
    let margin = 1.0 + bow(0, 1, 3).max(bow(1, 2, 4)).max(bow(2, 0, 5));
    let (low, high) = around(&seen);
    (low - margin, high + margin)
}

/// Where a pinhole would see what the pixels of a rectangle show through a lens that distorts.
struct Bent {
    first: [u32; 2],
    width: usize,
    places: Vec<DVec2>,
}

impl Bent {
    fn new(camera: &Camera, columns: (u32, u32), rows: (u32, u32)) -> Self {
        let place = |x, y| {
            let distorted = (pixel_centre(x, y) - camera.centre) / camera.focal;
            camera.distortion.remove(distorted) * camera.focal + camera.centre
        };
        Self {
            first: [columns.0, rows.0],
            width: (columns.1 - columns.0) as usize,
            places: (rows.0..rows.1)
                .flat_map(|y| (columns.0..columns.1).map(move |x| place(x, y)))
                .collect(),
        }
    }

    /// That of all pixels of a band that some triangles may cover; `None` without a lens that distorts.
    fn around<'s>(
        camera: &Camera,
        setups: impl Iterator<Item = &'s Setup>,
        rows: (u32, u32),
    ) -> Option<Self> {
        if camera.distortion.is_none() {
            return None;
        }
        let columns = setups.fold((camera.width, 0), |(first, last), setup| {
            (first.min(setup.columns.0), last.max(setup.columns.1))
        });
        (columns.0 < columns.1).then(|| Self::new(camera, columns, rows))
    }

    #[inline]
    fn at(&self, x: u32, y: u32) -> DVec2 {
        self.places[(y - self.first[1]) as usize * self.width + (x - self.first[0]) as usize]
    }
}

/// Whether all of a mesh lies where the model of a camera's distortion applies.
fn is_in_view(mesh: &Mesh, camera: &Camera) -> bool {
    let seen = |p: &Vec3| camera.project(p.as_dvec3()).is_some();
    camera.distortion.is_none() || mesh.positions.par_iter().all(seen)
}

/// Front-most triangle and depth per pixel; through a lens that distorts, of a mesh that [`is_in_view`].
fn rasterise(mesh: &Mesh, camera: &Camera) -> (Vec<u32>, Vec<f32>) {
    let corners: Vec<DVec3> = mesh
        .positions
        .par_iter()
        .map(|p| camera.to_camera(p.as_dvec3()))
        .collect();
    let near = NEAR * f64::from(mesh.diagonal());
    let batches: Vec<Batch> = mesh
        .triangles
        .par_chunks(BATCH)
        .enumerate()
        .map(|(batch, triangles)| {
            let first = batch * BATCH;
            let setups = (first..).zip(triangles).filter_map(|(t, vertices)| {
                let corners = vertices.map(|v| corners[v as usize]);
                Setup::new(t as u32, corners, camera, near)
            });
            Batch::new(setups.collect(), camera.height)
        })
        .collect();
    let width = camera.width as usize;
    let pixels = width * camera.height as usize;
    let mut triangle = vec![NO_TRIANGLE; pixels];
    let mut depth = vec![f32::INFINITY; pixels];
    let band = width * BAND_ROWS as usize;
    if band > 0 {
        let bands = triangle
            .par_chunks_mut(band)
            .zip(depth.par_chunks_mut(band));
        bands.enumerate().for_each(|(index, (triangle, depth))| {
            let first_row = index as u32 * BAND_ROWS;
            let rows = (first_row, first_row + (triangle.len() / width) as u32);
            let setups = || batches.iter().flat_map(|batch| batch.in_band(index));
            let bent = Bent::around(camera, setups(), rows);
            for setup in setups() {
                setup.draw(width, first_row, near, bent.as_ref(), triangle, depth);
            }
        });
    }
    (triangle, depth)
}

/// Triangles that are drawn, with those that each band of rows shows.
struct Batch {
    setups: Vec<Setup>,
    /// Indices of the first band's, then those of the second, and so on.
    listed: Vec<u32>,
    /// Where each band's begin, and at last their number.
    starts: Vec<u32>,
}

impl Batch {
    /// Of triangles in an image of `height` rows.
    fn new(setups: Vec<Setup>, height: u32) -> Self {
        let bands_of = |setup: &Setup| {
            let last = (setup.rows.1 - 1) / BAND_ROWS;
            (setup.rows.0 / BAND_ROWS) as usize..=last as usize
        };
        let mut starts = vec![0; height.div_ceil(BAND_ROWS) as usize + 1];
        for band in setups.iter().flat_map(bands_of) {
            starts[band] += 1;
        }
        let mut total = 0;
        for start in &mut starts {
            total += *start;
            *start = total;
        }
        // From the last to the first, so that each band's start ends up where it is and its list in order.
        let mut listed = vec![0; total as usize];
        for (index, setup) in setups.iter().enumerate().rev() {
            for band in bands_of(setup) {
                starts[band] -= 1;
                listed[starts[band] as usize] = index as u32;
            }
        }
        Self {
            setups,
            listed,
            starts,
        }
    }

    fn in_band(&self, band: usize) -> impl Iterator<Item = &Setup> {
        let listed = &self.listed[self.starts[band] as usize..self.starts[band + 1] as usize];
        listed.iter().map(|&index| &self.setups[index as usize])
    }
}

/// Front-most triangle and depth per pixel of any camera, by one ray each.
fn cast(occluder: &Occluder, camera: &Camera) -> (Vec<u32>, Vec<f32>) {
    let origin = camera.position().as_vec3();
    let forward = camera.forward();
    (0..camera.height)
        .into_par_iter()
        .flat_map_iter(|y| {
            let directions = (0..camera.width).map(|x| camera.ray(pixel_centre(x, y)));
            let rays = directions.map(|direction| (direction, direction.as_vec3()));
            let mut seen = Vec::with_capacity(camera.width as usize);
            occluder.each_hit(origin, rays, |direction, hit| {
                seen.push(hit.map_or((NO_TRIANGLE, f32::INFINITY), |hit| {
                    let depth = f64::from(hit.distance) * direction.dot(forward);
                    (hit.triangle, depth as f32)
                }));
            });
            seen
        })
        .unzip()
}

/// Front-most triangle ([`NO_TRIANGLE`] where there is none) and depth at every pixel's centre.
pub fn front_most(mesh: &Mesh, occluder: &Occluder, camera: &Camera) -> (Vec<u32>, Vec<f32>) {
    if is_in_view(mesh, camera) {
        rasterise(mesh, camera)
    } else {
        cast(occluder, camera)
    }
}

/// Places on triangles that pixels' centres show, one after the other: what the last triangle needed is kept for the next
/// pixel.
pub struct Barycentrics<'a> {
    mesh: &'a Mesh,
    camera: &'a Camera,
    triangle: u32,
    /// The last triangle's weights are in the ratio of these, times the ray of unit depth.
    edges: [DVec3; 3],
}

impl<'a> Barycentrics<'a> {
    /// Nothing has been asked for yet.
    pub fn new(mesh: &'a Mesh, camera: &'a Camera) -> Self {
        Self {
            mesh,
            camera,
            triangle: NO_TRIANGLE,
            edges: [DVec3::ZERO; 3],
        }
    }

    /// Weights of the second and third corner of `triangle` where the ray through a pixel's centre meets its plane.
    pub fn at(&mut self, triangle: u32, x: u32, y: u32) -> Option<Vec2> {
        if triangle != self.triangle {
            let pose = &self.camera.world_from_camera;
            let corners = self.mesh.corners(triangle);
            let [a, b, c] = corners.map(|p| p.as_dvec3() - pose.translation);
            let to_camera = pose.matrix3.transpose();
            self.edges = [b.cross(c), c.cross(a), a.cross(b)].map(|normal| to_camera * normal);
            self.triangle = triangle;
        }
        let ray = unit_depth_ray(self.camera, pixel_centre(x, y));
        let [first, second, third] = self.edges.map(|edge| edge.dot(ray));
        let barycentric = DVec2::new(second, third) / (first + second + third);
        barycentric.is_finite().then(|| barycentric.as_vec2())
    }
}

/// A camera ready to project many points.
#[derive(Clone, Debug)]
struct Projection {
    camera: Camera,
    /// From the world to (x z, y z, z), with x and y in pixel coordinates and z the depth, where no lens distorts.
    straight: Option<DAffine3>,
    /// The shorter focal length in pixels.
    focal: f32,
}

impl Projection {
    fn new(camera: &Camera) -> Self {
        let straight = camera.distortion.is_none().then(|| {
            let (focal, centre) = (camera.focal, camera.centre);
            let to_pixels = DMat3::from_cols(
                DVec3::X * focal.x,
                DVec3::NEG_Y * focal.y,
                DVec3::new(-centre.x, -centre.y, -1.0),
            );
            let matrix = to_pixels * camera.world_from_camera.matrix3.transpose();
            DAffine3::from_mat3_translation(matrix, -(matrix * camera.position()))
        });
        Self {
            camera: camera.clone(),
            straight,
            focal: camera.focal.min_element() as f32,
        }
    }

    /// Pixel coordinates and depth; `None` behind the camera or where the model of the distortion no longer applies.
    fn project(&self, position: Vec3) -> Option<(DVec2, f32)> {
        if let Some(straight) = &self.straight {
            let image = straight.transform_point3(position.as_dvec3());
            return (image.z > 0.0).then(|| (image.truncate() / image.z, image.z as f32));
        }
        let in_camera = self.camera.to_camera(position.as_dvec3());
        let at = self.camera.project_from_camera(in_camera)?;
        Some((at, -in_camera.z as f32))
    }
}

/// A place between four pixels' centres.
pub(super) struct Between {
    /// Upper left, upper right, lower left and lower right.
    pub pixels: [usize; 4],
    /// Their shares in a bilinear look-up.
    pub weights: Vec4,
    /// In pixel coordinates.
    at: DVec2,
}

/// Shares of four neighbours in what lies `fraction` of the way right and down from the first.
fn bilinear(fraction: Vec2) -> Vec4 {
    let (right, below) = (fraction.x, fraction.y);
    let rows = Vec4::new(1.0 - below, 1.0 - below, below, below);
    rows * Vec4::new(1.0 - right, right, 1.0 - right, right)
}

/// Planes of triangles as a camera sees them: one over the depth is g · d for a ray d of unit depth. Those asked for last are
/// kept.
struct Planes<'a> {
    mesh: &'a Mesh,
    camera: &'a Camera,
    to_camera: DMat3,
    kept: [(u32, DVec3); PLANES_KEPT],
}

impl<'a> Planes<'a> {
    fn new(mesh: &'a Mesh, camera: &'a Camera) -> Self {
        Self {
            mesh,
            camera,
            to_camera: camera.world_from_camera.matrix3.transpose(),
            kept: [(NO_TRIANGLE, DVec3::ZERO); PLANES_KEPT],
        }
    }

    /// The g of a triangle's plane.
    fn of(&mut self, triangle: u32) -> DVec3 {
        let kept = &mut self.kept[triangle as usize % PLANES_KEPT];
        if kept.0 != triangle {
            let eye = self.camera.position();
            let corners = self.mesh.corners(triangle);
            let [a, b, c] = corners.map(|p| p.as_dvec3() - eye);
            let normal = (b - a).cross(c - a);
            *kept = (triangle, self.to_camera * (normal / normal.dot(a)));
        }
        kept.1
    }
}

impl ViewSurface {
    /// What `camera` sees of `mesh`; `occluder` is the same mesh's.
    pub fn new(mesh: &Mesh, occluder: &Occluder, camera: &Camera) -> Self {
        let (triangle, depth) = front_most(mesh, occluder, camera);
        let mut surface = Self {
            width: camera.width,
            height: camera.height,
            triangle,
            depth,
            interior: Vec::new(),
            whole: Vec::new(),
            projection: Projection::new(camera),
        };
        surface.find_jumps(mesh, camera);
        surface
    }

    /// Finds where depth jumps, and so what is `whole` and `interior`.
    fn find_jumps(&mut self, mesh: &Mesh, camera: &Camera) {
        let width = self.width as usize;
        let joined: Vec<[bool; 2]> = (0..self.height)
            .into_par_iter()
            .flat_map_iter(|y| self.joined_in_row(mesh, camera, y))
            .collect();
        // Nothing is joined to what would lie beyond the right edge or the lower one.
        let whole = joined
            .par_iter()
            .enumerate()
            .map(|(p, &[right, below])| right && below && joined[p + 1][1] && joined[p + width][0]);
        let whole: Vec<bool> = whole.collect();
        let interior = (0..whole.len()).into_par_iter().map(|p| {
            let inside = p > width && p % width != 0;
            inside && whole[p - width - 1] && whole[p - width] && whole[p - 1] && whole[p]
        });
        self.interior = interior.collect();
        self.whole = whole;
    }

    /// Whether the surface runs on without a jump from each pixel of a row to the one right of it and the one below.
    fn joined_in_row(&self, mesh: &Mesh, camera: &Camera, y: u32) -> Vec<[bool; 2]> {
        let width = self.width as usize;
        let mut planes = Planes::new(mesh, camera);
        // Of this row and the next; of pixels that show nothing none is asked for.
        let rays = [y, (y + 1).min(self.height - 1)].map(|y| self.rays_of_row(camera, y));
        let mut joined = |from: [u32; 2], to: [u32; 2]| {
            let [p, q] = [from, to].map(|[x, y]| y as usize * width + x as usize);
            let (tp, tq) = (self.triangle[p], self.triangle[q]);
            if tp == NO_TRIANGLE || tq == NO_TRIANGLE {
                return false;
            }
            tp == tq || {
                let [to_p, to_q] = [from, to].map(|[x, row]| rays[(row - y) as usize][x as usize]);
                let extended = [1.0 / planes.of(tp).dot(to_q), 1.0 / planes.of(tq).dot(to_p)];
                self.runs_on([p, q], extended, camera)
            }
        };
        let at = |x: u32| {
            let right = x + 1 < self.width && joined([x, y], [x + 1, y]);
            let below = y + 1 < self.height && joined([x, y], [x, y + 1]);
            [right, below]
        };
        (0..self.width).map(at).collect()
    }

    /// The rays of unit depth of a row's pixels; zero where they show nothing.
    fn rays_of_row(&self, camera: &Camera, y: u32) -> Vec<DVec3> {
        let width = self.width as usize;
        let shown = &self.triangle[y as usize * width..][..width];
        let ray = |(x, &triangle): (u32, &u32)| {
            if triangle == NO_TRIANGLE {
                DVec3::ZERO
            } else {
                unit_depth_ray(camera, pixel_centre(x, y))
            }
        };
        (0..).zip(shown).map(ray).collect()
    }

    /// Whether two neighbours of different triangles show one piece of surface: the plane of either, extended to the other,
    /// comes within a pixel's footprint of the depth there, allowing for curvature in proportion to the slope. `extended`
    /// is the first's plane at the second and the second's at the first.
    fn runs_on(&self, pixels: [usize; 2], extended: [f64; 2], camera: &Camera) -> bool {
        let [zp, zq] = pixels.map(|pixel| f64::from(self.depth[pixel]));
        let [zp_at_q, zq_at_p] = extended;
        let gap = (zp_at_q - zq).abs().min((zq_at_p - zp).abs());
        let slope = (zp_at_q - zp).abs().max((zq_at_p - zq).abs());
        let footprint = zp.min(zq) / camera.focal.min_element();
        gap <= footprint + 0.25 * slope.min((zp - zq).abs())
    }

    /// Weights of the second and third corner of the pixel's triangle where the ray through the pixel's centre meets its
    /// plane, `None` where the pixel shows nothing.
    pub fn barycentric(&self, mesh: &Mesh, camera: &Camera, x: u32, y: u32) -> Option<Vec2> {
        let t = self.triangle[y as usize * self.width as usize + x as usize];
        if t == NO_TRIANGLE {
            return None;
        }
        Barycentrics::new(mesh, camera).at(t, x, y)
    }

    /// The surface point that the pixel's centre shows.
    pub fn point(&self, mesh: &Mesh, camera: &Camera, x: u32, y: u32) -> Option<SurfacePoint> {
        let barycentric = self.barycentric(mesh, camera, x, y)?;
        let t = self.triangle[y as usize * self.width as usize + x as usize];
        Some(mesh.point(t, barycentric))
    }

    /// Where the view shows the world point `position`, in pixel coordinates: `None` unless it is the front-most surface
    /// there and the four pixels that a bilinear look-up reads show one piece of surface.
    pub fn sees(&self, position: Vec3) -> Option<DVec2> {
        self.between(position, &self.whole)
            .map(|between| between.at)
    }

    /// The pixels between whose centres the view shows the world point `position`; `None` unless it is the front-most surface
    /// there and the first of them is `readable`.
    pub(super) fn between(&self, position: Vec3, readable: &[bool]) -> Option<Between> {
        let (at, z) = self.projection.project(position)?;
        let corner = at - 0.5;
        let last = DVec2::new(f64::from(self.width) - 1.0, f64::from(self.height) - 1.0);
        if !(corner.cmpge(DVec2::ZERO).all() && corner.cmplt(last).all()) {
            return None;
        }
        let (x, y) = (corner.x as usize, corner.y as usize);
        let width = self.width as usize;
        let first = y * width + x;
        if !readable[first] {
            return None;
        }
        let fraction = (corner - DVec2::new(x as f64, y as f64)).as_vec2();
        let pixels = [first, first + 1, first + width, first + width + 1];
        let between = Between {
            pixels,
            weights: bilinear(fraction),
            at,
        };
        // Inverse depth is linear across a plane's image.
        let depths = Vec4::from_array(pixels.map(|pixel| self.depth[pixel]));
        let seen = 1.0 / between.weights.dot(depths.recip());
        let range = depths.max_element() - depths.min_element();
        let tolerance = z / self.projection.focal + 0.5 * range;
        ((z - seen).abs() <= tolerance).then_some(between)
    }

    /// For each pixel whether it and those right of it, below it and across show one piece of surface and each of them
    /// `is_readable`.
    pub(super) fn readable(&self, is_readable: &(dyn Fn(usize) -> bool + Sync)) -> Vec<bool> {
        let width = self.width as usize;
        let all = |(p, &whole): (usize, &bool)| {
            whole
                && [p, p + 1, p + width, p + width + 1]
                    .into_iter()
                    .all(is_readable)
        };
        self.whole.par_iter().enumerate().map(all).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::fixtures::{bumpy_sphere, camera};
    use rekindle_capture::Distortion;

    fn from_the_front() -> Camera {
        camera(DVec3::new(0.5, 1.0, 4.0), DVec3::ZERO, 320, 240, 1.5)
    }

    #[test]
    fn the_rasteriser_agrees_with_ray_casts() {
        let mesh = bumpy_sphere(100, 0.15);
        let occluder = Occluder::new(&mesh);
        let camera = from_the_front();
        let (triangle, depth) = rasterise(&mesh, &camera);
        let (cast_triangle, cast_depth) = cast(&occluder, &camera);
        let object = cast_triangle.iter().filter(|&&t| t != NO_TRIANGLE).count();
        let same = (0..triangle.len())
            .filter(|&p| triangle[p] == cast_triangle[p])
            .count();
        assert!(object > 20_000, "{object} pixels");
        assert!(
            same as f64 >= 0.9995 * triangle.len() as f64,
            "{same} of {}",
            triangle.len()
        );
        // A ray in single precision slides along a grazing surface.
        let off = |tolerance: f32| {
            (0..triangle.len())
                .filter(|&p| triangle[p] == cast_triangle[p] && triangle[p] != NO_TRIANGLE)
                .filter(|&p| (depth[p] - cast_depth[p]).abs() > tolerance * depth[p])
                .count()
        };
        assert!(off(1e-5) < object / 1000, "{} depths differ", off(1e-5));
        assert_eq!(off(1e-3), 0);
    }

    #[test]
    fn the_rasteriser_sees_through_a_distorting_lens_what_ray_casts_see() {
        let square = |half: f32| {
            [(-half, -half), (half, -half), (half, half), (-half, half)]
                .map(|(x, y)| Vec3::new(x, y, 0.0))
        };
        // Edges across all of the picture bend most.
        let large = Mesh {
            origin: glam::DVec3::ZERO,
            positions: square(1.2).to_vec(),
            normals: vec![Vec3::Z; 4],
            uvs: Vec::new(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        for (mesh, k) in [
            (bumpy_sphere(100, 0.15), -0.3),
            (large.clone(), -0.3),
            (large, 0.4),
        ] {
            let mut camera = camera(DVec3::new(0.2, 0.3, 4.0), DVec3::ZERO, 320, 240, 1.5);
            camera.distortion.k[0] = k;
            camera.distortion.p = [0.001, 0.002];
            assert!(is_in_view(&mesh, &camera));
            let (triangle, depth) = rasterise(&mesh, &camera);
            let (cast_triangle, cast_depth) = cast(&Occluder::new(&mesh), &camera);
            let pixels = || 0..triangle.len();
            let object = pixels()
                .filter(|&p| cast_triangle[p] != NO_TRIANGLE)
                .count();
            let other = pixels()
                .filter(|&p| triangle[p] != cast_triangle[p])
                .count();
            assert!(
                object > 10_000 && other <= object / 1000,
                "{other} of {object}"
            );
            let off = pixels()
                .filter(|&p| triangle[p] == cast_triangle[p] && triangle[p] != NO_TRIANGLE)
                .filter(|&p| (depth[p] - cast_depth[p]).abs() > 1e-3 * depth[p]);
            assert_eq!(off.count(), 0);
        }
    }

    #[test]
    fn a_triangle_that_reaches_behind_the_camera_is_drawn_where_it_is() {
        // A floor under the camera, from far ahead to far behind.
        let mesh = Mesh {
            origin: glam::DVec3::ZERO,
            positions: vec![
                Vec3::new(-100.0, -1.0, 100.0),
                Vec3::new(100.0, -1.0, 100.0),
                Vec3::new(0.0, -1.0, -100.0),
            ],
            normals: vec![Vec3::Y; 3],
            uvs: Vec::new(),
            triangles: vec![[0, 1, 2]],
        };
        let occluder = Occluder::new(&mesh);
        let camera = camera(DVec3::ZERO, DVec3::NEG_Z, 64, 64, 1.0);
        let (triangle, _) = rasterise(&mesh, &camera);
        let (cast_triangle, _) = cast(&occluder, &camera);
        assert_eq!(triangle, cast_triangle);
        assert!(triangle.contains(&0) && triangle.contains(&NO_TRIANGLE));
    }

    #[test]
    fn a_distorting_lens_moves_the_picture() {
        let mesh = bumpy_sphere(60, 0.1);
        let occluder = Occluder::new(&mesh);
        let mut camera = from_the_front();
        camera.distortion = Distortion {
            k: [-0.3, 0.1, 0.0, 0.0],
            p: [0.001, 0.002],
            ..Distortion::default()
        };
        let surface = ViewSurface::new(&mesh, &occluder, &camera);
        let mut seen = 0;
        for y in (0..240).step_by(7) {
            for x in (0..320).step_by(7) {
                if let Some(point) = surface.point(&mesh, &camera, x, y) {
                    let at = camera.project(point.position.as_dvec3()).unwrap();
                    assert!(
                        at.distance(pixel_centre(x, y)) < 1e-2,
                        "pixel {x}, {y} at {at}"
                    );
                    seen += 1;
                }
            }
        }
        assert!(seen > 400, "{seen} pixels");
    }

    #[test]
    fn interior_pixels_see_their_own_points_and_no_silhouettes() {
        let mesh = bumpy_sphere(100, 0.15);
        let occluder = Occluder::new(&mesh);
        let camera = from_the_front();
        let surface = ViewSurface::new(&mesh, &occluder, &camera);
        let (mut object, mut interior) = (0, 0);
        for y in 0..240 {
            for x in 0..320 {
                let p = (y * 320 + x) as usize;
                object += usize::from(surface.triangle[p] != NO_TRIANGLE);
                if !surface.interior[p] {
                    continue;
                }
                interior += 1;
                let point = surface.point(&mesh, &camera, x, y).unwrap();
                let at = surface.sees(point.position);
                assert!(
                    at.is_some_and(|at| at.distance(pixel_centre(x, y)) < 1e-2),
                    "pixel {x}, {y}"
                );
                let behind = camera.position().as_vec3().lerp(point.position, 1.1);
                assert!(surface.sees(behind).is_none(), "behind pixel {x}, {y}");
                let before = camera.position().as_vec3().lerp(point.position, 0.95);
                assert!(surface.sees(before).is_none(), "before pixel {x}, {y}");
                for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1), (1, 1), (-1, -1)] {
                    let q = (y as i32 + dy) * 320 + x as i32 + dx;
                    assert!(
                        surface.triangle[q as usize] != NO_TRIANGLE,
                        "silhouette at {x}, {y}"
                    );
                }
            }
        }
        assert!(interior > object * 9 / 10, "{interior} of {object}");
    }

    #[test]
    fn a_jump_in_depth_is_not_interior() {
        // A small square half a unit before a large one.
        let square = |half: f32, z: f32| {
            [(-half, -half), (half, -half), (half, half), (-half, half)]
                .map(|(x, y)| Vec3::new(x, y, z))
        };
        let mesh = Mesh {
            origin: glam::DVec3::ZERO,
            positions: [square(2.0, 0.0), square(0.5, 0.5)].concat(),
            normals: vec![Vec3::Z; 8],
            uvs: Vec::new(),
            triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        };
        let occluder = Occluder::new(&mesh);
        let camera = camera(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, 100, 100, 1.0);
        let surface = ViewSurface::new(&mesh, &occluder, &camera);
        for y in 1..99_usize {
            for x in 1..99_usize {
                let fronts = [-1_i32, 0, 1]
                    .iter()
                    .flat_map(|dy| [-1_i32, 0, 1].map(|dx| (dx, *dy)))
                    .filter(|(dx, dy)| {
                        let q = (y as i32 + dy) * 100 + x as i32 + dx;
                        surface.triangle[q as usize] >= 2
                    })
                    .count();
                let all_object = (y - 1..=y + 1)
                    .all(|y| (x - 1..=x + 1).all(|x| surface.triangle[y * 100 + x] != NO_TRIANGLE));
                if all_object {
                    assert_eq!(
                        surface.interior[y * 100 + x],
                        fronts == 0 || fronts == 9,
                        "{x}, {y}"
                    );
                }
            }
        }
        assert!(surface.sees(Vec3::new(1.5, 0.0, 0.0)).is_some());
        assert!(surface.sees(Vec3::ZERO).is_none());
    }
}
