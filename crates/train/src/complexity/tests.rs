//! Tests of decisions on constructed states, and of what applying them preserves.

use super::decide::RequiredVisibility;
use super::photographs::DecisionContext;
use super::sh_degrees::{self, PhotoEvidence};
use super::state::ComplexityState;
use super::{ablations, apply, evidence};
use crate::context::StepContext;
use crate::dataset::Dataset;
use relume_engine::cpu::{Pass, radiance_image};
use relume_engine::{Photo, RasterCamera, TrainState, evaluation};
use relume_layout::channel::Channels;
use relume_layout::constants::EarlyStop;
use relume_scene::{Field, Gaussians, IndirectForm, Model, ShadingOptions, VisibilityForm};
use relume_spec::training::{Complexity, Preset, TrainConfig, TrainOverrides};

fn small_state() -> TrainState {
    let mut gaussians = Gaussians::zeroed(5, 4, 4, 1);
    for (_, _, data) in gaussians.fields_mut() {
        data.iter_mut().enumerate().for_each(|(i, v)| *v = ((i * 37) % 23) as f32 / 23.0 - 0.4);
    }
    let mut state = TrainState::new(Model::new(
        gaussians,
        vec![[0.5, 0.4, 0.3], [0.51, 0.41, 0.3], [0.9, 0.8, 0.1], [0.1, 0.2, 0.3]],
        vec![[0.5; 3]; 8],
        (4, 2),
    ));
    state.labels = state.model.gaussians.field(Field::Visibility).to_vec();
    state.gathered = (0..5).map(|i| [i as f32; 6]).collect();
    state.moments.first.field_mut(Field::Mean).fill(7.0);
    state
}

fn albedo(state: &TrainState, i: usize) -> [f32; 3] {
    let options = ShadingOptions::default();
    let source =
        relume_engine::cpu::AttributeSource::new(&state.model.gaussians, &state.model.prototypes, &options);
    source.albedo(i)
}

#[test]
fn reducing_sh_degrees_keeps_lower_coefficients_and_moments() {
    let (before, mut after) = (small_state(), small_state());
    apply::cut_degrees(&mut after, RequiredVisibility::Degree(2), 0);
    let (old, new) = (&before.model.gaussians, &after.model.gaussians);
    assert_eq!((new.visibility_degree(), new.radiance_degree()), (2, 0));
    assert_eq!(new.row(Field::Visibility, 3), &old.row(Field::Visibility, 3)[..9]);
    assert_eq!(new.row(Field::Radiance, 3), &old.row(Field::Radiance, 3)[..3]);
    assert_eq!(new.field(Field::ProtoLogits), old.field(Field::ProtoLogits));
    assert_eq!(after.labels[3 * 9..4 * 9], before.labels[3 * 25..3 * 25 + 9]);
    assert_eq!(after.moments.first.row(Field::Mean, 4), [7.0; 3]);
    assert_eq!(after.moments.second.visibility_degree(), 2);
}

#[test]
fn merging_prototypes_preserves_albedo_through_the_residual() {
    let (before, mut after) = (small_state(), small_state());
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
    assert!(moved, "the control: the residual contains the difference");
}

#[test]
fn making_a_model_dielectric_keeps_its_diffuse_colour() {
    let (before, mut after) = (small_state(), small_state());
    apply::make_dielectric(&mut after);
    for i in 0..5 {
        let left = 1.0 - relume_engine::sigmoid(before.model.gaussians.row(Field::MetalLogit, i)[0]);
        let [a, b] = [albedo(&before, i), albedo(&after, i)];
        // An albedo is clamped below 0 and above 1.
        let inside = |v: f32| v > 0.001 && v < 0.999;
        assert!((0..3).all(|c| !inside(a[c]) || (a[c] * left - b[c]).abs() < 1e-5), "{a:?} {b:?}");
        assert!(relume_engine::sigmoid(after.model.gaussians.row(Field::MetalLogit, i)[0]) < 1e-3);
    }
}

