//! Sizes, shapes and positions of Gaussians.

use relume_engine::Device;
use relume_scene::Field;

use super::harness::{Suite, TIGHT, in_front, looking_from, model, on_each_engine, set};

on_each_engine! {
    scales_from_1e_6_to_1e6_match,
    scales_with_overflowing_or_underflowing_squares_match,
    elongated_and_flat_gaussians_match,
    flat_gaussians_seen_edge_on_and_face_on_match,
    zero_quaternion_is_the_identity,
    equal_depths_are_blended_by_index,
    gaussians_at_the_near_plane_and_behind_the_camera_match,
    large_gaussians_near_and_around_the_camera_match,
}

fn scales_from_1e_6_to_1e6_match(device: &Device) {
    let mut suite = Suite::on(device);
    for compensation in [false, true] {
        for scale in [1e-6f32, 1e-3, 1.0, 1e3, 1e6] {
            let mut model = model(8, 4);
            model.shading.low_pass_compensation = compensation;
            for i in 2..5 {
                let l = scale.ln();
                model.gaussians.row_mut(Field::LogScale, i).copy_from_slice(&[l, l + 0.3, l - 0.4]);
            }
            suite.check(&format!("scale {scale:e}"), &model, &in_front((16, 12)), TIGHT);
        }
    }
    suite.finish();
}

fn scales_with_overflowing_or_underflowing_squares_match(device: &Device) {
    let mut suite = Suite::on(device);
    // A point is as wide as the low-pass; with compensation its weight is 0.
    for (log, is_point) in
        [(f32::NEG_INFINITY, true), (-1e30, true), (-60.0, true), (60.0, false), (f32::INFINITY, false)]
    {
        for compensation in [false, true] {
            let mut model = model(4, 5);
            model.shading.low_pass_compensation = compensation;
            model.gaussians.row_mut(Field::LogScale, 1).fill(log);
            let name = format!("log scale {log} {compensation}");
            let result = suite.alike(&name, &model, &in_front((16, 12)), 1e-4);
            let drawn = result.splats.iter().any(|s| s.gaussian == 1);
            assert_eq!(drawn, is_point && !compensation, "{name}");
        }
    }
    suite.finish();
}

fn elongated_and_flat_gaussians_match(device: &Device) {
    let mut suite = Suite::on(device);
    let shapes: [[f32; 3]; 6] = [
        [1.0, 1e-3, 1e-3],
        [1e2, 1e-3, 1e-3],
        [1e3, 1e-2, 1e-3],
        [1.0, 1.0, 1e-4],
        [1e2, 1e2, 1e-6],
        [3.0, 1e-2, 1e-6],
    ];
    let with = |shape: [f32; 3], compensation| {
        let mut model = model(8, 6);
        model.shading.low_pass_compensation = compensation;
        (2..5).for_each(|i| model.gaussians.row_mut(Field::LogScale, i).copy_from_slice(&shape.map(f32::ln)));
        model
    };
    for compensation in [false, true] {
        for shape in shapes {
            let name = format!("shape {shape:?} {compensation}");
            suite.check(&name, &with(shape, compensation), &in_front((16, 12)), TIGHT);
        }
        // From a ratio of 1e8 on, `xx yy - xy^2` has no correct digits in the reference, even in f64.
        for shape in [[1e4, 1e-4, 1e-4], [1e6, 1e-6, 1e-6]] {
            let name = format!("shape {shape:?} {compensation}");
            suite.alike(&name, &with(shape, compensation), &in_front((16, 12)), 1e-3);
        }
    }
    suite.finish();
}

