//! The light as lat-long maps, turned as the program that reads them expects.
//!
//! All programs see the world from inside, not mirrored, with the top row up, and differ by a turn only:
//!
//! | program | u of +X | u of +Z | where it is written |
//! | --- | --- | --- | --- |
//! | Blender (an object imported by its default axes), three.js | 0.50 | 0.75 | Cycles' `projection.h`, three's `equirectUv` |
//! | OpenEXR, USD's DomeLight, Mitsuba | 0.25 | 0.50 | OpenUSD's `usdLux` schema, Mitsuba's `envmap.cpp` |
//! | nvdiffrec, Stanford-ORB | 0.75 | 0.00 | nvdiffrec's `render/util.py` |

use std::f32::consts::{PI, TAU};

use glam::{DVec3, Quat, Vec2, Vec3};
use rayon::prelude::*;

use super::asset::Asset;
use rekindle_relight::{Environment, LampNodes, LightNode};
use rekindle_scene::hemisphere::{Picture, SkyPiece, direction_from_lat_long, lat_long_of};

/// Half the angle of the calibration map's dots, radians.
const DOT: f32 = 0.07;

/// A program's way to lay out a lat-long map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Orientation {
    /// Blender's Environment Texture, for an object imported by its default axes
    #[default]
    Blender,
    /// three.js and its viewers
    Three,
    /// The OpenEXR convention
    Openexr,
    /// USD's `DomeLight`
    Usd,
    /// Mitsuba's `envmap`
    Mitsuba,
    /// nvdiffrec and Stanford-ORB
    Nvdiffrec,
}

impl Orientation {
    /// How far to the right of Blender's this map shows things, as a part of its width.
    fn offset(self) -> f32 {
        match self {
            Self::Blender | Self::Three => 0.0,
            Self::Openexr | Self::Usd | Self::Mitsuba => -0.25,
            Self::Nvdiffrec => 0.25,
        }
    }
}

/// How maps are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapLayout {
    /// Columns; rows are half as many.
    pub width: u32,
    /// The program's.
    pub orientation: Orientation,
    /// A further turn to the right, degrees.
    pub yaw_deg: f32,
}

/// Which part of the light a map shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Everything.
    Whole,
    /// One lamp.
    Lamp(usize),
    /// What belongs to no lamp: ambient light, environment and single lit nodes.
    Rest,
}

impl MapLayout {
    /// The same size in another program's orientation.
    #[must_use]
    pub fn oriented(self, orientation: Orientation) -> Self {
        Self {
            orientation,
            yaw_deg: 0.0,
            ..self
        }
    }

    /// A part of the light. Σ radiance × solid angle over the pixels is that over the nodes, and 4π × the ambient part.
    /// An environment is shown as it was given.
    pub fn map(&self, asset: &Asset, part: Part) -> Picture {
        let lighting = &asset.lighting;
        let mut pieces = Vec::new();
        match part {
            Part::Lamp(index) => pieces.extend(lighting.lamps[index].nodes.iter().map(piece)),
            Part::Whole => pieces.extend(lighting.lamps.iter().flat_map(|l| &l.nodes).map(piece)),
            Part::Rest => {}
        }
        let mut everywhere = Vec3::ZERO;
        let mut environment = None;
        if !matches!(part, Part::Lamp(_)) {
            pieces.extend(lighting.remainder.iter().map(piece));
            everywhere = lighting.ambient;
            environment = lighting.environment.as_ref();
            let suns = environment.iter().flat_map(|e| &e.suns);
            pieces.extend(suns.flat_map(|sun| &sun.nodes).map(piece));
        }
        let mut picture = self.draw(pieces, everywhere);
        if let Some(environment) = environment {
            self.add_sky(&mut picture, environment);
        }
        picture
    }

    /// Adds an environment's light but for its suns.
    fn add_sky(&self, picture: &mut Picture, environment: &Environment) {
        let (width, height) = (picture.width, picture.height);
        let back = self.turn().inverse();
        let spread = 0.5 * PI / height as f32;
        let of_pixel = |i: u32| {
            let place = Vec2::new((i % width) as f32, (i / width) as f32) + 0.5;
            let uv = place / Vec2::new(width as f32, height as f32);
            let angle = (TAU / width as f32) * (PI / height as f32) * (PI * uv.y).sin();
            let direction = back * direction_from_lat_long(uv);
            (environment.sky.radiance(direction, spread), angle)
        };
        let shown: Vec<(Vec3, f32)> = (0..width * height).into_par_iter().map(of_pixel).collect();
        let flux = |of: DVec3| of.max(DVec3::splat(f64::MIN_POSITIVE));
        let in_picture: DVec3 = (shown.iter())
            .map(|(radiance, angle)| (*radiance * *angle).as_dvec3())
            .sum();
        let all: Vec3 = environment.patches.iter().map(LampNodes::flux).sum();
        let held = (flux(all.as_dvec3()) / flux(in_picture)).as_vec3();
        for (pixel, (radiance, _)) in picture.radiance.iter_mut().zip(shown) {
            *pixel = (Vec3::from(*pixel) + held * radiance).to_array();
        }
    }

    /// How directions are turned for the picture.
    fn turn(&self) -> Quat {
        // Turning a direction by −φ about +Y moves it by φ to the right.
        let right = self.orientation.offset() * TAU + self.yaw_deg.to_radians();
        Quat::from_rotation_y(-right)
    }

    /// Dots at +X (red), +Y (green) and +Z (blue) on dark grey, to see how a program turns the map.
    pub fn calibration(&self) -> Picture {
        let solid_angle = TAU * (1.0 - DOT.cos());
        let axes = [Vec3::X, Vec3::Y, Vec3::Z];
        let dots = axes.map(|axis| SkyPiece::new(axis, axis, solid_angle));
        self.draw(dots.to_vec(), Vec3::splat(0.05))
    }

    fn draw(&self, mut pieces: Vec<SkyPiece>, everywhere: Vec3) -> Picture {
        let turn = self.turn();
        for piece in &mut pieces {
            piece.direction = turn * piece.direction;
        }
        let mut picture = lat_long_of(&pieces, self.width / 2);
        for pixel in &mut picture.radiance {
            *pixel = (Vec3::from(*pixel) + everywhere).to_array();
        }
        picture
    }
}

fn piece(node: &LightNode) -> SkyPiece {
    SkyPiece::new(node.direction, node.radiance, node.solid_angle)
}
