use super::*;
use relume_engine::SplitOrigin::{Keep, LowerHalf, UpperHalf};
use relume_engine::{DensityStats, Device, TrainState, TrainingLimits};
use relume_scene::light::{EnvOperators, TableResolution};
use relume_scene::{Field, Gaussians, Model};
use std::sync::Arc;

/// `n` small opaque Gaussians one unit apart along x; those in `wanted` have a large absgrad.
fn row(n: usize, wanted: &[usize]) -> (Gaussians, DensityStats) {
    let mut g = Gaussians::zeroed(n, 1, 0, 0);
    let mut stats = DensityStats::zeroed(n);
    for i in 0..n {
        g.row_mut(Field::Mean, i)[0] = i as f32;
        g.row_mut(Field::LogScale, i).copy_from_slice(&[-3.0, -2.0, -4.0]);
        g.row_mut(Field::Quaternion, i)[0] = 1.0;
        g.row_mut(Field::OpacityLogit, i)[0] = 2.0;
        let mean = if wanted.contains(&i) { SPLIT_ABSGRAD * (2.0 + i as f32) } else { 0.5 * SPLIT_ABSGRAD };
        (stats.absgrad[i], stats.seen[i]) = (4.0 * mean, 4.0);
    }
    (g, stats)
}

/// A state of these Gaussians under a light of 4 x 2 texels.
fn state(gaussians: Gaussians, density: DensityStats) -> TrainState {
    let model = Model::new(gaussians, vec![[0.5; 3]], vec![[0.5; 3]; 8], (4, 2));
    TrainState { density, ..TrainState::new(model) }
}

/// A training of this state on the CPU engine.
fn training(state: TrainState) -> Box<dyn relume_engine::TrainingEngine> {
    let operators = Arc::new(EnvOperators::new(4, 2, 0, TableResolution::TRAINING));
    let limits = TrainingLimits { resolution: 1, pixels: 1, max_gaussians: 16, probe_directions: 8 };
    Device::Cpu.training(state, &operators, &limits).unwrap()
}

fn planned(
    g: &Gaussians,
    stats: &DensityStats,
    budget: usize,
    centres: Option<&[[f32; 3]]>,
) -> Vec<(u32, SplitOrigin)> {
    let signals = training(state(g.clone(), stats.clone())).density_signals().unwrap();
    let plan = plan(&signals, budget, centres);
    plan.gaussians.iter().map(|g| (g.source, g.origin)).collect()
}

#[test]
fn largest_absgrads_split_within_the_budget() {
    let (g, stats) = row(4, &[1, 3]);
    let both = [(0, Keep), (1, UpperHalf), (1, LowerHalf), (2, Keep), (3, UpperHalf), (3, LowerHalf)];
    assert_eq!(planned(&g, &stats, 10, None), both);
    assert_eq!(
        planned(&g, &stats, 5, None),
        [(0, Keep), (1, Keep), (2, Keep), (3, UpperHalf), (3, LowerHalf)]
    );
    assert_eq!(planned(&g, &stats, 4, None).len(), 4, "the control: no budget, no split");
}

#[test]
fn new_gaussians_are_sorted_along_the_morton_curve() {
    let (mut g, stats) = row(4, &[1]);
    // Reversed along x.
    (0..4).for_each(|i| g.row_mut(Field::Mean, i)[0] = -(i as f32));
    let expected = [(3, Keep), (2, Keep), (1, UpperHalf), (1, LowerHalf), (0, Keep)];
    assert_eq!(planned(&g, &stats, 10, None), expected);
    let unplaced = DensitySignals {
        opacity_logits: vec![2.0; 4],
        log_scales: vec![[-3.0; 3]; 4],
        stats,
        ..Default::default()
    };
    let sources: Vec<u32> = plan(&unplaced, 4, None).gaussians.iter().map(|g| g.source).collect();
    assert_eq!(sources, [0, 1, 2, 3], "the control");
}

#[test]
fn transparent_huge_and_near_camera_gaussians_are_dropped() {
    let (mut g, stats) = row(3, &[]);
    g.row_mut(Field::OpacityLogit, 0)[0] = -9.0;
    g.row_mut(Field::LogScale, 1)[2] = 0.0;
    assert_eq!(planned(&g, &stats, 10, None), [(2, Keep)]);
    let at_camera = planned(&g, &stats, 10, Some(&[[2.1, 0.0, 0.0]]));
    assert_eq!(
        at_camera,
        [(1, Keep)],
        "without masks the huge one is kept and the one at the camera is dropped"
    );
}

#[test]
fn split_halves_lie_on_the_longest_axis_and_have_zero_moments() {
    let (gaussians, stats) = row(2, &[1]);
    let mut state = state(gaussians, stats);
    state.moments.first.field_mut(Field::Mean).fill(7.0);
    let mut training = training(state);
    let plan = plan(&training.density_signals().unwrap(), 10, None);
    training.rebuild(&plan).unwrap();
    let state = training.state().unwrap();
    let g = &state.model.gaussians;
    let y = |i: usize| g.row(Field::Mean, i)[1];
    let half_sigma = 0.5 * (-2.0f32).exp();
    assert_eq!((y(0), y(1), y(2)), (0.0, half_sigma, -half_sigma));
    assert!(g.row(Field::OpacityLogit, 1)[0] < 2.0 && g.row(Field::OpacityLogit, 0)[0] == 2.0);
    assert_eq!(state.moments.first.field(Field::Mean), [7.0, 7.0, 7.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(state.density, DensityStats::zeroed(3));
}
