//! Reading a whole capture: manifest, images in parallel, mesh, and whether they belong together.

use super::brackets::{self, Brackets, ExposureUse, Part, Response, Settings, Table};
use super::camera::Camera;
use super::crop::{self, Kept};
use super::error::CaptureError;
use super::isolated::isolated_pixels;
use super::manifest::{Frame, Manifest};
use super::mesh::Mesh;
use super::picture::{self, Encoding, Mask, Picture};
use super::raw::{self, WhiteBalance};
use super::{Capture, LightHemisphere, Photograph, View, mesh_file, needs};
use glam::{DAffine3, DVec2, DVec3};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Radiance from here on counts as infinite: its square is, and some programs write the largest number for infinity.
const INFINITE: f32 = 1e19;
/// Most points of the mesh tried when looking for one that a camera sees.
const SAMPLES: usize = 20_000;

impl Capture {
    /// Reads a capture from its folder or its `transforms.json`. Of large photographs only the part about the object is kept, if
    /// coverage says where that is, and of many of them blocks of pixels in place of each.
    pub fn load(path: &Path) -> Result<Self, CaptureError> {
        Self::read(path, true, Kept::Shared).map(|(capture, _)| capture)
    }

    /// [`Capture::load`] with every pixel about the object, however many there are.
    pub fn load_full(path: &Path) -> Result<Self, CaptureError> {
        Self::read(path, true, |_| Kept::Object).map(|(capture, _)| capture)
    }

    /// Reads a capture with all pixels, and counts the bad ones that its views had, one entry per view.
    pub fn load_counting(path: &Path) -> Result<(Self, Vec<PixelCounts>), CaptureError> {
        Self::read(path, true, |_| Kept::All)
    }

    /// [`Capture::load_counting`] of a capture whose mesh may lie where no camera sees it.
    pub fn load_unplaced(path: &Path) -> Result<(Self, Vec<PixelCounts>), CaptureError> {
        Self::read(path, false, |_| Kept::All)
    }

    fn read(
        path: &Path,
        placed: bool,
        kept: impl Fn(usize) -> Kept,
    ) -> Result<(Self, Vec<PixelCounts>), CaptureError> {
        let mut manifest = Manifest::read(path)?;
        let mut warnings = Vec::from_iter(manifest.leave_out_missing());
        let table = Table::beside(&manifest.folder)?;
        brackets::settle(&mut manifest, &table)?;
        let firsts = needs::first_alike(&manifest.frames);
        let kept = kept(manifest.frames.len());
        needs::check(&manifest, &firsts, kept)?;
        let exposures = manifest.frames.iter().flat_map(|frame| &frame.exposures);
        let white = raw::white_balance(exposures.map(|exposure| exposure.path.as_path()));
        let white = white.as_ref();
        let read = |frame: &Frame| read_frame(&manifest, frame, white);
        let several = manifest.frames.iter().filter(|f| f.exposures.len() > 1);
        let response = brackets::response(&several.collect::<Vec<_>>(), &|frame| read(frame))?;
        let (photographs, mesh) = rayon::join(
            || read_photographs(&manifest, &firsts, white, &response, kept),
            || {
                let mesh_path = manifest.mesh_path.as_deref();
                let file = mesh_file::find(&manifest.folder, mesh_path, &manifest.path)?;
                let transform = manifest.mesh_transform.as_ref();
                let (mesh, warnings) = mesh_file::read(&file, transform)?;
                Ok((file, mesh, warnings))
            },
        );
        let photographs = photographs?;
        let (mesh_path, mesh, mesh_warnings) = mesh?;
        let mut tally = Tally::default();
        let mut uses = Vec::with_capacity(firsts.len());
        let mut views = Vec::with_capacity(firsts.len());
        for (i, (frame, &first)) in manifest.frames.iter().zip(&firsts).enumerate() {
            let Some(read) = &photographs[first] else {
                continue;
            };
            if i == first {
                warnings.extend(read.warnings.iter().cloned());
            }
            uses.push(read.uses.clone());
            tally.count_encoding(read.encoding);
            tally.pixels.push((frame.name.clone(), read.counts));
            let camera = camera_of(frame, &read.photograph, frame.world_from_camera);
            views.push(View {
                name: frame.name.clone(),
                camera: camera.seen_about(mesh.origin),
                photograph: Arc::clone(&read.photograph),
            });
        }
        tally.report(&mut warnings);
        warnings.extend(crop::note(&views));
        let brackets = uses
            .iter()
            .any(|uses| !uses.is_empty())
            .then_some(Brackets {
                response,
                views: uses,
            });
        warnings.extend(brackets.as_ref().and_then(Brackets::note));
        warnings.extend(mesh_warnings);
        let place = place_cameras(&manifest, &mut views, &mesh, mesh_path, &mut warnings);
        if placed {
            place?;
        }
        let light_hemisphere = hemisphere(&manifest, &views, &mesh, &mut warnings);
        let capture = Self {
            name: name_of(&manifest.folder),
            views,
            mesh,
            light_hemisphere,
            is_developed: tally.single_srgb == tally.pixels.len(),
            brackets,
            warnings,
        };
        let counts = tally.pixels.into_iter().map(|(_, counts)| counts).collect();
        Ok((capture, counts))
    }
}

