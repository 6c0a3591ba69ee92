//! Lamps in frames: linear in the lamps, independent of bands and of the environment.

use glam::DVec3;

use relume_compare::rms_difference;
use relume_scene::{EnvMap, Model};
use relume_spec::rendering::{Lamp, Output, Quality, Tier};
use relume_train::render::{Frame, Renderer};

use crate::tiers::{camera, table};

const OUTPUTS: [Output; 3] = [Output::Rgb, Output::Diffuse, Output::Specular];

fn renderer() -> Renderer {
    Renderer::new(table())
}

fn lamp(text: &str) -> Lamp {
    text.parse().unwrap()
}

fn frame(renderer: &Renderer, radiance: f32, lamps: &[Lamp], tier: Tier) -> Frame {
    let light = renderer.prepare_light(EnvMap::constant(32, 16, [radiance; 3])).unwrap();
    let quality = Quality { samples: 4, ..tier.into() };
    let mut bands =
        renderer.bands(&camera(48), &light, quality, &OUTPUTS).unwrap().with_lamps(lamps.to_vec());
    while bands.render_next().unwrap() {}
    bands.into_frame()
}

fn rgb(frame: &Frame) -> &[f32] {
    &frame.planes[&Output::Rgb]
}

/// Root mean square difference over that of `expected` from 0.
fn relative(expected: &[f32], found: &[f32]) -> f64 {
    rms_difference(found, expected) / rms_difference(expected, &vec![0.0; expected.len()])
}

#[test]
fn light_of_lamps_adds_to_that_of_the_environment() {
    let renderer = renderer();
    let lamps = [
        lamp("point position=0.5,0.5,1.5 intensity=2"),
        lamp("disc position=-1,0,1 target=0,0,0 radius=0.2 lumen=6"),
    ];
    for tier in [Tier::Preview, Tier::Standard, Tier::High] {
        let of = |radiance, lamps: &[Lamp]| frame(&renderer, radiance, lamps, tier);
        let both = of(0.5, &lamps);
        let parts = [of(0.5, &[]), of(0.0, &lamps[..1]), of(0.0, &lamps[1..])];
        let sum: Vec<f32> =
            (0..rgb(&both).len()).map(|i| parts.iter().map(|part| rgb(part)[i]).sum()).collect();
        let apart = relative(rgb(&both), &sum);
        assert!(apart < 1e-5, "{tier:?}: {apart}");
        let without = relative(rgb(&both), rgb(&parts[0]));
        assert!(without.is_finite() && without > 0.1, "{tier:?}, the control: {without}");
        let whole: Vec<f32> = both.planes[&Output::Diffuse]
            .iter()
            .zip(&both.planes[&Output::Specular])
            .map(|(a, b)| a + b)
            .collect();
        assert!(relative(rgb(&both), &whole) < 1e-5, "{tier:?}");
    }
}

#[test]
fn a_distant_lamp_is_a_light_of_the_environment() {
    let renderer = renderer();
    let towards = DVec3::new(0.5, 0.2, 0.85).normalize();
    let position = towards * 200.0;
    let [x, y, z] = position.to_array();
    // A disc of light of 2 degrees and irradiance 1, and a lamp of the same irradiance and angular radius.
    let cos = 2.0f64.to_radians().cos();
    let radiance = (1.0 / (std::f64::consts::TAU * (1.0 - cos))) as f32;
    let map = EnvMap::from_fn(512, 256, |d| if d.dot(towards) > cos { [radiance; 3] } else { [0.0; 3] });
    let light = renderer.prepare_light(map).unwrap();
    let expected = renderer.render(&camera(48), &light, Tier::High, &OUTPUTS).unwrap();
    let radius = 200.0 * 2.0f64.to_radians().tan();
    let lamp = lamp(&format!("point position={x},{y},{z} radius={radius} intensity=40000"));
    let found = frame(&renderer, 0.0, &[lamp], Tier::High);
    let apart = relative(rgb(&expected), rgb(&found));
    assert!(apart < 0.06, "{apart}");
    let turned = self::lamp(&format!("point position={},{x},{z} radius={radius} intensity=40000", -y));
    let elsewhere = relative(rgb(&expected), rgb(&frame(&renderer, 0.0, &[turned], Tier::High)));
    assert!(elsewhere.is_finite() && elsewhere > 0.15, "the control, a lamp at another azimuth: {elsewhere}");
}

#[test]
fn position_and_intensity_are_in_units_of_the_capture() {
    let plain = renderer();
    // The same model in a capture that is ten times as large and 3 units higher.
    let large =
        Model { world_scale: 0.1, world_offset: DVec3::new(0.0, 0.0, -3.0), ..Model::clone(&table()) };
    let large = Renderer::new(large.into());
    let of_plain =
        frame(&plain, 0.0, &[lamp("point position=0.5,0.5,1.5 radius=0.1 intensity=2")], Tier::Standard);
    let light = large.prepare_light(EnvMap::constant(32, 16, [0.0; 3])).unwrap();
    let view = camera(48);
    let view = relume_scene::Camera {
        translation: -(view.rotation * (view.centre() * 10.0 + DVec3::Z * 3.0)),
        ..view
    };
    let bands = large.bands(&view, &light, Tier::Standard.into(), &OUTPUTS).unwrap();
    let mut bands = bands.with_lamps(vec![lamp("point position=5,5,18 radius=1 intensity=200")]);
    while bands.render_next().unwrap() {}
    let apart = relative(rgb(&of_plain), rgb(&bands.into_frame()));
    assert!(apart < 1e-3, "{apart}");
}
