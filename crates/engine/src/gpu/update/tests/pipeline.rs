//! The update after the device's own rasteriser: splats, gradient rows and labels come from its kernels.

use super::*;
use crate::gpu::{AttributeSource, Raster};
use relume_layout::constants::EarlyStop;

/// `device` with the rasteriser's splats, gradients and labels in place of the CPU engine's.
fn rasterised(gpu: &Gpu, case: &UpdateCase, channels: Channels) -> OnDevice {
    let mut device = OnDevice::new(gpu, case);
    let mut raster = Raster::new(gpu).unwrap();
    let source =
        AttributeSource { indirect_basis: Some(device.basis.clone()), ..AttributeSource::new(&device.model) };
    let by = gpu.upload("by", &case.by_gbuffer).unwrap();
    let projected = raster.prepare(&device.view, &source).unwrap();
    let mut recorder = gpu.record();
    let frame = projected.attributes(&mut recorder, channels).unwrap();
    let frame = frame.blend(&mut recorder, EarlyStop::WhenSaturated).unwrap();
    let mut frame = frame.backward(&mut recorder, &by, case.groups).unwrap();
    let labels = frame.backward_labels(&mut recorder).unwrap();
    recorder.submit().unwrap();
    device.splats = frame.blended.attributed.projected.splats.clone();
    device.rows = frame.splat_gradients.clone();
    device.view_labels = Some(labels);
    device
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradients_of_the_whole_gpu_pipeline_match_the_cpu_engine() {
    let gpu = Gpu::for_tests();
    for (seed, low_pass_compensation) in [(70, false), (71, true)] {
        for channels in [Channels::Colour, Channels::Geometry, Channels::Material, Channels::Full(9)] {
            let options = ShadingOptions {
                low_pass_compensation,
                indirect: IndirectForm::Learned,
                ..Default::default()
            };
            let shape = Shape { channels, options, ..Default::default() };
            let case = UpdateCase::new(&shape, seed, |_| ());
            let device = rasterised(&gpu, &case, channels);
            let (got, by_globals) = device.gradients(&ParameterWeights::default());
            let g = &case.model.gaussians;
            let expected = planar_rows(g, &case.expected);
            for field in Field::ALL {
                let r = range(g, field);
                let error = error_of_entries(&got[r.clone()], &expected[r]);
                eprintln!("{channels:?} {field:?} {error:e}");
                assert!(error < 1e-4, "{channels:?} {field:?}: {error:e}");
            }
            let prototypes: Vec<f32> = case.expected.prototypes.iter().flatten().copied().collect();
            let error = error_of_entries(&by_globals[..24], &prototypes);
            assert!(error < 1e-4, "{channels:?} prototypes: {error:e}");
            let density = gpu.read(&device.density, 0..shape.n).unwrap();
            for (i, d) in density.iter().enumerate() {
                assert_eq!(d[1] - 2.0, f32::from(u8::from(case.expected.visible[i])), "{i}");
            }
        }
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gradients_of_gpu_view_labels_match_the_cpu_engine() {
    let gpu = Gpu::for_tests();
    let shape = Shape::default();
    let case = UpdateCase::new(&shape, 72, |_| ());
    let mut device = rasterised(&gpu, &case, shape.channels);
    let terms = ParameterWeights { view_labels: 500.0, ..Default::default() };
    let without = device.gradients(&ParameterWeights::default()).0;
    let (got, _) = device.gradients(&terms);
    device.view_labels = Some(gpu.upload("labels", &case.labels).unwrap());
    let (expected, _) = device.gradients(&terms);
    let r = range(&case.model.gaussians, Field::Visibility);
    let error = error_of_entries(&got[r.clone()], &expected[r.clone()]);
    assert!(error < 1e-4, "{error:e}");
    let control = error_of_entries(&without[r.clone()], &expected[r]);
    assert!(control.is_finite() && control > 0.1, "the control: {control}");
}
