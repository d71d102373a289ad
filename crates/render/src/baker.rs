//! Light baked in the background with the reference renderer's own code: irradiance and visibility of one part of the light.
//!
//! One thread works through the newest request. A part that is done goes back at once; a newer request takes effect when
//! the part in work is done.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use glam::Vec3;
use half::f16;
use rayon::prelude::*;

use super::error::RenderError;
use super::surface::{Surface, to_half};
use rekindle_relight::lobes::{Source, merge};
use rekindle_relight::{
    LampNodes, LightNode, Lighting, Shader, ShadingPoint, TriangleShares, Visibility,
    texel_irradiance,
};

/// Nodes of an environment's patch are merged up to this variance of their directions, radians², where irradiance alone
/// matters.
const PATCH_SPREAD: f32 = 4e-3;
/// Patches with a larger part of the light keep all their nodes.
const BRIGHT: f32 = 0.02;
/// Rays that the reference renderer casts to a patch.
const PATCH_RAYS: usize = 4;

/// A part of the light to be baked.
#[derive(Clone)]
pub(super) struct Order {
    /// Comes back with the result.
    pub id: u64,
    /// The part with unit flux.
    pub shape: Lighting,
    /// Whether its visibility is that of one lamp, to be kept per texel.
    pub lamp: bool,
    /// Whether a draft is enough for now. Lamps have none: their shadow maps are as good.
    pub draft: bool,
}

/// A baked part of the light.
pub(super) struct Baked {
    /// That of the order.
    pub id: u64,
    /// Whether the exact result is still to come.
    pub draft: bool,
    /// Per texel of the light atlas: irradiance, direct and interreflected, in units of the surface, by unit flux; alpha is 0.
    pub irradiance: Vec<[f16; 4]>,
    /// A lamp's seen part per texel, 0 to 255; empty for other parts.
    pub visibility: Vec<u8>,
    /// Groups of the part, where their visibility is kept per vertex.
    pub groups: usize,
    /// Per vertex and group the seen part, 0 to 255.
    pub soft: Vec<u8>,
}

/// Orders for one surface.
struct Request {
    surface: Arc<Surface>,
    orders: Vec<Order>,
}

#[derive(Default)]
struct State {
    request: Option<Request>,
    done: Vec<Baked>,
    working: bool,
    quit: bool,
}

/// Called when something is done.
type Waker = Box<dyn Fn() + Send>;

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    waker: Mutex<Option<Waker>>,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The background thread.
pub(super) struct Baker {
    shared: Arc<Shared>,
}

impl Baker {
    /// Starts the thread.
    pub(super) fn new() -> Result<Self, RenderError> {
        let shared = Arc::new(Shared::default());
        let theirs = Arc::clone(&shared);
        std::thread::Builder::new()
            .name("light-baker".to_owned())
            .spawn(move || work(&theirs))
            .map(drop)
            .map_err(|e| RenderError::Refused {
                what: "a thread for baking light".to_owned(),
                reason: e.to_string(),
            })?;
        Ok(Self { shared })
    }

    /// What to call when something is done.
    pub(super) fn set_waker(&self, waker: Waker) {
        *self
            .shared
            .waker
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some(waker);
    }

    /// Replaces what is still to be done.
    pub(super) fn request(&self, surface: &Arc<Surface>, orders: Vec<Order>) {
        self.shared.state().request = Some(Request {
            surface: Arc::clone(surface),
            orders,
        });
        self.shared.changed.notify_all();
    }

    /// What has been done since the last call.
    pub(super) fn take(&self) -> Vec<Baked> {
        std::mem::take(&mut self.shared.state().done)
    }

    /// Whether something can be taken.
    pub(super) fn has_results(&self) -> bool {
        !self.shared.state().done.is_empty()
    }

