//! `rekindle synth`: captures with known truth.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::bail;
use clap::ValueEnum;

use super::interrupt::{self, Interrupted};
use super::progress::Progress;
use super::{OutputArgs, json_path, print_json, print_line};
use rekindle_lab::synth::{
    Encode, Files, GeometryErrors, Lamps, Light, Material, Mistake, Normals, Object, Places,
    Recipe, Sensor, SynthError, Views, check_destination, make,
};
use rekindle_scene::reflectance::SpecularModel;

/// Arguments of `rekindle synth`.
#[derive(clap::Args)]
pub(super) struct SynthArgs {
    /// Folder for the capture; an earlier one made by this command is replaced at the end
    #[arg(short, long, value_name = "CAPTURE")]
    output: PathBuf,
    #[command(flatten)]
    surface: SurfaceArgs,
    #[command(flatten)]
    light: LightArgs,
    #[command(flatten)]
    views: ViewArgs,
    #[command(flatten)]
    faults: FaultArgs,
    /// Leave out the truth's pictures from elsewhere and under new light, which take most of the time
    #[arg(long)]
    no_pictures: bool,
    /// Decides everything random: the same seed makes the same files
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(clap::Args)]
#[command(next_help_heading = "Object and surface")]
struct SurfaceArgs {
    /// The shape
    #[arg(long, value_enum, default_value_t = ObjectArg::Figurine)]
    object: ObjectArg,
    /// About how many triangles it has
    #[arg(long, default_value_t = 30_000, value_parser = clap::value_parser!(u32).range(1000..=4_000_000))]
    triangles: u32,
    /// Contrast of the texture, from 0 (one colour) to 1 (nearly black to nearly white)
    #[arg(long, value_name = "0..1", default_value_t = 0.5, value_parser = within::<0, 1>)]
    texture: f32,
    /// Form of the specular lobe
    #[arg(long, value_enum, default_value_t = ModelArg::Paper)]
    model: ModelArg,
    /// Roughness σ of the lobe, radians
    #[arg(long, default_value_t = 0.075, value_parser = sigma)]
    sigma: f32,
    /// Strength K_S of the paper's lobe [default: 0.4]
    #[arg(long, value_parser = positive)]
    ks: Option<f32>,
    /// Index of refraction of the microfacet lobe: it decides how strong the lobe is; its Fresnel factor has the shape of
    /// index 1.5 [default: 1.5]
    #[arg(long, value_parser = refractive_index)]
    ior: Option<f32>,
    /// Let the surface light itself (microfacets of index 1.5 and metals: the paper's model has no absolute scale)
    #[arg(long)]
    interreflection: bool,
}

#[derive(clap::Args)]
#[command(next_help_heading = "Light")]
struct LightArgs {
    /// Number of lamps
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=12))]
    lamps: u32,
    /// A lamp's place: azimuth from the front to the right and elevation, degrees; give it once for each lamp
    #[arg(long, value_name = "AZIMUTH,ELEVATION", conflicts_with_all = ["lamps", "apart"], allow_hyphen_values = true)]
    lamp: Vec<Place>,
    /// Angle between neighbouring lamps in a row, degrees (default: they are spread over the hemisphere)
    #[arg(long, value_name = "DEG", value_parser = within::<0, 15>)]
    apart: Option<f32>,
    /// Angular radius of every lamp, degrees
    #[arg(long, value_name = "DEG", default_value_t = 3.0, value_parser = extent)]
    extent: f32,
    /// How many times the strongest lamp is as strong as the weakest
    #[arg(long, default_value_t = 3.0, value_parser = at_least_one)]
    contrast: f32,
    /// Colour of the lamps, from 0 (white) to 1 (saturated)
    #[arg(long, value_name = "0..1", default_value_t = 0.0, value_parser = within::<0, 1>)]
    tint: f32,
    /// Distance of the lamps from the object's centre, whose radius is about 1 (default: distant)
    #[arg(long, value_name = "DISTANCE", value_parser = positive)]
    near: Option<f32>,
    /// Lat-long picture of distant light in place of lamps (EXR or HDR). It is summed up by 1500 nodes, which show as
    /// single highlights at a roughness below 0.05
    #[arg(long, value_name = "FILE", conflicts_with_all = ["lamps", "lamp", "apart", "extent", "contrast", "tint", "near"])]
    probe: Option<PathBuf>,
}

