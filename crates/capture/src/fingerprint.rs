//! Is this the capture that was read before?

use std::hash::Hasher;

use rayon::prelude::*;
use siphasher::sip128::{Hasher128, SipHasher13};

use super::{Camera, Capture, LightFrame, Mesh, View};

impl Capture {
    /// A digest (SipHash-1-3) of all that was measured and stated. It is the same for the same files wherever they lie, and,
    /// but for one chance in 2¹²⁸, for no others.
    pub fn fingerprint(&self) -> u128 {
        let mut hasher = SipHasher13::new();
        add_text(&mut hasher, &self.name);
        let views: Vec<u128> = self.views.par_iter().map(of_view).collect();
        add(&mut hasher, &views);
        add(&mut hasher, &[of_mesh(&self.mesh)]);
        add(&mut hasher, &self.light_hemisphere.up.to_array());
        add(&mut hasher, self.light_hemisphere.radius.as_slice());
        // Where nothing else is stated, the digest is that of versions before there was a choice.
        if let Some(frame) = self.light_hemisphere.frame {
            let name = match frame {
                LightFrame::World => "world",
                LightFrame::Camera => "camera",
            };
            add_text(&mut hasher, name);
        }
        for warning in &self.warnings {
            add_text(&mut hasher, warning);
        }
        hasher.finish128().as_u128()
    }
}

fn of_view(view: &View) -> u128 {
    let mut hasher = SipHasher13::new();
    add_text(&mut hasher, &view.name);
    add_camera(&mut hasher, &view.camera);
    add(&mut hasher, &view.photograph.radiance);
    add(&mut hasher, &view.photograph.usable);
    let clipped = view.photograph.clipped.as_deref();
    add(&mut hasher, clipped.unwrap_or_default());
    let coverage = view.photograph.coverage.as_deref();
    add(&mut hasher, coverage.unwrap_or_default());
    hasher.write_u8(u8::from(coverage.is_some()));
    hasher.finish128().as_u128()
}

fn add_camera(hasher: &mut SipHasher13, camera: &Camera) {
    add(hasher, &[camera.width, camera.height]);
    add(hasher, &camera.focal.to_array());
    add(hasher, &camera.centre.to_array());
    add(hasher, &camera.world_from_camera.to_cols_array());
    // Its fields are a camera model's business.
    add_text(hasher, &format!("{:?}", camera.distortion));
}

fn of_mesh(mesh: &Mesh) -> u128 {
    let mut hasher = SipHasher13::new();
    add(&mut hasher, &mesh.origin.to_array());
    add(&mut hasher, &mesh.positions);
    add(&mut hasher, &mesh.normals);
    add(&mut hasher, &mesh.uvs);
    add(&mut hasher, &mesh.triangles);
    hasher.finish128().as_u128()
}

/// Adds numbers, and how many there are: what follows can't be taken for some of them.
fn add<T: bytemuck::NoUninit>(hasher: &mut SipHasher13, values: &[T]) {
    hasher.write_u64(values.len() as u64);
    hasher.write(bytemuck::cast_slice(values));
}

fn add_text(hasher: &mut SipHasher13, text: &str) {
    add(hasher, text.as_bytes());
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{Distortion, LightHemisphere, Photograph};
    use glam::{DAffine3, DVec2, DVec3, Vec3};

    fn capture() -> Capture {
        let view = |name: &str| View {
            name: name.to_owned(),
            camera: Camera {
                width: 2,
                height: 1,
                focal: DVec2::ONE,
                centre: DVec2::new(1.0, 0.5),
                distortion: Distortion::default(),
                world_from_camera: DAffine3::IDENTITY,
            },
            photograph: Arc::new(Photograph {
                width: 2,
                height: 1,
                radiance: vec![[0.5; 3]; 2],
                coverage: None,
                usable: vec![true; 2],
                clipped: None,
                crop: None,
            }),
        };
        Capture {
            name: "thing".to_owned(),
            views: vec![view("a"), view("b")],
            mesh: Mesh {
                origin: glam::DVec3::ZERO,
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                normals: vec![Vec3::Z; 3],
                uvs: Vec::new(),
                triangles: vec![[0, 1, 2]],
            },
            light_hemisphere: LightHemisphere {
                up: DVec3::Z,
                radius: None,
                frame: None,
            },
            is_developed: false,
            brackets: None,
            warnings: Vec::new(),
        }
    }

    #[test]
    fn any_change_of_what_was_measured_shows() {
        let changes: [fn(&mut Capture); 13] = [
            |_| {},
            |c| c.views[1].camera.focal.y += 1e-12,
            |c| c.views[1].camera.distortion.k[0] = 1e-6,
            |c| c.views.swap(0, 1),
            |c| Arc::make_mut(&mut c.views[0].photograph).radiance[1][2] = 0.500_000_1,
            |c| Arc::make_mut(&mut c.views[0].photograph).usable[1] = false,
            |c| Arc::make_mut(&mut c.views[0].photograph).clipped = Some(vec![false, true]),
            |c| Arc::make_mut(&mut c.views[0].photograph).coverage = Some(Vec::new()),
            |c| c.mesh.normals[2].x = 1e-7,
            |c| c.light_hemisphere.radius = Some(3.0),
            |c| c.light_hemisphere.frame = Some(LightFrame::Camera),
            |c| c.light_hemisphere.frame = Some(LightFrame::World),
            |c| c.warnings.push("clipped".to_owned()),
        ];
        let prints: Vec<u128> = changes
            .iter()
            .map(|change| {
                let mut changed = capture();
                change(&mut changed);
                changed.fingerprint()
            })
            .collect();
        for (i, print) in prints.iter().enumerate() {
            assert!(!prints[..i].contains(print), "change {i} does not show");
        }
        assert_eq!(prints[0], capture().fingerprint());
    }
}