fn flat_gaussians_seen_edge_on_and_face_on_match(device: &Device) {
    let mut suite = Suite::on(device);
    for compensation in [false, true] {
        let mut model = model(4, 7);
        model.shading.low_pass_compensation = compensation;
        set(&mut model, Field::Quaternion, &[[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]);
        // Thin along x and along the view.
        set(&mut model, Field::LogScale, &[[-12.0, -0.5, -0.7], [-0.6, -12.0, -0.7]]);
        suite.check("edge-on", &model, &in_front((16, 12)), TIGHT);
    }
    suite.finish();
}

fn zero_quaternion_is_the_identity(device: &Device) {
    let mut suite = Suite::on(device);
    let mut zero = model(6, 8);
    let mut identity = zero.clone();
    for (i, row) in [[0.0f32; 4], [-0.0; 4], [0.0, -0.0, 0.0, 0.0]].iter().enumerate() {
        zero.gaussians.row_mut(Field::Quaternion, i).copy_from_slice(row);
        identity.gaussians.row_mut(Field::Quaternion, i).copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
    }
    let camera = in_front((16, 12));
    let (a, b) =
        (suite.alike("zero", &zero, &camera, 1e-4), suite.alike("identity", &identity, &camera, 1e-4));
    assert_eq!(a.radiance, b.radiance);
    assert!(
        a.gradients["quats"].data()[..12].iter().all(|g| *g == 0.0),
        "nothing turns what has no direction"
    );
    assert!(a.gradients["quats"].data()[12..].iter().any(|g| *g != 0.0), "the control");
    for length in [1e-9f32, 1e-4, 1e4, 1e18] {
        let mut scaled = model(6, 8);
        scaled.gaussians.field_mut(Field::Quaternion).iter_mut().for_each(|v| *v *= length);
        // The gradient by a quaternion is proportional to 1 / length; the image does not change.
        let result = suite.alike(&format!("length {length:e}"), &scaled, &camera, 1e-4);
        assert!(result.is_finite());
    }
    suite.finish();
}

fn equal_depths_are_blended_by_index(device: &Device) {
    let mut suite = Suite::on(device);
    let mut model = model(8, 9);
    (0..8).for_each(|i| model.gaussians.row_mut(Field::Mean, i)[1] = 0.0);
    model.gaussians.field_mut(Field::OpacityLogit).fill(2.0);
    suite.check("equal depths", &model, &in_front((16, 12)), TIGHT);
    let before = suite.alike("in order", &model, &in_front((16, 12)), 1e-4);
    let swapped = model.gaussians.gathered(&[7, 6, 5, 4, 3, 2, 1, 0]);
    let mut reversed = model.clone();
    reversed.gaussians = swapped;
    let after = suite.alike("reversed", &reversed, &in_front((16, 12)), 1e-4);
    assert_ne!(before.radiance, after.radiance, "the control: order matters");
    suite.finish();
}

fn gaussians_at_the_near_plane_and_behind_the_camera_match(device: &Device) {
    let mut suite = Suite::on(device);
    let mut model = model(8, 10);
    // Camera at y = -3, near plane at -2.95.
    let means = [
        [0.0, -3.0, 0.0],
        [0.0, -3.2, 0.1],
        [0.0, -2.9501, 0.0],
        [0.004, -2.9499, 0.003],
        [-0.01, -2.94, 0.0],
        [0.0, -1e6, 0.0],
    ];
    set(&mut model, Field::Mean, &means);
    (0..6).for_each(|i| model.gaussians.row_mut(Field::LogScale, i).copy_from_slice(&[-5.0, -5.5, -4.8]));
    suite.check("near", &model, &in_front((16, 12)), TIGHT);
    let drawn = suite.alike("near", &model, &in_front((16, 12)), 1e-3);
    assert_eq!(drawn.splats.iter().map(|s| s.gaussian).collect::<Vec<_>>(), [3, 4, 6, 7]);
    let mut behind = model.clone();
    (0..8).for_each(|i| behind.gaussians.row_mut(Field::Mean, i)[1] = -4.0 - i as f32);
    let nothing = suite.alike("all behind", &behind, &in_front((16, 12)), 1e-6);
    assert!(nothing.splats.is_empty() && nothing.coverage.iter().all(|c| *c == 0.0));
    suite.finish();
}

fn large_gaussians_near_and_around_the_camera_match(device: &Device) {
    let mut suite = Suite::on(device);
    let mut model = model(6, 11);
    set(&mut model, Field::Mean, &[[2.0, -2.5, 0.5], [-40.0, 1.0, 3.0], [0.1, -2.6, 0.1]]);
    (0..3).for_each(|i| model.gaussians.row_mut(Field::LogScale, i).copy_from_slice(&[1.5, 1.2, 0.9]));
    suite.check("beside", &model, &in_front((16, 12)), TIGHT);
    suite.check("beside, from above", &model, &looking_from([0.5, -2.0, 1.5], (16, 12)), TIGHT);
    suite.finish();
}
