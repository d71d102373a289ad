//! Which lobes a frame adds, and how much of each part of the light a vertex sees.
//!
//! While anything moves, a frame adds a bounded number of lobes: every lamp's own, and few wide ones for all other light.
//! A still picture is refined with lobes as narrow as the surface's lobe asks for. Where these are many, each frame adds
//! one window of them, and the mean over all windows is their sum.

use std::ops::Range;

use glam::Vec3;

use super::frame::GpuLobe;
use super::light::{Part, PartKind};
use rekindle_relight::lobes::{Lobe, Source, merge};

/// Lobes of other light than lamps in a frame while things move.
const MOVING: usize = 12;
/// Lobes of all lamps in a frame while things move, as long as every lamp has one.
const MOVING_LAMPS: usize = 12;
/// Lobes that a frame of a still picture adds at most before they are spread over several frames.
const STILL: usize = 32;
/// Visibilities of a vertex that a frame can use.
pub(super) const SLOTS: usize = 24;
/// Words of four visibilities that a frame reads.
const SLOT_WORDS: usize = SLOTS / 4;
/// The one of them that says how much of the sky is seen: for light that is not baked.
const OPENNESS: usize = SLOTS - 1;
/// Lamps whose visibility has a place in the texture.
pub(super) const MAX_LAMPS: usize = 32;
/// Largest variance of a lamp's lobe, in parts of that of the surface's lobe.
const LAMP_SPREAD: f32 = 0.06;
/// The same of other light.
const SOFT_SPREAD: f32 = 0.2;
/// Frames of a still picture: sixteen places in each pixel.
pub(super) const PLACES: u32 = 16;

/// What hides a lobe.
#[derive(Clone, Copy)]
enum Hidden {
    Nothing = 0,
    Texture = 1,
    Vertices = 2,
    ShadowMap = 3,
}

const LIVE: u32 = 1 << 16;
const NEAR: u32 = 1 << 17;
const NO_LOBE: u32 = 1 << 18;

/// A part of the light with what the device has of it.
pub(super) struct Lit<'a> {
    pub part: &'a Part,
    /// Whether it is baked. What isn't is lit by its lobes in every frame.
    pub baked: bool,
    /// A lamp's place in the visibility texture.
    pub place: Option<usize>,
    /// Its shadow map.
    pub shadow_map: Option<usize>,
    /// Where its groups begin among those of all soft parts, and the seen part per vertex and group.
    pub soft: Option<&'a Soft>,
}

/// Visibility per vertex of a part that is no lamp.
pub(super) struct Soft {
    /// Its groups.
    pub groups: usize,
    /// Per vertex and group the seen part, 0 to 255.
    pub seen: Vec<u8>,
}

/// Some of the frames' lobes.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Window {
    /// Lobes.
    pub range: Range<u32>,
    /// First of the words of a vertex's row that they refer to.
    pub first_word: u32,
}

/// The lobes of all frames.
#[derive(Default)]
pub(super) struct Lists {
    pub lobes: Vec<GpuLobe>,
    /// Those of a frame while things move.
    pub moving: Window,
    /// Those of every frame of a still picture.
    pub always: Window,
    /// Each of a still picture's frames adds one of these as well; a power of two up to 16 or a multiple of 16 of them.
    pub windows: Vec<Window>,
    /// Words per vertex.
    pub row_words: u32,
    /// The rows.
    pub rows: Vec<u32>,
}

impl Lists {
    /// Frames that a still picture takes.
    pub(super) fn frames(&self) -> u32 {
        (self.windows.len() as u32).max(PLACES)
    }

