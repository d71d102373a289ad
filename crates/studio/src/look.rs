//! A look: one whole lighting set-up, as the renderers take it and as a list of edits.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{Quat, Vec3};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::group::{Group, solo};
use super::lamp::{Baseline, Lamp, LampId, Origin};
use rekindle_relight::{Environment, LatLong, Lighting, ProbeUnits};

/// Lamps whose directions' cosine is above this can't be told apart by `near` in an edit.
const SAME_PLACE: f32 = 1.0 - 1e-6;

/// A light probe around the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Probe {
    /// The picture's file.
    pub file: PathBuf,
    /// Turn about the hemisphere's pole, radians, counter-clockwise seen from the pole.
    pub rotation: f32,
    /// How bright the picture is taken to be; older projects took all in the solution's units.
    #[serde(default = "solution_units")]
    pub units: ProbeUnits,
    /// Brightness in stops beyond that.
    pub stops: f32,
}

fn solution_units() -> ProbeUnits {
    ProbeUnits::Solution
}

/// A light probe's picture, ready to shine.
#[derive(Debug)]
pub struct ProbeLight {
    file: PathBuf,
    picture: LatLong,
    /// As it is, at the picture's own brightness; none where the picture is dark.
    environment: Option<Environment>,
    /// Radiance over all directions.
    flux: Vec3,
}

/// A lighting set-up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Look {
    /// What people call it.
    pub name: String,
    /// Whether it is the captured light, which is kept as it is.
    #[serde(default)]
    pub captured: bool,
    /// In the order of the list.
    pub lamps: Vec<Lamp>,
    /// Lamps that are set together. Projects of before there were groups have none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub groups: Vec<Group>,
    /// The only lamps that shine, if some are chosen so: all others, light that belongs to no lamp and the probe rest. In order.
    #[serde(default, with = "solo")]
    pub solo: Vec<LampId>,
    /// Whether light of the estimate that belongs to no lamp shines.
    pub remainder: bool,
    /// Factor of the ambient part.
    pub ambient: f32,
    /// What surrounds the object.
    pub probe: Option<Probe>,
}

/// A look as light, with the lamp of the document for each of the lighting's lamps.
#[derive(Clone, Debug)]
pub struct LitLook {
    /// For the renderers. Muted lamps are in it, marked so.
    pub lighting: Lighting,
    /// One for each lamp of the lighting, in its order.
    pub lamps: Vec<LampId>,
}

impl ProbeLight {
    /// Reads an EXR or Radiance HDR picture. The error is a whole sentence that names the file.
    pub fn load(file: &Path) -> Result<Arc<Self>, String> {
        let picture = LatLong::load(file)?;
        Ok(Arc::new(Self {
            file: file.to_owned(),
            environment: picture.environment(Quat::IDENTITY, Vec3::ONE),
            flux: picture.flux(),
            picture,
        }))
    }

    /// The picture's file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Radiance from a unit direction, turned about the pole of the captured lighting and dimmed.
    pub fn radiance(&self, probe: &Probe, captured: &Lighting, direction: Vec3) -> Vec3 {
        let back = Quat::from_axis_angle(captured.up, -probe.rotation);
        self.picture.radiance(back * direction) * self.gain(probe, captured)
    }

    /// Factor of the picture's radiances.
    fn gain(&self, probe: &Probe, captured: &Lighting) -> Vec3 {
        captured.probe_gain(probe.units, self.flux) * probe.stops.exp2()
    }

    /// Its light, turned about the pole of the captured lighting and dimmed.
    fn light(&self, probe: &Probe, captured: &Lighting) -> Option<Environment> {
        let turn = Quat::from_axis_angle(captured.up, probe.rotation);
        let environment = self.environment.as_ref()?;
        Some(environment.turned(turn, self.gain(probe, captured)))
    }
}

impl Look {
    /// The captured lighting; lamps are numbered from `first`.
    pub fn of_capture(base: &Baseline, first: u32) -> Self {
        let lamps = (0..base.lamps.len())
            .map(|i| base.estimated(LampId(first + i as u32), i))
            .collect();
        Self {
            name: "Captured light".to_owned(),
            captured: true,
            lamps,
            groups: Vec::new(),
            solo: Vec::new(),
            remainder: true,
            ambient: 1.0,
            probe: None,
        }
    }

