//! The document: a solution and what an artist makes of its light, with undo.
//!
//! Everything that can be undone is one [`State`]. A step of the history is the state before it, behind an `Arc`: states are
//! small (numbers, no pictures), so nothing needs to know how to reverse itself. A drag is one step from
//! [`Document::begin`] to [`Document::commit`].

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::group::GroupId;
use super::lamp::{Baseline, LampId};
use super::look::{LitLook, Look, Probe, ProbeLight};
use rekindle_solution::Solution;

/// What looks and groups that nobody has named yet are called, with a number.
const SETUP: &str = "Setup";
const GROUP: &str = "Group";
/// Steps that can be undone.
const MAX_STEPS: usize = 500;

/// What can be undone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// At least one.
    pub looks: Vec<Look>,
    /// Index of the look that is shown.
    pub active: usize,
    /// Number of the next lamp.
    pub next_lamp: u32,
}

/// A state that can be returned to.
#[derive(Clone, Debug)]
struct Step {
    /// What was done, as the menu says it.
    label: String,
    state: Arc<State>,
}

/// An opened solution being relit.
pub struct Document {
    pub(super) solution: Arc<Solution>,
    base: Arc<Baseline>,
    state: Arc<State>,
    undo: VecDeque<Step>,
    redo: Vec<Step>,
    /// A drag that is under way: the state before it.
    gesture: Option<Step>,
    /// The state that the project file has.
    saved: Option<Arc<State>>,
    /// Folder of the solution, once it has one.
    pub(super) source: Option<PathBuf>,
    /// The project file, once there is one.
    pub(super) project: Option<PathBuf>,
    /// The capture that it was estimated from, where that is known.
    pub capture: Option<PathBuf>,
    probes: BTreeMap<PathBuf, Arc<ProbeLight>>,
    /// Camera and whatever else of the view is to be kept; not undone, no change worth a question.
    pub view: Value,
    revision: u64,
}

impl State {
    /// One look with the captured lighting.
    pub fn new(base: &Baseline) -> Self {
        Self {
            looks: vec![Look::of_capture(base, 0)],
            active: 0,
            next_lamp: base.lamps.len() as u32,
        }
    }

    /// The look that is shown.
    pub fn look(&self) -> &Look {
        &self.looks[self.active]
    }

    /// The look that is shown, to be changed.
    pub fn look_mut(&mut self) -> &mut Look {
        &mut self.looks[self.active]
    }

    fn new_id(&mut self) -> LampId {
        let id = LampId(self.next_lamp);
        self.next_lamp = self.next_lamp.saturating_add(1);
        id
    }

    /// Adds a lamp to the look that is shown.
    pub fn add_lamp(&mut self, base: &Baseline, direction: Vec3) -> LampId {
        let id = self.new_id();
        let name = free_name("Light", self.look().lamps.iter().map(|l| l.name.as_str()));
        self.look_mut().lamps.push(base.added(id, name, direction));
        id
    }

    /// Puts a copy of a lamp below it.
    pub fn duplicate_lamp(&mut self, base: &Baseline, id: LampId) -> Option<LampId> {
        let at = self.look().lamps.iter().position(|l| l.id == id)?;
        let copy = self.new_id();
        let lamp = &self.look().lamps[at];
        let name = copy_name(
            &lamp.name,
            self.look().lamps.iter().map(|l| l.name.as_str()),
        );
        let lamp = base.duplicate(lamp, copy, name);
        self.look_mut().lamps.insert(at + 1, lamp);
        Some(copy)
    }

    /// Makes a group of lamps of the look that is shown; none without any. They shine as before.
    pub fn group_lamps(&mut self, lamps: &[LampId]) -> Option<GroupId> {
        let name = free_name(GROUP, self.look().groups.iter().map(|g| g.name.as_str()));
        self.look_mut().add_group(name, lamps)
    }

    /// Adds a look with the captured lighting and shows it.
    pub fn add_look(&mut self, base: &Baseline) {
        let mut look = Look::of_capture(base, self.next_lamp);
        self.next_lamp = self.next_lamp.saturating_add(base.lamps.len() as u32);
        look.captured = false;
        look.name = free_name(SETUP, self.looks.iter().map(|l| l.name.as_str()));
        self.push_look(look);
    }

