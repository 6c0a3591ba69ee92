//! The differentiable renderer.
