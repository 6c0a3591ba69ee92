//! A device and what it was chosen by, so that it can be opened anew after a failure.

use crate::engine::{Device, DeviceChoice, DeviceError};

/// A device that is ready.
pub struct OpenedDevice {
    choice: DeviceChoice,
    device: Device,
}

impl OpenedDevice {
    /// Opens what was chosen.
    ///
    /// # Errors
    /// When it cannot be had.
    pub fn open(choice: DeviceChoice) -> Result<Self, DeviceError> {
        let device = Device::open(choice)?;
        tracing::info!(device = device.name(), "device ready");
        Ok(Self { choice, device })
    }

    /// The CPU engine.
    pub fn cpu() -> Self {
        Self { choice: DeviceChoice::Cpu, device: Device::Cpu }
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Opens it again. The CPU engine takes over where that fails.
    pub(super) fn reopen(&mut self) {
        self.device = Device::open(self.choice).unwrap_or_else(|error| {
            tracing::error!(%error, "the device cannot be opened again; the CPU engine takes over");
            Device::Cpu
        });
        tracing::warn!(device = self.device.name(), "device opened again");
    }
}
