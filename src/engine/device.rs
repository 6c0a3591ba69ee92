//! The device that trains and renders.

use std::sync::Arc;

use crate::engine::frames::DeviceFrames;
#[cfg(feature = "gpu")]
use crate::engine::gpu::{self, Gpu};
use crate::engine::{DeviceChoice, TrainState, Training, TrainingLimits, cpu};
use crate::light::EnvOperators;
use crate::scene::Model;

/// An engine that is ready to use.
#[derive(Debug, Clone, Default)]
pub enum Device {
    /// The CPU engine.
    #[default]
    Cpu,
    /// The GPU engine on an open device.
    #[cfg(feature = "gpu")]
    Gpu(Gpu),
}

/// Why a device did not do what was asked, as far as a caller can act on it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// There is no such adapter, or it lacks what the engine needs.
    #[error("{0}")]
    Unavailable(String),
    /// One buffer would be larger than the device binds.
    #[error("{what} needs {needs} bytes on the device, which binds at most {most}")]
    TooLarge {
        /// What the memory is for.
        what: String,
        /// Bytes needed.
        needs: u64,
        /// Bytes that can be had.
        most: u64,
    },
    /// The device has no memory left.
    #[error("the device ran out of memory at {what} ({bytes} bytes)")]
    OutOfMemory {
        /// What the memory was for.
        what: String,
        /// Bytes asked for.
        bytes: u64,
    },
    /// The device went away; nothing on it can be used any more.
    #[error("the device was lost: {0}")]
    Lost(String),
    /// The device did not answer in time.
    #[error("the device did not answer within {0} s")]
    Timeout(u64),
    /// The caller asked for what does not fit together, such as a light that another device prepared.
    #[error("misuse of a device: {0}")]
    Misuse(&'static str),
    /// A mistake of ours; the text is for the log.
    #[error("internal device error: {0}")]
    Internal(String),
}

impl Device {
    /// Opens what `choice` means on this machine.
    ///
    /// # Errors
    /// [`DeviceError::Unavailable`] when a GPU is asked for and cannot be had.
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
        Ok(Gpu::choose(choice)?.map_or(Self::Cpu, Self::Gpu))
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

    /// What it is, in words.
    pub fn name(&self) -> String {
        match self {
            Self::Cpu => "cpu".to_owned(),
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => format!("gpu:{} {}", gpu.report().index, gpu.report().name),
        }
    }

    /// Takes a training over from `state`; `limits` says how large it may become.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] or [`DeviceError::OutOfMemory`] when it does not fit the device.
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables, reason = "the CPU engine has no limits"))]
    pub fn training(
        &self,
        state: TrainState,
        operators: &Arc<EnvOperators>,
        limits: &TrainingLimits,
    ) -> Result<Box<dyn Training>, DeviceError> {
        match self {
            Self::Cpu => Ok(Box::new(cpu::Training::new(state, operators))),
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => Ok(Box::new(gpu::Training::new(gpu, state, operators, limits)?)),
        }
    }

    /// Takes a checked model in, to be rendered; none on the CPU engine, which renders beside every device.
    ///
    /// # Errors
    /// When the device cannot hold it.
    #[cfg_attr(not(feature = "gpu"), expect(unused_variables, reason = "the CPU engine holds it elsewhere"))]
    pub fn frames(&self, model: &Arc<Model>) -> Result<Option<Box<dyn DeviceFrames>>, DeviceError> {
        match self {
            Self::Cpu => Ok(None),
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => Ok(Some(Box::new(gpu::Frames::new(gpu, model)?))),
        }
    }
}
