//! Reads a job's capture and its known light.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use crate::worker::job_source::{Claim, JobSourceError};
use crate::worker::progress::announce;
use crate::worker::renders::{DecodedMaps, LightSource};
use crate::worker::thread::Worker;
use crate::worker::training::outcome::{AttemptEnd, AttemptError, ENVIRONMENT_MISSING};
use relume_api::EnvironmentId;
use relume_capture::{BUILTIN, Capture, ImportLimits, Up};
use relume_spec::training::TrainConfig;
use relume_train::{MemoryBudget, MemoryEstimate, PhotographSizes, import_in_world};

impl Worker {
    /// Reads the capture on another thread while frames are rendered, in the world in which `up` is up. Stops early if the job is to
    /// stop.
    pub(super) async fn import(
        &mut self,
        claim: &dyn Claim,
        config: &TrainConfig,
        up: Up,
    ) -> Result<ControlFlow<AttemptEnd, Capture>, AttemptError> {
        announce(claim, "reading the capture").await?;
        let path = claim.capture().await.map_err(|error| match error {
            JobSourceError::Gone => AttemptError::new("capture_missing", "the capture no longer exists"),
            error => error.into(),
        })?;
        let light = known_light(claim, config).await?;
        let (config, limits) = (config.clone(), self.import_limits);
        // The budget is the memory of the machine, not the memory that is free at present, which may be larger at a retry.
        let budget = MemoryBudget::of_machine(self.device_of(claim)?);
        let read = move || load(&path, (&config, up), &limits, budget, light.as_ref());
        let capture = match self.run_in_background(claim, read).await? {
            ControlFlow::Continue(capture) => capture?,
            ControlFlow::Break(ending) => return Ok(ControlFlow::Break(ending)),
        };
        if claim.task().attempt == 1 {
            for warning in &capture.warnings {
                claim.warn(warning).await?;
            }
        }
        Ok(ControlFlow::Continue(capture))
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

/// Reads a capture and sets its known light.
fn load(
    path: &Path,
    (config, up): (&TrainConfig, Up),
    limits: &ImportLimits,
    budget: MemoryBudget,
    light: Option<&LightSource>,
) -> Result<Capture, AttemptError> {
    let mut capture = import_in_world(path, config, up, limits, budget)?;
    let memory = MemoryEstimate::of(&PhotographSizes::of(&capture), config, budget.on_device);
    tracing::info!(%memory, available = budget.available, "estimated memory of the training");
    if let (Some(known), Some(source)) = (&config.light, light) {
        let map = source
            .map()
            .map_err(|e| AttemptError::new(ENVIRONMENT_MISSING, format!("the known light: {e}")))?;
        if let Some(map) = map {
            relume_train::illuminate(known, &mut capture, Arc::unwrap_or_clone(map));
        }
    }
    Ok(capture)
}
