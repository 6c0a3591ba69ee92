//! The schedule: the trained parameters, weights and step sizes of each step as a function of progress.

use relume_engine::{
    Branches, FieldUpdate, ImageWeights, LightWeights, ParameterWeights, PhotoLights, PhotoSize,
    ProbeMeasurement, StepSizes, StepWeights, SurfaceWeights,
};
use relume_scene::Field;
use relume_scene::light::LightColour;
use relume_spec::training::{LabelSource, TrainConfig};

/// Progress at which depth-normal consistency starts; before, depth is too noisy.
const NORMALS_FROM: f32 = 0.05;
/// Factor on the weight of the exposure term if the light rotates.
const ROTATING_LIGHT_EXPOSURE: f32 = 0.01;
/// Progress at which sheen starts to train. Earlier it explains effects of normals, roughness and light.
const SHEEN_FROM: f32 = 0.7;

/// First position that may have a round of density control, and the largest distance between two rounds.
const FIRST_ROUND: u32 = 50;
const ROUND_EVERY: u32 = 100;

/// Number of iterations above which positions, shapes, materials, normals and light take proportionally smaller steps.
/// Larger total updates would only fit noise of the photographs.
const REFERENCE_ITERATIONS: f32 = 6000.0;

/// The branches that are trained after `step` steps.
pub fn branches(config: &TrainConfig, step: u32) -> Branches {
    let progress = step as f32 / config.iterations as f32;
    if step >= config.warm_up_steps() {
        return match config.labels {
            LabelSource::Probes => Branches::Both,
            _ => Branches::BothWithVisibility,
        };
    }
    match progress >= NORMALS_FROM && config.weights.depth_normal > 0.0 {
        true => Branches::RadianceAndNormals,
        false => Branches::Radiance,
    }
}

/// Size of the training photograph after `step` steps.
pub fn photo_size(config: &TrainConfig, step: u32) -> PhotoSize {
    let progress = step as f32 / config.iterations as f32;
    if progress < config.half_resolution { PhotoSize::Half } else { PhotoSize::Full }
}

/// True when the training measures visibility, for labels or for bounced light.
pub fn measures(config: &TrainConfig) -> bool {
    config.bounces > 0 || matches!(config.labels, LabelSource::Probes | LabelSource::Both)
}

/// Share of the schedule after which Gaussians that no photograph shows are hidden.
const HIDING: f32 = 0.8;

/// The position before which the Gaussians that no photograph shows are hidden.
pub fn hiding(config: &TrainConfig) -> u32 {
    (HIDING * config.iterations as f32) as u32
}

/// The rounds of density control.
pub fn density_rounds(config: &TrainConfig) -> DensityRounds {
    let total = config.iterations;
    DensityRounds {
        first: (total / 50).max(FIRST_ROUND),
        last: (config.densify_until * total as f32) as u32,
        every: ROUND_EVERY.min((total / 15).max(10)),
    }
}

/// Positions of rounds of density control: the multiples of `every` from `first` to `last`.
#[derive(Debug, Clone, Copy)]
pub struct DensityRounds {
    /// The position before which there is no round.
    pub first: u32,
    /// The position after which there is no round.
    pub last: u32,
    /// Distance between rounds.
    pub every: u32,
}

impl DensityRounds {
    /// Whether a round is due after the step that reaches `position`.
    pub fn contains(&self, position: u32) -> bool {
        (self.first..=self.last).contains(&position) && position.is_multiple_of(self.every)
    }
}

