//! What pixels show of a texture: sub-samples that read it bilinearly, gathered and scattered as vector code.
//!
//! Sub-samples of one pixel mostly read texels beside each other. Their weights are added up in a window of a few texels
//! first, as every texel that is read or written more than once has to wait for the time before.

use std::ops::Range;

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;
use smallvec::SmallVec;

/// Texels along the sides of a window.
const SIDE: usize = 4;
/// Steps in which sub-samples are placed on a texel.
const STEPS: f32 = 65536.0;
/// Texels of a band: what is summed up for them fits a cache while the pixels of all views pass by.
const BAND: usize = 1 << 15;
/// Pixels whose residuals are computed together.
const RUN: usize = 1024;

/// Four numbers of each texel in a row of a window, or a number of each texel of a window.
type Lanes = [f32; SIDE * SIDE];

/// A view prepared for reconstruction: only the pixels that the surface covers, band by band of the texture, and in a band tile
/// by tile of the view, so that those one after the other read texels beside each other.
pub(super) struct Footprints {
    /// Index of each pixel in the photograph.
    pub(super) pixels: Vec<u32>,
    /// Taps of pixel `i` are `taps[starts[i]..starts[i + 1]]`.
    starts: Vec<u32>,
    /// Where sub-samples read the texture.
    taps: Vec<Tap>,
    /// Factor of every tap: transmittance towards the viewer / sub-samples of a whole pixel.
    scale: Vec<f32>,
    /// What was measured, minus the specular part and over the irradiance.
    pub(super) target: Vec<Vec3>,
    /// Irradiance; none where it is the same in all views and part of the texture.
    irradiance: Vec<Vec3>,
    /// Confidence in the target, 0 to 1; 0 where other views serve that part of the surface.
    pub(super) weight: Vec<f32>,
    /// Pixels that show the surface but serve for nothing.
    pub(super) left_out: usize,
    /// Pixels of band `b` are those from `bands[b]` to `bands[b + 1]`; none before they have been sorted.
    bands: Vec<usize>,
}

/// A bilinear look-up: its place among texel centres, in 1/65536 of a texel.
#[derive(Clone, Copy)]
pub(super) struct Tap {
    x: u32,
    y: u32,
}

/// A pixel of a photograph.
pub(super) struct Pixel {
    /// Its index in the photograph.
    pub(super) index: usize,
    /// See [`Footprints`].
    pub(super) scale: f32,
    /// See [`Footprints`].
    pub(super) target: Vec3,
    /// See [`Footprints`].
    pub(super) irradiance: Option<Vec3>,
    /// See [`Footprints`].
    pub(super) weight: f32,
}

/// Four numbers for each texel of a texture, with a margin that windows may reach into.
#[derive(Clone)]
pub(super) struct Canvas {
    size: [usize; 2],
    values: Vec<[f32; 4]>,
}

/// Weights of the texels of a window.
struct Window {
    /// Its first texel on a canvas.
    first: usize,
    /// Rows that may have weight.
    rows: usize,
    /// Row by row.
    weights: Lanes,
}

impl Tap {
    /// The look-up at a texture coordinate in texels, held within the centres of a texture of some size.
    pub(super) fn new(at: Vec2, size: [usize; 2]) -> Self {
        let last = Vec2::new(size[0] as f32 - 1.0, size[1] as f32 - 1.0).max(Vec2::ZERO);
        let place = ((at - 0.5).clamp(Vec2::ZERO, last) * STEPS).as_uvec2();
        Self {
            x: place.x,
            y: place.y,
        }
    }

    /// The first of the texels that it reads.
    #[inline(always)]
    fn texel(self) -> [u32; 2] {
        [self.x >> 16, self.y >> 16]
    }
}

impl Window {
    /// The sums of the weights of the first taps, as many as one window holds, and how many they are.
    #[inline(always)]
    fn of_first(taps: &[Tap], stride: usize) -> (Self, usize) {
        const REACH: u32 = SIDE as u32 - 2;
        let (mut least, mut most) = (taps[0].texel(), taps[0].texel());
        let mut count = 1;
        for tap in &taps[1..] {
            let [x, y] = tap.texel();
            let (low, high) = (
                [least[0].min(x), least[1].min(y)],
                [most[0].max(x), most[1].max(y)],
            );
            if high[0] - low[0] > REACH || high[1] - low[1] > REACH {
                break;
            }
            (least, most) = (low, high);
            count += 1;
        }
        let mut weights: Lanes = [0.0; SIDE * SIDE];
        for tap in &taps[..count] {
            let x = (tap.x - (least[0] << 16)) as f32 / STEPS;
            let y = (tap.y - (least[1] << 16)) as f32 / STEPS;
            for (k, weight) in weights.iter_mut().enumerate() {
                let across = (1.0 - (x - (k % SIDE) as f32).abs()).max(0.0);
                let down = (1.0 - (y - (k / SIDE) as f32).abs()).max(0.0);
                *weight += across * down;
            }
        }
        let window = Self {
            first: least[1] as usize * stride + least[0] as usize,
            rows: (most[1] - least[1]) as usize + 2,
            weights,
        };
        (window, count)
    }

