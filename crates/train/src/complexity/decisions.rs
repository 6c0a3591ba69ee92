//! The decisions at each decision point of a training.

use crate::complexity::photographs::{DecisionContext, FEW_VIEWS};
use crate::complexity::state::{ComplexityState, DecisionPoint};
use crate::complexity::{ablations, apply, decide, evidence, sh_degrees};
use crate::context::StepContext;
use crate::dataset::Dataset;
use relume_engine::TrainState;
use relume_spec::training::ComplexitySetting;

impl ComplexityState {
    /// Makes the decisions of `point` and applies them to `state`, whose parameters must be finite.
    ///
    /// SH degrees, forward model and the numbers of Gaussians and prototypes may change.
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
                let photo_evidence = sh_degrees::PhotoEvidence { weights, concavity: context.concavity() };
                sh_degrees::decide(self, context, &photo_evidence, state);
            }
            DecisionPoint::Trained => ablations::decide_metalness(self, context, state),
            DecisionPoint::HalfWay => merge_prototypes(self, context, state),
            DecisionPoint::End => {
                ablations::decide_sheen(self, context, state);
                ablations::drop_least(self, context, state);
                merge_prototypes(self, context, state);
            }
        }
    }
}

/// Merges prototypes that the photographs hardly distinguish.
fn merge_prototypes(complexity: &mut ComplexityState, context: &DecisionContext<'_>, state: &mut TrainState) {
    let n = state.model.prototypes.len();
    if context.is_forced(ComplexitySetting::Prototypes) {
        return complexity.record_forced_value(ComplexitySetting::Prototypes, context.steps, n.to_string());
    }
    let weights = context.blending_weights(state, FEW_VIEWS);
    let overlap = evidence::Overlap::of(&state.model.gaussians, &weights);
    let (groups, moved) = decide::prototypes(&state.model.prototypes, &overlap);
    let figures = [("albedo_moved_rms", moved), ("tolerance", decide::PROTOTYPE_TOLERANCE)];
    let (was, is) = (n.to_string(), groups.len().to_string());
    complexity.record_decision(ComplexitySetting::Prototypes, context.steps, was, is, &figures);
    if groups.len() < n {
        apply::merge_prototypes(state, &groups, &overlap);
    }
}
