//! The GPU engine against the CPU engine through the public interface: equal frames, trainings and files.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use relume_capture::{Capture, SyntheticOptions, synthetic};
use relume_compare::{difference, largest_difference};
use relume_engine::gpu::{Adapters, Gpu, GpuOptions};
use relume_engine::{Device, DeviceChoice, DeviceError};
use relume_scene::{EnvMap, Field, Model};
use relume_spec::rendering::{Output, Quality, Tier};
use relume_spec::training::{
    LabelSource, LearningRateChanges, LossWeightChanges, Preset, ShadingChanges, TrainConfig, TrainOverrides,
};
use relume_train::eval::{EvalOptions, Report, evaluate};
use relume_train::render::{PreparedLight, Renderer};
use relume_train::{TrainError, Trainer};

use crate::support::{self, short_overrides as overrides};
use crate::tiers::sun;
use relume_reference::gpu_device;

fn capture() -> &'static Capture {
    static CAPTURE: OnceLock<Capture> = OnceLock::new();
    CAPTURE.get_or_init(|| {
        let lamp = EnvMap::from_fn(32, 16, |d| [0.3 + d.x.max(0.0) as f32, 0.5, 0.6]);
        let options = SyntheticOptions {
            train_views: 8,
            test_views: 2,
            size: 40,
            paths: 16,
            relit: BTreeMap::from([("lamp".to_owned(), lamp)]),
            ..Default::default()
        };
        synthetic(&options).unwrap()
    })
}

fn trainer(overrides: &TrainOverrides, device: &Device) -> Trainer {
    support::trainer(capture(), overrides, device)
}

/// Trains to the end and returns the losses.
fn finish(trainer: &mut Trainer) -> Vec<f32> {
    support::finish(trainer).into_iter().map(|report| report.loss).collect()
}

