//! Databases of every earlier schema are upgraded with all their rows.

use std::path::{Path, PathBuf};

use relume::store::{Filter, Page, Store};
use relume_api::TenantId;
use relume_spec::CaptureReport;
use sqlx::AnyPool;
use sqlx::migrate::Migrator;
use tempfile::TempDir;

use crate::service_support::{on_postgres, open_store, raw_pool};

/// Rows that are inserted when a schema of SQLite has their tables. The first schema had no tenants.
const SQLITE_ROWS: [(usize, &str); 6] = [
    (
        1,
        "INSERT INTO captures (id, sha256, bytes, artifact, report, created_ms)
             VALUES ('c', 'cc', 1, 'captures/cc', 'REPORT', 5);
         INSERT INTO environments (id, sha256, bytes, artifact, width, height, warnings, created_ms)
             VALUES ('e', 'ee', 1, 'environments/ee', 4, 2, '[]', 6);
         INSERT INTO jobs (id, capture_id, preset, overrides, device, priority, state, created_ms, total, model_id)
             VALUES ('j', 'c', 'draft', '{}', 'auto', 0, 'succeeded', 7, 10, 'm'),
                    ('q', 'c', 'draft', '{}', 'auto', 0, 'queued', 8, 10, NULL);
         INSERT INTO events (job_id, at_ms, kind, data) VALUES ('j', 7, 'state', '{}');
         INSERT INTO models (id, job_id, capture_id, gaussians, card, created_ms) VALUES ('m', 'j', 'c', 1, '{}', 8);
         INSERT INTO model_files VALUES ('m', 'model.ply', 'x/y', 1, 'ff', 'attempts/j/1/model.ply');",
    ),
    (4, KEY),
    (6, UPLOAD),
    (7, WEBHOOK),
    (11, EXPORT),
    (13, WORKER),
];

/// As [`SQLITE_ROWS`], for PostgreSQL.
const POSTGRES_ROWS: [(usize, &str); 6] = [
    (
        1,
        "INSERT INTO captures (id, tenant, sha256, bytes, artifact, report, created_ms)
             VALUES ('c', 'default', 'cc', 1, 'captures/cc', 'REPORT', 5);
         INSERT INTO environments (id, tenant, sha256, bytes, artifact, width, height, warnings, created_ms)
             VALUES ('e', 'default', 'ee', 1, 'environments/ee', 4, 2, '[]', 6);
         INSERT INTO jobs (id, tenant, capture_id, preset, overrides, device, priority, state, created_ms, total, model_id)
             VALUES ('j', 'default', 'c', 'draft', '{}', 'auto', 0, 'succeeded', 7, 10, 'm'),
                    ('q', 'default', 'c', 'draft', '{}', 'auto', 0, 'queued', 8, 10, NULL);
         INSERT INTO events (job_id, at_ms, kind, data) VALUES ('j', 7, 'state', '{}');
         INSERT INTO models (id, tenant, job_id, capture_id, gaussians, card, created_ms)
             VALUES ('m', 'default', 'j', 'c', 1, '{}', 8);
         INSERT INTO model_files VALUES ('m', 'model.ply', 'x/y', 1, 'ff', 'attempts/j/1/model.ply');",
    ),
    (1, KEY),
    (1, UPLOAD),
    (1, WEBHOOK),
    (1, EXPORT),
    (2, WORKER),
];

const KEY: &str = "INSERT INTO keys (id, name, tenant, scopes, secret_sha256, created_ms)
    VALUES ('k', 'a key', 'default', '[\"read\"]', '00', 9)";
const UPLOAD: &str = "INSERT INTO uploads (id, tenant, length, received, created_ms, expires_ms)
    VALUES ('u', 'default', 5, 0, 9, 99)";
const WEBHOOK: &str = "INSERT INTO webhooks (id, tenant, url, events, secret, created_ms, enabled)
        VALUES ('w', 'default', 'https://example.org/', '[\"job.succeeded\"]', 'SECRET', 9, TRUE);
    INSERT INTO deliveries (id, webhook_id, event, job_id, payload, created_ms, state, due_ms)
        VALUES ('d', 'w', 'job.succeeded', 'j', '{}', 9, 'pending', 9)";
const EXPORT: &str = "INSERT INTO exports (id, tenant, model_id, kind, request, state, total, created_ms)
    VALUES ('x', 'default', 'm', 'ply', '{\"kind\": \"ply\"}', 'queued', 1, 9)";
const WORKER: &str = "INSERT INTO workers (id, name, device, has_gpu, labels, version, started_ms, seen_ms)
    VALUES ('worker-1', 'a worker', 'cpu', FALSE, '[]', '0.1.0', 9, 9)";

/// The migrations of the database in use, in their order.
fn migrations() -> Vec<PathBuf> {
    let database = if on_postgres() { "postgres" } else { "sqlite" };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("migrations").join(database);
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn rows() -> &'static [(usize, &'static str)] {
    if on_postgres() { &POSTGRES_ROWS } else { &SQLITE_ROWS }
}

