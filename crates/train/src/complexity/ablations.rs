//! Decisions by ablation: the photographs are rendered without a part of the model, which stays if their PSNR falls.

use crate::complexity::photographs::{DecisionContext, MANY_VIEWS};
use crate::complexity::state::ComplexityState;
use crate::complexity::{apply, decide};
use relume_engine::TrainState;
use relume_scene::Field;
use relume_spec::training::ComplexitySetting;

/// A learned part of the model whose removal is tested.
struct Ablation {
    setting: ComplexitySetting,
    /// The setting's value without the part.
    without: &'static str,
    /// Names of the training PSNR with and without the part, in the model card.
    figures: [&'static str; 2],
    /// Accepted loss of PSNR, dB.
    tolerance: f32,
}

/// Drops the Gaussians with the least contribution, as many as the photographs allow in both branches.
pub fn drop_least(complexity: &mut ComplexityState, context: &DecisionContext<'_>, state: &mut TrainState) {
    let n = state.model.gaussians.len();
    if context.is_forced(ComplexitySetting::Gaussians) {
        return complexity.record_forced_value(ComplexitySetting::Gaussians, context.steps, n.to_string());
    }
    let weights = context.blending_weights(state, MANY_VIEWS);
    let psnr = |state: &TrainState| [context.physical_psnr(state), context.radiance_psnr(state)];
    let with = psnr(state);
    let mut best = (state.clone(), with);
    // The loss grows with the share, so bisection finds the largest share within tolerance.
    let mut untested = 0..decide::DROPPED_SHARES.len();
    while !untested.is_empty() {
        let middle = untested.start + untested.len() / 2;
        let mut without = state.clone();
        without.select(&decide::heaviest(&weights, decide::DROPPED_SHARES[middle]));
        let left = psnr(&without);
        let fits = with.iter().zip(left).all(|(with, left)| with - left <= decide::DROP_TOLERANCE);
        if fits {
            best = (without, left);
            untested.start = middle + 1;
        } else {
            untested.end = middle;
        }
    }
    let (smaller, without) = best;
    let left = smaller.model.gaussians.len();
    let figures = [
        ("psnr", with[0]),
        ("psnr_without", without[0]),
        ("radiance_psnr", with[1]),
        ("radiance_psnr_without", without[1]),
        ("tolerance_db", decide::DROP_TOLERANCE),
        ("share_dropped", 1.0 - left as f32 / n.max(1) as f32),
    ];
    let (was, is) = (n.to_string(), left.to_string());
    complexity.record_decision(ComplexitySetting::Gaussians, context.steps, was, is, &figures);
    *state = smaller;
}

/// Renders the photographs with and without metalness.
pub fn decide_metalness(
    complexity: &mut ComplexityState,
    context: &DecisionContext<'_>,
    state: &mut TrainState,
) {
    if context.is_forced(ComplexitySetting::Metalness) {
        let value = if context.config().metalness { "learned" } else { "dielectric" };
        return complexity.record_forced_value(ComplexitySetting::Metalness, context.steps, value.to_owned());
    }
    let mut without = state.clone();
    apply::make_dielectric(&mut without);
    let ablation = Ablation {
        setting: ComplexitySetting::Metalness,
        without: "dielectric",
        figures: ["psnr_learned", "psnr_dielectric"],
        tolerance: decide::METALNESS_TOLERANCE,
    };
    complexity.is_dielectric = ablate(&ablation, complexity, context, state, without);
}

/// Renders the photographs with and without sheen.
pub fn decide_sheen(complexity: &mut ComplexityState, context: &DecisionContext<'_>, state: &mut TrainState) {
    if context.is_forced(ComplexitySetting::Sheen) {
        let value = if context.config().sheen { "learned" } else { "none" };
        return complexity.record_forced_value(ComplexitySetting::Sheen, context.steps, value.to_owned());
    }
    let mut without = state.clone();
    without.model.gaussians.field_mut(Field::Sheen).fill(0.0);
    let ablation = Ablation {
        setting: ComplexitySetting::Sheen,
        without: "none",
        figures: ["psnr", "psnr_without"],
        tolerance: decide::SHEEN_TOLERANCE,
    };
    ablate(&ablation, complexity, context, state, without);
}

/// Replaces `state` by `without` if the photographs allow it. Returns whether it did.
fn ablate(
    ablation: &Ablation,
    complexity: &mut ComplexityState,
    context: &DecisionContext<'_>,
    state: &mut TrainState,
    without: TrainState,
) -> bool {
    let [with, bare] = [&*state, &without].map(|state| context.physical_psnr(state));
    let is_needed = with - bare > ablation.tolerance;
    let [name, name_without] = ablation.figures;
    let figures = [(name, with), (name_without, bare), ("tolerance_db", ablation.tolerance)];
    let is = if is_needed { "learned" } else { ablation.without };
    complexity.record_decision(
        ablation.setting,
        context.steps,
        "learned".to_owned(),
        is.to_owned(),
        &figures,
    );
    if !is_needed {
        *state = without;
    }
    !is_needed
}
