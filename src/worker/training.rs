//! One attempt at a job: import, train step by step, checkpoint, publish.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::capture::{BUILTIN, Capture, CaptureError, ImportOptions};
use crate::engine::Device;
use crate::engine::gpu::GpuError;
use crate::formats::{model_file, ply_model};
use crate::jobs::Lease;
use crate::scene::Model;
use crate::store::{Held, ModelFile, ModelRecord, ProgressUpdate, StoreError};
use crate::train::{Preset, TrainConfig, TrainError, TrainOverrides, Trainer};
use crate::worker::progress::Reporter;
use crate::worker::{LightSource, Worker};

/// How an attempt ended without a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ending {
    /// The model is published.
    Published,
    /// The job was cancelled.
    Cancelled,
    /// The lease was lost; someone else has the job.
    Lost,
    /// The server is stopping; the job is checkpointed and back in the queue.
    Stopped,
}

/// Code of failures to find or read a known light.
const ENVIRONMENT_MISSING: &str = "environment_missing";
/// Code of failures after which the device is opened anew.
const DEVICE_FAILED: &str = "device_failed";

/// A failure that ends the attempt and, unless it may pass, the job.
pub(super) struct Failure {
    /// Stable code.
    pub(super) code: &'static str,
    /// For people; no internals.
    pub(super) detail: String,
    /// Another attempt may succeed: the job goes on from its checkpoint.
    pub(super) may_pass: bool,
}

impl Failure {
    fn new(code: &'static str, detail: impl Into<String>) -> Self {
        Self { code, detail: detail.into(), may_pass: false }
    }

    /// The device can no longer be trusted.
    pub(super) fn is_of_the_device(&self) -> bool {
        self.code == DEVICE_FAILED
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        tracing::error!(%error, "the store failed under a job");
        match error {
            StoreError::Full => Self::new("storage_full", "there was no room to store the result"),
            _ => Self::new("storage_failed", "the store failed; the server's log says how"),
        }
    }
}

impl From<TrainError> for Failure {
    fn from(error: TrainError) -> Self {
        match error {
            // A model that is too large for the device stays so.
            TrainError::Device(error @ (GpuError::TooLarge { .. } | GpuError::Unavailable(_))) => {
                Self::new("device_unfit", error.to_string())
            }
            TrainError::Device(error) => {
                Self { may_pass: true, ..Self::new(DEVICE_FAILED, error.to_string()) }
            }
            error => Self::new("training_failed", error.to_string()),
        }
    }
}

/// What one attempt carries from step to step.
struct Attempt<'a> {
    lease: &'a Lease,
    trainer: Trainer,
    reporter: Reporter,
    checkpoint_every: u32,
}

impl Worker {
    /// Trains the lease's job until it ends one way or another.
    pub(super) async fn train(&mut self, lease: &Lease) -> Result<Ending, Failure> {
        let config = config(lease)?;
        let checkpoint_every = config.checkpoint_every.max(1);
        let capture = match self.import(lease, &config).await? {
            ControlFlow::Continue(capture) => capture,
            ControlFlow::Break(ending) => return Ok(ending),
        };
        let trainer = self.trainer(lease, &capture, config).await?;
        let reporter = Reporter::new(self.jobs.now_ms(), trainer.progress().step);
        let mut attempt = Attempt { lease, trainer, reporter, checkpoint_every };
        while !attempt.trainer.is_done() {
            if self.stop.is_cancelled() {
                return attempt.suspend().await;
            }
            if self.changes.has_changed().unwrap_or(false) {
                self.changes.mark_unchanged();
                if held_or_unknown(lease.check().await) != Held::Yes {
                    return Ok(settle(lease).await?);
                }
            }
            let held = attempt.step(self.jobs.now_ms()).await?;
            self.steps.fetch_add(1, Ordering::SeqCst);
            if held != Held::Yes {
                return Ok(settle(lease).await?);
            }
            self.serve_waiting();
        }
        publish(lease, &attempt.trainer).await
    }

