use glam::Vec3;
use rekindle::{capture::Capture, estimate::*, hemisphere::*, surface::*};
use std::time::Instant;
struct Trace(Instant);
impl Observer for Trace {
    fn progress(&mut self, w: &str, f: f32) -> std::ops::ControlFlow<()> {
        eprintln!("{:.0?} {w} {f}", self.0.elapsed());
        std::ops::ControlFlow::Continue(())
    }
    fn iteration(
        &mut self,
        i: &Iteration,
        h: &dyn Fn() -> Vec<[f32; 3]>,
    ) -> std::ops::ControlFlow<()> {
        eprintln!(
            "{:.0?} {i:?} lit {}",
            self.0.elapsed(),
            h().iter().filter(|l| l[0] > 0.).count()
        );
        std::ops::ControlFlow::Continue(())
    }
}
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let dir = std::path::Path::new(&args[1]);
    let t0 = Instant::now();
    let capture = Capture::load(dir).unwrap();
    eprintln!("load {:.0?}", t0.elapsed());
    let t = Instant::now();
    let occluder = Occluder::new(&capture.mesh);
    let surfaces: Vec<ViewSurface> = capture
        .views
        .iter()
        .map(|v| ViewSurface::new(&capture.mesh, &occluder, &v.camera))
        .collect();
    eprintln!("surface {:.0?}", t.elapsed());
    let t = Instant::now();
    let lh = capture.light_hemisphere;
    let grid = HemisphereGrid::new(
        70,
        lh.up.as_vec3(),
        lh.radius.map(|r| r as f32),
        capture.mesh.centre(),
    );
    let truth: serde_json::Value =
        serde_json::from_reader(std::fs::File::open(dir.join("truth/truth.json")).unwrap())
            .unwrap();
    let ts = truth["material"]["sigma"]
        .as_f64()
        .unwrap_or_else(|| truth["material"]["microfacet_alpha"].as_f64().unwrap() / 2f64.sqrt());
    {
        let t = Instant::now();
        let mut tr = Trace(Instant::now());
        let choice = match args.get(2).map(|s| s.as_str()) {
            Some("p") => SpecularChoice::Model(SpecularModel::Paper),
            Some("m") => SpecularChoice::Model(SpecularModel::Microfacet),
            _ => SpecularChoice::Auto,
        };
        let fit = estimate(
            &EstimateInput {
                capture: &capture,
                surfaces: &surfaces,
                occluder: &occluder,
                grid: &grid,
            },
            &EstimateParams {
                method: Method::Fast,
                specular: choice,
            },
            &mut tr,
        )
        .unwrap();
        println!(
            "{:?} {} {:?}",
            fit.brdf, fit.chosen_because, fit.diagnostics
        );
        let Some(brdf) = fit.brdf else { return };
        println!(
            "sigma {:.5} ({:+.2}%) {:?} in {:.0?}",
            brdf.sigma,
            100. * (f64::from(brdf.sigma) / ts - 1.),
            fit.sigma_interval95,
            t.elapsed()
        );
        let total: Vec3 = fit
            .radiance
            .iter()
            .map(|&l| Vec3::from(l) * grid.solid_angle)
            .sum();
        let lights = truth["lights"].as_array().unwrap();
        let v3 = |v: &serde_json::Value| {
            Vec3::new(
                v[0].as_f64().unwrap() as f32,
                v[1].as_f64().unwrap() as f32,
                v[2].as_f64().unwrap() as f32,
            )
        };
        let mut rows = vec![];
        for l in lights {
            let d = v3(&l["direction"]).normalize();
            let tf = v3(&l["radiance"]) * l["solid_angle"].as_f64().unwrap() as f32;
            let (mut f, mut c, mut n) = (Vec3::ZERO, Vec3::ZERO, 0);
            for (i, &r) in fit.radiance.iter().enumerate() {
                if grid.directions[i].angle_between(d) < 8f32.to_radians()
                    && Vec3::from(r).max_element() > 0.
                {
                    f += Vec3::from(r) * grid.solid_angle;
                    c += grid.directions[i] * Vec3::from(r).element_sum();
                    n += 1;
                }
            }
            let c = c.normalize_or_zero();
            let mut m2 = 0.;
            for (i, &r) in fit.radiance.iter().enumerate() {
                let a = grid.directions[i].angle_between(c);
                if a < 8f32.to_radians() {
                    m2 += a * a * Vec3::from(r).element_sum() * grid.solid_angle;
                }
            }
            rows.push((
                c.angle_between(d).to_degrees(),
                f,
                tf,
                n,
                (2. * m2 / f.element_sum()).sqrt().to_degrees(),
            ));
        }
        let k = rows.iter().map(|r| r.2.element_sum()).sum::<f32>()
            / rows.iter().map(|r| r.1.element_sum()).sum::<f32>();
        let inl: f32 = rows.iter().map(|r| r.1.element_sum()).sum();
        for r in &rows {
            println!(
                "   angle {:.3}  flux {:+.2}%  nodes {} extent {:.2} rgb {:?}",
                r.0,
                100. * (k * r.1.element_sum() / r.2.element_sum() - 1.),
                r.3,
                r.4,
                (r.1 / r.2).to_array()
            );
        }
        println!(
            "   1/k {:.4} in lights {:.2}%",
            1. / k,
            100. * inl / total.element_sum()
        );
    }
    println!("total {:.0?}", t0.elapsed());
}
