//! Which photographs of a folder are one bracket.
//!
//! Files that were taken one after the other with the same body, orientation and focal length, each with another exposure,
//! are one: a new bracket starts where an exposure comes up again, where the setup changes, or after a pause. Without such
//! data the names tell: `view_1_0.png` and `view_1_1.png` are alike but for what follows the last separator.

use super::shot::{Settings, Shot};
use std::path::{Path, PathBuf};

/// A longer pause than this between two photographs, in seconds beside the exposures themselves, ends a bracket.
const PAUSE: f64 = 60.0;
/// Exposures that differ by less than this factor are one exposure.
const SAME: f64 = 1.05;

/// A photograph with what is known of how it was taken.
#[derive(Clone, Debug)]
pub struct Photo {
    /// The file.
    pub path: PathBuf,
    /// What its EXIF data say, with the exposure that a table states instead.
    pub shot: Shot,
}

/// Photographs of one bracket, the longest exposure last; or one alone.
#[derive(Clone, Debug)]
pub struct Group {
    /// What the merged picture is called: the first file's name without its ending, or what all names have in common.
    pub name: String,
    /// The files.
    pub photos: Vec<Photo>,
}

impl Photo {
    fn amount(&self) -> Option<f64> {
        self.shot.settings.as_ref().map(Settings::amount)
    }
}

/// Puts photographs that belong together into groups, in the order of their names.
pub fn group(mut photos: Vec<Photo>) -> Vec<Group> {
    photos.sort_by_key(|photo| natural(&photo.path));
    let dated = photos
        .iter()
        .all(|p| p.shot.taken.is_some() && p.amount().is_some());
    if dated {
        // Counters of names start again at 10,000; the stable sort keeps the names' order within a second.
        photos.sort_by(|a, b| {
            a.shot
                .taken
                .unwrap_or(0.0)
                .total_cmp(&b.shot.taken.unwrap_or(0.0))
        });
    }
    let mut groups: Vec<Vec<Photo>> = Vec::new();
    for photo in photos {
        let joins = groups.last().is_some_and(|group| {
            if dated {
                continues(group, &photo)
            } else {
                shares_name(group, &photo)
            }
        });
        match groups.last_mut().filter(|_| joins) {
            Some(group) => group.push(photo),
            None => groups.push(vec![photo]),
        }
    }
    let mut groups: Vec<Group> = groups.into_iter().map(finish).collect();
    groups.sort_by_key(|group| natural(&group.photos[0].path));
    tell_apart(&mut groups);
    groups
}

/// Whether a photograph goes on with a bracket.
fn continues(group: &[Photo], photo: &Photo) -> bool {
    let Some(last) = group.last() else {
        return false;
    };
    let (Some(amount), Some(before)) = (photo.amount(), last.shot.taken) else {
        return false;
    };
    let repeated = group.iter().filter_map(Photo::amount).any(|other| {
        let ratio = amount / other;
        ratio < SAME && ratio > 1.0 / SAME
    });
    let open = |photo: &Photo| photo.shot.settings.map_or(0.0, |s| s.time);
    let pause = photo.shot.taken.unwrap_or(before) - before;
    !repeated
        && photo.shot.setup == last.shot.setup
        && photo.path.parent() == last.path.parent()
        && pause <= PAUSE + open(photo) + open(last)
}

/// Whether a photograph's name differs from those of a group only after the last separator.
fn shares_name(group: &[Photo], photo: &Photo) -> bool {
    let same = |other: &Photo| match (trunk(&other.path), trunk(&photo.path)) {
        (Some(a), Some(b)) => a == b && other.path.parent() == photo.path.parent(),
        _ => false,
    };
    group.first().is_some_and(same)
}

/// The name up to its last separator, if it has one with something before it.
fn trunk(path: &Path) -> Option<String> {
    let stem = path.file_stem()?.to_string_lossy().into_owned();
    let at = stem.rfind(['_', '-', ' ', '+'])?;
    // A sign before a number of stops belongs to the number, and so does its unit.
    let signs = ['_', '-', ' ', '+'];
    let mut trunk = stem[..at].trim_end_matches(signs);
    for unit in ["ev", "EV", "exp"] {
        let before = trunk.strip_suffix(unit).filter(|t| t.ends_with(signs));
        trunk = before.map_or(trunk, |t| t.trim_end_matches(signs));
    }
    (!trunk.is_empty()).then(|| trunk.to_owned())
}

