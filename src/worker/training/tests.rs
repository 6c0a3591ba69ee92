//! The import of a resumed job.

use std::path::PathBuf;

use async_trait::async_trait;
use tempfile::TempDir;
use tokio::sync::watch;
use tokio_util::bytes::Bytes;
use tokio_util::sync::CancellationToken;

use super::*;
use crate::worker::job_source::{ClaimOutcome, TrainedModel};
use crate::worker::opened_device::OpenedDevice;
use relume_api::EnvironmentId;
use relume_api::jobs::{JobProgress, NewJob};
use relume_api::work::Task;
use relume_capture::formats::image_file::encode_png;
use relume_capture::{ImportLimits, WorldUp};
use relume_fixtures::small_set;
use relume_spec::training::{Preset, TrainOverrides, UpAxis};
use relume_train::{MemoryBudget, import_in_world};

/// A source without jobs.
struct NoJobs(watch::Sender<()>);

#[async_trait(?Send)]
impl JobSource for NoJobs {
    async fn claim(&self) -> Result<ClaimOutcome, JobSourceError> {
        Ok(ClaimOutcome::Nothing)
    }

    fn changes(&self) -> watch::Receiver<()> {
        self.0.subscribe()
    }

    fn now_ms(&self) -> i64 {
        0
    }
}

/// A claim of a job with a capture and perhaps a checkpoint. It accepts every report.
struct FakeClaim {
    task: Task,
    capture: PathBuf,
    checkpoint: Vec<u8>,
}

#[async_trait(?Send)]
impl Claim for FakeClaim {
    fn task(&self) -> &Task {
        &self.task
    }

    async fn capture(&self) -> Result<PathBuf, JobSourceError> {
        Ok(self.capture.clone())
    }

    async fn environment(&self, _: &EnvironmentId) -> Result<(PathBuf, String), JobSourceError> {
        Err(JobSourceError::Gone)
    }

    async fn last_checkpoint(&self) -> Result<Bytes, JobSourceError> {
        Ok(self.checkpoint.clone().into())
    }

    async fn check(&self) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }

    async fn progress(&self, _: &JobProgress) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }

    async fn warn(&self, _: &str) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }

    async fn checkpoint(&self, _: i64, _: Vec<u8>) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }

    async fn publish(&self, _: TrainedModel) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }

    async fn fail(&self, _: &str, _: &str) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }

    async fn confirm_cancel(&self) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }

    async fn release(&self, _: Release) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }
}

/// A NeRF-synthetic capture of 32 x 32 pixels, which has +Z up unless a caller states another axis.
fn capture(folder: &TempDir) -> PathBuf {
    let pixel = |i: usize, p: usize| [(40 * i + p / 8) as u8, (p % 200) as u8, 90, 255];
    let picture =
        |i: usize| encode_png(32, 32, &(0..32 * 32).map(|p| pixel(i, p)).collect::<Vec<_>>()).unwrap();
    let mut files = small_set::blender();
    (0..4).for_each(|i| drop(files.insert(format!("train/r_{i}.png"), picture(i))));
    let path = folder.path().join("capture.zip");
    std::fs::write(&path, small_set::zip(&files)).unwrap();
    path
}

fn overrides() -> TrainOverrides {
    TrainOverrides {
        resolution: Some(16),
        iterations: Some(4),
        warm_up: Some(0.0),
        initial_gaussians: Some(64),
        max_gaussians: Some(64),
        ..TrainOverrides::default()
    }
}

/// A checkpoint after one step of a training whose world has another up direction than its settings give, as one of another
/// version of the program.
fn checkpoint(capture: &std::path::Path, config: &TrainConfig) -> Vec<u8> {
    let (limits, budget) = (ImportLimits::default(), MemoryBudget::unbounded());
    let capture = import_in_world(capture, config, UpAxis::Y.into(), &limits, budget).unwrap();
    let mut trainer = Trainer::new(&capture, config.clone(), &Device::Cpu).unwrap();
    trainer.step().unwrap();
    trainer.checkpoint().unwrap()
}

/// The world and the step with which an attempt begins.
async fn begun(claim: &FakeClaim, config: &TrainConfig) -> (WorldUp, u32) {
    let source = NoJobs(watch::Sender::new(()));
    let changes = source.changes();
    let mut worker = Worker {
        source: Arc::new(source),
        device: OpenedDevice::cpu(),
        steps: Arc::default(),
        previews: Arc::default(),
        import_limits: ImportLimits::default(),
        changes,
        stop: CancellationToken::new(),
        abandoned: CancellationToken::new(),
        once: false,
    };
    let clock = AttemptClock::start(&worker.source);
    match worker.prepared(claim, config.clone(), &clock).await {
        Ok(ControlFlow::Continue((capture, trainer, _))) => (capture.up.clone(), trainer.progress().step),
        Ok(ControlFlow::Break(ending)) => panic!("{ending:?}"),
        Err(error) => panic!("{}: {}", error.code, error.detail),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn resumed_job_imports_in_the_world_of_its_checkpoint() {
    let folder = TempDir::new().unwrap();
    let path = capture(&folder);
    let request = NewJob {
        capture: "capture".into(),
        preset: Preset::Draft,
        overrides: overrides(),
        ..NewJob::default()
    };
    let config = TrainConfig::new(request.preset, &request.overrides).unwrap();
    let task = Task {
        job: "job".into(),
        request,
        attempt: 2,
        is_last_attempt: false,
        total: 4,
        checkpoint_step: Some(1),
        traceparent: None,
    };
    let mut claim = FakeClaim { task, checkpoint: checkpoint(&path, &config), capture: path };
    let (world, step) = begun(&claim, &config).await;
    assert_eq!((world.direction, step), ([0.0, 1.0, 0.0], 1), "resumed, in the world of the checkpoint");
    claim.task.checkpoint_step = None;
    let (world, step) = begun(&claim, &config).await;
    assert_eq!((world, step), (WorldUp::default(), 0), "the control: a new training");
    (claim.task.checkpoint_step, claim.checkpoint) = (Some(1), b"damaged".to_vec());
    let (world, step) = begun(&claim, &config).await;
    assert_eq!((world, step), (WorldUp::default(), 0), "a damaged checkpoint has no world");
}
