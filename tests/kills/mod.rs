//! kill -9 under random requests of every kind that changes the state: all confirmed changes hold, and no
//! leftovers remain.

mod client;
mod known;

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use relume::store::{Inspection, inspect};
use relume_client::Client;
use tempfile::TempDir;

use crate::poses::{COPY, Place};
use crate::server_process::Server;
use crate::service_support::files_under;
use client::{Requests, Stop};
use known::Kind;

/// Default number of kills; `RELUME_KILLS` sets another.
const KILLS: u64 = 200;
const CLIENTS: u64 = 2;
const SEED: u64 = 11;
/// The operator's key. The server must not accept callers without a key, even after keys were created and
/// revoked.
const KEY: &str = "a-key-of-the-operator-of-these-tests";

/// The server, with webhooks to this machine permitted and a script in place of COLMAP.
fn start(data: &Path, tools: &Place) -> (Server, Client) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.env("PATH", tools.path());
    command.env("RELUME_API_KEYS", KEY);
    // Uploads whose creation was not answered are kept for a day.
    command.env("RELUME_MAX_UPLOADS_PER_TENANT", "100000");
    command.env("RELUME_WEBHOOK_ALLOW_HTTP", "true").env("RELUME_WEBHOOK_ALLOW_PRIVATE", "true");
    let server = Server::start_under(command, data);
    let client = Client::new(server.client.base().as_str(), Some(KEY.to_owned())).unwrap();
    (server, client)
}

/// Sends the requests of all clients until the server is killed.
async fn work_until_killed(clients: &mut [Requests], server: Server, client: &Client, life: Duration) {
    let work = clients.iter_mut().map(|requests| requests.go_on(client));
    let kill = async {
        tokio::time::sleep(life).await;
        server.kill();
    };
    let (stops, ()) = tokio::join!(futures::future::join_all(work), kill);
    for stop in stops {
        assert_eq!(stop.wrong(), None);
    }
}

/// The contradictions that a client finds.
async fn verify(clients: &mut [Requests], client: &Client) -> Result<(), Stop> {
    for requests in clients {
        requests.verify(client).await?;
    }
    Ok(())
}

/// Waits for the end of all jobs and validations, including those that no client knows, then stops the server with a signal.
async fn end_well(mut server: Server, client: &Client, clients: &mut [Requests]) {
    while Requests::any_validation(client).await {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    for state in ["queued", "running", "cancelling"] {
        while Requests::any_job(client, state).await {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
    verify(clients, client).await.unwrap();
    let terminated = Command::new("kill").arg(server.child.id().to_string()).status().unwrap();
    assert!(terminated.success());
    assert!(server.child.wait().unwrap().success());
}

async fn sound(data: &Path) -> Inspection {
    let found = inspect(data).await.unwrap();
    assert!(found.faults.is_empty(), "{:?}", found.faults);
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn two_hundred_kills_lose_nothing_that_was_acknowledged() {
    let kills = std::env::var("RELUME_KILLS").map_or(KILLS, |count| count.parse().unwrap());
    let data = TempDir::new().unwrap();
    // Many searches for poses are killed while this script sleeps.
    let tools = Place::new("3.8", "sleep 0.05", COPY);
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let mut clients: Vec<Requests> = (0..CLIENTS).map(|client| Requests::new(SEED, client)).collect();
    for kill in 0..kills {
        let (server, client) = start(data.path(), &tools);
        // Some starts are killed before any request.
        if random.random_bool(0.9) {
            verify(&mut clients, &client).await.unwrap_or_else(|stop| panic!("before kill {kill}: {stop:?}"));
        }
        // A few starts run long enough for a job to complete.
        let longest = if random.random_bool(0.1) { 1500 } else { 250 };
        let life = Duration::from_millis(random.random_range(0..longest));
        work_until_killed(&mut clients, server, &client, life).await;
        // Without recovery, all artifacts that the database references are intact.
        sound(data.path()).await;
    }

    let (server, client) = start(data.path(), &tools);
    verify(&mut clients, &client).await.unwrap();
    end_well(server, &client, &mut clients).await;
    let answered: u64 = clients.iter().map(|requests| requests.answered).sum();
    println!("{kills} kills amid {answered} steps: {:?}", Requests::counts(&clients));
    assert!(answered > kills, "the control: the server was killed amid work, not before any");
    let posed: u64 = clients.iter().map(|requests| requests.posed).sum();
    println!("poses of {posed} sets of photographs were found");
    assert!(posed > 0, "the control: no poses were found");
    let (server, client) = start(data.path(), &tools);
    verify(&mut clients, &client).await.unwrap();
    end_well(server, &client, &mut clients).await;
    let found = sound(data.path()).await;
    assert!(found.orphans.is_empty(), "{:?}", found.orphans);
    let known = |name: &str| {
        ["captures/", "environments/", "attempts/", "exports/", "models/", "uploads/", "orphans/"]
            .iter()
            .any(|f| name.starts_with(f))
    };
    let files = files_under(&data.path().join("artifacts"));
    assert!(files.iter().all(|(name, _)| known(name)), "{files:?}");
    the_checks_find_what_is_lost(data.path(), &tools, &clients).await;
}

/// Negative control: a lost file, a lost row and a reverted state are detected.
async fn the_checks_find_what_is_lost(data: &Path, tools: &Place, clients: &[Requests]) {
    let files = files_under(&data.join("artifacts"));
    let (capture, _) =
        files.iter().find(|(name, _)| name.starts_with("captures/")).expect("a capture is left");
    let path = data.join("artifacts").join(capture);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(inspect(data).await.unwrap().faults.len(), 1);
    std::fs::write(&path, bytes).unwrap();

    let mut tried = 0;
    for (kind, loss) in [
        (Kind::Capture, "UPDATE captures SET deleted_ms = 1"),
        (Kind::Photographs, "UPDATE captures SET deleted_ms = 1"),
        (Kind::Job, "UPDATE jobs SET deleted_ms = 1"),
        (Kind::Export, "UPDATE exports SET deleted_ms = 1"),
        (Kind::Webhook, "DELETE FROM webhooks"),
        (Kind::Key, "UPDATE keys SET revoked_ms = 1"),
    ] {
        if clients.iter().all(|requests| requests.kept(kind).is_empty()) {
            continue;
        }
        tried += 1;
        let folder = TempDir::new().unwrap();
        let copy = folder.path().join("data");
        assert!(Command::new("cp").arg("-r").args([data, &copy]).status().unwrap().success());
        let pool =
            sqlx::SqlitePool::connect(&format!("sqlite:{}", copy.join("relume.db").display())).await.unwrap();
        sqlx::raw_sql(loss).execute(&pool).await.unwrap();
        pool.close().await;
        let (server, client) = start(&copy, tools);
        let lost = verify(&mut clients.to_vec(), &client).await;
        assert!(matches!(lost, Err(Stop::Wrong(_))), "{loss}: {lost:?}");
        server.kill();
    }
    assert!(tried > 0, "nothing is left to lose");
}
