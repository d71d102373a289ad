//! Every command of the window, once: menus, shortcuts, the command palette and the key sheet all read this table.

use eframe::egui::{Key, KeyboardShortcut, Modifiers};

/// What a command does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Open the folder of a capture or of a solution.
    OpenFolder,
    /// Open a project file or a `transforms.json`.
    OpenFile,
    /// Open the built-in capture.
    Demo,
    /// Find the photographs of a solution that was opened without them.
    LocatePhotographs,
    /// Go to the welcome page.
    Welcome,
    /// Save the project.
    Save,
    /// Save the project under another name.
    SaveAs,
    /// Undo the last change.
    Undo,
    /// Do again what was undone.
    Redo,
    /// Show the list of steps, or hide it.
    History,
    /// Write pictures or an animation.
    Export,
    /// Write the object and its light for other programs.
    ExportObject,
    /// Write a web page in which the object is relit.
    ExportWeb,
    /// Add a lamp.
    AddLamp,
    /// Put a copy of the selected light beside it.
    DuplicateLamp,
    /// Remove the selected light.
    DeleteLamp,
    /// Switch the selected lamp off or on.
    MuteLamp,
    /// Leave only the selected light on, or end that.
    SoloLamp,
    /// Pressing on the object places the selected light's highlight.
    PlaceHighlight,
    /// Pressing on the object turns the selected light to where it shades brightest.
    PlaceBrightest,
    /// Pressing on the object places the selected light behind it.
    PlaceRim,
    /// Select the next lamp.
    NextLamp,
    /// Add the next lamp to the selection.
    AlsoNextLamp,
    /// Select all lamps of the list.
    SelectAllLamps,
    /// Make a group of the selected lamps.
    GroupLamps,
    /// End the groups of the selected lamps.
    UngroupLamps,
    /// Put the selected light back to how it was estimated.
    ResetLamp,
    /// Show the next look.
    NextLook,
    /// Show the captured light in place of a setup, or the setup again.
    CompareCaptured,
    /// Close the window.
    Quit,
    /// Bring the mesh to where the silhouettes say.
    Align,
    /// Set points on the mesh and mark them in photographs.
    AlignByPoints,
    /// Choose a picture of the light of the place.
    KnownLight,
    /// Start the estimation, or start it again.
    Solve,
    /// Pause the estimation or let it go on.
    Pause,
    /// Stop what is running.
    Stop,
    /// End the estimation with what it has reached.
    KeepBest,
    /// Show the page of the capture.
    ShowCapture,
    /// Show the page of the estimation.
    ShowEstimation,
    /// Show the page on which the object is relit.
    ShowRelighting,
    /// Show the whole object.
    Frame,
    /// Back to the first viewpoint.
    ResetView,
    /// To the camera of an input view, counted from 0.
    Camera(u8),
    /// More exposure.
    Brighter,
    /// Less exposure.
    Darker,
    /// Exposure back to none.
    ResetExposure,
    /// Show how often each brightness occurs.
    Histogram,
    /// Draw the hemisphere around the object, or don't.
    Dome,
    /// Dark or light theme.
    ToggleTheme,
    /// Larger text.
    ZoomIn,
    /// Smaller text.
    ZoomOut,
    /// Text at its normal size.
    ZoomReset,
    /// The whole screen or a window.
    FullScreen,
    /// How to shoot a capture.
    Guide,
    /// All commands by name.
    Palette,
    /// All keys.
    Keys,
    /// Version and graphics adapter.
    About,
}

/// Where a command is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Menu {
    /// Opening, saving, leaving.
    File,
    /// Changing the light.
    Edit,
    /// The estimation.
    Estimate,
    /// What is shown and how.
    View,
    /// Finding one's way.
    Help,
}

impl Menu {
    /// All menus in order.
    pub const ALL: [Self; 5] = [
        Self::File,
        Self::Edit,
        Self::Estimate,
        Self::View,
        Self::Help,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::File => "File",
            Self::Edit => "Edit",
            Self::Estimate => "Estimate",
            Self::View => "View",
            Self::Help => "Help",
        }
    }
}