    /// Puts a look at the end and shows it; a number is added to its name where another has that.
    pub(super) fn push_look(&mut self, mut look: Look) {
        look.name = numbered_name(&look.name, self.looks.iter().map(|l| l.name.as_str()));
        self.looks.push(look);
        self.active = self.looks.len() - 1;
    }

    /// Index of the look that holds the captured light.
    pub fn captured(&self) -> Option<usize> {
        self.looks.iter().position(|look| look.captured)
    }

    /// Keeps the captured light as it was `before`: what was made of it becomes a look of its own.
    fn protect_captured(&mut self, before: &Self) {
        let Some(at) = self.captured() else { return };
        let Some(kept) = before.captured().map(|at| &before.looks[at]) else {
            return;
        };
        if self.looks[at] == *kept {
            return;
        }
        let mut changed = std::mem::replace(&mut self.looks[at], kept.clone());
        changed.captured = false;
        changed.name = free_name(SETUP, self.looks.iter().map(|l| l.name.as_str()));
        self.looks.push(changed);
        if self.active == at {
            self.active = self.looks.len() - 1;
        }
    }

    /// Puts a copy of a look after it and shows it. Its lamps keep their numbers: they are the same lamps, otherwise set.
    pub fn duplicate_look(&mut self, index: usize) {
        let Some(look) = self.looks.get(index) else {
            return;
        };
        let mut copy = look.clone();
        copy.captured = false;
        copy.name = copy_name(&copy.name, self.looks.iter().map(|l| l.name.as_str()));
        self.looks.insert(index + 1, copy);
        self.active = index + 1;
    }

    /// Removes a look. The captured light stays, and so does the last one.
    pub fn delete_look(&mut self, index: usize) {
        let goes = self.looks.get(index).is_some_and(|look| !look.captured);
        if goes && self.looks.len() > 1 {
            self.looks.remove(index);
            if self.active > index || self.active == self.looks.len() {
                self.active -= 1;
            }
        }
    }

    /// Whether everything in it makes sense for a solution's light, with numbers held in their bounds.
    pub(super) fn checked(mut self, base: &Baseline) -> Result<Self, String> {
        if self.active >= self.looks.len() {
            return Err("the setup that is shown is not among its setups".to_owned());
        }
        for look in &mut self.looks {
            let named = |what: &str| format!("setup \"{}\" {what}", look.name);
            if !(look.ambient.is_finite() && look.ambient >= 0.0) {
                return Err(named("has an ambient part that is negative or not finite"));
            }
            if let Some(probe) = &look.probe
                && !(probe.rotation.is_finite() && probe.stops.is_finite())
            {
                return Err(named("has a light probe whose numbers are not finite"));
            }
            let mut lamps = Vec::with_capacity(look.lamps.len());
            for lamp in std::mem::take(&mut look.lamps) {
                if lamp.id.0 >= self.next_lamp {
                    return Err(format!("lamp \"{}\" has a number never given", lamp.name));
                }
                let other = match lamp.origin {
                    super::lamp::Origin::Estimated(index) => index >= base.lamps.len(),
                    super::lamp::Origin::Added(_) => false,
                };
                if other {
                    return Err(format!(
                        "lamp \"{}\" is none of the solution's; the solution is another than the project was made with",
                        lamp.name
                    ));
                }
                if lamps.iter().any(|l: &super::lamp::Lamp| l.id == lamp.id) {
                    return Err(format!("lamp \"{}\" has the number of another", lamp.name));
                }
                let name = lamp.name.clone();
                lamps.push(
                    lamp.checked().ok_or_else(|| {
                        format!("lamp \"{name}\" has numbers that are not finite")
                    })?,
                );
            }
            look.lamps = lamps;
            let mut solo = std::mem::take(&mut look.solo);
            solo.retain(|id| look.lamp(*id).is_some());
            solo.sort_unstable();
            solo.dedup();
            look.solo = solo;
            look.check_groups()?;
        }
        self.ensure_captured(base);
        Ok(self)
    }

    /// Makes sure that one look, and only one, holds the captured light as it is; projects of before it was kept so may have
    /// none, or have changed it.
    fn ensure_captured(&mut self, base: &Baseline) {
        let unchanged = |look: &Look| look.is_as_captured(base);
        let looks = self.looks.iter();
        let marked = looks.clone().position(|l| l.captured && unchanged(l));
        let at = marked.or_else(|| looks.clone().position(unchanged));
        let at = at.unwrap_or_else(|| {
            self.looks.insert(0, Look::of_capture(base, 0));
            self.active += 1;
            self.next_lamp = self.next_lamp.max(base.lamps.len() as u32);
            0
        });
        for (i, look) in self.looks.iter_mut().enumerate() {
            look.captured = i == at;
        }
    }
}

