//! `relume sample`: writes a small capture for testing the service.

use std::path::PathBuf;

use crate::cli::error::CommandResult;
use crate::cli::output;
use relume_capture::{HeldOutCameras, SyntheticOptions, synthetic, write_archive};

/// Options of `relume sample`.
#[derive(Debug, clap::Args)]
pub(super) struct SampleArgs {
    /// The zip file to write.
    #[arg(default_value = "capture.zip")]
    out: PathBuf,
    /// Seed of the noise in the photographs.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// Places of the held-out cameras: `between` the photographs, or `elsewhere`: nearer, farther, lower and higher than them.
    #[arg(long, value_name = "WHERE", default_value = "between")]
    held_out: HeldOut,
}

/// Values of `--held-out`.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum HeldOut {
    Between,
    Elsewhere,
}

/// Renders and writes the capture.
pub(super) fn run(args: &SampleArgs) -> CommandResult {
    if args.out.exists() {
        return Err(format!("{}: the file already exists", args.out.display()).into());
    }
    let options = SyntheticOptions {
        held_out: match args.held_out {
            HeldOut::Between => HeldOutCameras::Between,
            HeldOut::Elsewhere => HeldOutCameras::Elsewhere,
        },
        seed: args.seed,
        ..SyntheticOptions::sample()
    };
    let capture = synthetic(&options)?;
    output::write_named(&args.out, &write_archive(&capture)?)?;
    let (train, test) = (capture.train.len(), capture.test.len());
    eprintln!("wrote {}: {train} training and {test} held-out photographs", args.out.display());
    Ok(())
}
