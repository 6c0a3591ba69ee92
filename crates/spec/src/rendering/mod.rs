//! Settings of rendered frames.

mod alpha;
mod background;
mod colour_depth;
mod exported_colour;
mod format;
mod lamp;
mod layer_format;
mod material_edit;
mod primaries;
mod tier;
mod tone_curve;

pub use alpha::AlphaMode;
pub use background::Background;
pub use colour_depth::ColourDepth;
pub use exported_colour::ExportedColour;
pub use format::{FrameFormat, is_colour};
pub use lamp::{Lamp, LampShape, MAX_LAMPS};
pub use layer_format::LayerFormat;
pub use material_edit::{Ball, Colour, MAX_MATERIAL_EDITS, MaterialEdit};
pub use primaries::Primaries;
pub use relume_scene::Output;
pub use tier::{Quality, Tier};
pub use tone_curve::ToneCurve;

/// Highest SH degree of a colour in exported Gaussians.
pub const MAX_BAKED_DEGREE: usize = 3;
