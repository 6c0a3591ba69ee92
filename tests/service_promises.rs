//! The guarantees of the service, one test each, on the queue and the store.

use std::sync::Arc;
use std::time::Duration;

use relume::jobs::{Jobs, Lease, LeasePolicy, ManualClock, Origin, SequentialIds};
use relume::store::{
    CancelOutcome, CaptureRecord, Filter, IdempotencyKey, LeaseStatus, ModelFile, ModelRecord, Page, Release,
    StoreError, Submitted,
};
use relume::testing;
use relume_api::jobs::{JobProgress, JobState, NewJob};
use relume_api::metadata::ResourceMetadata;
use relume_api::quality::{Figures, QualityGate};
use relume_api::{JobId, TenantId};
use relume_spec::CaptureReport;
use tempfile::TempDir;

use crate::service_support::{capture_zip, ended, files_under, open_store, raw_pool, small_job, until};

/// A queue with its own clock and one capture.
pub struct Bench {
    pub jobs: Jobs,
    pub clock: Arc<ManualClock>,
    dir: TempDir,
}

/// The tenant of all resources.
fn tenant() -> TenantId {
    TenantId::of_operator()
}

const LEASE: Duration = Duration::from_secs(60);

impl Bench {
    pub async fn new() -> Self {
        let bench = Self::open(TempDir::new().unwrap()).await;
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
        bench.jobs.store().insert_capture(&tenant(), &capture, None).await.unwrap();
        bench
    }

    async fn open(dir: TempDir) -> Self {
        let clock = Arc::new(ManualClock::default());
        let store = open_store(dir.path()).await;
        let policy = LeasePolicy { duration: LEASE, max_idle_attempts: 3, ..LeasePolicy::default() };
        let jobs = Jobs::new(store, clock.clone(), Arc::new(SequentialIds::default()), policy);
        Self { jobs, clock, dir }
    }

    pub async fn submit(&self, priority: i64) -> JobId {
        self.submit_with(priority, None).await.unwrap()
    }

    /// Submits a job with a quality gate on one figure.
    pub async fn submit_asking(&self, figure: &str, wanted: &str) -> JobId {
        let quality_gate = QualityGate([(figure.to_owned(), wanted.to_owned())].into());
        let job = NewJob { capture: "capture".into(), quality_gate, ..NewJob::default() };
        match self
            .jobs
            .submit(&tenant(), job, 100, Origin::default(), None, |job, _| job.id.to_string())
            .await
            .unwrap()
        {
            Submitted::Created(id) | Submitted::Replayed(id) => id.into(),
        }
    }

    /// Submits a job with the identifier as the answer.
    async fn submit_with(&self, priority: i64, key: Option<&IdempotencyKey>) -> Result<JobId, StoreError> {
        let job = NewJob { capture: "capture".into(), priority, ..NewJob::default() };
        match self
            .jobs
            .submit(&tenant(), job, 100, Origin::default(), key, |job, _| job.id.to_string())
            .await?
        {
            Submitted::Created(id) | Submitted::Replayed(id) => Ok(id.into()),
        }
    }

    pub async fn claim(&self) -> Lease {
        self.jobs.claim().await.unwrap().expect("a job waits")
    }

    async fn state(&self, id: &JobId) -> JobState {
        self.jobs.store().job(&tenant(), id).await.unwrap().unwrap().state
    }
}

fn model_of(lease: &Lease, id: &str) -> (ModelRecord, Vec<ModelFile>) {
    let model = ModelRecord {
        id: id.into(),
        job_id: lease.job().id.clone(),
        capture_id: "capture".into(),
        gaussians: 1,
        metadata: ResourceMetadata::default(),
        card: serde_json::json!({}),
        created_ms: 0,
    };
    let file = ModelFile {
        name: "model.safetensors".into(),
        content_type: "application/octet-stream".into(),
        bytes: 1,
        sha256: "00".into(),
        artifact: format!("{}/model.safetensors", lease.artifact_prefix()),
    };
    (model, vec![file])
}

pub async fn publish(lease: &Lease, id: &str) -> LeaseStatus {
    let (model, files) = model_of(lease, id);
    lease.publish(&model, &files, Figures::default()).await.unwrap()
}