    /// The lobes for a surface with the roughness `sigma`, if it has a specular part. `unit` is the unit of radiance,
    /// `openness` the part of the sky that each vertex sees, `row_limit` the bytes that visibilities may take.
    pub(super) fn new(
        lit: &[Lit],
        sigma: Option<f32>,
        unit: f32,
        openness: &[u8],
        row_limit: u64,
    ) -> Self {
        let variance = sigma.map_or(0.1, |s| s * s);
        let mut lists = Self::default();
        let writer =
            |lobe: &Lobe, hidden: Hidden, index: usize, live: bool, radius: Option<f32>| GpuLobe {
                place: (lobe.direction * radius.unwrap_or(1.0)).to_array(),
                spread: lobe.spread,
                flux: (lobe.flux / unit).to_array(),
                bits: index as u32
                    | (hidden as u32) << 8
                    | if live { LIVE } else { 0 }
                    | if radius.is_some() { NEAR } else { 0 },
            };
        let lamps: Vec<&Lit> = lit
            .iter()
            .filter(|l| matches!(l.part.kind, PartKind::Lamp(_)))
            .collect();
        let lamp_lobes = |l: &Lit, most: usize| -> Vec<GpuLobe> {
            let (hidden, index) = match (l.baked, l.place, l.shadow_map) {
                (true, Some(place), _) => (Hidden::Texture, place),
                (false, _, Some(map)) => (Hidden::ShadowMap, map),
                _ => (Hidden::Nothing, 0),
            };
            merge(l.part.sources(), LAMP_SPREAD * variance, most)
                .iter()
                .map(|lobe| writer(lobe, hidden, index, !l.baked, l.part.radius()))
                .collect()
        };
        let most = (MOVING_LAMPS / lamps.len().max(1)).max(1);
        let moving_lamps: Vec<GpuLobe> = lamps.iter().flat_map(|l| lamp_lobes(l, most)).collect();
        let still_lamps: Vec<GpuLobe> = lamps
            .iter()
            .flat_map(|l| lamp_lobes(l, if l.baked { usize::MAX } else { most }))
            .collect();
        let soft = SoftLight::new(lit, SOFT_SPREAD * variance, openness, row_limit);
        // Of light that isn't baked a vertex sees as much as of the sky.
        let bare: Vec<GpuLobe> = lit
            .iter()
            .filter(|l| {
                matches!(l.part.kind, PartKind::Remainder | PartKind::Environment) && !l.baked
            })
            .flat_map(|l| {
                let hidden = soft.hidden();
                let (mirrored, of_sky) = l.part.sources_by_lobes();
                let bare = move |sources, bits| {
                    let lobes = merge(sources, SOFT_SPREAD * variance, MOVING).into_iter();
                    lobes.map(move |lobe| {
                        let lobe = writer(&lobe, hidden, OPENNESS, true, l.part.radius());
                        GpuLobe {
                            bits: lobe.bits | bits,
                            ..lobe
                        }
                    })
                };
                bare(mirrored, 0).chain(bare(of_sky, NO_LOBE))
            })
            .collect();
        // Their words are the first, so nothing is refined in windows as long as there are such.
        let few = soft.fine.len() <= MOVING || !bare.is_empty();
        let wide: Vec<GpuLobe> = soft
            .wide()
            .iter()
            .enumerate()
            .map(|(slot, (lobe, radius))| writer(lobe, soft.hidden(), slot, false, *radius))
            .collect();
        lists.moving = lists.push(&[&moving_lamps, &bare, &wide]);
        let mut rest: Vec<(GpuLobe, Option<u32>)> = Vec::new();
        let lamps_in_windows = still_lamps.len() > STILL && bare.is_empty();
        if lamps_in_windows {
            rest.extend(still_lamps.iter().map(|l| (*l, None)));
        }
        if !few {
            rest.extend(soft.fine.iter().map(|(lobe, radius)| {
                let group = lobe.groups.first().map_or(0, |g| g.0);
                (writer(lobe, soft.hidden(), 0, false, *radius), Some(group))
            }));
        }
        let none: &[GpuLobe] = &[];
        lists.always = lists.push(&[
            if lamps_in_windows { none } else { &still_lamps },
            &bare,
            if few { &wide } else { none },
        ]);
        lists.add_windows(&rest);
        (lists.row_words, lists.rows) = soft.rows();
        lists
    }

    fn push(&mut self, lists: &[&[GpuLobe]]) -> Window {
        let first = self.lobes.len() as u32;
        for list in lists {
            self.lobes.extend_from_slice(list);
        }
        Window {
            range: first..self.lobes.len() as u32,
            first_word: 0,
        }
    }

    /// Cuts lobes with their groups into windows whose groups lie close enough together.
    fn add_windows(&mut self, rest: &[(GpuLobe, Option<u32>)]) {
        let mut window: Option<(Window, u32)> = None;
        for (lobe, group) in rest {
            let fits = window.as_ref().is_some_and(|(w, first)| {
                w.range.len() < STILL
                    && group.is_none_or(|g| g >= *first && g - first < SLOTS as u32)
            });
            if !fits {
                self.windows.extend(window.take().map(|w| w.0));
            }
            let at = self.lobes.len() as u32;
            let (open, first) = window.get_or_insert_with(|| {
                let first = group.unwrap_or(0) / 4 * 4;
                let start = Window {
                    range: at..at,
                    first_word: SLOT_WORDS as u32 + first / 4,
                };
                (start, first)
            });
            let slot = group.map_or(0, |g| g - *first);
            self.lobes.push(GpuLobe {
                bits: lobe.bits | slot,
                ..*lobe
            });
            open.range.end = at + 1;
        }
        self.windows.extend(window.map(|w| w.0));
        let count = self.windows.len() as u32;
        let padded = if count <= PLACES {
            count.next_power_of_two()
        } else {
            count.next_multiple_of(PLACES)
        };
        if count > 0 {
            self.windows.resize(padded as usize, Window::default());
        }
    }
}