    /// The weights of a row's texels, each four times.
    #[inline(always)]
    fn row(&self, row: usize) -> Lanes {
        std::array::from_fn(|k| self.weights[row * SIDE + k / 4])
    }
}

impl Canvas {
    /// One of zeros.
    pub(super) fn new(size: [usize; 2]) -> Self {
        let stride = size[0] + SIDE - 1;
        Self {
            size,
            values: vec![[0.0; 4]; stride * (size[1] + SIDE - 1)],
        }
    }

    /// The numbers of all texels, with those in the margin.
    pub(super) fn values(&self) -> &[[f32; 4]] {
        &self.values
    }

    /// The same, to be changed.
    pub(super) fn values_mut(&mut self) -> &mut [[f32; 4]] {
        &mut self.values
    }

    /// The numbers of the texture's texels, row by row.
    pub(super) fn texels(&self) -> impl IndexedParallelIterator<Item = [f32; 4]> + '_ {
        let [width, height] = self.size;
        let stride = self.stride();
        let texel = move |t: usize| self.values[t / width * stride + t % width];
        (0..width * height).into_par_iter().map(texel)
    }

    fn stride(&self) -> usize {
        self.size[0] + SIDE - 1
    }

    /// A row of a window.
    #[inline(always)]
    fn row(&self, first: usize) -> &[[f32; 4]; SIDE] {
        let row = self.values[first..].first_chunk();
        row.expect("windows lie within margins")
    }
}

impl Footprints {
    /// Without pixels yet, with room for some of so many taps.
    pub(super) fn with_room(taps: usize) -> Self {
        let mut starts = Vec::with_capacity(taps + 1);
        starts.push(0);
        Self {
            pixels: Vec::with_capacity(taps),
            starts,
            taps: Vec::with_capacity(taps),
            scale: Vec::with_capacity(taps),
            target: Vec::with_capacity(taps),
            irradiance: Vec::new(),
            weight: Vec::with_capacity(taps),
            left_out: 0,
            bands: Vec::new(),
        }
    }

    /// Adds a pixel.
    pub(super) fn push(&mut self, pixel: &Pixel, taps: impl Iterator<Item = Tap>) {
        self.pixels.push(pixel.index as u32);
        self.taps.extend(taps);
        self.starts.push(self.taps.len() as u32);
        self.scale.push(pixel.scale);
        self.target.push(pixel.target);
        self.irradiance.extend(pixel.irradiance);
        self.weight.push(pixel.weight);
    }

    /// Adds the pixels of others after its own.
    pub(super) fn append(&mut self, parts: Vec<Self>) {
        let pixels = parts.iter().map(|p| p.pixels.len()).sum();
        self.taps.reserve(parts.iter().map(|p| p.taps.len()).sum());
        self.pixels.reserve(pixels);
        self.starts.reserve(pixels);
        self.scale.reserve(pixels);
        self.target.reserve(pixels);
        self.weight.reserve(pixels);
        for part in parts {
            let base = self.taps.len() as u32;
            self.starts
                .extend(part.starts[1..].iter().map(|s| base + s));
            self.pixels.extend(part.pixels);
            self.taps.extend(part.taps);
            self.scale.extend(part.scale);
            self.target.extend(part.target);
            self.irradiance.extend(part.irradiance);
            self.weight.extend(part.weight);
        }
    }