#[tokio::test]
async fn a_paused_worker_that_lost_its_lease_publishes_nothing() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    let paused = bench.claim().await;
    bench.clock.advance(LEASE + Duration::from_millis(1));
    assert_eq!(bench.jobs.reclaim_expired().await.unwrap().len(), 1);
    let second = bench.claim().await;

    let progress = JobProgress { step: 99, total: 100, ..JobProgress::default() };
    assert_eq!(paused.progress(&progress).await.unwrap(), LeaseStatus::Lost);
    assert_eq!(paused.checkpoint(99, vec![1]).await.unwrap(), LeaseStatus::Lost);
    assert_eq!(paused.warn("of the paused").await.unwrap(), LeaseStatus::Lost);
    assert_eq!(paused.fail("x", "y").await.unwrap(), LeaseStatus::Lost);
    assert_eq!(paused.release(Release::Shutdown).await.unwrap(), LeaseStatus::Lost);
    assert_eq!(publish(&paused, "from-the-paused").await, LeaseStatus::Lost);
    assert!(
        bench
            .jobs
            .store()
            .models(&tenant(), &Filter::default(), &Page { limit: 10, before: None })
            .await
            .unwrap()
            .is_empty()
    );
    let job = bench.jobs.store().job(&tenant(), &id).await.unwrap().unwrap();
    assert_eq!((job.state, job.progress.step, job.checkpoint), (JobState::Running, 0, None));
    let events = bench.jobs.events_after(&tenant(), &id, 0).await.unwrap();
    assert!(events.iter().all(|event| event.kind == "state"), "nor does it tell anything: {events:?}");

    // Negative control: the same calls with a valid lease have an effect.
    assert_eq!(second.progress(&progress).await.unwrap(), LeaseStatus::Held);
    assert_eq!(publish(&second, "from-the-second").await, LeaseStatus::Held);
    assert_eq!(bench.state(&id).await, JobState::Succeeded);
}

#[tokio::test]
async fn cancelling_a_queued_job_removes_its_checkpoint() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    let lease = bench.claim().await;
    lease.checkpoint(10, vec![1; 100]).await.unwrap();
    lease.release(Release::Shutdown).await.unwrap();
    assert_eq!(files_under(bench.dir.path()).len(), 1);
    bench.jobs.cancel(&tenant(), &id).await.unwrap();
    assert!(files_under(bench.dir.path()).is_empty());
}

#[tokio::test]
async fn a_job_waiting_for_disk_space_reports_it_and_uses_no_attempt() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    for _ in 0..10 {
        let lease = bench.claim().await;
        lease.progress(&JobProgress { step: 15, total: 100, ..JobProgress::default() }).await.unwrap();
        assert_eq!(lease.release(Release::NoRoom).await.unwrap(), LeaseStatus::Held);
    }
    let job = bench.jobs.store().job(&tenant(), &id).await.unwrap().unwrap();
    assert_eq!((job.state, job.progress.step, job.idle_attempts), (JobState::Queued, 0, 0));
    assert_eq!(job.progress.message.as_deref(), Some("waiting for disk space"));
    let lease = bench.claim().await;
    lease.checkpoint(10, vec![1; 100]).await.unwrap();
    lease.release(Release::NoRoom).await.unwrap();
    assert_eq!(bench.jobs.store().job(&tenant(), &id).await.unwrap().unwrap().progress.step, 10);
    bench.jobs.store().disk_space().note_shortage(1 << 60);
    assert!(matches!(bench.submit_with(0, None).await, Err(StoreError::NoDiskSpace { .. })));
    bench.jobs.store().disk_space().forget_shortage();
    bench.submit(0).await;
}

#[tokio::test]
async fn a_job_publishes_exactly_once() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    let lease = bench.claim().await;
    assert_eq!(publish(&lease, "first").await, LeaseStatus::Held);
    assert_eq!(publish(&lease, "again").await, LeaseStatus::Lost);
    let models = bench
        .jobs
        .store()
        .models(&tenant(), &Filter::default(), &Page { limit: 10, before: None })
        .await
        .unwrap();
    assert_eq!(models.iter().map(|m| m.id.as_str()).collect::<Vec<_>>(), ["first"]);
    assert_eq!(bench.jobs.store().job(&tenant(), &id).await.unwrap().unwrap().model_id, Some("first".into()));
}

