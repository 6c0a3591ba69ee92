//! The differentiable renderer. `docs/MODEL.md` says what every engine computes; [`mod@reference`] says it in f64,
//! [`cpu`] does it fast.

pub mod channel;
pub mod cpu;
mod gradients;
pub mod reference;

pub use gradients::{Gradients, RowLayout};
