//! The object as USD in its text form: a mesh with a preview surface, the light as a dome and the lamps as distant lights.
//!
//! The dome holds the whole light. The lamps are there too, switched off by their visibility: to relight, hide the dome and
//! show them. Lamps that are near shine themselves, and the dome holds the rest.

use std::fmt::{Display, Write as _};

use glam::{DMat4, Mat4, Quat, Vec3};

use super::asset::Asset;
use super::light_list::{ListedLamp, listed};
use super::obj::GlossFiles;
use rekindle_capture::Camera;

/// Files that the stage names.
pub struct Files<'a> {
    /// The base colour, PNG.
    pub base_colour: &'a str,
    /// Roughness and specular level of each texel, where parts differ.
    pub gloss: Option<GlossFiles<'a>>,
    /// The light that is not of near lamps, lat-long in USD's orientation.
    pub light: &'a str,
}

/// The stage as text.
pub fn stage(asset: &Asset, files: &Files) -> String {
    let mut text = String::from(
        "#usda 1.0\n(\n    defaultPrim = \"World\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\ndef Xform \"World\"\n{\n",
    );
    mesh(&mut text, asset);
    material(&mut text, asset, files);
    let _ = write!(
        text,
        "    def DomeLight \"Light\"\n    {{\n\
         \x20       asset inputs:texture:file = @{}@\n\
         \x20       token inputs:texture:format = \"latlong\"\n\
         \x20       float inputs:intensity = 1\n    }}\n",
        files.light
    );
    for (index, lamp) in listed(asset).iter().enumerate() {
        light(&mut text, index, lamp);
    }
    for (index, (_, camera)) in asset.cameras.iter().enumerate() {
        usd_camera(&mut text, index, camera);
    }
    text.push_str("}\n");
    text
}

/// Values in USD's notation of an array.
fn array<T: Display>(values: impl Iterator<Item = T>) -> String {
    let mut text = String::from("[");
    for (i, value) in values.enumerate() {
        let comma = if i == 0 { "" } else { ", " };
        // Writing into a string can't fail.
        let _ = write!(text, "{comma}{value}");
    }
    text.push(']');
    text
}

fn tuples(vectors: &[Vec3]) -> String {
    array(
        vectors
            .iter()
            .map(|v| format!("({}, {}, {})", v.x, v.y, v.z)),
    )
}

fn mesh(text: &mut String, asset: &Asset) {
    let mesh = &asset.mesh;
    let uvs = asset.uvs.iter().flatten();
    let least = mesh
        .positions
        .iter()
        .copied()
        .fold(Vec3::INFINITY, Vec3::min);
    let most = mesh
        .positions
        .iter()
        .copied()
        .fold(Vec3::NEG_INFINITY, Vec3::max);
    let _ = write!(
        text,
        "    def Mesh \"Object\" (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n    )\n    {{\n\
         \x20       uniform token subdivisionScheme = \"none\"\n\
         \x20       float3[] extent = {}\n\
         \x20       int[] faceVertexCounts = {}\n\
         \x20       int[] faceVertexIndices = {}\n\
         \x20       point3f[] points = {}\n\
         \x20       normal3f[] normals = {} (\n            interpolation = \"vertex\"\n        )\n\
         \x20       texCoord2f[] primvars:st = {} (\n            interpolation = \"faceVarying\"\n        )\n\
         \x20       rel material:binding = </World/Material>\n    }}\n",
        tuples(&[least, most]),
        array(mesh.triangles.iter().map(|_| 3)),
        array(mesh.triangles.iter().flatten()),
        tuples(&mesh.positions),
        tuples(&mesh.normals),
        array(uvs.map(|uv| format!("({}, {})", uv.x, uv.y))),
    );
}

/// A node that reads a texture, clamped at the edge.
fn texture(name: &str, file: &str, colours: &str, scale: f32) -> String {
    format!(
        "\n        def Shader \"{name}\"\n        {{\n\
         \x20           uniform token info:id = \"UsdUVTexture\"\n\
         \x20           asset inputs:file = @{file}@\n\
         \x20           token inputs:sourceColorSpace = \"{colours}\"\n\
         \x20           float4 inputs:scale = ({scale}, {scale}, {scale}, 1)\n\
         \x20           token inputs:wrapS = \"clamp\"\n\
         \x20           token inputs:wrapT = \"clamp\"\n\
         \x20           float2 inputs:st.connect = </World/Material/Place.outputs:result>\n\
         \x20           float outputs:r\n\
         \x20           float3 outputs:rgb\n        }}\n"
    )
}