#[derive(clap::Args)]
#[command(next_help_heading = "Photographs")]
struct ViewArgs {
    /// Number of photographs
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=64))]
    views: u32,
    /// Azimuths that they are spread over, degrees
    #[arg(long, value_name = "DEG", default_value_t = 150.0, value_parser = within::<0, 360>)]
    arc: f32,
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "640x480")]
    size: Size,
    /// Samples of a pixel: 16, 64, 144 or 256
    #[arg(long, default_value_t = 64, value_parser = samples)]
    samples: u32,
    /// Factor of all radiances
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    scale: f32,
    /// Turn the object before one camera: the light stands still with the camera, and lamps are stated as at the first view
    #[arg(long)]
    turntable: bool,
    /// Write this many 8-bit PNG files for each view in place of one EXR file
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u32).range(1..=9), conflicts_with = "exposures")]
    brackets: Option<u32>,
    /// How many stops the files of a view are apart
    #[arg(long, value_name = "STOPS", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=6), requires = "brackets")]
    bracket_stops: u32,
    /// How they are encoded
    #[arg(long, value_enum, default_value_t = ResponseArg::Srgb, requires = "brackets")]
    response: ResponseArg,
    /// Expose the views differently, within this many stops, and state the exposure times
    #[arg(long, value_name = "STOPS", value_parser = clap::value_parser!(u32).range(1..=16))]
    exposures: Option<u32>,
}

#[derive(clap::Args)]
#[command(next_help_heading = "Faults")]
struct FaultArgs {
    /// Standard deviation of the photon noise at the object's mean radiance, percent of it
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, value_parser = within::<0, 100>)]
    noise: f32,
    /// Part of the highlights' pixels that are clipped, percent. Brackets tell which; in EXR files they are a plateau
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, value_parser = within::<0, 100>)]
    saturated: f32,
    /// Part of the object's pixels that show something unrelated, percent
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, value_parser = within::<0, 100>)]
    outliers: f32,
    /// Standard deviation of the views' unstated gain, percent
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, value_parser = within::<0, 30>)]
    gain_error: f32,
    /// Angle by which every stated camera is turned away from the real one, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = within::<0, 10>)]
    camera_error: f32,
    /// Standard deviation of the stated mesh's vertices along their normals, percent of the object's diagonal
    #[arg(long, value_name = "PERCENT", default_value_t = 0.0, value_parser = within::<0, 5>)]
    vertex_noise: f32,
    /// About how many triangles the stated mesh has (default: it is the photographed surface)
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u32).range(1000..=4_000_000))]
    mesh_triangles: Option<u32>,
    /// Where the stated mesh's normals come from
    #[arg(long, value_enum, default_value_t = NormalsArg::Exact)]
    normals: NormalsArg,
    /// Standard deviation of the stated normals' tilt to each of two sides, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = within::<0, 45>)]
    normal_noise: f32,
    /// What else is wrong, and stated nowhere
    #[arg(long, value_enum)]
    mistake: Option<MistakeArg>,
}

#[derive(Clone, Copy, ValueEnum)]
enum MistakeArg {
    /// Photographs without alpha, before a background as bright as the object
    Background,
    /// Linear files with sRGB-encoded values
    Encoded,
    /// One view four times as bright
    BrighterView,
    /// One view of another white balance, 5 % in red and blue
    WhiteBalance,
    /// One camera half a degree further round the object than it stood
    OrbitedCamera,
    /// A mesh that lacks a fifth of its triangles
    Holes,
    /// Twenty pixels of each view a thousand times too bright
    HotPixels,
}

