//! Options for the local workers of a server.

use crate::server::{ServerConfig, Trainers};
use relume_engine::{AdapterReport, DeviceChoice, adapters};

/// Options for the local workers of a server.
#[derive(Debug, clap::Args)]
pub(super) struct LocalWorkerArgs {
    /// Start no local workers; only remote workers (`relume worker`) train.
    #[arg(long, env = "RELUME_NO_WORKER", conflicts_with = "devices")]
    no_worker: bool,
    /// Devices of the local workers, separated by commas, or `all` for all graphics cards. Each device trains one job at a time.
    /// The server renders frames on the first device. Replaces `--device`.
    #[arg(long, env = "RELUME_DEVICES", value_delimiter = ',')]
    devices: Vec<String>,
    /// Run as a replica, an additional server on the same database. It answers requests, renders and trains, but accepts no uploads,
    /// makes no exports and deletes nothing. Both servers must have access to the same artifacts.
    #[arg(long, env = "RELUME_REPLICA", requires = "database_url")]
    replica: bool,
    /// Labels of the local workers, separated by commas. A job can require labels of its worker.
    #[arg(long, env = "RELUME_WORKER_LABELS", value_delimiter = ',')]
    worker_labels: Vec<String>,
}

impl LocalWorkerArgs {
    /// Sets the options in a server's configuration.
    ///
    /// # Errors
    /// If a device is invalid, or if no graphics card exists.
    pub(super) fn apply(self, config: &mut ServerConfig) -> Result<(), String> {
        if let Some(why) = relume_api::work::validate_labels(&self.worker_labels) {
            return Err(format!("--worker-labels: {why}"));
        }
        config.worker_labels = self.worker_labels;
        config.replica = self.replica;
        if self.no_worker {
            config.trainers = Trainers::None;
        }
        let mut devices = chosen(&self.devices)?.into_iter();
        if let Some(first) = devices.next() {
            config.worker.device = first;
            config.trainers = Trainers::AlsoOn(devices.collect());
        }
        Ok(())
    }
}

fn chosen(devices: &[String]) -> Result<Vec<DeviceChoice>, String> {
    let devices: Vec<&str> =
        devices.iter().map(|device| device.trim()).filter(|device| !device.is_empty()).collect();
    if devices != ["all"] {
        let named = |device: &str| device.parse().map_err(|why| format!("--devices: {why}"));
        return devices.into_iter().map(named).collect();
    }
    let found = cards(&adapters());
    if found.is_empty() { Err("--devices all: no graphics card found".to_owned()) } else { Ok(found) }
}

/// The usable graphics cards, without software devices.
fn cards(reports: &[AdapterReport]) -> Vec<DeviceChoice> {
    let is_card = |report: &AdapterReport| report.usable() && !report.software;
    let numbers = reports.iter().filter(|report| is_card(report));
    numbers.map(|report| DeviceChoice::Gpu(Some(report.index))).collect()
}