/// A command.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// What it does.
    pub action: Action,
    /// What it is called; ends with `…` if it asks something first.
    pub name: &'static str,
    /// Where it is found.
    pub menu: Menu,
    /// Whether a line parts it from the entry before it.
    pub begins_group: bool,
    /// Its keys.
    pub keys: Option<KeyboardShortcut>,
    /// What it does, in a sentence.
    pub tip: &'static str,
}

impl Entry {
    /// Its keys as they are read: signs by the sign, not by its name.
    pub fn keys_text(&self, ctx: &eframe::egui::Context) -> Option<String> {
        let keys = self.keys?;
        let text = ctx.format_shortcut(&keys);
        let key = keys.logical_key;
        Some(match text.strip_suffix(key.name()) {
            Some(modifiers) => format!("{modifiers}{}", key.symbol_or_name()),
            None => text,
        })
    }
}

const fn entry(
    action: Action,
    name: &'static str,
    menu: Menu,
    keys: Option<(Modifiers, Key)>,
    tip: &'static str,
) -> Entry {
    let keys = match keys {
        Some((modifiers, key)) => Some(KeyboardShortcut::new(modifiers, key)),
        None => None,
    };
    Entry {
        action,
        name,
        menu,
        begins_group: false,
        keys,
        tip,
    }
}

const NONE: Modifiers = Modifiers::NONE;
const SHIFT: Modifiers = Modifiers::SHIFT;
const CTRL: Modifiers = Modifiers::COMMAND;

/// An entry that begins a group of its menu.
const fn apart(entry: Entry) -> Entry {
    Entry {
        begins_group: true,
        ..entry
    }
}

