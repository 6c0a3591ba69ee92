//! `relume bench service`: measures the latency of thumbnails while the service is under load.
//!
//! Server and clients run in this process, on loopback and in a temporary directory.

mod active_load;
mod args;
mod fixture;
mod memory;
mod timing;

use std::time::Duration;

use tempfile::TempDir;

use crate::cli::bench::table::{head, machine, publish, row};
use crate::cli::error::CommandResult;
use crate::server::raise_file_limit;
use crate::testing;
use active_load::{ActiveLoad, OTHER_FILES};
use args::Load;
use fixture::Fixture;
use memory::PeakMemory;
use relume_engine::Device;
use timing::{Thumbnails, Times};

pub(super) use args::ServiceArgs;

/// The columns after the load.
const COLUMNS: [&str; 7] =
    ["thumbnails", "refused", "p50, ms", "p95, ms", "p99, ms", "worst, ms", "peak resident memory, MiB"];

pub(super) fn run(args: &ServiceArgs) -> CommandResult {
    let name = machine(&Device::open(args.device)?);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let rows = runtime.block_on(measure(args))?;
    let text = format!(
        "{name}; server and clients in one process.\nThumbnails of {0} x {0} px, one after the other, at most {1} and {2} s under each load.\n\n{3}{rows}",
        args.size,
        args.thumbnails,
        args.seconds,
        head(&["load"], COLUMNS)
    );
    Ok(publish(&text, args.out.as_deref())?)
}

/// Measures all loads. Returns the rows of the table.
async fn measure(args: &ServiceArgs) -> CommandResult<String> {
    // Both ends of each connection are open files of this process.
    raise_file_limit(2 * args.sockets as usize + OTHER_FILES);
    let change = |config: &mut crate::server::ServerConfig| config.worker.device = args.device;
    let server = testing::spawn_with(TempDir::new()?, change).await?;
    let rows = measure_on(server.client().clone(), args).await;
    // The server is stopped in all cases; the first error is returned.
    let stopped = server.stop().await;
    let rows = rows?;
    stopped?;
    Ok(rows)
}

async fn measure_on(client: relume_client::Client, args: &ServiceArgs) -> CommandResult<String> {
    eprintln!("training a model to render");
    let fixture = Fixture::train(client, args).await?;
    let mut thumbnails = Thumbnails::new(&fixture, args.size);
    // The first thumbnail reads the model and the light.
    thumbnails.next().await.ok_or("the first thumbnail was refused")?;
    let mut text = String::new();
    for load in Load::ALL {
        if !args.only.is_empty() && !args.only.contains(&load) {
            continue;
        }
        eprintln!("{}", load.name());
        let memory = PeakMemory::begin();
        let active_load = ActiveLoad::begin(load, &fixture, args).await?;
        let times = thumbnails.during(args.thumbnails, Duration::from_secs(args.seconds)).await;
        let title = active_load.end().await?;
        let line = row(cells(&title, &times, memory.mebibytes()));
        eprint!("{line}");
        text += &line;
    }
    Ok(text)
}

/// The table cells of one load.
fn cells(title: &str, times: &Times, memory: Option<u64>) -> Vec<String> {
    let ms = |share: f64| times.answers.at(share).map_or_else(|| "-".to_owned(), |ms| format!("{ms:.1}"));
    let mut cells = vec![title.to_owned(), times.answers.count().to_string(), times.refused.to_string()];
    cells.extend([0.5, 0.95, 0.99, 1.0].map(ms));
    cells.push(memory.map_or_else(|| "-".to_owned(), |mebibytes| mebibytes.to_string()));
    cells
}
