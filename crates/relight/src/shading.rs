//! How a surface point looks under a lighting: specular radiance (eq. 7) and irradiance (the sums of eq. 18–19).
//!
//! * specular = Σ M L ω a · lobe(n, l, v), the lobe of [`Brdf`] with its 1/cos θᵣ inside;
//! * irradiance = Σ M L ω a · max(0, cos θᵢ) T(cos θᵢ), T what enters the surface, [`Brdf::diffuse_entry`];
//!
//! over the nodes of all lamps. a = (R/|p − x|)² is the fall-off of a node at the finite distance R (1 for distant
//! light), M ∈ {0, 1} whether a ray from the surface reaches the node. Light from behind the shading normal or
//! behind the triangle's plane contributes nothing. Interreflection is added elsewhere.
//!
//! A lamp is many nodes, and most points see either all of them or none: a few probes at its rim and centre tell, and
//! only where they disagree (the penumbra) every node has its ray. On a grid of neighbouring points even the
//! probes are cast for every fourth point only; see [`Shader::visibility`].

use std::borrow::{Borrow, Cow};
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{Vec2, Vec3};
use smallvec::SmallVec;

use super::environment::{self, Environment};
use super::lamp_groups::{Group, Horizon, Node, ONE_RAY, Role};
use super::lighting::{LampNodes, Lighting};
use super::patches::patches;
use super::sky::{DrawnLobe, FEW_CASES, Sky};
use rekindle_base::math::GOLDEN_ANGLE;
use rekindle_capture::Mesh;
use rekindle_scene::reflectance::{Brdf, Gloss, MIN_COS_VIEW};
use rekindle_scene::surface::Occluder;

/// Lobes are cut where they have fallen to this part of their peak.
const LOBE_CUTOFF: f32 = 1e-5;
/// Distance, in points of a grid, between those that cast probes.
const STRIDE: usize = 4;
/// Neighbouring points share visibility where their normals' cosine is above this …
const SAME_SURFACE_COS: f32 = 0.8;
/// … and they are no further apart than this many grid spacings per step.
const SAME_SURFACE_STEPS: f32 = 4.0;
/// A lobe of roughness σ does not resolve a lamp of an angular radius below this part of σ |l + v|: the half vector turns
/// by the radius over |l + v|.
const UNRESOLVED: f32 = 0.6;
/// Lamps of a smaller angular radius (radians) are small for the cosine of an irradiance.
const UNRESOLVED_BY_COSINE: f32 = 0.2;

/// A surface point to be shaded.
#[derive(Clone, Copy, Debug)]
pub struct ShadingPoint {
    /// World position.
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit normal of the triangle's plane.
    pub face_normal: Vec3,
    /// How its lobe differs from the main one.
    pub gloss: Gloss,
}

impl ShadingPoint {
    /// A point of a smooth surface.
    pub fn smooth(position: Vec3, normal: Vec3) -> Self {
        Self {
            position,
            normal,
            face_normal: normal,
            gloss: Gloss::MAIN,
        }
    }

    /// The same with another gloss.
    #[must_use]
    pub fn with_gloss(self, gloss: Gloss) -> Self {
        Self { gloss, ..self }
    }

    /// The point of a triangle at the weights of its second and third corner.
    pub fn on(mesh: &Mesh, triangle: u32, barycentric: Vec2) -> Self {
        let point = mesh.point(triangle, barycentric);
        let face_normal = mesh.face_normal(triangle);
        Self {
            position: point.position,
            normal: point.normal,
            face_normal: if face_normal == Vec3::ZERO {
                point.normal
            } else {
                face_normal
            },
            gloss: Gloss::MAIN,
        }
    }
}

/// How much of a lamp a point sees, its own horizon aside.
#[derive(Clone, Debug, PartialEq)]
pub enum Visibility {
    /// The lamp is behind the surface.
    Below,
    /// Something hides all of it.
    Hidden,
    /// All of it.
    Whole,
    /// These nodes: one bit a node.
    Part(Box<[u64]>),
    /// This fraction of a patch of an environment.
    Fraction(f32),
}

