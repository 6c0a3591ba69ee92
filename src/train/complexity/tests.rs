//! The ledger on hand-made states, and what applying a decision keeps.

use super::*;
use crate::engine::constants::EarlyStop;
use crate::scene::{Gaussians, Model, ShadingOptions};
use crate::train::{Preset, TrainOverrides};

fn state() -> Learned {
    let mut gaussians = Gaussians::zeroed(5, 4, 4, 1);
    for (_, _, data) in gaussians.fields_mut() {
        data.iter_mut().enumerate().for_each(|(i, v)| *v = ((i * 37) % 23) as f32 / 23.0 - 0.4);
    }
    let mut learned = Learned::new(Model {
        gaussians,
        prototypes: vec![[0.5, 0.4, 0.3], [0.51, 0.41, 0.3], [0.9, 0.8, 0.1], [0.1, 0.2, 0.3]],
        env_raw: vec![[0.5; 3]; 8],
        env_width: 4,
        env_height: 2,
        shading: ShadingOptions::default(),
        world_scale: 1.0,
        world_offset: glam::DVec3::ZERO,
        card: Value::Null,
    });
    learned.labels = learned.model.gaussians.field(Field::Visibility).to_vec();
    learned.gathered = (0..5).map(|i| [i as f32; 6]).collect();
    learned.moments.first.field_mut(Field::Mean).fill(7.0);
    learned
}

fn albedo(learned: &Learned, i: usize) -> [f32; 3] {
    let options = ShadingOptions::default();
    let source = crate::engine::cpu::AttributeSource {
        gaussians: &learned.model.gaussians,
        prototypes: &learned.model.prototypes,
        options: &options,
        gathered: &[],
        indirect_basis: &[[0.0; 3]; 16],
        light: None,
    };
    source.albedo(i)
}

#[test]
fn cutting_degrees_keeps_the_lower_ones_and_the_moments() {
    let (before, mut after) = (state(), state());
    apply::cut_orders(&mut after, Visibility::Order(2), 0);
    let (old, new) = (&before.model.gaussians, &after.model.gaussians);
    assert_eq!((new.visibility_order(), new.radiance_order()), (2, 0));
    assert_eq!(new.row(Field::Visibility, 3), &old.row(Field::Visibility, 3)[..9]);
    assert_eq!(new.row(Field::Radiance, 3), &old.row(Field::Radiance, 3)[..3]);
    assert_eq!(new.field(Field::ProtoLogits), old.field(Field::ProtoLogits));
    assert_eq!(after.labels[3 * 9..4 * 9], before.labels[3 * 25..3 * 25 + 9]);
    assert_eq!(after.moments.first.row(Field::Mean, 4), [7.0; 3]);
    assert_eq!(after.moments.second.visibility_order(), 2);
}

#[test]
fn merging_twins_changes_no_albedo_and_merging_others_without_compensation_would() {
    let (before, mut after) = (state(), state());
    let groups = [vec![0, 1], vec![2, 3]];
    let overlap = evidence::Overlap::of(&before.model.gaussians, &[0.4, 0.3, 0.297, 0.003, 0.0]);
    apply::merge_prototypes(&mut after, &groups, &overlap);
    assert_eq!(after.model.prototypes.len(), 2);
    assert_eq!(after.moments.globals[0].len(), 2 + 8);
    assert!(after.model.check().is_ok());
    for i in 0..5 {
        let [a, b] = [albedo(&before, i), albedo(&after, i)];
        assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-5), "{a:?} {b:?}");
    }
    after
        .model
        .gaussians
        .field_mut(Field::Residual)
        .copy_from_slice(before.model.gaussians.field(Field::Residual));
    let moved = (0..5).any(|i| (0..3).any(|c| (albedo(&before, i)[c] - albedo(&after, i)[c]).abs() > 1e-2));
    assert!(moved, "the control: it is the residual that holds the albedo");
}

#[test]
fn a_dielectric_keeps_its_diffuse_colour() {
    let (before, mut after) = (state(), state());
    apply::make_dielectric(&mut after);
    for i in 0..5 {
        let left = 1.0 - crate::engine::cpu::sigmoid(before.model.gaussians.row(Field::MetalLogit, i)[0]);
        let [a, b] = [albedo(&before, i), albedo(&after, i)];
        // Below 0 and above 1 an albedo is clamped.
        let inside = |v: f32| v > 0.001 && v < 0.999;
        assert!((0..3).all(|c| !inside(a[c]) || (a[c] * left - b[c]).abs() < 1e-5), "{a:?} {b:?}");
        assert!(crate::engine::cpu::sigmoid(after.model.gaussians.row(Field::MetalLogit, i)[0]) < 1e-3);
    }
}