/// What is read of a capture, or of a file with cameras: the manifest, the photographs, masks and mesh that it names, and the
/// path itself. Only the manifest is read.
pub fn input_files(path: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let manifest = Manifest::read(path)?;
    let mut files = vec![manifest.path.clone()];
    for frame in manifest.frames {
        files.extend(frame.exposures.into_iter().map(|exposure| exposure.path));
        files.extend(frame.mask);
    }
    // Cameras may have no mesh; a capture's that is missing is said when it is loaded.
    let mesh_path = manifest.mesh_path.as_deref();
    files.extend(mesh_file::find(&manifest.folder, mesh_path, &manifest.path));
    files.push(path.to_owned());
    Ok(files)
}

/// Reads only the cameras of a `transforms.json`, with the frames' names, for rendering from them what lies about `origin`
/// ([`Mesh::origin`]). Image sizes come from the manifest or else from the images' headers.
pub fn read_cameras(path: &Path, origin: DVec3) -> Result<Vec<(String, Camera)>, CaptureError> {
    let manifest = Manifest::read(path)?;
    manifest
        .frames
        .iter()
        .map(|frame| {
            let size = if let (Some(width), Some(height)) = frame.lens.size {
                (width, height)
            } else {
                let first = &frame.exposures[0];
                picture::read_size(&first.path, &first.field)?
            };
            if u64::from(size.0) * u64::from(size.1) > picture::MAX_PIXELS {
                return Err(CaptureError::Field {
                    path: manifest.path.clone(),
                    field: frame.field.clone(),
                    problem: format!("asks for {}×{} pixels", size.0, size.1),
                    advice: format!(
                        "reduce w and h to {} million pixels at most",
                        picture::MAX_PIXELS / 1_000_000
                    ),
                });
            }
            let camera = frame.lens.camera(size, frame.world_from_camera);
            Ok((frame.name.clone(), camera.seen_about(origin)))
        })
        .collect()
}

/// Reads any image file as linear radiance: width, height and RGB row by row from the top. Values that are not finite
/// become zero.
pub fn read_radiance(path: &Path) -> Result<(u32, u32, Vec<[f32; 3]>), CaptureError> {
    let picture = read_covered(path)?;
    Ok((picture.width, picture.height, picture.radiance))
}

