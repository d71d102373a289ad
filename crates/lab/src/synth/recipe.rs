//! What a made capture is to be like.

use std::path::PathBuf;

use glam::Vec3;

use super::object::Object;
use rekindle_relight::srgb;
use rekindle_scene::reflectance::SpecularModel;

/// Everything that decides a made capture, to the last bit.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// The shape.
    pub object: Object,
    /// About how many triangles the photographed surface has.
    pub triangles: u32,
    /// 0: one albedo everywhere; 1: from nearly black to nearly white.
    pub texture_contrast: f32,
    /// How the surface reflects.
    pub material: Material,
    /// Whether the surface lights itself.
    pub interreflection: bool,
    /// Where the light comes from.
    pub light: Light,
    /// Where the photographs are taken from.
    pub views: Views,
    /// What the camera's sensor does to them.
    pub sensor: Sensor,
    /// What is wrong with the geometry that the capture states.
    pub errors: GeometryErrors,
    /// What else is wrong with the capture.
    pub mistake: Option<Mistake>,
    /// Whether the truth has pictures from elsewhere and under new light, which take most of the time.
    pub truth_pictures: bool,
    /// Decides everything that is random.
    pub seed: u64,
}

/// The specular lobe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Its form.
    pub model: SpecularModel,
    /// Roughness σ, radians.
    pub sigma: f32,
    /// K_S of eq. 4.
    pub strength: f32,
    /// Index of refraction that the strength is that of; `None` in the paper's model and for metals.
    pub refractive_index: Option<f32>,
}

impl Material {
    /// The paper's lobe (eq. 4) of a strength K_S.
    pub fn paper(sigma: f32, strength: f32) -> Self {
        Self {
            model: SpecularModel::Paper,
            sigma,
            strength,
            refractive_index: None,
        }
    }

    /// A metal's lobe of a strength K_S.
    pub fn metal(sigma: f32, strength: f32) -> Self {
        Self {
            model: SpecularModel::Metal,
            ..Self::paper(sigma, strength)
        }
    }

    /// A dielectric's lobe, whose strength F(normal incidence)/(8πσ²) follows from the index of refraction.
    pub fn dielectric(model: SpecularModel, sigma: f32, refractive_index: f32) -> Self {
        let amplitude = (refractive_index - 1.0) / (refractive_index + 1.0);
        Self {
            model,
            sigma,
            strength: amplitude * amplitude / (8.0 * std::f32::consts::PI * sigma * sigma),
            refractive_index: Some(refractive_index),
        }
    }
}

/// The light.
#[derive(Clone, Debug, PartialEq)]
pub enum Light {
    /// Round lamps.
    Lamps(Lamps),
    /// A lat-long picture of distant light.
    Probe(PathBuf),
}

/// Round lamps of one size.
#[derive(Clone, Debug, PartialEq)]
pub struct Lamps {
    /// Where they are.
    pub places: Places,
    /// Angular radius seen from the object's centre, radians.
    pub angular_radius: f32,
    /// How many times the strongest is as strong as the weakest.
    pub contrast: f32,
    /// 0: white; 1: saturated colours.
    pub tint: f32,
    /// Distance from the object's centre in mesh units, `None` for distant lamps.
    pub distance: Option<f32>,
}

/// Where lamps are.
#[derive(Clone, Debug, PartialEq)]
pub enum Places {
    /// This many, all over the front of the hemisphere.
    Spread(u32),
    /// This many in a row, neighbours this many radians apart.
    Row(u32, f32),
    /// Azimuth from the front towards +X, and elevation, radians.
    At(Vec<[f32; 2]>),
}

/// The photographs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Views {
    /// How many.
    pub count: u32,
    /// Azimuths that they are spread over, radians.
    pub arc: f32,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Sub-pixels along each side of a pixel, each with the reference renderer's samples.
    pub supersampling: u32,
    /// Factor of all radiances.
    pub scale: f32,
    /// Whether the object turns before one camera, with which the light stands still; lamps are as they are at the first view then.
    pub turntable: bool,
}

