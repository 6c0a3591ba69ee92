//! Measurements for developers. `cargo run --release -p relume-bench -- precision` compares an engine with f64;
//! `cargo bench -p relume-bench --bench engine` times the stages of the CPU engine.

mod precision;

use std::process::ExitCode;

use clap::Parser;

/// Any error.
type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// Measurements for developers of Relume, as Markdown tables.
#[derive(Debug, Parser)]
#[command(name = "relume-bench")]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Error of a device's engine against f64, by stage and kind of scene.
    Precision(precision::PrecisionArgs),
}

fn main() -> ExitCode {
    let Command::Precision(args) = Args::parse().command;
    match precision::run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("relume-bench: {error}");
            ExitCode::FAILURE
        }
    }
}
