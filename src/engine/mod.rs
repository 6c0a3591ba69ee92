//! The differentiable renderer.

pub mod reference;