/// What a sensor does to a photograph, in this order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Standard deviation of the photon noise at the object's mean radiance, as a part of it.
    pub noise: f32,
    /// Part of the object's pixels that show something unrelated.
    pub outliers: f32,
    /// Part of the highlights' pixels that are clipped.
    pub saturated: f32,
    /// Standard deviation of a view's unstated gain, as a part of it.
    pub gain_error: f32,
    /// The files.
    pub files: Files,
    /// How the files of brackets are encoded.
    pub response: Encode,
}

/// How a camera encodes linear light, on [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encode {
    /// By sRGB's curve.
    Srgb,
    /// By a gamma of 1.8.
    Gamma,
    /// With a toe and a shoulder, as film.
    Film,
}

impl Encode {
    /// The code of a relative exposure, both 1 at full scale.
    pub(super) fn code(self, exposure: f32) -> f32 {
        let v = exposure.clamp(0.0, 1.0);
        match self {
            Self::Srgb => srgb(Vec3::splat(v)).x,
            Self::Gamma => v.powf(1.0 / 1.8),
            Self::Film => {
                let x = v.sqrt();
                let toe = x / (x + 0.01);
                let shoulder = 1.6 * x / (0.6 + x);
                shoulder * toe * 1.01
            }
        }
    }
}

/// How photographs are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Files {
    /// One EXR file a view. Clipped pixels can't be told from others.
    Exr,
    /// EXR files of exposure times that differ by up to this many stops, and are stated.
    Exposures(u32),
    /// 8-bit PNG files.
    Brackets {
        /// How many a view.
        count: u32,
        /// How many stops they are apart.
        stops: u32,
    },
}

/// What is wrong with the geometry that a capture states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometryErrors {
    /// Angle by which every camera is turned, radians.
    pub rotation: f32,
    /// Standard deviation of the vertices' places along their normals, as a part of the object's diagonal.
    pub vertex_noise: f32,
    /// About how many triangles the capture's mesh has, `None` for the photographed surface itself.
    pub triangles: Option<u32>,
    /// Where the mesh's normals come from.
    pub normals: Normals,
    /// Standard deviation of the normals' tilt in each of two directions, radians.
    pub normal_noise: f32,
}

/// One thing that is wrong with a capture and that nothing in it states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mistake {
    /// Photographs without alpha, of the object before a background as bright as itself.
    Background,
    /// Linear files with sRGB-encoded values.
    Encoded,
    /// One view four times as bright.
    BrighterView,
    /// One view of another white balance, 5 % in red and blue.
    WhiteBalance,
    /// One camera half a degree further round the object than it stood.
    OrbitedCamera,
    /// One camera nearer than it stood by 2 % of its distance.
    NearerCamera,
    /// One view out of focus.
    Defocused,
    /// A mesh that lacks a fifth of its triangles.
    Holes,
    /// Twenty pixels of each view a thousand times too bright.
    HotPixels,
}

impl Mistake {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Background,
        Self::Encoded,
        Self::BrighterView,
        Self::WhiteBalance,
        Self::OrbitedCamera,
        Self::NearerCamera,
        Self::Defocused,
        Self::Holes,
        Self::HotPixels,
    ];
}

/// Where a mesh's normals come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Normals {
    /// From the exact shape.
    Exact,
    /// From the triangles around each vertex.
    Faces,
}

impl Default for Recipe {
    /// The paper's surface and light, 640×480 from six views, without any fault.
    fn default() -> Self {
        Self {
            object: Object::Figurine,
            triangles: 30_000,
            texture_contrast: 0.5,
            material: Material::paper(0.075, 0.4),
            interreflection: false,
            light: Light::Lamps(Lamps {
                places: Places::Spread(3),
                angular_radius: 3.0_f32.to_radians(),
                contrast: 3.0,
                tint: 0.0,
                distance: None,
            }),
            views: Views {
                count: 6,
                arc: 150.0_f32.to_radians(),
                size: [640, 480],
                supersampling: 2,
                scale: 1.0,
                turntable: false,
            },
            sensor: Sensor {
                noise: 0.0,
                outliers: 0.0,
                saturated: 0.0,
                gain_error: 0.0,
                files: Files::Exr,
                response: Encode::Srgb,
            },
            errors: GeometryErrors {
                rotation: 0.0,
                vertex_noise: 0.0,
                triangles: None,
                normals: Normals::Exact,
                normal_noise: 0.0,
            },
            mistake: None,
            truth_pictures: true,
            seed: 1,
        }
    }
}