impl Visibility {
    /// Part of `nodes` nodes that is seen, for comparing neighbours.
    pub fn share(&self, nodes: usize) -> f32 {
        match self {
            Self::Below | Self::Hidden => 0.0,
            Self::Whole => 1.0,
            Self::Part(bits) => {
                bits.iter().map(|w| w.count_ones()).sum::<u32>() as f32 / nodes.max(1) as f32
            }
            Self::Fraction(f) => *f,
        }
    }
}

/// What arrives at and leaves a point.
#[derive(Clone, Copy, Debug, Default)]
pub struct Shade {
    /// Specular radiance towards the viewer, RGB.
    pub specular: Vec3,
    /// Irradiance as the diffuse part sees it, RGB: Lambert's cosine and the transmittance inside.
    pub irradiance: Vec3,
}

/// A lighting prepared for shading a mesh.
pub struct Shader<'a> {
    occluder: &'a Occluder,
    brdf: Option<Brdf>,
    groups: Vec<Group>,
    /// Irradiance by the ambient part.
    pub(super) ambient: Vec3,
    /// See [`Brdf::tint`].
    tint: Vec3,
    support: Support,
    /// What of environments lobes mirror, their suns aside.
    sky: Option<SkyLight>,
    /// Once set, nothing more is computed.
    stop: Option<&'a AtomicBool>,
}

/// What of environments lobes mirror, and how.
struct SkyLight {
    skies: Vec<Sky>,
    whole: DrawnLobe,
    few: [DrawnLobe; FEW_CASES],
}

impl SkyLight {
    fn new(brdf: Brdf, environments: &[Cow<'_, Environment>]) -> Self {
        Self {
            skies: environments.iter().map(|e| e.sky.clone()).collect(),
            whole: DrawnLobe::new(brdf),
            few: DrawnLobe::few(brdf),
        }
    }
}

/// How closely a lobe is looked at.
#[derive(Clone, Copy)]
pub enum Draw {
    /// By itself.
    Whole,
    /// By few of its half vectors, which and how turned the number of a pixel says: what is wanted is the mean of many of these.
    Few(usize),
}

/// Which lamps are shaded as one environment: where the wide ones together have more patches than that, all but suns.
fn in_sky(lighting: &Lighting, patches: &[Vec<LampNodes>]) -> Vec<bool> {
    let is_distant = |lamp: &LampNodes| !lamp.muted && lamp.radius.is_none();
    let lamps = lighting.lamps.iter();
    let distant = lamps
        .clone()
        .zip(patches)
        .filter(|(lamp, _)| is_distant(lamp));
    let (mut flux, mut cut) = (Vec3::ZERO, 0);
    for (lamp, patches) in distant {
        flux += lamp.flux();
        cut += patches.len();
    }
    let usual = flux.element_sum() / (4.0 * std::f32::consts::PI);
    let is_sky = |lamp: &LampNodes| is_distant(lamp) && Environment::is_sky(lamp, usual);
    lamps
        .map(|lamp| cut > environment::PATCHES && is_sky(lamp))
        .collect()
}

/// Radiance of some skies together about a unit direction, blurred to this standard deviation along each axis, radians.
fn of_skies(skies: &[Sky], direction: Vec3, spread: f32) -> Vec3 {
    let radiances = skies.iter().map(|sky| sky.radiance(direction, spread));
    radiances.sum()
}

impl<'a> Shader<'a> {
    /// Prepares a lighting.
    pub fn new(occluder: &'a Occluder, brdf: Option<Brdf>, lighting: &Lighting) -> Self {
        let mut groups = Vec::new();
        let unresolved = patch_reach(brdf);
        let cut = |lamp| patches(lamp, unresolved.max(ONE_RAY));
        let cut: Vec<Vec<LampNodes>> = lighting.lamps.iter().map(cut).collect();
        let in_sky = match brdf {
            Some(_) => in_sky(lighting, &cut),
            None => vec![false; cut.len()],
        };
        let lamps = || lighting.lamps.iter().zip(&in_sky);
        let sky: Vec<&LampNodes> = lamps()
            .filter_map(|(lamp, is_sky)| is_sky.then_some(lamp))
            .collect();
        let mut environments: Vec<Cow<'_, Environment>> =
            lighting.environment.iter().map(Cow::Borrowed).collect();
        if !sky.is_empty() {
            environments.push(Cow::Owned(Environment::of_lamps(&sky)));
        }
        for ((lamp, is_sky), patches) in lamps().zip(&cut) {
            let (parts, role) = if *is_sky {
                continue;
            } else if patches.is_empty() {
                (std::slice::from_ref(lamp), Role::Lamp)
            } else {
                (&patches[..], Role::Patch)
            };
            let parts = parts.iter();
            let group = |part| Group::new(part, lighting.centre, role, unresolved);
            groups.extend(parts.filter_map(group));
        }
        // Strays have no extent in common: each is a lamp of its own.
        groups.extend(lighting.remainder.iter().filter_map(|node| {
            let lamp = LampNodes::new(vec![*node], lighting.radius)?;
            Group::new(&lamp, lighting.centre, Role::Lamp, unresolved)
        }));
        for environment in &environments {
            let suns = environment.suns.iter().map(|sun| (sun, Role::Lamp));
            let patches = environment.patches.iter().map(|p| (p, Role::Environment));
            let group = |(part, role)| Group::new(part, lighting.centre, role, unresolved);
            groups.extend(suns.chain(patches).filter_map(group));
        }
        let sky = brdf.filter(|_| !environments.is_empty());
        let sky = sky.map(|brdf| SkyLight::new(brdf, &environments));
        Self {
            occluder,
            brdf,
            groups,
            ambient: lighting.ambient * ambient_gain(brdf),
            tint: brdf.map_or(Vec3::ONE, |brdf| brdf.tint(lighting.specular_scale)),
            support: Support::new(brdf),
            sky,
            stop: None,
        }
    }

