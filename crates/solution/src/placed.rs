//! Keeping where a mesh belongs: as a transform in its capture's manifest, or as another mesh.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use glam::DMat4;
use serde_json::{Value, json};

use super::write_plain_obj;
use rekindle_base::files;
use rekindle_base::staging::Staging;
use rekindle_capture::Mesh;

/// The capture's own manifest, into which a transform can be written.
pub fn manifest_of(capture: &Path) -> Option<PathBuf> {
    let named = ["transforms.json", "transforms_train.json"].map(|name| capture.join(name));
    let own = capture
        .extension()
        .is_some_and(|e| e == "json")
        .then(|| capture.to_owned());
    own.into_iter().chain(named).find(|path| path.is_file())
}

/// Writes a transform, after the one that is stated already, into a manifest; the file appears whole or not at all.
pub fn write_mesh_transform(manifest: &Path, transform: &DMat4) -> io::Result<()> {
    let mut value: Value = serde_json::from_slice(&files::read(manifest)?)?;
    let before = value.get("mesh_transform").and_then(matrix);
    let matrix = *transform * before.unwrap_or(DMat4::IDENTITY);
    value["mesh_transform"] = json!(matrix.transpose().to_cols_array_2d());
    let text = serde_json::to_vec_pretty(&value)?;
    add(manifest, |path| fs::write(path, text))
}

/// Writes a mesh that was moved as OBJ; the file appears whole or not at all.
pub fn write_placed_mesh(path: &Path, mesh: &Mesh) -> io::Result<()> {
    add(path, |path| write_plain_obj(path, mesh))
}

/// Puts a file that `write` makes into its folder. A link is followed.
fn add(path: &Path, write: impl FnOnce(&Path) -> io::Result<()>) -> io::Result<()> {
    let real = path.canonicalize();
    let path = real.as_deref().unwrap_or(path);
    let Some(name) = path.file_name() else {
        return Err(io::Error::other("it is not a file's name"));
    };
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let staging = Staging::within(folder)?;
    write(&staging.path().join(name))?;
    staging.add_all()
}

/// A matrix as rows.
fn matrix(value: &Value) -> Option<DMat4> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).ok()?;
    let mut matrix = DMat4::IDENTITY;
    for (i, row) in rows.iter().enumerate().take(4) {
        for (j, &v) in row.iter().enumerate().take(4) {
            matrix.col_mut(j)[i] = v;
        }
    }
    Some(matrix)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_linked_manifest_stays_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let [real, link] = ["real.json", "transforms.json"].map(|name| folder.path().join(name));
        fs::write(&real, "{}").unwrap();
        std::os::unix::fs::symlink("real.json", &link).unwrap();
        write_mesh_transform(&link, &DMat4::IDENTITY).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(
            fs::read_to_string(&real)
                .unwrap()
                .contains("mesh_transform")
        );
    }
}
