//! Backups that are made while a server runs, and restoration from them.

use std::path::Path;
use std::process::{Command, Output};

use relume::testing;
use relume_api::jobs::JobState;
use relume_client::Client;
use serde_json::Value;
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use crate::server_process::Server;
use crate::service_support::{CaptureZip, capture_zip, ended, files_under, small_job, trained, until};

/// More steps than any test needs.
const ENDLESS: u32 = 1_000_000;

fn relume(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_relume")).args(args).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn backup(data: &Path, out: &Path) -> Output {
    relume(&["backup", "--data-dir", text(data), text(out)])
}

fn restore(from: &Path, data: &Path) -> Output {
    relume(&["restore", text(from), "--data-dir", text(data)])
}

fn succeeds(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn fails_with(output: &Output, words: &str) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains(words), "{said}");
}

/// Uploads captures until a request fails.
async fn upload_for_ever(client: Client) {
    for count in 3.. {
        if client.upload_capture_bytes(CaptureZip::new(count, 16).zip()).await.is_err() {
            return;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn backup_during_training_and_uploads_is_complete() {
    let (data, folder) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let server = Server::start(data.path());
    let client = &server.client;
    let done = trained(client).await;
    let model = done.model.unwrap();
    let bytes = client.file(&model, "model.safetensors").await.unwrap();
    let job = client.create_job(&small_job(&done.capture, ENDLESS, 1000), None).await.unwrap();
    let uploads = tokio::spawn(upload_for_ever(client.clone()));
    until(client, &job.id, |job| job.progress.step > 2000).await;

    let (out, elsewhere) = (folder.path().join("backup"), folder.path().join("elsewhere"));
    succeeds(&backup(data.path(), &out));
    let mode = std::os::unix::fs::PermissionsExt::mode(&out.metadata().unwrap().permissions());
    assert_eq!(mode & 0o777, 0o700, "photographs may be private");
    let seen = client.job(&job.id).await.unwrap();
    assert_eq!(seen.state, JobState::Running, "the server was not disturbed");
    server.kill();
    uploads.await.unwrap();
    data.close().unwrap();

    succeeds(&restore(&out, &elsewhere));
    succeeds(&relume(&["doctor", "--device", "cpu", "--data-dir", text(&elsewhere)]));
    let server = Server::start(&elsewhere);
    let client = &server.client;
    assert_eq!(client.file(&model, "model.safetensors").await.unwrap(), bytes);
    let resumed = until(client, &job.id, |job| job.state == JobState::Running && job.attempts == 2).await;
    assert!(resumed.progress.step >= 1000, "it goes on from its checkpoint: {:?}", resumed.progress);
    client.cancel_job(&job.id).await.unwrap();
    ended(client, &job.id).await;
    for capture in client.captures().await.unwrap().items {
        let file = elsewhere.join("artifacts/captures").join(&capture.sha256);
        assert_eq!(file.metadata().unwrap().len(), capture.bytes as u64);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn restored_job_without_its_checkpoint_starts_over() {
    let server = testing::spawn().await.unwrap();
    let capture = server.client().upload_capture_bytes(capture_zip()).await.unwrap();
    let job = server.client().create_job(&small_job(&capture.id, ENDLESS, 100), None).await.unwrap();
    until(server.client(), &job.id, |job| job.progress.step > 200).await;
    let (data, out) = (server.stop().await.unwrap(), TempDir::new().unwrap());
    let files = files_under(data.path());
    let (checkpoint, _) = files.iter().find(|(name, _)| name.contains("/checkpoint-")).unwrap();
    std::fs::remove_file(data.path().join(checkpoint)).unwrap();
    let (backup, elsewhere) = (backup(data.path(), &out.path().join("b")), out.path().join("elsewhere"));
    succeeds(&backup);
    assert!(String::from_utf8_lossy(&backup.stdout).contains("1 jobs will restart from step 0"));
    succeeds(&restore(&out.path().join("b"), &elsewhere));
    let store = relume::store::Store::open(&elsewhere).await.unwrap();
    let restored = store.job(&relume_api::TenantId::of_operator(), &job.id).await.unwrap().unwrap();
    let checkpoint = (restored.checkpoint, restored.checkpoint_step, restored.progress.step);
    assert_eq!((restored.state, checkpoint), (JobState::Queued, (None, None, 0)));
    store.close().await;
}

/// A data directory with one model, and a backup of it.
async fn backed_up() -> (TempDir, TempDir) {
    let server = testing::spawn().await.unwrap();
    trained(server.client()).await;
    let (data, out) = (server.stop().await.unwrap(), TempDir::new().unwrap());
    succeeds(&backup(data.path(), out.path()));
    (data, out)
}

#[tokio::test(flavor = "multi_thread")]
async fn an_incomplete_or_damaged_backup_is_refused() {
    let (_data, out) = backed_up().await;
    let folder = TempDir::new().unwrap();
    let elsewhere = folder.path().join("elsewhere");
    let refused = |words: &str| {
        fails_with(&restore(out.path(), &elsewhere), words);
        assert!(files_under(&elsewhere).is_empty(), "a refusal leaves nothing");
        assert!(!elsewhere.join("relume.db").exists());
    };
    let manifest = out.path().join("backup.json");
    let complete = std::fs::read(&manifest).unwrap();
    std::fs::remove_file(&manifest).unwrap();
    refused("is not a backup: it has no backup.json");
    std::fs::write(&manifest, &complete[..complete.len() / 2]).unwrap();
    refused("is not a backup: backup.json");
    std::fs::write(&manifest, &complete).unwrap();

    for (part, why) in [("model.ply", "is damaged"), ("captures/", "is damaged"), ("backup.db", "is damaged")]
    {
        let files = files_under(out.path());
        let (name, _) = files.iter().find(|(name, _)| name.contains(part)).unwrap();
        let file = out.path().join(name);
        let sound = std::fs::read(&file).unwrap();
        let mut bytes = sound.clone();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&file, bytes).unwrap();
        refused(why);
        std::fs::remove_file(&file).unwrap();
        refused("does not exist");
        std::fs::write(&file, sound).unwrap();
    }
    succeeds(&restore(out.path(), &elsewhere));
    fails_with(&restore(out.path(), &elsewhere), "is not empty");
    assert!(elsewhere.join("relume.db").exists(), "what is there is not touched");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_incomplete_restore_is_not_served() {
    let (_data, out) = backed_up().await;
    let data = TempDir::new().unwrap();
    std::fs::copy(out.path().join("backup.db"), data.path().join("relume.db.restoring")).unwrap();
    let serve = ["serve", "--listen", "127.0.0.1:0", "--data-dir", text(data.path())];
    fails_with(&relume(&serve), "no database");
    assert!(!data.path().join("relume.db").exists());
    fails_with(&relume(&["serve", "--listen", "127.0.0.1:0", "--data-dir", text(out.path())]), "no database");
    fails_with(&restore(out.path(), data.path()), "is not empty");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_backup_names_the_cause_and_leaves_nothing() {
    let (data, out) = backed_up().await;
    fails_with(&backup(data.path(), out.path()), "is not empty");
    fails_with(&backup(&data.path().join("nowhere"), &out.path().join("a")), "not a data directory");
    assert!(!data.path().join("nowhere").exists() && !out.path().join("a").exists());
    let files = files_under(data.path());
    let [points, model] = ["model.ply", "model.safetensors"]
        .map(|part| files.iter().find(|(name, _)| name.ends_with(part)).unwrap().0.clone());
    let other = out.path().join("other");
    let sound = std::fs::read(data.path().join(&points)).unwrap();
    std::fs::write(data.path().join(&points), "other bytes").unwrap();
    fails_with(&backup(data.path(), &other), &format!("{points} is damaged"));
    std::fs::write(data.path().join(&points), sound).unwrap();
    std::fs::remove_file(data.path().join(&model)).unwrap();
    fails_with(
        &backup(data.path(), &other),
        &format!("{} does not exist", model.trim_start_matches("artifacts/")),
    );
    assert!(std::fs::read_dir(&other).unwrap().next().is_none());
}

/// Changes the database of a backup, and its manifest to match.
async fn tamper(backup: &Path, change: &str) {
    let database = backup.join("backup.db");
    let pool = sqlx::SqlitePool::connect(&format!("sqlite:{}", database.display())).await.unwrap();
    sqlx::raw_sql(sqlx::AssertSqlSafe(change)).execute(&pool).await.unwrap();
    sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&pool).await.unwrap();
    pool.close().await;
    let bytes = std::fs::read(&database).unwrap();
    let manifest = backup.join("backup.json");
    let mut text: Value = serde_json::from_slice(&std::fs::read(&manifest).unwrap()).unwrap();
    text["database"]["sha256"] =
        Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect::<String>().into();
    text["database"]["bytes"] = bytes.len().into();
    std::fs::write(manifest, text.to_string()).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_with_paths_outside_itself_is_refused() {
    let (_data, out) = backed_up().await;
    let folder = TempDir::new().unwrap();
    let victim = folder.path().join("victim");
    std::fs::write(&victim, "mine").unwrap();
    let names = [
        format!("UPDATE captures SET artifact = '{}', deleted_ms = 1", victim.display()),
        "UPDATE jobs SET id = '../../victim', retry_of = NULL".to_owned(),
        "UPDATE _sqlx_migrations SET version = version + 1 WHERE version = (SELECT MAX(version) FROM _sqlx_migrations)"
            .to_owned(),
    ];
    for (i, change) in names.iter().enumerate() {
        let copy = folder.path().join(format!("backup-{i}"));
        for (name, _) in files_under(out.path()) {
            let to = copy.join(&name);
            std::fs::create_dir_all(to.parent().unwrap()).unwrap();
            std::fs::copy(out.path().join(name), to).unwrap();
        }
        let elsewhere = folder.path().join(format!("data-{i}"));
        tamper(&copy, "PRAGMA user_version = 0").await;
        succeeds(&restore(&copy, &elsewhere));
        std::fs::remove_dir_all(&elsewhere).unwrap();
        tamper(&copy, &format!("PRAGMA foreign_keys = OFF; {change}")).await;
        fails_with(&restore(&copy, &elsewhere), "is damaged");
        assert!(!elsewhere.exists(), "on an empty folder a server would start anew, without keys");
    }
    assert_eq!(std::fs::read_to_string(victim).unwrap(), "mine");
}
