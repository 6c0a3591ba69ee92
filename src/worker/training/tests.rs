//! The import of a resumed job, and preemption.

use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::AtomicI64;

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

/// A source without jobs. Every query of its clock takes `tick_ms`.
struct NoJobs {
    changes: watch::Sender<()>,
    now_ms: AtomicI64,
    tick_ms: i64,
}

#[async_trait(?Send)]
impl JobSource for NoJobs {
    async fn claim(&self) -> Result<ClaimOutcome, JobSourceError> {
        Ok(ClaimOutcome::Nothing)
    }

    fn changes(&self) -> watch::Receiver<()> {
        self.changes.subscribe()
    }

    fn now_ms(&self) -> i64 {
        self.now_ms.fetch_add(self.tick_ms, Ordering::SeqCst)
    }
}

/// A claim of a job with a capture and perhaps a checkpoint. It accepts every report.
struct FakeClaim {
    task: Task,
    capture: PathBuf,
    checkpoint: Vec<u8>,
    /// Whether another job waits.
    should_yield: bool,
    /// The steps of stored checkpoints, and the reasons for which the job was returned.
    checkpoints: Mutex<Vec<i64>>,
    releases: Mutex<Vec<Release>>,
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

    async fn should_yield(&self) -> Result<bool, JobSourceError> {
        Ok(self.should_yield)
    }

    async fn progress(&self, _: &JobProgress) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }

    async fn warn(&self, _: &str) -> Result<LeaseStatus, JobSourceError> {
        Ok(LeaseStatus::Held)
    }

    async fn checkpoint(&self, step: i64, _: Vec<u8>) -> Result<LeaseStatus, JobSourceError> {
        self.checkpoints.lock().unwrap().push(step);
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

    async fn release(&self, why: Release) -> Result<LeaseStatus, JobSourceError> {
        self.releases.lock().unwrap().push(why);
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

/// A worker whose clock advances by `tick_ms` at every query.
fn worker(tick_ms: i64, once: bool) -> Worker {
    let source = NoJobs { changes: watch::Sender::new(()), now_ms: AtomicI64::new(0), tick_ms };
    let changes = source.changes();
    Worker {
        source: Arc::new(source),
        device: OpenedDevice::cpu(),
        steps: Arc::default(),
        previews: Arc::default(),
        import_limits: ImportLimits::default(),
        changes,
        stop: CancellationToken::new(),
        abandoned: CancellationToken::new(),
        once,
    }
}

/// The first attempt at a job of `iterations` steps.
fn claim(capture: PathBuf, iterations: u32) -> FakeClaim {
    let request = NewJob {
        capture: "capture".into(),
        preset: Preset::Draft,
        overrides: TrainOverrides { iterations: Some(iterations), ..overrides() },
        ..NewJob::default()
    };
    let task = Task {
        job: "job".into(),
        request,
        attempt: 1,
        is_last_attempt: false,
        total: i64::from(iterations),
        checkpoint_step: None,
        traceparent: None,
    };
    let (checkpoints, releases) = (Mutex::default(), Mutex::default());
    FakeClaim { task, capture, checkpoint: Vec::new(), should_yield: false, checkpoints, releases }
}

/// The world and the step with which an attempt begins.
async fn begun(claim: &FakeClaim, config: &TrainConfig) -> (WorldUp, u32) {
    let mut worker = worker(0, false);
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
    let mut claim = claim(path.clone(), 4);
    let request = &claim.task.request;
    let config = TrainConfig::new(request.preset, &request.overrides).unwrap();
    claim.checkpoint = checkpoint(&path, &config);
    claim.task.checkpoint_step = Some(1);
    let (world, step) = begun(&claim, &config).await;
    assert_eq!((world.direction, step), ([0.0, 1.0, 0.0], 1), "resumed, in the world of the checkpoint");
    claim.task.checkpoint_step = None;
    let (world, step) = begun(&claim, &config).await;
    assert_eq!((world, step), (WorldUp::default(), 0), "the control: a new training");
    (claim.task.checkpoint_step, claim.checkpoint) = (Some(1), b"damaged".to_vec());
    let (world, step) = begun(&claim, &config).await;
    assert_eq!((world, step), (WorldUp::default(), 0), "a damaged checkpoint has no world");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_attempt_yields_to_a_waiting_job_after_its_time_slice() {
    let folder = TempDir::new().unwrap();
    let path = capture(&folder);
    let attempt = async |tick_ms, once, should_yield| {
        let mut claim = claim(path.clone(), 40);
        claim.should_yield = should_yield;
        let end = match worker(tick_ms, once).train(&claim).await {
            Ok(end) => end,
            Err(error) => panic!("{}: {}", error.code, error.detail),
        };
        (end, claim.checkpoints.into_inner().unwrap(), claim.releases.into_inner().unwrap())
    };
    let (end, checkpoints, releases) = attempt(10_000, false, true).await;
    assert_eq!((end, releases), (AttemptEnd::Stopped, vec![Release::Preempted]));
    assert!(checkpoints.len() == 1 && (1..40).contains(&checkpoints[0]), "{checkpoints:?}");
    for (tick_ms, once, should_yield, case) in [
        (10_000, false, false, "no job waits"),
        (0, false, true, "the slice is not over"),
        (10_000, true, true, "a worker for a single job"),
    ] {
        let (end, _, releases) = attempt(tick_ms, once, should_yield).await;
        assert_eq!((end, releases), (AttemptEnd::Published, vec![]), "{case}");
    }
}