/// Creates a database of schema `version`, whose rows were inserted when their tables were new.
async fn former_database(data: &Path, version: usize) {
    if !on_postgres() {
        std::fs::write(data.join("relume.db"), b"").unwrap();
    }
    let pool = raw_pool(data).await;
    let folder = TempDir::new().unwrap();
    for (number, file) in migrations().iter().enumerate().take(version) {
        std::fs::copy(file, folder.path().join(file.file_name().unwrap())).unwrap();
        Migrator::new(folder.path()).await.unwrap().run(&pool).await.unwrap();
        insert_rows(&pool, number + 1).await;
    }
    pool.close().await;
}

async fn insert_rows(pool: &AnyPool, version: usize) {
    let report = serde_json::to_string(&CaptureReport::default()).unwrap();
    for (_, statements) in rows().iter().filter(|(since, _)| *since == version) {
        // SQLite stores only bytes as bytes.
        let statements = statements
            .replace("REPORT", &report)
            .replace("'SECRET'", if on_postgres() { "'secret'::bytea" } else { "x'736563726574'" });
        sqlx::raw_sql(sqlx::AssertSqlSafe(statements)).execute(pool).await.unwrap();
    }
}

/// The resources that the store lists, by their kind.
async fn resources(store: &Store) -> Vec<(&'static str, usize)> {
    let (tenant, filter, page) =
        (TenantId::of_operator(), Filter::default(), Page { limit: 9, before: None });
    vec![
        ("captures", store.captures(&tenant, &filter, &page).await.unwrap().len()),
        ("environments", store.environments(&tenant, &filter, &page).await.unwrap().len()),
        ("jobs", store.jobs(&tenant, None, &filter, &page).await.unwrap().len()),
        ("events", store.events_after(&tenant, &"j".into(), 0).await.unwrap().len()),
        ("models", store.models(&tenant, &filter, &page).await.unwrap().len()),
        ("files", store.model_files(&tenant, &"m".into()).await.unwrap().len()),
        ("keys", store.keys(None, &page).await.unwrap().len()),
        ("uploads", store.uploads(&tenant, 9, &page).await.unwrap().len()),
        ("webhooks", store.webhooks(&tenant, &page).await.unwrap().len()),
        ("deliveries", store.deliveries(&tenant, &"w".into(), &page).await.unwrap().len()),
        ("exports", store.exports(&tenant, None, None, &page).await.unwrap().len()),
        ("workers", store.workers().await.unwrap().len()),
    ]
}

/// The rows that a database of schema `version` had.
fn expected(version: usize) -> Vec<(&'static str, usize)> {
    let since = |statements: &str| {
        let row = rows().iter().find(|(_, text)| *text == statements).unwrap();
        usize::from(row.0 <= version)
    };
    let (webhook, first) = (since(WEBHOOK), 1);
    vec![
        ("captures", first),
        ("environments", first),
        ("jobs", 2),
        ("events", first),
        ("models", first),
        ("files", first),
        ("keys", since(KEY)),
        ("uploads", since(UPLOAD)),
        ("webhooks", webhook),
        ("deliveries", webhook),
        ("exports", since(EXPORT)),
        ("workers", since(WORKER)),
    ]
}

#[tokio::test]
async fn databases_of_every_schema_are_upgraded_with_their_rows() {
    let last = migrations().len();
    assert!(last >= rows().last().unwrap().0, "the rows fit the migrations");
    for version in 1..=last {
        let data = TempDir::new().unwrap();
        former_database(data.path(), version).await;
        let store = open_store(data.path()).await;
        assert_eq!(resources(&store).await, expected(version), "schema {version}");
        store.close().await;
        // A database that is up to date is opened again.
        let store = open_store(data.path()).await;
        assert_eq!(resources(&store).await, expected(version), "schema {version}, again");
        let claimed = store.claim_job(&relume::store::Claimant::default(), "t", 10, 20).await.unwrap();
        assert_eq!(claimed.unwrap().id.as_str(), "q", "schema {version}: the queued job can run");
        store.close().await;
    }
}

#[tokio::test]
async fn databases_whose_migration_was_changed_are_refused() {
    let data = TempDir::new().unwrap();
    former_database(data.path(), 1).await;
    let pool = raw_pool(data.path()).await;
    let change = if on_postgres() { "'other'::bytea" } else { "x'00'" };
    let change = format!("UPDATE _sqlx_migrations SET checksum = {change}");
    sqlx::raw_sql(sqlx::AssertSqlSafe(change)).execute(&pool).await.unwrap();
    pool.close().await;
    let database = relume::testing::database_of(data.path()).await.unwrap();
    let refused = Store::open_with(data.path(), database.as_ref()).await.map(|_| ()).unwrap_err();
    assert!(refused.to_string().contains("migration"), "{refused}");
}
