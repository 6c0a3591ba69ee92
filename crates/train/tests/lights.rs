//! Dominant lights with their own shadows, in a training and in frames of both engines.

use std::sync::Arc;

use relume_engine::{
    Device, FieldUpdate, ProbeMeasurement, TrainState, TrainingEngine, TrainingLimits, TurnedLight,
};
use relume_scene::light::{EnvOperators, TableResolution};
use relume_scene::{
    Field, Illumination, LightSplit, MAX_LIGHTS, Model, ShadeAt, SplitLight, VisibilityForm, texel_directions,
};
use relume_spec::rendering::{Output, Tier};
use relume_train::render::Renderer;

use crate::tiers::{camera, sun, table};

/// A light towards (0.5, 0.2, 0.85) to which most of the nearest texel of a 32 x 16 map belongs.
fn split(radius: f32) -> LightSplit {
    let towards = glam::DVec3::new(0.5, 0.2, 0.85).normalize();
    let texels = texel_directions(32, 16);
    let nearest =
        (0..512).max_by(|a, b| texels[*a].0.dot(towards).total_cmp(&texels[*b].0.dot(towards))).unwrap();
    let mut shares = vec![[0.0; MAX_LIGHTS]; 512];
    shares[nearest][0] = 0.9;
    let direction = towards.to_array().map(|v| v as f32);
    LightSplit { lights: vec![SplitLight { direction, radius }], shares }
}

fn lit_table(split: &LightSplit) -> Model {
    let mut model = (*table()).clone();
    (model.env_width, model.env_height) = (32, 16);
    model.env_raw = vec![[-2.0; 3]; 512];
    for (raw, shares) in model.env_raw.iter_mut().zip(&split.shares) {
        *raw = raw.map(|v| v + 60.0 * shares[0]);
    }
    model.lights = split.clone();
    model
}

fn training(device: &Device, model: Model, operators: &Arc<EnvOperators>) -> Box<dyn TrainingEngine> {
    let limits = TrainingLimits {
        resolution: 32,
        pixels: 32 * 32,
        max_gaussians: model.gaussians.len() as u32,
        probe_directions: 16,
    };
    device.training(TrainState::new(model), operators, &limits).unwrap()
}

fn measurement() -> ProbeMeasurement<'static> {
    ProbeMeasurement {
        directions: 16,
        bounces: 1,
        field: FieldUpdate::Keep,
        repeats: 1,
        lights: &[TurnedLight { group: 0, radians: 0.0 }],
    }
}

