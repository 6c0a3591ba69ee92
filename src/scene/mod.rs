//! What a relightable model *is*: Gaussians, materials, environment and camera. Plain data: no GPU, no IO.

mod camera;
mod environment;
mod field;
mod gaussians;
mod model;

pub use camera::{Camera, CameraError};
pub use environment::{
    BRIGHTEST, EnvMap, EnvMapError, EnvMapStats, direction_to_uv, texel_directions, uv_to_direction,
};
pub use field::Field;
pub use gaussians::Gaussians;
pub use model::{
    DiffuseForm, IndirectForm, Model, ModelError, NormalForm, ShadeAt, ShadingOptions, VisibilityForm,
    sh_count, softplus, softplus_inverse,
};
