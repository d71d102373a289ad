//! What the window remembers from one run of the program to the next.

use std::path::{Path, PathBuf};

use eframe::egui;
use serde::{Deserialize, Serialize};

use super::navigation::Habit;
use super::relight::Question;
use rekindle_capture::LightFrame;
use rekindle_estimate::estimate::{EstimateParams, Method, SpecularChoice};
use rekindle_scene::reflectance::{Brdf, SpecularModel};
use rekindle_solution::SolveOptions;

/// Recent files at most.
const RECENT: usize = 8;

/// Everything remembered.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// Dark, light or the system's.
    pub theme: egui::ThemePreference,
    /// Which mouse buttons move the view.
    pub habit: Habit,
    /// What was opened last, the newest first.
    pub recent: Vec<PathBuf>,
    /// How to estimate.
    pub estimation: Estimation,
    /// How hemispheres are shown.
    pub hemisphere: HemisphereExposure,
    /// Whether the mesh's outline lies over the photographs.
    pub outline: bool,
    /// Whether the hemisphere is drawn around the object.
    pub dome: bool,
    /// Whether the result card is open.
    pub result: bool,
    /// What was exported last and how.
    pub export: Question,
}

/// How to estimate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Estimation {
    /// The method.
    pub method: Method,
    /// The specular model, `None` for whichever leaves less unexplained.
    pub specular: Option<SpecularModel>,
    /// Roughness as other programs have it, 0 to 1, where the default method is not to estimate it.
    pub roughness: Option<f32>,
    /// Frequency of the geodesic hemisphere.
    pub frequency: u32,
    /// Distance of the lights in place of the capture's.
    pub radius: Option<f32>,
    /// What the lights stand still with in place of what the capture says.
    pub light_frame: Option<LightFrame>,
    /// Whether cameras and exposures are taken as the capture states them.
    pub as_stated: bool,
}

/// How hemispheres are shown.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HemisphereExposure {
    /// By the logarithm instead of in proportion.
    pub logarithmic: bool,
    /// Stops above the exposure at which the brightest node is white, if linear.
    pub stops: f32,
    /// Powers of ten from black to white, if logarithmic.
    pub decades: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            theme: egui::ThemePreference::Dark,
            habit: Habit::default(),
            recent: Vec::new(),
            estimation: Estimation::default(),
            hemisphere: HemisphereExposure::default(),
            outline: true,
            dome: false,
            result: false,
            export: Question::default(),
        }
    }
}

impl Default for Estimation {
    fn default() -> Self {
        Self {
            method: Method::Fast,
            specular: None,
            roughness: None,
            frequency: 70,
            radius: None,
            light_frame: None,
            as_stated: false,
        }
    }
}

impl Default for HemisphereExposure {
    fn default() -> Self {
        Self {
            logarithmic: true,
            stops: 0.0,
            decades: 3.0,
        }
    }
}

impl Settings {
    /// Moves a path to the front of the recent ones.
    pub fn remember(&mut self, path: &Path) {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        self.recent.retain(|other| *other != path);
        self.recent.insert(0, path);
        self.recent.truncate(RECENT);
    }
}

impl Estimation {
    /// The roughness that is stated, if the method takes one.
    pub fn stated_roughness(&self) -> Option<f32> {
        self.roughness.filter(|_| self.method == Method::Fast)
    }

    /// The same for `solve`.
    pub fn options(&self) -> SolveOptions {
        SolveOptions {
            estimate: EstimateParams {
                method: self.method,
                specular: self
                    .specular
                    .map_or(SpecularChoice::Auto, SpecularChoice::Model),
                sigma: self.stated_roughness().map(Brdf::sigma_of),
                as_stated: self.as_stated,
                ..EstimateParams::default()
            },
            frequency: self.frequency,
            radius: self.radius,
            light_frame: self.light_frame,
        }
    }
}