/// Weights of the objective at `progress` in [0, 1]. `light` is the colour towards which the light is regularised.
pub fn step_weights(
    config: &TrainConfig,
    branches: Branches,
    progress: f32,
    has_alpha: bool,
    light: LightColour,
) -> StepWeights {
    let w = &config.weights;
    let if_physical = |weight: f32| if branches.is_physical() { weight } else { 0.0 };
    let share = if branches.is_physical() { config.radiance_weight(has_alpha) } else { 1.0 };
    let labels = |sources: &[LabelSource]| {
        if_physical(if sources.contains(&config.labels) { w.visibility } else { 0.0 })
    };
    StepWeights {
        physical: ImageWeights { l1: if_physical(w.l1), ssim: if_physical(w.ssim) },
        radiance: ImageWeights { l1: w.l1 * share, ssim: w.ssim * share },
        surface: SurfaceWeights {
            coverage: if has_alpha { w.coverage } else { 0.0 },
            depth_normal: if branches == Branches::Radiance { 0.0 } else { w.depth_normal },
            smoothness: w.smooth().map(if_physical),
        },
        light: LightWeights {
            neutrality: if_physical(w.light),
            exposure: if_physical(w.exposure),
            colour: if_physical(w.light_colour),
            wanted: light,
            tolerance: config.light_colour_tolerance(progress),
        },
        parameters: ParameterWeights {
            aggregation: if_physical(w.aggregation),
            residual: if_physical(w.residual),
            flatness: w.flatness,
            probe_labels: labels(&[LabelSource::Both]),
            view_labels: labels(&[LabelSource::Backward, LabelSource::Both]),
        },
    }
}

/// Weights of the terms on a light that rotates between photographs. Moving highlights determine its level, so the
/// exposure term only has to prevent drift.
pub fn rotating_light_weights(weights: LightWeights) -> LightWeights {
    LightWeights { exposure: weights.exposure * ROTATING_LIGHT_EXPOSURE, ..weights }
}

/// Weights of the terms on a light of which only `sources`, a share of the sphere, are trained: the rest of it fixes level and colour,
/// so an estimate of the colour is no longer used once it has a tolerance.
pub fn weights_with_sources(weights: LightWeights, sources: f32) -> LightWeights {
    let colour = if weights.tolerance > 0.0 { 0.0 } else { weights.colour * sources };
    LightWeights { exposure: weights.exposure * sources, colour, ..weights }
}

/// Adam's step sizes at `progress` in [0, 1].
///
/// Those of shapes and radiance decrease to a thirtieth over the second half; those of materials, normals and light
/// decrease to a tenth over the last quarter. With more iterations than `REFERENCE_ITERATIONS` all of them are
/// proportionally smaller, except for those of opacity and radiance.
pub fn step_sizes(config: &TrainConfig, branches: Branches, progress: f32) -> StepSizes {
    let rates = &config.rates;
    let share = (REFERENCE_ITERATIONS / config.iterations as f32).min(1.0);
    let mean = share * rates.mean * (rates.mean_final / rates.mean.max(1e-20)).powf(progress);
    let second_half = (2.0 * progress - 1.0).max(0.0);
    let late = (1.0f32 / 30.0).powf(second_half);
    let last_quarter = (4.0 * progress - 3.0).max(0.0);
    let on = if branches.is_physical() { share * 0.1f32.powf(last_quarter) } else { 0.0 };
    let visibility = if branches == Branches::BothWithVisibility { rates.visibility * on } else { 0.0 };
    let table = [
        (Field::Mean, mean),
        (Field::LogScale, share * rates.scale * late),
        (Field::Quaternion, share * rates.rotation * late),
        (Field::OpacityLogit, rates.opacity * late),
        (Field::Normal, rates.normal * on),
        (Field::MetalLogit, if config.metalness { rates.material * on } else { 0.0 }),
        (Field::RoughLogit, rates.material * on),
        (Field::Sheen, if config.sheen && progress >= SHEEN_FROM { rates.sheen * on } else { 0.0 }),
        (Field::ProtoLogits, rates.scores * on),
        (Field::Residual, rates.residual * on),
        (Field::Visibility, visibility),
        (Field::Indirect, visibility),
        (Field::Radiance, rates.radiance * late),
    ];
    let mut fields = [0.0; Field::COUNT];
    for (field, rate) in table {
        fields[field as usize] = rate;
    }
    StepSizes { fields, prototypes: rates.prototypes * on, environment: rates.environment * on }
}

