//! Prepares a training without a device, so that this can run on any thread.

use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::dataset::Dataset;
use crate::error::TrainError;
use crate::state::ScheduleState;
use crate::time_budget::Timeline;
use crate::{checkpoint, initial, world_up};
use relume_capture::Capture;
use relume_engine::TrainState;
use relume_scene::Model;
use relume_scene::light::{EnvOperators, TableResolution};
use relume_spec::training::{Crop, TrainConfig, WhiteBalance};

/// Least number of photographs for a training.
const MIN_VIEWS: usize = 3;

/// A training that is ready to start or resume on a device.
pub struct PreparedTraining {
    pub(super) config: TrainConfig,
    pub(super) data: Dataset,
    pub(super) operators: Arc<EnvOperators>,
    pub(super) schedule: ScheduleState,
    pub(super) state: TrainState,
}

impl PreparedTraining {
    /// Starts a new training.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] names the unsuitable setting or input.
    pub fn new(capture: &Capture, mut config: TrainConfig) -> Result<Self, TrainError> {
        let data = prepare(capture, &mut config)?;
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let model = initial::model(capture, &data, &config, &mut rng);
        let mut schedule = ScheduleState::new(data.len(), config.iterations, rng);
        schedule.up = Some(capture.up.clone());
        Ok(Self::of(config, data, schedule, TrainState::new(model)))
    }

    /// Resumes from the bytes of a checkpoint.
    ///
    /// # Errors
    /// [`TrainError::Checkpoint`] names what does not match, [`TrainError::Invalid`] the unsuitable setting or input.
    pub fn resume(capture: &Capture, mut config: TrainConfig, bytes: &[u8]) -> Result<Self, TrainError> {
        let mut data = prepare(capture, &mut config)?;
        let (mut schedule, mut state) = checkpoint::decode(bytes, &config)?;
        world_up::check(schedule.up.as_ref(), &capture.up)?;
        schedule.up.get_or_insert_with(|| capture.up.clone());
        if schedule.order.len() != data.len() {
            return Err(TrainError::Checkpoint(
                "order: the checkpoint has another number of photographs".into(),
            ));
        }
        let gathered = state.model.gaussians.len() * data.lights.blocks.len();
        let is_of_these_lights = state.gathered.is_empty() || state.gathered.len() == gathered;
        if !is_of_these_lights || state.model.light_groups() != data.lights.groups() {
            return Err(TrainError::Checkpoint(
                "gathered: the checkpoint has another number of light rotations or light groups than the capture: set turntable_capture, \
                 the rotations and the groups as in its training, or start again without the checkpoint"
                    .into(),
            ));
        }
        match &schedule.cut {
            Some(cut) => cut.apply(&mut data, state.model.shading),
            // The text of a checkpoint may differ in the last digit.
            None => {
                state.model.framing = initial::framing(capture);
                (state.model.world_scale, state.model.world_offset) = (data.scale, data.offset);
            }
        }
        schedule.gains.iter().for_each(|gains| data.divide(gains));
        Ok(Self::of(config, data, schedule, state))
    }

    /// Limits the cache of decoded photographs to `bytes`, not counting those of the current step. Results do not
    /// depend on it.
    #[must_use]
    pub fn with_photo_cache(mut self, bytes: usize) -> Self {
        self.data.bound(bytes);
        self
    }

    /// Repeats a recorded plan instead of one step per iteration.
    #[must_use]
    pub fn with_timeline(mut self, timeline: Timeline) -> Self {
        self.schedule.timeline = timeline;
        self
    }

    fn of(config: TrainConfig, data: Dataset, schedule: ScheduleState, state: TrainState) -> Self {
        let operators = operators_of(&state.model);
        Self { config, data, operators, schedule, state }
    }
}

/// Checks that `capture` is suitable for training, adds measurements in it to `config`, and prepares its photographs.
fn prepare(capture: &Capture, config: &mut TrainConfig) -> Result<Dataset, TrainError> {
    if capture.train.len() < MIN_VIEWS {
        let n = capture.train.len();
        return Err(TrainError::Invalid(format!(
            "capture: {n} usable training photographs; at least {MIN_VIEWS} are needed"
        )));
    }
    if config.light.is_some() && capture.measured_light.is_none() {
        return Err(TrainError::Invalid("light: the environment map that it names is missing".into()));
    }
    if !capture.has_light_rotations(&config.light_rotation_per_photo) {
        let reason = "the photographs do not have these rotations of the light";
        return Err(TrainError::Invalid(format!("light_rotation_per_photo: {reason}")));
    }
    if !capture.has_light_groups(&config.light_groups) {
        let reason =
            "the photographs do not have these light groups; import the capture with the same settings";
        return Err(TrainError::Invalid(format!("light_groups: {reason}")));
    }
    if config.light.is_some()
        && capture.train.iter().any(|view| view.light_group != capture.train[0].light_group)
    {
        let reason = "is one light of all photographs, but the capture states several light groups; train without a known light";
        return Err(TrainError::Invalid(format!("light: {reason}")));
    }
    if config.crop != Crop::NONE && capture.has_alpha {
        return Err(TrainError::Invalid(
            "crop: the photographs have masks, which already define the subject".into(),
        ));
    }
    if config.grey_card.is_some() {
        let missing = "grey_card: the colour of the card was not measured";
        let card = capture.grey_card.ok_or_else(|| TrainError::Invalid(missing.into()))?;
        config.white_balance = WhiteBalance::Colour(card.colour);
    }
    if config.colour_chart.is_some() && capture.colour_chart.is_none() {
        return Err(TrainError::Invalid("colour_chart: the chart was not measured".into()));
    }
    Ok(Dataset::new(capture, config))
}

/// The operators for a model's environment, lights and visibility.
pub(super) fn operators_of(model: &Model) -> Arc<EnvOperators> {
    let sh_degree = model.gaussians.visibility_degree();
    let whole = EnvOperators::new(model.env_width, model.env_height, sh_degree, TableResolution::TRAINING);
    Arc::new(whole.with_lights(&model.lights))
}
