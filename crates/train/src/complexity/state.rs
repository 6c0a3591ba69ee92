//! The record of decisions, and when the next decisions are due.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::complexity::decide;
use crate::complexity::photographs::{ABLATION_PHOTOS, FEW_VIEWS, MANY_VIEWS};
use relume_scene::{Field, Gaussians};
use relume_spec::training::{Complexity, ComplexitySetting, TrainConfig};

/// Earliest share of the steps after which decisions are made.
const EARLIEST: f32 = 0.2;

/// One decision with its evidence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComplexityDecision {
    /// The setting.
    pub setting: ComplexitySetting,
    /// Completed steps.
    pub step: u32,
    /// The value before.
    pub was: String,
    /// The value after.
    pub is: String,
    /// True when the caller set the value, so no decision was made.
    pub forced: bool,
    /// Measured values, and the tolerances they were compared with.
    pub evidence: BTreeMap<String, f32>,
}

/// The rounds of density control so far, the input of [`decide::end_of_growth`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct Growth {
    /// Sum of the PSNRs of the steps since the last round, dB.
    sum: f32,
    steps: u32,
    phase: u32,
    history: Vec<decide::Round>,
}

/// The decisions so far, and the state for the next ones; part of every checkpoint.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ComplexityState {
    /// Decisions in order.
    pub findings: Vec<ComplexityDecision>,
    /// True when all surfaces are kept dielectric.
    pub is_dielectric: bool,
    /// Limit on the number of Gaussians, once more Gaussians no longer improve the result.
    pub most_gaussians: Option<u32>,
    /// Number of decision points passed.
    pub(super) points: u8,
    growth: Growth,
}

/// The points of a training at which decisions are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DecisionPoint {
    /// Visibility was measured for the first time.
    Measured,
    /// The step before [`DecisionPoint::HalfWay`]. Materials restart there by default; at this point they are
    /// trained.
    Trained,
    /// Halfway between the first point and the end.
    HalfWay,
    /// All steps are completed.
    End,
}

impl DecisionPoint {
    /// Number of renders for its decisions in a training of `photographs` photographs.
    fn renders(self, photographs: usize) -> usize {
        let [ablation, few, many] = [ABLATION_PHOTOS, FEW_VIEWS, MANY_VIEWS].map(|n| n.min(photographs));
        match self {
            Self::Measured | Self::HalfWay => few,
            Self::Trained => 2 * ablation,
            // Sheen, Gaussians by bisection in both branches, prototypes.
            Self::End => 2 * ablation + 5 * 2 * ablation + many + few,
        }
    }
}

/// Each decision point with the number of completed steps from which it is due; empty for `complexity: full`.
fn points(config: &TrainConfig) -> Vec<(u32, DecisionPoint)> {
    if config.complexity == Complexity::Full {
        return Vec::new();
    }
    let total = config.iterations;
    let first = config.warm_up_steps().max((EARLIEST * total as f32) as u32);
    let second = first + total.saturating_sub(first) / 2;
    vec![
        (first, DecisionPoint::Measured),
        (second.saturating_sub(1), DecisionPoint::Trained),
        (second, DecisionPoint::HalfWay),
        (total, DecisionPoint::End),
    ]
}

/// Number of renders for the decisions after `steps` steps of a training of `photographs` photographs, for estimates of the time.
pub fn renders(config: &TrainConfig, steps: u32, photographs: usize) -> usize {
    let due = points(config).into_iter().filter(|(from, _)| *from == steps);
    due.map(|(_, point)| point.renders(photographs)).sum()
}

impl ComplexityState {
    /// The decision point that is due after `steps` steps, if any.
    pub fn due(&self, config: &TrainConfig, steps: u32) -> Option<DecisionPoint> {
        let (from, point) = *points(config).get(usize::from(self.points))?;
        let is_due = steps >= from && (point == DecisionPoint::End || steps < config.iterations);
        is_due.then_some(point)
    }

