//! `relume bench queue`: measures the throughput of the job queue with workers that do no training, and the database size per
//! job.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use futures::future::try_join_all;
use tempfile::TempDir;
use tokio::task::JoinHandle;

use crate::cli::bench::quantiles::Quantiles;
use crate::cli::bench::table::{head, publish, row};
use crate::cli::error::CommandResult;
use crate::jobs::{Jobs, LeasePolicy, Origin, RandomIds, SystemClock};
use crate::store::{CaptureRecord, DatabaseUrl, Filter, LeaseStatus, ModelRecord, Page, Store, StoreError};
use relume_api::jobs::{JobProgress, NewJob};
use relume_api::metadata::ResourceMetadata;
use relume_api::quality::Figures;
use relume_api::{CaptureId, TenantId};
use relume_spec::CaptureReport;

/// Tasks that submit jobs.
const CLIENTS: u64 = 16;
/// Steps of each job.
const STEPS: i64 = 100;
/// Time between two requests for the list of jobs.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
const COLUMNS: [&str; 5] = ["times", "per second", "p50, ms", "p99, ms", "worst, ms"];

/// Options of `relume bench queue`.
#[derive(Debug, clap::Args)]
pub(super) struct QueueArgs {
    /// Number of jobs.
    #[arg(long, default_value_t = 10_000, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    jobs: u64,
    /// Number of concurrent workers.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1024))]
    workers: u32,
    /// Progress reports per job.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(i64).range(0..=1000))]
    reports: i64,
    /// An empty PostgreSQL database, `postgres://user:password@host:5432/name`. Default: a SQLite file in a temporary folder.
    #[arg(long, env = "RELUME_DATABASE_URL", hide_env_values = true, value_name = "URL")]
    database_url: Option<DatabaseUrl>,
    /// Also write the table to this file.
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &QueueArgs) -> CommandResult {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let text = runtime.block_on(measure(args))?;
    Ok(publish(&text, args.out.as_deref())?)
}

async fn measure(args: &QueueArgs) -> CommandResult<String> {
    let folder = TempDir::new()?;
    let store = Store::open_with(folder.path(), args.database_url.as_ref()).await?;
    let before = store.database_size().await?;
    let jobs = Jobs::new(store.clone(), Arc::new(SystemClock), Arc::new(RandomIds), LeasePolicy::default());
    let capture = insert_capture(&store).await?;
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let mut text = format!(
        "{}; {threads} threads; {} jobs, {} workers, {} reports of progress each.\n\n{}",
        store.database_version().await?,
        args.jobs,
        args.workers,
        args.reports,
        head(&["operation"], COLUMNS)
    );
    eprintln!("submitting");
    let submitted = Stopwatch::begin();
    let share = |client: u64| args.jobs / CLIENTS + u64::from(client < args.jobs % CLIENTS);
    let clients = (0..CLIENTS).map(|client| submit(jobs.clone(), capture.clone(), share(client)));
    text += &submitted.end(&[("submit", try_join_all(clients).await?)]);
    eprintln!("working");
    let (worked, done) = (Stopwatch::begin(), Arc::new(AtomicBool::new(false)));
    let looking = poll_jobs(jobs.clone(), done.clone());
    let published = Arc::new(AtomicU64::new(0));
    let workers =
        (0..args.workers).map(|_| tokio::spawn(work(jobs.clone(), args.reports, published.clone())));
    let times = try_join_all(workers).await?.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut by_operation: [Vec<Vec<f64>>; 3] = Default::default();
    for worker in times {
        for (all, own) in by_operation.iter_mut().zip(worker) {
            all.push(own);
        }
    }
    let [claims, reports, ends] = by_operation;
    text += &worked.end(&[("claim", claims), ("progress", reports), ("publish", ends)]);
    done.store(true, Ordering::SeqCst);
    text += &worked.end(&[("list of 50 jobs", vec![looking.await??])]);
    let count = published.load(Ordering::SeqCst);
    if count != args.jobs {
        return Err(format!("{count} of {} jobs were published", args.jobs).into());
    }
    let bytes = store.database_size().await?.saturating_sub(before);
    store.close().await;
    Ok(text + &format!("\n{} bytes of the database a job.\n", bytes / args.jobs))
}

