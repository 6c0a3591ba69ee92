//! The data of a relightable model: Gaussians, materials, environment, camera, images. No GPU, no input or output.

mod camera;
mod column_shift;
mod display_range;
mod environment;
mod gaussians;
mod illumination;
mod image;
pub mod light;
mod model;
mod opaque_extent;
mod output;
mod packed_image;
mod photographed_views;
pub mod srgb;

pub use camera::{Camera, CameraError};
pub use column_shift::ColumnShift;
pub use display_range::{DisplayRange, SCENE_PEAK};
pub use environment::{
    EnvMap, EnvMapError, EnvMapStats, MAX_RADIANCE, direction_to_uv, texel_directions, uv_to_direction,
};
pub use gaussians::{Gaussians, sh_count};
pub use illumination::Illumination;
pub use image::{ImageRgba, Plane};
pub use model::{
    DiffuseForm, Framing, IndirectForm, MAX_LIGHT_GROUPS, Model, ModelError, NormalForm, RECOVERED_GROUP,
    ShadeAt, ShadingOptions, VisibilityForm, softplus, softplus_inverse,
};
pub use opaque_extent::{opaque_centre, opaque_radius};
pub use output::Output;
pub use packed_image::{BitDepth, PackedImage};
pub use photographed_views::{
    FRAME_MARGIN, NearestPhotograph, PhotographedDirection, PhotographedViews, UNSEEN_DEG, direction_of,
};
pub use relume_layout::{Field, FieldWidth, LightSplit, MAX_LIGHTS, SplitLight};