#[test]
fn selected_gaussians_keep_their_rows() {
    let (before, mut after) = (small_state(), small_state());
    after.select(&[1, 4]);
    assert_eq!(after.labels[25..], before.labels[100..]);
    assert_eq!(after.gathered, [[1.0; 6], [4.0; 6]]);
    assert_eq!(after.model.gaussians.row(Field::Mean, 1), before.model.gaussians.row(Field::Mean, 4));
    assert_eq!((after.moments.first.len(), after.density.seen.len()), (2, 2));
}

fn config(overrides: &TrainOverrides) -> TrainConfig {
    TrainConfig { complexity: Complexity::Auto, ..TrainConfig::new(Preset::Draft, overrides).unwrap() }
}

/// The upper side of a ball, whose surfaces are all unoccluded. `share`: ratio of bounced to direct irradiance.
fn convex(share: f32) -> TrainState {
    let mut state = small_state();
    let rows = (0..5).flat_map(|_| evidence::half_open(4, [0.0, 0.0, 1.0]));
    state.labels = rows.collect();
    let labels = state.labels.clone();
    let g = &mut state.model.gaussians;
    g.field_mut(Field::Visibility).copy_from_slice(&labels);
    for i in 0..5 {
        g.row_mut(Field::Quaternion, i).copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
        g.row_mut(Field::LogScale, i).copy_from_slice(&[0.0, 0.0, -3.0]);
        g.row_mut(Field::Radiance, i)[3..].fill(0.0);
    }
    let direct = state.model.environment(0).texels()[0][0] * std::f32::consts::PI;
    state.gathered = vec![[share * direct; 6]; 5];
    state
}

