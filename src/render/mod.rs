//! A camera and a light in, a frame out.

mod edited;
mod high;
mod monte_carlo;
mod renderer;
mod tier;

pub use crate::engine::{Frame, Output};
pub use renderer::{PreparedLight, RenderError, Renderer};
pub use tier::{Quality, Tier};

use renderer::Job;