    fn taps_of(&self, i: usize) -> &[Tap] {
        &self.taps[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// What turns a pixel's target and residual to radiance.
    pub(super) fn irradiance(&self, i: usize) -> Vec3 {
        self.irradiance.get(i).copied().unwrap_or(Vec3::ONE)
    }

    /// How much of a pixel its taps make up, transmittance inside.
    pub(super) fn covered(&self, i: usize) -> f32 {
        (self.scale[i] * self.taps_of(i).len() as f32).max(1e-6)
    }

    /// Sorts the pixels by the bands of a texture that their first taps lie in.
    pub(super) fn sorted(&self, texture: &Canvas) -> Self {
        let band = |i: usize| self.taps_of(i)[0].texel()[1] as usize / texture.rows_of_band();
        let mut starts = vec![0; texture.bands() + 1];
        for i in 0..self.pixels.len() {
            starts[band(i) + 1] += 1;
        }
        for b in 0..texture.bands() {
            starts[b + 1] += starts[b];
        }
        let mut next = starts.clone();
        let mut order = vec![0; self.pixels.len()];
        for i in 0..self.pixels.len() {
            let place = &mut next[band(i)];
            order[*place] = i as u32;
            *place += 1;
        }
        self.in_order(&order, starts)
    }

    fn in_order(&self, order: &[u32], bands: Vec<usize>) -> Self {
        fn picked<T: Copy + Send + Sync>(values: &[T], order: &[u32]) -> Vec<T> {
            order.par_iter().map(|&i| values[i as usize]).collect()
        }
        let mut starts = Vec::with_capacity(order.len() + 1);
        let mut taps = Vec::with_capacity(self.taps.len());
        starts.push(0);
        for &i in order {
            taps.extend_from_slice(self.taps_of(i as usize));
            starts.push(taps.len() as u32);
        }
        Self {
            pixels: picked(&self.pixels, order),
            starts,
            taps,
            scale: picked(&self.scale, order),
            target: picked(&self.target, order),
            irradiance: if self.irradiance.is_empty() {
                Vec::new()
            } else {
                picked(&self.irradiance, order)
            },
            weight: picked(&self.weight, order),
            left_out: self.left_out,
            bands,
        }
    }

    /// What a pixel shows of a texture whose rows are so far apart.
    #[inline(always)]
    fn windows(&self, i: usize, stride: usize) -> SmallVec<[Window; 4]> {
        let mut windows = SmallVec::new();
        let mut taps = self.taps_of(i);
        while !taps.is_empty() {
            let (window, count) = Window::of_first(taps, stride);
            windows.push(window);
            taps = &taps[count..];
        }
        windows
    }

    /// What a texture leaves of a pixel's diffuse radiance.
    #[inline(always)]
    pub(super) fn residual(&self, i: usize, texture: &Canvas) -> Vec3 {
        if self.has_single_taps() {
            return self.residual_at(i, self.pair_of_rows(i, texture.stride()), texture);
        }
        self.residual_in(i, &self.windows(i, texture.stride()), texture)
    }

    /// Texels that the only tap of a pixel reads, by the first of each row, with their shares.
    #[inline(always)]
    fn pair_of_rows(&self, i: usize, stride: usize) -> (usize, [[f32; 2]; 2]) {
        let tap = self.taps[i];
        let [x, y] = [tap.x & 0xffff, tap.y & 0xffff].map(|part| part as f32 / STEPS);
        let [column, row] = tap.texel();
        let shares = [1.0 - y, y].map(|down| [(1.0 - x) * down, x * down]);
        (row as usize * stride + column as usize, shares)
    }

    /// Whether each pixel has just one tap.
    fn has_single_taps(&self) -> bool {
        self.taps.len() == self.pixels.len()
    }

    /// [`Footprints::residual`] where pixels have one tap.
    #[inline(always)]
    fn residual_at(
        &self,
        i: usize,
        (first, shares): (usize, [[f32; 2]; 2]),
        texture: &Canvas,
    ) -> Vec3 {
        let mut sum = Vec4::ZERO;
        for (row, [left, right]) in shares.into_iter().enumerate() {
            let texels = &texture.values[first + row * texture.stride()..][..2];
            sum += left * Vec4::from(texels[0]) + right * Vec4::from(texels[1]);
        }
        self.target[i] - sum.truncate() * self.scale[i]
    }

    #[inline(always)]
    fn residual_in(&self, i: usize, windows: &[Window], texture: &Canvas) -> Vec3 {
        let stride = texture.stride();
        let mut sum = Vec4::ZERO;
        for window in windows {
            for (row, shares) in window.weights.as_chunks::<SIDE>().0[..window.rows]
                .iter()
                .enumerate()
            {
                let texels = texture.row(window.first + row * stride);
                for (&share, &texel) in shares.iter().zip(texels) {
                    sum += share * Vec4::from(texel);
                }
            }
        }
        self.target[i] - sum.truncate() * self.scale[i]
    }

    /// [`Footprints::residual`] of all pixels.
    pub(super) fn residuals(&self, texture: &Canvas) -> Vec<Vec3> {
        let mut residuals = vec![Vec3::ZERO; self.pixels.len()];
        let runs = residuals.par_chunks_mut(RUN).enumerate();
        runs.for_each(|(run, residuals)| {
            pulp::Arch::new().dispatch(
                #[inline(always)]
                || {
                    for (k, residual) in residuals.iter_mut().enumerate() {
                        *residual = self.residual(run * RUN + k, texture);
                    }
                },
            );
        });
        residuals
    }
}

/// What a pixel adds to texels outside its band.
struct Spill {
    window: Window,
    weighted: Vec4,
}

/// Some rows of a canvas.
struct Band<'a> {
    /// The canvas's index of its first value.
    first: usize,
    stride: usize,
    values: &'a mut [[f32; 4]],
}

impl Band<'_> {
    /// Adds a value to the texels of a window; `false` where the window is not all within the band.
    #[inline(always)]
    fn add(&mut self, window: &Window, weighted: Vec4) -> bool {
        let weighted: Lanes = std::array::from_fn(|k| weighted.to_array()[k % 4]);
        let Some(first) = window.first.checked_sub(self.first) else {
            return false;
        };
        if first + (window.rows - 1) * self.stride + SIDE > self.values.len() {
            return false;
        }
        for row in 0..window.rows {
            let texels = &mut self.values[first + row * self.stride..][..SIDE];
            let sums = texels.as_flattened_mut().iter_mut();
            for ((sum, share), value) in sums.zip(window.row(row)).zip(weighted) {
                *sum += share * value;
            }
        }
        true
    }