    /// Once `stop` is set, long work with this shader ends soon. Its results then are of no use.
    #[must_use]
    pub fn stopped_by(self, stop: &'a AtomicBool) -> Self {
        Self {
            stop: Some(stop),
            ..self
        }
    }

    /// Whether the work is to end.
    pub fn is_stopped(&self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    }

    /// The surface's colour where it is a metal; see [`Brdf::tint`].
    pub(super) fn tint(&self) -> Vec3 {
        self.tint
    }

    /// Number of lamps and patches, so of visibilities a point has.
    pub fn groups(&self) -> usize {
        self.groups.len()
    }

    /// Number of nodes of a group.
    pub fn nodes(&self, group: usize) -> usize {
        self.groups[group].nodes.len()
    }

    /// Whether a group's visibility has edges.
    pub fn is_sharp(&self, group: usize) -> bool {
        !self.groups[group].soft
    }

    /// Whether lobes show a group as part of the sky.
    pub fn is_in_sky(&self, group: usize) -> bool {
        self.groups[group].in_sky
    }

    /// Whether a group can add to the specular part seen at a point from the unit direction `view`, but for that of the sky.
    pub fn is_in_lobe(&self, group: usize, point: &ShadingPoint, view: Vec3) -> bool {
        let group = &self.groups[group];
        if group.in_sky {
            return false;
        }
        let (axis, falloff, _) = group.towards(group.axis, point.position);
        let reach = group.reach_from(falloff);
        self.brdf.is_some_and(|brdf| {
            let support = self.support_at(brdf, point);
            support.holds(axis, reach, point.normal, view)
        })
    }

    /// Whether a lobe towards the unit direction `view` shows how a group's light is spread, and not only how much there is.
    pub fn is_resolved(&self, group: usize, point: &ShadingPoint, view: Vec3) -> bool {
        let group = &self.groups[group];
        let (axis, falloff, _) = group.towards(group.axis, point.position);
        self.brdf.is_some_and(|brdf| {
            resolves(brdf.at(point.gloss), group.reach_from(falloff), axis, view)
        })
    }

    /// Where the lobe of a point has not been cut yet.
    fn support_at(&self, brdf: Brdf, point: &ShadingPoint) -> Support {
        if point.gloss.roughness == 1.0 {
            self.support
        } else {
            Support::new(Some(brdf.at(point.gloss)))
        }
    }

    /// Casts a ray to each of some nodes of a group and says for its place in the list whether it is blocked; not of those
    /// behind the surface.
    fn cast_to(
        &self,
        point: &ShadingPoint,
        origin: Vec3,
        group: &Group,
        nodes: &[usize],
        tell: impl FnMut(usize, bool),
    ) {
        let rays = nodes.iter().enumerate().filter_map(|(place, &node)| {
            let (l, distance) = group.ray_to(node, point)?;
            Some((place, l, distance))
        });
        self.occluder.each_occluded(origin, rays, tell);
    }

