//! A training and its evaluation, for tables that compare settings.

use std::sync::Arc;
use std::time::Duration;

use crate::cli::error::CommandResult;
use relume_capture::Capture;
use relume_engine::Device;
use relume_scene::Model;
use relume_spec::training::TrainConfig;
use relume_train::Trainer;
use relume_train::eval::{EvalOptions, Report, evaluate};

/// A trained model and its scores.
pub(super) struct Trained {
    pub(super) model: Arc<Model>,
    /// Seconds spent in steps.
    pub(super) seconds: f64,
    pub(super) report: Report,
}

/// Trains on `capture` to the end and compares at most `views` held-out views. Frame rates are not measured.
pub(super) fn train_and_evaluate(
    capture: &Capture,
    config: TrainConfig,
    device: &Device,
    views: usize,
) -> CommandResult<Trained> {
    let mut trainer = Trainer::new(capture, config, device)?;
    while !trainer.is_done() {
        trainer.step()?;
    }
    let (model, seconds) = (Arc::new(trainer.model()?), trainer.seconds());
    // The renderer needs the trainer's device memory.
    drop(trainer);
    let options =
        EvalOptions { views: Some(views), frame_rate_time: Duration::ZERO, device, ..EvalOptions::default() };
    let report = evaluate(model.clone(), capture, &options)?;
    Ok(Trained { model, seconds, report })
}
