//! A classic colour chart of 24 patches in one of the photographs.

mod delta_e;
mod fit;
mod matrix;
mod measured;
mod order;
mod reference;
mod sampling;
#[cfg(test)]
mod test_chart;

pub use delta_e::DeltaE;
pub use matrix::ColourMatrix;
pub use measured::{ChartPatch, MeasuredChart, measure_colour_chart};
