//! A camera and a light in, a frame out.

mod renderer;

pub use renderer::{Frame, Output, PreparedLight, RenderError, Renderer, Tier};
