//! `relume bench`: measurements as Markdown tables, with the machine that they were made on.

mod attribution;
mod complexity;
#[cfg(feature = "gpu")]
mod device;
mod input;
mod matrix;
mod poses;
mod quantiles;
mod queue;
mod service;
mod shadow;
mod table;
mod tradeoff;
mod training;
mod visibility;

use crate::cli::error::CommandResult;

/// Options of `relume bench`.
#[derive(Debug, clap::Args)]
pub(super) struct BenchArgs {
    #[command(subcommand)]
    command: BenchCommand,
}

#[derive(Debug, clap::Subcommand)]
enum BenchCommand {
    #[cfg(feature = "gpu")]
    /// Milliseconds per stage and step, frames a second and memory of a device, by number of Gaussians.
    Device(device::DeviceArgs),
    /// Accuracy of each variant of the settings on each capture, in one table.
    Matrix(matrix::MatrixArgs),
    /// What each layer of a model costs its relit pictures, in dB: ground truth replaces one layer after the other.
    Attribution(attribution::AttributionArgs),
    /// Poses that COLMAP finds for photographs, against those that their capture states.
    Poses(poses::BenchPosesArgs),
    /// How fast jobs go through the queue when no worker computes anything, and what they leave in the database.
    Queue(queue::QueueArgs),
    /// Size, time and accuracy of trainings with all model features and with those that the scene requires.
    Complexity(complexity::ComplexityArgs),
    /// How long thumbnails take beside a training, uploads, renders and half-sent requests, and the memory of each.
    Service(service::ServiceArgs),
    /// What is left of the cast shadows of the photographs in the albedo of models.
    Shadow(shadow::ShadowArgs),
    /// Time of every render tier against its error, by model; a table, a CSV and a plot.
    Tradeoff(tradeoff::TradeoffArgs),
    /// Error of the visibility that models learned, by the source of its labels.
    Visibility(visibility::VisibilityArgs),
}

pub(super) fn run(args: &BenchArgs) -> CommandResult {
    match &args.command {
        #[cfg(feature = "gpu")]
        BenchCommand::Device(args) => device::run(args),
        BenchCommand::Matrix(args) => matrix::run(args),
        BenchCommand::Attribution(args) => attribution::run(args),
        BenchCommand::Poses(args) => poses::run(args),
        BenchCommand::Queue(args) => queue::run(args),
        BenchCommand::Complexity(args) => complexity::run(args),
        BenchCommand::Service(args) => service::run(args),
        BenchCommand::Shadow(args) => shadow::run(args),
        BenchCommand::Tradeoff(args) => tradeoff::run(args),
        BenchCommand::Visibility(args) => visibility::run(args),
    }
}