/// Reads a light probe: a lat-long picture of the light from everywhere, twice as wide as high, in floating point and with light in
/// it. Linear radiance as stored, RGB, row by row from the top; negative values become zero.
pub fn read_probe(path: &Path) -> Result<(u32, u32, Vec<[f32; 3]>), CaptureError> {
    let picture = Picture::read(path, "file", true, None, &|_| Ok(()))?;
    let refused = |problem: String, advice: &str| {
        Err(CaptureError::NoProbe {
            path: path.to_owned(),
            problem,
            advice: advice.to_owned(),
        })
    };
    if picture.encoding != Encoding::Float {
        return refused(
            "its values end at white, and lights are brighter than that".to_owned(),
            "give an EXR or Radiance HDR picture",
        );
    }
    let (width, height) = (picture.width, picture.height);
    if u64::from(width) != 2 * u64::from(height) {
        return refused(
            format!(
                "it is {width}×{height} pixels, and a lat-long picture of the light all around is twice as wide as high"
            ),
            "unwrap it to one",
        );
    }
    let is_finite = |pixel: &&[f32; 3]| pixel.iter().all(|v| v.is_finite());
    let broken = picture.rgb.len() - picture.rgb.iter().filter(is_finite).count();
    if broken > 0 {
        return refused(
            format!("{broken} of its pixels are not finite numbers"),
            "export it anew without them",
        );
    }
    if picture.rgb.as_flattened().iter().all(|&v| v <= 0.0) {
        return refused(
            "it is black everywhere".to_owned(),
            "give a picture with light in it",
        );
    }
    let radiance = picture.rgb.iter().map(|p| p.map(|v| v.max(0.0)));
    Ok((width, height, radiance.collect()))
}

/// A picture with the object's coverage of each pixel.
pub struct Covered {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Linear radiance, RGB, premultiplied by coverage, row by row from the top.
    pub radiance: Vec<[f32; 3]>,
    /// Coverage of each pixel; 1 everywhere in a file that doesn't state it.
    pub coverage: Vec<f32>,
}

/// Reads any image file as linear radiance and coverage. Values that are not finite become zero.
pub fn read_covered(path: &Path) -> Result<Covered, CaptureError> {
    let picture = Picture::read(path, "file", true, None, &|_| Ok(()))?;
    let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
    let pixels = picture.rgb.len();
    Ok(Covered {
        width: picture.width,
        height: picture.height,
        radiance: picture.rgb.iter().map(|p| p.map(finite)).collect(),
        coverage: picture.alpha.unwrap_or_else(|| vec![1.0; pixels]),
    })
}

/// The folder's name, also where the path is `.`.
fn name_of(folder: &Path) -> String {
    let full = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    full.file_name().map_or_else(
        || "capture".to_owned(),
        |n| n.to_string_lossy().into_owned(),
    )
}

/// What came of the files of a frame.
struct Read {
    photograph: Arc<Photograph>,
    counts: PixelCounts,
    encoding: Encoding,
    uses: Vec<ExposureUse>,
    warnings: Vec<String>,
}

/// The photographs of all frames, decoded in parallel, merged and cleaned; those that have the files of an earlier one, as
/// `firsts` says, are left out. The first error is that of the first frame with one.
fn read_photographs(
    manifest: &Manifest,
    firsts: &[usize],
    white: Option<&WhiteBalance>,
    response: &Response,
    kept: Kept,
) -> Result<Vec<Option<Read>>, CaptureError> {
    let read: Vec<Result<Option<Read>, CaptureError>> = manifest
        .frames
        .par_iter()
        .enumerate()
        .map(|(i, frame)| {
            let own = firsts[i] == i;
            own.then(|| read_photograph(manifest, frame, white, response, kept))
                .transpose()
        })
        .collect();
    read.into_iter().collect()
}

/// Joins the files of a frame to one photograph.
fn read_photograph(
    manifest: &Manifest,
    frame: &Frame,
    white: Option<&WhiteBalance>,
    response: &Response,
    kept: Kept,
) -> Result<Read, CaptureError> {
    let merged = brackets::merge(read_frame(manifest, frame, white)?, response)?;
    let encoding = merged.picture.encoding;
    let mask = read_mask(manifest, frame, &merged.picture)?;
    let (photograph, counts) = clean(merged.picture, mask.as_ref());
    check_useful(&photograph, &frame.exposures[0].path)?;
    Ok(Read {
        photograph: Arc::new(kept.of(photograph)),
        counts,
        encoding,
        uses: merged.uses,
        warnings: merged.warnings,
    })
}

