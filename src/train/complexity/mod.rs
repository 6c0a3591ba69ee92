//! Model only what a scene requires (DESIGN 7): at fixed points of a training, evidence is taken from its state, the
//! model is made as small as that allows, and both go into the model card.
//!
//! Decisions are functions of the state alone, so a training that is resumed decides what an undisturbed one does.

mod apply;
pub mod decide;
pub mod evidence;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

#[cfg(test)]
pub use apply::DIELECTRIC;
pub use apply::hold_dielectric;

use crate::scene::{Field, IndirectForm, VisibilityForm};
use crate::train::complexity::decide::Visibility;
use crate::train::dataset::Photo;
use crate::train::state::Learned;
use crate::train::step::{self, StepContext};
use crate::train::{Complexity, Setting, TrainConfig};

/// Photographs that tell what is seen, at the first point and at the second.
const VIEWS: [usize; 2] = [12, 64];
/// Photographs on which the model is tried without something.
const TRIALS: usize = 8;
/// Earliest share of the steps at which a state says anything.
const EARLIEST: f32 = 0.2;

/// One decision with its evidence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// What was decided on.
    pub setting: Setting,
    /// Steps done.
    pub step: u32,
    /// The value before.
    pub was: String,
    /// The value since.
    pub is: String,
    /// True when a caller named the value, so that there was nothing to decide.
    pub forced: bool,
    /// Measured figures, and the tolerances they were held against.
    pub evidence: BTreeMap<String, f32>,
}

/// The rounds of density control so far, for [`decide::is_enough`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Growth {
    sum: f32,
    steps: u32,
    phase: u32,
    history: Vec<(u32, f32)>,
}

/// What was decided so far, and what the next decisions need; part of every checkpoint.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Ledger {
    /// Decisions in order.
    pub findings: Vec<Finding>,
    /// Metalness is held at dielectric.
    pub is_dielectric: bool,
    /// The most Gaussians, once more were found not to be worth it.
    pub most_gaussians: Option<u32>,
    points: u8,
    growth: Growth,
}

/// When decisions are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Point {
    /// Visibility was measured for the first time.
    Measured,
    /// The step before the next point, where materials start anew by default: what has trained until then is still there.
    Trained,
    /// Half of the time between the first point and the end.
    HalfWay,
    /// All steps are done.
    End,
}

fn even<T>(all: &[T], most: usize) -> impl Iterator<Item = &T> {
    let count = all.len().min(most);
    (0..count).map(move |i| &all[i * all.len() / count.max(1)])
}

/// Mean blending weight a photograph, pixels, of each Gaussian over at most `most` photographs.
fn weights(learned: &Learned, photos: &[Photo], most: usize) -> Vec<f32> {
    let mut sums = vec![0.0f32; learned.model.gaussians.len()];
    for photo in even(photos, most) {
        sums.iter_mut().zip(step::weights_in(learned, photo)).for_each(|(sum, w)| *sum += w);
    }
    let count = photos.len().min(most).max(1) as f32;
    sums.iter_mut().for_each(|sum| *sum /= count);
    sums
}

/// PSNR on some of the photographs by the mean squared error that `error` finds on one, dB.
fn psnr(photos: &[Photo], error: impl Fn(&Photo) -> f32) -> f32 {
    let errors = even(photos, TRIALS).map(|photo| (error(photo), 1.0));
    -10.0 * evidence::weighted_mean(errors).max(1e-10).log10()
}

/// Something learned that the model is tried without.
struct Trial {
    setting: Setting,
    /// The setting's value without it.
    without: &'static str,
    /// Names of the training PSNR with and without it, in the model card.
    figures: [&'static str; 2],
    /// What it may cost, dB.
    tolerance: f32,
}

/// What the photographs show.
struct Shown {
    /// Mean blending weight of each Gaussian.
    weights: Vec<f32>,
    /// Mean share of the silhouettes' hulls that stays empty.
    concavity: Option<f32>,
}

fn concavity(photos: &[Photo]) -> Option<f32> {
    let each = even(photos, VIEWS[1]);
    let all: Vec<f32> = each.filter_map(|p| evidence::concavity(&p.alpha, p.camera.width as usize)).collect();
    (!all.is_empty()).then(|| all.iter().sum::<f32>() / all.len() as f32)
}

impl Ledger {
    /// The decisions that are due after `steps` steps.
    pub fn due(&self, config: &TrainConfig, steps: u32) -> Option<Point> {
        if config.complexity == Complexity::Full {
            return None;
        }
        let total = config.iterations;
        let first = config.warm_up_steps().max((EARLIEST * total as f32) as u32);
        let second = first + total.saturating_sub(first) / 2;
        match self.points {
            0 if steps >= first && steps < total => Some(Point::Measured),
            1 if steps + 1 >= second && steps < total => Some(Point::Trained),
            2 if steps >= second && steps < total => Some(Point::HalfWay),
            3 if steps >= total => Some(Point::End),
            _ => None,
        }
    }

