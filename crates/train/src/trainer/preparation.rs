//! From a capture to a trainer: what needs no device first, so that it can be done on any thread.

use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::dataset::Dataset;
use crate::error::TrainError;
use crate::state::ScheduleState;
use crate::{checkpoint, initial};
use relume_capture::Capture;
use relume_engine::TrainState;
use relume_scene::Model;
use relume_scene::light::{EnvOperators, TableResolution};
use relume_spec::training::{Crop, TrainConfig, WhiteBalance};

/// Fewest photographs worth training on.
const MIN_VIEWS: usize = 3;

/// A training that is ready to begin, or to go on, on a device.
pub struct PreparedTraining {
    pub(super) config: TrainConfig,
    pub(super) data: Dataset,
    pub(super) operators: Arc<EnvOperators>,
    pub(super) schedule: ScheduleState,
    pub(super) state: TrainState,
}

impl PreparedTraining {
    /// Starts from nothing.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] names what cannot be trained on.
    pub fn new(capture: &Capture, mut config: TrainConfig) -> Result<Self, TrainError> {
        let data = prepare(capture, &mut config)?;
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let model = initial::model(capture, &data, &config, &mut rng);
        let schedule = ScheduleState::new(data.len(), rng);
        Ok(Self::of(config, data, schedule, TrainState::new(model)))
    }

    /// Goes on from the bytes of a checkpoint.
    ///
    /// # Errors
    /// [`TrainError::Checkpoint`] names what does not fit, [`TrainError::Invalid`] what cannot be trained on.
    pub fn resume(capture: &Capture, mut config: TrainConfig, bytes: &[u8]) -> Result<Self, TrainError> {
        let mut data = prepare(capture, &mut config)?;
        let (schedule, state) = checkpoint::decode(bytes, &config)?;
        if schedule.order.len() != data.len() {
            return Err(TrainError::Checkpoint("order: was made with another number of photographs".into()));
        }
        if let Some(cut) = &schedule.cut {
            cut.apply(&mut data, state.model.shading);
        }
        schedule.gains.iter().for_each(|gains| data.divide(gains));
        Ok(Self::of(config, data, schedule, state))
    }

    /// Keeps at most so many bytes of photographs decoded, beside those of the step that runs. No result depends on it.
    #[must_use]
    pub fn with_photo_cache(mut self, bytes: usize) -> Self {
        self.data.bound(bytes);
        self
    }

    fn of(config: TrainConfig, data: Dataset, schedule: ScheduleState, state: TrainState) -> Self {
        let operators = operators_of(&state.model);
        Self { config, data, operators, schedule, state }
    }
}

/// Checks that `capture` can be trained on, gives `config` what was measured in it, and reads its photographs.
fn prepare(capture: &Capture, config: &mut TrainConfig) -> Result<Dataset, TrainError> {
    if capture.train.len() < MIN_VIEWS {
        let n = capture.train.len();
        return Err(TrainError::Invalid(format!(
            "capture: {n} usable training photographs, at least {MIN_VIEWS} are needed"
        )));
    }
    if config.light.is_some() && capture.measured_light.is_none() {
        return Err(TrainError::Invalid("light: the capture came without the map it names".into()));
    }
    if !capture.has_light_rotations(&config.light_rotation_per_photo) {
        let reason = "the capture came without the turns of the light that are given here";
        return Err(TrainError::Invalid(format!("light_rotation_per_photo: {reason}")));
    }
    if config.crop != Crop::NONE && capture.has_alpha {
        return Err(TrainError::Invalid(
            "crop: the photographs have masks, which say what the subject is".into(),
        ));
    }
    if config.grey_card.is_some() {
        let missing = "grey_card: the capture came without the colour of the card";
        let colour = capture.grey_card.ok_or_else(|| TrainError::Invalid(missing.into()))?;
        config.white_balance = WhiteBalance::Colour(colour);
    }
    Ok(Dataset::new(capture, config))
}

/// The operators for a model's environment, its lights and visibility.
pub(super) fn operators_of(model: &Model) -> Arc<EnvOperators> {
    let sh_degree = model.gaussians.visibility_degree();
    let whole = EnvOperators::new(model.env_width, model.env_height, sh_degree, TableResolution::TRAINING);
    Arc::new(whole.with_lights(&model.lights))
}
