//! What is left out because a scene doesn't need it: counted, and done all the same where that is asked for.

use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};

/// Work that is left out where it would change nothing to speak of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shortcut {
    /// Only cells that are lit, and those beside them, are split into finer ones; the others' nodes never are unknowns.
    DarkCells,
    /// Only cells that are lit, and those beside them, have equations; the others are looked at once these are solved.
    FarCells,
    /// A cell outside its lobe at all points of a block has no entries in the matrix there.
    Lobes,
    /// Points at which none of the lit cells could show take no part.
    UnlitPoints,
    /// Cells are tested for shadows in groups, and not at all where their highlight could not show.
    ShadowRays,
    /// Roughnesses far from the best of the other specular model, or beyond several worse ones, are not tried, and a model that is
    /// clearly worse is not improved.
    Roughnesses,
    /// Where many views see a part of the surface, its texture is reconstructed from the best of them.
    Views,
}

impl Shortcut {
    /// All there are.
    pub const ALL: [Self; 7] = [
        Self::DarkCells,
        Self::FarCells,
        Self::Lobes,
        Self::UnlitPoints,
        Self::ShadowRays,
        Self::Roughnesses,
        Self::Views,
    ];

    /// Name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::DarkCells => "dark-cells",
            Self::FarCells => "far-cells",
            Self::Lobes => "lobes",
            Self::UnlitPoints => "unlit-points",
            Self::ShadowRays => "shadow-rays",
            Self::Roughnesses => "roughnesses",
            Self::Views => "views",
        }
    }
}

/// Some of the shortcuts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ShortcutSet(u8);

impl ShortcutSet {
    /// Whether one of them is this.
    pub fn contains(self, shortcut: Shortcut) -> bool {
        self.0 & (1 << shortcut as u8) != 0
    }
}

impl FromIterator<Shortcut> for ShortcutSet {
    fn from_iter<I: IntoIterator<Item = Shortcut>>(shortcuts: I) -> Self {
        let bits = shortcuts.into_iter().map(|shortcut| 1 << shortcut as u8);
        Self(bits.fold(0, |all, bit| all | bit))
    }
}

/// How much of something there was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Of what.
    pub what: String,
    /// How much there was.
    pub all: u64,
    /// How much of it was left out.
    pub left_out: u64,
}

/// Which shortcuts an estimation takes, and how much they have left out so far.
#[derive(Debug, Default)]
pub struct Shortcuts {
    avoided: ShortcutSet,
    counts: [(AtomicU64, AtomicU64); Shortcut::ALL.len()],
}

impl Shortcuts {
    /// All but some.
    pub fn without(avoided: ShortcutSet) -> Self {
        Self {
            avoided,
            counts: Default::default(),
        }
    }

    /// Whether this one is taken.
    pub fn takes(&self, shortcut: Shortcut) -> bool {
        !self.avoided.contains(shortcut)
    }

    /// There was so much, of which so much was left out.
    pub fn count(&self, shortcut: Shortcut, all: usize, left_out: usize) {
        let (sum, left) = &self.counts[shortcut as usize];
        sum.fetch_add(all as u64, Ordering::Relaxed);
        left.fetch_add(left_out as u64, Ordering::Relaxed);
    }

    /// How much there was and how much of it was left out, of all that came up.
    pub fn counted(&self) -> Vec<LeftOut> {
        let counts = Shortcut::ALL.iter().zip(&self.counts);
        counts
            .map(|(shortcut, (all, left_out))| LeftOut {
                what: shortcut.name().to_owned(),
                all: all.load(Ordering::Relaxed),
                left_out: left_out.load(Ordering::Relaxed),
            })
            .filter(|count| count.all > 0)
            .collect()
    }
}