/// A model with all features, after some steps of a training.
fn model() -> Arc<Model> {
    static MODEL: OnceLock<Arc<Model>> = OnceLock::new();
    let made = MODEL.get_or_init(|| {
        let mut trainer = trainer(&overrides(), &Device::Cpu);
        finish(&mut trainer);
        Arc::new(trainer.model().unwrap())
    });
    made.clone()
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn every_output_of_every_tier_matches_the_cpu_engine() {
    let device = gpu_device();
    let all = [
        Output::Rgb,
        Output::Albedo,
        Output::Normal,
        Output::Metallic,
        Output::Roughness,
        Output::Visibility,
        Output::Depth,
        Output::Alpha,
        Output::Diffuse,
        Output::Specular,
        Output::Radiance,
    ];
    let lamp = EnvMap::from_fn(64, 32, |d| [0.4 + d.z.max(0.0) as f32, 0.5, 0.3 + d.y.max(0.0) as f32]);
    let (cpu, gpu) = (Renderer::new(model()), Renderer::on(model(), device).unwrap());
    let lights = (cpu.prepare_light(&lamp).unwrap(), gpu.prepare_light(&lamp).unwrap());
    let camera = &capture().test[0].camera;
    for (tier, outputs) in [
        (Tier::Standard, &all[..]),
        (Tier::Preview, &all[..1]),
        (Tier::Preview, &all[..3]),
        (Tier::High, &all[..]),
        // The engines draw different samples (tests/gpu_rays.rs compares them); the other outputs are equal.
        (Tier::MonteCarlo, &[&all[1..8], &all[10..]].concat()),
    ] {
        let expected = cpu.render(camera, &lights.0, tier, outputs).unwrap();
        let found = gpu.render(camera, &lights.1, tier, outputs).unwrap();
        assert!(expected.planes.keys().eq(found.planes.keys()));
        for (output, plane) in &expected.planes {
            // The depth of an empty pixel is infinite in both frames.
            let error = largest_difference(plane, &found.planes[output]);
            // A pixel's normal may flip where the normals of two surfaces cancel.
            assert!(error < 2e-3, "{tier:?} {output:?}: {error}");
        }
    }
    let other = gpu.prepare_light(EnvMap::constant(8, 4, [1.0; 3])).unwrap();
    let (a, b) = (&lights.1, &other);
    let rgb = |light| {
        gpu.render(camera, light, Tier::Standard, &[Output::Rgb]).unwrap().planes[&Output::Rgb].clone()
    };
    let control = largest_difference(&rgb(a), &rgb(b));
    assert!(control.is_finite() && control > 0.05, "the control: another light is another picture");
}

/// The shared device's adapter, opened a second time.
fn open_again(options: GpuOptions) -> Gpu {
    let Device::Gpu(shared) = gpu_device() else { panic!("the device is a GPU") };
    Gpu::open(&Adapters::find(), shared.report().index, options).unwrap()
}

/// The same adapter, opened as if it could bind at most `bytes`.
fn narrow_device(bytes: u64) -> Device {
    let options = GpuOptions { binding_limit: Some(bytes), ..GpuOptions::from_env() };
    Device::Gpu(open_again(options))
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn large_image_rendered_in_bands_has_no_seam() {
    let narrow = narrow_device(4 << 20);
    let renderers = [Renderer::on(model(), gpu_device()).unwrap(), Renderer::on(model(), &narrow).unwrap()];
    let camera = capture().test[0].camera.resized(256, 256);
    let mut bands = Vec::new();
    let frames = renderers.map(|r| {
        let light = r.prepare_light(EnvMap::constant(8, 4, [1.0; 3])).unwrap();
        let outputs = [Output::Rgb, Output::Depth];
        let mut frame = r.bands(&camera, &light, Tier::Standard.into(), &outputs).unwrap();
        bands.push(1);
        while frame.render_next().unwrap() {
            *bands.last_mut().unwrap() += 1;
        }
        frame.into_frame()
    });
    assert!(bands[0] == 1 && bands[1] > 1, "{bands:?}");
    for (output, plane) in &frames[0].planes {
        // Projected means round differently in a band, so a splat at the threshold of alpha may count or not:
        // single pixels differ by less than that threshold. A seam would be a whole row, one in 256.
        let other = &frames[1].planes[output];
        let pairs = plane.iter().zip(other);
        let apart = pairs.filter(|(a, b)| difference((**a).into(), (**b).into()) > 1e-4).count();
        assert!(apart * 1000 < plane.len(), "{output:?}: {apart} of {}", plane.len());
        if *output != Output::Depth {
            assert!(largest_difference(plane, other) < 1.0 / 255.0, "{output:?}");
        }
        // The control: a seam, one row that shows the row above it.
        let row = plane.len() / 256;
        let mut seam = plane.clone();
        seam.copy_within(127 * row..128 * row, 128 * row);
        let apart = plane.iter().zip(&seam).filter(|(a, b)| difference((**a).into(), (**b).into()) > 1e-4);
        assert!(apart.count() * 1000 > plane.len(), "{output:?}: the control");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn concurrent_frames_match_single_threaded_frames() {
    const THREADS: usize = 3;
    let sizes = [24, 40, 64, 33];
    let views = |thread: usize| {
        let turned = (0..sizes.len()).map(move |i| (thread + i) % sizes.len());
        turned.map(move |i| (sizes[i], Tier::ALL[(thread + 2 * i) % Tier::ALL.len()]))
    };
    let render = |renderer: &Renderer, light: &PreparedLight, (size, tier): (u32, Tier)| {
        let camera = capture().test[size as usize % 2].camera.resized(size, size);
        let quality = Quality { samples: 3, ..tier.into() };
        renderer.render(&camera, light, quality, &[Output::Rgb, Output::Normal]).unwrap()
    };
    let lone = Renderer::on(model(), gpu_device()).unwrap();
    let light = lone.prepare_light(sun()).unwrap();
    // A new renderer: the tile lists of its first views are too short.
    let shared = Renderer::on(model(), gpu_device()).unwrap();
    let shared_light = shared.prepare_light(sun()).unwrap();
    std::thread::scope(|scope| {
        let drawn =
            |thread| views(thread).map(|view| render(&shared, &shared_light, view)).collect::<Vec<_>>();
        let threads: Vec<_> = (0..THREADS).map(|thread| scope.spawn(move || drawn(thread))).collect();
        for (thread, drawn) in threads.into_iter().enumerate() {
            let alone = views(thread).map(|view| render(&lone, &light, view));
            for ((found, expected), view) in drawn.join().unwrap().iter().zip(alone).zip(views(thread)) {
                assert!(*found == expected, "{view:?} of thread {thread}");
            }
        }
    });
    let other = [Tier::Standard, Tier::High].map(|tier| render(&lone, &light, (40, tier)));
    assert!(other[0] != other[1], "the control");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn lights_of_other_renderers_and_bad_cameras_are_refused() {
    let device = gpu_device();
    let (cpu, gpu) = (Renderer::new(model()), Renderer::on(model(), device).unwrap());
    let light = EnvMap::constant(8, 4, [1.0; 3]);
    let (on_cpu, on_gpu) = (cpu.prepare_light(&light).unwrap(), gpu.prepare_light(&light).unwrap());
    let camera = capture().test[0].camera;
    assert!(gpu.render(&camera, &on_cpu, Tier::Standard, &[Output::Rgb]).is_err());
    let bad = relume_scene::Camera { fx: f64::NAN, ..camera };
    let refusal =
        |r: &Renderer, l| r.render(&bad, l, Tier::Standard, &[Output::Rgb]).unwrap_err().to_string();
    assert_eq!(refusal(&gpu, &on_gpu), refusal(&cpu, &on_cpu));
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn first_training_steps_match_the_cpu_engine() {
    let device = gpu_device();
    let weights = Some(LossWeightChanges {
        smoothness: Some(0.0),
        smooth_roughness: Some(0.0),
        light: Some(0.01),
        ..Default::default()
    });
    // Adam's first step moves a texel whose gradient is only rounding as far as all others, so the steps of
    // the light are small.
    let overrides = || {
        let rates = LearningRateChanges { environment: Some(0.01), ..Default::default() };
        // Without compensation, which reduces the opacity of the small initial splats until their gradients
        // almost vanish, while this test depends on signs. The engine's tests compare the gradients of
        // compensation with f64.
        let shading = ShadingChanges { low_pass_compensation: Some(false), ..Default::default() };
        TrainOverrides { rates: Some(rates), shading: Some(shading), ..overrides() }
    };
    let forms = [
        overrides(),
        TrainOverrides { warm_up: Some(0.0), weights, ..overrides() },
        TrainOverrides { warm_up: Some(0.0), labels: Some(LabelSource::Both), ..overrides() },
        TrainOverrides {
            warm_up: Some(0.0),
            labels: Some(LabelSource::Backward),
            bounces: Some(0),
            ..overrides()
        },
        TrainOverrides {
            warm_up: Some(0.0),
            visibility_order: Some(2),
            prototypes: Some(3),
            weights,
            ..overrides()
        },
    ];
    for form in &forms {
        let (mut on_cpu, mut on_gpu) = (trainer(form, &Device::Cpu), trainer(form, device));
        let losses = |trainer: &mut Trainer| -> BTreeMap<u32, f32> {
            let reports = (0..6).map(|_| trainer.step().unwrap());
            reports.map(|report| (report.metrics_step, report.loss)).collect()
        };
        let (a, b) = (losses(&mut on_cpu), losses(&mut on_gpu));
        assert!(a.len() == 6 && b.len() >= 5, "a device is a step behind at most: {b:?}");
        for (step, b) in b {
            // From the second step on, Adam's steps from almost vanishing gradients have an effect.
            let (a, allowed) = (a[&step], if step == 1 { 2e-5 } else { 5e-3 });
            assert!((a - b).abs() < allowed * a, "{form:?} step {step}: {a} {b}");
        }
        if form.weights.is_none() {
            // The gradient of smoothness depends on the sign of differences that are initially only rounding.
            continue;
        }
        let (a, b) = (on_cpu.model().unwrap(), on_gpu.model().unwrap());
        let means = |m: &Model| m.gaussians.field(Field::Mean).to_vec();
        // A centre whose gradient almost vanishes may move in the opposite direction for one or two of the
        // six steps.
        let step = f64::from(step_size(on_cpu.config(), Field::Mean));
        let moved = largest_difference(&means(&a), &means(&b)) / step;
        assert!(moved < 2.5, "{form:?}: {moved} steps");
        // Adam's first steps depend only on the sign of the gradient, so engines may disagree where it almost
        // vanishes. The limit is a fifth of the largest movement in six steps.
        let apart = |field| {
            let pairs = a.gaussians.field(field).iter().zip(b.gaussians.field(field));
            let far = pairs
                .filter(|(a, b)| !((**a - **b).abs() <= 6.0 / 5.0 * step_size(on_cpu.config(), field)))
                .count();
            far as f64 / a.gaussians.field(field).len().max(1) as f64
        };
        // Initial Gaussians are round, so their gradient by rotation is only rounding. The sampling rate does not train.
        for field in Field::ALL.into_iter().filter(|f| !matches!(f, Field::Quaternion | Field::SamplingRate))
        {
            // Rounding also decides their shortest axis, from which the normal starts.
            let allowed = if field == Field::Normal { 0.05 } else { 0.02 };
            assert!(apart(field) < allowed, "{form:?} {field:?}: {}", apart(field));
        }
    }
}

/// Distance by which Adam moves an entry of `field` in one of the first steps.
fn step_size(config: &TrainConfig, field: Field) -> f32 {
    let rates = &config.rates;
    match field {
        Field::Mean => rates.mean,
        Field::LogScale => rates.scale,
        Field::Quaternion => rates.rotation,
        Field::OpacityLogit => rates.opacity,
        Field::Normal => rates.normal,
        Field::MetalLogit | Field::RoughLogit => rates.material,
        Field::Sheen => rates.sheen,
        Field::ProtoLogits => rates.scores,
        Field::Residual => rates.residual,
        Field::Visibility | Field::Indirect => rates.visibility,
        Field::Radiance => rates.radiance,
        Field::SamplingRate => 0.0,
    }
}

fn report(model: Model) -> Report {
    let options = EvalOptions { frame_rate_time: std::time::Duration::ZERO, ..EvalOptions::default() };
    evaluate(Arc::new(model), capture(), &options).unwrap()
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn trained_result_matches_the_cpu_engine() {
    let device = gpu_device();
    // Small steps: atomic sums have no fixed order, and with large steps the results of runs of this size
    // scatter beyond the tolerance.
    let rates = LearningRateChanges {
        mean: Some(3e-4),
        scale: Some(5e-3),
        rotation: Some(1e-3),
        opacity: Some(0.03),
        radiance: Some(2.5e-3),
        ..Default::default()
    };
    let long =
        TrainOverrides { iterations: Some(120), probe_every: Some(40), rates: Some(rates), ..overrides() };
    let (mut on_cpu, mut on_gpu) = (trainer(&long, &Device::Cpu), trainer(&long, device));
    let (first, last) = (finish(&mut on_cpu), finish(&mut on_gpu));
    assert_eq!(first.len(), last.len());
    let (a, b) = (report(on_cpu.model().unwrap()), report(on_gpu.model().unwrap()));
    let psnr = |r: &Report| [r.novel_view.psnr.unwrap(), r.relit.mean.psnr.unwrap()];
    for (a, b) in psnr(&a).into_iter().zip(psnr(&b)) {
        // With so few pixels the results scatter: on the helmet at 400 px the engines differ by 0.02 dB
        // (docs/results.md, "Precision").
        assert!((a - b).abs() < 0.25, "{a} {b}");
    }
    let untrained = report(trainer(&long, device).model().unwrap());
    assert!(psnr(&untrained)[0] < psnr(&b)[0] - 3.0, "the control: training is what makes them alike");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn checkpoint_moves_between_cpu_and_gpu_and_back() {
    let device = gpu_device();
    let config = || TrainConfig::new(Preset::Draft, &overrides()).unwrap();
    let mut first = trainer(&overrides(), &Device::Cpu);
    (0..20).for_each(|_| drop(first.step().unwrap()));
    let handed_over = first.checkpoint().unwrap();
    let mut second = Trainer::resume(capture(), config(), &handed_over, device).unwrap();
    let untouched = second.checkpoint().unwrap();
    let five_steps_on = |bytes: &[u8]| {
        let mut trainer = Trainer::resume(capture(), config(), bytes, &Device::Cpu).unwrap();
        (0..5).for_each(|_| drop(trainer.step().unwrap()));
        relume_capture::formats::model_file::encode(&trainer.model().unwrap()).unwrap()
    };
    assert!(
        five_steps_on(&untouched) == five_steps_on(&handed_over),
        "the device hands back what it was given"
    );
    assert_eq!(second.progress().step, 20);
    (0..20).for_each(|_| drop(second.step().unwrap()));
    let back = second.checkpoint().unwrap();
    let mut third = Trainer::resume(capture(), config(), &back, &Device::Cpu).unwrap();
    let (mut uninterrupted, mut psnr) = (trainer(&overrides(), &Device::Cpu), 0.0);
    while !uninterrupted.is_done() {
        psnr = uninterrupted.step().unwrap().psnr;
    }
    let mut changed = 0.0;
    while !third.is_done() {
        changed = third.step().unwrap().psnr;
    }
    assert!((psnr - changed).abs() < 0.3, "{psnr} {changed}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn trainings_too_large_for_the_device_are_refused_with_sizes() {
    let narrow = narrow_device(64 << 20);
    let refusal = |overrides: TrainOverrides| {
        let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
        match Trainer::new(capture(), config, &narrow) {
            Err(TrainError::Device(DeviceError::TooLarge { what, needs, most })) => {
                assert!(needs > most && most == 64 << 20, "{what} {needs} {most}");
                what
            }
            Err(error) => panic!("another refusal: {error}"),
            Ok(_) => panic!("must be refused"),
        }
    };
    let many = refusal(TrainOverrides { max_gaussians: Some(4_000_000), ..overrides() });
    assert!(many.contains("max_gaussians: 4000000 (at most"), "{many}");
    trainer(&overrides(), &narrow).step().unwrap();
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn extreme_step_sizes_end_in_a_finite_model_or_an_error() {
    let device = gpu_device();
    let rates = serde_json::from_value(serde_json::json!({
        "mean": 1000.0, "mean_final": 1000.0, "scale": 1000.0, "opacity": 1000.0, "radiance": 1000.0
    }));
    let mut trainer = trainer(&TrainOverrides { rates: Some(rates.unwrap()), ..overrides() }, device);
    while !trainer.is_done() {
        match trainer.step() {
            Ok(report) => assert!(report.warning.is_some() || report.loss.is_finite()),
            Err(TrainError::Diverged { .. }) => return,
            Err(error) => panic!("{error}"),
        }
    }
    assert!(trainer.model().unwrap().gaussians.is_finite(), "a poisoned model must never be handed out");
    trainer.checkpoint().unwrap();
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn training_resumes_on_the_cpu_after_a_lost_device() {
    let own = open_again(GpuOptions::default());
    let mut first = trainer(&overrides(), &Device::Gpu(own.clone()));
    (0..5).for_each(|_| drop(first.step().unwrap()));
    let checkpoint = first.checkpoint().unwrap();
    own.destroy();
    for _ in 0..2 {
        let Err(TrainError::Device(DeviceError::Lost(_))) = first.step() else {
            panic!("a lost device must be said")
        };
    }
    assert!(first.checkpoint().is_err() && first.model().is_err(), "nothing can be read from it");
    let config = TrainConfig::new(Preset::Draft, &overrides()).unwrap();
    let mut second = Trainer::resume(capture(), config, &checkpoint, &Device::Cpu).unwrap();
    finish(&mut second);
    assert!(second.model().unwrap().gaussians.is_finite());
}

#[test]
fn missing_device_is_refused_by_name() {
    let error = Device::open(DeviceChoice::Gpu(Some(99))).unwrap_err().to_string();
    assert!(error.contains("gpu:99"), "{error}");
}
