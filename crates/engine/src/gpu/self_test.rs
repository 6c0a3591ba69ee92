//! A short test that a device computes correctly.

use crate::DeviceError;
use crate::gpu::buffer::Buffer;
use crate::gpu::device::Gpu;
use crate::gpu::recorder::Groups;
use crate::gpu::shaders;

impl Gpu {
    /// Tests that dispatches, float accumulation and transfers work on this device.
    ///
    /// # Errors
    /// [`DeviceError::Internal`] for a wrong result, or another error of the device.
    pub fn self_test(&self) -> Result<(), DeviceError> {
        let n = 100_000;
        let seen: Buffer<u32> = self.buffer("self-test", n)?;
        let sums: Buffer<f32> = self.buffer("self-test sums", 2)?;
        let mut recorder = self.record();
        recorder.clear(&sums);
        recorder.dispatch(&shaders::SELF_TEST, Groups::Linear(n), &[(&seen).into(), (&sums).into()]);
        recorder.submit()?;
        let counted = self.read(&seen, 0..n)?.iter().enumerate().all(|(i, v)| *v == i as u32);
        let sums = self.read(&sums, 0..2)?;
        if counted && sums.iter().all(|s| *s == n as f32 / 2.0) {
            return Ok(());
        }
        Err(DeviceError::Internal(format!("the self-test of the device failed: sums {sums:?}")))
    }
}