/// All commands, in the order of the menus.
pub const ENTRIES: &[Entry] = &[
    entry(
        Action::OpenFolder,
        "Open capture…",
        Menu::File,
        Some((CTRL, Key::O)),
        "Open the folder of a capture or of a solution",
    ),
    entry(
        Action::OpenFile,
        "Open project…",
        Menu::File,
        Some((CTRL.plus(SHIFT), Key::O)),
        "Open a project file, or a capture by its transforms.json",
    ),
    entry(
        Action::Demo,
        "Try the demo",
        Menu::File,
        Some((CTRL, Key::D)),
        "Open the built-in capture: six photographs of a painted cow",
    ),
    entry(
        Action::LocatePhotographs,
        "Locate photographs…",
        Menu::File,
        None,
        "Choose the folder of the capture that this was estimated from, to compare with its photographs",
    ),
    apart(entry(
        Action::Save,
        "Save project",
        Menu::File,
        Some((CTRL, Key::S)),
        "Save lights and setups, and the solution beside them",
    )),
    entry(
        Action::SaveAs,
        "Save project as…",
        Menu::File,
        Some((CTRL.plus(SHIFT), Key::S)),
        "Save lights and setups in another file",
    ),
    apart(entry(
        Action::Export,
        "Export pictures…",
        Menu::File,
        Some((CTRL, Key::E)),
        "Write pictures or an animation, made by the reference renderer",
    )),
    entry(
        Action::ExportObject,
        "Export for other programs…",
        Menu::File,
        Some((CTRL.plus(SHIFT), Key::E)),
        "Write the object and its light for Blender, Mitsuba, glTF, USD and others",
    ),
    entry(
        Action::ExportWeb,
        "Export web page…",
        Menu::File,
        None,
        "Write one file in which anyone with a browser turns the object and moves its lights",
    ),
    apart(entry(
        Action::Welcome,
        "Welcome page",
        Menu::File,
        None,
        "Go to the page with recent files; what is open stays open",
    )),
    entry(
        Action::Quit,
        "Quit",
        Menu::File,
        Some((CTRL, Key::Q)),
        "Close the window",
    ),
    entry(
        Action::Undo,
        "Undo",
        Menu::Edit,
        Some((CTRL, Key::Z)),
        "Undo the last change of the light, or of the mesh's place",
    ),
    entry(
        Action::Redo,
        "Redo",
        Menu::Edit,
        Some((CTRL.plus(SHIFT), Key::Z)),
        "Do again what was undone; Ctrl+Y does the same",
    ),
    entry(
        Action::History,
        "History",
        Menu::Edit,
        Some((CTRL, Key::H)),
        "List every change of the light, to go back to any of them",
    ),
    apart(entry(
        Action::AddLamp,
        "Add light",
        Menu::Edit,
        Some((NONE, Key::A)),
        "Add a white disc of light",
    )),
    entry(
        Action::DuplicateLamp,
        "Duplicate light",
        Menu::Edit,
        Some((SHIFT, Key::D)),
        "Put a copy of each selected light beside it",
    ),
    entry(
        Action::DeleteLamp,
        "Delete light",
        Menu::Edit,
        Some((NONE, Key::Delete)),
        "Remove the selected lights",
    ),
    entry(
        Action::ResetLamp,
        "Reset light",
        Menu::Edit,
        Some((SHIFT, Key::R)),
        "Put the selected lights back to how they were estimated",
    ),
    apart(entry(
        Action::MuteLamp,
        "Mute light",
        Menu::Edit,
        Some((NONE, Key::M)),
        "Switch the selected lights off or on",
    )),
    entry(
        Action::SoloLamp,
        "Solo light",
        Menu::Edit,
        Some((NONE, Key::S)),
        "Leave only the selected lights and the ambient light on, or end that",
    ),
    apart(entry(
        Action::NextLamp,
        "Select the next light",
        Menu::Edit,
        Some((NONE, Key::N)),
        "Select the light below the selected one, or the first",
    )),
    entry(
        Action::AlsoNextLamp,
        "Select the next light, too",
        Menu::Edit,
        Some((SHIFT, Key::N)),
        "Add the light below the selected one to the selection; Ctrl or Shift and a click do so, too",
    ),
    entry(
        Action::SelectAllLamps,
        "Select all lights",
        Menu::Edit,
        Some((CTRL, Key::A)),
        "Select all lights of the list; what is done is then done to all of them",
    ),
    entry(
        Action::GroupLamps,
        "Group lights",
        Menu::Edit,
        Some((CTRL, Key::G)),
        "Make a group of the selected lights: one name, intensity, mute and solo for all",
    ),
    entry(
        Action::UngroupLamps,
        "Ungroup lights",
        Menu::Edit,
        Some((CTRL.plus(SHIFT), Key::G)),
        "End the groups of the selected lights, which shine on as they do",
    ),
    apart(entry(
        Action::PlaceHighlight,
        "Place the highlight by pressing",
        Menu::Edit,
        Some((NONE, Key::H)),
        "Pressing on the object puts the selected light's highlight there",
    )),
    entry(
        Action::PlaceBrightest,
        "Place the brightest shading by pressing",
        Menu::Edit,
        Some((NONE, Key::B)),
        "Pressing on the object turns the selected light to face it there",
    ),
    entry(
        Action::PlaceRim,
        "Place a rim light by pressing",
        Menu::Edit,
        Some((NONE, Key::G)),
        "Pressing on the object lets the selected light graze it there from behind",
    ),
    apart(entry(
        Action::NextLook,
        "Next setup",
        Menu::Edit,
        Some((NONE, Key::L)),
        "Show the next way to light the object",
    )),
    entry(
        Action::CompareCaptured,
        "Compare with the captured light",
        Menu::Edit,
        Some((NONE, Key::C)),
        "Show the captured light in place of this setup, then the setup again",
    ),
    entry(
        Action::Solve,
        "Estimate",
        Menu::Estimate,
        Some((CTRL, Key::Enter)),
        "Estimate roughness and lights, with the settings of the capture's page",
    ),
    entry(
        Action::Pause,
        "Pause or resume",
        Menu::Estimate,
        Some((NONE, Key::Space)),
        "Pause the estimation, or let it go on",
    ),
    entry(
        Action::KeepBest,
        "Stop and keep the best so far",
        Menu::Estimate,
        Some((CTRL, Key::Period)),
        "End the estimation with what it has reached and relight with that",
    ),
    entry(
        Action::Stop,
        "Stop",
        Menu::Estimate,
        Some((NONE, Key::Escape)),
        "Stop what is running; by its key, an estimation keeps the best so far",
    ),
    apart(entry(
        Action::Align,
        "Align the mesh by silhouettes",
        Menu::Estimate,
        None,
        "Find the mesh's place, size and turn by the photographs' silhouettes",
    )),
    entry(
        Action::AlignByPoints,
        "Align the mesh by points…",
        Menu::Estimate,
        None,
        "Set points on the mesh and mark them in photographs, to begin with",
    ),
    apart(entry(
        Action::KnownLight,
        "Known light…",
        Menu::Estimate,
        Some((CTRL, Key::L)),
        "Choose a picture of all the light of the place: nothing about the light is estimated then",
    )),
    entry(
        Action::ShowCapture,
        "Show the capture",
        Menu::View,
        Some((NONE, Key::F1)),
        "Photographs, mesh and what is wrong with them",
    ),
    entry(
        Action::ShowEstimation,
        "Show the estimation",
        Menu::View,
        Some((NONE, Key::F2)),
        "Hemispheres, curves and every iteration",
    ),
    entry(
        Action::ShowRelighting,
        "Show the relighting",
        Menu::View,
        Some((NONE, Key::F3)),
        "The object and its lights",
    ),
    apart(entry(
        Action::Frame,
        "Frame the object",
        Menu::View,
        Some((NONE, Key::F)),
        "Show the whole object",
    )),
    entry(
        Action::ResetView,
        "Reset the view",
        Menu::View,
        Some((NONE, Key::Home)),
        "Back to the first viewpoint",
    ),
    camera(0, "Camera 1", Key::Num1),
    camera(1, "Camera 2", Key::Num2),
    camera(2, "Camera 3", Key::Num3),
    camera(3, "Camera 4", Key::Num4),
    camera(4, "Camera 5", Key::Num5),
    camera(5, "Camera 6", Key::Num6),
    camera(6, "Camera 7", Key::Num7),
    camera(7, "Camera 8", Key::Num8),
    camera(8, "Camera 9", Key::Num9),
    apart(entry(
        Action::Brighter,
        "More exposure",
        Menu::View,
        Some((NONE, Key::E)),
        "Half a stop more",
    )),
    entry(
        Action::Darker,
        "Less exposure",
        Menu::View,
        Some((SHIFT, Key::E)),
        "Half a stop less",
    ),
    entry(
        Action::ResetExposure,
        "Reset the exposure",
        Menu::View,
        Some((NONE, Key::R)),
        "Back to no stops",
    ),
    entry(
        Action::Histogram,
        "Histogram",
        Menu::View,
        Some((NONE, Key::I)),
        "Show how often each brightness occurs",
    ),
    entry(
        Action::Dome,
        "Hemisphere around the object",
        Menu::View,
        Some((NONE, Key::D)),
        "Draw the hemisphere that the lights are on around the object; they are dragged there, too",
    ),
    apart(entry(
        Action::ToggleTheme,
        "Dark or light theme",
        Menu::View,
        Some((CTRL, Key::T)),
        "Change between the dark and the light theme",
    )),
    entry(
        Action::ZoomIn,
        "Larger text",
        Menu::View,
        Some((CTRL, Key::Plus)),
        "Make everything larger",
    ),
    entry(
        Action::ZoomOut,
        "Smaller text",
        Menu::View,
        Some((CTRL, Key::Minus)),
        "Make everything smaller",
    ),
    entry(
        Action::ZoomReset,
        "Normal text",
        Menu::View,
        Some((CTRL, Key::Num0)),
        "Everything at its normal size",
    ),
    entry(
        Action::FullScreen,
        "Full screen",
        Menu::View,
        Some((NONE, Key::F11)),
        "Fill the whole screen, or go back to a window",
    ),
    entry(
        Action::Palette,
        "Command palette",
        Menu::Help,
        Some((CTRL, Key::P)),
        "Find any command by its name; Ctrl+K does the same",
    ),
    entry(
        Action::Guide,
        "How to shoot a capture",
        Menu::Help,
        Some((SHIFT, Key::F1)),
        "What a capture needs: object, light, views, brackets, masks, mesh",
    ),
    entry(
        Action::Keys,
        "All keys",
        Menu::Help,
        Some((NONE, Key::Questionmark)),
        "Show every key and mouse gesture",
    ),
    apart(entry(
        Action::About,
        "About rekindle",
        Menu::Help,
        None,
        "Show version and graphics adapter",
    )),
];

