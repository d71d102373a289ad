//! What a window asks of the renderer.

use rekindle_capture::Camera;
use rekindle_relight::ViewTransform;

/// What a picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Diffuse and specular radiance.
    #[default]
    Beauty,
    /// The diffuse part alone.
    Diffuse,
    /// The specular part alone.
    Specular,
    /// The pseudo-albedo, such that its brightest parts are white.
    Albedo,
    /// Irradiance: the radiance of a surface as bright as the object's brightest parts.
    Irradiance,
    /// Shading normals in the world, (n + 1)/2.
    Normals,
    /// What the surface sees of the lamp at this place in the lighting's list: 0 to 1.
    Shadow(usize),
    /// How far the texture is known, 0 to 1.
    Confidence,
    /// Roughness of the lobe as other programs call it, the root of its width α: 0 to 1, and 1 where nothing is reflected.
    Roughness,
    /// What the surface reflects specularly, as a part of what its strongest part does.
    Strength,
}

/// What is behind the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// A display colour (sRGB-encoded), whatever exposure and view transform are.
    Colour([f32; 3]),
    /// The light itself.
    Light,
}

/// A picture to be drawn.
#[derive(Clone, Debug)]
pub struct FrameRequest {
    /// Where it is taken from; its width and height are the picture's.
    pub camera: Camera,
    /// What it shows.
    pub mode: Mode,
    /// Exposure in stops; at 0 the surface's white is 1.
    pub exposure_ev: f32,
    /// From linear radiance to the screen.
    pub transform: ViewTransform,
    /// Behind the object.
    pub background: Background,
    /// Whether a lamp is being dragged: light is not baked before this ends.
    pub dragging: bool,
    /// Whether a picture of larger pixels may be drawn first, where the device is slow: a window answers at once then. Only
    /// [`Renderer::draw`](super::Renderer::draw) takes note of it.
    pub quick: bool,
}

impl Mode {
    /// The shader's number for it.
    pub(super) fn number(self) -> u32 {
        match self {
            Self::Beauty => 0,
            Self::Diffuse => 1,
            Self::Specular => 2,
            Self::Albedo => 3,
            Self::Irradiance => 4,
            Self::Normals => 5,
            Self::Shadow(_) => 6,
            Self::Confidence => 7,
            Self::Roughness => 8,
            Self::Strength => 9,
        }
    }

    /// How it is shown: 0 radiance, 1 linear without a view transform, 2 display values.
    pub(super) fn display_kind(self) -> u32 {
        match self {
            Self::Beauty | Self::Diffuse | Self::Specular | Self::Irradiance => 0,
            Self::Albedo => 1,
            Self::Normals
            | Self::Shadow(_)
            | Self::Confidence
            | Self::Roughness
            | Self::Strength => 2,
        }
    }
}