    /// Reads the capture beside this thread, which renders meanwhile; breaks off when the job is to stop.
    async fn import(
        &mut self,
        lease: &Lease,
        config: &TrainConfig,
    ) -> Result<ControlFlow<Ending, Capture>, Failure> {
        let job = lease.job();
        announce(lease, "reading the capture").await?;
        let record = self.jobs.store().capture(&job.capture_id).await?;
        let record = record.ok_or_else(|| Failure::new("capture_missing", "the capture is gone"))?;
        let path = self.jobs.store().artifacts().local_path(&record.artifact);
        let light = self.known_light(config).await?;
        let config = config.clone();
        let mut importing = tokio::task::spawn_blocking(move || lit_capture(&path, &config, light.as_ref()));
        let capture = loop {
            tokio::select! {
                imported = &mut importing => break imported,
                Some(request) = self.renders.recv() => self.serve(request),
                _ = self.changes.changed() => if lease.check().await? != Held::Yes {
                    return Ok(ControlFlow::Break(settle(lease).await?));
                },
                () = self.stop.cancelled() => {
                    lease.release(true).await?;
                    return Ok(ControlFlow::Break(Ending::Stopped));
                }
            }
        };
        let capture = capture.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()));
        let capture = capture?;
        if job.attempts == 1 {
            for warning in &capture.warnings {
                lease.warn(warning).await?;
            }
        }
        Ok(ControlFlow::Continue(capture))
    }

    /// Where the map of a known light lies.
    async fn known_light(&self, config: &TrainConfig) -> Result<Option<LightSource>, Failure> {
        let Some(light) = &config.light else { return Ok(None) };
        if BUILTIN.contains(&light.environment.as_str()) {
            return Ok(Some(LightSource::Builtin(light.environment.clone())));
        }
        let store = self.jobs.store();
        let record = store.environment(&light.environment).await?;
        let record = record.ok_or_else(|| Failure::new(ENVIRONMENT_MISSING, "the known light is gone"))?;
        let path = store.artifacts().local_path(&record.artifact);
        Ok(Some(LightSource::Stored { sha256: record.sha256, path }))
    }

    /// Goes on from the last checkpoint, or starts over when there is none that can be read.
    async fn trainer(
        &self,
        lease: &Lease,
        capture: &Capture,
        config: TrainConfig,
    ) -> Result<Trainer, Failure> {
        announce(lease, "preparing").await?;
        let device = match (lease.job().device.as_str(), &self.device) {
            ("cpu", _) => &Device::Cpu,
            ("gpu", Device::Cpu) => return Err(Failure::new("device_unfit", "this server has no GPU")),
            (_, device) => device,
        };
        let Some(key) = &lease.job().checkpoint else { return Ok(Trainer::new(capture, config, device)?) };
        let resumed = match self.jobs.store().artifacts().get(key).await {
            Ok(bytes) => Trainer::resume(capture, config.clone(), &bytes, device),
            Err(error) => Err(TrainError::Checkpoint(error.to_string())),
        };
        match resumed {
            Ok(trainer) => Ok(trainer),
            Err(error @ TrainError::Device(_)) => Err(error.into()),
            Err(error) => {
                tracing::warn!(%error, key, "a checkpoint cannot be used");
                lease.warn("the last checkpoint cannot be read; training starts over").await?;
                Ok(Trainer::new(capture, config, device)?)
            }
        }
    }
}

impl Attempt<'_> {
    /// One step and what it has to tell.
    async fn step(&mut self, now_ms: i64) -> Result<Held, Failure> {
        let report = self.trainer.step()?;
        metrics::counter!("relume_training_steps_total").increment(1);
        if let Some(warning) = &report.warning {
            self.tell(warning).await;
        }
        let progress = self.trainer.progress();
        let mut held = Held::Yes;
        if let Some(update) = self.reporter.report(now_ms, &report, progress) {
            held = held_or_unknown(self.lease.progress(&update).await);
        }
        if progress.step.is_multiple_of(self.checkpoint_every) && !self.trainer.is_done() {
            self.checkpoint().await?;
        }
        Ok(held)
    }

    /// Stores a checkpoint. One that cannot be stored is a pity, not the end: the one before still counts.
    async fn checkpoint(&self) -> Result<(), Failure> {
        let step = i64::from(self.trainer.progress().step);
        let bytes = self.trainer.checkpoint()?;
        if let Err(error) = self.lease.checkpoint(step, bytes).await {
            tracing::error!(%error, step, "a checkpoint could not be stored");
            self.tell("a checkpoint could not be stored; training goes on").await;
        }
        Ok(())
    }

    async fn tell(&self, warning: &str) {
        if let Err(error) = self.lease.warn(warning).await {
            tracing::warn!(%error, warning, "a warning could not be recorded");
        }
    }

    /// Leaves the job where another worker finds it.
    async fn suspend(&self) -> Result<Ending, Failure> {
        let step = i64::from(self.trainer.progress().step);
        if step > self.lease.job().checkpoint_step.unwrap_or(0) {
            self.checkpoint().await?;
        }
        match self.lease.release(true).await? {
            Held::Yes => Ok(Ending::Stopped),
            Held::Cancelling | Held::Lost => Ok(settle(self.lease).await?),
        }
    }
}

