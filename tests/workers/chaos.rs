//! Workers that are killed at random moments, a server and a database that restart, an object store that
//! fails, wrong clocks: every job ends once, with the bytes of an undisturbed run, and no files are left
//! over.

use std::collections::BTreeSet;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, SystemTime};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use relume::testing::{database_name, database_of, spawn_with};
use relume_api::JobId;
use relume_api::jobs::JobState;
use relume_client::Client;
use tempfile::TempDir;

use crate::s3::bucket::Bucket;
use crate::service_support::open_store;
use crate::workers::fleet::{Process, model_hash, short_job, undisturbed, upload, without_workers};

const WORKERS: usize = 3;
const SEED: u64 = 23;
/// Offset of a wrong clock.
const AHEAD: &str = "+7m";
const BEHIND: &str = "-5m";

/// Number of jobs of a run: `RELUME_CHAOS_JOBS`, or twelve.
fn count() -> usize {
    std::env::var("RELUME_CHAOS_JOBS").ok().and_then(|text| text.parse().ok()).unwrap_or(12)
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_end_once_with_the_same_bytes_despite_kills() {
    let data = run(None).await;
    let data = spawn_with(data, without_workers).await.unwrap().stop().await.unwrap();
    let mut files = Vec::new();
    list(&data.path().join("artifacts"), &mut files);
    assert_eq!(files.len(), 1 + 2 * count(), "the capture, and two files a job: {files:?}");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs libfaketime, and a PostgreSQL of its own: RELUME_POSTGRES_RESTARTS=1 .ci/postgres"]
async fn on_postgres_and_s3_jobs_end_once_despite_kills_and_faults() {
    let bucket = Bucket::start().await;
    let data = run(Some(&bucket)).await;
    let store = open_store(data.path()).await.with_artifacts(&bucket.place()).unwrap();
    let after_a_day = SystemTime::now() + Duration::from_secs(25 * 3600);
    store.reconcile_artifacts(after_a_day).await.unwrap();
    let keys = bucket.keys();
    assert_eq!(keys.len(), 1 + 2 * count(), "the capture, and two files a job: {keys:?}");
}

/// The processes that are killed while jobs run.
struct Fleet<'a> {
    address: String,
    data: TempDir,
    client: Client,
    bucket: Option<&'a Bucket>,
    folders: Vec<PathBuf>,
    workers: Vec<Process>,
    server: Option<Process>,
    /// A program that restarts PostgreSQL as after a crash; `None` for SQLite.
    restart_database: Option<PathBuf>,
    random: ChaCha8Rng,
    /// The order of the victims: each once, in random order, then again.
    victims: Vec<usize>,
}

/// The numbers of kills.
#[derive(Debug, Default)]
struct Deaths {
    workers: u32,
    servers: u32,
    databases: u32,
}

impl<'a> Fleet<'a> {
    async fn start(bucket: Option<&'a Bucket>, folder: &Path) -> Self {
        let address = free_address();
        let mut fleet = Self {
            client: Client::new(&format!("http://{address}"), None).unwrap(),
            address,
            data: TempDir::new().unwrap(),
            bucket,
            folders: (0..WORKERS).map(|i| folder.join(i.to_string())).collect(),
            workers: Vec::new(),
            server: None,
            restart_database: bucket.is_some().then(restart_of_postgres),
            random: ChaCha8Rng::seed_from_u64(SEED),
            victims: Vec::new(),
        };
        fleet.start_server().await;
        fleet.workers = (0..WORKERS).map(|i| fleet.worker(i)).collect();
        fleet
    }

    /// A worker process. On a database with its own clock, the clock of the first worker is wrong by minutes.
    fn worker(&self, i: usize) -> Process {
        let clock = if i == 0 && self.bucket.is_some() { wrong_clock(AHEAD) } else { Vec::new() };
        Process::start_with(&self.client, &self.folders[i], &[], clock)
    }

    /// A server process, which is killed on drop. On a database with its own clock, the clock of the server
    /// is behind.
    async fn start_server(&mut self) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
        command.args(["serve", "--no-worker", "--worker-silence", "2", "--max-attempts", "1000"]);
        command.args(["--listen", &self.address, "--data-dir"]).arg(self.data.path());
        command.env_remove("RELUME_API_KEY");
        if let Some(bucket) = self.bucket {
            command.envs(bucket.settings()).env("RELUME_ARTIFACTS", Bucket::url());
            command.envs(wrong_clock(BEHIND));
        }
        if let Some(database) = postgres_url(self.data.path()).await {
            command.args(["--database-url", &database]);
        }
        self.server = Some(Process(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()));
        for _ in 0..600 {
            if self.client.workers().await.is_ok() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        panic!("the server does not start");
    }

    /// Kills one process and starts it again.
    async fn harm(&mut self, deaths: &mut Deaths) {
        if let Some(bucket) = self.bucket {
            fail_now_and_then(bucket, &mut self.random);
        }
        if self.victims.is_empty() {
            self.victims = (0..WORKERS + 1 + usize::from(self.restart_database.is_some())).collect();
        }
        let victim = self.victims.swap_remove(self.random.random_range(0..self.victims.len()));
        match (victim, &self.restart_database) {
            (WORKERS, _) => {
                self.server = None;
                tokio::time::sleep(Duration::from_millis(300)).await;
                self.start_server().await;
                deaths.servers += 1;
            }
            (victim, Some(restart)) if victim > WORKERS => {
                let restart = restart.clone();
                let status = tokio::task::spawn_blocking(move || Command::new(restart).status());
                assert!(status.await.unwrap().unwrap().success(), "PostgreSQL starts again");
                deaths.databases += 1;
            }
            (victim, _) => {
                // The previous worker is killed on drop.
                self.workers[victim] = self.worker(victim);
                deaths.workers += 1;
            }
        }
    }

    /// Number of jobs that are not known to have ended.
    async fn running(&self, jobs: &[JobId]) -> usize {
        let mut open = 0;
        for id in jobs {
            // The server may still be starting.
            let has_ended = self.client.job(id).await.is_ok_and(|job| job.state.is_terminal());
            open += usize::from(!has_ended);
        }
        open
    }
}

/// Runs jobs while processes are killed; if present, also on a bucket with occasional faults, and on a
/// database that crashes, with wrong clocks. Returns the server's data directory.
async fn run(bucket: Option<&Bucket>) -> TempDir {
    let expected = undisturbed(short_job).await;
    let folder = TempDir::new().unwrap();
    let mut fleet = Fleet::start(bucket, folder.path()).await;
    let capture = upload(&fleet.client).await;
    let mut jobs = Vec::new();
    for _ in 0..count() {
        jobs.push(fleet.client.create_job(&short_job(&capture), None).await.unwrap().id);
    }
    let mut deaths = Deaths::default();
    while fleet.running(&jobs).await > 0 {
        tokio::time::sleep(Duration::from_millis(fleet.random.random_range(300..2000))).await;
        fleet.harm(&mut deaths).await;
    }
    println!("{} jobs: {deaths:?}", jobs.len());
    assert!(deaths.workers >= 3 && deaths.servers >= 1, "{deaths:?}: too few to tell");
    assert!(bucket.is_none() || deaths.databases >= 1, "{deaths:?}: too few to tell");
    let mut models = BTreeSet::new();
    for id in &jobs {
        assert_eq!(model_hash(&fleet.client, id).await, expected);
        let job = fleet.client.job(id).await.unwrap();
        assert_eq!(job.state, JobState::Succeeded);
        models.insert(job.model.unwrap());
    }
    assert_eq!(models.len(), jobs.len(), "each job has a model of its own");
    fleet.data
}

/// The environment of a program whose clock is wrong by `offset`, for libfaketime. The monotonic clock is
/// correct.
fn wrong_clock(offset: &str) -> Vec<(&'static str, String)> {
    let libraries = std::fs::read_dir("/usr/lib").unwrap().filter_map(Result::ok);
    let mut found = libraries.map(|folder| folder.path().join("faketime/libfaketime.so.1"));
    let library = found.find(|path| path.exists()).expect("libfaketime is installed");
    let settings = [
        ("LD_PRELOAD", library.display().to_string()),
        ("FAKETIME", offset.to_owned()),
        ("FAKETIME_DONT_FAKE_MONOTONIC", "1".to_owned()),
        ("FAKETIME_DISABLE_SHM", "1".to_owned()),
    ];
    settings.into()
}

#[test]
#[ignore = "needs libfaketime"]
fn simulated_clock_skew_takes_effect() {
    let now = |settings: Vec<(&'static str, String)>| -> i64 {
        let said = Command::new("date").arg("+%s").envs(settings).output().unwrap().stdout;
        String::from_utf8(said).unwrap().trim().parse().unwrap()
    };
    let right = now(Vec::new());
    assert!((now(wrong_clock(AHEAD)) - right - 7 * 60).abs() < 30);
    assert!((now(wrong_clock(BEHIND)) - right + 5 * 60).abs() < 30);
}

/// The program that restarts the PostgreSQL server of the test.
fn restart_of_postgres() -> PathBuf {
    let program = std::env::var_os("RELUME_TEST_POSTGRES_RESTART");
    program.expect("a PostgreSQL of its own: RELUME_POSTGRES_RESTARTS=1 .ci/postgres").into()
}

/// Sets one kind of fault for the next requests.
fn fail_now_and_then(bucket: &Bucket, random: &mut ChaCha8Rng) {
    let faults = &bucket.faults;
    let fault = [&faults.refused, &faults.cut, &faults.flipped, &faults.unanswered];
    faults.set(fault[random.random_range(0..fault.len())], random.random_range(0..3));
}

fn free_address() -> String {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string()
}

/// The URL of the database of a data directory; `None` for SQLite.
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