impl From<MistakeArg> for Mistake {
    fn from(arg: MistakeArg) -> Self {
        match arg {
            MistakeArg::Background => Self::Background,
            MistakeArg::Encoded => Self::Encoded,
            MistakeArg::BrighterView => Self::BrighterView,
            MistakeArg::WhiteBalance => Self::WhiteBalance,
            MistakeArg::OrbitedCamera => Self::OrbitedCamera,
            MistakeArg::Holes => Self::Holes,
            MistakeArg::HotPixels => Self::HotPixels,
        }
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum ObjectArg {
    /// A ball
    Sphere,
    /// A tilted ring: shadows and concave parts
    Torus,
    /// A bowl open to the front: much interreflection
    Bowl,
    /// A figure with arms, hollows and a fine relief
    Figurine,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ModelArg {
    /// Fresnel factor and masking constant (eq. 4)
    Paper,
    /// Microfacets with Beckmann's slopes, dielectric Fresnel factor and masking
    #[value(alias = "microfacet")]
    Beckmann,
    /// The same with GGX's slopes
    Ggx,
    /// GGX's slopes with a constant Fresnel factor
    Metal,
}

#[derive(Clone, Copy, ValueEnum)]
enum NormalsArg {
    /// From the exact shape
    Exact,
    /// From the triangles around each vertex
    Faces,
}

#[derive(Clone, Copy, ValueEnum)]
enum ResponseArg {
    /// By sRGB's curve
    Srgb,
    /// By a gamma of 1.8
    Gamma,
    /// With a toe and a shoulder, as film
    Film,
}

/// Azimuth and elevation, radians.
#[derive(Clone, Copy)]
struct Place([f32; 2]);

/// Width and height in pixels.
#[derive(Clone, Copy)]
pub(super) struct Size([u32; 2]);

impl Size {
    pub(super) fn pixels(self) -> [u32; 2] {
        self.0
    }
}

impl FromStr for Place {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once(',').and_then(|(azimuth, elevation)| {
            let number = |text: &str| text.trim().parse::<f32>().ok();
            Some([number(azimuth)?, number(elevation)?])
        });
        match parts {
            Some([azimuth, elevation])
                if azimuth.abs() <= 360.0 && (0.0..=90.0).contains(&elevation) =>
            {
                Ok(Self([azimuth.to_radians(), elevation.to_radians()]))
            }
            _ => Err("it must be an azimuth and an elevation from 0 to 90, like -30,45".to_owned()),
        }
    }
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text
            .split_once('x')
            .and_then(|(width, height)| Some([width.parse().ok()?, height.parse().ok()?]));
        match parts {
            Some(size) if size.iter().all(|side| (16..=8192).contains(side)) => Ok(Self(size)),
            _ => Err("it must be width x height of 16 to 8192 pixels, like 640x480".to_owned()),
        }
    }
}

fn within<const LEAST: i32, const MOST: i32>(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if (LEAST as f32..=MOST as f32).contains(&value) => Ok(value),
        _ => Err(format!("it must be a number from {LEAST} to {MOST}")),
    }
}

fn between(text: &str, least: f32, most: f32) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if (least..=most).contains(&value) => Ok(value),
        _ => Err(format!("it must be a number from {least} to {most}")),
    }
}

fn positive(text: &str) -> Result<f32, String> {
    between(text, 1e-9, 1e9)
}

fn sigma(text: &str) -> Result<f32, String> {
    between(text, 0.005, 1.0)
}

fn extent(text: &str) -> Result<f32, String> {
    between(text, 0.01, 90.0)
}

fn at_least_one(text: &str) -> Result<f32, String> {
    between(text, 1.0, 1e6)
}

fn refractive_index(text: &str) -> Result<f32, String> {
    between(text, 1.05, 3.0)
}

/// Samples of a pixel as sub-pixels along its side, each with 16 samples.
fn samples(text: &str) -> Result<u32, String> {
    match text {
        "16" | "64" | "144" | "256" => text.parse().map_err(|_| String::new()),
        _ => Err("it must be 16, 64, 144 or 256".to_owned()),
    }
}