/// Calls `act` with a context in which 7 steps are completed.
fn in_context(overrides: &TrainOverrides, photos: &Dataset, act: impl FnOnce(&DecisionContext<'_>)) {
    let config = config(overrides);
    let operators =
        relume_scene::light::EnvOperators::new(4, 2, 4, relume_scene::light::TableResolution::TRAINING);
    let step = StepContext {
        config: &config,
        operators: &operators,
        lights: &relume_engine::PhotoLights::default(),
        background: [1.0; 3],
        has_alpha: true,
    };
    act(&DecisionContext { step: &step, steps: 7, photos });
}

fn decided(
    overrides: &TrainOverrides,
    concavity: f32,
    mut state: TrainState,
) -> (ComplexityState, TrainState) {
    let mut complexity = ComplexityState::default();
    let photo_evidence = PhotoEvidence { weights: vec![1.0; 5], concavity: Some(concavity) };
    in_context(overrides, &Dataset::of_photos(&[]), |context| {
        sh_degrees::decide(&mut complexity, context, &photo_evidence, &mut state)
    });
    (complexity, state)
}

#[test]
fn a_convex_object_needs_no_visibility_and_no_indirect_light() {
    let (complexity, state) = decided(&TrainOverrides::default(), 0.0, convex(0.001));
    assert_eq!(state.model.shading.visibility, VisibilityForm::Off);
    assert_eq!(state.model.shading.indirect, IndirectForm::Off);
    let g = &state.model.gaussians;
    assert_eq!((g.visibility_degree(), g.radiance_degree()), (0, 1));
    assert!(state.labels.is_empty() && state.gathered.is_empty());
    let card = complexity.card(&config(&TrainOverrides::default()), g);
    assert!(card["bytes"].as_u64().unwrap() < card["bytes_full"].as_u64().unwrap(), "{card}");
    assert_eq!(card["findings"][0]["is"], "off", "{card}");
    assert!(card["findings"][0]["evidence"]["bounced_over_direct"].as_f64().unwrap() < 0.01, "{card}");
}

#[test]
fn indirect_light_is_kept_together_with_visibility() {
    let (_, state) = decided(&TrainOverrides::default(), 0.2, convex(0.5));
    assert_eq!(state.model.shading, ShadingOptions::default());
    assert!(state.model.gaussians.visibility_degree() >= 1);
}

#[test]
fn settings_given_by_the_caller_are_not_decided() {
    let named = TrainOverrides {
        visibility_order: Some(4),
        radiance_order: Some(1),
        bounces: Some(2),
        ..TrainOverrides::default()
    };
    let (complexity, state) = decided(&named, 0.0, convex(0.001));
    assert_eq!(state.model.shading, ShadingOptions::default());
    let g = &state.model.gaussians;
    assert_eq!((g.visibility_degree(), g.radiance_degree()), (4, 1));
    assert!(complexity.findings.iter().all(|f| f.forced) && complexity.findings.len() == 3, "{complexity:?}");
}

/// Five discs side by side in front of a camera, of which those in `hidden` are behind it, and their photograph.
fn discs(hidden: &[usize]) -> (TrainState, Photo) {
    let mut state = small_state();
    let g = &mut state.model.gaussians;
    for i in 0..5 {
        let depth = if hidden.contains(&i) { -9.0 } else { 0.0 };
        g.row_mut(Field::Mean, i).copy_from_slice(&[0.3 * (i as f32 - 2.0), depth, 0.0]);
        g.row_mut(Field::LogScale, i).fill(0.1f32.ln());
        g.row_mut(Field::OpacityLogit, i).fill(3.0);
        g.row_mut(Field::Radiance, i).fill(0.0);
        g.row_mut(Field::SamplingRate, i).fill(0.0);
    }
    let centre = glam::DVec3::new(0.0, -3.0, 0.0);
    let camera =
        relume_scene::Camera::look_at(centre, glam::DVec3::ZERO, glam::DVec3::Z, 0.6, (32, 32)).unwrap();
    let options = ShadingOptions::default();
    let source = evaluation::source(&state);
    let view = RasterCamera::new(&camera, &options);
    let pass = Pass::forward(&source, view, Channels::Colour, EarlyStop::WhenSaturated);
    let pixels = radiance_image(&pass, [1.0; 3]);
    let range = relume_scene::DisplayRange::Unit;
    (state, Photo { camera, pixels, alpha: Vec::new(), light: Default::default(), range })
}

#[test]
fn hidden_gaussians_are_dropped_and_visible_ones_are_kept() {
    let dropped = |hidden: &[usize]| {
        let (mut state, photo) = discs(hidden);
        let mut complexity = ComplexityState::default();
        let photos = Dataset::of_photos(&[photo.clone(), photo]);
        in_context(&TrainOverrides::default(), &photos, |context| {
            ablations::drop_least(&mut complexity, context, &mut state);
        });
        assert_eq!(complexity.findings[0].is, state.model.gaussians.len().to_string());
        (state.model.gaussians.field(Field::Mean).to_vec(), complexity)
    };
    let (means, complexity) = dropped(&[1, 2, 4]);
    let near = |a: f32, b: f32| (a - b).abs() < 1e-6;
    assert!(means.len() == 6 && near(means[0], -0.6) && near(means[3], 0.3), "{means:?}");
    assert!((complexity.findings[0].evidence["share_dropped"] - 0.6).abs() < 1e-6, "{complexity:?}");
    assert_eq!(dropped(&[]).0.len(), 15, "the control: all five are visible");
}

#[test]
fn sheen_is_kept_only_if_photographs_show_it() {
    let decided = |sheen: f32| {
        let (mut state, mut photo) = discs(&[]);
        state.model.gaussians.field_mut(Field::Sheen).fill(sheen);
        let mut complexity = ComplexityState::default();
        in_context(&TrainOverrides::default(), &Dataset::of_photos(&[]), |context| {
            // No model reproduces its photographs exactly.
            let image = context.step.physical_image(&state, &photo);
            photo.pixels = image.iter().map(|p| p.map(|v| v + 0.05)).collect();
            let context = DecisionContext { photos: &Dataset::of_photos(&[photo]), ..*context };
            ablations::decide_sheen(&mut complexity, &context, &mut state);
        });
        let stays = state.model.gaussians.field(Field::Sheen).iter().all(|s| *s == sheen);
        (stays, complexity.findings[0].is.clone())
    };
    assert_eq!(decided(1.5), (true, "learned".to_owned()));
    assert_eq!(decided(1e-3), (false, "none".to_owned()), "the control: too little to show");
}
