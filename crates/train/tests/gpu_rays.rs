//! Light that is traced along rays: the GPU engine against the CPU engine.

use std::sync::Arc;

use relume_compare::rms_difference;
use relume_scene::{Camera, EnvMap, Field, IndirectForm, Model, ShadeAt, VisibilityForm};
use relume_spec::rendering::{Output, Quality, Tier};
use relume_train::render::{Frame, Renderer};

use crate::tiers::{camera, sun, table};
use relume_reference::gpu_device;

const OUTPUTS: [Output; 3] = [Output::Rgb, Output::Diffuse, Output::Specular];

fn model(shade_at: ShadeAt, indirect: IndirectForm) -> Arc<Model> {
    let mut model = (*table()).clone();
    model.shading.shade_at = shade_at;
    model.shading.indirect = indirect;
    Arc::new(model)
}

fn shown(renderer: &Renderer, camera: &Camera, map: &EnvMap, quality: impl Into<Quality>) -> Frame {
    let light = renderer.prepare_light(map).unwrap();
    renderer.render(camera, &light, quality, &OUTPUTS).unwrap()
}

fn on_gpu(model: &Arc<Model>) -> Renderer {
    Renderer::on(model.clone(), gpu_device()).unwrap()
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64
}

/// Root mean square difference of one output.
fn distance(a: &Frame, b: &Frame, output: Output) -> f64 {
    let distance = rms_difference(&a.planes[&output], &b.planes[&output]);
    assert!(distance.is_finite(), "{output:?}");
    distance
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn per_pixel_shadows_match_the_cpu_engine() {
    for shade_at in [ShadeAt::Gaussian, ShadeAt::Pixel] {
        for indirect in [IndirectForm::Off, IndirectForm::Gathered] {
            let mut model = (*model(shade_at, indirect)).clone();
            model.gaussians.field_mut(Field::Sheen).fill(0.5);
            let model = Arc::new(model);
            let (cpu, gpu) = (Renderer::new(model.clone()), on_gpu(&model));
            let [expected, found] = [&cpu, &gpu].map(|r| shown(r, &camera(32), &sun(), Tier::High));
            let standard = shown(&gpu, &camera(32), &sun(), Tier::Standard);
            for output in OUTPUTS {
                let apart = distance(&found, &expected, output);
                let control = distance(&standard, &expected, output);
                println!("{shade_at:?} {indirect:?} {output:?}: {apart:.2e}, the control {control:.2e}");
                assert!(apart < 0.03 * control, "{shade_at:?} {indirect:?} {output:?}: {apart} of {control}");
            }
        }
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn no_shadows_without_visibility_or_under_an_even_light() {
    let mut open = (*model(ShadeAt::Gaussian, IndirectForm::Off)).clone();
    open.shading.visibility = VisibilityForm::Off;
    let open = Arc::new(open);
    let [expected, found] =
        [Renderer::new(open.clone()), on_gpu(&open)].map(|r| shown(&r, &camera(48), &sun(), Tier::High));
    let occluded = shown(&on_gpu(&table()), &camera(48), &sun(), Tier::High);
    let apart = distance(&found, &expected, Output::Rgb);
    assert!(apart < 0.01 * distance(&found, &occluded, Output::Rgb), "{apart}; the control: shadows show");
    let (gpu, even) = (on_gpu(&table()), EnvMap::constant(64, 32, [0.7; 3]));
    let [standard, high] = [Tier::Standard, Tier::High].map(|tier| shown(&gpu, &camera(24), &even, tier));
    assert_eq!(standard.planes, high.planes);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn monte_carlo_mean_and_noise_match_the_cpu_engine() {
    for (shade_at, indirect) in
        [(ShadeAt::Gaussian, IndirectForm::Gathered), (ShadeAt::Pixel, IndirectForm::Off)]
    {
        let model = model(shade_at, indirect);
        let (cpu, gpu) = (Renderer::new(model.clone()), on_gpu(&model));
        let of = |renderer: &Renderer, samples: u32, seed: u64| {
            shown(renderer, &camera(28), &sun(), Quality { seed, ..Quality::monte_carlo(samples) })
        };
        let truth = of(&cpu, 2048, 9);
        let (host, device) = (of(&cpu, 64, 0), of(&gpu, 64, 0));
        let precise = of(&gpu, 2048, 3);
        for output in OUTPUTS {
            let noise = [&host, &device, &precise].map(|frame| distance(frame, &truth, output));
            println!("{shade_at:?} {output:?}: noise {noise:.5?}");
            assert!((noise[1] / noise[0] - 1.0).abs() < 0.15, "{shade_at:?} {output:?}: {noise:?}");
            // Two frames of 2,048 samples differ by the noise of both: sqrt(2 / 32) of that of a frame of 64
            // samples.
            assert!(noise[2] < 0.35 * noise[0], "{shade_at:?} {output:?}: {noise:?}");
            let [found, expected] = [&precise, &truth].map(|frame| mean(&frame.planes[&output]));
            assert!((found / expected - 1.0).abs() < 5e-3, "{shade_at:?} {output:?}: {found} {expected}");
        }
        let brighter = sun().rotated_and_scaled(0.0, 1.02);
        let brighter = shown(&gpu, &camera(28), &brighter, Quality { seed: 3, ..Quality::monte_carlo(2048) });
        let [found, expected] = [&brighter, &truth].map(|frame| mean(&frame.planes[&Output::Rgb]));
        assert!(found / expected > 1.01, "the control: light a fiftieth too strong shows in the mean");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn samples_depend_only_on_the_seed_and_smooth_metal_reflects() {
    let mut polished = (*table()).clone();
    polished.gaussians.field_mut(Field::MetalLogit).fill(20.0);
    polished.gaussians.field_mut(Field::RoughLogit).fill(-20.0);
    let polished = Arc::new(polished);
    let of = |renderer: &Renderer, seed: u64| {
        shown(renderer, &camera(24), &sun(), Quality { seed, ..Quality::monte_carlo(32) })
    };
    let gpu = on_gpu(&polished);
    let first = of(&gpu, 1 << 40);
    assert_eq!(first.planes, of(&on_gpu(&polished), 1 << 40).planes);
    assert_ne!(first.planes, of(&gpu, 0).planes, "the control: the upper half of the seed counts");
    let sky = EnvMap::from_fn(64, 32, |d| [0.5 + 0.4 * d.x as f32, 0.5, 0.5 + 0.4 * d.z as f32]);
    let quality = Quality::monte_carlo(256);
    let expected = shown(&Renderer::new(polished), &camera(24), &sky, quality);
    let found = shown(&gpu, &camera(24), &sky, quality);
    let apart = distance(&found, &expected, Output::Specular);
    let [a, b] = [&found, &expected].map(|frame| mean(&frame.planes[&Output::Specular]));
    assert!((a / b - 1.0).abs() < 5e-3 && apart < 0.02 * b, "{a} {b} {apart}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn ray_traced_frames_are_finite_and_empty_without_a_model() {
    let gpu = on_gpu(&table());
    let mut texels = vec![[0.0f32; 3]; 64 * 32];
    texels[300] = [1e30; 3];
    for map in [EnvMap::new(64, 32, texels).unwrap().0, EnvMap::constant(8, 4, [0.0; 3])] {
        for quality in [Tier::High.into(), Quality::monte_carlo(4), Quality::monte_carlo(1)] {
            let frame = shown(&gpu, &camera(12), &map, quality);
            assert!(frame.planes.values().flatten().all(|v| v.is_finite()), "{quality:?}");
        }
    }
    let mut away = camera(12);
    away.translation.z = -away.translation.z;
    for quality in [Tier::High.into(), Quality::monte_carlo(4)] {
        let empty = shown(&gpu, &away, &sun(), quality);
        assert!(empty.planes.values().flatten().all(|v| *v == 0.0), "{quality:?}");
        let full = shown(&gpu, &camera(12), &sun(), quality);
        assert!(full.planes.values().flatten().any(|v| *v > 0.0), "the control");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn occluders_beyond_their_reach_cast_no_shadow() {
    let reaching = |reach: Option<f32>| {
        let mut model = (*table()).clone();
        model.shading.occluder_reach = reach;
        let model = Arc::new(model);
        [Renderer::new(model.clone()), on_gpu(&model)].map(|r| shown(&r, &camera(48), &sun(), Tier::High))
    };
    let ([cpu, gpu], [far, _]) = (reaching(Some(0.2)), reaching(None));
    let (apart, control) = (distance(&gpu, &cpu, Output::Diffuse), distance(&far, &cpu, Output::Diffuse));
    assert!(apart < 0.02 * control, "{apart} of {control}");
}
