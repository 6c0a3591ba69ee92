//! The native CPU engine: f32, tiles, sixteen pixels at a time, rayon over tiles and Gaussians.
//!
//! The same inputs give the same bytes for any number of threads: work is split by tile or Gaussian, never by thread, and
//! every sum across tiles has a fixed order. Kernels round products and sums separately, so the bytes do not depend on the
//! features of the CPU.

mod adam;
mod attributes;
mod blend;
mod blend_backward;
mod branch_images;
mod density;
mod direct;
mod display;
mod frames;
mod gather;
mod ground;
mod host;
mod host_views;
mod labels;
mod lambert;
mod lamp_ground;
mod lamps;
mod lanes;
mod light_matrix;
mod mixture;
mod monte_carlo;
pub mod objective;
mod occluder;
mod pass;
mod pixel_light;
mod point;
mod probes;
mod project;
mod rays;
mod resolve;
mod shadows;
mod sharp_lights;
mod shown_splats;
mod sky_shadows;
mod surface;
mod surface_shader;
mod tiles;
pub(crate) mod training;

pub use attributes::AttributeSource;
#[cfg(test)]
pub use blend_backward::ROW_HEADER;
pub use branch_images::{BranchImages, BufferGradient, radiance_image, radiance_image_backward, surface_at};
pub(crate) use frames::CpuFrameRenderer;
pub use frames::blended_radiance;
pub use gather::{Transport, sky_irradiance};
pub use ground::{Ground, GroundRadiance, GroundView};
pub use host::{HostLight, HostModel, SurfaceEdit, VisibleSurface};
pub use labels::{BackwardLabel, backward_labels, weighted_sums};
pub use lamp_ground::{LampGround, LampLight};
pub use lamps::{Lamp, LampCone, LampFrame, LampShadows};
pub(crate) use lanes::exp_negative;
pub use lanes::{LANES, Lanes};
pub use light_matrix::{LightMatrix, MatrixLight};
pub use mixture::softmax_lanes;
pub use pass::{Pass, attribute_rows, project_all};
pub use point::{surface_point, surface_points};
pub use probes::{Probes, arriving, light_shares, outward_normals};
pub use project::{Geometry, Splat, normalise, normalise_backward, rotation, rotation_backward};
pub use rays::OccluderBvh;
pub use resolve::{reflector, resolve};
pub use shown_splats::ShadedColumns;
pub use sky_shadows::SkyShadows;
pub use surface::{MAX_COEFFICIENTS, Surface, SurfaceGradient, SurfaceShader};
pub use surface_shader::Shaded;
pub use training::{CpuTraining, ObjectiveResult, objective};
