//! The reference engine for tests: the equations of docs/MODEL.md in f64, dense, without optimisation for speed.
//!
//! All operations are recorded on a [`Tape`], which gives the gradient of every intermediate value. [`forward()`] returns the
//! intermediate values, [`objective()`] the loss terms, [`Tape::gradients`] the gradients. [`render`] and
//! [`loss_and_gradients`] are shortcuts. [`parity`] runs one case on the reference, the CPU engine and the GPU engine.

mod array;
mod attributes;
mod compositing;
mod device;
mod direct;
mod display;
mod forward;
mod gbuffer;
mod geometry_loss;
mod lighting;
pub mod losses;
mod model;
mod objective;
mod ops;
pub mod parity;
mod probes;
mod projection;
mod quadrature;
mod shading;
mod spherical;
mod tables;
mod tape;

pub use array::Array;
pub use compositing::{AlphaLimits, Weights};
pub use device::gpu_device;
pub use forward::{Conventions, Gathered, Light, Options, Stages, forward, render};
pub use gbuffer::{Attributes, BlendedLight, GBuffer};
pub use lighting::{DirectLight, Lighting};
pub use model::{
    Arrays, ENVIRONMENT, PROTOTYPES, Parameters, ReferenceModel, ReferenceModelError, parameter_names,
};
pub use objective::{
    LIGHT_COLOUR_TOLERANCE, LISTING_WEIGHTS, Labels, Target, Terms, loss_and_gradients, objective, occlusion,
    weighted_sum,
};
pub use ops::{ScanDirection, concat};
pub use probes::Probes;
pub use projection::{GuardBand, NEAR, Splats};
pub use quadrature::{Quadrature, QuadratureLight};
pub use shading::{Shaded, Surfaces};
pub use spherical::{CLAMPED_COSINE, fibonacci_sphere, normal_related_sh, real_sh};
pub use tables::{TableOperators, TabulatedEnvironment};
pub use tape::{Tape, TapeGradients, Var};
