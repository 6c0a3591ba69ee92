//! The command line, one file for each command.

mod args;
mod artifacts;
mod backup;
mod bench;
mod capture;
mod database;
pub mod demo;
mod doctor;
mod error;
pub mod eval;
mod explain;
mod export;
mod import;
mod input;
mod key;
mod keys;
mod light;
mod logs;
mod output;
mod progress;
mod render;
mod sample;
mod serve;
mod size;
mod stop;
#[cfg(feature = "otlp")]
mod traces;
mod train;
mod worker;
mod worker_progress;
mod workers;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use error::CommandResult;

/// Turns posed photographs into relightable 3D Gaussian models and serves them relit.
#[derive(Debug, Parser)]
#[command(name = "relume", version, arg_required_else_help = true, after_help = error::EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Log as JSON, one object a line.
    #[arg(long, global = true)]
    json_logs: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// See it work: train on a synthetic capture, relight it, measure it against the exact truth.
    Demo(demo::DemoArgs),
    /// Run the HTTP service.
    Serve(Box<serve::ServeArgs>),
    /// Train jobs of a server elsewhere.
    Worker(worker::WorkerArgs),
    /// List the workers of a server, and drain them.
    Workers(workers::WorkersArgs),
    /// Look at photographs before a training, or find their poses.
    Capture(capture::CaptureArgs),
    /// Train a model from a capture on this machine.
    Train(train::TrainArgs),
    /// Render a model on this machine.
    Render(render::RenderArgs),
    /// Write a small synthetic capture, to try the service with.
    Sample(sample::SampleArgs),
    /// Measure a model against a capture's held-out views and ground truth.
    Eval(eval::EvalArgs),
    /// Measure speed on this machine.
    Bench(bench::BenchArgs),
    /// Print what a model contains, and the complexity decisions of its training with their evidence.
    Explain(explain::ExplainArgs),
    /// Write a model in another format.
    Export(export::ExportArgs),
    /// Make a model file of a PLY of Gaussians.
    Import(import::ImportArgs),
    /// Show this machine's devices and check that the service can run on it.
    Doctor(doctor::DoctorArgs),
    /// Make, list and revoke API keys, also while the server runs.
    Keys(keys::KeysArgs),
    /// Copy what a server has stored, also while it runs.
    Backup(backup::BackupArgs),
    /// Make a data directory from a backup.
    Restore(backup::RestoreArgs),
    /// Move what a server knows between SQLite and PostgreSQL.
    Db(database::DbArgs),
    /// Print the description of the HTTP API.
    Openapi,
}

impl Command {
    /// Whether it serves others until it is told to stop.
    fn is_service(&self) -> bool {
        match self {
            Self::Serve(_) => true,
            Self::Worker(_) => true,
            _ => false,
        }
    }
}

/// Runs the command that the process was started with.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let traces = logs::start(cli.json_logs, cli.command.is_service());
    let code = run(cli.command);
    traces.finish();
    code
}

fn run(command: Command) -> ExitCode {
    let outcome = match command {
        Command::Demo(args) => demo::run(&args).map_err(Into::into),
        Command::Serve(args) => serve::run(*args),
        Command::Worker(args) => return exit(worker::run(args)),
        Command::Workers(args) => workers::run(&args),
        Command::Capture(args) => return exit(capture::run(&args)),
        Command::Train(args) => return exit(train::run(&args)),
        Command::Render(args) => render::run(&args),
        Command::Sample(args) => sample::run(&args),
        Command::Eval(args) => eval::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Explain(args) => explain::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Keys(args) => keys::run(args),
        Command::Backup(args) => backup::backup(&args),
        Command::Restore(args) => backup::restore(&args),
        Command::Db(args) => database::run(&args),
        Command::Openapi => openapi(),
    };
    exit(outcome.map(|()| ExitCode::SUCCESS))
}

/// How the program ends; an error is printed.
fn exit(outcome: CommandResult<ExitCode>) -> ExitCode {
    match outcome {
        Ok(code) => code,
        Err(error) => {
            eprintln!("relume: {error}");
            ExitCode::FAILURE
        }
    }
}

fn openapi() -> CommandResult {
    println!("{}", crate::server::openapi().to_pretty_json()?);
    Ok(())
}
