//! The trainer through its public interface: it learns, is reproducible, resumes, and refuses invalid input.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use relume_capture::formats::model_file;
use relume_capture::{Capture, SyntheticOptions, SyntheticScene, synthetic};
use relume_engine::Device;
use relume_scene::{EnvMap, Field, IndirectForm, Model, VisibilityForm};
use relume_spec::training::{
    Complexity, KnownLight, LabelSource, LightExposure, LossWeightChanges, Preset, TrainConfig,
    TrainOverrides,
};
use relume_train::{PreparedTraining, TrainError, Trainer};

use crate::support::short_overrides as overrides;

fn capture() -> &'static Capture {
    static CAPTURE: OnceLock<Capture> = OnceLock::new();
    CAPTURE.get_or_init(|| {
        let options = SyntheticOptions {
            train_views: 8,
            test_views: 1,
            size: 40,
            paths: 16,
            relit: BTreeMap::new(),
            ..Default::default()
        };
        synthetic(&options).unwrap()
    })
}

fn config(overrides: &TrainOverrides) -> TrainConfig {
    TrainConfig::new(Preset::Draft, overrides).unwrap()
}

fn run(mut trainer: Trainer) -> Vec<u8> {
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    model_file::encode(&trainer.model().unwrap()).unwrap()
}

fn trained(overrides: &TrainOverrides) -> Vec<u8> {
    run(Trainer::new(capture(), config(overrides), &Device::Cpu).unwrap())
}

fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

#[test]
fn equal_seeds_give_equal_bytes_on_one_and_three_threads() {
    let one = with_threads(1, || trained(&overrides()));
    let three = with_threads(3, || trained(&overrides()));
    assert!(one == three, "the number of threads must not show in the bytes");
    let other = trained(&TrainOverrides { seed: Some(1), ..overrides() });
    assert!(one != other, "another seed must show in the bytes");
}

#[test]
fn photograph_cache_size_does_not_change_the_model() {
    // Photographs that are divided by their gains are decoded again.
    let overrides = TrainOverrides { match_exposures: Some(false), ..overrides() };
    let trained = |bytes: usize| {
        let preparation = PreparedTraining::new(capture(), config(&overrides)).unwrap();
        let mut trainer = preparation.with_photo_cache(bytes).on(&Device::Cpu).unwrap();
        while !trainer.is_done() {
            trainer.step().unwrap();
        }
        let stats = trainer.decoding();
        (model_file::encode(&trainer.model().unwrap()).unwrap(), stats)
    };
    let photograph = 40 * 40 * 16;
    let (one, few) = trained(photograph);
    let (all, once) = trained(usize::MAX);
    assert!(one == all, "the bound must not show in the bytes");
    // Eight photographs at two sizes.
    assert!(once.decoded == 16 && few.decoded > 16, "{few:?} {once:?}");
}

#[test]
fn resumed_training_gives_the_same_bytes() {
    let undisturbed = trained(&overrides());
    // Step 30 is between two probe refreshes, two density rounds and two snapshots.
    for stop in [1, 17, 30, 59] {
        let mut trainer = Trainer::new(capture(), config(&overrides()), &Device::Cpu).unwrap();
        (0..stop).for_each(|_| {
            trainer.step().unwrap();
        });
        let checkpoint = trainer.checkpoint().unwrap();
        drop(trainer);
        let resumed = Trainer::resume(capture(), config(&overrides()), &checkpoint, &Device::Cpu).unwrap();
        assert_eq!(resumed.progress().step, stop);
        assert!(run(resumed) == undisturbed, "resumed at step {stop}");
    }
}

#[test]
fn checkpoint_of_another_config_or_truncated_is_refused() {
    let mut trainer = Trainer::new(capture(), config(&overrides()), &Device::Cpu).unwrap();
    trainer.step().unwrap();
    let bytes = trainer.checkpoint().unwrap();
    let other = config(&TrainOverrides { seed: Some(9), ..overrides() });
    let refusal = |config, bytes: &[u8]| match Trainer::resume(capture(), config, bytes, &Device::Cpu) {
        Err(TrainError::Checkpoint(why)) => why,
        Err(e) => panic!("another refusal: {e}"),
        Ok(_) => panic!("must be refused"),
    };
    assert!(refusal(other, &bytes).contains("config"));
    for cut in [0, 8, bytes.len() / 2, bytes.len() - 1] {
        refusal(config(&overrides()), &bytes[..cut]);
    }
}

#[test]
fn training_improves_psnr_by_three_decibels() {
    let long = TrainOverrides { iterations: Some(240), ..overrides() };
    let mut trainer = Trainer::new(capture(), config(&long), &Device::Cpu).unwrap();
    let mut psnr = Vec::new();
    while !trainer.is_done() {
        psnr.push(trainer.step().unwrap().psnr);
    }
    let mean = |range: std::ops::Range<usize>| {
        let n = range.len() as f32;
        psnr[range].iter().sum::<f32>() / n
    };
    let (early, late) = (mean(0..20), mean(220..240));
    assert!(late > early + 3.0, "{early} dB at first, {late} dB at last");
}

#[test]
fn every_label_source_trains_to_finite_parameters() {
    for labels in [LabelSource::None, LabelSource::Backward, LabelSource::Probes, LabelSource::Both] {
        let bytes = trained(&TrainOverrides { labels: Some(labels), iterations: Some(40), ..overrides() });
        let model = model_file::decode(&bytes).unwrap();
        assert!(model.gaussians.is_finite(), "{labels:?}");
        let moved = model.gaussians.field(Field::Visibility).chunks_exact(25).any(|c| c[3].abs() > 1e-4);
        assert!(moved, "{labels:?}: visibility must have been learned or measured");
    }
}

