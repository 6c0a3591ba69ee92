//! Gradients of splats and backward labels.

use super::*;
use crate::cpu::{ROW_HEADER, backward_labels};
use relume_compare::relative_error;

/// A random gradient by the first `count` channels, `[pixel][stored]`; every seventh pixel has none.
fn random_gradient(view: &RasterCamera, count: usize, seed: u64) -> Vec<Vec<f32>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let stored = count.next_multiple_of(4);
    let mut row = |pixel: usize| -> Vec<f32> {
        let draw = |c: usize| if c < count && pixel % 7 != 3 { rng.random::<f32>() - 0.4 } else { 0.0 };
        (0..stored).map(draw).collect()
    };
    (0..view.width * view.height).map(&mut row).collect()
}

/// `[group][pixel]`, the layout of the device.
pub(super) fn planes(rows: &[Vec<f32>]) -> Vec<[f32; 4]> {
    let groups = rows[0].len() / 4;
    (0..groups).flat_map(|g| rows.iter().map(move |r| std::array::from_fn(|c| r[4 * g + c]))).collect()
}

/// The device's splat gradients as rows of 7 + stored floats per Gaussian.
fn device_rows(gpu: &Gpu, frame: Blended<'_>, by: &[Vec<f32>], n: usize) -> Vec<Vec<f32>> {
    let stored = by[0].len();
    let gradient = gpu.upload("by", &planes(by)).unwrap();
    let mut rec = gpu.record();
    let frame = frame.backward(&mut rec, &gradient, stored / 4).unwrap();
    rec.submit().unwrap();
    let width = GRADIENT_HEADER + stored;
    let flat = gpu.read(&frame.splat_gradients, 0..n * width).unwrap();
    let row = |r: &[f32]| {
        assert_eq!(r[7], 0.0, "the unused entry stays zero");
        [&r[..7], &r[8..]].concat()
    };
    flat.chunks_exact(width).map(row).collect()
}

/// Attribute rows per Gaussian from the CPU, the first `stored` channels of each.
pub(super) fn attributes_by_gaussian(pass: &Pass, n: usize, stored: usize) -> Vec<f32> {
    let carried = pass.channels.stored();
    let mut out = vec![0.0; n * stored];
    for (splat, row) in pass.splats.iter().zip(pass.attributes.chunks_exact(carried)) {
        out[splat.gaussian as usize * stored..][..stored].copy_from_slice(&row[..stored]);
    }
    out
}

/// Largest error over the columns, each relative to its largest entry.
fn column_error(got: &[Vec<f32>], expected: &[Vec<f64>]) -> f64 {
    worst((0..got[0].len()).map(|c| relative_error(&column(got, c), &column(expected, c))))
}

/// Runs the backward pass of both engines; returns the largest error against f64.
pub(super) fn check(raster: &mut Raster, scene: &RasterScene, channels: Channels, count: usize) -> f64 {
    let n = scene.gaussians.len();
    let gpu = raster.gpu.clone();
    let frame = scene.gpu(raster, channels, EarlyStop::Never);
    let pass = scene.cpu(channels, EarlyStop::Never);
    let by = random_gradient(&scene.view, count, 99);
    let got = device_rows(&gpu, frame, &by, n);
    let attributes = attributes_by_gaussian(&pass, n, by[0].len());
    let splats = exact::project(&scene.view, &scene.gaussians);
    column_error(&got, &exact::backward(&scene.view, &splats, &attributes, &by, n))
}

