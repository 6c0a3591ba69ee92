//! The terms of the objective (docs/MODEL.md section 5), each with its gradient.

pub mod aggregation;
pub mod geometry;
pub mod image;
pub mod parameters;

/// Derivative of `|x|`: 1, -1, and 0 at 0.
fn sign(x: f32) -> f32 {
    if x > 0.0 {
        1.0
    } else if x < 0.0 {
        -1.0
    } else {
        0.0
    }
}

fn sum(values: &[f32]) -> f32 {
    values.iter().map(|v| f64::from(*v)).sum::<f64>() as f32
}
