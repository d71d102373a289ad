//! The light as lat-long maps, turned as the program that reads them expects.
//!
//! All programs see the world from inside, not mirrored, with the top row up, and differ by a turn only:
//!
//! | program | u of +X | u of +Z | where it is written |
//! | --- | --- | --- | --- |
//! | Blender (an object imported by its default axes), three.js | 0.50 | 0.75 | Cycles' `projection.h`, three's `equirectUv` |
//! | OpenEXR, USD's DomeLight, Mitsuba | 0.25 | 0.50 | OpenUSD's `usdLux` schema, Mitsuba's `envmap.cpp` |
//! | nvdiffrec, Stanford-ORB | 0.75 | 0.00 | nvdiffrec's `render/util.py` |

use std::f32::consts::TAU;

use glam::{Quat, Vec3};

use super::asset::Asset;
use rekindle_relight::LightNode;
use rekindle_scene::hemisphere::{Picture, SkyPiece, lat_long_of};

/// Patches of an environment are rectangles with gaps between their nodes: these reach further than a lamp's.
const ENVIRONMENT_REACH: f32 = 2.5;
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
    pub fn map(&self, asset: &Asset, part: Part) -> Picture {
        let lighting = &asset.lighting;
        let mut pieces = Vec::new();
        match part {
            Part::Lamp(index) => pieces.extend(lighting.lamps[index].nodes.iter().map(piece)),
            Part::Whole => pieces.extend(lighting.lamps.iter().flat_map(|l| &l.nodes).map(piece)),
            Part::Rest => {}
        }
        let mut everywhere = Vec3::ZERO;
        if !matches!(part, Part::Lamp(_)) {
            pieces.extend(lighting.remainder.iter().map(piece));
            let patches = lighting.environment.iter().flat_map(|l| &l.nodes);
            pieces.extend(patches.map(|node| {
                let piece = piece(node);
                SkyPiece {
                    reach: ENVIRONMENT_REACH * piece.reach,
                    ..piece
                }
            }));
            everywhere = lighting.ambient;
        }
        self.draw(pieces, everywhere)
    }

    /// Dots at +X (red), +Y (green) and +Z (blue) on dark grey, to see how a program turns the map.
    pub fn calibration(&self) -> Picture {
        let solid_angle = TAU * (1.0 - DOT.cos());
        let axes = [Vec3::X, Vec3::Y, Vec3::Z];
        let dots = axes.map(|axis| SkyPiece::new(axis, axis, solid_angle));
        self.draw(dots.to_vec(), Vec3::splat(0.05))
    }

    fn draw(&self, mut pieces: Vec<SkyPiece>, everywhere: Vec3) -> Picture {
        // Turning a direction by −φ about +Y moves it by φ to the right.
        let right = self.orientation.offset() * TAU + self.yaw_deg.to_radians();
        let turn = Quat::from_rotation_y(-right);
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
