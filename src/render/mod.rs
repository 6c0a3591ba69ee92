//! A camera and a light in, a frame out.

mod colour;
mod develop;
mod edited;
mod high;
mod reference;
mod renderer;
mod standard;
mod tier;

pub use crate::engine::{Frame, Output};
pub use renderer::{PreparedLight, RenderError, Renderer};
pub use tier::{Quality, Tier};

use renderer::Job;
