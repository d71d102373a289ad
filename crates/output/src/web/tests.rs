//! What would go wrong for who opens a page: something missing that only a network has, a name that breaks it, light that is lost,
//! colours that are wrong.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{DVec3, Quat, Vec3};
use serde_json::Value;

use super::*;
use rekindle_relight::{Interreflection, LampNodes, LatLong, LightNode};
use rekindle_studio::fixtures;

fn page_of(solution: &Solution, setups: &[Setup]) -> String {
    page(solution, setups, Some(DVec3::Z), &|| false, &mut |_| {}).expect("a page")
}

fn fixture_page() -> String {
    let solution = fixtures::solution();
    page_of(&solution, &[Setup::captured(&solution)])
}

/// What the page's script reads.
fn scene_of(html: &str) -> Value {
    let start = "<script id=\"scene\" type=\"application/json\">";
    let (_, rest) = html.split_once(start).expect("a scene");
    let (text, _) = rest.split_once("</script>").expect("its end");
    serde_json::from_str(text).expect("JSON")
}

/// Bytes of a piece of data.
fn data_of(html: &str, name: &str) -> Vec<u8> {
    use base64::Engine as _;
    let (_, rest) = html
        .split_once(&format!("<script id=\"{name}\""))
        .expect(name);
    let (_, rest) = rest.split_once('>').expect("its text");
    let (text, _) = rest.split_once("</script>").expect("its end");
    base64::engine::general_purpose::STANDARD
        .decode(text)
        .expect("base64")
}

/// Σ flux over a list of seven numbers for each lobe.
fn flux_of(lobes: &Value) -> Vec3 {
    let numbers: Vec<f32> = serde_json::from_value(lobes.clone()).expect("numbers");
    let fluxes = numbers
        .chunks(7)
        .map(|lobe| Vec3::new(lobe[3], lobe[4], lobe[5]));
    fluxes.sum()
}

#[test]
fn a_page_asks_for_nothing_beyond_itself_and_is_small() {
    let html = fixture_page();
    for beyond in [
        "http:", "https:", "src=", "href=", "@import", "url(", "fetch(", "import(",
    ] {
        assert!(!html.contains(beyond), "{beyond}");
    }
    assert!(!html.contains("{{"), "a mark is left");
    assert!(html.len() < 1_000_000, "{} bytes", html.len());
    assert!(
        html[..4096].contains("rekindle"),
        "its maker is named at its beginning"
    );
}

#[test]
fn names_end_no_element_and_come_through() {
    let mut solution = Arc::into_inner(fixtures::solution()).expect("its only owner");
    let bad = "</script><script>alert(\"1\")</script><!-- & ' \\";
    bad.clone_into(&mut solution.name);
    let mut setup = Setup::captured(&solution);
    bad.clone_into(&mut setup.name);
    setup.names = vec![bad.to_owned(); 3];
    let html = page_of(&solution, &[setup]);
    assert_eq!(
        html.matches("<script").count(),
        html.matches("</script>").count()
    );
    assert!(!html.contains("<script>alert") && !html.contains("<!-- &"));
    let scene = scene_of(&html);
    assert_eq!(scene["name"], bad);
    assert_eq!(scene["setups"][0]["name"], bad);
    assert_eq!(scene["setups"][0]["lamps"][2]["name"], bad);
}

/// Names of the fields that hold nothing.
fn each_null(value: &Value, name: &str, found: &mut Vec<String>) {
    match value {
        Value::Null => found.push(name.to_owned()),
        Value::Array(all) => all.iter().for_each(|v| each_null(v, name, found)),
        Value::Object(all) => all.iter().for_each(|(name, v)| each_null(v, name, found)),
        _ => {}
    }
}

#[test]
fn all_numbers_are_finite_whatever_the_light() {
    let solution = fixtures::solution();
    let mut dark = Setup::captured(&solution);
    dark.captured = false;
    dark.lighting = dark.lighting.dark();
    let mut strong = Setup::captured(&solution);
    strong.lighting.lamps[0].nodes[0].radiance = Vec3::new(1e30, 0.0, 1e-30);
    let scene = scene_of(&page_of(&solution, &[dark, strong]));
    // JSON has no infinity: it would be null.
    let mut nulls = Vec::new();
    each_null(&scene, "", &mut nulls);
    nulls.retain(|name| !["near", "gloss"].contains(&name.as_str()));
    assert!(nulls.is_empty(), "{nulls:?}");
}

#[test]
fn no_light_is_lost_and_no_setup_has_too_many_lobes() {
    let solution = fixtures::solution();
    let white = solution.white();
    let captured = Setup::captured(&solution);
    let mut many = captured.clone();
    many.lighting.lamps = (0..40)
        .map(|i| {
            let turn = Quat::from_rotation_y(0.3 * i as f32);
            LampNodes::disc(turn * Vec3::new(0.6, 0.8, 0.0), Vec3::ONE, 0.4, None)
        })
        .collect();
    many.lighting.environment = LatLong::of(64, |direction| {
        Vec3::new(1.0, 2.0, 3.0) * (1.1 + direction.x)
    })
    .environment(Quat::IDENTITY, Vec3::ONE);
    let html = page_of(&solution, &[captured.clone(), many.clone()]);
    let scene = scene_of(&html);
    for (setup, shown) in [captured, many]
        .iter()
        .zip(scene["setups"].as_array().unwrap())
    {
        let mut lobes = 0;
        let mut alike = |given: Vec3, shown: &Value| {
            let error = (flux_of(shown) - given / white).length();
            assert!(error <= 1e-4 * given.length() / white, "{given}: {shown}");
            lobes += shown.as_array().unwrap().len() / 7;
        };
        let lamps = shown["lamps"].as_array().unwrap();
        assert_eq!(lamps.len(), setup.lighting.lamps.len());
        for (lamp, shown) in setup.lighting.lamps.iter().zip(lamps) {
            alike(lamp.flux(), &shown["lobes"]);
        }
        let nodes = |nodes: &[LightNode]| nodes.iter().map(LightNode::flux).sum();
        alike(nodes(&setup.lighting.remainder), &shown["rest"][0]["lobes"]);
        let environment = setup
            .lighting
            .environment_lamps()
            .map(LampNodes::flux)
            .sum();
        alike(environment, &shown["rest"][1]["lobes"]);
        assert!(lobes <= 64 + 1, "{lobes} lobes");
    }
}