impl Document {
    /// A document of a solution as it was estimated. `folder` is where the solution was read from; without one it has yet
    /// to be saved.
    pub fn new(solution: Arc<Solution>, folder: Option<PathBuf>) -> Self {
        let base = Arc::new(Baseline::new(&solution));
        let state = Arc::new(State::new(&base));
        Self {
            saved: folder.is_some().then(|| Arc::clone(&state)),
            solution,
            base,
            state,
            undo: VecDeque::new(),
            redo: Vec::new(),
            gesture: None,
            source: folder,
            project: None,
            capture: None,
            probes: BTreeMap::new(),
            view: Value::Null,
            revision: 0,
        }
    }

    /// A document in a known state.
    pub(super) fn restored(mut self, state: State, saved: bool) -> Self {
        self.state = Arc::new(state);
        self.saved = saved.then(|| Arc::clone(&self.state));
        self
    }

    /// What was solved.
    pub fn solution(&self) -> &Arc<Solution> {
        &self.solution
    }

    /// The captured lighting.
    pub fn base(&self) -> &Arc<Baseline> {
        &self.base
    }

    /// Looks and lamps as they are now.
    pub fn state(&self) -> &Arc<State> {
        &self.state
    }

    /// The look that is shown.
    pub fn look(&self) -> &Look {
        self.state.look()
    }

    /// Grows whenever looks or lamps change.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// The project file, once there is one.
    pub fn project(&self) -> Option<&Path> {
        self.project.as_deref()
    }

    /// What to call the document: the project's name, otherwise the capture's.
    pub fn name(&self) -> String {
        let stem = self.project.as_deref().and_then(Path::file_stem);
        stem.map_or_else(
            || self.solution.name.clone(),
            |s| s.to_string_lossy().into_owned(),
        )
    }

    /// The look that is shown, as light.
    pub fn light(&self) -> LitLook {
        self.light_of(self.look())
    }

    /// A look as light.
    pub fn light_of(&self, look: &Look) -> LitLook {
        let probe = look.probe.as_ref().and_then(|p| self.probes.get(&p.file));
        look.light(&self.base, probe.map(AsRef::as_ref))
    }

    /// The probe that surrounds the object in the look that is shown.
    pub fn surroundings(&self) -> Option<(&Probe, &ProbeLight)> {
        let look = self.look();
        let probe = look.probe.as_ref().filter(|_| look.solo.is_empty())?;
        Some((probe, self.probes.get(&probe.file)?))
    }

    /// Makes a probe's picture known, so that looks that name it shine.
    pub fn know_probe(&mut self, probe: Arc<ProbeLight>) {
        self.probes.insert(probe.file().to_owned(), probe);
        self.revision += 1;
    }

    fn put(&mut self, state: Arc<State>) {
        self.state = state;
        self.revision += 1;
    }

    fn remember(&mut self, step: Step) {
        if step.state != self.state {
            self.undo.push_back(step);
            self.redo.clear();
            if self.undo.len() > MAX_STEPS {
                self.undo.pop_front();
            }
        }
    }

    /// One change, one step. A drag under way ends first. Nothing is remembered where nothing changed.
    pub fn edit<T>(&mut self, label: &str, change: impl FnOnce(&mut State, &Baseline) -> T) -> T {
        self.commit();
        self.begin(label);
        let result = self.update(change);
        self.commit();
        result
    }

    /// Begins a drag, unless it is under way. Another one ends first.
    pub fn begin(&mut self, label: &str) {
        if self.gesture.as_ref().is_some_and(|g| g.label != label) {
            self.commit();
        }
        if self.gesture.is_none() {
            self.gesture = Some(Step {
                label: label.to_owned(),
                state: Arc::clone(&self.state),
            });
        }
    }

    /// Changes the state within a drag. The captured light stays as it is: the first change of it begins a look of its own.
    pub fn update<T>(&mut self, change: impl FnOnce(&mut State, &Baseline) -> T) -> T {
        let mut state = State::clone(&self.state);
        let result = change(&mut state, &self.base);
        state.protect_captured(&self.state);
        if state != *self.state {
            self.put(Arc::new(state));
        }
        result
    }

