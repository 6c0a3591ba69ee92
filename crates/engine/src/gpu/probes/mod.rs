//! Transmittance probes on the device: the port of [`crate::cpu::Probes`] (docs/MODEL.md, section 6).

mod buffers;
mod sweep;
#[cfg(test)]
pub(super) mod tests;

pub use buffers::ProbeBuffers;
pub(super) use buffers::direction_weight;
pub use sweep::measure;
