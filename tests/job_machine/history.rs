//! One history: the same operations on the queue and on the model, with a comparison after each.

use std::sync::Arc;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use relume::jobs::{Jobs, Lease, LeasePolicy, ManualClock, Origin, SequentialIds};
use relume::store::{
    CancelOutcome, CaptureRecord, Deletion, IdempotencyKey, LeaseStatus, ModelRecord, Release, Store,
    StoreError, Submitted,
};
use relume_api::jobs::{JobProgress, JobState, NewJob};
use relume_api::metadata::ResourceMetadata;
use relume_api::quality::{Figures, QualityGate};
use relume_api::{JobId, ResourceKind, ResourceName, TenantId};
use relume_spec::CaptureReport;
use serde_json::Value;
use sqlx::AnyPool;
use tempfile::TempDir;

use super::model::{Answer, Claim, Event, Job, LEASE_MS, MOST_IDLE, Model, Submission, TOTAL, Wrong};
use crate::service_support::{files_under, on_postgres, open_store, raw_pool};

/// Number of operations of a history.
const STEPS: usize = 12;
const WORKERS: usize = 3;

/// A database in which histories run one after another.
pub struct Bench {
    store: Store,
    clock: Arc<ManualClock>,
    ids: Arc<SequentialIds>,
    /// The test's own connections to the database.
    pool: AnyPool,
    /// Number of the last compared event.
    last_event: i64,
    dir: TempDir,
}

/// A row of the jobs table.
#[derive(sqlx::FromRow)]
struct Row {
    id: String,
    state: String,
    priority: i64,
    attempts: i64,
    idle: i64,
    step: i64,
    checkpoint: Option<i64>,
    error: Option<String>,
    deleted: i64,
    leased: i64,
    models: i64,
}

struct History<'a> {
    bench: &'a mut Bench,
    jobs: Jobs,
    model: Model,
    /// Identifiers of the model's jobs.
    ids: Vec<JobId>,
    /// The current or last lease of each worker.
    workers: [Option<(Lease, Claim)>; WORKERS],
    random: ChaCha8Rng,
    /// The operations so far, for the failure message.
    log: Vec<String>,
    /// The final state of each job that has ended.
    ends: Vec<Option<JobState>>,
}

/// The tenant of all resources.
fn tenant() -> TenantId {
    TenantId::of_operator()
}

/// An error that names the difference, if the values differ.
fn same<T: PartialEq + std::fmt::Debug>(what: &str, found: T, expected: T) -> Result<(), String> {
    if found == expected {
        return Ok(());
    }
    Err(format!("{what}: the queue has {found:?}, the model {expected:?}"))
}

fn failed(error: impl std::fmt::Display) -> String {
    format!("an error: {error}")
}

impl Bench {
    pub async fn new() -> Self {
        // In memory if possible; other tests cover the disk.
        let dir = TempDir::new_in("/dev/shm").or_else(|_| TempDir::new()).unwrap();
        let store = open_store(dir.path()).await;
        let capture = CaptureRecord {
            id: "capture".into(),
            sha256: "00".into(),
            bytes: 1,
            artifact: "captures/00".into(),
            metadata: ResourceMetadata::default(),
            report: CaptureReport::default(),
            made_of: None,
            created_ms: 0,
        };
        store.insert_capture(&tenant(), &capture, None).await.unwrap();
        let pool = raw_pool(dir.path()).await;
        let (clock, ids) = (Arc::default(), Arc::default());
        Self { store, clock, ids, pool, last_event: 0, dir }
    }

    fn queue(&self) -> Jobs {
        let duration = Duration::from_millis(LEASE_MS.unsigned_abs());
        let max_idle_attempts = u32::try_from(MOST_IDLE).unwrap();
        let policy = LeasePolicy { duration, max_idle_attempts, ..LeasePolicy::default() };
        Jobs::new(self.store.clone(), self.clock.clone(), self.ids.clone(), policy)
    }

    /// Runs one history. The error names the difference and the operations before it.
    pub async fn history(&mut self, seed: u64, wrong: Option<Wrong>) -> Result<(), String> {
        let jobs = self.queue();
        let model = Model::new(wrong, jobs.now_ms());
        let random = ChaCha8Rng::seed_from_u64(seed);
        let workers = [const { None }; WORKERS];
        let (ids, log, ends) = (Vec::new(), Vec::new(), Vec::new());
        let mut history = History { bench: self, jobs, model, ids, workers, random, log, ends };
        let ran = history.run().await;
        let told = ran.map_err(|difference| format!("{difference}\nafter {}", history.log.join("\n      ")));
        self.forget().await;
        told
    }

