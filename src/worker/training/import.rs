//! Reading a job's capture, and the light that it is known to have been taken in.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use crate::api::{EnvironmentId, TenantId};
use crate::capture::{BUILTIN, Capture, ImportLimits};
use crate::jobs::Lease;
use crate::train::{TrainConfig, import_for_training};
use crate::worker::progress::announce;
use crate::worker::renders::LightSource;
use crate::worker::thread::Worker;
use crate::worker::training::outcome::{AttemptEnd, AttemptError, ENVIRONMENT_MISSING};

impl Worker {
    /// Reads the capture on another thread while this one renders; stops early when the job is to stop.
    pub(super) async fn import(
        &mut self,
        lease: &Lease,
        config: &TrainConfig,
    ) -> Result<ControlFlow<AttemptEnd, Capture>, AttemptError> {
        let job = lease.job();
        announce(lease, "reading the capture").await?;
        let record = self.jobs.store().capture(&job.tenant, &job.request.capture).await?;
        let record = record.ok_or_else(|| AttemptError::new("capture_missing", "the capture is gone"))?;
        let artifacts = self.jobs.store().artifacts();
        artifacts.verify(&record.artifact, &record.sha256).await?;
        let path = artifacts.local_path(&record.artifact);
        let light = self.known_light(&job.tenant, config).await?;
        let (config, limits) = (config.clone(), self.import_limits);
        let read = move || load(&path, &config, &limits, light.as_ref());
        let capture = match self.aside(lease, read).await? {
            ControlFlow::Continue(capture) => capture?,
            ControlFlow::Break(ending) => return Ok(ControlFlow::Break(ending)),
        };
        if job.attempts == 1 {
            for warning in &capture.warnings {
                lease.warn(warning).await?;
            }
        }
        Ok(ControlFlow::Continue(capture))
    }

    /// The source of the map of a known light.
    async fn known_light(
        &self,
        tenant: &TenantId,
        config: &TrainConfig,
    ) -> Result<Option<LightSource>, AttemptError> {
        let Some(light) = &config.light else { return Ok(None) };
        if BUILTIN.contains(&light.environment.as_str()) {
            return Ok(Some(LightSource::Builtin(light.environment.clone())));
        }
        let store = self.jobs.store();
        let record = store.environment(tenant, &EnvironmentId::from(light.environment.as_str())).await?;
        let record =
            record.ok_or_else(|| AttemptError::new(ENVIRONMENT_MISSING, "the known light is gone"))?;
        store.artifacts().verify(&record.artifact, &record.sha256).await?;
        let path = store.artifacts().local_path(&record.artifact);
        Ok(Some(LightSource::Stored { sha256: record.sha256, path }))
    }
}

/// A capture with the light it is known to have been taken in.
fn load(
    path: &Path,
    config: &TrainConfig,
    limits: &ImportLimits,
    light: Option<&LightSource>,
) -> Result<Capture, AttemptError> {
    let capture = import_for_training(path, config, limits);
    let mut capture = capture.map_err(|e| AttemptError::new(e.code(), e.to_string()))?;
    if let (Some(known), Some(source)) = (&config.light, light) {
        let map = source
            .map()
            .map_err(|e| AttemptError::new(ENVIRONMENT_MISSING, format!("the known light: {e}")))?;
        if let Some(map) = map {
            known.illuminate(&mut capture, Arc::unwrap_or_clone(map));
        }
    }
    Ok(capture)
}