    /// Adds a value to the texels that a single tap reads; `false` where they are not all within the band.
    #[inline(always)]
    fn add_pair_of_rows(
        &mut self,
        (first, shares): (usize, [[f32; 2]; 2]),
        weighted: Vec4,
    ) -> bool {
        let Some(first) = first.checked_sub(self.first) else {
            return false;
        };
        if first + self.stride + 2 > self.values.len() {
            return false;
        }
        for (row, shares) in shares.into_iter().enumerate() {
            let texels = &mut self.values[first + row * self.stride..][..2];
            for (texel, share) in texels.iter_mut().zip(shares) {
                *texel = (Vec4::from(*texel) + share * weighted).into();
            }
        }
        true
    }

    /// [`Band::scatter`] of a view whose pixels have one tap each.
    #[inline(always)]
    fn scatter_single(
        &mut self,
        view: &Footprints,
        pixels: Range<usize>,
        texture: Option<&Canvas>,
        spills: &mut Vec<Spill>,
    ) {
        for i in pixels.filter(|&i| view.weight[i] > 0.0) {
            let rows = view.pair_of_rows(i, self.stride);
            let left = match texture {
                Some(texture) => view.residual_at(i, rows, texture),
                None => view.target[i],
            };
            let value = (left / view.covered(i)).extend(1.0);
            let weighted = value * (view.weight[i] * view.scale[i]);
            if !self.add_pair_of_rows(rows, weighted) {
                let (window, _) = Window::of_first(&view.taps[i..=i], self.stride);
                spills.push(Spill { window, weighted });
            }
        }
    }

    /// Adds what the pixels of a view that lie in the band show, or what a texture leaves of it, and returns what falls outside.
    #[inline(always)]
    fn scatter(
        &mut self,
        view: &Footprints,
        pixels: Range<usize>,
        texture: Option<&Canvas>,
        spills: &mut Vec<Spill>,
    ) {
        for i in pixels.filter(|&i| view.weight[i] > 0.0) {
            let windows = view.windows(i, self.stride);
            let left = match texture {
                Some(texture) => view.residual_in(i, &windows, texture),
                None => view.target[i],
            };
            let value = (left / view.covered(i)).extend(1.0);
            let weighted = value * (view.weight[i] * view.scale[i]);
            for window in windows {
                if !self.add(&window, weighted) {
                    spills.push(Spill { window, weighted });
                }
            }
        }
    }
}

impl Canvas {
    fn rows_of_band(&self) -> usize {
        (BAND / self.stride()).max(SIDE)
    }

    fn bands(&self) -> usize {
        (self.size[1] + SIDE - 1).div_ceil(self.rows_of_band())
    }