/// The camera at a pose that takes what is kept of a frame's photograph.
fn camera_of(frame: &Frame, photograph: &Photograph, pose: DAffine3) -> Camera {
    let kept = [photograph.width, photograph.height];
    let Some(crop) = photograph.crop else {
        return frame.lens.camera(kept.into(), pose);
    };
    frame
        .lens
        .camera(crop.whole.into(), pose)
        .cropped(crop, kept)
}

/// The mask of a frame, of the size of its picture.
fn read_mask(
    manifest: &Manifest,
    frame: &Frame,
    picture: &Picture,
) -> Result<Option<Mask>, CaptureError> {
    let Some(path) = &frame.mask else {
        return Ok(None);
    };
    let field = format!("{}.mask_path", frame.field);
    let mask = Mask::read(path, &field, !manifest.as_stored)?;
    let (found, stated) = ((mask.width, mask.height), (picture.width, picture.height));
    if found == stated {
        return Ok(Some(mask));
    }
    Err(CaptureError::ImageSize {
        path: path.clone(),
        found,
        stated,
        stated_by: format!("its image in {}", manifest.path.display()),
    })
}

fn read_frame(
    manifest: &Manifest,
    frame: &Frame,
    white: Option<&WhiteBalance>,
) -> Result<Vec<Part>, CaptureError> {
    frame
        .exposures
        .par_iter()
        .map(|exposure| {
            let check = |found: (u32, u32)| {
                let stated = (
                    frame.lens.size.0.unwrap_or(found.0),
                    frame.lens.size.1.unwrap_or(found.1),
                );
                if stated == found {
                    return Ok(());
                }
                Err(CaptureError::ImageSize {
                    path: exposure.path.clone(),
                    found,
                    stated,
                    stated_by: manifest.path.display().to_string(),
                })
            };
            let turned = !manifest.as_stored;
            let picture = Picture::read(&exposure.path, &exposure.field, turned, white, &check)?;
            Ok(Part {
                path: exposure.path.clone(),
                amount: exposure.settings.as_ref().map(Settings::amount),
                picture,
            })
        })
        .collect::<Vec<Result<Part, CaptureError>>>()
        .into_iter()
        .collect()
}

/// What was found in the pixels of one view before they were cleaned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PixelCounts {
    /// Black in the mask.
    pub masked: usize,
    /// Not finite: left out.
    pub non_finite: usize,
    /// At full scale in every exposure: how bright they are at least is kept.
    pub saturated: usize,
    /// Far brighter than all about them: left out.
    pub isolated: usize,
    /// Negative in some channel: set to zero there.
    pub negative: usize,
}

/// What all views together say about the input.
#[derive(Default)]
struct Tally {
    /// One per view, with its name.
    pixels: Vec<(String, PixelCounts)>,
    /// Number of views from one 8-bit file.
    single_srgb: usize,
    /// Number of views from one 16-bit file.
    single_linear: usize,
}

impl Tally {
    fn count_encoding(&mut self, encoding: Encoding) {
        match encoding {
            Encoding::Float | Encoding::Raw => {}
            Encoding::Linear16 => self.single_linear += 1,
            Encoding::Srgb8 => self.single_srgb += 1,
        }
    }

    /// "12 pixels in a.exr, b.exr" for the views where `count` is not zero.
    fn list(&self, count: impl Fn(&PixelCounts) -> usize) -> Option<String> {
        let found: Vec<(&str, usize)> = self
            .pixels
            .iter()
            .map(|(name, counts)| (name.as_str(), count(counts)))
            .filter(|(_, count)| *count > 0)
            .collect();
        let total: usize = found.iter().map(|(_, count)| count).sum();
        let names: Vec<&str> = found.iter().take(3).map(|(name, _)| *name).collect();
        let more = match found.len().saturating_sub(3) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let plural = if total == 1 { "" } else { "s" };
        (total > 0).then(|| format!("{total} pixel{plural} in {}{more}", names.join(", ")))
    }