    /// Whether it is the captured lighting, unchanged.
    pub(super) fn is_as_captured(&self, base: &Baseline) -> bool {
        let captured = Self::of_capture(base, 0);
        let same = |(a, b): (&Lamp, &Lamp)| {
            *b == Lamp {
                id: b.id,
                ..a.clone()
            }
        };
        self.lamps.len() == captured.lamps.len()
            && self.lamps.iter().zip(&captured.lamps).all(same)
            && (&self.solo, self.remainder, self.ambient)
                == (&captured.solo, captured.remainder, captured.ambient)
            && self.probe.is_none()
    }

    /// The lamp of this id.
    pub fn lamp(&self, id: LampId) -> Option<&Lamp> {
        self.lamps.iter().find(|l| l.id == id)
    }

    /// The lamp of this id, to be changed.
    pub fn lamp_mut(&mut self, id: LampId) -> Option<&mut Lamp> {
        self.lamps.iter_mut().find(|l| l.id == id)
    }

    /// Removes a lamp, and its group if it was the last in there.
    pub fn delete(&mut self, id: LampId) {
        self.lamps.retain(|l| l.id != id);
        self.solo.retain(|other| *other != id);
        self.forget_empty_groups();
    }

    /// Leaves only these lamps on, or ends that.
    pub fn toggle_solo(&mut self, lamps: &[LampId]) {
        let mut lamps = lamps.to_vec();
        lamps.sort_unstable();
        self.solo = if self.solo == lamps {
            Vec::new()
        } else {
            lamps
        };
    }

    /// Puts a light probe in the place of everything that shines.
    pub fn replace_by_probe(&mut self, file: PathBuf) {
        for lamp in &mut self.lamps {
            lamp.muted = true;
        }
        self.solo.clear();
        self.remainder = false;
        self.ambient = 0.0;
        self.probe = Some(Probe {
            file,
            rotation: 0.0,
            units: ProbeUnits::default(),
            stops: 0.0,
        });
    }

    /// Whether a lamp sends no light in this look.
    pub fn is_dark(&self, lamp: &Lamp) -> bool {
        if self.solo.is_empty() {
            self.as_lit(lamp).muted
        } else {
            !self.solo.contains(&lamp.id)
        }
    }

    /// The look as light. `probe` is the one that the look names; without it there is none.
    pub fn light(&self, base: &Baseline, probe: Option<&ProbeLight>) -> LitLook {
        let lit = &base.lighting;
        let environment = match (&self.probe, probe) {
            (Some(set), Some(light)) if self.solo.is_empty() => light.light(set, lit),
            _ => None,
        };
        LitLook {
            lamps: self.lamps.iter().map(|l| l.id).collect(),
            lighting: Lighting {
                lamps: self
                    .lamps
                    .iter()
                    .map(|lamp| base.nodes(&self.as_lit(lamp), self.is_dark(lamp)))
                    .collect(),
                remainder: if self.remainder && self.solo.is_empty() {
                    lit.remainder.clone()
                } else {
                    Vec::new()
                },
                environment,
                ambient: lit.ambient * self.ambient,
                ..*lit
            },
        }
    }

    /// The look as the entries of an `edits.json`, for a solution's light. The probe's file is named as it is. Edits know no
    /// groups: what these add is in the lamps.
    pub fn edits(&self, base: &Baseline) -> Vec<Value> {
        self.plain().edits_of_lamps(base)
    }

