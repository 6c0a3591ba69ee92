//! Extreme scenes.

use super::backward::{attributes_by_gaussian, check, label_error};
use super::*;
use relume_compare::largest_difference;

/// Largest error of the G-buffer against f64, relative to each channel's largest value: device, CPU.
fn forward_errors(raster: &mut Raster, scene: &RasterScene, channels: Channels) -> (f64, f64) {
    let gpu = raster.gpu.clone();
    let frame = scene.gpu(raster, channels, EarlyStop::Never);
    let pass = scene.cpu(channels, EarlyStop::Never);
    let (n, stored) = (scene.gaussians.len(), channels.stored());
    let attributes = attributes_by_gaussian(&pass, n, stored);
    let splats = exact::project(&scene.view, &scene.gaussians);
    let expected = exact::blend(&scene.view, &splats, &attributes, stored);
    let got = gbuffer(&gpu, &frame);
    let width = scene.view.width;
    let (mut device, mut cpu) = (0.0, 0.0);
    for c in 0..stored {
        let expected = column(&expected, c);
        let on_cpu: Vec<f32> = (0..expected.len()).map(|i| pass.at(i % width, i / width, c)).collect();
        let scale = worst(expected.iter().map(|v| v.abs())).max(1e-6);
        assert!(scale.is_finite(), "channel {c}");
        device = worst([device, largest_difference(&column(&got, c), &expected) / scale]);
        cpu = worst([cpu, largest_difference(&on_cpu, &expected) / scale]);
    }
    (device, cpu)
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn elongated_gaussians_keep_precision_on_both_engines() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let scene = RasterScene::random(31, 60, (64, 48), 1).fill(Field::LogScale, &[0.7, -6.0, -6.5]);
    let (device, cpu) = forward_errors(&mut raster, &scene, Channels::Material);
    let back = check(&mut raster, &scene, Channels::Material, 13);
    eprintln!("needles: device {device:e}, CPU {cpu:e}, backward {back:e}");
    assert!(device < 5e-5 && cpu < 5e-5, "device {device:e}, CPU {cpu:e}");
    assert!(back < 1e-3, "{back:e}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn flat_and_image_covering_gaussians_match_f64() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for (name, scale, n) in [("pancakes", [-1.5, -1.2, -8.0], 80), ("covering", [1.0, 1.2, 0.8], 40)] {
        let scene = RasterScene::random(32, n, (64, 48), 1).fill(Field::LogScale, &scale);
        let (device, cpu) = forward_errors(&mut raster, &scene, Channels::Material);
        let back = check(&mut raster, &scene, Channels::Material, 13);
        let labels = label_error(&mut raster, &scene);
        eprintln!("{name}: device {device:e}, CPU {cpu:e}, backward {back:e}, labels {labels:e}");
        assert!(device < 2e-5 && back < 1e-4 && labels < 1e-4, "{name}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn three_hundred_opaque_layers_match_f64() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for logit in [-1.0, 4.0, 9.0] {
        let scene = RasterScene::random(33, 300, (16, 16), 1)
            .fill(Field::LogScale, &[0.0, 0.2, -0.3])
            .fill(Field::OpacityLogit, &[logit]);
        let (device, cpu) = forward_errors(&mut raster, &scene, Channels::Material);
        let back = check(&mut raster, &scene, Channels::Material, 13);
        let labels = label_error(&mut raster, &scene);
        eprintln!("layers {logit}: device {device:e}, CPU {cpu:e}, backward {back:e}, labels {labels:e}");
        assert!(device < 2e-5 && back < 1e-4 && labels < 1e-4, "{logit}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn early_stop_error_is_at_most_its_threshold() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let scene = RasterScene::random(34, 300, (37, 21), 1).fill(Field::LogScale, &[-1.0, -0.8, -1.2]);
    let whole = gbuffer(&gpu, &scene.gpu(&mut raster, Channels::Colour, EarlyStop::Never));
    let stopped = gbuffer(&gpu, &scene.gpu(&mut raster, Channels::Colour, EarlyStop::WhenSaturated));
    let most = largest_difference(&column(&whole, 0), &column(&stopped, 0));
    assert!(most > 0.0 && most <= f64::from(TRANSMITTANCE_STOP), "{most}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn any_image_size_matches_the_cpu() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for size in [(1, 1), (1, 40), (16, 16), (17, 15), (37, 21), (3, 64)] {
        let scene = RasterScene::random(35, 100, size, 1);
        assert_forward(&mut raster, &scene, Channels::Geometry, 2e-5, &format!("{size:?}"));
        let back = check(&mut raster, &scene, Channels::Geometry, 8);
        assert!(back < 1e-4, "{size:?}: {back:e}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn no_visible_gaussians_give_an_empty_image() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for n in [0, 5] {
        // All Gaussians lie behind the camera.
        let scene = RasterScene::random(36, n, (20, 20), 1).fill(Field::Mean, &[0.4, -20.0, 0.9]);
        let frame = scene.gpu(&mut raster, Channels::Colour, EarlyStop::WhenSaturated);
        assert_eq!(counts(&frame), RasterCounts::default());
        assert!(gbuffer(&gpu, &frame).iter().flatten().all(|v| *v == 0.0));
        let by = gpu.upload("by", &[[1.0f32; 4]; 400]).unwrap();
        let mut rec = gpu.record();
        let mut frame = frame.backward(&mut rec, &by, 1).unwrap();
        frame.backward_labels(&mut rec).unwrap();
        rec.submit().unwrap();
        let gradients = gpu.read(&frame.splat_gradients, 0..n * 12).unwrap();
        assert!(gradients.iter().all(|v| *v == 0.0));
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gaussians_with_nan_parameters_are_invisible() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let fields = [Field::Mean, Field::LogScale, Field::Quaternion, Field::OpacityLogit];
    let mut scene = RasterScene::random(37, 40, (20, 20), 1).fill(Field::SamplingRate, &[20.0]);
    let all = counts(&scene.gpu(&mut raster, Channels::Colour, EarlyStop::WhenSaturated)).visible;
    for (i, field) in fields.into_iter().enumerate() {
        for k in 0..scene.gaussians.width(field) {
            scene.gaussians.row_mut(field, 4 * i + k)[k] = f32::NAN;
        }
    }
    scene.gaussians.row_mut(Field::Mean, 20)[1] = f32::INFINITY;
    scene.gaussians.row_mut(Field::OpacityLogit, 21)[0] = f32::NEG_INFINITY;
    scene.gaussians.row_mut(Field::LogScale, 22)[0] = 1e30;
    let frame = scene.gpu(&mut raster, Channels::Colour, EarlyStop::WhenSaturated);
    let visible = counts(&frame).visible;
    assert_eq!(visible, all - (3 + 3 + 4 + 1) - 3);
    assert!(gbuffer(&gpu, &frame).iter().flatten().all(|v| v.is_finite()));
    // An opacity logit of infinity is an opacity of 1.
    scene.gaussians.row_mut(Field::OpacityLogit, 23)[0] = f32::INFINITY;
    let frame = scene.gpu(&mut raster, Channels::Colour, EarlyStop::WhenSaturated);
    assert_eq!(counts(&frame).visible, visible);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn equal_depths_are_ordered_by_index() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let scene = RasterScene::random(38, 100, (37, 21), 1)
        .fill(Field::Mean, &[0.1, 0.0, 0.1])
        .fill(Field::LogScale, &[-1.5, -1.6, -1.2])
        .fill(Field::SamplingRate, &[20.0]);
    assert_forward(&mut raster, &scene, Channels::Material, 2e-5, "equal depths");
    let (_, order) = projected(&mut raster, &scene);
    let order = gpu.read(&order, 0..100).unwrap();
    assert!(order.iter().enumerate().all(|(rank, g)| rank == *g as usize));
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn more_pairs_than_a_binding_holds_are_refused_with_sizes() {
    let gpu = Gpu::for_tests();
    let raster = Raster::new(&gpu).unwrap();
    let most = gpu.report().max_binding.min(gpu.report().max_buffer);
    let pairs = (1u64 << 33) + 5;
    let Err(DeviceError::TooLarge { needs, most: said, what }) = raster.check_instances(pairs) else {
        panic!("was not refused")
    };
    assert_eq!((needs, said), (4 * pairs, most));
    assert!(what.contains("8589934597"), "{what}");
    raster.check_instances(1000).unwrap();
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn channels_and_buffers_not_matching_the_model_are_refused() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let scene = RasterScene::random(39, 10, (1, 1), 1);
    let (camera, fitting) = (CameraUniform::new(&scene.view), scene.on_device(&gpu));
    let short = || gpu.buffer("short", 1).unwrap();
    let refused = |raster: &mut Raster, source: &AttributeSource, channels: Channels| {
        let projected = raster.prepare(&camera, source).unwrap();
        matches!(projected.attributes(&mut gpu.record(), channels), Err(DeviceError::Misuse(_)))
    };
    assert!(!refused(&mut raster, &fitting, Channels::Full(4)));
    assert!(refused(&mut raster, &fitting, Channels::Full(49)), "more channels than there are");
    let gathered = AttributeSource { gathered: Some(short()), ..fitting.clone() };
    assert!(refused(&mut raster, &gathered, Channels::Material));
    let prototypes = AttributeSource { globals: short(), ..fitting };
    assert!(refused(&mut raster, &prototypes, Channels::Material));
}

/// Splats, and Gaussians by depth.
fn projected(raster: &mut Raster, scene: &RasterScene) -> (Buffer<SplatRecord>, Buffer<u32>) {
    let gpu = raster.gpu.clone();
    let mut rec = gpu.record();
    let (camera, source) = (CameraUniform::new(&scene.view), scene.on_device(&gpu));
    let found = raster.project(&mut rec, &camera, &source).unwrap();
    rec.submit().unwrap();
    found
}

/// The output of `tile_emit`, tiles and Gaussians, when the instances of every rank are miscounted by `off`.
fn emitted(
    raster: &mut Raster,
    scene: &RasterScene,
    off: i32,
    capacity: usize,
) -> (Vec<u32>, Vec<u32>, Vec<u32>) {
    let (gpu, n) = (raster.gpu.clone(), scene.gaussians.len());
    let (splat_buffer, order) = projected(raster, scene);
    let splats = gpu.read(&splat_buffer, 0..n).unwrap();
    let mut first = vec![0u32];
    for g in gpu.read(&order, 0..n).unwrap() {
        let counted = splats[g as usize].n_tiles.saturating_add_signed(off);
        first.push(first[first.len() - 1] + counted);
    }
    let starts = gpu.upload("first", &first).unwrap();
    let (tiles, gaussians) =
        (gpu.buffer("tiles", capacity).unwrap(), gpu.buffer("gaussians", capacity).unwrap());
    let most = (*first.last().unwrap()).min(capacity as u32 - 8);
    let mut rec = gpu.record();
    let bindings = [
        uniform(&CameraUniform::new(&scene.view)),
        uniform(&DispatchParams([n as u32, most, 0, 0])),
        (&splat_buffer).into(),
        (&order).into(),
        (&starts).into(),
        (&tiles).into(),
        (&gaussians).into(),
    ];
    rec.dispatch(&shaders::TILE_EMIT, Groups::Linear(n), &bindings);
    rec.submit().unwrap();
    (gpu.read(&tiles, 0..capacity).unwrap(), gpu.read(&gaussians, 0..capacity).unwrap(), first)
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn wrong_tile_counts_cause_no_overflow_or_undefined_entries() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let scene = RasterScene::random(40, 60, (40, 40), 1);
    let counts = counts(&scene.gpu(&mut raster, Channels::Colour, EarlyStop::WhenSaturated));
    let garbage = (-12345.0f32).to_bits();
    for (off, capacity) in [(0, counts.instances + 8), (2, counts.instances + 200), (-1, 500), (2, 90)] {
        let (tiles, gaussians, first) = emitted(&mut raster, &scene, off, capacity);
        let end = (*first.last().unwrap() as usize).min(capacity - 8);
        assert!(tiles[end..].iter().chain(&gaussians[end..]).all(|v| *v == garbage), "{off}: written past");
        assert!(tiles[..end].iter().all(|t| *t <= 9), "{off}: a tile that is none");
        assert!(gaussians[..end].iter().all(|g| *g < 60), "{off}");
        let unused = tiles[..end].iter().filter(|t| **t == 9).count();
        assert_eq!(unused > 0, off > 0, "{off}: {unused} instances marked as unused");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn pair_count_carries_beyond_32_bits() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let scene = RasterScene::random(41, 300, (64, 48), 1);
    let frame = scene.gpu(&mut raster, Channels::Colour, EarlyStop::WhenSaturated);
    let (counts, projected) = (counts(&frame), &frame.attributed.projected);
    let n = scene.gaussians.len();
    let start = u32::MAX - 5;
    let counted = gpu.upload("counts", &[0, start, 0, 0]).unwrap();
    let (keys, indices) = (gpu.buffer::<u32>("keys", n).unwrap(), gpu.buffer::<u32>("indices", n).unwrap());
    let mut rec = gpu.record();
    let bindings = [
        uniform(&projected.camera),
        uniform(&projected.source.layout),
        (&projected.source.params).into(),
        (&projected.splats).into(),
        (&keys).into(),
        (&indices).into(),
        (&counted).into(),
    ];
    rec.dispatch(&shaders::PROJECT, Groups::Linear(n), &bindings);
    rec.submit().unwrap();
    let [visible, low, high, _] = gpu.read(&counted, 0..4).unwrap()[..] else { panic!() };
    assert_eq!(visible as usize, counts.visible);
    assert_eq!((u64::from(high) << 32) + u64::from(low), u64::from(start) + counts.instances as u64);
    assert_eq!(high, 1);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn list_memory_shrinks_only_after_many_small_views() {
    let mut raster = Raster::new(&Gpu::for_tests()).unwrap();
    let (large, small) = ([1 << 20, 0, 1 << 20, 0, 9], [30_000, 0, 30_000, 0, 9]);
    raster.set_capacity(5 << 18);
    let mut views = |list_status: &[u32], count: usize| {
        (0..count).for_each(|_| assert!(raster.apply_list_status(list_status).unwrap()));
        raster.capacity()
    };
    for _ in 0..3 {
        assert_eq!(views(&small, 255), 5 << 18, "a large one may come");
        assert_eq!(views(&large, 1), 5 << 18);
    }
    assert_eq!(views(&small, 256), 60_000);
}
