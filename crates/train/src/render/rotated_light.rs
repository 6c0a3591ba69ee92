//! A light that rotates between frames, as on a turntable.

use crate::render::{PreparedLight, Renderer};
use relume_engine::DeviceError;
use relume_scene::Illumination;

/// One light, prepared at the rotation of the last frame.
#[derive(Default)]
pub struct RotatedLight {
    /// Light group and degrees, and the light rotated by them.
    prepared: Option<((usize, f64), PreparedLight)>,
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
        self.prepared(renderer, (0, degrees), || light.rotated_and_scaled(degrees, 1.0))
    }

    /// The recovered light of light group `group`, rotated by `degrees` about +Z; prepared again only if either differs from that of the
    /// previous call. `renderer` must be that of the previous call.
    ///
    /// # Errors
    /// The device failed.
    pub fn recovered(
        &mut self,
        renderer: &Renderer,
        group: usize,
        degrees: f64,
    ) -> Result<&PreparedLight, DeviceError> {
        let light = || renderer.model().recovered_light_of(group).rotated_and_scaled(degrees, 1.0);
        self.prepared(renderer, (group, degrees), light)
    }

    fn prepared(
        &mut self,
        renderer: &Renderer,
        key: (usize, f64),
        light: impl FnOnce() -> Illumination,
    ) -> Result<&PreparedLight, DeviceError> {
        let (_, prepared) = match self.prepared.take().filter(|(before, _)| *before == key) {
            Some(same) => self.prepared.insert(same),
            None => self.prepared.insert((key, renderer.prepare_light(light())?)),
        };
        Ok(prepared)
    }
}
