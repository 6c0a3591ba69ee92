//! `relume bench`: figures anyone can repeat, each with the machine it was measured on.

mod attribution;
mod complexity;
mod device;
mod matrix;
mod precision;
mod subject;
mod tradeoff;
mod visibility;

use crate::cli::CommandResult;

/// Options of `relume bench`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Milliseconds per stage and step, frames a second and memory of a device, by number of Gaussians.
    Device(device::Args),
    /// Accuracy of each variant of the settings on each capture, in one table.
    Matrix(matrix::Args),
    /// What each layer of a model costs its relit pictures, in dB: the truth in its place, one layer after the other.
    Attribution(attribution::Args),
    /// Error of a device's engine against f64, stage by stage.
    Precision(precision::Args),
    /// What modelling only what a scene requires saves and costs, scene by scene.
    Complexity(complexity::Args),
    /// Time of every render tier against its error, by model; a table, a CSV and a plot.
    Tradeoff(tradeoff::Args),
    /// How right the visibility is that models learned, by the source of its labels.
    Visibility(visibility::Args),
}

pub(super) fn run(args: &Args) -> CommandResult {
    match &args.what {
        What::Device(args) => device::run(args),
        What::Matrix(args) => matrix::run(args),
        What::Attribution(args) => attribution::run(args),
        What::Precision(args) => precision::run(args),
        What::Complexity(args) => complexity::run(args),
        What::Tradeoff(args) => tradeoff::run(args),
        What::Visibility(args) => visibility::run(args),
    }
}
