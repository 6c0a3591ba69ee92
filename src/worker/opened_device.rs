//! A device and what it was chosen by, so that it can be opened anew after a failure.

use std::sync::{Arc, Mutex, PoisonError};

use crate::engine::{Device, DeviceChoice, DeviceError};

/// A device that is ready. Several threads may share one.
pub struct OpenedDevice {
    choice: DeviceChoice,
    /// What this thread works on.
    device: Device,
    /// What the threads that share it have opened last.
    latest: Arc<Mutex<Device>>,
}

impl OpenedDevice {
    /// Opens what was chosen.
    ///
    /// # Errors
    /// When it cannot be had.
    pub fn open(choice: DeviceChoice) -> Result<Self, DeviceError> {
        let device = Device::open(choice)?;
        tracing::info!(device = device.name(), "device ready");
        Ok(Self::of(choice, device))
    }

    /// The CPU engine.
    #[cfg(test)]
    pub fn cpu() -> Self {
        Self::of(DeviceChoice::Cpu, Device::Cpu)
    }

    fn of(choice: DeviceChoice, device: Device) -> Self {
        Self { choice, latest: Arc::new(Mutex::new(device.clone())), device }
    }

    /// The same device for another thread.
    pub(super) fn shared(&self) -> Self {
        Self { choice: self.choice, device: self.device.clone(), latest: self.latest.clone() }
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Opens it again, unless it is sound or a thread that shares it has opened it again. The CPU engine takes over where that
    /// fails.
    pub(super) fn reopen(&mut self) {
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        if !latest.is_sound() {
            *latest = Device::open(self.choice).unwrap_or_else(|error| {
                tracing::error!(%error, "the device cannot be opened again; the CPU engine takes over");
                Device::Cpu
            });
            tracing::warn!(device = latest.name(), "device opened again");
        }
        self.device = latest.clone();
    }
}
