//! The ground below a model: its planes in frames, against a floor that belongs to the model and against simple facts.

use std::sync::Arc;

use glam::DVec3;

use relume_scene::{Camera, EnvMap, Model};
use relume_spec::rendering::{Output, Quality, Tier};
use relume_train::render::{Frame, Renderer};

use crate::tiers::{sun, table};

const SIZE: u32 = 64;
const PLANES: [Output; 3] = [Output::Shadow, Output::Bounce, Output::Contact];

/// The table, as a model of another scale and place in its capture.
fn renderer() -> Renderer {
    let model =
        Model { world_scale: 0.5, world_offset: DVec3::new(0.0, 0.0, -3.0), ..Model::clone(&table()) };
    Renderer::new(Arc::new(model))
}

fn camera(eye: DVec3, size: u32) -> Camera {
    Camera::look_at(eye, DVec3::new(0.0, 0.0, 3.0), DVec3::Z, 0.9, (size, size)).unwrap()
}

fn above(size: u32) -> Camera {
    camera(DVec3::new(4.0, -3.0, 8.0), size)
}

fn rendered(
    renderer: &Renderer,
    map: EnvMap,
    camera: &Camera,
    outputs: &[Output],
    height: Option<f64>,
) -> Frame {
    let light = renderer.prepare_light(map).unwrap();
    let mut bands =
        renderer.bands(camera, &light, Quality::from(Tier::Standard), outputs).unwrap().on_ground(height);
    while bands.render_next().unwrap() {}
    bands.into_frame()
}

/// The mean of a plane.
fn mean(frame: &Frame, output: Output) -> f64 {
    let plane = &frame.planes[&output];
    plane.iter().map(|v| f64::from(*v)).sum::<f64>() / plane.len() as f64
}

#[test]
fn frames_with_ground_have_only_the_requested_planes() {
    let renderer = renderer();
    let outputs = [Output::Rgb, Output::Shadow, Output::Position];
    let frame = rendered(&renderer, sun(), &above(SIZE), &outputs, None);
    assert_eq!(
        frame.planes.keys().copied().collect::<Vec<_>>(),
        [Output::Rgb, Output::Alpha, Output::Position, Output::Shadow]
    );
    let plain = rendered(&renderer, sun(), &above(SIZE), &[Output::Rgb, Output::Depth], None);
    let of = |frame: &Frame| frame.planes[&Output::Rgb].clone();
    assert!(of(&plain) == of(&frame), "the ground does not change the model");
}

#[test]
fn sun_casts_a_shadow_that_an_even_sky_does_not_cast() {
    let renderer = renderer();
    // Below the floor, so that it casts a shadow as well.
    let of = |map: EnvMap| rendered(&renderer, map, &above(SIZE), &PLANES, Some(2.99));
    let (sunny, even) = (of(sun()), of(EnvMap::constant(64, 32, [1.0; 3])));
    let darkest = |frame: &Frame| frame.planes[&Output::Shadow].iter().copied().fold(1.0, f32::min);
    assert!(darkest(&sunny) < 0.2, "{}", darkest(&sunny));
    assert!(darkest(&even) > 2.0 * darkest(&sunny), "{} {}", darkest(&even), darkest(&sunny));
    assert!(mean(&even, Output::Contact) < 0.95, "the control: {}", mean(&even, Output::Contact));
    assert_eq!(
        sunny.planes[&Output::Contact],
        even.planes[&Output::Contact],
        "contact is independent of the light"
    );
    // Under an even sky the shadow is the ambient occlusion, up to the choice of directions.
    let apart: Vec<f32> = even.planes[&Output::Shadow]
        .chunks_exact(3)
        .zip(&even.planes[&Output::Contact])
        .map(|(shadow, contact)| (shadow[0] - contact).abs())
        .collect();
    let worst = apart.iter().copied().fold(0.0, f32::max);
    assert!(worst < 0.08, "{worst}");
    for frame in [&sunny, &even] {
        assert!(frame.planes[&Output::Shadow].iter().all(|v| (0.0..=1.0 + 1e-4).contains(v)));
        assert!(
            frame.planes[&Output::Bounce].iter().all(|v| *v >= 0.0) && mean(frame, Output::Bounce) > 1e-4
        );
    }
}

