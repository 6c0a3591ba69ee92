//! Rendered frames: named planes of linear, scene-referred floats.

use std::collections::BTreeMap;

use crate::srgb;
use relume_scene::Output;

/// A rendered frame: each output row-major with its own channel count. Linear, scene-referred.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The requested outputs, and always [`Output::Alpha`].
    pub planes: BTreeMap<Output, Vec<f32>>,
}

impl Frame {
    /// Display-referred 8-bit RGBA (straight alpha) of `rgb`: clamp, sRGB curve. Transparent black without `rgb`.
    pub fn to_srgb8(&self) -> Vec<[u8; 4]> {
        let pixels = self.width as usize * self.height as usize;
        let (Some(rgb), Some(alpha)) = (self.planes.get(&Output::Rgb), self.planes.get(&Output::Alpha))
        else {
            return vec![[0; 4]; pixels];
        };
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        rgb.chunks_exact(3)
            .zip(alpha)
            .map(|(c, a)| {
                let straight = |v: f32| byte(srgb((v / a.max(1e-6)).clamp(0.0, 1.0)));
                [straight(c[0]), straight(c[1]), straight(c[2]), byte(*a)]
            })
            .collect()
    }
}
