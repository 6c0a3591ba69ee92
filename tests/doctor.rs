//! A damaged data directory: reports of `relume doctor` and `relume serve`.

use std::path::Path;
use std::process::{Command, Output};

use relume::testing;
use tempfile::TempDir;

use crate::service_support::{files_under, trained};

fn relume(args: &[&str], data: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.args(args).arg("--data-dir").arg(data).output().unwrap()
}

/// The output of `relume doctor`, and whether it found no fault.
fn doctor(data: &Path) -> (bool, String) {
    let output = relume(&["doctor", "--device", "cpu"], data);
    (output.status.success(), String::from_utf8(output.stdout).unwrap())
}

/// The reason why a server does not start.
fn refusal(data: &Path) -> String {
    let output = relume(&["serve", "--listen", "127.0.0.1:0"], data);
    assert!(!output.status.success(), "it started");
    String::from_utf8(output.stderr).unwrap()
}

/// The data directory of a server with one model.
async fn used() -> TempDir {
    let server = testing::spawn().await.unwrap();
    trained(server.client()).await;
    server.stop().await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn doctor_reports_damaged_missing_and_unknown_artifacts() {
    let data = used().await;
    let (sound, said) = doctor(data.path());
    assert!(sound && said.contains("3 referenced by the database, 0 not"), "{said}");

    let files = files_under(data.path());
    let [capture, model, points] = ["captures/", "model.safetensors", "model.ply"]
        .map(|part| files.iter().find(|(name, _)| name.contains(part)).unwrap().0.clone());
    let unknown = format!("artifacts/captures/{}", "b".repeat(64));
    std::fs::write(data.path().join(&unknown), "x").unwrap();
    let (sound, said) = doctor(data.path());
    assert!(sound && said.contains(&format!("{unknown}: not referenced")), "{said}");

    std::fs::write(data.path().join(&model), "other bytes").unwrap();
    std::fs::remove_file(data.path().join(&points)).unwrap();
    let (sound, said) = doctor(data.path());
    assert!(!sound, "{said}");
    assert!(said.contains(&format!("{model} is damaged")), "{said}");
    assert!(said.contains(&format!("{points} is missing")), "{said}");
    assert!(!said.contains(&capture), "the capture is sound: {said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn doctor_reports_a_damaged_database() {
    let data = used().await;
    let path = data.path().join("relume.db");
    let sound = std::fs::read(&path).unwrap();
    // All pages except the first two, so that the file can still be opened.
    let mut bytes = sound.clone();
    bytes[2 * 4096..].chunks_mut(4096).for_each(|page| page[..64].fill(0xa5));
    std::fs::write(&path, bytes).unwrap();
    let (healthy, said) = doctor(data.path());
    assert!(!healthy && said.contains("the database") && said.contains("damaged"), "{said}");

    std::fs::write(&path, [0x77; 8192]).unwrap();
    let (healthy, said) = doctor(data.path());
    assert!(!healthy && said.contains("relume.db is damaged"), "{said}");
    assert!(refusal(data.path()).contains("relume.db is damaged"));

    std::fs::write(&path, sound).unwrap();
    let (healthy, said) = doctor(data.path());
    assert!(healthy, "{said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn artifacts_without_a_database_are_not_served() {
    let data = used().await;
    std::fs::rename(data.path().join("relume.db"), data.path().join("elsewhere")).unwrap();
    let before = files_under(data.path());
    let why = refusal(data.path());
    assert!(why.contains("stored files but no database"), "{why}");
    let (sound, said) = doctor(data.path());
    assert!(!sound && said.contains("stored files but no database"), "{said}");
    assert_eq!(files_under(data.path()), before, "nothing was swept, nothing made");
    assert!(!data.path().join("relume.db").exists());
}

/// The name and size of every stored file.
fn artifacts(data: &Path) -> Vec<(String, u64)> {
    files_under(data).into_iter().filter(|(name, _)| name.starts_with("artifacts/")).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn artifacts_beside_an_empty_database_are_not_served() {
    let data = used().await;
    let database = data.path().join("relume.db");
    let sound = std::fs::read(&database).unwrap();
    let before = artifacts(data.path());
    assert!(!before.is_empty());
    // A file of 0 bytes, and a sound database without tables.
    std::fs::write(&database, "").unwrap();
    let why = refusal(data.path());
    assert!(why.contains("its database is empty"), "{why}");
    let (healthy, said) = doctor(data.path());
    assert!(!healthy && said.contains("its database is empty"), "{said}");
    std::fs::remove_file(&database).unwrap();
    let url = format!("sqlite:{}?mode=rwc", database.display());
    let pool = sqlx::SqlitePool::connect(&url).await.unwrap();
    sqlx::query("CREATE TABLE other (id INTEGER)").execute(&pool).await.unwrap();
    pool.close().await;
    let why = refusal(data.path());
    assert!(why.contains("its database is empty"), "{why}");
    assert_eq!(artifacts(data.path()), before, "no file was moved");
    std::fs::write(&database, sound).unwrap();
    testing::spawn_with(data, |_| {}).await.unwrap().stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn artifacts_older_than_an_unused_database_are_not_served() {
    let data = used().await;
    let before = artifacts(data.path());
    let fresh = testing::spawn().await.unwrap().stop().await.unwrap();
    std::fs::copy(fresh.path().join("relume.db"), data.path().join("relume.db")).unwrap();
    let set_age = |modified: std::time::SystemTime| {
        for (name, _) in &before {
            let file = std::fs::File::options().write(true).open(data.path().join(name)).unwrap();
            file.set_modified(modified).unwrap();
        }
    };
    set_age(std::time::UNIX_EPOCH + std::time::Duration::from_secs(1_000_000_000));
    let why = refusal(data.path());
    assert!(why.contains("belong to another database"), "{why}");
    assert_eq!(artifacts(data.path()), before, "no file was moved");
    // The control: a server that was killed during its first upload has left files that are younger than its database.
    set_age(std::time::SystemTime::now());
    let data = testing::spawn_with(data, |_| {}).await.unwrap().stop().await.unwrap();
    assert_eq!(artifacts(data.path()), before, "an unused database names nothing, so nothing is moved");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_with_a_newer_schema_is_refused() {
    let data = used().await;
    let path = data.path().join("relume.db");
    let pool = sqlx::SqlitePool::connect(&format!("sqlite:{}", path.display())).await.unwrap();
    let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
                 VALUES (9999, 'from the future', 1, x'00', 0)";
    sqlx::query(newer).execute(&pool).await.unwrap();
    pool.close().await;
    let why = refusal(data.path());
    assert!(why.contains("newer version of relume (schema 9999"), "{why}");
    let (sound, said) = doctor(data.path());
    assert!(!sound && said.contains("newer version of relume (schema 9999"), "{said}");
}

#[test]
fn doctor_refuses_a_data_directory_that_does_not_exist() {
    let folder = TempDir::new().unwrap();
    let missing = folder.path().join("missing");
    let output = relume(&["doctor", "--device", "cpu"], &missing);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("--data-dir") && said.contains("missing: is not an existing folder"), "{said}");
    assert!(!missing.exists());
    assert!(doctor(folder.path()).0, "the control: an empty folder");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_on_a_damaged_database_is_not_ready() {
    let data = used().await;
    let server = testing::spawn_with(data, |config| config.database = None).await.unwrap();
    let ready = async || {
        let request = server.client().request(reqwest::Method::GET, "/readyz").unwrap();
        request.send().await.unwrap().status().as_u16()
    };
    assert_eq!(ready().await, 200, "the control: a sound database");
    let url = format!("sqlite:{}", server.data_dir().join("relume.db").display());
    let pool = sqlx::SqlitePool::connect(&url).await.unwrap();
    sqlx::query("ALTER TABLE jobs RENAME TO elsewhere").execute(&pool).await.unwrap();
    assert_eq!(ready().await, 503);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_report_of_doctor_has_no_names_paths_or_keys() {
    let data = used().await;
    let pool = crate::service_support::raw_pool(data.path()).await;
    let change = "INSERT INTO jobs (id, capture_id, tenant, preset, overrides, device, priority, state, created_ms, total, error_code)
         SELECT 'failed', id, tenant, 'draft', '{}', 'auto', 0, 'failed', 1, 1, 'memory_unfit' FROM captures";
    sqlx::raw_sql(change).execute(&pool).await.unwrap();
    pool.close().await;
    let output = relume(&["doctor", "--report"], data.path());
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success() && said.starts_with("```text\n") && said.ends_with("```\n"), "{said}");
    for expected in
        [env!("CARGO_PKG_VERSION"), "commit", "features      gpu otlp web", "failed jobs   memory_unfit 1"]
    {
        assert!(said.contains(expected), "{expected}: {said}");
    }
    let folder = data.path().to_str().unwrap();
    assert!(!said.contains(folder) && !said.contains(folder.rsplit('/').next().unwrap()), "{said}");
    let nowhere = relume(&["doctor", "--report"], &data.path().join("nothing"));
    assert!(String::from_utf8(nowhere.stdout).unwrap().contains("failed jobs   none"));
}