/// The start time of a measurement.
struct Stopwatch(Instant);

impl Stopwatch {
    fn begin() -> Self {
        Self(Instant::now())
    }

    /// Table rows of the operations since the start, from their times in milliseconds.
    fn end(&self, operations: &[(&str, Vec<Vec<f64>>)]) -> String {
        let seconds = self.0.elapsed().as_secs_f64();
        let line = |(name, times): &(&str, Vec<Vec<f64>>)| {
            let times = Quantiles::of(times.concat());
            let ms = |share| times.at(share).map_or("-".to_owned(), |ms| format!("{ms:.2}"));
            let rate = format!("{:.0}", times.count() as f64 / seconds);
            row([(*name).to_owned(), times.count().to_string(), rate, ms(0.5), ms(0.99), ms(1.0)])
        };
        operations.iter().map(line).collect()
    }
}

fn elapsed_ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

async fn insert_capture(store: &Store) -> Result<CaptureId, StoreError> {
    let id = CaptureId::from(uuid::Uuid::now_v7().to_string());
    let capture = CaptureRecord {
        id: id.clone(),
        sha256: id.to_string(),
        bytes: 0,
        artifact: "captures/none".to_owned(),
        made_of: None,
        metadata: ResourceMetadata::default(),
        report: CaptureReport::default(),
        created_ms: 0,
    };
    store.insert_capture(&TenantId::of_operator(), &capture, None).await?;
    Ok(id)
}

/// Submits jobs one after the other. Returns the milliseconds of each request.
async fn submit(jobs: Jobs, capture: CaptureId, count: u64) -> Result<Vec<f64>, StoreError> {
    let mut times = Vec::new();
    for _ in 0..count {
        let (begin, request) = (Instant::now(), NewJob { capture: capture.clone(), ..NewJob::default() });
        jobs.submit(&TenantId::of_operator(), request, STEPS, Origin::default(), None, |_, _| String::new())
            .await?;
        times.push(elapsed_ms(begin));
    }
    Ok(times)
}

/// Claims jobs until the queue is empty. Returns the milliseconds of each claim, report and publication.
async fn work(jobs: Jobs, reports: i64, published: Arc<AtomicU64>) -> Result<[Vec<f64>; 3], StoreError> {
    let mut times: [Vec<f64>; 3] = Default::default();
    loop {
        let begin = Instant::now();
        let Some(lease) = jobs.claim().await? else { return Ok(times) };
        times[0].push(elapsed_ms(begin));
        for report in 1..=reports {
            let (begin, step) = (Instant::now(), STEPS * report / reports);
            lease.progress(&JobProgress { step, total: STEPS, ..JobProgress::default() }).await?;
            times[1].push(elapsed_ms(begin));
        }
        let model = ModelRecord {
            id: jobs.fresh_id(),
            job_id: lease.job().id.clone(),
            capture_id: lease.job().request.capture.clone(),
            gaussians: 1,
            metadata: ResourceMetadata::default(),
            card: serde_json::Value::Null,
            created_ms: jobs.now_ms(),
        };
        let begin = Instant::now();
        let status = lease.publish(&model, &[], Figures::default()).await?;
        times[2].push(elapsed_ms(begin));
        published.fetch_add(u64::from(status == LeaseStatus::Held), Ordering::SeqCst);
    }
}

/// Requests the newest 50 jobs periodically until `done` is set. Returns the milliseconds of each request.
fn poll_jobs(jobs: Jobs, done: Arc<AtomicBool>) -> JoinHandle<Result<Vec<f64>, StoreError>> {
    tokio::spawn(async move {
        let mut times = Vec::new();
        while !done.load(Ordering::SeqCst) {
            let (begin, page) = (Instant::now(), Page { limit: 50, before: None });
            let listed = jobs.list(&TenantId::of_operator(), None, &Filter::default(), &page).await?;
            jobs.positions(&listed).await?;
            times.push(elapsed_ms(begin));
            tokio::time::sleep(POLL_INTERVAL).await;
        }
        Ok(times)
    })
}
