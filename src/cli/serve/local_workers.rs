//! Options about what trains in a server.

use crate::server::{ServerConfig, Trainers};
use relume_engine::{AdapterReport, DeviceChoice, adapters};

/// Options about what trains in a server.
#[derive(Debug, clap::Args)]
pub(super) struct LocalWorkerArgs {
    /// Train nothing here: workers elsewhere do (`relume worker`).
    #[arg(long, env = "RELUME_NO_WORKER", conflicts_with = "devices")]
    no_worker: bool,
    /// Devices that train, one job each at a time, separated by commas, or `all` graphics cards. Frames are rendered on the first. In
    /// place of `--device`.
    #[arg(long, env = "RELUME_DEVICES", value_delimiter = ',')]
    devices: Vec<String>,
    /// Be a server beside the first one of a database: answer, render and train, but take no files in, make no exports and delete
    /// nothing. Needs artifacts that both reach.
    #[arg(long, env = "RELUME_REPLICA", requires = "database_url")]
    replica: bool,
    /// Labels of this server's workers that jobs may ask for, separated by commas.
    #[arg(long, env = "RELUME_WORKER_LABELS", value_delimiter = ',')]
    worker_labels: Vec<String>,
}

impl LocalWorkerArgs {
    /// Says so to a server.
    ///
    /// # Errors
    /// When a device is none, or there is no card.
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
    if found.is_empty() { Err("--devices all: there is no graphics card".to_owned()) } else { Ok(found) }
}

/// The graphics cards that can be used; software is none.
fn cards(reports: &[AdapterReport]) -> Vec<DeviceChoice> {
    let is_card = |report: &AdapterReport| report.usable() && !report.software;
    let numbers = reports.iter().filter(|report| is_card(report));
    numbers.map(|report| DeviceChoice::Gpu(Some(report.index))).collect()
}