    /// Casts the rays that tell how much of a group a point sees.
    pub fn cast(&self, point: &ShadingPoint, group: usize) -> Visibility {
        let group = &self.groups[group];
        if group.horizon(point) == Horizon::Below || self.is_stopped() {
            return Visibility::Below;
        }
        let origin = self
            .occluder
            .offset_origin(point.position, point.face_normal);
        let (mut blocked, mut clear) = (0, 0);
        self.cast_to(point, origin, group, &group.probes, |_, is_blocked| {
            if is_blocked {
                blocked += 1;
            } else {
                clear += 1;
            }
        });
        if group.soft {
            return Visibility::Fraction(fraction(blocked, clear));
        }
        match (blocked, clear) {
            (0, 1..) => Visibility::Whole,
            (1.., 0) => Visibility::Hidden,
            _ => Visibility::Part(self.cast_all(point, origin, group)),
        }
    }

    /// Which nodes of a group a point sees. Scouts go first; a node among three scouts that agree is as they are.
    fn cast_all(&self, point: &ShadingPoint, origin: Vec3, group: &Group) -> Box<[u64]> {
        let mut scouts = vec![None; group.scouts.len()];
        self.cast_to(point, origin, group, &group.scouts, |scout, blocked| {
            scouts[scout] = Some(blocked);
        });
        let agreed = |node: usize| {
            let &[a, b, c] = group.among.get(node)?;
            let first = scouts[usize::from(a)]?;
            let agree = [b, c]
                .iter()
                .all(|&s| scouts[usize::from(s)] == Some(first));
            agree.then_some(first)
        };
        let mut bits = vec![0_u64; group.nodes.len().div_ceil(64)].into_boxed_slice();
        let mut tell = |node: usize, blocked: bool| {
            bits[node / 64] |= u64::from(!blocked) << (node % 64);
        };
        let mut open = Vec::new();
        for node in 0..group.nodes.len() {
            match agreed(node) {
                Some(blocked) => tell(node, blocked),
                None => open.push(node),
            }
        }
        self.cast_to(point, origin, group, &open, |k, blocked| {
            tell(open[k], blocked);
        });
        bits
    }

    /// Part of a group's light, of what is above the horizon, that reaches a point; `None` where all of it is below.
    pub fn seen_share(&self, point: &ShadingPoint, group: usize) -> Option<f32> {
        self.share(point, group, &self.cast(point, group))
    }

    /// [`Shader::seen_share`] of every group. Rays to those without sharp shadows, which are many beside each other, go together.
    pub fn seen_shares(&self, point: &ShadingPoint) -> Vec<Option<f32>> {
        let mut shares = vec![None; self.groups.len()];
        if self.is_stopped() {
            return shares;
        }
        let origin = self
            .occluder
            .offset_origin(point.position, point.face_normal);
        let is_cast = |g: &usize| {
            let group = &self.groups[*g];
            group.soft && group.horizon(point) != Horizon::Below
        };
        let soft = (0..shares.len()).filter(is_cast);
        let rays = soft.clone().flat_map(|g| {
            let group = &self.groups[g];
            let probes = group.probes.iter();
            probes.filter_map(move |&node| {
                let (l, distance) = group.ray_to(node, point)?;
                Some((g, l, distance))
            })
        });
        let mut counts = vec![[0_u32; 2]; shares.len()];
        self.occluder.each_occluded(origin, rays, |g, is_blocked| {
            counts[g][usize::from(is_blocked)] += 1;
        });
        for g in soft {
            let [clear, blocked] = counts[g];
            shares[g] = Some(fraction(blocked, clear));
        }
        for g in (0..shares.len()).filter(|&g| self.is_sharp(g)) {
            shares[g] = self.seen_share(point, g);
        }
        shares
    }