#[test]
fn parts_of_the_shadow_are_those_of_sun_and_sky() {
    let outputs = [Output::Shadow, Output::ShadowKey, Output::ShadowFill];
    let light = EnvMap::from_fn(64, 32, |d| sun().sample(d).map(|v| v + 0.3));
    // Above the floor, which would block sun and sky alike.
    let frame = rendered(&renderer(), light, &above(SIZE), &outputs, Some(3.02));
    let [all, key, fill] = outputs.map(|output| frame.planes[&output].clone());
    let sums: Vec<f32> = key.iter().zip(&fill).map(|(key, fill)| key + fill).collect();
    let apart = all.iter().zip(&sums).map(|(all, sum)| (all - sum).abs()).fold(0.0, f32::max);
    assert!(apart < 1e-5, "{apart}");
    let relative = |plane: &[f32]| -> Vec<f32> {
        let most = plane.iter().copied().fold(0.0, f32::max);
        plane.iter().map(|value| value / most).collect()
    };
    let places = || relative(&key).into_iter().zip(relative(&fill));
    let brightest = |in_shadow: bool| {
        let fills = places().filter(|(key, _)| (*key < 0.2) == in_shadow).map(|(_, fill)| fill);
        fills.fold(0.0, f32::max)
    };
    assert!(brightest(true) > 0.4, "the sky lights the shadow of the sun: {}", brightest(true));
    assert!(brightest(false) > 0.9, "open ground: {}", brightest(false));
    assert!(mean(&frame, Output::ShadowKey) > 0.1 && mean(&frame, Output::ShadowFill) > 0.1);
}

#[test]
fn frames_have_the_same_bytes_for_any_number_of_threads() {
    let renderer = renderer();
    let light = renderer.prepare_light(sun()).unwrap();
    let outputs = [Output::Rgb, Output::Shadow, Output::Bounce, Output::Contact];
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let lamp = "point position=1,1,6 radius=0.2 intensity=9".parse().unwrap();
        let bands = renderer.bands(&above(SIZE), &light, Tier::High.into(), &outputs).unwrap();
        let mut bands = bands.with_lamps(vec![lamp]);
        pool.install(|| while bands.render_next().unwrap() {});
        bands.into_frame()
    };
    let (one, three) = (of(1), of(3));
    assert!(one == three);
    assert!(mean(&one, Output::Shadow) < 0.99, "the control");
}

#[test]
fn dark_light_casts_no_shadow() {
    let frame = rendered(&renderer(), EnvMap::constant(64, 32, [0.0; 3]), &above(SIZE), &PLANES, None);
    assert!(frame.planes[&Output::Shadow].iter().all(|v| *v == 1.0));
    assert!(frame.planes[&Output::Bounce].iter().all(|v| *v == 0.0));
    assert!(mean(&frame, Output::Contact) < 0.999, "the control");
}

#[test]
fn camera_below_the_ground_sees_no_ground() {
    let renderer = renderer();
    let below = camera(DVec3::new(4.0, -3.0, 2.5), SIZE);
    let frame = rendered(&renderer, sun(), &below, &PLANES, None);
    assert!(
        PLANES
            .iter()
            .all(|o| frame.planes[o].iter().all(|v| *v == f32::from(u8::from(*o != Output::Bounce))))
    );
    let seen = rendered(&renderer, sun(), &below, &PLANES, Some(1.0));
    assert!(mean(&seen, Output::Contact) < 0.999, "the control: a ground below the camera");
}