#[test]
fn the_textures_are_the_solutions() {
    let solution = fixtures::solution();
    let html = page_of(&solution, &[Setup::captured(&solution)]);
    let scene = scene_of(&html);
    for (name, texture, unit) in [
        ("diffuse", &solution.diffuse, solution.white()),
        ("albedo", &solution.albedo, 1.0),
    ] {
        let scale = scene["textures"][name].as_f64().unwrap() as f32 * unit;
        let picture = image::load_from_memory(&data_of(&html, name))
            .expect("a JPEG")
            .to_rgb8();
        let linear = |byte: u8| {
            let v = f32::from(byte) / 255.0;
            if v <= 0.04045 {
                v / 12.92
            } else {
                ((v + 0.055) / 1.055).powf(2.4)
            }
        };
        let largest = texture.iter().flatten().fold(0.0_f32, |m, v| m.max(*v));
        let (mut squares, mut count) = (0.0, 0.0);
        for texel in &solution.atlas.texels {
            let shown = picture.as_raw()[3 * texel.index as usize..][..3].iter();
            for (byte, value) in shown.zip(texture[texel.index as usize]) {
                squares += ((linear(*byte) * scale - value) / largest).powi(2);
                count += 1.0;
            }
        }
        let db = -10.0 * f32::log10(squares / count);
        assert!(db > 38.0, "{name}: {db} dB");
    }
}

#[test]
fn what_the_surface_sends_to_itself_is_as_the_reference_has_it() {
    let solution = fixtures::solution();
    let occluder = Occluder::new(&solution.mesh);
    let transfer = Transfer::new(&solution, &occluder, &|| false, &mut |_| {}).expect("some");
    let around = Interreflection::new(&solution.mesh, &occluder, solution.brdf).expect("some");
    let mut lighting = solution.lighting().dark();
    lighting.ambient = Vec3::new(0.3, 0.2, 0.1);
    for (direction, flux) in [
        (Vec3::new(0.48, 0.8, 0.36), Vec3::new(3.0, 2.0, 1.0)),
        (Vec3::new(-0.6, 0.0, -0.8), Vec3::new(0.5, 1.0, 2.0)),
    ] {
        lighting
            .lamps
            .push(LampNodes::disc(direction, flux, 0.02, None));
    }
    let shader = rekindle_relight::Shader::new(&occluder, solution.brdf, &lighting);
    let relit = around.of_light(&solution.mesh, &shader, &solution.atlas, &solution.albedo);
    let (mut error, mut all) = (0.0, 0.0);
    for triangle in 0..solution.mesh.triangles.len() as u32 {
        let expected = relit
            .indirect
            .at(&solution.mesh, triangle, glam::Vec2::ZERO);
        let vertex = solution.mesh.triangles[triangle as usize][0];
        let found = transfer.irradiance(vertex as usize, &lighting);
        error += (found - expected).length_squared();
        all += expected.length_squared();
    }
    assert!(all > 0.0, "there is some");
    let part = (error / all).sqrt();
    assert!(part < 0.2, "{part} of it is wrong");
}

#[test]
fn a_mesh_that_no_page_can_show_is_refused() {
    let mut solution = Arc::into_inner(fixtures::solution()).expect("its only owner");
    let refused = |solution: &Solution| {
        page(solution, &[], None, &|| false, &mut |_| {})
            .expect_err("refused")
            .to_string()
    };
    let triangle = solution.mesh.triangles[0];
    solution.mesh.triangles = vec![triangle; MOST_TRIANGLES + 1];
    let said = refused(&solution);
    assert!(
        said.contains("1000001 triangles") && said.contains("decimate"),
        "{said}"
    );
    solution.mesh.triangles.clear();
    assert!(refused(&solution).contains("no triangles"));
}

#[test]
fn a_setup_with_more_lights_than_the_shaders_hold_is_refused() {
    let solution = fixtures::solution();
    let mut setup = Setup::captured(&solution);
    let lamp = setup.lighting.lamps[0].clone();
    setup.lighting.lamps = vec![lamp; 201];
    let refused = page(&solution, &[setup], None, &|| false, &mut |_| {});
    let said = refused.expect_err("refused").to_string();
    assert!(
        said.contains("Captured light") && said.contains("201 lights"),
        "{said}"
    );
}

#[test]
fn it_stops_soon_after_it_is_asked_to() {
    let solution: Arc<Solution> = fixtures::solution();
    let asked = AtomicUsize::new(0);
    let stop = || asked.fetch_add(1, Ordering::Relaxed) > 2;
    let stopped = page(&solution, &[], None, &stop, &mut |_| {});
    assert!(matches!(stopped, Err(WebError::Stopped)));
}
