//! Sizes to which environment maps are reduced, in rows; a map has twice as many columns. The sizes are together in one file,
//! since one map passes through several of them.

/// Maps with which frames are rendered: a texel of 0.18 degrees, a third of the sun's width.
pub const RENDERED_ROWS: usize = 1024;
/// Maps from which Monte-Carlo samples are drawn: a texel of 0.35 degrees, two thirds of the sun's width.
pub const SAMPLED_ROWS: usize = 512;
/// Maps in which dominant lights are searched. Larger maps are reduced first, which keeps their power.
pub const LIGHT_SEARCH_ROWS: usize = 512;
/// Maps with fewer rows have no small lights: a texel of 5.6 degrees is wider than one.
pub const MIN_LIGHT_SEARCH_ROWS: usize = 32;
/// Maps that a viewer shows behind a model, as a picture of the light.
pub const VIEWER_ROWS: usize = 256;
/// Maps over which the diffuse transfer is integrated: the clamped cosine has no detail below ten degrees.
pub const DIFFUSE_ROWS: usize = 32;
/// Map whose texels the lobes of a light matrix divide: a lobe of 512 has 64 texels.
pub const LOBE_ROWS: usize = 128;
