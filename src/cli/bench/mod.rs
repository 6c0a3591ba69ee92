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
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    #[cfg(feature = "gpu")]
    /// Milliseconds per stage and step, frames a second and memory of a device, by number of Gaussians.
    Device(device::DeviceArgs),
    /// Accuracy of each variant of the settings on each capture, in one table.
    Matrix(matrix::MatrixArgs),
    /// What each layer of a model costs its relit pictures, in dB: ground truth replaces one layer after the other.
    Attribution(attribution::AttributionArgs),
    /// Poses that COLMAP finds for photographs, against those that their capture states.
    Poses(poses::PosesArgs),
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
    match &args.what {
        #[cfg(feature = "gpu")]
        What::Device(args) => device::run(args),
        What::Matrix(args) => matrix::run(args),
        What::Attribution(args) => attribution::run(args),
        What::Poses(args) => poses::run(args),
        What::Queue(args) => queue::run(args),
        What::Complexity(args) => complexity::run(args),
        What::Service(args) => service::run(args),
        What::Shadow(args) => shadow::run(args),
        What::Tradeoff(args) => tradeoff::run(args),
        What::Visibility(args) => visibility::run(args),
    }
}