    /// [`Shader::seen_share`] of a visibility that is known.
    pub fn share(&self, point: &ShadingPoint, group: usize, seen: &Visibility) -> Option<f32> {
        let group = &self.groups[group];
        match seen {
            Visibility::Below => None,
            Visibility::Hidden => Some(0.0),
            Visibility::Whole => Some(1.0),
            Visibility::Fraction(f) => Some(*f),
            Visibility::Part(bits) => {
                let (mut clear, mut all) = (0.0, 0.0);
                for (i, node) in group.nodes.iter().enumerate() {
                    let (l, falloff, _) = group.towards(node.place, point.position);
                    if l.dot(point.normal) > 0.0 && l.dot(point.face_normal) > 0.0 {
                        let flux = falloff * node.flux.element_sum();
                        all += flux;
                        clear += flux * f32::from(u8::from(bits[i / 64] >> (i % 64) & 1 == 1));
                    }
                }
                (all > 0.0).then(|| clear / all)
            }
        }
    }

    /// Visibilities on a grid of `points`, row by row, `width` of them in a row, `groups()` for each point. `told` gives those
    /// that are known beforehand. Only every fourth point in each direction casts probes; those between take what all their
    /// neighbours of the same surface agree on, and cast their own where there is no agreement. `spacing` is the typical
    /// distance of neighbouring points; `wanted` says whether a point needs a group at all.
    pub fn visibility(
        &self,
        points: &[Option<ShadingPoint>],
        width: usize,
        spacing: f32,
        wanted: &dyn Fn(usize, usize) -> bool,
        told: &dyn Fn(usize, usize) -> Option<Visibility>,
    ) -> Vec<Visibility> {
        let height = points.len() / width.max(1);
        let count = self.groups.len();
        let mut all = vec![Visibility::Below; points.len() * count];
        let size = [width, height];
        let mut needed = vec![false; count];
        for y in (0..height).filter(|y| y.is_multiple_of(STRIDE) || y + 1 == height) {
            for x in (0..width).filter(|&x| is_coarse([x, y], size)) {
                let Some(point) = &points[y * width + x] else {
                    continue;
                };
                // A coarse point answers for the cells around it.
                needed.fill(false);
                for ny in y.saturating_sub(STRIDE)..(y + STRIDE + 1).min(height) {
                    for nx in x.saturating_sub(STRIDE)..(x + STRIDE + 1).min(width) {
                        if points[ny * width + nx].is_some() {
                            for (g, n) in needed.iter_mut().enumerate() {
                                *n = *n || wanted(ny * width + nx, g);
                            }
                        }
                    }
                }
                let index = y * width + x;
                for g in (0..count).filter(|&g| needed[g]) {
                    all[index * count + g] = told(index, g).unwrap_or_else(|| self.cast(point, g));
                }
            }
        }
        for y in 0..height {
            for x in (0..width).filter(|&x| !is_coarse([x, y], size)) {
                let index = y * width + x;
                let Some(point) = &points[index] else {
                    continue;
                };
                let corners = corners(points, size, [x, y], spacing, SAME_SURFACE_COS);
                for g in (0..count).filter(|&g| wanted(index, g)) {
                    all[index * count + g] = told(index, g)
                        .or_else(|| self.shared(&corners, &all, g, point))
                        .unwrap_or_else(|| self.cast(point, g));
                }
            }
        }
        all
    }

    /// What a point's coarse neighbours say about a group, if they agree.
    fn shared(
        &self,
        corners: &[(usize, f32)],
        all: &[Visibility],
        group: usize,
        point: &ShadingPoint,
    ) -> Option<Visibility> {
        let count = self.groups.len();
        let of = |corner: &(usize, f32)| &all[corner.0 * count + group];
        if self.groups[group].horizon(point) == Horizon::Below {
            return Some(Visibility::Below);
        }
        if self.groups[group].soft {
            let (mut sum, mut weights) = (0.0, 0.0);
            for corner in corners {
                if let Visibility::Fraction(f) = of(corner) {
                    sum += corner.1 * f;
                    weights += corner.1;
                }
            }
            return (weights > 1e-3).then(|| Visibility::Fraction(sum / weights));
        }
        let (first, others) = corners.split_first()?;
        let agreed = of(first);
        let plain = matches!(agreed, Visibility::Whole | Visibility::Hidden);
        (corners.len() >= 3 && plain && others.iter().all(|c| of(c) == agreed))
            .then(|| agreed.clone())
    }

