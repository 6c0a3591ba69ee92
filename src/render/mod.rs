//! A camera and a light in, a frame out.

mod direct;
mod edited;
mod encode;
mod error;
mod high;
mod job;
mod monte_carlo;
mod renderer;
mod tier;
mod viewpoint;

pub use crate::engine::{Frame, Output};
pub use encode::{EncodedFrame, FrameFormat, encode_frame, is_colour};
pub use error::RenderError;
pub use renderer::{PreparedLight, Renderer};
pub use tier::{Quality, Tier};
pub use viewpoint::{Orbit, Viewpoint};