    fn report(&self, warnings: &mut Vec<String>) {
        if let Some(list) = self.list(|counts| counts.non_finite) {
            warnings.push(format!("Not finite and left out: {list}."));
        }
        if let Some(list) = self.list(|counts| counts.negative) {
            warnings.push(format!("Negative and set to zero: {list}."));
        }
        if let Some(list) = self.list(|counts| counts.saturated) {
            warnings.push(format!(
                "Saturated: {list}. They say only how bright highlights are at least; take shorter exposures too."
            ));
        }
        if let Some(list) = self.list(|counts| counts.isolated) {
            warnings.push(format!(
                "Far brighter than all about them, as hot pixels are, and left out: {list}."
            ));
        }
        if self.single_srgb > 0 {
            warnings.push(format!(
                "Single 8-bit images, {} of them: their values are taken as sRGB-encoded and their highlights are \
                 clipped, so that lights may come out too weak. Use EXR files or several exposures.",
                self.single_srgb
            ));
        }
        if self.single_linear > 0 {
            warnings.push(format!(
                "16-bit images, {} of them, are taken as linear; export them without a tone curve.",
                self.single_linear
            ));
        }
    }
}

/// Makes every pixel finite and not negative and marks what is data.
fn clean(picture: Picture, mask: Option<&Mask>) -> (Photograph, PixelCounts) {
    let Picture {
        width,
        height,
        mut rgb,
        alpha,
        saturated,
        ..
    } = picture;
    let opaque = alpha
        .as_ref()
        .is_none_or(|alpha| alpha.iter().all(|&a| a == 1.0));
    let mut coverage = if opaque { None } else { alpha };
    if let (None, Some(mask)) = (&coverage, mask) {
        let white = mask.white.iter();
        coverage = Some(white.map(|&white| f32::from(u8::from(white))).collect());
    }
    let mut usable = vec![true; rgb.len()];
    let mut clipped = vec![false; rgb.len()];
    let mut counts = PixelCounts::default();
    for (i, pixel) in rgb.iter_mut().enumerate() {
        let masked = mask.is_some_and(|mask| !mask.white[i]);
        let cover = coverage.as_ref().map_or(1.0, |coverage| coverage[i]);
        let bad = if masked {
            Some(&mut counts.masked)
        } else if !pixel.iter().all(|v| v.abs() < INFINITE) || !cover.is_finite() {
            Some(&mut counts.non_finite)
        } else if saturated[i] && cover > 0.0 {
            Some(&mut counts.saturated)
        } else {
            None
        };
        if let Some(count) = bad {
            *count += 1;
            usable[i] = false;
            clipped[i] = !masked && saturated[i] && pixel.iter().all(|v| v.abs() < INFINITE);
            if !clipped[i] {
                *pixel = [0.0; 3];
            }
        } else if pixel.iter().any(|&v| v < 0.0) {
            counts.negative += 1;
            *pixel = pixel.map(|v| v.max(0.0));
        }
    }
    // A pixel beside a clipped one is no brighter than that.
    let known: Vec<bool> = usable.iter().zip(&clipped).map(|(u, c)| u | c).collect();
    for i in isolated_pixels(&rgb, &known, width as usize) {
        counts.isolated += 1;
        usable[i] = false;
        clipped[i] = false;
        rgb[i] = [0.0; 3];
    }
    if let Some(coverage) = &mut coverage {
        for value in coverage {
            *value = if value.is_finite() {
                value.clamp(0.0, 1.0)
            } else {
                0.0
            };
        }
    }
    let photograph = Photograph {
        width,
        height,
        radiance: rgb,
        coverage,
        usable,
        clipped: clipped.contains(&true).then_some(clipped),
        crop: None,
    };
    (photograph, counts)
}

/// Refuses images without a single pixel of data.
fn check_useful(photograph: &Photograph, path: &Path) -> Result<(), CaptureError> {
    let useless = |problem: &str, advice: &str| {
        Err(CaptureError::ImageUseless {
            path: path.to_owned(),
            problem: problem.to_owned(),
            advice: advice.to_owned(),
        })
    };
    if !photograph.usable.contains(&true) {
        return useless(
            "no pixel can be used: all are masked, saturated or not finite",
            "render or photograph it anew, or remove its frame",
        );
    }
    if photograph.radiance.iter().flatten().all(|&v| v == 0.0) {
        return useless(
            "the image is black: all usable pixels are zero",
            "render or photograph it anew, or remove its frame",
        );
    }
    Ok(())
}

