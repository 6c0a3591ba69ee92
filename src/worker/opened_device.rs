//! A device and what it was chosen by, so that it can be opened anew after a failure.

use std::sync::Arc;

use tokio::sync::watch;

use relume_engine::{Device, DeviceChoice, DeviceError};

/// A device that is ready. Several threads may share one.
pub struct OpenedDevice {
    choice: DeviceChoice,
    /// What this thread works on.
    device: Device,
    /// What the threads that share it have opened last; said again each time that one of them failed.
    latest: Arc<watch::Sender<Device>>,
    updates: watch::Receiver<Device>,
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

    /// Opens it again, unless it is sound or a thread that shares it has opened it again. The CPU engine takes over where that
    /// fails. Other threads hear of it in any case: what they keep on a device without memory is in the way.
    pub(super) fn reopen(&mut self) {
        self.latest.send_modify(|latest| {
            if latest.is_sound() {
                return;
            }
            *latest = Device::open(self.choice).unwrap_or_else(|error| {
                tracing::error!(%error, "the device cannot be opened again; the CPU engine takes over");
                Device::Cpu
            });
            tracing::warn!(device = latest.name(), "device opened again");
        });
        self.device = self.updates.borrow_and_update().clone();
    }

    /// Goes over to the device that another thread has opened. True after a failure there: nothing should be kept on it then.
    pub(super) fn renew(&mut self) -> bool {
        let has_failed = self.updates.has_changed().unwrap_or(false);
        self.device = self.updates.borrow_and_update().clone();
        has_failed
    }

    /// Ends when [`Self::renew`] would be true.
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
        assert!(!one.renew() && !other.renew(), "not by itself, and not by who shares nothing");
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn a_lost_device_is_reopened_once_for_all_threads() {
        // A device of its own: the test destroys it.
        let Device::Gpu(shared) = relume_reference::gpu_device() else { panic!("the device is a GPU") };
        let gpu =
            Gpu::open(&Adapters::find(), shared.report().index as usize, GpuOptions::default()).unwrap();
        let choice = DeviceChoice::Gpu(Some(gpu.report().index as _));
        let mut one = OpenedDevice::of(choice, Device::Gpu(gpu.clone()));
        let mut other = one.shared();
        gpu.destroy();
        assert!(!one.device().is_sound() && !other.device().is_sound());
        one.reopen();
        assert!(one.device().is_sound() && other.renew() && other.device().is_sound());
    }
}