    /// Adds the PSNR of a step, dB. `phase` identifies the images that were compared; values of different phases are
    /// not comparable.
    pub fn record(&mut self, phase: u32, psnr: f32) {
        let growth = &mut self.growth;
        if growth.phase != phase {
            *growth = Growth { phase, ..Growth::default() };
        }
        growth.sum += psnr.clamp(0.0, 100.0);
        growth.steps += 1;
    }

    /// Called before a round of density control with `gaussians` Gaussians: decides whether more may be added.
    pub fn before_round(&mut self, config: &TrainConfig, steps: u32, gaussians: usize) {
        let is_open = self.most_gaussians.is_none() && !config.forced.contains(&ComplexitySetting::Gaussians);
        if config.complexity == Complexity::Full || !is_open || self.growth.steps == 0 {
            return;
        }
        let growth = &mut self.growth;
        growth.history.push((gaussians as u32, growth.sum / growth.steps as f32));
        (growth.sum, growth.steps) = (0.0, 0);
        let Some([from, to]) = decide::end_of_growth(&growth.history) else { return };
        let evidence = [
            ("psnr_before", from.1),
            ("psnr", to.1),
            ("gaussians_before", from.0 as f32),
            ("tolerance_db_per_doubling", decide::MIN_PSNR_GAIN),
            ("enough_db", decide::SUFFICIENT_PSNR),
        ];
        self.most_gaussians = Some(to.0);
        let was = format!("at most {}", config.max_gaussians);
        self.record_decision(
            ComplexitySetting::Gaussians,
            steps,
            was,
            format!("at most {}", to.0),
            &evidence,
        );
    }

    /// Number of Gaussians before the least contributing ones were removed.
    fn gaussians_of_full(&self, now: usize) -> usize {
        let removals = self.findings.iter().filter(|f| f.setting == ComplexitySetting::Gaussians);
        removals.filter_map(|f| f.was.parse().ok()).max().unwrap_or(now)
    }

    /// Records a decision on `setting`.
    pub(super) fn record_decision(
        &mut self,
        setting: ComplexitySetting,
        step: u32,
        was: String,
        is: String,
        evidence: &[(&str, f32)],
    ) {
        let named = |(name, value): &(&str, f32)| ((*name).to_owned(), value.clamp(-1e9, 1e9));
        let evidence = evidence.iter().map(named).collect();
        self.findings.push(ComplexityDecision { setting, step, was, is, forced: false, evidence });
    }

    /// Records that the caller had set `setting`.
    pub(super) fn record_forced_value(&mut self, setting: ComplexitySetting, step: u32, value: String) {
        let evidence = BTreeMap::new();
        self.findings.push(ComplexityDecision {
            setting,
            step,
            was: value.clone(),
            is: value,
            forced: true,
            evidence,
        });
    }

    /// The part of the model card about the decisions. `gaussians` are those of the model.
    pub fn card(&self, config: &TrainConfig, gaussians: &Gaussians) -> Value {
        let finding = |f: &ComplexityDecision| {
            let evidence: BTreeMap<&String, f64> = f.evidence.iter().map(|(k, v)| (k, rounded(*v))).collect();
            json!({
                "setting": f.setting, "step": f.step, "was": f.was, "is": f.is,
                "forced": f.forced, "evidence": evidence,
            })
        };
        let floats = |g: &Gaussians| Field::ALL.iter().map(|field| g.field(*field).len()).sum::<usize>();
        json!({
            "mode": config.complexity,
            "bytes": 4 * floats(gaussians),
            "bytes_full": 4 * self.gaussians_of_full(gaussians.len()) * floats(&of_full(config)),
            "findings": self.findings.iter().map(finding).collect::<Vec<_>>(),
        })
    }
}

/// One Gaussian with all configured parts.
fn of_full(config: &TrainConfig) -> Gaussians {
    let [prototypes, visibility, radiance] =
        [config.prototypes, config.visibility_order, config.radiance_order].map(|n| n as usize);
    Gaussians::zeroed(1, prototypes, visibility, radiance)
}

