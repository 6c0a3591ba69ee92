//! The extremes: where numbers end, every engine gives a finite picture, finite gradients and few wrong digits, or a
//! refusal that names the field.

mod cameras;
mod fuzz;
mod harness;
mod lights_and_materials;
mod opacity_and_layers;
mod shapes;
mod sizes;