const fn camera(index: u8, name: &'static str, key: Key) -> Entry {
    entry(
        Action::Camera(index),
        name,
        Menu::View,
        Some((NONE, key)),
        "Look from where this photograph was taken",
    )
}

/// The commands that have keys, in the order in which these are asked for: of two that share a key the one with more modifiers
/// first, since further ones are no hindrance to a shortcut.
pub fn by_keys() -> Vec<(KeyboardShortcut, Action)> {
    let keys = ENTRIES.iter().filter_map(|e| Some((e.keys?, e.action)));
    let mut keys: Vec<_> = keys.collect();
    let modifiers = |keys: &KeyboardShortcut| {
        let m = keys.modifiers;
        [m.command, m.shift, m.alt]
            .into_iter()
            .filter(|on| *on)
            .count()
    };
    keys.sort_by_key(|(keys, _)| std::cmp::Reverse(modifiers(keys)));
    keys
}

/// The entry of an action.
pub fn entry_of(action: Action) -> Option<&'static Entry> {
    ENTRIES.iter().find(|entry| entry.action == action)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_has_two_meanings_and_no_longer_one_is_shadowed() {
        for (i, a) in ENTRIES.iter().enumerate() {
            for b in &ENTRIES[i + 1..] {
                assert!(a.action != b.action, "{:?} is listed twice", a.action);
                assert!(a.name != b.name, "two commands are called {}", a.name);
            }
        }
        let keys = by_keys();
        for (i, (a, first)) in keys.iter().enumerate() {
            for (b, second) in &keys[i + 1..] {
                assert!(a != b, "{first:?} and {second:?}");
                // egui ignores extra Shift, so a shorter combination must come after.
                let shadowed = a.logical_key == b.logical_key
                    && b.modifiers.contains(a.modifiers)
                    && b.modifiers != a.modifiers;
                assert!(!shadowed, "{second:?} never hears its key: {first:?}");
            }
        }
    }

    #[test]
    fn menus_have_the_order_that_people_expect() {
        let place = |action| ENTRIES.iter().position(|e| e.action == action);
        for (first, second) in [
            (Action::Undo, Action::Redo),
            (Action::Save, Action::SaveAs),
            (Action::OpenFolder, Action::Save),
            (Action::Export, Action::Quit),
        ] {
            assert!(place(first) < place(second), "{first:?} before {second:?}");
        }
        // The entries of a menu stand together, and no line is above its first.
        let starts = ENTRIES.iter().enumerate().filter(|(i, e)| {
            i.checked_sub(1)
                .is_none_or(|before| ENTRIES[before].menu != e.menu)
        });
        let starts: Vec<&Entry> = starts.map(|(_, e)| e).collect();
        assert_eq!(starts.len(), Menu::ALL.len());
        assert!(starts.iter().all(|e| !e.begins_group));
    }
}
