//! Points of a bracket at which its exposures are compared: spread over all brightnesses, where the picture is smooth,
//! so that a camera that moved a little doesn't matter.

use super::merge::Part;
use super::recover::Sample;

/// Pixels looked at in a view.
const CANDIDATES: usize = 60_000;
/// Classes of brightness, and points taken from each.
const CLASSES: usize = 24;
const OF_EACH: usize = 50;

/// The samples of the files of one view; none for files that aren't coded.
pub(super) fn samples(parts: &[Part]) -> Vec<Sample> {
    let size = parts.first().map(|p| (p.picture.width, p.picture.height));
    let alike = parts
        .iter()
        .all(|p| p.picture.codes.is_some() && Some((p.picture.width, p.picture.height)) == size);
    let Some((width, height)) = size.filter(|&(w, h)| alike && w > 2 && h > 2) else {
        return Vec::new();
    };
    let (width, height) = (width as usize, height as usize);
    let stride = ((width * height) as f64 / CANDIDATES as f64)
        .sqrt()
        .ceil()
        .max(1.0) as usize;
    let mut classes: Vec<Vec<(u32, usize)>> = vec![Vec::new(); CLASSES];
    for y in (1..height - 1).step_by(stride) {
        for x in (1..width - 1).step_by(stride) {
            let at = y * width + x;
            if let Some((class, roughness)) = rate(parts, at, width) {
                classes[class].push((roughness, at));
            }
        }
    }
    let mut samples = Vec::new();
    for class in &mut classes {
        class.sort_unstable();
        for &(_, at) in class.iter().take(OF_EACH) {
            samples.extend((0..3).filter_map(|channel| sample(parts, at, channel)));
        }
    }
    samples
}

fn code(part: &Part, at: usize) -> [u16; 3] {
    let codes = part.picture.codes.as_ref();
    codes.map_or([0; 3], |codes| codes.at(at))
}

/// Class of a pixel, by the code of its longest exposure that isn't clipped, and how rough the picture is around it;
/// none for pixels that are no good.
fn rate(parts: &[Part], at: usize, width: usize) -> Option<(usize, u32)> {
    let around = [at - width, at - 1, at, at + 1, at + width];
    let opaque = |part: &Part| {
        let alpha = part.picture.alpha.as_ref();
        alpha.is_none_or(|alpha| around.iter().all(|&i| alpha[i] == 1.0))
    };
    let fit = |part: &&Part| around.iter().all(|&i| !part.picture.saturated[i]);
    let part = parts.iter().filter(fit).max_by(|a, b| {
        let amount = |part: &Part| part.amount.unwrap_or(1.0);
        amount(a).total_cmp(&amount(b))
    })?;
    if !parts.iter().all(opaque) {
        return None;
    }
    let green = |i: usize| u32::from(code(part, i)[1]);
    let (low, high) = around
        .iter()
        .map(|&i| green(i))
        .fold((u32::MAX, 0), |(low, high), v| (low.min(v), high.max(v)));
    let class = (green(at) as usize * CLASSES / 65_536).min(CLASSES - 1);
    // Relative to the code, in steps coarse enough that pixels of all over the picture are alike.
    let roughness = (high - low) * 16 / (green(at) / 4 + 257);
    Some((class, roughness))
}

fn sample(parts: &[Part], at: usize, channel: usize) -> Option<Sample> {
    let values = parts
        .iter()
        .filter(|part| !part.picture.saturated[at])
        .filter_map(|part| {
            let code = f64::from(code(part, at)[channel]) / 65_535.0;
            Some((code, part.amount?.ln()))
        });
    Sample::new(channel, values.collect())
}
