//! Captures under several lights: each light group has an environment, materials are common.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use relume_capture::{Capture, SyntheticOptions, SyntheticScene, synthetic};
use relume_compare::largest_difference;
use relume_engine::Device;
use relume_reference::gpu_device;
use relume_scene::{EnvMap, Field, Model};
use relume_spec::training::{Preset, TrainConfig, TrainOverrides};
use relume_train::eval::{EvalOptions, evaluate};
use relume_train::{TrainError, Trainer};

use crate::support::{self, finish, trainer};

/// A warm light from one side and a blue one from the other.
fn lights() -> [EnvMap; 2] {
    let lamp = |side: f64, colour: [f32; 3]| {
        EnvMap::from_fn(32, 16, |d| {
            let lobe = (0.8 * side * d.x + 0.6 * d.z).max(0.0).powi(8) as f32;
            colour.map(|c| 0.1 + 5.0 * c * lobe)
        })
    };
    [lamp(1.0, [1.4, 1.0, 0.6]), lamp(-1.0, [0.6, 1.0, 1.5])]
}

/// Photographs by turns under the two lights, with a held-out one under each.
fn two_lights() -> &'static Capture {
    static CAPTURE: OnceLock<Capture> = OnceLock::new();
    CAPTURE.get_or_init(|| {
        let [first, second] = lights().map(|train_light| {
            let options = SyntheticOptions {
                scene: SyntheticScene::default(),
                train_views: 12,
                test_views: 2,
                size: 40,
                train_light,
                relit: BTreeMap::new(),
                paths: 16,
                ..SyntheticOptions::default()
            };
            synthetic(&options).unwrap()
        });
        let mut out = first;
        for (i, view) in out.train.iter_mut().enumerate() {
            if i % 2 == 1 {
                *view = second.train[i].clone();
            }
            view.light_group = Some(["warm", "blue"][i % 2].to_owned());
        }
        out.test[1] = second.test[1].clone();
        for (view, group) in out.test.iter_mut().zip(["warm", "blue"]) {
            view.light_group = Some(group.to_owned());
        }
        out
    })
}

fn without_groups() -> Capture {
    let mut capture = two_lights().clone();
    capture.train.iter_mut().chain(&mut capture.test).for_each(|view| view.light_group = None);
    capture
}

fn trained(capture: &Capture, device: &Device) -> Model {
    let mut trainer = trainer(capture, &support::overrides(240), device);
    finish(&mut trainer);
    trainer.model().unwrap()
}

/// Blue over red of the mean radiance of a light.
fn blueness(model: &Model, group: &str) -> f32 {
    let map = model.environment(model.light_group(group).unwrap());
    let sum = |c: usize| map.texels().iter().map(|t| t[c]).sum::<f32>();
    sum(2) / sum(0)
}

#[test]
fn light_groups_recover_a_light_each() {
    let model = trained(two_lights(), &Device::Cpu);
    assert_eq!(model.light_group_names(), ["blue", "warm"]);
    let (warm, blue) = (blueness(&model, "warm"), blueness(&model, "blue"));
    assert!(warm < 0.9 && blue > 1.1, "{warm} {blue}");
    let named = |name: &str| model.named_recovered_light(name).unwrap();
    assert_eq!(named("recovered:warm").unwrap().environment, model.environment(1));
    assert_eq!(named("recovered").unwrap().environment, model.environment(0));
    let error = named("recovered:noon").unwrap_err();
    assert!(error.contains("noon") && error.contains("blue, warm"), "{error}");
    let psnr = |model: Model, capture: &Capture| {
        evaluate(Arc::new(model), capture, &EvalOptions::default()).unwrap().novel_view.psnr.unwrap()
    };
    let control = without_groups();
    let (with, without) = (psnr(model, two_lights()), psnr(trained(&control, &Device::Cpu), &control));
    assert!(with > without + 1.5, "held out: {with} dB with groups, {without} dB without");
}

#[test]
fn training_with_light_groups_resumes_with_the_same_bytes() {
    let form = TrainOverrides { iterations: Some(60), probe_every: Some(13), ..support::overrides(240) };
    let result = |mut trainer: Trainer| {
        finish(&mut trainer);
        let model = trainer.model().unwrap();
        (model.gaussians.field(Field::Mean).to_vec(), model.env_raw)
    };
    let undisturbed = result(trainer(two_lights(), &form, &Device::Cpu));
    let mut stopped = trainer(two_lights(), &form, &Device::Cpu);
    (0..30).for_each(|_| drop(stopped.step().unwrap()));
    let checkpoint = stopped.checkpoint().unwrap();
    let config = TrainConfig::new(Preset::Draft, &form).unwrap();
    let resume = |capture: &Capture| Trainer::resume(capture, config.clone(), &checkpoint, &Device::Cpu);
    assert!(result(resume(two_lights()).unwrap()) == undisturbed);
    let Err(TrainError::Checkpoint(why)) = resume(&without_groups()) else { panic!("must be refused") };
    assert!(why.contains("light groups"), "{why}");
}

#[test]
fn known_light_is_refused_with_light_groups() {
    let mut capture = two_lights().clone();
    capture.measured_light = Some(lights()[0].clone());
    let light = serde_json::json!({ "light": { "environment": "lamp" } });
    let overrides: TrainOverrides = serde_json::from_value(light).unwrap();
    let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
    let refused = |capture: &Capture| match Trainer::new(capture, config.clone(), &Device::Cpu) {
        Err(TrainError::Invalid(why)) => Some(why),
        _ => None,
    };
    assert!(refused(&capture).unwrap().contains("light groups"));
    capture.train.iter_mut().for_each(|view| view.light_group = None);
    assert_eq!(refused(&capture), None, "the control");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn light_groups_train_equally_on_gpu_and_cpu() {
    let first_steps = |capture: &Capture, device: &Device| -> Vec<f32> {
        let overrides = TrainOverrides { warm_up: Some(0.0), ..support::overrides(240) };
        let mut trainer = trainer(capture, &overrides, device);
        // A device may be one step behind. Later steps depend on rounding, since Adam divides small gradients by their size.
        let reports: Vec<_> = (0..3).map(|_| trainer.step().unwrap()).collect();
        let of_step = |n| reports.iter().find(|report| report.metrics_step == n).unwrap().psnr;
        (1..=2).map(of_step).collect()
    };
    let expected = first_steps(two_lights(), &Device::Cpu);
    let found = first_steps(two_lights(), gpu_device());
    assert!(largest_difference(&found, &expected) < 1e-3, "{found:?} {expected:?}");
    let control = largest_difference(&first_steps(&without_groups(), gpu_device()), &expected);
    assert!(control.is_finite() && control > 0.02, "the control: without groups, {control} dB");
}
