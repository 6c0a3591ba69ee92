//! `relume doctor`: what this machine offers and whether everything is in order.

use std::path::{Path, PathBuf};

use crate::cli::CommandResult;
use crate::cli::args::Device;
use crate::store::Store;

/// Options of `relume doctor`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The data directory to look at.
    #[arg(long, env = "RELUME_DATA_DIR", default_value = "relume-data")]
    data_dir: PathBuf,
    /// The device to look for.
    #[arg(long, value_enum, default_value_t)]
    device: Device,
}

pub(super) fn run(args: &Args) -> CommandResult {
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    println!("relume        {}", env!("CARGO_PKG_VERSION"));
    println!("device        cpu{}", if args.device == Device::Auto { " (chosen by auto)" } else { "" });
    println!("cpu threads   {threads}");
    println!("cpu features  {}", features().join(" "));
    println!("gpu           the GPU engine is not part of this build");
    println!("sqlite        {}", sqlite_version()?);
    println!("data dir      {}", data_dir(&args.data_dir)?);
    Ok(())
}

/// What the CPU engine can make use of.
#[cfg(target_arch = "x86_64")]
fn features() -> Vec<&'static str> {
    let known = [
        ("sse4.2", std::is_x86_feature_detected!("sse4.2")),
        ("avx", std::is_x86_feature_detected!("avx")),
        ("avx2", std::is_x86_feature_detected!("avx2")),
        ("fma", std::is_x86_feature_detected!("fma")),
        ("avx512f", std::is_x86_feature_detected!("avx512f")),
    ];
    known.into_iter().filter_map(|(name, there)| there.then_some(name)).collect()
}

/// What the CPU engine can make use of.
#[cfg(not(target_arch = "x86_64"))]
fn features() -> Vec<&'static str> {
    vec![std::env::consts::ARCH]
}

/// Runs a real database with the real schema, in a folder of its own.
fn sqlite_version() -> Result<String, Box<dyn std::error::Error + Send + Sync>> {
    let folder = tempfile::tempdir()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    Ok(runtime.block_on(async {
        let store = Store::open(folder.path()).await?;
        let version = store.sqlite_version().await;
        store.close().await;
        version
    })?)
}

/// Whether the directory, or the nearest folder above it that exists, takes files.
fn data_dir(path: &Path) -> Result<String, Box<dyn std::error::Error + Send + Sync>> {
    let absolute = std::path::absolute(path)?;
    let there = absolute.ancestors().find(|p| p.exists()).unwrap_or(Path::new("/"));
    let state = match tempfile::tempfile_in(there) {
        Ok(_) if there == absolute => "writable".to_owned(),
        Ok(_) => "will be created".to_owned(),
        Err(error) => return Err(format!("data dir {}: {error}", absolute.display()).into()),
    };
    Ok(format!("{} ({state})", absolute.display()))
}
