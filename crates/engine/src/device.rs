//! The device that trains and renders: the CPU engine or an open GPU.

use std::sync::Arc;

#[cfg(feature = "gpu")]
use crate::adapter::choose_adapter;
#[cfg(feature = "gpu")]
use crate::gpu::{self, Adapters, Gpu, GpuOptions};
use crate::{
    AdapterReport, DeviceChoice, DeviceError, FrameRenderer, TrainState, TrainingEngine, TrainingLimits, cpu,
};
use relume_scene::Model;
use relume_scene::light::EnvOperators;

/// An open engine.
#[derive(Debug, Clone, Default)]
pub enum Device {
    /// The CPU engine.
    #[default]
    Cpu,
    /// The GPU engine on an open device.
    #[cfg(feature = "gpu")]
    Gpu(Gpu),
}

/// The graphics adapters of this machine, including software adapters; empty in a build without the feature `gpu`.
pub fn adapters() -> Vec<AdapterReport> {
    #[cfg(feature = "gpu")]
    return Adapters::find().reports().to_vec();
    #[cfg(not(feature = "gpu"))]
    Vec::new()
}

impl Device {
    /// Opens the device that `choice` selects on this machine.
    ///
    /// # Errors
    /// [`DeviceError::Unavailable`] when `choice` requires a GPU and none is usable.
    pub fn open(choice: DeviceChoice) -> Result<Self, DeviceError> {
        if choice == DeviceChoice::Cpu {
            return Ok(Self::Cpu);
        }
        match (Self::open_gpu(choice), choice) {
            (Err(error), DeviceChoice::Auto) => {
                tracing::warn!(%error, "the GPU cannot be used; the CPU engine is");
                Ok(Self::Cpu)
            }
            (opened, _) => opened,
        }
    }

    #[cfg(feature = "gpu")]
    fn open_gpu(choice: DeviceChoice) -> Result<Self, DeviceError> {
        let adapters = Adapters::find();
        let Some(index) = choose_adapter(adapters.reports(), choice)? else { return Ok(Self::Cpu) };
        let gpu = Gpu::open(&adapters, index, GpuOptions::from_env())?;
        // A device that fails the self-test is not used.
        gpu.self_test()?;
        Ok(Self::Gpu(gpu))
    }

    #[cfg(not(feature = "gpu"))]
    fn open_gpu(choice: DeviceChoice) -> Result<Self, DeviceError> {
        match choice {
            DeviceChoice::Auto | DeviceChoice::Cpu => Ok(Self::Cpu),
            DeviceChoice::Gpu(_) => Err(DeviceError::Unavailable(
                "device: this build has no GPU engine (feature `gpu`)".to_owned(),
            )),
        }
    }

    /// False once the device has failed; everything on it is then unusable.
    pub fn is_sound(&self) -> bool {
        match self {
            Self::Cpu => true,
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => gpu.healthy().is_ok(),
        }
    }

    /// True on the GPU engine.
    pub fn is_gpu(&self) -> bool {
        !matches!(self, Self::Cpu)
    }

    /// Name for display.
    pub fn name(&self) -> String {
        match self {
            Self::Cpu => "cpu".to_owned(),
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => format!("gpu:{} {}", gpu.report().index, gpu.report().name),
        }
    }

    /// Starts a training from `state`; `limits` bounds its size.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] or [`DeviceError::OutOfMemory`] when it does not fit the device.
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables, reason = "the CPU engine has no limits"))]
    pub fn training(
        &self,
        state: TrainState,
        operators: &Arc<EnvOperators>,
        limits: &TrainingLimits,
    ) -> Result<Box<dyn TrainingEngine>, DeviceError> {
        match self {
            Self::Cpu => Ok(Box::new(cpu::CpuTraining::new(state, operators))),
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => Ok(Box::new(gpu::GpuTraining::new(gpu, state, operators, limits)?)),
        }
    }

    /// Prepares a checked model for rendering by the CPU engine.
    pub fn cpu_frames(model: Arc<Model>) -> Arc<dyn FrameRenderer> {
        Arc::new(cpu::CpuFrameRenderer::new(model))
    }

    /// Prepares a checked model for rendering.
    ///
    /// # Errors
    /// When the model does not fit the device, or the device failed.
    pub fn frames(&self, model: Arc<Model>) -> Result<Arc<dyn FrameRenderer>, DeviceError> {
        match self {
            Self::Cpu => Ok(Self::cpu_frames(model)),
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => Ok(Arc::new(gpu::GpuFrameRenderer::new(gpu, cpu::HostModel::new(model))?)),
        }
    }
}
