//! An opened device with the choice by which it was selected, so that it can be opened again after a failure.

use std::sync::Arc;

use tokio::sync::watch;

use relume_engine::{Device, DeviceChoice, DeviceError};

/// A ready device. Several threads may share it.
pub struct OpenedDevice {
    choice: DeviceChoice,
    /// The device that this thread uses.
    device: Device,
    /// The device that one of the sharing threads opened last. It is sent after each failure of one of them.
    latest: Arc<watch::Sender<Device>>,
    updates: watch::Receiver<Device>,
}

impl OpenedDevice {
    /// Opens the chosen device.
    ///
    /// # Errors
    /// If the device is not available.
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
        let (latest, updates) = watch::channel(device.clone());
        Self { choice, device, latest: Arc::new(latest), updates }
    }

    /// The same device for another thread.
    pub(super) fn shared(&self) -> Self {
        let (latest, updates) = (self.latest.clone(), self.latest.subscribe());
        Self { choice: self.choice, device: self.device.clone(), latest, updates }
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Opens the device again, unless it works or another thread has already reopened it. If this fails, the CPU engine replaces
    /// it. The other threads are notified in all cases, so that they release memory on the device.
    pub(super) fn reopen(&mut self) {
        self.latest.send_modify(|latest| {
            if latest.is_sound() {
                return;
            }
            *latest = Device::open(self.choice).unwrap_or_else(|error| {
                tracing::error!(%error, "the device cannot be opened again; the CPU engine replaces it");
                Device::Cpu
            });
            tracing::warn!(device = latest.name(), "device opened again");
        });
        self.device = self.updates.borrow_and_update().clone();
    }

    /// Switches to the device that another thread has opened. Returns true after a failure there; the caller must then clear its
    /// data on the device.
    pub(super) fn renew(&mut self) -> bool {
        let has_failed = self.updates.has_changed().unwrap_or(false);
        self.device = self.updates.borrow_and_update().clone();
        has_failed
    }

    /// Waits until [`Self::renew`] would return true.
    pub(super) async fn device_replaced(&self) {
        let mut updates = self.updates.clone();
        if updates.changed().await.is_err() {
            std::future::pending().await
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_engine::gpu::{Adapters, Gpu, GpuOptions};

    #[test]
    fn a_device_failure_is_reported_once_to_the_other_thread() {
        let (mut one, mut other) = (OpenedDevice::cpu(), OpenedDevice::cpu());
        let mut shared = one.shared();
        assert!(!shared.renew(), "the control: nothing has failed");
        one.reopen();
        assert!(shared.renew() && !shared.renew());
        assert!(
            !one.renew() && !other.renew(),
            "a thread is not notified of its own failure, nor of that of an unrelated device"
        );
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn a_lost_device_is_reopened_once_for_all_threads() {
        // A separate device, because the test destroys it.
        let Device::Gpu(shared) = relume_reference::gpu_device() else { panic!("the device is a GPU") };
        let gpu = Gpu::open(&Adapters::find(), shared.report().index, GpuOptions::default()).unwrap();
        let choice = DeviceChoice::Gpu(Some(gpu.report().index as _));
        let mut one = OpenedDevice::of(choice, Device::Gpu(gpu.clone()));
        let mut other = one.shared();
        gpu.destroy();
        assert!(!one.device().is_sound() && !other.device().is_sound());
        one.reopen();
        assert!(one.device().is_sound() && other.renew() && other.device().is_sound());
    }
}
