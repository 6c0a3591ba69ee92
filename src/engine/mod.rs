//! The differentiable renderer. `docs/MODEL.md` says what every engine computes; [`mod@reference`] says it in f64,
//! [`cpu`] does it fast on any machine, [`gpu`] on a graphics card.

pub mod channel;
pub mod constants;
pub mod cpu;
mod device;
pub mod gpu;
mod gradients;
pub mod reference;
pub mod side_by_side;
mod zeros;

pub use device::Device;
pub use gradients::{Gradients, RowLayout};
pub use zeros::zeros;