#[test]
fn what_stays_keeps_its_rows() {
    let (before, mut after) = (state(), state());
    apply::keep(&mut after, &[1, 4]);
    assert_eq!(after.labels[25..], before.labels[100..]);
    assert_eq!(after.gathered, [[1.0; 6], [4.0; 6]]);
    assert_eq!(after.model.gaussians.row(Field::Mean, 1), before.model.gaussians.row(Field::Mean, 4));
    assert_eq!((after.moments.first.len(), after.density.seen.len()), (2, 2));
}

fn config(overrides: &TrainOverrides) -> TrainConfig {
    TrainConfig { complexity: Complexity::Auto, ..TrainConfig::new(Preset::Draft, overrides).unwrap() }
}

/// A ball's upper side: every surface is open to what it faces. `share`: bounced over direct irradiance.
fn convex(share: f32) -> Learned {
    let mut learned = state();
    let rows = (0..5).flat_map(|_| evidence::half_open(4, [0.0, 0.0, 1.0]));
    learned.labels = rows.collect();
    let labels = learned.labels.clone();
    let g = &mut learned.model.gaussians;
    g.field_mut(Field::Visibility).copy_from_slice(&labels);
    for i in 0..5 {
        g.row_mut(Field::Quaternion, i).copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
        g.row_mut(Field::LogScale, i).copy_from_slice(&[0.0, 0.0, -3.0]);
        g.row_mut(Field::Radiance, i)[3..].fill(0.0);
    }
    let direct = learned.model.environment().texels()[0][0] * std::f32::consts::PI;
    learned.gathered = vec![[share * direct; 6]; 5];
    learned
}

