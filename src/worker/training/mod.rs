//! One attempt at a job: import, train step by step, checkpoint, compare with held-out views, publish.

mod background;
mod comparison;
mod evaluate;
mod import;
pub(super) mod outcome;
mod preparation;
mod publish;
mod time_budget;
mod time_slice;

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use tracing::{Instrument, Span, info_span};

use crate::worker::job_source::{Claim, JobSource, JobSourceError};
use crate::worker::previews::{Preview, PreviewPublisher};
use crate::worker::progress::ProgressReporter;
use crate::worker::thread::Worker;
use comparison::Comparison;
use import::ImportPlanning;
use outcome::{AttemptEnd, AttemptError, stop_attempt};
use preparation::{last_checkpoint, world_of};
use relume_api::jobs::JobDevice;
use relume_api::work::{LeaseStatus, Release};
use relume_capture::Capture;
use relume_engine::Device;
use relume_scene::Model;
use relume_spec::training::TrainConfig;
use relume_train::Trainer;
use relume_train::time_budget::{Eta, PhotographCost, StepCost};
use time_budget::{AttemptClock, AttemptPacing, planned_before};
use time_slice::TimeSlice;

/// The state of one attempt between steps.
struct TrainingAttempt<'a> {
    source: Arc<dyn JobSource>,
    claim: &'a dyn Claim,
    trainer: Trainer,
    reporter: ProgressReporter,
    /// The plan of a job with a time budget or a stop condition.
    pacing: Option<AttemptPacing>,
    checkpoint_every: u32,
    /// The span of the steps since the last report.
    steps_span: Span,
}

impl Worker {
    /// Runs the attempt until it ends.
    pub(super) async fn train(&mut self, claim: &dyn Claim) -> Result<AttemptEnd, AttemptError> {
        let clock = AttemptClock::start(&self.source);
        let request = &claim.task().request;
        let config = TrainConfig::new(request.preset, &request.overrides)
            .map_err(|error| AttemptError::new("config_invalid", error.to_string()))?;
        let prepared = self.prepared(claim, config, &clock).instrument(info_span!("prepare"));
        let (capture, mut trainer, cost) = match prepared.await? {
            ControlFlow::Continue(prepared) => prepared,
            ControlFlow::Break(ending) => return Ok(ending),
        };
        let (now_ms, step) = (self.source.now_ms(), trainer.progress().step);
        let mut slice = TimeSlice::new(now_ms, clock.ms());
        let mut reporter =
            ProgressReporter::new(Eta::new(trainer.config(), PhotographCost::of(&capture), step, now_ms));
        let checkpoint_every = trainer.config().checkpoint_every.max(1);
        let pacing = AttemptPacing::new(&mut trainer, &capture, clock, cost)?;
        reporter.plan(pacing.as_ref().map(|pacing| pacing.announcement(&trainer)), None);
        let comparison = Comparison::new(Arc::unwrap_or_clone(capture), trainer.config().light_rotations);
        let mut attempt = TrainingAttempt {
            source: self.source.clone(),
            claim,
            trainer,
            reporter,
            pacing,
            checkpoint_every,
            steps_span: Span::none(),
        };
        let shown = self.previews.of(&claim.task().job);
        while !attempt.trainer.is_done() {
            if self.stop.is_cancelled() {
                return attempt.suspend(Release::Shutdown).await;
            }
            // A worker that runs a single job must not leave it unfinished.
            if !self.once && slice.is_over(self.source.now_ms()) && attempt.should_yield().await {
                tracing::info!(
                    step = attempt.trainer.progress().step,
                    "paused, because another job runs first"
                );
                return attempt.suspend(Release::Preempted).await;
            }
            if self.changes.has_changed().unwrap_or(false) {
                self.changes.mark_unchanged();
                if held_or_unknown(claim.check().await) != LeaseStatus::Held {
                    return Ok(stop_attempt(claim).await?);
                }
            }
            let status = attempt.step(self.device_of(claim)?).await?;
            self.steps.fetch_add(1, Ordering::SeqCst);
            if status != LeaseStatus::Held {
                return Ok(stop_attempt(claim).await?);
            }
            if shown.is_due() {
                let model = Arc::new(attempt.trainer.model()?);
                attempt.show(&shown, model);
            }
        }
        let model = Arc::new(attempt.trainer.model()?);
        attempt.show(&shown, model.clone());
        let measured = self.measure(&mut attempt, &model, comparison);
        match measured.instrument(info_span!("evaluate")).await? {
            ControlFlow::Continue(figures) => {
                let published = publish::publish(claim, attempt.trainer.seconds(), &model, figures);
                published.instrument(info_span!("publish")).await
            }
            ControlFlow::Break(ending) => Ok(ending),
        }
    }

