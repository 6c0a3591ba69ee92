//! Decisions on SH degrees and bounced light, from the first measurement of visibility.

use crate::complexity::decide::{self, Convexity, RequiredVisibility};
use crate::complexity::photographs::DecisionContext;
use crate::complexity::state::ComplexityState;
use crate::complexity::{apply, evidence};
use relume_engine::{TrainState, evaluation};
use relume_scene::{Field, IndirectForm, LightSplit, VisibilityForm};
use relume_spec::training::ComplexitySetting;

/// Evidence from the photographs.
#[derive(Debug, Clone)]
pub struct PhotoEvidence {
    /// Mean blending weight of each Gaussian, pixels.
    pub weights: Vec<f32>,
    /// Mean share of the silhouettes' convex hulls that is empty; `None` without masks.
    pub concavity: Option<f32>,
}

/// Decides on bounced light, visibility and radiance, in this order, and applies the decisions.
pub fn decide(
    complexity: &mut ComplexityState,
    context: &DecisionContext<'_>,
    photo_evidence: &PhotoEvidence,
    state: &mut TrainState,
) {
    let g = &state.model.gaussians;
    let sh_degree = g.visibility_degree();
    let errors = (!state.labels.is_empty()).then(|| {
        let open = evidence::open_directions(&state.labels, sh_degree);
        evidence::visibility(&state.labels, sh_degree, &open, &photo_evidence.weights)
    });
    let convexity =
        errors.as_ref().map_or(Convexity::Unproven, |e| decide::convexity(photo_evidence.concavity, e.off));
    let residuals = evidence::radiance_residuals(g, &photo_evidence.weights);
    let is_gathered = decide_indirect(complexity, context, photo_evidence, convexity, state);
    let visibility =
        decide_visibility(complexity, context, photo_evidence, errors, (convexity, is_gathered), state);
    let radiance = decide_radiance(complexity, context, &residuals);
    apply::cut_degrees(state, visibility, radiance);
}

/// Decides the degree of the radiance branch from the loss at each degree; `residuals` has one value per degree from
/// 0 on.
fn decide_radiance(
    complexity: &mut ComplexityState,
    context: &DecisionContext<'_>,
    residuals: &[f32],
) -> usize {
    let old = residuals.len() - 1;
    if context.is_forced(ComplexitySetting::Radiance) {
        complexity.record_forced_value(ComplexitySetting::Radiance, context.steps, format!("degree {old}"));
        return old;
    }
    let degree = decide::radiance_degree(residuals);
    let figures = [
        ("lost_rms", residuals[degree]),
        ("lost_rms_one_less", residuals[degree.saturating_sub(1)]),
        ("tolerance", decide::RADIANCE_TOLERANCE),
    ];
    let (was, is) = (format!("degree {old}"), format!("degree {degree}"));
    complexity.record_decision(ComplexitySetting::Radiance, context.steps, was, is, &figures);
    degree
}

fn decide_visibility(
    complexity: &mut ComplexityState,
    context: &DecisionContext<'_>,
    photo_evidence: &PhotoEvidence,
    errors: Option<evidence::VisibilityErrors>,
    (convexity, is_gathered): (Convexity, bool),
    state: &TrainState,
) -> RequiredVisibility {
    let is_off = state.model.shading.visibility == VisibilityForm::Off;
    let old = state.model.gaussians.visibility_degree();
    let configured = if is_off { RequiredVisibility::Off } else { RequiredVisibility::Degree(old) };
    if context.is_forced(ComplexitySetting::Visibility) {
        complexity.record_forced_value(ComplexitySetting::Visibility, context.steps, configured.to_string());
        return configured;
    }
    let Some(errors) = errors.filter(|_| !is_off) else { return configured };
    let required = decide::visibility(&errors, convexity, is_gathered);
    let mut figures = vec![
        ("ao_error_off", errors.off),
        ("tolerance_off", decide::OFF_TOLERANCE),
        ("tolerance_concavity", decide::CONVEX_TOLERANCE),
    ];
    figures.extend(photo_evidence.concavity.map(|c| ("concavity", c)));
    if let RequiredVisibility::Degree(sh_degree) = required {
        figures.push(("ao_error", errors.ambient[sh_degree]));
        figures.push(("tolerance_ao", decide::AMBIENT_TOLERANCE));
        figures.push(("field_error", errors.field[sh_degree]));
        figures.push(("field_error_one_less", errors.field[sh_degree.saturating_sub(1)]));
        figures.push(("tolerance_field", decide::FIELD_TOLERANCE));
    }
    let (was, is) = (configured.to_string(), required.to_string());
    complexity.record_decision(ComplexitySetting::Visibility, context.steps, was, is, &figures);
    required
}

/// Whether bounced light is kept. A convex object has none, and a small share may be removed.
fn decide_indirect(
    complexity: &mut ComplexityState,
    context: &DecisionContext<'_>,
    photo_evidence: &PhotoEvidence,
    convexity: Convexity,
    state: &mut TrainState,
) -> bool {
    let is_gathered = state.model.shading.indirect == IndirectForm::Gathered && context.config().bounces > 0;
    if context.is_forced(ComplexitySetting::Indirect) {
        let value = if is_gathered { "gathered" } else { "as configured" };
        complexity.record_forced_value(ComplexitySetting::Indirect, context.steps, value.to_owned());
        return is_gathered;
    }
    if !is_gathered || state.gathered.is_empty() {
        return is_gathered;
    }
    let whole = context.step.operators.with_lights(&LightSplit::default());
    let tables = evaluation::mean_tables(state, &whole, context.step.lights);
    let gathered = evaluation::mean_gathered(state, context.step.lights);
    let field = state.model.gaussians.field(Field::Visibility);
    let normals = evaluation::normals(state);
    let share = evidence::indirect_share(&gathered, field, &normals, &tables, &photo_evidence.weights);
    let is_convex = convexity == Convexity::Convex;
    let stays = !is_convex && share > decide::INDIRECT_TOLERANCE;
    let figures = [
        ("bounced_over_direct", share),
        ("tolerance", decide::INDIRECT_TOLERANCE),
        ("is_convex", f32::from(u8::from(is_convex))),
    ];
    let (was, is) = ("gathered".to_owned(), if stays { "gathered" } else { "off" }.to_owned());
    complexity.record_decision(ComplexitySetting::Indirect, context.steps, was, is, &figures);
    if !stays {
        apply::drop_indirect(state);
    }
    stays
}
