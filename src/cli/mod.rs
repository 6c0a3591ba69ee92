//! The command line, with one file per command.

mod args;
mod artifacts;
mod backup;
mod bench;
mod calibrate;
mod capture;
mod checkpoint;
mod closed_pipe;
mod database;
mod delight;
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
mod licences;
mod light;
mod logs;
mod material_args;
mod materials;
mod model_capture;
mod output;
mod progress;
mod render;
mod sample;
mod serve;
mod setting_flags;
mod sheet;
mod size;
mod stop;
mod time_budget;
#[cfg(feature = "otlp")]
mod traces;
mod train;
mod train_summary;
mod version;
mod weights;
mod worker;
mod worker_progress;
mod workers;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use error::CommandResult;

/// Turns posed photographs into relightable 3D Gaussian models and serves them over HTTP.
#[derive(Debug, Parser)]
#[command(name = "relume", version, long_version = version::long(), arg_required_else_help = true, after_help = error::EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Write the log as JSON, one object per line.
    #[arg(long, global = true)]
    json_logs: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Demonstrate Relume: train on a synthetic capture, relight the model, and compare the result with the ground truth.
    Demo(demo::DemoArgs),
    /// Run the HTTP service.
    Serve(Box<serve::ServeArgs>),
    /// Train jobs of a server on this machine (remote worker).
    Worker(worker::WorkerArgs),
    /// List, drain and resume the workers of a server.
    Workers(workers::WorkersArgs),
    /// Check photographs before a training, or find their poses.
    Capture(capture::CaptureArgs),
    /// Train a model from a capture on this machine.
    Train(Box<train::TrainArgs>),
    /// Render a model on this machine.
    Render(render::RenderArgs),
    /// Print the weights of an environment map for the parts of a light matrix.
    Weights(weights::WeightsArgs),
    /// Write a small synthetic capture for testing the service.
    Sample(sample::SampleArgs),
    /// Compare a model with the held-out views and the ground truth of a capture.
    Eval(eval::EvalArgs),
    /// Scale the albedo of a model to the known reflectance of a surface in a photograph.
    Calibrate(calibrate::CalibrateArgs),
    /// Measure speed and accuracy on this machine.
    Bench(bench::BenchArgs),
    /// Print the contents of a model, and the complexity decisions of its training with their evidence.
    Explain(explain::ExplainArgs),
    /// List the materials of a model, write their masks, and try changes of them.
    Materials(materials::MaterialsArgs),
    /// Separate the photographs of a capture into albedo, shading, shadow and specular reflection.
    Delight(delight::DelightArgs),
    /// Convert a model into another format.
    Export(export::ExportArgs),
    /// Convert a file of Gaussians (PLY, SPZ or .splat) into a model file.
    Import(import::ImportArgs),
    /// List the devices of this machine and check that the service can run.
    Doctor(doctor::DoctorArgs),
    /// Create, list and revoke API keys. A server may run at the same time.
    Keys(keys::KeysArgs),
    /// Copy the stored data of a server. The server may run at the same time.
    Backup(backup::BackupArgs),
    /// Create a data directory from a backup.
    Restore(backup::RestoreArgs),
    /// Copy the records of a server between SQLite and PostgreSQL.
    Db(database::DbArgs),
    /// Print the OpenAPI description of the HTTP API.
    Openapi,
    /// Print the licences of the program and of the packages in it, with their texts.
    #[command(alias = "licenses")]
    Licences,
}

impl Command {
    /// Whether the command runs until it is stopped.
    fn is_service(&self) -> bool {
        matches!(self, Self::Serve(_) | Self::Worker(_))
    }
}

/// Runs the command of the process's arguments.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let traces = logs::start(cli.json_logs, cli.command.is_service());
    let code = closed_pipe::guard(|| run(cli.command));
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
        Command::Weights(args) => weights::run(&args),
        Command::Sample(args) => sample::run(&args),
        Command::Eval(args) => eval::run(&args),
        Command::Calibrate(args) => calibrate::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Explain(args) => explain::run(&args),
        Command::Materials(args) => materials::run(&args),
        Command::Delight(args) => delight::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Keys(args) => keys::run(args),
        Command::Backup(args) => backup::backup(&args),
        Command::Restore(args) => backup::restore(&args),
        Command::Db(args) => database::run(&args),
        Command::Openapi => openapi(),
        Command::Licences => licences::run(),
    };
    exit(outcome.map(|()| ExitCode::SUCCESS))
}

/// The exit code of the program. An error is printed.
fn exit(outcome: CommandResult<ExitCode>) -> ExitCode {
    match outcome {
        Ok(code) => code,
        Err(error) if closed_pipe::is_cause(&*error) => ExitCode::from(error::CLOSED_PIPE),
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