    /// Reads the capture and prepares its trainer.
    async fn prepared(
        &mut self,
        claim: &dyn Claim,
        config: TrainConfig,
        clock: &AttemptClock,
    ) -> Result<ControlFlow<AttemptEnd, (Arc<Capture>, Trainer, Option<StepCost>)>, AttemptError> {
        let checkpoint = last_checkpoint(claim).await?;
        let up = world_of(&checkpoint).unwrap_or_else(|| config.up.into());
        let before = planned_before(&checkpoint, &config);
        let cost = match config.time_budget_s {
            Some(_) if before.is_none() => Some(Self::step_cost(self.device_of(claim)?, &config, clock)?),
            _ => None,
        };
        let planning = cost.map(|cost| ImportPlanning { cost, clock: clock.clone() });
        let config = before.unwrap_or(config);
        let import = self.import(claim, config, up, planning).instrument(info_span!("import"));
        let (capture, config) = match import.await? {
            ControlFlow::Continue((capture, config)) => (Arc::new(capture), config),
            ControlFlow::Break(ending) => return Ok(ControlFlow::Break(ending)),
        };
        let trainer = self.trainer(claim, &capture, config, checkpoint);
        let trainer = trainer.instrument(info_span!("dataset")).await?;
        Ok(trainer.map_continue(|trainer| (capture, trainer, cost)))
    }

    /// The device of a job.
    pub(in crate::worker) fn device_of(&self, claim: &dyn Claim) -> Result<&Device, AttemptError> {
        match (claim.task().request.device, self.device()) {
            (JobDevice::Cpu, _) => Ok(&Device::Cpu),
            (JobDevice::Gpu, Device::Cpu) => Err(AttemptError::new("device_unfit", "this worker has no GPU")),
            (_, device) => Ok(device),
        }
    }
}

impl TrainingAttempt<'_> {
    /// Takes one step on `device` and reports it.
    async fn step(&mut self, device: &Device) -> Result<LeaseStatus, AttemptError> {
        if self.steps_span.is_none() {
            let first = self.trainer.progress().step + 1;
            self.steps_span = info_span!("steps", first, last = tracing::field::Empty);
        }
        let report = self.steps_span.in_scope(|| self.trainer.step())?;
        if let Some(pacing) = &mut self.pacing {
            let (told, seconds_left) = pacing.after_step(&mut self.trainer, device)?;
            self.reporter.plan(told, seconds_left);
        }
        metrics::counter!("relume_training_steps_total").increment(1);
        if let Some(warning) = &report.warning {
            self.record_warning(warning).await;
        }
        let progress = self.trainer.progress();
        let mut status = LeaseStatus::Held;
        let now_ms = self.source.now_ms();
        if let Some(update) = self.reporter.report(now_ms, &report, progress) {
            self.steps_span.record("last", progress.step);
            self.steps_span = Span::none();
            status = held_or_unknown(self.claim.progress(&update).await);
        }
        if progress.step.is_multiple_of(self.checkpoint_every) && !self.trainer.is_done() {
            self.checkpoint().await?;
        }
        Ok(status)
    }

    /// Stores a checkpoint. If this fails, the previous checkpoint is kept. On a full disk the attempt ends, so that no more
    /// progress is lost; after other failures the training continues.
    async fn checkpoint(&mut self) -> Result<(), AttemptError> {
        let bytes = self.trainer.checkpoint()?;
        // Read after the checkpoint, because a step that was not finite may have been rolled back.
        let step = i64::from(self.trainer.progress().step);
        self.store_checkpoint(step, bytes).instrument(info_span!("checkpoint", step)).await
    }

    async fn store_checkpoint(&mut self, step: i64, bytes: Vec<u8>) -> Result<(), AttemptError> {
        match self.claim.checkpoint(step, bytes).await {
            Ok(_) => {}
            Err(error @ JobSourceError::Full) => return Err(error.into()),
            Err(error) => {
                tracing::error!(%error, step, "cannot store a checkpoint");
                self.record_warning("a checkpoint could not be stored; the training continues").await;
            }
        }
        Ok(())
    }

    /// Publishes the current model as a preview.
    fn show(&self, shown: &PreviewPublisher, model: Arc<Model>) {
        let (step, is_relightable) = (self.trainer.progress().step, self.trainer.is_relightable());
        shown.show(Preview { step, model, is_relightable });
    }

    async fn record_warning(&self, warning: &str) {
        if let Err(error) = self.claim.warn(warning).await {
            tracing::warn!(%error, warning, "cannot record a warning");
        }
    }

    /// Whether another job should run before this one.
    async fn should_yield(&self) -> bool {
        self.claim.should_yield().await.unwrap_or_else(|error| {
            tracing::error!(%error, "the job source failed during a job; the training continues");
            false
        })
    }

    /// Stores a checkpoint and returns the job to the queue.
    async fn suspend(&mut self, why: Release) -> Result<AttemptEnd, AttemptError> {
        let step = i64::from(self.trainer.progress().step);
        if step > self.claim.task().checkpoint_step.unwrap_or(0) {
            self.checkpoint().await?;
        }
        match self.claim.release(why).await? {
            LeaseStatus::Held => Ok(AttemptEnd::Stopped),
            LeaseStatus::Cancelling | LeaseStatus::Lost => Ok(stop_attempt(self.claim).await?),
        }
    }
}

/// A temporary failure of the source, e.g. on a full disk, must not discard the training. The next successful write shows whether
/// the lease is still held, and nothing is published without a lease.
fn held_or_unknown(status: Result<LeaseStatus, JobSourceError>) -> LeaseStatus {
    status.unwrap_or_else(|error| {
        tracing::error!(%error, "the job source failed during a job; the training continues");
        LeaseStatus::Held
    })
}

#[cfg(test)]
mod tests;