fn finish(mut photos: Vec<Photo>) -> Group {
    let trunks: Vec<Option<String>> = photos.iter().map(|p| trunk(&p.path)).collect();
    let common = trunks[0]
        .clone()
        .filter(|_| photos.len() > 1 && trunks.iter().all(|t| t == &trunks[0]));
    let stem = photos[0]
        .path
        .file_stem()
        .map(|s| s.to_string_lossy().into_owned());
    // A camera's counter is the last part of a name too, and then the common part says nothing.
    let numbered = stem.as_ref().is_some_and(|stem| {
        let last = stem.rsplit(['_', '-', ' ', '+']).next().unwrap_or("");
        last.len() >= 4 && last.bytes().all(|b| b.is_ascii_digit())
    });
    let name = if numbered { None } else { common };
    let name = name.or(stem).unwrap_or_else(|| "photograph".to_owned());
    photos.sort_by(|a, b| {
        a.amount()
            .unwrap_or(0.0)
            .total_cmp(&b.amount().unwrap_or(0.0))
    });
    Group { name, photos }
}

/// Gives groups of one name the names of their first files, or numbers.
pub(super) fn tell_apart(groups: &mut [Group]) {
    for i in 0..groups.len() {
        let mut name = groups[i].name.clone();
        let mut number = 1;
        while groups[..i]
            .iter()
            .any(|other| other.name.eq_ignore_ascii_case(&name))
        {
            number += 1;
            name = format!("{}_{number}", groups[i].name);
        }
        groups[i].name = name;
    }
}

/// A key by which `b10` comes after `b9`.
fn natural(path: &Path) -> Vec<(String, u64)> {
    let text = path.to_string_lossy();
    let mut parts: Vec<(String, u64)> = vec![(String::new(), 0)];
    let mut in_number = false;
    for c in text.chars() {
        if let Some(digit) = c.to_digit(10) {
            if let Some((_, number)) = parts.last_mut() {
                *number = number.saturating_mul(10).saturating_add(digit.into());
            }
            in_number = true;
        } else {
            if in_number {
                parts.push((String::new(), 0));
                in_number = false;
            }
            if let Some((word, _)) = parts.last_mut() {
                word.push(c);
            }
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn photo(name: &str, time: Option<f64>, taken: Option<f64>) -> Photo {
        Photo {
            path: PathBuf::from(name),
            shot: Shot {
                settings: time.map(|time| Settings {
                    time,
                    f_number: None,
                    iso: None,
                }),
                setup: vec!["body".to_owned()],
                taken,
            },
        }
    }

    fn names(groups: &[Group]) -> Vec<(String, usize)> {
        groups
            .iter()
            .map(|g| (g.name.clone(), g.photos.len()))
            .collect()
    }

    #[test]
    fn a_bracket_ends_where_an_exposure_comes_again() {
        let times = [0.01, 0.04, 0.16];
        let photos = (0..9).map(|i| {
            let taken = f64::from(i) * 2.0 + f64::from(i / 3) * 30.0;
            photo(
                &format!("DSC_{:04}.JPG", 9 + i),
                Some(times[i as usize % 3]),
                Some(taken),
            )
        });
        let groups = group(photos.rev().collect());
        let expected = [("DSC_0009", 3), ("DSC_0012", 3), ("DSC_0015", 3)];
        assert_eq!(names(&groups), expected.map(|(n, c)| (n.to_owned(), c)));
        assert_eq!(
            groups[0].photos[2].path,
            Path::new("DSC_0011.JPG"),
            "longest last"
        );
    }

    #[test]
    fn pauses_and_other_setups_end_a_bracket() {
        let mut photos = vec![
            photo("a1.jpg", Some(0.1), Some(0.0)),
            photo("a2.jpg", Some(0.2), Some(1.0)),
            photo("a3.jpg", Some(0.4), Some(400.0)),
            photo("a4.jpg", Some(0.8), Some(401.0)),
        ];
        photos[3].shot.setup = vec!["turned".to_owned()];
        let counts: Vec<usize> = group(photos).iter().map(|g| g.photos.len()).collect();
        assert_eq!(counts, [2, 1, 1]);
    }

    #[test]
    fn names_tell_where_nothing_else_does() {
        let files = [
            "v_10_ev-2.png",
            "v_10_ev-0.png",
            "v_9_ev+0.png",
            "v_9_ev-2.png",
            "lone.png",
        ];
        let groups = group(files.iter().map(|f| photo(f, None, None)).collect());
        let expected = [("lone", 1), ("v_9", 2), ("v_10", 2)];
        let mut found = names(&groups);
        found.sort();
        let mut expected = expected.map(|(n, c)| (n.to_owned(), c)).to_vec();
        expected.sort();
        assert_eq!(found, expected);
    }
}
