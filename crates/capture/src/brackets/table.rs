//! A table that states exposures where files don't, or wrongly: lines of `file,time[,f,iso]`.
//!
//! Times are seconds, also as a fraction `1/60`. A first line of names is passed over, as are empty lines and those that start
//! with `#`. A file is named by its path from the table, or by its name alone; `*` and `?` stand for any characters and for
//! one, and of several lines that fit a file the last counts.

use super::super::error::CaptureError;
use super::shot::Settings;
use rekindle_base::files;
use std::path::{Path, PathBuf};

/// What the table beside a manifest is called.
pub const TABLE: &str = "exposures.csv";

/// Stated exposures of files.
#[derive(Clone, Debug, Default)]
pub struct Table {
    folder: PathBuf,
    lines: Vec<(String, Settings)>,
}

impl Table {
    /// The table of a folder, if there is one.
    pub fn beside(folder: &Path) -> Result<Self, CaptureError> {
        let path = folder.join(TABLE);
        if path.is_file() {
            Self::read(&path)
        } else {
            Ok(Self::default())
        }
    }

    /// Reads a table.
    pub fn read(path: &Path) -> Result<Self, CaptureError> {
        let bytes = files::read(path).map_err(|source| CaptureError::Unreadable {
            path: path.to_owned(),
            source,
        })?;
        Self::parse(path, &bytes)
    }

    /// Parses the bytes of the table `path`.
    pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Self, CaptureError> {
        let text = String::from_utf8_lossy(bytes);
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let mut lines = Vec::new();
        let mut first = true;
        for (i, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let is_first = std::mem::take(&mut first);
            match entry(line) {
                Ok(entry) => lines.push(entry),
                Err(_) if is_first && !line.contains(|c: char| c.is_ascii_digit()) => {}
                Err(problem) => {
                    return Err(CaptureError::Field {
                        path: path.to_owned(),
                        field: format!("line {}", i + 1),
                        problem,
                        advice: "write file,time or file,time,f,iso, such as IMG_1.JPG,1/60,8,100"
                            .to_owned(),
                    });
                }
            }
        }
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Ok(Self { folder, lines })
    }

    /// What the table says of a file.
    pub fn settings(&self, path: &Path) -> Option<Settings> {
        let below = path.strip_prefix(&self.folder).unwrap_or(path);
        let below = below.to_string_lossy().replace('\\', "/");
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned());
        let fits = |pattern: &str| {
            matches(pattern, &below) || name.as_deref().is_some_and(|name| matches(pattern, name))
        };
        let found = self.lines.iter().rev().find(|(pattern, _)| fits(pattern));
        found.map(|(_, settings)| *settings)
    }
}

fn entry(line: &str) -> Result<(String, Settings), String> {
    let cells: Vec<&str> = line
        .split(if line.contains('\t') {
            '\t'
        } else if line.contains(';') {
            ';'
        } else {
            ','
        })
        .map(|cell| cell.trim().trim_matches('"'))
        .collect();
    let number = |i: usize, what: &str| -> Result<Option<f64>, String> {
        let Some(cell) = cells.get(i).filter(|cell| !cell.is_empty()) else {
            return Ok(None);
        };
        let value = match cell.split_once('/') {
            Some((top, bottom)) => ratio(top, bottom),
            None => cell.parse().ok(),
        };
        let good = value.filter(|v: &f64| v.is_finite() && *v > 0.0);
        good.map(Some)
            .ok_or_else(|| format!("has '{cell}' as {what}, which is not a positive number"))
    };
    let file = cells[0];
    if file.is_empty() {
        return Err("names no file".to_owned());
    }
    let settings = Settings {
        time: number(1, "the time")?.ok_or("has no time")?,
        f_number: number(2, "the f-number")?,
        iso: number(3, "the ISO sensitivity")?,
    };
    Ok((file.replace('\\', "/"), settings))
}

fn ratio(top: &str, bottom: &str) -> Option<f64> {
    let (top, bottom): (f64, f64) = (top.trim().parse().ok()?, bottom.trim().parse().ok()?);
    Some(top / bottom)
}

/// Whether a name fits a pattern with `*` and `?`.
fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) =
        (pattern.chars().collect(), name.chars().collect());
    let (mut p, mut n) = (0, 0);
    // Where the last star is, and how far it has eaten.
    let mut star = None;
    while n < name.len() {
        match pattern.get(p) {
            Some('*') => {
                star = Some((p, n));
                p += 1;
            }
            Some(&c) if c == '?' || c == name[n] => {
                p += 1;
                n += 1;
            }
            _ => match star {
                Some((at, eaten)) => {
                    star = Some((at, eaten + 1));
                    (p, n) = (at + 1, eaten + 1);
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(|&c| c == '*')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Table, String> {
        Table::parse(Path::new("folder/exposures.csv"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn a_table_states_exposures_by_name_path_and_pattern() {
        let text =
            "file,time,f,iso\n# bracket\na.jpg,1/60,8,200\n*_2.png, 0.5\n\"sub/b.jpg\",2,,400\n";
        let table = parse(text).expect("a table");
        let of = |name: &str| table.settings(&Path::new("folder").join(name));
        let a = of("a.jpg").expect("stated");
        assert_eq!(
            (a.time, a.f_number, a.iso),
            (1.0 / 60.0, Some(8.0), Some(200.0))
        );
        assert_eq!(of("elsewhere/a.jpg"), Some(a));
        assert_eq!(of("view_001_2.png").map(|s| s.time), Some(0.5));
        let b = of("sub/b.jpg").expect("stated");
        assert_eq!((b.time, b.f_number, b.iso), (2.0, None, Some(400.0)));
        assert_eq!(of("b.jpg"), None, "another b");
        assert_eq!(of("view_001_3.png"), None);
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, part) in [
            ("a.jpg,1\nb.jpg,zero\n", "line 2 has 'zero' as the time"),
            ("a.jpg,1,-8\n", "line 1 has '-8' as the f-number"),
            ("a.jpg,1\nb.jpg\n", "line 2 has no time"),
            ("a.jpg,1\n,2\n", "line 2 names no file"),
            ("a1.jpg,1/0\n", "line 1 has '1/0' as the time"),
        ] {
            let message = parse(text).expect_err("a bad table");
            assert!(message.contains(part), "{message} lacks {part}");
        }
    }
}
