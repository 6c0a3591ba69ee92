//! `relume workers`: lists and drains the workers of a server.

use std::path::PathBuf;

use crate::cli::error::CommandResult;
use crate::cli::key::key;
use relume_api::WorkerId;
use relume_api::work::{WorkerChange, WorkerView};
use relume_client::Client;

/// Options of `relume workers`.
#[derive(Debug, clap::Args)]
pub(super) struct WorkersArgs {
    /// The server, e.g. `http://127.0.0.1:7878`.
    #[arg(long, env = "RELUME_SERVER", default_value = "http://127.0.0.1:7878")]
    server: String,
    /// A file with an API key with the scope `metrics`, or `admin` to drain and resume. Alternatively set the variable
    /// RELUME_API_KEY.
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// Drain this worker: it gets no more jobs. A remote worker exits after its current job; a local worker waits until it is
    /// resumed.
    #[arg(long, value_name = "ID", conflicts_with = "resume")]
    drain: Option<String>,
    /// Resume a drained worker.
    #[arg(long, value_name = "ID")]
    resume: Option<String>,
}

pub(super) fn run(args: &WorkersArgs) -> CommandResult {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(list(args))
}

async fn list(args: &WorkersArgs) -> CommandResult {
    let client = Client::new(&args.server, key(args.key_file.as_deref())?)?;
    for (id, draining) in [(&args.drain, true), (&args.resume, false)] {
        if let Some(id) = id {
            client.change_worker(&WorkerId::from(id.as_str()), &WorkerChange { draining }).await?;
        }
    }
    println!("{:<36}  {:<8}  {:<20}  {:<28}  {:<36}  labels", "id", "state", "name", "device", "job");
    for worker in client.workers().await?.items {
        println!("{}", line(&worker));
    }
    Ok(())
}

fn line(worker: &WorkerView) -> String {
    let job = worker.job.as_ref().map_or("-", |job| job.as_str());
    let (state, labels) = (worker.state.name(), worker.labels.join(","));
    let line = format!(
        "{:<36}  {state:<8}  {:<20}  {:<28}  {job:<36}  {labels}",
        worker.id, worker.name, worker.device
    );
    line.trim_end().to_owned()
}
