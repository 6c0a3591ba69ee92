//! Reduces the model to what a scene requires (`complexity: auto`): at fixed points of a training, evidence is gathered from
//! its state, the model is made as small as stated tolerances allow, and both go into the model card.
//!
//! Decisions depend on the state of the training alone, so a resumed training decides what an uninterrupted one does.
//!
//! [`state`] records what was decided. `evidence` and `decide` are pure functions on plain arrays; `photographs` gathers
//! evidence that takes rendering; `sh_degrees` and `ablations` make the decisions from them, `apply` changes the model.

mod ablations;
mod apply;
mod decide;
mod decisions;
mod evidence;
mod photographs;
mod sh_degrees;
pub mod state;

#[cfg(test)]
pub use apply::DIELECTRIC;
pub use apply::hold_dielectric;

#[cfg(test)]
mod tests;
