//! The device that trains and renders.

use crate::engine::gpu::{Adapters, DeviceChoice, Gpu, GpuError, GpuOptions};

/// An engine that is ready to use.
#[derive(Debug, Clone, Default)]
pub enum Device {
    /// The CPU engine.
    #[default]
    Cpu,
    /// The GPU engine on an open device.
    Gpu(Gpu),
}

impl Device {
    /// Opens what `choice` means on this machine.
    ///
    /// # Errors
    /// [`GpuError::Unavailable`] when a GPU is asked for and cannot be had.
    pub fn open(choice: DeviceChoice) -> Result<Self, GpuError> {
        if choice == DeviceChoice::Cpu {
            return Ok(Self::Cpu);
        }
        let adapters = Adapters::find();
        let Some(index) = adapters.choose(choice)? else { return Ok(Self::Cpu) };
        // Nothing is built on a device that cannot add.
        let opened = Gpu::open(&adapters, index, GpuOptions::from_env())
            .and_then(|gpu| gpu.self_test().map(|()| Self::Gpu(gpu)));
        match (opened, choice) {
            (Err(error), DeviceChoice::Auto) => {
                tracing::warn!(%error, "the GPU cannot be used; the CPU engine is");
                Ok(Self::Cpu)
            }
            (opened, _) => opened,
        }
    }

    /// What it is, in words.
    pub fn name(&self) -> String {
        match self {
            Self::Cpu => "cpu".to_owned(),
            Self::Gpu(gpu) => format!("gpu:{} {}", gpu.report().index, gpu.report().name),
        }
    }
}
