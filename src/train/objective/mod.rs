//! The terms of the objective (docs/MODEL.md section 5), each with its gradient.

pub mod geometry;
pub mod image;
pub mod material;