    /// The edits of a look without groups, with a solo of one lamp at most.
    fn edits_of_lamps(&self, base: &Baseline) -> Vec<Value> {
        let mut edits = Vec::new();
        let kept: Vec<Option<&Lamp>> = (0..base.lamps.len())
            .map(|i| {
                let is_kept =
                    |l: &&Lamp| l.origin == Origin::Estimated(i) && l.angular_radius.is_none();
                self.lamps.iter().find(is_kept)
            })
            .collect();
        let solo = self.solo.first().and_then(|id| self.lamp(*id));
        let solo_kept = solo.filter(|lamp| kept.contains(&Some(*lamp)));
        if let Some(near) = solo_kept.and_then(|lamp| base.own_direction(lamp)) {
            edits.push(json!({ "solo": { "near": near.to_array() } }));
        } else {
            for (own, _) in base
                .lamps
                .iter()
                .zip(&kept)
                .filter(|(_, lamp)| lamp.is_none() || solo.is_some())
            {
                edits.push(json!({ "delete": { "near": own.direction.to_array() } }));
            }
        }
        let mut moves = Vec::new();
        let wanted = |lamp: &&Lamp| solo.is_none_or(|s| s.id == lamp.id);
        for lamp in kept.iter().flatten().copied().filter(wanted) {
            let Some(near) = base.own_direction(lamp) else {
                continue;
            };
            let gain = base.gain(lamp);
            if gain != Vec3::ONE {
                edits.push(json!({ "gain": { "near": near.to_array(), "rgb": gain.to_array() } }));
            }
            if lamp.muted && solo.is_none() {
                edits.push(json!({ "mute": { "near": near.to_array() } }));
            }
            if lamp.direction != near {
                moves.push((near, lamp.direction));
            }
        }
        for (near, to) in ordered(moves, base) {
            edits.push(json!({ "move": { "near": near.to_array(), "to": to.to_array() } }));
        }
        self.push_surroundings(&mut edits);
        self.push_discs(base, &kept, solo, &mut edits);
        edits
    }

    fn push_surroundings(&self, edits: &mut Vec<Value>) {
        if !self.remainder && self.solo.is_empty() {
            edits.push(json!({ "remainder": { "gain": 0.0 } }));
        }
        if let Some(probe) = self.probe.as_ref().filter(|_| self.solo.is_empty()) {
            edits.push(json!({ "environment": {
                "file": probe.file,
                "rotation_deg": probe.rotation.to_degrees(),
                "units": probe.units,
                "gain": probe.stops.exp2(),
            } }));
        }
        if self.ambient != 1.0 {
            edits.push(json!({ "ambient": { "gain": self.ambient } }));
        }
    }

    /// Lamps that are discs now. Dark ones are left out: they send no light.
    fn push_discs(
        &self,
        base: &Baseline,
        kept: &[Option<&Lamp>],
        solo: Option<&Lamp>,
        edits: &mut Vec<Value>,
    ) {
        let discs = self
            .lamps
            .iter()
            .filter(|l| !kept.contains(&Some(*l)) && !self.is_dark(l));
        for lamp in discs {
            edits.push(json!({ "add": {
                "direction": lamp.direction.to_array(),
                "flux": base.flux(lamp).to_array(),
                "angular_radius_deg": base.angular_radius(lamp).to_degrees(),
            } }));
            if solo.is_some() {
                edits.push(json!({ "solo": { "near": lamp.direction.to_array() } }));
            }
        }
    }
}

/// Moves in an order in which every lamp is alone where `near` looks for it. Lamps that change places in a circle need one
/// of them parked on its way; two turns about one axis are one turn.
fn ordered(mut moves: Vec<(Vec3, Vec3)>, base: &Baseline) -> Vec<(Vec3, Vec3)> {
    let meet = |a: Vec3, b: Vec3| a.dot(b) > SAME_PLACE;
    let mut done = Vec::with_capacity(moves.len());
    while !moves.is_empty() {
        let free = (0..moves.len()).find(|&i| {
            let others = (0..moves.len()).filter(|&j| j != i);
            others.into_iter().all(|j| !meet(moves[i].1, moves[j].0))
        });
        if let Some(free) = free {
            done.push(moves.remove(free));
            continue;
        }
        let (from, to) = moves[0];
        let arc = Quat::from_rotation_arc(from, to);
        let parked = (1..32)
            .map(|k| Quat::IDENTITY.slerp(arc, k as f32 / 32.0) * from)
            .find(|&place| {
                let taken = moves.iter().flat_map(|&(a, b)| [a, b]);
                let stand = base.lamps.iter().map(|l| l.direction);
                taken.chain(stand).all(|d| !meet(place, d))
            })
            .unwrap_or(to);
        done.push((from, parked));
        moves[0].0 = parked;
    }
    done
}