#[tokio::test]
async fn terminal_states_never_change() {
    let bench = Bench::new().await;
    for end in [JobState::Succeeded, JobState::Rejected, JobState::Failed, JobState::Cancelled] {
        let id = match end {
            JobState::Rejected => bench.submit_asking("novel_view.psnr", ">=28").await,
            _ => bench.submit(0).await,
        };
        let lease = bench.claim().await;
        match end {
            JobState::Succeeded | JobState::Rejected => publish(&lease, id.as_str()).await,
            JobState::Failed => lease.fail("code", "detail").await.unwrap(),
            _ => {
                bench.jobs.cancel(&tenant(), &id).await.unwrap();
                lease.confirm_cancel().await.unwrap()
            }
        };
        assert_eq!(bench.state(&id).await, end);
        let before = bench.jobs.events_after(&tenant(), &id, 0).await.unwrap();
        let cancelled = bench.jobs.cancel(&tenant(), &id).await.unwrap();
        assert_eq!(matches!(cancelled, CancelOutcome::Accepted(_)), end == JobState::Cancelled);
        assert_eq!(lease.fail("other", "other").await.unwrap(), LeaseStatus::Lost);
        assert_eq!(lease.release(Release::Shutdown).await.unwrap(), LeaseStatus::Lost);
        assert!(!bench.jobs.set_priority(&tenant(), &id, 5).await.unwrap());
        bench.jobs.reclaim_all().await.unwrap();
        assert_eq!(bench.state(&id).await, end);
        assert_eq!(bench.jobs.events_after(&tenant(), &id, 0).await.unwrap(), before, "and nothing was told");
    }
}

#[tokio::test]
async fn database_constraints_reject_changes_of_terminal_states() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    bench.jobs.cancel(&tenant(), &id).await.unwrap();
    let pool = raw_pool(bench.dir.path()).await;
    let forced = sqlx::query("UPDATE jobs SET state = 'queued'").execute(&pool).await;
    assert!(forced.unwrap_err().to_string().contains("terminal"));
    sqlx::query("UPDATE jobs SET priority = 7").execute(&pool).await.unwrap();
}

#[tokio::test]
async fn a_job_that_always_crashes_fails_with_attempts_exhausted() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    for _ in 0..3 {
        bench.claim().await;
        bench.jobs.reclaim_all().await.unwrap();
    }
    let job = bench.jobs.store().job(&tenant(), &id).await.unwrap().unwrap();
    assert_eq!((job.state, job.error_code.as_deref()), (JobState::Failed, Some("attempts_exhausted")));
}

#[tokio::test]
async fn a_job_with_new_checkpoints_may_crash_any_number_of_times() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    for step in 1..=10 {
        let lease = bench.claim().await;
        assert_eq!(lease.checkpoint(step, vec![step as u8]).await.unwrap(), LeaseStatus::Held);
        bench.jobs.reclaim_all().await.unwrap();
    }
    let job = bench.jobs.store().job(&tenant(), &id).await.unwrap().unwrap();
    assert_eq!((job.state, job.checkpoint_step, job.attempts), (JobState::Queued, Some(10), 10));
    let kept = files_under(&bench.dir.path().join("artifacts"));
    assert_eq!(kept.len(), 1, "a checkpoint replaces the one before: {kept:?}");
}

#[tokio::test]
async fn a_second_checkpoint_at_a_step_does_not_damage_the_first() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    let lease = bench.claim().await;
    lease.checkpoint(5, vec![1]).await.unwrap();
    bench.jobs.reclaim_all().await.unwrap();
    // As at a shutdown directly afterwards, by a worker that was suspended in between.
    assert_eq!(lease.checkpoint(5, vec![2]).await.unwrap(), LeaseStatus::Lost);
    let job = bench.jobs.store().job(&tenant(), &id).await.unwrap().unwrap();
    let (key, sha256) = (job.checkpoint.unwrap(), job.checkpoint_sha256.unwrap());
    bench.jobs.store().artifacts().verify(&key, &sha256).await.unwrap();
    assert_eq!(files_under(&bench.dir.path().join("artifacts")).len(), 1, "the other one is gone");
}

#[tokio::test]
async fn a_finished_job_keeps_no_checkpoint() {
    let bench = Bench::new().await;
    bench.submit(0).await;
    let lease = bench.claim().await;
    lease.checkpoint(1, vec![1]).await.unwrap();
    assert_eq!(files_under(&bench.dir.path().join("artifacts")).len(), 1);
    assert_eq!(publish(&lease, "model").await, LeaseStatus::Held);
    assert!(files_under(&bench.dir.path().join("artifacts")).is_empty());
}

