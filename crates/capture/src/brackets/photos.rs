//! Brackets outside of a capture: photographs in folders, or the files of a manifest, merged one view after the other.

use super::groups::{Group, Photo, group};
use super::merge::{ExposureUse, Merged, Part, merge};
use super::response::Response;
use super::shot::{OPTIONAL, Settings, Shot};
use super::table::{TABLE, Table};
use crate::error::CaptureError;
use crate::manifest::Manifest;
use crate::picture::Picture;
use crate::raw::{self, WhiteBalance};
use rayon::prelude::*;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Endings of the files that are taken for photographs, beside those of raw files.
const ENDINGS: [&str; 7] = ["jpg", "jpeg", "png", "tif", "tiff", "exr", "hdr"];
const JPEG: [&str; 2] = ["jpg", "jpeg"];

/// Photographs in groups that are to be merged.
#[derive(Debug)]
pub struct Photos {
    /// At least one.
    pub groups: Vec<Group>,
    /// What raw files of its camera are developed with.
    white: Option<WhiteBalance>,
}

/// A group merged to linear radiance.
#[derive(Debug)]
pub struct MergedPhoto {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Radiance, RGB, premultiplied by alpha, row by row from the top; infinite where every exposure is clipped.
    pub radiance: Vec<[f32; 3]>,
    /// Coverage, if the files have it.
    pub alpha: Option<Vec<f32>>,
    /// What each exposure gave, the longest first; empty for a single file.
    pub uses: Vec<ExposureUse>,
    /// Number of pixels that are clipped in every exposure.
    pub saturated: usize,
    /// What a user should know.
    pub warnings: Vec<String>,
}

impl Photos {
    /// Finds photographs in files and folders, with exposures by a table, by the one in the first folder, or by EXIF data; the
    /// brackets of a manifest if there is but one path and it is that of one.
    pub fn find(paths: &[PathBuf], table: Option<&Path>) -> Result<Self, CaptureError> {
        let folder = paths.first().map_or(Path::new("."), |first| {
            if first.is_dir() {
                first
            } else {
                first.parent().unwrap_or(Path::new("."))
            }
        });
        let table = match table {
            Some(path) => Table::read(path)?,
            None => Table::beside(folder)?,
        };
        if let [only] = paths
            && (only.join("transforms.json").is_file() || has_ending(only, &["json"]))
        {
            return Self::of_manifest(only, &table);
        }
        let mut files = Vec::new();
        for path in paths {
            add_files(path, &mut files)?;
        }
        let photos: Vec<Photo> = files
            .into_par_iter()
            .map(|path| {
                let mut shot = Shot::read(&path);
                shot.settings = table.settings(&path).or(shot.settings);
                Photo { path, shot }
            })
            .collect();
        check_known(&photos)?;
        let groups = group(photos);
        check_brackets(&groups)?;
        Ok(Self::of(groups))
    }

    fn of(groups: Vec<Group>) -> Self {
        let photos = groups.iter().flat_map(|group| &group.photos);
        let white = raw::white_balance(photos.map(|photo| photo.path.as_path()));
        Self { groups, white }
    }

    fn of_manifest(path: &Path, table: &Table) -> Result<Self, CaptureError> {
        let mut manifest = Manifest::read(path)?;
        super::settle(&mut manifest, table)?;
        let photos = manifest.frames.into_iter().map(|frame| {
            let name = Path::new(&frame.name).file_stem();
            Group {
                name: name.map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
                photos: frame
                    .exposures
                    .into_iter()
                    .map(|exposure| Photo {
                        path: exposure.path,
                        shot: Shot {
                            settings: exposure.settings,
                            ..Shot::default()
                        },
                    })
                    .collect(),
            }
        });
        let mut groups: Vec<Group> = photos.collect();
        super::groups::tell_apart(&mut groups);
        Ok(Self::of(groups))
    }

    /// The response of the camera that took them all.
    pub fn response(&self) -> Result<Response, CaptureError> {
        let several: Vec<&Group> = self.groups.iter().filter(|g| g.photos.len() > 1).collect();
        super::response(&several, &|group: &Group| self.read(group))
    }

    /// Merges one of the groups.
    pub fn merge(&self, group: usize, response: &Response) -> Result<MergedPhoto, CaptureError> {
        let Merged {
            picture,
            uses,
            warnings,
        } = merge(self.read(&self.groups[group])?, response)?;
        let clipped = picture.saturated.iter().zip(picture.rgb);
        Ok(MergedPhoto {
            width: picture.width,
            height: picture.height,
            saturated: picture.saturated.iter().filter(|&&s| s).count(),
            radiance: clipped
                .map(|(&saturated, rgb)| if saturated { [f32::INFINITY; 3] } else { rgb })
                .collect(),
            alpha: picture.alpha,
            uses,
            warnings,
        })
    }