    /// Takes a step's PSNR in. `phase` names what it was measured on: a change makes it another quantity.
    pub fn record(&mut self, phase: u32, psnr: f32) {
        let growth = &mut self.growth;
        if growth.phase != phase {
            *growth = Growth { phase, ..Growth::default() };
        }
        growth.sum += psnr.clamp(0.0, 100.0);
        growth.steps += 1;
    }

    /// Before a round of density control with `gaussians` so far: decides whether more may come.
    pub fn before_round(&mut self, config: &TrainConfig, steps: u32, gaussians: usize) {
        let is_open = self.most_gaussians.is_none() && !config.forced.contains(&Setting::Gaussians);
        if config.complexity == Complexity::Full || !is_open || self.growth.steps == 0 {
            return;
        }
        let growth = &mut self.growth;
        growth.history.push((gaussians as u32, growth.sum / growth.steps as f32));
        (growth.sum, growth.steps) = (0.0, 0);
        if !decide::is_enough(&growth.history) {
            return;
        }
        let [.., from, to] = growth.history[..] else { return };
        let evidence = [
            ("psnr_before", from.1),
            ("psnr", to.1),
            ("gaussians_before", from.0 as f32),
            ("tolerance_db_per_doubling", decide::FLAT),
            ("enough_db", decide::ENOUGH),
        ];
        self.most_gaussians = Some(to.0);
        let was = format!("at most {}", config.max_gaussians);
        self.note(Setting::Gaussians, steps, was, format!("at most {}", to.0), &evidence);
    }

    fn note(&mut self, setting: Setting, step: u32, was: String, is: String, evidence: &[(&str, f32)]) {
        let named = |(name, value): &(&str, f32)| ((*name).to_owned(), value.clamp(-1e9, 1e9));
        let evidence = evidence.iter().map(named).collect();
        self.findings.push(Finding { setting, step, was, is, forced: false, evidence });
    }

    fn note_forced(&mut self, setting: Setting, step: u32, value: String) {
        let evidence = BTreeMap::new();
        self.findings.push(Finding { setting, step, was: value.clone(), is: value, forced: true, evidence });
    }

    /// Makes the decisions of `point` and applies them to `learned`, whose parameters must be finite.
    ///
    /// Orders, forward model and numbers may be others afterwards.
    pub fn decide(
        &mut self,
        point: Point,
        context: &StepContext<'_>,
        steps: u32,
        photos: &[Photo],
        learned: &mut Learned,
    ) {
        self.points += 1;
        match point {
            Point::Measured => {
                let weights = weights(learned, photos, VIEWS[0]);
                let concavity = if context.has_alpha { concavity(photos) } else { None };
                self.decide_orders(context, steps, &Shown { weights, concavity }, learned);
            }
            Point::Trained => self.decide_metalness(context, steps, photos, learned),
            Point::HalfWay => {
                self.drop_least(context, steps, photos, learned);
                self.merge(context.config, steps, photos, learned);
            }
            Point::End => {
                self.decide_sheen(context, steps, photos, learned);
                self.merge(context.config, steps, photos, learned);
            }
        }
    }

    fn decide_orders(&mut self, context: &StepContext<'_>, steps: u32, shown: &Shown, learned: &mut Learned) {
        let g = &learned.model.gaussians;
        let (order, old_radiance) = (g.visibility_order(), g.radiance_order());
        let errors = (!learned.labels.is_empty()).then(|| {
            let open = evidence::open_directions(&learned.labels, order);
            evidence::visibility(&learned.labels, order, &open, &shown.weights)
        });
        let is_convex = errors.as_ref().is_some_and(|e| decide::is_convex(shown.concavity, e.off));
        let residuals = evidence::radiance_residuals(g, &shown.weights);
        let is_lit = self.decide_indirect(context, steps, shown, is_convex, learned);
        let kept = self.decide_visibility(context, steps, shown, errors, [is_convex, is_lit], learned);
        let mut radiance = old_radiance;
        if context.config.forced.contains(&Setting::Radiance) {
            self.note_forced(Setting::Radiance, steps, format!("degree {radiance}"));
        } else {
            radiance = decide::radiance_order(&residuals);
            let figures = [
                ("lost_rms", residuals[radiance]),
                ("lost_rms_one_less", residuals[radiance.saturating_sub(1)]),
                ("tolerance", decide::RADIANCE_TOLERANCE),
            ];
            let (was, is) = (format!("degree {old_radiance}"), format!("degree {radiance}"));
            self.note(Setting::Radiance, steps, was, is, &figures);
        }
        apply::cut_orders(learned, kept, radiance);
    }

