//! Groups: lamps of a look that are set together.

use serde::{Deserialize, Serialize};

use super::lamp::{Lamp, LampId, MAX_STOPS};
use super::look::Look;

/// Names a group among those of its look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct GroupId(pub u32);

/// What lamps that name it have in common.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// Names it.
    pub id: GroupId,
    /// What people call it.
    pub name: String,
    /// Intensity in stops, beside that of each lamp.
    pub stops: f32,
    /// Whether all its lamps are switched off.
    pub muted: bool,
    /// Whether lists hide its lamps.
    pub folded: bool,
}

impl Look {
    /// The group of this id.
    pub fn group(&self, id: GroupId) -> Option<&Group> {
        self.groups.iter().find(|g| g.id == id)
    }

    /// The group of this id, to be changed.
    pub fn group_mut(&mut self, id: GroupId) -> Option<&mut Group> {
        self.groups.iter_mut().find(|g| g.id == id)
    }

    /// The lamps of a group, in the order of the list.
    pub fn members(&self, id: GroupId) -> Vec<LampId> {
        let lamps = self.lamps.iter().filter(|l| l.group == Some(id));
        lamps.map(|l| l.id).collect()
    }

    /// A lamp as it shines: what its group adds is its own.
    pub fn as_lit(&self, lamp: &Lamp) -> Lamp {
        let group = lamp.group.and_then(|id| self.group(id));
        Lamp {
            group: None,
            stops: lamp.stops + group.map_or(0.0, |g| g.stops),
            muted: lamp.muted || group.is_some_and(|g| g.muted),
            ..lamp.clone()
        }
    }

    /// Makes a group of lamps; none without any. They shine as before, and leave the groups that they were in.
    pub(super) fn add_group(&mut self, name: String, lamps: &[LampId]) -> Option<GroupId> {
        let id = GroupId(self.groups.iter().map(|g| g.id.0 + 1).max().unwrap_or(0));
        self.free(lamps);
        for lamp in self.lamps.iter_mut().filter(|l| lamps.contains(&l.id)) {
            lamp.group = Some(id);
        }
        let group = Group {
            id,
            name,
            stops: 0.0,
            muted: false,
            folded: false,
        };
        self.groups.push(group);
        self.forget_empty_groups();
        self.group(id).map(|group| group.id)
    }

    /// Ends a group: its lamps shine as before, each for itself.
    pub fn ungroup(&mut self, id: GroupId) {
        self.free(&self.members(id));
        self.forget_empty_groups();
    }

    /// Gives lamps what their groups added to them, and takes them out.
    fn free(&mut self, lamps: &[LampId]) {
        for id in lamps {
            if let Some(lit) = self.lamp(*id).map(|lamp| self.as_lit(lamp))
                && let Some(lamp) = self.lamp_mut(*id)
            {
                *lamp = lit;
                lamp.stops = lamp.stops.clamp(-MAX_STOPS, MAX_STOPS);
            }
        }
    }

    /// Removes groups that no lamp is in.
    pub(super) fn forget_empty_groups(&mut self) {
        let lamps = &self.lamps;
        let has_lamps = |g: &super::Group| lamps.iter().any(|l| l.group == Some(g.id));
        self.groups.retain(has_lamps);
    }

    /// The same light without groups, and without a solo of several lamps.
    pub(super) fn plain(&self) -> Self {
        let mut plain = Self {
            lamps: self.lamps.iter().map(|l| self.as_lit(l)).collect(),
            groups: Vec::new(),
            ..self.clone()
        };
        if plain.solo.len() > 1 {
            for lamp in &mut plain.lamps {
                lamp.muted = !plain.solo.contains(&lamp.id);
            }
            plain.solo.clear();
            plain.remainder = false;
            plain.probe = None;
        }
        plain
    }

    /// Holds the numbers of groups within their bounds; the error says what is wrong with one.
    pub(super) fn check_groups(&mut self) -> Result<(), String> {
        for (i, group) in self.groups.iter().enumerate() {
            let named = |what: &str| Err(format!("group \"{}\" {what}", group.name));
            if !group.stops.is_finite() {
                return named("has an intensity that is not finite");
            }
            if self.groups[..i].iter().any(|g| g.id == group.id) {
                return named("has the number of another");
            }
        }
        for group in &mut self.groups {
            group.stops = group.stops.clamp(-MAX_STOPS, MAX_STOPS);
        }
        let known: Vec<GroupId> = self.groups.iter().map(|g| g.id).collect();
        for lamp in &mut self.lamps {
            lamp.group = lamp.group.filter(|id| known.contains(id));
        }
        self.forget_empty_groups();
        Ok(())
    }
}

/// The lamps of a solo in files: nothing, one number as before there were several, or a list.
pub(super) mod solo {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::super::lamp::LampId;

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Written {
        One(LampId),
        Several(Vec<LampId>),
    }

    pub(in super::super) fn serialize<S: Serializer>(
        lamps: &[LampId],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match lamps {
            [] => serializer.serialize_none(),
            [one] => one.serialize(serializer),
            several => several.serialize(serializer),
        }
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<LampId>, D::Error> {
        Ok(match Option::<Written>::deserialize(deserializer)? {
            None => Vec::new(),
            Some(Written::One(lamp)) => vec![lamp],
            Some(Written::Several(lamps)) => lamps,
        })
    }
}