fn in_context(overrides: &TrainOverrides, act: impl FnOnce(&StepContext<'_>)) {
    let config = config(overrides);
    let operators = crate::light::EnvOperators::new(4, 2, 4, crate::light::TableResolution::TRAINING);
    act(&StepContext {
        config: &config,
        operators: &operators,
        background: [1.0; 3],
        has_alpha: true,
        progress: 0.3,
    });
}

fn decided(overrides: &TrainOverrides, concavity: f32, mut learned: Learned) -> (Ledger, Learned) {
    let mut ledger = Ledger::default();
    let shown = Shown { weights: vec![1.0; 5], concavity: Some(concavity) };
    in_context(overrides, |context| ledger.decide_orders(context, 7, &shown, &mut learned));
    (ledger, learned)
}

#[test]
fn a_convex_thing_needs_no_visibility_and_no_indirect_light() {
    let (ledger, learned) = decided(&TrainOverrides::default(), 0.0, convex(0.001));
    assert_eq!(learned.model.shading.visibility, VisibilityForm::Off);
    assert_eq!(learned.model.shading.indirect, IndirectForm::Off);
    let g = &learned.model.gaussians;
    assert_eq!((g.visibility_order(), g.radiance_order()), (0, 1));
    assert!(learned.labels.is_empty() && learned.gathered.is_empty());
    let card = ledger.card(&config(&TrainOverrides::default()));
    assert_eq!(card["findings"][0]["is"], "off", "{card}");
    assert!(card["findings"][0]["evidence"]["bounced_over_direct"].as_f64().unwrap() < 0.01, "{card}");
}

#[test]
fn bounced_light_keeps_itself_and_the_visibility_that_lets_it_in() {
    let (_, learned) = decided(&TrainOverrides::default(), 0.2, convex(0.5));
    assert_eq!(learned.model.shading, ShadingOptions::default());
    assert!(learned.model.gaussians.visibility_order() >= 1);
}

#[test]
fn what_is_named_is_not_decided() {
    let named = TrainOverrides {
        visibility_order: Some(4),
        radiance_order: Some(1),
        bounces: Some(2),
        ..TrainOverrides::default()
    };
    let (ledger, learned) = decided(&named, 0.0, convex(0.001));
    assert_eq!(learned.model.shading, ShadingOptions::default());
    let g = &learned.model.gaussians;
    assert_eq!((g.visibility_order(), g.radiance_order()), (4, 1));
    assert!(ledger.findings.iter().all(|f| f.forced) && ledger.findings.len() == 3, "{ledger:?}");
}

#[test]
fn decisions_come_once_each_in_order_and_only_if_asked_for() {
    let auto = config(&TrainOverrides { iterations: Some(100), ..Default::default() });
    let mut ledger = Ledger::default();
    assert_eq!(ledger.due(&auto, 24), None);
    assert_eq!(ledger.due(&auto, 25), Some(Point::Measured));
    ledger.points = 1;
    assert_eq!((ledger.due(&auto, 60), ledger.due(&auto, 61)), (None, Some(Point::Trained)));
    ledger.points = 2;
    assert_eq!((ledger.due(&auto, 61), ledger.due(&auto, 62)), (None, Some(Point::HalfWay)));
    ledger.points = 3;
    assert_eq!((ledger.due(&auto, 99), ledger.due(&auto, 100)), (None, Some(Point::End)));
    let full = TrainConfig { complexity: Complexity::Full, ..auto };
    assert_eq!(ledger.due(&full, 100), None);
}

#[test]
fn metalness_is_judged_when_it_has_trained_and_not_when_it_has_just_started_anew() {
    for iterations in [100, 801, 1500] {
        let auto = config(&TrainOverrides { iterations: Some(iterations), ..Default::default() });
        let when = |points, point| {
            let ledger = Ledger { points, ..Ledger::default() };
            (0..iterations).find(|step| ledger.due(&auto, *step) == Some(point)).unwrap()
        };
        let (trained, half_way) = (when(1, Point::Trained), when(2, Point::HalfWay));
        let anew = (0..=trained).rfind(|step| auto.is_albedo_round(*step)).unwrap();
        assert!(
            trained - anew > (iterations - auto.warm_up_steps()) / 6,
            "{anew}, {trained} of {iterations}"
        );
        assert!(auto.is_albedo_round(half_way), "the control: the next decisions come after a start");
    }
}

#[test]
fn growth_ends_when_it_brings_nothing_unless_the_number_was_named() {
    let rounds = |config: &TrainConfig| {
        let mut ledger = Ledger::default();
        for round in 0..4u32 {
            (0..10).for_each(|_| ledger.record(0, 30.0));
            ledger.before_round(config, 100 * round, 1000 + 100 * round as usize);
        }
        ledger.most_gaussians
    };
    assert_eq!(rounds(&config(&TrainOverrides::default())), Some(1200));
    assert_eq!(rounds(&config(&TrainOverrides { max_gaussians: Some(5000), ..Default::default() })), None);
}

/// Five discs beside each other in front of a camera, of which those of `hidden` are behind it, and their photograph.
fn discs(hidden: &[usize]) -> (Learned, Photo) {
    let mut learned = state();
    let g = &mut learned.model.gaussians;
    for i in 0..5 {
        let depth = if hidden.contains(&i) { -9.0 } else { 0.0 };
        g.row_mut(Field::Mean, i).copy_from_slice(&[0.3 * (i as f32 - 2.0), depth, 0.0]);
        g.row_mut(Field::LogScale, i).fill(0.1f32.ln());
        g.row_mut(Field::OpacityLogit, i).fill(3.0);
        g.row_mut(Field::Radiance, i).fill(0.0);
    }
    let eye = glam::DVec3::new(0.0, -3.0, 0.0);
    let camera =
        crate::scene::Camera::look_at(eye, glam::DVec3::ZERO, glam::DVec3::Z, 0.6, (32, 32)).unwrap();
    let options = ShadingOptions::default();
    let source = step::source(&learned, &[[0.0; 3]; 16]);
    let view = crate::engine::cpu::View::new(&camera, &options);
    let pass = crate::engine::cpu::Pass::forward(
        &source,
        view,
        crate::engine::channel::Channels::Colour,
        EarlyStop::WhenSaturated,
    );
    let pixels = crate::engine::cpu::radiance_image(&pass, [1.0; 3]);
    (learned, Photo { camera, pixels, alpha: Vec::new() })
}

#[test]
fn what_no_photograph_misses_is_dropped_and_what_one_misses_stays() {
    let dropped = |hidden: &[usize]| {
        let (mut learned, photo) = discs(hidden);
        let mut ledger = Ledger::default();
        let photos = [photo.clone(), photo];
        in_context(&TrainOverrides::default(), |context| {
            ledger.drop_least(context, 7, &photos, &mut learned)
        });
        assert_eq!(ledger.findings[0].is, learned.model.gaussians.len().to_string());
        (learned.model.gaussians.field(Field::Mean).to_vec(), ledger)
    };
    let (means, ledger) = dropped(&[1, 2, 4]);
    let near = |a: f32, b: f32| (a - b).abs() < 1e-6;
    assert!(means.len() == 6 && near(means[0], -0.6) && near(means[3], 0.3), "{means:?}");
    assert!((ledger.findings[0].evidence["share_dropped"] - 0.6).abs() < 1e-6, "{ledger:?}");
    assert_eq!(dropped(&[]).0.len(), 15, "the control: each of five is missed");
}

#[test]
fn sheen_stays_where_photographs_show_it() {
    let decided = |sheen: f32| {
        let (mut learned, mut photo) = discs(&[]);
        learned.model.gaussians.field_mut(Field::Sheen).fill(sheen);
        let mut ledger = Ledger::default();
        in_context(&TrainOverrides::default(), |context| {
            // No picture is met exactly.
            let seen = step::physical_image(context, &learned, &photo);
            photo.pixels = seen.iter().map(|p| p.map(|v| v + 0.05)).collect();
            ledger.decide_sheen(context, 7, &[photo], &mut learned);
        });
        let stays = learned.model.gaussians.field(Field::Sheen).iter().all(|s| *s == sheen);
        (stays, ledger.findings[0].is.clone())
    };
    assert_eq!(decided(1.5), (true, "learned".to_owned()));
    assert_eq!(decided(1e-3), (false, "none".to_owned()), "the control: too little to show");
}
