//! Rasterisation on the device: projection, depth order, tile lists, blending and the backward pass to the splats.
//!
//! A frame passes through typed stages, each created from the previous one: [`Raster::record`] returns [`Projected`],
//! [`Projected::attributes`] returns [`Attributed`], [`Attributed::blend`] returns [`Blended`], [`Blended::backward`] returns
//! [`Differentiated`]. A stage borrows the [`Raster`], whose memory is reused by all frames and only grows.

mod attributes;
mod blend;
mod blend_backward;
mod memory;
mod project;
mod records;
mod shaded;
#[cfg(test)]
mod tests;
mod tile_list_capacity;
mod tiles;

pub use attributes::Attributed;
pub use blend::Blended;
pub use blend_backward::{Differentiated, GRADIENT_HEADER};
pub use memory::Raster;
pub use project::Projected;
pub use records::{BlendEnd, RasterCounts, SplatRecord};
