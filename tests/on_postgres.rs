//! Behaviour of a server on PostgreSQL only. The tests need a PostgreSQL server (`.ci/postgres`), on which
//! the tests of the service can also run.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use futures::future::join_all;
use relume::jobs::{Jobs, LeasePolicy, Origin, RandomIds, SystemClock};
use relume::server::{ServeError, ServerConfig, WebhookPolicy};
use relume::store::{self, CopiedTable, DatabaseLocation, DatabaseUrl, StoreError};
use relume::testing::{self, database_name, database_of};
use relume_api::TenantId;
use relume_api::jobs::{JobState, NewJob};
use relume_client::Client;
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_support::{
    capture_zip, ended, files_under, open_store, raw_pool, small_job, trained, until,
};

/// The database of a data directory.
async fn database(data: &Path) -> DatabaseUrl {
    database_of(data).await.unwrap().expect("RELUME_TEST_POSTGRES, as .ci/postgres sets it")
}

/// Waits until a server answers from its database.
async fn answers(client: &Client) {
    for _ in 0..600 {
        if client.models().await.is_ok() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("the server never answered");
}

/// The answers of a server about all its resources.
async fn told(client: &Client) -> Vec<Value> {
    let mut answers = Vec::new();
    for path in ["/v1/captures", "/v1/environments", "/v1/jobs", "/v1/models", "/v1/webhooks"] {
        let answer = client.request(Method::GET, path).unwrap().send().await.unwrap();
        answers.push(answer.json().await.unwrap());
    }
    answers
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_database_copy_round_trips_and_needs_empty_target() {
    let data = TempDir::new().unwrap();
    let hooks = WebhookPolicy { allow_http: true, allow_private: true, ..WebhookPolicy::default() };
    let change = |config: &mut ServerConfig| {
        config.database = None;
        config.webhooks = hooks;
    };
    let server = testing::spawn_with(data, change).await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 3, 2), None).await.unwrap();
    assert_eq!(ended(client, &job.id).await.state, JobState::Succeeded);
    let hook = json!({ "url": "http://127.0.0.1:9/", "events": ["job.failed"] });
    let hook = client.request(Method::POST, "/v1/webhooks").unwrap().json(&hook).send().await.unwrap();
    assert_eq!(hook.status().as_u16(), 201);
    let before = told(client).await;
    let data = server.stop().await.unwrap();

    let url = database(data.path()).await;
    let (file, there) = (DatabaseLocation::DataDir(data.path().to_owned()), DatabaseLocation::Url(url));
    let copied = store::copy_database(&file, &there).await.unwrap();
    let rows = |table: &str| copied.iter().find(|copied| copied.name == table).unwrap().rows;
    assert_eq!((rows("captures"), rows("models"), rows("webhooks")), (1, 1, 1));
    assert!(rows("events") > 3);
    let again = store::copy_database(&file, &there).await.unwrap_err();
    assert!(matches!(again, StoreError::DatabaseNotEmpty("captures")), "{again}");

    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    assert_eq!(told(server.client()).await, before);
    let more = server.client().create_job(&small_job(&capture.id, 2, 2), None).await.unwrap();
    assert_eq!(ended(server.client(), &more.id).await.state, JobState::Succeeded);
    let after = told(server.client()).await;
    let data = server.stop().await.unwrap();
    std::fs::rename(data.path().join("relume.db"), data.path().join("former.db")).unwrap();
    let back = store::copy_database(&there, &file).await.unwrap();
    let rows = |copied: &[CopiedTable]| copied.iter().map(|table| table.rows).sum::<usize>();
    assert!(rows(&back) > rows(&copied));
    let server = testing::spawn_with(data, |config| config.database = None).await.unwrap();
    assert_eq!(told(server.client()).await, after);
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_a_second_server_is_refused_until_the_first_stops() {
    let (data, other) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let url = database(data.path()).await;
    let first = testing::spawn_with(data, |_| {}).await.unwrap();
    answers(first.client()).await;
    let same = url.clone();
    let second = testing::spawn_with(other, |config| config.database = Some(same)).await.unwrap();
    let refused = second.stop().await.unwrap_err();
    assert!(matches!(refused, ServeError::Store(StoreError::DatabaseLocked)), "{refused}");
    first.stop().await.unwrap();
    let third =
        testing::spawn_with(TempDir::new().unwrap(), |config| config.database = Some(url)).await.unwrap();
    answers(third.client()).await;
    third.stop().await.unwrap();
}

/// Ends every connection that holds the lock of the first server, and waits until none does. Returns their
/// number.
async fn cut_locks(data: &Path) -> i64 {
    let pool = raw_pool(data).await;
    let held = "FROM pg_locks WHERE locktype = 'advisory'
         AND database = (SELECT oid FROM pg_database WHERE datname = current_database())";
    let cut = format!("SELECT COUNT(pg_terminate_backend(pid)) {held}");
    let count = sqlx::query_scalar(sqlx::AssertSqlSafe(cut)).fetch_one(&pool).await.unwrap();
    let left = format!("SELECT COUNT(*) {held}");
    for _ in 0..1000 {
        let left: i64 = sqlx::query_scalar(sqlx::AssertSqlSafe(left.clone())).fetch_one(&pool).await.unwrap();
        if left == 0 {
            return count;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("the connections do not end");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_a_lost_server_lock_is_retaken_if_still_free() {
    let data = TempDir::new().unwrap();
    let store = open_store(data.path()).await;
    let mut first = store.lock_database().await.unwrap();
    first.renew().await.unwrap();
    assert_eq!(cut_locks(data.path()).await, 1);
    first.renew().await.unwrap();
    assert!(matches!(store.lock_database().await, Err(StoreError::DatabaseLocked)), "it has the lock again");
    assert_eq!(cut_locks(data.path()).await, 1);
    let _second = store.lock_database().await.unwrap();
    assert!(matches!(first.renew().await, Err(StoreError::DatabaseLocked)));
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_many_workers_claim_each_job_once_and_in_order() {
    const JOBS: usize = 200;
    let data = TempDir::new().unwrap();
    let server = testing::spawn_with(data, |config| config.limits.disk_bytes = Some(1 << 30)).await.unwrap();
    let capture = server.client().upload_capture_bytes(capture_zip()).await.unwrap();
    let data = server.stop().await.unwrap();
    let store = open_store(data.path()).await;
    let jobs = Jobs::new(store, Arc::new(SystemClock), Arc::new(RandomIds), LeasePolicy::default());
    for number in 0..JOBS {
        let request =
            NewJob { capture: capture.id.clone(), priority: (number % 3) as i64, ..NewJob::default() };
        jobs.submit(&TenantId::of_operator(), request, 1, Origin::default(), None, |_, _| String::new())
            .await
            .unwrap();
    }
    let worker = || async {
        let mut mine = Vec::new();
        while let Some(lease) = jobs.claim().await.unwrap() {
            mine.push((lease.job().request.priority, lease.job().id.to_string()));
        }
        mine
    };
    let claimed = join_all((0..16).map(|_| worker())).await;
    for mine in &claimed {
        assert!(mine.is_sorted_by_key(|(priority, _)| -priority), "{mine:?}");
    }
    let mut all: Vec<_> = claimed.concat().into_iter().map(|(_, id)| id).collect();
    all.sort();
    all.dedup();
    assert_eq!(all.len(), JOBS);
    assert!(claimed.iter().filter(|mine| !mine.is_empty()).count() > 1, "one worker took all");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_training_survives_a_database_outage() {
    let data = TempDir::new().unwrap();
    let name = database_name(data.path());
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 400, 50), None).await.unwrap();
    until(client, &job.id, |job| job.progress.step > 0).await;
    // The database refuses new connections and ends existing ones.
    let other = TempDir::new().unwrap();
    let root = raw_pool(other.path()).await;
    let execute = async |statement: String| {
        sqlx::raw_sql(sqlx::AssertSqlSafe(statement)).execute(&root).await.unwrap();
    };
    execute(format!("ALTER DATABASE \"{name}\" ALLOW_CONNECTIONS false")).await;
    execute(format!(
        "SELECT COUNT(pg_terminate_backend(pid)) FROM pg_stat_activity WHERE datname = '{name}'"
    ))
    .await;
    let refused = client.job(&job.id).await.unwrap_err();
    assert_eq!(refused.problem().map(|problem| problem.status), Some(503), "{refused}");
    tokio::time::sleep(Duration::from_secs(2)).await;
    execute(format!("ALTER DATABASE \"{name}\" ALLOW_CONNECTIONS true")).await;
    answers(client).await;
    let job = ended(client, &job.id).await;
    assert_eq!((job.state, job.attempts), (JobState::Succeeded, 1), "{:?}", job.error);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_a_backup_is_sqlite_and_can_be_restored() {
    let server = testing::spawn_with(TempDir::new().unwrap(), |_| {}).await.unwrap();
    let url = database(server.data_dir()).await;
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 2, 2), None).await.unwrap();
    ended(client, &job.id).await;
    let out = TempDir::new().unwrap();
    let (copy, restored) = (out.path().join("backup"), out.path().join("restored"));
    let made = store::backup(server.data_dir(), Some(&url), &copy, 0).await.unwrap();
    assert!(made.artifacts >= 3, "{made:?}");
    let before = client.job(&job.id).await.unwrap();
    server.stop().await.unwrap();
    store::restore(&copy, &restored).await.unwrap();
    let server = testing::spawn_with(TempDir::new_in(out.path()).unwrap(), |config| {
        config.data_dir = restored;
        config.database = None;
    })
    .await
    .unwrap();
    assert_eq!(server.client().job(&job.id).await.unwrap(), before);
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_doctor_checks_files_named_in_the_database() {
    let server = testing::spawn_with(TempDir::new().unwrap(), |_| {}).await.unwrap();
    let url = std::env::var("RELUME_TEST_POSTGRES").unwrap();
    let url = format!("{}/{}", url.rsplit_once('/').unwrap().0, database_name(server.data_dir()));
    trained(server.client()).await;
    let data = server.stop().await.unwrap();
    let doctor = |url: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
        command.args(["doctor", "--device", "cpu", "--data-dir"]).arg(data.path());
        let output = command.env("RELUME_DATABASE_URL", url).output().unwrap();
        let said = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes)).concat();
        (output.status.success(), said)
    };
    let (is_sound, said) = doctor(&url);
    assert!(is_sound && said.contains("3 referenced by the database, 0 not"), "{said}");
    let files = files_under(data.path());
    let (points, _) = files.iter().find(|(name, _)| name.ends_with("model.ply")).unwrap();
    std::fs::remove_file(data.path().join(points)).unwrap();
    let (is_sound, said) = doctor(&url);
    assert!(!is_sound && said.contains(&format!("{points} is missing")), "{said}");
    let (is_sound, said) = doctor("postgres://relume@127.0.0.1:1/nowhere");
    assert!(!is_sound && !said.contains("fault"), "{said}");
}
