//! `relume sample`: writes a small capture for testing the service.

use std::path::PathBuf;

use crate::cli::error::CommandResult;
use crate::cli::output;
use relume_capture::{SyntheticOptions, synthetic, write_archive};

/// Options of `relume sample`.
#[derive(Debug, clap::Args)]
pub(super) struct SampleArgs {
    /// The zip file to write.
    #[arg(default_value = "capture.zip")]
    out: PathBuf,
    /// Seed of the noise in the photographs.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
}

/// Renders the scene of the demo with fewer and smaller photographs, some of them held out.
pub(super) fn run(args: &SampleArgs) -> CommandResult {
    if args.out.exists() {
        return Err(format!("{}: the file already exists", args.out.display()).into());
    }
    let options = SyntheticOptions {
        train_views: 20,
        test_views: 4,
        size: 96,
        relit: [].into(),
        paths: 32,
        seed: args.seed,
        ..SyntheticOptions::default()
    };
    let capture = synthetic(&options)?;
    output::write_named(&args.out, &write_archive(&capture)?)?;
    let (train, test) = (capture.train.len(), capture.test.len());
    eprintln!("wrote {}: {train} training and {test} held-out photographs", args.out.display());
    Ok(())
}
