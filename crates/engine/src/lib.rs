//! The differentiable renderer: [`cpu`] on any machine and, with the feature `gpu`, on a graphics card. `docs/MODEL.md`
//! defines what both compute. The crate `relume-reference` computes the same in f64, for tests.
//!
//! [`Device`] opens an engine. A trainer uses [`TrainingEngine`], a renderer uses [`FrameRenderer`].

mod activation;
pub mod adam;
mod adapter;
mod camera;
pub mod cpu;
mod density;
mod device;
mod display;
mod error;
pub mod evaluation;
mod frame;
mod frame_job;
mod frames;
#[cfg(feature = "gpu")]
pub mod gpu;
mod gradients;
mod indirect;
mod objective;
mod photo_light;
mod probing;
mod ray_job;
mod state;
mod step;
mod training;
mod zeros;

pub use activation::{sigmoid, sigmoid_derivative, softmax};
pub use adam::{StepCounts, StepSizes};
pub use adapter::{AdapterReport, DeviceChoice, choose_adapter};
pub use camera::RasterCamera;
pub use cpu::{
    Ground, GroundRadiance, GroundView, HostLight, HostModel, Lamp, LampCone, LampFrame, LampGround,
    LampLight, LampShadows, LightMatrix, MatrixLight, OccluderBvh, ShadedColumns, Surface, SurfaceEdit,
    SurfaceShader, VisibleSurface,
};
pub use density::{DensityPlan, DensitySignals, DensityStats, PlannedGaussian, SplitOrigin};
pub use device::{Device, adapters};
pub use display::{linear_from_srgb, srgb, srgb_derivative};
pub use error::DeviceError;
pub use frame::Frame;
pub use frame_job::{BOUNCES, ColourMode, FrameJob, PROBE_DIRECTIONS};
pub use frames::{FrameLight, FrameRenderer};
pub use gradients::{Gradients, RowLayout};
pub use indirect::{NO_INDIRECT_BASIS, indirect_basis, indirect_basis_backward};
pub use objective::{
    ImageWeights, LightWeights, ParameterWeights, StepWeights, SurfaceWeights, upward_share,
};
pub use photo_light::{PhotoLight, PhotoLights, TurnedLight};
pub use probing::{ProbeSettings, fibonacci_sphere, towards_light};
pub use ray_job::{RayLight, RayTree};
pub use relume_layout::constants::TILE;
pub use state::{Moments, TrainState};
pub use step::{Branches, FieldUpdate, Photo, PhotoId, PhotoSize, ProbeMeasurement, Step, StepResult};
pub use training::{TrainingEngine, TrainingLimits};
pub use zeros::zeros;
