use super::*;
use crate::capture::Capture;

#[test]
#[ignore = "study"]
fn study() {
    for folder in std::env::var("STUDY").expect("captures").split(':') {
        let capture = Capture::load(std::path::Path::new(folder)).expect("capture");
        let occluder = Occluder::new(&capture.mesh);
        let surfaces: Vec<ViewSurface> = capture
            .views
            .iter()
            .map(|v| ViewSurface::new(&capture.mesh, &occluder, &v.camera))
            .collect();
        let started = std::time::Instant::now();
        let found = register(&capture.mesh, &capture.views, &surfaces, &occluder);
        println!("== {folder} {:.3} s", started.elapsed().as_secs_f64());
        println!("{:?}", describe(&found));
    }
}
