//! Reduces the model to what a scene requires (`complexity: auto`). At fixed points of a training, evidence is
//! gathered from its state, and the model is reduced as far as stated tolerances allow. Decisions and evidence are
//! recorded in the model card.
//!
//! Decisions depend only on the state of the training, so a resumed training decides as an uninterrupted one.
//!
//! [`state`] records the decisions. `evidence` and `decide` are pure functions on plain arrays; `photographs` gathers
//! evidence that requires rendering; `sh_degrees` and `ablations` make the decisions from them; `apply` changes the
//! model.

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
pub use photographs::MAX_SIDE;

#[cfg(test)]
mod tests;