/// The material with its textures.
fn material(text: &mut String, asset: &Asset, files: &Files) {
    let material = &asset.material;
    let mut textures = texture("BaseColour", files.base_colour, "sRGB", 1.0);
    let mut roughness = format!("float inputs:roughness = {}", material.roughness());
    let reflection = if let Some(gloss) = files.gloss {
        textures += &texture("Roughness", gloss.roughness, "raw", 1.0);
        textures += &texture("Specular", gloss.specular, "raw", asset.strongest().f0);
        "float inputs:roughness.connect = </World/Material/Roughness.outputs:r>"
            .clone_into(&mut roughness);
        "int inputs:useSpecularWorkflow = 1\n            \
         color3f inputs:specularColor.connect = </World/Material/Specular.outputs:rgb>"
            .to_owned()
    } else if material.model.is_some() {
        format!("float inputs:ior = {}", material.refractive_index())
    } else {
        "int inputs:useSpecularWorkflow = 1\n            color3f inputs:specularColor = (0, 0, 0)"
            .to_owned()
    };
    let _ = write!(
        text,
        "    def Material \"Material\"\n    {{\n\
         \x20       token outputs:surface.connect = </World/Material/Surface.outputs:surface>\n\n\
         \x20       def Shader \"Surface\"\n        {{\n\
         \x20           uniform token info:id = \"UsdPreviewSurface\"\n\
         \x20           color3f inputs:diffuseColor.connect = </World/Material/BaseColour.outputs:rgb>\n\
         \x20           {roughness}\n\
         \x20           float inputs:metallic = 0\n\
         \x20           {reflection}\n\
         \x20           token outputs:surface\n        }}\n\
         {textures}\n\
         \x20       def Shader \"Place\"\n        {{\n\
         \x20           uniform token info:id = \"UsdPrimvarReader_float2\"\n\
         \x20           string inputs:varname = \"st\"\n\
         \x20           float2 outputs:result\n        }}\n    }}\n",
    );
}

/// A 4×4 matrix in USD's notation: of row vectors, so that its rows are our columns.
fn matrix(columns: [[f64; 4]; 4]) -> String {
    let rows = columns.map(|[a, b, c, d]| format!("({a}, {b}, {c}, {d})"));
    format!("( {} )", rows.join(", "))
}

fn light(text: &mut String, index: usize, lamp: &ListedLamp) {
    let (colour, strength) = lamp.colour_and_strength();
    let turn = Quat::from_rotation_arc(Vec3::Z, lamp.direction);
    let place = lamp.position.unwrap_or(lamp.direction);
    let pose = Mat4::from_rotation_translation(turn, place).as_dmat4();
    let half = lamp.angular_radius;
    let (kind, shape, intensity) = match lamp.distance {
        // With `normalize` the intensity of a distant light is the irradiance of a surface that faces it.
        None => (
            "DistantLight",
            format!("float inputs:angle = {}", 2.0 * half.to_degrees()),
            strength,
        ),
        // That of a sphere is the radiance × its area: from outside π r² L is the radiant intensity.
        Some(distance) => (
            "SphereLight",
            format!("float inputs:radius = {}", distance * half.sin()),
            4.0 * strength * distance * distance,
        ),
    };
    let visibility = if lamp.distance.is_some() {
        ""
    } else {
        "        token visibility = \"invisible\"\n"
    };
    let [r, g, b] = colour;
    let _ = write!(
        text,
        "    def {kind} \"Light_{}\" (\n        displayName = \"{}\"\n    )\n    {{\n\
         {visibility}\
         \x20       {shape}\n\
         \x20       color3f inputs:color = ({r}, {g}, {b})\n\
         \x20       float inputs:intensity = {intensity}\n\
         \x20       bool inputs:normalize = 1\n\
         \x20       matrix4d xformOp:transform = {}\n\
         \x20       uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }}\n",
        index + 1,
        lamp.name.replace(['"', '\\', '\n'], "_"),
        matrix(pose.to_cols_array_2d()),
    );
}

fn usd_camera(text: &mut String, index: usize, camera: &Camera) {
    /// Apertures are in tenths of a unit, as lenses have them in millimetres.
    const APERTURE: f64 = 36.0;
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let per_pixel = APERTURE / width;
    // Pixels may be oblong; the focal length is that of the width.
    let tall = per_pixel * camera.focal.x / camera.focal.y;
    let pose = DMat4::from(camera.world_from_camera);
    let _ = write!(
        text,
        "    def Camera \"Camera_{}\"\n    {{\n\
         \x20       float focalLength = {}\n\
         \x20       float horizontalAperture = {APERTURE}\n\
         \x20       float verticalAperture = {}\n\
         \x20       float horizontalApertureOffset = {}\n\
         \x20       float verticalApertureOffset = {}\n\
         \x20       float2 clippingRange = (0.001, 100000)\n\
         \x20       matrix4d xformOp:transform = {}\n\
         \x20       uniform token[] xformOpOrder = [\"xformOp:transform\"]\n    }}\n",
        index + 1,
        camera.focal.x * per_pixel,
        height * tall,
        (0.5 * width - camera.centre.x) * per_pixel,
        (camera.centre.y - 0.5 * height) * tall,
        matrix(pose.to_cols_array_2d()),
    );
}
