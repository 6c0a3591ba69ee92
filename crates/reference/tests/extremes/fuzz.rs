//! NaN, infinite and extreme parameters: no engine panics, the images are finite, both engines draw the same Gaussians,
//! and Gaussians that are not drawn change nothing.

use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use relume_engine::Device;
use relume_reference::parity::{ParityCase, ParityResult, cpu_result};
use relume_scene::{Camera, Field, Model};

use super::harness::{BACKGROUND, LIGHT, in_front, looking_from, model, on_each_engine, result_on};
use relume_fixtures::cases_or;

on_each_engine! {
    extreme_parameters_give_finite_images,
    gaussians_with_nan_geometry_are_not_drawn,
}

const N: usize = 6;

/// Parameters in which even NaN must be harmless: they decide which Gaussians are drawn.
const GEOMETRY: [Field; 4] = [Field::Mean, Field::LogScale, Field::Quaternion, Field::OpacityLogit];

/// Finite values at limits: denormals, thresholds, tile edges, the largest value of a file.
fn finite() -> impl Strategy<Value = f32> {
    let near_cut = -(254.0f32.ln());
    prop_oneof![
        Just(0.0f32),
        Just(-0.0),
        Just(1e-45),
        Just(-1e-39),
        Just(f32::MIN_POSITIVE),
        Just(near_cut),
        Just(near_cut.next_up()),
        Just((0.99f32 / 0.01).ln()),
        Just(-2.95),
        Just(-3.0),
        Just(88.0),
        Just(-88.0),
        Just(1e6),
        Just(-1e12),
        Just(1e18),
        Just(-1e18),
        -10.0f32..10.0,
    ]
}

/// Finite values, NaN and infinities, which a file must not contain.
fn poison() -> impl Strategy<Value = f32> {
    prop_oneof![
        3 => finite(),
        1 => prop_oneof![
            Just(f32::NAN),
            Just(f32::INFINITY),
            Just(f32::NEG_INFINITY),
            Just(1e38f32),
            Just(-1e38),
            Just(f32::MAX),
            Just(f32::MIN),
        ],
    ]
}

/// Gaussian, field, component (taken modulo the width), value.
fn injection() -> impl Strategy<Value = (usize, Field, usize, f32)> {
    let geometry = (0..N, prop::sample::select(GEOMETRY.to_vec()), 0..4usize, poison());
    let rest: Vec<Field> = Field::ALL.into_iter().filter(|f| !GEOMETRY.contains(f)).collect();
    let rest = (0..N, prop::sample::select(rest), 0..32usize, finite());
    prop_oneof![2 => geometry, 1 => rest]
}

fn cameras() -> [Camera; 4] {
    [
        in_front((18, 17)),
        in_front((1, 1)),
        looking_from([0.0, 0.0, 2.0], (33, 5)),
        Camera::look_at([0.0, -3.0, 0.0].into(), glam::DVec3::ZERO, glam::DVec3::Z, 3.1, (16, 16)).unwrap(),
    ]
}

fn images_are_finite(result: &ParityResult) -> bool {
    let images = result.physical.iter().chain(&result.radiance).flatten().chain(&result.coverage);
    images.into_iter().all(|v| v.is_finite())
}

/// True when rounding may decide whether Gaussian `i` is drawn.
fn is_on_a_threshold(model: &Model, camera: &Camera, i: usize) -> bool {
    let g = &model.gaussians;
    let opacity = 1.0 / (1.0 + (-f64::from(g.row(Field::OpacityLogit, i)[0])).exp());
    let mean = glam::DVec3::from_array(g.get::<3>(Field::Mean, i).map(f64::from));
    let depth = (camera.rotation * mean + camera.translation).z;
    let scales = g.row(Field::LogScale, i);
    let near_zero = mean.length() > 1e5 && depth.abs() < 1e-4 * mean.length();
    (opacity * 255.0 - 1.0).abs() < 1e-4
        || (depth - 0.05).abs() < 1e-5
        || (depth / 1e12 - 1.0).abs() < 1e-4
        || near_zero
        // Size and distance together, or position on screen, at their limit.
        || scales.iter().any(|s| *s > 10.0)
        || (depth > 0.05 && (mean.length() / depth) > 1e8)
}

fn check(model: &Model, camera: &Camera, device: &Device) -> Result<(), TestCaseError> {
    let case = ParityCase::new(model, camera, BACKGROUND, &LIGHT, 5);
    let found = result_on(device, &case);
    prop_assert!(images_are_finite(&found));
    if let Device::Gpu(_) = device {
        let drawn = |result: &ParityResult| -> Vec<usize> {
            let steady = |i: &usize| !is_on_a_threshold(model, camera, *i);
            result.splats.iter().map(|s| s.gaussian).filter(steady).collect()
        };
        prop_assert_eq!(drawn(&cpu_result(&case)), drawn(&found));
        return Ok(());
    }
    // The same model without the Gaussians that are not drawn.
    let kept: Vec<usize> = found.splats.iter().map(|s| s.gaussian).collect();
    let mut rest = model.clone();
    rest.gaussians = model.gaussians.gathered(&kept);
    let without = cpu_result(&ParityCase::new(&rest, camera, BACKGROUND, &LIGHT, 5));
    prop_assert_eq!(found.physical, without.physical);
    Ok(())
}

fn extreme_parameters_give_finite_images(device: &Device) {
    let config =
        ProptestConfig { cases: cases_or(200), failure_persistence: None, ..ProptestConfig::default() };
    let injections = prop::collection::vec(injection(), 1..5);
    let cases = (injections, 0..4usize, 0..1000u64, any::<bool>());
    let run = TestRunner::new(config).run(&cases, |(injections, camera, seed, compensation)| {
        let mut model = model(N, seed);
        model.shading.low_pass_compensation = compensation;
        for (i, field, component, value) in injections {
            let row = model.gaussians.row_mut(field, i);
            let width = row.len();
            row[component % width] = value;
        }
        check(&model, &cameras()[camera], device)
    });
    run.unwrap();
}

fn gaussians_with_nan_geometry_are_not_drawn(device: &Device) {
    let drawn = |model: &Model| {
        let found = result_on(device, &ParityCase::new(model, &in_front((16, 12)), BACKGROUND, &LIGHT, 5));
        assert!(found.is_finite());
        found.splats.iter().map(|s| s.gaussian).collect::<Vec<_>>()
    };
    for field in GEOMETRY {
        let mut poisoned = model(3, 50);
        *poisoned.gaussians.row_mut(field, 1).last_mut().unwrap() = f32::NAN;
        assert_eq!(drawn(&poisoned), [0, 2], "{field:?}");
    }
    assert_eq!(drawn(&model(3, 50)), [0, 1, 2], "the control");
}

#[test]
fn non_finite_and_huge_parameters_are_refused_by_field() {
    for field in Field::ALL {
        for value in [f32::NAN, f32::INFINITY, 1e38] {
            let mut poisoned = model(3, 51);
            *poisoned.gaussians.row_mut(field, 1).last_mut().unwrap() = value;
            let error = poisoned.check().unwrap_err();
            assert_eq!(error.field, field.name(), "{error}");
        }
    }
    let mut poisoned = model(3, 51);
    poisoned.env_raw[2][1] = f32::NAN;
    assert_eq!(poisoned.check().unwrap_err().field, "environment");
    assert!(model(3, 51).check().is_ok(), "the control");
}