#[tokio::test]
async fn a_release_at_shutdown_uses_no_attempt() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    for _ in 0..10 {
        assert_eq!(bench.claim().await.release(Release::Shutdown).await.unwrap(), LeaseStatus::Held);
    }
    assert_eq!(bench.state(&id).await, JobState::Queued);
}

#[tokio::test]
async fn higher_priority_runs_first_and_equals_run_in_order() {
    let bench = Bench::new().await;
    let mut ids = Vec::new();
    for priority in [0, 5, 0, 5] {
        ids.push(bench.submit(priority).await);
        bench.clock.advance(Duration::from_millis(1));
    }
    let position = async |id: &JobId| bench.jobs.get(&tenant(), id).await.unwrap().unwrap().1.unwrap();
    assert_eq!([position(&ids[1]).await, position(&ids[3]).await, position(&ids[0]).await], [0, 1, 2]);
    assert!(bench.jobs.set_priority(&tenant(), &ids[2], 9).await.unwrap());
    let mut order = Vec::new();
    for _ in 0..4 {
        order.push(bench.claim().await.job().id.clone());
    }
    assert_eq!(order, [&ids[2], &ids[1], &ids[3], &ids[0]].map(JobId::clone));
    assert!(bench.jobs.claim().await.unwrap().is_none());
}

#[tokio::test]
async fn queue_positions_are_counted_up_to_1000() {
    let bench = Bench::new().await;
    let (first, second) = (bench.submit(0).await, bench.submit(0).await);
    let raw = raw_pool(bench.dir.path()).await;
    let copies = "INSERT INTO jobs (id, tenant, capture_id, preset, overrides, device, priority, state, created_ms, total)
         WITH RECURSIVE numbers (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM numbers WHERE n < 1500)
         SELECT CONCAT('between-', n), tenant, capture_id, preset, overrides, device, 0, state, 0, total
         FROM jobs, numbers WHERE id = $1";
    sqlx::query(copies).bind(first.as_str()).execute(&raw).await.unwrap();
    bench.clock.advance(Duration::from_secs(1));
    let last = bench.submit(0).await;
    let page = Page { limit: 3, before: None };
    let listed = bench.jobs.list(&tenant(), None, &Filter::default(), &page).await.unwrap();
    let positions = bench.jobs.positions(&listed).await.unwrap();
    assert_eq!(positions[&last], 1000, "there are 1,502 before it");
    let one = async |id: &JobId| bench.jobs.get(&tenant(), id).await.unwrap().unwrap().1;
    assert_eq!(one(&last).await, Some(1000));
    assert!(bench.jobs.set_priority(&tenant(), &second, 1).await.unwrap());
    assert_eq!((one(&second).await, one(&last).await), (Some(0), Some(1000)));
    assert!(bench.jobs.set_priority(&tenant(), &last, 2).await.unwrap());
    assert_eq!((one(&last).await, one(&second).await), (Some(0), Some(1)), "the control");
}

#[tokio::test]
async fn a_reused_idempotency_key_with_another_body_is_refused() {
    let bench = Bench::new().await;
    let key = |f: &str| IdempotencyKey { key: "k".into(), fingerprint: f.into() };
    let (one, two) = (key("a"), key("a"));
    let (first, second) = tokio::join!(bench.submit_with(0, Some(&one)), bench.submit_with(0, Some(&two)));
    assert_eq!(first.unwrap(), second.unwrap());
    let refused = bench.submit_with(0, Some(&key("b"))).await;
    assert!(matches!(refused, Err(StoreError::IdempotencyKeyReused)));
    assert_eq!(
        bench
            .jobs
            .list(&tenant(), None, &Filter::default(), &Page { limit: 10, before: None })
            .await
            .unwrap()
            .len(),
        1
    );
    bench.clock.advance(Duration::from_secs(25 * 3600));
    bench.submit_with(0, Some(&key("b"))).await.expect("a key is forgotten after a day");
}