    fn decide_visibility(
        &mut self,
        context: &StepContext<'_>,
        steps: u32,
        shown: &Shown,
        errors: Option<evidence::VisibilityErrors>,
        [is_convex, is_lit]: [bool; 2],
        learned: &Learned,
    ) -> Visibility {
        let old = learned.model.gaussians.visibility_order();
        let is_off = learned.model.shading.visibility == VisibilityForm::Off;
        let configured = if is_off { Visibility::Off } else { Visibility::Order(old) };
        if context.config.forced.contains(&Setting::Visibility) {
            self.note_forced(Setting::Visibility, steps, words(configured));
            return configured;
        }
        let Some(errors) = errors.filter(|_| !is_off) else { return configured };
        let kept = decide::visibility(&errors, is_convex, is_lit);
        let mut figures = vec![
            ("ao_error_off", errors.off),
            ("tolerance_off", decide::OFF_TOLERANCE),
            ("tolerance_concavity", decide::CONVEX_TOLERANCE),
        ];
        figures.extend(shown.concavity.map(|c| ("concavity", c)));
        if let Visibility::Order(order) = kept {
            figures.push(("ao_error", errors.ambient[order]));
            figures.push(("tolerance_ao", decide::AMBIENT_TOLERANCE));
            figures.push(("field_error", errors.field[order]));
            figures.push(("field_error_one_less", errors.field[order.saturating_sub(1)]));
            figures.push(("tolerance_field", decide::FIELD_TOLERANCE));
        }
        self.note(Setting::Visibility, steps, words(configured), words(kept), &figures);
        kept
    }

    /// Says whether bounced light stays: nothing lights a convex thing but the sky, and little is not worth it.
    fn decide_indirect(
        &mut self,
        context: &StepContext<'_>,
        steps: u32,
        shown: &Shown,
        is_convex: bool,
        learned: &mut Learned,
    ) -> bool {
        let is_gathered =
            learned.model.shading.indirect == IndirectForm::Gathered && context.config.bounces > 0;
        if context.config.forced.contains(&Setting::Indirect) {
            let value = if is_gathered { "gathered" } else { "as configured" };
            self.note_forced(Setting::Indirect, steps, value.to_owned());
            return is_gathered;
        }
        if !is_gathered || learned.gathered.is_empty() {
            return is_gathered;
        }
        let light = learned.model.environment();
        let tables = context.operators.apply(light.texels());
        let field = learned.model.gaussians.field(Field::Visibility);
        let normals = step::normals(learned);
        let share = evidence::indirect_share(&learned.gathered, field, &normals, &tables, &shown.weights);
        let stays = !is_convex && share > decide::INDIRECT_TOLERANCE;
        let is = if stays { "gathered" } else { "off" };
        let figures = [
            ("bounced_over_direct", share),
            ("tolerance", decide::INDIRECT_TOLERANCE),
            ("is_convex", f32::from(u8::from(is_convex))),
        ];
        self.note(Setting::Indirect, steps, "gathered".to_owned(), is.to_owned(), &figures);
        if !stays {
            apply::drop_indirect(learned);
        }
        stays
    }

    /// Tries the photographs without the Gaussians that add least to them, more and more of those.
    ///
    /// By the radiance branch: the other one may be out of tune, from a round of albedo a few steps ago, and what is lost
    /// would not show.
    fn drop_least(&mut self, context: &StepContext<'_>, steps: u32, photos: &[Photo], learned: &mut Learned) {
        let n = learned.model.gaussians.len();
        if context.config.forced.contains(&Setting::Gaussians) {
            return self.note_forced(Setting::Gaussians, steps, n.to_string());
        }
        let weights = weights(learned, photos, VIEWS[1]);
        let shown = |state: &Learned| psnr(photos, |photo| step::radiance_error(context, state, photo));
        let with = shown(learned);
        let mut kept = (learned.clone(), with);
        for share in decide::DROPPED_SHARES {
            let mut without = learned.clone();
            apply::keep(&mut without, &decide::heaviest(&weights, share));
            let psnr = shown(&without);
            if with - psnr > decide::DROP_TOLERANCE {
                break;
            }
            kept = (without, psnr);
        }
        let (smaller, without) = kept;
        let figures = [
            ("psnr", with),
            ("psnr_without", without),
            ("tolerance_db", decide::DROP_TOLERANCE),
            ("share_dropped", 1.0 - smaller.model.gaussians.len() as f32 / n.max(1) as f32),
        ];
        let is = smaller.model.gaussians.len().to_string();
        self.note(Setting::Gaussians, steps, n.to_string(), is, &figures);
        *learned = smaller;
    }

