//! A training on the GPU engine.
use crate::engine::gpu::{Gpu, GpuError};
use crate::light::EnvOperators;
use crate::train::on_cpu::OnCpu;
use crate::train::state::Learned;
use crate::train::{TrainConfig, TrainError};
pub(super) struct OnGpu;
impl OnGpu {
    pub(super) fn new(_: &Gpu, _: &TrainConfig, _: &EnvOperators, _l: Learned) -> Result<OnCpu, TrainError> {
        Err(GpuError::Internal("todo".into()).into())
    }
}