/// Rounds to four significant digits, the accuracy of the measurements.
fn rounded(value: f32) -> f64 {
    format!("{value:.3e}").parse().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::training::{Preset, TrainOverrides};

    fn config(overrides: &TrainOverrides) -> TrainConfig {
        TrainConfig { complexity: Complexity::Auto, ..TrainConfig::new(Preset::Draft, overrides).unwrap() }
    }

    #[test]
    fn state_of_a_stored_checkpoint_is_read() {
        let stored = json!({
            "findings": [{
                "setting": "visibility", "step": 7, "was": "degree 4", "is": "off", "forced": false,
                "evidence": {"ao_error_off": 0.05},
            }],
            "is_dielectric": true, "most_gaussians": 1200, "points": 2,
            "growth": {"sum": 30.0, "steps": 1, "phase": 3, "history": [[1000, 29.5]]},
        });
        let state: ComplexityState = serde_json::from_value(stored.clone()).unwrap();
        assert_eq!(state.findings[0].setting, ComplexitySetting::Visibility);
        assert_eq!((state.points, &state.growth.history[..]), (2, &[(1000, 29.5)][..]));
        let keys = |v: &Value| v.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
        let written = serde_json::to_value(&state).unwrap();
        assert_eq!((keys(&written), keys(&written["growth"])), (keys(&stored), keys(&stored["growth"])));
        let mut cut = stored;
        cut.as_object_mut().unwrap().remove("points");
        assert!(serde_json::from_value::<ComplexityState>(cut).is_err(), "the control: a key is missing");
    }

    #[test]
    fn each_decision_is_due_once_in_order_and_only_in_auto_mode() {
        let auto = config(&TrainOverrides { iterations: Some(100), ..Default::default() });
        let mut complexity = ComplexityState::default();
        assert_eq!(complexity.due(&auto, 24), None);
        assert_eq!(complexity.due(&auto, 25), Some(DecisionPoint::Measured));
        complexity.points = 1;
        assert_eq!(
            (complexity.due(&auto, 60), complexity.due(&auto, 61)),
            (None, Some(DecisionPoint::Trained))
        );
        complexity.points = 2;
        assert_eq!(
            (complexity.due(&auto, 61), complexity.due(&auto, 62)),
            (None, Some(DecisionPoint::HalfWay))
        );
        complexity.points = 3;
        assert_eq!((complexity.due(&auto, 99), complexity.due(&auto, 100)), (None, Some(DecisionPoint::End)));
        let full = TrainConfig { complexity: Complexity::Full, ..auto };
        assert_eq!(complexity.due(&full, 100), None);
    }

    #[test]
    fn metalness_is_decided_well_after_the_last_restart() {
        for iterations in [100, 801, 1500] {
            let auto = config(&TrainOverrides { iterations: Some(iterations), ..Default::default() });
            let when = |points, point| {
                let complexity = ComplexityState { points, ..ComplexityState::default() };
                (0..iterations).find(|step| complexity.due(&auto, *step) == Some(point)).unwrap()
            };
            let (trained, half_way) = (when(1, DecisionPoint::Trained), when(2, DecisionPoint::HalfWay));
            let anew = (0..=trained).rfind(|step| auto.is_albedo_round(*step)).unwrap();
            assert!(
                trained - anew > (iterations - auto.warm_up_steps()) / 6,
                "{anew}, {trained} of {iterations}"
            );
            assert!(auto.is_albedo_round(half_way), "the control: the next decisions follow a restart");
        }
    }

    #[test]
    fn growth_ends_without_gain_unless_max_gaussians_is_given() {
        let rounds = |config: &TrainConfig| {
            let mut complexity = ComplexityState::default();
            for round in 0..20u32 {
                (0..10).for_each(|_| complexity.record(0, 30.0));
                complexity.before_round(config, 100 * round, 1000 + 100 * round as usize);
            }
            complexity.most_gaussians
        };
        assert_eq!(rounds(&config(&TrainOverrides::default())), Some(2100));
        assert_eq!(
            rounds(&config(&TrainOverrides { max_gaussians: Some(5000), ..Default::default() })),
            None
        );
    }
}