    /// Specular radiance and irradiance at a point seen from the unit direction `view`, given its visibilities.
    pub fn shade(&self, point: &ShadingPoint, view: Vec3, visibility: &[Visibility]) -> Shade {
        Shade {
            specular: self.specular(point, view, visibility),
            irradiance: self.irradiance(point, visibility),
        }
    }

    /// Specular radiance at a point seen from the unit direction `view`, given its visibilities, but for that of the sky.
    pub fn specular(&self, point: &ShadingPoint, view: Vec3, visibility: &[Visibility]) -> Vec3 {
        self.specular_seen(point, view, |group| &visibility[group])
    }

    /// The same where so much is seen of each group.
    pub(super) fn specular_of_shares(
        &self,
        point: &ShadingPoint,
        view: Vec3,
        share: impl Fn(usize) -> f32,
    ) -> Vec3 {
        self.specular_seen(point, view, |group| match share(group) {
            0.0 => Visibility::Hidden,
            share => Visibility::Fraction(share),
        })
    }

    fn specular_seen<V: Borrow<Visibility>>(
        &self,
        point: &ShadingPoint,
        view: Vec3,
        visibility: impl Fn(usize) -> V,
    ) -> Vec3 {
        let mut specular = Vec3::ZERO;
        let Some(main) = self.brdf.filter(|_| point.gloss.strength > 0.0) else {
            return specular;
        };
        let brdf = main.at(point.gloss);
        let support = self.support_at(main, point);
        let terms = brdf.view_terms(point.normal, view);
        for (index, group) in self.groups.iter().enumerate() {
            let seen = visibility(index);
            let seen = seen.borrow();
            if group.in_sky || matches!(seen, Visibility::Below | Visibility::Hidden) {
                continue;
            }
            let (axis, falloff, _) = group.towards(group.axis, point.position);
            let reach = group.reach_from(falloff);
            if support.holds(axis, reach, point.normal, view) {
                let resolved = resolves(brdf, reach, axis, view);
                let nodes = group.standing_for(point, seen, resolved);
                Self::each_seen(group, nodes, point, seen, |l, flux| {
                    specular += flux * brdf.lobe(&terms, l);
                });
            }
        }
        specular * point.gloss.peak()
    }

    /// Whether lobes may show the sky of an environment.
    pub(super) fn shows_sky(&self) -> bool {
        self.sky.is_some()
    }

    /// Specular radiance of an environment's sky at a point seen from the unit direction `view`. What the rest of the surface may
    /// hide of it is found out by rays where the point `is_sheltered`.
    pub fn specular_of_sky(
        &self,
        point: &ShadingPoint,
        view: Vec3,
        is_sheltered: bool,
        draw: Draw,
    ) -> Vec3 {
        let mut specular = Vec3::ZERO;
        let (Some(sky), Some(main)) = (&self.sky, self.brdf) else {
            return specular;
        };
        if point.gloss.strength <= 0.0 || self.is_stopped() {
            return specular;
        }
        let mut rays: SmallVec<[(Vec3, Vec3, f32); 64]> = SmallVec::new();
        let lobe = (main.at(point.gloss), point.gloss.roughness);
        let (drawn, angle) = match draw {
            Draw::Whole => (&sky.whole, 0.0),
            Draw::Few(pixel) => (&sky.few[pixel % FEW_CASES], pixel as f32 * GOLDEN_ANGLE),
        };
        drawn.each(lobe, angle, point.normal, view, |mirrored| {
            if mirrored.weight > 0.0 && mirrored.light.dot(point.face_normal) > 0.0 {
                let radiance = of_skies(&sky.skies, mirrored.light, mirrored.spread);
                let arriving = mirrored.weight * radiance;
                if is_sheltered {
                    rays.push((arriving, mirrored.light, f32::INFINITY));
                } else {
                    specular += arriving;
                }
            }
        });
        let origin = self
            .occluder
            .offset_origin(point.position, point.face_normal);
        (self.occluder).each_occluded(origin, rays, |arriving, is_blocked| {
            if !is_blocked {
                specular += arriving;
            }
        });
        specular * point.gloss.peak()
    }

