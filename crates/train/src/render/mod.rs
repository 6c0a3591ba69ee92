//! Rendering of models: frames for a camera and a light, image files, splat files and meshes.

mod background;
mod baked;
mod bands;
mod edited;
mod encode;
mod encode_options;
mod error;
mod frame_metadata;
mod ground;
mod high_tier_light;
mod lamps;
mod light_matrix;
mod mesh;
mod renderer;
mod rotated_light;
mod sequence;
mod splat_file;
mod viewer;
mod viewpoint;

pub use bands::Bands;
pub use encode::{EncodedFrame, encode_frame, encode_wanted_frame};
pub use encode_options::EncodeOptions;
pub use error::RenderError;
pub use frame_metadata::FrameMetadata;
pub use light_matrix::{MatrixFrames, MatrixLights};
pub use mesh::MeshOptions;
pub use relume_engine::Frame;
pub use renderer::{PreparedLight, Renderer};
pub use rotated_light::RotatedLight;
pub use sequence::{FrameView, Turntable, orbit_camera, resized, rotate_light};
pub use splat_file::{SplatFile, SplatFileError, encode_mesh_file, encode_splat_file, relit};
pub use viewer::stream_gaussians;
pub use viewpoint::{Orbit, Viewpoint};