/// All light that is baked but no lamp.
struct SoftLight<'a> {
    openness: &'a [u8],
    /// Parts with the number of their first group.
    parts: Vec<(&'a Soft, usize)>,
    groups: usize,
    /// One group each, in the order of groups, with the distance of the nodes.
    fine: Vec<(Lobe, Option<f32>)>,
    /// All groups together.
    coarse: Vec<(Lobe, Option<f32>)>,
    /// Whether the device has room for visibilities.
    hides: bool,
}

impl<'a> SoftLight<'a> {
    fn new(lit: &[Lit<'a>], spread: f32, openness: &'a [u8], row_limit: u64) -> Self {
        let mut light = Self {
            openness,
            parts: Vec::new(),
            groups: 0,
            fine: Vec::new(),
            coarse: Vec::new(),
            hides: true,
        };
        let mut by_radius: Vec<(Option<f32>, Vec<Source>)> = Vec::new();
        for l in lit.iter().filter(|l| l.baked) {
            let Some(soft) = l.soft else { continue };
            let first = light.groups;
            light.groups += soft.groups;
            light.parts.push((soft, first));
            let (mut sources, _) = l.part.sources_by_lobes();
            for source in &mut sources {
                source.group += first as u32;
            }
            for group in sources.chunk_by(|a, b| a.group == b.group) {
                let lobes = merge(group.to_vec(), spread, usize::MAX);
                light
                    .fine
                    .extend(lobes.into_iter().map(|lobe| (lobe, l.part.radius())));
            }
            by_radius.push((l.part.radius(), sources));
        }
        let each = MOVING / by_radius.len().max(1);
        for (radius, sources) in by_radius {
            light.coarse.extend(
                merge(sources, spread, each)
                    .into_iter()
                    .map(|lobe| (lobe, radius)),
            );
        }
        light.hides = light.row_words() as u64 * 4 * openness.len() as u64 <= row_limit;
        light
    }

    fn row_words(&self) -> usize {
        // A frame reads all its words wherever the first one is.
        SLOT_WORDS + self.groups.div_ceil(4) + SLOT_WORDS
    }

    fn hidden(&self) -> Hidden {
        if self.hides {
            Hidden::Vertices
        } else {
            Hidden::Nothing
        }
    }

    /// The lobes of a frame in which not all have room.
    fn wide(&self) -> &[(Lobe, Option<f32>)] {
        if self.fine.len() <= MOVING {
            &self.fine
        } else {
            &self.coarse
        }
    }

    /// Words per vertex and the rows: first what each wide lobe's groups are seen of in the mean, then every group.
    fn rows(&self) -> (u32, Vec<u32>) {
        if !self.hides {
            return (0, Vec::new());
        }
        let words = self.row_words();
        let wide = self.wide();
        let mut rows = vec![0_u32; words * self.openness.len()];
        let mut seen = vec![0_u8; self.groups];
        for (v, row) in rows.chunks_mut(words).enumerate() {
            for (soft, first) in &self.parts {
                let theirs = &soft.seen[v * soft.groups..(v + 1) * soft.groups];
                seen[*first..first + soft.groups].copy_from_slice(theirs);
            }
            for (slot, (lobe, _)) in wide.iter().enumerate() {
                let mean: f32 = lobe
                    .groups
                    .iter()
                    .map(|&(g, share)| share * f32::from(seen[g as usize]))
                    .sum();
                row[slot / 4] |= ((mean + 0.5) as u32).min(255) << (8 * (slot % 4));
            }
            row[OPENNESS / 4] |= u32::from(self.openness[v]) << (8 * (OPENNESS % 4));
            for (group, &byte) in seen.iter().enumerate() {
                row[SLOT_WORDS + group / 4] |= u32::from(byte) << (8 * (group % 4));
            }
        }
        (words as u32, rows)
    }
}

/// The place in its pixel of a still picture's frame, in pixels from the centre: those of the reference renderer, in an
/// order in which every fourth makes a diagonal.
pub(super) fn jitter(frame: u32) -> [f32; 2] {
    let (row, turn) = (frame / 4 % 4, frame % 4);
    let offset = |cell: u32| (cell as f32 + 0.5) / 4.0 - 0.5;
    [offset((row + turn) % 4), offset(row)]
}

/// Places of the strongest lamps in the visibility texture: one per part.
pub(super) fn places(parts: &[Part]) -> Vec<Option<usize>> {
    let mut order: Vec<usize> = (0..parts.len())
        .filter(|&i| matches!(parts[i].kind, PartKind::Lamp(_)))
        .collect();
    let strength = |i: &usize| parts[*i].weight.element_sum();
    if order.len() > MAX_LAMPS {
        order.sort_by(|a, b| strength(b).total_cmp(&strength(a)).then(a.cmp(b)));
        order.truncate(MAX_LAMPS);
        order.sort_unstable();
    }
    let mut places = vec![None; parts.len()];
    for (place, part) in order.into_iter().enumerate() {
        places[part] = Some(place);
    }
    places
}

/// Whether a weight lets any light through.
pub(super) fn is_on(weight: Vec3) -> bool {
    weight != Vec3::ZERO
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;
    use rekindle_relight::{Environment, LampNodes, LatLong, LightNode, Lighting};

    fn sky(patches: usize) -> Lighting {
        let node = |k: usize| {
            let height = 1.0 - (k as f32 + 0.5) / (16 * patches) as f32;
            let across = (1.0 - height * height).sqrt();
            let (sin, cos) = (k as f32 * rekindle_base::math::GOLDEN_ANGLE).sin_cos();
            LightNode {
                direction: Vec3::new(across * cos, height, across * sin),
                radiance: Vec3::ONE,
                solid_angle: 0.01,
            }
        };
        let even = LatLong::of(8, |_| Vec3::ONE).environment(Quat::IDENTITY, Vec3::ONE);
        let even = Environment {
            patches: Vec::new(),
            ..even.expect("it shines")
        };
        Lighting {
            environment: Some(Environment {
                suns: (0..patches)
                    .filter_map(|p| {
                        LampNodes::new((0..16).map(|k| node(16 * p + k)).collect(), None)
                    })
                    .collect(),
                ..even
            }),
            ..Lighting::of(vec![LampNodes::disc(Vec3::Y, Vec3::ONE, 0.04, None)])
        }
    }

    fn lists(patches: usize, sigma: f32) -> Lists {
        let parts = super::super::light::split(&sky(patches));
        let soft = Soft {
            groups: patches,
            seen: (0..2 * patches).map(|i| i as u8).collect(),
        };
        let lit: Vec<Lit> = parts
            .iter()
            .map(|part| Lit {
                part,
                baked: true,
                place: Some(0),
                shadow_map: None,
                soft: (part.kind == PartKind::Environment).then_some(&soft),
            })
            .collect();
        Lists::new(&lit, Some(sigma), 1.0, &[200, 255], 1 << 20)
    }

    fn flux(lobes: &[GpuLobe]) -> f32 {
        lobes.iter().map(|l| l.flux[0]).sum()
    }

    #[test]
    fn all_light_is_in_the_moving_frame_and_in_the_windows_together() {
        for (patches, sigma) in [(3, 0.3), (96, 0.075), (96, 0.01), (1500, 0.02)] {
            let lists = lists(patches, sigma);
            let of = |w: &Window| flux(&lists.lobes[w.range.start as usize..w.range.end as usize]);
            let expected = 1.0 + 0.16 * patches as f32;
            let moving = of(&lists.moving);
            assert!(
                (moving / expected - 1.0).abs() < 1e-3,
                "{moving}, not {expected}"
            );
            let still = of(&lists.always) + lists.windows.iter().map(of).sum::<f32>();
            assert!(
                (still / expected - 1.0).abs() < 1e-3,
                "{still}, not {expected}"
            );
            assert!(lists.moving.range.len() <= MOVING + MOVING_LAMPS);
            assert!(
                lists
                    .frames()
                    .is_multiple_of(lists.windows.len().max(1) as u32)
            );
            assert!(lists.frames().is_multiple_of(PLACES));
        }
    }

    #[test]
    fn every_lobe_of_a_window_finds_its_groups_visibility() {
        let lists = lists(96, 0.02);
        assert!(lists.windows.len() > 16);
        for window in lists.windows.iter().filter(|w| !w.range.is_empty()) {
            assert!(window.range.len() <= STILL);
            assert!(window.first_word + SLOT_WORDS as u32 <= lists.row_words);
            for lobe in &lists.lobes[window.range.start as usize..window.range.end as usize] {
                let slot = lobe.bits & 0xff;
                assert!(slot < SLOTS as u32);
                // The second vertex sees (96 + g) mod 256 of group g; its row is the second.
                let word = lists.rows[(lists.row_words + window.first_word + slot / 4) as usize];
                let seen = word >> (8 * (slot % 4)) & 0xff;
                assert!((96..192).contains(&seen), "group {seen}");
            }
        }
    }

    #[test]
    fn the_places_in_a_pixel_are_the_reference_renderers() {
        let mut places: Vec<[i32; 2]> = (0..PLACES)
            .map(|f| jitter(f).map(|o| ((o + 0.5) * 4.0 - 0.5).round() as i32))
            .collect();
        places.sort_unstable();
        let expected: Vec<[i32; 2]> = (0..4).flat_map(|x| (0..4).map(move |y| [x, y])).collect();
        assert_eq!(places, expected);
    }
}
