//! Starts a server on a free port, for tests of other programs.
//!
//! ```no_run
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! let server = relume::testing::spawn().await?;
//! let models = server.client().models().await?;
//! assert!(models.items.is_empty());
//! server.stop().await?;
//! # Ok(()) }
//! ```

use std::path::Path;

use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::{CancellationToken, DropGuard};

use crate::server::{ServeError, ServerConfig, run};
use crate::store::DatabaseUrl;
use relume_client::Client;

/// A running server with its own data directory. Dropping it stops the server and deletes the directory.
pub struct TestServer {
    client: Client,
    data: TempDir,
    stop: DropGuard,
    task: JoinHandle<Result<(), ServeError>>,
}

/// Starts a server with the default configuration on a free port of 127.0.0.1, with a temporary data directory.
///
/// # Errors
/// When it cannot start.
pub async fn spawn() -> Result<TestServer, ServeError> {
    spawn_with(TempDir::new()?, |_| {}).await
}

/// As [`spawn`], with an existing data directory, which may contain data of an earlier server, and with changes to the
/// configuration.
///
/// # Errors
/// When it cannot start.
pub async fn spawn_with(
    data: TempDir,
    change: impl FnOnce(&mut ServerConfig),
) -> Result<TestServer, ServeError> {
    let mut config = ServerConfig::new(data.path());
    config.database = database_of(data.path()).await?;
    change(&mut config);
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    let base = format!("http://{}", listener.local_addr()?);
    let client = Client::new(&base, None).map_err(std::io::Error::other)?;
    let stop = CancellationToken::new();
    let shutdown = stop.clone();
    let serving = run(config, listener, async move { shutdown.cancelled().await });
    let task = tokio::spawn(serving);
    Ok(TestServer { client, data, stop: stop.drop_guard(), task })
}

/// The database for a data directory: a separate database on the PostgreSQL server of the environment variable
/// `RELUME_TEST_POSTGRES`, the same for each call. `None`, for SQLite, if the variable is not set.
///
/// # Errors
/// If the URL is invalid or the server cannot be reached.
pub async fn database_of(data: &Path) -> Result<Option<DatabaseUrl>, ServeError> {
    let Ok(url) = std::env::var("RELUME_TEST_POSTGRES") else { return Ok(None) };
    let server: DatabaseUrl = url.parse().map_err(std::io::Error::other)?;
    Ok(Some(server.sibling(&database_name(data)).await?))
}

/// The name of this database.
pub fn database_name(data: &Path) -> String {
    let path = data.to_string_lossy();
    let plain = path.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' });
    std::iter::once("relume".to_owned()).chain(plain.map(String::from)).collect()
}

impl TestServer {
    /// A client of this server.
    pub fn client(&self) -> &Client {
        &self.client
    }

    /// The data directory.
    pub fn data_dir(&self) -> &Path {
        self.data.path()
    }

    /// Stops the server as a signal would, and returns its data directory.
    ///
    /// # Errors
    /// The error with which the server ended.
    pub async fn stop(self) -> Result<TempDir, ServeError> {
        self.stop.disarm().cancel();
        match self.task.await {
            Ok(ended) => ended.map(|()| self.data),
            Err(error) => Err(std::io::Error::other(error).into()),
        }
    }
}
