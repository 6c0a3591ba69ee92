//! Workers that are killed at random moments, and a server that comes and goes: every job ends once, with the bytes of an undisturbed
//! run, and nothing is left.

use std::collections::BTreeSet;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, SystemTime};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use relume::api::JobId;
use relume::api::jobs::JobState;
use relume::client::Client;
use relume::testing::{database_name, database_of, spawn_with};
use tempfile::TempDir;

use crate::s3::bucket::Bucket;
use crate::service_support::open_store;
use crate::workers::fleet::{Process, model_hash, short_job, undisturbed, upload, without_workers};

const WORKERS: usize = 3;
const SEED: u64 = 23;

/// Jobs of a run: `RELUME_CHAOS_JOBS`, or a dozen.
fn count() -> usize {
    std::env::var("RELUME_CHAOS_JOBS").ok().and_then(|text| text.parse().ok()).unwrap_or(12)
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_end_once_and_with_the_same_bytes_whatever_is_killed() {
    let data = run(None).await;
    let data = spawn_with(data, without_workers).await.unwrap().stop().await.unwrap();
    let mut files = Vec::new();
    list(&data.path().join("artifacts"), &mut files);
    assert_eq!(files.len(), 1 + 2 * count(), "the capture, and two files a job: {files:?}");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_and_s3_jobs_end_once_whatever_is_killed_or_cut() {
    let bucket = Bucket::start().await;
    let data = run(Some(&bucket)).await;
    let store = open_store(data.path()).await.with_artifacts(&bucket.place()).unwrap();
    let after_a_day = SystemTime::now() + Duration::from_secs(25 * 3600);
    store.settle_artifacts(after_a_day).await.unwrap();
    let keys = bucket.keys();
    assert_eq!(keys.len(), 1 + 2 * count(), "the capture, and two files a job: {keys:?}");
}

/// Jobs under workers that are killed and a server that comes and goes, on a bucket that fails now and then where there is one. Returns
/// the server's data directory.
async fn run(bucket: Option<&Bucket>) -> TempDir {
    let expected = undisturbed(short_job).await;
    let (data, folder, count) = (TempDir::new().unwrap(), TempDir::new().unwrap(), count());
    let address = free_address();
    let client = Client::new(&format!("http://{address}"), None).unwrap();
    let mut server = start(&address, data.path(), &client, bucket).await;
    let capture = upload(&client).await;
    let mut jobs = Vec::new();
    for _ in 0..count {
        jobs.push(client.create_job(&short_job(&capture), None).await.unwrap().id);
    }
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let folders: Vec<_> = (0..WORKERS).map(|i| folder.path().join(i.to_string())).collect();
    let begin = |i: usize| Process::start(&client, &folders[i], &[]);
    let mut workers: Vec<Process> = (0..WORKERS).map(begin).collect();
    let (mut kills, mut restarts) = (0, 0);
    while running(&client, &jobs).await > 0 {
        tokio::time::sleep(Duration::from_millis(random.random_range(300..2000))).await;
        if let Some(bucket) = bucket {
            fail_now_and_then(bucket, &mut random);
        }
        match random.random_range(0..=WORKERS) {
            WORKERS => {
                drop(server);
                tokio::time::sleep(Duration::from_millis(300)).await;
                server = start(&address, data.path(), &client, bucket).await;
                restarts += 1;
            }
            victim => {
                // What runs there is killed as it is dropped.
                workers[victim] = begin(victim);
                kills += 1;
            }
        }
    }
    assert!(kills >= 3 && restarts >= 1, "{kills} kills and {restarts} restarts: too few to tell");
    let mut models = BTreeSet::new();
    for id in &jobs {
        assert_eq!(model_hash(&client, id).await, expected);
        let job = client.job(id).await.unwrap();
        assert_eq!(job.state, JobState::Succeeded);
        models.insert(job.model.unwrap());
    }
    assert_eq!(models.len(), count, "each job has a model of its own");
    data
}

/// One kind of fault for the next requests.
fn fail_now_and_then(bucket: &Bucket, random: &mut ChaCha8Rng) {
    let faults = &bucket.faults;
    let fault = [&faults.refused, &faults.cut, &faults.flipped, &faults.unanswered];
    faults.set(fault[random.random_range(0..fault.len())], random.random_range(0..3));
}

/// Jobs that have not ended.
async fn running(client: &Client, jobs: &[JobId]) -> usize {
    let mut open = 0;
    for id in jobs {
        open += usize::from(!client.job(id).await.unwrap().state.is_terminal());
    }
    open
}

fn free_address() -> String {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string()
}

/// A server process at an address, which dies when it is dropped.
async fn start(address: &str, data: &Path, client: &Client, bucket: Option<&Bucket>) -> Process {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.args(["serve", "--no-worker", "--worker-silence", "2", "--max-attempts", "1000"]);
    command.args(["--listen", address, "--data-dir"]).arg(data).env_remove("RELUME_API_KEY");
    if let Some(bucket) = bucket {
        command.envs(bucket.settings()).env("RELUME_ARTIFACTS", Bucket::url());
    }
    if let Some(database) = postgres_url(data).await {
        command.args(["--database-url", &database]);
    }
    let server = Process(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap());
    for _ in 0..600 {
        if client.workers().await.is_ok() {
            return server;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("the server does not start");
}

/// Where the database of a data directory is, unless it is a file in there.
async fn postgres_url(data: &Path) -> Option<String> {
    let url = std::env::var("RELUME_TEST_POSTGRES").ok()?;
    database_of(data).await.unwrap();
    let (server, _) = url.rsplit_once('/')?;
    Some(format!("{server}/{}", database_name(data)))
}

fn list(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { list(&path, files) } else { files.push(path) }
    }
}
