//! What memory a capture will take, found from the headers of its images before any of them is decoded.

use super::crop::Kept;
use super::error::CaptureError;
use super::manifest::{Frame, Manifest};
use super::picture;
use rayon::prelude::*;
use rekindle_base::memory;
use std::collections::HashMap;
use std::path::Path;

/// Bytes for each pixel of a file that is held: radiance, coverage, whether it is usable, and codes while it is read.
const FILE_BYTES: u64 = 24;
/// Bytes for each pixel of a view while it is solved: what the view sees there. With those of a file they are the 32 by which
/// solves of photographs of 0.1 to 12 megapixels grew, and a quarter more.
const VIEW_BYTES: u64 = 16;

/// For each frame the first with the same files, exposures and stated size: they are read once.
pub(super) fn first_alike(frames: &[Frame]) -> Vec<usize> {
    let mut firsts = HashMap::new();
    let alike = |frame: &Frame| {
        let exposures = frame.exposures.iter();
        let files: Vec<_> = exposures
            .map(|e| (e.path.clone(), e.settings.map(|s| s.amount().to_bits())))
            .collect();
        (files, frame.mask.clone(), frame.lens.size)
    };
    let frames = frames.iter().enumerate();
    frames
        .map(|(i, frame)| *firsts.entry(alike(frame)).or_insert(i))
        .collect()
}

/// Refuses a capture that would take more memory than the program may. `firsts` says which frames share their files, `kept` what
/// is kept of them.
pub(super) fn check(manifest: &Manifest, firsts: &[usize], kept: Kept) -> Result<(), CaptureError> {
    let Some(limit) = memory::limit() else {
        return Ok(());
    };
    let sizes: Vec<[u64; 2]> = manifest
        .frames
        .par_iter()
        .enumerate()
        .map(|(i, frame)| {
            if firsts[i] == i {
                pixels(frame)
            } else {
                [0; 2]
            }
        })
        .collect();
    let most = kept.at_most().map_or(u64::MAX, |pixels| pixels as u64);
    let held: u64 = sizes.iter().map(|[_, held]| held.min(&most)).sum();
    let seen: u64 = firsts.iter().map(|&first| sizes[first][0]).sum();
    let shown: u64 = firsts.iter().map(|&first| sizes[first][0].min(most)).sum();
    // What is held of a file at last is less than what its decoding takes, one file on each thread.
    let mut decoded: Vec<u64> = sizes
        .iter()
        .map(|[_, held]| held.saturating_sub(most))
        .collect();
    decoded.sort_unstable_by(|a, b| b.cmp(a));
    let decoded: u64 = decoded.iter().take(rayon::current_num_threads()).sum();
    let needed = FILE_BYTES * (held + decoded) + VIEW_BYTES * shown;
    if needed <= limit {
        return Ok(());
    }
    Err(CaptureError::Memory {
        path: manifest.path.clone(),
        views: firsts.len(),
        megapixels: seen as f64 / 1e6,
        needed: memory::in_words(needed),
        limit: memory::in_words(limit),
    })
}

/// Pixels of a frame's picture, and of all its files together. A file that can't be read counts nothing: reading it says why.
fn pixels(frame: &Frame) -> [u64; 2] {
    let of = |path: &Path| {
        picture::read_size(path, &frame.field)
            .map_or(0, |size| u64::from(size.0) * u64::from(size.1))
    };
    let files: Vec<u64> = frame.exposures.iter().map(|e| of(&e.path)).collect();
    let mask = frame.mask.as_deref().map_or(0, of);
    [files[0], files.iter().sum::<u64>() + mask]
}