/// The measurement of visibility and gathered light: `repeats` times in succession, under each of the `lights` of
/// the light.
pub fn measurement<'a>(
    config: &TrainConfig,
    lights: &'a PhotoLights,
    repeats: usize,
) -> ProbeMeasurement<'a> {
    ProbeMeasurement {
        directions: config.probe_directions as usize,
        bounces: config.bounces as usize,
        lights: &lights.blocks,
        field: match config.labels {
            LabelSource::Probes => FieldUpdate::Replace,
            LabelSource::Both => FieldUpdate::Start,
            LabelSource::None | LabelSource::Backward => FieldUpdate::Keep,
        },
        repeats,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::training::Preset;

    #[test]
    fn material_rates_fall_in_the_last_quarter_and_sheen_is_late() {
        let config = TrainConfig::preset(Preset::Draft);
        let rates = config.rates;
        let size = |field: Field, progress: f32| {
            step_sizes(&config, Branches::BothWithVisibility, progress).fields[field as usize]
        };
        assert_eq!(size(Field::RoughLogit, 0.75), rates.material);
        assert!((size(Field::RoughLogit, 1.0) - 0.1 * rates.material).abs() < 1e-6);
        assert_eq!(size(Field::Sheen, 0.69), 0.0);
        assert_eq!(size(Field::Sheen, 0.71), rates.sheen);
        assert!(size(Field::LogScale, 0.75) < 0.2 * rates.scale, "the control: shapes fall before");
    }

    #[test]
    fn step_sizes_shrink_for_longer_trainings() {
        let sizes = |iterations| {
            let config = TrainConfig { iterations, ..TrainConfig::preset(Preset::High) };
            step_sizes(&config, Branches::Both, 0.5)
        };
        let (short, usual, long) = (sizes(600), sizes(6000), sizes(30_000));
        assert_eq!(short, usual);
        for field in [
            Field::Mean,
            Field::LogScale,
            Field::Quaternion,
            Field::Normal,
            Field::RoughLogit,
            Field::MetalLogit,
            Field::ProtoLogits,
            Field::Residual,
        ] {
            let [usual, long] = [&usual, &long].map(|sizes| sizes.fields[field as usize]);
            assert!((5.0 * long / usual - 1.0).abs() < 1e-5, "{field:?}: {usual} {long}");
        }
        assert!((5.0 * long.environment / usual.environment - 1.0).abs() < 1e-5);
        for field in [Field::OpacityLogit, Field::Radiance] {
            assert_eq!(long.fields[field as usize], usual.fields[field as usize], "{field:?}");
        }
    }

    #[test]
    fn photographed_surroundings_replace_the_estimated_colour() {
        let weights = LightWeights { exposure: 1.0, colour: 1.0, ..LightWeights::default() };
        let kept = weights_with_sources(weights, 0.25);
        assert_eq!((kept.exposure, kept.colour), (0.25, 0.25));
        let later = weights_with_sources(LightWeights { tolerance: 0.15, ..weights }, 0.25);
        assert_eq!((later.exposure, later.colour), (0.25, 0.0));
    }

    #[test]
    fn warm_up_trains_radiance_then_normals_then_everything() {
        let config = TrainConfig::preset(Preset::Draft);
        let at = |step| branches(&config, step);
        assert_eq!(
            [at(0), at(75), at(375)],
            [Branches::Radiance, Branches::RadianceAndNormals, Branches::Both]
        );
        let weights = |step| step_weights(&config, at(step), 0.5, true, LightColour::NEUTRAL);
        assert_eq!(weights(75).physical, ImageWeights::default());
        assert!(weights(375).physical.l1 > 0.0 && weights(375).radiance.l1 < weights(75).radiance.l1);
    }
}
