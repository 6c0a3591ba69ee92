//! A camera and a light in, a frame out.

mod background;
mod baked;
mod bands;
mod direct;
mod edited;
mod encode;
mod error;
mod finish;
mod format;
mod high;
mod job;
mod mesh;
mod monte_carlo;
mod notes;
mod renderer;
mod tier;
mod tone_curve;
mod viewer;
mod viewpoint;

pub use crate::engine::{Frame, Output};
pub use crate::formats::exr_frame::ColourDepth;
pub use background::Background;
pub use baked::MOST_BAKED_DEGREE;
pub use bands::Bands;
pub use encode::{EncodedFrame, encode_frame, encode_wanted_frame};
pub use error::RenderError;
pub use finish::Finish;
pub use format::{FrameFormat, is_colour};
pub use mesh::MeshOptions;
pub use notes::FrameNotes;
pub use renderer::{PreparedLight, Renderer};
pub use tier::{Quality, Tier};
pub use tone_curve::ToneCurve;
pub use viewer::stream_gaussians;
pub use viewpoint::{Orbit, Viewpoint};
