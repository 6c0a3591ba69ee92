//! Rasterisation on the device: projection, depth order, tile lists, blending and the way back to the splats.
//!
//! A frame goes through typed stages, each made from the one before: [`Raster::record`] gives [`Projected`],
//! [`Projected::attributes`] gives [`Attributed`], [`Attributed::blend`] gives [`Blended`], [`Blended::backward`] gives
//! [`Differentiated`]. A stage borrows the [`Raster`], whose memory is kept from frame to frame and only grows.

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