#[test]
fn known_light_stays_fixed_after_resume_and_must_exist() {
    let light =
        KnownLight { environment: "lamp".into(), rotation_deg: 0.0, exposure_ev: LightExposure::Stops(-1.0) };
    let config = config(&TrainOverrides { light: Some(light), ..overrides() });
    let refused = Trainer::new(capture(), config.clone(), &Device::Cpu).err().unwrap();
    assert!(matches!(refused, TrainError::Invalid(m) if m.starts_with("light:")));

    let map = EnvMap::from_fn(64, 32, |d| [1.0 + d.z as f32, 0.5, 0.3 + 0.2 * d.x as f32]);
    let lit = Capture { measured_light: Some(map.clone()), ..capture().clone() };
    let mut trainer = Trainer::new(&lit, config.clone(), &Device::Cpu).unwrap();
    (0..30).for_each(|_| {
        trainer.step().unwrap();
    });
    let mut trainer = Trainer::resume(&lit, config, &trainer.checkpoint().unwrap(), &Device::Cpu).unwrap();
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    let found = trainer.model().unwrap().environment(0);
    let told = map.rotated_and_scaled(0.0, 0.5).resampled(32, 16);
    for (a, b) in found.texels().iter().flatten().zip(told.texels().iter().flatten()) {
        assert!((a - b).abs() < 1e-4 * (1.0 + b), "{a} {b}");
    }
}

#[test]
fn extreme_step_sizes_end_in_a_finite_model_or_an_error() {
    let rates = serde_json::from_value(serde_json::json!({
        "mean": 1000.0, "mean_final": 1000.0, "scale": 1000.0, "opacity": 1000.0, "radiance": 1000.0
    }));
    let wild = TrainOverrides { rates: Some(rates.unwrap()), ..overrides() };
    let mut trainer = Trainer::new(capture(), config(&wild), &Device::Cpu).unwrap();
    for _ in 0..200 {
        if trainer.is_done() {
            break;
        }
        match trainer.step() {
            Ok(report) => assert!(report.warning.is_some() || report.loss.is_finite()),
            Err(TrainError::Diverged { .. }) => return,
            Err(e) => panic!("{e}"),
        }
    }
    assert!(trainer.model().unwrap().gaussians.is_finite(), "a poisoned model must never be handed out");
    trainer.checkpoint().unwrap();
}

#[test]
fn extreme_weights_give_a_finite_model() {
    let heavy = LossWeightChanges {
        depth_normal: Some(1000.0),
        flatness: Some(1000.0),
        smoothness: Some(1000.0),
        ..Default::default()
    };
    let bytes = trained(&TrainOverrides { weights: Some(heavy), iterations: Some(40), ..overrides() });
    assert!(model_file::decode(&bytes).unwrap().gaussians.is_finite());
}

fn auto() -> TrainOverrides {
    TrainOverrides { complexity: Some(Complexity::Auto), max_gaussians: None, ..overrides() }
}

fn sized(overrides: &TrainOverrides) -> TrainConfig {
    TrainConfig {
        max_gaussians: 500,
        ..config(&TrainOverrides { initial_gaussians: Some(300), ..overrides.clone() })
    }
}

fn auto_model(scene: SyntheticScene, overrides: &TrainOverrides) -> Model {
    let options = SyntheticOptions {
        scene,
        train_views: 10,
        test_views: 1,
        size: 40,
        paths: 16,
        relit: BTreeMap::new(),
        ..Default::default()
    };
    let config = TrainConfig { iterations: 120, ..sized(overrides) };
    let trainer = Trainer::new(&synthetic(&options).unwrap(), config, &Device::Cpu).unwrap();
    model_file::decode(&run(trainer)).unwrap()
}

#[test]
fn auto_complexity_drops_visibility_on_a_ball_not_on_a_table() {
    let ball = auto_model(SyntheticScene::MatteBall, &auto());
    assert_eq!(ball.shading.visibility, VisibilityForm::Off, "{}", ball.card["complexity"]);
    assert_eq!(ball.shading.indirect, IndirectForm::Off);
    assert_eq!(ball.gaussians.visibility_degree(), 0);
    let table = auto_model(SyntheticScene::Table, &auto());
    assert_eq!(table.shading.visibility, VisibilityForm::Linear, "{}", table.card["complexity"]);
    assert!(table.gaussians.visibility_degree() >= 1);
    let named =
        TrainOverrides { visibility_order: Some(2), bounces: Some(1), metalness: Some(false), ..auto() };
    let forced = auto_model(SyntheticScene::MatteBall, &named);
    assert_eq!(forced.shading.visibility, VisibilityForm::Linear, "what is named wins");
    assert_eq!(forced.gaussians.visibility_degree(), 2);
    assert!(forced.gaussians.field(Field::MetalLogit).iter().all(|m| *m == -9.0));
}

#[test]
fn resume_around_complexity_decisions_gives_the_same_bytes() {
    let start = || Trainer::new(capture(), sized(&auto()), &Device::Cpu).unwrap();
    let undisturbed = run(start());
    // Decisions are made after 15 and 37 steps and at the end.
    for stop in [15, 16, 37, 38, 60] {
        let mut trainer = start();
        (0..stop).for_each(|_| {
            trainer.step().unwrap();
        });
        let checkpoint = trainer.checkpoint().unwrap();
        let resumed = Trainer::resume(capture(), sized(&auto()), &checkpoint, &Device::Cpu).unwrap();
        assert!(run(resumed) == undisturbed, "resumed at step {stop}");
    }
    let full = TrainOverrides { complexity: Some(Complexity::Full), ..auto() };
    let other = run(Trainer::new(capture(), sized(&full), &Device::Cpu).unwrap());
    assert!(other != undisturbed, "the control: decisions show in the bytes");
}
