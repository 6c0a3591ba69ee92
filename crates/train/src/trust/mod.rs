//! Confidence in the materials of each Gaussian (docs/MODEL.md, section 10).

mod evidence;
mod next;
mod places;

use crate::context::StepContext;
use crate::dataset::Dataset;
use evidence::Evidence;
use relume_engine::TrainState;

pub use next::{MAX_CANDIDATES, NextPhotograph, NextPhotographError, next_photographs};
pub use places::places_around;

/// Logarithm of the error of relit pictures where the photographs agree and nothing occludes, its increase with the square root of the
/// residual, and its decrease with openness: a least-squares fit to six path-traced scenes.
const LOG_ERROR: f32 = -3.72;
const BY_RESIDUAL: f32 = 7.05;
const BY_OPENNESS: f32 = -2.33;
/// Predicted error at which confidence is a half, display values.
const HALF_ERROR: f32 = 0.03;
/// Number of photographs below which confidence decreases.
const ENOUGH_PHOTOGRAPHS: f32 = 2.0;

/// Confidence of each Gaussian, 0 to 1.
pub(crate) fn confidence(state: &TrainState, context: &StepContext<'_>, data: &Dataset) -> Vec<f32> {
    evidence::evidence(state, context, data).iter().map(of_evidence).collect()
}

fn of_evidence(evidence: &Evidence) -> f32 {
    let residual = evidence.residual.max(0.0).sqrt();
    let error = (LOG_ERROR + BY_RESIDUAL * residual + BY_OPENNESS * evidence.openness).exp();
    let shown = (evidence.photographs / ENOUGH_PHOTOGRAPHS).clamp(0.0, 1.0);
    // Not finite where the photographs or the pictures are not.
    if evidence.residual.is_finite() { shown * HALF_ERROR / (HALF_ERROR + error) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: Evidence = Evidence { photographs: 20.0, residual: 0.01, openness: 0.9 };

    #[test]
    fn confidence_falls_with_residuals_and_occlusion() {
        let good = of_evidence(&GOOD);
        assert!(good > 0.7 && good < 1.0, "{good}");
        for worse in [
            Evidence { residual: 0.1, ..GOOD },
            Evidence { openness: 0.2, ..GOOD },
            Evidence { photographs: 1.0, ..GOOD },
        ] {
            assert!(of_evidence(&worse) < good - 0.1, "{worse:?}");
        }
        assert_eq!(of_evidence(&Evidence { photographs: 0.0, ..GOOD }), 0.0);
        assert_eq!(
            of_evidence(&Evidence { photographs: 30.0, ..GOOD }),
            good,
            "more photographs are no further evidence"
        );
    }

    #[test]
    fn confidence_is_between_0_and_1_for_all_values() {
        for residual in [0.0, 1e-9, 1.0, 64.0, f32::INFINITY, f32::NAN] {
            let confidence = of_evidence(&Evidence { residual, ..GOOD });
            assert!((0.0..=1.0).contains(&confidence), "{residual}: {confidence}");
            assert_eq!(confidence == 0.0, !residual.is_finite(), "{residual}: {confidence}");
        }
    }
}
