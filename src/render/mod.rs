//! A camera and a light in, a frame out.

mod colour;
mod develop;
mod edited;
mod encode;
mod frame;
mod high;
mod on_gpu;
mod reference;
mod renderer;
mod standard;
mod tier;
mod viewpoint;

pub use encode::{EncodedFrame, FrameFormat, encode_frame, is_colour};
pub use frame::{Frame, Output};
pub use renderer::{PreparedLight, RenderError, Renderer};
pub use tier::{Quality, Tier};
pub use viewpoint::{Orbit, Viewpoint};

use renderer::Job;