    /// Sets every texel to the sums, over the pixels of all views that show it, of weight × value (xyz) and weight (w). A
    /// pixel's value is the mean that it shows, or what `texture` leaves of that.
    pub(super) fn gather(&mut self, views: &[Footprints], texture: Option<&Self>) {
        let stride = self.stride();
        let length = self.rows_of_band() * stride;
        let bands = self.values.par_chunks_mut(length).enumerate();
        let spills: Vec<Vec<Spill>> = bands
            .map(|(number, values)| {
                values.fill([0.0; 4]);
                let first = number * length;
                let mut band = Band {
                    first,
                    stride,
                    values,
                };
                let mut spills = Vec::new();
                for view in views {
                    let pixels = view.bands[number]..view.bands[number + 1];
                    pulp::Arch::new().dispatch(
                        #[inline(always)]
                        || {
                            if view.has_single_taps() {
                                band.scatter_single(view, pixels, texture, &mut spills);
                            } else {
                                band.scatter(view, pixels, texture, &mut spills);
                            }
                        },
                    );
                }
                spills
            })
            .collect();
        let mut whole = Band {
            first: 0,
            stride,
            values: &mut self.values,
        };
        for Spill { window, weighted } in spills.into_iter().flatten() {
            whole.add(&window, weighted);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rekindle_base::math::random::Random;

    /// Pixels of up to so many taps each, near each other or anywhere, and where these are.
    fn view(size: [usize; 2], most: usize) -> (Footprints, Vec<Vec<Vec2>>) {
        let random = Random::new(7, 0);
        let extent = Vec2::new(size[0] as f32, size[1] as f32);
        let uniform = |index: usize| random.uniform(index as u64) as f32;
        let anywhere = |index| Vec2::new(uniform(2 * index), uniform(2 * index + 1)) * extent;
        let mut view = Footprints::with_room(0);
        let mut places = Vec::new();
        for index in 0..300 {
            let taps: Vec<Vec2> = (0..=index % most)
                .map(|k| match index % 3 {
                    0 => anywhere(4 * index + k),
                    _ => anywhere(4 * index) + Vec2::new(0.7, -0.4) * k as f32,
                })
                .collect();
            let pixel = Pixel {
                index,
                scale: 0.25,
                target: Vec3::new(1.0, 2.0, uniform(5000 + index)),
                irradiance: None,
                weight: uniform(6000 + index),
            };
            view.push(&pixel, taps.iter().map(|&at| Tap::new(at, size)));
            places.push(taps);
        }
        (view, places)
    }

    /// The texels that a look-up reads, with their weights.
    fn bilinear(at: Vec2, size: [usize; 2]) -> Vec<(usize, f32)> {
        let last = Vec2::new(size[0] as f32 - 1.0, size[1] as f32 - 1.0);
        let at = (at - 0.5).clamp(Vec2::ZERO, last);
        let texels = (0..size[0] * size[1]).map(|t| {
            let away = (Vec2::new((t % size[0]) as f32, (t / size[0]) as f32) - at).abs();
            (t, (1.0 - away.x).max(0.0) * (1.0 - away.y).max(0.0))
        });
        texels.filter(|(_, share)| *share > 0.0).collect()
    }

    #[test]
    fn sums_and_residuals_are_those_of_every_look_up_by_itself() {
        for (size, taps) in [([1, 1], 4), ([3, 2], 4), ([37, 900], 4), ([37, 900], 1)] {
            let (view, places) = view(size, taps);
            let mut sums = Canvas::new(size);
            let sorted = view.sorted(&sums);
            sums.gather(std::slice::from_ref(&sorted), None);
            let mut expected = vec![Vec4::ZERO; size[0] * size[1]];
            for (i, taps) in places.iter().enumerate() {
                let value = (view.target[i] / (0.25 * taps.len() as f32)).extend(1.0);
                for (texel, share) in taps.iter().flat_map(|&at| bilinear(at, size)) {
                    expected[texel] += share * 0.25 * view.weight[i] * value;
                }
            }
            let found: Vec<[f32; 4]> = sums.texels().collect();
            for (t, (found, expected)) in found.iter().zip(&expected).enumerate() {
                let error = (Vec4::from(*found) - expected).abs().max_element();
                assert!(
                    error < 1e-3 * expected.max_element().max(1.0),
                    "{size:?} {t}: {error}"
                );
            }
            let residuals = sorted.residuals(&sums);
            for (residual, &i) in residuals.iter().zip(&sorted.pixels) {
                let i = i as usize;
                let shown: Vec4 = (places[i].iter().flat_map(|&at| bilinear(at, size)))
                    .map(|(texel, share)| share * 0.25 * expected[texel])
                    .sum();
                let error = (*residual - (view.target[i] - shown.truncate())).abs();
                assert!(
                    error.max_element() < 1e-2 * shown.max_element().max(1.0),
                    "{size:?} {i}"
                );
            }
        }
    }
}
