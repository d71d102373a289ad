//! Light baked in the background with the reference renderer's own code: irradiance and visibility of one part of the light.
//!
//! One thread works through the newest request. A part that is done goes back at once; a newer request takes effect when
//! the part in work is done.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use glam::Vec3;
use half::f16;
use rayon::prelude::*;

use super::error::RenderError;
use super::surface::{Surface, to_half};
use crate::relight::{Lighting, Shader, ShadingPoint, Visibility, texel_irradiance};

/// A part of the light to be baked.
#[derive(Clone)]
pub(super) struct Order {
    /// Comes back with the result.
    pub id: u64,
    /// The part with unit flux.
    pub shape: Lighting,
    /// Whether its visibility is that of one lamp, to be kept per texel.
    pub lamp: bool,
}

/// A baked part of the light.
pub(super) struct Baked {
    /// That of the order.
    pub id: u64,
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
    thread: Option<JoinHandle<()>>,
}

impl Baker {
    /// Starts the thread.
    pub(super) fn new() -> Result<Self, RenderError> {
        let shared = Arc::new(Shared::default());
        let theirs = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("light-baker".to_owned())
            .spawn(move || work(&theirs))
            .map_err(|e| RenderError::Refused {
                what: "a thread for baking light".to_owned(),
                reason: e.to_string(),
            })?;
        Ok(Self {
            shared,
            thread: Some(thread),
        })
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
        if let Some(thread) = self.thread.take() {
            // A panic in there has been reported already.
            let _ = thread.join();
        }
    }
}

fn work(shared: &Shared) {
    // What came out since the last request was taken, so that a request made meanwhile doesn't ask for it again.
    let mut last: Vec<u64> = Vec::new();
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
        for order in request
            .orders
            .iter()
            .filter(|order| !last.contains(&order.id))
        {
            let stale = {
                let state = shared.state();
                state.quit || state.request.is_some()
            };
            if stale {
                break;
            }
            let baked = bake(&request.surface, order);
            finished.push(order.id);
            shared.state().done.push(baked);
            if let Some(wake) = &*shared.waker.lock().unwrap_or_else(PoisonError::into_inner) {
                wake();
            }
        }
        last = finished;
    }
}

/// Bakes a part of the light.
fn bake(surface: &Surface, order: &Order) -> Baked {
    let solution = &surface.solution;
    let (mesh, atlas) = (&solution.mesh, &surface.light_atlas);
    let shader = Shader::new(&surface.occluder, solution.brdf, &order.shape);
    let scene = surface.scene(None);
    let direct = texel_irradiance(&scene, atlas, &shader);
    let visibility = if order.lamp && shader.groups() == 1 {
        seen_part(surface, &shader, &direct)
    } else {
        Vec::new()
    };
    let mut irradiance: Vec<[f32; 3]> = direct.iter().map(Vec3::to_array).collect();
    if let Some(interreflection) = surface.interreflection() {
        let relit = interreflection.of_light(mesh, &shader, &solution.atlas, &solution.albedo);
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
    // By a flux of 1 in the capture's units, irradiance on the device is per unit of radiance there.
    let scale = surface.albedo_unit;
    let groups = if order.lamp { 0 } else { shader.groups() };
    Baked {
        id: order.id,
        irradiance: irradiance
            .par_iter()
            .map(|&e| to_half(Vec3::from(e) * scale, 0.0))
            .collect(),
        visibility,
        groups,
        soft: soft_visibility(surface, &shader, groups),
    }
}

/// Part of a lamp's irradiance that arrives, per texel, of what would if nothing were in the way.
fn seen_part(surface: &Surface, shader: &Shader, direct: &[Vec3]) -> Vec<u8> {
    let atlas = &surface.light_atlas;
    let parts: Vec<f32> = atlas
        .texels
        .par_iter()
        .map(|texel| {
            let point = ShadingPoint::on(&surface.solution.mesh, texel.triangle, texel.barycentric);
            let whole = shader
                .irradiance(&point, &[Visibility::Whole])
                .element_sum();
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

/// Per vertex and group the seen part.
fn soft_visibility(surface: &Surface, shader: &Shader, groups: usize) -> Vec<u8> {
    let mesh = &surface.solution.mesh;
    if groups == 0 {
        return Vec::new();
    }
    (0..mesh.positions.len())
        .into_par_iter()
        .flat_map_iter(|v| {
            let point = ShadingPoint {
                position: mesh.positions[v],
                normal: mesh.normals[v],
                face_normal: mesh.normals[v],
            };
            (0..groups).map(move |group| to_byte(shader.seen_share(&point, group).unwrap_or(1.0)))
        })
        .collect()
}

fn to_byte(part: f32) -> u8 {
    (part.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}
