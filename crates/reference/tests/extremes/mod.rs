//! Extreme inputs: every engine gives finite images and gradients within stated errors, or an error that names the field.

mod cameras;
mod fuzz;
pub mod harness;
mod lights_and_materials;
mod opacity_and_layers;
mod shapes;
mod sizes;
