//! Settings of rendered frames.

mod alpha;
mod background;
mod colour_depth;
mod format;
mod primaries;
mod shown;
mod tier;
mod tone_curve;

pub use alpha::AlphaMode;
pub use background::Background;
pub use colour_depth::ColourDepth;
pub use format::{FrameFormat, is_colour};
pub use primaries::Primaries;
pub use relume_scene::Output;
pub use shown::Shown;
pub use tier::{Quality, Tier};
pub use tone_curve::ToneCurve;

/// Highest SH degree of a colour in exported Gaussians.
pub const MOST_BAKED_DEGREE: usize = 3;