    /// The same by the middle of the lobe alone, for what is seen in a mirror.
    pub(super) fn specular_of_sky_in_mirror(&self, point: &ShadingPoint, view: Vec3) -> Vec3 {
        let (Some(sky), Some(main)) = (&self.sky, self.brdf) else {
            return Vec3::ZERO;
        };
        let cos = point.normal.dot(view).max(MIN_COS_VIEW);
        let light = point.normal * (2.0 * cos) - view;
        let origin = self
            .occluder
            .offset_origin(point.position, point.face_normal);
        if light.dot(point.face_normal) <= 0.0
            || self.occluder.occluded(origin, light, f32::INFINITY)
        {
            return Vec3::ZERO;
        }
        let brdf = main.at(point.gloss);
        // Mirroring turns by twice the half vector's angle along the plane of view and normal, and by less across.
        let spread = 2.0 * brdf.sigma * cos.sqrt();
        let reflected = brdf.drawn_scale(cos) * brdf.drawn_reflectance(0.0, cos, cos);
        of_skies(&sky.skies, light, spread) * (reflected * point.gloss.peak())
    }

    /// Irradiance at a point, given its visibilities.
    pub fn irradiance(&self, point: &ShadingPoint, visibility: &[Visibility]) -> Vec3 {
        self.ambient + self.irradiance_by(point, visibility.iter().enumerate())
    }

    /// Irradiance at a point that sees these parts of the groups.
    pub fn irradiance_of_shares(&self, point: &ShadingPoint, shares: &[Option<f32>]) -> Vec3 {
        let seen = |(g, share): (usize, &Option<f32>)| Some((g, Visibility::Fraction((*share)?)));
        let seen = shares.iter().enumerate().filter_map(seen);
        self.ambient + self.irradiance_by(point, seen)
    }

    /// Irradiance at a point by some groups, given their visibilities, without the ambient part.
    pub(super) fn irradiance_by<V: Borrow<Visibility>>(
        &self,
        point: &ShadingPoint,
        visibility: impl Iterator<Item = (usize, V)>,
    ) -> Vec3 {
        let mut irradiance = Vec3::ZERO;
        let transmittance = |cos: f32| self.brdf.map_or(1.0, |b| b.diffuse_entry(cos));
        for (group, seen) in visibility {
            let (group, seen) = (&self.groups[group], seen.borrow());
            // Distant light that is wholly seen and above the horizon adds up beforehand, as long as the
            // transmittance is the same for all of it.
            let weight = match seen {
                Visibility::Whole => 1.0,
                Visibility::Fraction(f) => *f,
                _ => f32::NAN,
            };
            if group.near.is_none()
                && !weight.is_nan()
                && group.horizon(point) == Horizon::Above
                && group.reach < 0.2
            {
                let through = weight * transmittance(group.axis.dot(point.normal));
                irradiance += through
                    * Vec3::new(
                        group.moment[0].dot(point.normal),
                        group.moment[1].dot(point.normal),
                        group.moment[2].dot(point.normal),
                    )
                    .max(Vec3::ZERO);
            } else {
                let resolved = group.reach > UNRESOLVED_BY_COSINE;
                let nodes = match &group.middle {
                    Some(middle) => middle,
                    None => group.standing_for(point, seen, resolved),
                };
                Self::each_seen(group, nodes, point, seen, |l, flux| {
                    let cos = l.dot(point.normal);
                    irradiance += flux * (cos * transmittance(cos));
                });
            }
        }
        irradiance
    }

