//! Reads a job's capture and its known light.

use std::ops::ControlFlow;
use std::sync::Arc;

use crate::worker::job_source::{Claim, JobSourceError};
use crate::worker::progress::announce;
use crate::worker::renders::{DecodedMaps, LightSource};
use crate::worker::thread::Worker;
use crate::worker::training::outcome::{AttemptEnd, AttemptError, ENVIRONMENT_MISSING};
use crate::worker::training::time_budget::{AttemptClock, finish_steps};
use relume_api::EnvironmentId;
use relume_capture::{BUILTIN, Capture, Up};
use relume_spec::training::TrainConfig;
use relume_train::time_budget::{Planning, StepCost, import_planned};
use relume_train::{MemoryBudget, MemoryEstimate, PhotographSizes, import_in_world};

/// Inputs of the plan of a job with a time budget, which the worker makes before it reads the capture.
pub(super) struct ImportPlanning {
    /// Measured cost of a step, seconds.
    pub(super) cost: StepCost,
    pub(super) clock: AttemptClock,
}

impl Worker {
    /// Reads the capture on another thread while frames are rendered, in the world in which `up` is up. Stops early if the job is to
    /// stop. With `planning` the settings are planned for the job's time budget; otherwise they are those of `config`.
    pub(super) async fn import(
        &mut self,
        claim: &dyn Claim,
        config: TrainConfig,
        up: Up,
        planning: Option<ImportPlanning>,
    ) -> Result<ControlFlow<AttemptEnd, (Capture, TrainConfig)>, AttemptError> {
        announce(claim, "reading the capture").await?;
        let path = claim.capture().await.map_err(|error| match error {
            JobSourceError::Gone => AttemptError::new("capture_missing", "the capture no longer exists"),
            error => error.into(),
        })?;
        let light = known_light(claim, &config).await?;
        let (limits, overrides) = (self.import_limits, claim.task().request.overrides.clone());
        // The budget is the memory of the machine, not the memory that is free at present, which may be larger at a retry.
        let budget = MemoryBudget::of_machine(self.device_of(claim)?);
        let read = move || {
            let Some(ImportPlanning { cost, clock }) = planning else {
                let capture = import_in_world(&path, &config, up, &limits, budget)?;
                return lit(capture, config, budget, light.as_ref());
            };
            let (now, finish_steps) = (|| clock.seconds(), finish_steps());
            let planning = Planning { overrides: &overrides, cost, finish_steps, now: &now };
            let (capture, config) = import_planned(&path, up, &limits, budget, &planning)?;
            lit(capture, config, budget, light.as_ref())
        };
        let (capture, config) = match self.run_in_background(claim, read).await? {
            ControlFlow::Continue(read) => read?,
            ControlFlow::Break(ending) => return Ok(ControlFlow::Break(ending)),
        };
        if claim.task().attempt == 1 {
            for warning in &capture.warnings {
                claim.warn(warning).await?;
            }
        }
        Ok(ControlFlow::Continue((capture, config)))
    }
}

/// The source of the map of a known light.
async fn known_light(claim: &dyn Claim, config: &TrainConfig) -> Result<Option<LightSource>, AttemptError> {
    let Some(light) = &config.light else { return Ok(None) };
    if BUILTIN.contains(&light.environment.as_str()) {
        return Ok(Some(LightSource::Builtin(light.environment.clone())));
    }
    let found = claim.environment(&EnvironmentId::from(light.environment.as_str())).await;
    let (path, sha256) = found.map_err(|error| match error {
        JobSourceError::Gone => AttemptError::new(ENVIRONMENT_MISSING, "the known light no longer exists"),
        error => error.into(),
    })?;
    Ok(Some(LightSource::Stored { sha256, path, maps: DecodedMaps::default() }))
}

/// The capture with its known light, and the settings of the training.
fn lit(
    mut capture: Capture,
    config: TrainConfig,
    budget: MemoryBudget,
    light: Option<&LightSource>,
) -> Result<(Capture, TrainConfig), AttemptError> {
    let memory = MemoryEstimate::of(&PhotographSizes::of(&capture), &config, budget.on_device);
    tracing::info!(%memory, available = budget.available, "estimated memory of the training");
    if let (Some(known), Some(source)) = (&config.light, light) {
        let map = source
            .map()
            .map_err(|e| AttemptError::new(ENVIRONMENT_MISSING, format!("the known light: {e}")))?;
        if let Some(map) = map {
            relume_train::illuminate(known, &mut capture, Arc::unwrap_or_clone(map));
        }
    }
    Ok((capture, config))
}
