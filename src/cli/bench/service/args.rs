//! Options of `relume bench service`, and its loads.

use std::path::PathBuf;

use relume_engine::DeviceChoice;

/// A load on the service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Load {
    Idle,
    Training,
    Uploads,
    Renders,
    Sockets,
}

impl Load {
    pub(super) const ALL: [Self; 5] =
        [Self::Idle, Self::Training, Self::Uploads, Self::Renders, Self::Sockets];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Training => "beside a training",
            Self::Uploads => "beside uploads",
            Self::Renders => "beside renders",
            Self::Sockets => "beside half-sent requests",
        }
    }
}

/// Options of `relume bench service`.
#[derive(Debug, clap::Args)]
pub(in crate::cli::bench) struct ServiceArgs {
    /// Device of the service: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    pub(super) device: DeviceChoice,
    /// Only these loads, separated by commas: `idle`, `training`, `uploads`, `renders`, `sockets`.
    #[arg(long, value_delimiter = ',')]
    pub(super) only: Vec<Load>,
    /// Maximum number of thumbnails per load, requested one after the other, each with its own URL.
    #[arg(long, default_value_t = 400, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(super) thumbnails: u32,
    /// Maximum seconds per load.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=600))]
    pub(super) seconds: u64,
    /// Side of the thumbnails, pixels.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=1024))]
    pub(super) size: u32,
    /// Training steps of the model that is rendered.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(super) iterations: u32,
    /// Maximum number of Gaussians of this model and of the training load.
    #[arg(long, default_value_t = 5000, value_parser = clap::value_parser!(u32).range(64..=1_000_000))]
    pub(super) gaussians: u32,
    /// Photographs in the upload that is validated repeatedly.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u32).range(3..=200))]
    pub(super) photographs: u32,
    /// Megapixels of each photograph of the upload.
    #[arg(long, default_value_t = 12.0, value_parser = megapixels)]
    pub(super) megapixels: f64,
    /// Renders in each burst of clients that disconnect.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(super) renders: u32,
    /// Side of these renders, pixels.
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub(super) render_size: u32,
    /// Connections that have sent half a request. A connection that the server closes, after 15 s, is not reopened.
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..=4000))]
    pub(super) sockets: u32,
    /// The Markdown file to write. The report is also printed.
    #[arg(long)]
    pub(super) out: Option<PathBuf>,
}

/// Parses megapixels; fractions are allowed.
fn megapixels(text: &str) -> Result<f64, String> {
    let read = text.parse().ok().filter(|millions| (0.001..=100.0).contains(millions));
    read.ok_or_else(|| "must be 0.001 to 100".to_owned())
}
