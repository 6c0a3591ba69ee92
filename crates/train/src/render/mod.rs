//! A camera and a light in, a frame out.

mod background;
mod baked;
mod bands;
mod direct;
mod edited;
mod encode;
mod error;
mod finish;
mod high;
mod job;
mod mesh;
mod monte_carlo;
mod notes;
mod renderer;
mod sequence;
mod splat_file;
mod viewer;
mod viewpoint;

pub use bands::Bands;
pub use encode::{EncodedFrame, encode_frame, encode_wanted_frame};
pub use error::RenderError;
pub use finish::Finish;
pub use mesh::MeshOptions;
pub use notes::FrameNotes;
pub use relume_engine::Frame;
pub use renderer::{PreparedLight, Renderer};
pub use sequence::{Turntable, View, orbit_camera, resized, turn_light};
pub use splat_file::{SplatFile, SplatFileError, encode_mesh_file, encode_splat_file, relit};
pub use viewer::stream_gaussians;
pub use viewpoint::{Orbit, Viewpoint};