impl SynthArgs {
    fn recipe(&self) -> anyhow::Result<Recipe> {
        Ok(Recipe {
            object: match self.surface.object {
                ObjectArg::Sphere => Object::Sphere,
                ObjectArg::Torus => Object::Torus,
                ObjectArg::Bowl => Object::Bowl,
                ObjectArg::Figurine => Object::Figurine,
            },
            triangles: self.surface.triangles,
            texture_contrast: self.surface.texture,
            material: self.surface.material()?,
            interreflection: self.surface.interreflection,
            light: self.light.light(),
            views: Views {
                count: self.views.views,
                arc: self.views.arc.to_radians(),
                size: self.views.size.pixels(),
                supersampling: self.views.samples.isqrt() / 4,
                scale: self.views.scale,
                turntable: self.views.turntable,
            },
            sensor: Sensor {
                noise: self.faults.noise / 100.0,
                outliers: self.faults.outliers / 100.0,
                saturated: self.faults.saturated / 100.0,
                gain_error: self.faults.gain_error / 100.0,
                files: match (self.views.brackets, self.views.exposures) {
                    (Some(count), _) => Files::Brackets {
                        count,
                        stops: self.views.bracket_stops,
                    },
                    (None, Some(stops)) => Files::Exposures(stops),
                    (None, None) => Files::Exr,
                },
                response: match self.views.response {
                    ResponseArg::Srgb => Encode::Srgb,
                    ResponseArg::Gamma => Encode::Gamma,
                    ResponseArg::Film => Encode::Film,
                },
            },
            errors: GeometryErrors {
                rotation: self.faults.camera_error.to_radians(),
                vertex_noise: self.faults.vertex_noise / 100.0,
                triangles: self.faults.mesh_triangles,
                normals: match self.faults.normals {
                    NormalsArg::Exact => Normals::Exact,
                    NormalsArg::Faces => Normals::Faces,
                },
                normal_noise: self.faults.normal_noise.to_radians(),
            },
            mistake: self.faults.mistake.map(Into::into),
            truth_pictures: !self.no_pictures,
            seed: self.seed,
        })
    }
}

impl SurfaceArgs {
    fn material(&self) -> anyhow::Result<Material> {
        let open = matches!(self.model, ModelArg::Paper | ModelArg::Metal);
        if open && self.ior.is_some() {
            bail!(
                "--ior is for --model beckmann or ggx; the paper's lobe and metals have a strength, --ks"
            );
        }
        if !open && self.ks.is_some() {
            bail!(
                "--ks is for --model paper or metal; a dielectric lobe's strength follows from --ior"
            );
        }
        let is_paper = matches!(self.model, ModelArg::Paper);
        if self.interreflection && (is_paper || self.ior.is_some_and(|ior| ior != 1.5)) {
            bail!(
                "--interreflection needs --model beckmann or ggx and the index of refraction 1.5, or --model metal, for which it is \
                 modelled"
            );
        }
        let dielectric = |model| Material::dielectric(model, self.sigma, self.ior.unwrap_or(1.5));
        Ok(match self.model {
            ModelArg::Paper => Material::paper(self.sigma, self.ks.unwrap_or(0.4)),
            ModelArg::Metal => Material::metal(self.sigma, self.ks.unwrap_or(0.4)),
            ModelArg::Beckmann => dielectric(SpecularModel::Beckmann),
            ModelArg::Ggx => dielectric(SpecularModel::Ggx),
        })
    }
}

impl LightArgs {
    fn light(&self) -> Light {
        if let Some(probe) = &self.probe {
            return Light::Probe(probe.clone());
        }
        let places = if !self.lamp.is_empty() {
            Places::At(self.lamp.iter().map(|place| place.0).collect())
        } else if let Some(apart) = self.apart {
            Places::Row(self.lamps, apart.to_radians())
        } else {
            Places::Spread(self.lamps)
        };
        Light::Lamps(Lamps {
            places,
            angular_radius: self.extent.to_radians(),
            contrast: self.contrast,
            tint: self.tint,
            distance: self.near,
        })
    }
}

pub(super) fn run(args: &SynthArgs, output: OutputArgs) -> anyhow::Result<()> {
    let recipe = args.recipe()?;
    let settled = check_destination(&args.output)?;
    let mut progress = Progress::new(output);
    progress.warn_all(&settled);
    let made = make(&recipe, &args.output, &mut |what, part| {
        progress.stage(what, part);
        if interrupt::asked() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    match made {
        Err(SynthError::Stopped) => return Err(Interrupted.into()),
        other => other?,
    }
    progress.finish();
    let views = recipe.views.count;
    if output.json {
        print_json(&serde_json::json!({ "capture": json_path(&args.output), "views": views }));
    } else if !output.quiet {
        let plural = if views == 1 { "" } else { "s" };
        print_line(&format!(
            "{}: {views} view{plural} with known truth",
            args.output.display()
        ));
    }
    Ok(())
}
