//! `relume backup` and `relume restore`.

use std::path::PathBuf;

use crate::cli::artifacts::ArtifactsArgs;
use crate::cli::database::DatabaseArgs;
use crate::cli::error::CommandResult;
use crate::jobs::{Clock, SystemClock};
use crate::store;

/// Options of `relume backup`.
#[derive(Debug, clap::Args)]
pub(super) struct BackupArgs {
    /// The data directory. A server may run on it during the backup.
    #[arg(long, env = "RELUME_DATA_DIR", default_value = "relume-data")]
    data_dir: PathBuf,
    #[command(flatten)]
    database: DatabaseArgs,
    #[command(flatten)]
    artifacts: ArtifactsArgs,
    /// The folder to create. It must not exist or must be empty.
    out: PathBuf,
}

/// Options of `relume restore`.
#[derive(Debug, clap::Args)]
pub(super) struct RestoreArgs {
    /// The backup folder.
    backup: PathBuf,
    /// The data directory to create. It must not exist or must be empty.
    #[arg(long, env = "RELUME_DATA_DIR", default_value = "relume-data")]
    data_dir: PathBuf,
}

pub(super) fn backup(args: &BackupArgs) -> CommandResult {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let url = args.database.database_url.as_ref();
    let (artifacts, now) = (args.artifacts.place(), SystemClock.now_ms());
    let made =
        runtime.block_on(store::backup_with(&args.data_dir, url, artifacts.as_ref(), &args.out, now))?;
    println!("{}: {} artifacts, {} bytes, verified", args.out.display(), made.artifacts, made.bytes);
    if made.without_checkpoint > 0 {
        println!(
            "{} jobs will restart from step 0: their checkpoints were replaced during the copy",
            made.without_checkpoint
        );
    }
    Ok(())
}

pub(super) fn restore(args: &RestoreArgs) -> CommandResult {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let made = runtime.block_on(store::restore(&args.backup, &args.data_dir))?;
    println!("{}: {} artifacts, {} bytes, verified", args.data_dir.display(), made.artifacts, made.bytes);
    Ok(())
}