    /// Calls `add(l, flux × fall-off)` for every one of a group's `nodes` that lights the point.
    #[inline]
    fn each_seen(
        group: &Group,
        nodes: &[Node],
        point: &ShadingPoint,
        seen: &Visibility,
        mut add: impl FnMut(Vec3, Vec3),
    ) {
        let weight = match seen {
            Visibility::Below | Visibility::Hidden => return,
            Visibility::Whole | Visibility::Part(_) => 1.0,
            Visibility::Fraction(f) => *f,
        };
        for (i, node) in nodes.iter().enumerate() {
            if let Visibility::Part(bits) = seen
                && bits[i / 64] >> (i % 64) & 1 == 0
            {
                continue;
            }
            let (l, falloff, _) = group.towards(node.place, point.position);
            if l.dot(point.normal) > 0.0 && l.dot(point.face_normal) > 0.0 {
                add(l, node.flux * (falloff * weight));
            }
        }
    }
}

/// Seen part of a group without sharp shadows by so many rays.
fn fraction(blocked: u32, clear: u32) -> f32 {
    match blocked + clear {
        0 => 1.0,
        rays => clear as f32 / rays as f32,
    }
}

/// Whether a lobe resolves light within the angle `reach` of `axis`.
fn resolves(brdf: Brdf, reach: f32, axis: Vec3, view: Vec3) -> bool {
    reach > UNRESOLVED * brdf.sigma * (axis + view).length()
}

/// How large parts of a wide lamp may be for the lobe, radians: so that it does not resolve them except at a grazing angle, and
/// there are not too many.
fn patch_reach(brdf: Option<Brdf>) -> f32 {
    const SMALLEST: f32 = 0.05;
    const LARGEST: f32 = 0.24;
    const GRAZING: f32 = 1.5;
    let unresolved = brdf.map_or(ONE_RAY, |b| UNRESOLVED * b.sigma * GRAZING);
    unresolved.clamp(SMALLEST, LARGEST)
}

/// Where a lobe has not been cut yet: the angle between half vector and normal.
#[derive(Clone, Copy, Debug)]
struct Support {
    cos: f32,
    sin: f32,
}

impl Support {
    fn new(brdf: Option<Brdf>) -> Self {
        let angle = brdf.map_or(0.0, |b| b.half_angle_support(LOBE_CUTOFF));
        Self {
            cos: angle.cos(),
            sin: angle.sin(),
        }
    }

    /// Whether light within the angle `reach` of `axis` can have its half vector in it.
    fn holds(self, axis: Vec3, reach: f32, normal: Vec3, view: Vec3) -> bool {
        let sum = axis + view;
        let length = sum.length();
        // The half vector turns by at most reach/|l + v|, a little more as |l + v| itself changes with l.
        let turn = reach / (length - reach).max(1e-3);
        // cos(angle + turn) is no less than this.
        let least = self.cos * (1.0 - 0.5 * turn * turn) - self.sin * turn;
        sum.dot(normal) > length * least.min(self.cos)
    }
}

/// Irradiance, transmittance inside, by unit radiance from everywhere.
pub fn ambient_gain(brdf: Option<Brdf>) -> f32 {
    std::f32::consts::PI * brdf.map_or(1.0, mean_transmittance)
}

/// ∫ T(cos θ) cos θ dω / π over the hemisphere: the transmittance of uniform light.
fn mean_transmittance(brdf: Brdf) -> f32 {
    /// Midpoint rule in cos²θ.
    const STEPS: usize = 64;
    (0..STEPS)
        .map(|i| brdf.diffuse_entry(((i as f32 + 0.5) / STEPS as f32).sqrt()))
        .sum::<f32>()
        / STEPS as f32
}

/// Whether a grid's point at `[x, y]` is one of those that others are interpolated from.
pub(super) fn is_coarse([x, y]: [usize; 2], [width, height]: [usize; 2]) -> bool {
    (x.is_multiple_of(STRIDE) || x + 1 == width) && (y.is_multiple_of(STRIDE) || y + 1 == height)
}

/// The corners of a point's cell that lie on the same surface, normals at most at the cosine `min_cos`, with bilinear
/// weights.
pub(super) fn corners(
    points: &[Option<ShadingPoint>],
    [width, height]: [usize; 2],
    [x, y]: [usize; 2],
    spacing: f32,
    min_cos: f32,
) -> SmallVec<[(usize, f32); 4]> {
    let mut found = SmallVec::new();
    let Some(point) = &points[y * width + x] else {
        return found;
    };
    let ends = |at: usize, limit: usize| {
        let low = at - at % STRIDE;
        let high = (low + STRIDE).min(limit - 1);
        let t = if high > low {
            (at - low) as f32 / (high - low) as f32
        } else {
            0.0
        };
        [(low, 1.0 - t), (high, t)]
    };
    let reach = SAME_SURFACE_STEPS * STRIDE as f32 * spacing;
    for (cy, wy) in ends(y, height) {
        for (cx, wx) in ends(x, width) {
            let index = cy * width + cx;
            if let Some(corner) = &points[index]
                && corner.normal.dot(point.normal) > min_cos
                && corner.position.distance_squared(point.position) < reach * reach
            {
                found.push((index, wx * wy));
            }
        }
    }
    found
}