/// The Gaussian nearest to `place`.
fn at(model: &Model, place: [f32; 3]) -> usize {
    let rows = model.gaussians.field(Field::Mean).as_chunks::<3>().0;
    let distance = |i: &usize| (0..3).map(|k| (rows[*i][k] - place[k]).powi(2)).sum::<f32>();
    (0..rows.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
}

/// Measures the table's shadow on a device; returns the arriving shares of the only light.
fn shadows_are_measured_and_follow_the_light(device: &Device) -> Vec<f32> {
    let (split, whole) = (split(0.0), EnvOperators::new(32, 16, 4, TableResolution::TRAINING));
    let operators = Arc::new(whole.with_lights(&split));
    let model = lit_table(&split);
    let [hidden, plate, corner] =
        [[-0.265, -0.106, 0.0], [0.0, 0.0, 0.45], [0.9, 0.9, 0.0]].map(|place| at(&model, place));
    let mut engine = training(device, model, &operators);
    assert!(engine.state().unwrap().arriving.is_empty(), "nothing is measured yet");
    engine.measure(&measurement()).unwrap();
    let state = engine.state().unwrap().into_owned();
    let share = |i: usize| state.arriving[i][0];
    assert!(share(hidden) < 0.05, "in the shadow: {}", share(hidden));
    assert!(share(plate) > 0.95 && share(corner) > 0.95, "the control: {} {}", share(plate), share(corner));
    assert!(state.arriving.iter().all(|a| a[1..] == [1.0; 3]), "there is one light only");
    // A snapshot keeps its light.
    assert!(engine.snapshot().unwrap());
    engine.light(&Arc::new(whole)).unwrap();
    let after = engine.state().unwrap().into_owned();
    assert!(after.model.lights.is_empty() && after.arriving.is_empty());
    engine.measure(&measurement()).unwrap();
    assert!(engine.state().unwrap().arriving.is_empty(), "without lights there is nothing to measure");
    engine.roll_back().unwrap();
    let back = engine.state().unwrap().into_owned();
    assert_eq!((&back.model.lights, &back.arriving), (&state.model.lights, &state.arriving));
    engine.load(state.clone()).unwrap();
    assert_eq!(engine.state().unwrap().arriving, state.arriving);
    state.arriving.iter().map(|a| a[0]).collect()
}

#[test]
fn measured_shadow_follows_its_light() {
    shadows_are_measured_and_follow_the_light(&Device::Cpu);
    // A wide light has a soft edge. Without occlusion nothing is measured.
    let steps = |radius: f32| {
        let split = split(radius);
        let whole = EnvOperators::new(32, 16, 4, TableResolution::TRAINING);
        let mut engine = training(&Device::Cpu, lit_table(&split), &Arc::new(whole.with_lights(&split)));
        engine.measure(&measurement()).unwrap();
        let state = engine.state().unwrap();
        state.arriving.iter().filter(|a| a[0] > 0.2 && a[0] < 0.8).count()
    };
    let (sharp, soft) = (steps(0.0), steps(0.1));
    assert!(soft > 2 * sharp, "{sharp} {soft}");
    let split = split(0.0);
    let mut open = lit_table(&split);
    open.shading.visibility = VisibilityForm::Off;
    let whole = EnvOperators::new(32, 16, 4, TableResolution::TRAINING);
    let mut engine = training(&Device::Cpu, open, &Arc::new(whole.with_lights(&split)));
    engine.measure(&measurement()).unwrap();
    assert!(engine.state().unwrap().arriving.is_empty());
}

/// Mean absolute difference.
fn apart(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32
}

#[test]
fn recovered_light_is_split_as_in_training() {
    let split = split(0.0);
    let render = |model: Model| {
        let light = model.recovered_light();
        let renderer = Renderer::new(Arc::new(model));
        let light = renderer.prepare_light(light).unwrap();
        let shown = renderer.render(&camera(48), &light, Tier::Standard, &[Output::Diffuse]).unwrap();
        shown.planes[&Output::Diffuse].clone()
    };
    let with = render(lit_table(&split));
    let without = render(Model { lights: LightSplit::default(), ..lit_table(&split) });
    let mean = with.iter().sum::<f32>() / with.len() as f32;
    assert!(apart(&with, &without) > 0.02 * mean, "{} of {mean}", apart(&with, &without));
    let mut deferred = lit_table(&split);
    deferred.shading.shade_at = ShadeAt::Pixel;
    let whole = Model { lights: LightSplit::default(), ..deferred.clone() };
    assert_eq!(render(deferred), render(whole), "the control: pixels have no lights of their own");
}

#[test]
fn small_rotation_changes_the_recovered_light_little() {
    let model = lit_table(&split(0.0));
    let (light, renderer) = (model.recovered_light(), Renderer::new(Arc::new(model)));
    let shown = |light: Illumination| {
        let light = renderer.prepare_light(light).unwrap();
        let frame = renderer.render(&camera(48), &light, Tier::Standard, &[Output::Diffuse]).unwrap();
        frame.planes[&Output::Diffuse].clone()
    };
    let [none, once, twice] = [0.0, 0.1, 0.2].map(|degrees| shown(light.rotated_and_scaled(degrees, 1.0)));
    let (first, second) = (apart(&none, &once), apart(&once, &twice));
    assert!(first <= 2.0 * second + 1e-6, "0 to 0.1 degrees: {first}; 0.1 to 0.2 degrees: {second}");
    let found_anew = shown(light.environment.rotated_and_scaled(0.1, 1.0).into());
    let control = apart(&none, &found_anew);
    assert!(control > 4.0 * first, "the control: lights found anew differ by {control}, not {first}");
}

mod on_gpu {
    use super::*;
    use relume_reference::gpu_device;

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn shadows_match_the_cpu_engine() {
        let cpu = shadows_are_measured_and_follow_the_light(&Device::Cpu);
        let gpu = shadows_are_measured_and_follow_the_light(gpu_device());
        assert!(apart(&gpu, &cpu) < 1e-3, "{}", apart(&gpu, &cpu));
        assert!(apart(&vec![1.0; cpu.len()], &cpu) > 2e-2, "the control: there is a shadow");
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn frames_with_a_sun_match_the_cpu_engine() {
        use relume_scene::IndirectForm;
        for indirect in [IndirectForm::Off, IndirectForm::Gathered] {
            let mut model = (*table()).clone();
            model.shading.indirect = indirect;
            let model = Arc::new(model);
            let shown = |renderer: Renderer, tier: Tier| {
                let light = renderer.prepare_light(sun()).unwrap();
                let outputs = [Output::Rgb, Output::Diffuse, Output::Specular];
                let outputs = if tier == Tier::Preview { &outputs[..1] } else { &outputs[..] };
                renderer.render(&camera(48), &light, tier, outputs).unwrap().planes
            };
            for tier in [Tier::Preview, Tier::Standard] {
                let cpu = shown(Renderer::new(model.clone()), tier);
                let gpu = shown(Renderer::on(model.clone(), gpu_device()).unwrap(), tier);
                for (output, plane) in &cpu {
                    let most = plane.iter().fold(0.0f32, |m, v| m.max(*v));
                    let apart = apart(&gpu[output], plane);
                    assert!(apart < 1e-3 * most, "{indirect:?} {tier:?} {output:?}: {apart} of {most}");
                }
            }
        }
    }
}