    /// Decodes the files of a group.
    fn read(&self, group: &Group) -> Result<Vec<Part>, CaptureError> {
        let white = self.white.as_ref();
        let read = |photo: &Photo| {
            Ok(Part {
                path: photo.path.clone(),
                amount: photo.shot.settings.as_ref().map(Settings::amount),
                picture: Picture::read(&photo.path, "the command", true, white, &|_| Ok(()))?,
            })
        };
        let parts: Vec<Result<Part, CaptureError>> = group.photos.par_iter().map(read).collect();
        parts.into_iter().collect()
    }
}

/// Whether a file of a folder is taken for a photograph.
fn is_photograph(path: &Path) -> bool {
    has_ending(path, &ENDINGS) || raw::is_raw(path)
}

/// Leaves the JPEG files out that cameras write beside raw files: each is the same photograph once more.
fn leave_out_doubles(files: &mut Vec<PathBuf>) {
    let raw: HashSet<PathBuf> = (files.iter())
        .filter(|path| raw::is_raw(path))
        .map(|path| path.with_extension(""))
        .collect();
    files.retain(|path| !has_ending(path, &JPEG) || !raw.contains(&path.with_extension("")));
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    ending.is_some_and(|ending| endings.contains(&ending.as_str()))
}

fn refusal(path: &Path, problem: String, advice: &str) -> CaptureError {
    CaptureError::Exposure {
        path: path.to_owned(),
        problem,
        advice: advice.to_owned(),
    }
}

/// Adds a file, or the photographs of a folder and of the folders in it.
fn add_files(path: &Path, files: &mut Vec<PathBuf>) -> Result<(), CaptureError> {
    if !path.exists() {
        return Err(CaptureError::NoSuchFolder {
            path: path.to_owned(),
        });
    }
    if path.is_file() {
        files.push(path.to_owned());
        return Ok(());
    }
    let list = |folder: &Path| -> Result<Vec<PathBuf>, CaptureError> {
        let entries = std::fs::read_dir(folder).map_err(|source| CaptureError::Unreadable {
            path: folder.to_owned(),
            source,
        })?;
        Ok(entries
            .filter_map(|entry| Some(entry.ok()?.path()))
            .collect())
    };
    let before = files.len();
    for entry in list(path)? {
        if entry.is_dir() {
            let inside = list(&entry)?;
            files.extend(
                inside
                    .into_iter()
                    .filter(|p| p.is_file() && is_photograph(p)),
            );
        } else if is_photograph(&entry) {
            files.push(entry);
        }
    }
    leave_out_doubles(files);
    if files.len() == before {
        return Err(refusal(
            path,
            "no photographs in this folder".to_owned(),
            "give a folder of raw, JPEG, PNG, TIFF, EXR or HDR files, or the files themselves",
        ));
    }
    Ok(())
}

/// Refuses photographs without an exposure, and those of which only some state aperture or sensitivity.
fn check_known(photos: &[Photo]) -> Result<(), CaptureError> {
    let advice =
        format!("list it in {TABLE} beside the photographs, a line file,time or file,time,f,iso");
    if let Some(photo) = photos.iter().find(|p| p.shot.settings.is_none()) {
        let problem = "its exposure is not known: it has no exposure time in EXIF data".to_owned();
        return Err(refusal(&photo.path, problem, &advice));
    }
    for (_, what, has) in OPTIONAL {
        let states = |photo: &&Photo| photo.shot.settings.is_some_and(|s| has(&s));
        if let (Some(without), true) = (
            photos.iter().find(|p| !states(p)),
            photos.iter().any(|p| states(&p)),
        ) {
            let problem = format!("its {what} is not known while that of other photographs is");
            return Err(refusal(&without.path, problem, &advice));
        }
    }
    Ok(())
}

/// Refuses photographs of which none belong together though there are several.
fn check_brackets(groups: &[Group]) -> Result<(), CaptureError> {
    if groups.len() < 2 || groups.iter().any(|group| group.photos.len() > 1) {
        return Ok(());
    }
    let first = &groups[0].photos[0];
    let same = groups
        .iter()
        .all(|group| group.photos[0].shot.settings == first.shot.settings);
    let problem = if same {
        format!(
            "all {} photographs state the same exposure as this one",
            groups.len()
        )
    } else {
        format!("none of the {} photographs belong together", groups.len())
    };
    Err(refusal(
        &first.path,
        problem,
        "correct that in exposures.csv, a line file,time a photograph; name brackets like view1_1.jpg, view1_2.jpg",
    ))
}
