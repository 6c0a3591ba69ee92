//! Chain rules against the CPU engine.

use super::*;

/// Worst relative error over the fields, and its field.
fn compare(case: &UpdateCase, got: &[f32]) -> (f64, &'static str) {
    let g = &case.model.gaussians;
    let expected = planar_rows(g, &case.expected);
    let mut worst = (0.0, "none");
    for field in Field::ALL {
        let r = range(g, field);
        let error = error_of_entries(&got[r.clone()], &expected[r]);
        if error > worst.0 {
            worst = (error, field.name());
        }
    }
    worst
}

fn check(gpu: &Gpu, shape: &Shape, seed: u64) {
    let case = UpdateCase::new(shape, seed, |_| ());
    let device = OnDevice::new(gpu, &case);
    let (got, by_globals) = device.gradients(&ParameterWeights::default());
    let (error, field) = compare(&case, &got);
    eprintln!("{shape:?} seed {seed}: {error:e} in {field}");
    assert!(error < 1e-5, "{shape:?} seed {seed}: {error:e} in {field}");
    let prototypes: Vec<f32> = case.expected.prototypes.iter().flatten().copied().collect();
    let error = error_of_entries(&by_globals[..prototypes.len()], &prototypes);
    assert!(error < 1e-5, "{shape:?} seed {seed}: prototypes {error:e}");
    assert!(by_globals[prototypes.len()..].iter().all(|v| *v == 0.0));
    assert_eq!(device.poisoned(), 0);
    let basis: Vec<f32> = case.by_basis.iter().flatten().map(|v| *v as f32).collect();
    let got = gpu.read(&device.by_basis, 0..48).unwrap();
    if shape.options.indirect == IndirectForm::Learned
        && shape.channels.count() > relume_layout::channel::DEPTH
    {
        assert!(error_of_entries(&got, &basis) < 1e-5, "basis {:e}", error_of_entries(&got, &basis));
    } else {
        assert_eq!(got, [0.0; 48]);
    }
    let density = gpu.read(&device.density, 0..shape.n).unwrap();
    let most = case.expected.absgrad.iter().fold(1e-6f32, |m, v| m.max(*v));
    for (i, d) in density.iter().enumerate() {
        assert!((d[0] - 1.0 - case.expected.absgrad[i]).abs() < 1e-5 * (most + 1.0), "{i}");
        assert_eq!(d[1] - 2.0, f32::from(u8::from(case.expected.visible[i])), "{i}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradients_match_the_cpu_engine() {
    let gpu = Gpu::for_tests();
    let mut seed = 0;
    for normal in [NormalForm::Free, NormalForm::ShortestAxis] {
        for indirect in [IndirectForm::Off, IndirectForm::Learned, IndirectForm::Gathered] {
            for low_pass_compensation in [false, true] {
                let options =
                    ShadingOptions { normal, indirect, low_pass_compensation, ..Default::default() };
                seed += 1;
                check(&gpu, &Shape { options, ..Default::default() }, seed);
            }
        }
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradients_match_for_all_prototype_and_coefficient_counts() {
    let gpu = Gpu::for_tests();
    let shapes = [(1, 0, 0), (8, 2, 1), (40, 4, 2), (3, 6, 3), (9, 1, 4), (7, 3, 0), (256, 5, 1)];
    for (at, (prototypes, visibility, radiance)) in shapes.into_iter().enumerate() {
        let channels = Channels::Full((visibility + 1) * (visibility + 1));
        let options = ShadingOptions { indirect: IndirectForm::Learned, ..Default::default() };
        let shape = Shape { prototypes, visibility, radiance, channels, options, ..Default::default() };
        check(&gpu, &shape, 100 + at as u64);
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradients_match_for_all_channel_and_gaussian_counts() {
    let gpu = Gpu::for_tests();
    for (at, channels) in [Channels::Colour, Channels::Geometry, Channels::Material].into_iter().enumerate() {
        let options = ShadingOptions { indirect: IndirectForm::Learned, ..Default::default() };
        check(&gpu, &Shape { channels, options, ..Default::default() }, 200 + at as u64);
    }
    for n in [1, 256, 300] {
        check(&gpu, &Shape { n, ..Default::default() }, 300 + n as u64);
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradients_without_float_atomics_match_the_cpu_engine() {
    let options = GpuOptions { compare_exchange: true, garbage: true, checks: true, ..GpuOptions::default() };
    let gpu = Gpu::with_options(options);
    check(&gpu, &Shape { n: 600, ..Default::default() }, 5);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradient_comparison_detects_one_changed_input() {
    let gpu = Gpu::for_tests();
    let options = ShadingOptions { low_pass_compensation: true, ..Default::default() };
    let shape = Shape { options, ..Default::default() };
    let changes: [fn(&mut UpdateCase); 5] = [
        |c| c.model.gaussians.field_mut(Field::Quaternion).iter_mut().for_each(|q| *q += 0.01),
        |c| c.model.gaussians.field_mut(Field::ProtoLogits).iter_mut().step_by(8).for_each(|s| *s += 0.01),
        |c| c.view.rotation[1][2] += 0.001,
        |c| c.records.iter_mut().for_each(|r| r.compensation *= 1.01),
        |c| c.model.shading.normal = NormalForm::Free,
    ];
    for (at, change) in changes.into_iter().enumerate() {
        let mut case = UpdateCase::new(&shape, 9, |_| ());
        change(&mut case);
        let (got, _) = OnDevice::new(&gpu, &case).gradients(&ParameterWeights::default());
        let (error, field) = compare(&case, &got);
        assert!(error.is_finite() && error > 1e-4, "change {at} went unnoticed: {error:e} in {field}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn invisible_non_finite_gaussians_do_not_affect_gradients() {
    let gpu = Gpu::for_tests();
    let spoil = |model: &mut Model| {
        let g = &mut model.gaussians;
        g.row_mut(Field::Mean, 5)[1] = f32::NAN;
        g.row_mut(Field::Quaternion, 6)[0] = f32::NAN;
        g.row_mut(Field::LogScale, 7)[2] = f32::INFINITY;
        // Behind the camera, with no finite parameter.
        for field in [Field::ProtoLogits, Field::Radiance, Field::Residual, Field::Indirect, Field::Normal] {
            g.row_mut(field, 2).fill(f32::NAN);
        }
    };
    let options = ShadingOptions { indirect: IndirectForm::Learned, ..Default::default() };
    let case = UpdateCase::new(&Shape { options, ..Default::default() }, 11, spoil);
    // A quaternion that is not finite counts as the identity.
    assert!([2, 5, 7].iter().all(|i| !case.expected.visible[*i]));
    let device = OnDevice::new(&gpu, &case);
    let (got, by_globals) = device.gradients(&ParameterWeights::default());
    let (error, field) = compare(&case, &got);
    assert!(error < 1e-5, "{error:e} in {field}");
    assert!(by_globals.iter().all(|v| v.is_finite()));
    assert_eq!(device.poisoned(), 0);
}

#[test]
fn test_case_contains_clamped_and_invisible_gaussians() {
    let case = UpdateCase::new(&Shape::default(), 1, |_| ());
    let clamped = |i: usize| {
        let camera = case.view.to_camera(case.model.gaussians.get(Field::Mean, i));
        let outside = |k: usize| {
            let ratio = camera[k] / camera[2];
            ratio < case.view.ratio_limits[k][0] || ratio > case.view.ratio_limits[k][1]
        };
        case.expected.visible[i] && (outside(0) || outside(1))
    };
    let moved = |i: usize| case.expected.get(Field::Mean, i).iter().any(|v| *v != 0.0);
    assert!((0..150).any(|i| clamped(i) && moved(i)), "the Jacobian's");
    let flat = |f: fn(&f32) -> bool| case.model.prototypes.iter().flatten().any(f);
    assert!(flat(|v| *v < 0.0) && flat(|v| *v > 1.0), "the prototypes'");
    let source = source(&case.model, &case.basis);
    assert!((0..150).any(|i| source.albedo(i).iter().any(|a| *a < 0.0 || *a > 1.0)), "the albedo's");
    let invisible = case.expected.visible.iter().filter(|v| !**v).count();
    assert!(invisible > 0 && invisible < 75, "{invisible}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn update_without_gaussians_gives_zero_gradients_and_losses() {
    let gpu = Gpu::for_tests();
    let mut case = UpdateCase::new(&Shape::default(), 3, |_| ());
    case.model.gaussians = Gaussians::zeroed(0, 8, 2, 2);
    let device = OnDevice::new(&gpu, &case);
    let (_, by_globals) = device.gradients(&ParameterWeights { aggregation: 1.0, ..Default::default() });
    assert!(by_globals.iter().all(|v| *v == 0.0));
    assert_eq!(device.losses(), [0.0; 16]);
}
