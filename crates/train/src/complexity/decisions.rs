//! What is decided at which point of a training.

use crate::complexity::photographs::{DecisionContext, FEW_VIEWS};
use crate::complexity::state::{ComplexityState, DecisionPoint};
use crate::complexity::{apply, decide, evidence, orders, trials};
use crate::context::StepContext;
use crate::dataset::Dataset;
use relume_engine::TrainState;
use relume_spec::training::ComplexitySetting;

impl ComplexityState {
    /// Makes the decisions of `point` and applies them to `state`, whose parameters must be finite.
    ///
    /// Orders, forward model and the numbers of Gaussians and prototypes may change.
    pub fn decide(
        &mut self,
        point: DecisionPoint,
        step: &StepContext<'_>,
        steps: u32,
        photos: &Dataset,
        state: &mut TrainState,
    ) {
        self.points += 1;
        let context = &DecisionContext { step, steps, photos };
        match point {
            DecisionPoint::Measured => {
                let weights = context.blending_weights(state, FEW_VIEWS);
                let shown = orders::Shown { weights, concavity: context.concavity() };
                orders::decide(self, context, &shown, state);
            }
            DecisionPoint::Trained => trials::decide_metalness(self, context, state),
            DecisionPoint::HalfWay => {
                trials::drop_least(self, context, state);
                merge_prototypes(self, context, state);
            }
            DecisionPoint::End => {
                trials::decide_sheen(self, context, state);
                merge_prototypes(self, context, state);
            }
        }
    }
}

/// Merges prototypes that the photographs hardly tell apart.
fn merge_prototypes(complexity: &mut ComplexityState, context: &DecisionContext<'_>, state: &mut TrainState) {
    let n = state.model.prototypes.len();
    if context.is_forced(ComplexitySetting::Prototypes) {
        return complexity.note_forced(ComplexitySetting::Prototypes, context.steps, n.to_string());
    }
    let weights = context.blending_weights(state, FEW_VIEWS);
    let overlap = evidence::Overlap::of(&state.model.gaussians, &weights);
    let (groups, moved) = decide::prototypes(&state.model.prototypes, &overlap);
    let figures = [("albedo_moved_rms", moved), ("tolerance", decide::PROTOTYPE_TOLERANCE)];
    let (was, is) = (n.to_string(), groups.len().to_string());
    complexity.note(ComplexitySetting::Prototypes, context.steps, was, is, &figures);
    if groups.len() < n {
        apply::merge_prototypes(state, &groups, &overlap);
    }
}
