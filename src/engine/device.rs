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
        match (adapters.choose(choice)?, choice) {
            (None, _) => Ok(Self::Cpu),
            (Some(index), DeviceChoice::Auto) => Ok(Gpu::open(&adapters, index, GpuOptions::from_env())
                .map(Self::Gpu)
                .unwrap_or_else(|error| {
                    tracing::warn!(%error, "the GPU cannot be used; the CPU engine is");
                    Self::Cpu
                })),
            (Some(index), _) => Gpu::open(&adapters, index, GpuOptions::from_env()).map(Self::Gpu),
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