    /// Shows another look, which is no step of the history.
    pub fn show(&mut self, index: usize) {
        self.commit();
        self.update(|state, _| {
            if index < state.looks.len() {
                state.active = index;
            }
        });
    }

    /// Whether a drag is under way.
    pub fn is_dragging(&self) -> bool {
        self.gesture.is_some()
    }

    /// The state before the drag that is under way.
    pub fn before_drag(&self) -> Option<&State> {
        self.gesture.as_ref().map(|step| &*step.state)
    }

    /// Ends a drag: all of it becomes one step.
    pub fn commit(&mut self) {
        if let Some(step) = self.gesture.take() {
            self.remember(step);
        }
    }

    /// Ends a drag as if it had never begun.
    pub fn cancel(&mut self) {
        if let Some(step) = self.gesture.take() {
            self.put(step.state);
        }
    }

    /// What undo would take back.
    pub fn undo_label(&self) -> Option<&str> {
        self.undo.back().map(|s| s.label.as_str())
    }

    /// What redo would do again.
    pub fn redo_label(&self) -> Option<&str> {
        self.redo.last().map(|s| s.label.as_str())
    }

    /// What was done, the oldest first: steps that undo takes back, then those that redo does again.
    pub fn history(&self) -> (Vec<&str>, Vec<&str>) {
        let done = self.undo.iter().map(|s| s.label.as_str());
        let undone = self.redo.iter().rev().map(|s| s.label.as_str());
        (done.collect(), undone.collect())
    }

    /// Goes to the state after this many of the steps of [`Self::history`], or to the last there is.
    pub fn go_to(&mut self, steps: usize) {
        self.commit();
        while self.undo.len() > steps && self.undo().is_some() {}
        while self.undo.len() < steps && self.redo().is_some() {}
    }

    /// Takes the last step back. Returns what it was.
    pub fn undo(&mut self) -> Option<String> {
        self.commit();
        let step = self.undo.pop_back()?;
        self.redo.push(Step {
            label: step.label.clone(),
            state: Arc::clone(&self.state),
        });
        self.put(step.state);
        Some(step.label)
    }

    /// Does again what undo took back. Returns what it was.
    pub fn redo(&mut self) -> Option<String> {
        self.commit();
        let step = self.redo.pop()?;
        self.undo.push_back(Step {
            label: step.label.clone(),
            state: Arc::clone(&self.state),
        });
        self.put(step.state);
        Some(step.label)
    }

    /// Whether there is something that closing would lose: an edit, or a solve that was never saved.
    pub fn is_modified(&self) -> bool {
        self.saved.as_ref() != Some(&self.state)
    }

    /// Notes that a state is in the project file now.
    pub(super) fn note_saved(&mut self, state: Arc<State>) {
        self.saved = Some(state);
    }
}

/// The first of "Kind 1", "Kind 2" … that is not taken.
fn free_name<'a>(kind: &str, taken: impl Iterator<Item = &'a str>) -> String {
    let taken: Vec<&str> = taken.collect();
    // Among one more than are taken one is free.
    (1..=taken.len() + 1)
        .map(|i| format!("{kind} {i}"))
        .find(|name| !taken.contains(&name.as_str()))
        .unwrap_or_else(|| kind.to_owned())
}

/// The first of "name", "name 2" … that is not taken.
fn numbered_name<'a>(name: &str, taken: impl Iterator<Item = &'a str>) -> String {
    let taken: Vec<&str> = taken.collect();
    let numbered = (2..=taken.len() + 1).map(|i| format!("{name} {i}"));
    // Among one more than are taken one is free.
    std::iter::once(name.to_owned())
        .chain(numbered)
        .find(|name| !taken.contains(&name.as_str()))
        .unwrap_or_else(|| name.to_owned())
}

/// The first of "name copy", "name copy 2" … that is not taken.
fn copy_name<'a>(name: &str, taken: impl Iterator<Item = &'a str>) -> String {
    let taken: Vec<&str> = taken.collect();
    let copy = format!("{name} copy");
    if !taken.contains(&copy.as_str()) {
        return copy;
    }
    (2..=taken.len() + 2)
        .map(|i| format!("{copy} {i}"))
        .find(|name| !taken.contains(&name.as_str()))
        .unwrap_or(copy)
}
