//! A camera and a light in, a frame out.

mod edited;
mod frame;
mod on_gpu;
mod preview;
mod renderer;

pub use frame::{Frame, Output};
pub use renderer::{PreparedLight, RenderError, Renderer, Tier};