    /// Deletes everything except the capture.
    async fn forget(&self) {
        let all = "DELETE FROM events; DELETE FROM model_files; DELETE FROM models; DELETE FROM jobs;
                   DELETE FROM idempotency;";
        sqlx::raw_sql(all).execute(&self.pool).await.unwrap();
        std::fs::remove_dir_all(self.dir.path().join("artifacts/attempts")).ok();
    }
}

impl History<'_> {
    async fn run(&mut self) -> Result<(), String> {
        for step in 0..STEPS {
            match if step == 0 { 0 } else { self.random.random_range(0..100) } {
                0..16 => self.submit().await?,
                16..36 => self.claim().await?,
                36..72 => self.work().await?,
                72..80 => self.cancel().await?,
                80..84 => self.delete().await?,
                84..88 => self.set_priority().await?,
                88..94 => self.pass_time().await?,
                _ => self.restart().await?,
            }
            self.compare().await?;
        }
        self.compare_files()
    }

    fn any_job(&mut self) -> usize {
        self.random.random_range(0..self.ids.len())
    }

    async fn submit(&mut self) -> Result<(), String> {
        let keys = [None, None, Some(("k", "a")), Some(("k", "b")), Some(("l", "a"))];
        let key = keys[self.random.random_range(0..keys.len())];
        let (priority, gated) = (self.random.random_range(-1..=1), self.random.random_bool(0.3));
        let ended = |job: &usize| self.model.jobs[*job].state.is_terminal();
        let again: Vec<usize> = (0..self.ids.len()).filter(ended).collect();
        let retry = (!again.is_empty() && self.random.random_bool(0.5))
            .then(|| again[self.random.random_range(0..again.len())]);
        self.log.push(format!("submit priority {priority} gated {gated} key {key:?} again {retry:?}"));

        let gate = [("novel_view.psnr".to_owned(), ">=28".to_owned())];
        let quality_gate = QualityGate(gate.into_iter().filter(|_| gated).collect());
        let request = NewJob { capture: "capture".into(), priority, quality_gate, ..NewJob::default() };
        let key_of =
            |(key, request): (&str, &str)| IdempotencyKey { key: key.into(), fingerprint: request.into() };
        let sent = key.map(key_of);
        let origin = Origin { retry_of: retry.map(|job| self.ids[job].clone()), ..Origin::default() };
        let id = |job: &relume::store::JobRecord, _| job.id.to_string();
        let submitted = self.jobs.submit(&tenant(), request, TOTAL, origin, sent.as_ref(), id).await;
        let expected = self.model.submit(priority, gated, key, retry);
        let found = match submitted {
            Ok(Submitted::Created(id)) => {
                self.ids.push(id.into());
                self.ends.push(None);
                Submission::Created
            }
            Ok(Submitted::Replayed(id)) => {
                let job = self.ids.iter().position(|known| known.as_str() == id);
                Submission::Replayed(job.ok_or("an answer of another history")?)
            }
            Err(StoreError::IdempotencyKeyReused) => Submission::IdempotencyKeyReused,
            Err(StoreError::Deleted(_)) => Submission::PredecessorDeleted,
            Err(error) => return Err(failed(error)),
        };
        same("the submission", found, expected)
    }

    async fn claim(&mut self) -> Result<(), String> {
        let worker = self.random.random_range(0..WORKERS);
        self.log.push(format!("worker {worker} claims"));
        let lease = self.jobs.claim().await.map_err(failed)?;
        let expected = self.model.claim();
        let place = |lease: &Lease| {
            let job = self.ids.iter().position(|id| *id == lease.job().id);
            job.map(|job| Claim { job, attempt: lease.job().attempts })
        };
        same("the claim", lease.as_ref().and_then(place), expected)?;
        if let (Some(lease), Some(claim)) = (lease, expected) {
            self.workers[worker] = Some((lease, claim));
        }
        Ok(())
    }

    /// Performs an operation of a worker with its current or last lease.
    async fn work(&mut self) -> Result<(), String> {
        let worker = self.random.random_range(0..WORKERS);
        let Some((lease, claim)) = &self.workers[worker] else { return Ok(()) };
        let (claim, model) = (*claim, &mut self.model);
        let step = self.random.random_range(1..TOTAL);
        let act = self.random.random_range(0..9);
        let done = [
            "progress",
            "checkpoint",
            "same checkpoint",
            "warn",
            "release",
            "fail",
            "publish",
            "publish",
            "stop",
        ][act];
        self.log.push(format!("worker {worker} on {claim:?}: {done} {step}"));
        let (found, expected) = match act {
            0 => {
                let progress = JobProgress { step, total: TOTAL, ..JobProgress::default() };
                (lease.progress(&progress).await, model.progress(claim, step))
            }
            1 => (lease.checkpoint(step, vec![1; 9]).await, model.checkpoint(claim, step)),
            // As at a shutdown directly after a checkpoint.
            2 => {
                let step = model.jobs[claim.job].checkpoint.unwrap_or(step);
                (lease.checkpoint(step, vec![2; 9]).await, model.checkpoint(claim, step))
            }
            3 => (lease.warn("look out").await, model.warn(claim)),
            4 => {
                let all = [
                    Release::Shutdown,
                    Release::NoRoom,
                    Release::AttemptFailed,
                    Release::Outage,
                    Release::Preempted,
                ];
                let why = all[step as usize % all.len()];
                (lease.release(why).await, model.release(claim, why))
            }
            5 => (lease.fail("broken", "it broke").await, model.end(claim, Some("broken"))),
            6 | 7 => {
                let psnr = [20.0, 30.0][step as usize % 2];
                let name = format!("model-{}-{}", self.log.len(), lease.job().id);
                (publish(lease, &name, psnr).await, model.publish(claim, psnr))
            }
            _ => (lease.confirm_cancel().await, model.end(claim, None)),
        };
        same("the answer to the worker", found.map_err(failed)?, expected)
    }

    async fn cancel(&mut self) -> Result<(), String> {
        let job = self.any_job();
        self.log.push(format!("cancel {job}"));
        let found = match self.jobs.cancel(&tenant(), &self.ids[job]).await.map_err(failed)? {
            CancelOutcome::Accepted(_) => Answer::Done,
            CancelOutcome::AlreadyFinished(_) => Answer::TooLate,
            CancelOutcome::NotFound => Answer::NotFound,
        };
        same("the cancellation", found, self.model.cancel(job))
    }

    async fn delete(&mut self) -> Result<(), String> {
        let (job, cascade) = (self.any_job(), self.random.random_bool(0.5));
        self.log.push(format!("delete {job} cascade {cascade}"));
        let name = ResourceName::new(ResourceKind::Job, self.ids[job].as_str());
        let found = match self.jobs.delete(&tenant(), &name, cascade).await.map_err(failed)? {
            Deletion::Done => Answer::Done,
            Deletion::InUse(_) => Answer::TooLate,
            Deletion::NotFound => Answer::NotFound,
        };
        same("the deletion", found, self.model.delete(job, cascade))
    }

    async fn set_priority(&mut self) -> Result<(), String> {
        let (job, priority) = (self.any_job(), self.random.random_range(-2..=2));
        self.log.push(format!("priority of {job} is {priority}"));
        let found = self.jobs.set_priority(&tenant(), &self.ids[job], priority).await.map_err(failed)?;
        same("the change of priority", found, self.model.set_priority(job, priority))
    }

    /// Advances the clock by less than a lease, exactly a lease, 1 ms more, or more than a day; then reclaims
    /// expired leases.
    async fn pass_time(&mut self) -> Result<(), String> {
        let by = [LEASE_MS / 2, LEASE_MS, LEASE_MS + 1, 25 * 3600 * 1000][self.random.random_range(0..4)];
        self.log.push(format!("{by} ms pass"));
        self.bench.clock.advance(Duration::from_millis(by.unsigned_abs()));
        self.model.now_ms += by;
        let taken = self.jobs.reclaim_expired().await.map_err(failed)?.len();
        same("the leases that ran out", taken, self.model.reclaim(false))
    }

    /// Another server takes over. The workers of the previous server have not noticed yet.
    async fn restart(&mut self) -> Result<(), String> {
        self.log.push("restart".to_owned());
        self.jobs = self.bench.queue();
        let taken = self.jobs.reclaim_all().await.map_err(failed)?.len();
        same("the leases of the server before", taken, self.model.reclaim(true))
    }

    async fn compare(&mut self) -> Result<(), String> {
        self.compare_jobs().await?;
        self.compare_events().await?;
        let mut holders = vec![0; self.ids.len()];
        for (lease, claim) in self.workers.iter().flatten() {
            let found = lease.check().await.map_err(failed)?;
            holders[claim.job] += usize::from(found != LeaseStatus::Lost);
            same("a lease", found, self.model.status(*claim))?;
        }
        same("more than one lease on a job", holders.iter().any(|count| *count > 1), false)
    }

    async fn compare_jobs(&mut self) -> Result<(), String> {
        let query = "SELECT id, state, priority, attempts, idle_attempts AS idle, step, checkpoint_step AS checkpoint,
                         error_code AS error, CASE WHEN deleted_ms IS NULL THEN 0 ELSE 1 END AS deleted,
                         CASE WHEN lease_token IS NULL THEN 0 ELSE 1 END AS leased,
                         (SELECT COUNT(*) FROM models WHERE job_id = jobs.id) AS models
                     FROM jobs ORDER BY id";
        let rows: Vec<Row> = sqlx::query_as(query).fetch_all(&self.bench.pool).await.map_err(failed)?;
        same("the jobs", rows.len(), self.ids.len())?;
        for (job, row) in rows.into_iter().enumerate() {
            same("the order of jobs", row.id.as_str(), self.ids[job].as_str())?;
            let state = JobState::ALL.into_iter().find(|state| state.name() == row.state);
            let state = state.ok_or("a state that there is not")?;
            same("a state that was terminal", state, self.ends[job].unwrap_or(state))?;
            self.ends[job] = Some(state).filter(|state| state.is_terminal());
            same("more than one model", row.models > 1, false)?;
            let (deleted, leased) = (row.deleted == 1, row.leased == 1);
            let Row { priority, attempts, idle, step, checkpoint, error, models, .. } = row;
            let found =
                Job { state, priority, attempts, idle, step, checkpoint, error, deleted, leased, models };
            same(&format!("job {job}"), &found, &self.model.jobs[job])?;
        }
        Ok(())
    }

    /// The events since the last comparison: numbered without gaps, and equal to those of the model.
    async fn compare_events(&mut self) -> Result<(), String> {
        let query = "SELECT seq, job_id, kind, data FROM events WHERE seq > $1 ORDER BY seq";
        let query = sqlx::query_as(query).bind(self.bench.last_event);
        let rows: Vec<(i64, String, String, String)> =
            query.fetch_all(&self.bench.pool).await.map_err(failed)?;
        let mut found: Vec<Event> = Vec::new();
        for (number, id, kind, data) in rows {
            let data: Value = serde_json::from_str(&data).map_err(failed)?;
            let state = data["state"].as_str().map(str::to_owned);
            // PostgreSQL skips the numbers of events that were rolled back.
            let next = if on_postgres() { number } else { self.bench.last_event + 1 };
            same("the number of an event", (number, number > self.bench.last_event), (next, true))?;
            self.bench.last_event = number;
            let job = self.ids.iter().position(|known| known.as_str() == id);
            found.push((job.ok_or("an event of another history")?, kind, state));
        }
        let mut expected = std::mem::take(&mut self.model.events);
        // The events of leases that are reclaimed together have any order; the events of each job keep
        // theirs.
        found.sort_by_key(|event| event.0);
        expected.sort_by_key(|event| event.0);
        same("the events", found, expected)
    }

    /// One checkpoint on disk for each job that can resume from one, none for jobs that have ended.
    fn compare_files(&self) -> Result<(), String> {
        let files = files_under(&self.bench.dir.path().join("artifacts"));
        for (job, id) in self.ids.iter().enumerate() {
            let Some(keeps) = self.model.keeps_file(job) else { continue };
            let prefix = format!("attempts/{id}/");
            let count = files.iter().filter(|(name, _)| name.starts_with(&prefix)).count();
            same(&format!("checkpoints of job {job}"), count, usize::from(keeps))?;
        }
        Ok(())
    }
}

async fn publish(lease: &Lease, id: &str, psnr: f64) -> Result<LeaseStatus, StoreError> {
    let model = ModelRecord {
        id: id.into(),
        job_id: lease.job().id.clone(),
        capture_id: "capture".into(),
        gaussians: 1,
        metadata: ResourceMetadata::default(),
        card: serde_json::json!({}),
        created_ms: 0,
    };
    let mut figures = Figures::default();
    figures.novel_view.psnr = Some(psnr);
    lease.publish(&model, &[], figures).await
}
