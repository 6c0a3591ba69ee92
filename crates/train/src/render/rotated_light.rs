//! The prepared light of frames whose light rotates.

use crate::render::{PreparedLight, Renderer};
use relume_engine::DeviceError;
use relume_scene::Illumination;

/// One light, prepared at the rotation of the last frame.
#[derive(Default)]
pub struct RotatedLight {
    /// Degrees, and the light rotated by them.
    prepared: Option<(f64, PreparedLight)>,
}

impl RotatedLight {
    /// `light` rotated by `degrees` about +Z; prepared again only if the rotation differs from that of the previous call.
    /// `renderer` and `light` must be those of the previous call.
    ///
    /// # Errors
    /// The device failed.
    pub fn at(
        &mut self,
        renderer: &Renderer,
        light: &Illumination,
        degrees: f64,
    ) -> Result<&PreparedLight, DeviceError> {
        let (_, prepared) = match self.prepared.take().filter(|(before, _)| *before == degrees) {
            Some(same) => self.prepared.insert(same),
            None => {
                let rotated = light.rotated_and_scaled(degrees, 1.0);
                self.prepared.insert((degrees, renderer.prepare_light(rotated)?))
            }
        };
        Ok(prepared)
    }
}
