//! Which files in the way were written by this program, so that it may write them anew.
//!
//! Every file says so at its beginning where its format has room for it: PNG and EXR as the software that wrote them, text and
//! scenes in a comment. Of other formats, such as CSV and Radiance HDR, those may be replaced that begin as what replaces them.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

/// What files say of who wrote them.
pub const MAKER: &str = "rekindle";
/// Bytes among which they do.
const HEAD: u64 = 4096;
/// Bytes that files without a maker have in common; tables begin with the names of their columns, of which later versions may
/// have more.
const SAME: usize = 64;
const SAME_IN_TABLES: usize = 24;
/// Formats that always have a maker.
const SIGNED: [&str; 10] = [
    "exr", "png", "obj", "mtl", "usda", "glb", "py", "svg", "xml", "html",
];

/// Which of some files lie in a folder and were certainly written by others, as far as can be said before they are made.
pub(super) fn foreign<'a>(
    folder: &Path,
    names: impl IntoIterator<Item = &'a str>,
) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for name in names {
        let ending = Path::new(name).extension();
        let signed = ending.is_some_and(|e| SIGNED.iter().any(|s| e.eq_ignore_ascii_case(s)));
        let there = folder.join(name);
        if signed && there.is_file() && !has_maker(&head(&there)?) {
            found.push(name.into());
        }
    }
    Ok(found)
}

/// Whether the file `there` may be replaced by `new`.
pub(super) fn may_replace(there: &Path, new: &Path) -> io::Result<bool> {
    let Ok(kind) = fs::symlink_metadata(there) else {
        return Ok(true);
    };
    if !kind.is_file() {
        return Ok(false);
    }
    let (old, new) = (head(there)?, head(new)?);
    let is_table = there.extension().is_some_and(|e| e == "csv");
    let count = if is_table { SAME_IN_TABLES } else { SAME };
    let same = || old.iter().take(count).eq(new.iter().take(count));
    Ok(has_maker(&old) || (!has_maker(&new) && same()))
}

fn has_maker(head: &[u8]) -> bool {
    head.windows(MAKER.len()).any(|w| w == MAKER.as_bytes())
}

fn head(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(HEAD).read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_own_files_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            path
        };
        let csv = "name,azimuth_deg,elevation_deg,angular_radius_deg,red,green,blue\n";
        let replaced =
            |old: &str, new: &str| may_replace(&file("old", old), &file("new", new)).unwrap();
        assert!(replaced(
            "# written by rekindle\nv 0 0 0",
            "# written by rekindle\n"
        ));
        assert!(!replaced("v 0 0 0", "# written by rekindle\n"));
        assert!(replaced(&format!("{csv}a,1"), &format!("{csv}b,2")));
        assert!(!replaced("name,price\nbread,2", &format!("{csv}b,2")));
        let new = file("new", "x");
        assert!(may_replace(&folder.path().join("nothing"), &new).unwrap());
        assert!(!may_replace(folder.path(), &new).unwrap());
    }

    #[test]
    fn what_is_foreign_is_known_before_the_work() {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [
            ("a.exr", "x"),
            ("b.PNG", "Software rekindle"),
            ("c.csv", "x"),
        ] {
            fs::write(folder.path().join(name), text).unwrap();
        }
        let found = foreign(folder.path(), ["a.exr", "b.PNG", "c.csv", "d.exr"]).unwrap();
        assert_eq!(found, [PathBuf::from("a.exr")]);
    }
}