/// The gradient in the layout of the CPU's pass.
pub(super) fn for_cpu(pass: &Pass, view: &RasterCamera, by: &[Vec<f32>]) -> Vec<f32> {
    let stored = by[0].len();
    let mut out = vec![0.0f32; pass.tiles.len() * 256 * stored];
    for (pixel, row) in by.iter().enumerate() {
        let at = pass.locate(pixel % view.width, pixel / view.width, stored);
        row.iter().enumerate().for_each(|(c, v)| out[at + 16 * c] = *v);
    }
    out
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradients_of_every_channel_set_match_f64() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for (channels, count) in [
        (Channels::Colour, 4),
        (Channels::Geometry, 8),
        (Channels::Geometry, 4),
        (Channels::Material, 13),
        (Channels::Full(25), 13),
        (Channels::Full(1), 21),
        (Channels::Full(4), 24),
        (Channels::Full(9), 29),
        (Channels::Full(16), 36),
        (Channels::Full(25), 45),
        (Channels::Full(36), 56),
        (Channels::Full(49), 69),
    ] {
        let sh_degree = if let Channels::Full(c) = channels { c.isqrt() - 1 } else { 1 };
        let error = check(&mut raster, &RasterScene::random(5, 150, (37, 21), sh_degree), channels, count);
        eprintln!("{channels:?} {count}: {error:e}");
        assert!(error < 2e-5, "{channels:?} {count}: {error:e}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradients_match_the_cpu() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let scene = RasterScene::random(6, 400, (64, 48), 2);
    let (channels, count, n) = (Channels::Material, 13, scene.gaussians.len());
    let frame = scene.gpu(&mut raster, channels, EarlyStop::WhenSaturated);
    let pass = scene.cpu(channels, EarlyStop::WhenSaturated);
    let by = random_gradient(&scene.view, count, 3);
    let got = device_rows(&gpu, frame, &by, n);
    let by = for_cpu(&pass, &scene.view, &by);
    let width = ROW_HEADER + count;
    let summed = pass.splat_gradients(&by, 16, count);
    let by_channel: Vec<f32> =
        summed.chunks_exact(width).flat_map(|row| row[ROW_HEADER..].to_vec()).collect();
    let rows = pass.backward(&scene.source(), &by, 16, count, None);
    let scale = by_channel.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    for (splat, expected) in pass.splats.iter().zip(by_channel.chunks_exact(count)) {
        let i = splat.gaussian as usize;
        for (g, e) in got[i][7..].iter().zip(expected) {
            assert!((g - e).abs() < 1e-5 * scale, "Gaussian {i}: {g} {e}");
        }
        let absgrad = got[i][6] * 0.5 * 64.0;
        assert!((absgrad - rows.absgrad[i]).abs() < 1e-4 * rows.absgrad[i].max(1.0), "Gaussian {i}");
        assert!(got[i][0].hypot(got[i][1]) <= got[i][6] * 1.0001, "a sum is no longer than its parts");
        let sigma = crate::sigmoid(scene.gaussians.row(Field::OpacityLogit, i)[0]);
        let opacity = got[i][5] * splat.compensation * sigma * (1.0 - sigma);
        let expected = rows.get(Field::OpacityLogit, i)[0];
        assert!(
            (opacity - expected).abs() < 1e-4 * expected.abs().max(0.1),
            "Gaussian {i}: {opacity} {expected}"
        );
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn the_gradient_comparison_notices_one_changed_pixel() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let scene = RasterScene::random(5, 150, (37, 21), 1);
    let n = scene.gaussians.len();
    let frame = scene.gpu(&mut raster, Channels::Material, EarlyStop::Never);
    let pass = scene.cpu(Channels::Material, EarlyStop::Never);
    let mut by = random_gradient(&scene.view, 13, 99);
    let attributes = attributes_by_gaussian(&pass, n, 16);
    let splats = exact::project(&scene.view, &scene.gaussians);
    let expected = exact::backward(&scene.view, &splats, &attributes, &by, n);
    by[10 * 37 + 19].iter_mut().for_each(|v| *v *= 1.1);
    let error = column_error(&device_rows(&gpu, frame, &by, n), &expected);
    assert!(error.is_finite() && error > 2e-4, "{error:e}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn zero_gradients_stay_zero_and_wrong_group_counts_are_refused() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    fn geometry(raster: &mut Raster) -> Blended<'_> {
        RasterScene::random(5, 150, (37, 21), 1).gpu(raster, Channels::Geometry, EarlyStop::WhenSaturated)
    }
    let rows = device_rows(&gpu, geometry(&mut raster), &vec![vec![0.0; 8]; 37 * 21], 150);
    assert!(rows.iter().flatten().all(|v| *v == 0.0));
    let by = gpu.upload("by", &vec![[0.0f32; 4]; 4 * 37 * 21]).unwrap();
    let refused = geometry(&mut raster).backward(&mut gpu.record(), &by, 4);
    assert!(matches!(refused, Err(DeviceError::Misuse(_))));
    let short = gpu.upload("by", &[[0.0f32; 4]; 37]).unwrap();
    let refused = geometry(&mut raster).backward(&mut gpu.record(), &short, 1);
    assert!(matches!(refused, Err(DeviceError::Misuse(_))));
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradients_without_float_atomics_match_f64() {
    let options =
        crate::gpu::GpuOptions { compare_exchange: true, garbage: true, checks: true, ..Default::default() };
    let gpu = Gpu::with_options(options);
    let mut raster = Raster::new(&gpu).unwrap();
    let error = check(&mut raster, &RasterScene::random(5, 150, (37, 21), 1), Channels::Material, 13);
    assert!(error < 2e-5, "{error:e}");
}

/// Largest error of labels and weights, relative to the largest weight.
pub(super) fn label_error(raster: &mut Raster, scene: &RasterScene) -> f64 {
    let gpu = raster.gpu.clone();
    let mut projected = raster.prepare(&CameraUniform::new(&scene.view), &scene.on_device(&gpu)).unwrap();
    let mut rec = gpu.record();
    let labels = projected.backward_labels(&mut rec).unwrap();
    rec.submit().unwrap();
    let n = scene.gaussians.len();
    let got = gpu.read(&labels, 0..n).unwrap();
    let pass = scene.cpu(Channels::Colour, EarlyStop::WhenSaturated);
    let expected = backward_labels(&pass);
    let scale = expected.iter().fold(1e-9f32, |m, l| m.max(l.weight));
    let mut unseen = vec![true; n];
    let mut largest = 0.0;
    for (splat, label) in pass.splats.iter().zip(expected) {
        unseen[splat.gaussian as usize] = false;
        let [sum, weight] = got[splat.gaussian as usize];
        let differences = [weight - label.weight, sum - label.transmittance * label.weight];
        largest = worst([largest, worst(differences.map(|d| d.abs() / scale))]);
    }
    assert!((0..n).all(|i| !unseen[i] || got[i] == [0.0; 2]), "invisible splats have no label");
    largest
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn backward_labels_match_the_cpu() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for (seed, n, size) in [(21, 400, (64, 48)), (22, 300, (37, 21)), (23, 30, (1, 1))] {
        let error = label_error(&mut raster, &RasterScene::random(seed, n, size, 1));
        eprintln!("labels of {n} in {size:?}: {error:e}");
        assert!(error < 1e-5, "{size:?}: {error:e}");
    }
}