#[tokio::test]
async fn event_numbers_increase_and_survive_a_restart() {
    let bench = Bench::new().await;
    let id = bench.submit(0).await;
    bench.claim().await.warn("look out").await.unwrap();
    let before = bench.jobs.events_after(&tenant(), &id, 0).await.unwrap();
    bench.jobs.store().close().await;
    let bench = Bench::open(bench.dir).await;
    bench.jobs.reclaim_all().await.unwrap();
    let after = bench.jobs.events_after(&tenant(), &id, 0).await.unwrap();
    assert_eq!(after[..before.len()], before);
    assert_eq!(after.len(), before.len() + 1, "and going back to the queue was told");
    assert!(after.windows(2).all(|pair| pair[0].seq < pair[1].seq));
    let tail = bench.jobs.events_after(&tenant(), &id, before.last().unwrap().seq).await.unwrap();
    assert_eq!(tail, after[before.len()..], "a listener goes on where it stopped");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_acknowledged_upload_byte_is_on_disk() {
    let server = testing::spawn().await.unwrap();
    let zip = capture_zip();
    let capture = server.client().upload_capture_bytes(zip.clone()).await.unwrap();
    let path = server.data_dir().join("artifacts/captures").join(&capture.sha256);
    assert_eq!(std::fs::read(path).unwrap(), zip);
    assert_eq!(capture.bytes, zip.len() as i64);
}

#[tokio::test(flavor = "multi_thread")]
async fn cancelling_a_running_job_starts_the_next_one() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let long = client.create_job(&small_job(&capture.id, 1_000_000, 1000), None).await.unwrap();
    until(client, &long.id, |job| job.state == JobState::Running && job.progress.step > 0).await;
    let next = client.create_job(&small_job(&capture.id, 3, 5), None).await.unwrap();
    assert_eq!(next.queue_position, Some(0));
    let asked = client.cancel_job(&long.id).await.unwrap();
    assert!(matches!(asked.state, JobState::Cancelling | JobState::Cancelled));
    assert_eq!(ended(client, &long.id).await.state, JobState::Cancelled);
    assert_eq!(ended(client, &next.id).await.state, JobState::Succeeded);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shutdown_writes_a_checkpoint_and_a_restart_resumes_from_it() {
    let server = testing::spawn().await.unwrap();
    let capture = server.client().upload_capture_bytes(capture_zip()).await.unwrap();
    let job = server.client().create_job(&small_job(&capture.id, 200, 100_000), None).await.unwrap();
    let seen = until(server.client(), &job.id, |job| job.progress.step > 0).await;
    let data = server.stop().await.unwrap();
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    let events = history(&server, &job.id).await;
    let checkpoint = events.iter().find(|e| e.kind == "checkpoint").expect("the shutdown made a checkpoint");
    assert!(checkpoint.data["step"].as_i64().unwrap() >= seen.progress.step);
    let done = ended(server.client(), &job.id).await;
    assert_eq!((done.state, done.attempts), (JobState::Succeeded, 2));
}

/// The complete history of a job.
async fn history(server: &testing::TestServer, id: &JobId) -> Vec<relume_client::JobEvent> {
    let mut events = Vec::new();
    server.client().wait(id, |event| events.push(event.clone())).await.unwrap();
    events
}

#[tokio::test(flavor = "multi_thread")]
async fn thumbnails_are_served_while_a_job_trains() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = crate::service_support::trained(client).await.model.unwrap();
    let capture = client.captures().await.unwrap().items.remove(0);
    let long = client.create_job(&small_job(&capture.id, 1_000_000, 1000), None).await.unwrap();
    until(client, &long.id, |job| job.progress.step > 0).await;
    client.thumbnail(&model, "env=studio&size=32").await.unwrap();
    assert_eq!(client.job(&long.id).await.unwrap().state, JobState::Running, "it was not waited for");
    client.cancel_job(&long.id).await.unwrap();
    ended(client, &long.id).await;
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn two_servers_never_share_a_data_directory() {
    let server = testing::spawn().await.unwrap();
    server.client().models().await.unwrap();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let config = relume::server::ServerConfig::new(server.data_dir());
    let refused = relume::server::run(config, listener, async {}).await.unwrap_err();
    assert!(refused.to_string().contains("in use by another server"), "{refused}");
}

#[tokio::test]
async fn a_server_without_a_key_refuses_to_listen_beyond_loopback() {
    let dir = TempDir::new().unwrap();
    let listener = tokio::net::TcpListener::bind("0.0.0.0:0").await.unwrap();
    let config = relume::server::ServerConfig::new(dir.path());
    let refused = relume::server::run(config, listener, async {}).await.unwrap_err();
    assert!(matches!(refused, relume::server::ServeError::Exposed(_)), "{refused}");
    assert!(!dir.path().join("relume.db").exists());
}
