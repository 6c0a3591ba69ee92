//! `relume bench`: measurements as Markdown tables, with the machine on which they were made.

mod attribution;
mod complexity;
mod confidence;
mod delight;
#[cfg(feature = "gpu")]
mod device;
mod input;
mod light_matrix;
mod matrix;
mod plot;
mod poses;
mod quantiles;
mod queue;
mod service;
mod shadow;
mod table;
mod time_curve;
mod tradeoff;
mod training;
mod training_profile;
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
    /// Measure a device by number of Gaussians: milliseconds per stage and step, frames per second, memory.
    Device(device::DeviceArgs),
    /// Measure time and error of light matrices against frames.
    LightMatrix(light_matrix::LightMatrixArgs),
    /// Train each capture with each variant of the settings; write the accuracies as one table.
    Matrix(matrix::MatrixArgs),
    /// Measure how much each layer of a model contributes to the error of relit pictures, in dB, by replacing layers with ground
    /// truth.
    Attribution(attribution::AttributionArgs),
    /// Rank correlation and sparsification error of the confidence of models.
    Confidence(confidence::ConfidenceArgs),
    /// Albedo of photographs without their light against the ground truth.
    Delight(delight::DelightBenchArgs),
    /// Compare the poses that COLMAP finds for photographs with the poses in their capture.
    Poses(poses::BenchPosesArgs),
    /// Measure the throughput of the job queue without training, and the database size per job.
    Queue(queue::QueueArgs),
    /// Compare size, time and accuracy of trainings with all model features and with the features that the scene requires.
    Complexity(complexity::ComplexityArgs),
    /// Measure thumbnail latency and memory of the service during a training, uploads, renders and incomplete requests.
    Service(service::ServiceArgs),
    /// Measure how much of the cast shadows of the photographs remains in the albedo of models.
    Shadow(shadow::ShadowArgs),
    /// Measure time and error of each rendering tier per model; write a table, a CSV file and a plot.
    Tradeoff(tradeoff::TradeoffArgs),
    /// Train captures with several time budgets and presets; write time, held-out and relit accuracy as a table and a plot.
    Training(time_curve::TimeCurveArgs),
    /// Measure the error of the visibility that models learned, by the source of its labels.
    Visibility(visibility::VisibilityArgs),
}

pub(super) fn run(args: &BenchArgs) -> CommandResult {
    match &args.command {
        #[cfg(feature = "gpu")]
        BenchCommand::Device(args) => device::run(args),
        BenchCommand::LightMatrix(args) => light_matrix::run(args),
        BenchCommand::Matrix(args) => matrix::run(args),
        BenchCommand::Attribution(args) => attribution::run(args),
        BenchCommand::Confidence(args) => confidence::run(args),
        BenchCommand::Delight(args) => delight::run(args),
        BenchCommand::Poses(args) => poses::run(args),
        BenchCommand::Queue(args) => queue::run(args),
        BenchCommand::Complexity(args) => complexity::run(args),
        BenchCommand::Service(args) => service::run(args),
        BenchCommand::Shadow(args) => shadow::run(args),
        BenchCommand::Tradeoff(args) => tradeoff::run(args),
        BenchCommand::Training(args) => time_curve::run(args),
        BenchCommand::Visibility(args) => visibility::run(args),
    }
}