/// Makes sure that some camera sees the mesh. Some programs move the mesh along with the cameras; if only the
/// matrices as written see it, they are used.
fn place_cameras(
    manifest: &Manifest,
    views: &mut [View],
    mesh: &Mesh,
    mesh_path: PathBuf,
    warnings: &mut Vec<String>,
) -> Result<(), CaptureError> {
    let seen = |views: &[View]| views.iter().any(|view| sees_any(&view.camera, mesh));
    if seen(views) {
        return Ok(());
    }
    if manifest.applied.is_some() {
        let undone: Vec<DAffine3> = views.iter().map(|v| v.camera.world_from_camera).collect();
        for (view, frame) in views.iter_mut().zip(&manifest.frames) {
            let camera = camera_of(frame, &view.photograph, frame.stated_pose);
            view.camera = camera.seen_about(mesh.origin);
        }
        if seen(views) {
            warnings.push(
                "The mesh is in the frame of the cameras as written, so applied_transform was not undone."
                    .to_owned(),
            );
            return Ok(());
        }
        for (view, pose) in views.iter_mut().zip(undone) {
            view.camera.world_from_camera = pose;
        }
    }
    Err(CaptureError::MeshUnseen { path: mesh_path })
}

/// Whether any of the mesh's points, or a sample of many, falls inside the camera's image, and all of them together are
/// larger there than a pixel: a mesh in other units than the cameras may lie in the middle of every image, as a speck.
fn sees_any(camera: &Camera, mesh: &Mesh) -> bool {
    let step = mesh.triangles.len().div_ceil(SAMPLES);
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    let mut inside = false;
    mesh.triangles.iter().step_by(step).any(|triangle| {
        let corners = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
        for pixel in corners.iter().filter_map(|&corner| camera.project(corner)) {
            (low, high) = (low.min(pixel), high.max(pixel));
        }
        let centre = corners.iter().sum::<DVec3>() / 3.0;
        inside |= camera.project(centre).is_some_and(|pixel| {
            pixel.min_element() >= 0.0
                && pixel.x <= f64::from(camera.width)
                && pixel.y <= f64::from(camera.height)
        });
        inside && (high - low).max_element() > 1.0
    })
}

/// The light hemisphere as stated, or up as the mean of the cameras' up vectors.
fn hemisphere(
    manifest: &Manifest,
    views: &[View],
    mesh: &Mesh,
    warnings: &mut Vec<String>,
) -> LightHemisphere {
    let up = manifest.light_hemisphere.up.unwrap_or_else(|| {
        // Those left out were held upright too, and often stood all around.
        let left_out = manifest.left_out.iter();
        let left_out = left_out.map(|frame| frame.world_from_camera.matrix3.y_axis);
        let ups = views.iter().map(|view| view.camera.up()).chain(left_out);
        let ups: Vec<DVec3> = ups.collect();
        let mean = ups.iter().sum::<DVec3>() / ups.len() as f64;
        let (up, from) = match mean.try_normalize() {
            Some(up) if mean.length() > 0.05 => (up, "the mean of the cameras' up vectors"),
            _ => (DVec3::Y, "the y axis, as the cameras' up vectors cancel"),
        };
        warnings.push(format!(
            "light_hemisphere.up is not stated: {from} is used, [{:.4}, {:.4}, {:.4}].",
            up.x, up.y, up.z
        ));
        up
    });
    if let Some(radius) = manifest.light_hemisphere.radius
        && radius <= 0.5 * f64::from(mesh.diagonal())
    {
        warnings.push(format!(
            "light_hemisphere.radius is {radius}, so that the hemisphere cuts through the object's bounding sphere of \
             radius {:.4}; check its unit.",
            0.5 * mesh.diagonal()
        ));
    }
    LightHemisphere {
        up,
        radius: manifest.light_hemisphere.radius,
        frame: manifest.light_hemisphere.frame,
    }
}