    /// Tries the photographs with and without metalness.
    fn decide_metalness(
        &mut self,
        context: &StepContext<'_>,
        steps: u32,
        photos: &[Photo],
        learned: &mut Learned,
    ) {
        if context.config.forced.contains(&Setting::Metalness) {
            let value = if context.config.metalness { "learned" } else { "dielectric" };
            return self.note_forced(Setting::Metalness, steps, value.to_owned());
        }
        let mut without = learned.clone();
        apply::make_dielectric(&mut without);
        let trial = Trial {
            setting: Setting::Metalness,
            without: "dielectric",
            figures: ["psnr_learned", "psnr_dielectric"],
            tolerance: decide::METALNESS_TOLERANCE,
        };
        self.is_dielectric = self.try_without(&trial, context, steps, photos, learned, without);
    }

    /// Tries the photographs with and without sheen.
    fn decide_sheen(
        &mut self,
        context: &StepContext<'_>,
        steps: u32,
        photos: &[Photo],
        learned: &mut Learned,
    ) {
        if context.config.forced.contains(&Setting::Sheen) {
            let value = if context.config.sheen { "learned" } else { "none" };
            return self.note_forced(Setting::Sheen, steps, value.to_owned());
        }
        let mut without = learned.clone();
        without.model.gaussians.field_mut(Field::Sheen).fill(0.0);
        let trial = Trial {
            setting: Setting::Sheen,
            without: "none",
            figures: ["psnr", "psnr_without"],
            tolerance: decide::SHEEN_TOLERANCE,
        };
        self.try_without(&trial, context, steps, photos, learned, without);
    }

    /// Takes the state without something that was learned, and says so, if the photographs do not miss it.
    fn try_without(
        &mut self,
        trial: &Trial,
        context: &StepContext<'_>,
        steps: u32,
        photos: &[Photo],
        learned: &mut Learned,
        without: Learned,
    ) -> bool {
        let [with, bare] = [&*learned, &without]
            .map(|state| psnr(photos, |photo| step::physical_error(context, state, photo)));
        let is_missed = with - bare > trial.tolerance;
        let [name, name_without] = trial.figures;
        let figures = [(name, with), (name_without, bare), ("tolerance_db", trial.tolerance)];
        let is = if is_missed { "learned" } else { trial.without };
        self.note(trial.setting, steps, "learned".to_owned(), is.to_owned(), &figures);
        if !is_missed {
            *learned = without;
        }
        !is_missed
    }

    fn merge(&mut self, config: &TrainConfig, steps: u32, photos: &[Photo], learned: &mut Learned) {
        let n = learned.model.prototypes.len();
        if config.forced.contains(&Setting::Prototypes) {
            return self.note_forced(Setting::Prototypes, steps, n.to_string());
        }
        let g = &learned.model.gaussians;
        let overlap = evidence::Overlap::of(g, &weights(learned, photos, VIEWS[0]));
        let (groups, moved) = decide::prototypes(&learned.model.prototypes, &overlap);
        let figures = [("albedo_moved_rms", moved), ("tolerance", decide::PROTOTYPE_TOLERANCE)];
        self.note(Setting::Prototypes, steps, n.to_string(), groups.len().to_string(), &figures);
        if groups.len() < n {
            apply::merge_prototypes(learned, &groups, &overlap);
        }
    }

    /// What the model card says.
    pub fn card(&self, config: &TrainConfig) -> Value {
        let finding = |f: &Finding| {
            let evidence: BTreeMap<&String, f64> = f.evidence.iter().map(|(k, v)| (k, rounded(*v))).collect();
            json!({
                "setting": f.setting, "step": f.step, "was": f.was, "is": f.is,
                "forced": f.forced, "evidence": evidence,
            })
        };
        json!({
            "mode": config.complexity,
            "findings": self.findings.iter().map(finding).collect::<Vec<_>>(),
        })
    }
}

fn words(visibility: Visibility) -> String {
    match visibility {
        Visibility::Off => "off".to_owned(),
        Visibility::Order(order) => format!("degree {order}"),
    }
}

/// Four significant digits: what is measured is not known better.
fn rounded(value: f32) -> f64 {
    format!("{value:.3e}").parse().unwrap_or_default()
}

#[cfg(test)]
mod tests;