/// A capture at the resolution it will be trained at, so that memory holds no pixel in vain.
///
/// # Errors
/// What the importer refuses, by file and field.
pub fn import_for_training(path: &Path, config: &TrainConfig) -> Result<Capture, CaptureError> {
    let options =
        ImportOptions { max_side: Some(config.resolution), load_truth: false, ..ImportOptions::default() };
    crate::capture::import(path, &options)
}

/// A capture with the light it is known to have been taken in.
fn lit_capture(path: &Path, config: &TrainConfig, light: Option<&LightSource>) -> Result<Capture, Failure> {
    let capture = import_for_training(path, config);
    let mut capture = capture.map_err(|e| Failure::new(e.code(), e.to_string()))?;
    if let (Some(known), Some(source)) = (&config.light, light) {
        let map =
            source.map().map_err(|e| Failure::new(ENVIRONMENT_MISSING, format!("the known light: {e}")))?;
        if let Some(map) = map {
            known.illuminate(&mut capture, Arc::unwrap_or_clone(map));
        }
    }
    Ok(capture)
}

/// The configuration the job was accepted with.
fn config(lease: &Lease) -> Result<TrainConfig, Failure> {
    let invalid = |e: String| Failure::new("config_invalid", e);
    let job = lease.job();
    let preset: Preset =
        serde_json::from_value(job.preset.clone().into()).map_err(|e| invalid(e.to_string()))?;
    let overrides: TrainOverrides =
        serde_json::from_str(&job.overrides).map_err(|e| invalid(e.to_string()))?;
    TrainConfig::new(preset, &overrides).map_err(|e| invalid(e.to_string()))
}

/// Says what goes on before the first step, keeping what earlier attempts reached.
async fn announce(lease: &Lease, message: &str) -> Result<(), StoreError> {
    let job = lease.job();
    let update = ProgressUpdate {
        step: job.checkpoint_step.unwrap_or(0),
        total: job.total,
        message: Some(message.to_owned()),
        ..ProgressUpdate::default()
    };
    lease.progress(&update).await.map(drop)
}

/// A store that fails for a while, e.g. on a full disk, is no reason to throw hours of training away: whether the
/// lease still stands shows at the next write that succeeds, and nothing is published without one.
fn held_or_unknown(held: Result<Held, StoreError>) -> Held {
    held.unwrap_or_else(|error| {
        tracing::error!(%error, "the store failed under a running job");
        Held::Yes
    })
}

/// Ends an attempt that does not hold a running job any more.
async fn settle(lease: &Lease) -> Result<Ending, StoreError> {
    match lease.check().await? {
        Held::Cancelling => {
            lease.confirm_cancel().await?;
            Ok(Ending::Cancelled)
        }
        Held::Yes | Held::Lost => Ok(Ending::Lost),
    }
}

/// Writes the model's files, then publishes them and ends the job in one transaction.
async fn publish(lease: &Lease, trainer: &Trainer) -> Result<Ending, Failure> {
    let (job, model) = (lease.job(), &trainer.model()?);
    let encoded = model_file::encode(model).map_err(|e| Failure::new("model_invalid", e.to_string()))?;
    let files = [
        store_file(lease, "model.safetensors", "application/octet-stream", encoded).await?,
        store_file(lease, "model.ply", "application/octet-stream", ply_model::encode(model)).await?,
    ];
    let record = ModelRecord {
        id: lease.jobs().fresh_id(),
        job_id: job.id.clone(),
        capture_id: job.capture_id.clone(),
        gaussians: i64::try_from(model.gaussians.len()).unwrap_or(i64::MAX),
        card: timed_card(trainer, model).to_string(),
        created_ms: lease.jobs().now_ms(),
    };
    match lease.publish(&record, &files).await? {
        Held::Yes => Ok(Ending::Published),
        Held::Cancelling | Held::Lost => Ok(settle(lease).await?),
    }
}

/// The model's card with the time it took, which the file leaves out so that its bytes depend on the job alone.
fn timed_card(trainer: &Trainer, model: &Model) -> serde_json::Value {
    let mut card = model.card.clone();
    if let Some(fields) = card.as_object_mut() {
        fields.insert("training_seconds".to_owned(), trainer.seconds().into());
    }
    card
}

async fn store_file(
    lease: &Lease,
    name: &str,
    content_type: &str,
    bytes: Vec<u8>,
) -> Result<ModelFile, StoreError> {
    let artifact = format!("{}/{name}", lease.artifact_prefix());
    let size = i64::try_from(bytes.len()).unwrap_or(i64::MAX);
    let sha256 = lease.jobs().store().artifacts().put(&artifact, bytes).await?;
    Ok(ModelFile {
        name: name.to_owned(),
        content_type: content_type.to_owned(),
        bytes: size,
        sha256,
        artifact,
    })
}