#[test]
fn large_frames_interpolate_the_ground() {
    let renderer = renderer();
    let of = |size| {
        rendered(&renderer, EnvMap::constant(64, 32, [1.0; 3]), &above(size), &[Output::Contact], None)
    };
    let (small, large) = (of(256), of(1024));
    // Mean difference of the small picture, moved by `shift` pixels, from the reduced large one.
    let apart = |shift: usize| {
        let difference = |i: usize| {
            let (x, y) = (i % 240, i / 240);
            let pixels = [(1, 1), (2, 1), (1, 2), (2, 2)].map(|(dx, dy)| (4 * y + dy) * 1024 + 4 * x + dx);
            let reduced = pixels.iter().map(|p| large.planes[&Output::Contact][*p]).sum::<f32>() / 4.0;
            f64::from((reduced - small.planes[&Output::Contact][y * 256 + x + shift]).abs())
        };
        (0..240 * 240).map(difference).sum::<f64>() / (240.0 * 240.0)
    };
    assert!(apart(0) < 0.002 && apart(4) > 3.0 * apart(0), "{} {}", apart(0), apart(4));
    assert!(mean(&small, Output::Contact) < 0.99, "the control");
}

#[test]
fn position_is_the_depth_along_the_pixel() {
    let camera = above(SIZE);
    let frame = rendered(&renderer(), sun(), &camera, &[Output::Position, Output::Depth], None);
    let (points, depths) = (&frame.planes[&Output::Position], &frame.planes[&Output::Depth]);
    let mut covered = 0;
    for (i, (point, depth)) in points.chunks_exact(3).zip(depths).enumerate() {
        if !depth.is_finite() {
            assert_eq!(point, [0.0; 3]);
            continue;
        }
        covered += 1;
        let seen = camera.rotation * DVec3::new(point[0].into(), point[1].into(), point[2].into())
            + camera.translation;
        let pixel = [camera.fx * seen.x / seen.z + camera.cx, camera.fy * seen.y / seen.z + camera.cy];
        let wanted = [(i as u32 % SIZE) as f64 + 0.5, (i as u32 / SIZE) as f64 + 0.5];
        assert!((seen.z - f64::from(*depth)).abs() < 1e-3, "{seen} {depth}");
        assert!(
            (pixel[0] - wanted[0]).abs() < 1e-2 && (pixel[1] - wanted[1]).abs() < 1e-2,
            "{pixel:?} {wanted:?}"
        );
    }
    assert!(covered > 100);
}

#[test]
fn lamps_light_the_ground_past_the_model() {
    let renderer = renderer();
    let light = renderer.prepare_light(sun()).unwrap();
    let outputs = [Output::Shadow, Output::LampLight, Output::LampShadow];
    let of = |lamps: &[&str]| {
        let bands = renderer.bands(&above(SIZE), &light, Tier::Standard.into(), &outputs).unwrap();
        let lamps = lamps.iter().map(|lamp| lamp.parse().unwrap()).collect();
        let mut bands = bands.on_ground(Some(2.99)).with_lamps(lamps);
        while bands.render_next().unwrap() {}
        bands.into_frame()
    };
    let lamp = "point position=0,0,7 radius=0.1 intensity=10";
    let (dark, one, two) = (of(&[]), of(&[lamp]), of(&[lamp, lamp]));
    assert!(dark.planes[&Output::LampLight].iter().all(|v| *v == 0.0));
    assert!(dark.planes[&Output::LampShadow].iter().all(|v| *v == 1.0));
    let [light, shadow] =
        [Output::LampLight, Output::LampShadow].map(|output| one.planes[&output].as_chunks::<3>().0.to_vec());
    let darkest = shadow.iter().map(|v| v[0]).fold(1.0, f32::min);
    assert!(darkest < 0.1, "the table casts a shadow: {darkest}");
    // 4.01 below the lamp a white ground has the radiance 10 / 4.01^2 / pi, elsewhere less.
    let brightest = light.iter().map(|v| v[0]).fold(0.0, f32::max);
    assert!((0.03..0.2).contains(&brightest), "{brightest}");
    let is_dark = |(light, shadow): (&[f32; 3], &[f32; 3])| light[0] < 0.2 * brightest && shadow[0] < 0.1;
    assert!(light.iter().zip(&shadow).any(is_dark), "no light in the shadow");
    assert_eq!(
        one.planes[&Output::Shadow],
        dark.planes[&Output::Shadow],
        "lamps do not change the map's shadow"
    );
    let apart = two.planes[&Output::LampLight].iter().zip(&one.planes[&Output::LampLight]);
    assert!(apart.map(|(two, one)| (two - 2.0 * one).abs()).fold(0.0, f32::max) < 1e-6, "lamps add up");
}