    /// Waits until everything asked for is done.
    pub(super) fn wait(&self) {
        let mut state = self.shared.state();
        while state.request.is_some() || state.working {
            state = self
                .shared
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl Drop for Baker {
    fn drop(&mut self) {
        self.shared.state().quit = true;
        self.shared.changed.notify_all();
        // The thread ends by itself after the part in work: nobody should wait for that.
    }
}

fn work(shared: &Shared) {
    // What came out since the last request was taken, so that a request made meanwhile doesn't ask for it again: its
    // number and whether it was a draft.
    let mut last: Vec<(u64, bool)> = Vec::new();
    loop {
        let mut state = shared.state();
        state.working = false;
        shared.changed.notify_all();
        let request = loop {
            if state.quit {
                return;
            }
            if let Some(request) = state.request.take() {
                state.working = true;
                break request;
            }
            state = shared
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        };
        drop(state);
        let mut finished = Vec::new();
        // Drafts of everything first.
        let drafts = request.orders.iter().filter(|o| !o.lamp).map(|o| (o, true));
        let exact = request
            .orders
            .iter()
            .filter(|o| !o.draft)
            .map(|o| (o, false));
        for (order, draft) in drafts.chain(exact) {
            if last
                .iter()
                .any(|&(id, was_draft)| id == order.id && (draft || !was_draft))
            {
                continue;
            }
            let stale = {
                let state = shared.state();
                state.quit || state.request.is_some()
            };
            if stale {
                break;
            }
            let surface = &request.surface;
            let baked = if order.lamp {
                bake_lamp(surface, order)
            } else {
                bake_soft(surface, order, draft)
            };
            finished.push((order.id, draft));
            shared.state().done.push(baked);
            if let Some(wake) = &*shared.waker.lock().unwrap_or_else(PoisonError::into_inner) {
                wake();
            }
        }
        last = finished;
    }
}

/// Irradiance of the light atlas' texels, without interreflection.
fn direct_irradiance(surface: &Surface, shader: &Shader) -> Vec<Vec3> {
    let (scene, atlas) = (surface.scene(), &surface.light_atlas);
    let triangles = TriangleShares::new(scene.mesh, atlas, shader);
    texel_irradiance(&scene, atlas, shader, &triangles)
}

/// Bakes a lamp.
fn bake_lamp(surface: &Surface, order: &Order) -> Baked {
    let shader = Shader::new(&surface.occluder, surface.solution.brdf, &order.shape);
    let direct = direct_irradiance(surface, &shader);
    let visibility = if shader.groups() > 0 {
        seen_part(surface, &shader, &direct)
    } else {
        vec![0; surface.light_atlas.len()]
    };
    Baked {
        id: order.id,
        draft: false,
        irradiance: finished(surface, &shader, &direct),
        visibility,
        groups: 0,
        soft: Vec::new(),
    }
}

/// Bakes a part that is no lamp. Its draft is interpolated between the vertices and has no interreflection.
fn bake_soft(surface: &Surface, order: &Order, draft: bool) -> Baked {
    let brdf = surface.solution.brdf;
    let groups = Shader::new(&surface.occluder, brdf, &order.shape).groups();
    let shader = Shader::new(&surface.occluder, brdf, &for_irradiance(&order.shape));
    let (soft, at_vertices) = at_vertices(surface, &shader);
    let irradiance = if draft {
        interpolated(surface, &at_vertices)
    } else {
        finished(surface, &shader, &direct_irradiance(surface, &shader))
    };
    // Merging keeps the groups; were it not so, the visibilities would be of others.
    let kept = shader.groups() == groups;
    Baked {
        id: order.id,
        draft,
        irradiance,
        visibility: Vec::new(),
        groups: if kept { groups } else { 0 },
        soft: if kept { soft } else { Vec::new() },
    }
}

/// The same light with fewer nodes: within a patch those close together are one, so much weaker that the sum of flux ×
/// direction stays, on which irradiance depends as long as all of it is above the horizon.
fn for_irradiance(shape: &Lighting) -> Lighting {
    let mut merged = shape.clone();
    let strength = |patch: &LampNodes| patch.flux().element_sum();
    let total: f32 = shape.environment_lamps().map(strength).sum();
    for patch in (merged.environment.iter_mut()).flat_map(|e| &mut e.patches) {
        // The shadow of a bright patch has an edge, in which every node shows.
        if strength(patch) > BRIGHT * total {
            continue;
        }
        let sources = patch
            .nodes
            .iter()
            .map(|n| Source {
                direction: n.direction,
                flux: n.flux(),
                group: 0,
            })
            .collect();
        let few: Vec<LightNode> = merge(sources, PATCH_SPREAD, usize::MAX)
            .into_iter()
            .map(|lobe| LightNode {
                direction: lobe.direction,
                // |mean direction|² = 1 − variance, which is twice the spread per axis.
                radiance: lobe.flux * (1.0 - 2.0 * lobe.spread).max(0.0).sqrt(),
                solid_angle: 1.0,
            })
            .collect();
        if few.len() + PATCH_RAYS < patch.nodes.len() {
            patch.nodes = with_rays(few, &patch.nodes);
        }
    }
    merged
}

/// Merged nodes with those among them, all but dark, to which rays are cast: the same as without merging. A patch's rays
/// go to every quarter of its list.
fn with_rays(merged: Vec<LightNode>, all: &[LightNode]) -> Vec<LightNode> {
    let count = merged.len() + PATCH_RAYS;
    let mut merged = merged.into_iter();
    let mut nodes: Vec<LightNode> = Vec::with_capacity(count);
    for ray in 0..PATCH_RAYS {
        let target = all[ray * all.len() / PATCH_RAYS];
        nodes.push(LightNode {
            radiance: target.radiance * 1e-9,
            ..target
        });
        let next = (ray + 1) * count / PATCH_RAYS;
        nodes.extend(merged.by_ref().take(next - nodes.len()));
    }
    nodes
}

/// Irradiance as the device stores it: interreflection added, in the device's units.
fn finished(surface: &Surface, shader: &Shader, direct: &[Vec3]) -> Vec<[f16; 4]> {
    let solution = &surface.solution;
    let (mesh, atlas) = (&solution.mesh, &surface.light_atlas);
    let mut irradiance: Vec<[f32; 3]> = direct.iter().map(Vec3::to_array).collect();
    if let Some(interreflection) = surface.interreflection() {
        let relit = interreflection.of_light(mesh, shader, &solution.atlas, &solution.albedo);
        let added: Vec<Vec3> = atlas
            .texels
            .par_iter()
            .map(|t| relit.indirect.at(mesh, t.triangle, t.barycentric))
            .collect();
        for (texel, added) in atlas.texels.iter().zip(added) {
            let sum = Vec3::from(irradiance[texel.index as usize]) + added;
            irradiance[texel.index as usize] = sum.to_array();
        }
    }
    atlas.extend(&mut irradiance);
    in_device_units(surface, &irradiance)
}

/// By a flux of 1 in the capture's units, irradiance on the device is per unit of radiance there.
fn in_device_units(surface: &Surface, irradiance: &[[f32; 3]]) -> Vec<[f16; 4]> {
    irradiance
        .par_iter()
        .map(|&e| to_half(Vec3::from(e) * surface.albedo_unit, 0.0))
        .collect()
}

/// Irradiance of the vertices, interpolated over every triangle.
fn interpolated(surface: &Surface, at_vertices: &[Vec3]) -> Vec<[f16; 4]> {
    let (mesh, atlas) = (&surface.solution.mesh, &surface.light_atlas);
    let values: Vec<Vec3> = atlas
        .texels
        .par_iter()
        .map(|t| {
            let [a, b, c] = mesh.triangles[t.triangle as usize].map(|v| at_vertices[v as usize]);
            a + (b - a) * t.barycentric.x + (c - a) * t.barycentric.y
        })
        .collect();
    let mut irradiance = vec![[0.0; 3]; atlas.len()];
    for (texel, value) in atlas.texels.iter().zip(values) {
        irradiance[texel.index as usize] = value.to_array();
    }
    in_device_units(surface, &irradiance)
}

/// Part of a lamp's irradiance that arrives, per texel, of what would if nothing were in the way.
fn seen_part(surface: &Surface, shader: &Shader, direct: &[Vec3]) -> Vec<u8> {
    let atlas = &surface.light_atlas;
    let all = vec![Visibility::Whole; shader.groups()];
    let parts: Vec<f32> = atlas
        .texels
        .par_iter()
        .map(|texel| {
            let point = ShadingPoint::on(&surface.solution.mesh, texel.triangle, texel.barycentric);
            let whole = shader.irradiance(&point, &all).element_sum();
            let arrives = direct[texel.index as usize].element_sum();
            if whole > 0.0 { arrives / whole } else { 0.0 }
        })
        .collect();
    let mut seen = vec![[0.0; 3]; atlas.len()];
    for (texel, part) in atlas.texels.iter().zip(parts) {
        seen[texel.index as usize] = [part; 3];
    }
    atlas.extend(&mut seen);
    seen.par_iter().map(|s| to_byte(s[0])).collect()
}

/// Per vertex and group the seen part, and every vertex's irradiance.
fn at_vertices(surface: &Surface, shader: &Shader) -> (Vec<u8>, Vec<Vec3>) {
    let mesh = &surface.solution.mesh;
    let found: Vec<(Vec<u8>, Vec3)> = (0..mesh.positions.len())
        .into_par_iter()
        .map(|v| {
            let point = ShadingPoint::smooth(mesh.positions[v], mesh.normals[v]);
            let shares = shader.seen_shares(&point);
            // A group below the horizon lights no neighbour that would ask.
            let part = |share: &Option<f32>| share.map_or(255, to_byte);
            (
                shares.iter().map(part).collect(),
                shader.irradiance_of_shares(&point, &shares),
            )
        })
        .collect();
    let irradiance = found.iter().map(|f| f.1).collect();
    (found.into_iter().flat_map(|f| f.0).collect(), irradiance)
}

fn to_byte(part: f32) -> u8 {
    (part.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}
