//! The differentiable renderer. `docs/MODEL.md` says what every engine computes; [`mod@reference`] says it in f64,
//! [`cpu`] does it fast on any machine, [`gpu`] on a graphics card, [`parity`] compares them.

mod blending;
mod camera;
pub mod channel;
pub mod cpu;
pub mod density;
mod device;
mod frame;
pub mod gpu;
mod gradients;
mod indirect;
mod objective;
pub mod parity;
mod probing;
pub mod reference;
mod step;
mod zeros;

pub use blending::{Blending, TRANSMITTANCE_STOP};
pub use camera::RasterCamera;
pub use device::Device;
pub use frame::{Frame, Output};
pub use gradients::{Gradients, RowLayout};
pub use indirect::{indirect_basis, indirect_basis_backward};
pub use objective::{ImageWeights, LightWeights, ParameterWeights, StepWeights, SurfaceWeights};
pub use probing::{NO_HIT, ProbeSettings, fibonacci_sphere};
pub use step::{
    FieldUpdate, Measurement, PhotoKey, Photograph, Step, StepCounts, StepSizes, StepSums, TrainingState,
};
pub use zeros::zeros;
